//! Modbus/TCP on real sockets, and the binary. Every wait is bounded by a socket time-out.
//!
//! The expected behaviour is that of the MODBUS application protocol specification and the messaging implementation guide.

use crate::common::program::Program;
use crate::rig::{BOUND, Client, Logged, QUICK, any_port, await_some, await_true, connect};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Instant;
use wsg_protocol::{Command, Status};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

const GSTATE: [u8; 5] = [4, 0, 0, 0, 1];
const IDLE: u8 = 0x01;
const HOLDING: u8 = 0x10;

fn serve(lines: Lines) -> ServerThread {
    let config = Config { time_scale: QUICK, part: Part::of_width(20.0), ..Config::default() };
    crate::rig::serve(config, Lines { modbus: any_port(), ..lines })
}

fn frame(transaction: u16, unit: u8, pdu: &[u8]) -> Vec<u8> {
    let length = (pdu.len() as u16 + 1).to_be_bytes();
    [&transaction.to_be_bytes()[..], &[0, 0], &length, &[unit], pdu].concat()
}

pub(crate) struct Master {
    stream: TcpStream,
    transaction: u16,
}

impl Master {
    fn new(address: impl ToSocketAddrs) -> Self {
        Self { stream: connect(address), transaction: 0 }
    }

    pub(crate) fn of(served: &ServerThread) -> Self {
        Self::new(served.modbus_address().expect("Modbus is served"))
    }

    fn send(&mut self, bytes: &[u8]) {
        self.stream.write_all(bytes).unwrap();
    }

    /// Returns the transaction, unit and PDU of the next frame.
    fn recv(&mut self) -> (u16, u8, Vec<u8>) {
        let mut header = [0; 7];
        self.stream.read_exact(&mut header).expect("an answer in time");
        let [t1, t0, 0, 0, l1, l0, unit] = header else { panic!("no MODBUS: {header:02X?}") };
        let mut pdu = vec![0; usize::from(u16::from_be_bytes([l1, l0])) - 1];
        self.stream.read_exact(&mut pdu).expect("the rest of the frame");
        (u16::from_be_bytes([t1, t0]), unit, pdu)
    }

    pub(crate) fn ask(&mut self, pdu: &[u8]) -> Vec<u8> {
        self.transaction = self.transaction.wrapping_add(1);
        self.send(&frame(self.transaction, 0xFF, pdu));
        let (transaction, unit, answer) = self.recv();
        assert_eq!((transaction, unit), (self.transaction, 0xFF));
        answer
    }

    /// Writes CMDFLAGS with the parameters of a grip at 20 mm.
    fn write(&mut self, flags: u8) {
        let image = [flags, 0, 0x07, 0xD0, 0x27, 0x10, 0x0F, 0xA0];
        let answer = self.ask(&[&[16, 0, 0, 0, 4, 8][..], &image].concat());
        assert_eq!(answer, [16, 0, 0, 0, 4]);
    }

    fn gstate(&mut self) -> u8 {
        let answer = self.ask(&GSTATE);
        assert_eq!(answer[..2], [4, 2]);
        answer[2]
    }

    fn status(&mut self) -> u8 {
        self.ask(&[4, 0, 5, 0, 1])[3]
    }

    /// Waits until the current command has its result.
    fn wait_for_result(&mut self) -> u8 {
        await_some("the result", || Some(self.status()).filter(|status| *status != 26))
    }

    fn run(&mut self, flags: u8) {
        self.write(0);
        self.write(flags);
        assert_eq!(self.wait_for_result(), 0);
        self.write(0);
    }

    /// Returns all bytes until the gripper closes the connection.
    fn rest(&mut self) -> Vec<u8> {
        let mut rest = vec![];
        self.stream.read_to_end(&mut rest).expect("the connection is closed in time");
        rest
    }
}

#[test]
fn pipelined_requests_are_all_answered_in_order() {
    let served = serve(Lines::default());
    let mut master = Master::of(&served);
    let requests: Vec<u8> = (0..2_000).flat_map(|n| frame(n, n as u8, &[3, 0, 0, 0, 4])).collect();
    master.send(&requests);
    for n in 0..2_000 {
        assert_eq!(master.recv(), (n, n as u8, vec![3, 8, 0, 0, 0, 0, 0, 0, 0, 0]));
    }
}

#[test]
fn unit_identifier_is_returned_and_chooses_nothing() {
    let served = serve(Lines::default());
    let mut master = Master::of(&served);
    for unit in 0..=255 {
        master.send(&frame(1, unit, &[6, 0, 1, 0, unit]));
        assert_eq!(master.recv(), (1, unit, vec![6, 0, 1, 0, unit]), "0 is not a broadcast over TCP");
    }
}

