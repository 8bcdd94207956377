//! The bridge of a gateway, its clock, and the connections that command it.
//!
//! A pause of the computer is a lost bus and a lost line: the requests that waited meanwhile are too old, so their connections
//! end, and none of their images reaches the gripper.

use std::cell::RefCell;
use std::fmt::Display;
use std::future::poll_fn;
use std::path::Path;
use std::rc::Rc;
use std::sync::OnceLock;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus_modbus::MAX_PDU_LEN;
use fieldbus_host::Activity;
use tokio::net::TcpStream;
use tokio::task::yield_now;
use tokio::time::{sleep, timeout};
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, NoCan};
use wsg_bridge_fw::plc::{ModbusTcp, TcpInput};
use wsg_bridge_fw::{BoardId, Bridge, Config, ResetCause, Station};
use wsg_fieldbus::{InputImage, SilenceReaction};
use wsg_protocol::{Status, SystemFlags};

use super::line::GripperLine;
use crate::file_flash::FileFlash;
use crate::print_error;

/// Longest time between two turns without input.
const TURN: Duration = Duration::from_millis(5);

/// Longest time without a regular turn after which waiting input still counts. A request must never take effect a second late.
const LONGEST_PAUSE: Duration = Duration::from_millis(800);

/// Time between two turns without input in which no request waits for long: such turns are regular. Several shorter pauses in a row
/// are one.
const REGULAR: Duration = Duration::from_millis(100);

/// Time after a pause in which connections are rejected: they may have been accepted, and their requests received, during it.
const REJECTION: Duration = Duration::from_millis(100);

/// Maximum number of masters at a time. A further one displaces the one that has been idle longest.
const MAX_MASTERS: usize = 32;

/// Time-out of an attempt to connect to the gripper.
const CONNECT_TIME: Duration = Duration::from_secs(3);

/// Time in which the bridge takes the constant level of FAST_STOP_OK for settled. Before, it ignores edges of a bus.
/// The stored debounce time is added.
const SETTLING: Duration = Duration::from_millis(20);

/// Longest time for a new connection to be answered. A connection that was cut meanwhile would hold a FAST STOP until the system
/// repeats what it has sent, which takes up to two minutes.
const SETUP_TIME: Duration = Duration::from_secs(3);

/// Maximum number of messages that wait to be printed.
const MAX_MESSAGES: usize = 64;

/// Pause between two attempts.
const RETRY: Duration = Duration::from_millis(250);

/// Time for the gripper to confirm a Stop at the end.
const STOP_TIME: Duration = Duration::from_millis(500);

/// Time for the gripper to confirm the announced end of the connection.
const FAREWELL_TIME: Duration = Duration::from_millis(200);

/// A gateway.
pub(super) struct Gateway {
    host: RefCell<Host>,
    masters: RefCell<Masters>,
    settling: Duration,
}

/// A bridge on this computer.
struct Host {
    station: Station<NoCan>,
    modbus: ModbusTcp,
    flash: FileFlash,
    line: GripperLine,
    /// Times of the computer's clock: of the start, of the last turn without input, and of the last regular one.
    start: Duration,
    passed_at: Duration,
    regular_at: Duration,
    /// When the line was last closed, or the gripper connected.
    answered_at: Duration,
    /// The end of the connection was announced.
    is_ending: bool,
}

struct Masters {
    open: Vec<Rc<Activity>>,
    /// Number of the next connection.
    next: u64,
    /// Number of the first connection that is served. Requests of earlier ones may be too old.
    first_served: u64,
    /// End of the last pause.
    paused_at: Option<Instant>,
    pauses: u32,
}

impl Gateway {
    /// Starts a bridge with the settings in a file.
    pub(super) fn open(settings: Option<&Path>) -> Result<Self> {
        let flash = FileFlash::open(settings)?;
        let mut station = Station::without_profibus(CanBus::new(NoCan, BusOffPolicy::DEFAULT));
        let config =
            station.load(&Config::DEFAULT.record(), &flash).context("the default settings are invalid")?;
        station.start(&config, BoardId { name: "wsg gateway", serial: 0 }, ResetCause::PowerOn);
        let now = uptime();
        let host = Host {
            station,
            modbus: ModbusTcp::new(),
            flash,
            line: GripperLine::default(),
            start: now,
            passed_at: now,
            regular_at: now,
            answered_at: now,
            is_ending: false,
        };
        let masters = Masters { open: Vec::new(), next: 0, first_served: 0, paused_at: None, pauses: 0 };
        let settling = SETTLING + Duration::from_millis(config.wires.debounce_ms.into());
        Ok(Self { host: RefCell::new(host), masters: RefCell::new(masters), settling })
    }

