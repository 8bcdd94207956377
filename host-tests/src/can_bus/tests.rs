//! Covers the bus's effects on a controller: arbitration, and the faults that a driver must survive. A more lenient
//! bus would hide a driver that sends in the wrong order or recovers too early.

use super::*;

const RATE: u32 = 500_000;

const BTR_500: u32 = (10 - 1) | (13 - 1) << 16 | (2 - 1) << 20 | (2 - 1) << 24;

/// Creates a bus whose board controller accepts every message into FIFO 0.
fn bus() -> CanBus {
    let mut bus = CanBus::new(RATE);
    for (offset, value) in
        [(0x00, 1), (0x1C, BTR_500), (0x200, 1), (0x20C, 1), (0x21C, 1), (0x200, 0), (0x00, 0)]
    {
        store(&mut bus, offset, value);
    }
    pass(&mut bus, 11);
    assert!(bus.controller().takes_part());
    bus
}

fn store(bus: &mut CanBus, offset: u32, value: u32) {
    bus.store(CAN1 + offset, Width::Word, value).unwrap();
}

fn load(bus: &mut CanBus, offset: u32) -> u32 {
    bus.load(CAN1 + offset, Width::Word).unwrap()
}

fn pass(bus: &mut CanBus, bits: u32) {
    bus.advance(Duration::from_micros(2) * bits);
}

fn request(bus: &mut CanBus, mailbox: u32, id: u32) {
    store(bus, 0x180 + 0x10 * mailbox, id << 21 | 1);
}

fn received(bus: &mut CanBus) -> Vec<u32> {
    let mut ids = Vec::new();
    while load(bus, 0x0C) & 0b11 != 0 {
        ids.push(load(bus, 0x1B0) >> 21);
        store(bus, 0x0C, 1 << 5);
    }
    ids
}

#[test]
fn the_lowest_identifier_wins_and_the_loser_follows() {
    let mut bus = bus();
    let (first, second) = (bus.join(), bus.join());
    request(&mut bus, 0, 0x200);
    first.send(WireFrame::standard(0x201, &[]));
    second.send(WireFrame::standard(0x100, &[]));
    pass(&mut bus, 3 * 47);
    let heard: Vec<_> = first.heard.try_iter().map(|frame| frame.id).collect();
    assert_eq!(heard, [0x100, 0x200].map(|id| WireFrame::standard(id, &[]).id));
    assert_eq!(received(&mut bus), [0x100, 0x201]);
    let heard: Vec<_> = second.heard.try_iter().map(|frame| frame.id).collect();
    assert_eq!(heard, [0x200, 0x201].map(|id| WireFrame::standard(id, &[]).id));
}

#[test]
fn a_frame_under_way_is_not_interrupted() {
    let mut bus = bus();
    let station = bus.join();
    station.send(WireFrame::standard(0x7FF, &[]));
    pass(&mut bus, 1);
    request(&mut bus, 0, 0);
    pass(&mut bus, 46);
    assert_eq!((received(&mut bus), bus.sent().len()), (vec![0x7FF], 0));
    pass(&mut bus, 47);
    assert_eq!(bus.sent().len(), 1);
}

#[test]
fn a_short_circuit_ends_in_bus_off() {
    let mut bus = bus();
    let station = bus.join();
    request(&mut bus, 0, 0x100);
    bus.set_fault(Fault::ShortCircuit);
    pass(&mut bus, 31 * FAILED_BITS);
    assert_eq!(load(&mut bus, 0x18) & 0b100, 0);
    pass(&mut bus, FAILED_BITS);
    assert_eq!(load(&mut bus, 0x18) & 0b100, 0b100);
    store(&mut bus, 0x00, 1);
    store(&mut bus, 0x00, 0);
    pass(&mut bus, 10_000);
    assert_eq!(load(&mut bus, 0x18) & 0b100, 0b100, "a shorted bus has no recessive bits");
    bus.set_fault(Fault::None);
    pass(&mut bus, 128 * 11 + 47);
    assert!(station.heard.try_recv().is_ok());
}

#[test]
fn a_different_rate_causes_errors_and_bus_off() {
    let mut bus = CanBus::new(250_000);
    for (offset, value) in
        [(0x00, 1), (0x1C, BTR_500), (0x200, 1), (0x20C, 1), (0x21C, 1), (0x200, 0), (0x00, 0)]
    {
        store(&mut bus, offset, value);
    }
    pass(&mut bus, 22);
    let station = bus.join();
    station.send(WireFrame::standard(0x100, &[]));
    pass(&mut bus, 100);
    assert!(received(&mut bus).is_empty());
    assert_eq!(load(&mut bus, 0x18) >> 24, 1);
    request(&mut bus, 0, 0x100);
    pass(&mut bus, 4_000);
    assert_eq!(load(&mut bus, 0x18) & 0b100, 0b100);
}
