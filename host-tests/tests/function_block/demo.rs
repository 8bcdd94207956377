//! Runs PRG_WSG_DEMO of the SCL source against the virtual gripper, and compares its registers with the Rust version of the
//! same cycle, scan by scan. These are the tests of both versions.

use std::collections::BTreeSet;

use document::read;
use host_tests::gripping_cycle::{Counters, Cycle, Motion, Phase};
use wsg_fieldbus::InputImage;
use wsg_protocol::GripperState;
use wsg_sim::{Config, Fault, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

use super::formats::SCL;
use super::structured_text::{Instance, Unit, Value};

const PROGRAM: &str = "PRG_WSG_DEMO";

/// A PLC with a scan cycle of 10 ms and a Modbus/TCP connection to the virtual gripper.
struct Plc {
    gripper: VirtualGripper,
    port: PortId,
    now: Time,
    program: Instance,
    cycle: Cycle,
}

impl Plc {
    fn new(part: Option<Part>, cycles: u32) -> Self {
        let mut gripper = VirtualGripper::new(Config { part, ..Config::default() });
        let port = gripper.connect(PortKind::ModbusTcp).unwrap();
        let mut program = Instance::new(&Unit::parse_scl(&read(SCL)), PROGRAM);
        program.set("Wanted", Value::Int(cycles.into()));
        Self { gripper, port, now: Time::ZERO, program, cycle: Cycle::new(cycles) }
    }

    fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        let header = [0, 1, 0, 0, 0, pdu.len() as u8 + 1, 1];
        self.gripper.receive(self.port, self.now, &[&header, pdu].concat());
        let mut buffer = [0; MAX_FRAME_LEN];
        self.gripper.transmit(self.port, &mut buffer).unwrap()[7..].to_vec()
    }

    /// Runs a scan of both programs with the same inputs. Their outputs must be equal; the gripper receives them.
    fn scan(&mut self) {
        let input = self.ask(&[4, 0, 0, 0, 6]);
        let now_ms = self.now.as_micros() / 1_000;
        let image = InputImage::from_bytes(input[2..].try_into().unwrap());
        let expected = self.cycle.scan(now_ms, &image).to_bytes();

        for (register, word) in input[2..].chunks(2).enumerate() {
            let word = u16::from_be_bytes([word[0], word[1]]);
            self.program.set(&format!("In{register}"), Value::Bits(16, word.into()));
        }
        self.program.scan(i64::try_from(now_ms).unwrap());
        let output = [0, 1, 2, 3].map(|register| {
            let Value::Bits(16, word) = self.program.get(&format!("Out{register}")) else { panic!() };
            u16::try_from(word).unwrap().to_be_bytes()
        });
        let output = output.concat();
        assert_eq!(output, expected, "at {now_ms} ms, {:?}, inputs {input:02X?}", self.cycle.phase());

        self.ask(&[&[16, 0, 0, 0, 4, 8], &output[..]].concat());
        self.now = self.now.plus_millis(10);
        self.gripper.advance(self.now);
    }

    /// Scans until a phase begins.
    #[track_caller]
    fn until(&mut self, phase: Phase) {
        for _ in 0..12_000 {
            if self.cycle.phase() == phase {
                return;
            }
            self.scan();
        }
        panic!("{:?} after two minutes, not {phase:?}", self.cycle.phase());
    }

    /// Ends both programs. Compares their results with the expected ones, and returns the executed lines.
    #[track_caller]
    fn ends(mut self, phase: Phase, expected: Counters) -> BTreeSet<usize> {
        self.until(phase);
        // Done and GivenUp follow one scan later.
        self.scan();
        let count = |name: &str| {
            let Value::Int(count) = self.program.get(name) else { panic!("{name}") };
            u32::try_from(count).unwrap()
        };
        let counters = Counters {
            cycles: count("Cycles"),
            held: count("Held"),
            not_found: count("NotFound"),
            lost: count("Lost"),
            homings: count("Homings"),
            errors: count("Errors"),
        };
        assert_eq!((counters, self.cycle.counters()), (expected, expected));
        let flags = ["Done", "GivenUp"].map(|name| self.program.get(name) == Value::Bool(true));
        assert_eq!(flags, [phase == Phase::Finished, phase == Phase::GivenUp]);
        self.program.covered
    }
}

fn cycles_with_a_part() -> BTreeSet<usize> {
    let expected = Counters { cycles: 3, held: 3, homings: 1, ..Counters::default() };
    let mut plc = Plc::new(Part::of_width(22.0), 3);
    plc.until(Phase::Finished);
    assert_eq!(plc.cycle.last_error(), None);
    assert_eq!((plc.gripper.state().width, plc.gripper.state().statistics.total), (60.0, 3));
    plc.ends(Phase::Finished, expected)
}

