//! The register images, byte by byte (fieldbus, 5.1).

use bitflags::bitflags;
use wsg_protocol::types::{DeviceType, GripperState, Status, SystemFlags};

bitflags! {
    /// CMDFLAGS, byte 0 of the output image. JOG and FASTSTOP act on their level, all other flags on a rising edge.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct CommandFlags: u8 {
        /// Bit 0: pre-position the fingers (WIDTH, SPEED).
        const MOVE = 1 << 0;
        /// Bit 1: grip a part (WIDTH, SPEED, FORCELIMIT).
        const GRIP = 1 << 1;
        /// Bit 2: release a part (WIDTH, SPEED). Chapter 6.3 of the manual prints bit 3; its table 1 is correct.
        const RELEASE = 1 << 2;
        /// Bit 3: home the fingers.
        const HOMING = 1 << 3;
        /// Bit 4: stop, or acknowledge a FAST STOP.
        const STOP_ACK = 1 << 4;
        /// Bit 5: request a FAST STOP for as long as the bit is 1.
        const FASTSTOP = 1 << 5;
        /// Bit 6: jog in the positive direction (opening) while the bit is 1.
        const JOG_PLUS = 1 << 6;
        /// Bit 7: jog in the negative direction (closing) while the bit is 1.
        const JOG_MINUS = 1 << 7;
    }

    /// GSTATE, byte 0 of the input image: the gripper state, with exactly one bit set.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct GripperFlags: u8 {
        /// Bit 0: waiting for a command.
        const IDLE = 1 << 0;
        /// Bit 1: the fingers are moving towards the part.
        const GRIPPING = 1 << 1;
        /// Bit 2: no part was found.
        const NO_PART = 1 << 2;
        /// Bit 3: the part was lost.
        const PART_LOST = 1 << 3;
        /// Bit 4: a part is held.
        const HOLDING = 1 << 4;
        /// Bit 5: the fingers are moving away from the part.
        const RELEASING = 1 << 5;
        /// Bit 6: the fingers are pre-positioning or homing.
        const POSITIONING = 1 << 6;
        /// Bit 7: an error occurred.
        const ERROR = 1 << 7;
    }
}

impl CommandFlags {
    /// The flags that start a motion on their rising edge.
    pub const MOTIONS: Self = Self::MOVE.union(Self::GRIP).union(Self::RELEASE).union(Self::HOMING);

    /// JOG+ and JOG-, of which at most one has an effect.
    pub const JOG: Self = Self::JOG_PLUS.union(Self::JOG_MINUS);

    /// Returns the set flag with the lowest bit number, which has priority when several rise at once.
    ///
    /// ```
    /// use wsg_fieldbus::CommandFlags;
    ///
    /// assert_eq!((CommandFlags::HOMING | CommandFlags::GRIP).lowest(), Some(CommandFlags::GRIP));
    /// assert_eq!(CommandFlags::empty().lowest(), None);
    /// ```
    #[must_use]
    pub const fn lowest(self) -> Option<Self> {
        let lowest = self.bits() & self.bits().wrapping_neg();
        if lowest == 0 { None } else { Some(Self::from_bits_retain(lowest)) }
    }
}

/// Flags that are ignored until the PLC writes them 0, because they were 1 when no edge may count.
///
/// While a JOG flag is masked, so is the other one. JOG becomes effective after both were 0, since both at once mean
/// a stop (fieldbus, 6.7).
///
/// ```
/// use wsg_fieldbus::{CommandFlags, MaskedFlags};
///
/// let mut masked = MaskedFlags::NONE;
/// let first = CommandFlags::MOVE | CommandFlags::FASTSTOP;
/// masked.see(first, true);
/// assert_eq!(masked.counting(first), CommandFlags::FASTSTOP);
/// masked.see(CommandFlags::empty(), false);
/// assert_eq!(masked.counting(CommandFlags::MOVE), CommandFlags::MOVE);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct MaskedFlags(CommandFlags);

