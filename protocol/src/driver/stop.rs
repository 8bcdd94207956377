//! Stop and FAST STOP from any thread (feature `std`). See [`gate`](super::gate) for the guarantees between handle and
//! driver.

use super::journal::Journal;
use super::link::Protocol;
use super::{MAX_STOP_LEN, StopKind, StopRequest};
#[cfg(feature = "embedded-io-async")]
use core::task::Context;
use core::task::{Poll, Waker};
use core::time::Duration;
use std::boxed::Box;
use std::io::{self, ErrorKind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Instant;

/// Time-out for sending the rest of a partially accepted stop message.
const REST_TIMEOUT: Duration = Duration::from_millis(100);

/// Stops the gripper of a driver from any thread, even while the driver waits in a call.
///
/// Created by the method `stop_handle` of a gripper. The handle writes directly to the line, so the bytes are in the
/// socket when its method returns, regardless of the driver's thread. The driver wakes up, withdraws unsent requests,
/// waits for the gripper to confirm the stop, and returns [`Error::Stopped`](super::Error::Stopped) from the current
/// call, or from the next call if none is active. Either way the program is notified before it can move the fingers
/// again.
///
/// Do not use it in a signal handler, because it locks a mutex. A thread that waits for signals, such as that of the
/// crate `signal-hook`, may use it.
///
/// The handle is detached by `into_io`, by `replace_io`, and by dropping the gripper.
///
/// ```no_run
/// use wsg_protocol::HomingDirection;
/// use wsg_protocol::driver::{Error, Mm, MmPerS, OnBlock, StopKind, host};
///
/// let mut gripper = host::connect("192.168.1.20:1000")?;
/// gripper.home(HomingDirection::Positive)?;
/// let handle = gripper.stop_handle().map_err(Error::Transport)?;
/// let button = std::thread::spawn(move || handle.stop());
/// let moved = gripper.move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop);
/// assert!(matches!(moved, Err(Error::Stopped(StopKind::Stop))));
/// button.join().unwrap().map_err(Error::Transport)?;
/// # Ok::<(), Error<std::io::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct StopHandle {
    shared: Weak<Shared>,
}

impl StopHandle {
    /// Stops the fingers. A held part is released (command set, 3.2.3).
    ///
    /// # Errors
    /// - `NotConnected`: the driver no longer exists or uses another transport. Nothing is sent.
    /// - `WouldBlock`: the line accepts no bytes because the gripper does not read. The driver sends the stop as soon
    ///   as possible, within its current call or the next one.
    /// - Other errors of the transport. The driver retries in its current call or the next one.
    pub fn stop(&self) -> io::Result<()> {
        self.request(StopKind::Stop)
    }

    /// Stops the fingers as fast as possible and locks them until `acknowledge` (command set, 3.2.4).
    ///
    /// # Errors
    /// Returns the same errors as [`stop`](Self::stop).
    pub fn fast_stop(&self) -> io::Result<()> {
        self.request(StopKind::FastStop)
    }

    fn request(&self, kind: StopKind) -> io::Result<()> {
        self.shared.upgrade().ok_or(ErrorKind::NotConnected)?.request(kind)
    }

    /// Returns how many stops the handles have requested, modulo 2³².
    pub(super) fn count(&self) -> u32 {
        self.shared.upgrade().map_or(0, |shared| shared.lock().count)
    }
}

type Write = dyn Fn(&[u8]) -> io::Result<usize> + Send + Sync;

/// A second write path to the line of a transport, for a [`StopHandle`].
pub struct StopLine {
    write: Box<Write>,
    wake: Box<dyn Fn() + Send + Sync>,
}

impl StopLine {
    /// Creates a line. `write` writes a message or its beginning without waiting, and returns `WouldBlock` if the line
    /// accepts no bytes. `wake` ends the transport's current or next [`wait`](super::blocking::Transport::wait); the
    /// async driver does not need it.
    pub fn new(
        write: impl Fn(&[u8]) -> io::Result<usize> + Send + Sync + 'static,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Self {
        Self { write: Box::new(write), wake: Box::new(wake) }
    }
}

impl core::fmt::Debug for StopLine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("StopLine").finish_non_exhaustive()
    }
}

/// A transport whose gripper can be stopped from another thread.
pub trait Stoppable {
    /// Creates a second write path to the line.
    ///
    /// # Errors
    /// Returns an error if the operating system has no descriptor left.
    fn stop_line(&mut self) -> io::Result<StopLine>;
}

/// State shared by a driver and its handles.
#[derive(Debug)]
pub(super) struct Shared {
    line: StopLine,
    journal: Journal,
    /// The Stop and FAST STOP messages in the driver's protocol.
    messages: [([u8; MAX_STOP_LEN], usize); 2],
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// Whether the driver has partially sent a message.
    is_mid_message: bool,
    request: Option<StopRequest>,
    /// Number of requests so far.
    count: u32,
    /// The task of the async driver that waits for a request.
    task: Option<Waker>,
}

impl Shared {
    /// Creates the shared state for a driver of this protocol.
    pub(super) fn new<P: Protocol>(line: StopLine, is_mid_message: bool, journal: Journal) -> Self {
        let messages = [StopKind::Stop, StopKind::FastStop].map(|kind| {
            let mut message = [0; MAX_STOP_LEN];
            let len = P::stop_message(kind, &mut message);
            (message, len)
        });
        Self {
            line,
            journal,
            messages,
            state: Mutex::new(State { is_mid_message, request: None, count: 0, task: None }),
        }
    }

