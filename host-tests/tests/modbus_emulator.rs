//! The flashed image between a Modbus master and a virtual gripper, in the emulator, over LPUART1.
#![cfg(unix)]

use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use host_tests::emulator::Emulator;
use host_tests::gripper_end::GripperEnd;
use host_tests::rig::motions;
use host_tests::trace::Trace;
use wsg_bridge_fw::io::Inputs;
use wsg_protocol::CommandId;
use wsg_protocol::modbus::rtu::crc;
use wsg_sim::{Config, Part};

const UNIT: u8 = 1;

/// Longer than any answer takes on a host that is busy.
const PATIENCE: Duration = Duration::from_millis(300);

struct Plant {
    _board: Emulator,
    gripper: GripperEnd,
    trace: Trace,
    line: UnixStream,
    retries: u32,
}

/// What becomes of a byte on the bus.
type Disturbance<'a> = &'a mut dyn FnMut(u8) -> u8;

/// How long an answer that begins like this is.
fn length(answer: &[u8]) -> usize {
    match answer[1] {
        0x80.. => 5,
        3 | 4 => 5 + usize::from(answer[2]),
        _ => 8,
    }
}

impl Plant {
    /// A board whose FAST STOP wire is high, a gripper that answers, and a bus that has written zeros.
    fn start(config: Config) -> Self {
        let elf: PathBuf =
            std::env::var_os("WSG_FIRMWARE_ELF").expect("WSG_FIRMWARE_ELF names the firmware image").into();
        let mut board = Emulator::start(&elf).unwrap();
        board.set_input(Inputs::FAST_STOP_OK, true).unwrap();
        let trace = Trace::new(vec![]);
        let gripper = GripperEnd::start(board.take_gripper_line().unwrap(), config, &trace).unwrap();
        let line = board.take_modbus_line().unwrap();
        line.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let mut plant = Self { _board: board, gripper, trace, line, retries: 0 };
        let bound = Instant::now() + Duration::from_secs(20);
        while plant.ask(&[4, 0, 0, 0, 6])[0] != 4 {
            assert!(Instant::now() < bound, "the gripper does not answer");
        }
        // The wire was low until just now.
        plant.write(&[0, 0, 0, 0]);
        plant.write(&[1 << 12, 0, 0, 0]);
        while plant.input()[1] & 0x0010 != 0 {
            assert!(Instant::now() < bound, "the FAST STOP is not acknowledged");
        }
        plant.write(&[0, 0, 0, 0]);
        plant
    }

    /// The answer's PDU, after as many attempts as it takes.
    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.ask_over(pdu, &mut |byte| byte)
    }

    fn ask_over(&mut self, pdu: &[u8], disturb: Disturbance<'_>) -> Vec<u8> {
        for _ in 0..10 {
            if let Some(answer) = self.try_once(pdu, disturb) {
                return answer;
            }
            self.retries += 1;
        }
        panic!("no answer to {pdu:02X?}");
    }

    fn try_once(&mut self, pdu: &[u8], disturb: Disturbance<'_>) -> Option<Vec<u8>> {
        let mut frame = [&[UNIT], pdu].concat();
        frame.extend(crc(&frame).to_le_bytes());
        let frame: Vec<u8> = frame.into_iter().map(&mut *disturb).collect();
        self.line.write_all(&frame).unwrap();
        let mut answer = vec![];
        let bound = Instant::now() + PATIENCE;
        while Instant::now() < bound {
            let mut chunk = [0; 256];
            match self.line.read(&mut chunk) {
                Ok(0) => panic!("the board went off"),
                Ok(count) => answer.extend(chunk[..count].iter().map(|byte| disturb(*byte))),
                // Silence; what has come is all.
                Err(_) if !answer.is_empty() => return None,
                Err(_) => continue,
            }
            // A part of an answer can have a right checksum by chance.
            let is_whole = answer.len() >= 5 && answer.len() == length(&answer) && {
                let (body, sum) = answer.split_at(answer.len() - 2);
                crc(body).to_le_bytes() == sum && body[0] == UNIT
            };
            if is_whole {
                return Some(answer[1..answer.len() - 2].to_vec());
            }
        }
        None
    }

    /// FC 16 over the output image.
    fn write(&mut self, values: &[u16; 4]) {
        let mut pdu = vec![16, 0, 0, 0, 4, 8];
        pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        assert_eq!(self.ask(&pdu), [16, 0, 0, 0, 4]);
    }

    /// The input image.
    fn input(&mut self) -> [u16; 6] {
        let answer = self.ask(&[4, 0, 0, 0, 6]);
        assert_eq!(answer[..2], [4, 12]);
        std::array::from_fn(|n| u16::from_be_bytes([answer[2 + 2 * n], answer[3 + 2 * n]]))
    }

    /// A command with its parameters; GSTATE and status at its end.
    fn command(&mut self, bit: u8, parameters: [u16; 3]) -> (u16, u16) {
        let [width, speed, force] = parameters;
        self.write(&[1 << (8 + bit), width, speed, force]);
        self.write(&[0, width, speed, force]);
        let bound = Instant::now() + Duration::from_secs(60);
        loop {
            let input = self.input();
            if input[5] != 26 {
                return (input[0] >> 8, input[5]);
            }
            assert!(Instant::now() < bound, "the command does not end");
        }
    }
}

const MOVE: u8 = 0;
const GRIP: u8 = 1;
const RELEASE: u8 = 2;
const HOMING: u8 = 3;
const STOP_ACK: u8 = 4;
const IDLE: u16 = 1 << 0;
const PART_LOST: u16 = 1 << 3;
const HOLDING: u16 = 1 << 4;
const RELEASING: u16 = 1 << 5;
const POSITIONING: u16 = 1 << 6;

