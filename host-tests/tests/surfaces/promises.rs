//! The promises, as code that judges. Each runs on a surface alone with its gripper.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

use host_tests::modbus_tcp::LATE;
use wsg_protocol::SystemFlags;

use crate::station::{BOUND, Line, STALL, Station, Way};
use crate::surface::{Outcome, Surface, Verb};
use crate::{Entry, Kind};

/// Time from the request to resting fingers in FAST STOP.
const FAST_STOP_TIME: Duration = Duration::from_millis(250);

/// Age after which a request must not start a motion.
const MAX_AGE: Duration = Duration::from_secs(1);

/// Time within which a read reports a lost connection.
const LOSS_TIME: Duration = Duration::from_secs(5);

/// Repetitions of a measurement that the machine disturbed.
const ATTEMPTS: u32 = 20;

/// Target of all motions in mm. Recipe 2 of the bridge has it as well.
const TARGET: f32 = 10.0;

/// Requests outside the limits of a WSG 50-110: stroke 110 mm, 5 to 80 N.
const OUTSIDE: [Verb; 6] = [
    Verb::Grip(20.0, 500.0),
    Verb::Grip(20.0, 80.5),
    Verb::Grip(20.0, -1.0),
    Verb::Grip(20.0, 0.0),
    Verb::Move(500.0),
    Verb::Move(-3.0),
];

/// A stall of the observer after which a driver may have lost its gripper (600 ms) or a gateway its turns (800 ms), and the number of
/// judgements after such stalls.
const DISTURBANCE: Duration = Duration::from_millis(200);
const JUDGEMENTS: u32 = 4;

/// Payload of a panic: something possible failed while the machine kept the observer from the processor, and with it perhaps the
/// gripper. A driver takes a gripper for lost that does not answer for 600 ms.
struct Disturbed(String);

/// Judges a promise, again if a disturbed machine prevented the situation that it is about.
pub(crate) fn judge(entry: &Entry, promise: fn(&Entry)) {
    for attempt in 1.. {
        let judged = catch_unwind(AssertUnwindSafe(|| promise(entry)));
        let Err(failure) = judged else { return };
        match failure.downcast::<Disturbed>() {
            Ok(disturbed) if attempt < JUDGEMENTS => {
                eprintln!("attempt {attempt}, disturbed: {}", disturbed.0)
            }
            Ok(disturbed) => panic!("in {JUDGEMENTS} attempts on a busy machine: {}", disturbed.0),
            Err(failure) => resume_unwind(failure),
        }
    }
}

/// Fails because something possible was refused or did not happen.
fn fail(station: &Station, why: String) -> ! {
    if station.stall() < DISTURBANCE { panic!("{why}") } else { resume_unwind(Box::new(Disturbed(why))) }
}

/// A surface with its gripper, referenced and wide open.
struct Rig {
    station: Station,
    surface: Box<dyn Surface>,
    kind: Kind,
}

impl Rig {
    fn homed(entry: &Entry) -> Self {
        let station = (entry.station)();
        let address = (entry.line)(&station).address;
        let opened = catch_unwind(AssertUnwindSafe(|| (entry.open)(address)));
        let surface = opened.unwrap_or_else(|_| fail(&station, "the surface does not connect".to_owned()));
        let mut rig = Self { station, surface, kind: entry.kind };
        if entry.kind == Kind::Wires {
            // FAST STOP is latched at power-up.
            rig.acknowledge();
        }
        // The answer precedes the motion on some surfaces.
        rig.succeed(Verb::Home);
        rig.station.until("referenced", |state| {
            state.flags.contains(SystemFlags::REFERENCED) && !state.flags.contains(SystemFlags::MOVING)
        });
        rig.station.measure();
        rig
    }

    fn finish(&mut self, verb: Verb) -> Outcome {
        let outcome = self.surface.begin(verb);
        outcome.recv_timeout(BOUND).unwrap_or_else(|error| panic!("{verb:?} has no outcome: {error}"))
    }

    /// Requests something that is possible. A user repeats it on a page that a busy machine keeps from its states, and a master
    /// after its time-out.
    fn succeed(&mut self, verb: Verb) {
        let start = Instant::now();
        while let Err(why) = self.finish(verb) {
            let may_repeat = self.kind == Kind::Page || why == LATE;
            if !may_repeat || start.elapsed() > BOUND {
                fail(&self.station, format!("{verb:?} is possible: {why}"));
            }
        }
    }

