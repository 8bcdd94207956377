//! The firmware image on an emulated B-L475E-IOT01A: power it, wire it, watch it.
//!
//! QEMU runs the ELF that is flashed. The PLC's input wires are driven through qtest, its output
//! wires are watched in QEMU's trace, the gripper's line (UART4), the bus (LPUART1) and the service port (USART1) are sockets.
//! Nothing here sleeps, and every wait has a bound. To reset the board drop the [`Emulator`] and start another.
//!
//! QEMU ends with the process that started it, however that ends.
//!
//! Peripherals that QEMU's machine lacks are models, for those who want them ([`Extras::models`]). What nothing here shows
//! are real time, baud rates on the wire and electrical levels.

mod output_port;

use std::fs::{self, File};
use std::io::{self, BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{self, Child, ChildStderr, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use object::{Object, ObjectSymbol};
use wsg_b_l475e_iot01a::INPUTS;
use wsg_bridge_fw::io::{Inputs, Outputs};

use self::output_port::{OutputPort, TRACE_EVENT};
use crate::gdb::Gdb;
use crate::qtest::Qtest;
use crate::registers::{Machine, RegisterModel, Registers};

const QEMU: &str = "qemu-system-arm";

/// QEMU starts in tens of milliseconds and answers in less; this is for a host that is very busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// The sockets' names, each in a directory of its own.
const GRIPPER_LINE: &str = "uart4";
const MODBUS_LINE: &str = "lpuart1";
const SERVICE_LINE: &str = "usart1";

/// Part of the name of the board file's millisecond counter.
const CLOCK_SYMBOL: &str = "4tick6NOW_MS";

/// Whose inputs are the interrupt lines.
const CORE: &str = "/machine/soc/armv7m";

/// Lines kept of what QEMU says besides its trace.
const SAID_MAX: usize = 4;

/// A running board. Dropping it switches it off.
#[derive(Debug)]
pub struct Emulator {
    qemu: Child,
    leash: Child,
    qtest: Arc<Mutex<Qtest>>,
    inputs: Mutex<Inputs>,
    gripper_line: Option<UnixStream>,
    modbus_line: Option<UnixStream>,
    service_line: Option<UnixStream>,
    /// Where the firmware counts its milliseconds.
    clock_address: Option<u32>,
    watch: Arc<Watch>,
}

/// What a board may have besides its wires.
#[derive(Debug, Default)]
pub struct Extras<'a> {
    /// Where the firmware's semihosting output goes, which is a `defmt` log; without it there is no
    /// semihosting, and a firmware that tries locks up.
    pub semihosting: Option<File>,
    /// Peripherals that QEMU lacks. Not together with semihosting: both take QEMU's standard output.
    pub models: Vec<Box<dyn RegisterModel>>,
    /// More arguments to QEMU.
    pub qemu_arguments: &'a [&'a str],
}

/// The wires to the PLC changed, all at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OutputChange {
    /// When the harness saw it.
    pub at: Instant,
    /// All wires after the change.
    pub outputs: Outputs,
}

impl Emulator {
    /// Powers a board with the image `elf`, and returns when the firmware's main loop runs.
    ///
    /// All inputs are low, that is, broken wires: the firmware boots with a FAST STOP wanted.
    ///
    /// # Errors
    /// When QEMU is missing, refuses to start, or runs no firmware for this board; one line says which.
    pub fn start(elf: &Path) -> Result<Self> {
        Self::start_with(elf, Extras::default())
    }

