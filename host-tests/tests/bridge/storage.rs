//! Tests of the settings' store on a flash that may lose power at any time.

use std::collections::VecDeque;

use host_tests::chance::Chance;
use host_tests::flash_model::{Fault, FlashModel, PAGE_LEN, Tear};
use proptest::prelude::*;
use wsg_bridge_fw::storage::{
    BeginError, FlashError, LoadError, NoFlash, NorFlash, Page, Progress, SaveError, Store,
};
use wsg_protocol::Instant;

const MAX_LEN: usize = 200;
type Settings = Store<MAX_LEN>;

/// Version and payload of a save.
type Saved = (u16, Vec<u8>);

/// Returns settings that differ for each number.
fn settings(number: u32, len: usize) -> Saved {
    let mut chance = Chance::new(number.into());
    (number as u16, (0..len).map(|_| chance.number() as u8).collect())
}

fn load(store: &mut Settings, flash: &FlashModel) -> Result<Saved, LoadError> {
    store.load(flash).map(|record| (record.version, record.payload.to_vec()))
}

/// Restarts the program. Returns its store, and the loaded settings.
fn boot(flash: &mut FlashModel) -> (Settings, Result<Saved, LoadError>) {
    flash.reboot();
    let mut store = Settings::new();
    let found = load(&mut store, flash);
    (store, found)
}

/// Polls until the save has ended. Returns [`None`] if the power failed.
fn finish(store: &mut Settings, flash: &mut FlashModel) -> Option<Result<(), SaveError>> {
    for now in 0..2_000 {
        let before = flash.operations;
        let progress = store.poll(flash, Instant::from_millis(now));
        assert!(flash.operations <= before + 1, "at most one operation per turn");
        match progress {
            _ if flash.is_off() => return None,
            Progress::Saving => assert!(store.is_saving()),
            Progress::Saved => return Some(Ok(())),
            Progress::Failed(error) => return Some(Err(error)),
            Progress::Idle => panic!("the end of the save was not reported"),
        }
    }
    panic!("the save did not end");
}

fn save(
    store: &mut Settings,
    flash: &mut FlashModel,
    (version, payload): &Saved,
) -> Option<Result<(), SaveError>> {
    assert_eq!(store.begin(*version, payload), Ok(()));
    let end = finish(store, flash);
    if !flash.is_off() {
        assert_eq!(store.poll(flash, Instant::from_millis(0)), Progress::Idle);
    }
    end
}

/// Returns a flash after these saves, and the last one.
fn history(saves: u32, len: usize) -> (FlashModel, Result<Saved, LoadError>) {
    let mut flash = FlashModel::new();
    let (mut store, mut last) = boot(&mut flash);
    for number in 0..saves {
        let saved = settings(number, len);
        assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
        last = Ok(saved);
    }
    (flash, last)
}

#[test]
fn last_save_is_loaded_with_any_length_and_version() {
    let mut flash = FlashModel::new();
    let (mut store, found) = boot(&mut flash);
    assert_eq!(found, Err(LoadError::Empty));
    for len in 0..=MAX_LEN {
        let saved = settings(u32::from(u16::MAX) - len as u32, len);
        flash.busy_polls = len as u32 % 3;
        assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
        assert_eq!(load(&mut store, &flash), Ok(saved.clone()), "in the same run");
        assert_eq!(boot(&mut flash).1, Ok(saved), "in the next run");
    }
}

#[test]
fn payload_is_copied_at_the_start_of_a_save() {
    let mut flash = FlashModel::new();
    let (mut store, _) = boot(&mut flash);
    let mut payload = [7; 20];
    assert_eq!(store.begin(1, &payload), Ok(()));
    payload.fill(8);
    assert_eq!(finish(&mut store, &mut flash), Some(Ok(())));
    assert_eq!(boot(&mut flash).1, Ok((1, vec![7; 20])));
}

