//! A pick-and-place station on a board: `no_std`, no allocation, whatever UART the board's HAL has.
//!
//! It is a library, so that it is compiled for the host with all other examples, and for a board by
//!
//! ```text
//! cargo build -p wsg-protocol --example no_std_board --features embedded-io --target thumbv7em-none-eabihf
//! ```
#![no_std]

use wsg_protocol::driver::{
    self, Clock, Error, Grip, Mm, MmPerS, N, OnBlock,
    blocking::{self, Transport},
};
use wsg_protocol::{HomingDirection, session};

/// A gripper with small buffers: replies up to a device tag, commands up to Pre-position Fingers. Some 600 bytes of RAM.
pub type Gripper<Uart, Tick> = blocking::Gripper<Uart, Tick, 66, 17>;

/// How wide the fingers are at a part.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// When they hold it.
    pub width: Mm,
    /// When it fits between them.
    pub open: Mm,
}

const SPEED: MmPerS = MmPerS(200.0);
const GRIP_SPEED: MmPerS = MmPerS(100.0);

/// What one cycle came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cycle {
    /// A part was taken and put down.
    Done,
    /// There was none.
    Empty,
}

/// The gripper on this UART; the tick is the board's millisecond counter.
pub const fn gripper<Uart: Transport, Tick: Clock>(uart: Uart, tick: Tick) -> Gripper<Uart, Tick> {
    const CONFIG: driver::Config = driver::Config {
        session: session::Config { width: true, ..driver::Config::DEFAULT.session },
        ..driver::Config::DEFAULT
    };
    Gripper::with_config(uart, tick, CONFIG)
}

/// After power-up: finds the gripper, references its fingers, sets the force.
///
/// # Errors
/// Those of the driver.
pub fn set_up<Uart: Transport, Tick: Clock>(
    gripper: &mut Gripper<Uart, Tick>,
    force: f32,
) -> Result<(), Error<Uart::Error>> {
    gripper.connect()?;
    gripper.home(HomingDirection::Default)?;
    gripper.set_force_limit(N(force))
}

/// Takes a part, has `carry` bring it where it belongs, and puts it down.
///
/// # Errors
/// Those of the driver.
pub fn cycle<Uart: Transport, Tick: Clock>(
    gripper: &mut Gripper<Uart, Tick>,
    part: Part,
    carry: impl FnOnce(),
) -> Result<Cycle, Error<Uart::Error>> {
    gripper.move_to(part.open, SPEED, OnBlock::Stop)?;
    match gripper.grip(part.width, GRIP_SPEED)? {
        Grip::NoPart => Ok(Cycle::Empty),
        Grip::Held => {
            carry();
            gripper.release(part.open, SPEED)?;
            Ok(Cycle::Done)
        }
    }
}
