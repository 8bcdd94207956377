//! `wsg bridge`: the service tool of the bridge, over its service port (docs/commissioning.md), or of a gateway. It never moves the
//! fingers.

mod change;
pub(crate) mod client;
mod flash;
pub(crate) mod gateway_reports;
pub(crate) mod names;
pub(crate) mod settings_file;
pub(crate) mod sign;
mod state;
mod strays;
mod update;

use std::fs;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use crossterm::event::{self, Event, KeyCode, KeyModifiers};
use crossterm::terminal;
use wsg_bridge_fw::Config;
use wsg_bridge_fw::registers::{Record, StoreCommand};
use wsg_fieldbus::{GripperFlags, InputImage};
use wsg_protocol::SystemFlags;
use wsg_sim::text::{self, one_line};

use crate::print_error;

use self::client::{Client, GatewayAddress};
pub(crate) use self::state::State;

/// Monitors and configures a bridge over its service port (the USB connector of its board), or a gateway; never moves the fingers
#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Serial port, such as /dev/ttyACM0 or COM3, or tcp://HOST[:502][?unit=1] of a gateway; not for keygen and sign
    port: Option<String>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Shows the status of bridge and gripper and the settings, or registers by name with their meaning
    Show {
        /// Settings or reports to show, such as RECIPE0_WIDTH or LINE_CHECKSUM
        names: Vec<String>,
        /// Show reports as well
        #[arg(long)]
        all: bool,
        /// Print everything as JSON, with raw register values
        #[arg(long, conflicts_with = "names")]
        json: bool,
    },
    /// Changes settings until power-off; `save` or --save makes the changes permanent
    Set {
        /// One or more pairs of NAME and VALUE. A value is a raw register value, a number with a unit such as 20.00mm, or
        /// a choice such as CANopen
        #[arg(required = true, num_args = 2.., value_names = ["NAME", "VALUE"])]
        changes: Vec<String>,
        /// Store the settings as well
        #[arg(long)]
        save: bool,
    },
    /// Shows the recipes as a table
    Recipes,
    /// Stores the settings, so that they remain after power-off
    Save,
    /// Reverts to the stored settings
    Restore,
    /// Resets all settings to their defaults and stores them
    Defaults {
        /// Reset without asking for confirmation
        #[arg(long, short)]
        yes: bool,
    },
    /// Shows recent events with cause and remedy
    Events {
        /// Print the events as JSON
        #[arg(long)]
        json: bool,
    },
    /// Shows status and events continuously, until q or Ctrl-C
    Watch {
        /// Refresh interval in ms
        #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u64).range(50..=60_000))]
        every: u64,
        /// Exit after this number of refreshes
        #[arg(long, value_name = "COUNT")]
        times: Option<u64>,
    },
    /// Writes all settings to a file; `-` is standard output
    Export {
        /// File to write, by convention NAME.toml; an existing file is overwritten
        file: PathBuf,
    },
    /// Applies the settings in a file: all of them or none
    Import {
        /// File written by `export`, or a part of one
        file: PathBuf,
        /// Show what would change without writing
        #[arg(long)]
        dry_run: bool,
        /// Store the settings as well
        #[arg(long, conflicts_with = "dry_run")]
        save: bool,
    },
    /// Writes a firmware image to the board
    Flash(flash::Arguments),
    /// Updates the firmware over the service port with a signed image; the gripper enters FAST STOP, and the bridge restarts
    Update(update::Arguments),
    /// Generates a key for signing images: FILE, which must be kept secret, and FILE.pub
    Keygen {
        /// File to write; an existing file is kept
        file: PathBuf,
    },
    /// Signs a firmware image for an update in the field
    Sign(sign::Arguments),
}

/// Reminder after a change that was not stored.
const NOT_STORED: &str = "in effect until power-off; run `save` to keep the changes";

pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let mut output = io::stdout().lock();
    let done = match (&arguments.command, &arguments.port) {
        (Command::Keygen { file }, None) => sign::generate_key(file, &mut output),
        (Command::Sign(arguments), None) => sign::sign(arguments, &mut output),
        (Command::Keygen { .. } | Command::Sign(_), Some(port)) => {
            bail!("keygen and sign have no PORT; remove {port}")
        }
        (command, Some(port)) => carry_out(port, command, &mut output),
        (_, None) => bail!("missing PORT, such as /dev/ttyACM0; run `wsg bridge --help`"),
    };
    match done {
        // The reader closed the pipe, for example `head`.
        Err(error)
            if error.downcast_ref::<io::Error>().is_some_and(|it| it.kind() == io::ErrorKind::BrokenPipe) => {
        }
        done => done?,
    }
    Ok(0)
}

fn carry_out(port: &str, command: &Command, output: &mut impl Write) -> Result<()> {
    if let Command::Flash(arguments) = command {
        return write_image(port, arguments, output);
    }
    if let Command::Update(arguments) = command {
        return update::run(port, arguments, output);
    }
    // Read the file before opening the port, so that an unreadable file never accesses the bridge.
    let file_text = match command {
        Command::Import { file, .. } => {
            text::read(file).with_context(|| format!("cannot read {}", file.display()))?
        }
        _ => String::new(),
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
                let [name, value] = change else { bail!("missing value for {}", change.concat()) };
                let (place, setting) = names::setting(name)?;
                if let Some(slot) = new.get_mut(place) {
                    *slot = names::value(setting, value)?;
                }
            }
            Config::from_record(&new).context("invalid configuration")?;
            change(&mut client, &old, &new, *save, output)?;
        }
        Command::Recipes => write!(output, "{}", read(&mut client)?.recipes())?,
        Command::Save => save_settings(&mut client, output)?,
        Command::Restore => replace_settings(&mut client, StoreCommand::Restore, output)?,
        Command::Defaults { yes } => {
            confirm("Reset all settings to their defaults and store them", *yes)?;
            replace_settings(&mut client, StoreCommand::Defaults, output)?;
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
                fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))?;
            }
        }
        Command::Import { file, dry_run, save } => {
            let old = client.settings()?;
            let new =
                settings_file::imported(&file_text, &old).with_context(|| file.display().to_string())?;
            if *dry_run {
                write_changes(&old, &new, output)?;
            } else {
                change(&mut client, &old, &new, *save, output)?;
            }
        }
        Command::Flash(_) | Command::Update(_) | Command::Keygen { .. } | Command::Sign(_) => {}
    }
    Ok(())
}

/// Reads a gateway at `HOST:PORT`: its bridge, and the registers of its reports on itself.
pub(crate) fn read_gateway(gateway: &GatewayAddress) -> Result<(State, Vec<u16>)> {
    let mut client = Client::open(&format!("tcp://{gateway}"))?;
    let reports = client.gateway_reports().context("it has no reports of a gateway of this release")?;
    Ok((read(&mut client)?, reports))
}

fn read(client: &mut Client) -> Result<State> {
    Ok(State { settings: client.settings()?, reports: client.reports()?, image: client.image()? })
}

/// Prints the changes, writes them, and stores them if `save` is set.
fn change(
    client: &mut Client,
    old: &Record,
    new: &Record,
    save: bool,
    output: &mut impl Write,
) -> Result<()> {
    write_changes(old, new, output)?;
    change::write(client, old, new)?;
    if save {
        save_settings(client, output)?;
    } else if old != new {
        writeln!(output, "{NOT_STORED}")?;
    }
    Ok(())
}

fn save_settings(client: &mut Client, output: &mut impl Write) -> Result<()> {
    client.command(StoreCommand::Save)?;
    Ok(writeln!(output, "stored")?)
}

/// Executes RESTORE or DEFAULTS and prints the changes.
fn replace_settings(client: &mut Client, command: StoreCommand, output: &mut impl Write) -> Result<()> {
    let old = client.settings()?;
    client.command(command)?;
    write_changes(&old, &client.settings()?, output)
}

