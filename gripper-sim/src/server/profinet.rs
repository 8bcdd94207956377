//! PROFINET: the device of `bus_profinet` on a network interface of Linux, with its own IP stack in addition to that of
//! the system.

#[cfg(target_os = "linux")]
mod ip;

use super::lines::ProfinetLine;
use super::open_line::OpenLine;
#[cfg(target_os = "linux")]
use super::options::{save, toml_value};
use anyhow::Result;
#[cfg(target_os = "linux")]
use bus_profinet::Stored;
#[cfg(target_os = "linux")]
use std::io;
#[cfg(target_os = "linux")]
use std::path::Path;

/// Saves name, address and I&M in the configuration file that they came from.
#[cfg(target_os = "linux")]
fn keep(path: &Path, stored: &Stored) -> io::Result<()> {
    let stored = ProfinetLine::kept(stored);
    let value = |text: &String| (!text.is_empty()).then(|| toml_value(std::slice::from_ref(text), false));
    save(path, &stored.each_ref().map(|(name, text)| (*name, value(text))))
}

#[cfg(target_os = "linux")]
mod interface {
    use super::ip::IpStack;
    use super::*;
    use crate::port::PortKind;
    use crate::server::hub::{BusLine, ClientHandle, Hub};
    use crate::server::open_line::Place;
    use anyhow::{Context, bail};
    use bus_profinet::{Event, MAX_FRAME_LEN, MacAddress, Profile, Transmit};
    use nix::errno::Errno;
    use nix::ifaddrs::getifaddrs;
    use nix::sys::socket::{AddressFamily, SockFlag, SockProtocol, SockType, bind, socket};
    use std::os::fd::AsRawFd;
    use std::sync::Arc;
    use std::time::SystemTime;
    use tokio::net::UnixDatagram;
    use tokio::task::yield_now;
    use wsg_fieldbus::OutputImage;
    use wsg_fieldbus::profinet::{Device, PROFILE, faults};

    /// The maximum number of frames received per turn.
    const FRAMES_A_TURN: usize = 16;
    /// Size of the receive buffer in bytes. Longer frames are truncated; they are never PROFINET frames.
    const BUFFER_LEN: usize = 2_048;

    /// Opens the line on a network interface.
    pub(in crate::server) fn open(line: &ProfinetLine) -> Result<OpenLine> {
        let name = &line.interface;
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
        let (mac, line) = (MacAddress(mac), line.clone());
        let (place, bus) = (Place::Path(name.into()), bus_line(name, &line.stored));
        Ok(OpenLine::new("profinet", place, move |hub| serve(hub, socket, mac, line)).on_bus(bus))
    }

    async fn serve(hub: Arc<Hub>, socket: UnixDatagram, mac: MacAddress, line: ProfinetLine) -> Result<()> {
        let client = hub
            .connect(PortKind::Profinet, &line.interface)
            .context("all client places are taken; none is left for PROFINET")?;
        let now = hub.now().as_micros();
        let mut station = Station {
            device: Box::new(Device::new(profile(hub.config().serial_number), mac, line.stored, session())),
            ip: IpStack::new(mac, now),
            client,
            line,
            has_outputs: false,
        };
        let mut buffer = [0; BUFFER_LEN];
        loop {
            let due = station.exchange(&hub, &socket);
            tokio::select! {
                () = hub.reached(due) => {}
                readable = socket.readable() => {
                    readable?;
                    for _ in 0..FRAMES_A_TURN {
                        match socket.try_recv(&mut buffer) {
                            Ok(len) => station.receive(&hub, mac, buffer.get(..len).unwrap_or(&[])),
                            Err(error) if error.kind() == io::ErrorKind::WouldBlock => break,
                            // The cable is unplugged, or a signal arrived; the next call shows which.
                            Err(_) => {}
                        }
                    }
                    yield_now().await;
                }
            }
        }
    }

    /// Returns the bit rate of an interface as Linux reports it, or nothing without a link.
    fn interface_rate(interface: &str) -> String {
        let speed = std::fs::read_to_string(format!("/sys/class/net/{interface}/speed")).unwrap_or_default();
        // -1: no link.
        speed.trim().parse::<u32>().map(|mbit| format!("{mbit} Mbit/s")).unwrap_or_default()
    }

    fn bus_line(interface: &str, stored: &Stored) -> BusLine {
        let address = if stored.ip.is_set() { ProfinetLine::ip_text(&stored.ip) } else { String::new() };
        BusLine {
            bus: "PROFINET",
            line: interface.to_owned(),
            address,
            rate: interface_rate(interface),
            name: stored.name.as_str().to_owned(),
        }
    }

    /// The device with its interface.
    struct Station {
        device: Box<Device>,
        ip: IpStack,
        client: ClientHandle,
        line: ProfinetLine,
        /// Whether outputs have been received since the controller enabled them. A flag set in the first outputs is not an edge.
        has_outputs: bool,
    }

