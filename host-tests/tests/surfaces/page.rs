//! The page of the virtual gripper in Chromium: its buttons, fields and keys, and what it shows.

use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, Weak};
use std::thread;
use std::time::{Duration, Instant};

use browser::Tab;

use crate::station::BOUND;
use crate::surface::{Outcome, SPEED, Surface, Verb};

/// The width on the screen, unless it is marked as old: in words, and dimmed.
const WIDTH: &str = "(() => {
    const isOld = document.getElementById('state').textContent === 'no connection'
        && getComputedStyle(document.querySelector('main')).opacity < 0.5;
    return isOld ? null : document.querySelector('#drawing text').textContent;
})()";

/// Records the longest time between two timers of the tab, which shows when Chromium does not run.
const WATCH_STALLS: &str = "
    window.stall = 0;
    let last = performance.now();
    setInterval(() => {
        const now = performance.now();
        window.stall = Math.max(window.stall, now - last);
        last = now;
    }, 10); 0";

struct Page {
    tab: Arc<Mutex<Tab>>,
    /// The number of the latest request.
    number: usize,
}

pub(crate) fn page(address: SocketAddr) -> Box<dyn Surface> {
    let mut tab = Tab::open(&format!("http://{address}"));
    tab.until(WIDTH);
    tab.eval(WATCH_STALLS);
    Box::new(Page { tab: Arc::new(Mutex::new(tab)), number: 0 })
}

impl Surface for Page {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        let (sender, outcome) = channel();
        let mut tab = self.tab.lock().expect("no panic");
        self.number += 1;
        let number = self.number;
        tab.eval(&format!(
            "for (const line of document.querySelectorAll('#results li')) line.dataset.before ??= {number}; 0"
        ));
        let (name, fields): (_, &[_]) = match verb {
            Verb::Read => {
                // The command editor asks for the width, too. On a line that holds the answers, its request blocks.
                tab.click("#send");
                tab.show("operate");
                let shown = tab.eval(WIDTH);
                let _ = sender.send(shown.as_str().map(str::to_owned).ok_or("no connection".to_owned()));
                return outcome;
            }
            Verb::Home => ("home", &[]),
            Verb::Move(width) => ("move", &[("#width", width), ("#speed", SPEED)]),
            Verb::Grip(width, force) => ("grip", &[("#width", width), ("#speed", SPEED), ("#force", force)]),
            Verb::FastStop => ("fast stop", &[]),
            Verb::Acknowledge => ("acknowledge", &[]),
        };
        for (field, number) in fields {
            tab.fill(field, &number.to_string());
        }
        if name == "fast stop" {
            tab.press("Escape");
        } else {
            tab.click(&format!("#{name}"));
        }
        // A refused field has the focus and a bubble with this text.
        let refused = tab.eval("document.activeElement.validationMessage");
        if let Some(why) = refused.as_str().filter(|why| !why.is_empty()) {
            sender.send(Err(why.to_owned())).expect("its receiver is here");
            return outcome;
        }
        let tab = Arc::downgrade(&self.tab);
        // The test may have ended.
        thread::spawn(move || sender.send(result(&tab, name, number)).ok());
        outcome
    }

    fn stall(&mut self) -> Duration {
        let longest =
            self.tab.lock().expect("no panic").eval("(() => { const s = stall; stall = 0; return s; })()");
        Duration::from_secs_f64(longest.as_f64().expect("a number") / 1_000.0)
    }
}

/// Waits for the result that the page lists for this request, after those that it listed before.
fn result(tab: &Weak<Mutex<Tab>>, name: &str, number: usize) -> Outcome {
    let look = format!(
        "(() => {{ const line = [...document.querySelectorAll('#results li')]
             .find(line => !(line.dataset.before <= {number}) && line.textContent.startsWith('{name}'));
           return line && !line.textContent.endsWith('pending')
             && {{ text: line.textContent + ' ' + document.getElementById('message').textContent,
                   isBad: line.className === 'bad' || line.textContent.includes('connection') }}; }})()"
    );
    let start = Instant::now();
    while start.elapsed() < BOUND {
        let Some(tab) = tab.upgrade() else { break };
        let found = tab.lock().expect("no panic").eval(&look);
        if let Some(text) = found["text"].as_str() {
            return if found["isBad"] == true { Err(text.to_owned()) } else { Ok(text.to_owned()) };
        }
        thread::sleep(Duration::from_millis(20));
    }
    Err(format!("the page lists no result of {name}"))
}
