//! Settings made before power-up: the model, and the settings of the real gripper's web interface.

use crate::axis::{Direction, Part};
use crate::finger::Finger;
use crate::model::Model;
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::{DecodeError, DeviceTag, SoftLimits};

/// The settings of a [`VirtualGripper`](crate::VirtualGripper). The default is a WSG 50-110 with factory settings and
/// no part between the fingers.
///
/// ```
/// use wsg_sim::{Config, Part};
///
/// let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
/// assert!(config.check_checksum);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The model to simulate.
    pub model: Model,
    /// Whether the model has an overdrive mode. Not every gripper has one (command set, 3.3.8).
    pub overdrive: bool,
    /// The serial number that Get System Information returns.
    pub serial_number: u32,
    /// The device tag; empty if none is set.
    pub tag: Tag,
    /// The direction of Homing if the request does not specify one.
    pub homing_default: Direction,
    /// Whether the gripper homes automatically after power-up (fieldbus, 6.4).
    pub homing_at_start: bool,
    /// The soft limits after power-up (command set, 3.3.5). Limits with minus above plus are ignored.
    pub soft_limits: Option<SoftLimits>,
    /// The part between the fingers at power-up.
    pub part: Option<Part>,
    /// The speed of the fingers relative to the real gripper, [`MIN_TIME_SCALE`](Self::MIN_TIME_SCALE) to
    /// [`MAX_TIME_SCALE`](Self::MAX_TIME_SCALE); values outside are clamped. It affects travel only, not periods or time-outs.
    pub time_scale: f32,
    /// Whether frames with a wrong checksum are rejected (command set, 1.4.1).
    pub check_checksum: bool,
    /// Whether a frame with a wrong checksum is answered with E_CHECKSUM_ERROR instead of being ignored. The manual does
    /// not specify which.
    pub answer_bad_checksum: bool,
    /// Whether the unannounced end of a TCP connection causes a FAST STOP (command set, 1.4.2).
    pub disconnect_error: bool,
    /// The fingers mounted on the two base jaws.
    pub fingers: [Finger; 2],
    /// How far beyond the nominal width a grip may move to build up its force, in mm (command set, 3.2.6). With the
    /// stroke or more, a part is accepted wherever it is met; clients then grip at 0 mm and hold any part.
    pub clamping_travel: f32,
    /// How far before the nominal width a part may be met, in mm. A part met earlier is the wrong part.
    pub part_width_tolerance: f32,
    /// The force limit after power-up in N, summed over both fingers, clamped to the model's limits; `None`: the model's default.
    pub force_limit: Option<f32>,
    /// The acceleration after power-up in mm/s², clamped to the model's limits; `None`: the model's default.
    pub acceleration: Option<f32>,
    /// Speed of homing in mm/s, clamped to the model's limits; `None`: the model's default.
    pub homing_speed: Option<f32>,
    /// Default speed in mm/s of MOVE and GRIP of the text protocol (GCL, 2.2.2 and 2.2.3).
    pub speed: f32,
    /// Default distance in mm of RELEASE of the text protocol (GCL, 2.2.4).
    pub release_distance: f32,
    /// Default speed in mm/s of RELEASE of the text protocol; `None`: the maximum.
    pub release_speed: Option<f32>,
    /// Whether a connection of the text protocol begins in verbose mode (GCL, 2.1.1).
    pub gcl_verbose: bool,
    /// Whether to swap the two bytes of each number in the Modbus registers, for PLCs that take "low byte first"
    /// (fieldbus, 4) literally. Flags are not swapped.
    pub modbus_swap_bytes: bool,
    /// Time-out in milliseconds of a Modbus master that has written; 0 disables it. A PROFIBUS master configures its
    /// own watchdog.
    pub bus_timeout_ms: u16,
    /// The reaction to that time-out, and to a master on PROFIBUS, PROFINET or EtherNet/IP that stops or is silent. A jog ends in any case.
    pub bus_reaction: SilenceReaction,
    /// The PROFIBUS address, 0 to 125 (fieldbus, 2.2).
    pub profibus_address: u8,
    /// Seconds without a byte from the client after which automatic updates end on lines without a connection: UDP,
    /// serial lines and CAN. 0: never, as far as the manual says.
    pub updates_idle_s: u16,
    /// Milliseconds without a further byte after which an incomplete frame is discarded.
    pub frame_timeout_ms: u16,
}

