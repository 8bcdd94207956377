use super::*;

fn input_frames(rig: &mut TestRig) -> Vec<Vec<u8>> {
    let frames = rig.sent().into_iter();
    frames.filter(|frame| frame[12..14] == [0x81, 0] && frame[18..20] == INPUT_ID.to_be_bytes()).collect()
}

#[test]
fn inputs_are_sent_each_cycle_with_statuses_and_a_31_us_counter() {
    let mut rig = TestRig::in_data();
    rig.device.show_inputs(&[0xAA, 0xBB]);
    let start = rig.device.poll_timeout(rig.now);
    rig.now = start;
    let frames = input_frames(&mut rig);
    let [frame] = &frames[..] else { panic!("{frames:?}") };
    assert_eq!(frame[..20], [&PLC.0[..], &DEVICE.0, &[0x81, 0, 0xC0, 0, 0x88, 0x92, 0xC0, 1]].concat());
    // Statuses of the three submodules of slot 0, data and status of slot 1, consumer statuses.
    assert_eq!(frame[20..28], [0x80, 0x80, 0x80, 0xAA, 0xBB, 0x80, 0x80, 0x80]);
    assert_eq!(frame[28..60], [0; 32]);
    assert_eq!(frame[62..], [0x35, 0]);
    let counter = |frame: &[u8]| u16::from_be_bytes([frame[60], frame[61]]);
    let first = counter(frame);
    for cycle in 1..=20_u16 {
        rig.now += CYCLE_US - 1;
        assert_eq!(input_frames(&mut rig).len(), 0);
        assert_eq!(rig.device.poll_timeout(rig.now), rig.now + 1);
        rig.now += 1;
        let frames = input_frames(&mut rig);
        assert_eq!(counter(&frames[0]), first.wrapping_add(128 * cycle));
        rig.outputs([0; 3]);
    }
    // Late by two and a half cycles: one frame is sent, and the counter skips the missed cycles.
    rig.now += CYCLE_US * 7 / 2;
    let frames = input_frames(&mut rig);
    assert_eq!((frames.len(), counter(&frames[0])), (1, first.wrapping_add(128 * 21)));
    assert_eq!(
        rig.device.poll_timeout(rig.now).min(rig.now + CYCLE_US / 2),
        rig.now + HOLD_US - CYCLE_US * 7 / 2
    );
}

#[test]
fn inputs_are_bad_until_parameters_end_and_status_shows_faults() {
    let mut rig = TestRig::new();
    rig.call(0, &Wanted::default().blocks());
    rig.now += CYCLE_US;
    let frames = input_frames(&mut rig);
    assert_eq!(frames[0][20..28], [0, 0, 0, 0, 0, 0, 0, 0]);
    rig.call(4, &control(0x0110, AR, 1));
    rig.device.show_faults(1);
    rig.now += CYCLE_US;
    let frames = input_frames(&mut rig);
    assert_eq!((&frames[0][25..28], frames[0][62]), (&[0x80; 3][..], 0x15));
    // Only the data of slot 1 is bad.
    for (shown, expected) in
        [(Some([0xAA, 0xBB]), [0xAA, 0xBB, 0x80]), (None, [0; 3]), (Some([1, 2]), [1, 2, 0x80])]
    {
        match shown {
            Some(inputs) => rig.device.show_inputs(&inputs),
            None => rig.device.show_bad_inputs(),
        }
        rig.now += CYCLE_US;
        let frames = input_frames(&mut rig);
        assert_eq!(frames[0][20..28], [&[0x80; 3], &expected[..], &[0x80; 2]].concat());
    }
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
        let mut rig = TestRig::in_data();
        rig.outputs([1, 2, 3]);
        let frame = outputs_frame([4, 5, 6], 0x4000, statuses, status);
        assert_eq!(rig.device.receive(rig.now, &frame), expected, "{statuses:?} {status:X}");
        let outputs = match expected {
            Some(Event::Outputs) => [4, 5, 6],
            Some(_) => [0; 3],
            None => [1, 2, 3],
        };
        assert_eq!(rig.device.outputs(), &outputs);
        // Reported once.
        let again = outputs_frame([4, 5, 6], 0x4080, statuses, status);
        let expected = expected.filter(|event| *event == Event::Outputs);
        assert_eq!(rig.device.receive(rig.now, &again), expected);
    }
}

#[test]
fn old_repeated_and_foreign_frames_are_ignored() {
    let mut rig = TestRig::in_data();
    let mut take = |frame: &[u8]| rig.device.receive(rig.now, frame);
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
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    rig.now += HOLD_US - 1;
    assert_eq!((rig.poll(), rig.device.outputs()), (None, &[1, 2, 3]));
    rig.now += 1;
    assert_eq!(rig.poll(), Some(Event::Left(Cause::Silence)));
    assert_eq!(rig.device.poll_timeout(rig.now), rig.now, "RTA-ERR is due");
    assert_eq!((rig.device.outputs(), rig.device.state()), (&[0; 3], State::Unconnected));
    assert_eq!(
        rig.acyclic()[0][18..34],
        [0xFE, 1, 0, 3, 0, 1, 0x14, 1, 0xFF, 0xFE, 0xFF, 0xFE, 0, 4, 0xCF, 0x81]
    );
    // The controller can connect again.
    assert_eq!(rig.call(0, &Wanted::default().blocks()).status, 0);
}

#[test]
fn disconnect_ends_the_outputs_and_reports_silence_to_the_controller() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    assert_eq!(rig.device.disconnect(), Some(Event::Left(Cause::Silence)));
    assert_eq!((rig.outputs([4, 5, 6]), rig.device.outputs()), (None, &[0; 3]));
    assert_eq!(rig.acyclic()[0][18..20], [0xFE, 1]);
    assert_eq!(rig.device.disconnect(), None);
}

#[test]
fn ignored_frames_do_not_restart_the_hold_time() {
    for (counter, status) in [(0x1000, 0x35), (0x0F80, 0x35), (0x1080, 0x31)] {
        let mut rig = TestRig::in_data();
        let good = outputs_frame([1, 2, 3], 0x1000, [0x80; 2], 0x35);
        assert_eq!(rig.device.receive(rig.now, &good), Some(Event::Outputs));
        rig.now += HOLD_US - 1;
        let other = outputs_frame([4, 5, 6], counter, [0x80; 2], status);
        assert_eq!(rig.device.receive(rig.now, &other), None);
        assert_eq!(rig.device.outputs(), &[1, 2, 3]);
        rig.now += 1;
        assert_eq!(rig.poll(), Some(Event::Left(Cause::Silence)), "{counter:X} {status:X}");
    }
}

/// Frames may queue up while the caller is busy.
#[test]
fn outputs_after_the_hold_time_do_not_count_even_without_a_poll() {
    let mut rig = TestRig::in_data();
    rig.outputs([1, 2, 3]);
    rig.now += HOLD_US - 1;
    assert_eq!(rig.outputs([4, 5, 6]), Some(Event::Outputs));
    rig.now += HOLD_US;
    assert_eq!(rig.outputs([7, 8, 9]), Some(Event::Left(Cause::Silence)));
    assert_eq!((rig.outputs([7, 8, 9]), rig.device.outputs()), (None, &[0; 3]));
}
