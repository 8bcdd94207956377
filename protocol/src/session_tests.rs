//! The session in virtual time, against a gripper whose answers each test writes down.

use super::*;
use crate::types::{
    DeviceType, FirmwareVersion, GripperState, HomingDirection, SystemFlags, SystemInfo, SystemLimits,
};
use crate::{
    AutoUpdate, Command, CommandId, Event, Frame, Instant, Kind, Payload, Refusal, Reply, Status, Value,
};
use std::vec;
use std::vec::Vec;

const GRIP: Command<'static> = Command::GripPart { width: 20.0, speed: 50.0 };
const HOMING: Command<'static> = Command::Homing { direction: HomingDirection::Default };
/// What connecting begins with.
const STATE: Command<'static> = Command::GetSystemState { update: AutoUpdate::on_change(10) };

pub(crate) const INFO: SystemInfo = SystemInfo {
    device: DeviceType::Wsg50,
    hardware_revision: 1,
    firmware: FirmwareVersion::new(4, 0, 0, 0),
    serial_number: 7,
};

pub(crate) const LIMITS: SystemLimits = SystemLimits {
    stroke: 110.0,
    min_speed: 5.0,
    max_speed: 420.0,
    min_acceleration: 100.0,
    max_acceleration: 5000.0,
    min_force: 5.0,
    nominal_force: 80.0,
    overdrive_force: 120.0,
};

/// A session, its clock, and what has happened.
struct Desk {
    session: Session,
    now: Instant,
    notices: Vec<std::string::String>,
}

impl Desk {
    fn new() -> Self {
        Self::with(Config::DEFAULT)
    }

    fn with(config: Config) -> Self {
        // Near the end of the clock's range, so that every script also shows that it may wrap.
        Self { session: Session::new(config), now: Instant::from_millis(u32::MAX - 400), notices: vec![] }
    }

    fn connected() -> Self {
        let mut desk = Self::new();
        desk.connect();
        desk.notices.clear();
        desk
    }

    fn connect(&mut self) {
        for _ in 0..2_000 {
            if self.session.is_connected() {
                return;
            }
            for command in self.pass(1) {
                self.answer(command.id());
            }
        }
        panic!("a gripper that answers is found");
    }

    /// Lets `ms` pass, one by one, noting what happens.
    fn pass(&mut self, ms: u32) -> Vec<Command<'static>> {
        let mut sent = self.sent();
        for _ in 0..ms {
            self.now = self.now.plus(1);
            sent.extend(self.sent());
        }
        sent
    }

    fn sent(&mut self) -> Vec<Command<'static>> {
        while let Some(notice) = self.session.tick(self.now) {
            self.notices.push(std::format!("{notice:?}"));
            assert!(self.notices.len() < 10_000, "notices without end");
        }
        let mut sent = vec![];
        while let Some(command) = self.session.poll_transmit(self.now) {
            sent.push(command);
            assert!(sent.len() < 200, "commands without end: {sent:?}");
        }
        sent
    }

    fn reply(&mut self, reply: Reply<'_>) {
        let payload: Vec<u8> = (0..reply.len()).map(|at| reply.byte(at)).collect();
        let event = Event::Frame(Frame { id: reply.id().code(), payload: &payload });
        if let Some(notice) = self.session.handle(self.now, &event) {
            self.notices.push(std::format!("{notice:?}"));
        }
    }

    fn status(&mut self, id: CommandId, status: Status) {
        self.reply(Reply::status_only(id, status));
    }

    /// A healthy gripper's answer to one of the session's own requests.
    fn answer(&mut self, id: CommandId) {
        self.reply(Reply::success(match id {
            CommandId::GetSystemInfo => Value::GetSystemInfo(INFO),
            CommandId::GetSystemLimits => Value::GetSystemLimits(LIMITS),
            CommandId::GetSystemState => Value::GetSystemState(SystemFlags::REFERENCED),
            CommandId::GetGripperState => Value::GetGripperState(GripperState::Idle),
            other => return self.status(other, Status::Success),
        }));
    }

    /// Lets `ms` pass with a gripper that answers the session's own requests, and nothing else.
    fn pass_answered(&mut self, ms: u32) {
        for _ in 0..ms {
            for command in self.pass(1) {
                if command.id().kind() == Kind::Query {
                    self.answer(command.id());
                }
            }
        }
    }

    fn noticed(&self, text: &str) -> usize {
        self.notices.iter().filter(|notice| notice.starts_with(text)).count()
    }
}

#[test]
fn connecting_subscribes_to_the_states_first_and_asks_for_device_and_limits() {
    let mut desk = Desk::new();
    assert!(!desk.session.is_connected());
    let mut asked = vec![];
    for _ in 0..4 {
        for command in desk.sent() {
            asked.push(command);
            desk.answer(command.id());
        }
    }
    assert!(desk.session.is_connected());
    let update = AutoUpdate::on_change(10);
    let expected = [
        Command::GetSystemState { update },
        Command::GetGripperState { update },
        Command::GetSystemInfo,
        Command::GetSystemLimits,
    ];
    assert_eq!(asked, expected);
    assert_eq!(desk.notices, ["Connected"]);
    assert_eq!(desk.session.known().limits, Some(LIMITS));
}

#[test]
fn motion_is_pending_and_then_done_while_queries_go_on() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.sent(), [GRIP]);
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.session.request(Command::GetTemperature).unwrap();
    assert_eq!(desk.sent(), [Command::GetTemperature]);
    desk.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    desk.status(CommandId::GripPart, Status::Success);
    assert_eq!(desk.noticed("Pending(GripPart)"), 1);
    assert_eq!(desk.noticed("Answered(Reply { id: GetTemperature, status: Success"), 1);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
    assert_eq!(desk.session.motion(), None);
    assert_eq!(desk.session.counters().unasked, 0);
}

#[test]
fn second_motion_is_refused_while_one_runs() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.session.request(HOMING), Err(RequestError::MotionRunning), "while it waits");
    desk.sent();
    assert_eq!(desk.session.request(HOMING), Err(RequestError::MotionRunning), "while it is sent");
    desk.status(CommandId::GripPart, Status::CmdPending);
    assert_eq!(desk.session.request(HOMING), Err(RequestError::MotionRunning), "while it runs");
    desk.status(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(desk.session.request(HOMING), Ok(()));
}

#[test]
fn motion_without_an_answer_is_never_sent_again() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    let sent = desk.pass(5_000);
    assert_eq!(sent.iter().filter(|command| **command == GRIP).count(), 1);
    assert_eq!(desk.noticed("Unanswered(GripPart)"), 1);
    assert_eq!(desk.noticed("Disconnected"), 1);
}

