//! Master and device exchange frames in virtual time.

use super::*;
use bus_slcan::ClassicFrame;
use embedded_can::{ExtendedId, Frame, Id, StandardId};
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const NODE: u16 = 0x10;
const MASTER: u16 = 0x7F;
const CONFIG: Config<2> = Config {
    node: 0x10,
    master: 0x7F,
    heartbeat_ms: 500,
    emergency_inhibit: 0,
    inhibit: [20, 205],
    event_ms: [100, 0],
};
/// Time-out for the master in milliseconds.
const TIME_MS: u16 = 300;
const STOP: u8 = 0x80;
const NAME: &str = "A device with a name";

const GENERIC: u8 = 1;
const COMMUNICATION: u8 = 1 << 4;
const FAULTS: [Fault; 6] = [
    Fault { code: 0xFF01, register: 1 << 7, cause: Cause::Application },
    Fault { code: 0x8130, register: COMMUNICATION, cause: Cause::MasterSilent },
    Fault { code: 0x8140, register: COMMUNICATION, cause: Cause::BusOff },
    Fault { code: 0x8210, register: COMMUNICATION, cause: Cause::PdoLength },
    Fault { code: 0x4210, register: 1 << 3, cause: Cause::Application },
    Fault { code: 0x1000, register: GENERIC, cause: Cause::Application },
];
static PROFILE: Profile<2, 2> = Profile {
    rpdos: [Rpdo { len: 8, keep: [STOP, 0, 0, 0, 0, 0, 0, 0] }, Rpdo { len: 2, keep: [0; 8] }],
    tpdos: [8, 4],
    faults: &FAULTS,
};

#[derive(Clone, Copy, Debug, PartialEq)]
enum Key {
    Byte,
    Word,
    Locked,
    Broken,
    Slow,
    Name,
    Image,
}

const fn object(index: u16, sub: u8, kind: DataType, writable: bool, source: Source<Key>) -> Object<Key> {
    Object { index, sub, kind, writable, mappable: false, name: "", record: "", source }
}

const OBJECTS: [Object<Key>; 42] = {
    use DataType::{Domain, I16, Text, U8, U16, U32};
    use Pdo::{Receive, Transmit};
    use Source as S;
    [
        object(0x1000, 0, U32, false, S::Fixed(0x0102_0304)),
        object(0x1001, 0, U8, false, S::ErrorRegister),
        object(0x1003, 0, U8, true, S::ErrorCount),
        object(0x1003, 1, U32, false, S::PastError(0)),
        object(0x1003, 2, U32, false, S::PastError(1)),
        object(0x1003, 8, U32, false, S::PastError(7)),
        object(0x1008, 0, Text, false, S::Application(Key::Name)),
        object(0x1014, 0, U32, true, S::PlusNode(0x80)),
        object(0x1015, 0, U16, true, S::EmergencyInhibitTime),
        object(0x1016, 0, U8, false, S::Fixed(1)),
        object(0x1016, 1, U32, true, S::ConsumerHeartbeat),
        object(0x1017, 0, U16, true, S::ProducerHeartbeat),
        object(0x1018, 3, U32, false, S::Fixed(1 << 16)),
        object(0x1029, 1, U8, true, S::ErrorBehaviour),
        object(0x1400, 1, U32, true, S::CobId(Receive(0))),
        object(0x1400, 2, U8, true, S::TransmissionType(Receive(0))),
        object(0x1401, 1, U32, true, S::CobId(Receive(1))),
        object(0x1401, 2, U8, true, S::TransmissionType(Receive(1))),
        object(0x1402, 1, U32, true, S::CobId(Receive(2))),
        object(0x1600, 0, U8, true, S::Mapped(Receive(0), 2)),
        object(0x1600, 1, U32, true, S::Mapping(0x2000_0108)),
        object(0x1800, 1, U32, true, S::CobId(Transmit(0))),
        object(0x1800, 2, U8, true, S::TransmissionType(Transmit(0))),
        object(0x1800, 3, U16, true, S::InhibitTime(0)),
        object(0x1800, 5, U16, true, S::EventTimer(0)),
        object(0x1801, 1, U32, true, S::CobId(Transmit(1))),
        object(0x1801, 2, U8, true, S::TransmissionType(Transmit(1))),
        object(0x1801, 3, U16, true, S::InhibitTime(1)),
        object(0x1801, 5, U16, true, S::EventTimer(1)),
        object(0x1802, 3, U16, true, S::InhibitTime(2)),
        object(0x1A00, 0, U8, true, S::Mapped(Transmit(0), 3)),
        object(0x1F50, 1, Domain, true, S::Application(Key::Image)),
        object(0x2000, 0, U8, true, S::Fixed(2)),
        object(0x2000, 1, U8, true, S::Rpdo { number: 0, at: 0 }),
        object(0x2000, 2, I16, false, S::Rpdo { number: 0, at: 6 }),
        object(0x2001, 1, U32, true, S::Tpdo { number: 0, at: 2 }),
        object(0x2001, 2, U16, false, S::Tpdo { number: 1, at: 2 }),
        object(0x2002, 1, U8, true, S::Application(Key::Byte)),
        object(0x2002, 2, U16, true, S::Application(Key::Word)),
        object(0x2002, 3, U16, true, S::Application(Key::Locked)),
        object(0x2002, 4, U16, false, S::Application(Key::Broken)),
        object(0x2002, 5, U16, true, S::Application(Key::Slow)),
    ]
};
const ENTRIES: [Entry<Key>; OBJECTS.len()] = entries(&OBJECTS);

struct Application {
    byte: u32,
    word: u32,
    time_ms: u16,
    name: &'static str,
    /// Outcome of a write to the slow object and to the domain.
    outcome: Option<Result<(), Abort>>,
    /// Size and bytes of the domain, and whether it is complete.
    image: (Option<u32>, Vec<u8>, bool),
}

impl Dictionary for Application {
    type Key = Key;

    fn find(&self, index: u16, sub: u8) -> Result<Entry<Key>, Abort> {
        find(&ENTRIES, index, sub)
    }

    fn read(&self, key: Key) -> Result<u32, Abort> {
        match key {
            Key::Byte => Ok(self.byte),
            Key::Word => Ok(self.word),
            Key::Locked => Ok(7),
            Key::Broken | Key::Slow | Key::Name | Key::Image => Err(Abort::DeviceState),
        }
    }

    fn text(&self, key: Key) -> Result<&'static str, Abort> {
        if key == Key::Name { Ok(self.name) } else { Err(Abort::NoData) }
    }

    fn begin_domain(&mut self, _: Key, size: Option<u32>) -> Result<(), Abort> {
        self.image = (size, vec![], false);
        Ok(())
    }

    fn write_domain(&mut self, _: Key, bytes: &[u8], is_last: bool) -> Result<(), Abort> {
        self.image.1.extend(bytes);
        self.image.2 = is_last;
        Ok(())
    }

    fn write(&mut self, key: Key, value: u32) -> Result<(), Abort> {
        match key {
            Key::Byte => self.byte = value,
            Key::Word => self.word = value,
            Key::Slow => {}
            Key::Locked | Key::Broken | Key::Name | Key::Image => return Err(Abort::DeviceState),
        }
        Ok(())
    }

    fn outcome(&self, key: Key) -> Option<Result<(), Abort>> {
        if matches!(key, Key::Slow | Key::Image) { self.outcome } else { Some(Ok(())) }
    }

    fn consumer_time_ms(&self) -> u16 {
        self.time_ms
    }

    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort> {
        if time_ms > 10_000 {
            return Err(Abort::Value);
        }
        self.time_ms = time_ms;
        Ok(())
    }
}

/// A device on a bus with its master.
struct Bus {
    device: Device<2, 2, 4>,
    application: Application,
    now_ms: u32,
    events: Vec<Event>,
    /// Frames sent by the device: time, identifier and data.
    sent: Vec<(u32, u16, Vec<u8>)>,
}

impl Bus {
    fn new() -> Self {
        let (outcome, image) = (None, (None, vec![], false));
        let application = Application { byte: 0, word: 0, time_ms: TIME_MS, name: NAME, outcome, image };
        // Shortly before the clock wraps.
        let now_ms = u32::MAX - 50;
        Self { device: Device::new(&PROFILE, CONFIG), application, now_ms, events: vec![], sent: vec![] }
    }

    /// Creates a device that has booted and been started.
    fn operational() -> Self {
        let mut bus = Self::new();
        bus.turn();
        bus.nmt(0x01);
        assert_eq!(bus.device.state(), NmtState::Operational);
        bus.events.clear();
        bus.sent.clear();
        bus
    }

    fn deliver(&mut self, id: u16, data: &[u8]) {
        let frame = ClassicFrame::new(StandardId::new(id).unwrap(), data).unwrap();
        self.device.on_frame(self.now_ms, &frame);
    }

    fn turn(&mut self) {
        while let Some(event) = self.device.poll_event(self.now_ms, &mut self.application) {
            self.events.push(event);
        }
        self.transmit();
    }

