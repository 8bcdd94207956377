//! The rules of the fieldbus manual, one by one. Each test plays the session.

use super::*;
use std::vec;
use std::vec::Vec;
use wsg_protocol::DecodeError;
use wsg_protocol::reply::Reply;
use wsg_protocol::session::{Known, RequestError};
use wsg_protocol::types::{AutoUpdate, DeviceType, FirmwareVersion, SystemInfo, SystemLimits};

const LIMITS: SystemLimits = SystemLimits {
    stroke: 110.0,
    min_speed: 5.0,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

/// Parameters inside `LIMITS`.
const PARAMETERS: OutputImage =
    OutputImage { flags: CommandFlags::empty(), user: 0, width: 20_00, speed: 50_00, force_limit: 40_00 };

const GRIP: Command<'static> = Command::GripPart { width: 20.0, speed: 50.0 };
const MOVE: Command<'static> =
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width: 20.0, speed: 50.0 };
const FORCE: Command<'static> = Command::SetForceLimit { force: 40.0 };
const HOMING: Command<'static> = Command::Homing { direction: HomingDirection::Default };
const FLAGS: Command<'static> = Command::GetSystemState { update: AutoUpdate::once() };

const MOVING: SystemFlags = SystemFlags::REFERENCED.union(SystemFlags::MOVING);
const FAST_STOPPED: SystemFlags = SystemFlags::REFERENCED.union(SystemFlags::FAST_STOP);

struct Plc {
    controller: Controller,
    known: Known,
    image: OutputImage,
}

impl Plc {
    /// Returns a PLC with all flags 0 and parameters set, and a connected, referenced, idle gripper.
    fn ready() -> Self {
        let mut plc = Self::with_first_image(PARAMETERS);
        plc.connect();
        plc
    }

    fn with_first_image(image: OutputImage) -> Self {
        let mut plc = Self { controller: Controller::new(), known: Known::NOTHING, image };
        plc.write(|_| {});
        plc
    }

    /// Returns a PLC whose FASTSTOP is 1, after the gripper has confirmed the FAST STOP.
    fn fast_stopped() -> Self {
        let mut plc = Self::ready();
        plc.raise(CommandFlags::FASTSTOP);
        plc.confirm_fast_stop();
        plc
    }

    /// Returns a PLC whose GRIP is 1, after the gripper has gripped a part.
    fn holding() -> Self {
        let mut plc = Self::ready();
        plc.grip();
        plc.answer(CommandId::GripPart, Status::Success);
        plc
    }

    fn connect(&mut self) {
        self.connect_with(SystemFlags::REFERENCED);
    }

    fn connect_with(&mut self, flags: SystemFlags) {
        self.known = Known {
            info: Some(SystemInfo {
                device: DeviceType::Wsg50,
                hardware_revision: 1,
                firmware: FirmwareVersion::new(4, 0, 0, 0),
                serial_number: 1,
            }),
            limits: Some(LIMITS),
            flags: Some(flags),
            state: Some(GripperState::Idle),
            width: Some(50.0),
            speed: Some(0.0),
            force: Some(0.0),
            force_limit: None,
        };
        self.controller.handle(&Event::Connected, &self.known);
    }

    fn disconnect(&mut self) {
        self.known = Known::NOTHING;
        self.controller.handle(&Event::Disconnected, &self.known);
    }

    fn write(&mut self, change: impl FnOnce(&mut OutputImage)) -> Vec<Command<'static>> {
        change(&mut self.image);
        self.controller.set_output(&self.image, &self.known);
        self.commands()
    }

    /// Returns a PLC after a confirmed FAST STOP: FASTSTOP is 0 again, STOP/ACK is 1, and the acknowledgement has been sent.
    fn acknowledging_a_fast_stop() -> Self {
        let mut plc = Self::fast_stopped();
        plc.lower(CommandFlags::FASTSTOP);
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
        plc
    }

    fn raise(&mut self, flags: CommandFlags) -> Vec<Command<'static>> {
        self.write(|image| image.flags |= flags)
    }

    fn lower(&mut self, flags: CommandFlags) -> Vec<Command<'static>> {
        self.write(|image| image.flags &= !flags)
    }

    fn answer(&mut self, id: CommandId, status: Status) -> Vec<Command<'static>> {
        self.controller.handle(&Event::Answered(Reply::status_only(id, status)), &self.known);
        self.commands()
    }

    /// Reports that the answer to a Stop is late.
    fn stop_is_late(&mut self) -> Vec<Command<'static>> {
        self.controller.handle(&Event::Late(CommandId::Stop), &self.known);
        self.commands()
    }

    /// Reports the start of a motion: E_CMD_PENDING.
    fn begins(&mut self, id: CommandId) {
        self.controller.handle(&Event::Pending(id), &self.known);
    }

    fn report(&mut self, state: GripperState) {
        self.known.state = Some(state);
        self.controller.handle(&Event::Reported(Value::GetGripperState(state)), &self.known);
    }

    /// Answers a FAST STOP and the query of the flags that follows it.
    fn confirm_fast_stop(&mut self) {
        assert_eq!(self.answer(CommandId::FastStop, Status::Success), [FLAGS]);
        self.answer_flags(FAST_STOPPED);
    }

    /// Answers an acknowledgement with success.
    fn acknowledged(&mut self) {
        self.known.flags = Some(SystemFlags::REFERENCED);
        assert_eq!(self.answer(CommandId::Acknowledge, Status::Success), []);
    }

    fn answer_flags(&mut self, flags: SystemFlags) -> Vec<Command<'static>> {
        self.known.flags = Some(flags);
        let reply = Reply::success(Value::GetSystemState(flags));
        self.controller.handle(&Event::Answered(reply), &self.known);
        self.commands()
    }

    fn report_flags(&mut self, flags: SystemFlags) {
        self.known.flags = Some(flags);
        self.controller.handle(&Event::Reported(Value::GetSystemState(flags)), &self.known);
    }

    fn is_fast_stopped(&self) -> bool {
        self.controller.input(&self.known).system.contains(SystemFlags::FAST_STOP)
    }

    fn commands(&mut self) -> Vec<Command<'static>> {
        let mut commands = vec![];
        while let Some(command) = self.controller.poll_command() {
            commands.push(command);
            assert!(commands.len() < 10, "commands without end: {commands:?}");
        }
        commands
    }

    fn shows(&self) -> (GripperFlags, Status) {
        let input = self.controller.input(&self.known);
        (input.state, input.status)
    }

    fn grip(&mut self) {
        assert_eq!(self.raise(CommandFlags::GRIP), [FORCE]);
        assert_eq!(self.answer(CommandId::SetForceLimit, Status::Success), [GRIP]);
    }
}

