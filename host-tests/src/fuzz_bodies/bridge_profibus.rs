//! The whole bridge on PROFIBUS and wires, with the gripper on RS-232: arbitrary characters and silences, telegrams
//! from two masters, wires and gripper behaviour.
//!
//! Properties:
//! - the [`Promises`](crate::promises::Promises): commands follow only edges of wires, or of outputs from the
//!   controlling master in data exchange; FAST STOP is sent at once; the outputs are true
//! - the watchdog may be fed
//! - the main loop receives the slave's events once and in order: changed outputs, end and return of control, and
//!   silence for BUS_TIMEOUT
//! - the line carries only the slave's answers, byte by byte and not early, and never during another transmission
//!
//! The reference slave is a second instance of [`bus_profibus`]'s. It receives the same characters with exact
//! silences, not measured by a microsecond clock. The body `profibus` checks its correctness.

use std::ops::RangeInclusive;

use bus_profibus::{Address, Baud, Cause, Character, Event};
use wsg_bridge_fw::plc::{DpBuffers, DpResponder, PlcEvent, PlcSide, Profibus, Shown, UartStatus, View};
use wsg_bridge_fw::{Bridge, Config, ControlSource};
use wsg_fieldbus::profibus::{PROFILE, Slave};
use wsg_fieldbus::{CommandFlags, Diagnosis, InputImage, OutputImage};
use wsg_protocol::{Instant, SystemFlags};

use super::input::Input;
use super::profibus::framed;
use super::whole::{self, Ends, PARAMETERS, WholeBridge};
use super::whole::{pick_answer, pick_characters, pick_edge, pick_image, pick_noise};
use crate::operation::{Operation, Port, Telegram, TelegramFault, image};
use crate::world::profibus::points::{
    CHK_CFG, GET_CFG, GLOBAL_CONTROL, RD_INP, RD_OUTP, SET_PRM, SET_SLAVE_ADDRESS, SLAVE_DIAG,
};
use crate::world::profibus::{AT_500K, STATION, sd1, sd2};

const BROADCAST: u8 = 127;
const MASTERS: [u8; 4] = [2, 2, 2, 3];

/// Duration of a bit and of a character at 500 kbit/s, in microseconds.
const BIT_US: u32 = 2;
const CHARACTER_US: u32 = 11 * BIT_US;

/// Bits from the end of reception, in the middle of the stop bit, to the end of the character.
const STOP_BITS: u32 = 1;

/// Silences before a telegram in bit times, sufficient and insufficient.
const SILENCES: [u32; 5] = [40, 40, 40, 200, 10];

/// Silences near 33 bits that a microsecond clock cannot distinguish.
const UNCLEAR_US: RangeInclusive<u32> = 32 * BIT_US..=35 * BIT_US;

thread_local! {
    /// Buffers shared by handler and main loop. They are leaked once per thread.
    static BUFFERS: &'static DpBuffers = Box::leak(Box::default());
}

/// An answer that is pending or in transmission.
struct Answer {
    bytes: Vec<u8>,
    /// Earliest time of transmission, in microseconds.
    from_us: u32,
    sent: usize,
}

pub(super) struct Model {
    bridge: Bridge,
    profibus: Profibus,
    handler: DpResponder,
    slave: Slave,
    now_us: u32,
    /// Time of the next timer event and of the end of the byte in transmission.
    timer_us: Option<u32>,
    sent_us: Option<u32>,
    /// End of the last character on the line.
    received_us: u32,
    /// Whether the transceiver echoes.
    echoes: bool,
    answer: Option<Answer>,
    /// Inputs not yet processed by the handler, and the flags of those last processed.
    inputs: Option<InputImage>,
    flags: SystemFlags,
    /// Whether the master has control, and its last outputs passed to the main loop.
    commands: bool,
    reported: Option<[u8; OutputImage::LEN]>,
    /// Events pending for the main loop, and whether the master has written since its last turn.
    done: Vec<PlcEvent>,
    exchanged: bool,
    /// Outputs known to the main loop, and the time of the master's last activity; `None` after silence.
    written: Option<OutputImage>,
    received_ms: Option<u32>,
    /// The masters' frame count bit and the last telegram.
    fcb: bool,
    last: Vec<u8>,
    ends: Ends,
}

