//! The released image between a Modbus master and a virtual gripper, in the emulator.

use std::time::{Duration, Instant};

use host_tests::emulator::Extras;
use host_tests::extent;
use host_tests::modbus_master::{Failed, Master};
use host_tests::rig::{MOTION_PATIENCE, Rig, motions};
use host_tests::trace::Entry;
use host_tests::world::{quick, with_part};
use wsg_bridge_fw::io::Inputs;
use wsg_protocol::{CommandId, Status};
use wsg_sim::Config;

use super::{Board, RELEASED, await_gripper, wait_until};

const UNIT: u8 = 1;

/// Board time after which no answer follows, in milliseconds.
const QUIET_MS: u32 = 200;

struct Plant {
    rig: Rig,
    master: Master,
}

impl Plant {
    /// A board with a high FAST STOP wire, a responding gripper, and a master that has written zeros.
    fn start(board: Board, config: Config) -> Self {
        let mut rig = board.rig(RELEASED, Extras::default(), config);
        rig.set(Inputs::FAST_STOP_OK, true).unwrap();
        let mut master = rig.master(UNIT).unwrap();
        await_gripper(&mut master);
        let mut plant = Self { rig, master };
        // The wire was low at power-up.
        plant.write(&[0, 0, 0, 0]);
        plant.write(&[1 << 12, 0, 0, 0]);
        plant.wait("the FAST STOP of power-up to end", |input| input[1] & FAST_STOP == 0);
        plant.write(&[0, 0, 0, 0]);
        plant
    }

    /// Returns the answer's PDU.
    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.master.ask(pdu).unwrap()
    }

    /// Writes the output image with FC 16.
    fn write(&mut self, values: &[u16; 4]) {
        self.master.write(0, values).unwrap();
    }

    /// Reads the input image.
    fn input(&mut self) -> [u16; 6] {
        self.master.read(4, 0, 6).unwrap().try_into().unwrap()
    }

    /// Waits for an input image that meets the condition.
    fn wait(&mut self, what: &str, is_there: impl Fn(&[u16; 6]) -> bool) -> [u16; 6] {
        wait_until(what, || self.input(), is_there)
    }

    /// Sets a JOG flag until the jog runs, and returns the mark of the trace before it. After a pause of this master for a second,
    /// the bridge takes its next image for the first, in which the flag is no edge. If the gripper paused for more than 100 ms
    /// before it answered a Stop, the bridge has sent a FAST STOP, which this acknowledges.
    fn begin_to_jog(&mut self, image: &[u16; 4]) -> usize {
        let bound = Instant::now() + MOTION_PATIENCE;
        loop {
            self.write(&[0, image[1], image[2], image[3]]);
            let mark = self.rig.trace().mark();
            self.write(image);
            let input = self.input();
            if input[0] >> 8 == RELEASING {
                return mark;
            }
            if input[1] & FAST_STOP != 0 {
                self.write(&[0; 4]);
                self.write(&[1 << 12, 0, 0, 0]);
            }
            assert!(Instant::now() < bound, "no jog; input image {input:04X?}");
        }
    }

    /// Runs a command with its parameters and returns GSTATE and status at its end.
    fn command(&mut self, bit: u8, parameters: [u16; 3]) -> (u16, u16) {
        let [width, speed, force] = parameters;
        self.write(&[1 << (8 + bit), width, speed, force]);
        self.write(&[0, width, speed, force]);
        let input = self.wait("the command to end", |input| input[5] != PENDING);
        (input[0] >> 8, input[5])
    }
}

const MOVE: u8 = 0;
const GRIP: u8 = 1;
const RELEASE: u8 = 2;
const HOMING: u8 = 3;
/// In input register 1, whose low byte is the second byte of SYSSTATE.
const FAST_STOP: u16 = 1 << 4;
const PENDING: u16 = Status::CmdPending.code();
const IDLE: u16 = 1 << 0;
const HOLDING: u16 = 1 << 4;
const RELEASING: u16 = 1 << 5;

fn grip_cycles_over_the_bus_of_the_emulated_board(board: Board) {
    let mut plant = Plant::start(board, with_part(20.0));
    plant.master.allow_pauses().unwrap();
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));
    for _ in 0..10 {
        assert_eq!(plant.command(MOVE, [80_00, 200_00, 40_00]), (IDLE, 0));
        assert_eq!(plant.command(GRIP, [20_00, 50_00, 40_00]), (HOLDING, 0));
        assert_eq!(plant.command(RELEASE, [40_00, 50_00, 40_00]), (IDLE, 0));
    }
    let cycle = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart];
    let expected = [&[CommandId::Homing][..], &cycle.repeat(10)].concat();
    assert_eq!(motions(&plant.rig.trace().since(0)), expected);
}

