//! Messages from the gripper that the line has not delivered.

use wsg_protocol::{CommandId, Status};

use crate::gripper_states::Answer;

/// Messages in transit to the bridge, in order.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answers {
    /// Each with a flag that it has already been delivered once.
    waiting: [(Answer, bool); Self::ROOM],
    len: usize,
}

impl Answers {
    const ROOM: usize = 16;

    pub(super) const NONE: Self =
        Self { waiting: [(Answer::status(CommandId::Loop, Status::Success), false); Self::ROOM], len: 0 };

    pub(super) fn waiting(&self) -> &[(Answer, bool)] {
        &self.waiting[..self.len]
    }

    /// Appends a message. Replies to a burst of FAST STOPs count as one. A message that does not fit is lost.
    pub(super) fn push(&mut self, answer: Answer) {
        let is_of_burst = answer.id == CommandId::FastStop && self.waiting().last() == Some(&(answer, false));
        if !is_of_burst && self.len < Self::ROOM {
            self.waiting[self.len] = (answer, false);
            self.len += 1;
        }
    }

    pub(super) fn pop(&mut self) -> Option<Answer> {
        let (first, _) = *self.waiting().first()?;
        self.waiting.copy_within(1.., 0);
        self.len -= 1;
        Some(first)
    }

    /// Returns the first message and keeps it for a second delivery.
    pub(super) fn repeat(&mut self) -> Option<Answer> {
        let (first, is_repeated) = self.waiting[..self.len].first_mut()?;
        *is_repeated = true;
        Some(*first)
    }
}

impl std::hash::Hash for Answers {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.waiting().hash(state);
    }
}
