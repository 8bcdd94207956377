//! Who a device is on its bus, and which identifiers CANopen uses.

/// What a device has at power-up. A master changes all but `node` by SDO where the object dictionary lets it; a reset of the
/// communication brings this back.
///
/// `T` is the number of TPDOs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Config<const T: usize> {
    /// The node-ID, 1 to 127.
    pub node: u8,
    /// The node-ID of the master, whose heartbeat is watched.
    pub master: u8,
    /// How often the device sends its heartbeat, in milliseconds; 0: never.
    pub heartbeat_ms: u16,
    /// The least time between two emergencies, in 100 µs.
    pub emergency_inhibit: u16,
    /// The least time between two transmissions of each TPDO, in 100 µs.
    pub inhibit: [u16; T],
    /// The most time between two transmissions of each TPDO, in milliseconds; 0: only on change.
    pub event_ms: [u16; T],
}

impl<const T: usize> Config<T> {
    /// Whether both node-IDs are in range, and differ.
    #[must_use]
    pub const fn is_valid(&self) -> bool {
        self.node >= 1
            && self.node <= 127
            && self.master >= 1
            && self.master <= 127
            && self.node != self.master
    }
}

/// Whether CANopen uses this 11-bit identifier, on whatever node: NMT, SYNC and EMCY, TIME; PDOs; SDOs; heartbeats; LSS.
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
