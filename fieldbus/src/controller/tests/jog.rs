//! JOG (fieldbus, 6.7), the silence of a PLC, and the user flags. Each test plays the session.

use super::*;
use wsg_protocol::types::SoftLimits;

const MINUS: Command<'static> = jog(0.0, 50.0);
const PLUS: Command<'static> = jog(110.0, 50.0);

const fn jog(width: f32, speed: f32) -> Command<'static> {
    Command::PrePosition { flags: PrePositionFlags::STOP_ON_BLOCK, width, speed }
}

impl Plc {
    /// Returns fingers that are opening because JOG+ is 1.
    fn jogging() -> Self {
        let mut plc = Self::ready();
        assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [PLUS]);
        plc.begins(CommandId::PrePosition);
        plc.report_flags(MOVING);
        plc
    }

    /// Answers a motion that a Stop ended. Returns the commands that the controller then sends.
    fn stopped(&mut self) -> Vec<Command<'static>> {
        self.answer(CommandId::PrePosition, Status::CmdAborted);
        self.answer(CommandId::Stop, Status::Success);
        self.report_flags(SystemFlags::REFERENCED | SystemFlags::AXIS_STOPPED);
        self.commands()
    }
}

#[test]
fn jog_runs_to_the_stroke_end_and_stops_when_its_flag_clears() {
    for (flag, command) in [(CommandFlags::JOG_PLUS, PLUS), (CommandFlags::JOG_MINUS, MINUS)] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(flag), [FORCE], "the force limit comes first");
        assert_eq!(plc.shows(), (GripperFlags::RELEASING, Status::CmdPending));
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [command]);
        assert_eq!(plc.write(|_| {}), [], "the same image again is no second command");
        assert_eq!(plc.lower(flag), [Command::Stop]);
        assert_eq!(plc.shows(), (GripperFlags::RELEASING, Status::CmdPending), "until it is confirmed");
        assert_eq!(plc.stopped(), []);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
        assert_eq!(plc.raise(flag), [FORCE], "a new edge restarts it");
    }
}

#[test]
fn jog_that_reaches_the_end_is_idle_and_needs_a_new_edge() {
    let mut plc = Plc::jogging();
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.answer(CommandId::PrePosition, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.write(|image| image.speed = 60_00), [], "the end of the stroke is reached");
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);
}

#[test]
fn jog_that_fails_is_idle_and_shows_why() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.answer(CommandId::PrePosition, Status::AxisBlocked), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AxisBlocked));
    assert_eq!(plc.write(|_| {}), [], "no automatic retry");

    let mut plc = Plc::ready();
    plc.raise(CommandFlags::JOG_MINUS);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::CmdFormatError), [], "nothing moves");
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::CmdFormatError));
}

impl Plc {
    /// Returns a gripper with soft limits at 30 and 80 mm and its fingers at 50 mm, after it refused the end of the stroke.
    fn jogging_into_soft_limits(flag: CommandFlags) -> Self {
        let mut plc = Self::ready();
        plc.raise(flag);
        plc.answer(CommandId::SetForceLimit, Status::Success);
        assert_eq!(plc.answer(CommandId::PrePosition, Status::RangeError), [Command::GetSoftLimits]);
        assert_eq!(plc.shows(), (GripperFlags::RELEASING, Status::CmdPending));
        plc
    }

    fn answer_soft_limits(&mut self) -> Vec<Command<'static>> {
        let reply = Reply::success(Value::GetSoftLimits(SoftLimits { minus: 30.0, plus: 80.0 }));
        self.controller.handle(&Event::Answered(reply), &self.known);
        self.commands()
    }
}

/// Fieldbus, 6.7; command set, 3.3.5.
#[test]
fn jog_runs_to_the_soft_limit_in_its_direction() {
    for (flag, limit) in [(CommandFlags::JOG_PLUS, 80.0), (CommandFlags::JOG_MINUS, 30.0)] {
        let mut plc = Plc::jogging_into_soft_limits(flag);
        assert_eq!(plc.answer_soft_limits(), [jog(limit, 50.0)]);
        plc.begins(CommandId::PrePosition);
        assert_eq!(plc.write(|image| image.speed = 60_00), [Command::Stop], "it follows the dial");
        plc.answer(CommandId::PrePosition, Status::CmdAborted);
        assert_eq!(plc.answer(CommandId::Stop, Status::Success), [FORCE]);
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [jog(limit, 60.0)]);
        assert_eq!(plc.answer(CommandId::PrePosition, Status::Success), []);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
        // The limits may change while both flags are 0.
        plc.lower(flag);
        plc.raise(flag);
        let end = if flag == CommandFlags::JOG_PLUS { 110.0 } else { 0.0 };
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [jog(end, 60.0)]);
    }
}

