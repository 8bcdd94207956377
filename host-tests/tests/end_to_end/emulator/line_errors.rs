//! The released image on lines with errors: no motion without a command, counted errors, and a correct LINK_OK.

use std::time::{Duration, Instant};

use host_tests::emulator::{Extras, Line};
use host_tests::line_errors::{LineError, LineErrors};
use host_tests::modbus_master::Master;
use host_tests::rig::{PATIENCE, Rig, motions};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;
use wsg_sim::Config;

use super::{Board, RELEASED};

const UNIT: u8 = 1;

/// FC 16 over the output image: HOMING without parameters.
const HOMING: [u8; 14] = [16, 0, 0, 0, 4, 8, 1 << 3, 0, 0, 0, 0, 0, 0, 0];
const NOTHING: [u8; 14] = [16, 0, 0, 0, 4, 8, 0, 0, 0, 0, 0, 0, 0, 0];
const STOP_ACK: [u8; 14] = [16, 0, 0, 0, 4, 8, 1 << 4, 0, 0, 0, 0, 0, 0, 0];

struct Plant {
    /// Models for a board in QEMU: the gripper's line and the bus.
    models: Option<[LineErrors; 2]>,
    rig: Rig,
    master: Master,
}

impl Plant {
    /// Starts a board and waits for READY.
    fn start(kind: Board) -> Self {
        let models = kind.1.map(|board| [board.gripper_uart, board.bus_uart].map(LineErrors::on));
        let served = models.iter().flatten().map(|line| Box::new(line.clone()) as _).collect();
        let extras = Extras { models: served, ..Extras::default() };
        let mut rig = kind.rig(RELEASED, extras, Config { time_scale: 10.0, ..Config::default() });
        rig.set(Inputs::FAST_STOP_OK, true).unwrap();
        let master = rig.master(UNIT).unwrap();
        let mut plant = Self { models, rig, master };
        plant.master.allow_pauses().unwrap();
        plant.acknowledge();
        plant
    }

    fn set(&self, line: Line, error: Option<(LineError, u32)>) {
        let Some([gripper, bus]) = &self.models else {
            return self.rig.board().set_line_error(line, error).unwrap();
        };
        match line {
            Line::Gripper => gripper.set(error),
            Line::Bus => bus.set(error),
        }
    }

    /// Returns the errors that the board's UART reports. A PL011 does not report noise.
    fn reported(&self) -> &'static [LineError] {
        const ALL: [LineError; 4] =
            [LineError::Parity, LineError::Framing, LineError::Overrun, LineError::Noise];
        if self.models.is_none() { &ALL[..3] } else { &ALL }
    }

    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.master.ask(pdu).unwrap()
    }

    fn report(&mut self, name: &str) -> u16 {
        self.master.report(name).unwrap()
    }

    fn acknowledge(&mut self) {
        let bound = Instant::now() + PATIENCE;
        loop {
            for image in [NOTHING, STOP_ACK, NOTHING] {
                self.ask(&image);
            }
            let ready = |outputs: Outputs| outputs.contains(Outputs::READY);
            match self.rig.board().wait_outputs(Duration::from_secs(2), ready) {
                Ok(_) => return,
                Err(error) => assert!(Instant::now() < bound, "{error:#}"),
            }
        }
    }
}

fn a_bus_with_line_errors_moves_nothing_and_counts(board: Board) {
    let mut plant = Plant::start(board);
    for &error in plant.reported() {
        let before = plant.report("BUS_OVERRUNS");
        // One damaged byte of 17 is sufficient, even with a correct checksum. The UART reports a lost byte with the next byte,
        // or earlier by itself.
        plant.set(Line::Bus, Some((error, 9)));
        plant.master.send(&Master::frame(UNIT, &HOMING)).unwrap();
        plant.rig.pass(200).unwrap();
        assert!(plant.master.is_silent().unwrap(), "{error:?} is answered");
        plant.set(Line::Bus, None);
        let after = plant.report("BUS_OVERRUNS");
        assert!(after > before, "{error:?} is not counted: {before}, {after}");
        assert_eq!(motions(&plant.rig.trace().since(0)), [], "{error:?}");
    }
    plant.ask(&HOMING);
    let referenced = |outputs: Outputs| outputs.contains(Outputs::REFERENCED | Outputs::READY);
    plant.rig.board().wait_outputs(PATIENCE, referenced).unwrap();
    assert_eq!(motions(&plant.rig.trace().since(0)), [CommandId::Homing]);
}

fn a_gripper_line_with_errors_is_reported_and_moves_nothing(board: Board) {
    let mut plant = Plant::start(board);
    if plant.reported().contains(&LineError::Noise) {
        // The checksum decides about bytes with noise.
        plant.set(Line::Gripper, Some((LineError::Noise, 1)));
        plant.rig.pass(1_000).unwrap();
        assert!(plant.rig.board().outputs().contains(Outputs::LINK_OK | Outputs::READY));
        assert_eq!(plant.report("DISCONNECTS"), 0);
    }

    for (disconnects, error) in (1..).zip([LineError::Framing, LineError::Overrun]) {
        let dropped = plant.report("LINE_DROPPED");
        plant.set(Line::Gripper, Some((error, 3)));
        plant.rig.board().wait_outputs(PATIENCE, |outputs| !outputs.contains(Outputs::LINK_OK)).unwrap();
        plant.ask(&HOMING);
        assert!(plant.report("LINE_DROPPED") > dropped, "{error:?}");
        plant.ask(&NOTHING);
        plant.set(Line::Gripper, None);
        plant.rig.board().wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
        assert_eq!(plant.report("DISCONNECTS"), disconnects, "{error:?}");
        plant.acknowledge();
    }
    assert_eq!(motions(&plant.rig.trace().since(0)), []);
}

on_every_board!(board =>
    a_bus_with_line_errors_moves_nothing_and_counts,
    a_gripper_line_with_errors_is_reported_and_moves_nothing,
);
