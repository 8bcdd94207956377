//! Detection of valid, damaged and truncated telegrams.

use super::*;
use crate::telegram::Function;
use proptest::prelude::*;
use std::vec;
use std::vec::Vec;

/// Destination, source, service access points, data.
type Content = (u8, u8, Option<u8>, Option<u8>, Vec<u8>);

/// Telegrams and damage found in a sequence of characters.
#[derive(Debug, Default, PartialEq)]
struct Found {
    telegrams: Vec<Content>,
    damaged: u32,
}

fn push(receiver: &mut Receiver, found: &mut Found, character: Character, silence_bits: u32) {
    if let Some(telegram) = receiver.push(character, silence_bits) {
        let Telegram { destination, source, dsap, ssap, data, .. } = telegram;
        found.telegrams.push((destination, source, dsap, ssap, data.to_vec()));
    }
    assert_eq!(receiver.counters().telegrams as usize, found.telegrams.len());
    found.damaged = receiver.counters().damaged;
}

/// Receives telegrams, each after 33 bit times of silence.
fn find(telegrams: &[&[u8]]) -> Found {
    let (mut receiver, mut found) = (Receiver::new(), Found::default());
    for telegram in telegrams {
        for (at, byte) in telegram.iter().enumerate() {
            let silence_bits = if at == 0 { SYNC_BITS } else { 0 };
            push(&mut receiver, &mut found, Character::Byte(*byte), silence_bits);
        }
    }
    found
}

const STATUS: [u8; 6] = [0x10, 7, 2, 0x49, 0x52, 0x16];
const DIAG: [u8; 11] = [0x68, 5, 5, 0x68, 0x87, 0x82, 0x6D, 60, 62, 0xF0, 0x16];
const EIGHT: [u8; 14] = [0xA2, 7, 2, 0x7D, 1, 2, 3, 4, 5, 6, 7, 8, 0xAA, 0x16];
const TOKEN: [u8; 3] = [0xDC, 2, 2];

#[test]
fn telegrams_with_each_start_delimiter_are_found() {
    let found = find(&[&STATUS, &DIAG, &EIGHT, &TOKEN, &[SC], &STATUS]);
    let expected = vec![
        (7, 2, None, None, vec![]),
        (7, 2, Some(60), Some(62), vec![]),
        (7, 2, None, None, vec![1, 2, 3, 4, 5, 6, 7, 8]),
        (7, 2, None, None, vec![]),
    ];
    assert_eq!(found, Found { telegrams: expected, damaged: 0 });
}

#[test]
fn telegram_may_follow_an_intact_one_without_silence() {
    let line = [&STATUS[..], &TOKEN, &[SC], &DIAG].concat();
    assert_eq!(find(&[&line]).telegrams.len(), 2);
}

#[test]
fn longest_and_shortest_telegrams_of_variable_length_are_found() {
    for len in [1, 2, 245, 246] {
        let mut telegram = vec![0x68, len + 3, len + 3, 0x68, 7, 2, 0x7D];
        telegram.extend((0..len).map(|byte| byte ^ 0x5A));
        let sum = telegram[4..].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
        telegram.extend([sum, 0x16]);
        let found = find(&[&telegram]);
        assert_eq!((found.telegrams.len(), found.damaged), (1, 0), "{len} bytes");
        assert_eq!(found.telegrams[0].4, telegram[7..telegram.len() - 2]);
    }
}

#[test]
fn any_wrong_bit_invalidates_a_telegram_but_not_the_next_one() {
    for telegram in [&STATUS[..], &DIAG, &EIGHT] {
        for at in 0..telegram.len() {
            for bit in 0..8 {
                let mut damaged = telegram.to_vec();
                damaged[at] ^= 1 << bit;
                let found = find(&[&damaged, &STATUS]);
                let last = found.telegrams.last().unwrap();
                assert_eq!((found.telegrams.len(), last.0, found.damaged), (1, 7, 1), "{damaged:02X?}");
            }
        }
    }
}

#[test]
fn damaged_character_invalidates_all_until_the_next_silence() {
    let (mut receiver, mut found) = (Receiver::new(), Found::default());
    let bytes = |telegram: &[u8]| telegram.iter().map(|byte| Character::Byte(*byte)).collect::<Vec<_>>();
    push(&mut receiver, &mut found, Character::Byte(STATUS[0]), SYNC_BITS);
    push(&mut receiver, &mut found, Character::Damaged, 0);
    for character in bytes(&STATUS) {
        push(&mut receiver, &mut found, character, SYNC_BITS - 1);
    }
    assert_eq!(found, Found { telegrams: vec![], damaged: 1 });
    for (at, mut character) in bytes(&STATUS).into_iter().enumerate() {
        if at == 4 {
            character = Character::Damaged;
        }
        push(&mut receiver, &mut found, character, if at == 0 { SYNC_BITS } else { 0 });
    }
    assert_eq!(found, Found { telegrams: vec![], damaged: 2 });
    for (at, character) in bytes(&STATUS).into_iter().enumerate() {
        push(&mut receiver, &mut found, character, if at == 0 { SYNC_BITS } else { 0 });
    }
    assert_eq!((found.telegrams.len(), found.damaged), (1, 2));
}

