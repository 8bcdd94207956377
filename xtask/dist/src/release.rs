//! Every file to upload, in one folder. Each is unpacked into an empty folder and used there without Rust on the path.

mod firmware;
mod packages;
mod programs;
mod sbom;
mod trial;

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use document::root;
use serde_json::Value;

use crate::{SUMS, program::run_program, sums};

pub(crate) const VERSION: &str = env!("CARGO_PKG_VERSION");

/// Time stamp of every file, in seconds: the earliest date in a ZIP archive, so that all archives have the same.
const TIME: &str = "315532800";

/// Environment variable with the name of the key that signs the checksums.
const KEY: &str = "WSG_SIGNING_KEY";

const README: &str = "\
Version VERSION of wsg-bridge, wsg, wsg-sim, their libraries and their documents.

wsg-bridge-VERSION-BOARD.zip     for PLC engineers: firmware, signed updates, manual, programs, device files
wsg-VERSION-SYSTEM               the programs wsg and wsg-sim, manual pages, completions
wsg-tools_VERSION-1_CPU.deb      the same for Debian and Ubuntu
wsg_gripper-VERSION-....whl      for Python
libwsg-VERSION.tar.gz            for C and C++
wsg-web-VERSION.zip              the virtual gripper and the bridge in a browser, for any web server
wsg-book-VERSION                 the documents, as HTML and PDF
*.crate                          the crates for Rust, in the order of ORDER.txt
*.cdx.json                       the parts of an image or a program (CycloneDX)

Check the files:                 sha256sum -c SHA256SUMS
Check the signature, if present: gpg --verify SHA256SUMS.asc SHA256SUMS
";

/// Makes every file to upload, and uses each as its user would
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder to write
    #[arg(long, value_name = "FOLDER")]
    to: PathBuf,
    /// Parts to make [default: all]
    #[arg(value_name = "PART")]
    parts: Vec<Part>,
}

/// A part of a release.
#[derive(Clone, Copy, ValueEnum)]
enum Part {
    /// The folders for PLC engineers, one for each board
    Firmware,
    /// `wsg` and `wsg-sim`
    Programs,
    /// Crates for Rust
    Crates,
    /// Wheels for Python
    Wheels,
    /// The archive for C and C++
    C,
    /// The pages for browsers
    Web,
    /// The documents
    Book,
}

/// A release in the making.
pub(crate) struct Release {
    to: PathBuf,
    target_dir: PathBuf,
    /// File and trial.
    made: Vec<(String, String)>,
}

pub(crate) fn run(Arguments { to, parts }: &Arguments) -> Result<()> {
    if parts.is_empty() {
        is_set("repository", env!("CARGO_PKG_REPOSITORY"))?;
        is_set("authors", env!("CARGO_PKG_AUTHORS"))?;
    }
    let mut release = Release { to: to.clone(), target_dir: target_dir(), made: Vec::new() };
    empty(to)?;
    let parts = if parts.is_empty() { Part::value_variants() } else { parts };
    for part in parts {
        match part {
            Part::Firmware => firmware::make(&mut release)?,
            Part::Programs => programs::make(&mut release)?,
            Part::Crates => packages::crates(&mut release)?,
            Part::Wheels => packages::wheels(&mut release)?,
            Part::C => packages::c(&mut release)?,
            Part::Web => packages::web(&mut release)?,
            Part::Book => packages::book(&mut release)?,
        }
    }
    release.finish()
}

impl Release {
    /// Adds a file, and the result of its trial.
    fn add(&mut self, name: &str, bytes: &[u8], trial: impl Into<String>) -> Result<()> {
        self.names_no_path(name, bytes)?;
        fs::write(self.to.join(name), bytes).with_context(|| format!("cannot write {name}"))?;
        println!("{name}");
        self.made.push((name.to_owned(), trial.into()));
        Ok(())
    }

    /// Fails if a file contains a path of this machine, which would differ on others.
    fn names_no_path(&self, name: &str, bytes: &[u8]) -> Result<()> {
        // dlltool makes symbols of paths in the target folder.
        let symbol =
            self.target_dir.display().to_string().replace(|part: char| !part.is_ascii_alphanumeric(), "_");
        let home = env::home_dir().unwrap_or_default();
        let places = [root(), self.target_dir.clone(), home.join(".cargo"), symbol.into()];
        for place in places.iter().filter_map(|place| place.to_str()) {
            let found = bytes.windows(place.len()).position(|part| part == place.as_bytes());
            ensure!(found.is_none(), "{name} contains the path {place}, at byte {}", found.unwrap_or(0));
        }
        Ok(())
    }

