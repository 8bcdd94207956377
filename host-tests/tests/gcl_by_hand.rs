//! Runs the conversation in docs/gcl.md, "By hand", against a real server of `wsg-sim`: over a bare socket and with
//! `nc`, which replaces the PuTTY of the manual's chapter 1.4.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// Time limit of every wait.
const BOUND: Duration = Duration::from_secs(60);

/// Starts the simulator as the document does (`wsg-sim --gcl ... --part 20`), with faster fingers.
fn serve() -> ServerThread {
    let config = Config { part: Part::of_width(20.0), time_scale: 20.0, ..Config::default() };
    let lines = Lines { gcl: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
    ServerThread::start(config, &lines, None).expect("the server starts")
}

/// Sends each received line to a channel, which ends with the input.
fn lines_of(from: impl Read + Send + 'static) -> Receiver<String> {
    let (line, lines) = channel();
    thread::spawn(move || {
        for text in BufReader::new(from).lines().map_while(Result::ok) {
            if line.send(text).is_err() {
                return;
            }
        }
    });
    lines
}

/// Types the lines of the document and compares the answers with it.
fn converse(mut keyboard: impl Write, screen: &Receiver<String>, line_end: &str) {
    let text = document::read("docs/gcl.md");
    let blocks: Vec<&str> =
        text.split("```nc\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    let [conversation] = blocks[..] else { panic!("docs/gcl.md must have exactly one `nc` block") };
    let mut count = 0;
    for line in conversation.lines() {
        count += 1;
        match line.split_once(' ') {
            Some((">", typed)) => keyboard.write_all(format!("{typed}{line_end}").as_bytes()).unwrap(),
            Some(("<", shown)) => {
                assert_eq!(screen.recv_timeout(BOUND).as_deref(), Ok(shown), "line {count}")
            }
            _ => panic!("expected `> typed` or `< shown`: {line}"),
        }
    }
    assert!(count > 10, "{count} lines");
}

/// Returns whether the gripper treated the end of the conversation as an error.
fn is_in_fast_stop(address: SocketAddr) -> bool {
    let mut stream = TcpStream::connect_timeout(&address, BOUND).unwrap();
    let screen = lines_of(stream.try_clone().unwrap());
    stream.write_all(b"SYSFLAGS[12]?\n").unwrap();
    let flag = screen.recv_timeout(BOUND).expect("an answer within the time limit");
    stream.write_all(b"BYE()\n").unwrap();
    assert_eq!(screen.recv_timeout(BOUND).as_deref(), Ok("ACK BYE"));
    flag == "SYSFLAGS[12]=1"
}

#[test]
fn conversation_by_hand_over_a_bare_socket() {
    // The bytes that Enter sends in `nc`, in PuTTY and in telnet.
    for line_end in ["\n", "\r", "\r\n"] {
        let served = serve();
        let address = served.gcl_address().unwrap();
        let stream = TcpStream::connect_timeout(&address, BOUND).unwrap();
        converse(stream.try_clone().unwrap(), &lines_of(stream.try_clone().unwrap()), line_end);
        stream.shutdown(std::net::Shutdown::Both).unwrap();
        assert!(!is_in_fast_stop(address), "{line_end:?}");
    }
}

#[test]
#[ignore = "needs nc (Debian: netcat-openbsd)"]
fn conversation_by_hand_with_nc() {
    let served = serve();
    let address = served.gcl_address().unwrap();
    let mut nc = Command::new("nc")
        .args([address.ip().to_string(), address.port().to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("nc must be installed");
    let screen = lines_of(nc.stdout.take().unwrap());
    converse(nc.stdin.as_mut().unwrap(), &screen, "\n");
    // Ctrl-C has the same effect.
    nc.kill().unwrap();
    nc.wait().unwrap();
    assert!(!is_in_fast_stop(address));
}
