//! A server that runs in its own thread.

use super::hub::Hub;
use super::open_line::Places;
use super::{Lines, Log, Server};
use crate::axis::Part;
use crate::config::Config;
use crate::faults::Fault;
use crate::gripper::State;
use anyhow::{Context, Result, anyhow};
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, mpsc};
use std::thread::{self, JoinHandle};
use tokio::runtime;
use tokio::sync::oneshot;

/// A gripper served by its own thread, for programs and tests that are not asynchronous. Dropping it powers the gripper off.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::io::{Read, Write};
/// use wsg_sim::Config;
/// use wsg_sim::server::{Lines, ServerThread};
///
/// let lines = Lines { tcp: Some("127.0.0.1:0".parse()?), ..Lines::default() };
/// let server = ServerThread::start(Config::default(), &lines, None)?;
/// let mut stream = std::net::TcpStream::connect(server.tcp_address().expect("TCP is enabled"))?;
/// // Acknowledge (24h) with its key.
/// stream.write_all(&[0xAA, 0xAA, 0xAA, 0x24, 0x03, 0x00, 0x61, 0x63, 0x6B, 0xDC, 0xB9])?;
/// let mut answer = [0; 10];
/// stream.read_exact(&mut answer)?;
/// assert_eq!(answer[3..8], [0x24, 0x02, 0x00, 0x00, 0x00]);
/// server.stop()
/// # }
/// ```
#[derive(Debug)]
pub struct ServerThread {
    hub: Arc<Hub>,
    places: Places,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<Result<()>>>,
}

impl ServerThread {
    /// Opens the lines and powers up the gripper. Clients can connect as soon as this returns.
    ///
    /// # Errors
    /// The errors of [`Server::bind`].
    pub fn start(config: Config, lines: &Lines, log: Option<Log>) -> Result<Self> {
        let lines = lines.clone();
        let (opened, opening) = mpsc::channel();
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new().name("wsg-sim".to_owned()).spawn(move || {
            let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(async {
                let server = Server::bind(config, &lines, log).await?;
                // The caller of `start` waits for it.
                let _ = opened.send((Arc::clone(&server.hub), server.places()));
                let end = async {
                    let _ = ended.await;
                };
                server.run(end).await
            })
        })?;
        match opening.recv() {
            Ok((hub, places)) => Ok(Self { hub, places, end: Some(end), thread: Some(thread) }),
            Err(_) => {
                join(thread)?;
                Err(anyhow!("the server thread ended before its lines were open"))
            }
        }
    }

    /// Returns the TCP address.
    ///
    /// `None` without TCP; with port 0, it contains the port that the system chose.
    #[must_use]
    pub fn tcp_address(&self) -> Option<SocketAddr> {
        self.places.address("tcp")
    }

    /// Returns the UDP address; `None` without UDP.
    #[must_use]
    pub fn udp_address(&self) -> Option<SocketAddr> {
        self.places.address("udp")
    }

    /// Returns the path that a client opens for the serial line.
    #[must_use]
    pub fn serial_path(&self) -> Option<&Path> {
        self.places.path("serial")
    }

    /// Returns the CAN interface, or the path of the SLCAN line.
    #[must_use]
    pub fn can_path(&self) -> Option<&Path> {
        self.places.path("can").or_else(|| self.places.path("slcan"))
    }

    /// Returns the address of the text protocol (GCL) over TCP.
    #[must_use]
    pub fn gcl_address(&self) -> Option<SocketAddr> {
        self.places.address("gcl")
    }

    /// Returns the address of the text protocol (GCL) over UDP.
    #[must_use]
    pub fn gcl_udp_address(&self) -> Option<SocketAddr> {
        self.places.address("gcl-udp")
    }

    /// Returns the address of Modbus/TCP.
    #[must_use]
    pub fn modbus_address(&self) -> Option<SocketAddr> {
        self.places.address("modbus")
    }

    /// Returns the path that a PROFIBUS master opens.
    #[must_use]
    pub fn profibus_path(&self) -> Option<&Path> {
        self.places.path("profibus")
    }

    /// Returns the network interface of the PROFINET device.
    #[must_use]
    pub fn profinet_path(&self) -> Option<&Path> {
        self.places.path("profinet")
    }

    /// Returns the address of the EtherNet/IP adapter.
    #[must_use]
    pub fn ethernetip_address(&self) -> Option<SocketAddr> {
        self.places.address("ethernetip")
    }

    /// Returns the address of the control interface.
    #[must_use]
    pub fn control_address(&self) -> Option<SocketAddr> {
        self.places.address("control")
    }

    /// Returns the state of the gripper as an observer beside it sees it.
    #[must_use]
    pub fn state(&self) -> State {
        self.hub.report().state
    }

    /// Places a part between the fingers, or removes it; see
    /// [`VirtualGripper::set_part`](crate::VirtualGripper::set_part).
    pub fn set_part(&self, part: Option<Part>) {
        self.hub.set_part(part);
    }

    /// Begins or ends a fault of the gripper.
    pub fn set_fault(&self, fault: Fault, on: bool) {
        self.hub.set_fault(fault, on);
    }

    /// Powers the gripper off and joins its thread.
    ///
    /// # Errors
    /// Returns the error that ended the server earlier, if any.
    pub fn stop(mut self) -> Result<()> {
        self.end()
    }

    fn end(&mut self) -> Result<()> {
        // Dropping the sender signals the end.
        self.end = None;
        self.thread.take().map_or(Ok(()), join)
    }
}

impl Drop for ServerThread {
    fn drop(&mut self) {
        // A drop cannot report errors; use `stop` for that.
        let _ = self.end();
    }
}

fn join(thread: JoinHandle<Result<()>>) -> Result<()> {
    thread
        .join()
        .map_err(|_| anyhow!("the thread panicked; see standard error"))
        .context("the server failed")?
}
