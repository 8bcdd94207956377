//! The worker: sends one order per period and receives the state in between.

use super::line::Exchanges;
use super::pace::Pace;
use super::script::{
    MAX_ANSWER_LEN, Measured, Order, STREAM_END, STREAM_ID, UMI_MEASURE_ID, UMI_MOVE_ID, stream_answer,
    stream_order, umi_answer, umi_order,
};
use super::{Backend, Cause, Config, End, HISTORY_LEN, Sample, Shared, lock};
use crate::driver::blocking::{Gripper, Transport};
use crate::driver::{Clock, Error, Mm, MmPerS, N, OnBlock, Pending, StopKind, Update};
use crate::session::Topic;
use crate::time::Instant;
use crate::types::{AutoUpdate, Status, SystemFlags};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

/// The travel time of one Pre-position, in ms.
const SEGMENT_MS: u32 = 100;
/// The shortest distance for which a Pre-position is sent, in mm.
const SHORTEST_WAY: f32 = 0.05;
/// The update period for width, speed and force, in ms. In field reports, real grippers send up to 140 updates per
/// second.
const UPDATE_PERIOD_MS: u16 = 25;
/// The subscriptions of [`Backend::PrePosition`].
const TOPICS: [Topic; 3] = [Topic::Width, Topic::Speed, Topic::Force];

/// The gripper, following the trajectory.
#[derive(Debug)]
pub(super) struct Worker<IO, C> {
    gripper: Gripper<IO, C>,
    clock: C,
    shared: Arc<Mutex<Shared>>,
    backend: Backend,
    rate_hz: u16,
    /// The last ordered position in mm.
    set_point: Option<f32>,
    segment: Segment,
}

/// The state of the Pre-position back-end.
#[derive(Debug)]
struct Segment {
    pending: Option<Pending<()>>,
    /// The current or planned end of the last segment, in mm.
    end: f32,
    /// The distance of the last segment, in mm.
    way: f32,
    /// The direction in which the fingers are blocked: positive is opening, 0 is none.
    blocked: f32,
    /// The applied force limit in N.
    force_limit: f32,
}

impl<IO: Transport, C: Clock + Clone> Worker<IO, C> {
    /// Detects the back-end and measures once.
    pub(super) fn new(mut gripper: Gripper<IO, C>, config: Config) -> Result<Self, Error<IO::Error>> {
        let mut clock = gripper.clock().clone();
        let limits = gripper.limits()?;
        let force_limit = gripper.force_limit()?.0;
        let flags = gripper.system_state()?;
        let mut exchanges = Exchanges::default();
        let mut sent = clock.now();
        let mut found = None;
        for backend in [Backend::Script, Backend::UmiScript] {
            sent = clock.now();
            match exchange(&mut gripper, backend, None, 0.0) {
                Ok(Some(measured)) => found = Some((backend, measured)),
                // The command is unsupported, or another script uses it.
                Ok(None) | Err(Error::Refused(_) | Error::TooLong { .. }) => continue,
                Err(error) => return Err(error),
            }
            break;
        }
        let (backend, measured) = match found {
            Some(found) => found,
            None => {
                for topic in TOPICS {
                    gripper.subscribe(topic, AutoUpdate::every(UPDATE_PERIOD_MS));
                }
                let (speed, force) = (gripper.speed()?.0, gripper.force()?.0);
                sent = clock.now();
                let position = gripper.width()?.0;
                (Backend::PrePosition, Measured { flags, position, speed, force, measured_ms: None })
            }
        };
        let received_at = clock.now();
        exchanges.add(sent, received_at, measured.measured_ms);
        let Measured { flags, position, speed, force, measured_ms } = measured;
        let measured_at = exchanges.estimate().measured_at(received_at, measured_ms);
        let latest =
            Sample { number: 0, measured_at, received_at, position, speed, force, flags, set_point: None };
        let mut history = VecDeque::with_capacity(HISTORY_LEN);
        history.push_back(latest);
        let shared = Arc::new(Mutex::new(Shared {
            limits,
            trajectory: None,
            speed_limit: limits.max_speed,
            force_limit,
            latest,
            history,
            exchanges,
            is_end_requested: false,
            cause: None,
            end: None,
        }));
        Ok(Self {
            gripper,
            clock,
            shared,
            backend,
            rate_hz: config.rate_hz,
            set_point: None,
            segment: Segment { pending: None, end: position, way: 0.0, blocked: 0.0, force_limit },
        })
    }

