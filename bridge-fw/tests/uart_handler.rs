//! The handlers of both lines over a HAL's UART, which the test plays.

use std::collections::VecDeque;

use bus_modbus::rtu::Character;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use wsg_bridge_fw::gripper::{LostBytes, Uart, UartBuffers, UartLine};
use wsg_bridge_fw::plc::{BusPort, Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::{BusConfig, Format};

const CONFIG: BusConfig = BusConfig { baud: 19_200, format: Format::Even1, ..BusConfig::DEFAULT };
const NOTHING: Interrupts = Interrupts { transmit_empty: false, transmission_complete: false };

/// A UART with one place for what was received, one to send, and a shift register.
#[derive(Default)]
struct Hal {
    received: VecDeque<Result<u8, ErrorKind>>,
    waits: Option<u8>,
    is_shifting: bool,
    sent: Vec<u8>,
}

impl Hal {
    /// The line has had time for a character.
    fn shift(&mut self) {
        self.is_shifting = self.waits.is_some();
        self.sent.extend(self.waits.take());
    }
}

impl ErrorType for Hal {
    type Error = ErrorKind;
}

impl Read for Hal {
    fn read(&mut self) -> nb::Result<u8, ErrorKind> {
        self.received.pop_front().ok_or(nb::Error::WouldBlock)?.map_err(nb::Error::Other)
    }
}

impl Write for Hal {
    fn write(&mut self, byte: u8) -> nb::Result<(), ErrorKind> {
        if self.waits.is_some() {
            return Err(nb::Error::WouldBlock);
        }
        self.waits = Some(byte);
        Ok(())
    }

    fn flush(&mut self) -> nb::Result<(), ErrorKind> {
        if self.waits.is_some() || self.is_shifting { Err(nb::Error::WouldBlock) } else { Ok(()) }
    }
}

struct Registers;

impl Uart for Registers {
    fn pend(&mut self) {}

    fn is_idle(&mut self) -> bool {
        true
    }
}

impl RtuUart for Registers {
    fn pend(&mut self) {}

    fn now_us(&mut self) -> u32 {
        0
    }
}

#[test]
fn no_byte_to_the_gripper_is_lost_while_the_uart_has_no_room() {
    let buffers: &'static UartBuffers<4, 4> = Box::leak(Box::default());
    let mut line = UartLine::new(Registers, buffers);
    let mut hal = Hal::default();
    embedded_io::Write::write(&mut line, &[1, 2]).unwrap();

    assert!(buffers.serve(&mut hal), "the second byte waits");
    assert!(buffers.serve(&mut hal), "there is no room for it");
    hal.shift();
    assert!(!buffers.serve(&mut hal));
    hal.shift();

    assert_eq!(hal.sent, [1, 2]);
}

#[test]
fn what_the_gripper_sent_is_read_and_what_was_damaged_is_counted() {
    let buffers: &'static UartBuffers<4, 4> = Box::leak(Box::default());
    let mut line = UartLine::new(Registers, buffers);
    let mut hal = Hal::default();
    hal.received.extend([
        Ok(7),
        Err(ErrorKind::Overrun),
        Err(ErrorKind::FrameFormat),
        Err(ErrorKind::Noise),
        Ok(8),
    ]);
    for _ in 0..5 {
        assert!(!buffers.serve(&mut hal));
    }

    let mut read = [0; 4];
    assert_eq!(embedded_io::Read::read(&mut line, &mut read), Ok(2));
    assert_eq!(read[..2], [7, 8]);
    assert_eq!(buffers.lost(), LostBytes { overrun: 1, framing: 2, queue_full: 0 });
}

#[test]
fn a_frame_on_the_bus_ends_behind_its_last_bit_and_its_echo_is_not_received() {
    let buffers: &'static RtuBuffers<16, 256> = Box::leak(Box::default());
    buffers.start(&CONFIG);
    let mut port = RtuPort::new(Registers, buffers);
    let mut hal = Hal::default();
    port.send(&[1, 2]);

    let full = Interrupts { transmit_empty: true, ..NOTHING };
    let ending = Interrupts { transmission_complete: true, ..NOTHING };
    assert_eq!(buffers.serve(&mut hal, 0), full);
    hal.shift();
    assert_eq!(buffers.serve(&mut hal, 573), ending);
    hal.received.push_back(Ok(1));
    hal.shift();
    assert_eq!(buffers.serve(&mut hal, 1_146), ending, "the last byte is on its way");
    hal.received.push_back(Ok(2));
    hal.shift();
    assert_eq!(buffers.serve(&mut hal, 1_719), NOTHING);

    assert_eq!((&hal.sent[..], port.receive()), (&[1, 2][..], None));
    hal.received.push_back(Ok(3));
    buffers.serve(&mut hal, 5_000);
    assert!(matches!(port.receive(), Some((Character::Byte(3), _))));
}

#[test]
fn damage_on_the_bus_is_told_with_its_character() {
    let buffers: &'static RtuBuffers<16, 256> = Box::leak(Box::default());
    buffers.start(&CONFIG);
    let mut port = RtuPort::new(Registers, buffers);
    let mut hal = Hal::default();
    hal.received.extend([Err(ErrorKind::Parity), Err(ErrorKind::Overrun), Ok(5), Ok(6)]);
    for at_us in [1_000, 2_000, 3_000, 4_000] {
        buffers.serve(&mut hal, at_us);
    }

    let characters = std::iter::from_fn(|| port.receive()).map(|(character, _)| character);
    assert_eq!(
        characters.collect::<Vec<_>>(),
        [Character::Damaged, Character::Damaged, Character::Byte(6)],
        "the one behind a lost one counts as damaged"
    );
}
