//! docs/telemetry.md has the settings and metrics as the program's tables have them.
#![cfg(feature = "telemetry")]

use std::process::Command;

#[test]
fn document_has_the_settings_and_metrics_of_the_program() {
    let output = Command::new(env!("CARGO_BIN_EXE_wsg")).args(["telemetry", "--reference"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    document::hold("docs/telemetry.md", "reference", &String::from_utf8(output.stdout).unwrap());
}
