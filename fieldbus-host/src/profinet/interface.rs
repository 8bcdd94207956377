//! The device on a packet socket.

use super::ProfinetLine;
use super::ip::IpStack;
use crate::Owner;
use anyhow::{Context, Result, bail};
use bus_profinet::{Event, MAX_FRAME_LEN, MacAddress, Profile, Stored, Transmit};
use nix::errno::Errno;
use nix::ifaddrs::getifaddrs;
use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, bind, socket};
use std::io::ErrorKind;
use std::os::fd::AsRawFd;
use std::time::SystemTime;
use tokio::net::UnixDatagram;
use tokio::task::yield_now;
use tokio::time::{Duration, Instant, sleep_until};
use wsg_fieldbus::OutputImage;
use wsg_fieldbus::profinet::{Device, PROFILE, faults};

/// The maximum number of frames received per turn.
const FRAMES_A_TURN: usize = 16;
/// The maximum number of discarded frames. More do not fit into the queue of a socket.
const MAX_DISCARDED: usize = 100_000;
/// Size of the receive buffer in bytes. Longer frames are truncated; they are never PROFINET frames.
const BUFFER_LEN: usize = 2_048;

/// An open network interface.
#[derive(Debug)]
pub struct Interface {
    socket: UnixDatagram,
    mac: MacAddress,
}

impl Interface {
    /// Opens a network interface by its name, in the context of a runtime.
    ///
    /// # Errors
    /// Returns an error without the capability CAP_NET_RAW, or if this is no Ethernet interface.
    pub fn open(name: &str) -> Result<Self> {
        let flags = SockFlag::SOCK_CLOEXEC | SockFlag::SOCK_NONBLOCK;
        let socket = match socket(AddressFamily::Packet, SockType::Raw, flags, SockProtocol::EthAll) {
            Err(Errno::EPERM) => bail!(
                "PROFINET on {name} needs the capability CAP_NET_RAW: start as root, \
                 or once `setcap cap_net_raw+ep` on this program"
            ),
            other => other.with_context(|| format!("PROFINET cannot open a socket on {name}"))?,
        };
        let addresses = getifaddrs().context("the network interfaces cannot be listed")?;
        let link = addresses
            .filter(|found| found.interface_name == *name)
            .find_map(|found| Some(*found.address.as_ref()?.as_link_addr()?))
            .with_context(|| format!("PROFINET: unknown network interface {name}"))?;
        let mac = link.addr().filter(|mac| *mac != [0; 6]);
        let mac = mac.with_context(|| format!("PROFINET: {name} is not an Ethernet interface"))?;
        // The link address has no protocol, so the socket keeps receiving all protocols.
        bind(socket.as_raw_fd(), &link).with_context(|| format!("PROFINET cannot bind to {name}"))?;
        // The type serves as a wrapper that sends and receives whole datagrams.
        let socket = UnixDatagram::from_std(std::os::unix::net::UnixDatagram::from(socket))?;
        Ok(Self { socket, mac: MacAddress(mac) })
    }

    /// Serves a device with this data and serial number until the future is dropped.
    ///
    /// # Errors
    /// Returns an error if the runtime ends.
    pub async fn serve(self, stored: Stored, serial_number: u32, owner: impl Owner) -> Result<()> {
        let Self { socket, mac } = self;
        let mut station = Station::new(mac, stored, serial_number, owner);
        let mut buffer = [0; BUFFER_LEN];
        loop {
            let due = station.exchange(&socket);
            tokio::select! {
                () = sleep_until(due) => {}
                readable = socket.readable() => {
                    readable?;
                    station.receive_waiting(&socket, &mut buffer);
                    yield_now().await;
                }
            }
        }
    }
}

/// The device with its owner.
struct Station<O> {
    device: Box<Device>,
    ip: IpStack,
    mac: MacAddress,
    owner: O,
    start: Instant,
    /// The last outputs since the controller enabled them.
    outputs: Option<OutputImage>,
}

impl<O: Owner> Station<O> {
    fn new(mac: MacAddress, stored: Stored, serial_number: u32, owner: O) -> Self {
        Self {
            device: Box::new(Device::new(profile(serial_number), mac, stored, session())),
            ip: IpStack::new(mac, 0),
            mac,
            owner,
            start: Instant::now(),
            outputs: None,
        }
    }

