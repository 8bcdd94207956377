//! Reasons for which an update is refused: one table for the register, the documents and the tool.

macro_rules! update_refusals {
    ($($code:literal $name:ident $meaning:literal;)*) => {
        /// Reason why a block, a command or an image of an update was refused: the value of UPDATE_REFUSAL.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum UpdateRefusal {
            $(#[doc = concat!("The ", $meaning, ".")] $name = $code,)*
        }

        impl UpdateRefusal {
            /// All reasons, in the order of their codes.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// Meaning of UPDATE_REFUSAL.
            pub(crate) const MEANING: &str =
                concat!("last refusal of an update: 0 none" $(, "; ", $code, " the ", $meaning)*);
        }

        impl core::fmt::Display for UpdateRefusal {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(match self {
                    $(Self::$name => concat!("the ", $meaning),)*
                })
            }
        }
    };
}

update_refusals! {
    1 NoBootLoader "board has no boot loader for updates";
    2 Moving "fingers move, or a command is pending";
    3 Saving "settings are being stored";
    4 OtherMaster "update of another master has not ended";
    5 Busy "previous block or the check has not ended";
    6 OutOfOrder "block does not follow the previous one";
    7 TooLong "image exceeds a slot";
    8 NothingReceived "image is not complete or not checked";
    9 Flash "flash failed";
    10 OnTrial "running image has not confirmed itself, 10 s after its start";
    11 NoImage "file contains no image";
    12 Unreadable "image is unreadable in the flash";
    13 WrongLength "length of the image is wrong";
    14 WrongBoard "image is for another board";
    15 LowerCounter "rollback counter is lower than the stored one";
    16 WrongSignature "signature is wrong";
    17 WrongSuccessor "successor of a key requires a signature with the first key";
}

impl core::error::Error for UpdateRefusal {}

impl UpdateRefusal {
    /// Returns the reason with this code.
    ///
    /// ```
    /// use wsg_bridge_fw::registers::UpdateRefusal;
    ///
    /// assert_eq!(UpdateRefusal::from_code(4), Some(UpdateRefusal::OtherMaster));
    /// assert_eq!(UpdateRefusal::from_code(0), None);
    /// ```
    #[must_use]
    pub fn from_code(code: u16) -> Option<Self> {
        Self::ALL.iter().copied().find(|it| *it as u16 == code)
    }
}
