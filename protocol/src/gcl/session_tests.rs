//! The session in virtual time, against a gripper whose answers each test writes down.

use super::*;
use crate::gcl::{Grip, Move, Select, Setting};
use crate::types::{DeviceType, FirmwareVersion, GripperState, HomingDirection, SystemFlags};
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

const GRIP: Request = Request::Grip(Grip::Part { force: 40.0, width: 20.0 });
const HOME: Request = Request::Home(HomingDirection::Default);

/// A session, its clock, and what has happened.
struct Desk {
    session: Session,
    now: Instant,
    notices: Vec<String>,
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
            for request in self.pass(1) {
                self.answer(request);
            }
        }
        panic!("a gripper that answers is found");
    }

    /// Lets `ms` pass, one by one, noting what happens.
    fn pass(&mut self, ms: u32) -> Vec<Request> {
        let mut sent = self.sent();
        for _ in 0..ms {
            self.now = self.now.plus(1);
            sent.extend(self.sent());
        }
        sent
    }

    fn sent(&mut self) -> Vec<Request> {
        while let Some(notice) = self.session.tick(self.now) {
            self.note(notice);
            assert!(self.notices.len() < 10_000, "notices without end");
        }
        let mut sent = vec![];
        while let Some(request) = self.session.poll_transmit(self.now) {
            sent.push(request);
            assert!(sent.len() < 100, "requests without end");
        }
        sent
    }

    /// What is sent in `ms`, as lines, without the session's own, which are answered.
    fn lines(&mut self, ms: u32) -> Vec<String> {
        let mut lines = vec![];
        for at in 0..=ms {
            for request in self.pass(u32::from(at > 0)) {
                if is_own(request) {
                    self.answer(request);
                } else {
                    lines.push(request.to_string());
                }
            }
        }
        lines
    }

    fn hear(&mut self, line: &str) {
        let now = self.now;
        if let Some(notice) = self.session.handle(now, &LineEvent::Line(line.as_bytes())) {
            let text = describe(notice);
            self.notices.push(text);
        }
    }

    fn note(&mut self, notice: Notice<'_>) {
        self.notices.push(describe(notice));
    }

    /// A healthy gripper's answer to one of the session's own requests.
    fn answer(&mut self, request: Request) {
        let line: String = match request {
            Request::Verbose(on) => std::format!("VERBOSE={}", u8::from(on)),
            Request::Devtype => "DEVTYPE=\"WSG 50-110\"".into(),
            Request::Version => "VERSION=\"4.0.0\"".into(),
            Request::Sn => "SN=7".into(),
            Request::Autosend(_) => "ACK AUTOSEND".into(),
            Request::Gripstate => "GRIPSTATE=0".into(),
            Request::Sysflags(Select::All) => "SYSFLAGS=[1,0]".into(),
            Request::Pos => "POS=20.0".into(),
            other => panic!("{other} is none of the session's own"),
        };
        self.hear(&line);
    }

    /// Lets `ms` pass with a gripper that answers the session's own requests, and nothing else.
    fn pass_answered(&mut self, ms: u32) {
        for _ in 0..ms {
            for request in self.pass(1) {
                if is_own(request) {
                    self.answer(request);
                }
            }
        }
    }

    /// What has happened since the last time, without reports.
    fn happened(&mut self) -> Vec<String> {
        self.notices.retain(|notice| !notice.starts_with("Reported"));
        core::mem::take(&mut self.notices)
    }
}

fn is_own(request: Request) -> bool {
    matches!(
        request,
        Request::Verbose(_)
            | Request::Devtype
            | Request::Version
            | Request::Sn
            | Request::Autosend(_)
            | Request::Gripstate
            | Request::Sysflags(Select::All)
    )
}

fn describe(notice: Notice<'_>) -> String {
    match notice {
        Notice::Answered(answer) => std::format!("Answered {answer}"),
        Notice::Reported(value) => std::format!("Reported {value}"),
        Notice::Pending(name) => std::format!("Pending {name}"),
        Notice::Unanswered(name) => std::format!("Unanswered {name}"),
        Notice::Withdrawn(name) => std::format!("Withdrawn {name}"),
        Notice::Late(name) => std::format!("Late {name}"),
        other => std::format!("{other:?}"),
    }
}