    /// Returns the time of the device in microseconds.
    fn now(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// Processes everything that is due and returns the next due time.
    fn exchange(&mut self, socket: &UnixDatagram) -> Instant {
        let now = self.now();
        while let Some(event) = self.device.poll(now) {
            self.handle(event);
        }
        match self.owner.inputs() {
            Some(inputs) => {
                self.device.show_inputs(&inputs.to_bytes());
                self.device.show_faults(faults(inputs.system));
            }
            None => self.device.show_bad_inputs(),
        }
        self.ip.set_parameters(self.device.ip());
        // Handles the events that the faults caused.
        while let Some(event) = self.device.poll(now) {
            self.handle(event);
        }
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(transmit) = self.device.poll_transmit(now, &mut buffer) {
            match transmit {
                Transmit::Frame(len) => send_frame(socket, buffer.get(..len).unwrap_or(&[])),
                Transmit::Datagram(len, to) => {
                    // Without room, the datagram is lost, like any datagram.
                    let _ = self.ip.send(now, to, buffer.get(..len).unwrap_or(&[]));
                }
            }
        }
        while let Some(len) = self.ip.poll_transmit(now, &mut buffer) {
            send_frame(socket, buffer.get(..len).unwrap_or(&[]));
        }
        let due = self.device.poll_timeout(now);
        let due = self.ip.poll_timeout(now).map_or(due, |ip| due.min(ip));
        self.start + Duration::from_micros(due)
    }

    /// Receives the waiting frames, or discards them after a pause.
    fn receive_waiting(&mut self, socket: &UnixDatagram, buffer: &mut [u8]) {
        for _ in 0..FRAMES_A_TURN {
            if self.owner.has_paused() {
                discard_waiting(socket, buffer);
                // Further frames of the connection may have been delayed on their way.
                if let Some(event) = self.device.disconnect() {
                    self.handle(event);
                }
                return;
            }
            match socket.try_recv(buffer) {
                Ok(len) => self.receive(buffer.get(..len).unwrap_or(&[])),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // The cable is unplugged, or a signal arrived; the next call shows which.
                Err(_) => {}
            }
        }
    }

    fn receive(&mut self, frame: &[u8]) {
        // The socket also receives the frames that this machine sends.
        if frame.get(6..12) == Some(&self.mac.0[..]) {
            return;
        }
        let now = self.now();
        if let Some(event) = self.device.receive(now, frame) {
            self.handle(event);
        }
        self.ip.receive(now, frame);
        let Self { device, ip, .. } = self;
        let event = ip.take_datagram(|from, datagram| device.receive_datagram(now, from, datagram));
        if let Some(event) = event.flatten() {
            self.handle(event);
        }
    }

    fn handle(&mut self, event: Event) {
        let Self { device, owner, .. } = self;
        match event {
            Event::Outputs => {
                let outputs = OutputImage::from_bytes(*device.outputs());
                let before = self.outputs.replace(outputs);
                owner.take_outputs(&outputs, before.as_ref());
            }
            Event::Connected => owner.note(format_args!("a controller exchanges data")),
            Event::Cleared => {
                owner.note(format_args!("the controller provides no valid outputs"));
                self.end_outputs();
            }
            Event::Left(cause) => {
                owner.note(format_args!("the controller has left: {cause:?}"));
                self.end_outputs();
            }
            Event::Signal => owner.note(format_args!("signal: identification requested")),
            Event::Stored => {
                owner.note(format_args!("name {:?}, {}", device.name(), ProfinetLine::ip_text(device.ip())));
                owner.store(device.stored());
            }
        }
    }

    fn end_outputs(&mut self) {
        self.outputs = None;
        self.owner.end_outputs();
    }
}

fn send_frame(socket: &UnixDatagram, frame: &[u8]) {
    // If the cable is unplugged or the queue is full, the frame is lost, like any frame.
    let _ = socket.try_send(frame);
}

/// Discards all frames that wait in the socket.
fn discard_waiting(socket: &UnixDatagram, buffer: &mut [u8]) {
    for _ in 0..MAX_DISCARDED {
        if socket.try_recv(buffer).is_err_and(|error| error.kind() == ErrorKind::WouldBlock) {
            return;
        }
    }
}

/// Returns the profile with this serial number, which lives as long as the program.
fn profile(serial_number: u32) -> &'static Profile {
    let serial_number = Box::leak(serial_number.to_string().into_boxed_str());
    Box::leak(Box::new(Profile { serial_number, ..PROFILE }))
}

/// Returns a number that differs for each start of the program.
fn session() -> u32 {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    since.as_millis() as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::{Cell, RefCell};
    use std::fmt::Arguments;
    use std::rc::Rc;
    use wsg_fieldbus::InputImage;

    /// An owner that logs events.
    #[derive(Clone, Default)]
    struct Log {
        paused: Rc<Cell<bool>>,
        notes: Rc<RefCell<Vec<String>>>,
    }

    impl Owner for Log {
        fn inputs(&self) -> Option<InputImage> {
            None
        }

        fn take_outputs(&self, _: &OutputImage, _: Option<&OutputImage>) {}

        fn end_outputs(&self) {}

        fn note(&self, what: Arguments<'_>) {
            self.notes.borrow_mut().push(what.to_string());
        }

        fn has_paused(&self) -> bool {
            self.paused.take()
        }
    }

    /// A DCP request to flash the LED.
    fn signal(to: MacAddress) -> Vec<u8> {
        let head = [&to.0[..], &[2, 0, 0, 0, 0, 1], &[0x88, 0x92, 0xFE, 0xFD, 4, 0]].concat();
        // Transaction, reserved, length; option, length, qualifier, flash once.
        [&head[..], &[0, 0, 0, 1, 0, 0, 0, 8], &[5, 3, 0, 4, 0, 0, 1, 0]].concat()
    }

    #[tokio::test]
    async fn frames_that_waited_during_a_pause_are_discarded() {
        let (socket, tool) = UnixDatagram::pair().unwrap();
        let (log, mac) = (Log::default(), MacAddress([2, 0, 0, 0, 0, 0x10]));
        let mut station = Station::new(mac, Stored::NONE, 1, log.clone());
        for (is_paused, count, expected) in [(false, 3, 3), (true, 5, 3), (false, 1, 4)] {
            for _ in 0..count {
                tool.send(&signal(mac)).await.unwrap();
            }
            log.paused.set(is_paused);
            socket.readable().await.unwrap();
            station.receive_waiting(&socket, &mut [0; BUFFER_LEN]);
            assert_eq!(log.notes.borrow().len(), expected, "{:?}", log.notes);
        }
    }
}
