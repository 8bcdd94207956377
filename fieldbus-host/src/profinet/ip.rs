//! ARP, IP and UDP of the device with `smoltcp`: Ethernet frames on one side, datagrams of port [`RPC_PORT`] on the other.

use smoltcp::iface::{Config, Interface, SocketHandle, SocketSet};
use smoltcp::phy::{self, Checksum, DeviceCapabilities, Medium};
use smoltcp::socket::Socket as Handed;
use smoltcp::socket::udp::{PacketBuffer, PacketMetadata, Socket};
use smoltcp::time::Instant;
use smoltcp::wire::{
    EthernetAddress, HardwareAddress, IpAddress, IpCidr, IpEndpoint, IpListenEndpoint, Ipv4Address,
};

use bus_profinet::{Endpoint, IpParameters, MAX_FRAME_LEN, MacAddress, RPC_PORT};

/// Number of datagrams queued in each direction, and of maximum datagrams that fit into the buffers.
const DATAGRAMS: usize = 4;
const DATAGRAM_BYTES: usize = 4_096;
/// Number of frames queued for transmission.
const FRAMES: usize = 4;

/// The IP stack of the device. It answers ARP and ICMP echo requests, and transfers datagrams of port [`RPC_PORT`].
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
    /// Creates a stack without an address.
    pub(super) fn new(mac: MacAddress, now_us: u64) -> Self {
        let mut wire = Wire { received: Frame::EMPTY, sent: [Frame::EMPTY; FRAMES], first: 0, count: 0 };
        let config = Config::new(HardwareAddress::Ethernet(EthernetAddress(mac.0)));
        let interface = Interface::new(config, &mut wire, instant(now_us));
        let buffer = || PacketBuffer::new(vec![PacketMetadata::EMPTY; DATAGRAMS], vec![0; DATAGRAM_BYTES]);
        let mut sockets = SocketSet::new(vec![]);
        let socket = sockets.add(opened(Socket::new(buffer(), buffer())));
        Self { interface, sockets, socket, wire, ip: IpParameters::NONE }
    }

    /// Applies new IP parameters.
    pub(super) fn set_parameters(&mut self, ip: &IpParameters) {
        if self.ip == *ip {
            return;
        }
        self.ip = *ip;
        self.interface.update_ip_addrs(|addresses| {
            addresses.clear();
            if ip.is_set() {
                let address = IpAddress::Ipv4(Ipv4Address::from(ip.address));
                // The list has room for one entry.
                let _ = addresses.push(IpCidr::new(address, ip.prefix_len()));
            }
        });
        let routes = self.interface.routes_mut();
        routes.remove_default_ipv4_route();
        if ip.gateway != [0; 4] && ip.gateway != ip.address {
            // The list has room for one entry.
            let _ = routes.add_default_ipv4_route(Ipv4Address::from(ip.gateway));
        }
    }

    /// Takes an Ethernet frame. Frames other than IP and ARP are ignored.
    pub(super) fn receive(&mut self, now_us: u64, frame: &[u8]) {
        if self.wire.received.set(frame) {
            self.poll(now_us);
        }
    }

    /// Sends a datagram and returns whether there was room. A datagram still waiting for ARP resolution is discarded.
    pub(super) fn send(&mut self, now_us: u64, to: Endpoint, datagram: &[u8]) -> bool {
        let to = IpEndpoint::new(IpAddress::Ipv4(Ipv4Address::from(to.address)), to.port);
        if self.sockets.get::<Socket<'_>>(self.socket).send_queue() > 0 {
            // `smoltcp` retries ARP indefinitely and blocks the queue meanwhile, so an unreachable peer could silence the device.
            let Handed::Udp(mut udp) = self.sockets.remove(self.socket);
            udp.close();
            self.socket = self.sockets.add(opened(udp));
        }
        let is_taken = self.sockets.get_mut::<Socket<'_>>(self.socket).send_slice(datagram, to).is_ok();
        self.poll(now_us);
        is_taken
    }

    /// Passes the next received datagram to `take`.
    pub(super) fn take_datagram<T>(&mut self, take: impl FnOnce(Endpoint, &[u8]) -> T) -> Option<T> {
        let (datagram, from) = self.sockets.get_mut::<Socket<'_>>(self.socket).recv().ok()?;
        let IpAddress::Ipv4(address) = from.endpoint.addr;
        Some(take(Endpoint { address: address.octets(), port: from.endpoint.port }, datagram))
    }

    /// Writes the next frame to send to `buffer` and returns its length.
    pub(super) fn poll_transmit(&mut self, now_us: u64, buffer: &mut [u8; MAX_FRAME_LEN]) -> Option<usize> {
        self.poll(now_us);
        self.wire.take(buffer)
    }

    /// Returns when [`poll_transmit`](Self::poll_transmit) has work without further input.
    pub(super) fn poll_timeout(&mut self, now_us: u64) -> Option<u64> {
        let at = self.interface.poll_at(instant(now_us), &self.sockets)?;
        u64::try_from(at.total_micros()).ok()
    }

    fn poll(&mut self, now_us: u64) {
        self.interface.poll(instant(now_us), &mut self.wire, &mut self.sockets);
    }
}

/// Returns the emptied socket, bound to the RPC port.
fn opened(mut udp: Socket<'static>) -> Socket<'static> {
    // Binding a closed socket fails only for port 0.
    let _ = udp.bind(IpListenEndpoint::from(RPC_PORT));
    udp
}

fn instant(now_us: u64) -> Instant {
    Instant::from_micros(i64::try_from(now_us).unwrap_or(i64::MAX))
}

/// An Ethernet frame; empty if its length is 0.
#[derive(Clone, Copy, Debug)]
struct Frame {
    bytes: [u8; MAX_FRAME_LEN],
    len: usize,
}

impl Frame {
    const EMPTY: Self = Self { bytes: [0; MAX_FRAME_LEN], len: 0 };

    /// Stores a frame unless it is too long. Returns whether it fits.
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

/// The interface to `smoltcp`: one received frame, several frames to send.
#[derive(Debug)]
struct Wire {
    received: Frame,
    sent: [Frame; FRAMES],
    /// Index of the oldest frame in `sent`; `count` is their number.
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
        // Frames from the same machine do not have a checksum yet. A lower layer has verified the frames of other machines.
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
        // `smoltcp` observes the maximum frame length from the capabilities.
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
