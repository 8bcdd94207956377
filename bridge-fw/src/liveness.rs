//! Whether the watchdog may be fed: only a bridge that looks at everything while time goes on is alive.

use bitflags::bitflags;
use wsg_protocol::Instant;

bitflags! {
    /// What a turn has to look at.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub(crate) struct Looked: u8 {
        /// The wires from the PLC.
        const WIRES = 1 << 0;
        /// The gripper's line: it said whether it had bytes.
        const LINE = 1 << 1;
        /// The PLC's bus, or that there is none.
        const BUS = 1 << 2;
        /// The wires to the PLC.
        const OUTPUTS = 1 << 3;
    }
}

/// What was looked at since the watchdog was fed last, and when that was.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Liveness {
    looked: Looked,
    fed_at: Option<Instant>,
}

impl Liveness {
    pub(crate) const fn new() -> Self {
        Self { looked: Looked::empty(), fed_at: None }
    }

    pub(crate) fn look(&mut self, at: Looked) {
        self.looked |= at;
    }

    /// Whether everything was looked at, and time has passed, since this was true last.
    pub(crate) fn take(&mut self, now: Instant) -> bool {
        let is_alive = self.looked.is_all() && self.fed_at != Some(now);
        if is_alive {
            *self = Self { looked: Looked::empty(), fed_at: Some(now) };
        }
        is_alive
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u32) -> Instant {
        Instant::from_millis(ms)
    }

    #[test]
    fn time_that_stands_still_is_no_life() {
        let mut liveness = Liveness::new();
        liveness.look(Looked::all());
        assert!(liveness.take(at(7)));
        for _ in 0..1_000 {
            liveness.look(Looked::all());
            assert!(!liveness.take(at(7)));
        }
        assert!(liveness.take(at(8)));
    }

    #[test]
    fn whatever_was_not_looked_at_since_is_missed() {
        for missed in Looked::all().iter() {
            let mut liveness = Liveness::new();
            liveness.look(Looked::all());
            assert!(liveness.take(at(1)));
            liveness.look(Looked::all() - missed);
            assert!(!liveness.take(at(2)), "{missed:?}");
            liveness.look(missed);
            assert!(liveness.take(at(3)), "{missed:?}");
        }
    }
}
