//! What a PLC has asked for: the rules of docs/wiring.md ("Inputs") and docs/registers.md ("Who commands"), and
//! whether a command that leaves the bridge was asked for by them.
//!
//! - An edge lets one command out, with the parameters of its side: of the recipe, or of the image. What else was asked for
//!   until then has come to nothing: one motion at a time.
//! - A wire counts once it has not changed for the debounce time: command and recipe wires together, STOP_ACK and
//!   FAST_STOP_OK by themselves; none before all have. But a low FAST_STOP_OK counts at once, and a high one after 5 ms at the
//!   least. The levels that the wires have then, and the first image of a bus, give no edge. Nor does a command wire while
//!   READY is low.
//! - A flag of the bus counts from its edge on, as long as it is 1 and the bus is heard. The edge of a motion or a jog is none
//!   while a command wire is high, or beside STOP/ACK; a command wire that rises ends what counts of them.
//! - Several motions at once are one: MOVE before GRIP before RELEASE before HOMING.
//! - With a recipe for the bus (BUS_RECIPE) an edge of it has that one's parameters, RELEASE the release width, and what the
//!   image has of them does not count.
//! - While the settings that are stored are refused, no motion leaves.
//! - A force limit leaves for its motion, and not after that came to nothing.
//! - STOP/ACK undoes the motions that were asked for before it and beside it, FAST STOP everything. Behind a FAST STOP no
//!   motion leaves before an acknowledgement, and that only for an edge of STOP/ACK. What was asked for before the connection
//!   was lost is void.

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

/// The motion flags, the one that counts first before the others, and their commands.
const MOTIONS: [(CommandFlags, CommandId); 4] = [
    (CommandFlags::MOVE, CommandId::PrePosition),
    (CommandFlags::GRIP, CommandId::GripPart),
    (CommandFlags::RELEASE, CommandId::ReleasePart),
    (CommandFlags::HOMING, CommandId::Homing),
];

const COMMANDS: CommandFlags =
    CommandFlags::MOVE.union(CommandFlags::GRIP).union(CommandFlags::RELEASE).union(CommandFlags::HOMING);
const JOG: CommandFlags = CommandFlags::JOG_PLUS.union(CommandFlags::JOG_MINUS);

/// Nothing leaves this long after its edge: in milliseconds.
const LATE_MS: u32 = 1_000;

/// How long FAST_STOP_OK must be high at least before it counts as high.
const LEAST_RELEASE_MS: u32 = 5;

/// A command that may leave.
struct Edge {
    id: CommandId,
    at_ms: u32,
    /// Width, speed and force limit of a motion, in hundredths.
    goes_by: [i32; 3],
}

/// What was asked for, and what has come of it.
pub(super) struct Asked {
    now_ms: u32,
    pub(super) debounce_ms: u32,
    pub(super) recipes: [Recipe; RECIPE_COUNT],
    /// Wires that settle together: the last reading, since when, and whether that is long enough to count.
    groups: [Group; 3],
    /// The flags of the wires as they count; none before all have settled.
    wires: Option<CommandFlags>,
    /// What the bus wrote last; none: what it writes next is its first.
    image: Option<OutputImage>,
    /// Its flags that count.
    bus: CommandFlags,
    /// Both sides' flags, as they stood last; none before the wires have settled.
    flags: Option<CommandFlags>,
    may_leave: Vec<Edge>,
    /// Force limits that were asked for, in hundredths, when, and whether for a jog.
    forces: Vec<(i32, u32, bool)>,
    /// What a jog goes by, and whether a Pre-position may leave for it.
    jog: (Option<(CommandFlags, u16, i16)>, bool),
    /// The bridge shows READY.
    pub(super) is_ready: bool,
    /// In this turn the edge of a command wire came while it did not.
    pub(super) is_refused: bool,
    /// In this turn a motion wire rose while it did.
    pub(super) has_edge: bool,
    /// In this turn FAST STOP or STOP/ACK was asked for, or what a jog goes by that runs was taken away or changed.
    pub(super) asks_fast_stop: bool,
    pub(super) asks_stop: bool,
    pub(super) ends_jog: bool,
    /// A Pre-position left for a jog, and was neither answered nor stopped.
    pub(super) jogs: bool,
    /// Since when a FAST STOP awaits its acknowledgement.
    pub(super) stopped_ms: Option<u32>,
    /// The settings that are stored are refused.
    pub(super) refuses: bool,
}

