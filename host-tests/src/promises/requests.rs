//! Requests of a PLC: the rules of docs/wiring.md ("Inputs") and docs/registers.md ("Who commands"). Checks that each
//! command from the bridge was requested.
//!
//! - An edge permits one command, with the parameters of its side: the recipe or the image. Earlier requests are
//!   void: there is one motion at a time.
//! - A wire takes effect after it has been stable for the debounce time: command and recipe wires together, STOP_ACK
//!   and FAST_STOP_OK separately, and none before all are stable. However, FAST_STOP_OK takes effect at once when
//!   low, and after at least 5 ms when high.
//! - Initial levels of the wires and the first image of a bus raise no edge. Command wires raise none while READY is
//!   low.
//! - A bus flag is effective from its edge while it is 1 and the bus is active. A motion or jog raises no edge while
//!   a command wire is high, or together with STOP/ACK. A rising command wire cancels it.
//! - Of simultaneous motions, MOVE precedes GRIP, RELEASE and HOMING.
//! - With a recipe for the bus (BUS_RECIPE), an edge uses that recipe's parameters, RELEASE its release width. The
//!   image's parameters are ignored.
//! - While the stored settings are rejected, no motion is sent.
//! - A force limit is sent for its motion, and not after that is void.
//! - STOP/ACK cancels earlier and simultaneous motions, FAST STOP all requests. After a FAST STOP no motion precedes
//!   an acknowledgement, which requires an edge of STOP/ACK. A lost connection voids earlier requests, and so does
//!   READY: a bridge that accepts a command has none left to send.
//! - The silence of a bus withdraws the motion that it requested.

use std::hash::{Hash, Hasher};

use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{RECIPE_COUNT, RECIPES, Recipe};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::{Command, CommandId, Instant, Kind, PrePositionFlags};

use super::{Kept, Promise, keep};
use crate::gripper_states::{LEAST_SPEED, STROKE};

const COMMAND_WIRES: [(Inputs, CommandFlags); 4] = [
    (Inputs::MOVE, CommandFlags::MOVE),
    (Inputs::GRIP, CommandFlags::GRIP),
    (Inputs::RELEASE, CommandFlags::RELEASE),
    (Inputs::HOME, CommandFlags::HOMING),
];

/// Motion flags in order of precedence, and their commands.
pub(crate) const MOTIONS: [(CommandFlags, CommandId); 4] = [
    (CommandFlags::MOVE, CommandId::PrePosition),
    (CommandFlags::GRIP, CommandId::GripPart),
    (CommandFlags::RELEASE, CommandId::ReleasePart),
    (CommandFlags::HOMING, CommandId::Homing),
];

const COMMANDS: CommandFlags =
    CommandFlags::MOVE.union(CommandFlags::GRIP).union(CommandFlags::RELEASE).union(CommandFlags::HOMING);
const JOG: CommandFlags = CommandFlags::JOG_PLUS.union(CommandFlags::JOG_MINUS);

/// Latest time of a command after its edge, in milliseconds.
const LATE_MS: u32 = 1_000;

/// Minimum time until a high FAST_STOP_OK takes effect, in milliseconds.
const LEAST_RELEASE_MS: u32 = 5;

/// A command that may be sent.
#[derive(Clone, Debug, Hash)]
struct Edge {
    id: CommandId,
    at: Instant,
    of_wire: bool,
    /// Width, speed and force limit of a motion, in hundredths.
    parameters: [i32; 3],
}

/// A force limit that may be sent, in hundredths.
#[derive(Clone, Debug, Hash)]
struct ForceLimit {
    force: i32,
    at: Instant,
    of_jog: bool,
}

/// Flags, speed and force limit of a jog.
type Drive = (CommandFlags, u16, i16);

