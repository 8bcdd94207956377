//! What happened between PLC, bridge and gripper: for a person to follow and for a test to compare.

use std::fmt;
use std::io::Write;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, Direction, Event, FrameParser, Meaning, frame::MAX_MESSAGE_LEN};

/// One thing that happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// The PLC changed wires: before, after.
    Plc(Inputs, Inputs),
    /// The bridge changed wires: before, after.
    Bridge(Outputs, Outputs),
    /// A frame from bridge to gripper.
    ToGripper(Vec<u8>),
    /// A frame, or what became of one, from gripper to bridge.
    FromGripper(Vec<u8>),
    /// The fingers came to this opening width, in mm.
    Fingers(f32),
    /// Something that the tester did or found.
    Note(String),
}

/// A capture, shared by all who watch.
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
    /// A capture that begins now; each entry is also written to every sink, as a line.
    #[must_use]
    pub fn new(sinks: Vec<Box<dyn Write + Send>>) -> Self {
        let inner = Mutex::new(Inner { entries: Vec::new(), sinks });
        Self { shared: Arc::new(Shared { start: Instant::now(), inner, grown: Condvar::new() }) }
    }

    /// Since when this records.
    #[must_use]
    pub fn start(&self) -> Instant {
        self.shared.start
    }

    /// Records an entry.
    pub fn add(&self, entry: Entry) {
        let at = self.shared.start.elapsed();
        let mut inner = self.lock();
        let line = format!("{:>9.3}  {entry}\n", at.as_secs_f64());
        // A sink that fails (a closed pipe) does not end the capture.
        inner.sinks.retain_mut(|sink| sink.write_all(line.as_bytes()).and_then(|()| sink.flush()).is_ok());
        inner.entries.push((at, entry));
        drop(inner);
        self.shared.grown.notify_all();
    }

    /// Writes a line to every sink that is no entry.
    pub fn headline(&self, text: &str) {
        let mut inner = self.lock();
        inner.sinks.retain_mut(|sink| writeln!(sink, "{text}").and_then(|()| sink.flush()).is_ok());
    }

    /// Writes a last line to every sink; what happens later is recorded and not written.
    pub fn finish(&self, text: &str) {
        // One turn of the lock: nothing gets in between.
        for mut sink in self.lock().sinks.drain(..) {
            // A sink that fails (a closed pipe) has nothing more to lose.
            let _ = writeln!(sink, "{text}").and_then(|()| sink.flush());
        }
    }

    /// How many entries there are: a place to come back to.
    #[must_use]
    pub fn mark(&self) -> usize {
        self.lock().entries.len()
    }

    /// The entries from a place on.
    #[must_use]
    pub fn since(&self, mark: usize) -> Vec<Entry> {
        self.lock().entries.iter().skip(mark).map(|(_, entry)| entry.clone()).collect()
    }

    /// Waits until an entry from `mark` on is as `wanted`; whether one came in time.
    pub fn wait(&self, mark: usize, timeout: Duration, wanted: impl Fn(&Entry) -> bool) -> bool {
        self.wait_for_count(mark, 1, timeout, wanted)
    }

    /// Waits until so many entries from `mark` on are as `wanted`; whether they came in time.
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

/// What two runs are compared by: sequences without times.
///
/// They are five because only the time decides how they interleave: wires and line reach the harness on separate ways,
/// and the gripper spaces the reports of each value by itself (10 ms at least, the bridge's regular questions in
/// between).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequences {
    /// Edges on the PLC's wires.
    pub edges: Vec<(Inputs, Inputs)>,
    /// Changes of the bridge's wires.
    pub outputs: Vec<(Outputs, Outputs)>,
    /// Every frame on the gripper's line, both ways, but those of the two values below, and the questions whether the force limit
    /// still holds: they have a pace of their own.
    pub frames: Vec<String>,
    /// The system states that the gripper reported, each that differs from the one before.
    pub system_states: Vec<String>,
    /// The gripper states that the gripper reported, each that differs from the one before.
    pub gripper_states: Vec<String>,
}

/// Where the id stands in a frame.
const ID_AT: usize = 3;

impl Sequences {
    /// The edges of each of the bridge's wires, one wire after the other. Which of two wires changes first only the time
    /// decides where each follows a report of its own: REFERENCED one value, BUSY and READY the other.
    #[must_use]
    pub fn output_edges(&self) -> Vec<(Outputs, bool)> {
        let edges = |wire: Outputs| {
            let changes =
                self.outputs.iter().filter(move |(before, after)| (*before ^ *after).contains(wire));
            changes.map(move |(_, after)| (wire, after.contains(wire)))
        };
        Outputs::all().iter().flat_map(edges).collect()
    }