    /// Acknowledges until the gripper has left FAST STOP. A user repeats it, too: the confirmation of the stop may be under way.
    fn acknowledge(&mut self) {
        let start = Instant::now();
        loop {
            let outcome = self.finish(Verb::Acknowledge);
            if !self.station.state().flags.contains(SystemFlags::FAST_STOP) {
                return;
            }
            assert!(start.elapsed() < BOUND, "FAST STOP stays: {outcome:?}");
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Starts a motion that takes five seconds.
    fn start_moving(&mut self) -> Receiver<Outcome> {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < BOUND, "a possible motion is refused");
            let outcome = self.surface.begin(Verb::Move(TARGET));
            // See `succeed`.
            let is_refused = Cell::new(false);
            self.station.until("moving", |state| {
                let moves = state.flags.contains(SystemFlags::MOVING);
                if !moves && let Ok(Err(why)) = outcome.try_recv() {
                    if self.kind != Kind::Page && why != LATE {
                        fail(&self.station, format!("a motion is possible: {why}"));
                    }
                    is_refused.set(true);
                }
                moves || is_refused.get()
            });
            if !is_refused.get() {
                return outcome;
            }
        }
    }
}

/// FAST STOP acts in time while a motion runs and three reads hang, because the line holds back all answers.
pub(crate) fn fast_stop_acts(entry: &Entry) {
    let mut rig = Rig::homed(entry);
    let mut disturbed = Vec::new();
    for _ in 0..ATTEMPTS {
        let moved = rig.start_moving();
        let line = (entry.line)(&rig.station);
        line.hold(Way::Answers);
        let hanging = [(); 3].map(|()| rig.surface.begin(Verb::Read));
        rig.surface.stall();
        rig.station.measure();
        let pressed = Instant::now();
        let stopped = rig.surface.begin(Verb::FastStop);
        let stood = rig.station.until("in FAST STOP", |state| {
            state.flags.contains(SystemFlags::FAST_STOP) && !state.flags.contains(SystemFlags::MOVING)
        });
        let time = stood - pressed;
        let counts = rig.station.stall() < STALL && rig.surface.stall() < STALL;
        (entry.line)(&rig.station).release(Way::Answers);
        if counts {
            assert!(time <= FAST_STOP_TIME, "FAST STOP took {time:?}");
            return;
        }
        disturbed.push(time);
        // Each of them ends, with any outcome.
        for outcome in hanging.into_iter().chain([moved, stopped]) {
            assert_ne!(outcome.recv_timeout(BOUND), Err(RecvTimeoutError::Timeout));
        }
        rig.acknowledge();
        rig.succeed(Verb::Home);
    }
    // A busy machine adds to each time, and a defect of the product to all of them.
    let shortest = disturbed.iter().min().expect("an attempt");
    assert!(*shortest <= FAST_STOP_TIME, "FAST STOP took {disturbed:?} on a busy machine");
}

/// Connecting, reading, a lost connection, an acknowledgement and a new connection move nothing.
pub(crate) fn nothing_moves_unrequested(entry: &Entry) {
    let mut rig = Rig::homed(entry);
    let moved = rig.start_moving();
    let line = (entry.line)(&rig.station);
    line.cut();
    let _ = moved.recv_timeout(BOUND);
    line.mend();
    // A client of another interface does not own the motion, which ends as requested.
    rig.station.until("at rest", |state| !state.flags.contains(SystemFlags::MOVING));
    rig.station.catch_up();
    let since = Instant::now();
    drop(std::mem::replace(&mut rig.surface, (entry.open)((entry.line)(&rig.station).address)));
    // Dropping a client that has not noticed the loss changes nothing either.
    if rig.station.state().flags.contains(SystemFlags::FAST_STOP) {
        rig.acknowledge();
    }
    for _ in 0..3 {
        let _ = rig.finish(Verb::Read);
    }
    thread::sleep(2 * FAST_STOP_TIME);
    let ages: Vec<_> = rig.station.travels_since(since).iter().map(|travel| *travel - since).collect();
    assert_eq!(ages, Vec::<Duration>::new(), "the fingers moved without a request");
}

