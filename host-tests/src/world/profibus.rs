//! A PROFIBUS master. The line is modelled as a UART: characters with times, and a handler that runs for each.

use bus_profibus::{Baud, Character};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::UartStatus;
use wsg_bridge_fw::{Config, PlcBus, ProfibusConfig};
use wsg_fieldbus::{CommandFlags, InputImage, OutputImage};

use super::World;
use super::plc::Plc;

/// The default station address.
pub const STATION: u8 = 7;
/// Address of the first class 1 master.
pub const MASTER: u8 = 2;
/// Address of a second master.
pub const SECOND_MASTER: u8 = 3;
/// Short acknowledgement.
pub const SC: [u8; 1] = [0xE5];

/// Service access points of the slave, by service (IEC 61158-6-3).
#[allow(missing_docs, reason = "named as in the standard")]
pub mod points {
    pub const SET_SLAVE_ADDRESS: u8 = 55;
    pub const RD_INP: u8 = 56;
    pub const RD_OUTP: u8 = 57;
    pub const GLOBAL_CONTROL: u8 = 58;
    pub const GET_CFG: u8 = 59;
    pub const SLAVE_DIAG: u8 = 60;
    pub const SET_PRM: u8 = 61;
    pub const CHK_CFG: u8 = 62;
    /// Source access point of a class 1 master.
    pub const MASTER: u8 = 62;
}

/// Bits per character.
const CHARACTER_BITS: u32 = 11;
/// Idle time before a request (T_SYN), in bits.
const SYNC_BITS: u32 = 33;

/// PROFIBUS at 500 kbit/s, the master's rate.
pub const AT_500K: Config = Config {
    plc_bus: PlcBus::Profibus,
    profibus: ProfibusConfig { rate: Some(Baud::K500), ..ProfibusConfig::DEFAULT },
    ..Config::DEFAULT
};

/// A master, the [`World`] that it is connected to, and the current time.
pub struct Master {
    /// The world. Time passes only in the master's methods.
    pub world: World,
    /// The master's output image.
    pub image: OutputImage,
    fcb: bool,
    now_us: u32,
    rate: u32,
}

