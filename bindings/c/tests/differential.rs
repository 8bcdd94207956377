//! The C interface and the Rust session give the same return values, bytes, events and state for the same script.
//!
//! The reference is [`Session`] with a parser in front of it. The values of C events are compared as payload bytes, which this
//! test encodes from the plain structures. `WSG_WHOLE=1` runs 10⁶ scripts; use a release build for that.

use std::collections::BTreeSet;
use std::ffi::{CString, c_void};
use std::mem::MaybeUninit;
use std::ptr;

use wsg::config::*;
use wsg::event::*;
use wsg::known::*;
use wsg::request::*;
use wsg::session::*;
use wsg::wsg_error;
use wsg_protocol::session::{self, Event, RequestError, Session, Topic};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, DecodeError, Frame, FrameEncoder, FrameParser, Instant, Payload, Reply,
    Status, UpdateFlags, Value,
};

/// Scripts of a run, and steps of a script.
const SCRIPTS: u64 = 2_000;
const WHOLE: u64 = 1_000_000;
const STEPS: usize = 40;

/// A generator of pseudo-random numbers (xorshift64*).
struct Chance(u64);

impl Chance {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 16
    }

    fn below(&mut self, limit: usize) -> usize {
        self.next() as usize % limit
    }

    fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    fn bytes(&mut self, len: usize) -> Vec<u8> {
        (0..len).map(|_| self.next() as u8).collect()
    }

    /// Mostly a usable number, sometimes none.
    fn number(&mut self) -> f32 {
        match self.below(24) {
            0 => f32::NAN,
            1 => f32::INFINITY,
            _ => self.below(5_000) as f32 / 16.0,
        }
    }
}

/// An event in a form that both sides can be brought to.
#[derive(Debug, PartialEq)]
struct Seen {
    kind: u8,
    command: u8,
    status: u16,
    value: Vec<u8>,
}

impl Seen {
    fn of(event: &Event<'_>) -> Self {
        let seen = |kind: wsg_event, id: CommandId| Self {
            kind: kind as u8,
            command: id.code(),
            status: 0,
            value: vec![],
        };
        let none = CommandId::from_code(0);
        match event {
            Event::Connected => seen(wsg_event::Connected, none),
            Event::Disconnected => seen(wsg_event::Disconnected, none),
            Event::Pending(id) => Self { status: 26, ..seen(wsg_event::Pending, *id) },
            Event::Answered(reply) => Self {
                status: reply.status().code(),
                value: value_bytes(reply),
                ..seen(wsg_event::Answered, reply.id())
            },
            Event::Unanswered(id) => seen(wsg_event::Unanswered, *id),
            Event::Late(id) => seen(wsg_event::Late, *id),
            Event::Withdrawn(id) => seen(wsg_event::Withdrawn, *id),
            Event::Reported(value) => {
                Self { value: value_bytes(&Reply::success(*value)), ..seen(wsg_event::Reported, value.id()) }
            }
            other => panic!("unknown event {other:?}"),
        }
    }
}

/// The payload without the status.
fn value_bytes(reply: &Reply<'_>) -> Vec<u8> {
    (2..reply.len()).map(|index| reply.byte(index)).collect()
}

/// Collects the events of the C interface.
unsafe extern "C" fn collect(context: *mut c_void, event: *const wsg_event_t) {
    let (seen, event) = unsafe { (&mut *context.cast::<Vec<Seen>>(), &*event) };
    seen.push(Seen {
        kind: event.kind,
        command: event.command,
        status: event.status,
        value: plain_bytes(event),
    });
}

