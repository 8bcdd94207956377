//! The boot loader and the firmware's side of it on a model of the flash: every power cut, and every unacceptable image.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash as _};
use host_tests::chance::Chance;
use host_tests::flash_pages::{FlashPages, Tear};
use host_tests::slot_flash::SlotFlash;
use wsg_boot::{Records, Stopped};
use wsg_bridge_fw::storage::Progress;
use wsg_protocol::Instant;
use wsg_update::sign::{SigningKey, file};
use wsg_update::{Keys, Manifest, Refusal, SIGNATURE_LEN, Target, Version};

const TARGET: Target = Target::of("b-l475e-iot01a");

/// Pages of a slot: fewer than on a board, and enough for each kind of step.
const SLOT: usize = 3;

fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

fn public(seed: u8) -> [u8; 32] {
    key(seed).verifying_key().to_bytes()
}

fn keys() -> Keys {
    Keys { first: public(1), second: public(2) }
}

fn manifest(version: u8, counter: u32) -> Manifest {
    Manifest { target: TARGET, version: Version([0, 0, version]), length: 0, counter, successor: None }
}

fn image(manifest: Manifest, len: usize, seed: u8) -> Vec<u8> {
    let program: Vec<u8> = (0..len).map(|at| (at * usize::from(manifest.version.0[2]) % 251) as u8).collect();
    file(&program, manifest, &key(seed)).unwrap()
}

/// A board with its flash, and the steps of its life.
#[derive(Clone)]
struct Board<const PAGE: usize, const UNIT: usize>(SlotFlash<PAGE, UNIT>);

impl<const PAGE: usize, const UNIT: usize> Board<PAGE, UNIT> {
    /// Creates a board with an image in slot A and random data in slot B, as from an interrupted transfer.
    fn new(image: &[u8]) -> Self {
        let board = Self(SlotFlash::new(SLOT));
        write(&mut board.0.parts().a, image);
        write(&mut board.0.parts().b, &[0x5A; 1_000]);
        let mut pages = board.0.content();
        pages.set(SLOT, 3, None);
        pages.set(SLOT + 2, 7, None);
        Self(SlotFlash::with(pages, SLOT))
    }

    /// Resets the board. Returns the version of the image that runs, and checks that it is one of the files.
    fn start(&self, files: &[&[u8]]) -> Result<u8, Stopped> {
        let manifest = self.0.parts().start(TARGET, keys(), &|| {})?;
        let mut found = vec![0; manifest.length as usize + SIGNATURE_LEN];
        self.0.parts().a.read(0, &mut found).unwrap();
        assert!(files.contains(&&found[..]), "slot A contains neither image");
        Ok(manifest.version.0[2])
    }

    /// The firmware's work in turns of its main loop.
    fn work(&self, begin: impl Fn(&mut Records)) {
        let mut parts = self.0.parts();
        let mut records = Records::load(&parts.state, &parts.trust);
        begin(&mut records);
        loop {
            match records.poll(&mut parts.state, &mut parts.trust, Instant::from_millis(0)) {
                Progress::Saving => {}
                end => return assert_eq!(end, Progress::Saved),
            }
        }
    }

    fn records(&self) -> Records {
        Records::load(&self.0.parts().state, &self.0.parts().trust)
    }

    /// Receives a file and requests the update.
    fn install(&self, file: &[u8]) {
        self.work(Records::settle);
        write(&mut self.0.parts().b, file);
        self.work(Records::request);
    }
}

/// Writes a file to a slot as the receiver does: erases each page before.
fn write<F: NorFlash>(slot: &mut F, file: &[u8]) {
    for (page, at) in file.chunks(F::ERASE_SIZE).zip((0..).step_by(F::ERASE_SIZE)) {
        slot.erase(at, at + F::ERASE_SIZE as u32).unwrap();
        for (unit, at) in page.chunks(F::WRITE_SIZE).zip((at..).step_by(F::WRITE_SIZE)) {
            let mut bytes = vec![0xFF; F::WRITE_SIZE];
            bytes[..unit.len()].copy_from_slice(unit);
            slot.write(at, &bytes).unwrap();
        }
    }
}

/// The observed numbers, and the point in the life of a board.
#[derive(Default)]
struct Count {
    operations: Cell<u32>,
    cuts: Cell<u32>,
    starts: Cell<u32>,
    /// The update was requested.
    is_requested: Cell<bool>,
    /// The new image was confirmed.
    is_confirmed: Cell<bool>,
}

fn add(cell: &Cell<u32>) {
    cell.set(cell.get() + 1);
}

const OLD: u8 = 1;
const NEW: u8 = 2;