impl Master {
    /// Creates a master that has sent nothing yet. All wires are low except FAST_STOP_OK.
    #[must_use]
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut world = World::new(config, gripper);
        world.set(Inputs::FAST_STOP_OK, true);
        world.interrupt(UartStatus::default(), 0);
        let image = OutputImage { width: 20_00, speed: 100_00, force_limit: 40_00, ..OutputImage::ZERO };
        let rate = config.profibus.rate.map_or(500_000, Baud::bit_s);
        Self { world, image, fcb: false, now_us: 0, rate }
    }

    /// Creates a master in data exchange, and a responding gripper. `watchdog` is in units of 10 ms; 0 disables it.
    /// The master has written parameters and no command flag.
    #[must_use]
    pub fn exchanging(config: Config, gripper: wsg_sim::Config, watchdog: u8) -> Self {
        let mut master = Self::new(config, gripper);
        master.pass_silent(200);
        master.start(watchdog);
        master.exchange();
        master.pass(10);
        master
    }

    /// Advances time. The main loop runs every millisecond, followed by the handler.
    fn pass_us(&mut self, us: u32) {
        for _ in 0..us {
            self.now_us += 1;
            if self.now_us.is_multiple_of(1_000) {
                self.world.step();
                let idle = UartStatus { has_room: true, is_complete: true, ..UartStatus::default() };
                let action = self.world.interrupt(idle, self.now_us);
                assert_eq!(action.send, None, "an answer without a request");
            }
        }
    }

    fn bits_us(&self, bits: u32) -> u32 {
        (bits * 1_000_000).div_ceil(self.rate)
    }

    /// Puts consecutive characters on the line. Returns the wait until an answer, if one is due.
    fn put(&mut self, characters: &[Character]) -> Option<u32> {
        let mut wait_us = None;
        for character in characters {
            self.pass_us(self.bits_us(CHARACTER_BITS));
            let status = UartStatus { received: Some(*character), has_room: true, is_complete: true };
            let action = self.world.interrupt(status, self.now_us);
            assert_eq!(action.send, None, "before the least T_SDR");
            wait_us = action.wait_us;
        }
        wait_us
    }

    /// Sends bytes after an idle time and returns the answer, or nothing.
    ///
    /// # Panics
    /// Panics when an answer begins before 11 bit times or after max T_SDR.
    pub fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        let characters: Vec<_> = bytes.iter().map(|byte| Character::Byte(*byte)).collect();
        self.send_characters(&characters)
    }

    /// Does the same as [`send`](Self::send), with characters that may be damaged.
    ///
    /// # Panics
    /// See [`send`](Self::send).
    pub fn send_characters(&mut self, characters: &[Character]) -> Vec<u8> {
        self.pass_us(self.bits_us(SYNC_BITS + 4));
        let Some(wait_us) = self.put(characters) else { return vec![] };
        assert!(wait_us >= self.bits_us(11), "{wait_us} us");
        let mut answer = Vec::new();
        // The timer expires. The main loop does not run meanwhile, so the handler alone sends the answer.
        self.now_us += wait_us;
        let mut status = UartStatus { has_room: true, is_complete: true, ..UartStatus::default() };
        loop {
            let action = self.world.interrupt(status, self.now_us);
            let Some(byte) = action.send else { break };
            answer.push(byte);
            let rest = action.interrupts;
            assert!(
                rest.transmit_empty != rest.transmission_complete,
                "exactly one transmit interrupt is enabled"
            );
            self.now_us += self.bits_us(CHARACTER_BITS);
            // The transceiver may echo.
            let echo = UartStatus { received: Some(Character::Byte(byte)), ..UartStatus::default() };
            assert_eq!(self.world.interrupt(echo, self.now_us).send, None);
            status = UartStatus { has_room: true, is_complete: rest.transmission_complete, ..status };
        }
        // The main loop catches up with the time that the answer took.
        while self.world.now_ms() < self.now_us / 1_000 {
            self.world.step();
            self.world.interrupt(UartStatus::default(), self.now_us);
        }
        answer
    }

    /// Returns the function code of the master's next request, with alternating frame count bit.
    fn next(&mut self) -> u8 {
        self.fcb = !self.fcb;
        if self.fcb { 0x7D } else { 0x5D }
    }

    /// Sends a service with data from this master.
    pub fn service_of(&mut self, master: u8, point: u8, data: &[u8]) -> Vec<u8> {
        let head = [STATION | 0x80, master | 0x80, self.next(), point, points::MASTER];
        self.send(&sd2(&[&head[..], data].concat()))
    }

    /// Sends a service with data.
    pub fn service(&mut self, point: u8, data: &[u8]) -> Vec<u8> {
        self.service_of(MASTER, point, data)
    }

    /// Sends configuration and parameters. `watchdog` is in units of 10 ms; 0 disables it.
    pub fn start(&mut self, watchdog: u8) {
        let status = if watchdog == 0 { 0x80 } else { 0x88 };
        self.start_with(&[status, 1, watchdog, 11, 0x55, 0x55, 0], &[0xA7, 0x9B]);
    }

    /// Sends these parameters and this configuration.
    ///
    /// # Panics
    /// Panics when they are not acknowledged. The slave acknowledges rejected ones, too.
    pub fn start_with(&mut self, parameters: &[u8], config: &[u8]) {
        assert_eq!(self.service(points::SET_PRM, parameters), SC);
        assert_eq!(self.service(points::CHK_CFG, config), SC);
    }

    /// Reads the three status bytes and the master address from the diagnosis.
    ///
    /// # Panics
    /// Panics when the diagnosis is not 16 bytes long.
    pub fn diagnosis(&mut self) -> [u8; 4] {
        let answer = self.service(points::SLAVE_DIAG, &[]);
        assert_eq!(answer.len(), 4 + 5 + 16 + 2, "{answer:02X?}");
        std::array::from_fn(|n| answer[9 + n])
    }

    /// Broadcasts Global_Control to these groups; 0 addresses all.
    ///
    /// # Panics
    /// Panics when the slave answers.
    pub fn control(&mut self, command: u8, groups: u8) {
        let answer = self.send(&sd2(&[
            0xFF,
            MASTER | 0x80,
            0x46,
            points::GLOBAL_CONTROL,
            points::MASTER,
            command,
            groups,
        ]));
        assert!(answer.is_empty(), "a broadcast must not be answered");
    }

    /// Performs Data_Exchange (SD3) from this master and returns the answer.
    pub fn exchange_of(&mut self, master: u8) -> Vec<u8> {
        let body = [&[STATION, master, self.next()][..], &self.image.to_bytes()].concat();
        self.send(&sd3(&body))
    }

    /// Performs Data_Exchange. Returns the answer's function code and the input image.
    ///
    /// # Panics
    /// Panics when the answer does not belong to Data_Exchange.
    pub fn exchange(&mut self) -> (u8, InputImage) {
        let answer = self.exchange_of(MASTER);
        assert_eq!(answer[..6], [0x68, 15, 15, 0x68, MASTER, STATION], "{answer:02X?}");
        assert_eq!(answer[19..], [sum(&answer[4..19]), 0x16]);
        let Ok(inputs) = answer[7..19].try_into() else { unreachable!("twelve bytes") };
        (answer[6], InputImage::from_bytes(inputs))
    }

    /// Writes these command flags.
    pub fn set(&mut self, flags: CommandFlags) {
        self.image.flags = flags;
        self.exchange();
    }

    /// Returns the input image after one further turn.
    pub fn input(&mut self) -> InputImage {
        self.exchange();
        self.pass_us(2_000);
        self.exchange().1
    }

    /// Exchanges data every one to two milliseconds.
    pub fn pass(&mut self, ms: u32) {
        let end = self.world.now_ms() + ms;
        while self.world.now_ms() < end {
            self.pass_us(1_000);
            self.exchange();
        }
    }

    /// Lets time pass without a master.
    pub fn pass_silent(&mut self, ms: u32) {
        self.pass_us(ms * 1_000);
    }
}

