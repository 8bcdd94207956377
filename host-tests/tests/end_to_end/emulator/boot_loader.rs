//! The boot loader of a board in QEMU: it starts a signed image in slot A, and stays in the safe state with a damaged one. With a
//! model of the flash, the firmware receives an image, and the boot loader exchanges the slots.

use std::fmt::Write;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use footprint::bytes_of_flash;
use host_tests::addresses::setting;
use host_tests::emulator::{Cut, Emulator, Extras};
use host_tests::extent;
use host_tests::flash_controller::FlashController;
use host_tests::modbus_master::Master;
use host_tests::registers::RegisterModel;
use host_tests::rig::{PATIENCE, Rig};
use host_tests::slot_flash::{Parts, SlotFlash};
use host_tests::trace::Trace;
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection};
use rustix::process::{Pid, Signal, kill_process};
use wsg_boot::Records;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::registers::{COMMAND_KEY, COMMANDS, FIRST_COMMAND};
use wsg_bridge_fw::storage::Progress;
use wsg_sim::Config;
use wsg_stm32::{Port, output_pins};
use wsg_update::sign::{SigningKey, file};
use wsg_update::{LENGTH_AT, Manifest, SIGNATURE_LEN, SLOT_LEN, Target, Version};

use super::{Board, RELEASED, wait_until};

const BOOT: &str = "WSG_BOOT_ELF";
const SLOT: &str = "WSG_SLOT_ELF";
const BOOT_AT: u32 = 0x0800_0000;
const SLOT_AT: u32 = 0x0800_8000;

/// Bytes of a request with file records.
const BLOCK_LEN: usize = 200;

/// Time for the exchange of the slots in QEMU.
const EXCHANGE_TIME: Duration = Duration::from_secs(900);

/// Bytes of a file of records.
const FILE_LEN: u32 = 20_000;

fn name(board: Board) -> &'static str {
    match board.0 {
        "" => "b-l475e-iot01a",
        "_NUCLEO" => "nucleo-g474re",
        _ => "pico",
    }
}

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
fn program(board: Board, elf: &[u8]) -> Vec<u8> {
    let slot = if board.1.is_some() { SLOT_AT } else { 0x1000_8000 };
    let file = ElfFile32::<Endianness>::parse(elf).unwrap();
    let mut program = Vec::new();
    for header in file.elf_program_headers() {
        let (at, data) = (header.p_paddr.get(file.endian()), header.data(file.endian(), elf).unwrap());
        if let Some(at) = at.checked_sub(slot).filter(|at| *at < SLOT_LEN && !data.is_empty()) {
            let end = at as usize + data.len();
            program.resize(end.max(program.len()), 0);
            program[at as usize..end].copy_from_slice(data);
        }
    }
    program
}

/// Returns the signed file of a board's image for slot A, with this patch level.
fn signed(board: Board, elf: &[u8], patch: u8) -> Vec<u8> {
    let program = program(board, elf);
    let target = Target::of(name(board));
    let version = Version([1, 0, patch]);
    let manifest = Manifest { target, version, length: 0, counter: 0, successor: None };
    file(&program, manifest, &SigningKey::from_bytes(&[2; 32])).unwrap()
}

/// A board with a boot loader and a signed image in slot A.
struct Plant {
    folder: Folder,
    board: Board,
    /// The program that starts, in which the harness finds symbols: of a board in QEMU the image, of the Pico the boot loader.
    elf: PathBuf,
    /// The length of the part of the ELF file in slot A.
    end: usize,
    old: Vec<u8>,
    new: Vec<u8>,
    flash: Flash,
}

/// Flash that survives a reset.
enum Flash {
    Qemu(FlashController),
    Pico(PathBuf),
}

impl Plant {
    fn new(board: Board, test: &str) -> Self {
        let folder = Folder::new(&format!("{test}-{}", name(board)));
        let mut elf = fs::read(board.image(SLOT)).unwrap();
        let [old, new] = [0, 1].map(|patch| signed(board, &elf, patch));
        let path = folder.0.join("image.elf");
        if board.1.is_none() {
            let file = folder.0.join("flash");
            fs::write(&file, vec![0xFF; 2 << 20]).unwrap();
            let flash = Flash::Pico(file);
            let plant = Self { folder, board, elf: board.image(BOOT), end: 0, old, new, flash };
            plant.install();
            return plant;
        }
        let file = object::File::parse(&*elf).unwrap();
        let (table, _) = file.section_by_name(".vector_table").unwrap().file_range().unwrap();
        let length_at = table as usize + LENGTH_AT;
        elf[length_at..length_at + 4].copy_from_slice(&old[LENGTH_AT..LENGTH_AT + 4]);
        fs::write(&path, &elf).unwrap();
        let flash = Flash::Qemu(FlashController::with_slots(&board.in_qemu().flash, &old));
        Self { folder, board, elf: path, end: program(board, &elf).len(), old, new, flash }
    }

