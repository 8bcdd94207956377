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

impl Keys {
    /// The keys of the boot loader: those in the variables `WSG_FIRST_KEY` and `WSG_SECOND_KEY` at its build, as 64 hexadecimal
    /// digits, otherwise [`TEST`](Self::TEST).
    pub const BUILT_IN: Self = Self {
        first: given(option_env!("WSG_FIRST_KEY"), Self::TEST.first),
        second: given(option_env!("WSG_SECOND_KEY"), Self::TEST.second),
    };

    /// Keys for tests, without any protection: the private keys are 32 bytes 01h, and 32 bytes 02h.
    pub const TEST: Self = Self {
        first: parse("8a88e3dd7409f195fd52db2d3cba5d72ca6709bf1d94121bf3748801b40f6f5c"),
        second: parse("8139770ea87d175f56a35466c34c7ecccb8d8a91b4ee37a25df60f5b8fc9b394"),
    };

    /// Returns whether a board trusts images signed with this key.
    #[must_use]
    pub fn contain(&self, key: &PublicKey) -> bool {
        [self.first, self.second].contains(key)
    }

    /// Returns whether anybody can sign for a board with these keys, because one of them is a test key.
    #[must_use]
    pub fn contain_test_key(&self) -> bool {
        self.contain(&Self::TEST.first) || self.contain(&Self::TEST.second)
    }
}

const fn given(digits: Option<&str>, default: PublicKey) -> PublicKey {
    match digits {
        Some(digits) => parse(digits),
        None => default,
    }
}

/// Parses 64 hexadecimal digits at compile time.
#[expect(
    clippy::panic,
    clippy::indexing_slicing,
    clippy::arithmetic_side_effects,
    reason = "evaluated at compile time"
)]
const fn parse(digits: &str) -> PublicKey {
    assert!(digits.len() == 64, "a key has 64 hexadecimal digits");
    let mut key = [0; 32];
    let mut at = 0;
    while at < 64 {
        let digit = match digits.as_bytes()[at] {
            digit @ b'0'..=b'9' => digit - b'0',
            digit @ b'a'..=b'f' => digit - b'a' + 10,
            digit @ b'A'..=b'F' => digit - b'A' + 10,
            _ => panic!("a key has 64 hexadecimal digits"),
        };
        key[at / 2] = key[at / 2] << 4 | digit;
        at += 1;
    }
    key
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

impl Manifest {
    /// Bytes of the vector table up to the length, and of a manifest.
    const MIN_LENGTH: u32 = (LENGTH_AT + 4 + Self::LEN) as u32;

    /// Reads the manifest of the image in a slot. It is not trusted.
    ///
    /// # Errors
    /// [`Refusal`] for a slot without an image.
    pub fn read(slot: &mut impl SlotReader) -> Result<Self, Refusal> {
        let mut length = [0; 4];
        read(slot, LENGTH_AT as u32, &mut length)?;
        let length = u32::from_le_bytes(length);
        if length < Self::MIN_LENGTH || !length.is_multiple_of(8) {
            return Err(Refusal::NoImage);
        }
        if length > const { SLOT_LEN - SIGNATURE_LEN as u32 } {
            return Err(Refusal::TooLong);
        }
        let mut bytes = [0; Self::LEN];
        read(slot, length.saturating_sub(Self::LEN as u32), &mut bytes)?;
        Self::decode(&bytes).filter(|manifest| manifest.length == length).ok_or(Refusal::NoImage)
    }
}

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

    /// Checks an image at once.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn whole(slot: &mut impl SlotReader, rules: Rules) -> Result<Manifest, Refusal> {
        let mut check = Self::begin(slot, rules)?;
        loop {
            if let Some(manifest) = check.step(slot)? {
                return Ok(manifest);
            }
        }
    }

    /// Checks everything but the signature.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn begin(slot: &mut impl SlotReader, rules: Rules) -> Result<Self, Refusal> {
        let manifest = Manifest::read(slot)?;
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
        self.step_with(slot, verify)
    }

    /// Does the same with another implementation of [`verify`], such as the boot loader's, which a firmware need not contain again.
    ///
    /// # Errors
    /// Like [`step`](Self::step).
    pub fn step_with(
        &mut self,
        slot: &mut impl SlotReader,
        verify: impl Fn(&PublicKey, &[u8; 64], &[u8; SIGNATURE_LEN]) -> bool,
    ) -> Result<Option<Manifest>, Refusal> {
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
        let digest = self.hash.clone().chain_update(self.manifest.encode()).finalize().into();
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
