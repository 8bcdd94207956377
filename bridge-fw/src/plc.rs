//! PLC sides: the ways for a PLC to command the bridge. All share one contract, and each defines its configuration and
//! registers.
//!
//! The wires are always active, with at most one bus beside them. The `arbiter` decides which of the two commands. A bus is a
//! folder here and a row of the list in this file, which generates [`PlcBus`], the register tables and the dispatch.

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
    BusConfig, BusPort, Format, IDENTIFICATION, Interrupts, Modbus, ModbusLine, ModbusTcp, RtuBuffers,
    RtuPort, RtuUart, TcpInput, TcpTurn,
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
use crate::update::Update;
use wsg_protocol::session::{self, Timeout};
use wsg_protocol::{CommandId, Instant};

/// Generates all code that names a PLC side. A row has the number in PLC_BUS, the name, the [`Medium`], the side, its part of
/// [`Config`], and its reports, if any.
macro_rules! plc_sides {
    ($(
        $number:literal $bus:ident $name:literal on $medium:ident
        $side:ident: $type:ty, $config:ident: $config_type:ty $(, $reports:ty)?;
    )*) => {
        /// The PLC's bus, in addition to the wires.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum PlcBus {
            /// No bus: the wires alone.
            Off,
            $(#[doc = concat!($name, ".")] $bus = $number,)*
        }

        impl PlcBus {
            /// All values, each at the index that is its number in PLC_BUS.
            const ALL: &[Self] = &[Self::Off, $(Self::$bus),*];

            /// Returns the line of the bus.
            pub(crate) const fn medium(self) -> Option<Medium> {
                match self {
                    Self::Off => None,
                    $(Self::$bus => Some(Medium::$medium),)*
                }
            }

            /// Meaning of the setting PLC_BUS.
            const MEANING: &str =
                concat!("PLC bus, in addition to the wires: 0 none" $(, ", ", $number, " ", $name)*);
        }

        const SETTING_ROWS: &[Rows<Setting>] =
            &[Config::SETTINGS, WiresConfig::SETTINGS, Recipe::SETTINGS, $(<$config_type>::SETTINGS),*];

        const REPORT_ROWS: &[Rows<Report>] = &[
            View::REPORTS, Update::REPORTS, Events::REPORTS, BusCounts::REPORTS, CanReports::REPORTS, $($(<$reports>::REPORTS,)?)*
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

        /// Checks the settings of each side. All values are already in their ranges.
        fn check_sides(value_at: &impl Fn(usize) -> u16) -> Result<(), u16> {
            $(<$config_type>::check(value_at)?;)*
            Ok(())
        }

        /// Reports of the PLC sides, each with registers of its own.
        #[derive(Clone, Debug, Hash)]
        pub struct SideReports {
            $($($side: $reports,)?)*
        }

        impl SideReports {
            pub(crate) const fn new(config: &Config) -> Self {
                Self { $($($side: <$reports>::new(config),)?)* }
            }

            /// Returns the report in a register, or `None` if no PLC side has this register.
            fn value_of(&self, register: u16) -> Option<u16> {
                None$($(.or_else(|| { let it: &$reports = &self.$side; it.value_of(register) }))?)*
            }
        }

        /// The buses, of which PLC_BUS selects one.
        #[derive(Clone)]
        pub(crate) struct Sides {
            bus: PlcBus,
            $($side: $type,)*
        }

        impl Sides {
            pub(crate) fn start(&mut self, config: &Config, board: BoardId) {
                self.bus = config.plc_bus;
                $(Listed::start(&mut self.$side, config, board);)*
            }

            /// Returns the selected side for one turn. `uart` has the characters of the bus's UART.
            pub(crate) fn over<'a>(&'a mut self, uart: &'a mut dyn BusPort) -> Side<'a> {
                match self.bus {
                    PlcBus::Off => Side::Off(NoBus),
                    $(PlcBus::$bus => Side::$bus(Listed::over(&mut self.$side, uart)),)*
                }
            }
        }

        /// The selected side, as one type. The image then holds the bridge's turn only once, not once per side.
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
    1 Modbus "Modbus RTU" on Uart modbus: Modbus, bus: BusConfig, modbus::ModbusReports;
    2 Canopen "CANopen" on Can canopen: canopen::Node, can: CanConfig;
    3 Profibus "PROFIBUS DP" on Uart profibus: Profibus, profibus: ProfibusConfig, profibus::ProfibusReports;
}

/// The line of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Medium {
    /// The UART of the bus, whose handler is in `bus_line`.
    Uart,
    /// The CAN controller.
    Can,
}

/// Requirements of the list for a PLC side.
pub(crate) trait Listed {
    /// Type of the side during one turn of the bridge.
    type Turn<'a>
    where
        Self: 'a;

    /// Applies the configuration. Called only before the first turn.
    fn start(&mut self, config: &Config, board: BoardId);

    /// Returns the side for one turn. `uart` has the characters of the bus's UART, for a side that reads them in the main loop.
    fn over<'a>(&'a mut self, uart: &'a mut dyn BusPort) -> Self::Turn<'a>;
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

    /// Returns the bridge's CANopen device, even if another bus is selected.
    pub(crate) const fn node(&self) -> &canopen::Node {
        &self.canopen
    }

    /// Returns the CANopen device if CANopen is selected.
    pub(crate) fn on_can(&mut self) -> Option<&mut canopen::Node> {
        self.bus.is_on_can().then_some(&mut self.canopen)
    }
}

impl PlcBus {
    /// Returns whether the PLC is on CAN.
    pub(crate) const fn is_on_can(self) -> bool {
        matches!(self.medium(), Some(Medium::Can))
    }
}

/// Configuration of a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// Timing of the wires.
    pub wires: WiresConfig,
    /// Time without a byte after which an incomplete gripper frame is discarded, in milliseconds.
    pub half_frame_ms: u32,
    /// Recipes, selected by the recipe wires or by BUS_RECIPE.
    pub recipes: [Recipe; RECIPE_COUNT],
    /// Number of the recipe for bus commands. `None`: bus commands use the parameters that the bus writes.
    pub bus_recipe: Option<u8>,
    /// Time-outs for the gripper.
    pub session: session::Config,
    /// Interface to the gripper.
    pub gripper_line: GripperLine,
    /// Bus over which the PLC commands the bridge.
    pub plc_bus: PlcBus,
    /// Settings shared by all buses, and the line of Modbus RTU.
    pub bus: BusConfig,
    /// CAN bus of the gripper, of the PLC, or of both.
    pub can: CanConfig,
    /// Address and rate on PROFIBUS.
    pub profibus: ProfibusConfig,
}

