//! The Python package: builds the wheel, and tests it in a virtual environment without Rust on the path.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

use crate::{process, workspace::Workspace};

/// The folder of the package in the workspace.
pub(crate) const FOLDER: &str = "bindings/python";

/// Builds the wheel, installs it in the environment and runs the tests of the package there.
pub(crate) fn test(workspace: &Workspace, environment: &Path) -> Result<()> {
    let wheel = build(workspace, environment, "dev", &["--compatibility", "linux"])?;
    let bin = environment.join("bin");
    let mut pip = Command::new(bin.join("python"));
    pip.args(["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--force-reinstall"]);
    process::run(pip.arg(wheel))?;
    let path = env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")])?;
    let mut pytest = Command::new(bin.join("python"));
    pytest.env_clear().env("PATH", path).current_dir(workspace.root.join(FOLDER));
    process::run(pytest.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]))
}

/// Builds a wheel and returns its path.
fn build(workspace: &Workspace, environment: &Path, profile: &str, options: &[&str]) -> Result<PathBuf> {
    let out = workspace.target_dir.join("wheels").join(profile);
    let _ = fs::remove_dir_all(&out);
    let mut maturin = Command::new(environment.join("bin/maturin"));
    maturin.current_dir(workspace.root.join(FOLDER)).env("CARGO_TARGET_DIR", &workspace.target_dir);
    maturin.args(["build", "--locked", "--profile", profile, "--out"]).arg(&out).args(options);
    process::run(&mut maturin)?;
    let wheel = fs::read_dir(&out)?.next().context("maturin built no wheel")?;
    Ok(wheel?.path())
}
