//! A common interface for the tests: blocking or async driver, over the binary protocol or GCL.

use std::convert::Infallible;

use wsg_protocol::driver::{
    self, DriverCounters, Finger, Grip, Mm, MmPerS, MotionResult, N, OnBlock, Pending, Protocol, Update,
    asynch, blocking,
};
use wsg_protocol::session::{Known, Topic};
use wsg_protocol::{
    AutoUpdate, CommandId, DeviceTag, FingerFlags, FingerInfo, GripperState, GrippingStatistics,
    HomingDirection, SystemFlags, SystemInfo, Temperature,
};
use wsg_sim::{Config, PortKind};

use crate::rig::TestRig;

pub(crate) type Error = driver::Error<Infallible>;
type Result<T> = std::result::Result<T, Error>;

/// The error of a program: a driver's error, or its own.
#[derive(Debug, PartialEq)]
pub(crate) enum ProgramError {
    Driver(Error),
    Own,
}

impl From<Error> for ProgramError {
    fn from(error: Error) -> Self {
        Self::Driver(error)
    }
}

pub(crate) type Outcome = std::result::Result<u8, ProgramError>;

/// Defines a test for each body and type: protocols, or drivers over a protocol.
macro_rules! for_all {
    ($($module:ident $client:ty),*; $(fn $name:ident;)*) => {
        for_all!(@modules [$($name)*] $($module $client),*);
    };
    (@modules $names:tt $($module:ident $client:ty),*) => {
        $(for_all!(@module $module $client, $names);)*
    };
    (@module $module:ident $client:ty, [$($name:ident)*]) => {
        mod $module {
            use super::*;

            $(#[test]
            fn $name() {
                super::$name::<$client>();
            })*
        }
    };
}
pub(crate) use for_all;

/// A protocol and its drivers.
pub(crate) trait Speech {
    type Protocol: Protocol;
    /// The port of the virtual gripper for this protocol, over a connection that detects its end.
    const PORT: PortKind;
    /// A port on a line whose end is not announced.
    const ANONYMOUS_PORT: PortKind;
    /// Input that a driver of this protocol must ignore.
    const GARBAGE: &[u8];
    fn blocking(rig: &TestRig) -> blocking::GripperOver<TestRig, TestRig, Self::Protocol>;
    fn asynch(rig: &TestRig) -> asynch::GripperOver<TestRig, TestRig, Self::Protocol>;
}

pub(crate) enum Frames {}

/// GCL.
pub(crate) enum Lines {}

impl Speech for Frames {
    type Protocol = driver::Binary;
    const PORT: PortKind = PortKind::Tcp;
    const ANONYMOUS_PORT: PortKind = PortKind::Serial;
    // A truncated preamble, a frame with a wrong checksum, and an unsolicited answer.
    const GARBAGE: &[u8] =
        b"\xAA\xAA\x00noise\xAA\xAA\xAA\x43\x02\x00\x00\x00\x00\x00\xAA\xAA\xAA\x20\x02\x00\x00\x00\xB3\xFD";

    fn blocking(rig: &TestRig) -> blocking::GripperOver<TestRig, TestRig, Self::Protocol> {
        blocking::Gripper::new(rig.clone(), rig.clone())
    }

    fn asynch(rig: &TestRig) -> asynch::GripperOver<TestRig, TestRig, Self::Protocol> {
        asynch::Gripper::new(rig.clone(), rig.clone())
    }
}

impl Speech for Lines {
    type Protocol = driver::Gcl;
    const PORT: PortKind = PortKind::GclTcp;
    const ANONYMOUS_PORT: PortKind = PortKind::GclUdp;
    const GARBAGE: &[u8] = b"\xFF\x00noise\nPOS=\nFIN HOME\nERR DANCE 14\nACK\r\n@TAG=\"x\"\n\n";

