//! docs/cycle-bus.svg and docs/cycle-wires.svg: who changes what in which order during a grip cycle, as it was recorded in virtual
//! time. The time axis is not to scale: changes within [`TOGETHER_MS`] share a column.

use host_tests::bench::Bench as WireBench;
use host_tests::document::hold_file;
use host_tests::modbus_bench::{Bench, GRIP, RELEASE};
use host_tests::wires::Wires;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_fieldbus::InputImage;
use wsg_protocol::SystemFlags;
use wsg_sim::Part;

use super::svg::{Anchor, Svg};

/// Changes that come within this of the first share its column.
const TOGETHER_MS: u32 = 25;

/// What is shown at one moment.
#[derive(Clone, PartialEq)]
enum Level {
    Wire(bool),
    Word(String),
}

/// All rows at one moment, and the opening width in mm.
struct Moment {
    at_ms: u32,
    levels: Vec<Level>,
    width: i32,
}

/// A picture: who drives each row, the rows' names, and what was recorded.
struct Recording {
    rows: &'static [(&'static str, &'static str)],
    moments: Vec<Moment>,
}

impl Recording {
    /// One moment for each column.
    fn columns(&self) -> Vec<&Moment> {
        let mut columns: Vec<&Moment> = Vec::new();
        let mut began_ms = 0;
        for moment in &self.moments {
            match columns.last_mut() {
                Some(last) if last.levels == moment.levels => {}
                Some(last) if moment.at_ms - began_ms <= TOGETHER_MS => *last = moment,
                _ => {
                    began_ms = moment.at_ms;
                    columns.push(moment);
                }
            }
        }
        columns
    }

    fn draw(&self, title: &'static str) -> String {
        const LEFT: i32 = 170;
        const COLUMN: i32 = 92;
        const ROW: i32 = 44;
        const HIGH: i32 = 24;
        let columns = self.columns();
        let count = i32::try_from(columns.len()).unwrap();
        let rows = i32::try_from(self.rows.len()).unwrap();
        let (right, bottom) = (LEFT + COLUMN * count, 30 + ROW * rows);
        let mut svg = Svg::new(right + 10, bottom + 100, title);
        let x = |column: usize| LEFT + COLUMN * i32::try_from(column).unwrap();
        for column in 1..columns.len() {
            svg.path(
                &format!("M{} 20V{}", x(column), bottom + 85),
                "stroke=\"#ccc\" stroke-dasharray=\"3 3\"",
            );
        }
        for (row, (from, name)) in self.rows.iter().enumerate() {
            let base = 30 + ROW * i32::try_from(row).unwrap() + 30;
            let top = base - HIGH;
            let colour = if *from == "PLC" { "#1a5fb4" } else { "#264" };
            svg.text((10, base - 6), Anchor::Start, "fill=\"#777\" font-size=\"11\"", from);
            svg.text(
                (LEFT - 10, base - 6),
                Anchor::End,
                &format!("fill=\"{colour}\" font-weight=\"bold\""),
                name,
            );
            let mut line = String::new();
            let mut word_from = 0;
            for (column, moment) in columns.iter().enumerate() {
                match &moment.levels[row] {
                    Level::Wire(high) => {
                        let y = if *high { top } else { base };
                        let begin = if column == 0 { format!("M{LEFT} {y}") } else { format!("V{y}") };
                        line.push_str(&format!("{begin}H{}", x(column + 1)));
                    }
                    Level::Word(word) => {
                        let next = columns.get(column + 1).map(|next| &next.levels[row]);
                        if next == Some(&moment.levels[row]) {
                            continue;
                        }
                        let (from, to) = (x(word_from), x(column + 1));
                        word_from = column + 1;
                        let middle = (base + top) / 2;
                        line.push_str(&format!(
                            "M{from} {middle}L{} {top}H{}L{to} {middle}L{} {base}H{}Z",
                            from + 4,
                            to - 4,
                            to - 4,
                            from + 4
                        ));
                        svg.text(
                            ((from + to) / 2, middle + 4),
                            Anchor::Middle,
                            "font-size=\"11\" fill=\"#112\"",
                            word,
                        );
                    }
                }
            }
            svg.path(&line, &format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\""));
        }
        // The width, from 0 at the bottom to the stroke at the top.
        let y = |width: i32| bottom + 80 - width * 60 / 110;
        svg.text((10, bottom + 50), Anchor::Start, "fill=\"#777\" font-size=\"11\"", "gripper");
        svg.text(
            (LEFT - 10, bottom + 50),
            Anchor::End,
            "fill=\"#264\" font-weight=\"bold\"",
            "opening width",
        );
        let mut line = format!("M{LEFT} {}", y(columns[0].width));
        for (column, moment) in columns.iter().enumerate() {
            let is_same = |other: Option<&&Moment>| other.is_none_or(|other| other.width == moment.width);
            let stays = is_same(columns.get(column + 1));
            // On the way the fingers are somewhere, and where exactly is a matter of milliseconds.
            if stays || (column > 0 && is_same(columns.get(column - 1))) {
                line.push_str(&format!("L{} {}", x(column), y(moment.width)));
            }
            if stays {
                let label = format!("{} mm", moment.width);
                let middle = (x(column) + x(column + 1)) / 2;
                let style = "font-size=\"11\" fill=\"#264\"";
                svg.text((middle, y(moment.width) - 6), Anchor::Middle, style, &label);
            }
        }
        line.push_str(&format!("H{right}"));
        svg.path(&line, "fill=\"none\" stroke=\"#264\" stroke-width=\"1.5\"");
        svg.finish()
    }
}

