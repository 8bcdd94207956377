//! The contract of a PLC side.

use super::SideReports;
use super::view::View;
use crate::register::Link;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::Instant;

/// One way for a PLC to command the bridge: converts the PLC's input to events, and provides the data that the PLC reads.
///
/// In each turn, the bridge calls [`receive`](Self::receive) until no event is left, and [`show`](Self::show) once at the
/// end. Neither may wait.
///
/// ```
/// use wsg_bridge_fw::plc::{PlcEvent, PlcSide, Shown, View};
/// use wsg_protocol::Instant;
/// use wsg_fieldbus::OutputImage;
///
/// /// A PLC that writes its image into shared memory.
/// struct SharedMemory {
///     written: Option<OutputImage>,
///     status: u16,
/// }
///
/// impl PlcSide for SharedMemory {
///     fn receive(&mut self, _: Instant, _: &mut View<'_>) -> Option<PlcEvent> {
///         self.written.take().map(PlcEvent::Output)
///     }
///
///     fn show(&mut self, _: Instant, shown: &Shown) {
///         self.status = shown.image.status.code();
///     }
/// }
/// ```
pub trait PlcSide {
    /// Returns the maximum number of events per turn. A continuously sending PLC must not delay the rest of the turn.
    fn max_events_per_turn(&self) -> usize {
        4
    }

    /// Updates the side's own report registers. Called before each turn.
    fn report(&self, _: &mut SideReports) {}

    /// Returns the next event, or `None` if there is no further input. Requests of the PLC are answered from `view`.
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent>;

    /// Sets the data that the PLC reads from now on.
    fn show(&mut self, now: Instant, shown: &Shown);
}

/// Event of a PLC side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlcEvent {
    /// The PLC wrote a complete output image.
    Output(OutputImage),
    /// The PLC changed settings.
    Configured,
    /// The PLC made a request that changes nothing.
    Served,
    /// The PLC no longer commands.
    Left {
        /// Unexpectedly, by a time-out. Counted in BUS_TIMEOUTS.
        silent: bool,
    },
}

/// Data for the PLC at the end of a turn.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// Input image of the fieldbus manual. For a bus, the end of a motion is shown with width and force measured after it.
    pub image: InputImage,
    /// State of the link to the gripper.
    pub link: Link,
    /// Event code of the cause of ERROR ([`EVENTS`](crate::registers::EVENTS)); 0: ERROR is low.
    pub error_cause: u8,
    /// A motion was refused because another command was pending, which it still is.
    pub refused_meanwhile: bool,
    /// A motion has not been answered yet, even if it was stopped.
    pub motion_is_open: bool,
    /// A motion command would have no effect: a motion is open, the fingers move, one side holds STOP/ACK or FASTSTOP, or the
    /// stored settings are refused.
    pub ignores_motions: bool,
}

/// Identity of the bridge's board, for masters (CANopen 1009h and 1018h, 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardId {
    /// Name of the board.
    pub name: &'static str,
    /// Serial number, which is not guaranteed to be unique.
    pub serial: u32,
}

impl BoardId {
    /// Identity of an unknown board.
    pub const UNKNOWN: Self = Self { name: "unknown", serial: 0 };
}

/// No bus beside the wires. Also the missing line, or service port, of a board.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoBus;

impl PlcSide for NoBus {
    fn receive(&mut self, _: Instant, _: &mut View<'_>) -> Option<PlcEvent> {
        None
    }

    fn show(&mut self, _: Instant, _: &Shown) {}
}

/// Returns, once per silence, whether a PLC whose last data came at `received_at` has sent nothing for `timeout_ms` (0: no limit).
pub(super) fn has_fallen_silent(received_at: &mut Option<Instant>, now: Instant, timeout_ms: u32) -> bool {
    let age_ms = received_at.as_mut().map(|received_at| received_at.age(now));
    let silent = timeout_ms > 0 && age_ms.is_some_and(|age_ms| age_ms >= timeout_ms);
    if silent {
        *received_at = None;
    }
    silent
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGIN: Instant = Instant::from_millis(u32::MAX - 50);

    #[test]
    fn plc_is_silent_exactly_at_its_time_out_and_once() {
        for timeout_ms in [1, 100, u16::MAX.into()] {
            let mut received_at = Some(BEGIN);
            let mut is_silent = |ms: u32| has_fallen_silent(&mut received_at, BEGIN.plus(ms), timeout_ms);
            assert!(!is_silent(timeout_ms - 1));
            assert!(is_silent(timeout_ms));
            assert!(!is_silent(timeout_ms + 1));
        }
    }

    #[test]
    fn plc_without_a_time_out_is_silent_as_soon_as_it_has_one() {
        let mut received_at = Some(BEGIN);
        // Longer than a time is comparable on the clock that wraps.
        let mut now = BEGIN;
        for _ in 0..30 {
            now = now.plus(24 * 60 * 60 * 1_000);
            assert!(!has_fallen_silent(&mut received_at, now, 0));
        }
        assert!(has_fallen_silent(&mut received_at, now, 100));
    }
}
