use super::*;

fn read(rig: &mut TestRig, uuid: [u8; 16], slot: u16, subslot: u16, index: u16) -> Result<Vec<u8>, u32> {
    let answer = rig.call(2, &record(9, uuid, slot, subslot, index, 4_096));
    let (head, data) = answer.blocks.split_at(64);
    assert_eq!(head[..6], [0x80, 0x09, 0, 60, 1, 0]);
    assert_eq!(head[36..40], (data.len() as u32).to_be_bytes());
    if answer.status == 0 { Ok(data.to_vec()) } else { Err(answer.status) }
}

#[test]
fn identification_and_maintenance_data_are_read() {
    let mut rig = TestRig::in_data();
    let im0 = read(&mut rig, AR, 0, 1, 0xAFF0).unwrap();
    let expected = [
        &[0, 0x20, 0, 56, 1, 0, 0x12, 0x34][..],
        b"EX-1                42              ",
        &[0, 3, b'V', 1, 2, 13, 0, 0, 0, 0, 0, 0, 1, 1, 0, 0x0E],
    ]
    .concat();
    assert_eq!(im0, expected);
    assert_eq!(read(&mut rig, AR, 0, 1, 0xAFF1).unwrap(), block(0x21, &[b' '; 54]));
    assert_eq!(read(&mut rig, AR, 2, 1, 0xAFF2).unwrap(), block(0x22, &[b' '; 16]));
    assert_eq!(read(&mut rig, AR, 0, 0x8000, 0xAFF3).unwrap(), block(0x23, &[b' '; 54]));
}

#[test]
fn only_the_controller_writes_maintenance_data_and_it_is_stored() {
    let mut rig = TestRig::in_data();
    let write = |rig: &mut TestRig, uuid, index, data: &[u8]| {
        let request = [&record(8, uuid, 0, 1, index, data.len() as u32)[..], data].concat();
        let answer = rig.call(3, &request);
        assert_eq!(answer.blocks[..6], [0x80, 0x08, 0, 60, 1, 0]);
        assert_eq!(answer.blocks[44..48], answer.status.to_be_bytes());
        (answer.event, answer.status)
    };
    let date = block(0x22, b"2026-11-23 16:00");
    assert_eq!(write(&mut rig, AR, 0xAFF2, &date), (Some(Event::Stored), 0));
    assert_eq!(rig.device.stored().maintenance.date, *b"2026-11-23 16:00");
    assert_eq!(write(&mut rig, AR, 0xAFF1, &block(0x21, &[b'x'; 54])), (Some(Event::Stored), 0));
    assert_eq!(write(&mut rig, AR, 0xAFF3, &block(0x23, &[b'y'; 54])), (Some(Event::Stored), 0));
    for (index, kind, text) in
        [(0xAFF1, 0x21, &[b'x'; 54][..]), (0xAFF2, 0x22, b"2026-11-23 16:00"), (0xAFF3, 0x23, &[b'y'; 54])]
    {
        assert_eq!(read(&mut rig, AR, 0, 1, index).unwrap(), block(kind, text));
    }
    let before = *rig.device.stored();
    for (uuid, index, data, reason) in [
        (AR, 0xAFF2, &block(0x22, &[b'x'; 15]), 0xB1),
        (AR, 0xAFF2, &block(0x21, &[b'x'; 16]), 0xB1),
        (AR, 0xAFF1, &block(0x21, &[b'x'; 55]), 0xB1),
        (AR, 0xAFF0, &block(0x20, &[b'x'; 16]), 0xB6),
        (AR, 0x1234, &vec![1], 0xB0),
        ([1; 16], 0xAFF2, &date, 0xB6),
    ] {
        let status = u32::from_be_bytes([0xDF, 0x80, reason, 0]);
        assert_eq!(write(&mut rig, uuid, index, data), (None, status), "{index:X}");
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
        assert_eq!(rig.call(3, &date_of(header)).status, 0xDF80_B200);
    }
    // Data shorter than its stated length.
    assert_eq!(rig.call(3, &record(8, AR, 0, 1, 0xAFF2, 9)).status, 0xDF80_B100);
    assert_eq!(*rig.device.stored(), before);
}