    fn transmit(&mut self) {
        while let Some(frame) = self.device.poll_transmit::<ClassicFrame>(self.now_ms) {
            let Id::Standard(id) = frame.id() else { panic!("{frame:?}") };
            assert!(self.device.sends(frame.id()));
            self.sent.push((self.now_ms, id.as_raw(), frame.data().to_vec()));
        }
    }

    fn pass(&mut self, ms: u32) {
        for _ in 0..ms {
            self.now_ms = self.now_ms.wrapping_add(1);
            self.turn();
        }
    }

    /// Passes whole days, with one turn each.
    fn pass_days(&mut self, days: u32) {
        for _ in 0..days {
            self.now_ms = self.now_ms.wrapping_add(24 * 60 * 60 * 1_000);
            self.turn();
        }
    }

    fn nmt(&mut self, specifier: u8) {
        self.deliver(0x000, &[specifier, NODE as u8]);
        self.turn();
    }

    /// Returns the frames sent on this identifier since the last call.
    fn take(&mut self, base: u16) -> Vec<Vec<u8>> {
        self.take_timed(base).into_iter().map(|(_, data)| data).collect()
    }

    fn take_timed(&mut self, base: u16) -> Vec<(u32, Vec<u8>)> {
        let (found, rest) =
            core::mem::take(&mut self.sent).into_iter().partition(|(_, id, _)| *id == base | NODE);
        self.sent = rest;
        let found: Vec<(u32, u16, Vec<u8>)> = found;
        found.into_iter().map(|(at, _, data)| (at, data)).collect()
    }

    fn sdo(&mut self, request: [u8; 8]) -> Vec<Vec<u8>> {
        self.deliver(0x600 | NODE, &request);
        self.turn();
        self.take(0x580)
    }

    fn upload(&mut self, index: u16, sub: u8) -> Result<Vec<u8>, u32> {
        let [low, high] = index.to_le_bytes();
        let answers = self.sdo([0x40, low, high, sub, 0, 0, 0, 0]);
        let [answer] = &answers[..] else { panic!("{answers:?}") };
        assert_eq!(answer[1..4], [low, high, sub]);
        match answer[0] {
            0x80 => Err(u32::from_le_bytes(answer[4..].try_into().unwrap())),
            specifier => {
                let unused = usize::from(specifier >> 2 & 3);
                assert_eq!(specifier & !0b1100, 0x43);
                assert!(answer[8 - unused..].iter().all(|byte| *byte == 0));
                Ok(answer[4..8 - unused].to_vec())
            }
        }
    }

    fn download(&mut self, index: u16, sub: u8, value: &[u8]) -> Result<(), u32> {
        let specifier = 0x23 | (4 - value.len() as u8) << 2;
        self.download_by(specifier, index, sub, value)
    }

    fn download_by(&mut self, specifier: u8, index: u16, sub: u8, value: &[u8]) -> Result<(), u32> {
        let [low, high] = index.to_le_bytes();
        let mut request = [specifier, low, high, sub, 0xEE, 0xEE, 0xEE, 0xEE];
        request[4..4 + value.len()].copy_from_slice(value);
        let answers = self.sdo(request);
        let [answer] = &answers[..] else { panic!("{answers:?}") };
        assert_eq!(answer[1..4], [low, high, sub]);
        match answer[0] {
            0x60 => {
                assert_eq!(answer[4..], [0; 4]);
                Ok(())
            }
            0x80 => Err(u32::from_le_bytes(answer[4..].try_into().unwrap())),
            other => panic!("{other:02X}"),
        }
    }

    fn show_faults(&mut self, present: u16) {
        self.device.show_faults(present, [1, 2, 3, 4, 5]);
        self.turn();
    }
}

fn rpdo(number: u8, data: [u8; 8]) -> Event {
    Event::Rpdo { number, data }
}

/// An SDO request that did not write an application value.
const READ: Event = Event::Sdo { written: false };
const LEFT: Event = Event::Left { master_silent: false };
const SILENT: Event = Event::Left { master_silent: true };

#[test]
fn device_sends_boot_up_and_heartbeats() {
    let mut bus = Bus::new();
    assert_eq!(bus.device.state(), NmtState::Initialising);
    bus.turn();
    assert_eq!(bus.device.state(), NmtState::PreOperational);
    bus.pass(1_000);
    let beats = bus.take_timed(0x700);
    let data: Vec<&[u8]> = beats.iter().map(|(_, data)| &data[..]).collect();
    assert_eq!(data, [&[0][..], &[127], &[127]]);
    assert!(beats.windows(2).all(|two| two[1].0.wrapping_sub(two[0].0) == 500));
    assert!(bus.sent.is_empty(), "no other frames: {:?}", bus.sent);
}

#[test]
fn nmt_commands_change_the_state() {
    let mut bus = Bus::new();
    bus.turn();
    for (specifier, state) in [
        (0x01, NmtState::Operational),
        (0x02, NmtState::Stopped),
        (0x80, NmtState::PreOperational),
        (0x01, NmtState::Operational),
        (0x80, NmtState::PreOperational),
        (0x02, NmtState::Stopped),
        (0x01, NmtState::Operational),
        (0x33, NmtState::Operational),
    ] {
        bus.nmt(specifier);
        assert_eq!(bus.device.state(), state, "{specifier:02X}h");
    }
    assert_eq!(bus.events, [LEFT, LEFT], "only when operation ended");
}

#[test]
fn invalid_nmt_commands_change_nothing() {
    let mut bus = Bus::new();
    bus.turn();
    for data in [&[0x01, 0x11][..], &[0x01], &[], &[0x01, 0x10, 0]] {
        bus.deliver(0x000, data);
    }
    let extended = ClassicFrame::new(ExtendedId::ZERO, &[0x01, 0x10]).unwrap();
    bus.device.on_frame(bus.now_ms, &extended);
    let remote = ClassicFrame::new_remote(StandardId::ZERO, 2).unwrap();
    bus.device.on_frame(bus.now_ms, &remote);
    assert_eq!(bus.device.state(), NmtState::PreOperational);
    bus.deliver(0x000, &[0x01, 0]);
    assert_eq!(bus.device.state(), NmtState::Operational, "command to all nodes");
}

#[test]
fn rpdos_of_the_right_length_are_events_only_in_operation() {
    let mut bus = Bus::new();
    bus.turn();
    for specifier in [0x80, 0x02] {
        bus.nmt(specifier);
        bus.deliver(0x210, &[1; 8]);
        bus.turn();
        assert_eq!(bus.events, [], "{specifier:02X}h");
    }
    bus.nmt(0x01);
    bus.deliver(0x210, &[1, 2, 3, 4, 5, 6, 7, 8]);
    bus.deliver(0x310, &[9, 10]);
    bus.deliver(0x410, &[9, 10]);
    bus.deliver(0x211, &[9; 8]);
    bus.deliver(0x110, &[9; 8]);
    bus.turn();
    let expected = [rpdo(0, [1, 2, 3, 4, 5, 6, 7, 8]), rpdo(1, [9, 10, 0, 0, 0, 0, 0, 0])];
    assert_eq!(bus.events, expected);
    assert_eq!(bus.take(0x080), Vec::<Vec<u8>>::new());
    for (id, len) in (0..8).map(|len| (0x210, len)).chain([(0x310, 3)]) {
        bus.deliver(id, &vec![1; len]);
        bus.turn();
        assert_eq!(bus.events, expected, "{len} bytes are rejected");
        let reported = [[0x10, 0x82, COMMUNICATION | GENERIC, 0, 0, 0, 0, 0], [0; 8]];
        assert_eq!(bus.take(0x080), reported, "reported once, then cleared");
        bus.turn();
        assert_eq!(bus.take(0x080), Vec::<Vec<u8>>::new());
    }
}

#[test]
fn events_beyond_the_queue_are_lost_except_kept_rpdo_bits() {
    let mut bus = Bus::operational();
    for byte in [1, 2, 3, STOP | 4, 5, 6] {
        bus.deliver(0x210, &[byte; 8]);
    }
    bus.deliver(0x310, &[7; 2]);
    bus.nmt(0x80);
    let kept = [STOP | 6, 6, 6, 6, 6, 6, 6, 6];
    assert_eq!(bus.events, [rpdo(0, [1; 8]), rpdo(0, [2; 8]), rpdo(0, [3; 8]), rpdo(0, kept)]);
}

#[test]
fn kept_bits_survive_a_repeated_rpdo() {
    let mut bus = Bus::operational();
    for byte in [1, 2, 3, STOP, STOP] {
        bus.deliver(0x210, &[byte; 8]);
    }
    bus.turn();
    assert_eq!(bus.events.last(), Some(&rpdo(0, [STOP; 8])));
}

