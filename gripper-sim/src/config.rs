//! What is settled before the gripper is switched on: the model, and what the real one has on its web interface.

use crate::axis::{Direction, Part};
use crate::finger::Finger;
use crate::model::Model;
use wsg_fieldbus::SilenceReaction;
use wsg_protocol::{DecodeError, DeviceTag, SoftLimits};

/// The settings of a [`VirtualGripper`](crate::VirtualGripper). The default is a WSG 50-110 as it leaves the factory,
/// with no part between the fingers.
///
/// ```
/// use wsg_sim::{Config, Part};
///
/// let config = Config { part: Part::of_width(20.0), time_scale: 10.0, ..Config::default() };
/// assert!(config.check_checksum);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The model.
    pub model: Model,
    /// The serial number that Get System Information answers.
    pub serial_number: u32,
    /// The device tag; empty: none is set.
    pub tag: Tag,
    /// Which way Homing goes when the request leaves it open.
    pub homing_default: Direction,
    /// Whether the gripper homes by itself after switching on (fieldbus, 6.4).
    pub homing_at_start: bool,
    /// The soft limits after switching on (command set, 3.3.5); those with minus above plus are ignored.
    pub soft_limits: Option<SoftLimits>,
    /// What lies between the fingers at the start.
    pub part: Option<Part>,
    /// How many times as fast as the real ones the fingers travel, [`MIN_TIME_SCALE`](Self::MIN_TIME_SCALE) to
    /// [`MAX_TIME_SCALE`](Self::MAX_TIME_SCALE); a value outside is clamped. Travel only: periods and time-outs stay.
    pub time_scale: f32,
    /// Whether frames with a wrong checksum are refused (command set, 1.4.1).
    pub check_checksum: bool,
    /// Whether a frame with a wrong checksum is answered with E_CHECKSUM_ERROR; otherwise there is silence. The manual
    /// does not say which.
    pub answer_bad_checksum: bool,
    /// Whether a TCP connection that ends unannounced causes a FAST STOP (command set, 1.4.2).
    pub disconnect_error: bool,
    /// What is mounted on the two base jaws.
    pub fingers: [Finger; 2],
    /// How far beyond the nominal width a grip may go to build up its force, in mm (command set, 3.2.6). With the stroke or
    /// more any part is the right one, wherever it is met: clients grip at 0 mm then, and hold it.
    pub clamping_travel: f32,
    /// How much before the nominal width a part may be met, in mm; one met earlier is the wrong part.
    pub part_width_tolerance: f32,
    /// The force limit after switching on in N, summed over both fingers; `None`: the model's. Kept within its limits.
    pub force_limit: Option<f32>,
    /// The acceleration after switching on in mm/s²; `None`: the model's. Kept within its limits.
    pub acceleration: Option<f32>,
    /// Speed of homing in mm/s; `None`: the model's. Kept within its limits.
    pub homing_speed: Option<f32>,
    /// Speed in mm/s of MOVE and GRIP of the text protocol when the request leaves it open (GCL, 2.2.2 and 2.2.3).
    pub speed: f32,
    /// Distance in mm of RELEASE of the text protocol when the request leaves it open (GCL, 2.2.4).
    pub release_distance: f32,
    /// Speed in mm/s of RELEASE of the text protocol when the request leaves it open; `None`: the greatest.
    pub release_speed: Option<f32>,
    /// Whether the two bytes of each number in the Modbus registers change places, for a PLC that takes "low byte first"
    /// (fieldbus, 4) by the letter; flags stay.
    pub modbus_swap_bytes: bool,
    /// How long a Modbus master that has written may be silent, in milliseconds; 0: for ever. A PROFIBUS master brings a
    /// watchdog of its own.
    pub bus_timeout_ms: u16,
    /// What is done then, and when the master of PROFIBUS or PROFINET has stopped or is silent; a jog ends in any case.
    pub bus_reaction: SilenceReaction,
    /// The address on PROFIBUS, 0 to 125 (fieldbus, 2.2).
    pub profibus_address: u8,
    /// After how many seconds without a byte from its client the automatic updates on a line end whose client may go
    /// unnoticed: UDP, serial lines and CAN. 0: never, as far as the manual says.
    pub updates_idle_s: u16,
    /// After how many milliseconds without a further byte half a frame is dropped.
    pub frame_timeout_ms: u16,
}

impl Config {
    /// The least `time_scale`.
    pub const MIN_TIME_SCALE: f32 = 0.01;
    /// The greatest `time_scale`.
    pub const MAX_TIME_SCALE: f32 = 1_000.0;
}

impl Default for Config {
    fn default() -> Self {
        Self {
            model: Model::default(),
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
            modbus_swap_bytes: false,
            bus_timeout_ms: 0,
            bus_reaction: SilenceReaction::Stop,
            profibus_address: wsg_fieldbus::profibus::ADDRESS.station,
            updates_idle_s: 0,
            frame_timeout_ms: 500,
        }
    }
}

/// A device tag that is kept: up to 64 printable ASCII characters (command set, 3.5.2).
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Tag {
    bytes: [u8; DeviceTag::MAX_LEN],
    len: u8,
}

impl Tag {
    /// No tag.
    pub const EMPTY: Self = Self { bytes: [0; DeviceTag::MAX_LEN], len: 0 };

    /// This text as a tag.
    ///
    /// # Errors
    /// Those of [`DeviceTag::new`].
    pub fn new(text: &str) -> Result<Self, DecodeError> {
        DeviceTag::new(text).map(Self::from)
    }

    /// The text.
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
