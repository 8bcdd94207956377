//! Tests of both lines' handlers with a modelled UART of a HAL.

use std::collections::VecDeque;

use bus_modbus::rtu::Character;
use embedded_hal_nb::serial::{ErrorKind, ErrorType, Read, Write};
use wsg_bridge_fw::gripper::{LostBytes, Uart, UartBuffers, UartLine};
use wsg_bridge_fw::plc::{
    BusHandler, BusLine, BusPort, HalfDuplexUart, Interrupts, Profibus, RtuBuffers, RtuPort, RtuUart,
};
use wsg_bridge_fw::{BusConfig, Config, Format, PlcBus, ProfibusConfig};

const CONFIG: BusConfig = BusConfig { baud: 19_200, format: Format::Even1, ..BusConfig::DEFAULT };
const NOTHING: Interrupts = Interrupts { transmit_empty: false, transmission_complete: false };

/// A UART with one received byte, one byte to send, and a shift register.
#[derive(Default)]
struct Hal {
    received: VecDeque<Result<u8, ErrorKind>>,
    waits: Option<u8>,
    is_shifting: bool,
    sent: Vec<u8>,
    is_driving: bool,
    enabled: Option<Interrupts>,
    set_up: Option<(u32, Format)>,
    wait_us: Option<u32>,
    now_us: u32,
}

impl Hal {
    /// Advances the line by one character.
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

impl HalfDuplexUart for Hal {
    fn has_room(&mut self) -> bool {
        self.waits.is_none()
    }

    fn enable(&mut self, interrupts: Interrupts) {
        self.enabled = Some(interrupts);
    }

    fn drive(&mut self, is_on: bool) {
        assert!(is_on || self.flush().is_ok(), "the driver cuts off the last bit");
        self.is_driving = is_on;
    }

    fn set_up(&mut self, baud: u32, format: Format) {
        self.set_up = Some((baud, format));
    }

    fn wake_in(&mut self, us: u32) {
        self.wait_us = Some(us);
    }

    fn now_ms(&mut self) -> u32 {
        self.now_us / 1_000
    }

    fn now_us(&mut self) -> u32 {
        self.now_us
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

    assert!(buffers.serve(&mut hal), "the second byte is queued");
    assert!(buffers.serve(&mut hal), "there is no room for the second byte");
    hal.shift();
    assert!(!buffers.serve(&mut hal));
    hal.shift();

    assert_eq!(hal.sent, [1, 2]);
}

#[test]
fn received_bytes_are_read_and_damaged_ones_counted() {
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
fn frame_ends_after_its_last_bit_and_its_echo_is_suppressed() {
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
    assert_eq!(buffers.serve(&mut hal, 1_146), ending, "the last byte is being sent");
    hal.received.push_back(Ok(2));
    hal.shift();
    assert_eq!(buffers.serve(&mut hal, 1_719), NOTHING);

    assert_eq!((&hal.sent[..], port.receive()), (&[1, 2][..], None));
    hal.received.push_back(Ok(3));
    buffers.serve(&mut hal, 5_000);
    assert!(matches!(port.receive(), Some((Character::Byte(3), _))));
}

#[test]
fn damage_on_the_bus_is_reported_with_its_character() {
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
        "the character after a lost one counts as damaged"
    );
}

/// Returns a line with its handler. The test starts the main loop's end.
fn bus() -> (&'static BusLine, BusHandler, Hal) {
    (Box::leak(Box::default()), BusHandler::new(), Hal::default())
}

#[test]
fn driver_is_on_from_first_byte_to_last_bit_of_a_modbus_frame() {
    let (line, mut handler, mut hal) = bus();
    let set_up = line.start(&Config { bus: CONFIG, ..Config::DEFAULT });
    assert_eq!((set_up, line.follows_turns()), (Some((19_200, Format::Even1)), false));
    let mut port = line.port(Registers);
    handler.serve(line, &mut hal);
    assert_eq!((hal.is_driving, hal.enabled), (false, Some(NOTHING)));
    port.send(&[1, 2]);

    let mut runs = 0;
    loop {
        handler.serve(line, &mut hal);
        if !hal.is_driving {
            break;
        }
        runs += 1;
        assert_ne!(hal.enabled, Some(NOTHING), "no pending interrupt to switch the driver off");
        hal.shift();
    }

    assert_eq!((&hal.sent[..], runs, hal.enabled), (&[1, 2][..], 3, Some(NOTHING)));
    hal.received.push_back(Ok(7));
    hal.now_us = 10_573;
    handler.serve(line, &mut hal);
    assert_eq!(
        port.receive(),
        Some((Character::Byte(7), 10_000)),
        "the silence without the character's 573 us"
    );
}

#[test]
fn profibus_master_is_answered_at_its_rate_with_the_driver_on() {
    /// FDL_Status from master 2 to station 7, and the response.
    const REQUEST: [u8; 6] = [0x10, 0x07, 0x02, 0x49, 0x52, 0x16];
    const ANSWER: [u8; 6] = [0x10, 0x02, 0x07, 0x00, 0x09, 0x16];
    let (line, mut handler, mut hal) = bus();
    let rate = bus_profibus::Baud::K500;
    Profibus::new(line.profibus()).start(ProfibusConfig { rate: Some(rate), ..ProfibusConfig::DEFAULT });
    let set_up = line.start(&Config { plc_bus: PlcBus::Profibus, ..Config::DEFAULT });
    assert_eq!((set_up, line.follows_turns()), (None, true));

    handler.serve(line, &mut hal);
    assert_eq!(hal.set_up, Some((500_000, Format::Even1)));
    hal.now_us = 1_000_000;
    // A damaged character does not belong to the following telegram.
    for received in [Err(ErrorKind::Parity)].into_iter().chain(REQUEST.map(Ok)) {
        assert_eq!(hal.wait_us, None);
        hal.received.push_back(received);
        hal.now_us += if received.is_ok() { 22 } else { 0 };
        handler.serve(line, &mut hal);
        hal.now_us += if received.is_ok() { 0 } else { 1_000 };
    }
    assert!(!hal.is_driving);
    hal.now_us += hal.wait_us.unwrap();
    for _ in ANSWER {
        handler.serve(line, &mut hal);
        assert!(hal.is_driving && hal.enabled != Some(NOTHING));
        hal.shift();
        hal.now_us += 22;
    }
    handler.serve(line, &mut hal);
    assert!(hal.is_driving, "the last byte is being sent");
    hal.shift();
    handler.serve(line, &mut hal);

    assert_eq!((&hal.sent[..], hal.is_driving, hal.enabled), (&ANSWER[..], false, Some(NOTHING)));
}