#[test]
fn query_without_an_answer_is_repeated_and_then_the_link_is_lost() {
    let mut desk = Desk::connected();
    desk.session.request(Command::GetTemperature).unwrap();
    let sent = desk.pass(599);
    assert_eq!(sent.iter().filter(|command| **command == Command::GetTemperature).count(), 3);
    desk.pass(1);
    assert_eq!(desk.notices.first().map(|notice| &notice[..]), Some("Unanswered(GetTemperature)"));
    assert_eq!(desk.noticed("Disconnected"), 1);
    assert_eq!(desk.session.known(), &Known::NOTHING);
}

#[test]
fn silence_is_noticed_within_a_second_and_a_gripper_that_comes_back_is_found() {
    let mut desk = Desk::connected();
    desk.pass(1_000);
    assert_eq!(desk.notices, ["Disconnected"]);
    let asked = desk.pass(3_000);
    assert!(asked.iter().all(|command| *command == STATE), "{asked:?}");
    assert!(asked.len() >= 3);
    desk.connect();
    assert_eq!(desk.notices, ["Disconnected", "Connected"]);
}

#[test]
fn subscriptions_are_renewed_in_turn_so_that_a_restarted_gripper_is_noticed() {
    let mut desk = Desk::connected();
    let mut asked = vec![];
    for _ in 0..1_010 {
        for command in desk.pass(1) {
            asked.push(command.id());
            desk.answer(command.id());
        }
    }
    let (state, gripper) = (CommandId::GetSystemState, CommandId::GetGripperState);
    assert_eq!(asked, [state, gripper, state, gripper]);
}

#[test]
fn nothing_asked_for_before_a_disconnect_leaves_after_it() {
    let mut desk = Desk::connected();
    desk.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    desk.session.request(GRIP).unwrap();
    let sent = desk.pass(2_000);
    assert!(!sent.contains(&GRIP));
    assert_eq!(desk.noticed("Unanswered(SetForceLimit)"), 1);
    assert_eq!(desk.noticed("Withdrawn(GripPart)"), 1);
    desk.connect();
    assert!(desk.pass(200).iter().all(|command| command.id().kind() == Kind::Query));
}

#[test]
fn two_requests_that_run_out_at_the_same_moment_lose_the_connection_once_and_leave_nothing_behind() {
    let mut desk = Desk::connected();
    // The regular question is due at 250 ms; at its last attempt a motion goes out with it.
    let before = desk.pass(250 + 2 * 200 - 1);
    assert_eq!(before.len(), 2, "{before:?}");
    desk.now = desk.now.plus(1);
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.sent().len(), 2, "both leave at one moment");
    desk.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    desk.pass(1_000);
    assert_eq!(desk.noticed("Unanswered(GripPart)"), 1);
    assert_eq!(desk.noticed("Withdrawn(SetForceLimit)"), 1);
    assert_eq!(desk.noticed("Disconnected"), 1);
    desk.connect();
    let after = desk.pass(300);
    assert!(after.iter().all(|command| command.id().kind() == Kind::Query), "{after:?}");
}

#[test]
fn stop_overtakes_what_waits_and_ends_the_motion() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.sent(), [Command::Stop]);
    assert_eq!(desk.noticed("Withdrawn(SetForceLimit)"), 1);
    desk.status(CommandId::GripPart, Status::CmdAborted);
    desk.status(CommandId::Stop, Status::Success);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: CmdAborted"), 1);
    assert_eq!(desk.noticed("Answered(Reply { id: Stop, status: Success"), 1);
}

#[test]
fn stop_that_is_not_answered_is_told_before_the_connection_counts_as_lost_and_does_not_leave_after_it() {
    let mut desk = Desk::connected();
    desk.session.request(Command::Stop).unwrap();
    let sent = desk.pass(2_000);
    assert_eq!(sent.iter().filter(|command| **command == Command::Stop).count(), 3);
    assert_eq!(desk.notices, ["Late(Stop)", "Late(Stop)", "Unanswered(Stop)", "Disconnected"]);
    desk.connect();
    assert!(!desk.pass(300).contains(&Command::Stop));
}

#[test]
fn stop_without_a_connection_is_sent_at_once_and_never_later() {
    let mut desk = Desk::connected();
    desk.pass(1_000);
    assert_eq!(desk.notices, ["Disconnected"]);
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.sent(), [Command::Stop]);
    let sent = desk.pass(3_000);
    assert!(!sent.contains(&Command::Stop), "once: {sent:?}");
    assert_eq!(desk.noticed("Unanswered(Stop)"), 1);
    desk.connect();
    assert!(!desk.pass(300).contains(&Command::Stop), "and not after the reconnect");
}

#[test]
fn stop_without_a_connection_that_is_answered_brings_the_connection_back() {
    let mut desk = Desk::connected();
    desk.pass(1_000);
    desk.session.request(Command::Stop).unwrap();
    desk.sent();
    desk.status(CommandId::Stop, Status::Success);
    assert_eq!(desk.noticed("Answered(Reply { id: Stop, status: Success"), 1);
    assert_eq!(desk.sent(), [STATE]);
}

#[test]
fn statistics_that_are_reset_by_reading_are_read_once() {
    for (reset, times) in [(true, 1), (false, 3)] {
        let mut desk = Desk::connected();
        let command = Command::GetGrippingStatistics { reset };
        desk.session.request(command).unwrap();
        let sent = desk.pass(3_000);
        assert_eq!(sent.iter().filter(|sent| **sent == command).count(), times, "reset: {reset}");
        assert_eq!(desk.noticed("Unanswered(GetGrippingStatistics)"), 1);
    }
}

#[test]
fn fast_stop_goes_first_and_is_repeated_until_it_is_confirmed() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.session.request(Command::FastStop).unwrap();
    let sent = desk.pass(10_000);
    assert!(!sent.contains(&GRIP), "what waited is withdrawn");
    assert_eq!(sent.first(), Some(&Command::FastStop));
    let stops = sent.iter().filter(|command| **command == Command::FastStop).count();
    assert!(stops >= 40, "over the disconnect, without end: {stops}");
    desk.status(CommandId::FastStop, Status::CmdFormatError);
    assert!(desk.session.owes_fast_stop(), "only E_SUCCESS confirms it");
    desk.status(CommandId::FastStop, Status::Success);
    assert!(!desk.session.owes_fast_stop());
    desk.connect();
    assert!(!desk.pass(100).contains(&Command::FastStop), "and it is not sent again");
}

