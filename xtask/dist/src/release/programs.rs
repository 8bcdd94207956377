//! `wsg` and `wsg-sim` for each system, with manual pages and completions, and the Debian packages.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use clap_complete::Shell;
use document::root;

use super::{Release, TIME, VERSION, cargo, empty, sbom, tar, trial};
use crate::program::run_program;
use crate::{LINUX, WINDOWS, archive};

/// A system that the programs are built for.
struct System {
    target: &'static str,
    /// End of the archive's name.
    name: &'static str,
    /// Extension of programs.
    ending: &'static str,
    /// Program that starts them here, if they do not start alone.
    launcher: Option<&'static str>,
}

const SYSTEMS: [System; 3] = [
    System { target: "x86_64-unknown-linux-musl", name: "linux-x86_64", ending: "", launcher: None },
    System {
        target: "aarch64-unknown-linux-musl",
        name: "linux-aarch64",
        ending: "",
        launcher: Some("qemu-aarch64-static"),
    },
    System {
        target: "x86_64-pc-windows-gnu",
        name: "windows-x86_64",
        ending: ".exe",
        launcher: Some("wine"),
    },
];

/// Folder of units in a Debian package.
const UNITS: &str = "usr/lib/systemd/system";

const PROGRAMS: [&str; 2] = ["wsg", "wsg-sim"];
const PACKAGES: [&str; 4] = ["--package", "wsg-tool", "--package", "wsg-sim"];
const PROFILE: &str = "wheel";

/// Folder of the gateway's service, and the file in it that makes a container image of the programs.
const SERVICE: &str = "tool/service";
const IMAGE: &str = "Containerfile";

const README: &str = "\
wsg      commands a gripper, configures the bridge, decodes recordings, publishes telemetry
wsg-sim  a virtual gripper

Try them:

  wsg-sim --tcp 127.0.0.1:11000 --part 20
  wsg gripper tcp://127.0.0.1:11000 home
  wsg gripper tcp://127.0.0.1:11000 grip 20 100 --force 40

On Linux, manual pages are in man (man -l man/wsg.1), completions in completions.
Containerfile makes an image of both programs: podman build --tag wsg .
";

pub(super) fn make(release: &mut Release) -> Result<()> {
    for system in &SYSTEMS {
        let folder = release.folder(&format!("packed-{}", system.name))?;
        let name = format!("wsg-{VERSION}-{}", system.name);
        let folder = folder.join(&name);
        fill(release, system, &folder)?;
        let trials = release.folder(system.name)?;
        let bytes = if system.ending.is_empty() {
            let bytes = tar(&folder)?;
            trial::untar(&trials, &bytes)?;
            bytes
        } else {
            let bytes = zip(&folder, &name)?;
            trial::unzip(&trials, &bytes)?;
            bytes
        };
        release.folder_names_no_path(&trials)?;
        let mut trial = is_used(system, &trials.join(&name))?;
        if system.launcher.is_none() {
            trial += is_used_in_container(release, &trials.join(&name))?;
        }
        let extension = if system.ending.is_empty() { "tar.gz" } else { "zip" };
        release.add(&format!("{name}.{extension}"), &bytes, trial)?;
        if system.ending.is_empty() {
            debian(release, system, &trials.join(&name))?;
        }
        for (program, package) in [("wsg", "tool"), ("wsg-sim", "gripper-sim")] {
            let name = format!("{program}-{VERSION}-{}", system.name);
            sbom::add(release, &name, package, system.target, "default")?;
        }
    }
    Ok(())
}

/// Returns `wsg` and `wsg-sim` for the computer of a PLC engineer: Windows or Linux, with a processor by Intel or AMD.
pub(super) fn for_plc_engineers(release: &Release) -> Result<Vec<(String, Vec<u8>)>> {
    let mut files = Vec::new();
    for (system, folder) in SYSTEMS.iter().filter_map(|system| Some((system, folder_of(system)?))) {
        let built = built(release, system.target)?;
        for program in PROGRAMS {
            let file = format!("{program}{}", system.ending);
            let bytes = fs::read(built.join(&file)).with_context(|| format!("cannot read {file}"))?;
            files.push((format!("{folder}/{file}"), bytes));
        }
        files.push((format!("{folder}/LICENCES.txt"), licences(system)?.into_bytes()));
    }
    Ok(files)
}

