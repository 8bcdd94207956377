//! Random bytes on every port, with and without checksum evaluation: the server must not fail and must still answer.

use crate::sim::{PATIENCE, Random, Setup, Sim, frame};
use anyhow::{Context, Result, anyhow};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use wsg_protocol::{Command, LoopData};

/// The longest run of bytes sent at once.
const MAX_RUN: usize = 1_500;
/// Time-out for an answer after which the request is repeated.
const RETRY: Duration = Duration::from_secs(1);
const SOUGHT: &[u8] = b"after all that noise";

pub(crate) fn run(lasting: Duration) -> Result<()> {
    let seed = SystemTime::now().duration_since(UNIX_EPOCH)?.as_micros() as u64;
    println!("seed {seed}, for {lasting:?}");
    let path = std::env::temp_dir().join(format!("wsg-load-{}", std::process::id()));
    let remote = UdpSocket::bind("127.0.0.1:0")?;
    remote.set_read_timeout(Some(RETRY))?;
    let udp_remote_port = remote.local_addr()?.port();
    let data = LoopData::new(SOUGHT).map_err(|refusal| anyhow!("{refusal}"))?;
    let question = frame(Command::Loop { data });
    for (name, setup) in [
        ("checksums evaluated, pseudo terminal", Setup { udp_remote_port, ..Setup::default() }),
        (
            "checksums ignored, Unix socket",
            Setup { udp_remote_port, ignore_checksums: true, unix: Some(&path) },
        ),
    ] {
        let sim = Sim::start(setup)?;
        let bytes = disturb(&sim, seed, lasting / 2)?;
        println!("{name}: {bytes} bytes");
        let state = b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n";
        for (name, address, request, answer) in [
            ("TCP", sim.tcp, &question[..], SOUGHT),
            ("GCL over TCP", sim.gcl, b"DEVTYPE?\n", b"DEVTYPE="),
            // Read Discrete Inputs: GSTATE.
            (
                "Modbus/TCP",
                sim.modbus,
                &[0, 7, 0, 0, 0, 6, 0xFF, 2, 0, 0, 0, 8],
                &[0, 7, 0, 0, 0, 4, 0xFF, 2, 1],
            ),
            ("the control interface", sim.control, state, b"HTTP/1.1 200"),
        ] {
            answers_stream(address, request, answer).context(name)?;
        }
        answers_datagrams(&remote, sim.udp, &question, SOUGHT).context("UDP")?;
        // A separate socket receives no answers to the noise.
        let socket = UdpSocket::bind("127.0.0.1:0")?;
        socket.set_read_timeout(Some(RETRY))?;
        answers_datagrams(&socket, sim.gcl_udp, b"DEVTYPE?\n", b"DEVTYPE=").context("GCL over UDP")?;
        answers_serial(&sim, &question).context("the serial line")?;
        sim.stop()?;
    }
    println!("every port still answers");
    Ok(())
}

/// Sends a run of bytes to one port.
type Sender = Box<dyn FnMut(&[u8]) -> Result<()> + Send>;

/// Sends bytes to every port until the time is over; returns the number of bytes.
fn disturb(sim: &Sim, seed: u64, lasting: Duration) -> Result<u64> {
    let end = Instant::now() + lasting;
    let (_unread, mut serial) = sim.open_serial()?;
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    let (tcp, udp, gcl, gcl_udp) = (sim.tcp, sim.udp, sim.gcl, sim.gcl_udp);
    let (modbus, control) = (sim.modbus, sim.control);
    let gcl_socket = UdpSocket::bind("127.0.0.1:0")?;
    let senders: [Sender; 8] = [
        Box::new(move |run| send_and_close(tcp, run)),
        Box::new(move |run| send_and_close(tcp, run)),
        Box::new(move |run| send_and_close(gcl, run)),
        Box::new(move |run| send_and_close(modbus, run)),
        Box::new(move |run| send_and_close(control, run)),
        // Datagrams for which the system has no room are lost.
        Box::new(move |run| uninterrupted::send_to(&socket, run, udp).map_or(Ok(()), |_| Ok(()))),
        Box::new(move |run| uninterrupted::send_to(&gcl_socket, run, gcl_udp).map_or(Ok(()), |_| Ok(()))),
        Box::new(move |run| Ok(serial.write_all(run)?)),
    ];
    thread::scope(|scope| {
        let mut clients = Vec::new();
        for (mut send, number) in senders.into_iter().zip(0..) {
            clients.push(scope.spawn(move || -> Result<u64> {
                let mut random = Random(seed ^ number);
                let mut sent = 0;
                while Instant::now() < end {
                    let run = noise(&mut random);
                    send(&run)?;
                    sent += run.len() as u64;
                }
                Ok(sent)
            }));
        }
        let mut sent = 0;
        for client in clients {
            sent += client.join().map_err(|_| anyhow!("a client failed"))??;
        }
        Ok(sent)
    })
}

