mod driver;

use super::*;
use crate::can_bus::CanBus;

/// 500 kbit/s from 16 MHz: a quantum of 125 ns, 1 + 6 + 7 of 16 before the sample point, 2 behind it.
const CNF: [u8; 3] = [0x00, 0xB5, 0x01];

/// One instruction: what comes out, byte by byte.
fn spi(can: &mut Mcp2515, bytes: &[u8]) -> Vec<u8> {
    can.select();
    let out = bytes.iter().map(|byte| can.exchange(*byte).unwrap()).collect();
    can.deselect();
    out
}

fn read(can: &mut Mcp2515, address: u8) -> u8 {
    spi(can, &[0x03, address, 0])[2]
}

fn write(can: &mut Mcp2515, address: u8, bytes: &[u8]) {
    spi(can, &[&[0x02, address], bytes].concat());
}

fn modify(can: &mut Mcp2515, address: u8, mask: u8, value: u8) {
    spi(can, &[0x05, address, mask, value]);
}

/// In Configuration mode, with its timing set.
fn configured() -> Mcp2515 {
    let mut can = Mcp2515::new(16_000_000);
    write(&mut can, CNF3, &[CNF[2], CNF[1], CNF[0]]);
    can
}

/// In Normal mode, and all filters off.
fn normal() -> Mcp2515 {
    let mut can = configured();
    write(&mut can, 0x60, &[RXM_ANY | 1 << 2]);
    write(&mut can, 0x70, &[RXM_ANY]);
    start(&mut can);
    can
}

const RXM_ANY: u8 = 0b11 << 5;

fn start(can: &mut Mcp2515) {
    write(can, CANCTRL, &[0]);
    can.idle(11);
    assert!(can.takes_part());
}

/// SIDH, SIDL of a standard identifier.
fn standard(id: u16) -> [u8; 2] {
    [(id >> 3) as u8, (id << 5) as u8]
}

fn load_and_request(can: &mut Mcp2515, buffer: u8, id: u16, data: &[u8]) {
    let [sidh, sidl] = standard(id);
    spi(can, &[&[0x40 | buffer << 1, sidh, sidl, 0, 0, data.len() as u8], data].concat());
    spi(can, &[0x80 | 1 << buffer]);
}

fn receive(can: &mut Mcp2515, frame: &WireFrame) {
    can.begin_reception(None);
    can.end_reception(frame);
}

fn fail(can: &mut Mcp2515, times: usize, why: ErrorCode) {
    for _ in 0..times {
        let mailbox = can.next_transmission().unwrap().mailbox;
        can.begin_transmission(mailbox);
        can.fail_transmission(mailbox, why);
    }
}

#[test]
fn reset_leaves_it_in_configuration_mode_and_silent() {
    let mut can = normal();
    load_and_request(&mut can, 0, 1, &[]);
    spi(&mut can, &[0xC0]);
    assert_eq!((read(&mut can, CANSTAT), read(&mut can, CANCTRL)), (0x80, 0x87));
    assert_eq!((can.takes_part(), can.pending(), read(&mut can, CNF1)), (false, 0, 0));
    // Each row has them.
    assert_eq!((read(&mut can, 0x3E), read(&mut can, 0x7F)), (0x80, 0x87));
}

#[test]
fn reads_and_writes_go_on_at_the_next_register_and_from_the_last_at_the_first() {
    let mut can = configured();
    write(&mut can, 0x00, &[1, 0xE2, 3, 4]);
    assert_eq!(spi(&mut can, &[0x03, 0x7F, 0, 0, 0, 0, 0])[2..], [0x87, 1, 0xE2, 3, 4]);
    assert_eq!(spi(&mut can, &[0x03, CNF3, 0, 0, 0])[2..], [CNF[2], CNF[1], CNF[0]]);
}

