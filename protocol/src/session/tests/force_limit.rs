//! The known force limit: how it becomes known, how it is refreshed, and each event that makes it unknown.

use super::*;

const REFRESH_MS: u32 = Config::DEFAULT.refresh_ms;
/// Time-out of the answer to a refresh.
const REFRESH_REPLY_MS: u32 = Config::DEFAULT.reply_timeout_ms / 4;

impl Rig {
    fn limit(&self) -> Option<f32> {
        self.session.known().force_limit
    }

    /// Reports the gripper's force limit.
    fn report(&mut self, force: f32) {
        self.reply(Reply::success(Value::GetForceLimit(force)));
    }

    /// Sets the force limit and answers the read-back with `read`.
    fn set(&mut self, force: f32, read: f32) {
        self.session.request(Command::SetForceLimit { force }).unwrap();
        assert_eq!(self.sent(), [Command::SetForceLimit { force }]);
        self.status(CommandId::SetForceLimit, Status::Success);
        assert_eq!(self.sent(), [Command::GetForceLimit]);
        self.report(read);
    }

    /// Advances by `ms` with a gripper that answers everything and has this force limit. Returns the number of force
    /// limit queries.
    fn pass_with(&mut self, ms: u32, force: f32) -> usize {
        let mut asked = 0;
        for _ in 0..ms {
            for command in self.pass(1) {
                match command {
                    Command::GetForceLimit => {
                        asked += 1;
                        self.report(force);
                    }
                    other => self.answer(other.id()),
                }
            }
        }
        asked
    }

    /// Advances until the session queries the force limit. Returns the elapsed time in ms.
    fn until_queried(&mut self) -> u32 {
        for ms in 1..REFRESH_MS {
            for command in self.pass(1) {
                if command == Command::GetForceLimit {
                    return ms;
                }
                self.answer(command.id());
            }
        }
        panic!("the session does not query the force limit");
    }
}

/// Returns a session that knows the gripper's limit to be 40 N.
fn limited() -> Rig {
    let mut rig = verifying();
    rig.set(40.0, 40.0);
    assert_eq!(rig.limit(), Some(40.0));
    rig.events.clear();
    rig
}

#[test]
fn force_limit_is_known_as_it_was_read_back() {
    let mut rig = verifying();
    assert_eq!(rig.limit(), None);
    rig.exchange(FORCE_40, Status::Success);
    assert_eq!(rig.limit(), None, "confirmed, but not read back");
    rig.sent();
    rig.report(40.0);
    assert_eq!(rig.limit(), Some(40.0));

    for (set, read, known) in [(100.0, 80.0, None), (40.0, 40.02, Some(40.02)), (40.0, 41.0, None)] {
        let mut rig = verifying();
        rig.set(set, read);
        assert_eq!(rig.limit(), known, "{set} read as {read}");
    }
}

#[test]
fn force_limit_that_was_not_set_or_not_read_back_is_not_known() {
    let mut rig = verifying();
    rig.send(Command::GetForceLimit);
    rig.report(40.0);
    assert_eq!(rig.limit(), None, "queried without a setting");
    rig.report(40.0);
    assert_eq!(rig.limit(), None, "unsolicited");

    let mut rig = Rig::connected();
    rig.exchange(FORCE_40, Status::Success);
    assert_eq!(rig.limit(), None, "settings are not read back");
}

#[test]
fn periodic_queries_keep_the_force_limit_known_during_motions() {
    let mut rig = limited();
    rig.exchange(GRIP, Status::CmdPending);
    let mut asked = rig.pass_with(2 * REFRESH_MS, 40.0);
    rig.status(CommandId::GripPart, Status::Success);
    asked += rig.pass_with(18 * REFRESH_MS, 40.0);
    assert!((39..=40).contains(&asked), "{asked}");
    assert_eq!(rig.limit(), Some(40.0));
    assert_eq!(rig.session.counters().unsolicited, 0);
    assert_eq!(rig.noticed("Reported(GetForceLimit"), 0, "no subscription to it");
    let states = rig.noticed("Reported(GetSystemState") + rig.noticed("Reported(GetGripperState");
    assert!((39..=40).contains(&states), "{states}");
}

