//! Keys and signatures of images for updates in the field. Offline; the format is that of the crate `wsg-update`.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use wsg_update::sign::{self, SigningKey};
use wsg_update::{Manifest, PublicKey, Target, Version};

/// First bytes of an ELF file.
const ELF: &[u8] = b"\x7FELF";

#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Program as bytes of the flash from the start of slot A (.bin)
    image: PathBuf,
    /// Private key, from `keygen`
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Board, such as b-l475e-iot01a, nucleo-g474re or pico; another board refuses the image
    #[arg(long, value_name = "NAME")]
    board: String,
    /// Version of the program, for display
    #[arg(long = "release", value_name = "X.Y.Z", value_parser = version, default_value = env!("CARGO_PKG_VERSION"))]
    version: Version,
    /// Rollback counter: raise it only for a security fix, because boards then refuse all images with a lower one
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    counter: u32,
    /// Public key that succeeds the second one on the boards; requires the first key
    #[arg(long, value_name = "FILE.pub")]
    successor: Option<PathBuf>,
    /// Signed image to write; by default the image's name with .update
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
}

fn version(text: &str) -> Result<Version> {
    Version::parse(text).context("expected three numbers up to 255, such as 1.2.3")
}

/// Writes a new private key and its public key.
pub(crate) fn generate_key(file: &Path, output: &mut impl Write) -> Result<()> {
    let mut seed = [0; 32];
    getrandom::fill(&mut seed).context("the operating system provides no random numbers")?;
    let key = SigningKey::from_bytes(&seed);
    let public = key.verifying_key().to_bytes();
    let mut public_file = file.as_os_str().to_owned();
    public_file.push(".pub");
    let public_file = PathBuf::from(public_file);
    ensure!(!public_file.exists(), "{} exists; choose another name", public_file.display());
    write_new(file, &sign::private_pem(&key))?;
    write_new(&public_file, &sign::public_pem(&public))?;
    writeln!(output, "{}: private key; keep it secret and offline, with a copy", file.display())?;
    let digits: String = public.iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(writeln!(output, "{}: public key {digits}", public_file.display())?)
}

/// Signs an image.
pub(crate) fn sign(arguments: &Arguments, output: &mut impl Write) -> Result<()> {
    let Arguments { image, key, board, version, counter, successor, .. } = arguments;
    let program = read(image)?;
    ensure!(!program.starts_with(ELF), "{} is an ELF file; expected the program as .bin", image.display());
    let manifest = Manifest {
        target: Target::of(board),
        version: *version,
        length: 0,
        counter: *counter,
        successor: successor.as_deref().map(public_key).transpose()?,
    };
    let file = wsg_update::sign::file(&program, manifest, &private_key(key)?)
        .with_context(|| format!("cannot sign {}", image.display()))?;
    let signed = arguments.output.clone().unwrap_or_else(|| image.with_extension("update"));
    ensure!(signed != *image, "the signed image needs another name than {}", image.display());
    fs::write(&signed, &file).with_context(|| format!("cannot write {}", signed.display()))?;
    let named = if successor.is_some() { ", names a successor of the second key" } else { "" };
    Ok(writeln!(
        output,
        "{}: {} bytes for {board}, version {version}, rollback counter {counter}{named}",
        signed.display(),
        file.len()
    )?)
}

/// Reads a private key.
fn private_key(file: &Path) -> Result<SigningKey> {
    let expected = || format!("{}: expected a private key of Ed25519 as PEM", file.display());
    sign::private_key(&read(file)?).with_context(expected)
}

/// Reads a public key.
pub(crate) fn public_key(file: &Path) -> Result<PublicKey> {
    let expected = || format!("{}: expected a public key of Ed25519 as PEM", file.display());
    sign::public_key(&read(file)?).with_context(expected)
}

fn read(file: &Path) -> Result<Vec<u8>> {
    fs::read(file).with_context(|| format!("cannot read {}", file.display()))
}

/// Writes a file that only its owner can read, unless it exists.
fn write_new(path: &Path, text: &str) -> Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let write = |mut file: File| file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    match options.open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            bail!("{} exists; choose another name", path.display())
        }
        opened => opened.and_then(write).with_context(|| format!("cannot write {}", path.display())),
    }
}
