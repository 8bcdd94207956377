//! The device: NMT, heartbeats, SYNC, PDOs and emergencies, between the frames of a bus and the application.

mod pdo;
mod server;

use embedded_can::{Frame, Id, StandardId};
use heapless::Deque;

use self::pdo::Tpdo;
use crate::clock::{age, since};
use crate::emergency::{Emergency, Message};
use crate::sdo::{Download, Upload};
use crate::{Cause, Config, Dictionary, Fault, Pdo};

/// NMT state of a device (CiA 301, 7.3.2), with its code in the heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum NmtState {
    /// The device has not sent its boot-up message yet.
    Initialising = 0,
    /// NMT and heartbeat only: no PDOs, no SDO, no emergencies.
    Stopped = 4,
    /// All services, including PDOs.
    Operational = 5,
    /// All services except PDOs.
    PreOperational = 127,
}

/// Properties of an RPDO.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rpdo {
    /// Length by the mapping in bytes, at most 8. RPDOs of another length are rejected.
    pub len: u8,
    /// Bits that request a stop. A later RPDO does not clear them when the event queue is full (see
    /// [`Device::poll_event`]), and an RPDO with one of them set does not wait for a SYNC.
    pub keep: [u8; 8],
}

/// Fixed properties of a device: its PDOs and the faults that it reports.
#[derive(Clone, Copy, Debug)]
pub struct Profile<const R: usize, const T: usize> {
    /// RPDOs on the identifiers of the predefined connection set: 200h + node, 300h + node, ...
    pub rpdos: [Rpdo; R],
    /// Lengths of the TPDOs in bytes, at most 8 each, on 180h + node, 280h + node, ...
    pub tpdos: [u8; T],
    /// Faults, up to 16. New faults are reported in order of this table.
    pub faults: &'static [Fault],
}

/// An event from the bus for the application.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// An RPDO has taken effect.
    Rpdo {
        /// Number of the RPDO, from 0.
        number: u8,
        /// Data of the RPDO, padded with 0 to 8 bytes.
        data: [u8; 8],
    },
    /// An SDO request was served.
    Sdo {
        /// Whether it wrote a value of the application.
        written: bool,
    },
    /// No master commands over the bus any more. The master took the device out of operation, disabled an RPDO,
    /// restarted or timed out, or the bus was lost.
    Left {
        /// Whether the cause is a time-out of the master.
        master_silent: bool,
    },
    /// NMT reset. The device has returned to its power-up state.
    Reset {
        /// Whether it was a node reset, so that the application must return to its power-up state too.
        application: bool,
    },
}

/// State after loss of the bus or the master (1029h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum ErrorBehaviour {
    PreOperational = 0,
    NoChange = 1,
    Stopped = 2,
}

/// A CANopen device with `R` RPDOs and `T` TPDOs, at most four each, and a queue of `Q` events. Reserve one event per
/// frame between two turns of the main loop, and another `R` for a SYNC if a master may make RPDOs synchronous.
///
/// In each turn of the main loop:
/// 1. Pass the received frames to [`on_frame`](Self::on_frame).
/// 2. Take the events from [`poll_event`](Self::poll_event).
/// 3. Update data and faults by [`show_tpdo`](Self::show_tpdo) and [`show_faults`](Self::show_faults).
/// 4. Send the frames that [`poll_transmit`](Self::poll_transmit) returns.
///
/// Times are milliseconds of any clock that wraps at 2^32.
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
    download: Option<Download>,
    /// Index and subindex of a write in progress, and the toggle bit of its segment, if any.
    writing: Option<(u16, u8, Option<bool>)>,
    /// Whether the master's heartbeat is monitored (1016h).
    watches_heartbeat: bool,
    error_behaviour: ErrorBehaviour,
    /// Time of the master's last heartbeat or RPDO; `None` if none was received or it timed out.
    received_at: Option<u32>,
    /// Whether a heartbeat was received. From then on, RPDOs do not count for monitoring.
    has_heartbeat: bool,
    master_silent: bool,
    /// Time of the device's last heartbeat.
    beat_at: Option<u32>,
    rpdos: [pdo::Rpdo; R],
    tpdos: [Tpdo; T],
    emergency: Emergency,
    /// Manufacturer-specific field of emergencies.
    field: [u8; 5],
}