/// The first byte also enables the transceiver's echo (bit 1). Each further op is a byte with parameter bytes: wires,
/// time, gripper, telegrams. Without bit 7 a millisecond passes after it.
pub fn bridge_profibus(data: &[u8]) {
    whole::run::<Model>(data);
}

impl Model {
    fn new(echoes: bool) -> Self {
        let buffers = BUFFERS.with(|buffers| *buffers);
        let mut profibus = Profibus::new(buffers);
        profibus.start(AT_500K.profibus);
        let mut handler = DpResponder::new(buffers);
        assert_eq!(handler.step(UartStatus::default(), 0, 0).rate, Some(Baud::K500));
        Self {
            bridge: Bridge::new(AT_500K),
            profibus,
            handler,
            slave: Slave::new(&PROFILE, Address::new(STATION)),
            now_us: 0,
            timer_us: None,
            sent_us: None,
            received_us: 0,
            echoes,
            answer: None,
            inputs: None,
            flags: SystemFlags::empty(),
            commands: false,
            reported: None,
            done: Vec::new(),
            exchanged: false,
            written: None,
            received_ms: None,
            fcb: false,
            last: Vec::new(),
            ends: Ends::new(&AT_500K, None),
        }
    }

    fn now_ms(&self) -> u32 {
        self.now_us / 1_000
    }

    /// Sends configuration and parameters. `watchdog` is in units of 10 ms; 0 disables it.
    fn start_slave(&mut self, master: u8, watchdog: u8, min_tsdr: u8) {
        let status = if watchdog == 0 { 0x80 } else { 0x88 };
        let prm = [status, 1, watchdog, min_tsdr, 0x55, 0x55, 0x01];
        for (point, data) in [(SET_PRM, &prm[..]), (CHK_CFG, PROFILE.config)] {
            let code = self.next();
            self.put(sd2(&[&[STATION | 0x80, master | 0x80, code, point, 62], data].concat()));
            // Waits for the answer as a master does.
            self.pass_us(255 * BIT_US + 2 * CHARACTER_US);
        }
    }

    /// Returns the function code of the next request.
    fn next(&mut self) -> u8 {
        self.fcb = !self.fcb;
        if self.fcb { 0x7D } else { 0x5D }
    }

    /// Returns a Data_Exchange request with these outputs.
    fn exchange(&mut self, master: u8, outputs: &[u8]) -> Vec<u8> {
        framed(&[&[STATION, master, self.next()], outputs].concat(), 0)
    }

    /// Sends a telegram without faults.
    fn put(&mut self, telegram: Vec<u8>) {
        self.send(&Telegram::Raw(telegram), SILENCES[0], TelegramFault::Intact);
    }

    /// Sends a telegram after a silence.
    fn send(&mut self, telegram: &Telegram, silence_bits: u32, fault: TelegramFault) {
        match telegram {
            Telegram::Exchange { master, outputs } => self.last = self.exchange(*master, outputs),
            Telegram::ServiceRequest { master, point, data } => {
                let head = [STATION | 0x80, master | 0x80, self.next(), *point, 62];
                self.last = sd2(&[&head, &data[..]].concat());
            }
            Telegram::Repetition => {}
            Telegram::Raw(bytes) => self.last.clone_from(bytes),
        }
        self.receive_all(&fault.characters(&self.last, silence_bits));
    }

    fn receive_all(&mut self, characters: &[(Option<u8>, u32)]) {
        for (byte, silence_bits) in characters {
            self.receive(byte.map_or(Character::Damaged, Character::Byte), *silence_bits);
        }
    }

    /// Receives a character after at least this silence. A master waits while the slave transmits.
    fn receive(&mut self, character: Character, silence_bits: u32) {
        self.pass_us(silence_bits * BIT_US + CHARACTER_US);
        while self.sent_us.is_some() || UNCLEAR_US.contains(&self.silence_us()) {
            self.pass_us(CHARACTER_US);
        }
        let silence_bits = self.silence_us() / BIT_US;
        self.received_us = self.now_us;
        // A character of another station cancels the pending answer.
        if !character.is_stray() {
            self.answer = None;
        }
        let was_due = self.answer.is_some();
        let now_ms = self.now_ms();
        if let Some(outcome) = self.slave.push(character, silence_bits, now_ms) {
            let from_us = |bits: u32| self.now_us + (bits + STOP_BITS) * BIT_US;
            self.answer = outcome.answer.map(|answer| Answer {
                bytes: answer.bytes.to_vec(),
                from_us: from_us(answer.not_before_bits),
                sent: 0,
            });
            let event = outcome.event;
            event.into_iter().for_each(|event| self.note(event));
        }
        let status = UartStatus { received: Some(character), has_room: true, is_complete: true };
        let action = self.handler.step(status, now_ms, self.now_us);
        assert_eq!(action.send, None, "too early");
        assert_eq!(action.wait_us.is_some(), self.answer.is_some() && !was_due, "an answer is due");
        self.timer_us = action.wait_us.map(|wait_us| self.now_us + wait_us).or(self.timer_us);
    }

