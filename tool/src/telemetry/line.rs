//! Lines to grippers. UDP has its own implementation: grippers reply to a fixed port, so one socket serves all of them.

use std::{
    cell::RefCell,
    collections::BTreeMap,
    io::{self, ErrorKind},
    net::SocketAddr,
    rc::{Rc, Weak},
    time::Duration,
};

use embedded_io_async::{ErrorType, Read, Write};
use serial2_tokio::SerialPort;
use socket2::{SockRef, TcpKeepalive};
use tokio::{
    net::{TcpStream, UdpSocket, lookup_host},
    sync::mpsc,
    task::spawn_local,
    time::timeout,
};
use wsg_protocol::driver::tokio::{Stream, Tcp};

use super::config::Address;

/// The rate of the gripper's serial line in bit/s.
const RATE: u32 = 115_200;
/// Time-out for opening a TCP connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);
/// Time without a response after which the operating system closes a TCP connection.
const SILENCE: Duration = Duration::from_secs(20);
/// Capacity of a gripper's datagram queue. A gripper sends about ten at a time at most.
const DATAGRAMS: usize = 64;
/// Maximum length of a datagram in bytes.
const DATAGRAM_LEN: usize = 65_535;

/// A line to a gripper.
#[derive(Debug)]
pub(super) enum Line {
    Tcp(Tcp),
    Udp(UdpLine),
    Serial(Stream<SerialPort>),
}

impl Line {
    /// Opens a line. UDP sockets are shared.
    pub(super) async fn open(address: &Address, sockets: &Sockets) -> io::Result<Self> {
        match address {
            Address::Tcp(host) => {
                let stream = timeout(CONNECT_TIMEOUT, TcpStream::connect(host.as_str())).await??;
                notice_silence(&stream)?;
                Tcp::new(stream).map(Self::Tcp)
            }
            Address::Udp { host, local_port } => {
                let mut found = lookup_host(host.as_str()).await?;
                let peer = found
                    .find(SocketAddr::is_ipv4)
                    .ok_or_else(|| io::Error::new(ErrorKind::NotFound, "the host has no IPv4 address"))?;
                sockets.join(*local_port, peer).await.map(Self::Udp)
            }
            Address::Serial(device) => SerialPort::open(device, RATE).map(Stream::new).map(Self::Serial),
        }
    }
}

/// Enables TCP keep-alive to detect a gripper that lost power or network.
///
/// The driver's time-out must not close the connection: the gripper may only be slow, and closing would cause a FAST STOP.
fn notice_silence(stream: &TcpStream) -> io::Result<()> {
    let socket = SockRef::from(stream);
    let keep_alive = TcpKeepalive::new().with_time(SILENCE / 2).with_interval(SILENCE / 8);
    socket.set_tcp_keepalive(&keep_alive)?;
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(SILENCE))?;
    Ok(())
}

impl ErrorType for Line {
    type Error = io::Error;
}

impl Read for Line {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(buffer).await,
            Self::Udp(line) => line.read(buffer).await,
            Self::Serial(port) => port.read(buffer).await,
        }
    }
}

impl Write for Line {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.write(bytes).await,
            Self::Udp(line) => line.socket.socket.send_to(bytes, line.peer).await,
            Self::Serial(port) => port.write(bytes).await,
        }
    }

    async fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Tcp(stream) => stream.flush().await,
            Self::Udp(_) => Ok(()),
            Self::Serial(port) => port.flush().await,
        }
    }
}

/// A gripper on a shared socket, because grippers reply to one fixed port.
#[derive(Debug)]
pub(super) struct UdpLine {
    socket: Rc<Shared>,
    peer: SocketAddr,
    datagrams: mpsc::Receiver<Vec<u8>>,
    rest: Vec<u8>,
}

impl UdpLine {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.rest.is_empty() {
            self.rest = self.datagrams.recv().await.ok_or(ErrorKind::ConnectionAborted)?;
        }
        let count = self.rest.len().min(buffer.len());
        for (slot, byte) in buffer.iter_mut().zip(self.rest.drain(..count)) {
            *slot = byte;
        }
        Ok(count)
    }
}

impl Drop for UdpLine {
    fn drop(&mut self) {
        self.socket.members.borrow_mut().remove(&self.peer);
    }
}

/// A shared socket and its grippers.
#[derive(Debug)]
struct Shared {
    socket: UdpSocket,
    members: RefCell<BTreeMap<SocketAddr, mpsc::Sender<Vec<u8>>>>,
}

/// The shared UDP sockets by port. Each exists while a gripper uses it.
#[derive(Debug, Default)]
pub(super) struct Sockets {
    by_port: RefCell<BTreeMap<u16, Weak<Shared>>>,
}

impl Sockets {
    async fn join(&self, port: u16, peer: SocketAddr) -> io::Result<UdpLine> {
        let open = self.by_port.borrow().get(&port).and_then(Weak::upgrade);
        let socket = match open {
            Some(socket) => socket,
            None => {
                let socket = UdpSocket::bind(("0.0.0.0", port)).await?;
                let shared = Rc::new(Shared { socket, members: RefCell::default() });
                self.by_port.borrow_mut().insert(port, Rc::downgrade(&shared));
                spawn_local(distribute(Rc::downgrade(&shared)));
                shared
            }
        };
        let (sender, datagrams) = mpsc::channel(DATAGRAMS);
        if socket.members.borrow_mut().insert(peer, sender).is_some() {
            return Err(io::Error::new(ErrorKind::AddrInUse, "two grippers have this address"));
        }
        Ok(UdpLine { socket, peer, datagrams, rest: Vec::new() })
    }
}

/// Forwards datagrams to the line of their sender until no gripper is left.
async fn distribute(shared: Weak<Shared>) {
    /// Interval at which to check whether the socket is still in use.
    const LOOK: Duration = Duration::from_secs(1);
    let mut datagram = vec![0; DATAGRAM_LEN];
    while let Some(shared) = shared.upgrade() {
        let Ok(Ok((len, from))) = timeout(LOOK, shared.socket.recv_from(&mut datagram)).await else {
            continue;
        };
        let members = shared.members.borrow();
        let of_host = |(address, _): &(&SocketAddr, &mpsc::Sender<Vec<u8>>)| address.ip() == from.ip();
        let mut of_this_host = members.iter().filter(of_host);
        // The source port of replies is undocumented, so accept any port if the host has a single gripper.
        let only = of_this_host.next().filter(|_| of_this_host.next().is_none()).map(|(_, sender)| sender);
        if let Some(sender) = members.get(&from).or(only) {
            // Datagrams are lost if the driver does not keep up, as on any network.
            let _ = sender.try_send(datagram.get(..len).unwrap_or(&[]).to_vec());
        }
    }
}
