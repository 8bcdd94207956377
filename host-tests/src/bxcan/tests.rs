//! Covers the model's strictness: rejected accesses, and flags that stay until cleared. The driver obeys these rules,
//! so no emulated image would detect a model without them. The last test covers the driver's interpretation of TSR.

use embedded_can::Id;
use wsg_b_l475e_iot01a::transmit_status::withdrawal;
use wsg_bridge_fw::can::Withdrawal;

use super::*;
use crate::can_controller::testing::{assert_recovers, receive};
use crate::can_controller::{BITS_TO_SYNCHRONISE, ErrorCode};

/// BTR for 500 kbit/s at 80 MHz with a sample point at 87.5 %.
const BTR_500: u32 = (10 - 1) | (13 - 1) << 16 | (2 - 1) << 20 | (2 - 1) << 24;

const TIR: [u32; MAILBOXES] = [0x180, 0x190, 0x1A0];

/// Filter registers: scale, activation, and the two registers of bank 0.
const FS1R: u32 = FILTERS + 0x0C;
const FA1R: u32 = FILTERS + 0x1C;
const BANK_0: [u32; 2] = [FILTERS + 0x40, FILTERS + 0x44];

/// Creates a controller in initialisation mode with one filter of this identifier and mask.
fn initialised(id: u32, mask: u32) -> Bxcan {
    let mut can = Bxcan::new(80_000_000);
    can.store(MCR, INRQ).unwrap();
    can.store(BTR, BTR_500).unwrap();
    for (offset, value) in [(FS1R, 1), (BANK_0[0], id), (BANK_0[1], mask), (FA1R, 1), (FILTERS, 0)] {
        can.store(offset, value).unwrap();
    }
    assert_eq!(can.violations(), [""; 0]);
    can
}

/// Creates a controller on the bus that accepts every message.
fn normal() -> Bxcan {
    let mut can = initialised(0, 0);
    can.store(MCR, 0).unwrap();
    can.idle(BITS_TO_SYNCHRONISE);
    assert!(can.takes_part());
    can
}

fn request(can: &mut Bxcan, mailbox: usize, id: u16) {
    can.store(TIR[mailbox] + 4, 0).unwrap();
    can.store(TIR[mailbox], u32::from(id) << 21 | 1).unwrap();
}

fn next(can: &Bxcan) -> Option<(usize, Id)> {
    can.next_transmission().map(|next| (next.mailbox, next.frame.id))
}

#[test]
fn modes_are_entered_in_their_order_and_time() {
    let mut can = Bxcan::new(80_000_000);
    can.store(MCR, SLEEP | INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (INAK | SLAK), SLAK, "SLEEP is still set");

    let mut can = initialised(0, 0);
    request(&mut can, 0, 1);
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert_eq!((can.next_transmission(), can.load(RF0R).unwrap()), (None, 0), "not on the bus");
    can.store(MCR, 0).unwrap();
    can.idle(BITS_TO_SYNCHRONISE - 1);
    assert!(!can.takes_part());
    can.idle(1);
    assert!(can.takes_part());

    can.begin_transmission(0);
    can.store(MCR, INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (INAK | TXM), TXM, "the frame completes first");
    can.end_transmission(0);
    assert_eq!(can.load(MSR).unwrap() & (INAK | TXM), INAK);
}

#[test]
fn registers_in_use_take_no_store_and_record_a_violation() {
    for register in [BTR, TIR[0], TIR[0] + 8, BANK_0[0], FS1R] {
        let mut can = normal();
        request(&mut can, 0, 0x100);
        let before = can.load(register).unwrap();
        can.store(register, 0x40).unwrap();
        assert_eq!((can.load(register).unwrap(), can.violations().len()), (before, 1), "{register:#X}");
    }
    let mut can = normal();
    can.store(FIFO_0, 0).unwrap();
    assert_eq!(can.violations().len(), 1, "a FIFO is read-only");
}

#[test]
fn filter_passes_no_other_identifier_kind_or_remote_frame() {
    let mut can = initialised(0x120 << 21, 0x7FF << 21 | 0b110);
    let passes = |can: &Bxcan, frame: WireFrame| can.filters.pass(&frame).is_some();
    assert!(passes(&can, WireFrame::standard(0x120, &[])));
    for other in [
        WireFrame::standard(0x121, &[]),
        WireFrame::standard(0x120, &[]).remote(),
        WireFrame::extended(0x120 << 18, &[]),
    ] {
        assert!(!passes(&can, other), "{other:?}");
    }
    can.store(FILTERS, 1).unwrap();
    assert!(!passes(&can, WireFrame::standard(0x120, &[])), "reception is off while filters are initialised");
}

