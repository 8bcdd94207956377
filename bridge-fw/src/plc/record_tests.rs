use std::string::ToString;
use std::vec::Vec;

use proptest::prelude::*;

use super::*;

const DEFAULT: Record = Config::DEFAULT.record();

fn with(name: &str, value: u16) -> Record {
    let mut record = DEFAULT;
    record[SETTINGS.iter().position(|setting| setting.name == name).unwrap()] = value;
    record
}

#[test]
fn default_configuration_survives_its_record() {
    let config = Config::from_record(&DEFAULT).unwrap();
    assert_eq!(config.record(), DEFAULT);
    assert_eq!((config.plc_bus, config.gripper_line), (PlcBus::Modbus, GripperLine::Serial));
    assert_eq!(config.bus, Config::DEFAULT.bus);
    assert_eq!((config.can, config.profibus), (CanConfig::DEFAULT, ProfibusConfig::DEFAULT));
    assert_eq!(config.recipes, Config::DEFAULT.recipes);
}

#[test]
fn values_of_a_configuration_are_clamped_to_their_ranges() {
    for (baud, rate) in [(0, 12), (6_560_000, 2_304), (u32::MAX, 2_304)] {
        let config = Config { bus: BusConfig { baud, ..Config::DEFAULT.bus }, ..Config::DEFAULT };
        assert_eq!(config.record(), with("MODBUS_RATE", rate), "{baud}");
    }
}

proptest! {
    /// Every record is either refused or returned by its configuration, so no value is ignored.
    #[test]
    fn accepted_record_is_applied_completely(record in SETTINGS.iter()
        .map(|setting| prop_oneof![4 => setting.least..=setting.most, 1 => Just(setting.least), 1 => Just(setting.most)])
        .collect::<Vec<_>>())
    {
        let record: Record = record.try_into().unwrap();
        if let Ok(config) = Config::from_record(&record) {
            prop_assert_eq!(config.record(), record);
        }
    }
}

#[test]
fn value_out_of_range_is_refused_for_each_setting() {
    for (at, setting) in SETTINGS.iter().enumerate() {
        for value in [setting.least.checked_sub(1), setting.most.checked_add(1)].into_iter().flatten() {
            let mut record = DEFAULT;
            record[at] = value;
            assert_eq!(Config::from_record(&record).err(), Some(WrongSetting { at }), "{}", setting.name);
        }
    }
}

#[test]
fn can_has_four_rates() {
    for rate in [125, 250, 500, 1_000] {
        assert_eq!(Config::from_record(&with("CAN_RATE", rate)).unwrap().can.kbit_rate, rate);
    }
    let error = Config::from_record(&with("CAN_RATE", 300)).unwrap_err();
    assert_eq!(error.to_string(), "CAN_RATE takes 125 to 1000: rate of CAN: 125, 250, 500 or 1000");
}

#[test]
fn identifiers_of_canopen_are_refused_for_the_gripper() {
    // 101h and 102h are free. 100h is the time stamp, and 180h, TPDO1 of node 0, is reserved although node 0 does not exist.
    for (id, is_free) in [(0x101, true), (0x100, false), (0x180, false), (0x120, true), (0, false)] {
        assert_eq!(Config::from_record(&with("CAN_ID", id)).is_ok(), is_free, "{id:#x}");
    }
}

#[test]
fn each_bus_of_the_plc_has_its_number() {
    for (number, bus) in [(0, PlcBus::Off), (1, PlcBus::Modbus), (2, PlcBus::Canopen), (3, PlcBus::Profibus)]
    {
        let config = Config::from_record(&with("PLC_BUS", number)).unwrap();
        assert_eq!((config.plc_bus, config.record()), (bus, with("PLC_BUS", number)));
    }
}

#[test]
fn profibus_has_seven_rates_and_the_search_for_one() {
    let rate = |value| Config::from_record(&with("PROFIBUS_RATE", value)).map(|config| config.profibus.rate);
    assert_eq!(rate(0), Ok(None));
    let rates = [96, 192, 454, 937, 1_875, 5_000, 15_000].map(|value| rate(value).unwrap());
    assert_eq!(rates, ProfibusConfig::RATES.map(Some));
    assert!(rate(455).is_err());
    let error = rate(1_152).unwrap_err().to_string();
    assert!(error.starts_with("PROFIBUS_RATE takes 0 to 15000: rate of PROFIBUS: 96, 192,"), "{error}");
}

#[test]
fn bus_recipe_selects_a_recipe_or_none() {
    for (number, recipe) in [(0, Some(0)), (15, Some(15)), (16, None)] {
        assert_eq!(Config::from_record(&with("BUS_RECIPE", number)).unwrap().bus_recipe, recipe);
    }
}

#[test]
fn bridge_and_master_need_different_node_ids() {
    assert!(Config::from_record(&with("CAN_NODE", 0x7F)).is_err());
    assert_eq!(Config::from_record(&with("CAN_NODE", 5)).unwrap().can.node.node, 5);
}
