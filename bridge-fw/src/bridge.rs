//! The bridge: a PLC side, the register controller, the session, and the gripper's line.

use crate::digital_io::DigitalIo;
use crate::io::{Inputs, Outputs};
use crate::log;
use crate::recipe::{RECIPE_COUNT, RECIPES, Recipe};
use embedded_io::{Read, ReadReady, Write, WriteReady};
use wsg_protocol::fieldbus::{Controller, ForceUnit};
use wsg_protocol::session::{self, Notice, Session};
use wsg_protocol::{Command, DeviceTag, FrameEncoder, FrameParser, Instant, frame};

/// The longest reply that a bridge asks for: a device tag behind its status code. Everything longer is not for it.
pub const MAX_REPLY_LEN: usize = DeviceTag::MAX_LEN + 2;

/// Bytes taken from the line in one turn of the main loop, at the most: a line that never falls silent must not keep
/// the wires waiting. One millisecond at 115 200 bit/s brings 12.
const MAX_RECEIVED_PER_POLL: usize = 256;

/// What can be set about a bridge.
#[derive(Clone, Copy, Debug)]
pub struct Config {
    /// How long a wire must keep its level before it counts, in milliseconds.
    pub debounce_ms: u32,
    /// How long BUSY is high at least, in milliseconds: fingers that are at their goal already would show it for less than
    /// a PLC's cycle.
    pub min_busy_ms: u32,
    /// After how long without a byte half a frame is given up, in milliseconds.
    pub half_frame_ms: u32,
    /// What the recipe wires choose from.
    pub recipes: &'static [Recipe; RECIPE_COUNT],
    /// Time-outs towards the gripper.
    pub session: session::Config,
}

impl Config {
    /// Debounced for 2 ms, BUSY for 50 ms at least, the recipes as delivered, time-outs for a serial line.
    pub const DEFAULT: Self = Self {
        debounce_ms: 2,
        min_busy_ms: 50,
        half_frame_ms: 20,
        recipes: &RECIPES,
        session: session::Config::DEFAULT,
    };
}

/// What the bridge has met that it could not use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// On the gripper's line, below frames.
    pub line: frame::Counters,
    /// In frames and requests.
    pub session: session::Counters,
}

/// One bridge between the wires of a PLC and one gripper.
///
/// Board-free: [`poll`](Self::poll) it in the main loop, at least once a millisecond.
#[derive(Debug)]
pub struct Bridge {
    half_frame_ms: u32,
    parser: FrameParser<MAX_REPLY_LEN>,
    received_at: Instant,
    session: Session,
    controller: Controller,
    wires: DigitalIo,
    /// The frame that is being sent.
    sending: Option<FrameEncoder<Command<'static>>>,
}

impl Bridge {
    /// A bridge at power-up: nothing is known, nothing will be sent that moves fingers.
    #[must_use]
    pub const fn new(config: Config) -> Self {
        Self {
            half_frame_ms: config.half_frame_ms,
            parser: FrameParser::new(),
            received_at: Instant::from_millis(0),
            session: Session::new(config.session),
            controller: Controller::new(),
            wires: DigitalIo::new(config.debounce_ms, config.min_busy_ms, config.recipes),
            sending: None,
        }
    }

    /// One turn: takes what the line and the wires brought, sends what is due, and gives the levels of the wires to the
    /// PLC. Never waits: `link` is read only when it has bytes and written only when it has room.
    pub fn poll<L: Read + ReadReady + Write + WriteReady>(
        &mut self,
        now_ms: u32,
        inputs: Inputs,
        link: &mut L,
    ) -> Outputs {
        let now = Instant::from_millis(now_ms);
        self.receive(now, link);
        self.expire_half_frame(now);
        self.tick(now);
        self.take_wires(now, inputs);
        self.forward_commands();
        self.tick(now);
        self.transmit(now, link);
        let gripper = self.controller.input(self.session.known());
        self.wires.outputs(now, &gripper, self.session.is_connected())
    }

    /// What has been met so far that could not be used.
    #[must_use]
    pub const fn counters(&self) -> Counters {
        Counters { line: self.parser.counters(), session: self.session.counters() }
    }

    fn receive<L: Read + ReadReady>(&mut self, now: Instant, link: &mut L) {
        let mut received = 0;
        let mut chunk = [0; 32];
        while received < MAX_RECEIVED_PER_POLL && link.read_ready().unwrap_or(false) {
            let Ok(count @ 1..) = link.read(&mut chunk) else { break };
            received += count;
            self.received_at = now;
            let mut rest = chunk.get(..count).unwrap_or(&[]);
            loop {
                let (taken, event) = self.parser.push_slice(rest);
                rest = rest.get(taken..).unwrap_or(&[]);
                let Some(event) = event else { break };
                let noticed = self.session.handle(now, &event);
                notice(&mut self.controller, &self.session, noticed);
            }
        }
    }

    fn expire_half_frame(&mut self, now: Instant) {
        if !self.parser.is_mid_frame() || now.since(self.received_at) < self.half_frame_ms {
            return;
        }
        while let Some(event) = self.parser.expire() {
            let noticed = self.session.handle(now, &event);
            notice(&mut self.controller, &self.session, noticed);
        }
    }

    fn tick(&mut self, now: Instant) {
        while let Some(noticed) = self.session.tick(now) {
            if noticed == Notice::Disconnected {
                // What has not left by now must not leave when the line comes back.
                self.sending = None;
            }
            notice(&mut self.controller, &self.session, Some(noticed));
        }
    }

    fn take_wires(&mut self, now: Instant, inputs: Inputs) {
        let known = self.session.known();
        let unit = known.info.map_or(ForceUnit::default(), |info| ForceUnit::of(info.device));
        let gripper = self.controller.input(known);
        if let Some(image) = self.wires.update(now, inputs, &gripper, unit) {
            self.controller.set_output(&image, known);
        }
    }

    fn forward_commands(&mut self) {
        while let Some(command) = self.controller.poll_command() {
            if let Err(error) = self.session.request(command) {
                self.controller.refused(command.id(), error);
            }
        }
    }

    fn transmit<L: Write + WriteReady>(&mut self, now: Instant, link: &mut L) {
        loop {
            let sending = match &mut self.sending {
                Some(sending) => sending,
                empty => {
                    let Some(command) = self.session.poll_transmit(now) else { return };
                    log::sent(&command);
                    empty.insert(FrameEncoder::new(command.id().code(), command))
                }
            };
            // One byte at a time: a byte is taken from the frame only when the line has room for it.
            while sending.len() > 0 {
                if !link.write_ready().unwrap_or(false) {
                    return;
                }
                let Some(byte) = sending.next() else { break };
                if !matches!(link.write(&[byte]), Ok(1)) {
                    // The rest of this frame would make no sense to the gripper; the session misses the answer.
                    break;
                }
            }
            self.sending = None;
        }
    }
}

fn notice(controller: &mut Controller, session: &Session, notice: Option<Notice<'_>>) {
    if let Some(notice) = notice {
        log::noticed(&notice);
        controller.handle(&notice, session.known());
    }
}
