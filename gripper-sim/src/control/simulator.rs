//! A gripper with its control interface, without a server: for a page that drives the time.

use super::answer::status;
use super::bench::{Bench, PAGE};
use super::faulty_line::Latency;
use super::json::object;
use super::log::Log;
use super::publisher::{Event, Publisher, hello};
use super::settings::{Changes, Given, Refused, Setting, SettingState, changed_settings};
use super::system_log::{Severity, SystemLog};
use super::{Action, Answer, Host, HttpError, check, lacking, words};
use crate::config::Config;
use crate::time::Time;
use std::sync::LazyLock;

/// The table of settings, as the command line of `wsg-sim` defines it. A test compares them.
static TABLE: LazyLock<Vec<Setting>> =
    LazyLock::new(|| include_str!("settings.tsv").lines().map(Setting::of).collect());

/// Interval between two samples of the history, in ms.
const SAMPLE_MS: u64 = 50;

/// A virtual gripper for one page.
///
/// ```
/// use wsg_sim::Time;
/// use wsg_sim::control::Simulator;
///
/// let mut simulator = Simulator::new(1, || "2026-01-01T00:00:00Z".to_owned());
/// simulator.open(Time::ZERO);
/// let (_, state) = simulator.request(Time::ZERO, "/state", None, None);
/// let as_of: serde_json::Value = serde_json::from_str(&state)?;
/// let home = Some(&br#"{"command":"home"}"#[..]);
/// assert_eq!(simulator.request(Time::ZERO, "/command", as_of["as_of"].as_str(), home).0, 200);
/// simulator.events(Time::from_millis(5_000));
/// assert!(simulator.request(Time::from_millis(5_000), "/state", None, None).1.contains("REFERENCED"));
/// # Ok::<(), serde_json::Error>(())
/// ```
#[derive(Debug)]
pub struct Simulator {
    bench: Bench,
    publisher: Publisher,
    /// The time of the page at the start of the gripper, and now.
    started: Time,
    now: Time,
    sampled: Time,
    /// The settings that are given, and that were given at the start.
    given: Given,
    at_start: Given,
    is_restarting: bool,
}

impl Simulator {
    /// Powers up a gripper. `run` is a number that no other start has; `date` returns date and time in UTC.
    #[must_use]
    pub fn new(run: u64, date: fn() -> String) -> Self {
        let system_log = SystemLog::new(date, None);
        let given = Given::default();
        Self {
            bench: bench(Config::default(), run, system_log),
            publisher: Publisher::default(),
            started: Time::ZERO,
            now: Time::ZERO,
            sampled: Time::ZERO,
            at_start: given.clone(),
            given,
            is_restarting: false,
        }
    }

    /// Opens the stream of events for a page.
    pub fn open(&mut self, now: Time) -> Event {
        self.advance(now);
        self.publisher = Publisher::default();
        self.publisher.begin(&mut self.bench);
        hello(&self.bench)
    }

    /// Returns the events until now: kind and JSON of each.
    pub fn events(&mut self, now: Time) -> Vec<Event> {
        self.advance(now);
        if std::mem::take(&mut self.is_restarting) {
            self.start(now);
            return vec![self.open(now)];
        }
        self.publisher.events(&mut self.bench, self.now)
    }

    /// Executes a request whose sender saw the state with this name. Only a POST has a body. Returns the status of HTTP, and
    /// the answer.
    pub fn request(
        &mut self,
        now: Time,
        path: &str,
        as_of: Option<&str>,
        body: Option<&[u8]>,
    ) -> (u16, String) {
        self.advance(now);
        let answer = self.execute(path, as_of, body);
        self.keep_tag();
        match answer {
            Ok(Answer::Json(text) | Answer::LogFile(text)) => (200, text),
            Err(HttpError { status, error, .. }) => (status, object! { "error": error }),
        }
    }