/// Encodes the value of an event by the manual.
fn plain_bytes(event: &wsg_event_t) -> Vec<u8> {
    let floats = |floats: &[f32]| floats.iter().flat_map(|float| float.to_le_bytes()).collect::<Vec<u8>>();
    let kinds = [
        wsg_value::None,
        wsg_value::Number,
        wsg_value::Flags,
        wsg_value::State,
        wsg_value::SoftLimits,
        wsg_value::Statistics,
        wsg_value::Temperature,
        wsg_value::Info,
        wsg_value::Limits,
        wsg_value::Finger,
        wsg_value::Bytes,
    ];
    let value = &event.value;
    unsafe {
        match kinds[usize::from(event.value_kind)] {
            wsg_value::None => vec![],
            wsg_value::Number => floats(&[value.number]),
            wsg_value::Flags if event.command == 0x40 => value.flags.to_le_bytes().to_vec(),
            wsg_value::Flags => u16::try_from(value.flags).unwrap().to_le_bytes().to_vec(),
            wsg_value::State => vec![value.state],
            wsg_value::SoftLimits => floats(&[value.soft_limits.minus, value.soft_limits.plus]),
            wsg_value::Statistics => {
                let counts = value.statistics;
                let [no_part, lost] = [counts.no_part, counts.part_lost].map(u16::to_le_bytes);
                [&counts.total.to_le_bytes()[..], &no_part, &lost].concat()
            }
            wsg_value::Temperature => value.temperature.to_le_bytes().to_vec(),
            wsg_value::Info => {
                let info = value.info;
                let (firmware, serial) = (info.firmware.to_le_bytes(), info.serial_number.to_le_bytes());
                [&[info.device, info.hardware_revision][..], &firmware, &serial].concat()
            }
            wsg_value::Limits => {
                let limits = value.limits;
                floats(&[
                    limits.stroke,
                    limits.min_speed,
                    limits.max_speed,
                    limits.min_acceleration,
                    limits.max_acceleration,
                    limits.min_force,
                    limits.nominal_force,
                    limits.overdrive_force,
                ])
            }
            wsg_value::Finger => {
                let [low, high] = value.finger.data_len.to_le_bytes();
                vec![value.finger.finger, low, high]
            }
            wsg_value::Bytes if value.bytes.length == 0 => vec![],
            wsg_value::Bytes => {
                std::slice::from_raw_parts(value.bytes.data, value.bytes.length.into()).to_vec()
            }
        }
    }
}

struct Pair {
    c: Box<MaybeUninit<wsg_t>>,
    // Boxed, because C has its address.
    #[allow(clippy::box_collection)]
    c_seen: Box<Vec<Seen>>,
    parser: FrameParser<WSG_MAX_PAYLOAD>,
    session: Session,
    /// The request whose payload both sides borrow, with its bytes and what C sees of them.
    kept: Option<(CommandId, Vec<u8>, CString)>,
    seen: Vec<Seen>,
    received_at: Instant,
    frame_timeout_ms: u32,
    now: u32,
    /// The commands sent last, to be answered.
    sent: Vec<CommandId>,
    requested: BTreeSet<u8>,
}

impl Pair {
    fn new(chance: &mut Chance) -> Self {
        let mut config = MaybeUninit::uninit();
        assert_eq!(wsg_config_default(Some(&mut config)), 0);
        let mut config = unsafe { config.assume_init() };
        config.updates = chance.below(8) as u8;
        config.verify_settings = chance.below(2) as u8;
        config.attempts = 1 + chance.below(3) as u8;
        let mut vary = |ms: &mut u32| *ms *= 1 + chance.below(3) as u32;
        vary(&mut config.reply_timeout_ms);
        vary(&mut config.refresh_ms);
        vary(&mut config.reconnect_ms);
        vary(&mut config.motion_timeout_ms);
        vary(&mut config.result_grace_ms);
        vary(&mut config.fast_stop_answer_ms);
        vary(&mut config.fast_stop_pause_ms);
        config.frame_timeout_ms *= 1 + chance.below(2) as u16;
        config.fast_stop_burst_frames = 1 + chance.below(5) as u16;
        config.update_period_ms += chance.below(50) as u16;
        let rust = session::Config {
            width: config.updates & WSG_UPDATE_WIDTH != 0,
            speed: config.updates & WSG_UPDATE_SPEED != 0,
            force: config.updates & WSG_UPDATE_FORCE != 0,
            verify_settings: config.verify_settings == 1,
            attempts: config.attempts,
            reply_timeout_ms: config.reply_timeout_ms,
            refresh_ms: config.refresh_ms,
            reconnect_ms: config.reconnect_ms,
            motion_timeout_ms: config.motion_timeout_ms,
            result_grace_ms: config.result_grace_ms,
            update_period_ms: config.update_period_ms,
            fast_stop: session::FastStopPattern {
                answer_ms: config.fast_stop_answer_ms,
                burst_frames: config.fast_stop_burst_frames,
                pause_ms: config.fast_stop_pause_ms,
            },
            ..session::Config::DEFAULT
        };
        let mut c = Box::new(MaybeUninit::uninit());
        let mut c_seen: Box<Vec<Seen>> = Box::default();
        let context = ptr::from_mut(&mut *c_seen).cast();
        assert_eq!(unsafe { wsg_init(Some(&mut c), Some(&config), Some(collect), context) }, 0);
        Self {
            c,
            c_seen,
            parser: FrameParser::new(),
            session: Session::new(rust),
            kept: None,
            seen: vec![],
            received_at: Instant::from_millis(0),
            frame_timeout_ms: config.frame_timeout_ms.into(),
            now: chance.next() as u32,
            sent: vec![],
            requested: BTreeSet::new(),
        }
    }

