//! Stopping time under line faults: every single-bit or single-byte fault, at every position of a grip cycle or a
//! jog, in both directions. FAST STOP is requested at every millisecond around it. The same faults must not keep GSTATE
//! from following a third party.
//!
//! Bridge library and virtual gripper run in virtual time on a line of 115 200 bit/s per direction. A case resumes
//! from a snapshot of the undisturbed cycle, so hundreds of thousands take seconds.

use wsg_bridge_fw::gripper::TO_SEND_MAX;
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_bridge_fw::{Config, ResetCause};
use wsg_fieldbus::{CommandFlags, GripperFlags, OutputImage};
use wsg_protocol::{CommandId, Status, SystemFlags};
use wsg_sim::{Part, PortKind};

use crate::chance::Chance;
use crate::faulty_link::{Fault, FaultyWay, Rates};
use crate::flash_model::FlashModel;
use crate::operation::{GripperEvent, Operation, image};
use crate::serial_gripper::{Carry, SerialGripper};
use crate::world::World;

/// Capacity of the line per millisecond, in hundredths of a byte (10 bits per byte).
const HUNDREDTHS_PER_MS: u32 = 1_152;

/// Returns the faults of a byte. With `every`: any other value, loss, duplication, and insertion of any byte before it.
/// Without it, the most relevant: single-bit flips, loss, duplication, and inserted bytes that resemble a preamble, an idle
/// line or a broken line.
fn faults(every: bool) -> Vec<Fault> {
    let [flips, inserted]: [Vec<u8>; 2] = if every {
        [(1..=u8::MAX).collect(), (0..=u8::MAX).collect()]
    } else {
        [(0..8).map(|bit| 1 << bit).collect(), vec![0x00, 0xAA, 0xFF]]
    };
    let flipped = flips.into_iter().map(Fault::Flip);
    flipped.chain([Fault::Drop, Fault::Duplicate]).chain(inserted.into_iter().map(Fault::Insert)).collect()
}

/// Direction of a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// From bridge to gripper.
    Out,
    /// From gripper to bridge.
    Back,
}

/// One direction of the line.
#[derive(Clone, Debug)]
struct Wire {
    /// Transmission credit, in hundredths of a byte.
    budget: u32,
    way: FaultyWay,
}

/// A damaged byte of a case: direction, index from the beginning of the course, and fault.
pub type Damage = (Way, usize, Fault);

/// Time of the stop request and the damaged bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Case {
    /// Time of the stop request, in milliseconds from the beginning of the course.
    pub stop_at: usize,
    /// Damaged bytes, before or after the request.
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
        // Idle time does not accumulate credit.
        self.budget = if waiting.len() > count { budget % 100 } else { 0 };
        self.way.carry(&mut waiting.drain(..count).collect())
    }
}

/// Bridge, line and gripper, wires and a Modbus bus.
type Rig = World<Wire>;

impl Rig {
    /// Issues a motion command and waits until it completes.
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
            assert!(self.now_ms() < 60_000, "{wire:?} does not complete");
            if self.outputs().contains(Outputs::READY) {
                return;
            }
        }
    }

    /// Creates a rig that is referenced and READY.
    fn homed(time_scale: f32, frame_timeout_ms: u16) -> Self {
        let config = wsg_sim::Config {
            part: Part::of_width(20.0),
            time_scale,
            frame_timeout_ms,
            ..wsg_sim::Config::default()
        };
        let far = SerialGripper::over(config, PortKind::Serial, TO_SEND_MAX, [Wire::new(), Wire::new()]);
        let mut rig = Self::with(Config::DEFAULT, far, FlashModel::new(), ResetCause::PowerOn);
        rig.set(Inputs::FAST_STOP_OK, true);
        rig.pass(200);
        assert!(rig.until(1_000, |outputs| outputs.contains(Outputs::READY)), "{:?}", rig.outputs());
        rig.course_of(Inputs::HOME, &mut |_| {});
        rig.take_sent();
        rig
    }

    fn way(&mut self, way: Way) -> &mut FaultyWay {
        match way {
            Way::Out => &mut self.far.to_gripper.way,
            Way::Back => &mut self.far.to_bridge.way,
        }
    }

    /// Returns the number of bytes carried in this direction.
    fn count(&self, way: Way) -> usize {
        let wire = if way == Way::Out { &self.far.to_gripper } else { &self.far.to_bridge };
        wire.way.counts().bytes as usize
    }

    fn is_moving(&self) -> bool {
        self.far.gripper.state().flags.contains(SystemFlags::MOVING)
    }
}

