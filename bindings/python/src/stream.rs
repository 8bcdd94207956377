//! Set-point streaming: the worker of `driver::stream`, with times of the system clock.

use std::mem;
use std::sync::atomic::Ordering::SeqCst;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime};

use pyo3::prelude::*;
use wsg_protocol::HomingDirection;
use wsg_protocol::driver::blocking::Gripper;
use wsg_protocol::driver::stream::{
    Backend, Cause, Config, End, Rejected, Sample, SetPointStream, StartError,
};
use wsg_protocol::driver::{Error, Mm, MmPerS, N};
use wsg_tool::Address;

use crate::core::{Close, close_at_exit};
use crate::error;
use crate::interpreter::{detach, process};
use crate::line::{Calls, Clock, Line};

type Running = SetPointStream<Line, Clock>;
/// Number, measured and received time in s, position in mm, speed in mm/s, force in N, flags, set-point in mm.
type Row = (u32, f64, f64, f32, f32, f32, u32, Option<f32>);

/// A stream of set-points.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Stream(Arc<Inner>);

struct Inner {
    state: Mutex<State>,
    /// The zero point of the driver's clock.
    start: Instant,
    backend: Backend,
    process: usize,
}

enum State {
    Running(Running),
    Ended(End, Sample, Vec<Sample>),
}

#[pymethods]
impl Stream {
    /// Connects, homes in a direction if one is given, and starts the worker.
    #[new]
    fn new(py: Python<'_>, address: &str, rate_hz: u16, direction: Option<u8>) -> PyResult<Self> {
        let address: Address =
            address.parse().map_err(|text: String| error::exception(py, "InvalidError", &text, None))?;
        if address.is_gcl() {
            let text = "streaming requires the binary protocol: use an address such as tcp://192.168.1.20";
            return Err(error::exception(py, "UnsupportedError", text, None));
        }
        let calls = Arc::new(Calls::default());
        calls.handles_signals.store(true, SeqCst);
        let start = Instant::now();
        let started = detach(py, || {
            let wire = wsg_tool::open(&address).map_err(Error::Transport)?;
            let mut gripper = Gripper::new(Line::new(wire, Arc::clone(&calls)), Clock::Real(start));
            gripper.connect()?;
            let homed = direction.and_then(HomingDirection::from_code).map(|it| gripper.home(it));
            if let Some(Err(failure)) = homed {
                calls.handles_signals.store(false, SeqCst);
                let _ = gripper.stop();
                return Err(failure.into());
            }
            // The worker must not wait for the interpreter.
            calls.handles_signals.store(false, SeqCst);
            SetPointStream::start(gripper, Config { rate_hz })
        });
        let stream = started.map_err(|failure| match (calls.take_raised(), failure) {
            (Some(raised), _) => raised,
            (None, StartError::Driver(failure)) => error::of_driver(py, &failure),
            (None, StartError::System(failure)) => failure.into(),
        })?;
        let backend = stream.backend();
        let state = Mutex::new(State::Running(stream));
        let inner = Arc::new(Inner { state, start, backend, process: process() });
        let weak = Arc::downgrade(&inner);
        close_at_exit(weak);
        Ok(Self(inner))
    }

    /// Schedules a position in mm for a time of the system clock in s.
    fn schedule(&self, py: Python<'_>, position: f32, time: f64) -> PyResult<()> {
        let ahead = (time - unix_now()) * 1e3;
        if !ahead.is_finite() {
            return Err(error::exception(py, "InvalidError", "the time is not a finite number", None));
        }
        let now_ms = self.0.start.elapsed().as_secs_f64() * 1e3;
        // A time in the past counts as now. Clocks wrap, so a set-point is at most 2^31 ms ahead.
        let at = (now_ms + ahead.clamp(0.0, f64::from(i32::MAX))).round() as u64 as u32;
        self.change(py, |stream| stream.schedule(Mm(position), wsg_protocol::Instant::from_millis(at)))
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

    /// Returns the latest sample.
    fn latest(&self, py: Python<'_>) -> PyResult<Row> {
        let sample = match &*self.0.state(py)? {
            State::Running(stream) => stream.latest(),
            State::Ended(_, latest, _) => *latest,
        };
        Ok(self.0.row(&sample))
    }

    /// Returns the samples as rows of eight doubles, oldest first, with the values of `latest`; NaN without a set-point.
    fn history(&self, py: Python<'_>) -> PyResult<Vec<u8>> {
        let samples = match &*self.0.state(py)? {
            State::Running(stream) => stream.history(),
            State::Ended(.., history) => history.clone(),
        };
        let rows = samples.iter().flat_map(|sample| {
            let (number, measured, received, position, speed, force, flags, set_point) = self.0.row(sample);
            let set_point = set_point.map_or(f64::NAN, f64::from);
            let floats = [position, speed, force].map(f64::from);
            let [position, speed, force] = floats;
            [number.into(), measured, received, position, speed, force, flags.into(), set_point]
        });
        Ok(rows.flat_map(f64::to_ne_bytes).collect())
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
    fn change(&self, py: Python<'_>, change: impl FnOnce(&Running) -> Result<(), Rejected>) -> PyResult<()> {
        let changed = match &*self.0.state(py)? {
            State::Running(stream) => change(stream),
            State::Ended(End { cause, .. }, ..) => Err(Rejected::Ended(*cause)),
        };
        changed.map_err(|rejected| {
            let class = match rejected {
                Rejected::Ended(_) => "StreamEndedError",
                Rejected::Full => "BusyError",
                Rejected::Invalid => "InvalidError",
            };
            error::exception(py, class, &rejected.to_string(), None)
        })
    }
}

fn unix_now() -> f64 {
    SystemTime::UNIX_EPOCH.elapsed().map_or(0.0, |elapsed| elapsed.as_secs_f64())
}

impl Inner {
    /// Locks the state. A forked child has no worker and may not.
    fn state(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, State>> {
        if self.process != process() {
            return Err(error::not_connected(py, "another process started the stream"));
        }
        Ok(self.state.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Converts a sample, with its times on the system clock.
    fn row(&self, sample: &Sample) -> Row {
        let Sample { number, measured_at, received_at, position, speed, force, flags, set_point } = *sample;
        let (now, now_ms) = (unix_now(), self.start.elapsed().as_secs_f64() * 1e3);
        // The driver's clock counts modulo 2^32 ms.
        let unix = |at: wsg_protocol::Instant| {
            let age = (now_ms as u64 as u32).wrapping_sub(at.as_millis()) as i32;
            now - (f64::from(age) + now_ms.fract()) / 1e3
        };
        (number, unix(measured_at), unix(received_at), position, speed, force, flags.bits(), set_point)
    }

    fn close(&self) -> bool {
        if self.process != process() {
            return false;
        }
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let (latest, history) = match &*state {
            State::Running(stream) => (stream.latest(), stream.history()),
            State::Ended(end, ..) => return end.is_stop_confirmed,
        };
        // In case the worker panics.
        let end = End { cause: Cause::Requested, is_stop_confirmed: false };
        let running = mem::replace(&mut *state, State::Ended(end, latest, history));
        let State::Running(stream) = running else { return false };
        let (mut gripper, end) = stream.end();
        let _ = gripper.announce_disconnect();
        if let State::Ended(ended, ..) = &mut *state {
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