    /// [`start`](Self::start) with `extras`.
    ///
    /// # Errors
    /// See [`start`](Self::start).
    pub fn start_with(elf: &Path, extras: Extras<'_>) -> Result<Self> {
        let uart4 = SocketAddress::bind(GRIPPER_LINE)?;
        let lpuart1 = SocketAddress::bind(MODBUS_LINE)?;
        let usart1 = SocketAddress::bind(SERVICE_LINE)?;
        let (qtest, qtest_server) = UnixStream::pair()?;
        let mut command = Command::new(QEMU);
        command
            .args(["-M", "b-l475e-iot01a", "-display", "none", "-monitor", "none"])
            // An instruction takes 16 ns of the machine's time, asleep it follows the wall clock.
            .args(["-icount", "shift=4"])
            // Standard input of QEMU is a socket here, so this one needs no name.
            .args(["-chardev", "socket,id=qtest,fd=0", "-qtest", "chardev:qtest", "-qtest-log", "none"])
            .args(["-chardev", &format!("socket,id=uart4,path={}", uart4.path().display())])
            .args(["-chardev", &format!("socket,id=lpuart1,path={}", lpuart1.path().display())])
            .args(["-chardev", &format!("socket,id=usart1,path={}", usart1.path().display())])
            // USART1 to USART3, UART4, UART5, LPUART1.
            .args(
                ["chardev:usart1", "null", "null", "chardev:uart4", "null", "chardev:lpuart1"]
                    .iter()
                    .flat_map(|to| ["-serial", to]),
            )
            .args(["-trace", TRACE_EVENT])
            .args(extras.qemu_arguments)
            .arg("-kernel")
            .arg(elf)
            .stdin(Stdio::from(OwnedFd::from(qtest_server)))
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        if !extras.models.iter().any(|model| model.is_watchdog()) {
            // A firmware that resets itself has failed: QEMU ends, and so does the test.
            command.arg("-no-reboot");
        }
        if let Some(log) = extras.semihosting {
            ensure!(extras.models.is_empty(), "models and semihosting both take QEMU's standard output");
            command.args(["-semihosting-config", "enable=on,target=native"]).stdout(log);
        }
        let clock_address = symbol(elf, CLOCK_SYMBOL);
        let models = if extras.models.is_empty() {
            None
        } else {
            let (gdb, gdb_server) = UnixStream::pair()?;
            // It waits for the watchpoints.
            command.args(["-S", "-chardev", "socket,id=gdb,fd=1", "-gdb", "chardev:gdb"]);
            command.stdout(Stdio::from(OwnedFd::from(gdb_server)));
            let clock_address =
                clock_address.with_context(|| format!("the image has no symbol {CLOCK_SYMBOL}"))?;
            Some((Gdb::new(gdb, PATIENCE)?, extras.models, clock_address))
        };
        let qtest = Qtest::new(qtest, PATIENCE)?;
        let mut qemu =
            command.spawn().with_context(|| format!("cannot run {QEMU}; `cargo xtask test` sets it up"))?;
        // It holds this side's copy of QEMU's socket, which would hide that QEMU hangs up.
        drop(command);
        let said_by_qemu = qemu.stderr.take();
        let leash = match put_on_leash(&qemu) {
            Ok(leash) => leash,
            Err(error) => {
                end(&mut qemu);
                return Err(error).context("cannot run sh");
            }
        };
        let mut emulator = Self {
            qemu,
            leash,
            qtest: Arc::new(Mutex::new(qtest)),
            inputs: Mutex::new(Inputs::empty()),
            gripper_line: None,
            modbus_line: None,
            service_line: None,
            clock_address,
            watch: Arc::default(),
        };
        if let Some(said_by_qemu) = said_by_qemu {
            let watch = Arc::clone(&emulator.watch);
            thread::spawn(move || watch.follow(said_by_qemu));
        }
        if let Some((gdb, models, clock_address)) = models {
            emulator.serve(Registers::new(gdb, models, clock_address)?)?;
        }
        let running = emulator.watch.wait(PATIENCE, |seen| seen.port.is_served()).map(drop);
        running.with_context(|| format!("no firmware for this board comes up from {}", elf.display()))?;
        // QEMU connected before the firmware ran, so there is nothing to wait for.
        emulator.gripper_line = Some(uart4.accept()?);
        emulator.modbus_line = Some(lpuart1.accept()?);
        emulator.service_line = Some(usart1.accept()?);
        Ok(emulator)
    }

