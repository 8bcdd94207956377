//! Loads the newest record, and writes the next one step by step.

use wsg_protocol::Instant;

use super::error::FlashError;
use super::flash::{NorFlash, Page};
use super::record::{self, BYTES, Checksum, ERASED, Found, Header, Located, OVERHEAD, ends_record};

/// Maximum records that read complete only once before a load fails. A power cut leaves one.
const MAX_READS: u8 = 3;

/// Persistent storage for payloads of up to `N` bytes: loads the newest record, and saves the next one.
///
/// ```
/// use wsg_bridge_fw::storage::{NorFlash, Progress, SaveError, Store};
/// use wsg_protocol::Instant;
///
/// const VERSION: u16 = 3;
///
/// fn main_loop(flash: &mut impl NorFlash, settings: &[u8], now: impl Fn() -> Instant) -> Result<(), SaveError> {
///     let mut store = Store::<200>::new();
///     match store.load(flash) {
///         Ok(record) if record.version == VERSION => { /* take record.payload */ }
///         Ok(_another_version) => { /* migrate, or refuse and report it */ }
///         Err(_) => { /* use defaults, and report why */ }
///     }
///     store.begin(VERSION, settings).expect("it was loaded, there is room, no other save runs");
///     loop {
///         // One turn of the main loop.
///         match store.poll(flash, now()) {
///             Progress::Saving => {}
///             Progress::Saved | Progress::Idle => return Ok(()),
///             Progress::Failed(error) => return Err(error),
///         }
///     }
/// }
/// ```
#[derive(Clone)]
pub struct Store<const N: usize> {
    /// Payload of the running save, otherwise of the last load or save.
    payload: [u8; N],
    is_loaded: bool,
    /// `newest` is valid. No `Option`, because its `None` is not zero and would move the store from .bss to .data.
    has_newest: bool,
    newest: Located,
    /// Without a complete record, the next one goes to the second page.
    avoids_first: bool,
    /// Index in the newest record's page at which the next record may start.
    free: usize,
    /// Highest number of all saves, whether they succeeded or not.
    sequence: u32,
    step: Step,
    /// Record in progress. Its trailer is valid once all other double words are written.
    target: Located,
    checksum: Checksum,
    /// The save is in its second attempt.
    is_retry: bool,
    /// Start of the running operation.
    started: Instant,
    /// The operation timed out, and may still be running.
    is_given_up: bool,
}

/// Step of a save.
#[derive(Clone, Copy)]
enum Step {
    Idle,
    /// Determine the place of the record.
    Place,
    /// The target's page is being erased.
    Erase,
    /// This double word of the target is being programmed.
    Program(usize),
}

/// A complete record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record<'a> {
    /// Version of the payload's format, as saved.
    pub version: u16,
    /// Payload as it was saved; its layout depends on the version.
    pub payload: &'a [u8],
}

/// Reason why no record was loaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LoadError {
    /// A save is running, so the flash cannot be read.
    Saving,
    /// Nothing was ever saved: both pages are erased, or hold what a power cut left of the first save.
    Empty,
    /// Both pages read zero: no usable flash, such as an emulator's.
    NoFlash,
    /// The pages hold data that no interrupted first save leaves, but no complete record.
    Damaged,
    /// The newest record is longer than `N` bytes. It is kept until the next successful save.
    TooLong {
        /// Version of its payload's format.
        version: u16,
        /// Length of its payload in bytes.
        len: u16,
    },
}

/// Reason why a save did not start. The stored record is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum BeginError {
    /// [`Store::load`] has not been called, so the page to keep is unknown.
    NotLoaded,
    /// Another save is running.
    Saving,
    /// The payload is longer than `N` bytes.
    TooLong,
    /// All 16 777 215 save numbers are used up.
    WornOut,
}

/// Progress of a save.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Progress {
    /// No save is running.
    Idle,
    /// A save is running.
    Saving,
    /// The record is stored and verified: the next [`Store::load`] returns it. Reported once.
    Saved,
    /// The save failed. Reported once.
    Failed(SaveError),
}

/// Reason for a failed save. All except [`Self::TimedOut`] are reported after a second attempt, with an erase, in the page
/// without the newest record.
///
/// The previous record is unchanged, and the next save may succeed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SaveError {
    /// The flash rejected an operation, or reported its failure.
    Flash(FlashError),
    /// The flash was busy with one operation for more than [`NorFlash::OPERATION_TIMEOUT_MS`].
    TimedOut,
    /// A page does not read erased after an erase.
    NotErased,
    /// The record reads back wrong.
    NotWritten,
}

