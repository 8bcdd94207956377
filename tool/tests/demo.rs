//! Runs `wsg demo` on ports that the system chooses.
#![cfg(unix)]

#[path = "common/program.rs"]
mod program;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Command, Stdio};

use document::read;
use program::{printed, wsg};
use rustix::process::{Pid, Signal, kill_process};

const FREE: [&str; 6] = ["--page", "localhost:0", "--tcp", "127.0.0.1:0", "--modbus", "127.0.0.1:0"];

#[test]
fn demo_plays_a_cycle_with_a_lost_part() {
    let output = wsg(&[&["demo", "--cycles", "1", "--speed-up", "50"], &FREE[..]].concat(), b"");
    let shown = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{shown}");
    // Without addresses and times.
    let lines: Vec<_> = shown.lines().skip(4).filter_map(|line| line.get(8..)).collect();
    assert_eq!(
        lines,
        [
            "HOME: the fingers search for their end stop",
            "referenced at 110.0 mm",
            "GRIP a part of 20.0 mm",
            "HOLDING at 19.6 mm with 40.0 N",
            "the part is pulled out",
            "PART LOST",
            "RELEASE to 60.0 mm",
            "IDLE at 60.0 mm",
            "GRIP a part of 20.0 mm",
            "HOLDING at 19.6 mm with 40.0 N",
            "RELEASE to 60.0 mm",
            "IDLE at 60.0 mm",
            "cycle 1 is complete",
        ]
    );
    // The quick start shows the first lines, with default addresses and real times.
    let text = read("docs/quick-start.md");
    let (_, block) = text.split_once("```console\n   page ").unwrap();
    let shown: Vec<_> = shown.lines().collect();
    let documented: Vec<_> = block.split("```").next().unwrap().lines().collect();
    assert_eq!(documented[3].trim(), shown[3]);
    let steps: Vec<_> = documented[4..].iter().filter_map(|line| line.get(11..)).collect();
    assert_eq!(steps, lines[..steps.len()]);
    assert_eq!(steps.len(), 3);
}

#[test]
fn demo_serves_its_page_and_modbus_until_ctrl_c() {
    let mut demo = Command::new(env!("CARGO_BIN_EXE_wsg"))
        .args([&["demo", "--speed-up", "50"], &FREE[..]].concat())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(demo.stdout.take().unwrap()).lines().map(Result::unwrap);
    let mut address = |word: &str| {
        let line = lines.next().unwrap();
        line.strip_prefix(word).unwrap_or_else(|| panic!("{line}")).trim().to_owned()
    };
    let page = address("page     http://");
    let (_, modbus) = (address("gripper  tcp://"), address("modbus   "));

    let mut client = TcpStream::connect(page.trim_end_matches('/')).unwrap();
    write!(client, "GET / HTTP/1.1\r\nHost: {}\r\nConnection: close\r\n\r\n", page.trim_end_matches('/'))
        .unwrap();
    let mut answer = String::new();
    client.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("<html"), "{answer}");

    // FC 4: GSTATE.
    let mut client = TcpStream::connect(modbus).unwrap();
    client.write_all(&[0, 1, 0, 0, 0, 6, 1, 4, 0, 0, 0, 1]).unwrap();
    let mut answer = [0; 11];
    client.read_exact(&mut answer).unwrap();
    assert_eq!(answer[..9], [0, 1, 0, 0, 0, 5, 1, 4, 2]);

    // The cycle repeats.
    assert!(lines.any(|line| line.ends_with("cycle 2 is complete")));
    let pid = Pid::from_child(&demo);
    kill_process(pid, Signal::INT).unwrap();
    let last = lines.last().unwrap();
    assert!(last.ends_with("  ended"), "{last}");
    assert_eq!(demo.wait().unwrap().code(), Some(0));
}

#[test]
fn wrong_option_or_address_is_refused_with_a_hint() {
    for (arguments, expected) in [
        (["--tpc", "localhost:0"], "a similar argument exists: '--tcp'"),
        (["--tcp", "bench:0"], "expected an address with a port, such as 127.0.0.1:8080 or localhost:0"),
    ] {
        let output = wsg(&[&["demo"], &arguments[..]].concat(), b"");
        assert_eq!(output.status.code(), Some(2));
        assert!(printed(&output).contains(expected), "{}", printed(&output));
    }
}

#[test]
fn demo_names_an_address_in_use() {
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
    let output = wsg(&[&["demo"], &FREE[2..], &["--page", &address]].concat(), b"");
    let shown = printed(&output);
    assert_eq!(output.status.code(), Some(1), "{shown}");
    assert!(shown.lines().count() == 1 && shown.contains(&address) && shown.contains("--page"), "{shown}");
}
