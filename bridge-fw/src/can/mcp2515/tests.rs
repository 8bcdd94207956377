//! Tests of the driver with a model of the registers it uses, according to the data sheet.

use core::cell::RefCell;
use core::convert::Infallible;
use std::boxed::Box;
use std::rc::Rc;
use std::vec::Vec;

use bus_slcan::ClassicFrame;
use embedded_can::nb::Can;
use embedded_hal::spi::ErrorType;

use super::*;

const CRYSTAL_HZ: u32 = 16_000_000;
/// An instruction of the handler.
const READ_STATUS: u8 = 0xA0;

/// Registers of the modelled chip.
struct Registers {
    values: [u8; 128],
    /// No chip: pulled-up lines.
    is_missing: bool,
    resets: u32,
    /// A frame of one byte that a buffer receives as soon as it was read.
    comes_next: Option<(usize, [u8; 4], u8)>,
    /// The transmit buffer whose frame is on the bus.
    sending: Option<usize>,
}

#[derive(Clone)]
struct Chip(Rc<RefCell<Registers>>);

impl Chip {
    fn new() -> Self {
        let registers =
            Registers { values: [0; 128], is_missing: false, resets: 0, comes_next: None, sending: None };
        Self(Rc::new(RefCell::new(registers)))
    }

    fn at(&self, register: u8) -> u8 {
        self.0.borrow().values[usize::from(register)]
    }

    fn set(&self, register: u8, value: u8) {
        self.0.borrow_mut().values[usize::from(register)] = value;
    }

    /// Places a frame in a receive buffer.
    fn receive(&self, buffer: usize, id: [u8; 4], data: &[u8]) {
        self.0.borrow_mut().receive(buffer, id, data);
    }

    fn status(&self) -> u8 {
        self.0.borrow().status()
    }

    /// Removes the frame with a transmit request in this buffer. Returns its first identifier register and its data.
    fn sent(&self, buffer: usize) -> Option<(u8, Vec<u8>)> {
        let mut chip = self.0.borrow_mut();
        let control = usize::from(TXBCTRL[buffer]);
        if chip.values[control] & TXREQ == 0 {
            return None;
        }
        chip.values[control] &= !TXREQ;
        let len = usize::from(chip.values[control + 5] & 0xF);
        Some((chip.values[control + 1], chip.values[control + 6..control + 6 + len].to_vec()))
    }
}

impl Registers {
    fn reset(&mut self) {
        self.values = [0; 128];
        self.values[usize::from(CANSTAT)] = CONFIGURATION;
        self.values[usize::from(CANCTRL)] = 0x87;
        self.resets += 1;
    }

    fn receive(&mut self, buffer: usize, id: [u8; 4], data: &[u8]) {
        let start = usize::from(RXBCTRL[buffer]) + 1;
        self.values[start..start + 4].copy_from_slice(&id);
        self.values[start + 4] = data.len() as u8;
        self.values[start + 5..start + 5 + data.len()].copy_from_slice(data);
        self.values[usize::from(CANINTF)] |= 1 << buffer;
    }

    fn status(&self) -> u8 {
        let waits = |buffer: usize| self.values[usize::from(TXBCTRL[buffer])] & TXREQ != 0;
        let flags = self.values[usize::from(CANINTF)];
        (0..3).fold(flags & 0b11, |status, buffer| {
            let waits = if waits(buffer) { TXREQS[buffer] } else { 0 };
            let was_sent = if flags & TXIF[buffer] != 0 { TXIFS[buffer] } else { 0 };
            status | waits | was_sent
        })
    }

    /// Ends the frame on the bus.
    fn end_frame(&mut self, is_acknowledged: bool) {
        let Some(buffer) = self.sending.take() else { return };
        if is_acknowledged || self.values[usize::from(CANCTRL)] & ABAT != 0 {
            self.values[usize::from(TXBCTRL[buffer])] &= !TXREQ;
        }
        if is_acknowledged {
            self.values[usize::from(CANINTF)] |= TXIF[buffer];
        }
    }

