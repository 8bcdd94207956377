//! Which clock LPUART1 runs from for a rate of the bus, and by what it is divided (RM0351, 41.4.5).

/// A clock that LPUART1 can run from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusClock {
    /// The crystal of 32.768 kHz (X1 on the board), for slow rates.
    Lse,
    /// The oscillator of 16 MHz that the PLL runs from: 1 % over temperature.
    Hsi16,
}

impl BusClock {
    /// Its rate in Hz.
    #[must_use]
    pub const fn hz(self) -> u32 {
        match self {
            Self::Lse => 32_768,
            Self::Hsi16 => 16_000_000,
        }
    }

    /// The clock for a rate in bit/s, and the divider: 256 times their ratio, rounded. None for a rate that this board
    /// cannot do; it takes 1200 to 230 400 bit/s.
    ///
    /// ```
    /// use wsg_b_l475e_iot01a::BusClock;
    ///
    /// assert_eq!(BusClock::for_rate(19_200), Some((BusClock::Hsi16, 213_333)));
    /// assert_eq!(BusClock::for_rate(1_200), Some((BusClock::Lse, 6_991)));
    /// assert_eq!(BusClock::for_rate(300), None);
    /// ```
    #[must_use]
    pub const fn for_rate(baud: u32) -> Option<(Self, u32)> {
        if baud < RATES.0 || baud > RATES.1 {
            return None;
        }
        // BRR has 20 bits: too few for HSI16 below 3907 bit/s.
        let clock = if baud < 4_800 { Self::Lse } else { Self::Hsi16 };
        Some((clock, (256 * clock.hz() + baud / 2) / baud))
    }
}

/// The slowest and the fastest rate, in bit/s.
const RATES: (u32, u32) = (1_200, 230_400);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dividers_are_rounded_to_the_nearest_and_fit_their_register() {
        assert_eq!(BusClock::for_rate(9_600), Some((BusClock::Hsi16, 426_667)));
        assert_eq!(BusClock::for_rate(19_200), Some((BusClock::Hsi16, 213_333)));
        assert_eq!(BusClock::for_rate(4_799), Some((BusClock::Lse, 1_748)));
        assert_eq!(BusClock::for_rate(4_800), Some((BusClock::Hsi16, 853_333)));
        for baud in RATES.0..=RATES.1 {
            let (_, divider) = BusClock::for_rate(baud).unwrap();
            // RM0351, 41.8.4: values below 300h are forbidden.
            assert!((0x300..=0xF_FFFF).contains(&divider), "{baud}");
        }
    }

    #[test]
    fn usual_rates_are_met_within_a_thousandth() {
        for baud in [1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 230_400] {
            let (clock, divider) = BusClock::for_rate(baud).unwrap();
            let real = 256.0 * f64::from(clock.hz()) / f64::from(divider);
            assert!((real / f64::from(baud) - 1.0).abs() < 1e-3, "{baud}: {real}");
            // RM0351: the clock is between 3 and 4096 times the rate.
            assert!((3..=4096).contains(&(clock.hz() / baud)), "{baud}");
        }
    }

    #[test]
    fn rates_outside_the_range_are_refused_and_all_inside_are_not() {
        assert_eq!(BusClock::for_rate(0), None);
        assert_eq!(BusClock::for_rate(1_199), None);
        assert_eq!(BusClock::for_rate(230_401), None);
        assert!((1_200..=230_400).all(|baud| BusClock::for_rate(baud).is_some()));
    }
}
