//! The Python package: builds the wheel, installs it in a virtual environment, and tests it there without Rust on the path.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};

use crate::{
    platforms::MINGW,
    process,
    setup::{self, PYTHON_PACKAGE},
    workspace::Workspace,
};

/// zig links wheels for Linux, against an old glibc.
const LINUX: &[&str] = &["--zig", "--compatibility", "manylinux_2_28"];
/// The free-threaded Python, which cannot load wheels for the stable ABI.
const FREE_THREADED: &str = "python3.14t";
/// Folder, target and maturin's options of each wheel.
const WHEELS: [(&str, &str, &[&str]); 4] = [
    ("aarch64", "aarch64-unknown-linux-gnu", &[]),
    ("x86_64", "x86_64-unknown-linux-gnu", &[]),
    (FREE_THREADED, "x86_64-unknown-linux-gnu", &["--interpreter", FREE_THREADED]),
    ("windows", "x86_64-pc-windows-gnu", &[]),
];
/// Limit for the size of a wheel, in bytes.
const MAX_WHEEL: u64 = 6_000_000;

/// The folder of the plugin for LeRobot in the workspace.
const LEROBOT_PLUGIN: &str = "bindings/lerobot";
/// pip's arguments for a file of this workspace, in place of any other version.
const INSTALL: &str = "-m pip --disable-pip-version-check install --quiet --no-index --no-deps --no-build-isolation \
                       --force-reinstall";

/// Builds the wheels for users, checks their sizes, and tests the wheel of this machine and the source distribution.
pub(crate) fn wheels(workspace: &Workspace, environment: &Path) -> Result<()> {
    let mut pip = Command::new(environment.join("bin/python"));
    pip.args("-m pip --disable-pip-version-check install --quiet --require-hashes --requirement".split(' '));
    process::run(pip.arg(workspace.root.join(PYTHON_PACKAGE).join("wheels/requirements.txt")))?;
    // A release contains every wheel there.
    let _ = fs::remove_dir_all(workspace.target_dir.join("wheels"));
    for (folder, target, options) in WHEELS {
        let is_linux = target.contains("linux");
        let has_linker = is_linux || setup::lacking(&[MINGW]).is_empty();
        if !has_linker || !setup::provide_target(workspace, target) {
            println!("NOT BUILT: {target}. Its standard library or its linker could not be installed");
            continue;
        }
        let linker = if is_linux { LINUX } else { &[] };
        let arguments = [&["--target", target], linker, options].concat();
        let wheel = build(workspace, environment, folder, &arguments)?;
        let size = fs::metadata(&wheel)?.len();
        ensure!(size <= MAX_WHEEL, "{} has {size} bytes, more than {MAX_WHEEL}", wheel.display());
        let is_here = folder == env::consts::ARCH;
        if is_here {
            install_wheel(environment, &wheel)?;
            test(workspace, environment)?;
        }
        println!("{}: {size} bytes, {}", wheel.display(), if is_here { "tested" } else { "linked, not run" });
    }
    try_sdist(workspace, environment)
}

/// Packs the source distribution and returns its path. It has all packages of this workspace that the tests need, too.
pub(crate) fn sdist(workspace: &Workspace, environment: &Path) -> Result<PathBuf> {
    let out = emptied(workspace, "sdist")?;
    process::run(maturin(workspace, environment, &[])?.args(["sdist", "--out"]).arg(&out))?;
    only_file(&out)
}

/// Installs the package from the source distribution, and grips.
fn try_sdist(workspace: &Workspace, environment: &Path) -> Result<()> {
    let sdist = sdist(workspace, environment)?;
    let mut pip = in_environment(workspace, environment, "python")?;
    // The content does not depend on the profile, and the dependencies are compiled already.
    pip.args(INSTALL.split_whitespace()).arg(&sdist).env("MATURIN_PEP517_ARGS", "--profile dev");
    process::run(&mut pip)?;
    process::run(in_environment(workspace, environment, "python")?.arg("examples/first_grip.py"))?;
    println!("{}: {} bytes, installed", sdist.display(), fs::metadata(&sdist)?.len());
    Ok(())
}

/// The variable that names, for the tests of the workspace, a Python with the package.
pub(crate) const VARIABLE: &str = "WSG_PYTHON";

/// Installs the wheel for tests.
pub(crate) fn install(workspace: &Workspace, environment: &Path) -> Result<()> {
    install_wheel(environment, &pack(workspace, environment)?)
}

