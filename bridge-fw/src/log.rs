//! What the bridge logs, with the feature `defmt`: commands sent and what the session noticed.

use wsg_protocol::Command;
use wsg_protocol::session::Event;

#[cfg(feature = "defmt")]
pub(crate) fn sent(command: &Command<'_>) {
    defmt::debug!("-> {}", command);
}

#[cfg(feature = "defmt")]
pub(crate) fn noticed(event: &Event<'_>) {
    defmt::debug!("<- {}", event);
}

#[cfg(not(feature = "defmt"))]
pub(crate) const fn sent(_: &Command<'_>) {}

#[cfg(not(feature = "defmt"))]
pub(crate) const fn noticed(_: &Event<'_>) {}