#[test]
fn grip_sets_the_force_limit_and_then_grips() {
    let mut plc = Plc::ready();
    plc.grip();
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending));
    assert_eq!(plc.answer(CommandId::GripPart, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::Success));
}

#[test]
fn error_that_the_gripper_reports_replaces_the_last_result() {
    let mut plc = Plc::holding();
    plc.report(GripperState::Error);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Success));
}

#[test]
fn grip_is_not_sent_when_the_force_limit_was_not_taken() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::CmdFormatError), []);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::CmdFormatError));
}

#[test]
fn only_the_answer_to_its_own_force_limit_lets_a_grip_begin() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
    assert_eq!(plc.answer(CommandId::TareForceSensor, Status::Success), [], "sent by another party");
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [GRIP]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [], "the grip has started");
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending));

    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [], "MOVE needs no force limit");
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::CmdFormatError), []);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::CmdPending), "and continues");
}

#[test]
fn failed_command_of_another_party_does_not_affect_a_motion() {
    for (flag, id) in [
        (CommandFlags::MOVE, CommandId::SetForceLimit),
        (CommandFlags::MOVE, CommandId::TareForceSensor),
        (CommandFlags::GRIP, CommandId::TareForceSensor),
    ] {
        let mut plc = Plc::ready();
        plc.raise(flag);
        let before = plc.shows();
        plc.controller.handle(&Event::Unanswered(id), &plc.known);
        plc.controller.handle(&Event::Withdrawn(id), &plc.known);
        assert_eq!(plc.shows(), before, "{flag:?} {id}");
    }
}

#[test]
fn unanswered_stop_or_acknowledgement_shows_e_timeout() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.controller.handle(&Event::Unanswered(CommandId::TareForceSensor), &plc.known);
    assert_eq!(plc.shows().1, Status::CmdPending, "sent by another party");
    plc.controller.handle(&Event::Unanswered(CommandId::Stop), &plc.known);
    assert_eq!(plc.shows().1, Status::Timeout);

    let mut plc = Plc::ready();
    plc.report_flags(FAST_STOPPED);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
    plc.controller.handle(&Event::Unanswered(CommandId::Acknowledge), &plc.known);
    assert_eq!(plc.shows().1, Status::Timeout);
}

#[test]
fn grip_without_a_part_shows_no_part_and_e_cmd_failed() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.answer(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(plc.shows(), (GripperFlags::NO_PART, Status::CmdFailed));
}

#[test]
fn part_that_goes_while_held_is_shown_lost() {
    let mut plc = Plc::holding();
    plc.report(GripperState::PartLost);
    assert_eq!(plc.shows(), (GripperFlags::PART_LOST, Status::Success));
}

#[test]
fn move_release_and_homing_go_through_their_states() {
    for (flag, command, state) in [
        (CommandFlags::MOVE, MOVE, GripperFlags::POSITIONING),
        (CommandFlags::RELEASE, Command::ReleasePart { width: 20.0, speed: 50.0 }, GripperFlags::RELEASING),
        (CommandFlags::HOMING, HOMING, GripperFlags::POSITIONING),
    ] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(flag), [command]);
        assert_eq!(plc.shows(), (state, Status::CmdPending));
        plc.answer(command.id(), Status::Success);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
        assert_eq!(plc.lower(flag), [], "a falling edge gives no command");
        assert_eq!(plc.raise(flag), [command], "the next rising edge does");
    }
}

#[test]
fn motion_that_fails_shows_error_until_the_next_command() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::AxisBlocked));
    assert_eq!(plc.raise(CommandFlags::HOMING), [HOMING]);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::CmdPending));
}

#[test]
fn stop_after_a_failed_motion_acknowledges_it_too() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop, Command::ACKNOWLEDGE]);
    plc.answer(CommandId::Stop, Status::Success);
    plc.answer(CommandId::Acknowledge, Status::Success);
    plc.report(GripperState::Idle);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    plc.lower(CommandFlags::STOP_ACK);
    // An error known only from the gripper's report is acknowledged too; without an error, only a Stop is sent.
    plc.report(GripperState::Error);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop, Command::ACKNOWLEDGE]);
    plc.report(GripperState::Idle);
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
}

#[test]
fn flags_that_are_set_at_power_up_start_nothing() {
    for flag in CommandFlags::MOTIONS.iter().chain([CommandFlags::STOP_ACK]) {
        let mut plc = Plc::with_first_image(OutputImage { flags: flag, ..PARAMETERS });
        plc.connect();
        assert_eq!(plc.write(|_| {}), [], "{flag:?}");
    }
}

#[test]
fn of_several_edges_only_the_lowest_runs() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::GRIP | CommandFlags::MOVE | CommandFlags::HOMING), [MOVE]);
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.commands(), [], "the others are lost, not kept");
}

#[test]
fn motion_is_ignored_while_stop_is_set_and_its_edge_is_lost() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::Success);
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.lower(CommandFlags::STOP_ACK), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn stop_beats_a_motion_that_rises_with_it() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK | CommandFlags::MOVE), [Command::Stop]);
}

#[test]
fn stop_while_holding_ends_in_idle() {
    let mut plc = Plc::holding();
    plc.report(GripperState::Holding);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::Success);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn stop_in_mid_travel_shows_success_and_not_the_aborted_motion() {
    for stop_answers_first in [true, false] {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::MOVE);
        plc.raise(CommandFlags::STOP_ACK);
        let (stop, motion) =
            ((CommandId::Stop, Status::Success), (CommandId::PrePosition, Status::CmdAborted));
        let order = if stop_answers_first { [stop, motion] } else { [motion, stop] };
        for (id, status) in order {
            plc.answer(id, status);
        }
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    }
}

#[test]
fn grip_stopped_while_setting_its_force_limit_never_starts() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), []);
}

