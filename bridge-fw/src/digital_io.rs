//! Digital I/O as a PLC side: wires in, output image out; input image in, wires out.

use crate::debounce::Debounce;
use crate::io::{Inputs, Outputs};
use crate::modbus::Settings;
use crate::recipe::{RECIPE_COUNT, Recipe};
use wsg_protocol::fieldbus::{CommandFlags, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Instant, Status, SystemFlags};

/// Each command wire and the flag that it stands for. FAST STOP is apart: its wire is active low.
const COMMANDS: [(Inputs, CommandFlags); 5] = [
    (Inputs::MOVE, CommandFlags::MOVE),
    (Inputs::GRIP, CommandFlags::GRIP),
    (Inputs::RELEASE, CommandFlags::RELEASE),
    (Inputs::HOME, CommandFlags::HOMING),
    (Inputs::STOP_ACK, CommandFlags::STOP_ACK),
];

/// GSTATE while a motion command is carried out.
const MOTION_STATES: GripperFlags =
    GripperFlags::GRIPPING.union(GripperFlags::RELEASING).union(GripperFlags::POSITIONING);

/// The wires between a PLC and the register images.
#[derive(Clone, Debug, Hash)]
pub struct DigitalIo {
    debounce: Debounce,
    recipes: [Recipe; RECIPE_COUNT],
    /// The wires as they count now; none before they have settled after power-up.
    levels: Option<Inputs>,
    image: OutputImage,
    min_busy_ms: u32,
    /// Since when BUSY is high.
    busy_since: Option<Instant>,
    /// What the PLC is shown.
    shown: Outputs,
}

impl DigitalIo {
    /// Wires that are debounced for `debounce_ms` milliseconds, and a BUSY that lasts `min_busy_ms` at least.
    #[must_use]
    pub const fn new(debounce_ms: u32, min_busy_ms: u32, recipes: [Recipe; RECIPE_COUNT]) -> Self {
        Self {
            debounce: Debounce::new(debounce_ms),
            recipes,
            levels: None,
            image: OutputImage::ZERO,
            min_busy_ms,
            busy_since: None,
            shown: Outputs::empty(),
        }
    }

    /// Whether the PLC is shown READY: the edge of a command wire is refused while it is not.
    pub(crate) const fn is_ready(&self) -> bool {
        self.shown.contains(Outputs::READY)
    }

    /// Takes over settings, from the next reading on.
    pub(crate) fn configure(&mut self, settings: &Settings) {
        self.debounce.set_period(settings.debounce_ms());
        self.min_busy_ms = settings.min_busy_ms();
        for (number, recipe) in self.recipes.iter_mut().enumerate() {
            *recipe = settings.recipe(number).unwrap_or(*recipe);
        }
    }

    /// Takes a reading of the wires; the output image when it has changed.
    ///
    /// The recipe is taken when its command rises while READY is shown, so never during a motion: there a parameter that
    /// changes is a FAST STOP (fieldbus, table 1).
    pub fn update(
        &mut self,
        now: Instant,
        reading: Inputs,
        unit: impl FnOnce() -> ForceUnit,
    ) -> Option<&OutputImage> {
        let Some(levels) = self.debounce.update(now, reading) else { return self.early_fast_stop() };
        let before = self.levels.replace(levels);
        if before == Some(levels) {
            return None;
        }
        let mut flags = CommandFlags::empty();
        for (wire, flag) in COMMANDS {
            flags.set(flag, levels.contains(wire));
        }
        flags.set(CommandFlags::FASTSTOP, !levels.contains(Inputs::FAST_STOP_OK));
        let rising = flags.difference(self.image.flags);
        self.image.flags = flags;
        if self.is_ready() {
            self.take_recipe(rising, levels, unit);
        }
        Some(&self.image)
    }

    /// FAST STOP before all wires have settled after power-up: it must not wait for a command wire that chatters.
    ///
    /// All other flags are shown set, which FASTSTOP overrules, so that none of them rises when the wires settle.
    fn early_fast_stop(&mut self) -> Option<&OutputImage> {
        let wanted = self.debounce.is_settled_low(Inputs::FAST_STOP_OK);
        if !wanted || self.image.flags.contains(CommandFlags::FASTSTOP) {
            return None;
        }
        self.image.flags =
            COMMANDS.iter().fold(CommandFlags::FASTSTOP, |flags, (_, flag)| flags.union(*flag));
        Some(&self.image)
    }

