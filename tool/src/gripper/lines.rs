//! Commands as lines of text, from the prompt, a script or standard input.

use std::io::{self, Read};
use std::path::Path;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Error, Parser, Subcommand};
use wsg_sim::command_line::suggest;
use wsg_sim::text::{self, one_line};

use super::action::{Named, signed};
use super::answer::{Answer, Outcome};
use super::output::Output;
use super::run::{self, Gripper, ProtocolCommands};
use super::trouble::Trouble;

/// A command line of the prompt or a script.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_version_flag = true, name = "")]
pub(crate) struct CommandLine {
    #[command(subcommand)]
    pub(crate) entry: Entry,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Entry {
    #[command(flatten)]
    Action(Named),
    /// Announces the end of the connection and exits
    Quit,
}

/// Why a line holds no command.
pub(crate) enum Wrong {
    /// The requested help text.
    Help(String),
    /// The error message, in one line.
    Mistake(String),
}

/// Parses a line. Returns `None` for a blank line or a comment.
pub(crate) fn parse(line: &str) -> Result<Option<Entry>, Wrong> {
    let line = line.trim();
    if line.is_empty() || line.starts_with('#') {
        return Ok(None);
    }
    let words =
        shlex::split(line).ok_or_else(|| Wrong::Mistake("missing closing quotation mark".to_owned()))?;
    match CommandLine::try_parse_from(words.into_iter().map(signed)) {
        Ok(CommandLine { entry }) => Ok(Some(entry)),
        Err(error) if !error.use_stderr() => Err(Wrong::Help(error.to_string())),
        Err(error) => Err(Wrong::Mistake(in_one_line(&error.to_string()))),
    }
}

/// Prints clap's explanation of an unknown command, with the usage of `wsg gripper`, and exits with clap's status.
pub(crate) fn explain(word: &str) -> ! {
    let mut wsg = crate::command();
    wsg.build();
    let mut error = Error::new(ErrorKind::InvalidSubcommand);
    if let Some(gripper) = wsg.find_subcommand_mut("gripper") {
        error = error.with_cmd(gripper);
        error.insert(ContextKind::Usage, ContextValue::StyledStr(gripper.render_usage()));
    }
    error.insert(ContextKind::InvalidSubcommand, ContextValue::String(word.to_owned()));
    suggest(error, &wsg, &["gripper"]).exit()
}

/// Joins clap's error message into one line and removes the usage.
fn in_one_line(text: &str) -> String {
    let lines = text.lines().take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let lines = lines.map(str::trim).filter(|line| !line.is_empty());
    one_line(lines.collect::<Vec<_>>().join(" ").trim_start_matches("error: ")).into_owned()
}

/// A script: its file name, and its commands with their line numbers.
pub(crate) struct Script {
    file: String,
    lines: Vec<(usize, Entry)>,
}

impl Script {
    /// Reads and checks a whole script; `-` is standard input.
    ///
    /// # Errors
    /// The file cannot be read, or has invalid lines, all of which are listed.
    pub(crate) fn read(path: &Path) -> Result<Self, Trouble> {
        let file = one_line(&path.display().to_string()).into_owned();
        let text = if file == "-" {
            let mut bytes = Vec::new();
            io::stdin().read_to_end(&mut bytes).and_then(|_| text::decoded(bytes))
        } else {
            text::read(path)
        };
        let text = text.map_err(|error| io::Error::new(error.kind(), format!("{file}: {error}")))?;
        let mut lines = Vec::new();
        let mut mistakes = Vec::new();
        for (number, line) in (1..).zip(text.lines()) {
            match parse(line) {
                Ok(entry) => lines.extend(entry.map(|entry| (number, entry))),
                Err(Wrong::Mistake(mistake)) => mistakes.push(format!("{file}:{number}: {mistake}")),
                Err(Wrong::Help(_)) => {
                    mistakes.push(format!("{file}:{number}: `--help` is not allowed in a script"))
                }
            }
        }
        if mistakes.is_empty() { Ok(Self { file, lines }) } else { Err(Trouble::Usage(mistakes.join("\n"))) }
    }

    /// Runs the commands up to the first that fails, and returns the exit status. A grip without a part counts as failed.
    pub(crate) fn run<P: ProtocolCommands>(
        &self,
        gripper: &mut Gripper<P>,
        output: &Output,
    ) -> Result<u8, Trouble> {
        for (number, entry) in &self.lines {
            let Entry::Action(Named { name, action }) = entry else { break };
            let place = Some((*number, self.file.as_str()));
            let result = run::carry_out(gripper, action, &mut |_| Ok(()));
            let result = match result {
                Err(trouble) if trouble.is_final() => return Err(trouble),
                Ok(Answer { outcome: Outcome::NoPart, .. }) if !output.is_json => Err(Trouble::NoPart),
                result => result,
            };
            let status = output.report(name, &result, place)?;
            if status != 0 {
                return Ok(status);
            }
        }
        Ok(0)
    }
}
