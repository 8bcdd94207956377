//! The DP slave on its line against a small model: telegrams, frame count bit, services, watchdog.

use bus_profibus::{Address, Cause, Character, Event, Profile, Slave, State};

use super::input::Input;
use crate::world::profibus::points::{
    CHK_CFG, GET_CFG, GLOBAL_CONTROL, RD_INP, RD_OUTP, SET_PRM, SET_SLAVE_ADDRESS, SLAVE_DIAG,
};
use crate::world::profibus::{STATION, sd1, sd2, sd3, sum};

const OTHER_STATION: u8 = 9;
const BROADCAST: u8 = 127;
const MASTERS: [u8; 3] = [2, 2, 3];
const IDENT: [u8; 2] = [0x12, 0x34];
const CONFIG: [u8; 2] = [0xA7, 0x11];
const SYNC_BITS: u32 = 33;

const SERVICES: [u8; 9] = [55, 56, 57, 58, 59, 60, 61, 62, 63];

/// A slave with all options, and one with none.
static PROFILES: [Profile; 2] = [
    Profile { ident: 0x1234, config: &CONFIG, sync: true, freeze: true, fail_safe: true, set_address: true },
    Profile {
        ident: 0x1234,
        config: &CONFIG,
        sync: false,
        freeze: false,
        fail_safe: false,
        set_address: false,
    },
];

type Device = Slave<8, 2, 4>;

/// Destination and source service access points.
type Points = (Option<u8>, Option<u8>);

/// A telegram as parsed from the whole capture.
#[derive(Clone, Debug)]
struct Telegram {
    destination: u8,
    source: u8,
    code: u8,
    points: Points,
    data: Vec<u8>,
}

/// The master that controls the slave.
#[derive(Clone, Copy, Debug)]
struct Owner {
    address: u8,
    sync: bool,
    freeze: bool,
    watchdog_ms: Option<u32>,
    groups: u8,
    received_ms: u32,
    configured: bool,
}

struct Model {
    device: Device,
    profile: &'static Profile,
    now_ms: u32,
    address: Address,
    owner: Option<Owner>,
    faults: u8,
    min_tsdr: u8,
    outputs: [u8; 8],
    received: [u8; 8],
    synchronised: bool,
    inputs: [u8; 2],
    frozen: Option<[u8; 2]>,
    diagnosis: Vec<u8>,
    is_fault: bool,
    overflow: bool,
    announced: bool,
    /// Source, frame count bit and service of the last request, followed by its answer.
    last: Option<(u8, bool, Points)>,
    stored: Vec<u8>,
    /// The master's frame count bit.
    fcb: bool,
}

/// The first byte selects the slave. Each further op is a byte with parameter bytes.
pub fn profibus(data: &[u8]) {
    let mut input = Input::new(data);
    let mut model = Model::new(&PROFILES[usize::from(input.byte() & 1)]);
    while !input.is_empty() {
        match input.byte() % 8 {
            0 => model.application(&mut input),
            1 => {
                model.now_ms = model.now_ms.wrapping_add(u32::from(input.byte()));
                model.poll();
            }
            2 => {
                let noise = input.fewer_than(40).to_vec();
                model.send(&noise, None, None);
            }
            3 => model.start(),
            _ => {
                let body = model.body(&mut input);
                let mut telegram = framed(&body, input.byte());
                let trouble = input.byte();
                let at = usize::from(input.byte()) % telegram.len();
                match trouble % 16 {
                    0 => telegram[at] ^= 1 << (trouble >> 5),
                    1 => telegram.truncate(at),
                    4 => telegram.insert(0, if trouble & 16 == 0 { 0x00 } else { 0xFF }),
                    _ => {}
                }
                model.send(&telegram, (trouble % 16 == 2).then_some(at), (trouble % 16 == 3).then_some(at));
            }
        }
        model.compare();
    }
}

/// Adds delimiters and checksum to a body. Eight bytes of data can use either format.
pub(super) fn framed(body: &[u8], how: u8) -> Vec<u8> {
    match body.len() {
        3 => sd1(body),
        11 if how & 1 == 0 => sd3(body),
        _ => sd2(body),
    }
}

