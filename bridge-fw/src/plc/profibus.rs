//! PROFIBUS DP as a PLC side (fieldbus, chapters 2, 5 and 6): what the master wrote as output images, input image and diagnosis
//! back. The slave itself is `bus_profibus`'s.
//!
//! A master waits for its answer for 60 to 150 bit times, which is 100 µs at 1.5 Mbit/s, and a turn of the main loop takes
//! a millisecond. So the slave belongs to the interrupt handler of its UART ([`DpResponder`]), and moves nothing: every image
//! that differs from the one before waits in [`DpBuffers`] until the main loop takes it ([`Profibus`]), and passes the arbiter
//! there as that of any other bus.

mod config;
mod responder;

pub use config::ProfibusConfig;
pub use responder::{Action, DpBuffers, DpResponder, UartStatus};

use bus_profibus::{Baud, BaudSearch};
use wsg_fieldbus::OutputImage;
use wsg_protocol::Instant;

use self::responder::FromMaster;
use super::modbus::BusPort;
use super::side::{BoardId, PlcEvent, PlcSide, Shown};
use super::{Config, Listed, SideReports, View};
use crate::register::report_rows;

/// What is reported about PROFIBUS: state, rate of the line, intact telegrams, damaged ones, as registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct ProfibusReports([u16; 4]);

impl ProfibusReports {
    /// The reports of a bridge whose PLC does not use PROFIBUS: all 0.
    pub(crate) const fn new(_: &Config) -> Self {
        Self([0; 4])
    }
}

report_rows! { ProfibusReports as it:
    206 "PROFIBUS_STATE" "PROFIBUS: 0 it is not the PLC's bus, 1 no telegram is heard, 2 a master has to send parameters, 3 its configuration, 4 data exchange"
        it.0[0];
    207 "PROFIBUS_LINE" "PROFIBUS: the line's rate in 100 bit/s; with state 1 one that is tried"
        it.0[1];
    208 "PROFIBUS_TELEGRAMS" "PROFIBUS: intact telegrams, for whatever station" it.0[2];
    209 "PROFIBUS_DAMAGED" "PROFIBUS: what was no telegram, such as noise or one with a wrong check sum"
        it.0[3];
}

/// The value of PROFIBUS_STATE where no telegram is heard; those behind it are the slave's states.
const NOT_HEARD: u8 = 1;

/// The main loop's end of PROFIBUS.
///
/// When the master releases the bridge, clears its outputs, lets its watchdog expire or is silent for BUS_TIMEOUT, the bridge
/// reacts as BUS_REACTION says.
#[derive(Debug)]
pub struct Profibus {
    buffers: &'static DpBuffers,
    search: BaudSearch,
    /// What the master wrote last; none while it does not command.
    written: Option<OutputImage>,
    /// When it did, changed or not; none once that is too long ago.
    heard_at: Option<Instant>,
    /// As `buffers` had it when this was looked at last.
    exchanges: u32,
    telegrams: Count,
    damaged: Count,
}

/// A count that stops at its end, of one that wraps.
#[derive(Debug)]
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
    /// The end of these buffers, of which there is one.
    #[must_use]
    pub const fn new(buffers: &'static DpBuffers) -> Self {
        Self {
            buffers,
            search: BaudSearch::new(&ProfibusConfig::RATES, 0),
            written: None,
            heard_at: None,
            exchanges: 0,
            telegrams: Count::ZERO,
            damaged: Count::ZERO,
        }
    }

    /// Takes address and rate, which the handler takes with its next step. Before the first turn alone.
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

    /// What the bridge's registers tell of it.
    fn reports(&self) -> ProfibusReports {
        let state = if self.search.is_found() { self.buffers.state() } else { NOT_HEARD };
        let rate = self.search.baud().map_or(0, |rate| (rate.bit_s() / 100) as u16);
        ProfibusReports([state.into(), rate, self.telegrams.total, self.damaged.total])
    }

    /// What the master did, as far as it has not been said.
    fn take(&mut self, now: Instant) -> Option<PlcEvent> {
        while let Some(event) = self.buffers.take() {
            match event {
                FromMaster::Output(bytes) => {
                    self.heard_at = Some(now);
                    let image = OutputImage::from_bytes(bytes);
                    self.written = Some(image);
                    return Some(PlcEvent::Output(image));
                }
                FromMaster::Left { silent } => {
                    self.written = None;
                    // Else it has been silent for BUS_TIMEOUT already.
                    if self.heard_at.take().is_some() {
                        return Some(PlcEvent::Left { silent });
                    }
                }
            }
        }
        None
    }

    /// A master that has written the same again; the image, if it was away for BUS_TIMEOUT.
    fn hear(&mut self, now: Instant) -> Option<PlcEvent> {
        let exchanges = self.buffers.exchanges();
        if core::mem::replace(&mut self.exchanges, exchanges) == exchanges {
            return None;
        }
        let written = self.written?;
        self.heard_at.replace(now).is_none().then_some(PlcEvent::Output(written))
    }

    /// Whether a master without a watchdog has been silent for so long, in milliseconds; says so once.
    fn has_fallen_silent(&mut self, now: Instant, timeout_ms: u32) -> bool {
        let silent =
            timeout_ms > 0 && self.heard_at.is_some_and(|heard_at| now.since(heard_at) >= timeout_ms);
        if silent {
            self.heard_at = None;
        }
        silent
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
        if let Some(event) = self.hear(now) {
            return Some(event);
        }
        let is_silent = self.has_fallen_silent(now, view.settings.timeout_ms());
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
