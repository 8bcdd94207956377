//! Recording of events between PLC, bridge and gripper, readable by people and comparable by tests.

use std::fmt;
use std::io::Write;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, Direction, Event, FrameParser, Meaning, frame::MAX_MESSAGE_LEN};

/// A recorded event.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// The PLC changed wires: before, after.
    Plc(Inputs, Inputs),
    /// The bridge changed wires: before, after.
    Bridge(Outputs, Outputs),
    /// A frame from bridge to gripper.
    ToGripper(Vec<u8>),
    /// A frame, possibly damaged, from gripper to bridge.
    FromGripper(Vec<u8>),
    /// The fingers reached this opening width, in mm.
    Fingers(f32),
    /// An action or finding of the test.
    Note(String),
}

impl Entry {
    /// Returns the command of a frame from bridge to gripper.
    #[must_use]
    pub fn command(&self) -> Option<CommandId> {
        let Self::ToGripper(bytes) = self else { return None };
        frame_id(bytes).map(CommandId::from_code)
    }
}

/// A shared recording.
#[derive(Clone)]
pub struct Trace {
    shared: Arc<Shared>,
}

struct Shared {
    start: Instant,
    inner: Mutex<Inner>,
    grown: Condvar,
}

struct Inner {
    entries: Vec<(Duration, Entry)>,
    sinks: Vec<Box<dyn Write + Send>>,
}

impl fmt::Debug for Trace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Trace").field("entries", &self.lock().entries.len()).finish_non_exhaustive()
    }
}

impl Trace {
    /// Starts a recording. Each entry is also written as a line to every sink.
    #[must_use]
    pub fn new(sinks: Vec<Box<dyn Write + Send>>) -> Self {
        let inner = Mutex::new(Inner { entries: Vec::new(), sinks });
        Self { shared: Arc::new(Shared { start: Instant::now(), inner, grown: Condvar::new() }) }
    }

    /// Returns the start time.
    #[must_use]
    pub fn start(&self) -> Instant {
        self.shared.start
    }

    /// Records an entry.
    pub fn add(&self, entry: Entry) {
        let at = self.shared.start.elapsed();
        let mut inner = self.lock();
        let line = format!("{:>9.3}  {entry}\n", at.as_secs_f64());
        // A failing sink, such as a closed pipe, does not end the recording.
        inner.sinks.retain_mut(|sink| sink.write_all(line.as_bytes()).and_then(|()| sink.flush()).is_ok());
        inner.entries.push((at, entry));
        drop(inner);
        self.shared.grown.notify_all();
    }

    /// Writes a line to every sink without recording an entry.
    pub fn headline(&self, text: &str) {
        let mut inner = self.lock();
        inner.sinks.retain_mut(|sink| writeln!(sink, "{text}").and_then(|()| sink.flush()).is_ok());
    }

    /// Writes a last line to every sink. Later entries are recorded but not written.
    pub fn finish(&self, text: &str) {
        // Holds the lock throughout, so no entry intervenes.
        for mut sink in self.lock().sinks.drain(..) {
            // A failing sink, such as a closed pipe, is ignored.
            let _ = writeln!(sink, "{text}").and_then(|()| sink.flush());
        }
    }

    /// Returns the number of entries, for use as a mark.
    #[must_use]
    pub fn mark(&self) -> usize {
        self.lock().entries.len()
    }

    /// Returns the entries from `mark` on.
    #[must_use]
    pub fn since(&self, mark: usize) -> Vec<Entry> {
        self.lock().entries.iter().skip(mark).map(|(_, entry)| entry.clone()).collect()
    }

    /// Waits until an entry from `mark` on satisfies `wanted`. Returns whether one did in time.
    pub fn wait(&self, mark: usize, timeout: Duration, wanted: impl Fn(&Entry) -> bool) -> bool {
        self.wait_for_count(mark, 1, timeout, wanted)
    }

