//! Configuration of Modbus RTU, and of the time-out of every bus.

use crate::register::{saturate, setting_rows};
use bus_modbus::rtu::Timing;
use wsg_fieldbus::SilenceReaction;

/// Format of a character: its bits in addition to the eight data bits (MODBUS over serial line, 2.5.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Even parity, one stop bit: the specification's default.
    Even1,
    /// No parity, one stop bit.
    None1,
    /// No parity, two stop bits: required by the specification without parity.
    None2,
}

impl Format {
    /// Returns the length of a character in bits, start bit included.
    #[must_use]
    pub const fn bits(self) -> u32 {
        match self {
            Self::Even1 | Self::None2 => 11,
            Self::None1 => 10,
        }
    }

    /// Parses a name such as `8E1`.
    #[must_use]
    pub const fn from_name(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"8E1" => Some(Self::Even1),
            b"8N1" => Some(Self::None1),
            b"8N2" => Some(Self::None2),
            _ => None,
        }
    }

    /// Returns the usual name, such as `8E1`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Even1 => "8E1",
            Self::None1 => "8N1",
            Self::None2 => "8N2",
        }
    }
}

/// The bus at power-up. Rate and format need a restart. The other values are settings that can change at run time
/// ([`SETTINGS`](crate::registers::SETTINGS)).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BusConfig {
    /// Rate in bit/s. The board's documentation lists the supported rates.
    pub baud: u32,
    /// Format of a character.
    pub format: Format,
    /// Address of the bridge, 1 to 247.
    pub unit: u8,
    /// Longest silence of a commanding PLC, in milliseconds; 0: unlimited.
    pub timeout_ms: u16,
    /// Reaction to a longer silence.
    pub reaction: SilenceReaction,
    /// Longest pause inside a request, in milliseconds; 0: T1.5 of the specification.
    pub character_timeout_ms: u16,
    /// Broadcast writes are executed. Off by default: a broadcast register of another kind of device could be CMDFLAGS here.
    pub broadcast: bool,
    /// The bytes of numbers in registers 0 to 5 are swapped.
    pub swap_bytes: bool,
}

impl BusConfig {
    /// 19 200 bit/s, 8E1, unit 1: the specification's defaults. A silence of 1 s stops a motion.
    pub const DEFAULT: Self = Self {
        baud: 19_200,
        format: Format::Even1,
        unit: 1,
        timeout_ms: 1_000,
        reaction: SilenceReaction::Stop,
        character_timeout_ms: 50,
        broadcast: false,
        swap_bytes: false,
    };

    /// The service port: 115 200 bit/s, 8N1, unit 1, independent of the settings of the PLC's bus. It has no time-out,
    /// because it cannot command motions.
    pub const SERVICE: Self = Self {
        baud: 115_200,
        format: Format::None1,
        unit: 1,
        timeout_ms: 0,
        reaction: SilenceReaction::Hold,
        character_timeout_ms: 50,
        broadcast: false,
        swap_bytes: false,
    };

    /// Returns the silences of this rate and format.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        Timing::of(self.baud, self.format.bits())
    }
}

setting_rows! { BusConfig:
    100 "UNIT" "" (1, 247) "address of the bridge on the bus; takes effect with the next request"
        unit: |it| it as u16, |value| Some(value as u8);
    101 "BUS_TIMEOUT" "ms" (0, u16::MAX) "longest silence of a commanding PLC; 0: unlimited"
        timeout_ms: |it| it, |value| Some(value);
    102 "BUS_REACTION" "" (0, 2) "reaction to a longer silence: 0 hold, 1 stop, 2 FAST STOP; a jog always ends"
        reaction: |it| it as u16, |value| Some(match value {
            0 => SilenceReaction::Hold,
            1 => SilenceReaction::Stop,
            _ => SilenceReaction::FastStop,
        });
    103 "BUS_CHAR_TIMEOUT" "ms" (0, 1_000) "longest pause inside a request; 0: T1.5 of the specification"
        character_timeout_ms: |it| it, |value| Some(value);
    104 "BROADCAST" "" (0, 1) "1: broadcast writes are executed"
        broadcast: |it| it as u16, |value| Some(value != 0);
    105 "SWAP_BYTES" "" (0, 1) "1: the bytes of numbers in registers 0 to 5 are swapped"
        swap_bytes: |it| it as u16, |value| Some(value != 0);
    176 "MODBUS_RATE" "100 bit/s" (12, 2_304) "rate of Modbus RTU"
        baud: |it| saturate(it / 100), |value| Some(u32::from(value) * 100);
    177 "MODBUS_FORMAT" "" (0, 2) "character format of Modbus RTU: 0 8E1, 1 8N1, 2 8N2"
        format: |it| it as u16, |value| Some(match value {
            0 => Format::Even1,
            1 => Format::None1,
            _ => Format::None2,
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_format_is_found_by_its_name() {
        for format in [Format::Even1, Format::None1, Format::None2] {
            assert_eq!(Format::from_name(format.name()), Some(format));
        }
        assert_eq!(Format::from_name("7E1"), None);
    }

    #[test]
    fn silences_at_the_slowest_and_fastest_rate_are_as_specified() {
        let timing = |baud, format| BusConfig { baud, format, ..BusConfig::DEFAULT }.timing();
        // 11 bits at 1200 bit/s are 9 167 us.
        let slow = timing(1_200, Format::Even1);
        assert_eq!((slow.t1_5_us, slow.t3_5_us), (13_750, 32_084));
        let fast = timing(230_400, Format::None1);
        assert_eq!((fast.t1_5_us, fast.t3_5_us), (750, 1_750));
    }
}
