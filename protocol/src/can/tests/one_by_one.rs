//! Edge cases of the mapping.

use super::*;
use crate::Frame;
use crate::types::{AckKey, HomingDirection, PrePositionFlags};

fn grip() -> Message {
    Message::command(Command::GripPart { width: 20.0, speed: 50.0 })
}

#[test]
fn size_field_ends_a_message_and_can_frame_length_never_does() {
    // Lengths around the multiples of eight: the last frame is full for 8, 16 and 24 bytes.
    for payload_len in 0..=24 {
        let message = Message::new(6, &[0x5A; 24][..payload_len]);
        let frames = message.frames();
        assert_eq!(frames.len(), payload_len.div_ceil(8) + 1);

        let mut wire = Wire::<4>::new();
        let (last, before) = frames.split_last().unwrap();
        wire.receive(before);
        assert_eq!(wire.seen, []);
        wire.receive([last]);
        assert_eq!(wire.messages(), [message]);
        assert_eq!(wire.reassembler.poll_timeout(), None);
    }
}

#[test]
fn longest_message_passes_and_one_more_byte_is_oversize() {
    let longest = Message::new(6, &[1; 8 * MAX_FRAMES - OVERHEAD]);
    let mut wire = Wire::<MAX_FRAMES>::new();
    wire.receive(&longest.frames());
    assert_eq!(wire.messages(), [longest]);

    let longer = Message::new(6, &[1; 8 * MAX_FRAMES - OVERHEAD + 1]);
    wire.receive(&longer.frames());
    wire.receive(&grip().frames());
    assert_eq!(wire.seen[1..], [Seen::Oversize(6, 1017), Seen::Message(grip())]);
    let counters = wire.reassembler.counters();
    assert_eq!((counters.oversize, counters.dropped, counters.miscut), (1, 129, 0));
}

#[test]
fn greatest_size_field_is_oversize() {
    let mut wire = Wire::<1>::new();
    wire.receive(&[CanFrame::ours(&[0xAA, 0xAA, 0xAA, 6, 0xFF, 0xFF, 0, 0])]);
    assert_eq!(wire.seen, [Seen::Oversize(6, 0xFFFF)]);
}

#[test]
fn partial_message_times_out_and_held_messages_are_delivered() {
    let mut wire = Wire::<4>::new();
    // A false first frame that waits for three more frames, followed by a complete message.
    wire.receive(&[CanFrame::ours(&[0xAA, 0xAA, 0xAA, 6, 24, 0, 0, 0])]);
    let stop = Message::command(Command::Stop);
    wire.receive(&stop.frames());
    let at = wire.reassembler.poll_timeout().unwrap();
    assert_eq!(at, wire.now.plus(HALF_MS));

    wire.pass(HALF_MS - 1);
    assert_eq!(wire.seen, []);
    wire.pass(1);
    assert_eq!(wire.messages(), [stop]);
    assert_eq!(wire.reassembler.poll_timeout(), None);
    assert_eq!(
        wire.reassembler.counters(),
        ReassemblerCounters { expired: 1, dropped: 1, ..ReassemblerCounters::default() }
    );
}

#[test]
fn next_frame_expires_an_overdue_partial_message_by_itself() {
    let [head, tail] = &grip().frames()[..] else { panic!() };
    for (late_by, delivered) in [(0, 0), (1, 1)] {
        let mut wire = Wire::<4>::new();
        wire.receive([head]);
        wire.now = wire.now.plus(HALF_MS - late_by);
        wire.receive([tail]);
        assert_eq!(wire.messages().len(), delivered);
    }
}

#[test]
fn timeout_runs_from_the_last_frame_despite_other_traffic() {
    let mut wire = Wire::<4>::new();
    let message = Message::new(6, &[3; 16]);
    let frames = message.frames();
    for frame in &frames {
        wire.pass(HALF_MS - 1);
        wire.receive([frame]);
    }
    assert_eq!(wire.messages(), [message]);

    wire.receive(&frames[..1]);
    wire.pass(HALF_MS - 1);
    let foreign = CanFrame { id: StandardId::ZERO.into(), ..frames[1].clone() };
    wire.receive([&foreign]);
    wire.pass(1);
    assert_eq!(wire.reassembler.counters().expired, 1);
}

#[test]
fn message_in_the_payload_of_a_broken_message_is_ignored() {
    // A byte parser would find the Stop in this payload once the first frame is lost.
    let mut payload = vec![0; 3];
    payload.extend(Message::command(Command::Stop).bytes());
    payload.extend([0; 10]);
    let frames = Message::new(6, &payload).frames();
    let mut wire = Wire::<4>::new();
    wire.receive(&frames[1..]);
    wire.pass(HALF_MS);
    assert_eq!(wire.seen, []);
    assert_eq!(wire.reassembler.counters().dropped, 3);
}

