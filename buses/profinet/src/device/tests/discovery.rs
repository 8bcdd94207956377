//! DCP, LLDP and the endpoint mapper: how controllers and neighbours find the device.

use super::*;

pub(super) const MULTICAST: MacAddress = MacAddress([1, 0x0E, 0xCF, 0, 0, 0]);

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
fn set(rig: &mut TestRig, is_permanent: bool, what: [u8; 2], data: &[u8]) -> (Option<Event>, u8) {
    let block = dcp_block(what, &[&[0, is_permanent.into()], data].concat());
    let event = rig.device.receive(rig.now, &dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &block));
    let answers = rig.acyclic();
    let [answer] = &answers[..] else { panic!("{answers:?}") };
    let [control, response, 0, 3, option, suboption, fault, 0] = answer[26..34] else { panic!("{answer:?}") };
    assert_eq!(([control, response], [option, suboption]), ([5, 4], what));
    (event, fault)
}

fn identify(rig: &mut TestRig, delay: u16, blocks: &[u8]) {
    let request = dcp_frame(MULTICAST, 0xFEFE, [5, 0], delay, blocks);
    assert_eq!(rig.device.receive(rig.now, &request), None);
}

#[test]
fn identify_for_this_station_only_is_answered() {
    let mut rig = TestRig::new();
    let request = dcp_frame(DEVICE, 0xFEFE, [5, 0], 1, &dcp_block([0xFF, 0xFF], &[]));
    assert_eq!(rig.device.receive(rig.now, &request), None);
    assert_eq!(rig.sent().len(), 1);
}

/// Compares the complete answer to an Identify request for all options.
#[test]
fn identify_is_answered_with_all_options_for_a_controller() {
    let mut rig = TestRig::new();

    identify(&mut rig, 1, &dcp_block([0xFF, 0xFF], &[]));

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
    assert_eq!(rig.sent(), [expected]);
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
        let mut rig = TestRig::new();
        identify(&mut rig, 1, &blocks);
        assert_eq!(rig.sent().len(), usize::from(is_answered), "{blocks:?}");
    }
}

#[test]
fn answer_to_identify_is_delayed_by_address_and_delay_factor() {
    let mut rig = TestRig::new();
    // 0010h modulo 7 is 2: two units of 10 ms.
    identify(&mut rig, 7, &dcp_block([0xFF, 0xFF], &[]));
    let due = rig.now + 20_000;
    assert_eq!(rig.device.poll_timeout(rig.now), due);
    rig.now = due - 1;
    assert_eq!(rig.sent().len(), 0);
    rig.now = due;
    assert_eq!(rig.sent().len(), 1);
}

#[test]
fn pending_answers_are_limited_and_lost_ones_are_counted() {
    let mut rig = TestRig::new();
    for _ in 0..6 {
        identify(&mut rig, 0x1900, &dcp_block([0xFF, 0xFF], &[]));
    }
    assert_eq!(rig.device.counters().dcp_lost, 2);
    rig.now += 64_000_000;
    let answers = rig.sent().into_iter().filter(|frame| frame[14..16] == [0xFE, 0xFF]);
    assert_eq!(answers.count(), 4);
}

#[test]
fn name_and_ip_take_effect_at_once_and_persist_if_permanent() {
    let mut rig = TestRig::new();
    let ip = [10, 0, 0, 7, 255, 0, 0, 0, 10, 0, 0, 1];

    assert_eq!(set(&mut rig, true, [2, 2], b"gripper"), (Some(Event::Stored), 0));
    assert_eq!(set(&mut rig, true, [1, 2], &ip), (Some(Event::Stored), 0));

    let stored = *rig.device.stored();
    assert_eq!((stored.name.as_str(), stored.ip.address), ("gripper", [10, 0, 0, 7]));
    assert_eq!((rig.device.name(), rig.device.ip()), (&stored.name, &stored.ip));
    assert_eq!((stored.ip.gateway, stored.ip.prefix_len()), ([10, 0, 0, 1], 8));

    // Temporary: none after the next start.
    assert_eq!(set(&mut rig, false, [2, 2], b"other"), (Some(Event::Stored), 0));
    assert_eq!(set(&mut rig, false, [1, 2], &[0; 12]), (Some(Event::Stored), 0));
    assert_eq!((rig.device.name().as_str(), rig.device.stored().name), ("other", StationName::NONE));
    assert_eq!((rig.device.ip().is_set(), rig.device.stored().ip), (false, IpParameters::NONE));
}

