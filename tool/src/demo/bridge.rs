//! `wsg demo --bus`: the bridge's library between a Modbus RTU master and the virtual gripper.
//!
//! It is the application of the board's firmware, with the same registers and settings. `FAST_STOP_OK` is high, and all other wires
//! are low. It runs in real time, one turn per millisecond or when bytes arrive. Pauses between characters are those that this computer
//! sees: an adapter may add some.

use std::collections::VecDeque;
use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use bus_modbus::rtu::Character;
use embedded_io::{ErrorType, ReadReady, WriteReady};
use serial2::{CharSize, Parity, SerialPort, Settings, StopBits};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, NoCan};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{
    BoardId, BusConfig, BusPort, Config, Format, GripperLine as BridgeLine, PlcBus, ResetCause, Station,
};

use crate::file_flash::FileFlash;
use crate::gripper::Signals;

/// Name of a pseudo terminal in place of a serial port.
const PTY: &str = "pty";

/// Maximum duration of a turn.
const TURN: Duration = Duration::from_millis(1);

/// Longest time that passes for the bridge between two turns. A paused computer pauses the bridge, too, which would otherwise
/// miss a gripper whose answers wait.
const LONGEST_STEP: Duration = Duration::from_millis(50);

/// Ports and settings of the bridge.
pub(super) struct Options<'a> {
    /// Serial port of the PLC's bus.
    pub(super) bus: &'a str,
    /// Serial port of the service port.
    pub(super) service: Option<&'a str>,
    /// File that stores the settings.
    pub(super) settings: Option<&'a Path>,
}

/// A line from which bytes were received.
#[derive(Clone, Copy)]
enum Source {
    Gripper,
    Bus,
    Service,
}

/// Received bytes, or the reason why a line has ended.
type Received = (Source, io::Result<Vec<u8>>);

/// A bridge that is connected to a virtual gripper at a TCP address.
pub(super) struct VirtualBridge {
    station: Station<NoCan>,
    flash: FileFlash,
    gripper: GripperLine,
    bus: RtuLine,
    service: RtuLine,
    received: Receiver<Received>,
    /// Time since the start, without pauses of the computer.
    time: Duration,
    outputs: Outputs,
}

impl VirtualBridge {
    /// Opens all lines, and starts the bridge with the stored settings.
    pub(super) fn open(options: &Options<'_>, gripper: &str) -> Result<Self> {
        let flash = FileFlash::open(options.settings)?;
        let mut station = Station::without_profibus(CanBus::new(NoCan, BusOffPolicy::DEFAULT));
        let config =
            station.load(&Config::DEFAULT.record(), &flash).context("the stored settings are invalid")?;
        ensure!(
            (config.plc_bus, config.gripper_line) == (PlcBus::Modbus, BridgeLine::Serial),
            "the stored settings select a bus or a gripper's line that only a board has; expected PLC_BUS 1 and GRIPPER_LINE 0, or a \
             new file"
        );
        station.start(&config, BoardId { name: "wsg demo", serial: 0 }, ResetCause::PowerOn);
        let (sender, received) = mpsc::channel();
        let line = TcpStream::connect(gripper).context("the virtual gripper does not accept a connection")?;
        line.set_nodelay(true)?;
        listen(Source::Gripper, line.try_clone()?, &sender);
        let bus = RtuLine::open(Source::Bus, options.bus, &config.bus, &sender)?;
        let service = match options.service {
            Some(port) => RtuLine::open(Source::Service, port, &BusConfig::SERVICE, &sender)?,
            None => RtuLine::unconnected(),
        };
        Ok(Self {
            station,
            flash,
            gripper: GripperLine { line, received: VecDeque::new() },
            bus,
            service,
            received,
            time: Duration::ZERO,
            outputs: Outputs::empty(),
        })
    }

    /// Returns the ports of bus and service port with their rates and formats.
    pub(super) fn ports(&self) -> (&str, Option<&str>) {
        (&self.bus.name, Some(&self.service.name[..]).filter(|name| !name.is_empty()))
    }

    /// Runs the bridge until a signal is caught. Calls `show` for each change of the outputs.
    pub(super) fn run(
        &mut self,
        signals: &Signals,
        mut show: impl FnMut(Duration, Outputs) -> Result<()>,
    ) -> Result<()> {
        let mut last = Instant::now();
        while signals.check().is_ok() {
            match self.received.recv_timeout(TURN) {
                Ok(received) => self.take(received)?,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => bail!("all lines have ended"),
            }
            while let Ok(received) = self.received.try_recv() {
                self.take(received)?;
            }
            let now = Instant::now();
            self.time += now.duration_since(last).min(LONGEST_STEP);
            last = now;
            let Self { station, flash, gripper, bus, service, time, outputs, .. } = self;
            let now_ms = time.as_millis() as u32;
            let after = station.turn(now_ms, Inputs::FAST_STOP_OK, gripper, bus, service, flash);
            if std::mem::replace(outputs, after) != after {
                show(*time, after)?;
            }
        }
        Ok(())
    }

    fn take(&mut self, (source, bytes): Received) -> Result<()> {
        let line = match source {
            Source::Gripper => {
                let bytes = bytes.context("the connection to the virtual gripper has ended")?;
                self.gripper.received.extend(bytes);
                return Ok(());
            }
            Source::Bus => &mut self.bus,
            Source::Service => &mut self.service,
        };
        let bytes = bytes.with_context(|| format!("the serial port {} has failed", line.name))?;
        line.deliver(&bytes);
        Ok(())
    }
}