#[test]
fn fast_stop_shows_idle_and_only_an_acknowledgement_ends_it() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    plc.confirm_fast_stop();
    plc.report(GripperState::Error);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert!(plc.is_fast_stopped());

    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [], "FASTSTOP is still 1");
    assert_eq!(plc.lower(CommandFlags::FASTSTOP), [], "STOP/ACK is 1 but does not rise");
    plc.lower(CommandFlags::STOP_ACK | CommandFlags::MOVE);
    assert_eq!(plc.raise(CommandFlags::MOVE), [], "motion is refused");
    assert_eq!(plc.shows().1, Status::AccessDenied);
    plc.lower(CommandFlags::MOVE);

    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
    plc.answer(CommandId::Acknowledge, Status::Success);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success), "before the state itself is reported");
    plc.report(GripperState::Idle);
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
}

#[test]
fn fast_stop_at_power_up_locks_motion_until_it_is_acknowledged() {
    let mut plc = Plc { controller: Controller::new(), known: Known::NOTHING, image: PARAMETERS };
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop], "the level counts, without an edge");
    plc.connect();
    plc.confirm_fast_stop();
    for flag in CommandFlags::MOTIONS.iter() {
        assert_eq!(plc.raise(flag), []);
        plc.lower(flag);
    }
    assert_eq!(plc.lower(CommandFlags::FASTSTOP), []);
    assert_eq!(plc.raise(CommandFlags::HOMING), [], "high again, but not acknowledged");
    plc.lower(CommandFlags::HOMING);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
}

/// Fieldbus, 6.6.
#[test]
fn each_loss_of_its_flag_while_faststop_is_1_resends_fast_stop() {
    let mut plc = Plc::fast_stopped();
    for times in 0..3 {
        plc.report_flags(SystemFlags::REFERENCED);
        assert!(plc.is_fast_stopped());
        assert_eq!(plc.commands(), [Command::FastStop], "acknowledged by a third party, {times}");
        assert_eq!(plc.raise(CommandFlags::MOVE), [], "{times}");
        plc.lower(CommandFlags::MOVE);
        plc.confirm_fast_stop();
    }
    let causes: Vec<_> = incidents(&mut plc).iter().map(|incident| incident.cause).collect();
    assert_eq!(causes, [Cause::Flag; 4]);
    // The gripper restarts within the link's time-out.
    plc.report_flags(SystemFlags::empty());
    assert_eq!(plc.commands(), [Command::FastStop]);
}

/// Fieldbus, 6.6.
#[test]
fn faststop_1_resends_a_lost_fast_stop_during_acknowledgement() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [], "the acknowledgement is still open");
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.commands(), [Command::FastStop]);
}

#[test]
fn repeated_fast_stop_request_is_sent_after_the_first_answer() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::FASTSTOP);
    // Meanwhile, a third party may acknowledge at the gripper.
    plc.lower(CommandFlags::FASTSTOP);
    plc.raise(CommandFlags::FASTSTOP);
    plc.lower(CommandFlags::FASTSTOP);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [Command::FastStop]);
    plc.report_flags(SystemFlags::REFERENCED);
    assert!(plc.is_fast_stopped());
    plc.confirm_fast_stop();
}

/// Fieldbus, 6.6.
#[test]
fn held_part_is_not_shown_again_after_a_fast_stop() {
    for own in [true, false] {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::GRIP);
        plc.answer(CommandId::SetForceLimit, Status::Success);
        plc.answer(CommandId::GripPart, Status::Success);
        assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::Success), "before the report of the state");
        if own {
            plc.raise(CommandFlags::FASTSTOP);
            plc.confirm_fast_stop();
            plc.lower(CommandFlags::FASTSTOP);
        } else {
            plc.report_flags(FAST_STOPPED);
        }
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(
            plc.shows().0,
            GripperFlags::IDLE,
            "acknowledged by a third party, state not reported yet"
        );
    }
}

#[test]
fn third_party_acknowledgement_with_faststop_0_unlocks_motion() {
    let mut plc = Plc::fast_stopped();
    plc.lower(CommandFlags::FASTSTOP);
    assert!(plc.is_fast_stopped());

    plc.report_flags(SystemFlags::REFERENCED);

    assert_eq!(plc.commands(), []);
    assert!(!plc.is_fast_stopped());
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
}

/// An outdated report, replayed or reordered on the line, looks like an acknowledgement.
#[test]
fn fast_stop_reappears_after_outdated_report_and_locks_motion() {
    let mut plc = Plc::fast_stopped();
    plc.lower(CommandFlags::FASTSTOP);
    plc.report_flags(SystemFlags::REFERENCED);
    assert!(!plc.is_fast_stopped());
    plc.report_flags(FAST_STOPPED);
    assert!(plc.is_fast_stopped());
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
}

#[test]
fn unconfirmed_fast_stop_cannot_be_acknowledged() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::FASTSTOP);
    plc.lower(CommandFlags::FASTSTOP);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), []);
    assert_eq!(plc.shows().1, Status::AccessDenied);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [FLAGS]);
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [], "its flags do not show it yet");
    plc.answer_flags(FAST_STOPPED);
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
}

#[test]
fn fast_stop_is_sent_again_if_the_gripper_flags_do_not_show_it() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [FLAGS]);
    assert_eq!(plc.answer_flags(MOVING), [Command::FastStop]);
    plc.confirm_fast_stop();
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn fast_stop_answered_before_connecting_is_confirmed_by_flags() {
    let mut plc = Plc { controller: Controller::new(), known: Known::NOTHING, image: PARAMETERS };
    plc.raise(CommandFlags::FASTSTOP);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [FLAGS]);
    plc.controller.refused(CommandId::GetSystemState, RequestError::NotConnected, &plc.known);
    plc.connect_with(FAST_STOPPED);
    plc.lower(CommandFlags::FASTSTOP);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
}

#[test]
fn answer_to_an_earlier_acknowledgement_never_ends_a_fast_stop() {
    for answers in
        [[CommandId::FastStop, CommandId::Acknowledge], [CommandId::Acknowledge, CommandId::FastStop]]
    {
        let mut plc = Plc::fast_stopped();
        plc.lower(CommandFlags::FASTSTOP);
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
        plc.lower(CommandFlags::STOP_ACK);
        assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
        let [first, second] = answers.map(|id| plc.answer(id, Status::Success));
        if answers[0] == CommandId::FastStop {
            // The acknowledgement may have undone the answered FAST STOP, so it is sent once more.
            assert_eq!((first, second), (vec![], vec![Command::FastStop]));
            assert_eq!(plc.answer(CommandId::FastStop, Status::Success), [FLAGS]);
        }
        plc.answer_flags(FAST_STOPPED);
        plc.lower(CommandFlags::FASTSTOP);
        assert_eq!(plc.raise(CommandFlags::MOVE), [], "{answers:?}");
        assert!(plc.is_fast_stopped());
        plc.lower(CommandFlags::MOVE);
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
        plc.acknowledged();
        plc.lower(CommandFlags::STOP_ACK);
        assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
    }
}

