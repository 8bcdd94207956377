//! docs/wiring.svg: the board, and everything that is wired to it. Wires to and from the PLC are those of the board's pin table;
//! lines and buses are those of the tables in docs/wiring.md.

use host_tests::document::{hold_file, read};
use wsg_b_l475e_iot01a::{INPUTS, NAME, OUTPUT_PORT, OUTPUTS};

use super::svg::{Anchor, Svg};

const DOCUMENT: &str = "docs/wiring.md";

/// A pin of a line or bus.
struct Pin {
    connector: String,
    mcu: String,
    /// What of the transceiver it goes to.
    end: String,
}

/// The first table below this heading of the document: one row for each pin.
fn pins(heading: &str) -> Vec<Pin> {
    let text = read(DOCUMENT);
    let below = text.split(&format!("\n{heading}\n")).nth(1);
    let below = below.unwrap_or_else(|| panic!("{DOCUMENT} has no \"{heading}\""));
    let rows = below.lines().skip_while(|line| !line.starts_with("|---")).skip(1);
    let rows = rows.take_while(|line| line.starts_with('|')).map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let end = cells[2].split(',').next().unwrap_or_default().to_owned();
        Pin { connector: cells[0].to_owned(), mcu: cells[1].to_owned(), end }
    });
    rows.collect()
}

/// A line or bus: where its pins are in the document, its transceiver, what is behind that.
const LINES: [(&str, &str, &str, &str); 3] = [
    ("## The gripper's line", "RS-232", "transceiver 3.3 V", "gripper, RS-232"),
    ("## The bus", "RS-485", "transceiver 3.3 V", "PLC, Modbus RTU"),
    ("### CAN", "CAN", "transceiver 3.3 V", "PLC or gripper, CAN"),
];

/// Where the pins of the service port are in the document.
const SERVICE_PORT: &str = "## The service port";

const BOX: &str = "fill=\"#eef3fa\" stroke=\"#446\" stroke-width=\"1.5\"";
const PART: &str = "fill=\"#fff\" stroke=\"#889\"";
const WIRE: &str = "fill=\"none\" stroke=\"#444\" stroke-width=\"1.2\"";
const SMALL: &str = "fill=\"#444\" font-size=\"11\"";
const PIN: &str = "fill=\"#264\" font-size=\"11\" font-family=\"monospace\"";
const BOLD: &str = "font-size=\"16\" font-weight=\"bold\"";

const ROW: i32 = 25;
const TOP: i32 = 76;
/// Left and right edges.
const PLC: (i32, i32) = (10, 150);
const COUPLER: (i32, i32) = (210, 300);
const BOARD: (i32, i32) = (370, 620);
const TRANSCEIVER: (i32, i32) = (690, 822);
const FAR: (i32, i32) = (872, 1017);

