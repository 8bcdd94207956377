//! The prompt: a line with the gripper's state, and the input line below it.

use std::io::{self, BufRead, IsTerminal, Write};
use std::sync::mpsc::{self, TryRecvError};
use std::thread;
use std::time::Duration;

use clap::{Command, CommandFactory};
use crossterm::cursor::{MoveToColumn, MoveUp};
use crossterm::event::{self, Event};
use crossterm::style::Print;
use crossterm::terminal::{self, Clear, ClearType};
use crossterm::{execute, queue};
use wsg_protocol::session::Known;
use wsg_sim::text;

use super::action::{Action, Named};
use super::editor::{Complete, Editor, Step};
use super::line::LOOK_MS;
use super::lines::{self, CommandLine, Entry, Wrong};
use super::output::Output;
use super::run::{self, Gripper, ProtocolCommands};
use super::signals::Signals;
use super::trouble::Trouble;

/// Shortest interval between two updates of a value, in ms.
const STATE_PERIOD_MS: u16 = 100;
const PROMPT: &str = "> ";

/// Runs commands until the input ends, and returns the exit status of the last one. Input is interactive on a terminal.
pub(crate) fn run<P: ProtocolCommands>(
    gripper: &mut Gripper<P>,
    output: &Output,
    signals: &Signals,
) -> Result<u8, Trouble> {
    if io::stdin().is_terminal() && io::stdout().is_terminal() {
        typed(gripper, output, signals)
    } else {
        piped(gripper, output)
    }
}

fn typed<P: ProtocolCommands>(
    gripper: &mut Gripper<P>,
    output: &Output,
    signals: &Signals,
) -> Result<u8, Trouble> {
    let words = Words(CommandLine::command());
    let mut editor = Editor::default();
    let mut status = 0;
    run::subscribe(gripper, STATE_PERIOD_MS);
    while let Some(line) = read_line(gripper, &mut editor, &words)? {
        let named = match lines::parse(&line) {
            Ok(None) => continue,
            Ok(Some(Entry::Quit)) => break,
            Ok(Some(Entry::Action(named))) => named,
            Err(Wrong::Help(text) | Wrong::Mistake(text)) => {
                writeln!(io::stdout(), "{}", text.trim_end())?;
                continue;
            }
        };
        let mut shown = String::new();
        let mut live = |known: &Known| show_state(known, &mut shown);
        let mut result = run::carry_out(gripper, &named.action, &mut live);
        erase_state()?;
        if matches!(result, Err(Trouble::Caught(_))) && signals.forget_interrupt() {
            // Ctrl-C stops the fingers and returns to the prompt.
            signals.heed(false);
            let stopped = if run::is_motion(&named.action) { gripper.stop() } else { Ok(()) };
            signals.heed(true);
            stopped?;
            writeln!(io::stdout(), "stopped")?;
            status = 130;
            continue;
        }
        if let Err(trouble) = &mut result
            && trouble.is_final()
        {
            return Err(std::mem::replace(trouble, Trouble::NoPart));
        }
        status = output.report(&named.name, &result, None)?;
        if matches!(named.action, Action::Disconnect) {
            return Ok(status);
        }
    }
    run::unsubscribe(gripper);
    Ok(status)
}

