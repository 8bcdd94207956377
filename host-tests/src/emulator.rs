//! The firmware image on an emulated board: power, wiring and observation.
//!
//! Runs the ELF that is flashed. The image determines the board: an STM32 board in QEMU, or a Raspberry Pi Pico in
//! rp2040js under Node.js. Both have the same interface to the PLC's wires, the gripper's line, the bus and the
//! service port; lines are sockets. No code here sleeps, and every wait is bounded. To reset the board, drop the
//! [`Emulator`] and start another. The emulator always ends with the process that started it.
//!
//! [`Emulator::start_library`] runs the application without the firmware, for computers without an emulator.
//!
//! Models replace peripherals that QEMU lacks ([`Extras::models`]). The Pico's lines run at their bit rates, and its
//! time stops until a gripper on one of them has caught up ([`Emulator::clock`]). Not emulated: real time, bit rates
//! on QEMU's lines, and electrical levels.

mod library;
#[cfg(unix)]
mod output_port;
#[cfg(unix)]
mod qemu;
#[cfg(unix)]
mod rp2040;
#[cfg(unix)]
mod sockets;
#[cfg(unix)]
pub mod stm_board;
mod watch;

use std::fmt;
use std::fs::File;
use std::path::Path;
#[cfg(unix)]
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use wsg_bridge_fw::io::{Inputs, Outputs};

use self::library::{LIBRARY, Library};
#[cfg(unix)]
use self::qemu::{QEMU, Qemu};
#[cfg(unix)]
use self::rp2040::{NODE, Rp2040};
use self::watch::Watch;
use crate::can_bus::CanBus;
use crate::clock::Clock;
use crate::line_errors::LineError;
use crate::mcp2515::Mcp2515;
use crate::registers::{Derailment, RegisterModel};
use crate::socket::Socket;

/// Time limit on a very busy host. Normally an emulator starts within tens of milliseconds and answers faster still.
const PATIENCE: Duration = Duration::from_secs(60);

trait Chip: fmt::Debug + Send + Sync {
    /// Drives a single wire.
    fn set_input(&self, wire: Inputs, high: bool) -> Result<()>;

    fn readl(&self, _: u32) -> Result<u32> {
        bail!("{LIBRARY} has no registers; use an emulator")
    }

    fn read_memory(&self, _: u32, _: usize) -> Result<Vec<u8>> {
        bail!("{LIBRARY} has no memory of a board; use an emulator")
    }

    fn now_ms(&self) -> Result<u32>;

    /// Executes a command of `emulators/rp2040/main.js`. Returns the answer.
    fn command(&self, command: &str) -> Result<String> {
        bail!("only the Pico's emulator executes `{command}`; use a model")
    }
}

/// A line of a board on which errors can be injected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// The gripper's line, UART0 of the Pico.
    Gripper,
    /// The PLC's bus, UART1 of the Pico.
    Bus,
}

/// The far ends of a board's lines; `None` once taken.
#[derive(Debug)]
struct Lines {
    gripper: Option<Socket>,
    bus: Option<Socket>,
    service: Option<Socket>,
}

/// A running board. Dropping it switches the board off.
#[derive(Debug)]
pub struct Emulator {
    chip: Box<dyn Chip>,
    inputs: Mutex<Inputs>,
    lines: Lines,
    watch: Arc<Watch>,
    clock: Clock,
}

/// A failure of the power during an operation of the flash.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    /// Number of operations before.
    pub operations: u32,
    /// Whether half of the operation takes effect; otherwise nothing of it does.
    pub is_torn: bool,
}

