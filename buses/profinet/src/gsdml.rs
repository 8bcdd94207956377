//! Generates the GSDML file (GSDML V2.3x, ISO 15745-4) from the device's profile.

use core::fmt::{self, Write as _};

use crate::lldp::MAU_TYPE;
use crate::profile::{Module, Profile, Submodule};
use crate::records::{INTERFACE_SUBSLOT, PORT_SUBSLOT};

/// Contents of a GSDML file that are not part of the profile.
#[derive(Clone, Copy, Debug)]
pub struct GsdmlFacts<'a> {
    /// Vendor name of the device.
    pub vendor: &'a str,
    /// Name of the product family.
    pub family: &'a str,
    /// Category in configuration tools: I/O, Drives, ...
    pub main_family: &'a str,
    /// Description of the device in one sentence.
    pub info: &'a str,
    /// Name of the bitmap file next to the GSDML file that shows the device, without `.bmp`: 70 x 40 pixels.
    pub bitmap: Option<&'a str>,
}

/// The GSDML file of a device. `Display` writes its text.
///
/// ```
/// use bus_profinet::{Gsdml, GsdmlFacts, Module, Profile, Submodule};
///
/// static PROFILE: Profile = Profile {
///     vendor_id: 0x1234,
///     device_id: 0x0001,
///     station_type: "example",
///     order_id: "EX-8-8",
///     serial_number: "1",
///     hardware_revision: 1,
///     software_revision: [1, 0, 0],
///     min_interval: 32,
///     modules: &[Module {
///         slot: 0,
///         ident: 1,
///         name: "example",
///         submodules: &[Submodule { subslot: 1, ident: 1, input_len: 0, output_len: 0 }],
///     }],
///     faults: &[],
/// };
/// let facts = GsdmlFacts { vendor: "example", family: "EX", main_family: "I/O", info: "Eight inputs, eight outputs", bitmap: None };
/// let text = Gsdml { facts, profile: &PROFILE }.to_string();
/// assert!(text.contains(r#"<DeviceIdentity VendorID="0x1234" DeviceID="0x0001">"#));
/// assert!(text.contains(r#"DNS_CompatibleName="example""#));
/// ```
///
/// There is no public GSDML schema. The text follows the specification and public reports on the
/// checks of TIA Portal, but has not been tested with an engineering tool yet. The file name must
/// start with `GSDML-` and [`Gsdml::SCHEMA_VERSION`].
#[derive(Clone, Copy, Debug)]
pub struct Gsdml<'a> {
    /// Contents that are not part of the profile.
    pub facts: GsdmlFacts<'a>,
    /// Profile of the device.
    pub profile: &'a Profile,
}

impl Gsdml<'_> {
    /// Schema version, which the file name must repeat.
    pub const SCHEMA_VERSION: &'static str = "V2.31";
}

/// PROFINET version that the device conforms to. From V2.31 on, TIA Portal's checker requires CertificationInfo,
/// LLDP_NoD_Supported, PTP_BoundarySupported and DCP_BoundarySupported, none of which this device has.
const PNIO_VERSION: &str = "V2.3";

/// Reduction ratios of real time class 1.
const RATIOS: [u16; 10] = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512];
/// Send clock that they divide, in 31.25 µs.
const SEND_CLOCK: u16 = 32;

