//! Behaviour of the device, as seen by a controller.

pub(crate) mod controller;

use super::*;
use crate::Maintenance;
use controller::*;
use std::string::String;
use std::vec;
use std::vec::Vec;

// --- DCP

const MULTICAST: MacAddress = MacAddress([1, 0x0E, 0xCF, 0, 0, 0]);

fn dcp_frame(to: MacAddress, id: u16, service: [u8; 2], delay: u16, blocks: &[u8]) -> Vec<u8> {
    let len = blocks.len() as u16;
    let head = [&to.0[..], &PLC.0, &[0x88, 0x92], &id.to_be_bytes(), &service, &[0xAB, 0xCD, 0xEF, 0x01]];
    [head.concat(), delay.to_be_bytes().to_vec(), len.to_be_bytes().to_vec(), blocks.to_vec()].concat()
}

/// Returns a block: option, suboption, data.
fn dcp_block(what: [u8; 2], data: &[u8]) -> Vec<u8> {
    let mut bytes = [&what[..], &(data.len() as u16).to_be_bytes(), data].concat();
    bytes.resize(bytes.len().next_multiple_of(2), 0);
    bytes
}

/// Sets an option, permanently or not. Returns the event and the block error.
fn set(bench: &mut Bench, is_permanent: bool, what: [u8; 2], data: &[u8]) -> (Option<Event>, u8) {
    let block = dcp_block(what, &[&[0, is_permanent.into()], data].concat());
    let event = bench.device.receive(bench.now, &dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &block));
    let answers = bench.acyclic();
    let [answer] = &answers[..] else { panic!("{answers:?}") };
    let [control, response, 0, 3, option, suboption, fault, 0] = answer[26..34] else { panic!("{answer:?}") };
    assert_eq!(([control, response], [option, suboption]), ([5, 4], what));
    (event, fault)
}

fn identify(bench: &mut Bench, delay: u16, blocks: &[u8]) {
    let request = dcp_frame(MULTICAST, 0xFEFE, [5, 0], delay, blocks);
    assert_eq!(bench.device.receive(bench.now, &request), None);
}

#[test]
fn identify_for_this_station_only_is_answered() {
    let mut bench = Bench::new();
    let request = dcp_frame(DEVICE, 0xFEFE, [5, 0], 1, &dcp_block([0xFF, 0xFF], &[]));
    assert_eq!(bench.device.receive(bench.now, &request), None);
    assert_eq!(bench.sent().len(), 1);
}

/// Compares the complete answer to an Identify request for all options.
#[test]
fn identify_is_answered_with_all_options_for_a_controller() {
    let mut bench = Bench::new();

    identify(&mut bench, 1, &dcp_block([0xFF, 0xFF], &[]));

    let expected = [
        &PLC.0[..],
        &DEVICE.0,
        &[0x88, 0x92, 0xFE, 0xFF, 5, 1, 0xAB, 0xCD, 0xEF, 0x01, 0, 0, 0, 0x6A],
        &[2, 2, 0, 11, 0, 0],
        b"example-1\0",
        &[1, 2, 0, 14, 0, 1, 192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0],
        &[2, 3, 0, 6, 0, 0, 0x12, 0x34, 0x56, 0x78],
        &[2, 1, 0, 9, 0, 0],
        b"example\0",
        &[2, 5, 0, 28, 0, 0, 1, 1, 1, 2, 2, 1, 2, 2, 2, 3, 2, 4, 2, 5, 2, 7, 5, 1, 5, 2, 5, 3, 5, 5, 5, 6],
        &[2, 4, 0, 4, 0, 0, 1, 0],
        &[2, 7, 0, 4, 0, 0, 0, 1],
    ]
    .concat();
    assert_eq!(bench.sent(), [expected]);
}

#[test]
fn identify_is_answered_if_all_filters_match() {
    let name = |name: &str| dcp_block([2, 2], name.as_bytes());
    let id = |vendor: u8| dcp_block([2, 3], &[vendor, 0x34, 0x56, 0x78]);
    for (blocks, is_answered) in [
        (name("example-1"), true),
        (name("example-2"), false),
        (name("example"), false),
        (name(""), false),
        (id(0x12), true),
        (id(0x13), false),
        ([name("example-1"), id(0x12)].concat(), true),
        ([name("example-1"), id(0x13)].concat(), false),
        (dcp_block([2, 6], b"port-001.example"), false),
        (dcp_block([1, 2], &[192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0]), true),
        (dcp_block([9, 9], &[1]), false),
        (dcp_block([9, 9], &[]), false),
        // A truncated block.
        (vec![2, 2, 0, 9, b'e'], false),
    ] {
        let mut bench = Bench::new();
        identify(&mut bench, 1, &blocks);
        assert_eq!(bench.sent().len(), usize::from(is_answered), "{blocks:?}");
    }
}

#[test]
fn answer_to_identify_is_delayed_by_address_and_delay_factor() {
    let mut bench = Bench::new();
    // 0010h modulo 7 is 2: two units of 10 ms.
    identify(&mut bench, 7, &dcp_block([0xFF, 0xFF], &[]));
    let due = bench.now + 20_000;
    assert_eq!(bench.device.poll_timeout(bench.now), due);
    bench.now = due - 1;
    assert_eq!(bench.sent().len(), 0);
    bench.now = due;
    assert_eq!(bench.sent().len(), 1);
}

#[test]
fn pending_answers_are_limited_and_lost_ones_are_counted() {
    let mut bench = Bench::new();
    for _ in 0..6 {
        identify(&mut bench, 0x1900, &dcp_block([0xFF, 0xFF], &[]));
    }
    assert_eq!(bench.device.counters().dcp_lost, 2);
    bench.now += 64_000_000;
    let answers = bench.sent().into_iter().filter(|frame| frame[14..16] == [0xFE, 0xFF]);
    assert_eq!(answers.count(), 4);
}

#[test]
fn name_and_address_take_effect_at_once_and_persist_if_permanent() {
    let mut bench = Bench::new();
    let ip = [10, 0, 0, 7, 255, 0, 0, 0, 10, 0, 0, 1];

    assert_eq!(set(&mut bench, true, [2, 2], b"gripper"), (Some(Event::Stored), 0));
    assert_eq!(set(&mut bench, true, [1, 2], &ip), (Some(Event::Stored), 0));

    let stored = *bench.device.stored();
    assert_eq!((stored.name.as_str(), stored.ip.address), ("gripper", [10, 0, 0, 7]));
    assert_eq!((bench.device.name(), bench.device.ip()), (&stored.name, &stored.ip));
    assert_eq!((stored.ip.gateway, stored.ip.prefix_len()), ([10, 0, 0, 1], 8));

    // Temporary: none after the next start.
    assert_eq!(set(&mut bench, false, [2, 2], b"other"), (Some(Event::Stored), 0));
    assert_eq!(set(&mut bench, false, [1, 2], &[0; 12]), (Some(Event::Stored), 0));
    assert_eq!((bench.device.name().as_str(), bench.device.stored().name), ("other", StationName::NONE));
    assert_eq!((bench.device.ip().is_set(), bench.device.stored().ip), (false, IpParameters::NONE));
}

#[test]
fn each_change_of_present_or_stored_data_is_reported_and_repetitions_are_not() {
    let mut bench = Bench::new();
    let (first, second) = ([10, 0, 0, 7, 255, 0, 0, 0, 0, 0, 0, 0], [10, 0, 0, 8, 255, 0, 0, 0, 0, 0, 0, 0]);
    for (is_permanent, what, data, is_told) in [
        (false, [2, 2], &b"one"[..], true),
        // Changes the present name; nothing is stored.
        (false, [2, 2], b"two", true),
        (false, [2, 2], b"two", false),
        // Stores the present name.
        (true, [2, 2], b"two", true),
        (true, [2, 2], b"two", false),
        (false, [1, 2], &first, true),
        (false, [1, 2], &second, true),
        (false, [1, 2], &second, false),
        (true, [1, 2], &second, true),
        (true, [1, 2], &second, false),
    ] {
        let expected = (is_told.then_some(Event::Stored), 0);
        assert_eq!(set(&mut bench, is_permanent, what, data), expected, "{what:?} {is_permanent} {data:?}");
    }
}

#[test]
fn invalid_settings_are_rejected_without_a_change() {
    let mut bench = Bench::new();
    let before = *bench.device.stored();
    for (what, data, fault) in [
        ([2, 2], &b"Example"[..], 3),
        ([2, 2], &[b'a'; 241][..], 3),
        ([1, 2], &[192, 168, 0, 255, 255, 255, 255, 0, 0, 0, 0, 0], 3),
        ([1, 2], &[192, 168, 0, 5, 255, 0, 255, 0, 0, 0, 0, 0], 3),
        ([1, 2], &[224, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0], 3),
        ([1, 2], &[192, 168, 0, 5], 3),
        ([1, 2], &[192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0, 0], 3),
        ([1, 1], &[0; 6], 3),
        ([2, 3], &[0; 4], 3),
        ([2, 9], &[0; 4], 2),
        ([5, 9], &[0; 4], 2),
        ([9, 1], &[0; 4], 1),
        ([5, 3], &[0, 0], 3),
    ] {
        assert_eq!(set(&mut bench, true, what, data), (None, fault), "{what:?} {data:?}");
    }
    assert_eq!(*bench.device.stored(), before);
    assert_eq!(set(&mut bench, false, [5, 3], &[1, 0]), (Some(Event::Signal), 0));
}