#[test]
fn jog_at_or_beyond_a_soft_limit_is_refused_with_e_range_error() {
    let (plus, minus) = (CommandFlags::JOG_PLUS, CommandFlags::JOG_MINUS);
    for (flag, width) in [(plus, 80.0), (plus, 81.0), (minus, 30.0), (minus, 29.0)] {
        let mut plc = Plc::jogging_into_soft_limits(flag);
        plc.known.width = Some(width);
        assert_eq!(plc.answer_soft_limits(), [], "at {width} mm");
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::RangeError));
        let range = incident(Cause::Gripper, Some(CommandId::PrePosition), Status::RangeError.code());
        assert_eq!(incidents(&mut plc), range);
    }
}

/// Places the fingers outside each limit in turn, where only the way back is permitted (command set, 3.3.5).
#[test]
fn jog_beyond_a_known_soft_limit_never_reverses_the_fingers() {
    let outside = [
        (CommandFlags::JOG_MINUS, CommandFlags::JOG_PLUS, 100.0),
        (CommandFlags::JOG_PLUS, CommandFlags::JOG_MINUS, 10.0),
    ];
    for (back, onward, width) in outside {
        let mut plc = Plc::jogging_into_soft_limits(back);
        plc.known.width = Some(width);
        assert_eq!(plc.answer_soft_limits().len(), 1, "back into the range");
        assert_eq!(plc.raise(onward), [Command::Stop], "both flags stop");
        plc.answer(CommandId::PrePosition, Status::CmdAborted);
        plc.answer(CommandId::Stop, Status::Success);
        assert_eq!(plc.lower(back), [], "{onward:?} at {width} mm");
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::RangeError));
    }
}

#[test]
fn jog_whose_soft_limits_do_not_help_ends_with_e_range_error() {
    let mut plc = Plc::jogging_into_soft_limits(CommandFlags::JOG_PLUS);
    assert_eq!(plc.answer(CommandId::GetSoftLimits, Status::NotAvailable), [], "cleared meanwhile");
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::NotAvailable));

    let mut plc = Plc::jogging_into_soft_limits(CommandFlags::JOG_PLUS);
    plc.answer_soft_limits();
    assert_eq!(plc.answer(CommandId::PrePosition, Status::RangeError), [], "moved meanwhile");
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::RangeError));
}

#[test]
fn jog_flag_cleared_during_a_soft_limit_query_moves_nothing() {
    let mut plc = Plc::jogging_into_soft_limits(CommandFlags::JOG_PLUS);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop]);
    assert_eq!(plc.answer_soft_limits(), []);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE], "a new edge restarts it");
}

#[test]
fn both_jog_flags_stop_and_the_remaining_one_continues() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.raise(CommandFlags::JOG_MINUS), [Command::Stop]);
    assert_eq!(plc.stopped(), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [FORCE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [MINUS]);
}

/// The answer to the jog may have been lost, or follow. The flag is 1 all the time.
#[test]
fn acknowledging_the_grippers_fast_stop_ends_a_jog_for_good() {
    for answers in [false, true] {
        let mut plc = Plc::jogging();
        plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
        if answers {
            plc.answer(CommandId::PrePosition, Status::CmdAborted);
        }
        plc.answer(CommandId::Acknowledge, Status::Success);
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
        assert_eq!(plc.write(|image| image.speed += 1), []);
        assert_eq!(plc.lower(CommandFlags::STOP_ACK), []);
        assert_eq!(plc.write(|image| image.speed += 1), []);
    }
}

/// The gripper may not have reported ERROR yet.
#[test]
fn stop_after_a_failed_jog_acknowledges_too() {
    let mut plc = Plc::jogging();
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop, Command::ACKNOWLEDGE]);
}

