//! Checks the wiring, recipes and times in docs/wiring.md.

use document::{hold, table};
use host_tests::fault_sweep::Sweep;
use wsg_b_l475e_iot01a::{INPUTS, OUTPUT_PORT, OUTPUTS, Port};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config, RECIPES, Recipe, WiresConfig};

/// Each input with its function.
const INPUT_MEANINGS: [(Inputs, &str); Inputs::COUNT] = [
    (Inputs::GRIP, "rising edge: grip a part"),
    (Inputs::RELEASE, "rising edge: release the part"),
    (Inputs::MOVE, "rising edge: move the fingers to a width"),
    (Inputs::HOME, "rising edge: reference the fingers"),
    (Inputs::STOP_ACK, "rising edge: stop, or acknowledge a FAST STOP"),
    (Inputs::FAST_STOP_OK, "**low: FAST STOP** (so a broken wire stops)"),
    (Inputs::RECIPE0, "recipe number, bit 0"),
    (Inputs::RECIPE1, "recipe number, bit 1"),
];

/// Each output with its meaning.
const OUTPUT_MEANINGS: [(Outputs, &str); Outputs::COUNT] = [
    (Outputs::READY, "ready to accept a command"),
    (Outputs::BUSY, "a command is in progress"),
    (Outputs::HOLDING, "a part is held"),
    (Outputs::PART_FAULT, "no part found, or part lost"),
    (Outputs::ERROR, "command refused or failed, state unknown, or FAST STOP"),
    (Outputs::REFERENCED, "the fingers are referenced"),
    (Outputs::LINK_OK, "the gripper responds"),
];