    /// Serves registers to the machine from a thread of its own.
    fn serve(&self, registers: Registers) -> Result<()> {
        let (mut machine, watch) = (BesideGdb(Arc::clone(&self.qtest)), Arc::clone(&self.watch));
        let run = move || {
            if let Err(why) = registers.serve(&mut machine) {
                watch.fail(&format!("{why:#}"));
            }
        };
        thread::Builder::new()
            .name("registers".into())
            .spawn(run)
            .map(drop)
            .context("no thread for registers")
    }

    /// The gripper's end of the line: what the firmware sends comes out, what goes in it receives.
    /// `None` when it was taken before.
    ///
    /// As on a wire, nothing stops a firmware that nobody reads; other than on a wire, bytes wait
    /// for the receiver instead of overrunning it. Dropping the end cuts the line for good.
    pub fn take_gripper_line(&mut self) -> Option<UnixStream> {
        self.gripper_line.take()
    }

    /// The master's end of the bus, as [`take_gripper_line`](Self::take_gripper_line) is the gripper's end of its line.
    ///
    /// Bytes come through as fast as the firmware takes them, and pauses between them as long as the host makes them.
    pub fn take_modbus_line(&mut self) -> Option<UnixStream> {
        self.modbus_line.take()
    }

    /// The service port, where the USB cable's end is on the board; otherwise as
    /// [`take_modbus_line`](Self::take_modbus_line).
    pub fn take_service_line(&mut self) -> Option<UnixStream> {
        self.service_line.take()
    }

    /// Drives all input wires; those that change do so one after the other, in the order of their bits.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn set_inputs(&self, inputs: Inputs) -> Result<()> {
        self.drive(|_| inputs)
    }

    /// Drives one input wire, or several, and leaves the others as they are.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn set_input(&self, wires: Inputs, high: bool) -> Result<()> {
        self.drive(|driven| if high { driven | wires } else { driven - wires })
    }

    fn drive(&self, wanted: impl FnOnce(Inputs) -> Inputs) -> Result<()> {
        let mut driven = lock(&self.inputs);
        let wanted = wanted(*driven);
        let changing = *driven ^ wanted;
        for wire in INPUTS.iter().filter(|wire| changing.contains(wire.signal)) {
            let port = format!("/machine/soc/gpio{}", wire.port.letter().to_ascii_lowercase());
            let high = wanted.contains(wire.signal);
            self.ask(|qtest| qtest.set_gpio_in(&port, wire.pin, high))?;
            driven.set(wire.signal, high);
        }
        Ok(())
    }

    /// The input wires as they are driven now.
    #[must_use]
    pub fn inputs(&self) -> Inputs {
        *lock(&self.inputs)
    }

    /// The output wires as they are now.
    #[must_use]
    pub fn outputs(&self) -> Outputs {
        lock(&self.watch.seen).port.outputs()
    }

    /// Every change of the output wires since power-up, past ones first. Ends when QEMU does.
    ///
    /// Each caller gets all of them.
    #[must_use]
    pub fn output_changes(&self) -> Receiver<OutputChange> {
        self.watch.subscribe()
    }

    /// Waits until the output wires are as `wanted`; at once when they are now. Returns them.
    ///
    /// A state that is over before it is looked at is not seen; for sequences there is
    /// [`output_changes`](Self::output_changes).
    ///
    /// # Errors
    /// When `timeout` passes first, or QEMU ends.
    pub fn wait_outputs(&self, timeout: Duration, wanted: impl Fn(Outputs) -> bool) -> Result<Outputs> {
        let seen = self.watch.wait(timeout, |seen| wanted(seen.port.outputs()));
        seen.map(|seen| seen.port.outputs()).with_context(|| {
            let names: Vec<&str> = self.outputs().iter_names().map(|(name, _)| name).collect();
            format!("the outputs are not as wanted; high are [{}]", names.join(", "))
        })
    }

    /// Reads the 32-bit word at `address` in the board's memory, registers included.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn readl(&self, address: u32) -> Result<u32> {
        self.ask(|qtest| qtest.readl(address))
    }

    /// Reads `len` bytes of the board's memory from `address` on.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn read_memory(&self, address: u32, len: usize) -> Result<Vec<u8>> {
        self.ask(|qtest| qtest.read(address, len))
    }

    /// The firmware's clock: milliseconds since its main loop began.
    ///
    /// A wait for this to advance is one in the board's time, however slow the host is.
    ///
    /// # Errors
    /// When the image has no symbols, or QEMU has ended.
    pub fn now_ms(&self) -> Result<u32> {
        self.readl(self.clock_address.with_context(|| format!("the image has no symbol {CLOCK_SYMBOL}"))?)
    }

    fn ask<T>(&self, question: impl FnOnce(&mut Qtest) -> Result<T>) -> Result<T> {
        // A machine that stands for good would answer for ever.
        {
            let seen = lock(&self.watch.seen);
            ensure!(!seen.has_ended, "{}", seen.last_words());
        }
        question(&mut lock(&self.qtest)).with_context(|| lock(&self.watch.seen).last_words())
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // Before QEMU: until that is waited for, its number is nobody else's.
        end(&mut self.leash);
        end(&mut self.qemu);
    }
}

