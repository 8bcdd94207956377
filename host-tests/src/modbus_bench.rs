//! Bridge and virtual gripper in virtual time, with a Modbus master on the bus, another on the service port, and wires that a
//! test plays.

use std::collections::VecDeque;

use crate::serial_gripper::SerialGripper;
use crate::wires::Wires;
use bus_modbus::rtu::{Character, crc};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::Modbus;
use wsg_bridge_fw::{Bridge, BusPort, Config};
use wsg_protocol::CommandId;
use wsg_sim::{Time, VirtualGripper};

/// The bridge's unit as delivered.
pub const UNIT: u8 = 1;

/// The bus.
#[derive(Default)]
struct Bus {
    waiting: VecDeque<(Character, u32)>,
    silence_us: u32,
    answers: Vec<Vec<u8>>,
}

impl BusPort for Bus {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front()
    }

    fn silence_us(&mut self) -> u32 {
        self.silence_us
    }

    fn send(&mut self, frame: &[u8]) {
        self.answers.push(frame.to_vec());
    }
}

/// Everything on the bench.
pub struct Bench {
    bridge: Bridge,
    modbus: Modbus,
    service: Modbus,
    /// The line that is not the master's now: the service port, but inside [`Bench::by_service`].
    other: Bus,
    is_by_service: bool,
    /// The gripper and its line.
    far: SerialGripper,
    bus: Bus,
    now_ms: u32,
    inputs: Inputs,
    outputs: Outputs,
}

impl Bench {
    /// A bench whose wires are low, but the one of FAST STOP.
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        Self {
            bridge: Bridge::new(config),
            modbus: Modbus::new(&config),
            service: Modbus::service(),
            other: Bus { silence_us: 1_000_000, ..Bus::default() },
            is_by_service: false,
            far: SerialGripper::new(gripper),
            bus: Bus { silence_us: 1_000_000, ..Bus::default() },
            now_ms: 0,
            inputs: Inputs::FAST_STOP_OK,
            outputs: Outputs::empty(),
        }
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

    /// The moment, on the gripper's clock.
    pub fn now(&self) -> Time {
        Time::from_millis(self.now_ms.into())
    }

    /// The bridge.
    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// The bridge, to tell it what its board knows.
    pub fn bridge_mut(&mut self) -> &mut Bridge {
        &mut self.bridge
    }

    /// The gripper.
    pub fn gripper(&mut self) -> &mut VirtualGripper<1> {
        &mut self.far.gripper
    }

    /// Switches the gripper off and on again: it has forgotten everything.
    pub fn restart_gripper(&mut self, config: wsg_sim::Config) {
        self.far.restart(config, self.now());
    }

    /// Lets a test do over the service port what it would do over the bus.
    pub fn by_service<T>(&mut self, test: impl FnOnce(&mut Self) -> T) -> T {
        self.change_line();
        let result = test(self);
        self.change_line();
        result
    }

    fn change_line(&mut self) {
        std::mem::swap(&mut self.bus, &mut self.other);
        self.is_by_service = !self.is_by_service;
    }

    /// Serves the service port so often without a turn of the bridge.
    pub fn serve_alone(&mut self, times: u32) {
        let Self { bridge, service, bus, other, now_ms, is_by_service, .. } = self;
        let port = if *is_by_service { bus } else { other };
        (0..times).for_each(|_| bridge.serve(*now_ms, &mut service.over(port)));
    }

    /// Cuts the line from gripper to bridge, or mends it.
    pub fn set_cut(&mut self, cut: bool) {
        self.far.to_bridge = if cut { Some(Box::new(Vec::clear)) } else { None };
    }

    /// Puts bytes on the bus, one right behind the other.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.bus.waiting.push_back((Character::Byte(*byte), std::mem::take(&mut self.bus.silence_us)));
        }
    }

    /// Puts bytes on the bus that come so long after those before, in microseconds.
    pub fn send_after(&mut self, pause_us: u32, bytes: &[u8]) {
        self.bus.silence_us = pause_us;
        self.send_raw(bytes);
    }

    /// A request's frame, checksum included.
    pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        let mut frame = [&[unit], pdu].concat();
        frame.extend(crc(&frame).to_le_bytes());
        frame
    }

    /// Sends a request, and waits for what the bridge answers in 20 ms: the PDU, checked.
    pub fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        // Half a frame can have a right checksum by chance, and is answered by an exception.
        self.bus.answers.clear();
        self.send_raw(&Self::frame(UNIT, pdu));
        for _ in 0..20 {
            self.step();
            if let Some(answer) = self.bus.answers.pop() {
                assert_eq!(self.bus.answers.len(), 0);
                let (body, sum) = answer.split_at(answer.len() - 2);
                assert_eq!(crc(body).to_le_bytes(), sum);
                assert_eq!(body[0], UNIT);
                return body[1..].to_vec();
            }
        }
        vec![]
    }

    /// Takes the answers that came since this was last asked; how many.
    pub fn answers(&mut self) -> usize {
        std::mem::take(&mut self.bus.answers).len()
    }

    /// FC 16.
    pub fn write(&mut self, first: u16, values: &[u16]) {
        assert_eq!(self.try_write(first, values), None);
    }

    /// FC 16; the exception.
    pub fn try_write(&mut self, first: u16, values: &[u16]) -> Option<u8> {
        let [a1, a0] = first.to_be_bytes();
        let count = values.len() as u8;
        let mut pdu = vec![16, a1, a0, 0, count, 2 * count];
        pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        let answer = self.ask(&pdu);
        if answer == [16, a1, a0, 0, count] {
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

impl Wires for Bench {
    fn inputs(&mut self) -> &mut Inputs {
        &mut self.inputs
    }

    fn outputs(&self) -> Outputs {
        self.outputs
    }

    fn take_sent(&mut self) -> Vec<CommandId> {
        self.far.take_sent()
    }

    fn step(&mut self) {
        self.now_ms += 1;
        for line in [&mut self.bus, &mut self.other] {
            line.silence_us = line.silence_us.saturating_add(1_000);
        }
        let Self { bridge, modbus, service, far, bus, other, is_by_service, inputs, now_ms, .. } = self;
        let (bus, port) = if *is_by_service { (other, bus) } else { (bus, other) };
        self.outputs = bridge.poll(*now_ms, *inputs, &mut far.line, &mut modbus.over(bus));
        bridge.serve(*now_ms, &mut service.over(port));
        self.far.advance(self.now());
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