fn jog_over_the_bus_stops_with_its_flag_or_a_silent_master(board: Board) {
    // The bridge stops the jog a second of board time after the last request. On a busy host, the board's clock may run far
    // slower than the gripper's, so the gripper is slow, too.
    let slow = Config { time_scale: 0.1, homing_speed: Some(300.0), ..Config::default() };
    let mut plant = Plant::start(board, slow);
    plant.master.allow_pauses().unwrap();
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));
    assert_eq!(plant.command(MOVE, [20_00, 300_00, 40_00]), (IDLE, 0));
    // The default BUS_TIMEOUT.
    assert_eq!(plant.ask(&[6, 0, 101, 3, 232]), [6, 0, 101, 3, 232]);
    let jog_plus = [1 << 14, 20_00, 5_00, 40_00];
    plant.begin_to_jog(&jog_plus);
    plant.wait("a jog that moves", |input| input[0] >> 8 == RELEASING && input[3] > 21_00);
    plant.write(&[0, 20_00, 5_00, 40_00]);
    plant.wait("the jog to end", |input| input[0] >> 8 == IDLE);
    let stands = plant.rig.gripper().state().width;
    assert!(stands > 20.5 && stands < 100.0, "{stands}");

    let mark = plant.begin_to_jog(&jog_plus);
    let is_stop = |entry: &Entry| entry.command() == Some(CommandId::Stop);
    assert!(plant.rig.trace().wait(mark, Duration::from_secs(60), is_stop), "no Stop");
    let input = plant.wait("the fingers to stand", |input| input[0] >> 8 == IDLE);
    assert!(input[3] < 100_00, "{input:?}");
}

fn foreign_or_broken_frames_move_nothing_and_cost_no_request(board: Board) {
    let mut plant = Plant::start(board, quick());
    // HOMING, a motion, for this unit and for another.
    let homing = |unit: u8| Master::frame(unit, &[6, 0, 0, 1 << HOMING, 0]);
    let read = [3, 0, 1, 0, 1];
    let value = [3, 2, 0, 0];
    for unit in [2, 247] {
        plant.master.send(&homing(unit)).unwrap();
        plant.rig.pass(QUIET_MS).unwrap();
        assert!(plant.master.is_silent().unwrap(), "unit {unit} must not be answered");
        assert_eq!(plant.ask(&read), value);
    }
    let glued = [homing(UNIT), homing(UNIT)].concat();
    let mut damaged = homing(UNIT);
    damaged[3] ^= 1;
    let broadcast = homing(0);
    let noise: Vec<u8> = (0..300u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    for bytes in [&glued, &damaged, &homing(UNIT)[..7], &broadcast, &noise] {
        plant.master.send(bytes).unwrap();
        plant.rig.pass(QUIET_MS).unwrap();
        assert!(plant.master.is_silent().unwrap(), "{bytes:02X?}");
        assert_eq!(plant.ask(&read), value, "after {bytes:02X?}");
    }
    assert_eq!(motions(&plant.rig.trace().since(0)), []);
    // The bridge tolerates pauses inside a request, which a USB adapter causes: here 6 ms. A busy host may extend the pause, so
    // the limit is a second (BUS_CHAR_TIMEOUT).
    assert_eq!(plant.ask(&[6, 0, 103, 3, 232]), [6, 0, 103, 3, 232]);
    let frame = Master::frame(UNIT, &read);
    for cut in 1..frame.len() {
        plant.master.send(&frame[..cut]).unwrap();
        plant.rig.pass(5).unwrap();
        assert_eq!(plant.master.ask_rest(&frame[cut..]).unwrap(), value, "cut after {cut} bytes");
    }
    // The bus was silent, and flags in the first image after silence are not edges.
    plant.write(&[0; 4]);
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));
    assert_eq!(motions(&plant.rig.trace().since(0)), [CommandId::Homing]);
}

fn disturbed_bus_yields_no_wrong_value_and_no_stuck_line(board: Board) {
    let requests = extent::of(10_000);
    let mut plant = Plant::start(board, quick());
    // Damage one byte in ten thousand in each direction, by a generator with a fixed seed (xorshift).
    let mut state = 0x2545_F491u32;
    let mut damaged = 0;
    let mut disturb = |byte: u8| {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        if !state.is_multiple_of(10_000) {
            return byte;
        }
        damaged += 1;
        byte ^ (1 << (state >> 29))
    };
    plant.master.failed = Failed::default();
    for number in 0..requests / 2 {
        let [high, low] = (number as u16).to_be_bytes();
        let written = plant.master.ask_over(&[16, 0, 1, 0, 1, 2, high, low], &mut disturb).unwrap();
        assert_eq!(written, [16, 0, 1, 0, 1]);
        let read = plant.master.ask_over(&[3, 0, 1, 0, 1], &mut disturb).unwrap();
        assert_eq!(read, [3, 2, high, low], "pair {number}");
    }
    let failed = plant.master.failed;
    println!("{requests} requests, {damaged} damaged bytes, {failed:?}");
    assert!(damaged > 0 && failed.damaged > 0, "the disturbance must have an effect");
    // A damaged byte costs at most one request. A very busy host may also answer it late, once.
    assert!(failed.after_damage <= 1, "{damaged} damaged bytes: {failed:?}");
    assert_eq!(motions(&plant.rig.trace().since(0)), []);
}

on_every_board!(board =>
    grip_cycles_over_the_bus_of_the_emulated_board,
    jog_over_the_bus_stops_with_its_flag_or_a_silent_master,
    foreign_or_broken_frames_move_nothing_and_cost_no_request,
    disturbed_bus_yields_no_wrong_value_and_no_stuck_line,
);
