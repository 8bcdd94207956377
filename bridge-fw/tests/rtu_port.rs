//! Tests of the RS-485 line of Modbus RTU. The test plays its handler.

use std::cell::Cell;

use bus_modbus::rtu::{Character, MAX_FRAME_LEN};
use wsg_bridge_fw::plc::{BusPort, Interrupts, RtuBuffers, RtuPort, RtuUart};
use wsg_bridge_fw::{BusConfig, Format};

/// Duration of a character of 11 bits at 19 200 bit/s, rounded up.
const CHARACTER_US: u32 = 573;
const CONFIG: BusConfig = BusConfig { baud: 19_200, format: Format::Even1, ..BusConfig::DEFAULT };

thread_local! {
    static NOW_US: Cell<u32> = const { Cell::new(0) };
    static PENDED: Cell<u32> = const { Cell::new(0) };
}

struct Registers;

impl RtuUart for Registers {
    fn pend(&mut self) {
        PENDED.set(PENDED.get() + 1);
    }

    fn now_us(&mut self) -> u32 {
        NOW_US.get()
    }
}

type Buffers = RtuBuffers<16, 256>;

fn line() -> (&'static Buffers, RtuPort<Registers, 16, 256>) {
    let buffers: &'static Buffers = Box::leak(Box::default());
    buffers.start(&CONFIG);
    (buffers, RtuPort::new(Registers, buffers))
}

/// Runs the handler with this state of the registers. Returns the byte to send.
fn handler(buffers: &Buffers, received: Option<u8>, has_room: bool, is_complete: bool) -> Option<u8> {
    if let Some(byte) = received {
        buffers.on_receive(byte, false, is_complete, NOW_US.get());
    }
    buffers.on_transmit(has_room, is_complete)
}

#[test]
fn character_has_the_preceding_silence_in_steps_of_8_us() {
    let (buffers, mut port) = line();
    for (at_us, silence_us) in [(10_000, 10_000 - CHARACTER_US), (10_573, 0), (12_573, 2_000 - 573)] {
        buffers.on_receive(7, false, true, at_us);
        assert_eq!(port.receive(), Some((Character::Byte(7), silence_us / 8 * 8)), "at {at_us} us");
    }
    // Late reading of the clock, and the longest reported silence.
    buffers.on_receive(8, false, true, 12_600);
    assert_eq!(port.receive(), Some((Character::Byte(8), 0)));
    buffers.on_receive(9, false, true, 12_600 + 1_000_000);
    assert_eq!(port.receive(), Some((Character::Byte(9), 0x7FFF * 8)));
    assert_eq!(port.receive(), None);
}

#[test]
fn silence_survives_clock_wrap_and_is_0_while_a_character_waits() {
    let (buffers, mut port) = line();
    buffers.on_receive(1, false, true, u32::MAX - 99);
    NOW_US.set(400);
    assert_eq!(port.silence_us(), 0);
    port.receive().unwrap();
    assert_eq!(port.silence_us(), 500);
}

#[test]
fn damage_is_reported_with_the_character_and_after_a_lost_one() {
    let (buffers, mut port) = line();
    buffers.on_receive(1, true, true, 10_000);
    assert_eq!(port.receive(), Some((Character::Damaged, (10_000 - CHARACTER_US) / 8 * 8)));
    // Five fit. The sixth is lost, and so is the frame that contains the seventh.
    for at in 0..6 {
        buffers.on_receive(at, false, true, 20_000);
    }
    for at in 0..5 {
        assert!(matches!(port.receive(), Some((Character::Byte(byte), _)) if byte == at));
    }
    assert_eq!(port.receive(), None);
    buffers.on_receive(6, false, true, 20_000);
    buffers.on_receive(7, false, true, 20_000);
    assert_eq!(port.receive(), Some((Character::Damaged, 0)));
    assert_eq!(port.receive(), Some((Character::Byte(7), 0)));
}

#[test]
fn overrun_damages_the_next_character_unless_it_hits_an_echo() {
    let (buffers, mut port) = line();
    buffers.on_overrun();
    buffers.on_receive(1, false, true, 20_000);
    buffers.on_receive(2, false, true, 20_000);
    assert!(matches!(port.receive(), Some((Character::Damaged, _))));
    assert_eq!(port.receive(), Some((Character::Byte(2), 0)));
    port.send(&[3]);
    assert_eq!(handler(buffers, None, true, true), Some(3));
    buffers.on_overrun();
    assert_eq!(handler(buffers, None, true, true), None, "the last bit has been sent");
    buffers.on_receive(4, false, true, 20_000);
    assert_eq!(port.receive(), Some((Character::Byte(4), 0)));
}

#[test]
fn frame_is_sent_byte_by_byte_and_another_one_discarded() {
    let (buffers, mut port) = line();
    let idle = Interrupts { transmit_empty: false, transmission_complete: false };
    assert_eq!(buffers.interrupts(), idle);
    port.send(&[1, 2]);
    port.send(&[9]);
    assert_eq!(PENDED.get(), 1, "the second frame is discarded");
    assert_eq!(handler(buffers, None, false, false), None, "no room");
    assert_eq!(buffers.interrupts(), Interrupts { transmit_empty: true, transmission_complete: false });
    assert_eq!(handler(buffers, None, true, true), Some(1));
    assert_eq!(handler(buffers, None, true, false), Some(2));
    assert_eq!(buffers.interrupts(), Interrupts { transmit_empty: false, transmission_complete: true });
    assert_eq!(handler(buffers, None, true, false), None, "the last bit is on the line");
    port.send(&[9]);
    assert_eq!(PENDED.get(), 1);
    assert_eq!(handler(buffers, None, true, true), None);
    assert_eq!(buffers.interrupts(), idle);
    port.send(&[3]);
    assert_eq!(handler(buffers, None, true, true), Some(3));
}

#[test]
fn longest_frame_fits() {
    let (buffers, mut port) = line();
    port.send(&[0x55; MAX_FRAME_LEN]);
    let sent = std::iter::from_fn(|| handler(buffers, None, true, false)).count();
    assert_eq!(sent, MAX_FRAME_LEN);
}

#[test]
fn echo_of_a_frame_is_suppressed() {
    let (buffers, mut port) = line();
    port.send(&[1, 2, 3]);
    assert_eq!(handler(buffers, None, true, true), Some(1));
    assert_eq!(handler(buffers, Some(1), true, false), Some(2));
    assert_eq!(handler(buffers, Some(2), true, false), Some(3));
    // The last echo is received with the last bit.
    assert_eq!(handler(buffers, Some(3), true, true), None);
    assert_eq!(port.receive(), None);
    assert_eq!(handler(buffers, Some(4), true, true), None);
    assert!(matches!(port.receive(), Some((Character::Byte(4), _))), "the next request");
}

#[test]
fn late_handler_receives_a_request_after_a_frame_without_echo() {
    let (buffers, mut port) = line();
    port.send(&[1, 2, 3]);
    for byte in 1..=3 {
        assert_eq!(handler(buffers, None, true, false), Some(byte));
    }
    // The handler runs after the last bit was sent and the request has begun.
    assert_eq!(handler(buffers, Some(0x11), true, true), None);
    assert!(matches!(port.receive(), Some((Character::Byte(0x11), _))));
    // No state of that frame is left, which could be taken for an echo of the next.
    port.send(&[5, 6]);
    assert_eq!(handler(buffers, None, true, true), Some(5));
    assert_eq!(handler(buffers, Some(5), true, false), Some(6));
    assert_eq!(handler(buffers, Some(6), true, true), None);
    assert_eq!(port.receive(), None);
}
