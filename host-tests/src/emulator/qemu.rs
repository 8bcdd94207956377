//! An STM32 board in QEMU. Inputs use qtest, outputs its trace, lines sockets, and additional peripherals GDB.

use std::io::{self, BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use anyhow::{Context, Result, ensure};
use rustix::pipe::fcntl_setpipe_size;
use wsg_bridge_fw::io::Inputs;

use super::output_port::{OutputPort, TRACE_EVENT};
use super::sockets::Sockets;
use super::stm_board::StmBoard;
use super::watch::Watch;
use super::{Chip, Extras, Lines, PATIENCE, lock};
use crate::example::Process;
use crate::flash_controller::{FLASH, FlashController};
use crate::gdb::Gdb;
use crate::qtest::Qtest;
use crate::registers::{Machine, Registers};

pub(super) const QEMU: &str = "qemu-system-arm";

/// Bytes of the trace that QEMU writes before it waits for the harness to read them: about 40 ms of machine time. The
/// firmware writes to its ports in each turn of its main loop. A harness that the host does not run therefore stops the
/// machine, too. Otherwise the gripper in the harness would be silent, and the bridge would report a lost link.
const TRACE_AHEAD: usize = 4096;

/// Names of the lines.
const LINES: [&str; 3] = ["gripper", "bus", "service"];

/// Number of QEMU's serial lines: USART1 to USART3, UART4, UART5, LPUART1.
const SERIAL_LINES: usize = 6;

const NO_CLOCK: &str = "the image has no symbol of a board's millisecond counter";

/// QOM path of the device whose inputs are the interrupt lines.
const CORE: &str = "/machine/soc/armv7m";

#[derive(Debug)]
pub(super) struct Qemu {
    /// Ends before QEMU is reaped, while the process number still belongs to QEMU.
    _leash: Process,
    _process: Process,
    board: &'static StmBoard,
    qtest: Arc<Mutex<Qtest>>,
    /// Address of the firmware's millisecond counter.
    clock_address: Option<u32>,
}

impl Qemu {
    /// Starts QEMU, and returns when the firmware's main loop runs.
    pub(super) fn start(elf: &Path, mut extras: Extras<'_>, watch: &Arc<Watch>) -> Result<(Self, Lines)> {
        ensure!(
            extras.can.is_none()
                && extras.flash.is_none()
                && extras.cut.is_none()
                && extras.ram.is_none()
                && !extras.may_reset,
            "the image runs in QEMU, but the extras are for the Pico"
        );
        let (board, clock_address) = StmBoard::of(extras.symbols.unwrap_or(elf));
        if board.reads_acr && !extras.models.iter().any(|model| model.addresses().contains(&FLASH)) {
            extras.models.push(FlashController::new(&board.flash).access_control());
        }
        let sockets = Sockets::bind(&LINES)?;
        let serial = (0..SERIAL_LINES).flat_map(|line| {
            let name = board.serial.iter().zip(LINES).find(|(number, _)| **number == line);
            let to = name.map_or_else(|| "null".to_owned(), |(_, name)| format!("chardev:{name}"));
            ["-serial".to_owned(), to]
        });
        let (qtest, qtest_server) = UnixStream::pair()?;
        let mut command = Command::new(QEMU);
        command
            .args(["-M", "b-l475e-iot01a", "-display", "none", "-monitor", "none"])
            // An instruction takes 16 ns of machine time; during sleep, machine time follows the wall clock.
            .args(["-icount", "shift=4"])
            // Uses QEMU's standard input as a socket, which needs no name.
            .args(["-chardev", "socket,id=qtest,fd=0", "-qtest", "chardev:qtest", "-qtest-log", "none"])
            .args(LINES.iter().flat_map(|name| {
                let to = sockets.path(name);
                ["-chardev".to_owned(), format!("socket,id={name},path={}", to.display())]
            }))
            .args(serial)
            .args(board.options)
            .args(["-trace", TRACE_EVENT])
            .args(extras.qemu_arguments)
            .arg("-kernel")
            .arg(elf)
            .stdin(Stdio::from(OwnedFd::from(qtest_server)))
            .stdout(Stdio::null());
        let (messages, to_messages) = io::pipe()?;
        // Before QEMU writes: a pipe that holds more than its new size keeps the old one.
        fcntl_setpipe_size(&messages, TRACE_AHEAD).context("cannot limit the pipe of the trace")?;
        command.stderr(to_messages);
        if !extras.models.iter().any(|model| model.resets_machine().is_some()) {
            // Without a watchdog model, a reset by the firmware is a failure: QEMU ends, and so does the test.
            command.arg("-no-reboot");
        }
        if let Some(log) = extras.semihosting {
            ensure!(extras.models.is_empty(), "models and semihosting both take QEMU's standard output");
            command.args(["-semihosting-config", "enable=on,target=native"]).stdout(log);
        }
        let models = if extras.models.is_empty() {
            None
        } else {
            let (gdb, gdb_server) = UnixStream::pair()?;
            // Starts stopped, to set the watchpoints first.
            command.args(["-S", "-chardev", "socket,id=gdb,fd=1", "-gdb", "chardev:gdb"]);
            command.stdout(Stdio::from(OwnedFd::from(gdb_server)));
            let clock_address = clock_address.context(NO_CLOCK)?;
            Some((Gdb::new(gdb, PATIENCE)?, extras.models, clock_address))
        };
        let qtest = Qtest::new(qtest, PATIENCE)?;
        let process = command.spawn().map(Process);
        let process = process.with_context(|| format!("cannot run {QEMU}; `cargo xtask test` sets it up"))?;
        // Closes this process's copy of QEMU's socket, which would hide that QEMU has closed its own.
        drop(command);
        let leash = put_on_leash(&process.0).map(Process).context("cannot run sh")?;
        let qtest = Arc::new(Mutex::new(qtest));
        let qemu = Self { _leash: leash, _process: process, board, qtest, clock_address };
        let followed = Arc::clone(watch);
        thread::spawn(move || follow(messages, OutputPort::of(board), &followed));
        if let Some((gdb, models, clock_address)) = models {
            qemu.serve(Registers::new(gdb, models, clock_address, board.after_reset)?, watch)?;
        }
        let running = watch.wait(PATIENCE.max(extras.patience), |seen| seen.is_served).map(drop);
        running.with_context(|| format!("no firmware for this board starts from {}", elf.display()))?;
        // QEMU connected before the firmware started, so accepting does not block.
        let [gripper, bus, service] = LINES.map(|name| sockets.accept(name).map(Some));
        Ok((qemu, Lines { gripper: gripper?, bus: bus?, service: service? }))
    }

    /// Serves registers to the machine on a separate thread.
    fn serve(&self, registers: Registers, watch: &Arc<Watch>) -> Result<()> {
        let (mut machine, watch) = (BesideGdb(Arc::clone(&self.qtest)), Arc::clone(watch));
        let run = move || {
            if let Err(why) = registers.serve(&mut machine) {
                watch.fail(&format!("{why:#}"));
            }
        };
        thread::Builder::new()
            .name("registers".into())
            .spawn(run)
            .map(drop)
            .context("cannot start the thread for registers")
    }
}

impl Chip for Qemu {
    fn set_input(&self, wire: Inputs, high: bool) -> Result<()> {
        let Some(wire) = self.board.inputs.iter().find(|its| its.signal == wire) else { return Ok(()) };
        let port = format!("/machine/soc/gpio{}", wire.port.letter().to_ascii_lowercase());
        lock(&self.qtest).set_gpio_in(&port, wire.pin, high)
    }

    fn readl(&self, address: u32) -> Result<u32> {
        lock(&self.qtest).readl(address)
    }

    fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>> {
        lock(&self.qtest).read(address, len)
    }

    fn now_ms(&self) -> Result<u32> {
        self.readl(self.clock_address.context(NO_CLOCK)?)
    }
}

/// Accesses the machine through qtest.
struct BesideGdb(Arc<Mutex<Qtest>>);

impl Machine for BesideGdb {
    fn set_interrupt(&mut self, line: u8, level: bool) -> Result<()> {
        lock(&self.0).set_gpio_in(CORE, line, level)
    }

    fn raise_nmi(&mut self) -> Result<()> {
        let mut qtest = lock(&self.0);
        // The core latches the interrupt as pending.
        [true, false].into_iter().try_for_each(|level| qtest.set_irq_in(CORE, "NMI", 0, level))
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        lock(&self.0).readl(address)
    }

    fn store(&mut self, address: u32, value: u32) -> Result<()> {
        lock(&self.0).writel(address, value)
    }
}

/// Starts a process that kills QEMU when this process ends in any way.
///
/// The kernel's `PR_SET_PDEATHSIG` needs `unsafe` and is tied to the thread that started QEMU.
fn put_on_leash(qemu: &Child) -> io::Result<Child> {
    // Its standard input closes only when this process ends, because nothing is ever written. Ctrl-C is left to QEMU.
    const WAIT_AND_KILL: &str = "trap '' HUP INT QUIT TERM; read -r _; kill -KILL \"$0\"";
    Command::new("sh")
        .args(["-c", WAIT_AND_KILL, &qemu.id().to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

/// Follows QEMU's trace until QEMU ends.
fn follow(messages: io::PipeReader, mut port: OutputPort, watch: &Watch) {
    let mut messages = BufReader::new(messages);
    let mut line = Vec::new();
    while matches!(messages.read_until(b'\n', &mut line), Ok(read) if read > 0) {
        let text = String::from_utf8_lossy(&line);
        if port.follow(&text) {
            watch.show(port.outputs(), port.is_served());
        } else {
            watch.receive(&text);
        }
        line.clear();
    }
    watch.end();
}
