//! An image on painted memory, with a gripper and a bus, under worst-case load.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use host_tests::emulator::{Emulator, Extras, is_for_pico};
use host_tests::rig::Rig;
use host_tests::trace::Trace;
use host_tests::world::quick;
use object::{Object, ObjectSection, ObjectSymbol};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::{CommandId, FrameEncoder, Reply, Status};
use wsg_sim::Part;

/// Start of RAM on every board, and cortex-m-rt's symbol for its end, where the stack starts.
const RAM: u32 = 0x2000_0000;
const STACK_START: &str = "_stack_start";

/// A value that programs are unlikely to put on the stack.
const PAINT: u8 = 0xC5;

/// Bytes per read.
const CHUNK: u32 = 4096;

/// Returns the bytes of stack used by the image named by the first argument.
pub(crate) fn deepest_of_image() -> Result<u32> {
    let elf: PathBuf = std::env::args_os().nth(1).context("expected the path of an image")?.into();
    let stack = room_for_stack(&elf)?;
    let rig = if is_for_pico(&elf) {
        power_up(&elf, Extras { ram: Some(PAINT), ..Extras::default() })?
    } else {
        let paint = Paint::new(&stack)?;
        let loader = format!("loader,file={}", paint.path.display());
        power_up(&elf, Extras { qemu_arguments: &["-device", &loader], ..Extras::default() })?
    };

    worst(&rig)?;

    Ok(stack.end - deepest(&rig, &stack)?)
}

/// Time limit for every wait.
const PATIENCE: Duration = Duration::from_secs(60);

/// Holding time of a wire and arrival time of noise, in milliseconds of board time.
const HOLD_MS: u32 = 60;

fn power_up(elf: &Path, extras: Extras<'_>) -> Result<Rig> {
    Rig::of(Emulator::start_with(elf, extras)?, None, quick(), Trace::new(vec![]))
}

/// Holds a wire for longer than the rig does, because noise may be on the line.
fn pulse(rig: &Rig, wire: Inputs) -> Result<()> {
    for high in [true, false] {
        rig.set(wire, high)?;
        rig.pass(HOLD_MS)?;
    }
    Ok(())
}

fn wait(rig: &Rig, what: &str, wanted: impl Fn(Outputs) -> bool) -> Result<()> {
    rig.board()
        .wait_outputs(PATIENCE, wanted)
        .map(drop)
        .with_context(|| format!("timed out waiting for {what}"))
}

/// Starts a motion; it may fail, because only its use of the stack matters.
fn motion(rig: &Rig, wire: Inputs) -> Result<()> {
    wait(rig, "READY", |outputs| outputs.contains(Outputs::READY))?;
    pulse(rig, wire)
}

fn release_fast_stop(rig: &Rig) -> Result<()> {
    wait(rig, "LINK_OK", |outputs| outputs.contains(Outputs::LINK_OK))?;
    rig.set(Inputs::FAST_STOP_OK, true)?;
    rig.pass(HOLD_MS)?;
    pulse(rig, Inputs::STOP_ACK)
}

/// Applies the worst-case load: motions, faults, noise at every stage, line cut and restored, FAST STOP.
fn worst(rig: &Rig) -> Result<()> {
    release_fast_stop(rig)?;
    motion(rig, Inputs::HOME)?;
    for turn in 0..3_u8 {
        rig.gripper().set_part(if turn == 1 { None } else { Part::of_width(20.0) });
        noise(rig, turn)?;
        motion(rig, Inputs::GRIP)?;
        noise(rig, turn.wrapping_add(7))?;
        motion(rig, Inputs::RELEASE)?;
    }
    motion(rig, Inputs::MOVE)?;
    rig.board().set_input(Inputs::FAST_STOP_OK, false)?;
    noise(rig, 1)?;
    rig.gripper().cut(true);
    wait(rig, "no LINK_OK", |outputs| !outputs.contains(Outputs::LINK_OK))?;
    rig.gripper().cut(false);
    release_fast_stop(rig)?;
    motion(rig, Inputs::HOME)
}

