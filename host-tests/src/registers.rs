//! Peripherals that QEMU lacks: their registers are served from outside, by a model.
//!
//! Before each load and store in a model's addresses QEMU stops. The instruction at the program counter is decoded, the model
//! asked, the instruction skipped, and the machine runs on; its interrupts go in through qtest. An access takes a good tenth
//! of a millisecond; a peripheral that the firmware leaves alone costs nothing.
//!
//! Models live in the machine's time, which stands while the machine does. But where it goes on, its clock runs ahead of its
//! core, by as much as the host is busy. So from an interrupt on, until that is answered, only accesses take time: no FIFO
//! overruns because the host was slow, and that the firmware is quick enough for a bus is not shown here.

use std::collections::HashMap;
use std::fmt;
use std::ops::Range;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};

use crate::gdb::{CoreRegisters, Gdb};
use crate::load_store::{LoadStore, Move, Width};

/// A peripheral's registers, and what it does by itself.
pub trait RegisterModel: fmt::Debug + Send {
    /// Their addresses.
    fn addresses(&self) -> Range<u32>;

    /// The core loads.
    ///
    /// # Errors
    /// When a real one would have no answer, or this one has none.
    fn load(&mut self, address: u32, width: Width) -> Result<u32>;

    /// The core stores.
    ///
    /// # Errors
    /// When the model does not know what a real one would do.
    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()>;

    /// As [`load`](Self::load), of a peripheral that QEMU has and that this one changes.
    ///
    /// # Errors
    /// See there.
    fn load_through(&mut self, address: u32, width: Width, _machine: &mut dyn Machine) -> Result<u32> {
        self.load(address, width)
    }

    /// As [`store`](Self::store), of a peripheral that QEMU has and that this one changes.
    ///
    /// # Errors
    /// See there.
    fn store_through(
        &mut self,
        address: u32,
        width: Width,
        value: u32,
        _machine: &mut dyn Machine,
    ) -> Result<()> {
        self.store(address, width, value)
    }

    /// Time passes for it; not while an interrupt is unanswered.
    fn advance(&mut self, _time: Duration) {}

    /// The machine has run for so long since this was last said, and for no less.
    fn has_run(&mut self, _time: Duration) {}

    /// Its lines to the interrupt controller and their levels now.
    fn interrupts(&self) -> Vec<(u8, bool)> {
        Vec::new()
    }

    /// Whether it may reset the machine.
    fn is_watchdog(&self) -> bool {
        false
    }

    /// Whether it resets the machine now.
    fn resets_machine(&self) -> bool {
        false
    }

    /// The machine was reset.
    fn reset(&mut self) {}

    /// How the firmware is to hang from here on, after an access.
    fn derailment(&mut self) -> Option<Derailment> {
        None
    }
}

/// How firmware hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derailment {
    /// In a loop of its program; interrupts are served.
    Loop,
    /// In a loop with interrupts masked.
    Masked,
    /// In the handler of the next interrupt.
    Handler,
}

/// The machine beside gdb.
pub trait Machine {
    /// Sets the level of an interrupt line.
    ///
    /// # Errors
    /// When it has ended.
    fn set_interrupt(&mut self, line: u8, level: bool) -> Result<()>;

    /// Raises the interrupt that cannot be masked, once: it is taken before the next instruction.
    ///
    /// # Errors
    /// When it has ended.
    fn raise_nmi(&mut self) -> Result<()>;

    /// Reads a word, as the core would.
    ///
    /// # Errors
    /// When it has ended.
    fn load(&mut self, address: u32) -> Result<u32>;

    /// Writes a word, as the core would.
    ///
    /// # Errors
    /// When it has ended.
    fn store(&mut self, address: u32, value: u32) -> Result<()>;
}

/// SRAM2, which no firmware of this board uses: `b .`, and with interrupts masked; and a table of vectors to the first.
const LOOP_AT: u32 = 0x1000_0000;
const LOOP: u32 = 0xE7FE_E7FE;
const MASKED_LOOP_AT: u32 = LOOP_AT + 4;
const MASKED_LOOP: u32 = 0xE7FE_B672;
const VECTORS_AT: u32 = LOOP_AT + 0x200;
const VECTORS: u32 = 16 + 82;

