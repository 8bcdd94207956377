//! The session in virtual time. Each test plays the gripper.

mod force_limit;

use super::*;
use crate::types::{
    DeviceType, FirmwareVersion, GripperState, HomingDirection, SystemFlags, SystemInfo, SystemLimits,
};
use crate::{
    AutoUpdate, Command, CommandId, DecodeError, Event as FrameEvent, Frame, Instant, Kind, Payload, Reply,
    Status, Value,
};
use std::vec;
use std::vec::Vec;

const GRIP: Command<'static> = Command::GripPart { width: 20.0, speed: 50.0 };
const HOMING: Command<'static> = Command::Homing { direction: HomingDirection::Default };
/// The first commands of a connection.
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

/// A session with its clock and its events.
struct Rig {
    session: Session,
    now: Instant,
    events: Vec<std::string::String>,
}

impl Rig {
    fn new() -> Self {
        Self::with(Config::DEFAULT)
    }

    fn with(config: Config) -> Self {
        // Close to the end of the clock's range, so that every script also covers the wraparound.
        Self { session: Session::new(config), now: Instant::from_millis(u32::MAX - 400), events: vec![] }
    }

    fn connected() -> Self {
        let mut rig = Self::new();
        rig.connect();
        rig.events.clear();
        rig
    }

    /// Connects to a healthy gripper. Returns the sent commands.
    fn connect(&mut self) -> Vec<Command<'static>> {
        let mut sent = vec![];
        for _ in 0..2_000 {
            if self.session.is_connected() {
                return sent;
            }
            sent.extend(self.pass_healthy(1));
        }
        panic!("the session does not connect to a gripper that answers");
    }

    /// Requests a command, which is sent at once and alone.
    #[track_caller]
    fn send(&mut self, command: Command<'static>) {
        self.session.request(command).unwrap();
        assert_eq!(self.sent(), [command]);
    }

    /// Sends a command and answers it with a status.
    #[track_caller]
    fn exchange(&mut self, command: Command<'static>, status: Status) {
        self.send(command);
        self.status(command.id(), status);
    }

    /// Advances by `ms`, millisecond by millisecond. Returns the sent commands.
    fn pass(&mut self, ms: u32) -> Vec<Command<'static>> {
        let mut sent = self.sent();
        for _ in 0..ms {
            self.now = self.now.plus(1);
            sent.extend(self.sent());
        }
        sent
    }

    fn sent(&mut self) -> Vec<Command<'static>> {
        while let Some(event) = self.session.tick(self.now) {
            self.events.push(std::format!("{event:?}"));
            assert!(self.events.len() < 10_000, "endless events");
        }
        let mut sent = vec![];
        while let Some(command) = self.session.poll_transmit(self.now) {
            sent.push(command);
            assert!(sent.len() < 200, "endless commands: {sent:?}");
        }
        sent
    }

    fn reply(&mut self, reply: Reply<'_>) {
        let payload: Vec<u8> = (0..reply.len()).map(|at| reply.byte(at)).collect();
        let event = FrameEvent::Frame(Frame { id: reply.id().code(), payload: &payload });
        if let Some(event) = self.session.handle(self.now, &event) {
            self.events.push(std::format!("{event:?}"));
        }
    }

    fn status(&mut self, id: CommandId, status: Status) {
        self.reply(Reply::status_only(id, status));
    }

    /// Answers one of the session's own requests like a healthy gripper.
    fn answer(&mut self, id: CommandId) {
        self.reply(Reply::success(match id {
            CommandId::GetSystemInfo => Value::GetSystemInfo(INFO),
            CommandId::GetSystemLimits => Value::GetSystemLimits(LIMITS),
            CommandId::GetSystemState => Value::GetSystemState(SystemFlags::REFERENCED),
            CommandId::GetGripperState => Value::GetGripperState(GripperState::Idle),
            CommandId::GetOpeningWidth => Value::GetOpeningWidth(0.0),
            CommandId::GetSpeed => Value::GetSpeed(0.0),
            CommandId::GetForce => Value::GetForce(0.0),
            other => return self.status(other, Status::Success),
        }));
    }

    /// Advances by `ms` with a gripper that answers everything. Returns the sent commands.
    fn pass_healthy(&mut self, ms: u32) -> Vec<Command<'static>> {
        let mut sent = vec![];
        for _ in 0..ms {
            for command in self.pass(1) {
                self.answer(command.id());
                sent.push(command);
            }
        }
        sent
    }

    /// Advances by `ms` with a gripper that is gripping.
    fn pass_gripping(&mut self, ms: u32) {
        for _ in 0..ms {
            for command in self.pass(1) {
                match command.id() {
                    CommandId::GetGripperState => {
                        self.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
                    }
                    id => self.answer(id),
                }
            }
        }
    }

    /// Advances by `ms`, answering only the session's own requests.
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
        self.events.iter().filter(|event| event.starts_with(text)).count()
    }
}

#[test]
fn connect_subscribes_to_states_then_queries_device_and_limits() {
    let mut rig = Rig::new();
    assert!(!rig.session.is_connected());
    let update = AutoUpdate::on_change(10);
    let expected = [
        Command::GetSystemState { update },
        Command::GetGripperState { update },
        Command::GetSystemInfo,
        Command::GetSystemLimits,
    ];
    assert_eq!(rig.connect(), expected);
    assert_eq!(rig.events, ["Connected"]);
    assert_eq!(rig.session.known().limits, Some(LIMITS));
}

#[test]
fn motion_is_pending_and_then_done_while_queries_continue() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.send(Command::GetTemperature);
    rig.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    rig.status(CommandId::GripPart, Status::Success);
    assert_eq!(rig.noticed("Pending(GripPart)"), 1);
    assert_eq!(rig.noticed("Answered(Reply { id: GetTemperature, status: Success"), 1);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
    assert_eq!(rig.session.motion(), None);
    assert_eq!(rig.session.counters().unsolicited, 0);
}

#[test]
fn gripper_that_refuses_its_states_is_not_connected() {
    let mut rig = Rig::new();
    for _ in 0..2_000 {
        for command in rig.pass(1) {
            rig.status(command.id(), Status::AccessDenied);
        }
    }
    assert!(!rig.session.is_connected());
    assert_eq!(rig.noticed("Connected"), 0);
}

#[test]
fn update_period_is_as_configured_but_at_least_10_ms() {
    for (update_period_ms, asked_ms) in [(1, 10), (9, 10), (10, 10), (11, 11), (500, 500)] {
        let mut rig = Rig::with(Config { update_period_ms, ..Config::DEFAULT });
        let update = AutoUpdate::on_change(asked_ms);
        assert_eq!(rig.pass(1), [Command::GetSystemState { update }], "{update_period_ms} ms");
    }
}

