//! How much the checksum is worth, measured; the numbers in docs/protocol.md are these.
//!
//! An error is what a disturbance adds to a frame (exclusive or). The checksum is linear, so whether an error passes
//! depends on the error and the frame's length alone. `cargo test -p host-tests --test docs checksum -- --nocapture`
//! prints the tables.

use crc::{Algorithm, Crc};
use host_tests::document::{hold, table};
use wsg_protocol::checksum::push;
use wsg_protocol::frame::{OVERHEAD, PREAMBLE_LEN};
use wsg_protocol::{
    AutoUpdate, Command, CommandId, Event, FirmwareVersion, Frame, FrameEncoder, FrameParser, GripperState,
    HomingDirection, PrePositionFlags, Reply, SoftLimits, Status, SystemFlags, SystemInfo, SystemLimits,
    Value,
};

const DOCUMENT: &str = "docs/protocol.md";

/// Bytes of the checksum.
const CHECKSUM_LEN: usize = 2;

const PRE_POSITION: Command<'static> =
    Command::PrePosition { flags: PrePositionFlags::empty(), width: 80.0, speed: 200.0 };

/// What an error leaves of the running value, from the first byte behind the preamble on.
fn value_of(error: &[u8]) -> u16 {
    error.iter().fold(0, |value, &byte| push(value, byte))
}

/// Whether a receiver overlooks the error that takes the running value over the whole frame and wants 0.
fn passes_zero(error: &[u8]) -> bool {
    value_of(error) == 0
}

/// Whether a receiver overlooks the error that compares the two received bytes with those it calculates.
fn passes_comparison(error: &[u8]) -> bool {
    let (covered, checksum) = error.split_at(error.len() - CHECKSUM_LEN);
    value_of(covered).to_le_bytes() == checksum
}

/// The rank of the map from the running value to the running value `bytes` bytes later.
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

/// All errors of two bits in a frame of `len` bytes, preamble excepted.
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

/// Of all errors that hit exactly `n` bytes behind the preamble, the shares that pass: wanting 0, comparing. Exact:
/// how errors spread over the running values is carried on byte by byte.
fn shares_by_wrong_bytes(len: usize) -> Vec<(f64, f64)> {
    let bytes = len - PREAMBLE_LEN;
    // spread[wrong][value]: the errors so far, each pattern of places weighted 1.
    let mut spread = vec![vec![0.0; 1 << 16]; bytes + 1];
    spread[0][0] = 1.0;
    let mut passed_comparison = vec![0.0; bytes + 1];
    for at in 0..bytes {
        if at == bytes - CHECKSUM_LEN {
            for (wrong, values) in spread.iter().enumerate().take(at + 1) {
                for (value, weight) in values.iter().enumerate() {
                    // The checksum's own error must be exactly this value: one of 255 for each byte that it hits.
                    let hit = [value & 0xFF, value >> 8].iter().filter(|&&byte| byte != 0).count();
                    passed_comparison[wrong + hit] += weight * 255f64.powi(-(hit as i32));
                }
            }
        }
        let mut next = vec![vec![0.0; 1 << 16]; bytes + 1];
        for (wrong, values) in spread.iter().enumerate().take(at + 1) {
            for (block, high) in values.chunks_exact(256).zip(0u16..) {
                let sum: f64 = block.iter().sum();
                for (weight, low) in block.iter().zip(0u16..) {
                    let after = usize::from(push(high << 8 | low, 0));
                    next[wrong][after] += weight;
                    next[wrong + 1][after] += (sum - weight) / 255.0;
                }
            }
        }
        spread = next;
    }
    let places = |wrong: usize| (0..wrong).fold(1.0, |ways, n| ways * (bytes - n) as f64 / (n + 1) as f64);
    (0..=bytes).map(|n| (spread[n][0] / places(n), passed_comparison[n] / places(n))).collect()
}

/// A share as one in so many.
fn one_in(share: f64) -> String {
    // The sums of weights carry rounding errors; no share of an error that can pass is near this.
    if share < 1e-12 { "none".to_owned() } else { format!("1 in {:.0}", 1.0 / share) }
}

/// What becomes of a frame with a wrong bit or two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Outcomes {
    errors: u32,
    /// The parser took it for an intact frame.
    passed: u32,
    /// Strict decoding refused what the parser took, or its id is none of the manual's.
    refused: u32,
}

impl Outcomes {
    fn accepted(self) -> u32 {
        self.passed - self.refused
    }
}

