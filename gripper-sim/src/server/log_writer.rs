//! Writes the log from a thread of its own. The gripper never waits for a disk, a terminal or a pipe that nobody reads.

use std::io::{BufWriter, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, channel, sync_channel};
use std::thread;
use std::time::Duration;

/// How many lines may wait to be written.
const MAX_WAITING: usize = 8_192;
/// How long the end waits for what is still to be written.
const PATIENCE: Duration = Duration::from_secs(5);

/// The gripper's end.
pub(super) struct LogWriter {
    /// `None` once nothing can be written any more.
    lines: Option<SyncSender<String>>,
    /// Lines that found no room since one did.
    lost: u64,
    /// Disconnected when the thread has ended.
    end: Receiver<()>,
}

impl LogWriter {
    pub(super) fn new(output: impl Write + Send + 'static) -> Self {
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

    /// Hands over a line with its end, without waiting.
    pub(super) fn write(&mut self, line: String) {
        let Some(lines) = &self.lines else { return };
        if self.lost > 0 {
            let told =
                lines.try_send(format!("{} lines are lost here: the log is taken too slowly\n", self.lost));
            if told.is_ok() {
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
        // Nobody sends: it is the end, or it takes too long.
        let (Ok(()) | Err(RecvTimeoutError::Disconnected | RecvTimeoutError::Timeout)) =
            self.end.recv_timeout(PATIENCE);
    }
}

/// Writes lines until there are no more to come; each is there at once unless the next one waits already.
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

/// A log that cannot be written is given up with one message; the gripper goes on.
fn give_up(error: &std::io::Error) {
    eprintln!("wsg-sim: the log ends here: {error}");
}
