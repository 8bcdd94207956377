//! Every fault of one bit or one byte on the gripper's line, at every place of a grip cycle or a jog, in both directions, with
//! FAST STOP asked for at every millisecond around it: how long the gripper takes to stop.
//!
//! Bridge library and virtual gripper in virtual time, on a line that carries 115 200 bit/s each way. A case goes on from a
//! snapshot of the undisturbed cycle, so that hundreds of thousands of them take seconds.

use wsg_bridge_fw::Config;
use wsg_bridge_fw::gripper::TO_SEND_MAX;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_protocol::SystemFlags;
use wsg_sim::Part;

use crate::chance::Chance;
use crate::faulty_link::{Fault, FaultyWay, Rates};
use crate::modbus_bench::{JOG_PLUS, ModbusLines};
use crate::serial_gripper::{Carry, SerialGripper};
use crate::wires::Wires;
use crate::world::World;

/// Hundredths of a byte that the line carries in a millisecond: 10 bits a byte.
const HUNDREDTHS_PER_MS: u32 = 1_152;

/// Each fault of a byte: changed to any other value, lost, doubled, and any other byte before it.
fn every_fault() -> Vec<Fault> {
    let flipped = (1..=u8::MAX).map(Fault::Flip);
    flipped.chain([Fault::Drop, Fault::Duplicate]).chain((0..=u8::MAX).map(Fault::Insert)).collect()
}

/// Each bit flipped by itself, lost, doubled, and a few bytes added: those that a preamble, a silent line and a broken line
/// look like.
fn usual_faults() -> Vec<Fault> {
    let flipped = (0..8).map(|bit| Fault::Flip(1 << bit));
    flipped.chain([Fault::Drop, Fault::Duplicate]).chain([0x00, 0xAA, 0xFF].map(Fault::Insert)).collect()
}

/// Which way a byte goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// From bridge to gripper.
    Out,
    /// From gripper to bridge.
    Back,
}

/// One way of the line.
#[derive(Clone, Debug)]
struct Wire {
    /// What the line may carry of it now, in hundredths of a byte.
    budget: u32,
    way: FaultyWay,
}

/// A damaged byte of a case, counted from the beginning of the course.
pub type Damage = (Way, usize, Fault);

/// When the stop is asked for, in milliseconds from the beginning of the course, and what is damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Case {
    /// When the stop is asked for.
    pub stop_at: usize,
    /// The damaged bytes. Those from [`Course::bytes_until`] on are what follows the request.
    pub damage: Vec<Damage>,
}

impl Wire {
    const fn new() -> Self {
        Self { budget: 0, way: FaultyWay::perfect() }
    }
}

impl Carry for Wire {
    fn carry(&mut self, waiting: &mut Vec<u8>) -> Vec<u8> {
        let budget = self.budget + HUNDREDTHS_PER_MS;
        let count = waiting.len().min((budget / 100) as usize);
        // A line that was idle carries no more for that.
        self.budget = if waiting.len() > count { budget % 100 } else { 0 };
        let bytes: Vec<u8> = waiting.drain(..count).collect();
        self.way.pass(0, &bytes);
        self.way.arrive(0)
    }
}

/// Bridge, line and gripper, wires and a Modbus bus.
type Rig = World<ModbusLines, Wire>;

impl Rig {
    fn switched_on(time_scale: f32, frame_timeout_ms: u16) -> Self {
        let config = wsg_sim::Config {
            part: Part::of_width(20.0),
            time_scale,
            frame_timeout_ms,
            ..wsg_sim::Config::default()
        };
        let far = SerialGripper::over(config, TO_SEND_MAX, [Wire::new(), Wire::new()]);
        let lines = ModbusLines::new(&Config::DEFAULT);
        Self::with(Config::DEFAULT, lines, far, Inputs::FAST_STOP_OK)
    }

    /// Gives a motion command, and waits for its end.
    fn course_of(&mut self, wire: Inputs, each: &mut impl FnMut(&Self)) {
        self.inputs |= wire;
        for _ in 0..6 {
            self.step();
            each(self);
        }
        self.inputs -= wire;
        loop {
            self.step();
            each(self);
            assert!(self.now_ms < 60_000, "{wire:?} does not end");
            if self.outputs.contains(Outputs::READY) {
                return;
            }
        }
    }

