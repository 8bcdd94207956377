//! Bit rates of the released image's lines, calculated from its clock and UART registers.

use host_tests::emulator::Extras;

use super::{Board, RELEASED};

/// Frequency of the oscillator HSI16 (RM0351, 6.2.2).
const HSI16_HZ: u32 = 16_000_000;

/// Clock registers (RM0351, 6.4).
const RCC_CFGR: u32 = 0x4002_1008;
const RCC_PLLCFGR: u32 = 0x4002_100C;
const RCC_CCIPR: u32 = 0x4002_1088;

/// UARTs and register offsets (RM0351, 40.8, 41.7).
const UART4: u32 = 0x4000_4C00;
const LPUART1: u32 = 0x4000_8000;
const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const CR3: u32 = 0x08;
const BRR: u32 = 0x0C;

fn field(register: u32, at: u32, bits: u32) -> u32 {
    register >> at & ((1 << bits) - 1)
}

#[test]
#[ignore = "needs QEMU and the firmware image: run `cargo xtask test`"]
fn lines_run_at_their_rates_and_each_frame_enables_the_driver() {
    let board = Board::DEFAULT.start(RELEASED, Extras::default());
    let read = |address| board.readl(address).unwrap();

    // The core and APB1 are clocked by the PLL without a divider: HSI16 / M * N / R.
    let (cfgr, pll) = (read(RCC_CFGR), read(RCC_PLLCFGR));
    assert_eq!((field(cfgr, 2, 2), field(cfgr, 4, 4), field(cfgr, 8, 3)), (0b11, 0, 0), "{cfgr:#X}");
    assert_eq!(field(pll, 0, 2), 0b10, "HSI16 must be the PLL's source: {pll:#X}");
    let divider = (field(pll, 4, 3) + 1) * 2 * (field(pll, 25, 2) + 1);
    let pclk1_hz = HSI16_HZ * field(pll, 8, 7) / divider;
    assert_eq!(pclk1_hz, 80_000_000);

    // UART4 is clocked by APB1, with 16 samples per bit; 8 data bits, no parity, 1 stop bit.
    assert_eq!(field(read(RCC_CCIPR), 6, 2), 0b00);
    let control = read(UART4 + CR1);
    let (m1, over8, m0, parity) =
        (field(control, 28, 1), field(control, 15, 1), field(control, 12, 1), field(control, 10, 1));
    assert_eq!((m1, over8, m0, parity, field(read(UART4 + CR2), 12, 2)), (0, 0, 0, 0, 0), "{control:#X}");
    let rate = f64::from(pclk1_hz) / f64::from(read(UART4 + BRR));
    assert!((rate / 115_200.0 - 1.0).abs() < 1e-3, "{rate}");

    // LPUART1 is clocked by HSI16. Default: 19 200 bit/s, 8E1, which is 9 bits including parity.
    assert_eq!(field(read(RCC_CCIPR), 10, 2), 0b10);
    let control = read(LPUART1 + CR1);
    let (m1, m0, parity) = (field(control, 28, 1), field(control, 12, 1), field(control, 9, 2));
    assert_eq!((m1, m0, parity, field(read(LPUART1 + CR2), 12, 2)), (0, 1, 0b10, 0), "{control:#X}");
    // QEMU keeps the lowest 16 bits of this BRR, which has 20 bits.
    let divider = (256 * u64::from(HSI16_HZ) + 19_200 / 2) / 19_200;
    assert_eq!(u64::from(read(LPUART1 + BRR)), divider & 0xFFFF);

    // DE mode enables the transceiver from 1 us before to 1 us after a transmission, in cycles of the UART clock (41.7.1).
    assert_eq!(field(read(LPUART1 + CR3), 14, 1), 1);
    let cycles_in_a_microsecond = HSI16_HZ / 1_000_000;
    assert_eq!(
        (field(control, 21, 5), field(control, 16, 5)),
        (cycles_in_a_microsecond, cycles_in_a_microsecond)
    );
}
