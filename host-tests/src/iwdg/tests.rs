//! Covers the watchdog's strictness: it fires only on time, and accepts values only with the key. Firmware that feeds
//! it in time would not detect a difference.

use super::*;

fn store(iwdg: &mut Iwdg, offset: u32, value: u32) {
    iwdg.store(IWDG + offset, value).unwrap();
}

fn load(iwdg: &mut Iwdg, offset: u32) -> u32 {
    iwdg.load(IWDG + offset).unwrap()
}

/// Creates a running watchdog with a time-out of 100 ms.
fn running() -> Iwdg {
    let mut iwdg = Iwdg::new();
    store(&mut iwdg, KR, START);
    store(&mut iwdg, KR, UNLOCK);
    store(&mut iwdg, PR, 0);
    store(&mut iwdg, RLR, 799);
    store(&mut iwdg, KR, RELOAD);
    iwdg
}

#[test]
fn it_resets_the_machine_when_it_is_not_fed() {
    let mut iwdg = running();
    iwdg.has_run(Duration::from_millis(99));
    assert_eq!(iwdg.resets_machine(), Some(false));
    store(&mut iwdg, KR, RELOAD);
    iwdg.has_run(Duration::from_millis(99));
    assert_eq!(iwdg.resets_machine(), Some(false));
    iwdg.has_run(Duration::from_millis(1));
    assert_eq!(iwdg.resets_machine(), Some(true));
}

#[test]
fn it_counts_only_after_its_start() {
    let mut iwdg = Iwdg::new();
    iwdg.has_run(Duration::from_secs(10));
    assert_eq!(iwdg.resets_machine(), Some(false));
}

#[test]
fn values_are_accepted_only_with_the_key() {
    let mut iwdg = Iwdg::new();
    store(&mut iwdg, RLR, 1);
    assert_eq!(load(&mut iwdg, RLR), 0xFFF);
    store(&mut iwdg, KR, UNLOCK);
    store(&mut iwdg, KR, RELOAD);
    store(&mut iwdg, PR, 5);
    assert_eq!(load(&mut iwdg, PR), 0, "reloading locks again");
}

#[test]
fn a_new_value_takes_five_cycles_of_its_clock() {
    let mut iwdg = running();
    assert_eq!(load(&mut iwdg, SR), PVU | RVU);
    store(&mut iwdg, KR, UNLOCK);
    store(&mut iwdg, RLR, 5);
    assert_eq!(load(&mut iwdg, RLR), 799, "ignored during an update");
    iwdg.advance(UPDATE);
    assert_eq!(load(&mut iwdg, SR), 0);
    store(&mut iwdg, RLR, 5);
    assert_eq!(load(&mut iwdg, RLR), 5);
}
