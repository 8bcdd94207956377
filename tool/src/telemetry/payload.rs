//! The Sparkplug B 3.0 payload (chapter 6) in Protocol Buffers: the part of `sparkplug_b.proto` that an edge node needs. Other
//! fields are skipped on decoding.

use prost::{Message, Oneof};

/// The payload of a message.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Payload {
    /// Time of sending in ms since 1970 (UTC).
    #[prost(uint64, optional, tag = "1")]
    pub(super) timestamp: Option<u64>,
    #[prost(message, repeated, tag = "2")]
    pub(super) metrics: Vec<Metric>,
    /// Sequence number, 0 to 255 with wraparound. NDEATH has none.
    #[prost(uint64, optional, tag = "3")]
    pub(super) seq: Option<u64>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Metric {
    /// Present in births, and if there is no alias.
    #[prost(string, optional, tag = "1")]
    pub(super) name: Option<String>,
    #[prost(uint64, optional, tag = "2")]
    pub(super) alias: Option<u64>,
    /// Time of measurement in ms since 1970 (UTC).
    #[prost(uint64, optional, tag = "3")]
    pub(super) timestamp: Option<u64>,
    /// A [`DataType`]. Required in births.
    #[prost(uint32, optional, tag = "4")]
    pub(super) datatype: Option<u32>,
    #[prost(bool, optional, tag = "5")]
    pub(super) is_historical: Option<bool>,
    #[prost(bool, optional, tag = "7")]
    pub(super) is_null: Option<bool>,
    #[prost(message, optional, tag = "9")]
    pub(super) properties: Option<PropertySet>,
    #[prost(oneof = "MetricValue", tags = "11, 12, 14, 15")]
    pub(super) value: Option<MetricValue>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(super) enum MetricValue {
    #[prost(uint64, tag = "11")]
    Long(u64),
    #[prost(float, tag = "12")]
    Float(f32),
    #[prost(bool, tag = "14")]
    Boolean(bool),
    #[prost(string, tag = "15")]
    String(String),
}

/// Names and values of properties, in the same order.
#[derive(Clone, PartialEq, Message)]
pub(super) struct PropertySet {
    #[prost(string, repeated, tag = "1")]
    pub(super) keys: Vec<String>,
    #[prost(message, repeated, tag = "2")]
    pub(super) values: Vec<PropertyValue>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct PropertyValue {
    /// The type of the value, a [`DataType`].
    #[prost(uint32, optional, tag = "1")]
    pub(super) datatype: Option<u32>,
    #[prost(oneof = "PropertyContent", tags = "5, 8")]
    pub(super) value: Option<PropertyContent>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(super) enum PropertyContent {
    #[prost(float, tag = "5")]
    Float(f32),
    #[prost(string, tag = "8")]
    String(String),
}

/// Data types of metrics (Sparkplug, 6.4.16). UInt32 is omitted, because implementations disagree on the field that holds it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DataType {
    Int64 = 4,
    UInt64 = 8,
    Float = 9,
    Boolean = 11,
    String = 12,
}

impl PropertySet {
    /// Creates properties for a unit and, if known, a range of values, with the conventional names.
    pub(super) fn of_unit(unit: &str, range: Option<(f32, f32)>) -> Self {
        let mut set = Self::default();
        set.add("engUnit", DataType::String, PropertyContent::String(unit.to_owned()));
        if let Some((low, high)) = range {
            set.add("engLow", DataType::Float, PropertyContent::Float(low));
            set.add("engHigh", DataType::Float, PropertyContent::Float(high));
        }
        set
    }

    fn add(&mut self, key: &str, datatype: DataType, value: PropertyContent) {
        self.keys.push(key.to_owned());
        self.values.push(PropertyValue { datatype: Some(datatype as u32), value: Some(value) });
    }
}
