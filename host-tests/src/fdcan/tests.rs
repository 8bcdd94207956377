//! Covers the model's strictness. The driver obeys these rules, so no emulated image detects a model without them.

use super::*;
use crate::can_bus::CanBus;
use crate::can_controller::testing::{assert_recovers, fail, receive, send};

const RF1N: u32 = RF0N << 3;
const BOTH: u32 = INIT | CCE;

/// Creates a controller on the bus in queue mode, at 500 kbit/s, with these registers or words of the RAM stored.
fn started(registers: &[(usize, u32)]) -> Fdcan {
    let mut can = Fdcan::new(HSE_HZ);
    let set_up = [(CCCR, BOTH), (NBTP, 0x0401_1302), (TXBC, TFQM)];
    for (number, value) in [&set_up[..], registers, &[(CCCR, 0)]].concat() {
        assert_eq!(store(&mut can, number, value), 0, "{number:#X}");
    }
    can.idle(11);
    can
}

/// Stores to a register. Returns the number of violations.
fn store(can: &mut Fdcan, number: usize, value: u32) -> usize {
    can.node.violations.clear();
    can.store(4 * number as u32, value).unwrap();
    can.violations().len()
}

fn load<const N: usize>(can: &mut Fdcan, numbers: [usize; N]) -> [u32; N] {
    numbers.map(|number| can.load(4 * number as u32).unwrap())
}

/// Requests the transmission of a frame without data. Returns the number of violations.
fn request(can: &mut Fdcan, buffer: usize, id: u32) -> usize {
    let at = RAM + TX_BUFFERS + ELEMENT_WORDS * buffer;
    store(can, at, id << 18) + store(can, at + 1, 0) + store(can, TXBAR, 1 << buffer)
}

#[test]
fn init_and_cce_unlock_timing_and_filters_and_empty_buffers() {
    let mut can = started(&[]);
    assert_eq!(can.bit_timing(), BitTiming { rate: 500_000, sample_point: 875, jump: 3, quanta: 24 });
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert_eq!([0, 1, 2].map(|buffer| request(&mut can, buffer, 0x100)), [0; 3]);
    send(&mut can);
    store(&mut can, TXBCR, 0b010);
    let used = [1 << 16 | 1, 0b100, 0b001, 0b010];
    for (cccr, violations, result, buffers) in
        [(CCE, 1, 0, used), (BOTH, 1, INIT, used), (BOTH, 0, BOTH, [0; 4]), (CCE, 0, 0, [0; 4])]
    {
        assert_eq!((store(&mut can, CCCR, cccr), load(&mut can, [CCCR])), (violations, [result]));
        assert_eq!(load(&mut can, [RXF0S, TXBRP, TXBTO, TXBCF]), buffers);
        let is_open = result == BOTH;
        for number in [NBTP, RXGFC, TXBC] {
            let value = can.registers[number] ^ 1 << 24;
            assert_eq!(store(&mut can, number, value), usize::from(!is_open), "{number:#X}");
            assert_eq!(can.registers[number] == value, is_open, "{number:#X}");
        }
        assert_eq!([TXBAR, TXBCR].map(|number| store(&mut can, number, 0)), [usize::from(is_open); 2]);
    }
}

#[test]
fn filters_select_by_type_and_action_and_rxgfc_on_no_match() {
    let flags_of = |registers: &[(usize, u32)], frame: WireFrame| {
        let mut can = started(registers);
        receive(&mut can, &frame);
        can.registers[IR]
    };
    let found = |kind: u32, action: u32, second: u32, id: u16| {
        let words = [
            (RXGFC, 1 << 24 | 1 << 16),
            (RAM, kind << 30 | action << 27 | 0x100 << 16 | second),
            (RAM + EXTENDED_FILTERS, action << 29 | 0x100),
            (RAM + EXTENDED_FILTERS + 1, kind << 30 | second),
        ];
        let frames = [WireFrame::standard(id, &[]), WireFrame::extended(id.into(), &[])];
        frames.map(|frame| flags_of(&words, frame))
    };
    for (kind, second, id, other) in
        [(0, 0x110, 0x110, 0x111), (1, 0x110, 0x110, 0x105), (2, 0x7F0, 0x10F, 0x110)]
    {
        assert_eq!([id, other].map(|id| found(kind, 2, second, id)), [[RF1N; 2], [RF0N; 2]], "{kind}");
    }
    for (action, flags) in [(0, RF0N), (3, 0), (4, HPM), (5, RF0N | HPM), (6, RF1N | HPM), (7, RF0N)] {
        assert_eq!(found(1, action, 0x100, 0x100), [flags; 2], "{action}");
    }
    assert_eq!(found(3, 2, 0x100, 0x100), [RF0N, RF1N], "disabled, or a range");
    let (standard, extended) = (WireFrame::standard(1, &[]), WireFrame::extended(1, &[]));
    let frames = [standard, standard.remote(), extended, extended.remote()];
    let found = |config| frames.map(|frame| flags_of(&[(RXGFC, config)], frame));
    for (code, flags) in (0..).zip([RF0N, RF1N, 0, 0]) {
        assert_eq!(found(code << 4), [flags, flags, RF0N, RF0N]);
        assert_eq!(found(code << 2), [RF0N, RF0N, flags, flags]);
    }
    assert_eq!([found(0b10), found(0b01)], [[RF0N, 0, RF0N, RF0N], [RF0N, RF0N, RF0N, 0]]);
}

