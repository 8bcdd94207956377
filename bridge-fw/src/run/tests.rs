//! Tests of order and conditions of the main loop, on hardware that records its calls.

use std::vec::Vec;

use super::*;
use crate::can::{BusOffPolicy, CanBus, NoCan};
use crate::gripper::UartBuffers;
use crate::io::Inputs;
use crate::plc::{NoBus, PlcBus, SETTINGS};
use crate::storage::NoFlash;

/// UART of a missing gripper.
struct Silent;

impl Uart for Silent {
    fn pend(&mut self) {}

    fn is_idle(&mut self) -> bool {
        true
    }
}

/// Wires that record their output levels.
#[derive(Default)]
struct Wires(Option<Outputs>);

impl InputPort for Wires {
    fn read(&mut self) -> Inputs {
        Inputs::FAST_STOP_OK
    }
}

impl OutputPort for Wires {
    fn write(&mut self, outputs: Outputs) {
        self.0 = Some(outputs);
    }
}

/// Generates methods that record a call.
macro_rules! records {
    ($($name:ident($($argument:ty),*) => $call:literal;)+) => {$(
        fn $name(&mut self $(, _: $argument)*) {
            self.calls.push($call);
        }
    )+};
}

/// Hardware of an image with settings in range, or out of range.
#[derive(Default)]
struct Double<const IN_RANGE: bool = true> {
    calls: Vec<&'static str>,
    led: Vec<bool>,
    now_ms: u32,
}

impl<const IN_RANGE: bool> Hardware for Double<IN_RANGE> {
    type Can = NoCan;
    type Flash = NoFlash;

    fn delivered() -> Record {
        if IN_RANGE { Config::DEFAULT.record() } else { [u16::MAX; SETTINGS.len()] }
    }

    records! {
        start_gripper() => "gripper";
        start_service() => "service";
        start_bus(&Config) => "bus";
        start_can(&mut NoCan, &CanConfig) => "CAN";
        feed_watchdog() => "feed";
        after_turn(Outputs, &mut NoFlash) => "after";
        rearm_can(&mut NoCan) => "rearm";
        serve_bus() => "serve";
    }

    fn now_ms(&mut self) -> u32 {
        self.now_ms
    }

    fn indicate(&mut self, is_lit: bool) {
        self.led.push(is_lit);
    }

    fn sleep(&mut self, now_ms: u32, uses_can: bool) {
        assert_eq!(now_ms, self.now_ms);
        self.calls.push(if uses_can { "sleep, CAN" } else { "sleep" });
    }
}

type OnDouble<'a, const IN_RANGE: bool = true> = Board<'a, Double<IN_RANGE>, Wires, Silent>;

