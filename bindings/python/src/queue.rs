//! Requests that a worker thread makes for an event loop.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};
use std::thread;

use pyo3::IntoPyObjectExt;
use pyo3::prelude::*;
use wsg_protocol::driver::StopKind;

use crate::core::{Core, Failed};
use crate::error;
use crate::interpreter::{detach, try_attach};

/// Receives the result of a request: a callable that takes a value and an exception, called on any thread.
pub(crate) type Reply = Py<PyAny>;

type Job = Box<dyn FnOnce() + Send>;

/// Requests in order. Their thread starts with the first one and ends with the queue.
#[derive(Default)]
pub(crate) struct Queue(Mutex<Option<mpsc::Sender<Job>>>);

/// How far a request is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stage {
    Queued,
    Running,
    Done,
    Cancelled,
}

/// A request in a queue.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Ticket {
    stage: Arc<Mutex<Stage>>,
    core: Arc<Core>,
    is_motion: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymethods]
impl Ticket {
    /// Withdraws the request. A motion that has begun is stopped, any other request completes without a reply.
    fn cancel(&self, py: Python<'_>) {
        detach(py, || {
            let mut stage = lock(&self.stage);
            if *stage == Stage::Running && self.is_motion {
                let _ = self.core.send_stop(StopKind::Stop);
            }
            if *stage != Stage::Done {
                *stage = Stage::Cancelled;
            }
        });
    }
}

impl Queue {
    /// Queues a request, and passes its result to `reply`.
    pub(crate) fn push<T>(
        &self,
        py: Python<'_>,
        reply: Reply,
        core: &Arc<Core>,
        is_motion: bool,
        act: impl FnOnce(&Core) -> Result<T, Failed> + Send + 'static,
    ) -> PyResult<Ticket>
    where
        T: for<'py> IntoPyObject<'py> + Send,
    {
        if !core.is_open() {
            return Err(error::not_connected(py, "the connection is closed"));
        }
        let stage = Arc::new(Mutex::new(Stage::Queued));
        let ticket = Ticket { stage: Arc::clone(&stage), core: Arc::clone(core), is_motion };
        let core = Arc::clone(core);
        let job: Job = Box::new(move || {
            {
                let mut stage = lock(&stage);
                if *stage == Stage::Cancelled {
                    return;
                }
                *stage = Stage::Running;
            }
            let result = act(&core);
            let mut stage = lock(&stage);
            if *stage == Stage::Cancelled {
                drop(stage);
                if is_motion {
                    let _ = core.confirm_stop(false, StopKind::Stop);
                }
                return;
            }
            *stage = Stage::Done;
            drop(stage);
            // There is no one to reply to once the interpreter has ended.
            try_attach(|py| deliver(py, &reply, result));
        });
        self.send(job)?;
        Ok(ticket)
    }

    fn send(&self, job: Job) -> PyResult<()> {
        let mut sender = lock(&self.0);
        let sender = match &mut *sender {
            Some(sender) => sender,
            none => {
                let (sender, jobs) = mpsc::channel::<Job>();
                thread::Builder::new()
                    .name("wsg requests".to_owned())
                    .spawn(move || jobs.into_iter().for_each(|job| job()))?;
                none.insert(sender)
            }
        };
        // The thread ends only with the sender.
        let _ = sender.send(job);
        Ok(())
    }
}

fn deliver<T: for<'py> IntoPyObject<'py>>(py: Python<'_>, reply: &Reply, result: Result<T, Failed>) {
    let value = match result {
        Ok(value) => value.into_bound_py_any(py),
        Err(failed) => Err(failed.into_exception(py)),
    };
    let delivered = match value {
        Ok(value) => reply.call1(py, (value, py.None())),
        Err(error) => reply.call1(py, (py.None(), error)),
    };
    if let Err(error) = delivered {
        error.write_unraisable(py, None);
    }
}
