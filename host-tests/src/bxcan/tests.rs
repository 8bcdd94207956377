use embedded_can::Id;
use wsg_b_l475e_iot01a::transmit_status::{TME, withdrawal};
use wsg_bridge_fw::can::Withdrawal;

use super::*;

/// Fields of BTR for 500 kbit/s at 80 MHz with a sample point at 87.5 %.
const BTR_500: u32 = (10 - 1) | (13 - 1) << 16 | (2 - 1) << 20 | (2 - 1) << 24;

const TIR: [u32; MAILBOXES] = [0x180, 0x190, 0x1A0];

const NEVER: u32 = 0;

/// A controller in initialisation mode.
fn initialised() -> Bxcan {
    let mut can = Bxcan::new(80_000_000);
    can.store(MCR, INRQ).unwrap();
    can.store(BTR, BTR_500).unwrap();
    can
}

/// A controller on the bus that takes every message into FIFO 0.
fn normal() -> Bxcan {
    let mut can = initialised();
    filter(&mut can, 0, &[(0x1C, 1), (0x0C, 1), (0x40, 0), (0x44, 0)]);
    can.store(MCR, NEVER).unwrap();
    can.idle(11);
    assert!(can.takes_part());
    can
}

/// Stores to the filters' registers, by their offsets from FMR.
fn filter(can: &mut Bxcan, fifo_1: u32, stores: &[(u32, u32)]) {
    can.store(FILTERS, 1).unwrap();
    can.store(FILTERS + 0x14, fifo_1).unwrap();
    for (offset, value) in stores {
        can.store(FILTERS + offset, *value).unwrap();
    }
    can.store(FILTERS, 0).unwrap();
    assert_eq!(can.violations(), [""; 0]);
}

fn request(can: &mut Bxcan, mailbox: usize, id: u16) {
    can.store(TIR[mailbox] + 4, 0).unwrap();
    can.store(TIR[mailbox], u32::from(id) << 21 | 1).unwrap();
}

fn next(can: &Bxcan) -> Option<(usize, Id)> {
    can.next_transmission().map(|next| (next.mailbox, next.frame.id))
}

fn standard(id: u16) -> Id {
    WireFrame::standard(id, &[]).id
}

fn receive(can: &mut Bxcan, frame: &WireFrame) {
    can.begin_reception(None);
    can.end_reception(frame);
}

fn fail(can: &mut Bxcan, times: usize, why: ErrorCode) {
    for _ in 0..times {
        let mailbox = can.next_transmission().unwrap().mailbox;
        can.begin_transmission(mailbox);
        can.fail_transmission(mailbox, why);
    }
}

// Modes (46.4).

#[test]
fn reset_leaves_it_asleep() {
    let mut can = Bxcan::new(80_000_000);
    let values =
        [(MCR, 0x0001_0002), (MSR, 0x0C02), (TSR, 0x1C00_0000), (BTR, 0x0123_0000), (0x200, 0x2A1C_0E01)];
    for (offset, value) in values {
        assert_eq!(can.load(offset).unwrap(), value, "{offset:#X}");
    }
    assert!(!can.takes_part());
}

#[test]
fn sleep_is_not_left_while_sleep_is_asked_for() {
    let mut can = Bxcan::new(80_000_000);
    can.store(MCR, SLEEP | INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (INAK | SLAK), SLAK);
    can.store(MCR, INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (INAK | SLAK), INAK);
}

#[test]
fn it_takes_part_after_eleven_recessive_bits() {
    let mut can = initialised();
    can.store(MCR, NEVER).unwrap();
    can.idle(10);
    assert!(!can.takes_part());
    assert_eq!(can.load(MSR).unwrap() & INAK, INAK);
    can.idle(1);
    assert!(can.takes_part());
    assert_eq!(can.load(MSR).unwrap() & INAK, 0);
}

#[test]
fn a_frame_under_way_goes_on_to_its_end_before_initialisation() {
    let mut can = normal();
    request(&mut can, 0, 1);
    can.begin_transmission(0);
    can.store(MCR, INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (INAK | TXM), TXM);
    can.end_transmission(0);
    assert_eq!(can.load(MSR).unwrap() & (INAK | TXM), INAK);
    assert_eq!(can.load(TSR).unwrap() & 0b11, 0b11, "it was sent");
}

