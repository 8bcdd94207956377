//! Updates in the field: receives an image into slot B, lets the boot loader's rules check it, and restarts into it
//! (docs/decisions.md). Independent of the bus that carries the image. The boot loader exchanges the slots.
//!
//! - A session begins with a block, CHECK or RESTART while the fingers stand still and no command is pending. From then on,
//!   motions are refused and settings stay, until the restart, a refused image, or [`PAUSE_MS`] without a block or a command.
//! - After a pause, the next session may continue with the next block. The check covers the complete image.
//! - No operation of the flash starts while a FAST STOP waits for the gripper's confirmation.

use core::hash::{Hash, Hasher};

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use wsg_protocol::Instant;

use crate::register::{UpdateCommand, UpdateRefusal, report_rows};
use crate::storage::{FlashError, ImageVersion, SLOT_PAGE_LEN, Slot};

/// Pause after which a session ends, in milliseconds.
pub(crate) const PAUSE_MS: u32 = 5_000;

/// Time for the gripper to confirm the FAST STOP before a restart, in milliseconds. A missing gripper cannot.
const STOP_MS: u32 = 1_000;

/// Longest operation of the flash, in milliseconds. The flash of a Pico erases a sector in 400 ms at most.
const OPERATION_MS: u32 = 1_000;

/// Time after which a running image confirms itself, in milliseconds. The main loop has fed the watchdog meanwhile.
const TRIAL_MS: u32 = 10_000;

/// Bytes of a page that is written, and of the next one.
const BUFFER_LEN: usize = 2 * SLOT_PAGE_LEN;

/// Bitwise, because a table of 1 KiB would exceed all other code of the update.
static CRC: Crc<u32, Table<0>> = Crc::<u32, Table<0>>::new(&CRC_32_ISO_HDLC);

/// Connection over which a master sends an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Master {
    Service,
    Bus,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Nothing was received.
    Idle,
    /// Blocks are accepted.
    Receiving,
    /// The last page is written, then the image is checked.
    Checking,
    /// The image may be started.
    Received,
    /// The image was refused, or the flash failed.
    Refused,
    /// A FAST STOP was requested at this time, in the first turn of the phase.
    Stopping(Option<Instant>),
    /// The exchange of the slots is being requested.
    Marking,
    /// The MCU is being reset.
    Restarting,
}

/// Operation of the flash, with its start.
#[derive(Clone, Copy, Debug)]
enum Operation {
    Nothing,
    Erase(Instant),
    Program(Instant),
}

/// Confirmation of the running image.
#[derive(Clone, Copy, Debug)]
enum Confirmation {
    /// Nothing is to be confirmed, or it was.
    Done,
    /// Waits since this time, of the start or of the last attempt.
    Waits(Instant),
    /// The records are being written.
    Runs,
}

/// An update, from its first block to the restart.
#[derive(Clone, Debug)]
pub(crate) struct Update {
    /// Time of the last turn.
    now: Instant,
    /// Bytes of slot B and of its sectors; 0 without a boot loader.
    slot_len: u32,
    sector_len: u32,
    /// Number of the board; 0 without a boot loader.
    target: u32,
    /// Version of the image in slot B.
    version: ImageVersion,
    phase: Phase,
    confirmation: Confirmation,
    /// The running image has not confirmed itself.
    is_on_trial: bool,
    /// The master, and the time of its last block or command; `None` while motions are possible.
    session: Option<(Master, Instant)>,
    refusal: Option<UpdateRefusal>,
    /// Bytes received and written, and the start of the last block.
    received: u32,
    written: u32,
    block_at: u32,
    /// CRC-32 of the received bytes, with and without the last block.
    crc: u32,
    crc_before: u32,
    operation: Operation,
    /// The sector of the next page was erased for it.
    is_erased: bool,
    /// Received bytes that are not written.
    buffer: [u8; BUFFER_LEN],
}

impl Update {
    pub(crate) const fn new() -> Self {
        Self {
            now: Instant::from_millis(0),
            slot_len: 0,
            sector_len: 0,
            target: 0,
            version: [0; 3],
            phase: Phase::Idle,
            confirmation: Confirmation::Done,
            is_on_trial: false,
            session: None,
            refusal: None,
            received: 0,
            written: 0,
            block_at: 0,
            crc: 0,
            crc_before: 0,
            operation: Operation::Nothing,
            is_erased: false,
            buffer: [0; BUFFER_LEN],
        }
    }

