//! Records of rare events for the crate `log` (feature `log`). Without the feature, a journal is empty and records nothing.
//!
//! A record may wait for the program's logger. So it is made after the message that it reports is sent, and under no lock.

use crate::session::Event;
use core::fmt::Arguments;

/// The journal of a gripper.
#[derive(Clone, Debug)]
pub(super) struct Journal {
    /// The name of the gripper in its records.
    #[cfg(feature = "log")]
    name: std::borrow::Cow<'static, str>,
    /// Whether the end of the connection was announced, so that it is not a loss.
    #[cfg(feature = "log")]
    is_announced: bool,
}

#[cfg(feature = "log")]
impl Journal {
    pub(super) const NEW: Self = Self { name: std::borrow::Cow::Borrowed("gripper"), is_announced: false };

    pub(super) fn set_name(&mut self, name: &str) {
        self.name = std::string::String::from(name).into();
    }

    /// Records an event of normal operation.
    pub(super) fn info(&self, text: Arguments<'_>) {
        log::info!(target: "wsg_protocol", "{}: {text}", self.name);
    }

    /// Records an event that needs attention.
    pub(super) fn warn(&self, text: Arguments<'_>) {
        log::warn!(target: "wsg_protocol", "{}: {text}", self.name);
    }

    /// Records beginning, loss and announced end of the connection.
    pub(super) fn note(&mut self, event: &Event<'_>) {
        match event {
            Event::Connected => {
                self.is_announced = false;
                self.info(format_args!("connected"));
            }
            Event::Disconnected if !self.is_announced => self.warn(format_args!("connection lost")),
            Event::Answered(reply)
                if reply.id() == crate::CommandId::DisconnectAnnouncement
                    && reply.status() == crate::Status::Success =>
            {
                self.is_announced = true;
                self.info(format_args!("disconnect announced"));
            }
            _ => {}
        }
    }
}

#[cfg(not(feature = "log"))]
impl Journal {
    pub(super) const NEW: Self = Self {};

    #[cfg(feature = "std")]
    pub(super) fn info(&self, _: Arguments<'_>) {}

    pub(super) fn warn(&self, _: Arguments<'_>) {}

    pub(super) fn note(&mut self, _: &Event<'_>) {}
}