#[test]
fn second_motion_is_refused_while_one_runs() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.session.request(HOMING), Err(RequestError::MotionRunning), "while the first is queued");
    rig.sent();
    assert_eq!(
        rig.session.request(HOMING),
        Err(RequestError::MotionRunning),
        "while the first awaits its answer"
    );
    rig.status(CommandId::GripPart, Status::CmdPending);
    assert_eq!(rig.session.request(HOMING), Err(RequestError::MotionRunning), "while the first runs");
    rig.status(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(rig.session.request(HOMING), Ok(()));
}

#[test]
fn motion_without_an_answer_is_never_sent_again() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    let sent = rig.pass(5_000);
    assert_eq!(sent.iter().filter(|command| **command == GRIP).count(), 1);
    assert_eq!(rig.noticed("Unanswered(GripPart)"), 1);
    assert_eq!(rig.noticed("Disconnected"), 1);
}

#[test]
fn unanswered_query_is_repeated_and_then_the_link_is_lost() {
    let mut rig = Rig::connected();
    rig.session.request(Command::GetTemperature).unwrap();
    let sent = rig.pass(599);
    assert_eq!(sent.iter().filter(|command| **command == Command::GetTemperature).count(), 3);
    rig.pass(1);
    assert_eq!(rig.events.first().map(|event| &event[..]), Some("Unanswered(GetTemperature)"));
    assert_eq!(rig.noticed("Disconnected"), 1);
    assert_eq!(rig.session.known(), &Known::NOTHING);
}

#[test]
fn silent_gripper_is_lost_within_1_s_and_found_when_it_returns() {
    let mut rig = Rig::connected();
    rig.pass(1_000);
    assert_eq!(rig.events, ["Disconnected"]);
    let asked = rig.pass(3_000);
    assert!(asked.iter().all(|command| *command == STATE), "{asked:?}");
    assert!(asked.len() >= 3);
    rig.connect();
    assert_eq!(rig.events, ["Disconnected", "Connected"]);
}

#[test]
fn subscriptions_are_renewed_in_turn_to_notice_a_restart() {
    let mut rig = Rig::connected();
    let asked: Vec<_> = rig.pass_healthy(1_010).iter().map(Command::id).collect();
    let (state, gripper) = (CommandId::GetSystemState, CommandId::GetGripperState);
    assert_eq!(asked, [state, gripper, state, gripper]);
}

#[test]
fn requests_pending_at_a_disconnect_are_never_sent_later() {
    let mut rig = Rig::connected();
    rig.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    rig.session.request(GRIP).unwrap();
    let sent = rig.pass(2_000);
    assert!(!sent.contains(&GRIP));
    assert_eq!(rig.noticed("Unanswered(SetForceLimit)"), 1);
    assert_eq!(rig.noticed("Withdrawn(GripPart)"), 1);
    rig.connect();
    assert!(rig.pass(200).iter().all(|command| command.id().kind() == Kind::Query));
}

#[test]
fn subscribed_values_stay_fresh_with_one_answer_in_four_lost() {
    const OLDEST_MS: u32 = 250;
    const ANSWER_MS: u32 = 5;
    let config = Config { refresh_ms: 150, width: true, speed: true, force: true, ..Config::DEFAULT };
    let mut rig = Rig::with(config);
    rig.connect();
    let ids = Topic::ALL.map(Topic::id);
    let mut refreshed = [rig.now; Topic::ALL.len()];
    let (mut asked, mut count) = (None, 0);
    for _ in 0..10_000 {
        if let Some(command) = rig.pass(1).pop() {
            count += 1;
            // The line is too fast for a second query before the answer to the first.
            asked = (count % 4 != 0).then_some((command.id(), rig.now.plus(ANSWER_MS)));
        }
        if let Some((id, at)) = asked
            && rig.now == at
        {
            rig.answer(id);
            let topic = ids.iter().position(|topic| *topic == id).expect("nothing else is requested");
            refreshed[topic] = rig.now;
        }
        let oldest = refreshed.iter().map(|at| rig.now.since(*at)).max().unwrap();
        assert!(oldest <= OLDEST_MS, "{oldest} ms");
    }
    assert!(rig.session.is_connected());
}

#[test]
fn simultaneous_timeouts_disconnect_once_and_clear_all_requests() {
    let mut rig = Rig::connected();
    // The refresh is due at 250 ms and is sent every 50 ms. A motion starts 200 ms before the connection counts as lost.
    let before = rig.pass(250 + 2 * 200 - 1);
    assert_eq!(before.len(), 8, "{before:?}");
    rig.now = rig.now.plus(1);
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.sent().len(), 2, "both are sent at once");
    rig.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    rig.pass(1_000);
    assert_eq!(rig.noticed("Unanswered(GripPart)"), 1);
    assert_eq!(rig.noticed("Withdrawn(SetForceLimit)"), 1);
    assert_eq!(rig.noticed("Disconnected"), 1);
    rig.connect();
    let after = rig.pass(300);
    assert!(after.iter().all(|command| command.id().kind() == Kind::Query), "{after:?}");
}

#[test]
fn motion_is_overtaken_by_a_stopping_command_until_its_answer() {
    for stop in [Command::Stop, Command::FastStop] {
        let mut rig = Rig::connected();
        rig.send(GRIP);
        assert!(!rig.session.has_overtaken(), "no command stops it");
        rig.session.request(stop).unwrap();
        assert!(rig.session.has_overtaken(), "{stop:?}");
        // This answer may belong to an earlier command.
        rig.status(CommandId::GripPart, Status::CmdPending);
        assert!(rig.session.has_overtaken(), "{stop:?}");
        assert_eq!(rig.sent(), [stop]);
        rig.status(stop.id(), Status::Success);
        assert!(!rig.session.has_overtaken(), "{stop:?}: answered");
    }
}

#[test]
fn acknowledge_overtakes_a_motion_until_taken_back_but_no_query() {
    let acknowledge = Command::Acknowledge { key: crate::types::AckKey };
    let mut rig = Rig::connected();
    rig.send(GRIP);
    rig.session.request(acknowledge).unwrap();
    assert!(rig.session.has_overtaken());
    assert!(rig.session.take_back(CommandId::GripPart));
    assert!(!rig.session.has_overtaken());
    assert_eq!(rig.pass(10), [acknowledge]);
    assert_eq!(rig.noticed("GripPart"), 0, "no event reports it");

    let mut rig = Rig::connected();
    rig.send(Command::GetTemperature);
    rig.session.request(acknowledge).unwrap();
    assert!(!rig.session.has_overtaken());

    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.session.tick(rig.now), None);
    rig.session.request(acknowledge).unwrap();
    assert!(!rig.session.has_overtaken(), "nothing of it has been sent");
}

