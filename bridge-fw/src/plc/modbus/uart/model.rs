//! Models of handler and main loop in every order of events: `cargo xtask loom`.

extern crate std;

use super::*;
use crate::atomic::model::made;
use loom::thread;
use std::boxed::Box;
use std::sync::Arc;
use std::vec::Vec;

type Buffers = RtuBuffers<4, 2>;

/// Main loop's registers, with a clock that the handler's thread advances.
struct Registers(Arc<loom::sync::atomic::AtomicU32>);

impl RtuUart for Registers {
    fn pend(&mut self) {}

    fn now_us(&mut self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A store between the steps of both threads. `loom` tracks one access per atomic, so a thread's load before its own store
/// hides the other thread's access and some orders are skipped. With this store, it runs the steps in every order.
#[derive(Clone)]
struct Turn(Arc<loom::sync::atomic::AtomicBool>);

impl Turn {
    fn new() -> Self {
        Self(Arc::new(loom::sync::atomic::AtomicBool::new(false)))
    }

    fn take(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn line(start_us: u32) -> (&'static Buffers, Arc<loom::sync::atomic::AtomicU32>, RtuPort<Registers, 4, 2>) {
    let buffers: &'static Buffers = Box::leak(Box::new(made()));
    let clock = Arc::new(loom::sync::atomic::AtomicU32::new(start_us));
    (buffers, Arc::clone(&clock), RtuPort::new(Registers(clock), buffers))
}

#[test]
fn every_character_is_received_with_the_preceding_silence() {
    loom::model(|| {
        let (buffers, _, mut port) = line(0);
        let handler = thread::spawn(move || {
            for (byte, now_us) in [(0x11, 800), (0x22, 2_400)] {
                while buffers.received.room() < ENTRY_LEN {
                    thread::yield_now();
                }
                buffers.on_receive(byte, false, true, now_us);
            }
        });
        for expected in [(Character::Byte(0x11), 800), (Character::Byte(0x22), 1_600)] {
            let received = loop {
                match port.receive() {
                    Some(received) => break received,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(received, expected);
        }
        handler.join().unwrap();
        assert_eq!(port.receive(), None);
    });
}

#[test]
fn silence_never_exceeds_the_time_since_the_last_character() {
    loom::model(|| {
        let (buffers, clock, mut port) = line(1_000);
        let turn = Turn::new();
        let of_handler = turn.clone();
        let handler = thread::spawn(move || {
            clock.store(2_000, Ordering::Relaxed);
            buffers.on_receive(0x11, false, true, 2_000);
            of_handler.take();
            clock.store(2_100, Ordering::Relaxed);
        });
        turn.take();
        // A negative value would wrap.
        let silence_us = port.silence_us();
        assert!(silence_us <= 2_100, "{silence_us}");
        if port.receive().is_some() {
            assert!(port.silence_us() <= 100);
        }
        handler.join().unwrap();
    });
}

#[test]
fn frame_is_accepted_only_after_the_previous_one_is_fully_sent() {
    loom::model(|| {
        let (buffers, _, mut port) = line(0);
        let turn = Turn::new();
        let of_handler = turn.clone();
        let handler = thread::spawn(move || {
            let mut sent = Vec::new();
            for _ in 0..3 {
                of_handler.take();
                match buffers.on_transmit(true, false) {
                    Some(byte) => sent.push(byte),
                    // The transmitter is empty.
                    None if buffers.sending.load(Ordering::Relaxed) => {
                        assert_eq!(buffers.on_transmit(false, true), None);
                        sent.push(0);
                    }
                    None => thread::yield_now(),
                }
            }
            sent
        });
        for frame in [[1, 2], [3, 4]] {
            turn.take();
            port.send(&frame);
        }
        turn.take();
        let mut sent = handler.join().unwrap();
        while let Some(byte) = buffers.on_transmit(true, false) {
            sent.push(byte);
        }
        assert!(matches!(sent[..], [1, 2] | [1, 2, 0] | [1, 2, 0, 3, 4]), "{sent:?}");
    });
}
