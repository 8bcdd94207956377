//! The released image with a model of the CAN controller's registers, under three settings: gripper on CAN, PLC on CAN, and both. A
//! third-party CANopen master controls it.

mod faults;

use std::os::unix::net::UnixStream;

use host_tests::bxcan::Bxcan;
use host_tests::can_bus::CanBus;
use host_tests::can_controller::{BusController, MappedController};
use host_tests::can_hub::CanHub;
use host_tests::can_wire::WireFrame;
use host_tests::emulator::{Emulator, Extras};
use host_tests::fdcan::{Fdcan, HSE_HZ};
use host_tests::masters::{self, printed};
use host_tests::mcp2515::Mcp2515;
use host_tests::rig::{PATIENCE, Rig, motions};
use host_tests::terminal::Terminal;
use host_tests::trace::Trace;
use host_tests::world::with_part;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::CommandId;
use wsg_sim::Config;

use super::{Board, wait_until};

const READY: Outputs = Outputs::READY.union(Outputs::LINK_OK);

/// Environment variables of the images with CAN, as `cargo xtask test` builds them, and their bit rates in bit/s.
const GRIPPER_ON_CAN: (&str, u32) = ("WSG_FIRMWARE_ELF_CAN_GRIPPER", 1_000_000);
const PLC_ON_CAN: (&str, u32) = ("WSG_FIRMWARE_ELF_CAN_PLC", 250_000);
const BOTH_ON_CAN: (&str, u32) = ("WSG_FIRMWARE_ELF_CAN_BOTH", 500_000);

/// A board's CAN controller, with the board-specific checks.
pub(super) trait CanBoard: BusController {
    const BOARD: Board;

    /// The required sample point at 1 Mbit/s in thousandths of a bit.
    const SAMPLE_POINT_AT_1M: u32 = 875;

    fn new_bus(rate: u32) -> CanBus<Self>;

    fn extras(bus: &CanBus<Self>) -> Extras<'static>;

    /// Returns whether the controller is bus-off, error passive, and above its warning limit.
    fn faults(&mut self) -> (bool, bool, bool);

    /// Returns whether the filters passed only these frames or, for wider filters, whether no such frame was lost.
    fn filters_hold(&self, is_wanted: impl Fn(&WireFrame) -> bool) -> bool {
        self.accepted().iter().all(is_wanted)
    }

    /// Checks the board's own registers, and that no frame was lost if the model detects losses.
    fn assert_registers(board: &Emulator, bus: &CanBus<Self>);

    /// Checks requirements on every driver: the bit rate, a sample point at 87.5 % if the controller's clock permits it (CiA 301,
    /// table 1), and no violation of the manual. Also checks the board's own registers.
    fn assert_set_up(board: &Emulator, bus: &CanBus<Self>, rate: u32) {
        Self::assert_registers(board, bus);
        let timing = bus.controller().bit_timing();
        let sample_point = if rate == 1_000_000 { Self::SAMPLE_POINT_AT_1M } else { 875 };
        assert_eq!((timing.rate, timing.sample_point), (rate, sample_point), "{timing:?}");
        assert_eq!(bus.controller().violations(), [""; 0]);
    }
}

impl CanBoard for Bxcan {
    const BOARD: Board = Board::DEFAULT;

    fn new_bus(rate: u32) -> CanBus {
        CanBus::new(rate)
    }

    fn extras(bus: &CanBus) -> Extras<'static> {
        Extras { models: bus.models(), ..Extras::default() }
    }

    fn faults(&mut self) -> (bool, bool, bool) {
        const ESR: u32 = 0x18;
        let esr = self.load(ESR).unwrap();
        (esr & 1 << 2 != 0, esr & 1 << 1 != 0, esr & 1 << 0 != 0)
    }

    fn assert_registers(board: &Emulator, bus: &CanBus) {
        let read = |address| board.readl(address).unwrap();
        assert_eq!(read(RCC_APB1ENR1) >> 25 & 1, 1, "CAN1's clock must be enabled");
        assert_eq!(read(GPIOB_MODER) >> 16 & 0xF, 0b1010, "PB8 and PB9 must be in alternate-function mode");
        assert_eq!(read(GPIOB_AFRH) & 0xFF, 0x99, "PB8 and PB9 must belong to CAN1");
        // CAN1_TX and CAN1_RX0.
        await_interrupts(board, 0b11 << 19);
        assert_hold(bus, &CAN_SET_UP);
    }
}

impl CanBoard for Fdcan {
    const BOARD: Board = Board::NUCLEO;

    fn new_bus(rate: u32) -> CanBus<Self> {
        CanBus::with(Self::new(HSE_HZ), rate)
    }

