//! What the command lines of all host programs share: help without Markdown, suggestions, and addresses (feature `std`).

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Arg, Command, Error};
use std::net::{IpAddr, Ipv4Addr, SocketAddr};

/// The address that `localhost` stands for.
pub(crate) const LOOPBACK: IpAddr = IpAddr::V4(Ipv4Addr::LOCALHOST);

/// Parses an address to listen on. `localhost` is the only name, because looking up another one could take seconds, and the
/// running gripper would wait for it.
///
/// ```
/// use wsg_sim::command_line::address;
///
/// assert_eq!(address("localhost:0"), "127.0.0.1:0".parse().ok());
/// assert_eq!(address("bench:0"), None);
/// ```
#[must_use]
pub fn address(text: &str) -> Option<SocketAddr> {
    text.parse().ok().or_else(|| {
        let (name, port) = text.rsplit_once(':')?;
        let port = port.parse().ok().filter(|_| name.eq_ignore_ascii_case("localhost"))?;
        Some(SocketAddr::new(LOOPBACK, port))
    })
}

/// Returns the text after a prefix such as `tcp://`, in upper or lower case: schemes are not case-sensitive (RFC 3986, 3.1).
///
/// ```
/// use wsg_sim::command_line::after_scheme;
///
/// assert_eq!(after_scheme("TCP://Left", "tcp://"), Some("Left"));
/// ```
#[must_use]
pub fn after_scheme<'a>(text: &'a str, scheme: &str) -> Option<&'a str> {
    let (start, rest) = text.split_at_checked(scheme.len())?;
    start.eq_ignore_ascii_case(scheme).then_some(rest)
}

/// Returns the names that a mistyped word may stand for: those that begin with it, or else those that differ from it in the
/// fewest letters.
///
/// ```
/// use wsg_sim::command_line::nearest;
///
/// assert_eq!(nearest("tpc", ["tcp", "udp", "gcl"]), ["tcp"]);
/// assert_eq!(nearest("WSG 50", ["wsg25", "wsg50-110", "wsg50-210"]), ["wsg50-110", "wsg50-210"]);
/// assert!(nearest("colour", ["tcp", "udp"]).is_empty());
/// ```
pub fn nearest<'a>(word: &str, names: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let letters = |text: &str| -> String {
        text.chars().filter(|char| char.is_alphanumeric()).flat_map(char::to_lowercase).collect()
    };
    let word = letters(word);
    // A word of three letters may differ in one of them.
    let most = (word.chars().count() / 3).clamp(1, 3);
    let distances = names.into_iter().map(|name| {
        let name_letters = letters(name);
        let is_beginning = word.len() >= 2 && name_letters.starts_with(&word);
        (if is_beginning { 0 } else { strsim::damerau_levenshtein(&word, &name_letters) }, name)
    });
    let near: Vec<_> = distances.filter(|(distance, _)| *distance <= most).collect();
    let least = near.iter().map(|(distance, _)| *distance).min();
    near.into_iter().filter(|(distance, _)| Some(*distance) == least).map(|(_, name)| name).collect()
}

/// Adds the names that an unknown option, value or subcommand may stand for. `command` defines the command line, and `words` are
/// its words.
#[must_use]
pub fn suggest(mut error: Error, command: &Command, words: &[impl AsRef<str>]) -> Error {
    let command =
        words.iter().fold(command, |command, word| command.find_subcommand(word.as_ref()).unwrap_or(command));
    let text = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text.clone()),
        _ => None,
    };
    let hyphens = |name: &&str| format!("--{name}");
    let (kind, names) = if let Some(word) = text(ContextKind::InvalidSubcommand) {
        let names = nearest(&word, command.get_subcommands().map(Command::get_name));
        (ContextKind::SuggestedSubcommand, names.into_iter().map(str::to_owned).collect())
    } else if let (Some(word), Some(ContextValue::Strings(values))) =
        (text(ContextKind::InvalidValue), error.get(ContextKind::ValidValue))
    {
        let names = nearest(&word, values.iter().map(String::as_str));
        (ContextKind::SuggestedValue, names.into_iter().map(str::to_owned).collect())
    } else if error.kind() == ErrorKind::UnknownArgument
        && let Some(word) = text(ContextKind::InvalidArg).filter(|word| word.starts_with("--"))
    {
        let names = nearest(&word, command.get_arguments().filter_map(Arg::get_long));
        (ContextKind::SuggestedArg, names.iter().map(hyphens).collect::<Vec<_>>())
    } else {
        return error;
    };
    if !names.is_empty() {
        error.insert(kind, ContextValue::Strings(names));
    }
    error
}

/// Rewrites all help for a terminal: the documents contain the same texts in Markdown.
#[must_use]
pub fn without_markdown(mut command: Command) -> Command {
    let plain_text = |text: Option<&StyledStr>| text.map(|text| plain(&text.to_string()));
    if let Some(about) = plain_text(command.get_about()) {
        command = command.about(about);
    }
    if let Some(about) = plain_text(command.get_long_about()) {
        command = command.long_about(about);
    }
    command = command.mut_args(|mut arg| {
        if let Some(help) = plain_text(arg.get_help()) {
            arg = arg.help(help);
        }
        if let Some(help) = plain_text(arg.get_long_help()) {
            arg = arg.long_help(help);
        }
        arg
    });
    command.mut_subcommands(without_markdown)
}

/// Converts Markdown for a terminal: code in quotation marks, and the target of a link instead of its text.
fn plain(markdown: &str) -> String {
    let mut text = String::new();
    let mut rest = markdown;
    while let Some((before, link)) = rest.split_once('[') {
        text += before;
        let is_link = link.split_once("](").and_then(|(name, rest)| {
            let (target, rest) = rest.split_once(')')?;
            (!name.contains([']', '['])).then_some((name, target, rest))
        });
        match is_link {
            Some((name, target, behind)) => {
                text += &match target.strip_prefix('#') {
                    Some(_) => format!("docs/simulator.md, {name}"),
                    None => format!("docs/{target}"),
                };
                rest = behind;
            }
            None => {
                text.push('[');
                rest = link;
            }
        }
    }
    (text + rest).replace('`', "'")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_loses_its_markdown_and_keeps_its_brackets() {
        for (markdown, expected) in [
            ("`-` is standard output", "'-' is standard output"),
            ("over TCP ([gcl.md](gcl.md))", "over TCP (docs/gcl.md)"),
            ("Runs it ([Lua scripts](#lua-scripts))", "Runs it (docs/simulator.md, Lua scripts)"),
            ("Listens [default: 1501]", "Listens [default: 1501]"),
            ("a [b] and [c](c.md)", "a [b] and docs/c.md"),
        ] {
            assert_eq!(plain(markdown), expected);
        }
    }

    #[test]
    fn nearest_names_share_the_beginning_or_differ_in_few_letters() {
        let models = ["wsg50-110", "wsg50-210", "wsg32", "wsg25", "wsg70"];
        for (word, expected) in [
            ("wsg50", &["wsg50-110", "wsg50-210"][..]),
            ("wsg50-111", &["wsg50-110"]),
            ("WSG 32", &["wsg32"]),
            ("wsg23", &["wsg32", "wsg25"]),
            ("gripper", &[]),
            ("", &[]),
        ] {
            assert_eq!(nearest(word, models), expected, "{word}");
        }
    }
}
