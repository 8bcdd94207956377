//! A broker whose other clients send anything. It speaks just enough MQTT, so that no other program is needed.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    process::{Command as Process, Stdio},
    sync::mpsc,
    thread,
};

use crate::rig::{Folder, PATIENCE, Running, wait_for};

/// Reads one packet and returns its body.
fn packet(stream: &mut TcpStream) -> Vec<u8> {
    let mut byte = [0];
    stream.read_exact(&mut byte).unwrap();
    let (mut len, mut shift) = (0, 0);
    loop {
        stream.read_exact(&mut byte).unwrap();
        len |= usize::from(byte[0] & 0x7F) << shift;
        shift += 7;
        if byte[0] & 0x80 == 0 {
            break;
        }
    }
    let mut body = vec![0; len];
    stream.read_exact(&mut body).unwrap();
    body
}

fn publish(topic: &str) -> Vec<u8> {
    let len = u8::try_from(topic.len()).unwrap();
    [&[0x30, len + 2, 0, len], topic.as_bytes()].concat()
}

#[test]
fn topics_are_logged_in_one_line_without_control_characters() {
    let folder = Folder::new();
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let text = format!(
        "[broker]\naddress = \"mqtt://{}\"\n[node]\ngroup = \"plant\"\nname = \"cell\"\nstate_file = {:?}\n\
         [[gripper]]\nname = \"left\"\naddress = \"serial:/nowhere\"\n",
        listener.local_addr().unwrap(),
        folder.path("state"),
    );
    let mut telemetry = Process::new(env!("CARGO_BIN_EXE_wsg"));
    telemetry.arg("telemetry").arg(folder.write("cell.toml", &text)).stderr(Stdio::piped());
    let mut telemetry = Running(telemetry.spawn().unwrap());
    let stderr = BufReader::new(telemetry.0.stderr.take().unwrap());
    let (sender, lines) = mpsc::channel();
    thread::spawn(move || stderr.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));

    listener.set_nonblocking(true).unwrap();
    let mut stream = wait_for("the connection", || listener.accept().ok()).0;
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    packet(&mut stream);
    stream.write_all(&[0x20, 2, 0, 0]).unwrap();
    let subscribe = packet(&mut stream);
    stream.write_all(&[0x90, 4, subscribe[0], subscribe[1], 1, 1]).unwrap();
    let topic = "spBv1.0/plant/DCMD/cell/\x1b[2Jx\u{202e}\r\nwsg: command on forged: Home";
    stream.write_all(&publish(topic)).unwrap();
    stream.write_all(&publish("spBv1.0/plant/DCMD/cell/last")).unwrap();

    let next = || lines.recv_timeout(PATIENCE).expect("the program logs both topics");
    let lines: Vec<String> =
        std::iter::repeat_with(next).take_while(|line| !line.contains("cell/last")).collect();
    let forged: Vec<&String> = lines.iter().filter(|line| line.contains("forged")).collect();
    let expected = r"wsg: command on spBv1.0/plant/DCMD/cell/\u{1b}[2Jx\u{202e}\r\nwsg: command on forged: Home refused: ";
    assert!(matches!(forged[..], [line] if line.starts_with(expected)), "{lines:?}");
}