#[test]
fn bits_are_modified_where_that_is_possible_and_all_of_them_elsewhere() {
    let mut can = configured();
    write(&mut can, CANINTE, &[0b1010_0000]);
    modify(&mut can, CANINTE, 0b0000_1111, 0xFF);
    assert_eq!(read(&mut can, CANINTE), 0b1010_1111);
    write(&mut can, 0x00, &[0xF0]);
    modify(&mut can, 0x00, 0x01, 0x0F);
    assert_eq!(read(&mut can, 0x00), 0x0F);
}

#[test]
fn timing_and_filters_are_written_in_configuration_mode_alone() {
    let mut can = normal();
    write(&mut can, CNF1, &[0x3F]);
    write(&mut can, 0x20, &[0xFF]);
    assert_eq!((read(&mut can, CNF1), read(&mut can, 0x20)), (CNF[0], 0));
    assert_eq!(can.violations().len(), 2);
}

#[test]
fn the_rate_and_the_sample_point_are_those_of_the_three_registers() {
    let mut can = configured();
    assert_eq!((can.rate(), can.sample_point()), (500_000, 875));
    // Without BTLMODE, phase segment 2 is as long as 1: 1 + 6 + 7 before, 7 behind.
    write(&mut can, 0x29, &[0x35]);
    assert_eq!(can.rate(), 16_000_000 / 2 / 21);
}

#[test]
fn it_takes_part_after_eleven_recessive_bits() {
    let mut can = configured();
    write(&mut can, CANCTRL, &[0]);
    assert_eq!(read(&mut can, CANSTAT), 0);
    can.idle(10);
    assert!(!can.takes_part());
    can.idle(1);
    assert!(can.takes_part());
}

#[test]
fn a_message_leaves_as_it_was_written_and_is_told_of() {
    let mut can = normal();
    write(&mut can, CANINTE, &[TX0IF << 1]);
    load_and_request(&mut can, 1, 0x123, &[1, 2, 3]);
    let Transmission { mailbox, frame } = can.next_transmission().unwrap();
    assert_eq!((mailbox, frame), (1, WireFrame::standard(0x123, &[1, 2, 3])));
    assert_eq!(spi(&mut can, &[0xA0, 0])[1], 1 << 4);

    can.begin_transmission(1);
    can.end_transmission(1);
    assert_eq!((can.next_transmission(), can.interrupt_pin()), (None, false));
    assert_eq!(spi(&mut can, &[0xA0, 0])[1], 1 << 5);
    // TXB1
    assert_eq!(read(&mut can, CANSTAT), 4 << 1);
    modify(&mut can, CANINTF, TX0IF << 1, 0);
    assert!(can.interrupt_pin());
}

#[test]
fn extended_and_remote_frames_leave_as_they_were_written() {
    let mut can = normal();
    let id = 0x1234_5678u32;
    let sidl = ((id >> 18) as u8) << 5 | 1 << 3 | (id >> 16) as u8 & 3;
    let bytes = [(id >> 21) as u8, sidl, (id >> 8) as u8, id as u8, 1 << 6 | 2];
    spi(&mut can, &[&[0x44], &bytes[..]].concat());
    spi(&mut can, &[0x84]);
    let expected = WireFrame { dlc: 2, ..WireFrame::extended(id, &[]).remote() };
    assert_eq!(can.next_transmission().unwrap().frame, expected);
}

#[test]
fn the_highest_priority_leaves_first_and_of_equal_ones_the_highest_buffer() {
    let mut can = normal();
    for buffer in 0..3 {
        load_and_request(&mut can, buffer, 0x100, &[]);
    }
    assert_eq!(can.next_transmission().unwrap().mailbox, 2);
    modify(&mut can, 0x30, 0b11, 0b01);
    assert_eq!(can.next_transmission().unwrap().mailbox, 0);
}

#[test]
fn a_pending_message_is_protected() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[7]);
    write(&mut can, 0x36, &[9]);
    assert_eq!(can.next_transmission().unwrap().frame.data[0], 7);
    assert_eq!(can.violations().len(), 1);
}