#[test]
fn stop_overtakes_queued_requests_and_ends_the_motion() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.session.request(Command::SetForceLimit { force: 40.0 }).unwrap();
    rig.send(Command::Stop);
    assert_eq!(rig.noticed("Withdrawn(SetForceLimit)"), 1);
    rig.status(CommandId::GripPart, Status::CmdAborted);
    rig.status(CommandId::Stop, Status::Success);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: CmdAborted"), 1);
    assert_eq!(rig.noticed("Answered(Reply { id: Stop, status: Success"), 1);
}

#[test]
fn unanswered_stop_is_reported_and_not_sent_after_a_disconnect() {
    let mut rig = Rig::connected();
    rig.session.request(Command::Stop).unwrap();
    let sent = rig.pass(2_000);
    assert_eq!(sent.iter().filter(|command| **command == Command::Stop).count(), 3);
    assert_eq!(rig.events, ["Late(Stop)", "Late(Stop)", "Unanswered(Stop)", "Disconnected"]);
    rig.connect();
    assert!(!rig.pass(300).contains(&Command::Stop));
}

#[test]
fn stop_without_a_connection_is_sent_at_once_and_never_later() {
    let mut rig = Rig::connected();
    rig.pass(1_000);
    assert_eq!(rig.events, ["Disconnected"]);
    rig.send(Command::Stop);
    let sent = rig.pass(3_000);
    assert!(!sent.contains(&Command::Stop), "once: {sent:?}");
    assert_eq!(rig.noticed("Unanswered(Stop)"), 1);
    rig.connect();
    assert!(!rig.pass(300).contains(&Command::Stop), "and not after the reconnect");
}

#[test]
fn answer_to_a_stop_while_disconnected_starts_reconnecting() {
    let mut rig = Rig::connected();
    rig.pass(1_000);
    rig.exchange(Command::Stop, Status::Success);
    assert_eq!(rig.noticed("Answered(Reply { id: Stop, status: Success"), 1);
    assert_eq!(rig.sent(), [STATE]);
}

#[test]
fn statistics_that_are_reset_by_reading_are_read_once() {
    for (reset, times) in [(true, 1), (false, 3)] {
        let mut rig = Rig::connected();
        let command = Command::GetGrippingStatistics { reset };
        rig.session.request(command).unwrap();
        let sent = rig.pass(3_000);
        assert_eq!(sent.iter().filter(|sent| **sent == command).count(), times, "reset: {reset}");
        assert_eq!(rig.noticed("Unanswered(GetGrippingStatistics)"), 1);
    }
}

#[test]
fn fast_stop_goes_first_and_is_repeated_until_it_is_confirmed() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    rig.session.request(Command::FastStop).unwrap();
    let sent = rig.pass(10_000);
    assert!(!sent.contains(&GRIP), "queued commands are withdrawn");
    assert_eq!(sent.first(), Some(&Command::FastStop));
    let stops = sent.iter().filter(|command| **command == Command::FastStop).count();
    assert!(stops >= 40, "repeated across the disconnect: {stops}");
    rig.status(CommandId::FastStop, Status::CmdFormatError);
    assert!(rig.session.fast_stop_pending(), "only E_SUCCESS confirms it");
    rig.status(CommandId::FastStop, Status::Success);
    assert!(!rig.session.fast_stop_pending());
    rig.connect();
    assert!(!rig.pass(100).contains(&Command::FastStop), "and it is not sent again");
}

#[test]
fn only_its_own_success_confirms_a_fast_stop() {
    let mut rig = Rig::connected();
    rig.send(Command::FastStop);
    for late in [CommandId::GetSystemState, CommandId::GetSystemInfo, CommandId::GetGripperState] {
        rig.answer(late);
        assert!(rig.session.fast_stop_pending(), "{late:?}");
    }
    rig.status(CommandId::Stop, Status::Success);
    assert!(rig.session.fast_stop_pending());
    assert!(rig.pass(250).contains(&Command::FastStop), "it is repeated");
}

#[test]
fn earlier_answer_does_not_confirm_an_unsent_fast_stop() {
    let mut rig = Rig::connected();
    rig.exchange(Command::FastStop, Status::Success);
    assert!(!rig.session.fast_stop_pending());
    // The answer is received twice. Meanwhile, another FAST STOP was requested but the line has no room for it yet.
    rig.session.request(Command::FastStop).unwrap();
    rig.status(CommandId::FastStop, Status::Success);
    assert!(rig.session.fast_stop_pending());
    assert_eq!(rig.sent(), [Command::FastStop]);
    let unsolicited = rig.session.counters().unsolicited;
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!((rig.session.fast_stop_pending(), rig.session.counters().unsolicited), (false, unsolicited));
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!(rig.session.counters().unsolicited, unsolicited + 1, "no command awaits it");
}

#[test]
fn stop_during_unconfirmed_fast_stop_is_refused_and_never_sent() {
    let mut rig = Rig::connected();
    rig.session.request(Command::FastStop).unwrap();
    assert_eq!(rig.session.request(Command::Stop), Err(RequestError::FastStopRunning));
    assert_eq!(rig.sent(), [Command::FastStop]);
    assert_eq!(rig.session.request(Command::Stop), Err(RequestError::FastStopRunning));
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!(rig.sent(), []);
    assert_eq!(rig.session.request(Command::Stop), Ok(()), "confirmed");
}

#[test]
fn fast_stop_is_the_first_command_of_a_connection() {
    let mut rig = Rig::new();
    rig.send(Command::FastStop);
    assert_eq!(rig.session.request(Command::ACKNOWLEDGE), Err(RequestError::NotConnected));
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!(rig.sent(), [STATE]);
}

#[test]
fn fast_stop_is_never_acknowledged_by_the_session() {
    let mut rig = Rig::connected();
    rig.session.request(Command::FastStop).unwrap();
    assert_eq!(rig.session.request(Command::ACKNOWLEDGE), Err(RequestError::FastStopRunning));
    rig.sent();
    rig.status(CommandId::FastStop, Status::Success);
    rig.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED | SystemFlags::FAST_STOP)));
    for _ in 0..3 {
        assert!(!rig.pass(3_000).contains(&Command::ACKNOWLEDGE));
        rig.connect();
    }
}

#[test]
fn acknowledgement_without_an_answer_is_not_repeated() {
    let mut rig = Rig::connected();
    rig.session.request(Command::ACKNOWLEDGE).unwrap();
    let sent = rig.pass(3_000);
    assert_eq!(sent.iter().filter(|command| **command == Command::ACKNOWLEDGE).count(), 1);
    assert_eq!(rig.noticed("Unanswered(Acknowledge)"), 1);
}

