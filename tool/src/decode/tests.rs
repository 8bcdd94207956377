//! Whole recordings, compared with the files in `golden/`. `WSG_UPDATE_DOCS=1` rewrites them.

use clap::Parser;
use document::hold_file;
use proptest::prelude::*;
use wsg_protocol::{Command, FrameEncoder};

use self::capture_file::{CLIENT, Capture, Connection, GRIPPER};
use super::*;

#[path = "../../tests/common/capture.rs"]
mod capture_file;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    arguments: Arguments,
}

fn shown(bytes: &[u8], options: &[&str]) -> String {
    let line = Line::try_parse_from([&["wsg"], options].concat()).unwrap();
    let entries = decode(bytes.to_vec(), &line.arguments).unwrap();
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
fn script_commands_are_named_and_their_answers_may_have_any_form() {
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
fn truncated_message_and_duplicated_frame_on_can_affect_only_their_own_messages() {
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

/// A capture of a TCP connection with split, reordered, retransmitted and missing segments, of datagrams and of other packets.
fn capture() -> Vec<u8> {
    let grip = request(GRIP);
    let pending = reply(0x25, &[26, 0]);
    let width = reply(0x43, &[0, 0, 0, 0, 0xA0, 0x41]);
    let mut capture = Capture::new();
    let connection = Connection::open(&mut capture, 1_000);
    let mut tcp = |to_gripper, sequence, acknowledged, payload: &[u8]| {
        connection.segment(&mut capture, to_gripper, sequence, Some(acknowledged), false, payload);
    };
    tcp(true, 1_000, 5_000, &grip[..5]);
    tcp(true, 1_000, 5_000, &grip[..5]);
    tcp(true, 1_005, 5_000, &grip[5..]);
    tcp(false, 5_010, 1_016, &width);
    tcp(false, 5_000, 1_016, &pending);
    // 14 bytes from the gripper are missing.
    tcp(false, 5_038, 1_016, &width);
    tcp(true, 1_016, 5_052, &request(Command::Stop));
    capture.udp((CLIENT, 50_000), (GRIPPER, 1_500), &request(Command::Stop));
    capture.udp((GRIPPER, 1_500), (CLIENT, 1_501), &reply(0x22, &[0, 0]));
    capture.udp((CLIENT, 50_001), (GRIPPER, 53), b"\x00\x01who is there");
    capture.packet(&[0xFF; 20]);
    capture.into_file()
}

#[test]
fn tcp_is_shown_in_order_without_retransmissions_and_udp_by_datagram() {
    hold("capture.txt", &shown(&capture(), &[]));
    let by_port = shown(&capture(), &["--port", "53"]);
    assert!(by_port.contains("without a gripper, on port 1000, 1500"), "{by_port}");
}

/// Splits a file made by [`Capture`] into packets: seconds, microseconds, bytes.
fn packets(file: &[u8]) -> Vec<(u32, u32, Vec<u8>)> {
    let mut rest = &file[24..];
    let mut packets = Vec::new();
    while !rest.is_empty() {
        let word = |at: usize| u32::from_le_bytes(rest[at..at + 4].try_into().unwrap());
        let len = word(8) as usize;
        packets.push((word(0), word(4), rest[16..16 + len].to_vec()));
        rest = &rest[16 + len..];
    }
    packets
}

#[test]
fn pcapng_and_pcap_of_either_byte_order_and_resolution_are_equivalent() {
    let expected = shown(&capture(), &[]);
    let packets = packets(&capture());
    let padded = |bytes: &[u8]| [bytes, &vec![0; bytes.len().next_multiple_of(4) - bytes.len()]].concat();
    let block = |kind: u32, body: &[u8]| {
        let len = (12 + body.len() as u32).to_le_bytes();
        [&kind.to_le_bytes()[..], &len, body, &len].concat()
    };
    let mut ng =
        block(0x0A0D_0D0A, &[0x4D, 0x3C, 0x2B, 0x1A, 1, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]);
    // Ethernet, with nanosecond time stamps.
    ng.extend(block(1, &[1, 0, 0, 0, 0, 0, 4, 0, 9, 0, 1, 0, 9, 0, 0, 0, 0, 0, 0, 0]));
    let mut nanoseconds =
        vec![0xA1, 0xB2, 0x3C, 0x4D, 0, 2, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 1];
    for (seconds, micros, bytes) in &packets {
        let ticks = u64::from(*seconds) * 1_000_000_000 + u64::from(*micros) * 1_000;
        let words = [0, (ticks >> 32) as u32, ticks as u32, bytes.len() as u32, bytes.len() as u32];
        let head: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        ng.extend(block(6, &[head, padded(bytes)].concat()));
        let words = [*seconds, micros * 1_000, bytes.len() as u32, bytes.len() as u32];
        nanoseconds.extend(words.iter().flat_map(|word| word.to_be_bytes()));
        nanoseconds.extend(bytes);
    }
    assert_eq!(shown(&ng, &[]), expected);
    assert_eq!(shown(&nanoseconds, &[]), expected);
}

#[test]
fn every_link_type_that_carries_ip_is_equivalent() {
    let expected = shown(&capture(), &[]);
    // The link-layer header that replaces the Ethernet header.
    let links: [(u32, &[u8]); 5] = [
        (0, &[2, 0, 0, 0]),
        (101, &[]),
        (108, &[0, 0, 0, 2]),
        (113, &[0, 0, 0, 1, 0, 6, 2, 2, 2, 2, 2, 2, 0, 0, 0x08, 0x00]),
        (276, &[0x08, 0x00, 0, 0, 0, 0, 0, 2, 0, 1, 0, 6, 2, 2, 2, 2, 2, 2, 0, 0]),
    ];
    for (link, before) in links {
        let mut file = capture()[..20].to_vec();
        file.extend(link.to_le_bytes());
        for (seconds, micros, bytes) in packets(&capture()) {
            let bytes = [before, &bytes[14..]].concat();
            let len = bytes.len() as u32;
            file.extend([seconds, micros, len, len].iter().flat_map(|word| word.to_le_bytes()));
            file.extend(bytes);
        }
        assert_eq!(shown(&file, &[]), expected, "{link}");
    }
}

#[test]
fn truncated_capture_is_shown_up_to_its_end() {
    let whole = capture();
    for len in 0..whole.len() {
        let Ok(entries) = decode(whole[..len].to_vec(), &arguments()) else { continue };
        let last = entries.last().map_or(String::new(), |entry| entry.words.clone());
        let is_reported = last.contains("truncated or corrupted after packet");
        let is_between_packets = !is_reported && len > 24;
        assert!(is_reported || is_between_packets || len <= 24, "{len}: {last}");
    }
}

#[test]
fn file_in_another_format_is_rejected_as_a_capture() {
    let line = Line::try_parse_from(["wsg", "--format", "capture"]).unwrap();
    let error = decode(session(), &line.arguments).unwrap_err();
    assert_eq!(error.to_string(), "not a capture file; expected pcap or pcapng");
}

fn arguments() -> Arguments {
    Line::try_parse_from(["wsg"]).unwrap().arguments
}

proptest! {
    #[test]
    fn garbage_never_panics(bytes in prop::collection::vec(any::<u8>(), 1..600)) {
        for format in ["auto", "hex", "sim", "candump", "raw"] {
            shown(&bytes, &["--format", format]);
        }
        shown(&bytes, &["--protocol", "gcl"]);
    }

    #[test]
    fn damaged_capture_never_panics(
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        is_ng in any::<bool>(),
    ) {
        let mut bytes = capture();
        for (at, byte) in damage {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if is_ng {
            bytes[..4].copy_from_slice(&[0x0A, 0x0D, 0x0D, 0x0A]);
        }
        // An error is acceptable as well.
        let _ = decode(bytes, &arguments());
    }

    #[test]
    fn arbitrary_text_never_panics(text in "([0-9A-Fa-fxR#\\[\\]():. <>s*|-]|can0 120#| -> AA AA AA |\n){1,200}") {
        for format in ["auto", "hex", "sim", "candump"] {
            shown(text.as_bytes(), &["--format", format]);
        }
    }
}
