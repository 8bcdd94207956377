//! What is fixed about PROFIBUS when the bridge starts: its address, and the rate of the bus.

use bus_profibus::Baud;
use wsg_fieldbus::profibus::ADDRESS;

/// The bridge as a DP slave at power-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProfibusConfig {
    /// Its address, 0 to 125.
    pub address: u8,
    /// The rate of the bus; `None`: it is searched among [`RATES`](Self::RATES).
    pub rate: Option<Baud>,
}

impl ProfibusConfig {
    /// Address 7 (fieldbus, 2.2), and whatever rate the bus has.
    pub const DEFAULT: Self = Self { address: ADDRESS.station, rate: None };

    /// The rates that can be set and are searched: 9.6 kbit/s to 1.5 Mbit/s.
    pub const RATES: [Baud; 7] =
        [Baud::K9_6, Baud::K19_2, Baud::K45_45, Baud::K93_75, Baud::K187_5, Baud::K500, Baud::M1_5];

    /// The rate as a setting: in 100 bit/s, what is left of it cut off; 0: searched.
    pub(crate) const fn rate_setting(rate: Option<Baud>) -> u16 {
        match rate {
            Some(rate) => setting(rate),
            None => 0,
        }
    }

    /// The rate that this setting means; `None` if it is no rate of PROFIBUS that can be set.
    pub(crate) fn rate_of(value: u16) -> Option<Option<Baud>> {
        if value == 0 {
            return Some(None);
        }
        Self::RATES.into_iter().find(|rate| setting(*rate) == value).map(Some)
    }
}

const fn setting(rate: Baud) -> u16 {
    (rate.bit_s() / 100) as u16
}

const _: () = assert!(setting(Baud::M1_5) == 15_000);
