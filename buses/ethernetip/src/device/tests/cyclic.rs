//! Cyclic data.

use super::*;

/// A device with an owner, and the identifier of the owner's packets.
fn owned(open: &Fo) -> (Rig, u32) {
    let (mut rig, session) = Rig::with_session();
    let id = rig.open(1, session, open).unwrap();
    assert_eq!(rig.events(), [Event::Connected]);
    (rig, id)
}

#[test]
fn sequence_numbers_decide_what_is_new() {
    for first in [0_u32, 1, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFE] {
        for first_count in [0_u16, 0x8000, 0xFFFF] {
            let (mut rig, id) = owned(&OWN);
            // Steps of the sequence number and of the count, and the event.
            for (sequence, count, event) in [
                (0, 0, Some(Event::Outputs)),
                (1, 1, Some(Event::Outputs)),
                (1, 2, None),
                (0, 3, None),
                (0xFFFF_FFF0, 4, None),
                (2, 1, None),
                (3, 0, Some(Event::Outputs)),
                (0x7FFF_FFFF, 9, Some(Event::Outputs)),
                (0xFFFF_FFFF, 10, None),
                (0x8000_0000, 10, Some(Event::Outputs)),
            ] {
                let (sequence, count) = (first.wrapping_add(sequence), first_count.wrapping_add(count));
                let events = rig.outputs(id, sequence, count, 1);
                assert_eq!(events, event.into_iter().collect::<Vec<_>>(), "{sequence:x} {count:x}");
            }
            assert_eq!(rig.device.counters().packets_dropped, 4);
        }
    }
}

#[test]
fn idle_precedes_the_next_outputs_even_if_not_taken() {
    let (mut rig, id) = owned(&OWN);
    for (sequence, (count, header, events)) in (1..).zip([
        (1, 0, &[][..]),
        (2, 0, &[]),
        (3, 1, &[Event::Outputs]),
        // Only bit 0 is the mode.
        (4, 0xFFFF_FFFE, &[Event::Idle]),
        (5, 3, &[Event::Outputs]),
        (6, 1, &[Event::Outputs]),
        // The mode counts even with a frozen count.
        (6, 0, &[Event::Idle]),
        (6, 1, &[Event::Outputs]),
        (6, 1, &[]),
    ]) {
        assert_eq!(rig.outputs(id, sequence, count, header), events, "{sequence}");
        let (expected, mode) =
            if header & 1 == 0 { ([0; 8], State::Idle) } else { ([count as u8; 8], State::Run) };
        assert_eq!((*rig.device.outputs(), rig.device.state()), (expected, mode));
    }
    // Several packets before the application takes an event.
    assert!(rig.packet(PLC, id, 10, "0700 01000000 0102030405060708"));
    rig.packet(PLC, id, 11, "0800 00000000 0102030405060708");
    rig.packet(PLC, id, 12, "0900 01000000 1112131415161718");
    assert_eq!(rig.events(), [Event::Idle, Event::Outputs]);
    assert_eq!(rig.device.outputs()[0], 0x11);
    rig.packet(PLC, id, 13, "0a00 01000000 0102030405060708");
    rig.packet(PLC, id, 14, "0b00 00000000 0102030405060708");
    assert_eq!((rig.events(), rig.device.outputs()), (std::vec![Event::Idle], &[0; 8]));
}

#[test]
fn foreign_and_malformed_packets_are_dropped_and_counted() {
    let (mut rig, id) = owned(&OWN);
    rig.outputs(id, 5, 5, 1);
    let before = rig.device.poll_timeout(0);
    let data = "0600 01000000 ffffffffffffffff";
    rig.now = 1_000;
    rig.packet(OTHER, id, 6, data);
    rig.packet(PLC, id ^ 1, 6, data);
    rig.packet(PLC, id ^ 0x100, 6, data);
    // The identifier of the other direction; no header; one byte too short and too long.
    rig.packet(PLC, 0xE419_A12F, 6, data);
    rig.packet(PLC, id, 6, "0600 ffffffffffffffff");
    rig.packet(PLC, id, 6, &data[..data.len() - 2]);
    rig.packet(PLC, id, 6, &(data.to_owned() + "ff"));
    let id = hex(&id.to_le_bytes());
    for wrong in [
        "",
        "0100 0280 0800 I 06000000 b100 0e00 D",
        "0300 0280 0800 I 06000000 b100 0e00 D",
        "0200 0280 0700 I 060000 b100 0e00 D",
        "0200 0280 0c00 I 06000000 00000000 b100 0e00 D",
        "0200 a100 0800 I 06000000 b100 0e00 D",
        "0200 0280 0800 I 06000000 b200 0e00 D",
        "0200 0280 0800 I 06000000 b100 0f00 D",
        "0200 0280 0800 I 06000000 b100 0e00 D 00",
    ] {
        let packet = bytes(&wrong.replace('I', &id).replace('D', data));
        rig.device.receive_packet(rig.now, PLC, &packet);
    }
    assert_eq!((rig.events(), rig.device.outputs()), (Vec::new(), &[5; 8]));
    assert_eq!(rig.device.counters().packets_dropped, 16);
    rig.sent();
    assert_eq!(rig.device.poll_timeout(rig.now).min(before), before);
}

