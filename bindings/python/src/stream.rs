//! Set-point streaming: the worker of `driver::stream`, with times of the system clock.

use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc::RecvTimeoutError};
use std::time::{Duration, Instant};
use std::{io, mem, thread};

use pyo3::exceptions::PyStopIteration;
use pyo3::prelude::*;
use wsg_protocol::HomingDirection;
use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::stream::{
    Backend, Cause, Config, End, Gap, HORIZON_MS, Outcome, Rejected, Sample, SetPointStream, StartError,
};
use wsg_protocol::driver::{self, Error, Mm, MmPerS, N, stream};
use wsg_protocol::limits::{OutOfLimits, Quantity};
use wsg_protocol::{SystemLimits, session};
use wsg_tool::Address;

use crate::core::{Close, close_at_exit};
use crate::driver::{Limits, homing, limits_as_tuple};
use crate::error;
use crate::interpreter::{SIGNALS, detach, process, unix_now};
use crate::line::{Calls, Clock, Line};
use crate::number::shortest;

type Running = SetPointStream<Line, Clock>;
/// Number, measured and received time in s, position in mm, speed in mm/s, force in N, flags, set-point in mm.
type Row = (u32, f64, f64, f64, f64, f64, u32, Option<f64>);

/// The driver's settings, with a time-out of the link of 1 s.
const DRIVER: driver::Config = driver::Config {
    session: session::Config { attempts: 5, ..driver::Config::DEFAULT.session },
    ..driver::Config::DEFAULT
};
/// Difference of the clocks, in s, from which the system clock counts as set.
const CLOCK_STEP: f64 = 0.01;
/// Longest time between two readings of clocks that count as simultaneous, in s.
const SIMULTANEOUS: f64 = 1e-3;

/// A stream of set-points.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Stream(Arc<Inner>);

struct Inner {
    state: Mutex<State>,
    /// Held by the thread that closes the connection, which others may await without the interpreter lock only.
    closing: Mutex<()>,
    /// The zero point of the driver's clock, and its time of the system clock in s.
    start: Instant,
    start_unix: Mutex<f64>,
    backend: Backend,
    limits: SystemLimits,
    process: usize,
}

enum State {
    Running(Running),
    Ended(End, Vec<Sample>, Vec<Gap>),
}

/// The reason why no stream began.
enum Failed {
    Start(StartError<io::Error>),
    Limits(OutOfLimits),
}

impl From<Error<io::Error>> for Failed {
    fn from(error: Error<io::Error>) -> Self {
        Self::Start(StartError::Driver(error))
    }
}

#[pymethods]
impl Stream {
    /// Connects, checks the limits, homes in a direction if one is given, and starts the worker.
    #[new]
    fn new(
        py: Python<'_>,
        address: &str,
        rate_hz: u16,
        queue_len: usize,
        direction: Option<u8>,
        speed_limit: Option<f32>,
        force_limit: Option<f32>,
    ) -> PyResult<Self> {
        let address: Address =
            address.parse().map_err(|text: String| error::exception(py, "InvalidError", &text, None))?;
        if address.is_gcl() {
            let text = "streaming requires the binary protocol: use an address such as tcp://192.168.1.20";
            return Err(error::exception(py, "UnsupportedError", text, None));
        }
        let config = Config { rate_hz, queue_len };
        if !config.is_valid() {
            let text = StartError::<io::Error>::Config.to_string();
            return Err(error::exception(py, "InvalidError", &text, None));
        }
        let calls = Arc::new(Calls::default());
        calls.handles_signals.store(true, SeqCst);
        let start = Instant::now();
        let started = detach(py, || {
            let wire = wsg_tool::open(&address).map_err(Error::Transport)?;
            let line = Line::new(wire, Arc::clone(&calls));
            let mut gripper = Gripper::<_, _>::with_config(line, Clock::Real(start), DRIVER);
            gripper.set_log_name(&address.to_string());
            gripper.connect()?;
            let limits = gripper.limits()?;
            let flags = gripper.system_state()?;
            let wanted = [(Quantity::Speed, speed_limit), (Quantity::Force, force_limit)];
            for (quantity, value) in wanted {
                // Before anything moves.
                if let Some(Err(refused)) = value.map(|value| limits.check(quantity, value, flags)) {
                    let _ = gripper.announce_disconnect();
                    return Err(Failed::Limits(refused));
                }
            }
            let homed = direction.and_then(HomingDirection::from_code).map(|it| gripper.home(it));
            if let Some(Err(failure)) = homed {
                calls.handles_signals.store(false, SeqCst);
                let _ = gripper.stop();
                return Err(failure.into());
            }
            // The worker must not wait for the interpreter.
            calls.handles_signals.store(false, SeqCst);
            let stream = SetPointStream::start(gripper, config).map_err(Failed::Start)?;
            // They were checked, so only the end of the stream rejects them, and the caller learns of it.
            let _ = speed_limit.map(|speed| stream.set_speed_limit(MmPerS(speed)));
            let _ = force_limit.map(|force| stream.set_force_limit(N(force)));
            // An interpolation needs two samples.
            while stream.latest().is_ok_and(|sample| sample.number == 0) {
                thread::sleep(Duration::from_millis(1));
            }
            Ok((stream, limits))
        });
        let (stream, limits) = started.map_err(|failure| match (calls.take_raised(), failure) {
            (Some(raised), _) => raised,
            (None, Failed::Limits(refused)) => {
                error::exception(py, "InvalidError", &refused.to_string(), None)
            }
            (None, Failed::Start(StartError::Config)) => {
                let text = StartError::<io::Error>::Config.to_string();
                error::exception(py, "InvalidError", &text, None)
            }
            (None, Failed::Start(StartError::Driver(failure))) => error::of_driver(py, &failure),
            (None, Failed::Start(StartError::System(failure))) => failure.into(),
        })?;
        let backend = stream.backend();
        let state = Mutex::new(State::Running(stream));
        let start_unix = Mutex::new(unix_now() - start.elapsed().as_secs_f64());
        let closing = Mutex::default();
        let inner =
            Arc::new(Inner { state, closing, start, start_unix, backend, limits, process: process() });
        let weak = Arc::downgrade(&inner);
        close_at_exit(weak);
        Ok(Self(inner))
    }

