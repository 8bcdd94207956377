use super::*;
use wsg_protocol::CommandId;

fn registers(events: &Events, number: u8) -> [u16; EVENT_LEN] {
    core::array::from_fn(|field| events.register(number, field as u8))
}

fn at(ms: u32) -> Instant {
    Instant::from_millis(ms)
}

#[test]
fn codes_are_ascending_and_names_unique() {
    assert!(EVENTS.windows(2).all(|two| (two[0].code as u8) < two[1].code as u8));
    for (number, event) in EVENTS.iter().enumerate() {
        assert!(EVENTS[..number].iter().all(|other| other.name != event.name));
        assert!(!event.meaning.is_empty() && !event.remedy.is_empty(), "{}", event.name);
    }
}

#[test]
fn events_are_read_latest_first_with_their_age() {
    let mut events = Events::new();
    assert_eq!(registers(&events, 0), [0; 4]);
    events.grow_old(at(2_500));
    events.happened(EventCode::GripperSilent, 0);
    events.grow_old(at(3_600));
    let incident = Incident { cause: Cause::Gripper, command: Some(CommandId::GripPart), value: 14 };
    events.note(incident, EventCode::BusFlag);
    events.grow_old(at(5_999));
    assert_eq!(registers(&events, 0), [EventCode::Refused as u16, 0x25, 14, 2]);
    assert_eq!(registers(&events, 1), [EventCode::GripperSilent as u16, 0, 0, 3]);
    assert_eq!(registers(&events, 2), [0; 4]);
    assert_eq!(events.count(), 2);
}

#[test]
fn sixteen_events_are_kept_and_ages_saturate() {
    let mut events = Events::new();
    for value in 0..300 {
        events.happened(EventCode::BusSilent, value);
    }
    for number in 0..16 {
        assert_eq!(registers(&events, number)[2], 299 - u16::from(number));
    }
    assert_eq!(events.count(), 300);
    events.grow_old(at(70_000_000));
    assert_eq!(registers(&events, 0)[3], u16::MAX);
}

#[test]
fn last_fast_stop_is_kept_despite_later_events() {
    let mut events = Events::new();
    assert_eq!(events.cause_of_error(true), 0);
    let flag = Incident { cause: Cause::Flag, command: None, value: 0 };
    events.note(flag, EventCode::Wire);
    assert_eq!(events.fast_stop_register(0), EventCode::Wire as u16);
    events.note(flag, EventCode::BusFlag);
    for _ in 0..20 {
        events.note(Incident { cause: Cause::FastStopLasts, command: None, value: 0 }, EventCode::Wire);
    }
    assert_eq!(events.fast_stop_register(0), EventCode::BusFlag as u16);
    assert_eq!(events.cause_of_error(true), EventCode::BusFlag as u8);
    assert_eq!(events.cause_of_error(false), EventCode::FastStopLasts as u8);
}

#[test]
fn rising_flags_are_events() {
    let mut events = Events::new();
    let faults = SystemFlags::TEMP_FAULT | SystemFlags::FAST_STOP;
    events.see_flags(faults, false);
    events.see_flags(faults, false);
    assert_eq!(events.count(), 2);
    assert_eq!(events.fast_stop_register(0), EventCode::GripperFastStop as u16);
    events.see_flags(SystemFlags::empty(), false);
    events.see_flags(SystemFlags::FAST_STOP, true);
    assert_eq!(events.count(), 2, "the bridge requested this FAST STOP");
}
