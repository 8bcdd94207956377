//! A slave on a serial line: telegrams in, answers out.

use crate::dp::{Dp, Response};
use crate::receiver::{Character, Counters, Receiver};
use crate::telegram::{
    BROADCAST, DATA_HIGH, DATA_LOW, Function, MAX_TELEGRAM_LEN, NO_SERVICE, OK, SC, SD1_LEN, Telegram, sd1,
    write_sd2,
};
use crate::{Address, Cause, Event, MAX_DATA_LEN, Profile, STANDARD_DIAGNOSIS_LEN, State};

/// Minimum of min T_SDR: the earliest start of an answer after the end of its request, in bit times.
pub const MIN_TSDR_BITS: u32 = 11;

/// An answer telegram to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer<'a> {
    /// Characters of the telegram, to be sent without a pause.
    pub bytes: &'a [u8],
    /// Min T_SDR: required silence from the end of the request to the first character, in bit times. The
    /// master waits at least [`Baud::max_tsdr_bits`](crate::Baud::max_tsdr_bits).
    pub not_before_bits: u32,
}

/// Result of a received telegram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome<'a> {
    /// Event for the application, if any.
    pub event: Option<Event>,
    /// Answer to send, if any.
    pub answer: Option<Answer<'a>>,
}

/// A request that may be repeated, identified by sender, frame count bit and service. The standard does not
/// compare the service. This does, so that a master that abandons a request and continues with the same bit
/// never receives another service's data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cycle {
    source: u8,
    fcb: bool,
    points: (Option<u8>, Option<u8>),
}

/// A DP slave with `O` bytes of outputs, `I` bytes of inputs, and up to `D` bytes of device-specific diagnosis.
///
/// See the [crate](crate) for an example.
#[derive(Clone, Debug)]
pub struct Slave<const O: usize, const I: usize, const D: usize> {
    receiver: Receiver,
    station: Station<O, I, D>,
}

#[derive(Clone, Debug)]
struct Station<const O: usize, const I: usize, const D: usize> {
    dp: Dp<O, I, D>,
    /// Request that `answer` belongs to.
    cycle: Option<Cycle>,
    /// Last answer to a request that may be repeated.
    answer: [u8; MAX_TELEGRAM_LEN],
    answer_len: usize,
    /// Last answer to a request that is never repeated.
    status: [u8; SD1_LEN],
}

impl<const O: usize, const I: usize, const D: usize> Slave<O, I, D> {
    /// Creates a slave that waits for a master. More than 244 bytes of outputs or inputs, or more than 238 bytes
    /// of diagnosis, do not compile.
    #[must_use]
    pub const fn new(profile: &'static Profile, address: Address) -> Self {
        const {
            assert!(O <= MAX_DATA_LEN && I <= MAX_DATA_LEN, "outputs and inputs: at most 244 bytes each");
            assert!(D <= MAX_DATA_LEN - STANDARD_DIAGNOSIS_LEN, "diagnosis: at most 238 bytes");
        }
        Self {
            receiver: Receiver::new(),
            station: Station {
                dp: Dp::new(profile, address),
                cycle: None,
                answer: [0; MAX_TELEGRAM_LEN],
                answer_len: 0,
                status: [0; SD1_LEN],
            },
        }
    }

    /// Processes a character, the silence before it, and the time.
    ///
    /// `silence_bits` is the time from the end of the previous character to the start of this one, in bit times. If
    /// silences cannot be measured, for example on a pseudo-terminal, pass [`SYNC_BITS`](crate::SYNC_BITS) for the
    /// first byte of a burst and 0 for the others.
    pub fn push(&mut self, character: Character, silence_bits: u32, now_ms: u32) -> Option<Outcome<'_>> {
        let Self { receiver, station } = self;
        let telegram = receiver.push(character, silence_bits)?;
        // A telegram that arrives after the watchdog has expired is not answered; the master repeats it.
        if station.dp.is_expired(now_ms) {
            return station.expire().map(|event| Outcome { event: Some(event), answer: None });
        }
        station.handle(&telegram, now_ms)
    }

    /// Checks the master's watchdog. The interval between calls limits the accuracy; call
    /// it every millisecond, for example.
    pub fn poll(&mut self, now_ms: u32) -> Option<Event> {
        if self.station.dp.is_expired(now_ms) { self.station.expire() } else { None }
    }

    /// Returns the time in milliseconds after which [`poll`](Self::poll) must be called, unless the master sends a
    /// request before; `None` without a watchdog.
    #[must_use]
    pub fn poll_timeout(&self, now_ms: u32) -> Option<u32> {
        self.station.dp.time_left_ms(now_ms)
    }

    /// Returns the state of the slave towards its master.
    #[must_use]
    pub fn state(&self) -> State {
        self.station.dp.state()
    }

    /// Returns the address of its master, if any.
    #[must_use]
    pub fn master(&self) -> Option<u8> {
        self.station.dp.master()
    }

    /// Changes the address, for applications that know it only after [`new`](Self::new).
    pub const fn set_address(&mut self, address: Address) {
        self.station.dp.set_address(address);
    }

    /// Returns the present address.
    #[must_use]
    pub const fn address(&self) -> Address {
        self.station.dp.address()
    }

    /// Returns the statistics of the receiver.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        self.receiver.counters()
    }

    /// Returns the outputs from the master. They are 0 before the first Data_Exchange, after
    /// Clear, and outside data exchange.
    #[must_use]
    pub const fn outputs(&self) -> &[u8; O] {
        self.station.dp.outputs()
    }

    /// Sets the inputs for the master.
    pub const fn show_inputs(&mut self, inputs: &[u8; I]) {
        self.station.dp.show_inputs(inputs);
    }

    /// Sets the device-specific part of the diagnosis: blocks, each with its header. Bytes past `D` are dropped and
    /// reported by Diag.Ext_Diag_Overflow. `is_fault` sets Diag.Ext_Diag; without it, the part is a status.
    pub fn show_diagnosis(&mut self, bytes: &[u8], is_fault: bool) {
        self.station.dp.show_diagnosis(bytes, is_fault);
    }

    /// Requests the master to read the diagnosis, by high-priority answers until it does.
    pub const fn announce_diagnosis(&mut self) {
        self.station.dp.announce_diagnosis();
    }
}

