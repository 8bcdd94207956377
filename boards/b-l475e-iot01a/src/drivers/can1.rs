//! CAN1 on PB8 (RX, D15) and PB9 (TX, D14), connected to a 3.3 V transceiver (RM0351, chapter 46).
//!
//! The interrupt handlers only wake the main loop and mask themselves; the main loop does the work. Every wait is bounded.

use bus_slcan::ClassicFrame;
use cortex_m::peripheral::NVIC;
use embedded_can::{ErrorKind, ExtendedId, Frame, Id, StandardId};
use wsg_bridge_fw::can::{CanConfig, CanController, Health, TransmitBuffers, Withdrawal};
use wsg_stm32::pac::can::regs::Tir;
use wsg_stm32::pac::{CAN1, Interrupt, RCC, interrupt};
use wsg_stm32::{BitTiming, Segments};

use super::clock::HCLK_HZ;
use crate::transmit_status::{self, MAILBOXES, TME};

/// Fields of an identifier register, identical for transmission, reception and filters (46.7.4, 46.9.3).
const STANDARD_AT: u32 = 21;
const EXTENDED_AT: u32 = 3;
const IDE: u32 = 1 << 2;
const RTR: u32 = 1 << 1;
const TXRQ: u32 = 1 << 0;

/// Filter mask for an exact standard identifier of a data frame.
const EXACT: u32 = 0x7FF << STANDARD_AT | IDE | RTR;

/// Maximum number of data bytes. A length code above 8, up to 15, also means 8 (ISO 11898-1).
const MAX_DATA_LEN: u8 = 8;

/// Aborts the request of mailbox 0 in TSR; the others are 8 and 16 bits higher. `set_abrq` with a variable mailbox can panic.
const ABRQ0: u32 = 1 << 7;

/// Maximum number of status reads while the controller changes its mode, which takes a few cycles of the bus clock.
const MAX_LOOKS: u32 = 10_000;

/// The driver of the bxCAN controller CAN1.
#[derive(Debug)]
pub struct Can1 {
    config: Option<CanConfig>,
    /// Whether timing and filters are configured.
    is_set_up: bool,
    transmit: TransmitBuffers,
}

impl Can1 {
    /// Returns a controller that is not started. Call it once.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "a program has a single value")]
    pub const fn new() -> Self {
        Self { config: None, is_set_up: false, transmit: TransmitBuffers::new() }
    }

    /// Starts the controller. The clock must run and the pins must be set up. The filters accept only frames for the bridge.
    pub fn start(&mut self, config: &CanConfig) {
        RCC.apb1enr1().modify(|w| w.set_can1en(true));
        let _ = RCC.apb1enr1().read();
        self.config = Some(*config);
        self.transmit.start(config);
        self.join();
    }

    /// Initializes the controller and joins the bus. After bus-off, it waits for 128 times 11 recessive bits first.
    fn join(&mut self) {
        let Some(config) = self.config else { return };
        // Leaves sleep mode. Automatic recovery from bus-off stays disabled, because the bus-off policy decides.
        CAN1.mcr().write(|w| {
            w.set_inrq(true);
            w.set_dbf(true);
        });
        let entered = (0..MAX_LOOKS).any(|_| CAN1.msr().read().inak());
        self.is_set_up = entered && set_up(&config);
        // The controller synchronizes in the background; the first frames wait for that.
        CAN1.mcr().write(|w| w.set_dbf(true));
    }

    /// Unmasks the interrupts, so that they wake the main loop again.
    pub fn rearm(&mut self) {
        if !NVIC::is_enabled(Interrupt::CAN1_TX) {
            // This also clears TXOK, which a pending withdrawal still has to read.
            CAN1.tsr().write(|w| {
                for mailbox in 0..MAILBOXES {
                    w.set_rqcp(mailbox, self.transmit.withdrawing() != Some(mailbox));
                }
            });
        }
        // SAFETY: no critical section depends on these interrupts being masked. Their handlers only mask them.
        unsafe {
            NVIC::unmask(Interrupt::CAN1_RX0);
            NVIC::unmask(Interrupt::CAN1_TX);
        }
    }
}

/// Returns whether the receive FIFO holds a frame.
#[must_use]
pub fn has_received() -> bool {
    CAN1.rfr(0).read().fmp() != 0
}

/// Configures timing, filters and interrupts in initialization mode. Returns whether the rate is supported.
fn set_up(config: &CanConfig) -> bool {
    let Some(timing) = BitTiming::for_rate(Segments::BXCAN, HCLK_HZ, config.kbit_rate) else { return false };
    // Each field holds its value minus one.
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
    // Five filter banks with a 32-bit mask each, for FIFO 0.
    CAN1.fm1r().write(|w| w.0 = 0);
    CAN1.fs1r().write(|w| w.0 = 0b1_1111);
    CAN1.ffa1r().write(|w| w.0 = 0);
    let wanted = [
        (CAN1.fb(0), (gripper, EXACT)),
        // NMT; SYNC; frames for this node; heartbeats.
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

/// The FIFO was full and a frame overwrote another one.
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
        // Indexing by a variable could panic.
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
        // Every length up to 8 yields a frame.
        frame.ok_or(nb::Error::WouldBlock)
    }
}

impl CanController for Can1 {
    /// A controller that could not be configured is reported as bus-off, so that the policy tries again.
    fn health(&mut self) -> Health {
        if !self.is_set_up {
            return Health { is_off: true, ..Health::default() };
        }
        let status = CAN1.esr().read();
        Health {
            is_off: status.boff(),
            is_passive: status.epvf(),
            // The register holds the lowest 8 bits; at bus-off the counter has a ninth.
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

    /// A frame in transmission is completed, but not repeated.
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