#[test]
fn tpdos_respect_inhibit_time_and_event_timer() {
    let mut bus = Bus::new();
    bus.turn();
    bus.device.show_tpdo(0, [1; 8]);
    bus.device.show_tpdo(1, [2; 8]);
    bus.device.show_tpdo(2, [3; 8]);
    bus.pass(300);
    bus.sent.clear();
    bus.nmt(0x01);
    assert_eq!((bus.take(0x180), bus.take(0x280)), (vec![vec![1; 8]], vec![vec![2; 4]]), "at the start");
    let start = bus.now_ms;
    bus.pass(1);
    for byte in 2..=22 {
        bus.device.show_tpdo(0, [byte; 8]);
        bus.device.show_tpdo(1, [byte; 8]);
        bus.pass(1);
    }
    // The event timer of TPDO1 starts again with the last transmission.
    let moments = |sent: Vec<(u32, Vec<u8>)>| -> Vec<u32> {
        sent.iter().map(|(at, _)| at.wrapping_sub(start)).collect()
    };
    assert_eq!(moments(bus.take_timed(0x180)), [2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22]);
    // 20.5 ms are rounded up to 21. The data had not changed before.
    assert_eq!(moments(bus.take_timed(0x280)), [21]);
    bus.pass(400);
    assert_eq!(moments(bus.take_timed(0x180)), [122, 222, 322, 422]);
    assert_eq!(moments(bus.take_timed(0x280)), [42], "the last change, without event timer");
    bus.nmt(0x01);
    assert_eq!(bus.take(0x180), Vec::<Vec<u8>>::new(), "a start in operation sends nothing");
}

/// Days after which a time before them seems to be in the future, on the clock that wraps.
const MANY_DAYS: u32 = 30;

#[test]
fn tpdo_without_event_timer_is_sent_on_change_after_many_days() {
    let mut bus = Bus::operational();
    bus.device.show_tpdo(1, [1; 8]);
    bus.pass(50);
    bus.pass_days(MANY_DAYS);
    bus.sent.clear();
    bus.device.show_tpdo(1, [2; 8]);
    bus.turn();
    assert_eq!(bus.take(0x280), [[2; 4]]);
}

#[test]
fn emergency_is_sent_after_many_days_without_one() {
    let mut bus = Bus::operational();
    bus.download(0x1015, 0, &[0x2C, 1]).unwrap();
    bus.show_faults(1);
    bus.pass_days(MANY_DAYS);
    bus.sent.clear();
    bus.show_faults(0);
    assert_eq!(bus.take(0x080).len(), 1);
}

#[test]
fn master_silent_for_many_days_is_silent_when_monitoring_begins() {
    let mut bus = Bus::operational();
    bus.application.time_ms = 0;
    bus.deliver(0x700 | MASTER, &[5]);
    bus.pass_days(MANY_DAYS);
    assert_eq!(bus.events, []);
    bus.application.time_ms = TIME_MS;
    bus.turn();
    assert_eq!(bus.events, [SILENT]);
}

#[test]
fn tpdos_and_heartbeat_are_repeated_after_lost_frames() {
    let mut bus = Bus::operational();
    bus.pass(10);
    bus.sent.clear();
    bus.device.frames_lost();
    bus.turn();
    assert_eq!((bus.take(0x180).len(), bus.take(0x280).len()), (1, 1));
    assert_eq!(bus.take(0x700), [[5]]);
}

#[test]
fn master_with_a_heartbeat_is_monitored_only_by_heartbeat() {
    let mut bus = Bus::operational();
    bus.pass(1_000);
    assert_eq!(bus.device.state(), NmtState::Operational, "monitoring has not started yet");
    bus.deliver(0x700 | MASTER, &[5]);
    bus.pass(u32::from(TIME_MS) - 1);
    bus.deliver(0x210, &[0; 8]);
    bus.deliver(0x701, &[5]);
    bus.deliver(0x700 | MASTER, &[5, 5]);
    bus.turn();
    assert_eq!(bus.events, [rpdo(0, [0; 8])]);
    bus.pass(1);
    assert_eq!(bus.events.last(), Some(&SILENT));
    assert_eq!(bus.device.state(), NmtState::PreOperational);
    bus.pass(1_000);
    assert_eq!(bus.events.len(), 2, "reported once");
}

#[test]
fn master_without_a_heartbeat_is_monitored_by_its_rpdos() {
    let mut bus = Bus::operational();
    for _ in 0..5 {
        bus.deliver(0x310, &[0; 2]);
        bus.pass(200);
    }
    assert!(!bus.events.contains(&SILENT));
    bus.pass(100);
    assert_eq!(bus.events.last(), Some(&SILENT));
}

#[test]
fn master_time_out_is_an_emergency_until_the_next_nmt_start() {
    let mut bus = Bus::operational();
    bus.deliver(0x700 | MASTER, &[5]);
    bus.pass(TIME_MS.into());
    bus.show_faults(0);
    assert_eq!(bus.take(0x080), [[0x30, 0x81, COMMUNICATION | GENERIC, 1, 2, 3, 4, 5]]);
    bus.nmt(0x01);
    bus.show_faults(0);
    assert_eq!(bus.take(0x080), [[0, 0, 0, 1, 2, 3, 4, 5]]);
}

#[test]
fn master_that_restarts_commands_no_more() {
    let mut bus = Bus::operational();
    bus.deliver(0x700 | MASTER, &[0]);
    bus.pass(100_000);
    assert_eq!((&bus.events[..], bus.device.state()), (&[][..], NmtState::Operational), "no master known");
    bus.deliver(0x210, &[0; 8]);
    bus.deliver(0x700 | MASTER, &[0]);
    bus.turn();
    assert_eq!(bus.events, [rpdo(0, [0; 8]), LEFT]);
    assert_eq!(bus.device.state(), NmtState::PreOperational);
    bus.pass(1_000);
    assert_eq!(bus.events.len(), 2, "no longer monitored");
}

#[test]
fn heartbeat_time_of_0_disables_the_heartbeat() {
    let mut bus = Bus::new();
    bus.turn();
    bus.take(0x700);
    bus.download(0x1017, 0, &[0, 0]).unwrap();
    bus.take(0x700);
    bus.pass(2_000);
    assert_eq!(bus.take(0x700), Vec::<Vec<u8>>::new());
}

#[test]
fn resets_restore_power_up_state_and_report_their_extent() {
    for (specifier, application) in [(0x81, true), (0x82, false)] {
        let mut bus = Bus::operational();
        bus.device.show_tpdo(0, [1; 8]);
        bus.deliver(0x210, &[1; 8]);
        bus.turn();
        bus.download(0x1017, 0, &[100, 0]).unwrap();
        bus.download(0x1016, 1, &[100, 0, 5, 0]).unwrap();
        bus.events.clear();
        bus.sent.clear();
        bus.nmt(specifier);
        assert_eq!(bus.events, [LEFT, Event::Reset { application }]);
        assert_eq!(bus.take(0x700), [[0]], "boot-up message");
        assert_eq!(bus.upload(0x1017, 0), Ok(vec![0xF4, 1]));
        assert_eq!(bus.upload(0x1016, 1), Ok(vec![100, 0, 0x7F, 0]), "time-out of the application is kept");
        assert_eq!(bus.upload(0x2000, 1), Ok(vec![0]));
        assert_eq!(bus.upload(0x2001, 1), Ok(vec![0; 4]));
    }
}

#[test]
fn only_another_reset_counts_before_the_boot_up_message() {
    let mut bus = Bus::operational();
    for specifier in [0x82, 0x01, 0x81] {
        bus.deliver(0x000, &[specifier, NODE as u8]);
    }
    bus.deliver(0x210, &[1; 8]);
    bus.turn();
    let resets = [Event::Reset { application: false }, Event::Reset { application: true }];
    assert_eq!(bus.events, [LEFT, resets[0], resets[1]]);
    assert_eq!(bus.device.state(), NmtState::PreOperational);
}

