//! One client of the gripper, as the tasks of the lines hold it.

use super::{Connected, Hub, Shared};
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortKind};
use crate::server::faulty_line::{Fate, FaultyLine, Passage};
use crate::server::request_line::RequestLine;
use fieldbus_host::{Client, Dismissal, IDLE_LIMIT};
use std::cell::RefCell;
use std::sync::Arc;
use wsg_fieldbus::OutputImage;

/// A client of the gripper; dropping it disconnects the client.
#[derive(Debug)]
pub(in crate::server) struct ClientHandle {
    hub: Arc<Hub>,
    connected: Arc<Connected>,
    line: RefCell<FaultyLine>,
    requests: RefCell<RequestLine>,
}

impl ClientHandle {
    pub(super) const fn new(
        hub: Arc<Hub>,
        connected: Arc<Connected>,
        line: RefCell<FaultyLine>,
        requests: RefCell<RequestLine>,
    ) -> Self {
        Self { hub, connected, line, requests }
    }

    /// Takes an output image written by the master.
    pub(in crate::server) fn write_image(&self, image: &OutputImage, is_first: bool) {
        self.connected.activity.note();
        self.hub.act(|gripper, now| gripper.write_image(self.connected.id, now, image, is_first));
    }

    /// Reports that the master that writes images has stopped or is silent.
    pub(in crate::server) fn end_images(&self) {
        self.hub.act(|gripper, now| gripper.end_images(self.connected.id, now));
    }

    /// Ends the subscriptions, because another sender uses the line now.
    pub(in crate::server) fn end_updates(&self) {
        self.hub.with_gripper(|gripper, now| gripper.end_updates(self.connected.id, now));
    }

    fn deliver(&self, bytes: &[u8]) {
        let tag = self.hub.act(|gripper, now| {
            gripper.receive(self.connected.id, now, bytes);
            *gripper.tag()
        });
        self.hub.keep_tag(&tag);
        self.hub.script_waits.notify_all();
    }

    fn next_frame(&self, buffer: &mut FrameBuffer) -> Option<usize> {
        let Self { hub, line, .. } = self;
        let mut line = line.borrow_mut();
        while line.has_room() {
            let mut shared = hub.lock();
            let Shared { gripper, log, line_faults, line_counts, .. } = &mut *shared;
            let Some(frame) = gripper.transmit(self.connected.id, buffer) else { break };
            let now = hub.now();
            let passage = line.pass(&line_faults.of_replies(), now, frame);
            let fate = match passage {
                Passage::Through => Fate::default(),
                Passage::Held(fate) => fate,
            };
            line_counts.replies.count(&fate);
            if let Some(log) = log {
                log.sent(now, self.connected.id, &self.connected.name, frame);
                if !fate.is_harmless() {
                    log.note(now, &self.connected.name, format_args!("<- line fault: {fate}"));
                }
            }
            if passage == Passage::Through {
                return Some(frame.len());
            }
        }
        let arrived = line.arrive(hub.now())?;
        let place = buffer.get_mut(..arrived.len())?;
        place.copy_from_slice(&arrived);
        Some(place.len())
    }
}

impl Client<MAX_FRAME_LEN> for ClientHandle {
    fn receive(&self, bytes: &[u8]) {
        let Self { hub, requests, connected, .. } = self;
        connected.activity.note();
        let mut shared = hub.lock();
        let now = hub.now();
        let Shared { log, line_faults, line_counts, .. } = &mut *shared;
        if let Some(log) = log {
            log.received(connected.id, now, bytes);
        }
        let faults = line_faults.of_requests();
        let mut requests = requests.borrow_mut();
        if faults.are_none() && requests.is_empty() {
            drop(shared);
            return self.deliver(bytes);
        }
        requests.take(&faults, now, bytes, |fate| {
            line_counts.requests.count(fate);
            if !fate.is_harmless()
                && let Some(log) = log
            {
                log.note(now, &connected.name, format_args!("-> line fault: {fate}"));
            }
        });
    }

    fn transmit<'a>(&self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let len = self.next_frame(buffer)?;
        buffer.get(..len)
    }

    fn is_over(&self) -> bool {
        let shared = self.hub.lock();
        shared.gripper.is_lost(self.connected.id)
            && !shared.gripper.has_frame(self.connected.id)
            && self.line.borrow().next_arrival().is_none()
    }

    async fn frame_waits(&self) {
        let arrival = self.line.borrow().next_arrival();
        tokio::select! {
            () = self.hub.reached_if(arrival) => {}
            () = self.connected.frames.notified() => {}
        }
    }

    async fn dismissed(&self) {
        let Connected { kind, name, activity, .. } = &*self.connected;
        // Clients of other protocols stay, because the end of their connection may cause a FAST STOP.
        if *kind != PortKind::ModbusTcp {
            return std::future::pending().await;
        }
        if activity.dismissed().await == Dismissal::Idle {
            self.hub.note_of(name, format_args!("closed: idle for {} s", IDLE_LIMIT.as_secs()));
        }
    }

    fn has_room(&self) -> bool {
        self.line.borrow().has_room()
    }

    fn takes_more(&self) -> bool {
        self.has_room() && self.requests.borrow().has_room()
    }

    async fn request_waits(&self) {
        let arrival = self.requests.borrow().next_arrival();
        self.hub.reached_if(arrival).await;
    }

    fn arrive(&self) {
        let arrived = self.requests.borrow_mut().arrive(self.hub.now());
        if let Some(bytes) = arrived {
            self.deliver(&bytes);
        }
    }
}

impl Drop for ClientHandle {
    fn drop(&mut self) {
        self.hub.disconnect(&self.connected);
    }
}
