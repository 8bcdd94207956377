//! Checks the wiring, recipes and times in docs/wiring.md.

use boards::BOARDS;
use document::{hold, hold_file, table};
use host_tests::board_wiring::BoardWiring;
use host_tests::fault_sweep::Sweep;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config, RECIPES, Recipe, WiresConfig};

/// Each input with its function.
const INPUT_MEANINGS: [(Inputs, &str); Inputs::COUNT] = [
    (Inputs::GRIP, "grip a part"),
    (Inputs::RELEASE, "release the part"),
    (Inputs::MOVE, "move the fingers to the recipe's width"),
    (Inputs::HOME, "reference the fingers"),
    (Inputs::STOP_ACK, "stop, or acknowledge a FAST STOP"),
    (Inputs::FAST_STOP_OK, "**low: FAST STOP**"),
    (Inputs::RECIPE0, "recipe number, bit 0"),
    (Inputs::RECIPE1, "recipe number, bit 1"),
];

/// Each output with the condition of its high level.
const OUTPUT_MEANINGS: [(Outputs, &str); Outputs::COUNT] = [
    (Outputs::READY, "the bridge accepts a command: all conditions below the table are met"),
    (
        Outputs::BUSY,
        "a motion runs, or its result is pending; and for at least 50 ms after each executed or refused \
         edge. A FAST STOP, or a fault that locks the gripper, lowers `BUSY` immediately",
    ),
    (
        Outputs::HOLDING,
        "a part is held with the set force, and no motion has begun since. A refused command does not \
         change it",
    ),
    (Outputs::PART_FAULT, "the last grip found no part, or the held part was lost"),
    (
        Outputs::ERROR,
        "the last command was refused or failed, or its outcome is unknown. Also during FAST STOP, with a \
         fault of the gripper or a finger, and with unusable stored settings",
    ),
    (Outputs::REFERENCED, "the gripper reports that its fingers are referenced"),
    (Outputs::LINK_OK, "the gripper responds, and its limits and states are known"),
];

fn name<T>(mut names: impl Iterator<Item = (&'static str, T)>) -> String {
    format!("`{}`", names.next().expect("each wire has a name").0)
}

/// Returns the table of the inputs, in the order of the bits.
fn inputs() -> String {
    let row = |(wire, meaning): (Inputs, &str)| [name(wire.iter_names()), meaning.to_owned()];
    table(["wire", "meaning"], INPUT_MEANINGS.map(row))
}

/// Returns the table of the outputs, in the order of the bits.
fn outputs() -> String {
    let row = |(wire, meaning): (Outputs, &str)| [name(wire.iter_names()), meaning.to_owned()];
    table(["wire", "high when"], OUTPUT_MEANINGS.map(row))
}

fn recipes() -> String {
    let hundredths = |value: i32| format!("{:.1}", f64::from(value) / 100.0);
    let by_wires = 1 << 2;
    let row = |number: String, recipe: &Recipe| {
        [
            number,
            hundredths(recipe.width.into()),
            hundredths(recipe.speed.into()),
            hundredths(recipe.force.into()),
            hundredths(recipe.release_width.into()),
        ]
    };
    let rows = RECIPES.iter().enumerate().take(by_wires);
    let rows = rows.map(|(number, recipe)| row(number.to_string(), recipe));
    let (last, others) = RECIPES[by_wires..].split_last().unwrap();
    assert!(
        others.iter().all(|other| other == last),
        "the other recipes must be equal, because one row describes them"
    );
    let rest = format!("{by_wires} to {}", RECIPES.len() - 1);
    table(
        ["recipe", "width, mm", "speed, mm/s", "force, N", "release width, mm"],
        rows.chain([row(rest, last)]),
    )
}

fn times() -> String {
    let Config { wires: WiresConfig { debounce_ms, min_busy_ms }, half_frame_ms, session, .. } =
        Config::DEFAULT;
    let ms = |value: u32| format!("{value} ms");
    let rows = [
        ("debounce time of a wire", ms(debounce_ms)),
        ("minimum pulse of `BUSY`", ms(min_busy_ms)),
        ("time-out of an answer", ms(session.reply_timeout_ms)),
        ("time-out of the answer to a Stop", ms(session.timeouts[0].reply_ms)),
        ("time-out of the answer to a FAST STOP", ms(session.fast_stop.answer_ms)),
        ("number of FAST STOPs in a burst", session.fast_stop.burst_frames.to_string()),
        ("pause after a burst", ms(session.fast_stop.pause_ms)),
        (
            "transmissions of a repeatable request before the link counts as lost",
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
    hold("docs/wiring.md", "inputs", &inputs());
    hold("docs/wiring.md", "outputs", &outputs());
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
