//! Checks the GSDML file and the lists in docs/simulator.md.

use bus_profinet::{Gsdml, GsdmlFacts, Priority};
use document::{hold, hold_file, read};
use host_tests::device_files::{FOLDERS, GSDML, GSDML_BITMAP, VENDOR};
use roxmltree::{Document, Node};
use wsg_fieldbus::profinet::PROFILE;
use wsg_fieldbus::{InputImage, OutputImage};

const PAGE: &str = "docs/simulator.md";

const FACTS: GsdmlFacts<'_> = GsdmlFacts {
    // The catalogue path of the original gripper (fieldbus, 3.1).
    vendor: VENDOR,
    family: "WSG",
    main_family: "I/O",
    info: "wsg-sim, a virtual gripper of the WSG series: 8 bytes of outputs, 12 bytes of inputs",
    bitmap: Some(GSDML_BITMAP),
};

/// Returns the file's path from the root.
fn path() -> String {
    format!("docs/{GSDML}")
}

#[test]
fn gsdml_file_is_that_of_the_tables() {
    let text = Gsdml { facts: FACTS, profile: &PROFILE }.to_string();
    FOLDERS.iter().for_each(|folder| hold_file(&format!("{folder}/{GSDML}"), &text));
}

/// Returns the elements with this name.
fn all<'a>(document: &'a Document<'_>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    document.descendants().filter(move |node| node.tag_name().name() == name)
}

/// Parses a decimal number, or a hexadecimal one after `0x`.
fn number(node: Node<'_, '_>, attribute: &str) -> u32 {
    let text = node.attribute(attribute).unwrap_or_else(|| panic!("{node:?} has no {attribute}"));
    match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).unwrap(),
        None => text.parse().unwrap(),
    }
}

#[test]
fn numbers_of_the_file_are_those_of_the_device() {
    let text = read(&path());
    let document = Document::parse(&text).expect("well-formed");
    let identity = all(&document, "DeviceIdentity").next().unwrap();
    assert_eq!((number(identity, "VendorID"), number(identity, "DeviceID")), (0x02A2, 0x0001));

    let modules = all(&document, "DeviceAccessPointItem").chain(all(&document, "ModuleItem"));
    let idents: Vec<u32> = modules.map(|module| number(module, "ModuleIdentNumber")).collect();
    assert_eq!(idents, PROFILE.modules.iter().map(|module| module.ident).collect::<Vec<_>>());
    let fixed: Vec<u32> =
        all(&document, "ModuleItemRef").map(|module| number(module, "FixedInSlots")).collect();
    assert_eq!(fixed, [1, 2]);

    let mut listed = vec![];
    for submodule in all(&document, "VirtualSubmoduleItem") {
        listed.push((number(submodule, "FixedInSubslots"), number(submodule, "SubmoduleIdentNumber")));
    }
    for name in ["InterfaceSubmoduleItem", "PortSubmoduleItem"] {
        let submodule = all(&document, name).next().unwrap();
        listed.push((number(submodule, "SubslotNumber"), number(submodule, "SubmoduleIdentNumber")));
    }
    let submodules = PROFILE.modules.iter().flat_map(|module| module.submodules);
    let mut expected: Vec<_> =
        submodules.map(|submodule| (u32::from(submodule.subslot), submodule.ident)).collect();
    listed.sort_unstable();
    expected.sort_unstable();
    assert_eq!(listed, expected);

    let lens: Vec<_> = all(&document, "DataItem")
        .map(|item| (item.parent().unwrap().tag_name().name(), number(item, "Length") as usize))
        .collect();
    assert_eq!(lens, [("Input", InputImage::LEN), ("Output", OutputImage::LEN)]);
    // IOPS and IOCS of two data submodules, of the access point, of its interface and of its port.
    let data = all(&document, "IOConfigData").next().unwrap();
    assert_eq!((number(data, "MaxInputLength"), number(data, "MaxOutputLength")), (17, 13));

    let errors: Vec<u32> = all(&document, "ChannelDiagItem").map(|item| number(item, "ErrorType")).collect();
    assert_eq!(errors, PROFILE.faults.iter().map(|fault| fault.error_type.into()).collect::<Vec<u32>>());
}