#[test]
fn name_and_address_stay_while_a_controller_uses_them() {
    let mut bench = Bench::in_data();
    let ip = [192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0];
    assert_eq!(set(&mut bench, true, [2, 2], b"gripper"), (None, 6));
    assert_eq!(set(&mut bench, true, [2, 2], b"example-1"), (None, 0));
    assert_eq!(set(&mut bench, true, [1, 2], &ip), (None, 0));
    assert_eq!(set(&mut bench, true, [1, 2], &[0; 12]), (None, 6));
}

#[test]
fn reset_ends_the_connection_and_clears_stored_data() {
    for (what, qualifier, fault) in [
        ([5, 5], 0, 0),
        ([5, 6], 4, 0),
        ([5, 6], 5, 0),
        ([5, 6], 8, 0),
        ([5, 6], 16, 0),
        ([5, 6], 2, 2),
        ([5, 6], 6, 2),
    ] {
        let mut bench = Bench::in_data();
        let request = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block(what, &[0, qualifier]));
        let event = bench.device.receive(bench.now, &request);
        let frames = bench.acyclic();
        let answer = frames.iter().find(|frame| frame[14..16] == [0xFE, 0xFD]).unwrap();
        assert_eq!(answer[32], fault, "{what:?} {qualifier}");
        let is_reset = fault == 0;
        assert_eq!(event, is_reset.then_some(Event::Left(Cause::Reset)));
        assert!(!is_reset || bench.device.poll_timeout(bench.now) == bench.now);
        assert_eq!((bench.poll(), bench.poll()), (is_reset.then_some(Event::Stored), None));
        assert_eq!(*bench.device.stored() == Stored::NONE, is_reset);
        assert_eq!(bench.device.state(), if is_reset { State::Unconnected } else { State::Data });
    }
}

#[test]
fn reset_of_communication_keeps_the_maintenance_data() {
    for (what, qualifier, leaves_it) in
        [([5, 6], 4, true), ([5, 6], 8, false), ([5, 6], 16, false), ([5, 5], 0, false)]
    {
        let mut bench = Bench::in_data();
        let date = block(0x22, b"2026-11-23 16:00");
        bench.call(3, &[&record(8, AR, 0, 1, 0xAFF2, date.len() as u32)[..], &date].concat());
        let before = bench.device.stored().maintenance;
        assert_eq!(before.date, *b"2026-11-23 16:00");
        let request = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block(what, &[0, qualifier]));
        bench.device.receive(bench.now, &request);
        let maintenance = if leaves_it { before } else { Maintenance::NONE };
        assert_eq!(*bench.device.stored(), Stored { maintenance, ..Stored::NONE }, "{what:?} {qualifier}");
    }
}

/// The application learns about the end of outputs even if more frames arrive before it polls.
#[test]
fn reset_is_reported_before_a_name_set_directly_after_it() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    let reset = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block([5, 6], &[0, 4]));
    assert_eq!(bench.device.receive(bench.now, &reset), Some(Event::Left(Cause::Reset)));
    bench.acyclic();
    assert_eq!(set(&mut bench, true, [2, 2], b"gripper"), (Some(Event::Stored), 0));
    assert_eq!((bench.device.outputs(), bench.device.state()), (&[0; 3], State::Unconnected));
    assert_eq!((bench.poll(), bench.poll()), (Some(Event::Stored), None));
}

#[test]
fn get_returns_requested_options_and_errors_for_unknown_ones() {
    let mut bench = Bench::new();
    let request = dcp_frame(DEVICE, 0xFEFD, [3, 0], 0, &[2, 2, 1, 1, 9, 9, 2, 6, 2]);
    assert_eq!(bench.device.receive(bench.now, &request), None);
    let answers = bench.sent();
    let expected = [
        &[2, 2, 0, 11, 0, 0][..],
        b"example-1\0",
        &[1, 1, 0, 8, 0, 0],
        &DEVICE.0,
        &[5, 4, 0, 3, 9, 9, 1, 0, 5, 4, 0, 3, 2, 6, 2, 0],
    ]
    .concat();
    assert_eq!(answers[0][26..26 + expected.len()], expected);
    assert_eq!(answers[0][24..26], (expected.len() as u16).to_be_bytes());
}

#[test]
fn dcp_for_another_station_or_of_another_type_is_not_answered() {
    let all = dcp_block([0xFF, 0xFF], &[]);
    let name = dcp_block([2, 2], b"\0\x01other");
    for (to, id, service, blocks) in [
        (OTHER, 0xFEFD, [3, 0], &[2, 2][..]),
        (MULTICAST, 0xFEFD, [3, 0], &[2, 2]),
        (OTHER, 0xFEFD, [4, 0], &name),
        (MULTICAST, 0xFEFD, [4, 0], &name),
        (OTHER, 0xFEFE, [5, 0], &all),
        (DEVICE, 0xFEFD, [3, 1], &[2, 2]),
        (DEVICE, 0xFEFD, [9, 0], &[2, 2]),
        (DEVICE, 0xFEFF, [5, 1], &all),
    ] {
        let mut bench = Bench::new();
        assert_eq!(bench.device.receive(bench.now, &dcp_frame(to, id, service, 1, blocks)), None);
        assert_eq!(bench.sent().len(), 0, "{to} {id:X} {service:?}");
        assert_eq!(bench.device.name().as_str(), "example-1");
    }
}

// --- LLDP

#[test]
fn lldp_announces_name_port_and_address_every_5_s() {
    let mut bench = Bench::new();
    assert_eq!(bench.device.poll_timeout(bench.now), 6_000_000);
    bench.now = 6_000_000;
    let expected = [
        &[1, 0x80, 0xC2, 0, 0, 0x0E][..],
        &DEVICE.0,
        &[0x88, 0xCC],
        b"\x02\x0a\x07example-1",
        b"\x04\x09\x07port-001",
        &[6, 2, 0, 20],
        &[0xFE, 8, 0, 0x0E, 0xCF, 2, 0, 0, 0, 0],
        &[0xFE, 10, 0, 0x0E, 0xCF, 5],
        &DEVICE.0,
        &[0xFE, 9, 0, 0x12, 0x0F, 1, 3, 0, 0, 0, 16],
        &[0x10, 12, 5, 1, 192, 168, 0, 5, 2, 0, 0, 0, 1, 0],
        &[0, 0],
    ]
    .concat();
    assert_eq!(bench.sent(), [expected]);
    assert_eq!(bench.device.poll_timeout(bench.now), 11_000_000);
}

#[test]
fn lldp_without_name_and_address_uses_the_mac_address() {
    let mut device = Device::<3, 2>::new(&PROFILE, DEVICE, Stored::NONE, 1);
    let mut buffer = [0; MAX_FRAME_LEN];
    assert_eq!(device.poll_transmit(0, &mut buffer), Some(Transmit::Frame(73)));
    assert_eq!(buffer[14..23], [2, 7, 4, 2, 0, 0, 0, 0, 0x10]);
}

// --- Connect

#[test]
fn controller_connects_without_parameters_and_exchanges_data() {
    let mut bench = Bench::new();
    let answer = bench.call(0, &Wanted::default().blocks());
    assert_eq!((answer.event, answer.kind, answer.status), (None, 2, 0));
    let expected = [
        (0x8101, [&[0, 1][..], &AR, &[0, 7], &DEVICE.0, &[0x88, 0x92]].concat()),
        (0x8102, vec![0, 1, 0, 11, 0xC0, 1]),
        (0x8102, vec![0, 2, 0, 12, 0x80, 1]),
        (0x8103, vec![0, 1, 0, 1, 0, 200]),
    ];
    assert_eq!(blocks_of(&answer.blocks), expected);
    assert_eq!(bench.device.state(), State::Parameters);

    let answer = bench.call(4, &control(0x0110, AR, 1));
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(answer.blocks, control(0x8110, AR, 8));
    assert_eq!(bench.device.state(), State::Ready);

    let calls = bench.calls();
    let [call] = &calls[..] else { panic!("{calls:?}") };
    assert_eq!((call[0], call[1], &call[68..70]), (4, 0, &[0, 4][..]));
    assert_eq!(call[8..24], PLC_OBJECT, "object UUID of the controller");
    assert_eq!(call[24..28], [0xDE, 0xA0, 0, 2]);
    // The activity identifies the device and its start, so that answers to other calls do not match.
    assert_eq!(call[40..56], [0, 0, 0xB0, 7, 0, 0, 0x10, 0, 0x80, 0, 0x02, 0, 0, 0, 0, 0x10]);
    assert_eq!(call[100..], control(0x0112, AR, 2));
    // Outputs do not count before the controller's confirmation.
    assert_eq!(bench.outputs([1, 2, 3]), None);
    assert_eq!(bench.confirm(call), Some(Event::Connected));
    assert_eq!(bench.device.state(), State::Data);
    assert_eq!(bench.confirm(call), None, "only once");
    assert_eq!(bench.outputs([1, 2, 3]), Some(Event::Outputs));
    assert_eq!(bench.device.outputs(), &[1, 2, 3]);
}

