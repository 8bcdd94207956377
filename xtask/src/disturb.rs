//! Disturbs the tests as a busy machine does: threads that compute, and pauses of emulators, their harness and its peers.
//!
//! A bridge or a driver takes a gripper for lost that does not answer for 600 ms. With a pause of 500 ms and its wait for a
//! processor, a virtual gripper would be silent for longer. Therefore other tests do not pause, and the harness, in which the
//! grippers of all emulators run, pauses together with them and its peers.

use std::{
    collections::HashMap,
    fs, hint,
    ops::Range,
    process::{self, Command, Stdio},
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::Duration,
};

use anyhow::{Result, ensure};

/// Number of threads that compute.
const BUSY: usize = 4;

/// Shortest and longest time between two rounds of pauses, and longest pause, in milliseconds.
const BETWEEN_MS: Range<u64> = 100..300;
const PAUSE_MS: u64 = 500;

/// Start of the name of the program with the tests on emulated boards.
const HARNESS: &str = "end_to_end";

/// Share of the processes that pause at the same time.
const SHARE: f64 = 0.4;

/// Runs `work` while threads compute and processes of the harness pause, at random times that follow from the seed. Without a
/// seed, nothing disturbs it.
pub(crate) fn during<T>(seed: Option<u64>, work: impl FnOnce() -> Result<T>) -> Result<T> {
    during_pauses_of(HARNESS, seed, work)
}

fn during_pauses_of<T>(harness: &str, seed: Option<u64>, work: impl FnOnce() -> Result<T>) -> Result<T> {
    let Some(seed) = seed else { return work() };
    ensure!(cfg!(target_os = "linux"), "--disturbed finds the processes in /proc, which only Linux has");
    println!("test: beside {BUSY} busy threads, with pauses of up to {PAUSE_MS} ms; seed {seed}");
    let is_over = AtomicBool::new(false);
    // Also if the work panics: the scope waits for all threads.
    struct End<'a>(&'a AtomicBool);
    impl Drop for End<'_> {
        fn drop(&mut self) {
            self.0.store(true, Ordering::Relaxed);
        }
    }
    let (outcome, pauses) = thread::scope(|scope| {
        for _ in 0..BUSY {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    hint::spin_loop();
                }
            });
        }
        let pauses = scope.spawn(|| pause_until(&is_over, harness, seed));
        let end = End(&is_over);
        let outcome = work();
        drop(end);
        (outcome, pauses.join().expect("a panic is a defect, and was printed"))
    });
    println!("test: {pauses} pauses of processes");
    outcome
}

/// Pauses random processes until the end, and returns how often. Each runs during at least one round between two of its
/// pauses, and before and after it, because two pauses with a few milliseconds in between are one longer pause.
fn pause_until(is_over: &AtomicBool, harness: &str, seed: u64) -> usize {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut pauses = 0;
    let mut paused: Vec<u32> = vec![];
    while !is_over.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_millis(random.u64(BETWEEN_MS)));
        let running = running(harness);
        let mut chosen = running.clone();
        chosen.retain(|process| random.f64() < SHARE && !paused.contains(process));
        // The harness is found before the programs that it has started.
        if running.first().is_some_and(|harness| chosen.contains(harness)) {
            chosen = running;
        }
        signal("-STOP", &chosen);
        pauses += chosen.len();
        thread::sleep(Duration::from_millis(random.u64(..PAUSE_MS)));
        signal("-CONT", &chosen);
        paused = chosen;
    }
    pauses
}

/// Sends a signal to all these processes. Some may have ended, which is no error.
fn signal(name: &str, processes: &[u32]) {
    let mut kill = Command::new("sh");
    kill.args(["-c", "kill \"$@\"", "sh", name]).args(processes.iter().map(u32::to_string));
    // Without a shell, nothing pauses, and the count of pauses would be wrong.
    kill.stderr(Stdio::null()).status().expect("a shell runs");
}

/// Returns the processes of programs with this name that this process started, directly or through others, and the processes
/// that they started. A process that a test has stopped must stay so.
fn running(harness: &str) -> Vec<u32> {
    let mut children: HashMap<u32, Vec<(u32, Stat)>> = HashMap::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        if let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok())
            && let Ok(stat) = fs::read_to_string(entry.path().join("stat"))
            && let Some(stat) = Stat::read(&stat)
        {
            children.entry(stat.parent).or_default().push((pid, stat));
        }
    }
    let mut found = Vec::new();
    let mut unvisited = vec![(process::id(), false)];
    while let Some((pid, is_below)) = unvisited.pop() {
        for (child, stat) in children.remove(&pid).unwrap_or_default() {
            let is_of_it = is_below || stat.name.starts_with(harness);
            if is_of_it && !stat.is_stopped {
                found.push(child);
            }
            unvisited.push((child, is_of_it));
        }
    }
    found
}

/// A line of /proc/PID/stat.
#[derive(Debug, PartialEq, Eq)]
struct Stat {
    /// The first 15 characters of the program's name, which may itself contain any character.
    name: String,
    is_stopped: bool,
    parent: u32,
}

impl Stat {
    fn read(line: &str) -> Option<Self> {
        let (before, after_name) = line.rsplit_once(") ")?;
        let (_, name) = before.split_once(" (")?;
        let mut fields = after_name.split(' ');
        let is_stopped = fields.next()? == "T";
        Some(Self { name: name.to_owned(), is_stopped, parent: fields.next()?.parse().ok()? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_is_read_with_any_name() {
        let stat = |is_stopped| Some(Stat { name: "a) S 7".to_owned(), is_stopped, parent: 34 });
        assert_eq!(Stat::read("12 (a) S 7) S 34 12"), stat(false));
        assert_eq!(Stat::read("12 (a) S 7) T 34 12"), stat(true));
        assert_eq!(Stat::read("12"), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn only_programs_of_the_harness_are_found() {
        let mut program = Command::new("sh").args(["-c", "read line"]).stdin(Stdio::piped()).spawn().unwrap();
        let is_found = ["sh", HARNESS].map(|harness| running(harness).contains(&program.id()));
        drop(program.stdin.take());
        program.wait().unwrap();
        assert_eq!(is_found, [true, false]);
    }

    /// The processes of the tests pause and continue, so that work with them ends.
    #[test]
    #[cfg(target_os = "linux")]
    fn work_ends_beside_pauses() {
        let work = || {
            let mut program = Command::new("sh").args(["-c", "sleep 1; echo"]).spawn()?;
            Ok(program.wait()?.success())
        };
        assert!(during_pauses_of("sh", Some(1), work).unwrap());
    }

    /// Otherwise this test does not end.
    #[test]
    #[cfg(target_os = "linux")]
    fn work_that_panics_ends_the_disturbance() {
        let work = || -> Result<()> { panic!("on purpose") };
        assert!(std::panic::catch_unwind(|| during(Some(1), work)).is_err());
    }
}
