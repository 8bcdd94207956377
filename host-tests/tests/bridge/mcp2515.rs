//! The driver of the MCP2515 against the model of its data sheet. The two share no constant.

use std::convert::Infallible;
use std::time::Duration;

use bus_slcan::ClassicFrame;
use embedded_can::nb::Can;
use embedded_can::{Frame, Id};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use host_tests::can_bus::{CanBus, Fault, Station};
use host_tests::can_controller::BusController;
use host_tests::can_wire::WireFrame;
use host_tests::mcp2515::{Mcp2515 as Model, TRANSMIT_BUFFERS};
use wsg_bridge_fw::can::{CanConfig, CanController, Mcp2515, Mcp2515Buffers, Withdrawal};

const CRYSTAL_HZ: u32 = 16_000_000;
const RATE: u32 = 500_000;

/// Part of a frame, and longer than a frame.
const BEGUN: Duration = Duration::from_micros(40);
const OVER: Duration = Duration::from_millis(1);

/// A frame for each transmit buffer, in the order of transmission. The first buffer is the gripper's.
const SENT: [u16; TRANSMIT_BUFFERS] = [0x120, 0x200, 0x300];

/// SPI between driver and chip.
#[derive(Clone)]
struct Chip(CanBus<Model>);

impl ErrorType for Chip {
    type Error = Infallible;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        self.0.act(|chip| {
            chip.select();
            for operation in operations {
                match operation {
                    Operation::Write(bytes) => {
                        for byte in *bytes {
                            chip.exchange(*byte).unwrap();
                        }
                    }
                    Operation::Read(bytes) => bytes.fill_with(|| chip.exchange(0).unwrap()),
                    Operation::TransferInPlace(bytes) => {
                        bytes.iter_mut().for_each(|byte| *byte = chip.exchange(*byte).unwrap());
                    }
                    Operation::Transfer(..) | Operation::DelayNs(_) => panic!("the driver uses neither"),
                }
            }
            chip.deselect();
        });
        Ok(())
    }
}

impl Chip {
    /// Sends the frame that wins arbitration, and returns it.
    fn send_next(&self) -> WireFrame {
        self.0.act(|chip| {
            let next = chip.next_transmission().expect("a frame that waits");
            chip.begin_transmission(next.mailbox);
            chip.end_transmission(next.mailbox);
            next.frame
        })
    }

    /// Returns a copy of the controller.
    fn look(&self) -> Model {
        self.0.controller()
    }
}

struct Bench {
    chip: Chip,
    driver: Mcp2515<Chip, ClassicFrame>,
    received: &'static Mcp2515Buffers,
}

impl Bench {
    fn new() -> Self {
        let chip = Chip(CanBus::with(Model::new(CRYSTAL_HZ), RATE));
        let received: &'static Mcp2515Buffers = Box::leak(Box::new(Mcp2515Buffers::new()));
        let mut driver = Mcp2515::new(chip.clone(), CRYSTAL_HZ, received);
        driver.start(&CanConfig { kbit_rate: (RATE / 1_000) as u16, ..CanConfig::DEFAULT });
        chip.0.pass(OVER);
        assert!(!driver.health().is_off);
        Self { chip, driver, received }
    }

    fn transmit(&mut self, frame: WireFrame) {
        assert_eq!(self.driver.transmit(&frame.to().unwrap()), Ok(None));
    }

    /// Fills the transmit buffers. Of buffers with the same priority, the chip sends the last one first (3.3).
    fn fill(&mut self) {
        let [gripper, second, third] = SENT;
        for id in [gripper, third, second] {
            self.transmit(WireFrame::standard(id, &[id as u8]));
        }
    }

    /// Sends all frames, and returns their identifiers.
    fn sent(&self) -> Vec<u16> {
        let mut ids = vec![];
        while self.chip.look().next_transmission().is_some() {
            let Id::Standard(id) = self.chip.send_next().id else { panic!("an extended identifier") };
            ids.push(id.as_raw());
        }
        ids
    }
}

#[test]
fn mcp2515_joins_the_bus_at_the_configured_rate() {
    let chip = Bench::new().chip.look();
    let timing = chip.bit_timing();
    assert_eq!((timing.rate, timing.sample_point, chip.takes_part()), (RATE, 875, true));
    assert_eq!(chip.violations(), [""; 0]);
}

#[test]
fn mcp2515_sends_data_and_remote_frames_of_both_formats() {
    let mut bench = Bench::new();
    for frame in [
        WireFrame::standard(0x120, &[1, 2, 3]),
        WireFrame::standard(0x121, &[0; 4]).remote(),
        WireFrame::extended(0x1234_5678, &[9; 8]),
    ] {
        bench.transmit(frame);
        assert_eq!(bench.chip.send_next(), frame);
    }
}

#[test]
fn mcp2515_receives_two_frames_before_the_handler_serves_it() {
    let mut bench = Bench::new();
    let id = CanConfig::DEFAULT.gripper.controller().receive.as_raw();
    let frames = [1, 2].map(|byte| WireFrame::standard(id, &[byte]));
    bench.chip.0.burst(&frames);
    assert!(!bench.chip.look().interrupt_pin(), "INT is low");
    assert!(bench.received.serve(&mut bench.chip.clone()));
    assert!(bench.chip.look().interrupt_pin() && bench.chip.look().lost().is_empty());
    for frame in frames {
        assert_eq!(bench.driver.receive(), Ok(frame.to().unwrap()));
    }
}

#[test]
fn mcp2515_withdraws_a_frame_from_any_buffer_and_sends_the_rest() {
    for (at, withdrawn) in SENT.into_iter().enumerate() {
        let mut bench = Bench::new();
        // Each buffer has sent a frame before, which must not be mistaken for this one.
        bench.fill();
        assert_eq!(bench.sent(), SENT);
        bench.fill();
        let id = WireFrame::standard(withdrawn, &[]).id;
        assert_eq!(bench.driver.withdraw(id), Withdrawal::Withdrawn);
        assert_eq!(bench.sent(), [&SENT[..at], &SENT[at + 1..]].concat());

        // Too late: the frame is on the bus.
        bench.fill();
        for _ in &SENT[..at] {
            bench.chip.send_next();
        }
        let mailbox = bench.chip.look().next_transmission().unwrap().mailbox;
        bench.chip.0.act(|chip| chip.begin_transmission(mailbox));
        assert_eq!(bench.driver.withdraw(id), Withdrawal::Undecided);
        bench.chip.0.act(|chip| chip.end_transmission(mailbox));
        assert_eq!(bench.driver.withdraw(id), Withdrawal::TooLate);
        assert_eq!(bench.sent(), SENT[at + 1..]);
    }
}

/// Returns a bus, an acknowledging station, and a driver whose chip is on the bus.
fn started() -> (CanBus<Model>, Station<Model>, Mcp2515<Chip, ClassicFrame>) {
    let Bench { chip: Chip(bus), driver, .. } = Bench::new();
    let station = bus.join();
    (bus, station, driver)
}

fn gripper() -> Id {
    CanConfig::DEFAULT.gripper.controller().transmit.into()
}

fn id(id: u16) -> Id {
    WireFrame::standard(id, &[]).id
}

fn give(driver: &mut Mcp2515<Chip, ClassicFrame>, id: Id, byte: u8) -> bool {
    driver.transmit(&ClassicFrame::new(id, &[byte; 8]).unwrap()).is_ok()
}

/// Returns the frames sent by the board: identifier and first data byte.
fn sent(bus: &CanBus<Model>) -> Vec<(Id, u8)> {
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
