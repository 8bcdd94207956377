//! The session of the binary protocol.

use core::hash::{Hash, Hasher};

use super::config::Config;
use super::dialect::{Dialect, Role};
use super::engine::Engine;
use super::event::{EventOf, RequestError};
use super::known::Known;
use super::message::{Message, Name};
use super::read_back;
use super::subscriptions::{Subscription, Subscriptions};
use super::topic::{self, Topic, Update};
use super::transaction::{Outgoing, Request};
use crate::command::{Command, CommandId, Kind};
use crate::field::DecodeError;
use crate::frame::Event as FrameEvent;
use crate::reply::{Reply, Value};
use crate::time::Instant;
use crate::types::{AutoUpdate, Status, SystemFlags};

/// The controller's side of a binary-protocol connection.
pub type Session = Engine<BinaryDialect>;

/// An event of a binary-protocol session.
pub type Event<'a> = EventOf<CommandId, Reply<'a>, Value<'a>>;

/// Hashes the kind of event and the command, not the values.
impl Hash for Event<'_> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        core::mem::discriminant(self).hash(state);
        let id = match self {
            Self::Connected | Self::Disconnected => None,
            Self::Pending(id) | Self::Unanswered(id) | Self::Late(id) | Self::Withdrawn(id) => Some(*id),
            Self::Answered(reply) => Some(reply.id()),
            Self::Reported(value) => Some(value.id()),
        };
        id.hash(state);
    }
}

/// Status of a setting that the gripper confirmed but did not apply: the read-back shows another value or none
/// ([`Config::verify_settings`]).
///
/// The value is E_WRITE_ERROR. The manual does not list it for any of these settings, so a register interface can show
/// it unchanged.
pub const MISMATCH: Status = Status::WriteError;

/// The dialect of the binary protocol (command set).
#[derive(Clone, Copy, Debug, Hash)]
pub struct BinaryDialect {
    verify_settings: bool,
}

/// Number of setup steps for the two states. They come first because a moving gripper must be detected at once.
const STATE_STEPS: u8 = 2;

impl Session {
    /// Creates a disconnected session, which begins to connect immediately.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        let dialect = BinaryDialect { verify_settings: config.verify_settings };
        Self::over(dialect, config.timing(), topic::of_config(&config))
    }

    /// Requests a command. Its outcome is reported as an [`Event`].
    ///
    /// Stop, FAST STOP and Acknowledge overtake all queued requests, which are withdrawn. So does a FAST
    /// STOP that the gripper reports while a motion waits to be sent. A single query of a
    /// subscribed value does not end the subscription.
    ///
    /// # Errors
    /// Returns [`RequestError`] if the command is rejected. It is then never sent.
    pub fn request(&mut self, mut command: Command<'static>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        // A single query would end the subscription (command set, 3.4.1).
        if let Some(once) = Update::of(&command).filter(|asked| asked.update == AutoUpdate::once())
            && let Some(subscribed) = self.subscriptions().find(once.name())
        {
            command = subscribed.request();
        }
        self.enqueue(Request::Own(command))
    }

    /// Requests a command that the caller keeps because it borrows its payload. The session stores only the id and
    /// sends the command when the caller passes it to [`poll_transmit_borrowed`](Self::poll_transmit_borrowed).
    ///
    /// Call [`withdraw`](Self::withdraw) when the command is no longer available. A borrowed setting is not read back.
    ///
    /// ```
    /// use wsg_protocol::session::{Config, RequestError, Session};
    /// use wsg_protocol::{Command, DeviceTag};
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// let text = String::from("left hand");
    /// let command = Command::SetDeviceTag { tag: DeviceTag::new(&text).unwrap() };
    /// assert_eq!(session.request_borrowed(&command), Err(RequestError::NotConnected));
    /// ```
    ///
    /// # Errors
    /// Returns [`RequestError`] if the command is rejected. It is then never sent.
    pub fn request_borrowed(&mut self, command: &Command<'_>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        self.enqueue(match command.id() {
            CommandId::FastStop => Request::Own(Command::FastStop),
            CommandId::Stop => Request::Own(Command::Stop),
            id => Request::Borrowed(id),
        })
    }

    /// Subscribes to periodic updates of a value, reported as [`Event::Reported`]. The subscription overrides
    /// [`Config`] and is restored after each reconnect. [`AutoUpdate::once`] ends it. Periods below 10 ms count as 10
    /// ms.
    ///
    /// The session polls the two states even without updates.
    ///
    /// ```
    /// use wsg_protocol::session::{Config, Session, Topic};
    /// use wsg_protocol::AutoUpdate;
    ///
    /// let mut session = Session::new(Config::DEFAULT);
    /// session.subscribe(Topic::Force, AutoUpdate::every(20));
    /// ```
    pub fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
        self.subscriptions_mut().set(Update::new(topic, update));
    }

    /// Processes an event of the parser.
    pub fn handle<'a>(&mut self, now: Instant, event: &FrameEvent<'a>) -> Option<Event<'a>> {
        let FrameEvent::Frame(frame) = event else {
            return None; // The parser counts it. The request it may have answered is repeated or reported.
        };
        let Ok(reply) = Reply::decode(frame) else {
            self.count_refused();
            return None;
        };
        self.take(now, &reply)
    }

    /// Returns the next command to send and counts it as sent.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Command<'static>> {
        self.poll_transmit_borrowed(now, None)
    }

    /// Returns the next command to send, like [`poll_transmit`](Self::poll_transmit), and may return `borrowed`, the
    /// command of [`request_borrowed`](Self::request_borrowed). It may be returned repeatedly until it is answered.
    pub fn poll_transmit_borrowed<'p>(
        &mut self,
        now: Instant,
        borrowed: Option<Command<'p>>,
    ) -> Option<Command<'p>> {
        match self.next_to_send(now, borrowed.map(|command| command.id()))? {
            Outgoing::FastStop => Some(Command::FastStop),
            Outgoing::Own(command) => Some(*command),
            Outgoing::Borrowed => borrowed,
        }
    }
}

