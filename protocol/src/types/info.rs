//! Information about a gripper: device, limits, statistics and fingers.

use core::hash::{Hash, Hasher};

use crate::field::{finite, fixed_field};

macro_rules! open_byte_enum {
    ($(#[$doc:meta])* $type:ident { $($code:literal $name:ident $text:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
        pub enum $type {
            $(#[doc = concat!($text, " (", $code, ").")] $name,)*
            /// A value reserved by the manual.
            Unknown(u8),
        }

        impl $type {
            /// Returns the byte that encodes the value.
            #[must_use]
            pub const fn code(self) -> u8 {
                match self {
                    $(Self::$name => $code,)*
                    Self::Unknown(code) => code,
                }
            }

            /// Returns the value for this code.
            #[must_use]
            pub const fn from_code(code: u8) -> Self {
                match code {
                    $($code => Self::$name,)*
                    code => Self::Unknown(code),
                }
            }
        }

        impl core::fmt::Display for $type {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match self {
                    $(Self::$name => f.write_str($text),)*
                    Self::Unknown(code) => write!(f, "reserved ({code})"),
                }
            }
        }
    };
}

open_byte_enum! {
    /// The product type (command set, 3.5.1).
    DeviceType {
        0 Unspecified "unknown";
        1 Wsg50 "WSG 50";
        2 Wsg32 "WSG 32";
        3 Kms40 "KMS 40";
        4 Wts "WTS";
        5 Wsg25 "WSG 25";
        6 Wsg70 "WSG 70";
    }
}

open_byte_enum! {
    /// The kind of finger at a sensor port (command set, 3.6.1).
    FingerType {
        0 Generic "generic or none";
        1 Fmf "WSG-FMF";
        2 Dsa "WSG-DSA";
    }
}

/// The firmware version: three numbers, and the number of a release candidate or 0 (command set, 3.5.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, crate::Format)]
pub struct FirmwareVersion(u16);

impl FirmwareVersion {
    /// Creates a version from its parts, of which the low four bits are used.
    #[must_use]
    pub const fn new(major: u8, minor: u8, patch: u8, release_candidate: u8) -> Self {
        Self(
            (major as u16 & 15) << 12
                | (minor as u16 & 15) << 8
                | (patch as u16 & 15) << 4
                | release_candidate as u16 & 15,
        )
    }

    /// Returns the version as encoded in the reply.
    #[must_use]
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Creates a version as encoded in the reply.
    #[must_use]
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// Returns the major version, minor version 1, minor version 2 and the number of the release candidate (0 for a
    /// release).
    #[must_use]
    pub const fn parts(self) -> (u8, u8, u8, u8) {
        let [low, high] = self.0.to_le_bytes();
        (high >> 4, high & 15, low >> 4, low & 15)
    }
}

impl core::fmt::Display for FirmwareVersion {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self.parts() {
            (major, minor, patch, 0) => write!(f, "{major}.{minor}.{patch}"),
            (major, minor, patch, candidate) => write!(f, "{major}.{minor}.{patch}-rc{candidate}"),
        }
    }
}

/// Device type, hardware revision, firmware version and serial number (command set, 3.5.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, crate::Format)]
pub struct SystemInfo {
    /// Product type (50h), which determines the units of the fieldbus registers.
    pub device: DeviceType,
    /// The hardware revision of the device.
    pub hardware_revision: u8,
    /// The installed firmware version.
    pub firmware: FirmwareVersion,
    /// The serial number of the device.
    pub serial_number: u32,
}

impl core::fmt::Display for SystemInfo {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { device, hardware_revision, firmware, serial_number } = self;
        write!(
            f,
            "{device}, revision {hardware_revision}, firmware {firmware}, serial number {serial_number}"
        )
    }
}

fixed_field!(
    SystemInfo,
    8,
    |info| {
        let [version_low, version_high] = info.firmware.bits().to_le_bytes();
        let [s0, s1, s2, s3] = info.serial_number.to_le_bytes();
        [info.device.code(), info.hardware_revision, version_low, version_high, s0, s1, s2, s3]
    },
    |bytes| {
        let [device, hardware_revision, version_low, version_high, serial @ ..] = bytes;
        Ok(Self {
            device: DeviceType::from_code(device),
            hardware_revision,
            firmware: FirmwareVersion::from_bits(u16::from_le_bytes([version_low, version_high])),
            serial_number: u32::from_le_bytes(serial),
        })
    }
);

