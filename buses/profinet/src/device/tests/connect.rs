//! Connections: Connect, Control, Release, time-outs.

use super::discovery::MULTICAST;
use super::*;

#[test]
fn controller_connects_without_parameters_and_exchanges_data() {
    let mut rig = TestRig::new();
    let answer = rig.call(0, &Wanted::default().blocks());
    assert_eq!((answer.event, answer.kind, answer.status), (None, 2, 0));
    let expected = [
        (0x8101, [&[0, 1][..], &AR, &[0, 7], &DEVICE.0, &[0x88, 0x92]].concat()),
        (0x8102, vec![0, 1, 0, 11, 0xC0, 1]),
        (0x8102, vec![0, 2, 0, 12, 0x80, 1]),
        (0x8103, vec![0, 1, 0, 1, 0, 200]),
    ];
    assert_eq!(blocks_of(&answer.blocks), expected);
    assert_eq!(rig.device.state(), State::Parameters);

    let answer = rig.call(4, &control(0x0110, AR, 1));
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(answer.blocks, control(0x8110, AR, 8));
    assert_eq!(rig.device.state(), State::Ready);

    let calls = rig.calls();
    let [call] = &calls[..] else { panic!("{calls:?}") };
    assert_eq!((call[0], call[1], &call[68..70]), (4, 0, &[0, 4][..]));
    assert_eq!(call[8..24], PLC_OBJECT, "object UUID of the controller");
    assert_eq!(call[24..28], [0xDE, 0xA0, 0, 2]);
    // The activity identifies the device and its start, so that answers to other calls do not match.
    assert_eq!(call[40..56], [0, 0, 0xB0, 7, 0, 0, 0x10, 0, 0x80, 0, 0x02, 0, 0, 0, 0, 0x10]);
    assert_eq!(call[100..], control(0x0112, AR, 2));
    // Outputs do not count before the controller's confirmation.
    assert_eq!(rig.outputs([1, 2, 3]), None);
    assert_eq!(rig.confirm(call), Some(Event::Connected));
    assert_eq!(rig.device.state(), State::Data);
    assert_eq!(rig.confirm(call), None, "only once");
    assert_eq!(rig.outputs([1, 2, 3]), Some(Event::Outputs));
    assert_eq!(rig.device.outputs(), &[1, 2, 3]);
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
        let mut rig = TestRig::new();
        let answer = rig.call(0, &wanted.blocks());
        assert_eq!(answer.status, u32::from_be_bytes([0xDB, 0x81, code1, code2]), "{wanted:?}");
        assert_eq!((answer.blocks, rig.device.state()), (vec![], State::Unconnected));
        // And no inputs are sent.
        rig.now += CYCLE_US;
        assert_eq!(rig.sent().len(), 0);
    }
}

/// IEC 61158-6-10, RPCObjectUUID: instance, device and vendor number identify a device.
#[test]
fn connect_for_the_object_of_another_device_is_rejected() {
    let blocks = Wanted::default().blocks();
    for is_low_first in [true, false] {
        // A byte of the vendor, device and instance number.
        for at in [22, 20, 19] {
            let mut rig = TestRig::new();
            let mut request = datagram(is_low_first, 0, 1, 0, &arguments(is_low_first, &blocks));
            request[at] ^= 1;
            assert_eq!(rig.device.receive_datagram(rig.now, HOST, &request), None);
            let [(Some(HOST), answer)] = &rig.transmitted()[..] else { panic!("{at}") };
            let status: [u8; 4] = answer[80..].try_into().unwrap();
            let status = if is_low_first { u32::from_le_bytes(status) } else { u32::from_be_bytes(status) };
            assert_eq!((answer[1], status), (6, 0x1C01_0017), "{at}");
            assert_eq!(rig.device.state(), State::Unconnected);
            assert_eq!(rig.device.counters().rpc_refused, 1);
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
        assert_eq!(TestRig::new().call(0, &wanted.blocks()).status, 0, "{wanted:?}");
    }
}

#[test]
fn data_without_a_place_in_its_frame_is_an_error() {
    for placed in [[false, true, true], [true, false, true], [true, true, false]] {
        let mut rig = TestRig::new();
        let answer = rig.call(0, &Wanted { placed, ..Wanted::default() }.blocks());
        assert_eq!((answer.status, rig.device.state()), (0xDB81_0215, State::Unconnected), "{placed:?}");
    }
    // The data of a missing module needs no place.
    let wanted = Wanted { placed: [true, true, false], modules: [0x20, 0x99], ..Wanted::default() };
    assert_eq!(TestRig::new().call(0, &wanted.blocks()).status, 0);
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
        assert_eq!(TestRig::new().call(0, &changed).status, status, "{at} {offset}");
    }
}

