//! Covers the model's strictness: an error flag stays set until the firmware clears it.

use super::*;

/// Base address of UART4 (RM0351, table 1).
const UART4: u32 = 0x4000_4C00;

/// QEMU's UART with a waiting byte; records stores to ICR.
#[derive(Default)]
struct Uart(Vec<u32>);

impl Machine for Uart {
    fn set_interrupt(&mut self, _: u8, _: bool) -> Result<()> {
        Ok(())
    }

    fn raise_nmi(&mut self) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        Ok(if address == UART4 + ISR { RXNE } else { 1 })
    }

    fn store(&mut self, _: u32, value: u32) -> Result<()> {
        self.0.push(value);
        Ok(())
    }
}

#[test]
fn an_error_stays_until_it_is_cleared() {
    let (mut line, mut uart) = (LineErrors::on(UART4), Uart::default());
    line.set(Some((LineError::Noise, 2)));
    let mut load = |offset| line.load_through(UART4 + offset, Width::Word, &mut uart).unwrap();
    let seen = [ISR, RDR, ISR, RDR, ISR].map(|offset| load(offset) & 0xF);
    assert_eq!(seen, [0, 1, 4, 1, 4]);
    line.store_through(UART4 + ICR, Width::Word, 4, &mut uart).unwrap();
    assert_eq!(line.load_through(UART4 + ISR, Width::Word, &mut uart).unwrap() & 0xF, 0);
    assert_eq!(uart.0, [4]);
}
