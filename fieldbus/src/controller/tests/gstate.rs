//! GSTATE follows the gripper, whoever commands it (fieldbus, 5.1.2 and appendix C). Each test plays the session and
//! a third party.

use super::*;

const MOTIONS: [(CommandFlags, CommandId); 4] = [
    (CommandFlags::MOVE, CommandId::PrePosition),
    (CommandFlags::GRIP, CommandId::GripPart),
    (CommandFlags::RELEASE, CommandId::ReleasePart),
    (CommandFlags::HOMING, CommandId::Homing),
];

impl Plc {
    /// Returns a PLC whose motion has begun, with flags that show it.
    fn in_motion(flag: CommandFlags, id: CommandId) -> Self {
        let mut plc = Self::ready();
        plc.known.force_limit = Some(40.0);
        assert_eq!(plc.raise(flag).len(), 1);
        plc.begins(id);
        plc.report(match id {
            CommandId::GripPart => GripperState::Gripping,
            CommandId::ReleasePart => GripperState::Releasing,
            _ => GripperState::Positioning,
        });
        plc.report_flags(MOVING);
        plc
    }

    /// Reports the states that other parties' motions cause, and expects each of them in GSTATE.
    fn follows_others(&mut self, status: Status) {
        for state in [
            GripperState::Positioning,
            GripperState::Idle,
            GripperState::Gripping,
            GripperState::NoPart,
            GripperState::Gripping,
            GripperState::Holding,
            GripperState::PartLost,
            GripperState::Releasing,
            GripperState::Error,
            GripperState::Idle,
        ] {
            // A refresh repeats every state.
            for _ in 0..2 {
                self.report(state);
                assert_eq!(self.shows(), (state.into(), status), "41h = {}", state.code());
            }
        }
    }
}

#[test]
fn third_party_stop_ends_a_motion_in_idle_and_the_next_begins() {
    for (flag, id) in MOTIONS {
        for state_first in [false, true] {
            let mut plc = Plc::in_motion(flag, id);
            if state_first {
                plc.report(GripperState::Idle);
            }
            plc.answer(id, Status::CmdAborted);
            assert_eq!(plc.shows().1, Status::CmdPending, "until the fingers stand");
            plc.report_flags(SystemFlags::REFERENCED | SystemFlags::AXIS_STOPPED);
            assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::CmdAborted), "{id}");
            let aborted = incident(Cause::Gripper, Some(id), Status::CmdAborted.code());
            assert_eq!(incidents(&mut plc), aborted);
            plc.report(GripperState::Idle);
            plc.lower(flag);
            assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE], "without STOP/ACK");
        }
    }
}

#[test]
fn gstate_follows_other_parties_after_each_end_of_a_motion() {
    let ends = [
        (Status::Success, GripperState::Idle),
        (Status::CmdAborted, GripperState::Idle),
        (Status::AxisBlocked, GripperState::Error),
        (Status::RangeError, GripperState::Error),
        (Status::Timeout, GripperState::Error),
    ];
    for (status, state) in ends {
        let mut plc = Plc::in_motion(CommandFlags::MOVE, CommandId::PrePosition);
        plc.answer(CommandId::PrePosition, status);
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(plc.shows(), (state.into(), status), "before the report");
        plc.report(state);
        assert_eq!(plc.shows(), (state.into(), status));
        plc.follows_others(status);
    }
}

type Refuse = fn(&mut Plc);

/// Refusals of RELEASE by the gripper and by the session. The gripper never begins the motion, so it repeats its state from
/// before it.
const REFUSALS: [(Refuse, Status); 4] = [
    (|plc| drop(plc.answer(CommandId::ReleasePart, Status::RangeError)), Status::RangeError),
    (|plc| drop(plc.answer(CommandId::ReleasePart, Status::NotInitialized)), Status::NotInitialized),
    (|plc| plc.controller.handle(&Event::Withdrawn(CommandId::ReleasePart), &plc.known), Status::CmdAborted),
    (
        |plc| plc.controller.refused(CommandId::ReleasePart, RequestError::QueueFull, &plc.known),
        Status::InsufficientResources,
    ),
];

