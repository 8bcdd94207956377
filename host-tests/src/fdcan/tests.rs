//! One test per rule of the manual. The driver obeys these rules, so no emulated image would detect a model without
//! them. Sections and pages refer to RM0440 Rev 4.

use super::transmit::{TC, TCF};
use super::*;

/// NBTP for 500 kbit/s at 24 MHz with a sample point at 87.5 %.
const NBTP_500: u32 = 2 << 25 | 1 << 16 | 19 << 8 | 2;

const QUEUE: (u32, u32) = (TXBC, TFQM);

/// Creates a controller with INIT, CCE and these registers stored.
fn configured(registers: &[(u32, u32)]) -> Fdcan {
    let mut can = Fdcan::new(HSE_HZ);
    for (offset, value) in [&[(CCCR, INIT | CCE), (NBTP, NBTP_500)][..], registers].concat() {
        can.store(offset, value).unwrap();
    }
    can
}

/// Creates a controller on the bus with these registers stored.
fn started(registers: &[(u32, u32)]) -> Fdcan {
    let mut can = configured(registers);
    let mode = can.cccr & !(INIT | CCE);
    can.store(CCCR, mode).unwrap();
    assert_eq!(load(&mut can, [CCCR; 2]), [mode | INIT, mode]);
    can.idle(11);
    assert!(can.takes_part() && can.violations().is_empty(), "{:?}", can.violations());
    can
}

fn load<const N: usize>(can: &mut Fdcan, offsets: [u32; N]) -> [u32; N] {
    offsets.map(|offset| can.load(offset).unwrap())
}

/// Stores to a register. Returns the number of violations.
fn store(can: &mut Fdcan, offset: u32, value: u32) -> usize {
    can.violations.clear();
    can.store(offset, value).unwrap();
    can.violations().len()
}

/// Requests the transmission of a frame without data. Returns the number of violations.
fn request(can: &mut Fdcan, buffer: usize, id: u32) -> usize {
    for (n, word) in [id << 18, 0].into_iter().enumerate() {
        store(can, ram(TX_BUFFERS + ELEMENT_WORDS * buffer + n), word);
    }
    store(can, TXBAR, 1 << buffer)
}

const fn ram(word: usize) -> u32 {
    RAM + 4 * word as u32
}

fn send(can: &mut Fdcan) -> usize {
    let mailbox = can.next_transmission().unwrap().mailbox;
    can.begin_transmission(mailbox);
    can.end_transmission(mailbox);
    mailbox
}

fn fail(can: &mut Fdcan, times: usize, why: ErrorCode) {
    for _ in 0..times {
        can.begin_transmission(0);
        can.fail_transmission(0, why);
    }
}

fn receive(can: &mut Fdcan, frame: &WireFrame) {
    can.begin_reception(None);
    can.end_reception(frame);
}

/// 44.4.1, .2, .6, .7, .12, .13, .20, .27: "Reset value".
#[test]
fn registers_have_their_reset_values() {
    let offsets = [0x00, 0x04, CCCR, NBTP, ECR, PSR, XIDAM, TXFQS];
    let values = [0x3214_1218, 0x8765_4321, 1, 0x0600_0A03, 0, 0x707, 0x1FFF_FFFF, 3];
    assert_eq!(load(&mut Fdcan::new(HSE_HZ), offsets), values);
}

/// 44.4.7 and 44.4.37.
#[test]
fn bit_timing_follows_from_clock_divider_and_nbtp() {
    let timing = BitTiming { rate: 500_000, sample_point: 875, jump: 3, quanta: 24 };
    assert_eq!(configured(&[]).bit_timing(), timing);
    assert_eq!(configured(&[(CKDIV, 2)]).bit_timing(), BitTiming { rate: 125_000, ..timing });
}

/// 44.4.6, note on INIT.
#[test]
fn init_must_read_back_before_it_changes_again() {
    let mut can = started(&[]);
    assert_eq!(store(&mut can, CCCR, INIT), 0);
    assert_eq!(store(&mut can, CCCR, 0), 1);
    assert_eq!(load(&mut can, [CCCR; 2]), [INIT, 0]);
    assert_eq!(store(&mut can, CCCR, INIT), 0);
}

