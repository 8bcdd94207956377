//! The firmware's slot B: receives an image, checks it with the boot loader's signature check, and agrees with the boot loader.

use wsg_bridge_fw::registers::UpdateRefusal;
use wsg_bridge_fw::storage::{
    FlashError, ImageVersion, NorFlash, Page, Progress, SLOT_PAGE_LEN, Slot, Unreadable,
};
use wsg_protocol::Instant;
use wsg_update::{Check, Keys, Manifest, Refusal, Rules, SIGNATURE_LEN, SLOT_LEN, Target};

use crate::flash::{ERASED, PolledFlash, Reader};
use crate::{Records, Verify};

/// The running image, and its way to the boot loader.
#[derive(Clone, Copy)]
pub struct Firmware {
    /// Manifest of the running image. Its target is the only one that is accepted.
    pub image: Manifest,
    /// The keys of the boot loader.
    pub keys: Keys,
    /// Checks a signature.
    pub verify: Verify,
    /// Resets the MCU. It returns only in a model.
    pub restart: fn(),
}

impl Firmware {
    /// Returns the image that runs in slot A of this board; `None` without a boot loader or a manifest.
    #[must_use]
    pub fn of(a: &impl PolledFlash, board: &str, verify: Option<Verify>, restart: fn()) -> Option<Self> {
        let image = Manifest::read(&mut Reader(a)).ok().filter(|image| image.target == Target::of(board))?;
        Some(Self { image, keys: Keys::BUILT_IN, verify: verify?, restart })
    }
}

/// Slot B, and the records of state and trust.
#[derive(Clone)]
pub struct Updater<F, S, T> {
    slot: F,
    state: S,
    trust: T,
    records: Records,
    firmware: Firmware,
    check: Option<Check>,
    work: Work,
    /// Page in progress.
    page: [u8; SLOT_PAGE_LEN],
}

/// Work on the flash, one operation at a time.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Work {
    Nothing,
    /// A request of an earlier image is withdrawn before the first erase.
    Settle,
    Erase,
    /// Programs the page at this offset. The second number counts its bytes that are done.
    Program(u32, usize),
    Request,
    Confirm,
}

impl<F: PolledFlash, S: NorFlash, T: NorFlash> Updater<F, S, T> {
    /// Loads the records. Reads all of their pages, so call it at the start.
    #[must_use]
    pub fn new(slot: F, state: S, trust: T, firmware: Firmware) -> Self {
        let records = Records::load(&state, &trust);
        Self {
            slot,
            state,
            trust,
            records,
            firmware,
            check: None,
            work: Work::Nothing,
            page: [0; SLOT_PAGE_LEN],
        }
    }

    /// Returns the parts of the flash.
    pub const fn parts(&mut self) -> (&mut F, &mut S, &mut T) {
        (&mut self.slot, &mut self.state, &mut self.trust)
    }

    fn rules(&self) -> Rules {
        let trusted = self.records.trusted();
        Rules {
            target: self.firmware.image.target,
            keys: trusted.keys(self.firmware.keys),
            counter: trusted.counter,
        }
    }

    /// Continues the work on the records that `begin` requests.
    fn write_records(
        &mut self,
        work: Work,
        now: Instant,
        begin: impl FnOnce(&mut Records),
    ) -> nb::Result<(), FlashError> {
        if self.work != work {
            begin(&mut self.records);
            self.work = work;
        }
        let progress = self.records.poll(&mut self.state, &mut self.trust, now);
        if progress == Progress::Saving {
            return Err(nb::Error::WouldBlock);
        }
        self.work = Work::Nothing;
        (progress == Progress::Saved).then_some(()).ok_or(nb::Error::Other(FlashError::Failed))
    }

    /// Starts to program the next unit of the page that is not erased.
    fn program(&mut self, at: u32, done: usize) -> Result<(), FlashError> {
        self.work = Work::Nothing;
        let rest = self.page.get(done..).unwrap_or_default();
        let mut units = rest.chunks(F::UNIT_LEN).zip((done..).step_by(F::UNIT_LEN));
        let Some((unit, start)) = units.find(|(unit, _)| unit.iter().any(|byte| *byte != ERASED)) else {
            return Ok(());
        };
        self.slot.start_program(at.saturating_add(start as u32), unit)?;
        self.work = Work::Program(at, start.saturating_add(F::UNIT_LEN));
        Ok(())
    }

