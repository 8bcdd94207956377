//! Persistent settings: a log of records in two pages of flash, over a small trait of the board. [`Slot`] is the trait of the
//! flash for updates.
//!
//! A save appends a record. If the newest record's page is full, or ends with other data, the other page is erased and
//! receives the record. So the page of the newest complete record is never erased. After a power cut at any time, the newest
//! complete record is either the old one or the new one. Leftovers are skipped, and removed by the next erase of their page.
//! Leftovers of an interrupted first save are no record: nothing is stored. The last double word of a record, which is
//! programmed last, distinguishes them from a damaged record. If that very double word of the only record is damaged, the
//! record counts as never completed.
//! A page receives its first record only after an erase in the same run, because a page that reads erased may be the result
//! of an interrupted erase.
//!
//! The caller defines the payload, and the handling of other versions.
//!
//! # Format
//! A record consists of little-endian double words of 64 bits:
//!
//! | double words | bits | content |
//! |---|---|---|
//! | first | 0 to 7 | A5h |
//! | | 8 to 23 | length of the payload in bytes |
//! | | 24 to 39 | version of the payload's format |
//! | | 40 to 63 | number of the save; the newest record has the highest |
//! | as many as required | | payload, padded with FFh |
//! | last | 0 to 31 | CRC-32 (ISO-HDLC) of all previous double words, as bytes |
//! | | 32 to 63 | the inverted CRC |
//!
//! # Wear
//! A record of `len` bytes occupies `2 + len / 8` double words, rounded up. A page of an STM32L4 has 256 double words and
//! endures 10 000 erases. Saving unchanged settings writes nothing, except after an interrupted save.
//!
//! | payload | records per page | erases per save | saves until both pages are worn |
//! |---|---|---|---|
//! | 120 bytes | 15 | 1/15 | 300 000 |
//! | 200 bytes | 9 | 1/9 | 180 000 |

mod error;
mod flash;
mod record;
mod slot;
mod store;

pub use error::{FlashError, Unreadable};
pub use flash::{NoFlash, NorFlash, Page};
pub use record::ends_record;
pub use slot::{ImageVersion, SLOT_PAGE_LEN, Slot};
pub use store::{BeginError, LoadError, Progress, Record, SaveError, Store};