/// Runs a test on a board.
fn on_board<const IN_RANGE: bool>(test: impl FnOnce(&mut OnDouble<'_, IN_RANGE>)) {
    static BUFFERS: UartBuffers = UartBuffers::new();
    test(&mut Board {
        hardware: Double::default(),
        id: BoardId::UNKNOWN,
        wires: Wires::default(),
        gripper: UartLine::new(Silent, &BUFFERS),
        bus: &mut NoBus,
        service: &mut NoBus,
        flash: &mut NoFlash,
    });
}

fn station(gripper_line: GripperLine, plc_bus: PlcBus) -> (Station<NoCan>, Config) {
    let config = Config { gripper_line, plc_bus, ..Config::DEFAULT };
    let mut station = Station::without_profibus(CanBus::new(NoCan, BusOffPolicy::DEFAULT));
    station.start(&config, BoardId::UNKNOWN, ResetCause::PowerOn);
    (station, config)
}

/// Asserts the calls of a turn at each of these times, in milliseconds.
fn assert_turns(gripper_line: GripperLine, plc_bus: PlcBus, turns: &[(u32, &[&str])]) {
    on_board::<true>(|board| {
        let (mut station, _) = station(gripper_line, plc_bus);
        let mut served_ms = 0;
        for (now_ms, expected) in turns {
            board.hardware.calls.clear();
            board.hardware.now_ms = *now_ms;
            board.turn(&mut station, &mut served_ms);
            assert_eq!(board.hardware.calls, *expected, "{now_ms} ms");
            assert!(board.wires.0.take().is_some());
        }
    });
}

#[test]
fn start_starts_only_the_lines_that_the_settings_select() {
    let cases: [(_, _, &[&str]); 8] = [
        (GripperLine::Serial, PlcBus::Off, &["gripper", "service"]),
        (GripperLine::Serial, PlcBus::Modbus, &["gripper", "service", "bus"]),
        (GripperLine::Serial, PlcBus::Profibus, &["gripper", "service", "bus"]),
        (GripperLine::Serial, PlcBus::Canopen, &["gripper", "service", "CAN"]),
        (GripperLine::Can, PlcBus::Off, &["service", "CAN"]),
        (GripperLine::Can, PlcBus::Modbus, &["service", "bus", "CAN"]),
        (GripperLine::Can, PlcBus::Profibus, &["service", "bus", "CAN"]),
        (GripperLine::Can, PlcBus::Canopen, &["service", "CAN"]),
    ];
    for (gripper_line, plc_bus, expected) in cases {
        let (mut station, config) = station(gripper_line, plc_bus);
        let mut hardware: Double = Double::default();
        start_lines(&mut hardware, &mut station, &config);
        assert_eq!(hardware.calls, expected, "{gripper_line:?}, {plc_bus:?}");
    }
}

#[test]
fn board_starts_with_the_settings_of_the_image() {
    on_board::<true>(|board| {
        let (mut station, _) = station(GripperLine::Can, PlcBus::Off);
        assert!(board.start(&mut station, ResetCause::PowerOn));
        assert_eq!(board.hardware.calls, ["gripper", "service", "bus"]);
    });
}

#[test]
fn invalid_settings_start_no_line_and_the_led_flickers() {
    on_board::<false>(|board| {
        let (mut station, _) = station(GripperLine::Serial, PlcBus::Modbus);
        assert!(!board.start(&mut station, ResetCause::PowerOn));
        for now_ms in 0..200 {
            board.hardware.now_ms = now_ms;
            board.wait_for_watchdog();
            assert_eq!(board.hardware.led.pop(), Some(Indication::NotStarted.is_lit(now_ms)));
        }
        assert_eq!(board.hardware.calls, ["sleep"; 200], "the watchdog is not fed");
        assert_eq!(board.wires.0, None);
    });
}

#[test]
fn turn_serves_bus_and_watchdog_once_per_ms_and_sleeps_last() {
    let turns: [(_, &[_]); 3] = [
        (1, &["after", "serve", "feed", "sleep"]),
        (1, &["after", "sleep"]),
        (2, &["after", "serve", "feed", "sleep"]),
    ];
    assert_turns(GripperLine::Serial, PlcBus::Modbus, &turns);
    let with_can: [(_, &[_]); 1] = [(1, &["after", "rearm", "serve", "feed", "sleep, CAN"])];
    assert_turns(GripperLine::Can, PlcBus::Off, &with_can);
}

#[test]
fn led_shows_the_indication_of_the_bridge() {
    on_board::<true>(|board| {
        let (mut station, _) = station(GripperLine::Serial, PlcBus::Modbus);
        for now_ms in 0..4_000 {
            board.hardware.now_ms = now_ms;
            board.turn(&mut station, &mut 0);
            assert_eq!(board.hardware.led.pop(), Some(Indication::NeverAnswered.is_lit(now_ms)));
        }
    });
}

#[test]
fn pair_reads_its_first_port_and_writes_its_second() {
    let mut pair = (Wires::default(), Wires::default());
    assert_eq!(pair.read(), Inputs::FAST_STOP_OK);
    pair.write(Outputs::BUSY);
    assert_eq!((pair.0.0, pair.1.0), (None, Some(Outputs::BUSY)));
}