/// Requests and their outcomes so far.
#[derive(Clone, Debug)]
pub(crate) struct Requests {
    now: Instant,
    pub(crate) debounce_ms: u32,
    pub(crate) recipes: [Recipe; RECIPE_COUNT],
    /// Groups of wires that are debounced together.
    groups: [Group; 3],
    /// Effective flags of the wires; `None` before all have settled.
    wires: Option<CommandFlags>,
    /// Last image from the bus; `None` before its first.
    image: Option<OutputImage>,
    /// Effective flags of the bus.
    bus: CommandFlags,
    /// Last effective flags of both sides; `None` before the wires have settled.
    flags: Option<CommandFlags>,
    edges: Vec<Edge>,
    force_limits: Vec<ForceLimit>,
    /// Parameters of a jog, and whether a Pre-position may be sent for it.
    drive: Option<Drive>,
    may_jog: bool,
    /// The promise that a motion without a request breaks. It only names the failure.
    voided_by: Promise,
    /// Whether the bridge shows READY.
    is_ready: bool,
    /// Whether a command wire rose in this turn while READY was low.
    pub(super) is_refused: bool,
    /// Whether a motion wire rose in this turn while READY was high.
    pub(super) has_edge: bool,
    /// Whether in this turn FAST STOP or STOP/ACK was requested, the parameters of a running jog ended or changed, or the bus
    /// that commands became silent.
    pub(super) asks_fast_stop: bool,
    pub(super) asks_stop: bool,
    pub(super) ends_jog: bool,
    pub(super) bus_is_silent: bool,
    /// Whether a Pre-position was sent for a jog and neither answered nor stopped.
    pub(crate) jogs: bool,
    /// Time since which a FAST STOP has been unacknowledged.
    pub(crate) stopped: Option<Instant>,
    /// Whether the stored settings are rejected.
    pub(crate) refuses: bool,
}

impl Hash for Requests {
    /// Ignores what the bridge stores as well: levels, images and settings.
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { edges, force_limits, may_jog, bus, jogs, stopped, .. } = self;
        (edges, force_limits, may_jog, bus, jogs, stopped).hash(state);
    }
}

#[derive(Clone, Copy, Debug)]
struct Group {
    wires: Inputs,
    read: Option<(Inputs, Instant)>,
    counts: Option<Inputs>,
}

impl Requests {
    /// Creates the state without requests, with this debounce time.
    pub(super) fn new(now: Instant, debounce_ms: u32) -> Self {
        let command_group = Inputs::all().difference(Inputs::STOP_ACK | Inputs::FAST_STOP_OK);
        let group = |wires| Group { wires, read: None, counts: None };
        Self {
            now,
            debounce_ms,
            recipes: RECIPES,
            groups: [command_group, Inputs::STOP_ACK, Inputs::FAST_STOP_OK].map(group),
            wires: None,
            image: None,
            bus: CommandFlags::empty(),
            flags: None,
            edges: Vec::new(),
            force_limits: Vec::new(),
            drive: None,
            may_jog: false,
            voided_by: Promise::ResetWithdraws,
            is_ready: false,
            is_refused: false,
            has_edge: false,
            asks_fast_stop: false,
            asks_stop: false,
            ends_jog: false,
            bus_is_silent: false,
            jogs: false,
            stopped: None,
            refuses: false,
        }
    }

    /// Returns whether the wires have settled and neither side asserts STOP/ACK or FAST STOP.
    pub(super) fn is_released(&self) -> bool {
        let held = CommandFlags::STOP_ACK | CommandFlags::FASTSTOP;
        // STOP/ACK in a first image raises no edge, but holds.
        let stop = self.image.unwrap_or_default().flags & CommandFlags::STOP_ACK;
        self.wires.is_some_and(|wires| !(wires | self.bus | stop).intersects(held))
    }

    /// Returns whether either side asserts FAST STOP.
    pub(super) fn holds_fast_stop(&self) -> bool {
        match self.flags {
            Some(flags) => flags.contains(CommandFlags::FASTSTOP),
            // FAST STOP does not wait for the other wires.
            None => self.groups[2].counts == Some(Inputs::empty()),
        }
    }