#[test]
fn errors_in_a_connect_are_located_and_nothing_is_connected() {
    let default = Wanted::default;
    let unknown = block(0x0199, &[]);
    let again = default().blocks()[..61].to_vec();
    assert_eq!(again.len(), usize::from(u16::from_be_bytes([again[2], again[3]])) + 4);
    for (wanted, code1, code2) in [
        (Wanted { ar_type: 2, ..default() }, 1, 4),
        (Wanted { ar_type: 6, ..default() }, 1, 4),
        (Wanted { properties: 0x111, ..default() }, 1, 4),
        (Wanted { uuid: [0; 16], ..default() }, 1, 5),
        (Wanted { mac: MULTICAST, ..default() }, 1, 7),
        (Wanted { object: [0; 16], ..default() }, 1, 8),
        (Wanted { object: AR, ..default() }, 1, 8),
        (Wanted { properties: 0x10, ..default() }, 1, 9),
        (Wanted { properties: 0x4000_0011, ..default() }, 1, 9),
        (Wanted { properties: 0x211, ..default() }, 1, 9),
        (Wanted { properties: 0x411, ..default() }, 1, 9),
        (Wanted { name: b"", ..default() }, 1, 12),
        (Wanted { name: &[b'a'; 241], ..default() }, 1, 12),
        (Wanted { class: 3, ..default() }, 2, 7),
        (Wanted { data_len: 39, ..default() }, 2, 8),
        (Wanted { data_len: 1_441, ..default() }, 2, 8),
        (Wanted { input_id: 0x7FFF, ..default() }, 2, 9),
        (Wanted { output_id: 0xBC00, ..default() }, 2, 9),
        (Wanted { output_id: 0xFC00, ..default() }, 2, 9),
        (Wanted { send_clock: 0, ..default() }, 2, 10),
        (Wanted { send_clock: 129, ..default() }, 2, 10),
        (Wanted { reduction: 0, ..default() }, 2, 11),
        (Wanted { send_clock: 16, reduction: 1_024, ..default() }, 2, 11),
        (Wanted { send_clock: 31, reduction: 1, ..default() }, 2, 11),
        (Wanted { send_clock: 33, reduction: 512, hold: 1, ..default() }, 2, 11),
        (Wanted { phase: 0, ..default() }, 2, 12),
        (Wanted { phase: 5, ..default() }, 2, 12),
        (Wanted { hold: 0, ..default() }, 2, 16),
        (Wanted { hold: 481, ..default() }, 2, 16),
        (Wanted { tags: [0, 0xC000, 0xA000], ..default() }, 2, 17),
        (Wanted { tags: [0xA000, 0xC000, 0xA000], ..default() }, 2, 17),
        (Wanted { tags: [0xC001, 0xC000, 0xA000], ..default() }, 2, 17),
        (Wanted { alarm_properties: 2, ..default() }, 4, 6),
        (Wanted { retries: 2, ..default() }, 4, 8),
        (Wanted { retries: 16, ..default() }, 4, 8),
        (Wanted { tags: [0xC000, 0, 0xA000], ..default() }, 4, 11),
        (Wanted { tags: [0xC000, 0xC000, 0], ..default() }, 4, 12),
        (Wanted { more: unknown, ..default() }, 0x40, 1),
        (Wanted { more: again, ..default() }, 1, 0),
        (Wanted { more: vec![1], ..default() }, 0x40, 0),
    ] {
        let mut bench = Bench::new();
        let answer = bench.call(0, &wanted.blocks());
        assert_eq!(answer.status, u32::from_be_bytes([0xDB, 0x81, code1, code2]), "{wanted:?}");
        assert_eq!((answer.blocks, bench.device.state()), (vec![], State::Unconnected));
        // And no inputs are sent.
        bench.now += CYCLE_US;
        assert_eq!(bench.sent().len(), 0);
    }
}

/// IEC 61158-6-10, RPCObjectUUID: instance, device and vendor number identify a device.
#[test]
fn connect_for_the_object_of_another_device_is_rejected() {
    let blocks = Wanted::default().blocks();
    for is_low_first in [true, false] {
        // A byte of the vendor, device and instance number.
        for at in [22, 20, 19] {
            let mut bench = Bench::new();
            let mut request = datagram(is_low_first, 0, 1, 0, &arguments(is_low_first, &blocks));
            request[at] ^= 1;
            assert_eq!(bench.device.receive_datagram(bench.now, HOST, &request), None);
            let [(Some(HOST), answer)] = &bench.transmitted()[..] else { panic!("{at}") };
            let status: [u8; 4] = answer[80..].try_into().unwrap();
            let status = if is_low_first { u32::from_le_bytes(status) } else { u32::from_be_bytes(status) };
            assert_eq!((answer[1], status), (6, 0x1C01_0017), "{at}");
            assert_eq!(bench.device.state(), State::Unconnected);
            assert_eq!(bench.device.counters().rpc_refused, 1);
        }
    }
}

#[test]
fn cycles_hold_times_and_addresses_at_their_limits_are_accepted() {
    let default = Wanted::default;
    for wanted in [
        Wanted { send_clock: 32, reduction: 1, ..default() },
        Wanted { send_clock: 1, reduction: 32, ..default() },
        Wanted { send_clock: 128, reduction: 128, ..default() },
        Wanted { send_clock: 32, reduction: 512, ..default() },
        Wanted { phase: 4, ..default() },
        Wanted { hold: 480, ..default() },
        Wanted { name: &[b'a'; 240], ..default() },
        Wanted { tags: [0xD000, 0xD000, 0xB000], ..default() },
        Wanted { data_len: 1_440, ..default() },
        Wanted { retries: 15, ..default() },
        Wanted { mac: MacAddress([0, 0, 0, 0, 0, 1]), ..default() },
    ] {
        assert_eq!(Bench::new().call(0, &wanted.blocks()).status, 0, "{wanted:?}");
    }
}

#[test]
fn data_without_a_place_in_its_frame_is_an_error() {
    for placed in [[false, true, true], [true, false, true], [true, true, false]] {
        let mut bench = Bench::new();
        let answer = bench.call(0, &Wanted { placed, ..Wanted::default() }.blocks());
        assert_eq!((answer.status, bench.device.state()), (0xDB81_0215, State::Unconnected), "{placed:?}");
    }
    // The data of a missing module needs no place.
    let wanted = Wanted { placed: [true, true, false], modules: [0x20, 0x99], ..Wanted::default() };
    assert_eq!(Bench::new().call(0, &wanted.blocks()).status, 0);
}

/// Otherwise data could be mistaken for its own status.
#[test]
fn overlapping_parts_of_a_frame_are_rejected() {
    let blocks = Wanted::default().blocks();
    // Offsets in the second frame: outputs of slot 2 (2 bytes and a status), and the consumer statuses after them.
    let frame = blocks.windows(2).rposition(|pair| pair == [0x01, 0x02]).unwrap();
    let second = frame + 4 + usize::from(u16::from_be_bytes([blocks[frame + 2], blocks[frame + 3]]));
    let (consumers, outputs) = (second - 4 * 6, second - 4 * 6 - 2 - 2);
    assert_eq!(
        (blocks[outputs..outputs + 2].to_vec(), blocks[consumers + 4..consumers + 6].to_vec()),
        (vec![0, 2], vec![0, 5])
    );
    for (at, offset, status) in [
        (outputs, 0, 0xDB81_0218),
        (outputs, 1, 0xDB81_0218),
        (outputs, 3, 0xDB81_021C),
        (consumers + 4, 4, 0xDB81_021C),
        (consumers + 4, 6, 0xDB81_021C),
        (outputs, 2, 0),
        (outputs, 9, 0),
        (consumers + 4, 39, 0),
        (consumers + 4, 40, 0xDB81_021C),
    ] {
        let mut changed = blocks.clone();
        changed[at + 1] = offset;
        assert_eq!(Bench::new().call(0, &changed).status, status, "{at} {offset}");
    }
}

/// The limit covers data and a consumer status for the maximum number of submodules.
#[test]
fn frame_has_at_most_32_parts() {
    // The status of a missing module may be repeated.
    let wanted = |statuses| Wanted { modules: [0x20, 0x99], statuses, ..Wanted::default() };
    assert_eq!(Bench::new().call(0, &wanted(26).blocks()).status, 0);
    assert_eq!(Bench::new().call(0, &wanted(27).blocks()).status, 0xDB81_021C);
}

#[test]
fn missing_blocks_are_reported() {
    let blocks = Wanted::default().blocks();
    let mut cut = vec![];
    let mut rest = &blocks[..];
    while !rest.is_empty() {
        let len = 4 + usize::from(u16::from_be_bytes([rest[2], rest[3]]));
        cut.push(rest[..len].to_vec());
        rest = &rest[len..];
    }
    for (missing, status) in [(0, 0xDB81_0100), (1, 0xDB81_4002), (2, 0xDB81_4002), (3, 0xDB81_4003)] {
        let mut some = cut.clone();
        some.remove(missing);
        assert_eq!(Bench::new().call(0, &some.concat()).status, status, "{missing}");
    }
    // A place in a frame for a submodule that is not expected.
    cut.remove(5);
    assert_eq!(Bench::new().call(0, &cut.concat()).status, 0xDB81_0216);
    assert_eq!(Bench::new().call(0, &[]).status, 0xDB81_0100);
}

#[test]
fn truncated_connect_is_rejected() {
    let blocks = Wanted::default().blocks();
    for len in 0..blocks.len() {
        let mut bench = Bench::new();
        assert_ne!(bench.call(0, &blocks[..len]).status, 0, "{len}");
        assert_eq!(bench.device.state(), State::Unconnected);
    }
}

#[test]
fn frame_identifiers_of_both_ranges_are_accepted_and_chosen_if_left_open() {
    for (class, asked, given) in [
        (1, 0x8000, 0x8000),
        (1, 0xBBFF, 0xBBFF),
        (1, 0xC000, 0xC000),
        (1, 0xFBFF, 0xFBFF),
        (1, 0xFFFF, 0xC000),
        (2, 0xFFFF, 0x8000),
    ] {
        let wanted = Wanted { class, input_id: asked, output_id: asked, ..Wanted::default() };
        let answer = Bench::new().call(0, &wanted.blocks());
        let ids: Vec<u16> = blocks_of(&answer.blocks)
            .iter()
            .filter(|(kind, _)| *kind == 0x8102)
            .map(|(_, body)| u16::from_be_bytes([body[4], body[5]]))
            .collect();
        assert_eq!(ids, [given, given], "{asked:X}");
    }
}

