//! The status page: shows in a browser what `wsg gateway status` prints. It has no commands.

use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;

use tokio::net::TcpListener;
use tokio::task::yield_now;
use wsg_sim::server::serve_read_only;

use super::bridge::{Gateway, uptime};
use super::status::Reading;

const PAGE: &str = include_str!("page.html");

/// Values for programs: an array with the objects of `wsg gateway status --json`.
const JSON: &str = "/status.json";
/// Values for the page: the lines of `wsg gateway status`.
const TEXT: &str = "/status.txt";

/// Time for which values are served again, so that many requests cost a bridge no more than one.
const PERIOD: Duration = Duration::from_millis(100);

/// A gripper on the page.
pub(super) struct Shown {
    /// Its name, if it has one, and its address.
    pub(super) heading: String,
    /// Address on which masters connect; without Modbus/TCP, of the gripper.
    pub(super) address: String,
    pub(super) gateway: Rc<Gateway>,
    /// The latest values as JSON and text, and their time.
    pub(super) latest: RefCell<Option<(Duration, [String; 2])>>,
}

impl Shown {
    /// Returns values as JSON and text; `None` after a pause of the computer.
    fn values(&self) -> Option<[String; 2]> {
        let now = uptime();
        let mut latest = self.latest.borrow_mut();
        if latest.as_ref().is_none_or(|(read_at, _)| now.saturating_sub(*read_at) > PERIOD) {
            *latest = self.gateway.read().and_then(|read| {
                let reading = Reading::new(Ok(read));
                Some((now, [reading.json(&self.address).to_string(), reading.text(&self.heading).ok()?]))
            });
        }
        latest.as_ref().map(|(_, values)| values.clone())
    }
}

/// Serves the page.
pub(super) async fn serve(listener: TcpListener, grippers: Vec<Shown>) {
    for gripper in &grippers {
        // Width and force are measured from here on.
        gripper.gateway.read();
    }
    let read = async move |path: &str| {
        let mut all = Vec::new();
        for gripper in &grippers {
            let [json, text] = gripper.values()?;
            all.push(if path == JSON { json } else { text });
            // The masters wait for the values of one gripper at most.
            yield_now().await;
        }
        Some(if path == JSON { format!("[{}]\n", all.join(",")) } else { all.concat() })
    };
    let paths = &[(JSON, "application/json"), (TEXT, "text/plain; charset=utf-8")];
    match serve_read_only(listener, PAGE, paths, read).await {}
}
