//! A PLC on any bus, which writes its output image, reads its input image, and stops sending.
//!
//! A bus takes part in the tests of every bus by one implementation of [`Plc`], in the module of its master.

use wsg_bridge_fw::Config;
use wsg_fieldbus::{CommandFlags, InputImage, OutputImage};
use wsg_protocol::Status;

use super::World;

/// 20.00 mm, 50.00 mm/s and 40.00 N, without a flag.
pub const PARAMETERS: OutputImage =
    OutputImage { width: 20_00, speed: 50_00, force_limit: 40_00, ..OutputImage::ZERO };

/// A PLC on a bus, connected to a [`World`].
pub trait Plc: Sized {
    /// A bridge on this bus.
    const CONFIG: Config;

    /// Time after which the bridge misses a silent PLC, in milliseconds.
    const TIMEOUT_MS: u32;

    /// Time by which width and force may follow the state in the input image, in milliseconds.
    const MEASURED_MS: u32 = 0;

    /// Powers up a world with FAST_STOP_OK high, and a PLC that has sent nothing yet.
    fn power_up(config: Config, gripper: wsg_sim::Config) -> Self;

    /// Returns the world and the output image.
    fn parts(&mut self) -> (&mut World, &mut OutputImage);

    /// Writes the output image, and waits until the bridge has executed it.
    fn write(&mut self);

    /// Reads the input image.
    fn read(&mut self) -> InputImage;

    /// Returns whether the bus reports a missing gripper, in the bus's own way.
    fn misses_the_gripper(&mut self) -> bool {
        let image = self.read();
        (image.state, image.status) == (wsg_fieldbus::GripperFlags::ERROR, Status::IoError)
    }

    /// Lets time pass while the PLC communicates.
    fn run(&mut self, ms: u32);

    /// Lets time pass while the PLC is silent.
    fn fall_silent(&mut self, ms: u32);

    /// Communicates again after a silence. Writes the output image.
    fn resume(&mut self);

    /// Returns the world. Time passes only in the methods of the PLC.
    fn world(&mut self) -> &mut World {
        self.parts().0
    }

    /// Returns the output image, for changes.
    fn image(&mut self) -> &mut OutputImage {
        self.parts().1
    }

    /// Creates a PLC that has waited for the gripper, and has written this image as the first.
    #[must_use]
    fn connect(config: Config, gripper: wsg_sim::Config, first: OutputImage) -> Self {
        let mut plc = Self::power_up(config, gripper);
        *plc.image() = first;
        plc.fall_silent(500);
        plc.resume();
        plc
    }

    /// Creates a PLC that has written zeros.
    #[must_use]
    fn ready(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut plc = Self::connect(config, gripper, OutputImage::ZERO);
        *plc.image() = PARAMETERS;
        plc.write();
        plc
    }

    /// Creates a PLC that has referenced the fingers.
    #[must_use]
    fn homed(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut plc = Self::ready(config, gripper);
        assert_eq!(plc.command(CommandFlags::HOMING), Status::Success);
        plc.world().take_sent();
        plc
    }

    /// Writes these flags.
    fn set(&mut self, flags: CommandFlags) {
        self.image().flags = flags;
        self.write();
    }

    /// Writes these flags with this width.
    fn set_with_width(&mut self, flags: CommandFlags, width: i16) {
        self.image().width = width;
        self.set(flags);
    }

    /// Gives an edge, clears the flag, and returns the status at the end.
    ///
    /// # Panics
    /// Panics when the command does not end.
    fn command(&mut self, flags: CommandFlags) -> Status {
        self.set(flags);
        self.set(CommandFlags::empty());
        self.end_of_command()
    }

    /// Waits for the end of a command, and returns its status.
    ///
    /// # Panics
    /// Panics when the command does not end.
    fn end_of_command(&mut self) -> Status {
        for _ in 0..20_000 {
            let status = self.read().status;
            if status != Status::CmdPending {
                return status;
            }
            self.run(5);
        }
        panic!("the command does not end");
    }
}