/// Follows a board after a power cut: with a new image that confirms itself, and with one that does not. Returns the flash after
/// another cut at a random operation of the first start, unless that start has fewer operations.
fn recover<const PAGE: usize, const UNIT: usize>(
    pages: &FlashPages,
    files: [&[u8]; 2],
    new: Manifest,
    count: &Count,
) -> Option<FlashPages> {
    add(&count.cuts);
    let second = Rc::new(RefCell::new(None));
    let mut chance = Chance::new(count.cuts.get().into());
    let bound = chance.below(2 * SLOT as u64 * (PAGE / UNIT) as u64);
    let left = Cell::new(chance.below(bound));
    for confirms in [true, false] {
        let board = Board::<PAGE, UNIT>(SlotFlash::with(pages.clone(), SLOT));
        if confirms {
            let (second, left) = (Rc::clone(&second), left.clone());
            board.0.observe(Some(Rc::new(move |before, after, page, range| {
                if left.replace(left.get().wrapping_sub(1)) == 0 {
                    let mut pages = after.clone();
                    pages.tear_range(before, page, range, Tear::Mixed);
                    *second.borrow_mut() = Some(pages);
                }
            })));
        }
        let (mut previous, mut was_trial) = (None, false);
        for start in 0..3 {
            add(&count.starts);
            let runs = board.start(&files);
            board.0.observe(None);
            let runs = runs.unwrap_or_else(|stopped| panic!("start {start}: {stopped:?}"));
            let is_trial = board.records().is_trial();
            if runs == NEW {
                assert!(count.is_requested.get(), "start {start}: the new image runs before its request");
            } else {
                assert!(!is_trial, "start {start}: the old image is on trial");
                assert!(
                    !count.is_confirmed.get(),
                    "start {start}: the old image runs after the new one's confirmation"
                );
            }
            match previous {
                Some(NEW) if was_trial && !confirms => assert_eq!(runs, OLD, "start {start}: no return"),
                Some(NEW) => assert_eq!(runs, NEW, "start {start}: return after a confirmation"),
                _ => {}
            }
            if runs == NEW && confirms {
                board.work(|records| records.confirm(new));
                assert!(board.records().trusted().counter == new.counter && !board.records().is_trial());
            }
            (previous, was_trial) = (Some(runs), is_trial && !confirms);
        }
    }
    second.take()
}

/// Installs an update and confirms or returns it, with a power cut at each operation.
fn every_power_cut<const PAGE: usize, const UNIT: usize>(old: usize, new: usize) {
    let (old, new) = (image(manifest(OLD, 5), old, 1), image(manifest(NEW, 6), new, 1));
    let signed = Manifest { length: (new.len() - SIGNATURE_LEN) as u32, ..manifest(NEW, 6) };
    let count = Rc::new(Count::default());
    for confirms in [true, false] {
        let board = Board::<PAGE, UNIT>::new(&old);
        assert_eq!(board.start(&[&old]), Ok(OLD));
        count.is_requested.set(false);
        count.is_confirmed.set(false);
        let (observed, files) = (Rc::clone(&count), (old.clone(), new.clone()));
        board.0.observe(Some(Rc::new(move |before, after, page, range| {
            add(&observed.operations);
            // Every kind of tear for records, erases, and the first and last units of a page; one kind for other data.
            let is_inner =
                page < 2 * SLOT + 1 && range.len() == 1 && range.start > 1 && range.end < PAGE / 8 - 1;
            let rotating = observed.operations.get() as usize % Tear::ALL.len();
            for tear in if is_inner { &Tear::ALL[rotating..=rotating] } else { &Tear::ALL } {
                let mut pages = after.clone();
                pages.tear_range(before, page, range.clone(), *tear);
                let second = recover::<PAGE, UNIT>(&pages, [&files.0, &files.1], signed, &observed);
                if let Some(pages) = second {
                    recover::<PAGE, UNIT>(&pages, [&files.0, &files.1], signed, &observed);
                }
            }
        })));
        board.work(Records::settle);
        write(&mut board.0.parts().b, &new);
        count.is_requested.set(true);
        board.work(Records::request);
        assert_eq!(board.start(&[&new]), Ok(NEW));
        if confirms {
            // The first of both records of the state takes effect.
            board.work(|records| records.confirm(signed));
            count.is_confirmed.set(true);
        }
        assert_eq!(board.start(&[&old, &new]), Ok(if confirms { NEW } else { OLD }));
        assert_eq!(board.records().is_restored(), !confirms);
    }
    let [operations, cuts, starts] = [&count.operations, &count.cuts, &count.starts].map(Cell::get);
    println!(
        "{PAGE} bytes per page, {UNIT} per write: {operations} operations, {cuts} power cuts, {starts} starts"
    );
    assert!(operations > 100 && cuts > operations);
}

/// STM32L475 and STM32G474 have the same pages.
#[test]
fn power_cut_at_any_operation_leaves_the_old_or_the_new_image_on_stm32() {
    every_power_cut::<2048, 8>(2_100, 1_300);
}

#[test]
fn power_cut_at_any_operation_leaves_the_old_or_the_new_image_on_the_pico() {
    every_power_cut::<4096, 256>(2_000, 5_000);
}