    /// Processes a reading of the wires.
    pub(super) fn read_wires(&mut self, now: Instant, reading: Inputs) {
        self.now = now;
        (self.is_refused, self.has_edge) = (false, false);
        (self.asks_fast_stop, self.asks_stop, self.ends_jog, self.bus_is_silent) =
            (false, false, false, false);
        self.edges.retain(|edge| now.since(edge.at) < LATE_MS);
        self.force_limits.retain(|limit| now.since(limit.at) < LATE_MS);
        for group in &mut self.groups {
            group.read(now, reading, self.debounce_ms);
        }
        if self.groups[2].counts == Some(Inputs::empty()) && self.wires.is_none() && self.stopped.is_none() {
            // FAST STOP does not wait for the other wires.
            self.fast_stop();
        }
        let [Some(commands), Some(stop), Some(fast_stop)] = self.groups.map(|group| group.counts) else {
            return;
        };
        let mut wires = CommandFlags::empty();
        for (wire, flag) in COMMAND_WIRES {
            wires.set(flag, commands.contains(wire));
        }
        wires.set(CommandFlags::STOP_ACK, !stop.is_empty());
        wires.set(CommandFlags::FASTSTOP, fast_stop.is_empty());
        if wires.intersects(COMMANDS) {
            self.bus -= COMMANDS | JOG;
            self.take(self.wires, true);
        }
        self.wires = Some(wires);
        self.take(self.wires, true);
    }

    /// Processes an image from the bus; its commands use the values of `recipe`, if any.
    pub(crate) fn take_image(&mut self, mut image: OutputImage, recipe: Option<Recipe>) {
        if let Some(recipe) = recipe {
            let OutputImage { flags, width, speed, force_limit, .. } = self.image.unwrap_or_default();
            (image.width, image.speed, image.force_limit) = (width, speed, force_limit);
            // The lowest flag takes precedence. A jog uses the recipe that was selected at its edge.
            if let Some(command) = (image.flags - flags).intersection(COMMANDS | JOG).lowest() {
                let releases = command == CommandFlags::RELEASE;
                image.width = if releases { recipe.release_width } else { recipe.width };
                (image.speed, image.force_limit) = (recipe.speed, recipe.force);
            }
        }
        let Some(before) = self.image.replace(image) else {
            self.bus = image.flags & CommandFlags::FASTSTOP;
            return self.take(self.wires, false);
        };
        let mut rising = image.flags - before.flags;
        let is_masked = self.wires.unwrap_or_default().intersects(COMMANDS) || self.refuses;
        if is_masked || image.flags.contains(CommandFlags::STOP_ACK) {
            rising -= COMMANDS | JOG;
        }
        self.bus = (self.bus & image.flags) | rising;
        self.take(self.wires, false);
    }

    /// Processes the loss of the bus. `commands` is whether the bus requested the last motion, and the bridge must stop it.
    pub(crate) fn lose_bus(&mut self, commands: bool) {
        // Stopping the bus's motion takes precedence in the display.
        self.is_refused = false;
        self.image = None;
        self.bus &= CommandFlags::FASTSTOP;
        if commands {
            self.bus_is_silent = true;
            self.void(Promise::SilenceWithdraws, |edge| !edge.of_wire && edge.id != CommandId::Acknowledge);
        }
        self.take(self.wires, false);
    }

    /// Processes the end of the PLC's connection, with which its jog ends.
    pub(crate) fn end_jog(&mut self) {
        self.bus -= JOG;
        self.take(self.wires, false);
    }

