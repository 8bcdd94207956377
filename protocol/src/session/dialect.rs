//! The interface between the session engine and a protocol: names, requests, replies and their meaning.

use core::fmt::Debug;

use super::message::Message;
use super::subscriptions::List;
use crate::types::Status;

/// A protocol for gripper commands: the binary protocol or GCL. Sealed.
pub trait Dialect: Copy + Debug {
    /// A request, stored until it is answered.
    type Request: Message;
    /// The reason why the parameters of a request are invalid.
    type Invalid;
    /// A reply, or an unsolicited update.
    type Answer<'a>: Copy;
    /// A value in a reply or update.
    type Value<'a>: Copy;
    /// The known state of the gripper.
    type Known;
    type Subscriptions: List<Request = Self::Request>;

    /// The known state before the first reply.
    const NOTHING: Self::Known;

    /// The command name of every [`upkeep`](Self::upkeep) query.
    const UPKEEP: Option<NameOf<Self>> = None;

    /// Returns the request of a setup step, or `None` after the last step.
    fn setup(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Self::Request>;

    /// Returns one of the requests that are repeated while connected, or `None` after the last one.
    fn refresh(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Self::Request>;

    /// Returns the command that a reply refers to, or `None` if it is not in the manual.
    fn name(answer: &Self::Answer<'_>) -> Option<NameOf<Self>>;

    /// Returns the status of a reply: E_CMD_PENDING, E_SUCCESS or the error.
    fn status(answer: &Self::Answer<'_>) -> Status;

    /// Returns the value in a reply or update.
    fn value<'r, 'a>(answer: &'r Self::Answer<'a>) -> Option<&'r Self::Value<'a>>;

    /// Returns the role of a reply, judged by its form alone.
    fn role(answer: &Self::Answer<'_>) -> Role;

    /// Returns whether the reply refers to the value that this request (of the same name) queries.
    fn fits(request: &Self::Request, answer: &Self::Answer<'_>) -> bool;

    /// Returns whether a command of this name has two replies: E_CMD_PENDING and the result.
    fn is_asynchronous(name: NameOf<Self>) -> bool;

    /// Returns whether the first reply to a request is the late result of an earlier one of the same name. `given_up`
    /// means that such a result timed out.
    fn is_late_result(name: NameOf<Self>, status: Status, given_up: bool) -> bool;

    /// Returns whether this reply completes a setup step or reports a subscribed value.
    fn completes_step(name: NameOf<Self>, status: Status) -> bool;

    /// Returns whether the connection ends when a request of this name is confirmed.
    fn is_farewell(name: NameOf<Self>) -> bool;

    /// Stores a value if it is part of the known state. Returns whether the fingers move, if the value contains that.
    fn learn(known: &mut Self::Known, value: &Self::Value<'_>) -> Option<bool>;

    /// Returns whether the gripper is known to be in FAST STOP.
    fn is_fast_stopped(known: &Self::Known) -> bool;

    /// Returns the query that reads this setting back, if it is to be verified.
    fn read_back(&self, _setting: &Self::Request) -> Option<Self::Request> {
        None
    }

    /// Returns the final reply to a setting that was read back, and stores the setting if it is part of the known
    /// state.
    fn read_back_answer<'a>(
        _setting: &Self::Request,
        read: &Self::Answer<'a>,
        _known: &mut Self::Known,
    ) -> Self::Answer<'a> {
        *read
    }

    /// Returns the query that checks whether a known setting still applies, if any is known.
    fn upkeep(_known: &Self::Known) -> Option<Self::Request> {
        None
    }

    /// Forgets the known settings that a request of this name may change or delay.
    fn forget_changed(_known: &mut Self::Known, _name: NameOf<Self>) {}

    /// Forgets all known settings.
    fn forget_settings(_known: &mut Self::Known) {}
}

/// The names of a dialect's commands.
pub(super) type NameOf<D> = <<D as Dialect>::Request as Message>::Name;

/// The possible roles of a reply, judged by its form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Always an update.
    Update,
    /// Always the result of a command that has begun.
    Result,
    /// A reply to a request, never an update.
    Answer,
    /// Either: the form does not distinguish replies from updates.
    Any,
}
