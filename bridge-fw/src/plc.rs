//! PLC sides: the ways in which a PLC commands the bridge. All have one contract, and each comes with its configuration and its registers.
//!
//! The wires are always there, with at most one bus beside them. The `arbiter` decides which of the two commands. A bus is a
//! folder here and a row of the list in this file, from which [`PlcBus`], the register tables and the dispatch derive.

mod bus_line;
pub mod canopen;
mod debounce;
mod modbus;
mod motion_end;
mod profibus;
mod settings;
mod side;
mod view;
pub(crate) mod wires;

pub use bus_line::{BusHandler, BusLine, HalfDuplexUart};
pub use modbus::{
    BusConfig, BusPort, Format, IDENTIFICATION, Interrupts, Modbus, ModbusLine, RtuBuffers, RtuPort, RtuUart,
};
pub use profibus::{Action, DpBuffers, DpResponder, Profibus, ProfibusConfig, UartStatus};
pub use side::{BoardId, NoBus, PlcEvent, PlcSide, Shown};
pub use view::View;
pub use wires::WiresConfig;

pub(crate) use debounce::Debounce;
pub(crate) use motion_end::MotionEnd;
pub(crate) use settings::Settings;
pub(crate) use view::{Facts, force_unit};

use crate::can::{CanConfig, CanReports};
use crate::gripper::GripperLine;
use crate::recipe::{RECIPE_COUNT, RECIPES, Recipe};
use crate::register::{
    BusCounts, Events, FIRST_REPORT, FIRST_SETTING, Report, Rows, Setting, assembled, count, setting_rows,
};
use wsg_protocol::session::{self, Timeout};
use wsg_protocol::{CommandId, Instant};

/// Derives everything that names a PLC side from a list of them, with the number in PLC_BUS, the name, the side, its part of
/// [`Config`], and its reports if it has some.
macro_rules! plc_sides {
    ($(
        $number:literal $bus:ident $name:literal
        $side:ident: $type:ty, $config:ident: $config_type:ty $(, $reports:ty)?;
    )*) => {
        /// The bus of the PLC, beside the wires.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum PlcBus {
            /// None.
            Off,
            $(#[doc = concat!($name, ".")] $bus = $number,)*
        }

        impl PlcBus {
            /// All of them, each at the place that is its number in the setting PLC_BUS.
            const ALL: &[Self] = &[Self::Off, $(Self::$bus),*];

            /// What the setting says of them.
            const MEANING: &str =
                concat!("the PLC's bus, beside the wires: 0 none" $(, ", ", $number, " ", $name)*);
        }

        /// The rows of all settings.
        const SETTING_ROWS: &[Rows<Setting>] =
            &[Config::SETTINGS, WiresConfig::SETTINGS, Recipe::SETTINGS, $(<$config_type>::SETTINGS),*];

        /// The rows of all reports.
        const REPORT_ROWS: &[Rows<Report>] = &[
            View::REPORTS, Events::REPORTS, BusCounts::REPORTS, CanReports::REPORTS, $($(<$reports>::REPORTS,)?)*
        ];

        impl Config {
            const fn put_sides(&self, record: &mut Record) {
                $(self.$config.put(record);)*
            }

            fn take_sides(&mut self, value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
                $(self.$config.take(value_at)?;)*
                Ok(())
            }
        }

        /// Checks what settings say of each side, all values being in their ranges.
        fn check_sides(value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
            $(<$config_type>::check(value_at)?;)*
            Ok(())
        }

        /// What the PLC sides report of themselves, in registers of their own.
        #[derive(Clone, Debug, Hash)]
        pub struct SideReports {
            $($($side: $reports,)?)*
        }

        impl SideReports {
            pub(crate) const fn new(config: &Config) -> Self {
                Self { $($($side: <$reports>::new(config),)?)* }
            }

            /// Returns the report in a register, or `None` if it is not one of these.
            fn value_of(&self, register: u16) -> Option<u16> {
                None$($(.or_else(|| { let it: &$reports = &self.$side; it.value_of(register) }))?)*
            }
        }

        /// The PLC sides beside the wires, of which one counts.
        pub(crate) struct Sides {
            bus: PlcBus,
            $($side: $type,)*
        }

        impl Sides {
            pub(crate) fn start(&mut self, config: &Config, board: BoardId) {
                self.bus = config.plc_bus;
                $(Listed::start(&mut self.$side, config, board);)*
            }

            /// Returns the side that counts, for one turn. `port`: the line of Modbus RTU.
            pub(crate) fn over<'a>(&'a mut self, port: &'a mut dyn BusPort) -> Side<'a> {
                match self.bus {
                    PlcBus::Off => Side::Off(NoBus),
                    $(PlcBus::$bus => Side::$bus(Listed::over(&mut self.$side, port)),)*
                }
            }
        }

        /// The side that counts. One type for all, so that the bridge's turn is not in the image for each.
        pub(crate) enum Side<'a> {
            Off(NoBus),
            $($bus(<$type as Listed>::Turn<'a>),)*
        }

        impl PlcSide for Side<'_> {
            fn max_events_per_turn(&self) -> usize {
                match self {
                    Self::Off(side) => side.max_events_per_turn(),
                    $(Self::$bus(side) => side.max_events_per_turn(),)*
                }
            }

            fn report(&self, reports: &mut SideReports) {
                match self {
                    Self::Off(side) => side.report(reports),
                    $(Self::$bus(side) => side.report(reports),)*
                }
            }

            fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
                match self {
                    Self::Off(side) => PlcSide::receive(side, now, view),
                    $(Self::$bus(side) => side.receive(now, view),)*
                }
            }

            fn show(&mut self, now: Instant, shown: &Shown) {
                match self {
                    Self::Off(side) => side.show(now, shown),
                    $(Self::$bus(side) => side.show(now, shown),)*
                }
            }
        }
    };
}

