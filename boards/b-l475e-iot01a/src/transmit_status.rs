//! What TSR of bxCAN reports of the three transmit mailboxes (RM0351, 46.9.2).

use wsg_bridge_fw::can::Withdrawal;

/// Transmit mailboxes.
pub const MAILBOXES: usize = 3;

/// Whether mailboxes 0, 1 and 2 are empty.
pub const TME: [u32; MAILBOXES] = [1 << 26, 1 << 27, 1 << 28];

/// Whether the last frame of each mailbox was sent. A new request clears it, and so does the driver with RQCP.
const TXOK: [u32; MAILBOXES] = [1 << 1, 1 << 9, 1 << 17];

/// Returns the outcome for a mailbox whose frame was requested and then aborted by ABRQ, by TSR's value after that.
#[must_use]
pub fn withdrawal(tsr: u32, mailbox: usize) -> Withdrawal {
    let has = |bits: [u32; MAILBOXES]| bits.get(mailbox).is_some_and(|bit| tsr & bit != 0);
    Withdrawal::of(!has(TME), has(TXOK))
}
