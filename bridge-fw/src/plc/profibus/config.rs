//! PROFIBUS configuration that is fixed at the start: the bridge's address, and the rate of the bus.

use crate::register::setting_rows;
use bus_profibus::Baud;
use wsg_fieldbus::profibus::ADDRESS;

/// The bridge as a DP slave at power-up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProfibusConfig {
    /// Station address, 0 to 125.
    pub address: u8,
    /// Rate of the bus. `None`: the bridge searches for it among [`RATES`](Self::RATES).
    pub rate: Option<Baud>,
}

impl ProfibusConfig {
    /// Address 7 (fieldbus, 2.2), rate search.
    pub const DEFAULT: Self = Self { address: ADDRESS.station, rate: None };

    /// Rates for setting and search: 9.6 kbit/s to 1.5 Mbit/s.
    pub const RATES: [Baud; 7] =
        [Baud::K9_6, Baud::K19_2, Baud::K45_45, Baud::K93_75, Baud::K187_5, Baud::K500, Baud::M1_5];

    /// Returns the rate as a setting, in 100 bit/s, rounded down; 0: search.
    const fn rate_setting(rate: Option<Baud>) -> u16 {
        match rate {
            Some(rate) => setting(rate),
            None => 0,
        }
    }

    /// Returns the rate for this setting. `None`: not a supported PROFIBUS rate.
    fn rate_of(value: u16) -> Option<Option<Baud>> {
        if value == 0 {
            return Some(None);
        }
        Self::RATES.into_iter().find(|rate| setting(*rate) == value).map(Some)
    }
}

setting_rows! { ProfibusConfig:
    182 "PROFIBUS_ADDRESS" "" (0, 125) "address of the bridge on PROFIBUS"
        address: |it| it as u16, |value| Some(value as u8);
    183 "PROFIBUS_RATE" "100 bit/s" (0, 15_000)
        "rate of PROFIBUS: 96, 192, 454 (45.45 kbit/s), 937 (93.75 kbit/s), 1875, 5000 or 15000; 0: automatic search"
        rate: |it| Self::rate_setting(it), |value| Self::rate_of(value);
}

const fn setting(rate: Baud) -> u16 {
    (rate.bit_s() / 100) as u16
}

const _: () = assert!(setting(Baud::M1_5) == 15_000);
