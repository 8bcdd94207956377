//! The driver of the MCP2515 against the model of its data sheet. The two share no constant.

use std::cell::RefCell;
use std::convert::Infallible;
use std::rc::Rc;

use bus_slcan::ClassicFrame;
use embedded_can::{Id, nb::Can};
use embedded_hal::spi::{ErrorType, Operation, SpiDevice};
use host_tests::can_controller::BusController;
use host_tests::can_wire::WireFrame;
use host_tests::mcp2515::{Mcp2515 as Model, TRANSMIT_BUFFERS};
use wsg_bridge_fw::can::{CanConfig, CanController, Mcp2515, Mcp2515Buffers, Withdrawal};

const CRYSTAL_HZ: u32 = 16_000_000;

/// A frame for each transmit buffer, in the order of transmission. The first buffer is the gripper's.
const SENT: [u16; TRANSMIT_BUFFERS] = [0x120, 0x200, 0x300];

#[derive(Clone)]
struct Chip(Rc<RefCell<Model>>);

impl ErrorType for Chip {
    type Error = Infallible;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut chip = self.0.borrow_mut();
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
        Ok(())
    }
}

impl Chip {
    /// Sends the frame that wins arbitration, and returns it.
    fn send_next(&self) -> WireFrame {
        let mut chip = self.0.borrow_mut();
        let next = chip.next_transmission().expect("a frame that waits");
        chip.begin_transmission(next.mailbox);
        chip.end_transmission(next.mailbox);
        next.frame
    }

    fn receive(&self, frame: &WireFrame) {
        let mut chip = self.0.borrow_mut();
        chip.begin_reception(None);
        chip.end_reception(frame);
    }
}

struct Bench {
    chip: Chip,
    driver: Mcp2515<Chip, ClassicFrame>,
    received: &'static Mcp2515Buffers,
}

impl Bench {
    fn new() -> Self {
        let chip = Chip(Rc::new(RefCell::new(Model::new(CRYSTAL_HZ))));
        let received: &'static Mcp2515Buffers = Box::leak(Box::new(Mcp2515Buffers::new()));
        let mut driver = Mcp2515::new(chip.clone(), CRYSTAL_HZ, received);
        driver.start(&CanConfig::DEFAULT);
        chip.0.borrow_mut().idle(11);
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
        while self.chip.0.borrow().next_transmission().is_some() {
            let Id::Standard(id) = self.chip.send_next().id else { panic!("an extended identifier") };
            ids.push(id.as_raw());
        }
        ids
    }
}

#[test]
fn mcp2515_joins_the_bus_at_the_configured_rate() {
    let mut bench = Bench::new();
    let chip = bench.chip.0.borrow();
    assert_eq!((chip.rate(), chip.sample_point(), chip.takes_part()), (500_000, 875, true));
    assert_eq!(chip.violations(), [""; 0]);
    drop(chip);
    assert!(!bench.driver.health().is_off);
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
    frames.iter().for_each(|frame| bench.chip.receive(frame));
    assert!(!bench.chip.0.borrow().interrupt_pin(), "INT is low");
    assert!(bench.received.serve(&mut bench.chip.clone()));
    assert!(bench.chip.0.borrow().interrupt_pin() && bench.chip.0.borrow().lost().is_empty());
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
        let mailbox = bench.chip.0.borrow().next_transmission().unwrap().mailbox;
        bench.chip.0.borrow_mut().begin_transmission(mailbox);
        assert_eq!(bench.driver.withdraw(id), Withdrawal::Undecided);
        bench.chip.0.borrow_mut().end_transmission(mailbox);
        assert_eq!(bench.driver.withdraw(id), Withdrawal::TooLate);
        assert_eq!(bench.sent(), SENT[at + 1..]);
    }
}