    fn extras(bus: &CanBus<Self>) -> Extras<'static> {
        Extras { models: bus.models(), ..Extras::default() }
    }

    fn faults(&mut self) -> (bool, bool, bool) {
        const PSR: u32 = 0x44;
        let psr = self.load(PSR).unwrap();
        (psr & 1 << 7 != 0, psr & 1 << 5 != 0, psr & 1 << 6 != 0)
    }

    fn assert_registers(board: &Emulator, bus: &CanBus<Self>) {
        const FDCANSEL: u32 = 0b11 << 24;
        let read = |address| board.readl(address).unwrap();
        assert_eq!(read(RCC_APB1ENR1) >> 25 & 1, 1, "FDCAN's clock must be enabled");
        assert_eq!(read(RCC_CCIPR) & FDCANSEL, 0, "FDCAN must be clocked by HSE");
        assert_eq!(read(GPIOA_MODER) >> 22 & 0xF, 0b1010, "PA11 and PA12 must be in alternate-function mode");
        assert_eq!(read(GPIOA_AFRH) >> 12 & 0xFF, 0x99, "PA11 and PA12 must belong to FDCAN1");
        await_interrupts(board, 1 << 21);
        assert_hold(bus, &FDCAN_SET_UP);
    }
}

impl CanBoard for Mcp2515 {
    const BOARD: Board = Board::PICO;

    /// The crystal provides eight time quanta per bit.
    const SAMPLE_POINT_AT_1M: u32 = 750;

    fn new_bus(rate: u32) -> CanBus<Self> {
        const CRYSTAL_HZ: u32 = 16_000_000;
        CanBus::with(Self::new(CRYSTAL_HZ), rate)
    }

    fn extras(bus: &CanBus<Self>) -> Extras<'static> {
        Extras { can: Some(bus.clone()), ..Extras::default() }
    }

    fn faults(&mut self) -> (bool, bool, bool) {
        const EFLG: u8 = 0x2D;
        self.select();
        let bytes = [0x03, EFLG, 0].map(|byte| self.exchange(byte).unwrap());
        self.deselect();
        (bytes[2] & 1 << 5 != 0, bytes[2] & 0b11 << 3 != 0, bytes[2] & 1 << 0 != 0)
    }

    fn filters_hold(&self, is_wanted: impl Fn(&WireFrame) -> bool) -> bool {
        !self.lost().iter().any(is_wanted)
    }

    fn assert_registers(_: &Emulator, bus: &CanBus<Self>) {
        assert_eq!(bus.controller().lost(), []);
    }
}

/// Starts a board on a bus, with its main loop running.
fn power_up<C: CanBoard>((variable, rate): (&str, u32)) -> (Emulator, CanBus<C>, CanHub) {
    let bus = C::new_bus(rate);
    // The acknowledging nodes join before the board starts.
    let places = [bus.join(), bus.join()];
    let board = C::BOARD.start(variable, C::extras(&bus));
    let hub = CanHub::start(places, &board.clock()).unwrap();
    (board, bus, hub)
}

/// MODER and AFRH of port B, and the register that enables CAN1's clock (RM0351, 8.5, 6.4.19).
const GPIOB_MODER: u32 = 0x4800_0400;
const GPIOB_AFRH: u32 = 0x4800_0424;
const RCC_APB1ENR1: u32 = 0x4002_1058;

/// Enable register of the first 32 interrupts (ARMv7-M, B3.4.4).
const NVIC_ISER0: u32 = 0xE000_E100;

/// Registers of CAN1 after the set-up (RM0351, 46.9.2): interrupts for an empty mailbox and for a message in FIFO 0; retransmits,
/// sends by identifier, and stays bus-off until software recovers it.
const CAN_SET_UP: [(u32, u32); 2] = [(0x14, 0b11), (0x00, 0x0001_0000)];

/// MODER and AFRH of port A, and the register that selects FDCAN's clock (RM0440, 9.4, 7.4.25).
const GPIOA_MODER: u32 = 0x4800_0000;
const GPIOA_AFRH: u32 = 0x4800_0024;
const RCC_CCIPR: u32 = 0x4002_1088;

/// Registers of FDCAN1 after the set-up (RM0440, 44.4): interrupts for a sent frame and for a new one in each FIFO, on line 0;
/// standard frames that match no filter, and remote and extended frames, are rejected; buffers sent by identifier.
const FDCAN_SET_UP: [(u32, u32); 6] = [
    (0x54, 1 << 0 | 1 << 3 | 1 << 7),
    (0x58, 0),
    (0x5C, 1),
    (0x80, 0x0005_002B),
    (0xC0, 1 << 24),
    (0xDC, 0b111),
];

/// Checks that the registers at these offsets have these values.
fn assert_hold<C: MappedController>(bus: &CanBus<C>, registers: &[(u32, u32)]) {
    let mut controller = bus.controller();
    for (offset, value) in registers {
        assert_eq!(controller.load(*offset).unwrap(), *value, "{offset:#X}");
    }
}

/// Waits until these of the first 32 interrupts are enabled: the handlers mask them until the next turn of the main loop.
fn await_interrupts(board: &Emulator, lines: u32) {
    let read = || board.readl(NVIC_ISER0).unwrap();
    wait_until(&format!("the interrupts {lines:#X}"), read, |enabled| enabled & lines == lines);
}

