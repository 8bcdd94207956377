//! The page without a server, from the files that `cargo xtask web` builds. It passes the tests of the page with a server that need
//! no sockets, files, scripts and second window, and it keeps its own promises about time.

use super::{Gripper, IN_BROWSER, STATE, flag_is_on, functions, home, look, tab_to};
use browser::{MAX_DRAWING_MS, Tab};
use serde_json::{Map, Value, json};
use std::path::Path;
use std::sync::LazyLock;

/// What prevents a test from running in Firefox. There, Tab leads from the last element to Firefox's own controls, and a click of
/// WebDriver does not return the focus without a desktop.
const DEVTOOLS: &str = "the DevTools protocol";
const FOCUS: &str = "a focus that stays on the page";

/// The tests of the page, and what prevents one from running without a server or in Firefox.
const TESTS: [(fn(), &str); 20] = [
    (super::drawing_follows_fingers_that_home_and_grip_by_clicks, ""),
    (super::hollow_part_is_drawn_around_fingers_that_grip_inside, ""),
    (super::invalid_number_or_speed_field_sends_nothing, "messages of the WebSocket"),
    (super::fast_stop_is_red_on_every_page_until_acknowledged, "two windows"),
    (super::keyboard_alone_reaches_and_operates_everything, FOCUS),
    (super::every_control_has_a_name_for_a_screen_reader, DEVTOOLS),
    (super::page_asks_its_own_server_alone_and_the_console_stays_empty, DEVTOOLS),
    (super::page_of_another_origin_can_neither_command_nor_watch, "sockets"),
    (super::plot_shows_width_speed_and_force_and_continues, ""),
    (super::fieldbus_monitor_shows_every_bit_of_both_images, "sockets"),
    (super::frames_are_filtered_and_paused, "sockets"),
    (super::page_reports_a_lost_gripper_and_continues_when_it_returns, "a program"),
    (super::excess_page_connects_when_another_is_closed, "sockets"),
    (functions::each_command_shows_its_result_and_a_refusal_moves_nothing, ""),
    (functions::inputs_show_what_the_gripper_has, ""),
    (functions::plot_has_a_history_a_cursor_and_a_pause, "two windows"),
    (functions::settings_are_changed_by_keys_and_refused_in_place, "a file"),
    (functions::editor_previews_sends_and_decodes, ""),
    (look::layout_fits_and_text_has_contrast_in_light_and_dark, ""),
    (look::pages_are_short_on_a_telephone, ""),
];

/// Returns the address of the files.
pub(super) fn address() -> String {
    static ADDRESS: LazyLock<String> = LazyLock::new(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("../web");
        assert!(folder.join("wsg.wasm").exists(), "{} is missing: run `cargo xtask web`", folder.display());
        browser::serve(&folder).unwrap()
    });
    ADDRESS.clone()
}

/// Opens the page, gives its gripper these settings, and restarts it.
pub(super) fn open(address: &str, options: &[String]) -> Tab {
    let mut tab = Tab::open(&format!("{address}/gripper.html"));
    tab.until("document.getElementById('values').childElementCount > 0");
    let pairs = options.chunks(2).map(|pair| (pair[0].trim_start_matches("--").to_owned(), json!(pair[1])));
    let settings = Value::Object(pairs.collect::<Map<_, _>>());
    let run = tab.eval(&format!(
        "(async () => {{
           const earlier = asOf.split('.')[0];
           for (const [path, body] of [['/settings', {settings}], ['/restart', {{}}]]) {{
             for (;;) {{
               const {{ status, body: answer }} = await send(path, body);
               if (status === 200) break;
               if (status !== 412 && status !== 0) throw new Error(answer.error);
               await new Promise(later => setTimeout(later, 50));
             }}
           }}
           return earlier;
         }})()"
    ));
    tab.until(&format!("isFresh() && asOf.split('.')[0] !== {run}"));
    tab
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_without_a_server_passes_the_tests_of_the_page() {
    run_without_server(&["", DEVTOOLS, FOCUS]);
}

#[test]
#[ignore = "needs Firefox: `cargo xtask test` installs it"]
fn page_without_a_server_passes_the_tests_of_the_page_in_firefox() {
    browser::use_firefox();
    run_without_server(&[""]);
    let gripper = Gripper::new(&[]);
    let mut tab = gripper.open();
    tab_to(&mut tab, "home");
    tab.press("Enter");
    tab.until(&flag_is_on("REFERENCED"));
    assert_eq!(tab.events_of("Log.entryAdded"), [Value::Null; 0]);
}