    /// Checks a command that is sent. `command` is `None` while only its id is known; `force_limit` is the gripper's,
    /// in hundredths, if known.
    pub(super) fn send(
        &mut self,
        id: CommandId,
        command: Option<&Command<'_>>,
        force_limit: Option<i32>,
    ) -> Kept {
        match id.kind() {
            Kind::Motion => {
                keep(Promise::NoMotionInFastStop, self.stopped.is_none())?;
                keep(Promise::RefusedSettingsMoveNothing, !self.refuses)?;
                let edges = || self.edges.iter().filter(|edge| edge.id == id);
                let may_jog = self.may_jog && id == CommandId::PrePosition;
                keep(self.voided_by, may_jog || edges().next().is_some())?;
                let edges = || edges().filter(|edge| edge.fits(command));
                let drive = self.drive.filter(|drive| may_jog && fits(*drive, command));
                keep(Promise::MotionHasItsParameters, drive.is_some() || edges().next().is_some())?;
                let is_limited_to = |force: i32| force_limit.is_none_or(|limit| limit == force);
                let has_edge =
                    edges().any(|edge| id != CommandId::GripPart || is_limited_to(edge.parameters[2]));
                let jogs = drive.is_some_and(|(.., force)| is_limited_to(force.into()));
                keep(Promise::GripHasItsForce, has_edge || jogs)?;
                self.jogs = !has_edge;
                self.void_all(Promise::MotionLeavesOnce);
                Ok(())
            }
            Kind::Acknowledge => {
                let edge = self.edges.iter().position(|edge| edge.id == id);
                self.edges.remove(edge.ok_or(Promise::AcknowledgementHasItsEdge)?);
                self.stopped = None;
                Ok(())
            }
            Kind::Stop => {
                self.jogs = false;
                if id == CommandId::FastStop {
                    self.void_all(Promise::FastStopWithdraws);
                    self.stopped = self.stopped.or(Some(self.now));
                }
                Ok(())
            }
            Kind::Query => Ok(()),
            _ => {
                keep(Promise::OnlyForceLimitIsSet, id == CommandId::SetForceLimit)?;
                keep(Promise::NoSettingInFastStop, self.stopped.is_none())?;
                let Some(Command::SetForceLimit { force }) = command else { return Ok(()) };
                let is_wanted = |limit: &ForceLimit| limit.force == hundredths(*force);
                keep(Promise::ForceLimitHasItsMotion, self.force_limits.iter().any(is_wanted))
            }
        }
    }

    /// Processes a missing or lost connection to the gripper.
    pub(super) fn lose_gripper(&mut self) {
        self.void_all(Promise::ReconnectWithdraws);
        self.jogs = false;
    }

    /// Processes the level of READY at the end of a turn.
    pub(super) fn show_ready(&mut self, is_ready: bool) {
        self.is_ready = is_ready;
        if is_ready {
            self.void(Promise::MotionHasItsEdge, |edge| edge.id != CommandId::Acknowledge);
            self.may_jog = false;
        }
    }

    /// Returns the parameters for an edge of this command from a wire or from the bus.
    fn parameters(&self, id: CommandId, of_wire: bool) -> [i32; 3] {
        if !of_wire {
            let image = self.image.unwrap_or_default();
            return [image.width.into(), image.speed.into(), image.force_limit.into()];
        }
        let levels = self.groups[0].counts.unwrap_or(Inputs::empty());
        let bit = |wire| usize::from(levels.contains(wire));
        let recipe = self.recipes[bit(Inputs::RECIPE0) + 2 * bit(Inputs::RECIPE1)];
        let width = if id == CommandId::ReleasePart { recipe.release_width } else { recipe.width };
        [width.into(), recipe.speed.into(), recipe.force.into()]
    }

    /// Updates the flags of both sides after a change of the wires or of the bus.
    fn take(&mut self, wires: Option<CommandFlags>, of_wire: bool) {
        let Some(flags) = wires.map(|wires| wires | self.bus) else { return };
        let before = self.flags.replace(flags);
        let rising = before.map_or(CommandFlags::empty(), |before| flags - before);
        if flags.intersects(CommandFlags::STOP_ACK | CommandFlags::FASTSTOP) {
            self.bus -= JOG;
        }
        if flags.contains(CommandFlags::FASTSTOP) {
            let is_first = before.is_none() && self.stopped.is_none();
            if is_first || rising.contains(CommandFlags::FASTSTOP) {
                self.fast_stop();
            }
        } else if rising.contains(CommandFlags::STOP_ACK) {
            (self.is_refused, self.asks_stop) = (false, true);
            self.void(Promise::StopAckWithdraws, |edge| edge.id != CommandId::Acknowledge);
            self.may_jog = false;
            self.push(CommandId::Acknowledge, of_wire, [0; 3]);
        } else if !flags.contains(CommandFlags::STOP_ACK)
            && let Some((_, id)) = MOTIONS.iter().find(|(flag, _)| rising.contains(*flag))
        {
            self.is_refused = of_wire && !self.is_ready;
            self.has_edge |= of_wire && self.is_ready;
            if self.is_refused {
                self.voided_by = Promise::EdgeWhileNotReadyStartsNothing;
            } else {
                let parameters = self.parameters(*id, of_wire);
                self.force_limits.push(ForceLimit { force: parameters[2], at: self.now, of_jog: false });
                self.push(*id, of_wire, parameters);
            }
        }
        self.follow_jog(flags & (self.bus | !JOG), before.is_none());
    }