    /// Returns the silence before a character that ends now.
    fn silence_us(&self) -> u32 {
        (self.now_us - self.received_us).saturating_sub(CHARACTER_US)
    }

    /// Advances time: turns of the main loop, each followed by the handler, and timer and transmitter events.
    fn pass_us(&mut self, us: u32) {
        let end_us = self.now_us + us;
        loop {
            let turn_us = (self.now_ms() + 1) * 1_000;
            let next_us = [Some(turn_us), self.timer_us, self.sent_us].into_iter().flatten().min();
            let next_us = next_us.filter(|next_us| *next_us <= end_us);
            let Some(next_us) = next_us else { break };
            self.now_us = next_us;
            if next_us == turn_us {
                self.turn();
            }
            let is_due = self.timer_us == Some(next_us) && self.answer.is_some();
            self.timer_us = self.timer_us.filter(|timer_us| *timer_us != next_us);
            self.handle();
            assert!(!is_due || self.sent_us.is_some(), "an answer was not sent on time");
        }
        self.now_us = end_us;
    }

    /// Runs the handler; only an echo of its own byte may be received.
    fn handle(&mut self) {
        let (now_ms, now_us) = (self.now_ms(), self.now_us);
        let is_sending = self.sent_us.is_some();
        let is_sent = self.sent_us == Some(now_us);
        if let Some(Answer { bytes, sent, .. }) = self.answer.as_ref().filter(|_| is_sent && self.echoes) {
            let received = Some(Character::Byte(bytes[sent - 1]));
            let action = self.handler.step(UartStatus { received, ..UartStatus::default() }, now_ms, now_us);
            assert_eq!((action.send, action.wait_us), (None, None), "the transmitter is full");
        }
        let is_free = is_sent || !is_sending;
        let status = UartStatus { received: None, has_room: is_free, is_complete: is_free };
        let action = self.handler.step(status, now_ms, now_us);
        assert_eq!((action.rate, action.wait_us), (None, None));
        match (action.send, &mut self.answer) {
            (Some(byte), Some(answer)) => {
                assert!(now_us >= answer.from_us, "{} us too early", answer.from_us - now_us);
                assert_eq!(Some(&byte), answer.bytes.get(answer.sent), "of {:02X?}", answer.bytes);
                answer.sent += 1;
                self.sent_us = Some(now_us + CHARACTER_US);
            }
            (Some(_), None) => panic!("a byte was sent without an answer"),
            (None, Some(answer)) if is_sent => {
                assert_eq!(answer.sent, answer.bytes.len(), "the answer is truncated");
                (self.answer, self.sent_us, self.received_us) = (None, None, now_us);
            }
            (None, _) => {}
        }
        let rest = self.answer.as_ref().filter(|answer| answer.sent > 0);
        let has_more = rest.map(|answer| answer.sent < answer.bytes.len());
        let interrupts = (action.interrupts.transmit_empty, action.interrupts.transmission_complete);
        assert_eq!(interrupts, has_more.map_or((false, false), |has_more| (has_more, !has_more)));
        if self.answer.is_none() {
            self.synchronise();
        }
    }

    /// Updates the reference slave's inputs and time, as the handler does while no answer is pending.
    fn synchronise(&mut self) {
        if let Some(inputs) = self.inputs.take() {
            self.slave.show_inputs(&inputs.to_bytes());
            let before = std::mem::replace(&mut self.flags, inputs.system);
            let is_fault = self.flags.intersects(Diagnosis::TRIGGERS);
            self.slave.show_diagnosis(&Diagnosis::device_part(self.flags), is_fault);
            if Diagnosis::is_due(before, self.flags) {
                self.slave.announce_diagnosis();
            }
        }
        let event = self.slave.poll(self.now_ms());
        event.into_iter().for_each(|event| self.note(event));
    }

