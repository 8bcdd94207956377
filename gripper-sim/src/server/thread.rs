//! A server in a thread of its own.

use super::{Lines, Log, Server};
use crate::config::Config;
use anyhow::{Context, Result, anyhow};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::thread::{self, JoinHandle};
use tokio::runtime;
use tokio::sync::oneshot;

/// A gripper that is served from a thread of its own, for programs and tests that are not asynchronous. It is switched
/// off when this is dropped.
///
/// ```
/// # fn main() -> anyhow::Result<()> {
/// use std::io::{Read, Write};
/// use wsg_sim::Config;
/// use wsg_sim::server::{Lines, ServerThread};
///
/// let lines = Lines { tcp: Some("127.0.0.1:0".parse()?), ..Lines::default() };
/// let server = ServerThread::start(Config::default(), &lines, None)?;
/// let mut stream = std::net::TcpStream::connect(server.tcp_address().expect("it was asked for"))?;
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
    addresses: Addresses,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<Result<()>>>,
}

#[derive(Debug)]
struct Addresses {
    tcp: Option<SocketAddr>,
    udp: Option<SocketAddr>,
    serial: Option<PathBuf>,
    can: Option<PathBuf>,
    gcl: Option<SocketAddr>,
    gcl_udp: Option<SocketAddr>,
    modbus: Option<SocketAddr>,
    profibus: Option<PathBuf>,
    #[cfg(feature = "profinet")]
    profinet: Option<PathBuf>,
    control: Option<SocketAddr>,
}

impl ServerThread {
    /// Opens the lines and switches the gripper on. When this returns, clients can connect.
    ///
    /// # Errors
    /// Those of [`Server::bind`].
    pub fn start(config: Config, lines: &Lines, log: Option<Log>) -> Result<Self> {
        let lines = lines.clone();
        let (opened, opening) = mpsc::channel();
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new().name("wsg-sim".to_owned()).spawn(move || {
            let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
            runtime.block_on(async {
                let server = Server::bind(config, &lines, log).await?;
                // Whoever started this waits for it.
                let _ = opened.send(Addresses {
                    tcp: server.tcp_address(),
                    udp: server.udp_address(),
                    serial: server.serial_path().map(Path::to_owned),
                    can: server.can_path().map(Path::to_owned),
                    gcl: server.gcl_address(),
                    gcl_udp: server.gcl_udp_address(),
                    modbus: server.modbus_address(),
                    profibus: server.profibus_path().map(Path::to_owned),
                    #[cfg(feature = "profinet")]
                    profinet: server.profinet_path().map(Path::to_owned),
                    control: server.control_address(),
                });
                let end = async {
                    let _ = ended.await;
                };
                server.run(end).await
            })
        })?;
        match opening.recv() {
            Ok(addresses) => Ok(Self { addresses, end: Some(end), thread: Some(thread) }),
            Err(_) => {
                join(thread)?;
                Err(anyhow!("the server ended before it began"))
            }
        }
    }

    /// The address that TCP listens on.
    #[must_use]
    pub const fn tcp_address(&self) -> Option<SocketAddr> {
        self.addresses.tcp
    }

    /// The address that UDP listens on.
    #[must_use]
    pub const fn udp_address(&self) -> Option<SocketAddr> {
        self.addresses.udp
    }

    /// What a client opens to get at the serial line.
    #[must_use]
    pub fn serial_path(&self) -> Option<&Path> {
        self.addresses.serial.as_deref()
    }

    /// What leads to the CAN bus.
    #[must_use]
    pub fn can_path(&self) -> Option<&Path> {
        self.addresses.can.as_deref()
    }

    /// The address that the text protocol (GCL) over TCP listens on.
    #[must_use]
    pub const fn gcl_address(&self) -> Option<SocketAddr> {
        self.addresses.gcl
    }

    /// The address that the text protocol (GCL) over UDP listens on.
    #[must_use]
    pub const fn gcl_udp_address(&self) -> Option<SocketAddr> {
        self.addresses.gcl_udp
    }

    /// The address that Modbus/TCP listens on.
    #[must_use]
    pub const fn modbus_address(&self) -> Option<SocketAddr> {
        self.addresses.modbus
    }

    /// What a PROFIBUS master opens.
    #[must_use]
    pub fn profibus_path(&self) -> Option<&Path> {
        self.addresses.profibus.as_deref()
    }

    /// The network interface that is a PROFINET device.
    #[cfg(feature = "profinet")]
    #[must_use]
    pub fn profinet_path(&self) -> Option<&Path> {
        self.addresses.profinet.as_deref()
    }

    /// The address that the control interface listens on.
    #[must_use]
    pub const fn control_address(&self) -> Option<SocketAddr> {
        self.addresses.control
    }

    /// Switches the gripper off and waits for the end of its thread.
    ///
    /// # Errors
    /// What ended the server before, if anything did.
    pub fn stop(mut self) -> Result<()> {
        self.end()
    }

    fn end(&mut self) -> Result<()> {
        // Dropping the sender is the sign.
        self.end = None;
        self.thread.take().map_or(Ok(()), join)
    }
}

impl Drop for ServerThread {
    fn drop(&mut self) {
        // Nobody is left to be told; `stop` tells.
        let _ = self.end();
    }
}

fn join(thread: JoinHandle<Result<()>>) -> Result<()> {
    thread.join().map_err(|_| anyhow!("a panic, shown on standard error")).context("the server failed")?
}