#[test]
fn a_message_is_aborted_at_once_unless_it_is_being_sent() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    modify(&mut can, 0x30, 1 << 3, 0);
    assert_eq!((can.next_transmission(), read(&mut can, 0x30)), (None, 0));

    load_and_request(&mut can, 0, 0x100, &[]);
    can.begin_transmission(0);
    modify(&mut can, 0x30, 1 << 3, 0);
    assert_eq!(can.pending(), 1);
    can.fail_transmission(0, ErrorCode::Acknowledgement);
    assert_eq!(can.pending(), 0);
}

#[test]
fn abat_aborts_all_tells_so_and_lets_nothing_leave_until_it_is_cleared() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    modify(&mut can, CANCTRL, ABAT, ABAT);
    assert_eq!(read(&mut can, 0x30), 1 << 6);
    load_and_request(&mut can, 1, 0x100, &[]);
    assert_eq!(can.next_transmission(), None);
    modify(&mut can, CANCTRL, ABAT, 0);
    assert_eq!(can.next_transmission().unwrap().mailbox, 1);
}

#[test]
fn what_fails_or_loses_is_tried_again_and_the_reason_told() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    fail(&mut can, 1, ErrorCode::BitRecessive);
    can.begin_reception(Some(0));
    can.end_reception(&WireFrame::standard(1, &[]));
    assert_eq!(read(&mut can, 0x30), 1 << 5 | 1 << 4 | 1 << 3);
    assert_eq!(read(&mut can, CANINTF) & MERRF, MERRF);
    // The next request clears them.
    can.begin_transmission(0);
    can.end_transmission(0);
    spi(&mut can, &[0x81]);
    assert_eq!(read(&mut can, 0x30), 1 << 3);
}

#[test]
fn with_osm_it_is_tried_once() {
    let mut can = normal();
    modify(&mut can, CANCTRL, OSM, OSM);
    load_and_request(&mut can, 0, 0x100, &[]);
    fail(&mut can, 1, ErrorCode::Acknowledgement);
    assert_eq!(read(&mut can, 0x30), 1 << 6 | 1 << 4);
    load_and_request(&mut can, 0, 0x100, &[]);
    can.begin_reception(Some(0));
    assert_eq!(can.pending(), 0);
}

#[test]
fn a_pending_message_is_sent_or_aborted_before_the_mode_changes() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    modify(&mut can, CANCTRL, REQOP, 4 << 5);
    assert_eq!(read(&mut can, CANSTAT), 0);
    can.begin_transmission(0);
    can.end_transmission(0);
    assert_eq!(read(&mut can, CANSTAT) >> 5, 4);
}

#[test]
fn a_message_is_read_by_its_own_instruction_which_frees_its_buffer() {
    let mut can = normal();
    write(&mut can, CANINTE, &[RX0IF]);
    receive(&mut can, &WireFrame::standard(0x7A5, &[1, 2]));
    assert!(!can.interrupt_pin());
    let bytes = spi(&mut can, &[0x90, 0, 0, 0, 0, 0, 0, 0]);
    let [sidh, sidl] = standard(0x7A5);
    assert_eq!(bytes[1..], [sidh, sidl, 0, 0, 2, 1, 2]);
    assert!(can.interrupt_pin());
    assert_eq!(read(&mut can, CANINTF), 0);
    // From the data on, and by READ, which frees nothing.
    receive(&mut can, &WireFrame::standard(0x7A5, &[3, 4]));
    assert_eq!(spi(&mut can, &[0x03, 0x66, 0, 0])[2..], [3, 4]);
    assert_eq!(spi(&mut can, &[0x92, 0, 0])[1..], [3, 4]);
    assert_eq!(read(&mut can, CANINTF), 0);
}

