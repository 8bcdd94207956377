//! Tells the linker about the board's memory and the log's sections. Builds for the host need neither.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let on_microcontroller = env::var("CARGO_CFG_TARGET_OS").is_ok_and(|os| os == "none");
    let enabled = |feature: &str| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();

    if on_microcontroller && enabled("BOARD_B_L475E_IOT01A") {
        // cortex-m-rt's link.x includes memory.x by name.
        let workspace = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
        println!("cargo:rerun-if-changed={}", workspace.join("memory.x").display());
        println!("cargo:rustc-link-search={}", workspace.display());
    }
    if on_microcontroller && enabled("DEFMT") {
        println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
        // defmt's own default leaves out all but errors.
        println!("cargo:rerun-if-env-changed=DEFMT_LOG");
        if env::var_os("DEFMT_LOG").is_none() {
            println!("cargo:rustc-env=DEFMT_LOG=info");
        }
    }
}
