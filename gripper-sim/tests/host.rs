//! The drivers on a computer, over every transport, with the virtual gripper at the other end.

use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread;
use std::time::{Duration, Instant};

use wsg_protocol::driver::blocking::{GclGripper, Gripper, GripperOver, Transport};
use wsg_protocol::driver::host::{self, StdClock, Tcp, Udp};
use wsg_protocol::driver::{self, Clock, Error, Grip, Mm, MmPerS, N, OnBlock, Protocol, StopKind, Stoppable};
use wsg_protocol::{Command, CommandId, FrameEncoder, FrameParser, HomingDirection, SystemFlags, session};
use wsg_sim::server::{Lines, ServerThread, UdpLine};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortKind, Time, VirtualGripper};

#[expect(dead_code, reason = "only its test runs here, because the crate's own tests have no server")]
#[path = "../../protocol/examples/quick_start.rs"]
mod quick_start;

/// Maximum time that a test waits for an expected event.
const PATIENCE: Duration = Duration::from_secs(30);

fn loopback() -> SocketAddr {
    "127.0.0.1:0".parse().unwrap()
}

/// Starts a gripper with a part of 20 mm, which homes at its start.
fn serve(lines: &Lines) -> ServerThread {
    let config = Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() };
    ServerThread::start(config, lines, None).expect("loopback and pseudo terminals are available")
}

fn on_tcp() -> (ServerThread, SocketAddr) {
    let server = serve(&Lines { tcp: Some(loopback()), ..Lines::default() });
    let address = server.tcp_address().unwrap();
    (server, address)
}

fn on_gcl() -> (ServerThread, SocketAddr) {
    let server = serve(&Lines { gcl: Some(loopback()), ..Lines::default() });
    let address = server.gcl_address().unwrap();
    (server, address)
}

/// Returns a driver with a longer time-out than usual, because a busy machine may pause it or the gripper.
fn patient<IO: Transport>(line: IO) -> Gripper<IO, StdClock> {
    let session = session::Config { reply_timeout_ms: 10_000, ..driver::Config::DEFAULT.session };
    Gripper::with_config(line, StdClock::new(), driver::Config { session, ..driver::Config::DEFAULT })
}

/// Runs the same grip cycle over any transport and protocol.
fn grips<IO, C, P>(gripper: &mut GripperOver<IO, C, P>)
where
    IO: Transport<Error = io::Error>,
    C: Clock,
    P: Protocol,
{
    let grip = gripper.with_connection(|gripper| {
        gripper.home(HomingDirection::Default)?;
        gripper.set_force_limit(N(40.0))?;
        gripper.grip(Mm(20.0), MmPerS(400.0))
    });
    assert_eq!(grip.unwrap(), Grip::Held);
}

#[test]
fn blocking_driver_grips_over_gcl() {
    let (_server, address) = on_gcl();
    grips(&mut GclGripper::new(Tcp::connect(address).unwrap(), StdClock::new()));
}

#[test]
fn blocking_driver_grips_over_gcl_on_udp() {
    let server = serve(&Lines { gcl_udp: Some(loopback()), ..Lines::default() });
    let line = Udp::connect(server.gcl_udp_address().unwrap(), 0).unwrap();
    grips(&mut GclGripper::new(line, StdClock::new()));
}

/// Waits until the fingers are at rest, over a separate connection. Returns the flags.
fn flags_at_rest(address: SocketAddr) -> SystemFlags {
    let begin = Instant::now();
    let look = |gripper: &mut Gripper<Tcp, StdClock>| -> Result<_, Error<io::Error>> {
        loop {
            let flags = gripper.system_state()?;
            if !flags.contains(SystemFlags::MOVING) {
                return Ok(flags);
            }
            assert!(begin.elapsed() < PATIENCE, "the fingers still move: {flags}");
        }
    };
    host::with_gripper(address, look).expect("the gripper answers")
}

/// Returns a gripper in mid travel, 30 s before its target.
fn in_motion(address: SocketAddr) -> Gripper<Tcp, StdClock> {
    let mut gripper = Gripper::new(Tcp::connect(address).unwrap(), StdClock::new());
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Positive).unwrap();
    let _ = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop).unwrap();
    gripper
}

