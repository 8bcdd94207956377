//! Atomics shared by interrupt handlers and the main loop, from `core`, or from `loom` in the models of `cargo xtask loom`.
//! Only loads and stores are used, because a Cortex-M0+ has no other atomic operations.

#[cfg(all(loom, test))]
pub(crate) mod model;

#[cfg(all(loom, test))]
pub(crate) use self::model::{AtomicBool, AtomicU8, AtomicU32, AtomicUsize, Place};
pub(crate) use core::sync::atomic::Ordering;
#[cfg(not(all(loom, test)))]
pub(crate) use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU8 as Place, AtomicU32, AtomicUsize, fence};
#[cfg(all(loom, test))]
pub(crate) use loom::sync::atomic::fence;
