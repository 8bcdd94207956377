//! Gripper state, homing direction and update settings.

use super::UpdateFlags;
use crate::field::{DecodeError, fixed_field};

macro_rules! byte_enum {
    ($(#[$doc:meta])* $type:ident { $($(#[$item_doc:meta])* $code:literal $name:ident $text:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, crate::Format)]
        pub enum $type {
            $($(#[$item_doc])* $name = $code,)*
        }

        impl $type {
            /// All values, in the order of their codes.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Returns the byte that encodes the value.
            #[must_use]
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// Returns the value for this code, or `None` if the manual does not define it.
            #[must_use]
            pub const fn from_code(code: u8) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)*
                    _ => None,
                }
            }
        }

        impl core::fmt::Display for $type {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(match self {
                    $(Self::$name => $text,)*
                })
            }
        }

        fixed_field!($type, 1, |value| [value.code()], |bytes| {
            let [code] = bytes;
            Self::from_code(code).ok_or(DecodeError::UndefinedValue)
        });
    };
}

byte_enum! {
    /// The state of the gripping process (command set, 3.4.2 and appendix C).
    GripperState {
        /// Waiting for a command.
        #[default]
        0 Idle "IDLE";
        /// The fingers are closing to grip a part.
        1 Gripping "GRIPPING";
        /// The fingers closed without finding a part.
        2 NoPart "NO PART";
        /// A held part was lost.
        3 PartLost "PART LOST";
        /// A part is held with the gripping force.
        4 Holding "HOLDING";
        /// The fingers are opening to release a part.
        5 Releasing "RELEASING";
        /// The fingers are pre-positioning or homing.
        6 Positioning "POSITIONING";
        /// An error occurred; motion is not possible.
        7 Error "ERROR";
    }
}

impl GripperState {
    /// Returns whether a motion command is in progress in this state.
    #[must_use]
    pub const fn is_motion(self) -> bool {
        matches!(self, Self::Gripping | Self::Releasing | Self::Positioning)
    }
}

byte_enum! {
    /// The end stop to which homing moves (command set, 3.2.1).
    HomingDirection {
        /// The direction configured in the gripper.
        #[default]
        0 Default "default direction";
        /// Outward: the fingers open.
        1 Positive "positive direction";
        /// Inward: the fingers close.
        2 Negative "negative direction";
    }
}

/// Whether a value is queried once or updated periodically (command set, 3.4.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, crate::Format)]
pub struct AutoUpdate {
    /// Whether updates follow and whether only changes are sent; empty for a single reply.
    pub flags: UpdateFlags,
    /// The minimum time between two updates, in milliseconds. The manual's minimum is 10.
    pub period_ms: u16,
}

impl AutoUpdate {
    /// The minimum period according to the manual, in milliseconds.
    pub const MIN_PERIOD_MS: u16 = 10;

    /// Requests one reply now and ends all updates.
    #[must_use]
    pub const fn once() -> Self {
        Self { flags: UpdateFlags::empty(), period_ms: 0 }
    }

    /// Requests an update every `period_ms` milliseconds.
    #[must_use]
    pub const fn every(period_ms: u16) -> Self {
        Self { flags: UpdateFlags::AUTOMATIC, period_ms }
    }

    /// Requests an update on each change, at least `period_ms` milliseconds apart.
    #[must_use]
    pub const fn on_change(period_ms: u16) -> Self {
        Self { flags: UpdateFlags::AUTOMATIC.union(UpdateFlags::ON_CHANGE), period_ms }
    }
}

impl core::fmt::Display for AutoUpdate {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if !self.flags.contains(UpdateFlags::AUTOMATIC) {
            f.write_str("once")
        } else if self.flags.contains(UpdateFlags::ON_CHANGE) {
            write!(f, "on change, {} ms apart", self.period_ms)
        } else {
            write!(f, "every {} ms", self.period_ms)
        }
    }
}

fixed_field!(
    AutoUpdate,
    3,
    |update| {
        let [low, high] = update.period_ms.to_le_bytes();
        [update.flags.bits(), low, high]
    },
    |bytes| {
        let [flags, low, high] = bytes;
        let flags = UpdateFlags::from_bits(flags).ok_or(DecodeError::ReservedBits)?;
        Ok(Self { flags, period_ms: u16::from_le_bytes([low, high]) })
    },
    check
        | update
        | if UpdateFlags::all().contains(update.flags) { Ok(()) } else { Err(DecodeError::ReservedBits) }
);
