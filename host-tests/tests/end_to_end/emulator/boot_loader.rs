//! The boot loader of a board in QEMU: it starts a signed image in slot A, and stays in the safe state with a damaged one. With a
//! model of the flash, the firmware receives an image, and the boot loader exchanges the slots.

use std::fmt::Write;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use host_tests::addresses::setting;
use host_tests::can_bus::Station;
use host_tests::can_wire::WireFrame;
use host_tests::emulator::stm_board::StmBoard;
use host_tests::emulator::{Cut, Emulator, Extras};
use host_tests::extent;
use host_tests::flash_controller::FlashController;
use host_tests::flash_pages::Tear;
use host_tests::mcp2515::Mcp2515;
use host_tests::modbus_master::Master;
use host_tests::registers::RegisterModel;
use host_tests::rig::{PATIENCE, Rig};
use host_tests::slot_flash::{Parts, SlotFlash};
use host_tests::trace::Trace;
use object::Endianness;
use object::read::elf::{ElfFile32, ProgramHeader};
use rustix::process::{Pid, Signal, kill_process};
use wsg_boot::Records;
use wsg_bridge_fw::PlcBus;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::registers::{COMMAND_KEY, COMMANDS, FIRST_COMMAND};
use wsg_bridge_fw::storage::Progress;
use wsg_sim::Config;
use wsg_stm32::{Port, output_pins};
use wsg_update::sign::{SigningKey, file};
use wsg_update::{Manifest, SIGNATURE_LEN, SLOT_LEN, Target, Version};

use super::can::CanBoard;
use super::{Board, RELEASED, wait_until};

const BOOT: &str = "WSG_BOOT_ELF";
const SLOT: &str = "WSG_SLOT_ELF";
const SLOT_AT: u32 = 0x0800_8000;

/// Bytes of a request with file records.
const BLOCK_LEN: usize = 200;

/// Bytes of the start of an image, in blocks.
const PART_LEN: usize = 26 * BLOCK_LEN;

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

/// Returns the signed file of a board's program for slot A, with this patch level.
fn signed(board: Board, program: &[u8], patch: u8) -> Vec<u8> {
    let target = Target::of(name(board));
    let version = Version([1, 0, patch]);
    let manifest = Manifest { target, version, length: 0, counter: 0, successor: None };
    file(program, manifest, &SigningKey::from_bytes(&[2; 32])).unwrap()
}

/// A board with a boot loader and a signed image in slot A.
struct Plant {
    folder: Folder,
    board: Board,
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
        let elf = fs::read(board.image(SLOT)).unwrap();
        Self::with(board, test, [0, 1].map(|patch| signed(board, &program(board, &elf), patch)))
    }

    /// Creates a board with the old one of these files, and the other for an update.
    fn with(board: Board, test: &str, [old, new]: [Vec<u8>; 2]) -> Self {
        let folder = Folder::new(&format!("{test}-{}", name(board)));
        let flash = if board.1.is_none() {
            let file = folder.0.join("flash");
            fs::write(&file, vec![0xFF; 2 << 20]).unwrap();
            Flash::Pico(file)
        } else {
            Flash::Qemu(FlashController::with_slots(&board.in_qemu().flash, &old, &[], &[]))
        };
        let plant = Self { folder, board, old, new, flash };
        plant.install();
        plant
    }

    /// Writes the image to slot A, as over the drive. A board in QEMU is created with it.
    fn install(&self) {
        if let Flash::Pico(file) = &self.flash {
            let mut flash = fs::read(file).unwrap();
            flash[0x8000..][..self.old.len()].copy_from_slice(&self.old);
            fs::write(file, flash).unwrap();
        }
    }

    /// Does what a transfer and its request do: the new image is in slot B, and the state of the boot loader requests it.
    fn request(&mut self) {
        match &mut self.flash {
            Flash::Qemu(flash) => {
                let state = requested::<2048, 8>();
                *flash =
                    FlashController::with_slots(&self.board.in_qemu().flash, &self.old, &self.new, &state);
            }
            Flash::Pico(file) => {
                let mut flash = fs::read(&file).unwrap();
                flash[0x10_0000..][..self.new.len()].copy_from_slice(&self.new);
                let state = requested::<4096, 256>();
                flash[0x1F_C000..][..state.len()].copy_from_slice(&state);
                fs::write(file, flash).unwrap();
            }
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
        Self::serve(self.start(None).unwrap())
    }

    fn serve(emulator: Emulator) -> (Rig, Master) {
        let mut rig = Rig::of(emulator, None, Config::default(), Trace::new(vec![])).unwrap();
        await_link(&rig);
        let line = rig.board_mut().take_service_line().unwrap();
        let master = Master::new(line, rig.board().clock(), 1);
        (rig, master)
    }

    /// Starts the board; the power may fail after some operations of its flash.
    fn start(&self, cut: Option<Cut>) -> anyhow::Result<Emulator> {
        match &self.flash {
            Flash::Qemu(flash) => {
                flash.power_cycle();
                if let Some(Cut { operations, is_torn }) = cut {
                    flash.cut(operations, if is_torn { Tear::Mixed } else { Tear::NotBegun });
                }
                self.start_in_qemu(&flash.slots(), flash.models())
            }
            Flash::Pico(file) => {
                let extras = Extras { flash: Some(file), cut, ..Extras::default() };
                Emulator::start_with(&self.board.image(BOOT), extras)
            }
        }
    }

    /// Cuts the power of the running board at the operation of its flash after this number of others.
    fn cut(&self, board: &Emulator, operations: u32) {
        match &self.flash {
            Flash::Qemu(flash) => flash.cut(operations, Tear::Mixed),
            Flash::Pico(_) => board.cut_power_after(operations).unwrap(),
        }
    }

    fn start_in_qemu(
        &self,
        slots: &[(u32, Vec<u8>)],
        models: Vec<Box<dyn RegisterModel>>,
    ) -> anyhow::Result<Emulator> {
        let loaders: Vec<_> = slots
            .iter()
            .map(|(address, bytes)| self.folder.loader(&format!("{address:X}.hex"), *address, bytes))
            .collect();
        let arguments: Vec<_> = loaders.iter().flat_map(|loader| ["-device", loader]).collect();
        let symbols = self.board.image(SLOT);
        let extras = Extras {
            qemu_arguments: &arguments,
            models,
            symbols: Some(&symbols),
            patience: EXCHANGE_TIME,
            ..Extras::default()
        };
        Emulator::start_with(&self.board.image(BOOT), extras)
    }
}

