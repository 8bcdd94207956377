//! What JOG+ and JOG- ask for, and where a jog stands (fieldbus, 6.7). What is sent for it is the controller's.

use super::{CommandFlags, OutputImage};
use wsg_protocol::types::SoftLimits;

/// Which way the fingers go.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Direction {
    /// They open.
    Plus,
    /// They close.
    Minus,
}

/// A jog as the flags and the dial ask for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Drive {
    pub(super) direction: Direction,
    /// SPEED as in the register; 0 stands for the least speed.
    pub(super) speed: u16,
    /// FORCELIMIT as in the register.
    pub(super) force_limit: i16,
}

impl Drive {
    /// What this image asks for; both flags ask for a stop.
    fn asked_by(image: &OutputImage) -> Option<Self> {
        let direction = match image.flags.intersection(CommandFlags::JOG) {
            CommandFlags::JOG_PLUS => Direction::Plus,
            CommandFlags::JOG_MINUS => Direction::Minus,
            _ => return None,
        };
        Some(Self { direction, speed: image.speed, force_limit: image.force_limit })
    }
}

/// Where the jog stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Stage {
    /// There is none.
    Off,
    /// Asked for in this way, and sent.
    Runs(Drive),
    /// A Stop was sent; what the gripper has not answered yet.
    Stops { stop_open: bool, motion_open: bool },
}

/// The flags as levels: a jog that has ended by itself, was refused or overruled begins again only after both flags
/// were 0. The same goes for flags that are 1 in the first image, or beside STOP/ACK or FASTSTOP: to let go of these, or to
/// acknowledge, moves nothing.
#[derive(Clone, Copy, Debug, PartialEq, Hash)]
pub(super) struct Jog {
    pub(super) stage: Stage,
    /// The last one ended with an error, and nothing was asked for since: the gripper's ERROR is its own.
    pub(super) failed: bool,
    /// The gripper's soft limits, once it has refused the end of the stroke because of them. Known until both flags are 0.
    pub(super) soft_limits: Option<SoftLimits>,
    armed: bool,
}

impl Jog {
    pub(super) const fn new() -> Self {
        Self { stage: Stage::Off, failed: false, soft_limits: None, armed: false }
    }

    pub(super) fn is_on(&self) -> bool {
        self.stage != Stage::Off
    }

    /// Takes a look at an image.
    pub(super) fn see(&mut self, image: &OutputImage) {
        let overruled = image.flags.intersects(CommandFlags::STOP_ACK.union(CommandFlags::FASTSTOP));
        let is_asked = image.flags.intersects(CommandFlags::JOG);
        self.armed = !is_asked || (self.armed && !overruled);
        self.soft_limits = self.soft_limits.filter(|_| is_asked);
    }

    /// Lets what the flags ask for now no longer count.
    pub(super) fn disarm(&mut self, image: Option<&OutputImage>) {
        self.armed = image.is_some_and(|image| !image.flags.intersects(CommandFlags::JOG));
    }

    /// What is asked for, as far as it counts.
    pub(super) fn asked(&self, image: Option<&OutputImage>) -> Option<Drive> {
        image.and_then(Drive::asked_by).filter(|_| self.armed)
    }
}