/// The motion to stop, and the criterion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scene {
    /// Grip and release, ended by FAST_STOP_OK; measured until the gripper reports FAST STOP.
    GripCycle,
    /// A jog over Modbus, ended by its flag; measured until the fingers stop.
    Jog,
    /// A jog over Modbus whose master stops sending; measured until the fingers stop.
    Silence,
    /// A MOVE over Modbus, stopped by a third party; measured until GSTATE shows its end.
    ThirdPartyStop,
    /// The same, followed by a motion of the third party; measured until GSTATE shows it.
    ThirdPartyMotion,
}

impl Scene {
    /// Returns the request for the stop.
    const fn request(self) -> Operation {
        match self {
            Self::GripCycle => Operation::Toggle(Inputs::FAST_STOP_OK),
            Self::Jog => Operation::Write(with(CommandFlags::empty())),
            Self::Silence => Operation::FallSilent,
            Self::ThirdPartyStop => Operation::Gripper(GripperEvent::ThirdPartyStops),
            Self::ThirdPartyMotion => {
                Operation::Gripper(GripperEvent::ThirdPartyBegins(CommandId::PrePosition))
            }
        }
    }
}

/// Returns an image with these flags, 40 mm, 50 mm/s and 40 N.
const fn with(flags: CommandFlags) -> OutputImage {
    image(flags, [40_00, 50_00, 40_00])
}

/// The undisturbed course of a scene, as one snapshot per millisecond.
#[derive(Debug)]
struct Course {
    scene: Scene,
    snapshots: Vec<Rig>,
}

impl Course {
    /// Plays a scene against a gripper that discards an incomplete frame after `frame_timeout_ms`.
    fn play(scene: Scene, frame_timeout_ms: u16) -> Self {
        let mut snapshots = vec![];
        let mut keep = |rig: &Rig| snapshots.push(rig.clone());
        // At the original speed the stroke takes 1.8 s, after which a jog would end without a stop.
        let time_scale = if scene == Scene::GripCycle { 10.0 } else { 1.0 };
        let mut rig = Rig::homed(time_scale, frame_timeout_ms);
        let jogs = matches!(scene, Scene::Jog | Scene::Silence);
        if jogs {
            rig.course_of(Inputs::MOVE, &mut |_| {});
        }
        if scene != Scene::GripCycle {
            let flags = if jogs { CommandFlags::JOG_PLUS } else { CommandFlags::MOVE };
            let [before, after] = [CommandFlags::empty(), flags].map(|flags| Operation::Write(with(flags)));
            rig.play(&[before, Operation::Pass(100), after]);
        }
        if matches!(scene, Scene::ThirdPartyStop | Scene::ThirdPartyMotion) {
            rig.pass(50);
            assert!(rig.is_moving(), "the PLC's motion runs");
        }
        if scene == Scene::ThirdPartyMotion {
            rig.play(&[Operation::Gripper(GripperEvent::ThirdPartyStops), Operation::Pass(100)]);
        }
        keep(&rig);
        if scene == Scene::GripCycle {
            rig.course_of(Inputs::GRIP, &mut keep);
            rig.course_of(Inputs::RELEASE, &mut keep);
        } else {
            for _ in 0..100 {
                rig.step();
                keep(&rig);
            }
        }
        assert!(!jogs || rig.is_moving(), "the jog runs");
        Self { scene, snapshots }
    }

    /// Returns the course's duration in milliseconds.
    const fn duration_ms(&self) -> usize {
        self.snapshots.len()
    }

    /// Returns the number of bytes carried in this direction before a stop request at `stop_at` milliseconds.
    fn bytes_until(&self, way: Way, stop_at: usize) -> usize {
        let count =
            |at: usize| self.snapshots.get(at).or(self.snapshots.last()).map_or(0, |rig| rig.count(way));
        count(stop_at) - count(0)
    }

    /// Returns the time from the stop request to the gripper's stop, in milliseconds; `None` if it exceeds
    /// `bound_ms`.
    fn stop(&self, case: &Case, bound_ms: u32) -> Option<u32> {
        let first = self.snapshots.first()?;
        // Resumes at the last snapshot before any damaged byte is sent.
        let is_before = |at: usize| {
            let left = |(way, byte, _): &Damage| self.bytes_until(*way, at) > *byte;
            !case.damage.iter().any(left)
        };
        let last = case.stop_at.min(self.snapshots.len() - 1);
        let begin = (0..=last).rev().find(|at| is_before(*at)).unwrap_or(0);
        let mut rig = self.snapshots.get(begin)?.clone();
        for (way, byte, fault) in &case.damage {
            let at = first.count(*way) + byte;
            rig.way(*way).hit(at as u64, *fault);
        }
        // After the end of the course, time continues without commands.
        rig.pass((case.stop_at - begin) as u32);
        rig.play(&[self.scene.request()]);
        self.time_until_stopped(&mut rig, bound_ms)
    }