#[test]
fn nothing_is_sent_or_heard_outside_of_normal_mode() {
    let mut can = initialised();
    request(&mut can, 0, 1);
    assert_eq!(can.next_transmission(), None);
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert_eq!(can.load(RF0R).unwrap(), 0);
}

#[test]
fn entering_sleep_and_waking_up_are_told() {
    let mut can = normal();
    can.store(IER, SLKIE | WKUIE).unwrap();
    can.store(MCR, SLEEP | AWUM).unwrap();
    assert_eq!(can.load(MSR).unwrap() & (SLAK | SLAKI), SLAK | SLAKI);
    assert!(can.interrupts()[3]);
    can.store(MSR, SLAKI).unwrap();
    assert!(!can.interrupts()[3]);
    can.begin_reception(None);
    assert!(can.interrupts()[3], "WKUI");
    can.end_reception(&WireFrame::standard(1, &[]));
    assert!(can.takes_part(), "AWUM cleared SLEEP");
    assert_eq!(can.load(RF0R).unwrap(), 0, "the frame that woke it is lost");
}

#[test]
fn master_reset_forgets_all_but_the_filters() {
    let mut can = normal();
    request(&mut can, 0, 1);
    can.store(MCR, RESET).unwrap();
    assert_eq!((can.load(MCR).unwrap(), can.load(MSR).unwrap()), (DBF | SLEEP, 0xC02));
    assert_eq!(can.load(TSR).unwrap(), 0x1C00_0000);
    assert_eq!(can.load(0x21C).unwrap(), 1);
}

// Bit timing (46.7.7).

#[test]
fn the_rate_and_the_sample_point_are_those_of_btr() {
    let can = initialised();
    let timing = BitTiming { rate: 500_000, sample_point: 875, jump: 2, quanta: 16 };
    assert_eq!(can.bit_timing(), timing);
}

#[test]
fn bit_timing_is_written_in_initialisation_alone() {
    let mut can = normal();
    can.store(BTR, 0).unwrap();
    assert_eq!(can.load(BTR).unwrap(), BTR_500);
    assert_eq!(can.violations().len(), 1);
}

// Transmission (46.7.1).

#[test]
fn a_message_leaves_as_it_was_written() {
    let mut can = normal();
    can.store(TIR[1] + 4, 3).unwrap();
    can.store(TIR[1] + 8, 0x4433_2211).unwrap();
    can.store(TIR[1], 0x1234_5678 << 3 | IDE_AND_REQUEST).unwrap();
    let frame = can.next_transmission().unwrap().frame;
    assert_eq!(frame, WireFrame::extended(0x1234_5678, &[0x11, 0x22, 0x33]));
}

const IDE_AND_REQUEST: u32 = 0b101;

#[test]
fn a_remote_frame_has_a_length_and_no_data() {
    let mut can = normal();
    can.store(TIR[0] + 4, 5).unwrap();
    can.store(TIR[0], 0x120 << 21 | 0b011).unwrap();
    let frame = can.next_transmission().unwrap().frame;
    assert_eq!((frame.is_remote, frame.dlc, frame.payload()), (true, 5, &[][..]));
}

#[test]
fn the_lowest_identifier_leaves_first_and_of_equal_ones_the_lower_mailbox() {
    let mut can = normal();
    request(&mut can, 0, 0x200);
    request(&mut can, 1, 0x100);
    request(&mut can, 2, 0x100);
    assert_eq!(next(&can), Some((1, standard(0x100))));
    can.begin_transmission(1);
    can.end_transmission(1);
    assert_eq!(next(&can), Some((2, standard(0x100))));
}

#[test]
fn with_txfp_the_first_request_leaves_first() {
    let mut can = normal();
    can.store(MCR, TXFP).unwrap();
    request(&mut can, 2, 0x300);
    request(&mut can, 0, 0x200);
    request(&mut can, 1, 0x100);
    assert_eq!(next(&can), Some((2, standard(0x300))));
    can.begin_transmission(2);
    can.end_transmission(2);
    assert_eq!(next(&can), Some((0, standard(0x200))));
}

