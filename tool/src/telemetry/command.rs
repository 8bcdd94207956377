//! Commands of hosts to a gripper (DCMD): which are taken, and why others are not. Without I/O.
//!
//! No command moves fingers twice, late or unasked. So a command says when it was given, must be new, and must be the only thing
//! that its message says; and what is taken counts for the connection to the gripper that there is, not for the next one.

use tokio::sync::mpsc;

use super::{
    metrics::{COMMANDS, Metric, OfCommand},
    payload::{self, MetricValue, Payload},
};

/// Orders of a kind that wait for a gripper.
const QUEUE_LEN: usize = 4;

/// The metrics that are commands.
const ACTIONS: [OfCommand; 7] = [
    OfCommand::Home,
    OfCommand::Move,
    OfCommand::Grip,
    OfCommand::Release,
    OfCommand::Stop,
    OfCommand::FastStop,
    OfCommand::Acknowledge,
];
/// Those that are parameters.
const PARAMETERS: [OfCommand; 3] = [OfCommand::Width, OfCommand::Speed, OfCommand::Force];

/// A command with its parameters: mm, mm/s, N.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Action {
    Home,
    Move { width: f32, speed: f32, force: Option<f32> },
    Grip { width: f32, speed: f32, force: Option<f32> },
    Release { width: f32, speed: f32 },
    Stop,
    FastStop,
    Acknowledge,
}

impl Action {
    /// Its row in the table.
    pub(super) const fn of(&self) -> OfCommand {
        match self {
            Self::Home => OfCommand::Home,
            Self::Move { .. } => OfCommand::Move,
            Self::Grip { .. } => OfCommand::Grip,
            Self::Release { .. } => OfCommand::Release,
            Self::Stop => OfCommand::Stop,
            Self::FastStop => OfCommand::FastStop,
            Self::Acknowledge => OfCommand::Acknowledge,
        }
    }

    /// Whether it overtakes everything else.
    pub(super) const fn is_urgent(&self) -> bool {
        matches!(self, Self::Stop | Self::FastStop)
    }
}

impl OfCommand {
    /// Whether the fingers move by it.
    pub(super) const fn is_motion(self) -> bool {
        matches!(self, Self::Home | Self::Move | Self::Grip | Self::Release)
    }

    fn name(self) -> &'static str {
        COMMANDS.get(usize::from(self)).map_or("", |metric: &Metric| metric.name)
    }

    /// As results have it: "Fast Stop".
    pub(super) fn title(self) -> &'static str {
        self.name().trim_start_matches("Command/")
    }
}

/// A command that was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Order {
    pub(super) action: Action,
    /// When the host gave it, in ms since 1970 (UTC).
    pub(super) at: u64,
    /// Until when it may begin.
    pub(super) expires_at: u64,
    /// How often the gripper had been found when it was taken.
    pub(super) life: u64,
}

/// Where the orders of a gripper go in.
#[derive(Debug)]
pub(super) struct Orders {
    urgent: mpsc::Sender<Order>,
    others: mpsc::Sender<Order>,
}

/// Where they come out. What is urgent is taken first.
#[derive(Debug)]
pub(super) struct Queue {
    pub(super) urgent: mpsc::Receiver<Order>,
    pub(super) others: mpsc::Receiver<Order>,
}

pub(super) fn queue() -> (Orders, Queue) {
    let (urgent, taken_first) = mpsc::channel(QUEUE_LEN);
    let (others, taken_next) = mpsc::channel(QUEUE_LEN);
    (Orders { urgent, others }, Queue { urgent: taken_first, others: taken_next })
}

impl Orders {
    /// Whether there was room for it.
    pub(super) fn push(&self, order: Order) -> bool {
        let queue = if order.action.is_urgent() { &self.urgent } else { &self.others };
        queue.try_send(order).is_ok()
    }
}

impl Queue {
    /// The next order. May be given up: none is lost.
    pub(super) async fn next(&mut self) -> Option<Order> {
        tokio::select! {
            biased;
            order = self.urgent.recv() => order,
            order = self.others.recv() => order,
        }
    }
}

/// What is known of the gripper when a command comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation<'a> {
    /// In ms since 1970 (UTC).
    pub(super) now: u64,
    /// How far the time of a command may be from `now`, in ms.
    pub(super) age_ms: u64,
    /// The latest time of the commands so far.
    pub(super) last_at: u64,
    pub(super) is_online: bool,
    /// Whether a motion that was taken is not over.
    pub(super) is_moving: bool,
    /// By the places of the table.
    pub(super) ranges: &'a [Option<(f32, f32)>],
    /// Of the first row of the table.
    pub(super) first_alias: u64,
}

