//! Settings that change while the gripper runs, and its restart.

use super::{Hub, lock};
use crate::config::Tag;
pub(in crate::server) use crate::control::{Changes, Refused};
use crate::control::{PAGE, SettingState, Severity, changed_settings};
use crate::server::options::{Options, save, settings, toml_value};

/// The options with which the gripper runs.
#[derive(Clone, Debug)]
pub(in crate::server) struct Running {
    /// The options including all changes.
    pub(in crate::server) options: Options,
    /// The options at power-up, to which settings that need a restart refer.
    pub(in crate::server) at_start: Options,
}

impl Running {
    pub(super) fn new(options: &Options) -> Self {
        Self { options: options.clone(), at_start: options.clone() }
    }
}

impl Hub {
    /// Returns every setting; `None` for a server without options.
    pub(in crate::server) fn settings(&self) -> Option<Vec<SettingState>> {
        let running = lock(self.running.as_ref()?);
        let Running { options, at_start } = &*running;
        Some(SettingState::all(settings(), &options.given, &at_start.given))
    }

    /// Returns the file in which settings are saved.
    pub(in crate::server) fn settings_file(&self) -> Option<String> {
        let running = lock(self.running.as_ref()?);
        running.options.file.as_ref().map(|file| file.display().to_string())
    }

    /// Changes settings, all or none, and saves them in the file of `--config`.
    pub(in crate::server) fn change_settings(&self, changes: &Changes) -> Result<(), Refused> {
        let running = self.running.as_ref().ok_or(Refused::NoOptions)?;
        let mut running = lock(running);
        let invalid = |error: anyhow::Error| Refused::Invalid(format!("{error:#}"));
        let options = running.options.with(changes).map_err(invalid)?;
        if !self.at_bench(|bench, now| bench.reconfigure(&options.config, now)) {
            return Err(Refused::Moving);
        }
        let changed = changed_settings(changes, &running.options.given, &options.given, |text| {
            self.report_event(Severity::Info, PAGE, text);
        });
        let saved = self.save_settings(&options, &changed);
        running.options = options;
        saved.map_err(Refused::NotSaved)
    }

    /// Saves these settings in the file of `--config`, if any.
    fn save_settings(&self, options: &Options, names: &[&String]) -> Result<(), String> {
        let Some(file) = &options.file else { return Ok(()) };
        let is_list = |name: &str| settings().iter().any(|row| row.name == name && row.is_list);
        let value = |name: &str| options.given.get(name).map(|words| toml_value(words, is_list(name)));
        let lines: Vec<_> = names.iter().map(|name| (name.as_str(), value(name))).collect();
        save(file, &lines).map_err(|error| {
            let error = format!("{} cannot be written: {error}", file.display());
            self.report_event(Severity::Error, "gripper", &error);
            error
        })
    }

    /// Keeps the tag that a client has set (command set, 3.5.2), so that it outlasts a restart and, with `--config`, the
    /// program.
    pub(in crate::server) fn keep_tag(&self, tag: &Tag) {
        let Some(running) = &self.running else { return };
        if lock(running).options.config.tag == *tag {
            return;
        }
        let name = "tag".to_owned();
        let words = (!tag.as_str().is_empty()).then(|| vec![tag.as_str().to_owned()]);
        self.remember(&Changes::from([(name.clone(), words)]));
        // A failure is in the system log. The command itself has succeeded.
        let _ = self.save_settings(&lock(running).options, &[&name]);
    }

    /// Takes over settings that are in effect already, such as a station name that a controller has set, so that they
    /// outlast a restart.
    pub(in crate::server) fn remember(&self, changes: &Changes) {
        let Some(running) = &self.running else { return };
        let Running { options, at_start } = &mut *lock(running);
        for options in [options, at_start] {
            // The values come from the device, so they are valid.
            if let Ok(changed) = options.with(changes) {
                *options = changed;
            }
        }
    }

    /// Restarts the gripper with its current settings, as after a power cycle. Returns false without options.
    pub(in crate::server) fn restart(&self) -> bool {
        if self.running.is_some() {
            self.report_event(Severity::Warning, PAGE, "restart");
            self.restart.notify_one();
        }
        self.running.is_some()
    }

    /// Ready when a restart is requested.
    pub(in crate::server) async fn restart_requested(&self) {
        self.restart.notified().await;
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use crate::control::SystemLog;
    use crate::server::lines::Profile;

    #[test]
    fn station_name_set_by_a_controller_is_not_pending() {
        let options = Options::parse(vec!["--profinet".into(), "eth0".into()]).unwrap();
        let hub = Hub::new(
            options.config,
            Profile::Instant,
            0,
            None,
            SystemLog::new(String::new, None),
            Some(&options),
        );
        hub.remember(&Changes::from([("station".to_owned(), Some(vec!["wsg-7".to_owned()]))]));
        let settings = hub.settings().unwrap();
        let station = settings.iter().find(|setting| setting.row.name == "station").unwrap();
        assert_eq!((&station.given, station.is_pending), (&Some(vec!["wsg-7".to_owned()]), false));
        let running = lock(hub.running.as_ref().unwrap());
        assert_eq!(running.options.lines.profinet.as_ref().unwrap().stored.name.as_str(), "wsg-7");
    }
}
