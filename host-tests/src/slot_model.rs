//! Slot B of a board with a boot loader, and the boot loader's check with test keys.

use wsg_bridge_fw::registers::UpdateRefusal;
use wsg_bridge_fw::storage::{FlashError, ImageVersion, SLOT_PAGE_LEN, Slot, Unreadable};
use wsg_update::sign::{SigningKey, file};
use wsg_update::{Check, Keys, Manifest, Rules, SIGNATURE_LEN, SLOT_LEN, Target, Version};

/// Name of the board in virtual time.
pub const BOARD_NAME: &str = "virtual";

/// Bytes of a sector, as on the STM32 boards.
pub const SECTOR_LEN: usize = 2_048;

/// Lowest accepted rollback counter.
const COUNTER: u32 = 3;

fn key(seed: u8) -> SigningKey {
    SigningKey::from_bytes(&[seed; 32])
}

fn rules() -> Rules {
    let public = |seed| key(seed).verifying_key().to_bytes();
    Rules {
        target: Target::of(BOARD_NAME),
        keys: Keys { first: public(1), second: public(2) },
        counter: COUNTER,
    }
}

/// Returns the public keys of the boot loader.
#[must_use]
pub fn keys() -> [[u8; 32]; 2] {
    let Keys { first, second } = rules().keys;
    [first, second]
}

/// Returns an image of about this length for this board with its signature by the second key.
///
/// # Panics
/// Panics when it exceeds a slot.
#[must_use]
pub fn signed(len: usize, board: &str, version: [u8; 3]) -> Vec<u8> {
    let program: Vec<u8> = (0..len).map(|at| (at * 7 % 251) as u8).collect();
    let (target, version) = (Target::of(board), Version(version));
    let manifest = Manifest { target, version, length: 0, counter: COUNTER, successor: None };
    file(&program, manifest, &key(2)).expect("it fits into a slot")
}

#[derive(Clone, Copy, Debug)]
enum Operation {
    Erase(usize),
    Program(usize),
}

/// The simulated slot.
#[derive(Clone)]
pub struct SlotModel {
    /// Content of the flash.
    pub bytes: Vec<u8>,
    running: Option<(Operation, u32)>,
    /// Page that is being programmed.
    page: [u8; SLOT_PAGE_LEN],
    check: Option<Check>,
    /// Number of busy results before an operation ends.
    pub busy_polls: u32,
    /// Operation, as in [`Self::operations`], that ends without an effect.
    pub fails_at: Option<u32>,
    /// Number of operations started.
    pub operations: u32,
    /// Number of requests to exchange the slots.
    pub marks: u32,
    /// Number of resets.
    pub restarts: u32,
}

impl SlotModel {
    /// Creates a slot with old data.
    #[must_use]
    pub fn new() -> Self {
        Self {
            bytes: vec![0x55; SLOT_LEN as usize],
            running: None,
            page: [0; SLOT_PAGE_LEN],
            check: None,
            busy_polls: 2,
            fails_at: None,
            operations: 0,
            marks: 0,
            restarts: 0,
        }
    }

    fn begin(&mut self, operation: Operation) -> Result<(), FlashError> {
        if self.running.is_some() {
            return Err(FlashError::Busy);
        }
        self.operations += 1;
        self.running = Some((operation, self.busy_polls));
        Ok(())
    }
}

impl Default for SlotModel {
    fn default() -> Self {
        Self::new()
    }
}

impl Slot for SlotModel {
    fn len(&self) -> u32 {
        SLOT_LEN
    }

    fn sector_len(&self) -> u32 {
        SECTOR_LEN as u32
    }

    fn target(&self) -> u32 {
        rules().target.number()
    }

    fn version(&self) -> ImageVersion {
        [0; 3]
    }

    fn start_erase(&mut self, at: u32) -> Result<(), FlashError> {
        assert!(at.is_multiple_of(SECTOR_LEN as u32), "{at}");
        self.check = None;
        self.begin(Operation::Erase(at as usize))
    }

    fn start_program(&mut self, at: u32, page: &[u8; SLOT_PAGE_LEN]) -> Result<(), FlashError> {
        assert!(at.is_multiple_of(SLOT_PAGE_LEN as u32), "{at}");
        self.begin(Operation::Program(at as usize))?;
        self.page = *page;
        Ok(())
    }

    fn poll(&mut self) -> nb::Result<(), FlashError> {
        match self.running.take() {
            None => Ok(()),
            Some((operation, polls @ 1..)) => {
                self.running = Some((operation, polls - 1));
                Err(nb::Error::WouldBlock)
            }
            Some(_) if self.fails_at == Some(self.operations) => Ok(()),
            Some((Operation::Erase(at), _)) => {
                self.bytes[at..at + SECTOR_LEN].fill(0xFF);
                Ok(())
            }
            Some((Operation::Program(at), _)) => {
                self.bytes[at..].iter_mut().zip(self.page).for_each(|(old, new)| *old &= new);
                Ok(())
            }
        }
    }

    fn read(&self, at: u32) -> Result<u64, Unreadable> {
        assert!(self.running.is_none(), "read while an operation runs");
        let bytes = self.bytes.get(at as usize..).and_then(|rest| rest.first_chunk()).ok_or(Unreadable)?;
        Ok(u64::from_le_bytes(*bytes))
    }

    fn check(&mut self, len: u32) -> nb::Result<ImageVersion, UpdateRefusal> {
        let mut slot = &self.bytes[..];
        let step = match &mut self.check {
            Some(check) => check.step(&mut slot),
            none => Check::begin(&mut slot, rules()).map(|check| {
                *none = Some(check);
                None
            }),
        };
        let refused = |code| UpdateRefusal::from_code(code).expect("a reason of the boot loader");
        match step {
            Ok(None) => Err(nb::Error::WouldBlock),
            Ok(Some(manifest)) if manifest.length + SIGNATURE_LEN as u32 == len => Ok(manifest.version.0),
            Ok(Some(_)) => Err(nb::Error::Other(UpdateRefusal::WrongLength)),
            Err(why) => Err(nb::Error::Other(refused(10 + why as u16))),
        }
    }

    fn mark(&mut self) -> nb::Result<(), FlashError> {
        self.marks += 1;
        Ok(())
    }

    fn restart(&mut self) {
        self.restarts += 1;
    }
}
