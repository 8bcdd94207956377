//! Reads a gripper: connects, subscribes to its values, and reports changes.

use std::{future::pending, time::Duration};

use tokio::{sync::watch, time::sleep};
use wsg_protocol::{
    AutoUpdate, SystemFlags,
    driver::{
        self, Config, Error, Update,
        asynch::{Gripper, Transport},
        tokio::TokioTimer,
    },
    session::{self, Known, Topic},
};

use super::{
    command::{Order, Queue},
    commander::{self, Commander},
    config::{Address, Data},
    line::{Line, Sockets},
    metrics::{COMMANDS, GRIPPER, OfCommand, OfGripper, Value},
    payload::DataType,
    report::{Messages, Reporter, What, stopped},
    values::Values,
};

/// Delay before reconnecting to a gripper.
const RETRY: Duration = Duration::from_secs(1);
/// Longest wait for an update before the state is checked, in ms.
const LOOK_MS: u32 = 1_000;
/// Time-out for the disconnect announcement.
const FAREWELL: Duration = Duration::from_millis(500);

/// The rows derived from the system state flags.
const FLAGS: [OfGripper; 5] =
    [OfGripper::Flags, OfGripper::Referenced, OfGripper::Moving, OfGripper::FastStop, OfGripper::Fault];

/// Reads the gripper and executes orders, if allowed, until `stop` is set. Then announces the disconnect to avoid a FAST STOP.
pub(super) async fn read(
    address: Address,
    data: Data,
    sockets: &Sockets,
    reporter: Reporter,
    orders: Option<Queue>,
    mut stop: watch::Receiver<bool>,
) {
    let mut messages = Messages::default();
    let commander = orders.map(|queue| Commander::new(queue, reporter.clone()));
    let values = Values::new(GRIPPER);
    let mut reader = Reader { data, reporter, values, commander, connections: 0, bad_before: 0 };
    loop {
        let ended = tokio::select! {
            line = Line::open(&address, sockets) => match line {
                Ok(line) => Some(line),
                Err(error) => {
                    messages.print(format!("{} ({address}): {error}", reader.reporter.name));
                    None
                }
            },
            () = stopped(&mut stop) => return,
        };
        if let Some(line) = ended {
            let why = reader.serve(line, &mut stop, &mut messages).await;
            if *stop.borrow() {
                return;
            }
            messages.print(format!("{} ({address}): {why}", reader.reporter.name));
        }
        tokio::select! {
            () = sleep(RETRY) => {}
            () = stopped(&mut stop) => return,
        }
    }
}

#[derive(Debug)]
struct Reader {
    data: Data,
    reporter: Reporter,
    values: Values,
    commander: Option<Commander>,
    connections: u64,
    /// Number of bad frames on earlier lines.
    bad_before: u64,
}

impl Reader {
    /// Reads over this line until it fails or the program is to exit. Returns the reason.
    async fn serve<IO: Transport>(
        &mut self,
        line: IO,
        stop: &mut watch::Receiver<bool>,
        messages: &mut Messages,
    ) -> String
    where
        IO::Error: std::fmt::Display,
    {
        let period_ms = self.data.period_ms;
        let session = session::Config {
            width: true,
            speed: true,
            force: true,
            update_period_ms: period_ms,
            // Values are sent automatically, so one request per second suffices to detect a restart.
            refresh_ms: LOOK_MS * session::Topic::ALL.len() as u32,
            // The gripper may correct a force limit without an error.
            verify_settings: true,
            ..session::Config::DEFAULT
        };
        let config = Config { session, ..Config::DEFAULT };
        let mut gripper = Gripper::<_, _>::with_config(line, TokioTimer::new(), config);
        // Changes of state are reported immediately.
        for topic in [Topic::SystemState, Topic::GripperState] {
            gripper.subscribe(topic, AutoUpdate::on_change(AutoUpdate::MIN_PERIOD_MS));
        }
        let end = loop {
            // On a serial line or UDP, a gripper that does not respond may be switched on later.
            let connected = tokio::select! {
                connected = gripper.connect() => connected,
                () = stopped(stop) => break None,
            };
            match connected {
                Ok(()) => {}
                Err(Error::NotConnected) => {
                    messages.print(format!("{}: no response", self.reporter.name));
                    continue;
                }
                Err(error) => break Some(error),
            }
            self.connections += 1;
            messages.print(format!("{}: connected", self.reporter.name));
            let found = self.found(gripper.known());
            self.reporter.send(found).await;
            let end = self.watch(&mut gripper, stop).await;
            if let Some(commander) = &mut self.commander {
                commander.lost().await;
            }
            self.reporter.send(What::Lost).await;
            match end {
                Some(Error::NotConnected) => {
                    messages.print(format!("{}: no longer responds", self.reporter.name))
                }
                end => break end,
            }
        };
        self.bad_before += bad_frames(&gripper.counters());
        // Announce the end even after an error, so that closing a live connection causes no FAST STOP.
        let _ = tokio::time::timeout(FAREWELL, gripper.announce_disconnect()).await;
        end.map_or_else(|| "ended".to_owned(), |error| error.to_string())
    }

