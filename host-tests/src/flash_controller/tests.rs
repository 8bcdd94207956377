//! Covers the model's strictness: accesses that the flash interface rejects or penalizes. The driver avoids them, so
//! no emulated image would detect a model without them.

use super::*;
use crate::registers::tests::Core;

const FIRST: u32 = Layout::STM32L475.memory.start + SETTINGS as u32 * PAGE_BYTES;
const SECOND: u32 = FIRST + 0x800;

/// Returns the register block.
fn registers(flash: &FlashController) -> Box<dyn RegisterModel> {
    flash.models().swap_remove(0)
}

/// Returns the memory of the pages.
fn memory(flash: &FlashController) -> Box<dyn RegisterModel> {
    flash.models().swap_remove(1)
}

fn store(flash: &FlashController, offset: u32, value: u32) {
    registers(flash).store(FLASH + offset, value).unwrap();
}

fn load(flash: &FlashController, offset: u32) -> u32 {
    registers(flash).load(FLASH + offset).unwrap()
}

fn poke(flash: &FlashController, address: u32, width: Width, value: u32) {
    memory(flash).store_through(address, width, value, &mut Core::default()).unwrap();
}

/// Returns the loaded value and the number of NMIs.
fn peek(flash: &FlashController, address: u32) -> (u32, u32) {
    let mut core = Core::default();
    (memory(flash).load_through(address, Width::Word, &mut core).unwrap(), core.nmis)
}

fn pass(flash: &FlashController, time: Duration) {
    registers(flash).advance(time);
}

fn unlock(flash: &FlashController) {
    KEYS.into_iter().for_each(|key| store(flash, KEYR, key));
}

/// Creates an unlocked interface with the data cache off.
fn ready() -> FlashController {
    let flash = FlashController::new(&Layout::STM32L475);
    store(&flash, ACR, ICEN);
    unlock(&flash);
    flash
}

fn program(flash: &FlashController, address: u32, value: u64) {
    store(flash, CR, PG);
    poke(flash, address, Width::Word, value as u32);
    poke(flash, address + 4, Width::Word, (value >> 32) as u32);
}

fn erase(flash: &FlashController, page_number: u32) {
    let selection = PER | (page_number & 0xFF) << 3 | (page_number >> 8) << 11;
    store(flash, CR, selection);
    store(flash, CR, selection | STRT);
}

#[test]
fn a_wrong_key_locks_it_until_reset() {
    for wrong in [[KEYS[1], KEYS[0]], [KEYS[0], KEYS[0]], [0, KEYS[1]]] {
        let flash = FlashController::new(&Layout::STM32L475);
        wrong.into_iter().for_each(|key| store(&flash, KEYR, key));
        assert!(flash.violations()[0].starts_with("3.3.5"), "{wrong:X?}");
        unlock(&flash);
        assert_ne!(load(&flash, CR) & LOCK, 0, "{wrong:X?}");
        registers(&flash).reset();
        unlock(&flash);
        assert_eq!(load(&flash, CR) & LOCK, 0, "{wrong:X?}");
    }
    let flash = ready();
    store(&flash, KEYR, KEYS[0]);
    assert_eq!(flash.violations().len(), 1, "a key while unlocked");
    let flash = FlashController::new(&Layout::STM32L475);
    store(&flash, CR, PG);
    assert_eq!((flash.violations().len(), load(&flash, CR)), (1, OPTLOCK | LOCK), "a store while locked");
}

#[test]
fn each_programming_error_sets_its_flag_and_changes_nothing() {
    use Width::{Byte, Halfword, Word};
    type Stores = &'static [(u32, Width)];
    let cases: [(Stores, u32, ErrorFlag); 6] = [
        (&[(FIRST, Byte)], PG, ErrorFlag::Size),
        (&[(FIRST, Halfword)], PG, ErrorFlag::Size),
        (&[(FIRST + 4, Word)], PG, ErrorFlag::Alignment),
        (&[(FIRST, Word), (FIRST + 12, Word)], PG, ErrorFlag::Alignment),
        (&[(FIRST, Word)], 0, ErrorFlag::Sequence),
        (&[(FIRST, Word), (FIRST + 4, Word)], PG | PER, ErrorFlag::Sequence),
    ];
    for (stores, cr, flag) in cases {
        let flash = ready();
        store(&flash, CR, cr);
        stores.iter().for_each(|(address, width)| poke(&flash, *address, *width, 0));
        assert_eq!((load(&flash, SR), flash.operations()), (flag as u32, 0), "{stores:X?}");
        assert_eq!(flash.double_word(Page::First, 0), Some(u64::MAX));
        store(&flash, SR, flag as u32);
        assert_eq!(load(&flash, SR), 0, "cleared by a 1");
    }
}

