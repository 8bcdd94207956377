//! The class `Driver`: every request of the manual, for a caller that waits and for one that does not.
//!
//! The Python classes `Gripper` and `AsyncGripper` document the requests and type their results. Each method ends
//! with a parameter `reply`. Without it, the method waits for the result and returns it. With it, a worker thread makes
//! the request and delivers the result to the caller's event loop.

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use wsg_protocol::driver::blocking::{GclGripper, Gripper};
use wsg_protocol::driver::{Error, Finger, Grip, Mm, MmPerS, MotionResult, N, OnBlock, Pending, StopKind};
use wsg_protocol::{DecodeError, DeviceTag, HomingDirection, SoftLimits, Status, SystemLimits};
use wsg_tool::{Address, Wire};

use crate::core::{self, Core, Failed, each};
use crate::error::{self, Failure};
use crate::interpreter::detach;
use crate::line::{Calls, Clock, Line};
use crate::number::shortest;
use crate::queue::{Queue, Reply};
use crate::updates::Updates;

/// Longest reply of a script or of a finger, in bytes.
const MAX_REPLY: usize = 1_024;

/// A connection to a gripper.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Driver {
    core: Arc<Core>,
    is_gcl: bool,
    is_virtual: bool,
    /// The queues of motions and of all other requests, which pass them.
    motions: Queue,
    queries: Queue,
}

/// Connects a driver to a gripper at the other end of this wire.
///
/// `limits` are those that the user states, because GCL has no query for them. `name` is for its records.
pub(crate) fn connect(
    wire: Box<dyn Wire>,
    clock: Clock,
    is_gcl: bool,
    limits: Option<SystemLimits>,
    name: &str,
) -> Result<Driver, Failed> {
    let calls = Arc::new(Calls::default());
    let line = Line::new(wire, Arc::clone(&calls));
    let is_virtual = matches!(clock, Clock::Virtual(_));
    let mut driver = if is_gcl {
        let mut gripper = GclGripper::new(line, clock);
        if let Some(limits) = limits {
            gripper.assume_limits(limits);
        }
        core::Driver::Gcl(Box::new(gripper))
    } else {
        core::Driver::Binary(Box::new(Gripper::new(line, clock)))
    };
    each!(&mut driver, gripper => gripper.set_log_name(name));
    let core = Core::connect(driver, calls)?;
    Ok(Driver { core, is_gcl, is_virtual, motions: Queue::default(), queries: Queue::default() })
}

/// A motion that has begun.
#[derive(Clone, Copy)]
enum Begun {
    Grip(Pending<Grip>),
    Other(Pending<()>),
}

impl Begun {
    /// Waits for the result: whether a part is held, or `None` for other motions.
    fn wait(self, core: &Core, stops: usize, handles_signals: bool) -> Result<Option<bool>, Failed> {
        Ok(match self {
            Self::Grip(pending) => Some(core.wait(handles_signals, &pending, stops)? == Grip::Held),
            Self::Other(pending) => {
                core.wait(handles_signals, &pending, stops)?;
                None
            }
        })
    }
}

/// A motion in progress.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Motion {
    core: Arc<Core>,
    begun: Begun,
    /// Number of stops before it began.
    stops: usize,
}

#[pymethods]
impl Motion {
    /// Waits for the end of the motion. Returns whether a part is held; None for motions other than a grip.
    fn wait(&self, py: Python<'_>) -> PyResult<Option<bool>> {
        detach(py, || self.begun.wait(&self.core, self.stops, true))
            .map_err(|failed| failed.into_exception(py))
    }

    /// Returns None while the motion continues, otherwise its result in a tuple. Does not wait.
    fn poll(&self, py: Python<'_>) -> PyResult<Option<(Option<bool>,)>> {
        fn poll<T: MotionResult>(core: &Core, pending: &Pending<T>) -> Result<Option<T>, Failed> {
            core.with(true, |driver| each!(driver, gripper => gripper.poll(pending)))
        }
        let polled = detach(py, || match &self.begun {
            Begun::Grip(pending) => {
                poll(&self.core, pending).map(|done| done.map(|grip| (Some(grip == Grip::Held),)))
            }
            Begun::Other(pending) => poll(&self.core, pending).map(|done| done.map(|()| (None,))),
        });
        polled.map_err(|failed| failed.into_exception(py))
    }
}