fn gripper() -> wsg_sim::Config {
    wsg_sim::Config { part: Part::of_width(20.0), ..wsg_sim::Config::default() }
}

fn rounded(width: f32) -> i32 {
    width.round() as i32
}

/// A PLC on the bus: flags as it writes them, all else as it reads it.
fn over_the_bus() -> Recording {
    let mut bench = Bench::homed(gripper());
    let mut recording = Recording {
        rows: &[
            ("PLC", "GRIP"),
            ("PLC", "RELEASE"),
            ("bridge", "GSTATE"),
            ("bridge", "Status Code"),
            ("bridge", "MOVING"),
        ],
        moments: Vec::new(),
    };
    let mut scan = |bench: &mut Bench, flags: u8, scans: usize, until: Option<fn(&InputImage) -> bool>| {
        for _ in 0..scans {
            let answer = bench.ask(&[4, 0, 0, 0, 6]);
            let image = InputImage::from_bytes(answer[2..].try_into().unwrap());
            let state: Vec<&str> = image.state.iter_names().map(|(name, _)| name).collect();
            recording.moments.push(Moment {
                at_ms: u32::try_from(bench.now().as_micros() / 1_000).unwrap(),
                levels: vec![
                    Level::Wire(flags & GRIP != 0),
                    Level::Wire(flags & RELEASE != 0),
                    Level::Word(state.join(" ")),
                    Level::Word(format!(
                        "{} {}",
                        image.status.code(),
                        image.status.symbol().trim_start_matches("E_")
                    )),
                    Level::Wire(image.system.contains(SystemFlags::MOVING)),
                ],
                width: rounded(bench.gripper().state().width),
            });
            if until.is_some_and(|until| until(&image)) {
                return;
            }
        }
        assert!(until.is_none(), "it does not end");
    };
    scan(&mut bench, 0, 50, None);
    for (flags, width) in [(GRIP, 20_00), (RELEASE, 40_00)] {
        bench.write(0, &[u16::from(flags) << 8, width, 50_00, 40_00]);
        scan(&mut bench, flags, 100, None);
        bench.write(0, &[0, width, 50_00, 40_00]);
        scan(&mut bench, 0, 5_000, Some(|image| image.status.is_final()));
        scan(&mut bench, 0, 300, None);
    }
    recording
}

/// A PLC on the wires.
fn over_the_wires() -> Recording {
    let mut bench = WireBench::homed(gripper());
    let mut recording = Recording {
        rows: &[
            ("PLC", "GRIP"),
            ("PLC", "RELEASE"),
            ("bridge", "READY"),
            ("bridge", "BUSY"),
            ("bridge", "HOLDING"),
        ],
        moments: Vec::new(),
    };
    let mut pass = |bench: &mut WireBench, bound_ms: u32, until: Option<fn(Outputs) -> bool>| {
        for _ in 0..bound_ms {
            bench.step();
            let (inputs, outputs) = (*bench.inputs(), bench.outputs());
            recording.moments.push(Moment {
                at_ms: u32::try_from(bench.now().as_micros() / 1_000).unwrap(),
                levels: vec![
                    Level::Wire(inputs.contains(Inputs::GRIP)),
                    Level::Wire(inputs.contains(Inputs::RELEASE)),
                    Level::Wire(outputs.contains(Outputs::READY)),
                    Level::Wire(outputs.contains(Outputs::BUSY)),
                    Level::Wire(outputs.contains(Outputs::HOLDING)),
                ],
                width: rounded(bench.gripper().state().width),
            });
            if until.is_some_and(|until| until(outputs)) {
                return;
            }
        }
        assert!(until.is_none(), "it does not end");
    };
    pass(&mut bench, 100, None);
    for wire in [Inputs::GRIP, Inputs::RELEASE] {
        bench.set(wire, true);
        pass(&mut bench, 1_000, Some(|outputs| outputs.contains(Outputs::BUSY)));
        pass(&mut bench, 100, None);
        bench.set(wire, false);
        pass(&mut bench, 10_000, Some(|outputs| !outputs.contains(Outputs::BUSY)));
        pass(&mut bench, 300, None);
    }
    recording
}

#[test]
fn timing_diagrams_show_what_was_recorded() {
    hold_file("docs/cycle-bus.svg", &over_the_bus().draw("A grip cycle over a bus"));
    hold_file("docs/cycle-wires.svg", &over_the_wires().draw("A grip cycle over the wires"));
}
