//! The state and result of a motion.

use super::{Error, Grip};
use crate::command::CommandId;
use crate::session::Event;
use crate::types::Status;
use core::marker::PhantomData;

/// A motion that has begun (E_CMD_PENDING). `wait` and `poll` return its result `T`, repeatedly if needed, until
/// another motion is begun. Dropping it has no effect on the motion.
#[must_use = "the motion continues; call `wait` or `poll` for its result"]
pub struct Pending<T> {
    id: CommandId,
    serial: u16,
    result: PhantomData<fn() -> T>,
}

impl<T> Pending<T> {
    /// Returns the command in progress.
    #[must_use]
    pub const fn id(&self) -> CommandId {
        self.id
    }
}

impl<T> Clone for Pending<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Pending<T> {}

impl<T> core::fmt::Debug for Pending<T> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("Pending").field(&self.id).finish()
    }
}

/// The result of a successful motion: [`Grip`] for a grip, `()` for all others.
pub trait MotionResult: Sized + private::Sealed {
    /// Converts the status of a second reply to a result; `None` means failure.
    #[doc(hidden)]
    fn from_status(status: Status) -> Option<Self>;
}

mod private {
    pub trait Sealed {}
    impl Sealed for () {}
    impl Sealed for super::Grip {}
}

impl MotionResult for () {
    fn from_status(status: Status) -> Option<Self> {
        (status == Status::Success).then_some(())
    }
}

impl MotionResult for Grip {
    fn from_status(status: Status) -> Option<Self> {
        match status {
            Status::Success => Some(Self::Held),
            Status::CmdFailed => Some(Self::NoPart),
            _ => None,
        }
    }
}

/// The last requested motion.
#[derive(Debug)]
pub(super) struct Motion {
    id: CommandId,
    serial: u16,
    stage: Stage,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Requested, without a reply yet.
    Requested,
    /// Begun (E_CMD_PENDING).
    Runs,
    /// Did not begin.
    NotBegun(Verdict),
    /// Begun and ended.
    Over(Verdict),
}

/// The outcome of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Answered with this final status.
    Answered(Status),
    /// Sent, without a reply.
    Unanswered,
    /// Withdrawn before it was sent.
    Withdrawn,
}

impl Verdict {
    /// Returns the outcome that an event reports for a request with this id, or `None` if it concerns another request
    /// or is not final.
    pub(super) fn of(event: &Event<'_>, id: CommandId) -> Option<Self> {
        match event {
            Event::Answered(reply) if reply.id() == id => Some(Self::Answered(reply.status())),
            Event::Unanswered(of) if *of == id => Some(Self::Unanswered),
            Event::Withdrawn(of) if *of == id => Some(Self::Withdrawn),
            _ => None,
        }
    }
}

impl Motion {
    pub(super) const fn none() -> Self {
        Self { id: CommandId::Unknown(0), serial: 0, stage: Stage::NotBegun(Verdict::Withdrawn) }
    }

    /// Records the request of another motion.
    pub(super) const fn ask(&mut self, id: CommandId) {
        *self = Self { id, serial: self.serial.wrapping_add(1), stage: Stage::Requested };
    }

    pub(super) fn note(&mut self, event: &Event<'_>) {
        match (self.stage, Verdict::of(event, self.id)) {
            (Stage::Requested, Some(verdict)) => self.stage = Stage::NotBegun(verdict),
            (Stage::Runs, Some(verdict)) => self.stage = Stage::Over(verdict),
            (Stage::Requested, None) if *event == Event::Pending(self.id) => self.stage = Stage::Runs,
            _ => {}
        }
    }

    /// Returns whether the motion is known to have begun or failed to begin.
    pub(super) const fn is_decided(&self) -> bool {
        !matches!(self.stage, Stage::Requested)
    }

    pub(super) const fn is_over(&self) -> bool {
        matches!(self.stage, Stage::NotBegun(_) | Stage::Over(_))
    }

    /// Returns the motion if it has begun.
    pub(super) fn begun<T, E>(&self) -> Result<Pending<T>, Error<E>> {
        match self.stage {
            Stage::NotBegun(Verdict::Answered(status)) => Err(Error::Refused(status)),
            Stage::NotBegun(Verdict::Withdrawn) => Err(Error::NotConnected),
            Stage::NotBegun(Verdict::Unanswered) | Stage::Requested => Err(Error::Unanswered),
            Stage::Runs | Stage::Over(_) => {
                Ok(Pending { id: self.id, serial: self.serial, result: PhantomData })
            }
        }
    }

    pub(super) const fn is_of<T>(&self, pending: &Pending<T>) -> bool {
        self.serial == pending.serial
    }

    /// Returns the result of the motion.
    pub(super) fn result<T: MotionResult, E>(&self) -> Result<T, Error<E>> {
        let Stage::Over(Verdict::Answered(status)) = self.stage else { return Err(Error::Unanswered) };
        T::from_status(status).ok_or(match status {
            Status::AxisBlocked => Error::Blocked,
            Status::CmdAborted => Error::Aborted,
            status => Error::Failed(status),
        })
    }
}
