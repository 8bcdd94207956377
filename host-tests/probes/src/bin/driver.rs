//! Every public function of `wsg-protocol`'s blocking driver, over the binary protocol and over GCL.
#![no_std]
#![no_main]

use core::convert::Infallible;

use cortex_m_rt::entry;
use embedded_io::{ErrorType, Read, ReadReady, Write};
use wsg_probes::{bytes, keep, opaque};
use wsg_protocol::driver::blocking::{GclGripper, GripperOver};
use wsg_protocol::driver::{Binary, Clock, Config, Finger, Gcl, OnBlock, Protocol};
use wsg_protocol::session::Signal;
use wsg_protocol::{AutoUpdate, DeviceTag, HomingDirection, Instant, SoftLimits};

/// A transport that nothing is known of.
struct Line;

impl ErrorType for Line {
    type Error = Infallible;
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(opaque(true))
    }
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        Ok(opaque(&mut *buffer).len().min(opaque(0)))
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        keep(bytes);
        Ok(opaque(bytes.len()))
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A clock that nothing is known of.
struct Time;

impl Clock for Time {
    fn now(&mut self) -> Instant {
        Instant::from_millis(opaque(0))
    }
}

type Over<P> = GripperOver<Line, Time, P>;

#[entry]
fn main() -> ! {
    static mut BINARY: Over<Binary> = GripperOver::<Line, Time, Binary>::new(Line, Time);
    static mut GCL: Over<Gcl> = GclGripper::new(Line, Time);
    loop {
        *BINARY = GripperOver::<Line, Time, Binary>::with_config(Line, Time, Config::DEFAULT);
        *GCL = GclGripper::with_config(Line, Time, Config::DEFAULT);
        every_method(opaque(&mut *BINARY));
        every_method(opaque(&mut *GCL));
        of_gcl_alone(opaque(&mut *GCL));
        keep(&GripperOver::<Line, Time, Binary>::new(Line, Time).into_io());
    }
}

fn every_method<P: Protocol>(gripper: &mut Over<P>) {
    keep(&gripper.replace_io(Line));
    connection(gripper);
    motions(gripper);
    settings(gripper);
    states(gripper);
    fingers(gripper);
}

#[inline(never)]
fn of_gcl_alone(gripper: &mut Over<Gcl>) {
    keep(&gripper.part_width_tolerance());
    keep(&gripper.set_part_width_tolerance(opaque(0.0)));
    keep(&gripper.clamping_travel());
    keep(&gripper.set_clamping_travel(opaque(0.0)));
}

#[inline(never)]
fn connection<P: Protocol>(gripper: &mut Over<P>) {
    if let Err(error) = gripper.connect() {
        keep(&error.culprit());
    }
    keep(&gripper.next_update(opaque(0)));
    gripper.subscribe(opaque(Signal::Force), AutoUpdate::once());
    keep(&(gripper.is_connected(), gripper.motion(), gripper.owes_fast_stop(), gripper.counters()));
    keep(gripper.known());
    keep(&gripper.loop_back(bytes()));
    keep(&gripper.raw(opaque(0), bytes(), opaque(&mut [0; 64][..])));
    keep(&gripper.announce_disconnect());
}

#[inline(never)]
fn motions<P: Protocol>(gripper: &mut Over<P>) {
    keep(&gripper.home(HomingDirection::Default));
    keep(&gripper.begin_home(HomingDirection::Default));
    keep(&gripper.move_to(opaque(0.0), opaque(0.0), opaque(OnBlock::Stop)));
    keep(&gripper.begin_move_to(opaque(0.0), opaque(0.0), opaque(OnBlock::Stop)));
    keep(&gripper.move_by(opaque(0.0), opaque(0.0), opaque(OnBlock::Stop)));
    keep(&gripper.begin_move_by(opaque(0.0), opaque(0.0), opaque(OnBlock::Stop)));
    keep(&gripper.grip(opaque(0.0), opaque(0.0)));
    if let Ok(pending) = gripper.begin_grip(opaque(0.0), opaque(0.0)) {
        keep(&pending.id());
        keep(&gripper.poll(&pending));
        keep(&gripper.wait(&pending));
    }
    keep(&gripper.release(opaque(0.0), opaque(0.0)));
    keep(&gripper.begin_release(opaque(0.0), opaque(0.0)));
    keep(&gripper.stop());
    keep(&gripper.fast_stop());
    keep(&gripper.acknowledge());
}

#[inline(never)]
fn settings<P: Protocol>(gripper: &mut Over<P>) {
    keep(&gripper.set_acceleration(opaque(0.0)));
    keep(&gripper.acceleration());
    keep(&gripper.set_force_limit(opaque(0.0)));
    keep(&gripper.force_limit());
    keep(&gripper.set_soft_limits(SoftLimits { minus: opaque(0.0), plus: opaque(0.0) }));
    keep(&gripper.soft_limits());
    keep(&gripper.clear_soft_limits());
    keep(&gripper.set_overdrive(opaque(false)));
    keep(&gripper.tare());
    keep(&gripper.set_tag(opaque("WSG")));
}

#[inline(never)]
fn states<P: Protocol>(gripper: &mut Over<P>) {
    keep(&gripper.system_state());
    keep(&gripper.state());
    keep(&gripper.statistics(opaque(false)));
    keep(&gripper.width());
    keep(&gripper.speed());
    keep(&gripper.force());
    keep(&gripper.temperature());
    keep(&gripper.system_info());
    keep(&gripper.limits());
    keep(&gripper.tag(&mut [0; DeviceTag::MAX_LEN]));
}

#[inline(never)]
fn fingers<P: Protocol>(gripper: &mut Over<P>) {
    keep(&gripper.finger_info(opaque(Finger::One)));
    keep(&gripper.finger_flags(opaque(Finger::One)));
    keep(&gripper.set_finger_power(opaque(Finger::One), opaque(false)));
    keep(&gripper.finger_data(opaque(Finger::One), opaque(&mut [0; 64][..])));
}
