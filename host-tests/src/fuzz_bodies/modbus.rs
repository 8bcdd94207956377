//! The MODBUS server on a serial line against a small model: framing, addresses, checksum and the four tables.

use bus_modbus::rtu::{Character, Config, Event, Mode, Server, Timing};
use bus_modbus::{Bits, Device, Exception, Identification, Words};

use super::input::Input;
use super::rtu_line::{Heard, checksum, frame_in};

const UNIT: u8 = 17;
const OTHER_UNIT: u8 = 5;
const BROADCAST: u8 = 0;
const TIMING: Timing = Timing::of(19_200, 11);

/// Existing addresses of registers and bits.
const REGISTERS: std::ops::Range<u16> = 100..110;
const BITS: std::ops::Range<u16> = 40..60;

/// Supported functions, an unsupported one, and those covered only by the library's own tests.
const FUNCTIONS: [u8; 13] = [1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 7, DIAGNOSTICS, IDENTIFICATION];
const DIAGNOSTICS: u8 = 8;
const REPORT_SERVER_ID: u8 = 17;
const WRITE_FILE_RECORD: u8 = 21;
const IDENTIFICATION: u8 = 43;
const MAY_BE_BROADCAST: [u8; 5] = [5, 6, 15, 16, 22];

#[derive(Clone, Debug, PartialEq)]
struct Tables {
    coils: [bool; 20],
    discrete_inputs: [bool; 20],
    holding: [u16; 10],
    input: [u16; 10],
}

/// Required effect of a frame.
#[derive(Debug, PartialEq)]
enum Outcome {
    Damaged,
    Passed,
    Served,
    Answer(Vec<u8>),
    /// FC 8, FC 17, FC 21 and FC 43 are not modelled.
    Unmodelled,
}

struct Model {
    config: Config,
    server: Server,
    served: Tables,
    expected: Tables,
    /// The characters before the next long silence.
    received: Vec<Heard>,
}

/// The first byte enables broadcasts. Each further op is a byte that selects a frame, with parameter bytes.
pub fn modbus(data: &[u8]) {
    let mut input = Input::new(data);
    let config = Config { unit: UNIT, mode: Mode::Strict, broadcast: input.byte() & 1 != 0 };
    let tables = Tables {
        coils: std::array::from_fn(|n| n % 3 == 0),
        discrete_inputs: std::array::from_fn(|n| n % 2 == 0),
        holding: std::array::from_fn(|n| n as u16 * 0x0101),
        input: std::array::from_fn(|n| 0xFF00 + n as u16),
    };
    let mut model = Model {
        config,
        server: Server::new(config, TIMING),
        served: tables.clone(),
        expected: tables,
        received: Vec::new(),
    };
    while !input.is_empty() {
        let op = input.byte();
        let mut frame = match op % 8 {
            0 => input_bytes(&mut input, 24),
            1 => sealed(
                &[&[input.pick(&[UNIT, OTHER_UNIT, BROADCAST])][..], &input_bytes(&mut input, 24)].concat(),
            ),
            2 => sealed(&[&[BROADCAST][..], &request(&mut input)].concat()),
            _ => sealed(&[&[UNIT][..], &request(&mut input)].concat()),
        };
        let trouble = input.byte();
        let at = usize::from(input.byte()) % frame.len().max(1);
        match (trouble % 8, frame.get_mut(at)) {
            (0, Some(byte)) => *byte ^= 1 << (trouble >> 5),
            (1, _) => frame.truncate(at),
            (4, _) => frame.extend([[0x00, 0xFF][usize::from(trouble >> 7)]].repeat(1 + at % 4)),
            (5, _) => frame
                .splice(..0, [[0x00, 0xFF][usize::from(trouble >> 7)]].repeat(1 + at % 10))
                .for_each(drop),
            _ => {}
        }
        model.send(&frame, (trouble % 8 == 2).then_some(at), (trouble % 8 == 3).then_some(at));
        if op & 0x80 != 0 {
            model.fall_silent();
        }
    }
    model.fall_silent();
}

fn input_bytes(input: &mut Input<'_>, most: u8) -> Vec<u8> {
    let count = usize::from(input.byte() % most);
    input.bytes(count).to_vec()
}