#[derive(Clone, Copy)]
struct Group {
    wires: Inputs,
    read: Option<(Inputs, u32)>,
    counts: Option<Inputs>,
}

impl Asked {
    /// Nothing, by a PLC whose wires are debounced for so long.
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

    /// Whether the wires have settled, and neither side holds STOP/ACK or FAST STOP.
    pub(super) fn is_released(&self) -> bool {
        let held = CommandFlags::STOP_ACK | CommandFlags::FASTSTOP;
        // STOP/ACK of a first image gives no edge, but holds.
        let stop = self.image.unwrap_or_default().flags & CommandFlags::STOP_ACK;
        self.wires.is_some_and(|wires| !(wires | self.bus | stop).intersects(held))
    }

    /// Whether either side asserts FAST STOP.
    pub(super) fn holds_fast_stop(&self) -> bool {
        match self.flags {
            Some(flags) => flags.contains(CommandFlags::FASTSTOP),
            // It does not wait for the other wires.
            None => self.groups[2].counts == Some(Inputs::empty()),
        }
    }

    /// The wires are read.
    pub(super) fn read_wires(&mut self, now_ms: u32, reading: Inputs) {
        self.now_ms = now_ms;
        (self.is_refused, self.asks_fast_stop, self.asks_stop, self.ends_jog) = (false, false, false, false);
        self.has_edge = false;
        for group in &mut self.groups {
            group.read(now_ms, reading, self.debounce_ms);
        }
        if self.groups[2].counts == Some(Inputs::empty()) && self.wires.is_none() && self.stopped_ms.is_none()
        {
            // It does not wait for the others.
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

    /// The bus has written an image, and its commands take this recipe's values.
    pub(super) fn take_image(&mut self, mut image: OutputImage, recipe: Option<Recipe>) {
        if let Some(recipe) = recipe {
            let OutputImage { flags, width, speed, force_limit, .. } = self.image.unwrap_or_default();
            (image.width, image.speed, image.force_limit) = (width, speed, force_limit);
            // The lowest bit counts of several; a jog goes by the recipe that counted when its flag rose.
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

    /// Nobody commands over the bus any more.
    pub(super) fn lose_bus(&mut self) {
        // What it began may be stopped, which says more than that.
        self.is_refused = false;
        self.image = None;
        self.bus &= CommandFlags::FASTSTOP;
        self.take(self.wires, false);
    }

    /// A command leaves the bridge; none where it only begins to, so that no more than the id is known. The force limit of
    /// the gripper in hundredths, if that is known.
    pub(super) fn leaves(&mut self, id: CommandId, command: Option<&Command<'_>>, force_limit: Option<i32>) {
        match id.kind() {
            Kind::Motion => {
                assert!(self.stopped_ms.is_none(), "{id} behind a FAST STOP that is not acknowledged");
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
                assert_eq!(id, CommandId::SetForceLimit, "{id} is no command of a PLC, but {kind:?}");
                if let Some(Command::SetForceLimit { force }) = command {
                    let is_recent = |(asked, at_ms, _): &(i32, u32, bool)| {
                        *asked == hundredths(*force) && self.now_ms - at_ms < LATE_MS
                    };
                    assert!(self.forces.iter().any(is_recent), "{force} N, which nobody asked for");
                }
            }
        }
    }

    /// The connection to the gripper is lost, or there is none.
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
        let asked = if speed == 0 { hundredths(LEAST_SPEED) } else { speed.into() };
        *how == PrePositionFlags::STOP_ON_BLOCK && *width == end && hundredths(*goes) == asked
    }

    /// What an edge of this command goes by: of a wire, or else of the bus.
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

    /// Takes both sides' flags as they stand now, behind a change of the wires, or else of the bus.
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

    /// A jog goes by its flags, SPEED and FORCELIMIT, and what changes of them asks for another command.
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

    /// What was asked for comes to nothing.
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
