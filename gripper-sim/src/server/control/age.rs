//! The age of requests. A request may wait in a browser, a proxy, a network or a stopped process, and would then run when
//! its sender no longer expects it.
//!
//! `as_of` names the state that the sender saw, by the gripper's clock alone. A request that changes something is executed
//! only if that state is at most a second old. Stop and FAST STOP are executed at any age.

use super::answer::HttpError;
use crate::server::hub::Hub;
use crate::time::Time;
use hyper::header::{HeaderMap, ORIGIN};
use hyper::{StatusCode, Uri};
use std::cell::Cell;
use std::net::IpAddr;
use std::rc::Rc;
use tokio::time::{Duration, Instant, MissedTickBehavior, interval};

/// Maximum age of the state that the sender of a request saw.
const MAX_AGE: Duration = Duration::from_secs(1);
/// Interval at which this program checks that it runs.
const TURN: Duration = Duration::from_millis(100);
/// Time after a stall in which a request may have waited for its end.
const AFTER_STALL: Duration = Duration::from_millis(500);
/// Headers by which a proxy says that it forwards the request of another machine.
const FORWARDED: [&str; 4] = ["forwarded", "via", "x-forwarded-for", "x-real-ip"];

/// Returns the name of the state at this time: the start of the gripper and the time since, in µs.
pub(super) fn as_of(hub: &Hub, now: Time) -> String {
    format!("{:016x}.{}", hub.run(), now.as_micros())
}

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

/// What a request may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    /// It moves the fingers, or permits it again.
    Moves,
    /// It changes something else.
    Changes,
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
            return check(hub, effect, as_of);
        }
        if !self.is_local_program {
            let error = "the request lacks as_of, by which its age is known; expected as_of of a state that is at most \
                         1 s old, except with stop and fast_stop";
            return Err(HttpError::new(StatusCode::PRECONDITION_REQUIRED, error.to_owned()));
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

/// Rejects a request whose sender saw a state that is too old. A sender that has not seen the latest stop may not move the
/// fingers, or acknowledge the stop.
fn check(hub: &Hub, effect: Effect, as_of: &str) -> Result<(), HttpError> {
    let seen = as_of.split_once('.').and_then(|(run, micros)| {
        Some((u64::from_str_radix(run, 16).ok()?, Time::from_micros(micros.parse().ok()?)))
    });
    let now = hub.now();
    let Some((run, at)) = seen.filter(|(run, at)| *run != hub.run() || *at <= now) else {
        let error = format!("{as_of:?} names no state of this gripper; expected as_of of GET /state");
        return Err(HttpError::wrong(error));
    };
    let age = Duration::from_micros(now.as_micros().saturating_sub(at.as_micros()));
    let error = if run != hub.run() {
        "the sender saw the gripper before its last start; read the state again".to_owned()
    } else if age > MAX_AGE {
        format!("the sender saw a state {:.1} s old; expected at most 1 s", age.as_secs_f64())
    } else if effect == Effect::Moves && at < hub.stopped_at() {
        "the sender has not seen the latest stop; read the state again".to_owned()
    } else {
        return Ok(());
    };
    Err(HttpError::new(StatusCode::PRECONDITION_FAILED, error))
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
    use hyper::header::HeaderValue;
    use tokio::task::{LocalSet, yield_now};

    const LOCAL: Sender = Sender { is_local_program: true };
    const OTHER: Sender = Sender { is_local_program: false };

    fn status(checked: Result<(), HttpError>) -> Result<(), u16> {
        checked.map_err(|refused| refused.status.as_u16())
    }

    #[tokio::test(start_paused = true)]
    async fn state_that_the_sender_saw_is_at_most_a_second_old() {
        let (hub, stalls) = (Hub::of_test(), Stalls::new());
        let check = |as_of: &str| status(OTHER.check(&hub, &stalls, Effect::Moves, Some(as_of)));
        tokio::time::advance(Duration::from_secs(10)).await;
        let seen = as_of(&hub, hub.now());
        assert_eq!(check(&seen), Ok(()));
        tokio::time::advance(Duration::from_secs(1)).await;
        assert_eq!(check(&seen), Ok(()));
        tokio::time::advance(Duration::from_millis(1)).await;
        assert_eq!(check(&seen), Err(412));
    }

    /// The time of a gripper begins again with each start.
    #[tokio::test(start_paused = true)]
    async fn state_of_another_start_or_an_invalid_one_is_refused() {
        let (hub, stalls) = (Hub::of_test(), Stalls::new());
        tokio::time::advance(Duration::from_secs(10)).await;
        let check = |as_of: &str| status(OTHER.check(&hub, &stalls, Effect::Moves, Some(as_of)));
        let earlier = Hub::of_test();
        for at in [0, 9_999_999, 10_000_000, 10_000_001, u64::MAX] {
            assert_eq!(check(&as_of(&earlier, Time::from_micros(at))), Err(412), "{at}");
        }
        for never in [&as_of(&hub, hub.now().plus_micros(1)), "", ".", "1", "x.1", "-1.5", "1.-5", "1.1.1"] {
            assert_eq!(check(never), Err(400), "{never}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn state_from_before_a_stop_is_refused() {
        use wsg_protocol::Command;
        let (hub, stalls) = (Hub::of_test(), Stalls::new());
        for stop in [Command::Stop, Command::FastStop] {
            let before = as_of(&hub, hub.now());
            tokio::time::advance(Duration::from_millis(1)).await;
            hub.command(None, &stop);
            assert_eq!(status(OTHER.check(&hub, &stalls, Effect::Moves, Some(&before))), Err(412));
            assert_eq!(status(OTHER.check(&hub, &stalls, Effect::Changes, Some(&before))), Ok(()));
            let after = as_of(&hub, hub.now());
            assert_eq!(status(OTHER.check(&hub, &stalls, Effect::Moves, Some(&after))), Ok(()));
        }
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
            let seen = as_of(&hub, hub.now());
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
