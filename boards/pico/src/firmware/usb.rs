//! The service port: Modbus RTU over the USB socket, as a serial port (RP2040, 4.1).
//!
//! The handler alone touches the registers and the endpoints' buffers. It is given descriptors and answers by the library.

use core::ptr::with_exposed_provenance_mut;

use cortex_m::peripheral::NVIC;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::BusConfig;
use wsg_bridge_fw::plc::{RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::usb_serial::{self, Answer, PACKET_LEN};

use crate::registers::{peripheral, reset, reset_bit, write};
use crate::tick;

static SERVICE: RtuBuffers = RtuBuffers::new();

/// The memory that the controller shares: the packet that begins a control transfer, the endpoints' controls, and buffers.
const DPRAM: usize = 0x5010_0000;
const DPRAM_LEN: usize = 4096;
const SETUP: usize = 0;
/// Controls of endpoints, of which number 1 is the first, and of their buffers: to the host, and four bytes on from the host.
const ENDPOINT_CONTROL: usize = 0;
const BUFFER_CONTROL: usize = 0x80;
/// Buffers, of 64 bytes each.
const CONTROL_BUFFER: usize = 0x100;
const NOTIFICATIONS_BUFFER: usize = 0x180;
const FROM_HOST_BUFFER: usize = 0x1C0;
const TO_HOST_BUFFER: usize = 0x200;

/// An endpoint's control: on, with an interrupt for each buffer, its type and its buffer.
const ENABLE: u32 = 1 << 31 | 1 << 29;
const BULK: u32 = 2 << 26;
const INTERRUPT: u32 = 3 << 26;

/// A buffer's control.
const FULL: u32 = 1 << 15;
const DATA1: u32 = 1 << 13;
const STALL: u32 = 1 << 11;
const AVAILABLE: u32 = 1 << 10;
const LEN: u32 = 0x3FF;

/// Bits of BUFF_STATUS and EP_STALL_ARM: to the host; from the host is the next one.
const CONTROL_TO_HOST: u32 = 1 << 0;
const CONTROL_FROM_HOST: u32 = 1 << 1;
const DATA_TO_HOST: u32 = 1 << 4;
const DATA_FROM_HOST: u32 = 1 << 5;

/// INTE and INTS.
const INT_BUFFER: u32 = 1 << 4;
const INT_RESET: u32 = 1 << 12;
const INT_SETUP: u32 = 1 << 16;
/// SIE_STATUS.
const BUS_RESET: u32 = 1 << 19;
const SETUP_RECEIVED: u32 = 1 << 17;
/// SIE_CTRL, USB_MUXING, USB_PWR, MAIN_CTRL.
const CONTROL_INTERRUPTS: u32 = 1 << 29;
const PULL_UP: u32 = 1 << 16;
const TO_PHY: u32 = 1 << 0 | 1 << 3;
const FORCE_VBUS: u32 = 1 << 2 | 1 << 3;
const CONTROLLER_ON: u32 = 1 << 0;

/// The bridge's end of the service port.
pub(crate) type ServiceLine = RtuPort<Usb>;

/// The end of the service port. To be asked for once.
pub(crate) const fn service_line() -> ServiceLine {
    RtuPort::new(Usb(()), &SERVICE)
}

/// What the main loop needs of the registers.
pub(crate) struct Usb(());

impl RtuUart for Usb {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::USBCTRL_IRQ);
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}

/// Starts the service port. The clock of 48 MHz runs.
pub(crate) fn start_service() {
    SERVICE.start(&BusConfig::SERVICE);
    // Should it not come out of reset, no host sees a device.
    let _ = reset(reset_bit::USBCTRL);
    (0..DPRAM_LEN).step_by(4).for_each(|at| set(at, 0));
    let registers = peripheral!(USBCTRL_REGS);
    write(registers.usb_muxing(), TO_PHY);
    // The socket's supply is not wired to a pin; where the board runs, it is there or another one is.
    write(registers.usb_pwr(), FORCE_VBUS);
    write(registers.main_ctrl(), CONTROLLER_ON);
    write(registers.inte(), INT_BUFFER | INT_RESET | INT_SETUP);
    write(registers.sie_ctrl(), CONTROL_INTERRUPTS | PULL_UP);
    // SAFETY: no critical section depends on this interrupt being masked; the handler shares only
    // atomics with the rest.
    unsafe { NVIC::unmask(Interrupt::USBCTRL_IRQ) };
}

