//! A server for one unit on a serial line: frames in, responses out, including FC 8.

use core::hash::{Hash, Hasher};

use super::counters::count;
use super::{CRC_LEN, Character, Counters, Damage, MAX_FRAME_LEN, Mode, Received, Receiver, Timing, crc};
use crate::{Device, Exception, Function, MAX_PDU_LEN, serve_as};

/// Broadcast address: all units execute the request, none responds.
pub const BROADCAST: u8 = 0;

/// Valid addresses of a unit (MODBUS over serial line, 2.2).
pub const UNITS: core::ops::RangeInclusive<u8> = 1..=247;

/// Configuration of a server on a serial line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Address of the unit, one of [`UNITS`].
    pub unit: u8,
    /// Rules for silence within a frame.
    pub mode: Mode,
    /// Whether broadcast writes are executed. The specification requires it. On a line with other kinds of devices, a
    /// write to a register of theirs would also take effect here.
    pub broadcast: bool,
}

/// Outcome of received characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event<'a> {
    /// Response frame to send, including the checksum.
    Answer(&'a [u8]),
    /// A request for this unit or a broadcast was served and has no response, or not yet.
    Served,
    /// A frame for another unit, or one that this unit ignores.
    Passed,
    /// Discarded characters, with the reason.
    Damaged(Damage),
}

/// A MODBUS server on a serial line.
///
/// ```
/// # use bus_modbus::{Bits, Device, Exception, Identification, Words};
/// # const NONE: Exception = Exception::IllegalDataAddress;
/// # struct Zero;
/// # impl Device for Zero {
/// #     fn coil(&self, _: u16) -> Result<bool, Exception> { Err(NONE) }
/// #     fn discrete_input(&self, _: u16) -> Result<bool, Exception> { Err(NONE) }
/// #     fn holding_register(&self, _: u16) -> Result<u16, Exception> { Ok(0) }
/// #     fn input_register(&self, _: u16) -> Result<u16, Exception> { Err(NONE) }
/// #     fn write_coils(&mut self, _: u16, _: Bits<'_>) -> Result<(), Exception> { Err(NONE) }
/// #     fn write_registers(&mut self, _: u16, _: Words<'_>) -> Result<(), Exception> { Err(NONE) }
/// #     fn identification(&self) -> Identification { unimplemented!() }
/// # }
/// # let mut device = Zero;
/// use bus_modbus::rtu::{Character, Config, Event, Mode, Server, Timing};
///
/// let config = Config { unit: 1, mode: Mode::Strict, broadcast: true };
/// let mut server = Server::new(config, Timing::of(19_200, 11));
/// // Read Holding Registers: one register from address 0.
/// for byte in [0x01, 0x03, 0x00, 0x00, 0x00, 0x01, 0x84, 0x0A] {
///     assert_eq!(server.push(Character::Byte(byte), 0, &mut device), None);
/// }
/// let answer: &[u8] = &[0x01, 0x03, 0x02, 0x00, 0x00, 0xB8, 0x44];
/// assert_eq!(server.silence(2_010, &mut device), Some(Event::Answer(answer)));
/// ```
#[derive(Clone, Debug)]
pub struct Server {
    config: Config,
    receiver: Receiver,
    line: Line,
    response: [u8; MAX_FRAME_LEN],
}

/// Excludes counters and last response, which do not affect future behaviour.
impl Hash for Server {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Self { config, receiver, line: Line { counters: _, listen_only, deferred }, response: _ } = self;
        (config, receiver, listen_only, deferred).hash(state);
    }
}

/// State that FC 8 reads and changes.
#[derive(Clone, Debug)]
struct Line {
    counters: Counters,
    listen_only: bool,
    /// Length of a response PDU that waits for the device; 0 without one.
    deferred: usize,
}

impl Server {
    /// Creates a server without a frame in progress.
    #[must_use]
    pub const fn new(config: Config, timing: Timing) -> Self {
        Self {
            config,
            receiver: Receiver::new(config.unit, config.mode, timing),
            line: Line { counters: Counters::ZERO, listen_only: false, deferred: 0 },
            response: [0; MAX_FRAME_LEN],
        }
    }

