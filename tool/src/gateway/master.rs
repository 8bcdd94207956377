//! The ports of Modbus/TCP, and a connection of a master: its frames. The bridge of the addressed gripper answers the requests.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::pending;
use std::net::{IpAddr, SocketAddr};
use std::rc::Rc;

use anyhow::Result;
use bus_modbus::tcp::{Event, MAX_FRAME_LEN, Receiver};
use bus_modbus::{Exception, MAX_PDU_LEN};
use fieldbus_host::{Activity, Client};

use super::bridge::{Gateway, Masters};
use super::config::GripperConfig;

/// A port: one gripper, or several that are addressed by unit.
pub(super) struct Port {
    pub(super) address: SocketAddr,
    masters: Rc<RefCell<Masters>>,
    gateways: Vec<(Option<u8>, Rc<Gateway>)>,
}

impl Port {
    /// Returns a port without a gripper.
    pub(super) fn new(address: SocketAddr) -> Self {
        Self { address, masters: Rc::default(), gateways: Vec::new() }
    }

    /// Adds a gripper, and starts its bridge.
    pub(super) fn add(&mut self, gripper: &GripperConfig) -> Result<Rc<Gateway>> {
        let gateway = Rc::new(Gateway::open(gripper, &self.masters)?);
        self.gateways.push((gripper.unit, Rc::clone(&gateway)));
        Ok(gateway)
    }

    pub(super) fn serves(&self, gateway: &Rc<Gateway>) -> bool {
        self.gateways.iter().any(|(_, other)| Rc::ptr_eq(gateway, other))
    }

    /// Answers a request for a unit. Returns the length of the response.
    fn serve(&self, master: (u64, IpAddr), unit: u8, pdu: &[u8], response: &mut [u8; MAX_PDU_LEN]) -> usize {
        if let Some((_, gateway)) = self.gateways.iter().find(|(own, _)| own.is_none_or(|own| own == unit)) {
            return gateway.serve(master, pdu, response);
        }
        let (Some(function), [code, exception, ..]) = (pdu.first(), response) else { return 0 };
        (*code, *exception) = (function | 0x80, Exception::GatewayPathUnavailable.code());
        2
    }

    /// Ends a connection.
    fn disconnect(&self, master: u64, activity: &Rc<Activity>) {
        self.masters.borrow_mut().remove(activity);
        self.gateways.iter().for_each(|(_, gateway)| gateway.end_jog(master));
    }
}

/// A connection.
pub(super) struct Master {
    port: Rc<Port>,
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
    pub(super) fn connect(port: &Rc<Port>, address: IpAddr) -> Option<Self> {
        let (number, activity) = port.masters.borrow_mut().admit()?;
        Some(Self { port: Rc::clone(port), number, address, activity, frames: RefCell::default() })
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
                        self.port.serve((self.number, self.address), request.unit, pdu, response)
                    });
                    if !answer.is_empty() {
                        answers.push_back(answer.to_vec());
                    }
                }
                // A jog ends at once, not when the socket has been drained.
                Some(Event::Lost) => {
                    *is_lost = true;
                    self.port.disconnect(self.number, &self.activity);
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
        self.port.disconnect(self.number, &self.activity);
    }
}
