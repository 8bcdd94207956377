//! Units of numbers that stand side by side in a call, so that they cannot be swapped. A lone number is an `f32`; its
//! method's documentation has the unit.

/// An opening width, or a change of it, in mm.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Mm(pub f32);

/// A finger speed in mm/s.
///
/// Width and speed cannot be swapped:
///
/// ```compile_fail,E0308
/// # #[cfg(feature = "embedded-io")] {
/// use wsg_protocol::driver::blocking::{GripperOver, Transport};
/// use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, Protocol};
///
/// fn pick<IO: Transport, C: Clock, P: Protocol>(
///     gripper: &mut GripperOver<IO, C, P>,
/// ) -> Result<Grip, Error<IO::Error>> {
///     gripper.grip(MmPerS(100.0), Mm(20.0))
/// }
/// # }
/// # #[cfg(not(feature = "embedded-io"))] compile_error!("there is no driver");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MmPerS(pub f32);
