//! Checks that the texts of an archive describe its board: every pin as in the board's table, no name of another board.

use anyhow::{Context, Result, ensure};
use boards::{BOARDS, Board};
use host_tests::board_wiring::BoardWiring;
use wsg_protocol::SystemFlags;

/// Beginning of the picture of the wiring, as a data URL.
const DRAWING: &str = "data:image/svg+xml;charset=utf-8,";

/// Checks the manual and the first page of a board's archive.
///
/// # Errors
/// Fails when the manual has other pins, or when a text names a pin, a connector, a file or a part of another board.
pub(crate) fn check(board: &Board, manual: &str, readme: &str) -> Result<()> {
    let wiring = BoardWiring::of(board);
    let expected = [wiring.wire_rows(), wiring.line_rows()];
    let expected = expected.map(|rows| rows.into_iter().map(|row| row.map(|cell| cell.replace('`', ""))));
    let expected: Vec<Vec<_>> = expected.into_iter().map(Iterator::collect).collect();
    let tables = pin_tables(manual);
    ensure!(tables == expected, "the manual has the pins {tables:?}; expected {expected:?}");

    let pictures = pictures(manual)?;
    let shown: Vec<&str> = pictures.iter().flat_map(|picture| pins(picture)).collect();
    let wires = wiring.wires.iter().flat_map(|it| [&it.pin[..], &it.mcu]);
    let lines = wiring.lines.iter().flat_map(|it| [it.pin, it.mcu]);
    let expected: Vec<&str> = wires.chain(lines).collect();
    ensure!(shown == expected, "the manual's picture has the pins {shown:?}; expected {expected:?}");

    let drawn = pictures.iter().map(|picture| without_tags(picture));
    for text in drawn.chain([without_tags(manual), readme.to_owned()]) {
        names_no_other_board(board, &text)?;
    }
    Ok(())
}

/// Returns the rows of each table of pins.
fn pin_tables(manual: &str) -> Vec<Vec<[String; 3]>> {
    let tables = manual.split("<table>").skip(1).filter_map(|rest| rest.split("</table>").next());
    let tables = tables.filter(|table| table.contains("<th>MCU pin</th>"));
    let row = |row: &str| {
        let mut cells = row.split("<td>").skip(1).map(|cell| without_tags(cell).trim().to_owned());
        [(); 3].map(|()| cells.next().unwrap_or_default())
    };
    tables.map(|table| table.split("<tr>").skip(2).map(row).collect()).collect()
}

/// Returns the drawings in the manual.
fn pictures(manual: &str) -> Result<Vec<String>> {
    let addresses = manual.split(DRAWING).skip(1).filter_map(|rest| rest.split('"').next());
    let decode = |address: &str| {
        let mut parts = address.split('%');
        let mut bytes = parts.next().unwrap_or_default().as_bytes().to_vec();
        for part in parts {
            let (code, rest) = part.split_at_checked(2).context("a drawing ends in an escape")?;
            bytes.push(u8::from_str_radix(code, 16)?);
            bytes.extend_from_slice(rest.as_bytes());
        }
        Ok(String::from_utf8(bytes)?)
    };
    addresses.map(decode).collect()
}

/// Returns the pins in a drawing.
fn pins(drawing: &str) -> impl Iterator<Item = &str> {
    let pins = drawing.split("<text class=\"pin\"").skip(1);
    let pins = pins.filter_map(|rest| rest.split_once('>')?.1.split('<').next());
    pins.filter(|pin| *pin != "GND")
}

fn without_tags(html: &str) -> String {
    let mut parts = html.split('<');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        text.push(' ');
        text.push_str(part.split_once('>').map_or(part, |(_, after)| after));
    }
    text
}

fn names_no_other_board(board: &Board, text: &str) -> Result<()> {
    let own = names(board);
    let words: Vec<&str> = words(text).collect();
    for other in BOARDS.iter().filter(|other| *other != board) {
        let foreign: Vec<String> = names(other).into_iter().filter(|name| !own.contains(name)).collect();
        for (at, word) in words.iter().enumerate() {
            let is_foreign = foreign.iter().any(|name| name.eq_ignore_ascii_case(word));
            ensure!(
                !is_foreign || is_data(&words, at),
                "a text for the {} names {word} of the {}: {}",
                board.name,
                other.name,
                words[at.saturating_sub(8)..(at + 8).min(words.len())].join(" ")
            );
        }
    }
    Ok(())
}

/// Returns whether a word is a byte of a message, a limit of a range of bits such as `D7 to D0`, or a bit with the name of its
/// flag. They look like the connectors of an Arduino.
fn is_data(words: &[&str], at: usize) -> bool {
    let word = |at: Option<usize>| at.and_then(|at| words.get(at)).copied().unwrap_or_default();
    let is_byte = |word: &str| word.len() == 2 && word.bytes().all(|byte| byte.is_ascii_hexdigit());
    let bit_of = |word: &str| word.strip_prefix('D')?.parse::<u32>().ok();
    let this = words[at];
    let (before, after) = (word(at.checked_sub(1)), word(at.checked_add(1)));
    let other_limit = if before == "to" { at.checked_sub(2) } else { at.checked_add(2) };
    let is_limit = (before == "to" || after == "to") && bit_of(word(other_limit)).is_some();
    let flag = SystemFlags::from_name(after).map(|flag| flag.bits().trailing_zeros());
    let is_bit = bit_of(this).is_some_and(|bit| is_limit || flag == Some(bit));
    is_bit || is_byte(this) && (is_byte(before) || is_byte(after))
}

