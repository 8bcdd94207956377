//! EtherNet/IP: the adapter of `bus_ethernetip` on an IP address: TCP and UDP port 44818, and UDP port 2222 for cyclic data.

use crate::tcp;
use crate::{Client as TcpClient, Owner};
use anyhow::{Context, Result};
pub use bus_ethernetip::Status;
use bus_ethernetip::{Client, DSCP, Event, IO_PORT, MAX_FRAME_LEN, Network, PORT, Profile, Receiver};
use bus_ethernetip::{Registers, State, Transmit};
use socket2::{Domain, Protocol, SockRef, Socket, Type};
use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::future::{pending, poll_fn};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::ErrorKind;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::rc::Rc;
use std::task::Poll;
use tokio::net::{TcpListener, UdpSocket};
use tokio::sync::{Notify, watch};
use tokio::task::yield_now;
use tokio::time::{Duration, Instant, sleep, sleep_until};
use wsg_fieldbus::OutputImage;
use wsg_fieldbus::ethernetip::{Device, NO_INPUTS, PROFILE};

/// Maximum number of TCP connections. A further one is rejected.
const MAX_CONNECTIONS: usize = 16;
/// Time in which a TCP connection must register a session.
const REGISTRATION_TIME: Duration = Duration::from_secs(10);
/// Time for the last answers of a connection that ends.
const LINGER: Duration = Duration::from_secs(1);
/// The maximum number of datagrams received per socket and turn.
const DATAGRAMS_A_TURN: usize = 16;
/// The maximum number of discarded datagrams. More do not fit into the queue of a socket.
const MAX_DISCARDED: usize = 100_000;
/// Size of the receive buffer in bytes. Longer datagrams are truncated; they are never valid.
const BUFFER_LEN: usize = 2_048;
/// Index of the socket for cyclic data, and of the one for messages. Sockets for broadcasts follow.
const PACKETS: usize = 0;
const MESSAGES: usize = 1;

/// The address of an adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EthernetIpLine {
    /// The IP address, and the port for messages. Cyclic data always has port 2222.
    pub address: SocketAddrV4,
    /// The vendor number.
    pub vendor: u16,
}

impl EthernetIpLine {
    /// The vendor number without one in the options.
    pub const VENDOR: u16 = PROFILE.vendor_id;

    /// Parses `IP` or `IP:PORT`; `None` if it is not the address of a single computer.
    #[must_use]
    pub fn address_of_text(text: &str) -> Option<SocketAddrV4> {
        let port_of_bus = |_| text.parse().map(|ip| SocketAddrV4::new(ip, PORT));
        let address: SocketAddrV4 = text.parse().or_else(port_of_bus).ok()?;
        let ip = address.ip();
        (!ip.is_unspecified() && !ip.is_multicast() && !ip.is_broadcast()).then_some(address)
    }
}

/// An adapter with open ports.
#[derive(Debug)]
pub struct Adapter {
    listener: TcpListener,
    sockets: Vec<UdpSocket>,
    address: SocketAddrV4,
    profile: Profile,
    network: Network,
}

impl Adapter {
    /// Opens the ports, in the context of a runtime. With port 0, the system chooses the port for messages.
    ///
    /// # Errors
    /// Returns an error if an address is not this computer's, or a port is in use.
    pub async fn open(line: EthernetIpLine) -> Result<Self> {
        let ip = *line.address.ip();
        let refused = |address| move || format!("EtherNet/IP cannot listen on {address}");
        let listener = TcpListener::bind(line.address).await.with_context(refused(line.address))?;
        let address = SocketAddrV4::new(ip, listener.local_addr()?.port());
        // Without priorities, packets take longer in a busy network.
        let _ = SockRef::from(&listener).set_tos_v4(u32::from(DSCP[4]) << 2);
        let (network, broadcasts) = network(ip);
        let packets = udp(SocketAddrV4::new(ip, IO_PORT), false)?;
        let socket = SockRef::from(&packets);
        let _ = socket.set_tos_v4(u32::from(DSCP[1]) << 2);
        // Groups are of the network of this address, and no router forwards their packets.
        let directed = socket.set_multicast_if_v4(&ip).and_then(|()| socket.set_multicast_ttl_v4(1));
        let profile = Profile { vendor_id: line.vendor, allows_multicast: directed.is_ok(), ..PROFILE };
        let mut sockets = vec![packets, udp(address, false)?];
        for ip in broadcasts {
            sockets.push(udp(SocketAddrV4::new(ip, address.port()), true)?);
        }
        Ok(Self { listener, sockets, address, profile, network })
    }

