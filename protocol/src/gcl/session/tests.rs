//! The session in virtual time: the parts specific to GCL. The tests of [`crate::session`] cover the common engine. Each test plays the
//! gripper.

use super::*;
use crate::gcl::{Grip, Move, Select, Setting};
use crate::types::{DeviceType, FirmwareVersion, GripperState, HomingDirection, SystemFlags};
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

const GRIP: Request = Request::Grip(Grip::Part { force: 40.0, width: 20.0 });
const HOME: Request = Request::Home(HomingDirection::Default);

/// A session with its clock and its events.
struct Rig {
    session: Session,
    now: Instant,
    events: Vec<String>,
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

    /// Requests a command, which is sent at once and alone, and answers it with a line.
    #[track_caller]
    fn exchange(&mut self, request: Request, line: &str) {
        self.session.request(request).unwrap();
        assert_eq!(self.lines(0), [request.to_string()]);
        self.receive(line);
    }

    /// Returns a session that gave up waiting for the result of a GRIP.
    fn with_a_lost_result() -> Self {
        let mut rig = Self::connected();
        rig.exchange(GRIP, "ACK GRIP");
        rig.receive("GRIPSTATE=4");
        rig.pass_answered(1_300);
        rig
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
        panic!("the session does not connect to a gripper that answers");
    }

    /// Advances by `ms`, millisecond by millisecond. Returns the sent requests.
    fn pass(&mut self, ms: u32) -> Vec<Request> {
        let mut sent = self.sent();
        for _ in 0..ms {
            self.now = self.now.plus(1);
            sent.extend(self.sent());
        }
        sent
    }

    fn sent(&mut self) -> Vec<Request> {
        while let Some(event) = self.session.tick(self.now) {
            self.note(event);
            assert!(self.events.len() < 10_000, "endless events");
        }
        let mut sent = vec![];
        while let Some(request) = self.session.poll_transmit(self.now) {
            sent.push(request);
            assert!(sent.len() < 100, "endless requests");
        }
        sent
    }

    /// Returns the lines sent within `ms`. The session's own requests are answered and left out.
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

    fn receive(&mut self, line: &str) {
        let now = self.now;
        if let Some(event) = self.session.handle(now, &LineEvent::Line(line.as_bytes())) {
            let text = describe(event);
            self.events.push(text);
        }
    }

    fn note(&mut self, event: Event<'_>) {
        self.events.push(describe(event));
    }

