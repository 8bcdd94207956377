//! Tests of the gripper's link on CAN alone: capacity, discarded messages and counters.

use bus_slcan::ClassicFrame;
use embedded_can::{Frame, Id, StandardId};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_bridge_fw::can::CanNode;
use wsg_bridge_fw::gripper::GripperLink;
use wsg_protocol::can::{Identifiers, Segments};
use wsg_protocol::frame::OVERHEAD;
use wsg_protocol::{Command, CommandId, DeviceTag, FrameEncoder, Instant};

const IDENTIFIERS: Identifiers = Identifiers::DEFAULT;
const LATER: Instant = Instant::from_millis(1);

fn link() -> GripperLink {
    GripperLink::new(IDENTIFIERS)
}

/// Returns a message with this many bytes of payload, as on a line.
fn message(payload_len: usize) -> Vec<u8> {
    let payload: Vec<u8> = (0..payload_len).map(|at| at as u8).collect();
    FrameEncoder::new(0x51, &payload[..]).collect()
}

/// Sends these bytes from the gripper.
fn deliver(link: &mut GripperLink, bytes: &[u8]) {
    for segment in Segments::new(bytes.iter().copied()) {
        let frame: ClassicFrame = segment.frame(IDENTIFIERS.gripper().transmit).unwrap();
        link.on_frame(LATER, &frame);
    }
}

fn read_all(link: &mut GripperLink) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 7];
    while link.read_ready().unwrap() {
        let count = link.read(&mut buffer).unwrap();
        bytes.extend(&buffer[..count]);
    }
    bytes
}

fn takes_back(link: &GripperLink) -> bool {
    CanNode::<ClassicFrame>::takes_back(link).is_some()
}

fn transmit(link: &mut GripperLink) -> Option<ClassicFrame> {
    link.poll_transmit(LATER)
}

/// Writes a message byte by byte, as the bridge does.
fn write_all(link: &mut GripperLink, bytes: &[u8]) {
    for byte in bytes {
        assert!(link.write_ready().unwrap());
        assert_eq!(link.write(&[*byte]).unwrap(), 1);
    }
}

#[test]
fn longest_reply_is_received_and_a_longer_one_is_counted() {
    let longest = message(DeviceTag::MAX_LEN + 2);
    let mut link = link();
    deliver(&mut link, &longest);
    assert_eq!(read_all(&mut link), longest);

    deliver(&mut link, &message(8 * longest.len()));
    assert_eq!(read_all(&mut link), []);
    assert_eq!(link.counters().frames.oversize, 1);
}

#[test]
fn full_queue_keeps_its_messages_and_counts_overflows() {
    // 32 messages of eight bytes are 256 bytes, which a bridge reads in one turn.
    let message = message(0);
    assert_eq!(message.len(), OVERHEAD);
    let mut link = link();
    assert!(!link.read_ready().unwrap());
    let fit = 256 / message.len();
    for _ in 0..fit {
        deliver(&mut link, &message);
    }
    assert_eq!(link.counters().overflows, 0);
    deliver(&mut link, &message);
    assert_eq!(link.counters().overflows, 1);
    assert_eq!(read_all(&mut link), message.repeat(fit));
    assert!(link.read(&mut [0]).is_err() && link.read(&mut []).is_ok());

    // Room for eight bytes does not suffice for nine.
    for _ in 1..fit {
        deliver(&mut link, &message);
    }
    let longer = self::message(1);
    assert_eq!(256 - (fit - 1) * message.len() + 1, longer.len());
    deliver(&mut link, &longer);
    assert_eq!(link.counters().overflows, 2);
    assert_eq!(read_all(&mut link), message.repeat(fit - 1));
}

#[test]
fn error_has_a_message() {
    let error = link().read(&mut [0]).unwrap_err();
    assert_eq!(error.to_string(), "the line would have to wait");
}

#[test]
fn own_frames_are_the_frames_to_the_gripper() {
    let link = link();
    let own = IDENTIFIERS.controller().transmit;
    let sends = |id: StandardId| CanNode::<ClassicFrame>::sends(&link, Id::Standard(id));
    assert!(sends(own));
    assert!(!sends(IDENTIFIERS.controller().receive));
}

#[test]
fn messages_are_sent_in_order_and_one_at_a_time() {
    let mut link = link();
    let message = message(10);
    assert!(link.write_ready().unwrap() && link.flush().is_ok());
    write_all(&mut link, &message);
    assert!(!link.write_ready().unwrap(), "the next message waits until the controller has all frames");
    assert!(link.write(&[0]).is_err() && link.write(&[]).is_ok());
    assert!(link.flush().is_err());
    let frames: Vec<ClassicFrame> = core::iter::from_fn(|| transmit(&mut link)).collect();
    let sent: Vec<u8> = frames.iter().flat_map(|frame| frame.data().to_vec()).collect();
    let expected: Vec<u8> = Segments::new(message.iter().copied())
        .filter_map(|segment| segment.frame::<ClassicFrame>(IDENTIFIERS.controller().transmit))
        .flat_map(|frame| frame.data().to_vec())
        .collect();
    assert_eq!(sent, expected);
    assert!(frames.iter().all(|frame| frame.id() == Id::Standard(IDENTIFIERS.controller().transmit)));
    assert!(link.write_ready().unwrap() && link.flush().is_ok());
    assert_eq!(link.counters().broken, 0);
}

