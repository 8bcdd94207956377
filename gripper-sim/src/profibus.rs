//! The line of a PROFIBUS master: received characters and sent telegrams. `bus_profibus` implements the slave and
//! `fieldbus` the images.

use crate::client::Client;
use crate::config::Config;
use crate::device::Device;
use crate::fieldbus::Fieldbus;
use crate::port::{FrameBuffer, PortCounters, PortId};
use crate::time::Time;
use bus_profibus::{Address, Cause, Character, Event, SYNC_BITS};
use heapless::Vec;
use wsg_fieldbus::profibus::{PROFILE, Slave};
use wsg_fieldbus::{Diagnosis, OutputImage, SilenceReaction};
use wsg_protocol::{FrameCounters, SystemFlags};

/// Longest telegram in bytes.
const MAX_TELEGRAM_LEN: usize = 255;

/// Shortest pause that counts as silence. A pseudo terminal does not show silences of a few bit times, so masters use a
/// longer slot time there.
const SILENCE_MICROS: u64 = 5_000;

/// The PROFIBUS slave on one line.
#[derive(Clone, Debug)]
pub(crate) struct ProfibusSlave {
    id: PortId,
    slave: Slave,
    /// When the last bytes were received.
    last_rx: Option<Time>,
    /// The last answer, until it is sent.
    answer: Vec<u8, MAX_TELEGRAM_LEN>,
    /// The flags of the last reported diagnosis.
    reported_flags: SystemFlags,
    /// Whether outputs have been received since data exchange began. A flag set in the first outputs is not an edge.
    has_outputs: bool,
    replies_lost: u32,
}

impl ProfibusSlave {
    pub(crate) const fn new(id: PortId, station: u8) -> Self {
        Self {
            id,
            slave: Slave::new(&PROFILE, Address::new(station)),
            last_rx: None,
            answer: Vec::new(),
            reported_flags: SystemFlags::empty(),
            has_outputs: false,
            replies_lost: 0,
        }
    }

    /// Returns the address of the master that has locked the slave.
    pub(crate) fn master(&self) -> Option<u8> {
        self.slave.master()
    }

    /// Passes the current inputs and diagnosis to the slave.
    fn show(&mut self, device: &Device, fieldbus: &Fieldbus) {
        let flags = device.flags();
        self.slave.show_inputs(&fieldbus.input(device).to_bytes());
        self.slave.show_diagnosis(&Diagnosis::device_part(flags), flags.intersects(Diagnosis::TRIGGERS));
        if Diagnosis::is_due(self.reported_flags, flags) {
            self.slave.announce_diagnosis();
        }
        self.reported_flags = flags;
    }

    fn handle(&mut self, device: &Device, fieldbus: &mut Fieldbus, event: Event) {
        match event {
            Event::Outputs => {
                let image = OutputImage::from_bytes(*self.slave.outputs());
                let is_first = !core::mem::replace(&mut self.has_outputs, true);
                fieldbus.exchange(device, self.id, &image, is_first);
            }
            // Clear means that the master has stopped. The zero outputs alone would only reset the flags.
            Event::Cleared | Event::Left(_) => {
                self.has_outputs = false;
                fieldbus.end_outputs(device, self.id, device.config().bus_reaction);
                if event == Event::Left(Cause::Watchdog) {
                    fieldbus.note_timeout();
                }
            }
            // The profile does not let a master change the address.
            Event::Address(_) => {}
        }
    }
}

impl Client for ProfibusSlave {
    fn id(&self) -> PortId {
        self.id
    }

    fn counters(&self) -> PortCounters {
        let damaged = u16::try_from(self.slave.counters().damaged).unwrap_or(u16::MAX);
        PortCounters {
            parser: FrameCounters { dropped: 0, bad_checksum: damaged, oversize: 0 },
            updates_lost: 0,
            replies_lost: self.replies_lost,
        }
    }

    /// The watchdog of the bus ends with its line.
    fn reaction_to_its_end(&self, config: &Config) -> SilenceReaction {
        config.bus_reaction
    }

    /// Takes bytes up to the first telegram for this slave.
    fn receive(
        &mut self,
        device: &mut Device,
        fieldbus: &mut Fieldbus,
        now: Time,
        bytes: &[u8],
    ) -> (usize, bool) {
        self.show(device, fieldbus);
        let last_rx = self.last_rx.replace(now);
        let is_silent = last_rx.is_none_or(|last_rx| now >= last_rx.plus_micros(SILENCE_MICROS));
        let mut silence_bits = if is_silent { SYNC_BITS } else { 0 };
        for (at, byte) in bytes.iter().enumerate() {
            let outcome = self.slave.push(Character::Byte(*byte), silence_bits, millis(now));
            silence_bits = 0;
            let Some(outcome) = outcome else { continue };
            let event = outcome.event;
            if let Some(answer) = outcome.answer {
                if !self.answer.is_empty() {
                    self.replies_lost = self.replies_lost.saturating_add(1);
                }
                self.answer.clear();
                // The buffer holds the longest telegram.
                let _ = self.answer.extend_from_slice(answer.bytes);
            }
            if let Some(event) = event {
                self.handle(device, fieldbus, event);
            }
            return (at.saturating_add(1), true);
        }
        (bytes.len(), false)
    }

    /// Polls the master's watchdog.
    fn expire(&mut self, device: &mut Device, fieldbus: &mut Fieldbus, now: Time) -> bool {
        let Some(event) = self.slave.poll(millis(now)) else { return false };
        self.handle(device, fieldbus, event);
        true
    }

    fn next_due(&self, now: Time) -> Option<Time> {
        let remaining_ms = self.slave.poll_timeout(millis(now))?;
        Some(Time::from_millis(now.as_micros() / 1_000).plus_millis(remaining_ms.into()))
    }

    fn has_frame(&self) -> bool {
        !self.answer.is_empty()
    }

    fn next_frame<'a>(&mut self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let place = buffer.get_mut(..self.answer.len()).filter(|place| !place.is_empty())?;
        place.copy_from_slice(&self.answer);
        self.answer.clear();
        Some(place)
    }
}

/// Returns the slave's clock, which may wrap.
const fn millis(now: Time) -> u32 {
    (now.as_micros() / 1_000) as u32
}
