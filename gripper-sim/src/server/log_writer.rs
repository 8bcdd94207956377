//! Writes the log in a separate thread. The gripper never waits for a disk, a terminal or a blocked pipe.

use crate::control::Sink;
use std::io::{BufWriter, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel};
use std::thread;
use std::time::Duration;

/// Capacity of the queue in lines.
const MAX_WAITING: usize = 8_192;
/// How long the shutdown waits for the remaining lines.
const PATIENCE: Duration = Duration::from_secs(5);

/// The gripper's end of the queue.
pub(super) struct LogWriter {
    /// `None` once writing has failed.
    lines: Option<SyncSender<String>>,
    /// Lines dropped since the last one that was queued.
    lost: u64,
    /// Disconnected when the writer thread has ended.
    end: Receiver<()>,
}

impl LogWriter {
    fn new(output: impl Write + Send + 'static) -> Self {
        let (lines, waiting) = sync_channel(MAX_WAITING);
        let (running, end) = channel();
        let thread = thread::Builder::new().name("wsg-sim log".to_owned()).spawn(move || {
            write(BufWriter::new(output), &waiting);
            drop(running);
        });
        let lines = match thread {
            Ok(_) => Some(lines),
            Err(error) => {
                give_up(&error);
                None
            }
        };
        Self { lines, lost: 0, end }
    }

    /// Returns a writer for a log, which has written the rest once it is dropped.
    pub(super) fn sink(output: impl Write + Send + 'static) -> Sink {
        let mut writer = Self::new(output);
        Box::new(move |line| writer.write(line))
    }

    /// Queues a line with its line end, without waiting.
    fn write(&mut self, line: String) {
        let Some(lines) = &self.lines else { return };
        if self.lost > 0 {
            let sent =
                lines.try_send(format!("{} lines are lost here: the log is read too slowly\n", self.lost));
            if sent.is_ok() {
                self.lost = 0;
            }
        }
        match lines.try_send(line) {
            Ok(()) => {}
            Err(TrySendError::Full(_)) => self.lost += 1,
            Err(TrySendError::Disconnected(_)) => self.lines = None,
        }
    }
}

impl Drop for LogWriter {
    fn drop(&mut self) {
        self.lines = None;
        // Nothing is ever sent: the thread has ended, or the time-out has expired.
        let (Ok(()) | Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout)) =
            self.end.recv_timeout(PATIENCE);
    }
}

/// Writes lines until the queue is closed. Flushes after each line unless the next one is already queued.
fn write(mut output: impl Write, lines: &Receiver<String>) {
    let mut write_all = || -> std::io::Result<()> {
        while let Ok(line) = lines.recv() {
            output.write_all(line.as_bytes())?;
            while let Ok(line) = lines.try_recv() {
                output.write_all(line.as_bytes())?;
            }
            output.flush()?;
        }
        Ok(())
    };
    if let Err(error) = write_all() {
        give_up(&error);
    }
}

/// Stops writing after the first error and reports it once; the gripper continues.
fn give_up(error: &std::io::Error) {
    eprintln!("wsg-sim: the log stops here: {error}");
}