#[test]
fn record_has_the_documented_format() {
    let mut flash = FlashModel::new();
    let (mut store, _) = boot(&mut flash);
    save(&mut store, &mut flash, &(0x1234, b"123456789".to_vec()));
    let bytes: Vec<u8> =
        (0..5).flat_map(|index| flash.read(Page::First, index).unwrap_or(0).to_le_bytes()).collect();
    let crc = crc32(&bytes[..24]);
    assert_eq!(bytes[..8], [0xA5, 9, 0, 0x34, 0x12, 1, 0, 0]);
    assert_eq!(bytes[8..24], *b"123456789\xFF\xFF\xFF\xFF\xFF\xFF\xFF");
    assert_eq!(bytes[24..28], crc.to_le_bytes());
    assert_eq!(bytes[28..32], (!crc).to_le_bytes());
    assert_eq!(bytes[32..], [0xFF; 8], "no data after the record");
    assert_eq!(crc32(b"123456789"), 0xCBF4_3926, "the check value of CRC-32");
}

/// Computes CRC-32 according to its definition.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| (crc >> 1) ^ if crc & 1 == 1 { 0xEDB8_8320 } else { 0 })
    })
}

#[test]
fn save_is_refused_before_a_load_during_a_save_and_if_too_long() {
    let mut flash = FlashModel::new();
    let mut store = Settings::new();
    assert_eq!(store.begin(1, &[]), Err(BeginError::NotLoaded));
    assert_eq!(store.poll(&mut flash, Instant::from_millis(0)), Progress::Idle);
    let _ = load(&mut store, &flash);
    assert_eq!(store.begin(1, &[0; MAX_LEN + 1]), Err(BeginError::TooLong));
    assert!(!store.is_saving());
    assert_eq!(store.begin(1, &[1]), Ok(()));
    assert_eq!(store.begin(2, &[2]), Err(BeginError::Saving));
    assert_eq!(load(&mut store, &flash), Err(LoadError::Saving));
    assert_eq!(finish(&mut store, &mut flash), Some(Ok(())));
    assert_eq!(boot(&mut flash).1, Ok((1, vec![1])));
}

#[test]
fn saving_unchanged_settings_writes_nothing() {
    let (mut flash, last) = history(3, 30);
    let (mut store, _) = boot(&mut flash);
    let Ok(saved) = last else { panic!("three saves were made") };
    let before = flash.operations;
    assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
    assert_eq!(flash.operations, before);
    // Any difference leads to a write.
    for changed in [(saved.0 + 1, saved.1.clone()), (saved.0, saved.1[1..].to_vec())] {
        assert_eq!(save(&mut store, &mut flash, &changed), Some(Ok(())));
        assert_eq!(boot(&mut flash).1, Ok(changed));
    }
    // So does an unreadable record.
    let (mut flash, _) = history(3, 30);
    let (mut store, _) = boot(&mut flash);
    flash.set(Page::First, 2 * 6 + 5, None);
    assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
    assert_eq!(boot(&mut flash).1, Ok(saved));
}

/// Returns the operations of the next save.
fn operations_of_next(flash: &FlashModel, next: &Saved) -> std::ops::Range<u32> {
    let mut flash = flash.clone();
    let (mut store, _) = boot(&mut flash);
    let begin = flash.operations;
    assert_eq!(save(&mut store, &mut flash, next), Some(Ok(())));
    begin..flash.operations
}

/// Returns the flash after a save with a power cut in this operation.
fn cut(flash: &FlashModel, next: &Saved, at: u32, tear: Tear) -> FlashModel {
    let mut flash = flash.clone();
    let (mut store, _) = boot(&mut flash);
    flash.cut = Some((at, tear));
    assert_eq!(save(&mut store, &mut flash, next), None);
    flash
}

/// Asserts the permitted results after a power cut in operation `at` of a save.
fn assert_old_or_new(
    found: &Result<Saved, LoadError>,
    old: &Result<Saved, LoadError>,
    new: &Saved,
    is_last: bool,
    tear: Tear,
) {
    let (is_new, is_old) = (found.as_ref() == Ok(new), found == old);
    match tear {
        Tear::Complete if is_last => assert!(is_new, "{found:?}"),
        Tear::Changing | Tear::Mixed if is_last => assert!(is_new || is_old, "{found:?}"),
        _ => assert!(is_old, "{found:?}"),
    }
}

