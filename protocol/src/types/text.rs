//! Payloads of variable length: loop data, device tags, finger data; and the acknowledge key.

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

/// A variable run of bytes: whatever is left of the payload.
macro_rules! byte_run {
    ($(#[$doc:meta])* $type:ident, $max:expr) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
        pub struct $type<'a>(&'a [u8]);

        impl<'a> $type<'a> {
            /// The most bytes it may have.
            pub const MAX_LEN: usize = $max;

            /// These bytes.
            ///
            /// # Errors
            /// [`DecodeError::TooLong`]: more than [`MAX_LEN`](Self::MAX_LEN).
            pub const fn new(bytes: &'a [u8]) -> Result<Self, DecodeError> {
                if bytes.len() > Self::MAX_LEN { Err(DecodeError::TooLong) } else { Ok(Self(bytes)) }
            }

            /// The bytes.
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
    /// What Loop sends and gets back: at most 256 bytes (command set, 3.1.1).
    LoopData, 256
}

byte_run! {
    /// One data frame of a finger; its meaning is the finger's (command set, 3.6.4). A WSG-FMF sends one `f32`, newton.
    FingerData, crate::frame::MAX_MESSAGE_LEN.saturating_sub(crate::frame::OVERHEAD + 2)
}

/// The device tag: up to 64 printable ASCII characters (command set, 3.5.2).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct DeviceTag<'a>(&'a str);

impl<'a> DeviceTag<'a> {
    /// The most characters it may have.
    pub const MAX_LEN: usize = 64;

    /// This tag; trailing NUL characters are stripped.
    ///
    /// # Errors
    /// [`DecodeError::TagTooLong`], [`DecodeError::Character`].
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

    /// The text.
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
