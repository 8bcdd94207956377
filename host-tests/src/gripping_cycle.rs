//! The gripping cycle of the fieldbus manual's demo program (appendix D) as a PLC scan: input image in, output image
//! out. It has no bus and no clock.
//!
//! As in the manual, an error clears all command flags, acknowledges, homes and restarts. Differences:
//! - the cycle homes first, and treats FAST STOP as an error regardless of GSTATE
//! - each command flag, including STOP/ACK, is 0 for a scan before it rises; otherwise a second error would raise no
//!   edge
//! - a motion may complete before the next scan
//! - every wait is bounded

use wsg_fieldbus::{CommandFlags, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};

/// Holding time of a part, in milliseconds.
const HOLDING_TIME_MS: u64 = 1_000;
/// Time limit for everything else, in milliseconds: more than any stroke needs.
const PATIENCE_MS: u64 = 30_000;
/// Time after its edge in which a motion may start and complete unseen, in milliseconds.
const BEGIN_MS: u64 = 300;
/// Number of consecutive errors after which the cycle gives up.
const MAX_ERRORS_IN_A_ROW: u32 = 3;

/// A motion of the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// Homing.
    Home,
    /// Move to the width before a grip.
    PrePosition,
    /// Grip.
    Grip,
    /// Release.
    Release,
    /// Move to the width between two cycles.
    Start,
}

impl Motion {
    const fn flag(self) -> CommandFlags {
        match self {
            Self::Home => CommandFlags::HOMING,
            Self::PrePosition | Self::Start => CommandFlags::MOVE,
            Self::Grip => CommandFlags::GRIP,
            Self::Release => CommandFlags::RELEASE,
        }
    }

    /// Returns GSTATE during the motion.
    const fn running(self) -> GripperFlags {
        match self {
            Self::Home | Self::PrePosition | Self::Start => GripperFlags::POSITIONING,
            Self::Grip => GripperFlags::GRIPPING,
            Self::Release => GripperFlags::RELEASING,
        }
    }

    /// Returns WIDTH, SPEED and FORCELIMIT as registers; HOMING has none.
    const fn parameters(self) -> Option<(i16, u16, i16)> {
        match self {
            Self::Home => None,
            Self::PrePosition | Self::Release => Some((30_00, 400_00, 80_00)),
            Self::Grip => Some((22_00, 400_00, 50_00)),
            Self::Start => Some((60_00, 400_00, 80_00)),
        }
    }
}

/// Results since the start of the cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Completed cycles.
    pub cycles: u32,
    /// Parts held for the holding time.
    pub held: u32,
    /// Grips without a part.
    pub not_found: u32,
    /// Parts lost while they were held.
    pub lost: u32,
    /// Successful homings.
    pub homings: u32,
    /// Errors.
    pub errors: u32,
}

/// State of the cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Nothing has been written.
    Off,
    /// All command flags are 0, because the first write raises no edge.
    Clear,
    /// STOP/ACK is set.
    Acknowledge,
    /// The flag of a motion is set.
    Begin(Motion),
    /// The motion is running and its flag is 0.
    Run(Motion),
    /// The part is held.
    Hold,
    /// All cycles are complete.
    Finished,
    /// Stopped after too many consecutive errors.
    GivenUp,
}

/// The gripping cycle, scanned once in each cycle of the PLC.
#[derive(Debug)]
pub struct Cycle {
    output: OutputImage,
    phase: Phase,
    since_ms: u64,
    wanted: u32,
    errors_in_a_row: u32,
    counters: Counters,
    last_error: Option<String>,
}

impl Cycle {
    /// Creates a cycle that repeats this many times.
    pub const fn new(wanted: u32) -> Self {
        Self {
            output: OutputImage::ZERO,
            phase: Phase::Off,
            since_ms: 0,
            wanted,
            errors_in_a_row: 0,
            counters: Counters { cycles: 0, held: 0, not_found: 0, lost: 0, homings: 0, errors: 0 },
            last_error: None,
        }
    }

    /// Returns the current phase.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Returns the results so far.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Returns the last error.
    pub fn last_error(&self) -> Option<&str> {
        self.last_error.as_deref()
    }

    /// Performs one scan: processes the input image and returns the output image.
    pub fn scan(&mut self, now_ms: u64, input: &InputImage) -> OutputImage {
        let lasted_ms = now_ms.saturating_sub(self.since_ms);
        let next = match self.next(lasted_ms, input) {
            Ok(next) => next,
            Err(error) => Some(self.recover(error)),
        };
        if let Some(phase) = next {
            self.enter(phase, now_ms);
        }
        self.output
    }