    /// Changes the configuration. The new unit and mode also apply to a frame in progress.
    pub const fn configure(&mut self, config: Config) {
        self.config = config;
        self.receiver.configure(config.unit, config.mode);
    }

    /// Returns the diagnostic counters since start-up or the last reset by FC 8.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.line.counters
    }

    /// Returns whether FC 8 has put the server into listen-only mode.
    #[must_use]
    pub const fn is_listen_only(&self) -> bool {
        self.line.listen_only
    }

    /// Returns whether no frame is in progress and no response is deferred, so that [`silence`](Self::silence) returns nothing.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        self.receiver.is_idle() && self.line.deferred == 0
    }

    /// Processes a character and the silence before it in microseconds; see [`Receiver`].
    pub fn push<D: Device + ?Sized>(
        &mut self,
        character: Character,
        silence_us: u32,
        device: &mut D,
    ) -> Option<Event<'_>> {
        let Self { config, receiver, line, response } = self;
        let received = receiver.push(character, silence_us)?;
        Some(line.handle(*config, received, device, response))
    }

    /// Processes a silence in microseconds that is still going on; see [`Receiver`]. Also returns a response that the device has
    /// deferred ([`Device::outcome`]) as soon as it is due.
    pub fn silence<D: Device + ?Sized>(&mut self, silence_us: u32, device: &mut D) -> Option<Event<'_>> {
        let Self { config, receiver, line, response } = self;
        if let Some(received) = receiver.silence(silence_us) {
            return Some(line.handle(*config, received, device, response));
        }
        // While the next frame is received, a response would collide with it.
        receiver.is_idle().then_some(())?;
        line.confirm(device, response)
    }
}

