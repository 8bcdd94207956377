//! The bridge of a gateway, its clock, and the connections that command it.
//!
//! A pause of the computer is a lost bus and a lost line: the requests that waited meanwhile are too old, so their connections
//! end, and none of their images reaches the gripper.

use std::cell::RefCell;
use std::fmt::Display;
use std::future::poll_fn;
use std::io;
use std::mem;
use std::net::{IpAddr, Ipv4Addr};
use std::rc::Rc;
use std::sync::OnceLock;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bus_modbus::MAX_PDU_LEN;
use fieldbus_host::Activity;
use tokio::task::yield_now;
use tokio::time::sleep;
use wsg_bridge_fw::can::{BusOffPolicy, CanBus, NoCan};
use wsg_bridge_fw::plc::{ModbusTcp, TcpInput};
use wsg_bridge_fw::registers::{FIRST_REPORT, FIRST_SETTING, REPORTS, Record, SETTINGS};
use wsg_bridge_fw::{BoardId, Bridge, Config, ResetCause, Station};
use wsg_fieldbus::{InputImage, SilenceReaction};
use wsg_protocol::{Status, SystemFlags};

use super::config::GripperConfig;
use super::line::{GripperLine, Stream};
use crate::bridge::State;
use crate::bridge::gateway_reports::{self, Measured};
use crate::file_flash::FileFlash;
use crate::gripper::Address;
use crate::{Severity, print_message};

/// Longest time between two turns without input.
pub(super) const TURN: Duration = Duration::from_millis(5);

/// Longest time without a regular turn after which waiting input still counts. A request must never take effect a second late.
const LONGEST_PAUSE: Duration = Duration::from_millis(800);

/// Age of the gripper's last answer from which its values are not shown, and its line is lost. The session counts attempts
/// instead: without a pause, it finds a silent gripper in less time.
const SILENCE_TIME: Duration = Duration::from_secs(1);

/// Time between two turns without input in which no request waits for long: such turns are regular. Several shorter pauses in a row
/// are one.
const REGULAR: Duration = Duration::from_millis(100);

/// Time after a pause in which connections are rejected: they may have been accepted, and their requests received, during it.
const REJECTION: Duration = Duration::from_millis(100);

/// Maximum number of masters of a port at a time. A further one displaces the one that has been idle longest.
const MAX_MASTERS: usize = 32;

/// Time in which the bridge takes the constant level of FAST_STOP_OK for settled. Before, it ignores edges of a bus.
/// The stored debounce time is added.
const SETTLING: Duration = Duration::from_millis(20);

/// Longest time for a new line to be answered. A connection that was cut meanwhile would hold a FAST STOP until the system repeats
/// what it has sent, which takes up to two minutes. An SLCAN adapter may have restarted with a closed channel.
const SETUP_TIME: Duration = Duration::from_secs(3);

/// Maximum number of messages that wait to be printed.
const MAX_MESSAGES: usize = 64;

/// Number of a reader of registers without a connection. It is never the PLC: a tool must not hide the PLC's silence.
pub(super) const READER: u64 = u64::MAX;

/// Problem of a line after a pause of the computer.
const PAUSED: &str = "this computer paused";
/// Problem of a line to a silent gripper.
const SILENT: &str = "the gripper does not answer";

/// Pause between two attempts.
const RETRY: Duration = Duration::from_millis(250);

/// Time for the gripper to confirm a Stop or FAST STOP at the end.
const STOP_TIME: Duration = Duration::from_millis(500);

/// Time for the gripper to confirm the announced end of the connection.
const FAREWELL_TIME: Duration = Duration::from_millis(200);

/// A gateway.
pub(super) struct Gateway {
    host: RefCell<Host>,
    masters: Rc<RefCell<Masters>>,
    settling: Duration,
}

/// A bridge on this computer.
struct Host {
    /// Begins each message.
    label: String,
    station: Station<NoCan>,
    modbus: ModbusTcp,
    flash: FileFlash,
    line: GripperLine,
    /// Address of the gripper, and the last message about the line to it.
    address: String,
    reported: String,
    /// Times of the computer's clock: of the start, of the last turn without input, and of the last regular one.
    start: Duration,
    passed_at: Duration,
    regular_at: Duration,
    /// The last turn.
    received_at: Duration,
    /// When the line was last closed, or the gripper answered, at the latest.
    answered_at: Duration,
    /// End of the last turn without input after which a board feeds its watchdog.
    alive_at: Instant,
    /// The end of the connection was announced.
    is_ending: bool,
    /// Values for the reports.
    measured: Measured,
}