/// Packs a wheel with the library as the workspace's tests build it, and returns its path. maturin would spend a minute on
/// compiling the dependencies again, with fewer features.
pub(crate) fn pack(workspace: &Workspace, environment: &Path) -> Result<PathBuf> {
    process::run(
        &mut workspace.cargo(&format!("build -q --workspace --lib {}", Workspace::FEATURES_OF_TESTS)),
    )?;
    let out = emptied(workspace, "wheels/dev")?;
    let content = out.join("content");
    let mut maturin = maturin(workspace, environment, &[])?;
    process::run(maturin.args(["pep517", "write-dist-info", "--metadata-directory"]).arg(&content))?;
    let package = workspace.root.join(PYTHON_PACKAGE).join("python/wsg_gripper");
    process::run(Command::new("cp").arg("-r").arg(package).arg(&content))?;
    let library = format!("debug/{}wsg_gripper{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    let (library, native) = (workspace.target_dir.join(library), content.join("wsg_gripper/_native.abi3.so"));
    fs::copy(library, native).context("cannot copy the library")?;
    let mut pack = Command::new(environment.join("bin/python"));
    process::run(pack.args(["-m", "wheel", "pack", "--dest-dir"]).arg(&out).arg(&content))?;
    fs::remove_dir_all(&content)?;
    only_file(&out)
}

/// Installs a wheel in place of any other version.
pub(crate) fn install_wheel(environment: &Path, wheel: &Path) -> Result<()> {
    let mut pip = Command::new(environment.join("bin/python"));
    process::run(pip.args(INSTALL.split_whitespace()).arg(wheel))
}

/// Runs the tests of the installed package, and of the plugin for LeRobot from its source distribution.
pub(crate) fn test(workspace: &Workspace, environment: &Path) -> Result<()> {
    let bin = environment.join("bin");
    let path = env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")])?;
    let python = |folder: &str, words: &str| {
        let mut python = Command::new(bin.join("python"));
        python.env_clear().env("PATH", &path).env("PYTHONSAFEPATH", "1");
        python.env("HF_HOME", environment.join("huggingface")).current_dir(workspace.root.join(folder));
        python.args(words.split_whitespace());
        python
    };
    // In several processes, because the tests mostly wait for fingers.
    process::run(&mut python(PYTHON_PACKAGE, "-m pytest -q -p no:cacheprovider -n 8"))?;
    let out = emptied(workspace, "lerobot")?;
    let build = format!("from flit_core.buildapi import build_sdist; build_sdist({out:?})");
    process::run(python(LEROBOT_PLUGIN, "-c").arg(build))?;
    process::run(python(LEROBOT_PLUGIN, INSTALL).arg(only_file(&out)?))?;
    process::run(&mut python(LEROBOT_PLUGIN, "-m pytest -q -p no:cacheprovider -n 4 tests"))
}

/// Builds a wheel and returns its path.
fn build(workspace: &Workspace, environment: &Path, folder: &str, options: &[&str]) -> Result<PathBuf> {
    let out = emptied(workspace, &format!("wheels/{folder}"))?;
    let mut maturin = maturin(workspace, environment, options)?;
    maturin.args(["build", "--locked", "--profile", "wheel", "--out"]).arg(&out).args(options);
    provenance::remove_paths(&mut maturin, &workspace.target_dir, &[]);
    process::run(&mut maturin)?;
    only_file(&out)
}

/// Returns maturin's command for the package, and writes the licences, which it adds to the wheel.
fn maturin(workspace: &Workspace, environment: &Path, options: &[&str]) -> Result<Command> {
    let package = workspace.root.join(PYTHON_PACKAGE);
    let target = options.iter().skip_while(|option| **option != "--target").take(2);
    let selection = ["--package", "wsg-python"].iter().chain(target).copied().collect::<Vec<_>>().join(" ");
    fs::write(package.join("LICENCES.txt"), provenance::licences(&[&selection])?)?;
    in_environment(workspace, environment, "maturin")
}

/// Returns the command for a program of the environment, in the folder of the package.
fn in_environment(workspace: &Workspace, environment: &Path, program: &str) -> Result<Command> {
    let (bin, path) = (environment.join("bin"), env::var_os("PATH").unwrap_or_default());
    let mut command = Command::new(bin.join(program));
    // maturin finds Python and zig by the path, and pip finds maturin.
    let path = env::join_paths([bin].into_iter().chain(env::split_paths(&path)))?;
    command.current_dir(workspace.root.join(PYTHON_PACKAGE)).env("PATH", path);
    command.env("CARGO_TARGET_DIR", &workspace.target_dir);
    Ok(command)
}

/// Returns the only file in a folder.
fn only_file(folder: &Path) -> Result<PathBuf> {
    Ok(fs::read_dir(folder)?.next().with_context(|| format!("{} is empty", folder.display()))??.path())
}

/// Returns an empty folder below the target folder.
fn emptied(workspace: &Workspace, folder: &str) -> Result<PathBuf> {
    let out = workspace.target_dir.join(folder);
    let _ = fs::remove_dir_all(&out);
    fs::create_dir_all(&out)?;
    Ok(out)
}