    /// Returns the address and port for messages.
    #[must_use]
    pub const fn address(&self) -> SocketAddrV4 {
        self.address
    }

    /// Serves an adapter with this serial number until the future is dropped, in a [`LocalSet`](tokio::task::LocalSet).
    pub async fn serve(self, serial_number: u32, owner: impl Owner + 'static) {
        let Self { listener, sockets, network, profile, .. } = self;
        let profile = Profile { serial_number, ..profile };
        let shared = Rc::new(Shared {
            station: RefCell::new(Station::new(profile, network, owner)),
            changed: Notify::new(),
        });
        let mut buffer = [0; BUFFER_LEN];
        let exchange = async {
            loop {
                let due = shared.station.borrow_mut().exchange(&sockets, &mut buffer);
                tokio::select! {
                    () = sleep_until(due) => {}
                    () = shared.changed.notified() => {}
                    () = any_readable(&sockets) => {
                        shared.station.borrow_mut().receive_waiting(&sockets, &mut buffer);
                        yield_now().await;
                    }
                }
            }
        };
        tokio::select! {
            () = tcp::serve(listener, |peer| Connection::open(&shared, peer)) => {}
            () = exchange => {}
        }
    }
}

/// Opens a UDP socket. Several adapters of a computer receive the same broadcasts.
fn udp(address: SocketAddrV4, is_shared: bool) -> Result<UdpSocket> {
    let open = || {
        let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
        socket.set_reuse_address(is_shared)?;
        socket.set_nonblocking(true)?;
        socket.bind(&SocketAddr::from(address).into())?;
        UdpSocket::from_std(socket.into())
    };
    open().with_context(|| format!("EtherNet/IP cannot listen on UDP {address}"))
}

/// Returns the interface with this address, and its addresses for broadcasts. Linux delivers these to sockets that are bound to
/// them, Windows to the address itself. Elsewhere, broadcasts are not received, and mask and Ethernet address are unknown. The speed
/// is unknown: it may change at any time.
fn network(address: Ipv4Addr) -> (Network, Vec<Ipv4Addr>) {
    let (mask, mac, broadcasts) = interface(address).unwrap_or((Ipv4Addr::BROADCAST, [0; 6], Vec::new()));
    (Network { address, mask, gateway: Ipv4Addr::UNSPECIFIED, mac, speed: 0 }, broadcasts)
}

/// Returns mask, Ethernet address and addresses for broadcasts.
#[cfg(target_os = "linux")]
fn interface(address: Ipv4Addr) -> Option<(Ipv4Addr, [u8; 6], Vec<Ipv4Addr>)> {
    use nix::net::if_::InterfaceFlags;
    use nix::sys::socket::SockaddrStorage;

    let ip = |it: &Option<SockaddrStorage>| Some(*SocketAddrV4::from(*it.as_ref()?.as_sockaddr_in()?).ip());
    let interfaces: Vec<_> = nix::ifaddrs::getifaddrs().ok()?.collect();
    let own = interfaces.iter().find(|it| ip(&it.address) == Some(address))?;
    let mut links = interfaces.iter().filter(|it| it.interface_name == own.interface_name);
    let mac = links.find_map(|it| it.address.as_ref()?.as_link_addr()?.addr());
    let is_broadcast = own.flags.contains(InterfaceFlags::IFF_BROADCAST);
    let broadcasts = [ip(&own.broadcast), Some(Ipv4Addr::BROADCAST)].into_iter().flatten();
    Some((ip(&own.netmask)?, mac.unwrap_or_default(), broadcasts.filter(|_| is_broadcast).collect()))
}

#[cfg(not(target_os = "linux"))]
fn interface(_: Ipv4Addr) -> Option<(Ipv4Addr, [u8; 6], Vec<Ipv4Addr>)> {
    None
}

async fn any_readable(sockets: &[UdpSocket]) {
    poll_fn(|context| {
        let is_readable = sockets.iter().any(|socket| socket.poll_recv_ready(context).is_ready());
        if is_readable { Poll::Ready(()) } else { Poll::Pending }
    })
    .await;
}

/// The adapter as its connections share it.
struct Shared<O> {
    station: RefCell<Station<O>>,
    /// Notified when a message may have changed the due times.
    changed: Notify,
}