    /// Returns whether a session is in progress, so that motions are refused.
    pub(crate) const fn is_active(&self) -> bool {
        self.session.is_some()
    }

    /// Returns whether no settings may be stored and no session may begin: the running image has not confirmed itself.
    pub(crate) const fn is_on_trial(&self) -> bool {
        self.is_on_trial || matches!(self.confirmation, Confirmation::Runs)
    }

    /// Returns the offset of the next block.
    pub(crate) const fn next(&self) -> u32 {
        self.received
    }

    /// Takes bytes at an offset of the image: the next ones, the last ones again, or the first ones of a new image. `may_begin`
    /// is the reason why no session can begin now.
    pub(crate) fn take_block(
        &mut self,
        master: Master,
        at: u32,
        bytes: &[u8],
        may_begin: Result<(), UpdateRefusal>,
    ) -> Result<(), UpdateRefusal> {
        self.may_enter(master, may_begin)?;
        let is_receiving = self.phase == Phase::Receiving;
        let end = at.saturating_add(bytes.len() as u32);
        let is_repeated = is_receiving
            && (at, end) == (self.block_at, self.received)
            && update_crc(self.crc_before, bytes) == self.crc;
        if !is_repeated {
            self.is_idle().then_some(()).ok_or(UpdateRefusal::Busy)?;
            if at == 0 {
                (self.received, self.written, self.crc, self.is_erased) = (0, 0, 0, false);
            } else if !is_receiving || at != self.received {
                return Err(UpdateRefusal::OutOfOrder);
            }
            let fill = self.received.saturating_sub(self.written) as usize;
            let place = self.buffer.get_mut(fill..).and_then(|rest| rest.get_mut(..bytes.len()));
            let place = place.filter(|_| end <= self.slot_len).ok_or(UpdateRefusal::TooLong)?;
            copy(place, bytes);
            (self.phase, self.block_at, self.received) = (Phase::Receiving, at, end);
            (self.crc_before, self.crc) = (self.crc, update_crc(self.crc, bytes));
        }
        self.session = Some((master, self.now));
        Ok(())
    }

    /// Takes a command. A repeated one has no effect.
    pub(crate) fn take_command(
        &mut self,
        master: Master,
        command: UpdateCommand,
        may_begin: Result<(), UpdateRefusal>,
    ) -> Result<(), UpdateRefusal> {
        self.may_enter(master, may_begin)?;
        match (command, self.phase) {
            (UpdateCommand::Check, Phase::Receiving) if self.received > 0 => self.phase = Phase::Checking,
            (UpdateCommand::Check, Phase::Checking | Phase::Received) => {}
            (UpdateCommand::Restart, Phase::Received) => self.phase = Phase::Stopping(None),
            (UpdateCommand::Restart, _) if self.is_restarting() => {}
            _ => return Err(UpdateRefusal::NothingReceived),
        }
        self.session = Some((master, self.now));
        Ok(())
    }

    fn may_enter(&self, master: Master, may_begin: Result<(), UpdateRefusal>) -> Result<(), UpdateRefusal> {
        match self.session {
            _ if self.slot_len == 0 => Err(UpdateRefusal::NoBootLoader),
            None if self.is_on_trial() => Err(UpdateRefusal::OnTrial),
            None => may_begin,
            Some((other, _)) if other != master => Err(UpdateRefusal::OtherMaster),
            Some(_) => Ok(()),
        }
    }

    /// Records a refusal. Returns whether it differs from the last one.
    pub(crate) fn refuse(&mut self, why: UpdateRefusal) -> bool {
        self.refusal.replace(why) != Some(why)
    }

    /// Returns the outcome of the last block or check; `None` while it is in progress.
    pub(crate) fn outcome(&self) -> Option<Result<(), UpdateRefusal>> {
        match self.phase {
            Phase::Refused => Some(self.refusal.map_or(Ok(()), Err)),
            Phase::Checking => None,
            _ => self.is_idle().then_some(Ok(())),
        }
    }

    /// Returns whether the flash has nothing to do, so that another block fits into the buffer.
    fn is_idle(&self) -> bool {
        let is_full = self.received.saturating_sub(self.written) >= SLOT_PAGE_LEN as u32;
        matches!(self.operation, Operation::Nothing)
            && !is_full
            && !self.is_restarting()
            && self.phase != Phase::Checking
    }

