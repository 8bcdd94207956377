//! Checks the generated reference of settings and metrics in docs/tool.md.
#![cfg(feature = "telemetry")]

use std::process::Command;

#[test]
fn document_matches_the_reference_of_the_program() {
    let output = Command::new(env!("CARGO_BIN_EXE_wsg")).args(["telemetry", "--reference"]).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    document::hold("docs/tool.md", "reference", &String::from_utf8(output.stdout).unwrap());
}