/// Passes on what a line receives, in a thread of its own, until the line ends.
fn listen(source: Source, mut line: impl Read + Send + 'static, sender: &Sender<Received>) {
    let sender = sender.clone();
    thread::spawn(move || {
        let mut buffer = [0; 512];
        loop {
            #[expect(clippy::disallowed_methods, reason = "retried after an interruption")]
            let received = match line.read(&mut buffer) {
                Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
                Ok(count) => Ok(buffer.get(..count).unwrap_or(&[]).to_vec()),
                Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::TimedOut) => {
                    continue;
                }
                Err(error) => Err(error),
            };
            let is_over = received.is_err();
            if sender.send((source, received)).is_err() || is_over {
                return;
            }
        }
    });
}

/// Returns a queue of one frame for a port. A thread of its own sends them, because a master that does not read blocks it.
fn sender_to(mut port: impl Write + Send + 'static) -> SyncSender<Vec<u8>> {
    let (sender, frames) = mpsc::sync_channel::<Vec<u8>>(1);
    thread::spawn(move || {
        for frame in frames {
            if port.write_all(&frame).is_err() {
                return;
            }
        }
    });
    sender
}

/// The bridge's end of the gripper's line.
struct GripperLine {
    line: TcpStream,
    received: VecDeque<u8>,
}

impl ErrorType for GripperLine {
    type Error = io::Error;
}

impl ReadReady for GripperLine {
    fn read_ready(&mut self) -> io::Result<bool> {
        Ok(!self.received.is_empty())
    }
}

impl embedded_io::Read for GripperLine {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = buffer.len().min(self.received.len());
        buffer.iter_mut().zip(self.received.drain(..count)).for_each(|(slot, byte)| *slot = byte);
        Ok(count)
    }
}

impl WriteReady for GripperLine {
    fn write_ready(&mut self) -> io::Result<bool> {
        Ok(true)
    }
}

impl embedded_io::Write for GripperLine {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.line.write_all(bytes).map(|()| bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A Modbus RTU line.
struct RtuLine {
    /// Port, rate and format; empty without a line.
    name: String,
    /// Passes on answers to the thread that sends them.
    port: Option<SyncSender<Vec<u8>>>,
    /// The other end of a pseudo terminal, kept open so that reads do not fail while no master is connected.
    other_end: Option<SerialPort>,
    waiting: VecDeque<(Character, u32)>,
    /// Time of the last received character.
    heard: Instant,
}

impl RtuLine {
    fn unconnected() -> Self {
        let waiting = VecDeque::new();
        Self { name: String::new(), port: None, other_end: None, waiting, heard: Instant::now() }
    }

    fn open(source: Source, port: &str, config: &BusConfig, sender: &Sender<Received>) -> Result<Self> {
        let mut line = Self::unconnected();
        if port == PTY {
            let Pty { terminal, path, other_end } = open_pty().context("no pseudo terminal can be opened")?;
            listen(source, terminal.try_clone()?, sender);
            line.name = format!("{}  (pseudo terminal: no parity)", path.display());
            line.port = Some(sender_to(terminal));
            line.other_end = Some(other_end);
            return Ok(line);
        }
        let (parity, stop_bits) = match config.format {
            Format::Even1 => (Parity::Even, StopBits::One),
            Format::None1 => (Parity::None, StopBits::One),
            Format::None2 => (Parity::None, StopBits::Two),
        };
        let device = SerialPort::open(port, |mut settings: Settings| {
            settings.set_raw();
            settings.set_baud_rate(config.baud)?;
            settings.set_char_size(CharSize::Bits8);
            settings.set_parity(parity);
            settings.set_stop_bits(stop_bits);
            Ok(settings)
        })
        .with_context(|| format!("the serial port {port} cannot be opened"))?;
        listen(source, device.try_clone()?, sender);
        line.name = format!("{port}  {} bit/s, {}", config.baud, config.format.name());
        line.port = Some(sender_to(device));
        Ok(line)
    }

    fn deliver(&mut self, bytes: &[u8]) {
        let mut silence_us = self.silence_us();
        for byte in bytes {
            self.waiting.push_back((Character::Byte(*byte), std::mem::take(&mut silence_us)));
        }
        self.heard = Instant::now();
    }
}

impl BusPort for RtuLine {
    fn receive(&mut self) -> Option<(Character, u32)> {
        self.waiting.pop_front()
    }

    fn silence_us(&mut self) -> u32 {
        self.heard.elapsed().as_micros().try_into().unwrap_or(u32::MAX)
    }

    fn send(&mut self, frame: &[u8]) {
        if let Some(port) = &self.port {
            // Fails while the master does not read an earlier answer, and after the port is lost, which ends the program by its
            // reader.
            let _ = port.try_send(frame.to_vec());
        }
    }
}

/// A pseudo terminal.
struct Pty {
    /// This program's end.
    terminal: fs::File,
    /// Path of the other end.
    path: PathBuf,
    other_end: SerialPort,
}

#[cfg(unix)]
fn open_pty() -> io::Result<Pty> {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    let terminal = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&terminal)?;
    unlockpt(&terminal)?;
    let path = PathBuf::from(ptsname(&terminal, Vec::new())?.to_str().map_err(io::Error::other)?);
    // This also sets the raw mode.
    let other_end = SerialPort::open(&path, 19_200)?;
    Ok(Pty { terminal: terminal.into(), path, other_end })
}

#[cfg(not(unix))]
fn open_pty() -> io::Result<Pty> {
    Err(io::Error::new(ErrorKind::Unsupported, "this requires Unix; expected a serial port, such as COM3"))
}