fn quick() -> Config {
    Config { time_scale: 10.0, ..Config::default() }
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn grip_cycles_over_the_bus_of_the_emulated_board() {
    let mut plant = Plant::start(Config { part: Part::of_width(20.0), ..quick() });
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));
    for _ in 0..10 {
        assert_eq!(plant.command(MOVE, [80_00, 200_00, 40_00]), (IDLE, 0));
        assert_eq!(plant.command(GRIP, [20_00, 50_00, 40_00]), (HOLDING, 0));
        assert_eq!(plant.command(RELEASE, [40_00, 50_00, 40_00]), (IDLE, 0));
    }
    let cycle = [CommandId::PrePosition, CommandId::GripPart, CommandId::ReleasePart];
    let expected = [&[CommandId::Homing][..], &cycle.repeat(10)].concat();
    assert_eq!(motions(&plant.trace.since(0)), expected);
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn rules_of_the_fieldbus_manual_hold_on_the_emulated_board() {
    let mut plant = Plant::start(Config { part: Part::of_width(20.0), ..Config::default() });
    let fast_stopped = |plant: &mut Plant| plant.input()[1] & 0x0010 != 0;
    let acknowledge = |plant: &mut Plant| {
        plant.write(&[0, 30_00, 50_00, 40_00]);
        assert_eq!(plant.command(STOP_ACK, [30_00, 50_00, 40_00]), (IDLE, 0));
        assert!(!fast_stopped(plant));
    };
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));

    // Two edges at once: MOVE and GRIP; the lowest runs. Then a parameter changes on the way.
    plant.write(&[0b11 << 8, 30_00, 50_00, 40_00]);
    assert_eq!(plant.input()[0] >> 8, POSITIONING);
    plant.write(&[0b11 << 8, 30_00, 50_01, 40_00]);
    while !fast_stopped(&mut plant) {}
    assert_eq!(plant.input()[0] >> 8, IDLE);
    acknowledge(&mut plant);

    // SPEED out of range.
    plant.write(&[1 << 8, 30_00, 1, 40_00]);
    while !fast_stopped(&mut plant) {}
    acknowledge(&mut plant);

    // FASTSTOP on the way; it is not acknowledged while it is 1.
    plant.write(&[1 << 8, 30_00, 50_00, 40_00]);
    plant.write(&[1 << 13, 30_00, 50_00, 40_00]);
    while !fast_stopped(&mut plant) {}
    plant.write(&[0b11 << 12, 30_00, 50_00, 40_00]);
    std::thread::sleep(Duration::from_millis(100));
    assert!(fast_stopped(&mut plant));
    acknowledge(&mut plant);

    // A part is gripped, and lost.
    assert_eq!(plant.command(GRIP, [20_00, 200_00, 40_00]), (HOLDING, 0));
    plant.gripper.set_part(None);
    let bound = Instant::now() + Duration::from_secs(10);
    while plant.input()[0] >> 8 != PART_LOST {
        assert!(Instant::now() < bound, "PART_LOST does not come");
    }
    let expected = [CommandId::Homing, CommandId::PrePosition, CommandId::PrePosition, CommandId::GripPart];
    assert_eq!(motions(&plant.trace.since(0)), expected);
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn jog_over_the_bus_of_the_emulated_board_stops_with_its_flag_and_with_the_masters_silence() {
    let mut plant = Plant::start(Config::default());
    assert_eq!(plant.command(HOMING, [0; 3]), (IDLE, 0));
    assert_eq!(plant.command(MOVE, [20_00, 300_00, 40_00]), (IDLE, 0));
    let jog_plus = [1 << 14, 20_00, 20_00, 40_00];
    plant.write(&jog_plus);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(plant.input()[0] >> 8, RELEASING);
    plant.write(&[0, 20_00, 20_00, 40_00]);
    while plant.input()[0] >> 8 != IDLE {}
    let stands = plant.gripper.state().width;
    assert!(stands > 20.5 && stands < 100.0, "{stands}");

    plant.write(&jog_plus);
    std::thread::sleep(Duration::from_millis(1_500));
    let stopped = plant.gripper.state().width;
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(plant.gripper.state().width, stopped, "nobody holds the button");
    assert!(stopped < 100.0, "{stopped}");
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn requests_over_a_disturbed_bus_read_no_wrong_value_and_leave_no_stuck_line() {
    const PAIRS: u32 = 1_000;
    let mut plant = Plant::start(quick());
    // One byte in a thousand, each way, by a generator that is the same in every run.
    let mut state = 1u32;
    let mut damaged = 0;
    let mut disturb = |byte: u8| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        if state >> 8 & 0x3FF == 0 {
            damaged += 1;
            return byte ^ (1 << (state >> 29));
        }
        byte
    };
    let before = plant.retries;
    for number in 0..PAIRS {
        let [high, low] = (number as u16).to_be_bytes();
        let written = [16, 0, 1, 0, 1, 2, high, low];
        assert_eq!(plant.ask_over(&written, &mut disturb), [16, 0, 1, 0, 1]);
        assert_eq!(plant.ask_over(&[3, 0, 1, 0, 1], &mut disturb), [3, 2, high, low], "pair {number}");
    }
    let retries = plant.retries - before;
    // A host that is busy pauses inside frames as well, and each such frame is one more.
    println!("{PAIRS} writes and reads, {damaged} damaged bytes, {retries} retries");
    assert!(damaged > 0 && retries > 0);
    assert_eq!(motions(&plant.trace.since(0)), []);
}
