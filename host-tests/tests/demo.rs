//! The demonstration on a computer without an emulator.
#![cfg(unix)]

use std::process::Command;

#[test]
fn demonstration_without_an_emulator_passes_and_says_so() {
    let output =
        Command::new(env!("CARGO_BIN_EXE_demo")).args(["--speed-up", "2"]).env("PATH", "").output().unwrap();
    let printed = host_tests::masters::printed(&output);
    assert!(output.status.success(), "{printed}");
    let lines: Vec<&str> = printed.lines().filter(|line| !line.is_empty()).collect();
    assert!(lines[0].contains("the firmware is not tested"), "{printed}");
    let last = "demo: 12 steps passed, 0 failed (the bridge's library, not the firmware)";
    assert_eq!(lines.last(), Some(&last), "{printed}");
}
