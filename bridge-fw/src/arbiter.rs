//! Arbitration: merges the commands of wires and bus to one output image for the controller.
//!
//! The rules:
//! 1. FASTSTOP and STOP/ACK of either side always take effect, including a low FASTSTOP wire.
//! 2. Motion and jog flags of the bus take effect only while all command wires (GRIP, RELEASE, MOVE, HOME) are low. A flag
//!    that rises in the meantime, or is 1 when a command wire rises, is ignored until it was written 0. So a jog of the bus
//!    ends when a command wire rises.
//! 3. The first image of the bus, after power-up or a time-out, gives no edge. A flag that is 1 in it is ignored until it was
//!    written 0. FASTSTOP takes effect immediately. Reads do not matter: a master that holds a flag during a reset of the
//!    bridge may read zeros before it writes.
//! 4. While the stored settings are refused, and during an update, motion and jog flags of the bus are ignored until they were written 0
//!    afterwards.
//! 5. WIDTH, SPEED and FORCELIMIT come from the source of the last motion command. While the fingers move, the other side's
//!    values have no effect.

use crate::recipe::Recipe;
use crate::register::EventCode;
use wsg_fieldbus::{CommandFlags, ForceUnit, MaskedFlags, OutputImage};

/// Flags that move fingers.
const MOVERS: CommandFlags = CommandFlags::MOTIONS.union(CommandFlags::JOG);

/// Source of the last motion command.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ControlSource {
    /// No motion command since power-up.
    #[default]
    Nobody,
    /// The wires.
    Wires,
    /// The bus.
    Bus,
}

/// Merges wire and bus commands.
#[derive(Clone, Debug, Hash)]
pub(crate) struct Arbiter {
    /// Image of the wires; `None` until they have settled.
    wires: Option<OutputImage>,
    /// Last image written by the bus.
    bus: OutputImage,
    /// The next image of the bus is its first.
    bus_is_new: bool,
    /// Ignored flags of the bus.
    masked: MaskedFlags,
    /// All flags that move fingers are ignored.
    refuses: bool,
    /// FASTSTOP is 1 before a restart, regardless of wires and bus.
    restarts: bool,
    control_source: ControlSource,
    /// Effective WIDTH, SPEED and FORCELIMIT. Its flags are unused.
    parameters: OutputImage,
}

impl Arbiter {
    pub(crate) const fn new() -> Self {
        Self {
            wires: None,
            bus: OutputImage::ZERO,
            bus_is_new: true,
            masked: MaskedFlags::NONE,
            refuses: false,
            restarts: false,
            control_source: ControlSource::Nobody,
            parameters: OutputImage::ZERO,
        }
    }

    pub(crate) const fn control_source(&self) -> ControlSource {
        self.control_source
    }

    /// Returns the last image written by the bus, whether or not it has an effect.
    pub(crate) const fn bus_image(&self) -> &OutputImage {
        &self.bus
    }

    /// Returns whether the bus holds STOP/ACK, which prevents every motion (fieldbus, table 1). A master's first image gives
    /// no edge of it, but the level takes effect.
    pub(crate) const fn bus_holds_stop(&self) -> bool {
        !self.bus_is_new && self.bus.flags.contains(CommandFlags::STOP_ACK)
    }

    /// Sets whether flags that move fingers are ignored, from the bus's next image on.
    pub(crate) const fn set_refuses(&mut self, refuses: bool) {
        self.refuses = refuses;
    }

    /// Sets whether the bridge itself requests FAST STOP for a restart. Returns the image for the controller if this changes and
    /// the wires have settled.
    pub(crate) fn set_restarts(&mut self, restarts: bool) -> Option<OutputImage> {
        let is_new = core::mem::replace(&mut self.restarts, restarts) != restarts;
        self.wires.filter(|_| is_new).map(|wires| self.merged(wires.flags))
    }