#[test]
fn driver_dropped_in_mid_travel_causes_no_fast_stop() {
    let (_server, address) = on_tcp();
    drop(in_motion(address));
    let flags = flags_at_rest(address);
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
    assert!(flags.contains(SystemFlags::REFERENCED), "{flags}");
}

#[test]
fn driver_over_gcl_dropped_in_mid_travel_causes_no_fast_stop() {
    let server = serve(&Lines { tcp: Some(loopback()), gcl: Some(loopback()), ..Lines::default() });
    let line = Tcp::connect(server.gcl_address().unwrap()).unwrap();
    let mut gripper = GclGripper::new(line, StdClock::new());
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Positive).unwrap();
    let _ = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop).unwrap();
    drop(gripper);
    let flags = flags_at_rest(server.tcp_address().unwrap());
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
}

#[test]
fn program_that_ends_early_causes_no_fast_stop() {
    let (_server, address) = on_tcp();
    let program = |gripper: &mut Gripper<Tcp, StdClock>| {
        gripper.home(HomingDirection::Positive)?;
        let _ = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop)?;
        Err(Error::NoForceLimit)
    };
    let left: Result<(), _> = host::with_gripper(address, program);
    assert!(matches!(left, Err(Error::NoForceLimit)), "{left:?}");
    let flags = flags_at_rest(address);
    assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
}

#[test]
fn panicking_program_fast_stops_even_if_a_handle_remains() {
    for has_handle in [false, true] {
        let (_server, address) = on_tcp();
        let mut gripper = in_motion(address);
        let _handle = has_handle.then(|| gripper.stop_handle().unwrap());
        let panicked = catch_unwind(AssertUnwindSafe(move || {
            let _gripper = gripper;
            std::panic::resume_unwind(Box::new("an intended panic"));
        }));
        assert!(panicked.is_err());
        let flags = flags_at_rest(address);
        assert!(flags.contains(SystemFlags::FAST_STOP), "{flags}");
    }
}

#[test]
fn requested_fast_stop_stays_in_effect() {
    let (_server, address) = on_tcp();
    let mut gripper = in_motion(address);
    gripper.fast_stop().unwrap();
    drop(gripper);
    assert!(flags_at_rest(address).contains(SystemFlags::FAST_STOP));
}

/// Starts a slow motion and checks that another thread can stop it, by Stop and by FAST STOP.
fn stopped_by_another_thread<IO, P>(gripper: &mut GripperOver<IO, StdClock, P>)
where
    IO: Transport<Error = io::Error> + Stoppable,
    P: Protocol,
{
    gripper.connect().unwrap();
    gripper.home(HomingDirection::Positive).unwrap();
    let handle = gripper.stop_handle().unwrap();
    for kind in [StopKind::Stop, StopKind::FastStop] {
        let begun = Instant::now();
        let handle = handle.clone();
        let button = thread::spawn(move || match kind {
            StopKind::Stop => handle.stop(),
            StopKind::FastStop => handle.fast_stop(),
        });
        let moved = gripper.move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop);
        assert!(matches!(moved, Err(Error::Stopped(by)) if by == kind), "{moved:?}");
        assert!(begun.elapsed() < Duration::from_secs(15), "the fingers did not travel to the end");
        button.join().unwrap().unwrap();
    }
    assert!(gripper.system_state().unwrap().contains(SystemFlags::FAST_STOP));
    gripper.acknowledge().unwrap();
    gripper.move_by(Mm(-1.0), MmPerS(50.0), OnBlock::Stop).unwrap();
}

#[test]
fn another_thread_stops_a_motion_over_tcp() {
    let (_server, address) = on_tcp();
    stopped_by_another_thread(&mut Gripper::new(Tcp::connect(address).unwrap(), StdClock::new()));
}

#[test]
fn another_thread_stops_a_motion_over_gcl() {
    let (_server, address) = on_gcl();
    stopped_by_another_thread(&mut GclGripper::new(Tcp::connect(address).unwrap(), StdClock::new()));
}

