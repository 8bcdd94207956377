//! Metric tables of grippers, bridges and the edge node, from which births, data and docs/tool.md are derived.

use super::payload::{DataType, MetricValue};
use crate::bridge::gateway_reports::{REPORTS, Report, Reported};

/// A value of a metric. `Option::None` stands for null: unknown.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Float(f32),
    Unsigned(u64),
    Boolean(bool),
    Text(String),
}

/// A metric in a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
        State: "State" String "" "gripper state: IDLE, GRIPPING, NO PART, PART LOST, HOLDING, RELEASING, POSITIONING, ERROR";
        Flags: "Flags" UInt64 "" "system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers are moving";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched";
        Fault: "Fault" Boolean "" "a temperature, supply, motor or finger fault";
        Device: "Properties/Device" String "" "device type";
        Serial: "Properties/Serial Number" UInt64 "" "serial number";
        Firmware: "Properties/Firmware" String "" "firmware version";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames from the gripper with a wrong checksum or length";
        Connections: "Diagnostics/Connections" UInt64 "" "number of times the gripper was found";
    }
}

table! {
    /// Additional metrics of a gripper that allows commands; they follow its other rows.
    COMMANDS, OfCommand {
        Home: "Command/Home" Boolean "" "references the fingers";
        Move: "Command/Move" Boolean "" "moves the fingers to `Command/Width` at `Command/Speed`; they stop at an obstacle";
        Grip: "Command/Grip" Boolean "" "grips a part of width `Command/Width` at `Command/Speed`";
        Release: "Command/Release" Boolean "" "opens the fingers to `Command/Width` at `Command/Speed` to release a part";
        Stop: "Command/Stop" Boolean "" "stops the fingers and stops holding a part";
        FastStop: "Command/Fast Stop" Boolean "" "FAST STOP: stops the fingers and locks them until it is acknowledged";
        Acknowledge: "Command/Acknowledge" Boolean "" "acknowledges a FAST STOP or a fault";
        Width: "Command/Width" Float "mm" "parameter: opening width";
        Speed: "Command/Speed" Float "mm/s" "parameter: finger speed";
        Force: "Command/Force" Float "N" "optional parameter of `Command/Grip` and `Command/Move`: new force limit";
        Result: "Command/Result" String "" "result of the last command; null before the first";
    }
}

table! {
    /// Metrics of a bridge and its gripper.
    BRIDGE, OfBridge {
        Width: "Width" Float "mm" "opening width; null while the fingers are not referenced";
        Force: "Force" Float "N" "gripping force, summed over both fingers";
        State: "State" String "" "gripper state: IDLE, GRIPPING, NO PART, PART LOST, HOLDING, RELEASING, POSITIONING, ERROR";
        Flags: "Flags" UInt64 "" "system state flags (command set, appendix B)";
        Referenced: "Referenced" Boolean "" "the fingers are referenced";
        Moving: "Moving" Boolean "" "the fingers are moving";
        FastStop: "Fast Stop" Boolean "" "FAST STOP is latched";
        Fault: "Fault" Boolean "" "a temperature, supply, motor or finger fault";
        Status: "Status" String "" "status code of the last command";
        Link: "Gripper Link" String "" "state of the link: never answered, silent, answers";
        Cause: "Error Cause" String "" "cause of ERROR, the name of an event (registers.md); empty while ERROR is low";
        Events: "Events" UInt64 "" "events";
        Device: "Properties/Device" String "" "device type of the gripper";
        Serial: "Properties/Serial Number" UInt64 "" "serial number; 0: unknown";
        Bridge: "Properties/Bridge Firmware" String "" "firmware version";
        Disconnects: "Diagnostics/Disconnects" UInt64 "" "number of times the gripper stopped responding";
        BadFrames: "Diagnostics/Bad Frames" UInt64 "" "frames from the gripper with a wrong checksum";
        Repeated: "Diagnostics/Repeated" UInt64 "" "repeated requests to the gripper";
        Timeouts: "Diagnostics/Bus Timeouts" UInt64 "" "time-outs of the commanding PLC";
    }
}

/// Metrics of a gateway: the rows of a bridge, and the gateway's reports on itself.
pub(super) const GATEWAY: &[Metric] = &{
    let mut rows = [BRIDGE[0]; BRIDGE.len() + REPORTS.len()];
    let mut row = 1;
    while row < rows.len() {
        rows[row] = if row < BRIDGE.len() { BRIDGE[row] } else { of_report(&REPORTS[row - BRIDGE.len()]) };
        row += 1;
    }
    rows
};

const fn of_report(report: &Report) -> Metric {
    let datatype = match (report.is_address(), report.unit.is_empty()) {
        (true, _) => DataType::String,
        (false, true) => DataType::UInt64,
        (false, false) => DataType::Float,
    };
    metric(report.metric, datatype, report.unit, report.meaning)
}

/// Returns the value of a report's metric.
pub(super) fn of_reported(report: &Report, reported: Reported) -> Option<Value> {
    match reported {
        Reported::Address(address) => address.map(|address| Value::Text(address.to_string())),
        Reported::Number(number) if report.unit.is_empty() => Some(Value::Unsigned(number)),
        Reported::Number(number) => Some(Value::Float(number as f32)),
    }
}

table! {
    /// Metrics of the edge node, except `bdSeq` and `Node Control/Rebirth`.
    NODE, OfNode {
        Online: "Devices/Online" UInt64 "" "devices that respond";
        Waiting: "Store/Waiting" UInt64 "" "samples waiting for the broker";
        Dropped: "Store/Dropped" UInt64 "" "samples dropped because the store was full";
        Late: "Store/Late" UInt64 "" "samples sent as historical";
        Connections: "Broker/Connections" UInt64 "" "connections to the broker";
        Refused: "Commands/Refused" UInt64 "" "refused commands";
    }
}
