//! The bridge's library in place of a board, for computers without an emulator: the same application without the firmware's
//! registers and interrupts. It has the gripper's line and the wires. A turn takes a millisecond of its time, which is not faster than
//! real time, and waits for the gripper like that of the Pico's emulator.

use std::io::{ErrorKind, Write as _};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::Result;
use wsg_bridge_fw::Config;
use wsg_bridge_fw::io::Inputs;

use super::watch::Watch;
use super::{Chip, Lines, PATIENCE};
use crate::clock::Clock;
use crate::flash_model::FlashModel;
use crate::rtu_double::RtuDouble;
use crate::serial_gripper::SerialLine;
use crate::socket::{self, Socket};
use crate::world::start;

/// Name in messages.
pub(super) const LIBRARY: &str = "the bridge's library";

/// Duration of a turn.
const TURN: Duration = Duration::from_millis(1);

/// The running library. Dropping it ends it.
#[derive(Debug)]
pub(super) struct Library(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    inputs: AtomicU8,
    now_ms: AtomicU32,
    is_off: AtomicBool,
}

impl Library {
    /// Starts the library with default settings on this clock, and returns when its main loop runs.
    pub(super) fn start(watch: &Arc<Watch>, clock: &Clock) -> Result<(Self, Lines)> {
        let (near, far) = socket::pair()?;
        near.set_nonblocking(true)?;
        let library = Self(Arc::default());
        let (shared, running, clock) = (library.0.clone(), watch.clone(), clock.clone());
        thread::spawn(move || {
            shared.run(near, &running, &clock);
            running.end();
        });
        drop(watch.wait(PATIENCE, |seen| seen.is_served)?);
        Ok((library, Lines { gripper: Some(far), bus: None, service: None }))
    }
}

impl Shared {
    /// Runs the main loop until the library is switched off or the gripper's end of the line is closed.
    fn run(&self, mut line: Socket, watch: &Watch, clock: &Clock) {
        let mut flash = FlashModel::new();
        let (mut station, _) = start(&Config::DEFAULT, &mut flash);
        let mut serial = SerialLine::with_room(usize::MAX);
        // The PLC uses wires only.
        let [mut bus, mut service] = [RtuDouble::default(), RtuDouble::default()];
        let mut received = [0; 256];
        let mut due = Instant::now();
        for now_ms in 0.. {
            // A paused computer pauses the library, too.
            thread::sleep(due.saturating_duration_since(Instant::now()));
            due = due.max(Instant::now()) + TURN;
            if self.is_off.load(Ordering::Relaxed) {
                return;
            }
            self.now_ms.store(now_ms, Ordering::Relaxed);
            clock.report(u64::from(now_ms) * 1_000);
            match uninterrupted::read(&mut line, &mut received) {
                Ok(0) => return,
                Ok(count) => serial.deliver(received.get(..count).unwrap_or(&[])),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(_) => return,
            }
            let inputs = Inputs::from_bits_retain(self.inputs.load(Ordering::Relaxed));
            let outputs = station.turn(now_ms, inputs, &mut serial, &mut bus, &mut service, &mut flash);
            if line.write_all(&serial.take_sent()).is_err() {
                return;
            }
            watch.show(outputs, true);
        }
    }
}

impl Chip for Library {
    fn set_input(&self, wire: Inputs, high: bool) -> Result<()> {
        if high {
            self.0.inputs.fetch_or(wire.bits(), Ordering::Relaxed);
        } else {
            self.0.inputs.fetch_and(!wire.bits(), Ordering::Relaxed);
        }
        Ok(())
    }

    fn now_ms(&self) -> Result<u32> {
        Ok(self.0.now_ms.load(Ordering::Relaxed))
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        self.0.is_off.store(true, Ordering::Relaxed);
    }
}