#[test]
fn silence_ends_the_owner_and_another_follows_at_once() {
    for (multiplier, timeout) in [(0, 80_000), (3, 640_000), (7, 10_240_000)] {
        let open = Fo { multiplier, ..OWN };
        let (mut rig, id) = owned(&open);
        // Before the first packet, at least 10 s. A frozen count and an idle packet keep the connection alive.
        rig.now = 10_000_000_u64.max(timeout) - 1;
        assert_eq!(rig.outputs(id, 1, 1, 1), [Event::Outputs]);
        rig.now += timeout - 1;
        assert_eq!(rig.outputs(id, 2, 1, 1), []);
        rig.now += timeout - 1;
        assert_eq!(rig.outputs(id, 3, 2, 0), [Event::Idle]);
        rig.now += timeout - 1;
        assert_eq!(rig.outputs(id, 4, 3, 1), [Event::Outputs]);
        rig.now += timeout - 1;
        // A dropped packet does not.
        rig.packet(OTHER, id, 5, "0500 01000000 0000000000000000");
        assert_eq!((rig.events(), rig.device.state()), (Vec::new(), State::Run));
        rig.sent();
        rig.now += 1;
        assert!(rig.device.poll_timeout(rig.now) <= rig.now);
        // A late packet revives nothing, and inputs stop.
        rig.packet(PLC, id, 6, "0600 01000000 0606060606060606");
        assert_eq!((rig.sent(), rig.device.outputs()), (Vec::new(), &[0; 8]));
        let session = rig.register(100);
        let next = rig.open(100, session, &open).unwrap();
        assert_ne!(next, id);
        let close = Event::Close(1);
        assert_eq!(rig.events(), [Event::Left(Cause::Silence), Event::Connected, close]);
    }
}

#[test]
fn waiting_outputs_are_discarded_with_their_owner() {
    let (mut rig, id) = owned(&OWN);
    rig.packet(PLC, id, 1, "0100 01000000 ffffffffffffffff");
    rig.now = 160_000;
    assert_eq!(rig.events(), [Event::Left(Cause::Silence), Event::Close(1)]);
    assert_eq!(rig.device.outputs(), &[0; 8]);
}

#[test]
fn observers_never_set_outputs_and_keep_their_own_time() {
    let (mut rig, session) = Rig::with_session();
    let watch = rig.open(1, session, &INPUT_ONLY).unwrap();
    let full = rig.open(1, session, &Fo { serial: 9, size: [6, 14], ..INPUT_ONLY }).unwrap();
    rig.now = 9_000_000;
    assert!(!rig.packet(PLC, watch, 1, "0100"));
    rig.packet(PLC, full, 1, "0100 01000000");
    rig.packet(PLC, watch, 2, "0200 01000000 ffffffffffffffff");
    assert_eq!((rig.events(), rig.device.outputs()), (Vec::new(), &[0; 8]));
    assert_eq!(rig.device.counters().packets_dropped, 1);
    rig.now += 159_999;
    rig.packet(PLC, full, 2, "0100 01000000");
    rig.now += 1;
    assert_eq!(rig.events(), []);
    assert_eq!(rig.device.connections().count(), 1);
}

#[test]
fn inputs_are_sent_in_each_interval_of_their_connection() {
    let (mut rig, id) = owned(&Fo { rpi: [10_000_000, 20_000], ..OWN });
    let session = rig.register(100);
    rig.open(100, session, &Fo { rpi: [10_000_000, 50_000], ..INPUT_ONLY }).unwrap();
    let mut count = [0; 2];
    while rig.now < 1_000_000 {
        for (to, packet) in rig.sent() {
            let place = usize::from(*to.ip() == OTHER);
            count[place] += 1;
            assert_like(&packet[20..28], &hex(&u32::to_le_bytes(count[place])), "sequence number");
            assert_like(&packet[36..40], &hex(&(count[place] as u16).to_le_bytes()), "sequence count");
        }
        rig.now = rig.device.poll_timeout(rig.now);
    }
    assert_eq!(count, [50, 20]);
    // A late caller sends one packet, not all that it missed.
    rig.sent();
    rig.now += 9_000_010;
    rig.outputs(id, 1, 1, 1);
    assert_eq!(rig.sent().len(), 2);
    assert_eq!(rig.device.poll_timeout(rig.now), 10_020_000);
}