#[test]
fn lost_result_is_given_up_once_the_gripper_stands_still() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
    rig.pass(100);
    rig.reply(Reply::success(Value::GetGripperState(GripperState::Holding)));
    rig.pass_answered(900);
    assert_eq!(rig.noticed("Unanswered"), 0, "the result may be delayed");
    rig.pass_answered(200);
    assert_eq!(rig.noticed("Unanswered(GripPart)"), 1);
    assert!(rig.session.is_connected());
}

#[test]
fn slow_motion_is_awaited_while_the_gripper_reports_it() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.pass_gripping(30_000);
    assert_eq!(rig.noticed("Unanswered"), 0);
    rig.status(CommandId::GripPart, Status::Success);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
}

#[test]
fn late_result_of_an_earlier_motion_does_not_end_a_new_one() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    rig.pass(5_000);
    rig.connect();
    rig.events.clear();
    rig.exchange(GRIP, Status::Success); // of the first
    assert_eq!(rig.events, [""; 0]);
    assert_eq!(rig.session.counters().unsolicited, 1);
    rig.status(CommandId::GripPart, Status::CmdPending);
    rig.status(CommandId::GripPart, Status::CmdFailed);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: CmdFailed"), 1);
}

#[test]
fn answer_received_before_its_request_was_sent_is_ignored() {
    for (command, status) in [(Command::TareForceSensor, Status::Success), (GRIP, Status::AccessDenied)] {
        let mut rig = Rig::connected();
        rig.session.request(command).unwrap();
        assert_eq!(rig.session.tick(rig.now), None);
        rig.status(command.id(), status);
        assert_eq!(rig.events, [""; 0]);
        assert_eq!(rig.session.counters().unsolicited, 1);
        assert_eq!(rig.sent(), [command]);
        rig.status(command.id(), status);
        assert_eq!(rig.noticed("Answered"), 1);
    }
}

#[test]
fn unsolicited_and_invalid_frames_are_only_counted() {
    let mut rig = Rig::connected();
    rig.status(CommandId::Homing, Status::Success);
    rig.status(CommandId::Unknown(0xB0), Status::Success);
    assert_eq!(rig.session.counters().unsolicited, 2);
    let undefined = FrameEvent::Frame(Frame { id: 0x41, payload: &[0, 0, 9] });
    assert_eq!(rig.session.handle(rig.now, &undefined), None);
    assert_eq!(rig.session.counters().refused, 1);
    assert_eq!(rig.session.known().state, Some(GripperState::Idle));
    assert_eq!(rig.events, [""; 0]);
}

#[test]
fn updates_are_reported_as_received() {
    let mut rig = Rig::connected();
    rig.reply(Reply::success(Value::GetGripperState(GripperState::PartLost)));
    assert_eq!(rig.events, ["Reported(GetGripperState(PartLost))"]);
    assert_eq!(rig.session.known().state, Some(GripperState::PartLost));
    assert_eq!(rig.session.counters().unsolicited, 0);
}

#[test]
fn error_status_is_the_answer_of_a_motion_that_did_not_begin() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::AccessDenied);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: AccessDenied"), 1);
    assert_eq!(rig.session.motion(), None);
}

#[test]
fn number_that_is_not_finite_is_refused_before_it_is_sent() {
    let mut rig = Rig::connected();
    let refused = rig.session.request(Command::GripPart { width: f32::NAN, speed: 50.0 });
    assert_eq!(refused, Err(RequestError::Invalid(DecodeError::NotFinite)));
    assert_eq!(rig.sent(), []);
}

#[test]
fn queue_that_is_full_refuses_and_loses_nothing() {
    let mut rig = Rig::connected();
    for _ in 0..QUEUE_LEN {
        rig.session.request(Command::GetTemperature).unwrap();
    }
    assert_eq!(rig.session.request(Command::GetTemperature), Err(RequestError::QueueFull));
    for _ in 0..QUEUE_LEN {
        assert_eq!(rig.sent(), [Command::GetTemperature]);
        rig.reply(Reply::success(Value::GetTemperature(crate::Temperature(0))));
    }
    assert_eq!(rig.sent(), []);
}

#[test]
fn finger_supply_may_be_switched_on_beside_a_motion() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.exchange(Command::Finger1Power { enabled: true }, Status::CmdPending);
    rig.status(CommandId::GripPart, Status::Success);
    rig.status(CommandId::Finger1Power, Status::Success);
    assert_eq!(rig.noticed("Answered(Reply { id: Finger1Power, status: Success"), 1);
    assert_eq!(rig.noticed("Answered(Reply { id: GripPart, status: Success"), 1);
}

#[test]
fn timeout_is_announced_in_advance() {
    let mut rig = Rig::connected();
    let mut checked = 0;
    for step in 0..4_000 {
        if step == 100 {
            rig.session.request(GRIP).unwrap();
        }
        let due = rig.session.poll_timeout();
        let before = (rig.events.len(), rig.session.is_connected());
        let sent = rig.pass(1);
        let happened = !sent.is_empty() || before != (rig.events.len(), rig.session.is_connected());
        if happened && step != 100 {
            checked += 1;
            assert!(due.is_some_and(|due| rig.now.has_reached(due)), "{step}: {sent:?} was not announced");
        }
    }
    assert!(checked > 5, "{checked}");
}

const FORCE_40: Command<'static> = Command::SetForceLimit { force: 40.0 };

fn verifying() -> Rig {
    let mut rig = Rig::with(Config { verify_settings: true, ..Config::DEFAULT });
    rig.connect();
    rig.events.clear();
    rig
}

/// Sends a setting, answers its read-back with `read`, and returns the events.
fn read_back(setting: Command<'static>, read: Reply<'_>) -> Vec<std::string::String> {
    let mut rig = verifying();
    rig.exchange(setting, Status::Success);
    assert_eq!(rig.events, [""; 0], "a read-back follows before the answer");
    assert_eq!(rig.sent().iter().map(Command::id).collect::<Vec<_>>(), [read.id()]);
    assert!(rig.session.is_busy());
    rig.reply(read);
    assert!(!rig.session.is_busy());
    assert_eq!(rig.session.counters().unsolicited, 0);
    rig.events
}

fn answered(id: CommandId, status: Status) -> std::string::String {
    std::format!("{:?}", Event::Answered(Reply::status_only(id, status)))
}