#[test]
fn what_else_the_gripper_answers_does_not_confirm_a_fast_stop() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.sent(), [Command::FastStop]);
    for late in [CommandId::GetSystemState, CommandId::GetSystemInfo, CommandId::GetGripperState] {
        desk.answer(late);
        assert!(desk.session.owes_fast_stop(), "{late:?}");
    }
    desk.status(CommandId::Stop, Status::Success);
    assert!(desk.session.owes_fast_stop());
    assert!(desk.pass(250).contains(&Command::FastStop), "it is repeated");
}

#[test]
fn answer_that_comes_before_its_fast_stop_has_left_does_not_confirm_it() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    desk.sent();
    desk.status(CommandId::FastStop, Status::Success);
    assert!(!desk.session.owes_fast_stop());
    // Doubled on the line; meanwhile another FAST STOP was asked for, and the line has no room for it yet.
    desk.session.request(Command::FastStop).unwrap();
    desk.status(CommandId::FastStop, Status::Success);
    assert!(desk.session.owes_fast_stop());
    assert_eq!(desk.sent(), [Command::FastStop]);
    let unasked = desk.session.counters().unasked;
    desk.status(CommandId::FastStop, Status::Success);
    assert_eq!((desk.session.owes_fast_stop(), desk.session.counters().unasked), (false, unasked));
    desk.status(CommandId::FastStop, Status::Success);
    assert_eq!(desk.session.counters().unasked, unasked + 1, "nothing waits for it");
}

#[test]
fn stop_behind_a_fast_stop_that_is_not_confirmed_is_refused_and_not_sent_later() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.session.request(Command::Stop), Err(RequestError::FastStopRunning));
    assert_eq!(desk.sent(), [Command::FastStop]);
    assert_eq!(desk.session.request(Command::Stop), Err(RequestError::FastStopRunning));
    desk.status(CommandId::FastStop, Status::Success);
    assert_eq!(desk.sent(), []);
    assert_eq!(desk.session.request(Command::Stop), Ok(()), "it is confirmed");
}

#[test]
fn fast_stop_is_the_first_thing_that_a_gripper_hears() {
    let mut desk = Desk::new();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.sent(), [Command::FastStop]);
    assert_eq!(desk.session.request(Command::ACKNOWLEDGE), Err(RequestError::NotConnected));
    desk.status(CommandId::FastStop, Status::Success);
    assert_eq!(desk.sent(), [STATE]);
}

#[test]
fn fast_stop_is_never_acknowledged_by_the_session() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.session.request(Command::ACKNOWLEDGE), Err(RequestError::FastStopRunning));
    desk.sent();
    desk.status(CommandId::FastStop, Status::Success);
    desk.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED | SystemFlags::FAST_STOP)));
    for _ in 0..3 {
        assert!(!desk.pass(3_000).contains(&Command::ACKNOWLEDGE));
        desk.connect();
    }
}

#[test]
fn acknowledgement_without_an_answer_is_not_repeated() {
    let mut desk = Desk::connected();
    desk.session.request(Command::ACKNOWLEDGE).unwrap();
    let sent = desk.pass(3_000);
    assert_eq!(sent.iter().filter(|command| **command == Command::ACKNOWLEDGE).count(), 1);
    assert_eq!(desk.noticed("Unanswered(Acknowledge)"), 1);
}

#[test]
fn lost_result_is_given_up_once_the_gripper_stands_still() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
    desk.pass(100);
    desk.reply(Reply::success(Value::GetGripperState(GripperState::Holding)));
    desk.pass_answered(900);
    assert_eq!(desk.noticed("Unanswered"), 0, "a result may be a little late");
    desk.pass_answered(200);
    assert_eq!(desk.noticed("Unanswered(GripPart)"), 1);
    assert!(desk.session.is_connected());
}

#[test]
fn slow_motion_is_waited_for_while_the_gripper_reports_it() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    for _ in 0..30_000 {
        for command in desk.pass(1) {
            match command.id() {
                CommandId::GetGripperState => {
                    desk.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
                }
                id => desk.answer(id),
            }
        }
    }
    assert_eq!(desk.noticed("Unanswered"), 0);
    desk.status(CommandId::GripPart, Status::Success);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
}

#[test]
fn late_result_of_an_earlier_motion_is_not_taken_for_that_of_a_new_one() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.pass(5_000);
    desk.connect();
    desk.notices.clear();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::Success); // of the first
    assert_eq!(desk.notices, [""; 0]);
    assert_eq!(desk.session.counters().unasked, 1);
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.status(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: CmdFailed"), 1);
}

#[test]
fn answer_that_comes_before_its_request_has_left_is_not_taken_for_its_answer() {
    for (command, status) in [(Command::TareForceSensor, Status::Success), (GRIP, Status::AccessDenied)] {
        let mut desk = Desk::connected();
        desk.session.request(command).unwrap();
        assert_eq!(desk.session.tick(desk.now), None);
        desk.status(command.id(), status);
        assert_eq!(desk.notices, [""; 0]);
        assert_eq!(desk.session.counters().unasked, 1);
        assert_eq!(desk.sent(), [command]);
        desk.status(command.id(), status);
        assert_eq!(desk.noticed("Answered"), 1);
    }
}

#[test]
fn unasked_and_forbidden_frames_are_counted_and_change_nothing() {
    let mut desk = Desk::connected();
    desk.status(CommandId::Homing, Status::Success);
    desk.status(CommandId::Unknown(0xB0), Status::Success);
    assert_eq!(desk.session.counters().unasked, 2);
    let undefined = Event::Frame(Frame { id: 0x41, payload: &[0, 0, 9] });
    assert_eq!(desk.session.handle(desk.now, &undefined), None);
    assert_eq!(desk.session.counters().refused, 1);
    assert_eq!(desk.session.known().state, Some(GripperState::Idle));
    assert_eq!(desk.notices, [""; 0]);
}

#[test]
fn updates_are_reported_as_they_come() {
    let mut desk = Desk::connected();
    desk.reply(Reply::success(Value::GetGripperState(GripperState::PartLost)));
    assert_eq!(desk.notices, ["Reported(GetGripperState(PartLost))"]);
    assert_eq!(desk.session.known().state, Some(GripperState::PartLost));
    assert_eq!(desk.session.counters().unasked, 0);
}

#[test]
fn error_status_is_the_answer_of_a_motion_that_did_not_begin() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::AccessDenied);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: AccessDenied"), 1);
    assert_eq!(desk.session.motion(), None);
}