#[test]
fn a_programmed_double_word_can_only_be_programmed_to_zero() {
    let flash = ready();
    flash.set(Page::First, 0, Some(u64::MAX));
    program(&flash, FIRST, 5);
    pass(&flash, PROGRAM_TIME);
    assert_eq!(load(&flash, SR), ErrorFlag::Programming as u32);
    assert_eq!(flash.double_word(Page::First, 0), Some(u64::MAX), "all ones, but not erased");
    store(&flash, SR, u32::MAX);
    program(&flash, FIRST, 0);
    pass(&flash, PROGRAM_TIME);
    assert_eq!((load(&flash, SR), flash.double_word(Page::First, 0)), (0, Some(0)));
}

#[test]
fn no_operation_starts_while_an_error_flag_is_set() {
    let flash = ready();
    poke(&flash, FIRST, Width::Byte, 0);
    let size_and_sequence = ErrorFlag::Size as u32 | ErrorFlag::Sequence as u32;
    assert_eq!(load(&flash, SR), ErrorFlag::Size as u32);
    program(&flash, FIRST, 5);
    assert_eq!((load(&flash, SR), flash.operations()), (size_and_sequence, 0));
    store(&flash, SR, ErrorFlag::Sequence as u32);
    erase(&flash, 510);
    assert_eq!((load(&flash, SR), flash.operations()), (size_and_sequence, 0));
    store(&flash, SR, size_and_sequence);
    erase(&flash, 510);
    assert_eq!((load(&flash, SR), flash.operations()), (BSY, 1));
}

#[test]
fn a_forbidden_erase_is_recorded_and_has_no_effect() {
    // Without BKER, and the neighbouring pages.
    for number in [254, 255, 505, 0] {
        let flash = ready();
        flash.set(Page::First, 0, Some(7));
        erase(&flash, number);
        assert_eq!((flash.violations().len(), load(&flash, SR), flash.operations()), (1, 0, 0), "{number}");
        assert_eq!(flash.double_word(Page::First, 0), Some(7));
    }
    let flash = ready();
    store(&flash, CR, PER | BKER | 254 << 3 | STRT);
    assert!(flash.violations()[0].contains("by one store"));
}

#[test]
fn an_enabled_data_cache_during_an_operation_is_recorded() {
    let flash = FlashController::new(&Layout::STM32L475);
    unlock(&flash);
    program(&flash, FIRST, 5);
    assert!(flash.violations()[0].contains("data cache"), "{:?}", flash.violations());
}

#[test]
fn data_cache_is_stale_after_erase_until_flushed_while_disabled() {
    let flash = ready();
    flash.set(Page::First, 0, Some(7));
    store(&flash, ACR, ICEN | DCEN);
    assert_eq!(peek(&flash, FIRST).0, 7);
    store(&flash, ACR, ICEN);
    erase(&flash, 510);
    pass(&flash, ERASE_TIME);
    store(&flash, ACR, ICEN | DCEN);
    assert_eq!((peek(&flash, FIRST).0, flash.violations().len()), (7, 1), "stale");
    store(&flash, ACR, ICEN | DCEN | DCRST);
    assert_eq!(peek(&flash, FIRST).0, 7, "flushed while enabled");
    assert!(flash.violations()[1].contains("flushed"), "{:?}", flash.violations());
    store(&flash, ACR, ICEN);
    store(&flash, ACR, ICEN | DCRST);
    store(&flash, ACR, ICEN | DCEN);
    assert_eq!(peek(&flash, FIRST).0, u32::MAX);
}

#[test]
fn accesses_that_would_stall_the_core_are_recorded() {
    let flash = ready();
    program(&flash, FIRST, 5);
    peek(&flash, SECOND);
    poke(&flash, SECOND, Width::Word, 1);
    store(&flash, CR, 0);
    assert_eq!(flash.violations().len(), 3, "{:?}", flash.violations());
}

#[test]
fn unreadable_double_word_raises_one_nmi_until_flag_is_cleared() {
    let flash = ready();
    flash.set(Page::Second, 3, None);
    assert_eq!(peek(&flash, SECOND + 24).1, 1);
    // Bank 2 and the address in it.
    assert_eq!(load(&flash, ECCR), ECCD | Layout::STM32L475.bk_ecc | 0x7_F818);
    assert_eq!(peek(&flash, SECOND + 28).1, 0);
    assert!(flash.violations()[0].starts_with("3.3.2"));
    store(&flash, ECCR, ECCD);
    assert_eq!(load(&flash, ECCR) & ECCD, 0);
    assert_eq!(peek(&flash, SECOND + 28).1, 1);
}
