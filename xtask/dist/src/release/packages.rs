//! Packages for programmers, and the book. Other commands of `cargo xtask` build most of them.

use std::{fs, path::Path, process::Command};

use anyhow::{Context, Result, ensure};
use browser::Tab;

use crate::book::{self, without_links};

use super::{Release, VERSION, cargo, published, sbom, tar, trial};
use crate::program::run_program;

/// Packages the crates. A trial of publishing builds each from its package alone, with the others as dependencies from a registry.
pub(super) fn crates(release: &mut Release) -> Result<()> {
    let folder = release.target_dir.join("package");
    let _ = fs::remove_dir_all(&folder);
    let published = published()?;
    let run = |line: &str| {
        let mut cargo = cargo(line);
        run_program(cargo.args(published.iter().flat_map(|name| ["-p", name.as_str()])), "")
    };
    let files_of = |printed: &str, word: &str| -> Vec<String> {
        let lines = printed.lines().filter_map(|line| line.trim_start().strip_prefix(word));
        lines
            .filter_map(|line| line.split(" (").next())
            .map(|it| format!("{}.crate", it.replace(" v", "-")))
            .collect()
    };
    run("package --locked --allow-dirty --no-verify")?;
    let printed = run("publish --dry-run --locked --allow-dirty")?;
    // cargo uploads each crate after its dependencies.
    let (files, verified) = (files_of(&printed, "Uploading "), files_of(&printed, "Verifying "));
    ensure!(files.len() == published.len(), "cargo would upload {files:?}; expected {published:?}");
    ensure!(
        files.iter().all(|file| verified.contains(file)),
        "cargo verified {verified:?}; expected {files:?}"
    );
    embassy(release, &folder)?;
    release.add("ORDER.txt", (files.join("\n") + "\n").as_bytes(), "")?;
    for file in files {
        let bytes = fs::read(folder.join(&file)).with_context(|| format!("cannot read {file}"))?;
        release.add(&file, &bytes, "built from its package alone by cargo publish --dry-run")?;
    }
    Ok(())
}

/// Builds the project for embassy from the packed crate.
fn embassy(release: &Release, packages: &Path) -> Result<()> {
    let place = release.folder("embassy")?;
    for name in ["wsg-protocol", "wsg-protocol-macros"] {
        let package = packages.join(format!("{name}-{VERSION}.crate"));
        trial::untar(&place, &fs::read(&package).with_context(|| package.display().to_string())?)?;
    }
    let project = place.join(format!("wsg-protocol-{VERSION}/examples/embassy"));
    fs::rename(project.join("project.toml"), project.join("Cargo.toml"))
        .context("cannot rename project.toml")?;
    let mut cargo = cargo("build --quiet --release --target thumbv7em-none-eabihf --config");
    // Until it is published.
    let macros = place.join(format!("wsg-protocol-macros-{VERSION}"));
    cargo.arg(format!("patch.crates-io.wsg-protocol-macros.path='{}'", macros.display()));
    cargo.current_dir(&project).env("CARGO_TARGET_DIR", release.target_dir.join("embassy"));
    // Without the flags for this repository's own images, which cargo finds above the folder.
    run_program(cargo.env("RUSTFLAGS", ""), "").map(drop)
}

/// Adds the wheels, whose tests run without Rust on the path, and grips with one in an environment of its own.
pub(super) fn wheels(release: &mut Release) -> Result<()> {
    let folder = release.target_dir.join("wheels");
    release.xtask("wheels")?;
    for target in fs::read_dir(&folder)? {
        let target = target?.path();
        if target.ends_with("dev") {
            continue;
        }
        let wheel = fs::read_dir(&target)?.next().context("a folder without a wheel")??.path();
        let name = wheel.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let place = release.folder("wheel-unpacked")?;
        trial::unzip(&place, &fs::read(&wheel)?)?;
        release.folder_names_no_path(&place)?;
        let trial = if target.ends_with(std::env::consts::ARCH) {
            let place = release.folder("wheel")?;
            run_program(Command::new("python3").current_dir(&place).args(["-m", "venv", "."]), "")?;
            let mut pip = trial::isolated(&[], &place.join("bin/python"), &place);
            run_program(pip.args(["-m", "pip", "install", "--quiet", "--no-index"]).arg(&wheel), "")?;
            let mut python = trial::isolated(&[], &place.join("bin/python"), &place);
            run_program(python.args(["-c", PYTHON_GRIP]), "held")?;
            "its tests; grips in a virtual environment"
        } else {
            "linked only"
        };
        release.add(&name, &fs::read(&wheel)?, trial)?;
    }
    sbom::add(
        release,
        &format!("wsg_gripper-{VERSION}"),
        "bindings/python",
        "x86_64-unknown-linux-gnu",
        "default",
    )
}