#[test]
fn multiple_writes_are_answered_one_by_one() {
    let mut rig = TestRig::in_data();
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
    let answer = rig.call(3, &request);
    assert_eq!((answer.event, answer.status, answer.blocks.len()), (Some(Event::Stored), 0, 64 * 4));
    let statuses: Vec<&[u8]> = answer.blocks.chunks(64).map(|answer| &answer[44..48]).collect();
    assert_eq!(statuses, [&[0; 4][..], &[0; 4], &[0xDF, 0x80, 0xB0, 0], &[0; 4]]);
    assert_eq!(rig.device.stored().maintenance.descriptor, [b'z'; 54]);
    // Writes without room for an answer are not executed.
    let parts: Vec<u8> = (b'a'..=b'q').flat_map(|letter| part(0xAFF3, &block(0x23, &[letter; 54]))).collect();
    let request = [record(8, AR, 0, 0, 0xE040, parts.len() as u32), parts].concat();
    let answer = rig.call(3, &request);
    assert_eq!((answer.status, answer.blocks.len()), (0, 64 * 17));
    assert_eq!(rig.device.stored().maintenance.descriptor, [b'p'; 54], "the 16th write");
}

#[test]
fn real_and_expected_identification_are_read_at_every_level() {
    let mut rig = TestRig::in_data();
    let head = |kind: u8, body: &[u8]| {
        let mut bytes = block(kind.into(), body);
        bytes[5] = 1;
        bytes
    };
    let second = [0, 1, 0, 0, 0, 0, 0, 1, 0, 2, 0, 0, 0, 0x30, 0, 1, 0, 1, 0, 0, 0, 0x31];
    for (real, expected) in [(0x8001, 0x8000), (0xC001, 0xC000)] {
        assert_eq!(read(&mut rig, AR, 2, 1, real).unwrap(), head(0x13, &second));
        assert_eq!(read(&mut rig, AR, 2, 1, expected).unwrap(), head(0x12, &second));
    }
    for index in [0xF000, 0xE001] {
        let all = read(&mut rig, AR, 0, 0, index).unwrap();
        assert_eq!(all[6..18], [0, 1, 0, 0, 0, 0, 0, 3, 0, 0, 0, 0]);
        assert_eq!(all.len(), 6 + 6 + 2 + 3 * 8 + 5 * 6);
    }
    let expected = read(&mut rig, AR, 0, 0, 0xE000).unwrap();
    assert_eq!(expected[6..], read(&mut rig, AR, 0, 0, 0xE001).unwrap()[6..]);
    assert_eq!(read(&mut rig, AR, 0, 0, 0xE002).unwrap(), block(0x8104, &[0, 0]));
    assert_eq!(read(&mut rig, AR, 0, 0, 0xF821).unwrap(), block(0x1A, &[0, 1, 0, 0, 0, 0]));
    let filter = read(&mut rig, AR, 0, 0, 0xF840).unwrap();
    let kinds: Vec<u16> = blocks_of(&filter).iter().map(|(kind, _)| *kind).collect();
    assert_eq!(kinds, [0x30, 0x32]);
    assert_eq!(
        blocks_of(&filter)[1].1,
        [0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0x10, 0, 1, 0, 1, 0, 0, 0, 0x11]
    );
}

#[test]
fn faults_are_read_as_diagnosis() {
    let mut rig = TestRig::in_data();
    assert_eq!(read(&mut rig, AR, 0, 1, 0x800A).unwrap(), []);
    rig.device.show_faults(0b101);
    let mut expected = block(
        0x10,
        &[0, 0, 0, 0, 0, 0, 0, 1, 0x80, 0, 8, 0, 0x80, 0, 0x80, 0, 8, 0, 1, 0, 0x80, 0, 8, 0, 1, 2],
    );
    expected[5] = 1;
    for index in [0x800A, 0x800B, 0x800C, 0xC00A, 0xE00C, 0xF00B, 0xF80C] {
        assert_eq!(read(&mut rig, AR, 0, 1, index).unwrap(), expected, "{index:X}");
    }
    assert_eq!(read(&mut rig, AR, 1, 1, 0x800A).unwrap(), [], "another slot");
}