    /// Writes the image to slot A, as over the drive. The harness does so for a board in QEMU at each start.
    fn install(&self) {
        if let Flash::Pico(file) = &self.flash {
            let mut flash = fs::read(file).unwrap();
            flash[0x8000..][..self.old.len()].copy_from_slice(&self.old);
            fs::write(file, flash).unwrap();
        }
    }

    /// Returns the content of slot A.
    fn slot_a(&self) -> Vec<u8> {
        match &self.flash {
            Flash::Qemu(flash) => flash.slots()[0].1.clone(),
            Flash::Pico(file) => fs::read(file).unwrap()[0x8000..].to_vec(),
        }
    }

    /// Starts the board, with a gripper and a master on the service port.
    fn power_up(&self) -> (Rig, Master) {
        let emulator = match &self.flash {
            Flash::Qemu(flash) => {
                flash.power_cycle();
                self.start_in_qemu(&flash.slots(), flash.models())
            }
            Flash::Pico(file) => self.start_pico(file, None).unwrap(),
        };
        let mut rig = Rig::of(emulator, None, Config::default(), Trace::new(vec![])).unwrap();
        await_link(&rig);
        let line = rig.board_mut().take_service_line().unwrap();
        let master = Master::new(line, rig.board().clock(), 1);
        (rig, master)
    }

    /// Starts the Pico; the power may fail after some operations of its flash.
    fn start_pico(&self, flash: &Path, cut: Option<Cut>) -> anyhow::Result<Emulator> {
        Emulator::start_with(&self.elf, Extras { flash: Some(flash), cut, ..Extras::default() })
    }

    fn start_in_qemu(&self, slots: &[(u32, Vec<u8>)], models: Vec<Box<dyn RegisterModel>>) -> Emulator {
        let boot = bytes_of_flash(&fs::read(self.board.image(BOOT)).unwrap()).unwrap();
        let mut loaders = vec![self.folder.loader("boot.hex", BOOT_AT, &boot)];
        for (address, bytes) in slots {
            // QEMU loads the image itself.
            let skipped = if *address == SLOT_AT { self.end } else { 0 };
            let name = format!("{address:X}.hex");
            loaders.push(self.folder.loader(&name, address + skipped as u32, &bytes[skipped..]));
        }
        let arguments: Vec<_> = loaders.iter().flat_map(|loader| ["-device", loader]).collect();
        let extras =
            Extras { qemu_arguments: &arguments, models, patience: EXCHANGE_TIME, ..Extras::default() };
        Emulator::start_with(&self.elf, extras).unwrap()
    }
}

/// Waits for the gripper: the boot loader and the firmware have started.
fn await_link(rig: &Rig) {
    rig.board().wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
}

fn boot_loader_starts_a_signed_image(board: Board) {
    let plant = Plant::new(board, "start");
    let emulator = plant.start_in_qemu(&[(SLOT_AT, plant.old.clone())], Vec::new());
    await_link(&Rig::of(emulator, None, Config::default(), Trace::new(vec![])).unwrap());
}

