//! Bit vectors: system state (appendix B), finger flags, and the flags of requests.

use crate::field::{DecodeError, fixed_field};
use bitflags::bitflags;

bitflags! {
    /// The system state flags (command set, appendix B). Reserved bits are preserved.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct SystemFlags: u32 {
        /// D0: the fingers are referenced and motion commands are accepted.
        const REFERENCED = 1 << 0;
        /// D1: the fingers are moving.
        const MOVING = 1 << 1;
        /// D2: the axis is blocked in negative moving direction.
        const BLOCKED_MINUS = 1 << 2;
        /// D3: the axis is blocked in positive moving direction.
        const BLOCKED_PLUS = 1 << 3;
        /// D4: the soft limit in negative moving direction is reached.
        const SOFT_LIMIT_MINUS = 1 << 4;
        /// D5: the soft limit in positive moving direction is reached.
        const SOFT_LIMIT_PLUS = 1 << 5;
        /// D6: a motion was ended by Stop; the next motion clears it.
        const AXIS_STOPPED = 1 << 6;
        /// D7: the target position is reached; may be set some time after MOVING is cleared.
        const TARGET_POS_REACHED = 1 << 7;
        /// D8: forces up to the overdrive limit are allowed.
        const OVERDRIVE_MODE = 1 << 8;
        /// D9: the force is controlled by a force measurement finger.
        const FORCECNTL_MODE = 1 << 9;
        /// D12: FAST STOP: motion is refused until it is acknowledged.
        const FAST_STOP = 1 << 12;
        /// D13: the hardware will soon be too hot.
        const TEMP_WARNING = 1 << 13;
        /// D14: the hardware is too hot; motion is refused.
        const TEMP_FAULT = 1 << 14;
        /// D15: the supply voltage is out of range.
        const POWER_FAULT = 1 << 15;
        /// D16: the motor is at its thermal limit.
        const CURR_FAULT = 1 << 16;
        /// D17: a finger is in fault; see the finger flags.
        const FINGER_FAULT = 1 << 17;
        /// D18: the last command returned an error.
        const CMD_FAILURE = 1 << 18;
        /// D19: a script runs on the gripper.
        const SCRIPT_RUNNING = 1 << 19;
        /// D20: a script ended with an error.
        const SCRIPT_FAILURE = 1 << 20;
    }

    /// The state flags of a finger (command set, 3.6.2; bit 10 from the GCL manual). Reserved bits are preserved.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub struct FingerFlags: u16 {
        /// Bit 0: the finger is powered.
        const POWER_ON = 1 << 0;
        /// Bit 1: the finger provides configuration data.
        const CONFIG_AVAIL = 1 << 1;
        /// Bit 2: a communication interface is open.
        const COMM_OPEN = 1 << 2;
        /// Bit 8: over-current was detected.
        const POWER_FAULT = 1 << 8;
        /// Bit 9: communication failed at run time.
        const COMM_FAULT = 1 << 9;
        /// Bit 10: the finger failed to initialize.
        const INIT_FAULT = 1 << 10;
    }

    /// The flags of Pre-position Fingers (command set, 3.2.2). Some public drivers swap the two.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct PrePositionFlags: u8 {
        /// D0: the width is an offset to the current opening width.
        const RELATIVE = 1 << 0;
        /// D1: on a block the motor is turned off; without it the fingers clamp with half of the nominal force.
        const STOP_ON_BLOCK = 1 << 1;
    }

    /// The flags of the commands that support automatic updates (command set, 3.4.1).
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct UpdateFlags: u8 {
        /// D0: updates are sent from now on. If clear, updates end.
        const AUTOMATIC = 1 << 0;
        /// D1: updates are sent only on a change.
        const ON_CHANGE = 1 << 1;
    }
}

impl SystemFlags {
    /// The flags in which a gripper rejects motion commands.
    pub const LOCKS: Self =
        Self::FAST_STOP.union(Self::TEMP_FAULT).union(Self::POWER_FAULT).union(Self::CURR_FAULT);
}

/// Reserved bits are rejected in requests, and preserved in replies for later firmware.
macro_rules! bit_field {
    ($type:ident, $len:literal, $bits:ty, strict) => {
        fixed_field!($type, $len, |flags| flags.bits().to_le_bytes(), |bytes| {
            Self::from_bits(<$bits>::from_le_bytes(bytes)).ok_or(DecodeError::ReservedBits)
        }, check |flags| if Self::all().contains(*flags) { Ok(()) } else { Err(DecodeError::ReservedBits) });
        bit_field!(@text $type);
    };
    ($type:ident, $len:literal, $bits:ty, retain) => {
        fixed_field!($type, $len, |flags| flags.bits().to_le_bytes(), |bytes| {
            Ok(Self::from_bits_retain(<$bits>::from_le_bytes(bytes)))
        });
        bit_field!(@text $type);
    };
    (@text $type:ident) => {
        impl core::fmt::Display for $type {
            /// Formats the names of the set bits, or `0` if there are none.
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                if self.bits() == 0 { f.write_str("0") } else { bitflags::parser::to_writer(self, f) }
            }
        }

        #[cfg(feature = "defmt")]
        impl defmt::Format for $type {
            fn format(&self, f: defmt::Formatter<'_>) {
                defmt::write!(f, "{=u32:#x}", u32::from(self.bits()));
            }
        }
    };
}

bit_field!(SystemFlags, 4, u32, retain);
bit_field!(FingerFlags, 2, u16, retain);
bit_field!(PrePositionFlags, 1, u8, strict);
bit_field!(UpdateFlags, 1, u8, strict);
