//! One client of the gripper, as the tasks of the lines hold it.

use super::{Hub, Waits};
use crate::control::{Bench, Client};
use crate::port::{FrameBuffer, MAX_FRAME_LEN, PortKind};
use crate::time::Time;
use fieldbus_host::{Dismissal, IDLE_LIMIT};
use std::cell::RefCell;
use std::sync::Arc;
use wsg_fieldbus::OutputImage;

/// A client of the gripper; dropping it disconnects the client.
#[derive(Debug)]
pub(in crate::server) struct ClientHandle {
    hub: Arc<Hub>,
    waits: Arc<Waits>,
    client: RefCell<Client>,
}

impl ClientHandle {
    pub(super) const fn new(hub: Arc<Hub>, waits: Arc<Waits>, client: Client) -> Self {
        Self { hub, waits, client: RefCell::new(client) }
    }

    /// Takes an output image written by the master.
    pub(in crate::server) fn write_image(&self, image: &OutputImage, is_first: bool) {
        self.waits.activity.note();
        self.at_bench(|client, bench, now| {
            bench.note_received(client.number, now);
            bench.act(now, |gripper, now| gripper.write_image(client.id, now, image, is_first));
        });
    }

    /// Reports that the master that writes images has stopped or is silent.
    pub(in crate::server) fn end_images(&self) {
        self.hub.act(|gripper, now| gripper.end_images(self.waits.id, now));
    }

    /// Ends the subscriptions, because another sender uses the line now.
    pub(in crate::server) fn end_updates(&self) {
        self.hub.act(|gripper, now| gripper.end_updates(self.waits.id, now));
    }

    fn at_bench<T>(&self, act: impl FnOnce(&mut Client, &mut Bench, Time) -> T) -> T {
        let client = &mut *self.client.borrow_mut();
        self.hub.at_bench(|bench, now| act(client, bench, now))
    }

    /// The same for what may give the gripper a request.
    fn deliver(&self, act: impl FnOnce(&mut Client, &mut Bench, Time)) {
        let tag = self.at_bench(|client, bench, now| {
            act(client, bench, now);
            *bench.gripper().tag()
        });
        self.hub.keep_tag(&tag);
        self.hub.script_waits.notify_all();
    }
}

impl fieldbus_host::Client<MAX_FRAME_LEN> for ClientHandle {
    fn receive(&self, bytes: &[u8]) {
        self.waits.activity.note();
        self.deliver(|client, bench, now| client.receive(bench, now, bytes));
    }

    fn transmit<'a>(&self, buffer: &'a mut FrameBuffer) -> Option<&'a [u8]> {
        let client = &mut *self.client.borrow_mut();
        let len = client.transmit(&mut self.hub.lock().bench, self.hub.now(), buffer)?;
        buffer.get(..len)
    }

    fn is_over(&self) -> bool {
        let shared = self.hub.lock();
        let gripper = shared.bench.gripper();
        gripper.is_lost(self.waits.id)
            && !gripper.has_frame(self.waits.id)
            && self.client.borrow().next_frame().is_none()
    }

    async fn frame_waits(&self) {
        let arrival = self.client.borrow().next_frame();
        tokio::select! {
            () = self.hub.reached_if(arrival) => {}
            () = self.waits.frames.notified() => {}
        }
    }

    async fn dismissed(&self) {
        let (kind, name) = {
            let client = self.client.borrow();
            (client.kind, Arc::clone(&client.name))
        };
        // Clients of other protocols stay, because the end of their connection may cause a FAST STOP.
        if kind != PortKind::ModbusTcp {
            return std::future::pending().await;
        }
        if self.waits.activity.dismissed().await == Dismissal::Idle {
            self.hub.note_of(&name, format_args!("closed: idle for {} s", IDLE_LIMIT.as_secs()));
        }
    }

    fn has_room(&self) -> bool {
        self.client.borrow().has_room()
    }

    fn takes_more(&self) -> bool {
        self.client.borrow().takes_more()
    }

    async fn request_waits(&self) {
        let arrival = self.client.borrow().next_request();
        self.hub.reached_if(arrival).await;
    }

    fn arrive(&self) {
        self.deliver(|client, bench, now| client.arrive(bench, now));
    }
}

impl Drop for ClientHandle {
    fn drop(&mut self) {
        let number = self.client.get_mut().number;
        self.hub.at_bench(|bench, now| bench.disconnect(number, now));
    }
}