/// The masters of a port.
#[derive(Default)]
pub(super) struct Masters {
    open: Vec<Rc<Activity>>,
    /// Number of the next master.
    next: u64,
    /// Connections of Modbus/TCP since the start.
    connections: u32,
    /// Number of the first connection that is served. Requests of earlier ones may be too old.
    first_served: u64,
    /// End of the last pause.
    paused_at: Option<Instant>,
}

impl Gateway {
    /// Starts a bridge with the stored or delivered settings.
    pub(super) fn open(gripper: &GripperConfig, masters: &Rc<RefCell<Masters>>) -> Result<Self> {
        let flash = FileFlash::open(gripper.settings.as_deref())?;
        let mut station = Station::without_profibus(CanBus::new(NoCan, BusOffPolicy::DEFAULT));
        let delivered = gripper.delivered.unwrap_or(Config::DEFAULT.record());
        let config = station.load(&delivered, &flash).context("the delivered settings are invalid")?;
        if let (Some(delivered), Some(file)) = (gripper.delivered, &gripper.settings)
            && config.record() != delivered
        {
            report(format_args!(
                "{}{} was saved by a master and takes precedence; DEFAULTS returns to the configuration",
                gripper.label,
                file.display()
            ));
        }
        station.start(&config, BoardId { name: "wsg gateway", serial: 0 }, ResetCause::PowerOn);
        let now = uptime();
        let host = Host {
            label: gripper.label.clone(),
            station,
            modbus: ModbusTcp::new(),
            flash,
            line: GripperLine::default(),
            address: gripper.gripper.to_string(),
            reported: String::new(),
            start: now,
            passed_at: now,
            regular_at: now,
            received_at: now,
            answered_at: now,
            alive_at: Instant::now(),
            is_ending: false,
            measured: Measured::default(),
        };
        let settling = SETTLING + Duration::from_millis(config.wires.debounce_ms.into());
        Ok(Self { host: RefCell::new(host), masters: Rc::clone(masters), settling })
    }

    /// Returns the time until the bridge takes commands. No board connects to a gripper or a master that soon after its start.
    pub(super) const fn settling(&self) -> Duration {
        self.settling
    }

    /// Runs turns for this time.
    pub(super) async fn settle(&self, time: Duration) {
        self.reaches(time, |_| false).await;
    }