    const fn is_restarting(&self) -> bool {
        matches!(self.phase, Phase::Stopping(_) | Phase::Marking | Phase::Restarting)
    }

    /// Continues in each turn. `is_free`: no FAST STOP is pending. `is_stopped`: the gripper has confirmed the FAST STOP that
    /// precedes a restart. `may_confirm`: the settings are valid, none is being stored, and the fingers stand still.
    ///
    /// Returns whether the FAST STOP must be requested from now on.
    ///
    /// # Errors
    /// The reason why the image or the flash was refused in this turn.
    pub(crate) fn turn(
        &mut self,
        now: Instant,
        slot: &mut dyn Slot,
        is_free: bool,
        is_stopped: bool,
        may_confirm: bool,
    ) -> Result<bool, UpdateRefusal> {
        self.now = now;
        if self.slot_len == 0 {
            (self.slot_len, self.sector_len) = (slot.len(), slot.sector_len());
            (self.target, self.version) = (slot.target(), slot.version());
            (self.is_on_trial, self.confirmation) = (slot.is_on_trial(), Confirmation::Waits(now));
        }
        if !self.is_active() {
            self.confirm(slot, is_free && may_confirm);
        }
        let done = self.advance(slot, is_free, is_stopped);
        if done.is_err() {
            (self.phase, self.session, self.operation) = (Phase::Refused, None, Operation::Nothing);
        }
        let is_over = self.session.is_some_and(|(_, at)| now.since(at) >= PAUSE_MS);
        if is_over && self.is_idle() {
            self.session = None;
        }
        done.map(|()| self.is_restarting())
    }

    /// Confirms the running image once.
    fn confirm(&mut self, slot: &mut dyn Slot, may_begin: bool) {
        match self.confirmation {
            Confirmation::Waits(since)
                if may_begin && self.now.since(since) >= TRIAL_MS && self.is_idle() =>
            {
                self.confirmation = Confirmation::Runs;
            }
            Confirmation::Runs => match slot.confirm(self.now) {
                Err(nb::Error::WouldBlock) => {}
                Err(nb::Error::Other(_)) => self.confirmation = Confirmation::Waits(self.now),
                Ok(()) => (self.confirmation, self.is_on_trial) = (Confirmation::Done, false),
            },
            Confirmation::Waits(_) | Confirmation::Done => {}
        }
    }

    fn advance(&mut self, slot: &mut dyn Slot, is_free: bool, is_stopped: bool) -> Result<(), UpdateRefusal> {
        if let Operation::Erase(since) | Operation::Program(since) = self.operation {
            return match slot.poll(self.now) {
                Err(nb::Error::WouldBlock) if self.now.since(since) < OPERATION_MS => Ok(()),
                Ok(()) => self.end_operation(slot),
                Err(_) => Err(UpdateRefusal::Flash),
            };
        }
        let pending = self.received.saturating_sub(self.written);
        let is_last = self.phase == Phase::Checking && pending > 0;
        match self.phase {
            Phase::Stopping(_) | Phase::Marking => self.restart(slot, is_stopped),
            // Before each operation: it may stop the program, or a check may take long.
            _ if !is_free => Ok(()),
            Phase::Receiving | Phase::Checking if pending >= SLOT_PAGE_LEN as u32 || is_last => {
                self.begin_operation(slot, pending).map_err(|_| UpdateRefusal::Flash)
            }
            Phase::Checking => match slot.check(self.received) {
                Err(nb::Error::WouldBlock) => Ok(()),
                Err(nb::Error::Other(why)) => Err(why),
                Ok(version) => {
                    (self.phase, self.version) = (Phase::Received, version);
                    Ok(())
                }
            },
            _ => Ok(()),
        }
    }

    fn begin_operation(&mut self, slot: &mut dyn Slot, pending: u32) -> Result<(), FlashError> {
        if !self.is_erased && self.written.is_multiple_of(self.sector_len) {
            self.version = [0; 3];
            slot.start_erase(self.written)?;
            self.operation = Operation::Erase(self.now);
            return Ok(());
        }
        if let Some(rest) = self.buffer.get_mut(pending as usize..) {
            rest.fill(0xFF);
        }
        let page = self.buffer.first_chunk().ok_or(FlashError::Failed)?;
        slot.start_program(self.written, page)?;
        self.operation = Operation::Program(self.now);
        Ok(())
    }