#[test]
fn elements_name_the_first_filter_and_have_rubbish_elsewhere() {
    let filters = [(RAM, 0), (RAM + 1, 1 << 27 | 0x7FF), (RAM + 2, 2 << 27 | 0x7FF), (RXGFC, 3 << 16)];
    let mut can = started(&filters);
    receive(&mut can, &WireFrame::standard(0x123, &[1, 2, 3]));
    receive(&mut can, &WireFrame::extended(0x123_4567, &[0; 8]).remote());
    let [r0, r1, r2] = load(&mut can, [0, 1, 2].map(|n| RAM + RX_FIFOS + n));
    assert_eq!((r0 & !0x3_FFFF, r1 & !0xC0_0000, r2 & 0xFF_FFFF), (0x123 << 18, 0x103_0000, 0x03_0201));
    assert!(r0 & 0x3_FFFF != 0 && r2 >> 24 != 0);
    let [r0, r1] = load(&mut can, [18, 19].map(|n| RAM + RX_FIFOS + n));
    assert_eq!((r0, r1 & 0x803F_FFFF), (XTD | RTR | 0x123_4567, 0x8008_0000));
}

#[test]
fn full_fifo_loses_messages_until_elements_are_acknowledged() {
    for (fifo, [status, acknowledge]) in [[RXF0S, RXF0A], [RXF1S, RXF1A]].into_iter().enumerate() {
        let mut can = started(&[(RXGFC, (fifo as u32) << 4)]);
        (1..=4).for_each(|id| receive(&mut can, &WireFrame::standard(id, &[])));
        assert_eq!(load(&mut can, [status, IR]), [1 << 25 | 1 << 24 | 3, 0b111 << (3 * fifo)]);
        assert_eq!((store(&mut can, IR, !0), load(&mut can, [status])), (0, [1 << 24 | 3]));
        for (element, violations) in [(1, 0), (0, 1), (1, 1), (3, 1)] {
            let found = (store(&mut can, acknowledge, element), load(&mut can, [status]));
            assert_eq!(found, (violations, [2 << 8 | 1]));
        }
        assert_eq!(load(&mut can, [RAM + RX_FIFOS + ELEMENT_WORDS * (3 * fifo + 2)])[0] >> 18, 3);
        assert_eq!(can.accepted().len(), 4);
    }
}

#[test]
fn queue_sends_lowest_identifier_fifo_oldest_no_buffer_twice() {
    for (mode, ids, order, status) in [
        (TFQM, [0x300, 0x200, 0x100], [2, 1, 0], [0, 1 << 16, 2 << 16]),
        (TFQM, [0x100; 3], [0, 1, 2], [0, 1 << 16, 2 << 16]),
        (0, [0x300, 0x200, 0x100], [0, 1, 2], [3, 1 << 16 | 2, 2 << 16 | 1]),
    ] {
        let mut can = started(&[(TXBC, mode)]);
        let found = [0, 1, 2].map(|n| (load(&mut can, [TXFQS]), request(&mut can, n, ids[n])));
        assert_eq!(found, status.map(|status| ([status], 0)));
        assert_eq!(load(&mut can, [TXFQS]), [1 << 21]);
        assert_eq!(order.map(|_| send(&mut can)), order);
        // A buffer with a request, and one that is not at the put index of the FIFO.
        assert_eq!((request(&mut can, 0, 1), request(&mut can, 0, 1)), (0, 3));
        assert_eq!(request(&mut can, 2, 1), usize::from(mode == 0));
    }
}

#[test]
fn cancellation_finishes_at_once_or_with_the_transmission() {
    for (end, cancelled) in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)] {
        let mut can = started(&[]);
        request(&mut can, 0, 1);
        can.begin_transmission(0);
        store(&mut can, TXBCR, cancelled);
        assert_eq!(load(&mut can, [TXBRP, TXBCR, TXBCF]), [1, cancelled, 0]);
        match end {
            0 => can.end_transmission(0),
            1 => can.fail_transmission(0, ErrorCode::Acknowledgement),
            _ => can.begin_reception(Some(0)),
        }
        let (pending, sent) = (u32::from(end != 0 && cancelled == 0), u32::from(end == 0));
        assert_eq!(load(&mut can, [TXBRP, TXBCR, TXBCF, TXBTO]), [pending, 0, cancelled, sent]);
    }
    let mut can = started(&[]);
    request(&mut can, 0, 1);
    store(&mut can, TXBCR, 0b11);
    assert_eq!(load(&mut can, [TXBRP, TXBCF]), [0, 0b11], "even without a request");
    assert_eq!((request(&mut can, 0, 1), load(&mut can, [TXBRP, TXBCF])), (0, [1, 0b10]));
}

