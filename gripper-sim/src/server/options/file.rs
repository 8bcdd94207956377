//! The configuration file: how it is read, and how settings are saved in it.

use super::{HELP, definition};
use crate::options_file::OptionsFile;
use crate::server::folder;
use crate::text;
use anyhow::{Context, Result, bail};
use std::ffi::OsString;
use std::ops::Range;
use std::path::Path;
use std::{fs, io};
use toml::de::DeTable;

/// Converts the options of a file to command line words. Each is checked, so that an error names its line.
pub(super) fn words_of_file(path: &Path) -> Result<Vec<OsString>> {
    let file =
        OptionsFile::read(path).with_context(|| format!("--config {} cannot be read", path.display()))?;
    let table = file.table()?;
    if let Some((key, _)) = table.get_ref().get_key_value("config") {
        bail!("{}: config is only valid on the command line", file.place(key.span().start));
    }
    file.words(table.get_ref(), &definition(), HELP)
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
