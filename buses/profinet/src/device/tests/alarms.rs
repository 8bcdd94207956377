use super::*;

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
fn alarms(rig: &mut TestRig) -> Vec<Vec<u8>> {
    let mut all = rig.acyclic();
    all.retain(|frame| frame[12..14] == [0x81, 0] && matches!(frame[18..20], [0xFE | 0xFC, 1]));
    all.into_iter().map(|frame| frame[18..].to_vec()).collect()
}

#[test]
fn fault_is_reported_acknowledged_twice_and_cleared() {
    let mut rig = TestRig::in_data();
    rig.device.show_faults(0b001);
    assert_eq!(rig.poll(), None);
    let sent = alarms(&mut rig);
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
    let now = rig.now;
    assert_eq!(rig.device.receive(now, &rta(false, 0x13, 0xFFFE, 0xFFFF, &[])), None);
    assert_eq!(rig.device.receive(now, &rta(false, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(false, 1, 0))), None);
    assert_eq!(alarms(&mut rig)[0][..14], [0xFE, 1, 0, 3, 0, 1, 0x13, 1, 0xFF, 0xFF, 0xFF, 0xFF, 0, 0]);
    assert_eq!((rig.poll(), alarms(&mut rig)), (None, vec![]), "reported once");

    rig.device.show_faults(0);
    rig.poll();
    let sent = alarms(&mut rig);
    // The next sequence number; disappears, with the next alarm number, and no fault left.
    assert_eq!(sent[0][8..12], [0, 0, 0xFF, 0xFF]);
    assert_eq!(sent[0][20..22], [0, 0x0C]);
    assert_eq!(sent[0][38..], [0x08, 1, 0x80, 0, 0x80, 0, 0x10, 0, 0x01, 0x00]);
}

#[test]
fn each_fault_is_reported_once_when_it_appears_and_disappears() {
    let mut rig = TestRig::in_data();
    let (mut sequence, mut number, mut ours) = (0xFFFF_u16, 0, 0xFFFF_u16);
    let following = |number: u16| number.wrapping_add(1) & 0x7FFF;
    // Present faults, and the expected alarm: fault, and whether it appears.
    for (faults, reported) in [
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
        rig.device.show_faults(faults);
        assert_eq!(rig.poll(), None);
        let sent = alarms(&mut rig);
        let found = sent.first().map(|alarm| {
            let word = |at: usize| u16::from_be_bytes([alarm[at], alarm[at + 1]]);
            assert_eq!(word(8), ours, "sequence number of the transport");
            assert_eq!(word(38) & 0x07FF, number, "number of the alarm");
            // Whether the submodule and the connection have any diagnosis.
            assert_eq!(word(38) & 0xA000, if faults == 0 { 0 } else { 0xA000 });
            (word(46), word(20) == 1)
        });
        assert_eq!((sent.len(), found), (usize::from(reported.is_some()), reported), "{faults:b}");
        if let Some((_, appears)) = reported {
            let ack = alarm_ack(false, if appears { 1 } else { 0x0C }, number);
            rig.device.receive(rig.now, &rta(false, 0x11, sequence, ours, &ack));
            assert_eq!(rig.device.poll_timeout(rig.now), rig.now, "the acknowledgement is due");
            assert_eq!(alarms(&mut rig).len(), 1);
            (sequence, ours, number) = (following(sequence), following(ours), number + 1);
        }
    }
}

#[test]
fn alarm_is_due_at_once_and_again_after_its_time_out() {
    let mut rig =
        TestRig::in_data_as(&Wanted { send_clock: 128, reduction: 128, hold: 3, ..Wanted::default() });
    rig.sent();
    rig.device.show_faults(1);
    rig.poll();
    assert_eq!(rig.device.poll_timeout(rig.now), rig.now);
    assert_eq!(alarms(&mut rig).len(), 1);
    assert_eq!(rig.device.poll_timeout(rig.now), rig.now + 100_000);
}