    /// A jog depends on its flags, SPEED and FORCELIMIT; a change requests another command.
    fn follow_jog(&mut self, flags: CommandFlags, is_first: bool) {
        let stops = flags.intersects(CommandFlags::STOP_ACK | CommandFlags::FASTSTOP);
        let image = self.image.filter(|_| flags.intersects(JOG) && !stops);
        let drive = image.map(|image| (flags & JOG, image.speed, image.force_limit));
        if drive != self.drive {
            self.ends_jog |= self.jogs;
            self.force_limits.retain(|limit| !limit.of_jog);
            self.force_limits.extend(drive.map(|(.., force)| ForceLimit {
                force: force.into(),
                at: self.now,
                of_jog: true,
            }));
            self.drive = drive;
            self.may_jog = drive.is_some() && !is_first;
        }
    }

    fn push(&mut self, id: CommandId, of_wire: bool, parameters: [i32; 3]) {
        self.edges.push(Edge { id, at: self.now, of_wire, parameters });
    }

    fn fast_stop(&mut self) {
        self.void_all(Promise::FastStopWithdraws);
        self.asks_fast_stop = true;
        self.stopped = self.stopped.or(Some(self.now));
    }

    fn void_all(&mut self, by: Promise) {
        self.void(by, |_| true);
        self.may_jog = false;
    }

    /// Withdraws requests, and the force limits of all.
    fn void(&mut self, by: Promise, is_void: impl Fn(&Edge) -> bool) {
        if self.may_jog || self.edges.iter().any(&is_void) {
            self.voided_by = by;
        }
        self.edges.retain(|edge| !is_void(edge));
        self.force_limits.clear();
    }
}

impl Edge {
    /// Returns whether the command goes by these parameters, as far as it is known.
    fn fits(&self, command: Option<&Command<'_>>) -> bool {
        let [width, speed, _] = self.parameters;
        let goes_by = |w: f32, s: f32| (hundredths(w), hundredths(s)) == (width, speed);
        match command {
            None => true,
            Some(Command::PrePosition { flags, width, speed }) => {
                *flags == PrePositionFlags::STOP_ON_BLOCK && goes_by(*width, *speed)
            }
            Some(Command::GripPart { width, speed } | Command::ReleasePart { width, speed }) => {
                goes_by(*width, *speed)
            }
            Some(other) => other.id() == CommandId::Homing,
        }
    }
}

/// Returns whether the command is a jog with these parameters, as far as it is known.
fn fits((flags, dial, _): Drive, command: Option<&Command<'_>>) -> bool {
    let Some(Command::PrePosition { flags: how, width, speed }) = command else { return true };
    let end = if flags == CommandFlags::JOG_PLUS { STROKE } else { 0.0 };
    let wanted = if dial == 0 { hundredths(LEAST_SPEED) } else { dial.into() };
    *how == PrePositionFlags::STOP_ON_BLOCK && *width == end && hundredths(*speed) == wanted
}

impl Group {
    fn read(&mut self, now: Instant, reading: Inputs, debounce_ms: u32) {
        let is_fast_stop = self.wires == Inputs::FAST_STOP_OK;
        let period_ms = if is_fast_stop { debounce_ms.max(LEAST_RELEASE_MS) } else { debounce_ms };
        let reading = reading & self.wires;
        let (before, since) = self.read.unwrap_or((reading, now));
        let since = if reading == before { since } else { now };
        self.read = Some((reading, since));
        let has_settled = reading == before && now.since(since) >= period_ms;
        if has_settled || is_fast_stop && reading.is_empty() {
            self.counts = Some(reading);
        }
    }
}

fn hundredths(value: f32) -> i32 {
    (value * 100.0).round() as i32
}
