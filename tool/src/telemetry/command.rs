//! Validation of host commands to a gripper (DCMD), without I/O.
//!
//! No command may move the fingers twice or late. A command must therefore carry a new timestamp and be the only content of its
//! message. It is valid only for the current connection to the gripper.

use tokio::sync::mpsc;

use super::{
    metrics::{COMMANDS, Metric, OfCommand},
    payload::{self, MetricValue, Payload},
};

/// Capacity of each order queue of a gripper.
const QUEUE_LEN: usize = 4;

/// The metrics that are commands, of which a message carries exactly one.
const ACTIONS: [OfCommand; 7] = [
    OfCommand::Home,
    OfCommand::Move,
    OfCommand::Grip,
    OfCommand::Release,
    OfCommand::Stop,
    OfCommand::FastStop,
    OfCommand::Acknowledge,
];
/// The metrics that are parameters of a command.
const PARAMETERS: [OfCommand; 3] = [OfCommand::Width, OfCommand::Speed, OfCommand::Force];

/// A command with its parameters in mm, mm/s and N.
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
    /// Returns the row of the command in the table.
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

    /// Returns whether the command takes precedence over queued commands.
    pub(super) const fn is_urgent(&self) -> bool {
        matches!(self, Self::Stop | Self::FastStop)
    }
}

impl OfCommand {
    /// Returns whether the command moves the fingers.
    pub(super) const fn is_motion(self) -> bool {
        matches!(self, Self::Home | Self::Move | Self::Grip | Self::Release)
    }

    fn name(self) -> &'static str {
        COMMANDS.get(usize::from(self)).map_or("", |metric: &Metric| metric.name)
    }

    /// Returns the name used in results, such as "Fast Stop".
    pub(super) fn title(self) -> &'static str {
        self.name().trim_start_matches("Command/")
    }
}

/// An accepted command, with the limits on its execution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Order {
    pub(super) action: Action,
    /// Timestamp of the command in ms since 1970 (UTC).
    pub(super) at: u64,
    /// Latest time to start it, in ms since 1970 (UTC).
    pub(super) expires_at: u64,
    /// Number of times the gripper had been found when the command was accepted.
    pub(super) life: u64,
}

/// Sending side of the order queue of a gripper.
#[derive(Debug)]
pub(super) struct Orders {
    urgent: mpsc::Sender<Order>,
    others: mpsc::Sender<Order>,
}

/// Receiving side of the order queue. Urgent orders are taken first.
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
    /// Queues an order. Returns false if the queue is full.
    pub(super) fn push(&self, order: Order) -> bool {
        let queue = if order.action.is_urgent() { &self.urgent } else { &self.others };
        queue.try_send(order).is_ok()
    }
}

impl Queue {
    /// Waits for the next order. Cancel safe.
    pub(super) async fn next(&mut self) -> Option<Order> {
        tokio::select! {
            biased;
            order = self.urgent.recv() => order,
            order = self.others.recv() => order,
        }
    }
}

/// State of the gripper when a command is received.
#[derive(Clone, Copy, Debug)]
pub(super) struct Situation<'a> {
    /// Current time in ms since 1970 (UTC).
    pub(super) now: u64,
    /// Maximum deviation of a command's timestamp from `now`, in ms.
    pub(super) age_ms: u64,
    /// Latest timestamp of all commands so far.
    pub(super) last_at: u64,
    pub(super) is_online: bool,
    /// Whether an accepted motion is still running.
    pub(super) is_moving: bool,
    /// Permitted ranges, by row of the table.
    pub(super) ranges: &'a [Option<(f32, f32)>],
    /// Alias of the first row of the table.
    pub(super) first_alias: u64,
}

impl Situation<'_> {
    /// Returns the timestamp of a command.
    ///
    /// # Errors
    /// The timestamp is missing, deviates too much from the current time, or is not new.
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
                "its timestamp is not later than the previous command or the program start".to_owned()
            );
        }
        Ok(at)
    }

    /// Returns the command in a payload whose timestamp is valid.
    ///
    /// # Errors
    /// The payload is not a valid command, or the command cannot be accepted now.
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
                return Err(format!("the type of {} differs from the birth", row.name()));
            }
            if let Some((_, slot)) = PARAMETERS.iter().zip(&mut parameters).find(|(of, _)| **of == row) {
                if slot.replace(self.number_of(row, metric)?).is_some() {
                    return Err(format!("{} appears twice", row.name()));
                }
                continue;
            }
            if metric.value != Some(MetricValue::Boolean(true)) {
                return Err(format!("{} is not true", row.name()));
            }
            if command.replace(row).is_some() {
                return Err("it contains more than one command".to_owned());
            }
        }
        let command = command.ok_or_else(|| "it contains no command".to_owned())?;
        let action = action_of(command, parameters)?;
        if !self.is_online {
            return Err("the gripper does not respond".to_owned());
        }
        if self.is_moving && command.is_motion() {
            return Err("the previous motion is not over".to_owned());
        }
        Ok(action)
    }

    /// Finds the row of a metric by name or alias.
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
            (Some(name), _) => format!("{name:?} is not a gripper command or parameter"),
            (None, Some(alias)) => {
                format!("alias {alias} is not a command or parameter of this gripper")
            }
            (None, None) => "a metric has neither name nor alias".to_owned(),
        })
    }

    fn number_of(&self, row: OfCommand, metric: &payload::Metric) -> Result<f32, String> {
        let Some(MetricValue::Float(number)) = metric.value else {
            return Err(format!("{} is not a Float", row.name()));
        };
        match self.ranges.get(usize::from(row)).copied().flatten() {
            // NaN is in no range.
            Some((low, high)) if (low..=high).contains(&number) => Ok(number),
            Some((low, high)) => Err(format!("{} = {number} is outside {low} to {high}", row.name())),
            None => Err(format!("the range of {} is unknown", row.name())),
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
        (OfCommand::Move | OfCommand::Grip, _) => {
            return Err(format!("{title} requires a width and a speed"));
        }
        (OfCommand::Release, _) => return Err(format!("{title} requires a width and a speed, and no force")),
        _ => return Err(format!("{title} takes no parameters")),
    };
    Ok(action)
}

#[cfg(test)]
mod tests;
