//! What is told of a gripper, of a bridge and of this edge node: one table each, from which births, data and the document
//! derive.

use super::payload::{DataType, MetricValue};

/// A value of a device or of the node. `None` in its place is null: not known.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Float(f32),
    Unsigned(u64),
    Boolean(bool),
    Text(String),
}

/// A row of a table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Metric {
    pub(super) name: &'static str,
    pub(super) datatype: DataType,
    /// Empty: none.
    pub(super) unit: &'static str,
    pub(super) meaning: &'static str,
}

const fn metric(name: &'static str, datatype: DataType, unit: &'static str, meaning: &'static str) -> Metric {
    Metric { name, datatype, unit, meaning }
}

impl Metric {
    /// The type as the payload has it. Data has it, too, though Sparkplug would rather not: decoders that keep no births,
    /// such as Eclipse Tahu's for JavaScript, read null without it.
    pub(super) fn datatype(&self) -> u32 {
        self.datatype as u32
    }
}

impl Value {
    /// As the payload has it.
    pub(super) fn encode(&self) -> MetricValue {
        match self {
            Self::Float(number) => MetricValue::Float(*number),
            Self::Unsigned(number) => MetricValue::Long(*number),
            Self::Boolean(on) => MetricValue::Boolean(*on),
            Self::Text(text) => MetricValue::String(text.clone()),
        }
    }
}

/// Names the rows of a table by constants, so that no index is written by hand.
macro_rules! table {
    ($(#[$doc:meta])* $table:ident, $index:ident { $($row:ident: $name:literal $datatype:ident $unit:literal $meaning:literal;)* }) => {
        /// The places in the table of the same name.
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
    /// What is told of a gripper.
    GRIPPER, OfGripper {
        Width: "Width" Float "mm" "opening width; null while the fingers are not referenced";
        Speed: "Speed" Float "mm/s" "finger speed";
        Force: "Force" Float "N" "gripping force, summed over both fingers";
        State: "State" String "" "gripper state in words, as the command set has them: IDLE, GRIPPING, NO PART, PART LOST, HOLDING, RELEASING, POSITIONING, ERROR";
        Flags: "Flags" UInt64 "" "system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers move";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched: motion is refused until it is acknowledged";
        Fault: "Fault" Boolean "" "a fault of temperature, supply, motor or finger";
        Device: "Properties/Device" String "" "the model";
        Serial: "Properties/Serial Number" UInt64 "" "the serial number";
        Firmware: "Properties/Firmware" String "" "version of the gripper's firmware";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames from the gripper with a wrong checksum or length, since the program started";
        Connections: "Diagnostics/Connections" UInt64 "" "how often the gripper was found, since the program started";
    }
}

table! {
    /// How a gripper is commanded that allows it: behind its other rows.
    COMMANDS, OfCommand {
        Home: "Command/Home" Boolean "" "true: references the fingers; no parameters";
        Move: "Command/Move" Boolean "" "true: moves the fingers to `Command/Width` by `Command/Speed`; they stop where something is in the way";
        Grip: "Command/Grip" Boolean "" "true: grips a part of `Command/Width` by `Command/Speed`";
        Release: "Command/Release" Boolean "" "true: opens the fingers to `Command/Width` by `Command/Speed`, to release a part";
        Stop: "Command/Stop" Boolean "" "true: stops the fingers; a part is held no longer";
        FastStop: "Command/Fast Stop" Boolean "" "true: FAST STOP, which locks the fingers until it is acknowledged";
        Acknowledge: "Command/Acknowledge" Boolean "" "true: acknowledges FAST STOP or a fault";
        Width: "Command/Width" Float "mm" "parameter: opening width";
        Speed: "Command/Speed" Float "mm/s" "parameter: finger speed";
        Force: "Command/Force" Float "N" "parameter of `Command/Grip` and `Command/Move` that may be left out: the force limit from now on; left out: it stays as it is";
        Result: "Command/Result" String "" "what the last command came to; null: there was none";
    }
}

table! {
    /// What is told of a bridge and the gripper behind it.
    BRIDGE, OfBridge {
        Width: "Width" Float "mm" "opening width; null while the fingers are not referenced. This and all down to `Status` is null while no gripper answers";
        Force: "Force" Float "N" "gripping force, summed over both fingers";
        State: "State" String "" "gripper state in words, as for a gripper";
        Flags: "Flags" UInt64 "" "SYSSTATE: system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers move";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched";
        Fault: "Fault" Boolean "" "a fault of temperature, supply, motor or finger";
        Status: "Status" String "" "status code of the last command";
        Link: "Gripper Link" String "" "whether a gripper answers the bridge: never answered, silent, answers";
        Cause: "Error Cause" String "" "why ERROR is high, the name of an event (registers.md); empty: it is low";
        Events: "Events" UInt64 "" "events since the bridge started";
        Device: "Properties/Device" String "" "the gripper's model";
        Serial: "Properties/Serial Number" UInt64 "" "the gripper's serial number; 0: not known";
        Bridge: "Properties/Bridge Firmware" String "" "version of the bridge's firmware";
        Disconnects: "Diagnostics/Disconnects" UInt64 "" "how often the gripper fell silent since the bridge started";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames of the gripper with a wrong checksum since then";
        Repeated: "Diagnostics/Repeated" UInt64 "" "requests to the gripper that were sent again since then";
        Timeouts: "Diagnostics/Bus Timeouts" UInt64 "" "how often the PLC that commanded was silent for too long since then";
    }
}

table! {
    /// What is told of this edge node, beside `bdSeq` and `Node Control/Rebirth`.
    NODE, OfNode {
        Online: "Devices/Online" UInt64 "" "devices that answer";
        Waiting: "Store/Waiting" UInt64 "" "samples that wait for the broker";
        Dropped: "Store/Dropped" UInt64 "" "samples that were dropped because the store was full, since the program started";
        Late: "Store/Late" UInt64 "" "samples that were sent as historical, since the program started";
        Connections: "Broker/Connections" UInt64 "" "connections to the broker, since the program started";
        Refused: "Commands/Refused" UInt64 "" "commands from the broker that were refused, since the program started";
    }
}
