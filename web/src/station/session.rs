//! The inputs of a session with their times, and the compact text of both for a link.
//!
//! An action is a letter that is no hexadecimal digit, with hexadecimal arguments, such as `w21` or `i200.7d0.1388.fa0`. A link holds actions separated by `~`,
//! each with the time since the previous one in microseconds, and ends with the time after the last one: `0w20~2d0w30~1388`.

/// Maximum number of actions in a link.
pub const MAX_ACTIONS: usize = 400;

/// Maximum virtual time in a link, in microseconds: 20 minutes, which a page replays in seconds.
pub const MAX_TIME_US: u64 = 1_200_000_000;

/// The settings of the bridge that a session can change: time-out and reaction of the bus, wires, recipes 0 to 3, BUS_RECIPE.
pub const OFFERED_SETTINGS: [u16; 21] =
    [101, 102, 106, 107, 109, 110, 111, 112, 113, 114, 115, 116, 117, 118, 119, 120, 121, 122, 123, 124, 173];

/// An input of the station.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Levels of the eight wires from the PLC.
    Wires(u8),
    /// The output image that the bus master writes, as registers.
    Image([u16; 4]),
    /// Whether the bus master sends.
    Master(bool),
    /// Whether the gripper's line is cut.
    Cut(bool),
    /// Damages the next byte: to the gripper, or from it.
    Damage(bool),
    /// Puts a part of this width in 1/10 mm between the fingers; 0 takes it away.
    Part(u16),
    /// Restarts the bridge.
    RestartBridge,
    /// Switches the gripper off and on.
    RestartGripper,
    /// Writes a setting of the bridge: register and value.
    Setting(u16, u16),
}

impl Action {
    /// Parses an action.
    #[must_use]
    pub fn parse(text: &str) -> Option<Self> {
        let (letter, rest) = text.split_at_checked(1)?;
        let parse = |word| u16::from_str_radix(word, 16).ok();
        let words = rest.split('.').filter(|word| !word.is_empty()).map(parse).collect::<Option<Vec<_>>>()?;
        Some(match (letter, &words[..]) {
            ("w", &[levels]) => Self::Wires(levels.try_into().ok()?),
            ("i", &[flags, width, speed, force]) => Self::Image([flags, width, speed, force]),
            ("m", &[on @ 0..=1]) => Self::Master(on == 1),
            ("x", &[on @ 0..=1]) => Self::Cut(on == 1),
            ("n", &[to_gripper @ 0..=1]) => Self::Damage(to_gripper == 1),
            ("p", &[width]) => Self::Part(width),
            ("r", []) => Self::RestartBridge,
            ("g", []) => Self::RestartGripper,
            ("s", &[register, value]) if OFFERED_SETTINGS.contains(&register) => {
                Self::Setting(register, value)
            }
            _ => return None,
        })
    }
}

impl core::fmt::Display for Action {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Self::Wires(levels) => write!(f, "w{levels:x}"),
            Self::Image([flags, width, speed, force]) => {
                write!(f, "i{flags:x}.{width:x}.{speed:x}.{force:x}")
            }
            Self::Master(on) => write!(f, "m{}", u8::from(on)),
            Self::Cut(on) => write!(f, "x{}", u8::from(on)),
            Self::Damage(to_gripper) => write!(f, "n{}", u8::from(to_gripper)),
            Self::Part(width) => write!(f, "p{width:x}"),
            Self::RestartBridge => f.write_str("r"),
            Self::RestartGripper => f.write_str("g"),
            Self::Setting(register, value) => write!(f, "s{register:x}.{value:x}"),
        }
    }
}

/// The actions of a session, each with its time in microseconds, and the session's end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Session {
    /// The actions in the order of their times.
    pub actions: Vec<(u64, Action)>,
    /// The end.
    pub end_us: u64,
}

impl Session {
    /// Returns the text for a link, or `None` if the session is too long for one.
    #[must_use]
    pub fn link(&self) -> Option<String> {
        if self.actions.len() > MAX_ACTIONS || self.end_us > MAX_TIME_US {
            return None;
        }
        let (mut text, mut before_us) = (String::new(), 0);
        for (at_us, action) in &self.actions {
            text += &format!("{:x}{action}~", at_us - before_us);
            before_us = *at_us;
        }
        Some(text + &format!("{:x}", self.end_us - before_us))
    }

    /// Parses a link. Returns `None` for any other text, and for a session that is too long.
    #[must_use]
    pub fn parse(link: &str) -> Option<Self> {
        let (actions, end) = link.rsplit_once('~').unwrap_or(("", link));
        let mut session = Self::default();
        let time = |before: u64, text| before.checked_add(u64::from_str_radix(text, 16).ok()?);
        for part in actions.split('~').filter(|part| !part.is_empty()) {
            let letter = part.find(|char: char| !char.is_ascii_hexdigit())?;
            let (at, action) = part.split_at_checked(letter)?;
            session.end_us = time(session.end_us, at)?;
            session.actions.push((session.end_us, Action::parse(action)?));
        }
        session.end_us = time(session.end_us, end)?;
        let fits = session.actions.len() <= MAX_ACTIONS && session.end_us <= MAX_TIME_US;
        fits.then_some(session)
    }
}