#[test]
fn rx_status_tells_of_the_kind_and_the_filter() {
    let mut can = normal();
    let status = |can: &mut Mcp2515| spi(can, &[0xB0, 0])[1];
    assert_eq!(status(&mut can), 0);
    receive(&mut can, &WireFrame::extended(0x1ABC_DEF0, &[]).remote());
    assert_eq!(status(&mut can), 0b01 << 6 | 1 << 4 | 1 << 3);
    assert_eq!(spi(&mut can, &[0x90, 0, 0, 0, 0, 0])[2..], [0xE8, 0xDE, 0xF0, 1 << 6]);
    receive(&mut can, &WireFrame::standard(5, &[]).remote());
    receive(&mut can, &WireFrame::standard(6, &[]));
    assert_eq!(status(&mut can), 0b11 << 6 | 1 << 3);
    spi(&mut can, &[0x90]);
    // Rolled over to the second buffer.
    assert_eq!(status(&mut can), 0b10 << 6 | 0b110);
}

#[test]
fn a_message_rolls_over_and_the_third_is_lost_and_told_of() {
    let mut can = normal();
    for id in 1..=3 {
        receive(&mut can, &WireFrame::standard(id, &[]));
    }
    assert_eq!(read(&mut can, EFLG), RX1OVR);
    assert_eq!(read(&mut can, CANINTF), ERRIF | 0b11);
    assert_eq!([0x62, 0x72].map(|at| read(&mut can, at) >> 5), [1, 2]);
    modify(&mut can, EFLG, RX1OVR, 0);
    assert_eq!((read(&mut can, EFLG), can.accepted().len()), (0, 3));
    assert_eq!(can.lost(), [WireFrame::standard(3, &[])]);

    let mut can = normal();
    modify(&mut can, 0x60, 1 << 2, 0);
    receive(&mut can, &WireFrame::standard(1, &[]));
    receive(&mut can, &WireFrame::standard(2, &[]));
    assert_eq!((read(&mut can, EFLG), read(&mut can, CANINTF)), (RX0OVR, ERRIF | 1));
}

#[test]
fn filters_choose_the_buffer_and_keep_others_out() {
    let mut can = configured();
    let [sidh, sidl] = standard(0x7FF);
    for mask in [0x20, 0x24] {
        write(&mut can, mask, &[sidh, sidl, 0, 0]);
    }
    for (filter, id) in [(0x00, 0x100), (0x04, 0x101), (0x08, 0x200), (0x10, 0x201), (0x14, 0x202)] {
        write(&mut can, filter, &standard(id));
    }
    // RXF5: extended.
    write(&mut can, 0x18, &[standard(0x300)[0], standard(0x300)[1] | 1 << 3]);
    start(&mut can);

    let mut place = |frame: WireFrame| {
        receive(&mut can, &frame);
        let (flags, status) = (read(&mut can, CANINTF), spi(&mut can, &[0xB0, 0])[1]);
        write(&mut can, CANINTF, &[0]);
        (flags & 0b11, status & 0b111)
    };
    assert_eq!(place(WireFrame::standard(0x100, &[])), (1, 0));
    assert_eq!(place(WireFrame::standard(0x101, &[]).remote()), (1, 1));
    assert_eq!(place(WireFrame::standard(0x202, &[])), (2, 4));
    assert_eq!(place(WireFrame::standard(0x300, &[])), (0, 0));
    assert_eq!(place(WireFrame::extended(0x300 << 18 | 0x2_AAAA, &[])), (2, 5));
    assert_eq!(place(WireFrame::extended(0x100 << 18, &[])), (0, 0));
}