fn draw() -> String {
    let mut svg = Svg::new(1027, 500, "The board, the wires to the PLC, the gripper's line and the buses");
    let block = |svg: &mut Svg, (left, right): (i32, i32), top: i32, height: i32, style: &str| {
        svg.rect((left, top), (right - left, height), style);
    };
    block(&mut svg, PLC, 40, 435, BOX);
    block(&mut svg, COUPLER, 60, 415, PART);
    block(&mut svg, BOARD, 40, 450, BOX);
    let middle = |(left, right): (i32, i32)| (left + right) / 2;
    svg.text((middle(PLC), 62), Anchor::Middle, BOLD, "PLC, 24 V");
    svg.text((middle(BOARD), 62), Anchor::Middle, BOLD, NAME);
    svg.text((middle(COUPLER), 30), Anchor::Middle, SMALL, "couplers,");
    svg.text((middle(COUPLER), 45), Anchor::Middle, SMALL, "one for each wire");

    // The wires of the PLC.
    let inputs = INPUTS.iter().map(|wire| {
        let mcu = format!("P{}{}", wire.port.letter(), wire.pin);
        (wire.signal.iter_names().next().unwrap().0, wire.connector, mcu, true)
    });
    let outputs = OUTPUTS.iter().map(|wire| {
        let mcu = format!("P{}{}", OUTPUT_PORT.letter(), wire.pin);
        (wire.signal.iter_names().next().unwrap().0, wire.connector, mcu, false)
    });
    let mut y = TOP;
    for (signal, connector, mcu, to_board) in inputs.chain(outputs) {
        y += ROW;
        svg.text((PLC.1 - 8, y + 4), Anchor::End, "font-size=\"12\"", signal);
        let ends = "marker-end=\"url(#arrow)\"";
        for (from, to) in [(PLC.1, COUPLER.0), (COUPLER.1, BOARD.0)] {
            let (from, to) = if to_board { (from, to) } else { (to, from) };
            svg.path(&format!("M{from} {y}H{to}"), &format!("{WIRE} {ends}"));
        }
        svg.text((BOARD.0 + 8, y + 4), Anchor::Start, PIN, connector);
        svg.text((BOARD.0 + 48, y + 4), Anchor::Start, PIN, &mcu);
    }
    svg.text((middle(COUPLER), TOP + 4), Anchor::Middle, SMALL, "24 V to 3.3 V");

    // The lines.
    let mut y = TOP;
    for (heading, name, part, far) in LINES {
        let pins = pins(heading);
        let top = y + 6;
        for pin in &pins {
            y += ROW;
            svg.path(&format!("M{} {y}H{}", BOARD.1, TRANSCEIVER.0), WIRE);
            svg.text((BOARD.1 - 8, y + 4), Anchor::End, PIN, &pin.connector);
            svg.text((BOARD.1 - 45, y + 4), Anchor::End, PIN, &pin.mcu);
            let end = if pin.connector == "GND" { "GND" } else { &pin.end };
            svg.text((TRANSCEIVER.0 + 6, y + 4), Anchor::Start, SMALL, end);
        }
        let height = y - top + 14;
        let rim = "fill=\"none\" stroke=\"#889\"";
        block(&mut svg, TRANSCEIVER, top, height, rim);
        svg.text((middle(TRANSCEIVER), top - 4), Anchor::Middle, SMALL, &format!("{name} {part}"));
        let centre = top + height / 2;
        svg.path(
            &format!("M{} {centre}H{}", TRANSCEIVER.1, FAR.0),
            &format!("{WIRE} marker-start=\"url(#arrow)\" marker-end=\"url(#arrow)\""),
        );
        block(&mut svg, FAR, centre - 20, 40, BOX);
        svg.text((middle(FAR), centre + 5), Anchor::Middle, "font-size=\"12\" font-weight=\"bold\"", far);
        y += 32;
    }
    // Without a transceiver: the cable is the board's.
    let first = y + ROW;
    for pin in pins(SERVICE_PORT) {
        y += ROW;
        svg.text((BOARD.1 - 8, y + 4), Anchor::End, PIN, &pin.connector);
        svg.text((BOARD.1 - 45, y + 4), Anchor::End, PIN, &pin.mcu);
    }
    let centre = i32::midpoint(first, y);
    svg.path(
        &format!("M{} {centre}H{}", BOARD.1, FAR.0),
        &format!("{WIRE} marker-start=\"url(#arrow)\" marker-end=\"url(#arrow)\""),
    );
    svg.text((middle(TRANSCEIVER), centre - 6), Anchor::Middle, SMALL, "USB cable");
    block(&mut svg, FAR, centre - 20, 40, BOX);
    svg.text(
        (middle(FAR), centre + 5),
        Anchor::Middle,
        "font-size=\"12\" font-weight=\"bold\"",
        "computer, service",
    );
    svg.finish()
}

#[test]
fn wiring_diagram_is_that_of_the_board_file_and_the_tables() {
    hold_file("docs/wiring.svg", &draw());
}

#[test]
fn no_connector_of_the_wiring_is_used_twice() {
    let wires = INPUTS.iter().map(|wire| wire.connector).chain(OUTPUTS.iter().map(|wire| wire.connector));
    let mut used: Vec<String> = wires.map(str::to_owned).collect();
    for (heading, ..) in LINES {
        used.extend(pins(heading).into_iter().map(|pin| pin.connector).filter(|name| name != "GND"));
    }
    for (at, connector) in used.iter().enumerate() {
        assert!(!used[..at].contains(connector), "{connector} is used twice");
    }
}