/// The vector table's address (ARMv7-M, B3.2.5).
const VTOR: u32 = 0xE000_ED08;

/// SysTick's control register, and its bit that says that a millisecond has ended since it was last read (ARMv7-M, B3.3.3).
const SYST_CSR: u32 = 0xE000_E010;
const COUNTFLAG: u32 = 1 << 16;

/// How long the machine runs without a look at what its peripherals do by themselves.
const LOOK_AROUND: Duration = Duration::from_micros(250);

/// In which steps they go on, to see an interrupt in time: less than a CAN frame takes.
const STEP: Duration = Duration::from_micros(40);

/// By how much QEMU's clock runs ahead of its core where the machine goes on, on a host with time to spare.
const SLOW_START: Duration = Duration::from_micros(40);

const A_MILLISECOND: Duration = Duration::from_millis(1);

/// What an access and the instructions round it take.
const AN_ACCESS: Duration = Duration::from_micros(1);

/// SysTick's reload value and current value, and how many bytes the two are (ARMv7-M, B3.3).
const SYSTICK: (u32, usize) = (0xE000_E014, 8);

/// The interrupt control and state register, and its bit that says that SysTick's exception waits (ARMv7-M, B3.2.4).
const ICSR: (u32, usize) = (0xE000_ED04, 4);
const PENDSTSET: u32 = 1 << 26;

/// Serves models to a machine that stands, and has run nothing yet.
#[derive(Debug)]
pub struct Registers {
    gdb: Gdb,
    models: Vec<Box<dyn RegisterModel>>,
    /// Where the firmware counts the milliseconds of SysTick.
    milliseconds_at: u32,
    /// The firmware's instructions, which do not change.
    code: HashMap<u32, [u16; 2]>,
    /// The interrupt lines as they were last set.
    levels: HashMap<u8, bool>,
}

impl Registers {
    /// Watches the models' addresses. `milliseconds_at`: where the firmware counts the milliseconds of SysTick.
    ///
    /// # Errors
    /// When QEMU takes no watchpoint.
    pub fn new(mut gdb: Gdb, models: Vec<Box<dyn RegisterModel>>, milliseconds_at: u32) -> Result<Self> {
        for model in &models {
            let Range { start, end } = model.addresses();
            gdb.watch(start, end - start)?;
        }
        let (code, levels) = (HashMap::new(), HashMap::new());
        Ok(Self { gdb, models, milliseconds_at, code, levels })
    }

    /// Lets the machine run and serves it until it ends, which is an error.
    ///
    /// # Errors
    /// When the firmware accesses a model in a way that this does not understand or a model refuses, and when QEMU ends.
    pub fn serve(mut self, machine: &mut impl Machine) -> Result<()> {
        let has_watchdog = self.models.iter().any(|model| model.is_watchdog());
        self.gdb.run()?;
        let mut stopped_at = Duration::ZERO;
        loop {
            let mut passed = Duration::ZERO;
            let mut watched = Duration::ZERO;
            let mut looked = Instant::now();
            while !self.gdb.stops_within(LOOK_AROUND)? {
                // It sleeps, and its clock goes with the host's.
                let time = looked.elapsed();
                looked = Instant::now();
                passed += self.advance(time, machine)?;
                // Not all milliseconds are seen on a busy host. Those that are have passed.
                if has_watchdog && machine.load(SYST_CSR)? & COUNTFLAG != 0 {
                    watched += A_MILLISECOND;
                    self.models.iter_mut().for_each(|model| model.has_run(A_MILLISECOND));
                }
                if self.models.iter().any(|model| model.resets_machine()) {
                    self.gdb.interrupt()?;
                    self.reset_machine()?;
                    (stopped_at, passed, watched) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
                    self.gdb.run()?;
                }
            }
            let (registers, [milliseconds, systick, icsr]) =
                self.gdb.look([(self.milliseconds_at, 4), SYSTICK, ICSR])?;
            // Before the firmware has started its clock there is but the host's.
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
            self.gdb.run_from(&registers)?;
        }
    }

    /// Resets the machine, which stands, and the models.
    fn reset_machine(&mut self) -> Result<()> {
        self.gdb.reset_machine()?;
        self.models.iter_mut().for_each(|model| model.reset());
        Ok(())
    }

