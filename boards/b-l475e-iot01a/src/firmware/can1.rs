//! CAN1 by `bxcan`: PB8 (RX, D15) and PB9 (TX, D14), behind a transceiver for 3.3 V (RM0351, chapter 46).
//!
//! No emulator has this peripheral: nothing here has run anywhere yet. What could be kept out of here is in the library
//! and tested there.

use bxcan::filter::Mask32;
use bxcan::{FilterOwner, Instance, Interrupts, Mailbox, OverrunError, RegisterBlock, StandardId};
use cortex_m::peripheral::NVIC;
use embedded_can::ErrorKind;
use stm32_metapac::{CAN1, Interrupt, RCC, interrupt};
use wsg_bridge_fw::can::{CanConfig, CanController, Health};

use crate::clock::HCLK_HZ;

/// Quanta of a bit: one to synchronise, 13 before and 2 behind the sample point, which so is at 87.5 %.
const BEFORE_SAMPLE: u32 = 13;
const BEHIND_SAMPLE: u32 = 2;
const QUANTA: u32 = 1 + BEFORE_SAMPLE + BEHIND_SAMPLE;
const _: () = assert!((1 + BEFORE_SAMPLE) * 1_000 / QUANTA == 875);
/// By how many time quanta a bit may be made longer or shorter to stay in step.
const JUMP: u32 = 2;

/// What the clock is divided by for a rate of a thousand time quanta a second; a bus of N kbit/s takes an N-th.
const PRESCALER_AT_1_KBIT: u32 = HCLK_HZ / 1_000 / QUANTA;
const _: () = assert!(PRESCALER_AT_1_KBIT * 1_000 * QUANTA == HCLK_HZ);
const _: () = assert!(PRESCALER_AT_1_KBIT.is_multiple_of(1_000), "the clock divides to all four rates");

/// BTR: each field holds one less than it means.
fn bit_timing(config: &CanConfig) -> u32 {
    let prescaler = PRESCALER_AT_1_KBIT / u32::from(config.kbit_rate).max(1);
    (JUMP - 1) << 24 | (BEHIND_SAMPLE - 1) << 20 | (BEFORE_SAMPLE - 1) << 16 | prescaler.saturating_sub(1)
}

/// How often the peripheral's answer to a change of its mode is looked at. It takes a few cycles of the bus clock.
const MAX_LOOKS: u32 = 10_000;

/// The peripheral, for `bxcan`.
pub(crate) struct Registers(());

// SAFETY: the block of CAN1, which nobody else in this program uses while a `Registers` exists, and there is one, in the
// controller. (`health` and `recover` go to the same block from within the controller.)
unsafe impl Instance for Registers {
    const REGISTERS: *mut RegisterBlock = 0x4000_6400 as *mut RegisterBlock;
}

// SAFETY: CAN1 of this chip has 14 filter banks of its own (RM0351, 46.1).
unsafe impl FilterOwner for Registers {
    const NUM_FILTER_BANKS: u8 = 14;
}

/// CAN1.
pub(crate) struct Controller {
    can: Option<bxcan::Can<Registers>>,
}

pub(crate) const fn new() -> Controller {
    Controller { can: None }
}

/// Starts the controller: only what the bridge may want passes its filters.
pub(crate) fn start(controller: &mut Controller, config: &CanConfig) {
    RCC.apb1enr1().modify(|w| w.set_can1en(true));
    let _ = RCC.apb1enr1().read();
    let mut can = bxcan::Can::builder(Registers(()))
        .set_bit_timing(bit_timing(config))
        .set_automatic_retransmit(true)
        .leave_disabled();
    {
        let mut filters = can.modify_filters();
        filters.clear();
        let exact = |id: u16| StandardId::new(id).map(|id| Mask32::frames_with_std_id(id, StandardId::MAX));
        let masked = |id: u16, mask: u16| {
            Some(Mask32::frames_with_std_id(StandardId::new(id)?, StandardId::new(mask)?))
        };
        let wanted = [
            exact(config.gripper.controller().receive.as_raw()),
            // NMT; SYNC; what is for this node; heartbeats.
            exact(0),
            exact(0x080),
            masked(config.node.node.into(), 0x07F),
            masked(0x700, 0x780),
        ];
        for (bank, filter) in wanted.into_iter().enumerate() {
            if let Some(filter) = filter {
                filters.enable_bank(bank as u8, bxcan::Fifo::Fifo0, filter);
            }
        }
    }
    can.enable_interrupts(Interrupts::FIFO0_MESSAGE_PENDING | Interrupts::TRANSMIT_MAILBOX_EMPTY);
    // It synchronises in its own time; the first frames wait for that.
    let _ = can.enable_non_blocking();
    no_automatic_recovery();
    controller.can = Some(can);
    rearm(controller);
}