#[test]
fn connecting_asks_who_it_is_and_subscribes_to_the_states() {
    let mut desk = Desk::new();
    let mut lines = vec![];
    for _ in 0..20 {
        if desk.session.is_connected() {
            break;
        }
        for request in desk.pass(1) {
            lines.push(request.to_string());
            desk.answer(request);
        }
    }
    assert_eq!(
        lines,
        [
            "VERBOSE=0",
            "DEVTYPE?",
            "VERSION?",
            "SN?",
            "AUTOSEND(\"GRIPSTATE\",10,1)",
            "GRIPSTATE?",
            "AUTOSEND(\"SYSFLAGS\",10,1)",
            "SYSFLAGS?"
        ]
    );
    assert_eq!(desk.happened(), ["Connected"]);
    let known = desk.session.known();
    assert_eq!(known.device, Some(DeviceType::Wsg50));
    assert_eq!(known.firmware, Some(FirmwareVersion::new(4, 0, 0, 0)));
    assert_eq!(known.serial_number, Some(7));
    assert_eq!(known.flags, Some(SystemFlags::REFERENCED));
    assert_eq!(known.state, Some(GripperState::Idle));
    assert!(!known.is_moving());
}

#[test]
fn gripper_that_does_not_know_a_question_of_identity_is_connected_all_the_same() {
    let mut desk = Desk::new();
    for _ in 0..100 {
        for request in desk.pass(1) {
            match request {
                Request::Verbose(_) | Request::Devtype | Request::Version | Request::Sn => {
                    let line = Answer::failed(request.name(), Status::CmdUnknown).to_string();
                    desk.hear(&line);
                }
                other => desk.answer(other),
            }
        }
    }
    assert!(desk.session.is_connected());
    assert_eq!(desk.session.known().device, None);
}

#[test]
fn gripper_that_refuses_its_states_is_not_connected() {
    let mut desk = Desk::new();
    for _ in 0..2_000 {
        for request in desk.pass(1) {
            let line = Answer::failed(request.name(), Status::AccessDenied).to_string();
            desk.hear(&line);
        }
    }
    assert!(!desk.session.is_connected());
}

#[test]
fn motion_is_acknowledged_and_finished_while_queries_go_on() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.lines(0), ["GRIP(40.0,20.0)"]);
    assert_eq!(desk.session.motion(), Some(CommandName::Grip));
    desk.hear("ACK GRIP");
    for request in [Request::Pos, Request::Force, Request::Tag] {
        desk.session.request(request).unwrap();
    }
    assert_eq!(desk.lines(0), ["POS?"]);
    desk.hear("POS=35.5");
    assert_eq!(desk.lines(0), ["FORCE?"]);
    desk.hear("FORCE=0.0");
    assert_eq!(desk.lines(0), ["TAG?"]);
    desk.hear("FIN GRIP");
    desk.hear("TAG=\"left\"");
    assert_eq!(
        desk.happened(),
        [
            "Pending GRIP",
            "Answered POS=35.5",
            "Answered FORCE=0.0",
            "Answered FIN GRIP",
            "Answered TAG=\"left\""
        ]
    );
    assert_eq!(desk.session.motion(), None);
    assert_eq!(desk.session.known().width, Some(35.5));
}

#[test]
fn motion_fails_before_or_after_its_acknowledgement() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ERR GRIP 3");
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ACK GRIP");
    desk.hear("ERR GRIP 18 E_CMD_FAILED");
    assert_eq!(desk.happened(), ["Answered ERR GRIP 3", "Pending GRIP", "Answered ERR GRIP 18 E_CMD_FAILED"]);
    assert_eq!(desk.session.motion(), None);
}

