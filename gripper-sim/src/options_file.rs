//! Options in a TOML file, `name = value` with the names of a command line, for all host programs (feature `std`).

use crate::command_line::{nearest, suggest};
use crate::text;
use anyhow::{Context, Result, anyhow, bail};
use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command};
use std::ffi::OsString;
use std::io;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The text of a file with options.
#[derive(Clone, Debug)]
pub struct OptionsFile {
    name: String,
    text: String,
}

impl OptionsFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or is not UTF-8.
    pub fn read(path: &Path) -> io::Result<Self> {
        Ok(Self { name: path.display().to_string(), text: text::read(path)? })
    }

    /// Returns the file's name and the line of a byte, for messages.
    #[must_use]
    pub fn place(&self, at: usize) -> String {
        let line = 1 + self.text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        format!("{}, line {line}", self.name)
    }

    /// Parses the file.
    ///
    /// # Errors
    /// Returns one line with the place of the first mistake.
    pub fn table(&self) -> Result<Spanned<DeTable<'_>>> {
        DeTable::parse(&self.text).map_err(|error| {
            let place = self.place(error.span().map_or(0, |span| span.start));
            let what = error.message().lines().collect::<Vec<_>>().join(", ");
            anyhow!("{place}: {what}; expected TOML")
        })
    }

    /// Converts the options of a table to command line words. Each is checked, so that an error names its line. `list` names the
    /// place where the options are described.
    ///
    /// # Errors
    /// Returns one line with the place of the first unknown or invalid option.
    pub fn words(&self, table: &DeTable<'_>, command: &Command, list: &str) -> Result<Vec<OsString>> {
        let mut words = Vec::new();
        for (key, value) in table {
            let place = self.place(key.span().start);
            let key: &str = key.get_ref();
            let Some(arg) = command.get_arguments().find(|arg| arg.get_long() == Some(key)) else {
                let near = nearest(key, command.get_arguments().filter_map(Arg::get_long)).join(" or ");
                let hint = if near.is_empty() { near } else { format!("; did you mean {near}?") };
                bail!("{place}: {key} is unknown; expected options as {list} lists them{hint}");
            };
            for word in words_of(arg, key, value.get_ref()).with_context(|| {
                let expected = value_name(arg).unwrap_or("true or false");
                format!(
                    "{place}: {key} has the wrong type; expected {expected}, as a text unless it is a number"
                )
            })? {
                let wrong = command.clone().try_get_matches_from([&word]).err();
                // An option may require another one of the table.
                if let Some(wrong) = wrong.filter(|wrong| wrong.kind() != ErrorKind::MissingRequiredArgument)
                {
                    return Err(one_line(wrong, command, list)).with_context(|| place.clone());
                }
                words.push(word);
            }
        }
        Ok(words)
    }
}

/// Returns the name of an option's value; a switch has none.
pub(crate) fn value_name(arg: &Arg) -> Option<&str> {
    arg.get_value_names().filter(|_| arg.get_action().takes_values()).map(|names| names[0].as_str())
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

/// Reduces an error of a command line to one line without the usage. `list` names the place where its options are described.
#[must_use]
pub fn one_line(error: clap::Error, command: &Command, list: &str) -> anyhow::Error {
    let error = suggest(error, command, &[""; 0]);
    let text = error.to_string();
    let lines = text.lines().take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let lines: Vec<_> = lines.map(str::trim).filter(|line| !line.is_empty()).collect();
    let hint = match error.kind() {
        ErrorKind::InvalidValue | ErrorKind::UnknownArgument => {
            format!("; expected options as {list} lists them")
        }
        _ => String::new(),
    };
    anyhow!("{}{hint}", lines.join("; ").trim_start_matches("error: "))
}