impl Line {
    fn handle<'r, D: Device + ?Sized>(
        &mut self,
        config: Config,
        received: Received<'_>,
        device: &mut D,
        response: &'r mut [u8; MAX_FRAME_LEN],
    ) -> Event<'r> {
        // The client no longer waits for it.
        self.deferred = 0;
        let (unit, pdu) = match received {
            Received::Frame { unit, pdu } => (unit, pdu),
            Received::FrameAmongStrays { unit, pdu, strays } => {
                self.counters.strays = self.counters.strays.saturating_add(strays);
                (unit, pdu)
            }
            Received::Damaged(damage) => {
                self.counters.damaged(damage);
                return Event::Damaged(damage);
            }
        };
        count(&mut self.counters.bus_messages);
        let broadcast = unit == BROADCAST;
        if unit != config.unit && !broadcast {
            return Event::Passed;
        }
        count(&mut self.counters.server_messages);
        let Some((&code, data)) = pdu.split_first() else { return Event::Passed };
        let function = Function::from_code(code);
        let [unit_place, rest @ ..] = response;
        *unit_place = unit;
        let Some(place) = rest.first_chunk_mut::<MAX_PDU_LEN>() else { return Event::Passed };
        let unheard = broadcast && !(config.broadcast && function.is_some_and(Function::may_be_broadcast));
        if unheard || (self.listen_only && !is_restart(pdu)) {
            count(&mut self.counters.no_responses);
            return Event::Passed;
        }
        let (len, exception) = if function == Some(Function::Diagnostics) {
            self.diagnose(pdu, place)
        } else {
            serve_as(function, code, Some(unit), data, device, place)
        };
        if let Some(exception) = exception {
            self.counters.excepted(exception);
        } else if function == Some(Function::WriteFileRecord) {
            self.deferred = len;
            return self.confirm(device, response).unwrap_or(Event::Served);
        }
        if broadcast || len == 0 {
            count(&mut self.counters.no_responses);
            return Event::Served;
        }
        Event::Answer(seal(response, len))
    }

    /// Returns the deferred response as soon as the device has an outcome.
    fn confirm<'r, D: Device + ?Sized>(
        &mut self,
        device: &D,
        response: &'r mut [u8; MAX_FRAME_LEN],
    ) -> Option<Event<'r>> {
        if self.deferred == 0 {
            return None;
        }
        let outcome = device.outcome()?;
        let mut len = core::mem::take(&mut self.deferred);
        if let Err(exception) = outcome {
            self.counters.excepted(exception);
            let [_, code, reason, ..] = response;
            (*code, *reason, len) = (*code | 0x80, exception.code(), 2);
        }
        Some(Event::Answer(seal(response, len)))
    }

    /// Serves FC 8, Diagnostics. Returns the length of the response, 0 for none, and the exception, if any.
    fn diagnose(&mut self, pdu: &[u8], response: &mut [u8; MAX_PDU_LEN]) -> (usize, Option<Exception>) {
        match self.subfunction(pdu) {
            Ok(Diagnosed::Echo) => {
                for (to, from) in response.iter_mut().zip(pdu) {
                    *to = *from;
                }
                (pdu.len(), None)
            }
            Ok(Diagnosed::Value(value)) => {
                let [high, low] = value.to_be_bytes();
                let sub = pdu.get(2).copied().unwrap_or(0);
                if let Some(place) = response.first_chunk_mut() {
                    *place = [Function::Diagnostics.code(), 0, sub, high, low];
                }
                (5, None)
            }
            Ok(Diagnosed::Nothing) => (0, None),
            Err(exception) => {
                if let Some(place) = response.first_chunk_mut() {
                    *place = [Function::Diagnostics.code() | 0x80, exception.code()];
                }
                (2, Some(exception))
            }
        }
    }

    fn subfunction(&mut self, pdu: &[u8]) -> Result<Diagnosed, Exception> {
        let &[_, high, low, ref data @ ..] = pdu else { return Err(Exception::IllegalDataValue) };
        let sub = u16::from_be_bytes([high, low]);
        if sub == RETURN_QUERY_DATA {
            return Ok(Diagnosed::Echo);
        }
        let value = match data {
            &[high, low] => Ok(u16::from_be_bytes([high, low])),
            _ => Err(Exception::IllegalDataValue),
        };
        let zero = value.and_then(|value| if value == 0 { Ok(()) } else { Err(Exception::IllegalDataValue) });
        let counters = &mut self.counters;
        let read = |counter: u16| zero.map(|()| Diagnosed::Value(counter));
        match sub {
            RESTART => match value? {
                // FF00 also clears the event log, which this server does not have.
                0x0000 | 0xFF00 => {
                    let silent = core::mem::take(&mut self.listen_only);
                    *counters = Counters::ZERO;
                    Ok(if silent { Diagnosed::Nothing } else { Diagnosed::Echo })
                }
                _ => Err(Exception::IllegalDataValue),
            },
            0x02 => read(0),
            0x04 => zero.map(|()| {
                self.listen_only = true;
                Diagnosed::Nothing
            }),
            0x0A => zero.map(|()| {
                *counters = Counters::ZERO;
                Diagnosed::Echo
            }),
            0x0B..=0x12 => read(counters.by_subfunction(sub)),
            0x14 => zero.map(|()| {
                counters.overruns = 0;
                Diagnosed::Echo
            }),
            _ => Err(Exception::IllegalFunction),
        }
    }
}

/// Subfunctions of FC 8.
const RETURN_QUERY_DATA: u16 = 0x00;
const RESTART: u16 = 0x01;

/// Response to a subfunction of FC 8.
#[derive(Clone, Copy)]
enum Diagnosed {
    /// Echo of the request.
    Echo,
    /// A value in place of the data field.
    Value(u16),
    Nothing,
}

/// Returns whether the PDU is Restart Communications Option, the only request that ends listen-only mode.
fn is_restart(pdu: &[u8]) -> bool {
    matches!(pdu, [0x08, 0x00, 0x01, 0x00 | 0xFF, 0x00])
}

/// Appends the checksum to the unit and a response PDU of this length, and returns the frame.
fn seal(frame: &mut [u8; MAX_FRAME_LEN], pdu_len: usize) -> &[u8] {
    let end = pdu_len.saturating_add(1);
    let sum = crc(frame.get(..end).unwrap_or_default());
    if let Some(place) = frame.get_mut(end..).and_then(|rest| rest.first_chunk_mut::<CRC_LEN>()) {
        *place = sum.to_le_bytes();
    }
    frame.get(..end.saturating_add(CRC_LEN)).unwrap_or_default()
}