impl Dialect for BinaryDialect {
    type Request = Command<'static>;
    type Invalid = DecodeError;
    type Answer<'a> = Reply<'a>;
    type Value<'a> = Value<'a>;
    type Known = Known;
    type Subscriptions = Subscriptions<Update, { Topic::ALL.len() }>;

    const NOTHING: Known = Known::NOTHING;
    const UPKEEP: Option<CommandId> = Some(CommandId::GetForceLimit);

    /// The two states, device information, limits, then the other subscriptions.
    fn setup(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Command<'static>> {
        const INFO: u8 = STATE_STEPS;
        const LIMITS: u8 = INFO + 1;
        /// Number of steps that query device information and limits.
        const OF_THE_DEVICE: u8 = 2;
        match step {
            0..STATE_STEPS => self.refresh(step, subscribed),
            INFO => Some(Command::GetSystemInfo),
            LIMITS => Some(Command::GetSystemLimits),
            _ => self.refresh(step.saturating_sub(OF_THE_DEVICE), subscribed),
        }
    }

    fn refresh(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Command<'static>> {
        subscribed.nth(step).map(|update| update.request())
    }

    fn name(reply: &Reply<'_>) -> Option<CommandId> {
        Some(reply.id())
    }

    fn status(reply: &Reply<'_>) -> Status {
        reply.status()
    }

    fn value<'r, 'a>(reply: &'r Self::Answer<'a>) -> Option<&'r Self::Value<'a>> {
        reply.value_ref()
    }

    fn role(_: &Reply<'_>) -> Role {
        Role::Any
    }

    fn fits(_: &Command<'static>, _: &Reply<'_>) -> bool {
        true
    }

    fn is_asynchronous(id: CommandId) -> bool {
        id.kind() == Kind::Motion || id.has_completion()
    }

    fn is_late_result(id: CommandId, status: Status, _: bool) -> bool {
        id.is_completion_only(status)
    }

    fn completes_step(_: CommandId, status: Status) -> bool {
        status == Status::Success
    }

    fn is_farewell(_: CommandId) -> bool {
        false
    }

    fn learn(known: &mut Known, value: &Value<'_>) -> Option<bool> {
        known.learn(value)
    }

    fn is_fast_stopped(known: &Known) -> bool {
        known.flags.is_some_and(|flags| flags.contains(SystemFlags::FAST_STOP))
    }

    fn read_back(&self, setting: &Command<'static>) -> Option<Command<'static>> {
        if self.verify_settings { read_back::query(setting) } else { None }
    }

    fn read_back_answer<'a>(
        setting: &Command<'static>,
        read: &Self::Answer<'a>,
        known: &mut Known,
    ) -> Self::Answer<'a> {
        let value = read.value().filter(|value| read_back::agrees(setting, value));
        if let Some(Value::GetForceLimit(read)) = value {
            known.confirm_force_limit(read);
        }
        Reply::status_only(setting.id(), if value.is_some() { Status::Success } else { MISMATCH })
    }

    fn upkeep(known: &Known) -> Option<Command<'static>> {
        known.force_limit.map(|_| Command::GetForceLimit)
    }

    /// Motions are the only requests that do not wait for other replies: not even a query may come between a known
    /// setting and the motion that relies on it. An unknown command may be for a script. A restarted gripper has lost
    /// its settings and needs homing.
    fn forget_changed(known: &mut Known, id: CommandId) {
        if !matches!(id, CommandId::PrePosition | CommandId::GripPart | CommandId::ReleasePart) {
            Self::forget_settings(known);
        }
    }

    fn forget_settings(known: &mut Known) {
        known.force_limit = None;
    }
}

impl Message for Command<'static> {
    type Name = CommandId;

    const STOP: Self = Command::Stop;
    const FAST_STOP: Self = Command::FastStop;

    fn name(&self) -> CommandId {
        self.id()
    }

    fn is_repeatable(&self) -> bool {
        Command::is_repeatable(self)
    }
}

impl Name for CommandId {
    fn kind(self) -> Kind {
        Self::kind(self)
    }

    fn is_repeatable(self) -> bool {
        Self::is_repeatable(self)
    }
}
