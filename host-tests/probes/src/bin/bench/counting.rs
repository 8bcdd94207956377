//! Counts instructions with SysTick.

use core::hint::black_box;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// Nanoseconds of machine time per tick at 4 MHz, and per instruction with `-icount shift=10`.
const TICK_NS: u32 = 250;
const INSTRUCTION_NS: u32 = 1024;

/// SysTick has 24 bits. A longer interval between two readings would be ambiguous.
const MASK: u32 = 0x00FF_FFFF;

/// Cost of two readings in ticks, measured once.
static LOOKING: AtomicU32 = AtomicU32::new(0);

pub(crate) struct Counter(());

/// A reading, in ticks of a clock that counts down.
#[derive(Clone, Copy)]
pub(crate) struct Moment(u32);

impl Counter {
    pub(crate) fn start(mut systick: SYST) -> Self {
        systick.set_clock_source(SystClkSource::Core);
        systick.set_reload(MASK);
        systick.clear_current();
        systick.enable_counter();
        let counter = Self(());
        let (before, after) = (counter.now(), counter.now());
        LOOKING.store(before.ticks_to(after), Ordering::Relaxed);
        counter
    }

    #[inline(always)]
    pub(crate) fn now(&self) -> Moment {
        now()
    }

    /// Returns the instructions of `work`.
    #[inline(always)]
    pub(crate) fn of<T>(&self, work: impl FnOnce() -> T) -> u32 {
        let before = self.now();
        black_box(work());
        let after = self.now();
        before.instructions_to(after)
    }

    /// Counts a known loop, so that a machine with another clock yields no figures.
    pub(crate) fn check(&self) {
        let counted = self.of(|| {
            // The first value and 100 times a subtraction and a branch.
            let mut left = 100_u32;
            // SAFETY: the code changes only its own register and the flags.
            unsafe { core::arch::asm!("2: subs {0}, #1", "bne 2b", inout(reg) left) };
            left
        });
        assert!(
            (200..=206).contains(&counted),
            "SysTick counts {counted} instead of 200 instructions: is this `-icount shift=10`?"
        );
    }
}

#[inline(always)]
pub(crate) fn now() -> Moment {
    Moment(SYST::get_current())
}

impl Moment {
    /// Returns the instructions from this reading to `later`, without the cost of the readings.
    pub(crate) fn instructions_to(self, later: Self) -> u32 {
        let ticks = self.ticks_to(later).saturating_sub(LOOKING.load(Ordering::Relaxed));
        // In units of 16 ns, so that no product of 24-bit ticks overflows.
        (ticks / 16 * TICK_NS + ticks % 16 * TICK_NS / 16 + INSTRUCTION_NS / 32) / (INSTRUCTION_NS / 16)
    }

    fn ticks_to(self, later: Self) -> u32 {
        self.0.wrapping_sub(later.0) & MASK
    }
}
