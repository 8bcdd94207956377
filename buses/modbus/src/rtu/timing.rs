//! Silent intervals (MODBUS over serial line V1.02, 2.5.1.1).

/// Silent intervals T1.5 and T3.5, in microseconds.
///
/// ```
/// use bus_modbus::rtu::Timing;
///
/// // 1.5 and 3.5 characters of 11 bits.
/// assert_eq!(Timing::of(9_600, 11), Timing { t1_5_us: 1_719, t3_5_us: 4_011 });
/// // Fixed above 19 200 bit/s.
/// assert_eq!(Timing::of(115_200, 10), Timing { t1_5_us: 750, t3_5_us: 1_750 });
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Timing {
    /// T1.5: a longer silence inside a frame invalidates the frame.
    pub t1_5_us: u32,
    /// T3.5: a silence of at least this length ends the frame.
    pub t3_5_us: u32,
}

impl Timing {
    /// Returns the intervals at a rate in bit/s. `bits_per_character` includes start, parity and stop bits: 10 for 8N1,
    /// 11 for 8E1 and 8N2. A rate of 0 is treated as 1.
    #[must_use]
    pub const fn of(baud: u32, bits_per_character: u32) -> Self {
        if baud > 19_200 {
            return Self { t1_5_us: 750, t3_5_us: 1_750 };
        }
        let baud = if baud == 0 { 1 } else { baud };
        let half_character_us = bits_per_character.saturating_mul(500_000);
        Self {
            t1_5_us: half_character_us.saturating_mul(3).div_ceil(baud),
            t3_5_us: half_character_us.saturating_mul(7).div_ceil(baud),
        }
    }
}
