//! A server that its page can restart with other settings.

use super::log::Log;
use super::options::{Given, Options, settings};
use super::system_log::{Severity, SystemLog};
use super::{Lines, Server};
use crate::time::Time;
use anyhow::Result;
use std::net::SocketAddr;

/// How a server ended.
#[derive(Debug)]
pub enum Ending {
    /// As the caller requested.
    Stopped,
    /// The page requests a restart: call [`Server::restart`].
    Restart(Box<Restart>),
}

/// What a restart takes over.
#[derive(Debug)]
pub struct Restart {
    /// The options with all changed settings.
    pub(super) options: Options,
    /// The options that the server had.
    pub(super) before: Options,
    pub(super) log: Option<Log>,
    pub(super) system_log: SystemLog,
    /// The addresses that the server had.
    pub(super) bound: Bound,
}

/// The addresses of the lines, with the ports that the system chose.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bound {
    pub(super) tcp: Option<SocketAddr>,
    pub(super) udp: Option<SocketAddr>,
    pub(super) gcl: Option<SocketAddr>,
    pub(super) gcl_udp: Option<SocketAddr>,
    pub(super) modbus: Option<SocketAddr>,
    pub(super) control: Option<SocketAddr>,
}

impl Bound {
    pub(super) fn of(server: &Server) -> Self {
        Self {
            tcp: server.tcp_address(),
            udp: server.udp_address(),
            gcl: server.gcl_address(),
            gcl_udp: server.gcl_udp_address(),
            modbus: server.modbus_address(),
            control: server.control_address(),
        }
    }

    /// Gives each line whose option has not changed the address that it had.
    fn keep(&self, lines: &mut Lines, before: &Given, now: &Given) {
        let keep = |name: &str, line: Option<&mut SocketAddr>, bound: Option<SocketAddr>| {
            if let (Some(line), Some(bound)) = (line, bound)
                && before.get(name) == now.get(name)
            {
                *line = bound;
            }
        };
        keep("tcp", lines.tcp.as_mut(), self.tcp);
        keep("udp", lines.udp.as_mut().map(|udp| &mut udp.address), self.udp);
        keep("gcl", lines.gcl.as_mut(), self.gcl);
        keep("gcl-udp", lines.gcl_udp.as_mut(), self.gcl_udp);
        keep("modbus", lines.modbus.as_mut(), self.modbus);
        keep("control", lines.control.as_mut(), self.control);
    }
}

impl Server {
    /// Opens the lines of these options and powers up the gripper. Its page can change settings and restart it.
    ///
    /// # Errors
    /// Returns an error that names the line that cannot be opened.
    pub async fn bind_options(options: &Options, log: Option<Log>) -> Result<Self> {
        // Built before any line waits for this thread.
        let _ = settings();
        let system_log = SystemLog::open(options.lines.system_log.as_deref())?;
        Self::open(options.config, &options.lines, &mut { log }, system_log, Some(options)).await
    }

    /// Opens the lines again, with the changed settings. If that fails, the system log says why, and the earlier
    /// settings count.
    ///
    /// # Errors
    /// Returns an error if the earlier lines cannot be opened either.
    pub async fn restart(restart: Box<Restart>) -> Result<Self> {
        let Restart { mut options, mut before, mut log, system_log, bound } = *restart;
        bound.keep(&mut options.lines, &before.given, &options.given);
        let opened =
            Self::open(options.config, &options.lines, &mut log, system_log.clone(), Some(&options)).await;
        let error = match opened {
            Ok(server) => return Ok(server),
            Err(error) => error,
        };
        let text = format!("the restart failed, and the earlier settings count: {error:#}");
        system_log.write(Time::ZERO, Severity::Error, "gripper", &text);
        let given = before.given.clone();
        bound.keep(&mut before.lines, &given, &given);
        Self::open(before.config, &before.lines, &mut log, system_log, Some(&before)).await
    }
}
