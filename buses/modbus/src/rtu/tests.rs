//! Frames and silences: frame detection, addressing and counters.

use super::*;
use crate::tests::Plant;
use crate::{Exception, Function, MAX_PDU_LEN};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::vec;
use std::vec::Vec;

const TIMING: Timing = Timing::of(19_200, 11);
const UNIT: u8 = 5;
const CHARACTER_TIMEOUT_US: u32 = 20_000;
const STRICT: Config = Config { unit: UNIT, mode: Mode::Strict, broadcast: true };
const TOLERANT: Config =
    Config { mode: Mode::Tolerant { character_timeout_us: CHARACTER_TIMEOUT_US }, ..STRICT };

fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    let mut frame = [&[unit], pdu].concat();
    frame.extend(crc(&frame).to_le_bytes());
    frame
}

/// A serial line with a server and its device.
struct Bus {
    server: Server,
    plant: Plant,
    answers: Vec<Vec<u8>>,
    others: Vec<&'static str>,
}

impl Bus {
    fn new(config: Config) -> Self {
        Self { server: Server::new(config, TIMING), plant: Plant::new(), answers: vec![], others: vec![] }
    }

    fn note(answers: &mut Vec<Vec<u8>>, others: &mut Vec<&'static str>, event: Option<Event<'_>>) {
        match event {
            None => {}
            Some(Event::Answer(answer)) => answers.push(answer.to_vec()),
            Some(Event::Served) => others.push("served"),
            Some(Event::Passed) => others.push("passed"),
            Some(Event::Damaged(Damage::Silence)) => others.push("silence"),
            Some(Event::Damaged(Damage::Character)) => others.push("character"),
            Some(Event::Damaged(Damage::Length)) => others.push("length"),
            Some(Event::Damaged(Damage::Checksum)) => others.push("checksum"),
        }
    }

