//! Status, registers and events of a bridge, as text and as JSON.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};
use wsg_bridge_fw::RECIPE_COUNT;
use wsg_bridge_fw::registers::{
    EVENTS, EVENTS_KEPT, EventText, FIRST_REPORT, FIRST_SETTING, REPORTS, Record, SETTINGS,
};
use wsg_fieldbus::{ForceUnit, InputImage};
use wsg_protocol::{CommandId, DeviceType, FirmwareVersion, Status, SystemFlags};

use super::names::{self, place, report, words};

/// Number of registers per event: code, command, value, age.
const EVENT_LEN: usize = 4;
/// Number of registers per recipe: width, speed, force, release width.
const RECIPE_LEN: usize = 4;

/// A snapshot of a bridge's registers.
pub(crate) struct State {
    pub(crate) settings: Record,
    /// Report values, in the order of `REPORTS`.
    pub(crate) reports: Vec<u16>,
    /// Input image, or `None` if no gripper responds.
    pub(crate) image: Option<InputImage>,
}

impl State {
    /// Returns a report, which must exist.
    pub(crate) fn report(&self, name: &str) -> u16 {
        self.reports.get(report(name)).copied().unwrap_or_default()
    }

    /// Formats a report as the name of its choice, or as a number.
    fn report_words(&self, name: &str) -> String {
        let value = self.report(name);
        let meaning = REPORTS.get(report(name)).map_or("", |report| report.meaning);
        words("", meaning, value).unwrap_or_else(|| value.to_string())
    }

    /// Formats identity and status of bridge and gripper, one line per topic.
    pub(crate) fn summary(&self) -> String {
        let [major, minor] = self.report("BRIDGE_VERSION").to_be_bytes();
        let mut text = String::new();
        let version = format!("{major}.{minor}.{}", self.report("BRIDGE_PATCH"));
        // Writing to a string never fails.
        let _ = writeln!(text, "bridge     firmware {version}, register map {}", self.report("MAP_VERSION"));
        let stored = match self.report("SETTINGS_CHANGED") {
            0 => "no unsaved changes",
            _ => "unsaved changes",
        };
        let _ = writeln!(text, "settings   source: {}; {stored}", self.report_words("SETTINGS_FROM"));
        let _ = writeln!(text, "gripper    {}", self.gripper());
        if let Some(image) = &self.image {
            let _ = writeln!(text, "fingers    {}", self.fingers(image));
            let flags =
                if image.system.is_empty() { "no flags".to_owned() } else { image.system.to_string() };
            let _ = writeln!(text, "system     {flags}");
        }
        let _ = writeln!(text, "error      {}", self.error());
        text
    }

    fn gripper(&self) -> String {
        let link = self.report_words("GRIPPER_LINK");
        let device = u8::try_from(self.report("GRIPPER_TYPE")).map(DeviceType::from_code);
        let serial_number =
            u32::from(self.report("SERIAL_HIGH")) << 16 | u32::from(self.report("SERIAL_LOW"));
        match device {
            Ok(device) if device != DeviceType::Unspecified => {
                let firmware = FirmwareVersion::from_bits(self.report("GRIPPER_FIRMWARE"));
                format!("{link}: {device}, firmware {firmware}, serial number {serial_number}")
            }
            _ => link,
        }
    }

    fn fingers(&self, image: &InputImage) -> String {
        let device = DeviceType::from_code(self.report("GRIPPER_TYPE").to_le_bytes()[0]);
        let force = f32::from(image.force) / ForceUnit::of(device).per_newton();
        let states: Vec<&str> = image.state.iter_names().map(|(name, _)| name).collect();
        // The width is unknown until the gripper is referenced.
        let width = match image.system.contains(SystemFlags::REFERENCED) {
            true => format!("{:.2} mm", f32::from(image.width) / 100.0),
            false => "width unknown".to_owned(),
        };
        format!("{}, {width}, {force:.2} N; last command: {}", states.join(" "), image.status)
    }

    /// Returns why a PLC cannot use the gripper now: the gripper is not connected, or ERROR is high.
    pub(crate) fn fault(&self) -> Option<String> {
        match (self.report_words("GRIPPER_LINK").as_str(), self.report("ERROR_CAUSE")) {
            ("connected", 0) => None,
            ("connected", code) => Some(event_words(code)),
            (link, _) => Some(format!("no gripper: {link}")),
        }
    }

    fn error(&self) -> String {
        match self.report("ERROR_CAUSE") {
            0 => "none".to_owned(),
            code => event_words(code),
        }
    }

