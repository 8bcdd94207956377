//! A receive FIFO of three messages (RM0351, 46.7.3, 46.9.2, 46.9.3).

use std::collections::VecDeque;

use super::filters::rir;
use crate::can_wire::WireFrame;

const DEPTH: usize = 3;

/// Bits of RFxR.
const FULL: u32 = 1 << 3;
const FOVR: u32 = 1 << 4;
const RFOM: u32 = 1 << 5;

/// RIxR, RDTxR, RDLxR, RDHxR.
type Message = [u32; 4];

#[derive(Clone, Debug, Default)]
pub(super) struct Fifo {
    messages: VecDeque<Message>,
    /// Content of the output registers.
    output: Message,
    is_full: bool,
    is_overrun: bool,
}

impl Fifo {
    pub(super) fn rfr(&self) -> u32 {
        let flag = |bit, is_set: bool| if is_set { bit } else { 0 };
        self.messages.len() as u32 | flag(FULL, self.is_full) | flag(FOVR, self.is_overrun)
    }

    pub(super) fn store_rfr(&mut self, value: u32) {
        if value & FULL != 0 {
            self.is_full = false;
        }
        if value & FOVR != 0 {
            self.is_overrun = false;
        }
        if value & RFOM != 0 && self.messages.pop_front().is_some() {
            self.show();
        }
    }

    pub(super) fn load(&self, offset: u32) -> u32 {
        self.output[(offset / 4) as usize]
    }

    pub(super) fn has_message(&self) -> bool {
        !self.messages.is_empty()
    }

    /// Stores a message that passed a filter. When full, the third message is overwritten.
    pub(super) fn put(&mut self, frame: &WireFrame, filter: u8) {
        if self.messages.len() == DEPTH {
            self.is_overrun = true;
            self.messages.pop_back();
        }
        self.messages.push_back(message(frame, filter));
        self.is_full |= self.messages.len() == DEPTH;
        self.show();
    }

    /// Updates the output registers; an empty FIFO keeps its last output.
    fn show(&mut self) {
        if let Some(message) = self.messages.front() {
            self.output = *message;
        }
    }
}

fn message(frame: &WireFrame, filter: u8) -> Message {
    let [low, high] = frame.words();
    [rir(frame), u32::from(frame.dlc) | u32::from(filter) << 8, low, high]
}