#[test]
fn power_cut_leaves_old_or_new_record_and_the_next_save_works() {
    // A page holds 9, 15 or 36 records. The range covers the first save to the second erase of the first page.
    for (len, saves) in [(200, 0..20), (120, 13..32), (40, 34..39)] {
        for count in saves {
            let (flash, old) = history(count, len);
            let new = settings(1_000, len);
            let operations = operations_of_next(&flash, &new);
            for (at, tear) in operations.clone().flat_map(|at| Tear::ALL.map(|tear| (at, tear))) {
                let mut flash = cut(&flash, &new, at, tear);
                let (mut store, found) = boot(&mut flash);
                assert_old_or_new(&found, &old, &new, at + 1 == operations.end, tear);
                let next = settings(1_001, len);
                assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())), "{count} {at} {tear:?}");
                assert_eq!(boot(&mut flash).1, Ok(next), "{count} {at} {tear:?}");
                // A double word that visibly is not erased is not programmed again.
                let is_seen = !matches!(tear, Tear::SeemsErased | Tear::Changing | Tear::Mixed);
                assert!(flash.refused == 0 || !is_seen, "{count} {at} {tear:?}");
            }
        }
    }
}

/// The interrupted record may read complete later, although the settings to save are those that were loaded.
#[test]
fn old_settings_saved_again_after_a_power_cut_stay() {
    let (flash, old) = history(3, 40);
    let Ok(old) = old else { panic!("three saves were made") };
    let new = settings(1_000, 40);
    for at in operations_of_next(&flash, &new) {
        for tear in Tear::ALL {
            let mut flash = cut(&flash, &new, at, tear);
            let mut store = boot(&mut flash).0;
            assert_eq!(save(&mut store, &mut flash, &old), Some(Ok(())));
            for _ in 0..30 {
                assert_eq!(boot(&mut flash).1, Ok(old.clone()), "{at} {tear:?}");
            }
        }
    }
}

/// A bridge with damaged settings moves nothing. A power cut in the save that ends this must not turn them into none.
#[test]
fn damaged_settings_stay_damaged_until_a_save_has_completed() {
    let (flash, _) = history(1, 40);
    for (n, value) in (0..6).flat_map(|n| [(n, None), (n, Some(0)), (n, Some(0xC8A5))]) {
        let mut flash = flash.clone();
        flash.set(Page::First, n, value);
        let (mut store, damaged) = boot(&mut flash);
        assert_eq!(damaged, Err(LoadError::Damaged), "{n} {value:X?}");
        let new = settings(1_000, 40);
        let operations = operations_of_next(&flash, &new);
        for (at, tear) in operations.clone().flat_map(|at| Tear::ALL.map(|tear| (at, tear))) {
            let mut flash = cut(&flash, &new, at, tear);
            let found = boot(&mut flash).1;
            assert_old_or_new(&found, &damaged, &new, at + 1 == operations.end, tear);
        }
        assert_eq!(save(&mut store, &mut flash, &new), Some(Ok(())));
        assert_eq!(boot(&mut flash).1, Ok(new));
    }
    // The last double word of the only record: this is what an interrupted first save leaves.
    let mut flash = flash.clone();
    flash.set(Page::First, 6, None);
    assert_eq!(boot(&mut flash).1, Err(LoadError::Empty));
    // Other data is not from a first save.
    for index in [PAGE_LEN - 1, 30] {
        let mut flash = FlashModel::new();
        flash.set(Page::First, index, Some(0x5555));
        assert_eq!(boot(&mut flash).1, Err(LoadError::Damaged), "{index}");
    }
}