    /// Aborts all waiting frames except the one on the bus.
    fn abort_all(&mut self) {
        for buffer in (0..3).filter(|&buffer| self.sending != Some(buffer)) {
            self.values[usize::from(TXBCTRL[buffer])] &= !TXREQ;
        }
    }

    /// Returns the chip's response to the bytes of one chip select.
    fn exchange(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = std::vec![0xFF; bytes.len()];
        if self.is_missing {
            return out;
        }
        match bytes {
            [RESET] => self.reset(),
            [READ, from, ..] => {
                for (place, value) in out[2..].iter_mut().zip(&self.values[usize::from(*from)..]) {
                    *place = *value;
                }
            }
            [WRITE, to, values @ ..] => {
                self.values[usize::from(*to)..][..values.len()].copy_from_slice(values);
                if *to == CANCTRL {
                    self.values[usize::from(CANSTAT)] = values[0] & MODE;
                }
            }
            [BIT_MODIFY, at, mask, value] => {
                let register = &mut self.values[usize::from(*at)];
                *register = *register & !mask | value & mask;
                if *at == CANCTRL && mask & value & ABAT != 0 {
                    self.abort_all();
                }
            }
            [READ_STATUS, ..] => {
                let status = self.status();
                out[1..].fill(status);
            }
            [read @ (0x90 | 0x94), ..] => {
                let buffer = usize::from(*read == 0x94);
                let start = usize::from(RXBCTRL[buffer]) + 1;
                out[1..].copy_from_slice(&self.values[start..start + bytes.len() - 1]);
                self.values[usize::from(CANINTF)] &= !(1 << buffer);
                if let Some((_, id, byte)) = self.comes_next.take_if(|(to, ..)| *to == buffer) {
                    self.receive(buffer, id, &[byte]);
                }
            }
            [load @ (0x40 | 0x42 | 0x44), values @ ..] => {
                let start = usize::from(TXBCTRL[usize::from(load - 0x40) / 2]) + 1;
                self.values[start..start + values.len()].copy_from_slice(values);
            }
            [rts @ (0x81 | 0x82 | 0x84)] => {
                let buffer = rts.trailing_zeros() as usize;
                self.values[usize::from(TXBCTRL[buffer])] |= TXREQ;
            }
            other => panic!("unknown instruction: {other:02X?}"),
        }
        out
    }
}

impl ErrorType for Chip {
    type Error = Infallible;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut bytes = Vec::new();
        for operation in operations.iter() {
            match operation {
                Operation::Write(written) => bytes.extend_from_slice(written),
                Operation::Read(read) => bytes.extend(read.iter().map(|_| 0)),
                Operation::TransferInPlace(both) => bytes.extend_from_slice(both),
                other => panic!("unexpected operation: {other:?}"),
            }
        }
        let mut given = self.0.borrow_mut().exchange(&bytes).into_iter();
        for operation in operations {
            match operation {
                Operation::Write(written) => drop(given.by_ref().take(written.len()).count()),
                Operation::Read(read) => {
                    read.iter_mut().zip(given.by_ref()).for_each(|(to, from)| *to = from)
                }
                Operation::TransferInPlace(both) => {
                    both.iter_mut().zip(given.by_ref()).for_each(|(to, from)| *to = from)
                }
                other => panic!("unexpected operation: {other:?}"),
            }
        }
        Ok(())
    }
}

fn on(chip: &Chip) -> Mcp2515<Chip, ClassicFrame> {
    Mcp2515::new(chip.clone(), CRYSTAL_HZ, Box::leak(Box::new(Mcp2515Buffers::new())))
}

fn started() -> (Chip, Mcp2515<Chip, ClassicFrame>) {
    let chip = Chip::new();
    let mut controller = on(&chip);
    controller.start(&CanConfig::DEFAULT);
    assert!(!controller.health().is_off);
    (chip, controller)
}

