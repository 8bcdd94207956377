//! The virtual gripper: the device, its clients, and the order in which things happen.

use crate::axis::Part;
use crate::client::Client;
use crate::config::Config;
use crate::device::{Device, NextEvent};
use crate::faults::Fault;
use crate::fieldbus::Fieldbus;
use crate::finger::{Finger, Jaw};
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortCounters, PortId, PortKind, Request};
use crate::script::{ScriptRequest, ScriptState};
use crate::time::{Time, earlier};
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Command, GripperState, GrippingStatistics, Status, SystemFlags, Temperature};

/// A gripper that up to `PORTS` clients talk to.
///
/// Sans-IO: the caller moves bytes and says what time it is.
/// - [`receive`](Self::receive) takes bytes of a client, [`transmit`](Self::transmit) gives the frames for it, one at a
///   call.
/// - [`advance`](Self::advance) lets time pass; every method that takes `now` does so first. Time never runs backwards:
///   a `now` before the latest one counts as that.
/// - [`next_wake`](Self::next_wake) says when something happens next by itself; call `advance` then.
///
/// What happens, happens at its own virtual time however late `advance` is called, so the same inputs at the same times
/// give the same bytes.
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
    clients: [Option<Client>; PORTS],
    connections: u32,
    now: Time,
}

/// How many clients a [`VirtualGripper`] takes when nothing else is said.
pub const DEFAULT_PORTS: usize = 8;

/// What the gripper is at, as somebody beside it would see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// The real opening width in mm, referenced or not.
    pub width: f32,
    /// What Get Opening Width answers, in mm: 0 while the fingers are not referenced.
    pub reported_width: f32,
    /// The change of the opening width in mm/s, negative while the fingers close; as the gripper counts, before the
    /// time scale.
    pub speed: f32,
    /// The force on the fingers in N, summed over both.
    pub force: f32,
    /// The force limit that is set, in N, summed over both fingers.
    pub force_limit: f32,
    /// The gripper state.
    pub gripper: GripperState,
    /// The system state flags.
    pub flags: SystemFlags,
    /// The temperature of the device.
    pub temperature: Temperature,
    /// The gripping statistics.
    pub statistics: GrippingStatistics,
    /// The part, between the fingers or waiting for them to open far enough.
    pub part: Option<Part>,
    /// Whether it is between them.
    pub part_is_between: bool,
}

impl VirtualGripper {
    /// A gripper that has just been switched on: not referenced, its fingers half open; for [`DEFAULT_PORTS`] clients.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self::with_ports(config)
    }
}

impl<const PORTS: usize> VirtualGripper<PORTS> {
    /// As [`new`](VirtualGripper::new), for any number of clients.
    #[must_use]
    pub fn with_ports(config: Config) -> Self {
        let device = Device::new(config);
        let fieldbus = Fieldbus::new(&device);
        Self { device, fieldbus, clients: [const { None }; PORTS], connections: 0, now: Time::ZERO }
    }

    /// Takes a client; `None` when there are as many as it can have.
    pub fn connect(&mut self, kind: PortKind) -> Option<PortId> {
        let index = self.clients.iter().position(Option::is_none)?;
        self.connections = self.connections.wrapping_add(1);
        let id = PortId { index: index as u16, generation: self.connections };
        *self.clients.get_mut(index)? = Some(Client::new(id, kind, self.device.config()));
        Some(id)
    }

    /// The client is gone. A TCP connection that ends without announcement causes a FAST STOP (command set, 1.4.2),
    /// unless that is configured off.
    pub fn disconnect(&mut self, id: PortId, now: Time) {
        self.advance(now);
        let Some(client) = self.client(id) else { return };
        let is_error = client.is_missed();
        let reaction = client.reaction_to_its_end(self.device.config());
        let has_cyclic_outputs = matches!(client, Client::Profibus(_) | Client::Images(_));
        if let Some(slot) = self.clients.get_mut(usize::from(id.index)) {
            *slot = None;
        }
        if is_error && self.device.config().disconnect_error {
            self.device.fast_stop();
        }
        if has_cyclic_outputs {
            self.fieldbus.end_outputs(&self.device, id, reaction);
        } else {
            self.fieldbus.leave(&self.device, id, reaction);
        }
        self.settle();
    }

