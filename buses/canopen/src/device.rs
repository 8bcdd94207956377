//! The device: NMT, heartbeats, SYNC, PDOs and emergencies, between the frames of a bus and the application.

mod pdo;
mod server;

use embedded_can::{Frame, Id, StandardId};
use heapless::Deque;

use self::pdo::Tpdo;
use crate::clock::since;
use crate::emergency::{Emergency, Message};
use crate::sdo::Upload;
use crate::{Cause, Config, Dictionary, Fault, Pdo};

/// The state of a device (CiA 301, 7.3.2), by its code in the heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// It has not announced itself yet.
    Initialising = 0,
    /// No PDOs, no SDO.
    Stopped = 4,
    /// All of it.
    Operational = 5,
    /// No PDOs.
    PreOperational = 127,
}

/// An RPDO of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rpdo {
    /// Its length by the mapping, in bytes, 8 at the most. One of another length is not taken.
    pub len: u8,
    /// Requests to stop: bits that a later RPDO does not take back when there is no room for both (see
    /// [`Device::poll_event`]), and that wait for no SYNC.
    pub keep: [u8; 8],
}

/// What is fixed about a device: its PDOs and the faults that it tells.
#[derive(Clone, Copy, Debug)]
pub struct Profile<const R: usize, const T: usize> {
    /// The RPDOs, on the identifiers of the predefined connection set: 200h + node, 300h + node, ...
    pub rpdos: [Rpdo; R],
    /// The lengths of the TPDOs in bytes, 8 at the most, on 180h + node, 280h + node, ...
    pub tpdos: [u8; T],
    /// The faults, up to 16. The first that is new is told first.
    pub faults: &'static [Fault],
}

/// What came from the bus, for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// An RPDO.
    Rpdo {
        /// Which, counted from 0.
        number: u8,
        /// Its bytes; those behind its length are 0.
        data: [u8; 8],
    },
    /// A master asked for something by SDO.
    Sdo {
        /// It wrote a value of the application.
        written: bool,
    },
    /// Nobody commands over the bus any more: the master took the device out of operation, disabled an RPDO, restarted or fell
    /// silent, or the bus is gone.
    Left {
        /// Because the master fell silent.
        master_silent: bool,
    },
    /// NMT: reset communication. The device itself is as it was at power-up.
    Reset {
        /// Reset node: the application too is to be as it was at power-up.
        application: bool,
    },
}

/// What becomes of operation when the bus or the master is lost (1029h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum ErrorBehaviour {
    PreOperational = 0,
    NoChange = 1,
    Stopped = 2,
}

/// A CANopen device with `R` RPDOs and `T` TPDOs, up to four each, and room for `Q` events: one for each frame between two
/// turns, and `R` for a SYNC where a master may set RPDOs to wait for it.
///
/// In each turn of the main loop: hand over what the bus brought ([`on_frame`](Self::on_frame)), take the events
/// ([`poll_event`](Self::poll_event)), show what has changed ([`show_tpdo`](Self::show_tpdo),
/// [`show_faults`](Self::show_faults)), and send what is due ([`poll_transmit`](Self::poll_transmit)). Times are
/// milliseconds of any clock that wraps.
#[derive(Clone, Debug)]
pub struct Device<const R: usize, const T: usize, const Q: usize> {
    profile: &'static Profile<R, T>,
    config: Config<T>,
    initial: Config<T>,
    state: NmtState,
    events: Deque<Event, Q>,
    request: Option<[u8; 8]>,
    response: Option<[u8; 8]>,
    upload: Option<Upload>,
    /// Index and subindex of what a client has written, while it goes on.
    writing: Option<(u16, u8)>,
    /// The master whose heartbeat is watched is at work (1016h).
    watches_heartbeat: bool,
    error_behaviour: ErrorBehaviour,
    /// When the master was heard last; none when it was not, or too long ago.
    heard_at: Option<u32>,
    /// By its heartbeat, which from then on counts alone.
    has_heartbeat: bool,
    master_silent: bool,
    /// When the own heartbeat was sent.
    beat_at: Option<u32>,
    rpdos: [pdo::Rpdo; R],
    tpdos: [Tpdo; T],
    emergency: Emergency,
    /// The manufacturer's field of an emergency.
    field: [u8; 5],
}