/// Sends the frame with each error of two bits through parser and decoder.
fn outcomes(line: &[u8], is_refused: impl Fn(&Frame<'_>) -> bool) -> Outcomes {
    let mut outcomes = Outcomes::default();
    for error in two_bit_errors(line.len()) {
        let mut damaged = line.to_vec();
        for (byte, error) in damaged[PREAMBLE_LEN..].iter_mut().zip(&error) {
            *byte ^= error;
        }
        outcomes.errors += 1;
        let mut parser = FrameParser::<1016>::new();
        let mut take = |event: Event<'_>| {
            if let Event::Frame(frame) = event {
                outcomes.passed += 1;
                outcomes.refused += u32::from(is_refused(&frame));
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
    outcomes
}

fn request_outcomes(command: &Command<'_>) -> Outcomes {
    let line: Vec<u8> = FrameEncoder::new(command.id().code(), *command).collect();
    outcomes(&line, |frame| Command::decode(frame).is_ok_and(|it| is_listed(it.id())).eq(&false))
}

fn reply_outcomes(reply: &Reply<'_>) -> Outcomes {
    let line: Vec<u8> = FrameEncoder::new(reply.id().code(), *reply).collect();
    outcomes(&line, |frame| Reply::decode(frame).is_ok_and(|it| is_listed(it.id())).eq(&false))
}

fn is_listed(id: CommandId) -> bool {
    !matches!(id, CommandId::Unknown(_))
}

/// Requests that a bridge sends, and the replies to them.
fn typical() -> (Vec<Command<'static>>, Vec<Reply<'static>>) {
    let update = AutoUpdate::on_change(10);
    let requests = vec![
        Command::Stop,
        Command::Homing { direction: HomingDirection::Default },
        Command::GetSystemState { update },
        Command::ACKNOWLEDGE,
        Command::SetForceLimit { force: 40.0 },
        Command::GripPart { width: 20.0, speed: 50.0 },
        Command::SetSoftLimits { limits: SoftLimits { minus: 5.0, plus: 100.0 } },
        PRE_POSITION,
    ];
    let info = SystemInfo {
        device: wsg_protocol::DeviceType::Wsg50,
        hardware_revision: 1,
        firmware: FirmwareVersion::new(4, 0, 0, 0),
        serial_number: 1,
    };
    let limits = SystemLimits {
        stroke: 110.0,
        min_speed: 5.0,
        max_speed: 420.0,
        min_acceleration: 100.0,
        max_acceleration: 5000.0,
        min_force: 5.0,
        nominal_force: 80.0,
        overdrive_force: 120.0,
    };
    let replies = vec![
        Reply::status_only(CommandId::GripPart, Status::CmdPending),
        Reply::status_only(CommandId::GripPart, Status::Success),
        Reply::success(Value::GetGripperState(GripperState::Holding)),
        Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)),
        Reply::success(Value::GetOpeningWidth(20.0)),
        Reply::success(Value::GetSystemInfo(info)),
        Reply::success(Value::GetSystemLimits(limits)),
    ];
    (requests, replies)
}

#[test]
fn checksum_map_has_rank_13_from_the_third_byte_on() {
    assert_eq!([1, 2, 3, 4, 100].map(rank_after), [15, 14, 13, 13, 13]);
    let rows = (1..=4).map(|bytes| [bytes.to_string(), rank_after(bytes).to_string()]);
    hold(DOCUMENT, "rank", &table(["after so many more bytes", "rank, of 16"], rows));
}

#[test]
fn checksum_of_every_frame_has_three_others_that_also_end_in_zero() {
    let ends_in_zero = (0..=u16::MAX).filter(|error| passes_zero(&error.to_le_bytes()));
    assert_eq!(ends_in_zero.count(), 4);
}

#[test]
fn checksum_finds_every_error_in_one_byte_and_every_odd_number_of_bits() {
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
    // A byte changes the parity of the running value by its own: an odd number of bits never comes to 0.
    for value in 0..=u16::MAX {
        assert_eq!(push(value, 0).count_ones() % 2, value.count_ones() % 2, "{value:04X}h");
    }
}

#[test]
fn checksum_lets_50_of_6216_two_bit_errors_of_pre_position_pass() {
    let line: Vec<u8> = FrameEncoder::new(0x21, PRE_POSITION).collect();
    assert_eq!(line.len(), 17);
    let errors: Vec<Vec<u8>> = two_bit_errors(line.len()).collect();
    assert_eq!(errors.len(), 6216);
    assert_eq!(errors.iter().filter(|error| passes_zero(error)).count(), 50);
}

#[test]
fn checksum_shares_in_the_document_are_measured() {
    let len = PRE_POSITION_LEN;
    let shares = shares_by_wrong_bytes(len);
    let rows = [1, 2, 3, 4, 6, 8, 10, 12, 14].map(|wrong| {
        let (zero, comparison) = shares[wrong];
        [wrong.to_string(), one_in(zero), one_in(comparison)]
    });
    hold(DOCUMENT, "shares", &table(["wrong bytes of 14", "pass a test for 0", "pass a comparison"], rows));
}

/// Bytes of a Pre-position frame.
const PRE_POSITION_LEN: usize = OVERHEAD + Command::MAX_FIXED_LEN;

#[test]
fn checksum_two_bit_errors_by_length_in_the_document_are_measured() {
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
fn checksum_two_bit_errors_that_decoding_refuses_in_the_document_are_measured() {
    let row = |what: String, outcomes: Outcomes| {
        [
            what,
            outcomes.errors.to_string(),
            outcomes.passed.to_string(),
            outcomes.refused.to_string(),
            outcomes.accepted().to_string(),
        ]
    };
    let (requests, replies) = typical();
    let requests = requests.iter().map(|command| row(format!("-> {command}"), request_outcomes(command)));
    let replies = replies.iter().map(|reply| {
        let words = reply.to_string();
        // The limits are many words.
        let words = words.split(" stroke").next().unwrap_or(&words);
        row(format!("<- {words}"), reply_outcomes(reply))
    });
    let rows: Vec<[String; 5]> = requests.chain(replies).collect();
    hold(
        DOCUMENT,
        "two-bit errors by frame",
        &table(["frame", "two-bit errors", "taken by the parser", "refused by decoding", "accepted"], rows),
    );
}

/// All CRCs of 16 bits that the catalogue lists.
static CATALOGUE: [Algorithm<u16>; 31] = [
    crc::CRC_16_ARC,
    crc::CRC_16_CDMA2000,
    crc::CRC_16_CMS,
    crc::CRC_16_DDS_110,
    crc::CRC_16_DECT_R,
    crc::CRC_16_DECT_X,
    crc::CRC_16_DNP,
    crc::CRC_16_EN_13757,
    crc::CRC_16_GENIBUS,
    crc::CRC_16_GSM,
    crc::CRC_16_IBM_3740,
    crc::CRC_16_IBM_SDLC,
    crc::CRC_16_ISO_IEC_14443_3_A,
    crc::CRC_16_KERMIT,
    crc::CRC_16_LJ1200,
    crc::CRC_16_M17,
    crc::CRC_16_MAXIM_DOW,
    crc::CRC_16_MCRF4XX,
    crc::CRC_16_MODBUS,
    crc::CRC_16_NRSC_5,
    crc::CRC_16_OPENSAFETY_A,
    crc::CRC_16_OPENSAFETY_B,
    crc::CRC_16_PROFIBUS,
    crc::CRC_16_RIELLO,
    crc::CRC_16_SPI_FUJITSU,
    crc::CRC_16_T10_DIF,
    crc::CRC_16_TELEDISK,
    crc::CRC_16_TMS37157,
    crc::CRC_16_UMTS,
    crc::CRC_16_USB,
    crc::CRC_16_XMODEM,
];

/// Frames of one length, without their checksums, and these as numbers.
const FRAMES: [(&[u8], u16); 5] = [
    (&[0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x1A, 0x00], 0xCB67),
    (&[0xAA, 0xAA, 0xAA, 0x21, 0x02, 0x00, 0x00, 0x00], 0x0428),
    (&[0xAA, 0xAA, 0xAA, 0x20, 0x02, 0x00, 0x00, 0x00], 0xFDB3),
    (&[0xAA, 0xAA, 0xAA, 0x90, 0x02, 0x00, 0x0E, 0x00], 0x02FD),
    (&[0xAA, 0xAA, 0xAA, 0x01, 0x02, 0x00, 0x12, 0x34], 0x666D),
];

#[test]
fn checksum_is_no_crc_of_the_catalogue() {
    for algorithm in &CATALOGUE {
        let crc = Crc::<u16>::new(algorithm);
        let gives = |order: fn(u16) -> u16| {
            FRAMES.iter().all(|(frame, expected)| order(crc.checksum(frame)) == *expected)
        };
        assert!(!gives(|value| value) && !gives(u16::swap_bytes), "{algorithm:?}");
    }
}

#[test]
fn checksum_is_no_crc_with_any_parameters() {
    // Start value and final exclusive or cancel out between two messages of one length: what is left of a CRC is its
    // polynomial, and the order of bits and bytes in and out.
    let (first, expected_first) = FRAMES[0];
    let differences = FRAMES[1..].iter().map(|(frame, expected)| {
        let message: Vec<u8> = first.iter().zip(*frame).map(|(a, b)| a ^ b).collect();
        (message, expected_first ^ expected)
    });
    let differences: Vec<(Vec<u8>, u16)> = differences.collect();
    let orders: [fn(u16) -> u16; 4] =
        [|value| value, u16::swap_bytes, u16::reverse_bits, |value| value.reverse_bits().swap_bytes()];
    for polynomial in 0..=u16::MAX {
        for bits_reversed in [false, true] {
            let remainder = |message: &[u8]| {
                message.iter().fold(0u16, |value, &byte| {
                    let byte = if bits_reversed { byte.reverse_bits() } else { byte };
                    (0..8).fold(value ^ u16::from(byte) << 8, |value, _| {
                        if value & 0x8000 == 0 { value << 1 } else { value << 1 ^ polynomial }
                    })
                })
            };
            for order in orders {
                let gives = differences.iter().all(|(message, wanted)| order(remainder(message)) == *wanted);
                assert!(!gives, "polynomial {polynomial:04X}h, bits reversed: {bits_reversed}");
            }
        }
    }
}
