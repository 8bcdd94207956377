//! Models of handler and main loop in every order of events: `cargo xtask loom`.

extern crate std;

use super::*;
use crate::atomic::model::made;
use loom::thread;
use std::boxed::Box;
use std::vec::Vec;

/// Registers without a function for the main loop.
struct Registers;

impl Uart for Registers {
    fn pend(&mut self) {}

    fn is_idle(&mut self) -> bool {
        true
    }
}

#[test]
fn every_received_byte_is_read_in_order_or_counted() {
    loom::model(|| {
        let buffers: &'static UartBuffers<2, 2> = Box::leak(Box::new(made()));
        let mut line = UartLine::new(Registers, buffers);
        let handler = thread::spawn(move || {
            for byte in 1..=3 {
                buffers.on_receive(Some(byte), ReceiveErrors { framing: false, overrun: false });
            }
        });
        let mut read = Vec::new();
        for _ in 0..2 {
            if line.read_ready().unwrap() {
                let mut buffer = [0; 2];
                let count = line.read(&mut buffer).expect("ready");
                read.extend_from_slice(&buffer[..count]);
            }
        }
        handler.join().unwrap();
        let mut rest = [0; 2];
        let count = line.read(&mut rest).unwrap_or(0);
        read.extend_from_slice(&rest[..count]);
        assert!(read.is_sorted() && read.first().is_none_or(|first| *first == 1), "{read:?}");
        assert_eq!(read.len() as u32 + buffers.lost().queue_full, 3);
    });
}

#[test]
fn every_written_byte_is_sent_in_order_and_none_after_a_flush() {
    loom::model(|| {
        let buffers: &'static UartBuffers<2, 2> = Box::leak(Box::new(made()));
        let mut line = UartLine::new(Registers, buffers);
        let handler = thread::spawn(move || {
            let mut sent = Vec::new();
            while sent.len() < 3 {
                match buffers.next_to_send() {
                    Some(byte) => sent.push(byte),
                    None => thread::yield_now(),
                }
            }
            sent
        });
        for byte in 1..=3 {
            while !line.write_ready().unwrap() {
                thread::yield_now();
            }
            assert_eq!(line.write(&[byte]).expect("ready"), 1);
        }
        while line.flush().is_err() {
            thread::yield_now();
        }
        assert_eq!(buffers.next_to_send(), None);
        assert_eq!(handler.join().unwrap(), [1, 2, 3]);
    });
}