    /// Returns the event of a FASTSTOP flag. The wires take precedence, because they may be broken.
    pub(crate) fn fast_stop_event(&self) -> EventCode {
        if self.wires.is_some_and(|wires| wires.flags.contains(CommandFlags::FASTSTOP)) {
            EventCode::Wire
        } else if self.restarts {
            EventCode::UpdateRestart
        } else {
            EventCode::BusFlag
        }
    }

    /// Merges an image of the wires, and passes the results to the controller in order. Before an edge of a command wire, it
    /// passes an image in which the bus has released its flags.
    pub(crate) fn take_wires(
        &mut self,
        image: &OutputImage,
        moving: bool,
        mut to_controller: impl FnMut(&OutputImage),
    ) {
        let before = self.wires.replace(*image);
        let rising = before
            .map_or(CommandFlags::MOTIONS, |before| image.flags.difference(before.flags))
            .intersection(CommandFlags::MOTIONS);
        let effective = self.bus_flags();
        if image.flags.intersects(CommandFlags::MOTIONS) {
            self.masked.mask(self.bus.flags.intersection(MOVERS));
        }
        if let Some(before) = before
            && effective != self.bus_flags()
        {
            to_controller(&self.merged(before.flags));
        }
        if !rising.is_empty() && image.flags.intersects(CommandFlags::MOTIONS) && !moving {
            self.control_source = ControlSource::Wires;
            self.parameters = *image;
        }
        to_controller(&self.merged(image.flags));
    }

    /// Returns the rising motion and jog flags of a bus image that are refused, because a command wire is high or motions are
    /// locked.
    pub(crate) fn refused(&self, image: &OutputImage) -> CommandFlags {
        let wires = self.wires.unwrap_or_default();
        let refuses = wires.flags.intersects(CommandFlags::MOTIONS) || self.refuses;
        if refuses && !self.bus_is_new {
            image.flags.difference(self.bus.flags).intersection(MOVERS)
        } else {
            CommandFlags::empty()
        }
    }

    /// Merges an image written by the bus. Returns the image for the controller if the wires have settled.
    ///
    /// With a `recipe`, its values for the rising command replace the image's. Without a rising command, and while the
    /// fingers move, the last values stay, so that they never change during a motion.
    pub(crate) fn take_bus(
        &mut self,
        image: OutputImage,
        recipe: Option<(Recipe, ForceUnit)>,
        moving: bool,
    ) -> Option<OutputImage> {
        let refused = self.refused(&image);
        let before = core::mem::replace(&mut self.bus, image);
        let rising = image.flags.difference(before.flags);
        self.masked.mask(refused);
        self.masked.see(image.flags, core::mem::take(&mut self.bus_is_new));
        if image.flags.contains(CommandFlags::STOP_ACK) {
            self.masked.mask(rising.intersection(MOVERS));
        }
        let commanded = rising.intersection(MOVERS);
        let commands = self.bus_flags().intersects(commanded);
        if commands && !moving {
            self.control_source = ControlSource::Bus;
        }
        if self.control_source == ControlSource::Bus {
            match (recipe, commanded.lowest()) {
                (None, _) => self.parameters = image,
                (Some((recipe, unit)), Some(command)) if !moving => {
                    recipe.fill(&mut self.parameters, command, unit);
                }
                (Some(_), _) => {}
            }
        }
        self.wires.map(|wires| self.merged(wires.flags))
    }

    /// Handles a lost bus: all its flags except FASTSTOP are ignored.
    pub(crate) fn lose_bus(&mut self) -> Option<OutputImage> {
        self.bus_is_new = true;
        self.masked.mask(self.bus.flags.difference(CommandFlags::FASTSTOP));
        self.wires.map(|wires| self.merged(wires.flags))
    }

    fn bus_flags(&self) -> CommandFlags {
        self.masked.counting(self.bus.flags)
    }