/// A board with its gripper on a bus.
struct Plant<C> {
    rig: Rig,
    bus: CanBus<C>,
    _master: UnixStream,
}

impl<C: CanBoard> Plant<C> {
    /// Starts a board, and waits for READY.
    fn ready(image: (&str, u32), config: Config) -> Self {
        let (board, bus, CanHub { gripper, master }) = power_up::<C>(image);
        let rig = Rig::of(board, Some(gripper), config, Trace::new(vec![])).unwrap();
        rig.release_fast_stop().unwrap();
        Self { rig, bus, _master: master }
    }

    /// Issues a command by a wire, and checks the outputs at its end.
    fn command(&self, wire: Inputs, wanted: Outputs) {
        assert_eq!(self.rig.command(wire).unwrap(), wanted);
    }
}

fn assert_one_cycle(rig: &Rig) {
    let expected = [CommandId::Homing, CommandId::GripPart, CommandId::ReleasePart];
    assert_eq!(motions(&rig.trace().since(0)), expected);
    assert!(rig.gripper().state().width > 25.0, "{}", rig.gripper().state().width);
}

fn gripper_on_can_runs_a_grip_cycle_by_wires<C: CanBoard>() {
    let plant = Plant::<C>::ready(GRIPPER_ON_CAN, with_part(20.0));
    plant.command(Inputs::HOME, READY | Outputs::REFERENCED);
    plant.command(Inputs::GRIP, READY | Outputs::REFERENCED | Outputs::HOLDING);
    plant.command(Inputs::RELEASE, READY | Outputs::REFERENCED);
    assert_one_cycle(&plant.rig);
    C::assert_set_up(plant.rig.board(), &plant.bus, GRIPPER_ON_CAN.1);
}

/// Runs the master against a board, with the gripper on the same bus or on a serial line.
fn run_master<C: CanBoard>(settings: (&str, u32), gripper_on_bus: bool) {
    let (board, bus, hub) = power_up::<C>(settings);
    let line = gripper_on_bus.then_some(hub.gripper);
    let rig = Rig::of(board, line, with_part(20.0), Trace::new(vec![])).unwrap();
    // The gripper confirms the FAST STOP of power-up.
    rig.await_outputs(PATIENCE, |outputs| outputs.contains(Outputs::LINK_OK)).unwrap();
    rig.set(Inputs::FAST_STOP_OK, true).unwrap();
    let terminal = Terminal::to(hub.master).unwrap();
    let eds = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/wsg-bridge.eds");
    let output = masters::python(include_str!("master.py"), &[&terminal.path, eds]);
    assert!(output.status.success() && printed(&output).contains("passed"), "{}", printed(&output));
    let cycle = [CommandId::GripPart, CommandId::ReleasePart];
    let expected = [&[CommandId::Homing], &cycle[..], &cycle].concat();
    assert_eq!(motions(&rig.trace().since(0)), expected, "{}", printed(&output));
    C::assert_set_up(rig.board(), &bus, settings.1);
}

/// Number of the flash chip that `emulators/rp2040/flash.js` models.
const FLASH_CHIP: [u32; 2] = [0xE660_5838, 0x832A_472F];

#[test]
#[ignore = "needs rp2040js and the firmware image with the PLC on CAN: run `cargo xtask test`"]
fn serial_number_is_made_of_the_flash_chips_in_rp2040js() {
    let (_board, bus, _hub) = power_up::<Mcp2515>(PLC_ON_CAN);
    let master = bus.join();
    let receive = |id: u16| {
        let id = WireFrame::standard(id, &[]).id;
        let next = || master.received.recv_timeout(PATIENCE).expect("the frame must be sent");
        wait_until("the frame", next, |frame| frame.id == id)
    };
    // A heartbeat shows that the node is on the bus.
    receive(0x710);
    // Read object 1018h, subindex 4, by SDO.
    master.send(WireFrame::standard(0x610, &[0x40, 0x18, 0x10, 4, 0, 0, 0, 0]));
    let answer = receive(0x590);
    let (of, number) = answer.data.split_at(4);
    assert_eq!(of, [0x43, 0x18, 0x10, 4]);
    assert_eq!(number, (FLASH_CHIP[0].rotate_left(11) ^ FLASH_CHIP[1]).to_le_bytes());
}

fn plc_on_can_is_served_to_a_master_of_canopen<C: CanBoard>() {
    run_master::<C>(PLC_ON_CAN, false);
}

fn plc_and_gripper_on_one_bus_are_served_to_a_master_of_canopen<C: CanBoard>() {
    run_master::<C>(BOTH_ON_CAN, true);
}

on_every_board!(controller =>
    gripper_on_can_runs_a_grip_cycle_by_wires,
    plc_on_can_is_served_to_a_master_of_canopen,
    plc_and_gripper_on_one_bus_are_served_to_a_master_of_canopen,
);