/// Watchdog of the master, in units of 10 ms.
const WATCHDOG: u8 = 20;

impl Plc for Master {
    const CONFIG: Config = AT_500K;
    const TIMEOUT_MS: u32 = 10 * WATCHDOG as u32;

    fn power_up(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::new(config, gripper)
    }

    fn parts(&mut self) -> (&mut World, &mut OutputImage) {
        (&mut self.world, &mut self.image)
    }

    fn write(&mut self) {
        self.exchange();
        self.pass_silent(2);
    }

    fn read(&mut self) -> InputImage {
        self.input()
    }

    fn run(&mut self, ms: u32) {
        self.pass(ms);
    }

    fn fall_silent(&mut self, ms: u32) {
        self.pass_silent(ms);
    }

    fn resume(&mut self) {
        self.start(WATCHDOG);
        self.write();
    }
}

/// Returns the checksum of a telegram body.
#[must_use]
pub fn sum(body: &[u8]) -> u8 {
    body.iter().fold(0, |sum, byte| sum.wrapping_add(*byte))
}

/// Returns a telegram with start delimiter SD2.
#[must_use]
pub fn sd2(body: &[u8]) -> Vec<u8> {
    let len = body.len() as u8;
    [&[0x68, len, len, 0x68], body, &[sum(body), 0x16]].concat()
}

/// Returns a telegram with start delimiter SD3: eight bytes of data.
#[must_use]
pub fn sd3(body: &[u8]) -> Vec<u8> {
    [&[0xA2], body, &[sum(body), 0x16]].concat()
}

/// Returns a telegram with start delimiter SD1: no data.
#[must_use]
pub fn sd1(body: &[u8]) -> Vec<u8> {
    [&[0x10], body, &[sum(body), 0x16]].concat()
}