    /// Schedules a position in mm for a time of the system clock in s.
    fn schedule(&self, py: Python<'_>, position: f32, time: f64) -> PyResult<()> {
        let ahead = time - unix_now();
        let horizon = f64::from(HORIZON_MS) / 1e3;
        let text = if !ahead.is_finite() {
            format!("target_time is {time}; expected seconds of time.time()")
        } else if ahead.abs() > horizon {
            let side = if ahead > 0.0 { "ahead" } else { "in the past" };
            let distance = ahead.abs();
            let distance = if distance < 1e6 { format!("{distance:.0}") } else { format!("{distance:.1e}") };
            format!(
                "target_time is {distance} s {side}; expected seconds of time.time(), at most {horizon} s {side}"
            )
        } else {
            let now_ms = self.0.start.elapsed().as_secs_f64() * 1e3;
            // The driver's clock counts modulo 2^32 ms.
            let at = wsg_protocol::Instant::from_millis((now_ms + ahead * 1e3).round() as i64 as u32);
            return self.change(py, |stream| stream.schedule(Mm(position), at));
        };
        Err(error::exception(py, "InvalidError", &text, None))
    }

    fn set_target(&self, py: Python<'_>, position: f32) -> PyResult<()> {
        self.change(py, |stream| stream.set_target(Mm(position)))
    }

    fn set_speed_limit(&self, py: Python<'_>, speed: f32) -> PyResult<()> {
        self.change(py, |stream| stream.set_speed_limit(MmPerS(speed)))
    }

    fn set_force_limit(&self, py: Python<'_>, force: f32) -> PyResult<()> {
        self.change(py, |stream| stream.set_force_limit(N(force)))
    }

    /// Homes in a direction and waits for the end.
    fn home(&self, py: Python<'_>, direction: u8) -> PyResult<()> {
        let direction = homing(direction).map_err(|failure| error::of_driver(py, &failure))?;
        self.wait(py, |stream| stream.home(direction))
    }

    fn acknowledge(&self, py: Python<'_>) -> PyResult<()> {
        self.wait(py, Running::acknowledge)
    }

    /// Returns a reader of new samples.
    fn subscribe(&self, py: Python<'_>) -> PyResult<Samples> {
        let samples = Mutex::new(self.change(py, |stream| Ok(stream.samples()))?);
        Ok(Samples { samples, inner: Arc::clone(&self.0), is_closed: AtomicBool::new(false) })
    }