#[test]
fn second_motion_is_refused_while_one_runs_or_waits() {
    let mut desk = Desk::connected();
    desk.session.request(HOME).unwrap();
    assert_eq!(desk.session.request(GRIP), Err(RequestError::MotionRunning));
    desk.lines(0);
    assert_eq!(desk.session.request(GRIP), Err(RequestError::MotionRunning));
    desk.hear("ACK HOME");
    assert_eq!(desk.session.request(GRIP), Err(RequestError::MotionRunning));
    desk.hear("FIN HOME");
    assert_eq!(desk.session.request(GRIP), Ok(()));
}

#[test]
fn motion_without_an_answer_is_never_sent_again() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.lines(5_000), ["GRIP(40.0,20.0)"]);
    assert_eq!(desk.happened()[..2], ["Unanswered GRIP", "Disconnected"]);
}

#[test]
fn only_the_request_that_was_given_once_and_last_is_taken_back() {
    let mut desk = Desk::connected();
    let request = Request::Pwt(Setting::Set(1.0));
    desk.session.request(request).unwrap();
    assert!(!desk.session.take_back(CommandName::Pwt), "it was not given yet");
    assert_eq!(desk.lines(0), ["PWT=1.0"]);
    assert!(!desk.session.take_back(CommandName::Clt));
    assert!(desk.session.is_busy());
    assert!(desk.session.take_back(CommandName::Pwt));
    assert!(!desk.session.is_busy());
    assert_eq!(desk.lines(1_000), Vec::<String>::new());

    desk.session.request(request).unwrap();
    assert_eq!(desk.lines(Config::DEFAULT.reply_timeout_ms + 1), ["PWT=1.0", "PWT=1.0"]);
    assert!(!desk.session.take_back(CommandName::Pwt), "the first may have left");
    assert_eq!(desk.happened(), Vec::<String>::new());
}

#[test]
fn fsack_and_bye_are_never_sent_again() {
    for (request, line) in [(Request::Fsack, "FSACK()"), (Request::Bye, "BYE()")] {
        let mut desk = Desk::connected();
        desk.session.request(request).unwrap();
        assert_eq!(desk.lines(5_000), [line]);
    }
}

#[test]
fn queries_and_settings_are_sent_again_until_the_connection_counts_as_lost() {
    for request in [Request::Pos, Request::Pwt(Setting::Set(1.0))] {
        let mut desk = Desk::connected();
        desk.session.request(request).unwrap();
        assert_eq!(desk.lines(3_000), vec![request.to_string(); 3]);
        let happened = desk.happened();
        assert_eq!(happened[0], std::format!("Unanswered {}", request.name()));
        assert_eq!(happened[1], "Disconnected");
        assert_eq!(desk.session.counters().repeated, 2);
    }
}

#[test]
fn silence_is_noticed_within_a_second_and_a_gripper_that_comes_back_is_found() {
    let mut desk = Desk::connected();
    desk.pass(1_000);
    assert_eq!(desk.happened(), ["Disconnected"]);
    assert_eq!(*desk.session.known(), Known::NOTHING);
    assert_eq!(desk.session.request(Request::Pos), Err(RequestError::NotConnected));
    desk.connect();
    assert_eq!(desk.happened(), ["Connected"]);
}

#[test]
fn lost_connection_is_tried_again_after_its_time_and_not_before() {
    let mut desk = Desk::connected();
    while desk.happened() != ["Disconnected"] {
        desk.pass(1);
    }
    assert_eq!(desk.pass(Config::DEFAULT.reconnect_ms - 1), []);
    assert_eq!(desk.pass(2), [Request::Verbose(false)]);
}

#[test]
fn nothing_asked_for_before_a_disconnect_leaves_after_it() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Tag).unwrap();
    desk.session.request(GRIP).unwrap();
    desk.pass(1_000);
    assert_eq!(desk.happened(), ["Unanswered TAG", "Withdrawn GRIP", "Disconnected"]);
    desk.connect();
    assert_eq!(desk.lines(1_000), Vec::<String>::new());
}

