//! Status codes (command set, appendix A).

use crate::field::fixed_field;

macro_rules! statuses {
    ($($code:literal $name:ident $symbol:literal $meaning:literal;)*) => {
        /// The status code at the start of every reply (command set, appendix A).
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
        pub enum Status {
            $(#[doc = concat!($symbol, " (", $code, "): ", $meaning, ".")] $name,)*
            /// A code that the manual does not define.
            Unknown(u16),
        }

        impl Status {
            /// All codes of the manual, in order.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Returns the numeric code of the status.
            #[must_use]
            pub const fn code(self) -> u16 {
                match self {
                    $(Self::$name => $code,)*
                    Self::Unknown(code) => code,
                }
            }

            /// Returns the status for this numeric code.
            #[must_use]
            pub const fn from_code(code: u16) -> Self {
                match code {
                    $($code => Self::$name,)*
                    code => Self::Unknown(code),
                }
            }

            /// Returns the manual's name, such as `E_CMD_PENDING`, or `E_?` for a code that the manual does not define.
            #[must_use]
            pub const fn symbol(self) -> &'static str {
                match self {
                    $(Self::$name => $symbol,)*
                    Self::Unknown(_) => "E_?",
                }
            }

            /// Returns the meaning of the status as text.
            ///
            /// ```
            /// use wsg_protocol::Status;
            ///
            /// assert_eq!(Status::CmdAborted.meaning(), "command aborted, by Stop for example");
            /// ```
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$name => $meaning,)*
                    Self::Unknown(_) => "a status that the manual does not list",
                }
            }
        }
    };
}

statuses! {
    0 Success "E_SUCCESS" "no error";
    1 NotAvailable "E_NOT_AVAILABLE" "function or data not available";
    2 NoSensor "E_NO_SENSOR" "no measurement converter connected";
    3 NotInitialized "E_NOT_INITIALIZED" "device not initialized: the fingers are not referenced";
    4 AlreadyRunning "E_ALREADY_RUNNING" "already running: the fingers move or hold a part";
    5 FeatureNotSupported "E_FEATURE_NOT_SUPPORTED" "feature currently not available";
    6 InconsistentData "E_INCONSISTENT_DATA" "parameters contradict each other";
    7 Timeout "E_TIMEOUT" "time-out";
    8 ReadError "E_READ_ERROR" "error while reading";
    9 WriteError "E_WRITE_ERROR" "error while writing";
    10 InsufficientResources "E_INSUFFICIENT_RESOURCES" "out of memory";
    11 ChecksumError "E_CHECKSUM_ERROR" "wrong checksum";
    12 NoParamExpected "E_NO_PARAM_EXPECTED" "parameter given where none is expected";
    13 NotEnoughParams "E_NOT_ENOUGH_PARAMS" "too few parameters";
    14 CmdUnknown "E_CMD_UNKNOWN" "unknown command";
    15 CmdFormatError "E_CMD_FORMAT_ERROR" "command format wrong, its length for example";
    16 AccessDenied "E_ACCESS_DENIED" "access denied, in FAST STOP for example";
    17 AlreadyOpen "E_ALREADY_OPEN" "interface already open";
    18 CmdFailed "E_CMD_FAILED" "command failed; after Grip Part: no part found";
    19 CmdAborted "E_CMD_ABORTED" "command aborted, by Stop for example";
    20 InvalidHandle "E_INVALID_HANDLE" "invalid handle";
    21 NotFound "E_NOT_FOUND" "device or file not found";
    22 NotOpen "E_NOT_OPEN" "device or file not open";
    23 IoError "E_IO_ERROR" "input or output error";
    24 InvalidParameter "E_INVALID_PARAMETER" "wrong parameter";
    25 IndexOutOfBounds "E_INDEX_OUT_OF_BOUNDS" "index out of bounds";
    26 CmdPending "E_CMD_PENDING" "no error: the command runs, another reply brings its result";
    27 Overrun "E_OVERRUN" "data overrun";
    28 RangeError "E_RANGE_ERROR" "range error";
    29 AxisBlocked "E_AXIS_BLOCKED" "axis blocked";
    30 FileExists "E_FILE_EXISTS" "file exists already";
}

impl Status {
    /// Returns whether this status completes a command, as all but E_CMD_PENDING do.
    #[must_use]
    pub const fn is_final(self) -> bool {
        !matches!(self, Self::CmdPending)
    }
}

impl core::fmt::Display for Status {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Unknown(code) => write!(f, "E_? ({code})"),
            known => f.write_str(known.symbol()),
        }
    }
}

fixed_field!(Status, 2, |status| status.code().to_le_bytes(), |bytes| Ok(Self::from_code(
    u16::from_le_bytes(bytes)
)));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_31_codes_stand_at_their_own_index() {
        assert_eq!(Status::ALL.len(), 31);
        for (index, status) in Status::ALL.iter().enumerate() {
            assert_eq!(status.code() as usize, index);
            assert!(status.symbol().starts_with("E_"));
        }
    }

    #[test]
    fn every_code_survives_the_round_trip() {
        for code in 0..=u16::MAX {
            assert_eq!(Status::from_code(code).code(), code);
        }
    }
}