#[test]
fn status_names_the_next_free_mailbox_and_the_last_to_leave() {
    let mut can = normal();
    let code_and_low = |can: &mut Bxcan| (can.load(TSR).unwrap() >> 24 & 0b11, can.load(TSR).unwrap() >> 29);
    assert_eq!(code_and_low(&mut can), (0, 0));
    request(&mut can, 0, 0x100);
    assert_eq!(code_and_low(&mut can), (1, 0), "one alone is not the last");
    request(&mut can, 1, 0x300);
    assert_eq!(code_and_low(&mut can), (2, 0b010));
    request(&mut can, 2, 0x200);
    assert_eq!(code_and_low(&mut can), (1, 0b010), "none is free: the last to leave");
    assert_eq!(can.load(TSR).unwrap() >> 26 & 0b111, 0);
}

#[test]
fn a_mailbox_that_is_not_empty_is_protected() {
    let mut can = normal();
    request(&mut can, 0, 0x100);
    request(&mut can, 0, 0x200);
    assert_eq!(next(&can), Some((0, standard(0x100))));
    assert_eq!(can.violations().len(), 2);
}

#[test]
fn a_message_that_was_sent_is_told_until_that_is_cleared() {
    let mut can = normal();
    can.store(IER, TMEIE).unwrap();
    request(&mut can, 1, 0x100);
    assert!(!can.interrupts()[0]);
    can.begin_transmission(1);
    can.end_transmission(1);
    assert!(can.interrupts()[0]);
    assert_eq!(can.load(TSR).unwrap(), 0x1C00_0300);
    can.store(TSR, 1 << 8).unwrap();
    assert_eq!(can.load(TSR).unwrap(), 0x1C00_0000);
    assert!(!can.interrupts()[0]);
    request(&mut can, 1, 0x100);
    can.begin_transmission(1);
    can.end_transmission(1);
    request(&mut can, 1, 0x100);
    assert!(!can.interrupts()[0], "a request clears it as well");
}

#[test]
fn a_message_is_aborted_at_once_unless_it_is_being_sent() {
    let mut can = normal();
    request(&mut can, 0, 0x100);
    request(&mut can, 1, 0x200);
    can.begin_transmission(0);
    can.store(TSR, 1 << 7 | 1 << 15).unwrap();
    assert_eq!(can.load(TSR).unwrap() & 0xFFFF, 0x0180, "mailbox 1: RQCP without TXOK");
    can.end_transmission(0);
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b11, "it was sent all the same");

    request(&mut can, 0, 0x100);
    can.begin_transmission(0);
    can.store(TSR, 1 << 7).unwrap();
    can.fail_transmission(0, ErrorCode::BitDominant);
    assert_eq!(can.next_transmission(), None, "and not tried again when it failed");
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b1001);
}

#[test]
fn what_became_of_an_aborted_message_is_read_from_tsr_by_the_driver() {
    for mailbox in 0..MAILBOXES {
        let abort = 1 << (7 + 8 * mailbox);
        let mut can = normal();
        let outcome = |can: &mut Bxcan| withdrawal(can.load(TSR).unwrap(), mailbox);
        // Of the frame before it was said that it was sent.
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
            assert_eq!(outcome(&mut can), Withdrawal::Undecided, "being sent");
            if is_acknowledged {
                can.end_transmission(mailbox);
            } else {
                can.fail_transmission(mailbox, ErrorCode::Acknowledgement);
            }
            assert_eq!(outcome(&mut can), expected);
            assert_eq!(can.next_transmission(), None, "not repeated");
        }

        // It is sent just before it is aborted.
        request(&mut can, mailbox, 0x120);
        can.begin_transmission(mailbox);
        can.end_transmission(mailbox);
        can.store(TSR, abort).unwrap();
        assert_eq!(outcome(&mut can), Withdrawal::TooLate);
    }
}

#[test]
fn an_abort_leaves_the_other_mailboxes_alone() {
    let mut can = normal();
    for mailbox in 0..MAILBOXES {
        request(&mut can, mailbox, 0x100 + mailbox as u16);
    }
    can.store(TSR, 1 << 7).unwrap();
    assert_eq!(next(&can), Some((1, standard(0x101))));
    assert_eq!(can.load(TSR).unwrap() & TME.iter().sum::<u32>(), TME[0]);
}

