//! A Modbus RTU master on the emulated board's bus, for tests that want every byte in their hand.
//!
//! It knows what the MODBUS specifications say of requests and answers, and nothing of the server's code but the
//! checksum, which a test holds to the `crc` crate and to other masters.

use std::io::Write;
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use bus_modbus::rtu::crc;

use crate::clock::Clock;

/// How long an answer may take, in the board's time.
const PATIENCE: Duration = Duration::from_millis(1_000);

/// After so much silence what has come is all, in the board's time.
const PAUSE: Duration = Duration::from_millis(50);

/// A board whose time stands for so long, on the wall, is off.
const STANDSTILL: Duration = Duration::from_secs(60);

/// How often a request is sent at the most.
const ATTEMPTS: u32 = 10;

/// What becomes of each byte on the line, each way.
pub type Disturbance<'a> = &'a mut dyn FnMut(u8) -> u8;

/// A master for one unit.
pub struct Master {
    line: UnixStream,
    clock: Clock,
    unit: u8,
    /// Attempts without an intact answer.
    pub failed: Failed,
}

/// Attempts without an intact answer, by what happened on the line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Failed {
    /// A byte was damaged.
    pub damaged: u32,
    /// No byte was damaged, neither in this attempt nor in the one before: the host was too busy to run the board.
    pub undamaged: u32,
    /// No byte was damaged, but one was in the attempt before.
    pub after_damage: u32,
}

impl Master {
    /// A master on this line, which goes by the board's clock.
    #[must_use]
    pub const fn new(line: UnixStream, clock: Clock, unit: u8) -> Self {
        Self { line, clock, unit, failed: Failed { damaged: 0, undamaged: 0, after_damage: 0 } }
    }

    /// Hands the line back, without a time-out.
    ///
    /// # Errors
    /// When the line keeps it.
    pub fn into_line(self) -> Result<UnixStream> {
        self.line.set_read_timeout(None)?;
        Ok(self.line)
    }

    /// A frame: unit, PDU, checksum.
    #[must_use]
    pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        let mut frame = [&[unit], pdu].concat();
        frame.extend(crc(&frame).to_le_bytes());
        frame
    }

    /// Asks until an intact answer comes: its PDU, which may be an exception.
    ///
    /// # Errors
    /// When none comes.
    pub fn ask(&mut self, pdu: &[u8]) -> Result<Vec<u8>> {
        self.ask_over(pdu, &mut |byte| byte)
    }

    /// As [`ask`](Self::ask), over a line that changes bytes.
    ///
    /// # Errors
    /// When no intact answer comes.
    pub fn ask_over(&mut self, pdu: &[u8], disturb: Disturbance<'_>) -> Result<Vec<u8>> {
        let mut was_damaged = false;
        for _ in 0..ATTEMPTS {
            let mut is_damaged = false;
            let mut disturb = |byte| {
                let arrives = disturb(byte);
                is_damaged |= arrives != byte;
                arrives
            };
            let frame: Vec<u8> = Self::frame(self.unit, pdu).into_iter().map(&mut disturb).collect();
            self.send(&frame)?;
            if let Some(answer) = self.answer(&mut disturb)? {
                return Ok(answer);
            }
            let failed = match (is_damaged, was_damaged) {
                (true, _) => &mut self.failed.damaged,
                (false, true) => &mut self.failed.after_damage,
                (false, false) => &mut self.failed.undamaged,
            };
            *failed += 1;
            was_damaged = is_damaged;
        }
        bail!("no intact answer to {pdu:02X?} in {ATTEMPTS} attempts")
    }

    /// Puts bytes on the line.
    ///
    /// # Errors
    /// When the board is off.
    pub fn send(&mut self, bytes: &[u8]) -> Result<()> {
        self.line.write_all(bytes).context("the board takes nothing any more")
    }

    /// Whether the line stays silent for this time of the board; what came meanwhile is dropped.
    ///
    /// # Errors
    /// When the board is off.
    pub fn is_silent(&mut self, time: Duration) -> Result<bool> {
        let bound = self.clock.now() + time;
        let mut silent = true;
        while self.clock.now() < bound {
            silent &= self.receive()?.is_empty();
        }
        Ok(silent)
    }

    /// The next answer's PDU; none if nothing intact from this unit comes.
    ///
    /// # Errors
    /// When the board is off.
    pub fn answer(&mut self, disturb: Disturbance<'_>) -> Result<Option<Vec<u8>>> {
        let mut answer = vec![];
        let bound = self.clock.now() + PATIENCE;
        while self.clock.now() < bound {
            let received = self.receive()?;
            if received.is_empty() && !answer.is_empty() {
                return Ok(None);
            }
            answer.extend(received.into_iter().map(&mut *disturb));
            // By its length as well: a part of an answer can have a right checksum by chance.
            if answer.len() >= 5 && answer.len() == length(&answer) {
                let (body, sum) = answer.split_at(answer.len() - 2);
                if crc(body).to_le_bytes() == sum && body.first() == Some(&self.unit) {
                    return Ok(Some(body[1..].to_vec()));
                }
            }
        }
        Ok(None)
    }

    fn receive(&mut self) -> Result<Vec<u8>> {
        let mut chunk = [0; 256];
        let (end, bound) = (self.clock.now() + PAUSE, Instant::now() + STANDSTILL);
        loop {
            match uninterrupted::read_within(&self.line, &mut chunk, PAUSE)? {
                Some(0) => bail!("the board went off"),
                Some(count) => return Ok(chunk[..count].to_vec()),
                None if self.clock.now() >= end => return Ok(vec![]),
                None => ensure!(Instant::now() < bound, "the board's clock stands still"),
            }
        }
    }
}

/// How long an answer that begins like this is, of the functions that the tests use.
fn length(answer: &[u8]) -> usize {
    match answer[1] {
        0x80.. => 5,
        1..=4 | 23 => 5 + usize::from(answer[2]),
        22 => 10,
        _ => 8,
    }
}
