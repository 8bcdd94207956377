//! Composes and signs images.
//!
//! Keys are PEM files that OpenSSL and other programs read: PKCS#8 (RFC 8410) for the private key, SubjectPublicKeyInfo for the
//! public one.

use alloc::string::String;
use alloc::vec::Vec;

use ed25519_dalek::Signer;
pub use ed25519_dalek::SigningKey;
use pem::{EncodeConfig, LineEnding, Pem};
use sha2::{Digest, Sha512};

use crate::{LENGTH_AT, Manifest, PublicKey, Refusal, SIGNATURE_LEN, SLOT_LEN};

/// Tag, and DER before the 32 bytes of each key (RFC 8410, 10.3 and 10.1).
const PRIVATE: (&str, &[u8]) =
    ("PRIVATE KEY", b"\x30\x2E\x02\x01\x00\x30\x05\x06\x03\x2B\x65\x70\x04\x22\x04\x20");
const PUBLIC: (&str, &[u8]) = ("PUBLIC KEY", b"\x30\x2A\x30\x05\x06\x03\x2B\x65\x70\x03\x21\x00");

/// Parses a private key of Ed25519. Returns `None` for any other text.
#[must_use]
pub fn private_key(pem: &[u8]) -> Option<SigningKey> {
    parse(pem, PRIVATE).map(|seed| SigningKey::from_bytes(&seed))
}

/// Parses a public key of Ed25519. Returns `None` for any other text.
#[must_use]
pub fn public_key(pem: &[u8]) -> Option<PublicKey> {
    parse(pem, PUBLIC)
}

/// Returns the PEM text of a private key.
#[must_use]
pub fn private_pem(key: &SigningKey) -> String {
    text(PRIVATE, key.as_bytes())
}

/// Returns the PEM text of a public key.
#[must_use]
pub fn public_pem(key: &PublicKey) -> String {
    text(PUBLIC, key)
}

fn parse(pem: &[u8], (tag, prefix): (&str, &[u8])) -> Option<[u8; 32]> {
    let parsed = pem::parse(pem).ok().filter(|parsed| parsed.tag() == tag)?;
    parsed.contents().strip_prefix(prefix)?.try_into().ok()
}

fn text((tag, prefix): (&str, &[u8]), key: &[u8; 32]) -> String {
    let pem = Pem::new(tag, [prefix, key].concat());
    pem::encode_config(&pem, EncodeConfig::new().set_line_ending(LineEnding::LF))
}

/// Returns the file for a program: the image with its manifest, whose length is ignored, and the signature.
///
/// # Errors
/// [`Refusal::TooLong`], or [`Refusal::NoImage`] for a program without a vector table.
pub fn file(program: &[u8], manifest: Manifest, key: &SigningKey) -> Result<Vec<u8>, Refusal> {
    let mut image = program.to_vec();
    image.resize(program.len().next_multiple_of(8), 0xFF);
    let length = image.len().saturating_add(Manifest::LEN);
    if length.saturating_add(SIGNATURE_LEN) > SLOT_LEN as usize {
        return Err(Refusal::TooLong);
    }
    let length = length as u32;
    let place = image.get_mut(LENGTH_AT..).and_then(<[u8]>::first_chunk_mut).ok_or(Refusal::NoImage)?;
    *place = length.to_le_bytes();
    image.extend(Manifest { length, ..manifest }.encode());
    let signature = key.sign(&Sha512::digest(&image));
    image.extend(signature.to_bytes());
    Ok(image)
}
