//! The command table, from which help, completion, prompt, scripts and docs/tool.md are derived.

use clap::builder::{StringValueParser, TypedValueParser};
use clap::{ArgMatches, Command, FromArgMatches, Subcommand, ValueEnum};
use wsg_protocol::driver::{Finger, OnBlock};
use wsg_protocol::{CommandId, HomingDirection, Kind, LoopData, editor};

/// A gripper command with its parameters.
#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Action {
    /// References the fingers at an end stop
    Home {
        /// End stop to reference at
        #[arg(value_enum, default_value_t = End::Default)]
        end: End,
    },
    /// Moves the fingers to an opening width
    Move {
        /// Opening width in mm
        #[arg(value_parser = mm)]
        width: f32,
        /// Finger speed in mm/s
        #[arg(value_parser = mm_per_s)]
        speed: f32,
        /// Clamp on an obstacle with half the nominal force instead of switching off the motor
        #[arg(long)]
        clamp: bool,
    },
    /// Moves the fingers by an offset: positive opens, negative closes
    MoveBy {
        /// Change of the opening width in mm
        #[arg(value_parser = mm)]
        offset: f32,
        /// Finger speed in mm/s
        #[arg(value_parser = mm_per_s)]
        speed: f32,
        /// Clamp on an obstacle with half the nominal force instead of switching off the motor
        #[arg(long)]
        clamp: bool,
    },
    /// Grips a part of a nominal width
    Grip {
        /// Nominal width of the part in mm
        #[arg(value_parser = mm)]
        width: f32,
        /// Gripping speed in mm/s
        #[arg(value_parser = mm_per_s)]
        speed: f32,
        /// Force limit in N, summed over both fingers; set before the grip and kept afterwards
        #[arg(long, value_parser = newton)]
        force: Option<f32>,
    },
    /// Opens the fingers to release a part
    Release {
        /// Opening width in mm
        #[arg(value_parser = mm)]
        width: f32,
        /// Opening speed in mm/s
        #[arg(value_parser = mm_per_s)]
        speed: f32,
    },
    /// Stops the fingers and stops holding a part
    Stop,
    /// Stops the fingers as fast as possible and locks them until `ack`
    FastStop,
    /// Acknowledges a FAST STOP or a fault and unlocks the fingers
    Ack,

    /// Reads or sets the force limit
    ForceLimit {
        /// Force limit in N, summed over both fingers
        #[arg(value_parser = newton)]
        force: Option<f32>,
    },
    /// Reads or sets the acceleration
    Acceleration {
        /// Acceleration of the fingers in mm/s²
        #[arg(value_parser = mm_per_s2)]
        acceleration: Option<f32>,
    },
    /// Reads, sets or clears the soft limits, which restrict the travel of the fingers
    SoftLimits {
        /// Smallest opening width in mm
        #[arg(value_parser = mm, requires = "to", conflicts_with = "clear")]
        from: Option<f32>,
        /// Largest opening width in mm
        #[arg(value_parser = mm)]
        to: Option<f32>,
        /// Remove the soft limits
        #[arg(long)]
        clear: bool,
    },
    /// Enables or disables overdrive, which allows forces up to the overdrive limit
    Overdrive {
        #[arg(value_enum)]
        switch: Switch,
    },
    /// Zeroes the force sensor
    Tare,
    /// Reads the part width tolerance or sets it for this connection; GCL only (GCL, 2.2.5)
    PartWidthTolerance {
        /// How far before the nominal width the fingers may meet the part, in mm
        #[arg(value_parser = mm)]
        tolerance: Option<f32>,
    },
    /// Reads the clamping travel or sets it for this connection; GCL only (GCL, 2.2.6)
    ClampingTravel {
        /// How much further the fingers may travel to build up the gripping force, in mm
        #[arg(value_parser = mm)]
        travel: Option<f32>,
    },

    /// Reads state, width, speed, force and flags together
    Status,
    /// Reads the gripping state
    State,
    /// Reads the system state flags
    Flags,
    /// Reads the opening width
    Width,
    /// Reads the finger speed
    Speed,
    /// Reads the gripping force
    Force,
    /// Reads the device temperature
    Temperature,
    /// Reads the grip counters
    Statistics {
        /// Reset the counters to 0 after reading
        #[arg(long)]
        reset: bool,
    },

    /// Reads device type, versions and serial number
    Info,
    /// Reads the physical limits
    Limits,
    /// Reads or sets the device tag
    Tag {
        /// New tag: up to 64 printable ASCII characters
        #[arg(value_parser = StringValueParser::new().map(|word| hyphenated(&word)))]
        text: Option<String>,
    },

    /// Reads the kind of electronics at a finger's port
    FingerInfo {
        /// Finger: 1 or 2
        #[arg(value_parser = finger)]
        finger: Finger,
    },
    /// Reads the state flags of a finger
    FingerFlags {
        /// Finger: 1 or 2
        #[arg(value_parser = finger)]
        finger: Finger,
    },
    /// Switches a finger's power supply
    FingerPower {
        /// Finger: 1 or 2
        #[arg(value_parser = finger)]
        finger: Finger,
        #[arg(value_enum)]
        switch: Switch,
    },
    /// Reads one data frame from a finger
    FingerData {
        /// Finger: 1 or 2
        #[arg(value_parser = finger)]
        finger: Finger,
    },

    /// Sends bytes that the gripper must echo unchanged
    Loop {
        /// Bytes such as 32 or 0x20, floats such as 150.0f, and texts such as '"text"'
        #[arg(value_parser = values, required = true)]
        bytes: Vec<Bytes>,
    },
    /// Sends any command, such as one defined by a script on the gripper
    Raw {
        /// Command name such as 'Grip Part', or ID such as 0x25 or 37
        #[arg(value_parser = id)]
        id: u8,
        /// Payload: bytes such as 32 or 0x20, floats such as 150.0f, and texts such as '"text"'
        #[arg(value_parser = values)]
        payload: Vec<Bytes>,
    },
    /// Announces the end of the connection, as `wsg` does whenever it exits
    Disconnect,
    /// Waits for a number of seconds
    Pause {
        /// Time to wait in seconds, up to 86400
        #[arg(value_parser = seconds)]
        seconds: f32,
    },
}