#[test]
fn stop_overtakes_what_waits_and_ends_the_motion() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Move(Move { width: 50.0, speed: None })).unwrap();
    desk.lines(0);
    desk.hear("ACK MOVE");
    desk.session.request(Request::Tag).unwrap();
    desk.lines(0);
    desk.session.request(Request::Pos).unwrap();
    desk.session.request(Request::Stop).unwrap();
    assert_eq!(desk.lines(0), ["STOP()"]);
    desk.hear("ERR MOVE 19");
    desk.hear("ACK STOP");
    desk.hear("TAG=\"\"");
    assert_eq!(
        desk.happened(),
        ["Pending MOVE", "Withdrawn POS", "Answered ERR MOVE 19", "Answered ACK STOP", "Answered TAG=\"\""]
    );
}

#[test]
fn stop_without_a_connection_is_sent_once_and_never_later() {
    let mut desk = Desk::connected();
    desk.pass(1_000);
    desk.happened();
    desk.session.request(Request::Stop).unwrap();
    assert_eq!(desk.sent()[0], Request::Stop);
    desk.pass(300);
    assert_eq!(desk.happened(), ["Unanswered STOP"]);
    desk.connect();
    assert_eq!(desk.lines(1_000), Vec::<String>::new());
}

#[test]
fn stop_that_is_open_when_the_connection_goes_is_told_and_never_sent_again() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Stop).unwrap();
    assert_eq!(desk.lines(0), ["STOP()"]);
    desk.session.disconnect();
    desk.pass(1);
    assert_eq!(desk.happened(), ["Unanswered STOP", "Disconnected"]);
    desk.connect();
    assert_eq!(desk.lines(1_000), Vec::<String>::new());
}

#[test]
fn fast_stop_goes_out_first_and_is_repeated_until_it_is_confirmed() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Tag).unwrap();
    desk.session.request(Request::Faststop).unwrap();
    assert_eq!(desk.sent()[0], Request::Faststop);
    assert_eq!(desk.happened(), ["Withdrawn TAG"]);
    for refused in [GRIP, Request::Fsack, Request::Stop] {
        assert_eq!(desk.session.request(refused), Err(RequestError::FastStopRunning), "{refused}");
    }
    // An error is no confirmation.
    desk.hear("ERR FASTSTOP 15");
    assert!(desk.session.owes_fast_stop());
    assert!(desk.pass(400).contains(&Request::Faststop));
    desk.hear("ACK FASTSTOP");
    assert!(!desk.session.owes_fast_stop());
    assert_eq!(desk.happened(), ["Answered ACK FASTSTOP"]);
    assert_eq!(desk.session.request(Request::Fsack), Ok(()));
}

#[test]
fn nothing_but_fast_stop_is_sent_until_it_is_confirmed() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Faststop).unwrap();
    let sent = desk.pass(Config::DEFAULT.reply_timeout_ms * 2 + 1);
    assert_eq!(sent, [Request::Faststop; 3]);
}

#[test]
fn fsack_withdraws_what_was_requested_before_it() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Tag).unwrap();
    assert_eq!(desk.lines(0), ["TAG?"]);
    desk.session.request(GRIP).unwrap();
    desk.session.request(Request::Fsack).unwrap();
    desk.hear("TAG=\"left\"");
    assert_eq!(desk.lines(1), ["FSACK()"]);
    assert_eq!(desk.happened(), ["Answered TAG=\"left\"", "Withdrawn GRIP"]);
}

#[test]
fn stop_that_is_not_answered_in_time_is_reported_and_repeated() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Stop).unwrap();
    assert_eq!(desk.lines(Config::DEFAULT.reply_timeout_ms), ["STOP()", "STOP()"]);
    assert_eq!(desk.happened(), ["Late STOP"]);
}