    fn note(&mut self, event: Event) {
        match event {
            Event::Outputs => {
                (self.commands, self.exchanged) = (true, true);
                let outputs = *self.slave.outputs();
                if self.reported.replace(outputs) != Some(outputs) {
                    self.done.push(PlcEvent::Output(OutputImage::from_bytes(outputs)));
                }
            }
            Event::Cleared | Event::Left(_) => {
                if std::mem::take(&mut self.commands) {
                    self.reported = None;
                    self.done.push(PlcEvent::Left { silent: event == Event::Left(Cause::Watchdog) });
                }
            }
            Event::Address(_) => panic!("the address cannot be changed"),
        }
    }

    /// Returns the events that the main loop must receive.
    fn events(&mut self, now_ms: u32) -> Vec<PlcEvent> {
        let mut events = vec![];
        for event in self.done.drain(..) {
            if let PlcEvent::Output(image) = event {
                (self.written, self.received_ms) = (Some(image), Some(now_ms));
            } else {
                self.written = None;
                if self.received_ms.take().is_none() {
                    continue;
                }
            }
            events.push(event);
        }
        if std::mem::take(&mut self.exchanged)
            && let Some(image) = self.written
            && self.received_ms.replace(now_ms).is_none()
        {
            // The master returns after silence for BUS_TIMEOUT.
            events.push(PlcEvent::Output(image));
        }
        let timeout_ms = u32::from(Config::DEFAULT.bus.timeout_ms);
        if self.received_ms.is_some_and(|received_ms| now_ms - received_ms >= timeout_ms) {
            self.received_ms = None;
            events.push(PlcEvent::Left { silent: true });
        }
        events
    }
}

impl WholeBridge for Model {
    const NAME: &'static str = "bridge_profibus";

    fn start(choice: u8) -> Self {
        Self::new(choice & 2 != 0)
    }

    /// Empties the buffers for the next case.
    fn end(mut self) {
        while !self.done.is_empty() || self.answer.is_some() || self.inputs.is_some() {
            self.pass(1);
        }
    }

    fn ends(&mut self) -> &mut Ends {
        &mut self.ends
    }

    fn write_zeros(&mut self) {
        self.pass(4);
        self.start_slave(MASTERS[0], 200, 11);
        self.execute(&Operation::Write(image(CommandFlags::empty(), PARAMETERS[0])));
        self.pass(2);
        assert!(self.commands);
    }

    fn turn(&mut self) {
        let now_ms = self.now_ms();
        let ends = &mut self.ends;
        ends.now_ms = now_ms;
        let mut side = Side { profibus: &mut self.profibus, events: vec![], shown: None };
        let outputs = self.bridge.poll(now_ms, ends.wires, ends.line.turn(), &mut side);
        let (events, shown) = (side.events, side.shown);
        self.inputs = shown;
        assert!(self.bridge.may_feed_watchdog(now_ms));
        let received = ends.line.take_received();
        ends.begin_turn(&received);
        assert_eq!(events, self.events(now_ms));
        for event in events {
            match event {
                PlcEvent::Output(image) => self.ends.promises.requests.take_image(image, None),
                PlcEvent::Left { .. } => {
                    let commands = self.bridge.control_source() == ControlSource::Bus;
                    self.ends.promises.requests.lose_bus(commands);
                }
                PlcEvent::Configured | PlcEvent::Served => unreachable!("PROFIBUS has no registers"),
            }
        }
        self.ends.end_turn(&self.bridge, outputs, Some(1));
    }

    fn pass(&mut self, ms: u32) {
        self.pass_us(ms * 1_000);
    }

