//! Pseudo-random numbers, reproducible by seed: SplitMix64 (Steele, Lea and Flood, 2014).

/// A pseudo-random number generator.
#[derive(Clone, Debug)]
pub struct Chance(u64);

impl Chance {
    /// Creates a generator with this seed.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next number.
    pub fn number(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let value = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        value ^ (value >> 31)
    }

    /// Returns a number from 0 to `bound` - 1; 0 for a bound of 0.
    pub fn below(&mut self, bound: u64) -> u64 {
        self.number().checked_rem(bound).unwrap_or(0)
    }

    /// Returns true with this probability, from 0 (never) to 1 (always).
    pub fn hits(&mut self, rate: f64) -> bool {
        const TWO_TO_53: f64 = (1_u64 << 53) as f64;
        ((self.number() >> 11) as f64) < rate * TWO_TO_53
    }
}
