//! The look of the page: layout, contrast, and the pictures of the document.

use super::{Gripper, PAGES, STATE, flag_is_on, grip, home};
use crate::rig::connect;
use browser::{PROBLEMS, Tab};
use serde_json::json;
use std::io::{Read, Write};
use std::path::Path;

/// Window sizes and colour schemes that the page supports.
const LOOKS: [(u32, u32, &str); 4] =
    [(1280, 800, "light"), (1280, 800, "dark"), (390, 844, "light"), (390, 844, "dark")];

/// Changes the window and waits until the plot has been redrawn in the new size.
fn look(tab: &mut Tab, (width, height, scheme): (u32, u32, &str)) {
    tab.show("operate");
    tab.look(width, height, scheme);
    tab.until(
        "(() => { const plot = document.getElementById('plot'), axes = plot.querySelector('.axis').getBBox(); scrollTo(0, 0);
           return Math.abs(axes.x + axes.width - plot.clientWidth) < 5; })()",
    );
}

/// Returns these sizes and more, down to the smallest phones.
fn sizes() -> impl Iterator<Item = (u32, u32, &'static str)> {
    LOOKS.into_iter().chain([320, 360, 810, 1920].map(|width| (width, 800, "light")))
}

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn layout_fits_and_text_has_contrast_in_light_and_dark() {
    let gripper = Gripper::new(&["--time-scale", "20"]);
    let mut tab = gripper.open();
    home(&mut tab);
    grip(&mut tab);
    let _client = gripper.connect_client(&mut tab);
    for size in sizes() {
        check(&mut tab, size, "");
    }
    tab.click("#fast_stop");
    tab.until(&flag_is_on("FAST_STOP"));
    tab.click("#home");
    tab.until("document.getElementById('message').textContent !== ''");
    for size in sizes() {
        check(&mut tab, size, "after a FAST STOP");
    }
}

/// Checks every page in this size: its layout, and that FAST STOP is in view.
fn check(tab: &mut Tab, size: (u32, u32, &str), when: &str) {
    look(tab, size);
    for page in PAGES {
        tab.show(page);
        tab.eval("scrollTo(0, 0)");
        assert_eq!(tab.eval(PROBLEMS), json!([]), "{page} {size:?} {when}");
        tab.eval("scrollTo(0, document.body.scrollHeight)");
        let in_view = "(() => { const { top, bottom, left, right } = document.getElementById('fast_stop').getBoundingClientRect();
            return top >= 0 && left >= 0 && bottom <= innerHeight && right <= innerWidth; })()";
        assert_eq!(tab.eval(in_view), true, "{page} {size:?}: FAST STOP must stay in view");
    }
}

/// A page on a telephone has at most this height in pixels, with all groups of settings but the first closed.
const MOST_HEIGHT: u64 = 2_400;

#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
pub(super) fn pages_are_short_on_a_telephone() {
    let gripper = Gripper::new(&[]);
    let mut tab = gripper.open();
    tab.look(390, 844, "light");
    for page in PAGES.into_iter().filter(|page| *page != "settings") {
        tab.show(page);
        let height = tab.eval("document.documentElement.scrollHeight").as_u64().unwrap();
        println!("{page}: {height} px");
        assert!(height <= MOST_HEIGHT, "{page}: {height} px");
    }
}

/// Compares the pictures of `docs/simulator.md`; `WSG_UPDATE_DOCS=1` takes them again. Their content depends on the
/// fonts of the machine, so only the sizes are compared.
#[test]
#[ignore = "needs Chromium: `cargo xtask test` installs it"]
fn documents_have_pictures_of_the_page() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    let text = std::fs::read_to_string(docs.join("simulator.md")).unwrap();
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let gripper = Gripper::new(&["--finger1", "fmf", "--scripts", examples.to_str().unwrap()]);
    let mut tab = gripper.open();
    let _client = gripper.acknowledge();
    if std::env::var_os("WSG_UPDATE_DOCS").is_some() {
        home(&mut tab);
        grip(&mut tab);
        for _ in 0..5 {
            tab.fill("#width", "80");
            tab.click("#release");
            tab.until(&format!("{STATE} === 'IDLE'"));
            grip(&mut tab);
        }
        tab.call("Emulation.setScrollbarsHidden", &json!({"hidden": true}));
        for size in LOOKS {
            look(&mut tab, size);
            tab.eval("document.activeElement.blur(); scrollTo(0, 0)");
            tab.call("Input.dispatchMouseEvent", &json!({"type": "mouseMoved", "x": 0, "y": 0}));
            std::fs::write(docs.join(picture(size)), tab.picture()).unwrap();
        }
        show_something(&gripper, &mut tab);
        look(&mut tab, LOOKS[0]);
        tab.eval("document.getElementById('script-folder').textContent = 'gripper-sim/examples'");
        for page in PICTURED {
            tab.show(page);
            tab.eval("document.activeElement.blur(); scrollTo(0, 0)");
            std::fs::write(docs.join(format!("page-{page}.png")), tab.picture()).unwrap();
        }
    }
    for page in PICTURED {
        let name = format!("page-{page}.png");
        assert!(text.contains(&name) && docs.join(&name).exists(), "docs/simulator.md must show {name}");
    }
    for (width, height, scheme) in LOOKS {
        let name = picture((width, height, scheme));
        assert!(text.contains(&name), "docs/simulator.md must show {name}");
        let png = std::fs::read(docs.join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let size = [16, 20].map(|at| u32::from_be_bytes(png[at..at + 4].try_into().unwrap()));
        assert_eq!(size, [width, height], "{name}");
    }
}

/// The pages beside the first that the document shows.
const PICTURED: [&str; 5] = ["settings", "fieldbus", "editor", "scripts", "logs"];

/// Fills these pages: a master that writes, a packet of the editor, and a lost connection.
fn show_something(gripper: &Gripper, tab: &mut Tab) {
    let mut master = connect(&gripper.modbus);
    for frame in [[0, 1, 0, 0, 0, 6, 1, 6, 0, 1, 0x08, 0x98], [0, 2, 0, 0, 0, 6, 1, 6, 0, 2, 0x13, 0x88]] {
        master.write_all(&frame).unwrap();
        master.read_exact(&mut [0; 12]).expect("an answer in time");
    }
    drop(gripper.acknowledge());
    tab.until(&flag_is_on("FAST_STOP"));
    tab.click("#acknowledge");
    tab.until(&format!("{STATE} === 'IDLE'"));
    tab.fill("#frame-command", "Get System Limits");
    tab.fill("#frame-payload", "");
    tab.press("Enter");
    tab.click("#frames li:last-child button");
    tab.fill("#to", "11");
    tab.show("scripts");
    tab.until("document.getElementById('script-list').childElementCount > 0");
    tab.eval(
        "(() => { const list = document.getElementById('script-list'); list.value = 'remote.lua'; list.dispatchEvent(new Event('change')); })()",
    );
    tab.until("document.getElementById('script-source').value !== ''");
    tab.click("#script-run");
    tab.until("document.getElementById('script-state').textContent === 'remote.lua: running'");
    // The master stays until the end of the program.
    std::mem::forget(master);
}

fn picture((width, height, scheme): (u32, u32, &str)) -> String {
    format!("page-{width}x{height}-{scheme}.png")
}
