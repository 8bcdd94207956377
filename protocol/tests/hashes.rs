//! Equal hashes imply equal future behaviour. Pending input and commands therefore count; counters and past answers do not.
//! The exhaustive exploration relies on it.

use std::hash::{DefaultHasher, Hash, Hasher};

use wsg_protocol::session::{self, Event, Known, Session};
use wsg_protocol::{
    Command, CommandId, Event as FrameEvent, Frame, FrameEncoder, FrameParser, Instant, Kind, Reply, Status,
    SystemFlags, SystemLimits,
};

fn hash(state: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    state.hash(&mut hasher);
    hasher.finish()
}

/// Returns whether all hashes differ.
fn differ<T: Hash>(states: &[T]) -> bool {
    let mut hashes: Vec<_> = states.iter().map(hash).collect();
    hashes.sort_unstable();
    hashes.dedup();
    hashes.len() == states.len()
}

#[test]
fn events_differ_by_kind_and_command_and_not_by_the_answer() {
    let answered = |id, status| Event::Answered(Reply::status_only(id, status));
    assert!(differ(&[
        Event::Connected,
        Event::Disconnected,
        Event::Pending(CommandId::Homing),
        Event::Pending(CommandId::GripPart),
        Event::Unanswered(CommandId::Homing),
        Event::Late(CommandId::Homing),
        Event::Withdrawn(CommandId::Homing),
        answered(CommandId::Homing, Status::Success),
        answered(CommandId::Stop, Status::Success),
    ]));
    let [done, failed] =
        [Status::Success, Status::CmdFailed].map(|status| answered(CommandId::Homing, status));
    assert_eq!(hash(&done), hash(&failed));
}

#[test]
fn commands_differ_by_id_and_by_each_parameter() {
    assert!(differ(&[
        Command::Stop,
        Command::FastStop,
        Command::GripPart { width: 20.0, speed: 50.0 },
        Command::GripPart { width: 20.0, speed: 51.0 },
        Command::GripPart { width: 21.0, speed: 50.0 },
        Command::ReleasePart { width: 20.0, speed: 50.0 },
    ]));
}

#[test]
fn moments_differ() {
    assert!(differ(&[0, 1, 1 << 31, u32::MAX].map(Instant::from_millis)));
}

#[test]
fn known_values_differ_by_each() {
    let nothing = Known::NOTHING;
    let limits = SystemLimits {
        stroke: 110.0,
        min_speed: 5.0,
        max_speed: 420.0,
        min_acceleration: 100.0,
        max_acceleration: 5_000.0,
        min_force: 5.0,
        nominal_force: 80.0,
        overdrive_force: 120.0,
    };
    assert!(differ(&[
        nothing,
        Known { limits: Some(limits), ..nothing },
        Known { limits: Some(SystemLimits { overdrive_force: 121.0, ..limits }), ..nothing },
        Known { limits: Some(SystemLimits { stroke: 210.0, ..limits }), ..nothing },
        Known { flags: Some(SystemFlags::empty()), ..nothing },
        Known { flags: Some(SystemFlags::MOVING), ..nothing },
        Known { width: Some(1.0), ..nothing },
        Known { speed: Some(1.0), ..nothing },
        Known { force: Some(1.0), ..nothing },
        Known { force_limit: Some(1.0), ..nothing },
    ]));
}

#[test]
fn parsers_differ_by_buffered_and_not_by_past_bytes() {
    let frame: Vec<u8> = FrameEncoder::new(CommandId::GetForce.code(), &[1, 2, 3][..]).collect();
    let after = |bytes: &[u8]| {
        let mut parser = FrameParser::<64>::new();
        for byte in bytes {
            let _ = parser.push(*byte);
        }
        parser
    };
    let mut other = frame.clone();
    other[7] ^= 1;
    assert!(differ(&[
        after(&[]),
        after(&frame[..2]),
        after(&frame[..7]),
        after(&frame[..8]),
        after(&other[..8])
    ]));
    assert!(differ(&[after(&[]), FrameParser::ignoring_checksums()]));
    assert_eq!(hash(&after(&frame)), hash(&after(&[])));
    assert_eq!(hash(&after(b"noise")), hash(&after(&[])), "only counted");
}

#[test]
fn session_hash_covers_pending_requests_but_no_counters() {
    let now = Instant::from_millis(0);
    let fresh = Session::new(session::Config::DEFAULT);
    let mut unsolicited = fresh.clone();
    let event = FrameEvent::Frame(Frame { id: CommandId::GetForce.code(), payload: &[0, 0, 0, 0, 0, 0] });
    assert_eq!(unsolicited.handle(now, &event), None);
    assert_ne!(unsolicited.counters(), fresh.counters());
    assert!(unsolicited.known().force.is_some(), "its value is still stored");
    let mut refused = fresh.clone();
    assert_eq!(refused.handle(now, &FrameEvent::Frame(Frame { id: 1, payload: &[] })), None);
    assert_ne!(refused.counters(), fresh.counters());
    assert_eq!(hash(&refused), hash(&fresh));

    let mut stopped = fresh.clone();
    assert_eq!(stopped.request(Command::FastStop), Ok(()));
    let mut sent = stopped.clone();
    assert_eq!(sent.tick(now), None);
    assert_eq!(sent.poll_transmit(now).map(|command| command.id().kind()), Some(Kind::Stop));
    assert!(differ(&[fresh, unsolicited, stopped, sent]));
}