/// 44.3.2, software initialization.
#[test]
fn cce_requires_init_and_is_cleared_with_it() {
    let mut can = started(&[]);
    assert_eq!(store(&mut can, CCCR, INIT | CCE), 1);
    assert_eq!(load(&mut can, [CCCR; 2]), [0, INIT]);
    assert_eq!(store(&mut can, CCCR, INIT | CCE), 0);
    assert_eq!(store(&mut can, CCCR, CCE), 0);
    assert_eq!(load(&mut can, [CCCR; 2]), [INIT, 0]);
}

/// 44.4: bits "(P)" are writable only when CCE and INIT are set; 44.4.6: so are DAR and, to set it, ASM.
#[test]
fn protected_registers_take_no_store_without_init_and_cce() {
    for offset in [0x0C, 0x14, NBTP, 0x20, 0x28, 0x48, RXGFC, XIDAM, TXBC, CKDIV] {
        let mut can = started(&[]);
        let before = can.registers.clone();
        assert_eq!((store(&mut can, offset, 1), &can.registers), (1, &before), "{offset:#X}");
    }
    for mode in [DAR, ASM] {
        let mut can = started(&[]);
        assert_eq!((store(&mut can, CCCR, mode), load(&mut can, [CCCR])), (1, [0]));
        assert_eq!(configured(&[(CCCR, INIT | CCE | mode)]).cccr, INIT | CCE | mode);
    }
    for offset in [IE, ILS, ILE, TXBTIE, TXBCIE] {
        let mut can = started(&[]);
        assert_eq!((store(&mut can, offset, 1), load(&mut can, [offset])), (0, [1]), "{offset:#X}");
    }
}

/// 44.3.2: registers that CCE resets, and registers that are writable only while it is cleared.
#[test]
fn cce_empties_fifos_and_requests_and_blocks_new_ones() {
    const STATUS: [u32; 4] = [RXF0S, TXBRP, TXBTO, TXBCF];
    let mut can = started(&[QUEUE]);
    receive(&mut can, &WireFrame::standard(1, &[]));
    for buffer in 0..ELEMENTS {
        request(&mut can, buffer, 0x100);
    }
    send(&mut can);
    store(&mut can, TXBCR, 0b10);
    assert_eq!(load(&mut can, STATUS), [1 << 16 | 1, 0b100, 0b001, 0b010]);
    store(&mut can, CCCR, INIT);
    load(&mut can, [CCCR; 2]);
    assert_eq!(load(&mut can, STATUS)[1], 0b100, "INIT alone keeps requests");
    store(&mut can, CCCR, INIT | CCE);
    assert_eq!((store(&mut can, TXBAR, 1), store(&mut can, TXBCR, 1)), (1, 1));
    assert_eq!(load(&mut can, STATUS), [0; 4]);
}

/// 44.3.2, power-down.
#[test]
fn clock_stop_waits_for_requests_and_holds_init() {
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    store(&mut can, CCCR, CSR);
    assert_eq!(load(&mut can, [CCCR]), [CSR]);
    send(&mut can);
    assert_eq!(load(&mut can, [CCCR]), [CSR | CSA | INIT]);
    assert_eq!((store(&mut can, CCCR, 0), load(&mut can, [CCCR])), (1, [INIT]));
    assert_eq!((store(&mut can, CCCR, 0), load(&mut can, [CCCR; 2])), (0, [INIT, 0]));
}

/// Returns the FIFO that a frame reaches, with these words of the message RAM.
fn fifo_of(registers: &[(u32, u32)], words: &[(usize, u32)], frame: &WireFrame) -> Option<usize> {
    let words = words.iter().map(|&(at, word)| (ram(at), word)).collect::<Vec<_>>();
    let mut can = started(&[registers, &words[..]].concat());
    receive(&mut can, frame);
    can.fifos.iter().position(|fifo| fifo.fill == 1)
}

