//! Checks that the hand-drawn pictures show the names in the code and the tables.

use document::read;
use wsg_b_l475e_iot01a::{INPUTS, NAME, OUTPUT_PORT, OUTPUTS};
use wsg_fieldbus::GripperFlags;

/// The heading of the table in docs/wiring.md that has the pins of lines and buses on the default board.
const LINES: &str = "\n### Lines of the B-L475E-IOT01A\n";

/// Returns the connectors and MCU pins of that table.
fn pins_of_lines() -> Vec<[String; 2]> {
    let text = read("docs/wiring.md");
    let below = text.split(LINES).nth(1).unwrap_or_else(|| panic!("docs/wiring.md has no \"{LINES}\""));
    let rows = below.lines().skip_while(|line| !line.starts_with("|---")).skip(1);
    let rows = rows.take_while(|line| line.starts_with('|')).map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        [cells[0].to_owned(), cells[1].to_owned()]
    });
    rows.collect()
}

/// Asserts that a picture contains each text, alone or at the start of a longer text.
fn assert_shows(picture: &str, texts: impl IntoIterator<Item = String>) {
    let svg = read(picture);
    for text in texts {
        assert!(svg.contains(&format!(">{text}")), "{picture} does not show \"{text}\"");
    }
}

#[test]
fn wiring_picture_shows_every_wire_line_and_pin() {
    let inputs = INPUTS.iter().flat_map(|wire| {
        let mcu = format!("P{}{}", wire.port.letter(), wire.pin);
        [wire.signal.iter_names().next().unwrap().0.to_owned(), wire.connector.to_owned(), mcu]
    });
    let outputs = OUTPUTS.iter().flat_map(|wire| {
        let mcu = format!("P{}{}", OUTPUT_PORT.letter(), wire.pin);
        [wire.signal.iter_names().next().unwrap().0.to_owned(), wire.connector.to_owned(), mcu]
    });
    let lines = pins_of_lines().into_iter().flatten();
    let parts = [NAME, "24 V", "120 Ω", "GND", "RS-485", "PROFIBUS", "CAN_H", "pull-down"].map(str::to_owned);
    assert_shows("docs/wiring.svg", inputs.chain(outputs).chain(lines).chain(parts));
}

#[test]
fn state_picture_shows_every_state() {
    let states = GripperFlags::all().iter_names().map(|(name, _)| name.to_owned());
    assert_shows("docs/states.svg", states.chain(["FAST STOP".to_owned()]));
}

#[test]
fn no_connector_of_the_wiring_is_used_twice() {
    let wires = INPUTS.iter().map(|wire| wire.connector).chain(OUTPUTS.iter().map(|wire| wire.connector));
    let mut used: Vec<String> = wires.map(str::to_owned).collect();
    // The USB connector has both lines of the service port.
    used.extend(pins_of_lines().into_iter().map(|[connector, _]| connector).filter(|name| name != "USB"));
    for (at, connector) in used.iter().enumerate() {
        assert!(!used[..at].contains(connector), "{connector} is used twice");
    }
}