/// Returns bytes of one of three kinds: random, typical of frames, or a request with a few wrong bytes.
fn noise(random: &mut Random) -> Vec<u8> {
    let len = 1 + random.below(MAX_RUN);
    match random.below(3) {
        0 => (0..len).map(|_| random.next() as u8).collect(),
        1 => {
            const LIKELY: [u8; 16] = [
                0xAA, 0xAA, 0xAA, 0xAA, 0xAA, 0x06, 0x07, 0x20, 0x25, 0x40, 0x00, 0x00, 0x00, 0x01, 0x02,
                0xFF,
            ];
            (0..len).map(|_| LIKELY[random.below(LIKELY.len())]).collect()
        }
        _ => {
            let mut run: Vec<u8> = [
                frame(Command::ACKNOWLEDGE),
                frame(Command::GripPart { width: 20.0, speed: 100.0 }),
                frame(Command::GetSystemInfo),
                vec![0, 1, 0, 0, 0, 15, 1, 16, 0, 0, 0, 4, 8, 2, 0, 7, 0xD0, 0x27, 0x10, 0x0F, 0xA0],
                vec![0, 2, 0, 0, 0, 6, 1, 3, 0, 0, 0, 4],
                b"VERBOSE=1\nGRIP(10,20.5)\nAUTOSEND('POS',10,0.5)\nSYSFLAGS[3]?\n".to_vec(),
                b"POST /part HTTP/1.1\r\nContent-Length: 4\r\n\r\nnull".to_vec(),
            ]
            .concat();
            for _ in 0..random.below(4) {
                let at = random.below(run.len());
                run[at] = random.next() as u8;
            }
            run
        }
    }
}

/// Opens a connection, sends a run of bytes, reads the available bytes, and disconnects.
fn send_and_close(to: SocketAddr, run: &[u8]) -> Result<()> {
    let mut stream = TcpStream::connect(to)?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    // The server may close the connection because of the noise.
    let _ = stream.write_all(run);
    let _ = uninterrupted::read(&stream, &mut [0; 4_096]);
    Ok(())
}

/// Sends a request over a new connection and reads up to the start of the expected answer.
fn answers_stream(address: SocketAddr, request: &[u8], expected: &[u8]) -> Result<()> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(request)?;
    let mut answer = Vec::new();
    while !contains(&answer, expected) {
        let mut byte = [0];
        stream.read_exact(&mut byte).with_context(|| format!("unexpected answer: {answer:02X?}"))?;
        answer.extend(byte);
    }
    Ok(())
}

/// Repeats a request until the expected answer arrives. Answers to the noise arrive first, and the line's buffers may
/// still be full of it.
fn answers_datagrams(socket: &UdpSocket, to: SocketAddr, request: &[u8], expected: &[u8]) -> Result<()> {
    let start = Instant::now();
    let mut datagram = [0; 2_048];
    while start.elapsed() < PATIENCE {
        uninterrupted::send_to(socket, request, to)?;
        while let Ok((len, _)) = uninterrupted::recv_from(socket, &mut datagram) {
            if contains(&datagram[..len], expected) {
                return Ok(());
            }
        }
    }
    Err(anyhow!("no answer"))
}

/// Repeats the request, because the gripper may be waiting for the rest of an incomplete frame of the noise.
fn answers_serial(sim: &Sim, question: &[u8]) -> Result<()> {
    let (mut reader, mut writer) = sim.open_serial()?;
    // A terminal has no read time-out, so a separate thread reads.
    let (bytes, incoming) = mpsc::channel();
    thread::spawn(move || {
        let mut buffer = [0; 4_096];
        while let Ok(len @ 1..) = uninterrupted::read(&mut reader, &mut buffer) {
            if bytes.send(buffer[..len].to_vec()).is_err() {
                break;
            }
        }
    });
    let start = Instant::now();
    let mut seen = Vec::new();
    while start.elapsed() < PATIENCE {
        writer.write_all(question)?;
        let sent_at = Instant::now();
        while let Ok(more) = incoming.recv_timeout(RETRY.saturating_sub(sent_at.elapsed())) {
            seen.extend_from_slice(&more);
            if contains(&seen, SOUGHT) {
                return Ok(());
            }
        }
    }
    Err(anyhow!("no answer"))
}

fn contains(bytes: &[u8], sought: &[u8]) -> bool {
    bytes.windows(sought.len()).any(|window| window == sought)
}
