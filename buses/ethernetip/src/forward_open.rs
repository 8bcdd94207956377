//! Forward_Open and Large_Forward_Open (volume 1, chapter 3): the request, and the checks that need no connection.

use crate::cursor::Reader;
use crate::encapsulation::MAX_SIZE;
use crate::path::{Segment, Segments};
use crate::profile::{Profile, Status};

/// Maximum requested packet interval of cyclic data.
pub(crate) const MAX_INTERVAL_US: u32 = 10_000_000;
/// Bytes before the outputs: sequence count and run/idle header.
pub(crate) const OUTPUT_OVERHEAD: usize = 6;
/// Bytes before the inputs: sequence count.
pub(crate) const INPUT_OVERHEAD: usize = 2;

/// Minimum size of a connection for answers: any request that changes something gets its answer.
const MIN_ANSWER_SIZE: u16 = 32;

/// Identifies a connection for its originator: serial number, and the originator's vendor and serial number.
pub(crate) type Triad = [u8; 8];

/// A refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Failure {
    /// By any object.
    Status(Status),
    /// By the connection manager: extended status (volume 1, chapter 3), and the right value of a wrong size.
    Connection(u16, Option<u16>),
}

impl From<Status> for Failure {
    fn from(status: Status) -> Self {
        Self::Status(status)
    }
}

/// Parameters of one direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Direction {
    /// Requested packet interval (RPI).
    pub(crate) interval_us: u32,
    pub(crate) size: u16,
    kind: u16,
    is_redundant: bool,
}

impl Direction {
    const NULL: u16 = 0;
    const MULTICAST: u16 = 1;
    const POINT_TO_POINT: u16 = 2;

    fn read(reader: &mut Reader<'_>, is_large: bool) -> Option<Self> {
        let (interval_us, word) = (reader.u32()?, reader.u16()?);
        let (size, flags) = if is_large { (word, reader.u16()?) } else { (word & 0x01FF, word) };
        Some(Self { interval_us, size, kind: (flags >> 13) & 3, is_redundant: flags & 0x8000 != 0 })
    }

    pub(crate) const fn is_multicast(&self) -> bool {
        self.kind == Self::MULTICAST
    }
}

/// What a service of an object results in.
pub(crate) type Served = Result<(), Failure>;

/// Kind of a connection: class 1 with cyclic data, or class 3 with explicit messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    ExclusiveOwner,
    InputOnly,
    ListenOnly,
    Explicit,
}

/// A request for a connection.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Open<'a> {
    /// Identifier for data to the originator, chosen by the originator unless it requests multicast.
    pub(crate) produced_id: u32,
    pub(crate) triad: Triad,
    pub(crate) multiplier: u8,
    pub(crate) output: Direction,
    pub(crate) input: Direction,
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
        let (produced_id, triad) = (reader.u32()?, reader.array()?);
        let [multiplier, _, _, _] = reader.array()?;
        let (output, input) = (Direction::read(reader, is_large)?, Direction::read(reader, is_large)?);
        let (transport, words) = (reader.u8()?, reader.u8()?);
        Some((Self { produced_id, triad, multiplier, output, input, transport, path: &[] }, words))
    }

    /// Returns whether the request opens no connection.
    pub(crate) const fn is_null(&self) -> bool {
        self.output.kind == Direction::NULL && self.input.kind == Direction::NULL
    }

    /// Checks everything that does not depend on other connections, for outputs and inputs of these lengths. Returns the
    /// kind of the connection.
    pub(crate) fn check(&self, profile: &Profile, lens: (usize, usize)) -> Result<Kind, Failure> {
        let Self { output, input, .. } = self;
        let path = ConnectionPath::parse(self.path)?;
        let key = path.key.and_then(|key| key.mismatch(profile));
        // Any trigger. Bit 7, the direction, has no meaning.
        let is_explicit = self.transport & 0x0F == 3;
        let intervals = if is_explicit { 1..=u32::MAX } else { profile.min_interval_us..=MAX_INTERVAL_US };
        let are_allowed = intervals.contains(&output.interval_us) && intervals.contains(&input.interval_us);
        let allows_multicast = !is_explicit && profile.allows_multicast;
        let is_right_input =
            input.kind == Direction::POINT_TO_POINT || allows_multicast && input.is_multicast();
        let refusals = [
            (self.is_null(), 0x0132),
            // Class 1 is cyclic.
            (!is_explicit && self.transport & 0x7F != 1, 0x0103),
            (key.is_some(), key.unwrap_or(0)),
            (output.kind != Direction::POINT_TO_POINT, 0x0123),
            (!is_right_input, 0x0124),
            (output.is_redundant || input.is_redundant, 0x0125),
            (self.multiplier > 7 || !are_allowed, 0x0111),
        ];
        if let Some((_, code)) = refusals.iter().find(|(is_refused, _)| *is_refused) {
            return Err(Failure::Connection(*code, None));
        }
        let kind = if is_explicit { path.router()? } else { path.assemblies(profile)? };
        let wrong_size = |code, right| Err(Failure::Connection(code, Some(right)));
        if !path.configuration.is_empty() {
            return wrong_size(0x0126, 0);
        }
        let [output_len, input_len] = [(lens.0, OUTPUT_OVERHEAD), (lens.1, INPUT_OVERHEAD)]
            .map(|(len, overhead)| len.saturating_add(overhead) as u16);
        let (is_right, right) = match kind {
            Kind::ExclusiveOwner => (output.size == output_len, output_len),
            // A heartbeat is empty, a sequence count, or both with a run/idle header.
            Kind::InputOnly | Kind::ListenOnly => (matches!(output.size, 0 | 2 | 6), 2),
            Kind::Explicit => (output.size <= MAX_SIZE, MAX_SIZE),
        };
        if !is_right {
            return wrong_size(0x0127, right);
        }
        let (least, most) = if is_explicit { (MIN_ANSWER_SIZE, MAX_SIZE) } else { (input_len, input_len) };
        if !(least..=most).contains(&input.size) {
            return wrong_size(0x0128, input.size.max(least).min(most));
        }
        Ok(kind)
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
                    *place.ok_or(Failure::Connection(0x012F, None))? = Some(number);
                }
                Some(Segment::Data(data)) if parsed.points[0].is_some() && !has_data => {
                    (has_data, parsed.configuration) = (true, data);
                }
                _ => return Err(Failure::Connection(0x0315, None)),
            }
        }
        Ok(parsed)
    }

    /// Returns the kind of a connection to the message router.
    fn router(&self) -> Result<Kind, Failure> {
        let is_it = self.class == Some(2) && self.points == [Some(1), None, None];
        is_it.then_some(Kind::Explicit).ok_or(Failure::Connection(0x0117, None))
    }

    /// Returns the kind of a connection to assemblies. Any configuration instance is accepted, because it has no data.
    fn assemblies(&self, profile: &Profile) -> Result<Kind, Failure> {
        let (output, input) = match (self.class, self.points) {
            (Some(4), [Some(output), Some(input), None] | [_, Some(output), Some(input)]) => (output, input),
            (Some(4), _) => return Err(Failure::Connection(0x012F, None)),
            _ => return Err(Failure::Connection(0x0117, None)),
        };
        let kind = match u16::try_from(output) {
            Ok(output) if output == profile.output => Kind::ExclusiveOwner,
            Ok(output) if output == profile.input_only => Kind::InputOnly,
            Ok(output) if output == profile.listen_only => Kind::ListenOnly,
            _ => return Err(Failure::Connection(0x012A, None)),
        };
        if input == profile.input.into() { Ok(kind) } else { Err(Failure::Connection(0x012B, None)) }
    }
}