/// The commands of the manual that each name stands for.
const OF_THE_MANUAL: &[(&str, &[CommandId])] = &[
    ("home", &[CommandId::Homing]),
    ("move", &[CommandId::PrePosition]),
    ("move-by", &[CommandId::PrePosition]),
    ("grip", &[CommandId::GripPart]),
    ("release", &[CommandId::ReleasePart]),
    ("stop", &[CommandId::Stop]),
    ("fast-stop", &[CommandId::FastStop]),
    ("ack", &[CommandId::Acknowledge]),
    ("force-limit", &[CommandId::GetForceLimit, CommandId::SetForceLimit]),
    ("acceleration", &[CommandId::GetAcceleration, CommandId::SetAcceleration]),
    ("soft-limits", &[CommandId::GetSoftLimits, CommandId::SetSoftLimits, CommandId::ClearSoftLimits]),
    ("overdrive", &[CommandId::OverdriveMode]),
    ("tare", &[CommandId::TareForceSensor]),
    ("state", &[CommandId::GetGripperState]),
    ("flags", &[CommandId::GetSystemState]),
    ("width", &[CommandId::GetOpeningWidth]),
    ("speed", &[CommandId::GetSpeed]),
    ("force", &[CommandId::GetForce]),
    ("temperature", &[CommandId::GetTemperature]),
    ("statistics", &[CommandId::GetGrippingStatistics]),
    ("info", &[CommandId::GetSystemInfo]),
    ("limits", &[CommandId::GetSystemLimits]),
    ("tag", &[CommandId::GetDeviceTag, CommandId::SetDeviceTag]),
    ("finger-info", &[CommandId::GetFinger1Info, CommandId::GetFinger2Info]),
    ("finger-flags", &[CommandId::GetFinger1Flags, CommandId::GetFinger2Flags]),
    ("finger-power", &[CommandId::Finger1Power, CommandId::Finger2Power]),
    ("finger-data", &[CommandId::GetFinger1Data, CommandId::GetFinger2Data]),
    ("loop", &[CommandId::Loop]),
    ("disconnect", &[CommandId::DisconnectAnnouncement]),
];

