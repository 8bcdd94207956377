//! `wsg bridge`: the service tool of the bridge, over its service port (docs/tool-bridge.md). It moves nothing.

mod change;
mod client;
mod flash;
mod names;
mod settings_file;
mod state;

use std::fs;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use crossterm::event::{self, Event, KeyCode, KeyModifiers};
use crossterm::terminal;
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{Record, StoreCommand};
use wsg_fieldbus::GripperFlags;
use wsg_protocol::SystemFlags;

use self::client::Client;
use self::state::State;

/// Looks at a bridge and sets it up, over its service port (the USB cable of the ST-Link). It moves nothing.
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// The serial port: /dev/ttyACM0, COM3
    port: String,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// How bridge and gripper are, and the settings; or registers by name, with what they mean
    Show {
        /// Settings or reports, as RECIPE0_WIDTH or LINE_CHECKSUM
        names: Vec<String>,
        /// Reports, too
        #[arg(long)]
        all: bool,
        /// Everything as JSON, values as the registers have them
        #[arg(long, conflicts_with = "names")]
        json: bool,
    },
    /// Changes settings; they last only with `save`
    Set {
        /// NAME VALUE, again and again: the register's number, a number with unit as 20.00mm, or a choice as CANopen
        #[arg(required = true, num_args = 2.., value_names = ["NAME", "VALUE"])]
        changes: Vec<String>,
        /// Stores the settings as well
        #[arg(long)]
        save: bool,
    },
    /// The recipes as a table
    Recipes,
    /// Stores the settings: they count after the next power-up, too
    Save,
    /// Takes the stored settings again
    Restore,
    /// Takes the settings that the image was delivered with, and stores them
    Defaults {
        /// Without asking
        #[arg(long, short)]
        yes: bool,
    },
    /// What happened, why, and what to do
    Events {
        /// As JSON
        #[arg(long)]
        json: bool,
    },
    /// How bridge and gripper are, again and again, until q or Ctrl-C
    Watch {
        /// How often, in ms
        #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u64).range(50..=60_000))]
        every: u64,
        /// Ends after so many times
        #[arg(long, value_name = "COUNT")]
        times: Option<u64>,
    },
    /// Writes all settings to a file; `-` is standard output
    Export {
        /// A file that is written anew, by convention NAME.toml
        file: PathBuf,
    },
    /// Makes the settings of a file the bridge's: all of them, or none
    Import {
        /// A file as `export` writes it, or a part of one
        file: PathBuf,
        /// Says what would change, and writes nothing
        #[arg(long)]
        dry_run: bool,
        /// Stores the settings as well
        #[arg(long, conflicts_with = "dry_run")]
        save: bool,
    },
    /// Writes an image to the board
    Flash(flash::Arguments),
}

/// Says that changed settings are not stored.
const NOT_STORED: &str = "in force until the next power-off; `save` makes it last";

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let mut output = io::stdout().lock();
    let port = &arguments.port;
    match carry_out(port, &arguments.command, &mut output) {
        // Whoever reads has seen enough.
        Err(error)
            if error.downcast_ref::<io::Error>().is_some_and(|it| it.kind() == io::ErrorKind::BrokenPipe) => {
        }
        done => done?,
    }
    Ok(ExitCode::SUCCESS)
}

fn carry_out(port: &str, command: &Command, output: &mut impl Write) -> Result<()> {
    if let Command::Flash(arguments) = command {
        return write_image(port, arguments, output);
    }
    // Before the bridge is asked for anything: a file that cannot be read is no matter of its port.
    let file_text = match command {
        Command::Import { file, .. } => {
            Some(fs::read_to_string(file).with_context(|| format!("{} cannot be read", file.display()))?)
        }
        _ => None,
    };
    let mut client = Client::open(port)?;
    match command {
        Command::Show { names, all, json } => {
            let state = read(&mut client)?;
            if *json {
                writeln!(output, "{:#}", state.json())?;
            } else if names.is_empty() {
                write!(output, "{}\n{}", state.summary(), state.registers(*all))?;
            } else {
                for name in names {
                    write!(output, "{}", state.named(name)?)?;
                }
            }
        }
        Command::Set { changes, save } => {
            let old = client.settings()?;
            let mut new = old;
            for change in changes.chunks(2) {
                let [name, value] = change else { bail!("{} has no value", change.concat()) };
                let (place, setting) = names::setting(name)?;
                if let Some(slot) = new.get_mut(place) {
                    *slot = names::value(setting, value)?;
                }
            }
            Config::from_record(&new).context("beside the other settings it does not fit")?;
            change(&mut client, &old, &new, *save, output)?;
        }
        Command::Recipes => write!(output, "{}", read(&mut client)?.recipes())?,
        Command::Save => {
            client.command(StoreCommand::Save)?;
            writeln!(output, "stored")?;
        }
        Command::Restore => {
            let old = client.settings()?;
            client.command(StoreCommand::Restore)?;
            told_changes(&old, &client.settings()?, output)?;
        }
        Command::Defaults { yes } => {
            confirm("Take the settings that the image was delivered with, and store them", *yes)?;
            let old = client.settings()?;
            client.command(StoreCommand::Defaults)?;
            told_changes(&old, &client.settings()?, output)?;
            writeln!(output, "stored")?;
        }
        Command::Events { json } => {
            let state = read(&mut client)?;
            if *json {
                writeln!(output, "{:#}", state.events_json())?;
            } else {
                write!(output, "{}", state.events_words())?;
            }
        }
        Command::Watch { every, times } => watch(&mut client, Duration::from_millis(*every), *times, output)?,
        Command::Export { file } => {
            let text = settings_file::exported(&client.settings()?, &client.firmware()?);
            if file.as_os_str() == "-" {
                write!(output, "{text}")?;
            } else {
                fs::write(file, text).with_context(|| format!("{} cannot be written", file.display()))?;
            }
        }
        Command::Import { file, dry_run, save } => {
            let old = client.settings()?;
            let text = file_text.as_deref().unwrap_or_default();
            let new = settings_file::imported(text, &old).with_context(|| file.display().to_string())?;
            if *dry_run {
                told_changes(&old, &new, output)?;
            } else {
                change(&mut client, &old, &new, *save, output)?;
            }
        }
        Command::Flash(_) => {}
    }
    Ok(())
}

