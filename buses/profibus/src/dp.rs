//! DP state machine (EN 50170-2, part 8; IEC 61158-6-3): lock by a master, outputs, inputs, diagnosis.

mod parameters;

use core::ops::BitOr;

use self::parameters::{Parameters, SetPrm};
use crate::profile::MAX_ADDRESS;
use crate::{Address, Cause, Event, Profile, STANDARD_DIAGNOSIS_LEN, State};

/// Service access points of a slave.
const SET_SLAVE_ADDRESS: u8 = 55;
const RD_INP: u8 = 56;
const RD_OUTP: u8 = 57;
const GLOBAL_CONTROL: u8 = 58;
const GET_CFG: u8 = 59;
const SLAVE_DIAG: u8 = 60;
const SET_PRM: u8 = 61;
const CHK_CFG: u8 = 62;
/// Service access point of a master for all of these services.
const MASTER: u8 = 62;

/// Bits of Station_status_1.
const STATION_NOT_READY: u8 = 1 << 1;
const CFG_FAULT: u8 = 1 << 2;
const EXT_DIAG: u8 = 1 << 3;
const NOT_SUPPORTED: u8 = 1 << 4;
const PRM_FAULT: u8 = 1 << 6;
/// Bits of Station_status_2.
const PRM_REQ: u8 = 1;
const ALWAYS: u8 = 1 << 2;
const WD_ON: u8 = 1 << 3;
const FREEZE_MODE: u8 = 1 << 4;
const SYNC_MODE: u8 = 1 << 5;
/// Bits of Station_status_3.
const EXT_DIAG_OVERFLOW: u8 = 1 << 7;
/// Diag.Master_Add without a master.
const NO_MASTER: u8 = 0xFF;

/// Control_Command of Global_Control. If both bits of a pair are set, the mode ends.
const CLEAR_DATA: u8 = 1 << 1;
const UNFREEZE: u8 = 1 << 2;
const FREEZE: u8 = 1 << 3;
const UNSYNC: u8 = 1 << 4;
const SYNC: u8 = 1 << 5;

/// Response to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Response {
    /// Short acknowledgement (SC).
    Acknowledge,
    /// No service activated (RS).
    NoService,
    /// The inputs; without inputs, only whether a diagnosis is pending.
    Exchange {
        high_priority: bool,
    },
    Inputs,
    Outputs,
    Configuration,
    Diagnosis([u8; STANDARD_DIAGNOSIS_LEN]),
}

/// The master that has locked the slave.
#[derive(Clone, Copy, Debug)]
struct Master {
    address: u8,
    parameters: Parameters,
    /// Time of its last request, in milliseconds.
    received_ms: u32,
    /// Whether it has also sent the correct configuration.
    configured: bool,
}

#[derive(Clone, Debug)]
pub(crate) struct Dp<const O: usize, const I: usize, const D: usize> {
    profile: &'static Profile,
    address: Address,
    master: Option<Master>,
    min_tsdr_bits: u8,
    /// Fault bits of Station_status_1 from the last parameters or configuration.
    faults: u8,
    outputs: [u8; O],
    /// Data of the last Data_Exchange; in Sync mode not yet the outputs.
    received: [u8; O],
    is_synchronised: bool,
    inputs: [u8; I],
    frozen: Option<[u8; I]>,
    diagnosis: [u8; D],
    diagnosis_len: usize,
    diagnosis_is_fault: bool,
    diagnosis_overflow: bool,
    diagnosis_announced: bool,
}

impl<const O: usize, const I: usize, const D: usize> Dp<O, I, D> {
    pub(crate) const fn new(profile: &'static Profile, address: Address) -> Self {
        Self {
            profile,
            address,
            master: None,
            min_tsdr_bits: 0,
            faults: 0,
            outputs: [0; O],
            received: [0; O],
            is_synchronised: false,
            inputs: [0; I],
            frozen: None,
            diagnosis: [0; D],
            diagnosis_len: 0,
            diagnosis_is_fault: false,
            diagnosis_overflow: false,
            diagnosis_announced: false,
        }
    }

    pub(crate) const fn address(&self) -> Address {
        self.address
    }

    pub(crate) const fn set_address(&mut self, address: Address) {
        self.address = address;
    }

    pub(crate) fn state(&self) -> State {
        match &self.master {
            None => State::WaitPrm,
            Some(master) if !master.configured => State::WaitCfg,
            Some(_) => State::DataExch,
        }
    }

    pub(crate) fn master(&self) -> Option<u8> {
        self.master.map(|master| master.address)
    }

    pub(crate) const fn min_tsdr_bits(&self) -> u8 {
        self.min_tsdr_bits
    }

    pub(crate) const fn outputs(&self) -> &[u8; O] {
        &self.outputs
    }

