//! Quantities with units, so that arguments cannot be swapped.

/// Defines a quantity, formatted with its unit: `20.5 mm` by `{:.1}`.
macro_rules! quantity {
    ($(#[$meta:meta])* $name:ident $unit:literal) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, PartialOrd, crate::Format)]
        pub struct $name(pub f32);

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                core::fmt::Display::fmt(&self.0, f)?;
                f.write_str(concat!(" ", $unit))
            }
        }
    };
}

quantity! {
    /// An opening width, or another length, in mm.
    Mm "mm"
}

quantity! {
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
    MmPerS "mm/s"
}

quantity! {
    /// A force in N, summed over both fingers.
    N "N"
}
