//! Records of the crate `log`.

use super::*;
use std::format;
use std::string::String;
use std::sync::{Mutex, Once};

static RECORDS: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Recorder;

impl log::Log for Recorder {
    fn enabled(&self, _: &log::Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &log::Record<'_>) {
        assert_eq!(record.target(), "wsg_protocol");
        RECORDS.lock().unwrap().push(format!("{} {}", record.level(), record.args()));
    }

    fn flush(&self) {}
}

/// Begins recording.
pub(in crate::driver) fn begin() {
    static BEGUN: Once = Once::new();
    BEGUN.call_once(|| log::set_logger(&Recorder).unwrap());
    log::set_max_level(log::LevelFilter::Trace);
}

/// Returns the records of a gripper as levels and texts, without the name, which no other test has.
pub(in crate::driver) fn of(name: &str) -> Vec<String> {
    let records = RECORDS.lock().unwrap();
    let name = format!(" {name}: ");
    records.iter().filter(|record| record.contains(&name)).map(|record| record.replace(&name, " ")).collect()
}

#[test]
fn connection_and_fast_stop_are_recorded_once_each() {
    begin();
    let rig = Rig::new();
    let mut gripper = Blocking::new(rig.clone(), Watch(rig.clone()));
    gripper.set_log_name("recorded");
    gripper.connect().unwrap();
    gripper.stop_handle().unwrap().fast_stop().unwrap();
    assert_eq!(gripper.width(), Err(Error::Stopped(StopKind::FastStop)));
    gripper.acknowledge().unwrap();
    gripper.fast_stop().unwrap();
    rig.world(|world| world.closed = true);
    assert_eq!(gripper.width(), Err(Error::Closed));
    rig.world(|world| world.closed = false);
    gripper.connect().unwrap();
    assert!(gripper.width().is_ok());
    gripper.announce_disconnect().unwrap();
    rig.world(|world| world.closed = true);
    assert!(gripper.width().is_err());
    let (connected, fast_stop) = ("INFO connected", "WARN FAST STOP requested");
    let expected =
        [connected, fast_stop, fast_stop, "WARN connection lost", connected, "INFO disconnect announced"];
    assert_eq!(of("recorded"), expected);
}
