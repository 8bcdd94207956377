//! The configuration file: how it is read, and how settings are saved in it.

use super::{command, one_line, value_name};
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::{Arg, ArgAction};
use std::ffi::OsString;
use std::path::Path;
use std::{fs, io};
use toml::de::{DeTable, DeValue};

/// Converts the options of a file to command line words. Each is checked, so that an error names its line.
pub(super) fn words_of_file(path: &Path) -> Result<Vec<OsString>> {
    let name = path.display();
    let text = std::fs::read_to_string(path).with_context(|| format!("--config {name} cannot be read"))?;
    let line_of = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
    let table = DeTable::parse(&text).map_err(|error| {
        let line = line_of(error.span().map_or(0, |span| span.start));
        let what = error.message().lines().collect::<Vec<_>>().join(", ");
        anyhow!("{name}, line {line}: {what}; expected TOML")
    })?;
    let command = command();
    let mut words = Vec::new();
    for (key, value) in table.get_ref() {
        let place = format!("{name}, line {}", line_of(key.span().start));
        let key: &str = key.get_ref();
        let Some(arg) = command.get_arguments().find(|arg| arg.get_long() == Some(key)) else {
            bail!("{place}: {key} is unknown; expected options as --help lists them");
        };
        ensure!(key != "config", "{place}: {key} is only valid on the command line");
        for word in words_of(arg, key, value.get_ref()).with_context(|| {
            let expected = value_name(arg).unwrap_or("true or false");
            format!("{place}: {key} has the wrong type; expected {expected}, as a text unless it is a number")
        })? {
            let checked = command.clone().try_get_matches_from([&word]);
            checked.map_err(one_line).with_context(|| place.clone())?;
            words.push(word);
        }
    }
    Ok(words)
}

/// Returns the words for an option of a file; `None` if its value has the wrong type.
fn words_of(arg: &Arg, key: &str, value: &DeValue<'_>) -> Option<Vec<OsString>> {
    let is_switch = value_name(arg).is_none();
    let text = match value {
        DeValue::Boolean(true) if is_switch => return Some(vec![format!("--{key}").into()]),
        DeValue::Boolean(false) if is_switch => return Some(vec![]),
        _ if is_switch => return None,
        DeValue::Array(items) if matches!(arg.get_action(), ArgAction::Append) => {
            let words: Option<Vec<_>> = items.iter().map(|item| words_of(arg, key, item.get_ref())).collect();
            return Some(words?.concat());
        }
        DeValue::String(text) => text.clone().into_owned(),
        DeValue::Integer(number) => i128::from_str_radix(number.as_str(), number.radix()).ok()?.to_string(),
        DeValue::Float(number) => number.as_str().to_owned(),
        DeValue::Boolean(_) | DeValue::Datetime(_) | DeValue::Array(_) | DeValue::Table(_) => return None,
    };
    Some(vec![format!("--{key}={text}").into()])
}

/// Saves settings in the configuration file: replaces their lines, and keeps all others. `None` removes a setting.
pub(in crate::server) fn save(path: &Path, settings: &[(&str, Option<String>)]) -> io::Result<()> {
    let text = fs::read_to_string(path)?;
    let is_other = |line: &&str| {
        let key = line.split('=').next().unwrap_or("").trim();
        settings.iter().all(|(name, _)| *name != key)
    };
    let mut kept: Vec<String> = text.lines().filter(is_other).map(str::to_owned).collect();
    let set = settings.iter().filter_map(|(name, value)| Some(format!("{name} = {}", value.as_ref()?)));
    kept.extend(set);
    // Written to a new file that then replaces the old one, so that no failure leaves half a file.
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    fs::write(&new, kept.join("\n") + "\n")?;
    fs::rename(&new, path)
}

/// Returns the words of a setting as a value in the file: true for a switch, a list where the option may be repeated.
pub(in crate::server) fn toml_value(words: &[String], is_list: bool) -> String {
    let quoted_words: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    match &quoted_words[..] {
        words if is_list => format!("[{}]", words.join(", ")),
        [] => "true".to_owned(),
        words => words.concat(),
    }
}

/// Quotes a text as a TOML string.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for letter in text.chars() {
        match letter {
            '"' | '\\' => quoted.extend(['\\', letter]),
            letter if letter.is_control() => quoted.push_str(&format!("\\u{:04X}", u32::from(letter))),
            letter => quoted.push(letter),
        }
    }
    quoted + "\""
}