#[test]
fn flag_raises_the_line_of_its_group_until_it_is_cleared() {
    let mut can = started(&[(IE, 0xFF_FFFF), (ILE, 0b11)]);
    for (bit, group) in [(0, 0), (5, 1), (8, 2), (9, 3), (15, 4), (16, 5), (17, 5), (18, 6), (23, 6)] {
        can.registers[IR] = 1 << bit;
        for (ils, levels) in [(1 << group, [false, true]), (0x7F ^ 1 << group, [true, false])] {
            store(&mut can, ILS, ils);
            assert_eq!(can.interrupts(), levels, "{bit}");
        }
    }
    let mut can = started(&[(IE, TC), (ILE, 0b01), (TXBTIE, 0b10)]);
    let found = [0, 1].map(|n| (request(&mut can, n, 1), send(&mut can), can.interrupts()));
    assert_eq!(found, [(0, 0, [false; 2]), (0, 1, [true, false])]);
    for (number, value, is_raised) in
        [(ILE, 2, false), (ILE, 1, true), (IE, 0, false), (IE, TC, true), (IR, !TC, true), (IR, TC, false)]
    {
        store(&mut can, number, value);
        assert_eq!(can.interrupts(), [is_raised, false]);
    }
}

#[test]
fn errors_change_counters_and_states_up_to_bus_off() {
    let [ew, ep, bo] = STATES;
    let mut can = started(&[]);
    request(&mut can, 0, 1);
    fail(&mut can, 12, ErrorCode::Acknowledgement);
    assert_eq!(load(&mut can, [ECR, PSR, PSR]), [96, 0x70B | ew, 0x70F | ew], "LEC is read once");
    fail(&mut can, 14, ErrorCode::Acknowledgement);
    assert_eq!(load(&mut can, [ECR, IR]), [128, (ew | ep) << 12 | PEA], "uncounted while passive");
    store(&mut can, IR, !0);
    send(&mut can);
    assert_eq!(load(&mut can, [ECR, PSR, IR]), [127, 0x708 | ew, ep << 12]);
    let mut can = started(&[]);
    request(&mut can, 0, 1);
    let rejoin = |can: &mut Fdcan| {
        assert_eq!(load(can, [CCCR, PSR, IR]), [INIT, 0x705 | ew | ep | bo, (ew | ep | bo) << 12 | PEA]);
        assert_eq!((store(can, IR, !0), store(can, CCCR, 0)), (0, 0));
        can.idle(10 * 11);
        assert_eq!((load(can, [ECR])[0] >> 8 & 0x7F, load(can, [PSR])[0] & 0b111), (10, 5));
    };
    assert_recovers(&mut can, rejoin, RECOVERY - 10);
    assert_eq!(load(&mut can, [ECR, IR, TXBRP]), [0, (ew | ep | bo) << 12, 1]);
}

#[test]
fn restricted_operation_receives_but_neither_sends_nor_counts() {
    let mut can = started(&[]);
    request(&mut can, 0, 1);
    can.fail_ram_access();
    assert_eq!((load(&mut can, [CCCR, IR]), can.next_transmission()), ([ASM, MRAF], None));
    receive(&mut can, &WireFrame::standard(1, &[]));
    can.begin_reception(None);
    can.fail_reception(ErrorCode::Crc);
    assert_eq!(load(&mut can, [RXF0S, ECR]), [1 << 16 | 1, 0]);
    assert_eq!((store(&mut can, CCCR, 0), send(&mut can)), (0, 0));
}

#[test]
fn options_and_registers_that_are_not_modelled_are_faults() {
    for option in [20, 21, 23] {
        let mut can = started(&[(RAM + TX_BUFFERS + 1, 1 << option)]);
        assert!(can.store(4 * TXBAR as u32, 1).is_err(), "{option}");
    }
    let mut can = started(&[]);
    can.begin_transmission(0);
    assert!(can.store(4 * CCCR as u32, INIT).is_err(), "truncates a transmission");
    can.registers[CCCR] = BOTH;
    let modes = (2..16).map(|bit| (CCCR, BOTH | 1 << bit));
    let options = [(RXGFC, 1 << 9), (TXBC, 1), (0x0C / 4, 0), (0x84 / 4, 0), (0x100 / 4, 0), (RAM_END, 0)];
    for (number, value) in modes.chain(options) {
        assert!(can.store(4 * number as u32, value).is_err(), "{number:#X} {value:#X}");
    }
    assert!(can.load(0x84).is_err());
}

#[test]
fn unread_data_stops_time_and_a_reset_empties_the_fifos() {
    let bus = CanBus::with(started(&[]), 500_000);
    let mut models = bus.models();
    assert!(models.iter().all(|model| !model.has_unread_data()));
    bus.burst(&[WireFrame::standard(1, &[])]);
    assert!(models.iter().all(|model| model.has_unread_data()));
    models.iter_mut().for_each(|model| model.reset());
    assert_eq!(bus.act(|can| load(can, [CCCR, RXF0S])), [INIT, 0]);
}
