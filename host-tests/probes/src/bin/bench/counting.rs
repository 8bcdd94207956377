//! Instructions by SysTick.

use core::hint::black_box;
use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;

/// Nanoseconds of the machine's time: of a tick at 4 MHz, and of an instruction with `-icount shift=10`.
const TICK_NS: u32 = 250;
const INSTRUCTION_NS: u32 = 1024;

/// SysTick counts 24 bits; more ticks than this between two looks would be ambiguous.
const MASK: u32 = 0x00FF_FFFF;

/// What it costs to look twice, in ticks; found out once.
static LOOKING: AtomicU32 = AtomicU32::new(0);

/// The counter.
pub(crate) struct Counter(());

/// A moment, in ticks of a clock that counts down.
#[derive(Clone, Copy)]
pub(crate) struct Moment(u32);

impl Counter {
    /// Starts counting.
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

    /// This moment.
    #[inline(always)]
    pub(crate) fn now(&self) -> Moment {
        now()
    }

    /// Instructions that `work` takes.
    #[inline(always)]
    pub(crate) fn of<T>(&self, work: impl FnOnce() -> T) -> u32 {
        let before = self.now();
        black_box(work());
        let after = self.now();
        before.instructions_to(after)
    }

    /// Counts what is known, so that a machine with another clock gives no figures at all.
    pub(crate) fn check(&self) {
        let counted = self.of(|| {
            // 100 times a subtraction and a branch, and the first value.
            let mut left = 100_u32;
            // SAFETY: it changes nothing but its own register and the flags.
            unsafe { core::arch::asm!("2: subs {0}, #1", "bne 2b", inout(reg) left) };
            left
        });
        assert!(
            (200..=206).contains(&counted),
            "SysTick counts {counted} instead of 200 instructions: is this `-icount shift=10`?"
        );
    }
}

/// This moment.
#[inline(always)]
pub(crate) fn now() -> Moment {
    Moment(SYST::get_current())
}

impl Moment {
    /// Instructions from this moment to `later`, without those of looking.
    pub(crate) fn instructions_to(self, later: Self) -> u32 {
        let ticks = self.ticks_to(later).saturating_sub(LOOKING.load(Ordering::Relaxed));
        // 16 ticks are 64 instructions less than 2^24: no overflow below a million instructions.
        (ticks / 16 * TICK_NS + ticks % 16 * TICK_NS / 16 + INSTRUCTION_NS / 32) / (INSTRUCTION_NS / 16)
    }

    fn ticks_to(self, later: Self) -> u32 {
        self.0.wrapping_sub(later.0) & MASK
    }
}
