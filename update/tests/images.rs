//! Signed images, and everything that is not one.
#![cfg(feature = "sign")]

use wsg_update::sign::{SigningKey, file};
use wsg_update::{Check, Keys, Manifest, Refusal, Rules, SLOT_LEN, Target, Trust, Version};

const TARGET: Target = Target::of("pico");

fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

fn public(seed: u8) -> [u8; 32] {
    key(seed).verifying_key().to_bytes()
}

fn rules(counter: u32) -> Rules {
    Rules { target: TARGET, keys: Keys { first: public(1), second: public(2) }, counter }
}

fn manifest(counter: u32) -> Manifest {
    Manifest { target: TARGET, version: Version([1, 2, 3]), length: 0, counter, successor: None }
}

fn program(len: usize) -> Vec<u8> {
    (0..len).map(|at| (at * 7 % 251) as u8).collect()
}

fn checked(slot: &[u8], rules: Rules) -> Result<Manifest, Refusal> {
    Check::whole(&mut &*slot, rules)
}

#[test]
fn image_of_either_key_is_accepted_at_every_length_and_no_other_key() {
    // Around a block of the hash, and up to the slot.
    for len in (32..300).chain([SLOT_LEN as usize - 128]) {
        for seed in [1, 2] {
            let mut slot = file(&program(len), manifest(5), &key(seed)).unwrap();
            let expected = Manifest { length: (len.next_multiple_of(8) + 64) as u32, ..manifest(5) };
            slot.resize(SLOT_LEN as usize, 0xFF);
            assert_eq!(checked(&slot, rules(5)), Ok(expected), "{len} bytes, key {seed}");
        }
    }
    let foreign = file(&program(100), manifest(5), &key(3)).unwrap();
    assert_eq!(checked(&foreign, rules(5)), Err(Refusal::WrongSignature));
    assert_eq!(file(&program(SLOT_LEN as usize - 127), manifest(5), &key(1)), Err(Refusal::TooLong));
    assert_eq!(file(&program(24), manifest(5), &key(1)), Err(Refusal::NoImage));
}

#[test]
fn test_keys_are_those_of_their_private_keys() {
    assert_eq!(Keys::TEST, rules(0).keys);
}

#[test]
fn each_wrong_image_is_refused_by_name() {
    let signed = |manifest: Manifest| file(&program(100), manifest, &key(2)).unwrap();
    let good = signed(manifest(5));
    let mut long = good.clone();
    long[0x1C..0x20].copy_from_slice(&(SLOT_LEN - 56).to_le_bytes());
    let mut shifted = good.clone();
    shifted.swap(0, 1);
    let other = Manifest { target: Target::of("b-l475e-iot01a"), ..manifest(5) };
    let successor = Manifest { successor: Some(public(3)), ..manifest(5) };
    let cases = [
        (vec![0xFF; 4096], 5, Refusal::NoImage),
        (vec![0; 4096], 5, Refusal::NoImage),
        (program(4096), 5, Refusal::NoImage),
        (good[..good.len() - 1].to_vec(), 5, Refusal::Unreadable),
        (long, 5, Refusal::TooLong),
        (signed(other), 5, Refusal::WrongBoard),
        (good.clone(), 6, Refusal::LowerCounter),
        (shifted, 5, Refusal::WrongSignature),
        (signed(successor), 5, Refusal::WrongSuccessor),
    ];
    for (slot, counter, refusal) in cases {
        assert_eq!(checked(&slot, rules(counter)), Err(refusal));
    }
    assert_eq!(
        checked(&file(&program(100), successor, &key(1)).unwrap(), rules(5)).unwrap().successor,
        Some(public(3))
    );
}

#[test]
fn no_image_with_a_changed_bit_or_byte_is_accepted() {
    let good = file(&program(200), manifest(5), &key(2)).unwrap();
    for bit in 0..good.len() * 8 {
        let mut changed = good.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        assert!(checked(&changed, rules(5)).is_err(), "bit {bit}");
    }
    for len in 0..good.len() {
        assert!(checked(&good[..len], rules(5)).is_err(), "{len} bytes");
    }
}

/// Its manifest reads with another counter at the second read.
struct Changing(Vec<u8>, u32);

impl wsg_update::SlotReader for Changing {
    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), wsg_update::Unreadable> {
        (&self.0[..]).read(offset, bytes)?;
        if offset == self.1 && bytes.len() == Manifest::LEN {
            bytes[16] = 9;
        }
        Ok(())
    }
}

#[test]
fn returned_manifest_is_the_signed_one_though_the_flash_reads_differently() {
    let good = file(&program(104), manifest(5), &key(2)).unwrap();
    let mut slot = Changing(good, 104);
    let mut check = Check::begin(&mut slot, rules(5)).unwrap();
    assert_eq!(check.manifest().counter, 9);
    let result = loop {
        match check.step(&mut slot) {
            Ok(None) => {}
            end => break end,
        }
    };
    assert_eq!(result, Err(Refusal::WrongSignature));
}

#[test]
fn successor_replaces_the_second_key_and_the_counter_never_falls() {
    let mut trust = Trust::default();
    assert_eq!(trust.keys(rules(0).keys), rules(0).keys);
    let named = Manifest { successor: Some(public(3)), ..manifest(7) };
    for (image, counter, second) in [(manifest(5), 5, 2), (named, 7, 3), (manifest(6), 7, 3)] {
        trust = trust.after(&image);
        assert_eq!((trust.counter, trust.keys(rules(0).keys).second), (counter, public(second)));
        assert_eq!(trust.keys(rules(0).keys).first, public(1));
        assert_eq!(Trust::decode(1, &trust.encode()), Some(trust));
    }
    let keys = trust.keys(rules(0).keys);
    let before = file(&program(100), manifest(7), &key(2)).unwrap();
    assert_eq!(checked(&before, Rules { keys, ..rules(7) }), Err(Refusal::WrongSignature));
    let after = file(&program(100), manifest(7), &key(3)).unwrap();
    assert!(checked(&after, Rules { keys, ..rules(7) }).is_ok());
}
