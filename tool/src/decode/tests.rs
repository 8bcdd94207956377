//! Whole recordings, compared with the files in `golden/`. `WSG_UPDATE_DOCS=1` rewrites them.

use clap::Parser;
use document::hold_file;
use proptest::prelude::*;
use wsg_protocol::{Command, FrameEncoder};

use super::*;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    arguments: Arguments,
}

fn decoded(bytes: &[u8], options: &[&str]) -> Result<Vec<Entry>> {
    let line = Line::try_parse_from([&["wsg"], options].concat()).unwrap();
    decode(bytes.to_vec(), &line.arguments)
}

fn shown(bytes: &[u8], options: &[&str]) -> String {
    let entries = decoded(bytes, options).unwrap();
    entries.iter().map(|entry| format!("{entry}\n")).collect::<String>() + &summary(&entries) + "\n"
}

/// Compares the output with the golden file of this name.
fn hold(name: &str, shown: &str) {
    hold_file(&format!("tool/src/decode/golden/{name}"), shown);
}

fn request(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

fn reply(id: u8, payload: &[u8]) -> Vec<u8> {
    FrameEncoder::new(id, payload).collect()
}

const GRIP: Command<'static> = Command::GripPart { width: 20.0, speed: 50.0 };

/// A session with noise: a request, its answers, a corrupted frame, and a truncated frame at the end.
fn session() -> Vec<u8> {
    let mut damaged = reply(0x43, &[0, 0, 0, 0, 0xA0, 0x41]);
    damaged[10] ^= 0x10;
    [
        request(GRIP),
        reply(0x25, &[26, 0]),
        vec![0x00, 0x17, 0xFF],
        damaged,
        reply(0x25, &[0, 0]),
        reply(0x06, b"ab"),
        reply(0x25, &[1]),
        request(Command::Stop)[..7].to_vec(),
    ]
    .concat()
}

#[test]
fn session_in_one_stream() {
    let raw = shown(&session(), &[]);
    hold("session.txt", &raw);
    let digits: String = session().iter().map(|byte| format!("{byte:02x} ")).collect();
    assert_eq!(shown(digits.as_bytes(), &[]), raw);
    let c_array: String = session().iter().map(|byte| format!("0x{byte:02X}, ")).collect();
    assert_eq!(shown(c_array.as_bytes(), &["--format", "hex"]), raw);
}

#[test]
fn given_direction_resolves_an_ambiguous_frame() {
    let loop_back = reply(0x06, &[0, 0, b'a']);
    let by_itself = shown(&loop_back, &[]);
    assert!(by_itself.contains("--  06h Loop 3 bytes, or 06h Loop E_SUCCESS 1 byte"), "{by_itself}");
    let to = shown(&loop_back, &["--direction", "to"]);
    assert!(to.contains("->  06h Loop 3 bytes\n"), "{to}");
}

#[test]
fn script_commands_are_named_and_answers_may_have_any_form() {
    let frames = [reply(0xA0, &[1, 2]), reply(0xBF, &[]), reply(0x9F, &[])].concat();
    let to = shown(&frames, &["--direction", "to"]);
    for words in [
        "->  A0h script command 2 bytes\n",
        "->  BFh script command 0 bytes\n",
        "->  9Fh unknown command 0 bytes\n",
    ] {
        assert!(to.contains(words), "{to}");
    }
    let answers = [reply(0xA0, &[0, 0, 7]), reply(0xB0, &[1, 0, 7])].concat();
    let from = shown(&answers, &["--direction", "from"]);
    assert!(from.contains("<-  A0h script command E_SUCCESS 1 byte"), "{from}");
    assert!(from.contains("<-  B0h script command 3 bytes\n"), "{from}");
}

#[test]
fn text_of_gcl() {
    let text = "VERBOSE=1\nHOME()\r\nACK HOME\r\nFIN HOME\nGRIP(20,50)\nERR GRIP 18 command failed\n\
                @POS=20.5\nPOS?\nPOS=20.5\nDANCE(1)\nERR DANCE 14\nBYE()\n";
    hold("gcl.txt", &shown(text.as_bytes(), &[]));
}

#[test]
fn truncated_or_duplicated_can_frame_affects_only_its_message() {
    let log = "(1.000000) can0 120#AAAAAA2508000000\n\
               (1.001000) can0 121#AAAAAA2502000000\n\
               (1.001100) can0 121#2287\n\
               (2.000000) can0 120#AAAAAA2200000E76\n\
               (2.000100) can0 120#AAAAAA2508000000\n\
               (2.000200) can0 120#AAAAAA2508000000\n\
               (2.000300) can0 120#A04100004842AA1E\n\
               (2.500000) can0 120#0011\n\
               (3.000000) can0 7FF#00\n\
               what is this\n";
    let at_delivered = shown(log.as_bytes(), &[]);
    hold("candump.txt", &at_delivered);
    let elsewhere = shown(log.replace(" 12", " 34").as_bytes(), &[]);
    assert_eq!(elsewhere, at_delivered.replace("120h", "340h").replace("121h", "341h"));
    let none = shown(log.as_bytes(), &["--can-id", "0x200"]);
    assert!(none.contains("skipped 9 CAN frames with other identifiers"), "{none}");
}

#[test]
fn log_of_the_simulator() {
    let log = "0.000100 s tcp 127.0.0.1:40000 connected\n\
               0.001000 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 0E 76 22h Stop\n\
               0.002000 s tcp 127.0.0.1:40000 -> AA AA AA 22 00 00 00 00 22h Stop\n\
               0.003000 s gcl 127.0.0.1:40001 -> POS?\n\
               0.004000 s gcl 127.0.0.1:40001 <- POS=20.5\n\
               0.005000 s modbus 127.0.0.1:40002 -> 00 01 00 00 00 06 01 04 00 00 00 06 FC 4 ReadInputRegisters\n";
    hold("sim_log.txt", &shown(log.as_bytes(), &[]));
}

fn status_of(bytes: &[u8], options: &[&str]) -> u8 {
    status(&decoded(bytes, options).unwrap())
}

#[test]
fn text_in_no_known_format_is_rejected_with_the_accepted_ones() {
    let syslog = "Nov 28 10:00:01 plc gripper: connected\nNov 28 10:00:02 plc gripper: GRIP(20,50) sent\n";
    let mostly_prose = "POS=20.5\nthe gripper answers\nwidth is fine\nand the force as well\n";
    let octal_words = "0000000 125252 021252 000000 073016\n0000010\n";
    for text in [syslog, mostly_prose, octal_words, "\0\u{1}\u{2}", "x=1\ny=2\n"] {
        let error = decoded(text.as_bytes(), &[]).unwrap_err().to_string();
        assert!(error.starts_with("unknown format; expected a hex dump, a candump log, "), "{text}: {error}");
    }
    let utf_16: Vec<u8> = "AA AA".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let error = format!("{:#}", decoded(&[&[0xFF, 0xFE][..], &utf_16].concat(), &[]).unwrap_err());
    assert_eq!(error, "cannot read the recording: the text is UTF-16; save it as UTF-8");
}

#[test]
fn capture_is_left_to_wireshark() {
    for start in CAPTURES {
        let error = decoded(&[&start[..], &session()].concat(), &[]).unwrap_err().to_string();
        assert!(error.contains("this is a capture (pcap); open it in Wireshark"), "{error}");
    }
}

#[test]
fn nothing_is_joined_across_a_line_that_cannot_be_read() {
    let hex = "AA AA AA 25 08 00\n00 00 what A0 41\n00 00 48 42 AA 1E\n";
    let can = "can0 120#AAAAAA2508000000\ncan0 120#A0410Z\ncan0 120#A04100004842AA1E\n";
    for (text, line) in [
        (hex, "cannot read line 2: not in hex dump format"),
        (can, "cannot read line 2: not in candump format"),
    ] {
        let output = shown(text.as_bytes(), &[]);
        assert!(output.contains(line) && output.contains("0 intact frames"), "{output}");
        assert!(output.trim_end().ends_with(", 1 part not read"), "{output}");
    }
    assert!(shown(can.as_bytes(), &[]).contains("its rest may be in a line that could not be read"));
}

#[test]
fn status_is_success_only_if_everything_was_read() {
    let stop = "AA AA AA 22 00 00 0E 76\n";
    let can = "can0 120#AAAAAA2200000E76\n";
    let log = "1.0 s tcp 127.0.0.1:1 connected\n1.1 s tcp 127.0.0.1:1 -> AA AA AA 22 00 00 0E 76  22h Stop\n";
    for (text, expected) in [
        (stop.to_owned(), 0),
        (format!("# from the PLC\n{stop}\n{stop}"), 0),
        (format!("{stop}what\n{stop}"), 1),
        (format!("\u{FEFF}{stop}"), 0),
        (can.to_owned(), 0),
        (format!("{can}can0 120##1AA\n{can}"), 1),
        (log.to_owned(), 0),
        (format!("{log}panicked at main.rs\n"), 1),
        ("POS?\nPOS=20.5\n".to_owned(), 0),
        ("POS?\nPOS=20.5\nthe part is gone\n".to_owned(), 1),
        ("00 01 02\n".to_owned(), 1),
    ] {
        assert_eq!(status_of(text.as_bytes(), &[]), expected, "{text}");
    }
    assert_eq!(status_of(b"hello\n", &["--protocol", "gcl"]), 1);
}

#[test]
fn text_of_a_recording_cannot_command_the_terminal() {
    let log = "1.0 s \u{1b}[2J connected\n1.1 s x\u{1b}[1m -> wrong checksum: \u{7} bytes of payload\n";
    let can = "(1.000000) c\u{1b}[2J 120#AAAAAA2200000E76\n";
    for text in [log, can] {
        let output = shown(text.as_bytes(), &[]);
        assert!(output.contains("\\u{1b}[2J"), "{output}");
        assert!(!output.contains(|char: char| char.is_control() && char != '\n'), "{output}");
    }
}

proptest! {
    #[test]
    fn garbage_never_panics(bytes in prop::collection::vec(any::<u8>(), 1..600)) {
        for format in ["auto", "hex", "sim", "candump", "raw"] {
            // An error is acceptable as well.
            let _ = decoded(&bytes, &["--format", format]);
        }
        let _ = decoded(&bytes, &["--protocol", "gcl"]);
    }

    #[test]
    fn arbitrary_text_never_panics(text in "([0-9A-Fa-fxR#\\[\\]():. <>s*|-]|can0 120#| -> AA AA AA |\n){1,200}") {
        for format in ["auto", "hex", "sim", "candump"] {
            let _ = decoded(text.as_bytes(), &["--format", format]);
        }
    }
}