    /// Returns the next phase, `None` to stay, or an error.
    fn next(&mut self, lasted_ms: u64, input: &InputImage) -> Result<Option<Phase>, String> {
        let is_fast_stopped = input.system.contains(SystemFlags::FAST_STOP);
        match self.phase {
            Phase::Finished | Phase::GivenUp => return Ok(None),
            Phase::Off => return Ok(Some(Phase::Clear)),
            Phase::Clear => return Ok(Some(Phase::Acknowledge)),
            Phase::Acknowledge if input.state == GripperFlags::IDLE && !is_fast_stopped => {
                return Ok(Some(Phase::Begin(Motion::Home)));
            }
            Phase::Acknowledge => {}
            Phase::Begin(_) | Phase::Run(_) | Phase::Hold if is_fast_stopped => {
                return Err("FAST STOP".to_owned());
            }
            Phase::Begin(_) | Phase::Run(_) | Phase::Hold if input.state == GripperFlags::ERROR => {
                return Err(format!("ERROR with {}", input.status));
            }
            Phase::Begin(motion) => {
                let began = input.state == motion.running() || input.status == Status::CmdPending;
                if began || lasted_ms >= BEGIN_MS {
                    return Ok(Some(Phase::Run(motion)));
                }
            }
            Phase::Run(motion) => {
                if input.state != motion.running() && input.status != Status::CmdPending {
                    return self.follow(motion, input).map(Some);
                }
            }
            Phase::Hold => match input.state {
                GripperFlags::HOLDING if lasted_ms < HOLDING_TIME_MS => {}
                GripperFlags::HOLDING => {
                    self.counters.held += 1;
                    return Ok(Some(Phase::Begin(Motion::Release)));
                }
                GripperFlags::PART_LOST => {
                    self.counters.lost += 1;
                    return Ok(Some(Phase::Begin(Motion::Release)));
                }
                state => return Err(format!("{state:?} instead of HOLDING")),
            },
        }
        if lasted_ms < PATIENCE_MS { Ok(None) } else { Err(format!("{:?} took too long", self.phase)) }
    }

    /// Returns the phase after a completed motion.
    fn follow(&mut self, motion: Motion, input: &InputImage) -> Result<Phase, String> {
        let next = match (motion, input.state, input.status) {
            (Motion::Home, GripperFlags::IDLE, Status::Success) => {
                if !input.system.contains(SystemFlags::REFERENCED) {
                    return Err("not REFERENCED after homing".to_owned());
                }
                self.counters.homings += 1;
                Phase::Begin(Motion::PrePosition)
            }
            (Motion::PrePosition, GripperFlags::IDLE, Status::Success) => Phase::Begin(Motion::Grip),
            (Motion::Grip, GripperFlags::HOLDING, _) => Phase::Hold,
            (Motion::Grip, GripperFlags::NO_PART, _) => {
                self.counters.not_found += 1;
                Phase::Begin(Motion::Release)
            }
            (Motion::Grip, GripperFlags::PART_LOST, _) => {
                self.counters.lost += 1;
                Phase::Begin(Motion::Release)
            }
            (Motion::Release, GripperFlags::IDLE, Status::Success) => Phase::Begin(Motion::Start),
            (Motion::Start, GripperFlags::IDLE, Status::Success) => {
                self.counters.cycles += 1;
                self.errors_in_a_row = 0;
                if self.counters.cycles < self.wanted {
                    Phase::Begin(Motion::PrePosition)
                } else {
                    Phase::Finished
                }
            }
            (motion, state, status) => return Err(format!("{motion:?} ended in {state:?} with {status}")),
        };
        Ok(next)
    }

    fn recover(&mut self, error: String) -> Phase {
        self.counters.errors += 1;
        self.errors_in_a_row += 1;
        self.last_error = Some(error);
        if self.errors_in_a_row < MAX_ERRORS_IN_A_ROW { Phase::Clear } else { Phase::GivenUp }
    }

    fn enter(&mut self, phase: Phase, now_ms: u64) {
        self.output.flags = match phase {
            Phase::Acknowledge => CommandFlags::STOP_ACK,
            Phase::Begin(motion) => motion.flag(),
            _ => CommandFlags::empty(),
        };
        if let Phase::Begin(motion) = phase
            && let Some((width, speed, force_limit)) = motion.parameters()
        {
            self.output = OutputImage { width, speed, force_limit, ..self.output };
        }
        (self.phase, self.since_ms) = (phase, now_ms);
    }
}
