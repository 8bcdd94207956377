//! Examples of this package, for tests that run them.

use std::path::PathBuf;

/// Where cargo puts the example of this name, beside the test that asks.
///
/// # Panics
/// When it is not built: `cargo test` builds the examples of a package with its tests, but not with one of them alone.
#[must_use]
pub fn path(name: &str) -> PathBuf {
    let test = std::env::current_exe();
    let path = test.ok().and_then(|test| Some(test.parent()?.parent()?.join("examples").join(name)));
    match path {
        Some(path) if path.exists() => path,
        path => panic!("{path:?} is not built: run the tests of the whole package"),
    }
}