/// Returns a valid request near the ends of the tables.
fn request(input: &mut Input<'_>) -> Vec<u8> {
    let function = input.pick(&FUNCTIONS);
    let table = if matches!(function, 1 | 2 | 5 | 15) { BITS } else { REGISTERS };
    let address = (table.start - 2 + u16::from(input.byte()) % (table.end - table.start + 4)).to_be_bytes();
    let quantity = u16::from(input.byte() % 12);
    let count = quantity.to_be_bytes();
    let values = |input: &mut Input<'_>, len: u16| {
        let values: Vec<u8> = (0..len).map(|_| input.byte()).collect();
        [&[len as u8][..], &values].concat()
    };
    let data = match function {
        1..=4 => [address, count].concat(),
        5 => [address, [input.pick(&[0x00, 0xFF, 0x01]), 0]].concat(),
        6 => [address, input.array()].concat(),
        15 => [[address, count].concat(), values(input, quantity.div_ceil(8))].concat(),
        16 => [[address, count].concat(), values(input, quantity * 2)].concat(),
        22 => [address, input.array(), input.array()].concat(),
        23 => {
            let from = (REGISTERS.start + u16::from(input.byte() % 11)).to_be_bytes();
            let read = u16::from(input.byte() % 5).to_be_bytes();
            [[from, read, address, count].concat(), values(input, quantity * 2)].concat()
        }
        _ => input_bytes(input, 6),
    };
    [&[function][..], &data].concat()
}

pub(super) fn sealed(frame: &[u8]) -> Vec<u8> {
    [frame, &checksum(frame)].concat()
}

impl Model {
    /// Sends a frame, possibly with a damaged character or a pause. The silence before it ends the previous frame.
    fn send(&mut self, frame: &[u8], damaged_at: Option<usize>, pause_at: Option<usize>) {
        for (at, byte) in frame.iter().enumerate() {
            let character = if damaged_at == Some(at) { Character::Damaged } else { Character::Byte(*byte) };
            let silence_us = match at {
                0 => TIMING.t3_5_us,
                _ if pause_at == Some(at) => TIMING.t1_5_us + 1,
                _ => TIMING.t1_5_us,
            };
            let event = self.server.push(character, silence_us, &mut self.served).map(Outcome::from);
            if at == 0 {
                if self.settle(event) {
                    // The previous frame consumed the character.
                    assert!(self.server.push(character, silence_us, &mut self.served).is_none());
                }
            } else {
                assert_eq!(event, None, "inside a frame");
            }
            let byte = (damaged_at != Some(at)).then_some(*byte);
            self.received.push(Heard { byte, after_pause: pause_at == Some(at) });
        }
    }

    fn fall_silent(&mut self) {
        assert!(
            self.server.silence(TIMING.t3_5_us - 1, &mut self.served).is_none(),
            "the silence is too short"
        );
        let event = self.server.silence(TIMING.t3_5_us, &mut self.served).map(Outcome::from);
        self.settle(event);
        assert!(
            self.server.silence(u32::MAX, &mut self.served).is_none(),
            "a silence ends a frame only once"
        );
    }

    /// Compares the effect of the sent frame with the model. Returns whether the server was replaced.
    fn settle(&mut self, event: Option<Outcome>) -> bool {
        let received = std::mem::take(&mut self.received);
        if received.is_empty() {
            assert_eq!(event, None, "nothing was sent");
            return false;
        }
        let event = event.expect("a silence ends a frame");
        let frame = frame_in(&received);
        if let Outcome::Answer(answer) = &event {
            let frame = frame.as_ref().filter(|frame| frame[0] == UNIT);
            let frame = frame.expect("an answer to a frame that was not for this unit");
            assert!((5..=256).contains(&answer.len()), "{answer:02X?}");
            assert_eq!(answer[0], UNIT);
            assert_eq!(answer[1] & 0x7F, frame[1] & 0x7F, "the function of the request");
            assert_eq!(checksum(&answer[..answer.len() - 2]), answer[answer.len() - 2..], "{answer:02X?}");
        }
        let expected = frame.as_ref().map_or(Outcome::Damaged, |frame| self.outcome(frame));
        if expected != Outcome::Unmodelled {
            assert_eq!(event, expected, "after {frame:02X?}");
        }
        assert_eq!(self.served, self.expected, "after {frame:02X?}");
        // FC 8 has tests in the library; here the server must not stay silent.
        let is_listen_only = self.server.is_listen_only();
        if is_listen_only {
            self.server = Server::new(self.config, TIMING);
        }
        is_listen_only
    }

