//! Every combination of losses and duplicates for the CAN frames of three messages.

use super::*;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Kept,
    Lost,
    Doubled,
}

const FATES: [Fate; 3] = [Fate::Kept, Fate::Lost, Fate::Doubled];

/// Messages of every layout: one frame, a short last frame, a full last frame, and payloads whose frames look like the
/// start of a short or an oversize message. They differ at each place of the script.
fn kinds(place: usize) -> [Message; 5] {
    // Different parameters, so no two messages share a frame.
    let n = place as f32 * 1.37;
    let payload = |len: usize| (1..=len as u8).map(|byte| byte ^ (0x10 << place)).collect::<Vec<u8>>();
    let looking_like_a_beginning = |size: u8| {
        let mut payload = payload(15);
        payload[2..8].copy_from_slice(&[0xAA, 0xAA, 0xAA, 6, size, 0]);
        Message::new(6, &payload)
    };
    let query = [Command::Stop, Command::FastStop, Command::GetTemperature][place];
    [
        Message::command(query),
        Message::command(Command::SetForceLimit { force: 40.1 + n }),
        Message::command(Command::GripPart { width: 20.3 + n, speed: 50.7 + n }),
        looking_like_a_beginning(8),
        looking_like_a_beginning(200),
    ]
}

/// Foreign frames that resemble this frame or could be inserted between the frames of a message.
fn foreign(ours: &CanFrame) -> [CanFrame; 5] {
    let number = RECEIVED.as_raw();
    [
        CanFrame { id: StandardId::new(number - 1).unwrap().into(), ..ours.clone() },
        CanFrame { id: ExtendedId::new(number.into()).unwrap().into(), ..ours.clone() },
        CanFrame { id: ExtendedId::new(u32::from(number) << 18).unwrap().into(), ..ours.clone() },
        CanFrame { remote: true, data: Vec::new(), ..ours.clone() },
        CanFrame { data: Vec::new(), ..ours.clone() },
    ]
}

/// Calls `check` with every assignment of losses to `count` frames.
fn each_pattern(count: usize, mut check: impl FnMut(&[Fate])) {
    for number in 0..3usize.pow(count as u32) {
        let losses: Vec<Fate> =
            (0..count).map(|frame| FATES[number / 3usize.pow(frame as u32) % 3]).collect();
        check(&losses);
    }
}

/// Returns the frames received after these losses.
fn on_the_bus<'a>(frames: &'a [CanFrame], losses: &[Fate]) -> impl Iterator<Item = &'a CanFrame> {
    let times = |fate: &Fate| match fate {
        Fate::Kept => 1,
        Fate::Lost => 0,
        Fate::Doubled => 2,
    };
    frames.iter().zip(losses).flat_map(move |(frame, fate)| iter::repeat_n(frame, times(fate)))
}

fn frames_of(script: &[Message]) -> Vec<CanFrame> {
    script.iter().flat_map(Message::frames).collect()
}

/// Asserts that each intact message is delivered in order, and no other.
fn check_delivery(script: &[Message], losses: &[Fate], delivered: &[Message]) {
    let context = || std::format!("{script:02X?}\n{losses:?}\ndelivered {delivered:02X?}");
    let mut rest = delivered;
    let mut losses = losses;
    for message in script {
        let (own, behind) = losses.split_at(message.frames().len());
        losses = behind;
        let times = rest.iter().take_while(|delivered| *delivered == message).count();
        rest = &rest[times..];
        let may_be = if own.contains(&Fate::Lost) {
            0..=0
        } else if !own.contains(&Fate::Doubled) {
            1..=1
        } else if own.len() == 1 {
            // A duplicated single-frame message cannot be distinguished from two messages.
            2..=2
        } else {
            0..=1
        };
        assert!(may_be.contains(&times), "{message:02X?} came {times} times\n{}", context());
    }
    assert!(rest.is_empty(), "unexpected or out of order: {rest:02X?}\n{}", context());
}

#[test]
fn lost_or_doubled_can_frames_cost_at_most_their_own_messages() {
    let mut runs = 0;
    for first in kinds(0) {
        for second in kinds(1) {
            for third in kinds(2) {
                let script = [first.clone(), second.clone(), third];
                let frames = frames_of(&script);
                let foreign: Vec<CanFrame> = frames.iter().flat_map(foreign).collect();
                each_pattern(frames.len(), |losses| {
                    let mut wire = Wire::<4>::new();
                    for (n, frame) in on_the_bus(&frames, losses).enumerate() {
                        wire.receive([&foreign[(runs + n) % foreign.len()], frame]);
                    }
                    wire.pass(HALF_MS);
                    check_delivery(&script, losses, &wire.messages());
                    runs += 1;
                });
            }
        }
    }
    // Messages of 1, 2, 2, 3 and 3 frames at each of three places.
    assert_eq!(runs, (3 + 9 + 9 + 27 + 27usize).pow(3));
}

#[test]
fn damage_delays_the_next_message_only_through_a_false_start() {
    let next = Message::command(Command::GripPart { width: 77.7, speed: 11.1 });
    for first in &kinds(0)[..3] {
        for second in &kinds(1)[..3] {
            let script = [first.clone(), second.clone()];
            let frames = frames_of(&script);
            each_pattern(frames.len(), |losses| {
                let mut wire = Wire::<4>::new();
                wire.receive(on_the_bus(&frames, losses));
                wire.receive(&next.frames());
                assert_eq!(wire.messages().last(), Some(&next), "{script:02X?} {losses:?}");
            });
        }
    }
}

/// Calls `check` with every interleaving of `ours` and `others` that keeps the order within each.
fn each_interleaving(ours: &[CanFrame], others: &[CanFrame], check: &mut impl FnMut(&[CanFrame])) {
    fn merge(
        merged: &mut Vec<CanFrame>,
        a: &[CanFrame],
        b: &[CanFrame],
        check: &mut impl FnMut(&[CanFrame]),
    ) {
        if a.is_empty() && b.is_empty() {
            check(merged);
        }
        for (taken, left) in [(a, b), (b, a)] {
            if let Some((frame, rest)) = taken.split_first() {
                merged.push(frame.clone());
                merge(merged, rest, left, check);
                merged.pop();
            }
        }
    }
    merge(&mut Vec::new(), ours, others, check);
}

#[test]
fn traffic_of_the_other_direction_changes_nothing_in_any_order() {
    let grip = Command::GripPart { width: 20.3, speed: 50.7 };
    let script = [Message::command(grip), Message::command(Command::Stop), Message::new(6, &[7; 9])];
    let ours = frames_of(&script);
    let other = Id::Standard(StandardId::new(RECEIVED.as_raw() - 1).unwrap());
    let others: Vec<CanFrame> =
        ours.iter().take(4).map(|frame| CanFrame { id: other, ..frame.clone() }).collect();
    let mut orders = 0;
    each_interleaving(&ours, &others, &mut |merged| {
        let mut wire = Wire::<4>::new();
        wire.receive(merged);
        assert_eq!(wire.messages(), script);
        assert_eq!(
            wire.reassembler.counters(),
            ReassemblerCounters { foreign: 4, ..ReassemblerCounters::default() }
        );
        orders += 1;
    });
    assert_eq!(orders, 210, "ten frames, four of them in the other direction");
}