/// 44.3.3, acceptance filter (page 1960); 44.3.8 (pages 1972 and 1973).
#[test]
fn standard_filters_select_by_type_action_and_order() {
    let word = |kind: u32, action: u32, id: u32, other: u32| kind << 30 | action << 27 | id << 16 | other;
    let any = word(0, 2, 0, 0x7FF);
    for (filters, id, fifo) in [
        ([word(0, 1, 0x100, 0x110), 0], 0x110, Some(0)),
        ([word(0, 2, 0x100, 0x110), 0], 0x100, Some(1)),
        ([word(0, 1, 0x100, 0x110), 0], 0x111, None),
        ([word(1, 1, 0x100, 0x110), 0], 0x110, Some(0)),
        ([word(1, 1, 0x100, 0x110), 0], 0x105, None),
        ([word(2, 1, 0x100, 0x7F0), 0], 0x10F, Some(0)),
        ([word(2, 1, 0x100, 0x7F0), 0], 0x110, None),
        ([word(3, 1, 0x100, 0x100), any], 0x100, Some(1)),
        ([word(1, 0, 0x100, 0x100), any], 0x100, Some(1)),
        ([word(1, 7, 0x100, 0x100), any], 0x100, Some(1)),
        ([word(1, 3, 0x100, 0x100), any], 0x100, None),
        ([word(1, 4, 0x100, 0x100), any], 0x100, None),
        ([word(1, 5, 0x100, 0x100), any], 0x100, Some(0)),
        ([word(1, 6, 0x100, 0x100), 0], 0x100, Some(1)),
        ([any, word(1, 3, 0x100, 0x100)], 0x100, Some(1)),
    ] {
        let words = [(0, filters[0]), (1, filters[1])];
        let config = (RXGFC, 2 << 16 | 0b10 << 4);
        let found = fifo_of(&[config], &words, &WireFrame::standard(id, &[]));
        assert_eq!(found, fifo, "{filters:X?} {id:#X}");
    }
}

/// 44.3.3 (pages 1960 and 1962); 44.3.9 (page 1973); 44.4.20.
#[test]
fn extended_filters_apply_xidam_except_type_3() {
    for (kind, first, second, fifo) in [
        (0, 0x1_2300, 0x1_2300, Some(0)),
        (1, 0, 0x1_2300, Some(0)),
        (2, 0x1_2300, 0x1FFF_FFFF, Some(0)),
        (3, 0x1_2300, 0x1_2300, None),
        (3, 0x1_23AB, 0x1_23AB, Some(0)),
        (0, 0x1_23AB, 0x1_23AB, None),
    ] {
        let config = [(RXGFC, 1 << 24 | 0b10 << 2), (XIDAM, 0x1FFF_FF00)];
        let words = [(EXTENDED_FILTERS, 1 << 29 | first), (EXTENDED_FILTERS + 1, kind << 30 | second)];
        let found = fifo_of(&config, &words, &WireFrame::extended(0x1_23AB, &[]));
        assert_eq!(found, fifo, "{kind} {first:#X} {second:#X}");
    }
}

/// 44.4.19; 44.3.3, figures of the filter paths (page 1962).
#[test]
fn rxgfc_decides_on_remote_frames_and_frames_without_a_match() {
    let (standard, extended) = (WireFrame::standard(1, &[]), WireFrame::extended(1, &[]));
    for (config, frame, fifo) in [
        (0, standard, Some(0)),
        (0b01 << 4, standard, Some(1)),
        (0b10 << 4, standard, None),
        (0b11 << 4, standard, None),
        (0b11 << 4, extended, Some(0)),
        (0b01 << 2, extended, Some(1)),
        (0b10 << 2, extended, None),
        (0b11 << 2, standard, Some(0)),
        (0b10, standard.remote(), None),
        (0b10, extended.remote(), Some(0)),
        (0b10, standard, Some(0)),
        (0b01, extended.remote(), None),
        (0b01, standard.remote(), Some(0)),
    ] {
        assert_eq!(fifo_of(&[(RXGFC, config)], &[], &frame), fifo, "{config:#b} {frame:?}");
    }
}

/// 44.3.5.
#[test]
fn received_elements_have_rubbish_in_unused_bits() {
    let mut can = started(&[(RXGFC, 1 << 16), (ram(0), 1 << 27 | 0x100 << 16 | 0x1FF)]);
    receive(&mut can, &WireFrame::standard(0x123, &[1, 2, 3]));
    receive(&mut can, &WireFrame::extended(0x123_4567, &[0; 8]).remote());
    let [r0, r1, r2] = load(&mut can, [0, 1, 2].map(|n| ram(RX_FIFOS + n)));
    assert_eq!((r0 & !0x3_FFFF, r1 & !0xC0_0000, r2 & 0xFF_FFFF), (0x123 << 18, 3 << 16, 0x03_0201));
    assert!(r0 & 0x3_FFFF != 0 && r2 >> 24 != 0);
    let [r0, r1] = load(&mut can, [18, 19].map(|n| ram(RX_FIFOS + n)));
    assert_eq!((r0, r1 & 0x803F_FFFF), (XTD | RTR | 0x123_4567, 1 << 31 | 8 << 16));
}

