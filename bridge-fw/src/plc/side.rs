//! The contract of a PLC side.

use super::SideReports;
use super::view::View;
use crate::register::Link;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::Instant;

/// One way in which a PLC commands the bridge: it turns what the PLC sends into events, and gives it what it reads.
///
/// In each of its turns the bridge calls [`receive`](Self::receive) until nothing more has come, and
/// [`show`](Self::show) once at the end. Neither may wait.
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
    /// Events taken in one turn, at the most: a PLC that never falls silent must not keep the rest waiting.
    fn max_events_per_turn(&self) -> usize {
        4
    }

    /// Writes what it reports of itself in registers of its own, before each turn.
    fn report(&self, _: &mut SideReports) {}

    /// Returns the next event, or `None` when nothing more has come. What the PLC asks meanwhile is answered from `view`.
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent>;

    /// Gives the PLC what it reads from now on.
    fn show(&mut self, now: Instant, shown: &Shown);
}

/// What a PLC side received in one turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlcEvent {
    /// It wrote the output image, complete and at once.
    Output(OutputImage),
    /// It changed settings.
    Configured,
    /// It asked for something that changes nothing.
    Served,
    /// It does not command any more.
    Left {
        /// Unexpectedly, because it fell silent; this is counted in BUS_TIMEOUTS.
        silent: bool,
    },
}

/// What a PLC reads at the end of a turn.
#[derive(Clone, Copy, Debug)]
pub struct Shown {
    /// The input image of the fieldbus manual. To a bus the end of a motion is shown with width and force from after it.
    pub image: InputImage,
    /// Whether the gripper answers.
    pub link: Link,
    /// Why the wire ERROR is high, by the code of an event ([`EVENTS`](crate::registers::EVENTS)); 0: it is low.
    pub error_cause: u8,
    /// A motion was refused because another command was, and is, pending.
    pub refused_meanwhile: bool,
    /// A motion has not answered yet, be it that it was stopped.
    pub motion_is_open: bool,
    /// A motion command would come to nothing: for that reason, because the fingers move, or because either side holds
    /// STOP/ACK or FASTSTOP.
    pub ignores_motions: bool,
}

/// The identity of the board that a bridge runs on, as a master can read it (CANopen 1009h and 1018h, 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardId {
    /// Its name.
    pub name: &'static str,
    /// The serial number; of no number is known whether another board has it too.
    pub serial: u32,
}

impl BoardId {
    /// A board of which nothing is known.
    pub const UNKNOWN: Self = Self { name: "unknown", serial: 0 };
}

/// No bus beside the wires; or the line of one that a board does not have, the service port included.
#[derive(Clone, Copy, Debug, Default)]
pub struct NoBus;

impl PlcSide for NoBus {
    fn receive(&mut self, _: Instant, _: &mut View<'_>) -> Option<PlcEvent> {
        None
    }

    fn show(&mut self, _: Instant, _: &Shown) {}
}
