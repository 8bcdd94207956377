//! A station of the bridge library and a virtual gripper in virtual time.

use wsg_bridge_fw::can::{BusOffPolicy, CanBus};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::plc::DpBuffers;
use wsg_bridge_fw::registers::{FIRST_SETTING, Record, SETTINGS};
use wsg_bridge_fw::{BoardId, BusPort, Config, ResetCause, Station};
use wsg_protocol::CommandId;
use wsg_sim::Time;

use crate::addresses::setting;
use crate::can_rig::Double;
use crate::flash_model::FlashModel;
use crate::modbus_rig::write_request;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialGripper;
use crate::wires::Wires;

/// Turns within which the bridge answers on the PLC's bus.
const TURNS_TO_ANSWER: usize = 20;

/// A bridge on its lines: a gripper on RS-232, a PLC on Modbus or CAN, wires, the service port, and flash. A turn
/// takes one millisecond.
pub struct StationRig {
    /// The bridge.
    pub station: Station<Double>,
    /// Its buffers for PROFIBUS.
    pub buffers: &'static DpBuffers,
    /// Its settings since the start.
    pub config: Config,
    /// The CAN controller.
    pub can: Double,
    /// The gripper and its line.
    pub gripper: SerialGripper,
    /// The settings flash.
    pub flash: FlashModel,
    /// The PLC's Modbus line.
    pub bus: RtuDouble,
    /// The line of the service port.
    pub service: RtuDouble,
    /// The wires from the PLC.
    pub inputs: Inputs,
    outputs: Outputs,
    /// The time in milliseconds.
    pub now_ms: u32,
}

impl StationRig {
    /// Powers up bridge and gripper for the first time.
    #[must_use]
    pub fn new(gripper: wsg_sim::Config) -> Self {
        let gripper = SerialGripper::new(gripper);
        Self::with(&Config::DEFAULT.record(), gripper, FlashModel::new(), ResetCause::PowerOn)
    }

    /// Starts a bridge with these delivered settings after a reset. All wires are low except FAST_STOP_OK.
    ///
    /// # Panics
    /// Panics when the settings are rejected.
    #[must_use]
    pub fn with(
        delivered: &Record,
        gripper: SerialGripper,
        mut flash: FlashModel,
        cause: ResetCause,
    ) -> Self {
        flash.reboot();
        let (buffers, can): (&'static DpBuffers, Double) = (Box::leak(Box::default()), Double::default());
        let mut station = Station::new(CanBus::new(can.clone(), BusOffPolicy::DEFAULT), buffers);
        let config = station.load(delivered, &flash).expect("the settings are valid");
        station.start(&config, BoardId::UNKNOWN, cause);
        Self {
            station,
            buffers,
            config,
            can,
            gripper,
            flash,
            bus: RtuDouble::default(),
            service: RtuDouble::default(),
            inputs: Inputs::FAST_STOP_OK,
            outputs: Outputs::empty(),
            now_ms: 0,
        }
    }

    /// Restarts the bridge with the settings in the flash.
    pub fn start(&mut self) {
        let gripper = std::mem::replace(&mut self.gripper, SerialGripper::new(wsg_sim::Config::default()));
        let flash = std::mem::take(&mut self.flash);
        let rig = Self::with(&Config::DEFAULT.record(), gripper, flash, ResetCause::PowerOn);
        *self = Self { now_ms: self.now_ms, ..rig };
    }

    /// Runs one millisecond of bridge and gripper.
    pub fn turn(&mut self, service: &mut dyn BusPort) {
        self.turn_alone(service);
        self.gripper.advance(Time::from_millis(self.now_ms.into()));
    }

    /// Runs one millisecond of the bridge while the gripper is off.
    pub fn turn_alone(&mut self, service: &mut dyn BusPort) {
        self.now_ms += 1;
        let Self { station, gripper, flash, bus, now_ms, inputs, .. } = self;
        self.outputs = station.turn(*now_ms, *inputs, &mut gripper.line, bus, service, flash);
    }

    /// Sends a request as the PLC and returns the answer with unit and checksum.
    ///
    /// # Panics
    /// Panics when the bridge does not answer.
    pub fn ask(&mut self, request: &[u8]) -> Vec<u8> {
        self.bus.ask(request);
        for _ in 0..TURNS_TO_ANSWER {
            self.step();
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
        words(&answer[3..answer.len() - 2])
    }

    /// Sends a PDU over the service port. Returns the data of the answer, or the exception.
    ///
    /// # Errors
    /// Fails with the exception when the bridge refuses the request.
    ///
    /// # Panics
    /// Panics when the bridge does not answer.
    pub fn serve(&mut self, request: &[u8]) -> Result<Vec<u8>, u8> {
        self.service.ask(&[&[1], request].concat());
        self.pass(5);
        let answer = self.service.answer().expect("the service port answers");
        if answer[1] & 0x80 == 0 { Ok(answer[2..answer.len() - 2].to_vec()) } else { Err(answer[2]) }
    }

    /// Reads registers over the service port with FC 3 or 4.
    ///
    /// # Panics
    /// Panics when the request is refused.
    pub fn served(&mut self, function: u8, first: u16, count: u8) -> Vec<u16> {
        let [high, low] = first.to_be_bytes();
        let answer = self.serve(&[function, high, low, 0, count]).expect("the registers exist");
        assert_eq!(answer[0], 2 * count);
        words(&answer[1..])
    }

    /// Writes a register over the service port with FC 6.
    ///
    /// # Errors
    /// Fails with the exception when the bridge refuses the value.
    pub fn set_register(&mut self, address: u16, value: u16) -> Result<(), u8> {
        let ([a1, a0], [v1, v0]) = (address.to_be_bytes(), value.to_be_bytes());
        self.serve(&[6, a1, a0, v1, v0]).map(drop)
    }

    /// Starts a motion, with bus supervision switched off.
    pub fn begin_to_move(&mut self) {
        self.write(setting("BUS_TIMEOUT"), &[0]);
        self.write(0, &[0, 0, 0, 0]);
        self.write(0, &[0x0800, 0, 0, 0]);
    }
}

impl Wires for StationRig {
    fn inputs(&mut self) -> &mut Inputs {
        &mut self.inputs
    }

    fn outputs(&self) -> Outputs {
        self.outputs
    }

    fn take_sent(&mut self) -> Vec<CommandId> {
        self.gripper.take_sent()
    }

    fn step(&mut self) {
        let mut service = std::mem::take(&mut self.service);
        self.turn(&mut service);
        self.service = service;
    }
}

/// Returns registers from their bytes.
fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
}
