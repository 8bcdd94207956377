//! ARP, IP and UDP of the device by `smoltcp`: Ethernet frames on one side, datagrams of port [`RPC_PORT`] on the other.

use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{self, Checksum, DeviceCapabilities, Medium};
use smoltcp::socket::Socket as Handed;
use smoltcp::socket::udp::{PacketBuffer, PacketMetadata, Socket};
use smoltcp::time::Instant;
use smoltcp::wire::{
    EthernetAddress, HardwareAddress, IpAddress, IpCidr, IpEndpoint, IpListenEndpoint, Ipv4Address,
};

use bus_profinet::{Endpoint, IpParameters, MAX_FRAME_LEN, MacAddress, RPC_PORT};

/// How many datagrams wait in each direction, and how many bytes of them.
const DATAGRAMS: usize = 4;
const DATAGRAM_BYTES: usize = 4_096;
/// How many frames wait to be sent.
const FRAMES: usize = 4;

/// The IP side of a device: it answers ARP and ICMP echo requests, and carries datagrams from and to port [`RPC_PORT`].
pub(super) struct IpStack {
    interface: Interface,
    sockets: SocketSet<'static>,
    socket: SocketHandle,
    wire: Wire,
    ip: IpParameters,
}

impl core::fmt::Debug for IpStack {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("IpStack").field("ip", &self.ip).finish_non_exhaustive()
    }
}

impl IpStack {
    /// A stack without an address yet.
    pub(super) fn new(mac: MacAddress, now_us: u64) -> Self {
        let mut wire = Wire { received: Frame::EMPTY, sent: [Frame::EMPTY; FRAMES], first: 0, count: 0 };
        let config = Config::new(HardwareAddress::Ethernet(EthernetAddress(mac.0)));
        let interface = Interface::new(config, &mut wire, instant(now_us));
        let buffer = || PacketBuffer::new(vec![PacketMetadata::EMPTY; DATAGRAMS], vec![0; DATAGRAM_BYTES]);
        let mut sockets = SocketSet::new(vec![]);
        let socket = sockets.add(opened(Socket::new(buffer(), buffer())));
        Self { interface, sockets, socket, wire, ip: IpParameters::NONE }
    }

    /// Takes the parameters that count from now on.
    pub(super) fn set_parameters(&mut self, ip: &IpParameters) {
        if self.ip == *ip {
            return;
        }
        self.ip = *ip;
        self.interface.update_ip_addrs(|addresses| {
            addresses.clear();
            if ip.is_set() {
                let address = IpAddress::Ipv4(Ipv4Address::from(ip.address));
                // There is room for one.
                let _ = addresses.push(IpCidr::new(address, ip.prefix_len()));
            }
        });
        let routes = self.interface.routes_mut();
        routes.remove_default_ipv4_route();
        if ip.gateway != [0; 4] && ip.gateway != ip.address {
            // There is room for one.
            let _ = routes.add_default_ipv4_route(Ipv4Address::from(ip.gateway));
        }
    }

    /// Takes an Ethernet frame; what is not IP or ARP is ignored.
    pub(super) fn receive(&mut self, now_us: u64, frame: &[u8]) {
        if self.wire.received.set(frame) {
            self.poll(now_us);
        }
    }

    /// Sends a datagram; whether there was room for it. One that still waits because nobody has its address is given up.
    pub(super) fn send(&mut self, now_us: u64, to: Endpoint, datagram: &[u8]) -> bool {
        let to = IpEndpoint::new(IpAddress::Ipv4(Ipv4Address::from(to.address)), to.port);
        if self.sockets.get::<Socket<'_>>(self.socket).send_queue() > 0 {
            // `smoltcp` asks for an address for ever, and nothing passes what waits: a stranger could make the device mute.
            let Handed::Udp(mut udp) = self.sockets.remove(self.socket);
            udp.close();
            self.socket = self.sockets.add(opened(udp));
        }
        let is_taken = self.sockets.get_mut::<Socket<'_>>(self.socket).send_slice(datagram, to).is_ok();
        self.poll(now_us);
        is_taken
    }

    /// Gives the next datagram that came, to `take`.
    pub(super) fn take_datagram<T>(&mut self, take: impl FnOnce(Endpoint, &[u8]) -> T) -> Option<T> {
        let (datagram, from) = self.sockets.get_mut::<Socket<'_>>(self.socket).recv().ok()?;
        let IpAddress::Ipv4(address) = from.endpoint.addr;
        Some(take(Endpoint { address: address.octets(), port: from.endpoint.port }, datagram))
    }

    /// Writes the next frame that is to be sent, and gives its length.
    pub(super) fn poll_transmit(&mut self, now_us: u64, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<usize> {
        self.poll(now_us);
        self.wire.take(buffer)
    }

    /// When [`poll_transmit`](Self::poll_transmit) has something to do by itself.
    pub(super) fn poll_timeout(&mut self, now_us: u64) -> Option<u64> {
        let at = self.interface.poll_at(instant(now_us), &self.sockets)?;
        u64::try_from(at.total_micros()).ok()
    }

    fn poll(&mut self, now_us: u64) {
        self.interface.poll(instant(now_us), &mut self.wire, &mut self.sockets);
    }
}