#[test]
fn failed_jog_hides_the_reported_error_until_the_next_motion() {
    let mut plc = Plc::ready();
    let commands = plc.raise(CommandFlags::JOG_PLUS);
    assert_eq!(commands.len(), 1);
    plc.answer(CommandId::SetForceLimit, Status::Success);
    plc.begins(CommandId::PrePosition);
    plc.report(GripperState::Positioning);
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    plc.report(GripperState::Error);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AxisBlocked));
    plc.lower(CommandFlags::JOG_PLUS);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AxisBlocked));
    // An error of another party's motion is shown.
    plc.report(GripperState::Positioning);
    plc.report(GripperState::Error);
    assert_eq!(plc.shows().0, GripperFlags::ERROR);
    // An error of the PLC's own motion is shown too.
    plc.raise(CommandFlags::HOMING);
    plc.begins(CommandId::Homing);
    plc.report(GripperState::Positioning);
    plc.answer(CommandId::Homing, Status::AxisBlocked);
    plc.report(GripperState::Error);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::AxisBlocked));
}

#[test]
fn jog_flags_that_rise_together_move_nothing() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS | CommandFlags::JOG_MINUS), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn jog_that_reverses_stops_first() {
    let mut plc = Plc::jogging();
    let turned = plc.write(|image| image.flags = CommandFlags::JOG_MINUS);
    assert_eq!(turned, [Command::Stop]);
    assert_eq!(plc.answer(CommandId::PrePosition, Status::CmdAborted), []);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), [], "the fingers still move");
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.commands(), [FORCE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [MINUS]);
}

#[test]
fn speed_and_force_of_a_jog_follow_a_dial() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.write(|image| image.speed = 60_00), [Command::Stop], "no FAST STOP");
    assert_eq!(plc.write(|image| image.speed = 70_00), [], "one Stop is enough");
    assert_eq!(plc.write(|image| image.force_limit = 30_00), []);
    assert_eq!(plc.stopped(), [Command::SetForceLimit { force: 30.0 }], "the newest values");
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [jog(110.0, 70.0)]);
    assert!(!plc.is_fast_stopped());
}

#[test]
fn jog_waits_for_both_answers_before_it_continues() {
    for first in [CommandId::Stop, CommandId::PrePosition] {
        let mut plc = Plc::jogging();
        plc.report_flags(SystemFlags::REFERENCED);
        plc.write(|image| image.speed = 60_00);
        let status = |id| if id == CommandId::Stop { Status::Success } else { Status::CmdAborted };
        assert_eq!(plc.answer(first, status(first)), []);
        let second = if first == CommandId::Stop { CommandId::PrePosition } else { CommandId::Stop };
        assert_eq!(plc.answer(second, status(second)), [FORCE]);
    }
}

#[test]
fn jog_stopped_twice_still_awaits_the_answer_to_its_motion() {
    let mut plc = Plc::jogging();
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop]);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), []);
    assert_eq!(plc.shows().0, GripperFlags::RELEASING, "its motion is not answered");
    assert_eq!(plc.lower(CommandFlags::STOP_ACK), []);
    assert_eq!(plc.raise(CommandFlags::JOG_MINUS), [], "so the next does not begin yet");
    assert_eq!(plc.answer(CommandId::PrePosition, Status::CmdAborted), [FORCE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [MINUS]);
}

#[test]
fn successful_jog_stop_is_no_fast_stop_despite_an_older_state() {
    let mut plc = Plc::jogging();
    plc.report(GripperState::Positioning);
    plc.lower(CommandFlags::JOG_PLUS);
    plc.report_flags(SystemFlags::REFERENCED | SystemFlags::AXIS_STOPPED);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), []);
    assert_eq!(plc.answer(CommandId::PrePosition, Status::CmdAborted), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn failed_jog_stop_is_no_fast_stop_if_the_fingers_stand() {
    let mut plc = Plc::jogging();
    plc.lower(CommandFlags::JOG_PLUS);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.answer(CommandId::Stop, Status::CmdFailed), []);
    assert_eq!(plc.shows().1, Status::CmdFailed);
    assert!(!plc.is_fast_stopped());
}

#[test]
fn width_that_changes_during_a_jog_is_a_fast_stop() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.write(|image| image.width += 1), [Command::FastStop]);
}

