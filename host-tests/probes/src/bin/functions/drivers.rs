//! Both drivers over both protocols. Excludes the waiting methods of the async driver: polling a completed future panics.

use core::convert::Infallible;
use core::hint::black_box;

use embedded_io::{Read, ReadReady, Write};
use wsg_protocol::driver::{
    Binary, Clock, Config, Error, Gcl, Grip, MotionResult, Pending, Timer, asynch, blocking,
};
use wsg_protocol::gcl::session::RequestError as GclRequestError;
use wsg_protocol::limits::OutOfLimits;
use wsg_protocol::session::RequestError;
use wsg_protocol::{DecodeError, Instant};

use crate::transport::Line;
use crate::{function, functions};

struct Time;

impl Clock for Time {
    fn now(&mut self) -> Instant {
        Instant::from_millis(black_box(0))
    }
}

impl Timer for Time {
    async fn wait_until(&mut self, moment: Instant) {
        black_box(moment);
    }
}

impl embedded_io_async::Read for Line {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        embedded_io::Read::read(self, buffer)
    }
}

impl embedded_io_async::Write for Line {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        embedded_io::Write::write(self, bytes)
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// An opaque client program.
type Program<Gripper> = fn(&mut Gripper) -> Result<Grip, Error<Infallible>>;

pub(crate) fn every_function() {
    blocking();
    asynch();
}

/// The methods that wait in neither driver.
macro_rules! without_waiting {
    ($($gripper:ty),+) => {
        functions! { $(
            $gripper: is_connected, known, age_ms, motion, fast_stop_pending, counters, subscribe, replace_io, into_io;
        )+ }
    };
}

macro_rules! waiting {
    ($($gripper:ty),+) => {
        functions! { $(
            $gripper: connect, announce_disconnect, next_update, loop_back, raw;
            $gripper: home, move_to, move_by, grip, release, stop, fast_stop, acknowledge;
            $gripper: begin_home, begin_move_to, begin_move_by, begin_grip, begin_release;
            $gripper: grip_with_force, begin_grip_with_force, begin_move_to_with_force;
            $gripper: acceleration, set_acceleration, force_limit, set_force_limit, soft_limits, set_soft_limits;
            $gripper: clear_soft_limits, set_overdrive, tare, tag, set_tag;
            $gripper: system_state, gripper_state, statistics, width, speed, force, temperature, system_info, limits;
            $gripper: finger_info, finger_flags, set_finger_power, finger_data;
        )+ }
        $(
            function!(<$gripper>::poll::<Grip>);
            function!(<$gripper>::wait::<Grip>);
            function!(<$gripper>::poll::<()>);
            function!(<$gripper>::wait::<()>);
        )+
    };
}

fn blocking() {
    type OverBinary = blocking::GripperOver<Line, Time, Binary>;
    type OverGcl = blocking::GripperOver<Line, Time, Gcl>;
    type Spinning = blocking::Spinning<Line>;
    without_waiting!(OverBinary, OverGcl);
    waiting!(OverBinary, OverGcl);
    functions! {
        OverBinary: new, with_config;
        OverGcl: new, with_config, assume_limits;
        OverGcl: clamping_travel, set_clamping_travel, part_width_tolerance, set_part_width_tolerance;
        Error<Infallible>: cause;
        Pending<()>: id, clone;
        Grip: from_status;
        Config: default;
        Spinning: read, read_ready, write, flush;
    }
    function!(OverBinary::with_connection, fn(&mut OverBinary, Program<OverBinary>) -> _);
    function!(OverGcl::with_connection, fn(&mut OverGcl, Program<OverGcl>) -> _);
    function!(<Error<Infallible> as core::error::Error>::source);
    function!(<Error<Infallible> as From<RequestError>>::from);
    function!(<Error<Infallible> as From<DecodeError>>::from);
    function!(<Error<Infallible> as From<OutOfLimits>>::from);
    function!(<Error<Infallible> as From<GclRequestError>>::from);
}

fn asynch() {
    type OverBinary = asynch::GripperOver<Line, Time, Binary>;
    type OverGcl = asynch::GripperOver<Line, Time, Gcl>;
    without_waiting!(OverBinary, OverGcl);
    functions! {
        OverBinary: new, with_config;
        OverGcl: new, with_config, assume_limits;
    }
}