/// The socket, with nothing in it, at the port of RPC.
fn opened(mut udp: Socket<'static>) -> Socket<'static> {
    // One that is not open takes any port but 0.
    let _ = udp.bind(IpListenEndpoint::from(RPC_PORT));
    udp
}

fn instant(now_us: u64) -> Instant {
    Instant::from_micros(i64::try_from(now_us).unwrap_or(i64::MAX))
}

/// A frame, if its length is not 0.
#[derive(Clone, Copy, Debug)]
struct Frame {
    bytes: [u8; MAX_FRAME_LEN],
    len: usize,
}

impl Frame {
    const EMPTY: Self = Self { bytes: [0; MAX_FRAME_LEN], len: 0 };

    /// Takes a frame, if it is not too long.
    fn set(&mut self, frame: &[u8]) -> bool {
        let Some(place) = self.bytes.get_mut(..frame.len()) else { return false };
        place.copy_from_slice(frame);
        self.len = frame.len();
        true
    }

    fn get(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&[])
    }
}

/// What `smoltcp` has for a line: one frame in, some out.
#[derive(Debug)]
struct Wire {
    received: Frame,
    sent: [Frame; FRAMES],
    /// The oldest of `sent`, and how many there are.
    first: usize,
    count: usize,
}

impl Wire {
    fn take(&mut self, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<usize> {
        let frame = self.sent.get(self.first).filter(|_| self.count > 0)?.get();
        buffer.get_mut(..frame.len())?.copy_from_slice(frame);
        self.first = self.first.wrapping_add(1) % FRAMES;
        self.count = self.count.saturating_sub(1);
        Some(frame.len())
    }
}

impl phy::Device for Wire {
    type RxToken<'a> = RxToken;
    type TxToken<'a> = TxToken<'a>;

    fn capabilities(&self) -> DeviceCapabilities {
        let mut capabilities = DeviceCapabilities::default();
        capabilities.medium = Medium::Ethernet;
        capabilities.max_transmission_unit = MAX_FRAME_LEN;
        // Frames of a neighbour in the same machine have none yet; those of others were looked at below.
        capabilities.checksum.udp = Checksum::Tx;
        capabilities
    }

    fn receive(&mut self, now: Instant) -> Option<(RxToken, TxToken<'_>)> {
        if self.received.len == 0 || self.count >= FRAMES {
            return None;
        }
        let frame = core::mem::replace(&mut self.received, Frame::EMPTY);
        Some((RxToken(frame), self.transmit(now)?))
    }

    fn transmit(&mut self, _: Instant) -> Option<TxToken<'_>> {
        let at = self.first.wrapping_add(self.count) % FRAMES;
        let place = self.sent.get_mut(at).filter(|_| self.count < FRAMES)?;
        Some(TxToken { place, count: &mut self.count })
    }
}

struct RxToken(Frame);

impl phy::RxToken for RxToken {
    fn consume<R, F: FnOnce(&[u8]) -> R>(self, take: F) -> R {
        take(self.0.get())
    }
}

struct TxToken<'a> {
    place: &'a mut Frame,
    count: &'a mut usize,
}

impl phy::TxToken for TxToken<'_> {
    fn consume<R, F: FnOnce(&mut [u8]) -> R>(self, len: usize, fill: F) -> R {
        let Self { place, count } = self;
        // `smoltcp` keeps to the longest frame that it was told.
        let len = len.min(MAX_FRAME_LEN);
        let (frame, _) = place.bytes.split_at_mut(len);
        let result = fill(frame);
        place.len = len;
        *count = count.saturating_add(1);
        result
    }
}

#[cfg(test)]
mod tests;