#[test]
fn number_that_is_not_finite_is_refused_before_it_is_sent() {
    let mut desk = Desk::connected();
    let refused = desk.session.request(Command::GripPart { width: f32::NAN, speed: 50.0 });
    assert_eq!(refused, Err(RequestError::Invalid(Refusal::NotFinite)));
    assert_eq!(desk.sent(), []);
}

#[test]
fn queue_that_is_full_refuses_and_loses_nothing() {
    let mut desk = Desk::connected();
    for _ in 0..QUEUE_LEN {
        desk.session.request(Command::GetTemperature).unwrap();
    }
    assert_eq!(desk.session.request(Command::GetTemperature), Err(RequestError::QueueFull));
    for _ in 0..QUEUE_LEN {
        assert_eq!(desk.sent(), [Command::GetTemperature]);
        desk.reply(Reply::success(Value::GetTemperature(crate::Temperature(0))));
    }
    assert_eq!(desk.sent(), []);
}

#[test]
fn finger_supply_may_be_switched_on_beside_a_motion() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.session.request(Command::Finger1Power { enabled: true }).unwrap();
    desk.sent();
    desk.status(CommandId::Finger1Power, Status::CmdPending);
    desk.status(CommandId::GripPart, Status::Success);
    desk.status(CommandId::Finger1Power, Status::Success);
    assert_eq!(desk.noticed("Answered(Reply { id: Finger1Power, status: Success"), 1);
    assert_eq!(desk.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
}

#[test]
fn time_out_is_told_in_advance() {
    let mut desk = Desk::connected();
    let mut checked = 0;
    for step in 0..4_000 {
        if step == 100 {
            desk.session.request(GRIP).unwrap();
        }
        let due = desk.session.poll_timeout();
        let before = (desk.notices.len(), desk.session.is_connected());
        let sent = desk.pass(1);
        let happened = !sent.is_empty() || before != (desk.notices.len(), desk.session.is_connected());
        if happened && step != 100 {
            checked += 1;
            assert!(due.is_some_and(|due| desk.now.has_reached(due)), "{step}: {sent:?} was not announced");
        }
    }
    assert!(checked > 5, "{checked}");
}

const FORCE_40: Command<'static> = Command::SetForceLimit { force: 40.0 };

fn verifying() -> Desk {
    let mut desk = Desk::with(Config { verify_settings: true, ..Config::DEFAULT });
    desk.connect();
    desk.notices.clear();
    desk
}

/// Sets the force limit and has it read back as this; what is noticed then.
fn read_back(force: f32, read: f32) -> Vec<std::string::String> {
    let mut desk = verifying();
    desk.session.request(Command::SetForceLimit { force }).unwrap();
    desk.sent();
    desk.status(CommandId::SetForceLimit, Status::Success);
    assert_eq!(desk.notices, [""; 0], "confirmed is not answered");
    assert_eq!(desk.sent(), [Command::GetForceLimit]);
    assert!(desk.session.is_busy());
    desk.reply(Reply::success(Value::GetForceLimit(read)));
    assert!(!desk.session.is_busy());
    assert_eq!(desk.session.counters().unasked, 0);
    desk.notices
}

fn answered(id: CommandId, status: Status) -> std::string::String {
    std::format!("{:?}", Notice::Answered(Reply::status_only(id, status)))
}

#[test]
fn setting_is_answered_once_it_was_read_back() {
    let success = [answered(CommandId::SetForceLimit, Status::Success)];
    assert_eq!(read_back(40.0, 40.0), success);
    assert_eq!(read_back(40.0, 40.02), success, "in steps of the gripper's own");
    assert_eq!(read_back(1.0, 5.0), success, "clamped to the least force");
    assert_eq!(read_back(100.0, 80.0), success, "clamped to the nominal force");
    assert_eq!(read_back(500.0, 120.0), success, "clamped to the overdrive force");
}

#[test]
fn setting_that_the_gripper_did_not_take_over_is_a_mismatch() {
    let mismatch = [answered(CommandId::SetForceLimit, MISMATCH)];
    assert_eq!(read_back(40.0, 41.0), mismatch);
    assert_eq!(read_back(40.0, 80.0), mismatch);
    for setting in [CommandId::SetAcceleration, CommandId::SetForceLimit, CommandId::SetSoftLimits] {
        assert!(!setting.may_answer(MISMATCH), "no gripper says it");
    }
}

#[test]
fn other_settings_are_read_back_too() {
    let mut desk = verifying();
    desk.session.request(Command::SetAcceleration { acceleration: 9_999.0 }).unwrap();
    desk.sent();
    desk.status(CommandId::SetAcceleration, Status::Success);
    assert_eq!(desk.sent(), [Command::GetAcceleration]);
    desk.reply(Reply::success(Value::GetAcceleration(5_000.0)));
    let limits = crate::SoftLimits { minus: 10.0, plus: 90.0 };
    desk.session.request(Command::SetSoftLimits { limits }).unwrap();
    desk.sent();
    desk.status(CommandId::SetSoftLimits, Status::Success);
    assert_eq!(desk.sent(), [Command::GetSoftLimits]);
    desk.status(CommandId::GetSoftLimits, Status::NotAvailable);
    let expected =
        [answered(CommandId::SetAcceleration, Status::Success), answered(CommandId::SetSoftLimits, MISMATCH)];
    assert_eq!(desk.notices, expected);
}

#[test]
fn setting_that_was_refused_is_not_read_back() {
    let mut desk = verifying();
    desk.session.request(FORCE_40).unwrap();
    desk.sent();
    desk.status(CommandId::SetForceLimit, Status::CmdFormatError);
    assert_eq!(desk.notices, [answered(CommandId::SetForceLimit, Status::CmdFormatError)]);
    assert_eq!(desk.sent(), []);
}

#[test]
fn next_request_waits_for_the_read_back() {
    let mut desk = verifying();
    desk.session.request(FORCE_40).unwrap();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.sent(), [FORCE_40]);
    desk.status(CommandId::SetForceLimit, Status::Success);
    assert_eq!(desk.sent(), [Command::GetForceLimit]);
    desk.reply(Reply::success(Value::GetForceLimit(40.0)));
    assert_eq!(desk.sent(), [GRIP]);
}

#[test]
fn read_back_without_an_answer_leaves_the_setting_unanswered() {
    let mut desk = verifying();
    desk.session.request(FORCE_40).unwrap();
    desk.sent();
    desk.status(CommandId::SetForceLimit, Status::Success);
    let asked = desk.pass(2_000).into_iter().filter(|command| *command == Command::GetForceLimit).count();
    assert_eq!(asked, 3);
    assert_eq!(desk.notices, ["Unanswered(SetForceLimit)", "Disconnected"]);
}

