//! Tests of the causes of ERROR and of the last FAST STOP. causes.rs covers every single event.

use host_tests::addresses::report;
use host_tests::world::modbus::*;
use wsg_bridge_fw::io::Outputs;
use wsg_bridge_fw::registers::EventCode;
use wsg_protocol::CommandId;

/// Returns code, command and value of the events, latest first.
fn events(rig: &mut Master) -> Vec<[u16; 3]> {
    let first = report("EVENT1_CODE");
    let registers = rig.input(first, 64).unwrap();
    let all = registers.chunks_exact(4).map(|event| [event[0], event[1], event[2]]);
    all.take_while(|[code, ..]| *code != 0).collect()
}

fn cause(rig: &mut Master) -> u16 {
    rig.input(report("ERROR_CAUSE"), 1).unwrap()[0]
}

fn fast_stop(rig: &mut Master) -> [u16; 3] {
    rig.input(report("FAST_STOP_CAUSE"), 3).unwrap().try_into().unwrap()
}

#[test]
fn cause_of_error_is_the_fast_stop_while_it_is_active() {
    let mut rig = Master::homed(wsg_sim::Config::default());
    rig.write(0, &[u16::from(MOVE) << 8, 10_00, 20_00, 40_00]);
    rig.pass(300);
    assert_eq!(cause(&mut rig), 0);
    rig.write(1, &[11_00]);
    rig.pass(20);
    assert!(rig.outputs().contains(Outputs::ERROR));
    assert_eq!(cause(&mut rig), EventCode::ParameterChanged as u16);
    let pre_position = u16::from(CommandId::PrePosition.code());
    assert_eq!(fast_stop(&mut rig), [EventCode::ParameterChanged as u16, pre_position, 11_00]);
    rig.write(0, &[0]);
    rig.write(0, &[u16::from(GRIP) << 8]);
    rig.pass(10);
    assert_eq!(events(&mut rig)[0][0], EventCode::FastStopLasts as u16);
    assert_eq!(cause(&mut rig), EventCode::ParameterChanged as u16, "the cause to remove");
    rig.write(0, &[0]);
    rig.write(0, &[u16::from(STOP_ACK) << 8]);
    rig.pass(50);
    assert_eq!(cause(&mut rig), 0);
    assert_eq!(fast_stop(&mut rig)[0], EventCode::ParameterChanged as u16, "the last FAST STOP");
    rig.pass(900);
    rig.write(0, &[0]);
    rig.pass(900);
    let age = rig.input(report("FAST_STOP_AGE"), 1).unwrap()[0];
    assert!((1..=3).contains(&age), "{age} s");
}