#[test]
fn refused_fast_stop_or_acknowledgement_changes_nothing() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::FASTSTOP);
    assert_eq!(plc.answer(CommandId::FastStop, Status::AccessDenied), []);
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.answer(CommandId::Acknowledge, Status::AccessDenied);
    assert!(plc.controller.asks_fast_stop());
}

#[test]
fn lost_fast_stop_is_resent_only_after_acknowledge_is_answered() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), []);
    plc.lower(CommandFlags::FASTSTOP);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.commands(), []);
    assert_eq!(plc.answer(CommandId::Acknowledge, Status::Success), [Command::FastStop]);
}

#[test]
fn unanswered_acknowledge_is_repeatable_and_resends_fast_stop() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.controller.handle(&Event::Unanswered(CommandId::Acknowledge), &plc.known);
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
    plc.disconnect();
    assert_eq!(plc.commands(), [Command::FastStop], "whether it was acknowledged is not known");
}

#[test]
fn cleared_flag_ends_fast_stop_even_after_a_refused_acknowledge() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.report_flags(SystemFlags::REFERENCED);
    assert!(plc.is_fast_stopped(), "not answered yet");
    plc.answer(CommandId::Acknowledge, Status::AccessDenied);
    plc.report_flags(FAST_STOPPED);
    assert!(plc.is_fast_stopped());
    plc.report_flags(SystemFlags::REFERENCED);
    assert!(!plc.is_fast_stopped());
    plc.lower(CommandFlags::STOP_ACK);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
}

#[test]
fn late_stop_is_a_fast_stop_unless_rest_followed_the_motion() {
    for begins in [false, true] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
        // This report may have been sent before the motion.
        plc.report_flags(SystemFlags::REFERENCED);
        if begins {
            plc.begins(CommandId::PrePosition);
        }
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
        assert_eq!(plc.stop_is_late(), [Command::FastStop], "started: {begins}");
    }
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.begins(CommandId::PrePosition);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.stop_is_late(), []);
}

#[test]
fn late_stop_is_no_fast_stop_if_the_motion_was_never_sent() {
    let mut plc = Plc::ready();
    plc.image.flags |= CommandFlags::MOVE;
    plc.controller.set_output(&plc.image, &plc.known);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    assert_eq!(plc.stop_is_late(), []);
}

/// Lists the events that prove the fingers at rest after a motion. Without one, a late Stop becomes a FAST STOP.
#[test]
fn only_a_report_sent_after_a_motion_proves_the_fingers_at_rest() {
    const MOTION: CommandId = CommandId::PrePosition;
    const STANDS: SystemFlags = SystemFlags::REFERENCED;
    let flags = || Value::GetSystemState(STANDS);
    let state = || Value::GetGripperState(GripperState::Idle);
    let answered = |status| Event::Answered(Reply::status_only(MOTION, status));
    let force = CommandId::SetForceLimit;
    let cases: Vec<(&str, Vec<Event<'_>>, bool)> = vec![
        ("given", vec![], true),
        ("given, and reported", vec![Event::Reported(flags())], true),
        ("given, and queried", vec![Event::Answered(Reply::success(flags()))], true),
        ("begun", vec![Event::Pending(MOTION)], true),
        ("begun, and reported", vec![Event::Pending(MOTION), Event::Reported(flags())], false),
        ("begun, and its state reported", vec![Event::Pending(MOTION), Event::Reported(state())], false),
        ("begun, and queried", vec![Event::Pending(MOTION), Event::Answered(Reply::success(flags()))], false),
        (
            "begun, and its state queried",
            vec![Event::Pending(MOTION), Event::Answered(Reply::success(state()))],
            false,
        ),
        (
            "begun, and the width reported",
            vec![Event::Pending(MOTION), Event::Reported(Value::GetOpeningWidth(20.0))],
            true,
        ),
        (
            "begun, and something else answered",
            vec![Event::Pending(MOTION), Event::Answered(Reply::status_only(force, Status::Success))],
            true,
        ),
        ("begun, and something else withdrawn", vec![Event::Pending(MOTION), Event::Withdrawn(force)], true),
        ("answered", vec![answered(Status::CmdAborted)], false),
        ("never sent", vec![Event::Withdrawn(MOTION)], false),
        (
            "without an outcome, but reported at rest",
            vec![Event::Pending(MOTION), Event::Reported(flags()), Event::Unanswered(MOTION)],
            false,
        ),
        ("without an outcome, and not reported", vec![Event::Unanswered(MOTION)], true),
        ("reconnected", vec![Event::Pending(MOTION), Event::Disconnected, Event::Connected], false),
    ];
    for (what, events, is_fast_stop) in cases {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
        plc.known.flags = Some(STANDS);
        for event in events {
            plc.controller.handle(&event, &plc.known);
        }
        plc.commands();
        assert_eq!(plc.stop_is_late() == [Command::FastStop], is_fast_stop, "{what}");
    }
}

#[test]
fn switching_a_finger_supply_is_no_motion() {
    let mut plc = Plc::ready();
    let supply = CommandId::Finger1Power;
    plc.controller.handle(&Event::Pending(supply), &plc.known);
    plc.controller.handle(&Event::Unanswered(supply), &plc.known);
    assert_eq!(plc.stop_is_late(), []);
}

#[test]
fn acknowledgement_sent_before_a_disconnect_is_not_awaited() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    plc.lower(CommandFlags::STOP_ACK);
    plc.disconnect();
    assert_eq!(plc.commands(), [Command::FastStop], "the gripper may have been restarted");
    plc.connect();
    plc.confirm_fast_stop();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
    plc.acknowledged();
    assert!(!plc.is_fast_stopped());
}

#[test]
fn session_refusal_leaves_only_an_earlier_motion_in_doubt() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.controller.refused(CommandId::PrePosition, RequestError::MotionRunning, &plc.known);
    assert_eq!(plc.stop_is_late(), [Command::FastStop], "an earlier one may be the reason");

    let mut plc = Plc::ready();
    plc.controller.refused(CommandId::SetForceLimit, RequestError::QueueFull, &plc.known);
    assert_eq!(plc.stop_is_late(), [], "there is no motion");
}