    pub(super) const fn shared(&self) -> &Arc<Mutex<Shared>> {
        &self.shared
    }

    pub(super) const fn backend(&self) -> Backend {
        self.backend
    }

    /// Follows the trajectory until the stream ends, and returns the gripper.
    pub(super) fn run(mut self) -> Gripper<IO, C> {
        let mut pace = Pace::new(self.rate_hz, self.clock.now());
        let cause = loop {
            let followed = self.turn().and_then(|()| {
                let due = pace.next(self.clock.now());
                self.rest(due)
            });
            if let Err(cause) = followed {
                break cause;
            }
        };
        self.finish(cause)
    }

    /// Sends the orders that are due.
    fn turn(&mut self) -> Result<(), Cause> {
        let now = self.clock.now();
        let order = {
            let mut shared = lock(&self.shared);
            if shared.is_end_requested {
                return Err(Cause::Requested);
            }
            shared.order(now)
        };
        self.set_point = order.map(|order| order.position);
        match self.backend {
            Backend::PrePosition => self.pre_position(now, order)?,
            Backend::Script | Backend::UmiScript => {
                let here = lock(&self.shared).latest.position;
                let measured = exchange(&mut self.gripper, self.backend, order, here).map_err(cause_of)?;
                self.record(now, measured.ok_or(Cause::Script)?);
            }
        }
        self.check()
    }

    /// Receives updates until `due`, but at least those available.
    fn rest(&mut self, due: Instant) -> Result<(), Cause> {
        loop {
            let rest_ms = due.since(self.clock.now());
            let update = self.gripper.next_update(rest_ms).map_err(cause_of)?;
            self.check()?;
            match update {
                Some(Update::Width(position)) if self.backend == Backend::PrePosition => {
                    self.record_update(position);
                }
                Some(_) => {}
                None => return Ok(()),
            }
        }
    }

    /// Records the reply to a request of time `sent`.
    fn record(&mut self, sent: Instant, measured: Measured) {
        let received = self.clock.now();
        let mut shared = lock(&self.shared);
        shared.exchanges.add(sent, received, measured.measured_ms);
        shared.record(received, &measured, self.set_point);
    }

    /// Records an automatic update of the width, with the latest values of the others.
    fn record_update(&mut self, position: f32) {
        let received = self.clock.now();
        let known = self.gripper.known();
        let measured = Measured {
            flags: known.flags.unwrap_or_default(),
            position,
            speed: known.speed.unwrap_or_default(),
            force: known.force.unwrap_or_default(),
            measured_ms: None,
        };
        lock(&self.shared).record(received, &measured, self.set_point);
    }

    /// Checks for conditions that end the stream without an error reply.
    fn check(&self) -> Result<(), Cause> {
        let reported = lock(&self.shared).latest.flags;
        let known = self.gripper.known().flags.unwrap_or_default();
        if known.union(reported).contains(SystemFlags::FAST_STOP) {
            return Err(Cause::FastStop);
        }
        if self.backend != Backend::PrePosition && known.contains(SystemFlags::SCRIPT_FAILURE) {
            return Err(Cause::Script);
        }
        Ok(())
    }

