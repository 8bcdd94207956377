//! All settings as one record: what an image is delivered with, and what counts from the next start on.

use super::settings::{SETTINGS, Setting, Settings, into_ranges, ranges, saturate, setting};
use crate::config::{CanConfig, Config, Format, GripperLine, NodeConfig, PlcBus, collides_with_canopen};
use wsg_protocol::can::Identifiers;

/// Places among [`START_SETTINGS`] of those whose range is not all that they are held to.
const CAN_RATE: usize = 4;
const CAN_ID: usize = 5;
const CAN_NODE: usize = 6;

/// The settings that count from a start on; no bus can change them.
pub const START_SETTINGS: [Setting; 8] = [
    setting("PLC_BUS", "", (0, PlcBus::ALL.len() as u16 - 1), PlcBus::NUMBERS),
    setting("GRIPPER_LINE", "", (0, 1), "the gripper's line: 0 RS-232, 1 CAN"),
    setting("MODBUS_RATE", "100 bit/s", (12, 2_304), "the rate of Modbus RTU"),
    setting("MODBUS_FORMAT", "", (0, 2), "a character of Modbus RTU: 0 8E1, 1 8N1, 2 8N2"),
    setting("CAN_RATE", "kbit/s", (125, 1_000), "the rate of CAN: 125, 250, 500 or 1000"),
    setting(
        "CAN_ID",
        "",
        (0, 0x7FE),
        "the identifier that the gripper listens to; it sends on the next one. None of both may be one of CANopen's",
    ),
    setting("CAN_NODE", "", (1, 127), "the bridge's node-ID; not CAN_MASTER's"),
    setting("CAN_MASTER", "", (1, 127), "the node-ID of the CANopen master, whose heartbeat is watched"),
];

/// The ranges alone, so that the words of the table stay out of the image.
const RANGES: [(u16, u16); START_SETTINGS.len()] = ranges(&START_SETTINGS);

/// Words of a [`Record`].
pub const RECORD_LEN: usize = START_SETTINGS.len() + SETTINGS.len();

/// The values of all settings: of [`START_SETTINGS`] first, then of [`SETTINGS`].
pub type Record = [u16; RECORD_LEN];

/// A setting of a record has a value that it does not take, be it only beside another's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSetting {
    /// Its place in the record.
    pub at: usize,
}

impl core::fmt::Display for WrongSetting {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match record_settings().nth(self.at) {
            Some(Setting { name, least, most, meaning, .. }) => {
                write!(f, "{name} takes {least} to {most}: {meaning}")
            }
            None => f.write_str("there is no such setting"),
        }
    }
}

impl core::error::Error for WrongSetting {}

/// Returns the settings of a [`Record`], in its order.
pub fn record_settings() -> impl Iterator<Item = &'static Setting> {
    START_SETTINGS.iter().chain(&SETTINGS)
}

impl Config {
    /// Returns the settings of this configuration as a record, each value brought into its range.
    ///
    /// ```
    /// use wsg_bridge_fw::Config;
    ///
    /// let record = Config::DEFAULT.record();
    /// assert_eq!(record[..4], [1, 0, 192, 0], "Modbus RTU, the gripper on RS-232, 19 200 bit/s, 8E1");
    /// ```
    #[must_use]
    pub const fn record(&self) -> Record {
        let Self { gripper_line, plc_bus, bus, can, .. } = self;
        let start = [
            *plc_bus as u16,
            match gripper_line {
                GripperLine::Serial => 0,
                GripperLine::Can => 1,
            },
            saturate(bus.baud / 100),
            match bus.format {
                Format::Even1 => 0,
                Format::None1 => 1,
                Format::None2 => 2,
            },
            can.kbit_rate,
            can.gripper.base(),
            can.node.node as u16,
            can.node.master as u16,
        ];
        let settings = Settings::new(self);
        let mut record = [0; RECORD_LEN];
        let (head, tail) = record.split_at_mut(START_SETTINGS.len());
        head.copy_from_slice(&into_ranges(start, &RANGES));
        tail.copy_from_slice(settings.values());
        record
    }

    /// Returns the configuration that this record makes. What no setting is for is [`DEFAULT`](Self::DEFAULT)'s.
    ///
    /// # Errors
    /// [`WrongSetting`]: the first whose value is out of its range or does not go with the others.
    pub fn from_record(record: &Record) -> Result<Self, WrongSetting> {
        let (start, rest) = record.split_first_chunk().ok_or(WrongSetting { at: 0 })?;
        if let Some(at) =
            start.iter().zip(RANGES).position(|(value, (least, most))| !(least..=most).contains(value))
        {
            return Err(WrongSetting { at });
        }
        let &[plc_bus, gripper_line, rate, format, can_rate, can_id, node, master] = start;
        let values = rest.first_chunk().ok_or(WrongSetting { at: RECORD_LEN })?;
        let settings = Settings::from_values(*values)
            .map_err(|at| WrongSetting { at: START_SETTINGS.len().saturating_add(at) })?;

        if !matches!(can_rate, 125 | 250 | 500 | 1_000) {
            return Err(WrongSetting { at: CAN_RATE });
        }
        let gripper = Identifiers::from_base(can_id)
            .filter(|pair| !collides_with_canopen(*pair))
            .ok_or(WrongSetting { at: CAN_ID })?;
        let node = NodeConfig { node: node as u8, master: master as u8, ..CanConfig::DEFAULT.node };
        if !node.is_valid() {
            return Err(WrongSetting { at: CAN_NODE });
        }
        let mut config = settings.config(Self::DEFAULT);
        config.plc_bus = *PlcBus::ALL.get(usize::from(plc_bus)).ok_or(WrongSetting { at: 0 })?;
        config.gripper_line = if gripper_line == 0 { GripperLine::Serial } else { GripperLine::Can };
        config.bus.baud = u32::from(rate) * 100;
        config.bus.format = match format {
            0 => Format::Even1,
            1 => Format::None1,
            _ => Format::None2,
        };
        config.can = CanConfig { kbit_rate: can_rate, gripper, node };
        Ok(config)
    }
}

#[cfg(test)]
mod tests;
