//! The boot loader of a board in QEMU: it starts a signed image in slot A, and stays in the safe state with a damaged one.
//!
//! QEMU's flash cannot be written, so slots and records keep their contents: no record, and nothing to exchange.

use std::fmt::Write;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use footprint::bytes_of_flash;
use host_tests::emulator::{Emulator, Extras};
use host_tests::rig::Rig;
use host_tests::trace::Trace;
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection};
use rustix::process::{Pid, Signal, kill_process};
use wsg_bridge_fw::io::Outputs;
use wsg_sim::Config;
use wsg_stm32::{Port, output_pins};
use wsg_update::sign::{SigningKey, file};
use wsg_update::{LENGTH_AT, Manifest, SIGNATURE_LEN, SLOT_LEN, Target, Version};

use super::Board;

const BOOT: &str = "WSG_BOOT_ELF";
const SLOT: &str = "WSG_SLOT_ELF";
const BOOT_AT: u32 = 0x0800_0000;
const SLOT_AT: u32 = 0x0800_8000;

/// Files of a test, removed at its end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("wsg-boot-{test}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    /// Writes a file of the bytes at an address. Returns QEMU's option that loads it.
    fn loader(&self, name: &str, address: u32, bytes: &[u8]) -> String {
        let path = self.0.join(name);
        fs::write(&path, intel_hex(address, bytes)).unwrap();
        format!("loader,file={}", path.display())
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Returns the bytes as an Intel HEX file, because QEMU limits the length of raw files.
fn intel_hex(address: u32, bytes: &[u8]) -> String {
    let mut text = String::new();
    let mut record = |kind: u8, offset: u16, data: &[u8]| {
        let [high, low] = offset.to_be_bytes();
        let record = [&[data.len() as u8, high, low, kind], data].concat();
        let sum = record.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
        let digits = record.iter().chain([&sum.wrapping_neg()]).fold(String::new(), |mut digits, byte| {
            let _ = write!(digits, "{byte:02X}");
            digits
        });
        text.push_str(&format!(":{digits}\n"));
    };
    for (line, at) in bytes.chunks(16).zip((address..).step_by(16)) {
        record(4, 0, &((at >> 16) as u16).to_be_bytes());
        record(0, at as u16, line);
    }
    record(1, 0, &[]);
    text
}

/// Returns the flash contents of an image for slot A, with zeros between its parts, as QEMU has them.
fn program(elf: &[u8]) -> Vec<u8> {
    let file = ElfFile32::<Endianness>::parse(elf).unwrap();
    let mut program = Vec::new();
    for header in file.elf_program_headers() {
        let (at, data) = (header.p_paddr.get(file.endian()), header.data(file.endian(), elf).unwrap());
        if let Some(at) = at.checked_sub(SLOT_AT).filter(|at| *at < SLOT_LEN && !data.is_empty()) {
            let end = at as usize + data.len();
            program.resize(end.max(program.len()), 0);
            program[at as usize..end].copy_from_slice(data);
        }
    }
    program
}

/// Returns the signed file of a board's image for slot A.
fn signed(board: &str, elf: &[u8]) -> Vec<u8> {
    let program = program(elf);
    let target = Target::of(board);
    let manifest = Manifest { target, version: Version([1, 0, 0]), length: 0, counter: 0, successor: None };
    file(&program, manifest, &SigningKey::from_bytes(&[2; 32])).unwrap()
}

fn name(board: Board) -> &'static str {
    if board.0.is_empty() { "b-l475e-iot01a" } else { "nucleo-g474re" }
}

/// The harness finds the firmware's symbols in the ELF file that it starts, so this is the signed image without its end.
fn boot_loader_starts_a_signed_image(board: Board) {
    let folder = Folder::new(name(board));
    let mut elf = fs::read(board.image(SLOT)).unwrap();
    let signed = signed(name(board), &elf);
    let table =
        object::File::parse(&*elf).unwrap().section_by_name(".vector_table").unwrap().file_range().unwrap();
    let length_at = table.0 as usize + LENGTH_AT;
    elf[length_at..length_at + 4].copy_from_slice(&signed[LENGTH_AT..LENGTH_AT + 4]);
    let image = folder.0.join("image.elf");
    fs::write(&image, &elf).unwrap();
    let end = program(&elf).len();
    let boot = bytes_of_flash(&fs::read(board.image(BOOT)).unwrap()).unwrap();
    let loaders = [
        folder.loader("boot.hex", BOOT_AT, &boot),
        folder.loader("end.hex", SLOT_AT + end as u32, &signed[end..]),
    ];
    let arguments = ["-device", &loaders[0], "-device", &loaders[1]];
    let extras = Extras { qemu_arguments: &arguments, ..Extras::default() };
    let emulator = Emulator::start_with(&image, extras).unwrap();
    let rig = Rig::of(emulator, None, Config::default(), Trace::new(vec![])).unwrap();
    let has_link = |outputs: Outputs| outputs.contains(Outputs::LINK_OK);
    rig.board().wait_outputs(host_tests::rig::PATIENCE, has_link).unwrap();
}

/// Returns the register and the value of a line of QEMU's trace of writes to this port.
fn write_to(line: &str, port: char) -> Option<(u32, u32)> {
    let rest = line.strip_prefix(&format!("stm32l4x5_gpio_write GPIO{port} "))?;
    let mut numbers = rest.split("0x").skip(1).map(|number| {
        let digits = number.split(|char: char| !char.is_ascii_hexdigit()).next().unwrap_or_default();
        u32::from_str_radix(digits, 16).unwrap()
    });
    numbers.next().zip(numbers.next())
}

fn damaged_image_stays_in_the_boot_loader_with_outputs_low(board: Board) {
    let folder = Folder::new(&format!("damaged-{}", name(board)));
    let mut file = signed(name(board), &fs::read(board.image(SLOT)).unwrap());
    let at = file.len() - SIGNATURE_LEN - 1_000;
    file[at] ^= 1;
    // `timeout` ends QEMU even if it writes nothing, and forwards the signal below.
    let mut run = Command::new("timeout")
        .args(["60", "qemu-system-arm", "-M", "b-l475e-iot01a", "-display", "none", "-monitor", "none"])
        .args(board.in_qemu().options)
        .args(["-trace", "stm32l4x5_gpio_write", "-kernel"])
        .arg(board.image(BOOT))
        .args(["-device", &folder.loader("slot.hex", SLOT_AT, &file)])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let (led, pin) = board.in_qemu().indicator;
    let (port, outputs) = (board.in_qemu().output_port, output_pins(board.in_qemu().outputs));
    // BSRR: bits that set pins.
    let set =
        |line: &str, port: Port| write_to(line, port.letter()).filter(|(register, _)| *register == 0x18);
    let (mut flashes, mut high) = (0, Vec::new());
    for line in BufReader::new(run.stderr.take().unwrap()).lines().map_while(Result::ok) {
        flashes += u32::from(set(&line, led).is_some_and(|(_, value)| value == 1 << pin));
        high.extend(set(&line, port).filter(|(_, value)| value & u32::from(outputs) != 0));
        if flashes == 5 {
            break;
        }
    }
    let _ = kill_process(Pid::from_child(&run), Signal::TERM);
    run.wait().unwrap();
    assert_eq!(flashes, 5, "the LED does not blink");
    assert_eq!(high, [], "outputs are high");
}

on_every_board!(board_in_qemu =>
    boot_loader_starts_a_signed_image,
    damaged_image_stays_in_the_boot_loader_with_outputs_low,
);