    fn c(&mut self) -> Option<&mut wsg_t> {
        Some(unsafe { self.c.assume_init_mut() })
    }

    fn step(&mut self, chance: &mut Chance) {
        match chance.below(20) {
            0..4 => self.receive(&Self::something_received(chance, &self.sent)),
            4..7 => self.pass_time(chance),
            7..12 => self.request(chance),
            12 => self.subscribe(chance),
            13 if chance.one_in(8) => {
                assert_eq!(wsg_disconnect(self.c()), 0);
                self.session.disconnect();
            }
            14 if chance.one_in(8) => {
                assert_eq!(wsg_withdraw(self.c()), 0);
                self.session.withdraw();
                self.kept = None;
            }
            15 if chance.one_in(4) => {
                assert_eq!(unsafe { wsg_expire(self.c.as_mut_ptr(), self.now) }, 0);
                self.expire();
            }
            _ => self.answer(chance),
        }
        self.tick();
        self.transmit();
        self.compare();
    }

    fn note(seen: &mut Vec<Seen>, kept: &mut Option<(CommandId, Vec<u8>, CString)>, event: &Event<'_>) {
        let ended = match event {
            Event::Answered(reply) => Some(reply.id()),
            Event::Unanswered(id) | Event::Withdrawn(id) => Some(*id),
            _ => None,
        };
        if kept.as_ref().is_some_and(|(id, ..)| Some(*id) == ended) {
            *kept = None;
        }
        seen.push(Seen::of(event));
    }

