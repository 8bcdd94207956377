//! Configuration of a device, and the identifiers reserved by CANopen.

/// Configuration of a device at power-up. A master can change everything except `node` by SDO, as far as the object
/// dictionary permits. A communication reset restores this configuration.
///
/// `T` is the number of TPDOs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config<const T: usize> {
    /// Node-ID of the device, 1 to 127.
    pub node: u8,
    /// Node-ID of the master whose heartbeat is monitored, 1 to 127.
    pub master: u8,
    /// Period of the device's heartbeat in milliseconds; 0 disables it.
    pub heartbeat_ms: u16,
    /// Inhibit time of emergencies in 100 µs.
    pub emergency_inhibit: u16,
    /// Inhibit time of each TPDO in 100 µs.
    pub inhibit: [u16; T],
    /// Event timer of each TPDO in milliseconds; 0 sends it on change only.
    pub event_ms: [u16; T],
}

impl<const T: usize> Config<T> {
    /// Returns whether both node-IDs are in range and differ.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        self.node >= 1
            && self.node <= 127
            && self.master >= 1
            && self.master <= 127
            && self.node != self.master
    }
}

/// Returns whether CANopen reserves this 11-bit identifier for any node: NMT, SYNC and EMCY, TIME,
/// PDOs, SDOs, heartbeats or LSS.
///
/// ```
/// assert!(bus_canopen::is_reserved(0x190), "TPDO1 of node 10h");
/// assert!(!bus_canopen::is_reserved(0x120));
/// ```
#[must_use]
pub const fn is_reserved(id: u16) -> bool {
    matches!(
        id,
        0 | 0x080..=0x100 | 0x181..=0x57F | 0x581..=0x5FF | 0x601..=0x67F | 0x701..=0x77F | 0x7E4..=0x7E5
    )
}