#[test]
fn second_power_cut_during_the_repair_does_no_further_harm() {
    let len = 40;
    for count in [0, 35, 36, 72] {
        let (flash, old) = history(count, len);
        let (first, second) = (settings(1_000, len), settings(1_001, len));
        let operations = operations_of_next(&flash, &first);
        for (at, tear) in operations.flat_map(|at| Tear::ALL.map(|tear| (at, tear))) {
            // A record that reads differently each time may be found as either. The next save then decides.
            if tear == Tear::Changing || tear == Tear::Mixed {
                continue;
            }
            let mut flash = cut(&flash, &first, at, tear);
            let between = boot(&mut flash).1;
            assert!(between == old || between.as_ref() == Ok(&first), "{between:?}");
            let operations = operations_of_next(&flash, &second);
            for (at, tear) in operations.clone().flat_map(|at| Tear::ALL.map(|tear| (at, tear))) {
                let mut flash = cut(&flash, &second, at, tear);
                let (mut store, found) = boot(&mut flash);
                assert_old_or_new(&found, &between, &second, at + 1 == operations.end, tear);
                let next = settings(1_002, len);
                assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())));
                assert_eq!(boot(&mut flash).1, Ok(next));
            }
        }
    }
}

#[test]
fn unprogrammable_double_word_moves_record_to_the_other_page() {
    for count in 1..20 {
        let (flash, _) = history(count, MAX_LEN);
        let new = settings(1_000, MAX_LEN);
        for index in 0..PAGE_LEN {
            for page in Page::ALL {
                let mut flash = flash.clone();
                let (mut store, old) = boot(&mut flash);
                flash.fault = Some(Fault::Unprogrammable(page, index));
                let end = save(&mut store, &mut flash, &new);
                let found = boot(&mut flash).1;
                match end {
                    Some(Ok(())) => assert_eq!(found, Ok(new.clone())),
                    // The target page is the broken one.
                    Some(Err(error)) => {
                        assert_eq!((error, &found), (SaveError::Flash(FlashError::Failed), &old));
                        assert!(index < 27 && count % 9 == 0, "{count} {index}");
                    }
                    None => panic!("the power does not fail"),
                }
            }
        }
    }
}

#[test]
fn failed_save_reports_the_reason_and_leaves_the_old_record() {
    let everywhere =
        [(Fault::Protected, SaveError::Flash(FlashError::Protected)), (Fault::Stuck, SaveError::TimedOut)];
    for (fault, error) in everywhere {
        for count in 0..20 {
            let (mut flash, _) = history(count, MAX_LEN);
            let (mut store, old) = boot(&mut flash);
            flash.fault = Some(fault);
            assert_eq!(save(&mut store, &mut flash, &settings(1_000, MAX_LEN)), Some(Err(error)));
            flash.fault = None;
            let (mut store, found) = boot(&mut flash);
            assert_eq!(found, old);
            let next = settings(1_001, MAX_LEN);
            assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())), "works again");
            assert_eq!(boot(&mut flash).1, Ok(next));
        }
    }
    // A worn page does not read erased.
    let (mut flash, old) = history(9, MAX_LEN);
    let (mut store, _) = boot(&mut flash);
    flash.fault = Some(Fault::Worn(PAGE_LEN - 1));
    let next = settings(1_000, MAX_LEN);
    assert_eq!(save(&mut store, &mut flash, &next), Some(Err(SaveError::NotErased)));
    assert_eq!(load(&mut store, &flash), old);
    flash.fault = None;
    assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())), "the same store continues");
    assert_eq!(boot(&mut flash).1, Ok(next));
}

#[test]
fn each_failure_of_the_flash_has_its_own_message() {
    let words = [FlashError::Busy, FlashError::Protected, FlashError::NotErased, FlashError::Failed]
        .map(|error| error.to_string());
    for (words, part) in words.iter().zip(["busy", "protected", "already programmed", "failed"]) {
        assert!(words.contains(part), "{words}");
    }
}

#[test]
fn second_page_replaces_worn_first_page_if_nothing_is_stored() {
    let mut flash = FlashModel::new();
    let (mut store, _) = boot(&mut flash);
    flash.fault = Some(Fault::Unprogrammable(Page::First, 3));
    let saved = settings(1, MAX_LEN);
    assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
    assert_eq!((boot(&mut flash).1, flash.erases), (Ok(saved), [1, 1]));
}