#[test]
fn mismatching_modules_are_reported_as_differences() {
    let default = Wanted::default;
    for (wanted, expected) in [
        // A wrong module, including its submodules.
        (
            Wanted { modules: [0x99, 0x30], ..default() },
            &[0, 1, 0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0x20, 0, 1, 0, 0][..],
        ),
        // A wrong submodule.
        (
            Wanted { submodules: [0x21, 0x99], ..default() },
            &[0, 1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0x30, 0, 2, 0, 1, 0, 1, 0, 0, 0, 0x31, 0x90, 0],
        ),
        // A module without a slot, with a submodule.
        (
            Wanted {
                more: block(
                    0x0104,
                    &[
                        0, 1, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0x40, 0, 0, 0, 1, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0,
                        0, 1, 1,
                    ],
                ),
                submodules: [0x21, 0x99],
                ..default()
            },
            &[
                0, 1, 0, 0, 0, 0, 0, 2, 0, 2, 0, 0, 0, 0x30, 0, 2, 0, 1, 0, 1, 0, 0, 0, 0x31, 0x90, 0, 0, 9,
                0, 0, 0, 0, 0, 0, 0, 0,
            ],
        ),
        // Data of another length.
        (
            Wanted { output_len: 1, ..default() },
            &[0, 1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0x30, 0, 2, 0, 1, 0, 1, 0, 0, 0, 0x31, 0x90, 0],
        ),
    ] {
        let mut bench = Bench::new();
        let answer = bench.call(0, &wanted.blocks());
        let blocks = blocks_of(&answer.blocks);
        assert_eq!(blocks.last(), Some(&(0x8104, expected.to_vec())), "{wanted:?}");
        // Without a place for all outputs, none of them count.
        bench.call(4, &control(0x0110, AR, 1));
        let calls = bench.calls();
        assert_eq!(bench.confirm(&calls[0]), Some(Event::Connected));
        assert_eq!(bench.outputs([1, 2, 3]), None);
        assert_eq!(bench.device.outputs(), &[0; 3]);
    }
}

#[test]
fn second_controller_is_rejected_and_the_first_continues() {
    let mut bench = Bench::in_data();
    let second = Wanted { uuid: [0xB6; 16], mac: OTHER, ..Wanted::default() };
    assert_eq!(bench.call(0, &second.blocks()).status, 0xDB81_4004);
    assert_eq!(bench.outputs([1, 2, 3]), Some(Event::Outputs));
    // It cannot release, end parameters or send outputs either.
    assert_eq!(bench.call(1, &control(0x0114, [0xB6; 16], 4)).status, 0xDC81_4005);
    assert_eq!(bench.call(4, &control(0x0110, [0xB6; 16], 1)).status, 0xDD81_4005);
    let mut frame = outputs_frame([9; 3], 0x7000, [0x80; 2], 0x35);
    frame[6..12].copy_from_slice(&OTHER.0);
    assert_eq!(bench.device.receive(bench.now, &frame), None);
    assert_eq!(bench.device.outputs(), &[1, 2, 3]);
}

#[test]
fn reconnecting_controller_starts_again() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    let answer = bench.call(0, &Wanted::default().blocks());
    assert_eq!((answer.event, answer.status), (Some(Event::Left(Cause::Aborted)), 0));
    assert_eq!((bench.device.outputs(), bench.device.state()), (&[0; 3], State::Parameters));
    // The alarm connection has a new reference.
    assert_eq!(blocks_of(&answer.blocks)[3].1, [0, 1, 0, 2, 0, 200]);
}

#[test]
fn repeated_call_is_executed_once_and_gets_the_same_answer() {
    let mut bench = Bench::new();
    let request = datagram(false, 0, 5, 0, &arguments(false, &Wanted::default().blocks()));
    assert_eq!(bench.device.receive_datagram(bench.now, HOST, &request), None);
    assert_eq!(bench.device.poll_timeout(bench.now), bench.now, "the answer is due");
    let is_answer = |(to, _): &(Option<Endpoint>, Vec<u8>)| *to == Some(HOST);
    let first: Vec<_> = bench.transmitted().into_iter().filter(is_answer).collect();
    assert_eq!(bench.device.receive_datagram(bench.now, HOST, &request), None);
    let second: Vec<_> = bench.transmitted().into_iter().filter(is_answer).collect();
    assert_eq!((first.len(), &second), (1, &first));
    // Big-endian, like the request.
    assert_eq!(first[0].1[68..74], [0, 0, 0xFF, 0xFF, 0xFF, 0xFF]);
    assert_eq!(first[0].1[64..68], [0, 0, 0, 5]);
    assert_eq!(first[0].1[56..60], [0, 0, 0xB0, 7], "this start of the device");
    assert_eq!(first[0].1[100..102], [0x81, 0x01]);
}

#[test]
fn first_call_is_served_for_any_endpoint_and_activity() {
    let unset = Endpoint { address: [0; 4], port: 0 };
    let mut request = datagram(true, 0, 0, 5, &arguments(true, &record(9, [0; 16], 0, 1, 0xAFF0, 64)));
    request[40..56].fill(0);
    let mut bench = Bench::new();
    bench.device.receive_datagram(bench.now, unset, &request);
    let sent = bench.transmitted();
    let answer = Answer::of(None, &sent[0].1);
    assert_eq!((answer.kind, answer.status, answer.blocks.len()), (2, 0, 64 + 60));
}

#[test]
fn only_identification_can_be_read_without_a_connection() {
    let mut bench = Bench::new();
    let answer = bench.call(5, &record(9, [0; 16], 0, 1, 0xAFF0, 64));
    assert_eq!((answer.status, answer.blocks.len()), (0, 64 + 60));
    assert_eq!(bench.call(5, &record(9, [0; 16], 0, 0, 0xE000, 4_096)).status, 0xDE80_A900);
    assert_eq!(bench.call(2, &record(9, [0; 16], 0, 1, 0xAFF0, 64)).status, 0xDE80_B600);
}

#[test]
fn invalid_calls_are_rejected_or_ignored() {
    let blocks = arguments(true, &Wanted::default().blocks());
    let good = datagram(true, 0, 1, 0, &blocks);
    let change = |at: usize, value: u8| {
        let mut changed = good.clone();
        changed[at] = value;
        changed
    };
    let cases = [
        // A fragment, authentication, another interface, another operation, invalid arguments.
        (change(2, 0x24), Some((6, 0x1C01_000B))),
        (change(76, 1), Some((6, 0x1C01_000B))),
        (change(78, 1), Some((6, 0x1C01_000B))),
        (good[..200].to_vec(), Some((6, 0x1C01_000B))),
        (change(24, 9), Some((6, 0x1C01_0003))),
        (change(68, 9), Some((6, 0x1C01_0002))),
        (change(92, 1), Some((3, 0x1C01_000B))),
        (change(84, 1), Some((3, 0x1C01_000B))),
        // Another version, an answer, an acknowledgement, a truncated header.
        (change(0, 5), None),
        (change(1, 2), None),
        (change(1, 7), None),
        (good[..79].to_vec(), None),
    ];
    for (request, expected) in cases {
        let mut bench = Bench::new();
        assert_eq!(bench.device.receive_datagram(bench.now, HOST, &request), None);
        let answers = bench.transmitted();
        let said = answers.first().map(|(_, bytes)| {
            let answer = Answer::of(None, bytes);
            (answer.kind, answer.status)
        });
        assert_eq!(said, expected, "{:02X?}", &request[..80.min(request.len())]);
        assert_eq!(bench.device.counters().rpc_refused, expected.is_some().into());
        assert_eq!(bench.device.state(), State::Unconnected);
    }
}

#[test]
fn ping_repeats_the_answer_to_a_known_call_and_reports_an_unknown_one() {
    let mut bench = Bench::new();
    let request = datagram(true, 0, 9, 5, &arguments(true, &record(9, [0; 16], 0, 1, 0xAFF0, 64)));
    bench.device.receive_datagram(bench.now, HOST, &request);
    let first = bench.transmitted();
    bench.device.receive_datagram(bench.now, HOST, &datagram(true, 1, 9, 5, &[]));
    assert_eq!(bench.transmitted(), first);
    bench.device.receive_datagram(bench.now, HOST, &datagram(true, 1, 10, 5, &[]));
    let answers = bench.transmitted();
    assert_eq!((answers[0].1[1], answers[0].1.len()), (5, 80));
}

#[test]
fn unfinished_parameters_time_out() {
    let mut bench = Bench::new();
    bench.call(0, &Wanted::default().blocks());
    bench.now += 900_000;
    // A write or a read restarts the time-out.
    bench.call(2, &record(9, AR, 0, 1, 0xAFF0, 64));
    bench.now += 999_999;
    assert_eq!(bench.poll(), None);
    bench.now += 1;
    assert_eq!(bench.poll(), Some(Event::Left(Cause::Silence)));
    let frames = bench.acyclic();
    assert_eq!(frames[0][18..20], [0xFE, 0x01], "sent to the controller");
    assert_eq!(frames[0][32..36], [0xCF, 0x81, 0xFD, 5]);
}

#[test]
fn missing_confirmation_is_requested_five_times() {
    let mut bench = Bench::new();
    bench.call(0, &Wanted::default().blocks());
    bench.call(4, &control(0x0110, AR, 1));
    let mut calls = 0;
    let start = bench.now;
    let event = loop {
        calls += bench.calls().len();
        if let Some(event) = bench.poll() {
            break event;
        }
        bench.now += 100_000;
        assert!(bench.now < start + 60_000_000);
    };
    assert_eq!((event, calls, bench.now - start), (Event::Left(Cause::NotConfirmed), 5, 10_000_000));
}