#[test]
fn interface_and_port_are_read() {
    let mut rig = TestRig::in_data();
    let interface = read(&mut rig, AR, 0, 0x8000, 0x8080).unwrap();
    let expected = [
        &[2, 0x40, 0, 36, 1, 0, 9][..],
        b"example-1",
        &DEVICE.0,
        &[0, 0, 192, 168, 0, 5, 255, 255, 255, 0, 0, 0, 0, 0],
    ]
    .concat();
    assert_eq!(interface[..4], [2, 0x40, 0, 32]);
    assert_eq!(interface[4..], expected[4..]);
    let port = read(&mut rig, AR, 0, 0x8001, 0x802A).unwrap();
    assert_eq!(port[12..21], *b"\x08port-001");
    assert_eq!(port.len() % 4, 0);
    let both = read(&mut rig, AR, 0, 0, 0xF841).unwrap();
    let blocks = blocks_of(&both);
    assert_eq!(blocks.iter().map(|(kind, _)| *kind).collect::<Vec<_>>(), [0x400, 0x400]);
    assert_eq!((blocks[0].1[10..].to_vec(), blocks[1].1[10..].to_vec()), (interface, port));
}

#[test]
fn unavailable_records_are_rejected_with_a_reason() {
    let mut rig = TestRig::in_data();
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
        assert_eq!(read(&mut rig, uuid, slot, subslot, index), Err(status), "{index:X}");
    }
    // Too long for the request.
    assert_eq!(rig.call(2, &record(9, AR, 0, 1, 0xAFF0, 59)).status, 0xDE80_B100);
    assert_eq!(rig.call(2, &record(9, AR, 0, 1, 0xAFF0, 60)).status, 0);
    assert_eq!(rig.call(2, &[]).status, 0xDE80_B100);
}

#[test]
fn reader_connects_beside_the_controller_and_changes_nothing() {
    const READER: [u8; 16] = [0xEE; 16];
    let mut rig = TestRig::in_data();
    let answer = rig.call(0, &Wanted::access(READER).blocks());
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(blocks_of(&answer.blocks).len(), 1);
    assert!(read(&mut rig, READER, 0, 1, 0xAFF0).is_ok());
    assert_eq!(read(&mut rig, READER, 0, 0, 0xE002), Err(0xDE80_A900));
    let write = [record(8, READER, 0, 1, 0xAFF2, 22), block(0x22, &[b'x'; 16])].concat();
    assert_eq!(rig.call(3, &write).status, 0xDF80_B600);
    assert_eq!(rig.call(4, &control(0x0110, READER, 1)).status, 0xDD81_4005);
    // Only one reader can connect.
    assert_eq!(rig.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0xDB81_4004);
    let answer = rig.call(1, &control(0x0114, READER, 4));
    assert_eq!((answer.event, answer.status), (None, 0));
    assert_eq!(rig.device.state(), State::Data);
    assert_eq!(read(&mut rig, READER, 0, 1, 0xAFF0), Err(0xDE80_B600));
}

#[test]
fn idle_reader_loses_its_connection() {
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::access([0xEE; 16]).blocks());
    rig.now += 900_000;
    assert!(read(&mut rig, [0xEE; 16], 0, 1, 0xAFF0).is_ok());
    rig.now += 999_999;
    rig.poll();
    assert!(rig.device.poll_timeout(rig.now) <= rig.now + 1);
    assert_eq!(rig.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0xDB81_4004);
    rig.now += 1;
    rig.poll();
    assert_eq!(rig.call(0, &Wanted::access([0xEF; 16]).blocks()).status, 0);
}
