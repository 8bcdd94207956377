//! The virtual gripper as a program: `wsg-sim --help` says how.

mod options;

use anyhow::{Context, Result};
use options::{LogTo, Options, Request};
use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::process::ExitCode;
use tokio::net::TcpListener;
use wsg_sim::server::{Log, Server};

/// Exit status for options that are wrong.
const WRONG_USE: u8 = 2;
/// Takes the place of the gripper's own port where that needs rights.
const UNPRIVILEGED_TCP: SocketAddr = SocketAddr::V4(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 11_000));

fn main() -> ExitCode {
    let options = match options::parse(lexopt::Parser::from_env()) {
        Ok(Request::Serve(options)) => *options,
        Ok(Request::Help) => return print(&options::usage()),
        Ok(Request::Version) => return print(concat!("wsg-sim ", env!("CARGO_PKG_VERSION"), "\n")),
        Err(error) => return fail(&error, WRONG_USE),
    };
    match serve(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error, 1),
    }
}

fn serve(options: Options) -> Result<()> {
    let log = match &options.log {
        Some(LogTo::Stdout) => Some(Log::to_stdout()),
        Some(LogTo::File(path)) => Some(Log::to_file(path)?),
        None => None,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let server = bind(&options, log).await?;
        announce(&options, &server).context("standard output cannot be written")?;
        server.run(end()?).await
    })
}

/// Ready when the user or the system wants the program to end.
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

/// Ready when the user or the system wants the program to end: Ctrl-C, Ctrl-Break, a console that is closed.
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

/// Opens the lines. The gripper's own port needs rights that an ordinary user lacks on many systems: where no line was asked
/// for, another port takes its place.
async fn bind(options: &Options, log: Option<Log>) -> Result<Server> {
    let mut lines = options.lines.clone();
    if options.is_default_line
        && let Some(address) = lines.tcp
        && !may_listen(address).await
    {
        lines.tcp = Some(UNPRIVILEGED_TCP);
        eprintln!(
            "wsg-sim: port {} needs rights that you lack: serving {UNPRIVILEGED_TCP} instead, \
             as --tcp {UNPRIVILEGED_TCP} does",
            address.port()
        );
    }
    let is_low = lines.tcp.is_some_and(|address| address.port() < 1_024);
    Server::bind(options.config, &lines, log).await.map_err(|error| {
        let is_denied = error
            .downcast_ref::<io::Error>()
            .is_some_and(|error| error.kind() == io::ErrorKind::PermissionDenied);
        if is_denied && is_low {
            error.context(format!("ports below 1024 need rights; try --tcp {UNPRIVILEGED_TCP}"))
        } else {
            error
        }
    })
}

/// Whether the system lets this program listen there. What else is wrong shows when it does.
async fn may_listen(address: SocketAddr) -> bool {
    match TcpListener::bind(address).await {
        Err(error) => error.kind() != io::ErrorKind::PermissionDenied,
        Ok(_) => true,
    }
}

/// Says what is served where, one line each, for people and for scripts that wait for it.
fn announce(options: &Options, server: &Server) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "model {}", options.config.model)?;
    if let Some(address) = server.tcp_address() {
        writeln!(out, "tcp {address}")?;
    }
    if let Some(address) = server.udp_address() {
        writeln!(out, "udp {address}")?;
    }
    if let Some(path) = server.serial_path() {
        writeln!(out, "serial {}", path.display())?;
    }
    if let Some(path) = server.can_path() {
        writeln!(out, "can {}", path.display())?;
    }
    if let Some(address) = server.gcl_address() {
        writeln!(out, "gcl {address}")?;
    }
    if let Some(address) = server.gcl_udp_address() {
        writeln!(out, "gcl-udp {address}")?;
    }
    if let Some(address) = server.modbus_address() {
        writeln!(out, "modbus {address}")?;
    }
    if let Some(path) = server.profibus_path() {
        writeln!(out, "profibus {}", path.display())?;
    }
    #[cfg(feature = "profinet")]
    if let Some(path) = server.profinet_path() {
        writeln!(out, "profinet {}", path.display())?;
    }
    if let Some(address) = server.control_address() {
        writeln!(out, "control {address}")?;
        writeln!(out, "page http://{address}/")?;
    }
    out.flush()
}

fn print(text: &str) -> ExitCode {
    match io::stdout().write_all(text.as_bytes()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::FAILURE,
    }
}

/// One line that says what was wrong.
fn fail(error: &anyhow::Error, status: u8) -> ExitCode {
    eprintln!("wsg-sim: {error:#}");
    ExitCode::from(status)
}