impl<const N: usize> Store<N> {
    /// Creates a store before the first [`load`](Self::load).
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N <= u16::MAX as usize) };
        let nowhere = Located {
            page: Page::First,
            index: 0,
            header: Header { len: 0, version: 0, sequence: 0 },
            trailer: 0,
        };
        Self {
            payload: [0; N],
            is_loaded: false,
            has_newest: false,
            newest: nowhere,
            avoids_first: false,
            free: 0,
            sequence: 0,
            step: Step::Idle,
            target: nowhere,
            checksum: Checksum::new(),
            is_retry: false,
            started: Instant::from_millis(0),
            is_given_up: false,
        }
    }

    /// Returns the newest complete record. Reads both pages completely, up to three times, so call it at the start and not in
    /// a turn.
    ///
    /// # Errors
    /// [`LoadError`]; all but [`LoadError::Saving`] leave the store ready to save.
    pub fn load<F: NorFlash>(&mut self, flash: &F) -> Result<Record<'_>, LoadError> {
        const {
            assert!(F::PAGE_LEN >= OVERHEAD + N.div_ceil(BYTES), "a page has no room for a record of N bytes")
        };
        if self.is_saving() {
            return Err(LoadError::Saving);
        }
        self.is_loaded = true;
        let mut below = u32::MAX;
        for _ in 0..MAX_READS {
            let mut blank = Blank { erased: true, zero: true, damaged: false };
            self.has_newest = false;
            self.scan(flash, Page::First, below, &mut blank);
            let (is_used, is_damaged) = (!blank.erased, blank.damaged);
            self.scan(flash, Page::Second, below, &mut blank);
            // A power cut must not erase what shows that settings were stored. Half erased leftovers are no better.
            self.avoids_first = is_damaged || (is_used && !blank.damaged);
            let Some(newest) = self.newest() else {
                return Err(match blank {
                    Blank { erased: true, .. } => LoadError::Empty,
                    Blank { zero: true, .. } => LoadError::NoFlash,
                    Blank { damaged: false, .. } => LoadError::Empty,
                    _ => LoadError::Damaged,
                });
            };
            let Header { len, version, sequence } = newest.header;
            self.sequence = self.sequence.max(sequence);
            // Verify the data that is returned, not an earlier read: a double word whose programming was interrupted may read
            // differently each time.
            match record::read(flash, newest.page, newest.index, &mut self.payload) {
                Found::Record(again) if again == newest => {
                    return match self.payload.get(..usize::from(len)) {
                        Some(payload) => Ok(Record { version, payload }),
                        None => Err(LoadError::TooLong { version, len }),
                    };
                }
                _ => below = sequence,
            }
        }
        Err(LoadError::Damaged)
    }

    /// Starts to save a copy of the payload, which [`poll`](Self::poll) writes.
    ///
    /// # Errors
    /// [`BeginError`]. The store is unchanged.
    pub fn begin(&mut self, version: u16, payload: &[u8]) -> Result<(), BeginError> {
        if !self.is_loaded {
            return Err(BeginError::NotLoaded);
        }
        if self.is_saving() {
            return Err(BeginError::Saving);
        }
        if self.sequence >= Header::MAX_SEQUENCE {
            return Err(BeginError::WornOut);
        }
        self.payload.get_mut(..payload.len()).ok_or(BeginError::TooLong)?.copy_from_slice(payload);
        self.target.header.len = payload.len() as u16;
        self.target.header.version = version;
        self.is_retry = false;
        self.step = Step::Place;
        Ok(())
    }

    /// Returns whether a save is running. During a save, no other access to the flash is allowed.
    #[must_use]
    pub const fn is_saving(&self) -> bool {
        !matches!(self.step, Step::Idle)
    }

    /// Continues the save and returns its progress. Called in every turn of the main loop. Does not wait, and starts at most
    /// one operation of the flash.
    pub fn poll<F: NorFlash>(&mut self, flash: &mut F, now: Instant) -> Progress {
        let ended = match self.step {
            Step::Idle => return Progress::Idle,
            Step::Place if !self.is_given_up => Ok(()),
            _ => flash.poll(),
        };
        let next = match (self.step, ended) {
            // A read would stall the core until the end of the operation.
            (Step::Place, Err(nb::Error::WouldBlock)) => Err(SaveError::TimedOut),
            (Step::Place, _) => Ok(self.place(flash)),
            (_, Ok(())) => self.after_operation(flash),
            (_, Err(nb::Error::WouldBlock)) if now.since(self.started) <= F::OPERATION_TIMEOUT_MS => {
                return Progress::Saving;
            }
            (_, Err(nb::Error::WouldBlock)) => Err(SaveError::TimedOut),
            (_, Err(nb::Error::Other(error))) => Err(SaveError::Flash(error)),
        };
        match next.and_then(|step| self.start(flash, step)) {
            Ok(step) => {
                self.is_given_up = false;
                self.step = step;
                self.started = now;
                if self.is_saving() { Progress::Saving } else { Progress::Saved }
            }
            Err(error) => self.fail(error),
        }
    }

    fn newest(&self) -> Option<Located> {
        self.has_newest.then_some(self.newest)
    }

    /// Scans a page. Records from number `below` on are treated as damaged.
    fn scan<F: NorFlash>(&mut self, flash: &F, page: Page, below: u32, blank: &mut Blank) {
        let mut index = 0usize;
        // Start of the next record: after the last one, if nothing follows it.
        let mut free = 0;
        let mut is_newest_here = false;
        while index < F::PAGE_LEN {
            let found = record::read(flash, page, index, &mut []);
            let len = match found {
                Found::Record(record) if record.header.sequence < below => {
                    if self.newest().is_none_or(|newest| newest.header.sequence < record.header.sequence) {
                        (self.newest, self.has_newest) = (record, true);
                        is_newest_here = true;
                    }
                    free = record.end();
                    record.header.record_len()
                }
                Found::Record(Located { header, .. }) | Found::Damaged { header, .. } => {
                    blank.damaged |= matches!(found, Found::Damaged { is_ended: true, .. });
                    // It may read complete another time, so the numbers of new saves must be higher.
                    if header.sequence <= Header::MAX_SEQUENCE / 2 {
                        self.sequence = self.sequence.max(header.sequence);
                    }
                    free = F::PAGE_LEN;
                    header.record_len()
                }
                Found::Other(double_word) => {
                    if double_word != Ok(ERASED) {
                        blank.erased = false;
                        free = F::PAGE_LEN;
                    }
                    blank.zero &= double_word == Ok(0);
                    // An interrupted erase leaves unreadable double words anywhere.
                    blank.damaged |= double_word.is_ok_and(|bits| {
                        ends_record(bits) || (bits != ERASED && index >= OVERHEAD + N.div_ceil(BYTES))
                    });
                    index = index.saturating_add(1);
                    continue;
                }
            };
            (blank.erased, blank.zero) = (false, false);
            index = index.saturating_add(len);
        }
        if is_newest_here {
            self.free = free;
        }
    }

    /// Determines the place of the record and returns the first step, or [`Step::Idle`] if it is already stored.
    fn place<F: NorFlash>(&mut self, flash: &F) -> Step {
        let Header { len, version, .. } = self.target.header;
        let payload = self.payload.get(..usize::from(len)).unwrap_or(&[]);
        // After an interrupted save it is stored again, because the record of that save may read complete another time.
        if let Some(newest) = self.newest()
            && newest.header.sequence == self.sequence
            && (newest.header.len, newest.header.version) == (len, version)
            && newest.is_stored(flash, payload)
        {
            return Step::Idle;
        }
        self.sequence = self.sequence.saturating_add(1).min(Header::MAX_SEQUENCE);
        self.target.header.sequence = self.sequence;
        self.checksum = Checksum::new();
        let newest_page = self.newest().map(|newest| newest.page);
        match newest_page {
            Some(page) if self.free.saturating_add(self.target.header.record_len()) <= F::PAGE_LEN => {
                (self.target.page, self.target.index) = (page, self.free);
                Step::Program(0)
            }
            _ => {
                let without_any = if self.is_retry == self.avoids_first { Page::First } else { Page::Second };
                (self.target.page, self.target.index) = (newest_page.map_or(without_any, Page::other), 0);
                Step::Erase
            }
        }
    }

    /// Returns the step after a completed operation.
    fn after_operation<F: NorFlash>(&mut self, flash: &F) -> Result<Step, SaveError> {
        let target = &self.target;
        match self.step {
            Step::Program(n) if n.saturating_add(1) < target.header.record_len() => {
                Ok(Step::Program(n.saturating_add(1)))
            }
            Step::Program(_) => {
                let payload = self.payload.get(..usize::from(target.header.len)).unwrap_or(&[]);
                if !target.is_stored(flash, payload) {
                    return Err(SaveError::NotWritten);
                }
                self.free = target.end();
                (self.newest, self.has_newest) = (*target, true);
                Ok(Step::Idle)
            }
            _ if (0..F::PAGE_LEN).all(|index| flash.read(target.page, index) == Ok(ERASED)) => {
                Ok(Step::Program(0))
            }
            _ => Err(SaveError::NotErased),
        }
    }

    /// Starts the operation of a step.
    fn start<F: NorFlash>(&mut self, flash: &mut F, step: Step) -> Result<Step, SaveError> {
        match step {
            Step::Idle | Step::Place => Ok(()),
            Step::Erase => flash.start_erase(self.target.page),
            Step::Program(n) => {
                self.target.trailer = self.checksum.trailer();
                let payload = self.payload.get(..usize::from(self.target.header.len)).unwrap_or(&[]);
                let double_word = self.target.double_word(n, payload);
                self.checksum.push(double_word);
                flash.start_program(self.target.page, self.target.index.saturating_add(n), double_word)
            }
        }
        .map_or_else(|error| Err(SaveError::Flash(error)), |()| Ok(step))
    }

    /// Starts a second attempt, which never uses the page of the newest record. Fails after it.
    fn fail(&mut self, error: SaveError) -> Progress {
        self.free = usize::MAX;
        self.is_given_up = error == SaveError::TimedOut;
        if core::mem::replace(&mut self.is_retry, true) || self.is_given_up {
            self.step = Step::Idle;
            return Progress::Failed(error);
        }
        self.step = Step::Place;
        Progress::Saving
    }
}

impl<const N: usize> Default for Store<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Common content of all double words so far.
struct Blank {
    erased: bool,
    zero: bool,
    /// One of them is not a remainder of an interrupted first save.
    damaged: bool,
}