/// A command, with the name under which it was requested.
#[derive(Clone, Debug)]
pub(crate) struct Named {
    pub(crate) name: String,
    pub(crate) action: Action,
}

impl Named {
    /// Returns whether the command ends motions.
    pub(crate) const fn stops(&self) -> bool {
        matches!(self.action, Action::Stop | Action::FastStop)
    }

    /// Returns whether the fingers may move because of the command: a motion, an acknowledgement, or a command of any kind.
    pub(crate) fn may_move(&self) -> bool {
        let is_raw = matches!(self.action, Action::Raw { .. });
        let of_the_manual = OF_THE_MANUAL.iter().filter(|(name, _)| *name == self.name);
        let mut kinds = of_the_manual.flat_map(|(_, ids)| ids.iter().map(|id| id.kind()));
        is_raw || kinds.any(|kind| matches!(kind, Kind::Motion | Kind::Acknowledge))
    }
}

impl FromArgMatches for Named {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let name = matches.subcommand_name().unwrap_or_default().to_owned();
        Ok(Self { name, action: Action::from_arg_matches(matches)? })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Subcommand for Named {
    /// Appends the manual's section to the help of each command.
    fn augment_subcommands(command: Command) -> Command {
        let command = Action::augment_subcommands(command);
        OF_THE_MANUAL.iter().fold(command, |command, (name, ids)| {
            command.mut_subcommand(name, |of_name| {
                let about = of_name.get_about().map(ToString::to_string).unwrap_or_default();
                let about = format!("{about} ({})", sections(ids));
                of_name.about(about)
            })
        })
    }

    fn augment_subcommands_for_update(command: Command) -> Command {
        Self::augment_subcommands(command)
    }

    fn has_subcommand(name: &str) -> bool {
        Action::has_subcommand(name)
    }
}

/// Lists the manual's sections of these commands: `3.3.3, 3.3.4`.
fn sections(ids: &[CommandId]) -> String {
    let mut sections: Vec<&str> = ids.iter().map(|id| id.section()).collect();
    sections.sort_unstable();
    sections.join(", ")
}

/// The end stop at which homing references the fingers.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum End {
    /// As configured in the gripper
    Default,
    /// Outward: the fingers open
    Positive,
    /// Inward: the fingers close
    Negative,
}

