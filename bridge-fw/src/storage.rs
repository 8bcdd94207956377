//! Settings that survive power-off: a log of records in two pages of flash, over a small trait of the board.
//!
//! A save appends a record. When the page that holds the newest record is full, or has anything but records at its end,
//! the other page is erased and takes the record; so the newest whole record is never in the page that is erased. After
//! a power cut at any moment the newest whole record is either the old one or the new one. Leftovers are passed over,
//! and go with the next erase of their page. A page takes its first record only after an erase in the same run, for one
//! that reads erased may be what a power cut left of an erase.
//!
//! What is in a payload, and what to do with another version of it, is the caller's concern.
//!
//! # Format
//! A record is made of double words of 64 bits, each little-endian:
//!
//! | double words | bits | holds |
//! |---|---|---|
//! | first | 0 to 7 | A5h |
//! | | 8 to 23 | length of the payload in bytes |
//! | | 24 to 39 | version of the payload's format |
//! | | 40 to 63 | number of the save; the highest one is the newest record |
//! | as many as it takes | | payload, filled up with FFh |
//! | last | 0 to 31 | CRC-32 (ISO-HDLC) over all double words before, as bytes |
//! | | 32 to 63 | the same, inverted |
//!
//! # Wear
//! A record of `len` bytes takes `2 + len / 8` double words, rounded up. STM32L4: 256 double words a page, and each of the
//! two pages endures 10 000 erases. A save of what is stored already writes nothing.
//!
//! | payload | records in a page | erases per save | saves until both pages are worn |
//! |---|---|---|---|
//! | 120 bytes | 15 | 1/15 | 300 000 |
//! | 200 bytes | 9 | 1/9 | 180 000 |

mod flash;
mod record;
mod store;

pub use flash::{FlashError, NoFlash, NorFlash, Page, Unreadable};
pub use store::{BeginError, LoadError, Progress, Record, SaveError, Store};