/// Injects unsolicited answers, false preambles, wrong checksums around valid frames, and excessive lengths.
fn noise(rig: &Rig, seed: u8) -> Result<()> {
    for id in CommandId::ALL.iter().filter(|id| !matches!(id.code(), 0x40 | 0x41)) {
        for status in [Status::Success, Status::CmdPending, Status::AccessDenied] {
            let reply = Reply::status_only(*id, status);
            let mut bytes: Vec<u8> = FrameEncoder::new(id.code(), reply).collect();
            if id.code() % 3 == seed % 3
                && let Some(last) = bytes.last_mut()
            {
                *last ^= 0x40;
            }
            rig.gripper().inject(&bytes);
        }
    }
    for size in [0_u16, 1, 6, 66, 67, 1024, u16::MAX] {
        let [low, high] = size.to_le_bytes();
        rig.gripper().inject(&[0xAA, 0xAA, 0xAA, 0xAA, seed, low, high, 0xAA, 0xAA, 0xAA, 0x40, 6, 0]);
        rig.pass(30)?;
    }
    let inner: Vec<u8> = FrameEncoder::new(0x25, &[0, 0][..]).collect();
    let mut outer: Vec<u8> = FrameEncoder::new(0xAA, &inner.repeat(6)[..]).collect();
    if let Some(last) = outer.last_mut() {
        *last ^= 1;
    }
    rig.gripper().inject(&outer);
    rig.pass(HOLD_MS)
}

/// Returns the lowest overwritten address.
fn deepest(rig: &Rig, stack: &Range<u32>) -> Result<u32> {
    let mut address = stack.start;
    while address < stack.end {
        let length = CHUNK.min(stack.end - address);
        let bytes = rig.board().read_memory(address, length as usize)?;
        if let Some(at) = bytes.iter().position(|&byte| byte != PAINT) {
            ensure!(address + at as u32 > stack.start, "the stack has reached the static variables");
            return Ok(address + at as u32);
        }
        address += length;
    }
    anyhow::bail!("no byte of the stack was written: the image may not have started")
}

/// Returns the range between the static variables and the start of the stack.
fn room_for_stack(elf: &Path) -> Result<Range<u32>> {
    let image = fs::read(elf).with_context(|| format!("cannot read {}", elf.display()))?;
    let image = object::File::parse(&*image)?;
    let start = image.symbols().find(|symbol| symbol.name() == Ok(STACK_START));
    let start = start.with_context(|| format!("the image has no symbol {STACK_START}"))?.address();
    let ends = image.sections().map(|section| section.address() + section.size());
    let end = ends.filter(|end| (u64::from(RAM)..start).contains(end)).max();
    let end = u32::try_from(end.unwrap_or(RAM.into()))?.next_multiple_of(8);
    Ok(end..u32::try_from(start)?)
}

/// A file with paint for QEMU to load; removed on drop.
struct Paint {
    path: PathBuf,
}

impl Paint {
    /// Creates paint for this range, as an ELF file with one segment: QEMU loads raw files only on machines with
    /// configurable memory.
    fn new(&Range { start: first, end }: &Range<u32>) -> Result<Self> {
        const HEADERS: u32 = 52 + 32;
        let length = end - first;
        // Little endian, executable, Arm; one program header after this header, no sections.
        let ident = *b"\x7FELF\x01\x01\x01\0\0\0\0\0\0\0\0\0";
        let mut bytes = ident.to_vec();
        bytes.extend([2_u16, 40].map(u16::to_le_bytes).concat());
        bytes.extend([1_u32, 0, 52, 0, 0].map(u32::to_le_bytes).concat());
        bytes.extend([52_u16, 32, 1, 40, 0, 0].map(u16::to_le_bytes).concat());
        // A loadable segment: file offset, address (twice), length (twice), readable and writable.
        bytes.extend([1, HEADERS, first, first, length, length, 6, 8].map(u32::to_le_bytes).concat());
        bytes.resize((HEADERS + length) as usize, PAINT);
        let path = std::env::temp_dir().join(format!("wsg-paint-{}", std::process::id()));
        fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(Self { path })
    }
}

impl Drop for Paint {
    fn drop(&mut self) {
        // Failure is harmless: the directory is one for temporary files.
        let _ = fs::remove_file(&self.path);
    }
}
