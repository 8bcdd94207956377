//! Composes and signs images.

use alloc::vec::Vec;

use ed25519_dalek::Signer;
pub use ed25519_dalek::SigningKey;
use sha2::{Digest, Sha512};

use crate::{LENGTH_AT, Manifest, Refusal, SIGNATURE_LEN, SLOT_LEN};

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
