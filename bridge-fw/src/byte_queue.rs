//! The queue between an interrupt handler and the main loop.
//!
//! `heapless::spsc` is not used for this: its two halves have to be put into statics by `unsafe`,
//! and its division by a length known only at run time is a way to panic.

#[cfg(all(loom, test))]
mod model;

use crate::atomic::{AtomicUsize, Ordering, Place};

/// A queue of up to `N` bytes, `N` a power of two, from one producer to one consumer.
///
/// Both sides use it through a shared reference, so it can be a plain `static`. With more than one
/// producer or consumer at the same time bytes get lost or doubled, but nothing worse happens.
///
/// ```
/// use wsg_bridge_fw::byte_queue::{ByteQueue, Full};
///
/// static RECEIVED: ByteQueue<2> = ByteQueue::new();
///
/// assert_eq!(RECEIVED.push(0xAA), Ok(()));
/// assert_eq!(RECEIVED.push(0xAB), Ok(()));
/// assert_eq!(RECEIVED.push(0xAC), Err(Full));
/// assert_eq!(RECEIVED.pop(), Some(0xAA));
/// ```
#[derive(Debug)]
pub struct ByteQueue<const N: usize> {
    bytes: [Place; N],
    /// Bytes ever pushed, wrapping; written by the producer alone.
    pushed: AtomicUsize,
    /// Bytes ever popped, wrapping; written by the consumer alone.
    popped: AtomicUsize,
}

/// A byte was not taken because the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

impl<const N: usize> ByteQueue<N> {
    /// An empty queue.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self { bytes: [const { Place::new(0) }; N], pushed: AtomicUsize::new(0), popped: AtomicUsize::new(0) }
    }

    /// Puts a byte at the end of the queue. For the producer.
    ///
    /// # Errors
    /// [`Full`] when `N` bytes wait already; `byte` is dropped.
    pub fn push(&self, byte: u8) -> Result<(), Full> {
        let pushed = self.pushed.load(Ordering::Relaxed);
        // Acquire: the consumer has read the place before this byte goes there.
        let waiting = pushed.wrapping_sub(self.popped.load(Ordering::Acquire));
        match self.bytes.get(pushed & (N - 1)) {
            Some(place) if waiting < N => {
                place.store(byte, Ordering::Relaxed);
                // Release: a consumer that sees the new count sees the byte.
                self.pushed.store(pushed.wrapping_add(1), Ordering::Release);
                Ok(())
            }
            _ => Err(Full),
        }
    }

    /// The byte that waits longest, which stays. For the consumer.
    pub fn peek(&self) -> Option<u8> {
        let popped = self.popped.load(Ordering::Relaxed);
        if self.pushed.load(Ordering::Acquire) == popped {
            return None;
        }
        self.bytes.get(popped & (N - 1)).map(|place| place.load(Ordering::Relaxed))
    }

    /// Takes the byte that waits longest. For the consumer.
    pub fn pop(&self) -> Option<u8> {
        let popped = self.popped.load(Ordering::Relaxed);
        if self.pushed.load(Ordering::Acquire) == popped {
            return None;
        }
        let byte = self.bytes.get(popped & (N - 1))?.load(Ordering::Relaxed);
        self.popped.store(popped.wrapping_add(1), Ordering::Release);
        Some(byte)
    }

    /// Puts bytes at the end of the queue, all of them or none: the consumer never sees a part. For the producer.
    ///
    /// # Errors
    /// [`Full`] when there is no room for all of them; `bytes` are dropped.
    pub fn push_all(&self, bytes: &[u8]) -> Result<(), Full> {
        if bytes.len() > self.room() {
            return Err(Full);
        }
        let pushed = self.pushed.load(Ordering::Relaxed);
        for (n, byte) in bytes.iter().enumerate() {
            if let Some(place) = self.bytes.get(pushed.wrapping_add(n) & (N - 1)) {
                place.store(*byte, Ordering::Relaxed);
            }
        }
        self.pushed.store(pushed.wrapping_add(bytes.len()), Ordering::Release);
        Ok(())
    }

    /// Takes the `L` bytes that wait longest, if so many wait. For the consumer.
    pub fn pop_all<const L: usize>(&self) -> Option<[u8; L]> {
        let popped = self.popped.load(Ordering::Relaxed);
        if self.pushed.load(Ordering::Acquire).wrapping_sub(popped) < L {
            return None;
        }
        let mut bytes = [0; L];
        for (n, byte) in bytes.iter_mut().enumerate() {
            *byte = self.bytes.get(popped.wrapping_add(n) & (N - 1))?.load(Ordering::Relaxed);
        }
        self.popped.store(popped.wrapping_add(L), Ordering::Release);
        Some(bytes)
    }

    /// Drops what waits. For the consumer.
    pub fn clear(&self) {
        self.popped.store(self.pushed.load(Ordering::Acquire), Ordering::Release);
    }

    /// How many more bytes can be pushed, as the producer sees it.
    #[must_use]
    pub fn room(&self) -> usize {
        let pushed = self.pushed.load(Ordering::Relaxed);
        N.saturating_sub(pushed.wrapping_sub(self.popped.load(Ordering::Acquire)))
    }

    /// Whether no byte waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pushed.load(Ordering::Acquire) == self.popped.load(Ordering::Acquire)
    }

    /// Whether there is no room for another byte.
    #[must_use]
    pub fn is_full(&self) -> bool {
        let pushed = self.pushed.load(Ordering::Acquire);
        pushed.wrapping_sub(self.popped.load(Ordering::Acquire)) >= N
    }
}

