//! The queue under every interleaving and every reordering that the memory model allows: `cargo xtask loom`.
//!
//! The atomics are those of `loom`, which plays both ends in every order, and lets a relaxed load see an old value. It does not
//! let a load see a value that is stored later, as a processor may; so each place also notes who is at it, and it is
//! an error when one end is there before it can know that the other has left.

extern crate std;

use super::{ByteQueue, Full};
use core::sync::atomic::Ordering;
use loom::cell::UnsafeCell;
use loom::sync::atomic::AtomicU8;
pub(super) use loom::sync::atomic::AtomicUsize;
use loom::thread;
use std::sync::Arc;
use std::vec::Vec;

/// A place for a byte.
#[derive(Debug)]
pub(super) struct Place {
    byte: AtomicU8,
    visitors: UnsafeCell<()>,
}

impl Place {
    fn new() -> Self {
        Self { byte: AtomicU8::new(0), visitors: UnsafeCell::new(()) }
    }

    pub(super) fn load(&self, order: Ordering) -> u8 {
        self.visitors.with(|_| ());
        self.byte.load(order)
    }

    pub(super) fn store(&self, byte: u8, order: Ordering) {
        self.visitors.with_mut(|_| ());
        self.byte.store(byte, order);
    }
}

impl<const N: usize> ByteQueue<N> {
    /// What the statics of lines are made of, which no model has: the atomics of `loom` are not made at compile time.
    pub(crate) const fn new() -> Self {
        panic!("a model begins with an empty queue")
    }

    /// An empty queue.
    fn empty() -> Self {
        Self {
            bytes: core::array::from_fn(|_| Place::new()),
            pushed: AtomicUsize::new(0),
            popped: AtomicUsize::new(0),
        }
    }
}

/// Sends so many bytes from one thread to another, in every way in which they can run.
fn send<const N: usize>(count: u8) {
    loom::model(move || {
        let queue = Arc::new(ByteQueue::<N>::empty());
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
fn what_either_end_is_told_of_the_other_is_never_too_much() {
    loom::model(|| {
        let queue = Arc::new(ByteQueue::<2>::empty());
        let popping = Arc::clone(&queue);
        queue.push(1).unwrap();
        let consumer = thread::spawn(move || {
            // Of what it is told to be there, it gets a byte.
            (0..2).filter(|_| !popping.is_empty()).map(|_| popping.pop().unwrap()).collect::<Vec<u8>>()
        });
        // What it is told to have room for, it can push.
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
fn what_is_pushed_together_is_seen_together() {
    loom::model(|| {
        let queue = Arc::new(ByteQueue::<4>::empty());
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
        // Whole pairs are dropped, too.
        queue.clear();
        producer.join().unwrap();
        assert!(matches!(queue.pop_all(), None | Some([5, 6])));
        assert!(queue.is_empty());
    });
}