/// Returns whether a file, as text and as elements, keeps a rule.
type Check = fn(&str, &Document<'_>) -> bool;

/// Rules of TIA Portal's checker beyond the schema (from its public logs and p-net's guide), each with a modification of the
/// file that breaks it. Rules for PROFINET V2.31 do not apply to a device that declares V2.3.
const RULES: [(&str, Check, [&str; 2]); 11] = [
    (
        "CertificationInfo from V2.31 on",
        |_, file| is_before_v2_31(file) || all(file, "CertificationInfo").next().is_some(),
        ["PNIO_Version=\"V2.3\"", "PNIO_Version=\"V2.31\""],
    ),
    (
        "LLDP_NoD_Supported from V2.31 on",
        |_, file| is_before_v2_31(file) || is_true(file, "DeviceAccessPointItem", "LLDP_NoD_Supported"),
        ["PNIO_Version=\"V2.3\"", "PNIO_Version=\"V2.31\""],
    ),
    (
        "PTP_BoundarySupported from V2.31 on",
        |_, file| is_before_v2_31(file) || is_true(file, "InterfaceSubmoduleItem", "PTP_BoundarySupported"),
        ["PNIO_Version=\"V2.3\"", "PNIO_Version=\"V2.4\""],
    ),
    (
        "DCP_BoundarySupported from V2.31 on",
        |_, file| is_before_v2_31(file) || is_true(file, "InterfaceSubmoduleItem", "DCP_BoundarySupported"),
        ["PNIO_Version=\"V2.3\"", "PNIO_Version=\"V2.4\""],
    ),
    (
        "ResetToFactoryModes has mode 2",
        |_, file| item(file, "DeviceAccessPointItem").attribute("ResetToFactoryModes") == Some("2"),
        ["ResetToFactoryModes=\"2\"", "ResetToFactoryModes=\"1\""],
    ),
    (
        // PDInterfaceAdjust (8071h) sets the feature declared by LLDP_NoD_Supported, and the device has no such record.
        "record 8071h is not offered",
        |_, file| !is_true(file, "DeviceAccessPointItem", "LLDP_NoD_Supported"),
        ["MultipleWriteSupported=", "LLDP_NoD_Supported=\"true\" MultipleWriteSupported="],
    ),
    (
        "CheckDeviceID_Allowed and NameOfStationNotTransferable are given",
        |_, file| {
            ["CheckDeviceID_Allowed", "NameOfStationNotTransferable"]
                .iter()
                .all(|name| item(file, "DeviceAccessPointItem").has_attribute(*name))
        },
        ["NameOfStationNotTransferable=\"false\"", ""],
    ),
    (
        "MaxInputLength counts IOPS and IOCS",
        |_, file| number(item(file, "IOConfigData"), "MaxInputLength") == frame_len(file, "Input"),
        ["MaxInputLength=\"17\"", "MaxInputLength=\"12\""],
    ),
    (
        "MaxOutputLength counts IOPS and IOCS",
        |_, file| number(item(file, "IOConfigData"), "MaxOutputLength") == frame_len(file, "Output"),
        ["MaxOutputLength=\"13\"", "MaxOutputLength=\"8\""],
    ),
    (
        "the name of the file has the version of the schema",
        |text, _| {
            let version = GSDML.split('-').nth(1).unwrap();
            text.contains(&format!("GSDML-DeviceProfile-{version}.xsd"))
        },
        ["DeviceProfile-V2.31.xsd", "DeviceProfile-V2.3.xsd"],
    ),
    (
        "the device's symbol is a bitmap named by vendor and device number",
        |_, file| {
            let target = item(file, "GraphicItemRef").attribute("GraphicItemTarget");
            let picture = item(file, "GraphicItem");
            picture.attribute("ID") == target
                && picture.attribute("GraphicFile") == Some("GSDML-02A2-0001-WSG")
        },
        ["GraphicItemTarget=\"Symbol\"", "GraphicItemTarget=\"Other\""],
    ),
];

/// Returns the only element with this name.
fn item<'a>(file: &'a Document<'_>, name: &'static str) -> Node<'a, 'a> {
    all(file, name).next().unwrap_or_else(|| panic!("no {name}"))
}

fn is_true(file: &Document<'_>, name: &'static str, attribute: &str) -> bool {
    item(file, name).attribute(attribute) == Some("true")
}

