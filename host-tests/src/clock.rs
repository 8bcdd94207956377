//! The time that a virtual gripper beside an emulated board goes by: the wall's, or the machine's.
//!
//! QEMU takes bytes as fast as they come, and its time is close enough to the wall's. Lines of the Pico's emulator have their
//! rates, and on a busy host its time is slower than the wall's: a gripper that went by the wall would send more than its line
//! carries, and one that waits for a processor would be late. So that machine tells its time, and waits until everybody who
//! goes by it has come up to it.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What somebody does each time that the machine has told its time; `false`: that was the last time.
type Follower = Box<dyn FnMut() -> bool + Send>;

/// A clock; clones are the same one.
#[derive(Clone, Debug)]
pub struct Clock(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Wall(Instant),
    Machine(Arc<Machine>),
}

#[derive(Default)]
struct Machine {
    micros: AtomicU64,
    followers: Mutex<Vec<Follower>>,
}

impl Clock {
    /// The clock on the wall.
    #[must_use]
    pub fn wall() -> Self {
        Self(Kind::Wall(Instant::now()))
    }

    /// A clock that stands until it is [told](Self::tell).
    #[must_use]
    pub fn of_machine() -> Self {
        Self(Kind::Machine(Arc::default()))
    }

    /// Time since some moment before.
    #[must_use]
    pub fn now(&self) -> Duration {
        match &self.0 {
            Kind::Wall(start) => start.elapsed(),
            Kind::Machine(machine) => Duration::from_micros(machine.micros.load(Ordering::Acquire)),
        }
    }

    /// The machine's time is this now; returns when all who follow it have done what they do then. The wall is told nothing.
    pub fn tell(&self, micros: u64) {
        if let Kind::Machine(machine) = &self.0 {
            machine.micros.store(micros, Ordering::Release);
            let mut followers = machine.followers.lock().unwrap_or_else(PoisonError::into_inner);
            followers.retain_mut(|follower| follower());
        }
    }

    /// Whether this is the clock on the wall, which tells nobody.
    #[must_use]
    pub fn is_wall(&self) -> bool {
        matches!(self.0, Kind::Wall(_))
    }

    /// Calls `follower` each time that the machine has [told](Self::tell) its time, until that returns `false`.
    pub fn follow(&self, follower: impl FnMut() -> bool + Send + 'static) {
        if let Kind::Machine(machine) = &self.0 {
            machine.followers.lock().unwrap_or_else(PoisonError::into_inner).push(Box::new(follower));
        }
    }
}

impl fmt::Debug for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Machine").field("micros", &self.micros).finish_non_exhaustive()
    }
}