impl Situation<'_> {
    /// The time of a command, if it is new and of now.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn time_of(&self, payload: &Payload) -> Result<u64, String> {
        let Self { now, age_ms, last_at, .. } = *self;
        let at = payload.timestamp.ok_or_else(|| "it has no timestamp".to_owned())?;
        if at < now.saturating_sub(age_ms) {
            return Err(format!("its timestamp is older than {age_ms} ms"));
        }
        if at > now.saturating_add(age_ms) {
            return Err(format!("its timestamp is more than {age_ms} ms ahead of this computer's clock"));
        }
        if at <= last_at {
            return Err(
                "its timestamp is not later than that of the command before, or of the start".to_owned()
            );
        }
        Ok(at)
    }

    /// The command of a payload whose time is right.
    ///
    /// # Errors
    /// Why it is none, or cannot be taken now.
    pub(super) fn decide(&self, payload: &Payload) -> Result<Action, String> {
        let mut command = None;
        let mut parameters = [None; PARAMETERS.len()];
        for metric in &payload.metrics {
            let row = self.row_of(metric)?;
            if metric.is_null == Some(true) || metric.is_historical == Some(true) {
                return Err(format!("{} is null or historical", row.name()));
            }
            let type_of_row = COMMANDS.get(usize::from(row)).map(Metric::datatype);
            if metric.datatype.is_some() && metric.datatype != type_of_row {
                return Err(format!("{} has another type than in the birth", row.name()));
            }
            if let Some((_, slot)) = PARAMETERS.iter().zip(&mut parameters).find(|(of, _)| **of == row) {
                if slot.replace(self.number_of(row, metric)?).is_some() {
                    return Err(format!("{} is there twice", row.name()));
                }
                continue;
            }
            if metric.value != Some(MetricValue::Boolean(true)) {
                return Err(format!("{} is not true", row.name()));
            }
            if command.replace(row).is_some() {
                return Err("it has more than one command".to_owned());
            }
        }
        let command = command.ok_or_else(|| "it has no command".to_owned())?;
        let action = action_of(command, parameters)?;
        if !self.is_online {
            return Err("the gripper does not answer".to_owned());
        }
        if self.is_moving && command.is_motion() {
            return Err("the motion before is not over".to_owned());
        }
        Ok(action)
    }

    /// Which row of the table, by name or alias, is meant.
    fn row_of(&self, metric: &payload::Metric) -> Result<OfCommand, String> {
        let is_it = |row: &OfCommand| {
            let alias = self.first_alias + usize::from(*row) as u64;
            match (&metric.name, metric.alias) {
                (None, None) => false,
                (name, given) => {
                    name.as_ref().is_none_or(|name| name == row.name())
                        && given.is_none_or(|given| given == alias)
                }
            }
        };
        ACTIONS.into_iter().chain(PARAMETERS).find(is_it).ok_or_else(|| match (&metric.name, metric.alias) {
            (Some(name), _) => format!("{name:?} is no command of a gripper, and no parameter of one"),
            (None, Some(alias)) => {
                format!("the alias {alias} is no command of this gripper, and no parameter of one")
            }
            (None, None) => "a metric has neither name nor alias".to_owned(),
        })
    }

    fn number_of(&self, row: OfCommand, metric: &payload::Metric) -> Result<f32, String> {
        let Some(MetricValue::Float(number)) = metric.value else {
            return Err(format!("{} is no Float", row.name()));
        };
        match self.ranges.get(usize::from(row)).copied().flatten() {
            // NaN is in no range.
            Some((low, high)) if (low..=high).contains(&number) => Ok(number),
            Some((low, high)) => Err(format!("{} = {number} is not in {low} to {high}", row.name())),
            None => Err(format!("the range of {} is not known", row.name())),
        }
    }
}

fn action_of(command: OfCommand, parameters: [Option<f32>; 3]) -> Result<Action, String> {
    let title = command.title();
    let action = match (command, parameters) {
        (OfCommand::Home, [None, None, None]) => Action::Home,
        (OfCommand::Stop, [None, None, None]) => Action::Stop,
        (OfCommand::FastStop, [None, None, None]) => Action::FastStop,
        (OfCommand::Acknowledge, [None, None, None]) => Action::Acknowledge,
        (OfCommand::Move, [Some(width), Some(speed), force]) => Action::Move { width, speed, force },
        (OfCommand::Grip, [Some(width), Some(speed), force]) => Action::Grip { width, speed, force },
        (OfCommand::Release, [Some(width), Some(speed), None]) => Action::Release { width, speed },
        (OfCommand::Move | OfCommand::Grip, _) => return Err(format!("{title} needs a width and a speed")),
        (OfCommand::Release, _) => return Err(format!("{title} needs a width and a speed, and no force")),
        _ => return Err(format!("{title} takes no parameters")),
    };
    Ok(action)
}

#[cfg(test)]
mod tests;
