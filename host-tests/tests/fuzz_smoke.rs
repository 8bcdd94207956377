//! Runs the fuzz bodies on stable Rust: over the committed seeds, and over 60 000 inputs that are the same in each run.

use std::fs;
use std::path::Path;

use host_tests::fuzz_bodies::{self, Body};
use host_tests::operation::names::*;

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

/// Three earlier faults, each as its seed and as the script that a failure prints.
#[test]
#[rustfmt::skip]
fn printed_script_is_rust_that_plays_the_same_case() {
    let master_restarts = vec![
        Can(Heartbeat { of_plc: true, state: 5 }),
        Pass(1),
        Write(OutputImage { flags: CommandFlags::empty(), user: 0, width: 2000, speed: 5000, force_limit: 4000 }),
        Write(OutputImage { flags: CommandFlags::MOVE, user: 0, width: 2000, speed: 5000, force_limit: 4000 }),
        Pass(1),
        Can(Heartbeat { of_plc: true, state: 0 }),
        Pass(1),
        Can(Data(0, vec![1, 16])),
        Pass(1),
        Write(OutputImage { flags: CommandFlags::MOVE, user: 0, width: 2000, speed: 5000, force_limit: 4000 }),
        Pass(7),
    ];
    let unlocked_with_a_flag = vec![
        Profibus { telegram: Exchange { master: 2, outputs: vec![2, 0, 7, 208, 19, 136, 15, 160] }, silence: 40, fault: Intact },
        Pass(1),
        Profibus { telegram: ServiceRequest { master: 2, point: 61, data: vec![64, 1, 0, 0, 85, 85, 0] }, silence: 40, fault: Intact },
        Pass(1),
        StartSlave { master: 2, watchdog: 20, min_tsdr: 11 },
        Pass(1),
        Profibus { telegram: Exchange { master: 2, outputs: vec![2, 0, 7, 208, 19, 136, 15, 160] }, silence: 40, fault: Intact },
        Pass(33),
    ];
    let jog_ends_with_the_connection_that_began_it = vec![
        Behave(Behaviour { answers: true, deliveries: vec![Late(50)], flags: SystemFlags::REFERENCED, has_part: true, is_disturbed: false }),
        Pass(1),
        Gateway(Request { master: 0, pdu: vec![16, 0, 0, 0, 4, 8, 0, 0, 7, 208, 19, 136, 15, 160], fault: Intact }),
        Pass(4),
        Gateway(Request { master: 0, pdu: vec![16, 0, 0, 0, 4, 8, 64, 0, 7, 208, 19, 136, 15, 160], fault: Intact }),
        Pass(206),
        Gateway(Request { master: 1, pdu: vec![16, 0, 0, 0, 4, 8, 64, 0, 7, 208, 19, 136, 15, 160], fault: Intact }),
        Pass(1),
        Gateway(Reconnect(0)),
        Pass(7),
    ];
    let seeds = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds");
    for (body, seed, operations) in [
        ("bridge_can", "master_restarts", master_restarts),
        ("bridge_profibus", "unlocked_with_a_flag", unlocked_with_a_flag),
        ("bridge_gateway", "jog_ends_with_the_connection_that_began_it", jog_ends_with_the_connection_that_began_it),
    ] {
        let (choice, decoded) = fuzz_bodies::decode(body, &fs::read(seeds.join(body).join(seed)).unwrap());
        assert_eq!(decoded, operations, "{seed}");
        for line in script(&operations).lines() {
            assert!(include_str!("fuzz_smoke.rs").contains(line), "{line}");
        }
        fuzz_bodies::play(body, choice, &operations);
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