    /// The sequences of a capture from the entry `mark` on. What was reported before is known: repeating it is no
    /// news.
    #[must_use]
    pub fn of(entries: &[Entry], mark: usize) -> Self {
        let mut sequences = Self::default();
        let mut last_reports = [None, None];
        let mut last_frame = None;
        for (at, entry) in entries.iter().enumerate() {
            let counts = at >= mark;
            match entry {
                Entry::Plc(before, after) if counts => sequences.edges.push((*before, *after)),
                Entry::Bridge(before, after) if counts => sequences.outputs.push((*before, *after)),
                Entry::ToGripper(bytes) | Entry::FromGripper(bytes) => {
                    let [last_system_state, last_gripper_state] = &mut last_reports;
                    let (last, reports) = match frame_id(bytes).map(CommandId::from_code) {
                        Some(CommandId::GetSystemState) => (last_system_state, &mut sequences.system_states),
                        Some(CommandId::GetGripperState) => {
                            (last_gripper_state, &mut sequences.gripper_states)
                        }
                        id => {
                            let is_answer = matches!(entry, Entry::FromGripper(_));
                            // What is read back follows what was set.
                            let follows =
                                [(CommandId::SetForceLimit, true), (CommandId::GetForceLimit, false)];
                            let is_upkeep = id == Some(CommandId::GetForceLimit)
                                && last_frame != Some(follows[usize::from(is_answer)]);
                            if counts && !is_upkeep {
                                sequences.frames.push(entry.to_string());
                            }
                            if !is_upkeep {
                                last_frame = id.map(|id| (id, is_answer));
                            }
                            continue;
                        }
                    };
                    let is_report = matches!(entry, Entry::FromGripper(_));
                    if is_report && last.replace(bytes) != Some(bytes) && counts {
                        reports.push(entry.to_string());
                    }
                }
                _ => {}
            }
        }
        sequences
    }
}

/// The id of the frame in these bytes, if they look like one.
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

/// `GRIP ↑  RECIPE0 ↓`.
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

/// A frame's direction, its meaning and its bytes.
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
    fn frames_and_edges_read_as_a_person_would_write_them() {
        let pending = [0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x1A, 0x00, 0x67, 0xCB];
        let line = Entry::FromGripper(pending.to_vec()).to_string();
        assert!(line.starts_with("<- 21h Pre-position Fingers E_CMD_PENDING "), "{line}");
        assert!(line.ends_with(" AA AA AA 21 02 00 1A 00 67 CB"), "{line}");
        let edge = Entry::Plc(Inputs::RECIPE0, Inputs::GRIP).to_string();
        assert_eq!(edge, "PLC     GRIP ↑  RECIPE0 ↓");
    }

    #[test]
    fn sequences_leave_out_what_only_the_time_decides() {
        let state = |byte| Entry::FromGripper(vec![0xAA, 0xAA, 0xAA, 0x41, 3, 0, 0, 0, byte]);
        let question = Entry::ToGripper(vec![0xAA, 0xAA, 0xAA, 0x41, 3, 0, 3, 10, 0]);
        let stop = Entry::ToGripper(vec![0xAA, 0xAA, 0xAA, 0x22, 0, 0]);
        let entries = [question.clone(), state(0), question, state(0), stop.clone(), state(6), state(0)];
        let sequences = Sequences::of(&entries, 0);
        assert_eq!(sequences.frames, [stop.to_string()]);
        assert_eq!(sequences.gripper_states, [state(0), state(6), state(0)].map(|entry| entry.to_string()));
        let later = Sequences::of(&entries, 3);
        assert_eq!(later.gripper_states, [state(6), state(0)].map(|entry| entry.to_string()));
    }

    #[test]
    fn edges_of_a_wire_are_the_same_whichever_wire_changes_first() {
        let of = |outputs: &[(Outputs, Outputs)]| {
            let outputs = outputs.to_vec();
            Sequences { outputs, ..Sequences::default() }.output_edges()
        };
        let (busy, both) = (Outputs::BUSY, Outputs::BUSY | Outputs::REFERENCED);
        let at_once = of(&[(Outputs::empty(), busy), (busy, Outputs::REFERENCED)]);
        let one_by_one = of(&[(Outputs::empty(), busy), (busy, both), (both, Outputs::REFERENCED)]);
        assert_eq!(at_once, [(busy, true), (busy, false), (Outputs::REFERENCED, true)]);
        assert_eq!(at_once, one_by_one);
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
