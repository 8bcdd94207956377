//! The state transitions in docs/grip-cycle.md, recorded in virtual time.

use std::collections::BTreeSet;

use document::{hold, table};
use host_tests::world::modbus::{FASTSTOP, GRIP, HOMING, JOG_PLUS, MOVE, Master, RELEASE, STOP_ACK};
use host_tests::world::quick;
use wsg_fieldbus::InputImage;
use wsg_protocol::SystemFlags;
use wsg_sim::{Fault, Part};

/// A previous state, the cause of the change, and the next state.
type Transition = (&'static str, &'static str, &'static str);

/// A PLC that records transitions between states.
struct Watch {
    rig: Master,
    state: &'static str,
    seen: BTreeSet<Transition>,
}

impl Watch {
    fn new(part: Option<f32>) -> Self {
        let part = part.map(|width| Part::of_width(width).unwrap());
        let rig = Master::ready_with(wsg_bridge_fw::Config::DEFAULT, wsg_sim::Config { part, ..quick() });
        let mut watch = Self { rig, state: "", seen: BTreeSet::new() };
        watch.state = watch.look();
        watch
    }

    fn look(&mut self) -> &'static str {
        let answer = self.rig.ask(&[4, 0, 0, 0, 6]);
        let image = InputImage::from_bytes(answer[2..].try_into().unwrap());
        if image.system.contains(SystemFlags::FAST_STOP) {
            return FAST_STOP;
        }
        image.state.iter_names().next().map_or("", |(name, _)| name)
    }

    /// Lets time pass. `reason` is the cause of the first change; each other change is caused by the end of the previous state.
    fn go_on(&mut self, mut reason: Option<&'static str>) {
        for _ in 0..GO_ON_LOOKS {
            self.note(|state| reason.take().unwrap_or_else(|| ended(state)));
        }
        assert!(!MOVING.contains(&self.state), "{} does not end within the limit", self.state);
    }

    fn note(&mut self, reason: impl FnOnce(&'static str) -> &'static str) {
        let state = self.look();
        if state != self.state {
            self.seen.insert((self.state, reason(state), state));
            self.state = state;
        }
    }

    fn write(&mut self, flag: u8, width: u16) {
        self.rig.write(0, &[u16::from(flag) << 8, width, 50_00, 40_00]);
    }

    /// Issues a command and resets its flag.
    fn command(&mut self, name: &'static str, flag: u8, width: u16) {
        self.write(flag, width);
        let before = self.state;
        self.note(|_| name);
        self.write(0, width);
        self.go_on(match flag {
            JOG_PLUS => Some("flag cleared"),
            _ if self.state == before => Some(name),
            _ => None,
        });
    }

    fn set_fault(&mut self, fault: Fault, on: bool) {
        let now = self.rig.now();
        self.rig.gripper().set_fault(fault, on, now);
    }
}

/// Number of polls, a few milliseconds each, for the effects of a command. Exceeds every motion of the quick gripper.
const GO_ON_LOOKS: usize = 1_500;

const FAST_STOP: &str = "FAST STOP";

/// Returns the cause of a state that follows without a command.
fn ended(state: &str) -> &'static str {
    match state {
        "IDLE" => "done",
        "HOLDING" => "part held",
        "NO_PART" => "no part",
        "ERROR" => "blocked",
        state => panic!("{state} requires a command"),
    }
}

/// A part between the fingers, and steps that lead to a state.
type Way = (Option<f32>, fn(&mut Watch));

const COMMANDS: [(&str, u8); 7] = [
    ("HOMING", HOMING),
    ("MOVE", MOVE),
    ("GRIP", GRIP),
    ("RELEASE", RELEASE),
    ("JOG", JOG_PLUS),
    ("STOP/ACK", STOP_ACK),
    ("FASTSTOP", FASTSTOP),
];

fn home(watch: &mut Watch) {
    watch.command("HOMING", HOMING, 0);
    watch.command("MOVE", MOVE, 80_00);
}

fn grip(watch: &mut Watch) {
    home(watch);
    watch.command("GRIP", GRIP, 20_00);
}

/// One sequence for each state at standstill.
const WAYS: [Way; 6] = [
    (None, home),
    (None, grip),
    (Some(20.0), grip),
    (Some(20.0), |watch| {
        grip(watch);
        let now = watch.rig.now();
        watch.rig.gripper().set_part(None, now);
        watch.go_on(Some("part removed"));
    }),
    (None, |watch| {
        home(watch);
        watch.write(MOVE, 40_00);
        watch.note(|_| "MOVE");
        watch.set_fault(Fault::AxisBlocked, true);
        watch.write(0, 40_00);
        watch.go_on(Some("blocked"));
        watch.set_fault(Fault::AxisBlocked, false);
    }),
    (None, |watch| {
        home(watch);
        watch.command("FASTSTOP", FASTSTOP, 80_00);
    }),
];

/// Records each command in each state at standstill, and STOP/ACK and FASTSTOP in each state of motion.
fn record() -> BTreeSet<Transition> {
    let mut seen = BTreeSet::new();
    for (part, way) in WAYS {
        for (name, flag) in COMMANDS {
            let mut watch = Watch::new(part);
            way(&mut watch);
            watch.command(name, flag, if flag == GRIP { 20_00 } else { 60_00 });
            seen.extend(watch.seen);
        }
    }
    for (name, flag) in COMMANDS {
        for (end, ends) in [("STOP/ACK", STOP_ACK), ("FASTSTOP", FASTSTOP)] {
            let mut watch = Watch::new(None);
            home(&mut watch);
            watch.write(flag, 20_00);
            watch.note(|_| name);
            let moves = MOVING.contains(&watch.state);
            watch.write(0, 20_00);
            if moves && flag != JOG_PLUS {
                watch.command(end, ends, 20_00);
                seen.extend(watch.seen);
            }
        }
    }
    seen
}

const STANDING: [&str; 5] = ["IDLE", "HOLDING", "NO_PART", "PART_LOST", "ERROR"];
const MOVING: [&str; 3] = ["POSITIONING", "GRIPPING", "RELEASING"];

fn next_states(seen: &BTreeSet<Transition>) -> String {
    let rows = STANDING.iter().chain(&[FAST_STOP]).chain(&MOVING).map(|state| {
        let next = COMMANDS.map(|(name, _)| {
            let next = seen.iter().find(|(from, reason, _)| from == state && *reason == name);
            next.map_or_else(String::new, |(_, _, to)| (*to).to_owned())
        });
        let [homing, moves, grip, release, jog, stop, fast_stop] = next;
        let itself = seen
            .iter()
            .filter(|(from, reason, _)| from == state && COMMANDS.iter().all(|(name, _)| name != reason));
        let itself: Vec<String> = itself.map(|(_, reason, to)| format!("{reason}: {to}")).collect();
        [(*state).to_owned(), homing, moves, grip, release, jog, stop, fast_stop, itself.join(", ")]
    });
    let [a, b, c, d, e, f, g] = COMMANDS.map(|(name, _)| name);
    table(["GSTATE", a, b, c, d, e, f, g, "without a command"], rows)
}

#[test]
fn documented_states_follow_one_another_as_recorded() {
    hold("docs/grip-cycle.md", "states", &next_states(&record()));
}