fn name<T>(mut names: impl Iterator<Item = (&'static str, T)>) -> String {
    format!("`{}`", names.next().expect("each wire has a name").0)
}

/// Returns the table of all wires, in the order of the bits.
fn wires() -> String {
    let row = |wire, direction: &str, meaning: &str| [wire, direction.to_owned(), meaning.to_owned()];
    let inputs = INPUT_MEANINGS.map(|(wire, meaning)| row(name(wire.iter_names()), "PLC to bridge", meaning));
    let outputs =
        OUTPUT_MEANINGS.map(|(wire, meaning)| row(name(wire.iter_names()), "bridge to PLC", meaning));
    table(["wire", "direction", "meaning"], inputs.into_iter().chain(outputs))
}

/// Returns the table of a board's wires with their pins on the board and on the MCU, in the order of the bits.
fn pins(
    inputs: [(Inputs, [String; 2]); Inputs::COUNT],
    outputs: [(Outputs, [String; 2]); Outputs::COUNT],
) -> String {
    let row = |wire, [pin, on_mcu]: [String; 2]| [wire, pin, on_mcu];
    let inputs = inputs.into_iter().map(|(wire, pins)| row(name(wire.iter_names()), pins));
    let outputs = outputs.into_iter().map(|(wire, pins)| row(name(wire.iter_names()), pins));
    table(["wire", "pin", "MCU pin"], inputs.chain(outputs))
}

fn pins_of_the_default_board() -> String {
    let pins = |connector: &str, port: Port, pin| [connector.to_owned(), format!("P{}{pin}", port.letter())];
    self::pins(
        INPUTS.map(|wire| (wire.signal, pins(wire.connector, wire.port, wire.pin))),
        OUTPUTS.map(|wire| (wire.signal, pins(wire.connector, OUTPUT_PORT, wire.pin))),
    )
}

fn pins_of_the_pico() -> String {
    let pins = |pin: u8, gpio: u8| [pin.to_string(), format!("GP{gpio}")];
    self::pins(
        wsg_pico::INPUTS.map(|wire| (wire.signal, pins(wire.pin, wire.gpio))),
        wsg_pico::OUTPUTS.map(|wire| (wire.signal, pins(wire.pin, wire.gpio))),
    )
}

fn pins_of_the_nucleo() -> String {
    use wsg_nucleo_g474re::{INPUTS, OUTPUT_PORT, OUTPUTS, Port};
    let pins = |connector: &str, port: Port, pin| [connector.to_owned(), format!("P{}{pin}", port.letter())];
    self::pins(
        INPUTS.map(|wire| (wire.signal, pins(wire.connector, wire.port, wire.pin))),
        OUTPUTS.map(|wire| (wire.signal, pins(wire.connector, OUTPUT_PORT, wire.pin))),
    )
}

fn recipes() -> String {
    let hundredths = |value: i32| format!("{:.1}", f64::from(value) / 100.0);
    let by_wires = 1 << 2;
    let row = |number: String, [bit_1, bit_0]: [String; 2], recipe: &Recipe| {
        [
            number,
            bit_1,
            bit_0,
            hundredths(recipe.width.into()),
            hundredths(recipe.speed.into()),
            hundredths(recipe.force.into()),
            hundredths(recipe.release_width.into()),
        ]
    };
    let rows = RECIPES.iter().enumerate().take(by_wires).map(|(number, recipe)| {
        row(number.to_string(), [number >> 1, number & 1].map(|bit| bit.to_string()), recipe)
    });
    let (last, others) = RECIPES[by_wires..].split_last().unwrap();
    assert!(
        others.iter().all(|other| other == last),
        "the other recipes must be equal, because one row describes them"
    );
    let rest = format!("{by_wires} to {}", RECIPES.len() - 1);
    table(
        ["recipe", "`RECIPE1`", "`RECIPE0`", "width, mm", "speed, mm/s", "force, N", "release width, mm"],
        rows.chain([row(rest, Default::default(), last)]),
    )
}

fn times() -> String {
    let Config { wires: WiresConfig { debounce_ms, min_busy_ms }, half_frame_ms, session, .. } =
        Config::DEFAULT;
    let ms = |value: u32| format!("{value} ms");
    let rows = [
        ("debounce time of a wire", ms(debounce_ms)),
        ("minimum pulse of `BUSY`, unless an error ends it", ms(min_busy_ms)),
        ("time-out of the first answer to a request", ms(session.reply_timeout_ms)),
        ("time-out of the answer to a Stop, before it becomes a FAST STOP", ms(session.timeouts[0].reply_ms)),
        ("time-out of the answer to a FAST STOP, before a burst of them", ms(session.fast_stop.answer_ms)),
        ("number of FAST STOPs in a burst", session.fast_stop.burst_frames.to_string()),
        ("pause after a burst", ms(session.fast_stop.pause_ms)),
        (
            "transmissions of a repeatable request before the link counts as lost",
            session.attempts.to_string(),
        ),
        ("polling interval of each state of the gripper", ms(session.refresh_ms)),
        ("interval of attempts to reconnect", ms(session.reconnect_ms)),
        ("time-out of a motion", ms(session.motion_timeout_ms)),
        ("time-out of a result after standstill", ms(session.result_grace_ms)),
        ("time-out of an incomplete frame", ms(half_frame_ms)),
    ];
    table(["parameter", "value"], rows.map(|(what, value)| [what.to_owned(), value]))
}

fn fast_stop() -> String {
    let rows = Sweep::all(1, false).map(|sweep| [sweep.name.to_owned(), format!("{} ms", sweep.limit_ms)]);
    table(["fault", "worst-case latency"], rows)
}

#[test]
fn wiring_in_the_documents_is_that_of_the_board_files() {
    hold("docs/wiring.md", "wires", &wires());
    hold("docs/wiring.md", "pins of the B-L475E-IOT01A", &pins_of_the_default_board());
    hold("docs/wiring.md", "pins of the Pico", &pins_of_the_pico());
    hold("docs/wiring.md", "pins of the NUCLEO-G474RE", &pins_of_the_nucleo());
}

#[test]
fn recipes_in_the_documents_are_those_of_the_firmware() {
    hold("docs/wiring.md", "recipes", &recipes());
}

#[test]
fn promises_about_fast_stop_are_those_that_the_sweep_holds() {
    hold("docs/wiring.md", "fast-stop", &fast_stop());
}

#[test]
fn times_in_the_document_are_those_of_the_firmware() {
    hold("docs/wiring.md", "times", &times());
}