pub(crate) fn homing(direction: u8) -> Result<HomingDirection, Failure> {
    HomingDirection::from_code(direction).ok_or(Error::Invalid(DecodeError::UndefinedValue))
}

const fn on_block(clamps: bool) -> OnBlock {
    if clamps { OnBlock::Clamp } else { OnBlock::Stop }
}

fn finger(number: u8) -> Result<Finger, Failure> {
    match number {
        1 => Ok(Finger::One),
        2 => Ok(Finger::Two),
        _ => Err(Error::Invalid(DecodeError::UndefinedValue)),
    }
}

/// The values of the Python class `Limits`, in its order.
pub(crate) type Limits = (f64, f64, f64, f64, f64, f64, f64, f64);

/// Returns the limits of speed, acceleration and force with the stroke.
pub(crate) fn limits_as_tuple(it: SystemLimits) -> Limits {
    (
        shortest(it.stroke),
        shortest(it.min_speed),
        shortest(it.max_speed),
        shortest(it.min_acceleration),
        shortest(it.max_acceleration),
        shortest(it.min_force),
        shortest(it.nominal_force),
        shortest(it.overdrive_force),
    )
}

/// Implements the methods of [`Driver`]: the given ones, motions, requests that return None, and requests that return a
/// value. Each expression is for a driver of either protocol.
macro_rules! driver_methods {
    (
        { $($given:tt)* }
        motions { $($motion:ident($($given_to:ident: $of:ty),*) => |$moved:ident| $begin:expr;)* }
        changes { $($change:ident($($setting:ident: $kind:ty),*) => |$changed:ident| $set:expr;)* }
        requests { $($request:ident($($parameter:ident: $type:ty),*) => |$gripper:ident| $ask:expr;)* }
    ) => {
        #[pymethods]
        impl Driver {
            $($given)*

            $(
                #[pyo3(signature = ($($given_to,)* waits, reply=None))]
                fn $motion(
                    &self,
                    py: Python<'_>,
                    $($given_to: $of,)*
                    waits: bool,
                    reply: Option<Reply>,
                ) -> PyResult<Py<PyAny>> {
                    self.begin(py, waits, reply, move |driver| each!(driver, $moved => $begin))
                }
            )*

            $(
                #[pyo3(signature = ($($setting,)* reply=None))]
                fn $change(&self, py: Python<'_>, $($setting: $kind,)* reply: Option<Reply>) -> PyResult<Py<PyAny>> {
                    self.request(py, reply, move |driver| each!(driver, $changed => $set).map(|()| NOTHING))
                }
            )*

            $(
                #[pyo3(signature = ($($parameter,)* reply=None))]
                fn $request(&self, py: Python<'_>, $($parameter: $type,)* reply: Option<Reply>) -> PyResult<Py<PyAny>> {
                    self.request(py, reply, move |driver| each!(driver, $gripper => $ask))
                }
            )*
        }
    };
}

