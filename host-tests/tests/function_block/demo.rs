//! Runs PRG_WSG_DEMO of the SCL source against the virtual gripper, and compares its registers with the Rust version of the
//! same cycle, scan by scan.

use document::read;
use host_tests::gripping_cycle::{Counters, Cycle, Motion, Phase};
use wsg_fieldbus::InputImage;
use wsg_sim::{Config, Fault, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

use super::formats::SCL;
use super::structured_text::{Instance, Unit, Value};

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
        let mut program = Instance::new(&Unit::parse_scl(&read(SCL)), "PRG_WSG_DEMO");
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

    /// Ends both programs, and returns the results of the SCL program, which must equal the others.
    fn ends(mut self, phase: Phase) -> Counters {
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
        assert_eq!(counters, self.cycle.counters());
        let flags = ["Done", "GivenUp"].map(|name| self.program.get(name) == Value::Bool(true));
        assert_eq!(flags, [phase == Phase::Finished, phase == Phase::GivenUp]);
        counters
    }
}

#[test]
fn demo_program_writes_the_registers_of_the_example_with_a_part_and_without() {
    let counters = Plc::new(Part::of_width(22.0), 3).ends(Phase::Finished);
    assert_eq!(counters, Counters { cycles: 3, held: 3, homings: 1, ..Counters::default() });
    let counters = Plc::new(None, 2).ends(Phase::Finished);
    assert_eq!(counters, Counters { cycles: 2, not_found: 2, homings: 1, ..Counters::default() });
}

#[test]
fn demo_program_writes_the_registers_of_the_example_when_a_part_is_lost() {
    let mut plc = Plc::new(Part::of_width(22.0), 1);
    plc.until(Phase::Hold);
    plc.gripper.set_part(None, plc.now);
    let counters = plc.ends(Phase::Finished);
    assert_eq!(counters, Counters { cycles: 1, lost: 1, homings: 1, ..Counters::default() });
}

#[test]
fn demo_program_writes_the_registers_of_the_example_after_faults() {
    for fault in [Fault::AxisBlocked, Fault::MotorCurrent] {
        let mut plc = Plc::new(Part::of_width(22.0), 2);
        plc.until(Phase::Run(Motion::Start));
        plc.gripper.set_fault(fault, true, plc.now);
        plc.until(Phase::Clear);
        plc.gripper.set_fault(fault, false, plc.now);
        let counters = plc.ends(Phase::Finished);
        assert_eq!(counters, Counters { cycles: 2, held: 3, homings: 2, errors: 1, ..Counters::default() });
    }
    let mut plc = Plc::new(None, 1);
    plc.gripper.set_fault(Fault::MotorCurrent, true, plc.now);
    assert_eq!(plc.ends(Phase::GivenUp), Counters { errors: 3, ..Counters::default() });
}