    /// Runs turns until the bridge takes commands. No board connects to a gripper or a master that soon after its start.
    pub(super) async fn settle(&self) {
        self.reaches(self.settling, |_| false).await;
    }

    /// Connects to the gripper whenever the line is not open.
    pub(super) async fn keep_connected(&self, address: &str) {
        let mut reported = String::new();
        loop {
            if !self.host.borrow().line.is_open() {
                let stream = match timeout(CONNECT_TIME, TcpStream::connect(address)).await {
                    Ok(stream) => stream.map_err(|error| error.to_string()),
                    Err(_) => Err(format!("no answer within {} s", CONNECT_TIME.as_secs())),
                };
                let opened = stream.and_then(|stream| {
                    self.host.borrow_mut().line.open(stream).map_err(|error| error.to_string())
                });
                let problem = opened.err().unwrap_or_default();
                if problem.is_empty() {
                    report(format_args!("connected to the gripper at {address}"));
                } else if problem != reported {
                    report(format_args!("cannot connect to the gripper at {address}: {problem}; retrying"));
                }
                reported = problem;
            }
            sleep(RETRY).await;
        }
    }

    /// Runs a turn, and waits until the next one is due.
    pub(super) async fn pass_time(&self) {
        self.turn(TcpInput::Nothing);
        // Bytes that arrive without end must not starve the masters.
        yield_now().await;
        tokio::select! {
            () = sleep(TURN) => {}
            () = poll_fn(|context| self.host.borrow().line.poll_arrival(context)) => {}
        }
    }

    /// Admits a connection. Returns its number and activity, or `None` shortly after a pause.
    pub(super) fn admit(&self) -> Option<(u64, Rc<Activity>)> {
        let mut masters = self.masters.borrow_mut();
        if masters.paused_at.is_some_and(|paused_at| paused_at.elapsed() < REJECTION) {
            return None;
        }
        if masters.open.len() >= MAX_MASTERS {
            let open = masters.open.iter().enumerate();
            let (at, _) = open.min_by_key(|(_, activity)| activity.received_at())?;
            masters.open.swap_remove(at).displace();
        }
        let (number, activity) = (masters.number(), Rc::<Activity>::default());
        masters.open.push(Rc::clone(&activity));
        Some((number, activity))
    }

    /// Answers a request of a connection in a turn of the bridge. Returns the length of the response; 0 if the connection is no
    /// longer served.
    pub(super) fn serve(&self, master: u64, pdu: &[u8], response: &mut [u8; MAX_PDU_LEN]) -> usize {
        let mut len = 0;
        if master >= self.masters.borrow().first_served {
            self.turn(TcpInput::Request { master, pdu, response, len: &mut len });
        }
        len
    }

    /// Returns the number of a master of a cyclic bus.
    pub(super) fn number(&self) -> u64 {
        self.masters.borrow_mut().number()
    }

    /// Returns the number of pauses since the start.
    pub(super) fn pauses(&self) -> u32 {
        self.masters.borrow().pauses
    }

    /// Returns the input image for a cyclic bus. `None` while the gripper is not connected, and after a pause.
    pub(super) fn inputs(&self) -> Option<InputImage> {
        let mut host = self.host.borrow_mut();
        let is_current = uptime().saturating_sub(host.passed_at) <= LONGEST_PAUSE;
        let is_shown = is_current && host.station.bridge().is_connected();
        host.modbus.inputs().filter(|_| is_shown)
    }

    /// Ends a connection. A jog of its master ends at once, because its button cannot be released any more; other motions end
    /// after BUS_TIMEOUT, unless the master connects again and writes.
    pub(super) fn disconnect(&self, master: u64, activity: &Rc<Activity>) {
        self.masters.borrow_mut().open.retain(|open| !Rc::ptr_eq(open, activity));
        let mut host = self.host.borrow_mut();
        if host.modbus.is_plc(master) {
            host.station.bridge().silence(SilenceReaction::Hold);
        }
    }

    /// Ends the gateway: stops the fingers, and announces the end of the connection, so that the gripper does not enter FAST STOP.
    /// Fingers that do not stop in time, and a FAST STOP, end without the announcement: then the gripper enters FAST STOP.
    pub(super) async fn end(&self) {
        self.masters.borrow_mut().dismiss();
        self.host.borrow_mut().station.bridge().silence(SilenceReaction::Stop);
        let is_announced = self.reaches(STOP_TIME, is_at_rest).await && self.announce_end();
        if is_announced {
            self.reaches(FAREWELL_TIME, |bridge| !bridge.session().is_busy()).await;
            self.host.borrow_mut().line.finish();
        }
    }

    fn announce_end(&self) -> bool {
        let mut host = self.host.borrow_mut();
        let bridge = host.station.bridge();
        let is_stopped = bridge.input_image().system.contains(SystemFlags::FAST_STOP);
        let is_announced = !is_stopped && bridge.announce_end();
        host.is_ending = is_announced;
        is_announced
    }