#[test]
fn an_abort_of_an_empty_mailbox_does_nothing() {
    let mut can = normal();
    can.store(TSR, 1 << 7 | 1 << 15 | 1 << 23).unwrap();
    assert_eq!(can.load(TSR).unwrap(), 0x1C00_0000);
}

#[test]
fn what_fails_or_loses_is_tried_again_and_the_reason_told() {
    let mut can = normal();
    request(&mut can, 0, 0x100);
    can.begin_reception(Some(0));
    can.end_reception(&WireFrame::standard(1, &[]));
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b0100, "ALST");
    fail(&mut can, 1, ErrorCode::BitDominant);
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b1000, "TERR");
    assert_eq!(next(&can), Some((0, standard(0x100))));
}

#[test]
fn with_nart_it_is_tried_once() {
    let mut can = normal();
    can.store(MCR, NART).unwrap();
    request(&mut can, 0, 0x100);
    can.begin_reception(Some(0));
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b0101, "ALST");
    can.end_reception(&WireFrame::standard(1, &[]));
    request(&mut can, 0, 0x100);
    fail(&mut can, 1, ErrorCode::Acknowledgement);
    assert_eq!(can.load(TSR).unwrap() & 0xFF, 0b1001, "TERR");
    assert_eq!(can.next_transmission(), None);
}

// Reception (46.7.3).

#[test]
fn a_message_shows_in_the_registers_of_its_fifo_until_it_is_released() {
    let mut can = normal();
    receive(&mut can, &WireFrame::standard(0x123, &[1, 2, 3, 4, 5]));
    receive(&mut can, &WireFrame::extended(0x1234_5678, &[]).remote());
    assert_eq!(can.load(RF0R).unwrap(), 2);
    let registers = |can: &mut Bxcan| [0, 4, 8, 12].map(|at| can.load(FIFO_0 + at).unwrap());
    assert_eq!(registers(&mut can), [0x123 << 21, 5, 0x0403_0201, 5]);
    can.store(RF0R, 1 << 5).unwrap();
    assert_eq!(can.load(RF0R).unwrap(), 1);
    assert_eq!(registers(&mut can), [0x1234_5678 << 3 | 0b110, 0, 0, 0]);
    can.store(RF0R, 1 << 5).unwrap();
    can.store(RF0R, 1 << 5).unwrap();
    assert_eq!(can.load(RF0R).unwrap(), 0);
}

#[test]
fn a_fourth_message_takes_the_place_of_the_third_and_sets_overrun() {
    let mut can = normal();
    for id in 1..=4 {
        receive(&mut can, &WireFrame::standard(id, &[]));
    }
    assert_eq!(can.load(RF0R).unwrap(), 0b11011);
    let mut ids = Vec::new();
    for _ in 0..3 {
        ids.push(can.load(FIFO_0).unwrap() >> 21);
        can.store(RF0R, 1 << 5).unwrap();
    }
    assert_eq!(ids, [1, 2, 4]);
    assert_eq!(can.load(RF0R).unwrap(), 0b11000, "FULL and FOVR stay until they are cleared");
    can.store(RF0R, 0b11000).unwrap();
    assert_eq!(can.load(RF0R).unwrap(), 0);
}

#[test]
fn with_rflm_a_fourth_message_is_lost() {
    let mut can = normal();
    can.store(MCR, RFLM).unwrap();
    for id in 1..=4 {
        receive(&mut can, &WireFrame::standard(id, &[]));
    }
    can.store(RF0R, 1 << 5).unwrap();
    can.store(RF0R, 1 << 5).unwrap();
    assert_eq!(can.load(FIFO_0).unwrap() >> 21, 3);
}

#[test]
fn a_fifo_has_three_interrupts() {
    let mut can = normal();
    receive(&mut can, &WireFrame::standard(1, &[]));
    for (enable, is_on) in [(1 << 1, true), (1 << 2, false), (1 << 3, false), (1 << 4, false)] {
        can.store(IER, enable).unwrap();
        assert_eq!(can.interrupts(), [false, is_on, false, false]);
    }
    for _ in 0..3 {
        receive(&mut can, &WireFrame::standard(1, &[]));
    }
    for enable in [1 << 2, 1 << 3] {
        can.store(IER, enable).unwrap();
        assert!(can.interrupts()[1]);
    }
}

