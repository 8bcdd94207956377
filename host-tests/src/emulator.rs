//! The firmware image on an emulated board: power it, wire it, watch it.
//!
//! The ELF that is flashed runs, and tells which board it is for: a B-L475E-IOT01A in QEMU, or a Raspberry Pi Pico in rp2040js
//! under Node.js. The PLC's wires, the gripper's line, the bus and the service port are the same for both; lines are sockets.
//! Nothing here sleeps, and every wait has a bound. To reset the board drop the [`Emulator`] and start another.
//!
//! The emulator ends with the process that started it, however that ends.
//!
//! Peripherals that QEMU's machine lacks are models, for those who want them ([`Extras::models`]); the Pico's lines run at their
//! rates, and its time stands until a gripper on one of them has come up to it ([`Emulator::clock`]). What nothing here shows are real time, baud rates on QEMU's lines and electrical levels.

mod output_port;
mod qemu;
mod rp2040;
mod sockets;
mod watch;

use std::fmt;
use std::fs::{self, File};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Child;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use object::Object;
use wsg_bridge_fw::io::{Inputs, Outputs};

use self::qemu::{QEMU, Qemu};
use self::rp2040::{NODE, Rp2040};
use self::watch::Watch;
use crate::can_bus::CanBus;
use crate::clock::Clock;
use crate::line_errors::LineError;
use crate::mcp2515::Mcp2515;
use crate::registers::{Derailment, RegisterModel};

/// An emulator starts in tens of milliseconds and answers in less; this is for a host that is very busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// A board in an emulator.
trait Chip: fmt::Debug + Send + Sync {
    /// Drives the one wire.
    fn set_input(&self, wire: Inputs, high: bool) -> Result<()>;

    fn readl(&self, address: u32) -> Result<u32>;

    fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>>;

    fn now_ms(&self) -> Result<u32>;

    fn set_line_error(&self, _line: Line, _error: Option<(LineError, u32)>) -> Result<()> {
        bail!("line errors of this board are a model beside it")
    }

    fn derail(&self, _how: Derailment) -> Result<()> {
        bail!("the watchdog of this board is a model beside it")
    }

    fn watchdog_resets(&self) -> Result<(u32, Duration)> {
        bail!("the watchdog of this board is a model beside it")
    }
}

/// A line of a board that errors can be on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The gripper's.
    Gripper,
    /// The PLC's bus.
    Bus,
}

/// The other ends of a board's lines, until they are taken.
#[derive(Debug)]
struct Lines {
    gripper: Option<UnixStream>,
    bus: Option<UnixStream>,
    service: Option<UnixStream>,
}

/// A running board. Dropping it switches it off.
#[derive(Debug)]
pub struct Emulator {
    chip: Box<dyn Chip>,
    inputs: Mutex<Inputs>,
    lines: Lines,
    watch: Arc<Watch>,
    clock: Clock,
}

/// What a board may have besides its wires.
#[derive(Debug, Default)]
pub struct Extras<'a> {
    /// Where the firmware's semihosting output goes, which is a `defmt` log; without it there is no
    /// semihosting, and a firmware that tries locks up.
    pub semihosting: Option<File>,
    /// Peripherals that QEMU lacks. Not together with semihosting: both take QEMU's standard output.
    pub models: Vec<Box<dyn RegisterModel>>,
    /// More arguments to QEMU.
    pub qemu_arguments: &'a [&'a str],
    /// Of the Pico: the CAN bus that its MCP2515 is on; without it there is no chip on its SPI.
    pub can: Option<CanBus<Mcp2515>>,
    /// Of the Pico: the file that keeps what the flash holds. Without it the flash is forgotten.
    pub flash: Option<&'a Path>,
    /// Of the Pico: what each byte of its RAM is when the power comes; without this 0.
    pub ram: Option<u8>,
    /// Of the Pico: its watchdog resets it; without this it ends then.
    pub may_reset: bool,
}

/// The wires to the PLC changed, all at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputChange {
    /// When the harness saw it.
    pub at: Instant,
    /// All wires after the change.
    pub outputs: Outputs,
}

impl Emulator {
    /// Powers a board with the image `elf`, and returns when the firmware's main loop runs.
    ///
    /// All inputs are low, that is, broken wires: the firmware boots with a FAST STOP wanted.
    ///
    /// # Errors
    /// When the emulator is missing, refuses to start, or runs no firmware for this board; one line says which.
    pub fn start(elf: &Path) -> Result<Self> {
        Self::start_with(elf, Extras::default())
    }

    /// [`start`](Self::start) with `extras`.
    ///
    /// # Errors
    /// See [`start`](Self::start).
    pub fn start_with(elf: &Path, extras: Extras<'_>) -> Result<Self> {
        let is_pico = is_for_pico(elf);
        let watch = Arc::new(Watch::of(if is_pico { NODE } else { QEMU }));
        let clock = if is_pico { Clock::of_machine() } else { Clock::wall() };
        let (chip, lines): (Box<dyn Chip>, Lines) = if is_pico {
            let (rp2040, lines) = Rp2040::start(elf, &extras, &watch, &clock)?;
            (Box::new(rp2040), lines)
        } else {
            let (qemu, lines) = Qemu::start(elf, extras, &watch)?;
            (Box::new(qemu), lines)
        };
        Ok(Self { chip, inputs: Mutex::new(Inputs::empty()), lines, watch, clock })
    }

    /// The gripper's end of the line: what the firmware sends comes out, what goes in it receives.
    /// `None` when it was taken before.
    ///
    /// As on a wire, nothing stops a firmware that nobody reads; other than on a wire, bytes wait
    /// for the receiver instead of overrunning it. Dropping the end cuts the line for good.
    pub fn take_gripper_line(&mut self) -> Option<UnixStream> {
        self.lines.gripper.take()
    }