    /// Fails if a file of an unpacked archive contains a path of this machine.
    fn folder_names_no_path(&self, folder: &Path) -> Result<()> {
        for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
            let path = entry?.path();
            if path.is_dir() {
                self.folder_names_no_path(&path)?;
            } else {
                self.names_no_path(&path.display().to_string(), &fs::read(&path)?)?;
            }
        }
        Ok(())
    }

    /// Returns a new empty folder to try a file in.
    fn folder(&self, name: &str) -> Result<PathBuf> {
        let folder = self.target_dir.join("release-trials").join(name);
        empty(&folder)?;
        Ok(folder)
    }

    /// Runs a command of `cargo xtask`, which makes a part of its own.
    fn xtask(&self, line: &str) -> Result<()> {
        run_program(cargo(&format!("run --quiet --locked --package xtask -- {line}")), "").map(drop)
    }

    /// Writes readme and checksums, signs the checksums if there is a key, and prints the table.
    fn finish(mut self) -> Result<()> {
        self.add("README.txt", README.replace("VERSION", VERSION).as_bytes(), "")?;
        self.made.sort();
        let read = |(name, _): &(String, String)| Ok((name.clone(), fs::read(self.to.join(name))?));
        let files = self.made.iter().map(read).collect::<Result<Vec<_>>>()?;
        fs::write(self.to.join(SUMS), sums(&files))?;
        run_program(Command::new("sha256sum").current_dir(&self.to).args(["--quiet", "-c", SUMS]), "")?;
        println!("\n{}", self.to.display());
        for ((name, trial), (_, bytes)) in self.made.iter().zip(&files) {
            println!("{:>9}  {name:<52} {trial}", bytes.len());
        }
        match env::var(KEY) {
            Ok(key) => {
                let mut gpg = Command::new("gpg");
                gpg.current_dir(&self.to).args(["--local-user", &key, "--armor", "--detach-sign", SUMS]);
                run_program(&mut gpg, "")?;
                println!("{SUMS}.asc: signed with the key {key}");
            }
            Err(_) => println!("{SUMS} is not signed: {KEY} names no key for gpg"),
        }
        Ok(())
    }
}

/// Fails if a value of the workspace's manifest, which every package names, is still a placeholder.
fn is_set(key: &str, value: &str) -> Result<()> {
    // RFC 2606 reserves this top-level domain.
    ensure!(
        !value.contains(".invalid"),
        "`{key}` in Cargo.toml is a placeholder ({value}); set the project's own, or name the parts to try: \
         cargo xtask release firmware"
    );
    Ok(())
}

/// Returns cargo's folder for what it builds.
pub(crate) fn target_dir() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Returns the names of the crates to publish.
pub(crate) fn published() -> Result<Vec<String>> {
    let metadata = cargo("metadata --locked --no-deps --format-version 1").output();
    let metadata: Value = serde_json::from_slice(&metadata.context("cannot run cargo")?.stdout)?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    // `publish` is an empty list in packages that are not published.
    let published = packages.iter().filter(|package| package["publish"].is_null());
    Ok(published.filter_map(|package| Some(package["name"].as_str()?.to_owned())).collect())
}

/// Returns the calling cargo with these words.
pub(crate) fn cargo(line: &str) -> Command {
    let mut cargo = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.current_dir(root()).args(line.split(' ')).env("SOURCE_DATE_EPOCH", TIME);
    cargo
}

/// Empties a folder, or creates it.
fn empty(folder: &Path) -> Result<()> {
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))
}

/// Packs a folder into `NAME.tar.gz` beside it, and returns its bytes.
fn tar(folder: &Path) -> Result<Vec<u8>> {
    let (parent, name) = (folder.parent().context("no parent")?, folder.file_name().context("no name")?);
    let archive = folder.with_extension("packed");
    let mut tar = Command::new("tar");
    tar.current_dir(parent).args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner"]);
    tar.args([&format!("--mtime=@{TIME}"), "--mode=go=u-w", "--use-compress-program=gzip -n", "-cf"]);
    run_program(tar.arg(&archive).arg(name), "")?;
    let bytes = fs::read(&archive)?;
    fs::remove_file(archive)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn placeholder_is_refused_by_name() {
        let refused = is_set("repository", "https://repository.invalid/x").unwrap_err().to_string();
        assert!(
            refused.contains("`repository`") && refused.contains("https://repository.invalid/x"),
            "{refused}"
        );
        is_set("repository", "https://forge.example/x").unwrap();
    }
}