/// The limit covers data and a consumer status for the maximum number of submodules.
#[test]
fn frame_has_at_most_32_parts() {
    // The status of a missing module may be repeated.
    let wanted = |statuses| Wanted { modules: [0x20, 0x99], statuses, ..Wanted::default() };
    assert_eq!(TestRig::new().call(0, &wanted(26).blocks()).status, 0);
    assert_eq!(TestRig::new().call(0, &wanted(27).blocks()).status, 0xDB81_021C);
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
        assert_eq!(TestRig::new().call(0, &some.concat()).status, status, "{missing}");
    }
    // A place in a frame for a submodule that is not expected.
    cut.remove(5);
    assert_eq!(TestRig::new().call(0, &cut.concat()).status, 0xDB81_0216);
    assert_eq!(TestRig::new().call(0, &[]).status, 0xDB81_0100);
}

#[test]
fn truncated_connect_is_rejected() {
    let blocks = Wanted::default().blocks();
    for len in 0..blocks.len() {
        let mut rig = TestRig::new();
        assert_ne!(rig.call(0, &blocks[..len]).status, 0, "{len}");
        assert_eq!(rig.device.state(), State::Unconnected);
    }
}

#[test]
fn frame_id_of_either_range_is_accepted_and_chosen_if_left_open() {
    for (class, asked, given) in [
        (1, 0x8000, 0x8000),
        (1, 0xBBFF, 0xBBFF),
        (1, 0xC000, 0xC000),
        (1, 0xFBFF, 0xFBFF),
        (1, 0xFFFF, 0xC000),
        (2, 0xFFFF, 0x8000),
    ] {
        let wanted = Wanted { class, input_id: asked, output_id: asked, ..Wanted::default() };
        let answer = TestRig::new().call(0, &wanted.blocks());
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
        let mut rig = TestRig::new();
        let answer = rig.call(0, &wanted.blocks());
        let blocks = blocks_of(&answer.blocks);
        assert_eq!(blocks.last(), Some(&(0x8104, expected.to_vec())), "{wanted:?}");
        // Without a place for all outputs, none of them count.
        rig.call(4, &control(0x0110, AR, 1));
        let calls = rig.calls();
        assert_eq!(rig.confirm(&calls[0]), Some(Event::Connected));
        assert_eq!(rig.outputs([1, 2, 3]), None);
        assert_eq!(rig.device.outputs(), &[0; 3]);
    }
}

#[test]
fn second_controller_is_rejected_and_the_first_continues() {
    let mut rig = TestRig::in_data();
    let second = Wanted { uuid: [0xB6; 16], mac: OTHER, ..Wanted::default() };
    assert_eq!(rig.call(0, &second.blocks()).status, 0xDB81_4004);
    assert_eq!(rig.outputs([1, 2, 3]), Some(Event::Outputs));
    // It cannot release, end parameters or send outputs either.
    assert_eq!(rig.call(1, &control(0x0114, [0xB6; 16], 4)).status, 0xDC81_4005);
    assert_eq!(rig.call(4, &control(0x0110, [0xB6; 16], 1)).status, 0xDD81_4005);
    let mut frame = outputs_frame([9; 3], 0x7000, [0x80; 2], 0x35);
    frame[6..12].copy_from_slice(&OTHER.0);
    assert_eq!(rig.device.receive(rig.now, &frame), None);
    assert_eq!(rig.device.outputs(), &[1, 2, 3]);
}

