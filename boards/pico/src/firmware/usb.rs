//! The service port: Modbus RTU over the USB connector as a virtual serial port (RP2040, 4.1).
//!
//! Only the handler accesses the registers and the endpoint buffers. The library provides the descriptors and answers.

use core::ptr::with_exposed_provenance_mut;

use cortex_m::peripheral::NVIC;
use rp2040_hal::pac::{Interrupt, interrupt};
use wsg_bridge_fw::BusConfig;
use wsg_bridge_fw::plc::{RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::usb_serial::{self, Answer, PACKET_LEN};

use crate::registers::{peripheral, reset, reset_bit, write};
use crate::tick;

static SERVICE: RtuBuffers<RECEIVED_MAX> = RtuBuffers::new();

/// Bytes of the queue for received characters, three each. USB transfers the longest frame of 256 characters within a turn of the
/// main loop.
const RECEIVED_MAX: usize = 1024;

/// The controller's shared memory: setup packet, endpoint controls, buffer controls and buffers.
const DPRAM: usize = 0x5010_0000;
const DPRAM_LEN: usize = 4096;
const SETUP: usize = 0;
/// Offsets of the endpoint controls, starting with endpoint 1, and of the buffer controls. The control to the host is first,
/// the one from the host 4 bytes higher.
const ENDPOINT_CONTROL: usize = 0;
const BUFFER_CONTROL: usize = 0x80;
/// Offsets of the buffers, 64 bytes each.
const CONTROL_BUFFER: usize = 0x100;
const NOTIFICATIONS_BUFFER: usize = 0x180;
const FROM_HOST_BUFFER: usize = 0x1C0;
const TO_HOST_BUFFER: usize = 0x200;

/// Endpoint control: enable with an interrupt per buffer, and the endpoint type.
const ENABLE: u32 = 1 << 31 | 1 << 29;
const BULK: u32 = 2 << 26;
const INTERRUPT: u32 = 3 << 26;

/// Buffer control.
const FULL: u32 = 1 << 15;
const DATA1: u32 = 1 << 13;
const STALL: u32 = 1 << 11;
const AVAILABLE: u32 = 1 << 10;
const LEN: u32 = 0x3FF;

/// Bits of BUFF_STATUS and EP_STALL_ARM. The bit from the host follows the bit to the host.
const CONTROL_TO_HOST: u32 = 1 << 0;
const CONTROL_FROM_HOST: u32 = 1 << 1;
const DATA_TO_HOST: u32 = 1 << 4;
const DATA_FROM_HOST: u32 = 1 << 5;

/// Bits of INTE and INTS.
const INT_BUFFER: u32 = 1 << 4;
const INT_RESET: u32 = 1 << 12;
const INT_SETUP: u32 = 1 << 16;
/// Bits of SIE_STATUS.
const BUS_RESET: u32 = 1 << 19;
const SETUP_RECEIVED: u32 = 1 << 17;
/// Bits of SIE_CTRL, USB_MUXING, USB_PWR and MAIN_CTRL.
const CONTROL_INTERRUPTS: u32 = 1 << 29;
const PULL_UP: u32 = 1 << 16;
const TO_PHY: u32 = 1 << 0 | 1 << 3;
const FORCE_VBUS: u32 = 1 << 2 | 1 << 3;
const CONTROLLER_ON: u32 = 1 << 0;

/// The bridge's end of the service port.
pub(crate) type ServiceLine = RtuPort<Usb, RECEIVED_MAX>;

/// Returns the service port's line. Call it once.
pub(crate) const fn service_line() -> ServiceLine {
    RtuPort::new(Usb(()), &SERVICE)
}

/// The main loop's access to the registers.
pub(crate) struct Usb(());

impl RtuUart for Usb {
    fn pend(&mut self) {
        NVIC::pend(Interrupt::USBCTRL_IRQ);
    }

    fn now_us(&mut self) -> u32 {
        tick::now_us()
    }
}

/// Starts the service port. The 48 MHz clock must run.
pub(crate) fn start_service() {
    SERVICE.start(&BusConfig::SERVICE);
    // If it stays in reset, the host detects no device.
    let _ = reset(reset_bit::USBCTRL);
    (0..DPRAM_LEN).step_by(4).for_each(|at| set(at, 0));
    let registers = peripheral!(USBCTRL_REGS);
    write(registers.usb_muxing(), TO_PHY);
    // VBUS is not connected to a pin, so its presence is forced.
    write(registers.usb_pwr(), FORCE_VBUS);
    write(registers.main_ctrl(), CONTROLLER_ON);
    write(registers.inte(), INT_BUFFER | INT_RESET | INT_SETUP);
    write(registers.sie_ctrl(), CONTROL_INTERRUPTS | PULL_UP);
    // SAFETY: no critical section depends on this interrupt being masked. The handler shares only atomics with the rest of the
    // program.
    unsafe { NVIC::unmask(Interrupt::USBCTRL_IRQ) };
}

/// The state of the handler.
struct Device {
    /// The rest of the answer in this control transfer.
    rest: &'static [u8],
    is_sending: bool,
    /// The address that becomes effective at the end of this control transfer.
    address: Option<u8>,
    is_configured: bool,
    /// DATA0/DATA1 toggles of the data endpoint in both directions, and of the control endpoint to the host.
    data_to_host: u32,
    data_from_host: u32,
    control_to_host: u32,
    /// A packet awaits its transfer to the host. After a full one, another packet follows, which may be empty.
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

    /// Handles a bus reset by the host.
    fn reset(&mut self) {
        *self = Self::new();
        write(peripheral!(USBCTRL_REGS).addr_endp(), 0);
        give_up_answer();
    }

    /// Handles the setup packet of a control transfer.
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

    /// Acknowledges a request with an empty packet.
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

    /// Handles the completion of a control packet to the host.
    fn control_sent(&mut self) {
        if let Some(address) = self.address.take() {
            write(peripheral!(USBCTRL_REGS).addr_endp(), address.into());
        }
        if !self.rest.is_empty() {
            self.send_control();
        } else if core::mem::take(&mut self.is_sending) {
            // The host acknowledges with an empty packet.
            offer(BUFFER_CONTROL + 4, DATA1);
        }
    }

    /// Handles a control packet from the host.
    fn control_received(&mut self) {
        // A packet with data requires an acknowledgement; an empty one is the host's acknowledgement.
        if get(BUFFER_CONTROL + 4) & LEN != 0 {
            self.acknowledge();
        }
    }

    /// Permits the host to send the next data packet.
    fn listen(&mut self) {
        if self.is_configured {
            let control = BUFFER_CONTROL + 8 * usize::from(usb_serial::DATA) + 4;
            offer(control, self.data_from_host | u32::from(PACKET_LEN));
        }
    }

    /// Processes a data packet from the host.
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

    /// Offers the next data packet, unless one is already awaiting its transfer.
    fn send(&mut self) {
        if !self.is_configured || self.is_offered {
            return;
        }
        let mut len = 0;
        let bytes = core::iter::from_fn(|| SERVICE.on_transmit(true, false)).take(PACKET_LEN.into());
        fill(TO_HOST_BUFFER, bytes.inspect(|_| len += 1));
        if len == 0 && !core::mem::take(&mut self.was_full) {
            // All data has been sent.
            SERVICE.on_transmit(false, true);
            return;
        }
        self.was_full = len == u32::from(PACKET_LEN);
        self.is_offered = true;
        offer(BUFFER_CONTROL + 8 * usize::from(usb_serial::DATA), FULL | self.data_to_host | len);
        self.data_to_host ^= DATA1;
    }
}

/// Discards an answer that the host will not read.
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
    // Processed after the packets that preceded it.
    if causes & INT_SETUP != 0 {
        write(registers.sie_status(), SETUP_RECEIVED);
        DEVICE.set_up();
    }
    if done & DATA_TO_HOST != 0 {
        DEVICE.is_offered = false;
    }
    // Handle the sent packet first, so that the received packet is not taken for an echo.
    DEVICE.send();
    if done & DATA_FROM_HOST != 0 {
        DEVICE.received();
    }
}

/// Passes a buffer to the controller, which has a different clock: the last bit is set after the others have settled
/// (4.1.2.5.1).
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
    // SAFETY: the address is in the controller's memory and aligned: all offsets above are, and the buffers are within its
    // size.
    unsafe { with_exposed_provenance_mut::<u32>(DPRAM + at).read_volatile() }
}

fn set(at: usize, value: u32) {
    // SAFETY: as above; no reference to this memory exists.
    unsafe { with_exposed_provenance_mut::<u32>(DPRAM + at).write_volatile(value) };
}
