//! Generates the EDS file (volume 1, chapter 7) from the device's profile.

use core::fmt;

use crate::device::{EXPLICIT_CONNECTIONS, IO_CONNECTIONS};
use crate::forward_open::{INPUT_OVERHEAD, MAX_INTERVAL_US, OUTPUT_OVERHEAD};
use crate::profile::Profile;

/// Contents of an EDS file that are not part of the profile. All texts are ASCII without quotation marks.
#[derive(Clone, Copy, Debug)]
pub struct EdsFacts<'a> {
    /// Description of the device in one sentence.
    pub description: &'a str,
    /// Date of the file, MM-DD-YYYY.
    pub date: &'a str,
    /// Name of the vendor.
    pub vendor: &'a str,
    /// Name of the device profile, such as `Generic Device (keyable)` for 2Bh.
    pub type_name: &'a str,
    /// Order number.
    pub catalog: &'a str,
    /// Default requested packet interval (RPI) in µs.
    pub interval_us: u32,
}

/// The EDS file of a device. `Display` writes its text.
///
/// ```
/// use bus_ethernetip::{Eds, EdsFacts, Profile};
///
/// static PROFILE: Profile = Profile {
///     vendor_id: 0x1234,
///     device_type: 0x2B,
///     product_code: 1,
///     revision: [1, 1],
///     serial_number: 1,
///     product_name: "example",
///     output: 150,
///     input: 100,
///     configuration: 151,
///     input_only: 152,
///     listen_only: 153,
///     register_class: None,
///     min_interval_us: 1_000,
///     allows_multicast: false,
/// };
/// let facts = EdsFacts {
///     description: "One byte of inputs, one byte of outputs",
///     date: "01-31-2026",
///     vendor: "example",
///     type_name: "Generic Device (keyable)",
///     catalog: "EX-1-1",
///     interval_us: 10_000,
/// };
/// let text = Eds { facts, profile: &PROFILE, output_len: 1, input_len: 1 }.to_string();
/// assert!(text.contains("VendCode = 4660;"));
/// assert!(text.contains("\"20 04 24 97 2C 96 2C 64\";"));
/// ```
///
/// The text follows public descriptions and files of other vendors. No engineering tool has read it yet.
#[derive(Clone, Copy, Debug)]
pub struct Eds<'a> {
    /// Contents that are not part of the profile.
    pub facts: EdsFacts<'a>,
    /// Profile of the device.
    pub profile: &'a Profile,
    /// Length of the outputs in bytes.
    pub output_len: u16,
    /// Length of the inputs in bytes.
    pub input_len: u16,
}

/// Connection parameters of an owner: scheduled priority, point-to-point and fixed size in both directions, and a
/// run/idle header before the outputs.
const OWNER: u32 = 0x4444_0405;
/// The same for a connection with a heartbeat in place of the outputs.
const HEARTBEAT: u32 = 0x4444_0305;
/// Bit of multicast inputs, in addition to point-to-point.
const MULTICAST: u32 = 0x0020_0000;