const PYTHON_GRIP: &str = "\
from wsg_gripper import Gripper
from wsg_gripper.sim import Simulator
with Simulator(part=20) as simulator, Gripper(simulator.tcp) as gripper:
    gripper.home()
    print('held' if gripper.grip(20, speed=100, force=40) else 'no part')
";

/// Adds the archive for C, and grips with its example, compiled by gcc.
pub(super) fn c(release: &mut Release) -> Result<()> {
    release.xtask("dist-c")?;
    let name = format!("libwsg-{VERSION}");
    let bytes = fs::read(release.target_dir.join(format!("dist-c/{name}.tar.gz")))?;
    let place = release.folder("c")?;
    trial::untar(&place, &bytes)?;
    release.folder_names_no_path(&place)?;
    let place = place.join(&name);
    let mut gcc = trial::isolated(&[], "gcc".as_ref(), &place);
    gcc.args("-I include examples/posix.c -L lib/x86_64-unknown-linux-gnu -lwsg -o posix".split(' '));
    run_program(gcc, "")?;
    let programs = super::programs::built(release, "x86_64-unknown-linux-musl")?;
    let sim = trial::Sim::start(&[], &programs.join("wsg-sim"), &place)?;
    let (host, port) = sim.address.split_once(':').context("an address has a port")?;
    let mut grip = trial::isolated(&[], &place.join("posix"), &place);
    run_program(grip.args([host, port]), "Release Part: no error\ndone\n")?;
    release.add(&format!("{name}.tar.gz"), &bytes, "grips on wsg-sim: examples/posix.c, by gcc")?;
    sbom::add(release, &name, "bindings/c-host", "x86_64-unknown-linux-gnu", "default")
}

/// Adds the pages for browsers, and opens the station from a web server.
pub(super) fn web(release: &mut Release) -> Result<()> {
    release.xtask("web")?;
    let name = format!("wsg-web-{VERSION}");
    let bytes = super::programs::zip(&release.target_dir.join("web"), &name)?;
    let place = release.folder("web")?;
    trial::unzip(&place, &bytes)?;
    release.folder_names_no_path(&place)?;
    let mut tab = Tab::open(&format!("{}/station.html", browser::serve(&place.join(&name))?));
    tab.until("document.getElementById('state').textContent.startsWith('Gripper: FAST STOP')");
    release.add(&format!("{name}.zip"), &bytes, "Chromium runs the station")
}

/// Adds the book, as HTML and as PDF.
pub(super) fn book(release: &mut Release) -> Result<()> {
    book::build()?;
    let name = format!("wsg-book-{VERSION}");
    let folder = release.folder("packed-book")?.join(&name);
    let built = document::root().join("target/book");
    run_program(Command::new("cp").arg("-r").arg(&built).arg(&folder), "")?;
    let mut pages = 0;
    for entry in fs::read_dir(&folder)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "html") {
            // The archive does not contain the sources.
            let html = without_links(&fs::read_to_string(&path)?, |link| link.starts_with("../"));
            fs::write(&path, html)?;
            pages += 1;
        }
    }
    let bytes = tar(&folder)?;
    let place = release.folder("book")?;
    trial::untar(&place, &bytes)?;
    release.folder_names_no_path(&place)?;
    let mut browser = trial::isolated(&[], "chromium".as_ref(), &place);
    browser.args(book::HEADLESS).arg("--dump-dom");
    browser.arg(format!("file://{}", place.join(&name).join("quick-start.html").display()));
    run_program(browser, "<h1 id=\"quick-start\">")?;
    release.add(&format!("{name}.tar.gz"), &bytes, format!("{pages} pages; Chromium opens one"))?;
    let pdf = fs::read(built.with_extension("pdf"));
    let pdf = pdf.context("there is no PDF of the book: Chromium is missing")?;
    ensure!(pdf.starts_with(b"%PDF-"), "the PDF of the book does not begin with %PDF-");
    release.add(&format!("{name}.pdf"), &pdf, "a PDF file, not opened")
}
