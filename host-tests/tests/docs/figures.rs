//! The table of figures in README.md: the image's sizes are near those of the image that is tested.

use std::path::PathBuf;

use crate::document::{hold, is_updating, part, read, table};
use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, SectionFlags, elf};
use wsg_protocol::FrameParser;

const DOCUMENT: &str = "README.md";
const PART: &str = "figures";

/// How far the image may be from what the document says, in percent: compilers differ (Rust 1.96 of the Debian path makes
/// an image 7 % smaller than 1.95).
const TOLERANCE: u64 = 10;

/// The rows that the image decides, and how the limit stands in xtask/src/size.rs.
const FLASH: (&str, &str, &str) = ("firmware image, flash", "32 KiB", "FLASH_LIMIT: u64 = 32 * 1024");
const STATIC_RAM: (&str, &str, &str) =
    ("firmware image, static RAM", "6 KiB", "STATIC_RAM_LIMIT: u64 = 6 * 1024");

/// What is wanted and nobody has measured yet.
const NOT_MEASURED: [(&str, &str); 7] = [
    ("parser and encoder, code", "1200 B (700 B with `small-table`)"),
    ("whole protocol crate, code", "12 KiB"),
    ("worst-case stack of the firmware", "2 KiB"),
    ("panic paths in the protocol crate, every public function", "0"),
    ("instructions per byte on a Cortex-M4, byte by byte / in bulk", "32 / 10"),
    ("PLC edge to first byte on the gripper's line, after debouncing", "50 µs"),
    ("host throughput in bulk", "1 GB/s"),
];

/// Flash and static RAM of an image, in bytes, as `cargo xtask size` counts them.
fn measure(image: &[u8]) -> (u64, u64) {
    let image = ElfFile32::<object::Endianness>::parse(image).unwrap();
    let (mut flash, mut static_ram) = (0, 0);
    for section in image.sections() {
        let SectionFlags::Elf { sh_type, sh_flags } = section.flags() else { continue };
        if !sh_flags.contains(elf::SHF_ALLOC) {
            continue;
        }
        let is_loaded = sh_type != elf::SHT_NOBITS;
        flash += if is_loaded { section.size() } else { 0 };
        static_ram += if sh_flags.contains(elf::SHF_WRITE) || !is_loaded { section.size() } else { 0 };
    }
    (flash, static_ram)
}

fn figures(flash: u64, static_ram: u64) -> String {
    let row = |what: &str, value: String, limit: &str| [what.to_owned(), value, limit.to_owned()];
    let parser = size_of::<FrameParser<64>>();
    let mut rows = vec![
        row(FLASH.0, format!("{flash} B"), FLASH.1),
        row(STATIC_RAM.0, format!("{static_ram} B"), STATIC_RAM.1),
        row("parser for 64 bytes of payload, RAM", format!("{parser} B"), "64 + 16 B"),
    ];
    // A build that links only without them: `cargo xtask build --features prove-panic-free`.
    rows.push(row(
        "panic paths in the firmware image",
        "0 (it links with `prove-panic-free`)".to_owned(),
        "0",
    ));
    rows.extend(NOT_MEASURED.map(|(what, limit)| row(what, "not measured yet".to_owned(), limit)));
    table(["what", "measured", "limit"], rows)
}

/// The number that the document gives in this row.
fn stated(what: &str) -> u64 {
    let part = part(DOCUMENT, PART);
    let row = part.lines().find_map(|line| line.strip_prefix(&format!("| {what} | ")));
    row.unwrap_or_else(|| panic!("{DOCUMENT} has no row \"{what}\""))
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap()
}

#[test]
fn figures_in_the_readme_are_those_of_the_code() {
    if !is_updating() {
        hold(DOCUMENT, PART, &figures(stated(FLASH.0), stated(STATIC_RAM.0)));
    }
}

#[test]
fn limits_in_the_readme_are_those_of_the_size_gate() {
    let gate = read("xtask/src/size.rs");
    for (what, limit, source) in [FLASH, STATIC_RAM] {
        assert!(gate.contains(source), "{what}: the limit is no longer {limit}");
    }
}

#[test]
#[ignore = "needs the firmware image: run `cargo xtask test`"]
fn sizes_in_the_readme_are_near_those_of_the_image() {
    let image = std::env::var_os("WSG_FIRMWARE_ELF").expect("WSG_FIRMWARE_ELF names the firmware image");
    let (flash, static_ram) = measure(&std::fs::read(PathBuf::from(image)).unwrap());
    if is_updating() {
        hold(DOCUMENT, PART, &figures(flash, static_ram));
    }
    for (what, measured) in [(FLASH.0, flash), (STATIC_RAM.0, static_ram)] {
        let off = stated(what).abs_diff(measured) * 100;
        assert!(
            off <= measured * TOLERANCE,
            "{DOCUMENT}: {what} is {measured} B now; WSG_UPDATE_DOCS=1 cargo xtask test sizes_in_the_readme"
        );
    }
}
