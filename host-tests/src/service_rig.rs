//! The bridge library and a virtual gripper, with the service port connected to a stream.

use std::collections::VecDeque;
use std::io::{ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use bus_modbus::rtu::Character;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::plc::DpBuffers;
use wsg_bridge_fw::registers::{FIRST_SETTING, SETTINGS};
use wsg_bridge_fw::{BoardId, BusPort, Config, NoBus, ResetCause, Station};
use wsg_sim::Time;

use crate::addresses::setting;
use crate::can_rig::Double;
use crate::flash_model::FlashModel;
use crate::modbus_rig::write_request;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialGripper;

/// Turns within which the bridge answers on the PLC's bus.
const TURNS_TO_ANSWER: usize = 20;

/// The service port's end of a line to a master.
#[derive(Debug)]
pub struct ServiceLine {
    stream: UnixStream,
    waiting: VecDeque<Character>,
}

impl ServiceLine {
    /// Creates a line and returns both ends; the second is the master's.
    ///
    /// # Panics
    /// Panics when no socket can be created.
    #[must_use]
    pub fn new() -> (Self, UnixStream) {
        let (near, far) = UnixStream::pair().expect("a socket pair can be created");
        near.set_read_timeout(Some(Duration::from_millis(1))).expect("the time-out is not zero");
        (Self { stream: near, waiting: VecDeque::new() }, far)
    }

    /// Reads until no byte has arrived for a millisecond, so that a request is complete.
    ///
    /// # Panics
    /// Panics when the line fails.
    pub fn read(&mut self) {
        let mut bytes = [0; 256];
        loop {
            match uninterrupted::read(&mut self.stream, &mut bytes) {
                Ok(0) => return,
                Ok(len) => self.waiting.extend(bytes.iter().take(len).copied().map(Character::Byte)),
                Err(error) => {
                    assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}");
                    return;
                }
            }
        }
    }

    /// Discards received bytes.
    pub fn clear(&mut self) {
        self.waiting.clear();
    }
}

impl BusPort for ServiceLine {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front().map(|character| (character, 0))
    }

    fn silence_us(&mut self) -> u32 {
        100_000
    }

    fn send(&mut self, frame: &[u8]) {
        self.stream.write_all(frame).expect("the master's end is open");
    }
}

/// A bridge with a gripper on RS-232, flash and a Modbus bus. Time advances by one millisecond per turn.
pub struct ServiceRig {
    /// The bridge.
    pub station: Station<Double>,
    /// The gripper and its line.
    pub gripper: SerialGripper,
    /// The settings flash.
    pub flash: FlashModel,
    bus: RtuDouble,
    now_ms: u32,
}

impl ServiceRig {
    /// Powers up bridge and gripper for the first time.
    #[must_use]
    pub fn new(gripper: wsg_sim::Config) -> Self {
        let mut rig = Self {
            station: station(),
            gripper: SerialGripper::new(gripper),
            flash: FlashModel::new(),
            bus: RtuDouble::default(),
            now_ms: 0,
        };
        rig.start();
        rig
    }

    /// Powers up the bridge with the settings in the flash.
    ///
    /// # Panics
    /// Panics when the stored settings are rejected.
    pub fn start(&mut self) {
        self.station = station();
        let config =
            self.station.load(&Config::DEFAULT.record(), &self.flash).expect("the stored settings are valid");
        self.station.start(&config, BoardId::UNKNOWN, ResetCause::PowerOn);
    }

    /// Runs one millisecond of bridge and gripper.
    pub fn turn(&mut self, service: &mut dyn BusPort) {
        self.turn_alone(service);
        self.gripper.advance(Time::from_millis(self.now_ms.into()));
    }

    /// Runs one millisecond of the bridge while the gripper is off.
    pub fn turn_alone(&mut self, service: &mut dyn BusPort) {
        self.now_ms += 1;
        let Self { station, gripper, flash, bus, now_ms } = self;
        station.turn(*now_ms, Inputs::FAST_STOP_OK, &mut gripper.line, bus, service, flash);
    }

    /// Sends a request as the PLC and returns the answer with unit and checksum.
    ///
    /// # Panics
    /// Panics when the bridge does not answer.
    pub fn ask(&mut self, request: &[u8]) -> Vec<u8> {
        self.bus.ask(request);
        for _ in 0..TURNS_TO_ANSWER {
            self.turn(&mut NoBus);
            if let Some(answer) = self.bus.answer() {
                return answer;
            }
        }
        panic!("no answer to {request:?}");
    }

    /// Writes registers from the PLC's bus (FC 16).
    ///
    /// # Panics
    /// Panics when the write is rejected.
    pub fn write(&mut self, first: u16, values: &[u16]) {
        assert_eq!(self.ask(&write_request(first, values))[1], 16);
    }

    /// Reads all settings as a PLC does.
    pub fn settings(&mut self) -> Vec<u16> {
        let answer = self.ask(&[1, 3, 0, FIRST_SETTING as u8, 0, SETTINGS.len() as u8]);
        let values = answer[3..].chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
        values.take(SETTINGS.len()).collect()
    }

    /// Starts a motion, with bus supervision switched off.
    pub fn begin_to_move(&mut self) {
        self.write(setting("BUS_TIMEOUT"), &[0]);
        self.write(0, &[0, 0, 0, 0]);
        self.write(0, &[0x0800, 0, 0, 0]);
    }
}

fn station() -> Station<Double> {
    let buffers: &'static DpBuffers = Box::leak(Box::default());
    Station::new(CanBus::new(Double::default(), BusOffPolicy::DEFAULT), buffers)
}
