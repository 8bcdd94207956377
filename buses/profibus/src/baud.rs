//! Baud rates, and their automatic detection.

/// Baud rates of PROFIBUS DP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u32)]
pub enum Baud {
    /// 9.6 kbit/s.
    K9_6 = 9_600,
    /// 19.2 kbit/s.
    K19_2 = 19_200,
    /// 45.45 kbit/s.
    K45_45 = 45_450,
    /// 93.75 kbit/s.
    K93_75 = 93_750,
    /// 187.5 kbit/s.
    K187_5 = 187_500,
    /// 500 kbit/s.
    K500 = 500_000,
    /// 1.5 Mbit/s.
    M1_5 = 1_500_000,
    /// 3 Mbit/s.
    M3 = 3_000_000,
    /// 6 Mbit/s.
    M6 = 6_000_000,
    /// 12 Mbit/s.
    M12 = 12_000_000,
}

impl Baud {
    /// All baud rates in ascending order.
    pub const ALL: [Self; 10] = [
        Self::K9_6,
        Self::K19_2,
        Self::K45_45,
        Self::K93_75,
        Self::K187_5,
        Self::K500,
        Self::M1_5,
        Self::M3,
        Self::M6,
        Self::M12,
    ];

    /// Returns the rate in bit/s.
    #[must_use]
    pub const fn bit_s(self) -> u32 {
        self as u32
    }

    /// Returns Max T_SDR, the latest start of an answer after the end of its request, in bit times. DP slot times
    /// are based on this value.
    #[must_use]
    pub const fn max_tsdr_bits(self) -> u16 {
        match self {
            Self::K9_6 | Self::K19_2 | Self::K45_45 | Self::K93_75 | Self::K187_5 => 60,
            Self::K500 => 100,
            Self::M1_5 => 150,
            Self::M3 => 250,
            Self::M6 => 450,
            Self::M12 => 800,
        }
    }

    /// Returns how long the search listens at this rate, in milliseconds. A master polls missing addresses at least
    /// once in 100 token rotations, and an idle rotation takes less than 100 bit times.
    const fn dwell_ms(self) -> u32 {
        const ROUNDS_BITS: u32 = 10_000;
        const LEAST_MS: u32 = 100;
        let rounds_ms = (ROUNDS_BITS * 1_000).div_ceil(self.bit_s());
        LEAST_MS.saturating_add(rounds_ms)
    }
}

/// Time without an intact telegram until the search starts again, in milliseconds.
pub const BAUD_LOST_MS: u32 = 5_000;

/// Detects the baud rate of a bus by listening.
///
/// The search waits at each rate for an intact telegram with a check sum. It keeps the rate of the first one, until
/// none has been received for [`BAUD_LOST_MS`].
///
/// ```
/// use bus_profibus::{Baud, BaudSearch};
///
/// // Baud rates that the port supports.
/// static RATES: [Baud; 2] = [Baud::K500, Baud::M1_5];
/// let mut search = BaudSearch::new(&RATES, 0);
/// assert_eq!((search.baud(), search.is_found()), (Some(Baud::K500), false));
/// // Nothing intact at 500 kbit/s: set the port to 1.5 Mbit/s.
/// assert_eq!(search.poll(119, 0), None);
/// assert_eq!(search.poll(120, 0), Some(Baud::M1_5));
/// // `Slave::counters().telegrams` has increased: the rate is found.
/// assert_eq!(search.poll(121, 1), None);
/// assert!(search.is_found());
/// ```
#[derive(Clone, Debug)]
pub struct BaudSearch {
    rates: &'static [Baud],
    at: usize,
    found: bool,
    /// Time of the last telegram, or of the last change of rate.
    since_ms: u32,
    telegrams: u32,
}

impl BaudSearch {
    /// Creates a search that starts with the first of these rates.
    #[must_use]
    pub const fn new(rates: &'static [Baud], now_ms: u32) -> Self {
        Self { rates, at: 0, found: false, since_ms: now_ms, telegrams: 0 }
    }

    /// Returns the rate to set the port to, or `None` if there are no rates.
    #[must_use]
    pub fn baud(&self) -> Option<Baud> {
        self.rates.get(self.at).copied()
    }

    /// Returns whether telegrams have been received at this rate.
    #[must_use]
    pub const fn is_found(&self) -> bool {
        self.found
    }

    /// Updates the search with the time and the number of intact telegrams
    /// ([`Counters::telegrams`](crate::Counters::telegrams)). Returns the new rate for the port when it changes.
    pub fn poll(&mut self, now_ms: u32, telegrams: u32) -> Option<Baud> {
        let baud = self.baud()?;
        if core::mem::replace(&mut self.telegrams, telegrams) != telegrams {
            self.found = true;
            self.since_ms = now_ms;
            return None;
        }
        let limit_ms = if self.found { BAUD_LOST_MS } else { baud.dwell_ms() };
        if now_ms.wrapping_sub(self.since_ms) < limit_ms {
            return None;
        }
        self.found = false;
        self.since_ms = now_ms;
        self.at = self.at.saturating_add(1);
        if self.at >= self.rates.len() {
            self.at = 0;
        }
        self.baud().filter(|next| *next != baud)
    }
}

#[cfg(test)]
mod tests;
