//! PROFIBUS DP as a PLC side (fieldbus, chapters 2, 5 and 6): converts the master's output data to output images, and returns
//! input image and diagnosis. `bus_profibus` implements the slave.
//!
//! A master waits 60 to 150 bit times for a response, 100 µs at 1.5 Mbit/s, whereas a turn of the main loop takes 1 ms.
//! Therefore the slave runs in the interrupt handler of its UART ([`DpResponder`]) and commands no motion. It queues each
//! changed image in [`DpBuffers`]. The main loop reads the queue ([`Profibus`]) and passes the images to the arbiter, like
//! the images of any other bus.

mod config;
mod responder;

pub use config::ProfibusConfig;
pub use responder::{Action, DpBuffers, DpResponder, UartStatus};

use bus_profibus::{Baud, BaudSearch};
use wsg_fieldbus::OutputImage;
use wsg_protocol::Instant;

use self::responder::FromMaster;
use super::modbus::BusPort;
use super::side::{BoardId, PlcEvent, PlcSide, Shown, has_fallen_silent};
use super::{Config, Listed, SideReports, View};
use crate::register::report_rows;

/// Reports on PROFIBUS as registers: state, line rate, intact telegrams, damaged telegrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ProfibusReports([u16; 4]);

impl ProfibusReports {
    /// Creates the reports of a bridge that does not use PROFIBUS: all 0.
    pub(crate) const fn new(_: &Config) -> Self {
        Self([0; 4])
    }
}

report_rows! { ProfibusReports as it:
    206 "PROFIBUS_STATE" "PROFIBUS state: 0 not the PLC's bus, 1 no telegrams received, 2 waiting for parameters, 3 waiting for configuration, 4 data exchange"
        it.0[0];
    207 "PROFIBUS_LINE" "PROFIBUS line rate in 100 bit/s; in state 1 the rate being tried"
        it.0[1];
    208 "PROFIBUS_TELEGRAMS" "PROFIBUS: intact telegrams for any station" it.0[2];
    209 "PROFIBUS_DAMAGED" "PROFIBUS: noise and telegrams with errors, such as a wrong checksum"
        it.0[3];
}

/// PROFIBUS_STATE without received telegrams. Greater values are the slave's states.
const NOT_HEARD: u8 = 1;

/// The main loop's end of PROFIBUS.
///
/// The bridge reacts according to BUS_REACTION when the master releases it, clears its outputs, lets its watchdog expire or
/// is silent for BUS_TIMEOUT.
#[derive(Clone, Debug)]
pub struct Profibus {
    buffers: &'static DpBuffers,
    search: BaudSearch,
    /// Last output image of the master; `None` while it does not command.
    written: Option<OutputImage>,
    /// Time of the last output data, changed or not; `None` after a time-out.
    received_at: Option<Instant>,
    /// Last value of the exchange counter of `buffers`.
    exchanges: u32,
    telegrams: Count,
    damaged: Count,
}

/// A saturating count that follows a wrapping one.
#[derive(Clone, Debug)]
struct Count {
    total: u16,
    seen: u32,
}

impl Count {
    const ZERO: Self = Self { total: 0, seen: 0 };

    fn follow(&mut self, count: u32) {
        let more = count.wrapping_sub(core::mem::replace(&mut self.seen, count));
        self.total = self.total.saturating_add(u16::try_from(more).unwrap_or(u16::MAX));
    }
}

impl Profibus {
    /// Creates the main loop's end of these buffers. Create only one for each.
    #[must_use]
    pub const fn new(buffers: &'static DpBuffers) -> Self {
        Self {
            buffers,
            search: BaudSearch::new(&ProfibusConfig::RATES, 0),
            written: None,
            received_at: None,
            exchanges: 0,
            telegrams: Count::ZERO,
            damaged: Count::ZERO,
        }
    }

    /// Sets address and rate, which the handler applies in its next step. Called only before the first turn.
    pub fn start(&mut self, config: ProfibusConfig) {
        static RATES: [Baud; 7] = ProfibusConfig::RATES;
        let is_set = |rate: &Baud| config.rate.is_none_or(|set| set == *rate);
        let first = RATES.iter().position(is_set).unwrap_or_default();
        let last = RATES.iter().rposition(is_set).unwrap_or_default();
        self.search = BaudSearch::new(RATES.get(first..=last).unwrap_or_default(), 0);
        self.buffers.set_address(config.address);
        self.set_rate(self.search.baud());
    }

    fn set_rate(&self, rate: Option<Baud>) {
        if let Some(rate) = rate {
            self.buffers.set_rate(rate);
        }
    }

    /// Returns the values of the report registers.
    fn reports(&self) -> ProfibusReports {
        let state = if self.search.is_found() { self.buffers.state() } else { NOT_HEARD };
        let rate = self.search.baud().map_or(0, |rate| (rate.bit_s() / 100) as u16);
        ProfibusReports([state.into(), rate, self.telegrams.total, self.damaged.total])
    }

    /// Returns the next queued event of the master.
    fn take(&mut self, now: Instant) -> Option<PlcEvent> {
        while let Some(event) = self.buffers.take() {
            match event {
                FromMaster::Output(bytes) => {
                    self.received_at = Some(now);
                    let image = OutputImage::from_bytes(bytes);
                    self.written = Some(image);
                    return Some(PlcEvent::Output(image));
                }
                FromMaster::Left { silent } => {
                    self.written = None;
                    // Otherwise the time-out has already been reported.
                    if self.received_at.take().is_some() {
                        return Some(PlcEvent::Left { silent });
                    }
                }
            }
        }
        None
    }

    /// Handles unchanged output data. Returns the image if the master resumes after a time-out.
    fn resume(&mut self, now: Instant) -> Option<PlcEvent> {
        let exchanges = self.buffers.exchanges();
        if core::mem::replace(&mut self.exchanges, exchanges) == exchanges {
            return None;
        }
        let written = self.written?;
        self.received_at.replace(now).is_none().then_some(PlcEvent::Output(written))
    }
}

impl PlcSide for Profibus {
    fn report(&self, reports: &mut SideReports) {
        reports.profibus = self.reports();
    }

    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        if let Some(event) = self.take(now) {
            return Some(event);
        }
        if let Some(event) = self.resume(now) {
            return Some(event);
        }
        let is_silent = has_fallen_silent(&mut self.received_at, now, view.settings.timeout_ms());
        is_silent.then_some(PlcEvent::Left { silent: true })
    }

    fn show(&mut self, now: Instant, shown: &Shown) {
        self.buffers.show(shown.image.to_bytes());
        let telegrams = self.buffers.telegrams();
        self.telegrams.follow(telegrams);
        self.damaged.follow(self.buffers.damaged());
        let next = self.search.poll(now.as_millis(), telegrams);
        self.set_rate(next);
    }
}

impl Listed for Profibus {
    type Turn<'a> = &'a mut Self;

    fn start(&mut self, config: &Config, _: BoardId) {
        self.start(config.profibus);
    }

    fn over<'a>(&'a mut self, _: &'a mut dyn BusPort) -> &'a mut Self {
        self
    }
}
