//! Resources of an interrupt handler, such as a HAL's UART that the main loop sets up.

use core::cell::RefCell;

use critical_section::Mutex;

/// A resource that a handler owns once it runs; a plain `static`. No method panics.
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
    /// Creates an empty place.
    #[must_use]
    pub const fn new() -> Self {
        Self(Mutex::new(RefCell::new(None)))
    }

    /// Hands over the resource, before its interrupt is unmasked.
    pub fn give(&self, owned: T) {
        critical_section::with(|cs| {
            if let Ok(mut place) = self.0.borrow(cs).try_borrow_mut() {
                *place = Some(owned);
            }
        });
    }

    /// Runs `serve` with the resource. Returns `None` before [`give`](Self::give), and inside another run.
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
    fn resource_is_available_to_one_run_at_a_time() {
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
