//! Builds the folder for PLC engineers: image, device files, manual, book, licences. Run it with `cargo xtask dist`. The
//! same sources give the same bytes in any location. `cargo xtask release` runs it for each board, and makes every other
//! file to upload.

mod api;
mod archive;
mod bitmap;
mod board_names;
mod book;
mod device_archives;
mod manual;
mod program;
mod register_map;
mod release;

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::{Context, Result, ensure};
use boards::Board;
use clap::Parser;
use document::root;
use host_tests::{
    board_wiring::BoardWiring,
    device_files::{ETHERNETIP_EDS, GSD},
};
use sha2::{Digest, Sha256};

/// Files of `docs` that are copied unchanged.
const COPIED: [&str; 9] = [
    "wsg-bridge.eds",
    GSD,
    ETHERNETIP_EDS,
    "FB_WSG_GRIP.st",
    "PRG_WSG_MODBUS.st",
    "PRG_WSG_DEMO.st",
    "wsg-blocks.xml",
    "wsg-blocks.scl",
    "wsg-blocks.L5X",
];

const REGISTERS: &str = "registers.csv";
const SUMS: &str = "SHA256SUMS";

/// Returns the files to which the manual may link.
fn linked() -> Vec<&'static str> {
    COPIED.into_iter().chain([REGISTERS]).collect()
}

/// Folders of the programs for a PLC engineer's computer.
const WINDOWS: &str = "windows";
const LINUX: &str = "linux";

/// Folder of the files for updates in the field.
const UPDATES: &str = "updates";

/// The page that a reader opens first.
const START: &str = "START-HERE.txt";

const START_HERE: &str = "\
wsg-bridge for the BOARD: a bridge between a PLC and a servo gripper of the WSG series.
It is not a safety device. It was tested in emulators only, never with a real board or a
real gripper.

With the board:
1. Open manual.html in any browser; no network is needed.
2. Follow its first chapter, \"Quick start\", from the wiring to the first grip.
PROGRAMS
IMAGE
UPDATESmanual.html          the manual of this board
BOOKregisters.csv        all Modbus registers, coils and discrete inputs
wsg-bridge.eds       CANopen: device file for a master's tool
WSGB5555.gsd         PROFIBUS: device file for a master's tool
WSGB5555.zip         the same file with its bitmaps, for installation
GSDML-WSG.zip        PROFINET: the virtual gripper (wsg-sim) for a controller's tool;
                     in TIA Portal's catalogue under Other field devices ->
                     PROFINET IO -> I/O -> Weiss Robotics GmbH & Co. KG
wsg-ethernetip.eds   EtherNet/IP: the virtual gripper and wsg gateway, for a scanner's tool
FB_WSG_GRIP.st       a function block in IEC 61131-3 structured text
PRG_WSG_MODBUS.st    a program that connects it to Modbus registers
PRG_WSG_DEMO.st      the demo cycle of Weiss Robotics' fieldbus manual for the WSG (appendix D)
wsg-blocks.xml       the three blocks as PLCopen XML, for CODESYS and TwinCAT
wsg-blocks.scl       the three blocks as SCL source, for TIA Portal
wsg-blocks.L5X       a project with FB_WSG_GRIP and the gripper on EtherNet/IP, for Studio 5000
LICENCES.txt         third-party parts of the firmware and their licences
SHA256SUMS           checksums of these files: sha256sum -c SHA256SUMS
";

/// Lines about the programs.
const PROGRAMS: &str = "
Without the board, see a gripper cycle on this computer. In a terminal in this folder:
   Windows           .\\windows\\wsg.exe demo
   Linux             ./linux/wsg demo
Then open http://127.0.0.1:8080/ in a browser. Ctrl-C ends it.

windows/, linux/     wsg: settings and state of the bridge, and commands to a gripper
                     wsg-sim: a virtual gripper
";

