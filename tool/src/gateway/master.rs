//! A connection of a Modbus/TCP master to the gateway: its frames. The bridge answers the requests.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::pending;
use std::net::IpAddr;
use std::rc::Rc;

use bus_modbus::tcp::{Event, MAX_FRAME_LEN, Receiver};
use fieldbus_host::{Activity, Client};

use super::bridge::Gateway;

/// A connection.
pub(super) struct Master {
    gateway: Rc<Gateway>,
    number: u64,
    address: IpAddr,
    activity: Rc<Activity>,
    frames: RefCell<Frames>,
}

#[derive(Default)]
struct Frames {
    receiver: Receiver,
    answers: VecDeque<Vec<u8>>,
    is_lost: bool,
}

impl Master {
    /// Returns a new connection of the master at this address, or `None` while the gateway accepts none.
    pub(super) fn connect(gateway: &Rc<Gateway>, address: IpAddr) -> Option<Self> {
        let (number, activity) = gateway.admit()?;
        Some(Self { gateway: Rc::clone(gateway), number, address, activity, frames: RefCell::default() })
    }
}

impl Client<MAX_FRAME_LEN> for Master {
    fn receive(&self, bytes: &[u8]) {
        self.activity.note();
        let mut frames = self.frames.borrow_mut();
        let Frames { receiver, answers, is_lost } = &mut *frames;
        let mut rest = bytes;
        while !rest.is_empty() {
            let (taken, event) = receiver.push_slice(rest);
            match event {
                Some(Event::Request(request)) => {
                    let mut frame = [0; MAX_FRAME_LEN];
                    let answer = request.answer(&mut frame, |pdu, response| {
                        self.gateway.serve((self.number, self.address), pdu, response)
                    });
                    if !answer.is_empty() {
                        answers.push_back(answer.to_vec());
                    }
                }
                // A jog ends at once, not when the socket has been drained.
                Some(Event::Lost) => {
                    *is_lost = true;
                    self.gateway.disconnect(self.number, &self.activity);
                }
                Some(Event::Foreign { .. }) | None => {}
            }
            rest = rest.get(taken..).unwrap_or(&[]);
        }
    }

    fn transmit<'a>(&self, buffer: &'a mut [u8; MAX_FRAME_LEN]) -> Option<&'a [u8]> {
        let answer = self.frames.borrow_mut().answers.pop_front()?;
        let place = buffer.get_mut(..answer.len())?;
        place.copy_from_slice(&answer);
        Some(place)
    }

    fn is_over(&self) -> bool {
        let frames = self.frames.borrow();
        frames.is_lost && frames.answers.is_empty()
    }

    /// Never ready: each request is answered when it is received.
    fn frame_waits(&self) -> impl Future<Output = ()> {
        pending()
    }

    async fn dismissed(&self) {
        self.activity.dismissed().await;
    }
}

impl Drop for Master {
    fn drop(&mut self) {
        self.gateway.disconnect(self.number, &self.activity);
    }
}