/// Runs commands from a pipe or file. Each is answered before the next one is executed, and errors do not end the input.
fn piped<P: ProtocolCommands>(gripper: &mut Gripper<P>, output: &Output) -> Result<u8, Trouble> {
    let (sender, receiver) = mpsc::channel();
    // A thread of its own, so that the gripper is polled meanwhile. It runs until the process ends, because nothing
    // interrupts a blocked read.
    thread::spawn(move || {
        // Each line may begin with a byte order mark: programs can append files to each other.
        for line in io::stdin().lock().split(b'\n') {
            if sender.send(line.and_then(text::decoded)).is_err() {
                break;
            }
        }
    });
    let mut status = 0;
    loop {
        let line = match receiver.try_recv() {
            Ok(line) => {
                line.map_err(|error| io::Error::new(error.kind(), format!("standard input: {error}")))?
            }
            Err(TryRecvError::Disconnected) => return Ok(status),
            Err(TryRecvError::Empty) => {
                gripper.next_update(LOOK_MS)?;
                continue;
            }
        };
        let (name, result) = match lines::parse(&line) {
            Ok(None) => continue,
            Ok(Some(Entry::Quit)) => return Ok(status),
            Ok(Some(Entry::Action(Named { action: Action::Disconnect, .. }))) => {
                let result = run::carry_out(gripper, &Action::Disconnect, &mut |_| Ok(()));
                return Ok(output.report("disconnect", &result, None)?);
            }
            Ok(Some(Entry::Action(Named { name, action }))) => {
                let result = run::carry_out(gripper, &action, &mut |_| Ok(()));
                (name, result)
            }
            Err(Wrong::Help(text)) => {
                writeln!(io::stdout(), "{text}")?;
                continue;
            }
            Err(Wrong::Mistake(mistake)) => {
                let name = line.split_whitespace().next().unwrap_or_default().to_owned();
                (name, Err(Trouble::Usage(mistake)))
            }
        };
        match result {
            Err(trouble) if trouble.is_final() => return Err(trouble),
            result => status = output.report(&name, &result, None)?,
        }
    }
}

/// Formats state, width, speed, force and flags as one line.
pub(crate) fn state_line(known: &Known, is_connected: bool) -> String {
    if !is_connected {
        return "no connection".to_owned();
    }
    let number = |value: Option<f32>, digits: usize, unit: &str| match value {
        // Avoid "-0.0".
        Some(value) => format!("{:.digits$} {unit}", if value == 0.0 { 0.0 } else { value }),
        None => format!("? {unit}"),
    };
    let state = known.state.map_or_else(|| "?".to_owned(), |state| state.to_string());
    let flags = known.flags.map(|flags| flags.to_string()).unwrap_or_default();
    format!(
        "[{state}  {}  {}  {}  {flags}]",
        number(known.width, 2, "mm"),
        number(known.speed, 1, "mm/s"),
        number(known.force, 1, "N")
    )
}

/// Overwrites the current line with the state. `shown` is the text shown there now.
fn show_state(known: &Known, shown: &mut String) -> io::Result<()> {
    let state = fitting(&state_line(known, true));
    if state != *shown {
        execute!(io::stdout(), MoveToColumn(0), Clear(ClearType::CurrentLine), Print(&state))?;
        *shown = state;
    }
    Ok(())
}

fn erase_state() -> io::Result<()> {
    execute!(io::stdout(), MoveToColumn(0), Clear(ClearType::CurrentLine))
}

/// Truncates text to one line of the terminal.
fn fitting(text: &str) -> String {
    text.chars().take(columns() - 1).collect()
}

fn columns() -> usize {
    terminal::size().map_or(80, |(columns, _)| usize::from(columns)).max(20)
}

/// Puts the terminal in raw mode, so that each key is delivered at once. Dropping it restores the terminal.
struct RawMode;

impl RawMode {
    fn enter() -> io::Result<Self> {
        terminal::enable_raw_mode()?;
        Ok(Self)
    }
}

impl Drop for RawMode {
    fn drop(&mut self) {
        // An error cannot be reported from here.
        let _ = terminal::disable_raw_mode();
    }
}

/// Reads a line while polling the gripper and showing its state. Returns `None` at the end of the input.
fn read_line<P: ProtocolCommands>(
    gripper: &mut Gripper<P>,
    editor: &mut Editor,
    complete: &impl Complete,
) -> Result<Option<String>, Trouble> {
    let _raw = RawMode::enter()?;
    let mut out = io::stdout();
    let mut view = View::default();
    view.draw(&mut out, editor, &state_line(gripper.known(), gripper.is_connected()))?;
    loop {
        while event::poll(Duration::ZERO)? {
            let Event::Key(key) = event::read()? else { continue };
            match editor.key(key, complete) {
                Step::Typing => {}
                Step::Choices(choices) => {
                    view.erase(&mut out)?;
                    queue!(out, Print(choices.join("  ")), Print("\r\n"))?;
                }
                Step::Discarded => view.erase(&mut out)?,
                Step::Line(line) => {
                    view.erase(&mut out)?;
                    execute!(out, Print(format!("{PROMPT}{line}\r\n")))?;
                    return Ok(Some(line));
                }
                Step::End => {
                    view.erase(&mut out)?;
                    return Ok(None);
                }
            }
        }
        gripper.next_update(LOOK_MS)?;
        view.draw(&mut out, editor, &state_line(gripper.known(), gripper.is_connected()))?;
    }
}