impl<const N: usize> Default for ByteQueue<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    extern crate std;

    use super::*;

    #[test]
    fn takes_as_many_bytes_as_its_size_says() {
        let queue = ByteQueue::<4>::new();
        for byte in 0..4 {
            assert!(!queue.is_full());
            assert_eq!(queue.room(), 4 - usize::from(byte));
            assert_eq!(queue.push(byte), Ok(()));
        }
        assert!(queue.is_full());
        assert_eq!((queue.room(), queue.push(4)), (0, Err(Full)));
        for byte in 0..4 {
            assert!(!queue.is_empty());
            assert_eq!(queue.pop(), Some(byte));
        }
        assert!(queue.is_empty());
        assert_eq!(queue.pop(), None);
    }

    #[test]
    fn bytes_that_are_pushed_together_come_together_or_not_at_all() {
        let queue = ByteQueue::<4> {
            pushed: AtomicUsize::new(usize::MAX - 1),
            popped: AtomicUsize::new(usize::MAX - 1),
            ..ByteQueue::new()
        };
        assert_eq!(queue.push_all(&[1, 2, 3]), Ok(()));
        assert_eq!(queue.push_all(&[4, 5]), Err(Full));
        assert_eq!(queue.pop_all::<4>(), None);
        assert_eq!(queue.pop_all(), Some([1, 2]));
        assert_eq!(queue.push_all(&[4, 5, 6]), Ok(()));
        assert_eq!(queue.pop_all(), Some([3, 4, 5, 6]));
        assert!(queue.is_empty());
    }

    #[test]
    fn what_is_cleared_is_gone_and_leaves_its_room() {
        let queue = ByteQueue::<2>::new();
        assert_eq!(queue.push_all(&[1, 2]), Ok(()));
        queue.clear();
        assert_eq!((queue.pop(), queue.room()), (None, 2));
    }

    #[test]
    fn counts_may_wrap() {
        let queue = ByteQueue::<4> {
            pushed: AtomicUsize::new(usize::MAX - 1),
            popped: AtomicUsize::new(usize::MAX - 1),
            ..ByteQueue::new()
        };
        for byte in 0..9 {
            assert_eq!(queue.push(byte), Ok(()));
            assert_eq!(queue.push(byte | 0x80), Ok(()));
            assert_eq!(queue.pop(), Some(byte));
            assert_eq!(queue.pop(), Some(byte | 0x80));
            assert!(queue.is_empty());
        }
    }

    #[test]
    fn every_byte_arrives_once_and_in_order_from_another_thread() {
        const BYTES: u32 = 20_000;
        let queue = ByteQueue::<8>::new();
        std::thread::scope(|threads| {
            threads.spawn(|| {
                for n in 0..BYTES {
                    while queue.push(n as u8).is_err() {
                        std::thread::yield_now();
                    }
                }
            });
            for n in 0..BYTES {
                let byte = loop {
                    match queue.pop() {
                        Some(byte) => break byte,
                        None => std::thread::yield_now(),
                    }
                };
                assert_eq!(byte, n as u8);
            }
        });
        assert!(queue.is_empty());
    }
}
