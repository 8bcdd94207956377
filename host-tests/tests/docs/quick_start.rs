//! The names, addresses and values of registers in docs/quick-start.md are those of the tables.

use host_tests::document::read;
use wsg_bridge_fw::registers::{
    COMMAND_KEY, COMMANDS, FIRST_COMMAND, FIRST_REPORT, FIRST_SETTING, REPORTS, SETTINGS,
};

const DOCUMENT: &str = "docs/quick-start.md";

/// Each name with its address: `NAME` (address), or NAME (address) behind a command.
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
    assert!(named.len() > 25, "{named:?}");
    for (name, address) in named {
        assert!(all.contains(&(address, name)), "{name} is not at {address}");
    }
}

#[test]
fn commands_of_the_quick_start_name_their_register_and_write_what_it_takes() {
    let text = read(DOCUMENT);
    let lines: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("$M -t ")).collect();
    assert!(lines.len() > 10, "{lines:?}");
    for line in lines {
        let (command, comment) = line.split_once("# ").expect("each says which register it is");
        let words: Vec<&str> = command.split_whitespace().collect();
        let [table, "-r", address, what @ ..] = &words[..] else { panic!("{line}") };
        let address: u16 = address.parse().unwrap();
        let (name, said) = named(comment)[0];
        assert_eq!(address, said, "{line}");
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