#[test]
fn refused_motion_shows_error_until_another_state_is_reported() {
    for (refuse, status) in REFUSALS {
        for before in [GripperState::Idle, GripperState::NoPart] {
            let mut plc = Plc::ready();
            plc.report(before);
            plc.raise(CommandFlags::RELEASE);
            refuse(&mut plc);
            for _ in 0..3 {
                assert_eq!(plc.shows(), (GripperFlags::ERROR, status), "41h = {}", before.code());
                plc.report(before);
            }
            plc.follows_others(status);
        }
    }
}

/// A gripper that reports changes only does not repeat its state first.
#[test]
fn first_report_of_another_state_after_a_refusal_ends_error() {
    use GripperState::{Holding, Idle, NoPart, PartLost, Positioning};
    for (refuse, status) in REFUSALS {
        for (before, after) in
            [(Idle, NoPart), (Idle, PartLost), (NoPart, Idle), (Holding, PartLost), (PartLost, Positioning)]
        {
            let mut plc = Plc::ready();
            plc.report(before);
            plc.raise(CommandFlags::RELEASE);
            refuse(&mut plc);
            plc.report(after);
            assert_eq!(plc.shows(), (after.into(), status), "41h = {}, {}", before.code(), after.code());
        }
    }
}

/// The third party acknowledges first.
#[test]
fn acknowledgement_hides_no_state_that_a_third_party_has_caused() {
    use GripperState::{Gripping, Holding, NoPart, PartLost, Positioning};
    for state in [Positioning, Gripping, Holding, NoPart, PartLost] {
        let mut plc = Plc::acknowledging_a_fast_stop();
        plc.report_flags(SystemFlags::REFERENCED);
        plc.report(state);
        plc.answer(CommandId::Acknowledge, Status::Success);
        assert_eq!(plc.shows(), (state.into(), Status::Success), "41h = {}", state.code());
    }
}

/// A third party acknowledges the gripper's own FAST STOP before the answer to the force limit.
#[test]
fn motion_awaiting_its_force_limit_never_starts_after_fast_stop() {
    for flag in [CommandFlags::GRIP, CommandFlags::JOG_PLUS] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(flag), [Command::SetForceLimit { force: 40.0 }]);
        plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));
        plc.report_flags(SystemFlags::REFERENCED);
        assert_eq!(plc.answer(CommandId::SetForceLimit, Status::Success), []);
        assert_eq!(plc.write(|image| image.speed += 1), []);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));
    }
}

#[test]
fn unfetched_motion_does_not_start_after_a_fast_stop() {
    for flag in [CommandFlags::GRIP, CommandFlags::JOG_PLUS] {
        let mut plc = Plc::ready();
        assert_eq!(plc.raise(flag), [Command::SetForceLimit { force: 40.0 }]);
        let done = Reply::status_only(CommandId::SetForceLimit, Status::Success);
        plc.controller.handle(&Event::Answered(done), &plc.known);
        plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
        assert_eq!(plc.controller.poll_command(), None);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AccessDenied));
    }
}

/// The FAST STOP has ended the motion, so its outcome is not in doubt when another party acknowledges.
#[test]
fn motion_without_an_answer_in_fast_stop_leaves_no_error() {
    let mut plc = Plc::in_motion(CommandFlags::MOVE, CommandId::PrePosition);
    plc.report(GripperState::Error);
    plc.report_flags(SystemFlags::REFERENCED | SystemFlags::FAST_STOP);
    plc.controller.handle(&Event::Unanswered(CommandId::PrePosition), &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Timeout));
    plc.report_flags(SystemFlags::REFERENCED);
    plc.report(GripperState::Idle);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::Timeout));
}

#[test]
fn stop_hides_no_error_reported_before_its_answer() {
    for (state, shown) in [
        (GripperState::Error, GripperFlags::ERROR),
        (GripperState::PartLost, GripperFlags::IDLE),
        (GripperState::Positioning, GripperFlags::IDLE),
    ] {
        let mut plc = Plc::holding();
        assert_eq!(plc.raise(CommandFlags::STOP_ACK), [Command::Stop]);
        plc.report(state);
        plc.answer(CommandId::Stop, Status::Success);
        assert_eq!(plc.shows(), (shown, Status::Success), "41h = {}", state.code());
    }
}