impl<const R: usize, const T: usize, const Q: usize> Device<R, T, Q> {
    /// A device that has not announced itself.
    #[must_use]
    pub const fn new(profile: &'static Profile<R, T>, config: Config<T>) -> Self {
        const { assert!(R <= 4 && T <= 4 && Q > 0, "the predefined connection set has four PDOs each way") }
        Self {
            profile,
            config,
            initial: config,
            state: NmtState::Initialising,
            events: Deque::new(),
            request: None,
            response: None,
            upload: None,
            writing: None,
            watches_heartbeat: true,
            error_behaviour: ErrorBehaviour::PreOperational,
            heard_at: None,
            has_heartbeat: false,
            master_silent: false,
            beat_at: None,
            rpdos: [pdo::Rpdo::NEW; R],
            tpdos: [Tpdo::NEW; T],
            emergency: Emergency::new(),
            field: [0; 5],
        }
    }

    /// Its state.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.state
    }

    /// Takes a frame of the bus; those for others change nothing.
    pub fn on_frame<F: Frame>(&mut self, now_ms: u32, frame: &F) {
        let Id::Standard(id) = frame.id() else { return };
        if frame.is_remote_frame() {
            return;
        }
        let (id, data) = (id.as_raw(), frame.data());
        let node = u16::from(self.config.node);
        if id == 0 {
            if let &[specifier, whom] = data
                && (whom == 0 || whom == self.config.node)
            {
                self.command(specifier);
            }
        } else if id == 0x080 {
            if data.len() <= 1 {
                self.take_sync();
            }
        } else if id == 0x600 | node {
            if matches!(self.state, NmtState::PreOperational | NmtState::Operational) {
                self.request = <[u8; 8]>::try_from(data).ok().or(self.request);
            }
        } else if id == 0x700 | u16::from(self.config.master) {
            self.take_heartbeat(now_ms, data);
        } else if id & 0x7F == node
            && let Some(number) = (0..R as u8).find(|number| id == identifier(Pdo::Receive(*number)) | node)
        {
            self.take_rpdo(now_ms, number, data);
        }
    }

    /// The next event; none when there is nothing to do. An SDO request is answered here, from the dictionary, and here the
    /// master is found silent.
    ///
    /// To be called until it gives none, before more than `Q` frames have come. Where that is missed, an RPDO takes the
    /// place of the newest event, if that is an RPDO of the same number, and only the bits of [`Rpdo::keep`] are kept of
    /// it; every other event is lost.
    pub fn poll_event<D: Dictionary>(&mut self, now_ms: u32, dictionary: &mut D) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            if let Event::Reset { .. } = event {
                // Behind a reset nothing but another counts before the device has announced itself: that stays.
                let events = core::mem::take(&mut self.events);
                *self = Self::new(self.profile, self.initial);
                self.events = events;
            }
            return Some(event);
        }
        if let Some(request) = self.request.take() {
            return Some(Event::Sdo { written: self.answer(now_ms, &request, dictionary) });
        }
        self.confirm(dictionary);
        let time_ms = u32::from(dictionary.consumer_time_ms());
        let is_silent = time_ms > 0 && self.heard_at.is_some_and(|at| since(now_ms, at) >= time_ms);
        if !is_silent {
            return None;
        }
        self.master_silent = true;
        self.forget_waiting();
        self.end_operation();
        Some(Event::Left { master_silent: true })
    }

    /// What a TPDO, counted from 0, carries from now on. It is sent when it has changed or its event timer has run out.
    pub fn show_tpdo(&mut self, number: usize, data: [u8; 8]) {
        if let Some(tpdo) = self.tpdos.get_mut(number) {
            tpdo.shown = data;
        }
    }

    /// The faults that the application sees now, bit n for fault n of the table, and the manufacturer's field of the
    /// emergencies that are told from now on.
    pub fn show_faults(&mut self, present: u16, field: [u8; 5]) {
        self.field = field;
        self.emergency.see(self.profile.faults, present, self.master_silent, self.info());
    }

    /// The next frame that is due.
    pub fn poll_transmit<F: Frame>(&mut self, now_ms: u32) -> Option<F> {
        let (base, data, len) = self.due(now_ms)?;
        let id = StandardId::new(base | u16::from(self.config.node))?;
        F::new(id, data.get(..len)?)
    }

    /// Whether frames with this identifier are the device's own.
    #[must_use]
    pub fn sends(&self, id: Id) -> bool {
        matches!(id, Id::Standard(id) if id.as_raw() & 0x7F == u16::from(self.config.node))
    }

    /// Frames that it gave will not leave. What is cyclic comes again at once; a client of SDO asks again by itself.
    pub fn frames_lost(&mut self) {
        self.send_all_again();
    }

    /// The bus is gone. Nobody could stop the device any more, so it leaves operation, unless its master asked for something
    /// else (1029h); the event comes in any case.
    pub fn bus_lost(&mut self) {
        self.forget_transfer();
        self.fall_back();
    }

    /// The bus is there again.
    pub fn bus_joined(&mut self) {
        self.forget_transfer();
        self.emergency.happened(self.profile.faults, Cause::BusOff, self.info());
        self.send_all_again();
    }

    fn forget_transfer(&mut self) {
        (self.request, self.response, self.upload, self.writing) = (None, None, None, None);
    }

    /// What is remembered with a fault.
    const fn info(&self) -> u8 {
        let [.., last] = self.field;
        last
    }

    fn send_all_again(&mut self) {
        for tpdo in &mut self.tpdos {
            tpdo.send_again();
        }
        self.beat_at = None;
    }

    fn forget_master(&mut self) {
        (self.heard_at, self.has_heartbeat) = (None, false);
    }

    /// NMT: what the master does with the device.
    fn command(&mut self, specifier: u8) {
        let state = match specifier {
            0x01 => NmtState::Operational,
            0x02 => NmtState::Stopped,
            0x80 => NmtState::PreOperational,
            0x81 | 0x82 => {
                self.leave();
                self.state = NmtState::Initialising;
                self.push(Event::Reset { application: specifier == 0x81 });
                return;
            }
            _ => return,
        };
        if self.state == NmtState::Initialising {
            // It has not announced itself again yet.
            return;
        }
        if state == NmtState::Operational {
            self.master_silent = false;
            if self.state != state {
                for tpdo in &mut self.tpdos {
                    tpdo.send_again();
                }
            }
        } else {
            self.leave();
        }
        if state == NmtState::Stopped {
            self.forget_transfer();
        }
        self.state = state;
    }

    /// Nobody commands over the bus any more.
    fn leave(&mut self) {
        self.forget_waiting();
        if self.state == NmtState::Operational {
            self.push(Event::Left { master_silent: false });
        }
    }

    /// What waits for a SYNC was commanded by somebody who does not command any more.
    fn forget_waiting(&mut self) {
        for rpdo in &mut self.rpdos {
            rpdo.waiting = None;
        }
    }

    /// The bus or the master is lost.
    fn fall_back(&mut self) {
        self.leave();
        self.end_operation();
    }

    /// Waits for a master that starts the device again, as far as 1029h lets it.
    fn end_operation(&mut self) {
        if self.state == NmtState::Operational {
            self.state = match self.error_behaviour {
                ErrorBehaviour::PreOperational => NmtState::PreOperational,
                ErrorBehaviour::NoChange => NmtState::Operational,
                ErrorBehaviour::Stopped => NmtState::Stopped,
            };
        }
        self.forget_master();
    }

    fn push(&mut self, event: Event) {
        if self.events.push_back(event).is_ok() {
            return;
        }
        let (Some(Event::Rpdo { number: last, data: kept }), Event::Rpdo { number, data }) =
            (self.events.back_mut(), event)
        else {
            return;
        };
        let Some(rpdo) = self.profile.rpdos.get(usize::from(number)).filter(|_| *last == number) else {
            return;
        };
        for ((kept, new), keep) in kept.iter_mut().zip(data).zip(rpdo.keep) {
            *kept = *kept & keep | new;
        }
    }

    fn take_sync(&mut self) {
        if self.state != NmtState::Operational {
            return;
        }
        for number in 0..R as u8 {
            if let Some(data) = self.rpdos.get_mut(usize::from(number)).and_then(pdo::Rpdo::on_sync) {
                self.push(Event::Rpdo { number, data });
            }
        }
        for tpdo in &mut self.tpdos {
            tpdo.on_sync();
        }
    }

    fn take_rpdo(&mut self, now_ms: u32, number: u8, data: &[u8]) {
        let at = usize::from(number);
        let info = self.info();
        let (Some(profile), Some(rpdo)) = (self.profile.rpdos.get(at), self.rpdos.get_mut(at)) else {
            return;
        };
        if self.state != NmtState::Operational || !rpdo.setup.is_enabled {
            return;
        }
        if data.len() != usize::from(profile.len) {
            self.emergency.happened(self.profile.faults, Cause::PdoLength, info);
            return;
        }
        let mut bytes = [0; 8];
        for (place, byte) in bytes.iter_mut().zip(data) {
            *place = *byte;
        }
        let counts = rpdo.receive(bytes, profile.keep);
        if !self.has_heartbeat {
            self.hear_master(now_ms);
        }
        if let Some(data) = counts {
            self.push(Event::Rpdo { number, data });
        }
    }

    fn take_heartbeat(&mut self, now_ms: u32, data: &[u8]) {
        if !self.watches_heartbeat {
            return;
        }
        match data {
            // A boot-up: a master that restarts does not know what it has commanded.
            [0] if self.heard_at.is_some() => self.fall_back(),
            [0] => {}
            [_] => {
                self.hear_master(now_ms);
                self.has_heartbeat = true;
            }
            _ => {}
        }
    }

    fn hear_master(&mut self, now_ms: u32) {
        self.heard_at = Some(now_ms);
        // A device that stayed in operation is not started again.
        self.master_silent &= self.state != NmtState::Operational;
    }

    /// The next frame that is due: its identifier without the node-ID, and its data.
    fn due(&mut self, now_ms: u32) -> Option<(u16, [u8; 8], usize)> {
        if self.state == NmtState::Initialising {
            self.state = NmtState::PreOperational;
            self.beat_at = Some(now_ms);
            return Some((0x700, [0; 8], 1));
        }
        if self.state != NmtState::Stopped {
            let inhibit_ms = milliseconds(self.config.emergency_inhibit);
            let emergency = self.emergency.next(self.profile.faults, now_ms, inhibit_ms);
            if let Some(Message { code, register }) = emergency {
                let [low, high] = code.to_le_bytes();
                let [a, b, c, d, e] = self.field;
                return Some((0x080, [low, high, register, a, b, c, d, e], 8));
            }
            if let Some(response) = self.response.take() {
                return Some((0x580, response, 8));
            }
        }
        if self.state == NmtState::Operational {
            for number in 0..T as u8 {
                if let Some((data, len)) = self.due_tpdo(now_ms, number.into()) {
                    return Some((identifier(Pdo::Transmit(number)), data, len));
                }
            }
        }
        let period_ms = u32::from(self.config.heartbeat_ms);
        if period_ms > 0 && self.beat_at.is_none_or(|at| since(now_ms, at) >= period_ms) {
            self.beat_at = Some(now_ms);
            return Some((0x700, [self.state as u8, 0, 0, 0, 0, 0, 0, 0], 1));
        }
        None
    }

    fn due_tpdo(&mut self, now_ms: u32, number: usize) -> Option<([u8; 8], usize)> {
        let len = usize::from(*self.profile.tpdos.get(number)?);
        let inhibit_ms = milliseconds(*self.config.inhibit.get(number)?);
        let event_ms = u32::from(*self.config.event_ms.get(number)?);
        let data = self.tpdos.get_mut(number)?.due(now_ms, inhibit_ms, event_ms)?;
        Some((data, len))
    }
}

/// An inhibit time, which is given in 100 µs.
const fn milliseconds(inhibit: u16) -> u32 {
    (inhibit as u32).div_ceil(10)
}

/// The identifier of a PDO without its node-ID.
const fn identifier(pdo: Pdo) -> u16 {
    (pdo.base_cob_id() & 0x7FF) as u16
}