#[test]
fn fast_stop_stays_until_both_acknowledgements_are_answered() {
    let mut plc = Plc::fast_stopped();
    plc.lower(CommandFlags::FASTSTOP);
    for _ in 0..2 {
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
        plc.lower(CommandFlags::STOP_ACK);
    }
    plc.controller.handle(&Event::Withdrawn(CommandId::Acknowledge), &plc.known);
    plc.report_flags(SystemFlags::REFERENCED);
    assert!(plc.is_fast_stopped());
    plc.answer(CommandId::Acknowledge, Status::Success);
    assert!(!plc.is_fast_stopped());
}

#[test]
fn fast_stop_is_repeated_to_a_gripper_that_returns() {
    let mut plc = Plc::fast_stopped();
    plc.disconnect();
    assert_eq!(plc.commands(), [Command::FastStop], "the session keeps it until the gripper answers");
    plc.connect();
    plc.lower(CommandFlags::FASTSTOP);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [], "not confirmed yet");
}

#[test]
fn grippers_own_fast_stop_is_acknowledged_like_any_other() {
    let mut plc = Plc::ready();
    plc.report_flags(FAST_STOPPED);
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
}

#[test]
fn parameter_that_changes_while_the_fingers_move_is_a_fast_stop() {
    let changes: [fn(&mut OutputImage); 3] =
        [|image| image.width += 1, |image| image.speed += 1, |image| image.force_limit += 1];
    for change in changes {
        let mut plc = Plc::ready();
        assert_eq!(plc.write(change), [], "the fingers are at rest");
        plc.raise(CommandFlags::MOVE);
        assert_eq!(plc.write(change), [Command::FastStop]);
    }
    let mut plc = Plc::ready();
    plc.report_flags(MOVING);
    assert_eq!(plc.write(changes[0]), [Command::FastStop], "moved by another party");
}

#[test]
fn user_flags_may_change_while_the_fingers_move() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    assert_eq!(plc.write(|image| image.user = 0xFF), []);
}

#[test]
fn parameter_outside_the_limits_with_a_motion_is_a_fast_stop() {
    let changes: [fn(&mut OutputImage); 5] = [
        |image| image.speed = 4_99,
        |image| image.speed = 420_01,
        |image| image.force_limit = 4_99,
        |image| image.force_limit = 80_01,
        |image| image.force_limit = -1,
    ];
    for change in changes {
        for flag in [CommandFlags::MOVE, CommandFlags::GRIP, CommandFlags::RELEASE] {
            let mut plc = Plc::ready();
            assert_eq!(plc.write(change), [], "the value alone does nothing");
            assert_eq!(plc.raise(flag), [Command::FastStop], "{:?} {flag:?}", plc.image);
        }
        let mut plc = Plc::ready();
        plc.write(change);
        assert_eq!(plc.raise(CommandFlags::HOMING), [HOMING], "homing has no parameters");
    }
}

#[test]
fn parameters_at_the_limits_are_inside() {
    for (speed, force_limit) in [(5_00, 5_00), (420_00, 80_00)] {
        let mut plc = Plc::ready();
        plc.write(|image| (image.speed, image.force_limit) = (speed, force_limit));
        assert_eq!(plc.raise(CommandFlags::MOVE).len(), 1);
        assert_ne!(plc.shows().1, Status::Success);
        assert!(!plc.is_fast_stopped());
    }
}

#[test]
fn overdrive_mode_allows_forces_up_to_the_overdrive_limit() {
    let mut plc = Plc::ready();
    plc.report_flags(SystemFlags::REFERENCED | SystemFlags::OVERDRIVE_MODE);
    plc.write(|image| image.force_limit = 120_00);
    assert_eq!(plc.raise(CommandFlags::GRIP), [Command::SetForceLimit { force: 120.0 }]);
}

#[test]
fn force_of_a_wsg_70_is_in_tenths_of_a_newton() {
    let mut plc = Plc::ready();
    plc.known.info = plc.known.info.map(|info| SystemInfo { device: DeviceType::Wsg70, ..info });
    plc.known.limits = Some(SystemLimits { nominal_force: 400.0, ..LIMITS });
    plc.known.force = Some(305.0);
    plc.write(|image| image.force_limit = 3050);
    assert_eq!(plc.raise(CommandFlags::GRIP), [Command::SetForceLimit { force: 305.0 }]);
    assert_eq!(plc.controller.input(&plc.known).force, 3050);
}

#[test]
fn second_motion_is_refused_and_the_running_one_still_ends() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    assert_eq!(plc.raise(CommandFlags::RELEASE), []);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::AlreadyRunning));
    assert_eq!(plc.lower(CommandFlags::MOVE), []);
    assert_eq!(plc.shows().1, Status::AlreadyRunning, "as long as the flag is 1");
    assert_eq!(plc.lower(CommandFlags::RELEASE), []);
    assert_eq!(plc.shows().1, Status::CmdPending, "the first runs");
    plc.raise(CommandFlags::RELEASE);
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success), "regardless of the flags");
}

#[test]
fn motion_withheld_by_the_caller_is_refused_as_one_of_the_plc() {
    let mut plc = Plc::ready();
    plc.controller.refuse(CommandFlags::MOVE);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));

    plc.raise(CommandFlags::MOVE);
    assert!(!plc.controller.has_refused_meanwhile());
    for _ in 0..2 {
        plc.controller.refuse(CommandFlags::RELEASE);
        assert_eq!(plc.shows().1, Status::AlreadyRunning);
    }
    plc.lower(CommandFlags::RELEASE);
    assert_eq!(plc.shows().1, Status::CmdPending);
    assert!(plc.controller.has_refused_meanwhile(), "although its flag has fallen");
    plc.answer(CommandId::PrePosition, Status::Success);
    assert!(!plc.controller.has_refused_meanwhile());
}

#[test]
fn motion_is_refused_for_good_if_the_fingers_already_move() {
    let mut plc = Plc::ready();
    plc.report_flags(MOVING);
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.lower(CommandFlags::MOVE), []);
    assert_eq!(plc.shows().1, Status::AlreadyRunning);
}