    /// Does the same as [`stop`](Self::stop), with noise in both directions from `noise_ms` before to `noise_ms`
    /// after the request. `rate` is the fraction of damaged bytes. The result counts from the end of the noise.
    fn stop_in_noise(
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
            *rig.way(way) = FaultyWay::new(Rates::of_bytes(rate), seed);
        }
        rig.pass((stop_at - begin) as u32);
        rig.play(&[self.scene.request()]);
        rig.pass(noise_ms);
        for way in [Way::Out, Way::Back] {
            *rig.way(way) = FaultyWay::perfect();
        }
        if self.is_stopped(&mut rig) { Some(0) } else { self.time_until_stopped(&mut rig, bound_ms) }
    }

    fn time_until_stopped(&self, rig: &mut Rig, bound_ms: u32) -> Option<u32> {
        (1..=bound_ms).find(|_| {
            rig.step();
            self.is_stopped(rig)
        })
    }

    fn is_stopped(&self, rig: &mut Rig) -> bool {
        match self.scene {
            Scene::GripCycle => rig.far.gripper.state().flags.contains(SystemFlags::FAST_STOP),
            Scene::Jog | Scene::Silence => !rig.is_moving(),
            Scene::ThirdPartyStop => {
                let image = rig.bridge().input_image();
                // ERROR if the motion's result was lost.
                image.state == GripperFlags::IDLE || image.status == Status::Timeout
            }
            Scene::ThirdPartyMotion => rig.bridge().input_image().state == GripperFlags::POSITIONING,
        }
    }
}

/// Distribution of stopping times.
#[derive(Clone, Debug, Default)]
pub struct Times {
    /// Number of cases per stopping time in milliseconds; the last entry counts cases beyond their bound.
    counts: Vec<u64>,
    /// The worst case with its stopping time in milliseconds.
    worst: Option<(u32, Case)>,
}

impl Times {
    /// Runs a case and records its stopping time.
    fn take(&mut self, course: &Course, case: Case, bound_ms: u32) {
        let ms = course.stop(&case, bound_ms);
        self.note(ms, bound_ms, || case);
    }

