//! CAN bit timing (RM0351, 46.7.7; RM0440, FDCAN_NBTP).

/// The division of a bit by a type of CAN controller: one time quantum for synchronization and two segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segments {
    before_sample: u8,
    after_sample: u8,
    max_prescaler: u32,
}

impl Segments {
    /// bxCAN, with a 10-bit prescaler: 16 time quanta, sampled at 87.5 % (CiA 301, table 1).
    pub const BXCAN: Self = Self { before_sample: 13, after_sample: 2, max_prescaler: 1 << 10 };

    /// FDCAN, with a 9-bit prescaler: 24 time quanta, sampled at 87.5 %.
    pub const FDCAN: Self = Self { before_sample: 20, after_sample: 3, max_prescaler: 1 << 9 };

    const fn quanta(self) -> u32 {
        1 + self.before_sample as u32 + self.after_sample as u32
    }
}

/// The bit timing of a CAN controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Clock cycles in a time quantum.
    pub prescaler: u16,
    /// Time quanta between the synchronization quantum and the sample point.
    pub before_sample: u8,
    /// Time quanta after the sample point.
    pub after_sample: u8,
    /// Synchronization jump width in time quanta, equal to the segment after the sample point.
    pub jump: u8,
}

impl BitTiming {
    /// Returns the bit timing for a rate in kbit/s from a clock in Hz, or `None` if the clock does not divide to the rate.
    ///
    /// ```
    /// use wsg_stm32::{BitTiming, Segments};
    ///
    /// let prescaler = |rate| BitTiming::for_rate(Segments::BXCAN, 80_000_000, rate).map(|timing| timing.prescaler);
    /// assert_eq!(prescaler(500), Some(10));
    /// assert_eq!(prescaler(300), None);
    /// ```
    #[must_use]
    pub const fn for_rate(segments: Segments, clock_hz: u32, kbit_rate: u16) -> Option<Self> {
        let quanta_per_s = kbit_rate as u32 * 1_000 * segments.quanta();
        if quanta_per_s == 0 || !clock_hz.is_multiple_of(quanta_per_s) {
            return None;
        }
        let prescaler = clock_hz / quanta_per_s;
        if prescaler > segments.max_prescaler {
            return None;
        }
        let Segments { before_sample, after_sample, .. } = segments;
        Some(Self { prescaler: prescaler as u16, before_sample, after_sample, jump: after_sample })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The controllers with their boards' clocks.
    const CONTROLLERS: [(Segments, u32); 2] = [(Segments::BXCAN, 80_000_000), (Segments::FDCAN, 24_000_000)];

    #[test]
    fn every_selectable_rate_is_exact_and_sampled_at_seven_eighths() {
        for (segments, clock_hz) in CONTROLLERS {
            for kbit_rate in [10, 20, 50, 100, 125, 250, 500, 1_000] {
                let timing = BitTiming::for_rate(segments, clock_hz, kbit_rate).unwrap();
                let before = 1 + u32::from(timing.before_sample);
                let quanta = before + u32::from(timing.after_sample);
                let cycles = quanta * u32::from(timing.prescaler);
                assert_eq!(cycles * u32::from(kbit_rate) * 1_000, clock_hz);
                assert_eq!(1_000 * before / quanta, 875);
                assert!(timing.jump <= timing.after_sample);
            }
        }
    }

    #[test]
    fn bxcan_has_fields_for_its_segments() {
        let Segments { before_sample, after_sample, .. } = Segments::BXCAN;
        assert!(before_sample <= 16 && after_sample <= 4);
    }

    #[test]
    fn a_rate_that_the_clock_does_not_divide_to_is_refused() {
        for (segments, clock_hz) in CONTROLLERS {
            for kbit_rate in [0, 3, 300, 800, u16::MAX] {
                assert_eq!(BitTiming::for_rate(segments, clock_hz, kbit_rate), None, "{kbit_rate}");
            }
        }
    }

    #[test]
    fn a_prescaler_that_does_not_fit_its_field_is_refused() {
        let prescaler = |(segments, clock_hz), rate| {
            BitTiming::for_rate(segments, clock_hz, rate).map(|timing| timing.prescaler)
        };
        let [bxcan, fdcan] = CONTROLLERS;
        assert_eq!((prescaler(bxcan, 4), prescaler(bxcan, 5)), (None, Some(1_000)));
        assert_eq!((prescaler(fdcan, 1), prescaler(fdcan, 2)), (None, Some(500)));
    }
}