// Filters (46.7.4).

/// Which FIFO, and the number of the filter.
fn passes(can: &Bxcan, frame: WireFrame) -> Option<(usize, u8)> {
    can.filters.pass(&frame)
}

#[test]
fn nothing_passes_without_a_filter_or_while_they_are_initialised() {
    let mut can = initialised();
    can.store(FILTERS, 0).unwrap();
    assert_eq!(passes(&can, WireFrame::standard(1, &[])), None);
    let mut can = normal();
    can.store(FILTERS, 1).unwrap();
    assert_eq!(passes(&can, WireFrame::standard(1, &[])), None);
}

#[test]
fn a_mask_of_32_bits_tells_identifier_kind_and_remote_apart() {
    let mut can = initialised();
    let mask = 0x7FF << 21 | 0b110;
    filter(&mut can, 0, &[(0x1C, 1), (0x0C, 1), (0x40, 0x120 << 21), (0x44, mask)]);
    assert_eq!(passes(&can, WireFrame::standard(0x120, &[])), Some((0, 0)));
    assert_eq!(passes(&can, WireFrame::standard(0x121, &[])), None);
    assert_eq!(passes(&can, WireFrame::standard(0x120, &[]).remote()), None);
    assert_eq!(passes(&can, WireFrame::extended(0x120 << 18, &[])), None);
}

#[test]
fn a_list_of_16_bits_holds_four_identifiers() {
    let mut can = initialised();
    let pair = |low: u32, high: u32| low << 5 | high << 21;
    filter(&mut can, 0, &[(0x1C, 1), (0x04, 1), (0x40, pair(1, 2)), (0x44, pair(3, 4))]);
    for id in 1..=4 {
        assert_eq!(passes(&can, WireFrame::standard(id, &[])), Some((0, id as u8 - 1)));
    }
    assert_eq!(passes(&can, WireFrame::standard(5, &[])), None);
}

#[test]
fn wide_filters_go_before_narrow_ones_lists_before_masks_and_low_numbers_before_high_ones() {
    let mut can = initialised();
    // Bank 0: two masks of 16 bits. 1: a mask of 32. 2: a list of 32. 3: the same in FIFO 1. Each takes 120h.
    let (narrow, wide) = (0x120 << 5 | 0xFFE0_0000, 0x120 << 21);
    let banks =
        [(0x40, narrow), (0x44, narrow), (0x48, wide), (0x4C, !1), (0x50, 7), (0x54, wide), (0x58, wide)];
    let modes = [(0x04, 0b1100), (0x0C, 0b1110)];
    let take = |can: &mut Bxcan, active: u32| {
        filter(can, 0b1000, &[&modes[..], &banks[..], &[(0x1C, active)]].concat());
        passes(can, WireFrame::standard(0x120, &[]))
    };
    assert_eq!(take(&mut can, 0b0001), Some((0, 0)));
    assert_eq!(take(&mut can, 0b0011), Some((0, 2)), "the two of bank 0 come first");
    assert_eq!(take(&mut can, 0b0111), Some((0, 4)), "the second of its bank");
    assert_eq!(take(&mut can, 0b1111), Some((1, 0)), "FIFO 1 counts for itself");
    assert_eq!(take(&mut can, 0b0100), Some((0, 4)), "filters count that are not active");
}

#[test]
fn filters_in_use_are_protected() {
    let mut can = normal();
    can.store(FILTERS + 0x40, 5).unwrap();
    can.store(FILTERS + 0x0C, 0).unwrap();
    assert_eq!(can.violations().len(), 2);
    assert_eq!((can.load(FILTERS + 0x40).unwrap(), can.load(FILTERS + 0x0C).unwrap()), (0, 1));
    can.store(FILTERS + 0x48, 5).unwrap();
    assert_eq!(can.load(FILTERS + 0x48).unwrap(), 5, "a bank that is not active is free");
}

// Errors (46.7.6).

fn counters(can: &mut Bxcan) -> (u32, u32, u32) {
    let esr = can.load(ESR).unwrap();
    (esr >> 16 & 0xFF, esr >> 24, esr & 0b111)
}

