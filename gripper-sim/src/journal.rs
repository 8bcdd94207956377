//! Events for the system log (command set, 3.2.4 and 3.3.8): changes of the system state that an operator must be able
//! to trace, each with its cause. The server adds connections, settings and scripts.

use crate::port::PortId;
use crate::time::Time;
use heapless::Deque;
use wsg_protocol::SystemFlags;

/// Capacity of the queue. The caller takes the events after each call, which causes far fewer.
const MAX_WAITING: usize = 32;

/// The flags whose changes are logged.
const LOGGED: SystemFlags = SystemFlags::FAST_STOP
    .union(SystemFlags::OVERDRIVE_MODE)
    .union(SystemFlags::TEMP_WARNING)
    .union(SystemFlags::TEMP_FAULT)
    .union(SystemFlags::POWER_FAULT)
    .union(SystemFlags::CURR_FAULT)
    .union(SystemFlags::FINGER_FAULT);

/// A change of one system state flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JournalEvent {
    /// The time of the change.
    pub at: Time,
    /// The flag that changed: FAST_STOP, OVERDRIVE_MODE, or one of the faults and warnings.
    pub flag: SystemFlags,
    /// Whether the flag was set. Otherwise it was cleared.
    pub is_set: bool,
    /// The cause of the change.
    pub cause: Cause,
}

/// The cause of a change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Cause {
    /// A fault of the device, which FAST STOP follows.
    #[default]
    Fault,
    /// Fingers that moved beyond a soft limit.
    SoftLimit,
    /// A command of this client.
    Client(PortId),
    /// The end of this client's connection without a Disconnect Announcement (command set, 1.4.2).
    Disconnected(PortId),
    /// The master that wrote the register interface last; `None` if it is no longer connected.
    Fieldbus(Option<PortId>),
    /// A command of an operator or of a script.
    Operator,
}

impl Cause {
    /// Returns the cause that the sender of a request is.
    pub(crate) fn of(port: PortId) -> Self {
        match port {
            PortId::HAND => Self::Operator,
            PortId::FIELDBUS => Self::Fieldbus(None),
            client => Self::Client(client),
        }
    }
}

/// The events that the caller has not taken yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Journal {
    flags: SystemFlags,
    waiting: Deque<JournalEvent, MAX_WAITING>,
}

impl Journal {
    /// Compares the flags with the flags of the last call and queues an event for each logged change. A full queue drops
    /// its oldest event: only a caller that takes none fills it.
    pub(crate) fn observe(&mut self, at: Time, flags: SystemFlags, cause: Cause) {
        let changed = self.flags.symmetric_difference(flags).intersection(LOGGED);
        self.flags = flags;
        for flag in changed.iter() {
            if self.waiting.is_full() {
                self.waiting.pop_front();
            }
            // There is room now.
            let _ = self.waiting.push_back(JournalEvent { at, flag, is_set: flags.contains(flag), cause });
        }
    }

    pub(crate) fn take(&mut self) -> Option<JournalEvent> {
        self.waiting.pop_front()
    }
}