    fn outcome(&mut self, frame: &[u8]) -> Outcome {
        let (body, _) = frame.split_at(frame.len() - 2);
        let (unit, function, data) = (body[0], body[1], &body[2..]);
        let may_be_broadcast = self.config.broadcast && MAY_BE_BROADCAST.contains(&function);
        match unit {
            UNIT if matches!(
                function,
                DIAGNOSTICS | REPORT_SERVER_ID | WRITE_FILE_RECORD | IDENTIFICATION
            ) =>
            {
                return Outcome::Unmodelled;
            }
            UNIT => {}
            BROADCAST if may_be_broadcast => {}
            _ => return Outcome::Passed,
        }
        let response = match self.expected.serve(function, data) {
            Ok(data) => [&[unit, function][..], &data].concat(),
            Err(code) => vec![unit, function | 0x80, code],
        };
        if unit == BROADCAST { Outcome::Served } else { Outcome::Answer(sealed(&response)) }
    }
}

impl From<Event<'_>> for Outcome {
    fn from(event: Event<'_>) -> Self {
        match event {
            Event::Answer(frame) => Self::Answer(frame.to_vec()),
            Event::Served => Self::Served,
            Event::Passed => Self::Passed,
            Event::Damaged(_) => Self::Damaged,
        }
    }
}

const NO_FUNCTION: u8 = 1;
const NO_ADDRESS: u8 = 2;
const NO_VALUE: u8 = 3;

impl Tables {
    /// Serves a request as in the specification's diagrams. Returns the response's data, or the exception code.
    fn serve(&mut self, function: u8, data: &[u8]) -> Result<Vec<u8>, u8> {
        if !FUNCTIONS[..10].contains(&function) {
            return Err(NO_FUNCTION);
        }
        let words: Vec<u16> = data.chunks_exact(2).map(|it| u16::from_be_bytes([it[0], it[1]])).collect();
        let is_short = |len: usize| if data.len() == len { Ok(()) } else { Err(NO_VALUE) };
        let one_of = |value: u16, most: u16| if (1..=most).contains(&value) { Ok(()) } else { Err(NO_VALUE) };
        match function {
            1 | 2 => {
                is_short(4)?;
                one_of(words[1], 2000)?;
                let at = place(&BITS, words[0], words[1])?;
                let bits = if function == 1 { &self.coils } else { &self.discrete_inputs };
                let bytes: Vec<u8> = bits[at].chunks(8).map(packed).collect();
                Ok([&[bytes.len() as u8][..], &bytes].concat())
            }
            3 | 4 => {
                is_short(4)?;
                one_of(words[1], 125)?;
                let registers = if function == 3 { &self.holding } else { &self.input };
                Ok(counted(&registers[place(&REGISTERS, words[0], words[1])?]))
            }
            5 => {
                is_short(4)?;
                let value =
                    [(0, false), (0xFF00, true)].iter().find(|it| it.0 == words[1]).ok_or(NO_VALUE)?.1;
                self.coils[place(&BITS, words[0], 1)?].fill(value);
                Ok(data.to_vec())
            }
            6 => {
                is_short(4)?;
                self.holding[place(&REGISTERS, words[0], 1)?].fill(words[1]);
                Ok(data.to_vec())
            }
            15 => {
                one_of(*words.get(1).ok_or(NO_VALUE)?, 0x7B0)?;
                let bytes = usize::from(words[1].div_ceil(8));
                if data.get(4).copied().map(usize::from) != Some(bytes) || data.len() != 5 + bytes {
                    return Err(NO_VALUE);
                }
                for (n, coil) in self.coils[place(&BITS, words[0], words[1])?].iter_mut().enumerate() {
                    *coil = data[5 + n / 8] >> (n % 8) & 1 == 1;
                }
                Ok(data[..4].to_vec())
            }
            16 => {
                self.write(data, 0x7B)?;
                Ok(data[..4].to_vec())
            }
            22 => {
                is_short(6)?;
                let at = place(&REGISTERS, words[0], 1)?.start;
                self.holding[at] = self.holding[at] & words[1] | words[2] & !words[1];
                Ok(data.to_vec())
            }
            _ => {
                one_of(*words.get(1).ok_or(NO_VALUE)?, 0x7D)?;
                let mut written = self.clone();
                let outcome = written.write(&data[4..], 0x79);
                if outcome == Err(NO_VALUE) {
                    return Err(NO_VALUE);
                }
                let read = place(&REGISTERS, words[0], words[1])?;
                outcome?;
                *self = written;
                Ok(counted(&self.holding[read]))
            }
        }
    }

