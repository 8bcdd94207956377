//! Both sides of the text protocol: the controller's session of `wsg-protocol` with the virtual gripper, in virtual time.

use wsg_protocol::gcl::session::{Config as SessionConfig, Event, Session};
use wsg_protocol::gcl::{CommandName, Grip, LineReader, MAX_LINE_LEN, Move, Release, Request};
use wsg_protocol::{DeviceType, GripperState, HomingDirection, Instant, SystemFlags};
use wsg_sim::{Config, MAX_FRAME_LEN, Part, PortId, PortKind, Time, VirtualGripper};

struct Rig {
    gripper: VirtualGripper,
    port: PortId,
    session: Session,
    reader: LineReader<MAX_LINE_LEN>,
    millis: u32,
    events: Vec<String>,
}

impl Rig {
    fn new(part: Option<Part>) -> Self {
        let mut gripper = VirtualGripper::new(Config { part, ..Config::default() });
        let port = gripper.connect(PortKind::GclTcp).unwrap();
        let session = Session::new(SessionConfig { width: true, ..SessionConfig::DEFAULT });
        Self { gripper, port, session, reader: LineReader::new(), millis: 0, events: vec![] }
    }

    fn pass(&mut self, millis: u32) {
        for _ in 0..millis {
            self.millis += 1;
            let (now, time) = (Instant::from_millis(self.millis), Time::from_millis(self.millis.into()));
            self.gripper.advance(time);
            let mut buffer = [0; MAX_FRAME_LEN];
            while let Some(line) = self.gripper.transmit(self.port, &mut buffer) {
                let (_, event) = self.reader.push_slice(line);
                let event = event.expect("a whole line");
                match self.session.handle(now, &event) {
                    None | Some(Event::Reported(_)) => {}
                    Some(Event::Answered(answer)) => self.events.push(answer.to_string()),
                    Some(event) => self.events.push(format!("{event:?}")),
                }
            }
            while let Some(event) = self.session.tick(now) {
                self.events.push(format!("{event:?}"));
            }
            while let Some(request) = self.session.poll_transmit(now) {
                let mut line = [0; Request::MAX_LEN + 1];
                let len = request.write_line_into(&mut line).unwrap();
                self.gripper.receive(self.port, time, &line[..len]);
            }
        }
    }

    fn run(&mut self, request: Request) -> Vec<String> {
        self.session.request(request).unwrap();
        self.pass(5_000);
        core::mem::take(&mut self.events)
    }
}

#[test]
fn session_connects_homes_grips_and_releases() {
    let mut rig = Rig::new(Part::of_width(20.0));
    rig.pass(200);
    assert_eq!(core::mem::take(&mut rig.events), ["Connected"]);
    assert_eq!(rig.session.known().device, Some(DeviceType::Wsg50));
    assert_eq!(rig.run(Request::Home(HomingDirection::Default)), ["Pending(Home)", "FIN HOME"]);
    assert_eq!(rig.session.known().width, Some(110.0));
    let grip = Request::Grip(Grip::Part { force: 40.0, width: 20.0 });
    assert_eq!(rig.run(grip), ["Pending(Grip)", "FIN GRIP"]);
    assert_eq!(rig.session.known().state, Some(GripperState::Holding));
    assert_eq!(rig.run(grip), ["ERR GRIP 4"]);
    let release = Request::Release(Release::By { distance: 5.0 });
    assert_eq!(rig.run(release), ["Pending(Release)", "FIN RELEASE"]);
    assert_eq!(rig.session.counters().unsolicited, 0);
    assert_eq!(rig.session.counters().refused, 0);
}

#[test]
fn session_stops_and_fast_stops_a_motion() {
    let mut rig = Rig::new(None);
    rig.pass(200);
    rig.run(Request::Home(HomingDirection::Default));
    rig.events.clear();
    let slowly = Request::Move(Move { width: 10.0, speed: Some(10.0) });
    rig.session.request(slowly).unwrap();
    rig.pass(500);
    assert_eq!(rig.session.motion(), Some(CommandName::Move));
    assert_eq!(rig.run(Request::Stop), ["Pending(Move)", "ACK STOP", "ERR MOVE 19"]);
    rig.session.request(slowly).unwrap();
    rig.pass(500);
    assert_eq!(rig.run(Request::Faststop), ["Pending(Move)", "ACK FASTSTOP", "ERR MOVE 19"]);
    assert!(rig.session.known().flags.unwrap().contains(SystemFlags::FAST_STOP));
    assert_eq!(rig.run(slowly), ["ERR MOVE 16"]);
    assert_eq!(rig.run(Request::Fsack), ["ACK FSACK"]);
    assert_eq!(rig.run(Request::Bye), ["ACK BYE", "Disconnected"]);
    rig.gripper.disconnect(rig.port, Time::from_millis(rig.millis.into()));
    assert!(!rig.gripper.state().flags.contains(SystemFlags::FAST_STOP));
}
