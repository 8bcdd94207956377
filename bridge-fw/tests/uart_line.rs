//! Tests of a UART's line. The test plays its handler.

use std::cell::Cell;
use std::thread::LocalKey;

use embedded_io::{Error as _, ErrorKind, Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::gripper::{LostBytes, ReceiveErrors, Uart, UartBuffers, UartLine, WouldBlock};

const INTACT: ReceiveErrors = ReceiveErrors { framing: false, overrun: false };

thread_local! {
    static PENDED: Cell<u32> = const { Cell::new(0) };
    static IDLE: Cell<bool> = const { Cell::new(true) };
}

fn set<T: 'static>(cell: &'static LocalKey<Cell<T>>, value: T) {
    cell.with(|cell| cell.set(value));
}

struct Registers;

impl Uart for Registers {
    fn pend(&mut self) {
        set(&PENDED, PENDED.get() + 1);
    }

    fn is_idle(&mut self) -> bool {
        IDLE.get()
    }
}

fn line() -> (&'static UartBuffers<4, 4>, UartLine<Registers, 4, 4>) {
    let buffers: &'static UartBuffers<4, 4> = Box::leak(Box::default());
    (buffers, UartLine::new(Registers, buffers))
}

#[test]
fn bytes_are_read_in_order_and_an_empty_line_would_block() {
    let (buffers, mut line) = line();
    assert_eq!(line.read_ready(), Ok(false));
    assert_eq!(line.read(&mut [0; 4]), Err(WouldBlock));
    assert_eq!(line.read(&mut []), Ok(0));
    for byte in 1..=3 {
        buffers.on_receive(Some(byte), INTACT);
    }
    assert!(buffers.has_received());
    assert_eq!(line.read_ready(), Ok(true));
    let mut read = [0; 2];
    assert_eq!(line.read(&mut read), Ok(2));
    assert_eq!(read, [1, 2]);
    assert_eq!(line.read(&mut read), Ok(1));
    assert_eq!(read, [3, 2]);
    assert!(!buffers.has_received());
    assert_eq!(buffers.lost(), LostBytes::default());
    assert_eq!(WouldBlock.kind(), ErrorKind::Other);
    assert_eq!(WouldBlock.to_string(), "the line would have to wait");
}

#[test]
fn lost_bytes_are_counted_by_cause() {
    let (buffers, mut line) = line();
    buffers.on_receive(Some(0xEE), ReceiveErrors { framing: true, overrun: false });
    buffers.on_receive(Some(1), ReceiveErrors { framing: false, overrun: true });
    for byte in 2..=6 {
        buffers.on_receive(Some(byte), INTACT);
    }
    buffers.on_receive(None, INTACT);
    assert_eq!(line.lost(), LostBytes { overrun: 1, framing: 1, queue_full: 2 });
    let mut read = [0; 8];
    assert_eq!(line.read(&mut read), Ok(4));
    assert_eq!(read[..4], [1, 2, 3, 4]);
}

#[test]
fn handler_runs_again_when_a_full_queue_has_room() {
    let (buffers, mut line) = line();
    for byte in 0..4 {
        assert!(buffers.takes_more());
        buffers.on_receive(Some(byte), INTACT);
    }
    assert!(!buffers.takes_more());
    assert_eq!(line.read(&mut []), Ok(0));
    assert_eq!(PENDED.get(), 0, "nothing was read");
    assert_eq!(line.read(&mut [0]), Ok(1));
    assert_eq!(PENDED.get(), 1);
    assert!(buffers.takes_more());
    assert_eq!(line.read(&mut [0]), Ok(1));
    assert_eq!(PENDED.get(), 1, "the queue was not full");
}

#[test]
fn written_bytes_are_sent_in_order_as_far_as_they_fit() {
    let (buffers, mut line) = line();
    assert_eq!(line.write_ready(), Ok(true));
    assert_eq!(line.write(&[1, 2, 3, 4, 5]), Ok(4));
    assert_eq!(PENDED.get(), 1);
    assert_eq!(line.write_ready(), Ok(false));
    assert_eq!(line.write(&[5]), Err(WouldBlock));
    assert_eq!(line.write(&[]), Ok(0));
    for byte in 1..=4 {
        assert!(buffers.has_to_send());
        assert_eq!(buffers.next_to_send(), Some(byte));
    }
    assert!(!buffers.has_to_send());
    assert_eq!(buffers.next_to_send(), None);
}

#[test]
fn line_is_flushed_after_the_last_bit() {
    let (buffers, mut line) = line();
    assert_eq!(line.flush(), Ok(()));
    assert_eq!(line.write(&[1]), Ok(1));
    assert_eq!(line.flush(), Err(WouldBlock));
    set(&IDLE, false);
    assert_eq!(buffers.next_to_send(), Some(1));
    assert_eq!(line.flush(), Err(WouldBlock), "the byte is in the shift register");
    set(&IDLE, true);
    assert_eq!(line.flush(), Ok(()));
}
