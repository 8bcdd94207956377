//! What an interrupt handler owns: a HAL's UART that the main loop sets up and hands over.

use core::cell::RefCell;

use critical_section::Mutex;

/// A place for what belongs to a handler once it runs; a plain `static`. Nothing here panics.
///
/// ```
/// use wsg_bridge_fw::handler::Owned;
///
/// static UART: Owned<u32> = Owned::new();
///
/// assert_eq!(UART.with(|uart| *uart), None);
/// UART.give(7);
/// assert_eq!(UART.with(|uart| *uart), Some(7));
/// ```
#[derive(Debug)]
pub struct Owned<T>(Mutex<RefCell<Option<T>>>);

impl<T> Owned<T> {
    /// An empty place.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(None)))
    }

    /// Hands it over, before its interrupt is unmasked.
    pub fn give(&self, owned: T) {
        critical_section::with(|cs| {
            if let Ok(mut place) = self.0.borrow(cs).try_borrow_mut() {
                *place = Some(owned);
            }
        });
    }

    /// Runs a handler with what it owns; `None` if it was not given, or from within such a run.
    pub fn with<R>(&self, serve: impl FnOnce(&mut T) -> R) -> Option<R> {
        critical_section::with(|cs| self.0.borrow(cs).try_borrow_mut().ok()?.as_mut().map(serve))
    }
}

impl<T> Default for Owned<T> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_given_is_there_for_one_run_at_a_time() {
        static PLACE: Owned<u8> = Owned::new();
        assert_eq!(PLACE.with(|owned| *owned), None);
        PLACE.give(1);
        let inner = PLACE.with(|owned| {
            *owned += 1;
            PLACE.with(|owned| *owned)
        });
        assert_eq!((inner, PLACE.with(|owned| *owned)), (Some(None), Some(2)));
    }
}