#[test]
fn stop_does_not_take_a_read_back_away() {
    let mut desk = verifying();
    desk.session.request(FORCE_40).unwrap();
    desk.sent();
    desk.status(CommandId::SetForceLimit, Status::Success);
    desk.session.request(Command::Stop).unwrap();
    desk.session.withdraw();
    assert_eq!(desk.sent(), [Command::Stop, Command::GetForceLimit]);
    desk.reply(Reply::success(Value::GetForceLimit(40.0)));
    assert_eq!(desk.notices, [answered(CommandId::SetForceLimit, Status::Success)]);
}

#[test]
fn command_with_time_outs_of_its_own_is_waited_for_that_long() {
    let script = CommandId::Unknown(0xB0);
    const TIMEOUTS: &[Timeout] = &[
        Timeout { id: CommandId::Unknown(0xB0), reply_ms: 2_000, result_ms: 5_000 },
        Timeout { id: CommandId::GripPart, reply_ms: 200, result_ms: 700 },
    ];
    let mut desk = Desk::with(Config { timeouts: TIMEOUTS, ..Config::DEFAULT });
    desk.connect();
    desk.notices.clear();
    desk.session.request(Command::Unknown { id: 0xB0, payload: &[] }).unwrap();
    desk.pass_answered(1_900);
    assert_eq!(desk.noticed("Unanswered"), 0);
    desk.status(script, Status::CmdPending);
    desk.pass_answered(900);
    assert_eq!(desk.noticed("Unanswered"), 0);
    desk.status(script, Status::Success);
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
    for _ in 0..699 {
        for command in desk.pass(1) {
            match command.id() {
                CommandId::GetGripperState => {
                    desk.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
                }
                id => desk.answer(id),
            }
        }
    }
    assert_eq!(desk.noticed("Unanswered"), 0);
    desk.pass(2);
    assert_eq!(desk.noticed("Unanswered(GripPart)"), 1);
    assert!(desk.session.is_connected());
}

#[test]
fn subscription_is_asked_for_at_once_and_again_after_a_reconnect() {
    let mut desk = Desk::connected();
    let update = AutoUpdate::every(50);
    let force = Command::GetForce { update };
    desk.session.subscribe(Signal::Force, update);
    assert_eq!(desk.sent(), [force]);
    desk.reply(Reply::success(Value::GetForce(1.0)));
    desk.reply(Reply::success(Value::GetForce(2.0)));
    assert_eq!(desk.notices, ["Reported(GetForce(1.0))", "Reported(GetForce(2.0))"]);
    assert_eq!(desk.session.known().force, Some(2.0));
    desk.pass(1_000);
    assert_eq!(desk.noticed("Disconnected"), 1);

    let mut asked = vec![];
    for _ in 0..2_000 {
        if desk.session.is_connected() {
            break;
        }
        for command in desk.pass(1) {
            asked.push(command);
            match command.id() {
                CommandId::GetForce => desk.reply(Reply::success(Value::GetForce(3.0))),
                id => desk.answer(id),
            }
        }
    }
    assert_eq!(asked.last(), Some(&force));
}

#[test]
fn each_signal_has_a_period_of_its_own() {
    let mut desk = Desk::new();
    for (signal, period_ms) in Signal::ALL.into_iter().zip([20, 30, 40, 50, 5]) {
        desk.session.subscribe(signal, AutoUpdate::on_change(period_ms));
    }
    let mut asked = vec![];
    for _ in 0..50 {
        for command in desk.pass(1) {
            asked.push(command);
            match command.id() {
                CommandId::GetOpeningWidth => desk.reply(Reply::success(Value::GetOpeningWidth(0.0))),
                CommandId::GetSpeed => desk.reply(Reply::success(Value::GetSpeed(0.0))),
                CommandId::GetForce => desk.reply(Reply::success(Value::GetForce(0.0))),
                id => desk.answer(id),
            }
        }
    }
    let update = AutoUpdate::on_change;
    let expected = [
        Command::GetSystemState { update: update(20) },
        Command::GetGripperState { update: update(30) },
        Command::GetSystemInfo,
        Command::GetSystemLimits,
        Command::GetOpeningWidth { update: update(40) },
        Command::GetSpeed { update: update(50) },
        Command::GetForce { update: update(10) },
    ];
    assert_eq!(asked, expected);
}

#[test]
fn subscription_that_ends_is_ended_at_the_gripper() {
    let mut desk = Desk::with(Config { width: true, ..Config::DEFAULT });
    for _ in 0..20 {
        for command in desk.pass(1) {
            match command.id() {
                CommandId::GetOpeningWidth => desk.reply(Reply::success(Value::GetOpeningWidth(0.0))),
                id => desk.answer(id),
            }
        }
    }
    assert!(desk.session.is_connected());
    desk.session.subscribe(Signal::Width, AutoUpdate::once());
    assert_eq!(desk.sent(), [Command::GetOpeningWidth { update: AutoUpdate::once() }]);
    desk.reply(Reply::success(Value::GetOpeningWidth(0.0)));
    desk.notices.clear();
    desk.reply(Reply::success(Value::GetOpeningWidth(1.0)));
    assert_eq!(desk.notices, [""; 0]);
    assert_eq!(desk.session.counters().unasked, 1);
}

#[test]
fn to_ask_once_does_not_end_a_subscription() {
    let mut desk = Desk::connected();
    desk.session.request(Command::GetGripperState { update: AutoUpdate::once() }).unwrap();
    assert_eq!(desk.sent(), [Command::GetGripperState { update: AutoUpdate::on_change(10) }]);
    desk.answer(CommandId::GetGripperState);
    desk.session.request(Command::GetSpeed { update: AutoUpdate::once() }).unwrap();
    assert_eq!(desk.sent(), [Command::GetSpeed { update: AutoUpdate::once() }]);
}

#[test]
fn lent_command_is_sent_when_it_is_at_hand_and_repeated_while_it_is() {
    let mut desk = Desk::connected();
    let text = std::string::String::from("left");
    let tag = Command::SetDeviceTag { tag: crate::DeviceTag::new(&text).unwrap() };
    desk.session.request_lent(&tag).unwrap();
    assert_eq!(desk.sent(), [], "it is not at hand");
    assert_eq!(desk.session.poll_transmit_lent(desk.now, Some(Command::GetTemperature)), None);
    assert_eq!(desk.session.poll_transmit_lent(desk.now, Some(tag)), Some(tag));
    assert_eq!(desk.session.poll_transmit_lent(desk.now, Some(tag)), None);
    desk.now = desk.now.plus(200);
    desk.sent();
    assert_eq!(desk.session.poll_transmit_lent(desk.now, Some(tag)), Some(tag));
    desk.status(CommandId::SetDeviceTag, Status::Success);
    assert_eq!(desk.notices, [answered(CommandId::SetDeviceTag, Status::Success)]);
}