impl Config {
    /// Returns these settings with each setting of `new` that a running gripper can take over. The others keep the values
    /// that they had at power-up: model, overdrive, fingers, Modbus byte order, PROFIBUS address, and what applies at power-up only.
    #[must_use]
    pub const fn at_run_time(&self, new: &Self) -> Self {
        Self {
            model: self.model,
            overdrive: self.overdrive,
            fingers: self.fingers,
            homing_at_start: self.homing_at_start,
            soft_limits: self.soft_limits,
            force_limit: self.force_limit,
            acceleration: self.acceleration,
            modbus_swap_bytes: self.modbus_swap_bytes,
            profibus_address: self.profibus_address,
            frame_timeout_ms: self.frame_timeout_ms,
            ..*new
        }
    }

    /// Returns whether the motions of both differ.
    pub(crate) fn moves_differently(&self, other: &Self) -> bool {
        let of = |config: &Self| {
            let Self {
                homing_default, time_scale, clamping_travel, part_width_tolerance, homing_speed, ..
            } = *config;
            (homing_default, time_scale, clamping_travel, part_width_tolerance, homing_speed)
        };
        of(self) != of(other)
    }

    /// Smallest permitted `time_scale`: a hundredth of the real speed.
    pub const MIN_TIME_SCALE: f32 = 0.01;
    /// Largest permitted `time_scale`: a thousand times the real speed.
    pub const MAX_TIME_SCALE: f32 = 1_000.0;
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: Model::default(),
            overdrive: true,
            serial_number: 1,
            tag: Tag::EMPTY,
            homing_default: Direction::Plus,
            homing_at_start: false,
            soft_limits: None,
            part: None,
            time_scale: 1.0,
            check_checksum: true,
            answer_bad_checksum: false,
            disconnect_error: true,
            fingers: [Finger::None; 2],
            clamping_travel: 5.0,
            part_width_tolerance: 5.0,
            force_limit: None,
            acceleration: None,
            homing_speed: None,
            speed: 100.0,
            release_distance: 10.0,
            release_speed: None,
            gcl_verbose: false,
            modbus_swap_bytes: false,
            bus_timeout_ms: 0,
            bus_reaction: SilenceReaction::Stop,
            profibus_address: wsg_fieldbus::profibus::ADDRESS.station,
            updates_idle_s: 0,
            frame_timeout_ms: 500,
        }
    }
}

/// A stored device tag of up to 64 printable ASCII characters (command set, 3.5.2).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Tag {
    bytes: [u8; DeviceTag::MAX_LEN],
    len: u8,
}

impl Tag {
    /// The empty tag: none is set.
    pub const EMPTY: Self = Self { bytes: [0; DeviceTag::MAX_LEN], len: 0 };

    /// Converts a text to a tag.
    ///
    /// # Errors
    /// The errors of [`DeviceTag::new`].
    pub fn new(text: &str) -> Result<Self, DecodeError> {
        DeviceTag::new(text).map(Self::from)
    }

    /// Returns the tag as a string.
    #[must_use]
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.get(..usize::from(self.len)).unwrap_or(&[]);
        core::str::from_utf8(bytes).unwrap_or("")
    }
}

impl From<DeviceTag<'_>> for Tag {
    fn from(tag: DeviceTag<'_>) -> Self {
        let mut kept = Self::EMPTY;
        for (slot, byte) in kept.bytes.iter_mut().zip(tag.as_str().bytes()) {
            *slot = byte;
            kept.len += 1;
        }
        kept
    }
}

impl core::fmt::Debug for Tag {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.as_str().fmt(f)
    }
}