impl MaskedFlags {
    /// No flag is masked.
    pub const NONE: Self = Self(CommandFlags::empty());

    /// Takes the flags that a PLC wrote. Flags that are 1 in its first image are masked, except FASTSTOP, which acts
    /// on its level.
    pub fn see(&mut self, written: CommandFlags, is_first: bool) {
        // Both flags must be 0 together: masking continues if one rises as the masked one falls.
        let jog_was_masked = self.0.intersects(CommandFlags::JOG);
        self.0 &= written;
        if is_first {
            self.mask(written.difference(CommandFlags::FASTSTOP));
        }
        if jog_was_masked {
            self.mask(written.intersection(CommandFlags::JOG));
        }
    }

    /// Masks the flags that are 1 in `flags`.
    pub fn mask(&mut self, flags: CommandFlags) {
        self.0 |= flags;
    }

    /// Returns the written flags that are not masked.
    #[must_use]
    pub const fn counting(self, written: CommandFlags) -> CommandFlags {
        written.difference(self.0)
    }
}

#[cfg(feature = "defmt")]
mod format {
    impl defmt::Format for super::CommandFlags {
        fn format(&self, f: defmt::Formatter<'_>) {
            defmt::write!(f, "{=u8:#010b}", self.bits());
        }
    }

    impl defmt::Format for super::GripperFlags {
        fn format(&self, f: defmt::Formatter<'_>) {
            defmt::write!(f, "{=u8:#010b}", self.bits());
        }
    }
}

impl From<GripperState> for GripperFlags {
    fn from(state: GripperState) -> Self {
        match state {
            GripperState::Idle => Self::IDLE,
            GripperState::Gripping => Self::GRIPPING,
            GripperState::NoPart => Self::NO_PART,
            GripperState::PartLost => Self::PART_LOST,
            GripperState::Holding => Self::HOLDING,
            GripperState::Releasing => Self::RELEASING,
            GripperState::Positioning => Self::POSITIONING,
            GripperState::Error => Self::ERROR,
        }
    }
}

/// The value of one step of a force register.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ForceUnit {
    /// 1/100 N, all devices except the WSG 70.
    #[default]
    Hundredth,
    /// 1/10 N, the WSG 70.
    Tenth,
}

impl ForceUnit {
    /// Returns the unit that this device uses.
    #[must_use]
    pub const fn of(device: DeviceType) -> Self {
        match device {
            DeviceType::Wsg70 => Self::Tenth,
            _ => Self::Hundredth,
        }
    }

    /// Returns the register steps per newton: 100, or 10 for the WSG 70.
    #[must_use]
    pub const fn per_newton(self) -> f32 {
        match self {
            Self::Hundredth => 100.0,
            Self::Tenth => 10.0,
        }
    }
}

/// The registers that the PLC writes: 8 bytes, numbers big-endian.
///
/// ```
/// use wsg_fieldbus::{CommandFlags, OutputImage};
///
/// // The manual's example: MOVE and IF6 are Modbus register 0 = 288 = 0120h.
/// let image = OutputImage { flags: CommandFlags::MOVE, user: 1 << 5, width: 1220, ..OutputImage::ZERO };
/// assert_eq!(image.to_bytes(), [0x01, 0x20, 0x04, 0xC4, 0, 0, 0, 0]);
/// assert_eq!(OutputImage::from_bytes(image.to_bytes()), image);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutputImage {
    /// Byte 0, CMDFLAGS.
    pub flags: CommandFlags,
    /// Byte 1, IF: user flags IF1 (bit 0) to IF8.
    pub user: u8,
    /// Bytes 2 and 3, WIDTH in 1/100 mm.
    pub width: i16,
    /// Bytes 4 and 5, SPEED in 1/100 mm/s.
    pub speed: u16,
    /// Bytes 6 and 7, FORCELIMIT in 1/100 N (WSG 70: 1/10 N). Only positive values are valid.
    pub force_limit: i16,
}