#[test]
fn read_back_answers_a_setting_or_reports_a_mismatch() {
    let force = |force| Command::SetForceLimit { force };
    let acceleration = |acceleration| Command::SetAcceleration { acceleration };
    let limits = |minus, plus| crate::SoftLimits { minus, plus };
    let set_limits = Command::SetSoftLimits { limits: limits(10.0, 90.0) };
    let no_limits = Reply::status_only(CommandId::GetSoftLimits, Status::NotAvailable);
    let is = Reply::success;
    for (setting, read, status, why) in [
        (force(40.0), is(Value::GetForceLimit(40.0)), Status::Success, "equal"),
        (
            force(40.0),
            is(Value::GetForceLimit(40.02)),
            Status::Success,
            "rounded to the gripper's resolution",
        ),
        (force(1.0), is(Value::GetForceLimit(5.0)), MISMATCH, "corrected to the least force"),
        (force(100.0), is(Value::GetForceLimit(80.0)), MISMATCH, "corrected to the nominal force"),
        (force(500.0), is(Value::GetForceLimit(120.0)), MISMATCH, "corrected to the overdrive force"),
        (force(40.0), is(Value::GetForceLimit(41.0)), MISMATCH, "another force"),
        (force(40.0), is(Value::GetForceLimit(80.0)), MISMATCH, "the force before"),
        (acceleration(9_999.0), is(Value::GetAcceleration(5_000.0)), MISMATCH, "corrected"),
        (
            acceleration(3_000.0),
            is(Value::GetAcceleration(3_002.0)),
            Status::Success,
            "less than a thousandth more",
        ),
        (
            acceleration(3_000.0),
            is(Value::GetAcceleration(2_998.0)),
            Status::Success,
            "less than a thousandth less",
        ),
        (acceleration(3_000.0), is(Value::GetAcceleration(3_004.0)), MISMATCH, "more than a thousandth more"),
        (set_limits, is(Value::GetSoftLimits(limits(10.0, 90.0))), Status::Success, "equal"),
        (set_limits, is(Value::GetSoftLimits(limits(10.0, 80.0))), MISMATCH, "another plus limit"),
        (set_limits, is(Value::GetSoftLimits(limits(20.0, 90.0))), MISMATCH, "another minus limit"),
        (set_limits, no_limits, MISMATCH, "no limits"),
    ] {
        assert_eq!(read_back(setting, read), [answered(setting.id(), status)], "{setting:?}: {why}");
        assert!(!setting.id().may_answer(MISMATCH), "no gripper sends this status");
    }
}

#[test]
fn setting_that_was_refused_is_not_read_back() {
    let mut rig = verifying();
    rig.exchange(FORCE_40, Status::CmdFormatError);
    assert_eq!(rig.events, [answered(CommandId::SetForceLimit, Status::CmdFormatError)]);
    assert_eq!(rig.sent(), []);
}

#[test]
fn next_request_waits_for_the_read_back() {
    let mut rig = verifying();
    rig.session.request(FORCE_40).unwrap();
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.sent(), [FORCE_40]);
    rig.status(CommandId::SetForceLimit, Status::Success);
    assert_eq!(rig.sent(), [Command::GetForceLimit]);
    rig.reply(Reply::success(Value::GetForceLimit(40.0)));
    assert_eq!(rig.sent(), [GRIP]);
}

#[test]
fn read_back_without_an_answer_leaves_the_setting_unanswered() {
    let mut rig = verifying();
    rig.exchange(FORCE_40, Status::Success);
    let asked = rig.pass(2_000).into_iter().filter(|command| *command == Command::GetForceLimit).count();
    assert_eq!(asked, 3);
    assert_eq!(rig.events, ["Unanswered(SetForceLimit)", "Disconnected"]);
}

#[test]
fn stop_does_not_cancel_a_read_back() {
    let mut rig = verifying();
    rig.exchange(FORCE_40, Status::Success);
    rig.session.request(Command::Stop).unwrap();
    rig.session.withdraw();
    assert_eq!(rig.sent(), [Command::Stop, Command::GetForceLimit]);
    rig.reply(Reply::success(Value::GetForceLimit(40.0)));
    assert_eq!(rig.events, [answered(CommandId::SetForceLimit, Status::Success)]);
}

#[test]
fn command_with_its_own_timeouts_is_awaited_that_long() {
    let script = CommandId::Unknown(0xB0);
    const TIMEOUTS: &[Timeout] = &[
        Timeout { id: CommandId::Unknown(0xB0), reply_ms: 2_000, result_ms: 5_000 },
        Timeout { id: CommandId::GripPart, reply_ms: 200, result_ms: 700 },
    ];
    let mut rig = Rig::with(Config { timeouts: TIMEOUTS, ..Config::DEFAULT });
    rig.connect();
    rig.events.clear();
    rig.session.request(Command::Unknown { id: 0xB0, payload: &[] }).unwrap();
    rig.pass_answered(1_900);
    assert_eq!(rig.noticed("Unanswered"), 0);
    rig.status(script, Status::CmdPending);
    rig.pass_answered(900);
    assert_eq!(rig.noticed("Unanswered"), 0);
    rig.status(script, Status::Success);
    rig.exchange(GRIP, Status::CmdPending);
    rig.reply(Reply::success(Value::GetGripperState(GripperState::Gripping)));
    rig.pass_gripping(699);
    assert_eq!(rig.noticed("Unanswered"), 0);
    rig.pass(2);
    assert_eq!(rig.noticed("Unanswered(GripPart)"), 1);
    assert!(rig.session.is_connected());
}

#[test]
fn subscription_is_sent_at_once_and_again_after_a_reconnect() {
    let mut rig = Rig::connected();
    let update = AutoUpdate::every(50);
    let force = Command::GetForce { update };
    rig.session.subscribe(Topic::Force, update);
    assert_eq!(rig.sent(), [force]);
    rig.reply(Reply::success(Value::GetForce(1.0)));
    rig.reply(Reply::success(Value::GetForce(2.0)));
    assert_eq!(rig.events, ["Reported(GetForce(1.0))", "Reported(GetForce(2.0))"]);
    assert_eq!(rig.session.known().force, Some(2.0));
    rig.pass(1_000);
    assert_eq!(rig.noticed("Disconnected"), 1);
    assert_eq!(rig.connect().last(), Some(&force));
}

