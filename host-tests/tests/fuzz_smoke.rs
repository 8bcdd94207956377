//! The fuzz bodies on stable Rust: over the committed seeds, and over the same 60 000 inputs every time.

use std::fs;
use std::path::Path;

use host_tests::fuzz_bodies::{self, Body};

fn smoke(name: &str) {
    Body::named(name).expect("a body of this name").run_generated(0..fuzz_bodies::SMOKE_INPUTS);
}

#[test]
fn frames_60_000_cases() {
    smoke("frames");
}

#[test]
fn typed_60_000_cases() {
    smoke("typed");
}

#[test]
fn session_60_000_cases() {
    smoke("session");
}

#[test]
fn controller_60_000_cases() {
    smoke("controller");
}

#[test]
fn bridge_60_000_cases() {
    smoke("bridge");
}

#[test]
fn bridge_can_60_000_cases() {
    smoke("bridge_can");
}

#[test]
fn bridge_profibus_60_000_cases() {
    smoke("bridge_profibus");
}

#[test]
fn can_60_000_cases() {
    smoke("can");
}

#[test]
fn gcl_60_000_cases() {
    smoke("gcl");
}

#[test]
fn modbus_60_000_cases() {
    smoke("modbus");
}

#[test]
fn storage_60_000_cases() {
    smoke("storage");
}

#[test]
fn profibus_60_000_cases() {
    smoke("profibus");
}

#[test]
fn profinet_60_000_cases() {
    smoke("profinet");
}

#[test]
fn every_committed_seed_passes() {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    for Body { name, run, .. } in fuzz_bodies::ALL {
        let folder =
            fs::read_dir(seeds.join(name)).unwrap_or_else(|error| panic!("seeds of {name}: {error}"));
        let files: Vec<_> = folder.map(|entry| entry.unwrap().path()).collect();
        assert!(!files.is_empty(), "{name} has seeds");
        for file in files {
            eprintln!("{}", file.display());
            run(&fs::read(&file).unwrap());
        }
    }
}

#[test]
fn every_body_has_a_fuzz_target() {
    let targets = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/fuzz_targets");
    for Body { name, .. } in fuzz_bodies::ALL {
        let target = fs::read_to_string(targets.join(format!("{name}.rs"))).expect("its target");
        assert!(target.contains(&format!("fuzz_bodies::{name}(")), "{name}");
    }
}