/// Runs the interrupt handler. Returns whether the interrupt may stay unmasked.
fn interrupt(chip: &Chip, controller: &Mcp2515<Chip, ClassicFrame>) -> bool {
    controller.received.serve(&mut chip.clone())
}

/// Returns all frames for the main loop.
fn received(controller: &mut Mcp2515<Chip, ClassicFrame>) -> Vec<ClassicFrame> {
    core::iter::from_fn(|| controller.receive().ok()).collect()
}

fn frame(id: u16, data: &[u8]) -> ClassicFrame {
    ClassicFrame::new(StandardId::new(id).unwrap(), data).unwrap()
}

fn gripper_id() -> u16 {
    CanConfig::DEFAULT.gripper.controller().transmit.as_raw()
}

#[test]
fn every_selectable_rate_is_met_if_the_crystal_divides_to_it() {
    // Prescaler, quanta before and after the sample point.
    let of = |crystal, rate| {
        BitTiming::for_rate(crystal, rate).map(|BitTiming { registers: [cnf3, cnf2, cnf1] }| {
            assert_eq!(cnf2 & BTLMODE, BTLMODE);
            let before = 1 + u32::from(cnf2 & 0b111) + 1 + u32::from(cnf2 >> 3 & 0b111) + 1;
            (u32::from(cnf1 & 0x3F) + 1, before, u32::from(cnf3) + 1)
        })
    };
    for (crystal, rate, expected) in [
        (16_000_000, 1_000, Some((1, 6, 2))),
        (16_000_000, 500, Some((1, 14, 2))),
        (16_000_000, 250, Some((2, 14, 2))),
        (16_000_000, 125, Some((4, 14, 2))),
        (8_000_000, 500, Some((1, 6, 2))),
        (8_000_000, 1_000, None),
        (16_000_000, 300, None),
        (16_000_000, 0, None),
        // The largest prescaler is 64.
        (256_000_000, 125, Some((64, 14, 2))),
        (512_000_000, 125, None),
    ] {
        assert_eq!(of(crystal, rate), expected, "{crystal} Hz, {rate} kbit/s");
        if let Some((prescaler, before, behind)) = expected {
            assert_eq!(crystal / (2 * prescaler * (before + behind)), u32::from(rate) * 1_000);
        }
    }
}

#[test]
fn every_identifier_bit_and_the_length_pass_through_registers() {
    let standard = (0..11).map(|bit| Id::Standard(StandardId::new(1 << bit).unwrap()));
    let extended = (0..29).map(|bit| Id::Extended(ExtendedId::new(1 << bit).unwrap()));
    for (id, len) in standard.chain(extended).zip((0..=8).cycle()) {
        let mut raw = RawFrame::default();
        raw[..4].copy_from_slice(&id_registers(id));
        raw[4] = len;
        let decoded: ClassicFrame = super::frame(raw).unwrap();
        assert_eq!((decoded.id(), decoded.dlc()), (id, usize::from(len)));
    }
}

#[test]
fn filters_accept_frames_for_the_bridge_and_reject_others() {
    let (chip, _) = started();
    let id_at = |at: u8| u16::from(chip.at(at)) << 3 | u16::from(chip.at(at + 1) >> 5);
    let passes = |id: u16| {
        let found =
            |mask: u8, filters: &[u8]| filters.iter().any(|&filter| (id ^ id_at(filter)) & id_at(mask) == 0);
        found(RXM[0], &RXF[..2]) || found(RXM[1], &RXF[2..])
    };
    let CanConfig { gripper, node, .. } = CanConfig::DEFAULT;
    let node = u16::from(node.node);
    for wanted in [gripper.controller().receive.as_raw(), 0, 0x080, 0x200 + node, 0x600 + node, 0x701, 0x77F]
    {
        assert!(passes(wanted), "{wanted:#x}");
    }
    for foreign in [0x181, 0x601, 0x222, 0x081] {
        assert!(!passes(foreign), "{foreign:#x}");
    }
}

