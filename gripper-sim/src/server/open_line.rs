//! An open line of the server: its name, the place where clients reach it, and how it is served.

use super::hub::{BusLine, Hub};
use anyhow::{Context, Result};
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::pin::Pin;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Serves a line until it fails permanently.
type Serve = Box<dyn FnOnce(Arc<Hub>) -> Pin<Box<dyn Future<Output = Result<()>>>> + Send + Sync>;

/// A line that is open and not served yet.
pub(super) struct OpenLine {
    /// The name that the program prints. It is also the name of the option that sets an address.
    pub(super) name: &'static str,
    pub(super) place: Place,
    /// The bus of a line that carries the register interface.
    pub(super) bus: Option<BusLine>,
    serve: Serve,
}

impl OpenLine {
    pub(super) fn new<F: Future<Output = Result<()>> + 'static>(
        name: &'static str,
        place: Place,
        serve: impl FnOnce(Arc<Hub>) -> F + Send + Sync + 'static,
    ) -> Self {
        Self { name, place, bus: None, serve: Box::new(|hub| Box::pin(serve(hub))) }
    }

    /// Adds the bus, which the fieldbus monitor shows.
    pub(super) fn on_bus(self, bus: BusLine) -> Self {
        Self { bus: Some(bus), ..self }
    }

    /// Serves the line until it fails permanently.
    pub(super) async fn serve(self, hub: Arc<Hub>) -> Result<()> {
        (self.serve)(hub).await
    }
}

impl fmt::Debug for OpenLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("OpenLine")
            .field("name", &self.name)
            .field("place", &self.place)
            .finish_non_exhaustive()
    }
}

/// The place where clients reach a line.
#[derive(Clone, Debug)]
pub(super) enum Place {
    /// The address, with the port that the system chose.
    Address(SocketAddr),
    /// The path that a client opens, or the network interface.
    Path(PathBuf),
}

impl Place {
    pub(super) const fn address(&self) -> Option<SocketAddr> {
        match self {
            Self::Address(address) => Some(*address),
            Self::Path(_) => None,
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(f),
            Self::Path(path) => path.display().fmt(f),
        }
    }
}

/// The places of the lines by name.
#[derive(Clone, Debug, Default)]
pub(super) struct Places(Vec<(&'static str, Place)>);

impl Places {
    pub(super) fn of(lines: &[OpenLine]) -> Self {
        Self(lines.iter().map(|line| (line.name, line.place.clone())).collect())
    }

    /// Returns the places of the lines for which `is_kept` returns `true`.
    pub(super) fn kept(&self, is_kept: impl Fn(&str) -> bool) -> Self {
        Self(self.0.iter().filter(|(name, _)| is_kept(name)).cloned().collect())
    }

    fn place(&self, line: &str) -> Option<&Place> {
        self.0.iter().find(|(name, _)| *name == line).map(|(_, place)| place)
    }

    pub(super) fn address(&self, line: &str) -> Option<SocketAddr> {
        self.place(line)?.address()
    }

    pub(super) fn path(&self, line: &str) -> Option<&Path> {
        match self.place(line)? {
            Place::Path(path) => Some(path),
            Place::Address(_) => None,
        }
    }
}

/// The address of a line as the user specifies it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Listen<'a> {
    /// The name of the line; see [`OpenLine`].
    pub(super) name: &'static str,
    /// The name of the line in errors.
    pub(super) title: &'static str,
    /// The address, if the line is served.
    pub(super) given: Option<SocketAddr>,
    /// The addresses that lines keep across a restart.
    pub(super) kept: &'a Places,
}

impl Listen<'_> {
    /// Returns the address to listen on: after a restart, the same as before.
    pub(super) fn address(&self) -> Option<SocketAddr> {
        self.given.map(|given| self.kept.address(self.name).unwrap_or(given))
    }

    /// Listens for TCP connections. Returns the listener and its place; `None` without an address.
    pub(super) async fn tcp(&self) -> Result<Option<(TcpListener, Place)>> {
        let Some(address) = self.address() else { return Ok(None) };
        let listener = TcpListener::bind(address).await.with_context(|| self.refused(address))?;
        let place = Place::Address(listener.local_addr()?);
        Ok(Some((listener, place)))
    }

    /// Returns the error of an address that cannot be used.
    pub(super) fn refused(&self, address: SocketAddr) -> String {
        format!("{} cannot listen on {address}", self.title)
    }
}
