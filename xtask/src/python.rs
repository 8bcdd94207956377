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

/// Builds the wheels for users, checks their sizes, and tests the wheel of this machine.
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
    let out = emptied(workspace, "dev")?;
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
    Ok(fs::read_dir(out)?.next().context("there is no wheel")??.path())
}

/// Installs a wheel in place of any other version.
pub(crate) fn install_wheel(environment: &Path, wheel: &Path) -> Result<()> {
    let mut pip = Command::new(environment.join("bin/python"));
    pip.args(["-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--force-reinstall"]);
    process::run(pip.arg(wheel))
}

/// Runs the tests of the installed package.
pub(crate) fn test(workspace: &Workspace, environment: &Path) -> Result<()> {
    let bin = environment.join("bin");
    let path = env::join_paths([bin.as_path(), Path::new("/usr/bin"), Path::new("/bin")])?;
    let mut pytest = Command::new(bin.join("python"));
    pytest.env_clear().env("PATH", path).current_dir(workspace.root.join(PYTHON_PACKAGE));
    // In several processes, because the tests mostly wait for fingers.
    process::run(pytest.args(["-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "8"]))
}

/// Builds a wheel and returns its path.
fn build(workspace: &Workspace, environment: &Path, folder: &str, options: &[&str]) -> Result<PathBuf> {
    let out = emptied(workspace, folder)?;
    let mut maturin = maturin(workspace, environment, options)?;
    maturin.args(["build", "--locked", "--profile", "wheel", "--out"]).arg(&out).args(options);
    provenance::remove_paths(&mut maturin, &workspace.target_dir, &[]);
    process::run(&mut maturin)?;
    Ok(fs::read_dir(out)?.next().context("there is no wheel")??.path())
}

/// Returns maturin's command for the package, and writes the licences, which it adds to the wheel.
fn maturin(workspace: &Workspace, environment: &Path, options: &[&str]) -> Result<Command> {
    let package = workspace.root.join(PYTHON_PACKAGE);
    let target = options.iter().skip_while(|option| **option != "--target").take(2);
    let selection = ["--package", "wsg-python"].iter().chain(target).copied().collect::<Vec<_>>().join(" ");
    fs::write(package.join("LICENCES.txt"), provenance::licences(&[&selection])?)?;
    let (bin, path) = (environment.join("bin"), env::var_os("PATH").unwrap_or_default());
    let mut maturin = Command::new(bin.join("maturin"));
    // maturin finds Python and zig by the path.
    let path = env::join_paths([bin].into_iter().chain(env::split_paths(&path)))?;
    maturin.current_dir(package).env("CARGO_TARGET_DIR", &workspace.target_dir).env("PATH", path);
    Ok(maturin)
}

/// Returns an empty folder for a wheel.
fn emptied(workspace: &Workspace, folder: &str) -> Result<PathBuf> {
    let out = workspace.target_dir.join("wheels").join(folder);
    let _ = fs::remove_dir_all(&out);
    fs::create_dir_all(&out)?;
    Ok(out)
}
