//! The Python package: builds the wheel, and tests it in a virtual environment without Rust on the path.

use std::{
    env,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};

use crate::{
    process,
    setup::{self, PYTHON_PACKAGE},
    workspace::Workspace,
};

/// The targets of wheels with their platform tags. zig links all of them, against an old glibc.
const WHEELS: [(&str, &str); 2] =
    [("aarch64-unknown-linux-gnu", "manylinux_2_28"), ("x86_64-unknown-linux-gnu", "manylinux_2_28")];
/// Limit for the size of a wheel, in bytes.
const MAX_WHEEL: u64 = 6_000_000;

/// Builds the wheels for users, checks their sizes, and tests the wheel of this machine.
pub(crate) fn wheels(workspace: &Workspace, environment: &Path) -> Result<()> {
    let mut pip = Command::new(environment.join("bin/python"));
    pip.args("-m pip --disable-pip-version-check install --quiet --require-hashes --requirement".split(' '));
    process::run(pip.arg(workspace.root.join(PYTHON_PACKAGE).join("wheels/requirements.txt")))?;
    let path = env::var_os("PATH").unwrap_or_default();
    let path = env::join_paths([environment.join("bin")].into_iter().chain(env::split_paths(&path)))?;
    for (target, tag) in WHEELS {
        if !setup::provide_target(workspace, target) {
            println!("NOT BUILT: {target}. rustup could not install it");
            continue;
        }
        let options = ["--zig", "--target", target, "--compatibility", tag];
        let wheel = build(workspace, environment, "wheel", target, &options, &path)?;
        let size = fs::metadata(&wheel)?.len();
        ensure!(size <= MAX_WHEEL, "{} has {size} bytes, more than {MAX_WHEEL}", wheel.display());
        let is_here = target.starts_with(env::consts::ARCH);
        if is_here {
            test_wheel(workspace, environment, &wheel)?;
        }
        println!("{}: {size} bytes, {}", wheel.display(), if is_here { "tested" } else { "not run" });
    }
    Ok(())
}

/// Builds the wheel, installs it in the environment and runs the tests of the package there.
pub(crate) fn test(workspace: &Workspace, environment: &Path) -> Result<()> {
    let path = env::var_os("PATH").unwrap_or_default();
    let wheel = build(workspace, environment, "dev", "dev", &["--compatibility", "linux"], &path)?;
    test_wheel(workspace, environment, &wheel)
}

/// Installs a wheel in the environment and runs the tests there.
fn test_wheel(workspace: &Workspace, environment: &Path, wheel: &Path) -> Result<()> {
    let bin = environment.join("bin");
    let mut pip = Command::new(bin.join("python"));
    pip.args(["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--force-reinstall"]);
    process::run(pip.arg(wheel))?;
    let path = env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")])?;
    let mut pytest = Command::new(bin.join("python"));
    pytest.env_clear().env("PATH", path).current_dir(workspace.root.join(PYTHON_PACKAGE));
    process::run(pytest.args(["-m", "pytest", "-q", "-p", "no:cacheprovider"]))
}

/// Builds a wheel and returns its path.
fn build(
    workspace: &Workspace,
    environment: &Path,
    profile: &str,
    folder: &str,
    options: &[&str],
    path: &OsStr,
) -> Result<PathBuf> {
    let out = workspace.target_dir.join("wheels").join(folder);
    let _ = fs::remove_dir_all(&out);
    let package = workspace.root.join(PYTHON_PACKAGE);
    // maturin adds files of this name to the wheel.
    fs::write(package.join("LICENCES.txt"), licences::text(&["--package wsg-python"])?)?;
    let mut maturin = Command::new(environment.join("bin/maturin"));
    maturin.current_dir(package).env("CARGO_TARGET_DIR", &workspace.target_dir).env("PATH", path);
    maturin.args(["build", "--locked", "--profile", profile, "--out"]).arg(&out).args(options);
    process::run(&mut maturin)?;
    let wheel = fs::read_dir(&out)?.next().context("maturin built no wheel")?;
    Ok(wheel?.path())
}
