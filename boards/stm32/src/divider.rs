//! Baud rate dividers of USARTs (RM0351, 40.5.4; RM0440, USART_PRESC and USART_BRR).

/// A baud rate divider.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Divider {
    /// Whether the prescaler first halves the clock. Only an STM32G4 has a prescaler.
    pub is_halved: bool,
    /// The value of BRR.
    pub brr: u32,
}

impl Divider {
    /// Returns the divider for a clock in Hz and a rate in bit/s, rounded to the nearest, or `None` for an unsupported rate.
    /// The boards support 1200 bit/s to 1.5 Mbit/s.
    ///
    /// ```
    /// use wsg_stm32::Divider;
    ///
    /// let exactly = |brr| Some(Divider { is_halved: false, brr });
    /// assert_eq!(Divider::for_rate(144_000_000, 19_200), exactly(7_500));
    /// assert_eq!(Divider::for_rate(144_000_000, 1_500_000), exactly(96));
    /// assert_eq!(Divider::for_rate(144_000_000, 300), None);
    /// ```
    #[must_use]
    pub const fn for_rate(clock_hz: u32, baud: u32) -> Option<Self> {
        if baud < RATES.0 || baud > RATES.1 {
            return None;
        }
        // BRR has 16 bits.
        let is_halved = clock_hz / baud >= u16::MAX as u32;
        let clock_hz = if is_halved { clock_hz / 2 } else { clock_hz };
        let brr = (clock_hz + baud / 2) / baud;
        if brr < LEAST_DIVIDER || brr > u16::MAX as u32 {
            return None;
        }
        Some(Self { is_halved, brr })
    }

    /// Returns the divider for a fixed rate. For constants only: evaluation fails unless the divider's error is below 0.1 %,
    /// because the clock needs the rest of the line's tolerance.
    #[must_use]
    pub const fn fixed(clock_hz: u32, baud: u32) -> Self {
        let brr = (clock_hz + baud / 2) / baud;
        assert!(brr >= LEAST_DIVIDER && brr <= u16::MAX as u32);
        assert!((clock_hz / brr).abs_diff(baud) < baud / 1_000);
        Self { is_halved: false, brr }
    }
}

/// Minimum and maximum rate in bit/s.
const RATES: (u32, u32) = (1_200, 1_500_000);

/// The receiver takes 16 samples per bit.
const LEAST_DIVIDER: u32 = 16;

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK_HZ: u32 = 144_000_000;

    #[test]
    fn usual_rates_are_exact_and_45_450_bit_s_within_a_thousandth() {
        const MODBUS: [u32; 9] = [1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 230_400];
        const PROFIBUS: [u32; 4] = [93_750, 187_500, 500_000, 1_500_000];
        let real = |baud| {
            let Divider { is_halved, brr } = Divider::for_rate(CLOCK_HZ, baud).unwrap();
            f64::from(CLOCK_HZ >> u8::from(is_halved)) / f64::from(brr)
        };
        for baud in MODBUS.into_iter().chain(PROFIBUS) {
            assert_eq!(real(baud), f64::from(baud), "{baud}");
        }
        assert!((real(45_450) / 45_450.0 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn rates_outside_the_range_are_refused_and_all_inside_are_not() {
        for baud in [0, 300, 1_199, 1_500_001, u32::MAX] {
            assert_eq!(Divider::for_rate(CLOCK_HZ, baud), None, "{baud}");
        }
        assert!((1_200..=1_500_000).all(|baud| Divider::for_rate(CLOCK_HZ, baud).is_some()));
        assert_eq!(Divider::for_rate(16_000_000, 1_500_000), None, "fewer than 16 cycles per bit");
    }

    #[test]
    fn the_clock_is_halved_only_where_the_divider_would_not_fit() {
        assert!(Divider::for_rate(CLOCK_HZ, 2_190).unwrap().is_halved);
        assert!(!Divider::for_rate(CLOCK_HZ, 2_200).unwrap().is_halved);
    }

    #[test]
    fn a_fixed_rate_is_rounded_to_the_nearest() {
        assert_eq!(Divider::fixed(80_000_000, 115_200), Divider { is_halved: false, brr: 694 });
        assert_eq!(Divider::fixed(CLOCK_HZ, 115_200), Divider { is_halved: false, brr: 1_250 });
    }
}