    fn decode(op: u8, input: &mut Input<'_>, script: &mut Vec<Operation>) {
        let telegram = match op % 16 {
            3 => return script.push(pick_noise(input, false)),
            4 => return script.push(pick_answer(input)),
            5 => {
                let characters = pick_characters(input, &[0, 0, 0, 20, 40]);
                return script.push(Operation::Characters(Port::Bus, characters));
            }
            8 => {
                let outputs = pick_image(input).to_bytes().to_vec();
                Telegram::Exchange { master: input.pick(&MASTERS), outputs }
            }
            9 => {
                let edge = pick_edge(input).map(|image| [Operation::Write(image), Operation::Pass(2)]);
                return script.extend(edge.into_iter().flatten());
            }
            10 => {
                let watchdog = input.byte();
                let (master, min_tsdr) = (input.pick(&MASTERS), input.byte());
                return script.push(Operation::StartSlave { master, watchdog, min_tsdr });
            }
            11 => {
                let (point, data) = pick_service(input);
                Telegram::ServiceRequest { master: input.pick(&MASTERS), point, data }
            }
            12 => {
                // Clear, Sync, Freeze and unknown commands; to all, to this slave, to groups.
                let to = input.pick(&[BROADCAST, BROADCAST, STATION]) | 0x80;
                let control = [input.pick(&[0x02, 0x02, 0x20, 0x08, 0x00, 0xFF]), input.pick(&[0, 0, 1, 2])];
                let head = [to, input.pick(&MASTERS) | 0x80, 0x46, GLOBAL_CONTROL, 62];
                Telegram::Raw(sd2(&[&head[..], &control].concat()))
            }
            13 => match input.byte() % 3 {
                0 => Telegram::Repetition,
                // Missing outputs (Fail_Safe), and too few.
                1 => Telegram::Exchange { master: input.pick(&MASTERS), outputs: vec![] },
                _ => Telegram::Exchange { master: input.pick(&MASTERS), outputs: vec![input.byte(); 7] },
            },
            _ => {
                let body = [STATION, input.pick(&MASTERS), input.pick(&[0x49, 0x4C, 0x43, 0x4E])];
                let (telegram, fault) = (Telegram::Raw(sd1(&body)), TelegramFault::Intact);
                return script.push(Operation::Profibus { telegram, silence: SILENCES[0], fault });
            }
        };
        let (how, silence, at) = (input.byte(), input.pick(&SILENCES), input.byte());
        // The committed seeds have the codes of these two faults the other way round.
        let how = if matches!(how % 16, 2 | 3) { how ^ 1 } else { how };
        let fault = TelegramFault::of(how, at, || SILENCES[0]);
        script.push(Operation::Profibus { telegram, silence, fault });
    }

    fn execute(&mut self, operation: &Operation) {
        match operation {
            Operation::Write(image) => {
                let telegram = self.exchange(MASTERS[0], &image.to_bytes());
                self.put(telegram);
            }
            Operation::Characters(Port::Bus, characters) => self.receive_all(characters),
            Operation::Profibus { telegram, silence, fault } => self.send(telegram, *silence, *fault),
            Operation::StartSlave { master, watchdog, min_tsdr } => {
                self.start_slave(*master, *watchdog, *min_tsdr);
            }
            other => whole::cannot(other),
        }
    }
}

/// Returns a service access point, and data for it.
fn pick_service(input: &mut Input<'_>) -> (u8, Vec<u8>) {
    match input.byte() % 8 {
        0 => {
            let status = input.pick(&[0x88, 0x80, 0x40, 0x00, 0xA8, 0xB8]);
            let ident = input.pick(&[0x55, 0x55, 0x56]);
            (SET_PRM, vec![status, 1, input.byte(), input.byte(), 0x55, ident, input.pick(&[0, 1])])
        }
        1 => (CHK_CFG, input.pick(&[&[0xA7, 0x9B][..], &[0xA7, 0x9C], &[0xA7]]).to_vec()),
        2 => (SET_SLAVE_ADDRESS, vec![9, 0x55, 0x55, 0]),
        3 => (input.byte(), input.bytes(3).to_vec()),
        _ => (input.pick(&[SLAVE_DIAG, RD_INP, RD_OUTP, GET_CFG]), vec![]),
    }
}

/// The main loop's side, recording its events and inputs.
struct Side<'a> {
    profibus: &'a mut Profibus,
    events: Vec<PlcEvent>,
    shown: Option<InputImage>,
}

impl PlcSide for Side<'_> {
    fn receive(&mut self, now: Instant, view: &mut View<'_>) -> Option<PlcEvent> {
        let event = self.profibus.receive(now, view);
        self.events.extend(event);
        event
    }

    fn show(&mut self, now: Instant, shown: &Shown) {
        self.shown = Some(shown.image);
        self.profibus.show(now, shown);
    }
}
