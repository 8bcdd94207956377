//! The PROFIBUS diagnosis block (fieldbus, 5.2, table 3) as data. The bus stack decides when to send it.

use wsg_protocol::types::SystemFlags;

/// The 16-byte diagnosis that a WSG sends to a PROFIBUS master.
///
/// ```
/// use wsg_protocol::SystemFlags;
/// use wsg_fieldbus::Diagnosis;
///
/// let block = Diagnosis { standard: [0x08, 0x0C, 0x00, 0x02], system: SystemFlags::FAST_STOP };
/// let bytes = block.to_bytes();
/// assert_eq!(bytes[..7], [0x08, 0x0C, 0x00, 0x02, 0x55, 0x55, 0x0A]);
/// assert_eq!(bytes[7..], [0x00, 0x10, 0, 0, 0, 0, 0, 0, 0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Diagnosis {
    /// Bytes 0 to 3: station status 1 to 3 and the master's address, supplied by the bus stack.
    pub standard: [u8; 4],
    /// Bytes 7 to 10: the system state as in SYSSTATE (byte 7 holds bits 0 to 7).
    pub system: SystemFlags,
}

impl Diagnosis {
    /// Length of the block in bytes.
    pub const LEN: usize = 16;

    /// Bytes 4 and 5: the identification number of the WSG.
    pub const IDENT: u16 = 0x5555;

    /// Byte 6: the length of the device-related part, including this byte. Table 3 prints the reserved rest as bytes
    /// 10 to 15, but byte 10 belongs to the system state.
    pub const DEVICE_PART_LEN: u8 = 10;

    /// The flags whose change from 0 to 1 triggers the block.
    pub const TRIGGERS: SystemFlags = SystemFlags::SOFT_LIMIT_MINUS
        .union(SystemFlags::SOFT_LIMIT_PLUS)
        .union(SystemFlags::FAST_STOP)
        .union(SystemFlags::TEMP_FAULT)
        .union(SystemFlags::POWER_FAULT)
        .union(SystemFlags::CURR_FAULT)
        .union(SystemFlags::FINGER_FAULT)
        .union(SystemFlags::CMD_FAILURE)
        .union(SystemFlags::SCRIPT_FAILURE);

    /// Returns whether a change of the system state triggers the block.
    ///
    /// ```
    /// use wsg_protocol::SystemFlags;
    /// use wsg_fieldbus::Diagnosis;
    ///
    /// let (moving, stopped) = (SystemFlags::MOVING, SystemFlags::FAST_STOP);
    /// assert!(Diagnosis::is_due(moving, stopped));
    /// assert!(!Diagnosis::is_due(stopped, stopped | moving), "it was sent already");
    /// assert!(!Diagnosis::is_due(stopped, moving), "the end of a fault is no fault");
    /// ```
    #[must_use]
    pub const fn is_due(before: SystemFlags, after: SystemFlags) -> bool {
        after.difference(before).intersects(Self::TRIGGERS)
    }

    /// Encodes the whole diagnosis: standard, ident number and device part.
    #[must_use]
    pub const fn to_bytes(self) -> [u8; Self::LEN] {
        let [s0, s1, s2, s3] = self.standard;
        let [i1, i0] = Self::IDENT.to_be_bytes();
        let [d0, d1, d2, d3, d4, d5, d6, d7, d8, d9] = Self::device_part(self.system);
        [s0, s1, s2, s3, i1, i0, d0, d1, d2, d3, d4, d5, d6, d7, d8, d9]
    }

    /// Encodes bytes 6 to 15, the part that the device adds to the bus stack's.
    #[must_use]
    pub const fn device_part(system: SystemFlags) -> [u8; Self::DEVICE_PART_LEN as usize] {
        let [y0, y1, y2, y3] = system.bits().to_le_bytes();
        [Self::DEVICE_PART_LEN, y0, y1, y2, y3, 0, 0, 0, 0, 0]
    }
}

/// The device-related part extends from its length byte to the end of the block.
const _: () = assert!(6 + Diagnosis::DEVICE_PART_LEN as usize == Diagnosis::LEN);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn diagnosis_has_16_bytes_and_each_flag_in_bytes_7_to_10() {
        for bit in 0..32 {
            let system = SystemFlags::from_bits_retain(1 << bit);
            let mut expected = [1, 2, 3, 4, 0x55, 0x55, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0];
            expected[7 + bit / 8] = 1 << (bit % 8);
            assert_eq!(Diagnosis { standard: [1, 2, 3, 4], system }.to_bytes(), expected, "bit {bit}");
        }
    }

    #[test]
    fn diagnosis_is_due_for_exactly_the_flags_the_manual_lists() {
        let listed = [4, 5, 12, 14, 15, 16, 17, 18, 20];
        for bit in 0..32 {
            let flag = SystemFlags::from_bits_retain(1 << bit);
            assert_eq!(Diagnosis::is_due(SystemFlags::empty(), flag), listed.contains(&bit), "bit {bit}");
        }
    }
}
