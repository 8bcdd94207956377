//! A pick-and-place station on a board: `no_std`, without allocation, with any HAL's UART.
//!
//! As a library, it is compiled for the host with the other examples. Compile it for a board by
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

/// A gripper with small buffers: replies up to a device tag, commands up to Pre-position Fingers. It needs about 600 bytes of
/// RAM.
pub type Gripper<Uart, Tick> = blocking::Gripper<Uart, Tick, 66, 17>;

/// Finger widths for a part.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// The width when holding the part.
    pub width: Mm,
    /// The width when the part fits between the fingers.
    pub open: Mm,
}

const SPEED: MmPerS = MmPerS(200.0);
const GRIP_SPEED: MmPerS = MmPerS(100.0);

/// The result of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cycle {
    /// A part was picked and placed.
    Done,
    /// There was no part.
    Empty,
}

/// Returns the gripper on this UART. The tick is the board's millisecond counter.
pub const fn gripper<Uart: Transport, Tick: Clock>(uart: Uart, tick: Tick) -> Gripper<Uart, Tick> {
    const CONFIG: driver::Config = driver::Config {
        session: session::Config { width: true, ..driver::Config::DEFAULT.session },
        ..driver::Config::DEFAULT
    };
    Gripper::with_config(uart, tick, CONFIG)
}

/// Connects after power-up, homes the fingers and sets the force limit.
///
/// # Errors
/// Returns the errors of the driver.
pub fn set_up<Uart: Transport, Tick: Clock>(
    gripper: &mut Gripper<Uart, Tick>,
    force: f32,
) -> Result<(), Error<Uart::Error>> {
    gripper.connect()?;
    gripper.home(HomingDirection::Default)?;
    gripper.set_force_limit(N(force))
}

/// Picks a part, calls `carry` to move it to its place, and releases it.
///
/// # Errors
/// Returns the errors of the driver.
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
