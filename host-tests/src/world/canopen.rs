//! A CANopen master: NMT, heartbeat and PDOs. A test adds SDOs.

use wsg_bridge_fw::can::{DEFAULT_NODE, NodeConfig};
use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{Config, PlcBus};
use wsg_fieldbus::{GripperFlags, InputImage, OutputImage};
use wsg_protocol::can::Identifiers;
use wsg_protocol::{Status, SystemFlags};

use super::World;
use super::plc::Plc;

/// Default identifiers of the node.
pub const NODE: NodeConfig = DEFAULT_NODE;

/// Function codes (CiA 301, 7.3.3), without the node's identifier.
const TPDO1: u16 = 0x180;
const RPDO1: u16 = 0x200;
const TPDO2: u16 = 0x280;

/// Time in which the bridge executes a frame and answers it, in milliseconds.
const ANSWERED_MS: u32 = 5;

/// A master, the [`World`] that it is connected to, and the frames of the node.
pub struct Master {
    /// The world. Only [`pass`](Self::pass) keeps the node's frames.
    pub world: World,
    /// The last image sent.
    pub image: OutputImage,
    /// Time in milliseconds, identifier and data of frames that no test has taken.
    frames: Vec<(u32, u16, Vec<u8>)>,
    /// TPDO1 and TPDO2 as they were sent last.
    tpdos: [Option<Vec<u8>>; 2],
}

impl Master {
    /// Connects a master to a bridge.
    #[must_use]
    pub const fn of(world: World) -> Self {
        Self { world, image: OutputImage::ZERO, frames: Vec::new(), tpdos: [None, None] }
    }

    /// Lets time pass.
    pub fn pass(&mut self, ms: u32) {
        self.world.pass(ms);
        let to_gripper = Identifiers::DEFAULT.controller().transmit.as_raw();
        for frame in self.world.can.take_frames().into_iter().filter(|(_, id, _)| *id != to_gripper) {
            for (tpdo, base) in self.tpdos.iter_mut().zip([TPDO1, TPDO2]) {
                if frame.1 == of_node(base) {
                    *tpdo = Some(frame.2.clone());
                }
            }
            self.frames.push(frame);
        }
    }

    /// Waits for a state.
    ///
    /// # Panics
    /// Panics when it is not reached.
    pub fn until(&mut self, bound_ms: u32, wanted: impl Fn(&Self) -> bool) {
        for _ in 0..bound_ms {
            self.pass(1);
            if wanted(self) {
                return;
            }
        }
        panic!("not within {bound_ms} ms: {:?} {:?}", self.state(), self.system());
    }

    /// Queues a data frame.
    pub fn send(&mut self, id: u16, data: &[u8]) {
        self.world.can.send(id, data);
    }

    /// Sends an NMT command to the node.
    pub fn nmt(&mut self, specifier: u8) {
        self.send(0, &[specifier, NODE.node]);
        self.pass(ANSWERED_MS);
    }

    /// Sends the output image.
    pub fn write_image(&mut self) {
        let [flags, user, w1, w0, s1, s0, f1, f0] = self.image.to_bytes();
        self.send(of_node(RPDO1), &[flags, user, w0, w1, s0, s1, f0, f1]);
        self.pass(ANSWERED_MS);
    }

    /// Returns the last TPDO1 or TPDO2.
    #[must_use]
    pub fn tpdo(&self, base: u16) -> Option<&[u8]> {
        self.tpdos[usize::from(base == TPDO2)].as_deref()
    }

    /// Returns the input image of the last TPDOs, zero before them.
    ///
    /// # Panics
    /// Panics when a TPDO has another length.
    #[must_use]
    pub fn input(&self) -> InputImage {
        let [state, user, s0, s1, s2, s3, c0, c1] = self.tpdo(TPDO1).unwrap_or(&[0; 8]) else {
            panic!("TPDO1 has 8 bytes")
        };
        let [w0, w1, f0, f1] = self.tpdo(TPDO2).unwrap_or(&[0; 4]) else { panic!("TPDO2 has 4 bytes") };
        InputImage::from_bytes([state, user, s0, s1, s2, s3, w1, w0, f1, f0, c1, c0].map(|byte| *byte))
    }

    /// Returns GSTATE.
    #[must_use]
    pub fn state(&self) -> GripperFlags {
        self.input().state
    }

    /// Returns SYSSTATE.
    #[must_use]
    pub fn system(&self) -> SystemFlags {
        self.input().system
    }

    /// Returns the status register.
    #[must_use]
    pub fn status(&self) -> Status {
        self.input().status
    }

    /// Returns the frames of one kind received since the last call, with their times.
    pub fn take(&mut self, base: u16) -> Vec<(u32, Vec<u8>)> {
        let taken = self.frames.extract_if(.., |(_, id, _)| *id == of_node(base));
        taken.map(|(at, _, data)| (at, data)).collect()
    }
}

/// Returns the identifier of the node for a function code.
const fn of_node(base: u16) -> u16 {
    base | NODE.node as u16
}

impl Plc for Master {
    const CONFIG: Config = Config { plc_bus: PlcBus::Canopen, ..Config::DEFAULT };
    const TIMEOUT_MS: u32 = Config::DEFAULT.bus.timeout_ms as u32;
    /// The inhibit time of TPDO2, in 100 us, and a turn.
    const MEASURED_MS: u32 = NODE.inhibit[1] as u32 / 10 + 1;

    fn power_up(config: Config, gripper: wsg_sim::Config) -> Self {
        let mut world = World::new(config, gripper);
        world.set(Inputs::FAST_STOP_OK, true);
        Self::of(world)
    }

    fn parts(&mut self) -> (&mut World, &mut OutputImage) {
        (&mut self.world, &mut self.image)
    }

    fn write(&mut self) {
        self.write_image();
    }

    fn read(&mut self) -> InputImage {
        self.input()
    }

    fn run(&mut self, ms: u32) {
        self.pass(ms);
    }

    fn fall_silent(&mut self, ms: u32) {
        self.world.can.beats = false;
        self.pass(ms);
    }

    fn resume(&mut self) {
        self.world.can.beats = true;
        self.nmt(1);
        self.write_image();
    }
}
