//! The age of requests by their senders: by the state that they name, or by the stalls of this program.

use crate::control::{Effect, HttpError, MAX_AGE_MS, check, lacking};
use crate::server::hub::Hub;
use hyper::header::{HeaderMap, ORIGIN};
use hyper::{StatusCode, Uri};
use std::cell::Cell;
use std::net::IpAddr;
use std::rc::Rc;
use tokio::time::{Duration, Instant, MissedTickBehavior, interval};

/// A shorter stall does not make a request too old.
const MAX_AGE: Duration = Duration::from_millis(MAX_AGE_MS);
/// Interval at which this program checks that it runs.
const TURN: Duration = Duration::from_millis(100);
/// Time after a stall in which a request may have waited for its end.
const AFTER_STALL: Duration = Duration::from_millis(500);
/// Headers by which a proxy says that it forwards the request of another machine.
const FORWARDED: [&str; 4] = ["forwarded", "via", "x-forwarded-for", "x-real-ip"];

/// Returns `as_of` of a query.
pub(super) fn as_of_in(uri: &Uri) -> Result<Option<&str>, HttpError> {
    uri.query()
        .map(|query| {
            query.strip_prefix("as_of=").ok_or_else(|| {
                HttpError::wrong(format!("the query {query:?} is unknown; expected as_of=, or no query"))
            })
        })
        .transpose()
}

/// The sender of a request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sender {
    /// Whether it is a program on this machine, whose requests arrive without delay while this program runs.
    is_local_program: bool,
}

impl Sender {
    pub(super) fn of(headers: &HeaderMap, peer: IpAddr, here: IpAddr) -> Self {
        let is_local = peer.is_loopback() || peer == here;
        // A page sends `Origin` with each request that changes something.
        let is_browser = headers.contains_key(ORIGIN);
        let is_forwarded = FORWARDED.iter().any(|name| headers.contains_key(*name));
        Self { is_local_program: is_local && !is_browser && !is_forwarded }
    }

    /// Rejects a request that is too old, or whose age is unknown.
    pub(super) fn check(
        self,
        hub: &Hub,
        stalls: &Stalls,
        effect: Effect,
        as_of: Option<&str>,
    ) -> Result<(), HttpError> {
        if let Some(as_of) = as_of {
            return hub.at_bench(|bench, now| check(bench, now, effect, as_of));
        }
        if !self.is_local_program {
            return Err(lacking());
        }
        stalls.recent().map_or(Ok(()), |stall| {
            let error = format!(
                "the server did not run for {:.1} s, so the age of the request is unknown; send it again",
                stall.as_secs_f64()
            );
            Err(HttpError::new(StatusCode::SERVICE_UNAVAILABLE, error))
        })
    }
}

/// Times in which this program did not run, for example because it was stopped or its machine was overloaded. Requests
/// that arrived meanwhile waited in the system.
#[derive(Debug)]
pub(super) struct Stalls {
    last_turn: Cell<Instant>,
    /// Duration and end of the latest stall.
    latest: Cell<Option<(Duration, Instant)>>,
}

impl Stalls {
    pub(super) fn new() -> Rc<Self> {
        Rc::new(Self { last_turn: Cell::new(Instant::now()), latest: Cell::new(None) })
    }

    /// Watches for stalls for as long as the gripper runs.
    pub(super) async fn watch(self: Rc<Self>) {
        let mut turns = interval(TURN);
        turns.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            turns.tick().await;
            let gap = self.last_turn.replace(Instant::now()).elapsed();
            if gap > MAX_AGE {
                self.latest.set(Some((gap, Instant::now())));
            }
        }
    }

    /// Returns the duration of a stall in which a request of now may have waited.
    fn recent(&self) -> Option<Duration> {
        // After a stall, a request may be handled before the watch.
        let gap = self.last_turn.get().elapsed();
        let latest = self.latest.get().filter(|(_, end)| end.elapsed() < AFTER_STALL).map(|(gap, _)| gap);
        latest.or(Some(gap).filter(|gap| *gap > MAX_AGE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::as_of;
    use hyper::header::HeaderValue;
    use tokio::task::{LocalSet, yield_now};

    const LOCAL: Sender = Sender { is_local_program: true };
    const OTHER: Sender = Sender { is_local_program: false };

    fn status(checked: Result<(), HttpError>) -> Result<(), u16> {
        checked.map_err(|refused| refused.status)
    }

    #[tokio::test(start_paused = true)]
    async fn local_programs_need_no_state_unless_the_server_stalled() {
        let (hub, stalls) = (Hub::of_test(), Stalls::new());
        let all = LocalSet::new();
        all.run_until(async {
            tokio::task::spawn_local(Rc::clone(&stalls).watch());
            for _ in 0..30 {
                yield_now().await;
                tokio::time::advance(TURN).await;
            }
            assert_eq!(status(LOCAL.check(&hub, &stalls, Effect::Moves, None)), Ok(()));
            assert_eq!(status(OTHER.check(&hub, &stalls, Effect::Moves, None)), Err(428));

            // Before the watch notices the stall, and after it.
            tokio::time::advance(Duration::from_secs(3)).await;
            assert_eq!(status(LOCAL.check(&hub, &stalls, Effect::Moves, None)), Err(503));
            let seen = hub.at_bench(|bench, now| as_of(bench, now));
            assert_eq!(status(LOCAL.check(&hub, &stalls, Effect::Moves, Some(&seen))), Ok(()));
            yield_now().await;
            assert_eq!(status(LOCAL.check(&hub, &stalls, Effect::Moves, None)), Err(503));
            for _ in 0..6 {
                tokio::time::advance(TURN).await;
                yield_now().await;
            }
            assert_eq!(status(LOCAL.check(&hub, &stalls, Effect::Moves, None)), Ok(()));
        })
        .await;
    }

    #[test]
    fn browsers_proxies_and_other_machines_are_no_local_programs() {
        let here = "192.168.1.7".parse().unwrap();
        let is_local = |peer: &str, header: Option<&'static str>| {
            let mut headers = HeaderMap::new();
            if let Some(name) = header {
                headers.insert(name, HeaderValue::from_static("x"));
            }
            Sender::of(&headers, peer.parse().unwrap(), here).is_local_program
        };
        for peer in ["127.0.0.1", "::1", "192.168.1.7"] {
            assert!(is_local(peer, None) && is_local(peer, Some("accept")), "{peer}");
            for header in ["origin", "forwarded", "via", "x-forwarded-for", "x-real-ip"] {
                assert!(!is_local(peer, Some(header)), "{peer} {header}");
            }
        }
        assert!(!is_local("192.168.1.8", None));
    }
}
