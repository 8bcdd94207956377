//! The state of JOG+ and JOG- and of a jog (fieldbus, 6.7). The controller sends the commands.

use super::{CommandFlags, OutputImage};
use wsg_protocol::types::SoftLimits;

/// The direction of the fingers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Direction {
    /// Opens the fingers (JOG+).
    Plus,
    /// Closes the fingers (JOG-).
    Minus,
}

/// A jog as requested by the flags and the dial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Drive {
    pub(super) direction: Direction,
    /// SPEED in register units; 0 selects the minimum speed.
    pub(super) speed: u16,
    /// FORCELIMIT in register units.
    pub(super) force_limit: i16,
}

impl Drive {
    /// Returns the jog that this image requests; both flags together request a stop.
    fn requested_by(image: &OutputImage) -> Option<Self> {
        let direction = match image.flags.intersection(CommandFlags::JOG) {
            CommandFlags::JOG_PLUS => Direction::Plus,
            CommandFlags::JOG_MINUS => Direction::Minus,
            _ => return None,
        };
        Some(Self { direction, speed: image.speed, force_limit: image.force_limit })
    }
}

/// The progress of a jog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    Off,
    /// Requested with these parameters, and sent.
    Runs(Drive),
    /// A Stop was sent. The fields name the commands that the gripper has not answered yet.
    Stops {
        stop_open: bool,
        motion_open: bool,
    },
}

/// The JOG flags as levels. A jog that ended by itself, was refused or was overridden restarts only after both flags
/// were 0. The same applies to flags that are 1 in the first image, or beside STOP/ACK or FASTSTOP. Releasing those
/// flags, or an acknowledgement, thus moves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(super) struct Jog {
    pub(super) stage: Stage,
    /// The soft limits, known after the gripper refused the end of the stroke, until both flags are 0.
    pub(super) soft_limits: Option<SoftLimits>,
    armed: bool,
}

impl Jog {
    pub(super) const fn new() -> Self {
        Self { stage: Stage::Off, soft_limits: None, armed: false }
    }

    pub(super) fn is_on(&self) -> bool {
        self.stage != Stage::Off
    }

    pub(super) fn see(&mut self, image: &OutputImage) {
        let overruled = image.flags.intersects(CommandFlags::STOP_ACK.union(CommandFlags::FASTSTOP));
        let is_requested = image.flags.intersects(CommandFlags::JOG);
        self.armed = !is_requested || (self.armed && !overruled);
        self.soft_limits = self.soft_limits.filter(|_| is_requested);
    }

    /// Disables the current JOG flags until both were 0.
    pub(super) fn disarm(&mut self, image: Option<&OutputImage>) {
        self.armed = image.is_some_and(|image| !image.flags.intersects(CommandFlags::JOG));
    }

    /// Ends the jog. Another one needs flags that were 0 before.
    // Not inlined: it has several callers.
    #[inline(never)]
    pub(super) fn end(&mut self, image: Option<&OutputImage>) {
        self.stage = Stage::Off;
        self.disarm(image);
    }

    /// Returns the requested jog if the flags are effective.
    pub(super) fn asked(&self, image: Option<&OutputImage>) -> Option<Drive> {
        image.and_then(Drive::requested_by).filter(|_| self.armed)
    }
}