    /// Answers one of the session's own requests like a healthy gripper.
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
            other => panic!("{other} is not one of the session's own requests"),
        };
        self.receive(&line);
    }

    /// Advances by `ms`, answering only the session's own requests.
    fn pass_answered(&mut self, ms: u32) {
        for _ in 0..ms {
            for request in self.pass(1) {
                if is_own(request) {
                    self.answer(request);
                }
            }
        }
    }

    /// Returns the events since the last call, without reports.
    fn happened(&mut self) -> Vec<String> {
        self.events.retain(|event| !event.starts_with("Reported"));
        core::mem::take(&mut self.events)
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

fn describe(event: Event<'_>) -> String {
    match event {
        Event::Answered(answer) => std::format!("Answered {answer}"),
        Event::Reported(value) => std::format!("Reported {value}"),
        Event::Pending(name) => std::format!("Pending {name}"),
        Event::Unanswered(name) => std::format!("Unanswered {name}"),
        Event::Withdrawn(name) => std::format!("Withdrawn {name}"),
        Event::Late(name) => std::format!("Late {name}"),
        other => std::format!("{other:?}"),
    }
}

#[test]
fn connecting_queries_the_device_and_subscribes_to_the_states() {
    let mut rig = Rig::new();
    let mut lines = vec![];
    for _ in 0..20 {
        if rig.session.is_connected() {
            break;
        }
        for request in rig.pass(1) {
            lines.push(request.to_string());
            rig.answer(request);
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
    assert_eq!(rig.happened(), ["Connected"]);
    let known = rig.session.known();
    assert_eq!(known.device, Some(DeviceType::Wsg50));
    assert_eq!(known.firmware, Some(FirmwareVersion::new(4, 0, 0, 0)));
    assert_eq!(known.serial_number, Some(7));
    assert_eq!(known.flags, Some(SystemFlags::REFERENCED));
    assert_eq!(known.state, Some(GripperState::Idle));
    assert!(!known.is_moving());
}

#[test]
fn gripper_that_refuses_the_device_queries_is_connected() {
    let mut rig = Rig::new();
    for _ in 0..100 {
        for request in rig.pass(1) {
            match request {
                Request::Verbose(_) | Request::Devtype | Request::Version | Request::Sn => {
                    let line = Answer::failed(request.name(), Status::CmdUnknown).to_string();
                    rig.receive(&line);
                }
                other => rig.answer(other),
            }
        }
    }
    assert!(rig.session.is_connected());
    assert_eq!(rig.session.known().device, None);
}

#[test]
fn gripper_that_refuses_its_states_is_not_connected() {
    let mut rig = Rig::new();
    for _ in 0..2_000 {
        for request in rig.pass(1) {
            let line = Answer::failed(request.name(), Status::AccessDenied).to_string();
            rig.receive(&line);
        }
    }
    assert!(!rig.session.is_connected());
}

#[test]
fn motion_is_acknowledged_and_finished_while_queries_continue() {
    let mut rig = Rig::connected();
    rig.session.request(GRIP).unwrap();
    assert_eq!(rig.lines(0), ["GRIP(40.0,20.0)"]);
    assert_eq!(rig.session.motion(), Some(CommandName::Grip));
    rig.receive("ACK GRIP");
    for request in [Request::Pos, Request::Force, Request::Tag] {
        rig.session.request(request).unwrap();
    }
    assert_eq!(rig.lines(0), ["POS?"]);
    rig.receive("POS=35.5");
    assert_eq!(rig.lines(0), ["FORCE?"]);
    rig.receive("FORCE=0.0");
    assert_eq!(rig.lines(0), ["TAG?"]);
    rig.receive("FIN GRIP");
    rig.receive("TAG=\"left\"");
    assert_eq!(
        rig.happened(),
        [
            "Pending GRIP",
            "Answered POS=35.5",
            "Answered FORCE=0.0",
            "Answered FIN GRIP",
            "Answered TAG=\"left\""
        ]
    );
    assert_eq!(rig.session.motion(), None);
    assert_eq!(rig.session.known().width, Some(35.5));
}

#[test]
fn motion_fails_before_or_after_its_acknowledgement() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, "ERR GRIP 3");
    rig.exchange(GRIP, "ACK GRIP");
    rig.receive("ERR GRIP 18 E_CMD_FAILED");
    assert_eq!(rig.happened(), ["Answered ERR GRIP 3", "Pending GRIP", "Answered ERR GRIP 18 E_CMD_FAILED"]);
    assert_eq!(rig.session.motion(), None);
}

#[test]
fn only_the_last_request_sent_once_is_taken_back() {
    let mut rig = Rig::connected();
    let request = Request::Pwt(Setting::Set(1.0));
    rig.session.request(request).unwrap();
    assert!(!rig.session.take_back(CommandName::Pwt), "it was not sent yet");
    assert_eq!(rig.lines(0), ["PWT=1.0"]);
    assert!(!rig.session.take_back(CommandName::Clt));
    assert!(rig.session.is_busy());
    assert!(rig.session.take_back(CommandName::Pwt));
    assert!(!rig.session.is_busy());
    assert_eq!(rig.lines(1_000), Vec::<String>::new());

    rig.session.request(request).unwrap();
    assert_eq!(rig.lines(Config::DEFAULT.reply_timeout_ms + 1), ["PWT=1.0", "PWT=1.0"]);
    assert!(!rig.session.take_back(CommandName::Pwt), "the first one may have been sent");
    assert_eq!(rig.happened(), Vec::<String>::new());
}

#[test]
fn only_queries_and_settings_are_repeated_until_connection_loss() {
    for (request, times) in [
        (Request::Pos, 3),
        (Request::Pwt(Setting::Set(1.0)), 3),
        (GRIP, 1),
        (Request::Fsack, 1),
        (Request::Bye, 1),
    ] {
        let mut rig = Rig::connected();
        rig.session.request(request).unwrap();
        assert_eq!(rig.lines(5_000), vec![request.to_string(); times]);
        let unanswered = std::format!("Unanswered {}", request.name());
        assert_eq!(rig.happened()[..2], [&unanswered[..], "Disconnected"]);
    }
}

#[test]
fn lost_connection_is_tried_again_after_its_time_and_not_before() {
    let mut rig = Rig::connected();
    while rig.happened() != ["Disconnected"] {
        rig.pass(1);
    }
    assert_eq!(rig.pass(Config::DEFAULT.reconnect_ms - 1), []);
    assert_eq!(rig.pass(2), [Request::Verbose(false)]);
}

#[test]
fn fast_stop_is_sent_first_and_repeated_until_confirmed() {
    let mut rig = Rig::connected();
    rig.session.request(Request::Tag).unwrap();
    rig.session.request(Request::Faststop).unwrap();
    assert_eq!(rig.sent()[0], Request::Faststop);
    assert_eq!(rig.happened(), ["Withdrawn TAG"]);
    for refused in [GRIP, Request::Fsack, Request::Stop] {
        assert_eq!(rig.session.request(refused), Err(RequestError::FastStopRunning), "{refused}");
    }
    // An error does not confirm it.
    rig.receive("ERR FASTSTOP 15");
    assert!(rig.session.fast_stop_pending());
    assert!(rig.pass(400).contains(&Request::Faststop));
    rig.receive("ACK FASTSTOP");
    assert!(!rig.session.fast_stop_pending());
    assert_eq!(rig.happened(), ["Answered ACK FASTSTOP"]);
    assert_eq!(rig.session.request(Request::Fsack), Ok(()));
}

#[test]
fn fsack_withdraws_earlier_requests() {
    let mut rig = Rig::connected();
    rig.session.request(Request::Tag).unwrap();
    assert_eq!(rig.lines(0), ["TAG?"]);
    rig.session.request(GRIP).unwrap();
    rig.session.request(Request::Fsack).unwrap();
    rig.receive("TAG=\"left\"");
    assert_eq!(rig.lines(1), ["FSACK()"]);
    assert_eq!(rig.happened(), ["Answered TAG=\"left\"", "Withdrawn GRIP"]);
}

#[test]
fn gripper_fast_stop_withdraws_unsent_motion_or_setting() {
    let setting = Request::Pwt(Setting::Set(1.0));
    for (request, withdrawn) in [(GRIP, "Withdrawn GRIP"), (setting, "Withdrawn PWT")] {
        let mut rig = Rig::connected();
        rig.session.request(Request::Tag).unwrap();
        assert_eq!(rig.lines(0), ["TAG?"]);
        rig.session.request(request).unwrap();
        rig.receive("SYSFLAGS=[1,0,0,0,0,0,0,0,0,0,0,0,1]");
        rig.receive("TAG=\"left\"");
        assert_eq!(rig.lines(1), [""; 0]);
        assert_eq!(rig.happened().last().map(String::as_str), Some(withdrawn));
    }
}

#[test]
fn motion_that_never_ends_is_given_up_after_its_time() {
    let mut rig = Rig::connected();
    rig.exchange(HOME, "ACK HOME");
    for _ in 0..60_100 {
        for request in rig.pass(1) {
            match request {
                Request::Gripstate => rig.receive("GRIPSTATE=6"),
                other => rig.answer(other),
            }
        }
    }
    assert_eq!(rig.happened(), ["Pending HOME", "Unanswered HOME"]);
}

#[test]
fn late_result_is_not_taken_for_that_of_the_next_motion() {
    let mut rig = Rig::with_a_lost_result();
    rig.exchange(GRIP, "FIN GRIP");
    rig.receive("ERR GRIP 19");
    assert_eq!(rig.happened(), ["Pending GRIP", "Unanswered GRIP"]);
    rig.receive("ACK GRIP");
    rig.receive("ERR GRIP 18");
    assert_eq!(rig.happened(), ["Pending GRIP", "Answered ERR GRIP 18"]);
}

#[test]
fn refusal_after_a_lost_result_belongs_to_the_new_request() {
    let mut rig = Rig::with_a_lost_result();
    rig.exchange(GRIP, "ERR GRIP 3");
    // A status that ends a motion may also refuse another request.
    rig.exchange(Request::Pwt(Setting::Set(1.0)), "ERR PWT 18");
    assert_eq!(
        rig.happened(),
        ["Pending GRIP", "Unanswered GRIP", "Answered ERR GRIP 3", "Answered ERR PWT 18"]
    );
}

#[test]
fn states_are_polled_and_reported() {
    let mut rig = Rig::connected();
    rig.pass_answered(2_000);
    let reported = |text: &str| rig.events.iter().filter(|event| event.starts_with(text)).count();
    assert!(reported("Reported GRIPSTATE=0") >= 2, "{:?}", rig.events);
    assert!(reported("Reported SYSFLAGS=[1,0") >= 2, "{:?}", rig.events);
}

#[test]
fn updates_are_reported_once_subscribed_to() {
    let mut rig = Rig::connected();
    rig.receive("@POS=20.0");
    assert_eq!(rig.session.counters().unsolicited, 1);
    rig.session.subscribe(Autosend::every(Topic::Pos, 3));
    assert_eq!(rig.pass(1)[0].to_string(), "AUTOSEND(\"POS\",10)");
    rig.receive("ACK AUTOSEND");
    rig.receive("@POS=21.0");
    rig.receive("@GRIPSTATE=6");
    assert_eq!(rig.events, ["Reported POS=21.0", "Reported GRIPSTATE=6"]);
    assert!(rig.session.known().is_moving());
    rig.events.clear();
    rig.session.request(Request::Autosend(Autosend::off(Topic::Pos))).unwrap();
    assert_eq!(rig.pass(1)[0].to_string(), "AUTOSEND(\"POS\",0)");
    rig.receive("ACK AUTOSEND");
    rig.receive("@POS=22.0");
    assert_eq!(rig.events, Vec::<String>::new());
}

#[test]
fn values_in_answers_become_known() {
    let mut rig = Rig::connected();
    for line in ["POS=20.5", "SPEED=1.5", "FORCE=2.5", "TEMP=35.5", "PWT=3.5", "CLT=4.5", "TAG=\"x\""] {
        rig.receive(line);
    }
    let known = rig.session.known();
    assert_eq!((known.width, known.speed, known.force), (Some(20.5), Some(1.5), Some(2.5)));
    assert_eq!(known.temperature, Some(35.5));
    assert_eq!((known.part_width_tolerance, known.clamping_travel), (Some(3.5), Some(4.5)));
}

#[test]
fn subscriptions_are_made_again_after_a_reconnect() {
    let mut rig = Rig::with(Config { width: true, interval_ms: 1, ..Config::DEFAULT });
    rig.connect();
    rig.session.disconnect();
    let mut lines = vec![];
    for _ in 0..2_000 {
        if lines.iter().any(|line: &String| line.contains("POS")) {
            break;
        }
        for request in rig.pass(1) {
            lines.push(request.to_string());
            rig.answer(request);
        }
    }
    assert_eq!(lines.last().unwrap(), "AUTOSEND(\"POS\",10,0.01)");
}

#[test]
fn one_flag_and_all_flags_are_not_confused() {
    let mut rig = Rig::connected();
    rig.session.request(Request::Sysflags(Select::One(12))).unwrap();
    let mut sent = vec![];
    for _ in 0..260 {
        sent.extend(rig.pass(1));
        if sent.contains(&Request::Sysflags(Select::All)) || sent.len() > 1 {
            break;
        }
    }
    rig.receive("SYSFLAGS=[1,1]");
    rig.receive("SYSFLAGS[11]=0");
    assert_eq!(rig.happened(), Vec::<String>::new());
    rig.receive("SYSFLAGS[12]=1");
    assert_eq!(rig.happened(), ["Answered SYSFLAGS[12]=1"]);
}

#[test]
fn bye_silences_the_session_until_a_new_connection() {
    let mut rig = Rig::connected();
    rig.exchange(GRIP, "ACK GRIP");
    rig.exchange(Request::Bye, "ACK BYE");
    assert_eq!(rig.pass(5_000), []);
    assert_eq!(rig.happened(), ["Pending GRIP", "Answered ACK BYE", "Unanswered GRIP", "Disconnected"]);
    assert_eq!(rig.session.counters().disconnects, 0);
    assert_eq!(rig.session.poll_timeout(), None);
    assert_eq!(rig.session.request(Request::Pos), Err(RequestError::NotConnected));
    rig.session.disconnect();
    rig.connect();
    assert_eq!(rig.happened(), ["Connected"]);
}

#[test]
fn stop_after_bye_is_refused_and_not_sent_on_reconnect() {
    let mut rig = Rig::connected();
    rig.exchange(Request::Bye, "ACK BYE");
    rig.pass(1);
    assert_eq!(rig.session.request(Request::Stop), Err(RequestError::NotConnected));
    rig.session.disconnect();
    rig.connect();
    assert_eq!(rig.lines(1_000), Vec::<String>::new());
}

#[test]
fn fast_stop_pending_at_bye_waits_for_the_next_connection() {
    let mut rig = Rig::connected();
    rig.session.request(Request::Bye).unwrap();
    assert_eq!(rig.lines(0), ["BYE()"]);
    rig.exchange(Request::Faststop, "ACK BYE");
    assert_eq!(rig.pass(5_000), []);
    rig.session.disconnect();
    assert_eq!(rig.pass(1), [Request::Faststop]);
}

#[test]
fn unsolicited_and_invalid_lines_are_counted_and_change_nothing() {
    let mut rig = Rig::connected();
    for line in
        ["ACK GRIP", "FIN GRIP", "ERR GRIP 18", "ERR DANCE 14", "ERR ? 15", "TAG=\"left\"", "@TEMP=30.0"]
    {
        rig.receive(line);
    }
    assert_eq!(rig.session.counters().unsolicited, 7);
    rig.receive("hello");
    rig.session.handle(rig.now, &LineEvent::TooLong(b"FDATA=["));
    assert_eq!(rig.session.counters().refused, 2);
    assert_eq!(rig.happened(), Vec::<String>::new());
}

#[test]
fn invalid_request_is_refused_before_it_is_sent() {
    let mut rig = Rig::connected();
    let request = Request::Move(Move { width: f32::NAN, speed: None });
    assert_eq!(rig.session.request(request), Err(RequestError::Invalid(ParseError::Range)));
    rig.session.subscribe(Autosend::by(Topic::Sysflags, 10, 1.0));
    assert_eq!(rig.lines(100), Vec::<String>::new());
}

#[test]
fn ticks_at_announced_times_act_like_a_tick_each_millisecond() {
    let script = |request: Request, reply_timeout_ms: u32, by_announcement: bool| {
        let mut rig = Rig::with(Config { reply_timeout_ms, ..Config::DEFAULT });
        rig.connect();
        let end = rig.now.plus(4_000);
        rig.session.request(request).unwrap();
        let mut lines: Vec<String> = rig.sent().iter().map(ToString::to_string).collect();
        while !rig.now.has_reached(end) {
            let next = rig.now.plus(1);
            rig.now = match rig.session.poll_timeout() {
                _ if !by_announcement => next,
                Some(at) => {
                    assert!(at.has_reached(next), "{request}: a tick that was due already");
                    at.earlier_of(end)
                }
                None => end,
            };
            lines.extend(rig.sent().iter().map(ToString::to_string));
        }
        (lines, rig.happened())
    };
    for request in [Request::Tag, Request::Faststop] {
        // Less than the time between two tries to connect, and more.
        for timeout_ms in [200, 600] {
            let at_each_millisecond = script(request, timeout_ms, false);
            assert_eq!(script(request, timeout_ms, true), at_each_millisecond, "{request} {timeout_ms}");
        }
    }
}