#[test]
fn reconnecting_controller_starts_again() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    let answer = rig.call(0, &Wanted::default().blocks());
    assert_eq!((answer.event, answer.status), (Some(Event::Left(Cause::Aborted)), 0));
    assert_eq!((rig.device.outputs(), rig.device.state()), (&[0; 3], State::Parameters));
    // The alarm connection has a new reference.
    assert_eq!(blocks_of(&answer.blocks)[3].1, [0, 1, 0, 2, 0, 200]);
}

#[test]
fn repeated_call_is_executed_once_and_gets_the_same_answer() {
    let mut rig = TestRig::new();
    let request = datagram(false, 0, 5, 0, &arguments(false, &Wanted::default().blocks()));
    assert_eq!(rig.device.receive_datagram(rig.now, HOST, &request), None);
    assert_eq!(rig.device.poll_timeout(rig.now), rig.now, "the answer is due");
    let is_answer = |(to, _): &(Option<Endpoint>, Vec<u8>)| *to == Some(HOST);
    let first: Vec<_> = rig.transmitted().into_iter().filter(is_answer).collect();
    assert_eq!(rig.device.receive_datagram(rig.now, HOST, &request), None);
    let second: Vec<_> = rig.transmitted().into_iter().filter(is_answer).collect();
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
    let mut rig = TestRig::new();
    rig.device.receive_datagram(rig.now, unset, &request);
    let sent = rig.transmitted();
    let answer = Answer::of(None, &sent[0].1);
    assert_eq!((answer.kind, answer.status, answer.blocks.len()), (2, 0, 64 + 60));
}

#[test]
fn only_identification_can_be_read_without_a_connection() {
    let mut rig = TestRig::new();
    let answer = rig.call(5, &record(9, [0; 16], 0, 1, 0xAFF0, 64));
    assert_eq!((answer.status, answer.blocks.len()), (0, 64 + 60));
    assert_eq!(rig.call(5, &record(9, [0; 16], 0, 0, 0xE000, 4_096)).status, 0xDE80_A900);
    assert_eq!(rig.call(2, &record(9, [0; 16], 0, 1, 0xAFF0, 64)).status, 0xDE80_B600);
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
        let mut rig = TestRig::new();
        assert_eq!(rig.device.receive_datagram(rig.now, HOST, &request), None);
        let answers = rig.transmitted();
        let answer = answers.first().map(|(_, bytes)| {
            let answer = Answer::of(None, bytes);
            (answer.kind, answer.status)
        });
        assert_eq!(answer, expected, "{:02X?}", &request[..80.min(request.len())]);
        assert_eq!(rig.device.counters().rpc_refused, expected.is_some().into());
        assert_eq!(rig.device.state(), State::Unconnected);
    }
}

#[test]
fn ping_repeats_a_known_answer_and_reports_an_unknown_call() {
    let mut rig = TestRig::new();
    let request = datagram(true, 0, 9, 5, &arguments(true, &record(9, [0; 16], 0, 1, 0xAFF0, 64)));
    rig.device.receive_datagram(rig.now, HOST, &request);
    let first = rig.transmitted();
    rig.device.receive_datagram(rig.now, HOST, &datagram(true, 1, 9, 5, &[]));
    assert_eq!(rig.transmitted(), first);
    rig.device.receive_datagram(rig.now, HOST, &datagram(true, 1, 10, 5, &[]));
    let answers = rig.transmitted();
    assert_eq!((answers[0].1[1], answers[0].1.len()), (5, 80));
}