#[test]
fn only_the_controllers_own_confirmation_counts() {
    let ready = || {
        let mut bench = Bench::new();
        bench.call(0, &Wanted::default().blocks());
        bench.call(4, &control(0x0110, AR, 1));
        let call = bench.calls().remove(0);
        (bench, call)
    };
    let (mut bench, call) = ready();
    assert_eq!(bench.confirm_as(&call, [1; 16], 8, 0), None);
    assert_eq!(bench.confirm_as(&call, AR, 2, 0), None);
    assert_eq!(bench.confirm_as(&call, AR, 8, 1), None);
    let mut other = call.clone();
    other[64] ^= 1;
    assert_eq!(bench.confirm(&other), None, "another call");
    other = call.clone();
    other[40] ^= 1;
    assert_eq!(bench.confirm(&other), None, "another activity");
    assert_eq!(bench.confirm(&call), Some(Event::Connected));
    // There is nothing to confirm before the call has been sent.
    let mut bench = Bench::new();
    bench.call(0, &Wanted::default().blocks());
    assert_eq!(bench.confirm(&call), None);
    assert_eq!(bench.device.state(), State::Parameters);
    let end = datagram(true, 0, 9, 4, &arguments(true, &control(0x0110, AR, 1)));
    bench.device.receive_datagram(bench.now, HOST, &end);
    assert_eq!(bench.confirm(&call), None);
    assert_eq!(bench.device.state(), State::Ready);
    assert_eq!(bench.calls(), [&call[..]]);
    assert_eq!(bench.confirm(&call), Some(Event::Connected));
}

#[test]
fn end_of_parameters_is_accepted_once_and_only_with_its_command() {
    let mut bench = Bench::new();
    bench.call(0, &Wanted::default().blocks());
    assert_eq!(bench.call(4, &control(0x0110, AR, 2)).status, 0xDD81_1608);
    assert_eq!(bench.call(4, &control(0x0111, AR, 1)).status, 0xDD81_4005);
    assert_eq!(bench.call(4, &[]).status, 0xDD81_4005);
    assert_eq!(bench.call(4, &control(0x0110, AR, 1)).status, 0);
    assert_eq!(bench.call(4, &control(0x0110, AR, 1)).status, 0xDD81_4006);
}

#[test]
fn release_ends_the_connection_and_is_reported() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    assert_eq!(bench.call(1, &control(0x0114, AR, 1)).status, 0xDC81_2808);
    let answer = bench.call(1, &control(0x0114, AR, 4));
    assert_eq!((answer.event, answer.status), (Some(Event::Left(Cause::Released)), 0));
    assert_eq!(answer.blocks, control(0x8114, AR, 8));
    assert_eq!((bench.device.outputs(), bench.device.state()), (&[0; 3], State::Unconnected));
    bench.now += 100_000;
    assert_eq!(bench.sent().len(), 0, "neither inputs nor RTA-ERR");
    assert_eq!(bench.call(1, &control(0x0114, AR, 4)).status, 0xDC81_4005);
}

// --- Cyclic data

fn input_frames(bench: &mut Bench) -> Vec<Vec<u8>> {
    let frames = bench.sent().into_iter();
    frames.filter(|frame| frame[12..14] == [0x81, 0] && frame[18..20] == INPUT_ID.to_be_bytes()).collect()
}

#[test]
fn inputs_are_sent_each_cycle_with_statuses_and_a_counter_of_31_us() {
    let mut bench = Bench::in_data();
    bench.device.show_inputs(&[0xAA, 0xBB]);
    let start = bench.device.poll_timeout(bench.now);
    bench.now = start;
    let frames = input_frames(&mut bench);
    let [frame] = &frames[..] else { panic!("{frames:?}") };
    assert_eq!(frame[..20], [&PLC.0[..], &DEVICE.0, &[0x81, 0, 0xC0, 0, 0x88, 0x92, 0xC0, 1]].concat());
    // Statuses of the three submodules of slot 0, data and status of slot 1, consumer statuses.
    assert_eq!(frame[20..28], [0x80, 0x80, 0x80, 0xAA, 0xBB, 0x80, 0x80, 0x80]);
    assert_eq!(frame[28..60], [0; 32]);
    assert_eq!(frame[62..], [0x35, 0]);
    let counter = |frame: &[u8]| u16::from_be_bytes([frame[60], frame[61]]);
    let first = counter(frame);
    for cycle in 1..=20_u16 {
        bench.now += CYCLE_US - 1;
        assert_eq!(input_frames(&mut bench).len(), 0);
        assert_eq!(bench.device.poll_timeout(bench.now), bench.now + 1);
        bench.now += 1;
        let frames = input_frames(&mut bench);
        assert_eq!(counter(&frames[0]), first.wrapping_add(128 * cycle));
        bench.outputs([0; 3]);
    }
    // Late by two and a half cycles: one frame is sent, and the counter skips the missed cycles.
    bench.now += CYCLE_US * 7 / 2;
    let frames = input_frames(&mut bench);
    assert_eq!((frames.len(), counter(&frames[0])), (1, first.wrapping_add(128 * 21)));
    assert_eq!(
        bench.device.poll_timeout(bench.now).min(bench.now + CYCLE_US / 2),
        bench.now + HOLD_US - CYCLE_US * 7 / 2
    );
}

#[test]
fn inputs_are_bad_until_parameters_end_and_faults_show_in_the_data_status() {
    let mut bench = Bench::new();
    bench.call(0, &Wanted::default().blocks());
    bench.now += CYCLE_US;
    let frames = input_frames(&mut bench);
    assert_eq!(frames[0][20..28], [0, 0, 0, 0, 0, 0, 0, 0]);
    bench.call(4, &control(0x0110, AR, 1));
    bench.device.show_faults(1);
    bench.now += CYCLE_US;
    let frames = input_frames(&mut bench);
    assert_eq!((&frames[0][25..28], frames[0][62]), (&[0x80; 3][..], 0x15));
}

#[test]
fn outputs_count_only_with_good_statuses() {
    for (statuses, status, expected) in [
        ([0x80, 0x80], 0x35, Some(Event::Outputs)),
        // A problem of the controller does not matter.
        ([0x80, 0x80], 0x15, Some(Event::Outputs)),
        ([0x00, 0x80], 0x35, Some(Event::Cleared)),
        ([0x80, 0x60], 0x35, Some(Event::Cleared)),
        // Stopped; a backup controller.
        ([0x80, 0x80], 0x25, Some(Event::Cleared)),
        ([0x80, 0x80], 0x34, Some(Event::Cleared)),
        // Not valid: ignored.
        ([0x80, 0x80], 0x31, None),
    ] {
        let mut bench = Bench::in_data();
        bench.outputs([1, 2, 3]);
        let frame = outputs_frame([4, 5, 6], 0x4000, statuses, status);
        assert_eq!(bench.device.receive(bench.now, &frame), expected, "{statuses:?} {status:X}");
        let outputs = match expected {
            Some(Event::Outputs) => [4, 5, 6],
            Some(_) => [0; 3],
            None => [1, 2, 3],
        };
        assert_eq!(bench.device.outputs(), &outputs);
        // Reported once.
        let again = outputs_frame([4, 5, 6], 0x4080, statuses, status);
        let expected = expected.filter(|event| *event == Event::Outputs);
        assert_eq!(bench.device.receive(bench.now, &again), expected);
    }
}

#[test]
fn old_repeated_and_foreign_frames_are_ignored() {
    let mut bench = Bench::in_data();
    let mut take = |frame: &[u8]| bench.device.receive(bench.now, frame);
    let at = |counter| outputs_frame([1, 2, 3], counter, [0x80; 2], 0x35);
    assert_eq!(take(&at(0x1000)), Some(Event::Outputs));
    assert_eq!(take(&at(0x1000)), None, "repeated");
    assert_eq!(take(&at(0x0F80)), None, "older");
    assert_eq!(take(&at(0x1000_u16.wrapping_sub(4_095))), None);
    assert_eq!(take(&at(0x1000_u16.wrapping_add(61_440))), Some(Event::Outputs), "maximum advance");
    let next = at(0x1000_u16.wrapping_add(61_441));
    for (place, value) in [(0, 0x12), (6, 0x12), (19, 2), (17, 0x93)] {
        let mut other = next.clone();
        other[place] = value;
        assert_eq!(take(&other), None, "{place}");
    }
    for len in 0..next.len() {
        assert_eq!(take(&next[..len]), None, "{len}");
    }
    let mut marked = next.clone();
    *marked.last_mut().unwrap() = 1;
    assert_eq!(take(&marked), None, "transfer status not 0");
    assert_eq!(take(&[&next[..], &[0]].concat()), None, "too long");
    assert_eq!(take(&next), Some(Event::Outputs));
}

#[test]
fn silent_controller_times_out_after_its_hold_time() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    bench.now += HOLD_US - 1;
    assert_eq!((bench.poll(), bench.device.outputs()), (None, &[1, 2, 3]));
    bench.now += 1;
    assert_eq!(bench.poll(), Some(Event::Left(Cause::Silence)));
    assert_eq!(bench.device.poll_timeout(bench.now), bench.now, "RTA-ERR is due");
    assert_eq!((bench.device.outputs(), bench.device.state()), (&[0; 3], State::Unconnected));
    assert_eq!(
        bench.acyclic()[0][18..34],
        [0xFE, 1, 0, 3, 0, 1, 0x14, 1, 0xFF, 0xFE, 0xFF, 0xFE, 0, 4, 0xCF, 0x81]
    );
    // The controller can connect again.
    assert_eq!(bench.call(0, &Wanted::default().blocks()).status, 0);
}