/// 44.3.3, Rx FIFO blocking mode; 44.3.4; 44.4.22; 44.4.23.
#[test]
fn a_full_fifo_loses_messages_until_elements_are_acknowledged() {
    for (number, config, status, acknowledge) in [(0, 0, RXF0S, RXF0A), (1, 0b01 << 4, RXF1S, RXF1A)] {
        let mut can = started(&[(RXGFC, config)]);
        (1..=4).for_each(|id| receive(&mut can, &WireFrame::standard(id, &[])));
        assert_eq!(load(&mut can, [status, IR]), [1 << 25 | 1 << 24 | 3, 0b111 << (3 * number)]);
        store(&mut can, IR, RF0L << (3 * number));
        assert_eq!(load(&mut can, [status]), [1 << 24 | 3], "RFnL is a copy");
        assert_eq!((store(&mut can, acknowledge, 1), load(&mut can, [status])), (0, [2 << 8 | 1]));
        for empty in [0, 1, 3] {
            assert_eq!((store(&mut can, acknowledge, empty), load(&mut can, [status])), (1, [2 << 8 | 1]));
        }
        assert_eq!(load(&mut can, [ram(RX_FIFOS + 54 * number + 36)])[0] >> 18, 3);
    }
}

/// 44.3.3, Rx FIFO overwrite mode.
#[test]
fn a_full_fifo_in_overwrite_mode_drops_its_oldest_message() {
    for (config, status) in [(F0OM, RXF0S), (F0OM >> 1 | 0b01 << 4, RXF1S)] {
        let mut can = started(&[(RXGFC, config)]);
        (1..=4).for_each(|id| receive(&mut can, &WireFrame::standard(id, &[])));
        assert_eq!(load(&mut can, [status]), [1 << 24 | 1 << 16 | 1 << 8 | 3]);
    }
}

/// 44.3.3, Tx FIFO and Tx queue; 44.4.27.
#[test]
fn queue_sends_lowest_identifier_and_fifo_oldest_request() {
    for (mode, ids, order, status) in [
        (TFQM, [0x300, 0x200, 0x100], [2, 1, 0], [0, 1 << 16, 1 << 21]),
        (TFQM, [0x100; 3], [0, 1, 2], [0, 1 << 16, 1 << 21]),
        (0, [0x300, 0x200, 0x100], [0, 1, 2], [3, 1 << 16 | 2, 1 << 21]),
    ] {
        let mut can = started(&[(TXBC, mode)]);
        assert_eq!(load(&mut can, [TXFQS])[0], status[0]);
        request(&mut can, 0, ids[0]);
        assert_eq!(load(&mut can, [TXFQS])[0], status[1]);
        assert_eq!((request(&mut can, 1, ids[1]), request(&mut can, 2, ids[2])), (0, 0));
        assert_eq!(load(&mut can, [TXFQS])[0], status[2]);
        assert_eq!(order.map(|_| send(&mut can)), order);
    }
}

/// 44.3.3, Tx FIFO; 44.4.29, note.
#[test]
fn request_for_pending_buffer_or_off_put_index_is_violation() {
    let mut can = started(&[]);
    assert_eq!((request(&mut can, 1, 1), load(&mut can, [TXBRP])), (1, [0]));
    let mut can = started(&[QUEUE]);
    assert_eq!((request(&mut can, 1, 1), store(&mut can, TXBAR, 0b10)), (0, 1));
    assert_eq!((store(&mut can, ram(TX_BUFFERS + 18), 0), store(&mut can, ram(TX_BUFFERS), 0)), (1, 0));
    assert_eq!(store(&mut can, ram(RX_FIFOS), 0), 1);
}