impl OutputImage {
    /// Length of the image in bytes.
    pub const LEN: usize = 8;

    /// The image after power-up: no command and all parameters 0.
    pub const ZERO: Self = Self { flags: CommandFlags::empty(), user: 0, width: 0, speed: 0, force_limit: 0 };

    /// Decodes an image. Every byte pattern is valid.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; Self::LEN]) -> Self {
        let [flags, user, w1, w0, s1, s0, f1, f0] = bytes;
        Self {
            flags: CommandFlags::from_bits_retain(flags),
            user,
            width: i16::from_be_bytes([w1, w0]),
            speed: u16::from_be_bytes([s1, s0]),
            force_limit: i16::from_be_bytes([f1, f0]),
        }
    }

    /// Encodes the image in the byte order of the bus.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; Self::LEN] {
        let [w1, w0] = self.width.to_be_bytes();
        let [s1, s0] = self.speed.to_be_bytes();
        let [f1, f0] = self.force_limit.to_be_bytes();
        [self.flags.bits(), self.user, w1, w0, s1, s0, f1, f0]
    }

    /// WIDTH in mm.
    #[must_use]
    pub fn width_mm(&self) -> f32 {
        f32::from(self.width) / 100.0
    }

    /// SPEED in mm/s.
    #[must_use]
    pub fn speed_mm_s(&self) -> f32 {
        f32::from(self.speed) / 100.0
    }

    /// FORCELIMIT in N.
    #[must_use]
    pub fn force_limit_n(&self, unit: ForceUnit) -> f32 {
        f32::from(self.force_limit) / unit.per_newton()
    }

    /// Returns whether WIDTH, SPEED or FORCELIMIT differs.
    #[must_use]
    pub const fn parameters_differ(&self, other: &Self) -> bool {
        self.width != other.width || self.speed != other.speed || self.force_limit != other.force_limit
    }
}

/// The registers that the PLC reads: 12 bytes, numbers big-endian, SYSSTATE as a bit vector (byte 2 holds bits 0 to 7).
///
/// ```
/// use wsg_fieldbus::{GripperFlags, InputImage};
/// use wsg_protocol::{Status, SystemFlags};
///
/// let image = InputImage {
///     state: GripperFlags::HOLDING,
///     user: 0,
///     system: SystemFlags::REFERENCED | SystemFlags::FAST_STOP,
///     width: 2000,
///     force: 405, // 4.05 N; the manual's "40.5 N" is an error
///     status: Status::CmdPending,
/// };
/// assert_eq!(image.to_bytes(), [0x10, 0, 0x01, 0x10, 0, 0, 0x07, 0xD0, 0x01, 0x95, 0, 26]);
/// assert_eq!(InputImage::from_bytes(image.to_bytes()), image);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct InputImage {
    /// Byte 0, GSTATE.
    pub state: GripperFlags,
    /// Byte 1, OF: user flags OF1 (bit 0) to OF8.
    pub user: u8,
    /// Bytes 2 to 5, SYSSTATE.
    pub system: SystemFlags,
    /// Bytes 6 and 7, the opening width in 1/100 mm.
    pub width: i16,
    /// Bytes 8 and 9, the gripping force in 1/100 N (WSG 70: 1/10 N).
    pub force: i16,
    /// Bytes 10 and 11, the status code of the last command.
    pub status: Status,
}

impl InputImage {
    /// Length of the image in bytes.
    pub const LEN: usize = 12;

    /// Decodes an image. Every byte pattern is valid.
    #[must_use]
    pub const fn from_bytes(bytes: [u8; Self::LEN]) -> Self {
        let [state, user, y0, y1, y2, y3, w1, w0, f1, f0, c1, c0] = bytes;
        Self {
            state: GripperFlags::from_bits_retain(state),
            user,
            system: SystemFlags::from_bits_retain(u32::from_le_bytes([y0, y1, y2, y3])),
            width: i16::from_be_bytes([w1, w0]),
            force: i16::from_be_bytes([f1, f0]),
            status: Status::from_code(u16::from_be_bytes([c1, c0])),
        }
    }

