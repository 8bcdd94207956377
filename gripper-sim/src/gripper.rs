//! The virtual gripper: the device, its clients, and the order of events.

use crate::axis::Part;
use crate::config::{Config, Tag};
use crate::device::{Device, NextEvent};
use crate::faults::Fault;
use crate::fieldbus::{Exchange, Fieldbus};
use crate::finger::{Finger, Jaw};
use crate::journal::{Cause, Journal, JournalEvent};
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind, Request};
use crate::protocol_client::ProtocolClient;
use crate::script::{ScriptRequest, ScriptState};
use crate::time::{Time, earlier};
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Command, GripperState, GrippingStatistics, SoftLimits, Status, SystemFlags, Temperature};

/// A gripper with up to `PORTS` clients.
///
/// Sans-IO: the caller moves the bytes and supplies the time.
/// - [`receive`](Self::receive) takes bytes from a client; [`transmit`](Self::transmit) returns one frame for it per
///   call.
/// - [`advance`](Self::advance) moves virtual time forward. Every method with a `now` parameter does so first. Time
///   never runs backwards: a `now` before the latest one counts as the latest one.
/// - [`next_wake`](Self::next_wake) returns the time of the next timed event; call `advance` then.
///
/// Every event takes effect at its own virtual time, however late `advance` is called. The same inputs at the same
/// times therefore produce the same bytes.
///
/// ```
/// use wsg_sim::{Config, PortKind, Time, VirtualGripper};
///
/// let mut gripper = VirtualGripper::new(Config::default());
/// let client = gripper.connect(PortKind::Serial).unwrap();
/// // Homing (20h) outward.
/// gripper.receive(client, Time::ZERO, &[0xAA, 0xAA, 0xAA, 0x20, 0x01, 0x00, 0x01, 0xAE, 0x93]);
/// let mut buffer = [0; wsg_sim::MAX_FRAME_LEN];
/// let pending = gripper.transmit(client, &mut buffer).unwrap();
/// assert_eq!(pending[3..8], [0x20, 0x02, 0x00, 0x1A, 0x00]);
///
/// gripper.advance(Time::from_millis(4_000));
/// let done = gripper.transmit(client, &mut buffer).unwrap();
/// assert_eq!(done, [0xAA, 0xAA, 0xAA, 0x20, 0x02, 0x00, 0x00, 0x00, 0xB3, 0xFD]);
/// assert_eq!(gripper.state().width, 110.0);
/// ```
#[derive(Clone, Debug)]
pub struct VirtualGripper<const PORTS: usize = DEFAULT_PORTS> {
    device: Device,
    fieldbus: Fieldbus,
    clients: [Option<ProtocolClient>; PORTS],
    connections: u32,
    journal: Journal,
    now: Time,
}

/// The default number of clients of a [`VirtualGripper`].
pub const DEFAULT_PORTS: usize = 8;

/// The state of the gripper as an observer beside it sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// The real opening width in mm, referenced or not.
    pub width: f32,
    /// The answer to Get Opening Width, in mm: 0 while the fingers are not referenced.
    pub reported_width: f32,
    /// The change of the opening width in mm/s, negative while the fingers close, excluding the time scale.
    pub speed: f32,
    /// The force on the fingers in N, summed over both.
    pub force: f32,
    /// The configured force limit in N, summed over both fingers.
    pub force_limit: f32,
    /// The configured acceleration in mm/s².
    pub acceleration: f32,
    /// The soft limits, if they are set.
    pub soft_limits: Option<SoftLimits>,
    /// The gripper state (command set, 3.4.2 and appendix C).
    pub gripper: GripperState,
    /// The system state flags (command set, appendix B).
    pub flags: SystemFlags,
    /// The temperature of the device, as Get Temperature reports it.
    pub temperature: Temperature,
    /// The gripping statistics since power-up or the last reset.
    pub statistics: GrippingStatistics,
    /// The part, whether between the fingers or waiting for them to open far enough.
    pub part: Option<Part>,
    /// Whether the part is between the fingers, or around them.
    pub part_is_between: bool,
    /// Whether the part is around the fingers, which are in its hole.
    pub part_is_around: bool,
}

impl VirtualGripper {
    /// Creates a gripper for [`DEFAULT_PORTS`] clients, just powered up: not referenced, its fingers half open.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self::with_ports(config)
    }
}

