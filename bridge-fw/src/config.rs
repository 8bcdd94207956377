//! What is fixed about a bridge when it starts, and what its settings begin with. Everything else may import this.

mod bus;
mod can;
mod profibus;
mod recipe;

pub use bus::{BusConfig, Format};
pub use can::{CanConfig, DEFAULT_NODE, NodeConfig, collides_with_canopen};
pub use profibus::ProfibusConfig;
pub use recipe::{RECIPE_COUNT, RECIPES, Recipe};

pub(crate) use can::TPDOS;

use wsg_protocol::session::{self, Timeout};
use wsg_protocol::{CommandId, DeviceTag};

/// The longest reply that a bridge asks for: a device tag behind its status code. Everything longer is not for it.
pub const MAX_REPLY_LEN: usize = DeviceTag::MAX_LEN + 2;

/// The line that the gripper is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GripperLine {
    /// RS-232.
    Serial,
    /// CAN.
    Can,
}

/// The bus of the PLC, beside the wires.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PlcBus {
    /// None.
    Off,
    /// Modbus RTU.
    Modbus,
    /// CANopen.
    Canopen,
    /// PROFIBUS DP.
    Profibus,
}

impl PlcBus {
    /// All of them, each at the place that is its number in the setting PLC_BUS.
    pub(crate) const ALL: [Self; 4] = [Self::Off, Self::Modbus, Self::Canopen, Self::Profibus];
}

/// The identity of the board that a bridge runs on, as a master can read it (CANopen 1009h and 1018h, 4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardId {
    /// Its name.
    pub name: &'static str,
    /// The serial number; of no number is known whether another board has it too.
    pub serial: u32,
}

impl BoardId {
    /// A board of which nothing is known.
    pub const UNKNOWN: Self = Self { name: "unknown", serial: 0 };
}

/// What can be set about a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// How long a wire must keep its level before it counts, in milliseconds.
    pub debounce_ms: u32,
    /// How long BUSY is high at least, in milliseconds: fingers that are at their goal already would show it for less than
    /// a PLC's cycle.
    pub min_busy_ms: u32,
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

/// How long a gripper may take to answer a Stop, in milliseconds, before the fingers count as not stopped. A burst of FAST
/// STOPs behind it takes 90 ms, and both together may take 250 ms.
const STOP_ANSWER_MS: u32 = 100;

impl Config {
    /// Debounced for 2 ms, BUSY for 50 ms at least, the recipes as delivered, the gripper on RS-232, and the PLC on wires and
    /// on Modbus RTU at 19 200 bit/s.
    pub const DEFAULT: Self = Self {
        debounce_ms: 2,
        min_busy_ms: 50,
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
}
