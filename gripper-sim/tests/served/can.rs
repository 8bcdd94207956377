//! The gripper on a CAN bus: a controller over SLCAN, opened like an adapter, and the parts of SocketCAN that need no
//! interface. Every wait is bounded.

use crate::common::grip;
use crate::common::program::Program;
use crate::rig::{BOUND, HOMING, QUICK, open_adapter, open_terminal, scratch};
use bus_slcan::{ClassicFrame, Decoder, Line, encode};
use embedded_can::{Frame, Id, StandardId};
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command as Process;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use wsg_protocol::can::{Identifiers, Reassembler, Segments};
use wsg_protocol::{Command, Event, FrameEncoder, Instant, LoopData, Status};
use wsg_sim::server::{CanBus, CanLine, Lines, SerialLine, ServerThread};
use wsg_sim::{Config, Part};

fn identifiers() -> Identifiers {
    Identifiers::from_base(0x345).unwrap()
}

fn serve(config: Config, line: SerialLine) -> ServerThread {
    let can = Some(CanLine { bus: CanBus::Slcan(line), identifiers: identifiers() });
    crate::rig::serve(config, Lines { can, ..Lines::default() })
}

/// A controller on a serial line, with the received SLCAN lines.
struct Controller<S> {
    line: S,
    lines: Receiver<Line<ClassicFrame>>,
    reassembler: Reassembler<64>,
}

impl<S: Write> Controller<S> {
    fn new(line: S, mut reader: impl Read + Send + 'static) -> Self {
        let (sender, lines) = mpsc::channel();
        thread::spawn(move || {
            let mut decoder = Decoder::new();
            let mut chunk = [0; 64];
            // Ends with the line or with the test.
            while let Ok(count @ 1..) = uninterrupted::read(&mut reader, &mut chunk) {
                for &byte in &chunk[..count] {
                    if decoder.push(byte).is_some_and(|line| sender.send(line).is_err()) {
                        return;
                    }
                }
            }
        });
        Self { line, lines, reassembler: Reassembler::new(identifiers().controller().receive, 1_000) }
    }

    fn write(&mut self, text: &[u8]) {
        self.line.write_all(text).unwrap();
    }

    fn next(&self) -> Line<ClassicFrame> {
        self.lines.recv_timeout(BOUND).expect("a line in time")
    }

    /// Opens the channel as hosts do, after closing any earlier one.
    fn open(&mut self) {
        for command in [&b"C\r"[..], b"S6\r", b"O\r"] {
            self.write(command);
            assert_eq!(self.next(), Line::Done);
        }
    }

    fn send_frame(&mut self, id: impl Into<Id>, data: &[u8]) {
        self.write(encode(&ClassicFrame::new(id, data).unwrap()).as_bytes());
        assert_eq!(self.next_answer(), Line::Taken(b'z'));
    }

    /// Returns the next line that is not a frame; skips frames before it.
    fn next_answer(&self) -> Line<ClassicFrame> {
        loop {
            match self.next() {
                Line::Frame(_) => {}
                answer => return answer,
            }
        }
    }

    fn send(&mut self, command: Command<'_>) {
        for segment in Segments::new(FrameEncoder::new(command.id().code(), command)) {
            let frame: ClassicFrame = segment.frame(identifiers().controller().transmit).unwrap();
            self.write(encode(&frame).as_bytes());
        }
    }

    /// Returns the id and payload of the next message.
    fn recv(&mut self) -> (u8, Vec<u8>) {
        loop {
            let Line::Frame(frame) = self.next() else { continue };
            let mut message = None;
            self.reassembler.receive(Instant::from_millis(0), &frame, |event| match event {
                Event::Frame(frame) => message = Some((frame.id, frame.payload.to_vec())),
                event => panic!("{event:?}"),
            });
            if let Some(message) = message {
                return message;
            }
        }
    }

    fn status(&mut self, command: Command<'_>) -> Status {
        let (id, payload) = self.recv();
        assert_eq!(id, command.id().code());
        Status::from_code(u16::from_le_bytes([payload[0], payload[1]]))
    }

    fn run(&mut self, command: Command<'_>) -> Status {
        self.send(command);
        assert_eq!(self.status(command), Status::CmdPending);
        self.status(command)
    }
}

fn controller(served: &ServerThread) -> Controller<File> {
    let terminal = open_terminal(served.can_path().expect("CAN is served"));
    let reader = terminal.try_clone().unwrap();
    let mut controller = Controller::new(terminal, reader);
    controller.open();
    controller
}

#[test]
fn slcan_grip_cycle_over_a_pseudo_terminal() {
    let config = Config { time_scale: QUICK, part: Part::of_width(20.0), ..Config::default() };
    let served = serve(config, SerialLine::Pty);
    let mut controller = controller(&served);

    assert_eq!(controller.run(HOMING), Status::Success);
    let limit = Command::SetForceLimit { force: 40.0 };
    controller.send(limit);
    assert_eq!(controller.status(limit), Status::Success);
    assert_eq!(controller.run(grip(20.0)), Status::Success);
    controller.send(Command::GetGripperState { update: wsg_protocol::AutoUpdate::once() });
    assert_eq!(controller.recv(), (0x41, vec![0, 0, 4]), "holding");
    assert_eq!(controller.run(Command::ReleasePart { width: 40.0, speed: 50.0 }), Status::Success);
}

