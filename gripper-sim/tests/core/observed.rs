//! What observers see beside the lines: events for the system log, the data exchange of the register interface, and
//! settings that change.

use crate::common::{Rig, go_to};
use wsg_protocol::{Command, SoftLimits, Status, SystemFlags};
use wsg_sim::{
    Cause, Config, ExchangeState, Fault, JournalEvent, PortKind, SilenceReaction, Time, VirtualGripper,
};

/// Write Single Register (FC 6): WIDTH, 22 mm.
const WRITE: [u8; 12] = [0, 1, 0, 0, 0, 6, 1, 6, 0, 1, 0x08, 0x98];

fn events(gripper: &mut VirtualGripper) -> Vec<JournalEvent> {
    std::iter::from_fn(|| gripper.take_journal_event()).collect()
}

#[test]
fn fast_stop_has_the_cause_of_its_change() {
    let mut rig = Rig::homed(None);
    assert_eq!(rig.status(Command::FastStop), Status::Success);
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    let limits = SoftLimits { minus: 10.0, plus: 90.0 };
    assert_eq!(rig.status(Command::SetSoftLimits { limits }), Status::Success);
    assert_eq!(rig.run(go_to(80.0)), Status::Success);
    let _ = events(&mut rig.gripper);
    // A relative motion beyond the limit by an operator.
    rig.gripper.command(&Command::FastStop, rig.now);
    rig.gripper.command(&Command::ACKNOWLEDGE, rig.now);
    rig.set_fault(Fault::MotorCurrent, true);
    let port = rig.port;
    let found = events(&mut rig.gripper);
    let seen: Vec<_> = found.iter().map(|event| (event.flag, event.is_set, event.cause)).collect();
    assert_eq!(
        seen[..2],
        [(SystemFlags::FAST_STOP, true, Cause::Operator), (SystemFlags::FAST_STOP, false, Cause::Operator),]
    );
    assert!(seen[2..].contains(&(SystemFlags::FAST_STOP, true, Cause::Fault)), "{seen:?}");
    assert!(seen[2..].contains(&(SystemFlags::CURR_FAULT, true, Cause::Fault)), "{seen:?}");
    rig.set_fault(Fault::MotorCurrent, false);
    let _ = events(&mut rig.gripper);
    assert_eq!(rig.status(Command::ACKNOWLEDGE), Status::Success);
    assert_eq!(events(&mut rig.gripper)[0].cause, Cause::Client(port));
}

#[test]
fn journal_keeps_the_latest_events() {
    let mut rig = Rig::new(Config::default());
    for millis in 0..100 {
        rig.now = Time::from_millis(millis);
        let enabled = millis % 2 == 0;
        assert_eq!(rig.status(Command::OverdriveMode { enabled }), Status::Success);
    }
    let found = events(&mut rig.gripper);
    assert_eq!((found.len(), found[31].at), (32, Time::from_millis(99)));
    assert!(found.iter().all(|event| event.flag == SystemFlags::OVERDRIVE_MODE));
}

#[test]
fn data_exchange_is_waiting_then_running_then_expired_or_left() {
    let config = Config { bus_timeout_ms: 500, bus_reaction: SilenceReaction::Hold, ..Config::default() };
    let mut gripper = VirtualGripper::new(config);
    let port = gripper.connect(PortKind::ModbusTcp).unwrap();
    assert_eq!(gripper.exchange().state, ExchangeState::Waiting);
    gripper.receive(port, Time::ZERO, &WRITE);
    let exchange = gripper.exchange();
    assert_eq!(
        (exchange.state, exchange.master, exchange.outputs),
        (ExchangeState::DataExchange, Some(port), 1)
    );
    gripper.advance(Time::from_millis(600));
    let exchange = gripper.exchange();
    assert_eq!(
        (exchange.state, exchange.master, exchange.timeouts),
        (ExchangeState::WatchdogExpired, None, 1)
    );
    gripper.receive(port, Time::from_millis(700), &WRITE);
    assert_eq!(gripper.exchange().state, ExchangeState::DataExchange);
    gripper.disconnect(port, Time::from_millis(710));
    let exchange = gripper.exchange();
    assert_eq!((exchange.state, exchange.outputs, exchange.timeouts), (ExchangeState::Left, 2, 1));
}

#[test]
fn power_up_settings_stay_and_motion_settings_wait() {
    let mut rig = Rig::homed(None);
    let config = Config {
        acceleration: Some(700.0),
        soft_limits: Some(SoftLimits { minus: 10.0, plus: 90.0 }),
        profibus_address: 9,
        clamping_travel: 2.0,
        ..Config::default()
    };
    assert_eq!(rig.status(go_to(50.0)), Status::CmdPending);
    assert_eq!(rig.gripper.reconfigure(&config, rig.now), Status::AlreadyRunning);
    assert_eq!(rig.gripper.config(), &Config::default());
    assert_eq!(rig.next().status(), Status::Success);
    assert_eq!(rig.gripper.reconfigure(&config, rig.now), Status::Success);
    assert_eq!(rig.gripper.config(), &Config { clamping_travel: 2.0, ..Config::default() });
    assert_eq!(rig.status(Command::GetSoftLimits), Status::NotAvailable);
    assert!(rig.flags().contains(SystemFlags::REFERENCED));
}