/// The two lines on the screen: the state, and the input with its cursor column.
#[derive(Default)]
struct View {
    shown: Option<(String, String, usize)>,
}

impl View {
    fn draw(&mut self, out: &mut impl Write, editor: &Editor, state: &str) -> io::Result<()> {
        // Show the part of a long line that contains the cursor.
        let room = columns() - PROMPT.len() - 1;
        let from = editor.cursor().saturating_sub(room);
        let text: String = editor.text().chars().skip(from).take(room).collect();
        let next = (fitting(state), text, PROMPT.len() + editor.cursor() - from);
        if self.shown.as_ref() == Some(&next) {
            return Ok(());
        }
        self.erase(out)?;
        let (state, text, column) = &next;
        queue!(out, Print(state), Print("\r\n"), Print(PROMPT), Print(text))?;
        queue!(out, MoveToColumn(*column as u16))?;
        out.flush()?;
        self.shown = Some(next);
        Ok(())
    }

    fn erase(&mut self, out: &mut impl Write) -> io::Result<()> {
        if self.shown.take().is_some() {
            queue!(out, MoveToColumn(0), Clear(ClearType::CurrentLine), MoveUp(1))?;
            queue!(out, Clear(ClearType::CurrentLine))?;
        }
        out.flush()
    }
}

/// Completions from clap's command definition.
struct Words(Command);

impl Complete for Words {
    fn choices(&self, words: &[&str]) -> Vec<String> {
        let Some((name, rest)) = words.split_first() else {
            let mut names: Vec<String> =
                self.0.get_subcommands().map(|command| command.get_name().to_owned()).collect();
            names.push("help".to_owned());
            names.sort();
            return names;
        };
        let Some(command) = self.0.find_subcommand(name) else {
            return if *name == "help" && rest.is_empty() { self.choices(&[]) } else { Vec::new() };
        };
        let position = rest.iter().filter(|word| !word.starts_with("--")).count();
        let values = command.get_positionals().nth(position).into_iter().flat_map(|argument| {
            argument.get_possible_values().into_iter().map(|value| value.get_name().to_owned())
        });
        let flags = command.get_arguments().filter(|argument| !argument.is_positional());
        let flags = flags.filter_map(|argument| Some(format!("--{}", argument.get_long()?)));
        values.chain(flags.filter(|flag| !rest.contains(&flag.as_str()))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_protocol::{GripperState, SystemFlags};

    #[test]
    fn completions_match_the_command_table() {
        let words = Words(CommandLine::command());
        let names = words.choices(&[]);
        for name in ["grip", "fast-stop", "help", "quit"] {
            assert!(names.iter().any(|choice| choice == name), "{names:?}");
        }
        assert_eq!(words.choices(&["grip", "20", "50"]), ["--force"]);
        assert_eq!(words.choices(&["grip", "--force", "40"]), [""; 0]);
        assert_eq!(words.choices(&["home"]), ["default", "positive", "negative"]);
        assert_eq!(words.choices(&["finger-power", "1"]), ["on", "off"]);
        assert_eq!(words.choices(&["dance"]), [""; 0]);
    }

    #[test]
    fn state_line_shows_known_values() {
        let known = Known {
            state: Some(GripperState::Holding),
            width: Some(20.0),
            speed: Some(-0.0),
            flags: Some(SystemFlags::REFERENCED),
            ..Known::NOTHING
        };
        assert_eq!(state_line(&known, true), "[HOLDING  20.00 mm  0.0 mm/s  ? N  REFERENCED]");
        assert_eq!(state_line(&known, false), "no connection");
    }
}