#[test]
fn move_is_refused_while_a_part_is_held() {
    let mut plc = Plc::holding();
    plc.lower(CommandFlags::GRIP);
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::AccessDenied));
}

#[test]
fn move_requires_gstate_idle_and_other_motions_any_rest_state() {
    let states = [
        (GripperState::NoPart, GripperFlags::NO_PART),
        (GripperState::PartLost, GripperFlags::PART_LOST),
        (GripperState::Error, GripperFlags::ERROR),
    ];
    for (state, shown) in states {
        let mut plc = Plc::ready();
        plc.report(state);
        assert_eq!(plc.raise(CommandFlags::MOVE), []);
        assert_eq!(plc.shows(), (shown, Status::AccessDenied));
        assert_eq!(incidents(&mut plc), incident(Cause::NotIdle, None, 0));
        plc.lower(CommandFlags::MOVE);
        // STOP/ACK leaves each of these states.
        plc.raise(CommandFlags::STOP_ACK);
        plc.answer(CommandId::Stop, Status::Success);
        plc.answer(CommandId::Acknowledge, Status::Success);
        plc.report(GripperState::Idle);
        plc.lower(CommandFlags::STOP_ACK);
        assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);

        for (flag, sent) in [
            (CommandFlags::GRIP, CommandId::SetForceLimit),
            (CommandFlags::RELEASE, CommandId::ReleasePart),
            (CommandFlags::HOMING, CommandId::Homing),
        ] {
            let mut plc = Plc::ready();
            plc.report(state);
            assert_eq!(plc.raise(flag)[0].id(), sent, "{state}");
        }
    }
}

#[test]
fn motion_without_a_connection_is_refused_and_not_kept() {
    let mut plc = Plc::ready();
    plc.disconnect();
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError));
    plc.connect();
    assert_eq!(plc.write(|_| {}), []);
}

#[test]
fn disconnected_gripper_shows_error_regardless_of_last_state() {
    let plc = Plc::with_first_image(PARAMETERS);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError), "never connected");

    let mut plc = Plc::ready();
    plc.disconnect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError), "at rest");
    plc.connect();
    assert_eq!(plc.shows().1, Status::Success, "again");

    let mut plc = Plc::holding();
    plc.report(GripperState::Holding);
    plc.disconnect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError), "while it held a part");

    let mut plc = Plc::ready();
    plc.raise(CommandFlags::FASTSTOP);
    plc.disconnect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError));
    assert!(plc.is_fast_stopped(), "still in effect");
}

#[test]
fn motion_whose_outcome_is_not_known_shows_error_and_e_timeout() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.controller.handle(&Event::Unanswered(CommandId::GripPart), &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout));
    plc.disconnect();
    plc.connect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout), "still not known after the reconnect");
}

#[test]
fn motion_that_is_given_up_with_the_connection_is_no_fast_stop() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.report_flags(MOVING);
    plc.known = Known::NOTHING;
    plc.controller.handle(&Event::Unanswered(CommandId::GripPart), &plc.known);
    plc.disconnect();
    assert_eq!(plc.commands(), []);
    plc.connect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout));
}

#[test]
fn held_part_shows_even_if_the_grip_result_was_lost() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.report(GripperState::Holding);
    plc.controller.handle(&Event::Unanswered(CommandId::GripPart), &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::Timeout));
}

#[test]
fn command_that_the_session_refuses_shows_why() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.controller.refused(CommandId::PrePosition, RequestError::MotionRunning, &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::AlreadyRunning));
}

#[test]
fn measured_values_stand_in_the_input_image() {
    let mut plc = Plc::ready();
    (plc.known.width, plc.known.force) = (Some(12.2), Some(4.05));
    let input = plc.controller.input(&plc.known);
    assert_eq!((input.width, input.force), (1220, 405));
}

#[test]
fn success_shows_once_the_fingers_are_reported_to_stand() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.report(GripperState::Gripping);
    plc.report_flags(MOVING);
    plc.answer(CommandId::GripPart, Status::Success);
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending), "not yet");
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::Success), "although the state's report is older");
    plc.lower(CommandFlags::GRIP);
    let commands = plc.write(|image| {
        image.width = 40_00;
        image.flags = CommandFlags::RELEASE;
    });
    assert_eq!(commands, [Command::ReleasePart { width: 40.0, speed: 50.0 }], "new parameters, no FAST STOP");
}

#[test]
fn failure_shows_at_once_even_if_the_fingers_still_move() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.report_flags(MOVING);
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::AxisBlocked));
}

#[test]
fn success_that_is_held_back_is_not_lost_with_the_connection() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.report_flags(MOVING);
    plc.answer(CommandId::PrePosition, Status::Success);
    plc.disconnect();
    plc.connect();
    assert_eq!(plc.shows().1, Status::Success);
}

#[test]
fn fast_stop_wins_over_a_success_that_is_held_back() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.report_flags(MOVING);
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    plc.report_flags(FAST_STOPPED);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::CmdPending));
}

mod gstate;
mod jog;

#[test]
fn grip_is_sent_only_after_the_answer_to_its_own_force_limit() {
    for refused in [true, false] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
        assert_eq!(plc.write(|image| image.flags = CommandFlags::STOP_ACK), [Command::Stop]);
        plc.answer(CommandId::Stop, Status::Success);
        plc.write(|image| (image.flags, image.force_limit) = (CommandFlags::empty(), 10_00));
        assert_eq!(plc.raise(CommandFlags::GRIP), [Command::SetForceLimit { force: 10.0 }]);
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [], "40 N: the earlier one");
        if refused {
            assert_eq!(plc.answer(CommandId::SetForceLimit, Status::RangeError), []);
            assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::RangeError));
        } else {
            assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [GRIP]);
        }
    }
}

#[test]
fn grip_is_sent_at_once_if_its_force_limit_is_known_to_be_set() {
    let mut plc = Plc::ready();
    plc.known.force_limit = Some(40.0);
    assert_eq!(plc.raise(CommandFlags::GRIP), [GRIP]);
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending));
    plc.begins(CommandId::GripPart);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::CmdFormatError), [], "sent by another party");
    assert_eq!(plc.answer(CommandId::GripPart, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::Success));

    for other in [None, Some(39.99), Some(40.01)] {
        let mut plc = Plc::ready();
        plc.known.force_limit = other;
        assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE], "{other:?}");
    }
}