/// 44.3.3, transmit cancellation; 44.4.28 (page 1999); 44.4.30 to 44.4.34.
#[test]
fn cancellation_finishes_at_once_or_with_the_transmission() {
    for (is_sent, is_lost) in [(true, false), (false, false), (false, true)] {
        let mut can = started(&[QUEUE, (TXBCIE, 1)]);
        request(&mut can, 0, 1);
        can.begin_transmission(0);
        store(&mut can, TXBCR, 1);
        assert_eq!(load(&mut can, [TXBRP, TXBCR, TXBCF]), [1, 1, 0]);
        match (is_sent, is_lost) {
            (true, _) => can.end_transmission(0),
            (false, true) => can.begin_reception(Some(0)),
            (false, false) => can.fail_transmission(0, ErrorCode::Acknowledgement),
        }
        assert_eq!(load(&mut can, [TXBRP, TXBCR, TXBCF, TXBTO]), [0, 0, 1, u32::from(is_sent)]);
        assert_eq!(load(&mut can, [IR])[0] & (TC | TCF), TCF);
    }
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    store(&mut can, TXBCR, 0b11);
    assert_eq!(load(&mut can, [TXBRP, TXBCF, IR]), [0, 0b11, 0]);
    request(&mut can, 0, 1);
    assert_eq!(load(&mut can, [TXBRP, TXBCF]), [1, 0b10]);
    assert_eq!(store(&mut started(&[]), TXBCR, 1), 1, "not for the TX FIFO");
}

/// 44.3.2, disabled automatic retransmission.
#[test]
fn a_failed_transmission_is_repeated_except_with_dar() {
    for (mode, pending) in [(0, 1), (DAR, 0)] {
        let mut can = started(&[(CCCR, INIT | CCE | mode), QUEUE]);
        request(&mut can, 0, 1);
        fail(&mut can, 1, ErrorCode::Acknowledgement);
        assert_eq!(load(&mut can, [TXBRP, TXBCF, TXBTO]), [pending, 1 - pending, 0]);
    }
}

/// 44.4.15 to 44.4.18; 44.4.33.
#[test]
fn a_flag_raises_the_line_of_its_group_until_it_is_cleared() {
    let mut can = started(&[(IE, 0xFF_FFFF), (ILE, 0b11)]);
    for (bit, group) in [(0, 0), (5, 1), (8, 2), (9, 3), (15, 4), (16, 5), (17, 5), (18, 6), (23, 6)] {
        can.ir = 1 << bit;
        store(&mut can, ILS, 1 << group);
        assert_eq!(can.interrupts(), [false, true], "{bit}");
        store(&mut can, ILS, 0x7F & !(1 << group));
        assert_eq!(can.interrupts(), [true, false], "{bit}");
    }
    let mut can = started(&[QUEUE, (IE, TC), (ILE, 0b01), (TXBTIE, 0b10)]);
    for (buffer, is_raised) in [(0, false), (1, true)] {
        request(&mut can, buffer, 1);
        send(&mut can);
        assert_eq!(can.interrupts(), [is_raised, false]);
    }
    for (offset, value, is_raised) in [(ILE, 2, false), (ILE, 1, true), (IR, !TC, true), (IR, TC, false)] {
        store(&mut can, offset, value);
        assert_eq!(can.interrupts(), [is_raised, false]);
    }
}

/// 44.4.12; 44.4.13; 44.4.15.
#[test]
fn errors_are_counted_and_logged_and_states_report_changes() {
    const STATES: u32 = (EP | EW | BO) << 12;
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    fail(&mut can, 12, ErrorCode::Acknowledgement);
    assert_eq!(load(&mut can, [ECR, ECR]), [12 << 16 | 96, 96], "CEL is cleared by a load");
    assert_eq!(load(&mut can, [PSR, PSR]), [0x700 | EW | 1 << 3 | 3, 0x700 | EW | 1 << 3 | 7]);
    assert_eq!(load(&mut can, [IR])[0] & (STATES | PEA), EW << 12 | PEA);
    fail(&mut can, 14, ErrorCode::Acknowledgement);
    assert_eq!(load(&mut can, [ECR]), [4 << 16 | 128], "a passive transmitter does not count them");
    store(&mut can, IR, !0);
    send(&mut can);
    assert_eq!(load(&mut can, [ECR, PSR]), [127, 0x700 | EW | 1 << 3]);
    assert_eq!(load(&mut can, [IR])[0] & STATES, EP << 12);
}

