//! The GSDML file, and the tables of docs/profinet.md.

use bus_profinet::{Gsdml, GsdmlFacts, Priority};
use host_tests::document::{hold, hold_file, read, table};
use roxmltree::{Document, Node};
use wsg_protocol::fieldbus::profinet::PROFILE;
use wsg_protocol::fieldbus::{InputImage, OutputImage};

/// Named as tools want it: version of the language, vendor, device, date.
const FILE: &str = "docs/GSDML-V2.31-wsg-sim-WSG-20261123.xml";
const PAGE: &str = "docs/profinet.md";

const FACTS: GsdmlFacts<'_> = GsdmlFacts {
    vendor: "wsg-sim",
    family: "WSG",
    // Where the gripper's own file is listed (fieldbus, 3.1).
    main_family: "I/O",
    info: "A servo gripper of the WSG series: 8 bytes of outputs, 12 bytes of inputs",
};

#[test]
fn gsdml_file_is_that_of_the_tables() {
    hold_file(FILE, &Gsdml { facts: FACTS, profile: &PROFILE }.to_string());
}

/// The elements of this name.
fn all<'a>(document: &'a Document<'_>, name: &'static str) -> impl Iterator<Item = Node<'a, 'a>> {
    document.descendants().filter(move |node| node.tag_name().name() == name)
}

/// A number in decimal, or behind `0x` in hexadecimal.
fn number(node: Node<'_, '_>, attribute: &str) -> u32 {
    let text = node.attribute(attribute).unwrap_or_else(|| panic!("{node:?} has no {attribute}"));
    match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).unwrap(),
        None => text.parse().unwrap(),
    }
}

#[test]
fn numbers_of_the_file_are_those_of_the_device() {
    let text = read(FILE);
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
    let data = all(&document, "IOConfigData").next().unwrap();
    assert_eq!((number(data, "MaxInputLength"), number(data, "MaxOutputLength")), (12, 8));

    let errors: Vec<u32> = all(&document, "ChannelDiagItem").map(|item| number(item, "ErrorType")).collect();
    assert_eq!(errors, PROFILE.faults.iter().map(|fault| fault.error_type.into()).collect::<Vec<u32>>());
}

#[test]
fn every_text_that_the_file_names_is_there_once_and_every_id_is_another_one() {
    let text = read(FILE);
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
fn tables_of_the_page_are_those_of_the_device() {
    let modules = PROFILE.modules.iter().flat_map(|module| {
        module.submodules.iter().map(|submodule| {
            let subslot = submodule.subslot;
            [
                module.slot.to_string(),
                if subslot < 0x8000 { subslot.to_string() } else { format!("{subslot:X}h") },
                module.name.to_owned(),
                format!("{:X}h", module.ident),
                format!("{:X}h", submodule.ident),
                submodule.input_len.to_string(),
                submodule.output_len.to_string(),
            ]
        })
    });
    let head = ["slot", "subslot", "module", "its ident number", "the submodule's", "bytes in", "bytes out"];
    hold(PAGE, "profinet modules", &table(head, modules));
    let faults = PROFILE.faults.iter().map(|fault| {
        let priority = if fault.priority == Priority::High { "high" } else { "low" };
        [format!("`{}`", fault.name), format!("{:04X}h", fault.error_type), priority.to_owned()]
    });
    hold(PAGE, "profinet faults", &table(["flag", "ChannelErrorType", "priority"], faults));
}