    /// Formats all settings except the recipes, and the reports if `all` is set.
    pub(crate) fn registers(&self, all: bool) -> String {
        let recipes = recipe_places();
        let settings = (0..SETTINGS.len()).filter(|at| !recipes.contains(at));
        let mut text: String = settings.filter_map(|at| self.setting_line(at)).collect();
        if all {
            text.extend((0..REPORTS.len()).filter_map(|at| self.report_line(at)));
        }
        text
    }

    fn setting_line(&self, at: usize) -> Option<String> {
        let (setting, value) = (SETTINGS.get(at)?, self.settings.get(at)?);
        Some(line(setting.name, *value, words(setting.unit, setting.meaning, *value)))
    }

    fn report_line(&self, at: usize) -> Option<String> {
        let (report, value) = (REPORTS.get(at)?, self.reports.get(at)?);
        Some(line(report.name, *value, words("", report.meaning, *value)))
    }

    /// Formats one setting or report with its meaning.
    ///
    /// # Errors
    /// There is no setting or report with this name.
    pub(crate) fn named(&self, name: &str) -> anyhow::Result<String> {
        let is = |it: &str| it.eq_ignore_ascii_case(name);
        if let Some((at, it)) = SETTINGS.iter().enumerate().find(|(_, it)| is(it.name)) {
            let address = usize::from(FIRST_SETTING) + at;
            let line = self.setting_line(at).unwrap_or_default();
            let meaning = if it.meaning.is_empty() { String::new() } else { format!("; {}", it.meaning) };
            return Ok(format!(
                "{line}    holding register {address}, {} to {}{meaning}\n",
                it.least, it.most
            ));
        }
        if let Some((at, it)) = REPORTS.iter().enumerate().find(|(_, it)| is(it.name)) {
            let address = usize::from(FIRST_REPORT) + at;
            let line = self.report_line(at).unwrap_or_default();
            let meaning = if it.meaning.is_empty() { String::new() } else { format!(": {}", it.meaning) };
            return Ok(format!("{line}    input register {address}{meaning}\n"));
        }
        let mut all = SETTINGS.iter().map(|it| it.name).chain(REPORTS.iter().map(|it| it.name));
        anyhow::bail!(names::unknown(name, "setting or report", &mut all));
    }

    /// Returns settings, reports and input image as JSON, by name.
    pub(crate) fn json(&self) -> Value {
        let settings =
            SETTINGS.iter().zip(&self.settings).map(|(it, value)| (it.name.to_owned(), json!(value)));
        let reports = REPORTS.iter().zip(&self.reports).map(|(it, value)| (it.name.to_owned(), json!(value)));
        let image = self.image.as_ref().map(|image| {
            let flags = |names: Vec<&'static str>| json!(names);
            json!({
                "state": flags(image.state.iter_names().map(|(name, _)| name).collect()),
                "system": flags(image.system.iter_names().map(|(name, _)| name).collect()),
                "width": image.width,
                "force": image.force,
                "status": image.status.symbol(),
            })
        });
        json!({
            "settings": settings.collect::<Map<_, _>>(),
            "reports": reports.collect::<Map<_, _>>(),
            "input": image,
        })
    }

    /// Formats all recipes as a table.
    pub(crate) fn recipes(&self) -> String {
        let mut text = "recipe       width        speed       force      release\n".to_owned();
        for number in 0..RECIPE_COUNT {
            let first = recipe_places().start + number * RECIPE_LEN;
            let cell = |at: usize| {
                let (setting, value) = (SETTINGS.get(first + at), self.settings.get(first + at));
                setting.zip(value).and_then(|(it, value)| words(it.unit, "", *value)).unwrap_or_default()
            };
            let [width, speed, force, release] = [0, 1, 2, 3].map(cell);
            let _ = writeln!(text, "{number:>6} {width:>11} {speed:>12} {force:>11} {release:>12}");
        }
        let used = self.settings.get(place("BUS_RECIPE")).copied().unwrap_or_default();
        let bus = match usize::from(used) {
            number if number < RECIPE_COUNT => format!("the bus uses recipe {number}"),
            _ => "the bus sends its own values".to_owned(),
        };
        text + &bus + " (BUS_RECIPE); the wires select one of the first four\n"
    }

    /// Reads an event. `code` names its first register; the others follow it.
    fn event(&self, code: &str) -> Option<Event> {
        let first = report(code);
        let [code, command, value, age_s] = *self.reports.get(first..first + EVENT_LEN)? else { return None };
        (code != 0).then_some(Event { code, command, value, age_s })
    }