impl fmt::Display for Eds<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { facts, profile, output_len, input_len } = *self;
        let mut file = File(out);
        file.section("File")?;
        file.text("DescText", facts.description)?;
        for (date, time) in [("CreateDate", "CreateTime"), ("ModDate", "ModTime")] {
            file.entry(date, facts.date)?;
            file.entry(time, "00:00:00")?;
        }
        // Revision of the file. Tools reject a revision without a minor number.
        file.entry("Revision", "1.1")?;

        file.section("Device")?;
        file.entry("VendCode", profile.vendor_id)?;
        file.text("VendName", facts.vendor)?;
        file.entry("ProdType", profile.device_type)?;
        file.text("ProdTypeStr", facts.type_name)?;
        file.entry("ProdCode", profile.product_code)?;
        let [major, minor] = profile.revision;
        file.entry("MajRev", major)?;
        file.entry("MinRev", minor)?;
        file.text("ProdName", profile.product_name)?;
        file.text("Catalog", facts.catalog)?;
        file.section("Device Classification")?;
        file.entry("Class1", "EtherNetIP")?;

        file.section("Params")?;
        let (least, default) = (profile.min_interval_us, facts.interval_us);
        // Descriptor, data type UDINT and its length; name, unit, help; limits; no scaling, no decimal places.
        file.entry(
            "Param1",
            format_args!(
                "0,,,0x0000,0xC8,4,\"RPI\",\"us\",\"Requested packet interval\",{least},{MAX_INTERVAL_US},{default},,,,,,,,,0"
            ),
        )?;

        file.section("Assembly")?;
        file.text("Object_Name", "Assembly Object")?;
        file.entry("Object_Class_Code", "0x04")?;
        for (number, name, len) in
            [(profile.input, "Inputs", input_len), (profile.output, "Outputs", output_len)]
        {
            // One member of all bits, without a parameter.
            let (path, bits) = (Segment(0x24, number), u32::from(len).saturating_mul(8));
            file.entry(
                format_args!("Assem{number}"),
                format_args!("\"{name}\",\"20 04{path} 30 03\",{len},0x0000,,,{bits},"),
            )?;
        }

        file.section("Connection Manager")?;
        file.text("Object_Name", "Connection Manager Object")?;
        file.entry("Object_Class_Code", "0x06")?;
        for (number, (transport, parameters, point, name)) in (1..).zip([
            (0x0401_0002, OWNER, profile.output, "Exclusive owner"),
            (0x0201_0002, HEARTBEAT, profile.input_only, "Input only"),
            (0x0101_0002, HEARTBEAT, profile.listen_only, "Listen only"),
        ]) {
            let all = if profile.allows_multicast { parameters | MULTICAST } else { parameters };
            write!(file.0, "  Connection{number} = 0x{transport:08X},0x{all:08X},Param1,")?;
            match parameters {
                OWNER => write!(file.0, "{output_len},Assem{point}")?,
                _ => write!(file.0, "0,")?,
            }
            // Two configurations without data.
            write!(file.0, ",Param1,{input_len},Assem{},,,,,\"{name}\",\"\",", profile.input)?;
            let path = [(0x24, profile.configuration), (0x2C, point), (0x2C, profile.input)];
            let [configuration, output, input] = path.map(|(kind, number)| Segment(kind, number));
            write!(file.0, "\"20 04{configuration}{output}{input}\";\r\n")?;
        }

        file.section("Capacity")?;
        file.entry("MaxMsgConnections", EXPLICIT_CONNECTIONS)?;
        file.entry("MaxIOConnections", IO_CONNECTIONS)?;
        let sizes = [(output_len, OUTPUT_OVERHEAD), (input_len, INPUT_OVERHEAD)];
        let size = sizes.map(|(len, overhead)| usize::from(len).saturating_add(overhead));
        let rate = 1_000_000_u32.checked_div(least).unwrap_or(0);
        file.entry("TSpec1", format_args!("TxRx,{},{rate}", size.into_iter().max().unwrap_or(0)))
    }
}

/// A segment of a path, in 8 bits or in 16 bits with a pad byte, preceded by a blank.
struct Segment(u8, u16);

impl fmt::Display for Segment {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(kind, number) = *self;
        let [low, high] = number.to_le_bytes();
        match high {
            0 => write!(out, " {kind:02X} {low:02X}"),
            _ => write!(out, " {:02X} 00 {low:02X} {high:02X}", kind | 1),
        }
    }
}

/// Writes entries on lines with CRLF.
struct File<'a, 'b>(&'a mut fmt::Formatter<'b>);

impl File<'_, '_> {
    fn section(&mut self, name: &str) -> fmt::Result {
        write!(self.0, "[{name}]\r\n")
    }

    fn entry(&mut self, name: impl fmt::Display, value: impl fmt::Display) -> fmt::Result {
        write!(self.0, "  {name} = {value};\r\n")
    }

    fn text(&mut self, name: &str, text: &str) -> fmt::Result {
        self.entry(name, format_args!("\"{text}\""))
    }
}

#[cfg(test)]
mod tests;