impl fmt::Display for Gsdml<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { facts, profile } = *self;
        let version = Self::SCHEMA_VERSION;
        let mut file = File(out);
        file.line(0, format_args!(r#"<?xml version="1.0" encoding="utf-8"?>"#))?;
        let base = "http://www.profibus.com/GSDML/2003/11";
        file.line(0, format_args!(r#"<ISO15745Profile xmlns="{base}/DeviceProfile""#))?;
        file.line(4, format_args!(r#"xmlns:base="{base}/Primitives""#))?;
        file.line(4, format_args!(r#"xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance""#))?;
        file.line(
            4,
            format_args!(
                r#"xsi:schemaLocation="{base}/DeviceProfile ..\xsd\GSDML-DeviceProfile-{version}.xsd">"#
            ),
        )?;
        file.header()?;
        file.line(1, format_args!("<ProfileBody>"))?;
        let Profile { vendor_id, device_id, .. } = profile;
        file.line(
            2,
            format_args!(r#"<DeviceIdentity VendorID="0x{vendor_id:04X}" DeviceID="0x{device_id:04X}">"#),
        )?;
        file.line(3, format_args!(r#"<InfoText TextId="TOK_Info"/>"#))?;
        file.line(3, format_args!(r#"<VendorName Value="{}"/>"#, Escaped(facts.vendor)))?;
        file.line(2, format_args!("</DeviceIdentity>"))?;
        file.line(2, format_args!("<DeviceFunction>"))?;
        let (main_family, family) = (Escaped(facts.main_family), Escaped(facts.family));
        file.line(3, format_args!(r#"<Family MainFamily="{main_family}" ProductFamily="{family}"/>"#))?;
        file.line(2, format_args!("</DeviceFunction>"))?;
        file.line(2, format_args!("<ApplicationProcess>"))?;
        if let Some((access_point, modules)) = profile.modules.split_first() {
            file.access_point(&facts, profile, access_point, modules)?;
            file.modules(modules)?;
        }
        file.faults(profile)?;
        if let Some(bitmap) = facts.bitmap {
            file.line(3, format_args!("<GraphicsList>"))?;
            file.line(4, format_args!(r#"<GraphicItem ID="Symbol" GraphicFile="{}"/>"#, Escaped(bitmap)))?;
            file.line(3, format_args!("</GraphicsList>"))?;
        }
        file.texts(&facts, profile)?;
        file.line(2, format_args!("</ApplicationProcess>"))?;
        file.line(1, format_args!("</ProfileBody>"))?;
        file.line(0, format_args!("</ISO15745Profile>"))
    }
}

/// Text escaped for an attribute value.
struct Escaped<'a>(&'a str);

impl fmt::Display for Escaped<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|letter| match letter {
            '&' => out.write_str("&amp;"),
            '<' => out.write_str("&lt;"),
            '>' => out.write_str("&gt;"),
            '"' => out.write_str("&quot;"),
            letter => out.write_char(letter),
        })
    }
}

/// Writes indented lines of XML.
struct File<'a, 'b>(&'a mut fmt::Formatter<'b>);

impl File<'_, '_> {
    fn line(&mut self, depth: usize, line: fmt::Arguments<'_>) -> fmt::Result {
        for _ in 0..depth {
            self.0.write_str("  ")?;
        }
        self.0.write_fmt(format_args!("{line}\n"))
    }

    fn header(&mut self) -> fmt::Result {
        self.line(1, format_args!("<ProfileHeader>"))?;
        for (name, value) in [
            ("ProfileIdentification", "PROFINET Device Profile"),
            ("ProfileRevision", "1.00"),
            ("ProfileName", "Device Profile for PROFINET Devices"),
            ("ProfileSource", "PROFIBUS Nutzerorganisation e. V. (PNO)"),
            ("ProfileClassID", "Device"),
        ] {
            self.line(2, format_args!("<{name}>{value}</{name}>"))?;
        }
        self.line(2, format_args!("<ISO15745Reference>"))?;
        for (name, value) in [("ISO15745Part", "4"), ("ISO15745Edition", "1"), ("ProfileTechnology", "GSDML")]
        {
            self.line(3, format_args!("<{name}>{value}</{name}>"))?;
        }
        self.line(2, format_args!("</ISO15745Reference>"))?;
        self.line(1, format_args!("</ProfileHeader>"))
    }

    /// Writes the device access point: slot 0, with its interface and its port.
    fn access_point(
        &mut self,
        facts: &GsdmlFacts<'_>,
        profile: &Profile,
        access_point: &Module,
        modules: &[Module],
    ) -> fmt::Result {
        let last = modules.iter().map(|module| module.slot).max().unwrap_or(0);
        let (ident, min_interval) = (access_point.ident, profile.min_interval);
        self.line(3, format_args!("<DeviceAccessPointList>"))?;
        self.line(4, format_args!("<DeviceAccessPointItem"))?;
        self.line(6, format_args!(r#"ID="DAP" PNIO_Version="{PNIO_VERSION}" RequiredSchemaVersion="V2.3""#))?;
        self.line(
            6,
            format_args!(r#"ModuleIdentNumber="0x{ident:08X}" MinDeviceInterval="{min_interval}""#),
        )?;
        self.line(
            6,
            format_args!(r#"PhysicalSlots="0..{last}" FixedInSlots="0" ObjectUUID_LocalIndex="1""#),
        )?;
        self.0.write_str("            DNS_CompatibleName=\"")?;
        for letter in profile.station_type.chars() {
            self.0.write_fmt(format_args!("{}", letter.to_ascii_lowercase()))?;
        }
        self.line(0, format_args!(r#"" AddressAssignment="DCP" NameOfStationNotTransferable="false""#))?;
        self.line(6, format_args!(r#"CheckDeviceID_Allowed="true" MultipleWriteSupported="true""#))?;
        self.line(6, format_args!(r#"ImplementationType="STANDARD-MAC" ResetToFactoryModes="2">"#))?;
        let info = |file: &mut Self, depth| {
            let [major, minor, patch] = profile.software_revision;
            file.line(depth, format_args!(r#"<VendorName Value="{}"/>"#, Escaped(facts.vendor)))?;
            file.line(depth, format_args!(r#"<OrderNumber Value="{}"/>"#, Escaped(profile.order_id)))?;
            file.line(depth, format_args!(r#"<HardwareRelease Value="{}"/>"#, profile.hardware_revision))?;
            file.line(depth, format_args!(r#"<SoftwareRelease Value="V{major}.{minor}.{patch}"/>"#))
        };
        self.info(5, format_args!("TOK_Slot_0"), info)?;
        let frame_lens = profile.submodules().map(|slotted| slotted.submodule.frame_lens());
        let (inputs, outputs) = frame_lens.fold((0, 0), |(inputs, outputs), (input, output)| {
            (input.saturating_add(inputs), output.saturating_add(outputs))
        });
        self.line(
            5,
            format_args!(r#"<IOConfigData MaxInputLength="{inputs}" MaxOutputLength="{outputs}"/>"#),
        )?;
        self.line(5, format_args!("<UseableModules>"))?;
        for Module { slot, .. } in modules {
            self.line(
                6,
                format_args!(r#"<ModuleItemRef ModuleItemTarget="Slot_{slot}" FixedInSlots="{slot}"/>"#),
            )?;
        }
        self.line(5, format_args!("</UseableModules>"))?;
        self.submodules(access_point)?;
        self.line(5, format_args!("<SystemDefinedSubmoduleList>"))?;
        for submodule in access_point.submodules {
            self.system_defined(submodule, profile.min_interval)?;
        }
        self.line(5, format_args!("</SystemDefinedSubmoduleList>"))?;
        if facts.bitmap.is_some() {
            self.line(5, format_args!("<Graphics>"))?;
            self.line(
                6,
                format_args!(r#"<GraphicItemRef Type="DeviceSymbol" GraphicItemTarget="Symbol"/>"#),
            )?;
            self.line(5, format_args!("</Graphics>"))?;
        }
        self.line(4, format_args!("</DeviceAccessPointItem>"))?;
        self.line(3, format_args!("</DeviceAccessPointList>"))
    }

    fn info(
        &mut self,
        depth: usize,
        text: fmt::Arguments<'_>,
        more: impl FnOnce(&mut Self, usize) -> fmt::Result,
    ) -> fmt::Result {
        let inner = depth.saturating_add(1);
        self.line(depth, format_args!("<ModuleInfo>"))?;
        self.line(inner, format_args!(r#"<Name TextId="{text}"/>"#))?;
        self.line(inner, format_args!(r#"<InfoText TextId="{text}"/>"#))?;
        more(self, inner)?;
        self.line(depth, format_args!("</ModuleInfo>"))
    }

    /// Writes the virtual submodules of a module: all except interface and port.
    fn submodules(&mut self, module: &Module) -> fmt::Result {
        let slot = module.slot;
        self.line(5, format_args!("<VirtualSubmoduleList>"))?;
        for Submodule { subslot, ident, input_len, output_len } in module.submodules {
            if matches!(*subslot, INTERFACE_SUBSLOT | PORT_SUBSLOT) {
                continue;
            }
            self.line(
                6,
                format_args!(
                    r#"<VirtualSubmoduleItem ID="Slot_{slot}_{subslot}" SubmoduleIdentNumber="0x{ident:08X}" FixedInSubslots="{subslot}" Writeable_IM_Records="1 2 3" MayIssueProcessAlarm="false">"#
                ),
            )?;
            self.line(7, format_args!("<IOData>"))?;
            for (direction, len) in [("Input", *input_len), ("Output", *output_len)] {
                if len > 0 {
                    self.line(8, format_args!(r#"<{direction} Consistency="All items consistency">"#))?;
                    self.line(
                        9,
                        format_args!(
                            r#"<DataItem DataType="OctetString" Length="{len}" TextId="TOK_Slot_{slot}"/>"#
                        ),
                    )?;
                    self.line(8, format_args!("</{direction}>"))?;
                }
            }
            self.line(7, format_args!("</IOData>"))?;
            self.info(7, format_args!("TOK_Slot_{slot}"), |_, _| Ok(()))?;
            self.line(6, format_args!("</VirtualSubmoduleItem>"))?;
        }
        self.line(5, format_args!("</VirtualSubmoduleList>"))
    }

    /// Writes the interface or the port submodule.
    fn system_defined(&mut self, submodule: &Submodule, min_interval: u16) -> fmt::Result {
        let Submodule { subslot, ident, .. } = submodule;
        match *subslot {
            INTERFACE_SUBSLOT => {
                self.line(
                    6,
                    format_args!(
                        r#"<InterfaceSubmoduleItem ID="Interface" SubslotNumber="{subslot}" SubmoduleIdentNumber="0x{ident:08X}" TextId="TOK_Interface" SupportedRT_Classes="RT_CLASS_1" SupportedProtocols="LLDP" NetworkComponentDiagnosisSupported="false">"#
                    ),
                )?;
                self.line(7, format_args!(r#"<ApplicationRelations StartupMode="Legacy">"#))?;
                self.0.write_fmt(format_args!(
                    r#"                <TimingProperties SendClock="{SEND_CLOCK}" ReductionRatio=""#
                ))?;
                let are_slow = |ratio: &&u16| ratio.saturating_mul(SEND_CLOCK) >= min_interval;
                for (at, ratio) in RATIOS.iter().filter(are_slow).enumerate() {
                    self.0.write_fmt(format_args!("{}{ratio}", if at == 0 { "" } else { " " }))?;
                }
                self.line(0, format_args!(r#""/>"#))?;
                self.line(7, format_args!("</ApplicationRelations>"))?;
                self.line(6, format_args!("</InterfaceSubmoduleItem>"))
            }
            PORT_SUBSLOT => {
                self.line(
                    6,
                    format_args!(
                        r#"<PortSubmoduleItem ID="Port" SubslotNumber="{subslot}" SubmoduleIdentNumber="0x{ident:08X}" TextId="TOK_Port" MaxPortRxDelay="350" MaxPortTxDelay="160">"#
                    ),
                )?;
                self.line(7, format_args!("<MAUTypeList>"))?;
                self.line(8, format_args!(r#"<MAUTypeItem Value="{MAU_TYPE}"/>"#))?;
                self.line(7, format_args!("</MAUTypeList>"))?;
                self.line(6, format_args!("</PortSubmoduleItem>"))
            }
            _ => Ok(()),
        }
    }

    fn modules(&mut self, modules: &[Module]) -> fmt::Result {
        self.line(3, format_args!("<ModuleList>"))?;
        for module in modules {
            let Module { slot, ident, .. } = module;
            self.line(4, format_args!(r#"<ModuleItem ID="Slot_{slot}" ModuleIdentNumber="0x{ident:08X}">"#))?;
            self.info(5, format_args!("TOK_Slot_{slot}"), |_, _| Ok(()))?;
            self.submodules(module)?;
            self.line(4, format_args!("</ModuleItem>"))?;
        }
        self.line(3, format_args!("</ModuleList>"))
    }

    fn faults(&mut self, profile: &Profile) -> fmt::Result {
        if profile.faults.is_empty() {
            return Ok(());
        }
        self.line(3, format_args!("<ChannelDiagList>"))?;
        for fault in profile.faults {
            let number = fault.error_type;
            self.line(4, format_args!(r#"<ChannelDiagItem ErrorType="{number}">"#))?;
            self.line(5, format_args!(r#"<Name TextId="TOK_Fault_{number}"/>"#))?;
            self.line(4, format_args!("</ChannelDiagItem>"))?;
        }
        self.line(3, format_args!("</ChannelDiagList>"))
    }

    fn texts(&mut self, facts: &GsdmlFacts<'_>, profile: &Profile) -> fmt::Result {
        self.line(3, format_args!("<ExternalTextList>"))?;
        self.line(4, format_args!("<PrimaryLanguage>"))?;
        let mut text = |id: fmt::Arguments<'_>, value: &str| {
            self.line(5, format_args!(r#"<Text TextId="{id}" Value="{}"/>"#, Escaped(value)))
        };
        text(format_args!("TOK_Info"), facts.info)?;
        text(format_args!("TOK_Interface"), "Interface")?;
        text(format_args!("TOK_Port"), "Port 1")?;
        for module in profile.modules {
            text(format_args!("TOK_Slot_{}", module.slot), module.name)?;
        }
        for fault in profile.faults {
            text(format_args!("TOK_Fault_{}", fault.error_type), fault.name)?;
        }
        self.line(4, format_args!("</PrimaryLanguage>"))?;
        self.line(3, format_args!("</ExternalTextList>"))
    }
}

#[cfg(test)]
mod tests;