#[test]
fn missing_chip_is_bus_off_until_it_responds() {
    let chip = Chip::new();
    chip.0.borrow_mut().is_missing = true;
    let mut controller = on(&chip);
    controller.start(&CanConfig::DEFAULT);
    assert!(controller.health().is_off);
    assert_eq!(controller.transmit(&frame(1, &[])), Err(nb::Error::WouldBlock));

    chip.0.borrow_mut().is_missing = false;
    controller.recover();

    assert!(!controller.health().is_off);
}

#[test]
fn chip_that_lost_its_supply_is_set_up_again() {
    let (chip, mut controller) = started();
    chip.0.borrow_mut().reset();
    assert!(controller.health().is_off);

    controller.recover();

    assert!(!controller.health().is_off);
    assert_eq!(chip.at(CANCTRL), NORMAL);
    assert_eq!(chip.0.borrow().resets, 3);
}

#[test]
fn frames_to_the_gripper_have_their_own_buffer_with_priority() {
    let (chip, mut controller) = started();
    assert_eq!(controller.transmit(&frame(0x180, &[1])), Ok(None));
    assert_eq!(controller.transmit(&frame(0x280, &[2])), Ok(None));
    assert_eq!(controller.transmit(&frame(0x380, &[3])), Err(nb::Error::WouldBlock));

    assert_eq!(controller.transmit(&frame(gripper_id(), &[4, 5])), Ok(None));
    assert_eq!(controller.transmit(&frame(gripper_id(), &[6])), Err(nb::Error::WouldBlock));

    assert_eq!(chip.at(TXBCTRL[0]) & TXP_HIGHEST, TXP_HIGHEST);
    assert_eq!(chip.sent(0), Some(((gripper_id() >> 3) as u8, std::vec![4, 5])));
    assert_eq!(chip.sent(1), Some((0x30, std::vec![1])));
    assert_eq!(controller.transmit(&frame(gripper_id(), &[6])), Ok(None));
}

#[test]
fn frames_with_one_identifier_never_wait_in_two_buffers() {
    let (chip, mut controller) = started();
    assert_eq!(controller.transmit(&frame(0x180, &[1])), Ok(None));
    assert_eq!(controller.transmit(&frame(0x180, &[2])), Err(nb::Error::WouldBlock));
    assert_eq!(controller.transmit(&frame(0x181, &[3])), Ok(None));
    assert_eq!(chip.sent(1).unwrap().1, [1]);
    assert_eq!(controller.transmit(&frame(0x181, &[4])), Err(nb::Error::WouldBlock));
    assert_eq!(controller.transmit(&frame(0x180, &[2])), Ok(None));
}

#[test]
fn received_frames_keep_their_order() {
    let (chip, mut controller) = started();
    let id = id_registers(Id::Standard(standard(0x121)));
    chip.receive(0, id, &[1]);
    chip.receive(1, id, &[2]);
    // The first buffer receives the next frame as soon as it is free, before the second is read.
    chip.0.borrow_mut().comes_next = Some((0, id, 3));
    assert!(interrupt(&chip, &controller));
    let data: Vec<u8> = received(&mut controller).iter().map(|frame| frame.data()[0]).collect();
    assert_eq!(data, [1, 2, 3]);
}

#[test]
fn full_queue_leaves_frames_in_the_controller() {
    let (chip, mut controller) = started();
    let id = id_registers(Id::Standard(standard(0x121)));
    let mut came = 0;
    loop {
        chip.receive(0, id, &[came]);
        came += 1;
        if !interrupt(&chip, &controller) {
            break;
        }
    }
    assert!(usize::from(came) > crate::can::bus::MAX_RECEIVED_PER_POLL);
    assert_eq!(chip.status() & 0b11, 0b01, "the last frame is still in the buffer");
    assert!(!interrupt(&chip, &controller));
    let data = |frames: Vec<ClassicFrame>| frames.iter().map(|frame| frame.data()[0]).collect::<Vec<u8>>();
    assert!(data(received(&mut controller)).into_iter().eq(0..came - 1));

    assert!(interrupt(&chip, &controller));

    assert!(controller.received.has_received());
    assert_eq!(data(received(&mut controller)), [came - 1]);
    assert!(!controller.received.has_received());
    assert_eq!(controller.health(), Health::default());
}