    fn continue_work(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        match self.work {
            Work::Settle => {
                self.write_records(Work::Settle, now, Records::settle)?;
                self.slot.start_erase(0)?;
                self.work = Work::Erase;
                Err(nb::Error::WouldBlock)
            }
            Work::Program(..) => {
                // Most flash is busy after the first unit.
                while let Work::Program(at, done) = self.work {
                    self.slot.poll()?;
                    self.program(at, done)?;
                }
                Ok(())
            }
            Work::Erase => self.slot.poll(),
            Work::Nothing | Work::Request | Work::Confirm => Ok(()),
        }
    }

    fn step(&mut self, len: u32) -> Result<Option<ImageVersion>, UpdateRefusal> {
        let (mut reader, rules) = (Reader(&self.slot), self.rules());
        let Some(check) = &mut self.check else {
            self.check = Some(Check::begin(&mut reader, rules).map_err(refused)?);
            return Ok(None);
        };
        let verify = self.firmware.verify;
        let step = check.step_with(&mut reader, |key, digest, signature| verify(key, digest, signature));
        match step.map_err(refused)? {
            Some(image) if image.length.saturating_add(SIGNATURE_LEN as u32) == len => {
                Ok(Some(image.version.0))
            }
            Some(_) => Err(UpdateRefusal::WrongLength),
            None => Ok(None),
        }
    }
}

const fn refused(why: Refusal) -> UpdateRefusal {
    match why {
        Refusal::NoImage => UpdateRefusal::NoImage,
        Refusal::Unreadable => UpdateRefusal::Unreadable,
        Refusal::TooLong => UpdateRefusal::TooLong,
        Refusal::WrongBoard => UpdateRefusal::WrongBoard,
        Refusal::LowerCounter => UpdateRefusal::LowerCounter,
        Refusal::WrongSignature => UpdateRefusal::WrongSignature,
        Refusal::WrongSuccessor => UpdateRefusal::WrongSuccessor,
    }
}

impl<F: PolledFlash, S: NorFlash, T: NorFlash> Slot for Updater<F, S, T> {
    fn len(&self) -> u32 {
        SLOT_LEN
    }

    fn sector_len(&self) -> u32 {
        F::SECTOR_LEN as u32
    }

    fn target(&self) -> u32 {
        self.firmware.image.target.number()
    }

    fn version(&self) -> ImageVersion {
        Manifest::read(&mut Reader(&self.slot)).map_or([0; 3], |image| image.version.0)
    }

    fn is_on_trial(&self) -> bool {
        self.records.is_trial()
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        self.check = None;
        if at == 0 {
            self.records.settle();
            self.work = Work::Settle;
            return Ok(());
        }
        self.work = Work::Erase;
        self.slot.start_erase(at)
    }

    fn start_program(&mut self, at: u32, page: &[u8; SLOT_PAGE_LEN]) -> Result<(), FlashError> {
        self.page = *page;
        self.program(at, 0)
    }

    fn poll(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        let result = self.continue_work(now);
        if !matches!(result, Err(nb::Error::WouldBlock)) {
            self.work = Work::Nothing;
        }
        result
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        self.slot.read(at)
    }

    fn check(&mut self, len: u32) -> nb::Result<ImageVersion, UpdateRefusal> {
        let step = self.step(len);
        if !matches!(step, Ok(None)) {
            self.check = None;
        }
        step?.ok_or(nb::Error::WouldBlock)
    }

    fn mark(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        self.write_records(Work::Request, now, Records::request)
    }

    fn confirm(&mut self, now: Instant) -> nb::Result<(), FlashError> {
        let image = self.firmware.image;
        self.write_records(Work::Confirm, now, |records| records.confirm(image))
    }

    fn restart(&mut self) {
        (self.firmware.restart)();
    }
}

/// The pages of the settings, and slot B if a boot loader started this image.
pub struct FlashWithSlot<P, F, S, T> {
    /// The settings.
    pub settings: P,
    /// The slot.
    pub updater: Option<Updater<F, S, T>>,
}

impl<P: NorFlash, F: PolledFlash, S: NorFlash, T: NorFlash> NorFlash for FlashWithSlot<P, F, S, T> {
    const PAGE_LEN: usize = P::PAGE_LEN;
    const OPERATION_TIMEOUT_MS: u32 = P::OPERATION_TIMEOUT_MS;

    fn read(&self, page: Page, index: usize) -> Result<u64, Unreadable> {
        self.settings.read(page, index)
    }

    fn start_program(&mut self, page: Page, index: usize, value: u64) -> Result<(), FlashError> {
        self.settings.start_program(page, index, value)
    }

    fn start_erase(&mut self, page: Page) -> Result<(), FlashError> {
        self.settings.start_erase(page)
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        self.settings.poll()
    }

    fn slot(&mut self) -> Option<&mut dyn Slot> {
        self.updater.as_mut().map(|updater| updater as _)
    }
}
