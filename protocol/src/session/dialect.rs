//! What the session's engine asks of a protocol: names, requests, answers, and what they mean.

use core::fmt::Debug;

use super::message::Message;
use super::subscriptions::List;
use crate::types::Status;

/// A protocol in which a gripper is commanded: the binary one or GCL. No other type can be one.
pub trait Dialect: Copy + Debug {
    /// A request, as it is kept until it is answered.
    type Request: Message;
    /// Why the parameters of a request are refused.
    type Invalid;
    /// An answer, or an update that came without a request.
    type Answer<'a>: Copy;
    /// A value that an answer or an update carries.
    type Value<'a>: Copy;
    /// What is known of the gripper.
    type Known;
    /// What can be subscribed to.
    type Subscriptions: List<Request = Self::Request>;

    /// What is known of a gripper that has said nothing.
    const NOTHING: Self::Known;

    /// The command of each [`upkeep`](Self::upkeep).
    const UPKEEP: Option<NameOf<Self>> = None;

    /// Returns the request of a step of connecting, in order; `None` after the last one.
    fn setup(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Self::Request>;

    /// Returns one of the requests that are made again and again while connected; `None` after the last one.
    fn refresh(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Self::Request>;

    /// Returns the command that an answer is about; `None` if the manual has no such command.
    fn name(answer: &Self::Answer<'_>) -> Option<NameOf<Self>>;

    /// Returns what an answer says of its request: E_CMD_PENDING, E_SUCCESS or the error.
    fn status(answer: &Self::Answer<'_>) -> Status;

    /// Returns the value that an answer or an update carries.
    fn value<'r, 'a>(answer: &'r Self::Answer<'a>) -> Option<&'r Self::Value<'a>>;

    /// Returns what an answer can be, by its form alone.
    fn role(answer: &Self::Answer<'_>) -> Role;

    /// Whether the answer is about the very value that the request of this name asks for.
    fn fits(request: &Self::Request, answer: &Self::Answer<'_>) -> bool;

    /// Whether a command of this name is answered twice: E_CMD_PENDING, then its result.
    fn is_asynchronous(name: NameOf<Self>) -> bool;

    /// Whether the first answer to a request is the result of an earlier one of the same name, late. `given_up`: the
    /// result of one was not waited for any longer.
    fn is_late_result(name: NameOf<Self>, status: Status, given_up: bool) -> bool;

    /// Whether a step of connecting is done, or a subscribed value reported, when it is answered like this.
    fn completes_step(name: NameOf<Self>, status: Status) -> bool;

    /// Whether the connection is over when a request of this name is confirmed.
    fn is_farewell(name: NameOf<Self>) -> bool;

    /// Keeps a value, if it is one that is kept. Returns whether the fingers move, if the value tells.
    fn learn(known: &mut Self::Known, value: &Self::Value<'_>) -> Option<bool>;

    /// Returns the query that shows what this setting came to, if that is to be asked.
    fn read_back(&self, _setting: &Self::Request) -> Option<Self::Request> {
        None
    }

    /// Returns the answer to a setting that was read back, and keeps the setting if it is one that is kept.
    fn read_back_answer<'a>(
        _setting: &Self::Request,
        read: &Self::Answer<'a>,
        _known: &mut Self::Known,
    ) -> Self::Answer<'a> {
        *read
    }

    /// Returns the query that shows whether a setting that is known still holds, if one is known.
    fn upkeep(_known: &Self::Known) -> Option<Self::Request> {
        None
    }

    /// Whether this is an [`upkeep`](Self::upkeep).
    fn is_upkeep(_request: &Self::Request) -> bool {
        false
    }

    /// Whether a request of this name leaves all settings as they are, and nothing that comes behind it waits.
    fn leaves_settings(_name: NameOf<Self>) -> bool {
        true
    }

    /// Forgets the settings that are known.
    fn forget_settings(_known: &mut Self::Known) {}
}

/// The names of a dialect's commands.
pub(super) type NameOf<D> = <<D as Dialect>::Request as Message>::Name;

/// What an answer can be, by its form.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// An update, and nothing else.
    Update,
    /// The result of a command that has begun, and nothing else.
    Result,
    /// An answer to a request, and no update.
    Answer,
    /// The form does not tell answers and updates apart.
    Any,
}