#[test]
fn lost_frame_discards_its_message_and_the_writer_is_notified() {
    // Completely written; partly written; not started.
    for (written, is_broken, is_told) in [(18, true, false), (5, true, true), (0, false, false)] {
        let mut link = link();
        write_all(&mut link, &message(10)[..written]);
        CanNode::<ClassicFrame>::lost(&mut link);
        assert!(transmit(&mut link).is_none(), "{written}");
        assert_eq!(link.counters().broken, u16::from(is_broken), "{written}");
        assert!(link.write_ready().unwrap(), "{written}");
        assert_eq!(link.write(&[0xAA]).is_err(), is_told, "{written}");
        if is_told {
            // Reported once. The next bytes are a new message.
            write_all(&mut link, &message(0));
            assert!(transmit(&mut link).is_some());
        }
    }
}

#[test]
fn lost_bus_accepts_nothing_and_earlier_frames_are_never_sent() {
    let mut link = link();
    write_all(&mut link, &message(10));
    CanNode::<ClassicFrame>::bus_changed(&mut link, false);
    assert!(!link.write_ready().unwrap() && link.write(&[0xAA]).is_err());
    assert!(transmit(&mut link).is_none());
    CanNode::<ClassicFrame>::bus_changed(&mut link, true);
    assert!(transmit(&mut link).is_none());
    assert!(link.write_ready().unwrap());
    assert_eq!(link.counters().broken, 1);
}

#[test]
fn lost_bus_discards_incomplete_and_keeps_complete_messages() {
    let whole = message(0);
    let longer = message(10);
    let mut link = link();
    deliver(&mut link, &whole);
    let first = Segments::new(longer.iter().copied()).next().unwrap();
    link.on_frame(LATER, &first.frame::<ClassicFrame>(IDENTIFIERS.gripper().transmit).unwrap());
    CanNode::<ClassicFrame>::bus_changed(&mut link, false);
    CanNode::<ClassicFrame>::bus_changed(&mut link, true);
    deliver(&mut link, &longer);
    assert_eq!(read_all(&mut link), [whole, longer].concat());
    assert_eq!(link.counters().frames.dropped, 1, "the frame of the incomplete message");
}

#[test]
fn frames_waiting_100_ms_are_withdrawn_also_from_the_controller() {
    let at = Instant::from_millis;
    let mut link = link();
    write_all(&mut link, &message(10));
    link.expire(at(1));
    link.expire(at(100));
    assert!(!takes_back(&link));
    // An accepted frame restarts the time.
    assert!(transmit(&mut link).is_some());
    link.expire(at(101));
    link.expire(at(200));
    assert!(!takes_back(&link));
    link.expire(at(201));
    assert!(takes_back(&link));
    assert!(!link.write_ready().unwrap() && transmit(&mut link).is_none());
    CanNode::<ClassicFrame>::taken_back(&mut link, 1);
    assert!(!takes_back(&link) && link.write_ready().unwrap());
    assert!(transmit(&mut link).is_none());
    assert_eq!(link.counters().broken, 1);
}

#[test]
fn frames_to_a_lost_gripper_are_withdrawn() {
    let mut link = link();
    link.set_connected(false);
    assert!(!takes_back(&link), "no connection was lost");
    // Number of frames that the bus has taken of a message of three, and of its unsent ones among them.
    for (taken, unsent) in [(0, 0), (1, 1), (2, 1), (2, 2), (3, 3)] {
        let mut link = self::link();
        link.set_connected(true);
        write_all(&mut link, &message(10));
        for _ in 0..taken {
            assert!(transmit(&mut link).is_some());
        }
        link.set_connected(true);
        assert!(!takes_back(&link));
        link.set_connected(false);
        assert!(takes_back(&link));
        assert!(transmit(&mut link).is_none());
        CanNode::<ClassicFrame>::taken_back(&mut link, unsent);
        assert!(!takes_back(&link));
        assert!(transmit(&mut link).is_none(), "nothing is sent to a gripper that returns: {taken} {unsent}");
        write_all(&mut link, &message(0));
        let sent = transmit(&mut link).expect("the first message of the next connection");
        assert_eq!(sent.data(), message(0));
    }
}

#[test]
fn withdrawn_message_is_removed_or_spoilt_and_the_next_is_kept() {
    let grip = Command::GripPart { width: 20.0, speed: 50.0 };
    let grip: Vec<u8> = FrameEncoder::new(grip.id().code(), grip).collect();
    // Number of unsent frames among the last frames passed to the bus.
    for unsent in 0..=2 {
        let mut link = link();
        // The bus has sent all frames of four earlier messages.
        for _ in 0..4 {
            write_all(&mut link, &message(0));
            assert!(transmit(&mut link).is_some());
        }
        link.withdraw();
        assert!(!takes_back(&link), "a query is not withdrawn");
        write_all(&mut link, &grip);
        assert!(transmit(&mut link).is_some() && transmit(&mut link).is_some());
        write_all(&mut link, &message(0));

        link.withdraw();
        assert!(takes_back(&link) && !link.write_ready().unwrap());
        assert!(transmit(&mut link).is_none(), "no frame overtakes the withdrawal");
        CanNode::<ClassicFrame>::taken_back(&mut link, unsent);

        let rest: Vec<Vec<u8>> =
            core::iter::from_fn(|| transmit(&mut link)).map(|frame| frame.data().to_vec()).collect();
        let spoilt = if unsent == 1 { vec![vec![0x7F; 8]] } else { vec![] };
        assert_eq!(rest, [spoilt, vec![message(0)]].concat(), "{unsent} unsent");
        let withdrawn = (unsent > 0).then_some(CommandId::GripPart);
        assert_eq!(link.take_withdrawn(), withdrawn, "{unsent} unsent");
        assert_eq!(link.take_withdrawn(), None);
        link.withdraw();
        assert!(!takes_back(&link), "{unsent} unsent: decided");
    }
}
