//! Bit rates of the released image's lines, calculated from its clock and UART registers.

use host_tests::emulator::Extras;

use super::{Board, RELEASED};

/// Clock registers (RM0351, 6.4; RM0440, 7.4).
const RCC_CFGR: u32 = 0x4002_1008;
const RCC_PLLCFGR: u32 = 0x4002_100C;
const RCC_CCIPR: u32 = 0x4002_1088;

/// Offsets of the UART registers (RM0351, 40.8, 41.7; RM0440, 37.8).
const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const CR3: u32 = 0x08;
const BRR: u32 = 0x0C;

fn field(register: u32, at: u32, bits: u32) -> u32 {
    register >> at & ((1 << bits) - 1)
}

fn lines_run_at_their_rates_and_each_frame_enables_the_driver(kind: Board) {
    let (emulator, board) = (kind.start(RELEASED, Extras::default()), kind.in_qemu());
    let clocks = &board.clocks;
    let read = |address| emulator.readl(address).unwrap();

    // The core and the buses of the UARTs are clocked by the PLL without a divider: oscillator / M * N / R.
    let (cfgr, pll) = (read(RCC_CFGR), read(RCC_PLLCFGR));
    assert_eq!((field(cfgr, 2, 2), field(cfgr, 4, 4), field(cfgr, 8, 6)), (0b11, 0, 0), "{cfgr:#X}");
    assert_eq!(field(pll, 0, 2), clocks.pll_source, "source of the PLL: {pll:#X}");
    let divider = (field(pll, 4, 3) + 1) * 2 * (field(pll, 25, 2) + 1);
    assert_eq!(clocks.oscillator_hz * field(pll, 8, 7) / divider, clocks.core_hz);
    let (mask, selected) = clocks.selection;
    assert_eq!(read(RCC_CCIPR) & mask, selected, "clocks of the UARTs");

    // The gripper's line: 16 samples per bit; 8 data bits, no parity, 1 stop bit.
    let gripper = board.gripper_uart;
    let control = read(gripper + CR1);
    let (m1, over8, m0, parity) =
        (field(control, 28, 1), field(control, 15, 1), field(control, 12, 1), field(control, 10, 1));
    assert_eq!((m1, over8, m0, parity, field(read(gripper + CR2), 12, 2)), (0, 0, 0, 0, 0), "{control:#X}");
    let rate = f64::from(clocks.core_hz) / f64::from(read(gripper + BRR));
    assert!((rate / 115_200.0 - 1.0).abs() < 1e-3, "{rate}");

    // The bus. Default: 19 200 bit/s, 8E1, which is 9 bits including parity.
    let bus = board.bus_uart;
    let control = read(bus + CR1);
    let (m1, m0, parity) = (field(control, 28, 1), field(control, 12, 1), field(control, 9, 2));
    assert_eq!((m1, m0, parity, field(read(bus + CR2), 12, 2)), (0, 1, 0b10, 0), "{control:#X}");
    assert_eq!(read(bus + BRR), board.bus_divider(19_200));

    // DE mode enables the transceiver for this time before and after a transmission (RM0351, 41.7.1).
    assert_eq!(field(read(bus + CR3), 14, 1), 1);
    let times = (field(control, 21, 5), field(control, 16, 5));
    assert_eq!(times, (clocks.driver_time, clocks.driver_time));
}

on_every_board!(board_in_qemu => lines_run_at_their_rates_and_each_frame_enables_the_driver);