#[test]
fn save_times_out_after_200_ms() {
    let (mut flash, _) = history(3, MAX_LEN);
    let (mut store, _) = boot(&mut flash);
    flash.fault = Some(Fault::Stuck);
    let begin = u32::MAX - 20;
    assert_eq!(store.begin(1, &[1]), Ok(()));
    let ends = (0..).find_map(|ms| match store.poll(&mut flash, Instant::from_millis(begin).plus(ms)) {
        Progress::Saving => None,
        progress => Some((ms, progress)),
    });
    assert_eq!(ends, Some((201, Progress::Failed(SaveError::TimedOut))));
    // A busy flash is not read either, because that would stall the core.
    let next = settings(4, MAX_LEN);
    assert_eq!(save(&mut store, &mut flash, &next), Some(Err(SaveError::TimedOut)));
    flash.fault = None;
    assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())));
    assert_eq!(boot(&mut flash).1, Ok(next));
}

#[test]
fn flash_that_ignores_writes_is_no_flash() {
    for (reads, found, error) in [
        (0, LoadError::NoFlash, SaveError::NotErased),
        (u64::MAX, LoadError::Empty, SaveError::NotWritten),
        (0x5555, LoadError::Damaged, SaveError::NotErased),
    ] {
        let mut flash = FlashModel::new();
        flash.fault = Some(Fault::Swallows(reads));
        let (mut store, loaded) = boot(&mut flash);
        assert_eq!(loaded, Err(found));
        for number in 0..3 {
            let before = flash.operations;
            assert_eq!(save(&mut store, &mut flash, &settings(number, MAX_LEN)), Some(Err(error)));
            assert!(flash.operations - before <= 2 * 28, "no endless attempts");
        }
        assert_eq!(load(&mut store, &flash), Err(found));
    }
}

#[test]
fn board_without_flash_loads_nothing_and_every_operation_fails() {
    assert_eq!(Settings::new().load(&NoFlash).unwrap_err(), LoadError::NoFlash);
    let failed = FlashError::Failed;
    for page in Page::ALL {
        assert_eq!(NoFlash.start_erase(page), Err(failed));
        assert_eq!(NoFlash.start_program(page, 0, 1), Err(failed));
        assert_eq!(NoFlash.poll(), Err(failed.into()));
    }
}

#[test]
fn damaged_record_does_not_affect_others() {
    let (flash, last) = history(6, MAX_LEN);
    let before = settings(4, MAX_LEN);
    for record in 0..6 {
        for (n, value) in
            (0..27).flat_map(|n| [(n, None), (n, Some(0)), (n, Some(u64::MAX)), (n, Some(0xC8A5))])
        {
            let mut flash = flash.clone();
            flash.set(Page::First, record * 27 + n, value);
            let (mut store, found) = boot(&mut flash);
            if record < 5 {
                assert_eq!(found, last, "{record} {n} {value:X?}");
            } else {
                assert_eq!(found, Ok(before.clone()), "{n} {value:X?}");
            }
            let next = settings(1_000, MAX_LEN);
            assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())));
            assert_eq!(boot(&mut flash).1, Ok(next));
        }
    }
}

#[test]
fn record_with_unstable_reads_loads_completely_or_not_at_all() {
    let (flash, last) = history(6, MAX_LEN);
    let before = Ok(settings(4, MAX_LEN));
    for n in 0..27 {
        let mut flash = flash.clone();
        flash.set_changing(Page::First, 5 * 27 + n, u64::MAX);
        let mut store = Settings::new();
        for _ in 0..30 {
            let found = load(&mut store, &flash);
            assert!(found == last || found == before, "{n} {found:?}");
        }
        let next = settings(1_000, MAX_LEN);
        assert_eq!(save(&mut store, &mut flash, &next), Some(Ok(())));
        for _ in 0..30 {
            assert_eq!(boot(&mut flash).1, Ok(next.clone()));
        }
    }
}