/// Returns the telegrams between two silences, each with the index of its last byte. Damaged characters are `None`.
fn read(line: &[Option<u8>]) -> Vec<(usize, Telegram)> {
    let mut found = vec![];
    let mut at = 0;
    while at < line.len() {
        let rest: Vec<u8> = line[at..].iter().map_while(|byte| *byte).collect();
        let (head, len) = match *rest {
            // Strays of a transceiver.
            [] | [0x00 | 0xFF, ..] => (0, 1),
            [0xE5, ..] => (0, 1),
            [0xDC, ..] => (0, 3),
            [0x10, ..] => (1, 6),
            [0xA2, ..] => (1, 14),
            [0x68, len, again, 0x68, ..] if len == again && (4..=249).contains(&len) => {
                (4, usize::from(len) + 6)
            }
            _ => break,
        };
        if rest.len() < len && !rest.is_empty() {
            break;
        }
        at += len;
        if head == 0 {
            continue;
        }
        let (body, tail) = rest[head..len].split_at(len - head - 2);
        let Some(telegram) = telegram(body).filter(|_| tail == [sum(body), 0x16]) else { break };
        found.push((at - 1, telegram));
    }
    found
}

fn telegram(body: &[u8]) -> Option<Telegram> {
    let mut data = body[3..].iter().copied();
    let dsap = if body[0] & 0x80 != 0 { Some(data.next()?) } else { None };
    let ssap = if body[1] & 0x80 != 0 { Some(data.next()?) } else { None };
    Some(Telegram {
        destination: body[0] & 0x7F,
        source: body[1] & 0x7F,
        code: body[2],
        points: (dsap, ssap),
        data: data.collect(),
    })
}

impl Model {
    fn new(profile: &'static Profile) -> Self {
        let address = Address::new(STATION);
        Self {
            device: Device::new(profile, address),
            profile,
            now_ms: 0,
            address,
            owner: None,
            faults: 0,
            min_tsdr: 11,
            outputs: [0; 8],
            received: [0; 8],
            synchronised: false,
            inputs: [0; 2],
            frozen: None,
            diagnosis: vec![],
            is_fault: false,
            overflow: false,
            announced: false,
            last: None,
            stored: vec![],
            fcb: false,
        }
    }

    /// Sets inputs and a diagnosis as the application.
    fn application(&mut self, input: &mut Input<'_>) {
        let how = input.byte();
        self.inputs = input.array();
        self.device.show_inputs(&self.inputs);
        if how & 1 != 0 {
            let diagnosis = input.bytes(usize::from(how >> 4 & 7));
            self.is_fault = how & 2 != 0;
            self.device.show_diagnosis(diagnosis, self.is_fault);
            self.overflow = diagnosis.len() > 4;
            self.diagnosis = diagnosis[..diagnosis.len().min(4)].to_vec();
        }
        if how & 4 != 0 {
            self.device.announce_diagnosis();
            self.announced = true;
        }
    }

    /// Starts control by a master with all supported modes.
    fn start(&mut self) {
        let modes = if self.profile.sync { 0x30 } else { 0 };
        let station = self.address.station | 0x80;
        self.fcb = false;
        let prm = [station, 0x82, 0x6D, SET_PRM, 62, 0x88 | modes, 1, 20, 0, IDENT[0], IDENT[1], 0x01];
        self.send(&framed(&prm, 1), None, None);
        self.send(&framed(&[station, 0x82, 0x5D, CHK_CFG, 62, CONFIG[0], CONFIG[1]], 1), None, None);
    }

