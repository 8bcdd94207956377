//! Cost of one command and its answer in the session.

use core::hint::black_box;

use cortex_m_semihosting::hprintln;
use wsg_protocol::session::{Config, Event, Session};
use wsg_protocol::{
    Command, CommandId, Event as FrameEvent, FrameEncoder, FrameParser, Instant, Reply, Status,
};
use wsg_sim::{MAX_FRAME_LEN, PortKind, Time, VirtualGripper};

use crate::counting::Counter;

/// Counts from the request to the event of its answer: queue, frame and answer, without transmission.
// Not inlined, so that register allocation is independent of the other measurements.
#[inline(never)]
pub(crate) fn count(counter: &Counter) {
    let mut session = Session::new(Config::DEFAULT);
    let mut parser = FrameParser::<64>::new();
    let now = connect(&mut session, &mut parser);

    let mut answer = [0; 16];
    let reply = Reply::status_only(CommandId::SetForceLimit, Status::Success);
    let length = FrameEncoder::new(CommandId::SetForceLimit.code(), reply).write_into(&mut answer);
    let answer = black_box(length.ok().and_then(|length| answer.get(..length)).unwrap_or(&[]));

    let (session, parser) = (black_box(&mut session), black_box(&mut parser));
    let mut sent = 0;
    let mut answered = false;
    let instructions = counter.of(|| {
        let taken = session.request(Command::SetForceLimit { force: black_box(40.0) });
        assert!(taken.is_ok(), "the session must accept the request");
        while session.tick(now).is_some() {}
        while let Some(command) = session.poll_transmit(now) {
            for byte in FrameEncoder::new(command.id().code(), command) {
                sent += usize::from(black_box(byte) != 0);
            }
        }
        if let (_, Some(event)) = parser.push_slice(answer) {
            answered = matches!(session.handle(now, &event), Some(Event::Answered(_)));
        }
    });
    assert!(answered && sent > 8, "the command must be sent and answered");
    hprintln!("round-trip {} 1", instructions);
}

/// Connects the session to a virtual gripper.
fn connect(session: &mut Session, parser: &mut FrameParser<64>) -> Instant {
    let mut gripper = VirtualGripper::<1>::with_ports(wsg_sim::Config::default());
    let Some(port) = gripper.connect(PortKind::Serial) else { unreachable!("a new gripper takes a client") };
    let mut ms = 0;
    while !session.is_connected() {
        ms += 1;
        assert!(ms < 1_000, "the session must connect within a second");
        let now = Instant::from_millis(ms);
        let time = Time::from_millis(ms.into());
        while session.tick(now).is_some() {}
        while let Some(command) = session.poll_transmit(now) {
            let mut request = [0; 64];
            if let Ok(length) = FrameEncoder::new(command.id().code(), command).write_into(&mut request) {
                gripper.receive(port, time, request.get(..length).unwrap_or(&[]));
            }
        }
        gripper.advance(time);
        let mut buffer = [0; MAX_FRAME_LEN];
        while let Some(mut rest) = gripper.transmit(port, &mut buffer) {
            while let (taken, Some(event)) = parser.push_slice(rest) {
                rest = rest.get(taken..).unwrap_or(&[]);
                if matches!(event, FrameEvent::Frame(_)) {
                    session.handle(now, &event);
                }
            }
        }
    }
    Instant::from_millis(ms)
}
