//! Examples of this package and programs of the workspace, for tests that run them.

use std::path::{Path, PathBuf};

/// Where cargo puts the example of this name, beside the test that asks.
///
/// # Panics
/// When it is not built: `cargo test` builds the examples of a package with its tests, but not with one of them alone.
#[must_use]
pub fn path(name: &str) -> PathBuf {
    built(&Path::new("examples").join(name))
}

/// Where cargo puts the program of this name, above the test that asks.
///
/// # Panics
/// When it is not built: `cargo test` builds the programs of another package only with the whole workspace.
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