#[test]
fn fast_stop_is_owed_over_a_reconnect_and_is_the_first_thing_a_gripper_hears() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Faststop).unwrap();
    let silent = desk.pass(3_000);
    assert!(silent.iter().filter(|request| **request == Request::Faststop).count() > 5);
    assert_eq!(desk.happened(), ["Disconnected"]);
    let silent = desk.pass(2 * Config::DEFAULT.reconnect_ms);
    assert!(silent.len() > 1 && silent.iter().all(|request| *request == Request::Faststop), "{silent:?}");
    desk.hear("ACK FASTSTOP");
    desk.connect();
    assert_eq!(desk.happened(), ["Answered ACK FASTSTOP", "Connected"]);
}

#[test]
fn fast_stop_is_never_acknowledged_by_the_session() {
    let mut desk = Desk::connected();
    desk.hear("@SYSFLAGS=[1,0,0,0,0,0,0,0,0,0,0,0,1]");
    assert!(desk.session.known().flags.unwrap().contains(SystemFlags::FAST_STOP));
    for _ in 0..5_000 {
        for request in desk.pass(1) {
            assert_ne!(request, Request::Fsack);
            desk.answer(request);
        }
    }
}

#[test]
fn lost_result_is_given_up_once_the_gripper_stands_still() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ACK GRIP");
    desk.hear("@GRIPSTATE=1");
    desk.hear("@GRIPSTATE=4");
    desk.pass_answered(900);
    assert_eq!(desk.happened(), ["Pending GRIP"]);
    desk.pass_answered(200);
    assert_eq!(desk.happened(), ["Unanswered GRIP"]);
    assert_eq!(desk.session.motion(), None);
    assert!(desk.session.is_connected());
}

#[test]
fn motion_that_never_ends_is_given_up_after_its_time() {
    let mut desk = Desk::connected();
    desk.session.request(HOME).unwrap();
    desk.lines(0);
    desk.hear("ACK HOME");
    for _ in 0..60_100 {
        for request in desk.pass(1) {
            match request {
                Request::Gripstate => desk.hear("GRIPSTATE=6"),
                other => desk.answer(other),
            }
        }
    }
    assert_eq!(desk.happened(), ["Pending HOME", "Unanswered HOME"]);
}

#[test]
fn late_result_is_not_taken_for_that_of_the_next_motion() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ACK GRIP");
    desk.hear("GRIPSTATE=4");
    desk.pass_answered(1_300);
    desk.session.request(GRIP).unwrap();
    assert_eq!(desk.lines(0), ["GRIP(40.0,20.0)"]);
    desk.hear("FIN GRIP");
    desk.hear("ERR GRIP 19");
    assert_eq!(desk.happened(), ["Pending GRIP", "Unanswered GRIP"]);
    desk.hear("ACK GRIP");
    desk.hear("ERR GRIP 18");
    assert_eq!(desk.happened(), ["Pending GRIP", "Answered ERR GRIP 18"]);
}

#[test]
fn refusal_behind_a_lost_result_is_that_of_the_new_request() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ACK GRIP");
    desk.hear("GRIPSTATE=4");
    desk.pass_answered(1_300);
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ERR GRIP 3");
    // How a motion ends may be how another request is refused.
    desk.session.request(Request::Pwt(Setting::Set(1.0))).unwrap();
    desk.lines(0);
    desk.hear("ERR PWT 18");
    assert_eq!(
        desk.happened(),
        ["Pending GRIP", "Unanswered GRIP", "Answered ERR GRIP 3", "Answered ERR PWT 18"]
    );
}

#[test]
fn states_are_asked_for_again_and_again_and_reported() {
    let mut desk = Desk::connected();
    desk.pass_answered(2_000);
    let reported = |text: &str| desk.notices.iter().filter(|notice| notice.starts_with(text)).count();
    assert!(reported("Reported GRIPSTATE=0") >= 2, "{:?}", desk.notices);
    assert!(reported("Reported SYSFLAGS=[1,0") >= 2, "{:?}", desk.notices);
}

