//! The settings store on pages with arbitrary content.

use wsg_bridge_fw::storage::{NorFlash, Page, Progress, Store};
use wsg_protocol::Instant;

use super::input::Input;
use crate::flash_model::{FlashModel, PAGE_LEN, Tear};

const MAX_LEN: usize = 200;

/// Limits the number of slow saves.
const MAX_SAVES: usize = 8;

/// Each op is a byte with parameter bytes: contents of pages, saves, power failures.
pub fn storage(data: &[u8]) {
    let mut input = Input::new(data);
    let mut flash = FlashModel::new();
    let mut may_change = false;
    let mut saves = 0;
    while !input.is_empty() && saves < MAX_SAVES {
        let op = input.byte();
        let page = Page::ALL[usize::from(op >> 7)];
        match op & 7 {
            // The store never writes beside double words whose reads vary, so no record follows one.
            0..=3 if may_change => {}
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

/// Checks that loaded settings have a valid CRC.
fn loads_what_is_there(flash: &FlashModel) {
    let mut store = Store::<MAX_LEN>::new();
    let Ok(found) = store.load(flash) else { return };
    let is_there = |page, index| {
        let Ok(first) = flash.read(page, index) else { return false };
        let expected = record(found.version, 0, found.payload);
        // Excludes the number of the save, which cannot be known.
        let expected = with_number(&expected, first >> 40);
        (index..).zip(&expected).all(|(index, double_word)| flash.read(page, index) == Ok(*double_word))
    };
    let is_there = Page::ALL.into_iter().any(|page| (0..PAGE_LEN).any(|index| is_there(page, index)));
    assert!(is_there, "no such record: {found:X?}");
}

/// Checks that a save succeeds on any content and can be loaded.
fn save(flash: &mut FlashModel, version: u16, payload: &[u8], cut: Option<(u32, Tear)>) {
    let mut store = Store::<MAX_LEN>::new();
    let _ = store.load(flash);
    flash.cut = cut.map(|(after, tear)| (flash.operations + after, tear));
    assert_eq!(store.begin(version, payload), Ok(()));
    // An erase and the longest record, in both pages, and their start and end.
    for _ in 0..70 {
        match store.poll(flash, Instant::from_millis(0)) {
            Progress::Saving if flash.is_off() => break,
            Progress::Saving => {}
            Progress::Saved => break,
            Progress::Idle | Progress::Failed(_) => unreachable!("the flash has no fault"),
        }
    }
    let was_cut = store.is_saving();
    assert!(!was_cut || cut.is_some(), "a save completes without a power failure");
    flash.reboot();
    let mut store = Store::<MAX_LEN>::new();
    let found = store.load(flash).map(|record| (record.version, record.payload));
    assert!(
        was_cut || found == Ok((version, payload)),
        "the loaded settings differ from the saved ones: {found:X?}"
    );
}

/// Returns the double words of a record per the format.
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

/// Returns the record with this number and a matching CRC.
fn with_number(record: &[u64], number: u64) -> Vec<u64> {
    let mut record = record.to_vec();
    record[0] = record[0] & 0xFF_FFFF_FFFF | number << 40;
    let Some((trailer, covered)) = record.split_last_mut() else {
        unreachable!("a record has at least two double words")
    };
    let bytes = covered.iter().flat_map(|double_word| double_word.to_le_bytes());
    let crc: u32 = !bytes.fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    });
    *trailer = u64::from(crc) | u64::from(!crc) << 32;
    record
}