/// Returns the folder of a system's programs in the archive of a board.
fn folder_of(system: &System) -> Option<&'static str> {
    match system.name {
        "windows-x86_64" => Some(WINDOWS),
        "linux-x86_64" => Some(LINUX),
        _ => None,
    }
}

/// Returns the folder of the programs for a system, and builds them if necessary.
pub(super) fn built(release: &Release, target: &str) -> Result<PathBuf> {
    let is_windows = target.contains("windows");
    let mut cargo = cargo(if is_windows { "auditable build" } else { "auditable zigbuild" });
    cargo.args(["--quiet", "--locked", "--bins", "--profile", PROFILE, "--target", target]).args(PACKAGES);
    let without_time: &[&str] = if is_windows { &["-Clink-arg=-Wl,--no-insert-timestamp"] } else { &[] };
    provenance::remove_paths(&mut cargo, &release.target_dir, without_time);
    run_program(cargo, "")?;
    Ok(release.target_dir.join(target).join(PROFILE))
}

/// Returns the licences of the programs and their parts.
fn licences(system: &System) -> Result<String> {
    let selection = [&PACKAGES[..], &["--target", system.target]].concat().join(" ");
    provenance::licences(&[&selection])
}

/// Fills a folder with programs, licences, manual pages and completions.
fn fill(release: &Release, system: &System, folder: &Path) -> Result<()> {
    let built = built(release, system.target)?;
    empty(folder)?;
    for program in PROGRAMS {
        let file = format!("{program}{}", system.ending);
        fs::copy(built.join(&file), folder.join(&file)).with_context(|| format!("cannot copy {file}"))?;
    }
    fs::write(folder.join("LICENCES.txt"), licences(system)?)?;
    fs::write(folder.join("README.txt"), README)?;
    fs::copy(root().join("CHANGELOG.md"), folder.join("CHANGELOG.md"))?;
    if system.ending.is_empty() {
        fs::copy(root().join(SERVICE).join(IMAGE), folder.join(IMAGE))?;
        manual_pages_and_completions(folder)?;
    }
    Ok(())
}

/// Writes the folders `man` and `completions`.
fn manual_pages_and_completions(folder: &Path) -> Result<()> {
    let (pages, completions) = (folder.join("man"), folder.join("completions"));
    empty(&pages)?;
    empty(&completions)?;
    for command in [wsg_tool::command(), wsg_sim::server::command()] {
        let name = command.get_name().to_owned();
        for shell in [Shell::Bash, Shell::Fish, Shell::Zsh] {
            clap_complete::generate_to(shell, &mut command.clone(), &name, &completions)?;
        }
        clap_mangen::generate_to(command, &pages)?;
    }
    Ok(())
}

/// Adds the Debian package of the programs, which is installed below a folder, used and purged.
fn debian(release: &mut Release, system: &System, files: &Path) -> Result<()> {
    let place = release.folder(&format!("debian-{}", system.name))?;
    let cpu = if system.name.ends_with("aarch64") { "arm64" } else { "amd64" };
    let maintainer = env!("CARGO_PKG_AUTHORS").split(':').next().unwrap_or_default();
    let mut pack = Command::new("sh");
    pack.arg(root().join("xtask/dist/src/release/debian.sh")).current_dir(&place);
    pack.env("FILES", files).env("DOCS", root().join("docs")).env("VERSION", VERSION).env("CPU", cpu);
    pack.env("SERVICE", root().join(SERVICE));
    pack.env("SOURCE_DATE_EPOCH", TIME);
    pack.env("MAINTAINER", maintainer).env("HOMEPAGE", env!("CARGO_PKG_REPOSITORY"));
    run_program(pack, "")?;
    let name = format!("wsg-tools_{VERSION}-1_{cpu}.deb");
    let package = place.join(&name);

    for folder in ["info", "updates"] {
        fs::create_dir_all(place.join("var/lib/dpkg").join(folder))?;
    }
    fs::write(place.join("var/lib/dpkg/status"), "")?;
    let dpkg = |action| {
        let mut dpkg = Command::new("dpkg");
        dpkg.arg(format!("--root={}", place.display()));
        dpkg.args(["--force-not-root", "--force-script-chrootless", "--force-architecture", action]);
        dpkg
    };
    run_program(dpkg("--install").arg(&package), "")?;
    let bytes = fs::read(&package)?;
    let mut trial = is_used(system, &place.join("usr/bin"))?;
    if system.launcher.is_none() {
        trial += is_served(release, &place)?;
    }
    // The unit's own targets are the system's.
    for target in ["sysinit", "shutdown"] {
        fs::write(place.join(UNITS).join(format!("{target}.target")), "[Unit]\n")?;
    }
    let mut verify = Command::new("systemd-analyze");
    verify.args(["verify", "--man=no", &format!("--root={}", place.display()), "wsg-gateway.service"]);
    run_program(verify, "")?;
    let installed = ["usr/bin/wsg", "etc/wsg/gateway.toml"].map(|file| place.join(file));
    ensure!(installed.iter().all(|file| file.exists()), "{name} lacks one of {installed:?}");
    run_program(dpkg("--purge").arg("wsg-tools"), "")?;
    ensure!(!installed.iter().any(|file| file.exists()), "dpkg left one of {installed:?}");
    release.add(&name, &bytes, format!("installed, {trial}, unit verified, purged"))
}