    /// Runs turns until `is_reached` holds, for at most this time. Returns whether it holds.
    async fn reaches(&self, at_most: Duration, is_reached: impl Fn(&Bridge) -> bool) -> bool {
        let start = Instant::now();
        while start.elapsed() < at_most {
            self.pass_time().await;
            let mut host = self.host.borrow_mut();
            let bridge: &Bridge = host.station.bridge();
            if is_reached(bridge) {
                return true;
            }
        }
        false
    }

    /// Runs a turn of the bridge. After a pause, `input` is not served, and no connection continues.
    pub(super) fn turn(&self, input: TcpInput<'_>) {
        let pause = self.host.borrow_mut().turn(input);
        if let Some(pause) = pause {
            let mut masters = self.masters.borrow_mut();
            masters.dismiss();
            masters.paused_at = Some(Instant::now());
            masters.pauses += 1;
            report(format_args!(
                "this computer paused for {} ms (pause {} since the start): disconnected from gripper and PLC, and discarded waiting \
                 requests",
                pause.as_millis(),
                masters.pauses
            ));
        }
    }
}

impl Masters {
    /// Returns the number of the next connection.
    const fn number(&mut self) -> u64 {
        self.next += 1;
        self.next - 1
    }

    /// Closes all connections. None of their requests is served from here on.
    fn dismiss(&mut self) {
        self.first_served = self.next;
        for activity in self.open.drain(..) {
            activity.displace();
        }
    }
}

impl Host {
    /// Runs a turn. Returns the time since the last regular one if it is a pause.
    fn turn(&mut self, input: TcpInput<'_>) -> Option<Duration> {
        let now = uptime();
        if matches!(input, TcpInput::Nothing) {
            if now.saturating_sub(self.passed_at) < REGULAR {
                self.regular_at = now;
            }
            self.passed_at = now;
        }
        let since = now.saturating_sub(self.regular_at);
        let pause = Some(since).filter(|since| *since > LONGEST_PAUSE);
        if pause.is_some() {
            self.regular_at = now;
        }
        let input = if pause.is_some() { TcpInput::Paused } else { input };
        if pause.is_some() || !self.line.receive() {
            self.lose_line();
        } else {
            self.station.bridge().set_link_lost(false);
        }
        let was_connected = self.station.bridge().is_connected();
        let now_ms = now.saturating_sub(self.start).as_millis() as u32;
        let Self { station, line, modbus, flash, .. } = self;
        station.turn_of_gateway(now_ms, line, &mut modbus.over(input), flash);
        // The commands that a silent gripper has not answered may still wait in the socket.
        let is_silent = was_connected && !self.station.bridge().is_connected() && !self.is_ending;
        if !self.line.is_open() || self.station.bridge().is_connected() {
            self.answered_at = now;
        }
        let is_mute = now.saturating_sub(self.answered_at) > SETUP_TIME;
        // A turn that was interrupted, for example while the settings were written, must not send its command.
        let is_late = pause.is_none() && since + uptime().saturating_sub(now) > LONGEST_PAUSE;
        if is_silent || is_mute || is_late || !self.line.send() {
            self.lose_line();
        }
        pause
    }

    /// Resets the connection to the gripper, if there is one. The bridge forgets its pending commands.
    fn lose_line(&mut self) {
        let was_open = self.line.is_open();
        self.line.reset();
        self.station.bridge().set_link_lost(true);
        if was_open && !self.is_ending {
            report("lost the connection to the gripper");
        }
    }
}

/// Returns the time since the computer's start. It includes the time for which the computer was suspended: a request from before must
/// be found too old after it.
#[cfg(target_os = "linux")]
fn uptime() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

/// Returns the time since the first call. On Windows, it includes the time for which the computer was suspended.
#[cfg(not(target_os = "linux"))]
fn uptime() -> Duration {
    static FIRST: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    FIRST.elapsed()
}

/// Prints a message on standard error, in a thread: a reader that does not read must not hold the bridge, nor end a task. A message
/// that finds no room is lost.
pub(super) fn report(what: impl Display) {
    static MESSAGES: OnceLock<SyncSender<String>> = OnceLock::new();
    let messages = MESSAGES.get_or_init(|| {
        let (sender, messages) = sync_channel::<String>(MAX_MESSAGES);
        thread::spawn(move || messages.iter().for_each(print_error));
        sender
    });
    let _ = messages.try_send(what.to_string());
}

/// Returns whether no motion runs and none is to be stopped.
fn is_at_rest(bridge: &Bridge) -> bool {
    let image = bridge.input_image();
    image.status != Status::CmdPending
        && !image.system.contains(SystemFlags::MOVING)
        && !bridge.motion_is_open()
}
