//! Models of peripherals that QEMU lacks; their registers are served from outside.
//!
//! QEMU stops before each load and store in a model's address range. The instruction at the program counter is
//! decoded, the model performs the access, the instruction is skipped, and the machine resumes. Interrupts are raised
//! through qtest. An access takes about 0.1 ms; a peripheral that the firmware does not access costs nothing.
//!
//! Models follow the machine's time, which stops with the machine. On resuming, its clock runs ahead of its core by
//! an amount that depends on the host's load. Therefore, while an interrupt is pending or a model has unread data,
//! only accesses take time. A slow host causes no FIFO overrun, and this set-up does not show whether the firmware
//! keeps up with a bus.

use std::collections::HashMap;
use std::fmt;
use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};

use crate::gdb::{CoreRegisters, Gdb};
use crate::load_store::{LoadStore, Move, Width};

/// A peripheral: its registers and its autonomous behaviour.
pub trait RegisterModel: fmt::Debug + Send {
    /// Returns the address range of the registers.
    fn addresses(&self) -> Range<u32>;

    /// Handles a load of a word by the core.
    ///
    /// # Errors
    /// Fails when the real peripheral would fault or the model lacks the register.
    fn load(&mut self, address: u32) -> Result<u32> {
        bail!("a load of {address:#010X} needs the machine")
    }

    /// Handles a store of a word by the core.
    ///
    /// # Errors
    /// Fails when the real peripheral's reaction is not modelled.
    fn store(&mut self, address: u32, _value: u32) -> Result<()> {
        bail!("a store to {address:#010X} needs the machine")
    }

    /// Handles a load of any width, possibly by means of the machine, for example from a peripheral that QEMU has and that
    /// this model extends. By default, only aligned words are [loaded](Self::load).
    ///
    /// # Errors
    /// See [`load`](Self::load).
    fn load_through(&mut self, address: u32, width: Width, _: &mut dyn Machine) -> Result<u32> {
        ensure_word(address, width)?;
        self.load(address)
    }

    /// Handles a store of any width. By default, only aligned words are [stored](Self::store).
    ///
    /// # Errors
    /// See [`store`](Self::store).
    fn store_through(&mut self, address: u32, width: Width, value: u32, _: &mut dyn Machine) -> Result<()> {
        ensure_word(address, width)?;
        self.store(address, value)
    }

    /// Returns whether received data waits for the core, which suspends time as a pending interrupt does: a handler
    /// may clear the interrupt before the data is read.
    fn has_unread_data(&self) -> bool {
        false
    }

    /// Advances time. While an interrupt is pending or a model has unread data, only accesses do so.
    fn advance(&mut self, _time: Duration) {}

    /// Reports a lower bound of the time that the machine has run since the last call.
    fn has_run(&mut self, _time: Duration) {}

    /// Returns the interrupt lines and their current levels.
    fn interrupts(&self) -> Vec<(u8, bool)> {
        Vec::new()
    }

    /// Returns whether the model, which is a watchdog, resets the machine now; `None` for any other model.
    fn resets_machine(&self) -> Option<bool> {
        None
    }

    /// Handles a reset of the machine.
    fn reset(&mut self) {}

    /// Returns whether the core loads from QEMU's memory, and only its stores are served.
    fn loads_memory(&self) -> bool {
        false
    }

    /// Returns bytes to be written to QEMU's memory now, even to a ROM, and their addresses.
    fn take_written(&mut self) -> Vec<(u32, Vec<u8>)> {
        Vec::new()
    }

    /// Returns how the firmware is to hang after this access, if at all.
    fn derailment(&mut self) -> Option<Derailment> {
        None
    }
}

/// A way in which firmware hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derailment {
    /// In a loop with interrupts enabled.
    Loop,
    /// In a loop with interrupts masked.
    Masked,
    /// In the handler of the next interrupt.
    Handler,
}

/// Machine access in addition to GDB.
pub trait Machine {
    /// Sets the level of an interrupt line.
    ///
    /// # Errors
    /// Fails when the machine has ended.
    fn set_interrupt(&mut self, line: u8, level: bool) -> Result<()>;

