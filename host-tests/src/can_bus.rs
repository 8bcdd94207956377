//! A CAN bus between the board's controller and others: arbitration, acknowledgement, time, and what can go wrong.
//!
//! Its time is the machine's. A frame takes as long as its bits do, without stuff bits. The others are ideal: they have no
//! error counters, and a frame of theirs that fails is not sent again.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::Result;

use crate::bxcan::{self, Bxcan, LINES};
use crate::can_controller::{BusController, ErrorCode, Transmission};
use crate::can_wire::WireFrame;
use crate::load_store::Width;
use crate::registers::{RegisterModel, ensure_word};

/// Where CAN1's registers are (RM0351, table 1).
const CAN1: u32 = 0x4000_6400;

/// CAN1's clock: APB1, which this board runs undivided from its 80 MHz.
const CLOCK_HZ: u32 = 80_000_000;

/// Bits of a frame that fails at its beginning: some of it, the error flags, and the pause behind them.
const FAILED_BITS: u32 = 31;

/// After how many bits of a free bus it is looked again who wants to send.
const IDLE_STEP: u32 = 11;

/// What is wrong with the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// Nothing.
    #[default]
    None,
    /// The line is dominant: no frame comes through, and nobody who is off comes back.
    ShortCircuit,
    /// The board's wires are off: it hears silence, and nobody hears it.
    Cut,
}

/// A bus with the board's controller on it; clones are the same bus.
#[derive(Debug)]
pub struct CanBus<C = Bxcan>(Arc<Mutex<Bus<C>>>);

/// Somebody on the bus besides the board.
#[derive(Debug)]
pub struct Station<C = Bxcan> {
    bus: CanBus<C>,
    number: usize,
    /// What the others send.
    pub heard: Receiver<WireFrame>,
}

#[derive(Debug)]
struct Bus<C> {
    rate: u32,
    controller: C,
    stations: Vec<Seat>,
    fault: Fault,
    on_wire: Option<OnWire>,
    /// Time that makes no whole bit yet.
    rest: Duration,
    /// What the board has sent.
    sent: Vec<WireFrame>,
}

#[derive(Debug)]
struct Seat {
    to_send: VecDeque<WireFrame>,
    heard: Sender<WireFrame>,
}

#[derive(Clone, Copy, Debug)]
struct OnWire {
    frame: WireFrame,
    from: Sending,
    bits_left: u32,
    /// Why it will come to nothing.
    fails: Option<ErrorCode>,
}

#[derive(Clone, Copy, Debug)]
enum Sending {
    Board { mailbox: usize },
    Station(usize),
}

impl<C> Clone for CanBus<C> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl CanBus {
    /// A bus of so many bits a second, with bxCAN on it.
    #[must_use]
    pub fn new(rate: u32) -> Self {
        Self::with(Bxcan::new(CLOCK_HZ), rate)
    }
}

impl<C: BusController> CanBus<C> {
    /// A bus of so many bits a second, with this controller on it.
    #[must_use]
    pub fn with(controller: C, rate: u32) -> Self {
        Self(Arc::new(Mutex::new(Bus {
            rate,
            controller,
            stations: Vec::new(),
            fault: Fault::None,
            on_wire: None,
            rest: Duration::ZERO,
            sent: Vec::new(),
        })))
    }

    /// Puts somebody on the bus, for good.
    #[must_use]
    pub fn join(&self) -> Station<C> {
        let (sender, heard) = mpsc::channel();
        let mut bus = self.lock();
        bus.stations.push(Seat { to_send: VecDeque::new(), heard: sender });
        Station { bus: self.clone(), number: bus.stations.len() - 1, heard }
    }

    /// The board's controller as it is now.
    #[must_use]
    pub fn controller(&self) -> C {
        self.lock().controller.clone()
    }

    /// What the board has sent until now.
    #[must_use]
    pub fn sent(&self) -> Vec<WireFrame> {
        self.lock().sent.clone()
    }

    /// Brings the board frames faster than any bus does, as soon as nothing is under way.
    pub fn burst(&self, frames: &[WireFrame]) {
        loop {
            let mut bus = self.lock();
            if bus.on_wire.is_none() {
                for frame in frames {
                    bus.controller.begin_reception(None);
                    bus.controller.end_reception(frame);
                }
                return;
            }
        }
    }

    /// The board does something with its controller.
    pub fn act<T>(&self, what: impl FnOnce(&mut C) -> T) -> T {
        what(&mut self.lock().controller)
    }

    /// Lets time pass, for a controller that is no [`RegisterModel`].
    pub fn pass(&self, time: Duration) {
        self.lock().advance(time);
    }

    /// How long nothing changes if nobody has more to send: until the frame on the bus ends; `None`: none is there.
    #[must_use]
    pub fn until_next(&self) -> Option<Duration> {
        let bus = self.lock();
        Some(Duration::from_secs(1) / bus.rate * bus.on_wire?.bits_left)
    }

    /// Breaks or mends the bus.
    pub fn set_fault(&self, fault: Fault) {
        self.lock().fault = fault;
    }

    fn lock(&self) -> MutexGuard<'_, Bus<C>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<C: BusController> Station<C> {
    /// Queues a frame.
    pub fn send(&self, frame: WireFrame) {
        self.bus.lock().stations[self.number].to_send.push_back(frame);
    }