#[test]
fn updates_are_reported_once_subscribed_to() {
    let mut desk = Desk::connected();
    desk.hear("@POS=20.0");
    assert_eq!(desk.session.counters().unasked, 1);
    desk.session.subscribe(Autosend::every(Signal::Pos, 3));
    assert_eq!(desk.pass(1)[0].to_string(), "AUTOSEND(\"POS\",10)");
    desk.hear("ACK AUTOSEND");
    desk.hear("@POS=21.0");
    desk.hear("@GRIPSTATE=6");
    assert_eq!(desk.notices, ["Reported POS=21.0", "Reported GRIPSTATE=6"]);
    assert!(desk.session.known().is_moving());
    desk.notices.clear();
    desk.session.request(Request::Autosend(Autosend::off(Signal::Pos))).unwrap();
    assert_eq!(desk.pass(1)[0].to_string(), "AUTOSEND(\"POS\",0)");
    desk.hear("ACK AUTOSEND");
    desk.hear("@POS=22.0");
    assert_eq!(desk.notices, Vec::<String>::new());
}

#[test]
fn each_subscription_that_changes_is_told_to_the_gripper_once() {
    let mut desk = Desk::connected();
    for signal in [Signal::Temp, Signal::Force] {
        desk.session.subscribe(Autosend::every(signal, 50));
    }
    let mut told = vec![];
    for _ in 0..100 {
        for request in desk.pass(1) {
            told.extend(matches!(request, Request::Autosend(_)).then(|| request.to_string()));
            desk.answer(request);
        }
    }
    assert_eq!(told, ["AUTOSEND(\"FORCE\",50)", "AUTOSEND(\"TEMP\",50)"]);
}

#[test]
fn what_a_gripper_says_is_known() {
    let mut desk = Desk::connected();
    for line in ["POS=20.5", "SPEED=1.5", "FORCE=2.5", "TEMP=35.5", "PWT=3.5", "CLT=4.5", "TAG=\"x\""] {
        desk.hear(line);
    }
    let known = desk.session.known();
    assert_eq!((known.width, known.speed, known.force), (Some(20.5), Some(1.5), Some(2.5)));
    assert_eq!(known.temperature, Some(35.5));
    assert_eq!((known.part_width_tolerance, known.clamping_travel), (Some(3.5), Some(4.5)));
}

#[test]
fn answer_that_comes_before_its_request_was_sent_is_none() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Tag).unwrap();
    while desk.session.tick(desk.now).is_some() {}
    desk.hear("TAG=\"left\"");
    assert_eq!(desk.happened(), Vec::<String>::new());
    assert_eq!(desk.lines(0), ["TAG?"]);
}

#[test]
fn subscriptions_are_made_again_after_a_reconnect() {
    let mut desk = Desk::with(Config { width: true, interval_ms: 1, ..Config::DEFAULT });
    desk.connect();
    desk.session.disconnect();
    let mut lines = vec![];
    for _ in 0..2_000 {
        if lines.iter().any(|line: &String| line.contains("POS")) {
            break;
        }
        for request in desk.pass(1) {
            lines.push(request.to_string());
            desk.answer(request);
        }
    }
    assert_eq!(lines.last().unwrap(), "AUTOSEND(\"POS\",10,0.01)");
}

#[test]
fn one_flag_and_all_of_them_are_not_taken_for_each_other() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Sysflags(Select::One(12))).unwrap();
    let mut sent = vec![];
    for _ in 0..260 {
        sent.extend(desk.pass(1));
        if sent.contains(&Request::Sysflags(Select::All)) || sent.len() > 1 {
            break;
        }
    }
    desk.hear("SYSFLAGS=[1,1]");
    desk.hear("SYSFLAGS[11]=0");
    assert_eq!(desk.happened(), Vec::<String>::new());
    desk.hear("SYSFLAGS[12]=1");
    assert_eq!(desk.happened(), ["Answered SYSFLAGS[12]=1"]);
}