#[test]
fn a_filter_of_a_standard_identifier_sees_two_bytes_of_data() {
    let mut can = configured();
    write(&mut can, 0x20, &[0, 0, 0xFF, 0]);
    write(&mut can, 0x00, &[0, 0, 0x55, 0]);
    write(&mut can, 0x04, &[0, 0, 0x55, 0]);
    write(&mut can, 0x24, &[0xFF, 0xE0, 0, 0]);
    start(&mut can);
    receive(&mut can, &WireFrame::standard(0x123, &[0x54]));
    assert_eq!(read(&mut can, CANINTF), 0);
    receive(&mut can, &WireFrame::standard(0x123, &[0x55]));
    assert_eq!(read(&mut can, CANINTF), 1);
}

#[test]
fn a_lonely_controller_becomes_error_passive_and_goes_on_trying() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    fail(&mut can, 11, ErrorCode::Acknowledgement);
    assert_eq!((read(&mut can, TEC), read(&mut can, EFLG)), (88, 0));
    fail(&mut can, 1, ErrorCode::Acknowledgement);
    assert_eq!((read(&mut can, TEC), read(&mut can, EFLG)), (96, faults::TXWAR | faults::EWARN));
    assert_eq!(read(&mut can, CANINTF), MERRF | ERRIF);
    fail(&mut can, 100, ErrorCode::Acknowledgement);
    assert_eq!(read(&mut can, TEC), 128);
    assert_eq!(read(&mut can, EFLG), faults::TXEP | faults::TXWAR | faults::EWARN);
    assert_eq!(can.pending(), 1);
}

#[test]
fn bus_off_ends_by_itself_after_128_times_11_recessive_bits_and_the_message_is_still_pending() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    fail(&mut can, 32, ErrorCode::BitDominant);
    assert_eq!(read(&mut can, EFLG) & faults::TXBO, faults::TXBO);
    assert!(!can.takes_part());
    write(&mut can, CANINTF, &[0]);
    can.idle(127 * 11);
    // The failed frame ended with 11 of them.
    assert!(can.takes_part());
    assert_eq!((read(&mut can, TEC), read(&mut can, EFLG), read(&mut can, CANINTF)), (0, 0, ERRIF));
    assert_eq!(can.next_transmission().unwrap().mailbox, 0);
}

#[test]
fn configuration_mode_clears_the_error_counters() {
    let mut can = normal();
    for _ in 0..200 {
        can.begin_reception(None);
        can.fail_reception(ErrorCode::Crc);
    }
    assert_eq!(
        (read(&mut can, REC), read(&mut can, EFLG)),
        (200, faults::RXEP | faults::RXWAR | faults::EWARN)
    );
    modify(&mut can, CANCTRL, REQOP, 4 << 5);
    assert_eq!((read(&mut can, REC), read(&mut can, EFLG)), (0, 0));
}

#[test]
fn one_success_ends_error_passive_reception() {
    let mut can = normal();
    for _ in 0..128 {
        can.begin_reception(None);
        can.fail_reception(ErrorCode::Crc);
    }
    receive(&mut can, &WireFrame::standard(1, &[]));
    assert_eq!(read(&mut can, REC), 120);
}

#[test]
fn on_a_bus_it_sends_and_hears_in_the_time_of_the_frames() {
    let bus = CanBus::with(normal(), 500_000);
    let station = bus.join();
    station.send(WireFrame::standard(0x222, &[5]));
    bus.pass(std::time::Duration::from_micros(2) * 200);
    assert_eq!(bus.controller().accepted(), [WireFrame::standard(0x222, &[5])]);
    bus.act(|can| load_and_request(can, 0, 0x111, &[]));
    bus.pass(std::time::Duration::from_micros(2) * 100);
    assert_eq!(station.heard.try_recv(), Ok(WireFrame::standard(0x111, &[])));
}

#[test]
fn what_is_not_modelled_is_refused() {
    let mut can = configured();
    for bytes in [&[0x02, CANCTRL, 1 << 5][..], &[0x02, CANCTRL, 2 << 5], &[0x02, BFPCTRL, 1], &[0xFF]] {
        can.select();
        assert!(bytes.iter().any(|byte| can.exchange(*byte).is_err()), "{bytes:02X?}");
    }
}