#[test]
fn jog_begins_at_once_if_its_force_limit_is_known_to_be_set() {
    let mut plc = Plc::ready();
    plc.known.force_limit = Some(40.0);
    let jog = Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width: 110.0, speed: 50.0 };
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [jog]);
    plc.begins(CommandId::PrePosition);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop]);
    assert_eq!(plc.answer(CommandId::PrePosition, Status::CmdAborted), []);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn force_limit_is_set_again_if_a_command_is_still_queued() {
    let mut plc = Plc::ready();
    plc.known.force_limit = Some(40.0);
    plc.image.flags = CommandFlags::STOP_ACK;
    plc.controller.set_output(&plc.image, &plc.known);
    plc.image.flags = CommandFlags::empty();
    plc.controller.set_output(&plc.image, &plc.known);
    assert_eq!(plc.raise(CommandFlags::GRIP), [Command::Stop, FORCE]);
}

#[test]
fn withdrawn_earlier_force_limit_does_not_end_a_later_grip() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::GRIP);
    plc.write(|image| image.flags = CommandFlags::STOP_ACK);
    plc.write(|image| image.flags = CommandFlags::empty());
    assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
    plc.controller.handle(&Event::Withdrawn(CommandId::SetForceLimit), &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending));
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [GRIP]);
}

#[test]
fn force_limit_that_was_never_handed_over_is_not_waited_for() {
    let mut plc = Plc::ready();
    plc.image.flags |= CommandFlags::GRIP;
    plc.controller.set_output(&plc.image, &plc.known);
    assert_eq!(plc.write(|image| image.flags = CommandFlags::STOP_ACK), [Command::Stop], "in the same turn");
    plc.write(|image| image.flags = CommandFlags::empty());
    plc.grip();
}

#[test]
fn late_stop_becomes_a_fast_stop_unless_the_fingers_stand() {
    for (flags, becomes) in [(MOVING, vec![Command::FastStop]), (SystemFlags::REFERENCED, vec![])] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
        plc.report_flags(flags);
        assert_eq!(plc.stop_is_late(), becomes);
    }
}

/// Returns a controller after a reset, with this knowledge of a gripper that is not connected yet.
fn after_a_reset(flags: SystemFlags, state: GripperState) -> Plc {
    let mut plc = Plc::with_first_image(PARAMETERS);
    plc.known = Known { flags: Some(flags), state: Some(state), ..Known::NOTHING };
    plc.controller.adopt_known(&plc.known);
    plc
}

#[test]
fn gripper_moving_at_first_contact_is_stopped_and_shows_error() {
    let mut plc = after_a_reset(MOVING, GripperState::Positioning);
    assert_eq!(plc.commands(), [Command::Stop]);
    plc.controller.adopt_known(&plc.known);
    assert_eq!(plc.commands(), [], "sent only once");
    plc.answer(CommandId::Stop, Status::Success);
    plc.connect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::CmdAborted));
    assert_eq!(plc.raise(CommandFlags::HOMING), [HOMING], "motions are not locked");
}

#[test]
fn motion_of_another_party_shows_after_the_first_contact_stop() {
    let mut plc = after_a_reset(MOVING, GripperState::Positioning);
    assert_eq!(plc.commands(), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::Success);
    // First reported while the session still connects, then repeated.
    plc.known.state = Some(GripperState::Gripping);
    plc.controller.handle(&Event::Connected, &plc.known);
    plc.report(GripperState::Gripping);
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdAborted));
}

#[test]
fn gripper_that_holds_a_part_at_the_first_contact_keeps_it() {
    let mut plc = after_a_reset(SystemFlags::REFERENCED, GripperState::Holding);
    assert_eq!(plc.commands(), []);
    plc.connect();
    plc.controller.adopt_known(&plc.known);
    plc.report_flags(MOVING);
    plc.controller.adopt_known(&plc.known);
    assert_eq!(plc.commands(), [], "a later motion has another reason");
}

#[test]
fn motion_is_refused_while_the_plc_sees_ready_low() {
    let mut plc = Plc::ready();
    for (flags, status) in [
        (SystemFlags::REFERENCED, Status::AlreadyRunning),
        (SystemFlags::REFERENCED | SystemFlags::TEMP_FAULT, Status::AccessDenied),
    ] {
        plc.report_flags(flags);
        plc.image.flags = CommandFlags::MOVE;
        plc.controller.set_output_refusing_motions(&plc.image, &plc.known);
        assert_eq!(plc.commands(), []);
        assert_eq!(plc.shows().1, status);
        assert_eq!(plc.lower(CommandFlags::MOVE), []);
    }
    plc.image.flags = CommandFlags::STOP_ACK;
    plc.controller.set_output_refusing_motions(&plc.image, &plc.known);
    assert_eq!(plc.commands(), [Command::Stop], "only motions");
}

#[test]
fn fast_stop_due_again_after_acknowledge_survives_a_disconnect() {
    let mut plc = Plc::acknowledging_a_fast_stop();
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    assert_eq!(plc.answer(CommandId::FastStop, Status::Success), []);
    plc.disconnect();
    assert_eq!(plc.commands(), [Command::FastStop]);
}

#[test]
fn earlier_result_does_not_end_a_grip_setting_its_force_limit() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::GRIP), [FORCE]);
    assert_eq!(plc.answer(CommandId::GripPart, Status::CmdAborted), []);
    assert_eq!(plc.shows(), (GripperFlags::GRIPPING, Status::CmdPending));
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [GRIP]);
}

#[test]
fn motions_are_ignored_during_stop_fast_stop_and_finger_motion() {
    let mut plc = Plc::ready();
    assert!(!plc.controller.ignores_motions(&plc.known));
    for flag in [CommandFlags::STOP_ACK, CommandFlags::FASTSTOP] {
        plc.raise(flag);
        assert!(plc.controller.ignores_motions(&plc.known), "{flag:?}");
        plc.lower(flag);
    }
    plc.report_flags(MOVING);
    assert!(plc.controller.ignores_motions(&plc.known));
}

fn incidents(plc: &mut Plc) -> Vec<Incident> {
    core::iter::from_fn(|| plc.controller.poll_incident()).collect()
}

fn incident(cause: Cause, command: Option<CommandId>, value: u16) -> Vec<Incident> {
    std::vec![Incident { cause, command, value }]
}

