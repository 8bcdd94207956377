//! The model of the station: its sessions and links. `host-tests/tests/web_station.rs` holds it to the promises of the bridge.

mod sessions;

use serde_json::{Value, json};
use wsg_web::station::{Action, MAX_ACTIONS, MAX_TIME_US, Session, Station, call};

/// Asks the station of this thread.
fn ask(body: &Value) -> Value {
    serde_json::from_str(&call(&json!({ "station": body }).to_string())).unwrap()
}

/// Returns the names of the high outputs.
fn outputs(view: &Value) -> Vec<String> {
    let hello = ask(&json!({ "hello": true }));
    let names = hello["outputs"].as_array().unwrap();
    let levels = view["outputs"].as_u64().unwrap();
    let high = names.iter().enumerate().filter(|(bit, _)| levels & 1 << bit != 0);
    high.map(|(_, name)| name.as_str().unwrap().to_owned()).collect()
}

#[test]
fn part_is_gripped_lost_and_stopped_over_a_cut_line() {
    ask(&json!({ "link": "" }));
    let act = |actions: &[&str], ms: u32| {
        ask(&json!({ "actions": actions, "step_us": ms * 1_000, "first_frame": 0 }))
    };
    assert_eq!(outputs(&act(&[], 500)), ["ERROR", "LINK_OK"]);
    act(&["w20"], 100);
    assert_eq!(outputs(&act(&["w30"], 200)), ["LINK_OK"], "READY waits for STOP_ACK low");
    assert_eq!(outputs(&act(&["w20"], 100)), ["READY", "LINK_OK"]);
    act(&["w28"], 2_000);
    assert_eq!(outputs(&act(&["w20"], 2_000)), ["READY", "REFERENCED", "LINK_OK"]);
    act(&["w21"], 2_000);
    let held = act(&["w20"], 1_000);
    assert_eq!(outputs(&held), ["READY", "HOLDING", "REFERENCED", "LINK_OK"]);
    assert_eq!((&held["state"], &held["input"][0]), (&json!("HOLDING"), &json!(16)));
    assert_eq!(held["input"][3], 40_00);
    assert_eq!(outputs(&act(&["p0"], 500)), ["READY", "PART_FAULT", "REFERENCED", "LINK_OK"]);

    let lost = act(&["x1", "w0"], 1_500);
    assert_eq!(outputs(&lost), ["ERROR"]);
    assert_eq!((&lost["input"], &lost["exception"]), (&Value::Null, &json!(0x0B)), "no old values");
    let frames = lost["frames"].as_array().unwrap();
    let stop = frames.iter().find(|frame| frame["text"].as_str().unwrap().contains("FAST STOP")).unwrap();
    assert_eq!((&stop["is_lost"], &stop["to_gripper"]), (&json!(true), &json!(true)));
    let restored = act(&["x0"], 1_500);
    assert!(restored["flags"].as_array().unwrap().contains(&json!("FAST_STOP")), "{restored}");
    assert_eq!(restored["reports"][133 - 100], 10, "ERROR_CAUSE: FAST_STOP_WIRE");
}

#[test]
fn settings_take_effect_over_the_service_port_and_survive_a_restart_of_the_bridge() {
    ask(&json!({ "link": "" }));
    let written = ask(&json!({ "actions": ["s6d.c8"], "step_us": 500_000 }));
    assert_eq!((&written["settings"][9], &written["refused"]), (&json!(200), &Value::Null));
    let refused = ask(&json!({ "actions": ["s66.3"], "step_us": 500_000 }));
    assert_eq!((&refused["settings"][2], &refused["refused"]), (&json!(1), &json!([102, 3])));
    assert_eq!(ask(&json!({ "actions": ["r"], "step_us": 500_000 }))["settings"][9], 200);
}

#[test]
fn damaged_byte_is_one_damaged_frame_which_the_bridge_survives() {
    ask(&json!({ "link": "", "step_us": 500_000 }));
    let view = ask(&json!({ "actions": ["n1", "n0"], "step_us": 1_000_000, "first_frame": 0 }));
    let damaged = view["frames"].as_array().unwrap().iter().filter(|frame| frame["is_damaged"] == true);
    assert_eq!(damaged.count(), 2);
    assert_eq!(outputs(&view), ["ERROR", "LINK_OK"]);
}

/// The states at the end, and all frames, do not depend on the steps. A link reaches the same state.
#[test]
fn session_is_reproduced_by_its_link_and_by_other_steps() {
    for number in (0..sessions::COUNT).step_by(10) {
        let session = sessions::session(number);
        let link = session.link().unwrap();
        assert_eq!(Session::parse(&link).as_ref(), Some(&session), "{link}");
        let replayed = ask(&json!({ "link": link, "first_frame": 0, "share": true }));
        ask(&json!({ "link": "" }));
        let mut now_us = 0;
        for (at_us, action) in &session.actions {
            while now_us < *at_us {
                let step_us = (at_us - now_us).min(1 + now_us % 16_667);
                ask(&json!({ "step_us": step_us, "first_frame": u32::MAX }));
                now_us += step_us;
            }
            ask(&json!({ "actions": [action.to_string()], "first_frame": u32::MAX }));
        }
        let stepped = ask(&json!({ "step_us": session.end_us - now_us, "first_frame": 0, "share": true }));
        assert_eq!(stepped, replayed, "session {number}: {link}");
        assert_eq!(stepped["link"], link);
    }
}

#[test]
fn long_session_has_no_link_and_a_damaged_link_is_refused() {
    let mut station = Station::default();
    for _ in 0..MAX_ACTIONS {
        station.act(Action::Part(0));
    }
    assert!(station.session().link().is_some_and(|link| link.len() < 8_000));
    station.act(Action::Part(0));
    assert_eq!(station.session().link(), None);
    assert_eq!(Session { actions: vec![], end_us: MAX_TIME_US + 1 }.link(), None);
    let [too_long, too_many] = [format!("{:x}", MAX_TIME_US + 1), "0g~".repeat(MAX_ACTIONS + 1) + "0"];
    for link in [
        "?",
        "0w20",
        "0w20~",
        "w20~0",
        "0w123~0",
        "0q~0",
        "0s64.5~0",
        "0x2~0",
        "ffffffffffffffffg~1~0",
        &too_long,
        &too_many,
    ] {
        assert_eq!(Session::parse(link), None, "{link}");
        assert!(ask(&json!({ "link": link }))["error"].is_string(), "{link}");
    }
}
