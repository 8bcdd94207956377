//! The atomics that interrupt handlers and the main loop share: those of `core`, and in the models of `cargo xtask loom` those of
//! `loom`. Loads and stores alone, because a Cortex-M0+ has nothing else.

#[cfg(all(loom, test))]
pub(crate) mod model;

#[cfg(all(loom, test))]
pub(crate) use self::model::{AtomicBool, AtomicU8, AtomicU32, AtomicUsize, Place};
pub(crate) use core::sync::atomic::Ordering;
#[cfg(not(all(loom, test)))]
pub(crate) use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU8 as Place, AtomicU32, AtomicUsize, fence};
#[cfg(all(loom, test))]
pub(crate) use loom::sync::atomic::fence;