#[test]
fn time_of_the_next_query_is_announced() {
    let mut rig = limited();
    let mut due = None;
    let asked = (0..REFRESH_MS).any(|_| {
        due = rig.session.poll_timeout();
        let sent = rig.pass(1);
        let is_requested = sent.contains(&Command::GetForceLimit);
        sent.iter().filter(|_| !is_requested).for_each(|command| rig.answer(command.id()));
        is_requested
    });
    assert_eq!((asked, due), (true, Some(rig.now)));
    rig.report(40.0);
    rig.pass_answered(1);
    assert!(!rig.session.poll_timeout().is_some_and(|due| rig.now.has_reached(due)));
}

#[test]
fn unknown_force_limit_causes_no_wake_up() {
    let mut rig = limited();
    rig.session.request(Command::GetTemperature).unwrap();
    for command in rig.sent() {
        rig.answer(command.id());
    }
    for _ in 0..2 * REFRESH_MS {
        assert!(!rig.session.poll_timeout().is_some_and(|due| rig.now.has_reached(due)));
        for command in rig.pass(1) {
            assert_ne!(command, Command::GetForceLimit);
            rig.answer(command.id());
        }
    }
}

#[test]
fn any_request_except_a_non_homing_motion_makes_it_unknown() {
    let script = Command::Unknown { id: 0xB0, payload: &[] };
    let tag = Command::SetDeviceTag { tag: crate::DeviceTag::new("x").unwrap() };
    let once = AutoUpdate::once();
    for request in [
        FORCE_40,
        Command::SetAcceleration { acceleration: 1_000.0 },
        Command::OverdriveMode { enabled: false },
        Command::TareForceSensor,
        tag,
        script,
        Command::GetTemperature,
        Command::GetForceLimit,
        Command::GetForce { update: once },
        Command::Stop,
        Command::FastStop,
        Command::ACKNOWLEDGE,
        // The requests that a restarted gripper needs.
        HOMING,
    ] {
        let mut rig = limited();
        rig.session.request(request).unwrap();
        assert_eq!(rig.limit(), None, "{request:?}");
    }
    let mut rig = limited();
    rig.session.request_borrowed(&script).unwrap();
    assert_eq!(rig.limit(), None, "borrowed");

    let (width, speed) = (20.0, 50.0);
    let flags = crate::PrePositionFlags::STOP_ON_BLOCK;
    for motion in [GRIP, Command::ReleasePart { width, speed }, Command::PrePosition { flags, width, speed }]
    {
        let mut rig = limited();
        rig.send(motion);
        assert_eq!(rig.limit(), Some(40.0), "{motion:?}");
    }
}

#[test]
fn it_stays_unknown_while_a_queued_request_may_change_it() {
    // Another limit, which is sent after the read-back, and a Stop, which delays the requests after it.
    for queued in [Command::SetForceLimit { force: 10.0 }, Command::Stop] {
        let mut rig = verifying();
        rig.exchange(FORCE_40, Status::Success);
        rig.session.request(queued).unwrap();
        rig.sent();
        rig.report(40.0);
        assert_eq!(rig.noticed("Answered(Reply { id: SetForceLimit"), 1, "{queued:?}");
        assert_eq!(rig.limit(), None, "{queued:?}");
    }
}

#[test]
fn it_stays_unknown_if_either_answer_may_precede_the_setting() {
    let mut rig = verifying();
    rig.exchange(FORCE_40, Status::Success);
    let asked = rig.pass(Config::DEFAULT.reply_timeout_ms).into_iter();
    assert_eq!(asked.filter(|command| *command == Command::GetForceLimit).count(), 2);
    rig.report(40.0);
    assert_eq!(rig.noticed("Answered(Reply { id: SetForceLimit"), 1);
    assert_eq!(rig.limit(), None);
}

