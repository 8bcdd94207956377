//! Runs the function block of docs/FB_WSG_GRIP.st in an interpreter with a simulated PLC, against the bridge and the virtual
//! gripper in virtual time.

mod demo;
mod formats;
mod l5x;
mod structured_text;

use std::collections::BTreeSet;

use document::read;
use host_tests::world::modbus::Master;
use host_tests::world::plc;
use host_tests::world::{canopen, profibus, quick};
use structured_text::{Instance, Unit, Value};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::io::Inputs;
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::CommandId;
use wsg_sim::{Fault, Part};

/// Cycle time of the PLC.
const SCAN_MS: i64 = 10;

fn units() -> [Unit; 2] {
    [Unit::parse(&read("docs/FB_WSG_GRIP.st")), Unit::parse(&read("docs/PRG_WSG_MODBUS.st"))]
}

/// A PLC that runs the program, with a Modbus master that exchanges the registers in its own cycle.
struct Plc {
    program: Instance,
    rig: Master,
    now_ms: i64,
    /// Period of the exchange, in cycles of the PLC.
    exchange_every: i64,
    is_unplugged: bool,
}

impl Plc {
    fn new(part: Option<f32>, exchange_every: i64) -> Self {
        let part = part.map(|width| Part::of_width(width).unwrap());
        let gripper = wsg_sim::Config { part, ..quick() };
        let mut rig = Master::new(Config::DEFAULT, gripper);
        // The wire is low until the plant is ready, so there is a FAST STOP at power-up.
        rig.set(Inputs::FAST_STOP_OK, false);
        rig.pass(300);
        rig.set(Inputs::FAST_STOP_OK, true);
        let program = Instance::new(&units(), "PRG_WSG_MODBUS");
        Self { program, rig, now_ms: 0, exchange_every, is_unplugged: false }
    }

    /// Like `new`, but acknowledged and homed.
    fn homed(part: Option<f32>, exchange_every: i64) -> Self {
        let mut plc = Self::new(part, exchange_every);
        plc.until("Error");
        plc.press("StopAck");
        plc.until("Ready");
        plc.press("Home");
        plc.until("Done");
        plc.rig.take_sent();
        plc
    }

    fn exchange(&mut self) {
        let answer = self.rig.ask(&[4, 0, 0, 0, 6]);
        // After an exception, a master keeps its previous registers.
        if answer[0] == 4 {
            for (name, word) in ["In0", "In1", "In2", "In3", "In4", "In5"].iter().zip(answer[2..].chunks(2)) {
                let word = u16::from_be_bytes([word[0], word[1]]);
                self.program.set(name, Value::Bits(16, word.into()));
            }
        }
        let image: Vec<u16> = ["Out0", "Out1", "Out2", "Out3"].map(|name| self.word(name)).to_vec();
        self.rig.write(0, &image);
    }

    fn word(&self, name: &str) -> u16 {
        let Value::Bits(16, word) = self.program.get(name) else { panic!("{name} is not a WORD") };
        u16::try_from(word).unwrap()
    }

    /// Runs one cycle of the PLC.
    fn scan(&mut self) {
        let before = self.rig.now().as_micros();
        if !self.is_unplugged && (self.now_ms / SCAN_MS) % self.exchange_every == 0 {
            self.exchange();
        }
        self.program.scan(self.now_ms);
        let took_ms = i64::try_from((self.rig.now().as_micros() - before) / 1_000).unwrap();
        assert!(took_ms <= SCAN_MS);
        self.rig.pass(u32::try_from(SCAN_MS - took_ms).unwrap());
        self.now_ms += SCAN_MS;
    }

    fn pass(&mut self, ms: i64) {
        for _ in 0..ms / SCAN_MS {
            self.scan();
        }
    }

    /// Returns an output of the function block.
    fn is(&self, output: &str) -> bool {
        let Value::Bool(value) = self.program.get(&format!("Gripper.{output}")) else { panic!("{output}") };
        value
    }

    fn error_status(&self) -> Value {
        self.program.get("Gripper.ErrorStatus")
    }

    #[track_caller]
    fn until(&mut self, output: &str) {
        for _ in 0..7_000 {
            if self.is(output) {
                return;
            }
            self.scan();
        }
        panic!("no {output}: step {:?}, {:?}", self.program.get("Gripper.Step"), self.program.get("In0"));
    }

    fn set(&mut self, button: &str, is_pressed: bool) {
        self.program.set(button, Value::Bool(is_pressed));
    }