    fn blocking(rig: &TestRig) -> blocking::GripperOver<TestRig, TestRig, Self::Protocol> {
        let mut gripper = blocking::GclGripper::new(rig.clone(), rig.clone());
        gripper.assume_limits(rig.limits());
        gripper
    }

    fn asynch(rig: &TestRig) -> asynch::GripperOver<TestRig, TestRig, Self::Protocol> {
        let mut gripper = asynch::GclGripper::new(rig.clone(), rig.clone());
        gripper.assume_limits(rig.limits());
        gripper
    }
}

pub(crate) struct Blocking<S: Speech> {
    pub(crate) rig: TestRig,
    pub(crate) gripper: blocking::GripperOver<TestRig, TestRig, S::Protocol>,
}

/// The async driver; each call runs to completion.
pub(crate) struct Asynch<S: Speech> {
    pub(crate) rig: TestRig,
    pub(crate) gripper: asynch::GripperOver<TestRig, TestRig, S::Protocol>,
}

/// The interface that every test uses.
pub(crate) trait Client: Calls + Sized {
    type Speech: Speech;

    /// Returns a driver that is not connected, with its gripper.
    fn at(rig: TestRig) -> Self;

    fn new(config: Config) -> Self {
        Self::at(TestRig::new(Self::Speech::PORT, config))
    }

    fn rig(&self) -> TestRig;

    /// Returns a connected driver.
    fn connected(config: Config) -> Self {
        let mut client = Self::new(config);
        client.connect().expect("the gripper answers");
        client
    }

    /// Returns a connected driver with homed fingers and a force limit of 40 N.
    fn homed(config: Config) -> Self {
        let mut client = Self::connected(config);
        client.home(HomingDirection::Default).expect("the path is clear");
        client.set_force_limit(N(40.0)).expect("40 N is within the limits");
        client
    }
}

impl<S: Speech> Client for Blocking<S> {
    type Speech = S;

    fn at(rig: TestRig) -> Self {
        Self { gripper: S::blocking(&rig), rig }
    }

    fn rig(&self) -> TestRig {
        self.rig.clone()
    }
}

impl<S: Speech> Client for Asynch<S> {
    type Speech = S;

    fn at(rig: TestRig) -> Self {
        Self { gripper: S::asynch(&rig), rig }
    }

    fn rig(&self) -> TestRig {
        self.rig.clone()
    }
}

