//! Payloads of variable length (loop data, device tags, finger data) and the acknowledge key.

use crate::field::{DecodeError, Field, fixed_field};

/// The key that acknowledges a FAST STOP: the letters `ack` (command set, 3.2.5).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct AckKey;

fixed_field!(AckKey, 3, |_key| *b"ack", |bytes| if bytes == *b"ack" {
    Ok(Self)
} else {
    Err(DecodeError::AckKey)
});

impl core::fmt::Display for AckKey {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("\"ack\"")
    }
}

/// Defines a variable-length run of bytes: the remainder of the payload.
macro_rules! byte_run {
    ($(#[$doc:meta])* $type:ident, $max:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
        pub struct $type<'a>(&'a [u8]);

        impl<'a> $type<'a> {
            /// Maximum length in bytes.
            pub const MAX_LEN: usize = $max;

            /// Creates the value from these bytes.
            ///
            /// # Errors
            /// Returns [`DecodeError::TooLong`] for more than [`MAX_LEN`](Self::MAX_LEN) bytes.
            pub const fn new(bytes: &'a [u8]) -> Result<Self, DecodeError> {
                if bytes.len() > Self::MAX_LEN { Err(DecodeError::TooLong) } else { Ok(Self(bytes)) }
            }

            /// Returns the bytes of the value.
            #[must_use]
            pub const fn bytes(self) -> &'a [u8] {
                self.0
            }
        }

        impl<'a> Field<'a> for $type<'a> {
            fn len(&self) -> usize {
                self.0.len()
            }

            fn byte(&self, index: usize) -> u8 {
                self.0.get(index).copied().unwrap_or(0)
            }

            fn take(input: &mut &'a [u8]) -> Result<Self, DecodeError> {
                Self::new(core::mem::take(input))
            }
        }

        impl core::fmt::Display for $type<'_> {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                write!(f, "{} bytes", self.0.len())
            }
        }
    };
}

byte_run! {
    /// The data that Loop echoes: at most 256 bytes (command set, 3.1.1).
    LoopData, 256
}

byte_run! {
    /// One data frame of a finger, whose format depends on the finger (command set, 3.6.4). A WSG-FMF sends one `f32`
    /// in N.
    FingerData, crate::frame::MAX_MESSAGE_LEN.saturating_sub(crate::frame::OVERHEAD + 2)
}

/// The device tag: up to 64 printable ASCII characters (command set, 3.5.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct DeviceTag<'a>(&'a str);

impl<'a> DeviceTag<'a> {
    /// Maximum length in characters.
    pub const MAX_LEN: usize = 64;

    /// Creates a tag and strips trailing NUL characters.
    ///
    /// # Errors
    /// Returns [`DecodeError::TagTooLong`] or [`DecodeError::Character`].
    pub fn new(text: &'a str) -> Result<Self, DecodeError> {
        let text = text.trim_end_matches('\0');
        if text.len() > Self::MAX_LEN {
            Err(DecodeError::TagTooLong)
        } else if text.bytes().any(|byte| !(0x20..0x7F).contains(&byte)) {
            Err(DecodeError::Character)
        } else {
            Ok(Self(text))
        }
    }

    /// Returns the text without trailing NUL characters.
    #[must_use]
    pub const fn as_str(self) -> &'a str {
        self.0
    }
}

impl<'a> Field<'a> for DeviceTag<'a> {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn byte(&self, index: usize) -> u8 {
        self.0.as_bytes().get(index).copied().unwrap_or(0)
    }

    fn take(input: &mut &'a [u8]) -> Result<Self, DecodeError> {
        Self::new(core::str::from_utf8(core::mem::take(input)).map_err(|_| DecodeError::Character)?)
    }
}

impl core::fmt::Display for DeviceTag<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "\"{}\"", self.0)
    }
}
