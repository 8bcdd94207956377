//! The gripper of a page, with the control interface of `wsg-sim`.

use std::cell::RefCell;
use std::fmt::Write;
use wsg_sim::Time;
use wsg_sim::control::Simulator;
use wsg_sim::control::json::{self, body, object};

thread_local! {
    static GRIPPER: RefCell<Option<Simulator>> = const { RefCell::new(None) };
    /// Date and time of the latest call.
    static DATE: RefCell<String> = const { RefCell::new(String::new()) };
}

/// A call of the worker of the page.
#[derive(Debug)]
struct Call {
    /// A random number, for the first call.
    run: u64,
    /// Date and time in UTC.
    date: String,
    /// The time of the page in µs.
    now: u64,
    /// A request, with the state that its sender saw, and a body for a POST.
    path: Option<String>,
    as_of: Option<String>,
    body: Option<String>,
    /// Whether the stream of events begins.
    opens: bool,
    /// Whether the events until now are wanted.
    streams: bool,
}
body!(Call: run, date, now, path, as_of, body, #[default] opens, #[default] streams);

/// Answers a call: a request with its status in a line before the answer, and otherwise with an array of events, each its kind and
/// its data.
pub(crate) fn call(call: &[u8]) -> Vec<u8> {
    let mut call: Call = match json::read(call) {
        Ok(call) => call,
        Err(error) => {
            let error = object! { "error": format!("the call is invalid: {error}") };
            return format!("400\n{error}").into_bytes();
        }
    };
    DATE.set(std::mem::take(&mut call.date));
    GRIPPER.with_borrow_mut(|gripper| {
        let gripper =
            gripper.get_or_insert_with(|| Simulator::new(call.run, || DATE.with_borrow(Clone::clone)));
        let now = Time::from_micros(call.now);
        if let Some(path) = call.path {
            let body = call.body.as_deref().map(str::as_bytes);
            let (status, answer) = gripper.request(now, &path, call.as_of.as_deref(), body);
            return format!("{status}\n{answer}").into_bytes();
        }
        let events = match call {
            Call { opens: true, .. } => vec![gripper.open(now)],
            Call { streams: true, .. } => gripper.events(now),
            _ => vec![],
        };
        let mut text = String::from("[");
        for (number, (kind, json)) in events.iter().enumerate() {
            let comma = if number > 0 { "," } else { "" };
            // Writing to a string cannot fail.
            let _ = write!(text, "{comma}[\"{kind}\",{json}]");
        }
        (text + "]").into_bytes()
    })
}