    /// Returns a telegram from a master, from destination to data.
    fn body(&mut self, input: &mut Input<'_>) -> Vec<u8> {
        let how = input.byte();
        let destination = match how % 16 {
            0 => OTHER_STATION,
            1 => BROADCAST,
            _ => self.address.station,
        };
        let source = input.pick(&MASTERS);
        let code = match how >> 4 {
            0 => input.byte(),
            1 => 0x6D,
            2 => 0x4C,
            3 => 0x49,
            // A repetition.
            4 => 0x5D | u8::from(self.fcb) << 5,
            _ => {
                self.fcb = !self.fcb;
                0x5D | u8::from(self.fcb) << 5
            }
        };
        let kind = input.byte() % 12;
        if kind < 3 {
            let count = input.pick(&[8, 8, 8, 8, 0, 7, 9]);
            let outputs = (0..count).map(|_| input.byte());
            return [destination, source, code].into_iter().chain(outputs).collect();
        }
        let (point, data) = match kind {
            3 => {
                let status = input.pick(&[0x80, 0x88, 0xB8, 0x00, 0x40, 0xC8, 0x84]);
                let ident = input.pick(&[IDENT, IDENT, IDENT, [0x12, 0x35]]);
                let parameters = [status, input.byte() % 3, input.byte() % 20, input.byte()];
                let user = input.pick(&[&[][..], &[], &[0, 0, 0], &[0x40, 0, 0], &[0], &[0, 0, 1]]);
                (SET_PRM, [&parameters[..], &ident, &[input.byte() % 4], user].concat())
            }
            4 => (CHK_CFG, input.pick(&[&CONFIG[..], &CONFIG, &[0xA7], &[]]).to_vec()),
            5 | 6 => {
                let broadcast = input.pick(&[BROADCAST, destination]) | 0x80;
                let control = [input.byte() & 0x3F, input.pick(&[0, 0, 1, 2])];
                return [&[broadcast, source | 0x80, 0x46, GLOBAL_CONTROL, 62], &control[..]].concat();
            }
            7 => (SET_SLAVE_ADDRESS, {
                let station = input.pick(&[STATION, 8, 126]);
                vec![station, IDENT[0], input.pick(&[IDENT[1], 0]), input.byte() / 128]
            }),
            8 => {
                let count = usize::from(input.byte() % 12);
                (input.pick(&SERVICES), input.bytes(count).to_vec())
            }
            _ => (input.pick(&[SLAVE_DIAG, SLAVE_DIAG, RD_INP, RD_OUTP, GET_CFG]), vec![]),
        };
        let ssap = input.pick(&[62, 62, 62, 62, 62, 62, 62, 50]);
        [&[destination | 0x80, source | 0x80, code, point, ssap], &data[..]].concat()
    }

    /// Sends a telegram after a silence, possibly with a damaged character or a pause.
    fn send(&mut self, line: &[u8], damaged_at: Option<usize>, pause_at: Option<usize>) {
        let seen = |(at, byte): (usize, &u8)| (damaged_at != Some(at)).then_some(*byte);
        let seen: Vec<Option<u8>> = line.iter().enumerate().map(seen).collect();
        let (first, second) = seen.split_at(pause_at.unwrap_or(line.len()));
        let behind = read(second).into_iter().map(|(at, telegram)| (first.len() + at, telegram));
        let mut telegrams = read(first).into_iter().chain(behind);
        let mut next = telegrams.next();
        for (at, byte) in line.iter().enumerate() {
            let character = if damaged_at == Some(at) { Character::Damaged } else { Character::Byte(*byte) };
            let silence_bits =
                if at == 0 || pause_at == Some(at) { SYNC_BITS } else { u32::from(*byte) % SYNC_BITS };
            let expected = match next.take_if(|(end, _)| *end == at) {
                Some((_, telegram)) => {
                    next = telegrams.next();
                    self.handle(&telegram)
                }
                None => (None, None),
            };
            let not_before_bits = u32::from(self.min_tsdr.max(11));
            let outcome = self.device.push(character, silence_bits, self.now_ms);
            let (event, answer) = outcome.map_or((None, None), |outcome| (outcome.event, outcome.answer));
            assert_eq!(event, expected.0, "byte {at} of {line:02X?}");
            assert_eq!(answer.map(|answer| answer.bytes), expected.1.as_deref(), "byte {at} of {line:02X?}");
            if let Some(answer) = answer {
                assert_eq!(answer.not_before_bits, not_before_bits);
            }
        }
    }

    fn poll(&mut self) {
        let expected = if self.is_expired() { self.expire() } else { None };
        assert_eq!(self.device.poll(self.now_ms), expected);
    }

    fn compare(&self) {
        assert_eq!(*self.device.outputs(), self.outputs);
        assert_eq!(self.device.state(), self.state());
        assert_eq!(self.device.address(), self.address);
        assert_eq!(self.device.master(), self.owner.map(|owner| owner.address));
        // Outputs require a master in data exchange.
        assert!(self.state() == State::DataExch || self.outputs == [0; 8]);
    }

    fn state(&self) -> State {
        match self.owner {
            None => State::WaitPrm,
            Some(owner) if owner.configured => State::DataExch,
            Some(_) => State::WaitCfg,
        }
    }

    fn is_expired(&self) -> bool {
        self.owner.is_some_and(|owner| {
            owner.watchdog_ms.is_some_and(|limit_ms| self.now_ms - owner.received_ms > limit_ms)
        })
    }

    fn expire(&mut self) -> Option<Event> {
        self.last = None;
        self.lose(Cause::Watchdog)
    }

