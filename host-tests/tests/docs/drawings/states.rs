//! docs/states.svg and the table beside it: how GSTATE goes on, as it was seen in virtual time.

use std::collections::BTreeSet;

use host_tests::document::{hold, hold_file, table};
use host_tests::modbus_bench::{Bench, FASTSTOP, GRIP, HOMING, JOG_PLUS, MOVE, RELEASE, STOP_ACK, quick};
use wsg_fieldbus::InputImage;
use wsg_protocol::SystemFlags;
use wsg_sim::{Fault, Part};

use super::svg::{Anchor, Svg};

/// From a state, for a reason, to a state.
type Transition = (&'static str, &'static str, &'static str);

/// A PLC that notes how the state goes on.
struct Watch {
    bench: Bench,
    state: &'static str,
    seen: BTreeSet<Transition>,
}

impl Watch {
    fn new(part: Option<f32>) -> Self {
        let part = part.map(|width| Part::of_width(width).unwrap());
        let bench = Bench::ready_with(wsg_bridge_fw::Config::DEFAULT, wsg_sim::Config { part, ..quick() });
        let mut watch = Self { bench, state: "", seen: BTreeSet::new() };
        watch.state = watch.look();
        watch
    }

    fn look(&mut self) -> &'static str {
        let answer = self.bench.ask(&[4, 0, 0, 0, 6]);
        let image = InputImage::from_bytes(answer[2..].try_into().unwrap());
        if image.system.contains(SystemFlags::FAST_STOP) {
            return FAST_STOP;
        }
        image.state.iter_names().next().map_or("", |(name, _)| name)
    }

    /// Lets time pass. The first change is for this reason, if there is one; each other one is the end of what came before.
    fn go_on(&mut self, mut reason: Option<&'static str>) {
        for _ in 0..GO_ON_LOOKS {
            self.note(|state| reason.take().unwrap_or_else(|| ended(state)));
        }
        assert!(!MOVING.contains(&self.state), "{} does not end", self.state);
    }

    fn note(&mut self, reason: impl FnOnce(&'static str) -> &'static str) {
        let state = self.look();
        if state != self.state {
            self.seen.insert((self.state, reason(state), state));
            self.state = state;
        }
    }

    fn write(&mut self, flag: u8, width: u16) {
        self.bench.write(0, &[u16::from(flag) << 8, width, 50_00, 40_00]);
    }

    /// Gives a command and takes its flag back.
    fn command(&mut self, name: &'static str, flag: u8, width: u16) {
        self.write(flag, width);
        let before = self.state;
        self.note(|_| name);
        self.write(0, width);
        self.go_on(match flag {
            JOG_PLUS => Some("flag back"),
            _ if self.state == before => Some(name),
            _ => None,
        });
    }

    fn set_fault(&mut self, fault: Fault, on: bool) {
        let now = self.bench.now();
        self.bench.gripper().set_fault(fault, on, now);
    }
}

/// Looks of a few milliseconds each, for what a command starts: longer than a motion of the quick gripper takes.
const GO_ON_LOOKS: usize = 1_500;

const FAST_STOP: &str = "FAST STOP";

/// Why a state came by itself.
fn ended(state: &str) -> &'static str {
    match state {
        "IDLE" => "done",
        "HOLDING" => "part held",
        "NO_PART" => "no part",
        "ERROR" => "blocked",
        state => panic!("{state} does not come by itself"),
    }
}

/// How a watch gets into a state.
type Way = (Option<f32>, fn(&mut Watch));

/// The commands that a PLC can give.
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