    /// How many frames wait for the bus.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.bus.lock().stations[self.number].to_send.len()
    }

    /// Another handle to the same place, for sending alone.
    pub fn sender(&self) -> impl Fn(WireFrame) + Send + 'static {
        let (bus, number) = (self.bus.clone(), self.number);
        move |frame| bus.lock().stations[number].to_send.push_back(frame)
    }
}

impl RegisterModel for CanBus {
    fn addresses(&self) -> Range<u32> {
        CAN1..CAN1 + bxcan::LEN
    }

    fn load(&mut self, address: u32, width: Width) -> Result<u32> {
        // 46.9: all of them are accessed by words.
        ensure_word(address, width)?;
        self.lock().controller.load(address - CAN1)
    }

    fn store(&mut self, address: u32, width: Width, value: u32) -> Result<()> {
        ensure_word(address, width)?;
        self.lock().controller.store(address - CAN1, value)
    }

    fn advance(&mut self, time: Duration) {
        self.lock().advance(time);
    }

    fn reset(&mut self) {
        let mut bus = self.lock();
        bus.controller = Bxcan::new(CLOCK_HZ);
        bus.on_wire = None;
    }

    fn interrupts(&self) -> Vec<(u8, bool)> {
        LINES.into_iter().zip(self.lock().controller.interrupts()).collect()
    }
}

impl<C: BusController> Bus<C> {
    fn advance(&mut self, time: Duration) {
        let time = self.rest + time;
        let bit = Duration::from_secs(1) / self.rate;
        let mut bits = u32::try_from(time.as_nanos() / bit.as_nanos()).unwrap_or(u32::MAX);
        self.rest = time.saturating_sub(bit * bits);
        while bits > 0 {
            match &mut self.on_wire {
                Some(on_wire) if on_wire.bits_left > bits => {
                    on_wire.bits_left -= bits;
                    return;
                }
                Some(on_wire) => {
                    bits -= on_wire.bits_left;
                    let ended = *on_wire;
                    self.on_wire = None;
                    self.end(&ended);
                }
                None => {
                    self.begin();
                    if self.on_wire.is_none() {
                        // In steps: somebody may be ready to send behind each.
                        let step = bits.min(IDLE_STEP);
                        if self.fault != Fault::ShortCircuit {
                            self.controller.idle(step);
                        }
                        bits -= step;
                    }
                }
            }
        }
    }

    /// The bus is free: whoever has the lowest identifier begins.
    fn begin(&mut self) {
        let own = self.controller.next_transmission();
        let others = self.stations.iter().enumerate();
        let others = others.filter_map(|(n, seat)| Some((n, *seat.to_send.front()?)));
        let best = others.min_by_key(|(_, frame)| frame.arbitration());
        // On wires that are off everybody wins.
        let is_alone = self.fault == Fault::Cut;
        match (own, best) {
            (Some(Transmission { mailbox, frame }), best)
                if is_alone || best.is_none_or(|(_, other)| frame.arbitration() <= other.arbitration()) =>
            {
                self.controller.begin_transmission(mailbox);
                self.put(frame, Sending::Board { mailbox });
            }
            (own, Some((n, frame))) => {
                self.stations[n].to_send.pop_front();
                if !is_alone {
                    self.controller.begin_reception(own.map(|own| own.mailbox));
                }
                self.put(frame, Sending::Station(n));
            }
            (_, None) => {}
        }
    }

    fn put(&mut self, frame: WireFrame, from: Sending) {
        let fits = self.controller.rate() == self.rate;
        let is_cut = self.fault == Fault::Cut;
        let (fails, bits_left) = match from {
            _ if self.fault == Fault::ShortCircuit => (Some(ErrorCode::BitDominant), FAILED_BITS),
            Sending::Board { .. } if !fits => (Some(ErrorCode::BitRecessive), FAILED_BITS),
            Sending::Board { .. } if is_cut || self.stations.is_empty() => {
                (Some(ErrorCode::Acknowledgement), frame.bits())
            }
            Sending::Station(n) => {
                let board_hears = self.controller.takes_part() && fits && !is_cut;
                let is_heard = board_hears || (0..self.stations.len()).any(|other| other != n);
                (if is_heard { None } else { Some(ErrorCode::Acknowledgement) }, frame.bits())
            }
            Sending::Board { .. } => (None, frame.bits()),
        };
        self.on_wire = Some(OnWire { frame, from, bits_left, fails });
    }

    fn end(&mut self, OnWire { frame, from, fails, .. }: &OnWire) {
        match (*from, *fails) {
            (Sending::Board { mailbox }, Some(why)) => self.controller.fail_transmission(mailbox, why),
            (Sending::Board { mailbox }, None) => {
                self.controller.end_transmission(mailbox);
                self.sent.push(*frame);
                self.tell(frame, None);
            }
            (Sending::Station(n), _) if self.fault == Fault::Cut => {
                self.controller.idle(frame.bits());
                self.tell(frame, Some(n));
            }
            (Sending::Station(_), Some(_)) => self.controller.fail_reception(ErrorCode::Form),
            (Sending::Station(n), None) => {
                if self.controller.rate() == self.rate {
                    self.controller.end_reception(frame);
                } else {
                    self.controller.fail_reception(ErrorCode::Stuff);
                }
                self.tell(frame, Some(n));
            }
        }
    }

    fn tell(&self, frame: &WireFrame, except: Option<usize>) {
        for (n, seat) in self.stations.iter().enumerate() {
            if Some(n) != except {
                // Whoever is gone hears nothing.
                let _ = seat.heard.send(*frame);
            }
        }
    }
}

#[cfg(test)]
mod tests;