    /// Raises a non-maskable interrupt once; it is taken before the next instruction.
    ///
    /// # Errors
    /// Fails when the machine has ended.
    fn raise_nmi(&mut self) -> Result<()>;

    /// Reads a word as the core would.
    ///
    /// # Errors
    /// Fails when the machine has ended.
    fn load(&mut self, address: u32) -> Result<u32>;

    /// Writes a word as the core would.
    ///
    /// # Errors
    /// Fails when the machine has ended.
    fn store(&mut self, address: u32, value: u32) -> Result<()>;
}

/// Unused SRAM2 holds `b .`, the same with interrupts masked, and a vector table that points to the first.
const LOOP_AT: u32 = 0x1000_0000;
const LOOP: u32 = 0xE7FE_E7FE;
const MASKED_LOOP_AT: u32 = LOOP_AT + 4;
const MASKED_LOOP: u32 = 0xE7FE_B672;
const VECTORS_AT: u32 = LOOP_AT + 0x200;
const VECTORS: u32 = 16 + 82;

/// Address of the vector table register (ARMv7-M, B3.2.5).
const VTOR: u32 = 0xE000_ED08;

/// SysTick control register, and its flag for a counted millisecond since the last read (ARMv7-M, B3.3.3).
const SYST_CSR: u32 = 0xE000_E010;
const COUNTFLAG: u32 = 1 << 16;

/// Longest time the machine runs before the models advance.
const LOOK_AROUND: Duration = Duration::from_micros(250);

/// Step in which the models advance, to raise interrupts in time: less than a CAN frame.
const STEP: Duration = Duration::from_micros(40);

/// Lead of QEMU's clock over its core after resuming, on an idle host.
const SLOW_START: Duration = Duration::from_micros(40);

const A_MILLISECOND: Duration = Duration::from_millis(1);

/// Duration of an access including the surrounding instructions.
const AN_ACCESS: Duration = Duration::from_micros(1);

/// SysTick's reload value and current value, and their length in bytes (ARMv7-M, B3.3).
const SYSTICK: (u32, usize) = (0xE000_E014, 8);

/// The interrupt control and state register and its flag for a pending SysTick exception (ARMv7-M, B3.2.4).
const ICSR: (u32, usize) = (0xE000_ED04, 4);
const PENDSTSET: u32 = 1 << 26;

/// Serves models to a machine that is stopped and has executed nothing yet.
#[derive(Debug)]
pub struct Registers {
    gdb: Gdb,
    models: Vec<Box<dyn RegisterModel>>,
    /// Address of the firmware's SysTick millisecond counter.
    milliseconds_at: u32,
    /// Words to store after a reset of the machine, which QEMU would otherwise not complete.
    after_reset: &'static [(u32, u32)],
    /// Cached instructions of the firmware, which are constant.
    code: HashMap<u32, [u16; 2]>,
    /// Last level of each interrupt line.
    levels: HashMap<u8, bool>,
}

impl Registers {
    /// Watches the models' addresses. `milliseconds_at` is the address of the firmware's SysTick millisecond counter;
    /// `after_reset` are addresses and words to store after a reset of the machine.
    ///
    /// # Errors
    /// Fails when QEMU rejects a watchpoint.
    pub fn new(
        mut gdb: Gdb,
        models: Vec<Box<dyn RegisterModel>>,
        milliseconds_at: u32,
        after_reset: &'static [(u32, u32)],
    ) -> Result<Self> {
        for model in &models {
            let Range { start, end } = model.addresses();
            gdb.watch(start, end - start, model.loads_memory())?;
        }
        let (code, levels) = (HashMap::new(), HashMap::new());
        Ok(Self { gdb, models, milliseconds_at, after_reset, code, levels })
    }