    /// Referenced and ready.
    fn homed(time_scale: f32, frame_timeout_ms: u16) -> Self {
        let mut rig = Self::switched_on(time_scale, frame_timeout_ms);
        rig.pass(200);
        assert!(rig.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", rig.outputs);
        rig.course_of(Inputs::HOME, &mut |_| {});
        rig.take_sent();
        rig
    }

    fn wire(&mut self, way: Way) -> &mut Wire {
        let SerialGripper { to_gripper, to_bridge, .. } = &mut self.far;
        match way {
            Way::Out => to_gripper,
            Way::Back => to_bridge,
        }
    }

    /// The bytes that have gone this way.
    fn count(&self, way: Way) -> usize {
        let SerialGripper { to_gripper, to_bridge, .. } = &self.far;
        let wire = if way == Way::Out { to_gripper } else { to_bridge };
        wire.way.counts().bytes as usize
    }

    fn is_moving(&self) -> bool {
        self.far.gripper.state().flags.contains(SystemFlags::MOVING)
    }

    fn ask_for_stop(&mut self, scene: Scene) {
        match scene {
            Scene::GripCycle => self.inputs -= Inputs::FAST_STOP_OK,
            Scene::Jog => self.write(0),
            Scene::Silence => self.bus.repeat(None),
        }
    }

    /// Writes these flags, with 40.00 mm, 50.00 mm/s, 40.00 N, at once, and again and again.
    fn write(&mut self, flags: u8) {
        self.bus.repeat(Some([u16::from(flags) << 8, 40_00, 50_00, 40_00]));
    }
}

/// What is stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scene {
    /// Grip and release, ended by the wire FAST_STOP_OK: until the gripper is in FAST STOP.
    GripCycle,
    /// A jog over Modbus, ended by its flag: until the fingers stand.
    Jog,
    /// A jog over Modbus whose master falls silent: until the fingers stand.
    Silence,
}

/// The undisturbed course of a scene, millisecond by millisecond.
#[derive(Debug)]
pub struct Course {
    scene: Scene,
    snapshots: Vec<Rig>,
}

impl Course {
    /// Plays a scene against a gripper that gives up half a frame after so long.
    #[must_use]
    pub fn play(scene: Scene, frame_timeout_ms: u16) -> Self {
        let mut snapshots = vec![];
        let mut keep = |rig: &Rig| snapshots.push(rig.clone());
        match scene {
            Scene::GripCycle => {
                let mut rig = Rig::homed(10.0, frame_timeout_ms);
                keep(&rig);
                rig.course_of(Inputs::GRIP, &mut keep);
                rig.course_of(Inputs::RELEASE, &mut keep);
            }
            Scene::Jog | Scene::Silence => {
                // At its own speed: 1.8 s to the end of the stroke, where it would end by itself.
                let mut rig = Rig::homed(1.0, frame_timeout_ms);
                rig.course_of(Inputs::MOVE, &mut |_| {});
                rig.write(0);
                rig.pass(100);
                rig.write(JOG_PLUS);
                keep(&rig);
                for _ in 0..100 {
                    rig.step();
                    keep(&rig);
                }
                assert!(rig.is_moving(), "the jog runs");
            }
        }
        Self { scene, snapshots }
    }

    /// How many milliseconds the course takes.
    #[must_use]
    pub const fn duration_ms(&self) -> usize {
        self.snapshots.len()
    }

    /// How many bytes have gone this way when the stop is asked for after `stop_at` milliseconds.
    #[must_use]
    pub fn bytes_until(&self, way: Way, stop_at: usize) -> usize {
        let count =
            |at: usize| self.snapshots.get(at).or(self.snapshots.last()).map_or(0, |rig| rig.count(way));
        count(stop_at) - count(0)
    }

    /// How many milliseconds pass from the request to stop until the gripper has stopped; none if it has not after
    /// `bound_ms`.
    #[must_use]
    pub fn stop(&self, case: &Case, bound_ms: u32) -> Option<u32> {
        let first = self.snapshots.first()?;
        // The last moment before any of the damaged bytes leaves.
        let is_before = |at: usize| {
            let left = |(way, byte, _): &Damage| self.bytes_until(*way, at) > *byte;
            !case.damage.iter().any(left)
        };
        let last = case.stop_at.min(self.snapshots.len() - 1);
        let begin = (0..=last).rev().find(|at| is_before(*at)).unwrap_or(0);
        let mut rig = self.snapshots.get(begin)?.clone();
        for (way, byte, fault) in &case.damage {
            let at = first.count(*way) + byte;
            rig.wire(*way).way.hit(at as u64, *fault);
        }
        // Behind the course it goes on without a command.
        rig.pass((case.stop_at - begin) as u32);
        rig.ask_for_stop(self.scene);
        self.time_until_stopped(&mut rig, bound_ms)
    }

