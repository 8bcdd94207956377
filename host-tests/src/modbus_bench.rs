//! Bridge and virtual gripper in virtual time, with a Modbus master on the bus, another on the service port, and wires that a
//! test plays.

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, Config};

use crate::rtu_double::{RtuDouble, sealed};
use crate::serial_gripper::{SerialGripper, SerialLine};
use crate::wires::Wires;
use crate::world::{Bus, World};

/// The bridge's unit as delivered.
pub const UNIT: u8 = 1;

/// The bridge's two servers, and their lines.
#[derive(Clone, Debug)]
pub struct ModbusLines {
    modbus: Modbus,
    service: Modbus,
    /// The line that the master is on: the bus, but inside [`Bench::by_service`].
    line: RtuDouble,
    /// The other one.
    other: RtuDouble,
    is_by_service: bool,
    /// What the master writes every 20 ms to registers 0 to 3, CMDFLAGS to FORCELIMIT.
    repeats: Option<[u16; 4]>,
}

impl ModbusLines {
    /// Both, and lines on which nobody has asked yet.
    pub(crate) fn new(config: &Config) -> Self {
        Self {
            modbus: Modbus::new(config),
            service: Modbus::service(),
            line: RtuDouble::default(),
            other: RtuDouble::default(),
            is_by_service: false,
            repeats: None,
        }
    }

    fn change_line(&mut self) {
        std::mem::swap(&mut self.line, &mut self.other);
        self.is_by_service = !self.is_by_service;
    }

    /// Writes this image at once, and again and again from now on; or does so no more.
    pub(crate) fn repeat(&mut self, image: Option<[u16; 4]>) {
        self.repeats = image;
        self.write();
    }

    fn write(&mut self) {
        if let Some(image) = self.repeats {
            self.line.put(&sealed(&write_request(0, &image)));
        }
    }
}

impl Bus for ModbusLines {
    fn turn(&mut self, bridge: &mut Bridge, now_ms: u32, inputs: Inputs, line: &mut SerialLine) -> Outputs {
        self.line.pass_ms();
        self.other.pass_ms();
        if now_ms.is_multiple_of(20) {
            self.write();
        }
        let Self { modbus, service, line: bus, other: port, is_by_service, .. } = self;
        let (bus, port) = if *is_by_service { (port, bus) } else { (bus, port) };
        let outputs = bridge.poll(now_ms, inputs, line, &mut modbus.over(bus));
        bridge.serve(now_ms, &mut service.over(port));
        outputs
    }
}

/// A [`World`] whose PLC is on Modbus.
pub type Bench = World<ModbusLines>;

/// FC 16 with its unit, without its checksum.
pub(crate) fn write_request(first: u16, values: &[u16]) -> Vec<u8> {
    let ([a1, a0], count) = (first.to_be_bytes(), values.len() as u8);
    let head = [UNIT, 16, a1, a0, 0, count, 2 * count];
    head.into_iter().chain(values.iter().flat_map(|value| value.to_be_bytes())).collect()
}

