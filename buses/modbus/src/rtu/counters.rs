//! Diagnostic counters read by FC 8 (MODBUS over serial line, appendix A; application protocol, 6.8).

use super::Damage;
use crate::Exception;

/// Diagnostic counters. Each saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Bus Message Count: intact frames, for any unit.
    pub bus_messages: u16,
    /// Bus Communication Error Count: damaged frames.
    pub bus_errors: u16,
    /// Bus Exception Error Count: exceptions, including exceptions to broadcasts.
    pub exceptions: u16,
    /// Server Message Count: intact frames for this unit and broadcasts.
    pub server_messages: u16,
    /// Server No Response Count: messages to this server that it did not respond to.
    pub no_responses: u16,
    /// Server Busy Count: exceptions 06.
    pub busy: u16,
    /// Bus Character Overrun Count: frames with a damaged or lost character.
    pub overruns: u16,
    /// Stray characters before and after intact frames; see [`Receiver`](super::Receiver). FC 8 clears but does not read it.
    pub strays: u16,
}

impl Counters {
    /// All counters at zero.
    pub const ZERO: Self = Self {
        bus_messages: 0,
        bus_errors: 0,
        exceptions: 0,
        server_messages: 0,
        no_responses: 0,
        busy: 0,
        overruns: 0,
        strays: 0,
    };

    /// Returns the counter that this subfunction of FC 8 reads, from 0Bh to 12h.
    pub(super) fn by_subfunction(&self, sub: u16) -> u16 {
        // This server never sends a negative acknowledgement (exception 07).
        let naks = 0;
        let counters = [
            self.bus_messages,
            self.bus_errors,
            self.exceptions,
            self.server_messages,
            self.no_responses,
            naks,
            self.busy,
            self.overruns,
        ];
        counters.get(usize::from(sub.wrapping_sub(0x0B))).copied().unwrap_or(0)
    }

    pub(super) fn damaged(&mut self, damage: Damage) {
        count(&mut self.bus_errors);
        if damage == Damage::Character {
            count(&mut self.overruns);
        }
    }

    pub(super) fn excepted(&mut self, exception: Exception) {
        count(&mut self.exceptions);
        if exception == Exception::ServerDeviceBusy {
            count(&mut self.busy);
        }
    }
}

pub(super) const fn count(counter: &mut u16) {
    *counter = counter.saturating_add(1);
}