    /// Presses a button for two cycles of the PLC, so that the function block detects it.
    fn press(&mut self, button: &str) {
        self.set(button, true);
        self.pass(2 * SCAN_MS);
        self.set(button, false);
        self.pass(SCAN_MS);
    }

    fn set_fault(&mut self, fault: Fault, on: bool) {
        let now = self.rig.now();
        self.rig.gripper().set_fault(fault, on, now);
    }

    fn width(&mut self) -> f32 {
        self.rig.gripper().state().width
    }

    /// Returns the executed lines of the function block.
    fn covered(&self) -> BTreeSet<usize> {
        self.program.block("Gripper").covered.clone()
    }
}

/// Bus cycles: as fast as the PLC's, and the slowest that BusTime permits.
const EXCHANGES: [i64; 2] = [1, 5];

fn grip_cycle(exchange_every: i64) -> Plc {
    let mut plc = Plc::new(Some(20.0), exchange_every);
    plc.until("Error");
    assert_eq!(plc.rig.take_motions(), []);
    plc.press("StopAck");
    plc.until("Ready");
    assert!(!plc.is("Error"));
    plc.press("Home");
    assert!(plc.is("Busy") && !plc.is("Ready"));
    plc.pass(200);
    assert_eq!(plc.word("Out0"), 0, "the flag is reset after the motion has started");
    plc.until("Done");
    for _ in 0..3 {
        plc.press("Grip");
        assert!(!plc.is("Done"));
        plc.until("Done");
        assert!(plc.is("Holding") && plc.is("Ready") && !plc.is("NoPart"));
        plc.press("Release");
        plc.until("Done");
        assert!(!plc.is("Holding") && (plc.width() - 40.0).abs() < 0.5);
    }
    let cycle = [CommandId::GripPart, CommandId::ReleasePart].repeat(3);
    assert_eq!(plc.rig.take_motions(), [&[CommandId::Homing], &cycle[..]].concat());
    plc
}

fn grip_cycles() -> Plc {
    let [_, slow] = EXCHANGES.map(grip_cycle);
    slow
}

fn no_part() -> Plc {
    let mut plc = Plc::homed(None, 5);
    plc.press("Grip");
    plc.until("Done");
    assert!(plc.is("NoPart") && !plc.is("Holding") && !plc.is("Error"));
    // The fingers are already at the target of GRIP, so the motion ends before a poll sees it. Every GRIP is still sent.
    plc.rig.take_motions();
    for _ in 0..4 {
        plc.press("Grip");
        plc.until("Done");
        assert!(plc.is("NoPart"));
    }
    assert_eq!(plc.rig.take_motions(), [CommandId::GripPart; 4]);
    plc.press("Release");
    plc.until("Done");
    assert!(!plc.is("NoPart"));
    plc
}

fn part_lost() -> Plc {
    let mut plc = Plc::homed(Some(20.0), 1);
    plc.press("Grip");
    plc.until("Holding");
    plc.until("Done");
    let now = plc.rig.now();
    plc.rig.gripper().set_part(None, now);
    plc.until("PartLost");
    assert!(!plc.is("Holding") && !plc.is("Error") && plc.is("Ready"));
    plc.press("Release");
    plc.until("Done");
    assert!(!plc.is("PartLost"));
    plc
}

fn fault_and_acknowledge() -> Plc {
    let mut plc = Plc::homed(Some(20.0), 5);
    plc.set_fault(Fault::MotorCurrent, true);
    plc.until("Error");
    // The fault persists, so the function block waits for some time until it disappears.
    plc.press("StopAck");
    plc.pass(1_000);
    assert!(plc.is("Busy"));
    plc.pass(2_000);
    assert!(plc.is("Error") && !plc.is("Busy"));
    plc.set_fault(Fault::MotorCurrent, false);
    plc.press("StopAck");
    plc.until("Ready");
    assert!(!plc.is("Error"));
    plc.press("Grip");
    plc.until("Done");
    assert!(plc.is("Holding"));
    plc
}

fn not_referenced() -> Plc {
    let mut plc = Plc::new(None, 5);
    plc.until("Error");
    plc.press("StopAck");
    plc.until("Ready");
    plc.press("Grip");
    plc.until("Error");
    assert_eq!(plc.error_status(), Value::Int(3), "E_NOT_INITIALIZED");
    // Without Ready, the edge is ignored.
    plc.press("Home");
    plc.pass(1_000);
    assert_eq!(plc.rig.take_motions(), [CommandId::GripPart]);
    plc.press("StopAck");
    plc.until("Ready");
    plc.press("Home");
    plc.until("Done");
    plc
}