#[test]
fn handler_ignores_a_controller_that_is_not_set_up() {
    let chip = Chip::new();
    chip.0.borrow_mut().is_missing = true;
    let mut controller = on(&chip);
    assert!(!interrupt(&chip, &controller));
    controller.start(&CanConfig::DEFAULT);
    // Pulled-up lines always read as two frames.
    assert!(!interrupt(&chip, &controller));
    assert!(!controller.received.has_received());

    chip.0.borrow_mut().is_missing = false;
    controller.recover();
    assert!(interrupt(&chip, &controller));

    // The chip disappears during reception. The handler ends, and frames received before the next set-up are discarded.
    chip.0.borrow_mut().is_missing = true;
    assert!(!interrupt(&chip, &controller));
    assert!(controller.health().is_off);
    chip.0.borrow_mut().is_missing = false;
    chip.receive(0, [0; 4], &[1]);
    assert!(!interrupt(&chip, &controller));
    assert_eq!(chip.status() & 0b11, 0b01);
    assert_eq!(received(&mut controller), []);
    controller.recover();
    assert!(!controller.health().is_off);
    assert_eq!(received(&mut controller), []);

    // The same for a controller whose restart fails.
    controller.start(&CanConfig { kbit_rate: 300, ..CanConfig::DEFAULT });
    assert!(!interrupt(&chip, &controller));
}

#[test]
fn restart_resets_the_order_of_the_buffers() {
    let (chip, mut controller) = started();
    // The queue becomes full after the first of two frames, and a third follows.
    let id = id_registers(Id::Standard(standard(0x121)));
    chip.receive(0, id, &[0]);
    while interrupt(&chip, &controller) {
        chip.receive(0, id, &[0]);
    }
    assert!(controller.receive().is_ok());
    chip.receive(1, id, &[1]);
    assert!(!interrupt(&chip, &controller));
    assert_eq!(chip.status() & 0b11, 0b10);

    controller.start(&CanConfig::DEFAULT);
    chip.receive(0, id, &[2]);
    chip.receive(1, id, &[3]);

    assert!(interrupt(&chip, &controller));
    let data: Vec<u8> = received(&mut controller).iter().map(|frame| frame.data()[0]).collect();
    assert_eq!(data, [2, 3]);
}

#[test]
fn identifiers_lengths_and_remote_frames_convert_both_ways() {
    let (chip, mut controller) = started();
    for (id, registers) in [
        (Id::Standard(standard(0x7A5)), [0xF4, 0xA0, 0, 0]),
        (Id::Extended(ExtendedId::new(0x1234_5678).unwrap()), [0x91, 0xA8, 0x56, 0x78]),
    ] {
        assert_eq!(id_registers(id), registers);
        chip.receive(0, registers, &[1, 2, 3, 4, 5, 6, 7, 8]);
        assert!(interrupt(&chip, &controller));
        let frame = controller.receive().unwrap();
        assert_eq!((frame.id(), frame.data().len()), (id, 8));
    }
    chip.receive(0, [0xF4, 0xA0 | SRR, 0, 0], &[]);
    assert!(interrupt(&chip, &controller));
    assert!(controller.receive().unwrap().is_remote_frame());
    // A length above 8 means 8.
    chip.receive(0, [0xF4, 0xA0, 0, 0], &[0; 8]);
    chip.set(RXBCTRL[0] + 5, 0xF);
    assert!(interrupt(&chip, &controller));
    assert_eq!(controller.receive().unwrap().data().len(), 8);
}