/// A transceiver that switches over adds characters after a telegram, and less than T_SYN before the next one.
#[test]
fn strays_between_telegrams_do_not_hide_the_next_one() {
    let strays = [
        Character::Byte(0x00),
        Character::Byte(0xFF),
        // A break.
        Character::Damaged,
    ];
    for stray in strays {
        for count in 1..=3 {
            let (mut receiver, mut found) = (Receiver::new(), Found::default());
            for at in 0..2 {
                for (n, byte) in STATUS.into_iter().enumerate() {
                    let silence_bits = if n > 0 {
                        0
                    } else if at == 0 {
                        SYNC_BITS
                    } else {
                        SYNC_BITS - 12
                    };
                    push(&mut receiver, &mut found, Character::Byte(byte), silence_bits);
                }
                for _ in 0..count {
                    push(&mut receiver, &mut found, stray, 1);
                }
            }
            assert_eq!((found.telegrams.len(), found.damaged), (2, 1), "{count} times {stray:?}");
        }
    }
    for wrong in [0x01, 0x55, 0x80] {
        let line = [&STATUS[..], &[wrong], &STATUS].concat();
        assert_eq!(find(&[&line]).telegrams.len(), 1, "{wrong:02X}h is no stray");
    }
}

#[test]
fn strays_inside_a_telegram_invalidate_it() {
    for stray in [0x00, 0xFF] {
        for at in 1..STATUS.len() {
            let line = [&STATUS[..at], &[stray], &STATUS[at..]].concat();
            assert_eq!(find(&[&line]), Found { telegrams: vec![], damaged: 1 }, "{stray:02X}h before {at}");
        }
    }
}

#[test]
fn silence_inside_a_telegram_ends_it_but_a_short_pause_does_not() {
    for at in 1..STATUS.len() {
        for (silence_bits, expected) in [(SYNC_BITS - 1, 1), (SYNC_BITS, 0), (u32::MAX, 0)] {
            let (mut receiver, mut found) = (Receiver::new(), Found::default());
            for (n, byte) in STATUS.into_iter().enumerate() {
                let silence_bits = match n {
                    0 => SYNC_BITS,
                    _ if n == at => silence_bits,
                    _ => 0,
                };
                push(&mut receiver, &mut found, Character::Byte(byte), silence_bits);
            }
            assert_eq!(found.telegrams.len(), expected, "{silence_bits} before {at}");
        }
    }
    assert_eq!(find(&[&STATUS[..3], &STATUS]).damaged, 1, "truncated");
}

#[test]
fn nothing_is_found_before_the_first_silence() {
    let (mut receiver, mut found) = (Receiver::new(), Found::default());
    for byte in STATUS {
        push(&mut receiver, &mut found, Character::Byte(byte), 0);
    }
    assert_eq!(found, Found::default());
}

#[test]
fn invalid_lengths_are_damage() {
    for header in [[0x68, 3, 3, 0x68], [0x68, 250, 250, 0x68], [0x68, 5, 6, 0x68], [0x68, 5, 5, 0x16]] {
        assert_eq!(find(&[&header, &STATUS]).damaged, 1, "{header:02X?}");
        assert_eq!(find(&[&header, &STATUS]).telegrams.len(), 1);
    }
    // The address flags a service access point, but there is no data.
    assert_eq!(find(&[&[0x10, 0x87, 2, 0x49, 0xD2, 0x16]]), Found { telegrams: vec![], damaged: 1 });
    assert_eq!(
        find(&[&[0x68, 4, 4, 0x68, 0x87, 0x82, 0x6D, 60, 0xB2, 0x16]]).damaged,
        1,
        "one of two points"
    );
}

#[test]
fn function_code_distinguishes_requests_from_answers() {
    let function = |code: u8| {
        let bytes = crate::telegram::sd1(7, 2, code);
        let telegram = Telegram::parse(&bytes).unwrap();
        (telegram.function(), telegram.fcb(), telegram.fcv())
    };
    for (code, expected) in [
        (0x43, Some(Function::Unserved)),
        (0x44, Some(Function::Sdn)),
        (0x45, Some(Function::Unserved)),
        (0x46, Some(Function::Sdn)),
        (0x49, Some(Function::FdlStatus)),
        (0x4C, Some(Function::Srd)),
        (0x4D, Some(Function::Srd)),
        (0x4E, Some(Function::Unserved)),
        (0x4F, Some(Function::Unserved)),
        (0x40, None),
        (0x47, None),
        (0x4A, None),
        (0x09, None),
        (0xCC, None),
    ] {
        assert_eq!(function(code), (expected, false, false), "{code:02X}h");
    }
    assert_eq!(function(0x6D), (Some(Function::Srd), true, false));
    assert_eq!(function(0x5D), (Some(Function::Srd), false, true));
    assert_eq!(function(0x7D), (Some(Function::Srd), true, true));
}

proptest! {
        /// A telegram after 33 bit times of silence is found, regardless of preceding noise and pauses.
    #[test]
    fn telegram_after_noise_is_found(
        noise in prop::collection::vec((prop::option::weighted(0.9, any::<u8>()), 0..40u32), 0..300),
        data in prop::collection::vec(any::<u8>(), 0..=244),
    ) {
        let mut receiver = Receiver::new();
        for (byte, silence_bits) in noise {
            let character = byte.map_or(Character::Damaged, Character::Byte);
            let _ = receiver.push(character, silence_bits);
        }
        let mut bytes = [0; MAX_TELEGRAM_LEN];
        let len = crate::telegram::write_sd2(&mut bytes, [7, 2, 0x6D], Some([60, 62]), [&data, &[]]);
        for (at, byte) in bytes[..len].iter().enumerate() {
            let found = receiver.push(Character::Byte(*byte), if at == 0 { SYNC_BITS } else { 0 });
            if at + 1 < len {
                prop_assert_eq!(found, None);
            } else {
                let telegram = found.unwrap();
                prop_assert_eq!((telegram.dsap, telegram.ssap, telegram.data), (Some(60), Some(62), &data[..]));
            }
        }
    }
}
