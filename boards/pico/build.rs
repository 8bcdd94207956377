//! Passes the board's memory layout to the linker. Host builds do not need it.

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
    // Fails the link of an image that does not fit into a slot for updates.
    let slot = board.join("../update-slot.x");
    println!("cargo:rerun-if-changed={}", slot.display());
    println!("cargo:rustc-link-arg-bins=-T{}", slot.display());
}