#[test]
fn only_the_acknowledgement_of_the_reported_alarm_ends_it() {
    let mut rig = TestRig::in_data();
    rig.device.show_faults(1);
    rig.poll();
    assert_eq!(alarms(&mut rig).len(), 1);
    let mut sequence = 0xFFFF_u16;
    // Of the other priority, of another alarm, or none: the frame is acknowledged, but the alarm stays pending.
    for ack in [alarm_ack(true, 1, 0), alarm_ack(false, 1, 1), block(0x8002, &[0; 4]), vec![]] {
        rig.device.receive(rig.now, &rta(false, 0x11, sequence, 0xFFFF, &ack));
        assert_eq!(alarms(&mut rig)[0][6], 0x13);
        // A repeated frame is acknowledged again, one out of sequence is not.
        rig.device.receive(rig.now, &rta(false, 0x11, sequence, 0xFFFF, &ack));
        assert_eq!(alarms(&mut rig).len(), 1);
        let ahead = rta(false, 0x11, sequence.wrapping_add(2) & 0x7FFF, 0xFFFF, &alarm_ack(false, 1, 0));
        rig.device.receive(rig.now, &ahead);
        assert_eq!(alarms(&mut rig).len(), 0);
        rig.device.show_faults(0);
        rig.poll();
        assert_eq!(alarms(&mut rig).len(), 0, "the alarm for the cleared fault waits");
        sequence = sequence.wrapping_add(1) & 0x7FFF;
    }
    rig.device.receive(rig.now, &rta(false, 0x11, sequence, 0xFFFF, &alarm_ack(false, 1, 0)));
    rig.poll();
    assert_eq!(alarms(&mut rig).len(), 2, "the acknowledgement, and the alarm for the cleared fault");
}

#[test]
fn high_priority_alarm_does_not_wait_for_a_low_priority_one() {
    let mut rig = TestRig::in_data();
    rig.device.show_faults(0b101);
    rig.poll();
    assert_eq!(alarms(&mut rig).len(), 1, "one at a time");
    rig.device.show_faults(0b111);
    rig.poll();
    let sent = alarms(&mut rig);
    assert_eq!((sent.len(), &sent[0][..2], &sent[0][14..16]), (1, &[0xFC, 1][..], &[0, 1][..]));
    let now = rig.now;
    rig.device.receive(now, &rta(true, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(true, 1, 0)));
    assert_eq!(alarms(&mut rig)[0][6], 0x13);
    // The low-priority acknowledgement, and the next low-priority alarm.
    rig.device.receive(now, &rta(false, 0x11, 0xFFFF, 0xFFFF, &alarm_ack(false, 1, 0)));
    rig.poll();
    let sent = alarms(&mut rig);
    assert_eq!((sent.len(), sent[1][46..].to_vec()), (2, vec![0x01, 0x02]));
}

#[test]
fn all_alarms_are_low_if_the_controller_requests_it() {
    let mut rig = TestRig::in_data_as(&Wanted { alarm_properties: 1, ..Wanted::default() });
    rig.device.show_faults(0b010);
    rig.poll();
    assert_eq!(alarms(&mut rig)[0][..2], [0xFE, 1]);
}

#[test]
fn unacknowledged_alarm_is_repeated_and_ends_the_connection() {
    let mut rig = TestRig::in_data();
    rig.device.show_faults(1);
    let start = rig.now;
    let mut sent = 0;
    let event = loop {
        // The controller keeps sending outputs.
        rig.outputs([0; 3]);
        if let Some(event) = rig.poll() {
            break event;
        }
        sent += alarms(&mut rig).len();
        rig.now += 4_000;
        assert!(rig.now < start + 10_000_000);
    };
    // Three retries, at intervals of 100 ms.
    assert_eq!((event, sent, rig.now - start), (Event::Left(Cause::AlarmFailed), 4, 400_000));
    assert_eq!(rig.acyclic()[0][35], 8);
}

#[test]
fn foreign_rta_frames_and_wrong_numbers_change_nothing() {
    let mut rig = TestRig::in_data();
    rig.device.show_faults(1);
    rig.poll();
    assert_eq!(alarms(&mut rig).len(), 1);
    let good = rta(false, 0x13, 0xFFFE, 0xFFFF, &[]);
    for (at, value) in [(6, 0x12), (17, 9), (19, 9), (24, 0x12)] {
        let mut other = good.clone();
        other[at] = value;
        assert_eq!(rig.device.receive(rig.now, &other), None);
    }
    for len in 0..good.len() {
        assert_eq!(rig.device.receive(rig.now, &good[..len]), None);
    }
    for _ in 0..30 {
        rig.now += 4_000;
        rig.outputs([0; 3]);
    }
    assert_eq!(alarms(&mut rig).len(), 1, "still retried");
}

#[test]
fn abort_by_the_controller_ends_the_connection() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    let abort = rta(false, 0x14, 0xFFFE, 0xFFFE, &[0xCF, 0x81, 0xFD, 0x0F]);
    assert_eq!(rig.device.receive(rig.now, &abort), Some(Event::Left(Cause::Aborted)));
    assert_eq!(rig.device.outputs(), &[0; 3]);
    assert_eq!(rig.acyclic(), Vec::<Vec<u8>>::new(), "no answer to an abort");
}