#[test]
fn invalid_length_closes_the_connection_after_all_answers() {
    let served = serve(Lines::default());
    for length in [0u16, 1, 255, 0xFFFF] {
        let mut master = Master::of(&served);
        let before: Vec<u8> = (0..50).flat_map(|n| frame(n, 1, &[3, 0, 0, 0, 1])).collect();
        let mut wrong = frame(99, 1, &[6, 0, 1, 0x12, 0x34]);
        wrong[4..6].copy_from_slice(&length.to_be_bytes());
        let behind = frame(100, 1, &[6, 0, 2, 0x12, 0x34]);
        master.send(&[before, wrong, behind].concat());
        for n in 0..50 {
            assert_eq!(master.recv(), (n, 1, vec![3, 2, 0, 0]));
        }
        assert!(master.rest().is_empty(), "{length}");
        assert_eq!(
            Master::of(&served).ask(&[3, 0, 1, 0, 2]),
            [3, 4, 0, 0, 0, 0],
            "{length}: nothing is written"
        );
    }
}

#[test]
fn stalled_masters_do_not_delay_the_others() {
    let served = serve(Lines::default());
    let request = frame(1, 1, &[43, 14, 1, 0]);
    let requests = request.repeat(500);
    let mut deaf: Vec<Master> = (0..5).map(|_| Master::of(&served)).collect();
    let mut master = Master::of(&served);
    for deaf in &deaf {
        deaf.stream.set_nonblocking(true).unwrap();
        let (mut written, mut stuck) = (0, 0);
        // Until the gripper accepts nothing more in 20 consecutive turns.
        while stuck < 20 {
            match uninterrupted::write(&deaf.stream, &requests[written % request.len()..]) {
                Ok(count) => (written, stuck) = (written + count, 0),
                Err(error) if error.kind() == ErrorKind::WouldBlock => stuck += 1,
                Err(error) => panic!("{error}"),
            }
            assert_eq!(master.gstate(), IDLE);
        }
        deaf.stream.set_nonblocking(false).unwrap();
    }
    let halves: Vec<Master> = (0..20)
        .map(|n| {
            let mut master = Master::of(&served);
            master.send(&frame(1, 1, &[6, 0, 0, 1, 0])[..n % 11]);
            master
        })
        .collect();
    let begin = Instant::now();
    for _ in 0..200 {
        assert_eq!(master.gstate(), IDLE);
    }
    assert!(begin.elapsed() < BOUND / 2, "{:?}", begin.elapsed());
    // A partial request is not answered.
    assert_eq!(master.ask(&[3, 0, 0, 0, 1]), [3, 2, 0, 0]);
    drop(halves);
    // A deaf client gets all its answers once it reads.
    let mut first = deaf.remove(0);
    for _ in 0..5_000 {
        assert_eq!(first.recv().2[..3], [43, 14, 1]);
    }
}

#[test]
fn idle_connections_give_way_to_new_ones_of_any_kind() {
    let served = serve(Lines { tcp: any_port(), ..Lines::default() });
    let mut masters: Vec<Master> = (0..128).map(|_| Master::of(&served)).collect();
    // The last one is answered, so all of them were accepted. The first one then becomes the most recently active.
    for at in [127, 0] {
        assert_eq!(masters[at].gstate(), IDLE);
    }
    let mut newcomer = Master::of(&served);
    assert_eq!(newcomer.gstate(), IDLE);
    assert_eq!(Client::of(&served).ask(Command::Stop), Status::Success);
    for master in &mut masters[1..3] {
        assert!(master.rest().is_empty());
    }
    for at in [0, 3, 127] {
        assert_eq!(masters[at].gstate(), IDLE, "{at}");
    }
    assert_eq!(newcomer.gstate(), IDLE);
}

