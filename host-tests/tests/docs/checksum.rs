//! Measures the strength of the checksum, on which the parser, the decoder and docs/figures.md rely.
//!
//! An error is the exclusive or of the sent and the received frame. The checksum is linear, so its detection depends
//! only on the error and the frame's length.

use document::{hold, table};
use wsg_protocol::checksum::push;
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, Event, Frame, FrameEncoder, FrameParser, GripperState, HomingDirection,
    PrePositionFlags, Reply, SoftLimits, Status, SystemFlags, Value,
};

const DOCUMENT: &str = "docs/figures.md";

/// Length of the checksum in bytes.
const CHECKSUM_LEN: usize = 2;

const PRE_POSITION: Command<'static> =
    Command::PrePosition { flags: PrePositionFlags::empty(), width: 80.0, speed: 200.0 };

/// Returns the contribution of an error to the running value, from the first byte after the preamble.
fn value_of(error: &[u8]) -> u16 {
    error.iter().fold(0, |value, &byte| push(value, byte))
}

/// Returns whether an error passes a receiver that requires a running value of 0 over the whole frame.
fn passes_zero(error: &[u8]) -> bool {
    value_of(error) == 0
}

/// Returns whether an error passes a receiver that compares the two received checksum bytes with the calculated ones.
fn passes_comparison(error: &[u8]) -> bool {
    let (covered, checksum) = error.split_at(error.len() - CHECKSUM_LEN);
    value_of(covered).to_le_bytes() == checksum
}

/// Returns the rank of the map from the running value to the running value `bytes` bytes later.
fn rank_after(bytes: usize) -> usize {
    let mut basis: Vec<u16> = Vec::new();
    for bit in 0..u16::BITS {
        let value = (0..bytes).fold(1 << bit, |value, _| push(value, 0));
        let rest = basis.iter().fold(value, |value, &row| value.min(value ^ row));
        if rest != 0 {
            basis.push(rest);
        }
    }
    basis.len()
}

/// Returns all two-bit errors in a frame of `len` bytes, preamble excepted.
fn two_bit_errors(len: usize) -> impl Iterator<Item = Vec<u8>> {
    let bytes = len - PREAMBLE_LEN;
    let pairs =
        (0..8 * bytes).flat_map(move |first| (first + 1..8 * bytes).map(move |second| (first, second)));
    pairs.map(move |(first, second)| {
        let mut error = vec![0; bytes];
        for bit in [first, second] {
            error[bit / 8] ^= 1 << (bit % 8);
        }
        error
    })
}

/// Sends a frame with each two-bit error through parser and decoder. Returns a row: the number of errors, the number that
/// the parser accepts, and of these, the number that decoding refuses or maps to an id outside the manual.
fn outcomes(what: String, line: &[u8], id: impl Fn(&Frame<'_>) -> Option<CommandId>) -> [String; 5] {
    let (mut errors, mut passed, mut refused) = (0, 0, 0);
    for error in two_bit_errors(line.len()) {
        let mut damaged = line.to_vec();
        for (byte, error) in damaged[PREAMBLE_LEN..].iter_mut().zip(&error) {
            *byte ^= error;
        }
        errors += 1;
        let mut parser = FrameParser::<1016>::new();
        let mut take = |event: Event<'_>| {
            if let Event::Frame(frame) = event {
                passed += 1;
                refused += u32::from(id(&frame).is_none_or(|id| matches!(id, CommandId::Unknown(_))));
            }
        };
        let mut rest = &damaged[..];
        while !rest.is_empty() {
            let (taken, event) = parser.push_slice(rest);
            rest = &rest[taken..];
            event.into_iter().for_each(&mut take);
        }
        while let Some(event) = parser.expire() {
            take(event);
        }
    }
    [what, errors.to_string(), passed.to_string(), refused.to_string(), (passed - refused).to_string()]
}

/// A CRC has rank 16 after any number of bytes, so the checksum is no CRC.
#[test]
fn checksum_map_has_rank_13_from_the_third_byte_on() {
    assert_eq!([1, 2, 3, 4, 100].map(rank_after), [15, 14, 13, 13, 13]);
}

#[test]
fn checksum_finds_any_error_in_one_byte_or_odd_number_of_bits() {
    for len in OVERHEAD..=64 {
        for at in 0..len - PREAMBLE_LEN {
            for flip in 1..=255 {
                let mut error = vec![0; len - PREAMBLE_LEN];
                error[at] = flip;
                assert!(
                    !passes_zero(&error) && !passes_comparison(&error),
                    "{flip:02X}h in byte {at} of {len}"
                );
            }
        }
    }
    // Each byte value changes the parity of the running value by its own parity, so an odd number of bits never yields 0.
    for value in 0..=u16::MAX {
        assert_eq!(push(value, 0).count_ones() % 2, value.count_ones() % 2, "{value:04X}h");
    }
}

#[test]
fn documented_two_bit_errors_by_length_are_measured() {
    let rows = [8, 10, 11, 12, 14, 16, 17, 18, 24, 32, 42, 64].map(|len| {
        let count = |passes: fn(&[u8]) -> bool| two_bit_errors(len).filter(|error| passes(error)).count();
        [
            len.to_string(),
            two_bit_errors(len).count().to_string(),
            count(passes_zero).to_string(),
            count(passes_comparison).to_string(),
        ]
    });
    hold(
        DOCUMENT,
        "two-bit errors by length",
        &table(["bytes of the frame", "two-bit errors", "pass a test for 0", "pass a comparison"], rows),
    );
}

#[test]
fn documented_two_bit_errors_refused_by_decoding_are_measured() {
    let requests = [
        Command::Stop,
        Command::Homing { direction: HomingDirection::Default },
        Command::GetSystemState { update: AutoUpdate::on_change(10) },
        Command::ACKNOWLEDGE,
        Command::SetForceLimit { force: 40.0 },
        Command::GripPart { width: 20.0, speed: 50.0 },
        Command::SetSoftLimits { limits: SoftLimits { minus: 5.0, plus: 100.0 } },
        PRE_POSITION,
    ];
    let replies = [
        Reply::status_only(CommandId::GripPart, Status::CmdPending),
        Reply::status_only(CommandId::GripPart, Status::Success),
        Reply::success(Value::GetGripperState(GripperState::Holding)),
        Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)),
        Reply::success(Value::GetOpeningWidth(20.0)),
    ];
    let requests = requests.iter().map(|command| {
        let line: Vec<u8> = FrameEncoder::new(command.id().code(), *command).collect();
        let id = |frame: &Frame<'_>| Command::decode(frame).ok().map(|command| command.id());
        outcomes(format!("-> {command}"), &line, id)
    });
    let replies = replies.iter().map(|reply| {
        let line: Vec<u8> = FrameEncoder::new(reply.id().code(), *reply).collect();
        let id = |frame: &Frame<'_>| Reply::decode(frame).ok().map(|reply| reply.id());
        outcomes(format!("<- {reply}"), &line, id)
    });
    hold(
        DOCUMENT,
        "two-bit errors by frame",
        &table(
            ["frame", "two-bit errors", "accepted by the parser", "refused by decoding", "accepted by both"],
            requests.chain(replies),
        ),
    );
}
