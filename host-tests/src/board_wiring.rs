//! The wiring of each board: its pins as the documents show them, and the picture of them.

use std::fmt::Write as _;

use boards::Board;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_stm32::{InputWire, OutputWire, Port};

/// The pins of a board.
pub struct BoardWiring {
    /// The board's name.
    pub name: &'static str,
    /// The input wires, then the output wires, in the order of the bits.
    pub wires: Vec<WirePin>,
    /// The pins of lines and buses.
    pub lines: Vec<LinePin>,
    /// The pin of the MCU that drives the status LED.
    pub indicator: String,
}

/// The pin of a wire.
pub struct WirePin {
    /// The wire's name.
    pub wire: &'static str,
    /// The pin on the board's connector.
    pub pin: String,
    /// The pin of the MCU.
    pub mcu: String,
}

/// The pin of a line or bus.
pub struct LinePin {
    /// The pin on the board's connector.
    pub pin: &'static str,
    /// The pin of the MCU, and its function.
    pub mcu: &'static str,
    /// The connected part.
    pub part: &'static str,
    /// The pin of that part.
    pub its_pin: &'static str,
}

impl BoardWiring {
    /// Returns the wiring of a board.
    ///
    /// # Panics
    /// Panics if this function does not know the board.
    #[must_use]
    pub fn of(board: &Board) -> Self {
        match board.name {
            "b-l475e-iot01a" => {
                use wsg_b_l475e_iot01a::{INDICATOR, INPUTS, LINE_PINS, NAME, OUTPUT_PORT, OUTPUTS};
                Self::new(NAME, stm32(&INPUTS, OUTPUT_PORT, &OUTPUTS), &LINE_PINS, mcu(INDICATOR))
            }
            "nucleo-g474re" => {
                use wsg_nucleo_g474re::{INDICATOR, INPUTS, LINE_PINS, NAME, OUTPUT_PORT, OUTPUTS};
                Self::new(NAME, stm32(&INPUTS, OUTPUT_PORT, &OUTPUTS), &LINE_PINS, mcu(INDICATOR))
            }
            "pico" => {
                use wsg_pico::{INDICATOR, INPUTS, LINE_PINS, NAME, OUTPUTS};
                let pin =
                    |wire, pin: u8, gpio| WirePin { wire, pin: pin.to_string(), mcu: format!("GP{gpio}") };
                let inputs = INPUTS.iter().map(|wire| pin(input(wire.signal), wire.pin, wire.gpio));
                let outputs = OUTPUTS.iter().map(|wire| pin(output(wire.signal), wire.pin, wire.gpio));
                Self::new(NAME, inputs.chain(outputs).collect(), &LINE_PINS, format!("GP{INDICATOR}"))
            }
            unknown => panic!("no pins of the board {unknown}"),
        }
    }

    fn new(name: &'static str, wires: Vec<WirePin>, lines: &[[&'static str; 4]], indicator: String) -> Self {
        let lines = lines.iter().map(|&[pin, mcu, part, its_pin]| LinePin { pin, mcu, part, its_pin });
        Self { name, wires, lines: lines.collect(), indicator }
    }

    /// Returns the rows of the table of wires: wire, pin, MCU pin.
    #[must_use]
    pub fn wire_rows(&self) -> Vec<[String; 3]> {
        let row = |it: &WirePin| [format!("`{}`", it.wire), it.pin.clone(), it.mcu.clone()];
        self.wires.iter().map(row).collect()
    }

    /// Returns the rows of the table of lines: pin, MCU pin, connected part.
    #[must_use]
    pub fn line_rows(&self) -> Vec<[String; 3]> {
        let connected = |it: &LinePin| format!("{}, {}", it.part, label(it.its_pin));
        let row = |it: &LinePin| [it.pin.to_owned(), it.mcu.to_owned(), connected(it)];
        self.lines.iter().map(row).collect()
    }

    /// Returns the picture of the wiring, as SVG.
    #[must_use]
    pub fn picture(&self) -> String {
        let mut picture = Picture::default();
        picture.wires(self);
        picture.lines(self);
        picture.finish()
    }
}

fn stm32(inputs: &[InputWire], output_port: Port, outputs: &[OutputWire]) -> Vec<WirePin> {
    let pin = |wire, connector: &str, port: Port, pin| WirePin {
        wire,
        pin: connector.to_owned(),
        mcu: mcu((port, pin)),
    };
    let inputs = inputs.iter().map(|wire| pin(input(wire.signal), wire.connector, wire.port, wire.pin));
    let outputs = outputs.iter().map(|wire| pin(output(wire.signal), wire.connector, output_port, wire.pin));
    inputs.chain(outputs).collect()
}

