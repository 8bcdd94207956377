//! Digital I/O as a PLC side: converts input wires to the output image, and the input image to output wires.

use super::motion_end::MOTION_STATES;
use super::side::{PlcEvent, PlcSide, Shown};
use super::{Debounce, Settings, View};
use crate::io::{Inputs, Outputs};
use crate::recipe::Recipe;
use crate::register::{Link, saturate, setting_rows};
use wsg_fieldbus::{CommandFlags, ForceUnit, GripperFlags, InputImage, OutputImage};
use wsg_protocol::{Instant, Status, SystemFlags};

/// Command wires and their flags. FAST STOP is separate, because its wire is active low.
const COMMANDS: [(Inputs, CommandFlags); 5] = [
    (Inputs::MOVE, CommandFlags::MOVE),
    (Inputs::GRIP, CommandFlags::GRIP),
    (Inputs::RELEASE, CommandFlags::RELEASE),
    (Inputs::HOME, CommandFlags::HOMING),
    (Inputs::STOP_ACK, CommandFlags::STOP_ACK),
];

/// Duration of BUSY after a refused edge, in milliseconds, regardless of a shorter MIN_BUSY. It covers the cycle of a slow
/// PLC.
const REFUSAL_MS: u32 = 50;

/// Timing of the wires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WiresConfig {
    /// Debounce time of the inputs, in milliseconds.
    pub debounce_ms: u32,
    /// Minimum duration of BUSY, in milliseconds. A motion whose target is already reached would otherwise show BUSY for less
    /// than a PLC's cycle.
    pub min_busy_ms: u32,
}

impl WiresConfig {
    /// 2 ms debounce, BUSY for at least 50 ms.
    pub const DEFAULT: Self = Self { debounce_ms: 2, min_busy_ms: 50 };
}

setting_rows! { WiresConfig:
    106 "DEBOUNCE" "ms" (0, 1_000) "debounce time of the input wires; FAST_STOP_OK low takes effect immediately, regardless of this setting"
        debounce_ms: |it| saturate(it), |value| Some(value.into());
    107 "MIN_BUSY" "ms" (0, 10_000) "minimum duration of the wire BUSY; at least 50 ms after a refused command"
        min_busy_ms: |it| saturate(it), |value| Some(value.into());
}

/// Conversion between the wires of a PLC and the register images.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Wires {
    debounce: Debounce,
    /// Debounced levels; `None` until all wires have settled after power-up.
    levels: Option<Inputs>,
    image: OutputImage,
    min_busy_ms: u32,
    /// Time at which a motion wire or BUSY last rose. BUSY stays high for a minimum time from then.
    busy_since: Option<Instant>,
    /// A motion has run since BUSY rose. Its result is shown when BUSY falls.
    has_run: bool,
    /// Output levels for the PLC.
    shown: Outputs,
}

impl Wires {
    /// Creates the state before the first reading.
    #[must_use]
    pub(crate) const fn new(WiresConfig { debounce_ms, min_busy_ms }: WiresConfig) -> Self {
        Self {
            debounce: Debounce::new(debounce_ms),
            levels: None,
            image: OutputImage::ZERO,
            min_busy_ms,
            busy_since: None,
            has_run: false,
            shown: Outputs::empty(),
        }
    }

    /// Returns whether READY is high. While it is low, an edge of a command wire is refused.
    pub(crate) const fn is_ready(&self) -> bool {
        self.shown.contains(Outputs::READY)
    }

    /// Applies settings, from the next reading on.
    pub(crate) fn configure(&mut self, settings: &Settings) {
        let config = settings.wires();
        self.debounce.set_period(config.debounce_ms);
        self.min_busy_ms = config.min_busy_ms;
    }

    /// Processes a reading of the wires. Returns the output image if it has changed.
    ///
    /// Reads the recipe when its command rises. The arbiter ignores the parameters of a command that rises while READY is
    /// low, because a parameter change during a motion causes a FAST STOP (fieldbus, table 1).
    fn update(
        &mut self,
        now: Instant,
        reading: Inputs,
        recipe: impl FnOnce(usize) -> Option<(Recipe, ForceUnit)>,
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
        let held = CommandFlags::STOP_ACK.union(CommandFlags::FASTSTOP);
        if before.is_some() && rising.intersects(CommandFlags::MOTIONS) && !flags.intersects(held) {
            // Every command shows BUSY, even a refused one: ERROR may have been high before.
            self.busy_since = Some(now);
        }
        self.take_recipe(rising, levels, recipe);
        Some(&self.image)
    }