    /// Records the stopping time of a case.
    fn note(&mut self, ms: Option<u32>, bound_ms: u32, case: impl FnOnce() -> Case) {
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

    /// Returns the number of cases.
    #[must_use]
    pub fn cases(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Returns the median stopping time in milliseconds.
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

    /// Returns the worst case and its stopping time in milliseconds (above the bound without a stop).
    #[must_use]
    pub const fn worst(&self) -> Option<&(u32, Case)> {
        self.worst.as_ref()
    }
}

/// The damaged bytes of a set of cases.
#[derive(Clone, Copy, Debug)]
enum Faults {
    /// One byte from shortly before the request to the end of the first answers.
    One(Scene),
    /// One byte up to two seconds before the request, which may leave the gripper in a truncated frame.
    OneOld,
    /// Two random bytes: one before or after the request, and one up to the end of the first burst.
    Two,
    /// Noise of three intensities.
    Noise,
}

/// A set of cases and their permitted stopping time.
#[derive(Clone, Copy, Debug)]
pub struct Sweep {
    /// Description of the cases.
    pub name: &'static str,
    /// Longest permitted stopping time in milliseconds.
    pub limit_ms: u32,
    /// Step between tested milliseconds, bytes and random cases; 1 tests all of them.
    pub stride: usize,
    /// Whether to try all values of damaged and inserted bytes, instead of a relevant few.
    pub every_fault: bool,
    faults: Faults,
}

impl Sweep {
    /// Returns all sets of cases with this stride.
    #[must_use]
    pub fn all(stride: usize, every_fault: bool) -> [Self; 6] {
        [
            (
                "one byte lost, changed, duplicated or inserted, at any time of a grip cycle",
                250,
                Faults::One(Scene::GripCycle),
            ),
            ("one byte damaged as above, up to 2 s before the FAST STOP request", 250, Faults::OneOld),
            (
                "one damaged byte, from clearing the flag of a jog over Modbus until the fingers stop",
                250,
                Faults::One(Scene::Jog),
            ),
            (
                "one damaged byte, from the last request of a jog's master until the fingers stop; contains BUS_TIMEOUT (1 s)",
                1_270,
                Faults::One(Scene::Silence),
            ),
            ("any two bytes damaged", 1_500, Faults::Two),
            ("noise that damages up to half of all bytes, measured from its end", 1_000, Faults::Noise),
        ]
        .map(|(name, limit_ms, faults)| Self { name, limit_ms, stride, every_fault, faults })
    }

    /// Returns the cases in which a third party commands the gripper, with this stride. The first limit includes the
    /// time-out of a result after standstill.
    #[must_use]
    pub fn of_third_parties(stride: usize) -> [Self; 2] {
        [
            (
                "one byte, while a third party stops a motion of the PLC, until GSTATE shows its end",
                1_250,
                Faults::One(Scene::ThirdPartyStop),
            ),
            (
                "one byte, while a third party starts a motion after that, until GSTATE shows it",
                250,
                Faults::One(Scene::ThirdPartyMotion),
            ),
        ]
        .map(|(name, limit_ms, faults)| Self { name, limit_ms, stride, every_fault: false, faults })
    }

    /// Runs the cases.
    #[must_use]
    pub fn run(&self) -> Times {
        let mut times = Times::default();
        for frame_timeout_ms in FRAME_TIMEOUTS_MS {
            let scene = if let Faults::One(scene) = self.faults { scene } else { Scene::GripCycle };
            let course = Course::play(scene, frame_timeout_ms);
            let chance = Chance::new(frame_timeout_ms.into());
            match self.faults {
                Faults::One(_) => self.one(&course, &mut times),
                Faults::OneOld => self.one_old(&course, &mut times),
                Faults::Two => self.two(&course, chance, &mut times),
                Faults::Noise => self.noise(&course, chance, &mut times),
            }
        }
        times
    }

    /// Damages this byte in every way.
    fn damage(&self, course: &Course, stop_at: usize, way: Way, byte: usize, times: &mut Times) {
        for fault in faults(self.every_fault) {
            times.take(course, Case { stop_at, damage: vec![(way, byte, fault)] }, self.limit_ms);
        }
    }

    fn one(&self, course: &Course, times: &mut Times) {
        const BEFORE: usize = 40;
        // The bus time-out adds a second before the answers, which is expensive.
        let (after, stride) =
            if course.scene == Scene::Silence { (160, self.stride * 10) } else { (60, self.stride) };
        for stop_at in (0..course.duration_ms()).step_by(stride) {
            for way in [Way::Out, Way::Back] {
                let next = course.bytes_until(way, stop_at);
                for byte in next.saturating_sub(BEFORE)..next + after {
                    self.damage(course, stop_at, way, byte, times);
                }
            }
        }
    }

    fn one_old(&self, course: &Course, times: &mut Times) {
        let end = course.duration_ms();
        for way in [Way::Out, Way::Back] {
            for byte in (0..course.bytes_until(way, end)).step_by(self.stride) {
                for late in [0, 50, 100, 200, 300, 500, 700, 1_000, 2_000] {
                    self.damage(course, end + late, way, byte, times);
                }
            }
        }
    }

    fn two(&self, course: &Course, mut chance: Chance, times: &mut Times) {
        const CASES: usize = 200_000;
        let faults = faults(self.every_fault);
        for _ in 0..CASES / self.stride {
            let stop_at = chance.below(course.duration_ms() as u64) as usize;
            let mut damage = |before: u64, after: u64| {
                let way = if chance.below(4) == 0 { Way::Back } else { Way::Out };
                let from = course.bytes_until(way, stop_at).saturating_sub(before as usize);
                let byte = from + chance.below(before + after) as usize;
                // Half of them change low bits, as in a length's high byte: the gripper then awaits hundreds of
                // bytes.
                let fault = match chance.below(2) {
                    0 => Fault::Flip(1 + chance.below(3) as u8),
                    _ => faults[chance.below(faults.len() as u64) as usize],
                };
                (way, byte, fault)
            };
            let damage = vec![damage(30, 30), damage(10, 1_100)];
            times.take(course, Case { stop_at, damage }, self.limit_ms);
        }
    }

    fn noise(&self, course: &Course, mut chance: Chance, times: &mut Times) {
        const CASES: usize = 60_000;
        for number in 0..CASES / self.stride {
            let stop_at = chance.below(course.duration_ms() as u64) as usize;
            let noise_ms = 1 + chance.below(400) as u32;
            let rate = [0.5, 0.1, 0.02][number % 3];
            let ms = course.stop_in_noise(stop_at, noise_ms, rate, number as u64, self.limit_ms);
            times.note(ms, self.limit_ms, || Case { stop_at, damage: vec![] });
        }
    }
}

/// Grippers that discard an incomplete frame after half a second and practically never; the manual gives no value.
const FRAME_TIMEOUTS_MS: [u16; 2] = [500, 60_000];