/// 44.4.13, note on the recovery from bus-off.
#[test]
fn bus_off_ends_after_init_is_cleared_and_129_sequences() {
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    fail(&mut can, 32, ErrorCode::BitDominant);
    assert_eq!(load(&mut can, [CCCR, IR]), [INIT, (EP | EW | BO) << 12 | PEA]);
    can.idle(1_000_000);
    assert_eq!(load(&mut can, [PSR])[0] & (BO | 3 << 3), BO);
    store(&mut can, CCCR, 0);
    can.idle(10 * 11);
    assert_eq!(load(&mut can, [ECR])[0] >> 8 & 0x7F, 10);
    assert_eq!(load(&mut can, [PSR])[0] & 7, ErrorCode::BitDominant as u32);
    can.idle(119 * 11 - 1);
    assert_eq!((can.takes_part(), load(&mut can, [PSR])[0] & BO), (false, BO));
    store(&mut can, IR, !0);
    can.idle(1);
    assert_eq!(load(&mut can, [ECR, IR, TXBRP]), [0, (EP | EW | BO) << 12, 1]);
    assert_eq!(send(&mut can), 0, "the request is still pending");
}

/// 44.3.2, restricted operation mode; 44.4.15, MRAF.
#[test]
fn restricted_operation_receives_but_neither_sends_nor_counts() {
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    can.fail_ram_access();
    assert_eq!((load(&mut can, [CCCR, IR]), can.next_transmission()), ([ASM, MRAF], None));
    receive(&mut can, &WireFrame::standard(1, &[]));
    can.begin_reception(None);
    can.fail_reception(ErrorCode::Crc);
    assert_eq!(load(&mut can, [RXF0S, ECR]), [1 << 16 | 1, 1 << 16]);
    assert_eq!(store(&mut can, CCCR, 0), 0);
    assert_eq!(send(&mut can), 0);
}

/// 44.3.6; 44.4.3 to 44.4.10.
#[test]
fn options_beyond_classic_can_are_faults() {
    for option in [1 << 5, 1 << 7, 1 << 8, 1 << 9, 1 << 13, 1 << 14, 1 << 15] {
        assert!(configured(&[]).store(CCCR, INIT | CCE | option).is_err(), "{option:#X}");
        assert!(configured(&[]).store(0x0C, option).is_err());
    }
    for offset in [0x10, 0x14, 0x20, 0x28, 0x48, 0x100 + 4] {
        assert!(configured(&[]).store(offset, 0xFFFF_0001).is_err(), "{offset:#X}");
    }
    for option in [20, 21, 23] {
        let mut can = started(&[QUEUE]);
        store(&mut can, ram(TX_BUFFERS + 1), 1 << option);
        assert!(can.store(TXBAR, 1).is_err(), "{option}");
    }
    let mut can = started(&[QUEUE]);
    request(&mut can, 0, 1);
    can.begin_transmission(0);
    assert!(can.store(CCCR, INIT).is_err(), "truncates a transmission");
}

/// 44.3.3: the RAM is addressed by words. The time rule is that of [`crate::registers`].
#[test]
fn other_widths_are_faults_and_unread_data_stops_time() {
    let bus = CanBus::with(started(&[QUEUE]), 500_000);
    let station = bus.join();
    let mut models = bus.models();
    for (n, start) in [FDCAN1, 0x4000_A400].into_iter().enumerate() {
        let model = &mut models[n];
        assert_eq!(model.addresses().start, start);
        assert!(model.load(start, Width::Byte).is_err() && model.store(start, Width::Halfword, 0).is_err());
        assert!(model.load(start + 2, Width::Word).is_err() && model.load(start, Width::Word).is_ok());
        assert_eq!(bus.controller().violations().len(), 3 * (n + 1));
    }
    bus.act(|can| request(can, 0, 1));
    models.iter_mut().for_each(|model| model.advance(Duration::from_micros(92)));
    assert_eq!((bus.sent().len(), station.received.try_recv().is_ok()), (0, false), "one of 47 bits is left");
    models.iter_mut().for_each(|model| model.advance(Duration::from_micros(2)));
    assert_eq!((bus.sent().len(), station.received.try_recv().is_ok()), (1, true));

    for (frames, is_unread) in [(0, false), (1, true)] {
        bus.burst(&[WireFrame::standard(1, &[])][..frames]);
        assert!(models.iter().all(|model| model.has_unread_data() == is_unread));
    }
    models.iter_mut().for_each(|model| model.reset());
    assert_eq!(bus.act(|can| load(can, [CCCR, RXF0S])), [INIT, 0]);
}