/// The machine through qtest.
struct BesideGdb(Arc<Mutex<Qtest>>);

impl Machine for BesideGdb {
    fn set_interrupt(&mut self, line: u8, level: bool) -> Result<()> {
        lock(&self.0).set_gpio_in(CORE, line, level)
    }

    fn raise_nmi(&mut self) -> Result<()> {
        let mut qtest = lock(&self.0);
        // The core keeps it pending.
        [true, false].into_iter().try_for_each(|level| qtest.set_irq_in(CORE, "NMI", 0, level))
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        lock(&self.0).readl(address)
    }

    fn store(&mut self, address: u32, value: u32) -> Result<()> {
        lock(&self.0).writel(address, value)
    }
}

/// Starts a process that waits until this one has ended, however it ends, and ends QEMU then.
///
/// What the kernel has for that (`PR_SET_PDEATHSIG`) takes `unsafe`, and looks at the thread that started QEMU.
fn put_on_leash(qemu: &Child) -> io::Result<Child> {
    // Its input ends with this process, and only then: nothing is ever written. A Ctrl-C is for QEMU.
    const WAIT_AND_KILL: &str = "trap '' HUP INT QUIT TERM; read -r _; kill -KILL \"$0\"";
    Command::new("sh")
        .args(["-c", WAIT_AND_KILL, &qemu.id().to_string()])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
}

fn end(process: &mut Child) {
    // An error means that it has ended already, which is what is wanted.
    let _ = process.kill();
    let _ = process.wait();
}

/// A socket in a directory of its own that QEMU connects to; both are gone when this is dropped.
struct SocketAddress {
    directory: PathBuf,
    name: &'static str,
    listener: UnixListener,
}

impl SocketAddress {
    fn bind(name: &'static str) -> Result<Self> {
        static EMULATORS: AtomicU32 = AtomicU32::new(0);
        let number = EMULATORS.fetch_add(1, Ordering::Relaxed);
        let directory = std::env::temp_dir().join(format!("wsg-emulator-{}-{number}", process::id()));
        let bind = || {
            // A process of this number may have died before it tidied up.
            let _ = fs::remove_dir_all(&directory);
            fs::create_dir(&directory)?;
            let listener = UnixListener::bind(directory.join(name))?;
            listener.set_nonblocking(true)?;
            Ok::<_, io::Error>(listener)
        };
        let listener = bind().with_context(|| format!("cannot make a socket in {}", directory.display()))?;
        Ok(Self { directory, name, listener })
    }

    fn path(&self) -> PathBuf {
        self.directory.join(self.name)
    }

    /// The connection that QEMU has made.
    fn accept(&self) -> Result<UnixStream> {
        let (connection, _) =
            self.listener.accept().with_context(|| format!("QEMU has not connected its {}", self.name))?;
        connection.set_nonblocking(false)?;
        Ok(connection)
    }
}