    /// Begins the next segment when the previous one has ended. A running segment is not replaced, because the gripper
    /// rejects a Pre-position while the fingers move (command set, 3.2.2).
    fn pre_position(&mut self, now: Instant, order: Option<Order>) -> Result<(), Cause> {
        if let Some(pending) = &self.segment.pending {
            match self.gripper.poll(pending) {
                Ok(None) => return Ok(()),
                Ok(Some(())) => {}
                Err(Error::Blocked) => {
                    self.segment.blocked = self.segment.way;
                    self.segment.end = self.gripper.width().map_err(cause_of)?.0;
                }
                Err(error) => return Err(cause_of(error)),
            }
            self.segment.pending = None;
        }
        let Some(order) = order else { return Ok(()) };
        let shared = lock(&self.shared);
        let to = shared.position_at(now.plus(SEGMENT_MS)).unwrap_or(order.position);
        let min_speed = shared.limits.min_speed;
        drop(shared);
        let way = to - self.segment.end;
        if way.abs() < SHORTEST_WAY || way * self.segment.blocked > 0.0 {
            return Ok(());
        }
        if order.force_limit != self.segment.force_limit {
            match self.gripper.set_force_limit(N(order.force_limit)) {
                // The gripper's own limits may be narrower.
                Ok(()) | Err(Error::Mismatch) => self.segment.force_limit = order.force_limit,
                Err(error) => return Err(cause_of(error)),
            }
        }
        // A short way takes less time than a segment, because the driver refuses a speed below the gripper's minimum.
        let speed = (way.abs() * 1_000.0 / SEGMENT_MS as f32).max(min_speed).min(order.speed_limit);
        let sent = self.clock.now();
        let pending = self.gripper.begin_move_to(Mm(to), MmPerS(speed), OnBlock::Stop).map_err(cause_of)?;
        lock(&self.shared).exchanges.add(sent, self.clock.now(), None);
        self.segment =
            Segment { pending: Some(pending), end: to, way, blocked: 0.0, force_limit: order.force_limit };
        Ok(())
    }

    /// Stops the fingers and reports the cause.
    fn finish(mut self, mut cause: Cause) -> Gripper<IO, C> {
        {
            let mut shared = lock(&self.shared);
            if shared.is_end_requested && cause == Cause::Stopped(StopKind::Stop) {
                cause = Cause::Requested;
            }
            shared.cause = Some(cause);
        }
        let is_stop_confirmed = self.gripper.stop().is_ok();
        if is_stop_confirmed && let Some(pending) = &self.segment.pending {
            // Fetches the result; otherwise the next motion would be rejected.
            let _ = self.gripper.wait(pending);
        }
        match self.backend {
            Backend::Script if is_stop_confirmed => {
                // Otherwise the script could affect the following motions.
                let _ = exchange(&mut self.gripper, self.backend, None, 0.0);
            }
            Backend::Script | Backend::UmiScript => {}
            Backend::PrePosition => {
                for topic in TOPICS {
                    self.gripper.subscribe(topic, AutoUpdate::once());
                }
            }
        }
        // FAST STOP also aborts motions.
        if cause == Cause::StoppedByOther
            && self.gripper.system_state().is_ok_and(|flags| flags.contains(SystemFlags::FAST_STOP))
        {
            cause = Cause::FastStop;
        }
        let mut shared = lock(&self.shared);
        shared.cause = Some(cause);
        shared.end = Some(End { cause, is_stop_confirmed });
        drop(shared);
        self.gripper
    }
}

/// Sends an order to the script, or only measures, and returns the state. `here` is the measured position in mm.
/// Returns `None` for a reply of another layout.
fn exchange<IO: Transport, C: Clock>(
    gripper: &mut Gripper<IO, C>,
    backend: Backend,
    order: Option<Order>,
    here: f32,
) -> Result<Option<Measured>, Error<IO::Error>> {
    let mut buffer = [0; MAX_ANSWER_LEN];
    if backend == Backend::Script {
        let payload = order.map(|order| stream_order(&order));
        let payload = payload.as_ref().map_or(&STREAM_END[..], |payload| payload);
        return gripper.raw(STREAM_ID, payload, &mut buffer).map(stream_answer);
    }
    let answer = match order {
        Some(order) => gripper.raw(UMI_MOVE_ID, &umi_order(&order, here), &mut buffer)?,
        None => gripper.raw(UMI_MEASURE_ID, &[0], &mut buffer)?,
    };
    Ok(umi_answer(answer, gripper.known().flags.unwrap_or_default()))
}