/// Runs the service of an installed package under systemd, in namespaces.
fn is_served(release: &Release, package: &Path) -> Result<&'static str> {
    let room = release.folder("service")?;
    let run = |process_1: &str| {
        let mut run = Command::new("unshare");
        run.args(["--mount", "bash"]).arg(root().join("xtask/dist/src/release/service.sh"));
        run_program(run.env("PACKAGE", package).env("ROOM", &room).env("PROCESS_1", process_1), "")
    };
    if run("/bin/true").is_err() {
        return Ok(", service not tried without the rights of root");
    }
    run("/lib/systemd/systemd").map(|_| ", service runs under systemd")
}

/// Grips with the programs in a container of their image, if there is buildah.
fn is_used_in_container(release: &Release, files: &Path) -> Result<&'static str> {
    if Command::new("buildah").arg("--version").output().is_err() {
        return Ok("; no container without buildah");
    }
    let store = release.folder("containers")?.display().to_string();
    let words = format!("buildah --storage-driver vfs --root {store}/root --runroot {store}/run ");
    let run = |line: &str, expected: &str| {
        let line = format!("{words}{line}");
        let mut words = line.split(' ');
        run_program(Command::new(words.next().unwrap_or_default()).args(words).current_dir(files), expected)
    };
    run("build --quiet --isolation chroot --tag wsg .", "")?;
    run("from --name trial wsg", "trial")?;
    let launcher = format!("{words}run --isolation chroot trial --");
    trial::grip(&launcher.split(' ').collect::<Vec<_>>(), "/usr/bin".as_ref(), "")?;
    Ok(", and in a container")
}

/// Packs the files of a folder without subfolders.
pub(super) fn zip(folder: &Path, name: &str) -> Result<Vec<u8>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        files.push((format!("{name}/{}", entry.file_name().to_string_lossy()), fs::read(entry.path())?));
    }
    files.sort();
    archive::zip(&files)
}

/// Grips with the unpacked programs, if they start here.
fn is_used(system: &System, folder: &Path) -> Result<String> {
    let Some(launcher) = system.launcher else {
        trial::grip(&[], folder, system.ending)?;
        return Ok("grips on wsg-sim".to_owned());
    };
    if Command::new(launcher).arg("--version").output().is_err() {
        return Ok(format!("linked only: no {launcher}"));
    }
    if launcher != "wine" {
        trial::grip(&[launcher], folder, system.ending)?;
        return Ok(format!("grips on wsg-sim, by {launcher}"));
    }
    // Debian's Wine lacks this library of Windows.
    let mut library = Command::new("x86_64-w64-mingw32-gcc");
    library.args(["-shared", "-o"]).arg(folder.join("bcryptprimitives.dll"));
    run_program(library.arg(root().join("xtask/src/platforms.c")).arg("-ladvapi32"), "")?;
    // Wine's settings are in the folder, too. Programs that start its server at the same time may fail.
    let server = |option| trial::isolated(&[], "wineserver".as_ref(), folder).arg(option).status();
    server("-p60")?;
    let outcome = trial::grip(&[launcher], folder, system.ending);
    server("-k")?;
    outcome.map(|()| "grips on wsg-sim, by Wine".to_owned())
}