/// A file replaces the image over the service port, with the drivers of flash and boot loader that are delivered.
///
/// In QEMU, each access to the flash takes 0.1 ms, and the exchange minutes. So except in `cargo xtask ci`, the test ends after some
/// pages.
fn image_is_received_exchanged_and_confirmed(board: Board) {
    let plant = Plant::new(board, "update");
    let (rig, mut master) = plant.power_up();
    let report = |master: &mut Master, name: &str| master.report(name).unwrap();
    let halves = ["HIGH", "LOW"].map(|half| report(&mut master, &format!("UPDATE_BOARD_{half}")));
    let number = Target::of(name(board)).number();
    assert_eq!(halves, [(number >> 16) as u16, number as u16]);
    let is_whole = extent::is_whole() || matches!(plant.flash, Flash::Pico(_));
    let began = Instant::now();
    for (block, at) in plant.new.chunks(BLOCK_LEN).zip((0..).step_by(BLOCK_LEN)) {
        let [_, f, r1, r0] = ((at / FILE_LEN) << 16 | (at % FILE_LEN / 2)).to_be_bytes();
        let len = block.len() as u8;
        let pdu = [&[21, 7 + len, 6, 0, 1 + f, r1, r0, 0, len / 2], block].concat();
        assert_eq!(master.ask(&pdu).unwrap(), pdu, "{at}");
        if let (Flash::Qemu(flash), false, 5_000..) = (&plant.flash, is_whole, at) {
            assert!(flash.slots()[1].1.starts_with(&plant.new[..at as usize & !0xFF]));
            assert!(flash.violations().is_empty(), "{:?}", flash.violations());
            return;
        }
    }
    println!("transfer of {} bytes: {:.1?}", plant.new.len(), began.elapsed());
    master.write(command("UPDATE_CHECK"), &[COMMAND_KEY]).unwrap();
    let state = wait_until("the check to end", || report(&mut master, "UPDATE_STATE"), |state| *state != 2);
    assert_eq!((state, report(&mut master, "UPDATE_REFUSAL")), (3, 0));
    println!("with the check: {:.1?}", began.elapsed());
    master.write(command("UPDATE_RESTART"), &[COMMAND_KEY]).unwrap();
    // The emulator ends at the reset.
    wait_until("a reset", || rig.board().now_ms().is_err(), |ended| *ended);
    drop(rig);
    assert!(plant.slot_a().starts_with(&plant.old), "only the boot loader exchanges the slots");

    let began = Instant::now();
    let (rig, mut master) = plant.power_up();
    println!("start with the exchange: {:.1?}", began.elapsed());
    assert!(plant.slot_a().starts_with(&plant.new));
    let save = [&[6][..], &command("SAVE").to_be_bytes(), &COMMAND_KEY.to_be_bytes()].concat();
    assert_eq!(master.ask(&save).unwrap(), [0x86, 6], "on trial");
    wait_until("the confirmation", || master.ask(&save).unwrap(), |answer| answer[0] == 6);
    wait_until("the save to end", || report(&mut master, "SAVE_STATE"), |state| *state != 1);
    drop(rig);
    let (_rig, mut master) = plant.power_up();
    assert!(plant.slot_a().starts_with(&plant.new), "confirmed");
    assert_eq!(report(&mut master, "SETTINGS_FROM"), 1, "stored");
    if let Flash::Qemu(flash) = &plant.flash {
        assert!(flash.violations().is_empty(), "{:?}", flash.violations());
    }
}

fn command(name: &str) -> u16 {
    FIRST_COMMAND + COMMANDS.iter().position(|command| command.name == name).unwrap() as u16
}

/// The released image has no boot loader, and stores its settings at the same addresses.
fn settings_survive_the_installation_of_the_boot_loader(board: Board) {
    let plant = Plant::new(board, "install");
    let extras = match &plant.flash {
        Flash::Qemu(flash) => Extras { models: flash.models(), ..Extras::default() },
        Flash::Pico(file) => Extras { flash: Some(file), ..Extras::default() },
    };
    let mut rig = board.rig(RELEASED, extras, Config::default());
    let line = rig.board_mut().take_service_line().unwrap();
    let mut master = Master::new(line, rig.board().clock(), 1);
    master.write(setting("DEBOUNCE"), &[7]).unwrap();
    master.write(command("SAVE"), &[COMMAND_KEY]).unwrap();
    wait_until("the save to end", || master.report("SAVE_STATE").unwrap(), |state| *state == 2);
    drop(rig);

    plant.install();
    let (_rig, mut master) = plant.power_up();
    assert_ne!(master.report("UPDATE_BOARD_LOW").unwrap(), 0, "there is a boot loader");
    assert_eq!(master.report("SETTINGS_FROM").unwrap(), 1, "stored");
    assert_eq!(master.read(3, setting("DEBOUNCE"), 1).unwrap(), [7]);
}

/// Returns a program for slot A of the Pico that drives the outputs low, READY apart, and feeds the watchdog. It is as small as two
/// sectors, so the power can be cut at every operation of its exchange.
fn small_program(is_ready: bool, ready: u32, outputs: &[u32]) -> Vec<u8> {
    // Bits 5 and 8 of RESETS release the pins; function 5 of a pin is the register of levels (RP2040 data sheet, 2.14 and 2.19).
    let mut writes = vec![(0x4000_F000, 1 << 5 | 1 << 8)];
    writes.extend(outputs.iter().map(|gpio| (0x4001_4004 + 8 * gpio, 5)));
    let mask = outputs.iter().fold(0, |mask, gpio| mask | 1 << gpio);
    let level = if is_ready { 0xD000_0014 } else { 0xD000_0018 };
    writes.extend([(0xD000_0024, mask), (level, 1 << ready)]);
    // The longest time of the watchdog. The program repeats this store.
    writes.push((0x4005_8004, 0xFF_FFFF));
    const CODE_AT: usize = 0x100;
    let mut program = vec![0; CODE_AT];
    program[..4].copy_from_slice(&0x2004_0000_u32.to_le_bytes());
    program[4..8].copy_from_slice(&(0x1000_8000 + CODE_AT as u32 + 1).to_le_bytes());
    let pool_at = (CODE_AT + 6 * writes.len() + 2).next_multiple_of(4);
    for (number, _) in writes.iter().enumerate() {
        // `ldr r0, [pc, ...]`, `ldr r1, [pc, ...]`, `str r1, [r0]`
        for (load, word) in [(0x4800, 2 * number), (0x4900, 2 * number + 1)] {
            let from = (program.len() + 4) & !3;
            program.extend((load | ((pool_at + 4 * word - from) / 4) as u16).to_le_bytes());
        }
        program.extend(0x6001_u16.to_le_bytes());
    }
    // A branch to the last store.
    program.extend(0xE7FD_u16.to_le_bytes());
    program.resize(pool_at, 0);
    program.extend(
        writes.iter().flat_map(|(address, value)| [address, value]).flat_map(|word| word.to_le_bytes()),
    );
    program.resize(6_000, u8::from(is_ready) + 1);
    program
}