impl Flash {
    /// Returns other flash with the same content.
    fn copy(&self) -> Self {
        match self {
            Self::Qemu(flash) => Self::Qemu(flash.copy()),
            Self::Pico(file) => {
                let copy = PathBuf::from(format!("{}-", file.display()));
                fs::copy(file, &copy).unwrap();
                Self::Pico(copy)
            }
        }
    }
}

/// Returns the pages of the boot loader's state after a request.
fn requested<const PAGE: usize, const UNIT: usize>() -> Vec<u8> {
    let flash = SlotFlash::<PAGE, UNIT>::new(1);
    let Parts { state, trust, .. } = &mut flash.parts();
    let mut records = Records::load(state, trust);
    records.request();
    while records.poll(state, trust, wsg_protocol::Instant::from_millis(0)) == Progress::Saving {}
    let pages = flash.content();
    // One page of slot A and two of slot B are before them.
    let places = [3, 4].into_iter().flat_map(|page| (0..PAGE / 8).map(move |index| (page, index)));
    places.flat_map(|(page, index)| pages.bits(page, index).to_le_bytes()).collect()
}

/// Waits for the gripper: the boot loader and the firmware have started.
fn await_link(rig: &Rig) {
    rig.board().wait_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
}

fn boot_loader_starts_a_signed_image(board: Board) {
    let plant = Plant::new(board, "start");
    let emulator = plant.start_in_qemu(&[(SLOT_AT, plant.old.clone())], Vec::new()).unwrap();
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
    if let (Flash::Qemu(flash), false) = (&plant.flash, extent::is_whole()) {
        send_records(&mut master, &plant.new[..PART_LEN]).unwrap();
        assert!(flash.slots()[1].1.starts_with(&plant.new[..PART_LEN - BLOCK_LEN]));
        assert!(flash.violations().is_empty(), "{:?}", flash.violations());
        return;
    }
    let began = Instant::now();
    send_records(&mut master, &plant.new).unwrap();
    println!("transfer of {} bytes: {:.1?}", plant.new.len(), began.elapsed());
    check(&mut master);
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

/// Sends an image, or the start of one, as file records. Fails when the board does not answer.
fn send_records(master: &mut Master, bytes: &[u8]) -> anyhow::Result<()> {
    for (block, at) in bytes.chunks(BLOCK_LEN).zip((0..).step_by(BLOCK_LEN)) {
        let [_, f, r1, r0] = ((at / FILE_LEN) << 16 | (at % FILE_LEN / 2)).to_be_bytes();
        let len = block.len() as u8;
        let pdu = [&[21, 7 + len, 6, 0, 1 + f, r1, r0, 0, len / 2], block].concat();
        assert_eq!(master.ask(&pdu)?, pdu, "{at}");
    }
    Ok(())
}

/// Has a complete image checked, which is accepted.
fn check(master: &mut Master) {
    master.write(command("UPDATE_CHECK"), &[COMMAND_KEY]).unwrap();
    let state =
        wait_until("the check to end", || master.report("UPDATE_STATE").unwrap(), |state| *state != 2);
    assert_eq!((state, master.report("UPDATE_REFUSAL").unwrap()), (3, 0));
}

/// Downloads an image, or the start of one, to object 1F50h, subindex 1, in segments (CiA 301, 7.2.4.3).
fn download(station: &Station<Mcp2515>, image: &[u8], len: usize) {
    let ask = |request: [u8; 8]| {
        station.send(WireFrame::standard(0x610, &request));
        let is_answer = |frame: &WireFrame| frame.id == WireFrame::standard(0x590, &[]).id;
        let next = || station.received.recv_timeout(PATIENCE).expect("an answer must be sent");
        wait_until("the answer", next, is_answer).data
    };
    let [l0, l1, l2, l3] = (image.len() as u32).to_le_bytes();
    assert_eq!(ask([0x21, 0x50, 0x1F, 1, l0, l1, l2, l3])[..4], [0x60, 0x50, 0x1F, 1]);
    for (segment, number) in image[..len].chunks(7).zip(0..) {
        let toggle = u8::from(number % 2 == 1) << 4;
        let is_last = 7 * (number + 1) >= image.len();
        let mut request = [0; 8];
        request[0] = toggle | (7 - segment.len() as u8) << 1 | u8::from(is_last);
        request[1..1 + segment.len()].copy_from_slice(segment);
        assert_eq!(ask(request)[0], 0x20 | toggle, "segment {number}");
    }
}

/// The Pico receives an image over each transport, and accepts it. Prints the times of the board's clock as rows of a table. Except
/// in `cargo xtask ci` and `cargo xtask figures`, each transfer ends after some pages.
#[test]
#[ignore = "needs rp2040js and the firmware images: run `cargo xtask test`"]
fn each_transport_receives_an_image_in_rp2040js() {
    let plant = Plant::new(Board::PICO, "transports");
    let (image, is_whole) = (&plant.new, extent::is_whole());
    let len = if is_whole { image.len() } else { PART_LEN };
    let transfer = |master: &mut Master| {
        send_records(master, &image[..len]).unwrap();
        if is_whole {
            check(master);
        }
    };
    let measure = |transport: &str, rig: &Rig, transfer: &mut dyn FnMut()| {
        let began = rig.board().now_ms().unwrap();
        transfer();
        let seconds = f64::from(rig.board().now_ms().unwrap() - began) / 1e3;
        println!("| {transport} | {len} | {seconds:.1} s |");
    };

    let (rig, mut service) = plant.power_up();
    measure("service port", &rig, &mut || transfer(&mut service));
    drop(rig);
    let (mut rig, _) = plant.power_up();
    let mut bus = rig.master(1).unwrap();
    measure("Modbus RTU, 19 200 bit/s with parity", &rig, &mut || transfer(&mut bus));
    drop(rig);

    let (rig, mut service) = plant.power_up();
    store(&mut service, "PLC_BUS", PlcBus::Canopen as u16);
    drop(rig);
    let bus = Mcp2515::new_bus(500_000);
    let station = bus.join();
    let Flash::Pico(file) = &plant.flash else { unreachable!("the board is a Pico") };
    let extras = Extras { flash: Some(file), ..Mcp2515::extras(&bus) };
    let (rig, mut service) = Plant::serve(Emulator::start_with(&plant.board.image(BOOT), extras).unwrap());
    measure("CANopen, 500 kbit/s", &rig, &mut || download(&station, image, len));
    let received = ["HIGH", "LOW"].map(|half| service.report(&format!("UPDATE_BYTES_{half}")).unwrap());
    assert_eq!(usize::from(received[0]) << 16 | usize::from(received[1]), len);
}

/// Changes a setting, and stores it.
fn store(master: &mut Master, name: &str, value: u16) {
    master.write(setting(name), &[value]).unwrap();
    master.write(command("SAVE"), &[COMMAND_KEY]).unwrap();
    wait_until("the save to end", || master.report("SAVE_STATE").unwrap(), |state| *state == 2);
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
    store(&mut master, "DEBOUNCE", 7);
    drop(rig);

    plant.install();
    let (_rig, mut master) = plant.power_up();
    assert_ne!(master.report("UPDATE_BOARD_LOW").unwrap(), 0, "there is a boot loader");
    assert_eq!(master.report("SETTINGS_FROM").unwrap(), 1, "stored");
    assert_eq!(master.read(3, setting("DEBOUNCE"), 1).unwrap(), [7]);
}

/// Returns a program for a slot at this address that stores words at addresses, and repeats the last store. It is as small as two
/// pages of the flash, so its exchange has few operations.
fn small_program(slot: u32, writes: &[(u32, u32)], len: usize) -> Vec<u8> {
    const CODE_AT: usize = 0x100;
    let mut program = vec![0; CODE_AT];
    program[..4].copy_from_slice(&0x2000_4000_u32.to_le_bytes());
    program[4..8].copy_from_slice(&(slot + CODE_AT as u32 + 1).to_le_bytes());
    let pool_at = (CODE_AT + 6 * writes.len() + 2).next_multiple_of(4);
    for number in 0..writes.len() {
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
    let words = writes.iter().flat_map(|(address, value)| [address, value]);
    program.extend(words.flat_map(|word| word.to_le_bytes()));
    program.resize(len, 0xA5);
    program
}

/// Returns a small program that drives the outputs low, except perhaps READY, and feeds the watchdog.
fn indicator(board: Board, is_ready: bool) -> Vec<u8> {
    let Some(StmBoard { output_port, outputs, .. }) = board.1 else {
        let gpio = |wire: &wsg_pico::OutputWire| u32::from(wire.gpio);
        let outputs = &wsg_pico::OUTPUTS;
        let ready = outputs.iter().find(|wire| wire.signal == Outputs::READY).map(gpio).unwrap();
        let mask = outputs.iter().fold(0, |mask, wire| mask | 1 << gpio(wire));
        // Bits 5 and 8 of RESETS release the pins; function 5 of a pin is the register of levels (RP2040 data sheet, 2.14, 2.19).
        let mut writes = vec![(0x4000_F000, 1 << 5 | 1 << 8)];
        writes.extend(outputs.iter().map(|wire| (0x4001_4004 + 8 * gpio(wire), 5)));
        let level = if is_ready { 0xD000_0014 } else { 0xD000_0018 };
        // The last store is the longest time of the watchdog.
        writes.extend([(0xD000_0024, mask), (level, 1 << ready), (0x4005_8004, 0xFF_FFFF)]);
        return small_program(0x1000_8000, &writes, 6_000);
    };
    let port = 0x4800_0000 + 0x400 * (u32::from(output_port.letter()) - u32::from('A'));
    let ready = outputs.iter().find(|wire| wire.signal == Outputs::READY).unwrap().pin;
    let pins = u32::from(output_pins(outputs));
    // MODER: 01 is an output, 11 an analog pin (RM0351, 8.4.1). BSRR sets with its lower half, and resets with its upper half.
    let mode =
        (0..16).filter(|pin| pins >> pin & 1 == 1).fold(u32::MAX, |mode, pin| mode ^ 0b10 << (2 * pin));
    let levels = pins << 16 | if is_ready { 1 << ready } else { 0 };
    // The last store is the key that feeds the watchdog.
    let writes = [(0x4002_104C, 0xFF), (port, mode), (port + 0x18, levels), (0x4000_3000, 0xAAAA)];
    small_program(SLOT_AT, &writes, 2_500)
}

/// The exchange and the return of the previous image by the delivered boot loader, with power cuts at operations of the flash, which
/// are left out or torn. Another cut follows each. `cargo xtask ci` cuts at each operation of the Pico, whose emulator has watchdog
/// and boot ROM.
fn power_cuts_in_exchange_and_return_leave_the_old_or_the_new_image(board: Board) {
    let images = [0, 1].map(|patch| signed(board, &indicator(board, patch == 1), patch));
    let mut plant = Plant::with(board, "cuts", images);
    plant.request();
    // In QEMU, a start takes seconds, so the cuts are fewer: in short runs, one of the exchange alone.
    let (directions, first, step) = match plant.flash {
        Flash::Pico(_) => (2, 0, extent::step(29)),
        Flash::Qemu(_) if extent::is_whole() => (2, 0, 41),
        Flash::Qemu(_) => (1, 331, 1_000),
    };
    // Starts the board, and returns whether the new image runs. Fails if none does.
    let start =
        |plant: &Plant, cut| plant.start(cut).map(|emulator| emulator.outputs().contains(Outputs::READY));
    for is_new in [true, false].into_iter().take(directions) {
        let before = plant.flash.copy();
        let mut cuts = 0;
        for operations in (first..).step_by(step) {
            plant.flash = before.copy();
            let cut = Cut { operations, is_torn: cuts % 2 == 1 };
            if start(&plant, Some(cut)).is_ok() {
                break;
            }
            // The power is cut once more, unless the exchange has fewer operations left.
            let again = Cut { operations: 5, is_torn: !cut.is_torn };
            let runs = start(&plant, Some(again)).or_else(|_| start(&plant, None));
            let runs = runs.unwrap_or_else(|why| panic!("no image runs after {cut:?}: {why:#}"));
            assert_eq!(runs, is_new, "{cut:?}");
            let image = if is_new { &plant.new } else { &plant.old };
            assert!(plant.slot_a().starts_with(image), "{cut:?}");
            cuts += 1;
        }
        println!("{cuts} cuts, one in {step} operations");
        assert!(cuts > 0 && cuts * step > 50, "the exchange has at most {} operations", cuts * step);
        // The next start returns the previous image, because this one did not confirm itself.
    }
}

/// Power cuts while the firmware receives an image: the old one runs with its settings, and receives the image from its start.
fn power_cuts_in_a_transfer_leave_the_old_image(board: Board) {
    let plant = Plant::new(board, "transfer-cuts");
    let (mut rig, mut master) = plant.power_up();
    store(&mut master, "DEBOUNCE", 7);
    // The first operations write the state's record, which withdraws an earlier request, and the first page.
    let cuts: &[u32] = if extent::is_whole() { &[0, 1, 2, 3, 5, 8, 13, 20] } else { &[2] };
    for operations in cuts {
        plant.cut(rig.board(), *operations);
        thread::scope(|scope| {
            let transfer = scope.spawn(|| send_records(&mut master, &plant.new[..PART_LEN]));
            wait_until("the power cut", || rig.board().now_ms().is_err(), |is_cut| *is_cut);
            // The board's lines end.
            drop(rig);
            assert!(transfer.join().unwrap().is_err(), "after {operations} operations");
        });
        (rig, master) = plant.power_up();
        assert!(plant.slot_a().starts_with(&plant.old), "after {operations} operations");
        assert_eq!(master.read(3, setting("DEBOUNCE"), 1).unwrap(), [7], "after {operations} operations");
    }
    send_records(&mut master, &plant.new[..PART_LEN]).unwrap();
}

/// Power cuts while a new image confirms itself: it stays, or the previous one returns, which is final. Only in `cargo xtask ci`.
#[test]
#[ignore = "needs rp2040js and the firmware images: run `cargo xtask test`"]
fn power_cuts_in_the_confirmation_leave_the_old_or_the_new_image_in_rp2040js() {
    /// Time from the start of the firmware, in which it has confirmed itself.
    const TRIAL_MS: u32 = 15_000;
    if !extent::is_whole() {
        return;
    }
    for operations in 0.. {
        let mut plant = Plant::new(Board::PICO, "confirmation-cuts");
        plant.request();
        let (rig, _) = plant.power_up();
        assert!(plant.slot_a().starts_with(&plant.new), "on trial");
        plant.cut(rig.board(), operations);
        let now = || rig.board().now_ms().unwrap_or(u32::MAX);
        let end = now().saturating_add(TRIAL_MS);
        let is_cut = wait_until("the confirmation", now, |now| *now >= end) == u32::MAX;
        drop(rig);
        let runs_new = || {
            drop(plant.power_up());
            let (old, new) = (plant.slot_a().starts_with(&plant.old), plant.slot_a().starts_with(&plant.new));
            assert!(old != new, "slot A contains neither image after {operations} operations");
            new
        };
        let is_new = runs_new();
        assert_eq!(runs_new(), is_new, "after {operations} operations");
        println!("after {operations} operations: new {is_new}");
        if !is_cut {
            assert!(is_new && operations > 1, "{operations} operations");
            return;
        }
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
    let mut file = signed(board, &program(board, &fs::read(board.image(SLOT)).unwrap()), 0);
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
        power_cuts_in_a_transfer_leave_the_old_image,
        power_cuts_in_exchange_and_return_leave_the_old_or_the_new_image,
    );
}