/// A motion that was requested while the line held back all answers starts within a second or not at all. So does one of the
/// page while the line held back its requests or was cut, because it names the state that its user saw.
pub(crate) fn nothing_old_runs(entry: &Entry) {
    type Act = fn(&Line);
    let all: [(Act, Act); 3] = [
        (|line| line.hold(Way::Answers), |line| line.release(Way::Answers)),
        (|line| line.hold(Way::Requests), |line| line.release(Way::Requests)),
        (Line::cut, Line::mend),
    ];
    let is_page = entry.kind == Kind::Page;
    for (begin, end) in &all[..if is_page { 3 } else { 1 }] {
        let mut rig = Rig::homed(entry);
        begin((entry.line)(&rig.station));
        let hanging = rig.surface.begin(Verb::Read);
        let late = rig.surface.begin(Verb::Move(TARGET));
        let requested = Instant::now();
        thread::sleep(MAX_AGE + FAST_STOP_TIME);
        end((entry.line)(&rig.station));
        for outcome in [hanging, late] {
            assert_ne!(outcome.recv_timeout(BOUND), Err(RecvTimeoutError::Timeout));
        }
        if is_page {
            // It connects again.
            rig.succeed(Verb::Read);
        }
        thread::sleep(FAST_STOP_TIME);
        for travel in rig.station.travels_since(requested) {
            let age = travel - requested;
            assert!(age <= MAX_AGE, "a motion started {age:?} after its request");
        }
    }
}

/// A number outside the limits is refused with a reason. Nothing is sent, nothing moves, and the force limit stays.
pub(crate) fn refusal_changes_nothing(entry: &Entry) {
    if entry.kind == Kind::Wires {
        // Recipes have the numbers: see the tests of the settings.
        return;
    }
    let mut rig = Rig::homed(entry);
    let limit = rig.station.state().force_limit;
    for verb in OUTSIDE {
        if entry.kind == Kind::Fieldbus && matches!(verb, Verb::Move(_)) {
            // The gripper limits a width itself (command set, 3.2.2), and the register interface leaves it to the gripper.
            continue;
        }
        let _ = rig.station.tcp.take_effective();
        let _ = (entry.line)(&rig.station).take_posts();
        let since = Instant::now();
        let refused = rig.finish(verb);
        let why = refused.expect_err(&format!("{verb:?} is outside the limits"));
        assert!(!why.trim().is_empty(), "{verb:?} is refused without a reason");
        let state = rig.station.state();
        assert_eq!(state.force_limit, limit, "{verb:?} left a force limit: {why}");
        assert_eq!(rig.station.travels_since(since).len(), 0, "{verb:?} moved the fingers");
        assert_eq!(rig.station.tcp.take_effective(), [], "{verb:?} was sent");
        if entry.kind == Kind::Page {
            assert_eq!((entry.line)(&rig.station).take_posts(), 0, "{verb:?} was sent to the server");
        }
        match entry.kind {
            Kind::Fieldbus if state.flags.contains(SystemFlags::FAST_STOP) => rig.acknowledge(),
            _ => assert!(!state.flags.contains(SystemFlags::FAST_STOP), "{verb:?} led to FAST STOP"),
        }
    }
}

/// After the line is cut, or answers nothing, a read fails.
pub(crate) fn lost_connection_shows(entry: &Entry) {
    for is_cut in [true, false] {
        let mut rig = Rig::homed(entry);
        rig.succeed(Verb::Read);
        let line = (entry.line)(&rig.station);
        if is_cut {
            line.cut()
        } else {
            line.hold(Way::Answers)
        }
        let lost = Instant::now();
        loop {
            // One read may have been answered before.
            let read = rig.surface.begin(Verb::Read).recv_timeout(LOSS_TIME);
            match read {
                Ok(Err(_)) => break,
                // A caller that still waits has received no old value.
                Err(RecvTimeoutError::Timeout) => break,
                _ => {}
            }
            assert!(lost.elapsed() < LOSS_TIME, "{read:?} is read {:?} after the loss", lost.elapsed());
            thread::sleep(Duration::from_millis(20));
        }
    }
}
