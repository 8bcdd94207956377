//! All settings as one record: what an image is delivered with, what is stored, and what counts from the next start on.

use super::settings::{Place, RANGES, Record, Settings, WrongSetting, reaction_of, recipe_of, value_of};
use crate::config::{BusConfig, Config, Format, GripperLine, PlcBus, ProfibusConfig, RECIPE_COUNT};
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::can::Identifiers;

impl Config {
    /// Returns the settings of this configuration as a record, each value brought into its range.
    ///
    /// ```
    /// use wsg_bridge_fw::Config;
    ///
    /// let record = Config::DEFAULT.record();
    /// assert_eq!(record[..3], [1, 1_000, 1], "unit 1, and a stop after a second of silence");
    /// ```
    #[must_use]
    pub const fn record(&self) -> Record {
        let Self {
            debounce_ms,
            min_busy_ms,
            half_frame_ms,
            recipes,
            bus_recipe,
            gripper_line,
            plc_bus,
            bus,
            can,
            profibus,
            ..
        } = self;
        let mut record = [0; RANGES.len()];
        #[expect(clippy::indexing_slicing, reason = "every place is in the table")]
        {
            record[Place::Unit as usize] = bus.unit as u16;
            record[Place::Timeout as usize] = bus.timeout_ms;
            record[Place::Reaction as usize] = match bus.reaction {
                SilenceReaction::Hold => 0,
                SilenceReaction::Stop => 1,
                SilenceReaction::FastStop => 2,
            };
            record[Place::Patience as usize] = bus.character_timeout_ms;
            record[Place::Broadcast as usize] = bus.broadcast as u16;
            record[Place::SwapBytes as usize] = bus.swap_bytes as u16;
            record[Place::Debounce as usize] = saturate(*debounce_ms);
            record[Place::MinBusy as usize] = saturate(*min_busy_ms);
            record[Place::HalfFrame as usize] = saturate(*half_frame_ms);
            record[Place::BusRecipe as usize] = match bus_recipe {
                Some(number) => *number as u16,
                None => u16::MAX,
            };
            record[Place::PlcBus as usize] = *plc_bus as u16;
            record[Place::GripperLine as usize] = match gripper_line {
                GripperLine::Serial => 0,
                GripperLine::Can => 1,
            };
            record[Place::ModbusRate as usize] = saturate(bus.baud / 100);
            record[Place::ModbusFormat as usize] = match bus.format {
                Format::Even1 => 0,
                Format::None1 => 1,
                Format::None2 => 2,
            };
            record[Place::CanRate as usize] = can.kbit_rate;
            record[Place::CanId as usize] = can.gripper.base();
            record[Place::CanNode as usize] = can.node.node as u16;
            record[Place::CanMaster as usize] = can.node.master as u16;
            record[Place::ProfibusAddress as usize] = profibus.address as u16;
            record[Place::ProfibusRate as usize] = profibus.rate_setting();
            let mut at = 0;
            while at < recipes.len() {
                let registers = recipes[at].registers();
                let mut n = 0;
                while n < registers.len() {
                    record[Place::Recipes as usize + at * registers.len() + n] = registers[n];
                    n += 1;
                }
                at += 1;
            }
            let mut at = 0;
            while at < RANGES.len() {
                let (least, most) = RANGES[at];
                record[at] = if record[at] < least { least } else { record[at] };
                record[at] = if record[at] > most { most } else { record[at] };
                at += 1;
            }
        }
        record
    }

    /// Returns the configuration that this record makes. What no setting is for is [`DEFAULT`](Self::DEFAULT)'s.
    ///
    /// # Errors
    /// [`WrongSetting`]: the first whose value is out of its range or does not go with the others.
    pub fn from_record(record: &Record) -> Result<Self, WrongSetting> {
        Settings::check_record(record)?;
        let value = |place| value_of(record, place);
        let wrong = |place: Place| WrongSetting { at: place as usize };
        // In its place from the start on: copies of it would be on the stack.
        let mut config = Self::DEFAULT;
        config.plc_bus = *PlcBus::ALL.get(usize::from(value(Place::PlcBus))).ok_or(wrong(Place::PlcBus))?;
        config.gripper_line =
            if value(Place::GripperLine) == 0 { GripperLine::Serial } else { GripperLine::Can };
        config.can.gripper = Identifiers::from_base(value(Place::CanId)).ok_or(wrong(Place::CanId))?;
        config.can.kbit_rate = value(Place::CanRate);
        config.can.node.node = value(Place::CanNode) as u8;
        config.can.node.master = value(Place::CanMaster) as u8;
        config.profibus = ProfibusConfig {
            address: value(Place::ProfibusAddress) as u8,
            rate: ProfibusConfig::rate_of(value(Place::ProfibusRate)).ok_or(wrong(Place::ProfibusRate))?,
        };
        config.bus = BusConfig {
            baud: u32::from(value(Place::ModbusRate)) * 100,
            format: match value(Place::ModbusFormat) {
                0 => Format::Even1,
                1 => Format::None1,
                _ => Format::None2,
            },
            unit: value(Place::Unit) as u8,
            timeout_ms: value(Place::Timeout),
            reaction: reaction_of(value(Place::Reaction)),
            character_timeout_ms: value(Place::Patience),
            broadcast: value(Place::Broadcast) != 0,
            swap_bytes: value(Place::SwapBytes) != 0,
        };
        config.debounce_ms = value(Place::Debounce).into();
        config.min_busy_ms = value(Place::MinBusy).into();
        config.half_frame_ms = value(Place::HalfFrame).into();
        for (number, recipe) in config.recipes.iter_mut().enumerate() {
            *recipe = recipe_of(record, number).unwrap_or(*recipe);
        }
        config.bus_recipe =
            u8::try_from(value(Place::BusRecipe)).ok().filter(|it| usize::from(*it) < RECIPE_COUNT);
        Ok(config)
    }
}

const fn saturate(value: u32) -> u16 {
    if value > u16::MAX as u32 { u16::MAX } else { value as u16 }
}

#[cfg(test)]
mod tests;