/// Returns the names that belong to a board: board, MCU, pins, connectors, peripherals, files and parts.
fn names(board: &Board) -> Vec<String> {
    let wiring = BoardWiring::of(board);
    let wires = wiring.wires.iter().flat_map(|it| [it.pin.clone(), it.mcu.clone()]);
    let lines = wiring.lines.iter().flat_map(|it| [it.pin, it.mcu]).flat_map(words).map(str::to_owned);
    let has_both = |name: &String| {
        name.bytes().any(|byte| byte.is_ascii_digit()) && name.bytes().any(|byte| byte.is_ascii_alphabetic())
    };
    let files = words(board.files).filter(|word| word.starts_with("wsg-bridge.")).map(str::to_owned);
    let others = [board.name, board.chip, wiring.name].into_iter().chain(board.words.iter().copied());
    wires
        .chain(lines)
        .chain([wiring.indicator])
        .filter(has_both)
        .chain(files)
        .chain(others.map(str::to_owned))
        .collect()
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    let words = text.split(|c: char| !c.is_ascii_alphanumeric() && !"-_.".contains(c));
    words.map(|word| word.trim_matches(['.', '-'])).filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{linked, manual, start_here};

    fn manual_of(board: &Board) -> String {
        manual::html(board, &linked()).unwrap()
    }

    #[test]
    fn each_manual_has_the_pins_and_names_of_its_board_only() {
        for board in &BOARDS {
            check(board, &manual_of(board), &start_here(board, false, true, true)).unwrap();
        }
    }

    #[test]
    fn fast_stop_ok_is_at_the_pin_of_the_board() {
        for (board, pin, mcu) in
            [("b-l475e-iot01a", "D3", "PB0"), ("pico", "16", "GP12"), ("nucleo-g474re", "CN7-38", "PC0")]
        {
            let tables = pin_tables(&manual_of(Board::named(board).unwrap()));
            assert_eq!(tables[0][5], ["FAST_STOP_OK", pin, mcu]);
        }
    }

    #[test]
    fn manual_or_first_page_of_another_board_is_rejected() {
        for board in &BOARDS {
            let (manual, start) = (manual_of(board), start_here(board, false, true, true));
            for other in BOARDS.iter().filter(|other| *other != board) {
                assert!(
                    check(other, &manual, &start_here(other, false, true, true)).is_err(),
                    "{}",
                    other.name
                );
            }
            // A pin, a connector, a file, an instruction, a part: one of each that belongs to another board.
            let wrong = match board.name {
                "pico" => ["connect D3 to 3.3 V", "PB0", "UART4", "copy it with the ST-Link", "CN7-38"],
                "nucleo-g474re" => ["connect D3 to 3.3 V", "GP12", "hold BOOTSEL", "wsg-bridge.uf2", "LED2"],
                _ => ["connect CN7-38 to 3.3 V", "GP12", "hold BOOTSEL", "wsg-bridge.uf2", "STM32G474RE"],
            };
            for wrong in wrong {
                let manual = manual.replace("</body>", &format!("<p>{wrong}</p></body>"));
                assert!(check(board, &manual, &start).is_err(), "{}: {wrong}", board.name);
                let start = format!("{start}{wrong}");
                assert!(check(board, &manual_of(board), &start).is_err(), "{}: {wrong}", board.name);
            }
        }
    }

    #[test]
    fn manual_with_a_changed_pin_is_rejected() {
        for board in &BOARDS {
            let (manual, start) = (manual_of(board), start_here(board, false, true, true));
            for row in BoardWiring::of(board).wire_rows() {
                let [wire, pin, mcu] = row.map(|cell| cell.replace('`', ""));
                let right = format!("<td>{pin}</td><td>{mcu}</td>");
                assert!(manual.contains(&right), "{wire}");
                let wrong = manual.replace(&right, &format!("<td>X</td><td>{mcu}</td>"));
                assert!(check(board, &wrong, &start).is_err(), "{wire}");
            }
        }
    }

    #[test]
    fn each_manual_has_the_warnings_that_hold_for_its_board() {
        let halts = "at worst 400 ms";
        let profibus = "187.5 kbit/s at most";
        let clock = "not accurate enough for every bus";
        for (board, has, has_not) in [
            ("b-l475e-iot01a", &[clock][..], &[halts, profibus][..]),
            ("pico", &[halts, profibus], &[clock]),
            ("nucleo-g474re", &[], &[halts, profibus, clock]),
        ] {
            let manual = manual_of(Board::named(board).unwrap()).replace('\n', " ");
            for warning in has {
                assert!(manual.contains(warning), "{board} lacks: {warning}");
            }
            for warning in has_not {
                assert!(!manual.contains(warning), "{board} has: {warning}");
            }
        }
    }
}