    /// Runs and serves the machine until it ends, which is an error.
    ///
    /// # Errors
    /// Fails when an access is not understood or a model rejects it, and when QEMU ends.
    pub fn serve(mut self, machine: &mut impl Machine) -> Result<()> {
        let has_watchdog = self.models.iter().any(|model| model.resets_machine().is_some());
        self.gdb.run()?;
        let mut stopped_at = Duration::ZERO;
        loop {
            let mut passed = Duration::ZERO;
            let mut watched = Duration::ZERO;
            let mut looked = Instant::now();
            while !self.gdb.stops_within(LOOK_AROUND)? {
                // The machine is asleep, so its clock follows the host's.
                let time = looked.elapsed();
                looked = Instant::now();
                passed += self.advance(time, machine)?;
                // A busy host misses some milliseconds. Each one observed has really passed.
                if has_watchdog && machine.load(SYST_CSR)? & COUNTFLAG != 0 {
                    watched += A_MILLISECOND;
                    self.models.iter_mut().for_each(|model| model.has_run(A_MILLISECOND));
                }
                if self.models.iter().any(|model| model.resets_machine() == Some(true)) {
                    self.gdb.interrupt()?;
                    self.reset_machine(machine)?;
                    (stopped_at, passed, watched) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
                    self.gdb.run()?;
                }
            }
            let (registers, [milliseconds, systick, icsr]) =
                self.gdb.look([(self.milliseconds_at, 4), SYSTICK, ICSR])?;
            // Before the firmware starts SysTick, only the host's clock is available.
            let now = machine_time(&milliseconds, &systick, &icsr).unwrap_or(stopped_at + looked.elapsed());
            self.advance(now.saturating_sub(stopped_at + SLOW_START + passed), machine)?;
            let unwatched = now.saturating_sub(stopped_at + watched);
            self.models.iter_mut().for_each(|model| model.has_run(unwatched));
            stopped_at = now;
            let mut registers = self.access(registers, machine)?;
            self.set_interrupts(machine)?;
            if let Some(how) = self.models.iter_mut().find_map(|model| model.derailment()) {
                derail(how, &mut registers, machine)?;
            }
            for (address, bytes) in self.models.iter_mut().flat_map(|model| model.take_written()) {
                self.gdb.write_memory(address, &bytes)?;
            }
            self.gdb.run_from(&registers)?;
        }
    }

    /// Resets the stopped machine and the models.
    fn reset_machine(&mut self, machine: &mut impl Machine) -> Result<()> {
        self.gdb.reset_machine()?;
        self.after_reset.iter().try_for_each(|(address, word)| machine.store(*address, *word))?;
        self.models.iter_mut().for_each(|model| model.reset());
        Ok(())
    }

    fn waits_for_core(&self) -> bool {
        let is_pending = self.levels.values().any(|is_raised| *is_raised);
        is_pending || self.models.iter().any(|model| model.has_unread_data())
    }

    /// Advances the models until the core has to react. Returns the elapsed time.
    fn advance(&mut self, time: Duration, machine: &mut impl Machine) -> Result<Duration> {
        let mut passed = Duration::ZERO;
        while passed < time && !self.waits_for_core() {
            let step = STEP.min(time - passed);
            self.models.iter_mut().for_each(|model| model.advance(step));
            passed += step;
            self.set_interrupts(machine)?;
        }
        Ok(passed)
    }

    fn set_interrupts(&mut self, machine: &mut impl Machine) -> Result<()> {
        for (line, level) in self.models.iter().flat_map(|model| model.interrupts()) {
            if self.levels.insert(line, level).unwrap_or(false) != level {
                machine.set_interrupt(line, level)?;
            }
        }
        Ok(())
    }