/// The device with its owner.
struct Station<O> {
    device: Box<Device>,
    profile: Profile,
    network: Network,
    owner: O,
    start: Instant,
    /// The last outputs since the controller enabled them.
    outputs: Option<OutputImage>,
    /// The TCP connections by number. Those that are `true` end.
    connections: BTreeMap<u32, watch::Sender<bool>>,
    /// Number of the next connection.
    next: u32,
}

impl<O: Owner> Station<O> {
    fn new(profile: Profile, network: Network, owner: O) -> Self {
        Self {
            device: device(profile, network),
            profile,
            network,
            owner,
            start: Instant::now(),
            outputs: None,
            connections: BTreeMap::new(),
            next: 0,
        }
    }

    /// Returns the time of the device in microseconds.
    fn now(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// Processes everything that is due and returns the next due time.
    fn exchange(&mut self, sockets: &[UdpSocket], buffer: &mut [u8]) -> Instant {
        self.end_after_pause(sockets, buffer);
        let now = self.now();
        self.handle_events(now);
        self.show_inputs();
        let mut datagram = [0; MAX_FRAME_LEN];
        while let Some(transmit) = self.device.poll_transmit(now, &mut datagram) {
            let (socket, len, to) = match transmit {
                Transmit::Io(len, to) => (PACKETS, len, to),
                Transmit::Answer(len, to) => (MESSAGES, len, to),
            };
            send(sockets, socket, datagram.get(..len), to);
        }
        self.start + Duration::from_micros(self.device.poll_timeout(now))
    }

    fn show_inputs(&mut self) {
        let inputs = self.owner.inputs().unwrap_or(NO_INPUTS);
        self.device.show_inputs(&inputs.to_bytes());
    }

    /// Receives the waiting datagrams, or discards them after a pause.
    fn receive_waiting(&mut self, sockets: &[UdpSocket], buffer: &mut [u8]) {
        for (at, socket) in sockets.iter().enumerate() {
            for _ in 0..DATAGRAMS_A_TURN {
                if self.end_after_pause(sockets, buffer) {
                    return;
                }
                match socket.try_recv_from(buffer) {
                    Ok((len, SocketAddr::V4(from))) => {
                        let datagram = buffer.get(..len).unwrap_or(&[]);
                        if at == PACKETS {
                            self.receive_packet(*from.ip(), datagram);
                        } else {
                            self.receive_datagram(sockets, at, from, datagram);
                        }
                    }
                    Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                    // Another datagram was undeliverable, or a signal arrived.
                    Ok(_) | Err(_) => {}
                }
            }
        }
    }

    fn receive_packet(&mut self, from: Ipv4Addr, datagram: &[u8]) {
        let now = self.now();
        let is_of_owner = self.device.receive_packet(now, from, datagram);
        self.handle_events(now);
        if is_of_owner && self.device.state() == State::Run {
            let outputs = OutputImage::from_bytes(*self.device.outputs());
            let before = self.outputs.replace(outputs);
            self.owner.note_controller(from.into());
            self.owner.take_outputs(&outputs, before.as_ref());
        }
    }

    fn receive_datagram(&mut self, sockets: &[UdpSocket], at: usize, from: SocketAddrV4, datagram: &[u8]) {
        let (now, mut answer) = (self.now(), [0; MAX_FRAME_LEN]);
        let answer = self.device.receive_datagram(now, from, at > MESSAGES, datagram, &mut answer);
        if answer.is_some() {
            send(sockets, MESSAGES, answer, from);
        }
    }

    /// Returns the answer to a frame of a TCP connection.
    fn request(&mut self, client: Client, frame: &[u8]) -> Option<Vec<u8>> {
        self.show_inputs();
        let (now, mut answer) = (self.now(), [0; MAX_FRAME_LEN]);
        let Self { device, owner, .. } = self;
        let answer = device.request(now, client, frame, &mut RegistersOf(owner), &mut answer);
        let answer = answer.map(<[u8]>::to_vec);
        self.handle_events(now);
        answer
    }

    fn handle_events(&mut self, now: u64) {
        while let Some(event) = self.device.poll(now) {
            match event {
                Event::Connected => self.owner.note(format_args!("a controller has connected")),
                // Each packet of a running controller is one image; see `receive_packet`.
                Event::Outputs => {}
                Event::Idle => {
                    self.owner.note(format_args!("the controller is idle"));
                    self.end_outputs();
                }
                Event::Left(cause) => {
                    self.owner.note(format_args!("the controller has left: {cause:?}"));
                    self.end_outputs();
                }
                Event::Reset(_) => {
                    self.owner.note(format_args!("a tool restarts the adapter"));
                    self.restart();
                }
                Event::Close(number) => {
                    self.connections.get(&number).map(|connection| connection.send_replace(true));
                }
            }
        }
    }

    fn end_outputs(&mut self) {
        if self.outputs.take().is_some() {
            self.owner.end_outputs();
        }
    }

    /// Ends all connections, as after power-up.
    fn restart(&mut self) {
        self.device = device(self.profile, self.network);
        for connection in self.connections.values() {
            connection.send_replace(true);
        }
        self.end_outputs();
    }

    /// After a pause, discards the waiting datagrams and ends all connections, because further datagrams may have been delayed on
    /// their way. Returns whether there was a pause.
    fn end_after_pause(&mut self, sockets: &[UdpSocket], buffer: &mut [u8]) -> bool {
        let has_paused = self.owner.has_paused();
        if has_paused {
            for socket in sockets {
                let is_empty = |_: &usize| {
                    socket.try_recv_from(buffer).is_err_and(|error| error.kind() == ErrorKind::WouldBlock)
                };
                let _ = (0..MAX_DISCARDED).find(is_empty);
            }
            self.restart();
        }
        has_paused
    }
}

/// Returns a device with identifiers that no other station can predict.
fn device(profile: Profile, network: Network) -> Box<Device> {
    Box::new(Device::new(profile, network, RandomState::new().build_hasher().finish()))
}

fn send(sockets: &[UdpSocket], socket: usize, datagram: Option<&[u8]>, to: SocketAddrV4) {
    if let (Some(socket), Some(datagram)) = (sockets.get(socket), datagram) {
        // Without room, or without a way to the station, the datagram is lost, like any datagram.
        let _ = socket.try_send_to(datagram, to.into());
    }
}

/// The owner's registers for explicit messages, which only read.
struct RegistersOf<'a, O>(&'a O);