plc_sides! {
    1 Modbus "Modbus RTU" modbus: Modbus, bus: BusConfig, modbus::ModbusReports;
    2 Canopen "CANopen" canopen: canopen::Node, can: CanConfig;
    3 Profibus "PROFIBUS DP" profibus: Profibus, profibus: ProfibusConfig, profibus::ProfibusReports;
}

/// What the list needs of a PLC side.
pub(crate) trait Listed {
    /// The side for one turn of the bridge.
    type Turn<'a>
    where
        Self: 'a;

    /// Takes its configuration, before the first turn alone.
    fn start(&mut self, config: &Config, board: BoardId);

    /// Returns the side for one turn. `port`: the line of Modbus RTU.
    fn over<'a>(&'a mut self, port: &'a mut dyn BusPort) -> Self::Turn<'a>;
}

impl Sides {
    pub(crate) const fn new(config: &Config, profibus: &'static DpBuffers) -> Self {
        Self {
            bus: config.plc_bus,
            modbus: Modbus::new(config),
            canopen: canopen::Node::new(config.can.node),
            profibus: Profibus::new(profibus),
        }
    }

    pub(crate) const fn bus(&self) -> PlcBus {
        self.bus
    }

    /// The bridge as a CANopen device, whether the PLC is on CANopen or not.
    pub(crate) const fn node(&self) -> &canopen::Node {
        &self.canopen
    }

    /// The side that is on CAN, if it counts.
    pub(crate) fn on_can(&mut self) -> Option<&mut canopen::Node> {
        self.bus.is_on_can().then_some(&mut self.canopen)
    }
}

impl PlcBus {
    /// Returns whether the PLC is on CAN.
    pub(crate) const fn is_on_can(self) -> bool {
        matches!(self, Self::Canopen)
    }
}