/// Defines a structure of consecutive finite floats.
macro_rules! float_fields {
    ($(#[$doc:meta])* $type:ident, $len:literal { $($(#[$item_doc:meta])* $name:ident $text:literal $unit:literal;)* }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
        pub struct $type {
            $($(#[$item_doc])* pub $name: f32,)*
        }

        impl core::fmt::Display for $type {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                let mut separator = "";
                $(
                    write!(f, concat!("{}", $text, " {:.1} ", $unit), separator, crate::Number(self.$name))?;
                    separator = ", ";
                )*
                let _ = separator;
                Ok(())
            }
        }

        impl Hash for $type {
            fn hash<H: Hasher>(&self, state: &mut H) {
                $(self.$name.to_bits().hash(state);)*
            }
        }

        fixed_field!($type, $len, |value| {
            let mut bytes = [0; $len];
            let mut slots = bytes.chunks_exact_mut(4);
            $(if let Some(slot) = slots.next() {
                slot.copy_from_slice(&value.$name.to_le_bytes());
            })*
            bytes
        }, |bytes| {
            let mut rest = bytes.as_slice();
            $(let $name = <f32 as crate::field::Field>::take(&mut rest)?;)*
            Ok(Self { $($name),* })
        }, check |value| {
            $(finite(value.$name)?;)*
            Ok(())
        });
    };
}

float_fields! {
    /// The physical limits of the gripper (command set, 3.5.4). Forces are the sum over both fingers.
    SystemLimits, 32 {
        /// Maximum stroke in mm.
        stroke "stroke" "mm";
        /// Minimum speed in mm/s.
        min_speed "speed from" "mm/s";
        /// Maximum speed in mm/s.
        max_speed "to" "mm/s";
        /// Minimum acceleration in mm/s².
        min_acceleration "acceleration from" "mm/s²";
        /// Maximum acceleration in mm/s².
        max_acceleration "to" "mm/s²";
        /// Minimum gripping force in N.
        min_force "force from" "N";
        /// Nominal gripping force in N, at a duty cycle of 100 %.
        nominal_force "nominal" "N";
        /// Maximum gripping force in overdrive mode, in N.
        overdrive_force "overdrive" "N";
    }
}

float_fields! {
    /// The permitted range of the opening width (command set, 3.3.5).
    SoftLimits, 8 {
        /// Minimum opening width in mm.
        minus "from" "mm";
        /// Maximum opening width in mm.
        plus "to" "mm";
    }
}

/// Grip counters (command set, 3.4.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub struct GrippingStatistics {
    /// Total number of grips.
    pub total: u32,
    /// Number of grips that found no part.
    pub no_part: u16,
    /// Number of grips whose part was lost before release.
    pub part_lost: u16,
}

impl core::fmt::Display for GrippingStatistics {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} grips, {} without part, {} lost", self.total, self.no_part, self.part_lost)
    }
}

fixed_field!(
    GrippingStatistics,
    8,
    |counts| {
        let [t0, t1, t2, t3] = counts.total.to_le_bytes();
        let [n0, n1] = counts.no_part.to_le_bytes();
        let [l0, l1] = counts.part_lost.to_le_bytes();
        [t0, t1, t2, t3, n0, n1, l0, l1]
    },
    |bytes| {
        let [t0, t1, t2, t3, n0, n1, l0, l1] = bytes;
        Ok(Self {
            total: u32::from_le_bytes([t0, t1, t2, t3]),
            no_part: u16::from_le_bytes([n0, n1]),
            part_lost: u16::from_le_bytes([l0, l1]),
        })
    }
);

/// A temperature in steps of 0.1 °C (command set, 3.4.7).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, crate::Format)]
pub struct Temperature(pub i16);

impl core::fmt::Display for Temperature {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{:.1} °C", crate::Number(f32::from(self.0) / 10.0))
    }
}

fixed_field!(Temperature, 2, |value| value.0.to_le_bytes(), |bytes| Ok(Self(i16::from_le_bytes(bytes))));

/// The device at a finger's sensor port (command set, 3.6.1).
#[derive(Clone, Copy, Debug, PartialEq, Eq, crate::Format)]
pub struct FingerInfo {
    /// The type of the finger.
    pub finger: FingerType,
    /// Length of one data frame in bytes; 0 if the finger provides no data.
    pub data_len: u16,
}

impl core::fmt::Display for FingerInfo {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}, {} bytes of data", self.finger, self.data_len)
    }
}

fixed_field!(
    FingerInfo,
    3,
    |info| {
        let [low, high] = info.data_len.to_le_bytes();
        [info.finger.code(), low, high]
    },
    |bytes| {
        let [finger, low, high] = bytes;
        Ok(Self { finger: FingerType::from_code(finger), data_len: u16::from_le_bytes([low, high]) })
    }
);
