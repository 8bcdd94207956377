//! A Raspberry Pi Pico in rp2040js: Node.js runs `emulators/rp2040/main.js`, which takes commands on a socket.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::num::NonZero;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{ChildStderr, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use wsg_bridge_fw::io::Inputs;
use wsg_pico::{INPUTS, OUTPUTS, outputs_from_gpios};

use super::sockets::Sockets;
use super::watch::Watch;
use super::{Chip, Cut, Extras, Lines, PATIENCE, lock};
use crate::can_bus::CanBus;
use crate::clock::Clock;
use crate::example::Process;
use crate::gdb::from_hex;
use crate::masters::NODE_VARIABLE;
use crate::mcp2515::Mcp2515;

pub(super) const NODE: &str = "node with rp2040js";

/// Address range of the flash, where an RP2040 image starts.
pub(super) const FLASH: std::ops::Range<u64> = 0x1000_0000..0x1100_0000;

const CONTROL: &str = "control";
const GRIPPER_LINE: &str = "gripper";
const BUS_LINE: &str = "bus";
const SERVICE_LINE: &str = "service";

/// Polling interval for transmissions of other CAN participants, in machine time.
const LOOK_AT_BUS: Duration = Duration::from_micros(100);

/// Interval at which a process that has not connected is checked for its end.
const LOOK: Duration = Duration::from_millis(50);

#[derive(Debug)]
pub(super) struct Rp2040 {
    _process: Process,
    control: Mutex<Control>,
    _turn: Turn,
}

/// Permission to run one emulator. Each uses about a third of a processor, and too many would be too slow for masters
/// on wall-clock time. Starting a second one while holding a permission can deadlock.
#[derive(Debug)]
struct Turn;

/// Number of running emulators.
static RUNNING: Mutex<usize> = Mutex::new(0);
static HAS_ENDED: Condvar = Condvar::new();

impl Turn {
    fn wait() -> Self {
        let most = thread::available_parallelism().map_or(1, NonZero::get);
        let running = HAS_ENDED.wait_while(lock(&RUNNING), |running| *running >= most);
        *running.unwrap_or_else(PoisonError::into_inner) += 1;
        Self
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        *lock(&RUNNING) -= 1;
        HAS_ENDED.notify_one();
    }
}

#[derive(Debug)]
struct Control {
    commands: Commands,
    answers: Receiver<String>,
}

/// Sends commands to the emulator, one whole line at a time, from any thread.
#[derive(Clone, Debug)]
struct Commands(Arc<Mutex<UnixStream>>);

impl Commands {
    fn send(&self, line: &str) -> io::Result<()> {
        lock(&self.0).write_all(format!("{line}\n").as_bytes())
    }
}

impl Rp2040 {
    /// Starts the emulator, and returns when the firmware's main loop runs.
    pub(super) fn start(
        elf: &Path,
        extras: &Extras<'_>,
        watch: &Arc<Watch>,
        clock: &Clock,
    ) -> Result<(Self, Lines)> {
        ensure!(
            extras.models.is_empty()
                && extras.semihosting.is_none()
                && extras.symbols.is_none()
                && extras.qemu_arguments.is_empty(),
            "the image runs on the Pico, but the extras are for QEMU"
        );
        let Some(packages) = std::env::var_os(NODE_VARIABLE) else {
            bail!("{NODE_VARIABLE} does not name a folder with rp2040js: run `cargo xtask test`");
        };
        let sockets = Sockets::bind(&[CONTROL, GRIPPER_LINE, BUS_LINE, SERVICE_LINE])?;
        let outputs = OUTPUTS.iter().fold(0u32, |mask, wire| mask | 1 << wire.gpio);
        let mut command = Command::new("node");
        command
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("emulators/rp2040/main.js"))
            .arg(elf)
            .arg("--sockets")
            .arg(sockets.directory())
            .args(["--outputs", &outputs.to_string()])
            .env("NODE_PATH", packages)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        if let Some(file) = extras.flash {
            command.arg("--flash").arg(file);
        }
        if let Some(byte) = extras.ram {
            command.args(["--ram", &byte.to_string()]);
        }
        if let Some(Cut { operations, is_torn }) = extras.cut {
            command.args(["--cut", &operations.to_string()]);
            command.args(is_torn.then_some("--torn"));
        }
        if extras.may_reset {
            command.arg("--reboot");
        }
        if extras.can.is_some() {
            command.arg("--can").stdin(Stdio::piped()).stdout(Stdio::piped());
        }
        let turn = Turn::wait();
        let mut process = command.spawn().map(Process).context("cannot run node")?;
        if let Some(printed) = process.0.stderr.take() {
            let watch = Arc::clone(watch);
            thread::spawn(move || receive(printed, &watch));
        }
        if let Some(bus) = &extras.can {
            let (asks, reported) = (process.0.stdout.take(), process.0.stdin.take());
            let (asks, reported) = asks.zip(reported).context("standard input and output are not pipes")?;
            let (bus, watch) = (bus.clone(), Arc::clone(watch));
            thread::spawn(move || serve_spi(asks, reported, &bus, &watch));
        }
        let line = accept(&mut process, &sockets, CONTROL);
        let line = line.with_context(|| lock(&watch.seen).last_words())?;
        let (answer, answers) = mpsc::channel();
        let (reported, commands) = (line.try_clone()?, Commands(Arc::new(Mutex::new(line))));
        let (watch_of_it, clock, and_back) = (Arc::clone(watch), clock.clone(), commands.clone());
        thread::spawn(move || follow(reported, &answer, &watch_of_it, &clock, &and_back));
        let running = watch.wait(PATIENCE, |seen| seen.is_served).map(drop);
        running.with_context(|| format!("no firmware for this board starts from {}", elf.display()))?;
        // The emulator connects the other lines first.
        let [gripper, bus, service] =
            [GRIPPER_LINE, BUS_LINE, SERVICE_LINE].map(|name| sockets.accept(name).map(Some));
        let lines = Lines { gripper: gripper?, bus: bus?, service: service? };
        let control = Mutex::new(Control { commands, answers });
        Ok((Self { _process: process, control, _turn: turn }, lines))
    }
}

