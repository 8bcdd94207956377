//! FDCAN1 on PA11 (RX, CN10-14) and PA12 (TX, CN10-12) as a classic CAN controller, connected to a 3.3 V transceiver (RM0440,
//! FDCAN).
//!
//! It runs from the crystal. The interrupt wakes the main loop, which does the work. Every wait is bounded.

use bus_slcan::ClassicFrame;
use cortex_m::peripheral::NVIC;
use embedded_can::{ErrorKind, Frame, Id};
use wsg_bridge_fw::can::{CanConfig, CanController, Health, TransmitBuffers, Withdrawal};
use wsg_stm32::pac::can::regs::{Txbar, Txbcr, Txbtie};
use wsg_stm32::pac::can::vals::{Anfe, Anfs, Tfqm};
use wsg_stm32::pac::rcc::vals::Fdcansel;
use wsg_stm32::pac::{FDCAN1, FDCANRAM1, Interrupt, RCC, interrupt};
use wsg_stm32::{BitTiming, Segments};

use super::clock::HSE_HZ;
use crate::message_ram::{ELEMENT_STRIDE, ELEMENTS, Fifo, element, filter, frame};

/// The receive error counter saturates at 127; a separate flag reports larger values.
const REC_BEYOND: u8 = 128;

/// All transmit buffers, as bits of the registers with one bit per buffer.
const ALL_BUFFERS: u32 = (1 << ELEMENTS) - 1;

/// Maximum number of status reads while the controller changes its mode, which takes a few cycles of the crystal.
const MAX_LOOKS: u32 = 10_000;

/// The driver of the controller FDCAN1.
#[derive(Debug)]
pub struct Can {
    config: Option<CanConfig>,
    /// Whether timing and filters are configured.
    is_set_up: bool,
    transmit: TransmitBuffers,
}

impl Can {
    /// Returns a controller that is not started. Call it once.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "a program has a single value")]
    pub const fn new() -> Self {
        Self { config: None, is_set_up: false, transmit: TransmitBuffers::new() }
    }

    /// Starts the controller. The crystal must run and the pins must be set up. The filters accept only frames for the bridge.
    pub fn start(&mut self, config: &CanConfig) {
        RCC.ccipr().modify(|w| w.set_fdcansel(Fdcansel::HSE));
        RCC.apb1enr1().modify(|w| w.set_fdcanen(true));
        let _ = RCC.apb1enr1().read();
        self.config = Some(*config);
        self.transmit.start(config);
        self.join();
        // SAFETY: no critical section depends on this interrupt being masked. The handler shares nothing.
        unsafe { NVIC::unmask(Interrupt::FDCAN1_IT0) };
    }

    /// Initializes the controller and joins the bus. After bus-off, it waits for 129 times 11 recessive bits first. Pending
    /// and received frames are discarded.
    fn join(&mut self) {
        let Some(config) = self.config else { return };
        FDCAN1.cccr().modify(|w| w.set_init(true));
        let entered = (0..MAX_LOOKS).any(|_| FDCAN1.cccr().read().init());
        self.is_set_up = entered && set_up(&config);
        if self.is_set_up {
            // Normal classic CAN mode. The controller synchronizes in the background; the first frames wait for that.
            FDCAN1.cccr().write(|_| {});
        }
    }
}

/// Returns whether a receive FIFO holds a frame.
#[must_use]
pub fn has_received() -> bool {
    FDCAN1.rxfs(0).read().ffl() != 0 || FDCAN1.rxfs(1).read().ffl() != 0
}

/// Configures timing, filters and interrupts in initialization mode. Returns whether the rate is supported.
fn set_up(config: &CanConfig) -> bool {
    let Some(timing) = BitTiming::for_rate(Segments::FDCAN, HSE_HZ, config.kbit_rate) else { return false };
    // Unlocks the registers, and empties FIFOs and transmit buffers.
    FDCAN1.cccr().modify(|w| w.set_cce(true));
    // Each field holds its value minus one.
    FDCAN1.nbtp().write(|w| {
        w.set_nbrp(timing.prescaler.saturating_sub(1));
        w.set_ntseg1(timing.before_sample.saturating_sub(1));
        w.set_ntseg2(timing.after_sample.saturating_sub(1));
        w.set_nsjw(timing.jump.saturating_sub(1));
    });
    let gripper = config.gripper.controller().receive.as_raw();
    let filters = [
        filter(Fifo::Gripper, gripper, 0x7FF),
        // NMT; SYNC; frames for this node; heartbeats.
        filter(Fifo::Others, 0x000, 0x7FF),
        filter(Fifo::Others, 0x080, 0x7FF),
        filter(Fifo::Others, config.node.node.into(), 0x07F),
        filter(Fifo::Others, 0x700, 0x780),
    ];
    for (n, filter) in filters.iter().enumerate() {
        FDCANRAM1.flssa(n).write_value(*filter);
    }
    FDCAN1.rxgfc().write(|w| {
        w.set_lss(filters.len() as u8);
        // All other frames are rejected. A frame for a full FIFO is lost and sets a flag.
        w.set_anfs(Anfs::REJECT);
        w.set_anfe(Anfe::REJECT);
        w.set_rrfs(true);
        w.set_rrfe(true);
    });
    FDCAN1.txbc().write(|w| w.set_tfqm(Tfqm::QUEUE));
    FDCAN1.txbtie().write_value(Txbtie(ALL_BUFFERS));
    FDCAN1.ie().write(|w| {
        w.set_rfne(0, true);
        w.set_rfne(1, true);
        w.set_tce(true);
    });
    // All on the first of the two interrupt lines, the reset value.
    FDCAN1.ile().write(|w| w.set_eint0(true));
    true
}