#[test]
fn unfinished_parameters_time_out() {
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::default().blocks());
    rig.now += 900_000;
    // A write or a read restarts the time-out.
    rig.call(2, &record(9, AR, 0, 1, 0xAFF0, 64));
    rig.now += 999_999;
    assert_eq!(rig.poll(), None);
    rig.now += 1;
    assert_eq!(rig.poll(), Some(Event::Left(Cause::Silence)));
    let frames = rig.acyclic();
    assert_eq!(frames[0][18..20], [0xFE, 0x01], "sent to the controller");
    assert_eq!(frames[0][32..36], [0xCF, 0x81, 0xFD, 5]);
}

#[test]
fn missing_confirmation_is_requested_five_times() {
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::default().blocks());
    rig.call(4, &control(0x0110, AR, 1));
    let mut calls = 0;
    let start = rig.now;
    let event = loop {
        calls += rig.calls().len();
        if let Some(event) = rig.poll() {
            break event;
        }
        rig.now += 100_000;
        assert!(rig.now < start + 60_000_000);
    };
    assert_eq!((event, calls, rig.now - start), (Event::Left(Cause::NotConfirmed), 5, 10_000_000));
}

#[test]
fn only_the_controllers_own_confirmation_counts() {
    let ready = || {
        let mut rig = TestRig::new();
        rig.call(0, &Wanted::default().blocks());
        rig.call(4, &control(0x0110, AR, 1));
        let call = rig.calls().remove(0);
        (rig, call)
    };
    let (mut rig, call) = ready();
    assert_eq!(rig.confirm_as(&call, [1; 16], 8, 0), None);
    assert_eq!(rig.confirm_as(&call, AR, 2, 0), None);
    assert_eq!(rig.confirm_as(&call, AR, 8, 1), None);
    let mut other = call.clone();
    other[64] ^= 1;
    assert_eq!(rig.confirm(&other), None, "another call");
    other = call.clone();
    other[40] ^= 1;
    assert_eq!(rig.confirm(&other), None, "another activity");
    assert_eq!(rig.confirm(&call), Some(Event::Connected));
    // There is nothing to confirm before the call has been sent.
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::default().blocks());
    assert_eq!(rig.confirm(&call), None);
    assert_eq!(rig.device.state(), State::Parameters);
    let end = datagram(true, 0, 9, 4, &arguments(true, &control(0x0110, AR, 1)));
    rig.device.receive_datagram(rig.now, HOST, &end);
    assert_eq!(rig.confirm(&call), None);
    assert_eq!(rig.device.state(), State::Ready);
    assert_eq!(rig.calls(), [&call[..]]);
    assert_eq!(rig.confirm(&call), Some(Event::Connected));
}

#[test]
fn end_of_parameters_is_accepted_once_and_only_with_its_command() {
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::default().blocks());
    assert_eq!(rig.call(4, &control(0x0110, AR, 2)).status, 0xDD81_1608);
    assert_eq!(rig.call(4, &control(0x0111, AR, 1)).status, 0xDD81_4005);
    assert_eq!(rig.call(4, &[]).status, 0xDD81_4005);
    assert_eq!(rig.call(4, &control(0x0110, AR, 1)).status, 0);
    assert_eq!(rig.call(4, &control(0x0110, AR, 1)).status, 0xDD81_4006);
}

#[test]
fn release_ends_the_connection_and_is_reported() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    assert_eq!(rig.call(1, &control(0x0114, AR, 1)).status, 0xDC81_2808);
    let answer = rig.call(1, &control(0x0114, AR, 4));
    assert_eq!((answer.event, answer.status), (Some(Event::Left(Cause::Released)), 0));
    assert_eq!(answer.blocks, control(0x8114, AR, 8));
    assert_eq!((rig.device.outputs(), rig.device.state()), (&[0; 3], State::Unconnected));
    rig.now += 100_000;
    assert_eq!(rig.sent().len(), 0, "neither inputs nor RTA-ERR");
    assert_eq!(rig.call(1, &control(0x0114, AR, 4)).status, 0xDC81_4005);
}