#[test]
fn every_fast_stop_reports_its_cause() {
    type Act = fn(&mut Plc);
    let acts: [(Act, Cause, Option<CommandId>, u16); 8] = [
        (|plc| drop(plc.raise(CommandFlags::FASTSTOP)), Cause::Flag, Some(CommandId::PrePosition), 0),
        (
            |plc| drop(plc.write(|image| image.width = 12_34)),
            Cause::ParameterChanged,
            Some(CommandId::PrePosition),
            12_34,
        ),
        (
            |plc| drop(plc.write(|image| image.speed = 23_45)),
            Cause::ParameterChanged,
            Some(CommandId::PrePosition),
            23_45,
        ),
        (
            |plc| drop(plc.write(|image| image.force_limit = 34_56)),
            Cause::ParameterChanged,
            Some(CommandId::PrePosition),
            34_56,
        ),
        (
            |plc| plc.controller.silence(SilenceReaction::FastStop, &plc.known),
            Cause::PlcSilent,
            Some(CommandId::PrePosition),
            0,
        ),
        (
            |plc| {
                plc.raise(CommandFlags::STOP_ACK);
                plc.controller.handle(&Event::Late(CommandId::Stop), &plc.known);
            },
            Cause::StopFailed,
            None,
            Status::Timeout.code(),
        ),
        (
            |plc| {
                plc.answer(CommandId::PrePosition, Status::Success);
                plc.report_flags(SystemFlags::REFERENCED);
                plc.write(|image| (image.flags, image.speed) = (CommandFlags::MOVE, 1));
                plc.write(|image| image.flags = CommandFlags::empty());
                plc.raise(CommandFlags::GRIP);
            },
            Cause::OutsideLimits,
            None,
            1,
        ),
        (
            |plc| {
                plc.answer(CommandId::PrePosition, Status::Success);
                plc.report_flags(SystemFlags::REFERENCED);
                plc.write(|image| (image.flags, image.force_limit) = (CommandFlags::empty(), 32_000));
                plc.raise(CommandFlags::GRIP);
            },
            Cause::OutsideLimits,
            None,
            32_000,
        ),
    ];
    for (number, (act, cause, command, value)) in acts.into_iter().enumerate() {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::MOVE);
        plc.report_flags(MOVING);
        assert_eq!(incidents(&mut plc), [], "{number}");
        act(&mut plc);
        assert_eq!(incidents(&mut plc), incident(cause, command, value), "{number}");
        assert!(cause.is_fast_stop() && plc.is_fast_stopped());
    }
}

#[test]
fn repeated_fast_stop_is_not_a_second_incident() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::FASTSTOP);
    incidents(&mut plc);
    plc.answer(CommandId::FastStop, Status::Success);
    plc.report_flags(SystemFlags::REFERENCED);
    plc.disconnect();
    assert_eq!(incidents(&mut plc), []);
}

/// Returns the incidents, none of which may be a FAST STOP.
fn refusals(plc: &mut Plc) -> Vec<Incident> {
    let incidents = incidents(plc);
    assert!(incidents.iter().all(|incident| !incident.cause.is_fast_stop()), "{incidents:?}");
    incidents
}

#[test]
fn every_failed_command_reports_its_cause() {
    let moved = Some(CommandId::PrePosition);
    let mut plc = Plc::ready();
    plc.disconnect();
    plc.raise(CommandFlags::MOVE);
    assert_eq!(refusals(&mut plc), incident(Cause::NotConnected, None, 0));

    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.raise(CommandFlags::RELEASE);
    assert_eq!(refusals(&mut plc), incident(Cause::MotionRuns, moved, 0));
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    assert_eq!(refusals(&mut plc), incident(Cause::Gripper, moved, Status::AxisBlocked.code()));

    for (event, cause) in [
        (Event::Unanswered(CommandId::PrePosition), Cause::Unanswered),
        (Event::Withdrawn(CommandId::PrePosition), Cause::Withdrawn),
    ] {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::MOVE);
        plc.controller.handle(&event, &plc.known);
        assert_eq!(refusals(&mut plc), incident(cause, moved, 0));
    }

    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::CmdFailed);
    let failed = incident(Cause::Gripper, Some(CommandId::Stop), Status::CmdFailed.code());
    assert_eq!(refusals(&mut plc), failed);

    let invalid = RequestError::Invalid(DecodeError::NotFinite);
    for (error, status, cause) in [
        (RequestError::NotConnected, Status::IoError, Cause::NotConnected),
        (RequestError::FastStopRunning, Status::AccessDenied, Cause::FastStopLasts),
        (invalid, Status::InvalidParameter, Cause::OutsideLimits),
        (RequestError::QueueFull, Status::InsufficientResources, Cause::Withdrawn),
    ] {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::MOVE);
        plc.controller.refused(CommandId::PrePosition, error, &plc.known);
        assert_eq!(plc.shows(), (GripperFlags::ERROR, status), "{error:?}");
        assert_eq!(incidents(&mut plc), incident(cause, moved, 0), "{error:?}");
    }

    let mut plc = Plc::ready();
    plc.report_flags(SystemFlags::FAST_STOP);
    plc.raise(CommandFlags::MOVE);
    assert_eq!(refusals(&mut plc), incident(Cause::FastStopLasts, None, 0));

    let mut plc = Plc::holding();
    plc.lower(CommandFlags::GRIP);
    plc.raise(CommandFlags::MOVE);
    assert_eq!(refusals(&mut plc), incident(Cause::PartHeld, None, 0));

    let mut plc = Plc::ready();
    plc.image.flags = CommandFlags::MOVE;
    plc.controller.set_output_refusing_motions(&plc.image, &plc.known);
    assert_eq!(refusals(&mut plc), incident(Cause::NotReady, None, 0));

    let mut plc = after_a_reset(MOVING, GripperState::Positioning);
    assert_eq!(refusals(&mut plc), incident(Cause::MovedAtStart, None, 0));
}

#[test]
fn no_part_is_a_result_and_not_an_incident() {
    let mut plc = Plc::ready();
    plc.grip();
    plc.answer(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(incidents(&mut plc), [], "NO_PART is a result");
    plc.lower(CommandFlags::GRIP);
    plc.raise(CommandFlags::RELEASE);
    plc.answer(CommandId::ReleasePart, Status::Success);
    plc.raise(CommandFlags::STOP_ACK);
    plc.answer(CommandId::Stop, Status::Success);
    assert_eq!(incidents(&mut plc), []);
}
