//! Runs the fuzz bodies on stable Rust: over the committed seeds, and over 60 000 inputs that are the same in each run.

use std::fs;
use std::path::Path;

use host_tests::fuzz_bodies::{self, Body};

macro_rules! smoke {
    ($($test:ident: $name:literal,)*) => {
        $(#[test]
        fn $test() {
            Body::named($name).expect("a body with this name").run_generated(0..fuzz_bodies::SMOKE_INPUTS);
        })*
    };
}

smoke! {
    frames_60_000_cases: "frames",
    typed_60_000_cases: "typed",
    session_60_000_cases: "session",
    controller_60_000_cases: "controller",
    bridge_60_000_cases: "bridge",
    bridge_can_60_000_cases: "bridge_can",
    bridge_profibus_60_000_cases: "bridge_profibus",
    bridge_gateway_60_000_cases: "bridge_gateway",
    can_60_000_cases: "can",
    gcl_60_000_cases: "gcl",
    modbus_60_000_cases: "modbus",
    storage_60_000_cases: "storage",
    profibus_60_000_cases: "profibus",
    profinet_60_000_cases: "profinet",
    ethernetip_60_000_cases: "ethernetip",
}

#[test]
fn every_committed_seed_passes() {
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    for Body { name, run, .. } in fuzz_bodies::ALL {
        let folder =
            fs::read_dir(seeds.join(name)).unwrap_or_else(|error| panic!("seeds of {name}: {error}"));
        let files: Vec<_> = folder.map(|entry| entry.unwrap().path()).collect();
        assert!(!files.is_empty(), "{name} has no seeds");
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
        let target = fs::read_to_string(targets.join(format!("{name}.rs"))).expect("a target for the body");
        assert!(target.contains(&format!("fuzz_bodies::{name}(")), "{name}");
    }
}
