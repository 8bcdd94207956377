//! Covers the model's strictness: an error flag stays set until the firmware clears it.

use super::*;
use crate::registers::tests::Core;

/// Base address of UART4 (RM0351, table 1).
const UART4: u32 = 0x4000_4C00;

#[test]
fn an_error_stays_until_it_is_cleared() {
    // QEMU's UART has a waiting byte, whose value is the same.
    let (mut line, mut uart) = (LineErrors::on(UART4), Core { word: RXNE, ..Core::default() });
    line.set(Some((LineError::Noise, 2)));
    let mut load = |offset: u32| line.load_through(UART4 + offset, Width::Word, &mut uart).unwrap();
    let noise = RXNE | LineError::Noise as u32;
    assert_eq!([ISR, RDR, ISR, RDR, ISR].map(&mut load), [RXNE, RXNE, noise, RXNE, noise]);
    line.store_through(UART4 + ICR, Width::Word, 4, &mut uart).unwrap();
    assert_eq!(line.load_through(UART4 + ISR, Width::Word, &mut uart).unwrap(), RXNE);
    assert_eq!(uart.stored, [4]);
}