driver_methods! {
    {
        /// Opens the line to an address and connects.
        #[new]
        fn new(py: Python<'_>, address: &str) -> PyResult<Self> {
            let address: Address =
                address.parse().map_err(|text: String| error::exception(py, "InvalidError", &text, None))?;
            detach(py, || {
                let wire = wsg_tool::open(&address).map_err(Error::Transport)?;
                connect(wire, Clock::Real(Instant::now()), address.is_gcl(), address.limits(), &address.to_string())
            })
            .map_err(|failed| match failed {
                Failed::Driver(failure) => error::not_connected(py, &format!("{address}: {failure}")),
                failed => failed.into_exception(py),
            })
        }

        /// Announces the end of the connection and closes it.
        fn close(&self, py: Python<'_>) {
            detach(py, || self.core.close());
        }

        fn is_open(&self) -> bool {
            self.core.is_open()
        }

        /// Returns whether the connection uses the text protocol (GCL).
        fn is_gcl(&self) -> bool {
            self.is_gcl
        }

        /// Begins automatic updates at an interval in s, and returns at once.
        fn subscribe(
            &self,
            py: Python<'_>,
            interval: Option<f64>,
            width: bool,
            speed: bool,
            force: bool,
        ) -> PyResult<Updates> {
            Updates::begin(py, &self.core, interval, [width, speed, force], self.is_virtual)
        }

        #[pyo3(signature = (is_fast, reply=None))]
        fn stop(&self, py: Python<'_>, is_fast: bool, reply: Option<Reply>) -> PyResult<Py<PyAny>> {
            let kind = if is_fast { StopKind::FastStop } else { StopKind::Stop };
            if reply.is_some() {
                // Sent before the requests in the queue.
                let _ = detach(py, || self.core.send_stop(kind));
            }
            let handles_signals = reply.is_none();
            self.make(py, reply, &self.queries, false, move |core| {
                core.stop(handles_signals, kind).map(|()| NOTHING)
            })
        }

        #[pyo3(signature = (reply=None))]
        fn acknowledge(&self, py: Python<'_>, reply: Option<Reply>) -> PyResult<Py<PyAny>> {
            let (handles_signals, stops) = (reply.is_none(), self.core.stops());
            self.make(py, reply, &self.queries, false, move |core| {
                core.acknowledge(handles_signals, stops).map(|()| NOTHING)
            })
        }

        #[pyo3(signature = (tolerance, reply=None))]
        fn part_width_tolerance(
            &self,
            py: Python<'_>,
            tolerance: Option<f32>,
            reply: Option<Reply>,
        ) -> PyResult<Py<PyAny>> {
            self.request(py, reply, move |driver| {
                only_gcl(driver, |gripper| match tolerance {
                    Some(tolerance) => gripper.set_part_width_tolerance(Mm(tolerance)),
                    None => gripper.part_width_tolerance(),
                })
            })
        }

        #[pyo3(signature = (travel, reply=None))]
        fn clamping_travel(
            &self,
            py: Python<'_>,
            travel: Option<f32>,
            reply: Option<Reply>,
        ) -> PyResult<Py<PyAny>> {
            self.request(py, reply, move |driver| {
                only_gcl(driver, |gripper| match travel {
                    Some(travel) => gripper.set_clamping_travel(Mm(travel)),
                    None => gripper.clamping_travel(),
                })
            })
        }
    }
    motions {
        home(direction: u8) => |gripper| gripper.begin_home(homing(direction)?).map(Begun::Other);
        move_to(width: f32, speed: f32, clamps: bool) => |gripper|
            gripper.begin_move_to(Mm(width), MmPerS(speed), on_block(clamps)).map(Begun::Other);
        move_by(offset: f32, speed: f32, clamps: bool) => |gripper|
            gripper.begin_move_by(Mm(offset), MmPerS(speed), on_block(clamps)).map(Begun::Other);
        grip(width: f32, speed: f32, force: Option<f32>) => |gripper| match force {
            Some(force) => gripper.begin_grip_with_force(Mm(width), MmPerS(speed), N(force)),
            None => gripper.begin_grip(Mm(width), MmPerS(speed)),
        }.map(Begun::Grip);
        release(width: f32, speed: f32) => |gripper|
            gripper.begin_release(Mm(width), MmPerS(speed)).map(Begun::Other);
    }
    changes {
        set_acceleration(acceleration: f32) => |gripper| gripper.set_acceleration(acceleration);
        set_force_limit(force: f32) => |gripper| gripper.set_force_limit(N(force));
        set_soft_limits(minus: f32, plus: f32) => |gripper| gripper.set_soft_limits(SoftLimits { minus, plus });
        clear_soft_limits() => |gripper| gripper.clear_soft_limits();
        set_overdrive(enabled: bool) => |gripper| gripper.set_overdrive(enabled);
        tare() => |gripper| gripper.tare();
        set_tag(tag: String) => |gripper| gripper.set_tag(&tag);
        set_finger_power(number: u8, enabled: bool) => |gripper|
            gripper.set_finger_power(finger(number)?, enabled);
        loop_back(data: Vec<u8>) => |gripper| gripper.loop_back(&data);
    }
    requests {
        acceleration() => |gripper| gripper.acceleration().map(shortest);
        force_limit() => |gripper| gripper.force_limit().map(|force| shortest(force.0));
        soft_limits() => |gripper|
            gripper.soft_limits().map(|limits| limits.map(|it| (shortest(it.minus), shortest(it.plus))));
        flags() => |gripper| gripper.system_state().map(|flags| flags.bits());
        state() => |gripper| gripper.gripper_state().map(|state| state.code());
        statistics(reset: bool) => |gripper|
            gripper.statistics(reset).map(|it| (it.total, it.no_part, it.part_lost));
        width() => |gripper| gripper.width().map(|width| shortest(width.0));
        speed() => |gripper| gripper.speed().map(|speed| shortest(speed.0));
        force() => |gripper| gripper.force().map(|force| shortest(force.0));
        temperature() => |gripper| gripper.temperature().map(|it| f64::from(it.0) / 10.0);
        limits() => |gripper| gripper.limits().map(limits_as_tuple);
        info() => |gripper| gripper.system_info().map(|it| {
            (it.device.to_string(), it.hardware_revision, it.firmware.to_string(), it.serial_number)
        });
        tag() => |gripper| match gripper.tag(&mut [0; DeviceTag::MAX_LEN]).map(str::to_owned) {
            Err(Error::Refused(Status::NotAvailable)) => Ok(String::new()),
            tag => tag,
        };
        finger_info(number: u8) => |gripper|
            gripper.finger_info(finger(number)?).map(|it| (it.finger.to_string(), it.data_len));
        finger_flags(number: u8) => |gripper| gripper.finger_flags(finger(number)?).map(|flags| flags.bits());
        finger_data(number: u8) => |gripper|
            gripper.finger_data(finger(number)?, &mut [0; MAX_REPLY]).map(|bytes| Bytes::from(bytes.to_vec()));
        raw(id: u8, payload: Vec<u8>) => |gripper|
            gripper.raw(id, &payload, &mut [0; MAX_REPLY]).map(|bytes| Bytes::from(bytes.to_vec()));
    }
}

