//! State of the CAN bus and of the gripper's link on it, for reports.

use wsg_protocol::can;

use super::{BusState, Health};
use crate::register::report_rows;

/// Faults of the bus since power-up. Each count saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BusCounters {
    /// Transitions to bus-off since power-up; stops at 65 535.
    pub bus_offs: u16,
    /// Received frames for which the controller had no room.
    pub overruns: u16,
    /// Frames that the controller refused to send.
    pub refused: u16,
}

/// Faults of the link since power-up. Each count saturates at 65 535.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Faults on the bus, below messages.
    pub frames: can::ReassemblerCounters,
    /// Messages for which there was no room, because the bridge did not read.
    pub overflows: u16,
    /// Messages to the gripper that were sent only in part.
    pub broken: u16,
}

/// State of a node's bus, for the reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct BusReport {
    /// Participation of the bridge in the bus.
    pub state: BusState,
    /// State of the controller's error confinement.
    pub health: Health,
    /// Faults of the bus.
    pub counters: BusCounters,
    /// Faults of the gripper's link; all 0 if the gripper is not on this bus.
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

/// Reports on CAN as registers: state, transmit and receive errors, bus-offs, overruns, dropped frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CanReports(pub [u16; 6]);

impl CanReports {
    /// No CAN: all 0.
    pub const NONE: Self = Self([0; 6]);

    /// Returns whether the controller is off the bus: bus-off, recovering or given up.
    pub(crate) const fn is_off(&self) -> bool {
        self.0[0] & 0x7F != 0
    }

    /// Returns the number of transitions to bus-off.
    pub(crate) const fn bus_offs(&self) -> u16 {
        self.0[3]
    }
}

report_rows! { CanReports as it:
    126 "CAN_STATE" "CAN state: 0 on the bus, 1 bus-off, 2 recovering, 3 given up; plus 128: error passive. Without CAN, all CAN registers are 0"
        it.0[0];
    127 "CAN_TEC" "CAN: transmit error counter" it.0[1];
    128 "CAN_REC" "CAN: receive error counter" it.0[2];
    129 "CAN_BUS_OFFS" "CAN: number of transitions to bus-off" it.0[3];
    130 "CAN_OVERRUNS" "CAN: received frames lost because the controller was full" it.0[4];
    131 "CAN_DROPPED" "CAN: frames from the gripper outside of intact messages" it.0[5];
}