    /// Writes registers: first address, quantity, byte count, values.
    fn write(&mut self, data: &[u8], most: u16) -> Result<(), u8> {
        let &[a1, a0, q1, q0, count, ref values @ ..] = data else { return Err(NO_VALUE) };
        let (first, quantity) = (u16::from_be_bytes([a1, a0]), u16::from_be_bytes([q1, q0]));
        let agrees = usize::from(count) == usize::from(quantity) * 2 && values.len() == usize::from(count);
        if !(1..=most).contains(&quantity) || !agrees {
            return Err(NO_VALUE);
        }
        let registers = &mut self.holding[place(&REGISTERS, first, quantity)?];
        for (register, value) in registers.iter_mut().zip(values.chunks_exact(2)) {
            *register = u16::from_be_bytes([value[0], value[1]]);
        }
        Ok(())
    }
}

/// Returns the range of a block in its table, if it fits completely.
fn place(table: &std::ops::Range<u16>, first: u16, quantity: u16) -> Result<std::ops::Range<usize>, u8> {
    let end = u32::from(first) + u32::from(quantity);
    if first < table.start || end > u32::from(table.end) {
        return Err(NO_ADDRESS);
    }
    let start = usize::from(first - table.start);
    Ok(start..start + usize::from(quantity))
}

fn packed(bits: &[bool]) -> u8 {
    bits.iter().rev().fold(0, |byte, bit| byte << 1 | u8::from(*bit))
}

fn counted(registers: &[u16]) -> Vec<u8> {
    let bytes: Vec<u8> = registers.iter().flat_map(|register| register.to_be_bytes()).collect();
    [&[bytes.len() as u8][..], &bytes].concat()
}

/// Provides the tables to the server by address.
impl Device for Tables {
    fn coil(&self, address: u16) -> Result<bool, Exception> {
        item(&self.coils, &BITS, address)
    }

    fn discrete_input(&self, address: u16) -> Result<bool, Exception> {
        item(&self.discrete_inputs, &BITS, address)
    }

    fn holding_register(&self, address: u16) -> Result<u16, Exception> {
        item(&self.holding, &REGISTERS, address)
    }

    fn input_register(&self, address: u16) -> Result<u16, Exception> {
        item(&self.input, &REGISTERS, address)
    }

    fn write_coils(&mut self, first: u16, values: Bits<'_>) -> Result<(), Exception> {
        replace(&mut self.coils, &BITS, first, values.iter().collect())
    }

    fn write_registers(&mut self, first: u16, values: Words<'_>) -> Result<(), Exception> {
        replace(&mut self.holding, &REGISTERS, first, values.iter().collect())
    }

    fn identification(&self) -> Identification {
        Identification { vendor_name: "vendor", product_code: "code", revision: "1", regular: None }
    }
}

fn item<T: Copy>(table: &[T], addresses: &std::ops::Range<u16>, address: u16) -> Result<T, Exception> {
    let at = address.checked_sub(addresses.start).ok_or(Exception::IllegalDataAddress)?;
    table.get(usize::from(at)).copied().ok_or(Exception::IllegalDataAddress)
}

fn replace<T: Copy>(
    table: &mut [T],
    addresses: &std::ops::Range<u16>,
    first: u16,
    values: Vec<T>,
) -> Result<(), Exception> {
    let at = usize::from(first.checked_sub(addresses.start).ok_or(Exception::IllegalDataAddress)?);
    let place = table.get_mut(at..at + values.len()).ok_or(Exception::IllegalDataAddress)?;
    place.copy_from_slice(&values);
    Ok(())
}