fn fast_stop() -> Plc {
    let mut plc = Plc::homed(None, 5);
    plc.press("FastStop");
    assert!(!plc.is("Done"));
    plc.until("Error");
    plc.press("StopAck");
    plc.until("Ready");
    plc.rig.take_sent();
    plc.press("Release");
    plc.until("Done");
    plc.press("Home");
    plc.set("FastStop", true);
    plc.pass(100);
    assert!(!plc.is("Ready") && plc.rig.take_sent().contains(&CommandId::FastStop));
    // No acknowledgement is sent while FastStop is set.
    plc.press("StopAck");
    plc.pass(1_000);
    assert!(!plc.rig.take_sent().contains(&CommandId::Acknowledge));
    plc.set("FastStop", false);
    plc.until("Error");
    plc.press("StopAck");
    plc.until("Ready");
    // A pulse shorter than the bus cycle, directly after an exchange.
    plc.rig.take_sent();
    while plc.now_ms % 50 != SCAN_MS {
        plc.scan();
    }
    plc.set("FastStop", true);
    plc.scan();
    plc.set("FastStop", false);
    plc.until("Error");
    assert!(plc.rig.take_sent().contains(&CommandId::FastStop));
    plc.press("StopAck");
    plc.until("Ready");
    plc
}

fn stop() -> Plc {
    let mut plc = Plc::homed(Some(20.0), 5);
    plc.press("Grip");
    plc.until("Done");
    // The second press occurs while the flag of the first is 1. Without a 0 in between, there is no edge.
    plc.press("StopAck");
    plc.pass(50);
    assert_eq!(plc.word("Out0"), 0x1000);
    plc.press("StopAck");
    assert!(plc.is("Busy") && plc.word("Out0") == 0);
    plc.until("Ready");
    assert!(!plc.is("Holding") && !plc.is("Done") && !plc.is("Error"));
    let stops = plc.rig.take_sent().into_iter().filter(|id| *id == CommandId::Stop).count();
    assert_eq!(stops, 2);
    // Repeat as soon as the block is Ready, on a slow bus.
    for _ in 0..3 {
        plc.press("StopAck");
        plc.until("Ready");
        assert_eq!(plc.rig.take_sent().into_iter().filter(|id| *id == CommandId::Stop).count(), 1);
    }
    plc
}

fn parameters_change() -> Plc {
    let mut plc = Plc::homed(None, 1);
    plc.press("Grip");
    // The parameters change during the motion. Forwarding them would cause a FAST STOP.
    for dial in ["GripWidth", "Speed", "ForceLimit"] {
        plc.program.set(dial, Value::Int(15_00));
    }
    plc.until("Done");
    assert!(!plc.rig.take_sent().contains(&CommandId::FastStop));
    plc
}

fn bus_is_cut() -> Plc {
    let mut plc = Plc::homed(None, 1);
    plc.press("Release");
    plc.is_unplugged = true;
    plc.until("Error");
    assert!(plc.now_ms >= 65_000, "a motion may take a minute");
    plc.is_unplugged = false;
    plc.pass(500);
    // The bridge stopped the motion when polling ceased. No motion starts without a command.
    plc.rig.take_motions();
    plc.pass(2_000);
    assert_eq!(plc.rig.take_motions(), []);
    plc.press("StopAck");
    plc.until("Ready");
    plc
}

fn wrong_place() -> Plc {
    let mut plc = Plc::homed(None, 1);
    // A wire stops the motion without the function block. The fingers stand in a wrong position without an error.
    for motion in ["Grip", "Release", "Home"] {
        plc.press(motion);
        plc.rig.set(Inputs::STOP_ACK, true);
        plc.pass(50);
        plc.rig.set(Inputs::STOP_ACK, false);
        plc.until("Error");
        plc.press("StopAck");
        plc.until("Ready");
    }
    plc
}

fn buttons_that_stay() -> Plc {
    let mut plc = Plc::homed(Some(20.0), 1);
    for (button, output, id) in [
        ("Grip", "Done", CommandId::GripPart),
        ("Release", "Done", CommandId::ReleasePart),
        ("Home", "Done", CommandId::Homing),
        ("StopAck", "Ready", CommandId::Stop),
    ] {
        plc.rig.take_sent();
        plc.set(button, true);
        plc.pass(2 * SCAN_MS);
        plc.until(output);
        plc.pass(3_000);
        plc.set(button, false);
        plc.pass(SCAN_MS);
        assert!(plc.is("Ready"));
        let sent = plc.rig.take_sent().into_iter().filter(|sent| *sent == id).count();
        assert_eq!(sent, 1, "{button}");
    }
    plc
}

