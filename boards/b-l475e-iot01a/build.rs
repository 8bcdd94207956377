//! Passes the board's memory layout and the log's sections to the linker. Host builds need neither.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_FIRMWARE").is_none() {
        return;
    }
    // link.x of cortex-m-rt includes the top-level memory.x, which includes the board's.
    let board = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    println!("cargo:rerun-if-changed={}", board.join("board-memory.x").display());
    println!("cargo:rustc-link-search={}", board.display());
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
