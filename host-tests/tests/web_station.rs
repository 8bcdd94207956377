//! The station of the web page keeps the promises of the bridge, in the sessions that the page's own tests play.

use std::collections::BTreeSet;

use host_tests::station_promises::judge;
use wsg_bridge_fw::io::Outputs;
use wsg_protocol::CommandId;

#[path = "../../web/tests/sessions/mod.rs"]
mod sessions;

#[test]
fn bridge_keeps_its_promises_in_all_sessions_of_the_page() {
    let (mut outputs, mut sent) = (Outputs::empty(), BTreeSet::new());
    for number in 0..sessions::COUNT {
        let seen = judge(&sessions::session(number));
        outputs |= seen.outputs;
        sent.extend(seen.sent.iter().map(|id| id.code()));
    }
    assert_eq!(outputs, Outputs::all());
    for id in [
        CommandId::Homing,
        CommandId::PrePosition,
        CommandId::Stop,
        CommandId::FastStop,
        CommandId::Acknowledge,
        CommandId::GripPart,
        CommandId::ReleasePart,
        CommandId::SetForceLimit,
    ] {
        assert!(sent.contains(&id.code()), "{id:?} was never sent");
    }
}
