//! The worker: sends one order per period and receives the state in between.

use super::line::Exchanges;
use super::pace::Pace;
use super::script::{
    MAX_ANSWER_LEN, Measured, Order, STREAM_END, STREAM_ID, UMI_MEASURE_ID, UMI_MOVE_ID, stream_answer,
    stream_order, umi_answer, umi_order,
};
use super::{
    Backend, Cause, Config, End, GAPS_LEN, Gap, HISTORY_LEN, MAX_GAP_MS, Request, Sample, Shared, keep, lock,
};
use crate::command::Command;
use crate::driver::blocking::{Gripper, Transport};
use crate::driver::engine::{Awaited, Copied, Goal};
use crate::driver::link::Link;
use crate::driver::{
    Clock, Error, Mm, MmPerS, N, OnBlock, Pending, StopHandle, StopKind, UPDATES_LEN, Update,
};
use crate::frame::Frame;
use crate::reply::Reply;
use crate::session::{MISMATCH, Topic};
use crate::time::Instant;
use crate::types::{AutoUpdate, Status, SystemFlags};
use embedded_io::ErrorType;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, mpsc};

/// How late an answer or a period may be, in ms, before it counts as a gap.
const GAP_MS: u32 = 100;
/// The travel time of one Pre-position, in ms.
const SEGMENT_MS: u32 = 100;
/// The shortest distance for which a Pre-position is sent, in mm.
const SHORTEST_WAY: f32 = 0.05;
/// The update period for width, speed and force, in ms. In field reports, real grippers send up to 140 updates per
/// second.
const UPDATE_PERIOD_MS: u16 = 25;
/// The subscriptions of [`Backend::PrePosition`].
const TOPICS: [Topic; 3] = [Topic::Width, Topic::Speed, Topic::Force];

/// How long the worker of a stream that a FAST STOP has ended waits for bytes before it looks for requests, in ms.
const PARKED_MS: u32 = 20;

/// A homing that has begun, and where its result goes.
type Homing<E> = (Pending<()>, mpsc::Sender<Result<(), Error<E>>>);