#[test]
fn flag_change_without_a_motion_makes_it_unknown() {
    let motions = [
        SystemFlags::MOVING,
        SystemFlags::BLOCKED_MINUS,
        SystemFlags::BLOCKED_PLUS,
        SystemFlags::SOFT_LIMIT_MINUS,
        SystemFlags::SOFT_LIMIT_PLUS,
        SystemFlags::AXIS_STOPPED,
        SystemFlags::TARGET_POS_REACHED,
    ];
    for bit in 0..u32::BITS {
        let flag = SystemFlags::from_bits_retain(1 << bit);
        let mut rig = limited();
        let changed = SystemFlags::REFERENCED.symmetric_difference(flag);
        rig.reply(Reply::success(Value::GetSystemState(changed)));
        let stays = motions.contains(&flag);
        assert_eq!(rig.limit().is_some(), stays, "{flag:?}");
        // Also when the flag is cleared.
        let mut rig = verifying();
        rig.reply(Reply::success(Value::GetSystemState(changed)));
        rig.set(40.0, 40.0);
        rig.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED)));
        assert_eq!(rig.limit().is_some(), stays, "{flag:?}");
    }
}

#[test]
fn it_is_not_known_while_a_script_runs() {
    let mut rig = verifying();
    rig.reply(Reply::success(Value::GetSystemState(SystemFlags::REFERENCED | SystemFlags::SCRIPT_RUNNING)));
    rig.set(40.0, 40.0);
    assert_eq!(rig.events.last().unwrap(), &answered(CommandId::SetForceLimit, Status::Success));
    assert_eq!(rig.limit(), None);
}

#[test]
fn reading_a_different_limit_makes_it_unknown() {
    let mut rig = limited();
    rig.report(40.1);
    assert_eq!(rig.limit(), None, "unsolicited");

    let mut rig = limited();
    rig.until_queried();
    rig.report(39.9);
    assert_eq!(rig.limit(), None, "queried by the session");
    rig.report(40.0);
    assert_eq!(rig.pass_with(2 * REFRESH_MS, 40.0), 0, "only a new setting makes it known again");
    assert_eq!(rig.limit(), None);

    let mut rig = limited();
    rig.until_queried();
    rig.status(CommandId::GetForceLimit, Status::AccessDenied);
    assert_eq!(rig.limit(), None, "refused");
}

#[test]
fn limit_not_refreshed_in_time_becomes_unknown() {
    let mut rig = limited();
    let opened = rig.until_queried();
    assert_eq!(opened, REFRESH_MS / 2);
    rig.pass(REFRESH_REPLY_MS - 1);
    assert_eq!(rig.limit(), Some(40.0));
    rig.pass(1);
    assert_eq!(rig.limit(), None);

    // The time starts at the query, not at the answer.
    let mut rig = limited();
    let opened = rig.until_queried();
    rig.pass(40);
    rig.report(40.0);
    let asked = rig.until_queried();
    assert_eq!(opened + 40 + asked, REFRESH_MS);
    rig.pass(REFRESH_REPLY_MS - 1);
    assert_eq!(rig.limit(), Some(40.0));
    rig.pass(1);
    assert_eq!(rig.limit(), None);
}

#[test]
fn time_of_a_read_back_starts_at_its_query_too() {
    let mut rig = verifying();
    rig.exchange(FORCE_40, Status::Success);
    assert_eq!(rig.sent(), [Command::GetForceLimit]);
    rig.pass(40);
    rig.report(40.0);
    assert_eq!(rig.limit(), Some(40.0));
    assert_eq!(rig.until_queried(), REFRESH_MS / 2 - 40);
}

#[test]
fn limit_becomes_unknown_while_the_line_accepts_no_data() {
    let mut rig = limited();
    for _ in 0..REFRESH_MS {
        rig.now = rig.now.plus(1);
        assert_eq!(rig.session.tick(rig.now), None);
    }
    assert_eq!(rig.limit(), None);
}

#[test]
fn unanswered_query_is_not_repeated_and_other_queries_continue() {
    let mut rig = limited();
    rig.until_queried();
    let mut others = 0;
    for _ in 0..4 * REFRESH_MS {
        for command in rig.pass(1) {
            assert_ne!(command, Command::GetForceLimit);
            others += 1;
            rig.answer(command.id());
        }
    }
    assert!(rig.session.is_connected() && (7..=8).contains(&others), "{others}");
    assert_eq!(rig.session.counters().repeated, 0);
    rig.set(40.0, 40.0);
    assert_eq!(rig.limit(), Some(40.0), "a new setting makes it known again");
}