    /// Reports FAST STOP before all wires have settled after power-up, so that a bouncing command wire does not delay it.
    ///
    /// All command flags are set as well, so that none of them rises when the wires settle. FASTSTOP overrules them.
    fn early_fast_stop(&mut self) -> Option<&OutputImage> {
        let wanted = self.debounce.is_settled_low(Inputs::FAST_STOP_OK);
        if !wanted || self.image.flags.contains(CommandFlags::FASTSTOP) {
            return None;
        }
        self.image.flags =
            COMMANDS.iter().fold(CommandFlags::FASTSTOP, |flags, (_, flag)| flags.union(*flag));
        Some(&self.image)
    }

    /// Returns these wires with their current reading: a PLC side for one turn.
    pub(crate) const fn read(&mut self, reading: Inputs) -> WiresRead<'_> {
        WiresRead { wires: self, reading }
    }

    /// Returns the output levels for the PLC.
    pub(crate) const fn shown(&self) -> Outputs {
        self.shown
    }

    fn levels_for(&mut self, now: Instant, shown: &Shown) -> Outputs {
        let busy = self.is_busy(now, shown);
        let gripper = &shown.image;
        let has = |state: GripperFlags| gripper.state.intersects(state);
        let levels = self.levels.unwrap_or_default();
        let released = levels.contains(Inputs::FAST_STOP_OK) && !levels.contains(Inputs::STOP_ACK);
        let locked = gripper.system.intersects(SystemFlags::LOCKS);
        let mut outputs = Outputs::empty();
        outputs.set(Outputs::ERROR, has_error(shown));
        if shown.link != Link::Up {
            // The last reported state of the gripper is no longer valid.
            return outputs;
        }
        outputs.set(Outputs::LINK_OK, true);
        outputs.set(Outputs::READY, !busy && !locked && released && !shown.ignores_motions);
        outputs.set(Outputs::BUSY, busy);
        // A result is shown when BUSY falls, not before. While BUSY answers a refused edge, the last result stays.
        let is_over = !self.has_run;
        outputs.set(Outputs::HOLDING, has(GripperFlags::HOLDING) && is_over);
        outputs.set(
            Outputs::PART_FAULT,
            has(GripperFlags::PART_LOST) || (has(GripperFlags::NO_PART) && is_over),
        );
        outputs.set(Outputs::REFERENCED, gripper.system.contains(SystemFlags::REFERENCED));
        outputs
    }

    /// Returns whether a motion runs or has not been answered, or a command is too recent for a PLC to have seen BUSY. A
    /// locked gripper ends BUSY immediately, because READY stays low.
    fn is_busy(&mut self, now: Instant, shown: &Shown) -> bool {
        let gripper = &shown.image;
        let runs = is_moving(gripper) || (shown.motion_is_open && !is_error(gripper));
        let has_run = runs || self.has_run;
        let since = self.busy_since.or(runs.then_some(now));
        // In its turn, an edge begins a motion or an error.
        let least_ms = if is_error(gripper) { self.min_busy_ms.max(REFUSAL_MS) } else { self.min_busy_ms };
        let too_short = since.is_some_and(|since| now.since(since) < least_ms);
        let locked = gripper.system.intersects(SystemFlags::LOCKS);
        let busy = shown.link == Link::Up && (runs || (too_short && !locked));
        self.busy_since = since.filter(|_| busy);
        self.has_run = has_run && busy;
        busy
    }

    fn take_recipe(
        &mut self,
        rising: CommandFlags,
        levels: Inputs,
        recipe: impl FnOnce(usize) -> Option<(Recipe, ForceUnit)>,
    ) {
        let with_recipe = CommandFlags::MOVE | CommandFlags::GRIP | CommandFlags::RELEASE;
        // The lowest of several flags takes effect, as in the controller.
        let Some(command) = rising.intersection(with_recipe).lowest() else { return };
        let number =
            usize::from(levels.contains(Inputs::RECIPE0)) + 2 * usize::from(levels.contains(Inputs::RECIPE1));
        if let Some((recipe, unit)) = recipe(number) {
            recipe.fill(&mut self.image, command, unit);
        }
    }
}

/// [`Wires`] with their current reading.
#[derive(Debug)]
pub(crate) struct WiresRead<'a> {
    wires: &'a mut Wires,
    reading: Inputs,
}

impl PlcSide for WiresRead<'_> {
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        let recipe = |number| view.settings.recipe(number).map(|recipe| (recipe, view.force_unit()));
        let image = self.wires.update(now, self.reading, recipe)?;
        Some(PlcEvent::Output(*image))
    }

    fn show(&mut self, now: Instant, shown: &Shown) {
        self.wires.shown = self.wires.levels_for(now, shown);
    }
}

