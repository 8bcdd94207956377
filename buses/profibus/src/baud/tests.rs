//! Baud rate detection in virtual time.

use super::*;
use std::vec;
use std::vec::Vec;

static PORT: [Baud; 3] = [Baud::K9_6, Baud::K500, Baud::M1_5];

/// Polls every millisecond. Returns each change of rate with its time.
fn run(search: &mut BaudSearch, times_ms: core::ops::Range<u32>, telegrams: u32) -> Vec<(u32, Baud)> {
    times_ms.filter_map(|now_ms| Some((now_ms, search.poll(now_ms, telegrams)?))).collect()
}

#[test]
fn search_listens_for_the_gap_polling_time_of_an_idle_master() {
    let mut search = BaudSearch::new(&PORT, 0);
    assert_eq!(search.baud(), Some(Baud::K9_6));
    // 10 000 bit times and 100 ms: 1142, 120 and 107 ms.
    let expected = vec![(1_142, Baud::K500), (1_262, Baud::M1_5), (1_369, Baud::K9_6), (2_511, Baud::K500)];
    assert_eq!(run(&mut search, 0..2_600, 0), expected);
    assert!(!search.is_found());
}

#[test]
fn telegram_ends_the_search_until_five_seconds_without_one() {
    let mut search = BaudSearch::new(&PORT, 0);
    assert_eq!(run(&mut search, 0..1_200, 0), [(1_142, Baud::K500)]);
    assert_eq!(search.poll(1_200, 1), None);
    assert!(search.is_found());
    assert_eq!(run(&mut search, 1_200..4_000, 1), []);
    // Another telegram restarts the time.
    assert_eq!(search.poll(4_000, 2), None);
    assert_eq!(run(&mut search, 4_000..9_001, 2), [(9_000, Baud::M1_5)]);
    assert_eq!((search.is_found(), search.baud()), (false, Some(Baud::M1_5)));
    assert_eq!(run(&mut search, 9_001..9_108, 2), [(9_107, Baud::K9_6)], "the search continues");
}

#[test]
fn clock_and_telegram_counter_may_wrap() {
    let start = u32::MAX - 50;
    let mut search = BaudSearch::new(&[Baud::M12, Baud::M6], start);
    assert_eq!(search.poll(start.wrapping_add(100), 0), None);
    assert_eq!(search.poll(start.wrapping_add(101), 0), Some(Baud::M6));
    assert_eq!(search.poll(start.wrapping_add(102), u32::MAX), None);
    assert_eq!(search.poll(start.wrapping_add(103), 0), None);
    assert!(search.is_found());
}

#[test]
fn port_with_one_rate_or_none_never_changes_it() {
    let mut one = BaudSearch::new(&[Baud::K187_5], 0);
    assert_eq!(run(&mut one, 0..2_000, 0), []);
    assert_eq!(one.baud(), Some(Baud::K187_5));
    let mut none = BaudSearch::new(&[], 0);
    assert_eq!((run(&mut none, 0..2_000, 0), none.baud()), (vec![], None));
}

#[test]
fn rates_and_max_tsdr_follow_the_standard() {
    let rates: Vec<_> = Baud::ALL.iter().map(|baud| (baud.bit_s(), baud.max_tsdr_bits())).collect();
    let expected = [
        (9_600, 60),
        (19_200, 60),
        (45_450, 60),
        (93_750, 60),
        (187_500, 60),
        (500_000, 100),
        (1_500_000, 150),
        (3_000_000, 250),
        (6_000_000, 450),
        (12_000_000, 800),
    ];
    assert_eq!(rates, expected);
}