/// The gripper, following the trajectory.
#[derive(Debug)]
pub(super) struct Worker<IO: ErrorType, C> {
    gripper: Gripper<IO, C>,
    clock: C,
    shared: Arc<Mutex<Shared>>,
    backend: Backend,
    rate_hz: u16,
    /// Start of the current period.
    due: Instant,
    /// The last ordered position in mm.
    set_point: Option<f32>,
    segment: Segment,
    requests: mpsc::Receiver<Request<IO::Error>>,
    handle: StopHandle,
    homing: Option<Homing<IO::Error>>,
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
    pub(super) fn new(
        mut gripper: Gripper<IO, C>,
        config: Config,
        requests: mpsc::Receiver<Request<IO::Error>>,
        handle: StopHandle,
    ) -> Result<Self, Error<IO::Error>> {
        let mut clock = gripper.clock().clone();
        gripper.engine.link_mut().tolerate_late_answers(true);
        let limits = gripper.limits()?;
        let force_limit = gripper.force_limit()?.0;
        let flags = gripper.system_state()?;
        let mut exchanges = Exchanges::default();
        let mut sent = clock.now();
        let mut found = None;
        for backend in [Backend::Script, Backend::UmiScript] {
            sent = clock.now();
            match exchange(&mut gripper, backend, None) {
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
            queue_len: config.queue_len,
            latest,
            history,
            recorded: Arc::default(),
            gaps: VecDeque::new(),
            exchanges,
            is_end_requested: false,
            is_busy: false,
            cause: None,
            end: None,
        }));
        Ok(Self {
            gripper,
            clock,
            shared,
            backend,
            rate_hz: config.rate_hz,
            due: received_at,
            set_point: None,
            segment: Segment { pending: None, end: position, way: 0.0, blocked: 0.0, force_limit },
            requests,
            handle,
            homing: None,
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
        loop {
            self.due = self.clock.now();
            let mut pace = Pace::new(self.rate_hz, self.due);
            let cause = loop {
                let followed = self.turn().and_then(|()| {
                    let due = pace.next(self.clock.now());
                    self.rest(due)
                });
                if let Err(cause) = followed {
                    break cause;
                }
            };
            if !self.finish(cause).is_fast_stop() {
                return self.gripper;
            }
            loop {
                match self.wait_for_acknowledge() {
                    None => {}
                    Some(true) => break,
                    Some(false) => return self.gripper,
                }
            }
        }
    }

    /// After a FAST STOP, keeps the connection alive for a moment and serves a request to acknowledge. Returns whether the
    /// stream begins again, or `None` while that is open.
    fn wait_for_acknowledge(&mut self) -> Option<bool> {
        if lock(&self.shared).is_end_requested {
            return Some(false);
        }
        let lost = match self.gripper.next_update(PARKED_MS) {
            Ok(_) | Err(Error::Stopped(_)) if self.gripper.is_connected() => None,
            Ok(_) | Err(Error::Stopped(_)) => Some(Cause::Unanswered),
            Err(error) => Some(cause_of(error)),
        };
        if let Some(cause) = lost {
            let mut shared = lock(&self.shared);
            self.reject_requests(&mut shared);
            shared.cause = Some(cause);
            shared.end = shared.end.map(|end| End { cause, ..end });
            return Some(false);
        }
        let Ok(Request { stops, result, .. }) = self.requests.try_recv() else { return None };
        let begun = if self.handle.count() == stops {
            self.end_script().and_then(|()| self.gripper.acknowledge()).and_then(|()| self.begin_again())
        } else {
            Err(Error::Stopped(StopKind::FastStop))
        };
        let mut shared = lock(&self.shared);
        shared.is_busy = false;
        if begun.is_ok() {
            (shared.cause, shared.end) = (None, None);
        }
        drop(shared);
        let is_begun = begun.is_ok();
        // The caller may have gone.
        let _ = result.send(begun);
        is_begun.then_some(true)
    }

    /// Begins again without set-points, with a new sample.
    fn begin_again(&mut self) -> Result<(), Error<IO::Error>> {
        // Updates from before are no samples.
        for _ in 0..UPDATES_LEN {
            self.gripper.next_update(0)?;
        }
        if self.backend == Backend::PrePosition {
            for topic in TOPICS {
                self.gripper.subscribe(topic, AutoUpdate::every(UPDATE_PERIOD_MS));
            }
        }
        self.settle()?;
        self.gripper.engine.link_mut().tolerate_late_answers(true);
        Ok(())
    }

    /// Rejects the request that the worker has not seen.
    fn reject_requests(&self, shared: &mut Shared) {
        shared.is_busy = false;
        while self.requests.try_recv().is_ok() {}
    }

    /// Drops all set-points. The next one begins where the fingers are.
    fn settle(&mut self) -> Result<(), Error<IO::Error>> {
        (lock(&self.shared).trajectory, self.set_point) = (None, None);
        self.measure()?;
        if self.segment.pending.is_none() {
            (self.segment.end, self.segment.blocked) = (lock(&self.shared).latest.position, 0.0);
        }
        Ok(())
    }

    /// Serves the next request of the caller.
    fn serve(&mut self) -> Result<(), Cause> {
        if let Ok(Request { home, result, .. }) = self.requests.try_recv() {
            let begun = self.halt().and_then(|()| match home {
                Some(direction) => self.gripper.begin_home(direction).map(Some),
                None => self.gripper.acknowledge().map(|()| None),
            });
            match begun {
                Ok(Some(pending)) => self.homing = Some((pending, result)),
                Ok(None) => self.answer(&result, Ok(()))?,
                Err(error) => self.answer(&result, Err(error))?,
            }
        }
        let Some((pending, result)) = self.homing.take() else { return Ok(()) };
        match self.gripper.poll(&pending) {
            Ok(None) => self.homing = Some((pending, result)),
            Ok(Some(())) => self.answer(&result, Ok(()))?,
            Err(error) => self.answer(&result, Err(error))?,
        }
        Ok(())
    }

    /// Stops the fingers, so that no earlier set-point moves them any more.
    fn halt(&mut self) -> Result<(), Error<IO::Error>> {
        self.gripper.stop()?;
        if let Some(pending) = self.segment.pending.take()
            // Fetches the result; otherwise the next motion would be rejected.
            && let Err(Error::Stopped(kind)) = self.gripper.wait(&pending)
        {
            return Err(Error::Stopped(kind));
        }
        self.end_script()
    }

    /// Makes the project's script forget the last set-point and a Stop. Otherwise it could affect the following motions, or refuse
    /// the next set-point.
    fn end_script(&mut self) -> Result<(), Error<IO::Error>> {
        if self.backend == Backend::Script {
            exchange(&mut self.gripper, self.backend, None)?;
        }
        Ok(())
    }

    /// Passes the outcome of a request to the caller, which may have gone. Fails if the fingers were stopped, which ends the
    /// stream.
    fn answer(
        &mut self,
        result: &mpsc::Sender<Result<(), Error<IO::Error>>>,
        outcome: Result<(), Error<IO::Error>>,
    ) -> Result<(), Cause> {
        let stopped = match outcome {
            Err(Error::Stopped(kind)) => Err(Cause::Stopped(kind)),
            Err(Error::Aborted) => Err(Cause::StoppedByOther),
            _ => self.settle().map_err(cause_of),
        };
        if stopped.is_ok() {
            lock(&self.shared).is_busy = false;
        }
        let _ = result.send(outcome);
        stopped
    }

    /// Records the state by queries, which every gripper answers at any time.
    fn measure(&mut self) -> Result<(), Error<IO::Error>> {
        let flags = self.gripper.system_state()?;
        let (speed, force) = (self.gripper.speed()?.0, self.gripper.force()?.0);
        let position = self.gripper.width()?.0;
        let measured = Measured { flags, position, speed, force, measured_ms: None };
        lock(&self.shared).record(self.clock.now(), &measured, self.set_point);
        Ok(())
    }

    /// Sends the orders that are due.
    fn turn(&mut self) -> Result<(), Cause> {
        let now = self.clock.now();
        self.check_pause(now)?;
        self.serve()?;
        let is_referenced =
            self.gripper.known().flags.is_some_and(|flags| flags.contains(SystemFlags::REFERENCED));
        if self.homing.is_some() || (self.backend == Backend::PrePosition && !is_referenced) {
            // A script is not called during a motion of the driver, and no gripper sends updates of the width before homing.
            self.measure().map_err(cause_of)?;
        }
        let order = {
            let mut shared = lock(&self.shared);
            if shared.is_end_requested {
                return Err(Cause::Requested);
            }
            shared.order(now)
        };
        self.set_point = order.map(|order| order.position);
        match self.backend {
            _ if self.homing.is_some() => {}
            Backend::PrePosition => self.pre_position(now, order)?,
            Backend::Script | Backend::UmiScript => {
                let latest = lock(&self.shared).latest;
                let order = order.map(|order| (order, latest));
                let measured = exchange(&mut self.gripper, self.backend, order).map_err(cause_of)?;
                self.record(now, measured.ok_or(Cause::Script)?)?;
            }
        }
        self.check()
    }

    /// Receives updates until the next period at `due`, but at least those available.
    fn rest(&mut self, due: Instant) -> Result<(), Cause> {
        self.due = due;
        loop {
            let rest_ms = due.since(self.clock.now());
            let update = self.gripper.next_update(rest_ms).map_err(cause_of)?;
            self.check()?;
            match update {
                Some(Update::Width(position)) if self.backend == Backend::PrePosition => {
                    self.record_update(position)?;
                }
                Some(_) => {}
                None => return Ok(()),
            }
        }
    }

    /// Records the reply to a request of time `sent`.
    fn record(&mut self, sent: Instant, measured: Measured) -> Result<(), Cause> {
        let received = self.clock.now();
        self.check_gap(self.due, received, measured.position)?;
        let mut shared = lock(&self.shared);
        shared.exchanges.add(sent, received, measured.measured_ms);
        shared.record(received, &measured, self.set_point);
        Ok(())
    }

    /// Records an automatic update of the width, with the latest values of the others.
    fn record_update(&mut self, position: f32) -> Result<(), Cause> {
        let received = self.clock.now();
        self.check_pause(received)?;
        let expected = lock(&self.shared).latest.received_at.plus(UPDATE_PERIOD_MS.into());
        self.check_gap(expected, received, self.segment.end)?;
        let known = self.gripper.known();
        let measured = Measured {
            flags: known.flags.unwrap_or_default(),
            position,
            speed: known.speed.unwrap_or_default(),
            force: known.force.unwrap_or_default(),
            measured_ms: None,
        };
        lock(&self.shared).record(received, &measured, self.set_point);
        Ok(())
    }

    /// Handles a pause of this program: the trajectory continues where it was, or the stream ends.
    fn check_pause(&self, now: Instant) -> Result<(), Cause> {
        let here = lock(&self.shared).latest.position;
        self.resume(now.since(self.due), now, here, Cause::Watchdog)
    }

    /// Records a gap if a sample that was `expected` has been `received` late, with the fingers `here` in mm.
    fn check_gap(&self, expected: Instant, received: Instant, here: f32) -> Result<(), Cause> {
        let length_ms = received.since(expected);
        if length_ms > GAP_MS {
            keep(&mut lock(&self.shared).gaps, Gap { begun_at: expected, length_ms }, GAPS_LEN);
            self.gripper.engine.journal().warn(format_args!("the answer was {length_ms} ms late"));
        }
        self.resume(length_ms, received, here, Cause::Unanswered)
    }

    /// After a gap, continues from the last ordered position, or from `here` if the fingers are further on their way. Ends
    /// the stream if set-points became too old in the gap.
    fn resume(&self, gap_ms: u32, now: Instant, here: f32, cause: Cause) -> Result<(), Cause> {
        if gap_ms > MAX_GAP_MS {
            return Err(cause);
        }
        let ordered = match self.backend {
            Backend::PrePosition => Some(self.segment.end),
            Backend::Script | Backend::UmiScript => self.set_point,
        };
        if gap_ms > GAP_MS
            && let Some(ordered) = ordered
            && let Some(trajectory) = &mut lock(&self.shared).trajectory
        {
            trajectory.resume(now, ordered, here);
        }
        Ok(())
    }

    /// Checks for conditions that end the stream without an error reply.
    fn check(&self) -> Result<(), Cause> {
        if !self.gripper.is_connected() {
            return Err(Cause::Unanswered);
        }
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
        let (to, min_speed) = {
            let shared = lock(&self.shared);
            let to = shared.position_at(now.plus(SEGMENT_MS)).unwrap_or(order.position);
            (shared.within_stroke(to), shared.limits.min_speed)
        };
        let way = to - self.segment.end;
        if way.abs() < SHORTEST_WAY || way * self.segment.blocked > 0.0 {
            return Ok(());
        }
        if order.force_limit != self.segment.force_limit {
            self.gripper.set_force_limit(N(order.force_limit)).map_err(cause_of)?;
            self.segment.force_limit = order.force_limit;
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

    /// Stops the fingers, reports the cause and returns it.
    fn finish(&mut self, mut cause: Cause) -> Cause {
        self.gripper.engine.link_mut().tolerate_late_answers(false);
        {
            let mut shared = lock(&self.shared);
            if shared.is_end_requested && cause == Cause::Stopped(StopKind::Stop) {
                cause = Cause::Requested;
            }
            shared.cause = Some(cause);
            self.reject_requests(&mut shared);
            shared.recorded.notify_all();
        }
        let segment = self.segment.pending.take();
        let motion = self.homing.take().map(|(pending, _)| pending).or(segment);
        let is_stop_confirmed = self.gripper.stop().is_ok();
        if is_stop_confirmed && let Some(pending) = &motion {
            // Fetches the result; otherwise the next motion would be rejected.
            let _ = self.gripper.wait(pending);
        }
        match self.backend {
            Backend::Script if is_stop_confirmed => {
                let _ = self.end_script();
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
        let journal = self.gripper.engine.journal();
        match cause {
            Cause::Requested => journal.info(format_args!("stream ended: {cause}")),
            _ => journal.warn(format_args!("stream ended: {cause}")),
        }
        cause
    }
}

/// Sends an order with the latest sample to the script, or only measures, and returns the state. Returns `None` for a
/// reply of another layout.
fn exchange<IO: Transport, C: Clock>(
    gripper: &mut Gripper<IO, C>,
    backend: Backend,
    order: Option<(Order, Sample)>,
) -> Result<Option<Measured>, Error<IO::Error>> {
    let mut buffer = [0; MAX_ANSWER_LEN];
    if backend == Backend::Script {
        let payload = order.map(|(order, _)| stream_order(&order));
        let payload = payload.as_ref().map_or(&STREAM_END[..], |payload| payload);
        return gripper.raw(STREAM_ID, payload, &mut buffer).map(stream_answer);
    }
    let answer = match order {
        Some((order, latest)) => {
            let payload = umi_order(&order, latest.position);
            // A Stop would release the part.
            if is_blocked(latest.flags) {
                gripper.raw(UMI_MOVE_ID, &payload, &mut buffer)?
            } else {
                move_or_stop(gripper, UMI_MOVE_ID, &payload, &mut buffer)?
            }
        }
        None => gripper.raw(UMI_MEASURE_ID, &[0], &mut buffer)?,
    };
    Ok(umi_answer(answer, gripper.known().flags.unwrap_or_default()))
}

/// Sends an order to a script that keeps the last speed. If the answer is late, sends Stop and waits on.
fn move_or_stop<'b, IO: Transport, C: Clock>(
    gripper: &mut Gripper<IO, C>,
    id: u8,
    payload: &[u8],
    buffer: &'b mut [u8],
) -> Result<&'b [u8], Error<IO::Error>> {
    let command = Command::decode(&Frame { id, payload })?;
    gripper.become_free()?;
    gripper.engine.link_mut().request_borrowed(&command)?;
    let mut copied = Copied::new(buffer);
    let look = &mut |reply: &Reply<'_>| copied.take(reply);
    let mut awaited = Awaited::answer(command.id(), Some(command), look);
    let until = gripper.clock.now().plus(GAP_MS);
    if !gripper.drive(&mut awaited, Goal::Answered, Some(until))? {
        gripper.engine.link_mut().request(Command::Stop, None)?;
        gripper.drive(&mut awaited, Goal::Answered, None)?;
    }
    awaited.result()?;
    copied.finish()
}

/// Returns whether the fingers push against a part or an end stop.
fn is_blocked(flags: SystemFlags) -> bool {
    flags.intersects(SystemFlags::BLOCKED_MINUS | SystemFlags::BLOCKED_PLUS)
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
        // The gripper has another force limit than the one that was set.
        Error::Mismatch => Cause::Refused(MISMATCH),
        Error::Closed => Cause::Closed,
        Error::Transport(error) => Cause::Transport(error.kind()),
        _ => Cause::Unanswered,
    }
}

#[cfg(test)]
mod tests {
    use super::super::trajectory::Trajectory;
    use super::*;
    use crate::driver::tests::rig::{Rig, Watch, frame, payload, status};
    use crate::{Command, CommandId, HomingDirection, PrePositionFlags, Reply, Value};
    #[cfg(feature = "log")]
    use std::format;
    use std::vec;
    use std::vec::Vec;

    /// The opening width of the rig, in mm.
    const HERE: f32 = 42.5;

    /// Returns the answer of a script to the request with this ID.
    fn answer(id: u8, position: f32, flags: SystemFlags) -> Vec<u8> {
        let flags = flags.bits().to_le_bytes();
        let head = if id == STREAM_ID { [&[1], &flags[..]].concat() } else { vec![flags[0]] };
        let values = [position, 0.0, 0.0, 0.0].map(f32::to_le_bytes);
        let parameters = [&head, values.as_flattened()].concat();
        frame(Reply::success(Value::Unknown { id, parameters: &parameters }))
    }

    /// Scripts the answer to the next request with this ID, after `ms`.
    fn answer_after(rig: &Rig, ms: u32, id: u8, flags: SystemFlags) {
        rig.script(CommandId::Unknown(id), vec![(ms, answer(id, HERE, flags))]);
    }

    /// Returns a worker that the test advances by hand. A script has answered once.
    fn worker(backend: Backend) -> (Rig, Worker<Rig, Watch>) {
        worker_with(backend, crate::driver::Config::DEFAULT)
    }

    fn worker_with(backend: Backend, config: crate::driver::Config) -> (Rig, Worker<Rig, Watch>) {
        let rig = Rig::new();
        for (script, id) in [(Backend::Script, STREAM_ID), (Backend::UmiScript, UMI_MEASURE_ID)] {
            if backend == script {
                answer_after(&rig, 1, id, SystemFlags::empty());
                break;
            }
            rig.script_status(CommandId::Unknown(id), Status::CmdUnknown);
        }
        let mut gripper = Gripper::<_, _>::with_config(rig.clone(), Watch(rig.clone()), config);
        gripper.connect().unwrap();
        let handle = gripper.stop_handle().unwrap();
        let worker = Worker::new(gripper, Config::DEFAULT, mpsc::channel().1, handle).unwrap();
        assert_eq!(worker.backend(), backend);
        (rig, worker)
    }

    fn now(rig: &Rig) -> Instant {
        rig.world(|world| world.now)
    }

    /// Orders a position, starting at the end of the last segment.
    fn order(rig: &Rig, worker: &Worker<Rig, Watch>, position: f32, speed_limit: f32) {
        let now = rig.world(|world| world.now);
        let mut shared = lock(worker.shared());
        let mut trajectory = Trajectory::at(worker.segment.end, now, 64);
        trajectory.set_target(now, position, speed_limit);
        (shared.trajectory, shared.speed_limit) = (Some(trajectory), speed_limit);
    }

    #[test]
    fn segment_without_a_script_targets_the_trajectory_at_its_end() {
        for (position, way, speed) in [(80.0, 10.0, 100.0), (HERE + 5.0, 5.0, 50.0)] {
            let (rig, mut worker) = worker(Backend::PrePosition);
            order(&rig, &worker, position, 100.0);
            worker.turn().unwrap();
            let flags = PrePositionFlags::STOP_ON_BLOCK;
            let motion = Command::PrePosition { flags, width: HERE + way, speed };
            let last = rig.world(|world| world.received.last().cloned());
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
            assert_eq!(rig.received(CommandId::PrePosition), sent, "{position}");
        }
    }

    #[test]
    fn force_limit_is_sent_only_when_it_has_changed() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        for (force_limit, sent) in [(80.0, 0), (40.0, 1), (40.0, 1)] {
            lock(worker.shared()).force_limit = force_limit;
            order(&rig, &worker, worker.segment.end + 5.0, 100.0);
            worker.turn().unwrap();
            assert_eq!(rig.received(CommandId::SetForceLimit), sent);
            // The end of the motion.
            let pending = worker.segment.pending.take().unwrap();
            worker.gripper.wait(&pending).unwrap();
        }
        assert_eq!(rig.received(CommandId::PrePosition), 3);
    }

    #[test]
    fn only_scriptless_streams_take_width_updates_as_samples() {
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
            let (_rig, mut worker) = worker(Backend::PrePosition);
            let shared = Arc::clone(worker.shared());
            lock(&shared).is_end_requested = is_end_requested;
            worker.finish(cause);
            assert_eq!(lock(&shared).end, Some(End { cause: end, is_stop_confirmed: true }));
        }
    }

