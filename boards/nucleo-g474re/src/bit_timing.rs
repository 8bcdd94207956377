//! The times of a bit on CAN (RM0440, FDCAN_NBTP).

/// Time quanta of a bit: one to synchronise, 20 before and 3 behind the sample point, which so is at 87.5 % (CiA 301, table 1).
const BEFORE_SAMPLE: u8 = 20;
const BEHIND_SAMPLE: u8 = 3;
const QUANTA: u32 = 1 + BEFORE_SAMPLE as u32 + BEHIND_SAMPLE as u32;

/// By how many time quanta a bit may be made longer or shorter to stay in step: as many as there are behind the sample point.
const JUMP: u8 = BEHIND_SAMPLE;

/// How FDCAN1 makes a bit of its clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Cycles of the clock in a time quantum.
    pub prescaler: u16,
    /// Time quanta between the one that synchronises and the sample point.
    pub before_sample: u8,
    /// Time quanta behind the sample point.
    pub behind_sample: u8,
    /// By how many time quanta it may be made longer or shorter.
    pub jump: u8,
}

impl BitTiming {
    /// The times for a rate in kbit/s from a clock in Hz. None for a rate that the clock does not divide to.
    ///
    /// ```
    /// use wsg_nucleo_g474re::BitTiming;
    ///
    /// assert_eq!(BitTiming::for_rate(24_000_000, 500).map(|timing| timing.prescaler), Some(2));
    /// assert_eq!(BitTiming::for_rate(24_000_000, 300), None);
    /// ```
    #[must_use]
    pub const fn for_rate(clock_hz: u32, kbit_rate: u16) -> Option<Self> {
        let quanta_per_s = kbit_rate as u32 * 1_000 * QUANTA;
        if quanta_per_s == 0 || !clock_hz.is_multiple_of(quanta_per_s) {
            return None;
        }
        let prescaler = clock_hz / quanta_per_s;
        // NBRP has 9 bits, and holds one less.
        if prescaler > 1 << 9 {
            return None;
        }
        Some(Self {
            prescaler: prescaler as u16,
            before_sample: BEFORE_SAMPLE,
            behind_sample: BEHIND_SAMPLE,
            jump: JUMP,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK_HZ: u32 = 24_000_000;

    #[test]
    fn usual_rates_are_met_and_sampled_at_seven_eighths() {
        for kbit_rate in [10, 20, 50, 100, 125, 250, 500, 1_000] {
            let timing = BitTiming::for_rate(CLOCK_HZ, kbit_rate).unwrap();
            let before = 1 + u32::from(timing.before_sample);
            let quanta = before + u32::from(timing.behind_sample);
            let cycles = quanta * u32::from(timing.prescaler);
            assert_eq!(cycles * u32::from(kbit_rate) * 1_000, CLOCK_HZ);
            assert_eq!(1_000 * before / quanta, 875);
            assert!(timing.jump <= timing.behind_sample);
        }
    }

    #[test]
    fn a_rate_that_the_clock_does_not_divide_to_is_refused() {
        for kbit_rate in [0, 3, 300, 800, u16::MAX] {
            assert_eq!(BitTiming::for_rate(CLOCK_HZ, kbit_rate), None, "{kbit_rate}");
        }
        assert_eq!(BitTiming::for_rate(CLOCK_HZ, 1), None, "1000 does not fit NBRP");
        assert!(BitTiming::for_rate(CLOCK_HZ, 2).is_some(), "500 does");
    }
}
