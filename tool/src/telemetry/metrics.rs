//! Metric tables of grippers, bridges and the edge node, from which births, data and docs/telemetry.md are derived.

use super::payload::{DataType, MetricValue};

/// A value of a metric. `Option::None` stands for null: unknown.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Float(f32),
    Unsigned(u64),
    Boolean(bool),
    Text(String),
}

/// A metric in a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) datatype: DataType,
    /// Unit, or empty.
    pub(super) unit: &'static str,
    pub(super) meaning: &'static str,
}

const fn metric(name: &'static str, datatype: DataType, unit: &'static str, meaning: &'static str) -> Metric {
    Metric { name, datatype, unit, meaning }
}

impl Metric {
    /// Returns the type code for the payload.
    ///
    /// Data messages include it although Sparkplug advises against it. Decoders that do not store births, such as Eclipse Tahu's for
    /// JavaScript, read null without it.
    pub(super) fn datatype(&self) -> u32 {
        self.datatype as u32
    }
}

impl Value {
    /// Converts the value for the payload.
    pub(super) fn encode(&self) -> MetricValue {
        match self {
            Self::Float(number) => MetricValue::Float(*number),
            Self::Unsigned(number) => MetricValue::Long(*number),
            Self::Boolean(on) => MetricValue::Boolean(*on),
            Self::Text(text) => MetricValue::String(text.clone()),
        }
    }
}

/// Defines a table and an enum of its rows, so that no index is written by hand.
macro_rules! table {
    ($(#[$doc:meta])* $table:ident, $index:ident { $($row:ident: $name:literal $datatype:ident $unit:literal $meaning:literal;)* }) => {
        /// The rows of the table.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum $index { $($row),* }

        impl From<$index> for usize {
            fn from(row: $index) -> Self {
                row as Self
            }
        }

        $(#[$doc])*
        pub(super) const $table: &[Metric] = &[$(metric($name, DataType::$datatype, $unit, $meaning)),*];
    };
}

table! {
    /// Metrics of a gripper.
    GRIPPER, OfGripper {
        Width: "Width" Float "mm" "opening width; null while the fingers are not referenced";
        Speed: "Speed" Float "mm/s" "finger speed";
        Force: "Force" Float "N" "gripping force, summed over both fingers";
        State: "State" String "" "gripper state, as named in the command set: IDLE, GRIPPING, NO PART, PART LOST, HOLDING, RELEASING, POSITIONING, ERROR";
        Flags: "Flags" UInt64 "" "system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers are moving";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched: motion is refused until it is acknowledged";
        Fault: "Fault" Boolean "" "a temperature, supply, motor or finger fault";
        Device: "Properties/Device" String "" "device type";
        Serial: "Properties/Serial Number" UInt64 "" "serial number";
        Firmware: "Properties/Firmware" String "" "firmware version of the gripper";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames from the gripper with a wrong checksum or length since the program started";
        Connections: "Diagnostics/Connections" UInt64 "" "number of times the gripper was found since the program started";
    }
}

table! {
    /// Additional metrics of a gripper that allows commands; they follow its other rows.
    COMMANDS, OfCommand {
        Home: "Command/Home" Boolean "" "true: references the fingers; no parameters";
        Move: "Command/Move" Boolean "" "true: moves the fingers to `Command/Width` at `Command/Speed`; they stop at an obstacle";
        Grip: "Command/Grip" Boolean "" "true: grips a part of width `Command/Width` at `Command/Speed`";
        Release: "Command/Release" Boolean "" "true: opens the fingers to `Command/Width` at `Command/Speed` to release a part";
        Stop: "Command/Stop" Boolean "" "true: stops the fingers and stops holding a part";
        FastStop: "Command/Fast Stop" Boolean "" "true: FAST STOP, which locks the fingers until it is acknowledged";
        Acknowledge: "Command/Acknowledge" Boolean "" "true: acknowledges a FAST STOP or a fault";
        Width: "Command/Width" Float "mm" "parameter: opening width";
        Speed: "Command/Speed" Float "mm/s" "parameter: finger speed";
        Force: "Command/Force" Float "N" "optional parameter of `Command/Grip` and `Command/Move`: new force limit; unchanged if omitted";
        Result: "Command/Result" String "" "result of the last command; null: none so far";
    }
}

table! {
    /// Metrics of a bridge and its gripper.
    BRIDGE, OfBridge {
        Width: "Width" Float "mm" "opening width; null while the fingers are not referenced. This metric and all others up to `Status` are null while no gripper responds";
        Force: "Force" Float "N" "gripping force, summed over both fingers";
        State: "State" String "" "gripper state, as for a gripper";
        Flags: "Flags" UInt64 "" "SYSSTATE: system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers are moving";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched";
        Fault: "Fault" Boolean "" "a temperature, supply, motor or finger fault";
        Status: "Status" String "" "status code of the last command";
        Link: "Gripper Link" String "" "link to the gripper: never answered, silent, answers";
        Cause: "Error Cause" String "" "cause of ERROR, the name of an event (registers.md); empty while ERROR is low";
        Events: "Events" UInt64 "" "events since the bridge started";
        Device: "Properties/Device" String "" "device type of the gripper";
        Serial: "Properties/Serial Number" UInt64 "" "serial number of the gripper; 0: unknown";
        Bridge: "Properties/Bridge Firmware" String "" "firmware version of the bridge";
        Disconnects: "Diagnostics/Disconnects" UInt64 "" "number of times the gripper stopped responding since the bridge started";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames from the gripper with a wrong checksum since the bridge started";
        Repeated: "Diagnostics/Repeated" UInt64 "" "repeated requests to the gripper since the bridge started";
        Timeouts: "Diagnostics/Bus Timeouts" UInt64 "" "time-outs of the commanding PLC since the bridge started";
    }
}

table! {
    /// Metrics of the edge node, except `bdSeq` and `Node Control/Rebirth`.
    NODE, OfNode {
        Online: "Devices/Online" UInt64 "" "devices that respond";
        Waiting: "Store/Waiting" UInt64 "" "samples waiting for the broker";
        Dropped: "Store/Dropped" UInt64 "" "samples dropped because the store was full, since the program started";
        Late: "Store/Late" UInt64 "" "samples sent as historical since the program started";
        Connections: "Broker/Connections" UInt64 "" "connections to the broker since the program started";
        Refused: "Commands/Refused" UInt64 "" "commands refused since the program started";
    }
}
