//! The binary protocol's session.

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
use crate::types::{AutoUpdate, Status};

/// The controller's side of a connection that speaks the binary protocol.
pub type Session = Engine<Binary>;

/// What happened.
pub type Event<'a> = EventOf<CommandId, Reply<'a>, Value<'a>>;

/// By kind and command, without the values.
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

/// The status of a setting that the gripper confirmed but did not take over: read back, it shows another value, or none
/// ([`Config::verify_settings`]).
///
/// It is E_WRITE_ERROR, which the manual lists for none of the settings that are read back, so that a register interface
/// can show it as it is.
pub const MISMATCH: Status = Status::WriteError;

/// The binary protocol (command set).
#[derive(Clone, Copy, Debug, Hash)]
pub struct Binary {
    verify_settings: bool,
}

/// Steps of connecting that ask for the two states, before anything else: a gripper that moves must be noticed at once.
const STATE_STEPS: u8 = 2;

impl Session {
    /// A session that is not connected, and begins to connect at once.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        let dialect = Binary { verify_settings: config.verify_settings };
        Self::over(dialect, config.timing(), topic::of_config(&config))
    }

    /// Asks for a command to be sent. Its outcome comes as an [`Event`].
    ///
    /// Stop, FAST STOP and Acknowledge overtake what waits: it is withdrawn. To ask once for a value that is
    /// subscribed to does not end the subscription.
    ///
    /// # Errors
    /// [`RequestError`]; then the command is not sent, now or later.
    pub fn request(&mut self, mut command: Command<'static>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        // To ask once would end a subscription (command set, 3.4.1).
        if let Some(once) = Update::of(&command).filter(|asked| asked.update == AutoUpdate::once())
            && let Some(subscribed) = self.subscriptions().find(once.name())
        {
            command = subscribed.request();
        }
        self.enqueue(Request::Own(command))
    }

    /// As [`request`](Self::request), for a command that the caller keeps, because it borrows its payload: only the id
    /// is kept here, and the command is sent when [`poll_transmit_borrowed`](Self::poll_transmit_borrowed) has it at
    /// hand.
    ///
    /// A caller that cannot lend it any more calls [`withdraw`](Self::withdraw). A setting that is borrowed is not read
    /// back.
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
    /// [`RequestError`]; then the command is not sent, now or later.
    pub fn request_borrowed(&mut self, command: &Command<'_>) -> Result<(), RequestError> {
        command.check().map_err(RequestError::Invalid)?;
        self.enqueue(match command.id() {
            CommandId::FastStop => Request::Own(Command::FastStop),
            CommandId::Stop => Request::Own(Command::Stop),
            id => Request::Borrowed(id),
        })
    }

    /// Has the gripper send a value by itself from now on, again after each reconnect, as [`Event::Reported`].
    /// [`AutoUpdate::once`] ends that. Periods below 10 ms count as 10 ms. In place of what [`Config`] says.
    ///
    /// The two states are asked for again and again even without updates: the session needs them.
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

    /// Takes what the parser found.
    pub fn handle<'a>(&mut self, now: Instant, event: &FrameEvent<'a>) -> Option<Event<'a>> {
        let FrameEvent::Frame(frame) = event else {
            return None; // The parser counts it; the request that it may have answered is repeated, or reported.
        };
        let Ok(reply) = Reply::decode(frame) else {
            self.count_refused();
            return None;
        };
        self.take(now, &reply)
    }

    /// The next command to send. It counts as sent now.
    pub fn poll_transmit(&mut self, now: Instant) -> Option<Command<'static>> {
        self.poll_transmit_borrowed(now, None)
    }

    /// As [`poll_transmit`](Self::poll_transmit), with the command of [`request_borrowed`](Self::request_borrowed) at
    /// hand. It may be given more than once, until it is answered.
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

impl Dialect for Binary {
    type Request = Command<'static>;
    type Invalid = DecodeError;
    type Answer<'a> = Reply<'a>;
    type Value<'a> = Value<'a>;
    type Known = Known;
    type Subscriptions = Subscriptions<Update, { Topic::ALL.len() }>;

    const NOTHING: Known = Known::NOTHING;
    const UPKEEP: Option<CommandId> = Some(CommandId::GetForceLimit);

    /// The two states, what device, what limits, then the other subscriptions.
    fn setup(&self, step: u8, subscribed: &Self::Subscriptions) -> Option<Command<'static>> {
        const INFO: u8 = STATE_STEPS;
        const LIMITS: u8 = INFO + 1;
        /// Steps that are no subscriptions.
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
        id.kind() == Kind::Motion || !id.completion_statuses().is_empty()
    }

    fn is_late_result(id: CommandId, status: Status, _: bool) -> bool {
        id.completion_statuses().contains(&status) && !id.immediate_statuses().contains(&status)
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

    fn read_back(&self, setting: &Command<'static>) -> Option<Command<'static>> {
        if self.verify_settings { read_back::query(setting) } else { None }
    }

    fn read_back_answer<'a>(
        setting: &Command<'static>,
        read: &Self::Answer<'a>,
        known: &mut Known,
    ) -> Self::Answer<'a> {
        let value = read.value().filter(|value| read_back::agrees(setting, value, known));
        if let Some(Value::GetForceLimit(read)) = value {
            known.confirm_force_limit(read);
        }
        Reply::status_only(setting.id(), if value.is_some() { Status::Success } else { MISMATCH })
    }

    fn upkeep(known: &Known) -> Option<Command<'static>> {
        known.force_limit.map(|_| Command::GetForceLimit)
    }

    fn is_upkeep(request: &Command<'static>) -> bool {
        matches!(request, Command::GetForceLimit)
    }

    /// A motion is the one request that does not wait for the answer to another one: not even a query may lie between what
    /// is known and the motion that relies on it. An unknown command may be a script's. Homing is what a gripper needs that
    /// was restarted, and has forgotten its settings.
    fn leaves_settings(id: CommandId) -> bool {
        matches!(id, CommandId::PrePosition | CommandId::GripPart | CommandId::ReleasePart)
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
