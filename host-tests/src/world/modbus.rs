//! A Modbus master on the PLC's bus, and on the service port.

use std::ops::{Deref, DerefMut};

use wsg_bridge_fw::Config;
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{InputImage, OutputImage};

use super::plc::Plc;
use super::{World, quick};
use crate::rtu_double::RtuDouble;
pub use crate::rtu_double::sealed;

/// The bridge's default unit address.
pub const UNIT: u8 = 1;

/// Returns an FC 16 request with unit address, without checksum.
pub(crate) fn write_request(first: u16, values: &[u16]) -> Vec<u8> {
    let ([a1, a0], count) = (first.to_be_bytes(), values.len() as u8);
    let head = [UNIT, 16, a1, a0, 0, count, 2 * count];
    head.into_iter().chain(values.iter().flat_map(|value| value.to_be_bytes())).collect()
}

/// Returns the registers of an output image, from CMDFLAGS to FORCELIMIT.
pub(crate) fn registers_of(image: &OutputImage) -> [u16; 4] {
    let bytes = image.to_bytes();
    std::array::from_fn(|n| u16::from_be_bytes([bytes[2 * n], bytes[2 * n + 1]]))
}

/// A master, and the [`World`] that it is connected to.
pub struct Master {
    world: World,
    /// The output image of [`Plc`].
    image: OutputImage,
    /// Whether the master is at the service port: inside [`by_service`](Self::by_service).
    is_by_service: bool,
}

impl Deref for Master {
    type Target = World;

    fn deref(&self) -> &World {
        &self.world
    }
}

impl DerefMut for Master {
    fn deref_mut(&mut self) -> &mut World {
        &mut self.world
    }
}

impl Master {
    /// Creates a master on the bus, with all wires low except FAST_STOP_OK.
    pub fn new(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::of(World::new(config, gripper))
    }

    /// Connects a master to a bridge, and raises FAST_STOP_OK.
    pub fn of(mut world: World) -> Self {
        world.set(Inputs::FAST_STOP_OK, true);
        Self { world, image: OutputImage::ZERO, is_by_service: false }
    }

    /// Creates a master that has written zeros, and a responding gripper.
    pub fn ready() -> Self {
        Self::ready_with(Config::DEFAULT, quick())
    }

    /// Does the same as [`ready`](Self::ready), with these settings of bridge and gripper.
    pub fn ready_with(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut master = Self::new(config, gripper);
        master.pass(200);
        master.write(0, &[0, 0, 0, 0]);
        master
    }

    /// Creates a master that has referenced the fingers.
    pub fn homed(gripper: wsg_sim::Config) -> Self {
        let mut master = Self::ready_with(Config::DEFAULT, gripper);
        master.command(HOMING, 0, 0, 0);
        assert_eq!(master.state(), IDLE);
        assert!(master.bit(16), "REFERENCED");
        master
    }

    /// Disconnects the master.
    pub fn into_world(self) -> World {
        self.world
    }

    /// Runs `test` over the service port instead of the bus.
    pub fn by_service<T>(&mut self, test: impl FnOnce(&mut Self) -> T) -> T {
        let before = std::mem::replace(&mut self.is_by_service, true);
        let result = test(self);
        self.is_by_service = before;
        result
    }

    fn line(&mut self) -> &mut RtuDouble {
        if self.is_by_service { &mut self.world.service } else { &mut self.world.modbus }
    }

    /// Puts bytes on the bus back to back.
    pub fn send_raw(&mut self, bytes: &[u8]) {
        self.line().put(bytes);
    }

    /// Puts bytes on the bus after a pause in microseconds.
    pub fn send_after(&mut self, pause_us: u32, bytes: &[u8]) {
        self.line().silence_us = pause_us;
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
            if let Some(answer) = self.line().answer() {
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
        self.line().take_events().len()
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

    /// Sends a request and returns the rest of the answer's PDU; fails with the exception code.
    pub fn data(&mut self, pdu: &[u8]) -> Result<Vec<u8>, u8> {
        let answer = self.ask(pdu);
        let (function, data) = answer.split_first().expect("an answer");
        if *function == pdu[0] { Ok(data.to_vec()) } else { Err(data[0]) }
    }

    /// Writes a register (FC 6); fails with the exception code.
    pub fn set_register(&mut self, address: u16, value: u16) -> Result<(), u8> {
        let ([a1, a0], [v1, v0]) = (address.to_be_bytes(), value.to_be_bytes());
        self.data(&[6, a1, a0, v1, v0]).map(drop)
    }

    /// Reads registers with FC 3 or 4; fails with the exception code.
    pub fn registers(&mut self, function: u8, first: u16, count: u8) -> Result<Vec<u16>, u8> {
        let [a1, a0] = first.to_be_bytes();
        let data = self.data(&[function, a1, a0, 0, count])?;
        assert_eq!(data[0], 2 * count);
        Ok(data[1..].chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect())
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

impl Plc for Master {
    const CONFIG: Config = Config::DEFAULT;
    const TIMEOUT_MS: u32 = Config::DEFAULT.bus.timeout_ms as u32;

    fn power_up(config: Config, gripper: wsg_sim::Config) -> Self {
        Self::new(config, gripper)
    }

    fn parts(&mut self) -> (&mut World, &mut OutputImage) {
        (&mut self.world, &mut self.image)
    }

    fn write(&mut self) {
        self.write(0, &registers_of(&self.image));
    }

    fn read(&mut self) -> InputImage {
        let data = self.data(&[4, 0, 0, 0, 6]).expect("the gripper is connected");
        InputImage::from_bytes(data[1..].try_into().expect("six registers"))
    }

    /// An exception (docs/registers.md) instead of an image.
    fn misses_the_gripper(&mut self) -> bool {
        self.data(&[4, 0, 0, 0, 6]) == Err(0x0B)
    }

    fn run(&mut self, ms: u32) {
        let end = self.now_ms() + ms;
        while self.now_ms() < end {
            self.ask(&[4, 0, 0, 0, 6]);
            self.step();
        }
    }

    fn fall_silent(&mut self, ms: u32) {
        self.pass(ms);
    }

    fn resume(&mut self) {
        Plc::write(self);
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
