//! The bridge library and a virtual gripper, with the service port at the end of a stream.

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
use crate::can_bench::Double;
use crate::flash_model::FlashModel;
use crate::modbus_bench::write_request;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialGripper;

/// Turns within which the bridge answers on the PLC's bus.
const TURNS_TO_ANSWER: usize = 20;

/// The service port's end of a line, whose master is at the other.
#[derive(Debug)]
pub struct ServiceLine {
    stream: UnixStream,
    waiting: VecDeque<Character>,
}

impl ServiceLine {
    /// Both ends; the second one is the master's.
    ///
    /// # Panics
    /// There is no socket to be had.
    #[must_use]
    pub fn new() -> (Self, UnixStream) {
        let (near, far) = UnixStream::pair().expect("there are sockets");
        near.set_read_timeout(Some(Duration::from_millis(1))).expect("a millisecond is not zero");
        (Self { stream: near, waiting: VecDeque::new() }, far)
    }

    /// Takes what comes until nothing has for a millisecond: then a request is there as a whole.
    ///
    /// # Panics
    /// The line is broken.
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

    /// Forgets what has come.
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

/// A bridge with a gripper on RS-232, flash and a Modbus bus. It knows no time but its turns, of a millisecond each.
pub struct ServiceBench {
    /// The bridge.
    pub station: Station<Double>,
    /// What is on its line.
    pub gripper: SerialGripper,
    /// Where its settings stay.
    pub flash: FlashModel,
    bus: RtuDouble,
    now_ms: u32,
}

impl ServiceBench {
    /// Both have power, for the first time.
    #[must_use]
    pub fn new(gripper: wsg_sim::Config) -> Self {
        let mut bench = Self {
            station: station(),
            gripper: SerialGripper::new(gripper),
            flash: FlashModel::new(),
            bus: RtuDouble::default(),
            now_ms: 0,
        };
        bench.start();
        bench
    }

    /// The bridge's power comes on, with what the flash has.
    ///
    /// # Panics
    /// Those settings are refused.
    pub fn start(&mut self) {
        self.station = station();
        let config =
            self.station.load(&Config::DEFAULT.record(), &self.flash).expect("these settings are right");
        self.station.start(&config, BoardId::UNKNOWN, ResetCause::PowerOn);
    }

    /// The bridge's millisecond, and the gripper's.
    pub fn turn(&mut self, service: &mut dyn BusPort) {
        self.turn_alone(service);
        self.gripper.advance(Time::from_millis(self.now_ms.into()));
    }

    /// The bridge's millisecond while the gripper has no power.
    pub fn turn_alone(&mut self, service: &mut dyn BusPort) {
        self.now_ms += 1;
        let Self { station, gripper, flash, bus, now_ms } = self;
        station.turn(*now_ms, Inputs::FAST_STOP_OK, &mut gripper.line, bus, service, flash);
    }

    /// Asks as the PLC does; the answer with unit and checksum.
    ///
    /// # Panics
    /// There is none.
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

    /// FC 16 on the PLC's bus.
    ///
    /// # Panics
    /// It is refused.
    pub fn write(&mut self, first: u16, values: &[u16]) {
        assert_eq!(self.ask(&write_request(first, values))[1], 16);
    }

    /// All settings, as the PLC reads them.
    pub fn settings(&mut self) -> Vec<u16> {
        let answer = self.ask(&[1, 3, 0, FIRST_SETTING as u8, 0, SETTINGS.len() as u8]);
        let values = answer[3..].chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
        values.take(SETTINGS.len()).collect()
    }

    /// The fingers travel, and no PLC is missed.
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