#[test]
fn jog_at_speed_0_runs_at_the_least_speed() {
    let mut plc = Plc::ready();
    plc.write(|image| image.speed = 0);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), [jog(110.0, 5.0)]);
    let mut plc = Plc::ready();
    plc.write(|image| image.speed = 0);
    assert_eq!(plc.raise(CommandFlags::MOVE), [Command::FastStop], "only for JOG");
}

#[test]
fn jog_outside_the_limits_fast_stops_at_start_and_in_motion() {
    type Change = fn(&mut OutputImage);
    // Changes, and the value to report: the speed, or with a speed inside the limits the force limit.
    let changes: [(Change, u16); 5] = [
        (|image| image.speed = 4_99, 4_99),
        (|image| image.speed = 420_01, 420_01),
        (|image| image.force_limit = 80_01, 80_01),
        (|image| image.force_limit = 0, 0),
        (|image| (image.speed, image.force_limit) = (0, 80_02), 80_02),
    ];
    for (change, value) in changes {
        let mut plc = Plc::ready();
        plc.write(change);
        assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [Command::FastStop]);
        assert_eq!(incidents(&mut plc), incident(Cause::OutsideLimits, None, value));
        let mut plc = Plc::jogging();
        assert_eq!(plc.write(change), [Command::FastStop]);
        assert_eq!(incidents(&mut plc), incident(Cause::OutsideLimits, Some(CommandId::PrePosition), value));
    }
}

#[test]
fn jog_flag_at_power_up_starts_nothing_until_both_were_0() {
    let jogs = OutputImage { flags: CommandFlags::JOG_PLUS, ..PARAMETERS };
    let mut plc = Plc::with_first_image(jogs);
    plc.connect();
    assert_eq!(plc.write(|_| {}), []);
    assert_eq!(plc.write(|image| image.flags = CommandFlags::JOG_MINUS), [], "never 0");
    assert_eq!(plc.lower(CommandFlags::JOG_MINUS), []);
    assert_eq!(plc.raise(CommandFlags::JOG_MINUS), [FORCE]);
}

#[test]
fn jog_that_stop_or_fast_stop_ended_waits_until_its_flag_was_0() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    assert_eq!(plc.stopped(), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.lower(CommandFlags::STOP_ACK), [], "JOG+ is still 1");
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);

    let mut plc = Plc::jogging();
    assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
    plc.answer(CommandId::FastStop, Status::Success);
    plc.answer(CommandId::PrePosition, Status::CmdAborted);
    plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
    assert_eq!(plc.lower(CommandFlags::FASTSTOP), []);
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::ACKNOWLEDGE]);
    plc.answer(CommandId::Acknowledge, Status::Success);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.lower(CommandFlags::STOP_ACK), [], "JOG+ is still 1");
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn jog_flag_set_during_stop_or_fast_stop_starts_nothing_later() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::Success);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.lower(CommandFlags::STOP_ACK), [], "JOG+ is still 1");
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);

    // Before, with and after the acknowledgement of a FAST STOP.
    for at in 0..3 {
        let mut plc = Plc::ready();
        let jog_if = |now: bool| if now { CommandFlags::JOG_MINUS } else { CommandFlags::empty() };
        assert_eq!(plc.raise(CommandFlags::FASTSTOP), [Command::FastStop]);
        plc.answer(CommandId::FastStop, Status::Success);
        plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!(plc.raise(jog_if(at == 0)), []);
        assert_eq!(plc.lower(CommandFlags::FASTSTOP), []);
        assert_eq!(plc.raise(CommandFlags::STOP_ACK | jog_if(at == 1)), [Command::ACKNOWLEDGE]);
        plc.answer(CommandId::Acknowledge, Status::Success);
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(plc.raise(jog_if(at == 2)), []);
        assert_eq!(plc.lower(CommandFlags::STOP_ACK), [], "{at}: JOG- is still 1");
        assert_eq!(plc.lower(CommandFlags::JOG_MINUS), []);
        assert_eq!(plc.raise(CommandFlags::JOG_MINUS), [FORCE]);
    }
}