    #[test]
    fn acknowledgement_from_before_a_stop_has_no_effect() {
        for (is_before_end, is_before_stop) in [(false, false), (true, false), (false, true)] {
            let (rig, mut worker) = worker(Backend::PrePosition);
            let (requests, received) = mpsc::channel();
            worker.requests = received;
            let handle = worker.handle.clone();
            let (result, outcome) = mpsc::channel();
            let acknowledge =
                |stops| requests.send(Request { home: None, stops, result: result.clone() }).unwrap();
            worker.segment.end = 10.0;
            order(&rig, &worker, 80.0, 100.0);
            if is_before_end {
                acknowledge(handle.count());
            }
            let cause = if is_before_end {
                // By another client.
                Cause::FastStop
            } else {
                handle.fast_stop().unwrap();
                worker.rest(now(&rig)).unwrap_err()
            };
            assert!(worker.finish(cause).is_fast_stop());
            if !is_before_end {
                acknowledge(handle.count());
            }
            if is_before_stop {
                handle.fast_stop().unwrap();
            }
            let is_served = !is_before_end && !is_before_stop;
            assert_eq!(worker.wait_for_acknowledge(), is_served.then_some(true));
            assert_eq!(rig.received(CommandId::Acknowledge), usize::from(is_served));
            assert_eq!(outcome.try_recv().is_ok_and(|outcome| outcome.is_ok()), is_served);
            assert_eq!(lock(worker.shared()).cause, (!is_served).then_some(cause));
            if is_served {
                assert!(lock(worker.shared()).trajectory.is_none());
                assert_eq!(worker.segment.end, HERE);
            }
        }
    }

