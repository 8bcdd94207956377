//! The gripper in a separate process, and its clients.

use anyhow::{Context, Result, ensure};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command as Process, Stdio};
use std::time::Duration;
use wsg_protocol::{Command, Event, FrameEncoder, FrameParser};

/// The argument that starts this program as the gripper. The options of `wsg-sim` follow it.
pub(crate) const SERVE: &str = "serve";
/// Maximum time for an answer.
pub(crate) const PATIENCE: Duration = Duration::from_secs(10);

/// Ticks of the kernel's process clock per second, the same on all current architectures of Linux.
const CLOCK_TICKS: f64 = 100.0;

/// The configuration of the server.
#[derive(Clone, Copy, Default)]
pub(crate) struct Setup<'a> {
    /// A Unix socket instead of a pseudo terminal.
    pub(crate) unix: Option<&'a Path>,
    pub(crate) ignore_checksums: bool,
    pub(crate) udp_remote_port: u16,
}

/// The gripper's process, killed on drop.
pub(crate) struct Sim {
    process: Child,
    pub(crate) tcp: SocketAddr,
    pub(crate) udp: SocketAddr,
    pub(crate) gcl: SocketAddr,
    pub(crate) gcl_udp: SocketAddr,
    pub(crate) modbus: SocketAddr,
    pub(crate) control: SocketAddr,
    pub(crate) serial: PathBuf,
}

/// The two directions of a serial line.
pub(crate) type SerialEnds = (Box<dyn Read + Send>, Box<dyn Write + Send>);

impl Sim {
    pub(crate) fn start(setup: Setup<'_>) -> Result<Self> {
        let serial = setup.unix.map_or("pty".to_owned(), |path| format!("unix:{}", path.display()));
        let remote_port = setup.udp_remote_port.to_string();
        let mut process = Process::new(std::env::current_exe()?);
        process.args([SERVE, "--time-scale", "4", "--part", "20", "--serial", &serial]);
        for line in ["--tcp", "--udp", "--gcl", "--gcl-udp", "--modbus", "--control"] {
            process.args([line, "127.0.0.1:0"]);
        }
        process.args(["--udp-remote-port", &remote_port]);
        process.args(setup.ignore_checksums.then_some("--no-checksum-check"));
        let mut process = process.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        let mut lines = BufReader::new(process.stdout.take().context("standard output is piped")?).lines();
        let mut place = move |name: &str| -> Result<String> {
            let line = lines.next().context("the gripper did not start")??;
            let place = line.strip_prefix(name).with_context(|| format!("{line}, expected {name}"))?;
            Ok(place.trim_start().to_owned())
        };
        place("model")?;
        let sim = Self {
            tcp: place("tcp")?.parse()?,
            udp: place("udp")?.parse()?,
            serial: place("serial")?.into(),
            gcl: place("gcl")?.parse()?,
            gcl_udp: place("gcl-udp")?.parse()?,
            modbus: place("modbus")?.parse()?,
            control: place("control")?.parse()?,
            process,
        };
        // The last line: the gripper ends if it cannot print.
        place("page")?;
        Ok(sim)
    }

    pub(crate) fn connect(&self) -> Result<TcpStream> {
        let stream = TcpStream::connect(self.tcp)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        Ok(stream)
    }

    /// Opens the two directions of the serial line: a Unix socket or a terminal.
    #[cfg(unix)]
    pub(crate) fn open_serial(&self) -> Result<SerialEnds> {
        if let Ok(stream) = std::os::unix::net::UnixStream::connect(&self.serial) {
            return Ok((Box::new(stream.try_clone()?), Box::new(stream)));
        }
        let terminal = std::fs::OpenOptions::new().read(true).write(true).open(&self.serial)?;
        Ok((Box::new(terminal.try_clone()?), Box::new(terminal)))
    }

    /// Serial lines require Unix here.
    #[cfg(not(unix))]
    pub(crate) fn open_serial(&self) -> Result<SerialEnds> {
        anyhow::bail!("{} requires Unix", self.serial.display())
    }

    /// Returns the CPU time used so far, in seconds.
    pub(crate) fn cpu_s(&self) -> Result<f64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.process.id()))?;
        // Fields 14 and 15; the second field, in parentheses, may contain spaces.
        let (_, fields) = stat.rsplit_once(')').context("the kernel's format")?;
        let ticks: Vec<f64> =
            fields.split_whitespace().skip(11).take(2).map(str::parse).collect::<Result<_, _>>()?;
        Ok(ticks.iter().sum::<f64>() / CLOCK_TICKS)
    }

    /// Returns how long the threads were runnable without a processor so far, in seconds.
    pub(crate) fn waited_s(&self) -> Result<f64> {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.process.id()))?;
        tasks.map(|task| waited_s(&task?.path())).sum()
    }

    /// Returns the resident memory, in KiB.
    pub(crate) fn rss_kib(&self) -> Result<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.process.id()))?;
        let line =
            status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("the kernel's format")?;
        Ok(line.trim().trim_end_matches(" kB").parse()?)
    }

    /// Ends the process. It must still be running and, on Unix, exit successfully when it is interrupted.
    pub(crate) fn stop(mut self) -> Result<()> {
        ensure!(self.process.try_wait()?.is_none(), "the gripper ended prematurely");
        #[cfg(unix)]
        {
            use rustix::process::{Pid, Signal, kill_process};
            kill_process(Pid::from_child(&self.process), Signal::INT)?;
            ensure!(self.process.wait()?.success(), "the gripper did not exit successfully");
        }
        Ok(())
    }
}

impl Drop for Sim {
    fn drop(&mut self) {
        // After `stop` there is no process left.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Returns how long this thread was runnable without a processor so far, in seconds.
pub(crate) fn own_wait_s() -> Result<f64> {
    waited_s("/proc/thread-self".as_ref())
}

/// Returns the same for the thread with this directory. Kernels without `CONFIG_SCHED_INFO` show 0 or have no file.
fn waited_s(thread: &Path) -> Result<f64> {
    let Ok(schedstat) = std::fs::read_to_string(thread.join("schedstat")) else { return Ok(0.0) };
    let nanos: f64 = schedstat.split_whitespace().nth(1).context("the kernel's format")?.parse()?;
    Ok(nanos / 1e9)
}

pub(crate) fn frame(command: Command<'_>) -> Vec<u8> {
    FrameEncoder::new(command.id().code(), command).collect()
}

/// Sends a command and waits for `answers` answers to it.
pub(crate) fn ask(stream: &mut (impl Read + Write), command: Command<'_>, answers: usize) -> Result<()> {
    stream.write_all(&frame(command))?;
    let mut parser = FrameParser::<1016>::new();
    let mut seen = 0;
    let mut buffer = [0; 1_024];
    while seen < answers {
        let len = uninterrupted::read(&mut *stream, &mut buffer)?;
        ensure!(len > 0, "the gripper closed the connection");
        for byte in &buffer[..len] {
            let is_answer = |event| matches!(event, Event::Frame(frame) if frame.id == command.id().code());
            seen += usize::from(parser.push(*byte).is_some_and(is_answer));
        }
    }
    Ok(())
}

/// Pseudo-random numbers (SplitMix64), reproducible for a seed.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let value = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        value ^ (value >> 31)
    }

    pub(crate) fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
}
