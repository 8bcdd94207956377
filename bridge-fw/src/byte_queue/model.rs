//! Models of the queue in every interleaving and reordering that the memory model allows: `cargo xtask loom`.

extern crate std;

use super::{ByteQueue, Full};
use crate::atomic::model::made;
use loom::thread;
use std::sync::Arc;
use std::vec::Vec;

/// Sends `count` bytes from one thread to another, in every order of execution.
fn send<const N: usize>(count: u8) {
    loom::model(move || {
        let queue = Arc::new(made::<ByteQueue<N>>());
        let pushing = Arc::clone(&queue);
        let producer = thread::spawn(move || {
            for byte in 1..=count {
                while pushing.push(byte) == Err(Full) {
                    thread::yield_now();
                }
            }
        });
        let mut popped = Vec::new();
        while popped.len() < usize::from(count) {
            match queue.pop() {
                Some(byte) => popped.push(byte),
                None => thread::yield_now(),
            }
        }
        producer.join().unwrap();
        assert!(popped.iter().copied().eq(1..=count), "{popped:?}");
        assert!(queue.is_empty());
    });
}

#[test]
fn every_byte_arrives_once_and_in_order_through_one_place() {
    send::<1>(3);
}

#[test]
fn every_byte_arrives_once_and_in_order_through_two_places() {
    send::<2>(3);
}

#[test]
fn neither_end_overestimates_bytes_or_room() {
    loom::model(|| {
        let queue = Arc::new(made::<ByteQueue<2>>());
        let popping = Arc::clone(&queue);
        queue.push(1).unwrap();
        let consumer = thread::spawn(move || {
            // Each reported byte can be popped.
            (0..2).filter(|_| !popping.is_empty()).map(|_| popping.pop().unwrap()).collect::<Vec<u8>>()
        });
        // The reported room can be filled.
        let room = queue.room();
        assert!(room >= 1 && queue.is_full() <= (queue.room() == 0));
        for byte in 0..room {
            queue.push(2 + byte as u8).unwrap();
        }
        let popped = consumer.join().unwrap();
        assert!(popped.iter().copied().eq(1..=popped.len() as u8), "{popped:?}");
    });
}

#[test]
fn bytes_pushed_together_are_seen_together() {
    loom::model(|| {
        let queue = Arc::new(made::<ByteQueue<4>>());
        let pushing = Arc::clone(&queue);
        let producer = thread::spawn(move || {
            for pair in [[1, 2], [3, 4], [5, 6]] {
                while pushing.push_all(&pair) == Err(Full) {
                    thread::yield_now();
                }
            }
        });
        for expected in [[1, 2], [3, 4]] {
            let pair = loop {
                match queue.pop_all() {
                    Some(pair) => break pair,
                    None => thread::yield_now(),
                }
            };
            assert_eq!(pair, expected);
        }
        // `clear` also discards whole pairs.
        queue.clear();
        producer.join().unwrap();
        assert!(matches!(queue.pop_all(), None | Some([5, 6])));
        assert!(queue.is_empty());
    });
}
