//! The boards that there are, as data.

/// A board that the firmware runs on.
pub(crate) struct Board {
    /// The binary's name, and the image's.
    pub(crate) name: &'static str,
    /// The board's crate.
    pub(crate) package: &'static str,
    /// The microcontroller's name for probe-rs.
    pub(crate) chip: &'static str,
    /// QEMU's name for the board. QEMU is asked for it, never for its version: distributions backport.
    pub(crate) machine: &'static str,
}

/// The default board.
pub(crate) const BOARD: Board = Board {
    name: "b-l475e-iot01a",
    package: "wsg-b-l475e-iot01a",
    chip: "STM32L475VG",
    machine: "b-l475e-iot01a",
};
