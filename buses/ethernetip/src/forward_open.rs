//! Forward_Open and Large_Forward_Open (volume 1, chapter 3): the request, and the checks that need no connection.

use crate::cursor::{Reader, Writer};
use crate::encapsulation::MAX_SIZE;
use crate::path::{Segment, Segments};
use crate::profile::{Profile, Status};

/// Maximum requested packet interval of cyclic data.
pub(crate) const MAX_INTERVAL_US: u32 = 10_000_000;
/// Bytes before the outputs: sequence count and run/idle header.
pub(crate) const OUTPUT_OVERHEAD: usize = 6;
/// Bytes before the inputs: sequence count.
pub(crate) const INPUT_OVERHEAD: usize = 2;

/// Identifies a connection for its originator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Triad {
    serial: u16,
    vendor: u16,
    originator: u32,
}

impl Triad {
    pub(crate) fn read(reader: &mut Reader<'_>) -> Option<Self> {
        Some(Self { serial: reader.u16()?, vendor: reader.u16()?, originator: reader.u32()? })
    }

    pub(crate) fn write(&self, out: &mut Writer<'_>) {
        out.u16(self.serial);
        out.u16(self.vendor);
        out.u32(self.originator);
    }
}

/// A refusal: general status, extended status of the connection manager (volume 1, chapter 3), right value of a wrong
/// size, and the triad of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    pub(crate) status: Status,
    pub(crate) extended: Option<u16>,
    pub(crate) right: Option<u16>,
    pub(crate) triad: Option<Triad>,
}

impl Failure {
    /// Returns a refusal by the connection manager.
    pub(crate) const fn refused(extended: u16) -> Self {
        let status = Status::ConnectionFailure;
        Self { status, extended: Some(extended), right: None, triad: None }
    }
}

impl From<Status> for Failure {
    fn from(status: Status) -> Self {
        Self { status, extended: None, right: None, triad: None }
    }
}

/// Network connection parameters of one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parameters {
    pub(crate) size: u16,
    kind: u8,
    is_redundant: bool,
}

impl Parameters {
    const NULL: u8 = 0;
    const POINT_TO_POINT: u8 = 2;

    fn read(reader: &mut Reader<'_>, is_large: bool) -> Option<Self> {
        let (size, flags) = if is_large {
            (reader.u16()?, reader.u16()?)
        } else {
            let word = reader.u16()?;
            (word & 0x01FF, word)
        };
        let kind = (flags.checked_shr(13)? & 3) as u8;
        Some(Self { size, kind, is_redundant: flags & 0x8000 != 0 })
    }
}

/// What a service of an object results in.
pub(crate) type Served = Result<(), Failure>;

/// Kind of a connection with cyclic data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    ExclusiveOwner,
    InputOnly,
    ListenOnly,
}

/// A request for a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Open<'a> {
    /// Identifier for data to the originator, chosen by the originator.
    pub(crate) produced_id: u32,
    pub(crate) triad: Triad,
    pub(crate) multiplier: u8,
    /// Requested packet intervals (RPI).
    pub(crate) output_us: u32,
    pub(crate) output: Parameters,
    pub(crate) input_us: u32,
    pub(crate) input: Parameters,
    transport: u8,
    path: &'a [u8],
}

impl<'a> Open<'a> {
    /// Parses the data of a request.
    pub(crate) fn parse(data: &'a [u8], is_large: bool) -> Result<Self, Status> {
        let mut reader = Reader::new(data);
        let (open, words) = Self::read(&mut reader, is_large).ok_or(Status::TooShort)?;
        exact_path(&reader, words).map(|path| Self { path, ..open })
    }

    /// Reads all fields before the path, and the number of its words.
    fn read(reader: &mut Reader<'a>, is_large: bool) -> Option<(Self, u8)> {
        let (_tick, _ticks, _consumed_id) = (reader.u8()?, reader.u8()?, reader.u32()?);
        let (produced_id, triad) = (reader.u32()?, Triad::read(reader)?);
        let [multiplier, _, _, _] = reader.array()?;
        let mut direction = || Some((reader.u32()?, Parameters::read(reader, is_large)?));
        let ((output_us, output), (input_us, input)) = (direction()?, direction()?);
        let (transport, words) = (reader.u8()?, reader.u8()?);
        let path = &[];
        Some((
            Self { produced_id, triad, multiplier, output_us, output, input_us, input, transport, path },
            words,
        ))
    }

    /// Returns whether the request opens no connection.
    pub(crate) const fn is_null(&self) -> bool {
        self.output.kind == Parameters::NULL && self.input.kind == Parameters::NULL
    }

