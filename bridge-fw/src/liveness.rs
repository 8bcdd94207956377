//! Watchdog policy: a bridge is alive only if it serves all parts while time passes.

use bitflags::bitflags;
use wsg_protocol::Instant;

bitflags! {
    /// Parts that each turn must serve.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub(crate) struct Served: u8 {
        /// The input wires were read in this turn.
        const WIRES = 1 << 0;
        /// Gripper line: it has reported whether bytes are available.
        const LINE = 1 << 1;
        /// The PLC's bus, or its absence.
        const BUS = 1 << 2;
        /// The output wires were written in this turn.
        const OUTPUTS = 1 << 3;
    }
}

/// Parts served since the watchdog was last fed, and the time of that.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Liveness {
    served: Served,
    fed_at: Option<Instant>,
}

impl Liveness {
    pub(crate) const fn new() -> Self {
        Self { served: Served::empty(), fed_at: None }
    }

    pub(crate) fn serve(&mut self, part: Served) {
        self.served |= part;
    }

    /// Returns whether all parts were served and time has passed since the last `true`.
    pub(crate) fn take(&mut self, now: Instant) -> bool {
        let is_alive = self.served.is_all() && self.fed_at != Some(now);
        if is_alive {
            *self = Self { served: Served::empty(), fed_at: Some(now) };
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
    fn stopped_clock_is_not_alive() {
        let mut liveness = Liveness::new();
        liveness.serve(Served::all());
        assert!(liveness.take(at(7)));
        for _ in 0..1_000 {
            liveness.serve(Served::all());
            assert!(!liveness.take(at(7)));
        }
        assert!(liveness.take(at(8)));
    }

    #[test]
    fn each_part_must_be_served_again() {
        for missed in Served::all().iter() {
            let mut liveness = Liveness::new();
            liveness.serve(Served::all());
            assert!(liveness.take(at(1)));
            liveness.serve(Served::all() - missed);
            assert!(!liveness.take(at(2)), "{missed:?}");
            liveness.serve(missed);
            assert!(liveness.take(at(3)), "{missed:?}");
        }
    }
}