    /// The master's end of the bus, as [`take_gripper_line`](Self::take_gripper_line) is the gripper's end of its line.
    ///
    /// Bytes come through as fast as the firmware takes them, and pauses between them as long as the host makes them.
    pub fn take_modbus_line(&mut self) -> Option<UnixStream> {
        self.lines.bus.take()
    }

    /// The service port, where the USB cable's end is on the board; otherwise as
    /// [`take_modbus_line`](Self::take_modbus_line).
    pub fn take_service_line(&mut self) -> Option<UnixStream> {
        self.lines.service.take()
    }

    /// The clock that a virtual gripper on one of its lines goes by.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.clock.clone()
    }

    /// Drives all input wires; those that change do so one after the other, in the order of their bits.
    ///
    /// # Errors
    /// When the emulator has ended.
    pub fn set_inputs(&self, inputs: Inputs) -> Result<()> {
        self.drive(|_| inputs)
    }

    /// Drives one input wire, or several, and leaves the others as they are.
    ///
    /// # Errors
    /// When the emulator has ended.
    pub fn set_input(&self, wires: Inputs, high: bool) -> Result<()> {
        self.drive(|driven| if high { driven | wires } else { driven - wires })
    }

    fn drive(&self, wanted: impl FnOnce(Inputs) -> Inputs) -> Result<()> {
        let mut driven = lock(&self.inputs);
        let wanted = wanted(*driven);
        let changing = *driven ^ wanted;
        for wire in changing.iter() {
            let high = wanted.contains(wire);
            self.ask(|chip| chip.set_input(wire, high))?;
            driven.set(wire, high);
        }
        Ok(())
    }

    /// The input wires as they are driven now.
    #[must_use]
    pub fn inputs(&self) -> Inputs {
        *lock(&self.inputs)
    }

    /// The output wires as they are now.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        lock(&self.watch.seen).outputs
    }

    /// Every change of the output wires since power-up, past ones first. Ends when the emulator does.
    ///
    /// Each caller gets all of them.
    #[must_use]
    pub fn output_changes(&self) -> Receiver<OutputChange> {
        self.watch.subscribe()
    }

    /// Waits until the output wires are as `wanted`; at once when they are now. Returns them.
    ///
    /// A state that is over before it is looked at is not seen; for sequences there is
    /// [`output_changes`](Self::output_changes).
    ///
    /// # Errors
    /// When `timeout` passes first, or the emulator ends.
    pub fn wait_outputs(&self, timeout: Duration, wanted: impl Fn(Outputs) -> bool) -> Result<Outputs> {
        let seen = self.watch.wait(timeout, |seen| wanted(seen.outputs));
        seen.map(|seen| seen.outputs).with_context(|| {
            let names: Vec<&str> = self.outputs().iter_names().map(|(name, _)| name).collect();
            format!("the outputs are not as wanted; high are [{}]", names.join(", "))
        })
    }

    /// Reads the 32-bit word at `address` in the board's memory, registers included.
    ///
    /// # Errors
    /// When the emulator has ended.
    pub fn readl(&self, address: u32) -> Result<u32> {
        self.ask(|chip| chip.readl(address))
    }

    /// Reads `len` bytes of the board's memory from `address` on.
    ///
    /// # Errors
    /// When the emulator has ended.
    pub fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>> {
        self.ask(|chip| chip.read_memory(address, len))
    }

    /// The firmware's clock: milliseconds since its main loop began.
    ///
    /// A wait for this to advance is one in the board's time, however slow the host is.
    ///
    /// # Errors
    /// When the image for QEMU has no symbols, or the emulator has ended.
    pub fn now_ms(&self) -> Result<u32> {
        self.ask(|chip| chip.now_ms())
    }

    /// Of the Pico: lets each n-th byte that arrives from now on have this error; `None`: the line is well.
    ///
    /// # Errors
    /// When this is another board, or the emulator has ended.
    pub fn set_line_error(&self, line: Line, error: Option<(LineError, u32)>) -> Result<()> {
        self.ask(|chip| chip.set_line_error(line, error))
    }

    /// Of the Pico: lets its firmware hang behind the next time that it feeds the watchdog, which is its main loop's.
    ///
    /// # Errors
    /// When this is another board, or the emulator has ended.
    pub fn derail(&self, how: Derailment) -> Result<()> {
        self.ask(|chip| chip.derail(how))
    }

    /// Of the Pico: how often its watchdog has reset it, and how long the last time came behind the main loop's last turn.
    ///
    /// # Errors
    /// When this is another board, or the emulator has ended.
    pub fn watchdog_resets(&self) -> Result<(u32, Duration)> {
        self.ask(|chip| chip.watchdog_resets())
    }

    fn ask<T>(&self, question: impl FnOnce(&dyn Chip) -> Result<T>) -> Result<T> {
        // A machine that stands for good would answer for ever.
        {
            let seen = lock(&self.watch.seen);
            ensure!(!seen.has_ended, "{}", seen.last_words());
        }
        question(&*self.chip).with_context(|| lock(&self.watch.seen).last_words())
    }
}

/// Whether this image is for the Pico, which its entry tells.
#[must_use]
pub fn is_for_pico(elf: &Path) -> bool {
    let entry = || Some(object::File::parse(&*fs::read(elf).ok()?).ok()?.entry());
    entry().is_some_and(|entry| rp2040::FLASH.contains(&entry))
}

fn end(process: &mut Child) {
    // An error means that it has ended already, which is what is wanted.
    let _ = process.kill();
    let _ = process.wait();
}

/// A lock that a panicking test held guards nothing that would be left half done.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