#[test]
fn right_bytes_in_a_wrong_cut_are_no_message() {
    let bytes = grip().bytes();
    for cut in [[7, 9], [1, 15], [4, 12]] {
        let (first, second) = bytes.split_at(cut[0]);
        let mut wire = Wire::<4>::new();
        let frames: Vec<CanFrame> =
            [first, second].iter().flat_map(|piece| piece.chunks(8)).map(CanFrame::ours).collect();
        wire.receive(&frames);
        wire.receive(&grip().frames());
        assert_eq!(wire.messages(), [grip()], "{cut:?}");
    }
    // A short frame in the middle, where frames must be full.
    let long = Message::new(6, &[9; 12]).bytes();
    let mut wire = Wire::<4>::new();
    wire.receive(&[CanFrame::ours(&long[..8]), CanFrame::ours(&long[8..12]), CanFrame::ours(&long[12..])]);
    assert_eq!(wire.seen, []);
    assert_eq!(
        wire.reassembler.counters(),
        ReassemblerCounters { miscut: 1, dropped: 3, ..ReassemblerCounters::default() }
    );
}

#[test]
fn shared_frame_replaces_a_lost_one_and_yields_the_sent_message() {
    // The low bytes of both widths are 0, so the two requests have identical first frames.
    let other = Message::command(Command::GripPart { width: 40.0, speed: 60.0 });
    let ([head, _], [other_head, other_tail]) = (&grip().frames()[..], &other.frames()[..]) else { panic!() };
    assert_eq!(head, other_head);
    let mut wire = Wire::<4>::new();
    wire.receive([head, other_tail]);
    assert_eq!(wire.messages(), [other]);
}

#[test]
fn frame_with_more_data_than_classic_can_has_is_foreign() {
    let mut wire = Wire::<4>::new();
    wire.receive(&[CanFrame::ours(&grip().bytes())]);
    assert_eq!(wire.seen, []);
    assert_eq!(
        wire.reassembler.counters(),
        ReassemblerCounters { foreign: 1, ..ReassemblerCounters::default() }
    );
}

#[test]
fn reset_forgets_half_a_message() {
    let [head, tail] = &grip().frames()[..] else { panic!() };
    let mut wire = Wire::<4>::new();
    wire.receive([head]);
    wire.reassembler.reset();
    assert_eq!(wire.reassembler.poll_timeout(), None);
    wire.receive([tail]);
    assert_eq!(wire.seen, []);
    assert_eq!(wire.reassembler.counters().dropped, 2);
}

#[test]
fn counts_stay_at_their_maximum() {
    let mut wire = Wire::<4>::new();
    let foreign = CanFrame { remote: true, ..CanFrame::ours(&[1]) };
    for _ in 0..=u16::MAX {
        wire.receive([&foreign]);
    }
    assert_eq!(wire.reassembler.counters().foreign, u16::MAX);
}

#[test]
fn no_motion_fits_in_one_can_frame_that_could_be_doubled() {
    for id in (0..=u8::MAX).map(CommandId::from_code) {
        let parameterless = Command::decode(&crate::Frame { id: id.code(), payload: &[] }).is_ok();
        if parameterless && !matches!(id, CommandId::Unknown(_)) {
            assert!(!matches!(id.kind(), Kind::Motion | Kind::Acknowledge), "{id:?}");
        }
    }
    // No reply fits either: all begin with a status code.
    let shortest = FrameEncoder::new(0x25, Reply::status_only(CommandId::GripPart, Status::Success));
    assert_eq!(Segments::new(shortest).count(), 2);
}

#[test]
fn segmenter_sends_nothing_that_is_no_message() {
    let mut segmenter = Segmenter::new();
    let noise = [0x00, 0xAA, 0xAA, 0x01, 0xAA, 0x02];
    let line: Vec<u8> = noise.into_iter().chain(grip().bytes()).collect();
    let segments: Vec<Vec<u8>> =
        line.iter().filter_map(|&byte| segmenter.push(byte)).map(|segment| segment.data().to_vec()).collect();
    assert_eq!(segments.concat(), grip().bytes());
    assert!(!segmenter.is_mid_message());
}

