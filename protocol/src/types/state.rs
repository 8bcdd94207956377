//! Gripper state, homing direction, and the form of update requests.

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
            /// Every value, in order.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The byte that stands for it.
            #[must_use]
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// The value that the byte stands for.
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
    /// Where the gripping process stands (command set, 3.4.2 and appendix C).
    GripperState {
        /// Waiting for a command.
        #[default]
        0 Idle "IDLE";
        /// The fingers close to grip a part.
        1 Gripping "GRIPPING";
        /// The fingers closed and found no part.
        2 NoPart "NO PART";
        /// A part was held and went.
        3 PartLost "PART LOST";
        /// A part is held with the gripping force.
        4 Holding "HOLDING";
        /// The fingers open to release a part.
        5 Releasing "RELEASING";
        /// The fingers pre-position, or home.
        6 Positioning "POSITIONING";
        /// An error occurred.
        7 Error "ERROR";
    }
}

impl GripperState {
    /// Whether a motion command is being carried out in this state.
    #[must_use]
    pub const fn is_motion(self) -> bool {
        matches!(self, Self::Gripping | Self::Releasing | Self::Positioning)
    }
}

byte_enum! {
    /// Which end stop homing goes to (command set, 3.2.1).
    HomingDirection {
        /// As the gripper is configured.
        #[default]
        0 Default "default direction";
        /// Outward: fingers open.
        1 Positive "positive direction";
        /// Inward: fingers close.
        2 Negative "negative direction";
    }
}

/// Whether a value is asked for once, or sent again and again (command set, 3.4.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, crate::Format)]
pub struct AutoUpdate {
    /// What is asked for.
    pub flags: UpdateFlags,
    /// The least time between two updates in milliseconds. The manual's minimum is 10.
    pub period_ms: u16,
}

impl AutoUpdate {
    /// The manual's minimum of the period, in milliseconds.
    pub const MIN_PERIOD_MS: u16 = 10;

    /// One answer now; updates end.
    #[must_use]
    pub const fn once() -> Self {
        Self { flags: UpdateFlags::empty(), period_ms: 0 }
    }

    /// An update every `period_ms` milliseconds.
    #[must_use]
    pub const fn every(period_ms: u16) -> Self {
        Self { flags: UpdateFlags::AUTOMATIC, period_ms }
    }

    /// An update at each change, at least `period_ms` milliseconds apart.
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