    /// Executes the load or store at the program counter on a model. Returns the registers afterwards.
    fn access(&mut self, mut registers: CoreRegisters, machine: &mut impl Machine) -> Result<CoreRegisters> {
        let pc = registers.r[15];
        let code = self.code_at(pc)?;
        let access = LoadStore::decode(code, &registers.r);
        let access = access.with_context(|| format!("at {pc:#010X}, before an access to a peripheral"))?;
        let LoadStore { direction, width, address, register, write_back, len } = access;
        // Firmware that polls a bit must make progress.
        self.models.iter_mut().for_each(|model| model.advance(AN_ACCESS));
        let model = self.models.iter_mut().find(|model| model.addresses().contains(&address));
        let model = model.with_context(|| {
            format!("QEMU stopped at {pc:#010X} for {address:#010X}, which belongs to no model")
        })?;
        if let Some((base, after)) = write_back {
            registers.r[base] = after;
        }
        match direction {
            Move::Load { .. } => {
                let value = model.load_through(address, width, machine);
                let value = value.with_context(|| format!("load of {address:#010X} at {pc:#010X}"))?;
                registers.r[register] = access.loaded(value);
            }
            Move::Store => {
                let value = width.of(registers.r[register]);
                let stored = model.store_through(address, width, value, machine);
                stored.with_context(|| format!("store of {value:#X} to {address:#010X} at {pc:#010X}"))?;
            }
        }
        registers.r[15] = pc.wrapping_add(len);
        registers.xpsr = after_one_instruction(registers.xpsr);
        Ok(registers)
    }

    fn code_at(&mut self, pc: u32) -> Result<[u16; 2]> {
        if let Some(code) = self.code.get(&pc) {
            return Ok(*code);
        }
        let bytes = self.gdb.read_memory(pc, 4)?;
        let [a, b, c, d] = bytes[..] else { unreachable!("four bytes were requested") };
        let code = [u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])];
        self.code.insert(pc, code);
        Ok(code)
    }
}

/// Makes the firmware hang from here on.
fn derail(how: Derailment, registers: &mut CoreRegisters, machine: &mut impl Machine) -> Result<()> {
    machine.store(LOOP_AT, LOOP)?;
    machine.store(MASKED_LOOP_AT, MASKED_LOOP)?;
    match how {
        Derailment::Loop => registers.r[15] = LOOP_AT,
        Derailment::Masked => registers.r[15] = MASKED_LOOP_AT,
        Derailment::Handler => {
            // With the Thumb bit.
            (0..VECTORS).try_for_each(|n| machine.store(VECTORS_AT + 4 * n, LOOP_AT | 1))?;
            machine.store(VTOR, VECTORS_AT)?;
        }
    }
    Ok(())
}

/// Returns xPSR after an instruction that changes no flag: the IT block advances by one (ARMv7-M, A7.3.3).
fn after_one_instruction(xpsr: u32) -> u32 {
    const IT: u32 = 0b11 << 25 | 0x3F << 10;
    let state = xpsr >> 25 & 0b11 | (xpsr >> 10 & 0x3F) << 2;
    let state = if state & 0b111 == 0 { 0 } else { state & 0xE0 | state << 1 & 0x1F };
    xpsr & !IT | (state & 0b11) << 25 | (state >> 2) << 10
}

/// Returns the time since SysTick started, which counts one millisecond per period; `None` before the start.
fn machine_time(milliseconds: &[u8], systick: &[u8], icsr: &[u8]) -> Option<Duration> {
    let word = |bytes: &[u8], at: usize| Some(u32::from_le_bytes(*bytes.as_chunks().0.get(at)?));
    let (reload, current) = (word(systick, 0)?, word(systick, 1)?);
    if reload == 0 {
        return None;
    }
    // The counter may have wrapped while its exception is still pending.
    let is_late = word(icsr, 0)? & PENDSTSET != 0 && current > reload / 2;
    let ms = u64::from(word(milliseconds, 0)?) + u64::from(is_late);
    let ns = u64::from(reload.saturating_sub(current)) * 1_000_000 / u64::from(reload + 1);
    Some(Duration::from_millis(ms) + Duration::from_nanos(ns))
}

/// Rejects accesses that are not a full register wide.
///
/// # Errors
/// Fails for anything but an aligned word.
pub fn ensure_word(address: u32, width: Width) -> Result<()> {
    ensure!(
        width == Width::Word && address.is_multiple_of(4),
        "the peripheral takes accesses of 32 bits, not of {} at {address:#010X}",
        8 * width.bytes()
    );
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests;