    #[test]
    fn acknowledgement_while_the_stream_runs_drops_all_set_points() {
        for home in [None, Some(HomingDirection::Positive)] {
            let (rig, mut worker) = worker(Backend::PrePosition);
            let (requests, received) = mpsc::channel();
            worker.requests = received;
            let (result, outcome) = mpsc::channel();
            worker.segment.end = 10.0;
            order(&rig, &worker, 80.0, 100.0);
            requests.send(Request { home, stops: 0, result }).unwrap();
            until_answered(&rig, &mut worker, &outcome);
            // UMI's script keeps its last speed until a Stop.
            assert_eq!((rig.received(CommandId::PrePosition), rig.received(CommandId::Stop)), (0, 1));
            assert_eq!((worker.segment.end, worker.set_point), (HERE, None));
        }
    }

    /// Advances the worker until it has answered a request.
    fn until_answered(
        rig: &Rig,
        worker: &mut Worker<Rig, Watch>,
        outcome: &mpsc::Receiver<Result<(), Error<crate::driver::tests::rig::Noise>>>,
    ) {
        for _ in 0..1_000 {
            worker.turn().unwrap();
            if let Ok(outcome) = outcome.try_recv() {
                return outcome.unwrap();
            }
            worker.rest(now(rig).plus(10)).unwrap();
        }
        panic!("no answer");
    }