    /// The wires to the PLC for what the gripper shows.
    ///
    /// `motion_is_open`: a motion has not answered yet, be it that it was stopped. `ignores_motions`: an edge of a command wire
    /// would come to nothing, for that reason, because the fingers move, or because either side holds STOP/ACK or FASTSTOP.
    pub fn outputs(
        &mut self,
        now: Instant,
        gripper: &InputImage,
        connected: bool,
        motion_is_open: bool,
        ignores_motions: bool,
    ) -> Outputs {
        self.shown = self.levels_for(now, gripper, connected, motion_is_open);
        if ignores_motions {
            self.shown -= Outputs::READY;
        }
        self.shown
    }

    fn levels_for(
        &mut self,
        now: Instant,
        gripper: &InputImage,
        connected: bool,
        motion_is_open: bool,
    ) -> Outputs {
        let busy = self.is_busy(now, gripper, connected, motion_is_open);
        let has = |state: GripperFlags| gripper.state.intersects(state);
        let levels = self.levels.unwrap_or_default();
        let released = levels.contains(Inputs::FAST_STOP_OK) && !levels.contains(Inputs::STOP_ACK);
        let locked = gripper.system.intersects(SystemFlags::LOCKS);
        let mut outputs = Outputs::empty();
        outputs.set(Outputs::ERROR, is_error(gripper));
        if !connected {
            // Nothing is known of the gripper, whatever it has told so far.
            return outputs;
        }
        outputs.set(Outputs::LINK_OK, true);
        outputs.set(Outputs::READY, !busy && !locked && released);
        outputs.set(Outputs::BUSY, busy);
        // A result shows when BUSY goes, not before.
        outputs.set(Outputs::HOLDING, has(GripperFlags::HOLDING) && !busy);
        outputs
            .set(Outputs::PART_FAULT, has(GripperFlags::PART_LOST) || (has(GripperFlags::NO_PART) && !busy));
        outputs.set(Outputs::REFERENCED, gripper.system.contains(SystemFlags::REFERENCED));
        outputs
    }

    /// Whether a motion runs, has not answered, or ran too short for a PLC to have seen it. An error shows at once, and stays
    /// to be seen.
    fn is_busy(&mut self, now: Instant, gripper: &InputImage, connected: bool, motion_is_open: bool) -> bool {
        let moving = is_moving(gripper);
        let since = self.busy_since.or(moving.then_some(now));
        let too_short = since.is_some_and(|since| now.since(since) < self.min_busy_ms);
        let shown = connected && (moving || ((motion_is_open || too_short) && !is_error(gripper)));
        self.busy_since = since.filter(|_| shown);
        shown
    }

    fn take_recipe(&mut self, rising: CommandFlags, levels: Inputs, unit: impl FnOnce() -> ForceUnit) {
        let with_recipe = CommandFlags::MOVE | CommandFlags::GRIP | CommandFlags::RELEASE;
        // As the controller does: of several the lowest bit counts.
        let Some(command) = rising.intersection(with_recipe).lowest() else { return };
        let number =
            usize::from(levels.contains(Inputs::RECIPE0)) + 2 * usize::from(levels.contains(Inputs::RECIPE1));
        let Some(recipe) = self.recipes.get(number) else { return };
        self.image.width = if command == CommandFlags::RELEASE { recipe.release_width } else { recipe.width };
        self.image.speed = recipe.speed;
        self.image.force_limit = match unit() {
            ForceUnit::Hundredth => recipe.force,
            ForceUnit::Tenth => recipe.force / 10,
        };
    }
}

/// Whether a motion is shown to be carried out, or the fingers to move for another reason.
fn is_moving(gripper: &InputImage) -> bool {
    gripper.state.intersects(MOTION_STATES) || gripper.system.contains(SystemFlags::MOVING)
}

/// FAST STOP, a fault, or a last command that was refused, failed or has an unknown outcome. That no part was found is
/// a result, not an error.
fn is_error(gripper: &InputImage) -> bool {
    let no_part = gripper.status == Status::CmdFailed && gripper.state.contains(GripperFlags::NO_PART);
    let failed = !matches!(gripper.status, Status::Success | Status::CmdPending) && !no_part;
    failed
        || gripper.state.contains(GripperFlags::ERROR)
        || gripper.system.intersects(SystemFlags::LOCKS | SystemFlags::FINGER_FAULT)
}