    /// As [`stop`](Self::stop), but with noise both ways from `noise_ms` before the request until as long behind it, which
    /// hits bytes at this rate; counts from the end of the noise.
    #[must_use]
    pub fn stop_in_noise(
        &self,
        stop_at: usize,
        noise_ms: u32,
        rate: f64,
        seed: u64,
        bound_ms: u32,
    ) -> Option<u32> {
        let begin = stop_at.saturating_sub(noise_ms as usize);
        let mut rig = self.snapshots.get(begin)?.clone();
        for (way, seed) in [(Way::Out, seed), (Way::Back, !seed)] {
            rig.wire(way).way = FaultyWay::new(Rates::of_bytes(rate), seed);
        }
        rig.pass((stop_at - begin) as u32);
        rig.ask_for_stop(self.scene);
        rig.pass(noise_ms);
        for way in [Way::Out, Way::Back] {
            rig.wire(way).way = FaultyWay::perfect();
        }
        if self.is_stopped(&rig) { Some(0) } else { self.time_until_stopped(&mut rig, bound_ms) }
    }

    fn time_until_stopped(&self, rig: &mut Rig, bound_ms: u32) -> Option<u32> {
        (1..=bound_ms).find(|_| {
            rig.step();
            self.is_stopped(rig)
        })
    }

    fn is_stopped(&self, rig: &Rig) -> bool {
        match self.scene {
            Scene::GripCycle => rig.far.gripper.state().flags.contains(SystemFlags::FAST_STOP),
            Scene::Jog | Scene::Silence => !rig.is_moving(),
        }
    }
}

/// How long the gripper took to stop, over many cases.
#[derive(Clone, Debug, Default)]
pub struct Times {
    /// How many cases took so many milliseconds; the last place counts those that took longer than its bound.
    counts: Vec<u64>,
    /// The worst case, and how many milliseconds it took.
    worst: Option<(u32, Case)>,
}

impl Times {
    /// Runs a case and takes down how long it took.
    pub fn take(&mut self, course: &Course, case: Case, bound_ms: u32) {
        let ms = course.stop(&case, bound_ms);
        self.note(ms, bound_ms, || case);
    }

    /// Takes down how long a case took.
    pub fn note(&mut self, ms: Option<u32>, bound_ms: u32, case: impl FnOnce() -> Case) {
        let ms = ms.unwrap_or(bound_ms + 1);
        let place = ms as usize;
        if self.counts.len() <= place {
            self.counts.resize(place + 1, 0);
        }
        self.counts[place] += 1;
        if self.worst.as_ref().is_none_or(|(worst, _)| ms > *worst) {
            self.worst = Some((ms, case()));
        }
    }

    /// How many cases were run.
    #[must_use]
    pub fn cases(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The time that half of the cases did not exceed, in milliseconds.
    #[must_use]
    pub fn median_ms(&self) -> u32 {
        let half = self.cases().div_ceil(2);
        let mut seen = 0;
        let place = self.counts.iter().position(|count| {
            seen += count;
            seen >= half
        });
        place.unwrap_or(0) as u32
    }

    /// The worst case, and how many milliseconds it took; more than its bound where the gripper did not stop.
    #[must_use]
    pub const fn worst(&self) -> Option<&(u32, Case)> {
        self.worst.as_ref()
    }
}

/// A set of cases, and how long the gripper may take in each.
#[derive(Clone, Copy, Debug)]
pub struct Sweep {
    /// What the cases have in common.
    pub name: &'static str,
    /// The longest time that is allowed, in milliseconds.
    pub limit_ms: u32,
    /// Every so many milliseconds of the course, of bytes, and of random cases is tried: 1 for all of them.
    pub stride: usize,
    /// Each byte is changed to any other, or has any other added, in place of a few that matter.
    pub every_fault: bool,
    run: fn(&Sweep) -> Times,
}

impl Sweep {
    /// Every set of cases, with this stride.
    #[must_use]
    pub fn all(stride: usize, every_fault: bool) -> [Self; 6] {
        let sweep = |name, limit_ms, run| Self { name, limit_ms, stride, every_fault, run };
        [
            sweep(
                "any one byte is lost, changed, doubled or added, at any time of a grip cycle",
                250,
                |sweep: &Sweep| sweep.one_fault(Scene::GripCycle),
            ),
            sweep("the same, up to two seconds before", 250, Sweep::one_old_fault),
            sweep(
                "the same, for the end of a jog over Modbus until the fingers stand",
                250,
                |sweep: &Sweep| sweep.one_fault(Scene::Jog),
            ),
            sweep(
                "the same, for a jog whose master falls silent, BUS_TIMEOUT of 1 s included",
                1_270,
                |sweep: &Sweep| sweep.one_fault(Scene::Silence),
            ),
            sweep("any two bytes are", 1_500, Sweep::two_faults),
            sweep("noise, however strong: counted from its end", 1_000, Sweep::noise),
        ]
    }