#[test]
fn what_is_withdrawn_does_not_leave_and_what_was_lent_is_not_repeated() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.session.withdraw();
    assert_eq!(desk.sent(), []);
    assert!(!desk.session.is_busy());

    let echo = Command::Loop { data: crate::LoopData::new(&[1]).unwrap() };
    desk.session.request_lent(&echo).unwrap();
    desk.sent();
    assert_eq!(desk.session.poll_transmit_lent(desk.now, Some(echo)), Some(echo));
    desk.session.withdraw();
    assert!(desk.session.is_busy(), "its answer may still come");
    desk.pass_answered(201);
    assert!(!desk.session.is_busy());
    assert!(desk.session.is_connected());
    assert_eq!(desk.noticed("Unanswered"), 0);
}

#[test]
fn motion_that_the_caller_did_not_send_is_taken_back() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.sent(), [GRIP]);
    assert!(!desk.session.take_back(CommandId::Homing));
    assert!(desk.session.take_back(CommandId::GripPart));
    assert_eq!(desk.session.motion(), None);
    assert_eq!(desk.session.request(HOMING), Ok(()));
}

#[test]
fn connection_that_the_caller_knows_is_gone_is_given_up_at_once() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.status(CommandId::GripPart, Status::CmdPending);
    desk.session.disconnect();
    desk.sent();
    assert_eq!(desk.notices, ["Pending(GripPart)", "Unanswered(GripPart)", "Disconnected"]);
    assert_eq!(desk.session.known(), &Known::NOTHING);
    desk.connect();
}

#[test]
fn stop_of_a_connection_that_the_caller_gives_up_is_sent_again_only_if_it_is_a_fast_stop_that_is_not_confirmed()
 {
    for (command, again) in [(Command::FastStop, true), (Command::Stop, false)] {
        let mut desk = Desk::connected();
        desk.session.request(command).unwrap();
        assert_eq!(desk.sent(), [command]);
        assert_eq!(desk.sent(), []);
        desk.session.disconnect();
        assert_eq!(desk.sent().contains(&command), again);
        desk.status(command.id(), Status::Success);
        desk.session.disconnect();
        assert!(!desk.sent().contains(&command));
    }
}

#[test]
fn fast_stop_that_is_owed_while_the_line_is_down_does_not_make_the_caller_spin() {
    let mut desk = Desk::with(Config { reconnect_ms: 50, ..Config::DEFAULT });
    desk.connect();
    desk.session.request(Command::FastStop).unwrap();
    for _ in 0..5_000 {
        desk.pass(1);
        assert!(desk.session.poll_timeout().is_none_or(|due| !desk.now.has_reached(due)));
    }
}

#[test]
fn connection_that_is_given_up_while_it_begins_is_tried_again_at_once() {
    let mut desk = Desk::new();
    assert_eq!(desk.sent(), [STATE]);
    desk.answer(CommandId::GetSystemState);
    assert_eq!(desk.sent(), [Command::GetGripperState { update: AutoUpdate::on_change(10) }]);
    desk.session.disconnect();
    assert_eq!(desk.session.known(), &Known::NOTHING);
    assert_eq!(desk.sent(), [STATE]);
    assert_eq!(desk.notices, [""; 0], "there was none to lose");
}

#[test]
fn connection_that_is_given_up_twice_still_tells_what_was_open() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.sent();
    desk.session.disconnect();
    desk.session.disconnect();
    desk.sent();
    assert_eq!(desk.notices, ["Unanswered(GripPart)", "Disconnected"]);
}

#[test]
fn time_out_that_is_told_lies_ahead_whether_the_gripper_answers_or_not() {
    let mut desk = Desk::connected();
    for step in 0..4_000 {
        for command in desk.pass(1) {
            if step < 2_000 {
                desk.answer(command.id());
            }
        }
        desk.sent();
        assert!(desk.session.poll_timeout().is_some_and(|due| !desk.now.has_reached(due)), "{step}");
    }
}

#[test]
fn motion_that_is_next_to_be_sent_is_withdrawn() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.session.tick(desk.now), None);
    desk.session.withdraw();
    assert_eq!(desk.sent(), []);
    assert!(!desk.session.is_busy());
}

#[test]
fn query_is_not_taken_back() {
    let mut desk = Desk::connected();
    desk.session.request(Command::GetTemperature).unwrap();
    desk.sent();
    assert!(!desk.session.take_back(CommandId::GetTemperature));
    assert!(desk.session.is_busy());
}

#[test]
fn supply_that_is_being_switched_on_is_not_switched_again() {
    let mut desk = Desk::connected();
    desk.session.request(Command::Finger1Power { enabled: true }).unwrap();
    desk.sent();
    desk.status(CommandId::Finger1Power, Status::CmdPending);
    let again = desk.session.request(Command::Finger1Power { enabled: false });
    assert_eq!(again, Err(RequestError::MotionRunning));
    assert_eq!(desk.session.request(Command::Finger2Power { enabled: true }), Ok(()), "the other one may be");
}

#[test]
fn request_behind_a_stop_waits_until_the_stop_is_answered() {
    let mut desk = Desk::connected();
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.sent(), [Command::Stop]);
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.sent(), []);
    desk.status(CommandId::Stop, Status::Success);
    assert_eq!(desk.sent(), [GRIP]);
}

#[test]
fn nothing_is_reported_before_the_connection_stands() {
    let mut desk = Desk::new();
    desk.sent();
    desk.answer(CommandId::GetGripperState);
    assert_eq!(desk.notices, [""; 0]);
    assert_eq!(desk.session.counters().unasked, 1);
}

#[test]
fn setting_may_be_off_by_a_thousandth_and_no_more() {
    for (read, status) in [(3_002.0, Status::Success), (2_998.0, Status::Success), (3_004.0, MISMATCH)] {
        let mut desk = verifying();
        desk.session.request(Command::SetAcceleration { acceleration: 3_000.0 }).unwrap();
        desk.sent();
        desk.status(CommandId::SetAcceleration, Status::Success);
        desk.sent();
        desk.reply(Reply::success(Value::GetAcceleration(read)));
        assert_eq!(desk.notices, [answered(CommandId::SetAcceleration, status)], "{read}");
    }
}

