//! The virtual gripper as a program; see `wsg-sim --help` (feature `std`).

use crate::server::{Ending, Log, Options, Server};
use crate::text::one_line;
use anyhow::{Context, Result};
use std::ffi::OsString;
use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use tokio::net::TcpListener;

/// Exit status for invalid options.
const WRONG_USE: u8 = 2;
/// Replaces the gripper's own port where listening on that port requires privileges.
const UNPRIVILEGED_TCP: SocketAddr = SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 11_000));

/// Runs `wsg-sim` with the words after the name of the program, and returns its exit status.
///
/// Reports an error in one line with status 1, or 2 for an invalid option. `--help` and `--version` end the process.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let options = match Options::parse(arguments.into_iter().collect()) {
        Ok(options) => options,
        Err(error) => return fail(&error, WRONG_USE),
    };
    match serve(options) {
        Ok(()) => 0,
        Err(error) => fail(&error, 1),
    }
}

fn serve(options: Options) -> Result<()> {
    let log = match &options.log {
        Some(path) if path.as_os_str() == "-" => Some(Log::to_stdout()),
        Some(path) => Some(Log::to_file(path)?),
        None => None,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut server = bind(options, log).await?;
        let mut end = std::pin::pin!(end()?);
        loop {
            announce(&server).context("standard output cannot be written")?;
            match server.run_to_restart(&mut end).await? {
                Ending::Stopped => return Ok(()),
                Ending::Restart(restart) => server = Server::restart(restart).await?,
            }
        }
    })
}

/// Returns a future that is ready when the program must end: SIGINT or SIGTERM.
#[cfg(unix)]
fn end() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
    })
}

/// Returns a future that is ready when the program must end: Ctrl-C, Ctrl-Break, or a closed console.
#[cfg(windows)]
fn end() -> io::Result<impl Future<Output = ()>> {
    use tokio::signal::windows::{ctrl_break, ctrl_c, ctrl_close};
    let (mut interrupt, mut terminate, mut close) = (ctrl_c()?, ctrl_break()?, ctrl_close()?);
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = close.recv() => {}
        }
    })
}

/// Opens the lines. On many systems, the gripper's own port requires privileges. If no line is given, another port replaces it.
async fn bind(mut options: Options, log: Option<Log>) -> Result<Server> {
    if options.is_default_line
        && let Some(address) = options.lines.tcp
        && !may_listen(address).await
    {
        options.lines.tcp = Some(UNPRIVILEGED_TCP);
        eprintln!(
            "wsg-sim: port {} requires privileges that you lack: serving {UNPRIVILEGED_TCP} instead, \
             as --tcp {UNPRIVILEGED_TCP} does",
            address.port()
        );
    }
    let is_low = options.lines.tcp.is_some_and(|address| address.port() < 1_024);
    Server::bind_options(&options, log).await.map_err(|error| {
        let is_denied = error
            .downcast_ref::<io::Error>()
            .is_some_and(|error| error.kind() == io::ErrorKind::PermissionDenied);
        if is_denied && is_low {
            error.context(format!("ports below 1024 require privileges; try --tcp {UNPRIVILEGED_TCP}"))
        } else {
            error
        }
    })
}

/// Returns whether the system permits listening on this address. The server reports any other error.
async fn may_listen(address: SocketAddr) -> bool {
    match TcpListener::bind(address).await {
        Err(error) => error.kind() != io::ErrorKind::PermissionDenied,
        Ok(_) => true,
    }
}

/// Prints each served line, for people and for scripts that wait for it.
fn announce(server: &Server) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "model {}", server.model())?;
    for (line, place) in server.served() {
        writeln!(out, "{line} {}", one_line(&place))?;
    }
    if let Some(address) = server.address("control") {
        writeln!(out, "page http://{address}/")?;
    }
    out.flush()
}

/// Prints the error in one line and returns the exit status.
fn fail(error: &anyhow::Error, status: u8) -> u8 {
    eprintln!("wsg-sim: {}", one_line(&format!("{error:#}")));
    status
}
