//! Settings as JSON: the table with its values, and changes.

use super::Host;
use super::answer::{HttpError, status};
use super::json::{FromJson, ToJson, Value, object};
use wsg_protocol::editor::Quoted;

/// Headings of settings.
pub(crate) const COMMAND: &str = "Command interface";
pub(crate) const MOTION: &str = "Motion configuration";
pub(crate) const NETWORK: &str = "Network";
pub(crate) const FIELDBUS: &str = "Fieldbus";
pub(crate) const DEVICE: &str = "Device";
/// The groups of settings on the page, in order.
pub(crate) const GROUPS: [&str; 5] = [COMMAND, MOTION, NETWORK, FIELDBUS, DEVICE];

pub(crate) const SETTINGS_EXPECTED: &str = r#"an object with the settings to change, such as {"clamping-travel":4,"homing-at-start":true,"tag":null}, where null is the default"#;

/// Stands for the unit of a switch in `settings.tsv`.
const SWITCH: &str = "switch";

/// One row of the table of settings.
#[derive(Debug)]
pub(crate) struct Setting {
    pub(crate) name: String,
    pub(crate) group: String,
    pub(crate) meaning: String,
    /// The default, as the help writes it; empty without one.
    pub(crate) default: String,
    /// The unit, or the form of the value. `None` for a switch.
    pub(crate) unit: Option<String>,
    /// The possible values, if they are few.
    pub(crate) choices: Vec<String>,
    /// The accepted values, in the words of the error; empty for a free text.
    pub(crate) expected: String,
    pub(crate) is_at_once: bool,
    /// Whether the value is a list.
    pub(crate) is_list: bool,
}

impl Setting {
    /// Returns the row in a line of `settings.tsv`.
    #[cfg(all(test, feature = "std"))]
    pub(crate) fn line(&self) -> String {
        let unit = self.unit.as_deref().unwrap_or(SWITCH);
        let mut words = vec![&self.name[..], &self.group, &self.meaning, &self.default, unit, &self.expected];
        words.extend([self.is_at_once, self.is_list].map(|is_so| if is_so { "yes" } else { "no" }));
        words.extend(self.choices.iter().map(String::as_str));
        words.join("\t") + "\n"
    }

    /// Returns the row of a line of `settings.tsv`.
    pub(crate) fn of(line: &str) -> Self {
        let mut words = line.split('\t').map(str::to_owned);
        let mut next = || words.next().unwrap_or_default();
        Self {
            name: next(),
            group: next(),
            meaning: next(),
            default: next(),
            unit: Some(next()).filter(|unit| unit != SWITCH),
            expected: next(),
            is_at_once: next() == "yes",
            is_list: next() == "yes",
            choices: words.collect(),
        }
    }
}

/// A setting with its value.
#[derive(Debug)]
pub(crate) struct SettingState {
    pub(crate) row: &'static Setting,
    /// The given words; `None` for the default.
    pub(crate) given: Option<Vec<String>>,
    /// Whether the value counts after the next restart only.
    pub(crate) is_pending: bool,
}

impl SettingState {
    /// Returns the rows of a table with the words that are given now, and that were given at the start.
    pub(crate) fn all(table: &'static [Setting], given: &Given, at_start: &Given) -> Vec<Self> {
        let state = |row: &'static Setting| {
            let words = given.get(&row.name);
            let is_pending = !row.is_at_once && words != at_start.get(&row.name);
            Self { row, given: words.cloned(), is_pending }
        };
        table.iter().map(state).collect()
    }
}

/// The words given for each option, without its hyphens: none for a switch, several for an option that may be repeated. The
/// options are in the order of their names. They are few, and the code of a map is large.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Given(Vec<(String, Vec<String>)>);

impl Given {
    pub(crate) fn get(&self, name: &str) -> Option<&Vec<String>> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, words)| words)
    }

    pub(crate) fn iter(&self) -> std::slice::Iter<'_, (String, Vec<String>)> {
        self.0.iter()
    }

    /// Sets the words of an option; `None` for the default.
    pub(crate) fn set(&mut self, name: &str, words: Option<Vec<String>>) {
        self.0.retain(|(known, _)| known != name);
        if let Some(words) = words {
            let at = self.0.partition_point(|(known, _)| &known[..] < name);
            self.0.insert(at, (name.to_owned(), words));
        }
    }

    pub(crate) fn with(&self, changes: &Changes) -> Self {
        let mut given = self.clone();
        changes.iter().for_each(|(name, words)| given.set(name, words.clone()));
        given
    }
}

/// Changed settings: new words, none for a switch that is on, `None` for the default.
pub(crate) type Changes = Vec<(String, Option<Vec<String>>)>;

/// Why settings cannot change.
#[derive(Debug)]
pub(crate) enum Refused {
    /// The server was started by a program of its own, without options.
    NoOptions,
    /// A value is invalid, in one line.
    Invalid(String),
    /// A motion runs whose settings would change.
    Moving,
    /// The settings are in effect, but the file cannot be written.
    NotSaved(String),
}

