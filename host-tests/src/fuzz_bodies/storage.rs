//! The store of settings on pages that hold anything.

use wsg_bridge_fw::storage::{NorFlash, Page, Progress, Store};
use wsg_protocol::Instant;

use super::input::Input;
use crate::flash_model::{FlashModel, PAGE_LEN, Tear};

const MAX_LEN: usize = 200;

/// Saves are slow beside everything else.
const MAX_SAVES: usize = 8;

/// Each op is a byte that says what, and bytes that say how: what pages hold, saves, power cuts.
pub fn storage(data: &[u8]) {
    let mut input = Input::new(data);
    let mut flash = FlashModel::new();
    let mut may_change = false;
    let mut saves = 0;
    while !input.is_empty() && saves < MAX_SAVES {
        let op = input.byte();
        let page = Page::ALL[usize::from(op >> 7)];
        match op & 7 {
            0 => {
                let index = usize::from(input.byte());
                for index in index..(index + usize::from(op >> 3 & 7) + 1).min(PAGE_LEN) {
                    flash.set(page, index, Some(u64::from_le_bytes(input.array())));
                }
            }
            1 => {
                let index = usize::from(input.byte());
                let len = usize::from(input.byte());
                let number = u16::from_le_bytes(input.array());
                let record = record(input.byte().into(), number, input.bytes(len));
                for (index, double_word) in (index..PAGE_LEN).zip(record) {
                    flash.set(page, index, Some(double_word));
                }
            }
            2 => flash.set(page, usize::from(input.byte()), None),
            3 => {
                let value = input.pick(&[0, u64::MAX, 0xA5, 0x00C8_A500_00C8_A5A5]);
                (0..PAGE_LEN).for_each(|index| flash.set(page, index, Some(value)));
            }
            how => {
                let cut = (how == 4).then(|| (u32::from(input.byte()), input.pick(&Tear::ALL)));
                may_change |= matches!(cut, Some((_, Tear::Changing | Tear::Mixed)));
                let version = input.byte().into();
                let len = usize::from(input.byte()).min(MAX_LEN);
                save(&mut flash, version, input.bytes(len), cut);
                saves += 1;
            }
        }
        if !may_change {
            loads_what_is_there(&flash);
        }
    }
}

/// What is loaded has a CRC that fits.
fn loads_what_is_there(flash: &FlashModel) {
    let mut store = Store::<MAX_LEN>::new();
    let Ok(found) = store.load(flash) else { return };
    let is_there = |page, index| {
        let Ok(first) = flash.read(page, index) else { return false };
        let expected = record(found.version, 0, found.payload);
        // All but the number of the save, which nothing else tells.
        let expected = with_number(&expected, first >> 40);
        (index..).zip(&expected).all(|(index, double_word)| flash.read(page, index) == Ok(*double_word))
    };
    let is_there = Page::ALL.into_iter().any(|page| (0..PAGE_LEN).any(|index| is_there(page, index)));
    assert!(is_there, "no such record: {found:X?}");
}

/// A save on whatever is there works, and is found.
fn save(flash: &mut FlashModel, version: u16, payload: &[u8], cut: Option<(u32, Tear)>) {
    let mut store = Store::<MAX_LEN>::new();
    let _ = store.load(flash);
    flash.cut = cut.map(|(after, tear)| (flash.operations + after, tear));
    assert_eq!(store.begin(version, payload), Ok(()));
    // An erase, the longest record, the same again in the other page, and what begins and ends them.
    for _ in 0..70 {
        match store.poll(flash, Instant::from_millis(0)) {
            Progress::Saving if flash.is_off() => break,
            Progress::Saving => {}
            Progress::Saved => break,
            Progress::Idle | Progress::Failed(_) => unreachable!("the flash has no fault"),
        }
    }
    let was_cut = store.is_saving();
    assert!(!was_cut || cut.is_some(), "a save ends");
    flash.reboot();
    let mut store = Store::<MAX_LEN>::new();
    let found = store.load(flash).map(|record| (record.version, record.payload));
    assert!(was_cut || found == Ok((version, payload)), "saved is not what is loaded: {found:X?}");
}

/// The double words of a record, as the format says.
fn record(version: u16, number: u16, payload: &[u8]) -> Vec<u64> {
    let first = 0xA5 | (payload.len() as u64) << 8 | u64::from(version) << 24;
    let padded = payload.chunks(8).map(|chunk| {
        let mut bytes = [0xFF; 8];
        bytes[..chunk.len()].copy_from_slice(chunk);
        u64::from_le_bytes(bytes)
    });
    let double_words: Vec<u64> = [first].into_iter().chain(padded).chain([0]).collect();
    with_number(&double_words, number.into())
}

/// The record with this number and the CRC that fits.
fn with_number(record: &[u64], number: u64) -> Vec<u64> {
    let mut record = record.to_vec();
    record[0] = record[0] & 0xFF_FFFF_FFFF | number << 40;
    let Some((trailer, covered)) = record.split_last_mut() else { unreachable!("it has two at the least") };
    let bytes = covered.iter().flat_map(|double_word| double_word.to_le_bytes());
    let crc: u32 = !bytes.fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    });
    *trailer = u64::from(crc) | u64::from(!crc) << 32;
    record
}