/// What the handler remembers.
struct Device {
    /// What is still to go to the host in this control transfer.
    rest: &'static [u8],
    is_sending: bool,
    /// The address from the end of this control transfer on.
    address: Option<u8>,
    is_configured: bool,
    /// The data endpoint's packets alternate; the control endpoint's to the host.
    data_to_host: u32,
    data_from_host: u32,
    control_to_host: u32,
    /// A packet waits for the host, and whether it was full: then another one follows, if an empty one.
    is_offered: bool,
    was_full: bool,
}

impl Device {
    const fn new() -> Self {
        Self {
            rest: &[],
            is_sending: false,
            address: None,
            is_configured: false,
            data_to_host: 0,
            data_from_host: 0,
            control_to_host: 0,
            is_offered: false,
            was_full: false,
        }
    }

    /// The host reset the bus.
    fn reset(&mut self) {
        *self = Self::new();
        write(peripheral!(USBCTRL_REGS).addr_endp(), 0);
        give_up_answer();
    }

    /// The host began a control transfer.
    fn set_up(&mut self) {
        let [a, b] = [SETUP, SETUP + 4].map(get);
        let ([a, b, c, d], [e, f, g, h]) = (a.to_le_bytes(), b.to_le_bytes());
        self.rest = &[];
        self.is_sending = false;
        self.address = None;
        self.control_to_host = DATA1;
        match usb_serial::answer([a, b, c, d, e, f, g, h], self.is_configured) {
            Answer::Data(bytes) => {
                self.rest = bytes;
                self.is_sending = true;
                self.send_control();
            }
            Answer::Done => self.acknowledge(),
            Answer::Address(address) => {
                self.address = Some(address);
                self.acknowledge();
            }
            Answer::Configured(is_configured) => {
                self.configure(is_configured);
                self.acknowledge();
            }
            Answer::Cleared { to_host } => {
                if to_host {
                    self.data_to_host = 0;
                } else {
                    self.data_from_host = 0;
                    self.listen();
                }
                self.acknowledge();
            }
            Answer::TakeData => offer(BUFFER_CONTROL + 4, DATA1 | u32::from(PACKET_LEN)),
            Answer::Stall => {
                write(peripheral!(USBCTRL_REGS).ep_stall_arm(), CONTROL_TO_HOST | CONTROL_FROM_HOST);
                set(BUFFER_CONTROL, STALL);
                set(BUFFER_CONTROL + 4, STALL);
            }
        }
    }

    fn configure(&mut self, is_configured: bool) {
        give_up_answer();
        let on = if is_configured { ENABLE } else { 0 };
        let control = |endpoint: u8| ENDPOINT_CONTROL + 8 * usize::from(endpoint);
        set(control(usb_serial::NOTIFICATIONS), on | INTERRUPT | NOTIFICATIONS_BUFFER as u32);
        set(control(usb_serial::DATA), on | BULK | TO_HOST_BUFFER as u32);
        set(control(usb_serial::DATA) + 4, on | BULK | FROM_HOST_BUFFER as u32);
        self.is_configured = is_configured;
        self.is_offered = false;
        self.was_full = false;
        self.data_to_host = 0;
        self.data_from_host = 0;
        self.listen();
    }

    /// Acknowledges a request by an empty packet.
    fn acknowledge(&mut self) {
        offer(BUFFER_CONTROL, FULL | DATA1);
    }

    /// Offers the next packet of a control transfer.
    fn send_control(&mut self) {
        let (packet, rest) = self.rest.split_at_checked(PACKET_LEN.into()).unwrap_or((self.rest, &[]));
        fill(CONTROL_BUFFER, packet.iter().copied());
        offer(BUFFER_CONTROL, FULL | self.control_to_host | packet.len() as u32);
        self.control_to_host ^= DATA1;
        self.rest = rest;
    }

    /// A packet of a control transfer went to the host.
    fn control_sent(&mut self) {
        if let Some(address) = self.address.take() {
            write(peripheral!(USBCTRL_REGS).addr_endp(), address.into());
        }
        if !self.rest.is_empty() {
            self.send_control();
        } else if core::mem::take(&mut self.is_sending) {
            // The host acknowledges by an empty packet.
            offer(BUFFER_CONTROL + 4, DATA1);
        }
    }

