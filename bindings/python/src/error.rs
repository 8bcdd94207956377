//! Errors of the driver as Python exceptions, by cause.

use std::io;

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use wsg_protocol::driver::Error;

/// An error of a request.
pub(crate) type Failure = Error<io::Error>;

/// Returns the exception of this class in `wsg_gripper._errors`, with the status code of the gripper.
pub(crate) fn exception(py: Python<'_>, class: &str, message: &str, status: Option<u16>) -> PyErr {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    let build = || -> PyResult<PyErr> {
        let module = MODULE.get_or_try_init(py, || py.import("wsg_gripper._errors").map(Bound::unbind))?;
        let exception = module.bind(py).getattr(class)?.call1((message, status))?;
        Ok(PyErr::from_value(exception))
    };
    build().unwrap_or_else(|error| error)
}

/// Returns the exception for an error of the driver.
pub(crate) fn of_driver(py: Python<'_>, failure: &Failure) -> PyErr {
    let (class, status) = match failure {
        Error::NotConnected | Error::Transport(_) | Error::Closed => ("NotConnectedError", None),
        Error::MotionRunning | Error::FastStopRunning | Error::Superseded => ("BusyError", None),
        Error::Invalid(_) | Error::OutOfLimits(_) | Error::NoForceLimit | Error::TooLong { .. } => {
            ("InvalidError", None)
        }
        Error::NotInGcl => ("UnsupportedError", None),
        Error::Stopped(_) => ("StoppedError", None),
        Error::Refused(status) | Error::NotSetBack(status) => ("RefusedError", Some(status.code())),
        Error::Blocked => ("BlockedError", Some(wsg_protocol::Status::AxisBlocked.code())),
        Error::Aborted => ("AbortedError", Some(wsg_protocol::Status::CmdAborted.code())),
        Error::Failed(status) => ("MotionError", Some(status.code())),
        Error::Mismatch => ("MismatchError", None),
        Error::Unanswered => ("UnansweredError", None),
        _ => ("GripperError", None),
    };
    exception(py, class, &failure.to_string(), status)
}

/// Returns `NotConnectedError` with this message.
pub(crate) fn not_connected(py: Python<'_>, message: &str) -> PyErr {
    exception(py, "NotConnectedError", message, None)
}