/// The exchange and the return of the previous image, with a power cut at each operation, which is left out or done by half. The
/// Pico's emulator has watchdog and boot ROM, and executes the boot loader in its time. Except in `cargo xtask ci`, one of some
/// operations is tested.
fn power_cuts_in_exchange_and_return_leave_the_old_or_the_new_image(board: Board) {
    let mut plant = Plant::new(board, "cuts");
    let outputs = wsg_pico::OUTPUTS.map(|wire| u32::from(wire.gpio));
    let ready = wsg_pico::OUTPUTS.iter().find(|wire| wire.signal == Outputs::READY).unwrap().gpio;
    let image = |patch: u8| {
        let program = small_program(patch == 1, ready.into(), &outputs);
        let version = Version([1, 0, patch]);
        let manifest =
            Manifest { target: Target::of(name(board)), version, length: 0, counter: 0, successor: None };
        file(&program, manifest, &SigningKey::from_bytes(&[2; 32])).unwrap()
    };
    [plant.old, plant.new] = [0, 1].map(image);
    plant.install();
    let Flash::Pico(file) = &plant.flash else { panic!("only the Pico's emulator cuts the power") };
    // As after a transfer: the new image in slot B, and a request in the records of its state.
    let mut flash = fs::read(file).unwrap();
    flash[0x10_0000..][..plant.new.len()].copy_from_slice(&plant.new);
    let requested = SlotFlash::<4096, 256>::new(1);
    let Parts { state, trust, .. } = &mut requested.parts();
    let mut records = Records::load(state, trust);
    records.request();
    while records.poll(state, trust, wsg_protocol::Instant::from_millis(0)) == Progress::Saving {}
    let pages = requested.content();
    for (page, at) in [(3, 0x1F_C000), (4, 0x1F_D000)] {
        let double_words = (0..512).flat_map(|index| pages.bits(page, index).to_le_bytes());
        flash[at..][..4096].copy_from_slice(&double_words.collect::<Vec<_>>());
    }
    // Starts the board, and returns whether the new image runs. Fails if none does.
    let start = |cut| plant.start_pico(file, cut).map(|emulator| emulator.outputs().contains(Outputs::READY));
    for (image, is_new) in [(&plant.new, true), (&plant.old, false)] {
        let mut operations = 0;
        for number in (0..).step_by(extent::step(29)) {
            fs::write(file, &flash).unwrap();
            let cut = Cut { operations: number, is_torn: number / extent::step(29) as u32 % 2 == 1 };
            if start(Some(cut)).is_ok() {
                break;
            }
            // The power is cut once more, unless the exchange has fewer operations left.
            let again = Cut { operations: 5, is_torn: !cut.is_torn };
            let runs = start(Some(again)).or_else(|_| start(None));
            let runs = runs.unwrap_or_else(|why| panic!("no image runs after {cut:?}: {why:#}"));
            assert_eq!(runs, is_new, "{cut:?}");
            assert!(plant.slot_a().starts_with(image), "{cut:?}");
            operations = number + 1;
        }
        println!("{operations} operations");
        assert!(operations > 50, "the exchange has only {operations} operations");
        // The next start returns the previous image, because this one did not confirm itself.
        flash = fs::read(file).unwrap();
    }
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
    let mut file = signed(board, &fs::read(board.image(SLOT)).unwrap(), 0);
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

mod updates {
    use super::*;

    on_every_board!(board =>
        image_is_received_exchanged_and_confirmed,
        settings_survive_the_installation_of_the_boot_loader,
    );

    #[test]
    #[ignore = "needs an emulator and the firmware images: run `cargo xtask test`"]
    fn power_cuts_in_exchange_and_return_leave_the_old_or_the_new_image() {
        super::power_cuts_in_exchange_and_return_leave_the_old_or_the_new_image(Board::PICO);
    }
}
