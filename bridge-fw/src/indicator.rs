//! Blink patterns of the board's LED, for diagnosis without a PLC. [`Bridge::indication`](crate::Bridge::indication) selects
//! one.
//!
//! The LED itself is the board's. LINK_OK is a wire.

use crate::register::Link;

/// Period of a pattern.
const PERIOD_MS: u32 = 2_000;
/// A flash, and the dark time before it. The pause after four flashes is more than twice the dark time between two.
const FLASH_MS: u32 = 150;
const DARK_MS: u32 = 200;
/// Gap in the light of a running bridge.
const GAP_MS: u32 = 100;
/// Half a period of the flicker. The watchdog restarts the pattern within 100 ms, which looks the same.
const FLICKER_MS: u32 = 50;

/// Status shown by the LED.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Indication {
    /// The gripper answers, and there is no error.
    Running,
    /// The gripper has not answered since power-up.
    NeverAnswered,
    /// The gripper has stopped answering.
    GripperSilent,
    /// The PLC's bus is lost: its master is silent, or the CAN controller is off the bus.
    BusLost,
    /// The wire ERROR is high for another reason.
    Error,
    /// The bridge cannot start.
    NotStarted,
}

/// A row of the table of patterns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndicationText {
    /// Status that the pattern shows.
    pub indication: Indication,
    /// Pattern of the LED as a person describes it.
    pub seen: &'static str,
    /// Meaning of the pattern.
    pub meaning: &'static str,
    /// Recommended action.
    pub remedy: &'static str,
}

/// All patterns. If several apply, the first is shown.
pub const INDICATIONS: [IndicationText; 6] = [
    text(
        Indication::NotStarted,
        "flickers",
        "the bridge cannot start: no clock, or the firmware's default settings are out of range",
        "flash the firmware again; if the pattern persists, replace the board",
    ),
    text(
        Indication::NeverAnswered,
        "1 flash",
        "the gripper has not answered since power-up",
        "check the gripper's supply, its line and its interface setting, and the setting `GRIPPER_LINE`",
    ),
    text(
        Indication::GripperSilent,
        "2 flashes",
        "the gripper has stopped answering",
        "check the gripper's supply, plugs and cable",
    ),
    text(
        Indication::BusLost,
        "3 flashes",
        "the connection to the PLC is lost: the bus master was silent for `BUS_TIMEOUT`, or CAN is bus-off. A silent master is not shown if none has ever connected, or if wires gave the last motion command",
        "check the bus wiring, rate and termination, and the master",
    ),
    text(
        Indication::Error,
        "4 flashes",
        "`ERROR` is high for another reason. This is normal after a power-up with `FAST_STOP_OK` low, until you acknowledge with `STOP_ACK`",
        "read `ERROR_CAUSE` over a bus or the service port, remove the cause, then pulse `STOP_ACK`",
    ),
    text(
        Indication::Running,
        "on, with one short gap every 2 s",
        "the gripper answers, and there is no error",
        "nothing",
    ),
];

const fn text(
    indication: Indication,
    seen: &'static str,
    meaning: &'static str,
    remedy: &'static str,
) -> IndicationText {
    IndicationText { indication, seen, meaning, remedy }
}

impl Indication {
    /// Returns the indication of a running bridge.
    pub(crate) const fn of(link: Link, is_bus_lost: bool, has_error: bool) -> Self {
        match (link, is_bus_lost, has_error) {
            (Link::Never, ..) => Self::NeverAnswered,
            (Link::Silent, ..) => Self::GripperSilent,
            (Link::Up, true, _) => Self::BusLost,
            (Link::Up, false, true) => Self::Error,
            (Link::Up, false, false) => Self::Running,
        }
    }

    /// Returns whether the LED is lit at this time, in milliseconds from an arbitrary start.
    ///
    /// Each pattern begins dark, so that a bridge in a reset loop does not look like a running one.
    ///
    /// ```
    /// use wsg_bridge_fw::indicator::Indication;
    ///
    /// assert!(Indication::Running.is_lit(1_000));
    /// ```
    #[must_use]
    pub const fn is_lit(self, now_ms: u32) -> bool {
        let at_ms = now_ms % PERIOD_MS;
        let flashes = match self {
            Self::Running => return at_ms >= GAP_MS,
            Self::NotStarted => return at_ms % (2 * FLICKER_MS) >= FLICKER_MS,
            Self::NeverAnswered => 1,
            Self::GripperSilent => 2,
            Self::BusLost => 3,
            Self::Error => 4,
        };
        at_ms / (DARK_MS + FLASH_MS) < flashes && at_ms % (DARK_MS + FLASH_MS) >= DARK_MS
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    #[test]
    fn first_applicable_pattern_of_the_table_is_shown() {
        let rank = |wanted| INDICATIONS.iter().position(|text| text.indication == wanted).unwrap();
        for link in [Link::Never, Link::Silent, Link::Up] {
            for (is_bus_lost, has_error) in [(false, false), (false, true), (true, false), (true, true)] {
                let applies = [
                    (link == Link::Never, Indication::NeverAnswered),
                    (link == Link::Silent, Indication::GripperSilent),
                    (is_bus_lost, Indication::BusLost),
                    (has_error, Indication::Error),
                    (true, Indication::Running),
                ];
                let applies = applies.into_iter().filter(|(applies, _)| *applies);
                let wanted = applies.map(|(_, indication)| indication).min_by_key(|it| rank(*it));
                assert_eq!(Some(Indication::of(link, is_bus_lost, has_error)), wanted);
            }
        }
    }

    #[test]
    fn bridge_that_cannot_start_flickers_ten_times_a_second() {
        let levels: Vec<bool> = (0..1_000).map(|ms| Indication::NotStarted.is_lit(ms)).collect();
        assert_eq!(levels.windows(2).filter(|pair| !pair[0] && pair[1]).count(), 10);
        assert_eq!(levels.iter().filter(|is_lit| **is_lit).count(), 500);
    }

    #[test]
    fn every_pattern_begins_dark() {
        for text in INDICATIONS {
            assert!((0..50).all(|ms| !text.indication.is_lit(ms)), "{text:?}");
        }
    }
}
