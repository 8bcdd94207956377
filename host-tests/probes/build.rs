//! Adds the memory layout of the default board to the linker's search path, for the target only.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    if env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none") {
        // link.x of cortex-m-rt includes the memory.x at the top, which includes the board's.
        let board = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../boards/b-l475e-iot01a");
        println!("cargo:rerun-if-changed={}", board.join("board-memory.x").display());
        println!("cargo:rustc-link-search={}", board.display());
    }
}
