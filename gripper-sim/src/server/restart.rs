//! How a server ends, and what a restart of its page takes over.

use super::hub::Running;
use super::log::Log;
use super::open_line::Places;
use super::system_log::SystemLog;

/// How a server ended.
#[derive(Debug)]
pub enum Ending {
    /// As the caller requested.
    Stopped,
    /// The page requests a restart: call [`Server::restart`](super::Server::restart).
    Restart(Box<Restart>),
}

/// What a restart takes over.
#[derive(Debug)]
pub struct Restart {
    /// The options with all changed settings, and those that the server had.
    pub(super) running: Running,
    pub(super) log: Option<Log>,
    pub(super) system_log: SystemLog,
    /// The places of the lines, with the ports that the system chose.
    pub(super) places: Places,
}