fn cause_of<E: embedded_io::Error>(error: Error<E>) -> Cause {
    match error {
        Error::Stopped(kind) => Cause::Stopped(kind),
        Error::Refused(Status::AccessDenied) => Cause::FastStop,
        Error::Refused(Status::CmdAborted) | Error::Aborted => Cause::StoppedByOther,
        Error::Refused(Status::Timeout) => Cause::Watchdog,
        Error::Refused(Status::CmdUnknown | Status::CmdFailed) | Error::TooLong { .. } => Cause::Script,
        Error::Refused(status) | Error::Failed(status) => Cause::Refused(status),
        Error::OutOfLimits(_) => Cause::Refused(Status::RangeError),
        Error::MotionRunning => Cause::Refused(Status::AlreadyRunning),
        Error::Closed => Cause::Closed,
        Error::Transport(error) => Cause::Transport(error.kind()),
        _ => Cause::Unanswered,
    }
}

#[cfg(test)]
mod tests {
    use super::super::trajectory::Trajectory;
    use super::*;
    use crate::driver::tests::rig::{Rig, Watch, frame, payload};
    use crate::{Command, CommandId, PrePositionFlags, Reply, Value};
    use std::vec;

    /// The opening width of the rig, in mm.
    const HERE: f32 = 42.5;

    /// Returns a worker that the test advances by hand. With [`Backend::Script`], the script has answered once.
    fn worker(backend: Backend) -> (Rig, Worker<Rig, Watch>) {
        let rig = Rig::new();
        for id in [STREAM_ID, UMI_MEASURE_ID].map(CommandId::Unknown) {
            if backend == Backend::Script {
                let values = [0.0, HERE, 0.0, 0.0, 0.0].map(f32::to_le_bytes);
                let parameters = [&[1], values.as_flattened()].concat();
                let value = Value::Unknown { id: STREAM_ID, parameters: &parameters };
                rig.script(id, vec![(1, frame(Reply::success(value)))]);
                break;
            }
            rig.script_status(id, Status::CmdUnknown);
        }
        let gripper = crate::driver::tests::connect(&rig);
        let worker = Worker::new(gripper, Config::DEFAULT).unwrap();
        assert_eq!(worker.backend(), backend);
        (rig, worker)
    }

    /// Orders a position, starting at the end of the last segment.
    fn order(rig: &Rig, worker: &Worker<Rig, Watch>, position: f32, speed_limit: f32) {
        let now = rig.world(|world| world.now);
        let mut shared = lock(worker.shared());
        let mut trajectory = Trajectory::at(worker.segment.end, now);
        trajectory.set_target(now, position, speed_limit);
        (shared.trajectory, shared.speed_limit) = (Some(trajectory), speed_limit);
    }

    #[test]
    fn segment_without_a_script_goes_where_the_trajectory_is_at_its_end() {
        for (position, way, speed) in [(80.0, 10.0, 100.0), (HERE + 5.0, 5.0, 50.0)] {
            let (rig, mut worker) = worker(Backend::PrePosition);
            order(&rig, &worker, position, 100.0);
            worker.turn().unwrap();
            let flags = PrePositionFlags::STOP_ON_BLOCK;
            let motion = Command::PrePosition { flags, width: HERE + way, speed };
            let last = rig.world(|world| world.heard.last().cloned());
            assert_eq!(last, Some((CommandId::PrePosition.code(), payload(&motion))));
        }
    }

    #[test]
    fn shortest_way_is_sent_and_a_shorter_one_is_not() {
        for (position, sent) in [(0.04, 0), (SHORTEST_WAY, 1)] {
            let (rig, mut worker) = worker(Backend::PrePosition);
            worker.segment.end = 0.0;
            order(&rig, &worker, position, 100.0);
            worker.turn().unwrap();
            assert_eq!(rig.heard(CommandId::PrePosition), sent, "{position}");
        }
    }