/// Optional equipment of a board.
#[derive(Debug, Default)]
pub struct Extras<'a> {
    /// Destination of the firmware's semihosting output, a `defmt` log. Without it, firmware that uses semihosting
    /// locks up.
    pub semihosting: Option<File>,
    /// Models of peripherals that QEMU lacks. Excludes semihosting, because both need QEMU's standard output.
    pub models: Vec<Box<dyn RegisterModel>>,
    /// Additional QEMU arguments.
    pub qemu_arguments: &'a [&'a str],
    /// QEMU: the program that a boot loader starts, for its symbols.
    pub symbols: Option<&'a Path>,
    /// QEMU: time until the firmware runs, if that may take longer than usual.
    pub patience: Duration,
    /// Pico: the CAN bus of its MCP2515. Without it no chip is on the SPI.
    pub can: Option<CanBus<Mcp2515>>,
    /// Pico: file that stores the flash. Without it the flash is volatile.
    pub flash: Option<&'a Path>,
    /// Pico: a failure of the power.
    pub cut: Option<Cut>,
    /// Pico: initial value of every byte of RAM, 0 by default.
    pub ram: Option<u8>,
    /// Pico: whether the watchdog resets the board. Otherwise the emulator ends instead.
    pub may_reset: bool,
}

/// A simultaneous change of the wires to the PLC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputChange {
    /// Time of observation by the harness.
    pub at: Instant,
    /// All wires after the change.
    pub outputs: Outputs,
}

impl Emulator {
    /// Powers a board with the image `elf`, and returns when the firmware's main loop runs.
    ///
    /// All inputs are low, as with broken wires, so the firmware starts with FAST STOP requested.
    ///
    /// # Errors
    /// Fails with one line when the emulator is missing, does not start, or runs no firmware for this board.
    pub fn start(elf: &Path) -> Result<Self> {
        Self::start_with(elf, Extras::default())
    }

    /// Does the same as [`start`](Self::start), with `extras`.
    ///
    /// # Errors
    /// See [`start`](Self::start). Fails on Windows.
    #[cfg(not(unix))]
    pub fn start_with(_: &Path, _: Extras<'_>) -> Result<Self> {
        bail!("an emulator needs Unix sockets; use Linux or macOS")
    }

    /// Does the same as [`start`](Self::start), with `extras`.
    ///
    /// # Errors
    /// See [`start`](Self::start). Fails on Windows.
    #[cfg(unix)]
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

    /// Runs the bridge's library on this computer in place of a board. It has no bus and no service port.
    ///
    /// # Errors
    /// Fails when no socket can be created.
    pub fn start_library() -> Result<Self> {
        let watch = Arc::new(Watch::of(LIBRARY));
        let clock = Clock::of_machine();
        let (library, lines) = Library::start(&watch, &clock)?;
        Ok(Self { chip: Box::new(library), inputs: Mutex::new(Inputs::empty()), lines, watch, clock })
    }

    /// Returns the gripper's end of the line, or `None` if it has been taken.
    ///
    /// As on a wire, the firmware is not blocked by a missing reader. Unlike on a wire, bytes wait for the receiver
    /// and never overrun it. Dropping the end cuts the line permanently.
    pub fn take_gripper_line(&mut self) -> Option<Socket> {
        self.lines.gripper.take()
    }

    /// Returns the master's end of the bus; see [`take_gripper_line`](Self::take_gripper_line).
    ///
    /// Bytes pass as fast as the firmware accepts them. The host determines the pauses between them.
    pub fn take_modbus_line(&mut self) -> Option<Socket> {
        self.lines.bus.take()
    }

    /// Returns the end of the service port (USB on the real board); see [`take_modbus_line`](Self::take_modbus_line).
    pub fn take_service_line(&mut self) -> Option<Socket> {
        self.lines.service.take()
    }