impl Chip for Rp2040 {
    fn set_input(&self, wire: Inputs, high: bool) -> Result<()> {
        let Some(wire) = INPUTS.iter().find(|its| its.signal == wire) else { return Ok(()) };
        self.command(&format!("in {} {}", wire.gpio, u8::from(high))).map(drop)
    }

    fn readl(&self, address: u32) -> Result<u32> {
        let bytes = self.read_memory(address, 4)?;
        Ok(bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte)))
    }

    fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>> {
        let digits = self.command(&format!("read {address} {len}"))?;
        let bytes = from_hex(&digits).filter(|bytes| bytes.len() == len);
        bytes.with_context(|| format!("{NODE} returned {digits}, which is not {len} bytes"))
    }

    fn now_ms(&self) -> Result<u32> {
        let micros: u64 = self.command("time")?.parse()?;
        Ok((micros / 1_000) as u32)
    }

    /// Returns the answer after `ok`.
    fn command(&self, command: &str) -> Result<String> {
        let control = lock(&self.control);
        let no_answer = || format!("{NODE} does not answer `{command}`");
        control.commands.send(command).with_context(no_answer)?;
        let answer = control.answers.recv_timeout(PATIENCE).with_context(no_answer)?;
        match answer.split_once(' ').unwrap_or((&answer, "")) {
            ("ok", reported) => Ok(reported.to_owned()),
            (_, why) => bail!("{NODE} rejects `{command}`: {why}"),
        }
    }
}

/// Waits for the connection of this name; fails when the process has ended.
fn accept(process: &mut Process, sockets: &Sockets, name: &str) -> Result<UnixStream> {
    let bound = Instant::now() + PATIENCE;
    loop {
        if sockets.wait(name, LOOK)? {
            return sockets.accept(name);
        }
        ensure!(process.0.try_wait()?.is_none(), "{NODE} has ended");
        ensure!(Instant::now() < bound, "{NODE} does not connect");
    }
}

/// Events of the SPI chip, as defined in `emulators/rp2040/spi.js`.
const TIME_PASSES: u8 = 0;
const SELECTED: u8 = 1;
const BYTE: u8 = 2;
const DESELECTED: u8 = 3;
const RESET: u8 = 4;

/// Acts as the MCP2515 on the board's SPI until the board is switched off.
fn serve_spi(mut asks: ChildStdout, mut reported: ChildStdin, bus: &CanBus<Mcp2515>, watch: &Watch) {
    let (mut question, mut passed) = ([0; 10], 0);
    while asks.read_exact(&mut question).is_ok() {
        let [time @ .., what, byte] = question;
        let now = u64::from_le_bytes(time);
        bus.pass(Duration::from_nanos(now.saturating_sub(passed)));
        passed = now;
        let answer = bus.act(|chip| {
            match what {
                SELECTED => chip.select(),
                BYTE => return chip.exchange(byte),
                DESELECTED => chip.deselect(),
                RESET => chip.reset(),
                _ => debug_assert_eq!(what, TIME_PASSES),
            }
            Ok(0xFF)
        });
        let byte = answer.unwrap_or_else(|why| {
            watch.fail(&format!("{why:#}"));
            0xFF
        });
        let next = bus.until_next().unwrap_or(LOOK_AT_BUS).min(LOOK_AT_BUS);
        let next = now.saturating_add(u64::try_from(next.as_nanos()).unwrap_or(u64::MAX));
        let level = bus.act(|chip| chip.interrupt_pin());
        let mut answer = [byte, u8::from(level), 0, 0, 0, 0, 0, 0, 0, 0];
        answer[2..].copy_from_slice(&next.to_le_bytes());
        if reported.write_all(&answer).is_err() {
            return;
        }
    }
}

/// Records standard error until the emulator ends.
fn receive(printed: ChildStderr, watch: &Watch) {
    for line in BufReader::new(printed).lines().map_while(Result::ok) {
        watch.receive(&line);
    }
    watch.end();
}

/// Processes answers and events until the emulator ends, and resumes it once its peers have caught up with its time.
fn follow(line: UnixStream, answer: &Sender<String>, watch: &Watch, clock: &Clock, commands: &Commands) {
    for line in BufReader::new(line).lines().map_while(Result::ok) {
        match line.split_once(' ').unwrap_or((&line, "")) {
            (event @ ("out" | "served"), levels) => {
                watch.show(outputs_from_gpios(levels.parse().unwrap_or(0)), event == "served");
            }
            ("end", why) => watch.fail(why),
            ("time", micros) => {
                clock.report(micros.parse().unwrap_or(0));
                // The emulator may have ended.
                let _ = commands.send("go on");
            }
            ("reset", _) => {}
            // The requester may have given up.
            _ => drop(answer.send(line)),
        }
    }
}