#[test]
fn lost_bus_ends_operation_and_is_reported_after_recovery() {
    let mut bus = Bus::operational();
    bus.deliver(0x600 | NODE, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    bus.device.bus_lost();
    bus.turn();
    assert_eq!((&bus.events[..], bus.device.state()), (&[LEFT][..], NmtState::PreOperational));
    assert_eq!(bus.take(0x580), Vec::<Vec<u8>>::new(), "pending response is discarded");
    bus.sent.clear();
    bus.deliver(0x600 | NODE, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    bus.device.bus_joined();
    bus.turn();
    assert_eq!(bus.sent.iter().map(|(_, id, _)| *id).collect::<Vec<_>>(), [0x090, 0x090, 0x710]);
    assert_eq!(bus.take(0x080), [[0x40, 0x81, COMMUNICATION | GENERIC, 0, 0, 0, 0, 0], [0; 8]]);
    bus.pass(100);
    assert_eq!(bus.take(0x080), Vec::<Vec<u8>>::new(), "reported once");
}

#[test]
fn lost_bus_outside_operation_is_no_event() {
    let mut bus = Bus::new();
    bus.turn();
    bus.nmt(0x02);
    bus.device.bus_lost();
    bus.turn();
    assert_eq!((&bus.events[..], bus.device.state()), (&[][..], NmtState::Stopped));
}

#[test]
fn faults_are_reported_in_table_order_and_then_cleared() {
    let mut bus = Bus::operational();
    // The application does not control the faults of bits 1 to 3.
    bus.show_faults(0b11111);
    assert_eq!(bus.upload(0x1001, 0), Ok(vec![1 << 7 | 1 << 3 | GENERIC]));
    let both = 1 << 7 | 1 << 3 | GENERIC;
    let reported = bus.take(0x080);
    assert_eq!(reported, [[0x01, 0xFF, both, 1, 2, 3, 4, 5], [0x10, 0x42, both, 1, 2, 3, 4, 5]]);
    bus.show_faults(0b11111);
    assert_eq!(bus.take(0x080), Vec::<Vec<u8>>::new(), "reported once");
    bus.show_faults(0b10000);
    assert_eq!(bus.take(0x080), [[0, 0, 1 << 3 | GENERIC, 1, 2, 3, 4, 5]]);
    bus.show_faults(0b00001);
    let reported = bus.take(0x080);
    assert_eq!(
        reported,
        [[0x01, 0xFF, 1 << 7 | GENERIC, 1, 2, 3, 4, 5], [0, 0, 1 << 7 | GENERIC, 1, 2, 3, 4, 5]]
    );
}

#[test]
fn register_bit_shared_by_two_faults_stays_set() {
    let mut bus = Bus::operational();
    bus.show_faults(1 << 5);
    assert_eq!(bus.take(0x080), [[0x00, 0x10, GENERIC, 1, 2, 3, 4, 5]]);
    bus.show_faults(0);
    bus.deliver(0x700 | MASTER, &[5]);
    bus.pass(TIME_MS.into());
    bus.show_faults(0);
    bus.take(0x080);
    // The master has timed out, and the bus was off.
    bus.device.bus_joined();
    bus.turn();
    assert_eq!(bus.take(0x080)[0], [0x40, 0x81, COMMUNICATION | GENERIC, 1, 2, 3, 4, 5]);
}

#[test]
fn stopped_device_defers_faults_until_started() {
    let mut bus = Bus::operational();
    bus.nmt(0x02);
    bus.show_faults(1);
    bus.deliver(0x600 | NODE, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    bus.pass(1_000);
    assert!(bus.sent.iter().all(|(_, id, data)| *id == 0x710 && data == &[4]), "{:?}", bus.sent);
    bus.sent.clear();
    bus.nmt(0x80);
    assert_eq!(bus.take(0x080).len(), 1);
    assert_eq!(bus.take(0x580), Vec::<Vec<u8>>::new(), "requests while stopped are ignored");
}

#[test]
fn frames_are_sent_in_order_of_priority() {
    let mut bus = Bus::operational();
    bus.device.frames_lost();
    bus.device.show_faults(1, [0; 5]);
    bus.deliver(0x600 | NODE, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    bus.turn();
    assert_eq!(
        bus.sent.iter().map(|(_, id, _)| *id).collect::<Vec<_>>(),
        [0x090, 0x590, 0x190, 0x290, 0x710]
    );
}

#[test]
fn objects_are_read_from_their_sources() {
    let mut bus = Bus::operational();
    bus.deliver(0x210, &[1, 2, 3, 4, 5, 6, 0xFE, 0xFF]);
    bus.device.show_tpdo(0, [1, 2, 3, 4, 5, 6, 7, 8]);
    bus.device.show_tpdo(1, [1, 2, 3, 4, 5, 6, 7, 8]);
    (bus.application.byte, bus.application.word) = (0xAB, 0x1234);
    bus.turn();
    for (index, sub, value) in [
        (0x1000, 0, &[4, 3, 2, 1][..]),
        (0x1001, 0, &[0]),
        (0x1014, 0, &[0x90, 0, 0, 0]),
        (0x1016, 0, &[1]),
        (0x1016, 1, &[0x2C, 1, 0x7F, 0]),
        (0x1017, 0, &[0xF4, 1]),
        (0x1800, 3, &[20, 0]),
        (0x1800, 5, &[100, 0]),
        (0x1801, 3, &[205, 0]),
        (0x1801, 5, &[0, 0]),
        (0x2000, 1, &[1]),
        (0x2000, 2, &[0xFE, 0xFF]),
        (0x2001, 1, &[3, 4, 5, 6]),
        (0x2001, 2, &[3, 4]),
        (0x2002, 1, &[0xAB]),
        (0x2002, 2, &[0x34, 0x12]),
    ] {
        assert_eq!(bus.upload(index, sub), Ok(value.to_vec()), "{index:04X}h, {sub}");
    }
}

#[test]
fn writable_objects_accept_writes() {
    let mut bus = Bus::operational();
    bus.download(0x2002, 1, &[0xCD]).unwrap();
    bus.download(0x2002, 2, &[0x78, 0x56]).unwrap();
    assert_eq!(
        (bus.application.byte, bus.application.word),
        (0xCD, 0x5678),
        "without bytes past their length"
    );
    // Without a size: the length of the object applies.
    bus.download_by(0x22, 0x2002, 2, &[1, 2, 3, 4]).unwrap();
    assert_eq!(bus.application.word, 0x0201);
    assert_eq!(bus.events, [Event::Sdo { written: true }; 3]);
    for (index, sub, value) in [(0x1017, 0, 50u16), (0x1800, 5, 11), (0x1801, 5, 13), (0x1015, 0, 100)] {
        bus.download(index, sub, &value.to_le_bytes()).unwrap();
        assert_eq!(bus.upload(index, sub), Ok(value.to_le_bytes().to_vec()), "{index:04X}h, {sub}");
    }
    assert_eq!(bus.events.len(), 3 + 2 * 4);
    assert!(bus.events[3..].iter().all(|event| *event == READ), "the device's own values");
    bus.pass(1);
    bus.sent.clear();
    bus.pass(200);
    assert_eq!(bus.take(0x700).len(), 4, "a heartbeat every 50 ms");
}

#[test]
fn consumer_heartbeat_object_changes_master_and_time_out() {
    let mut bus = Bus::operational();
    bus.deliver(0x700 | MASTER, &[5]);
    bus.download(0x1016, 1, &[100, 0, 5, 0]).unwrap();
    bus.pass(1_000);
    assert_eq!(bus.events, [READ], "the previous master is not monitored");
    bus.deliver(0x705, &[5]);
    bus.pass(100);
    assert_eq!(bus.events, [READ, SILENT]);
    for (value, abort) in
        [([100, 0, 128, 0], 0x0609_0030), ([100, 0, 5, 1], 0x0609_0030), ([0xFF, 0xFF, 5, 0], 0x0609_0030)]
    {
        assert_eq!(bus.download(0x1016, 1, &value), Err(abort), "{value:?}");
    }
    assert_eq!(bus.upload(0x1016, 1), Ok(vec![100, 0, 5, 0]));
}

#[test]
fn master_time_out_starts_with_the_request_that_changes_or_disables_it() {
    // The new time-out, or the one of the application for RPDOs.
    for (value, time_ms) in [([100, 0, MASTER as u8, 0], 100), ([0; 4], u32::from(TIME_MS))] {
        let mut bus = Bus::operational();
        bus.deliver(0x700 | MASTER, &[5]);
        bus.pass(200);
        bus.download(0x1016, 1, &value).unwrap();
        bus.pass(time_ms - 1);
        assert_eq!(bus.events, [READ], "{value:?}");
        bus.pass(1);
        assert_eq!(bus.events, [READ, SILENT], "{value:?}");
    }
}

#[test]
fn server_reports_abort_codes() {
    let mut bus = Bus::operational();
    assert_eq!(bus.upload(0x3000, 0), Err(0x0602_0000));
    assert_eq!(bus.upload(0x2002, 9), Err(0x0609_0011));
    assert_eq!(bus.upload(0x2002, 4), Err(0x0800_0022));
    assert_eq!(bus.download(0x3000, 0, &[0]), Err(0x0602_0000));
    assert_eq!(bus.download(0x1000, 0, &[0; 4]), Err(0x0601_0002));
    assert_eq!(bus.download(0x2002, 4, &[0; 2]), Err(0x0601_0002));
    assert_eq!(
        bus.download(0x2001, 1, &[0; 4]),
        Err(0x0601_0002),
        "a TPDO cannot be written, even if the table permits it"
    );
    assert_eq!(bus.download(0x2002, 2, &[0]), Err(0x0607_0010));
    assert_eq!(bus.download(0x2002, 3, &[0; 2]), Err(0x0800_0022));
    for specifier in [0x21, 0x00, 0x60, 0x70, 0xA0, 0xC0] {
        assert_eq!(bus.download_by(specifier, 0x2002, 2, &[0; 2]), Err(0x0504_0001), "{specifier:02X}h");
    }
    assert!(bus.events.iter().all(|event| *event == READ), "nothing was written");
}

#[test]
fn truncated_requests_and_client_aborts_get_no_response() {
    let mut bus = Bus::operational();
    bus.deliver(0x610, &[0x40, 0, 0x10, 0, 0, 0, 0]);
    bus.turn();
    assert_eq!(bus.take(0x580), Vec::<Vec<u8>>::new());
    assert_eq!(bus.sdo([0x80, 0, 0x10, 0, 0, 0, 0, 0]), Vec::<Vec<u8>>::new());
    // The later of two requests in one turn is served; a truncated one does not replace it.
    bus.deliver(0x610, &[0x40, 0, 0x10, 0, 0, 0, 0, 0]);
    bus.deliver(0x610, &[0x40, 0x17, 0x10, 0, 0, 0, 0, 0]);
    bus.deliver(0x610, &[0x40]);
    bus.turn();
    assert_eq!(bus.take(0x580), [[0x4B, 0x17, 0x10, 0, 0xF4, 1, 0, 0]]);
}

#[test]
fn identifiers_that_canopen_uses_are_reserved() {
    for id in [0, 0x080, 0x0FF, 0x100, 0x181, 0x57F, 0x581, 0x5FF, 0x601, 0x67F, 0x701, 0x77F, 0x7E4, 0x7E5] {
        assert!(is_reserved(id), "{id:03X}h");
    }
    for id in [1, 0x07F, 0x101, 0x180, 0x580, 0x600, 0x680, 0x700, 0x780, 0x7E3, 0x7E6, 0x7FF] {
        assert!(!is_reserved(id), "{id:03X}h");
    }
    let bus = Bus::new();
    let extended = Id::Extended(ExtendedId::new(NODE.into()).unwrap());
    assert!(!bus.device.sends(StandardId::new(0x191).unwrap().into()) && !bus.device.sends(extended));
}

#[test]
fn node_ids_are_1_to_127_and_differ() {
    assert!(CONFIG.is_valid());
    for (node, master) in [(1, 127), (127, 1)] {
        assert!(Config { node, master, ..CONFIG }.is_valid(), "{node} {master}");
    }
    for (node, master) in [(0, 1), (1, 0), (128, 1), (1, 128), (5, 5)] {
        assert!(!Config { node, master, ..CONFIG }.is_valid(), "{node} {master}");
    }
}

#[test]
fn data_types_have_the_standard_lengths_and_numbers() {
    let reported = [DataType::I16, DataType::U8, DataType::U16, DataType::U32, DataType::Text]
        .map(|kind| (kind.len(), kind.code()));
    assert_eq!(reported, [(2, 3), (1, 5), (2, 6), (4, 7), (0, 9)]);
}

#[test]
fn eds_file_matches_the_table() {
    let facts = EdsFacts {
        file_name: "test.eds",
        description: "Test",
        time: "12:00AM",
        date: "01-31-2026",
        author: "a",
        vendor: "v",
        product: "p",
        order_code: "o",
        kbit_rates: &[125, 1000],
    };
    let named = |index, sub, record, name| {
        let object = OBJECTS.iter().find(|object| (object.index, object.sub) == (index, sub)).unwrap();
        Object { record, name, ..*object }
    };
    let entries = [
        EdsEntry::new(named(0x1001, 0, "", "Error register")),
        EdsEntry::new(named(0x1003, 0, "Errors", "Number of errors")),
        EdsEntry {
            default: Some(EdsValue::Text(NAME)),
            ..EdsEntry::new(named(0x1008, 0, "", "Manufacturer device name"))
        },
        EdsEntry::new(named(0x1014, 0, "", "COB-ID EMCY")),
        EdsEntry::new(named(0x1015, 0, "", "Inhibit time EMCY")),
        EdsEntry::new(named(0x1016, 0, "Consumer heartbeat time", "Number of entries")),
        EdsEntry {
            default: Some(EdsValue::Number(0x7F_0000)),
            ..EdsEntry::new(named(0x1016, 1, "Consumer heartbeat time", "Master"))
        },
        EdsEntry::new(named(0x1017, 0, "", "Heartbeat time")),
        EdsEntry::new(named(0x1018, 3, "Identity", "Revision number")),
        EdsEntry::new(named(0x1029, 1, "Error behaviour", "Communication")),
        EdsEntry::new(named(0x1401, 1, "RPDO2", "COB-ID")),
        EdsEntry::new(named(0x1600, 0, "RPDO1 mapping", "Number of entries")),
        EdsEntry::new(named(0x1600, 1, "RPDO1 mapping", "First")),
        EdsEntry::new(named(0x1801, 1, "TPDO2", "COB-ID")),
        EdsEntry::new(named(0x1801, 2, "TPDO2", "Transmission type")),
        EdsEntry::new(named(0x1801, 3, "TPDO2", "Inhibit time")),
        EdsEntry::new(named(0x1801, 5, "TPDO2", "Event timer")),
        EdsEntry::new(Object { mappable: true, ..named(0x2000, 1, "Outputs", "Byte") }),
        EdsEntry::new(Object { mappable: true, ..named(0x2002, 1, "Values", "Byte") }),
        EdsEntry { limits: Some((1, 1_000)), ..EdsEntry::new(named(0x2002, 2, "Values", "Word")) },
    ];
    // A non-zero value, to distinguish it from the default.
    let config = Config { emergency_inhibit: 7, ..CONFIG };
    let made = Eds { facts, entries: entries.into_iter(), config }.to_string();
    assert_eq!(made, include_str!("tests/test.eds"));
}

/// COB-ID of RPDO1, whose length is 8 bytes.
const COB_ID: [u8; 4] = [0x10, 0x02, 0, 0];
const COB_ID_DISABLED: [u8; 4] = [0x10, 0x02, 0, 0x80];
/// COB-ID of TPDO1.
const SEND_ID: [u8; 4] = [0x90, 0x01, 0, 0x40];
const SEND_ID_DISABLED: [u8; 4] = [0x90, 0x01, 0, 0xC0];
const VALUE: u32 = 0x0609_0030;
const STATE: u32 = 0x0800_0022;

#[test]
fn disabling_an_rpdo_ends_command_by_the_master() {
    let mut bus = Bus::operational();
    bus.deliver(0x210, &[1; 8]);
    bus.turn();
    bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
    assert_eq!(bus.events, [rpdo(0, [1; 8]), READ, LEFT]);
    assert_eq!(bus.upload(0x1400, 1), Ok(COB_ID_DISABLED.to_vec()));
    bus.deliver(0x210, &[2; 8]);
    bus.deliver(0x210, &[2; 7]);
    bus.deliver(0x310, &[3; 2]);
    bus.events.clear();
    bus.turn();
    assert_eq!(bus.events, [rpdo(1, [3, 3, 0, 0, 0, 0, 0, 0])], "RPDO2 is unchanged");
    assert_eq!(bus.take(0x080), Vec::<Vec<u8>>::new());
    bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
    bus.download(0x1400, 1, &COB_ID).unwrap();
    bus.deliver(0x210, &[4; 8]);
    bus.events.clear();
    bus.turn();
    assert_eq!(bus.events, [rpdo(0, [4; 8])]);
    assert_eq!(bus.upload(0x1400, 1), Ok(COB_ID.to_vec()));
}

#[test]
fn missing_rpdos_after_disabling_one_are_no_time_out() {
    let mut bus = Bus::operational();
    bus.deliver(0x210, &[1; 8]);
    bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
    bus.pass(10 * u32::from(TIME_MS));
    assert!(!bus.events.contains(&SILENT));
    // A missing heartbeat is.
    bus.deliver(0x700 | MASTER, &[5]);
    bus.download(0x1401, 1, &[0x10, 0x03, 0, 0x80]).unwrap();
    bus.pass(TIME_MS.into());
    assert_eq!(bus.events.last(), Some(&SILENT));
}

#[test]
fn changing_the_transmission_type_keeps_the_rpdo_in_command() {
    let mut bus = Bus::operational();
    bus.download(0x1400, 2, &[1]).unwrap();
    assert_eq!(bus.events, [READ]);
}

#[test]
fn disabling_an_rpdo_outside_operation_is_no_event() {
    let mut bus = Bus::new();
    bus.turn();
    bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
    assert_eq!(bus.events, [READ]);
}

#[test]
fn disabled_tpdo_is_not_sent() {
    let mut bus = Bus::operational();
    bus.download(0x1800, 1, &SEND_ID_DISABLED).unwrap();
    assert_eq!(bus.upload(0x1800, 1), Ok(SEND_ID_DISABLED.to_vec()));
    bus.device.show_tpdo(0, [1; 8]);
    bus.take(0x180);
    bus.pass(500);
    assert_eq!(bus.take(0x180), Vec::<Vec<u8>>::new());
    bus.download(0x1800, 1, &SEND_ID).unwrap();
    assert_eq!(bus.take(0x180), [[1; 8]], "at once after enabling");
}

#[test]
fn cob_ids_must_match_the_predefined_set() {
    let mut bus = Bus::new();
    bus.turn();
    for (index, value, outcome) in [
        (0x1400, [0x10, 0x02, 0, 0x40], Ok(())),
        (0x1400, [0x10, 0x02, 0, 0xC0], Ok(())),
        (0x1400, [0x11, 0x02, 0, 0x80], Err(VALUE)),
        (0x1400, [0x10, 0x03, 0, 0], Err(VALUE)),
        (0x1400, [0x10, 0x02, 0, 0x20], Err(VALUE)),
        (0x1401, [0x10, 0x03, 0, 0x80], Ok(())),
        // Remote frames are not supported.
        (0x1800, [0x90, 0x01, 0, 0x00], Err(VALUE)),
        (0x1800, [0x90, 0x01, 0, 0x80], Err(VALUE)),
        (0x1800, [0x90, 0x02, 0, 0x40], Err(VALUE)),
        (0x1801, [0x90, 0x02, 0, 0x40], Ok(())),
        (0x1402, [0x10, 0x04, 0, 0x80], Err(0x0602_0000)),
    ] {
        assert_eq!(bus.download(index, 1, &value), outcome, "{index:X}h {value:02X?}");
    }
}

#[test]
fn mapping_accepts_only_itself_in_the_order_of_the_standard() {
    let mut bus = Bus::new();
    bus.turn();
    assert_eq!(bus.download(0x1600, 0, &[0]), Err(STATE), "while the PDO is enabled");
    bus.download(0x1600, 0, &[2]).unwrap();
    bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
    bus.download(0x1600, 0, &[0]).unwrap();
    assert_eq!(bus.upload(0x1600, 0), Ok(vec![0]));
    assert_eq!(bus.download(0x1400, 1, &COB_ID), Err(STATE), "a PDO without mapping");
    bus.download(0x1600, 1, &[0x08, 0x01, 0x00, 0x20]).unwrap();
    assert_eq!(bus.download(0x1600, 1, &[0x10, 0x01, 0x00, 0x20]), Err(0x0604_0041));
    assert_eq!(bus.download(0x1600, 0, &[1]), Err(VALUE));
    assert_eq!(bus.download(0x1600, 0, &[3]), Err(VALUE));
    bus.download(0x1600, 0, &[2]).unwrap();
    bus.download(0x1400, 1, &COB_ID).unwrap();
    assert_eq!(bus.upload(0x1600, 0), Ok(vec![2]));
    assert_eq!(bus.download(0x1A00, 0, &[0]), Err(STATE));
}

#[test]
fn inhibit_time_changes_only_while_the_tpdo_is_disabled() {
    let mut bus = Bus::operational();
    bus.download(0x1800, 3, &[20, 0]).unwrap();
    assert_eq!(bus.download(0x1800, 3, &[21, 0]), Err(STATE));
    bus.download(0x1800, 1, &SEND_ID_DISABLED).unwrap();
    bus.download(0x1800, 3, &[50, 0]).unwrap();
    assert_eq!(bus.download(0x1801, 3, &[50, 0]), Err(STATE), "TPDO2 is enabled");
    assert_eq!(bus.download(0x1802, 3, &[50, 0]), Err(0x0602_0000));
    bus.download(0x1800, 1, &SEND_ID).unwrap();
    bus.sent.clear();
    bus.device.show_tpdo(0, [1; 8]);
    bus.pass(4);
    assert_eq!(bus.take(0x180), Vec::<Vec<u8>>::new());
    bus.pass(1);
    assert_eq!(bus.take(0x180), [[1; 8]], "5 ms");
}

#[test]
fn transmission_types_exclude_remote_frames() {
    let mut bus = Bus::operational();
    for index in [0x1400, 0x1401, 0x1800, 0x1801] {
        for kind in 0..=255 {
            let outcome = if matches!(kind, 0..=240 | 254..=255) { Ok(()) } else { Err(VALUE) };
            assert_eq!(bus.download(index, 2, &[kind]), outcome, "{index:X}h {kind}");
            if outcome.is_ok() {
                assert_eq!(bus.upload(index, 2), Ok(vec![kind]));
            }
        }
    }
}

#[test]
fn synchronous_rpdo_takes_effect_at_sync_but_a_stop_at_once() {
    let mut bus = Bus::operational();
    bus.download(0x1400, 2, &[10]).unwrap();
    bus.events.clear();
    bus.deliver(0x210, &[1; 8]);
    bus.deliver(0x210, &[2; 8]);
    bus.turn();
    assert_eq!(bus.events, []);
    assert_eq!(bus.upload(0x2000, 1), Ok(vec![0]));
    bus.events.clear();
    bus.deliver(0x080, &[1, 2]);
    bus.turn();
    assert_eq!(bus.events, [], "not a SYNC");
    for sync in [&[][..], &[7]] {
        bus.deliver(0x210, &[2; 8]);
        bus.deliver(0x080, sync);
        bus.deliver(0x080, sync);
        bus.turn();
        assert_eq!(bus.events, [rpdo(0, [2; 8])], "the last one, once");
        assert_eq!(bus.upload(0x2000, 1), Ok(vec![2]));
        bus.events.clear();
    }
    bus.deliver(0x210, &[3; 8]);
    bus.deliver(0x210, &[STOP; 8]);
    bus.deliver(0x080, &[]);
    bus.turn();
    assert_eq!(bus.events, [rpdo(0, [STOP; 8])], "earlier data is discarded");
}

#[test]
fn data_awaiting_sync_is_dropped_if_its_master_stops_commanding() {
    type Act = fn(&mut Bus);
    let acts: [Act; 5] = [
        |bus| bus.nmt(0x80),
        |bus| bus.device.bus_lost(),
        |bus| bus.deliver(0x700 | MASTER, &[0]),
        |bus| bus.pass(TIME_MS.into()),
        |bus| {
            bus.download(0x1400, 1, &COB_ID_DISABLED).unwrap();
            bus.download(0x1400, 1, &COB_ID).unwrap();
        },
    ];
    for (number, act) in acts.into_iter().enumerate() {
        let mut bus = Bus::operational();
        bus.download(0x1400, 2, &[0]).unwrap();
        bus.deliver(0x210, &[1; 8]);
        act(&mut bus);
        bus.turn();
        bus.nmt(0x01);
        bus.deliver(0x080, &[]);
        bus.turn();
        assert!(!bus.events.contains(&rpdo(0, [1; 8])), "{number}: {:?}", bus.events);
        assert!(bus.events.iter().any(|event| matches!(event, Event::Left { .. })), "{number}");
    }
}

#[test]
fn sync_outside_operation_is_ignored() {
    let mut bus = Bus::operational();
    bus.download(0x1800, 2, &[1]).unwrap();
    bus.nmt(0x80);
    bus.sent.clear();
    bus.deliver(0x080, &[]);
    bus.pass(1);
    bus.nmt(0x01);
    bus.pass(1);
    assert_eq!(bus.take(0x180), Vec::<Vec<u8>>::new());
    bus.deliver(0x080, &[]);
    bus.turn();
    assert_eq!(bus.take(0x180).len(), 1);
}

#[test]
fn synchronous_tpdos_are_sent_every_nth_sync_or_on_change() {
    let mut bus = Bus::operational();
    bus.download(0x1800, 2, &[3]).unwrap();
    bus.download(0x1801, 2, &[0]).unwrap();
    bus.sent.clear();
    let mut counts = vec![];
    for n in 1..=9 {
        if n == 5 {
            bus.device.show_tpdo(1, [n; 8]);
        }
        bus.pass(150);
        assert_eq!((bus.take(0x180).len(), bus.take(0x280).len()), (0, 0), "nothing without a SYNC");
        bus.deliver(0x080, &[]);
        bus.turn();
        counts.push((bus.take(0x180).len(), bus.take(0x280).len()));
    }
    let expected = [(0, 1), (0, 0), (1, 0), (0, 0), (0, 1), (1, 0), (0, 0), (0, 0), (1, 0)];
    assert_eq!(counts, expected);
}

#[test]
fn disabled_heartbeat_consumer_still_monitors_rpdos() {
    for value in [[0; 4], [100, 0, 0, 0], [0, 0, MASTER as u8, 0]] {
        let mut bus = Bus::operational();
        bus.download(0x1016, 1, &value).unwrap();
        assert_eq!(bus.upload(0x1016, 1), Ok(vec![0; 4]), "disabled");
        bus.deliver(0x700 | MASTER, &[5]);
        bus.pass(10 * u32::from(TIME_MS));
        bus.deliver(0x700 | MASTER, &[0]);
        bus.turn();
        assert_eq!(bus.events, [READ, READ], "{value:?}");
        assert_eq!(bus.application.time_ms, TIME_MS, "time-out of the application is unchanged");
        bus.deliver(0x310, &[0; 2]);
        bus.pass(TIME_MS.into());
        assert_eq!(bus.events.last(), Some(&SILENT), "every commanding master is monitored");
        bus.download(0x1016, 1, &[200, 0, MASTER as u8, 0]).unwrap();
        assert_eq!(bus.upload(0x1016, 1), Ok(vec![200, 0, MASTER as u8, 0]));
    }
}

#[test]
fn rpdos_suffice_without_a_monitored_heartbeat() {
    for (heartbeat, value) in [(true, [0; 4]), (false, [100, 0, MASTER as u8, 0])] {
        let mut bus = Bus::operational();
        if heartbeat {
            bus.deliver(0x700 | MASTER, &[5]);
        }
        bus.deliver(0x310, &[0; 2]);
        bus.download(0x1016, 1, &value).unwrap();
        for _ in 0..20 {
            bus.pass(50);
            bus.deliver(0x310, &[0; 2]);
        }
        assert!(!bus.events.contains(&SILENT), "{value:?}");
        bus.pass(TIME_MS.into());
        assert_eq!(bus.events.last(), Some(&SILENT), "{value:?}");
    }
}

#[test]
fn inhibit_time_delays_emergencies_but_loses_none() {
    let mut bus = Bus::operational();
    bus.download(0x1015, 0, &[0x2C, 1]).unwrap();
    assert_eq!(bus.upload(0x1015, 0), Ok(vec![0x2C, 1]));
    let start = bus.now_ms;
    for n in 0..60 {
        bus.deliver(0x210, &[0; 7]);
        // A fault that appears and clears within one inhibit time.
        bus.show_faults(u16::from(n == 5));
        bus.pass(1);
    }
    bus.pass(200);
    let reported = bus.take_timed(0x080);
    let reported: Vec<_> = reported
        .iter()
        .map(|(at, data)| (at.wrapping_sub(start), u16::from_le_bytes([data[0], data[1]])))
        .collect();
    assert_eq!(reported, [(0, 0x8210), (30, 0xFF01), (60, 0x8210), (90, 0)]);
}

#[test]
fn past_faults_are_recorded_until_a_master_clears_them() {
    let mut bus = Bus::operational();
    assert_eq!(bus.upload(0x1003, 0), Ok(vec![0]));
    assert_eq!(bus.upload(0x1003, 1), Err(0x0800_0024));
    bus.show_faults(1);
    bus.show_faults(0b10001);
    bus.show_faults(0b00001);
    assert_eq!(bus.upload(0x1003, 0), Ok(vec![2]), "a cleared fault is no new entry");
    assert_eq!(bus.upload(0x1003, 1), Ok(vec![0x10, 0x42, 5, 0]));
    assert_eq!(bus.upload(0x1003, 2), Ok(vec![0x01, 0xFF, 5, 0]));
    for _ in 0..10 {
        bus.deliver(0x210, &[]);
        bus.turn();
    }
    assert_eq!(bus.upload(0x1003, 0), Ok(vec![8]));
    assert_eq!(bus.upload(0x1003, 8), Ok(vec![0x10, 0x82, 5, 0]));
    assert_eq!(bus.download(0x1003, 0, &[1]), Err(VALUE));
    assert_eq!(bus.download(0x1003, 1, &[0; 4]), Err(0x0601_0002));
    bus.download(0x1003, 0, &[0]).unwrap();
    assert_eq!(bus.upload(0x1003, 0), Ok(vec![0]));
    assert_eq!(bus.upload(0x1003, 1), Err(0x0800_0024));
}

#[test]
fn error_behaviour_selects_the_state_after_a_loss() {
    for (behaviour, state) in
        [(0, NmtState::PreOperational), (1, NmtState::Operational), (2, NmtState::Stopped)]
    {
        type Act = fn(&mut Bus);
        let acts: [Act; 3] = [
            |bus| bus.device.bus_lost(),
            |bus| bus.deliver(0x700 | MASTER, &[0]),
            |bus| bus.pass(TIME_MS.into()),
        ];
        for act in acts {
            let mut bus = Bus::operational();
            bus.download(0x1029, 1, &[behaviour]).unwrap();
            assert_eq!(bus.upload(0x1029, 1), Ok(vec![behaviour]));
            bus.deliver(0x700 | MASTER, &[5]);
            bus.events.clear();
            act(&mut bus);
            bus.turn();
            assert_eq!(bus.device.state(), state);
            assert!(matches!(bus.events[..], [Event::Left { .. }]), "in every state: {:?}", bus.events);
        }
    }
    let mut bus = Bus::operational();
    assert_eq!(bus.download(0x1029, 1, &[3]), Err(VALUE));
}

#[test]
fn time_out_without_state_change_clears_when_the_master_returns() {
    let mut bus = Bus::operational();
    bus.download(0x1029, 1, &[1]).unwrap();
    for data in [&[5][..], &[127]] {
        bus.deliver(0x700 | MASTER, data);
        bus.pass(TIME_MS.into());
        bus.show_faults(0);
        assert_eq!(bus.take(0x080).len(), 1, "time-out");
        bus.deliver(0x700 | MASTER, data);
        bus.show_faults(0);
        assert_eq!(bus.take(0x080), [[0, 0, 0, 1, 2, 3, 4, 5]]);
    }
}

#[test]
fn text_is_read_in_segments() {
    let mut bus = Bus::operational();
    assert_eq!(bus.download(0x1008, 0, &[0; 4]), Err(0x0601_0002));
    for name in [NAME, "1234567", "1.2", ""] {
        bus.application.name = name;
        let size = name.len() as u8;
        assert_eq!(bus.sdo([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]), [[0x41, 0x08, 0x10, 0, size, 0, 0, 0]]);
        let (mut text, mut toggle) = (vec![], 0);
        loop {
            let answers = bus.sdo([0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
            let [answer] = &answers[..] else { panic!("{answers:?}") };
            assert_eq!(answer[0] & 0xF0, toggle);
            let used = 7 - usize::from(answer[0] >> 1 & 7);
            text.extend_from_slice(&answer[1..1 + used]);
            assert!(answer[1 + used..].iter().all(|byte| *byte == 0));
            if answer[0] & 1 != 0 {
                break;
            }
            assert_eq!(used, 7, "only the last segment is shorter");
            toggle ^= 0x10;
        }
        assert_eq!(text, name.as_bytes());
        let more = bus.sdo([0x60 | toggle ^ 0x10, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(more, [[0x80, 0, 0, 0, 1, 0, 4, 5]], "no further segment");
    }
}

/// An application that does not implement `text` and `outcome`.
struct Textless(Application);

impl Dictionary for Textless {
    type Key = Key;

    fn find(&self, index: u16, sub: u8) -> Result<Entry<Key>, Abort> {
        self.0.find(index, sub)
    }

    fn read(&self, key: Key) -> Result<u32, Abort> {
        self.0.read(key)
    }

    fn write(&mut self, key: Key, value: u32) -> Result<(), Abort> {
        self.0.write(key, value)
    }

    fn consumer_time_ms(&self) -> u16 {
        self.0.consumer_time_ms()
    }

    fn set_consumer_time_ms(&mut self, time_ms: u16) -> Result<(), Abort> {
        self.0.set_consumer_time_ms(time_ms)
    }
}

#[test]
fn by_default_a_text_is_no_data_and_a_write_ends_immediately() {
    let [a, b, c, d] = (Abort::NoData as u32).to_le_bytes();
    for (request, event, expected) in [
        ([0x40, 0x08, 0x10, 0, 0, 0, 0, 0], READ, [0x80, 0x08, 0x10, 0, a, b, c, d]),
        (SLOW, Event::Sdo { written: true }, [0x60, 0x02, 0x20, 5, 0, 0, 0, 0]),
    ] {
        let mut bus = Bus::operational();
        bus.deliver(0x600 | NODE, &request);
        let Bus { mut device, application, now_ms, .. } = bus;
        assert_eq!(device.poll_event(now_ms, &mut Textless(application)), Some(event));
        let answer = device.poll_transmit::<ClassicFrame>(now_ms).unwrap();
        assert_eq!(answer.data(), expected);
    }
}

#[test]
fn segmented_transfer_ends_on_wrong_toggle_bit_or_new_request() {
    let begin = [0x40, 0x08, 0x10, 0, 0, 0, 0, 0];
    let mut bus = Bus::operational();
    bus.sdo(begin);
    let toggled = bus.sdo([0x70, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(toggled, [[0x80, 0x08, 0x10, 0, 0, 0, 0x03, 0x05]]);
    let none = [[0x80, 0, 0, 0, 1, 0, 4, 5]];
    assert_eq!(bus.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]), none, "after the abort by the server");
    bus.sdo(begin);
    assert_eq!(bus.sdo([0x80, 0x08, 0x10, 0, 0, 0, 0, 0]), Vec::<Vec<u8>>::new());
    assert_eq!(bus.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]), none, "after the abort by the client");
    bus.sdo(begin);
    bus.upload(0x1000, 0).unwrap();
    assert_eq!(bus.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]), none, "after another request");
    bus.sdo(begin);
    bus.nmt(0x02);
    bus.nmt(0x01);
    assert_eq!(bus.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]), none, "after a stop");
}

/// A request that writes the slow object.
const SLOW: [u8; 8] = [0x2B, 0x02, 0x20, 5, 1, 0, 0, 0];

#[test]
fn slow_write_is_answered_when_it_has_ended() {
    for (outcome, answer) in [
        (Ok(()), [0x60, 0x02, 0x20, 5, 0, 0, 0, 0]),
        (Err(Abort::Hardware), [0x80, 0x02, 0x20, 5, 0, 0, 0x06, 0x06]),
    ] {
        let mut bus = Bus::operational();
        assert!(bus.sdo(SLOW).is_empty());
        bus.pass(30);
        assert!(bus.take(0x580).is_empty(), "still in progress");
        assert_eq!(bus.events, [Event::Sdo { written: true }], "once");
        bus.application.outcome = Some(outcome);
        bus.pass(1);
        assert_eq!(bus.take(0x580), [answer]);
        bus.pass(30);
        assert!(bus.take(0x580).is_empty(), "once");
    }
}

#[test]
fn new_request_replaces_a_write_in_progress() {
    let aborted = [0x80, 0x02, 0x20, 5, 0, 0, 0x04, 0x05];
    for (next, answers) in [(aborted, 0), ([0x40, 0x02, 0x20, 2, 0, 0, 0, 0], 1)] {
        let mut bus = Bus::operational();
        bus.sdo(SLOW);
        assert_eq!(bus.sdo(next).len(), answers);
        bus.application.outcome = Some(Ok(()));
        bus.pass(30);
        assert!(bus.take(0x580).is_empty());
    }
    let ends: [fn(&mut Bus); 3] = [|bus| bus.nmt(0x02), |bus| bus.nmt(0x82), |bus| bus.device.bus_lost()];
    for end in ends {
        let mut bus = Bus::operational();
        bus.sdo(SLOW);
        end(&mut bus);
        bus.application.outcome = Some(Ok(()));
        bus.nmt(0x01);
        bus.pass(30);
        assert!(bus.take(0x580).is_empty());
    }
}

/// Starts a download of 8 bytes to the domain.
const BEGIN: [u8; 8] = [0x21, 0x50, 0x1F, 1, 8, 0, 0, 0];
const FIRST_SEGMENT: [u8; 8] = [0x00, 1, 2, 3, 4, 5, 6, 7];
const LAST_SEGMENT: [u8; 8] = [0x1D, 8, 0, 0, 0, 0, 0, 0];

#[test]
fn domain_is_downloaded_in_segments_each_answered_when_written() {
    let mut bus = Bus::operational();
    bus.application.outcome = Some(Ok(()));
    assert_eq!(bus.sdo(BEGIN), [[0x60, 0x50, 0x1F, 1, 0, 0, 0, 0]]);
    bus.application.outcome = None;
    assert!(bus.sdo(FIRST_SEGMENT).is_empty());
    assert!(bus.sdo(FIRST_SEGMENT).is_empty(), "an impatient client repeats it");
    bus.application.outcome = Some(Ok(()));
    bus.pass(1);
    assert_eq!(bus.take(0x580), [[0x20, 0, 0, 0, 0, 0, 0, 0]], "once");
    assert_eq!(bus.application.image, (Some(8), vec![1, 2, 3, 4, 5, 6, 7], false));
    assert_eq!(bus.sdo(LAST_SEGMENT), [[0x30, 0, 0, 0, 0, 0, 0, 0]]);
    assert_eq!(bus.application.image, (Some(8), vec![1, 2, 3, 4, 5, 6, 7, 8], true));
    assert_eq!(bus.events.iter().filter(|event| **event != READ).count(), 1, "{:?}", bus.events);
    assert_eq!(bus.upload(0x1F50, 1), Err(0x0601_0001));
    assert_eq!(bus.sdo([0x20, 0x50, 0x1F, 1, 0, 0, 0, 0]).len(), 1);
    assert_eq!(bus.application.image.0, None, "without a size");
}

#[test]
fn download_ends_on_wrong_toggle_bit_failure_abort_or_new_request() {
    let abort = |[a, b, c, d]: [u8; 4]| [[0x80, 0x50, 0x1F, 1, a, b, c, d]];
    let mut bus = Bus::operational();
    bus.application.outcome = Some(Ok(()));
    bus.sdo(BEGIN);
    assert_eq!(bus.sdo(LAST_SEGMENT), abort([0, 0, 0x03, 0x05]), "toggled");
    assert_eq!(bus.sdo(FIRST_SEGMENT)[0][4..], [1, 0, 4, 5], "after the abort by the server");
    let ends: [fn(&mut Bus); 4] = [
        |bus| assert!(bus.sdo([0x80, 0x50, 0x1F, 1, 0, 0, 0, 0]).is_empty()),
        |bus| assert!(bus.upload(0x1000, 0).is_ok()),
        |bus| bus.nmt(0x02),
        |bus| {
            bus.application.outcome = Some(Err(Abort::Hardware));
            assert_eq!(bus.sdo(FIRST_SEGMENT)[0][4..], [0, 0, 0x06, 0x06]);
        },
    ];
    for end in ends {
        let mut bus = Bus::operational();
        bus.application.outcome = Some(Ok(()));
        bus.sdo(BEGIN);
        end(&mut bus);
        bus.nmt(0x01);
        let [.., a, b, c, d] = bus.sdo([0x10, 1, 2, 3, 4, 5, 6, 7])[0][..] else { panic!() };
        assert_eq!([a, b, c, d], [1, 0, 4, 5], "no download is in progress");
    }
    assert_eq!(bus.sdo([0x21, 0x08, 0x10, 0, 8, 0, 0, 0])[0][4..], [2, 0, 1, 6], "a text is read-only");
}

#[test]
fn transfer_survives_a_start_but_not_a_stop() {
    let mut bus = Bus::operational();
    bus.sdo([0x40, 0x08, 0x10, 0, 0, 0, 0, 0]);
    bus.nmt(0x80);
    bus.nmt(0x01);
    let answers = bus.sdo([0x60, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(answers[0][1..], NAME.as_bytes()[..7]);
    // A request and a stop in the same turn.
    bus.deliver(0x600 | NODE, &[0x2F, 0x02, 0x20, 1, 0xCD, 0, 0, 0]);
    bus.nmt(0x02);
    bus.nmt(0x80);
    assert_eq!((bus.application.byte, bus.take(0x580)), (0, vec![]));
}

#[test]
fn elapsed_time_covers_24_days_and_an_age_any_time() {
    use clock::MAX_AGE_MS;
    for then_ms in [0, u32::MAX] {
        let since = |ms: u32| clock::since(then_ms.wrapping_add(ms), then_ms);
        assert_eq!((since(0), since(0x7FFF_FFFF), since(0x8000_0000)), (0, 0x7FFF_FFFF, 0));
        let mut at_ms = then_ms;
        for (passed_ms, age_ms) in
            [(0, 0), (MAX_AGE_MS, MAX_AGE_MS), (0x7FFF_FFFF, MAX_AGE_MS), (0xBFFF_FFFE, MAX_AGE_MS)]
        {
            assert_eq!(clock::age(then_ms.wrapping_add(passed_ms), &mut at_ms), age_ms);
        }
    }
}

#[test]
fn rpdo_image_accepts_only_its_present_value_by_sdo() {
    let mut bus = Bus::operational();
    bus.deliver(0x210, &[1; 8]);
    bus.turn();
    bus.events.clear();
    bus.download(0x2000, 1, &[1]).unwrap();
    assert_eq!(bus.download(0x2000, 1, &[2]), Err(0x0800_0021));
    bus.download(0x2000, 0, &[2]).unwrap();
    assert_eq!(bus.download(0x2000, 0, &[3]), Err(VALUE), "a constant");
    bus.download(0x1014, 0, &[0x90, 0, 0, 0]).unwrap();
    assert_eq!(bus.download(0x1014, 0, &[0x91, 0, 0, 0]), Err(VALUE));
    assert_eq!(bus.events, [READ; 6]);
    assert_eq!(bus.upload(0x2000, 1), Ok(vec![1]));
}

#[test]
fn other_nodes_and_invalid_frames_do_not_count_as_the_master() {
    let remote = ClassicFrame::new_remote(StandardId::new(0x700 | MASTER).unwrap(), 1).unwrap();
    for has_heartbeat in [true, false] {
        let mut bus = Bus::operational();
        if has_heartbeat {
            bus.deliver(0x700 | MASTER, &[5]);
        } else {
            bus.deliver(0x210, &[0; 8]);
        }
        for _ in 0..TIME_MS / 10 {
            assert!(!bus.events.contains(&SILENT), "too early");
            for (id, data) in [
                (0x700 | (MASTER - 1), &[5][..]),
                (0x700 | MASTER, &[5, 5]),
                (0x700 | MASTER, &[]),
                (0x211, &[0; 8]),
                (0x210, &[0; 7]),
                (0x310, &[0; 3]),
                (0x080, &[]),
                (0x000, &[0x01, 0x11]),
                (0x610, &[0x40, 0x00, 0x10, 0, 0, 0, 0, 0]),
            ] {
                bus.deliver(id, data);
            }
            bus.device.on_frame(bus.now_ms, &remote);
            bus.pass(10);
        }
        assert_eq!(bus.events.last(), Some(&SILENT), "heartbeat: {has_heartbeat}");
    }
}
