//! Clock of a virtual gripper on an emulated board: wall clock or machine time.
//!
//! QEMU accepts bytes at any speed, and its time roughly matches the wall clock. The Pico's emulator models bit
//! rates, and on a busy host its time runs slower than the wall clock. A gripper on wall-clock time would then exceed
//! the line's capacity, and one that waits for a processor would be late. That machine therefore publishes its time,
//! and waits until all followers have caught up.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Called whenever the machine publishes its time, until it returns `false`.
type Follower = Box<dyn FnMut() -> bool + Send>;

/// A clock; clones share it.
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
    /// Creates a wall clock.
    #[must_use]
    pub fn wall() -> Self {
        Self(Kind::Wall(Instant::now()))
    }

    /// Creates a clock that advances only through [`Self::report`].
    #[must_use]
    pub fn of_machine() -> Self {
        Self(Kind::Machine(Arc::default()))
    }

    /// Returns the time since an arbitrary start.
    #[must_use]
    pub fn now(&self) -> Duration {
        match &self.0 {
            Kind::Wall(start) => start.elapsed(),
            Kind::Machine(machine) => Duration::from_micros(machine.micros.load(Ordering::Acquire)),
        }
    }

    /// Sets the machine's time, and returns when all followers have processed it. Has no effect on a wall clock.
    pub fn report(&self, micros: u64) {
        if let Kind::Machine(machine) = &self.0 {
            machine.micros.store(micros, Ordering::Release);
            let mut followers = machine.followers.lock().unwrap_or_else(PoisonError::into_inner);
            followers.retain_mut(|follower| follower());
        }
    }

    /// Returns whether this is a wall clock, which calls no followers.
    #[must_use]
    pub fn is_wall(&self) -> bool {
        matches!(self.0, Kind::Wall(_))
    }

    /// Calls `follower` after each [`Self::report`], until it returns `false`.
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
