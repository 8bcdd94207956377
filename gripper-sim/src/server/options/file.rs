//! The configuration file: how it is read, and how settings are saved in it.

use super::{definition, one_line, value_name};
use crate::command_line::nearest;
use crate::server::folder;
use crate::text;
use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::{Arg, ArgAction};
use std::ffi::OsString;
use std::ops::Range;
use std::path::Path;
use std::{fs, io};
use toml::de::{DeTable, DeValue};

/// Converts the options of a file to command line words. Each is checked, so that an error names its line.
pub(super) fn words_of_file(path: &Path) -> Result<Vec<OsString>> {
    let name = path.display();
    let text = text::read(path).with_context(|| format!("--config {name} cannot be read"))?;
    let line_number = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
    let table = DeTable::parse(&text).map_err(|error| {
        let line = line_number(error.span().map_or(0, |span| span.start));
        let what = error.message().lines().collect::<Vec<_>>().join(", ");
        anyhow!("{name}, line {line}: {what}; expected TOML")
    })?;
    let command = definition();
    let mut words = Vec::new();
    for (key, value) in table.get_ref() {
        let place = format!("{name}, line {}", line_number(key.span().start));
        let key: &str = key.get_ref();
        let Some(arg) = command.get_arguments().find(|arg| arg.get_long() == Some(key)) else {
            let near = nearest(key, command.get_arguments().filter_map(Arg::get_long)).join(" or ");
            let hint = if near.is_empty() { near } else { format!("; did you mean {near}?") };
            bail!("{place}: {key} is unknown; expected options as --help lists them{hint}");
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

/// Saves settings in the configuration file: replaces their values, and keeps everything else, including line ends and a byte
/// order mark. `None` removes a setting.
///
/// # Errors
/// Returns an error if the file cannot be read or written, or is no longer TOML.
pub(in crate::server) fn save(path: &Path, settings: &[(&str, Option<String>)]) -> io::Result<()> {
    let mut whole = fs::read(path)?;
    let mut text = text::decoded(whole.clone())?;
    // Keeps the byte order mark.
    whole.truncate(whole.len() - text.len());
    change(&mut text, settings)
        .map_err(|error| io::Error::other(format!("it is no longer TOML: {}", error.message())))?;
    whole.extend(text.bytes());
    folder::write(path, &whole)
}

/// Changes settings in the text of a file.
fn change(text: &mut String, settings: &[(&str, Option<String>)]) -> Result<(), toml::de::Error> {
    let mut edits = Vec::new();
    let mut added = Vec::new();
    {
        let table = DeTable::parse(text)?;
        for (name, value) in settings {
            match (table.get_ref().get_key_value(*name), value) {
                (Some((_, old)), Some(value)) => edits.push((old.span(), value.as_str())),
                (Some((key, old)), None) => edits.push((line_of(text, key.span().start, old.span().end), "")),
                (None, Some(value)) => added.push(format!("{name} = {value}")),
                (None, None) => {}
            }
        }
    }
    let line_end = if text.contains("\r\n") { "\r\n" } else { "\n" };
    // From the end, so that the earlier positions remain valid.
    edits.sort_by_key(|(range, _)| std::cmp::Reverse(range.start));
    for (range, value) in edits {
        text.replace_range(range, value);
    }
    if !added.is_empty() && !text.is_empty() && !text.ends_with('\n') {
        text.push_str(line_end);
    }
    for line in added {
        *text += &(line + line_end);
    }
    Ok(())
}

/// Returns the range of a setting, from its key to the end of its value, with the rest of the line, unless that is a comment.
fn line_of(text: &str, key: usize, end: usize) -> Range<usize> {
    let start = text.get(..key).and_then(|before| before.rfind('\n')).map_or(0, |at| at + 1);
    let rest = text.get(end..).unwrap_or("");
    let comment = rest.len() - rest.trim_start_matches([' ', '\t']).len();
    let line = rest.find('\n').map_or(rest.len(), |at| at + 1);
    start..end + if rest.get(comment..).is_some_and(|rest| rest.starts_with('#')) { comment } else { line }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn saved_settings_keep_line_ends_comments_and_byte_order_mark() {
        let path = std::env::temp_dir().join(format!("wsg-sim-save-{}.toml", std::process::id()));
        let set = |name, value: &str| (name, Some(value.to_owned()));
        for (before, settings, after) in [
            (
                "\u{FEFF}# A cell\r\ntag = \"x\"   # left\r\n\r\npart = \"20\"\r\n",
                &[set("tag", "\"y\""), set("speed", "5")][..],
                "\u{FEFF}# A cell\r\ntag = \"y\"   # left\r\n\r\npart = \"20\"\r\nspeed = 5\r\n",
            ),
            ("tag = 'x' # left\nforce=5\n", &[("tag", None), ("force", None)], "# left\n"),
            ("force=5\r\n\tspeed = 9\r\n# end", &[("speed", None)], "force=5\r\n# end"),
            ("force = 5", &[set("speed", "9")], "force = 5\nspeed = 9\n"),
            (
                "control-host = [ # two\n  \"a\",\n  \"b\",\n] # hosts\n\"tag\" = \"x\"\n",
                &[set("control-host", "[\"c\"]"), set("tag", "\"control-host = 1\"")],
                "control-host = [\"c\"] # hosts\n\"tag\" = \"control-host = 1\"\n",
            ),
            ("", &[set("force", "5"), ("tag", None)], "force = 5\n"),
        ] {
            fs::write(&path, before).unwrap();
            save(&path, settings).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), after);
        }
        fs::write(&path, "force =\n").unwrap();
        assert!(save(&path, &[set("force", "5")]).is_err(), "the file changed and is no longer TOML");
        fs::remove_file(&path).unwrap();
    }
}
