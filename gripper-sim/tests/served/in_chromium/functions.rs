//! Every function of the page by clicks and keys, on a screen and on a telephone: results, plot, settings, editor,
//! system log, fieldbus monitor.

use super::{Gripper, STATE, flag_is_on, grip, home};
use crate::rig::connect;
use browser::Tab;
use serde_json::json;
use std::io::{Read, Write};

/// A screen and a telephone.
const SIZES: [(u32, u32); 2] = [(1280, 800), (390, 844)];

/// Runs a test with a new gripper in each size.
fn in_each_size(options: &[&str], test: impl Fn(&Gripper, &mut Tab)) {
    for (width, height) in SIZES {
        let gripper = Gripper::new(options);
        let mut tab = gripper.open();
        tab.look(width, height, "light");
        test(&gripper, &mut tab);
    }
}

fn text(id: &str) -> String {
    format!("document.getElementById('{id}').textContent")
}

/// Returns an expression for whether the element is red and bold.
fn is_refused(id: &str) -> String {
    format!("document.getElementById('{id}').classList.contains('refused') && {} !== ''", text(id))
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn each_command_shows_its_result_and_a_refusal_moves_nothing() {
    in_each_size(&["--time-scale", "20"], |_, tab| {
        let place = "document.getElementById('results').getBoundingClientRect().top + scrollY";
        let before = tab.eval(place);
        tab.click("#grip");
        tab.until(&is_refused("message"));
        assert_eq!(tab.eval(place), before, "the refusal must not shift the layout");
        // The longest texts of the header, which the next state replaces.
        let longest =
            "now = 12345; isGone(); write($('state'), 'FAST STOP, POSITIONING'); seenDate = 0; isGone();";
        let moved = tab.eval(&format!("(() => {{ {longest} return {place}; }})()"));
        assert_eq!(moved, before, "a lost connection must not shift the layout");
        tab.until("!document.body.classList.contains('stale')");
        tab.until("document.querySelector('#results .bad').textContent.endsWith('refused')");
        home(tab);
        tab.until(&format!("{}.includes('home: IDLE at 110.0 mm')", text("results")));
        grip(tab);
        tab.until(&format!("{}.includes('HOLDING at 19.7 mm, 30.0 N')", text("results")));
        tab.click("#part_out");
        tab.until(&format!("{STATE} === 'PART LOST'"));
        tab.fill("#width", "50");
        tab.click("#release");
        tab.until(&format!("{STATE} === 'IDLE'"));
        tab.fill("#width", "20");
        tab.click("#grip");
        tab.until("document.querySelector('#results li:last-child.bad').textContent.includes('NO PART')");
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn inputs_show_what_the_gripper_has() {
    in_each_size(&["--part", "33:70", "--force", "25"], |_, tab| {
        let value = |id: &str| format!("document.getElementById('{id}').value");
        tab.until(&format!(
            "{} === '33' && {} === '70' && {} === '' && {} === '25'",
            value("part"),
            value("stiffness"),
            value("inner"),
            value("force")
        ));
        // On a busy machine, the page may have seen no state for a second, and the server refuses its request.
        let other = tab.eval(
            r#"(async () => {
                for (;;) {
                    const { status } = await send("/part", { width_mm: 44, inner_width_mm: 30 });
                    if (status !== 412) { return status === 200; }
                    await new Promise(later => setTimeout(later, 50));
                }
            })()"#,
        );
        assert_eq!(other, json!(true));
        tab.until(&format!("{} === '44' && {} === '30'", value("part"), value("inner")));
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn plot_has_a_history_a_cursor_and_a_pause() {
    in_each_size(&["--time-scale", "20"], |gripper, tab| {
        home(tab);
        grip(tab);
        // A page that opens later sees the motions before it.
        let mut late = gripper.open();
        let widths = "series.map(sample => sample[1])";
        late.until(&format!("Math.max(...{widths}) === 110 && {widths}.at(-1) < 20"));
        tab.show("operate");
        tab.eval("document.getElementById('plot').focus()");
        tab.press("ArrowLeft");
        tab.until(&format!("/−0.5 s · 19.7 mm · 0.0 mm.s · 30.0 N/.test({})", text("cursor")));
        tab.click_once("#hold");
        tab.until(&format!("{}.includes('pause')", text("plot")));
        let first = "document.querySelector('#plot polyline').getAttribute('points').split(' ')[0]";
        let before = tab.eval(first);
        tab.click("#part_out");
        tab.until(&format!("{STATE} === 'PART LOST' && series.at(-1)[3] === 0"));
        assert_eq!(tab.eval(first), before, "a paused plot stands");
        tab.click_once("#hold");
        tab.until(&format!("{first} !== '{}'", before.as_str().unwrap()));
        tab.click("#fast_stop");
        tab.until("document.querySelector('#plot .event.bad title').textContent === 'FAST STOP by command'");
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn settings_are_changed_by_keys_and_refused_in_place() {
    let file = std::env::temp_dir().join(format!("wsg-page-{}.toml", std::process::id()));
    for (width, height) in SIZES {
        std::fs::write(&file, "# A cell\n").unwrap();
        let gripper = Gripper::new(&["--config", file.to_str().unwrap(), "--time-scale", "0.05"]);
        let mut tab = gripper.open();
        tab.look(width, height, "light");
        tab.show("settings");
        tab.click("[data-group='Motion configuration'] summary");
        let mut other = gripper.open();
        other.until("document.getElementById('set-clamping-travel').value !== '7.5'");
        tab.fill("#set-clamping-travel", "7.5");
        tab.click("#set-homing-at-start");
        tab.click("#set-clamping-travel");
        tab.press("Enter");
        tab.until(&format!("{} === 'Homing at start, Clamping travel: changed.'", text("settings-message")));
        // In another window, too.
        for tab in [&mut tab, &mut other] {
            tab.until("document.getElementById('set-clamping-travel').value === '7.5'");
        }
        tab.until("document.getElementById('set-homing-at-start-about').textContent.includes('Waits for a restart')");
        let saved = std::fs::read_to_string(&file).unwrap();
        assert_eq!(saved, "# A cell\nclamping-travel = \"7.5\"\nhoming-at-start = true\n");

        tab.fill("#set-clamping-travel", "-1");
        tab.click("#apply");
        tab.until(&is_refused("settings-message"));
        tab.until(&format!("{}.includes('a number from 0 to 1000')", text("settings-message")));
        tab.click("#undo");
        tab.until("document.getElementById('set-clamping-travel').value === '7.5'");

        tab.click("#home");
        tab.until(&flag_is_on("MOVING"));
        tab.fill("#set-clamping-travel", "9");
        tab.click("#apply");
        tab.until(&format!("{}.includes('the fingers move')", text("settings-message")));
        tab.click("#restart");
        // After the restart the gripper homes by itself, and the page has reconnected.
        tab.until(
            "document.getElementById('set-homing-at-start-about').textContent.includes('Waits') === false",
        );
        tab.until(&flag_is_on("MOVING"));
    }
    std::fs::remove_file(&file).unwrap();
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn editor_previews_sends_and_decodes() {
    in_each_size(&["--time-scale", "20"], |_, tab| {
        tab.fill("#frame-command", "0x06");
        tab.fill("#frame-payload", "1 0x20 150.0f \"ab\"");
        tab.until(&format!("{}.startsWith('AA AA AA 06 08 00 01 20 00 00 16 43 61 62 ')", text("packet")));
        tab.fill("#frame-payload", "256");
        tab.until(&format!(
            "{} && {}.includes('\"256\" is no byte')",
            is_refused("frame-message"),
            text("frame-message")
        ));
        assert_eq!(tab.eval(&text("packet")), "");
        tab.fill("#frame-command", "get system limits");
        tab.fill("#frame-payload", "");
        tab.press("Enter");
        tab.until("document.querySelector('#frames li:last-child .what').textContent.startsWith('<- 53h Get System Limits E_SUCCESS stroke 110.0 mm')");
        // The preview of the last key, 150 ms after it, does not replace the answer.
        let message = text("frame-message");
        tab.until(&format!("{message}.endsWith(': sent')"));
        let later = format!("new Promise(done => setTimeout(() => done({message}), 400))");
        assert_eq!(tab.eval(&later), "53h Get System Limits: sent");
        tab.click("#frames li:last-child button");
        // The stroke is the first float after the status.
        tab.fill("#from", "8");
        tab.fill("#to", "11");
        tab.until(&format!(
            "{}.includes('float110') && {}.includes('integer1121714176')",
            text("read-as"),
            text("read-as")
        ));
        tab.fill("#from", "0");
        tab.fill("#to", "0");
        tab.until(&format!("{}.includes('integer170, signed -86')", text("read-as")));
        // A motion is answered twice.
        tab.fill("#frame-command", "Homing");
        tab.fill("#frame-payload", "1");
        tab.click("#send");
        for status in ["E_CMD_PENDING", "E_SUCCESS"] {
            tab.until(&format!("{}.includes('<- 20h Homing {status}')", text("frames")));
        }
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn system_log_shows_a_lost_connection_and_filters_by_severity() {
    in_each_size(&[], |gripper, tab| {
        let client = gripper.acknowledge();
        let name = format!("tcp {}", client.local_addr().unwrap());
        drop(client);
        tab.show("logs");
        let row = "[...document.querySelectorAll('#system_log .error')].map(row => row.textContent)";
        tab.until(&format!(
            "{row}.some(text => text.endsWith('error {name}: FAST STOP by a lost connection'))"
        ));
        tab.eval("document.getElementById('severity').focus()");
        tab.eval(
            "(() => { const list = document.getElementById('severity'); list.value = 'error'; list.dispatchEvent(new Event('change')); })()",
        );
        assert_eq!(tab.eval("document.querySelectorAll('#system_log li:not(.error)').length"), 0);
        tab.eval(
            "(() => { const list = document.getElementById('severity'); list.value = 'info'; list.dispatchEvent(new Event('change')); })()",
        );
        tab.until(&format!("{}.includes('started as wsg50-110')", text("system_log")));
        // A page that opens later has the whole log.
        let mut late = gripper.open();
        late.until(&format!("{}.includes('started as wsg50-110')", text("system_log")));
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn fieldbus_monitor_shows_the_master_and_marks_the_last_change() {
    in_each_size(&["--time-scale", "20", "--bus-timeout", "60000"], |gripper, tab| {
        tab.show("fieldbus");
        tab.until(&format!("{}.includes('waiting for a master')", text("exchange")));
        tab.until(&format!("{}.includes('Modbus/TCP{}')", text("buses"), gripper.modbus));
        let mut master = connect(&gripper.modbus);
        // Write Single Register (FC 6): WIDTH, 22 mm.
        master.write_all(&[0, 1, 0, 0, 0, 6, 1, 6, 0, 1, 0x08, 0x98]).unwrap();
        master.read_exact(&mut [0; 12]).expect("an answer in time");
        let name = master.local_addr().unwrap();
        tab.until(&format!(
            "{}.includes('data exchange') && {}.includes('modbus {name}')",
            text("exchange"),
            text("exchange")
        ));
        tab.until(&format!("{}.includes('60000 ms for Modbus')", text("exchange")));
        let marked = "[...document.querySelectorAll('#output_registers .changed td:first-child')].map(cell => cell.textContent).join()";
        tab.until(&format!("{marked} === 'WIDTH (2..3)'"));
        drop(master);
        tab.until(&format!("{}.includes('the master has left')", text("exchange")));
        // Both device files can be downloaded.
        let files = "Promise.all([...document.querySelectorAll('main[data-page=fieldbus] a[download]')]
            .map(link => fetch(link.href).then(answer => answer.text()))).then(texts => texts.map(text => text.slice(0, 20)))";
        let files = tab.eval(files);
        assert!(
            files[0].as_str().unwrap().contains("#Profibus_DP")
                && files[1].as_str().unwrap().starts_with("<?xml"),
            "{files}"
        );
    });
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn page_edits_and_runs_scripts_and_selects_the_error_line() {
    let folder = std::env::temp_dir().join(format!("wsg-page-scripts-{}", std::process::id()));
    for (width, height) in SIZES {
        std::fs::create_dir_all(&folder).unwrap();
        let config = folder.join("wsg.toml");
        std::fs::write(&config, "").unwrap();
        let options = ["--config", config.to_str().unwrap(), "--scripts", folder.to_str().unwrap()];
        let gripper = Gripper::new(&options);
        let mut tab = gripper.open();
        tab.look(width, height, "light");
        tab.fill("#script-name", "demo.lua");
        tab.fill("#script-source", "print('running')\nwhile true do sleep(1) end\n");
        tab.click("#script-save");
        tab.until(&format!("{} === 'demo.lua is saved.'", text("script-message")));
        assert!(folder.join("demo.lua").exists());
        tab.click("#script-run");
        tab.until(&format!("{} === 'demo.lua: running'", text("script-state")));
        tab.until(&format!("{} === 'running'", text("script-output")));
        tab.until(&flag_is_on("SCRIPT_RUNNING"));
        tab.click("#script-stop");
        tab.until(&format!("{} === 'demo.lua: stopped'", text("script-state")));
        tab.click("#script-start");
        tab.until("document.querySelector('#script-list option').textContent.endsWith('runs at the start')");
        assert!(std::fs::read_to_string(&config).unwrap().starts_with("script = "));

        tab.fill("#script-source", "local x = 1\nx()\n");
        tab.click("#script-save");
        tab.until(&format!("{} === 'demo.lua is saved.'", text("script-message")));
        tab.click("#script-run");
        tab.until(&format!(
            "{} && {}.includes('failed, demo.lua:2: ')",
            is_refused("script-state"),
            text("script-state")
        ));
        let source = "document.getElementById('script-source')";
        tab.until(&format!("{source}.value.slice({source}.selectionStart, {source}.selectionEnd) === 'x()'"));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn forces_of_a_wsg_70_are_tenths_of_a_newton_in_the_registers() {
    in_each_size(&["--model", "wsg70"], |gripper, tab| {
        let mut master = connect(&gripper.modbus);
        // Write Single Register (FC 6): FORCELIMIT, 1500.
        master.write_all(&[0, 1, 0, 0, 0, 6, 1, 6, 0, 3, 0x05, 0xDC]).unwrap();
        master.read_exact(&mut [0; 12]).expect("an answer in time");
        tab.show("fieldbus");
        tab.until(&format!("{}.includes('150.00 N05 DC')", text("output_registers")));
    });
}
