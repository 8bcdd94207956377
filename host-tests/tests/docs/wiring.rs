//! Checks the wiring, recipes and times in docs/wiring.md.

use boards::BOARDS;
use document::{hold, hold_file, table};
use host_tests::board_wiring::BoardWiring;
use host_tests::fault_sweep::Sweep;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config, RECIPES, Recipe, WiresConfig};

/// Each input with its function.
const INPUT_MEANINGS: [(Inputs, &str); Inputs::COUNT] = [
    (Inputs::GRIP, "rising edge: grip a part"),
    (Inputs::RELEASE, "rising edge: release the part"),
    (Inputs::MOVE, "rising edge: move the fingers to the recipe's width"),
    (Inputs::HOME, "rising edge: reference the fingers"),
    (Inputs::STOP_ACK, "rising edge: stop, or acknowledge a FAST STOP"),
    (Inputs::FAST_STOP_OK, "**low: FAST STOP**, so that a broken wire stops the fingers"),
    (Inputs::RECIPE0, "recipe number, bit 0"),
    (Inputs::RECIPE1, "recipe number, bit 1"),
];

/// Each output with its meaning.
const OUTPUT_MEANINGS: [(Outputs, &str); Outputs::COUNT] = [
    (Outputs::READY, "ready to accept a command"),
    (Outputs::BUSY, "a command is in progress"),
    (Outputs::HOLDING, "a part is held"),
    (Outputs::PART_FAULT, "no part found, or part lost"),
    (Outputs::ERROR, "command refused, failed or of unknown outcome; FAST STOP; or a fault"),
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
        (
            "minimum pulse of `BUSY`, unless a FAST STOP, a fault that locks, or a lost link ends it",
            ms(min_busy_ms),
        ),
        ("time-out of an answer (of the first, if several follow)", ms(session.reply_timeout_ms)),
        ("time-out of the answer to a Stop, before it becomes a FAST STOP", ms(session.timeouts[0].reply_ms)),
        (
            "time-out of the answer to a FAST STOP, before the bridge sends a burst of them",
            ms(session.fast_stop.answer_ms),
        ),
        ("number of FAST STOPs in a burst", session.fast_stop.burst_frames.to_string()),
        ("pause after a burst", ms(session.fast_stop.pause_ms)),
        (
            "transmissions of a repeatable request, the first included, before the link counts as lost",
            session.attempts.to_string(),
        ),
        ("polling interval of each gripper state", ms(session.refresh_ms)),
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
    for board in &BOARDS {
        let wiring = BoardWiring::of(board);
        let name = wiring.name;
        let wires = table(["wire", "pin", "MCU pin"], wiring.wire_rows());
        hold("docs/wiring.md", &format!("pins of the {name}"), &wires);
        let lines = table(["pin", "MCU pin", "connected to"], wiring.line_rows());
        hold("docs/wiring.md", &format!("lines of the {name}"), &lines);
    }
    hold_file("docs/wiring.svg", &BoardWiring::of(&BOARDS[0]).picture());
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