    /// Opens the line to the gripper whenever it is not open.
    pub(super) async fn keep_connected(&self, address: &Address) {
        if !matches!(address, Address::Tcp(_)) {
            self.host.borrow().report(format_args!(
                "the gripper at {address} does not notice the end of this line: if the gateway fails, a motion or jog runs to its end"
            ));
        }
        loop {
            let is_open = self.host.borrow().line.is_open();
            if !is_open {
                let opened = Stream::open(address).await;
                let mut host = self.host.borrow_mut();
                match opened {
                    Ok(stream) => host.line.open(stream),
                    Err(error) => host.report_problem(&error),
                }
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

    /// Returns the end of the last regular turn after which a board feeds its watchdog.
    pub(super) fn alive_at(&self) -> Instant {
        self.host.borrow().alive_at
    }

    /// Answers a request of a connection in a turn of the bridge. Returns the length of the response; 0 if the connection is no
    /// longer served.
    pub(super) fn serve(
        &self,
        (master, address): (u64, IpAddr),
        pdu: &[u8],
        response: &mut [u8; MAX_PDU_LEN],
    ) -> usize {
        let (mut len, mut is_write) = (0, false);
        if master < self.masters.borrow().first_served {
            return len;
        }
        let place = &mut *response;
        self.turn(TcpInput::Request { master, pdu, response: place, len: &mut len, is_write: &mut is_write });
        if is_write {
            self.note_cycle(address);
        }
        let (masters, measured) = (self.masters.borrow(), &mut self.host.borrow_mut().measured);
        (measured.masters, measured.master_connections) = (masters.open.len(), masters.connections);
        measured.answer(pdu, response).unwrap_or(len)
    }

    /// Reads what [`read_gateway`](crate::bridge::read_gateway) reads, as one more master that never writes, but without a
    /// connection, which would be counted. Returns `None` after a pause.
    pub(super) fn read(&self) -> Option<(State, Vec<u16>)> {
        // The first request for the image subscribes to width and force.
        let image = self.read_registers(4, 0, (InputImage::LEN / 2) as u16);
        let image: Option<Vec<u8>> = image.map(|it| it.into_iter().flat_map(u16::to_be_bytes).collect());
        let settings = self.read_registers(3, FIRST_SETTING, SETTINGS.len() as u16)?;
        let reports = self.read_registers(4, FIRST_REPORT, REPORTS.len() as u16)?;
        let own = self.read_registers(4, gateway_reports::FIRST, gateway_reports::LEN)?;
        let image = image.and_then(|bytes| bytes.try_into().ok()).map(InputImage::from_bytes);
        Some((State { settings: Record::try_from(settings).ok()?, reports, image }, own))
    }

    /// Reads holding (3) or input (4) registers. Returns `None` after an exception, and after a pause.
    fn read_registers(&self, function: u8, first: u16, count: u16) -> Option<Vec<u16>> {
        let ([a1, a0], [q1, q0]) = (first.to_be_bytes(), count.to_be_bytes());
        let mut response = [0; MAX_PDU_LEN];
        let reader = (READER, Ipv4Addr::UNSPECIFIED.into());
        let len = self.serve(reader, &[function, a1, a0, q1, q0], &mut response);
        let [code, _, bytes @ ..] = response.get(..len)? else { return None };
        (*code == function)
            .then(|| bytes.as_chunks().0.iter().map(|word| u16::from_be_bytes(*word)).collect())
    }

    /// Returns whether this master wrote last.
    pub(super) fn is_writer(&self, master: u64) -> bool {
        self.host.borrow().modbus.writer() == Some(master)
    }

    /// Records that the PLC at this address has written an output image. A PROFINET controller has the address 0.0.0.0.
    pub(super) fn note_cycle(&self, address: IpAddr) {
        self.host.borrow_mut().measured.note_cycle(address, uptime());
    }

    /// Returns the number of a master of a cyclic bus.
    pub(super) fn number(&self) -> u64 {
        self.masters.borrow_mut().number()
    }

    /// Returns the number of pauses since the start.
    pub(super) fn pauses(&self) -> u32 {
        self.host.borrow().measured.pauses
    }

    /// Returns the input image for a cyclic bus. `None` while the gripper is not connected or silent, and after a pause.
    pub(super) fn inputs(&self) -> Option<InputImage> {
        let mut host = self.host.borrow_mut();
        let now = uptime();
        let is_current = now.saturating_sub(host.passed_at) <= LONGEST_PAUSE
            && now.saturating_sub(host.answered_at) <= SILENCE_TIME;
        let is_shown = is_current && host.station.bridge().is_connected();
        host.modbus.inputs().filter(|_| is_shown)
    }

    /// Ends a jog of a master whose connection has ended, because its button cannot be released any more. Other motions end after
    /// BUS_TIMEOUT, unless the master connects again and writes.
    pub(super) fn end_jog(&self, master: u64) {
        let mut host = self.host.borrow_mut();
        if host.modbus.end_jog(master) {
            host.station.bridge().silence(SilenceReaction::Hold);
        }
    }

    /// Ends the gateway: stops the fingers, and announces the end of a connection, so that the gripper does not enter FAST STOP.
    /// Fingers that do not stop in time, and a FAST STOP, end without the announcement: then the gripper enters FAST STOP. A gripper
    /// that does not notice the end of its line is sent the FAST STOP.
    pub(super) async fn end(&self) {
        self.masters.borrow_mut().dismiss();
        self.silence(SilenceReaction::Stop);
        let is_at_rest = self.reaches(STOP_TIME, is_at_rest).await;
        if !is_at_rest {
            self.host.borrow().report(format_args!(
                "the gripper did not confirm within {} ms that its fingers stopped: FAST STOP",
                STOP_TIME.as_millis()
            ));
        }
        let is_connection = self.host.borrow().line.is_connection();
        if is_connection {
            if is_at_rest && self.announce_end() {
                self.reaches(FAREWELL_TIME, |bridge| !bridge.session().is_busy()).await;
                self.host.borrow_mut().line.finish();
            }
            return;
        }
        if !is_at_rest {
            self.silence(SilenceReaction::FastStop);
            self.reaches(STOP_TIME, is_fast_stopped).await;
        }
        self.host.borrow_mut().line.finish();
    }

    fn silence(&self, reaction: SilenceReaction) {
        self.host.borrow_mut().station.bridge().silence(reaction);
    }

    fn announce_end(&self) -> bool {
        let mut host = self.host.borrow_mut();
        let bridge = host.station.bridge();
        let is_announced = !is_fast_stopped(bridge) && bridge.announce_end();
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
            let host = self.host.borrow();
            host.report(format_args!(
                "this computer paused for {} ms (pause {} since the start): disconnected from gripper and PLC, and discarded waiting \
                 requests",
                pause.as_millis(),
                host.measured.pauses
            ));
        }
    }
}

impl Masters {
    /// Admits a connection. Returns its number and activity, or `None` shortly after a pause.
    pub(super) fn admit(&mut self) -> Option<(u64, Rc<Activity>)> {
        if self.paused_at.is_some_and(|paused_at| paused_at.elapsed() < REJECTION) {
            return None;
        }
        if self.open.len() >= MAX_MASTERS {
            let open = self.open.iter().enumerate();
            let (at, _) = open.min_by_key(|(_, activity)| activity.received_at())?;
            self.open.swap_remove(at).displace();
        }
        let (number, activity) = (self.number(), Rc::<Activity>::default());
        self.connections = self.connections.saturating_add(1);
        self.open.push(Rc::clone(&activity));
        Some((number, activity))
    }

    /// Removes a connection that has ended.
    pub(super) fn remove(&mut self, activity: &Rc<Activity>) {
        self.open.retain(|open| !Rc::ptr_eq(open, activity));
    }

    /// Returns the number of the next master.
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
        self.measured.longest_pause = self.measured.longest_pause.max(now.saturating_sub(self.regular_at));
        let is_regular = matches!(input, TcpInput::Nothing);
        if is_regular {
            if now.saturating_sub(self.passed_at) < REGULAR {
                self.regular_at = now;
            }
            self.passed_at = now;
        }
        let since = now.saturating_sub(self.regular_at);
        let pause = Some(since).filter(|since| *since > LONGEST_PAUSE);
        if pause.is_some() {
            self.regular_at = now;
            self.measured.pauses += 1;
        }
        let input = if pause.is_some() { TcpInput::Paused } else { input };
        let received = match pause {
            Some(_) => Err(io::Error::other(PAUSED)),
            None => self.receive(now),
        };
        match received {
            // A line without a connection is known to be down only while it is closed, as on a board.
            Ok(()) => self.station.bridge().set_link_lost(false),
            Err(error) => self.lose_line(&error),
        }
        let was_connected = self.station.bridge().is_connected();
        let now_ms = now.saturating_sub(self.start).as_millis() as u32;
        let Self { station, line, modbus, flash, measured, .. } = self;
        let had_plc = modbus.writer().is_some();
        station.turn_of_gateway(now_ms, line, &mut modbus.over(input), flash);
        if had_plc && modbus.writer().is_none() {
            measured.lose_plc();
        }
        if is_regular && self.station.bridge().may_feed_watchdog(now_ms) {
            self.alive_at = Instant::now();
        }
        // The commands that a silent gripper has not answered may still wait in the socket or port.
        let is_connected = self.station.bridge().is_connected();
        let is_silent = was_connected && !is_connected && !self.is_ending;
        if !self.line.is_open() {
            self.answered_at = now;
        }
        // A turn that was interrupted must not send its command.
        let is_late = pause.is_none() && since + uptime().saturating_sub(now) > LONGEST_PAUSE;
        let sent = if is_silent {
            Err(io::Error::other(SILENT))
        } else if is_late {
            Err(io::Error::other(PAUSED))
        } else {
            self.line.send()
        };
        match sent {
            Ok(()) if is_connected && !was_connected => {
                self.measured.gripper_connections = self.measured.gripper_connections.saturating_add(1);
                self.report_line(Severity::Info, format!("connected to the gripper at {}", self.address));
            }
            Ok(()) => {}
            Err(error) => self.lose_line(&error),
        }
        pause
    }

    /// Takes the received bytes from the line. Returns an error without a line, and when the gripper has been silent for too long: in
    /// this turn, masters already read that.
    fn receive(&mut self, now: Duration) -> io::Result<()> {
        let last = mem::replace(&mut self.received_at, now);
        if self.line.receive()? {
            // The answer may have waited since the last turn.
            self.answered_at = last;
        }
        let at_most = if self.station.bridge().is_connected() { SILENCE_TIME } else { SETUP_TIME };
        let is_silent = now.saturating_sub(self.answered_at) > at_most && !self.is_ending;
        if is_silent { Err(io::Error::other(SILENT)) } else { Ok(()) }
    }

    /// Resets the line to the gripper, if it is open. The bridge forgets its pending commands.
    fn lose_line(&mut self, why: &io::Error) {
        if self.line.is_open() && !self.is_ending {
            self.report_problem(why);
        }
        self.line.reset();
        self.station.bridge().set_link_lost(true);
    }

    fn report_problem(&mut self, problem: &io::Error) {
        self.report_line(
            Severity::Warning,
            format!("no connection to the gripper at {}: {problem}; retrying", self.address),
        );
    }

    /// Reports the state of the line, unless it is still the same.
    fn report_line(&mut self, severity: Severity, state: String) {
        if self.reported != state {
            self.log(severity, &state);
            self.reported = state;
        }
    }

    /// Prints a warning.
    fn report(&self, what: impl Display) {
        self.log(Severity::Warning, what);
    }

    fn log(&self, severity: Severity, what: impl Display) {
        log(severity, format_args!("{}{what}", self.label));
    }
}

/// Returns the time since the computer's start. It includes the time for which the computer was suspended: a request from before must
/// be found too old after it.
#[cfg(target_os = "linux")]
pub(super) fn uptime() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}