#[test]
fn either_soft_limit_that_is_another_one_is_a_mismatch() {
    let limits = crate::SoftLimits { minus: 10.0, plus: 90.0 };
    for (minus, plus, status) in
        [(10.0, 90.0, Status::Success), (10.0, 80.0, MISMATCH), (20.0, 90.0, MISMATCH)]
    {
        let mut desk = verifying();
        desk.session.request(Command::SetSoftLimits { limits }).unwrap();
        desk.sent();
        desk.status(CommandId::SetSoftLimits, Status::Success);
        desk.sent();
        desk.reply(Reply::success(Value::GetSoftLimits(crate::SoftLimits { minus, plus })));
        assert_eq!(desk.notices, [answered(CommandId::SetSoftLimits, status)], "{minus} {plus}");
    }
}

#[test]
fn to_ask_once_ends_no_subscription_of_any_signal() {
    let mut desk = Desk::connected();
    let (update, once) = (AutoUpdate::on_change(70), AutoUpdate::once());
    for (ask, kept) in [
        (Command::GetSystemState { update: once }, Command::GetSystemState { update }),
        (Command::GetGripperState { update: once }, Command::GetGripperState { update }),
        (Command::GetOpeningWidth { update: once }, Command::GetOpeningWidth { update }),
        (Command::GetSpeed { update: once }, Command::GetSpeed { update }),
        (Command::GetForce { update: once }, Command::GetForce { update }),
    ] {
        desk.session.subscribe(Signal::of(ask.id()).unwrap(), update);
        desk.session.request(ask).unwrap();
        assert_eq!(desk.sent(), [kept, kept], "for the caller, and to have it changed");
        for _ in 0..2 {
            match kept.id() {
                CommandId::GetOpeningWidth => desk.reply(Reply::success(Value::GetOpeningWidth(0.0))),
                CommandId::GetSpeed => desk.reply(Reply::success(Value::GetSpeed(0.0))),
                CommandId::GetForce => desk.reply(Reply::success(Value::GetForce(0.0))),
                id => desk.answer(id),
            }
        }
        assert_eq!(desk.sent(), [], "it is confirmed");
    }
}

#[test]
fn update_that_is_asked_for_is_sent_as_it_is() {
    let mut desk = Desk::connected();
    let ask = Command::GetGripperState { update: AutoUpdate::every(70) };
    desk.session.request(ask).unwrap();
    assert_eq!(desk.sent(), [ask]);
}

#[test]
fn subscriptions_that_change_together_are_each_asked_for_once() {
    let mut desk = Desk::connected();
    let update = AutoUpdate::every(50);
    desk.session.subscribe(Signal::Width, update);
    desk.session.subscribe(Signal::Force, update);
    assert_eq!(desk.sent(), [Command::GetOpeningWidth { update }]);
    desk.reply(Reply::success(Value::GetOpeningWidth(0.0)));
    assert_eq!(desk.sent(), [Command::GetForce { update }]);
    desk.reply(Reply::success(Value::GetForce(0.0)));
    assert_eq!(desk.sent(), []);
}

#[test]
fn request_that_is_answered_once_is_not_answered_by_pending() {
    let mut desk = Desk::connected();
    desk.session.request(Command::GetTemperature).unwrap();
    desk.sent();
    desk.status(CommandId::GetTemperature, Status::CmdPending);
    assert_eq!(desk.notices, [""; 0]);
    assert_eq!(desk.session.counters().unasked, 1);
    desk.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    assert_eq!(desk.noticed("Answered(Reply { id: GetTemperature, status: Success"), 1);
}

#[test]
fn everything_that_the_gripper_tells_of_itself_is_known() {
    let mut desk = Desk::connected();
    desk.reply(Reply::success(Value::GetSystemState(SystemFlags::MOVING)));
    assert!(desk.session.known().is_moving(), "by its flags");
    desk.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)));
    assert!(!desk.session.known().is_moving());
    desk.reply(Reply::success(Value::GetGripperState(GripperState::Releasing)));
    assert!(desk.session.known().is_moving(), "by its state");
    desk.reply(Reply::success(Value::GetOpeningWidth(12.5)));
    desk.reply(Reply::success(Value::GetForce(3.5)));
    let known = Known {
        info: Some(INFO),
        limits: Some(LIMITS),
        flags: Some(SystemFlags::REFERENCED),
        state: Some(GripperState::Releasing),
        width: Some(12.5),
        force: Some(3.5),
    };
    assert_eq!(desk.session.known(), &known);
}

/// The times at which a FAST STOP that is never answered leaves, in milliseconds since it was requested, each once.
fn fast_stop_times(desk: &mut Desk, ms: u32) -> Vec<(u32, usize)> {
    let mut times = vec![];
    for at in 0..ms {
        let sent = desk.sent();
        assert!(sent.iter().all(|command| *command == Command::FastStop), "{at} ms: {sent:?}");
        if !sent.is_empty() {
            times.push((at, sent.len()));
        }
        desk.now = desk.now.plus(1);
    }
    times
}

#[test]
fn fast_stop_that_is_not_answered_goes_out_in_bursts_with_silence_between_them() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(
        fast_stop_times(&mut desk, 1_900),
        [(0, 1), (30, 130), (630, 130), (1_230, 130), (1_830, 130)]
    );
    assert_eq!(desk.noticed("Disconnected"), 1, "and nothing else left before or behind that");
}

#[test]
fn burst_of_fast_stops_is_longer_than_the_longest_message_and_one_of_them() {
    let burst = usize::from(FastStopPattern::DEFAULT.burst_frames) * crate::frame::OVERHEAD;
    assert!(burst >= crate::frame::MAX_MESSAGE_LEN + crate::frame::OVERHEAD);
}

#[test]
fn burst_of_fast_stops_ends_with_its_confirmation_and_what_waited_goes_on() {
    let mut desk = Desk::connected();
    desk.session.request(Command::FastStop).unwrap();
    desk.sent();
    desk.session.request(Command::GetTemperature).unwrap();
    desk.now = desk.now.plus(30);
    assert_eq!(desk.session.tick(desk.now), None);
    for _ in 0..5 {
        assert_eq!(desk.session.poll_transmit(desk.now), Some(Command::FastStop));
    }
    desk.status(CommandId::FastStop, Status::Success);
    assert_eq!(desk.sent(), [Command::GetTemperature]);
}