impl Driver {
    /// Makes a request here, or in a queue if there is a `reply`.
    fn make<T>(
        &self,
        py: Python<'_>,
        reply: Option<Reply>,
        queue: &Queue,
        is_motion: bool,
        act: impl FnOnce(&Core) -> Result<T, Failed> + Send + 'static,
    ) -> PyResult<Py<PyAny>>
    where
        T: for<'py> IntoPyObject<'py> + Send,
    {
        match reply {
            Some(reply) => queue.push(py, reply, &self.core, is_motion, act)?.into_py_any(py),
            None => {
                let made = detach(py, || act(&self.core));
                made.map_err(|failed| failed.into_exception(py))?.into_py_any(py)
            }
        }
    }

    fn request<T>(
        &self,
        py: Python<'_>,
        reply: Option<Reply>,
        act: impl FnOnce(&mut core::Driver) -> Result<T, Failure> + Send + 'static,
    ) -> PyResult<Py<PyAny>>
    where
        T: for<'py> IntoPyObject<'py> + Send,
    {
        let handles_signals = reply.is_none();
        self.make(py, reply, &self.queries, false, move |core| core.with(handles_signals, act))
    }

    /// Begins a motion and returns it. With `waits`, which a `reply` implies, returns its result instead.
    fn begin(
        &self,
        py: Python<'_>,
        waits: bool,
        reply: Option<Reply>,
        act: impl FnOnce(&mut core::Driver) -> Result<Begun, Failure> + Send + 'static,
    ) -> PyResult<Py<PyAny>> {
        // A stop withdraws the requests before it, some of which may still wait for the driver.
        let stops = self.core.stops();
        if reply.is_some() {
            return self.make(py, reply, &self.motions, true, move |core| {
                core.begin(false, stops, act)?.wait(core, stops, false)
            });
        }
        let moved = detach(py, || {
            let begun = self.core.begin(true, stops, act)?;
            let result = if waits { Some(begun.wait(&self.core, stops, true)?) } else { None };
            Ok((begun, result))
        });
        let (begun, result) = moved.map_err(|failed: Failed| failed.into_exception(py))?;
        match result {
            Some(result) => result.into_py_any(py),
            None => Motion { core: Arc::clone(&self.core), begun, stops }.into_py_any(py),
        }
    }
}

/// The result of a request without a value. Python receives None for it, and an empty tuple for `()`.
const NOTHING: Option<bool> = None;

/// A reply of bytes, which Python receives as `bytes`.
type Bytes = Cow<'static, [u8]>;

/// Makes a request that only the text protocol has.
fn only_gcl(
    driver: &mut core::Driver,
    act: impl FnOnce(&mut GclGripper<Line, Clock>) -> Result<Mm, Failure>,
) -> Result<f64, Failure> {
    match driver {
        core::Driver::Gcl(gripper) => act(gripper).map(|value| shortest(value.0)),
        core::Driver::Binary(_) => Err(Error::Invalid(DecodeError::UndefinedValue)),
    }
}