    /// Encodes the image in the byte order of the bus.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; Self::LEN] {
        let [y0, y1, y2, y3] = self.system.bits().to_le_bytes();
        let [w1, w0] = self.width.to_be_bytes();
        let [f1, f0] = self.force.to_be_bytes();
        let [c1, c0] = self.status.code().to_be_bytes();
        [self.state.bits(), self.user, y0, y1, y2, y3, w1, w0, f1, f0, c1, c0]
    }
}

/// Converts a measured value to register steps, rounded and saturated at the ends of the register's range.
pub(super) fn to_register(value: f32, steps_per_unit: f32) -> i16 {
    let steps = value * steps_per_unit;
    // `as` saturates and converts NaN to 0.
    if steps < 0.0 { (steps - 0.5) as i16 } else { (steps + 0.5) as i16 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measured_values_round_and_saturate() {
        for (value, steps, register) in [
            (12.2, 100.0, 1220),
            (12.199_9, 100.0, 1220),
            (-0.004, 100.0, 0),
            (-0.006, 100.0, -1),
            (-12.2, 100.0, -1220),
            (-400.0, 100.0, i16::MIN),
            (400.0, 100.0, i16::MAX),
            (305.0, 10.0, 3050),
        ] {
            assert_eq!(to_register(value, steps), register, "{value}");
        }
        assert_eq!(to_register(f32::NAN, 100.0), 0);
    }

    #[test]
    fn all_images_survive_the_round_trip() {
        for seed in 0..=255u8 {
            let out = [seed, !seed, seed ^ 0x5A, seed, 3, seed, !seed, seed];
            assert_eq!(OutputImage::from_bytes(out).to_bytes(), out);
            let input = [seed, 1, seed, !seed, 0x80, seed, !seed, seed, seed, 7, seed, seed ^ 0x11];
            assert_eq!(InputImage::from_bytes(input).to_bytes(), input);
        }
    }

    #[test]
    fn flags_of_the_first_image_count_once_they_were_0() {
        let moves = CommandFlags::MOVE | CommandFlags::GRIP;
        let mut masked = MaskedFlags::NONE;
        masked.see(moves | CommandFlags::FASTSTOP, true);
        assert_eq!(masked.counting(moves | CommandFlags::FASTSTOP), CommandFlags::FASTSTOP);
        masked.see(CommandFlags::GRIP, false);
        assert_eq!(masked.counting(moves), CommandFlags::MOVE);
    }

    #[test]
    fn jog_counts_once_both_directions_were_0_together() {
        for [first, other] in [
            [CommandFlags::JOG_PLUS, CommandFlags::JOG_MINUS],
            [CommandFlags::JOG_MINUS, CommandFlags::JOG_PLUS],
        ] {
            let mut masked = MaskedFlags::NONE;
            masked.see(first, true);
            for written in [first, other, CommandFlags::JOG, first, first] {
                masked.see(written, false);
                assert_eq!(masked.counting(written), CommandFlags::empty(), "{written:?} after {first:?}");
            }
            masked.see(CommandFlags::empty(), false);
            masked.see(other, false);
            assert_eq!(masked.counting(CommandFlags::JOG), CommandFlags::JOG);
        }
    }

    #[test]
    fn masked_flags_add_up() {
        let mut masked = MaskedFlags::NONE;
        masked.mask(CommandFlags::MOVE);
        masked.mask(CommandFlags::MOVE | CommandFlags::GRIP);
        assert_eq!(
            masked.counting(CommandFlags::all()),
            CommandFlags::all() - CommandFlags::MOVE - CommandFlags::GRIP
        );
    }
}
