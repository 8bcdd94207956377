//! docs/gcl.md, "By hand": the conversation of the document with a real `wsg-sim`'s server, over a bare socket and with
//! `nc`, as the manual's chapter 1.4 has it with PuTTY.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

/// The longest that anything may take here.
const BOUND: Duration = Duration::from_secs(60);

/// What the document starts: `wsg-sim --gcl ... --part 20`, but for the time that the fingers take.
fn serve() -> ServerThread {
    let config = Config { part: Part::of_width(20.0), time_scale: 20.0, ..Config::default() };
    let lines = Lines { gcl: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
    ServerThread::start(config, &lines, None).expect("the server is up")
}

/// Lines as they come; the channel ends where they do.
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

/// Types what the document types, and holds what comes to what it shows.
fn converse(mut keyboard: impl Write, screen: &Receiver<String>, line_end: &str) {
    let text = document::read("docs/gcl.md");
    let blocks: Vec<&str> =
        text.split("```nc\n").skip(1).filter_map(|rest| rest.split("```").next()).collect();
    let [conversation] = blocks[..] else { panic!("the document has one conversation by hand") };
    let mut count = 0;
    for line in conversation.lines() {
        count += 1;
        match line.split_once(' ') {
            Some((">", typed)) => keyboard.write_all(format!("{typed}{line_end}").as_bytes()).unwrap(),
            Some(("<", shown)) => {
                assert_eq!(screen.recv_timeout(BOUND).as_deref(), Ok(shown), "line {count}")
            }
            _ => panic!("neither typed nor shown: {line}"),
        }
    }
    assert!(count > 10, "{count} lines");
}

/// Whether the gripper took the end of the conversation for an error.
fn is_in_fast_stop(address: SocketAddr) -> bool {
    let mut stream = TcpStream::connect_timeout(&address, BOUND).unwrap();
    let screen = lines_of(stream.try_clone().unwrap());
    stream.write_all(b"SYSFLAGS[12]?\n").unwrap();
    let flag = screen.recv_timeout(BOUND).expect("an answer in time");
    stream.write_all(b"BYE()\n").unwrap();
    assert_eq!(screen.recv_timeout(BOUND).as_deref(), Ok("ACK BYE"));
    flag == "SYSFLAGS[12]=1"
}

#[test]
fn conversation_by_hand_over_a_bare_socket() {
    // What Enter sends: in `nc`, in PuTTY, in telnet.
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
        .expect("nc is installed");
    let screen = lines_of(nc.stdout.take().unwrap());
    converse(nc.stdin.as_mut().unwrap(), &screen, "\n");
    // As Ctrl-C does.
    nc.kill().unwrap();
    nc.wait().unwrap();
    assert!(!is_in_fast_stop(address));
}