/// Defines the methods that all drivers share.
macro_rules! calls {
    ($(fn $name:ident $([$T:ident: $bound:ident])? ($($arg:ident: $type:ty),*) -> $result:ty;)*) => {
        pub(crate) trait Calls {
            $(fn $name $(<$T: $bound>)? (&mut self, $($arg: $type),*) -> Result<$result>;)*
            fn tag(&mut self) -> Result<String>;
            fn finger_data(&mut self, finger: Finger) -> Result<Vec<u8>>;
            /// Runs a program with `with_connection` that starts a slow motion and returns `end()` while it runs.
            fn with_connection(&mut self, end: impl FnOnce() -> Outcome) -> Outcome;
            fn is_connected(&self) -> bool;
            fn known(&self) -> Known;
            fn motion(&self) -> Option<CommandId>;
            fn fast_stop_pending(&self) -> bool;
            fn counters(&self) -> DriverCounters;
            fn subscribe(&mut self, topic: Topic, update: AutoUpdate);
            /// Continues with a new connection to the same gripper.
            fn take_new_line(&mut self);
        }

        impl<S: Speech> Calls for Blocking<S> {
            $(fn $name $(<$T: $bound>)? (&mut self, $($arg: $type),*) -> Result<$result> {
                self.gripper.$name($($arg),*)
            })*

            fn tag(&mut self) -> Result<String> {
                self.gripper.tag(&mut [0; DeviceTag::MAX_LEN]).map(str::to_owned)
            }

            fn finger_data(&mut self, finger: Finger) -> Result<Vec<u8>> {
                self.gripper.finger_data(finger, &mut [0; 16]).map(<[u8]>::to_vec)
            }

            fn with_connection(&mut self, end: impl FnOnce() -> Outcome) -> Outcome {
                self.gripper.with_connection(|gripper| {
                    gripper.home(HomingDirection::Default)?;
                    let _ = gripper.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop)?;
                    end()
                })
            }

            calls!(@at_once);
        }

        impl<S: Speech> Calls for Asynch<S> {
            $(fn $name $(<$T: $bound>)? (&mut self, $($arg: $type),*) -> Result<$result> {
                self.rig.run(self.gripper.$name($($arg),*))
            })*

            fn tag(&mut self) -> Result<String> {
                self.rig.run(self.gripper.tag(&mut [0; DeviceTag::MAX_LEN])).map(str::to_owned)
            }

            fn finger_data(&mut self, finger: Finger) -> Result<Vec<u8>> {
                self.rig.run(self.gripper.finger_data(finger, &mut [0; 16])).map(<[u8]>::to_vec)
            }

            fn with_connection(&mut self, end: impl FnOnce() -> Outcome) -> Outcome {
                self.rig.run(self.gripper.with_connection(async |gripper| {
                    gripper.home(HomingDirection::Default).await?;
                    let _ = gripper.begin_move_to(Mm(10.0), MmPerS(20.0), OnBlock::Stop).await?;
                    end()
                }))
            }

            calls!(@at_once);
        }
    };
    (@at_once) => {
        fn is_connected(&self) -> bool {
            self.gripper.is_connected()
        }

        fn known(&self) -> Known {
            *self.gripper.known()
        }

        fn motion(&self) -> Option<CommandId> {
            self.gripper.motion()
        }

        fn fast_stop_pending(&self) -> bool {
            self.gripper.fast_stop_pending()
        }

        fn counters(&self) -> DriverCounters {
            self.gripper.counters()
        }

        fn subscribe(&mut self, topic: Topic, update: AutoUpdate) {
            self.gripper.subscribe(topic, update);
        }

        fn take_new_line(&mut self) {
            self.rig.reconnect();
            self.gripper.replace_io(self.rig.clone());
        }
    };
}

calls! {
    fn connect() -> ();
    fn announce_disconnect() -> ();
    fn home(direction: HomingDirection) -> ();
    fn move_to(width: Mm, speed: MmPerS, block: OnBlock) -> ();
    fn begin_move_to(width: Mm, speed: MmPerS, block: OnBlock) -> Pending<()>;
    fn move_by(offset: Mm, speed: MmPerS, block: OnBlock) -> ();
    fn begin_move_to_with_force(width: Mm, speed: MmPerS, block: OnBlock, force: N) -> Pending<()>;
    fn grip(width: Mm, speed: MmPerS) -> Grip;
    fn grip_with_force(width: Mm, speed: MmPerS, force: N) -> Grip;
    fn begin_grip(width: Mm, speed: MmPerS) -> Pending<Grip>;
    fn release(width: Mm, speed: MmPerS) -> ();
    fn wait[T: MotionResult](pending: &Pending<T>) -> T;
    fn poll[T: MotionResult](pending: &Pending<T>) -> Option<T>;
    fn stop() -> ();
    fn fast_stop() -> ();
    fn acknowledge() -> ();
    fn set_force_limit(force: N) -> ();
    fn force_limit() -> N;
    fn tare() -> ();
    fn system_state() -> SystemFlags;
    fn gripper_state() -> GripperState;
    fn statistics(reset: bool) -> GrippingStatistics;
    fn width() -> Mm;
    fn speed() -> MmPerS;
    fn force() -> N;
    fn temperature() -> Temperature;
    fn system_info() -> SystemInfo;
    fn finger_info(finger: Finger) -> FingerInfo;
    fn finger_flags(finger: Finger) -> FingerFlags;
    fn next_update(within_ms: u32) -> Option<Update>;
}
