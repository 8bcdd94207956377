//! What every way in to a gripper can do, and a worker for those that wait for their answers.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::Duration;

/// Speed of all motions in mm/s: they outlast every measurement.
pub(crate) const SPEED: f32 = 20.0;

/// A request of a user.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Verb {
    Home,
    /// To this width in mm.
    Move(f32),
    /// A part of this width in mm with this force in N.
    Grip(f32, f32),
    FastStop,
    Acknowledge,
    /// Reads the opening width.
    Read,
}

/// The result for the user: an answer, or an error with its reason.
pub(crate) type Outcome = Result<String, String>;

/// A way in to a gripper.
pub(crate) trait Surface {
    /// Requests something, without waiting for the gripper, and returns where the outcome arrives.
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome>;

    /// Returns the longest time that the machine kept the surface's own process from running since the last call.
    fn stall(&mut self) -> Duration {
        Duration::ZERO
    }
}

/// Runs each request in a thread of its own, for surfaces whose users start a process or a connection for each.
pub(crate) struct Separately<F>(pub(crate) F);

impl<F: Fn(Verb) -> Outcome + Clone + Send + 'static> Surface for Separately<F> {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        let (sender, outcome) = channel();
        let act = self.0.clone();
        // The test may have ended.
        thread::spawn(move || sender.send(act(verb)).ok());
        outcome
    }
}

/// Runs the requests in turn in one thread, which owns the gripper. FAST STOP goes past it where the surface offers a way.
pub(crate) struct InTurn {
    requests: Sender<(Verb, Sender<Outcome>)>,
    fast_stop: Option<Box<dyn Fn() -> Outcome>>,
}

impl InTurn {
    /// `act` is created in the thread, after which `fast_stop` stops its gripper.
    pub(crate) fn new<S: 'static + Fn() -> Outcome + Send, A: FnMut(Verb) -> Outcome>(
        open: impl FnOnce() -> (A, Option<S>) + Send + 'static,
    ) -> Self {
        let (requests, received) = channel::<(Verb, Sender<Outcome>)>();
        let (opened, opening) = channel();
        thread::spawn(move || {
            let (mut act, fast_stop) = open();
            // The test waits for it.
            let _ = opened.send(fast_stop);
            for (verb, answer) in received {
                let _ = answer.send(act(verb));
            }
        });
        let fast_stop = opening.recv().expect("the surface connects");
        Self { requests, fast_stop: fast_stop.map(|it| Box::new(it) as _) }
    }
}

impl Surface for InTurn {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        let (sender, outcome) = channel();
        match (verb, &self.fast_stop) {
            (Verb::FastStop, Some(fast_stop)) => sender.send(fast_stop()).expect("its receiver is here"),
            _ => self.requests.send((verb, sender)).expect("the worker runs while the surface exists"),
        }
        outcome
    }
}