impl<O: Owner> Registers for RegistersOf<'_, O> {
    fn read(&mut self, instance: u16, attribute: u16, value: &mut [u8]) -> Result<usize, Status> {
        let register = self.0.register(instance, attribute)?.to_le_bytes();
        let place = value.first_chunk_mut().ok_or(Status::ReplyTooLarge)?;
        *place = register;
        Ok(register.len())
    }

    fn write(&mut self, instance: u16, attribute: u16, _: &[u8], _: bool) -> Result<(), Status> {
        self.0.register(instance, attribute)?;
        Err(Status::NotSettable)
    }
}

/// A TCP connection.
struct Connection<O: Owner> {
    shared: Rc<Shared<O>>,
    client: Client,
    since: Instant,
    ends: watch::Receiver<bool>,
    frames: RefCell<(Receiver, VecDeque<Vec<u8>>)>,
}

impl<O: Owner> Connection<O> {
    fn open(shared: &Rc<Shared<O>>, peer: SocketAddr) -> Option<Self> {
        let SocketAddr::V4(peer) = peer else { return None };
        let mut station = shared.station.borrow_mut();
        if station.connections.len() >= MAX_CONNECTIONS {
            return None;
        }
        let (number, (sender, ends)) = (station.next, watch::channel(false));
        station.next = number.wrapping_add(1);
        station.connections.insert(number, sender);
        let client = Client { number, address: *peer.ip() };
        let (shared, since) = (Rc::clone(shared), Instant::now());
        Some(Self { shared, client, since, ends, frames: RefCell::default() })
    }

    /// Ready when the connection must end.
    async fn ended(&self) {
        // The sender exists as long as the connection.
        let _ = self.ends.clone().wait_for(|ends| *ends).await;
    }

    fn has_session(&self) -> bool {
        self.shared.station.borrow().device.has_session(self.client.number)
    }
}

impl<O: Owner> TcpClient<MAX_FRAME_LEN> for Connection<O> {
    fn receive(&self, bytes: &[u8]) {
        let mut frames = self.frames.borrow_mut();
        let (receiver, answers) = &mut *frames;
        let mut rest = bytes;
        while !rest.is_empty() {
            let (taken, frame) = receiver.push_slice(rest);
            if let Some(frame) = frame {
                answers.extend(self.shared.station.borrow_mut().request(self.client, frame));
            }
            rest = rest.get(taken..).unwrap_or(&[]);
        }
        self.shared.changed.notify_one();
    }