#[test]
fn only_changes_of_present_or_stored_data_are_reported() {
    let mut rig = TestRig::new();
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
        assert_eq!(set(&mut rig, is_permanent, what, data), expected, "{what:?} {is_permanent} {data:?}");
    }
}

#[test]
fn invalid_settings_are_rejected_without_a_change() {
    let mut rig = TestRig::new();
    let before = *rig.device.stored();
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
        assert_eq!(set(&mut rig, true, what, data), (None, fault), "{what:?} {data:?}");
    }
    assert_eq!(*rig.device.stored(), before);
    assert_eq!(set(&mut rig, false, [5, 3], &[1, 0]), (Some(Event::Signal), 0));
}

#[test]
fn name_and_address_stay_while_a_controller_uses_them() {
    let mut rig = TestRig::in_data();
    let ip = [192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0];
    assert_eq!(set(&mut rig, true, [2, 2], b"gripper"), (None, 6));
    assert_eq!(set(&mut rig, true, [2, 2], b"example-1"), (None, 0));
    assert_eq!(set(&mut rig, true, [1, 2], &ip), (None, 0));
    assert_eq!(set(&mut rig, true, [1, 2], &[0; 12]), (None, 6));
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
        let mut rig = TestRig::in_data();
        let request = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block(what, &[0, qualifier]));
        let event = rig.device.receive(rig.now, &request);
        let frames = rig.acyclic();
        let answer = frames.iter().find(|frame| frame[14..16] == [0xFE, 0xFD]).unwrap();
        assert_eq!(answer[32], fault, "{what:?} {qualifier}");
        let is_reset = fault == 0;
        assert_eq!(event, is_reset.then_some(Event::Left(Cause::Reset)));
        assert!(!is_reset || rig.device.poll_timeout(rig.now) == rig.now);
        assert_eq!((rig.poll(), rig.poll()), (is_reset.then_some(Event::Stored), None));
        assert_eq!(*rig.device.stored() == Stored::NONE, is_reset);
        assert_eq!(rig.device.state(), if is_reset { State::Unconnected } else { State::Data });
    }
}

#[test]
fn reset_of_communication_keeps_the_maintenance_data() {
    for (what, qualifier, leaves_it) in
        [([5, 6], 4, true), ([5, 6], 8, false), ([5, 6], 16, false), ([5, 5], 0, false)]
    {
        let mut rig = TestRig::in_data();
        let date = block(0x22, b"2026-11-23 16:00");
        rig.call(3, &[&record(8, AR, 0, 1, 0xAFF2, date.len() as u32)[..], &date].concat());
        let before = rig.device.stored().maintenance;
        assert_eq!(before.date, *b"2026-11-23 16:00");
        let request = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block(what, &[0, qualifier]));
        rig.device.receive(rig.now, &request);
        let maintenance = if leaves_it { before } else { Maintenance::NONE };
        assert_eq!(*rig.device.stored(), Stored { maintenance, ..Stored::NONE }, "{what:?} {qualifier}");
    }
}