    pub(crate) const fn configuration(&self) -> &'static [u8] {
        self.profile.config
    }

    /// Returns the inputs for the master, frozen if in Freeze mode.
    pub(crate) fn inputs(&self) -> &[u8; I] {
        self.frozen.as_ref().unwrap_or(&self.inputs)
    }

    pub(crate) const fn show_inputs(&mut self, inputs: &[u8; I]) {
        self.inputs = *inputs;
    }

    /// Returns the device-specific part of the diagnosis.
    pub(crate) fn diagnosis(&self) -> &[u8] {
        self.diagnosis.get(..self.diagnosis_len).unwrap_or_default()
    }

    pub(crate) fn show_diagnosis(&mut self, bytes: &[u8], is_fault: bool) {
        for (place, byte) in self.diagnosis.iter_mut().zip(bytes) {
            *place = *byte;
        }
        self.diagnosis_len = bytes.len().min(D);
        self.diagnosis_overflow = bytes.len() > D;
        self.diagnosis_is_fault = is_fault;
    }

    pub(crate) const fn announce_diagnosis(&mut self) {
        self.diagnosis_announced = true;
    }

    /// Returns the time until the watchdog expires without a request, in milliseconds.
    pub(crate) fn time_left_ms(&self, now_ms: u32) -> Option<u32> {
        let Master { received_ms, parameters, .. } = self.master?;
        let silence_ms = now_ms.wrapping_sub(received_ms);
        Some(parameters.watchdog_ms?.saturating_add(1).saturating_sub(silence_ms))
    }

    /// Returns whether the master's watchdog has expired.
    pub(crate) fn is_expired(&self, now_ms: u32) -> bool {
        self.time_left_ms(now_ms) == Some(0)
    }

    /// Restarts the watchdog if `source` is the slave's master. Call it for each request to this station.
    pub(crate) fn receive(&mut self, source: u8, now_ms: u32) {
        if let Some(master) = self.master_if(source) {
            master.received_ms = now_ms;
        }
    }

    fn master_if(&mut self, address: u8) -> Option<&mut Master> {
        self.master.as_mut().filter(|master| master.address == address)
    }

    /// Releases the slave from its master. Outputs are 0 until the next data exchange.
    pub(crate) fn leave(&mut self, cause: Cause) -> Option<Event> {
        let was_exchanging = self.state() == State::DataExch;
        self.master = None;
        self.outputs = [0; O];
        self.received = [0; O];
        self.is_synchronised = false;
        self.frozen = None;
        was_exchanging.then_some(Event::Left(cause))
    }

    /// Serves a request that requires data in response, identified by its service access points.
    pub(crate) fn serve(
        &mut self,
        points: (Option<u8>, Option<u8>),
        source: u8,
        data: &[u8],
        now_ms: u32,
    ) -> (Response, Option<Event>) {
        let is_exchanging = self.state() == State::DataExch;
        match (points, data) {
            ((None, None), _) => self.data_exchange(source, data),
            ((Some(SLAVE_DIAG), Some(MASTER)), []) => {
                if self.master() == Some(source) {
                    self.diagnosis_announced = false;
                }
                (Response::Diagnosis(self.standard_diagnosis()), None)
            }
            ((Some(SET_PRM), Some(MASTER)), _) => self.set_prm(source, data, now_ms),
            ((Some(CHK_CFG), Some(MASTER)), _) => self.chk_cfg(source, data),
            ((Some(GET_CFG), Some(MASTER)), []) => (Response::Configuration, None),
            ((Some(RD_INP), Some(MASTER)), []) if is_exchanging => (Response::Inputs, None),
            ((Some(RD_OUTP), Some(MASTER)), []) if is_exchanging => (Response::Outputs, None),
            ((Some(SET_SLAVE_ADDRESS), Some(MASTER)), _) => self.set_slave_address(data),
            _ => (Response::NoService, None),
        }
    }

    fn data_exchange(&mut self, source: u8, data: &[u8]) -> (Response, Option<Event>) {
        if self.master() != Some(source) || self.state() != State::DataExch {
            return (Response::NoService, None);
        }
        let event = if let Ok(outputs) = <&[u8; O]>::try_from(data) {
            self.received = *outputs;
            self.take_received()
        } else if data.is_empty() && self.profile.fail_safe {
            Some(self.clear())
        } else {
            self.faults |= CFG_FAULT;
            return (Response::NoService, self.leave(Cause::OutputLength));
        };
        (Response::Exchange { high_priority: self.diagnosis_announced }, event)
    }

    /// Applies received outputs, unless they wait for a Sync.
    const fn take_received(&mut self) -> Option<Event> {
        if self.is_synchronised {
            return None;
        }
        self.outputs = self.received;
        Some(Event::Outputs)
    }

    const fn clear(&mut self) -> Event {
        self.received = [0; O];
        self.outputs = [0; O];
        Event::Cleared
    }

    fn set_prm(&mut self, source: u8, data: &[u8], now_ms: u32) -> (Response, Option<Event>) {
        if self.master().is_some_and(|master| master != source) {
            return (Response::NoService, None);
        }
        let event = match SetPrm::of(data, self.profile) {
            SetPrm::MinTsdr(bits) => {
                self.set_min_tsdr(bits);
                None
            }
            SetPrm::Unlock => self.leave(Cause::Unlocked),
            SetPrm::Fault => {
                self.faults = PRM_FAULT;
                self.leave(Cause::Parameters)
            }
            SetPrm::NotSupported => {
                self.faults = NOT_SUPPORTED;
                self.leave(Cause::Parameters)
            }
            SetPrm::Lock(parameters) => {
                let event = self.leave(Cause::Parameters);
                self.faults = 0;
                self.set_min_tsdr(parameters.min_tsdr_bits);
                self.master =
                    Some(Master { address: source, parameters, received_ms: now_ms, configured: false });
                event
            }
        };
        // The request is always acknowledged; the diagnosis reports errors.
        (Response::Acknowledge, event)
    }

    const fn set_min_tsdr(&mut self, bits: u8) {
        if bits != 0 {
            self.min_tsdr_bits = bits;
        }
    }

    fn chk_cfg(&mut self, source: u8, data: &[u8]) -> (Response, Option<Event>) {
        if self.master.is_none() {
            // The parameters were rejected, or the watchdog has expired. After an acknowledgement, masters read the
            // diagnosis, which reports it. After a rejection, publicly available masters restart without reading it.
            return (Response::Acknowledge, None);
        }
        let is_right = data == self.profile.config;
        let Some(master) = self.master_if(source) else { return (Response::NoService, None) };
        if is_right {
            master.configured = true;
            return (Response::Acknowledge, None);
        }
        self.faults = CFG_FAULT;
        (Response::Acknowledge, self.leave(Cause::Configuration))
    }

    fn set_slave_address(&mut self, data: &[u8]) -> (Response, Option<Event>) {
        let &[station, high, low, locked, ..] = data else { return (Response::NoService, None) };
        let is_allowed = self.profile.set_address && !self.address.locked && self.master.is_none();
        let is_right = u16::from_be_bytes([high, low]) == self.profile.ident && station <= MAX_ADDRESS;
        if !is_allowed || !is_right {
            return (Response::NoService, None);
        }
        self.address = Address { station, locked: locked != 0 };
        (Response::Acknowledge, Some(Event::Address(self.address)))
    }

    /// Executes a request without an answer. Global_Control is the only one supported.
    pub(crate) fn control(
        &mut self,
        points: (Option<u8>, Option<u8>),
        source: u8,
        data: &[u8],
    ) -> Option<Event> {
        let &[command, groups] = data else { return None };
        let Master { address, parameters, configured, .. } = self.master?;
        let is_concerned = groups == 0 || groups & parameters.group != 0;
        let is_global_control = points == (Some(GLOBAL_CONTROL), Some(MASTER));
        if !is_global_control || address != source || !configured || !is_concerned {
            return None;
        }
        let cleared = (command & CLEAR_DATA != 0).then(|| self.clear());
        if command & UNFREEZE != 0 {
            self.frozen = None;
        } else if command & FREEZE != 0 && parameters.freeze {
            self.frozen = Some(self.inputs);
        }
        let released = if command & UNSYNC != 0 {
            self.release(false)
        } else if command & SYNC != 0 && parameters.sync {
            self.release(true)
        } else {
            None
        };
        cleared.or(released)
    }

    /// Applies waiting outputs. Then starts or ends Sync mode.
    const fn release(&mut self, synchronised: bool) -> Option<Event> {
        let waited = core::mem::replace(&mut self.is_synchronised, synchronised);
        self.outputs = self.received;
        if waited { Some(Event::Outputs) } else { None }
    }

    /// Returns the standard six bytes of the diagnosis.
    fn standard_diagnosis(&self) -> [u8; STANDARD_DIAGNOSIS_LEN] {
        let status_1 = status(&[
            (self.faults, true),
            (STATION_NOT_READY, self.state() != State::DataExch),
            (EXT_DIAG, self.diagnosis_is_fault),
        ]);
        let is_watched = self.master.is_some_and(|master| master.parameters.watchdog_ms.is_some());
        let status_2 = status(&[
            (PRM_REQ, self.master.is_none()),
            (ALWAYS, true),
            (WD_ON, is_watched),
            (FREEZE_MODE, self.frozen.is_some()),
            (SYNC_MODE, self.is_synchronised),
        ]);
        let status_3 = status(&[(EXT_DIAG_OVERFLOW, self.diagnosis_overflow)]);
        let [high, low] = self.profile.ident.to_be_bytes();
        [status_1, status_2, status_3, self.master().unwrap_or(NO_MASTER), high, low]
    }
}

/// Combines the bits that are set.
fn status(bits: &[(u8, bool)]) -> u8 {
    bits.iter().filter(|(_, is_set)| *is_set).map(|(bit, _)| *bit).fold(0, BitOr::bitor)
}