#[test]
fn ignored_frames_do_not_restart_the_hold_time() {
    for (counter, status) in [(0x1000, 0x35), (0x0F80, 0x35), (0x1080, 0x31)] {
        let mut bench = Bench::in_data();
        let good = outputs_frame([1, 2, 3], 0x1000, [0x80; 2], 0x35);
        assert_eq!(bench.device.receive(bench.now, &good), Some(Event::Outputs));
        bench.now += HOLD_US - 1;
        let other = outputs_frame([4, 5, 6], counter, [0x80; 2], status);
        assert_eq!(bench.device.receive(bench.now, &other), None);
        assert_eq!(bench.device.outputs(), &[1, 2, 3]);
        bench.now += 1;
        assert_eq!(bench.poll(), Some(Event::Left(Cause::Silence)), "{counter:X} {status:X}");
    }
}

/// Frames may queue up while the caller is busy.
#[test]
fn outputs_after_the_hold_time_do_not_count_even_without_a_poll() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    bench.now += HOLD_US - 1;
    assert_eq!(bench.outputs([4, 5, 6]), Some(Event::Outputs));
    bench.now += HOLD_US;
    assert_eq!(bench.outputs([7, 8, 9]), Some(Event::Left(Cause::Silence)));
    assert_eq!((bench.outputs([7, 8, 9]), bench.device.outputs()), (None, &[0; 3]));
}

// --- Alarms

/// Returns an RTA frame of the controller: type, sequence numbers, data.
fn rta(is_high: bool, kind: u8, number: u16, acknowledged: u16, data: &[u8]) -> Vec<u8> {
    let id: u16 = if is_high { 0xFC01 } else { 0xFE01 };
    [
        &DEVICE.0[..],
        &PLC.0,
        &[0x88, 0x92],
        &id.to_be_bytes(),
        &[0, 1],
        &PLC_REFERENCE.to_be_bytes(),
        &[kind, 0x11],
        &number.to_be_bytes(),
        &acknowledged.to_be_bytes(),
        &(data.len() as u16).to_be_bytes(),
        data,
    ]
    .concat()
}

/// Returns the controller's acknowledgement of an alarm of this type and number.
fn alarm_ack(is_high: bool, kind: u8, number: u16) -> Vec<u8> {
    let body = [&[0, kind, 0, 0, 0, 0, 0, 0, 0, 1][..], &number.to_be_bytes(), &[0; 4]].concat();
    block(if is_high { 0x8001 } else { 0x8002 }, &body)
}

/// Returns the RTA frames sent now, from the frame identifier on.
fn alarms(bench: &mut Bench) -> Vec<Vec<u8>> {
    let mut all = bench.acyclic();
    all.retain(|frame| frame[12..14] == [0x81, 0] && matches!(frame[18..20], [0xFE | 0xFC, 1]));
    all.into_iter().map(|frame| frame[18..].to_vec()).collect()
}

#[test]
fn fault_is_reported_acknowledged_twice_and_cleared() {
    let mut bench = Bench::in_data();
    bench.device.show_faults(0b001);
    assert_eq!(bench.poll(), None);
    let sent = alarms(&mut bench);
    let expected = [
        // References, data, window and immediate acknowledgement, sequence numbers, length.
        &[0xFE, 1, 0, 3, 0, 1, 0x11, 0x11, 0xFF, 0xFF, 0xFF, 0xFE, 0, 34][..],
        // Channel diagnosis of slot 0, subslot 1, for the whole submodule: appears.
        &[0, 2, 0, 30, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0x10, 0, 0, 0, 0x11, 0xA8, 0],
        &[0x80, 0, 0x80, 0, 0x08, 0, 0x01, 0x00],
    ]
    .concat();
    assert_eq!(sent, [expected]);

    // The transport's acknowledgement stops the retries. The alarm's own acknowledgement is acknowledged in turn.
    let now = bench.now;
    assert_eq!(bench.device.receive(now, &rta(false, 0x13, 0xFFFE, 0xFFFF, &[])), None);
    assert_eq!(bench.device.receive(now, &rta(false, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(false, 1, 0))), None);
    assert_eq!(alarms(&mut bench)[0][..14], [0xFE, 1, 0, 3, 0, 1, 0x13, 1, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0]);
    assert_eq!((bench.poll(), alarms(&mut bench)), (None, vec![]), "reported once");

    bench.device.show_faults(0);
    bench.poll();
    let sent = alarms(&mut bench);
    // The next sequence number; disappears, with the next alarm number, and no fault left.
    assert_eq!(sent[0][8..12], [0, 0, 0xFF, 0xFF]);
    assert_eq!(sent[0][20..22], [0, 0x0C]);
    assert_eq!(sent[0][38..], [0x08, 1, 0x80, 0, 0x80, 0, 0x10, 0, 0x01, 0x00]);
}

#[test]
fn each_fault_is_reported_once_when_it_appears_and_disappears() {
    let mut bench = Bench::in_data();
    let (mut sequence, mut number, mut ours) = (0xFFFF_u16, 0, 0xFFFF_u16);
    let following = |number: u16| number.wrapping_add(1) & 0x7FFF;
    // Present faults, and the expected alarm: fault, and whether it appears.
    for (faults, told) in [
        (0b001, Some((0x0100, true))),
        (0b101, Some((0x0102, true))),
        (0b101, None),
        (0b100, Some((0x0100, false))),
        (0b100, None),
        (0b101, Some((0x0100, true))),
        (0b001, Some((0x0102, false))),
        (0b000, Some((0x0100, false))),
        (0b000, None),
    ] {
        bench.device.show_faults(faults);
        assert_eq!(bench.poll(), None);
        let sent = alarms(&mut bench);
        let found = sent.first().map(|alarm| {
            let word = |at: usize| u16::from_be_bytes([alarm[at], alarm[at + 1]]);
            assert_eq!(word(8), ours, "sequence number of the transport");
            assert_eq!(word(38) & 0x07FF, number, "number of the alarm");
            // Whether the submodule and the connection have any diagnosis.
            assert_eq!(word(38) & 0xA000, if faults == 0 { 0 } else { 0xA000 });
            (word(46), word(20) == 1)
        });
        assert_eq!((sent.len(), found), (usize::from(told.is_some()), told), "{faults:b}");
        if let Some((_, appears)) = told {
            let ack = alarm_ack(false, if appears { 1 } else { 0x0C }, number);
            bench.device.receive(bench.now, &rta(false, 0x11, sequence, ours, &ack));
            assert_eq!(bench.device.poll_timeout(bench.now), bench.now, "the acknowledgement is due");
            assert_eq!(alarms(&mut bench).len(), 1);
            (sequence, ours, number) = (following(sequence), following(ours), number + 1);
        }
    }
}

#[test]
fn alarm_is_due_at_once_and_again_after_its_time_out() {
    let mut bench =
        Bench::in_data_as(&Wanted { send_clock: 128, reduction: 128, hold: 3, ..Wanted::default() });
    bench.sent();
    bench.device.show_faults(1);
    bench.poll();
    assert_eq!(bench.device.poll_timeout(bench.now), bench.now);
    assert_eq!(alarms(&mut bench).len(), 1);
    assert_eq!(bench.device.poll_timeout(bench.now), bench.now + 100_000);
}

#[test]
fn only_the_acknowledgement_of_the_reported_alarm_ends_it() {
    let mut bench = Bench::in_data();
    bench.device.show_faults(1);
    bench.poll();
    assert_eq!(alarms(&mut bench).len(), 1);
    let mut sequence = 0xFFFF_u16;
    // Of the other priority, of another alarm, or none: the frame is acknowledged, but the alarm stays pending.
    for ack in [alarm_ack(true, 1, 0), alarm_ack(false, 1, 1), block(0x8002, &[0; 4]), vec![]] {
        bench.device.receive(bench.now, &rta(false, 0x11, sequence, 0xFFFF, &ack));
        assert_eq!(alarms(&mut bench)[0][6], 0x13);
        // A repeated frame is acknowledged again, one out of sequence is not.
        bench.device.receive(bench.now, &rta(false, 0x11, sequence, 0xFFFF, &ack));
        assert_eq!(alarms(&mut bench).len(), 1);
        let ahead = rta(false, 0x11, sequence.wrapping_add(2) & 0x7FFF, 0xFFFF, &alarm_ack(false, 1, 0));
        bench.device.receive(bench.now, &ahead);
        assert_eq!(alarms(&mut bench).len(), 0);
        bench.device.show_faults(0);
        bench.poll();
        assert_eq!(alarms(&mut bench).len(), 0, "the alarm for the cleared fault waits");
        sequence = sequence.wrapping_add(1) & 0x7FFF;
    }
    bench.device.receive(bench.now, &rta(false, 0x11, sequence, 0xFFFF, &alarm_ack(false, 1, 0)));
    bench.poll();
    assert_eq!(alarms(&mut bench).len(), 2, "the acknowledgement, and the alarm for the cleared fault");
}

#[test]
fn high_priority_alarm_does_not_wait_for_a_low_priority_one() {
    let mut bench = Bench::in_data();
    bench.device.show_faults(0b101);
    bench.poll();
    assert_eq!(alarms(&mut bench).len(), 1, "one at a time");
    bench.device.show_faults(0b111);
    bench.poll();
    let sent = alarms(&mut bench);
    assert_eq!((sent.len(), &sent[0][..2], &sent[0][14..16]), (1, &[0xFC, 1][..], &[0, 1][..]));
    let now = bench.now;
    bench.device.receive(now, &rta(true, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(true, 1, 0)));
    assert_eq!(alarms(&mut bench)[0][6], 0x13);
    // The low-priority acknowledgement, and the next low-priority alarm.
    bench.device.receive(now, &rta(false, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(false, 1, 0)));
    bench.poll();
    let sent = alarms(&mut bench);
    assert_eq!((sent.len(), sent[1][46..].to_vec()), (2, vec![0x01, 0x02]));
}

