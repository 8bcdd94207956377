use std::collections::VecDeque;

use super::*;

/// QEMU's UART: bytes that wait, and what ICR was told.
#[derive(Default)]
struct Uart {
    bytes: VecDeque<u8>,
    cleared: Vec<u32>,
}

impl Machine for Uart {
    fn set_interrupt(&mut self, _: u8, _: bool) -> Result<()> {
        Ok(())
    }

    fn raise_nmi(&mut self) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        Ok(match address - UART4 {
            ISR => 0xC0 | if self.bytes.is_empty() { 0 } else { RXNE },
            RDR => self.bytes.pop_front().unwrap_or(0).into(),
            _ => 0,
        })
    }

    fn store(&mut self, _: u32, value: u32) -> Result<()> {
        self.cleared.push(value);
        Ok(())
    }
}

/// What a handler sees of these bytes: its errors, and the byte.
fn received(line: &mut LineErrors, bytes: &[u8]) -> Vec<(u32, u32)> {
    let mut uart = Uart { bytes: bytes.iter().copied().collect(), ..Uart::default() };
    let mut seen = Vec::new();
    loop {
        let isr = line.load_through(UART4 + ISR, Width::Word, &mut uart).unwrap();
        let again = line.load_through(UART4 + ISR, Width::Word, &mut uart).unwrap();
        assert_eq!(isr, again, "looking twice changes nothing");
        if isr & RXNE == 0 {
            return seen;
        }
        let byte = line.load_through(UART4 + RDR, Width::Word, &mut uart).unwrap();
        line.store_through(UART4 + ICR, Width::Word, isr & 0xF, &mut uart).unwrap();
        seen.push((isr & 0xF, byte));
    }
}

#[test]
fn each_nth_byte_has_the_error_and_its_value() {
    let mut line = LineErrors::on(UART4);
    assert_eq!(received(&mut line, &[1, 2]), [(0, 1), (0, 2)]);
    for error in [LineError::Parity, LineError::Framing, LineError::Noise] {
        line.set(Some((error, 2)));
        assert_eq!(received(&mut line, &[1, 2, 3]), [(0, 1), (error as u32, 2), (0, 3)]);
    }
}

#[test]
fn an_overrun_loses_its_byte_and_is_told_with_the_next() {
    let mut line = LineErrors::on(UART4);
    line.set(Some((LineError::Overrun, 2)));
    assert_eq!(received(&mut line, &[1, 2, 3]), [(0, 1), (8, 3)]);
}

#[test]
fn an_error_stays_until_it_is_cleared() {
    let mut line = LineErrors::on(UART4);
    let mut uart = Uart { bytes: [1].into(), ..Uart::default() };
    line.set(Some((LineError::Noise, 1)));
    let isr = |line: &mut LineErrors, uart: &mut Uart| {
        line.load_through(UART4 + ISR, Width::Word, uart).unwrap() & 0xF
    };
    assert_eq!(isr(&mut line, &mut uart), 4);
    line.load_through(UART4 + RDR, Width::Word, &mut uart).unwrap();
    assert_eq!(isr(&mut line, &mut uart), 4);
    line.store_through(UART4 + ICR, Width::Word, 4, &mut uart).unwrap();
    assert_eq!((isr(&mut line, &mut uart), uart.cleared), (0, vec![4]));
}