    pub(super) fn handle(self: &Arc<Self>) -> StopHandle {
        StopHandle { shared: Arc::downgrade(self) }
    }

    /// A poisoned lock is safe to use: no code under it can panic halfway through a change.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn request(&self, kind: StopKind) -> io::Result<()> {
        let mut state = self.lock();
        state.count = state.count.wrapping_add(1);
        let sent = if state.is_mid_message {
            Err(ErrorKind::WouldBlock.into())
        } else {
            self.send(kind, REST_TIMEOUT)
        };
        let is_sent = sent.is_ok();
        state.request = Some(match state.request {
            Some(earlier) if earlier.kind > kind => earlier,
            Some(earlier) if earlier.kind == kind => {
                StopRequest { kind, is_sent: earlier.is_sent || is_sent }
            }
            _ => StopRequest { kind, is_sent },
        });
        let task = state.task.take();
        drop(state);
        if let Some(task) = task {
            task.wake();
        }
        (self.line.wake)();
        if kind == StopKind::FastStop {
            self.journal.warn(format_args!("FAST STOP requested"));
        }
        sent
    }

    /// Sends the stop message now, or fails. `rest_timeout` limits each pause within it.
    fn send(&self, kind: StopKind, rest_timeout: Duration) -> io::Result<()> {
        let [stop, fast_stop] = &self.messages;
        let (message, len) = if kind == StopKind::Stop { stop } else { fast_stop };
        let mut rest = message.get(..*len).unwrap_or(&[]);
        let mut begun = None;
        while !rest.is_empty() {
            match (self.line.write)(rest) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => {
                    rest = rest.get(count..).unwrap_or(&[]);
                    begun = Some(Instant::now());
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // Nothing else may be sent before the rest of this message.
                Err(error)
                    if error.kind() == ErrorKind::WouldBlock
                        && begun.is_some_and(|begun| begun.elapsed() < rest_timeout) =>
                {
                    std::thread::yield_now();
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    pub(super) fn poll_write<E>(
        &self,
        len: usize,
        write: impl FnOnce() -> Poll<Result<usize, E>>,
    ) -> Poll<Option<Result<usize, E>>> {
        let mut state = self.lock();
        if state.request.is_some() {
            return Poll::Ready(None);
        }
        let written = write();
        if let Poll::Ready(result) = &written {
            // The driver abandons a message whose write fails.
            state.is_mid_message = result.as_ref().is_ok_and(|count| *count < len);
        }
        written.map(Some)
    }

    pub(super) fn take(&self) -> Option<StopRequest> {
        self.lock().request.take()
    }

    #[cfg(feature = "embedded-io-async")]
    pub(super) fn poll_request(&self, context: &Context<'_>) -> Poll<()> {
        let mut state = self.lock();
        if state.request.is_some() {
            return Poll::Ready(());
        }
        state.task = Some(context.waker().clone());
        Poll::Pending
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::binary::Binary;
    use std::vec::Vec;

    /// Longer than a test takes.
    const FOREVER: Duration = Duration::from_secs(60);

    /// Sends a Stop over a line with these results, then `WouldBlock` for ever. Returns the result and the bytes that
    /// the line has accepted.
    fn stop(results: Vec<io::Result<usize>>, rest_timeout: Duration) -> (Result<(), ErrorKind>, Vec<u8>) {
        let state = Arc::new(Mutex::new((results, Vec::new())));
        let line = Arc::clone(&state);
        let write = move |bytes: &[u8]| {
            let mut line = line.lock().unwrap();
            let result = if line.0.is_empty() { Err(ErrorKind::WouldBlock.into()) } else { line.0.remove(0) };
            if let Ok(count) = result {
                line.1.extend(&bytes[..count]);
            }
            result
        };
        let shared = Shared::new::<Binary>(StopLine::new(write, || {}), false, Journal::NEW);
        let stopped = shared.send(StopKind::Stop, rest_timeout);
        let bytes = state.lock().unwrap().1.clone();
        (stopped.map_err(|error| error.kind()), bytes)
    }

    #[test]
    fn message_is_written_whole_over_interruptions_and_pauses() {
        let fail = |kind: ErrorKind| Err(kind.into());
        let (interrupted, full) = (ErrorKind::Interrupted, ErrorKind::WouldBlock);
        let (stopped, whole) = stop(std::vec![Ok(8)], FOREVER);
        assert_eq!((stopped, whole.len()), (Ok(()), 8));
        for results in [
            std::vec![fail(interrupted), Ok(8)],
            std::vec![Ok(3), fail(full), fail(interrupted), Ok(4), fail(full), Ok(1)],
        ] {
            assert_eq!(stop(results, FOREVER), (Ok(()), whole.clone()));
        }
    }

    #[test]
    fn full_line_is_reported_and_a_partial_message_gets_its_timeout() {
        assert_eq!(stop(std::vec![], FOREVER), (Err(ErrorKind::WouldBlock), std::vec![]));
        assert_eq!(stop(std::vec![Ok(0)], FOREVER).0, Err(ErrorKind::WriteZero));
        let (begun, rest_timeout) = (Instant::now(), Duration::from_millis(20));
        let (stopped, bytes) = stop(std::vec![Ok(3)], rest_timeout);
        assert_eq!((stopped, bytes.len()), (Err(ErrorKind::WouldBlock), 3));
        assert!(begun.elapsed() >= rest_timeout);
    }
}
