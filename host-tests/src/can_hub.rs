//! Stations on a CAN bus in addition to the board: a virtual gripper, and a terminal for masters.

use std::io::Write;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use bus_slcan::{Adapter, ClassicFrame, Decoder, Line, encode};
use embedded_can::Id;
use wsg_protocol::can::{Identifiers, Segmenter};

use crate::can_bus::Station;
use crate::can_controller::BusController;
use crate::can_wire::WireFrame;
use crate::clock::Clock;
use crate::socket::{self, Socket};

/// Lines to the stations on the bus, served until their other ends are closed.
#[derive(Debug)]
pub struct CanHub {
    /// The gripper's end: a byte stream of messages, as [`GripperEnd`](crate::gripper_end::GripperEnd) expects.
    pub gripper: Socket,
    /// The master's end: SLCAN, including the adapter's replies.
    pub master: Socket,
}

impl CanHub {
    /// Connects a gripper and a master to these stations. The gripper's station follows `clock`, as the gripper does.
    ///
    /// # Errors
    /// Fails when a line or a thread cannot be created.
    pub fn start<C: BusController>([first, second]: [Station<C>; 2], clock: &Clock) -> Result<Self> {
        let (gripper, own_gripper) = socket::pair()?;
        let (master, own_master) = socket::pair()?;
        serve_gripper(first, own_gripper, clock)?;
        serve_master(second, own_master)?;
        Ok(Self { gripper, master })
    }
}

fn serve_gripper<C: BusController>(station: Station<C>, line: Socket, clock: &Clock) -> Result<()> {
    let pair = Identifiers::DEFAULT.gripper();
    let (send, mut segmenter) = (station.sender(), Segmenter::new());
    let from_gripper = line.try_clone()?;
    let mut segment = move |byte| {
        let frame = segmenter.push(byte).and_then(|segment| segment.frame::<ClassicFrame>(pair.transmit));
        if let Some(frame) = frame {
            send(WireFrame::of(&frame));
        }
    };
    let (received, mut to_gripper) = (station.received, line);
    let mut pass = move |frame: WireFrame| {
        let is_for_gripper = frame.id == Id::Standard(pair.receive) && !frame.is_remote;
        !is_for_gripper || to_gripper.write_all(frame.payload()).is_ok()
    };
    if clock.is_wall() {
        spawn(move || each_byte(&from_gripper, segment))?;
        return spawn(move || {
            for frame in received {
                if !pass(frame) {
                    return;
                }
            }
        });
    }
    clock.follow(move || {
        while uninterrupted::is_readable_within(&from_gripper, Duration::ZERO).unwrap_or(false) {
            if !some_bytes(&from_gripper, &mut segment) {
                return false;
            }
        }
        received.try_iter().all(&mut pass)
    });
    Ok(())
}

fn serve_master<C: BusController>(station: Station<C>, line: Socket) -> Result<()> {
    let (send, mut decoder) = (station.sender(), Decoder::new());
    let from_master = line.try_clone()?;
    let adapter = Arc::new(Mutex::new((line, Adapter::new())));
    let answering = Arc::clone(&adapter);
    spawn(move || {
        each_byte(&from_master, |byte| {
            let Some(line) = decoder.push::<ClassicFrame>(byte) else { return };
            let (to_master, adapter) = &mut *lock(&answering);
            // A master that has disconnected is skipped.
            let _ = to_master.write_all(adapter.answer(&line));
            if let (Line::Frame(frame), true) = (line, adapter.is_open()) {
                send(WireFrame::of(&frame));
            }
        });
    })?;
    let received = station.received;
    spawn(move || {
        for frame in received {
            let (to_master, adapter) = &mut *lock(&adapter);
            let Some(frame) = frame.to::<ClassicFrame>().filter(|_| adapter.is_open()) else { continue };
            if to_master.write_all(encode(&frame).as_bytes()).is_err() {
                return;
            }
        }
    })
}

fn spawn(run: impl FnOnce() + Send + 'static) -> Result<()> {
    thread::Builder::new()
        .name("can".into())
        .spawn(run)
        .map(drop)
        .context("cannot start the thread of a line")
}

fn each_byte(line: &Socket, mut take: impl FnMut(u8)) {
    while some_bytes(line, &mut take) {}
}

/// Passes the bytes of one read. Returns whether the other end is still open.
fn some_bytes(line: &Socket, mut take: impl FnMut(u8)) -> bool {
    let mut chunk = [0; 256];
    let count = uninterrupted::read(line, &mut chunk).unwrap_or(0);
    chunk[..count].iter().for_each(|&byte| take(byte));
    count > 0
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