    /// Checks everything that does not depend on other connections, for outputs and inputs of these lengths. Returns the
    /// kind of a connection with cyclic data, or `None` for one with explicit messages.
    pub(crate) fn check(&self, profile: &Profile, lens: (usize, usize)) -> Result<Option<Kind>, Failure> {
        let refused = |code| Err(Failure::refused(code));
        let wrong_size = |code, right| Err(Failure { right: Some(right), ..Failure::refused(code) });
        let path = ConnectionPath::parse(self.path)?;
        if self.is_null() {
            return refused(0x0132);
        }
        let is_explicit = match self.transport & 0x7F {
            // Class 1, cyclic. Bit 7, the direction, has no meaning.
            0x01 => false,
            // Class 3 with any trigger.
            transport if transport & 0x0F == 3 => true,
            _ => return refused(0x0103),
        };
        if let Some(code) = path.key.and_then(|key| key.mismatch(profile)) {
            return refused(code);
        }
        if self.output.kind != Parameters::POINT_TO_POINT {
            return refused(0x0123);
        }
        if self.input.kind != Parameters::POINT_TO_POINT {
            return refused(0x0124);
        }
        if self.output.is_redundant || self.input.is_redundant {
            return refused(0x0125);
        }
        let intervals = [self.output_us, self.input_us];
        let allowed = if is_explicit { 1..=u32::MAX } else { profile.min_interval_us..=MAX_INTERVAL_US };
        if self.multiplier > 7 || !intervals.iter().all(|interval| allowed.contains(interval)) {
            return refused(0x0111);
        }
        if is_explicit {
            return match (path.class, path.points) {
                (Some(2), [Some(1), None, None]) if self.output.size > MAX_SIZE => {
                    wrong_size(0x0127, MAX_SIZE)
                }
                (Some(2), [Some(1), None, None]) if self.input.size > MAX_SIZE => {
                    wrong_size(0x0128, MAX_SIZE)
                }
                (Some(2), [Some(1), None, None]) => Ok(None),
                _ => refused(0x0117),
            };
        }
        // Any number of the configuration is accepted, because it has no data.
        let (output, input) = match (path.class, path.points) {
            (Some(4), [Some(output), Some(input), None] | [_, Some(output), Some(input)]) => (output, input),
            (Some(4), _) => return refused(0x012F),
            _ => return refused(0x0117),
        };
        let kind = match u16::try_from(output) {
            Ok(output) if output == profile.output => Kind::ExclusiveOwner,
            Ok(output) if output == profile.input_only => Kind::InputOnly,
            Ok(output) if output == profile.listen_only => Kind::ListenOnly,
            _ => return refused(0x012A),
        };
        if input != profile.input.into() {
            return refused(0x012B);
        }
        if !path.configuration.is_empty() {
            return wrong_size(0x0126, 0);
        }
        let output_size = lens.0.saturating_add(OUTPUT_OVERHEAD) as u16;
        match (kind, self.output.size) {
            (Kind::ExclusiveOwner, size) if size != output_size => {
                return wrong_size(0x0127, output_size);
            }
            // A heartbeat is empty, a sequence count, or both with a run/idle header.
            (Kind::ExclusiveOwner, _) | (_, 0 | 2 | 6) => {}
            _ => return wrong_size(0x0127, 2),
        }
        let input_size = lens.1.saturating_add(INPUT_OVERHEAD) as u16;
        if self.input.size != input_size {
            return wrong_size(0x0128, input_size);
        }
        Ok(Some(kind))
    }
}

/// Returns the path of the announced length, which must be all the remaining data.
pub(crate) fn exact_path<'a>(reader: &Reader<'a>, words: u8) -> Result<&'a [u8], Status> {
    let path = reader.rest();
    match path.len().cmp(&usize::from(words).saturating_mul(2)) {
        core::cmp::Ordering::Less => Err(Status::TooShort),
        core::cmp::Ordering::Equal => Ok(path),
        core::cmp::Ordering::Greater => Err(Status::TooLong),
    }
}

/// Path of a connection: key, class, numbers of the application's objects, configuration data.
#[derive(Clone, Copy, Debug, Default)]
struct ConnectionPath<'a> {
    key: Option<crate::path::Key>,
    class: Option<u32>,
    points: [Option<u32>; 3],
    configuration: &'a [u8],
}

impl<'a> ConnectionPath<'a> {
    fn parse(path: &'a [u8]) -> Result<Self, Failure> {
        let mut parsed = Self::default();
        let mut has_data = false;
        for segment in Segments::new(path) {
            match segment {
                Some(Segment::Key(key)) if parsed.key.is_none() && parsed.class.is_none() => {
                    parsed.key = Some(key);
                }
                Some(Segment::Class(class)) if parsed.class.is_none() => parsed.class = Some(class),
                Some(Segment::Instance(number) | Segment::Point(number))
                    if parsed.class.is_some() && !has_data =>
                {
                    let place = parsed.points.iter_mut().find(|place| place.is_none());
                    *place.ok_or(Failure::refused(0x012F))? = Some(number);
                }
                Some(Segment::Data(data)) if parsed.points[0].is_some() && !has_data => {
                    (has_data, parsed.configuration) = (true, data);
                }
                _ => return Err(Failure::refused(0x0315)),
            }
        }
        Ok(parsed)
    }
}