impl<const PORTS: usize> VirtualGripper<PORTS> {
    /// Creates a gripper for `PORTS` clients; otherwise the same as [`new`](VirtualGripper::new).
    #[must_use]
    pub fn with_ports(config: Config) -> Self {
        let device = Device::new(config);
        let fieldbus = Fieldbus::new(&device);
        Self {
            device,
            fieldbus,
            clients: [const { None }; PORTS],
            connections: 0,
            journal: Journal::default(),
            now: Time::ZERO,
        }
    }

    /// Connects a client. Returns `None` if all `PORTS` places are taken.
    pub fn connect(&mut self, kind: PortKind) -> Option<PortId> {
        let index = self.clients.iter().position(Option::is_none)?;
        self.connections = self.connections.wrapping_add(1);
        let id = PortId { index: index as u16, generation: self.connections };
        *self.clients.get_mut(index)? = Some(ProtocolClient::new(id, kind, self.device.config()));
        Some(id)
    }

    /// Disconnects a client. The unannounced end of a TCP connection causes a FAST STOP (command set, 1.4.2), unless
    /// [`Config::disconnect_error`] is off.
    pub fn disconnect(&mut self, id: PortId, now: Time) {
        self.advance(now);
        let Some(client) = self.client(id) else { return };
        let is_error = client.is_missed();
        let reaction = client.reaction_to_its_end(self.device.config());
        let has_cyclic_outputs = client.has_cyclic_outputs();
        if let Some(slot) = self.clients.get_mut(usize::from(id.index)) {
            *slot = None;
        }
        if is_error && self.device.config().disconnect_error {
            self.device.fast_stop(Cause::Disconnected(id));
        }
        if has_cyclic_outputs {
            self.fieldbus.end_outputs(&self.device, id, reaction);
        } else {
            self.fieldbus.leave(&self.device, id, reaction);
        }
        self.settle();
    }

    /// Returns whether the end of this client's connection would be an error: the client sent data and did not announce
    /// the end (command set, 3.1.2).
    #[must_use]
    pub fn is_missed(&self, id: PortId) -> bool {
        self.client(id).is_some_and(|client| client.is_missed())
    }

    /// Takes the next event for the system log. The queue keeps the latest events.
    pub fn take_journal_event(&mut self) -> Option<JournalEvent> {
        self.journal.take()
    }

    /// Ends the automatic updates of a client. For lines such as UDP, on which another sender takes over.
    pub fn end_updates(&mut self, id: PortId, now: Time) {
        self.advance(now);
        if let Some(client) = client_in(&mut self.clients, id) {
            client.end_updates();
        }
    }

    /// Takes bytes from the client. Its [`PortKind`] determines whether they are frames of the binary protocol, lines
    /// of the text protocol, frames of Modbus/TCP, or telegrams of PROFIBUS.
    ///
    /// All bytes are consumed. Answers are lost once the queue is full, so drain it with [`transmit`](Self::transmit)
    /// every few hundred bytes.
    pub fn receive(&mut self, id: PortId, now: Time, bytes: &[u8]) {
        self.advance(now);
        if bytes.is_empty() {
            // An empty read is silence and must not restart the time-out of an incomplete frame.
            return;
        }
        let mut rest = bytes;
        loop {
            let Self { device, fieldbus, clients, now, .. } = self;
            let Some(client) = client_in(clients, id) else { return };
            let (taken, happened) = client.receive(device, fieldbus, *now, rest);
            rest = rest.get(taken..).unwrap_or(&[]);
            if happened {
                self.settle();
            } else if rest.is_empty() {
                break;
            }
        }
        let Self { device, clients, now, .. } = self;
        if client_in(clients, id).is_some_and(|client| client.pause(device, *now)) {
            self.settle();
        }
        self.expire_half_frames();
    }