    /// Waits until `count` entries from `mark` on satisfy `wanted`. Returns whether they did in time.
    pub fn wait_for_count(
        &self,
        mark: usize,
        count: usize,
        timeout: Duration,
        wanted: impl Fn(&Entry) -> bool,
    ) -> bool {
        let seen = |inner: &Inner| {
            inner.entries.iter().skip(mark).filter(|(_, entry)| wanted(entry)).count() >= count
        };
        let (inner, _) = self
            .shared
            .grown
            .wait_timeout_while(self.lock(), timeout, |inner| !seen(inner))
            .unwrap_or_else(PoisonError::into_inner);
        seen(&inner)
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.shared.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Offset of the id in a frame.
const ID_AT: usize = 3;

/// Returns the id of a frame, if the bytes are long enough.
#[must_use]
pub fn frame_id(bytes: &[u8]) -> Option<u8> {
    bytes.get(ID_AT).copied()
}

impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plc(before, after) => {
                f.write_str("PLC     ")?;
                edges(f, before.bits(), after.bits(), |bit| {
                    name(Inputs::from_bits_retain(bit).iter_names().next())
                })
            }
            Self::Bridge(before, after) => {
                f.write_str("bridge  ")?;
                edges(f, before.bits(), after.bits(), |bit| {
                    name(Outputs::from_bits_retain(bit).iter_names().next())
                })
            }
            Self::ToGripper(bytes) => Described { bytes, direction: Direction::ToGripper }.fmt(f),
            Self::FromGripper(bytes) => Described { bytes, direction: Direction::FromGripper }.fmt(f),
            Self::Fingers(width) => write!(f, "fingers {width:.2} mm"),
            Self::Note(text) => write!(f, "{text}"),
        }
    }
}

fn name<T>(named: Option<(&'static str, T)>) -> &'static str {
    named.map_or("?", |(name, _)| name)
}

/// Writes edges as in `GRIP ↑  RECIPE0 ↓`.
fn edges(
    f: &mut fmt::Formatter<'_>,
    before: u8,
    after: u8,
    name: impl Fn(u8) -> &'static str,
) -> fmt::Result {
    let mut gap = "";
    for bit in (0..u8::BITS).map(|n| 1 << n).filter(|bit| (before ^ after) & bit != 0) {
        write!(f, "{gap}{} {}", name(bit), if after & bit != 0 { '↑' } else { '↓' })?;
        gap = "  ";
    }
    Ok(())
}

/// Displays a frame's direction, meaning and bytes.
struct Described<'a> {
    bytes: &'a [u8],
    direction: Direction,
}

impl fmt::Display for Described<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parser = FrameParser::<{ MAX_MESSAGE_LEN }>::new();
        let meaning = match parser.push_slice(self.bytes) {
            (taken, Some(Event::Frame(frame))) if taken == self.bytes.len() => {
                Meaning { direction: self.direction, frame }.to_string()
            }
            (_, Some(Event::BadChecksum { id, .. })) => format!("{id:02X}h with a wrong checksum"),
            _ => "no frame".to_owned(),
        };
        write!(f, "{} {meaning:<58}", self.direction)?;
        self.bytes.iter().try_for_each(|byte| write!(f, " {byte:02X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_edges_are_written_readably() {
        let pending = [0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x1A, 0x00, 0x67, 0xCB];
        let line = Entry::FromGripper(pending.to_vec()).to_string();
        assert!(line.starts_with("<- 21h Pre-position Fingers E_CMD_PENDING "), "{line}");
        assert!(line.ends_with(" AA AA AA 21 02 00 1A 00 67 CB"), "{line}");
        let edge = Entry::Plc(Inputs::RECIPE0, Inputs::GRIP).to_string();
        assert_eq!(edge, "PLC     GRIP ↑  RECIPE0 ↓");
    }

    #[test]
    fn wait_ends_at_its_bound_or_with_the_entry() {
        let trace = Trace::new(vec![]);
        assert!(!trace.wait(0, Duration::from_millis(1), |_| true));
        trace.add(Entry::Fingers(1.0));
        assert!(trace.wait(0, Duration::ZERO, |entry| matches!(entry, Entry::Fingers(_))));
        assert!(!trace.wait(1, Duration::ZERO, |_| true), "entries before the mark do not count");
    }
}