    fn receive(&mut self, bytes: &[u8]) {
        assert_eq!(unsafe { wsg_receive(self.c.as_mut_ptr(), self.now, bytes.as_ptr(), bytes.len()) }, 0);
        let now = Instant::from_millis(self.now);
        if !bytes.is_empty() {
            self.received_at = now;
        }
        let mut handle = |found: wsg_protocol::Event<'_>| {
            if let Some(event) = self.session.handle(now, &found) {
                Self::note(&mut self.seen, &mut self.kept, &event);
            }
        };
        // Byte by byte, unlike the library.
        for byte in bytes {
            if let Some(found) = self.parser.push(*byte) {
                handle(found);
            }
            while let Some(found) = self.parser.poll() {
                handle(found);
            }
        }
    }

    fn expire(&mut self) {
        let now = Instant::from_millis(self.now);
        while let Some(found) = self.parser.expire() {
            if let Some(event) = self.session.handle(now, &found) {
                Self::note(&mut self.seen, &mut self.kept, &event);
            }
        }
    }

    fn tick(&mut self) {
        assert_eq!(unsafe { wsg_tick(self.c.as_mut_ptr(), self.now) }, 0);
        let now = Instant::from_millis(self.now);
        if self.parser.is_mid_frame() && now.since(self.received_at) >= self.frame_timeout_ms {
            self.expire();
        }
        while let Some(event) = self.session.tick(now) {
            Self::note(&mut self.seen, &mut self.kept, &event);
        }
    }

    fn transmit(&mut self) {
        loop {
            let kept = self.kept.as_ref();
            let needed = kept.map_or(0, |(_, bytes, _)| bytes.len() + 8).max(WSG_TRANSMIT_LEN);
            let mut buffer = vec![0xEE; needed];
            let short =
                unsafe { wsg_transmit(self.c.as_mut_ptr(), self.now, buffer.as_mut_ptr(), needed - 1) };
            assert_eq!(short, wsg_error::BufferTooSmall as i32);
            let length = unsafe { wsg_transmit(self.c.as_mut_ptr(), self.now, buffer.as_mut_ptr(), needed) };
            let kept =
                kept.map(|(id, bytes, _)| Command::decode(&Frame { id: id.code(), payload: bytes }).unwrap());
            let now = Instant::from_millis(self.now);
            let expected = self.session.poll_transmit_borrowed(now, kept).map(|command| {
                self.sent.push(command.id());
                FrameEncoder::new(command.id().code(), command).collect::<Vec<u8>>()
            });
            assert_eq!(buffer[..usize::try_from(length).unwrap()], expected.as_deref().unwrap_or(&[])[..]);
            if length == 0 {
                return;
            }
        }
    }

    /// Lets some time pass, often until just the next deadline.
    fn pass_time(&mut self, chance: &mut Chance) {
        let mut delay = MaybeUninit::uninit();
        let is_due = wsg_next_deadline(Some(unsafe { self.c.assume_init_ref() }), self.now, Some(&mut delay));
        let delay = unsafe { delay.assume_init() };
        let now = Instant::from_millis(self.now);
        let half = self.parser.is_mid_frame().then(|| self.received_at.plus(self.frame_timeout_ms));
        let due = [half, self.session.poll_timeout()].into_iter().flatten().reduce(Instant::earlier_of);
        assert_eq!(is_due == 1, due.is_some());
        assert_eq!(delay, due.map_or(u32::MAX, |due| due.since(now)));
        let passed = match chance.below(4) {
            0 => chance.below(5) as u32,
            1 => chance.below(1_000) as u32,
            _ if is_due == 1 => delay,
            _ => 1,
        };
        self.now = self.now.wrapping_add(passed);
    }

    /// Answers the commands sent last, so that sessions connect.
    fn answer(&mut self, chance: &mut Chance) {
        for id in std::mem::take(&mut self.sent) {
            let payload = if chance.one_in(6) { reply_to(chance, id) } else { success_of(chance, id) };
            let frame: Vec<u8> = FrameEncoder::new(id.code(), &payload[..]).collect();
            self.receive(&frame);
        }
    }

    fn something_received(chance: &mut Chance, sent: &[CommandId]) -> Vec<u8> {
        let any = CommandId::ALL[chance.below(CommandId::ALL.len())];
        let id = match sent.last() {
            Some(id) if chance.one_in(2) => *id,
            _ if chance.one_in(16) => CommandId::Unknown(0xB0),
            _ => any,
        };
        let payload = match chance.below(8) {
            0 => {
                let len = chance.below(80);
                chance.bytes(len)
            }
            1 => (chance.below(32) as u16).to_le_bytes().to_vec(),
            _ => reply_to(chance, id),
        };
        let mut frame: Vec<u8> = FrameEncoder::new(id.code(), &payload[..]).collect();
        match chance.below(10) {
            0 => frame.truncate(chance.below(frame.len())),
            1 => {
                let at = chance.below(frame.len());
                frame[at] ^= 1 << chance.below(8);
            }
            2 => {
                let noise = chance.below(12);
                frame.splice(0..0, chance.bytes(noise));
            }
            3 => {
                let twice = frame.clone();
                frame.extend(twice);
            }
            _ => {}
        }
        frame
    }

    fn request(&mut self, chance: &mut Chance) {
        let id = match chance.below(40) {
            0 => CommandId::Unknown(0xB0 + chance.below(3) as u8),
            at => CommandId::ALL[(at + chance.below(40)) % CommandId::ALL.len()],
        };
        let Some(command) = command(chance, id) else { return };
        self.requested.insert(id.code());
        let expected = match &command {
            Made::Own(command) if self.is_outside_limits(command) => wsg_error::OutOfLimits as i32,
            Made::Own(command) => code_of(self.session.request(*command)),
            Made::Kept(payload) => self.keep(id, payload),
        };
        let returned = self.issue(id, &command);
        assert_eq!(returned, expected, "{command:?}");
        // C reads the text or data until the final event; a rejected request leaves nothing.
    }

    fn is_outside_limits(&self, command: &Command<'_>) -> bool {
        let known = self.session.known();
        let Some(limits) = &known.limits else { return false };
        command.check().is_ok()
            && command.check_limits(limits, known.flags.unwrap_or_default(), known.width).is_err()
    }

    fn keep(&mut self, id: CommandId, payload: &[u8]) -> i32 {
        if payload.len() > 64 {
            return wsg_error::TooLong as i32;
        }
        let is_text =
            id != CommandId::SetDeviceTag || payload.iter().all(|letter| (b' '..=b'~').contains(letter));
        if self.kept.is_some() && is_text {
            return wsg_error::QueueFull as i32;
        }
        let decoded = match Command::decode(&Frame { id: id.code(), payload }) {
            Ok(decoded) => decoded,
            Err(error) => return code_of(Err(RequestError::Invalid(error))),
        };
        let code = code_of(self.session.request_borrowed(&decoded));
        if code == 0 {
            let text = CString::new(payload).unwrap_or_default();
            self.kept = Some((id, payload.to_vec(), text));
        }
        code
    }

    /// Calls the function of this request.
    fn issue(&mut self, id: CommandId, made: &Made) -> i32 {
        // The payload must outlive the request: this is the copy of the reference, or one that is rejected anyway.
        let (kept, text) = match (made, &self.kept) {
            (Made::Kept(payload), Some((_, bytes, text))) if payload == bytes => {
                (bytes.as_ptr(), text.as_ptr())
            }
            (Made::Kept(payload), _) => {
                let text = Box::leak(Box::new(CString::new(payload.clone()).unwrap_or_default()));
                (payload.as_ptr(), text.as_ptr())
            }
            _ => (ptr::null(), ptr::null()),
        };
        let wsg = Some(unsafe { self.c.assume_init_mut() });
        let command = match made {
            Made::Own(command) => *command,
            Made::Kept(payload) => {
                return unsafe {
                    match id {
                        CommandId::Loop => wsg_loop(wsg, kept, payload.len()),
                        CommandId::SetDeviceTag => wsg_set_device_tag(wsg, text),
                        _ => wsg_custom(wsg, id.code(), kept, payload.len()),
                    }
                };
            }
        };
        match command {
            Command::DisconnectAnnouncement => wsg_disconnect_announcement(wsg),
            Command::Homing { direction } => wsg_homing(wsg, direction.code()),
            Command::PrePosition { flags, width, speed } => wsg_pre_position(wsg, flags.bits(), width, speed),
            Command::Stop => wsg_stop(wsg),
            Command::FastStop => wsg_fast_stop(wsg),
            Command::Acknowledge { .. } => wsg_acknowledge(wsg),
            Command::GripPart { width, speed } => wsg_grip_part(wsg, width, speed),
            Command::ReleasePart { width, speed } => wsg_release_part(wsg, width, speed),
            Command::SetAcceleration { acceleration } => wsg_set_acceleration(wsg, acceleration),
            Command::GetAcceleration => wsg_get_acceleration(wsg),
            Command::SetForceLimit { force } => wsg_set_force_limit(wsg, force),
            Command::GetForceLimit => wsg_get_force_limit(wsg),
            Command::SetSoftLimits { limits } => wsg_set_soft_limits(wsg, limits.minus, limits.plus),
            Command::GetSoftLimits => wsg_get_soft_limits(wsg),
            Command::ClearSoftLimits => wsg_clear_soft_limits(wsg),
            Command::OverdriveMode { enabled } => wsg_overdrive_mode(wsg, enabled.into()),
            Command::TareForceSensor => wsg_tare_force_sensor(wsg),
            Command::GetSystemState { .. } => wsg_get_system_state(wsg),
            Command::GetGripperState { .. } => wsg_get_gripper_state(wsg),
            Command::GetGrippingStatistics { reset } => wsg_get_gripping_statistics(wsg, reset.into()),
            Command::GetOpeningWidth { .. } => wsg_get_opening_width(wsg),
            Command::GetSpeed { .. } => wsg_get_speed(wsg),
            Command::GetForce { .. } => wsg_get_force(wsg),
            Command::GetTemperature => wsg_get_temperature(wsg),
            Command::GetSystemInfo => wsg_get_system_info(wsg),
            Command::GetDeviceTag => wsg_get_device_tag(wsg),
            Command::GetSystemLimits => wsg_get_system_limits(wsg),
            Command::GetFinger1Info => wsg_get_finger_info(wsg, 1),
            Command::GetFinger1Flags => wsg_get_finger_flags(wsg, 1),
            Command::Finger1Power { enabled } => wsg_finger_power(wsg, 1, enabled.into()),
            Command::GetFinger1Data => wsg_get_finger_data(wsg, 1),
            Command::GetFinger2Info => wsg_get_finger_info(wsg, 2),
            Command::GetFinger2Flags => wsg_get_finger_flags(wsg, 2),
            Command::Finger2Power { enabled } => wsg_finger_power(wsg, 2, enabled.into()),
            Command::GetFinger2Data => wsg_get_finger_data(wsg, 2),
            Command::Loop { .. } | Command::SetDeviceTag { .. } | Command::Unknown { .. } => unreachable!(),
        }
    }

    fn subscribe(&mut self, chance: &mut Chance) {
        let topic = Topic::ALL[chance.below(5)];
        let (period, on_change) = ([0, 9, 10, 500][chance.below(4)], chance.below(2) as u8);
        let subscribed = wsg_subscribe(self.c(), topic.id().code(), period, on_change);
        if period == 9 {
            assert_eq!(subscribed, wsg_error::Argument as i32);
            return;
        }
        assert_eq!(subscribed, 0);
        let mut flags = UpdateFlags::AUTOMATIC;
        flags.set(UpdateFlags::ON_CHANGE, on_change == 1);
        let update = AutoUpdate { flags, period_ms: period };
        self.session.subscribe(topic, if period == 0 { AutoUpdate::once() } else { update });
    }

    fn compare(&mut self) {
        assert_eq!(*self.c_seen, self.seen);
        self.c_seen.clear();
        self.seen.clear();
        let (mut known, mut counters) = (MaybeUninit::uninit(), MaybeUninit::uninit());
        let c = unsafe { self.c.assume_init_ref() };
        assert_eq!(
            (wsg_known(Some(c), Some(&mut known)), wsg_counters(Some(c), Some(&mut counters))),
            (0, 0)
        );
        let (known, counters) = unsafe { (known.assume_init(), counters.assume_init()) };
        let (line, session) = (self.parser.counters(), self.session.counters());
        assert_eq!(
            [line.dropped, line.bad_checksum, line.oversize, session.unsolicited, session.refused],
            [
                counters.dropped,
                counters.bad_checksum,
                counters.oversize,
                counters.unsolicited,
                counters.refused
            ]
        );
        assert_eq!([session.repeated, session.disconnects], [counters.repeated, counters.disconnects]);
        let its = self.session.known();
        let valid = |bit: u8, is_known: bool| assert_eq!(known.valid & bit != 0, is_known);
        valid(WSG_KNOWN_INFO, its.info.is_some());
        valid(WSG_KNOWN_LIMITS, its.limits.is_some());
        valid(WSG_KNOWN_FLAGS, its.flags.is_some());
        valid(WSG_KNOWN_STATE, its.state.is_some());
        let number = |bit: u8, value: f32| (known.valid & bit != 0).then_some(value);
        assert_eq!(
            [its.width, its.speed, its.force, its.force_limit],
            [
                number(WSG_KNOWN_WIDTH, known.width),
                number(WSG_KNOWN_SPEED, known.speed),
                number(WSG_KNOWN_FORCE, known.force),
                number(WSG_KNOWN_FORCE_LIMIT, known.force_limit),
            ]
        );
        assert_eq!(known.flags, its.flags.map_or(0, |flags| flags.bits()));
        assert_eq!(known.state, its.state.map_or(0, |state| state.code()));
        assert_eq!(known.info.serial_number, its.info.map_or(0, |info| info.serial_number));
        assert_eq!(known.limits.stroke, its.limits.map_or(0.0, |limits| limits.stroke));
        assert_eq!(known.connected == 1, self.session.is_connected());
        assert_eq!(known.busy == 1, self.session.is_busy());
        assert_eq!(known.motion, self.session.motion().map_or(0, CommandId::code));
        assert_eq!(known.fast_stop_pending == 1, self.session.fast_stop_pending());
    }
}