    /// Returns the next complete frame for the client, or `None` if none is queued.
    pub fn transmit<'a>(&mut self, id: PortId, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        client_in(&mut self.clients, id)?.next_frame(buffer)
    }

    /// Whether [`transmit`](Self::transmit) has a frame for the client.
    #[must_use]
    pub fn has_frame(&self, id: PortId) -> bool {
        self.client(id).is_some_and(|client| client.has_frame())
    }

    /// Returns whether the client's byte stream has lost synchronization for good. Send the queued frames, then close
    /// the connection. Only Modbus/TCP cannot resynchronize.
    #[must_use]
    pub fn is_lost(&self, id: PortId) -> bool {
        self.client(id).is_some_and(|client| client.is_lost())
    }

    /// Returns the error counters of the client's line; `None` after a disconnect.
    #[must_use]
    pub fn counters(&self, id: PortId) -> Option<PortCounters> {
        self.client(id).map(|client| client.counters())
    }

    /// Processes every event that is due up to `now`, each at its own time.
    pub fn advance(&mut self, now: Time) {
        while let Some(at) = self.next_event(|event| event.any).filter(|at| *at <= now) {
            let before = self.now;
            // An event that became due while time stood still is processed now.
            self.now = at.max(before);
            self.device.run_due(before, self.now);
            self.settle();
            self.expire_half_frames();
            if self.fieldbus.expire(&self.device, self.now) {
                self.settle();
            }
        }
        self.now = self.now.max(now);
    }

    /// Returns the time of the next event that may affect a line; `None` if nothing happens without further input.
    #[must_use]
    pub fn next_wake(&self) -> Option<Time> {
        self.next_event(|event| event.awake)
    }

    /// Returns the time up to which all events have been processed.
    #[must_use]
    pub const fn now(&self) -> Time {
        self.now
    }

    /// Returns the current settings.
    #[must_use]
    pub const fn config(&self) -> &Config {
        self.device.config()
    }

    /// Returns the device tag, which a client may have changed since power-up (command set, 3.5.2).
    #[must_use]
    pub const fn tag(&self) -> &Tag {
        self.device.tag()
    }

    /// Takes over the settings that a running gripper can take over ([`Config::at_run_time`]). Reference, latched state and
    /// connections stay. A part or a tag that differs from the last settings is set. Clients of the text protocol keep
    /// their part width tolerance and clamping travel, which they can set themselves.
    ///
    /// Returns E_ALREADY_RUNNING, and changes nothing, while a motion runs whose settings would change.
    pub fn reconfigure(&mut self, config: &Config, now: Time) -> Status {
        self.advance(now);
        let before = *self.config();
        let config = before.at_run_time(config);
        if !self.device.reconfigure(config) {
            return Status::AlreadyRunning;
        }
        for client in self.clients.iter_mut().flatten() {
            client.reconfigure(&before, &config);
        }
        self.settle();
        Status::Success
    }

    /// Places a part between the fingers, or removes it. A part wider than the opening enters once the fingers have
    /// opened far enough.
    pub fn set_part(&mut self, part: Option<Part>, now: Time) {
        self.advance(now);
        self.device.set_part(part);
        self.settle();
    }

    /// Begins or ends a fault.
    pub fn set_fault(&mut self, fault: Fault, on: bool, now: Time) {
        self.advance(now);
        self.device.set_fault(fault, on);
        self.settle();
    }

    /// Sets whether a script runs on the gripper. When it ends, the commands it has claimed become unknown again and OF
    /// is set to 0.
    pub fn set_script_state(&mut self, state: ScriptState, now: Time) {
        self.advance(now);
        self.device.set_script_state(state);
        if state != ScriptState::Running {
            self.fieldbus.set_user_outputs(0);
        }
        self.settle();
    }

    /// Claims commands with this id for the script; [`take_script_request`](Self::take_script_request) returns them.
    /// Returns whether scripts may claim the id ([`SCRIPT_IDS`](crate::SCRIPT_IDS)).
    pub fn claim_for_script(&mut self, id: u8) -> bool {
        self.device.script_mut().claim(id)
    }

    /// Releases an id that the script has claimed: its commands become unknown. Does nothing if the id is not claimed.
    /// Returns whether scripts may claim it.
    pub fn release_for_script(&mut self, id: u8) -> bool {
        self.device.script_mut().release(id)
    }

    /// Returns the number of commands queued for the script.
    #[must_use]
    pub fn script_requests(&mut self) -> usize {
        self.device.script_mut().waiting()
    }

    /// Sets OF: the user flags OF1 (bit 0) to OF8, which every fieldbus master reads (fieldbus manual, 5.1.1). They
    /// return to 0 when the script ends. [`fieldbus_images`](Self::fieldbus_images) returns IF and OF.
    pub const fn set_user_outputs(&mut self, flags: u8) {
        self.fieldbus.set_user_outputs(flags);
    }

    /// Takes the next command queued for the script.
    ///
    /// ```
    /// use wsg_sim::{Config, PortKind, ScriptState, Time, VirtualGripper};
    ///
    /// let mut gripper = VirtualGripper::new(Config::default());
    /// let client = gripper.connect(PortKind::Serial).unwrap();
    /// gripper.set_script_state(ScriptState::Running, Time::ZERO);
    /// assert!(gripper.claim_for_script(0xB0));
    /// let request: Vec<u8> = wsg_protocol::FrameEncoder::new(0xB0, &[1][..]).collect();
    /// gripper.receive(client, Time::ZERO, &request);
    /// let request = gripper.take_script_request().unwrap();
    /// assert_eq!((request.id, &request.payload[..]), (0xB0, &[1][..]));
    /// assert!(gripper.answer_for_script(request.port, request.id, &[0, 0]));
    /// let mut buffer = [0; wsg_sim::MAX_FRAME_LEN];
    /// assert_eq!(gripper.transmit(client, &mut buffer).unwrap()[3..8], [0xB0, 2, 0, 0, 0]);
    /// ```
    pub fn take_script_request(&mut self) -> Option<ScriptRequest> {
        self.device.script_mut().take()
    }

    /// Sends an answer of the script, including its status, to a client that may have disconnected. Returns whether it
    /// fits into a frame of the gripper.
    pub fn answer_for_script(&mut self, port: PortId, id: u8, payload: &[u8]) -> bool {
        let fits = payload.len() + OVERHEAD <= MAX_FRAME_LEN;
        if fits && let Some(client) = client_in(&mut self.clients, port) {
            client.answer_script(id, payload);
        }
        fits
    }

    /// Executes a command of an operator, as on the real gripper's web interface, or of a script. Returns its first
    /// status; the state shows the outcome of a motion.
    pub fn command(&mut self, command: &Command<'_>, now: Time) -> Status {
        self.advance(now);
        let request = Request { port: PortId::HAND, now: self.now };
        let status = self.device.execute(request, command).status();
        self.device.note_result(command.id().kind(), status);
        self.settle();
        status
    }

    /// Sets the force limit and executes a command of an operator. A refused command leaves the force limit as it was, and
    /// so does a force that the gripper would have to correct.
    #[cfg(feature = "control")]
    pub(crate) fn command_with_force(&mut self, force: f32, command: &Command<'_>, now: Time) -> Status {
        let settings = self.device.motion().settings();
        let before = settings.force_limit();
        if settings.possible_force(force) != force {
            return Status::RangeError;
        }
        self.device.set_force_limit(force);
        let status = self.command(command, now);
        if !matches!(status, Status::Success | Status::CmdPending) {
            self.device.set_force_limit(before);
        }
        status
    }

    /// Starts the velocity mode of scripts at this speed in mm/s, negative to close the fingers. The fingers move until
    /// the next speed, 0 included, any other command, or the end of the stroke or of a soft limit. They push against an
    /// obstacle with the force limit. Returns E_CMD_PENDING when the motion starts.
    pub fn run_for_script(&mut self, speed: f32, now: Time) -> Status {
        self.advance(now);
        let request = Request { port: PortId::HAND, now: self.now };
        let status = self.device.motion_mut().run_at(request, speed);
        self.settle();
        status
    }

    /// Returns whether a motion is in progress that the next motion command cannot replace, so that it would get
    /// E_ALREADY_RUNNING. Velocity mode of scripts counts only while the fingers move.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.device.motion().is_busy()
    }

    /// Opens the interface of this finger to custom electronics, for the script. FF_COMM_OPEN is set until the script ends.
    pub fn open_finger_interface(&mut self, jaw: Jaw) {
        self.device.open_finger_interface(jaw);
        self.settle();
    }

    /// Returns the kind of finger on this jaw and, for a force sensor, the force in N that it measures.
    #[must_use]
    pub fn finger(&self, jaw: Jaw) -> (Finger, Option<f32>) {
        self.device.finger_reading(jaw)
    }

    /// Returns both images of the register interface: the outputs that a master wrote last, and the current inputs. The
    /// outputs are zeros after the master on PROFIBUS, PROFINET or EtherNet/IP has left, cleared them or stopped.
    #[must_use]
    pub fn fieldbus_images(&self) -> (OutputImage, InputImage) {
        (*self.fieldbus.written(), self.fieldbus.input(&self.device))
    }

    /// Returns how data exchange with the masters of the register interface stands.
    #[must_use]
    pub const fn exchange(&self) -> Exchange {
        self.fieldbus.exchange_state()
    }

    /// Returns the address of the PROFIBUS master that has locked the slave, if any.
    #[must_use]
    pub fn profibus_master(&self) -> Option<u8> {
        self.clients.iter().flatten().find_map(ProtocolClient::profibus_master)
    }

    /// Writes a complete output image from a bus with image transfer ([`PortKind::Profinet`]). `is_first` marks the
    /// first image since the master began to write. A flag set in that image takes effect only after it has been 0, except
    /// FASTSTOP.
    ///
    /// ```
    /// use wsg_fieldbus::{CommandFlags, OutputImage};
    /// use wsg_sim::{Config, PortKind, Time, VirtualGripper};
    ///
    /// let mut gripper = VirtualGripper::new(Config::default());
    /// let bus = gripper.connect(PortKind::Profinet).unwrap();
    /// gripper.write_image(bus, Time::ZERO, &OutputImage::ZERO, true);
    /// let homing = OutputImage { flags: CommandFlags::HOMING, ..OutputImage::ZERO };
    /// gripper.write_image(bus, Time::from_millis(8), &homing, false);
    /// gripper.advance(Time::from_millis(4_000));
    /// assert_eq!(gripper.state().width, 110.0);
    /// ```
    pub fn write_image(&mut self, id: PortId, now: Time, image: &OutputImage, is_first: bool) {
        self.advance(now);
        if self.client(id).is_some() {
            self.fieldbus.exchange(&self.device, id, image, is_first);
            self.settle();
        }
    }

    /// Reports that the master that writes images has stopped or is silent. If it was the active master, a running
    /// motion ends as [`Config::bus_reaction`] specifies; a jog ends in any case.
    pub fn end_images(&mut self, id: PortId, now: Time) {
        self.advance(now);
        self.fieldbus.end_outputs(&self.device, id, self.device.config().bus_reaction);
        self.settle();
    }

    /// Returns the state at [`now`](Self::now).
    #[must_use]
    pub fn state(&self) -> State {
        let device = &self.device;
        let (motion, axis) = (device.motion(), device.motion().axis());
        State {
            width: axis.width() as f32,
            reported_width: device.reported_width(),
            speed: axis.speed() as f32,
            force: axis.force() as f32,
            force_limit: motion.settings().force_limit(),
            acceleration: motion.settings().acceleration(),
            soft_limits: motion.settings().soft_limits(),
            gripper: motion.state(),
            flags: device.flags(),
            temperature: device.temperature(),
            statistics: motion.statistics(),
            part: axis.part(),
            part_is_between: axis.part_is_between(),
            part_is_around: axis.part_is_around(),
        }
    }

    /// Sends the results of the last event: second answers first, then updates.
    fn settle(&mut self) {
        let Self { device, fieldbus, clients, journal, now, .. } = self;
        loop {
            while let Some(done) = device.take_completion(*now) {
                if done.port == PortId::FIELDBUS {
                    fieldbus.complete(device, done);
                } else if let Some(client) = client_in(clients, done.port) {
                    client.complete(done);
                }
            }
            // Motions that the controller ends are answered, too. The loop terminates, because each motion of the
            // controller begins with a write from a master.
            if !fieldbus.follow(device, *now) {
                break;
            }
        }
        device.note_load();
        let readings = device.readings();
        let cause = match device.cause() {
            Cause::Fieldbus(_) => Cause::Fieldbus(fieldbus.writer()),
            cause => cause,
        };
        journal.observe(*now, readings.flags, cause);
        for client in clients.iter_mut().flatten() {
            client.publish(*now, &readings);
        }
    }

    /// Processes the expired time-outs of incomplete frames and of masters. The bytes of an incomplete frame may
    /// contain complete ones.
    fn expire_half_frames(&mut self) {
        for index in 0..PORTS {
            loop {
                let Self { device, fieldbus, clients, now, .. } = self;
                let Some(Some(client)) = clients.get_mut(index) else { break };
                if !client.expire(device, fieldbus, *now) {
                    break;
                }
                self.settle();
            }
        }
    }

    fn next_event(&self, pick: impl FnOnce(NextEvent) -> Option<Time>) -> Option<Time> {
        let device = pick(self.device.next_event(self.now));
        let clients = self.clients.iter().flatten().filter_map(|client| client.next_due(self.now)).min();
        earlier(earlier(device, clients), self.fieldbus.next_due(&self.device))
    }

    fn client(&self, id: PortId) -> Option<&ProtocolClient> {
        self.clients.get(usize::from(id.index))?.as_ref().filter(|client| client.id() == id)
    }
}

fn client_in(clients: &mut [Option<ProtocolClient>], id: PortId) -> Option<&mut ProtocolClient> {
    clients.get_mut(usize::from(id.index))?.as_mut().filter(|client| client.id() == id)
}
