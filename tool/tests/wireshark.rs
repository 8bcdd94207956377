//! Runs the dissector `wireshark/wsg.lua` in `tshark` on generated captures and checks its output.

#[path = "common/capture.rs"]
mod capture;

use std::path::Path;
use std::process::Command as Program;

use capture::{CLIENT, Capture, Connection, GRIPPER};
use wsg_protocol::{Command, CommandId, Direction, Frame, FrameEncoder, HomingDirection, Meaning};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};

/// Runs `tshark` and returns these fields, one line for each packet that has the first of them. `|` separates fields, `;` the
/// values of a field.
fn tshark(name: &str, capture: Capture, options: &[&str], fields: &[&str]) -> Vec<String> {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.pcap"));
    std::fs::write(&file, capture.into_file()).unwrap();
    let script = format!("lua_script:{}/wireshark/wsg.lua", env!("CARGO_MANIFEST_DIR"));
    let mut tshark = Program::new("tshark");
    // Ignore the settings and plugins of the current user.
    tshark.env("HOME", env!("CARGO_TARGET_TMPDIR")).env_remove("XDG_CONFIG_HOME").env("LC_ALL", "C.UTF-8");
    tshark.args(["-X", &script, "-n", "-r"]).arg(&file).args(["-Y", fields[0]]).args(options);
    tshark.args(["-T", "fields", "-E", "separator=|", "-E", "aggregator=;", "-E", "occurrence=a"]);
    for field in fields {
        tshark.args(["-e", field]);
    }
    let output = tshark
        .output()
        .unwrap_or_else(|error| panic!("tshark does not start ({error}): run `cargo xtask test`"));
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !printed.to_lowercase().contains("lua"), "{printed}");
    String::from_utf8(output.stdout).unwrap().lines().map(str::to_owned).collect()
}

fn encoded(id: u8, payload: &[u8]) -> Vec<u8> {
    FrameEncoder::new(id, payload).collect()
}

