//! Bridge and virtual gripper in virtual time, with Modbus masters on the bus and on the service port, and wires
//! driven by the test.

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, Config};

use crate::rtu_double::{RtuDouble, sealed};
use crate::serial_gripper::{SerialGripper, SerialLine};
use crate::wires::Wires;
pub use crate::wires::{quick, with_part};
use crate::world::{Bus, World};

/// The bridge's default unit address.
pub const UNIT: u8 = 1;

/// The bridge's two Modbus servers and their lines.
#[derive(Clone, Debug)]
pub struct ModbusLines {
    modbus: Modbus,
    service: Modbus,
    /// The master's current line: the bus, except inside [`TestRig::by_service`].
    line: RtuDouble,
    other: RtuDouble,
    is_by_service: bool,
    /// Image that the master writes every 20 ms to registers 0 to 3 (CMDFLAGS to FORCELIMIT).
    repeats: Option<[u16; 4]>,
}

impl ModbusLines {
    /// Creates both servers on idle lines.
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

    /// Writes this image now and every 20 ms, or stops doing so.
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

/// A [`World`] with a Modbus PLC.
pub type TestRig = World<ModbusLines>;

/// Returns an FC 16 request with unit address, without checksum.
pub(crate) fn write_request(first: u16, values: &[u16]) -> Vec<u8> {
    let ([a1, a0], count) = (first.to_be_bytes(), values.len() as u8);
    let head = [UNIT, 16, a1, a0, 0, count, 2 * count];
    head.into_iter().chain(values.iter().flat_map(|value| value.to_be_bytes())).collect()
}

impl TestRig {
    /// Creates a rig with all wires low except FAST_STOP_OK.
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::with(config, ModbusLines::new(&config), SerialGripper::new(gripper), Inputs::FAST_STOP_OK)
    }

    /// Creates a rig with a responding gripper and a master that has written zeros.
    pub fn ready() -> Self {
        Self::ready_with(Config::DEFAULT, quick())
    }

    /// Does the same as [`ready`](Self::ready), with these settings of bridge and gripper.
    pub fn ready_with(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut rig = Self::new(config, gripper);
        rig.pass(200);
        rig.write(0, &[0, 0, 0, 0]);
        rig
    }

    /// Creates a rig whose fingers were referenced over the bus.
    pub fn homed(gripper: wsg_sim::Config) -> Self {
        let mut rig = Self::ready_with(Config::DEFAULT, gripper);
        rig.command(HOMING, 0, 0, 0);
        assert_eq!(rig.state(), IDLE);
        assert!(rig.bit(16), "REFERENCED");
        rig
    }

    /// Runs `test` over the service port instead of the bus.
    pub fn by_service<T>(&mut self, test: impl FnOnce(&mut Self) -> T) -> T {
        self.bus.change_line();
        let result = test(self);
        self.bus.change_line();
        result
    }

    /// Serves the service port `times` times without a turn of the bridge.
    pub fn serve_alone(&mut self, times: u32) {
        let Self { bridge, bus, now_ms, .. } = self;
        let port = if bus.is_by_service { &mut bus.line } else { &mut bus.other };
        (0..times).for_each(|_| bridge.serve(*now_ms, &mut bus.service.over(port)));
    }

    /// Puts bytes on the bus back to back.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.bus.line.put(bytes);
    }

    /// Puts bytes on the bus after a pause in microseconds.
    pub fn send_after(&mut self, pause_us: u32, bytes: &[u8]) {
        self.bus.line.silence_us = pause_us;
        self.send_raw(bytes);
    }

    /// Returns a request frame including its checksum.
    pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        sealed(&[&[unit], pdu].concat())
    }

    /// Sends a request and waits up to 20 ms. Returns the checked PDU of the answer; empty without one.
    pub fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        // Discards pending answers: a truncated frame can have a valid checksum by chance and raises an exception.
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

    /// Discards the answers received since the last call. Returns their number.
    pub fn answers(&mut self) -> usize {
        self.bus.line.take_events().len()
    }

    /// Writes registers (FC 16).
    pub fn write(&mut self, first: u16, values: &[u16]) {
        assert_eq!(self.try_write(first, values), None);
    }

    /// Writes registers (FC 16). Returns the exception code, if any.
    pub fn try_write(&mut self, first: u16, values: &[u16]) -> Option<u8> {
        let request = write_request(first, values);
        let answer = self.ask(&request[1..]);
        if answer == request[1..6] {
            return None;
        }
        assert_eq!((answer.len(), answer[0]), (2, 0x90));
        Some(answer[1])
    }

    /// Reads registers with FC 3 or 4.
    fn registers(&mut self, function: u8, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        let [a1, a0] = first.to_be_bytes();
        let answer = self.ask(&[function, a1, a0, 0, count]);
        if answer[0] == function | 0x80 {
            return Err(answer[1]);
        }
        assert_eq!(answer[..2], [function, 2 * count]);
        Ok(answer[2..].chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect())
    }

    /// Reads holding registers; fails with the exception code.
    pub fn holding(&mut self, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        self.registers(3, first, count)
    }

    /// Reads input registers; fails with the exception code.
    pub fn input(&mut self, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        self.registers(4, first, count)
    }

    /// Reads GSTATE.
    pub fn state(&mut self) -> u8 {
        (self.input(0, 1).unwrap()[0] >> 8) as u8
    }

    /// Reads the status register.
    pub fn status(&mut self) -> u16 {
        self.input(5, 1).unwrap()[0]
    }

    /// Reads a discrete input.
    pub fn bit(&mut self, address: u16) -> bool {
        let [a1, a0] = address.to_be_bytes();
        self.ask(&[2, a1, a0, 0, 1]) == [2, 1, 1]
    }

    /// Executes a command as a PLC does: writes parameters and flag together, clears the flag, and waits until the
    /// status is no longer PENDING.
    pub fn command(&mut self, flags: u8, width: u16, speed: u16, force: u16) {
        self.write(0, &[u16::from(flags) << 8, width, speed, force]);
        self.write(0, &[0, width, speed, force]);
        for _ in 0..20_000 {
            if self.status() != PENDING {
                return;
            }
            self.pass(10);
        }
        panic!("the command does not complete");
    }
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