/// A request with its own values, or with a payload that the caller keeps.
#[derive(Debug)]
enum Made {
    Own(Command<'static>),
    Kept(Vec<u8>),
}

fn command(chance: &mut Chance, id: CommandId) -> Option<Made> {
    let (first, second) = (chance.number(), chance.number());
    let own = match id {
        CommandId::Loop | CommandId::Unknown(_) => {
            let len = chance.below(70);
            return Some(Made::Kept(chance.bytes(len)));
        }
        CommandId::SetDeviceTag => {
            let len = chance.below(70);
            let letter =
                |chance: &mut Chance| if chance.one_in(200) { 7 } else { b' ' + chance.below(90) as u8 };
            return Some(Made::Kept((0..len).map(|_| letter(chance)).collect()));
        }
        CommandId::PrePosition => Command::PrePosition {
            flags: wsg_protocol::PrePositionFlags::from_bits(chance.below(4) as u8).unwrap(),
            width: first,
            speed: second,
        },
        CommandId::GripPart => Command::GripPart { width: first, speed: second },
        CommandId::ReleasePart => Command::ReleasePart { width: first, speed: second },
        CommandId::SetAcceleration => Command::SetAcceleration { acceleration: first },
        CommandId::SetForceLimit => Command::SetForceLimit { force: first },
        CommandId::SetSoftLimits => {
            Command::SetSoftLimits { limits: wsg_protocol::SoftLimits { minus: first, plus: second } }
        }
        CommandId::GetSystemState => Command::GetSystemState { update: AutoUpdate::once() },
        CommandId::GetGripperState => Command::GetGripperState { update: AutoUpdate::once() },
        CommandId::GetOpeningWidth => Command::GetOpeningWidth { update: AutoUpdate::once() },
        CommandId::GetSpeed => Command::GetSpeed { update: AutoUpdate::once() },
        CommandId::GetForce => Command::GetForce { update: AutoUpdate::once() },
        CommandId::Acknowledge => Command::ACKNOWLEDGE,
        CommandId::Homing => {
            Command::Homing { direction: wsg_protocol::HomingDirection::ALL[chance.below(3)] }
        }
        CommandId::OverdriveMode => Command::OverdriveMode { enabled: chance.one_in(2) },
        CommandId::GetGrippingStatistics => Command::GetGrippingStatistics { reset: chance.one_in(2) },
        CommandId::Finger1Power => Command::Finger1Power { enabled: chance.one_in(2) },
        CommandId::Finger2Power => Command::Finger2Power { enabled: chance.one_in(2) },
        // Without parameters.
        id => match Command::decode(&Frame { id: id.code(), payload: &[] }).ok()? {
            Command::Stop => Command::Stop,
            Command::FastStop if chance.one_in(4) => Command::FastStop,
            Command::FastStop => return None,
            Command::DisconnectAnnouncement => Command::DisconnectAnnouncement,
            Command::GetAcceleration => Command::GetAcceleration,
            Command::GetForceLimit => Command::GetForceLimit,
            Command::GetSoftLimits => Command::GetSoftLimits,
            Command::ClearSoftLimits => Command::ClearSoftLimits,
            Command::TareForceSensor => Command::TareForceSensor,
            Command::GetTemperature => Command::GetTemperature,
            Command::GetSystemInfo => Command::GetSystemInfo,
            Command::GetDeviceTag => Command::GetDeviceTag,
            Command::GetSystemLimits => Command::GetSystemLimits,
            Command::GetFinger1Info => Command::GetFinger1Info,
            Command::GetFinger1Flags => Command::GetFinger1Flags,
            Command::GetFinger1Data => Command::GetFinger1Data,
            Command::GetFinger2Info => Command::GetFinger2Info,
            Command::GetFinger2Flags => Command::GetFinger2Flags,
            Command::GetFinger2Data => Command::GetFinger2Data,
            other => panic!("{other:?} has parameters"),
        },
    };
    Some(Made::Own(own))
}

/// A reply that a gripper may give.
fn reply_to(chance: &mut Chance, id: CommandId) -> Vec<u8> {
    let statuses = if chance.one_in(2) { id.immediate_statuses() } else { id.completion_statuses() };
    let status = match chance.below(4) {
        0 if !statuses.is_empty() => statuses[chance.below(statuses.len())],
        _ if !id.completion_statuses().is_empty() && chance.one_in(2) => Status::CmdPending,
        _ => Status::Success,
    };
    if status == Status::Success { success_of(chance, id) } else { status.code().to_le_bytes().to_vec() }
}

/// A reply with E_SUCCESS and a value.
fn success_of(chance: &mut Chance, id: CommandId) -> Vec<u8> {
    if id == CommandId::GetSystemLimits {
        // So that some requests are inside the limits, and some are not.
        let limits: [f32; 8] = [200.0, 10.0, 250.0, 10.0, 250.0, 10.0, 80.0, 200.0];
        return [0u8; 2].into_iter().chain(limits.into_iter().flat_map(f32::to_le_bytes)).collect();
    }
    // The length of a value that decodes, by trial.
    for len in [0, 4, 1, 8, 2, 32, 3] {
        let mut payload = vec![0; 2];
        payload.extend(chance.bytes(len));
        // Finite floats.
        for float in payload[2..].chunks_exact_mut(4) {
            float[3] &= 0x3F;
        }
        if id == CommandId::GetGripperState && len == 1 {
            payload[2] %= 8;
        }
        let Ok(reply) = Reply::decode(&Frame { id: id.code(), payload: &payload }) else { continue };
        let is_run = matches!(
            reply.value(),
            Some(
                Value::Loop(_) | Value::GetFinger1Data(_) | Value::GetFinger2Data(_) | Value::Unknown { .. }
            )
        );
        if is_run {
            let len = chance.below(65);
            payload.extend(chance.bytes(len));
        }
        return payload;
    }
    panic!("no reply to {id}");
}

/// The documented code of a request's result.
fn code_of(result: Result<(), RequestError>) -> i32 {
    let Err(error) = result else { return 0 };
    let error = match error {
        RequestError::NotConnected => wsg_error::NotConnected,
        RequestError::MotionRunning => wsg_error::MotionRunning,
        RequestError::FastStopRunning => wsg_error::FastStopRunning,
        RequestError::QueueFull => wsg_error::QueueFull,
        RequestError::Invalid(DecodeError::NotFinite) => wsg_error::NotFinite,
        RequestError::Invalid(DecodeError::Character) => wsg_error::Character,
        other => panic!("{other:?}"),
    };
    error as i32
}

#[test]
fn c_and_rust_agree_on_random_scripts() {
    let scripts = if std::env::var_os("WSG_WHOLE").is_some() { WHOLE } else { SCRIPTS };
    let (mut requested, mut kinds, mut connected) = (BTreeSet::new(), BTreeSet::new(), 0);
    for script in 1..=scripts {
        let mut chance = Chance(script.wrapping_mul(0x9E37_79B9_7F4A_7C15));
        let mut pair = Pair::new(&mut chance);
        let bring_up = chance.one_in(8);
        for step in 0..STEPS {
            // Most scripts connect first.
            if !bring_up && step < 12 && !pair.session.is_connected() {
                pair.answer(&mut chance);
                pair.tick();
                pair.transmit();
            }
            pair.step(&mut chance);
            kinds.extend(pair.session.motion().map(CommandId::code));
        }
        connected += u64::from(pair.session.is_connected());
        requested.append(&mut pair.requested);
    }
    println!("{scripts} scripts of {STEPS} steps, {connected} connected at the end");
    // The scripts reach what they are to compare.
    assert!(connected > scripts / 4, "{connected}");
    let missing: Vec<_> = CommandId::ALL.iter().filter(|id| !requested.contains(&id.code())).collect();
    assert!(missing.is_empty(), "{missing:?}");
    assert!(kinds.contains(&CommandId::GripPart.code()) && kinds.contains(&0xB0), "{kinds:?}");
}
