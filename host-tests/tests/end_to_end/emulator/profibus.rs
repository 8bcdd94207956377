//! The released image between a PROFIBUS master and a virtual gripper, in the emulators, at 9.6 kbit/s. The masters are
//! `profirust` and `pyprofibus`.
//!
//! QEMU models neither bit rates, idle times nor this timer, so the next turn of the main loop sends an answer. rp2040js models
//! character times but runs slower than real time. The master's slot time is therefore 104 ms.

use std::io::{ErrorKind, Write};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use host_tests::emulator::Extras;
use host_tests::masters::{self, printed};
use host_tests::rig::{Rig, motions};
use host_tests::terminal::Terminal;
use host_tests::world::with_part;
use profirust::dp::{DpMaster, Peripheral, PeripheralHandle, PeripheralOptions};
use profirust::fdl::{FdlActiveStation, ParametersBuilder};
use profirust::phy::ProfibusPhy;
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::profibus::PROFILE;
use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, InputImage, OutputImage};
use wsg_protocol::{CommandId, Status, SystemFlags};

use super::Board;
use crate::profibus::gsd_file;

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(600);

/// The board's line, as the PHY of the master.
struct Line {
    line: UnixStream,
    received: Vec<u8>,
}

impl Line {
    /// Reads available bytes, and waits up to 1 ms for the first.
    fn listen(&mut self) {
        let mut chunk = [0; 256];
        match uninterrupted::read(&mut self.line, &mut chunk) {
            Ok(count) => self.received.extend_from_slice(&chunk[..count]),
            Err(error) => {
                assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut), "{error}")
            }
        }
    }
}

impl ProfibusPhy for Line {
    fn poll_transmission(&mut self, _: profirust::time::Instant) -> bool {
        false
    }

    fn transmit_data<F: FnOnce(&mut [u8]) -> (usize, R), R>(
        &mut self,
        _: profirust::time::Instant,
        fill: F,
    ) -> R {
        let mut buffer = [0; 256];
        let (len, result) = fill(&mut buffer);
        self.line.write_all(&buffer[..len]).unwrap();
        result
    }

    fn receive_data<F: FnOnce(&[u8]) -> (usize, R), R>(&mut self, _: profirust::time::Instant, take: F) -> R {
        let (taken, result) = take(&self.received);
        self.received.drain(..taken);
        result
    }
}

struct Plant {
    rig: Rig,
    line: Line,
    fdl: FdlActiveStation,
    master: DpMaster<'static>,
    station: PeripheralHandle,
    image: OutputImage,
}

/// Starts a board on PROFIBUS and a gripper with a part of 20 mm. Also returns the master's end of the bus.
fn power_up(board: Board) -> (Rig, UnixStream) {
    let mut rig = board.rig("WSG_FIRMWARE_ELF_PROFIBUS", Extras::default(), with_part(20.0));
    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    let line = rig.board_mut().take_modbus_line().unwrap();
    (rig, line)
}

impl Plant {
    fn start(board: Board) -> Self {
        let (rig, line) = power_up(board);
        line.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let options = PeripheralOptions {
            ident_number: PROFILE.ident,
            user_parameters: Some(&[]),
            config: Some(PROFILE.config),
            ..PeripheralOptions::default()
        };
        let mut master = DpMaster::new(vec![]);
        let (inputs, outputs) = (vec![0; InputImage::LEN], vec![0; OutputImage::LEN]);
        let station = master.add(Peripheral::new(7, options, inputs, outputs).with_diag_buffer(vec![0; 64]));
        master.enter_operate();
        let parameters = ParametersBuilder::new(2, profirust::Baudrate::B9600)
            .slot_bits(1_000)
            .max_retry_limit(15)
            .highest_station_address(3)
            .build_verified(&master);
        let mut fdl = FdlActiveStation::new(parameters);
        fdl.set_online();
        let image = OutputImage { width: 20_00, speed: 100_00, force_limit: 40_00, ..OutputImage::ZERO };
        let line = Line { line, received: vec![] };
        Self { rig, line, fdl, master, station, image }
    }