#[test]
fn each_signal_has_its_own_period() {
    let mut rig = Rig::new();
    for (topic, period_ms) in Topic::ALL.into_iter().zip([20, 30, 40, 50, 5]) {
        rig.session.subscribe(topic, AutoUpdate::on_change(period_ms));
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
    assert_eq!(rig.pass_healthy(50), expected);
}

#[test]
fn subscription_that_ends_is_ended_at_the_gripper() {
    let mut rig = Rig::with(Config { width: true, ..Config::DEFAULT });
    rig.connect();
    rig.session.subscribe(Topic::Width, AutoUpdate::once());
    assert_eq!(rig.sent(), [Command::GetOpeningWidth { update: AutoUpdate::once() }]);
    rig.reply(Reply::success(Value::GetOpeningWidth(0.0)));
    rig.events.clear();
    rig.reply(Reply::success(Value::GetOpeningWidth(1.0)));
    assert_eq!(rig.events, [""; 0]);
    assert_eq!(rig.session.counters().unsolicited, 1);
}

#[test]
fn borrowed_command_is_sent_and_repeated_while_it_is_available() {
    let mut rig = Rig::connected();
    let text = std::string::String::from("left");
    let tag = Command::SetDeviceTag { tag: crate::DeviceTag::new(&text).unwrap() };
    rig.session.request_borrowed(&tag).unwrap();
    assert_eq!(rig.sent(), [], "the lent command is not available");
    assert_eq!(rig.session.poll_transmit_borrowed(rig.now, Some(Command::GetTemperature)), None);
    assert_eq!(rig.session.poll_transmit_borrowed(rig.now, Some(tag)), Some(tag));
    assert_eq!(rig.session.poll_transmit_borrowed(rig.now, Some(tag)), None);
    rig.now = rig.now.plus(200);
    rig.sent();
    assert_eq!(rig.session.poll_transmit_borrowed(rig.now, Some(tag)), Some(tag));
    rig.status(CommandId::SetDeviceTag, Status::Success);
    assert_eq!(rig.events, [answered(CommandId::SetDeviceTag, Status::Success)]);
}

#[test]
fn withdrawn_command_is_not_sent_and_borrowed_one_not_repeated() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    rig.session.withdraw();
    assert_eq!(rig.sent(), []);
    assert!(!rig.session.is_busy());

    let echo = Command::Loop { data: crate::LoopData::new(&[1]).unwrap() };
    rig.session.request_borrowed(&echo).unwrap();
    rig.sent();
    assert_eq!(rig.session.poll_transmit_borrowed(rig.now, Some(echo)), Some(echo));
    rig.session.withdraw();
    assert!(rig.session.is_busy(), "its answer may still be received");
    rig.pass_answered(201);
    assert!(!rig.session.is_busy());
    assert!(rig.session.is_connected());
    assert_eq!(rig.noticed("Unanswered"), 0);
}

#[test]
fn motion_that_the_caller_did_not_send_is_taken_back() {
    let mut rig = Rig::connected();
    rig.send(GRIP);
    assert!(!rig.session.take_back(CommandId::Homing));
    assert!(rig.session.take_back(CommandId::GripPart));
    assert_eq!(rig.session.motion(), None);
    assert_eq!(rig.session.request(HOMING), Ok(()));
}

#[test]
fn disconnect_by_the_caller_takes_effect_at_once() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, Status::CmdPending);
    rig.session.disconnect();
    rig.sent();
    assert_eq!(rig.events, ["Pending(GripPart)", "Unanswered(GripPart)", "Disconnected"]);
    assert_eq!(rig.session.known(), &Known::NOTHING);
    rig.connect();
}

#[test]
fn callers_disconnect_resends_only_an_unconfirmed_fast_stop() {
    for (command, again) in [(Command::FastStop, true), (Command::Stop, false)] {
        let mut rig = Rig::connected();
        rig.send(command);
        assert_eq!(rig.sent(), []);
        rig.session.disconnect();
        assert_eq!(rig.sent().contains(&command), again);
        rig.status(command.id(), Status::Success);
        rig.session.disconnect();
        assert!(!rig.sent().contains(&command));
    }
}

#[test]
fn pending_fast_stop_causes_no_busy_loop_on_a_dead_line() {
    let mut rig = Rig::with(Config { reconnect_ms: 50, ..Config::DEFAULT });
    rig.connect();
    rig.session.request(Command::FastStop).unwrap();
    for _ in 0..5_000 {
        rig.pass(1);
        assert!(rig.session.poll_timeout().is_none_or(|due| !rig.now.has_reached(due)));
    }
}

#[test]
fn disconnect_while_connecting_causes_an_immediate_retry() {
    let mut rig = Rig::new();
    assert_eq!(rig.sent(), [STATE]);
    rig.answer(CommandId::GetSystemState);
    assert_eq!(rig.sent(), [Command::GetGripperState { update: AutoUpdate::on_change(10) }]);
    rig.session.disconnect();
    assert_eq!(rig.session.known(), &Known::NOTHING);
    assert_eq!(rig.sent(), [STATE]);
    assert_eq!(rig.events, [""; 0], "no connection was lost");
}

#[test]
fn second_disconnect_still_reports_open_requests() {
    let mut rig = Rig::connected();
    rig.send(GRIP);
    rig.session.disconnect();
    rig.session.disconnect();
    rig.sent();
    assert_eq!(rig.events, ["Unanswered(GripPart)", "Disconnected"]);
}

#[test]
fn announced_timeout_is_in_the_future_with_and_without_answers() {
    let mut rig = Rig::connected();
    for step in 0..4_000 {
        for command in rig.pass(1) {
            if step < 2_000 {
                rig.answer(command.id());
            }
        }
        rig.sent();
        assert!(rig.session.poll_timeout().is_some_and(|due| !rig.now.has_reached(due)), "{step}");
    }
}

/// Returns a session whose next command is a motion.
fn about_to_grip() -> Rig {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.session.tick(rig.now), None);
    rig
}

#[test]
fn motion_that_is_next_to_be_sent_is_withdrawn() {
    let mut rig = about_to_grip();
    rig.session.withdraw();
    assert_eq!(rig.sent(), []);
    assert!(!rig.session.is_busy());
}

#[test]
fn acknowledgement_withdraws_the_next_motion_to_be_sent() {
    let mut rig = about_to_grip();
    rig.send(Command::ACKNOWLEDGE);
    assert_eq!(rig.events, ["Withdrawn(GripPart)"]);
}

const FAST_STOPPED: Value<'static> =
    Value::GetSystemState(SystemFlags::REFERENCED.union(SystemFlags::FAST_STOP));

/// Otherwise it would follow the acknowledgement of another party.
#[test]
fn unsent_motion_is_withdrawn_by_a_fast_stop_of_the_gripper() {
    let mut next = about_to_grip();
    next.reply(Reply::success(FAST_STOPPED));
    assert_eq!(next.sent(), []);
    assert_eq!(next.noticed("Withdrawn(GripPart)"), 1);

    let mut queued = Rig::connected();
    queued.send(Command::GetTemperature);
    queued.session.request(GRIP).unwrap();
    queued.reply(Reply::success(FAST_STOPPED));
    queued.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)));
    queued.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    assert_eq!(queued.sent(), []);
    assert_eq!(queued.noticed("Withdrawn(GripPart)"), 1);
}

#[test]
fn fast_stop_of_the_gripper_overtakes_a_motion_being_sent() {
    let mut rig = Rig::connected();
    rig.send(GRIP);
    rig.reply(Reply::success(FAST_STOPPED));
    assert!(rig.session.has_overtaken());
}