    fn lose(&mut self, cause: Cause) -> Option<Event> {
        let was_exchanging = self.state() == State::DataExch;
        (self.owner, self.outputs, self.received) = (None, [0; 8], [0; 8]);
        (self.synchronised, self.frozen) = (false, None);
        was_exchanging.then_some(Event::Left(cause))
    }

    /// Returns the required event and answer for a telegram.
    fn handle(&mut self, telegram: &Telegram) -> (Option<Event>, Option<Vec<u8>>) {
        if self.is_expired() {
            return (self.expire(), None);
        }
        let &Telegram { destination, source, code, points, ref data } = telegram;
        let is_mine = destination == self.address.station;
        if code & 0xC0 != 0x40 || source == BROADCAST || !is_mine && destination != BROADCAST {
            return (None, None);
        }
        let short = |code: u8| Some(framed(&[source, destination, code], 0));
        match code & 0x0F {
            4 | 6 if points == (Some(GLOBAL_CONTROL), Some(62)) => (self.control(source, data), None),
            9 if is_mine => (None, short(0)),
            3 | 5 | 14 | 15 if is_mine => (None, short(3)),
            12 | 13 if is_mine => {
                let (fcv, fcb) = (code & 0x10 != 0, code & 0x20 != 0);
                let this = (source, fcb, points);
                let mut event = None;
                if !fcv || self.last != Some(this) {
                    let answer;
                    (event, answer) = self.request(telegram);
                    self.last = (fcv || fcb).then_some(this);
                    self.stored = match answer {
                        Answer::Acknowledge => vec![0xE5],
                        Answer::NoService => framed(&[source, destination, 3], 0),
                        Answer::Exchange => {
                            let code = if self.announced { 0x0A } else { 0x08 };
                            let inputs = self.frozen.unwrap_or(self.inputs);
                            framed(&[&[source, destination, code][..], &inputs].concat(), 1)
                        }
                        Answer::Data(data) => {
                            let from = points.0.unwrap();
                            let head = [source | 0x80, destination | 0x80, 0x08, 62, from];
                            framed(&[&head[..], &data].concat(), 1)
                        }
                    };
                }
                if let Some(owner) = self.owner.as_mut().filter(|owner| owner.address == source) {
                    owner.received_ms = self.now_ms;
                }
                (event, Some(self.stored.clone()))
            }
            _ => (None, None),
        }
    }

    fn request(&mut self, telegram: &Telegram) -> (Option<Event>, Answer) {
        let &Telegram { source, points, ref data, .. } = telegram;
        let state = self.state();
        let is_owner = self.owner.is_some_and(|owner| owner.address == source);
        let is_locked = self.owner.is_some() && !is_owner;
        let service = match points {
            (None, None) => None,
            (Some(service), Some(62)) => Some(service),
            _ => return (None, Answer::NoService),
        };
        match service {
            None if is_owner && state == State::DataExch => match <[u8; 8]>::try_from(&data[..]) {
                Ok(outputs) => {
                    self.received = outputs;
                    if self.synchronised {
                        return (None, Answer::Exchange);
                    }
                    self.outputs = outputs;
                    (Some(Event::Outputs), Answer::Exchange)
                }
                Err(_) if data.is_empty() && self.profile.fail_safe => {
                    (self.outputs, self.received) = ([0; 8], [0; 8]);
                    (Some(Event::Cleared), Answer::Exchange)
                }
                Err(_) => {
                    self.faults |= 0x04;
                    (self.lose(Cause::OutputLength), Answer::NoService)
                }
            },
            Some(SLAVE_DIAG) if data.is_empty() => {
                self.announced &= !is_owner;
                (
                    None,
                    Answer::Data(
                        self.standard_diagnosis().into_iter().chain(self.diagnosis.clone()).collect(),
                    ),
                )
            }
            Some(GET_CFG) if data.is_empty() => (None, Answer::Data(CONFIG.to_vec())),
            Some(RD_INP) if data.is_empty() && state == State::DataExch => {
                (None, Answer::Data(self.frozen.unwrap_or(self.inputs).to_vec()))
            }
            Some(RD_OUTP) if data.is_empty() && state == State::DataExch => {
                (None, Answer::Data(self.outputs.to_vec()))
            }
            Some(SET_PRM) if !is_locked => (self.set_prm(source, data), Answer::Acknowledge),
            Some(CHK_CFG) if !is_locked => {
                let event = match &mut self.owner {
                    None => None,
                    Some(owner) if **data == CONFIG => {
                        owner.configured = true;
                        None
                    }
                    Some(_) => {
                        self.faults = 0x04;
                        self.lose(Cause::Configuration)
                    }
                };
                (event, Answer::Acknowledge)
            }
            Some(SET_SLAVE_ADDRESS)
                if self.profile.set_address
                    && !self.address.locked
                    && self.owner.is_none()
                    && data.len() >= 4
                    && data[0] <= 125
                    && data[1..3] == IDENT =>
            {
                self.address = Address { station: data[0], locked: data[3] != 0 };
                (Some(Event::Address(self.address)), Answer::Acknowledge)
            }
            _ => (None, Answer::NoService),
        }
    }

