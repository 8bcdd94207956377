//! Running other programs. Each command is printed first, and a failure is reported in one line.

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

/// Prints the command, runs it, and returns its exit status.
pub(crate) fn run_for_status(command: &mut Command) -> Result<ExitStatus> {
    eprintln!("+ {}", shell_line(command));
    command.status().with_context(|| format!("cannot run `{}`", gist(command)))
}

/// Prints the command, runs it, and returns its standard output. Fails unless it succeeds.
pub(crate) fn output(command: &mut Command) -> Result<String> {
    eprintln!("+ {}", shell_line(command));
    let output = command.stdin(Stdio::null()).stderr(Stdio::inherit()).output();
    let output = output.with_context(|| format!("cannot run `{}`", gist(command)))?;
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        bail!("`{}` failed ({}): {}", gist(command), output.status, printed.trim());
    }
    Ok(printed)
}

/// Runs a command without printing it, and returns its standard output. Returns `None` if the program is missing or fails.
pub(crate) fn answer(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Returns whether a program exists. It must exit when called with `--version`.
pub(crate) fn exists(program: &str) -> bool {
    let mut version = Command::new(program);
    version.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// Formats the command as shell input, with the environment variables that it sets.
pub(crate) fn shell_line(command: &Command) -> String {
    let set = command.get_envs().filter_map(|(name, value)| Some((name, value?)));
    let set = set.map(|(name, value)| format!("{}={}", name.to_string_lossy(), quoted(value)));
    let words = [command.get_program()].into_iter().chain(command.get_args()).map(quoted);
    set.chain(words).collect::<Vec<_>>().join(" ")
}

/// Abbreviates a command, which has already been printed in full, to the words before its first option.
fn gist(command: &Command) -> String {
    let program = Path::new(command.get_program()).file_name().unwrap_or(command.get_program());
    let arguments = command.get_args().take_while(|argument| !argument.to_string_lossy().starts_with('-'));
    let words: Vec<_> = [program].into_iter().chain(arguments).map(quoted).collect();
    words.join(" ") + if words.len() <= command.get_args().len() { " ..." } else { "" }
}

/// Formats a shell word, in quotes if necessary.
fn quoted(word: &OsStr) -> String {
    let word = word.to_string_lossy();
    // A null character, which cannot be quoted, would also prevent the program from starting.
    shlex::try_quote(&word).unwrap_or_default().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_line_can_be_typed_again() {
        let mut command = Command::new("apt-get");
        command.env("DEBIAN_FRONTEND", "noninteractive").args(["install", "it's", "", "a b"]);

        assert_eq!(shell_line(&command), r#"DEBIAN_FRONTEND=noninteractive apt-get install "it's" '' 'a b'"#);
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