    /// Returns the latest sample. Fails after the end of the stream, because the sample is no longer current.
    fn latest(&self, py: Python<'_>) -> PyResult<Row> {
        let latest = match &*self.0.state(py)? {
            State::Running(stream) => stream.latest(),
            State::Ended(End { cause, .. }, ..) => Err(*cause),
        };
        let sample = latest.map_err(|cause| rejected(py, Rejected::Ended(cause)))?;
        Ok(row(&sample, self.0.clock()))
    }

    /// Returns the samples as rows of eight doubles, oldest first, with the values of `latest`; NaN without a set-point.
    fn history(&self, py: Python<'_>) -> PyResult<Vec<u8>> {
        let samples = match &*self.0.state(py)? {
            State::Running(stream) => stream.history(),
            State::Ended(_, history, _) => history.clone(),
        };
        let clock = self.0.clock();
        let rows = samples.iter().flat_map(|sample| {
            let (number, measured, received, position, speed, force, flags, set_point) = row(sample, clock);
            let set_point = set_point.unwrap_or(f64::NAN);
            [number.into(), measured, received, position, speed, force, flags.into(), set_point]
        });
        Ok(rows.flat_map(f64::to_ne_bytes).collect())
    }

    /// Returns the gaps, oldest first: time of the beginning and length in s.
    fn gaps(&self, py: Python<'_>) -> PyResult<Vec<(f64, f64)>> {
        let gaps = match &*self.0.state(py)? {
            State::Running(stream) => stream.gaps(),
            State::Ended(.., gaps) => gaps.clone(),
        };
        let clock = self.0.clock();
        Ok(gaps.iter().map(|gap| (clock.unix(gap.begun_at), f64::from(gap.length_ms) / 1e3)).collect())
    }

    /// Returns the limits of the gripper, in the order of the Python class `Limits`.
    fn limits(&self) -> Limits {
        limits_as_tuple(self.0.limits)
    }

    /// Returns the name of the back-end.
    fn backend(&self) -> &'static str {
        match self.0.backend {
            Backend::Script => "script",
            Backend::UmiScript => "umi-script",
            Backend::PrePosition => "pre-position",
        }
    }

    /// Returns the cause of the end, or None while the stream runs.
    fn ended(&self, py: Python<'_>) -> PyResult<Option<String>> {
        Ok(match &*self.0.state(py)? {
            State::Running(stream) => stream.ended().map(|end| end.cause.to_string()),
            State::Ended(end, ..) => Some(end.cause.to_string()),
        })
    }

    /// Sends Stop or FAST STOP, which ends the stream.
    fn stop_fingers(&self, py: Python<'_>, is_fast: bool) -> PyResult<()> {
        let handle = match &*self.0.state(py)? {
            State::Running(stream) => stream.stop_handle(),
            State::Ended(..) => return Ok(()),
        };
        detach(py, || if is_fast { handle.fast_stop() } else { handle.stop() })?;
        Ok(())
    }

    /// Stops the fingers and closes the connection. Returns whether the gripper confirmed the stop.
    fn close(&self, py: Python<'_>) -> bool {
        detach(py, || self.0.close())
    }
}

impl Stream {
    fn change<T>(&self, py: Python<'_>, change: impl FnOnce(&Running) -> Result<T, Rejected>) -> PyResult<T> {
        let changed = match &*self.0.state(py)? {
            State::Running(stream) => change(stream),
            State::Ended(End { cause, .. }, ..) => Err(Rejected::Ended(*cause)),
        };
        changed.map_err(|refusal| rejected(py, refusal))
    }

    /// Makes a request and waits for its outcome. If a signal handler raises an exception meanwhile, stops the fingers.
    fn wait(
        &self,
        py: Python<'_>,
        request: impl FnOnce(&Running) -> Result<Outcome<io::Error>, Rejected>,
    ) -> PyResult<()> {
        let mut outcome = self.change(py, request)?;
        loop {
            let received;
            (outcome, received) = detach(py, || {
                let received = outcome.recv_timeout(SIGNALS);
                (outcome, received)
            });
            match received {
                Ok(result) => return result.map_err(|failure| error::of_driver(py, &failure)),
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(raised) = py.check_signals() {
                        // The exception of the handler matters more than a failure to stop, which the stream reports.
                        let _ = self.stop_fingers(py, false);
                        return Err(raised);
                    }
                }
                // The stream has ended, or ends at this moment.
                Err(RecvTimeoutError::Disconnected) => {
                    self.latest(py)?;
                    return Err(rejected(py, Rejected::Ended(Cause::Requested)));
                }
            }
        }
    }
}