    fn send_after(&mut self, silence_us: u32, bytes: &[u8]) {
        for (n, byte) in bytes.iter().enumerate() {
            let silence_us = if n == 0 { silence_us } else { 0 };
            let event = self.server.push(Character::Byte(*byte), silence_us, &mut self.plant);
            Self::note(&mut self.answers, &mut self.others, event);
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        self.send_after(1_000_000, bytes);
    }

    fn silence(&mut self, us: u32) {
        let event = self.server.silence(us, &mut self.plant);
        Self::note(&mut self.answers, &mut self.others, event);
    }

    /// Sends a frame, then silence of T3.5, and returns the response; empty without one.
    fn ask(&mut self, unit: u8, pdu: &[u8]) -> Vec<u8> {
        self.send(&frame(unit, pdu));
        self.silence(TIMING.t3_5_us);
        self.answers.pop().unwrap_or_default()
    }

    fn diagnose(&mut self, sub: u16, data: u16) -> Vec<u8> {
        let ([s1, s0], [d1, d0]) = (sub.to_be_bytes(), data.to_be_bytes());
        self.ask(UNIT, &[8, s1, s0, d1, d0])
    }

    fn counter(&mut self, sub: u16) -> u16 {
        let answer = self.diagnose(sub, 0);
        assert_eq!(answer[..4], [UNIT, 8, 0, sub as u8], "subfunction {sub:02X}h");
        u16::from_be_bytes([answer[4], answer[5]])
    }
}

const READ: [u8; 5] = [3, 0, 0, 0, 4];

/// Write File Record: record 8 of file 1.
const FILE_RECORD: [u8; 11] = [21, 9, 6, 0, 1, 0, 8, 0, 1, 0xAB, 0xCD];

fn is_read_answer(answer: &[u8]) -> bool {
    answer == frame(UNIT, &[3, 8, 0, 0, 0, 0, 0, 0, 0, 0])
}

#[test]
fn silences_follow_the_rate_and_are_fixed_above_19_200_bit_s() {
    for (baud, bits, t1_5_us, t3_5_us) in [
        (9_600, 10, 1_563, 3_646),
        (19_200, 11, 860, 2_006),
        (19_201, 11, 750, 1_750),
        (230_400, 10, 750, 1_750),
    ] {
        assert_eq!(Timing::of(baud, bits), Timing { t1_5_us, t3_5_us }, "{baud} bit/s");
    }
}

#[test]
fn request_is_answered_after_3_5_characters_of_silence() {
    for config in [STRICT, TOLERANT] {
        let mut bus = Bus::new(config);
        bus.send(&frame(UNIT, &READ));
        bus.silence(TIMING.t3_5_us - 1);
        assert_eq!(bus.answers.len(), 0);
        bus.silence(TIMING.t3_5_us);
        assert!(is_read_answer(&bus.answers[0]));
        bus.silence(1_000_000);
        assert_eq!(bus.answers.len(), 1, "exactly one response");
    }
}

#[test]
fn request_cut_anywhere_is_one_up_to_1_5_characters_of_silence() {
    let request = frame(UNIT, &READ);
    for cut in 1..request.len() {
        for (silence_us, strict) in [(TIMING.t1_5_us, 1), (TIMING.t1_5_us + 1, 0), (TIMING.t3_5_us - 1, 0)] {
            for (config, answers) in [(STRICT, strict), (TOLERANT, 1)] {
                let mut bus = Bus::new(config);
                bus.send(&request[..cut]);
                bus.send_after(silence_us, &request[cut..]);
                bus.silence(TIMING.t3_5_us);
                assert_eq!(bus.answers.len(), answers, "cut at {cut}, {silence_us} us, {:?}", config.mode);
                if answers == 0 {
                    assert_eq!(bus.others, ["silence"]);
                }
            }
        }
    }
}

#[test]
fn tolerant_mode_waits_for_the_rest_of_a_request_for_this_unit() {
    let request = frame(UNIT, &[16, 0, 1, 0, 2, 4, 0, 1, 0, 2]);
    for cut in 1..request.len() {
        let mut bus = Bus::new(TOLERANT);
        bus.send(&request[..cut]);
        bus.silence(CHARACTER_TIMEOUT_US - 1);
        bus.send_after(CHARACTER_TIMEOUT_US - 1, &request[cut..]);
        bus.silence(TIMING.t3_5_us);
        assert_eq!(bus.answers, [frame(UNIT, &[16, 0, 1, 0, 2])], "cut at {cut}");

        let mut bus = Bus::new(TOLERANT);
        bus.send(&request[..cut]);
        bus.send_after(CHARACTER_TIMEOUT_US, &request[cut..]);
        bus.silence(CHARACTER_TIMEOUT_US);
        assert_eq!(bus.answers.len(), 0, "cut at {cut}");
        assert!(bus.plant.tables.take_written().is_none());
    }
}

#[test]
fn tolerant_mode_waits_for_the_rest_of_unknown_functions_too() {
    // Device identification is the shortest known request, Mask Write Register the longest of a fixed length.
    for pdu in [&[0x41][..], &[43, 14, 1, 0], &READ, &[22, 0, 0, 0xFF, 0xFF, 0, 0]] {
        let answer = Bus::new(TOLERANT).ask(UNIT, pdu);
        assert!(answer.len() > 4, "{pdu:?}");
        let request = frame(UNIT, pdu);
        for cut in 1..request.len() {
            let mut bus = Bus::new(TOLERANT);
            bus.send(&request[..cut]);
            bus.silence(CHARACTER_TIMEOUT_US - 1);
            bus.send_after(CHARACTER_TIMEOUT_US - 1, &request[cut..]);
            bus.silence(TIMING.t3_5_us);
            assert_eq!(bus.answers, core::slice::from_ref(&answer), "{pdu:?} cut at {cut}");
        }
    }
}

#[test]
fn tolerant_mode_does_not_wait_if_only_the_checksum_is_wrong() {
    let requests = [
        &[0x41][..],
        &[43, 14, 1, 0],
        &READ,
        &[22, 0, 0, 0xFF, 0xFF, 0, 0],
        &[16, 0, 1, 0, 2, 4, 0, 1, 0, 2],
    ];
    for pdu in requests {
        let mut request = frame(UNIT, pdu);
        let last = request.len() - 1;
        request[last] ^= 1;
        let mut bus = Bus::new(TOLERANT);
        bus.send(&request);
        bus.silence(TIMING.t3_5_us);
        assert_eq!(bus.others, ["checksum"], "{pdu:?}");
    }
}

#[test]
fn receiver_with_a_new_unit_waits_for_the_rest_of_its_requests() {
    let pdu: &[u8] = &[3, 0, 0, 0, 1];
    for (unit, is_waited_for) in [(UNIT + 1, true), (UNIT, false)] {
        let mut receiver = Receiver::new(UNIT, Mode::Strict, TIMING);
        receiver.configure(UNIT + 1, TOLERANT.mode);
        for byte in &frame(unit, pdu)[..4] {
            receiver.push(Character::Byte(*byte), 0);
        }
        assert_eq!(receiver.silence(TIMING.t3_5_us).is_none(), is_waited_for, "unit {unit}");
    }
}

#[test]
fn damage_after_an_allowed_silence_is_reported_as_damage() {
    let mut receiver = Receiver::new(UNIT, Mode::Strict, TIMING);
    receiver.push(Character::Byte(UNIT), 0);
    receiver.push(Character::Damaged, TIMING.t1_5_us);
    let received = receiver.silence(TIMING.t3_5_us);
    assert_eq!(received, Some(Received::Damaged(Damage::Character)));
}

#[test]
fn two_bytes_are_no_frame_even_with_a_valid_checksum() {
    for config in [STRICT, TOLERANT] {
        let mut bus = Bus::new(config);
        bus.send(&[0xFF, 0xFF]);
        bus.silence(CHARACTER_TIMEOUT_US);
        assert_eq!((bus.answers.len(), &bus.others[..]), (0, &["length"][..]));
    }
}

#[test]
fn truncated_frame_for_another_unit_is_not_joined_to_the_next() {
    let mut bus = Bus::new(TOLERANT);
    bus.send(&frame(UNIT + 1, &READ)[..5]);
    bus.send_after(TIMING.t3_5_us, &frame(UNIT, &READ));
    bus.silence(TIMING.t3_5_us);
    assert!(is_read_answer(&bus.answers[0]));
    assert_eq!(bus.others, ["checksum"]);
}

#[test]
fn truncated_frame_is_discarded() {
    let request = frame(UNIT, &[6, 0, 0, 0, 1]);
    for config in [STRICT, TOLERANT] {
        for len in 1..request.len() {
            let mut bus = Bus::new(config);
            bus.send(&request[..len]);
            bus.silence(CHARACTER_TIMEOUT_US);
            assert_eq!(bus.answers.len(), 0);
            assert!(bus.plant.tables.take_written().is_none(), "{len} bytes");
        }
    }
}

#[test]
fn frame_with_any_single_bit_error_is_discarded() {
    let request = frame(UNIT, &[16, 0, 0, 0, 2, 4, 0x01, 0x00, 0x07, 0xD0]);
    for bit in 0..request.len() * 8 {
        let mut wrong = request.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        let mut bus = Bus::new(STRICT);
        bus.send(&wrong);
        bus.silence(TIMING.t3_5_us);
        assert_eq!((bus.answers.len(), &bus.others[..]), (0, &["checksum"][..]), "bit {bit}");
        assert!(bus.plant.tables.take_written().is_none());
    }
}

#[test]
fn damaged_character_invalidates_only_its_own_frame() {
    let request = frame(UNIT, &READ);
    for at in 0..request.len() {
        let mut bus = Bus::new(TOLERANT);
        for (n, byte) in request.iter().enumerate() {
            let character = if n == at { Character::Damaged } else { Character::Byte(*byte) };
            assert_eq!(bus.server.push(character, 0, &mut bus.plant), None);
        }
        bus.silence(TIMING.t3_5_us);
        assert_eq!((bus.answers.len(), &bus.others[..]), (0, &["character"][..]));
        assert!(is_read_answer(&bus.ask(UNIT, &READ)));
        assert_eq!((bus.counter(0x0C), bus.counter(0x12)), (1, 1));
    }
}

/// Characters that a transceiver adds when it switches over. `None` is a break, or a damaged character.
const STRAYS: [&[Option<u8>]; 6] = [
    &[Some(0x00)],
    &[Some(0x00); 8],
    &[Some(0xFF)],
    &[None],
    &[None, Some(0x00), Some(0xFF)],
    &[Some(0xFF), None],
];

impl Bus {
    fn send_strays(&mut self, silence_us: u32, strays: &[Option<u8>]) {
        for (n, stray) in strays.iter().enumerate() {
            let character = stray.map_or(Character::Damaged, Character::Byte);
            let silence_us = if n == 0 { silence_us } else { 0 };
            let event = self.server.push(character, silence_us, &mut self.plant);
            Self::note(&mut self.answers, &mut self.others, event);
        }
    }
}

/// Requests of every kind of length, with their responses: fixed, counted, unknown function, exception, and one whose
/// checksum ends with 00h.
fn requests() -> [(Vec<u8>, Vec<u8>); 8] {
    let ending_with_00h = (0..=u8::MAX).find(|low| frame(UNIT, &[6, 0, 1, 0, *low]).ends_with(&[0])).unwrap();
    [
        READ.to_vec(),
        vec![6, 0, 1, 0, ending_with_00h],
        vec![15, 0, 0, 0, 3, 1, 5],
        vec![16, 0, 1, 0, 2, 4, 0, 1, 0, 0],
        FILE_RECORD.to_vec(),
        vec![23, 0, 0, 0, 1, 0, 1, 0, 1, 2, 0, 9],
        vec![0x41],
        vec![3, 0, 9, 0, 1],
    ]
    .map(|pdu| {
        let answer = Bus::new(STRICT).ask(UNIT, &pdu);
        (pdu, answer)
    })
}

#[test]
fn strays_after_a_request_are_ignored_and_counted() {
    for (pdu, expected) in requests() {
        for strays in STRAYS {
            // Without a pause, and with one that is longer than T1.5.
            for (config, silence_us) in [(STRICT, 0), (TOLERANT, 0), (STRICT, TIMING.t3_5_us - 1)] {
                let mut bus = Bus::new(config);
                bus.send(&frame(UNIT, &pdu));
                bus.send_strays(silence_us, strays);
                bus.silence(TIMING.t3_5_us);
                assert_eq!(bus.answers, core::slice::from_ref(&expected), "{pdu:02X?} {strays:02X?}");
                assert_eq!(usize::from(bus.server.counters().strays), strays.len());
                assert_eq!(bus.server.counters().bus_errors, 0);
            }
        }
    }
}

#[test]
fn strays_before_a_request_are_ignored_and_counted() {
    for (pdu, expected) in requests() {
        for strays in STRAYS {
            for (config, silence_us) in [(STRICT, 0), (TOLERANT, 0), (STRICT, TIMING.t3_5_us - 1)] {
                let mut bus = Bus::new(config);
                bus.send_strays(1_000_000, strays);
                bus.send_after(silence_us, &frame(UNIT, &pdu));
                bus.send_strays(0, strays);
                bus.silence(TIMING.t3_5_us);
                assert_eq!(bus.answers, core::slice::from_ref(&expected), "{pdu:02X?} {strays:02X?}");
                assert_eq!(usize::from(bus.server.counters().strays), 2 * strays.len());
            }
        }
    }
}

#[test]
fn broadcast_with_a_stray_behind_it_is_executed() {
    for stray in [0x00, 0xFF] {
        let mut bus = Bus::new(STRICT);
        bus.send(&[&frame(BROADCAST, &[6, 0, 1, 0, 7])[..], &[stray]].concat());
        bus.silence(TIMING.t3_5_us);
        assert_eq!(bus.others, ["served"]);
        assert_eq!(bus.plant.tables.take_written().map(|bytes| bytes[2..4] == [0, 7]), Some(true));
    }
}

/// Only strays outside of a request with a correct checksum are ignored.
#[test]
fn noise_around_a_request_is_no_stray() {
    let request = frame(UNIT, &[6, 0, 0, 0, 1]);
    let joined = |pieces: &[&[u8]]| pieces.concat();
    let mut cases = vec![
        ("another byte after it", joined(&[&request, &[0x01]])),
        ("another byte among strays", joined(&[&request, &[0x00, 0x80, 0x00]])),
        ("another byte before it", joined(&[&[0x01], &request])),
        ("nine strays before it", joined(&[&[0x00; 9], &request])),
        ("another frame after it", joined(&[&request, &frame(UNIT + 1, &READ)])),
        ("more strays than a frame has room for", joined(&[&request, &[0x00; 249]])),
    ];
    // One byte is missing, and strays take its place.
    for at in 0..request.len() {
        let rest = joined(&[&request[..at], &request[at + 1..]]);
        cases.push(("a lost byte, then strays", joined(&[&rest, &[0x00]])));
        cases.push(("strays, then a lost byte", joined(&[&[0x00], &rest])));
    }
    for (case, bytes) in cases {
        for config in [STRICT, TOLERANT] {
            let mut bus = Bus::new(config);
            bus.send(&bytes);
            bus.silence(CHARACTER_TIMEOUT_US);
            assert_eq!(bus.answers.len(), 0, "{case}: {bytes:02X?}");
            assert!(bus.plant.tables.take_written().is_none(), "{case}: {bytes:02X?}");
            assert_eq!(bus.server.counters().strays, 0);
        }
    }
}

#[test]
fn damaged_address_is_no_broadcast_and_damage_inside_counts() {
    for (unit, pdu) in [(BROADCAST, &[6, 0, 1, 0, 7][..]), (UNIT, &READ)] {
        let request = frame(unit, pdu);
        for at in 0..request.len() {
            let mut bus = Bus::new(STRICT);
            for (n, byte) in request.iter().enumerate() {
                let character = if n == at { Character::Damaged } else { Character::Byte(*byte) };
                assert_eq!(bus.server.push(character, 0, &mut bus.plant), None);
            }
            bus.send_strays(0, &[Some(0x00)]);
            bus.silence(TIMING.t3_5_us);
            assert_eq!((bus.answers.len(), &bus.others[..]), (0, &["character"][..]), "unit {unit}, {at}");
            assert!(bus.plant.tables.take_written().is_none());
        }
    }
}

#[test]
fn pause_inside_a_request_with_strays_invalidates_it() {
    // The address of a broadcast is no stray before the rest.
    for (unit, before) in [(UNIT, &[0x00][..]), (BROADCAST, &[])] {
        let request = frame(unit, &[6, 0, 1, 0, 7]);
        for cut in 1..request.len() {
            for after in [&[Some(0x00)][..], &[None]] {
                let mut bus = Bus::new(STRICT);
                bus.send(&[before, &request[..cut]].concat());
                bus.send_after(TIMING.t1_5_us + 1, &request[cut..]);
                bus.send_strays(0, after);
                bus.silence(TIMING.t3_5_us);
                assert_eq!(
                    (bus.answers.len(), &bus.others[..]),
                    (0, &["silence"][..]),
                    "{unit} cut at {cut}"
                );
                assert!(bus.plant.tables.take_written().is_none());
            }
        }
    }
}

#[test]
fn frames_for_other_units_between_requests_are_ignored() {
    let mut bus = Bus::new(STRICT);
    for (value, unit) in [UNIT, UNIT, UNIT + 1, 247, UNIT].into_iter().enumerate() {
        bus.send_after(TIMING.t3_5_us, &frame(unit, &[6, 0, 1, 0, value as u8]));
    }
    bus.silence(TIMING.t3_5_us);
    assert_eq!(bus.answers, [0, 1, 4].map(|value| frame(UNIT, &[6, 0, 1, 0, value])));
    assert_eq!(bus.others, ["passed", "passed"]);
}

#[test]
fn frames_without_silence_between_them_are_discarded() {
    for config in [STRICT, TOLERANT] {
        let mut bus = Bus::new(config);
        let request = frame(UNIT, &[6, 0, 0, 0, 1]);
        bus.send(&[request.clone(), request].concat());
        bus.silence(TIMING.t3_5_us);
        assert_eq!(bus.others, ["checksum"]);
        assert!(bus.plant.tables.take_written().is_none());
    }
}

#[test]
fn frame_of_256_bytes_is_accepted_and_of_257_rejected() {
    let echo = [&[8, 0, 0][..], &[7; 250]].concat();
    let mut bus = Bus::new(STRICT);
    assert_eq!(frame(UNIT, &echo).len(), MAX_FRAME_LEN);
    assert_eq!(bus.ask(UNIT, &echo), frame(UNIT, &echo));
    bus.ask(UNIT, &[&echo[..], &[7]].concat());
    bus.ask(UNIT, &[&echo[..], &[7; 1000]].concat());
    bus.ask(UNIT, &[]);
    bus.send(&[UNIT]);
    bus.silence(TIMING.t3_5_us);
    assert_eq!(bus.others, ["length"; 4]);
    assert!(is_read_answer(&bus.ask(UNIT, &READ)), "and the server still responds");
}

#[test]
fn broadcast_writes_are_executed_without_a_response() {
    let mut bus = Bus::new(STRICT);
    bus.ask(BROADCAST, &[6, 0, 1, 0, 7]);
    assert_eq!(bus.others, ["served"]);
    assert_eq!(bus.plant.tables.take_written().map(|bytes| bytes[2..4] == [0, 7]), Some(true));
    for pdu in
        [&READ[..], &[23, 0, 0, 0, 1, 0, 1, 0, 1, 2, 0, 9], &[8, 0, 4, 0, 0], &[17], &[43, 14, 1, 0], &[99]]
    {
        bus.ask(BROADCAST, pdu);
    }
    assert_eq!(bus.others, ["served", "passed", "passed", "passed", "passed", "passed", "passed"]);
    assert!(bus.plant.tables.take_written().is_none() && bus.answers.is_empty());
    assert!(!bus.server.is_listen_only());
}

#[test]
fn response_to_file_records_follows_their_outcome() {
    for (outcome, response) in [(Ok(()), &FILE_RECORD[..]), (Err(Exception::ServerDeviceFailure), &[0x95, 4])]
    {
        let mut bus = Bus::new(TOLERANT);
        bus.plant.outcome = None;
        assert_eq!(bus.ask(UNIT, &FILE_RECORD), [], "it is in progress");
        assert!(!bus.server.is_idle());
        bus.silence(TIMING.t3_5_us);
        bus.plant.outcome = Some(outcome);
        bus.send_after(1_000_000, &[UNIT + 1, 3]);
        bus.silence(0);
        assert_eq!((bus.answers.len(), &bus.others[..]), (0, &["served"][..]), "a request is being received");
        bus.silence(CHARACTER_TIMEOUT_US);
        bus.silence(CHARACTER_TIMEOUT_US);
        assert_eq!(bus.answers.len(), 0, "the client no longer waits after the end of a damaged frame");

        bus.plant.outcome = None;
        assert_eq!(bus.ask(UNIT, &FILE_RECORD), []);
        bus.plant.outcome = Some(outcome);
        bus.silence(TIMING.t3_5_us);
        bus.silence(TIMING.t3_5_us);
        assert_eq!(bus.answers, [frame(UNIT, response)], "once");
        let exceptions = bus.server.counters().exceptions;
        assert_eq!((exceptions, bus.server.is_idle()), (u16::from(outcome.is_err()), true));
    }
    let mut bus = Bus::new(STRICT);
    bus.plant.outcome = None;
    bus.ask(UNIT, &FILE_RECORD);
    bus.ask(UNIT + 1, &READ);
    bus.plant.outcome = Some(Ok(()));
    bus.silence(TIMING.t3_5_us);
    assert_eq!(bus.answers.len(), 0, "the client has spoken to another unit");
}

#[test]
fn server_is_idle_while_no_frame_is_in_progress() {
    let mut bus = Bus::new(STRICT);
    let request = frame(UNIT, &[4, 0, 0, 0, 1]);
    assert!(bus.server.is_idle());
    for byte in &request {
        bus.send_after(0, &[*byte]);
        assert!(!bus.server.is_idle());
    }
    bus.silence(TIMING.t3_5_us);
    assert!(bus.server.is_idle());
    assert_eq!(bus.answers.len(), 1);

    // The first character of the next frame ends the previous one and remains pending.
    bus.send(&request);
    bus.send(&request);
    assert_eq!(bus.answers.len(), 2);
    assert!(!bus.server.is_idle());
    bus.silence(TIMING.t3_5_us);
    assert!(bus.server.is_idle());
    bus.send(&request);
    bus.send(&request[..1]);
    assert!(!bus.server.is_idle(), "one character is carried over");
    bus.silence(TIMING.t3_5_us);
    assert!(bus.server.is_idle());
    bus.silence(u32::MAX);
    assert_eq!((bus.answers.len(), &bus.others[..]), (4, &["length"][..]));
}

#[test]
fn receiver_discards_pending_characters_on_reset() {
    let mut receiver = Receiver::new(UNIT, Mode::Strict, TIMING);
    let pdu: &[u8] = &[3, 0, 0, 0, 1];
    receiver.push(Character::Byte(UNIT), 0);
    receiver.push(Character::Damaged, 0);

    receiver.reset();

    assert!(receiver.is_idle());
    for byte in frame(UNIT, pdu) {
        assert_eq!(receiver.push(Character::Byte(byte), 0), None);
    }
    assert_eq!(receiver.silence(TIMING.t3_5_us), Some(Received::Frame { unit: UNIT, pdu }));
}

#[test]
fn broadcast_is_ignored_if_disabled() {
    let mut bus = Bus::new(Config { broadcast: false, ..STRICT });
    bus.ask(BROADCAST, &[6, 0, 1, 0, 7]);
    assert!(bus.plant.tables.take_written().is_none() && bus.answers.is_empty());
}

#[test]
fn diagnostic_counters_follow_the_specification() {
    let mut bus = Bus::new(STRICT);
    bus.ask(UNIT + 1, &READ);
    bus.ask(BROADCAST, &[6, 0, 1, 0, 7]);
    bus.ask(BROADCAST, &[6, 0, 9, 0, 7]);
    bus.ask(UNIT, &[3, 0, 9, 0, 1]);
    bus.send(&[1, 2, 3, 4, 5]);
    bus.silence(TIMING.t3_5_us);
    // Each read of a counter is a message as well.
    assert_eq!(bus.counter(0x0B), 5, "bus messages");
    assert_eq!(bus.counter(0x0C), 1, "communication errors");
    assert_eq!(bus.counter(0x0D), 2, "exceptions, including the broadcast's");
    assert_eq!(bus.counter(0x0E), 7, "server messages");
    assert_eq!(bus.counter(0x0F), 2, "no response");
    assert_eq!((bus.counter(0x10), bus.counter(0x11), bus.counter(0x12)), (0, 0, 0));
    assert_eq!(bus.counter(0x02), 0, "diagnostic register");
    bus.diagnose(0x0A, 0);
    assert_eq!(bus.counter(0x0B), 1);
}

#[test]
fn diagnostics_echo_and_reject_according_to_the_specification() {
    let mut bus = Bus::new(STRICT);
    assert_eq!(bus.diagnose(0, 0xA537), frame(UNIT, &[8, 0, 0, 0xA5, 0x37]));
    assert_eq!(bus.diagnose(1, 0), frame(UNIT, &[8, 0, 1, 0, 0]));
    assert_eq!(bus.diagnose(1, 0xFF00), frame(UNIT, &[8, 0, 1, 0xFF, 0]));
    assert_eq!(bus.diagnose(0x14, 0), frame(UNIT, &[8, 0, 0x14, 0, 0]));
    for (sub, data) in [(1, 1), (1, 0xFFFF), (2, 1), (4, 1), (0x0A, 1), (0x0B, 1), (0x14, 1)] {
        assert_eq!(bus.diagnose(sub, data), frame(UNIT, &[0x88, 3]), "{sub:02X}h with {data}");
    }
    for sub in [3, 5, 0x13, 0x15, 0xFFFF] {
        assert_eq!(bus.diagnose(sub, 0), frame(UNIT, &[0x88, 1]), "{sub:02X}h");
    }
    assert_eq!(bus.ask(UNIT, &[8, 0]), frame(UNIT, &[0x88, 3]));
    assert_eq!(bus.ask(UNIT, &[8, 0, 2, 0]), frame(UNIT, &[0x88, 3]));
}

#[test]
fn listen_only_mode_ends_only_with_a_restart() {
    let mut bus = Bus::new(STRICT);
    assert_eq!(bus.diagnose(4, 0), []);
    assert!(bus.server.is_listen_only());
    assert_eq!(bus.ask(UNIT, &[6, 0, 0, 0, 1]), []);
    assert_eq!(bus.diagnose(0, 0), []);
    assert!(bus.plant.tables.take_written().is_none());
    assert_eq!(bus.diagnose(1, 0), [], "the restart has no response either");
    assert!(!bus.server.is_listen_only());
    assert!(is_read_answer(&bus.ask(UNIT, &READ)));
}

#[test]
fn counters_saturate() {
    let mut bus = Bus::new(STRICT);
    for _ in 0..=u16::MAX {
        bus.send(&[1]);
        bus.silence(TIMING.t3_5_us);
    }
    assert_eq!(bus.counter(0x0C), u16::MAX);
}

#[test]
fn new_unit_applies_from_the_next_frame_on() {
    let mut bus = Bus::new(STRICT);
    bus.server.configure(Config { unit: 9, ..STRICT });
    assert_eq!(bus.ask(UNIT, &READ), []);
    assert_eq!(bus.ask(9, &READ)[0], 9);
}

#[test]
fn frame_beyond_the_buffer_is_rejected_despite_a_valid_checksum() {
    // The first 256 bytes are a valid frame, and one more byte follows.
    let mut long = frame(UNIT, &[&[8, 0, 0][..], &[7; 250]].concat());
    long.push(0);
    let mut bus = Bus::new(TOLERANT);
    bus.send(&long);
    bus.silence(CHARACTER_TIMEOUT_US);
    assert_eq!(bus.others, ["length"]);
}

#[test]
fn every_function_and_length_gets_a_complete_answer_or_none() {
    let mut bus = Bus::new(STRICT);
    for code in (0..=255u8).filter(|code| *code != Function::Diagnostics.code()) {
        for len in 0..=260usize {
            let mut pdu = vec![code];
            pdu.resize(1 + len, 1);
            let answer = bus.ask(UNIT, &pdu);
            if pdu.len() > MAX_PDU_LEN {
                assert_eq!(answer, [], "{code} with {len} bytes is longer than a frame");
            } else {
                let (body, sum) = answer.split_last_chunk().unwrap();
                assert_eq!((body[0], u16::from_le_bytes(*sum)), (UNIT, crc(body)), "{code} with {len} bytes");
                assert_eq!(body[1] & 0x7F, code & 0x7F);
            }
        }
    }
    assert_eq!(bus.ask(UNIT, &[]), [], "no function code");
    assert!(is_read_answer(&bus.ask(UNIT, &READ)), "and the server still responds");
}

#[test]
fn diagnostics_at_every_length_follow_the_specification() {
    for len in 0..=252usize {
        for sub in 0..=0x20u16 {
            let mut pdu = vec![8];
            pdu.extend(sub.to_be_bytes());
            pdu.resize(3 + len, 0);
            pdu.truncate(1 + len);
            let mut bus = Bus::new(STRICT);
            let answer = bus.ask(UNIT, &pdu);
            let whole = len == 4;
            let sub = if len >= 2 { Some(sub) } else { None };
            let expected: &[u8] = match sub {
                None => &[UNIT, 0x88, 3],
                Some(0) => &frame(UNIT, &pdu),
                // Listen-only mode has no response.
                Some(4) if whole => &[],
                Some(1 | 2 | 4 | 0x0A..=0x12 | 0x14) if !whole => &[UNIT, 0x88, 3],
                Some(1 | 0x0A | 0x14 | 2) => &frame(UNIT, &pdu),
                Some(0x0B..=0x12) => &[UNIT, 8],
                Some(_) => &[UNIT, 0x88, 1],
            };
            assert!(answer.starts_with(expected), "{pdu:02X?}: {answer:02X?}");
            assert_eq!(answer.is_empty(), expected.is_empty());
        }
    }
}

#[test]
fn server_id_is_the_unit_which_runs_and_what_it_is() {
    for config in [STRICT, TOLERANT] {
        let mut bus = Bus::new(config);
        let answer = [&[17, 8, UNIT, 0xFF][..], b"PC 1.2"].concat();
        assert_eq!(bus.ask(UNIT, &[17]), frame(UNIT, &answer));
        assert_eq!(bus.ask(UNIT, &[17, 0]), frame(UNIT, &[0x91, 3]));
        bus.ask(UNIT + 1, &[17]);
        assert_eq!(bus.others, ["passed"]);
    }
}

/// FC 17 has no data, so a four-byte request is complete and the receiver does not wait for more.
#[test]
fn damaged_request_for_the_server_id_ends_with_its_silence() {
    let mut bus = Bus::new(TOLERANT);
    bus.send(&[UNIT, 17, 0, 0]);
    bus.silence(TIMING.t3_5_us);
    assert_eq!(bus.others, ["checksum"]);
}

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

/// Equal hashes imply equal future behaviour: pending characters count, counters and sent responses do not.
#[test]
fn receivers_hash_pending_characters_and_not_past_ones() {
    let after = |bytes: &[u8]| {
        let mut receiver = Receiver::new(1, Mode::Strict, Timing::of(19_200, 11));
        for byte in bytes {
            assert_eq!(receiver.push(Character::Byte(*byte), 0), None);
        }
        receiver
    };
    let mut damaged = after(&[1]);
    assert_eq!(damaged.push(Character::Damaged, 0), None);
    assert!(differ(&[after(&[]), after(&[1]), after(&[2]), after(&[1, 0]), damaged]));
    let mut given = after(&[1, 3, 0, 0, 0, 1, 0x84, 0x0A]);
    assert!(given.silence(10_000).is_some());
    assert_eq!(hash(&given), hash(&after(&[])));
    let config = Config { unit: 1, mode: Mode::Strict, broadcast: true };
    let server = |config| Server::new(config, Timing::of(19_200, 11));
    assert!(differ(&[server(config), server(Config { broadcast: false, ..config })]));
}
