//! Checks the flash of each board: the regions reserved for updates in the field, and the addresses of the settings, which must
//! never change.

use std::collections::BTreeMap;
use std::ops::Range;

use document::{hold, read};

/// Bytes for the boot loader, at the start of flash.
const BOOT: u64 = wsg_update::BOOT_LEN as u64;

/// Bytes of a slot after the program.
const MANIFEST_AND_SIGNATURE: u64 = (wsg_update::Manifest::LEN + wsg_update::SIGNATURE_LEN) as u64;

/// A board, and the facts of its flash.
struct Board {
    name: &'static str,
    flash: Range<u64>,
    /// Unit of an erase.
    page: u64,
    /// Address of the settings since their introduction.
    settings: u64,
    /// Source of the settings' driver, and its statement of their address.
    driver: (&'static str, &'static str),
}

const BOARDS: [Board; 3] = [
    Board {
        name: "b-l475e-iot01a",
        flash: 0x0800_0000..0x0810_0000,
        page: 2_048,
        settings: 0x080F_F000,
        driver: ("boards/stm32/src/chip.rs", "FLASH_END: usize = 0x0810_0000"),
    },
    Board {
        name: "nucleo-g474re",
        flash: 0x0800_0000..0x0808_0000,
        page: 2_048,
        settings: 0x0807_F000,
        driver: ("boards/stm32/src/chip.rs", "FLASH_END: usize = 0x0808_0000"),
    },
    Board {
        name: "pico",
        flash: 0x1000_0000..0x1020_0000,
        page: 4_096,
        settings: 0x101F_E000,
        driver: (
            "boards/pico/src/firmware/flash.rs",
            "FIRST_SECTOR: u32 = 2 * 1024 * 1024 - 2 * SECTOR_BYTES as u32",
        ),
    },
];

/// Parses a number of a linker script: `0x100`, `194K`, or a difference of two numbers.
fn number(text: &str) -> u64 {
    if let Some((a, b)) = text.split_once(" - ") {
        return number(a) - number(b);
    }
    match (text.strip_prefix("0x"), text.strip_suffix('K')) {
        (Some(digits), _) => u64::from_str_radix(digits, 16).unwrap(),
        (_, Some(digits)) => digits.parse::<u64>().unwrap() * 1_024,
        _ => text.parse().unwrap(),
    }
}

/// Returns the regions of flash in a board's linker script.
fn regions(board: &Board) -> BTreeMap<String, Range<u64>> {
    regions_in(&format!("boards/{}/board-memory.x", board.name))
}

/// Returns the regions of flash in a linker script.
fn regions_in(script: &str) -> BTreeMap<String, Range<u64>> {
    let script = read(script);
    let lines = script.lines().filter_map(|line| line.split_once(": ORIGIN = "));
    let regions = lines.map(|(name, rest)| {
        let (origin, length) = rest.split_once(", LENGTH = ").unwrap();
        let origin = number(origin);
        (name.trim().to_owned(), origin..origin + number(length))
    });
    regions.filter(|(name, _)| name != "RAM").collect()
}

/// Returns the length of a slot for an image, from the assertion of the linker.
fn slot() -> u64 {
    let script = read("boards/update-slot.x");
    let (_, limit) = script.split_once("ORIGIN(FLASH) <= ").expect("the assertion");
    number(limit.split(',').next().unwrap())
}

#[test]
fn addresses_of_the_settings_are_those_of_the_first_release() {
    for board in &BOARDS {
        let settings = regions(board)["SETTINGS"].clone();
        assert_eq!(settings, board.settings..board.flash.end, "{}", board.name);
        assert_eq!(settings.end - settings.start, 2 * board.page, "{}", board.name);
        let (driver, statement) = board.driver;
        assert!(read(driver).contains(statement), "{driver}");
    }
}

#[test]
fn flash_has_room_for_boot_loader_and_two_slots() {
    let slot = slot();
    for board in &BOARDS {
        let Board { name, page, .. } = *board;
        let regions = regions(board);
        let mut sorted: Vec<_> = regions.values().cloned().collect();
        sorted.sort_by_key(|region| region.start);
        assert_eq!(sorted[0].start, board.flash.start, "{name}");
        assert!(sorted.windows(2).all(|pair| pair[0].end <= pair[1].start), "{name}: {sorted:X?}");
        for region in ["DFU", "ROLLBACK", "BOOTLOADER_STATE", "SETTINGS"] {
            let Range { start, end } = regions[region];
            assert!(start % page == 0 && end % page == 0 && end <= board.flash.end, "{name} {region}");
        }
        let len = |region: &str| regions[region].end - regions[region].start;
        assert!(board.flash.start + BOOT + slot <= regions["FLASH"].end, "{name}");
        // The exchange of the slots needs one spare page. A record needs two pages.
        assert_eq!((slot % page, len("DFU")), (0, slot + page), "{name}");
        assert_eq!((len("BOOTLOADER_STATE"), len("ROLLBACK")), (2 * page, 2 * page), "{name}");
        let part = |part: &str| regions_in(&format!("boards/{name}/{part}/board-memory.x"))["FLASH"].clone();
        assert_eq!(part("boot").end, board.flash.start + BOOT, "{name}");
        let image = board.flash.start + BOOT..board.flash.start + BOOT + slot - MANIFEST_AND_SIGNATURE;
        assert_eq!((part("slot"), u64::from(wsg_update::SLOT_LEN)), (image, slot), "{name}");
    }
}

#[test]
fn size_limits_and_build_scripts_keep_each_image_in_its_slot() {
    let limits = read("boards/table/src/lib.rs");
    let limits = limits.split("flash_limit: ").skip(1).filter_map(|rest| {
        let (kib, _) = rest.split_once(" * 1024")?;
        kib.parse::<u64>().ok()
    });
    let limits: Vec<_> = limits.collect();
    // Without and with a boot loader.
    assert_eq!(limits.len(), 2 * BOARDS.len());
    assert!(limits.iter().all(|kib| kib * 1_024 + MANIFEST_AND_SIGNATURE <= slot()), "{limits:?}");
    assert!(read("boards/build/src/lib.rs").contains("rustc-link-arg-bins=-T{}\", slot.display()"));
    for Board { name, .. } in &BOARDS {
        assert!(read(&format!("boards/{name}/build.rs")).contains("board_build::pass_layout();"), "{name}");
    }
}

#[test]
fn flash_layout_in_the_document_is_that_of_the_linker_scripts() {
    let slot = slot();
    let mut text = "```text\n".to_owned();
    for board in &BOARDS {
        let start = board.flash.start;
        text.push_str(&format!("{}\n", board.name));
        let mut rows =
            vec![("boot loader", start..start + BOOT), ("slot A", start + BOOT..start + BOOT + slot)];
        let regions = regions(board);
        for (name, region) in [
            ("slot B", "DFU"),
            ("rollback counter", "ROLLBACK"),
            ("boot loader's state", "BOOTLOADER_STATE"),
            ("settings", "SETTINGS"),
        ] {
            rows.push((name, regions[region].clone()));
        }
        for (name, Range { start, end }) in rows {
            text.push_str(&format!(
                "  {start:08X} to {:08X}  {:>3} KiB  {name}\n",
                end - 1,
                (end - start) / 1_024
            ));
        }
    }
    hold("docs/decisions.md", "flash-layout", &format!("{text}```"));
}