#[test]
fn jog_is_refused_when_disconnected_fast_stopped_or_holding() {
    let mut plc = Plc::ready();
    plc.disconnect();
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::IoError));
    plc.connect();
    assert_eq!(plc.write(|_| {}), [], "and not kept");

    let mut plc = Plc::ready();
    plc.report_flags(SystemFlags::FAST_STOP);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.shows().1, Status::AccessDenied);

    let mut plc = Plc::ready();
    plc.report(GripperState::Holding);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.shows(), (GripperFlags::HOLDING, Status::AccessDenied));
}

#[test]
fn jog_beside_another_motion_does_not_run_now_or_after_it() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::MOVE | CommandFlags::JOG_PLUS), [MOVE], "the lowest bit");
    assert_eq!(plc.shows().1, Status::CmdPending);
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.write(|_| {}), []);

    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::AlreadyRunning));
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), []);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::CmdPending));
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
    assert_eq!(plc.write(|_| {}), []);
}

#[test]
fn motion_during_a_jog_is_refused_and_the_jog_continues() {
    let mut plc = Plc::jogging();
    assert_eq!(plc.raise(CommandFlags::MOVE), []);
    assert_eq!(plc.shows(), (GripperFlags::RELEASING, Status::AlreadyRunning));
    assert_eq!(plc.lower(CommandFlags::MOVE | CommandFlags::JOG_PLUS), [Command::Stop]);
}

#[test]
fn jog_flag_cleared_while_setting_force_limit_moves_nothing() {
    let mut plc = Plc::ready();
    assert_eq!(plc.raise(CommandFlags::JOG_PLUS), [FORCE]);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop]);
    assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), []);
    assert_eq!(plc.answer(CommandId::Stop, Status::Success), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success), "there is no motion to wait for");
}

#[test]
fn jog_flag_cleared_before_its_motion_is_fetched_moves_nothing() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::JOG_PLUS);
    let success = Reply::status_only(CommandId::SetForceLimit, Status::Success);
    plc.controller.handle(&Event::Answered(success), &plc.known);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop], "and no Pre-position");
    plc.answer(CommandId::Stop, Status::Success);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn jog_still_ends_if_its_flag_clears_while_the_end_is_held_back() {
    let mut plc = Plc::jogging();
    plc.answer(CommandId::PrePosition, Status::Success);
    assert_eq!(plc.lower(CommandFlags::JOG_PLUS), [Command::Stop]);
    plc.answer(CommandId::Stop, Status::Success);
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Success));
}

#[test]
fn connection_lost_during_a_jog_queues_a_fast_stop() {
    let mut plc = Plc::jogging();
    plc.known = Known::NOTHING;
    plc.controller.handle(&Event::Unanswered(CommandId::PrePosition), &plc.known);
    plc.disconnect();
    assert!(plc.commands().contains(&Command::FastStop));
    plc.connect();
    assert_eq!(plc.write(|_| {}), [], "JOG+ is still 1");

    let mut plc = Plc::jogging();
    plc.lower(CommandFlags::JOG_PLUS);
    plc.known = Known::NOTHING;
    plc.controller.handle(&Event::Unanswered(CommandId::Stop), &plc.known);
    assert_eq!(plc.commands(), [Command::FastStop], "the Stop may not have arrived");
}

#[test]
fn jog_with_lost_result_needs_no_fast_stop_if_fingers_stand() {
    let mut plc = Plc::jogging();
    plc.report_flags(SystemFlags::REFERENCED);
    plc.controller.handle(&Event::Unanswered(CommandId::PrePosition), &plc.known);
    assert_eq!(plc.commands(), []);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Timeout));
}

#[test]
fn jog_stop_refused_by_gripper_or_session_becomes_a_fast_stop() {
    let mut plc = Plc::jogging();
    plc.lower(CommandFlags::JOG_PLUS);
    assert_eq!(plc.answer(CommandId::Stop, Status::CmdFailed), [Command::FastStop]);

    let mut plc = Plc::jogging();
    plc.lower(CommandFlags::JOG_PLUS);
    plc.controller.refused(CommandId::Stop, RequestError::NotConnected, &plc.known);
    assert_eq!(plc.commands(), [Command::FastStop]);
}

#[test]
fn jog_that_the_session_refuses_ends() {
    let mut plc = Plc::jogging();
    plc.controller.refused(CommandId::PrePosition, RequestError::MotionRunning, &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AlreadyRunning));
    assert_eq!(plc.write(|_| {}), []);
}

