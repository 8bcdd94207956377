//! What is fixed about PROFIBUS when the bridge starts: its address, and the rate of the bus.

use crate::register::setting_rows;
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
    const fn rate_setting(rate: Option<Baud>) -> u16 {
        match rate {
            Some(rate) => setting(rate),
            None => 0,
        }
    }

    /// The rate that this setting means; `None` if it is no rate of PROFIBUS that can be set.
    fn rate_of(value: u16) -> Option<Option<Baud>> {
        if value == 0 {
            return Some(None);
        }
        Self::RATES.into_iter().find(|rate| setting(*rate) == value).map(Some)
    }
}

setting_rows! { ProfibusConfig:
    182 "PROFIBUS_ADDRESS" "" (0, 125) "the bridge's address on PROFIBUS"
        address: |it| it as u16, |value| Some(value as u8);
    183 "PROFIBUS_RATE" "100 bit/s" (0, 15_000)
        "the rate of PROFIBUS: 96, 192, 454 (45.45 kbit/s), 937 (93.75 kbit/s), 1875, 5000 or 15000; 0: that of the bus, which is searched"
        rate: |it| Self::rate_setting(it), |value| Self::rate_of(value);
}

const fn setting(rate: Baud) -> u16 {
    (rate.bit_s() / 100) as u16
}

const _: () = assert!(setting(Baud::M1_5) == 15_000);