    /// Reads a written page back, and moves the rest of the buffer to its start.
    fn end_operation(&mut self, slot: &dyn Slot) -> Result<(), UpdateRefusal> {
        let is_page = matches!(self.operation, Operation::Program(_));
        (self.operation, self.is_erased) = (Operation::Nothing, !is_page);
        if !is_page {
            return Ok(());
        }
        let Some((page, rest)) = self.buffer.split_first_chunk_mut::<SLOT_PAGE_LEN>() else { return Ok(()) };
        for (at, bytes) in (self.written..).step_by(8).zip(page.as_chunks().0) {
            let is_same = slot.read(at).is_ok_and(|read| read == u64::from_le_bytes(*bytes));
            is_same.then_some(()).ok_or(UpdateRefusal::Flash)?;
        }
        copy(page, rest);
        self.written = self.written.saturating_add(SLOT_PAGE_LEN as u32).min(self.received);
        Ok(())
    }

    fn restart(&mut self, slot: &mut dyn Slot, is_stopped: bool) -> Result<(), UpdateRefusal> {
        match self.phase {
            Phase::Stopping(None) => self.phase = Phase::Stopping(Some(self.now)),
            Phase::Stopping(Some(since)) if is_stopped || self.now.since(since) >= STOP_MS => {
                self.phase = Phase::Marking;
            }
            Phase::Marking => match slot.mark(self.now) {
                Err(nb::Error::WouldBlock) => {}
                Err(nb::Error::Other(_)) => return Err(UpdateRefusal::Flash),
                Ok(()) => {
                    self.phase = Phase::Restarting;
                    slot.restart();
                }
            },
            _ => {}
        }
        Ok(())
    }

    const fn state(&self) -> u16 {
        match self.phase {
            Phase::Receiving if self.is_active() => 1,
            Phase::Idle | Phase::Receiving => 0,
            Phase::Checking => 2,
            Phase::Received => 3,
            Phase::Refused => 4,
            Phase::Stopping(_) | Phase::Marking | Phase::Restarting => 5,
        }
    }
}

report_rows! { Update as it:
    212 "UPDATE_STATE" "update: 0 none or interrupted, 1 receives blocks, 2 checks the image, 3 received and checked, 4 refused, 5 restarts"
        it.state();
    213 "UPDATE_REFUSAL" (UpdateRefusal::MEANING) it.refusal.map_or(0, |why| why as u16);
    214 "UPDATE_BYTES_HIGH" "bytes of the image received so far, bits 31 to 16" (it.received >> 16) as u16;
    215 "UPDATE_BYTES_LOW" "bytes of the image received so far, bits 15 to 0" it.received as u16;
    216 "UPDATE_CRC_HIGH" "CRC-32 (ISO-HDLC) of these bytes, bits 31 to 16" (it.crc >> 16) as u16;
    217 "UPDATE_CRC_LOW" "CRC-32 of these bytes, bits 15 to 0" it.crc as u16;
    218 "SLOT_B_VERSION" "version of the image in slot B: high byte major, low byte minor; 0 with SLOT_B_PATCH 0: none"
        { let [major, minor, _] = it.version; u16::from_be_bytes([major, minor]) };
    219 "SLOT_B_PATCH" "its patch level" { let [.., patch] = it.version; patch.into() };
    220 "UPDATE_BOARD_HIGH" "number of the board in the manifests of its images, bits 31 to 16; 0 with UPDATE_BOARD_LOW 0: no boot loader for updates"
        (it.target >> 16) as u16;
    221 "UPDATE_BOARD_LOW" "its bits 15 to 0" it.target as u16;
}

/// Excludes the update: the exploration has none.
impl Hash for Update {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

/// Returns the CRC-32 of UPDATE_CRC_HIGH and UPDATE_CRC_LOW, of bytes that follow others with this CRC-32.
///
/// ```
/// use wsg_bridge_fw::registers::update_crc;
///
/// assert_eq!(update_crc(update_crc(0, b"1234"), b"56789"), 0xCBF4_3926, "the check value of the catalogue");
/// ```
#[must_use]
pub fn update_crc(before: u32, bytes: &[u8]) -> u32 {
    let mut digest = CRC.digest_with_initial((!before).reverse_bits());
    digest.update(bytes);
    digest.finalize()
}

/// Copies as many bytes as both have.
fn copy(to: &mut [u8], from: &[u8]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}
