//! Checks that the hand-drawn picture of the states shows the names in the code.

use document::read;
use wsg_fieldbus::GripperFlags;

#[test]
fn state_picture_shows_every_state() {
    let picture = read("docs/states.svg");
    for state in GripperFlags::all().iter_names().map(|(name, _)| name).chain(["FAST STOP"]) {
        assert!(picture.contains(&format!(">{state}")), "docs/states.svg does not show {state}");
    }
}
