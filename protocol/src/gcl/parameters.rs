//! The parameters of requests.

use super::form::{Form, Parameters, Word, write_parameters};
use super::number::{finite, read_integer, write_float, write_integer};
use super::scanner::Scanner;
use super::{ParseError, Topic};
use crate::types::HomingDirection;
use core::fmt::{Result as Written, Write};

/// Checks optional numbers.
fn check_all(parameters: &[Option<f32>]) -> Result<(), ParseError> {
    parameters.iter().flatten().try_for_each(|value| finite(*value).map(|_| ()))
}

/// `1`: positive, outward. `0`: negative, inward. Without parameter: the gripper's configured direction (GCL, 2.2.1).
impl Form<'_> for HomingDirection {
    const FORMS: &'static [&'static str] = &["()", "(<bool>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let outward = parameters.optional()?;
        parameters.close()?;
        Ok(match outward {
            None => Self::Default,
            Some(true) => Self::Positive,
            Some(false) => Self::Negative,
        })
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_str(match self {
            Self::Default => "()",
            Self::Positive => "(1)",
            Self::Negative => "(0)",
        })
    }
}

/// The parameters of MOVE (GCL, 2.2.2).
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub struct Move {
    /// Target opening width in mm.
    pub width: f32,
    /// Speed in mm/s; `None` selects the gripper's configured speed.
    pub speed: Option<f32>,
}

impl Form<'_> for Move {
    const FORMS: &'static [&'static str] = &["(<float>)", "(<float>, <float>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let width = parameters.required()?;
        let speed = parameters.optional()?;
        parameters.close()?;
        Ok(Self { width, speed })
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_parameters(&[Some(self.width), self.speed], to)
    }

    fn check(&self) -> Result<(), ParseError> {
        check_all(&[Some(self.width), self.speed])
    }
}

/// The parameters of GRIP: the manual's four cases (GCL, 2.2.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub enum Grip {
    /// Closes until the fingers meet resistance, with the configured force and speed. The end stop counts as a part.
    #[default]
    Preset,
    /// Closes like `Preset`, with this force.
    Force {
        /// Force in N.
        force: f32,
    },
    /// Moves towards a part of this width, inward or outward.
    Part {
        /// Force in N.
        force: f32,
        /// Nominal width of the part in mm.
        width: f32,
    },
    /// Moves towards a part of this width at this speed.
    PartAtSpeed {
        /// Force in N.
        force: f32,
        /// Nominal width of the part in mm.
        width: f32,
        /// Speed in mm/s.
        speed: f32,
    },
}

impl Grip {
    const fn list(&self) -> [Option<f32>; 3] {
        match *self {
            Self::Preset => [None; 3],
            Self::Force { force } => [Some(force), None, None],
            Self::Part { force, width } => [Some(force), Some(width), None],
            Self::PartAtSpeed { force, width, speed } => [Some(force), Some(width), Some(speed)],
        }
    }
}

impl Form<'_> for Grip {
    const FORMS: &'static [&'static str] =
        &["()", "(<float>)", "(<float>, <float>)", "(<float>, <float>, <float>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let list = (parameters.optional()?, parameters.optional()?, parameters.optional()?);
        parameters.close()?;
        Ok(match list {
            (Some(force), Some(width), Some(speed)) => Self::PartAtSpeed { force, width, speed },
            (Some(force), Some(width), None) => Self::Part { force, width },
            (Some(force), None, _) => Self::Force { force },
            (None, ..) => Self::Preset,
        })
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_parameters(&self.list(), to)
    }

    fn check(&self) -> Result<(), ParseError> {
        check_all(&self.list())
    }
}

/// The parameters of RELEASE (GCL, 2.2.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub enum Release {
    /// Opens by the configured distance at the configured speed.
    #[default]
    Preset,
    /// Opens by this distance at maximum speed.
    By {
        /// Distance from the current width, in mm.
        distance: f32,
    },
    /// Opens by this distance at this speed.
    ByAtSpeed {
        /// Distance from the current width, in mm.
        distance: f32,
        /// Speed in mm/s.
        speed: f32,
    },
}

impl Release {
    const fn list(&self) -> [Option<f32>; 2] {
        match *self {
            Self::Preset => [None; 2],
            Self::By { distance } => [Some(distance), None],
            Self::ByAtSpeed { distance, speed } => [Some(distance), Some(speed)],
        }
    }
}