fn cycles_without_a_part() -> BTreeSet<usize> {
    let expected = Counters { cycles: 2, not_found: 2, homings: 1, ..Counters::default() };
    Plc::new(None, 2).ends(Phase::Finished, expected)
}

fn lost_part() -> BTreeSet<usize> {
    let expected = Counters { cycles: 1, lost: 1, homings: 1, ..Counters::default() };
    let mut plc = Plc::new(Part::of_width(22.0), 1);
    plc.until(Phase::Hold);
    plc.gripper.set_part(None, plc.now);
    let mut lines = plc.ends(Phase::Finished, expected);
    // The part is lost before the programs see HOLDING.
    let mut plc = Plc::new(Part::of_width(22.0), 1);
    plc.until(Phase::Run(Motion::Grip));
    while plc.gripper.state().gripper != GripperState::Holding {
        plc.scan();
    }
    plc.gripper.set_part(None, plc.now);
    lines.extend(plc.ends(Phase::Finished, expected));
    lines
}

fn fault_in_a_cycle() -> BTreeSet<usize> {
    let mut lines = BTreeSet::new();
    for (fault, named) in [(Fault::AxisBlocked, "E_AXIS_BLOCKED"), (Fault::MotorCurrent, "FAST STOP")] {
        let mut plc = Plc::new(Part::of_width(22.0), 2);
        plc.until(Phase::Run(Motion::Start));
        plc.gripper.set_fault(fault, true, plc.now);
        plc.until(Phase::Clear);
        assert!(plc.cycle.last_error().unwrap().contains(named), "{:?}", plc.cycle.last_error());
        plc.gripper.set_fault(fault, false, plc.now);
        let expected = Counters { cycles: 2, held: 3, homings: 2, errors: 1, ..Counters::default() };
        lines.extend(plc.ends(Phase::Finished, expected));
    }
    lines
}

fn lasting_fault() -> BTreeSet<usize> {
    let mut plc = Plc::new(None, 1);
    plc.gripper.set_fault(Fault::MotorCurrent, true, plc.now);
    plc.until(Phase::GivenUp);
    plc.scan();
    assert_eq!(plc.ask(&[3, 0, 0, 0, 1]), [3, 2, 0, 0], "all flags are 0");
    plc.ends(Phase::GivenUp, Counters { errors: 3, ..Counters::default() })
}

fn latched_fast_stop() -> BTreeSet<usize> {
    let mut plc = Plc::new(None, 1);
    plc.gripper.set_fault(Fault::MotorCurrent, true, plc.now);
    plc.gripper.set_fault(Fault::MotorCurrent, false, plc.now);
    let expected = Counters { cycles: 1, not_found: 1, homings: 1, ..Counters::default() };
    plc.ends(Phase::Finished, expected)
}

/// Another Modbus master sets STOP/ACK.
fn stop_by_another_master() -> BTreeSet<usize> {
    let mut lines = BTreeSet::new();
    for phase in [Phase::Run(Motion::Home), Phase::Run(Motion::Grip), Phase::Hold] {
        let mut plc = Plc::new(Part::of_width(22.0), 1);
        plc.until(phase);
        assert_eq!(plc.ask(&[5, 0, 4, 0xFF, 0]), [5, 0, 4, 0xFF, 0]);
        let homings = if phase == Phase::Run(Motion::Home) { 1 } else { 2 };
        let expected = Counters { cycles: 1, held: 1, homings, errors: 1, ..Counters::default() };
        lines.extend(plc.ends(Phase::Finished, expected));
    }
    lines
}

const SCENARIOS: [fn() -> BTreeSet<usize>; 7] = [
    cycles_with_a_part,
    cycles_without_a_part,
    lost_part,
    fault_in_a_cycle,
    lasting_fault,
    latched_fast_stop,
    stop_by_another_master,
];

#[test]
fn demo_program_writes_the_example_registers_on_every_line() {
    let covered: BTreeSet<usize> = SCENARIOS.iter().flat_map(|scenario| scenario()).collect();
    let units = Unit::parse_scl(&read(SCL));
    let program = units.iter().find(|unit| unit.name == PROGRAM).unwrap();
    let missed: Vec<_> = program.lines().difference(&covered).copied().collect();
    assert_eq!(missed, Vec::<usize>::new(), "lines of {SCL}");
}
