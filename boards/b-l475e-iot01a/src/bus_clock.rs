//! The clock source and divider of LPUART1 for a rate of the bus (RM0351, 41.4.5).

/// A clock source of LPUART1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusClock {
    /// The 32.768 kHz crystal (X1 on the board), for low rates.
    Lse,
    /// The 16 MHz oscillator that also feeds the PLL; accuracy 1 % over temperature.
    Hsi16,
    /// The 80 MHz bus clock from the PLL, for rates at which a bit has too few cycles of HSI16.
    Pclk1,
}

impl BusClock {
    /// Returns the frequency in Hz.
    #[must_use]
    pub const fn hz(self) -> u32 {
        match self {
            Self::Lse => 32_768,
            Self::Hsi16 => 16_000_000,
            Self::Pclk1 => 80_000_000,
        }
    }

    /// Returns the clock for a rate in bit/s and the divider, which is 256 times their ratio, rounded. Returns `None` for an
    /// unsupported rate. The board supports 1200 bit/s to 1.5 Mbit/s.
    ///
    /// ```
    /// use wsg_b_l475e_iot01a::BusClock;
    ///
    /// assert_eq!(BusClock::for_rate(19_200), Some((BusClock::Hsi16, 213_333)));
    /// assert_eq!(BusClock::for_rate(1_200), Some((BusClock::Lse, 6_991)));
    /// assert_eq!(BusClock::for_rate(1_500_000), Some((BusClock::Pclk1, 13_653)));
    /// assert_eq!(BusClock::for_rate(300), None);
    /// ```
    #[must_use]
    pub const fn for_rate(baud: u32) -> Option<(Self, u32)> {
        if baud < RATES.0 || baud > RATES.1 {
            return None;
        }
        let clock = match baud {
            // BRR has 20 bits, too few for HSI16 below 3907 bit/s and for the PLL below 19 532.
            ..4_800 => Self::Lse,
            4_800..=230_400 => Self::Hsi16,
            _ => Self::Pclk1,
        };
        // 256 times the clock would overflow 32 bits.
        let (whole, rest) = (clock.hz() / baud, clock.hz() % baud);
        Some((clock, 256 * whole + (256 * rest + baud / 2) / baud))
    }
}

/// Minimum and maximum rate in bit/s.
const RATES: (u32, u32) = (1_200, 1_500_000);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dividers_are_rounded_to_the_nearest_and_fit_their_register() {
        assert_eq!(BusClock::for_rate(9_600), Some((BusClock::Hsi16, 426_667)));
        assert_eq!(BusClock::for_rate(19_200), Some((BusClock::Hsi16, 213_333)));
        assert_eq!(BusClock::for_rate(4_799), Some((BusClock::Lse, 1_748)));
        assert_eq!(BusClock::for_rate(4_800), Some((BusClock::Hsi16, 853_333)));
        assert_eq!(BusClock::for_rate(230_400), Some((BusClock::Hsi16, 17_778)));
        assert_eq!(BusClock::for_rate(500_000), Some((BusClock::Pclk1, 40_960)));
        for baud in RATES.0..=RATES.1 {
            let (_, divider) = BusClock::for_rate(baud).unwrap();
            // RM0351, 41.8.4: values below 300h are forbidden. The receiver's tolerance to clock deviation is highest from
            // 1000h (41.4).
            assert!((0x1000..=0xF_FFFF).contains(&divider) || baud < 4_800, "{baud}");
            assert!(divider >= 0x300, "{baud}");
        }
    }

    #[test]
    fn usual_rates_are_met_within_a_thousandth() {
        const MODBUS: [u32; 9] = [1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 230_400];
        const PROFIBUS: [u32; 5] = [45_450, 93_750, 187_500, 500_000, 1_500_000];
        for baud in MODBUS.into_iter().chain(PROFIBUS) {
            let (clock, divider) = BusClock::for_rate(baud).unwrap();
            let real = 256.0 * f64::from(clock.hz()) / f64::from(divider);
            assert!((real / f64::from(baud) - 1.0).abs() < 1e-3, "{baud}: {real}");
            // RM0351: the clock must be 3 to 4096 times the rate.
            assert!((3..=4096).contains(&(clock.hz() / baud)), "{baud}");
        }
    }

    #[test]
    fn rates_outside_the_range_are_refused_and_all_inside_are_not() {
        assert_eq!(BusClock::for_rate(0), None);
        assert_eq!(BusClock::for_rate(1_199), None);
        assert_eq!(BusClock::for_rate(1_500_001), None);
        assert!((1_200..=1_500_000).all(|baud| BusClock::for_rate(baud).is_some()));
    }
}
