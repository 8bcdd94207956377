//! The build script of every board.

use std::env;
use std::path::PathBuf;

/// Passes the memory layout of the board and the sections of its log to the linker. Host builds need neither. Call it in `build.rs`.
pub fn pass_layout() {
    println!("cargo:rerun-if-changed=build.rs");
    let has = |feature| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    let board = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("Cargo names the package's folder"));
    for (feature, folder) in [("BOOT", "boot"), ("SLOT", "slot")] {
        if has(feature) {
            let memory = board.join(folder);
            println!("cargo:rerun-if-changed={}", memory.display());
            println!("cargo:rustc-link-search={}", memory.display());
            return;
        }
    }
    if !has("FIRMWARE") {
        return;
    }
    // link.x of cortex-m-rt includes the top-level memory.x, which includes the board's.
    println!("cargo:rerun-if-changed={}", board.join("board-memory.x").display());
    println!("cargo:rustc-link-search={}", board.display());
    // Fails the link of an image that does not fit into a slot for updates.
    let slot = board.join("../update-slot.x");
    println!("cargo:rerun-if-changed={}", slot.display());
    println!("cargo:rustc-link-arg-bins=-T{}", slot.display());
    if env::var_os("CARGO_FEATURE_DEFMT").is_some() {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    }
}
