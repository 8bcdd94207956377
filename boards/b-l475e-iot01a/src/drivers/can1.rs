//! CAN1 on PB8 (RX, D15) and PB9 (TX, D14), behind a transceiver for 3.3 V (RM0351, chapter 46).
//!
//! The interrupts wake the main loop and mask themselves; the work is done there. Nothing waits without a bound.

use bus_slcan::ClassicFrame;
use cortex_m::peripheral::NVIC;
use embedded_can::{ErrorKind, ExtendedId, Frame, Id, StandardId};
use wsg_bridge_fw::can::{CanConfig, CanController, Health, TransmitBuffers, Withdrawal};
use wsg_stm32::pac::can::regs::Tir;
use wsg_stm32::pac::{CAN1, Interrupt, RCC, interrupt};
use wsg_stm32::{BitTiming, Segments};

use super::clock::HCLK_HZ;
use crate::transmit_status::{self, MAILBOXES, TME};

/// Fields of an identifier's register, the same ones for sending, receiving and filters (46.7.4, 46.9.3).
const STANDARD_AT: u32 = 21;
const EXTENDED_AT: u32 = 3;
const IDE: u32 = 1 << 2;
const RTR: u32 = 1 << 1;
const TXRQ: u32 = 1 << 0;

/// A standard identifier's bits, and that it is a standard one, of a data frame.
const EXACT: u32 = 0x7FF << STANDARD_AT | IDE | RTR;

/// Bytes of data in a frame. Its length field goes up to 15; above 8 it also means 8 (ISO 11898-1).
const MAX_DATA_LEN: u8 = 8;

/// Aborts the request of mailbox 0, in TSR; the bits of the others are 8 and 16 higher. `set_abrq` of a variable mailbox can panic.
const ABRQ0: u32 = 1 << 7;

/// How often the peripheral's answer to a change of its mode is looked at. It takes a few cycles of the bus clock.
const MAX_LOOKS: u32 = 10_000;

/// The controller.
#[derive(Debug)]
pub struct Can1 {
    config: Option<CanConfig>,
    /// Whether timing and filters are in its registers.
    is_set_up: bool,
    transmit: TransmitBuffers,
}

impl Can1 {
    /// One that was not started. To be asked for once.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "there is one")]
    pub const fn new() -> Self {
        Self { config: None, is_set_up: false, transmit: TransmitBuffers::new() }
    }

    /// Starts the controller. The clock runs, the pins are set up. Only what the bridge may want passes its filters.
    pub fn start(&mut self, config: &CanConfig) {
        RCC.apb1enr1().modify(|w| w.set_can1en(true));
        let _ = RCC.apb1enr1().read();
        self.config = Some(*config);
        self.transmit.start(config);
        self.join();
    }

    /// Goes through initialisation and on to the bus: where it was bus-off, it then waits for 128 times 11 recessive bits.
    fn join(&mut self) {
        let Some(config) = self.config else { return };
        // Out of sleep. Out of bus-off not by itself: that is the bus-off policy's to decide.
        CAN1.mcr().write(|w| {
            w.set_inrq(true);
            w.set_dbf(true);
        });
        let entered = (0..MAX_LOOKS).any(|_| CAN1.msr().read().inak());
        self.is_set_up = entered && set_up(&config);
        // It synchronises in its own time; the first frames wait for that.
        CAN1.mcr().write(|w| w.set_dbf(true));
    }

    /// Lets the interrupts wake the main loop again.
    pub fn rearm(&mut self) {
        if !NVIC::is_enabled(Interrupt::CAN1_TX) {
            // That clears TXOK as well, which a withdrawal still has to read.
            CAN1.tsr().write(|w| {
                for mailbox in 0..MAILBOXES {
                    w.set_rqcp(mailbox, self.transmit.withdrawing() != Some(mailbox));
                }
            });
        }
        // SAFETY: no critical section depends on these being masked; their handlers do nothing but mask them.
        unsafe {
            NVIC::unmask(Interrupt::CAN1_RX0);
            NVIC::unmask(Interrupt::CAN1_TX);
        }
    }
}

/// Whether a frame waits.
#[must_use]
pub fn has_received() -> bool {
    CAN1.rfr(0).read().fmp() != 0
}

/// Timing, filters and interrupts, in initialisation mode; whether there is a timing for the rate.
fn set_up(config: &CanConfig) -> bool {
    let Some(timing) = BitTiming::for_rate(Segments::BXCAN, HCLK_HZ, config.kbit_rate) else { return false };
    // Each field holds one less than it means.
    CAN1.btr().write(|w| {
        w.set_brp(timing.prescaler.saturating_sub(1));
        w.set_ts(0, timing.before_sample.saturating_sub(1));
        w.set_ts(1, timing.after_sample.saturating_sub(1));
        w.set_sjw(timing.jump.saturating_sub(1));
    });
    let standard = |id: u16, mask: u16| {
        let [id, mask] = [id, mask].map(|bits| u32::from(bits & 0x7FF) << STANDARD_AT);
        (id, mask | IDE | RTR)
    };
    let gripper = u32::from(config.gripper.controller().receive.as_raw()) << STANDARD_AT;
    CAN1.fmr().modify(|w| w.set_finit(true));
    // Five banks of a mask of 32 bits each, for FIFO 0.
    CAN1.fm1r().write(|w| w.0 = 0);
    CAN1.fs1r().write(|w| w.0 = 0b1_1111);
    CAN1.ffa1r().write(|w| w.0 = 0);
    let wanted = [
        (CAN1.fb(0), (gripper, EXACT)),
        // NMT; SYNC; what is for this node; heartbeats.
        (CAN1.fb(1), (0, EXACT)),
        (CAN1.fb(4), standard(0x080, 0x7FF)),
        (CAN1.fb(2), standard(config.node.node.into(), 0x07F)),
        (CAN1.fb(3), standard(0x700, 0x780)),
    ];
    for (bank, (id, mask)) in wanted {
        bank.fr1().write(|w| w.0 = id);
        bank.fr2().write(|w| w.0 = mask);
    }
    CAN1.fa1r().write(|w| w.0 = 0b1_1111);
    CAN1.fmr().modify(|w| w.set_finit(false));
    CAN1.ier().write(|w| {
        w.set_fmpie(0, true);
        w.set_tmeie(true);
    });
    true
}