#[test]
fn unanswered_query_is_not_repeated_beside_a_read_back_either() {
    let mut rig = limited();
    rig.until_queried();
    rig.exchange(Command::SetForceLimit { force: 10.0 }, Status::Success);
    assert_eq!(rig.sent(), [Command::GetForceLimit], "the read-back");
    let sent = rig.pass(REFRESH_REPLY_MS + 1);
    assert!(!sent.contains(&Command::GetForceLimit), "{sent:?}");
}

#[test]
fn short_answer_time_ends_it_earlier() {
    let mut rig = Rig::with(Config { verify_settings: true, reply_timeout_ms: 80, ..Config::DEFAULT });
    rig.connect();
    rig.set(40.0, 40.0);
    rig.until_queried();
    rig.pass(19);
    assert_eq!(rig.limit(), Some(40.0));
    rig.pass(1);
    assert_eq!(rig.limit(), None);
}

#[test]
fn late_answer_to_an_earlier_query_does_not_answer_a_read_back() {
    for first in [40.0, 10.0] {
        let mut rig = limited();
        rig.until_queried();
        rig.exchange(Command::SetForceLimit { force: 10.0 }, Status::Success);
        assert_eq!(rig.sent(), [Command::GetForceLimit]);
        rig.report(first);
        assert_eq!(rig.events, [""; 0], "{first} N may precede the setting");
        assert_eq!(rig.limit(), None);
        rig.report(10.0);
        assert_eq!(rig.events, [answered(CommandId::SetForceLimit, Status::Success)]);
        assert_eq!(rig.limit(), Some(10.0));
        assert_eq!(rig.session.counters().unsolicited, 0);
    }
}

#[test]
fn query_not_sent_yet_does_not_take_the_answer_to_a_read_back() {
    let mut rig = limited();
    for _ in 0..REFRESH_MS / 2 {
        rig.now = rig.now.plus(1);
        rig.session.tick(rig.now);
    }
    // The query is due and has not been sent.
    rig.session.request(FORCE_40).unwrap();
    rig.session.tick(rig.now);
    assert_eq!(rig.session.poll_transmit(rig.now), Some(FORCE_40));
    rig.status(CommandId::SetForceLimit, Status::Success);
    rig.session.tick(rig.now);
    assert_eq!(rig.session.poll_transmit(rig.now), Some(Command::GetForceLimit));
    rig.report(40.0);
    assert_eq!(rig.events, [answered(CommandId::SetForceLimit, Status::Success)]);
    assert_eq!(rig.limit(), Some(40.0));
}

#[test]
fn force_limit_becomes_unknown_with_the_connection() {
    let mut rig = limited();
    rig.session.disconnect();
    rig.pass(1);
    assert_eq!(rig.limit(), None);
    rig.connect();
    rig.pass_with(2 * REFRESH_MS, 40.0);
    assert_eq!(rig.limit(), None);
}

/// Like `fast_stop_does_not_delay_the_detection_of_a_lost_line`, for a setting awaiting its read-back.
#[test]
fn read_back_held_by_fast_stop_does_not_delay_loss_detection() {
    for fast_stop_at in [100, 300, 500] {
        let mut rig = verifying();
        rig.exchange(FORCE_40, Status::Success);
        assert_eq!(rig.sent(), [Command::GetForceLimit]);
        rig.pass(fast_stop_at);
        rig.session.request(Command::FastStop).unwrap();
        rig.pass(610 - fast_stop_at);
        assert_eq!(rig.noticed("Disconnected"), 1, "FAST STOP after {fast_stop_at} ms of silence");
    }
}

#[test]
fn lost_answer_to_another_query_does_not_make_it_unknown() {
    // The lost answer may be due before, at and after the query of the force limit.
    for (lost, phase) in (1..=2).flat_map(|lost| (0..REFRESH_MS).step_by(10).map(move |ms| (lost, ms))) {
        let mut rig = verifying();
        rig.pass_healthy(phase);
        rig.set(40.0, 40.0);
        let mut others = 0;
        for _ in 0..2 * REFRESH_MS {
            for command in rig.pass(1) {
                if command == Command::GetForceLimit {
                    rig.report(40.0);
                    continue;
                }
                others += 1;
                if others != lost {
                    rig.answer(command.id());
                }
            }
            assert_eq!(rig.limit(), Some(40.0), "answer {lost} lost, set after {phase} ms");
        }
    }
}