#[test]
fn binary_text_and_modbus_clients_see_one_gripper() {
    let served = serve(Lines { tcp: any_port(), gcl: any_port(), ..Lines::default() });
    let mut master = Master::of(&served);
    let mut watcher = Master::of(&served);
    let mut binary = Client::of(&served);
    let mut text = connect(served.gcl_address().unwrap());
    let mut lines = BufReader::new(text.try_clone().unwrap()).lines().map(Result::unwrap);
    let mut ask_text = |line: &str| {
        text.write_all(format!("{line}\n").as_bytes()).unwrap();
        lines.next().unwrap()
    };
    let mut answers = |command: Command<'_>| {
        binary.send(command);
        binary.recv().1
    };
    const STATE: Command<'static> = Command::GetGripperState { update: wsg_protocol::AutoUpdate::once() };

    // The PLC homes and grips; all clients see the held part.
    master.run(0b1000);
    master.run(0b0010);
    assert_eq!((master.gstate(), watcher.gstate()), (HOLDING, HOLDING));
    assert_eq!(answers(STATE), [0, 0, 4]);
    assert_eq!(ask_text("GRIPSTATE?"), "GRIPSTATE=4");
    // The text client releases the part, and the PLC sees it.
    assert_eq!(ask_text("RELEASE()"), "ACK RELEASE");
    assert_eq!(ask_text(""), "FIN RELEASE");
    assert_eq!((master.gstate(), answers(STATE)), (IDLE, vec![0, 0, 0]));
    // A FAST STOP of the binary client also applies to the PLC: state IDLE there, 7 here and in the text protocol.
    assert_eq!(answers(Command::FastStop), [0, 0]);
    assert_eq!(watcher.ask(&[2, 0, 28, 0, 1]), [2, 1, 1], "SYSSTATE bit 12");
    assert_eq!(
        (watcher.gstate(), answers(STATE), ask_text("GRIPSTATE?")),
        (IDLE, vec![0, 0, 7], "GRIPSTATE=7".to_owned())
    );
    // The PLC acknowledges it for all clients.
    watcher.write(0);
    watcher.write(0b1_0000);
    assert_eq!(watcher.ask(&[2, 0, 28, 0, 1]), [2, 1, 0]);
    assert_eq!(
        (watcher.gstate(), answers(STATE), ask_text("GRIPSTATE?")),
        (IDLE, vec![0, 0, 0], "GRIPSTATE=0".to_owned())
    );
    assert_eq!(ask_text("BYE()"), "ACK BYE");
}

#[test]
fn log_shows_frames_with_their_function_and_exception() {
    let lines = Lines { modbus: any_port(), ..Lines::default() };
    let logged = Logged::new("modbus", Config::default(), &lines);
    let mut master = Master::of(&logged.served);
    master.ask(&[3, 0, 0, 0, 1]);
    master.ask(&[3, 0, 4, 0, 1]);
    let mut wrong = frame(3, 1, &[7]);
    wrong[2] = 1;
    master.send(&wrong);
    wrong[2..6].fill(0);
    master.send(&wrong);
    master.rest();
    let log = logged.stop();
    let lines: Vec<&str> = log.lines().collect();
    assert_eq!(lines.len(), 6, "{log}");
    for (line, end) in lines.iter().zip([
        " -> 00 01 00 00 00 06 FF 03 00 00 00 01  FC 3 ReadHoldingRegisters",
        " <- 00 01 00 00 00 05 FF 03 02 00 00  FC 3 ReadHoldingRegisters",
        " -> 00 02 00 00 00 06 FF 03 00 04 00 01  FC 3 ReadHoldingRegisters",
        " <- 00 02 00 00 00 03 FF 83 02  FC 3 ReadHoldingRegisters, exception 2",
        " -> 8 bytes of another protocol",
        " -> a length that no frame has",
    ]) {
        assert!(line.contains(" s modbus 127.0.0.1:") && line.ends_with(end), "{log}");
    }
}

#[test]
fn program_serves_modbus_and_says_where() {
    let arguments = ["--modbus", "127.0.0.1:0", "--modbus-swap-bytes", "--time-scale", "100"];
    let mut program = Program::start(&arguments);
    assert_eq!(program.line(), "model wsg50-110");
    let mut master = Master::new(program.place_of("modbus"));
    master.ask(&[6, 0, 0, 0, 0]);
    master.ask(&[6, 0, 0, 0x08, 0]);
    await_true("homing did not end", || master.ask(&[4, 0, 5, 0, 1]) == [4, 2, 0, 0]);
    assert_eq!(master.ask(&[4, 0, 3, 0, 1]), [4, 2, 0xF8, 0x2A], "110.00 mm, low byte first");
}

/// Fieldbus manual, 5.1.1: the user flags.
#[test]
fn user_flags_reach_a_script_and_come_from_it() {
    use crate::scripts::{MIRRORS_USER_FLAGS, script};
    let script = script("modbus-flags", MIRRORS_USER_FLAGS);
    let served = serve(Lines { script: Some(script.0.clone()), ..Lines::default() });
    let mut master = Master::of(&served);
    // IF1 is coil 8, OF1 input 8.
    for (inputs, outputs) in [(0b0000_0001, 0b0100_0000), (0b1000_0110, 0b1011_0000), (0, 0)] {
        assert_eq!(master.ask(&[15, 0, 8, 0, 8, 1, inputs]), [15, 0, 8, 0, 8]);
        await_true("the outputs", || master.ask(&[2, 0, 8, 0, 8]) == [2, 1, outputs]);
    }
}