fn write_changes(old: &Record, new: &Record, output: &mut impl Write) -> Result<()> {
    let described = change::described(old, new);
    write!(output, "{}", if described.is_empty() { "no changes\n" } else { &described })?;
    Ok(output.flush()?)
}

/// Asks for confirmation on the terminal, unless `yes` is set.
fn confirm(question: &str, yes: bool) -> Result<()> {
    if yes {
        return Ok(());
    }
    if !io::stdin().is_terminal() {
        bail!("confirmation requires a terminal; pass --yes to skip it");
    }
    eprint!("{}? [y/N] ", one_line(question));
    let mut answer = String::new();
    io::stdin().read_line(&mut answer).context("cannot read the answer")?;
    if !matches!(answer.trim().to_ascii_lowercase().as_str(), "y" | "yes") {
        bail!("cancelled; nothing was changed");
    }
    Ok(())
}

/// Flashes an image, unless the fingers are known to be moving.
fn write_image(port: &str, arguments: &flash::Arguments, output: &mut impl Write) -> Result<()> {
    let plan = flash::Plan::new(arguments)?;
    require_rest(Client::open(port).and_then(|mut client| Ok(client.image()?)), "flash")?;
    confirm(&plan.question, arguments.yes)?;
    plan.run()?;
    writeln!(output, "written; the board restarts with the new firmware")?;
    Ok(())
}

/// Rejects a restart while the fingers are known to be moving. `action` is the command to repeat.
fn require_rest(image: Result<Option<InputImage>>, action: &str) -> Result<()> {
    let moving = GripperFlags::GRIPPING | GripperFlags::RELEASING | GripperFlags::POSITIONING;
    match image {
        Ok(Some(image)) if image.state.intersects(moving) || image.system.contains(SystemFlags::MOVING) => {
            bail!("the fingers are moving; {action} again when they are at rest");
        }
        Ok(Some(image)) if image.state.contains(GripperFlags::HOLDING) => {
            print_error("warning: a part is held; the PLC cannot monitor it while the bridge restarts");
        }
        Ok(_) => {}
        Err(error) => {
            print_error(format_args!("warning: cannot determine whether the fingers are moving: {error:#}"))
        }
    }
    Ok(())
}

/// Shows the state periodically: in place on a terminal, otherwise one after the other.
fn watch(client: &mut Client, every: Duration, times: Option<u64>, output: &mut impl Write) -> Result<()> {
    let on_terminal = io::stdout().is_terminal() && io::stdin().is_terminal();
    let _raw = on_terminal.then(RawMode::begin).transpose()?;
    for _ in 0..times.unwrap_or(u64::MAX) {
        let text = match read(client) {
            Ok(state) => state.summary() + "\n" + &state.events_words(),
            Err(error) => one_line(&format!("{error:#}")).into_owned() + "\n",
        };
        if on_terminal {
            let (columns, rows) = terminal::size().ok().filter(|size| *size != (0, 0)).unwrap_or((80, 24));
            let lines = text.lines().take(usize::from(rows.saturating_sub(2)));
            let shown: String = lines
                .map(|line| format!("{}\x1b[K\r\n", line.chars().take(columns.into()).collect::<String>()))
                .collect();
            // Overwrite from the upper left corner and clear the rest.
            write!(output, "\x1b[H{shown}\x1b[Jq: quit")?;
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

/// Waits for this time, or until q, Esc or Ctrl-C is pressed. Returns whether one was.
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

/// Puts the terminal in raw mode on the alternate screen. Dropping it restores the terminal.
struct RawMode;

impl RawMode {
    fn begin() -> Result<Self> {
        terminal::enable_raw_mode().context("cannot switch the terminal to raw mode")?;
        print!("\x1b[?1049h\x1b[?25l\x1b[2J");
        Ok(Self)
    }
}

impl Drop for RawMode {
    fn drop(&mut self) {
        // An error cannot be reported from here.
        let _ = terminal::disable_raw_mode();
        print!("\x1b[?25h\x1b[?1049l");
        let _ = io::stdout().flush();
    }
}
