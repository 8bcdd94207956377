//! Signed images for updates of the bridge in the field (`docs/decisions.md`): their format, the checks of the boot loader and
//! of the receiver, and the records with which the firmware and the boot loader agree. Without flash and transfer.
//!
//! # Format
//! A file, and a slot from its start, contains an image and its signature. The image is the program as bytes of the flash from
//! the slot's start, its rest up to a multiple of 8 bytes, and the [`Manifest`], which are its last 64 bytes. The word at
//! offset [`LENGTH_AT`], a reserved entry of the vector table, is the length of the image, so the manifest can be found.
//!
//! The signature is Ed25519 (RFC 8032) with the 64 bytes SHA-512 of the image as its message. So every byte of the file is
//! protected, and third-party programs check it with two calls.
//!
//! # Keys
//! The boot loader contains two public keys. The first signs rarely and is kept offline; the second signs releases. An image
//! signed with the first can name a successor of the second, which replaces it once the image has confirmed itself
//! ([`Trust`]).
//!
//! ```
//! use wsg_update::{Check, Keys, Refusal, Rules, Target};
//!
//! fn check(slot: &[u8], keys: Keys, counter: u32) -> Result<wsg_update::Manifest, Refusal> {
//!     let mut slot = slot;
//!     let mut check = Check::begin(&mut slot, Rules { target: Target::of("pico"), keys, counter })?;
//!     loop {
//!         // Between two blocks, a firmware feeds its watchdog and serves its lines.
//!         if let Some(manifest) = check.step(&mut slot)? {
//!             return Ok(manifest);
//!         }
//!     }
//! }
//! # assert_eq!(check(&[0xFF; 1_000], Keys { first: [1; 32], second: [2; 32] }, 0), Err(Refusal::NoImage));
//! ```
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::indexing_slicing,
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::arithmetic_side_effects
    )
)]

#[cfg(feature = "sign")]
extern crate alloc;

mod check;
mod manifest;
mod record;
#[cfg(feature = "sign")]
pub mod sign;
mod signature;

pub use check::{Check, Keys, Refusal, Rules, SlotReader, Unreadable};
pub use manifest::{Manifest, Target, Version};
pub use record::{BootState, Phase, RECORD_VERSION, Trust};
pub use signature::verify;

/// A public key of Ed25519.
pub type PublicKey = [u8; 32];

/// Bytes of a signature, which follows the image.
pub const SIGNATURE_LEN: usize = 64;

/// Bytes of flash for the boot loader, from the start of flash to slot A.
pub const BOOT_LEN: u32 = 32 * 1024;

/// Bytes of a slot: the limit of a file. The linker checks the program alone (`boards/update-slot.x`).
pub const SLOT_LEN: u32 = 192 * 1024;

/// Offset of the image's length in the image.
pub const LENGTH_AT: usize = 0x1C;