/// Returns the time since the first call. On Windows, it includes the time for which the computer was suspended.
#[cfg(not(target_os = "linux"))]
pub(super) fn uptime() -> Duration {
    static FIRST: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    FIRST.elapsed()
}

/// Prints a warning like [`log`].
pub(super) fn report(what: impl Display) {
    log(Severity::Warning, what);
}

/// Prints a message on standard error in a thread, so that a blocked standard error never delays a bridge or ends a task. Messages
/// are discarded while the queue is full.
fn log(severity: Severity, what: impl Display) {
    static MESSAGES: OnceLock<SyncSender<(Severity, String)>> = OnceLock::new();
    let messages = MESSAGES.get_or_init(|| {
        let (sender, messages) = sync_channel(MAX_MESSAGES);
        thread::spawn(move || messages.iter().for_each(|(severity, what)| print_message(severity, what)));
        sender
    });
    let _ = messages.try_send((severity, what.to_string()));
}

/// Returns whether no motion runs and none is to be stopped.
fn is_at_rest(bridge: &Bridge) -> bool {
    let image = bridge.input_image();
    image.status != Status::CmdPending
        && !image.system.contains(SystemFlags::MOVING)
        && !bridge.motion_is_open()
}

fn is_fast_stopped(bridge: &Bridge) -> bool {
    bridge.input_image().system.contains(SystemFlags::FAST_STOP)
}

#[cfg(test)]
mod tests {
    use wsg_sim::server::{Lines, ServerThread};

    use super::*;

    /// A PROFINET controller reads between turns, too.
    #[tokio::test]
    async fn inputs_are_shown_for_a_second_after_the_last_answer() {
        let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
        let gripper = ServerThread::start(wsg_sim::Config::default(), &lines, None).unwrap();
        let config = GripperConfig::of(&format!("tcp://{}", gripper.tcp_address().unwrap()));
        let gateway = Gateway::open(&config, &Rc::default()).unwrap();
        let stream = Stream::open(&config.gripper).await.unwrap();
        gateway.host.borrow_mut().line.open(stream);
        let start = Instant::now();
        while gateway.inputs().is_none() {
            assert!(start.elapsed() < Duration::from_secs(60), "the gripper does not answer");
            gateway.pass_time().await;
        }
        gateway.host.borrow_mut().answered_at -= Duration::from_millis(1_001);
        assert_eq!(gateway.inputs(), None);
    }
}