#[test]
fn a_lonely_controller_becomes_error_passive_and_goes_on_trying() {
    let mut can = normal();
    request(&mut can, 0, 1);
    fail(&mut can, 12, ErrorCode::Acknowledgement);
    assert_eq!(counters(&mut can), (96, 0, 0b001), "it warns");
    fail(&mut can, 3, ErrorCode::Acknowledgement);
    assert_eq!(counters(&mut can), (120, 0, 0b001));
    fail(&mut can, 1_000, ErrorCode::Acknowledgement);
    assert_eq!(counters(&mut can), (128, 0, 0b011));
    assert_eq!(can.load(ESR).unwrap() >> 4 & 0b111, 3);
    can.begin_transmission(0);
    can.end_transmission(0);
    assert_eq!(counters(&mut can), (127, 0, 0b001));
    assert_eq!(can.load(ESR).unwrap() >> 4 & 0b111, 0);
}

#[test]
fn receive_errors_make_it_error_passive_and_one_success_ends_that() {
    let mut can = normal();
    for _ in 0..300 {
        can.begin_reception(None);
        can.fail_reception(ErrorCode::Crc);
    }
    assert_eq!(counters(&mut can), (0, 255, 0b011));
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert_eq!(counters(&mut can), (0, 120, 0b001));
}

#[test]
fn bus_off_ends_after_init_was_entered_and_left_and_128_times_11_recessive_bits() {
    let mut can = normal();
    request(&mut can, 0, 1);
    fail(&mut can, 32, ErrorCode::BitDominant);
    assert_eq!(counters(&mut can), (0, 0, 0b111), "the lowest 8 bits of 256");
    assert_eq!(can.next_transmission(), None);
    can.idle(1_000_000);
    assert_eq!(counters(&mut can).2, 0b111, "not by itself");
    can.store(MCR, INRQ).unwrap();
    assert_eq!(can.load(MSR).unwrap() & INAK, INAK);
    can.store(MCR, NEVER).unwrap();
    can.idle(11);
    assert_eq!(can.load(MSR).unwrap() & INAK, 0);
    can.idle(127 * 11 - 1);
    assert_eq!(counters(&mut can).2, 0b111);
    can.idle(1);
    assert_eq!(counters(&mut can), (0, 0, 0));
    assert_eq!(next(&can), Some((0, standard(1))), "what was not aborted is sent now");
}

#[test]
fn with_abom_bus_off_ends_by_itself_and_frames_of_others_count() {
    let mut can = normal();
    can.store(MCR, ABOM).unwrap();
    request(&mut can, 0, 1);
    fail(&mut can, 32, ErrorCode::BitDominant);
    for _ in 0..126 {
        receive(&mut can, &WireFrame::standard(1, &[]));
    }
    assert!(!can.takes_part());
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert!(can.takes_part());
    assert_eq!(can.load(RF0R).unwrap(), 0, "they were not received");
}

#[test]
fn error_interrupts_have_an_enable_each_and_one_for_all() {
    for (enable, times, is_told) in
        [(1 << 8, 11, false), (1 << 8, 12, true), (1 << 9, 15, false), (1 << 9, 16, true)]
    {
        let mut can = normal();
        can.store(IER, ERRIE | enable).unwrap();
        request(&mut can, 0, 1);
        fail(&mut can, times, ErrorCode::BitDominant);
        assert_eq!(can.interrupts()[3], is_told, "{enable:#X} {times}");
    }
    let mut can = normal();
    can.store(IER, ERRIE | 1 << 10).unwrap();
    request(&mut can, 0, 1);
    fail(&mut can, 31, ErrorCode::BitDominant);
    assert!(!can.interrupts()[3]);
    fail(&mut can, 1, ErrorCode::BitDominant);
    assert!(can.interrupts()[3]);
    can.store(IER, 1 << 10).unwrap();
    assert!(!can.interrupts()[3], "ERRIE");
    can.store(IER, ERRIE).unwrap();
    can.store(MSR, ERRI).unwrap();
    assert!(!can.interrupts()[3]);
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut can = initialised();
    assert!(can.store(MCR, TTCM | INRQ).is_err());
    assert!(can.store(BTR, 1 << 30).is_err());
    assert!(can.load(0x20).is_err());
    assert!(can.store(FILTERS + 0xB0, 0).is_err());
}
