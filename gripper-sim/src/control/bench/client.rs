//! One client of the gripper, with the faulty lines to it and from it.

use super::Bench;
use crate::control::faulty_line::{Fate, FaultyLine, Latency, Passage};
use crate::control::request_line::RequestLine;
use crate::port::{FrameBuffer, PortId, PortKind};
use crate::time::Time;
use std::sync::Arc;

/// A client of the gripper.
#[derive(Debug)]
pub(crate) struct Client {
    pub(crate) id: PortId,
    pub(crate) kind: PortKind,
    /// Its number in the order of connection.
    pub(crate) number: u64,
    /// Kind of line and peer, as shown in the log.
    pub(crate) name: Arc<str>,
    line: FaultyLine,
    requests: RequestLine,
}

impl Client {
    pub(super) fn new(
        id: PortId,
        kind: PortKind,
        number: u64,
        name: Arc<str>,
        seed: u64,
        latency: Latency,
    ) -> Self {
        let line = FaultyLine::new(seed, number).with_latency(latency);
        Self { id, kind, number, name, line, requests: RequestLine::new(kind, seed, number) }
    }

    /// Takes bytes from the client.
    pub(crate) fn receive(&mut self, bench: &mut Bench, now: Time, bytes: &[u8]) {
        let Self { id, number, name, requests, .. } = self;
        bench.note_received(*number, now);
        let Bench { log, line_faults, line_counts, .. } = bench;
        if let Some(log) = log {
            log.received(*id, now, bytes);
        }
        let faults = line_faults.of_requests();
        if faults.are_none() && requests.is_empty() {
            return self.deliver(bench, now, bytes);
        }
        requests.take(&faults, now, bytes, |fate| {
            line_counts.requests.count(fate);
            if !fate.is_harmless()
                && let Some(log) = log
            {
                log.note(now, name, format_args!("-> line fault: {fate}"));
            }
        });
    }

    fn deliver(&self, bench: &mut Bench, now: Time, bytes: &[u8]) {
        bench.act(now, |gripper, now| gripper.receive(self.id, now, bytes));
    }

    /// Passes on the next request that the line has delayed.
    pub(crate) fn arrive(&mut self, bench: &mut Bench, now: Time) {
        if let Some(bytes) = self.requests.arrive(now) {
            self.deliver(bench, now, &bytes);
        }
    }

    /// Returns the length of the next frame for the client, which is in the buffer.
    pub(crate) fn transmit(
        &mut self,
        bench: &mut Bench,
        now: Time,
        buffer: &mut FrameBuffer,
    ) -> Option<usize> {
        let Self { id, name, line, .. } = self;
        let Bench { gripper, log, line_faults, line_counts, .. } = bench;
        while line.has_room() {
            let Some(frame) = gripper.transmit(*id, buffer) else { break };
            let passage = line.pass(&line_faults.of_replies(), now, frame);
            let fate = match passage {
                Passage::Through => Fate::default(),
                Passage::Held(fate) => fate,
            };
            line_counts.replies.count(&fate);
            if let Some(log) = log {
                log.sent(now, *id, name, frame);
                if !fate.is_harmless() {
                    log.note(now, name, format_args!("<- line fault: {fate}"));
                }
            }
            if passage == Passage::Through {
                return Some(frame.len());
            }
        }
        let arrived = line.arrive(now)?;
        let place = buffer.get_mut(..arrived.len())?;
        place.copy_from_slice(&arrived);
        Some(place.len())
    }

    /// Returns when the next frame has passed the line to the client.
    pub(crate) fn next_frame(&self) -> Option<Time> {
        self.line.next_arrival()
    }

    /// Returns when the next request has passed the line to the gripper.
    pub(crate) fn next_request(&self) -> Option<Time> {
        self.requests.next_arrival()
    }

    /// Returns whether there is room for answers.
    pub(crate) fn has_room(&self) -> bool {
        self.line.has_room()
    }

    /// Returns whether there is room for answers and requests.
    pub(crate) fn takes_more(&self) -> bool {
        self.has_room() && self.requests.has_room()
    }
}