    #[test]
    fn lost_connection_replaces_the_fast_stop_as_the_cause() {
        let (rig, mut worker) = worker(Backend::Script);
        worker.finish(Cause::FastStop);
        rig.world(|world| world.closed = true);
        assert_eq!(worker.wait_for_acknowledge(), Some(false));
        let end = End { cause: Cause::Closed, is_stop_confirmed: true };
        let shared = lock(worker.shared());
        assert_eq!((shared.cause, shared.end), (Some(end.cause), Some(end)));
    }

    #[test]
    fn script_is_ended_only_after_a_confirmed_stop() {
        for is_stop_confirmed in [true, false] {
            let (rig, mut worker) = worker(Backend::Script);
            let shared = Arc::clone(worker.shared());
            if !is_stop_confirmed {
                rig.script_status(CommandId::Stop, Status::CmdFailed);
            }
            let before = rig.received(CommandId::Unknown(STREAM_ID));
            worker.finish(Cause::Unanswered);
            let end = End { cause: Cause::Unanswered, is_stop_confirmed };
            assert_eq!(lock(&shared).end, Some(end));
            let ended = rig.received(CommandId::Unknown(STREAM_ID)) - before;
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
    fn unapplied_force_limit_ends_the_stream_before_it_moves() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        rig.script(CommandId::GetForceLimit, vec![(1, frame(Reply::success(Value::GetForceLimit(80.0))))]);
        lock(worker.shared()).force_limit = 40.0;
        order(&rig, &worker, 80.0, 100.0);
        assert_eq!(worker.turn(), Err(Cause::Refused(MISMATCH)));
        assert_eq!(rig.received(CommandId::PrePosition), 0);
    }

    #[test]
    fn motion_that_was_running_before_refuses_the_first_segment() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        let _grip = worker.gripper.begin_grip(Mm(20.0), MmPerS(50.0)).unwrap();
        order(&rig, &worker, 80.0, 100.0);
        assert_eq!(worker.turn(), Err(Cause::Refused(Status::AlreadyRunning)));
    }