#[test]
fn flags_stay_until_they_are_cleared() {
    let mut can = normal();
    can.store(IER, TMEIE | FMPIE0).unwrap();
    request(&mut can, 1, 0x100);
    can.begin_transmission(1);
    can.end_transmission(1);
    assert_eq!((can.load(TSR).unwrap() & 0xFFFF, can.interrupts()), (0x0300, [true, false]));
    can.store(TSR, 1 << 8).unwrap();
    assert_eq!((can.load(TSR).unwrap() & 0xFFFF, can.interrupts()), (0, [false, false]));

    for id in 1..=4 {
        receive(&mut can, &WireFrame::standard(id, &[]));
    }
    let mut ids = Vec::new();
    while can.interrupts()[1] {
        ids.push(can.load(FIFO_0).unwrap() >> 21);
        can.store(RF0R, 1 << 5).unwrap();
    }
    assert_eq!(ids, [1, 2, 4], "a fourth message takes the place of the third");
    assert_eq!(can.load(RF0R).unwrap(), 0b11000, "FULL and FOVR");
    can.store(RF0R, 0b11000).unwrap();
    assert_eq!(can.load(RF0R).unwrap(), 0);
}

#[test]
fn bus_off_ends_only_after_initialisation_and_recessive_bits() {
    let mut can = normal();
    request(&mut can, 0, 1);
    let rejoin = |can: &mut Bxcan| {
        assert_eq!(can.load(ESR).unwrap() & 0b111, 0b111);
        can.store(MCR, INRQ).unwrap();
        can.store(MCR, 0).unwrap();
    };
    assert_recovers(&mut can, rejoin, RECOVERY);
    assert_eq!(can.load(ESR).unwrap() & 0b111, 0);
}

#[test]
fn abort_leaves_the_other_mailboxes_alone() {
    let mut can = normal();
    can.store(TSR, 1 << 7 | 1 << 15 | 1 << 23).unwrap();
    assert_eq!(can.load(TSR).unwrap(), 0x1C00_0000, "nothing to abort");
    for mailbox in 0..MAILBOXES {
        request(&mut can, mailbox, 0x100 + mailbox as u16);
    }
    can.store(TSR, 1 << 7).unwrap();
    assert_eq!(next(&can), Some((1, WireFrame::standard(0x101, &[]).id)));
    assert_eq!(can.load(TSR).unwrap() & 0x1C00_0000, 1 << 26);
}

#[test]
fn the_driver_reads_the_outcome_of_an_abort_from_tsr() {
    for mailbox in 0..MAILBOXES {
        let abort = 1 << (7 + 8 * mailbox);
        let mut can = normal();
        let outcome = |can: &mut Bxcan| withdrawal(can.load(TSR).unwrap(), mailbox);
        // The previous frame left TXOK set.
        request(&mut can, mailbox, 0x120);
        can.begin_transmission(mailbox);
        can.end_transmission(mailbox);
        request(&mut can, mailbox, 0x120);
        can.store(TSR, abort).unwrap();
        assert_eq!(outcome(&mut can), Withdrawal::Withdrawn, "not begun");

        for (is_acknowledged, expected) in [(true, Withdrawal::TooLate), (false, Withdrawal::Withdrawn)] {
            request(&mut can, mailbox, 0x120);
            can.begin_transmission(mailbox);
            can.store(TSR, abort).unwrap();
            assert_eq!(outcome(&mut can), Withdrawal::Undecided, "in transmission");
            if is_acknowledged {
                can.end_transmission(mailbox);
            } else {
                can.fail_transmission(mailbox, ErrorCode::Acknowledgement);
            }
            assert_eq!(outcome(&mut can), expected);
            assert_eq!(can.next_transmission(), None, "not repeated");
        }

        // The message is sent just before the abort.
        request(&mut can, mailbox, 0x120);
        can.begin_transmission(mailbox);
        can.end_transmission(mailbox);
        can.store(TSR, abort).unwrap();
        assert_eq!(outcome(&mut can), Withdrawal::TooLate);
    }
}