#[test]
fn silence_ends_a_jog_with_every_reaction() {
    for reaction in [SilenceReaction::Hold, SilenceReaction::Stop] {
        let mut plc = Plc::jogging();
        plc.controller.silence(reaction, &plc.known);
        assert_eq!(plc.commands(), [Command::Stop], "{reaction:?}");
        assert_eq!(plc.stopped(), []);
        assert_eq!(plc.write(|_| {}), [], "JOG+ is still 1 when the PLC is back");
    }
}

#[test]
fn silence_holds_stops_or_fast_stops_a_motion() {
    for (reaction, commands) in [
        (SilenceReaction::Hold, vec![]),
        (SilenceReaction::Stop, vec![Command::Stop]),
        (SilenceReaction::FastStop, vec![Command::FastStop]),
    ] {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::MOVE);
        plc.controller.silence(reaction, &plc.known);
        assert_eq!(plc.commands(), commands);
    }
}

#[test]
fn silence_does_not_drop_a_part_or_acknowledge_a_fast_stop() {
    let mut plc = Plc::ready();
    plc.report(GripperState::Holding);
    plc.controller.silence(SilenceReaction::Stop, &plc.known);
    assert_eq!(plc.commands(), []);

    let mut plc = Plc::ready();
    plc.report_flags(SystemFlags::FAST_STOP | SystemFlags::MOVING);
    plc.controller.silence(SilenceReaction::Stop, &plc.known);
    assert_eq!(plc.commands(), []);
}

#[test]
fn user_flags_go_both_ways() {
    let mut plc = Plc::ready();
    plc.write(|image| image.user = 0b0010_0000);
    assert_eq!(plc.controller.user_inputs(), 0b0010_0000);
    plc.controller.set_user_outputs(0b1000_0001);
    assert_eq!(plc.controller.input(&plc.known).to_bytes()[1], 0b1000_0001);
}

#[test]
fn plc_silence_in_a_disconnect_fast_stops_fingers_that_may_move() {
    for ends in [false, true] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(CommandFlags::MOVE).len(), 1);
        plc.begins(CommandId::PrePosition);
        plc.report_flags(MOVING);
        if ends {
            plc.answer(CommandId::PrePosition, Status::Success);
            plc.known = Known::NOTHING;
        } else {
            plc.known = Known::NOTHING;
            plc.controller.handle(&Event::Unanswered(CommandId::PrePosition), &plc.known);
        }
        plc.disconnect();
        plc.controller.silence(SilenceReaction::Stop, &plc.known);
        let expected: &[Command<'_>] = if ends { &[] } else { &[Command::FastStop] };
        assert_eq!(plc.commands(), expected, "the motion has ended: {ends}");
    }
}

/// FASTSTOP has priority over all other commands (fieldbus, 6.6), and its end starts no motion.
#[test]
fn jog_flag_set_before_fast_stop_starts_nothing_after_it_ends() {
    type Begin = fn() -> Plc;
    let of_a_parameter: Begin = || {
        let mut plc = Plc::jogging();
        assert_eq!(plc.write(|image| image.speed = 420_01), [Command::FastStop]);
        plc.confirm_fast_stop();
        plc.answer(CommandId::PrePosition, Status::CmdAborted);
        plc.write(|image| image.speed = 50_00);
        plc
    };
    let beside_its_flag: Begin = || {
        let mut plc = Plc::ready();
        plc.raise(CommandFlags::FASTSTOP);
        plc.confirm_fast_stop();
        plc.raise(CommandFlags::JOG_PLUS);
        plc.lower(CommandFlags::FASTSTOP);
        plc
    };
    for begin in [of_a_parameter, beside_its_flag] {
        let mut plc = begin();
        assert_eq!(
            plc.shows(),
            (GripperFlags::IDLE, Status::Success),
            "the state and status of the FAST STOP"
        );
        let causes: Vec<Cause> = incidents(&mut plc).iter().map(|incident| incident.cause).collect();
        assert!(!causes.contains(&Cause::FastStopLasts), "no jog was refused: {causes:?}");
        // Acknowledge on the gripper's web page.
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(plc.commands(), []);
        assert_eq!(plc.write(|image| image.user ^= 1), [], "JOG+ is still 1");
        assert_eq!(plc.write(|image| image.speed = 60_00), []);
    }
}