    /// Ends the automatic updates of a client, for a line on which somebody else goes on, such as UDP.
    pub fn end_updates(&mut self, id: PortId, now: Time) {
        self.advance(now);
        if let Some(client) = client_in(&mut self.clients, id) {
            client.end_updates();
        }
    }

    /// Takes bytes from the client: frames, lines of the text protocol, frames of Modbus/TCP, or telegrams of PROFIBUS, as its
    /// kind is.
    ///
    /// All are taken at once. What they ask for is answered as long as the queue of frames has room, so empty it by
    /// [`transmit`](Self::transmit) every few hundred bytes.
    pub fn receive(&mut self, id: PortId, now: Time, bytes: &[u8]) {
        self.advance(now);
        if bytes.is_empty() {
            // Silence: the time that half a frame is waited for goes on.
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

    /// The next frame for the client, whole; `None` when there is none at this time.
    pub fn transmit<'a>(&mut self, id: PortId, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        client_in(&mut self.clients, id)?.next_frame(buffer)
    }

    /// Whether [`transmit`](Self::transmit) has a frame for the client.
    #[must_use]
    pub fn has_frame(&self, id: PortId) -> bool {
        self.client(id).is_some_and(Client::has_frame)
    }

    /// Whether nothing more can be understood of what the client sends: its connection is to be closed once it has
    /// been sent what there is. Only Modbus/TCP has no way back.
    #[must_use]
    pub fn is_lost(&self, id: PortId) -> bool {
        self.client(id).is_some_and(Client::is_lost)
    }

    /// What went wrong on the client's line; `None` when it is gone.
    #[must_use]
    pub fn counters(&self, id: PortId) -> Option<PortCounters> {
        self.client(id).map(Client::counters)
    }

    /// Lets everything happen that is due up to `now`, each at its own time.
    pub fn advance(&mut self, now: Time) {
        while let Some(at) = self.next_event(|event| event.any).filter(|at| *at <= now) {
            let before = self.now;
            // Something that has become due while time stood still happens now.
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

    /// When something happens next that may show on a line; `None`: not before something comes in.
    #[must_use]
    pub fn next_wake(&self) -> Option<Time> {
        self.next_event(|event| event.awake)
    }

    /// The time up to which everything has happened.
    #[must_use]
    pub const fn now(&self) -> Time {
        self.now
    }

    /// Puts a part between the fingers, or takes it away. A part wider than the opening goes in when the fingers have
    /// opened far enough.
    pub fn set_part(&mut self, part: Option<Part>, now: Time) {
        self.advance(now);
        self.device.set_part(part);
        self.settle();
    }

    /// Lets a fault begin or end.
    pub fn set_fault(&mut self, fault: Fault, on: bool, now: Time) {
        self.advance(now);
        self.device.set_fault(fault, on);
        self.settle();
    }

    /// Says whether a script runs on the gripper. When it ends, the commands that it has claimed are unknown again, and OF is 0.
    pub fn set_script_state(&mut self, state: ScriptState, now: Time) {
        self.advance(now);
        self.device.script_mut().set_state(state);
        if state != ScriptState::Running {
            self.fieldbus.set_user_outputs(0);
        }
        self.settle();
    }

    /// Claims commands of this id for the script: from now on [`take_script_request`](Self::take_script_request) gives them.
    /// Returns whether scripts may claim it ([`SCRIPT_IDS`](crate::SCRIPT_IDS)).
    pub fn claim_for_script(&mut self, id: u8) -> bool {
        self.device.script_mut().claim(id)
    }

    /// Gives an id back that the script has claimed: its commands are unknown from now on. Harmless for an id that is not
    /// claimed. Returns whether scripts may claim it.
    pub fn release_for_script(&mut self, id: u8) -> bool {
        self.device.script_mut().release(id)
    }

    /// The number of commands that wait for the script.
    #[must_use]
    pub fn script_requests(&mut self) -> usize {
        self.device.script_mut().waiting()
    }

    /// Sets OF: the user flags OF1 (bit 0) to OF8 that every fieldbus master reads (fieldbus manual, 5.1.1). They are 0 again
    /// when the script ends. [`fieldbus_images`](Self::fieldbus_images) gives IF and OF.
    pub const fn set_user_outputs(&mut self, flags: u8) {
        self.fieldbus.set_user_outputs(flags);
    }

    /// The next command for the script.
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

    /// Sends an answer of the script, status and all, to a client that may be gone by now. Returns whether it is short enough
    /// for a frame of the gripper.
    pub fn answer_for_script(&mut self, port: PortId, id: u8, payload: &[u8]) -> bool {
        let fits = payload.len() + OVERHEAD <= MAX_FRAME_LEN;
        if fits && let Some(client) = client_in(&mut self.clients, port) {
            client.answer_script(id, payload);
        }
        fits
    }

    /// Carries out a command of a hand beside the gripper, as the web interface of the real one does, or of a script; its first
    /// status. What a motion comes to shows in the state.
    pub fn command(&mut self, command: &Command<'_>, now: Time) -> Status {
        self.advance(now);
        let request = Request { port: PortId::HAND, now: self.now };
        let status = self.device.execute(request, command).status();
        self.device.note_result(command.id().kind(), status);
        self.settle();
        status
    }

    /// Velocity mode of scripts: runs at this speed in mm/s, negative while the fingers close, until it is told another one, 0
    /// included, until any other command, or the end of the stroke or of a soft limit; what blocks the fingers is pushed against
    /// with the force limit. E_CMD_PENDING when it runs.
    pub fn run_for_script(&mut self, speed: f32, now: Time) -> Status {
        self.advance(now);
        let request = Request { port: PortId::HAND, now: self.now };
        let status = self.device.run_at(request, speed);
        self.settle();
        status
    }

    /// The finger on this side: its kind, and the force on it in N as its sensor measures it, if it has one.
    #[must_use]
    pub fn finger(&self, jaw: Jaw) -> (Finger, Option<f32>) {
        self.device.finger_reading(jaw)
    }

    /// Returns both images of the register interface: the outputs that a master wrote last, and the inputs that one reads now. The
    /// outputs are zeros after the master of PROFIBUS or PROFINET has left, cleared them or stopped.
    #[must_use]
    pub fn fieldbus_images(&self) -> (OutputImage, InputImage) {
        (*self.fieldbus.written(), self.fieldbus.input(&self.device))
    }

    /// Takes an image that a master wrote as a whole over a bus of images ([`PortKind::Profinet`]). `is_first`: the first since it
    /// began to write; flags in it count after they were 0, but FASTSTOP.
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

    /// The master that writes images has stopped, or is silent. If it was the one that commands, what runs ends as is
    /// configured ([`Config::bus_reaction`]); a jog ends in any case.
    pub fn end_images(&mut self, id: PortId, now: Time) {
        self.advance(now);
        self.fieldbus.end_outputs(&self.device, id, self.device.config().bus_reaction);
        self.settle();
    }

    /// How things stand at [`now`](Self::now).
    #[must_use]
    pub fn state(&self) -> State {
        let device = &self.device;
        State {
            width: device.real_width() as f32,
            reported_width: device.reported_width(),
            speed: device.speed() as f32,
            force: device.real_force() as f32,
            force_limit: device.force_limit(),
            gripper: device.state(),
            flags: device.flags(),
            temperature: device.temperature(),
            statistics: device.statistics(),
            part: device.part(),
            part_is_between: device.part_is_between(),
        }
    }

    /// Sends what the last event led to: second answers, then updates.
    fn settle(&mut self) {
        let Self { device, fieldbus, clients, now, .. } = self;
        loop {
            while let Some(done) = device.take_completion(*now) {
                if done.port == PortId::FIELDBUS {
                    fieldbus.complete(device, done);
                } else if let Some(client) = client_in(clients, done.port) {
                    client.complete(done);
                }
            }
            // A motion that the controller ends has an answer, too. It asks for a bounded number of commands at a time:
            // each of its motions begins with what a master wrote.
            if !fieldbus.follow(device, *now) {
                break;
            }
        }
        device.note_load();
        let readings = device.readings();
        for client in clients.iter_mut().flatten() {
            client.publish(*now, &readings);
        }
    }

    /// Ends the wait for half frames, and for masters, whose time is over. What they held may hold whole frames.
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

    fn client(&self, id: PortId) -> Option<&Client> {
        self.clients.get(usize::from(id.index))?.as_ref().filter(|client| client.id() == id)
    }
}

fn client_in(clients: &mut [Option<Client>], id: PortId) -> Option<&mut Client> {
    clients.get_mut(usize::from(id.index))?.as_mut().filter(|client| client.id() == id)
}