impl Form<'_> for Release {
    const FORMS: &'static [&'static str] = &["()", "(<float>)", "(<float>, <float>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let list = (parameters.optional()?, parameters.optional()?);
        parameters.close()?;
        Ok(match list {
            (Some(distance), Some(speed)) => Self::ByAtSpeed { distance, speed },
            (Some(distance), None) => Self::By { distance },
            (None, _) => Self::Preset,
        })
    }

    fn write(&self, to: &mut impl Write) -> Written {
        write_parameters(&self.list(), to)
    }

    fn check(&self) -> Result<(), ParseError> {
        check_all(&self.list())
    }
}

/// Reads or writes a setting: PWT and CLT (GCL, 2.2.5 and 2.2.6).
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub enum Setting {
    /// Queries the value without changing it (`?`).
    Ask,
    /// Sets the value in mm, until the connection ends.
    Set(f32),
}

impl Form<'_> for Setting {
    const FORMS: &'static [&'static str] = &["?", "=<float>"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        if input.take(b'?') { Ok(Self::Ask) } else { Form::read(input).map(Self::Set) }
    }

    fn write(&self, to: &mut impl Write) -> Written {
        match self {
            Self::Ask => to.write_char('?'),
            Self::Set(value) => Form::write(value, to),
        }
    }

    fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::Ask => Ok(()),
            Self::Set(value) => Form::check(value),
        }
    }
}

/// Queries all `LEN` elements of a vector, or one of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub enum Select<const LEN: u8> {
    /// All elements.
    #[default]
    All,
    /// The element with this index, counted from 0.
    One(u8),
}

/// Parses an index and the closing bracket.
pub(super) fn read_index<const LEN: u8>(input: &mut Scanner<'_>) -> Result<u8, ParseError> {
    let index = match read_integer(input) {
        Err(ParseError::Range) => return Err(ParseError::Index),
        other => other?,
    };
    input.expect(b']')?;
    u8::try_from(index).ok().filter(|index| *index < LEN).ok_or(ParseError::Index)
}

pub(super) fn write_index(index: u8, to: &mut impl Write) -> Written {
    to.write_char('[')?;
    write_integer(index.into(), to)?;
    to.write_char(']')
}

pub(super) const fn check_index<const LEN: u8>(index: u8) -> Result<(), ParseError> {
    if index < LEN { Ok(()) } else { Err(ParseError::Index) }
}

impl<const LEN: u8> Form<'_> for Select<LEN> {
    const FORMS: &'static [&'static str] = &["?", "[<integer>]?"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let selection = if input.take(b'[') { Self::One(read_index::<LEN>(input)?) } else { Self::All };
        input.expect(b'?')?;
        Ok(selection)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        if let Self::One(index) = self {
            write_index(*index, to)?;
        }
        to.write_char('?')
    }

    fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::All => Ok(()),
            Self::One(index) => check_index::<LEN>(*index),
        }
    }
}

/// The force measurement fingers that TARE zeroes (GCL, 3.3.1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, crate::Format)]
pub enum Tare {
    /// All connected fingers.
    #[default]
    All,
    /// The finger with this index, 0 or 1.
    Finger(u8),
}

/// Number of fingers of a gripper.
pub(super) const FINGERS: u8 = 2;

impl Form<'_> for Tare {
    const FORMS: &'static [&'static str] = &["()", "(<integer>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let finger = parameters.optional::<u32>()?;
        parameters.close()?;
        match finger {
            None => Ok(Self::All),
            Some(index) => {
                let index = u8::try_from(index).map_err(|_| ParseError::Index)?;
                check_index::<FINGERS>(index)?;
                Ok(Self::Finger(index))
            }
        }
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('(')?;
        if let Self::Finger(index) = self {
            write_integer((*index).into(), to)?;
        }
        to.write_char(')')
    }

    fn check(&self) -> Result<(), ParseError> {
        match self {
            Self::All => Ok(()),
            Self::Finger(index) => check_index::<FINGERS>(*index),
        }
    }
}

