//! Blocks of Control and Release, and headers of records.

use crate::connect::next_block;
use crate::cursor::{Reader, Writer};
use crate::records::Address;
use crate::rpc::PnioStatus;

/// Block types of Control, of Release and of records.
pub(super) mod block {
    pub(in crate::device) const WRITE: u16 = 0x0008;
    pub(in crate::device) const READ: u16 = 0x0009;
    pub(in crate::device) const END_OF_PARAMETERS: u16 = 0x0110;
    pub(in crate::device) const READY: u16 = 0x0112;
    pub(in crate::device) const RELEASE: u16 = 0x0114;
    /// Flag of a block in an answer.
    pub(in crate::device) const ANSWER: u16 = 0x8000;
    pub(in crate::device) const AR: u16 = 0x8101;
    pub(in crate::device) const IOCR: u16 = 0x8102;
    pub(in crate::device) const ALARM_CR: u16 = 0x8103;
}

/// Commands of Control and Release blocks.
pub(super) mod command {
    pub(in crate::device) const END_OF_PARAMETERS: u16 = 1;
    pub(in crate::device) const READY: u16 = 2;
    pub(in crate::device) const RELEASE: u16 = 4;
    pub(in crate::device) const DONE: u16 = 8;
}

/// A block of Control or Release.
#[derive(Clone, Copy, Debug)]
pub(super) struct ControlBlock {
    pub(super) kind: u16,
    pub(super) uuid: [u8; 16],
    pub(super) session_key: u16,
    pub(super) command: u16,
}

impl ControlBlock {
    pub(super) const LEN: usize = 32;

    pub(super) fn parse(blocks: &[u8]) -> Option<Self> {
        let mut reader = Reader::new(blocks);
        let (kind, body) = next_block(&mut reader)?;
        let mut body = Reader::new(body);
        body.skip(2)?;
        let uuid = body.array()?;
        let session_key = body.u16()?;
        body.skip(2)?;
        let command = body.u16()?;
        body.skip(2)?;
        Some(Self { kind, uuid, session_key, command })
    }

    pub(super) fn write(&self, writer: &mut Writer<'_>) {
        writer.block(self.kind, 0, |writer| {
            writer.u16(0);
            writer.bytes(&self.uuid);
            writer.u16s(&[self.session_key, 0, self.command, 0]);
        });
    }

    /// Writes the answer that the command is done.
    pub(super) fn answer(&self, writer: &mut Writer<'_>) {
        Self { kind: self.kind | block::ANSWER, command: command::DONE, ..*self }.write(writer);
    }
}

/// Header of a record to read or write.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    pub(super) sequence: u16,
    pub(super) uuid: [u8; 16],
    pub(super) address: Address,
    pub(super) len: usize,
}

impl Record {
    /// Length of the header in requests and answers.
    pub(super) const ANSWER_LEN: usize = 64;

    pub(super) fn parse(reader: &mut Reader<'_>, kind: u16) -> Option<Self> {
        let (found, body) = next_block(reader)?;
        let mut body = Reader::new(body);
        let sequence = body.u16()?;
        let uuid = body.array()?;
        let api = body.u32()?;
        let slot = body.u16()?;
        let subslot = body.u16()?;
        body.skip(2)?;
        let index = body.u16()?;
        let len = usize::try_from(body.u32()?).ok()?;
        body.skip(24)?;
        (found == kind).then_some(Self {
            sequence,
            uuid,
            address: Address { api, slot, subslot, index },
            len,
        })
    }

    /// Parses the next write with its data.
    pub(super) fn parse_with_data<'a>(reader: &mut Reader<'a>) -> Option<(Self, &'a [u8])> {
        let record = Self::parse(reader, block::WRITE)?;
        Some((record, reader.bytes(record.len)?))
    }

    /// Writes the header of an answer. An answer to a read has no status of its own; pass OK.
    pub(super) fn answer(&self, writer: &mut Writer<'_>, kind: u16, len: usize, status: PnioStatus) {
        writer.block(kind | block::ANSWER, 0, |writer| {
            writer.u16(self.sequence);
            writer.bytes(&self.uuid);
            writer.u32(self.address.api);
            writer.u16s(&[self.address.slot, self.address.subslot, 0, self.address.index]);
            writer.u32(len as u32);
            writer.u32(0);
            writer.u32(status.0);
            writer.fill(0, 16);
        });
    }

    /// Writes the answer to a write.
    pub(super) fn answer_write(&self, writer: &mut Writer<'_>, len: usize, result: Result<(), u8>) {
        let status = result.map_or_else(PnioStatus::write, |()| PnioStatus::OK);
        self.answer(writer, block::WRITE, len, status);
    }
}
