//! A bounded queue with `Hash`, which `heapless::Deque` lacks. Internal to this crate and `wsg-fieldbus`.

use core::hash::{Hash, Hasher};
use core::ops::{Deref, DerefMut};

use heapless::Deque;

/// A first-in, first-out queue of at most `N` items.
#[derive(Clone, Debug)]
pub struct Queue<T, const N: usize>(Deque<T, N>);

impl<T, const N: usize> Queue<T, N> {
    /// Creates an empty queue.
    #[must_use]
    #[expect(clippy::new_without_default, reason = "internal")]
    pub const fn new() -> Self {
        Self(Deque::new())
    }
}

impl<T, const N: usize> Deref for Queue<T, N> {
    type Target = Deque<T, N>;

    fn deref(&self) -> &Self::Target {
        &self.0
    }
}

impl<T, const N: usize> DerefMut for Queue<T, N> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.0
    }
}

impl<T: Hash, const N: usize> Hash for Queue<T, N> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.len().hash(state);
        self.iter().for_each(|item| item.hash(state));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::hash::DefaultHasher;

    #[test]
    fn queue_hash_depends_on_the_items_and_not_on_their_offset() {
        let hash = |items: &[u8], removed: usize| {
            let mut queue = Queue::<u8, 4>::new();
            for _ in 0..removed {
                queue.push_back(9).unwrap();
                queue.pop_front();
            }
            items.iter().for_each(|item| queue.push_back(*item).unwrap());
            let mut hasher = DefaultHasher::new();
            queue.hash(&mut hasher);
            hasher.finish()
        };
        assert_eq!(hash(&[1, 2], 0), hash(&[1, 2], 3));
        assert!([&[][..], &[1], &[2, 1], &[1, 2, 0]].iter().all(|other| hash(other, 0) != hash(&[1, 2], 0)));
    }
}
