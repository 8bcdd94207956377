//! Queue between an interrupt handler and the main loop.
//!
//! `heapless::spsc` does not fit: placing its halves in statics requires `unsafe`, and its division by a run-time length can
//! panic.

#[cfg(all(loom, test))]
mod model;

use crate::atomic::{AtomicUsize, Ordering, Place};

/// A queue of up to `N` bytes, a power of two, from one producer to one consumer.
///
/// Both ends use a shared reference, so the queue can be a plain `static`. With more than one producer or consumer at a time,
/// bytes are lost or duplicated, without further effects.
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
    /// Total bytes pushed, wrapping. Written only by the producer.
    pushed: AtomicUsize,
    /// Total bytes popped, wrapping. Written only by the consumer.
    popped: AtomicUsize,
}

/// Error: the queue has no room.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

impl<const N: usize> ByteQueue<N> {
    /// Creates an empty queue.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N.is_power_of_two()) };
        Self { bytes: [const { Place::new(0) }; N], pushed: AtomicUsize::new(0), popped: AtomicUsize::new(0) }
    }

    /// Appends a byte. For the producer.
    ///
    /// # Errors
    /// [`Full`] if the queue holds `N` bytes. `byte` is discarded.
    pub fn push(&self, byte: u8) -> Result<(), Full> {
        let pushed = self.pushed.load(Ordering::Relaxed);
        // Acquire: the consumer has read the place before this byte is stored.
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

    /// Returns the oldest byte without removing it. For the consumer.
    pub fn peek(&self) -> Option<u8> {
        let popped = self.popped.load(Ordering::Relaxed);
        if self.pushed.load(Ordering::Acquire) == popped {
            return None;
        }
        self.bytes.get(popped & (N - 1)).map(|place| place.load(Ordering::Relaxed))
    }

    /// Removes the oldest byte. For the consumer.
    pub fn pop(&self) -> Option<u8> {
        let popped = self.popped.load(Ordering::Relaxed);
        if self.pushed.load(Ordering::Acquire) == popped {
            return None;
        }
        let byte = self.bytes.get(popped & (N - 1))?.load(Ordering::Relaxed);
        self.popped.store(popped.wrapping_add(1), Ordering::Release);
        Some(byte)
    }

    /// Appends bytes, all or none, so that the consumer never sees a part. For the producer.
    ///
    /// # Errors
    /// [`Full`] if there is no room for all `bytes`, which are discarded.
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

    /// Removes the oldest `L` bytes, if that many are queued. For the consumer.
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

    /// Discards all queued bytes. For the consumer.
    pub fn clear(&self) {
        self.popped.store(self.pushed.load(Ordering::Acquire), Ordering::Release);
    }

    /// Returns the room in bytes, as seen by the producer.
    #[must_use]
    pub fn room(&self) -> usize {
        let pushed = self.pushed.load(Ordering::Relaxed);
        N.saturating_sub(pushed.wrapping_sub(self.popped.load(Ordering::Acquire)))
    }

    /// Returns whether the queue is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pushed.load(Ordering::Acquire) == self.popped.load(Ordering::Acquire)
    }

    /// Returns whether the queue has no room.
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
    fn holds_n_bytes() {
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
    fn bytes_pushed_together_are_popped_together_or_not_at_all() {
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
    fn clear_discards_all_bytes_and_frees_their_room() {
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
