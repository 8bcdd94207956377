//! What is known of the bus and of the gripper's link on it, for those who report it.

use wsg_protocol::can;

use super::{BusState, Health};
use crate::registers::CanReports;

/// What the bus has met so far; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// How often the controller went bus-off.
    pub bus_offs: u16,
    /// How often the controller had no room for a frame that it received.
    pub overruns: u16,
    /// Frames that the controller refused to send.
    pub refused: u16,
}

/// What the link could not use so far; each count stops at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// On the bus, below messages.
    pub frames: can::ReassemblerCounters,
    /// Messages for which there was no room, because the bridge did not read.
    pub overflows: u16,
    /// Messages to the gripper of which a part did not leave.
    pub broken: u16,
}

/// What a node knows of its bus, for the counters.
#[derive(Clone, Copy, Debug, Default)]
pub struct BusReport {
    /// How the bridge stands to the bus.
    pub state: BusState,
    /// How the controller sees the bus.
    pub health: Health,
    /// What the bus has met.
    pub counters: BusCounters,
    /// What the gripper's link has met; nothing where it is not on this bus.
    pub link: LinkCounters,
}

impl BusReport {
    pub(crate) const NOTHING: Self = Self {
        state: BusState::On,
        health: Health { is_off: false, is_passive: false, transmit_errors: 0, receive_errors: 0 },
        counters: BusCounters { bus_offs: 0, overruns: 0, refused: 0 },
        link: LinkCounters {
            frames: can::ReassemblerCounters {
                foreign: 0,
                dropped: 0,
                miscut: 0,
                bad_checksum: 0,
                oversize: 0,
                expired: 0,
            },
            overflows: 0,
            broken: 0,
        },
    };

    /// Returns the reports about CAN.
    #[must_use]
    pub const fn registers(&self) -> CanReports {
        let Self { state, health, counters, link } = self;
        let passive = if health.is_passive { 0x80 } else { 0 };
        CanReports([
            *state as u16 | passive,
            health.transmit_errors as u16,
            health.receive_errors as u16,
            counters.bus_offs,
            counters.overruns,
            link.frames.dropped,
        ])
    }
}
