use super::*;
use wsg_protocol::{Status, Value};

const RUNNING: InputImage = image(GripperFlags::GRIPPING, SystemFlags::MOVING, Status::CmdPending, 500);
const DONE: InputImage = image(GripperFlags::HOLDING, SystemFlags::empty(), Status::Success, 500);

const fn image(state: GripperFlags, system: SystemFlags, status: Status, force: i16) -> InputImage {
    InputImage { state, user: 3, system, width: 2_000, force, status }
}

fn at(ms: u32) -> Instant {
    Instant::from_millis(ms)
}

/// Returns the state after a motion at 0 ms and its end at 1 ms.
fn ended() -> MotionEnd {
    let mut end = MotionEnd::new();
    assert!(!end.look(at(0), &RUNNING));
    assert!(end.look(at(1), &DONE), "width and force are queried");
    assert!(!end.look(at(1), &DONE), "only once");
    end
}

#[test]
fn end_waits_for_both_values_which_are_shown_at_once() {
    let mut end = ended();
    let fresh = InputImage { force: 4_000, ..DONE };
    assert_eq!(end.shown(fresh), InputImage { force: 4_000, ..RUNNING });
    end.see(&Event::Reported(Value::GetOpeningWidth(20.0)));
    assert!(!end.look(at(3), &fresh));
    assert_eq!(end.shown(fresh).status, Status::CmdPending);
    end.see(&Event::Reported(Value::GetForce(40.0)));
    assert!(!end.look(at(4), &fresh));
    assert_eq!(end.shown(fresh), fresh);
    assert!(!end.is_awaited());
}

#[test]
fn end_waits_for_at_most_10_ms() {
    let mut end = ended();
    assert!(!end.look(at(10), &DONE));
    assert_eq!(end.shown(DONE).state, GripperFlags::GRIPPING);
    end.look(at(11), &DONE);
    assert_eq!(end.shown(DONE), DONE);
}

#[test]
fn other_values_and_those_before_the_end_do_not_end_the_wait() {
    let mut end = MotionEnd::new();
    end.look(at(0), &RUNNING);
    end.see(&Event::Reported(Value::GetOpeningWidth(21.0)));
    end.look(at(1), &DONE);
    end.see(&Event::Reported(Value::GetSpeed(0.0)));
    end.see(&Event::Reported(Value::GetForce(40.0)));
    end.look(at(2), &DONE);
    assert_eq!(end.shown(DONE).state, GripperFlags::GRIPPING);
}

#[test]
fn errors_are_shown_at_once() {
    for wrong in [
        image(GripperFlags::ERROR, SystemFlags::empty(), Status::AxisBlocked, 0),
        image(GripperFlags::IDLE, SystemFlags::FAST_STOP, Status::Success, 0),
    ] {
        let mut end = MotionEnd::new();
        end.look(at(0), &RUNNING);
        assert!(!end.look(at(1), &wrong));
        assert_eq!(end.shown(wrong), wrong);
        // The same during the wait.
        let mut end = ended();
        end.look(at(2), &wrong);
        assert_eq!(end.shown(wrong), wrong);
    }
}

#[test]
fn next_motion_is_shown_at_once() {
    let mut end = ended();
    let next = InputImage { state: GripperFlags::RELEASING, ..RUNNING };
    assert_eq!(end.shown(next), next, "for a master that reads in the turn of its command");
    assert!(!end.look(at(2), &next));
    assert_eq!(end.shown(next), next);
    assert!(end.look(at(3), &DONE), "its end waits for new values");
}

#[test]
fn nothing_is_queried_without_a_motion() {
    let mut end = MotionEnd::new();
    assert!(!end.look(at(0), &DONE) && !end.look(at(1), &DONE));
    assert_eq!(end.shown(DONE), DONE);
}
