//! The atomics of `loom` with the names and constructors of `core`.
//!
//! `loom` runs two threads in every order, and lets a relaxed load return an old value. An interrupt handler can do no more
//! than a second thread, so code that passes the models is correct for a handler.

extern crate std;

use core::fmt::{self, Debug, Formatter};
use std::format;
use std::sync::OnceLock;

use super::Ordering;
use loom::cell::UnsafeCell;
use loom::sync::atomic;

macro_rules! atomics {
    ($($name:ident: $value:ty;)*) => {$(
        /// Created on first access, because `loom` cannot create it at compile time.
        pub(crate) struct $name {
            initial: $value,
            made: OnceLock<atomic::$name>,
        }

        impl $name {
            pub(crate) const fn new(initial: $value) -> Self {
                Self { initial, made: OnceLock::new() }
            }

            fn made(&self) -> &atomic::$name {
                self.made.get_or_init(|| atomic::$name::new(self.initial))
            }

            pub(crate) fn load(&self, order: Ordering) -> $value {
                self.made().load(order)
            }

            pub(crate) fn store(&self, value: $value, order: Ordering) {
                self.made().store(value, order);
            }
        }

        impl Default for $name {
            fn default() -> Self {
                Self::new(<$value>::default())
            }
        }

        impl Debug for $name {
            fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
                self.made();
                f.write_str(stringify!($name))
            }
        }
    )*};
}

atomics! {
    AtomicBool: bool;
    AtomicU8: u8;
    AtomicU32: u32;
    AtomicUsize: usize;
}

/// A byte of a queue. Unlike a processor, `loom` does not let a load return a value that is stored later. Therefore a place
/// also tracks accesses, and fails if one end accesses it before the other is known to be done.
pub(crate) struct Place {
    byte: AtomicU8,
    visitors: OnceLock<UnsafeCell<()>>,
}

impl Place {
    pub(crate) const fn new(byte: u8) -> Self {
        Self { byte: AtomicU8::new(byte), visitors: OnceLock::new() }
    }

    fn visitors(&self) -> &UnsafeCell<()> {
        self.visitors.get_or_init(|| UnsafeCell::new(()))
    }

    pub(crate) fn load(&self, order: Ordering) -> u8 {
        self.visitors().with(|_| ());
        self.byte.load(order)
    }

    pub(crate) fn store(&self, byte: u8, order: Ordering) {
        self.visitors().with_mut(|_| ());
        self.byte.store(byte, order);
    }
}

impl Debug for Place {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.visitors();
        self.byte.fmt(f)
    }
}

/// Returns a value for a model with all atomics created, which must precede the second thread.
pub(crate) fn made<T: Debug + Default>() -> T {
    let value = T::default();
    let _ = format!("{value:?}");
    value
}