/// The application learns about the end of outputs even if more frames arrive before it polls.
#[test]
fn reset_is_reported_before_a_name_set_directly_after_it() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    let reset = dcp_frame(DEVICE, 0xFEFD, [4, 0], 0, &dcp_block([5, 6], &[0, 4]));
    assert_eq!(rig.device.receive(rig.now, &reset), Some(Event::Left(Cause::Reset)));
    rig.acyclic();
    assert_eq!(set(&mut rig, true, [2, 2], b"gripper"), (Some(Event::Stored), 0));
    assert_eq!((rig.device.outputs(), rig.device.state()), (&[0; 3], State::Unconnected));
    assert_eq!((rig.poll(), rig.poll()), (Some(Event::Stored), None));
}

#[test]
fn get_returns_requested_options_and_errors_for_unknown_ones() {
    let mut rig = TestRig::new();
    let request = dcp_frame(DEVICE, 0xFEFD, [3, 0], 0, &[2, 2, 1, 1, 9, 9, 2, 6, 2]);
    assert_eq!(rig.device.receive(rig.now, &request), None);
    let answers = rig.sent();
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
        let mut rig = TestRig::new();
        assert_eq!(rig.device.receive(rig.now, &dcp_frame(to, id, service, 1, blocks)), None);
        assert_eq!(rig.sent().len(), 0, "{to} {id:X} {service:?}");
        assert_eq!(rig.device.name().as_str(), "example-1");
    }
}

#[test]
fn lldp_announces_name_port_and_address_every_5_s() {
    let mut rig = TestRig::new();
    assert_eq!(rig.device.poll_timeout(rig.now), 6_000_000);
    rig.now = 6_000_000;
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
    assert_eq!(rig.sent(), [expected]);
    assert_eq!(rig.device.poll_timeout(rig.now), 11_000_000);
}

#[test]
fn lldp_without_name_and_address_uses_the_mac_address() {
    let mut device = Device::<3, 2>::new(&PROFILE, DEVICE, Stored::NONE, 1);
    let mut buffer = [0; MAX_FRAME_LEN];
    assert_eq!(device.poll_transmit(0, &mut buffer), Some(Transmit::Frame(73)));
    assert_eq!(buffer[14..23], [2, 7, 4, 2, 0, 0, 0, 0, 0x10]);
}

#[test]
fn endpoint_mapper_lists_one_interface_and_refuses_truncation() {
    for is_low_first in [true, false] {
        let mut rig = TestRig::new();
        let order = |value: u32| if is_low_first { value.to_le_bytes() } else { value.to_be_bytes() };
        let epm: [u8; 16] = if is_low_first {
            [8, 0x83, 0xAF, 0xE1, 0x1F, 0x5D, 0xC9, 0x11, 0x91, 0xA4, 8, 0, 0x2B, 0x14, 0xA0, 0xFA]
        } else {
            [0xE1, 0xAF, 0x83, 8, 0x5D, 0x1F, 0x11, 0xC9, 0x91, 0xA4, 8, 0, 0x2B, 0x14, 0xA0, 0xFA]
        };
        let mut lookup = |handle: (&[u8], u32)| {
            let (handle, max_entries) = handle;
            let body = [&order(0)[..], &order(0), &order(0), &order(1), handle, &order(max_entries)].concat();
            rig.sequence += 1;
            let mut request = datagram(is_low_first, 0, rig.sequence, 2, &body);
            request[24..40].copy_from_slice(&epm);
            rig.device.receive_datagram(rig.now, HOST, &request);
            rig.transmitted().remove(0).1[80..].to_vec()
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
        // The handle can be released, and a truncated request is a fault.
        let fault = order(0x1C01_000B);
        for (operation, body, answer) in [(4, &[0; 20][..], (2, &[0; 24][..])), (2, &[0; 8], (3, &fault))] {
            rig.sequence += 1;
            let mut request = datagram(is_low_first, 0, rig.sequence, operation, body);
            request[24..40].copy_from_slice(&epm);
            rig.device.receive_datagram(rig.now, HOST, &request);
            let sent = rig.transmitted();
            assert_eq!((sent[0].1[1], &sent[0].1[80..]), answer);
        }
    }
}