fn refused_meanwhile() -> Plc {
    let mut plc = Plc::homed(None, 1);
    plc.press("Release");
    // The edge of another source is refused. Its status code does not belong to the motion.
    plc.rig.set(Inputs::HOME, true);
    plc.pass(50);
    plc.rig.set(Inputs::HOME, false);
    plc.until("Done");
    assert!((plc.width() - 40.0).abs() < 0.5 && !plc.is("Error"));
    assert_eq!(plc.rig.take_motions(), [CommandId::ReleasePart]);
    plc
}

/// Runs the function block alone, with the image of a bus at its inputs and outputs.
fn grip_cycle_over<P: plc::Plc>() {
    let gripper = wsg_sim::Config { part: Part::of_width(20.0), ..quick() };
    let mut plc = P::connect(P::CONFIG, gripper, OutputImage::ZERO);
    let mut block = Instance::new(&units(), "FB_WSG_GRIP");
    let int = |block: &Instance, name: &str| {
        let Value::Int(value) = block.get(name) else { panic!("{name}") };
        value
    };
    let mut now_ms = 0;
    let mut scan = |plc: &mut P, block: &mut Instance| {
        let input = plc.read();
        block.set("GState", Value::Bits(8, input.state.bits().into()));
        block.set("SysState", Value::Bits(32, input.system.bits().into()));
        block.set("StatusCode", Value::Int(input.status.code().into()));
        block.set("Width", Value::Int(input.width.into()));
        block.scan(now_ms);
        now_ms += SCAN_MS;
        let Value::Bits(8, flags) = block.get("CmdFlags") else { panic!("CmdFlags is not a BYTE") };
        *plc.image() = OutputImage {
            flags: CommandFlags::from_bits_retain(flags as u8),
            user: 0,
            width: int(block, "WidthOut") as i16,
            speed: int(block, "SpeedOut") as u16,
            force_limit: int(block, "ForceOut") as i16,
        };
        plc.write();
        plc.run(u32::try_from(SCAN_MS).unwrap());
    };
    let steps = [
        ("StopAck", "Ready", false),
        ("Home", "Done", false),
        ("Grip", "Done", true),
        ("Release", "Done", false),
        ("Grip", "Done", true),
    ];
    for (button, output, holds) in steps {
        block.set(button, Value::Bool(true));
        scan(&mut plc, &mut block);
        block.set(button, Value::Bool(false));
        let ended = (0..5_000).any(|_| {
            scan(&mut plc, &mut block);
            block.get(output) == Value::Bool(true)
        });
        assert!(ended, "{button}: {block:?}");
        assert_eq!((block.get("Error"), block.get("Holding")), (Value::Bool(false), Value::Bool(holds)));
    }
    let motions = [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart, CommandId::GripPart];
    assert_eq!(plc.world().take_motions(), motions);
}

#[test]
fn grip_cycle_over_canopen() {
    grip_cycle_over::<canopen::Master>();
}

#[test]
fn grip_cycle_over_profibus() {
    grip_cycle_over::<profibus::Master>();
}

/// Generates a test for each scenario, and the list of all scenarios.
macro_rules! scenarios {
    ($($test:ident: $scenario:expr;)*) => {
        $(
            #[test]
            fn $test() {
                $scenario();
            }
        )*

        const SCENARIOS: &[fn() -> Plc] = &[$($scenario),*];
    };
}

scenarios! {
    homing_grip_and_release: grip_cycles;
    missing_part_is_a_result: no_part;
    lost_part_shows_and_is_released: part_lost;
    fault_is_an_error_until_it_is_gone_and_acknowledged: fault_and_acknowledge;
    command_before_homing_is_an_error_with_its_status: not_referenced;
    fast_stop_comes_first_and_waits_to_be_acknowledged: fast_stop;
    stop_lets_go_of_the_part: stop;
    parameters_stay_while_the_fingers_move: parameters_change;
    cut_bus_ends_the_command_in_an_error: bus_is_cut;
    motion_that_somebody_else_stopped_is_an_error: wrong_place;
    button_that_stays_pressed_gives_one_command: buttons_that_stay;
    motion_goes_on_to_its_end_while_other_commands_are_refused: refused_meanwhile;
}

#[test]
fn every_line_of_the_function_block_is_run_by_the_scenarios() {
    let covered: BTreeSet<usize> = SCENARIOS.iter().flat_map(|scenario| scenario().covered()).collect();
    let [block, _] = units();
    let missed: Vec<_> = block.lines().difference(&covered).copied().collect();
    assert_eq!(missed, Vec::<usize>::new(), "lines of docs/FB_WSG_GRIP.st");
}