    /// Reports changes until the gripper is lost. Returns the error, or `None` if the program is to exit.
    async fn watch<IO: Transport>(
        &mut self,
        gripper: &mut Gripper<IO, TokioTimer>,
        stop: &mut watch::Receiver<bool>,
    ) -> Option<Error<IO::Error>>
    where
        IO::Error: std::fmt::Display,
    {
        let period_ms = self.data.period_ms;
        loop {
            let mut within_ms = self.values.due_in(period_ms).unwrap_or(LOOK_MS);
            if self.commander.as_ref().is_some_and(Commander::is_moving) {
                within_ms = within_ms.min(commander::LOOK_MS);
            }
            let next = tokio::select! {
                biased;
                () = stopped(stop) => return None,
                order = next_order(&mut self.commander) => Next::Order(order),
                update = gripper.next_update(within_ms) => Next::Update(update),
            };
            let update = match (next, &mut self.commander) {
                (Next::Update(update), _) => update,
                (Next::Order(order), Some(commander)) => {
                    commander.carry_out(gripper, order, stop).await;
                    gripper.next_update(0).await
                }
                (Next::Order(_), None) => continue,
            };
            if let Some(commander) = &mut self.commander {
                commander.look(gripper).await;
            }
            let is_urgent = match update {
                Ok(update) => update.is_some_and(|update| self.values.take(update, &self.data)),
                Err(error) => return Some(error),
            };
            if !gripper.is_connected() {
                return Some(Error::NotConnected);
            }
            let bad = self.bad_before + bad_frames(&gripper.counters());
            self.values.set(OfGripper::BadFrames, Some(Value::Unsigned(bad)));
            if (is_urgent || self.values.due_in(period_ms) == Some(0))
                && let Some(changed) = self.values.changed()
            {
                self.reporter.send(changed).await;
            }
        }
    }

    fn found(&mut self, known: &Known) -> What {
        self.values = Values::of(known);
        self.values.set(OfGripper::Connections, Some(Value::Unsigned(self.connections)));
        self.values.set(OfGripper::BadFrames, Some(Value::Unsigned(self.bad_before)));
        let mut ranges = vec![None; GRIPPER.len()];
        if let Some(limits) = &known.limits {
            let force = limits.overdrive_force.max(limits.nominal_force);
            ranges[usize::from(OfGripper::Width)] = Some((0.0, limits.stroke));
            ranges[usize::from(OfGripper::Speed)] = Some((-limits.max_speed, limits.max_speed));
            ranges[usize::from(OfGripper::Force)] = Some((0.0, force));
        }
        let mut values = self.values.all();
        if let Some(commander) = &mut self.commander {
            commander.found(self.connections);
            for metric in COMMANDS {
                let is_command = metric.datatype == DataType::Boolean;
                values.push(is_command.then_some(Value::Boolean(false)));
            }
            let mut accepted = vec![None; COMMANDS.len()];
            if let Some(limits) = &known.limits {
                accepted[usize::from(OfCommand::Width)] = Some((0.0, limits.stroke));
                accepted[usize::from(OfCommand::Speed)] = Some((limits.min_speed, limits.max_speed));
                // The nominal force is the limit, because overdrive is off.
                accepted[usize::from(OfCommand::Force)] = Some((limits.min_force, limits.nominal_force));
            }
            ranges.extend(accepted);
        }
        What::Found { values, ranges }
    }
}

/// The next event to handle.
enum Next<E> {
    Order(Order),
    Update(Result<Option<Update>, Error<E>>),
}

/// Waits for the next order; never completes without a commander. Cancel safe.
async fn next_order(commander: &mut Option<Commander>) -> Order {
    let next = match commander {
        Some(commander) => commander.next().await,
        None => None,
    };
    match next {
        Some(order) => order,
        None => pending().await,
    }
}

fn bad_frames(counters: &driver::DriverCounters) -> u64 {
    u64::from(counters.line.bad_checksum) + u64::from(counters.line.oversize)
}

impl Values {
    /// Returns the known values of a gripper that was found.
    fn of(known: &Known) -> Self {
        let mut values = Self::new(GRIPPER);
        for (of, number) in [
            (OfGripper::Width, known.width),
            (OfGripper::Speed, known.speed),
            (OfGripper::Force, known.force),
        ] {
            values.set(of, number.map(Value::Float));
        }
        if let Some(flags) = known.flags {
            values.take_flags(flags);
        }
        values.set(OfGripper::State, known.state.map(|state| Value::Text(state.to_string())));
        if let Some(info) = known.info {
            values.set(OfGripper::Device, Some(Value::Text(info.device.to_string())));
            values.set(OfGripper::Serial, Some(Value::Unsigned(info.serial_number.into())));
            values.set(OfGripper::Firmware, Some(Value::Text(info.firmware.to_string())));
        }
        values
    }

    /// Sets an updated value. Returns whether to report it immediately.
    fn take(&mut self, update: Update, data: &Data) -> bool {
        match update {
            // The reported width is meaningless until the fingers are referenced.
            Update::Width(_) if self.get(OfGripper::Referenced) != Some(&Value::Boolean(true)) => {}
            Update::Width(width) => self.measured(OfGripper::Width, width, data.width_deadband),
            Update::Speed(speed) => self.measured(OfGripper::Speed, speed, data.speed_deadband),
            Update::Force(force) => self.measured(OfGripper::Force, force, data.force_deadband),
            Update::SystemState(flags) => {
                self.take_flags(flags);
                return self.is_changed();
            }
            Update::GripperState(state) => {
                self.set(OfGripper::State, Some(Value::Text(state.to_string())));
                return self.is_changed();
            }
            _ => {}
        }
        false
    }

    fn take_flags(&mut self, flags: SystemFlags) {
        self.set_flags(FLAGS, flags);
        if !flags.contains(SystemFlags::REFERENCED) {
            self.set(OfGripper::Width, None);
        }
    }
}