/// Waits for new samples.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Samples {
    samples: Mutex<stream::Samples>,
    inner: Arc<Inner>,
    is_closed: AtomicBool,
}

#[pymethods]
impl Samples {
    /// Waits for the next sample. Raises StopIteration after `close`, and the cause after the end of the stream.
    fn next(&self, py: Python<'_>) -> PyResult<Row> {
        let lock = || self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        while !self.is_closed.load(SeqCst) {
            // Fails in a forked child.
            drop(self.inner.state(py)?);
            match detach(py, || lock().next_within(SIGNALS)) {
                Ok(Some(sample)) => return Ok(row(&sample, self.inner.clock())),
                Ok(None) => py.check_signals()?,
                Err(cause) => return Err(rejected(py, Rejected::Ended(cause))),
            }
        }
        Err(PyStopIteration::new_err(()))
    }

    /// Ends the loop of the reader. The stream continues.
    fn close(&self) {
        self.is_closed.store(true, SeqCst);
    }
}

fn rejected(py: Python<'_>, rejected: Rejected) -> PyErr {
    let class = match rejected {
        Rejected::Ended(_) => "StreamEndedError",
        Rejected::Full { .. } | Rejected::Busy => "BusyError",
        Rejected::OutOfLimits(_) | Rejected::BeyondHorizon { .. } => "InvalidError",
    };
    error::exception(py, class, &rejected.to_string(), None)
}

/// A reading of the driver's clock, in ms, and the time of the system clock at its zero point, in s.
#[derive(Clone, Copy)]
struct Reading {
    start_unix: f64,
    now_ms: i64,
}

impl Reading {
    /// Converts a time of the driver, at most 24 days ago, to the system clock in s.
    fn unix(self, at: wsg_protocol::Instant) -> f64 {
        let age_ms = wsg_protocol::Instant::from_millis(self.now_ms as u32).signed_since(at);
        self.start_unix + (self.now_ms - i64::from(age_ms)) as f64 / 1e3
    }
}

/// Converts a sample, with its times on the system clock.
fn row(sample: &Sample, clock: Reading) -> Row {
    let Sample { number, measured_at, received_at, position, speed, force, flags, set_point } = *sample;
    let [position, speed, force] = [position, speed, force].map(shortest);
    let times = [measured_at, received_at].map(|at| clock.unix(at));
    (number, times[0], times[1], position, speed, force, flags.bits(), set_point.map(shortest))
}

impl Inner {
    /// Locks the state. A forked child has no worker and may not.
    fn state(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, State>> {
        if self.process != process() {
            return Err(error::not_connected(py, "another process started the stream"));
        }
        Ok(self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads the clock for the conversion of times. The result is the same at each call, so that the times of samples
    /// increase, unless the system clock was set.
    fn clock(&self) -> Reading {
        let mut start_unix = self.start_unix.lock().unwrap_or_else(PoisonError::into_inner);
        let before = self.start.elapsed().as_secs_f64();
        let unix = unix_now();
        let after = self.start.elapsed().as_secs_f64();
        let measured = unix - before;
        if after - before < SIMULTANEOUS && (measured - *start_unix).abs() > CLOCK_STEP {
            *start_unix = measured;
        }
        Reading { start_unix: *start_unix, now_ms: (after * 1e3) as i64 }
    }

    fn close(&self) -> bool {
        if self.process != process() {
            return false;
        }
        let _closing = self.closing.lock().unwrap_or_else(PoisonError::into_inner);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (history, gaps) = match &*state {
            State::Running(stream) => (stream.history(), stream.gaps()),
            State::Ended(end, ..) => return end.is_stop_confirmed,
        };
        // In case the worker panics.
        let end = End { cause: Cause::Requested, is_stop_confirmed: false };
        let running = mem::replace(&mut *state, State::Ended(end, history, gaps));
        // A thread that reads the state has the interpreter lock, so it must not wait for the gripper.
        drop(state);
        let State::Running(stream) = running else { return false };
        let (mut gripper, end) = stream.end();
        let _ = gripper.announce_disconnect();
        if let State::Ended(ended, ..) = &mut *self.state.lock().unwrap_or_else(PoisonError::into_inner) {
            *ended = end;
        }
        end.is_stop_confirmed
    }
}

impl Close for Inner {
    fn close_at_exit(&self) {
        self.close();
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.close();
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        if self.0.process != process() {
            // A forked child has no worker to join, and the parent still uses the connection.
            mem::forget(Arc::clone(&self.0));
        }
    }
}
