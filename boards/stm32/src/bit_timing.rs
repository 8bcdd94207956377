//! The times of a bit on CAN (RM0351, 46.7.7; RM0440, FDCAN_NBTP).

/// How a kind of CAN controller divides a bit: one time quantum for synchronisation, and two segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segments {
    before_sample: u8,
    after_sample: u8,
    max_prescaler: u32,
}

impl Segments {
    /// bxCAN, whose prescaler has 10 bits: 16 time quanta, sampled at 87.5 % (CiA 301, table 1).
    pub const BXCAN: Self = Self { before_sample: 13, after_sample: 2, max_prescaler: 1 << 10 };

    /// FDCAN, whose prescaler has 9 bits: 24 time quanta, sampled at 87.5 %.
    pub const FDCAN: Self = Self { before_sample: 20, after_sample: 3, max_prescaler: 1 << 9 };

    const fn quanta(self) -> u32 {
        1 + self.before_sample as u32 + self.after_sample as u32
    }
}

/// How a CAN controller makes a bit of its clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Cycles of the clock in a time quantum.
    pub prescaler: u16,
    /// Time quanta between the one for synchronisation and the sample point.
    pub before_sample: u8,
    /// Time quanta after the sample point.
    pub after_sample: u8,
    /// By how many time quanta a bit may be made longer or shorter: as many as there are after the sample point.
    pub jump: u8,
}

impl BitTiming {
    /// Returns the times for a rate in kbit/s from a clock in Hz. None for a rate that the clock does not divide to.
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

    /// The controllers, each with the clock of its board.
    const CONTROLLERS: [(Segments, u32); 2] = [(Segments::BXCAN, 80_000_000), (Segments::FDCAN, 24_000_000)];

    #[test]
    fn every_rate_of_the_settings_is_met_and_sampled_at_seven_eighths() {
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