    fn execute(&mut self, path: &str, as_of: Option<&str>, body: Option<&[u8]>) -> Result<Answer, HttpError> {
        if path == "/scripts" {
            let error = "Lua scripts need the program wsg-sim: a page without a server has no interpreter";
            return Err(HttpError::new(status::NOT_IMPLEMENTED, error.to_owned()));
        }
        let action = Action::of(self.bench.config(), path, body)?;
        if let Some(effect) = action.effect() {
            check(&self.bench, self.now, effect, as_of.ok_or_else(lacking)?)?;
        }
        action.execute(self)
    }

    /// Advances the gripper from event to event, so that the result does not depend on the steps of the page.
    fn advance(&mut self, now: Time) {
        let now = Time::from_micros(now.as_micros().saturating_sub(self.started.as_micros())).max(self.now);
        loop {
            let sample = self.sampled.plus_millis(SAMPLE_MS);
            let next = self.bench.next_wake().map_or(sample, |wake| wake.min(sample)).max(self.now);
            if next > now {
                break;
            }
            self.now = next;
            if next == sample {
                self.sampled = sample;
                self.bench.record(next);
            } else {
                self.bench.look(next, |_| ());
            }
        }
        self.now = now;
        self.bench.look(now, |_| ());
    }

    /// Starts the gripper again, with the settings that are given.
    fn start(&mut self, now: Time) {
        let (run, system_log) = (self.bench.run() + 1, self.bench.system_log().clone());
        // The settings were valid when they were given.
        let config = configured(&self.given).unwrap_or_default();
        self.bench = bench(config, run, system_log);
        self.at_start = self.given.clone();
        (self.started, self.now, self.sampled) = (now, Time::ZERO, Time::ZERO);
    }

    /// Keeps a tag that a frame has set, so that it outlasts a restart.
    fn keep_tag(&mut self) {
        let tag = self.bench.gripper().tag().as_str();
        for given in [&mut self.given, &mut self.at_start] {
            given.set("tag", (!tag.is_empty()).then(|| vec![tag.to_owned()]));
        }
    }
}

fn bench(config: Config, run: u64, system_log: SystemLog) -> Bench {
    let bench = Bench::new(config, run, Latency::NONE, run, Some(Log::new(None)), system_log);
    bench.report_event(Time::ZERO, Severity::Info, "gripper", &format!("started as {}", config.model));
    bench
}

/// Returns the settings of a gripper.
fn configured(given: &Given) -> Result<Config, String> {
    let mut config = Config::default();
    for (name, words) in given.iter() {
        if words::set(&mut config, name, words).is_some() {
            continue;
        }
        let row = TABLE.iter().find(|row| row.name == *name);
        let expected = row.map_or("", |row| row.expected.as_str());
        return Err(if words::is_of_gripper(name) {
            let word = words.concat();
            format!("invalid value '{word}' for '--{name}': expected {expected}")
        } else {
            format!("{name} needs the program wsg-sim: a page without a server has no lines")
        });
    }
    words::check_limits(&config)?;
    Ok(config)
}

impl Host for Simulator {
    fn at_bench<T>(&mut self, act: impl FnOnce(&mut Bench, Time) -> T) -> T {
        act(&mut self.bench, self.now)
    }

    fn settings(&mut self) -> Option<Vec<SettingState>> {
        Some(SettingState::all(&TABLE, &self.given, &self.at_start))
    }

    fn settings_file(&mut self) -> Option<String> {
        None
    }

    fn change_settings(&mut self, changes: &Changes) -> Result<(), Refused> {
        let given = self.given.with(changes);
        let config = configured(&given).map_err(Refused::Invalid)?;
        if !self.bench.reconfigure(&config, self.now) {
            return Err(Refused::Moving);
        }
        changed_settings(changes, &self.given, &given, |text| {
            self.bench.report_event(self.now, Severity::Info, PAGE, text);
        });
        self.given = given;
        Ok(())
    }

