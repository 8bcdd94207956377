//! Checks docs/quick-start.md: its registers against the tables, and the grip that it leads to. Also the grip in README.md, over CAN in
//! docs/can.md, and over PROFIBUS in docs/profibus.md.

use document::{ImageAccess, can_frames, image_accesses, read};
use host_tests::world::modbus::{Master, RELEASE};
use host_tests::world::plc::Plc;
use host_tests::world::{World, profibus, with_part};
use wsg_bridge_fw::Config;
use wsg_bridge_fw::can::{DEFAULT_NODE, NodeConfig};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS,
};
use wsg_fieldbus::OutputImage;
use wsg_protocol::CommandId;

const DOCUMENT: &str = "docs/quick-start.md";

/// Returns each name with its address: `NAME` (address), or NAME (address) after a command.
fn named(text: &str) -> Vec<(&str, u16)> {
    let pairs = text.match_indices('(').filter_map(|(at, _)| {
        let address = text[at + 1..].split(')').next()?.parse().ok()?;
        let before = text[..at].trim_end().trim_end_matches('`');
        let is_part = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_';
        Some((&before[before.trim_end_matches(is_part).len()..], address))
    });
    pairs.collect()
}

#[test]
fn registers_of_the_quick_start_are_those_of_the_tables() {
    let settings = (FIRST_SETTING..).zip(SETTINGS.iter().map(|setting| setting.name));
    let reports = (FIRST_REPORT..).zip(REPORTS.iter().map(|report| report.name));
    let commands = (FIRST_COMMAND..).zip(COMMANDS.iter().map(|command| command.name));
    let all: Vec<_> = settings.chain(reports).chain(commands).collect();
    let text = read(DOCUMENT);
    let named = named(&text);
    assert!(named.len() > 20, "{named:?}");
    for (name, address) in named {
        assert!(all.contains(&(address, name)), "{name} is not at {address}");
    }
}

#[test]
fn quick_start_commands_name_registers_and_write_valid_values() {
    let text = read(DOCUMENT);
    let lines: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("$M -t ")).collect();
    assert!(lines.len() > 10, "{lines:?}");
    for line in lines {
        let (command, comment) = line.split_once("# ").expect("a comment with the register");
        let words: Vec<&str> = command.split_whitespace().collect();
        let [table, "-r", address, what @ ..] = &words[..] else { panic!("{line}") };
        let address: u16 = address.parse().unwrap();
        let (name, documented) = named(comment)[0];
        assert_eq!(address, documented, "{line}");
        let is_report =
            address.checked_sub(FIRST_REPORT).and_then(|at| REPORTS.get(usize::from(at))).map(|it| it.name)
                == Some(name);
        match what {
            ["-c", "1", "$T"] => assert_eq!(*table == "3", is_report, "{line}"),
            ["$T", key] if address >= FIRST_COMMAND => assert_eq!(*key, format!("0x{COMMAND_KEY:X}")),
            ["$T", value] => {
                let setting = SETTINGS.iter().find(|setting| setting.name == name).expect(line);
                let range = setting.least..=setting.most;
                assert!(*table == "4" && range.contains(&value.parse().unwrap()), "{line}");
            }
            _ => panic!("{line}"),
        }
    }
}

/// Executes accesses as a PLC that polls.
fn play(plc: &mut impl Plc, accesses: &[ImageAccess]) {
    for access in accesses {
        match access {
            ImageAccess::Write(values) => {
                let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
                *plc.image() = OutputImage::from_bytes(bytes.try_into().unwrap());
                plc.write();
            }
            ImageAccess::Read(expected) => {
                let is_read = (0..20_000).any(|_| {
                    plc.run(1);
                    let input = plc.read().to_bytes();
                    let words = input.chunks(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]]));
                    ImageAccess::expects(expected, words)
                });
                assert!(is_read, "{expected:?} is not read, but {:?}", plc.read());
            }
        }
    }
}

/// Returns the first grip of a document, in steps.
fn first_grip(document: &str) -> String {
    let text = read(document);
    let (_, first_grip) = text.split_once("\n## First grip\n").expect("the page has a first grip");
    first_grip.split_once("\n## ").expect("a section follows the first grip").0.to_owned()
}

#[test]
fn quick_start_and_readme_registers_lead_to_a_grip() {
    let mut plc = Master::new(Config::DEFAULT, with_part(20.0));
    plc.pass(500);
    let accesses = image_accesses(&read(DOCUMENT));
    assert!(accesses.len() > 10, "{accesses:?}");
    play(&mut plc, &accesses);
    assert_eq!(plc.take_motions(), [CommandId::Homing, CommandId::GripPart]);

    plc.command(RELEASE, 40_00, 50_00, 40_00);
    let accesses = image_accesses(&read("README.md"));
    assert_eq!(accesses.len(), 3, "{accesses:?}");
    play(&mut plc, &accesses);
    assert_eq!(plc.take_motions(), [CommandId::ReleasePart, CommandId::GripPart]);
}

#[test]
fn frames_of_the_can_page_lead_to_a_grip_as_node_5() {
    const NODE: NodeConfig = NodeConfig { node: 5, ..DEFAULT_NODE };
    let mut rig = World::with_node(with_part(20.0), NODE);
    rig.can.beats = true;
    // The wire is low at power-up.
    rig.set(Inputs::FAST_STOP_OK, false);
    rig.pass(300);
    rig.set(Inputs::FAST_STOP_OK, true);
    rig.pass(100);
    let frames = can_frames(&first_grip("docs/can.md"));
    assert!(frames.len() > 10, "{frames:02X?}");
    for (id, data) in frames {
        if id != 0x180 | u16::from(NODE.node) {
            rig.can.send(id, &data);
            rig.pass(50);
            continue;
        }
        rig.can.take_frames();
        let is_told = (0..5_000).any(|_| {
            rig.pass(1);
            rig.can.take_frames().iter().any(|(_, received, sent)| (*received, sent) == (id, &data))
        });
        assert!(is_told, "{id:03X} {data:02X?} was not received");
    }
    assert_eq!(rig.take_motions(), [CommandId::Homing, CommandId::GripPart]);
}

#[test]
fn words_of_the_profibus_page_lead_to_a_grip() {
    let mut plc = profibus::Master::power_up(profibus::AT_500K, with_part(20.0));
    // The wire is low at power-up.
    plc.world.set(Inputs::FAST_STOP_OK, false);
    plc.fall_silent(300);
    plc.world.set(Inputs::FAST_STOP_OK, true);
    plc.fall_silent(100);
    plc.resume();
    let accesses = image_accesses(&first_grip("docs/profibus.md"));
    assert!(accesses.len() > 10, "{accesses:?}");
    play(&mut plc, &accesses);
    assert_eq!(plc.world.take_motions(), [CommandId::Homing, CommandId::GripPart]);
}
