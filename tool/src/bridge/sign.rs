//! Keys and signatures of images for updates in the field. Offline; the format is that of the crate `wsg-update`.
//!
//! Keys are PEM files that OpenSSL and other programs read: PKCS#8 (RFC 8410) for the private key, SubjectPublicKeyInfo for the
//! public one.

use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use pem::{EncodeConfig, LineEnding, Pem};
use wsg_update::sign::SigningKey;
use wsg_update::{Manifest, PublicKey, Target, Version};

/// DER before the 32 bytes of each key (RFC 8410, 10.3 and 10.1).
const PRIVATE: (&str, &[u8]) =
    ("PRIVATE KEY", b"\x30\x2E\x02\x01\x00\x30\x05\x06\x03\x2B\x65\x70\x04\x22\x04\x20");
const PUBLIC: (&str, &[u8]) = ("PUBLIC KEY", b"\x30\x2A\x30\x05\x06\x03\x2B\x65\x70\x03\x21\x00");

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

/// Parses a version of three numbers up to 255.
fn version(text: &str) -> Result<Version> {
    let numbers: Option<Vec<u8>> = text.split('.').map(|number| number.parse().ok()).collect();
    let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
    numbers.map(Version).context("expected three numbers up to 255, such as 1.2.3")
}

/// Writes a new private key and its public key.
pub(crate) fn generate_key(file: &Path, output: &mut impl Write) -> Result<()> {
    let mut seed = [0; 32];
    getrandom::fill(&mut seed).context("the operating system provides no random numbers")?;
    let public = SigningKey::from_bytes(&seed).verifying_key().to_bytes();
    let mut public_file = file.as_os_str().to_owned();
    public_file.push(".pub");
    let public_file = PathBuf::from(public_file);
    ensure!(!public_file.exists(), "{} exists; choose another name", public_file.display());
    write_new(file, &text(PRIVATE, &seed))?;
    write_new(&public_file, &text(PUBLIC, &public))?;
    writeln!(output, "{}: private key; keep it secret and offline, with a copy", file.display())?;
    Ok(writeln!(output, "{}: public key", public_file.display())?)
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
    Ok(SigningKey::from_bytes(&key(file, PRIVATE)?))
}

/// Reads a public key.
pub(crate) fn public_key(file: &Path) -> Result<PublicKey> {
    key(file, PUBLIC)
}

fn key(file: &Path, (tag, prefix): (&str, &[u8])) -> Result<[u8; 32]> {
    let expected = || format!("{}: expected a {} of Ed25519 as PEM", file.display(), tag.to_lowercase());
    let parsed = pem::parse(read(file)?).with_context(expected)?;
    let bytes = parsed.contents().strip_prefix(prefix).filter(|_| parsed.tag() == tag);
    bytes.and_then(|bytes| bytes.try_into().ok()).with_context(expected)
}

fn text((tag, prefix): (&str, &[u8]), key: &[u8; 32]) -> String {
    pem::encode_config(
        &Pem::new(tag, [prefix, key].concat()),
        EncodeConfig::new().set_line_ending(LineEnding::LF),
    )
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
