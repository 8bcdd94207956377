//! Checks the LED patterns in docs/commissioning.md.

use document::{hold, table};
use wsg_bridge_fw::indicator::INDICATIONS;

#[test]
fn patterns_in_the_document_are_those_of_the_code() {
    let rows = INDICATIONS.map(|text| [text.seen, text.meaning, text.remedy].map(str::to_owned));
    hold("docs/commissioning.md", "leds", &table(["status LED", "meaning", "remedy"], rows));
}
