//! Covers the model's strictness: rejected accesses, overwritten messages, and flags that stay until cleared. The
//! driver obeys these rules, so neither its tests nor an emulated image would detect a model without them.

use super::*;
use crate::can_controller::testing::{fail, receive};

/// Bit timing for 500 kbit/s from 16 MHz.
const CNF: [u8; 3] = [0x00, 0xB5, 0x01];

/// Executes one instruction and returns its output bytes.
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

/// Creates a controller in Configuration mode with its timing set.
fn configured() -> Mcp2515 {
    let mut can = Mcp2515::new(16_000_000);
    write(&mut can, CNF3, &[CNF[2], CNF[1], CNF[0]]);
    can
}

/// Creates a controller in Normal mode with all filters off.
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

/// Returns SIDH and SIDL of a standard identifier.
fn standard(id: u16) -> [u8; 2] {
    [(id >> 3) as u8, (id << 5) as u8]
}

fn load_and_request(can: &mut Mcp2515, buffer: u8, id: u16, data: &[u8]) {
    let [sidh, sidl] = standard(id);
    spi(can, &[&[0x40 | buffer << 1, sidh, sidl, 0, 0, data.len() as u8], data].concat());
    spi(can, &[0x80 | 1 << buffer]);
}

#[test]
fn bit_modify_masks_only_registers_that_support_it() {
    let mut can = configured();
    write(&mut can, CANINTE, &[0b1010_0000]);
    modify(&mut can, CANINTE, 0b0000_1111, 0xFF);
    assert_eq!(read(&mut can, CANINTE), 0b1010_1111);
    write(&mut can, 0x00, &[0xF0]);
    modify(&mut can, 0x00, 0x01, 0x0F);
    assert_eq!(read(&mut can, 0x00), 0x0F);
}

#[test]
fn registers_in_use_take_no_write_and_record_a_violation() {
    // Timing, a mask, the data of a pending message, a received message.
    for register in [CNF1, 0x20, 0x36, 0x66] {
        let mut can = normal();
        load_and_request(&mut can, 0, 0x100, &[7]);
        let before = read(&mut can, register);
        write(&mut can, register, &[0x3F]);
        assert_eq!((read(&mut can, register), can.violations().len()), (before, 1), "{register:#X}");
    }
}

#[test]
fn a_message_is_aborted_at_once_unless_in_transmission() {
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
fn filters_choose_the_buffer_and_keep_others_out() {
    let mut can = configured();
    let [sidh, sidl] = standard(0x7FF);
    for mask in [0x20, 0x24] {
        write(&mut can, mask, &[sidh, sidl, 0, 0]);
    }
    for (filter, id) in [(0x00, 0x100), (0x04, 0x101), (0x08, 0x200), (0x10, 0x201), (0x14, 0x202)] {
        write(&mut can, filter, &standard(id));
    }
    // RXF5 is for extended identifiers.
    write(&mut can, 0x18, &[standard(0x300)[0], standard(0x300)[1] | 1 << 3]);
    start(&mut can);

    let mut flags = |frame: WireFrame| {
        receive(&mut can, &frame);
        let flags = read(&mut can, CANINTF);
        write(&mut can, CANINTF, &[0]);
        flags
    };
    assert_eq!(flags(WireFrame::standard(0x100, &[])), 1);
    assert_eq!(flags(WireFrame::standard(0x101, &[]).remote()), 1);
    assert_eq!(flags(WireFrame::standard(0x202, &[])), 2);
    assert_eq!(flags(WireFrame::standard(0x300, &[])), 0);
    assert_eq!(flags(WireFrame::extended(0x300 << 18 | 0x2_AAAA, &[])), 2);
    assert_eq!(flags(WireFrame::extended(0x100 << 18, &[])), 0);
}

#[test]
fn bus_off_ends_after_recessive_bits_with_message_still_pending() {
    let mut can = normal();
    load_and_request(&mut can, 0, 0x100, &[]);
    fail(&mut can, 32, ErrorCode::BitDominant);
    assert_eq!(read(&mut can, EFLG) & TXBO, TXBO);
    assert!(!can.takes_part());
    write(&mut can, CANINTF, &[0]);
    can.idle(127 * 11);
    // The failed frame already ended with 11 of them.
    assert!(can.takes_part());
    assert_eq!((read(&mut can, TEC), read(&mut can, EFLG), read(&mut can, CANINTF)), (0, 0, ERRIF));
    assert_eq!(can.next_transmission().unwrap().mailbox, 0);
}