impl From<End> for HomingDirection {
    fn from(end: End) -> Self {
        match end {
            End::Default => Self::Default,
            End::Positive => Self::Positive,
            End::Negative => Self::Negative,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Switch {
    On,
    Off,
}

/// Returns what Pre-position does when an obstacle blocks the fingers.
pub(crate) const fn on_block(clamp: bool) -> OnBlock {
    if clamp { OnBlock::Clamp } else { OnBlock::Stop }
}

/// Replaces the hyphen of a word that begins with a negative number, such as `-5mm`, by a minus sign. The parser of the
/// command line would take the word for an option: it knows only numbers without a unit.
pub(crate) fn signed(word: String) -> String {
    let is_number = |rest: &str| rest.trim_start_matches('.').starts_with(|it: char| it.is_ascii_digit());
    match word.strip_prefix('-').filter(|rest| is_number(rest)) {
        Some(rest) => format!("{MINUS}{rest}"),
        None => word,
    }
}

/// U+2212, which also belongs to numbers copied from a document.
const MINUS: char = '\u{2212}';

/// Returns a word with a hyphen for the sign of [`signed`].
fn hyphenated(word: &str) -> String {
    word.strip_prefix(MINUS).map_or_else(|| word.to_owned(), |rest| format!("-{rest}"))
}

/// Parses a number with or without its unit, of which there may be several spellings.
fn quantity(text: &str, units: &[&str]) -> Result<f32, String> {
    let unit = units.first().copied().unwrap_or_default();
    let text = hyphenated(text.trim());
    let is_of_number = |character: char| character.is_ascii_digit() || "+-.eE".contains(character);
    let (digits, suffix) = text.split_at(text.find(|it| !is_of_number(it)).unwrap_or(text.len()));
    let (number, suffix) = (digits.parse::<f32>().ok().filter(|it| it.is_finite()), suffix.trim_start());
    match number {
        Some(number) if suffix.is_empty() || units.contains(&suffix) => Ok(number),
        Some(_) if suffix.starts_with(char::is_alphabetic) => {
            Err(format!("the unit is {suffix}; expected a number in {unit}"))
        }
        _ => Err(format!("expected a number in {unit}")),
    }
}

fn mm(text: &str) -> Result<f32, String> {
    quantity(text, &["mm"])
}

fn mm_per_s(text: &str) -> Result<f32, String> {
    quantity(text, &["mm/s"])
}

fn mm_per_s2(text: &str) -> Result<f32, String> {
    quantity(text, &["mm/s²", "mm/s2", "mm/s^2"])
}

fn newton(text: &str) -> Result<f32, String> {
    quantity(text, &["N"])
}

fn seconds(text: &str) -> Result<f32, String> {
    let seconds = quantity(text, &["s"])?;
    if (0.0..=86_400.0).contains(&seconds) { Ok(seconds) } else { Err("expected 0 to 86400 s".to_owned()) }
}

fn finger(text: &str) -> Result<Finger, String> {
    match text {
        "1" => Ok(Finger::One),
        "2" => Ok(Finger::Two),
        _ => Err("expected finger 1 or 2".to_owned()),
    }
}

fn id(text: &str) -> Result<u8, String> {
    editor::command_id(text).map(CommandId::code).map_err(|error| error.to_string())
}

/// The bytes of one word of the editor's language.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Bytes(Vec<u8>);

impl Bytes {
    /// Concatenates the bytes of all words.
    pub(crate) fn joined(words: &[Self]) -> Vec<u8> {
        words.iter().flat_map(|word| word.0.iter().copied()).collect()
    }
}

/// Parses one word of a payload.
fn values(text: &str) -> Result<Bytes, String> {
    let mut buffer = [0; LoopData::MAX_LEN];
    let len = editor::payload(&hyphenated(text), &mut buffer).map_err(|error| error.to_string())?;
    Ok(Bytes(buffer[..len].to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_of_the_manual_has_a_name() {
        let table = Action::augment_subcommands(Command::new("gripper"));
        for (name, _) in OF_THE_MANUAL {
            assert!(table.find_subcommand(name).is_some(), "{name}");
        }
        for id in CommandId::ALL {
            let count = OF_THE_MANUAL.iter().filter(|(_, ids)| ids.contains(id)).count();
            let expected = if *id == CommandId::PrePosition { 2 } else { 1 };
            assert_eq!(count, expected, "{id}");
        }
    }

    #[test]
    fn numbers_may_have_their_units_and_another_unit_is_named() {
        assert_eq!((mm("20"), mm("20.5mm"), mm("-3 mm")), (Ok(20.0), Ok(20.5), Ok(-3.0)));
        assert_eq!((newton("40N"), mm_per_s("50mm/s"), seconds("2e-1 s")), (Ok(40.0), Ok(50.0), Ok(0.2)));
        for text in ["9", "9mm/s²", "9 mm/s2", "9mm/s^2"] {
            assert_eq!(mm_per_s2(text), Ok(9.0), "{text}");
        }
        for wrong in ["", "mm", "x", "-", "nan", "inf", "1e39", "20,5", "5mm6"] {
            assert!(mm(wrong).is_err_and(|error| error.ends_with("expected a number in mm")), "{wrong}");
        }
        assert_eq!(mm("20N"), Err("the unit is N; expected a number in mm".to_owned()));
        assert_eq!(mm("20 mm/s"), Err("the unit is mm/s; expected a number in mm".to_owned()));
        assert_eq!(mm_per_s("-5mm"), Err("the unit is mm; expected a number in mm/s".to_owned()));
        assert_eq!(mm_per_s2("9mm/s"), Err("the unit is mm/s; expected a number in mm/s²".to_owned()));
    }

    #[test]
    fn negative_numbers_are_no_options_and_options_are_no_numbers() {
        let parsed = |line: &str| {
            let table = Named::augment_subcommands(Command::new("gripper").no_binary_name(true));
            let words = line.split(' ').map(|word| signed(word.to_owned()));
            let matches = table.try_get_matches_from(words).map_err(|error| error.to_string())?;
            Named::from_arg_matches(&matches).map_err(|error| error.to_string()).map(|named| named.action)
        };
        for line in [
            "move-by -5mm 50",
            "move-by -5 50mm/s",
            "move-by -.5mm 50",
            "move-by --clamp -5mm 50",
            "move-by -5mm 50 --clamp",
            "move -1 100",
            "move -1mm -100mm/s --clamp",
            "grip -20mm -50mm/s --force -1N",
            "grip 20 50 --force=-1",
            "release -1mm -5",
            "force-limit -5N",
            "acceleration -9mm/s2",
            "soft-limits -5 90",
            "soft-limits -5mm -1mm",
            "part-width-tolerance -2mm",
            "clamping-travel -2mm",
            "raw 0xB1 -1.5f 1",
            "tag -5",
        ] {
            assert!(parsed(line).is_ok(), "{line}: {:?}", parsed(line));
        }
        assert!(matches!(parsed("move-by -5mm 50 --clamp"), Ok(Action::MoveBy { clamp: true, .. })));
        assert!(matches!(parsed("move-by --clamp -5mm 50"), Ok(Action::MoveBy { clamp: true, .. })));
        assert!(matches!(parsed("tag -5"), Ok(Action::Tag { text: Some(tag) }) if tag == "-5"));
        for (line, expected) in [
            ("pause -1", "expected 0 to 86400 s"),
            ("move 20 50 -x", "unexpected argument '-x'"),
            ("move -1N 100", "the unit is N; expected a number in mm"),
            ("grip 20 50 --force -1mm", "the unit is mm; expected a number in N"),
            ("move --help", "Moves the fingers"),
            ("move 20 --clap 50", "unexpected argument '--clap'"),
        ] {
            let error = parsed(line).expect_err(line);
            assert!(error.contains(expected), "{line}: {error}");
        }
    }

    #[test]
    fn payloads_and_commands_are_those_of_the_editor() {
        assert_eq!(values("10 0xff"), Ok(Bytes(vec![10, 0xFF])));
        assert_eq!(values("150.0f"), Ok(Bytes(vec![0, 0, 0x16, 0x43])));
        assert_eq!(values("\"a b\""), Ok(Bytes(b"a b".to_vec())));
        for wrong in ["FF", "256", "\u{e4}"] {
            assert!(values(wrong).is_err(), "{wrong}");
        }
        assert_eq!((id("0xB0"), id("176"), id("grip-part")), (Ok(0xB0), Ok(0xB0), Ok(0x25)));
        assert!(id("B0").is_err() && id("256").is_err() && id("").is_err());
    }
}
