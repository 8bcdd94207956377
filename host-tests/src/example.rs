//! Paths of built examples and programs, and the processes of tests that run them.

use std::path::{Path, PathBuf};
use std::process::Child;

/// A process that ends on drop.
#[derive(Debug)]
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        // Fails only when the process has already ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Returns the path of an example of the calling test's package.
///
/// # Panics
/// Panics when it is not built; `cargo test` builds examples with all tests of a package, not with one alone.
#[must_use]
pub fn path(name: &str) -> PathBuf {
    built(&Path::new("examples").join(name))
}

/// Returns the path of a program in the calling test's target folder.
///
/// # Panics
/// Panics when it is not built. `cargo test` builds programs of other packages only for the whole workspace.
#[must_use]
pub fn program(name: &str) -> PathBuf {
    built(Path::new(name))
}

fn built(place: &Path) -> PathBuf {
    let test = std::env::current_exe();
    let path = test.ok().and_then(|test| Some(test.parent()?.parent()?.join(place)));
    match path {
        Some(path) if path.exists() => path,
        path => panic!("{path:?} is not built: run the tests of the whole workspace"),
    }
}