    /// The link's time-out with the default settings.
    const LINK_MS: u32 = 600;

    /// Returns the lengths of the gaps so far, in ms.
    fn gaps(worker: &Worker<Rig, Watch>) -> Vec<u32> {
        lock(worker.shared()).gaps.iter().map(|gap| gap.length_ms).collect()
    }

    /// Begins the next period now.
    fn begin_period(rig: &Rig, worker: &mut Worker<Rig, Watch>) {
        worker.due = now(rig);
    }

    #[test]
    fn late_script_answer_is_a_gap_and_the_stream_continues() {
        for (backend, id) in [(Backend::Script, STREAM_ID), (Backend::UmiScript, UMI_MOVE_ID)] {
            for (late_ms, gap) in
                [(GAP_MS, None), (GAP_MS + 1, Some(101)), (240, Some(240)), (599, Some(599))]
            {
                let (rig, mut worker) = worker(backend);
                order(&rig, &worker, 10.0, 100.0);
                begin_period(&rig, &mut worker);
                let begun_at = now(&rig);
                answer_after(&rig, late_ms, id, SystemFlags::empty());
                worker.turn().unwrap();
                let expected: Vec<Gap> =
                    gap.map(|length_ms| Gap { begun_at, length_ms }).into_iter().collect();
                assert_eq!(Vec::from(lock(worker.shared()).gaps.clone()), expected);
                // UMI's script would keep the last speed.
                let is_stopped = backend == Backend::UmiScript && gap.is_some();
                assert_eq!(
                    rig.received(CommandId::Stop),
                    usize::from(is_stopped),
                    "{backend:?}, {late_ms} ms"
                );
                // The time of the gap gives no reach: 1 mm in 10 ms at 100 mm/s.
                let before = worker.set_point.unwrap();
                rig.pass(10);
                begin_period(&rig, &mut worker);
                answer_after(&rig, 1, id, SystemFlags::empty());
                worker.turn().unwrap();
                let way = (worker.set_point.unwrap() - before).abs();
                assert!(gap.is_none() || (0.9..1.2).contains(&way), "{backend:?}, {late_ms} ms: {way} mm");
                assert_eq!(gaps(&worker).len(), expected.len());
            }
        }
    }