#[test]
fn unacceptable_image_in_slot_b_never_runs_and_changes_nothing() {
    let old = image(manifest(OLD, 5), 3_000, 1);
    let new = image(manifest(NEW, 5), 2_000, 2);
    let mut damaged = new.clone();
    damaged[1_000] ^= 1;
    let mut unsigned = new.clone();
    unsigned[2_064..].fill(0xFF);
    let foreign = Manifest { target: Target::of("pico"), ..manifest(NEW, 5) };
    let successor = Manifest { successor: Some(public(3)), ..manifest(NEW, 5) };
    let files = [
        ("damaged", damaged),
        ("unsigned", unsigned),
        ("truncated", new[..1_500].to_vec()),
        ("foreign board", image(foreign, 2_000, 1)),
        ("foreign key", image(manifest(NEW, 5), 2_000, 3)),
        ("lower counter", image(manifest(NEW, 4), 2_000, 1)),
        ("successor of the second key", image(successor, 2_000, 2)),
    ];
    for (what, refused) in files {
        let board = Board::<2048, 8>::new(&old);
        board.work(|records| records.confirm(manifest(OLD, 5)));
        board.install(&refused);
        for _ in 0..3 {
            assert_eq!(board.start(&[&old]), Ok(OLD), "{what}");
        }
        assert!(!board.records().is_trial() && !board.records().is_restored(), "{what}");
        // The next one is accepted.
        board.install(&new);
        assert_eq!(board.start(&[&new]), Ok(NEW), "{what}");
    }
}

#[test]
fn damaged_slot_a_is_replaced_by_an_intact_slot_b_and_nothing_else_starts() {
    let (old, new) = (image(manifest(OLD, 5), 3_000, 1), image(manifest(NEW, 5), 2_000, 2));
    let damage = |board: &Board<2048, 8>| {
        let mut pages = board.0.content();
        pages.set(0, 40, None);
        Board::<2048, 8>(SlotFlash::with(pages, SLOT))
    };
    let board = damage(&Board::new(&old));
    let operations = board.0.operations();
    assert_eq!(board.start(&[]), Err(Stopped::NoImage(Refusal::Unreadable)));
    assert_eq!(board.0.operations(), operations, "a stopped board writes nothing");

    let board = Board::new(&old);
    board.install(&new);
    assert_eq!(board.start(&[&new]), Ok(NEW));
    // The new image is damaged in its trial: the previous one returns.
    assert_eq!(damage(&board).start(&[&old]), Ok(OLD));
    // And after its confirmation.
    board.work(|records| records.confirm(manifest(NEW, 5)));
    let board = damage(&board);
    for _ in 0..3 {
        assert_eq!(board.start(&[&old]), Ok(OLD));
    }
}

/// A drive writes slot A alone, at any point of an exchange or a return. Another image may run afterwards, until the installation is
/// repeated.
#[test]
fn repeated_installation_over_the_drive_ends_an_update_at_any_point() {
    const THIRD: u8 = 3;
    let [old, new, third] = [OLD, NEW, THIRD].map(|version| image(manifest(version, 5), 3_000, 1));
    let board = Board::<2048, 8>::new(&old);
    board.install(&new);
    let points = Rc::new(Cell::new(0));
    let (count, files) = (Rc::clone(&points), [old.clone(), new.clone(), third.clone()]);
    board.0.observe(Some(Rc::new(move |_, after, page, _| {
        add(&count);
        // All operations of the records, and some of the data.
        if page < 2 * SLOT + 1 && !count.get().is_multiple_of(5) {
            return;
        }
        let board = Board::<2048, 8>(SlotFlash::with(after.clone(), SLOT));
        let install = || write(&mut board.0.parts().a, &files[2]);
        install();
        let _ = board.start(&files.each_ref().map(Vec::as_slice));
        install();
        assert_eq!(board.start(&[&files[2]]), Ok(THIRD), "operation {}", count.get());
    })));
    assert_eq!(board.start(&[&new]), Ok(NEW));
    assert_eq!(board.start(&[&old]), Ok(OLD));
    assert!(points.get() > 1_000, "{} operations", points.get());
}

#[test]
fn named_successor_signs_from_the_confirmation_on_and_no_earlier() {
    let [second, third] = [2, 3].map(|seed| image(manifest(NEW, 5), 2_000, seed));
    let named = image(Manifest { successor: Some(public(3)), ..manifest(OLD, 5) }, 3_000, 1);
    let board = Board::<2048, 8>::new(&second);
    board.install(&named);
    assert_eq!(board.start(&[&named]), Ok(OLD));
    board.work(|records| {
        assert_eq!(records.trusted().successor, None);
        records.confirm(Manifest { successor: Some(public(3)), ..manifest(OLD, 5) });
    });
    for (file, runs) in [(&second, OLD), (&third, NEW)] {
        board.install(file);
        assert_eq!(board.start(&[&named, &third]), Ok(runs));
    }
}