impl<const R: usize, const T: usize, const Q: usize> Device<R, T, Q> {
    /// Creates a device that has not sent its boot-up message yet.
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
            download: None,
            writing: None,
            watches_heartbeat: true,
            error_behaviour: ErrorBehaviour::PreOperational,
            received_at: None,
            has_heartbeat: false,
            master_silent: false,
            beat_at: None,
            rpdos: [pdo::Rpdo::NEW; R],
            tpdos: [Tpdo::NEW; T],
            emergency: Emergency::new(),
            field: [0; 5],
        }
    }

    /// Returns the present NMT state.
    #[must_use]
    pub const fn state(&self) -> NmtState {
        self.state
    }

    /// Processes a received frame. Ignores frames for other nodes.
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

    /// Returns the next event, or `None` if no event is pending. This call also serves SDO requests from the dictionary and
    /// detects the time-out of the master.
    ///
    /// Call it until it returns `None`, before more than `Q` frames have been received. If the queue is full, an RPDO
    /// replaces the newest event, provided that this is an RPDO of the same number. Bits of [`Rpdo::keep`] that were set
    /// in the replaced event stay set. All other events are lost.
    pub fn poll_event<D: Dictionary>(&mut self, now_ms: u32, dictionary: &mut D) -> Option<Event> {
        if let Some(event) = self.events.pop_front() {
            if let Event::Reset { .. } = event {
                // Only another reset can follow before the device has sent its boot-up message, so the queue is kept.
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
        let is_silent = self.received_at.as_mut().is_some_and(|at| age(now_ms, at) >= time_ms) && time_ms > 0;
        if !is_silent {
            return None;
        }
        self.master_silent = true;
        self.forget_waiting();
        self.end_operation();
        Some(Event::Left { master_silent: true })
    }

    /// Sets the data of a TPDO, numbered from 0. It is sent on change or when its event timer expires.
    pub fn show_tpdo(&mut self, number: usize, data: [u8; 8]) {
        if let Some(tpdo) = self.tpdos.get_mut(number) {
            tpdo.shown = data;
        }
    }

    /// Sets the faults present in the application, bit n for fault n of the table, and the
    /// manufacturer-specific field of subsequent emergencies.
    pub fn show_faults(&mut self, present: u16, field: [u8; 5]) {
        self.field = field;
        self.emergency.see(self.profile.faults, present, self.master_silent, self.info());
    }

    /// Returns the next frame to send, or `None` if none is due.
    pub fn poll_transmit<F: Frame>(&mut self, now_ms: u32) -> Option<F> {
        let (base, data, len) = self.due(now_ms)?;
        let id = StandardId::new(base | u16::from(self.config.node))?;
        F::new(id, data.get(..len)?)
    }

    /// Returns whether this device sends frames with this identifier.
    #[must_use]
    pub fn sends(&self, id: Id) -> bool {
        matches!(id, Id::Standard(id) if id.as_raw() & 0x7F == u16::from(self.config.node))
    }

    /// Notifies the device that frames were not sent. It repeats TPDOs and heartbeat at once;
    /// SDO clients repeat requests themselves.
    pub fn frames_lost(&mut self) {
        self.send_all_again();
    }

    /// Notifies the device that the bus is lost. Because no master could stop it any more, the device leaves operation,
    /// unless its master has configured otherwise (1029h). If operational, it reports [`Event::Left`] in either case.
    pub fn bus_lost(&mut self) {
        self.forget_transfer();
        self.fall_back();
    }

    /// Notifies the device that the bus is available again. It reports [`Cause::BusOff`]
    /// and repeats TPDOs and heartbeat.
    pub fn bus_joined(&mut self) {
        self.forget_transfer();
        self.emergency.happened(self.profile.faults, Cause::BusOff, self.info());
        self.send_all_again();
    }

    fn forget_transfer(&mut self) {
        (self.request, self.response, self.upload) = (None, None, None);
        (self.download, self.writing) = (None, None);
    }

    /// Returns the byte recorded with a fault: the last one of the manufacturer-specific field.
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
        (self.received_at, self.has_heartbeat) = (None, false);
    }

    /// Executes an NMT command for this device.
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
            // The boot-up message after a reset is still pending.
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

    /// Reports that the master has stopped commanding, and discards its pending data.
    fn leave(&mut self) {
        self.forget_waiting();
        if self.state == NmtState::Operational {
            self.push(Event::Left { master_silent: false });
        }
    }

    /// Discards RPDOs that wait for a SYNC, because their master has stopped commanding.
    fn forget_waiting(&mut self) {
        for rpdo in &mut self.rpdos {
            rpdo.waiting = None;
        }
    }

    /// Handles loss of the bus or the master.
    fn fall_back(&mut self) {
        self.leave();
        self.end_operation();
    }

    /// Leaves operation as configured by 1029h, and waits for a master to start the device again.
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
            self.note_master(now_ms);
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
            // Boot-up message: a restarted master does not know its previous commands.
            [0] if self.received_at.is_some() => self.fall_back(),
            [0] => {}
            [_] => {
                self.note_master(now_ms);
                self.has_heartbeat = true;
            }
            _ => {}
        }
    }

    fn note_master(&mut self, now_ms: u32) {
        self.received_at = Some(now_ms);
        // A device that stayed operational needs no new start.
        self.master_silent &= self.state != NmtState::Operational;
    }

    /// Returns the next frame to send: identifier without the node-ID, data and length.
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

/// Converts an inhibit time from units of 100 µs, rounding up.
const fn milliseconds(inhibit: u16) -> u32 {
    (inhibit as u32).div_ceil(10)
}

/// Returns the identifier of a PDO without the node-ID.
const fn identifier(pdo: Pdo) -> u16 {
    (pdo.base_cob_id() & 0x7FF) as u16
}