/// Session with the gripper. Settings are read back, because a force limit changed by a damaged frame could injure. An
/// unanswered Stop becomes a FAST STOP while time permits. With this refresh period, no state shown to the PLC is older than
/// 250 ms, even if the line loses one message.
const SESSION: session::Config = session::Config {
    verify_settings: true,
    refresh_ms: 150,
    timeouts: &[Timeout { id: CommandId::Stop, reply_ms: STOP_ANSWER_MS, result_ms: STOP_ANSWER_MS }],
    ..session::Config::DEFAULT
};

/// Time for the gripper to answer a Stop, in milliseconds. After it, the fingers count as still moving. The subsequent burst
/// of FAST STOPs takes 90 ms. Both together may take 250 ms.
const STOP_ANSWER_MS: u32 = 100;

setting_rows! { Config:
    108 "HALF_FRAME" "ms" (1, 1_000) "time without a byte after which an incomplete gripper frame is discarded"
        half_frame_ms: |it| crate::register::saturate(it), |value| Some(value.into());
    173 "BUS_RECIPE" "" (0, RECIPE_COUNT as u16)
        "parameters of bus commands: 0 to 15 this recipe; 16: WIDTH, SPEED and FORCELIMIT of the bus"
        bus_recipe: |it| match it { Some(number) => number as u16, None => u16::MAX },
        |value| Some(u8::try_from(value).ok().filter(|it| usize::from(*it) < RECIPE_COUNT));
    174 "PLC_BUS" "" (0, PlcBus::ALL.len() as u16 - 1) (PlcBus::MEANING)
        plc_bus: |it| it as u16, |value| PlcBus::ALL.get(usize::from(value)).copied();
    175 "GRIPPER_LINE" "" (0, 1) "gripper interface: 0 RS-232, 1 CAN"
        gripper_line: |it| it as u16,
        |value| Some(if value == 0 { GripperLine::Serial } else { GripperLine::Can });
}

impl Config {
    /// Default: 2 ms debounce, BUSY for at least 50 ms, the delivered recipes, the gripper on RS-232, and the PLC on wires
    /// and on Modbus RTU at 19 200 bit/s.
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

    /// Returns the settings of this configuration as a record, each value clamped to its range.
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

    /// Returns the configuration for this record. Parts without a setting have the values of [`DEFAULT`](Self::DEFAULT).
    ///
    /// # Errors
    /// [`WrongSetting`]: the first setting that is out of range or conflicts with another.
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

/// Settings as holding registers from [`FIRST_SETTING`]: one table for the PLC's bus, the flash and `--set`.
pub const SETTINGS: [Setting; count(SETTING_ROWS)] = assembled(FIRST_SETTING, SETTING_ROWS);

/// Reports as input registers from [`FIRST_REPORT`]. Counters saturate at 65 535.
pub const REPORTS: [Report; count(REPORT_ROWS)] = assembled(FIRST_REPORT, REPORT_ROWS);

/// Values of all settings, in the order of [`SETTINGS`].
pub type Record = [u16; SETTINGS.len()];

/// Index from which [`SETTINGS`] take effect only at the next start of the bridge.
pub const FIRST_START_SETTING: usize = place_of("PLC_BUS");

/// Returns the index of a setting in [`SETTINGS`]. An unknown name fails to compile.
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
    /// Index of the setting in the record.
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
            None => f.write_str("no such setting"),
        }
    }
}

impl core::error::Error for WrongSetting {}

/// Ranges without texts, which keeps the texts of [`SETTINGS`] out of the image.
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
    /// Returns the configuration of the wires.
    pub(crate) fn wires(&self) -> WiresConfig {
        let mut wires = WiresConfig::DEFAULT;
        // Cannot fail: the record holds only valid values.
        let _ = wires.take(&values_of(self.record()));
        wires
    }

    /// Returns the configuration of the PLC's bus.
    pub(crate) fn bus(&self) -> BusConfig {
        let mut bus = BusConfig::DEFAULT;
        let _ = bus.take(&values_of(self.record()));
        bus
    }
}

/// Returns an accessor to the values of a record, by index.
fn values_of(record: &Record) -> impl Fn(usize) -> u16 {
    |place| record.get(place).copied().unwrap_or_default()
}

/// Checks that all values are in range and do not conflict.
pub(crate) fn check_record(record: &Record) -> Result<(), WrongSetting> {
    let is_wrong = |(value, (least, most)): (&u16, &(u16, u16))| !(least..=most).contains(&value);
    if let Some(at) = record.iter().zip(&RANGES).position(is_wrong) {
        return Err(WrongSetting { at });
    }
    check_sides(&values_of(record)).map_err(WrongSetting::of)
}

#[cfg(test)]
mod record_tests;
