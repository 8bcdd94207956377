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
//!   an acknowledgement, which requires an edge of STOP/ACK. A lost connection voids earlier requests.

use wsg_bridge_fw::io::Inputs;
use wsg_bridge_fw::{RECIPE_COUNT, RECIPES, Recipe};
use wsg_fieldbus::{CommandFlags, OutputImage};
use wsg_protocol::{Command, CommandId, Kind, PrePositionFlags};

use crate::gripper_states::{LEAST_SPEED, STROKE};

const COMMAND_WIRES: [(Inputs, CommandFlags); 4] = [
    (Inputs::MOVE, CommandFlags::MOVE),
    (Inputs::GRIP, CommandFlags::GRIP),
    (Inputs::RELEASE, CommandFlags::RELEASE),
    (Inputs::HOME, CommandFlags::HOMING),
];

/// Motion flags in order of precedence, and their commands.
pub(super) const MOTIONS: [(CommandFlags, CommandId); 4] = [
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
struct Edge {
    id: CommandId,
    at_ms: u32,
    /// Width, speed and force limit of a motion, in hundredths.
    goes_by: [i32; 3],
}

/// Requests and their outcomes so far.
pub(super) struct Requested {
    now_ms: u32,
    pub(super) debounce_ms: u32,
    pub(super) recipes: [Recipe; RECIPE_COUNT],
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
    may_leave: Vec<Edge>,
    /// Requested force limits in hundredths, with their times and whether for a jog.
    forces: Vec<(i32, u32, bool)>,
    /// Parameters of a jog, and whether a Pre-position may be sent for it.
    jog: (Option<(CommandFlags, u16, i16)>, bool),
    /// Whether the bridge shows READY.
    pub(super) is_ready: bool,
    /// Whether a command wire rose in this turn while READY was low.
    pub(super) is_refused: bool,
    /// Whether a motion wire rose in this turn while READY was high.
    pub(super) has_edge: bool,
    /// Whether FAST STOP or STOP/ACK was requested in this turn, or the parameters of a running jog ended or changed.
    pub(super) asks_fast_stop: bool,
    pub(super) asks_stop: bool,
    pub(super) ends_jog: bool,
    /// Whether a Pre-position was sent for a jog and neither answered nor stopped.
    pub(super) jogs: bool,
    /// Time since which a FAST STOP has been unacknowledged.
    pub(super) stopped_ms: Option<u32>,
    /// Whether the stored settings are rejected.
    pub(super) refuses: bool,
}

#[derive(Clone, Copy)]
struct Group {
    wires: Inputs,
    read: Option<(Inputs, u32)>,
    counts: Option<Inputs>,
}

impl Requested {
    /// Creates the state without requests, with this debounce time.
    pub(super) fn new(debounce_ms: u32) -> Self {
        let command_group = Inputs::all().difference(Inputs::STOP_ACK | Inputs::FAST_STOP_OK);
        let group = |wires| Group { wires, read: None, counts: None };
        Self {
            now_ms: 0,
            debounce_ms,
            recipes: RECIPES,
            groups: [command_group, Inputs::STOP_ACK, Inputs::FAST_STOP_OK].map(group),
            wires: None,
            image: None,
            bus: CommandFlags::empty(),
            flags: None,
            may_leave: Vec::new(),
            forces: Vec::new(),
            jog: (None, false),
            is_ready: false,
            is_refused: false,
            has_edge: false,
            asks_fast_stop: false,
            asks_stop: false,
            ends_jog: false,
            jogs: false,
            stopped_ms: None,
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
    pub(super) fn read_wires(&mut self, now_ms: u32, reading: Inputs) {
        self.now_ms = now_ms;
        (self.is_refused, self.asks_fast_stop, self.asks_stop, self.ends_jog) = (false, false, false, false);
        self.has_edge = false;
        for group in &mut self.groups {
            group.read(now_ms, reading, self.debounce_ms);
        }
        if self.groups[2].counts == Some(Inputs::empty()) && self.wires.is_none() && self.stopped_ms.is_none()
        {
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
    pub(super) fn take_image(&mut self, mut image: OutputImage, recipe: Option<Recipe>) {
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

    /// Processes the loss of the bus.
    pub(super) fn lose_bus(&mut self) {
        // Stopping the bus's motion takes precedence in the display.
        self.is_refused = false;
        self.image = None;
        self.bus &= CommandFlags::FASTSTOP;
        self.take(self.wires, false);
    }

    /// Checks a command that is sent. `command` is `None` while only its id is known; `force_limit` is the gripper's,
    /// in hundredths, if known.
    pub(super) fn leaves(&mut self, id: CommandId, command: Option<&Command<'_>>, force_limit: Option<i32>) {
        match id.kind() {
            Kind::Motion => {
                assert!(self.stopped_ms.is_none(), "{id} after an unacknowledged FAST STOP");
                assert!(!self.refuses, "{id} while the stored settings are refused");
                let is_limited_to = |force| force_limit.is_none_or(|limit| limit == force);
                let has_edge = self.may_leave.iter().any(|edge| {
                    let is_limited = id != CommandId::GripPart || is_limited_to(edge.goes_by[2]);
                    is_limited && self.lets_out(edge, id, command)
                });
                let jogs = id == CommandId::PrePosition
                    && self.jog.0.is_some_and(|(.., force)| is_limited_to(force.into()))
                    && self.jogs_by(command);
                assert!(has_edge || jogs, "{id} without an edge, {command:?}, limited to {force_limit:?}");
                self.jogs = !has_edge;
                self.may_leave.clear();
                self.jog.1 = false;
            }
            Kind::Acknowledge => {
                let edge = self.may_leave.iter().position(|edge| self.lets_out(edge, id, None));
                let edge = edge.expect("an acknowledgement without STOP/ACK");
                self.may_leave.remove(edge);
                self.stopped_ms = None;
            }
            Kind::Stop => {
                self.jogs = false;
                if id == CommandId::FastStop {
                    self.undo();
                    self.stopped_ms = self.stopped_ms.or(Some(self.now_ms));
                }
            }
            Kind::Query => {}
            kind => {
                assert_eq!(id, CommandId::SetForceLimit, "{id} ({kind:?}) is not a PLC command");
                if let Some(Command::SetForceLimit { force }) = command {
                    let is_recent = |(requested, at_ms, _): &(i32, u32, bool)| {
                        *requested == hundredths(*force) && self.now_ms - at_ms < LATE_MS
                    };
                    assert!(self.forces.iter().any(is_recent), "{force} N without a request");
                }
            }
        }
    }

    /// Processes a missing or lost connection to the gripper.
    pub(super) fn lose_gripper(&mut self) {
        self.undo();
        self.jogs = false;
    }

    fn lets_out(&self, edge: &Edge, id: CommandId, command: Option<&Command<'_>>) -> bool {
        let [width, speed, _] = edge.goes_by;
        let goes_by = |w: f32, s: f32| (hundredths(w), hundredths(s)) == (width, speed);
        let is_so = match command {
            None => true,
            Some(Command::PrePosition { flags, width, speed }) => {
                *flags == PrePositionFlags::STOP_ON_BLOCK && goes_by(*width, *speed)
            }
            Some(Command::GripPart { width, speed } | Command::ReleasePart { width, speed }) => {
                goes_by(*width, *speed)
            }
            Some(other) => other.id() == CommandId::Homing,
        };
        edge.id == id && is_so && self.now_ms - edge.at_ms < LATE_MS
    }

    fn jogs_by(&self, command: Option<&Command<'_>>) -> bool {
        let (Some((flags, speed, _)), true) = self.jog else { return false };
        let Some(Command::PrePosition { flags: how, width, speed: goes }) = command else { return true };
        let end = if flags == CommandFlags::JOG_PLUS { STROKE } else { 0.0 };
        let wanted = if speed == 0 { hundredths(LEAST_SPEED) } else { speed.into() };
        *how == PrePositionFlags::STOP_ON_BLOCK && *width == end && hundredths(*goes) == wanted
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
            let is_first = before.is_none() && self.stopped_ms.is_none();
            if is_first || rising.contains(CommandFlags::FASTSTOP) {
                self.fast_stop();
            }
        } else if rising.contains(CommandFlags::STOP_ACK) {
            (self.is_refused, self.asks_stop) = (false, true);
            self.may_leave.retain(|edge| edge.id == CommandId::Acknowledge);
            self.forces.clear();
            self.jog.1 = false;
            self.may_leave.push(Edge { id: CommandId::Acknowledge, at_ms: self.now_ms, goes_by: [0; 3] });
        } else if !flags.contains(CommandFlags::STOP_ACK)
            && let Some((_, id)) = MOTIONS.iter().find(|(flag, _)| rising.contains(*flag))
        {
            self.is_refused = of_wire && !self.is_ready;
            self.has_edge |= of_wire && self.is_ready;
            if !self.is_refused {
                let goes_by = self.parameters(*id, of_wire);
                self.forces.push((goes_by[2], self.now_ms, false));
                self.may_leave.push(Edge { id: *id, at_ms: self.now_ms, goes_by });
            }
        }
        self.follow_jog(flags & (self.bus | !JOG), before.is_none());
    }

    /// A jog depends on its flags, SPEED and FORCELIMIT; a change requests another command.
    fn follow_jog(&mut self, flags: CommandFlags, is_first: bool) {
        let stops = flags.intersects(CommandFlags::STOP_ACK | CommandFlags::FASTSTOP);
        let image = self.image.filter(|_| flags.intersects(JOG) && !stops);
        let goes_by = image.map(|image| (flags & JOG, image.speed, image.force_limit));
        if goes_by != self.jog.0 {
            self.ends_jog |= self.jogs;
            self.forces.retain(|(.., of_jog)| !of_jog);
            self.forces.extend(goes_by.map(|(_, _, force_limit)| (force_limit.into(), self.now_ms, true)));
            self.jog = (goes_by, goes_by.is_some() && !is_first);
        }
    }

    fn fast_stop(&mut self) {
        self.undo();
        self.asks_fast_stop = true;
        self.stopped_ms = self.stopped_ms.or(Some(self.now_ms));
    }

    fn undo(&mut self) {
        self.may_leave.clear();
        self.forces.clear();
        self.jog.1 = false;
    }
}

impl Group {
    fn read(&mut self, now_ms: u32, reading: Inputs, debounce_ms: u32) {
        let is_fast_stop = self.wires == Inputs::FAST_STOP_OK;
        let period_ms = if is_fast_stop { debounce_ms.max(LEAST_RELEASE_MS) } else { debounce_ms };
        let reading = reading & self.wires;
        let (before, since_ms) = self.read.unwrap_or((reading, now_ms));
        let since_ms = if reading == before { since_ms } else { now_ms };
        self.read = Some((reading, since_ms));
        let has_settled = reading == before && now_ms - since_ms >= period_ms;
        if has_settled || is_fast_stop && reading.is_empty() {
            self.counts = Some(reading);
        }
    }
}

fn hundredths(value: f32) -> i32 {
    (value * 100.0).round() as i32
}
