//! What can be set about Modbus RTU, and about the silence of every bus.

use crate::register::{saturate, setting_rows};
use bus_modbus::rtu::Timing;
use wsg_fieldbus::SilenceReaction;

/// The bits of a character besides the eight of data (MODBUS over serial line, 2.5.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Even parity, one stop bit: the specification's default.
    Even1,
    /// No parity, one stop bit.
    None1,
    /// No parity, two stop bits: what the specification asks for without parity.
    None2,
}

impl Format {
    /// Bits of a character on the line, start bit included.
    #[must_use]
    pub const fn bits(self) -> u32 {
        match self {
            Self::Even1 | Self::None2 => 11,
            Self::None1 => 10,
        }
    }

    /// The one that is written so.
    #[must_use]
    pub const fn from_name(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"8E1" => Some(Self::Even1),
            b"8N1" => Some(Self::None1),
            b"8N2" => Some(Self::None2),
            _ => None,
        }
    }

    /// As it is written: `8E1`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Even1 => "8E1",
            Self::None1 => "8N1",
            Self::None2 => "8N2",
        }
    }
}

/// The bus at power-up. What can be changed while it runs has a register ([`SETTINGS`](crate::registers::SETTINGS)); rate and
/// format need a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BusConfig {
    /// The rate in bit/s. Which ones a board can do, its board file says.
    pub baud: u32,
    /// The format of a character.
    pub format: Format,
    /// The bridge's address, 1 to 247.
    pub unit: u8,
    /// How long a PLC that commanded may be silent, in milliseconds; 0: for ever.
    pub timeout_ms: u16,
    /// What is done then.
    pub reaction: SilenceReaction,
    /// How long a pause inside a request may be, in milliseconds; 0: by the specification, T1.5.
    pub character_timeout_ms: u16,
    /// Whether broadcasts count. Off as delivered: a register that is broadcast for devices of another kind would be
    /// CMDFLAGS here.
    pub broadcast: bool,
    /// Whether the bytes of numbers in registers 0 to 5 are swapped.
    pub swap_bytes: bool,
}

impl BusConfig {
    /// 19 200 bit/s, 8E1, unit 1: the specification's defaults. Silence of a second stops a motion.
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

    /// The service port: 115 200 bit/s, 8N1, unit 1, and whatever settings say of the PLC's bus changes none of it. It
    /// commands nothing, so its silence is no time-out.
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

    /// The silences of this rate and format.
    #[must_use]
    pub const fn timing(&self) -> Timing {
        Timing::of(self.baud, self.format.bits())
    }
}

setting_rows! { BusConfig:
    100 "UNIT" "" (1, 247) "the bridge's address on the bus, from the next request on"
        unit: |it| it as u16, |value| Some(value as u8);
    101 "BUS_TIMEOUT" "ms" (0, u16::MAX) "how long a PLC that commanded may be silent; 0: for ever"
        timeout_ms: |it| it, |value| Some(value);
    102 "BUS_REACTION" "" (0, 2) "what is done then: 0 hold, 1 stop, 2 FAST STOP; a jog ends in any case"
        reaction: |it| it as u16, |value| Some(match value {
            0 => SilenceReaction::Hold,
            1 => SilenceReaction::Stop,
            _ => SilenceReaction::FastStop,
        });
    103 "BUS_CHAR_TIMEOUT" "ms" (0, 1_000) "how long a pause inside a request may be; 0: T1.5, by the specification"
        character_timeout_ms: |it| it, |value| Some(value);
    104 "BROADCAST" "" (0, 1) "1: broadcast writes count"
        broadcast: |it| it as u16, |value| Some(value != 0);
    105 "SWAP_BYTES" "" (0, 1) "1: the bytes of the numbers in registers 0 to 5 change places"
        swap_bytes: |it| it as u16, |value| Some(value != 0);
    176 "MODBUS_RATE" "100 bit/s" (12, 2_304) "the rate of Modbus RTU"
        baud: |it| saturate(it / 100), |value| Some(u32::from(value) * 100);
    177 "MODBUS_FORMAT" "" (0, 2) "a character of Modbus RTU: 0 8E1, 1 8N1, 2 8N2"
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
    fn formats_have_the_names_that_they_are_found_by() {
        for format in [Format::Even1, Format::None1, Format::None2] {
            assert_eq!(Format::from_name(format.name()), Some(format));
        }
        assert_eq!(Format::from_name("7E1"), None);
    }

    #[test]
    fn slowest_and_fastest_rate_have_the_silences_of_the_specification() {
        let timing = |baud, format| BusConfig { baud, format, ..BusConfig::DEFAULT }.timing();
        // 11 bits at 1200 bit/s are 9 167 us.
        let slow = timing(1_200, Format::Even1);
        assert_eq!((slow.t1_5_us, slow.t3_5_us), (13_750, 32_084));
        let fast = timing(230_400, Format::None1);
        assert_eq!((fast.t1_5_us, fast.t3_5_us), (750, 1_750));
    }
}
