//! The end of a motion as a bus shows it: not before width and force are from after it.
//!
//! State, flags and status come with the gripper's answer, width and force in reports of their own, up to 10 ms older, and not at
//! all for the last hundredth of a millimetre. A PLC that reads all of them at once took the force of the approach for that of the
//! grip. So both are asked for when the fingers stand, and the end is shown with the answers.

use wsg_fieldbus::{GripperFlags, InputImage};
use wsg_protocol::session::Event;
use wsg_protocol::{CommandId, Instant, SystemFlags};

/// GSTATE while a motion command is carried out.
pub(super) const MOTION_STATES: GripperFlags =
    GripperFlags::GRIPPING.union(GripperFlags::RELEASING).union(GripperFlags::POSITIONING);

/// How long the end is kept back, in milliseconds, at the most.
const PATIENCE_MS: u32 = 10;

/// What is asked for.
const MEASURED: [CommandId; 2] = [CommandId::GetOpeningWidth, CommandId::GetForce];

/// Follows a motion to its end.
#[derive(Clone, Debug, Hash)]
pub(crate) struct MotionEnd {
    /// The image of the motion, until its end is shown.
    motion: Option<InputImage>,
    /// When width and force were asked for, after the motion.
    asked_at: Option<Instant>,
    /// Which of [`MEASURED`] has not been reported since.
    awaited: [bool; MEASURED.len()],
}

impl MotionEnd {
    pub(crate) const fn new() -> Self {
        Self { motion: None, asked_at: None, awaited: [false; MEASURED.len()] }
    }

    /// Whether a motion runs, or its end is kept back.
    pub(crate) const fn is_awaited(&self) -> bool {
        self.motion.is_some()
    }

    /// Takes the image as it is now. Whether width and force are to be asked for.
    pub(crate) fn look(&mut self, now: Instant, image: &InputImage) -> bool {
        if image.state.intersects(MOTION_STATES) {
            (self.motion, self.asked_at) = (Some(*image), None);
            return false;
        }
        // What went wrong is shown at once.
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

    /// Takes what the session noticed. A value that comes behind the end is from after it, be it an update: the gripper sends in
    /// the order in which it measures.
    pub(crate) fn see(&mut self, event: &Event<'_>) {
        let Event::Reported(value) = event else { return };
        for (awaited, measured) in self.awaited.iter_mut().zip(MEASURED) {
            *awaited &= value.id() != measured;
        }
    }

    /// What a bus shows of this image.
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
