//! Tests withdrawal in the driver of `wsg-bridge-fw`, with the chip on a bus.

use std::convert::Infallible;
use std::time::Duration;

use bus_slcan::ClassicFrame;
use embedded_can::nb::Can;
use embedded_can::{Frame, Id, StandardId};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use wsg_bridge_fw::can::{CanConfig, CanController, Mcp2515 as Driver, Mcp2515Buffers, Withdrawal};

use super::*;
use crate::can_bus::{CanBus, Fault, Station};

const CRYSTAL_HZ: u32 = 16_000_000;
const RATE: u32 = 500_000;

/// Part of a frame, and longer than a frame.
const BEGUN: Duration = Duration::from_micros(40);
const OVER: Duration = Duration::from_millis(1);

/// SPI between driver and chip.
#[derive(Debug)]
struct Spi(CanBus<Mcp2515>);

impl ErrorType for Spi {
    type Error = Infallible;
}

impl SpiDevice for Spi {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.0.act(|can| {
            can.select();
            for operation in operations {
                match operation {
                    Operation::Write(bytes) => bytes.iter().for_each(|byte| {
                        can.exchange(*byte).unwrap();
                    }),
                    Operation::Read(bytes) => {
                        bytes.iter_mut().for_each(|byte| *byte = can.exchange(0).unwrap())
                    }
                    Operation::TransferInPlace(bytes) => {
                        bytes.iter_mut().for_each(|byte| *byte = can.exchange(*byte).unwrap())
                    }
                    other => panic!("the driver does not use {other:?}"),
                }
            }
            can.deselect();
        });
        Ok(())
    }
}

/// Returns a bus, an acknowledging station, and a driver whose chip is on the bus.
fn started() -> (CanBus<Mcp2515>, Station<Mcp2515>, Driver<Spi, ClassicFrame>) {
    let bus = CanBus::with(Mcp2515::new(CRYSTAL_HZ), RATE);
    let station = bus.join();
    let mut driver = Driver::new(Spi(bus.clone()), CRYSTAL_HZ, Box::leak(Box::new(Mcp2515Buffers::new())));
    driver.start(&CanConfig { kbit_rate: (RATE / 1_000) as u16, ..CanConfig::DEFAULT });
    bus.pass(OVER);
    assert!(!driver.health().is_off);
    (bus, station, driver)
}

fn gripper() -> Id {
    CanConfig::DEFAULT.gripper.controller().transmit.into()
}

fn id(id: u16) -> Id {
    StandardId::new(id).unwrap().into()
}

fn give(driver: &mut Driver<Spi, ClassicFrame>, id: Id, byte: u8) -> bool {
    driver.transmit(&ClassicFrame::new(id, &[byte; 8]).unwrap()).is_ok()
}

/// Returns the frames sent by the board: identifier and first data byte.
fn sent(bus: &CanBus<Mcp2515>) -> Vec<(Id, u8)> {
    assert_eq!(bus.controller().violations(), [""; 0]);
    bus.sent().iter().map(|frame| (frame.id, frame.data[0])).collect()
}

#[test]
fn waiting_frame_is_withdrawn_at_once_and_others_are_sent_once() {
    let (bus, station, mut driver) = started();
    station.send(WireFrame::standard(0x001, &[0; 8]));
    bus.pass(BEGUN);
    assert!(
        give(&mut driver, id(0x190), 1) && give(&mut driver, gripper(), 2) && give(&mut driver, id(0x590), 3)
    );

    assert_eq!(driver.withdraw(gripper()), Withdrawal::Withdrawn);

    bus.pass(10 * OVER);
    let mut others = sent(&bus);
    others.sort_by_key(|(_, byte)| *byte);
    assert_eq!(others, [(id(0x190), 1), (id(0x590), 3)]);
    assert_eq!(driver.withdraw(gripper()), Withdrawal::TooLate, "no pending frame");
    assert!(give(&mut driver, gripper(), 4));
    bus.pass(OVER);
    assert_eq!(sent(&bus).last(), Some(&(gripper(), 4)));
}

#[test]
fn frame_in_transmission_is_undecided_until_acknowledgement() {
    for (fault, outcome) in [(Fault::None, Withdrawal::TooLate), (Fault::Cut, Withdrawal::Withdrawn)] {
        let (bus, _station, mut driver) = started();
        // The result of an earlier frame must not be mistaken for this one's.
        assert!(give(&mut driver, gripper(), 1));
        bus.pass(OVER);
        bus.set_fault(fault);
        assert!(give(&mut driver, gripper(), 2));
        bus.pass(BEGUN);
        assert!(give(&mut driver, id(0x590), 3));

        assert_eq!(driver.withdraw(gripper()), Withdrawal::Undecided, "{fault:?}");
        assert_eq!(driver.withdraw(gripper()), Withdrawal::Undecided, "{fault:?}");
        assert!(!give(&mut driver, gripper(), 4) && !give(&mut driver, id(0x190), 5), "{fault:?}");
        bus.pass(OVER);
        assert_eq!(driver.withdraw(gripper()), outcome, "{fault:?}");

        bus.set_fault(Fault::None);
        bus.pass(10 * OVER);
        let was_sent = outcome == Withdrawal::TooLate;
        let expected: &[(Id, u8)] = if was_sent {
            &[(gripper(), 1), (gripper(), 2), (id(0x590), 3)]
        } else {
            &[(gripper(), 1), (id(0x590), 3)]
        };
        assert_eq!(sent(&bus), expected, "{fault:?}");
        assert!(!driver.health().is_off);
    }
}

#[test]
fn another_frame_in_transmission_is_not_sent_twice() {
    let (bus, _station, mut driver) = started();
    assert!(give(&mut driver, id(0x190), 1));
    bus.pass(BEGUN);
    assert!(give(&mut driver, gripper(), 2));
    assert_eq!(driver.withdraw(gripper()), Withdrawal::Undecided);
    bus.pass(OVER);
    assert_eq!(driver.withdraw(gripper()), Withdrawal::Withdrawn);
    bus.pass(10 * OVER);
    assert_eq!(sent(&bus), [(id(0x190), 1)]);
}

#[test]
fn withdrawal_interrupted_by_bus_off_does_not_silence_the_chip() {
    let (bus, _station, mut driver) = started();
    assert!(give(&mut driver, gripper(), 1));
    bus.pass(BEGUN);
    assert_eq!(driver.withdraw(gripper()), Withdrawal::Undecided);
    driver.abort();
    bus.pass(10 * OVER);
    assert!(give(&mut driver, id(0x190), 2));
    bus.pass(OVER);
    assert_eq!(sent(&bus).last(), Some(&(id(0x190), 2)));
}
