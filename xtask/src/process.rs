//! Running other programs: what is run is printed first, and a failure is one line.

use std::{
    ffi::OsStr,
    path::Path,
    process::{Command, ExitStatus, Stdio},
};

use anyhow::{Context, Result, bail};

/// Prints the command, runs it, and fails unless it succeeds.
pub(crate) fn run(command: &mut Command) -> Result<()> {
    let status = run_for_status(command)?;
    if !status.success() {
        bail!("`{}` failed ({status})", gist(command));
    }
    Ok(())
}

/// Prints the command, runs it, and hands back how it ended.
pub(crate) fn run_for_status(command: &mut Command) -> Result<ExitStatus> {
    eprintln!("+ {}", shell_line(command));
    command.status().with_context(|| format!("cannot run `{}`", gist(command)))
}

/// Prints the command, runs it, and gives what it put on its standard output; fails unless it succeeds.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    eprintln!("+ {}", shell_line(command));
    let output = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output();
    let output = output.with_context(|| format!("cannot run `{}`", gist(command)))?;
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        bail!("`{}` failed ({}): {}", gist(command), output.status, said.trim());
    }
    Ok(said)
}

/// What a question to a program (never printed) put on its standard output; `None` where the program
/// is missing or refuses.
pub(crate) fn answer(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether there is such a program, one that knows `--version` or at least ends on it.
pub(crate) fn exists(program: &str) -> bool {
    let mut version = Command::new(program);
    version.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// The command as a person would type it, with the environment variables that it sets.
pub(crate) fn shell_line(command: &Command) -> String {
    let mut words = Vec::new();
    for (name, value) in command.get_envs() {
        if let Some(value) = value {
            words.push(format!("{}={}", name.to_string_lossy(), quoted(value)));
        }
    }
    words.push(quoted(command.get_program()));
    words.extend(command.get_args().map(quoted));
    words.join(" ")
}

/// Enough to recognise the command by, which is printed in full above: what comes before its first option.
fn gist(command: &Command) -> String {
    let program = Path::new(command.get_program()).file_name().unwrap_or(command.get_program());
    let mut words = vec![program.to_string_lossy().into_owned()];
    for argument in command.get_args() {
        if argument.to_string_lossy().starts_with('-') {
            words.push("...".to_owned());
            break;
        }
        words.push(quoted(argument));
    }
    words.join(" ")
}

/// One shell word: in single quotes where the shell would read more into it than the text.
pub(crate) fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.into_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_line_can_be_typed_again() {
        let mut command = Command::new("apt-get");
        command.env("DEBIAN_FRONTEND", "noninteractive").args(["install", "it's", "", "a b"]);

        assert_eq!(
            shell_line(&command),
            r"DEBIAN_FRONTEND=noninteractive apt-get install 'it'\''s' '' 'a b'"
        );
    }

    #[test]
    fn a_failure_names_the_command_without_its_options() {
        let error = run(Command::new("/bin/sh").args(["-c", "exit 3"])).unwrap_err();

        assert_eq!(error.to_string(), "`sh ...` failed (exit status: 3)");
        let mut rustup = Command::new("rustup");
        assert_eq!(gist(rustup.args(["target", "add", "thumb"])), "rustup target add thumb");
    }

    #[test]
    fn a_missing_program_has_no_answer() {
        assert_eq!(answer(&mut Command::new("no-such-program-of-this-name")), None);
    }
}