/// Runs the tests with one of these obstacles.
fn run_without_server(obstacles: &[&str]) {
    IN_BROWSER.set(true);
    for (test, _) in TESTS.iter().filter(|(_, obstacle)| obstacles.contains(obstacle)) {
        test();
    }
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn scripts_and_lines_say_that_they_need_the_program() {
    IN_BROWSER.set(true);
    let gripper = Gripper::new(&[]);
    let mut tab = gripper.open();
    tab.until("document.getElementById('script-message').textContent.startsWith('Lua scripts need the program wsg-sim')");
    tab.show("settings");
    tab.fill("#set-tcp", "127.0.0.1:1000");
    tab.click("#apply");
    tab.until(
        "document.getElementById('settings-message').textContent.startsWith('tcp needs the program wsg-sim')",
    );
    // The log can be saved, although there is no file.
    tab.eval("window.saved = null; URL.createObjectURL = blob => { blob.text().then(text => { saved = text; }); return '#logs'; }; 0");
    tab.click("a[href='log.txt']");
    tab.until("saved.includes('started as wsg50-110')");
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn hidden_page_stands_still_and_keeps_its_state() {
    IN_BROWSER.set(true);
    // The fingers home for minutes.
    let gripper = Gripper::new(&["--time-scale", "0.01"]);
    let mut tab = gripper.open();
    tab.click("#home");
    tab.until(&format!("{STATE} === 'POSITIONING'"));
    let hide = |hidden: bool| {
        format!(
            "(() => {{ Object.defineProperty(document, 'hidden', {{ value: {hidden}, configurable: true }});
               document.dispatchEvent(new Event('visibilitychange')); window.hiddenAt = performance.now(); return now; }})()"
        )
    };
    let before = tab.eval(&hide(true)).as_f64().unwrap();
    // It stands for several of its periods, and for longer than a late state may take.
    tab.until("performance.now() - hiddenAt > 4000");
    let hidden = tab.eval("now").as_f64().unwrap();
    assert!(hidden - before < 0.5, "{before} s, {hidden} s");
    tab.eval(&hide(false));
    tab.until(&format!("isFresh() && {STATE} === 'POSITIONING'"));
    let after = tab.eval("now - (performance.now() - hiddenAt) / 1000").as_f64().unwrap();
    assert!(after - before < 1.0, "{before} s, {after} s");
}

/// Largest share of a core of an idle page.
const MAX_IDLE: f64 = 0.03;

/// Measurements of an idle page. They count the windows of all tests, so the smallest is taken.
const MEASUREMENTS: usize = 20;

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_draws_60_frames_a_second_on_a_slow_telephone_and_idles() {
    IN_BROWSER.set(true);
    // The processor time of all windows in their share of a core.
    let share = |tab: &mut Tab| {
        let before = browser::cpu_time();
        tab.eval("new Promise(done => setTimeout(done, 2000))");
        (browser::cpu_time() - before) / 2.0
    };
    let mut empty = Tab::open("about:blank");
    let of_browser = (0..3).map(|_| share(&mut empty)).fold(f64::INFINITY, f64::min);
    drop(empty);
    let gripper = Gripper::alone(&[]);
    let mut tab = gripper.open();
    tab.look(390, 844, "light");
    home(&mut tab);
    let mut idle = f64::INFINITY;
    for _ in 0..MEASUREMENTS {
        idle = idle.min(share(&mut tab) - of_browser);
        if idle < MAX_IDLE {
            break;
        }
    }

    tab.count_drawings();
    for (field, value) in [("#width", "30"), ("#speed", "20")] {
        tab.fill(field, value);
    }
    tab.click("#move");
    tab.until(&format!("{STATE} === 'POSITIONING'"));
    let (first, before) = tab.drawings();
    tab.until(&format!("{STATE} === 'IDLE'"));
    let (last, after) = tab.drawings();
    let drawings = last - first;
    let drawing_ms = 1_000.0 * (after - before) / drawings;
    println!("{:.1} % of a core idle, {drawing_ms:.2} ms for each of {drawings} drawings", 100.0 * idle);
    assert!(idle < MAX_IDLE && drawings >= 20.0 && drawing_ms <= MAX_DRAWING_MS, "{idle}, {drawing_ms} ms");
}