/// Returns the name of an STM32's pin.
fn mcu((port, pin): (Port, u8)) -> String {
    format!("P{}{pin}", port.letter())
}

fn input(signal: Inputs) -> &'static str {
    signal.iter_names().next().map_or("", |(name, _)| name)
}

fn output(signal: Outputs) -> &'static str {
    signal.iter_names().next().map_or("", |(name, _)| name)
}

const STYLE: &str = r#"  <style>
    svg { font-family: sans-serif; font-size: 13px; --ink: #112; --line: #445; --paper: #fff; --part: #e9f0fa; --edge: #446; --inner: #fff; --pin: #264; --soft: #445 }
    @media (prefers-color-scheme: dark) {
      svg { --ink: #eef; --line: #bbc; --paper: #14161f; --part: #232a3c; --edge: #8894b8; --inner: #14161f; --pin: #9d9; --soft: #bbc }
    }
    text { fill: var(--ink) }
    .part { fill: var(--part); stroke: var(--edge); stroke-width: 1.5 }
    .inner { fill: var(--inner); stroke: var(--edge) }
    .line { fill: none; stroke: var(--line); stroke-width: 1.3 }
    .tip { fill: var(--line) }
    .pin { font-family: monospace; font-size: 11.5px; fill: var(--pin) }
    .soft { fill: var(--soft); font-size: 12px }
    .head { font-size: 15px; font-weight: bold }
    .m { text-anchor: middle }
    .e { text-anchor: end }
  </style>
  <defs>
    <marker id="arrow" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto-start-reverse">
      <path class="tip" d="M0 0 10 5 0 10z"/>
    </marker>
  </defs>
"#;

const WIDTH: u32 = 520;
/// Left edge of the board in the upper half, and of the coupler's and the parts' boxes.
const BOARD: u32 = 316;
/// Height of a row.
const ROW: u32 = 24;

/// A picture in the making.
#[derive(Default)]
struct Picture {
    body: String,
    /// The lower end of the drawing so far.
    bottom: u32,
}

impl Picture {
    fn add(&mut self, line: &str) {
        let _ = writeln!(self.body, "  {line}");
    }

    fn text(&mut self, class: &str, x: u32, y: u32, text: &str) {
        self.add(&format!(r#"<text class="{class}" x="{x}" y="{y}">{text}</text>"#));
    }

    fn part(&mut self, class: &str, [x, y, width, height]: [u32; 4]) {
        self.add(&format!(
            r#"<rect class="{class}" x="{x}" y="{y}" width="{width}" height="{height}" rx="5"/>"#
        ));
    }

    fn line(&mut self, path: &str) {
        self.add(&format!(r#"<path class="line" d="{path}"/>"#));
    }

    fn arrow(&mut self, path: &str) {
        self.add(&format!(r#"<path class="line" d="{path}" marker-end="url(#arrow)"/>"#));
    }

    /// Draws a resistor from a wire to ground.
    fn pull_down(&mut self, x: u32, y: u32) {
        self.line(&format!("M{x} {y}v3M{x} {}v3", y + 10));
        self.add(&format!(r#"<rect class="inner" x="{}" y="{}" width="6" height="7"/>"#, x - 3, y + 3));
        self.ground(x, y + 13);
    }

    fn ground(&mut self, x: u32, y: u32) {
        self.line(&format!("M{} {y}h12m-10 3h8m-6 3h4", x - 6));
    }

    /// Draws the supply, and the wires between PLC and board.
    fn wires(&mut self, wiring: &BoardWiring) {
        const RIGHT: u32 = WIDTH - 10;
        let middle = BOARD.midpoint(RIGHT);
        let first = 164;
        let bottom = first + ROW * wiring.wires.len() as u32 + 16;
        self.part("part", [10, 10, 112, 46]);
        self.text("head m", 66, 29, "24 V supply");
        self.text("soft m", 66, 47, "of the machine");
        self.part("part", [BOARD, 10, RIGHT - BOARD, 46]);
        self.text("head m", middle, 29, "converter");
        self.text("soft m", middle, 47, "24 V to 5 V");
        self.arrow("M122 24H312");
        self.text("soft m", 216, 18, "24 V");
        self.line("M122 46H312");
        self.text("soft m", 216, 41, "0 V");
        self.part("part", [10, 92, 112, bottom - 92]);
        self.part("inner", [162, 128, 86, bottom - 128]);
        self.part("part", [BOARD, 92, RIGHT - BOARD, bottom - 92]);
        self.arrow("M66 56V89");
        self.text("soft", 74, 78, "24 V");
        self.arrow(&format!("M{middle} 56V89"));
        self.text("soft e", middle - 7, 78, "5 V; the board makes 3.3 V");
        self.text("head m", 66, 112, "PLC");
        self.text("head m", middle, 112, wiring.name);
        self.text("soft m", 205, 106, "a coupler");
        self.text("soft m", 205, 120, "for each wire");
        self.text("soft m", 183, 146, "24 V");
        self.text("soft m", 227, 146, "3.3 V");
        self.line(&format!("M205 132V{}", bottom - 6));
        for (y, (at, wire)) in (first..).step_by(ROW as usize).zip(wiring.wires.iter().enumerate()) {
            self.text("e soft", 116, y + 4, wire.wire);
            if at < Inputs::COUNT {
                self.arrow(&format!("M122 {y}H159"));
                self.arrow(&format!("M248 {y}H{}", BOARD - 3));
            } else {
                self.arrow(&format!("M162 {y}H125"));
                self.arrow(&format!("M{BOARD} {y}H251"));
                self.pull_down(280, y);
            }
            self.text("pin", BOARD + 8, y + 4, &wire.pin);
            self.text("pin", BOARD + 64, y + 4, &wire.mcu);
        }
        let notes = [
            (first + ROW * 4, ["pull-downs", "in the MCU", ""]),
            (first + ROW * 11, ["a pull-down", "at each of", "these pins"]),
        ];
        for (y, lines) in notes {
            for (y, line) in (y..).step_by(15).zip(lines) {
                self.text("soft e", RIGHT - 8, y, line);
            }
        }
        self.line(&format!("M66 {bottom}v22H186v-22"));
        self.text("soft m", 126, bottom + 37, "0 V");
        self.line(&format!("M224 {bottom}v22H{middle}v-22"));
        self.ground(308, bottom + 22);
        self.text("soft", 320, bottom + 37, "GND, common");
        self.bottom = bottom + 37;
    }

    /// Draws the lines and buses.
    fn lines(&mut self, wiring: &BoardWiring) {
        /// Right edge of the board, left edges of the parts and of their peers.
        const BOARD: u32 = 200;
        const PART: u32 = 250;
        const PEER: u32 = 424;
        let (start, top) = (self.body.len(), self.bottom + 31);
        let mut y = top + 50;
        for pins in wiring.lines.chunk_by(|a, b| a.part == b.part) {
            let part = pins[0].part;
            let is_computer = part == "computer";
            let rows = pins.len() as u32 + u32::from(!is_computer);
            let height = ROW * rows + 34;
            self.part(if is_computer { "part" } else { "inner" }, [PART, y, 124, height]);
            self.text("m", PART + 62, y + 18, part.trim_end_matches(" transceiver"));
            let mut row = y + 38;
            for pin in pins {
                self.text("pin", 18, row + 4, pin.pin);
                self.text("pin", 74, row + 4, pin.mcu);
                if pin.mcu.ends_with("RX") || pin.its_pin == "INT" {
                    self.arrow(&format!("M{PART} {row}H{}", BOARD + 3));
                } else {
                    self.arrow(&format!("M{BOARD} {row}H{}", PART - 3));
                }
                if pin.its_pin.contains("enable") {
                    self.pull_down(PART - 22, row);
                }
                self.text("soft", PART + 6, row + 4, label(pin.its_pin));
                row += ROW;
            }
            if !is_computer {
                self.text("pin", 18, row + 4, "GND");
                self.line(&format!("M{BOARD} {row}H{PART}"));
                self.text("soft", PART + 6, row + 4, "GND, 3.3 V");
            }
            self.peer(part, [PEER, y, height]);
            y += height + 22;
        }
        // The board's box is below its pins.
        let pins = self.body.split_off(start);
        self.part("part", [10, top, BOARD - 10, y - top]);
        self.body.push_str(&pins);
        self.text("head m", 105, top + 20, wiring.name);
        self.text("soft m", 105, top + 36, "(the same board)");
        self.bottom = y;
    }

    /// Draws the gripper or PLC that a part is connected to.
    fn peer(&mut self, part: &str, [x, y, height]: [u32; 3]) {
        let (from, width) = (374, WIDTH - 10 - x);
        let middle = x + width / 2;
        let (names, notes): (&[&str], &[&str]) = match part {
            "RS-232 transceiver" => (&["gripper"], &[]),
            "RS-485 transceiver" => {
                (&["PLC"], &["Modbus:", "120 Ω at", "both ends", "PROFIBUS:", "390, 220,", "390 Ω"])
            }
            "MCP2515" => (&["PLC or", "gripper"], &["16 MHz,", "transceiver,", "120 Ω at", "both ends"]),
            "CAN transceiver" => (&["PLC or", "gripper"], &["120 Ω at", "both ends"]),
            _ => return,
        };
        self.part("part", [x, y, width, height]);
        for (y, name) in (y + 20..).step_by(18).zip(names) {
            self.text("head m", middle, y, name);
        }
        let below = y + 20 + 18 * names.len() as u32;
        for (y, note) in (below..).step_by(15).zip(notes) {
            self.text("soft", x + 6, y, note);
        }
        if notes.is_empty() {
            for (at, name) in ["RX", "TX", "GND"].iter().enumerate() {
                let row = y + 38 + ROW * at as u32;
                match at {
                    0 => self.arrow(&format!("M{from} {row}H{}", x - 3)),
                    1 => self.arrow(&format!("M{x} {row}H{}", from + 3)),
                    _ => self.line(&format!("M{from} {row}H{x}")),
                }
                self.text("soft", x + 6, row + 4, name);
            }
            return;
        }
        let (high, low) = if names.len() > 1 { ("CAN_H", "CAN_L") } else { ("A", "B") };
        let (first, last) = (y + 38, y + height - 20);
        self.line(&format!("M{from} {first}H{x}M{from} {last}H{x}"));
        self.text("soft", from + 4, first - 5, high);
        self.text("soft", from + 4, last + 15, low);
        let resistor = first.midpoint(last) - 12;
        let at = from + 25;
        self.line(&format!("M{at} {first}V{resistor}M{at} {}V{last}", resistor + 24));
        self.add(&format!(r#"<rect class="inner" x="{}" y="{resistor}" width="8" height="24"/>"#, at - 4));
    }

    fn finish(self) -> String {
        const TITLE: &str = "The board, its supply, the wires to the PLC, the gripper's line and the buses";
        let height = self.bottom + 10;
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\">\n  \
             <title>{TITLE}</title>\n{STYLE}  <rect width=\"{WIDTH}\" height=\"{height}\" fill=\"var(--paper)\"/>\n{}</svg>\n",
            self.body
        )
    }
}

/// Returns the name of a part's pin: `DI` of `driver input (DI)`.
fn label(its_pin: &str) -> &str {
    its_pin.split_once('(').map_or(its_pin, |(_, name)| name.trim_end_matches(')'))
}

#[cfg(test)]
mod tests {
    use super::*;
    use boards::BOARDS;

    #[test]
    fn no_pin_of_a_board_is_used_twice() {
        for board in &BOARDS {
            let wiring = BoardWiring::of(board);
            let wires = wiring.wires.iter().map(|it| [it.pin.clone(), it.mcu.clone()]);
            let lines = wiring.lines.iter().map(|it| {
                let mcu = it.mcu.split(',').next().unwrap_or_default();
                [it.pin.to_owned(), mcu.to_owned()]
            });
            let mut used: Vec<String> = Vec::new();
            for pin in wires.chain(lines).flatten() {
                // The USB connector has both lines of a service port.
                assert!(pin == "USB" || !used.contains(&pin), "{}: {pin} is used twice", wiring.name);
                used.push(pin);
            }
        }
    }

    #[test]
    fn a_picture_shows_every_wire_line_and_pin_of_its_board() {
        for board in &BOARDS {
            let wiring = BoardWiring::of(board);
            let picture = wiring.picture();
            let wires = wiring.wires.iter().flat_map(|it| [it.wire, &it.pin, &it.mcu]);
            let lines = wiring.lines.iter().flat_map(|it| [it.pin, it.mcu, label(it.its_pin)]);
            let parts = [wiring.name, "24 V", "120 Ω", "GND", "RS-485", "PROFIBUS", "CAN_H", "pull-down"];
            for text in wires.chain(lines).chain(parts) {
                assert!(picture.contains(&format!(">{text}")), "{} does not show {text}", wiring.name);
            }
        }
    }
}