#[test]
fn unstable_first_double_word_never_mixes_two_records() {
    // One record is the start of the other, whose payload contains the first one's last double word.
    let begin = b"8 bytes.";
    let first = |payload: &[u8]| {
        let mut flash = FlashModel::new();
        let (mut store, _) = boot(&mut flash);
        assert_eq!(save(&mut store, &mut flash, &(1, payload.to_vec())), Some(Ok(())));
        (flash.read(Page::First, 0).unwrap(), flash)
    };
    let (short_first, flash) = first(begin);
    let end = flash.read(Page::First, 2).unwrap().to_le_bytes();
    let (short, long) = ((1, begin.to_vec()), (1, [&begin[..], &end[..]].concat()));
    let (_, mut flash) = first(&long.1);
    flash.set_changing(Page::First, 0, short_first);
    let mut found = [0; 4];
    for _ in 0..200 {
        let loaded = boot(&mut flash).1;
        let which = [Ok(short.clone()), Ok(long.clone()), Err(LoadError::Damaged), Err(LoadError::Empty)];
        let which = which.iter().position(|it| *it == loaded);
        found[which.unwrap_or_else(|| panic!("{loaded:X?}"))] += 1;
    }
    assert!(found[0] > 0 && found[1] > 0, "{found:?}");
}

#[test]
fn payload_that_looks_like_records_is_not_parsed() {
    // Image of a record with a higher number, after an unrelated double word.
    let (flash, _) = history(8, 100);
    let image = (7 * 15..8 * 15).flat_map(|n| flash.read(Page::First, n).unwrap_or(0).to_le_bytes());
    let image: Vec<u8> = [0; 8].into_iter().chain(image).collect();
    let mut flash = FlashModel::new();
    let (mut store, _) = boot(&mut flash);
    let old = settings(1, 8);
    assert_eq!(save(&mut store, &mut flash, &old), Some(Ok(())));
    let looks = (2, image);
    assert_eq!(save(&mut store, &mut flash, &looks), Some(Ok(())));
    assert_eq!(boot(&mut flash).1, Ok(looks));
    for damaged in [3 + 17, 3 + 1] {
        let mut flash = flash.clone();
        flash.set(Page::First, damaged, None);
        assert_eq!(boot(&mut flash).1, Ok(old.clone()), "the rest of a damaged record is not parsed");
    }
}

#[test]
fn record_too_long_for_this_program_is_reported_and_replaced() {
    let (mut flash, _) = history(4, MAX_LEN);
    let mut small = Store::<199>::new();
    assert_eq!(small.load(&flash), Err(LoadError::TooLong { version: 3, len: 200 }));
    assert_eq!(small.begin(9, &[5; 199]), Ok(()));
    while small.is_saving() {
        let progress = small.poll(&mut flash, Instant::from_millis(0));
        assert!(matches!(progress, Progress::Saving | Progress::Saved), "{progress:?}");
    }
    assert_eq!(boot(&mut flash).1, Ok((9, vec![5; 199])));
}

#[test]
fn exhausted_save_numbers_are_reported() {
    let (mut flash, _) = history(1, 8);
    for (number, begin) in [(0xFF_FFFE, Ok(())), (0xFF_FFFF, Err(BeginError::WornOut))] {
        // The same record with a higher number.
        let bits = flash.read(Page::First, 0).unwrap_or(0) & 0xFF_FFFF_FFFF | number << 40;
        let payload = flash.read(Page::First, 1).unwrap_or(0);
        let crc = crc32(&[bits.to_le_bytes(), payload.to_le_bytes()].concat());
        flash.set(Page::First, 0, Some(bits));
        flash.set(Page::First, 2, Some(u64::from(crc) | u64::from(!crc) << 32));
        let mut flash = flash.clone();
        let (mut store, found) = boot(&mut flash);
        assert_eq!(found, Ok(settings(0, 8)));
        assert_eq!(store.begin(1, &[1]), begin);
        if begin.is_ok() {
            assert_eq!(finish(&mut store, &mut flash), Some(Ok(())));
            assert_eq!(boot(&mut flash).1, Ok((1, vec![1])));
        }
    }
}

