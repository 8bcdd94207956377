//! Disturbs the tests as a busy machine does: threads that compute, and pauses of random processes of the tests.

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

/// Share of the processes that pause at the same time.
const SHARE: f64 = 0.4;

/// Runs `work` while threads compute and processes that this one started pause, at random times that follow from the seed.
/// Without a seed, nothing disturbs it.
pub(crate) fn during<T>(seed: Option<u64>, work: impl FnOnce() -> Result<T>) -> Result<T> {
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
        let pauses = scope.spawn(|| pause_until(&is_over, seed));
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
fn pause_until(is_over: &AtomicBool, seed: u64) -> usize {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut pauses = 0;
    let mut paused: Vec<u32> = vec![];
    while !is_over.load(Ordering::Relaxed) {
        thread::sleep(Duration::from_millis(random.u64(BETWEEN_MS)));
        let mut chosen = started();
        chosen.retain(|process| random.f64() < SHARE && !paused.contains(process));
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

/// Returns the processes that this one started, directly or through others.
fn started() -> Vec<u32> {
    let mut children: HashMap<u32, Vec<u32>> = HashMap::new();
    for entry in fs::read_dir("/proc").into_iter().flatten().flatten() {
        if let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse().ok())
            && let Ok(stat) = fs::read_to_string(entry.path().join("stat"))
            && let Some(parent) = parent(&stat)
        {
            children.entry(parent).or_default().push(pid);
        }
    }
    let mut found = Vec::new();
    let mut unvisited = vec![process::id()];
    while let Some(pid) = unvisited.pop() {
        let of_it = children.remove(&pid).unwrap_or_default();
        found.extend(&of_it);
        unvisited.extend(of_it);
    }
    found
}

/// Returns the parent in a line of /proc/PID/stat. The program's name, in parentheses, may itself contain any character.
fn parent(stat: &str) -> Option<u32> {
    let (_, after_name) = stat.rsplit_once(") ")?;
    after_name.split(' ').nth(1)?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parent_is_found_beside_any_name() {
        assert_eq!(parent("12 (a) S 7) S 34 12"), Some(34));
        assert_eq!(parent("12"), None);
    }

    /// The processes of the tests pause and continue, so that work with them ends.
    #[test]
    #[cfg(target_os = "linux")]
    fn work_ends_beside_pauses() {
        let work = || {
            let mut program = Command::new("sh").args(["-c", "sleep 1; echo"]).spawn()?;
            ensure!(started().contains(&program.id()), "{}", program.id());
            Ok(program.wait()?.success())
        };
        assert!(during(Some(1), work).unwrap());
    }

    /// Otherwise this test does not end.
    #[test]
    #[cfg(target_os = "linux")]
    fn work_that_panics_ends_the_disturbance() {
        let work = || -> Result<()> { panic!("on purpose") };
        assert!(std::panic::catch_unwind(|| during(Some(1), work)).is_err());
    }
}