/// A way into each state in which the fingers stand.
const WAYS: [Way; 6] = [
    (None, home),
    (None, grip),
    (Some(20.0), grip),
    (Some(20.0), |watch| {
        grip(watch);
        let now = watch.bench.now();
        watch.bench.gripper().set_part(None, now);
        watch.go_on(Some("part gone"));
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

/// Each command in each state in which the fingers stand, and STOP/ACK and FASTSTOP in each in which they move.
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
    table(["GSTATE", a, b, c, d, e, f, g, "by itself"], rows)
}

/// A state in the picture.
const PLACES: [(&str, i32, i32); 9] = [
    ("ERROR", 175, 90),
    ("IDLE", 175, 170),
    ("NO_PART", 175, 250),
    ("HOLDING", 175, 330),
    ("PART_LOST", 175, 410),
    ("POSITIONING", 640, 110),
    ("RELEASING", 640, 210),
    ("GRIPPING", 640, 310),
    (FAST_STOP, 640, 450),
];
/// Half of a state's box.
const BOX: (i32, i32) = (65, 18);
/// The frame round the states in which the fingers stand.
const FRAME: (i32, i32, i32, i32) = (85, 40, 180, 410);

fn place(state: &str) -> (i32, i32) {
    let place = PLACES.iter().find(|place| place.0 == state);
    place.map(|(_, x, y)| (*x, *y)).unwrap_or_else(|| panic!("{state} has no place"))
}

/// What all, or all but one, of these states have in common.
fn is_shared(seen: &BTreeSet<Transition>, states: &[&str], (reason, to): (&str, &str)) -> bool {
    let others = states.iter().filter(|state| **state != to);
    others.clone().filter(|from| seen.contains(&(from, reason, to))).count() + 1 >= others.count()
}

/// What a command does in IDLE and in no other state in which the fingers stand.
fn is_of_idle_alone(seen: &BTreeSet<Transition>, (reason, to): (&str, &str)) -> bool {
    let mut from = STANDING.iter().filter(|from| seen.contains(&(from, reason, to)));
    MOVING.contains(&to) && from.next() == Some(&"IDLE") && from.next().is_none()
}

fn draw(seen: &BTreeSet<Transition>) -> String {
    let mut svg = Svg::new(860, 500, "How GSTATE goes on: commands and the ends of motions");
    let words = "fill=\"#444\" font-size=\"12\"";
    let given = "fill=\"none\" stroke=\"#1a5fb4\" stroke-width=\"2\" marker-end=\"url(#arrow)\"";
    let line = "fill=\"none\" stroke=\"#444\" stroke-width=\"1.5\" marker-end=\"url(#arrow)\"";
    let (x, y, width, height) = FRAME;
    svg.rect((x, y), (width, height), "fill=\"#f7f7f2\" stroke=\"#998\" stroke-dasharray=\"4 3\"");
    svg.text((x + 8, y + 18), Anchor::Start, words, "the fingers stand");
    for (name, x, y) in PLACES {
        let fill = if name == FAST_STOP || name == "ERROR" { "#fbe9e7" } else { "#eef3fa" };
        svg.rect(
            (x - BOX.0, y - BOX.1),
            (2 * BOX.0, 2 * BOX.1),
            &format!("fill=\"{fill}\" stroke=\"#446\" stroke-width=\"1.5\""),
        );
        svg.text((x, y + 5), Anchor::Middle, "font-weight=\"bold\"", name);
    }
    // What a command does wherever the fingers stand: one arrow from the frame.
    let shared: BTreeSet<_> = seen
        .iter()
        .map(|(_, reason, to)| (*reason, *to))
        .filter(|edge| MOVING.contains(&edge.1) && is_shared(seen, &STANDING, *edge))
        .collect();
    for state in MOVING {
        let names: Vec<String> = COMMANDS
            .iter()
            .filter_map(|(name, _)| match (*name, state) {
                edge if shared.contains(&edge) => Some((*name).to_owned()),
                edge if is_of_idle_alone(seen, edge) => Some(format!("{name} in IDLE")),
                _ => None,
            })
            .collect();
        let (x, y) = place(state);
        let (from, to) = (FRAME.0 + FRAME.2, x - BOX.0);
        svg.path(&format!("M{from} {}H{to}", y - 10), given);
        svg.text((to - 18, y - 15), Anchor::End, words, &names.join(", "));
    }
    // What it does wherever they are: an arrow out of nowhere.
    let everywhere: Vec<&str> = STANDING.iter().chain(&MOVING).copied().collect();
    assert!(is_shared(seen, &everywhere, ("FASTSTOP", FAST_STOP)));
    assert!(is_shared(seen, &everywhere, ("STOP/ACK", "IDLE")));
    let (x, y) = place(FAST_STOP);
    svg.path(&format!("M{} {y}H{}", x + 200, x + BOX.0), given);
    svg.text((x + 212, y - 10), Anchor::End, words, "FASTSTOP, everywhere");
    let (x, y) = place("IDLE");
    svg.path(&format!("M5 {y}H{}", x - BOX.0), given);
    svg.text((5, y - 22), Anchor::Start, words, "STOP/ACK,");
    svg.text((5, y - 8), Anchor::Start, words, "everywhere");
    // All that is left, from box to box.
    let mut left: Vec<(&str, &str, Vec<&str>)> = Vec::new();
    for (from, reason, to) in seen {
        let is_drawn = shared.contains(&(*reason, *to))
            || is_of_idle_alone(seen, (*reason, *to))
            || [("FASTSTOP", FAST_STOP), ("STOP/ACK", "IDLE")].contains(&(*reason, *to));
        if is_drawn {
            continue;
        }
        match left.iter_mut().find(|edge| (edge.0, edge.1) == (*from, *to)) {
            Some(edge) => edge.2.push(reason),
            None => left.push((from, to, vec![reason])),
        }
    }
    for (from, to, reasons) in left {
        let ((x0, y0), (x1, y1)) = (place(from), place(to));
        if x0 == x1 {
            let down = if y1 > y0 { BOX.1 } else { -BOX.1 };
            svg.path(&format!("M{x0} {}V{}", y0 + down, y1 - down), line);
            svg.text((x0 + 8, (y0 + y1) / 2 + 4), Anchor::Start, words, &reasons.join(", "));
        } else {
            assert!(x0 > x1, "{from} to {to} has no way in the picture");
            let (x0, y0, x1) = (x0 - BOX.0, y0 + 8, x1 + BOX.0);
            svg.path(&format!("M{x0} {y0}L{x1} {y1}"), line);
            // A third of the way, above the line.
            let (x, y) = (x0 - (x0 - x1) / 3, y0 + (y1 - y0) / 3);
            svg.text((x, y + 16), Anchor::Middle, words, &reasons.join(", "));
        }
    }
    svg.finish()
}

#[test]
fn states_in_the_document_follow_one_another_as_they_were_seen_to() {
    let seen = record();
    hold("docs/grip-cycle.md", "states", &next_states(&seen));
    hold_file("docs/states.svg", &draw(&seen));
}