/// The parameters of AUTOSEND: the value to report, and when (GCL, 3.1.7).
///
/// ```
/// use wsg_protocol::gcl::{Autosend, Request, Topic};
///
/// let every = Request::Autosend(Autosend::every(Topic::Pos, 10));
/// assert_eq!(every.to_string(), "AUTOSEND(\"POS\",10)");
/// let by_two = Request::Autosend(Autosend::by(Topic::Pos, 10, 2.0));
/// assert_eq!(by_two.to_string(), "AUTOSEND(\"POS\",10,2.0)");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, crate::Format)]
pub struct Autosend {
    /// The value to report.
    pub topic: Topic,
    /// Minimum interval between two updates in ms, at least [`MIN_INTERVAL_MS`](Self::MIN_INTERVAL_MS). 0 ends the updates.
    pub interval_ms: u32,
    /// The updates to suppress.
    pub filter: Filter,
}

/// The updates to suppress (GCL, 3.1.7).
#[derive(Clone, Copy, Debug, Default, PartialEq, crate::Format)]
pub enum Filter {
    /// None.
    #[default]
    None,
    /// For a measured value ([`Topic::is_measured`]): updates that differ by less than this from the last one. Not negative,
    /// in the unit of the value.
    Delta(f32),
    /// For a state: if `true`, updates equal to the last one.
    Unchanged(bool),
}

impl Autosend {
    /// The manual's minimum interval in ms.
    pub const MIN_INTERVAL_MS: u32 = 10;

    /// Requests an update every `interval_ms` milliseconds.
    #[must_use]
    pub const fn every(topic: Topic, interval_ms: u32) -> Self {
        Self { topic, interval_ms, filter: Filter::None }
    }

    /// Requests an update of a measured value after each change by `delta`, at least `interval_ms` milliseconds apart.
    #[must_use]
    pub const fn by(topic: Topic, interval_ms: u32, delta: f32) -> Self {
        Self { topic, interval_ms, filter: Filter::Delta(delta) }
    }

    /// Requests an update after each change, at least `interval_ms` milliseconds apart. The thresholds of measured values are
    /// 0.01 mm, 0.05 mm/s and 0.05 N, as in the binary protocol, and 0.1 °C.
    #[must_use]
    pub const fn on_change(topic: Topic, interval_ms: u32) -> Self {
        match topic {
            Topic::Pos => Self::by(topic, interval_ms, 0.01),
            Topic::Speed | Topic::Force => Self::by(topic, interval_ms, 0.05),
            Topic::Temp => Self::by(topic, interval_ms, 0.1),
            Topic::Gripstate | Topic::Sysflags => {
                Self { topic, interval_ms, filter: Filter::Unchanged(true) }
            }
        }
    }

    /// Ends the updates.
    #[must_use]
    pub const fn off(topic: Topic) -> Self {
        Self::every(topic, 0)
    }
}

impl Form<'_> for Autosend {
    const FORMS: &'static [&'static str] =
        &["(<string>, <integer>)", "(<string>, <integer>, <float>)", "(<string>, <integer>, <bool>)"];

    fn read(input: &mut Scanner<'_>) -> Result<Self, ParseError> {
        let mut parameters = Parameters::open(input)?;
        let topic: Topic = parameters.required()?;
        let interval_ms = parameters.required()?;
        let filter = if topic.is_measured() {
            parameters.optional()?.map(Filter::Delta)
        } else {
            parameters.optional()?.map(Filter::Unchanged)
        };
        parameters.close()?;
        let autosend = Self { topic, interval_ms, filter: filter.unwrap_or_default() };
        autosend.check()?;
        Ok(autosend)
    }

    fn write(&self, to: &mut impl Write) -> Written {
        to.write_char('(')?;
        Word::write(&self.topic, to)?;
        to.write_char(',')?;
        write_integer(self.interval_ms, to)?;
        match self.filter {
            Filter::None => {}
            Filter::Delta(delta) => {
                to.write_char(',')?;
                write_float(delta, to)?;
            }
            Filter::Unchanged(unchanged) => {
                to.write_char(',')?;
                Word::write(&unchanged, to)?;
            }
        }
        to.write_char(')')
    }

    fn check(&self) -> Result<(), ParseError> {
        match self.filter {
            Filter::None => Ok(()),
            Filter::Delta(delta) if self.topic.is_measured() && finite(delta)? >= 0.0 => Ok(()),
            Filter::Unchanged(_) if !self.topic.is_measured() => Ok(()),
            Filter::Delta(_) | Filter::Unchanged(_) => Err(ParseError::Value),
        }
    }
}