#[test]
fn another_thread_stops_a_motion_over_udp() {
    let socket = UdpSocket::bind(loopback()).unwrap();
    let remote_port = socket.local_addr().unwrap().port();
    let udp = UdpLine { address: loopback(), remote_port };
    let server = serve(&Lines { udp: Some(udp), ..Lines::default() });
    let line = Udp::new(socket, server.udp_address().unwrap()).unwrap();
    stopped_by_another_thread(&mut Gripper::new(line, StdClock::new()));
}

#[test]
fn fast_stop_of_a_handle_outlives_the_dropped_driver() {
    let (_server, address) = on_tcp();
    let mut gripper = in_motion(address);
    let handle = gripper.stop_handle().unwrap();
    handle.fast_stop().unwrap();
    drop(gripper);
    assert!(flags_at_rest(address).contains(SystemFlags::FAST_STOP));
    assert_eq!(handle.stop().unwrap_err().kind(), io::ErrorKind::NotConnected);
}

/// Counts the bytes outside of frames and the frames with bad checksums on a socket.
fn serve_and_count(listener: &TcpListener) -> (u16, u16) {
    use std::io::{Read, Write};
    let (mut stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    let (mut parser, mut bytes) = (FrameParser::<300>::new(), [0; 64]);
    let mut gripper = VirtualGripper::<1>::with_ports(Config::default());
    let port = gripper.connect(PortKind::Tcp).unwrap();
    let (begun, mut answer) = (Instant::now(), [0; MAX_FRAME_LEN]);
    loop {
        #[expect(clippy::disallowed_methods, reason = "no signal is sent")]
        let count = stream.read(&mut bytes).unwrap_or(0);
        if count == 0 {
            let counters = parser.counters();
            return (counters.dropped, counters.bad_checksum);
        }
        let mut rest = &bytes[..count];
        while let (taken, Some(_)) = parser.push_slice(rest) {
            rest = &rest[taken..];
        }
        let now = Time::from_millis(begun.elapsed().as_millis() as u64);
        gripper.advance(now);
        gripper.receive(port, now, &bytes[..count]);
        while let Some(message) = gripper.transmit(port, &mut answer) {
            // The driver may already be closed.
            let _ = stream.write_all(message);
        }
    }
}

#[test]
fn messages_of_driver_and_handles_do_not_interleave() {
    const STOPS: u32 = 300;
    let listener = TcpListener::bind(loopback()).unwrap();
    let address = listener.local_addr().unwrap();
    let peer = thread::spawn(move || serve_and_count(&listener));
    let mut gripper = host::connect(address).unwrap();
    let handle = gripper.stop_handle().unwrap();
    let buttons = [(); 3].map(|()| {
        let handle = handle.clone();
        thread::spawn(move || (0..STOPS).for_each(|_| handle.stop().unwrap()))
    });
    let (mut stopped, mut done) = (0, 0);
    while !buttons.iter().all(thread::JoinHandle::is_finished) || done == 0 {
        match gripper.loop_back(&[0xAA; 256]) {
            Ok(()) => done += 1,
            Err(Error::Stopped(StopKind::Stop)) => stopped += 1,
            other => panic!("{other:?}"),
        }
    }
    buttons.into_iter().for_each(|button| button.join().unwrap());
    assert!(stopped > 0);
    drop(gripper);
    assert_eq!(peer.join().unwrap(), (0, 0));
}

#[test]
fn closed_port_is_an_error_of_the_transport() {
    // No program listens on port 1.
    let address = SocketAddr::from(([127, 0, 0, 1], 1));
    let result = host::with_gripper(address, |gripper| gripper.stop());
    assert!(matches!(result, Err(Error::Transport(_))), "{result:?}");
    let source = std::error::Error::source(result.as_ref().unwrap_err()).map(ToString::to_string);
    assert!(source.is_some());
}

/// Returns both ends of a connection.
fn connected() -> (Tcp, TcpStream) {
    let listener = TcpListener::bind(loopback()).unwrap();
    let line = Tcp::connect(listener.local_addr().unwrap()).unwrap();
    (line, listener.accept().unwrap().0)
}

#[test]
fn bytes_after_an_emptying_read_are_noticed_without_a_wait() {
    use embedded_io::{Read, ReadReady};
    let (mut line, mut gripper) = connected();
    for byte in [1, 2] {
        io::Write::write_all(&mut gripper, &[byte]).unwrap();
        let begin = Instant::now();
        while !line.read_ready().unwrap() {
            assert!(begin.elapsed() < PATIENCE);
        }
        let mut read = [0; 2];
        assert_eq!((line.read(&mut read).unwrap(), read[0]), (1, byte));
        assert!(!line.read_ready().unwrap());
    }
}

#[test]
fn long_input_is_read_without_a_pause() {
    use embedded_io::{Read, ReadReady};
    let (mut line, mut gripper) = connected();
    let mut chunk = [7; 4_096];
    io::Write::write_all(&mut gripper, &chunk).unwrap();
    let mut left = chunk.len();
    while left > 0 {
        // Over loopback, the bytes are in the socket already.
        assert!(line.read_ready().unwrap(), "{left}");
        left -= line.read(&mut chunk).unwrap();
    }
}

/// Checks that a line waits while nothing comes, but not while it still holds bytes.
fn waits(mut line: impl Transport<Error = io::Error>, send: impl FnOnce(&[u8])) {
    let begin = Instant::now();
    line.wait(20).unwrap();
    assert!(begin.elapsed() >= Duration::from_millis(20));
    send(&[1, 2]);
    let begin = Instant::now();
    while !line.read_ready().unwrap() {
        assert!(begin.elapsed() < PATIENCE);
    }
    line.read_exact(&mut [0]).unwrap();
    line.wait(PATIENCE.as_millis() as u32).unwrap();
    assert!(begin.elapsed() < PATIENCE);
    line.read_exact(&mut [0]).unwrap();
}

#[test]
fn wait_ends_when_bytes_are_held() {
    let (line, mut gripper) = connected();
    waits(line, |bytes| io::Write::write_all(&mut gripper, bytes).unwrap());

    let gripper = UdpSocket::bind(loopback()).unwrap();
    let socket = UdpSocket::bind(loopback()).unwrap();
    let here = socket.local_addr().unwrap();
    let line = Udp::new(socket, gripper.local_addr().unwrap()).unwrap();
    waits(line, |bytes| host_send(&gripper, bytes, here));
}

/// Returns the error of a write.
fn refused(mut line: impl Transport<Error = io::Error>) -> io::ErrorKind {
    line.write_all(&[1]).unwrap_err().kind()
}

/// For broadcasts, a socket has no permission.
const BROADCAST: &str = "255.255.255.255:1500";

#[test]
fn datagram_that_may_not_be_sent_is_an_error() {
    let line = Udp::connect(BROADCAST, 0).unwrap();
    assert_eq!(refused(line), io::ErrorKind::PermissionDenied);
}

/// Returns a socket that the system informs about the closed port to which it sends. Only Linux permits the driver to
/// name the receiver again.
#[cfg(target_os = "linux")]
fn informed() -> (UdpSocket, SocketAddr) {
    let [socket, closed] = [(); 2].map(|()| UdpSocket::bind(loopback()).unwrap());
    let closed = closed.local_addr().unwrap();
    socket.connect(closed).unwrap();
    (socket, closed)
}

#[test]
#[cfg(target_os = "linux")]
fn closed_port_of_a_gripper_on_udp_is_silence() {
    use embedded_io::{ReadReady, Write};
    let (socket, closed) = informed();
    let mut line = Udp::new(socket, closed).unwrap();
    // The second write returns the error of the first one, and the read that of the third.
    for _ in 0..3 {
        line.write_all(&[1]).unwrap();
    }
    assert!(!line.read_ready().unwrap());
}

/// A port that reads as many bytes as planned, and counts the reads. Its writes fail with one error.
struct Port {
    plan: Vec<usize>,
    reads: usize,
    error: io::ErrorKind,
}

impl io::Read for Port {
    fn read(&mut self, _: &mut [u8]) -> io::Result<usize> {
        let len = self.plan[self.reads];
        self.reads += 1;
        if len == 0 { Err(io::ErrorKind::TimedOut.into()) } else { Ok(len) }
    }
}

impl io::Write for Port {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(self.error.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn port_is_not_read_again_soon_after_a_partial_read() {
    use embedded_io::{Read, ReadReady};
    const FULL: usize = 512;
    for (plan, reads) in [(vec![0, 1], 1), (vec![5, 1], 1), (vec![FULL, 1], 2), (vec![FULL, 0, 1], 2)] {
        loop {
            let mut line =
                host::Stream::new(Port { plan: plan.clone(), reads: 0, error: io::ErrorKind::Other });
            let begin = Instant::now();
            for _ in &plan {
                if line.read_ready().unwrap() {
                    line.read(&mut [0; FULL]).unwrap();
                }
            }
            // Later, the port may be read again.
            if begin.elapsed() < Duration::from_millis(10) {
                assert_eq!(line.into_inner().reads, reads, "{plan:?}");
                break;
            }
        }
    }
}

#[test]
fn second_handle_that_times_out_accepts_no_bytes() {
    use io::ErrorKind::{BrokenPipe, TimedOut, WouldBlock};
    for (error, stopped) in [(TimedOut, WouldBlock), (BrokenPipe, BrokenPipe)] {
        let [port, second] = [(); 2].map(|()| Port { plan: vec![], reads: 0, error });
        let mut gripper = Gripper::<_, _>::new(host::Stream::with_second(port, second), StdClock::new());
        assert_eq!(gripper.stop_handle().unwrap().stop().unwrap_err().kind(), stopped);
    }
}

/// The bytes of a FAST STOP on the line.
fn fast_stop() -> Vec<u8> {
    FrameEncoder::new(CommandId::FastStop.code(), Command::FastStop).collect()
}

#[test]
fn stop_of_a_handle_is_on_the_line_when_it_returns() {
    let (line, mut peer) = connected();
    let mut gripper = Gripper::<_, _>::new(line, StdClock::new());
    peer.set_read_timeout(Some(PATIENCE)).unwrap();
    // No call of the driver could send it.
    gripper.stop_handle().unwrap().fast_stop().unwrap();
    let mut received = vec![0; fast_stop().len()];
    io::Read::read_exact(&mut peer, &mut received).unwrap();
    assert_eq!(received, fast_stop());

    let peer = UdpSocket::bind(loopback()).unwrap();
    peer.set_read_timeout(Some(PATIENCE)).unwrap();
    let line = Udp::connect(peer.local_addr().unwrap(), 0).unwrap();
    let mut gripper = Gripper::<_, _>::new(line, StdClock::new());
    gripper.stop_handle().unwrap().fast_stop().unwrap();
    assert_eq!(host_received(&peer), fast_stop());
}

fn elsewhere() -> SocketAddr {
    "127.0.0.2:1500".parse().unwrap()
}

#[test]
fn udp_ignores_other_hosts_and_empty_datagrams() {
    use embedded_io::{Read, ReadReady};
    let gripper = UdpSocket::bind(loopback()).unwrap();
    for (address, is_heard) in [(gripper.local_addr().unwrap(), true), (elsewhere(), false)] {
        let socket = UdpSocket::bind(loopback()).unwrap();
        let here = socket.local_addr().unwrap();
        let mut line = Udp::new(socket, address).unwrap();
        for datagram in [&[][..], &[1, 2, 3]] {
            host_send(&gripper, datagram, here);
        }
        let begin = Instant::now();
        let mut ready = false;
        while is_heard && !ready {
            assert!(begin.elapsed() < PATIENCE);
            line.wait(100).unwrap();
            ready = line.read_ready().unwrap();
        }
        // Over loopback, the datagrams are in the socket's queue already.
        let ready = ready || line.read_ready().unwrap() || line.read_ready().unwrap();
        assert_eq!(ready, is_heard, "{address}");
        if is_heard {
            let mut two = [0; 2];
            assert_eq!((line.read(&mut two).unwrap(), two), (2, [1, 2]));
            assert!(line.read_ready().unwrap());
            assert_eq!((line.read(&mut two).unwrap(), two[0]), (1, 3));
        }
    }
}

fn host_send(socket: &UdpSocket, datagram: &[u8], to: SocketAddr) {
    #[expect(clippy::disallowed_methods, reason = "loopback takes a datagram at once")]
    let sent = socket.send_to(datagram, to).unwrap();
    assert_eq!(sent, datagram.len());
}

fn host_received(socket: &UdpSocket) -> Vec<u8> {
    let mut datagram = [0; MAX_FRAME_LEN];
    loop {
        #[expect(clippy::disallowed_methods, reason = "made again after a signal")]
        match socket.recv(&mut datagram) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            len => return datagram[..len.unwrap()].to_vec(),
        }
    }
}

mod on_tokio {
    use super::*;
    use tokio::net::UdpSocket;
    use tokio::sync::oneshot;
    use tokio::time::timeout;
    use wsg_protocol::driver::asynch::{self, Gripper};
    use wsg_protocol::driver::tokio::{self as driver_on_tokio, Tcp, TokioTimer, Udp, with_gripper};

    /// Wait for a read that must not return. Over loopback, what it could return is there already.
    const SHORT: Duration = Duration::from_millis(20);

    pub(super) fn run<T>(program: impl Future<Output = T>) -> T {
        tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(program)
    }

    pub(super) async fn grips<IO, P>(gripper: &mut asynch::GripperOver<IO, TokioTimer, P>)
    where
        IO: asynch::Transport<Error = io::Error>,
        P: driver::Protocol,
    {
        let program = async |gripper: &mut asynch::GripperOver<IO, TokioTimer, P>| {
            gripper.home(HomingDirection::Default).await?;
            gripper.set_force_limit(N(40.0)).await?;
            gripper.grip(Mm(20.0), MmPerS(400.0)).await
        };
        assert_eq!(gripper.with_connection(program).await.unwrap(), Grip::Held);
    }

    #[test]
    fn async_driver_grips_over_tcp() {
        let (_server, address) = on_tcp();
        run(async {
            let line = Tcp::connect(address).await.unwrap();
            grips(&mut Gripper::new(line, TokioTimer::new())).await;
        });
    }

    #[test]
    fn async_driver_grips_over_gcl() {
        let (_server, address) = on_gcl();
        run(async {
            let line = Tcp::connect(address).await.unwrap();
            grips(&mut asynch::GclGripper::new(line, TokioTimer::new())).await;
        });
    }

    #[test]
    fn async_driver_grips_over_udp() {
        run(async {
            let socket = UdpSocket::bind(loopback()).await.unwrap();
            let remote_port = socket.local_addr().unwrap().port();
            let udp = UdpLine { address: loopback(), remote_port };
            let server = serve(&Lines { udp: Some(udp), ..Lines::default() });
            let line = Udp::new(socket, server.udp_address().unwrap());
            grips(&mut Gripper::new(line, TokioTimer::new())).await;
        });
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn closed_port_of_a_gripper_on_udp_is_silence() {
        use embedded_io_async::{Read, Write};
        run(async {
            let (socket, closed) = informed();
            socket.set_nonblocking(true).unwrap();
            let mut line = Udp::new(UdpSocket::from_std(socket).unwrap(), closed);
            for _ in 0..3 {
                line.write_all(&[1]).await.unwrap();
            }
            let mut byte = [0];
            let read = timeout(SHORT, line.read(&mut byte)).await;
            assert!(read.is_err(), "{read:?}");
        });
    }

    #[test]
    fn datagram_that_may_not_be_sent_is_an_error() {
        use embedded_io_async::Write;
        run(async {
            let mut line = Udp::connect(BROADCAST, 0).await.unwrap();
            assert_eq!(line.write_all(&[1]).await.unwrap_err().kind(), io::ErrorKind::PermissionDenied);
        });
    }

    #[test]
    fn udp_ignores_other_hosts_and_empty_datagrams() {
        use embedded_io_async::Read;
        run(async {
            let gripper = super::UdpSocket::bind(loopback()).unwrap();
            for (address, wait) in [(gripper.local_addr().unwrap(), PATIENCE), (elsewhere(), SHORT)] {
                let socket = UdpSocket::bind(loopback()).await.unwrap();
                let here = socket.local_addr().unwrap();
                let mut line = Udp::new(socket, address);
                for datagram in [&[][..], &[1, 2, 3]] {
                    host_send(&gripper, datagram, here);
                }
                let mut two = [0; 2];
                let read = timeout(wait, line.read(&mut two)).await.map(Result::unwrap).ok();
                assert_eq!((read, two), if wait == SHORT { (None, [0, 0]) } else { (Some(2), [1, 2]) });
            }
        });
    }

    #[test]
    fn another_thread_stops_a_motion_of_the_async_driver() {
        let (_server, address) = on_tcp();
        run(async {
            let mut gripper = driver_on_tokio::connect(address).await.unwrap();
            gripper.home(HomingDirection::Positive).await.unwrap();
            let handle = gripper.stop_handle().unwrap();
            let button = thread::spawn(move || handle.fast_stop());
            let moved = gripper.move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop).await;
            assert!(matches!(moved, Err(Error::Stopped(StopKind::FastStop))), "{moved:?}");
            button.join().unwrap().unwrap();
        });
        assert!(flags_at_rest(address).contains(SystemFlags::FAST_STOP));
    }

    #[test]
    fn future_dropped_in_mid_travel_causes_no_fast_stop() {
        let (_server, address) = on_tcp();
        run(async {
            let (moves, moving) = oneshot::channel();
            let program = with_gripper(address, async |gripper| -> Result<(), Error<io::Error>> {
                gripper.home(HomingDirection::Positive).await?;
                let motion = gripper.begin_move_to(Mm(5.0), MmPerS(5.0), OnBlock::Stop).await?;
                moves.send(()).unwrap();
                gripper.wait(&motion).await
            });
            tokio::select! {
                result = program => panic!("half a minute has not passed: {result:?}"),
                begun = moving => begun.unwrap(),
            }
        });
        let flags = flags_at_rest(address);
        assert!(!flags.contains(SystemFlags::FAST_STOP), "{flags}");
    }
}

/// A pseudo terminal and a Unix socket, as serial lines.
#[cfg(unix)]
mod on_unix {
    use super::*;
    use ::tokio::io::BufStream;
    use ::tokio::net::UnixStream;
    use wsg_protocol::driver::{asynch, tokio};
    use wsg_sim::server::SerialLine;

    fn socket_path(name: &str) -> std::path::PathBuf {
        std::env::temp_dir().join(format!("wsg-protocol-{name}-{}.socket", std::process::id()))
    }

    #[test]
    fn blocking_driver_grips_over_a_serial_port() {
        let server = serve(&Lines { serial: Some(SerialLine::Pty), ..Lines::default() });
        let path = server.serial_path().unwrap().to_str().unwrap().to_owned();
        let port = serialport::new(path, 115_200).timeout(Duration::from_millis(1)).open().unwrap();
        grips(&mut patient(host::Stream::new(port)));
    }

    fn unix_socket(name: &str) -> (ServerThread, std::os::unix::net::UnixStream) {
        let server = serve(&Lines { serial: Some(SerialLine::Unix(socket_path(name))), ..Lines::default() });
        let stream = std::os::unix::net::UnixStream::connect(server.serial_path().unwrap()).unwrap();
        // As `host::Stream` requires.
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        (server, stream)
    }

    #[test]
    fn write_to_a_closed_stream_is_an_error() {
        let closed = || std::os::unix::net::UnixStream::pair().unwrap().0;
        assert_eq!(refused(host::PolledStream::new(closed())), io::ErrorKind::BrokenPipe);
        assert_eq!(refused(host::Stream::new(closed())), io::ErrorKind::BrokenPipe);
    }

    /// A stream whose calls are interrupted every other time and transfer at most three bytes, and which sends at a
    /// flush.
    struct Reluctant {
        stream: std::os::unix::net::UnixStream,
        is_interrupted: bool,
        to_send: Vec<u8>,
    }

    impl Reluctant {
        fn new(stream: std::os::unix::net::UnixStream) -> Self {
            Self { stream, is_interrupted: false, to_send: vec![] }
        }

        fn interrupt(&mut self) -> io::Result<()> {
            self.is_interrupted = !self.is_interrupted;
            if self.is_interrupted { Err(io::ErrorKind::Interrupted.into()) } else { Ok(()) }
        }
    }

    impl io::Read for Reluctant {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.interrupt()?;
            let len = buffer.len().min(3);
            #[expect(clippy::disallowed_methods, reason = "the transport under test takes every error")]
            self.stream.read(&mut buffer[..len])
        }
    }

    impl io::Write for Reluctant {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.interrupt()?;
            let len = bytes.len().min(3);
            self.to_send.extend(&bytes[..len]);
            Ok(len)
        }

        fn flush(&mut self) -> io::Result<()> {
            self.stream.write_all(&std::mem::take(&mut self.to_send))
        }
    }

    impl std::os::fd::AsFd for Reluctant {
        fn as_fd(&self) -> std::os::fd::BorrowedFd<'_> {
            self.stream.as_fd()
        }
    }

    #[test]
    fn blocking_driver_grips_despite_interrupted_and_short_io() {
        let (_server, stream) = unix_socket("reluctant");
        grips(&mut patient(host::PolledStream::new(Reluctant::new(stream))));
        let (_server, stream) = unix_socket("reluctant-read");
        grips(&mut patient(host::Stream::new(Reluctant::new(stream))));
    }

    /// Runs a program in this thread while another thread interrupts it with signals.
    fn under_signals(program: impl FnOnce()) {
        use nix::sys::pthread::{pthread_kill, pthread_self};
        use nix::sys::signal::Signal;
        use std::sync::atomic::{AtomicBool, Ordering};

        // Without a handler, the signal ends the process. This one makes interrupted calls return `Interrupted`.
        let handled = std::sync::Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(Signal::SIGUSR1 as i32, std::sync::Arc::clone(&handled)).unwrap();
        let driver = pthread_self();
        let is_over = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                while !is_over.load(Ordering::Relaxed) {
                    pthread_kill(driver, Signal::SIGUSR1).unwrap();
                    thread::yield_now();
                }
            });
            let ended = catch_unwind(AssertUnwindSafe(program));
            is_over.store(true, Ordering::Relaxed);
            if let Err(panic) = ended {
                std::panic::resume_unwind(panic);
            }
        });
        assert!(handled.load(Ordering::Relaxed));
    }

    #[test]
    fn signals_fail_no_call_of_a_driver_over_any_transport() {
        let (_server, address) = on_tcp();
        let socket = UdpSocket::bind(loopback()).unwrap();
        let remote_port = socket.local_addr().unwrap().port();
        let udp_server =
            serve(&Lines { udp: Some(UdpLine { address: loopback(), remote_port }), ..Lines::default() });
        let (_unix_server, stream) = unix_socket("signals");
        let (_other_unix_server, other_stream) = unix_socket("signals-read");
        under_signals(|| {
            grips(&mut patient(Tcp::connect(address).unwrap()));
            let line = Udp::new(socket, udp_server.udp_address().unwrap()).unwrap();
            grips(&mut patient(line));
            grips(&mut patient(host::PolledStream::new(stream)));
            grips(&mut patient(host::Stream::new(other_stream)));
        });
    }

    #[test]
    fn another_thread_stops_a_motion_over_a_unix_socket() {
        let (_server, stream) = unix_socket("stopped");
        stopped_by_another_thread(&mut Gripper::new(host::PolledStream::new(stream), StdClock::new()));
    }

    #[test]
    fn another_thread_stops_a_motion_over_a_second_stream_handle() {
        let (_server, stream) = unix_socket("second");
        let second = stream.try_clone().unwrap();
        stopped_by_another_thread(&mut Gripper::new(
            host::Stream::with_second(stream, second),
            StdClock::new(),
        ));
    }

    #[test]
    fn async_driver_grips_over_a_stream() {
        let path = socket_path("async");
        let server = serve(&Lines { serial: Some(SerialLine::Unix(path)), ..Lines::default() });
        on_tokio::run(async {
            let stream = UnixStream::connect(server.serial_path().unwrap()).await.unwrap();
            // It sends at a flush.
            let line = tokio::Stream::new(BufStream::new(stream));
            on_tokio::grips(&mut asynch::Gripper::new(line, tokio::TokioTimer::new())).await;
        });
    }
}