impl Bench {
    /// A bench whose wires are low, but the one of FAST STOP.
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::with(config, ModbusLines::new(&config), SerialGripper::new(gripper), Inputs::FAST_STOP_OK)
    }

    /// A bench whose gripper answers, with a bus that has written zeros.
    pub fn ready() -> Self {
        Self::ready_with(Config::DEFAULT, quick())
    }

    /// As [`ready`](Self::ready), with these settings of bridge and gripper.
    pub fn ready_with(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut bench = Self::new(config, gripper);
        bench.pass(200);
        bench.write(0, &[0, 0, 0, 0]);
        bench
    }

    /// A bench whose fingers are referenced, by the bus.
    pub fn homed(gripper: wsg_sim::Config) -> Self {
        let mut bench = Self::ready_with(Config::DEFAULT, gripper);
        bench.command(HOMING, 0, 0, 0);
        assert_eq!(bench.state(), IDLE);
        assert!(bench.bit(16), "REFERENCED");
        bench
    }

    /// Lets a test do over the service port what it would do over the bus.
    pub fn by_service<T>(&mut self, test: impl FnOnce(&mut Self) -> T) -> T {
        self.bus.change_line();
        let result = test(self);
        self.bus.change_line();
        result
    }

    /// Serves the service port so often without a turn of the bridge.
    pub fn serve_alone(&mut self, times: u32) {
        let Self { bridge, bus, now_ms, .. } = self;
        let port = if bus.is_by_service { &mut bus.line } else { &mut bus.other };
        (0..times).for_each(|_| bridge.serve(*now_ms, &mut bus.service.over(port)));
    }

    /// Puts bytes on the bus, one right behind the other.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.bus.line.put(bytes);
    }

    /// Puts bytes on the bus that come so long after those before, in microseconds.
    pub fn send_after(&mut self, pause_us: u32, bytes: &[u8]) {
        self.bus.line.silence_us = pause_us;
        self.send_raw(bytes);
    }

    /// A request's frame, checksum included.
    pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        sealed(&[&[unit], pdu].concat())
    }

    /// Sends a request, and waits for what the bridge answers in 20 ms: the PDU, checked.
    pub fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        // Half a frame can have a right checksum by chance, and is answered by an exception.
        self.answers();
        self.send_raw(&Self::frame(UNIT, pdu));
        for _ in 0..20 {
            self.step();
            if let Some(answer) = self.bus.line.answer() {
                assert_eq!(self.answers(), 0);
                let (body, _) = answer.split_at(answer.len() - 2);
                assert_eq!(sealed(body), answer);
                assert_eq!(body[0], UNIT);
                return body[1..].to_vec();
            }
        }
        vec![]
    }

    /// Takes the answers that came since this was last asked; how many.
    pub fn answers(&mut self) -> usize {
        self.bus.line.take_events().len()
    }

    /// FC 16.
    pub fn write(&mut self, first: u16, values: &[u16]) {
        assert_eq!(self.try_write(first, values), None);
    }

    /// FC 16; the exception.
    pub fn try_write(&mut self, first: u16, values: &[u16]) -> Option<u8> {
        let request = write_request(first, values);
        let answer = self.ask(&request[1..]);
        if answer == request[1..6] {
            return None;
        }
        assert_eq!((answer.len(), answer[0]), (2, 0x90));
        Some(answer[1])
    }

    /// FC 3 or 4.
    fn registers(&mut self, function: u8, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        let [a1, a0] = first.to_be_bytes();
        let answer = self.ask(&[function, a1, a0, 0, count]);
        if answer[0] == function | 0x80 {
            return Err(answer[1]);
        }
        assert_eq!(answer[..2], [function, 2 * count]);
        Ok(answer[2..].chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect())
    }

    /// Reads holding registers; an exception code when they are refused.
    pub fn holding(&mut self, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        self.registers(3, first, count)
    }

    /// Reads input registers; an exception code when they are refused.
    pub fn input(&mut self, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        self.registers(4, first, count)
    }

    /// GSTATE.
    pub fn state(&mut self) -> u8 {
        (self.input(0, 1).unwrap()[0] >> 8) as u8
    }

    /// The status register.
    pub fn status(&mut self) -> u16 {
        self.input(5, 1).unwrap()[0]
    }

    /// A discrete input.
    pub fn bit(&mut self, address: u16) -> bool {
        let [a1, a0] = address.to_be_bytes();
        self.ask(&[2, a1, a0, 0, 1]) == [2, 1, 1]
    }

    /// Gives a command as a PLC does: parameters and flag in one write, wait for the status, flag back, wait for the
    /// end.
    pub fn command(&mut self, flags: u8, width: u16, speed: u16, force: u16) {
        self.write(0, &[u16::from(flags) << 8, width, speed, force]);
        self.write(0, &[0, width, speed, force]);
        for _ in 0..20_000 {
            if self.status() != PENDING {
                return;
            }
            self.pass(10);
        }
        panic!("the command does not end");
    }
}

/// A gripper whose fingers travel ten times as fast.
pub fn quick() -> wsg_sim::Config {
    wsg_sim::Config { time_scale: 10.0, ..wsg_sim::Config::default() }
}

macro_rules! named {
    ($what:literal: $($name:ident: $type:ty = $value:expr;)*) => {
        $(#[doc = concat!($what, ": ", stringify!($name), ".")]
        pub const $name: $type = $value;)*
    };
}

named! { "CMDFLAGS, byte 0":
    MOVE: u8 = 1 << 0;
    GRIP: u8 = 1 << 1;
    RELEASE: u8 = 1 << 2;
    HOMING: u8 = 1 << 3;
    STOP_ACK: u8 = 1 << 4;
    FASTSTOP: u8 = 1 << 5;
    JOG_PLUS: u8 = 1 << 6;
    JOG_MINUS: u8 = 1 << 7;
}

named! { "GSTATE, byte 0":
    IDLE: u8 = 1 << 0;
    NO_PART: u8 = 1 << 2;
    PART_LOST: u8 = 1 << 3;
    HOLDING: u8 = 1 << 4;
    RELEASING: u8 = 1 << 5;
}

named! { "Status code":
    SUCCESS: u16 = 0;
    ALREADY_RUNNING: u16 = 4;
    PENDING: u16 = 26;
}
