//! The gripper in real time, shared by the tasks of its lines.

use super::log::{Direction, Log};
use crate::config::Config;
use crate::gripper::VirtualGripper;
use crate::port::{FrameBuffer, PortId, PortKind};
use crate::time::Time;
use anyhow::Result;
use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use tokio::sync::Notify;
use tokio::time::{Duration, Instant, sleep_until};

/// How many clients a server takes at a time.
const MAX_CLIENTS: usize = 128;

/// The gripper, its clock, and who waits for frames.
#[derive(Debug)]
pub(super) struct Hub {
    gripper: RefCell<Box<VirtualGripper<MAX_CLIENTS>>>,
    started: Instant,
    waiting: RefCell<HashMap<PortId, Rc<Notify>>>,
    /// Something came in, so the next wake may have changed.
    rescheduled: Notify,
    log: RefCell<Option<Log>>,
    check_checksum: bool,
}

impl Hub {
    pub(super) fn new(config: Config, log: Option<Log>) -> Self {
        Self {
            check_checksum: config.check_checksum,
            gripper: RefCell::new(Box::new(VirtualGripper::with_ports(config))),
            started: Instant::now(),
            waiting: RefCell::default(),
            rescheduled: Notify::new(),
            log: RefCell::new(log),
        }
    }

    /// Wakes the gripper whenever something is due.
    pub(super) async fn keep_time(self: Rc<Self>) -> Result<()> {
        loop {
            let wake = self.gripper.borrow().next_wake();
            let due = async {
                match wake {
                    Some(at) => sleep_until(self.started + Duration::from_micros(at.as_micros())).await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                () = due => {}
                () = self.rescheduled.notified() => {}
            }
            self.with_gripper(|gripper, now| gripper.advance(now));
        }
    }

    /// A client; `None` when there are too many.
    pub(super) fn connect(self: &Rc<Self>, kind: PortKind, peer: String) -> Option<Client> {
        let id = self.with_gripper(|gripper, now| {
            gripper.advance(now);
            gripper.connect(kind)
        })?;
        let frames = Rc::new(Notify::new());
        self.waiting.borrow_mut().insert(id, Rc::clone(&frames));
        let name = format!("{kind} {peer}");
        if let Some(log) = &mut *self.log.borrow_mut() {
            log.connect(id, self.check_checksum);
        }
        Some(Client { hub: Rc::clone(self), id, name, frames })
    }

    fn now(&self) -> Time {
        Time::from_micros(u64::try_from(self.started.elapsed().as_micros()).unwrap_or(u64::MAX))
    }

    /// Does something with the gripper at this time, and wakes whom it concerns.
    fn with_gripper<T>(&self, act: impl FnOnce(&mut VirtualGripper<MAX_CLIENTS>, Time) -> T) -> T {
        let mut gripper = self.gripper.borrow_mut();
        let result = act(&mut gripper, self.now());
        for (id, frames) in &*self.waiting.borrow() {
            if gripper.has_frame(*id) {
                frames.notify_one();
            }
        }
        result
    }
}

/// A client of the gripper; gone when dropped.
#[derive(Debug)]
pub(super) struct Client {
    hub: Rc<Hub>,
    id: PortId,
    /// Kind of line and peer, for the log.
    name: String,
    frames: Rc<Notify>,
}

impl Client {
    pub(super) fn receive(&self, bytes: &[u8]) {
        if let Some(log) = &mut *self.hub.log.borrow_mut() {
            log.received(self.id, self.hub.now(), &self.name, bytes);
        }
        self.hub.with_gripper(|gripper, now| gripper.receive(self.id, now, bytes));
        self.hub.rescheduled.notify_one();
    }

    /// The next frame for this client.
    pub(super) fn transmit<'a>(&self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let frame = self.hub.gripper.borrow_mut().transmit(self.id, buffer)?;
        if let Some(log) = &mut *self.hub.log.borrow_mut() {
            log.frame(self.hub.now(), Direction::FromGripper, &self.name, frame);
        }
        Some(frame)
    }

    /// Ready when there may be a frame.
    pub(super) async fn frame_waits(&self) {
        self.frames.notified().await;
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.hub.waiting.borrow_mut().remove(&self.id);
        if let Some(log) = &mut *self.hub.log.borrow_mut() {
            log.disconnect(self.id);
        }
        self.hub.with_gripper(|gripper, now| gripper.disconnect(self.id, now));
        self.hub.rescheduled.notify_one();
    }
}