/// What can be set about a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// The wires.
    pub wires: WiresConfig,
    /// After how long without a byte half a frame is given up, in milliseconds.
    pub half_frame_ms: u32,
    /// What the recipe wires choose from, and BUS_RECIPE.
    pub recipes: [Recipe; RECIPE_COUNT],
    /// The number of the recipe that the bus's commands take; none: they take the parameters that it writes.
    pub bus_recipe: Option<u8>,
    /// Time-outs towards the gripper.
    pub session: session::Config,
    /// Where the gripper is.
    pub gripper_line: GripperLine,
    /// Which bus the PLC is on.
    pub plc_bus: PlcBus,
    /// That bus: Modbus RTU's line, and what every bus has.
    pub bus: BusConfig,
    /// The CAN bus, for whoever is on it.
    pub can: CanConfig,
    /// The bridge on PROFIBUS.
    pub profibus: ProfibusConfig,
}

/// Towards the gripper: settings are read back, because a force limit that a damaged frame changed would hurt. A Stop that
/// is not answered soon becomes a FAST STOP while there is time for one. States are refreshed often enough that none
/// that the PLC sees is older than 250 ms, even when the line loses one message.
const SESSION: session::Config = session::Config {
    verify_settings: true,
    refresh_ms: 150,
    timeouts: &[Timeout { id: CommandId::Stop, reply_ms: STOP_ANSWER_MS, result_ms: STOP_ANSWER_MS }],
    ..session::Config::DEFAULT
};

/// How long a gripper may take to answer a Stop, in milliseconds, before the fingers count as not stopped. The burst
/// of FAST STOPs that follows takes 90 ms, and both together may take 250 ms.
const STOP_ANSWER_MS: u32 = 100;

setting_rows! { Config:
    108 "HALF_FRAME" "ms" (1, 1_000) "after how long without a byte half a frame of the gripper is given up"
        half_frame_ms: |it| crate::register::saturate(it), |value| Some(value.into());
    173 "BUS_RECIPE" "" (0, RECIPE_COUNT as u16)
        "0 to 15: commands of the bus take this recipe's values; 16: WIDTH, SPEED and FORCELIMIT that it writes"
        bus_recipe: |it| match it { Some(number) => number as u16, None => u16::MAX },
        |value| Some(u8::try_from(value).ok().filter(|it| usize::from(*it) < RECIPE_COUNT));
    174 "PLC_BUS" "" (0, PlcBus::ALL.len() as u16 - 1) (PlcBus::MEANING)
        plc_bus: |it| it as u16, |value| PlcBus::ALL.get(usize::from(value)).copied();
    175 "GRIPPER_LINE" "" (0, 1) "the gripper's line: 0 RS-232, 1 CAN"
        gripper_line: |it| it as u16,
        |value| Some(if value == 0 { GripperLine::Serial } else { GripperLine::Can });
}

impl Config {
    /// Debounced for 2 ms, BUSY for 50 ms at least, the recipes as delivered, the gripper on RS-232, and the PLC on wires and
    /// on Modbus RTU at 19 200 bit/s.
    pub const DEFAULT: Self = Self {
        wires: WiresConfig::DEFAULT,
        half_frame_ms: 20,
        recipes: RECIPES,
        bus_recipe: None,
        session: SESSION,
        gripper_line: GripperLine::Serial,
        plc_bus: PlcBus::Modbus,
        bus: BusConfig::DEFAULT,
        can: CanConfig::DEFAULT,
        profibus: ProfibusConfig::DEFAULT,
    };

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
        let mut record = [0; SETTINGS.len()];
        self.put(&mut record);
        self.wires.put(&mut record);
        self.put_sides(&mut record);
        Recipe::put_all(&self.recipes, &mut record);
        let mut at = 0;
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length")]
        while at < RANGES.len() {
            let (least, most) = RANGES[at];
            record[at] = if record[at] < least { least } else { record[at] };
            record[at] = if record[at] > most { most } else { record[at] };
            at += 1;
        }
        record
    }

    /// Returns the configuration that this record makes. What no setting is for is [`DEFAULT`](Self::DEFAULT)'s.
    ///
    /// # Errors
    /// [`WrongSetting`]: the first whose value is out of its range or does not go with the others.
    pub fn from_record(record: &Record) -> Result<Self, WrongSetting> {
        check_record(record)?;
        let mut config = Self::DEFAULT;
        config.take_all(record).map_err(WrongSetting::of)?;
        Ok(config)
    }

    fn take_all(&mut self, record: &Record) -> Result<(), u16> {
        let value_at = &values_of(record);
        self.take(value_at)?;
        self.wires.take(value_at)?;
        for (number, recipe) in self.recipes.iter_mut().enumerate() {
            *recipe = Recipe::of(record, number).unwrap_or(*recipe);
        }
        self.take_sides(value_at)
    }
}