    fn set_prm(&mut self, source: u8, data: &[u8]) -> Option<Event> {
        let Some((&[status, factor_1, factor_2, min_tsdr, i1, i0, groups], user)) = data.split_first_chunk()
        else {
            self.faults = 0x40;
            return self.lose(Cause::Parameters);
        };
        if status & 0xC0 != 0 {
            if [i1, i0] != IDENT {
                self.faults = 0x40;
                return self.lose(Cause::Parameters);
            }
            if status & 0x40 != 0 {
                return self.lose(Cause::Unlocked);
            }
            let has_modes = self.profile.sync;
            if status & 0x07 != 0 || status & 0x30 != 0 && !has_modes {
                self.faults = 0x10;
                return self.lose(Cause::Parameters);
            }
            let watchdog_ms = u32::from(factor_1) * u32::from(factor_2) * 10;
            let watched = status & 0x08 != 0;
            let user_is_right =
                user.is_empty() || user == [0, 0, 0] || self.profile.fail_safe && user == [0x40, 0, 0];
            if watched && watchdog_ms == 0 || !user_is_right {
                self.faults = 0x40;
                return self.lose(Cause::Parameters);
            }
            let event = self.lose(Cause::Parameters);
            self.faults = 0;
            self.owner = Some(Owner {
                address: source,
                sync: status & 0x20 != 0,
                freeze: status & 0x10 != 0,
                watchdog_ms: watched.then_some(watchdog_ms),
                groups,
                received_ms: self.now_ms,
                configured: false,
            });
            if min_tsdr != 0 {
                self.min_tsdr = min_tsdr;
            }
            return event;
        }
        if min_tsdr != 0 {
            self.min_tsdr = min_tsdr;
        }
        None
    }

    fn control(&mut self, source: u8, data: &[u8]) -> Option<Event> {
        let &[command, groups] = data else { return None };
        let owner = self.owner.filter(|owner| owner.address == source && owner.configured)?;
        if groups != 0 && groups & owner.groups == 0 {
            return None;
        }
        let mut event = None;
        match command & 0x30 {
            0x10 | 0x30 => {
                event = self.synchronised.then_some(Event::Outputs);
                (self.synchronised, self.outputs) = (false, self.received);
            }
            0x20 if owner.sync => {
                event = self.synchronised.then_some(Event::Outputs);
                (self.synchronised, self.outputs) = (true, self.received);
            }
            _ => {}
        }
        match command & 0x0C {
            0x04 | 0x0C => self.frozen = None,
            0x08 if owner.freeze => self.frozen = Some(self.inputs),
            _ => {}
        }
        if command & 0x02 != 0 {
            (self.outputs, self.received) = ([0; 8], [0; 8]);
            event = Some(Event::Cleared);
        }
        event
    }

    fn standard_diagnosis(&self) -> [u8; 6] {
        let bit = |is_set: bool, n: u8| u8::from(is_set) << n;
        let status_1 = self.faults | bit(self.state() != State::DataExch, 1) | bit(self.is_fault, 3);
        let is_watched = self.owner.is_some_and(|owner| owner.watchdog_ms.is_some());
        let status_2 = bit(self.owner.is_none(), 0)
            | bit(true, 2)
            | bit(is_watched, 3)
            | bit(self.frozen.is_some(), 4)
            | bit(self.synchronised, 5);
        let master = self.owner.map_or(0xFF, |owner| owner.address);
        [status_1, status_2, bit(self.overflow, 7), master, IDENT[0], IDENT[1]]
    }
}

enum Answer {
    Acknowledge,
    NoService,
    Exchange,
    Data(Vec<u8>),
}