#[test]
fn motion_refused_for_a_third_party_motion_shows_that_motion() {
    let mut plc = Plc::ready();
    plc.raise(CommandFlags::MOVE);
    plc.answer(CommandId::PrePosition, Status::AlreadyRunning);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::AlreadyRunning), "its report follows");
    plc.follows_others(Status::AlreadyRunning);
}

/// The reports from before the next rest may belong to the motion itself.
#[test]
fn unknown_outcome_shows_error_until_a_later_motion_or_result() {
    let unknown = || {
        let mut plc = Plc::in_motion(CommandFlags::RELEASE, CommandId::ReleasePart);
        plc.controller.handle(&Event::Unanswered(CommandId::ReleasePart), &plc.known);
        plc
    };
    let mut plc = unknown();
    for state in [GripperState::Releasing, GripperState::Releasing, GripperState::Idle, GripperState::Idle] {
        plc.report(state);
        assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout), "41h = {}", state.code());
    }
    plc.follows_others(Status::Timeout);

    for result in [GripperState::NoPart, GripperState::Holding, GripperState::PartLost] {
        let mut plc = unknown();
        plc.report(result);
        assert_eq!(plc.shows(), (result.into(), Status::Timeout));
    }

    let mut plc = unknown();
    plc.disconnect();
    plc.connect();
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout), "still not known");
    plc.follows_others(Status::Timeout);
}

/// Then a motion that is reported later is another party's.
#[test]
fn missing_answer_leaves_no_doubt_if_fingers_are_known_to_stand() {
    let mut plc = Plc::in_motion(CommandFlags::RELEASE, CommandId::ReleasePart);
    plc.report_flags(SystemFlags::REFERENCED);
    plc.report(GripperState::Idle);
    plc.controller.handle(&Event::Unanswered(CommandId::ReleasePart), &plc.known);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::Timeout));
    plc.report(GripperState::Positioning);
    assert_eq!(plc.shows(), (GripperFlags::POSITIONING, Status::Timeout));
}

#[test]
fn old_failure_does_not_reappear_after_a_third_party_fast_stop() {
    let mut plc = Plc::in_motion(CommandFlags::MOVE, CommandId::PrePosition);
    plc.answer(CommandId::PrePosition, Status::AxisBlocked);
    plc.report(GripperState::Error);
    plc.report_flags(FAST_STOPPED);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AxisBlocked));
    plc.report_flags(SystemFlags::REFERENCED);
    assert_eq!(plc.shows(), (GripperFlags::IDLE, Status::AxisBlocked), "state not reported yet");
    plc.report(GripperState::Idle);
    plc.lower(CommandFlags::MOVE);
    assert_eq!(plc.raise(CommandFlags::MOVE), [MOVE]);
}

#[test]
fn end_of_a_motion_does_not_await_the_next_third_party_motion() {
    for status in [Status::Success, Status::CmdAborted] {
        let mut plc = Plc::in_motion(CommandFlags::MOVE, CommandId::PrePosition);
        plc.answer(CommandId::PrePosition, status);
        plc.report(GripperState::Gripping);
        assert_eq!(
            plc.shows(),
            (GripperFlags::GRIPPING, status),
            "the flags report moving fingers throughout"
        );
    }
}

#[test]
fn motion_that_a_fault_of_the_gripper_aborts_shows_the_error() {
    let mut plc = Plc::in_motion(CommandFlags::MOVE, CommandId::PrePosition);
    plc.report(GripperState::Error);
    plc.answer(CommandId::PrePosition, Status::CmdAborted);
    assert_eq!(plc.shows(), (GripperFlags::ERROR, Status::CmdAborted));
    plc.follows_others(Status::CmdAborted);
}

#[test]
fn jog_failed_or_stopped_by_others_stays_idle_after_a_reconnect() {
    for (status, state) in
        [(Status::CmdAborted, GripperState::Idle), (Status::AxisBlocked, GripperState::Error)]
    {
        let mut plc = Plc::ready();
        plc.known.force_limit = Some(40.0);
        plc.raise(CommandFlags::JOG_PLUS);
        plc.begins(CommandId::PrePosition);
        plc.answer(CommandId::PrePosition, status);
        plc.report(state);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, status));
        let known = plc.known;
        plc.disconnect();
        plc.known = known;
        plc.controller.handle(&Event::Connected, &plc.known);
        assert_eq!(plc.shows(), (GripperFlags::IDLE, status));
        plc.follows_others(status);
    }
}