/// A frame found no room in the FIFO, and took another's place there.
#[derive(Debug)]
pub struct Overrun;

impl embedded_can::Error for Overrun {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Overrun
    }
}

impl embedded_can::nb::Can for Can1 {
    type Frame = ClassicFrame;
    type Error = Overrun;

    fn transmit(&mut self, frame: &ClassicFrame) -> nb::Result<Option<ClassicFrame>, Overrun> {
        if !self.is_set_up {
            return Err(nb::Error::WouldBlock);
        }
        let mailbox = self.transmit.take(frame.id(), empty_mailboxes());
        // By constants: a variable mailbox can panic.
        let mailboxes = [CAN1.tx(0), CAN1.tx(1), CAN1.tx(2)];
        let mailbox = mailbox.and_then(|n| mailboxes.get(n)).ok_or(nb::Error::WouldBlock)?;
        let mut data = [0; MAX_DATA_LEN as usize];
        for (place, byte) in data.iter_mut().zip(frame.data()) {
            *place = *byte;
        }
        let [a, b, c, d, e, f, g, h] = data;
        mailbox.tdtr().write(|w| w.set_dlc(frame.dlc() as u8));
        mailbox.tdlr().write(|w| w.0 = u32::from_le_bytes([a, b, c, d]));
        mailbox.tdhr().write(|w| w.0 = u32::from_le_bytes([e, f, g, h]));
        mailbox.tir().write_value(Tir(id_register(frame) | TXRQ));
        Ok(None)
    }

    fn receive(&mut self) -> nb::Result<ClassicFrame, Overrun> {
        if !self.is_set_up {
            return Err(nb::Error::WouldBlock);
        }
        let fifo = CAN1.rfr(0).read();
        if fifo.fovr() {
            CAN1.rfr(0).write(|w| w.set_fovr(true));
            return Err(nb::Error::Other(Overrun));
        }
        if fifo.fmp() == 0 {
            return Err(nb::Error::WouldBlock);
        }
        let message = CAN1.rx(0);
        let id = message.rir().read().0;
        let len = message.rdtr().read().dlc().min(MAX_DATA_LEN);
        let [a, b, c, d] = message.rdlr().read().0.to_le_bytes();
        let [e, f, g, h] = message.rdhr().read().0.to_le_bytes();
        CAN1.rfr(0).write(|w| w.set_rfom(true));
        let data = [a, b, c, d, e, f, g, h];
        let frame = if id & RTR != 0 {
            ClassicFrame::new_remote(id_of(id), len.into())
        } else {
            data.get(..len.into()).and_then(|data| ClassicFrame::new(id_of(id), data))
        };
        // A length up to 8 makes a frame.
        frame.ok_or(nb::Error::WouldBlock)
    }
}

impl CanController for Can1 {
    /// One that could not be set up is as good as bus-off, and the policy tries again.
    fn health(&mut self) -> Health {
        if !self.is_set_up {
            return Health { is_off: true, ..Health::default() };
        }
        let status = CAN1.esr().read();
        Health {
            is_off: status.boff(),
            is_passive: status.epvf(),
            // The register has the lowest 8 bits, and at bus-off there is a ninth.
            transmit_errors: if status.boff() { u8::MAX } else { status.tec() },
            receive_errors: status.rec(),
        }
    }

    fn withdraw(&mut self, id: Id) -> Withdrawal {
        let mailbox = match self.transmit.withdrawing() {
            Some(mailbox) => mailbox,
            None => {
                let Some(mailbox) = self.transmit.withdraw(id, empty_mailboxes()) else {
                    return Withdrawal::TooLate;
                };
                CAN1.tsr().write(|w| w.0 = ABRQ0 << (8 * mailbox));
                mailbox
            }
        };
        self.transmit.decide(transmit_status::withdrawal(CAN1.tsr().read().0, mailbox))
    }

    /// What is being sent at this moment goes on to its end, and is not tried again.
    fn abort(&mut self) {
        self.transmit.decide(Withdrawal::Withdrawn);
        CAN1.tsr().write(|w| {
            w.set_abrq(0, true);
            w.set_abrq(1, true);
            w.set_abrq(2, true);
        });
    }

    fn recover(&mut self) {
        self.join();
    }
}

fn empty_mailboxes() -> [bool; MAILBOXES] {
    let status = CAN1.tsr().read().0;
    TME.map(|empty| status & empty != 0)
}

fn id_register(frame: &ClassicFrame) -> u32 {
    let id = match frame.id() {
        Id::Standard(id) => u32::from(id.as_raw()) << STANDARD_AT,
        Id::Extended(id) => id.as_raw() << EXTENDED_AT | IDE,
    };
    if frame.is_remote_frame() { id | RTR } else { id }
}

fn id_of(register: u32) -> Id {
    if register & IDE != 0 {
        Id::Extended(ExtendedId::new(register >> EXTENDED_AT).unwrap_or(ExtendedId::MAX))
    } else {
        Id::Standard(StandardId::new((register >> STANDARD_AT) as u16).unwrap_or(StandardId::MAX))
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