    #[cfg(feature = "log")]
    #[test]
    fn gap_and_end_are_recorded_and_samples_are_not() {
        use crate::driver::tests::recorded;

        recorded::begin();
        let (rig, mut worker) = worker(Backend::Script);
        worker.gripper.set_log_name("streaming");
        for late_ms in [1, 240] {
            begin_period(&rig, &mut worker);
            answer_after(&rig, late_ms, STREAM_ID, SystemFlags::empty());
            worker.turn().unwrap();
        }
        worker.finish(Cause::Watchdog);
        let ended = format!("WARN stream ended: {}", Cause::Watchdog);
        assert_eq!(recorded::of("streaming"), ["WARN the answer was 240 ms late", &ended]);
    }

    #[test]
    fn after_a_gap_no_order_leads_back() {
        // Further on the way to 10 mm, before the last order, and past the target.
        for (measured, begin) in [(30.0, 30.0), (60.0, HERE), (5.0, HERE)] {
            let (rig, mut worker) = worker(Backend::Script);
            order(&rig, &worker, 10.0, 100.0);
            begin_period(&rig, &mut worker);
            let late = answer(STREAM_ID, measured, SystemFlags::empty());
            rig.script(CommandId::Unknown(STREAM_ID), vec![(240, late)]);
            worker.turn().unwrap();
            rig.pass(10);
            begin_period(&rig, &mut worker);
            answer_after(&rig, 1, STREAM_ID, SystemFlags::empty());
            worker.turn().unwrap();
            let way = begin - worker.set_point.unwrap();
            assert!((0.9..1.2).contains(&way), "at {measured} mm: {way} mm");
        }
    }

    #[test]
    fn lost_link_ends_the_stream() {
        for (backend, id) in [(Backend::Script, STREAM_ID), (Backend::UmiScript, UMI_MOVE_ID)] {
            let (rig, mut worker) = worker(backend);
            order(&rig, &worker, 10.0, 100.0);
            answer_after(&rig, LINK_MS + 10, id, SystemFlags::empty());
            rig.world(|world| world.silent = true);
            let begun = now(&rig);
            assert_eq!(worker.turn(), Err(Cause::Unanswered));
            assert!(now(&rig).since(begun) <= LINK_MS);
        }
        // Without a request, too.
        let (rig, mut worker) = worker(Backend::PrePosition);
        rig.world(|world| world.silent = true);
        let begun = now(&rig);
        let ended = (0..1_000).find_map(|_| worker.rest(now(&rig).plus(10)).err());
        assert_eq!(ended, Some(Cause::Unanswered));
        assert!(now(&rig).since(begun) <= 2 * LINK_MS);
    }

