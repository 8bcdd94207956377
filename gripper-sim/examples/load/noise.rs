//! Random bytes on every port, with and without checksum evaluation: the server must not fail and must still answer.

use crate::sim::{PATIENCE, Random, Setup, Sim, frame};
use anyhow::{Context, Result, anyhow, ensure};
use std::io::{BufRead, BufReader, Read, Write};
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
        answers_tcp(&sim).context("TCP")?;
        answers_udp(&sim, &remote).context("UDP")?;
        answers_serial(&sim).context("the serial line")?;
        answers_gcl(&sim).context("GCL over TCP")?;
        answers_gcl_udp(&sim).context("GCL over UDP")?;
        answers_modbus(&sim).context("Modbus/TCP")?;
        answers_control(sim.control).context("the control interface")?;
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
        Box::new(move |run| say_and_leave(tcp, run)),
        Box::new(move |run| say_and_leave(tcp, run)),
        Box::new(move |run| say_and_leave(gcl, run)),
        Box::new(move |run| say_and_leave(modbus, run)),
        Box::new(move |run| say_and_leave(control, run)),
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
fn say_and_leave(to: SocketAddr, run: &[u8]) -> Result<()> {
    let mut stream = TcpStream::connect(to)?;
    stream.set_read_timeout(Some(Duration::from_millis(1)))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    // The server may close the connection because of the noise.
    let _ = stream.write_all(run);
    let _ = uninterrupted::read(&stream, &mut [0; 4_096]);
    Ok(())
}

fn question() -> Result<Vec<u8>> {
    let data = LoopData::new(SOUGHT).map_err(|refusal| anyhow!("{refusal}"))?;
    Ok(frame(Command::Loop { data }))
}

fn answers_tcp(sim: &Sim) -> Result<()> {
    let mut stream = sim.connect()?;
    stream.write_all(&question()?)?;
    let mut answer = vec![0; question()?.len() + 2];
    stream.read_exact(&mut answer)?;
    ensure!(contains(&answer, SOUGHT), "unexpected answer: {answer:02X?}");
    Ok(())
}

fn answers_udp(sim: &Sim, remote: &UdpSocket) -> Result<()> {
    let start = Instant::now();
    let mut datagram = [0; 2_048];
    while start.elapsed() < PATIENCE {
        uninterrupted::send_to(remote, &question()?, sim.udp)?;
        // Answers to the noise arrive first.
        while let Ok((len, _)) = uninterrupted::recv_from(remote, &mut datagram) {
            if contains(&datagram[..len], SOUGHT) {
                return Ok(());
            }
        }
    }
    Err(anyhow!("no answer"))
}

fn answers_gcl(sim: &Sim) -> Result<()> {
    let mut stream = TcpStream::connect(sim.gcl)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(b"DEVTYPE?\n")?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line)?;
    ensure!(line.starts_with("DEVTYPE="), "unexpected answer: {line:?}");
    Ok(())
}

fn answers_modbus(sim: &Sim) -> Result<()> {
    let mut stream = TcpStream::connect(sim.modbus)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    // Read Discrete Inputs: GSTATE, in which exactly one bit is set.
    stream.write_all(&[0, 7, 0, 0, 0, 6, 0xFF, 2, 0, 0, 0, 8])?;
    let mut answer = [0; 10];
    stream.read_exact(&mut answer)?;
    let [head @ .., state] = answer;
    ensure!(
        head == [0, 7, 0, 0, 0, 4, 0xFF, 2, 1] && state.is_power_of_two(),
        "unexpected answer: {answer:02X?}"
    );
    Ok(())
}

/// Uses a separate socket, which receives no answers to the noise. The line's buffers may still be full of noise.
fn answers_gcl_udp(sim: &Sim) -> Result<()> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    socket.set_read_timeout(Some(RETRY))?;
    let start = Instant::now();
    let mut datagram = [0; 2_048];
    while start.elapsed() < PATIENCE {
        uninterrupted::send_to(&socket, b"DEVTYPE?\n", sim.gcl_udp)?;
        if let Ok((len, _)) = uninterrupted::recv_from(&socket, &mut datagram) {
            ensure!(datagram[..len].starts_with(b"DEVTYPE="), "unexpected answer: {:02X?}", &datagram[..len]);
            return Ok(());
        }
    }
    Err(anyhow!("no answer"))
}

/// Repeats the request, because the gripper may be waiting for the rest of an incomplete frame of the noise.
fn answers_serial(sim: &Sim) -> Result<()> {
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
        writer.write_all(&question()?)?;
        let asked = Instant::now();
        while let Ok(more) = incoming.recv_timeout(RETRY.saturating_sub(asked.elapsed())) {
            seen.extend_from_slice(&more);
            if contains(&seen, SOUGHT) {
                return Ok(());
            }
        }
    }
    Err(anyhow!("no answer"))
}

fn answers_control(control: SocketAddr) -> Result<()> {
    let mut stream = TcpStream::connect(control)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(b"GET /state HTTP/1.1\r\nHost: localhost\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    ensure!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    Ok(())
}

fn contains(bytes: &[u8], sought: &[u8]) -> bool {
    bytes.windows(sought.len()).any(|window| window == sought)
}