#[test]
fn lost_frame_is_reported_once() {
    let (chip, mut controller) = started();
    chip.set(EFLG, 1 << 7);
    assert!(!controller.health().is_off);
    assert_eq!(controller.receive(), Err(nb::Error::Other(Overrun)));
    assert_eq!(controller.receive(), Err(nb::Error::WouldBlock));
    assert_eq!(chip.at(EFLG), 0);
}

#[test]
fn after_bus_off_nothing_is_sent_or_received_until_recover() {
    let (chip, mut controller) = started();
    let gripper = Id::Standard(standard(gripper_id()));
    assert_eq!(controller.transmit(&frame(gripper_id(), &[])), Ok(None));
    chip.set(EFLG, TXBO | PASSIVE);
    let health = controller.health();
    assert!(health.is_off && health.is_passive && health.transmit_errors == 255);

    // The chip has recovered by itself.
    chip.set(EFLG, 0);
    chip.receive(0, id_registers(Id::Standard(standard(0x121))), &[1]);
    assert!(interrupt(&chip, &controller));
    assert_eq!(controller.receive(), Err(nb::Error::WouldBlock));
    assert!(controller.health().is_off);
    assert_eq!(controller.transmit(&frame(gripper_id(), &[])), Err(nb::Error::WouldBlock));
    assert_eq!(controller.withdraw(gripper), Withdrawal::TooLate);
    assert!(chip.sent(0).is_some());
    controller.recover();

    assert!(!controller.health().is_off);
    assert_eq!(controller.receive(), Err(nb::Error::WouldBlock));
    assert_eq!(controller.transmit(&frame(gripper_id(), &[])), Ok(None));
}

#[test]
fn aborted_frames_are_not_sent() {
    let (chip, mut controller) = started();
    for id in [gripper_id(), 0x180, 0x280] {
        assert_eq!(controller.transmit(&frame(id, &[1])), Ok(None));
    }
    controller.abort();
    assert_eq!([chip.sent(0), chip.sent(1), chip.sent(2)], [None, None, None]);
}

#[test]
fn one_frame_is_withdrawn_and_the_others_are_requested_again() {
    let (chip, mut controller) = started();
    let gripper = Id::Standard(standard(gripper_id()));
    for id in [gripper_id(), 0x180, 0x280] {
        assert_eq!(controller.transmit(&frame(id, &[1])), Ok(None));
    }
    assert_eq!(controller.withdraw(Id::Standard(standard(0x380))), Withdrawal::TooLate);

    assert_eq!(controller.withdraw(gripper), Withdrawal::Withdrawn);

    assert_eq!(chip.at(CANCTRL) & ABAT, 0);
    assert_eq!(chip.sent(0), None);
    assert!(chip.sent(1).is_some() && chip.sent(2).is_some());
    assert_eq!(controller.withdraw(gripper), Withdrawal::TooLate);
}

#[test]
fn withdrawal_is_undecided_until_the_frame_on_the_bus_ends() {
    for (is_acknowledged, outcome) in [(true, Withdrawal::TooLate), (false, Withdrawal::Withdrawn)] {
        let (chip, mut controller) = started();
        let gripper = Id::Standard(standard(gripper_id()));
        // The flag of an earlier sent frame is still set.
        chip.set(CANINTF, TXIF[0]);
        assert_eq!(controller.transmit(&frame(gripper_id(), &[1])), Ok(None));
        assert_eq!(controller.transmit(&frame(0x180, &[2])), Ok(None));
        chip.0.borrow_mut().sending = Some(0);

        assert_eq!(controller.withdraw(gripper), Withdrawal::Undecided);
        assert_eq!(controller.transmit(&frame(0x280, &[3])), Err(nb::Error::WouldBlock));
        chip.0.borrow_mut().end_frame(is_acknowledged);

        assert_eq!(controller.withdraw(gripper), outcome);
        assert_eq!(chip.sent(1), Some((0x30, std::vec![2])));
        assert_eq!(controller.transmit(&frame(gripper_id(), &[4])), Ok(None));
    }
}