#[test]
fn message_given_up_half_way_leaves_the_next_one_whole() {
    let mut segmenter = Segmenter::new();
    let bytes = grip().bytes();
    let begun = bytes.iter().take(11).filter_map(|&byte| segmenter.push(byte)).count();
    assert_eq!((begun, segmenter.is_mid_message()), (1, true));
    segmenter.reset();
    assert!(!segmenter.is_mid_message());
    let next: Vec<Segment> = bytes.iter().filter_map(|&byte| segmenter.push(byte)).collect();
    assert_eq!(next.iter().map(|segment| segment.data().len()).collect::<Vec<_>>(), [8, 8]);
    assert_eq!(next[0].data(), &bytes[..8]);
}

#[test]
fn segmenter_takes_the_longest_message_a_size_field_allows() {
    let bytes = Message::new(6, &vec![0x11; 0xFFFF]).bytes();
    let segments: Vec<Segment> = Segments::new(bytes.iter().copied()).collect();
    assert_eq!(segments.len(), 8192 + 1);
    assert_eq!(segments.last().unwrap().data(), &bytes[65_536..]);
}

#[test]
fn controller_sends_on_n_and_the_gripper_on_the_next_identifier() {
    let pair = Identifiers::from_base(0x7FE).unwrap();
    assert_eq!((pair.controller().transmit.as_raw(), pair.controller().receive.as_raw()), (0x7FE, 0x7FF));
    assert_eq!((pair.gripper().transmit.as_raw(), pair.gripper().receive.as_raw()), (0x7FF, 0x7FE));
    assert_eq!(pair.base(), 0x7FE);
    assert_eq!(Identifiers::from_base(0x7FF), None);
    assert_eq!(Identifiers::from_base(u16::MAX), None);
}

#[test]
fn spoilt_end_has_a_wrong_checksum_after_any_bytes() {
    let homing = Command::Homing { direction: HomingDirection::Positive };
    let last = Segments::new(FrameEncoder::new(homing.id().code(), homing)).last().unwrap();
    for before in 0..=u16::MAX {
        let mut spoilt = last;
        let after = spoilt.spoil(before, true);
        assert_ne!(after, 0, "{before:04X}h");
        assert_eq!(after, checksum::push_slice(before, spoilt.data()));
    }
}

#[test]
fn motion_with_spoilt_rest_is_invalid_even_if_checksums_are_off() {
    // Command set, 1.4.1: checksum evaluation of the gripper can be disabled.
    for command in [
        Command::Homing { direction: HomingDirection::Positive },
        Command::PrePosition { flags: PrePositionFlags::empty(), width: 20.0, speed: 50.0 },
        Command::GripPart { width: 20.0, speed: 50.0 },
        Command::ReleasePart { width: 20.0, speed: 50.0 },
        Command::Acknowledge { key: AckKey },
    ] {
        let segments: Vec<Segment> = Segments::new(FrameEncoder::new(command.id().code(), command)).collect();
        let intact = segments.iter().flat_map(|segment| segment.data().to_vec()).collect::<Vec<u8>>();
        for sent in 1..segments.len() {
            let mut segments = segments.clone();
            let count = segments.len();
            let (before, rest) = segments.split_at_mut(sent);
            let mut running = checksum::START;
            for segment in before {
                running = checksum::push_slice(running, segment.data());
            }
            for (n, segment) in rest.iter_mut().enumerate() {
                running = segment.spoil(running, sent + n + 1 == count);
            }
            let spoilt = segments.iter().flat_map(|segment| segment.data().to_vec()).collect::<Vec<u8>>();
            assert_eq!(
                spoilt.len(),
                intact.len(),
                "the length must not change, so the gripper finds the next message"
            );
            let (covered, received) = spoilt.split_last_chunk().unwrap();
            assert_ne!(
                checksum::push_slice(checksum::START, covered).to_le_bytes(),
                *received,
                "{command:?}"
            );
            assert_ne!(checksum::push_slice(checksum::START, &spoilt), 0, "{command:?}, {sent} sent");
            let payload = |message: &[u8]| message[6..message.len() - 2].to_vec();
            if payload(&spoilt) == payload(&intact) {
                // All data bytes were sent before; only the checksum remains.
                continue;
            }
            let payload = payload(&spoilt);
            match Command::decode(&Frame { id: command.id().code(), payload: &payload }) {
                Err(_) => {}
                Ok(Command::PrePosition { width, speed, .. } | Command::GripPart { width, speed })
                | Ok(Command::ReleasePart { width, speed }) => {
                    assert!(width > 1e38 && speed > 1e38, "{command:?}, {sent} sent: {width}, {speed}");
                }
                Ok(taken) => panic!("{command:?}, {sent} sent: {taken:?}"),
            }
        }
    }
}