fn request(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

/// Payloads of every kind of request and reply, both valid and invalid.
fn payloads() -> Vec<Vec<u8>> {
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let mut payloads = vec![
        vec![],
        b"ack".to_vec(),
        b"Ack".to_vec(),
        b"cell 4\0\0".to_vec(),
        "cell \u{b5}".as_bytes().to_vec(),
        b"cell\t4".to_vec(),
        vec![b'x'; 64],
        vec![b'x'; 65],
        vec![7; 256],
        vec![7; 257],
        floats(&[20.0]),
        floats(&[20.05, 49.95]),
        floats(&[-0.04, f32::MAX]),
        floats(&[f32::NAN, 1.0]),
        floats(&[f32::INFINITY]),
        [vec![3], floats(&[20.0, 50.0])].concat(),
        [vec![4], floats(&[20.0, 50.0])].concat(),
        floats(&[110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0]),
        vec![3, 10, 0],
        vec![1, 0x64, 0],
        vec![2, 1, 0],
        vec![5, 1, 0],
        vec![1, 2, 0x00, 0x40, 0xFF, 0xFF, 0xFF, 0xFF],
        vec![9, 2, 0x12, 0x54, 1, 0, 0, 0x80],
        vec![0x09, 0x10, 0x00, 0x80],
        vec![0x38, 0xFF],
        vec![0x03, 0x14],
        vec![9, 4, 0],
    ];
    payloads.extend((0..=40usize).map(|len| vec![0; len]));
    payloads.extend((0..=8u8).map(|byte| vec![byte]));
    payloads
}

#[test]
#[ignore = "needs tshark: run `cargo xtask test`"]
fn tshark_describes_every_request_and_reply_as_the_crate_does() {
    let mut capture = Capture::new();
    let mut expected = Vec::new();
    let mut add = |direction, id: u8, payload: &[u8]| {
        let meaning = Meaning { direction, frame: Frame { id, payload } };
        expected.push(format!("{meaning}|{}", u8::from(direction == Direction::ToGripper)));
        let (from, to) = match direction {
            Direction::ToGripper => ((CLIENT, 50_000), (GRIPPER, 1_500)),
            Direction::FromGripper => ((GRIPPER, 1_500), (CLIENT, 1_501)),
        };
        capture.udp(from, to, &encoded(id, payload));
    };
    let ids = CommandId::ALL.iter().copied().chain([CommandId::Unknown(0xA0)]);
    for id in ids.map(CommandId::code) {
        for payload in payloads() {
            add(Direction::ToGripper, id, &payload);
            add(Direction::FromGripper, id, &[&[0, 0][..], &payload].concat());
        }
        for status in [vec![], vec![26], vec![26, 0], vec![18, 0], vec![31, 0], vec![18, 0, 1]] {
            add(Direction::FromGripper, id, &status);
        }
    }

    let shown = tshark("words", capture, &[], &["wsg.meaning", "wsg.request"]);

    assert_eq!(shown.len(), expected.len());
    for (shown, expected) in shown.iter().zip(&expected) {
        assert_eq!(shown, expected);
    }
}

/// Runs a session with the virtual gripper: requests, each with its replies.
fn session() -> Vec<(Vec<u8>, Vec<Vec<u8>>)> {
    let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
    let mut gripper: VirtualGripper = VirtualGripper::new(config);
    let port = gripper.connect(PortKind::Tcp).unwrap();
    let mut now = Time::ZERO;
    let commands = [
        Command::ACKNOWLEDGE,
        Command::Homing { direction: HomingDirection::Default },
        Command::GetSystemLimits,
        Command::SetForceLimit { force: 40.0 },
        Command::GripPart { width: 20.0, speed: 50.0 },
        Command::GetOpeningWidth { update: wsg_protocol::AutoUpdate::once() },
        Command::ReleasePart { width: 40.0, speed: 50.0 },
        Command::GetSystemState { update: wsg_protocol::AutoUpdate::once() },
        Command::DisconnectAnnouncement,
    ];
    let mut buffer = [0; MAX_FRAME_LEN];
    commands
        .into_iter()
        .map(|command| {
            let frame = request(command);
            gripper.receive(port, now, &frame);
            let mut replies = Vec::new();
            for _ in 0..5_000 {
                while let Some(reply) = gripper.transmit(port, &mut buffer) {
                    replies.push(reply.to_vec());
                }
                if replies.last().is_some_and(|reply| reply[6..8] != [26, 0]) {
                    break;
                }
                now = now.plus_millis(1);
                gripper.advance(now);
            }
            (frame, replies)
        })
        .collect()
}

fn meaning(direction: Direction, frame: &[u8]) -> String {
    let frame = Frame { id: frame[3], payload: &frame[6..frame.len() - 2] };
    Meaning { direction, frame }.to_string()
}

/// Captures the session over TCP to this port, in segments of at most `most` bytes. Also returns its description.
fn on_tcp(port: u16, most: usize) -> (Capture, Vec<String>) {
    let mut capture = Capture::new();
    let mut connection = Connection::open(&mut capture, port);
    let mut words = Vec::new();
    for (request, replies) in session() {
        connection.send(&mut capture, true, &request, most);
        words.push(meaning(Direction::ToGripper, &request));
        words.extend(replies.iter().map(|reply| meaning(Direction::FromGripper, reply)));
        connection.send(&mut capture, false, &replies.concat(), most);
    }
    assert!(words.iter().any(|it| it == "25h Grip Part E_SUCCESS"), "{words:?}");
    (capture, words)
}

fn flat(shown: &[String]) -> Vec<String> {
    shown.iter().flat_map(|line| line.split(';')).map(str::to_owned).collect()
}

#[test]
#[ignore = "needs tshark: run `cargo xtask test`"]
fn tshark_reassembles_frames_from_segments() {
    // Segments of 3 bytes split preamble, header and checksum.
    let (capture, words) = on_tcp(1_000, 3);
    let shown = tshark("segments", capture, &[], &["wsg.meaning", "wsg.checksum.right"]);
    let (meanings, right): (Vec<_>, Vec<_>) = shown.iter().filter_map(|line| line.rsplit_once('|')).unzip();
    let meanings: Vec<String> = meanings.into_iter().map(str::to_owned).collect();
    assert_eq!(flat(&meanings), words);
    assert!(right.iter().all(|right| right.split(';').all(|right| right == "1")), "{right:?}");
}

#[test]
#[ignore = "needs tshark: run `cargo xtask test`"]
fn tshark_finds_gripper_on_another_port_by_heuristic_or_setting() {
    let (capture, words) = on_tcp(39_123, 1_400);
    assert_eq!(flat(&tshark("heuristic", capture, &[], &["wsg.meaning"])), words);
    let (capture, words) = on_tcp(39_123, 3);
    let options = ["-o", "wsg.tcp_port:39123"];
    assert_eq!(flat(&tshark("setting", capture, &options, &["wsg.meaning"])), words);
}

#[test]
#[ignore = "needs tshark: run `cargo xtask test`"]
fn tshark_marks_damage_and_noise_and_finds_frames_inside() {
    let mut damaged = encoded(0x25, &[26, 0]);
    damaged[8] ^= 1;
    let stop = encoded(0x22, &[0, 0]);
    let hiding = [&[0xAA, 0xAA, 0xAA, 0x25, 20, 0, 7][..], &stop, &[0; 30]].concat();
    let too_long = [&[0xAA, 0xAA, 0xAA, 0x25, 0xFF, 0xFF][..], &stop].concat();
    let mut capture = Capture::new();
    for datagram in
        [&damaged[..], &[&[1, 2, 3][..], &stop].concat(), &stop[..9], &hiding, &too_long, &[0xAA, 0xAA], &[7]]
    {
        capture.udp((GRIPPER, 1_500), (CLIENT, 1_501), datagram);
    }

    let shown = tshark("damaged", capture, &[], &["wsg", "wsg.meaning", "wsg.dropped", "_ws.expert.message"]);

    let shown: Vec<_> = shown.iter().map(|line| line.split_once('|').map_or("", |(_, rest)| rest)).collect();
    let expected = [
        "[wrong checksum] 25h Grip Part E_CMD_PENDING||Wrong checksum, expected 6D 48",
        "22h Stop E_SUCCESS|010203|No preamble",
        "|aaaaaa2202000000a7|Truncated frame",
        "[wrong checksum] 25h Grip Part: payload too long;22h Stop E_SUCCESS|ZEROS|Wrong checksum, expected 86 B3;Payload not permitted by the manual;No preamble",
        "22h Stop E_SUCCESS|aaaaaa25ffff|No preamble",
        "|aaaa|Truncated frame",
        "|07|No preamble",
    ];
    assert_eq!(shown, expected.map(|line| line.replace("ZEROS", &"00".repeat(30))));
}

#[test]
#[ignore = "needs tshark: run `cargo xtask test`"]
fn tshark_shows_lines_of_gcl_with_the_status_of_errors() {
    let mut capture = Capture::new();
    let mut connection = Connection::open(&mut capture, 1_000);
    connection.send(&mut capture, true, b"VERBOSE=1\r\nGRIP(20,50)\n", 4);
    connection.send(&mut capture, false, b"VERBOSE=1\nACK GRIP\nERR GRIP 18 failed\n@POS=20.5\n", 7);
    connection.send(&mut capture, true, b"DANCE()\n", 100);
    connection.send(&mut capture, false, b"ERR DANCE 14\n", 100);

    let shown =
        tshark("gcl", capture, &[], &["gcl.line", "gcl.name", "gcl.kind", "gcl.status", "gcl.request"]);

    let expected = [
        "VERBOSE=1|VERBOSE|setting||1",
        "GRIP(20,50)|GRIP|motion||1",
        "VERBOSE=1|VERBOSE|setting||0",
        "ACK GRIP|GRIP|motion||0",
        "ERR GRIP 18 failed|GRIP|motion|18|0",
        "@POS=20.5|POS|query||0",
        "DANCE()|DANCE|||1",
        "ERR DANCE 14|DANCE||14|0",
    ];
    assert_eq!(shown, expected);
}