/// A frame was lost because its FIFO was full.
#[derive(Debug)]
pub struct Overrun;

impl embedded_can::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Overrun
    }
}

/// Returns the oldest frame of a FIFO, or `None` if it is empty.
fn take<const FIFO: usize>() -> Result<Option<ClassicFrame>, Overrun> {
    if FDCAN1.ir().read().rfl(FIFO) {
        FDCAN1.ir().write(|w| w.set_rfl(FIFO, true));
        return Err(Overrun);
    }
    let status = FDCAN1.rxfs(FIFO).read();
    if status.ffl() == 0 {
        return Ok(None);
    }
    let index = usize::from(status.fgi()).min(ELEMENTS - 1);
    let word = |n: usize| {
        let n = index * ELEMENT_STRIDE + n;
        if FIFO == 0 { FDCANRAM1.rxfifo0(n).read() } else { FDCANRAM1.rxfifo1(n).read() }
    };
    let element = [word(0), word(1), word(2), word(3)];
    FDCAN1.rxfa(FIFO).write(|w| w.set_fai(index as u8));
    Ok(frame(element))
}

impl embedded_can::nb::Can for Can {
    type Frame = ClassicFrame;
    type Error = Overrun;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Overrun> {
        if !self.is_set_up {
            return Err(nb::Error::WouldBlock);
        }
        let buffer = self.transmit.take(frame.id(), empty_buffers()).ok_or(nb::Error::WouldBlock)?;
        // Buffers have no higher index, but without this the indexing could panic.
        let buffer = buffer.min(ELEMENTS - 1);
        for (n, word) in element(frame).iter().enumerate() {
            FDCANRAM1.txbuf(buffer * ELEMENT_STRIDE + n).write_value(*word);
        }
        FDCAN1.txbar().write_value(Txbar(1 << buffer));
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Overrun> {
        if !self.is_set_up {
            return Err(nb::Error::WouldBlock);
        }
        let gripper = take::<0>().map_err(nb::Error::Other)?;
        let frame = match gripper {
            Some(frame) => Some(frame),
            None => take::<1>().map_err(nb::Error::Other)?,
        };
        frame.ok_or(nb::Error::WouldBlock)
    }
}

impl CanController for Can {
    /// A controller that could not be configured is reported as bus-off, so that the policy tries again. So is one that
    /// stopped sending after a message RAM access failure.
    fn health(&mut self) -> Health {
        if !self.is_set_up {
            return Health { is_off: true, ..Health::default() };
        }
        let status = FDCAN1.psr().read();
        let errors = FDCAN1.ecr().read();
        Health {
            is_off: status.bo() || FDCAN1.cccr().read().asm(),
            is_passive: status.ep(),
            transmit_errors: if status.bo() { u8::MAX } else { errors.tec() },
            receive_errors: match (status.bo(), errors.rp()) {
                // During the recovery, the counter counts sequences of recessive bits.
                (true, _) => 0,
                (false, true) => REC_BEYOND,
                (false, false) => errors.rec(),
            },
        }
    }

    /// TXBRP stays set while the frame is pending. TXBTO is set if the frame was sent, until a new request clears it.
    fn withdraw(&mut self, id: Id) -> Withdrawal {
        let buffer = match self.transmit.withdrawing() {
            Some(buffer) => buffer,
            None => {
                let Some(buffer) = self.transmit.withdraw(id, empty_buffers()) else {
                    return Withdrawal::TooLate;
                };
                FDCAN1.txbcr().write_value(Txbcr(1 << buffer));
                buffer
            }
        };
        // The order matters: once TXBRP is clear, TXBTO does not change.
        let is_waiting = requested() & 1 << buffer != 0;
        let was_sent = FDCAN1.txbto().read().0 & 1 << buffer != 0;
        self.transmit.decide(Withdrawal::of(is_waiting, was_sent))
    }

    /// A frame in transmission is completed, but not repeated.
    fn abort(&mut self) {
        self.transmit.decide(Withdrawal::Withdrawn);
        FDCAN1.txbcr().write_value(Txbcr(ALL_BUFFERS));
    }

    fn recover(&mut self) {
        self.join();
    }
}

/// Returns the buffers with a request. While the controller scans the buffers, a new request may show in TXBAR only.
fn requested() -> u32 {
    // In this order: a request never moves from TXBRP to TXBAR.
    FDCAN1.txbar().read().0 | FDCAN1.txbrp().read().0
}

fn empty_buffers() -> [bool; ELEMENTS] {
    let waiting = requested();
    [1 << 0, 1 << 1, 1 << 2].map(|buffer| waiting & buffer == 0)
}

/// A received or sent frame only ends the main loop's sleep.
#[interrupt]
fn FDCAN1_IT0() {
    // Writing 1 clears a flag. The flag for a lost frame is kept.
    FDCAN1.ir().write(|w| {
        w.set_rfn(0, true);
        w.set_rfn(1, true);
        w.set_tc(true);
    });
}