#[test]
fn fast_stop_of_the_gripper_withdraws_no_query_or_later_request() {
    let mut rig = Rig::connected();
    rig.send(Command::GetForceLimit);
    rig.session.request(Command::GetTemperature).unwrap();
    rig.reply(Reply::success(FAST_STOPPED));
    rig.reply(Reply::success(Value::GetForceLimit(40.0)));
    assert_eq!(rig.sent(), [Command::GetTemperature]);
    rig.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    rig.send(Command::ACKNOWLEDGE);
    rig.session.request(HOMING).unwrap();
    // Repeated: it may precede the acknowledgement.
    rig.reply(Reply::success(FAST_STOPPED));
    rig.status(CommandId::Acknowledge, Status::Success);
    assert_eq!(rig.sent(), [HOMING]);
}

#[test]
fn query_is_not_taken_back() {
    let mut rig = Rig::connected();
    rig.send(Command::GetTemperature);
    assert!(!rig.session.take_back(CommandId::GetTemperature));
    assert!(rig.session.is_busy());
}

#[test]
fn finger_supply_is_not_switched_again_while_switching_on() {
    let mut rig = Rig::connected();
    rig.exchange(Command::Finger1Power { enabled: true }, Status::CmdPending);
    let again = rig.session.request(Command::Finger1Power { enabled: false });
    assert_eq!(again, Err(RequestError::MotionRunning));
    assert_eq!(
        rig.session.request(Command::Finger2Power { enabled: true }),
        Ok(()),
        "the other supply may be switched"
    );
}

#[test]
fn request_after_a_stop_waits_until_the_stop_is_answered() {
    let mut rig = Rig::connected();
    rig.send(Command::Stop);
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.sent(), []);
    rig.status(CommandId::Stop, Status::Success);
    assert_eq!(rig.sent(), [GRIP]);
}

#[test]
fn nothing_is_reported_before_the_connection_is_established() {
    let mut rig = Rig::new();
    rig.sent();
    rig.answer(CommandId::GetGripperState);
    assert_eq!(rig.events, [""; 0]);
    assert_eq!(rig.session.counters().unsolicited, 1);
}

#[test]
fn single_query_ends_the_subscription_of_no_signal() {
    let mut rig = Rig::connected();
    let (update, once) = (AutoUpdate::on_change(70), AutoUpdate::once());
    for (ask, kept) in [
        (Command::GetSystemState { update: once }, Command::GetSystemState { update }),
        (Command::GetGripperState { update: once }, Command::GetGripperState { update }),
        (Command::GetOpeningWidth { update: once }, Command::GetOpeningWidth { update }),
        (Command::GetSpeed { update: once }, Command::GetSpeed { update }),
        (Command::GetForce { update: once }, Command::GetForce { update }),
    ] {
        rig.session.subscribe(Topic::of(ask.id()).unwrap(), update);
        rig.session.request(ask).unwrap();
        assert_eq!(rig.sent(), [kept, kept], "once for the caller, once to change the period");
        (0..2).for_each(|_| rig.answer(kept.id()));
        assert_eq!(rig.sent(), [], "confirmed");
    }
    let mut rig = Rig::connected();
    rig.send(Command::GetSpeed { update: once });
}

#[test]
fn requested_update_is_sent_unchanged() {
    let mut rig = Rig::connected();
    let ask = Command::GetGripperState { update: AutoUpdate::every(70) };
    rig.send(ask);
}

#[test]
fn subscriptions_changed_together_are_each_requested_once() {
    let mut rig = Rig::connected();
    let update = AutoUpdate::every(50);
    rig.session.subscribe(Topic::Width, update);
    rig.session.subscribe(Topic::Force, update);
    assert_eq!(rig.sent(), [Command::GetOpeningWidth { update }]);
    rig.reply(Reply::success(Value::GetOpeningWidth(0.0)));
    assert_eq!(rig.sent(), [Command::GetForce { update }]);
    rig.reply(Reply::success(Value::GetForce(0.0)));
    assert_eq!(rig.sent(), []);
}

#[test]
fn request_that_is_answered_once_is_not_answered_by_pending() {
    let mut rig = Rig::connected();
    rig.exchange(Command::GetTemperature, Status::CmdPending);
    assert_eq!(rig.events, [""; 0]);
    assert_eq!(rig.session.counters().unsolicited, 1);
    rig.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    assert_eq!(rig.noticed("Answered(Reply { id: GetTemperature, status: Success"), 1);
}

#[test]
fn every_reported_value_becomes_known() {
    let mut rig = Rig::connected();
    rig.reply(Reply::success(Value::GetSystemState(SystemFlags::MOVING)));
    assert!(rig.session.known().is_moving(), "by its flags");
    rig.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)));
    assert!(!rig.session.known().is_moving());
    rig.reply(Reply::success(Value::GetGripperState(GripperState::Releasing)));
    assert!(rig.session.known().is_moving(), "by its state");
    rig.reply(Reply::success(Value::GetOpeningWidth(12.5)));
    rig.reply(Reply::success(Value::GetSpeed(-40.5)));
    rig.reply(Reply::success(Value::GetForce(3.5)));
    let known = Known {
        info: Some(INFO),
        limits: Some(LIMITS),
        flags: Some(SystemFlags::REFERENCED),
        state: Some(GripperState::Releasing),
        width: Some(12.5),
        speed: Some(-40.5),
        force: Some(3.5),
        force_limit: None,
    };
    assert_eq!(rig.session.known(), &known);
}

/// Returns the times in ms at which an unanswered FAST STOP is sent after its request, with the number of frames at each.
fn fast_stop_times(rig: &mut Rig, ms: u32) -> Vec<(u32, usize)> {
    let mut times = vec![];
    for at in 0..ms {
        let sent = rig.sent();
        assert!(sent.iter().all(|command| *command == Command::FastStop), "{at} ms: {sent:?}");
        if !sent.is_empty() {
            times.push((at, sent.len()));
        }
        rig.now = rig.now.plus(1);
    }
    times
}

#[test]
fn unanswered_fast_stop_is_sent_in_bursts_with_silence_between() {
    let mut rig = Rig::connected();
    rig.session.request(Command::FastStop).unwrap();
    assert_eq!(fast_stop_times(&mut rig, 1_900), [(0, 1), (30, 130), (630, 130), (1_230, 130), (1_830, 130)]);
    assert_eq!(rig.noticed("Disconnected"), 1, "and nothing else is sent");
}

#[test]
fn fast_stop_burst_covers_the_longest_message_and_one_fast_stop() {
    let burst = usize::from(FastStopPattern::DEFAULT.burst_frames) * crate::frame::OVERHEAD;
    assert!(burst >= crate::frame::MAX_MESSAGE_LEN + crate::frame::OVERHEAD);
}