    fn merged(&self, wires: CommandFlags) -> OutputImage {
        let mut flags = wires.union(self.bus_flags());
        flags.set(CommandFlags::FASTSTOP, self.restarts || flags.contains(CommandFlags::FASTSTOP));
        OutputImage { flags, user: self.bus.user, ..self.parameters }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    const MOVE: CommandFlags = CommandFlags::MOVE;
    const GRIP: CommandFlags = CommandFlags::GRIP;

    fn image(flags: CommandFlags, width: i16) -> OutputImage {
        OutputImage { flags, user: 0, width, speed: 50_00, force_limit: 40_00 }
    }

    /// Returns an arbiter with low wires and a bus that has written zeros once.
    fn idle() -> Arbiter {
        let mut arbiter = Arbiter::new();
        take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
        arbiter.take_bus(image(CommandFlags::empty(), 2), None, false);
        arbiter
    }

    /// Returns the images for the controller: the one in which the bus releases its flags, if any, and the last one.
    fn take_wires(
        arbiter: &mut Arbiter,
        image: OutputImage,
        moving: bool,
    ) -> (Option<OutputImage>, OutputImage) {
        let mut given = Vec::new();
        arbiter.take_wires(&image, moving, |image| given.push(*image));
        let last = given.pop().unwrap();
        assert!(given.len() <= 1);
        (given.pop(), last)
    }

    fn flags(merged: Option<OutputImage>) -> CommandFlags {
        merged.unwrap().flags
    }

    #[test]
    fn bus_commands_while_all_command_wires_are_low() {
        let mut arbiter = idle();
        assert_eq!(arbiter.take_bus(image(MOVE, 3), None, false), Some(image(MOVE, 3)));
        assert_eq!(arbiter.control_source(), ControlSource::Bus);
    }

    #[test]
    fn user_flags_are_from_the_bus_regardless_of_the_control_source() {
        let mut arbiter = idle();
        arbiter.take_bus(OutputImage { user: 0x20, ..image(CommandFlags::empty(), 3) }, None, false);
        let (_, merged) = take_wires(&mut arbiter, image(GRIP, 7), false);
        assert_eq!((merged.flags, merged.width, merged.user), (GRIP, 7, 0x20));
    }

    #[test]
    fn wire_commands_with_its_own_parameters() {
        let mut arbiter = idle();
        arbiter.take_bus(image(CommandFlags::empty(), 3), None, false);
        assert_eq!(take_wires(&mut arbiter, image(GRIP, 7), false), (None, image(GRIP, 7)));
        assert_eq!(arbiter.control_source(), ControlSource::Wires);
    }

    #[test]
    fn bus_edge_is_lost_while_a_command_wire_is_high() {
        let mut arbiter = idle();
        take_wires(&mut arbiter, image(GRIP, 7), false);
        assert_eq!(flags(arbiter.take_bus(image(MOVE, 3), None, false)), GRIP);
        let (_, merged) = take_wires(&mut arbiter, image(CommandFlags::empty(), 7), false);
        assert_eq!(merged.flags, CommandFlags::empty(), "MOVE is still 1 and still ignored");
        arbiter.take_bus(image(CommandFlags::empty(), 3), None, false);
        assert_eq!(flags(arbiter.take_bus(image(MOVE, 3), None, false)), MOVE);
    }

    #[test]
    fn wire_gives_an_edge_although_the_bus_has_the_same_flag_set() {
        let mut arbiter = idle();
        arbiter.take_bus(image(MOVE, 3), None, false);
        let (let_go, merged) = take_wires(&mut arbiter, image(MOVE, 7), false);
        assert_eq!(let_go, Some(image(CommandFlags::empty(), 3)), "the bus releases its flag first");
        assert_eq!(merged, image(MOVE, 7));
    }

    #[test]
    fn jog_of_the_bus_ends_when_a_command_wire_rises() {
        let mut arbiter = idle();
        arbiter.take_bus(image(CommandFlags::JOG_PLUS, 3), None, false);
        let (let_go, merged) = take_wires(&mut arbiter, image(GRIP, 7), true);
        assert_eq!(let_go, Some(image(CommandFlags::empty(), 3)));
        assert_eq!(merged, image(GRIP, 3), "the parameters do not change while the fingers move");
        let (_, merged) = take_wires(&mut arbiter, image(CommandFlags::empty(), 7), false);
        assert_eq!(merged.flags, CommandFlags::empty(), "the jog does not resume");
    }

    #[test]
    fn stop_and_fast_stop_of_either_side_always_take_effect() {
        for flag in [CommandFlags::STOP_ACK, CommandFlags::FASTSTOP] {
            let mut arbiter = idle();
            take_wires(&mut arbiter, image(GRIP, 7), false);
            assert_eq!(flags(arbiter.take_bus(image(flag, 2), None, true)), GRIP | flag);
            let mut arbiter = idle();
            arbiter.take_bus(image(MOVE, 2), None, false);
            let (_, merged) = take_wires(&mut arbiter, image(flag, 7), true);
            assert_eq!(merged.flags, MOVE | flag);
        }
    }

    #[test]
    fn first_image_of_the_bus_gives_no_edge_but_fast_stop() {
        for lost in [false, true] {
            let mut arbiter = idle();
            if lost {
                arbiter.lose_bus();
            } else {
                arbiter = Arbiter::new();
                take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
            }
            assert_eq!(
                flags(arbiter.take_bus(image(CommandFlags::all(), 3), None, false)),
                CommandFlags::FASTSTOP
            );
            assert_eq!(
                flags(arbiter.take_bus(image(MOVE, 3), None, false)),
                CommandFlags::empty(),
                "MOVE has not been 0"
            );
            arbiter.take_bus(image(CommandFlags::empty(), 3), None, false);
            assert_eq!(flags(arbiter.take_bus(image(MOVE, 3), None, false)), MOVE);
        }
    }

    #[test]
    fn motion_that_rises_beside_an_ignored_stop_flag_is_ignored() {
        let mut arbiter = Arbiter::new();
        take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
        arbiter.take_bus(image(CommandFlags::STOP_ACK, 3), None, false);
        let merged = arbiter.take_bus(image(CommandFlags::STOP_ACK | MOVE, 3), None, false);
        assert_eq!(flags(merged), CommandFlags::empty());
    }

    #[test]
    fn masked_jog_of_the_bus_is_ignored_until_both_flags_are_0() {
        const PLUS: CommandFlags = CommandFlags::JOG_PLUS;
        const MINUS: CommandFlags = CommandFlags::JOG_MINUS;
        let mut arbiter = Arbiter::new();
        take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
        let mut write = |flags_written| flags(arbiter.take_bus(image(flags_written, 3), None, false));
        for written in [MINUS, MINUS | PLUS, PLUS, MINUS, PLUS] {
            assert_eq!(write(written), CommandFlags::empty(), "{written:?} after JOG- in the first image");
        }
        write(CommandFlags::empty());
        assert_eq!(write(PLUS), PLUS);
    }

    #[test]
    fn stop_held_by_bus_blocks_motions_until_cleared_or_bus_is_lost() {
        let mut arbiter = Arbiter::new();
        take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
        assert!(!arbiter.bus_holds_stop());
        let merged = arbiter.take_bus(image(CommandFlags::STOP_ACK, 3), None, false);
        assert_eq!(flags(merged), CommandFlags::empty(), "no edge");
        assert!(arbiter.bus_holds_stop());
        arbiter.lose_bus();
        assert!(!arbiter.bus_holds_stop(), "the flags of a lost master are 0");
        arbiter.take_bus(image(CommandFlags::STOP_ACK, 3), None, false);
        arbiter.take_bus(image(CommandFlags::empty(), 3), None, false);
        assert!(!arbiter.bus_holds_stop());
    }

    #[test]
    fn lost_bus_releases_all_flags_but_fast_stop() {
        let mut arbiter = idle();
        arbiter.take_bus(image(MOVE | CommandFlags::JOG_PLUS | CommandFlags::FASTSTOP, 3), None, false);
        assert_eq!(flags(arbiter.lose_bus()), CommandFlags::FASTSTOP);
    }

    #[test]
    fn bus_parameters_change_nothing_while_wires_move_the_fingers() {
        let mut arbiter = idle();
        take_wires(&mut arbiter, image(GRIP, 7), false);
        take_wires(&mut arbiter, image(CommandFlags::empty(), 7), true);
        assert_eq!(arbiter.take_bus(image(CommandFlags::empty(), 3), None, true).unwrap().width, 7);
        let second = arbiter.take_bus(image(MOVE, 3), None, true).unwrap();
        assert_eq!((second.flags, second.width), (MOVE, 7), "the controller refuses the command");
        assert_eq!(arbiter.control_source(), ControlSource::Wires);
    }

    #[test]
    fn parameters_of_the_bus_follow_during_its_own_motion() {
        let mut arbiter = idle();
        arbiter.take_bus(image(MOVE, 3), None, false);
        assert_eq!(
            arbiter.take_bus(image(MOVE, 4), None, true),
            Some(image(MOVE, 4)),
            "the controller converts it to a FAST STOP"
        );
    }

    /// Returns width, speed and force limit for the controller.
    fn parameters(merged: Option<OutputImage>) -> (i16, u16, i16) {
        let OutputImage { width, speed, force_limit, .. } = merged.unwrap();
        (width, speed, force_limit)
    }

    #[test]
    fn recipe_replaces_bus_parameters_and_is_fixed_during_a_motion() {
        let recipe = Recipe { width: 11, speed: 12, force: 130, release_width: 14 };
        let other = Recipe { width: 21, speed: 22, force: 230, release_width: 24 };
        let by = |recipe| Some((recipe, ForceUnit::Hundredth));
        let mut arbiter = idle();
        let moved = arbiter.take_bus(image(MOVE, 3), by(recipe), false);
        assert_eq!(parameters(moved), (11, 12, 130));
        assert_eq!(arbiter.bus_image(), &image(MOVE, 3), "as written");
        let released = arbiter.take_bus(image(CommandFlags::empty(), 4), by(other), true);
        assert_eq!(parameters(released), (11, 12, 130), "no flag rises");
        let refused = arbiter.take_bus(image(CommandFlags::RELEASE, 4), by(other), true);
        assert_eq!(parameters(refused), (11, 12, 130), "the fingers move");
        let held = arbiter.take_bus(image(CommandFlags::RELEASE, 4), by(other), false);
        assert_eq!(parameters(held), (11, 12, 130), "RELEASE has not risen again");
        arbiter.take_bus(image(CommandFlags::empty(), 4), by(other), false);
        let opened = arbiter.take_bus(image(CommandFlags::RELEASE, 4), by(other), false);
        assert_eq!(parameters(opened), (24, 22, 230));
        arbiter.take_bus(image(CommandFlags::empty(), 4), by(other), false);
        let both =
            arbiter.take_bus(image(GRIP | CommandFlags::RELEASE, 4), Some((recipe, ForceUnit::Tenth)), false);
        assert_eq!(parameters(both), (11, 12, 13), "GRIP has priority");
        assert_eq!(parameters(arbiter.take_bus(image(GRIP, 4), None, false)), (4, 50_00, 40_00));
    }

    #[test]
    fn recipe_of_the_bus_has_no_effect_while_the_wires_command() {
        let recipe = Recipe { width: 11, speed: 12, force: 13, release_width: 14 };
        let mut arbiter = idle();
        take_wires(&mut arbiter, image(GRIP, 7), false);
        let merged = arbiter.take_bus(image(MOVE, 3), Some((recipe, ForceUnit::Hundredth)), false);
        assert_eq!(merged, Some(image(GRIP, 7)));
    }

    #[test]
    fn nothing_reaches_the_controller_before_the_wires_have_settled() {
        let mut arbiter = Arbiter::new();
        assert_eq!(arbiter.take_bus(image(CommandFlags::empty(), 3), None, false), None);
        assert_eq!(arbiter.take_bus(image(CommandFlags::FASTSTOP, 3), None, false), None);
        let (_, merged) = take_wires(&mut arbiter, image(CommandFlags::empty(), 1), false);
        assert_eq!(merged.flags, CommandFlags::FASTSTOP, "the image of the bus takes effect afterwards");
    }
}