    /// Runs the cases.
    #[must_use]
    pub fn run(&self) -> Times {
        (self.run)(self)
    }

    fn faults(&self) -> Vec<Fault> {
        if self.every_fault { every_fault() } else { usual_faults() }
    }

    /// Bytes from a while before the request to the end of the first answers to it.
    fn one_fault(&self, scene: Scene) -> Times {
        const BEFORE: usize = 40;
        // The answer to a silence comes a second later.
        let behind = if scene == Scene::Silence { 160 } else { 60 };
        let mut times = Times::default();
        for frame_timeout_ms in FRAME_TIMEOUTS_MS {
            let course = Course::play(scene, frame_timeout_ms);
            // A second takes its time.
            let stride = if scene == Scene::Silence { self.stride * 10 } else { self.stride };
            for stop_at in (0..course.duration_ms()).step_by(stride) {
                for way in [Way::Out, Way::Back] {
                    let next = course.bytes_until(way, stop_at);
                    for byte in next.saturating_sub(BEFORE)..next + behind {
                        for fault in self.faults() {
                            let case = Case { stop_at, damage: vec![(way, byte, fault)] };
                            times.take(&course, case, self.limit_ms);
                        }
                    }
                }
            }
        }
        times
    }

    /// A gripper that has been deaf for up to two seconds.
    fn one_old_fault(&self) -> Times {
        let mut times = Times::default();
        for frame_timeout_ms in FRAME_TIMEOUTS_MS {
            let course = Course::play(Scene::GripCycle, frame_timeout_ms);
            let end = course.duration_ms();
            for way in [Way::Out, Way::Back] {
                for byte in (0..course.bytes_until(way, end)).step_by(self.stride) {
                    for fault in self.faults() {
                        for late in [0, 50, 100, 200, 300, 500, 700, 1_000, 2_000] {
                            let case = Case { stop_at: end + late, damage: vec![(way, byte, fault)] };
                            times.take(&course, case, self.limit_ms);
                        }
                    }
                }
            }
        }
        times
    }

    /// By chance: one before or behind the request, and one up to the end of the first burst.
    fn two_faults(&self) -> Times {
        const CASES: usize = 200_000;
        let mut times = Times::default();
        for frame_timeout_ms in FRAME_TIMEOUTS_MS {
            let course = Course::play(Scene::GripCycle, frame_timeout_ms);
            let mut chance = Chance::new(frame_timeout_ms.into());
            let faults = self.faults();
            for _ in 0..CASES / self.stride {
                let stop_at = chance.below(course.duration_ms() as u64) as usize;
                let mut damage = |before: u64, behind: u64| {
                    let way = if chance.below(4) == 0 { Way::Back } else { Way::Out };
                    let from = course.bytes_until(way, stop_at).saturating_sub(before as usize);
                    let byte = from + chance.below(before + behind) as usize;
                    // Half of them as in the high byte of a length, which makes a gripper wait for hundreds of bytes.
                    let fault = match chance.below(2) {
                        0 => Fault::Flip(1 + chance.below(3) as u8),
                        _ => faults[chance.below(faults.len() as u64) as usize],
                    };
                    (way, byte, fault)
                };
                let damage = vec![damage(30, 30), damage(10, 1_100)];
                times.take(&course, Case { stop_at, damage }, self.limit_ms);
            }
        }
        times
    }

    /// Noise of three strengths.
    fn noise(&self) -> Times {
        const CASES: usize = 60_000;
        let mut times = Times::default();
        for frame_timeout_ms in FRAME_TIMEOUTS_MS {
            let course = Course::play(Scene::GripCycle, frame_timeout_ms);
            let mut chance = Chance::new(frame_timeout_ms.into());
            for number in 0..CASES / self.stride {
                let stop_at = chance.below(course.duration_ms() as u64) as usize;
                let noise_ms = 1 + chance.below(400) as u32;
                let rate = [0.5, 0.1, 0.02][number % 3];
                let ms = course.stop_in_noise(stop_at, noise_ms, rate, number as u64, self.limit_ms);
                times.note(ms, self.limit_ms, || Case { stop_at, damage: vec![] });
            }
        }
        times
    }
}

/// Grippers that give up half a frame after half a second, and practically never: the manual does not say when.
const FRAME_TIMEOUTS_MS: [u16; 2] = [500, 60_000];