/// `bxcan` lets the hardware leave bus-off by itself. That is the bus-off policy's to decide.
fn no_automatic_recovery() {
    CAN1.mcr().modify(|w| w.set_abom(false));
}

/// Lets the interrupts wake the main loop again. Their handlers mask themselves: the work is the main loop's.
pub(crate) fn rearm(controller: &mut Controller) {
    if let Some(can) = &mut controller.can {
        can.clear_tx_interrupt();
    }
    // SAFETY: no critical section depends on these being masked; their handlers do nothing but mask them.
    unsafe {
        NVIC::unmask(Interrupt::CAN1_RX0);
        NVIC::unmask(Interrupt::CAN1_TX);
    }
}

/// Whether a frame waits.
pub(crate) fn has_received() -> bool {
    CAN1.rfr(0).read().fmp() != 0
}

/// Bytes of data in a frame. Its length field goes up to 15, which a node may send and which also means 8 (ISO 11898-1);
/// `bxcan` takes it at its word, and panics when the data is looked at.
const MAX_DATA_LEN: u8 = 8;

/// A frame that came and is not handed over.
#[derive(Debug)]
pub(crate) enum Lost {
    /// It found no room.
    Overrun,
    /// It announces more than [`MAX_DATA_LEN`] bytes, which nobody on this bus should.
    TooLong,
}

impl From<OverrunError> for Lost {
    fn from(_: OverrunError) -> Self {
        Self::Overrun
    }
}

impl embedded_can::Error for Lost {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Overrun => ErrorKind::Overrun,
            Self::TooLong => ErrorKind::Other,
        }
    }
}

impl embedded_can::nb::Can for Controller {
    type Frame = bxcan::Frame;
    type Error = Lost;

    fn transmit(&mut self, frame: &bxcan::Frame) -> nb::Result<Option<bxcan::Frame>, Lost> {
        let can = self.can.as_mut().ok_or(nb::Error::WouldBlock)?;
        embedded_can::nb::Can::transmit(can, frame).map_err(|error| error.map(Lost::from))
    }

    fn receive(&mut self) -> nb::Result<bxcan::Frame, Lost> {
        let can = self.can.as_mut().ok_or(nb::Error::WouldBlock)?;
        if has_received() && CAN1.rx(0).rdtr().read().dlc() > MAX_DATA_LEN {
            CAN1.rfr(0).write(|w| w.set_rfom(true));
            return Err(nb::Error::Other(Lost::TooLong));
        }
        embedded_can::nb::Can::receive(can).map_err(|error| error.map(Lost::from))
    }
}

impl CanController for Controller {
    fn health(&mut self) -> Health {
        let status = CAN1.esr().read();
        Health {
            is_off: status.boff(),
            is_passive: status.epvf(),
            transmit_errors: status.tec(),
            receive_errors: status.rec(),
        }
    }

    fn abort(&mut self) {
        if let Some(can) = &mut self.can {
            for mailbox in [Mailbox::Mailbox0, Mailbox::Mailbox1, Mailbox::Mailbox2] {
                can.abort(mailbox);
            }
        }
    }

    fn recover(&mut self) {
        // Into the mode for initialisation and out of it: then the controller waits for 128 times 11 recessive bits.
        CAN1.mcr().modify(|w| w.set_inrq(true));
        let entered = (0..MAX_LOOKS).any(|_| CAN1.msr().read().inak());
        CAN1.mcr().modify(|w| w.set_inrq(false));
        // If it was not entered, bus-off goes on, and the policy tries again.
        let _ = entered;
    }
}

#[interrupt]
fn CAN1_RX0() {
    NVIC::mask(Interrupt::CAN1_RX0);
}

#[interrupt]
fn CAN1_TX() {
    NVIC::mask(Interrupt::CAN1_TX);
}