    #[test]
    fn force_limit_is_sent_only_when_it_has_changed() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        for (force_limit, sent) in [(80.0, 0), (40.0, 1), (40.0, 1)] {
            lock(worker.shared()).force_limit = force_limit;
            order(&rig, &worker, worker.segment.end + 5.0, 100.0);
            worker.turn().unwrap();
            assert_eq!(rig.heard(CommandId::SetForceLimit), sent);
            // The end of the motion.
            let pending = worker.segment.pending.take().unwrap();
            worker.gripper.wait(&pending).unwrap();
        }
        assert_eq!(rig.heard(CommandId::PrePosition), 3);
    }

    #[test]
    fn only_a_stream_without_a_script_takes_updates_of_the_width_as_samples() {
        for (backend, position) in [(Backend::PrePosition, 41.0), (Backend::Script, HERE)] {
            let (rig, mut worker) = worker(backend);
            // The caller's subscription.
            worker.gripper.subscribe(Topic::Width, AutoUpdate::every(10));
            worker.rest(rig.world(|world| world.now.plus(50))).unwrap();
            rig.inject(&frame(Reply::success(Value::GetOpeningWidth(41.0))));
            worker.rest(rig.world(|world| world.now)).unwrap();
            assert_eq!(lock(worker.shared()).latest.position, position);
        }
    }

    #[test]
    fn failure_of_a_script_ends_only_a_stream_that_uses_one() {
        for (backend, rested) in [(Backend::PrePosition, Ok(())), (Backend::Script, Err(Cause::Script))] {
            let (rig, mut worker) = worker(backend);
            rig.inject(&frame(Reply::success(Value::GetSystemState(SystemFlags::SCRIPT_FAILURE))));
            assert_eq!(worker.rest(rig.world(|world| world.now)), rested);
        }
    }

    #[test]
    fn stop_of_the_caller_is_its_end_and_no_other_cause() {
        let (stop, fast_stop) = (Cause::Stopped(StopKind::Stop), Cause::Stopped(StopKind::FastStop));
        for (is_end_requested, cause, end) in
            [(true, stop, Cause::Requested), (false, stop, stop), (true, fast_stop, fast_stop)]
        {
            let (_rig, worker) = worker(Backend::PrePosition);
            let shared = Arc::clone(worker.shared());
            lock(&shared).is_end_requested = is_end_requested;
            let _gripper = worker.finish(cause);
            assert_eq!(lock(&shared).end, Some(End { cause: end, is_stop_confirmed: true }));
        }
    }

    #[test]
    fn script_is_ended_only_after_a_confirmed_stop() {
        for is_stop_confirmed in [true, false] {
            let (rig, worker) = worker(Backend::Script);
            let shared = Arc::clone(worker.shared());
            if !is_stop_confirmed {
                rig.script_status(CommandId::Stop, Status::CmdFailed);
            }
            let before = rig.heard(CommandId::Unknown(STREAM_ID));
            let _gripper = worker.finish(Cause::Unanswered);
            let end = End { cause: Cause::Unanswered, is_stop_confirmed };
            assert_eq!(lock(&shared).end, Some(end));
            let ended = rig.heard(CommandId::Unknown(STREAM_ID)) - before;
            assert_eq!(ended, usize::from(is_stop_confirmed));
        }
    }

    #[test]
    fn each_refusal_of_a_script_is_a_cause() {
        for (status, cause) in [
            (Status::AccessDenied, Cause::FastStop),
            (Status::CmdAborted, Cause::StoppedByOther),
            (Status::Timeout, Cause::Watchdog),
            (Status::CmdUnknown, Cause::Script),
            (Status::CmdFailed, Cause::Script),
            (Status::RangeError, Cause::Refused(Status::RangeError)),
        ] {
            let (rig, mut worker) = worker(Backend::Script);
            rig.script_status(CommandId::Unknown(STREAM_ID), status);
            assert_eq!(worker.turn(), Err(cause));
        }
    }

    #[test]
    fn motion_that_was_running_before_refuses_the_first_segment() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        let _grip = worker.gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
        order(&rig, &worker, 80.0, 100.0);
        assert_eq!(worker.turn(), Err(Cause::Refused(Status::AlreadyRunning)));
    }

    #[test]
    fn loss_of_the_line_is_named() {
        let (rig, mut worker) = worker(Backend::Script);
        rig.world(|world| world.noise = true);
        assert_eq!(worker.turn(), Err(Cause::Transport(embedded_io::ErrorKind::Other)));
        rig.world(|world| world.closed = true);
        assert_eq!(worker.turn(), Err(Cause::Closed));
    }
}
