//! Settings as JSON: the table with its values, and changes.

use super::answer::HttpError;
use crate::server::hub::{Changes, Hub, Refused, SettingState};
use crate::server::options::GROUPS;
use hyper::StatusCode;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;

pub(super) const SETTINGS_EXPECTED: &str = r#"an object with the settings to change, such as {"clamping-travel":4,"homing-at-start":true,"tag":null}, where null is the default"#;

/// A changed setting may be any JSON value; its row decides.
pub(super) type SettingsBody = BTreeMap<String, Value>;

/// The answer to `/settings`.
#[derive(Debug, Serialize)]
pub(super) struct SettingsAnswer {
    /// A number that grows with each change.
    revision: u64,
    groups: [&'static str; 5],
    /// The file in which changes are saved.
    file: Option<String>,
    /// Whether a setting waits for a restart.
    restart_pending: bool,
    settings: Vec<SettingBody>,
}

#[derive(Debug, Serialize)]
struct SettingBody {
    name: &'static str,
    group: &'static str,
    meaning: &'static str,
    /// `switch`, `choice`, `list`, or `text` for numbers and texts.
    kind: &'static str,
    unit: &'static str,
    choices: &'static [String],
    default: &'static str,
    expected: &'static str,
    /// The given value; null for the default.
    value: Value,
    effect: &'static str,
    pending: bool,
}

impl SettingBody {
    fn of(state: SettingState) -> Self {
        let SettingState { row, given, is_pending } = state;
        let kind = match row.unit {
            None => "switch",
            Some(_) if row.is_list => "list",
            Some(_) if !row.choices.is_empty() => "choice",
            Some(_) => "text",
        };
        let value = match given {
            None if kind == "switch" => Value::Bool(false),
            None => Value::Null,
            Some(words) if kind == "list" => words.into(),
            Some(words) => words.into_iter().next().map_or(Value::Bool(true), Value::String),
        };
        Self {
            name: &row.name,
            group: row.group,
            meaning: &row.meaning,
            kind,
            unit: row.unit.unwrap_or(""),
            choices: &row.choices,
            default: &row.default,
            expected: &row.expected,
            value,
            effect: if row.is_at_once { "at once" } else { "after a restart" },
            pending: is_pending,
        }
    }
}

fn no_options() -> HttpError {
    let error =
        "this server was started by another program, which holds its settings; expected the program wsg-sim";
    HttpError::new(StatusCode::CONFLICT, error.to_owned())
}

pub(super) fn settings(hub: &Hub) -> Result<SettingsAnswer, HttpError> {
    let settings = hub.settings().ok_or_else(no_options)?;
    Ok(SettingsAnswer {
        revision: hub.settings_revision(),
        groups: GROUPS,
        file: hub.settings_file(),
        restart_pending: settings.iter().any(|setting| setting.is_pending),
        settings: settings.into_iter().map(SettingBody::of).collect(),
    })
}

/// Changes the settings, all or none.
pub(super) fn change(hub: &Hub, body: SettingsBody) -> Result<(), HttpError> {
    let table = hub.settings().ok_or_else(no_options)?;
    let changes: Result<Changes, HttpError> = body
        .into_iter()
        .map(|(name, value)| {
            let state = table.iter().find(|setting| setting.row.name == name).ok_or_else(|| {
                HttpError::wrong(format!("the setting {name:?} is unknown; expected one of GET /settings"))
            })?;
            let words = words(state, value).ok_or_else(|| {
                let expected = match (state.row.unit, state.row.is_list) {
                    (None, _) => "true or false",
                    (_, true) => "a list of texts",
                    _ => "a number, a text or null",
                };
                HttpError::wrong(format!("{name} has the wrong type; expected {expected}"))
            })?;
            Ok((name, words))
        })
        .collect();
    hub.change_settings(&changes?).map_err(|refused| match refused {
        Refused::NoOptions => no_options(),
        Refused::Invalid(error) => HttpError::wrong(error),
        Refused::Moving => {
            let error = "the fingers move; expected them at rest for a change of the motion configuration";
            HttpError::new(StatusCode::CONFLICT, error.to_owned())
        }
        Refused::NotSaved(error) => {
            let error = format!("the settings are in effect and not saved: {error}");
            HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error)
        }
    })
}

/// Returns the words of a value; the outer `None` for a value of the wrong type.
fn words(state: &SettingState, value: Value) -> Option<Option<Vec<String>>> {
    let word = |value: Value| match value {
        Value::String(text) => Some(text),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    };
    match value {
        Value::Null => Some(None),
        Value::Bool(on) if state.row.unit.is_none() => Some(on.then(Vec::new)),
        _ if state.row.unit.is_none() => None,
        Value::Array(items) if state.row.is_list => {
            let words: Vec<String> = items.into_iter().map(word).collect::<Option<_>>()?;
            Some((!words.is_empty()).then_some(words))
        }
        _ if state.row.is_list => None,
        value => word(value).map(|word| Some(vec![word])),
    }
}