    /// A packet of a control transfer came.
    fn control_received(&mut self) {
        // One with something in it is to be acknowledged; the empty one was the acknowledgement.
        if get(BUFFER_CONTROL + 4) & LEN != 0 {
            self.acknowledge();
        }
    }

    /// Lets the host send the next packet.
    fn listen(&mut self) {
        if self.is_configured {
            let control = BUFFER_CONTROL + 8 * usize::from(usb_serial::DATA) + 4;
            offer(control, self.data_from_host | u32::from(PACKET_LEN));
        }
    }

    /// Takes the packet that came.
    fn received(&mut self) {
        let control = BUFFER_CONTROL + 8 * usize::from(usb_serial::DATA) + 4;
        let len = (get(control) & LEN).min(PACKET_LEN.into()) as usize;
        let now_us = tick::now_us();
        let words = (FROM_HOST_BUFFER..).step_by(4).map(get);
        for byte in words.flat_map(u32::to_le_bytes).take(len) {
            SERVICE.on_receive(byte, false, !self.is_offered, now_us);
        }
        self.data_from_host ^= DATA1;
        self.listen();
    }

    /// Offers what there is to send, unless a packet waits for the host already.
    fn send(&mut self) {
        if !self.is_configured || self.is_offered {
            return;
        }
        let mut len = 0;
        let bytes = core::iter::from_fn(|| SERVICE.on_transmit(true, false)).take(PACKET_LEN.into());
        fill(TO_HOST_BUFFER, bytes.inspect(|_| len += 1));
        if len == 0 && !core::mem::take(&mut self.was_full) {
            // All is sent.
            SERVICE.on_transmit(false, true);
            return;
        }
        self.was_full = len == u32::from(PACKET_LEN);
        self.is_offered = true;
        offer(BUFFER_CONTROL + 8 * usize::from(usb_serial::DATA), FULL | self.data_to_host | len);
        self.data_to_host ^= DATA1;
    }
}

/// Forgets an answer that the host will not fetch.
fn give_up_answer() {
    while SERVICE.on_transmit(true, false).is_some() {}
    SERVICE.on_transmit(false, true);
}

#[interrupt]
fn USBCTRL_IRQ() {
    static mut DEVICE: Device = Device::new();
    let registers = peripheral!(USBCTRL_REGS);
    let causes = registers.ints().read().bits();
    if causes & INT_RESET != 0 {
        write(registers.sie_status(), BUS_RESET);
        DEVICE.reset();
    }
    let done = registers.buff_status().read().bits();
    write(registers.buff_status(), done);
    if done & CONTROL_TO_HOST != 0 {
        DEVICE.control_sent();
    }
    if done & CONTROL_FROM_HOST != 0 {
        DEVICE.control_received();
    }
    // Behind what was before it.
    if causes & INT_SETUP != 0 {
        write(registers.sie_status(), SETUP_RECEIVED);
        DEVICE.set_up();
    }
    if done & DATA_TO_HOST != 0 {
        DEVICE.is_offered = false;
    }
    // First what went: what came is no echo of it then.
    DEVICE.send();
    if done & DATA_FROM_HOST != 0 {
        DEVICE.received();
    }
}

/// Gives a buffer to the controller. Its clock is another one: the last bit is written when the others have arrived (4.1.2.5.1).
fn offer(control: usize, value: u32) {
    set(control, value);
    cortex_m::asm::delay(12);
    set(control, value | AVAILABLE);
}

/// Fills a buffer with up to 64 bytes.
fn fill(buffer: usize, bytes: impl Iterator<Item = u8>) {
    let mut bytes = bytes.fuse();
    for at in (buffer..).step_by(4).take(usize::from(PACKET_LEN) / 4) {
        let mut word = [0; 4];
        let mut is_empty = true;
        for (place, byte) in word.iter_mut().zip(bytes.by_ref()) {
            *place = byte;
            is_empty = false;
        }
        if is_empty {
            return;
        }
        set(at, u32::from_le_bytes(word));
    }
}

fn get(at: usize) -> u32 {
    // SAFETY: the address is in the controller's memory, aligned: all places above are, and buffers end before its end.
    unsafe { with_exposed_provenance_mut::<u32>(DPRAM + at).read_volatile() }
}

fn set(at: usize, value: u32) {
    // SAFETY: as above; no reference to it exists.
    unsafe { with_exposed_provenance_mut::<u32>(DPRAM + at).write_volatile(value) };
}