#[test]
fn slcan_messages_of_every_length_follow_the_size_field() {
    let served = serve(Config::default(), SerialLine::Pty);
    let mut controller = controller(&served);
    for len in (0..=24).chain([255, 256]) {
        let data: Vec<u8> = (0..len).map(|n| n as u8).collect();
        controller.send(Command::Loop { data: LoopData::new(&data).unwrap() });
        let (id, payload) = controller.recv();
        assert_eq!((id, &payload[2..]), (0x06, &data[..]));
    }
}

#[test]
fn slcan_frames_for_others_are_not_for_the_gripper() {
    let served = serve(Config::default(), SerialLine::Pty);
    let mut controller = controller(&served);
    let own = identifiers().controller().transmit;
    let segments: Vec<_> = Segments::new(FrameEncoder::new(0x46, Command::GetTemperature)).collect();
    let query = segments[0].data();

    controller.send_frame(identifiers().controller().receive, query);
    controller.send_frame(StandardId::new(own.as_raw() - 1).unwrap(), query);
    controller.write(b"r3458\r");
    assert_eq!(controller.next_answer(), Line::Taken(b'z'));
    controller.write(b"T000003458AAAAAA4600000000\r");
    assert_eq!(controller.next_answer(), Line::Taken(b'Z'));
    // The next message must be the answer to this request.
    controller.send(Command::GetSystemLimits);
    assert_eq!(controller.recv().0, 0x53);
}

#[test]
fn slcan_message_cut_differently_is_rejected() {
    let served = serve(Config::default(), SerialLine::Pty);
    let mut controller = controller(&served);
    let stop: Vec<u8> = FrameEncoder::new(0x23, Command::FastStop).collect();
    for pieces in [[&stop[..4], &stop[4..]], [&stop[..7], &stop[7..]]] {
        for piece in pieces {
            controller.send_frame(identifiers().controller().transmit, piece);
        }
    }
    controller.send(Command::GetSystemState { update: wsg_protocol::AutoUpdate::once() });
    assert_eq!(controller.recv(), (0x40, vec![0, 0, 0, 0, 0, 0]), "no FAST STOP");
}

#[test]
fn slcan_channel_that_is_closed_lets_nothing_through() {
    let served = serve(Config::default(), SerialLine::Pty);
    let mut controller = controller(&served);
    controller.write(b"C\r");
    assert_eq!(controller.next(), Line::Done);
    controller.send(Command::FastStop);
    assert_eq!(controller.next(), Line::Refused);
    controller.open();
    controller.send(Command::GetSystemState { update: wsg_protocol::AutoUpdate::once() });
    assert_eq!(controller.recv(), (0x40, vec![0, 0, 0, 0, 0, 0]), "no FAST STOP");
}

#[test]
fn slcan_over_a_unix_socket_takes_hosts_one_after_the_other() {
    let path = scratch("slcan");
    let served = serve(Config::default(), SerialLine::Unix(path.clone()));
    for _ in 0..2 {
        let stream = UnixStream::connect(served.can_path().unwrap()).unwrap();
        let mut controller = Controller::new(stream.try_clone().unwrap(), stream);
        controller.open();
        controller.send(Command::GetTemperature);
        assert_eq!(controller.recv().0, 0x46);
    }
    assert_eq!(served.can_path(), Some(&*path));
}

#[test]
fn slcan_on_a_device_makes_the_gripper_the_host() {
    let (adapter, path) = open_adapter();
    // The adapter's end must be raw before the gripper opens the other end, because nothing may be echoed.
    let _device = open_terminal(&path);
    let served = serve(Config::default(), SerialLine::Device(path));

    let mut controller = Controller::new(adapter.try_clone().unwrap(), adapter);
    for expected in
        [Line::Done, Line::Command(b'C', None), Line::Command(b'S', Some(b'6')), Line::Command(b'O', None)]
    {
        assert_eq!(controller.next(), expected);
    }
    // Answers of the adapter are not requests and must not be answered.
    controller.write(b"\r\rz\r\x07");
    controller.send(Command::GetTemperature);
    assert_eq!(controller.recv().0, 0x46);
    drop(served);
}

#[test]
fn interface_that_does_not_exist_is_named_in_one_line() {
    let ended = Process::new(env!("CARGO_BIN_EXE_wsg-sim")).args(["--can", "nocan0"]).output().unwrap();
    let error = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(1));
    assert!(error.starts_with("wsg-sim: the CAN interface nocan0 cannot be opened"), "{error}");
    assert_eq!(error.lines().count(), 1, "{error}");
}

#[test]
fn program_says_where_the_slcan_line_is() {
    let mut program = Program::start(&["--slcan", "pty", "--can-id", "0x345"]);
    assert_eq!(program.line(), "model wsg50-110");
    let terminal = open_terminal(Path::new(&program.place_of("slcan")));
    let mut controller = Controller::new(terminal.try_clone().unwrap(), terminal);
    controller.open();
    controller.send(Command::GetTemperature);
    assert_eq!(controller.recv().0, 0x46);
}