#[test]
fn damaged_record_does_not_use_up_the_save_numbers() {
    // The first double word of a record with the highest number, without the rest.
    let mut flash = FlashModel::new();
    flash.set(Page::First, 0, Some(0xFF_FFFF << 40 | 8 << 8 | 0xA5));
    let (mut store, found) = boot(&mut flash);
    assert_eq!(found, Err(LoadError::Empty), "an interrupted first save");
    for number in 0..3 {
        let saved = settings(number, 8);
        assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
        assert_eq!(boot(&mut flash).1, Ok(saved));
    }
}

/// Table in the documentation of `storage`: a page endures 10 000 erases.
#[test]
fn wear_is_shared_by_both_pages_as_documented() {
    const ENDURED: u32 = 10_000;
    for (len, per_page) in [(120, 15), (200, 9)] {
        let saves = 20 * per_page;
        let (flash, _) = history(saves, len);
        assert_eq!(flash.erases, [10, 10], "{len} bytes");
        assert_eq!(2 * ENDURED * per_page, if len == 120 { 300_000 } else { 180_000 });
    }
}

/// Operation on a store, for the comparison with a plain model.
#[derive(Clone, Debug)]
enum Op {
    Save(u32, usize),
    CutSave(u32, usize, u32, Tear),
    FailedSave(u32, usize, Page, usize),
    Reboot,
    Reload,
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    // Few settings, so that the same are saved again.
    let number = 0..3u32;
    let len = prop_oneof![4 => Just(MAX_LEN), 1 => 0..=MAX_LEN];
    let tear = proptest::sample::select(Tear::ALL.to_vec());
    let page = proptest::sample::select(Page::ALL.to_vec());
    let op = prop_oneof![
        4 => (number.clone(), len.clone()).prop_map(|(n, len)| Op::Save(n, len)),
        4 => (number.clone(), len.clone(), 0..60u32, tear).prop_map(|(n, len, at, tear)| Op::CutSave(n, len, at, tear)),
        1 => (number, len, page, 0..PAGE_LEN).prop_map(|(n, len, page, at)| Op::FailedSave(n, len, page, at)),
        1 => Just(Op::Reboot),
        1 => Just(Op::Reload),
    ];
    proptest::collection::vec(op, 1..40)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1_500, failure_persistence: None, ..ProptestConfig::default() })]

    /// The model is the last save. While a double word reads differently each time, an interrupted save is permitted as well.
    #[test]
    fn last_save_is_loaded_after_any_sequence_of_operations(ops in ops(), busy_polls in 0..3u32) {
        let mut flash = FlashModel::new();
        flash.busy_polls = busy_polls;
        let mut store = boot(&mut flash).0;
        let mut last: VecDeque<Option<Saved>> = VecDeque::from([None]);
        for op in ops {
            match op {
                Op::Save(number, len) => {
                    let saved = settings(number, len);
                    prop_assert_eq!(save(&mut store, &mut flash, &saved), Some(Ok(())));
                    last = VecDeque::from([Some(saved)]);
                }
                Op::CutSave(number, len, at, tear) => {
                    let saved = settings(number, len);
                    flash.cut = Some((flash.operations + at, tear));
                    if save(&mut store, &mut flash, &saved).is_some() {
                        last.clear();
                    }
                    last.push_front(Some(saved));
                    store = boot(&mut flash).0;
                }
                Op::FailedSave(number, len, page, index) => {
                    let saved = settings(number, len);
                    flash.fault = Some(Fault::Unprogrammable(page, index));
                    if save(&mut store, &mut flash, &saved) == Some(Ok(())) {
                        last = VecDeque::from([Some(saved)]);
                    }
                    flash.fault = None;
                }
                Op::Reboot => store = boot(&mut flash).0,
                Op::Reload => {}
            }
            let found = load(&mut store, &flash);
            let is_possible = matches!(found, Ok(_) | Err(LoadError::Empty | LoadError::Damaged));
            prop_assert!(is_possible, "{:?}", found);
            let found = found.ok();
            prop_assert!(last.contains(&found), "{:?}", found);
        }
    }
}
