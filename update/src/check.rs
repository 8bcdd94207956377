//! The checks of an image, block by block.

use core::fmt;

use sha2::{Digest, Sha512};

use crate::{LENGTH_AT, Manifest, PublicKey, SIGNATURE_LEN, SLOT_LEN, Target, verify};

/// Reads the bytes of a slot or a file.
pub trait SlotReader {
    /// Reads from this offset.
    ///
    /// # Errors
    /// [`Unreadable`] if a byte is past the end, or the flash detects damaged data.
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Unreadable>;
}

/// Error: bytes of a slot cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unreadable;

impl SlotReader for &[u8] {
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Unreadable> {
        let from = self.get(offset as usize..).ok_or(Unreadable)?;
        bytes.copy_from_slice(from.get(..bytes.len()).ok_or(Unreadable)?);
        Ok(())
    }
}

/// The two keys that a board trusts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Keys {
    /// Signs anything, including successors of the second.
    pub first: PublicKey,
    /// Signs images without a successor.
    pub second: PublicKey,
}

/// Conditions for an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rules {
    /// The board.
    pub target: Target,
    /// The trusted keys.
    pub keys: Keys,
    /// Lowest accepted rollback counter.
    pub counter: u32,
}

/// Reason why an image is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Refusal {
    /// No image: erased flash, or other data.
    NoImage = 1,
    /// The flash detects damaged data in the image.
    Unreadable = 2,
    /// The image and its signature exceed a slot.
    TooLong = 3,
    /// The image is for another board.
    WrongBoard = 4,
    /// The rollback counter is lower than the stored one.
    LowerCounter = 5,
    /// The signature is that of neither key, or a byte is damaged.
    WrongSignature = 6,
    /// The image names a successor, but is signed with the second key.
    WrongSuccessor = 7,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NoImage => "no image",
            Self::Unreadable => "the image is unreadable",
            Self::TooLong => "the image exceeds a slot of 192 KiB",
            Self::WrongBoard => "the image is for another board",
            Self::LowerCounter => "the image's rollback counter is lower than the stored one",
            Self::WrongSignature => "the signature is wrong",
            Self::WrongSuccessor => "only an image signed with the first key may name a successor",
        })
    }
}

impl core::error::Error for Refusal {}

/// A check in progress.
#[derive(Clone, Debug)]
pub struct Check {
    rules: Rules,
    manifest: Manifest,
    hash: Sha512,
    /// Bytes of the image in `hash`.
    hashed: u32,
    /// The first key does not verify the signature.
    is_second: bool,
}

impl Check {
    /// Bytes per step: a block of SHA-512.
    pub const BLOCK_LEN: usize = 128;

    /// Bytes of the vector table up to the length, and of a manifest.
    const MIN_LENGTH: u32 = (LENGTH_AT + 4 + Manifest::LEN) as u32;

    /// Checks everything but the signature.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn begin(slot: &mut impl SlotReader, rules: Rules) -> Result<Self, Refusal> {
        let mut length = [0; 4];
        read(slot, LENGTH_AT as u32, &mut length)?;
        let length = u32::from_le_bytes(length);
        if length < Self::MIN_LENGTH || !length.is_multiple_of(8) {
            return Err(Refusal::NoImage);
        }
        if length > const { SLOT_LEN - SIGNATURE_LEN as u32 } {
            return Err(Refusal::TooLong);
        }
        let mut bytes = [0; Manifest::LEN];
        read(slot, length.saturating_sub(Manifest::LEN as u32), &mut bytes)?;
        let manifest = Manifest::decode(&bytes).filter(|manifest| manifest.length == length);
        let manifest = manifest.ok_or(Refusal::NoImage)?;
        if manifest.target != rules.target {
            return Err(Refusal::WrongBoard);
        }
        if manifest.counter < rules.counter {
            return Err(Refusal::LowerCounter);
        }
        Ok(Self { rules, manifest, hash: Sha512::new(), hashed: 0, is_second: false })
    }

    /// Returns the manifest. It is not trusted before the signature is checked.
    #[must_use]
    pub const fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Reads the next block. Returns the manifest after the last step. One or two steps check the signature, one for each key;
    /// they take by far the longest.
    ///
    /// # Errors
    /// [`Refusal`], after which the check must not be continued.
    pub fn step(&mut self, slot: &mut impl SlotReader) -> Result<Option<Manifest>, Refusal> {
        let program = self.manifest.length.saturating_sub(Manifest::LEN as u32);
        let left = program.saturating_sub(self.hashed);
        if left > 0 {
            let mut block = [0; Self::BLOCK_LEN];
            let len = left.min(Self::BLOCK_LEN as u32);
            let block = block.get_mut(..len as usize).unwrap_or_default();
            read(slot, self.hashed, block)?;
            self.hash.update(block);
            self.hashed = self.hashed.saturating_add(len);
            return Ok(None);
        }
        // Not read again: the manifest that was checked must be the signed one, even if the flash reads differently each time.
        let digest = self.hash.clone().chain_update(self.manifest.encode()).finalize();
        let mut signature = [0; SIGNATURE_LEN];
        read(slot, self.manifest.length, &mut signature)?;
        if !core::mem::replace(&mut self.is_second, true) {
            return Ok(verify(&self.rules.keys.first, &digest, &signature).then_some(self.manifest));
        }
        if !verify(&self.rules.keys.second, &digest, &signature) {
            return Err(Refusal::WrongSignature);
        }
        if self.manifest.successor.is_some() {
            return Err(Refusal::WrongSuccessor);
        }
        Ok(Some(self.manifest))
    }
}

fn read(slot: &mut impl SlotReader, offset: u32, bytes: &mut [u8]) -> Result<(), Refusal> {
    slot.read(offset, bytes).map_err(|Unreadable| Refusal::Unreadable)
}