    /// Returns the clock for a virtual gripper on one of the lines.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.clock.clone()
    }

    /// Drives all input wires. Changes are applied one after the other, in bit order.
    ///
    /// # Errors
    /// Fails when the emulator has ended.
    pub fn set_inputs(&self, inputs: Inputs) -> Result<()> {
        self.drive(|_| inputs)
    }

    /// Drives the given input wires and leaves the others unchanged.
    ///
    /// # Errors
    /// Fails when the emulator has ended.
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

    /// Returns the driven levels of the input wires.
    #[must_use]
    pub fn inputs(&self) -> Inputs {
        *lock(&self.inputs)
    }

    /// Returns the current levels of the output wires.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        lock(&self.watch.seen).outputs
    }

    /// Returns a channel with every change of the output wires since power-up. Each caller receives all changes. The
    /// channel closes when the emulator ends.
    #[must_use]
    pub fn output_changes(&self) -> Receiver<OutputChange> {
        self.watch.subscribe()
    }

    /// Waits until the output wires satisfy `wanted`, and returns them. Returns immediately if they do now.
    ///
    /// Short states may be missed; use [`output_changes`](Self::output_changes) for sequences.
    ///
    /// # Errors
    /// Fails after `timeout`, or when the emulator ends.
    pub fn wait_outputs(&self, timeout: Duration, wanted: impl Fn(Outputs) -> bool) -> Result<Outputs> {
        let seen = self.watch.wait(timeout, |seen| wanted(seen.outputs));
        seen.map(|seen| seen.outputs).with_context(|| {
            let names: Vec<&str> = self.outputs().iter_names().map(|(name, _)| name).collect();
            format!("the outputs did not reach the expected state; high outputs: [{}]", names.join(", "))
        })
    }

    /// Reads the 32-bit word at `address` in memory or a peripheral.
    ///
    /// # Errors
    /// Fails when the emulator has ended.
    pub fn readl(&self, address: u32) -> Result<u32> {
        self.ask(|chip| chip.readl(address))
    }

    /// Reads `len` bytes of memory starting at `address`.
    ///
    /// # Errors
    /// Fails when the emulator has ended.
    pub fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>> {
        self.ask(|chip| chip.read_memory(address, len))
    }

    /// Returns the firmware's clock: milliseconds since its main loop started. Waits based on it are independent of
    /// the host's speed.
    ///
    /// # Errors
    /// Fails when an image for QEMU has no symbols, or when the emulator has ended.
    pub fn now_ms(&self) -> Result<u32> {
        self.ask(|chip| chip.now_ms())
    }

    /// Pico: injects this error into every n-th byte received from now on; `None` ends the injection.
    ///
    /// # Errors
    /// Fails on any other board, or when the emulator has ended.
    pub fn set_line_error(&self, line: Line, error: Option<(LineError, u32)>) -> Result<()> {
        let error = error.map_or("none".into(), |(error, every)| format!("{error:?} {every}"));
        self.command(&format!("error {} {error}", line as u8)).map(drop)
    }

    /// Pico: makes the firmware hang after the main loop next feeds the watchdog.
    ///
    /// # Errors
    /// Fails on any other board, or when the emulator has ended.
    pub fn derail(&self, how: Derailment) -> Result<()> {
        self.command(&format!("derail {how:?}")).map(drop)
    }

    /// Pico: cuts the power at the operation of the flash after this number of others.
    ///
    /// # Errors
    /// Fails on any other board, or when the emulator has ended.
    pub fn cut_power_after(&self, operations: u32) -> Result<()> {
        self.command(&format!("cut {operations}")).map(drop)
    }

    /// Pico: returns the number of watchdog resets, and the time from the main loop's last turn to the last reset.
    ///
    /// # Errors
    /// Fails on any other board, or when the emulator has ended.
    pub fn watchdog_resets(&self) -> Result<(u32, Duration)> {
        let reported = self.command("resets")?;
        let (resets, micros) = reported.split_once(' ').context("expected two numbers")?;
        Ok((resets.parse()?, Duration::from_micros(micros.parse()?)))
    }

    fn command(&self, command: &str) -> Result<String> {
        self.ask(|chip| chip.command(&command.to_lowercase()))
    }

    fn ask<T>(&self, question: impl FnOnce(&dyn Chip) -> Result<T>) -> Result<T> {
        // A permanently stopped machine still answers requests.
        {
            let seen = lock(&self.watch.seen);
            ensure!(!seen.has_ended, "{}", seen.last_words());
        }
        question(&*self.chip).with_context(|| lock(&self.watch.seen).last_words())
    }
}

/// Returns whether this image is for the Pico, judged by its entry point.
#[cfg(unix)]
#[must_use]
pub fn is_for_pico(elf: &Path) -> bool {
    use object::Object;

    let entry = || Some(object::File::parse(&*std::fs::read(elf).ok()?).ok()?.entry());
    entry().is_some_and(|entry| rp2040::FLASH.contains(&entry))
}

/// Ignores poisoning: no lock here guards data that a panic could leave inconsistent.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