    /// Lets time pass for the models until an interrupt is raised; returns how much did.
    fn advance(&mut self, time: Duration, machine: &mut impl Machine) -> Result<Duration> {
        let mut passed = Duration::ZERO;
        while passed < time && !self.levels.values().any(|is_raised| *is_raised) {
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

    /// Does what the instruction at the program counter would have done; the registers behind it.
    fn access(&mut self, mut registers: CoreRegisters, machine: &mut impl Machine) -> Result<CoreRegisters> {
        let pc = registers.r[15];
        let code = self.code_at(pc)?;
        let access = LoadStore::decode(code, &registers.r);
        let access = access.with_context(|| format!("at {pc:#010X}, before an access to a peripheral"))?;
        let LoadStore { direction, width, address, register, write_back, len } = access;
        // Firmware that waits for a bit comes round.
        self.models.iter_mut().for_each(|model| model.advance(AN_ACCESS));
        let model = self.models.iter_mut().find(|model| model.addresses().contains(&address));
        let model = model
            .with_context(|| format!("{address:#010X} is no model's, but QEMU stopped at {pc:#010X}"))?;
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
        registers.xpsr = behind_one_instruction(registers.xpsr);
        Ok(registers)
    }

    fn code_at(&mut self, pc: u32) -> Result<[u16; 2]> {
        if let Some(code) = self.code.get(&pc) {
            return Ok(*code);
        }
        let bytes = self.gdb.read_memory(pc, 4)?;
        let [a, b, c, d] = bytes[..] else { unreachable!("as many as were asked for") };
        let code = [u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d])];
        self.code.insert(pc, code);
        Ok(code)
    }
}

/// Lets the firmware hang from here on.
fn derail(how: Derailment, registers: &mut CoreRegisters, machine: &mut impl Machine) -> Result<()> {
    machine.store(LOOP_AT, LOOP)?;
    machine.store(MASKED_LOOP_AT, MASKED_LOOP)?;
    match how {
        Derailment::Loop => registers.r[15] = LOOP_AT,
        Derailment::Masked => registers.r[15] = MASKED_LOOP_AT,
        Derailment::Handler => {
            // With the bit that says Thumb.
            (0..VECTORS).try_for_each(|n| machine.store(VECTORS_AT + 4 * n, LOOP_AT | 1))?;
            machine.store(VTOR, VECTORS_AT)?;
        }
    }
    Ok(())
}

/// xPSR after an instruction that changes no flag: one less remains of an IT block (ARMv7-M, A7.3.3).
fn behind_one_instruction(xpsr: u32) -> u32 {
    const IT: u32 = 0b11 << 25 | 0x3F << 10;
    let state = xpsr >> 25 & 0b11 | (xpsr >> 10 & 0x3F) << 2;
    let state = if state & 0b111 == 0 { 0 } else { state & 0xE0 | state << 1 & 0x1F };
    xpsr & !IT | (state & 0b11) << 25 | (state >> 2) << 10
}

/// Since SysTick was started, of which a millisecond is one turn; `None` before.
fn machine_time(milliseconds: &[u8], systick: &[u8], icsr: &[u8]) -> Option<Duration> {
    let word = |bytes: &[u8], at: usize| Some(u32::from_le_bytes(*bytes.as_chunks().0.get(at)?));
    let (reload, current) = (word(systick, 0)?, word(systick, 1)?);
    if reload == 0 {
        return None;
    }
    // The counter may have begun anew while its exception waits for other code to end.
    let is_late = word(icsr, 0)? & PENDSTSET != 0 && current > reload / 2;
    let ms = u64::from(word(milliseconds, 0)?) + u64::from(is_late);
    let ns = u64::from(reload.saturating_sub(current)) * 1_000_000 / u64::from(reload + 1);
    Some(Duration::from_millis(ms) + Duration::from_nanos(ns))
}

/// Refuses what is not as wide as a register.
///
/// # Errors
/// Says so.
pub fn ensure_word(address: u32, width: Width) -> Result<()> {
    ensure!(
        width == Width::Word && address.is_multiple_of(4),
        "the peripheral takes accesses of 32 bits, not of {} at {address:#010X}",
        8 * width.bytes()
    );
    Ok(())
}

#[cfg(test)]
mod tests;