/// The settings as holding registers, from [`FIRST_SETTING`] on: one table, for the PLC's bus, for flash and for `--set`.
pub const SETTINGS: [Setting; count(SETTING_ROWS)] = assembled(FIRST_SETTING, SETTING_ROWS);

/// The reports as input registers, from [`FIRST_REPORT`] on. Counters stop at 65 535.
pub const REPORTS: [Report; count(REPORT_ROWS)] = assembled(FIRST_REPORT, REPORT_ROWS);

/// The values of all settings, in the order of [`SETTINGS`].
pub type Record = [u16; SETTINGS.len()];

/// The [`SETTINGS`] from this place on take effect at the next start of the bridge.
pub const FIRST_START_SETTING: usize = place_of("PLC_BUS");

/// Returns the place of a setting among [`SETTINGS`]. At compile time, where a name that none has does not compile.
const fn place_of(name: &str) -> usize {
    let mut place = 0;
    #[expect(clippy::indexing_slicing, reason = "at compile time, where a wrong index does not compile")]
    while !is_same(SETTINGS[place].name.as_bytes(), name.as_bytes()) {
        place += 1;
    }
    place
}

const fn is_same(one: &[u8], other: &[u8]) -> bool {
    match (one, other) {
        ([], []) => true,
        ([a, one @ ..], [b, other @ ..]) => *a == *b && is_same(one, other),
        _ => false,
    }
}

/// A record that no bridge can use: the value of one setting is outside its range, or conflicts with another setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongSetting {
    /// Its place in the record.
    pub at: usize,
}

impl WrongSetting {
    const fn of(register: u16) -> Self {
        Self { at: register.saturating_sub(FIRST_SETTING) as usize }
    }
}

impl core::fmt::Display for WrongSetting {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match SETTINGS.get(self.at) {
            Some(Setting { name, least, most, meaning, .. }) => {
                write!(f, "{name} takes {least} to {most}: {meaning}")
            }
            None => f.write_str("there is no such setting"),
        }
    }
}

impl core::error::Error for WrongSetting {}

/// The ranges alone, so that the words of the table stay out of the image.
const RANGES: [(u16, u16); SETTINGS.len()] = {
    let mut ranges = [(0, 0); SETTINGS.len()];
    let mut at = 0;
    while at < ranges.len() {
        #[expect(clippy::indexing_slicing, reason = "the loop ends at the table's length, at compile time")]
        {
            ranges[at] = (SETTINGS[at].least, SETTINGS[at].most);
        }
        at += 1;
    }
    ranges
};

impl Settings {
    /// What can be set about the wires.
    pub(crate) fn wires(&self) -> WiresConfig {
        let mut wires = WiresConfig::DEFAULT;
        // Values that no bridge can have are not among them.
        let _ = wires.take(&values_of(self.record()));
        wires
    }

    /// What can be set about the PLC's bus.
    pub(crate) fn bus(&self) -> BusConfig {
        let mut bus = BusConfig::DEFAULT;
        let _ = bus.take(&values_of(self.record()));
        bus
    }
}

/// Returns the values of a record by their places.
fn values_of(record: &Record) -> impl Fn(usize) -> u16 {
    |place| record.get(place).copied().unwrap_or_default()
}

/// Returns whether a bridge can have these values.
pub(crate) fn check_record(record: &Record) -> Result<(), WrongSetting> {
    let is_wrong = |(value, (least, most)): (&u16, &(u16, u16))| !(least..=most).contains(&value);
    if let Some(at) = record.iter().zip(&RANGES).position(is_wrong) {
        return Err(WrongSetting { at });
    }
    check_sides(&values_of(record)).map_err(WrongSetting::of)
}

#[cfg(test)]
mod record_tests;
