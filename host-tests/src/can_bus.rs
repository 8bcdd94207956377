//! Model of a CAN bus between the board's controller and other stations: arbitration, acknowledgement, timing, and
//! faults.
//! It follows the machine's time. A frame takes as long as its bits, without stuff bits. The other stations are
//! ideal: they have no error counters and do not repeat a failed frame.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::Result;

use crate::bxcan::Bxcan;
use crate::can_controller::{BusController, CAN1, ErrorCode, MappedController, Transmission};
use crate::can_wire::WireFrame;
use crate::registers::RegisterModel;

/// Length of the register block of a [`MappedController`] in bytes.
const LEN: u32 = 0x400;

/// CAN1's clock: APB1, which this board runs at the undivided 80 MHz.
const CLOCK_HZ: u32 = 80_000_000;

/// Bits of a frame that fails at its beginning, with error flags and intermission.
const FAILED_BITS: u32 = 31;

/// Interval on an idle bus after which senders are checked again, in bits.
const IDLE_STEP: u32 = 11;

/// A fault of the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fault {
    /// No fault.
    #[default]
    None,
    /// The line is dominant: no frame passes, and no station recovers from bus-off.
    ShortCircuit,
    /// The board's wires are cut: neither side receives the other.
    Cut,
}

/// A bus with the board's controller; clones share the bus.
#[derive(Debug)]
pub struct CanBus<C = Bxcan>(Arc<Mutex<Bus<C>>>);

/// A station on the bus, in addition to the board.
#[derive(Debug)]
pub struct Station<C = Bxcan> {
    bus: CanBus<C>,
    number: usize,
    /// Frames received from other stations.
    pub received: Receiver<WireFrame>,
}

#[derive(Debug)]
struct Bus<C> {
    rate: u32,
    controller: C,
    stations: Vec<Seat>,
    fault: Fault,
    on_wire: Option<OnWire>,
    /// Time short of a whole bit.
    rest: Duration,
    /// Frames sent by the board.
    sent: Vec<WireFrame>,
}

#[derive(Debug)]
struct Seat {
    to_send: VecDeque<WireFrame>,
    received: Sender<WireFrame>,
}

#[derive(Clone, Copy, Debug)]
struct OnWire {
    frame: WireFrame,
    from: Sending,
    bits_left: u32,
    /// Reason for which the transmission will fail.
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
    /// Creates a bus at `rate` bit/s with a bxCAN controller.
    #[must_use]
    pub fn new(rate: u32) -> Self {
        Self::with(Bxcan::new(CLOCK_HZ), rate)
    }
}

impl<C: BusController> CanBus<C> {
    /// Creates a bus at `rate` bit/s with this controller.
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

    /// Adds a station permanently.
    #[must_use]
    pub fn join(&self) -> Station<C> {
        let (sender, received) = mpsc::channel();
        let mut bus = self.lock();
        bus.stations.push(Seat { to_send: VecDeque::new(), received: sender });
        Station { bus: self.clone(), number: bus.stations.len() - 1, received }
    }

    /// Returns a copy of the board's controller.
    #[must_use]
    pub fn controller(&self) -> C {
        self.lock().controller.clone()
    }

    /// Returns all frames sent by the board.
    #[must_use]
    pub fn sent(&self) -> Vec<WireFrame> {
        self.lock().sent.clone()
    }

    /// Delivers frames to the board faster than any bus, as soon as the bus is idle.
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

    /// Accesses the board's controller.
    pub fn act<T>(&self, what: impl FnOnce(&mut C) -> T) -> T {
        what(&mut self.lock().controller)
    }

    /// Advances time, for a controller that is not a [`RegisterModel`].
    pub fn pass(&self, time: Duration) {
        self.lock().advance(time);
    }

    /// Returns the time until the frame on the bus ends; `None` on an idle bus.
    #[must_use]
    pub fn until_next(&self) -> Option<Duration> {
        let bus = self.lock();
        Some(Duration::from_secs(1) / bus.rate * bus.on_wire?.bits_left)
    }

    /// Sets or clears a fault of the bus.
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

    /// Returns the number of queued frames.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.bus.lock().stations[self.number].to_send.len()
    }

    /// Returns a handle that sends from this station.
    pub fn sender(&self) -> impl Fn(WireFrame) + Send + 'static {
        let (bus, number) = (self.bus.clone(), self.number);
        move |frame| bus.lock().stations[number].to_send.push_back(frame)
    }
}

impl<C: MappedController> CanBus<C> {
    /// Returns the models of the controller's registers and of its message RAM.
    #[must_use]
    pub fn models(&self) -> Vec<Box<dyn RegisterModel>> {
        let ranges = [CAN1..CAN1 + LEN, C::RAM].into_iter().filter(|range| !range.is_empty());
        ranges.map(|range| Box::new(Window(self.clone(), range)) as Box<dyn RegisterModel>).collect()
    }
}

/// The addresses of a controller on a bus: its registers, or its message RAM.
#[derive(Debug)]
struct Window<C>(CanBus<C>, Range<u32>);

impl<C: MappedController> RegisterModel for Window<C> {
    fn addresses(&self) -> Range<u32> {
        self.1.clone()
    }

    fn load(&mut self, address: u32) -> Result<u32> {
        self.0.lock().controller.load(address - CAN1)
    }

    fn store(&mut self, address: u32, value: u32) -> Result<()> {
        self.0.lock().controller.store(address - CAN1, value)
    }

    fn advance(&mut self, time: Duration) {
        // Once for all windows.
        if self.1.start == CAN1 {
            self.0.pass(time);
        }
    }

    fn interrupts(&self) -> Vec<(u8, bool)> {
        C::LINES.into_iter().zip(self.0.lock().controller.interrupts()).collect()
    }

    fn has_unread_data(&self) -> bool {
        self.0.lock().controller.has_unread_data()
    }

    fn reset(&mut self) {
        // The findings remain; the frame on the bus is lost.
        let bus = &mut *self.0.lock();
        let violations = std::mem::take(&mut bus.controller.node_mut().violations);
        bus.controller.reset();
        bus.controller.node_mut().violations = violations;
        bus.on_wire = None;
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
                        // Advances in steps, because a station may become ready to send in between.
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

    /// Arbitrates on a free bus: the lowest identifier wins.
    fn begin(&mut self) {
        let own = self.controller.next_transmission();
        let others = self.stations.iter().enumerate();
        let others = others.filter_map(|(n, seat)| Some((n, *seat.to_send.front()?)));
        let best = others.min_by_key(|(_, frame)| frame.arbitration());
        // On cut wires each side wins arbitration.
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
                self.report(frame, None);
            }
            (Sending::Station(n), _) if self.fault == Fault::Cut => {
                self.controller.idle(frame.bits());
                self.report(frame, Some(n));
            }
            (Sending::Station(_), Some(_)) => self.controller.fail_reception(ErrorCode::Form),
            (Sending::Station(n), None) => {
                if self.controller.rate() == self.rate {
                    self.controller.end_reception(frame);
                } else {
                    self.controller.fail_reception(ErrorCode::Stuff);
                }
                self.report(frame, Some(n));
            }
        }
    }

    fn report(&self, frame: &WireFrame, except: Option<usize>) {
        for (n, seat) in self.stations.iter().enumerate() {
            if Some(n) != except {
                // Receivers that no longer exist are skipped.
                let _ = seat.received.send(*frame);
            }
        }
    }
}