    fn events(&self) -> impl Iterator<Item = Event> {
        (1..=EVENTS_KEPT).filter_map(|number| self.event(&format!("EVENT{number}_CODE")))
    }

    /// Formats the most recent event in one line, without its remedy.
    pub(crate) fn latest_event(&self) -> String {
        let words = self.events().next().map(|event| event.words()).unwrap_or_default();
        words.lines().next().unwrap_or("none").trim_start().to_owned()
    }

    /// Formats the state of ERROR, the last FAST STOP, and the recorded events, most recent first.
    pub(crate) fn events_words(&self) -> String {
        let mut text = format!("ERROR is {}\n", if self.report("ERROR_CAUSE") == 0 { "low" } else { "high" });
        if self.report("ERROR_CAUSE") != 0 {
            let _ = writeln!(text, "  cause: {}", self.error());
        }
        match self.event("FAST_STOP_CAUSE") {
            Some(event) => {
                let _ = write!(text, "last FAST STOP:\n{}", event.words());
            }
            None => text.push_str("no FAST STOP since start-up\n"),
        }
        let _ = writeln!(text, "{} events since start-up, most recent first:", self.report("EVENTS"));
        text.extend(self.events().map(|event| event.words()));
        text
    }

    /// Returns the same as JSON.
    pub(crate) fn events_json(&self) -> Value {
        json!({
            "error": event_text(self.report("ERROR_CAUSE")).map(|it| it.name),
            "count": self.report("EVENTS"),
            "fast_stop": self.event("FAST_STOP_CAUSE").map(|event| event.json()),
            "events": self.events().map(|event| event.json()).collect::<Vec<_>>(),
        })
    }
}

fn line(name: &str, value: u16, words: Option<String>) -> String {
    format!("{name:<18} {value:>5}  {}", words.unwrap_or_default()).trim_end().to_owned() + "\n"
}

/// Returns the indices of the recipes in a record.
fn recipe_places() -> std::ops::Range<usize> {
    place("RECIPE0_WIDTH")..place("RECIPE0_WIDTH") + RECIPE_COUNT * RECIPE_LEN
}

fn event_text(code: u16) -> Option<&'static EventText> {
    EVENTS.iter().find(|event| event.code as u16 == code)
}

/// Formats an event code: `REFUSED: the gripper refused the command; remedy: see the status codes`.
fn event_words(code: u16) -> String {
    match event_text(code) {
        Some(EventText { name, meaning, remedy, .. }) => format!("{name}: {meaning}; remedy: {remedy}"),
        None => format!("event {code}, unknown to this version of wsg"),
    }
}

/// An entry of the bridge's event log.
struct Event {
    code: u16,
    command: u16,
    value: u16,
    age_s: u16,
}

impl Event {
    fn words(&self) -> String {
        let age =
            if self.age_s == u16::MAX { "long ago".to_owned() } else { format!("{} s ago", self.age_s) };
        let Some(EventText { name, meaning, value, remedy, .. }) = event_text(self.code) else {
            return format!("  {age:>10}  {}\n", event_words(self.code));
        };
        let command = u8::try_from(self.command).ok().filter(|id| *id != 0).map(CommandId::from_code);
        let command = command.map(|id| format!(" [{id}]")).unwrap_or_default();
        let value = if value.is_empty() { String::new() } else { format!(" ({})", self.value_words(value)) };
        format!("  {age:>10}  {name}{command}: {meaning}{value}\n{:14}remedy: {remedy}\n", "")
    }

    /// Formats the event's value. `what` has its description in the event table: a status, a register, or a number.
    fn value_words(&self, what: &'static str) -> String {
        if what == "its status" {
            let status = Status::from_code(self.value);
            return format!("{status}, {}", status.meaning());
        }
        let settings = SETTINGS.iter().map(|it| (it.name, it.meaning));
        let mut registers = settings.chain(REPORTS.iter().map(|it| (it.name, it.meaning)));
        let meaning = registers.find(|(name, _)| *name == what).map_or(what, |(_, meaning)| meaning);
        words("", meaning, self.value).unwrap_or_else(|| format!("{what}: {}", self.value))
    }

    fn json(&self) -> Value {
        let text = event_text(self.code);
        let command = u8::try_from(self.command).ok().filter(|id| *id != 0).map(CommandId::from_code);
        json!({
            "code": self.code,
            "name": text.map(|it| it.name),
            "meaning": text.map(|it| it.meaning),
            "command": command.map(|id| id.to_string()),
            "value": self.value,
            "age_s": self.age_s,
            "remedy": text.map(|it| it.remedy),
        })
    }
}
