//! Runs `examples/test_gripper.py` with the pytest that `cargo xtask test` installs.

use std::path::Path;
use std::process::Command;

#[test]
#[ignore = "needs pytest: see the top of this file"]
fn example_passes_in_pytest() {
    let python = std::env::var_os("WSG_MODBUS_PYTHON")
        .expect("WSG_MODBUS_PYTHON must name a Python with pytest; run `cargo xtask test`");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/test_gripper.py");
    let output = Command::new(python)
        .args(["-m", "pytest", "-p", "no:cacheprovider"])
        .arg(example)
        .env("WSG_SIM", env!("CARGO_BIN_EXE_wsg-sim"))
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .output()
        .expect("that Python starts");
    let stdout = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && stdout.contains(" passed in "), "{stdout}");
}