/// Returns whether a motion is in progress, or the fingers move for another reason.
fn is_moving(gripper: &InputImage) -> bool {
    gripper.state.intersects(MOTION_STATES) || gripper.system.contains(SystemFlags::MOVING)
}

/// Returns whether the wire ERROR is high.
pub(crate) fn has_error(shown: &Shown) -> bool {
    is_error(&shown.image) || shown.refused_meanwhile
}

/// Returns whether the image shows FAST STOP, a fault, or a last command that was refused, failed or has an unknown outcome.
/// A missing part is a result, not an error.
fn is_error(gripper: &InputImage) -> bool {
    let no_part = gripper.status == Status::CmdFailed && gripper.state.contains(GripperFlags::NO_PART);
    let failed = !matches!(gripper.status, Status::Success | Status::CmdPending) && !no_part;
    failed
        || gripper.state.contains(GripperFlags::ERROR)
        || gripper.system.intersects(SystemFlags::LOCKS | SystemFlags::FINGER_FAULT)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOTHING: InputImage = InputImage::from_bytes([0; InputImage::LEN]);

    /// Returns the outputs for these wires and the flags of a gripper at rest.
    fn shown_for(inputs: Inputs, system: SystemFlags) -> Outputs {
        shown_of(inputs, InputImage { system, ..NOTHING })
    }

    fn shown_of(inputs: Inputs, image: InputImage) -> Outputs {
        let mut wires = Wires::new(WiresConfig { debounce_ms: 0, min_busy_ms: 0 });
        for ms in 0..10 {
            wires.update(Instant::from_millis(ms), inputs, |_| None);
        }
        let shown = Shown {
            image,
            link: Link::Up,
            error_cause: 0,
            refused_meanwhile: false,
            motion_is_open: false,
            ignores_motions: false,
        };
        wires.levels_for(Instant::from_millis(10), &shown)
    }

    #[test]
    fn moving_fingers_and_a_running_motion_each_show_busy() {
        let moving = InputImage { system: SystemFlags::MOVING, ..NOTHING };
        for state in GripperFlags::all() {
            let image = InputImage { state, ..NOTHING };
            let is_busy = shown_of(Inputs::FAST_STOP_OK, image).contains(Outputs::BUSY);
            assert_eq!(is_busy, MOTION_STATES.contains(state), "{state:?}");
        }
        assert!(shown_of(Inputs::FAST_STOP_OK, moving).contains(Outputs::BUSY));
    }

    #[test]
    fn only_no_part_makes_a_failed_command_a_result() {
        for (status, state, is_error) in [
            (Status::CmdFailed, GripperFlags::NO_PART, false),
            (Status::CmdFailed, GripperFlags::IDLE, true),
            (Status::AccessDenied, GripperFlags::NO_PART, true),
            (Status::Success, GripperFlags::NO_PART, false),
            (Status::Success, GripperFlags::ERROR, true),
        ] {
            let shown = shown_of(Inputs::FAST_STOP_OK, InputImage { status, state, ..NOTHING });
            assert_eq!(shown.contains(Outputs::ERROR), is_error, "{status:?} {state:?}");
        }
    }

    #[test]
    fn exactly_the_locking_flags_show_error_and_not_ready() {
        let locks = [
            SystemFlags::FAST_STOP,
            SystemFlags::TEMP_FAULT,
            SystemFlags::POWER_FAULT,
            SystemFlags::CURR_FAULT,
        ];
        for flag in SystemFlags::all().iter().filter(|flag| *flag != SystemFlags::MOVING) {
            let shown = shown_for(Inputs::FAST_STOP_OK, flag);
            let is_lock = locks.contains(&flag);
            assert_eq!(shown.contains(Outputs::READY), !is_lock, "{flag:?}");
            let is_error = is_lock || flag == SystemFlags::FINGER_FAULT;
            assert_eq!(shown.contains(Outputs::ERROR), is_error, "{flag:?}");
        }
    }

    #[test]
    fn ready_needs_a_high_fast_stop_wire_and_a_low_stop_ack() {
        let ready = Outputs::READY | Outputs::LINK_OK;
        for (inputs, shown) in [
            (Inputs::FAST_STOP_OK, ready),
            (Inputs::FAST_STOP_OK | Inputs::STOP_ACK, Outputs::LINK_OK),
            (Inputs::empty(), Outputs::LINK_OK),
            (Inputs::STOP_ACK, Outputs::LINK_OK),
            (Inputs::all() - Inputs::STOP_ACK, ready),
        ] {
            assert_eq!(shown_for(inputs, SystemFlags::empty()), shown, "{inputs:?}");
        }
    }
}