    impl Station {
        /// Processes everything that is due and returns the next due time.
        fn exchange(&mut self, hub: &Hub, socket: &UnixDatagram) -> crate::time::Time {
            let now = hub.now().as_micros();
            while let Some(event) = self.device.poll(now) {
                self.handle(hub, event);
            }
            let (input, flags) = hub.shown();
            self.device.show_inputs(&input.to_bytes());
            self.device.show_faults(faults(flags));
            self.ip.set_parameters(self.device.ip());
            // Handles the events that the faults caused.
            while let Some(event) = self.device.poll(now) {
                self.handle(hub, event);
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
            crate::time::Time::from_micros(self.ip.poll_timeout(now).map_or(due, |ip| due.min(ip)))
        }

        fn receive(&mut self, hub: &Hub, mac: MacAddress, frame: &[u8]) {
            // The socket also receives the frames that this machine sends.
            if frame.get(6..12) == Some(&mac.0[..]) {
                return;
            }
            let now = hub.now().as_micros();
            if let Some(event) = self.device.receive(now, frame) {
                self.handle(hub, event);
            }
            self.ip.receive(now, frame);
            let Self { device, ip, .. } = self;
            let event = ip.take_datagram(|from, datagram| device.receive_datagram(now, from, datagram));
            if let Some(event) = event.flatten() {
                self.handle(hub, event);
            }
        }

        fn handle(&mut self, hub: &Hub, event: Event) {
            let note = |what: std::fmt::Arguments<'_>| {
                hub.note_of(&format!("profinet {}", self.line.interface), what)
            };
            match event {
                Event::Outputs => {
                    let image = OutputImage::from_bytes(*self.device.outputs());
                    let is_first = !std::mem::replace(&mut self.has_outputs, true);
                    self.client.write_image(&image, is_first);
                }
                Event::Connected => note(format_args!("a controller exchanges data")),
                Event::Cleared => {
                    note(format_args!("the controller provides no valid outputs"));
                    self.end_outputs();
                }
                Event::Left(cause) => {
                    note(format_args!("the controller has left: {cause:?}"));
                    self.end_outputs();
                }
                Event::Signal => note(format_args!("signal: identification requested")),
                Event::Stored => {
                    note(format_args!(
                        "name {:?}, {}",
                        self.device.name(),
                        ProfinetLine::ip_text(self.device.ip())
                    ));
                    hub.set_bus(bus_line(&self.line.interface, self.device.stored()));
                    let words = |text: String| (!text.is_empty()).then(|| vec![text]);
                    let kept = ProfinetLine::kept(self.device.stored());
                    hub.remember(&kept.map(|(name, text)| (name.to_owned(), words(text))).into());
                    if let Some(path) = &self.line.keep
                        && let Err(error) = keep(path, self.device.stored())
                    {
                        note(format_args!("{} cannot be written: {error}", path.display()));
                    }
                }
            }
        }

        fn end_outputs(&mut self) {
            self.has_outputs = false;
            self.client.end_images();
        }
    }

    fn send_frame(socket: &UnixDatagram, frame: &[u8]) {
        // If the cable is unplugged or the queue is full, the frame is lost, like any frame.
        let _ = socket.try_send(frame);
    }

    /// Returns the profile with this gripper's serial number, which lives as long as the program.
    fn profile(serial_number: u32) -> &'static Profile {
        let serial_number = Box::leak(serial_number.to_string().into_boxed_str());
        Box::leak(Box::new(Profile { serial_number, ..PROFILE }))
    }

    /// Returns a number that differs for each start of the program.
    fn session() -> u32 {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        since.as_millis() as u32
    }
}

#[cfg(target_os = "linux")]
pub(super) use interface::open;

/// Reports that this system does not have packet sockets.
#[cfg(not(target_os = "linux"))]
pub(super) fn open(line: &ProfinetLine) -> Result<OpenLine> {
    anyhow::bail!("PROFINET on {}: packet sockets require Linux", line.interface)
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use bus_profinet::{Maintenance, StationName};
    use std::fs;

    #[test]
    fn stored_values_replace_only_their_lines_in_the_file() {
        let path = std::env::temp_dir().join(format!("wsg-profinet-{}.toml", std::process::id()));
        let others = "# A cell\nmodel = \"wsg32\"\nprofinet = \"eth0\"\n";
        fs::write(
            &path,
            others.to_owned() + "station=\"old\"\nim-date = \"1999\"\nprofinet-ip = \"1.2.3.4/8\"\n",
        )
        .unwrap();
        let stored = Stored {
            name: StationName::new("new").unwrap(),
            ip: ProfinetLine::ip_of_text("10.0.0.5/8,10.0.0.1").unwrap(),
            maintenance: Maintenance {
                function: ProfinetLine::maintenance_of_text("+A \"1\" \\ gr\u{FC}n\u{1}").unwrap(),
                ..Maintenance::NONE
            },
        };
        keep(&path, &stored).unwrap();
        let kept = "station=\"new\"\nprofinet-ip = \"10.0.0.5/8,10.0.0.1\"\n\
                    im-function = \"+A \\\"1\\\" \\\\ gr\u{FC}n\\u0001\"\n";
        assert_eq!(fs::read_to_string(&path).unwrap(), others.to_owned() + kept);
        keep(&path, &Stored::NONE).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), others);
        fs::remove_file(&path).unwrap();
    }

    #[test]
    fn maintenance_fields_survive_the_round_trip_through_text() {
        let mut stored = Stored::NONE;
        for (at, byte) in stored.maintenance.descriptor.iter_mut().enumerate() {
            *byte = (at * 5) as u8;
        }
        let [.., (_, text)] = ProfinetLine::kept(&stored);
        assert_eq!(ProfinetLine::maintenance_of_text(&text), Some(stored.maintenance.descriptor));
        assert_eq!(ProfinetLine::maintenance_of_text::<2>("abc"), None, "too long");
        assert_eq!(ProfinetLine::maintenance_of_text::<2>("\u{100}"), None, "no byte");
        assert_eq!(ProfinetLine::maintenance_of_text::<3>("a"), Some(*b"a  "));
    }
}