/// Lines about updates.
const UPDATES_LINES: &str = "\
updates/             signed firmware for a board with a boot loader, and its installation
                     (manual.html, \"Updates\")
";

/// Lines about the book.
const BOOK: &str = "\
book/index.html      all pages, with those about the virtual gripper, Python, C and the tool wsg
book.pdf             the same pages for printing
";

/// Builds what a release consists of
#[derive(Parser)]
enum Arguments {
    Folder(Folder),
    Release(release::Arguments),
    Api(api::Arguments),
    Book(book::Arguments),
}

/// Builds the folder for PLC engineers
#[derive(clap::Args)]
struct Folder {
    /// Firmware image
    #[arg(long, value_name = "IMAGE")]
    elf: PathBuf,
    /// Board of the image
    #[arg(long, value_name = "NAME", value_parser = Board::named, default_value = Board::default_name())]
    board: &'static Board,
    /// Builds the book and adds it
    #[arg(long)]
    book: bool,
    /// Folder to write
    #[arg(long, value_name = "FOLDER")]
    to: PathBuf,
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse() {
        Arguments::Folder(folder) => run(&folder),
        Arguments::Release(release) => release::run(&release),
        Arguments::Api(api) => api::run(&api),
        Arguments::Book(_) => book::build(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(Folder { elf, board, book, to }: &Folder) -> Result<()> {
    let elf = fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let book = if *book { book::build().and_then(|()| book::files())? } else { Vec::new() };
    write(to, &contents(board, elf, book)?)?;
    println!("{}", to.display());
    Ok(())
}

/// Returns the named files and `more`, the book or programs, with the checksums last.
fn contents(board: &Board, elf: Vec<u8>, more: Vec<(String, Vec<u8>)>) -> Result<Vec<(String, Vec<u8>)>> {
    let has = |folder: &str| more.iter().any(|(name, _)| name.starts_with(folder));
    let start = start_here(board, has("book"), has(LINUX), has(UPDATES));
    let mut single = vec![
        (START, start.replace('\n', "\r\n").into_bytes()),
        ("wsg-bridge.bin", footprint::bytes_of_flash(&elf)?),
        ("wsg-bridge.elf", elf),
        ("manual.html", manual::html(board, &linked())?.into_bytes()),
        (REGISTERS, register_map::csv().into_bytes()),
        ("LICENCES.txt", provenance::licences(&[&board.selection()])?.into_bytes()),
    ];
    if board.takes_uf2 {
        let elf = &single[2].1;
        single.push(("wsg-bridge.uf2", footprint::uf2(elf)?));
    }
    let mut files: Vec<_> = single.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)).collect();
    for name in COPIED {
        files.push((
            name.to_owned(),
            fs::read(root().join("docs").join(name)).with_context(|| format!("docs/{name}"))?,
        ));
    }
    files.extend(device_archives::archives()?.into_iter().map(|(name, bytes)| (name.to_owned(), bytes)));
    files.extend(more);
    files.sort();
    files.push((SUMS.to_owned(), sums(&files).into_bytes()));
    Ok(files)
}

fn start_here(board: &Board, has_book: bool, has_programs: bool, has_updates: bool) -> String {
    let part = |has, part: &'static str| if has { part } else { "" };
    let start = START_HERE.replace("IMAGE", board.files).replace("BOOK", part(has_book, BOOK));
    let start = start.replace("PROGRAMS", part(has_programs, PROGRAMS));
    let start = start.replace("UPDATES", part(has_updates, UPDATES_LINES));
    start.replace("BOARD", BoardWiring::of(board).name)
}

/// Returns the checksums of these named files, as `sha256sum` prints them.
fn sums(files: &[(impl AsRef<str>, Vec<u8>)]) -> String {
    let mut sums = String::new();
    for (name, bytes) in files {
        let sum: String = Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect();
        sums.push_str(&format!("{sum}  {}\n", name.as_ref()));
    }
    sums
}

/// Replaces the contents of the folder with these files.
fn write(folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
    if folder.exists() {
        ensure!(
            folder.join(SUMS).exists(),
            "{} was not created by this program; expected a new folder or one with SHA256SUMS",
            folder.display()
        );
        fs::remove_dir_all(folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for (name, bytes) in files {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap_or(folder))?;
        fs::write(path, bytes).with_context(|| format!("cannot write {name}"))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use device_archives::{GSD_ARCHIVE, GSDML_ARCHIVE};

    #[test]
    fn folder_holds_the_files_and_nothing_from_before() {
        let folder = std::env::temp_dir().join(format!("wsg-dist-{}", std::process::id()));
        let file = |name: &str| (name.to_owned(), b"1".to_vec());
        write(&folder, &[file("old"), file(SUMS)]).unwrap();
        write(&folder, &[file("new")]).unwrap();
        // A folder without checksums may belong to someone else.
        let refused = write(&folder, &[file(SUMS)]).is_err();
        let left: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().file_name()).collect();

        fs::remove_dir_all(&folder).unwrap();
        assert_eq!(left, ["new"]);
        assert!(refused);
    }

    #[test]
    fn first_page_names_every_file_on_one_screen() {
        let start = start_here(&boards::BOARDS[0], true, true, true);
        for name in linked().into_iter().chain([GSD_ARCHIVE, GSDML_ARCHIVE]) {
            assert!(start.contains(&format!("\n{name} ")), "{name}");
        }
        assert!(start.lines().count() <= 45 && start.lines().all(|line| line.len() <= 100), "{start}");
    }
}