    /// Exchanges outputs with these flags until the inputs meet the condition.
    fn command(&mut self, flags: Flag, is_done: impl Fn(&InputImage) -> bool) -> InputImage {
        self.image.flags = flags;
        let start = Instant::now();
        let (mut shown, mut exchanges) = (None, 0);
        loop {
            assert!(start.elapsed() < BOUND, "{flags:?}: {shown:?}");
            let station = self.master.get_mut(self.station);
            station.pi_q_mut().copy_from_slice(&self.image.to_bytes());
            self.fdl.poll(profirust::time::Instant::now(), &mut self.line, &mut self.master);
            let event = self.master.take_last_events().peripheral;
            if let Some((_, profirust::dp::PeripheralEvent::DataExchanged)) = event {
                let inputs = self.master.get_mut(self.station).pi_i();
                let input = InputImage::from_bytes(inputs.try_into().unwrap());
                exchanges += 1;
                // The inputs of the first exchanges may precede the flag.
                if exchanges > 3 && is_done(&input) {
                    return input;
                }
                shown = Some(input);
            }
            self.line.listen();
        }
    }
}

fn master_of_profirust_runs_grip_cycles_on_the_emulated_board(board: Board) {
    let mut plant = Plant::start(board);
    let shows = |state| move |input: &InputImage| (input.state, input.status) == (state, Status::Success);
    let is_stopped = |input: &InputImage| input.system.contains(SystemFlags::FAST_STOP);
    // The wire of FAST STOP was low at power-up.
    plant.command(Flag::empty(), is_stopped);
    plant.command(Flag::STOP_ACK, |input| !is_stopped(input));
    plant.command(Flag::empty(), |_| true);
    plant.command(Flag::HOMING, |input| {
        input.system.contains(SystemFlags::REFERENCED) && shows(Shown::IDLE)(input)
    });
    for _ in 0..3 {
        plant.command(Flag::empty(), |_| true);
        plant.command(Flag::GRIP, shows(Shown::HOLDING));
        plant.command(Flag::empty(), shows(Shown::HOLDING));
        plant.command(Flag::RELEASE, shows(Shown::IDLE));
    }
    let cycle = [CommandId::GripPart, CommandId::ReleasePart];
    let expected = [&[CommandId::Homing][..], &cycle.repeat(3)].concat();
    assert_eq!(motions(&plant.rig.trace().since(0)), expected);
}

fn pyprofibus_runs_a_grip_cycle_on_the_emulated_board(board: Board) {
    let (rig, line) = power_up(board);
    let terminal = Terminal::to(line).unwrap();
    let output = masters::python(include_str!("../pyprofibus.py"), &[&terminal.path, &gsd_file()]);
    assert!(output.status.success(), "{}", printed(&output));
    let stdout = String::from_utf8_lossy(&output.stdout);
    let mut commands = motions(&rig.trace().since(0));
    for (edge, command) in [
        ("edge 08", CommandId::Homing),
        ("edge 02", CommandId::GripPart),
        ("edge 04", CommandId::ReleasePart),
    ] {
        // One edge is sufficient, unless a busy machine has made the master reconnect, which may lose the edge before.
        let edges = stdout.lines().filter(|line| *line == edge).count();
        let sent = commands.iter().take_while(|sent| **sent == command).count();
        assert!((1..=edges).contains(&sent), "{command:?} sent {sent} times: {}", printed(&output));
        commands.drain(..sent);
    }
    assert_eq!(commands, [], "{}", printed(&output));
}

on_every_board!(board =>
    master_of_profirust_runs_grip_cycles_on_the_emulated_board,
    pyprofibus_runs_a_grip_cycle_on_the_emulated_board,
);