    fn restart(&mut self) {
        self.bench.report_event(self.now, Severity::Warning, PAGE, "restart");
        self.is_restarting = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    fn simulator() -> Simulator {
        Simulator::new(7, String::new)
    }

    fn ask(simulator: &mut Simulator, ms: u64, path: &str, body: Option<&str>) -> (u16, Value) {
        let now = Time::from_millis(ms);
        let as_of = simulator.request(now, "/state", None, None).1;
        let as_of: Value = serde_json::from_str(&as_of).unwrap();
        let (status, answer) = simulator.request(now, path, as_of["as_of"].as_str(), body.map(str::as_bytes));
        (status, serde_json::from_str(&answer).unwrap())
    }

    #[test]
    fn result_does_not_depend_on_the_steps_of_the_page() {
        let run = |steps: &[u64]| {
            let mut simulator = simulator();
            let first = simulator.open(Time::ZERO);
            assert_eq!(first.0, "hello");
            assert_eq!(ask(&mut simulator, 100, "/command", Some(r#"{"command":"home"}"#)).0, 200);
            let body = Some(r#"{"command":"Get System State","payload":"1 100w","send":true}"#);
            assert_eq!(ask(&mut simulator, 100, "/frame", body).0, 400, "a payload that is no value");
            let body = Some(r#"{"command":"Get System State","payload":"1 100 0","send":true}"#);
            assert_eq!(ask(&mut simulator, 100, "/frame", body).0, 200);
            let mut now = 100;
            while now < 6_000 {
                now = steps.iter().map(|step| now + step).find(|next| *next <= 6_000).unwrap_or(6_000);
                simulator.events(Time::from_millis(now));
            }
            let frames = ask(&mut simulator, 6_000, "/frames", None).1;
            let width = ask(&mut simulator, 6_000, "/state", None).1["width_mm"].clone();
            (frames["frames"].as_array().unwrap().len(), frames, width, simulator.bench.history.samples())
        };
        let (count, frames, width, history) = run(&[16]);
        assert!(count > 2 && width == 110.0, "{count}, {width}");
        for steps in [&[7][..], &[5_900], &[1_000, 50]] {
            let other = run(steps);
            assert!((&other.2, &other.3) == (&width, &history), "{steps:?}");
            assert_eq!(other.1, frames, "{steps:?}");
        }
    }

    #[test]
    fn restart_takes_over_the_settings_and_refuses_the_earlier_state() {
        let mut simulator = simulator();
        let body = |text| Some(text);
        let (status, settings) =
            ask(&mut simulator, 1, "/settings", body(r#"{"model":"wsg70","speed":"50"}"#));
        assert_eq!((status, &settings["restart_pending"]), (200, &Value::Bool(true)));
        for (wrong, expected) in [
            (r#"{"speed":"x"}"#, "invalid value 'x' for '--speed': expected a number above 0"),
            (r#"{"tcp":"127.0.0.1:1000"}"#, "tcp needs the program wsg-sim"),
            (r#"{"force":"5000"}"#, "invalid value for --force with --model wsg70: "),
        ] {
            let (status, answer) = ask(&mut simulator, 2, "/settings", body(wrong));
            let error = answer["error"].as_str().unwrap_or_default();
            assert!(status == 400 && error.starts_with(expected), "{status} {error}");
        }
        let before = ask(&mut simulator, 3, "/restart", body("{}")).1;
        assert_eq!(before["model"], "wsg50-110");
        let events = simulator.events(Time::from_millis(50));
        assert!(events[0].0 == "hello" && events[0].1.contains("wsg70"), "{events:?}");
        let home = Some(&br#"{"command":"home"}"#[..]);
        let now = Time::from_millis(51);
        assert_eq!(simulator.request(now, "/command", before["as_of"].as_str(), home).0, 412);
        assert_eq!(simulator.request(now, "/command", None, home).0, 428);
        assert_eq!(simulator.request(now, "/scripts", None, None).0, 501);
        let settings = ask(&mut simulator, 52, "/settings", None).1;
        assert_eq!(settings["restart_pending"], false);
    }
}
