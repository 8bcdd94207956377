//! Checks docs/figures.md, which `cargo xtask figures` writes: its limits equal the gates' limits, and
//! its image sizes match the tested image.

use std::path::PathBuf;

use document::{part, read, root};
use footprint::{Footprint, sections_of};

const DOCUMENT: &str = "docs/figures.md";
const PART: &str = "figures";

/// Allowed deviation of the image from the document, in percent, because compilers differ.
const TOLERANCE: u64 = 10;

/// Rows that depend on the image, each with the limit in the document, in the source, and the source's path.
const FLASH: [&str; 4] =
    ["firmware image, flash", "80 KiB", "flash_limit: 80 * 1024", "boards/table/src/lib.rs"];
const STATIC_RAM: [&str; 4] =
    ["firmware image, static RAM", "12 KiB", "STATIC_RAM_LIMIT: u64 = 12 * 1024", "xtask/src/size.rs"];

/// Returns the cells of this row after the first.
fn row(what: &str) -> Vec<String> {
    let part = part(DOCUMENT, PART);
    let row = part.lines().find_map(|line| line.strip_prefix(&format!("| {what} | ")));
    let row = row.unwrap_or_else(|| panic!("{DOCUMENT} has no row \"{what}\""));
    row.trim_end_matches(" |").split(" | ").map(str::to_owned).collect()
}

#[test]
fn limits_in_the_document_are_those_of_the_size_gate() {
    for [what, limit, source, file] in [FLASH, STATIC_RAM] {
        assert!(read(file).contains(source), "{what}: {file} no longer has the limit {limit}");
        assert_eq!(row(what)[1], limit, "{what}");
    }
}

#[test]
fn number_of_fuzz_targets_in_the_document_is_that_of_the_folder() {
    let count = std::fs::read_dir(root().join("host-tests/fuzz/fuzz_targets")).unwrap().count();
    let start = format!("| `cargo xtask fuzz` | {count} targets, ");
    assert!(read(DOCUMENT).contains(&start), "{DOCUMENT} has no \"{start}\"");
}

#[test]
#[ignore = "needs the firmware image: run `cargo xtask test`"]
fn sizes_in_the_document_are_near_those_of_the_image() {
    let image = std::env::var_os("WSG_FIRMWARE_ELF")
        .expect("WSG_FIRMWARE_ELF must hold the path of the firmware image");
    let image = std::fs::read(PathBuf::from(image)).unwrap();
    let Footprint { flash, static_ram } = Footprint::of(&sections_of(&image).unwrap());
    for (what, measured) in [(FLASH[0], flash), (STATIC_RAM[0], static_ram)] {
        let stated: u64 = row(what)[0].split(' ').next().unwrap().parse().unwrap();
        assert!(
            stated.abs_diff(measured) * 100 <= measured * TOLERANCE,
            "{DOCUMENT}: {what} is now {measured} B; run `cargo xtask figures`"
        );
    }
}