#[test]
fn all_alarms_are_low_if_the_controller_requests_it() {
    let mut bench = Bench::in_data_as(&Wanted { alarm_properties: 1, ..Wanted::default() });
    bench.device.show_faults(0b010);
    bench.poll();
    assert_eq!(alarms(&mut bench)[0][..2], [0xFE, 1]);
}

#[test]
fn unacknowledged_alarm_is_repeated_and_ends_the_connection() {
    let mut bench = Bench::in_data();
    bench.device.show_faults(1);
    let start = bench.now;
    let mut sent = 0;
    let event = loop {
        // The controller keeps sending outputs.
        bench.outputs([0; 3]);
        if let Some(event) = bench.poll() {
            break event;
        }
        sent += alarms(&mut bench).len();
        bench.now += 4_000;
        assert!(bench.now < start + 10_000_000);
    };
    // Three retries, at intervals of 100 ms.
    assert_eq!((event, sent, bench.now - start), (Event::Left(Cause::AlarmFailed), 4, 400_000));
    assert_eq!(bench.acyclic()[0][35], 8);
}

#[test]
fn foreign_rta_frames_and_wrong_numbers_change_nothing() {
    let mut bench = Bench::in_data();
    bench.device.show_faults(1);
    bench.poll();
    assert_eq!(alarms(&mut bench).len(), 1);
    let good = rta(false, 0x13, 0xFFFE, 0xFFFF, &[]);
    for (at, value) in [(6, 0x12), (17, 9), (19, 9), (24, 0x12)] {
        let mut other = good.clone();
        other[at] = value;
        assert_eq!(bench.device.receive(bench.now, &other), None);
    }
    for len in 0..good.len() {
        assert_eq!(bench.device.receive(bench.now, &good[..len]), None);
    }
    for _ in 0..30 {
        bench.now += 4_000;
        bench.outputs([0; 3]);
    }
    assert_eq!(alarms(&mut bench).len(), 1, "still retried");
}

#[test]
fn abort_by_the_controller_ends_the_connection() {
    let mut bench = Bench::in_data();
    bench.outputs([1, 2, 3]);
    let abort = rta(false, 0x14, 0xFFFE, 0xFFFE, &[0xCF, 0x81, 0xFD, 0x0F]);
    assert_eq!(bench.device.receive(bench.now, &abort), Some(Event::Left(Cause::Aborted)));
    assert_eq!(bench.device.outputs(), &[0; 3]);
    assert_eq!(bench.acyclic(), Vec::<Vec<u8>>::new(), "no answer to an abort");
}

// --- Records

fn read(bench: &mut Bench, uuid: [u8; 16], slot: u16, subslot: u16, index: u16) -> Result<Vec<u8>, u32> {
    let answer = bench.call(2, &record(9, uuid, slot, subslot, index, 4_096));
    let (head, data) = answer.blocks.split_at(64);
    assert_eq!(head[..6], [0x80, 0x09, 0, 60, 1, 0]);
    assert_eq!(head[36..40], (data.len() as u32).to_be_bytes());
    if answer.status == 0 { Ok(data.to_vec()) } else { Err(answer.status) }
}

#[test]
fn identification_and_maintenance_data_are_read() {
    let mut bench = Bench::in_data();
    let im0 = read(&mut bench, AR, 0, 1, 0xAFF0).unwrap();
    let expected = [
        &[0, 0x20, 0, 56, 1, 0, 0x12, 0x34][..],
        b"EX-1                42              ",
        &[0, 3, b'V', 1, 2, 13, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0x0E],
    ]
    .concat();
    assert_eq!(im0, expected);
    assert_eq!(read(&mut bench, AR, 0, 1, 0xAFF1).unwrap(), block(0x21, &[b' '; 54]));
    assert_eq!(read(&mut bench, AR, 2, 1, 0xAFF2).unwrap(), block(0x22, &[b' '; 16]));
    assert_eq!(read(&mut bench, AR, 0, 0x8000, 0xAFF3).unwrap(), block(0x23, &[b' '; 54]));
}

#[test]
fn only_the_controller_writes_maintenance_data_and_it_is_stored() {
    let mut bench = Bench::in_data();
    let write = |bench: &mut Bench, uuid, index, data: &[u8]| {
        let request = [&record(8, uuid, 0, 1, index, data.len() as u32)[..], data].concat();
        let answer = bench.call(3, &request);
        assert_eq!(answer.blocks[..6], [0x80, 0x08, 0, 60, 1, 0]);
        assert_eq!(answer.blocks[44..48], answer.status.to_be_bytes());
        (answer.event, answer.status)
    };
    let date = block(0x22, b"2026-11-23 16:00");
    assert_eq!(write(&mut bench, AR, 0xAFF2, &date), (Some(Event::Stored), 0));
    assert_eq!(bench.device.stored().maintenance.date, *b"2026-11-23 16:00");
    assert_eq!(write(&mut bench, AR, 0xAFF1, &block(0x21, &[b'x'; 54])), (Some(Event::Stored), 0));
    assert_eq!(write(&mut bench, AR, 0xAFF3, &block(0x23, &[b'y'; 54])), (Some(Event::Stored), 0));
    for (index, kind, text) in
        [(0xAFF1, 0x21, &[b'x'; 54][..]), (0xAFF2, 0x22, b"2026-11-23 16:00"), (0xAFF3, 0x23, &[b'y'; 54])]
    {
        assert_eq!(read(&mut bench, AR, 0, 1, index).unwrap(), block(kind, text));
    }
    let before = *bench.device.stored();
    for (uuid, index, data, reason) in [
        (AR, 0xAFF2, &block(0x22, &[b'x'; 15]), 0xB1),
        (AR, 0xAFF2, &block(0x21, &[b'x'; 16]), 0xB1),
        (AR, 0xAFF1, &block(0x21, &[b'x'; 55]), 0xB1),
        (AR, 0xAFF0, &block(0x20, &[b'x'; 16]), 0xB6),
        (AR, 0x1234, &vec![1], 0xB0),
        ([1; 16], 0xAFF2, &date, 0xB6),
    ] {
        let status = u32::from_be_bytes([0xDF, 0x80, reason, 0]);
        assert_eq!(write(&mut bench, uuid, index, data), (None, status), "{index:X}");
    }
    // Another API, and submodules that do not exist.
    let date_of = |header: Vec<u8>| [header, date.clone()].concat();
    let mut other = record(8, AR, 0, 1, 0xAFF2, date.len() as u32);
    other[27] = 1;
    for header in [
        other,
        record(8, AR, 0, 2, 0xAFF2, date.len() as u32),
        record(8, AR, 9, 1, 0xAFF2, date.len() as u32),
    ] {
        assert_eq!(bench.call(3, &date_of(header)).status, 0xDF80_B200);
    }
    // Data shorter than its stated length.
    assert_eq!(bench.call(3, &record(8, AR, 0, 1, 0xAFF2, 9)).status, 0xDF80_B100);
    assert_eq!(*bench.device.stored(), before);
}

#[test]
fn multiple_writes_are_answered_one_by_one() {
    let mut bench = Bench::in_data();
    let part = |index, data: &[u8]| {
        let mut bytes = [&record(8, AR, 0, 1, index, data.len() as u32)[..], data].concat();
        bytes.resize(bytes.len().next_multiple_of(4), 0);
        bytes
    };
    let parts = [
        part(0xAFF2, &block(0x22, &[b'z'; 16])),
        part(0x1234, &[1]),
        part(0xAFF3, &block(0x23, &[b'z'; 54])),
    ]
    .concat();
    let request = [record(8, AR, 0, 0, 0xE040, parts.len() as u32), parts].concat();
    let answer = bench.call(3, &request);
    assert_eq!((answer.event, answer.status, answer.blocks.len()), (Some(Event::Stored), 0, 64 * 4));
    let statuses: Vec<&[u8]> = answer.blocks.chunks(64).map(|answer| &answer[44..48]).collect();
    assert_eq!(statuses, [&[0; 4][..], &[0; 4], &[0xDF, 0x80, 0xB0, 0], &[0; 4]]);
    assert_eq!(bench.device.stored().maintenance.descriptor, [b'z'; 54]);
    // Writes without room for an answer are not executed.
    let parts: Vec<u8> = (b'a'..=b'q').flat_map(|letter| part(0xAFF3, &block(0x23, &[letter; 54]))).collect();
    let request = [record(8, AR, 0, 0, 0xE040, parts.len() as u32), parts].concat();
    let answer = bench.call(3, &request);
    assert_eq!((answer.status, answer.blocks.len()), (0, 64 * 17));
    assert_eq!(bench.device.stored().maintenance.descriptor, [b'p'; 54], "the 16th write");
}