/// Returns whether the device conforms to a version before V2.31. Versions are decimals: V2.25 < V2.3 < V2.31 (GSDML, 5.1).
fn is_before_v2_31(file: &Document<'_>) -> bool {
    let version = item(file, "DeviceAccessPointItem").attribute("PNIO_Version").unwrap();
    version.strip_prefix('V').unwrap().parse::<f32>().unwrap() < 2.31
}

/// Returns the length of the cyclic data in a direction: a provider status after each submodule's data, and a consumer status
/// for each submodule with data in the other direction. Submodules without data count as inputs.
fn frame_len(file: &Document<'_>, direction: &str) -> u32 {
    let names = ["VirtualSubmoduleItem", "InterfaceSubmoduleItem", "PortSubmoduleItem"];
    let submodules = file.descendants().filter(|node| names.contains(&node.tag_name().name()));
    let lens = submodules.map(|submodule| {
        let len = |direction: &str| -> u32 {
            let data = submodule.descendants().filter(|node| node.tag_name().name() == direction);
            data.flat_map(|data| data.children().filter(Node::is_element))
                .map(|item| number(item, "Length"))
                .sum()
        };
        let statuses = if len("Input") > 0 && len("Output") > 0 { 2 } else { 1 };
        len(direction) + statuses
    });
    lens.sum()
}

#[test]
fn file_keeps_every_rule_of_tia_portal() {
    let text = read(&path());
    for (rule, holds, [part, change]) in RULES {
        assert!(holds(&text, &Document::parse(&text).unwrap()), "broken: {rule}");
        assert_eq!(text.matches(part).count(), 1, "{rule}: {part}");
        let broken = text.replace(part, change);
        assert!(
            !holds(&broken, &Document::parse(&broken).unwrap()),
            "the modified file does not break the rule: {rule}"
        );
    }
}

/// Checks the catalogue path (fieldbus, 3.1): PROFINET IO -> I/O -> Weiss Robotics GmbH & Co. KG.
#[test]
fn gsdml_file_has_the_catalogue_path_of_the_manual() {
    let text = read(&path());
    let file = Document::parse(&text).unwrap();
    assert_eq!(item(&file, "Family").attribute("MainFamily"), Some("I/O"));
    for vendor in all(&file, "VendorName") {
        assert_eq!(vendor.attribute("Value"), Some("Weiss Robotics GmbH & Co. KG"));
    }
}

#[test]
fn every_named_text_exists_once_and_every_id_is_unique() {
    let text = read(&path());
    let document = Document::parse(&text).unwrap();
    let texts: Vec<_> = all(&document, "Text").map(|text| text.attribute("TextId").unwrap()).collect();
    let named = document.descendants().filter(|node| node.tag_name().name() != "Text");
    for id in named.filter_map(|node| node.attribute("TextId")) {
        assert_eq!(texts.iter().filter(|text| **text == id).count(), 1, "{id}");
    }
    let mut ids: Vec<_> = document.descendants().filter_map(|node| node.attribute("ID")).collect();
    let count = ids.len();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), count);
    for target in all(&document, "ModuleItemRef").map(|module| module.attribute("ModuleItemTarget").unwrap())
    {
        assert!(ids.contains(&target), "{target}");
    }
}

#[test]
fn lists_of_the_page_are_those_of_the_device() {
    let modules = PROFILE.modules.iter().map(|module| {
        let submodules = module.submodules.iter().map(|submodule| {
            let subslot = submodule.subslot;
            let number = if subslot < 0x8000 { subslot.to_string() } else { format!("{subslot:X}h") };
            format!("subslot {number} ({:X}h)", submodule.ident)
        });
        let submodules = submodules.collect::<Vec<_>>().join(", ");
        format!("- slot {}, {} ({:X}h): {submodules}\n", module.slot, module.name, module.ident)
    });
    hold(PAGE, "profinet modules", &modules.collect::<String>());
    let faults = PROFILE.faults.iter().map(|fault| {
        let priority = if fault.priority == Priority::High { ", high priority" } else { "" };
        format!("- `{}`: {:04X}h{priority}\n", fault.name, fault.error_type)
    });
    hold(PAGE, "profinet faults", &faults.collect::<String>());
}