impl Drop for SocketAddress {
    fn drop(&mut self) {
        // What stays behind in a directory for temporary files harms nobody.
        let _ = fs::remove_dir_all(&self.directory);
    }
}

/// What can be seen of the board from outside, kept up to date by a thread.
#[derive(Debug, Default)]
struct Watch {
    seen: Mutex<Seen>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Seen {
    port: OutputPort,
    changes: Vec<OutputChange>,
    subscribers: Vec<Sender<OutputChange>>,
    /// The first lines QEMU said besides its trace: why it does not start, most of all.
    said: Vec<String>,
    has_ended: bool,
}

impl Watch {
    /// Follows QEMU's trace until QEMU ends.
    fn follow(&self, said_by_qemu: ChildStderr) {
        let mut said_by_qemu = BufReader::new(said_by_qemu);
        let mut line = Vec::new();
        while matches!(said_by_qemu.read_until(b'\n', &mut line), Ok(read) if read > 0) {
            lock(&self.seen).take_in(&String::from_utf8_lossy(&line));
            self.changed.notify_all();
            line.clear();
        }
        let mut seen = lock(&self.seen);
        seen.has_ended = true;
        seen.subscribers.clear();
        self.changed.notify_all();
    }

    /// The machine stands for good, and this is why.
    fn fail(&self, why: &str) {
        let mut seen = lock(&self.seen);
        // Not if QEMU was ended.
        if !seen.has_ended {
            seen.said.push(why.to_owned());
            seen.has_ended = true;
            seen.subscribers.clear();
        }
        self.changed.notify_all();
    }

    fn subscribe(&self) -> Receiver<OutputChange> {
        let (sender, receiver) = mpsc::channel();
        let mut seen = lock(&self.seen);
        for &change in &seen.changes {
            // The receiver is still here, so nothing is refused.
            let _ = sender.send(change);
        }
        if !seen.has_ended {
            seen.subscribers.push(sender);
        }
        receiver
    }

    fn wait(&self, timeout: Duration, wanted: impl Fn(&Seen) -> bool) -> Result<MutexGuard<'_, Seen>> {
        let (seen, _) = self
            .changed
            .wait_timeout_while(lock(&self.seen), timeout, |seen| !seen.has_ended && !wanted(seen))
            .unwrap_or_else(PoisonError::into_inner);
        if wanted(&seen) {
            Ok(seen)
        } else if seen.has_ended {
            bail!("{}", seen.last_words())
        } else {
            bail!("waited {timeout:?}; {}", seen.last_words())
        }
    }
}

impl Seen {
    fn take_in(&mut self, line: &str) {
        let before = self.port.outputs();
        if !self.port.follow(line) {
            // A CPU that locks up is followed by a dump of all registers; the reason is in front.
            if self.said.len() < SAID_MAX && !line.trim().is_empty() {
                self.said.push(line.trim().to_owned());
            }
            return;
        }
        let outputs = self.port.outputs();
        if outputs != before {
            let change = OutputChange { at: Instant::now(), outputs };
            self.changes.push(change);
            self.subscribers.retain(|subscriber| subscriber.send(change).is_ok());
        }
    }

    fn last_words(&self) -> String {
        let state = if self.has_ended { "has ended" } else { "is running" };
        match self.said.as_slice() {
            [] if self.has_ended => format!("{QEMU} {state} without a word: the firmware has reset itself"),
            [] => format!("{QEMU} {state}"),
            said => format!("{QEMU} {state}, and said: {}", said.join("; ")),
        }
    }
}

/// The address of the symbol whose name contains `name`.
fn symbol(elf: &Path, name: &str) -> Option<u32> {
    let image = fs::read(elf).ok()?;
    let image = object::File::parse(&*image).ok()?;
    let symbol = image.symbols().find(|symbol| symbol.name().is_ok_and(|found| found.contains(name)))?;
    u32::try_from(symbol.address()).ok()
}

/// A lock that a panicking test held guards nothing that would be left half done.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