#[test]
fn confirmation_ends_the_fast_stop_burst_and_resumes_the_queue() {
    let mut rig = Rig::connected();
    rig.send(Command::FastStop);
    rig.session.request(Command::GetTemperature).unwrap();
    rig.now = rig.now.plus(30);
    assert_eq!(rig.session.tick(rig.now), None);
    for _ in 0..5 {
        assert_eq!(rig.session.poll_transmit(rig.now), Some(Command::FastStop));
    }
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!(rig.sent(), [Command::GetTemperature]);
}

#[test]
fn fast_stop_after_a_stop_without_an_answer_starts_with_a_burst() {
    let mut rig = Rig::connected();
    rig.send(Command::Stop);
    rig.send(Command::FastStop);

    let mut rig = Rig::connected();
    rig.session.request(Command::Stop).unwrap();
    assert_eq!(rig.pass(200), [Command::Stop, Command::Stop]);
    assert_eq!(rig.events, ["Late(Stop)"]);
    rig.session.request(Command::FastStop).unwrap();
    assert_eq!(rig.sent().len(), 130);
}

#[test]
fn query_due_during_a_fast_stop_is_sent_right_after_it() {
    let mut rig = Rig::connected();
    let due = rig.session.poll_timeout().unwrap();
    rig.send(Command::FastStop);
    while !rig.now.has_reached(due.plus(5)) {
        rig.now = rig.now.plus(1);
        assert_eq!(rig.session.tick(rig.now), None);
    }
    rig.status(CommandId::FastStop, Status::Success);
    let sent = rig.sent();
    assert_eq!(sent.len(), 1, "{sent:?}");
    assert!(sent.iter().all(|command| command.id().kind() == Kind::Query));
}

#[test]
fn query_overdue_during_a_fast_stop_is_repeated_right_after_it() {
    let mut rig = Rig::connected();
    rig.now = rig.session.poll_timeout().unwrap();
    let query = rig.sent();
    assert_eq!(query.len(), 1);
    rig.session.request(Command::FastStop).unwrap();
    let during = rig.pass(150);
    assert!(during.iter().all(|command| *command == Command::FastStop), "{during:?}");
    rig.status(CommandId::FastStop, Status::Success);
    assert_eq!(rig.sent(), query);
}

#[test]
fn fast_stop_does_not_delay_the_detection_of_a_lost_line() {
    for fast_stop_at in [0, 100, 300, 500, 700] {
        let mut rig = Rig::connected();
        rig.pass(fast_stop_at);
        rig.session.request(Command::FastStop).unwrap();
        rig.pass(900 - fast_stop_at);
        assert_eq!(rig.noticed("Disconnected"), 1, "FAST STOP after {fast_stop_at} ms of silence");
    }
}

#[test]
fn acknowledgement_withdraws_earlier_requests() {
    let mut rig = Rig::connected();
    rig.send(Command::GetTemperature);
    let force = Command::SetForceLimit { force: 40.0 };
    for waiting in [GRIP, force, force, force] {
        rig.session.request(waiting).unwrap();
    }
    assert_eq!(rig.session.request(force), Err(RequestError::QueueFull));
    assert_eq!(rig.session.request(Command::ACKNOWLEDGE), Ok(()), "it frees the queue");
    rig.session.request(HOMING).unwrap_err();
    rig.reply(Reply::success(Value::GetTemperature(crate::Temperature(250))));
    assert_eq!(rig.sent(), [Command::ACKNOWLEDGE]);
    assert_eq!((rig.noticed("Withdrawn(GripPart)"), rig.noticed("Withdrawn(SetForceLimit)")), (1, 3));
    rig.session.request(HOMING).unwrap();
    assert_eq!(rig.sent(), [], "only after the answer");
    rig.status(CommandId::Acknowledge, Status::Success);
    assert_eq!(rig.sent(), [HOMING], "later requests are sent");
}

#[test]
fn overtaken_setting_is_not_repeated_but_reported_unanswered() {
    for overtakes in [Command::Stop, Command::FastStop, Command::ACKNOWLEDGE] {
        let mut rig = Rig::connected();
        let force = Command::SetForceLimit { force: 40.0 };
        rig.send(force);
        rig.session.request(overtakes).unwrap();
        let mut sent = vec![];
        for _ in 0..600 {
            for command in rig.pass(1) {
                if command != overtakes || overtakes != Command::ACKNOWLEDGE {
                    rig.answer(command.id());
                }
                sent.push(command);
            }
        }
        assert!(!sent.contains(&force), "{overtakes:?}");
        assert_eq!(rig.noticed("Unanswered(SetForceLimit)"), 1, "{overtakes:?}");
    }
}

#[test]
fn request_waits_until_no_second_answer_of_its_id_can_arrive() {
    let mut rig = Rig::connected();
    let [first, second] = [40.0, 10.0].map(|force| Command::SetForceLimit { force });
    rig.session.request(first).unwrap();
    assert_eq!(rig.pass(200), [first, first], "the answer to the first is late");
    rig.status(CommandId::SetForceLimit, Status::Success);
    rig.session.request(second).unwrap();
    assert_eq!(rig.pass(10), []);
    rig.status(CommandId::SetForceLimit, Status::Success);
    assert_eq!(
        rig.noticed("Answered(Reply { id: SetForceLimit"),
        1,
        "the second answer belongs to no request"
    );
    let sent = rig.pass(200);
    assert_eq!(sent.iter().filter(|command| command.id() == CommandId::SetForceLimit).count(), 1);
    rig.status(CommandId::SetForceLimit, Status::RangeError);
    assert_eq!(rig.noticed("Answered(Reply { id: SetForceLimit, status: RangeError"), 1);
}

#[test]
fn second_answer_deadline_is_announced_only_if_a_request_waits() {
    let force = Command::SetForceLimit { force: 40.0 };
    let doubled = || {
        let mut rig = Rig::connected();
        rig.session.request(force).unwrap();
        assert_eq!(rig.pass(200), [force, force]);
        rig.status(CommandId::SetForceLimit, Status::Success);
        rig
    };
    let mut waits = doubled();
    waits.session.request(force).unwrap();
    let mut due = None;
    while !waits.pass(1).contains(&force) {
        due = waits.session.poll_timeout();
    }
    assert_eq!(due, Some(waits.now), "announced in advance");

    let mut quiet = doubled();
    while quiet.now.plus(1) != waits.now {
        quiet.pass_answered(1);
    }
    assert_ne!(quiet.session.poll_timeout(), Some(waits.now), "no request waits");
}

#[test]
fn overtaken_setting_is_not_repeated_even_if_it_was_due() {
    let mut rig = Rig::connected();
    let force = Command::SetForceLimit { force: 40.0 };
    rig.send(force);
    rig.now = rig.now.plus(200);
    assert_eq!(rig.session.tick(rig.now), None, "the repetition is due");
    rig.send(Command::Stop);
    assert_eq!(rig.events, ["Unanswered(SetForceLimit)"]);
}