#[test]
fn bye_ends_the_conversation_until_there_is_a_new_connection() {
    let mut desk = Desk::connected();
    desk.session.request(GRIP).unwrap();
    desk.lines(0);
    desk.hear("ACK GRIP");
    desk.session.request(Request::Bye).unwrap();
    assert_eq!(desk.lines(0), ["BYE()"]);
    desk.hear("ACK BYE");
    assert_eq!(desk.pass(5_000), []);
    assert_eq!(desk.happened(), ["Pending GRIP", "Answered ACK BYE", "Unanswered GRIP", "Disconnected"]);
    assert_eq!(desk.session.counters().disconnects, 0);
    assert_eq!(desk.session.poll_timeout(), None);
    assert_eq!(desk.session.request(Request::Pos), Err(RequestError::NotConnected));
    desk.session.disconnect();
    desk.connect();
    assert_eq!(desk.happened(), ["Connected"]);
}

#[test]
fn fast_stop_that_a_farewell_overtook_waits_for_the_next_connection() {
    let mut desk = Desk::connected();
    desk.session.request(Request::Bye).unwrap();
    assert_eq!(desk.lines(0), ["BYE()"]);
    desk.session.request(Request::Faststop).unwrap();
    assert_eq!(desk.lines(0), ["FASTSTOP()"]);
    desk.hear("ACK BYE");
    assert_eq!(desk.pass(5_000), []);
    desk.session.disconnect();
    assert_eq!(desk.pass(1), [Request::Faststop]);
}

#[test]
fn unasked_lines_and_what_is_no_answer_are_counted_and_change_nothing() {
    let mut desk = Desk::connected();
    for line in
        ["ACK GRIP", "FIN GRIP", "ERR GRIP 18", "ERR DANCE 14", "ERR ? 15", "TAG=\"left\"", "@TEMP=30.0"]
    {
        desk.hear(line);
    }
    assert_eq!(desk.session.counters().unasked, 7);
    desk.hear("hello");
    desk.session.handle(desk.now, &LineEvent::TooLong(b"FDATA=["));
    assert_eq!(desk.session.counters().refused, 2);
    assert_eq!(desk.happened(), Vec::<String>::new());
}

#[test]
fn what_a_gripper_may_not_take_is_refused_before_it_is_sent() {
    let mut desk = Desk::connected();
    let request = Request::Move(Move { width: f32::NAN, speed: None });
    assert_eq!(desk.session.request(request), Err(RequestError::Invalid(Mistake::Range)));
    desk.session.subscribe(Autosend::by(Signal::Sysflags, 10, 1.0));
    assert_eq!(desk.lines(100), Vec::<String>::new());
}

#[test]
fn more_requests_than_fit_are_refused() {
    let mut desk = Desk::connected();
    for _ in 0..QUEUE_LEN {
        desk.session.request(Request::Pos).unwrap();
    }
    assert_eq!(desk.session.request(Request::Pos), Err(RequestError::QueueFull));
    assert!(desk.session.is_busy());
}

#[test]
fn tick_at_the_announced_times_does_all_that_a_tick_at_each_millisecond_does() {
    let script = |request: Request, reply_timeout_ms: u32, by_announcement: bool| {
        let mut desk = Desk::with(Config { reply_timeout_ms, ..Config::DEFAULT });
        desk.connect();
        let end = desk.now.plus(4_000);
        desk.session.request(request).unwrap();
        let mut lines: Vec<String> = desk.sent().iter().map(ToString::to_string).collect();
        while !desk.now.has_reached(end) {
            let next = desk.now.plus(1);
            desk.now = match desk.session.poll_timeout() {
                _ if !by_announcement => next,
                Some(at) => {
                    assert!(at.has_reached(next), "{request}: a tick that was due already");
                    at.earlier_of(end)
                }
                None => end,
            };
            lines.extend(desk.sent().iter().map(ToString::to_string));
        }
        (lines, desk.happened())
    };
    for request in [Request::Tag, Request::Faststop] {
        // Less than the time between two tries to connect, and more.
        for timeout_ms in [200, 600] {
            let at_each_millisecond = script(request, timeout_ms, false);
            assert_eq!(script(request, timeout_ms, true), at_each_millisecond, "{request} {timeout_ms}");
        }
    }
}