fn read(client: &mut Client) -> Result<State> {
    Ok(State { settings: client.settings()?, reports: client.reports()?, image: client.image()? })
}

/// Says each change, writes them, and stores them if that was asked for.
fn change(
    client: &mut Client,
    old: &Record,
    new: &Record,
    save: bool,
    output: &mut impl Write,
) -> Result<()> {
    told_changes(old, new, output)?;
    change::write(client, old, new)?;
    if save {
        client.command(StoreCommand::Save)?;
        writeln!(output, "stored")?;
    } else if old != new {
        writeln!(output, "{NOT_STORED}")?;
    }
    Ok(())
}

fn told_changes(old: &Record, new: &Record, output: &mut impl Write) -> Result<()> {
    let described = change::described(old, new);
    write!(output, "{}", if described.is_empty() { "nothing changes\n" } else { &described })?;
    Ok(output.flush()?)
}

/// Asks, where somebody is there to answer.
fn confirm(question: &str, yes: bool) -> Result<()> {
    if yes {
        return Ok(());
    }
    if !io::stdin().is_terminal() {
        bail!("this is asked for on a terminal; --yes does it without");
    }
    eprint!("{question}? [y/N] ");
    let mut answer = String::new();
    io::stdin().read_line(&mut answer).context("no answer can be read")?;
    if !matches!(answer.trim().to_ascii_lowercase().as_str(), "y" | "yes") {
        bail!("nothing was done");
    }
    Ok(())
}

/// Flashes an image, unless the fingers are known to travel.
fn write_image(port: &str, arguments: &flash::Arguments, output: &mut impl Write) -> Result<()> {
    let plan = flash::Plan::new(arguments)?;
    let image = Client::open(port).and_then(|mut client| Ok(client.image()?));
    let moving = GripperFlags::GRIPPING | GripperFlags::RELEASING | GripperFlags::POSITIONING;
    match image {
        Ok(Some(image)) if image.state.intersects(moving) || image.system.contains(SystemFlags::MOVING) => {
            bail!("the fingers move: nothing is flashed before they stand");
        }
        Ok(Some(image)) if image.state.contains(GripperFlags::HOLDING) => {
            eprintln!("wsg: a part is held; while the bridge starts anew its PLC does not see it");
        }
        Ok(_) => {}
        Err(error) => eprintln!("wsg: whether the fingers move is unknown: {error:#}"),
    }
    confirm(&plan.question, arguments.yes)?;
    plan.run()?;
    writeln!(output, "written; the board starts with it")?;
    Ok(())
}

/// Shows the state again and again: on a terminal in place, else one below the other.
fn watch(client: &mut Client, every: Duration, times: Option<u64>, output: &mut impl Write) -> Result<()> {
    let on_terminal = io::stdout().is_terminal() && io::stdin().is_terminal();
    let _raw = on_terminal.then(RawMode::begin).transpose()?;
    for _ in 0..times.unwrap_or(u64::MAX) {
        let text = match read(client) {
            Ok(state) => state.summary() + "\n" + &state.events_words(),
            Err(error) => format!("{error:#}\n"),
        };
        if on_terminal {
            let (columns, rows) = terminal::size().ok().filter(|size| *size != (0, 0)).unwrap_or((80, 24));
            let lines = text.lines().take(usize::from(rows.saturating_sub(2)));
            let shown: String = lines
                .map(|line| format!("{}\x1b[K\r\n", line.chars().take(columns.into()).collect::<String>()))
                .collect();
            // From the upper left corner on; what was below is cleared.
            write!(output, "\x1b[H{shown}\x1b[Jq ends it")?;
        } else {
            writeln!(output, "{text}")?;
        }
        output.flush()?;
        if on_terminal {
            if is_quit_within(every)? {
                break;
            }
        } else if times.is_none_or(|times| times > 1) {
            std::thread::sleep(every);
        }
    }
    Ok(())
}

/// Waits; whether somebody presses q, Esc or Ctrl-C meanwhile.
fn is_quit_within(time: Duration) -> Result<bool> {
    let end = std::time::Instant::now() + time;
    while event::poll(end.saturating_duration_since(std::time::Instant::now()))? {
        if let Event::Key(key) = event::read()? {
            let is_interrupt =
                key.code == KeyCode::Char('c') && key.modifiers.contains(KeyModifiers::CONTROL);
            if is_interrupt || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc) {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// A terminal whose keys come at once, on a screen of its own. It is as it was when this is dropped.
struct RawMode;

impl RawMode {
    fn begin() -> Result<Self> {
        terminal::enable_raw_mode().context("the terminal cannot be used")?;
        print!("\x1b[?1049h\x1b[?25l\x1b[2J");
        Ok(Self)
    }
}

impl Drop for RawMode {
    fn drop(&mut self) {
        // It is left in any case.
        let _ = terminal::disable_raw_mode();
        print!("\x1b[?25h\x1b[?1049l");
        let _ = io::stdout().flush();
    }
}