/// Returns the names of the settings that differ, and describes each change.
pub(crate) fn changed_settings<'a>(
    changes: &'a Changes,
    before: &Given,
    after: &Given,
    report: impl Fn(&str),
) -> Vec<&'a String> {
    let value = |words: &Vec<String>| if words.is_empty() { "on".to_owned() } else { words.join(", ") };
    let text = |words: Option<&Vec<String>>| words.map_or_else(|| "default".to_owned(), value);
    let changed: Vec<&String> =
        changes.iter().map(|(name, _)| name).filter(|name| before.get(name) != after.get(name)).collect();
    for name in &changed {
        let [before, now] = [before, after].map(|given| text(given.get(name)));
        report(&format!("setting {name}: {before} -> {now}"));
    }
    changed
}

/// A changed setting may be any JSON value; its row decides.
#[derive(Debug)]
pub(crate) struct SettingsBody(Vec<(String, Value)>);

impl FromJson for SettingsBody {
    fn from_json(value: Value) -> Result<Self, String> {
        value.into_members(None).map(Self)
    }
}

impl ToJson for SettingState {
    fn write(&self, json: &mut String) {
        let Self { row, given, is_pending } = self;
        let kind = match row.unit {
            None => "switch",
            Some(_) if row.is_list => "list",
            Some(_) if !row.choices.is_empty() => "choice",
            Some(_) => "text",
        };
        // Null for the default.
        let value: &dyn ToJson = match given.as_deref() {
            None if kind == "switch" => &false,
            Some([]) if kind != "list" => &true,
            Some([word, ..]) if kind != "list" => word,
            _ => given,
        };
        object!(json;
            "name" => row.name,
            "group" => row.group,
            "meaning" => row.meaning,
            "kind" => kind,
            "unit" => row.unit.as_deref().unwrap_or(""),
            "choices" => row.choices,
            "default" => row.default,
            "expected" => row.expected,
            "value" => value,
            "effect" => if row.is_at_once { "at once" } else { "after a restart" },
            "pending" => is_pending,
        );
    }
}

fn no_options() -> HttpError {
    let error =
        "this server was started by another program, which holds its settings; expected the program wsg-sim";
    HttpError::new(status::CONFLICT, error.to_owned())
}

/// Returns the answer to `/settings`.
pub(crate) fn settings(host: &mut impl Host) -> Result<String, HttpError> {
    let settings = host.settings().ok_or_else(no_options)?;
    Ok(object! {
        // Grows with each change.
        "revision": host.at_bench(|bench, _| bench.settings_revision()),
        "groups": GROUPS,
        "file": host.settings_file(),
        "restart_pending": settings.iter().any(|setting| setting.is_pending),
        "settings": settings,
    })
}

/// Changes the settings, all or none.
pub(crate) fn change(host: &mut impl Host, body: SettingsBody) -> Result<(), HttpError> {
    let table = host.settings().ok_or_else(no_options)?;
    let mut changes = Changes::new();
    for (name, value) in body.0 {
        let state = table.iter().find(|setting| setting.row.name == name).ok_or_else(|| {
            let name = Quoted(&name);
            HttpError::wrong(format!("the setting {name} is unknown; expected one of GET /settings"))
        })?;
        let words = words(state, value).ok_or_else(|| {
            let expected = match (&state.row.unit, state.row.is_list) {
                (None, _) => "true or false",
                (_, true) => "a list of texts",
                _ => "a number, a text or null",
            };
            HttpError::wrong(format!("{name} has the wrong type; expected {expected}"))
        })?;
        // In the order of their names, for the log and the file.
        let at = changes.partition_point(|(known, _)| *known < name);
        changes.insert(at, (name, words));
    }
    host.change_settings(&changes).map_err(|refused| match refused {
        Refused::NoOptions => no_options(),
        Refused::Invalid(error) => HttpError::wrong(error),
        Refused::Moving => {
            let error = "the fingers move; expected them at rest for a change of the motion configuration";
            HttpError::new(status::CONFLICT, error.to_owned())
        }
        Refused::NotSaved(error) => {
            let error = format!("the settings are in effect and not saved: {error}");
            HttpError::new(status::INTERNAL_SERVER_ERROR, error)
        }
    })
}

/// Returns the words of a value; the outer `None` for a value of the wrong type.
fn words(state: &SettingState, value: Value) -> Option<Option<Vec<String>>> {
    let word = |value: Value| match value {
        Value::Text(text) | Value::Number(text) => Some(text),
        _ => None,
    };
    match value {
        Value::Null => Some(None),
        Value::Bool(on) if state.row.unit.is_none() => Some(on.then(Vec::new)),
        _ if state.row.unit.is_none() => None,
        Value::List(items) if state.row.is_list => {
            let words: Vec<String> = items.into_iter().map(word).collect::<Option<_>>()?;
            Some((!words.is_empty()).then_some(words))
        }
        _ if state.row.is_list => None,
        value => word(value).map(|word| Some(vec![word])),
    }
}