    #[test]
    fn part_that_is_held_is_not_released_in_a_gap() {
        for (flags, stops) in [(SystemFlags::BLOCKED_MINUS, 0), (SystemFlags::BLOCKED_PLUS, 0)] {
            let (rig, mut worker) = worker(Backend::UmiScript);
            order(&rig, &worker, 10.0, 100.0);
            answer_after(&rig, 1, UMI_MOVE_ID, flags);
            worker.turn().unwrap();
            begin_period(&rig, &mut worker);
            answer_after(&rig, 240, UMI_MOVE_ID, flags);
            worker.turn().unwrap();
            assert_eq!((gaps(&worker), rig.received(CommandId::Stop)), (vec![240], stops));
        }
    }

    #[test]
    fn set_points_older_than_a_second_never_run() {
        // The line tolerates longer pauses than the stream.
        let session = crate::session::Config { reply_timeout_ms: 2_000, ..crate::session::Config::DEFAULT };
        let config = crate::driver::Config { session, ..crate::driver::Config::DEFAULT };
        for (late_ms, result) in [(MAX_GAP_MS, Ok(())), (MAX_GAP_MS + 1, Err(Cause::Unanswered))] {
            let (rig, mut worker) = worker_with(Backend::Script, config);
            order(&rig, &worker, 10.0, 100.0);
            begin_period(&rig, &mut worker);
            answer_after(&rig, late_ms, STREAM_ID, SystemFlags::empty());
            assert_eq!(worker.turn(), result);
            assert_eq!(gaps(&worker), [late_ms]);
        }
        // A pause of the program.
        for (backend, command) in [
            (Backend::Script, CommandId::Unknown(STREAM_ID)),
            (Backend::UmiScript, CommandId::Unknown(UMI_MOVE_ID)),
            (Backend::PrePosition, CommandId::PrePosition),
        ] {
            let (rig, mut worker) = worker(backend);
            order(&rig, &worker, 10.0, 100.0);
            begin_period(&rig, &mut worker);
            let before = rig.received(command);
            rig.pass(MAX_GAP_MS + 1);
            assert_eq!(worker.turn(), Err(Cause::Watchdog));
            assert_eq!(rig.received(command), before);
        }
    }

    #[test]
    fn shorter_pause_of_the_program_gives_no_reach() {
        let (rig, mut worker) = worker(Backend::Script);
        order(&rig, &worker, 10.0, 100.0);
        begin_period(&rig, &mut worker);
        answer_after(&rig, 1, STREAM_ID, SystemFlags::empty());
        worker.turn().unwrap();
        let before = worker.set_point.unwrap();
        rig.pass(MAX_GAP_MS - 10);
        answer_after(&rig, 1, STREAM_ID, SystemFlags::empty());
        worker.turn().unwrap();
        assert_eq!(worker.set_point, Some(before));
        assert_eq!(gaps(&worker).len(), 1);
    }

    #[test]
    fn late_start_of_a_segment_and_missing_updates_are_gaps() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        order(&rig, &worker, 80.0, 100.0);
        begin_period(&rig, &mut worker);
        let id = CommandId::PrePosition;
        let pending = status(id, Status::CmdPending);
        rig.script(id, vec![(240, pending), (340, status(id, Status::Success))]);
        let expected = lock(worker.shared()).latest.received_at.plus(UPDATE_PERIOD_MS.into());
        worker.turn().unwrap();
        rig.inject(&frame(Reply::success(Value::GetOpeningWidth(41.0))));
        worker.rest(now(&rig)).unwrap();
        assert_eq!(gaps(&worker), [now(&rig).since(expected)]);
        assert!(gaps(&worker)[0] >= 200);
        assert_eq!(rig.received(id), 1);
    }

    #[test]
    fn times_of_samples_increase_strictly() {
        let (rig, mut worker) = worker(Backend::PrePosition);
        for (pass_ms, width) in [(25, 41.0), (0, 40.0), (0, 39.0), (1, 38.0), (0, 37.0), (24, 36.0)] {
            rig.pass(pass_ms);
            // A shorter and a longer latency.
            let sent = now(&rig).plus(u32::MAX - pass_ms);
            lock(worker.shared()).exchanges.add(sent, now(&rig), None);
            worker.record_update(width).unwrap();
            assert_eq!(lock(worker.shared()).latest.position, width);
        }
        let history = Vec::from(lock(worker.shared()).history.clone());
        // Updates of the same millisecond are one sample, with the latest value.
        let positions: Vec<f32> = history.iter().map(|sample| sample.position).collect();
        assert_eq!(positions, [HERE, 39.0, 37.0, 36.0]);
        for pair in history.windows(2) {
            assert!(pair[1].received_at.signed_since(pair[0].received_at) > 0, "{pair:?}");
            assert!(pair[1].measured_at.signed_since(pair[0].measured_at) > 0, "{pair:?}");
            assert!(pair[1].received_at.has_reached(pair[1].measured_at), "{pair:?}");
            assert_eq!(pair[1].number, pair[0].number + 1);
        }
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
