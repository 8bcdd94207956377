//! The age of requests. A request may wait in a browser, a proxy, a network or a stopped process, and would then run when
//! its sender no longer expects it.
//!
//! `as_of` names the state that the sender saw, by the gripper's clock alone. A request that changes something is executed
//! only if that state is at most a second old. Stop and FAST STOP are executed at any age.

use super::answer::{HttpError, status};
use super::bench::Bench;
use crate::time::Time;
use wsg_protocol::Number;
use wsg_protocol::editor::Quoted;

/// Maximum age of the state that the sender of a request saw, in ms.
pub(crate) const MAX_AGE_MS: u64 = 1_000;

/// Returns the name of the state at this time: the start of the gripper and the time since, in µs.
pub(crate) fn as_of(bench: &Bench, now: Time) -> String {
    format!("{:016x}.{}", bench.run(), now.as_micros())
}

/// What a request may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effect {
    /// It moves the fingers, or permits it again.
    Moves,
    /// It changes something else.
    Changes,
}

/// Rejects a request without the state that its sender saw.
pub(crate) fn lacking() -> HttpError {
    let error = "the request lacks as_of, by which its age is known; expected as_of of a state that is at most 1 s old, \
                 except with stop and fast_stop";
    HttpError::new(status::PRECONDITION_REQUIRED, error.to_owned())
}

/// Rejects a request whose sender saw a state that is too old. A sender that has not seen the latest stop may not move the
/// fingers, or acknowledge the stop.
pub(crate) fn check(bench: &Bench, now: Time, effect: Effect, as_of: &str) -> Result<(), HttpError> {
    let seen = as_of.split_once('.').and_then(|(run, micros)| {
        Some((u64::from_str_radix(run, 16).ok()?, Time::from_micros(micros.parse().ok()?)))
    });
    let Some((run, at)) = seen.filter(|(run, at)| *run != bench.run() || *at <= now) else {
        let error = format!("{} names no state of this gripper; expected as_of of GET /state", Quoted(as_of));
        return Err(HttpError::wrong(error));
    };
    let age = now.as_micros().saturating_sub(at.as_micros());
    let error = if run != bench.run() {
        "the sender saw the gripper before its last start; read the state again".to_owned()
    } else if age > MAX_AGE_MS * 1_000 {
        format!("the sender saw a state {:.1} s old; expected at most 1 s", Number(age as f32 / 1e6))
    } else if effect == Effect::Moves && at < bench.stopped_at() {
        "the sender has not seen the latest stop; read the state again".to_owned()
    } else {
        return Ok(());
    };
    Err(HttpError::new(status::PRECONDITION_FAILED, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::bench::tests::bench;

    fn status(bench: &Bench, now: Time, effect: Effect, as_of: &str) -> Result<(), u16> {
        check(bench, now, effect, as_of).map_err(|refused| refused.status)
    }

    #[test]
    fn state_that_the_sender_saw_is_at_most_a_second_old() {
        let bench = bench(1);
        let seen = as_of(&bench, Time::from_millis(10_000));
        for (micros, expected) in [(10_000_000, Ok(())), (11_000_000, Ok(())), (11_000_001, Err(412))] {
            assert_eq!(status(&bench, Time::from_micros(micros), Effect::Moves, &seen), expected, "{micros}");
        }
    }

    /// The time of a gripper begins again with each start.
    #[test]
    fn state_of_another_start_or_an_invalid_one_is_refused() {
        let (earlier, bench, now) = (bench(1), bench(2), Time::from_millis(10_000));
        for at in [0, 9_999_999, 10_000_000, 10_000_001, u64::MAX] {
            let seen = as_of(&earlier, Time::from_micros(at));
            assert_eq!(status(&bench, now, Effect::Moves, &seen), Err(412), "{at}");
        }
        for never in [&as_of(&bench, now.plus_micros(1)), "", ".", "1", "x.1", "-1.5", "1.-5", "1.1.1"] {
            assert_eq!(status(&bench, now, Effect::Moves, never), Err(400), "{never}");
        }
    }

    #[test]
    fn state_from_before_a_stop_is_refused() {
        use wsg_protocol::Command;
        let mut bench = bench(1);
        for (stop, ms) in [(Command::Stop, 10), (Command::FastStop, 20)] {
            let now = Time::from_millis(ms);
            let before = as_of(&bench, Time::from_millis(ms - 1));
            bench.command(None, &stop, now);
            assert_eq!(status(&bench, now, Effect::Moves, &before), Err(412));
            assert_eq!(status(&bench, now, Effect::Changes, &before), Ok(()));
            assert_eq!(status(&bench, now, Effect::Moves, &as_of(&bench, now)), Ok(()));
        }
    }
}