#[test]
fn fast_stop_behind_a_stop_without_an_answer_begins_with_a_burst() {
    let mut desk = Desk::connected();
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.pass(200), [Command::Stop, Command::Stop]);
    assert_eq!(desk.notices, ["Late(Stop)"]);
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.sent().len(), 130);
}

#[test]
fn fast_stop_behind_a_stop_that_may_still_be_answered_begins_with_one_frame() {
    let mut desk = Desk::connected();
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.sent(), [Command::Stop]);
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.sent(), [Command::FastStop]);
}

#[test]
fn query_that_became_due_while_a_fast_stop_had_the_line_leaves_right_behind_it() {
    let mut desk = Desk::connected();
    let due = desk.session.poll_timeout().unwrap();
    desk.session.request(Command::FastStop).unwrap();
    assert_eq!(desk.sent(), [Command::FastStop]);
    while !desk.now.has_reached(due.plus(5)) {
        desk.now = desk.now.plus(1);
        assert_eq!(desk.session.tick(desk.now), None);
    }
    desk.status(CommandId::FastStop, Status::Success);
    let sent = desk.sent();
    assert_eq!(sent.len(), 1, "{sent:?}");
    assert!(sent.iter().all(|command| command.id().kind() == Kind::Query));
}

#[test]
fn line_that_is_held_for_a_fast_stop_counts_as_lost_no_later_than_without_it() {
    for fast_stop_at in [0, 100, 300, 500, 700] {
        let mut desk = Desk::connected();
        desk.pass(fast_stop_at);
        desk.session.request(Command::FastStop).unwrap();
        desk.pass(900 - fast_stop_at);
        assert_eq!(desk.noticed("Disconnected"), 1, "FAST STOP after {fast_stop_at} ms of silence");
    }
}

#[test]
fn acknowledgement_withdraws_what_was_requested_before_it() {
    let mut desk = Desk::connected();
    desk.session.request(Command::GetTemperature).unwrap();
    assert_eq!(desk.sent(), [Command::GetTemperature]);
    let force = Command::SetForceLimit { force: 40.0 };
    for waiting in [GRIP, force, force, force] {
        desk.session.request(waiting).unwrap();
    }
    assert_eq!(desk.session.request(force), Err(RequestError::QueueFull));
    assert_eq!(desk.session.request(Command::ACKNOWLEDGE), Ok(()), "it makes room");
    desk.session.request(HOMING).unwrap_err();
    desk.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    assert_eq!(desk.sent(), [Command::ACKNOWLEDGE]);
    assert_eq!((desk.noticed("Withdrawn(GripPart)"), desk.noticed("Withdrawn(SetForceLimit)")), (1, 3));
    desk.session.request(HOMING).unwrap();
    assert_eq!(desk.sent(), [], "behind the answer");
    desk.status(CommandId::Acknowledge, Status::Success);
    assert_eq!(desk.sent(), [HOMING], "what was requested later is sent");
}

#[test]
fn motion_that_is_next_to_be_sent_is_withdrawn_by_an_acknowledgement() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.session.tick(desk.now), None);
    desk.session.request(Command::ACKNOWLEDGE).unwrap();
    assert_eq!(desk.sent(), [Command::ACKNOWLEDGE]);
    assert_eq!(desk.notices, ["Withdrawn(GripPart)"]);
}

#[test]
fn setting_that_was_overtaken_is_not_sent_again_and_its_outcome_is_told() {
    for overtakes in [Command::Stop, Command::FastStop, Command::ACKNOWLEDGE] {
        let mut desk = Desk::connected();
        let force = Command::SetForceLimit { force: 40.0 };
        desk.session.request(force).unwrap();
        assert_eq!(desk.sent(), [force]);
        desk.session.request(overtakes).unwrap();
        let mut sent = vec![];
        for _ in 0..600 {
            for command in desk.pass(1) {
                if command != overtakes || overtakes != Command::ACKNOWLEDGE {
                    desk.answer(command.id());
                }
                sent.push(command);
            }
        }
        assert!(!sent.contains(&force), "{overtakes:?}");
        assert_eq!(desk.noticed("Unanswered(SetForceLimit)"), 1, "{overtakes:?}");
    }
}

#[test]
fn request_waits_until_no_second_answer_to_an_earlier_one_of_its_id_can_come() {
    let mut desk = Desk::connected();
    let [first, second] = [40.0, 10.0].map(|force| Command::SetForceLimit { force });
    desk.session.request(first).unwrap();
    assert_eq!(desk.pass(200), [first, first], "the answer to the first is late");
    desk.status(CommandId::SetForceLimit, Status::Success);
    desk.session.request(second).unwrap();
    assert_eq!(desk.pass(10), []);
    desk.status(CommandId::SetForceLimit, Status::Success);
    assert_eq!(desk.noticed("Answered(Reply { id: SetForceLimit"), 1, "the second answer is nobody's");
    let sent = desk.pass(200);
    assert_eq!(sent.iter().filter(|command| command.id() == CommandId::SetForceLimit).count(), 1);
    desk.status(CommandId::SetForceLimit, Status::RangeError);
    assert_eq!(desk.noticed("Answered(Reply { id: SetForceLimit, status: RangeError"), 1);
}

#[test]
fn end_of_the_wait_for_a_second_answer_is_told_where_a_request_waits_for_it_and_not_else() {
    let force = Command::SetForceLimit { force: 40.0 };
    let doubled = || {
        let mut desk = Desk::connected();
        desk.session.request(force).unwrap();
        assert_eq!(desk.pass(200), [force, force]);
        desk.status(CommandId::SetForceLimit, Status::Success);
        desk
    };
    let mut waits = doubled();
    waits.session.request(force).unwrap();
    let mut due = None;
    while !waits.pass(1).contains(&force) {
        due = waits.session.poll_timeout();
    }
    assert_eq!(due, Some(waits.now), "told in advance");

    let mut quiet = doubled();
    while quiet.now.plus(1) != waits.now {
        quiet.pass(1);
    }
    assert_ne!(quiet.session.poll_timeout(), Some(waits.now), "nobody waits");
}

#[test]
fn setting_whose_repetition_was_due_when_it_was_overtaken_is_not_sent_again() {
    let mut desk = Desk::connected();
    let force = Command::SetForceLimit { force: 40.0 };
    desk.session.request(force).unwrap();
    assert_eq!(desk.sent(), [force]);
    desk.now = desk.now.plus(200);
    assert_eq!(desk.session.tick(desk.now), None, "the repetition is due");
    desk.session.request(Command::Stop).unwrap();
    assert_eq!(desk.sent(), [Command::Stop]);
    assert_eq!(desk.notices, ["Unanswered(SetForceLimit)"]);
}