#[test]
fn real_and_expected_identification_are_read_by_submodule_module_and_whole() {
    let mut bench = Bench::in_data();
    let head = |kind: u8, body: &[u8]| {
        let mut bytes = block(kind.into(), body);
        bytes[5] = 1;
        bytes
    };
    let second = [0, 1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0x30, 0, 1, 0, 1, 0, 0, 0, 0x31];
    for (real, expected) in [(0x8001, 0x8000), (0xC001, 0xC000)] {
        assert_eq!(read(&mut bench, AR, 2, 1, real).unwrap(), head(0x13, &second));
        assert_eq!(read(&mut bench, AR, 2, 1, expected).unwrap(), head(0x12, &second));
    }
    for index in [0xF000, 0xE001] {
        let all = read(&mut bench, AR, 0, 0, index).unwrap();
        assert_eq!(all[6..18], [0, 1, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0]);
        assert_eq!(all.len(), 6 + 6 + 2 + 3 * 8 + 5 * 6);
    }
    let expected = read(&mut bench, AR, 0, 0, 0xE000).unwrap();
    assert_eq!(expected[6..], read(&mut bench, AR, 0, 0, 0xE001).unwrap()[6..]);
    assert_eq!(read(&mut bench, AR, 0, 0, 0xE002).unwrap(), block(0x8104, &[0, 0]));
    assert_eq!(read(&mut bench, AR, 0, 0, 0xF821).unwrap(), block(0x1A, &[0, 1, 0, 0, 0, 0]));
    let filter = read(&mut bench, AR, 0, 0, 0xF840).unwrap();
    let kinds: Vec<u16> = blocks_of(&filter).iter().map(|(kind, _)| *kind).collect();
    assert_eq!(kinds, [0x30, 0x32]);
    assert_eq!(
        blocks_of(&filter)[1].1,
        [0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0x10, 0, 1, 0, 1, 0, 0, 0, 0x11]
    );
}

#[test]
fn faults_are_read_as_diagnosis() {
    let mut bench = Bench::in_data();
    assert_eq!(read(&mut bench, AR, 0, 1, 0x800A).unwrap(), []);
    bench.device.show_faults(0b101);
    let mut expected = block(
        0x10,
        &[0, 0, 0, 0, 0, 0, 0, 1, 0x80, 0, 8, 0, 0x80, 0, 0x80, 0, 8, 0, 1, 0, 0x80, 0, 8, 0, 1, 2],
    );
    expected[5] = 1;
    for index in [0x800A, 0x800B, 0x800C, 0xC00A, 0xE00C, 0xF00B, 0xF80C] {
        assert_eq!(read(&mut bench, AR, 0, 1, index).unwrap(), expected, "{index:X}");
    }
    assert_eq!(read(&mut bench, AR, 1, 1, 0x800A).unwrap(), [], "another slot");
}

#[test]
fn interface_and_port_are_read() {
    let mut bench = Bench::in_data();
    let interface = read(&mut bench, AR, 0, 0x8000, 0x8080).unwrap();
    let expected = [
        &[2, 0x40, 0, 36, 1, 0, 9][..],
        b"example-1",
        &DEVICE.0,
        &[0, 0, 192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0],
    ]
    .concat();
    assert_eq!(interface[..4], [2, 0x40, 0, 32]);
    assert_eq!(interface[4..], expected[4..]);
    let port = read(&mut bench, AR, 0, 0x8001, 0x802A).unwrap();
    assert_eq!(port[12..21], *b"\x08port-001");
    assert_eq!(port.len() % 4, 0);
    let both = read(&mut bench, AR, 0, 0, 0xF841).unwrap();
    let blocks = blocks_of(&both);
    assert_eq!(blocks.iter().map(|(kind, _)| *kind).collect::<Vec<_>>(), [0x400, 0x400]);
    assert_eq!((blocks[0].1[10..].to_vec(), blocks[1].1[10..].to_vec()), (interface, port));
}

#[test]
fn unavailable_records_are_rejected_with_a_reason() {
    let mut bench = Bench::in_data();
    for (uuid, slot, subslot, index, reason) in [
        (AR, 0, 1, 0x1234, 0xB0),
        (AR, 9, 1, 0xAFF0, 0xB2),
        (AR, 1, 2, 0xAFF0, 0xB2),
        (AR, 9, 0, 0xC001, 0xB2),
        (AR, 0, 1, 0x8080, 0xB0),
        (AR, 0, 0x8000, 0x802A, 0xB0),
        ([1; 16], 0, 1, 0xAFF0, 0xB6),
    ] {
        let status = u32::from_be_bytes([0xDE, 0x80, reason, 0]);
        assert_eq!(read(&mut bench, uuid, slot, subslot, index), Err(status), "{index:X}");
    }
    // Too long for the request.
    assert_eq!(bench.call(2, &record(9, AR, 0, 1, 0xAFF0, 59)).status, 0xDE80_B100);
    assert_eq!(bench.call(2, &record(9, AR, 0, 1, 0xAFF0, 60)).status, 0);
    assert_eq!(bench.call(2, &[]).status, 0xDE80_B100);
}

#[test]
fn reader_connects_beside_the_controller_and_changes_nothing() {
    const READER: [u8; 16] = [0xEE; 16];
    let mut bench = Bench::in_data();
    let answer = bench.call(0, &Wanted::access(READER).blocks());
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(blocks_of(&answer.blocks).len(), 1);
    assert!(read(&mut bench, READER, 0, 1, 0xAFF0).is_ok());
    assert_eq!(read(&mut bench, READER, 0, 0, 0xE002), Err(0xDE80_A900));
    let write = [record(8, READER, 0, 1, 0xAFF2, 22), block(0x22, &[b'x'; 16])].concat();
    assert_eq!(bench.call(3, &write).status, 0xDF80_B600);
    assert_eq!(bench.call(4, &control(0x0110, READER, 1)).status, 0xDD81_4005);
    // Only one reader can connect.
    assert_eq!(bench.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0xDB81_4004);
    let answer = bench.call(1, &control(0x0114, READER, 4));
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(bench.device.state(), State::Data);
    assert_eq!(read(&mut bench, READER, 0, 1, 0xAFF0), Err(0xDE80_B600));
}

#[test]
fn idle_reader_loses_its_connection() {
    let mut bench = Bench::new();
    bench.call(0, &Wanted::access([0xEE; 16]).blocks());
    bench.now += 900_000;
    assert!(read(&mut bench, [0xEE; 16], 0, 1, 0xAFF0).is_ok());
    bench.now += 999_999;
    bench.poll();
    assert!(bench.device.poll_timeout(bench.now) <= bench.now + 1);
    assert_eq!(bench.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0xDB81_4004);
    bench.now += 1;
    bench.poll();
    assert_eq!(bench.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0);
}

// --- Endpoint mapper

#[test]
fn endpoint_mapper_lists_one_interface_and_then_none() {
    for is_low_first in [true, false] {
        let mut bench = Bench::new();
        let order = |value: u32| if is_low_first { value.to_le_bytes() } else { value.to_be_bytes() };
        let epm: [u8; 16] = if is_low_first {
            [8, 0x83, 0xAF, 0xE1, 0x1F, 0x5D, 0xC9, 0x11, 0x91, 0xA4, 8, 0, 0x2B, 0x14, 0xA0, 0xFA]
        } else {
            [0xE1, 0xAF, 0x83, 8, 0x5D, 0x1F, 0x11, 0xC9, 0x91, 0xA4, 8, 0, 0x2B, 0x14, 0xA0, 0xFA]
        };
        let mut lookup = |handle: (&[u8], u32)| {
            let (handle, max_entries) = handle;
            let body = [&order(0)[..], &order(0), &order(0), &order(1), handle, &order(max_entries)].concat();
            bench.sequence += 1;
            let mut request = datagram(is_low_first, 0, bench.sequence, 2, &body);
            request[24..40].copy_from_slice(&epm);
            bench.device.receive_datagram(bench.now, HOST, &request);
            bench.transmitted().remove(0).1[80..].to_vec()
        };
        let first = lookup((&[0; 20], 1));
        assert_eq!(first[20..24], order(1));
        let text = String::from_utf8_lossy(&first[64..128]).into_owned();
        assert_eq!(text, "example                   EX-1                     3 V  1  2 13\0");
        assert_eq!(first[first.len() - 4..], order(0));
        let floors = &first[136..];
        assert_eq!(floors[..6], [5, 0, 19, 0, 0x0D, 1]);
        assert_eq!(
            floors[floors.len() - 4 - 20..floors.len() - 5],
            [0, 0, 0, 1, 0, 8, 2, 0, 0x88, 0x94, 1, 0, 9, 4, 0, 192, 168, 0, 5][..]
        );
        let object: [u8; 16] = if is_low_first {
            [0, 0, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, 0x82, 0x71, 0, 1, 0x56, 0x78, 0x12, 0x34]
        } else {
            [0xDE, 0xA0, 0, 0, 0x6C, 0x97, 0x11, 0xD1, 0x82, 0x71, 0, 1, 0x56, 0x78, 0x12, 0x34]
        };
        assert_eq!(first[36..52], object);
        assert_eq!(first[128..136], [order(75), order(75)].concat(), "length of the tower");
        assert_eq!(
            floors[5..21],
            [1, 0, 0xA0, 0xDE, 0x97, 0x6C, 0xD1, 0x11, 0x82, 0x71, 0, 0xA0, 0x24, 0x42, 0xDF, 0x7D]
        );
        let none = lookup((&[0; 20], 0));
        assert_eq!(
            (&none[20..24], &none[36..]),
            (&order(0)[..], &order(0x16C9_A0D6)[..]),
            "no room for entries"
        );
        let end = lookup((&first[..20], 1));
        assert_eq!((&end[20..24], &end[36..]), (&order(0)[..], &order(0x16C9_A0D6)[..]));
        // The handle can be released.
        let mut request = datagram(is_low_first, 0, 9, 4, &[0; 20]);
        request[24..40].copy_from_slice(&epm);
        bench.device.receive_datagram(bench.now, HOST, &request);
        let sent = bench.transmitted();
        assert_eq!((sent[0].1[1], &sent[0].1[80..]), (2, &[0; 24][..]));
    }
}
