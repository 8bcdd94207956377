//! Generates the GSD file (device data base file of EN 50170-2, revision 1 of the language) from the slave's profile.

use core::fmt;

use crate::{Baud, Profile};

/// Contents of a GSD file that are not part of the profile.
#[derive(Clone, Copy, Debug)]
pub struct GsdFacts<'a> {
    /// Vendor of the device, up to 32 characters.
    pub vendor: &'a str,
    /// Model name of the device, up to 24 characters.
    pub model: &'a str,
    /// Revision of the device.
    pub revision: &'a str,
    /// Release of the hardware.
    pub hardware_release: &'a str,
    /// Release of the software.
    pub software_release: &'a str,
    /// Slave_Family: device category in configuration tools, such as 1 for drives and 3 for inputs and outputs.
    pub family: u8,
    /// Baud rates that the port supports.
    pub rates: &'a [Baud],
    /// Whether [`BaudSearch`](crate::BaudSearch) detects the baud rate.
    pub auto_baud: bool,
    /// Min_Slave_Intervall, the minimum time between two exchanges, in 100 µs.
    pub min_slave_interval: u16,
    /// Name of the only module, which comprises all configuration identifiers.
    pub module: &'a str,
    /// Max_Diag_Data_Len: maximum length of the diagnosis, including the standard six bytes.
    pub max_diagnosis_len: u8,
    /// Names of the bitmap files next to the GSD file, up to 8 characters without `.bmp`. They show the device in
    /// normal operation, with a diagnosis and in special operating modes: 70 x 40 pixels, 16 colours.
    pub bitmaps: Option<[&'a str; 3]>,
    /// Meaning of bits in the device-specific diagnosis; 0 is the lowest bit after its header.
    pub diagnosis_bits: &'a [(u16, &'a str)],
}

/// The GSD file of a slave. `Display` writes its text.
///
/// ```
/// use bus_profibus::{Baud, Gsd, GsdFacts, Profile};
///
/// static PROFILE: Profile = Profile {
///     ident: 0x1234,
///     config: &[0x20, 0x10],
///     sync: true,
///     freeze: true,
///     fail_safe: false,
///     set_address: false,
/// };
/// let facts = GsdFacts {
///     vendor: "example",
///     model: "IO-8-8",
///     revision: "1.0",
///     hardware_release: "1.0",
///     software_release: "1.0",
///     family: 3,
///     rates: &[Baud::K9_6, Baud::K19_2],
///     auto_baud: true,
///     min_slave_interval: 10,
///     module: "8 outputs, 8 inputs",
///     max_diagnosis_len: 8,
///     bitmaps: None,
///     diagnosis_bits: &[(0, "short circuit")],
/// };
/// let text = Gsd { facts, profile: &PROFILE }.to_string();
/// assert!(text.starts_with("#Profibus_DP\r\n"));
/// for line in ["Ident_Number = 0x1234", "9.6_supp = 1", "500_supp = 0", "MaxTsdr_19.2 = 60", "Sync_Mode_supp = 1"] {
///     assert!(text.contains(line), "{line}");
/// }
/// assert!(text.contains("Module = \"8 outputs, 8 inputs\" 0x20,0x10\r\n"));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Gsd<'a> {
    /// Contents that are not part of the profile.
    pub facts: GsdFacts<'a>,
    /// Profile of the slave.
    pub profile: &'a Profile,
}

impl fmt::Display for Gsd<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { facts, profile } = self;
        let mut lines = Lines(out);
        lines.line(format_args!("#Profibus_DP"))?;
        lines.number("GSD_Revision", 1)?;
        lines.text("Vendor_Name", facts.vendor)?;
        lines.text("Model_Name", facts.model)?;
        lines.text("Revision", facts.revision)?;
        lines.line(format_args!("Ident_Number = 0x{:04X}", profile.ident))?;
        // PROFIBUS DP, and a DP slave.
        lines.number("Protocol_Ident", 0)?;
        lines.number("Station_Type", 0)?;
        lines.flag("FMS_supp", false)?;
        lines.text("Hardware_Release", facts.hardware_release)?;
        lines.text("Software_Release", facts.software_release)?;
        let supported = || Baud::ALL.into_iter().filter(|baud| facts.rates.contains(baud));
        for baud in Baud::ALL {
            lines.line(format_args!("{}_supp = {}", name(baud), u8::from(facts.rates.contains(&baud))))?;
        }
        for baud in supported() {
            lines.line(format_args!("MaxTsdr_{} = {}", name(baud), baud.max_tsdr_bits()))?;
        }
        lines.flag("Redundancy", false)?;
        lines.number("Repeater_Ctrl_Sig", 0)?;
        lines.number("24V_Pins", 0)?;
        if let Some([device, diagnosis, special]) = facts.bitmaps {
            lines.text("Bitmap_Device", device)?;
            lines.text("Bitmap_Diag", diagnosis)?;
            lines.text("Bitmap_SF", special)?;
        }
        lines.flag("Freeze_Mode_supp", profile.freeze)?;
        lines.flag("Sync_Mode_supp", profile.sync)?;
        lines.flag("Auto_Baud_supp", facts.auto_baud)?;
        lines.flag("Set_Slave_Add_supp", profile.set_address)?;
        lines.flag("Fail_Safe", profile.fail_safe)?;
        lines.number("User_Prm_Data_Len", 0)?;
        lines.number("Min_Slave_Intervall", facts.min_slave_interval)?;
        lines.number("Slave_Family", facts.family.into())?;
        lines.number("Max_Diag_Data_Len", facts.max_diagnosis_len.into())?;
        for (bit, meaning) in facts.diagnosis_bits {
            lines.line(format_args!("Unit_Diag_Bit({bit}) = \"{meaning}\""))?;
        }
        lines.flag("Modular_Station", false)?;
        lines.line(format_args!("Module = \"{}\" {}", facts.module, Identifiers(profile.config)))?;
        lines.line(format_args!("EndModule"))
    }
}

/// Returns the name of a baud rate in GSD keywords.
const fn name(baud: Baud) -> &'static str {
    match baud {
        Baud::K9_6 => "9.6",
        Baud::K19_2 => "19.2",
        Baud::K45_45 => "45.45",
        Baud::K93_75 => "93.75",
        Baud::K187_5 => "187.5",
        Baud::K500 => "500",
        Baud::M1_5 => "1.5M",
        Baud::M3 => "3M",
        Baud::M6 => "6M",
        Baud::M12 => "12M",
    }
}

/// Writes lines with CRLF, as configuration tools on Windows require.
struct Lines<'a, 'b>(&'a mut fmt::Formatter<'b>);

impl Lines<'_, '_> {
    fn line(&mut self, line: fmt::Arguments<'_>) -> fmt::Result {
        self.0.write_fmt(format_args!("{line}\r\n"))
    }

    fn text(&mut self, keyword: &str, text: &str) -> fmt::Result {
        self.line(format_args!("{keyword} = \"{text}\""))
    }

    fn number(&mut self, keyword: &str, number: u16) -> fmt::Result {
        self.line(format_args!("{keyword} = {number}"))
    }

    fn flag(&mut self, keyword: &str, is_set: bool) -> fmt::Result {
        self.number(keyword, is_set.into())
    }
}

struct Identifiers(&'static [u8]);

impl fmt::Display for Identifiers {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, identifier) in self.0.iter().enumerate() {
            write!(out, "{}0x{identifier:02X}", if at == 0 { "" } else { "," })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
