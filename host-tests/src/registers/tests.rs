//! Covers the two calculations whose errors would cause intermittent test failures: the IT state after a skipped
//! instruction, and the machine's time. All other errors fail in every emulated image.

use super::*;

/// A machine for tests of models, in which every word has this value. Counts NMIs and records stored values.
#[derive(Default)]
pub(crate) struct Core {
    pub(crate) word: u32,
    pub(crate) nmis: u32,
    pub(crate) stored: Vec<u32>,
}

impl Machine for Core {
    fn set_interrupt(&mut self, _: u8, _: bool) -> Result<()> {
        Ok(())
    }

    fn raise_nmi(&mut self) -> Result<()> {
        self.nmis += 1;
        Ok(())
    }

    fn load(&mut self, _: u32) -> Result<u32> {
        Ok(self.word)
    }

    fn store(&mut self, _: u32, value: u32) -> Result<()> {
        self.stored.push(value);
        Ok(())
    }
}

#[test]
fn an_it_block_shrinks_with_each_instruction() {
    // ITTE EQ: 0000 1101 after IT.
    let xpsr = |state: u32| 0x4100_0010 | (state & 0b11) << 25 | (state >> 2) << 10;
    assert_eq!(after_one_instruction(xpsr(0b0000_0110)), xpsr(0b0000_1100));
    assert_eq!(after_one_instruction(xpsr(0b0000_1100)), xpsr(0b0001_1000));
    assert_eq!(after_one_instruction(xpsr(0b0001_1000)), xpsr(0));
    assert_eq!(after_one_instruction(xpsr(0)), xpsr(0));
}

#[test]
fn time_is_that_of_systick_and_its_milliseconds() {
    let time = |ms: u32, current: u32, icsr: u32| {
        let systick = [79_999u32.to_le_bytes(), current.to_le_bytes()].concat();
        machine_time(&ms.to_le_bytes(), &systick, &icsr.to_le_bytes())
    };
    assert_eq!(time(7, 79_999, 0), Some(Duration::from_millis(7)));
    assert_eq!(time(7, 39_999, 0), Some(Duration::from_micros(7_500)));
    assert_eq!(time(7, 79_999, PENDSTSET), Some(Duration::from_millis(8)), "the exception is pending");
    assert_eq!(
        time(7, 799, PENDSTSET),
        Some(Duration::from_micros(7_990)),
        "read before the counter wrapped"
    );
    assert_eq!(machine_time(&[0; 4], &[0; 8], &[0; 4]), None, "SysTick is stopped");
}