    fn transmit<'a>(&self, buffer: &'a mut [u8; MAX_FRAME_LEN]) -> Option<&'a [u8]> {
        let answer = self.frames.borrow_mut().1.pop_front()?;
        let place = buffer.get_mut(..answer.len())?;
        place.copy_from_slice(&answer);
        Some(place)
    }

    fn is_over(&self) -> bool {
        *self.ends.borrow() && self.frames.borrow().1.is_empty()
    }

    async fn frame_waits(&self) {
        self.ended().await;
    }

    fn takes_more(&self) -> bool {
        !*self.ends.borrow()
    }

    async fn dismissed(&self) {
        let unregistered = async {
            sleep_until(self.since + REGISTRATION_TIME).await;
            // A connection that ends has lost its session, and its last answers have their time.
            if self.has_session() || *self.ends.borrow() {
                pending().await
            }
        };
        let unread = async {
            self.ended().await;
            sleep(LINGER).await;
        };
        tokio::select! {
            () = unregistered => {}
            () = unread => {}
        }
    }
}

impl<O: Owner> Drop for Connection<O> {
    fn drop(&mut self) {
        let mut station = self.shared.station.borrow_mut();
        station.connections.remove(&self.client.number);
        station.device.closed(self.client.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;
    use std::fmt::Arguments;
    use tokio::time::timeout;
    use wsg_fieldbus::InputImage;

    /// RegisterSession.
    const REGISTER: [u8; 28] =
        [0x65, 0, 4, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0];

    /// An owner without inputs, which may have paused.
    #[derive(Default)]
    struct Paused(Cell<bool>);

    impl Owner for Paused {
        fn inputs(&self) -> Option<InputImage> {
            None
        }

        fn take_outputs(&self, _: &OutputImage, _: Option<&OutputImage>) {}

        fn end_outputs(&self) {}

        fn note(&self, _: Arguments<'_>) {}

        fn has_paused(&self) -> bool {
            self.0.take()
        }
    }

    fn shared() -> Rc<Shared<Paused>> {
        let station = Station::new(PROFILE, network(Ipv4Addr::LOCALHOST).0, Paused::default());
        Rc::new(Shared { station: RefCell::new(station), changed: Notify::new() })
    }

    fn connect(shared: &Rc<Shared<Paused>>) -> Option<Connection<Paused>> {
        Connection::open(shared, (Ipv4Addr::LOCALHOST, 1).into())
    }

    #[tokio::test(start_paused = true)]
    async fn connections_are_limited_and_end_without_a_session() {
        let shared = shared();
        let connections: Vec<_> = (0..MAX_CONNECTIONS).map_while(|_| connect(&shared)).collect();
        assert!(connections.len() == MAX_CONNECTIONS && connect(&shared).is_none());
        let registered = &connections[0];
        registered.receive(&REGISTER);
        assert!(registered.transmit(&mut [0; MAX_FRAME_LEN]).is_some_and(|answer| answer.len() == 28));
        let long = REGISTRATION_TIME + Duration::from_secs(1);
        assert!(timeout(long, connections[1].dismissed()).await.is_ok());
        assert!(timeout(long, registered.dismissed()).await.is_err());
        shared.station.borrow_mut().restart();
        assert!(timeout(LINGER / 2, registered.dismissed()).await.is_err(), "its last answer has no time");
        assert!(timeout(LINGER, registered.dismissed()).await.is_ok());
        drop(connections);
        assert!(connect(&shared).is_some(), "the places are free again");
    }

    #[tokio::test]
    async fn pause_discards_datagrams_and_ends_connections() {
        let (shared, mut buffer) = (shared(), [0; BUFFER_LEN]);
        let connection = connect(&shared).unwrap();
        connection.receive(&REGISTER);
        let sockets = [UdpSocket::bind("127.0.0.1:0").await.unwrap()];
        for is_paused in [false, true] {
            sockets[0].send_to(&[1], sockets[0].local_addr().unwrap()).await.unwrap();
            sockets[0].readable().await.unwrap();
            let mut station = shared.station.borrow_mut();
            station.owner.0.set(is_paused);
            assert_eq!(station.end_after_pause(&sockets, &mut buffer), is_paused);
            assert_eq!(station.device.has_session(connection.client.number), !is_paused);
            assert_eq!(*connection.ends.borrow(), is_paused);
            assert_eq!(sockets[0].try_recv_from(&mut buffer).is_err(), is_paused, "a datagram waits");
        }
    }
}
