//! The end of a motion as a bus shows it: only with width and force measured after it.
//!
//! State, flags and status change with the gripper's reply. Width and force have reports of their own, up to 10 ms older, and
//! the last 0.01 mm has none. A PLC that reads all values at once would take the force of the approach for the gripping
//! force. So the bridge queries both when the fingers are at rest, and shows the end with the replies.

use wsg_fieldbus::{GripperFlags, InputImage};
use wsg_protocol::session::Event;
use wsg_protocol::{CommandId, Instant, SystemFlags};

/// GSTATE while a motion command is executed.
pub(super) const MOTION_STATES: GripperFlags =
    GripperFlags::GRIPPING.union(GripperFlags::RELEASING).union(GripperFlags::POSITIONING);

/// Longest delay of the end, in milliseconds.
const PATIENCE_MS: u32 = 10;

/// Queries at the end of a motion.
const MEASURED: [CommandId; 2] = [CommandId::GetOpeningWidth, CommandId::GetForce];

/// Follows a motion to its end.
#[derive(Clone, Debug, Hash)]
pub(crate) struct MotionEnd {
    /// Image of the motion, until its end is shown.
    motion: Option<InputImage>,
    /// Time of the queries for width and force.
    asked_at: Option<Instant>,
    /// Outstanding replies to [`MEASURED`].
    awaited: [bool; MEASURED.len()],
}

impl MotionEnd {
    pub(crate) const fn new() -> Self {
        Self { motion: None, asked_at: None, awaited: [false; MEASURED.len()] }
    }

    /// Returns whether a motion runs or its end is delayed.
    pub(crate) const fn is_awaited(&self) -> bool {
        self.motion.is_some()
    }

    /// Processes the current image. Returns whether width and force must be queried.
    pub(crate) fn look(&mut self, now: Instant, image: &InputImage) -> bool {
        if image.state.intersects(MOTION_STATES) {
            (self.motion, self.asked_at) = (Some(*image), None);
            return false;
        }
        // Errors are shown immediately.
        let is_wrong = image.state.contains(GripperFlags::ERROR);
        let is_over = match self.asked_at {
            _ if is_wrong || image.system.contains(SystemFlags::FAST_STOP) => true,
            Some(asked_at) => !self.awaited.contains(&true) || now.since(asked_at) >= PATIENCE_MS,
            None => false,
        };
        if is_over {
            *self = Self::new();
        }
        if self.motion.is_none() || self.asked_at.is_some() {
            return false;
        }
        (self.asked_at, self.awaited) = (Some(now), [true; MEASURED.len()]);
        true
    }

    /// Processes an event of the session. A value received after the end was also measured after it, even in an automatic
    /// update, because the gripper sends values in the order of measurement.
    pub(crate) fn see(&mut self, event: &Event<'_>) {
        let Event::Reported(value) = event else { return };
        for (awaited, measured) in self.awaited.iter_mut().zip(MEASURED) {
            *awaited &= value.id() != measured;
        }
    }

    /// Returns this image as a bus shows it.
    pub(crate) fn shown(&self, image: InputImage) -> InputImage {
        match self.motion {
            Some(motion) if !image.state.intersects(MOTION_STATES) => {
                InputImage { state: motion.state, system: motion.system, status: motion.status, ..image }
            }
            _ => image,
        }
    }
}

#[cfg(test)]
mod tests;