impl<const O: usize, const I: usize, const D: usize> Station<O, I, D> {
    fn expire(&mut self) -> Option<Event> {
        // A stored answer from data exchange must not be repeated.
        self.cycle = None;
        self.dp.leave(Cause::Watchdog)
    }

    fn handle(&mut self, telegram: &Telegram<'_>, now_ms: u32) -> Option<Outcome<'_>> {
        let &Telegram { destination, source, dsap, ssap, data, .. } = telegram;
        let function = telegram.function()?;
        let is_mine = destination == self.dp.address().station;
        if source == BROADCAST {
            return None;
        }
        match function {
            Function::Sdn if is_mine || destination == BROADCAST => {
                let event = self.dp.control((dsap, ssap), source, data)?;
                Some(Outcome { event: Some(event), answer: None })
            }
            _ if !is_mine => None,
            Function::Sdn => None,
            Function::FdlStatus => Some(self.answer_status(source, OK)),
            Function::Unserved => Some(self.answer_status(source, NO_SERVICE)),
            Function::Srd => Some(self.request(telegram, now_ms)),
        }
    }

    fn answer_status(&mut self, destination: u8, function_code: u8) -> Outcome<'_> {
        self.status = sd1(destination, self.dp.address().station, function_code);
        let not_before_bits = self.not_before_bits();
        Outcome { event: None, answer: Some(Answer { bytes: &self.status, not_before_bits }) }
    }

    fn request(&mut self, telegram: &Telegram<'_>, now_ms: u32) -> Outcome<'_> {
        let &Telegram { source, dsap, ssap, data, .. } = telegram;
        let points = (dsap, ssap);
        let (fcv, fcb) = (telegram.fcv(), telegram.fcb());
        let cycle = (fcv || fcb).then_some(Cycle { source, fcb, points });
        let mut event = None;
        if !fcv || self.cycle != cycle {
            let response;
            (response, event) = self.dp.serve(points, source, data, now_ms);
            self.cycle = cycle;
            self.answer_len = self.write(response, telegram);
        }
        self.dp.receive(source, now_ms);
        let not_before_bits = self.not_before_bits();
        let bytes = self.answer.get(..self.answer_len).unwrap_or_default();
        Outcome { event, answer: Some(Answer { bytes, not_before_bits }) }
    }

    fn not_before_bits(&self) -> u32 {
        MIN_TSDR_BITS.max(self.dp.min_tsdr_bits().into())
    }

    /// Writes the answer to a request. Returns its length.
    fn write(&mut self, response: Response, request: &Telegram<'_>) -> usize {
        let Self { dp, answer, .. } = self;
        let (master, station) = (request.source, request.destination);
        // Swapped: the answer goes back to the source of the request.
        let points = request.ssap.zip(request.dsap).map(|(ssap, dsap)| [ssap, dsap]);
        let standard;
        let (function_code, points, data): (_, _, [&[u8]; 2]) = match response {
            Response::Acknowledge => return put(answer, &[SC]),
            Response::NoService => return put(answer, &sd1(master, station, NO_SERVICE)),
            Response::Exchange { high_priority: false } if I == 0 => return put(answer, &[SC]),
            Response::Exchange { high_priority: true } if I == 0 => {
                return put(answer, &sd1(master, station, DATA_HIGH));
            }
            Response::Exchange { high_priority } => {
                let function_code = if high_priority { DATA_HIGH } else { DATA_LOW };
                (function_code, None, [dp.inputs(), &[]])
            }
            Response::Inputs => (DATA_LOW, points, [dp.inputs(), &[]]),
            Response::Outputs => (DATA_LOW, points, [dp.outputs(), &[]]),
            Response::Configuration => {
                let config = dp.configuration();
                (DATA_LOW, points, [config.get(..MAX_DATA_LEN).unwrap_or(config), &[]])
            }
            Response::Diagnosis(first) => {
                standard = first;
                (DATA_LOW, points, [&standard, dp.diagnosis()])
            }
        };
        write_sd2(answer, [master, station, function_code], points, data)
    }
}

fn put(answer: &mut [u8; MAX_TELEGRAM_LEN], bytes: &[u8]) -> usize {
    for (place, byte) in answer.iter_mut().zip(bytes) {
        *place = *byte;
    }
    bytes.len()
}

#[cfg(test)]
mod tests;
