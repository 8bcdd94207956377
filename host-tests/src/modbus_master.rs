//! A Modbus RTU master on the emulated board's bus, for tests that control every byte.
//!
//! Implements the MODBUS specifications independently of the server's code, except for the checksum. A test compares
//! that with the `crc` crate and other masters.

use std::cell::Cell;
use std::io::Write;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use bus_modbus::rtu::crc;

use crate::addresses::report;
use crate::clock::Clock;
use crate::socket::Socket;

/// Time limit for an answer to an undamaged request. A busy host may run neither board nor master for seconds, and then the
/// answer is late, but not lost.
const PATIENCE: Duration = Duration::from_secs(60);

/// Time after which a request counts as unanswered, if it or the previous one was damaged.
const UNANSWERED: Duration = Duration::from_millis(1_000);

/// Silence that ends a transmission, in board time.
const PAUSE: Duration = Duration::from_millis(50);

/// Wall-clock time after which a board whose clock has stopped counts as off.
const STANDSTILL: Duration = Duration::from_secs(60);

/// Maximum number of transmissions of a request over a line that damages bytes.
const ATTEMPTS: u32 = 10;

/// Modifies each byte on the line, in both directions.
pub type Disturbance<'a> = &'a mut dyn FnMut(u8) -> u8;

/// A master of one unit.
pub struct Master {
    line: Socket,
    clock: Clock,
    unit: u8,
    /// Attempts without an intact answer.
    pub failed: Failed,
}

/// Attempts without an intact answer, by event on the line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Failed {
    /// A byte was damaged.
    pub damaged: u32,
    /// No byte was damaged now, but one was in the previous attempt.
    pub after_damage: u32,
}

impl Master {
    /// Creates a master on this line that follows the board's clock.
    #[must_use]
    pub const fn new(line: Socket, clock: Clock, unit: u8) -> Self {
        Self { line, clock, unit, failed: Failed { damaged: 0, after_damage: 0 } }
    }

    /// Returns the line without a time-out.
    ///
    /// # Errors
    /// Fails when the time-out cannot be removed.
    pub fn into_line(self) -> Result<Socket> {
        self.line.set_read_timeout(None)?;
        Ok(self.line)
    }

    /// Returns a frame: unit, PDU, checksum.
    #[must_use]
    pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
        let mut frame = [&[unit], pdu].concat();
        frame.extend(crc(&frame).to_le_bytes());
        frame
    }

    /// Raises BUS_TIMEOUT to a minute and BUS_CHAR_TIMEOUT to a second, because a busy host may pause inside requests. Until
    /// this request is accepted, such a pause ends it, so it is repeated.
    ///
    /// # Errors
    /// Fails when the board does not accept the settings.
    pub fn allow_pauses(&mut self) -> Result<()> {
        let [minute, second] = [60_000u16, 1_000].map(u16::to_be_bytes);
        let frame = Self::frame(self.unit, &[&[16, 0, 101, 0, 3, 6][..], &minute, &[0, 1], &second].concat());
        for _ in 0..ATTEMPTS {
            self.send(&frame)?;
            let answer = self.answer(&mut |byte| byte, || true)?;
            // The answer to an earlier attempt may follow.
            while !self.is_silent()? {}
            if answer.is_some_and(|answer| answer == [16, 0, 101, 0, 3]) {
                return Ok(());
            }
        }
        bail!("the board does not accept longer time-outs")
    }

    /// Sends a request, once. Returns the answer's PDU, which may be an exception.
    ///
    /// # Errors
    /// Fails when no intact answer arrives.
    pub fn ask(&mut self, pdu: &[u8]) -> Result<Vec<u8>> {
        self.ask_over(pdu, &mut |byte| byte)
    }

    /// Reads `count` registers from `first` on: holding registers with `function` 3, input registers with 4.
    ///
    /// # Errors
    /// Fails when no intact answer arrives, or an exception.
    pub fn read(&mut self, function: u8, first: u16, count: u16) -> Result<Vec<u16>> {
        let ([a1, a0], [c1, c0]) = (first.to_be_bytes(), count.to_be_bytes());
        let answer = self.ask(&[function, a1, a0, c1, c0])?;
        ensure!(answer[0] == function, "reading register {first}: {answer:02X?}");
        Ok(answer[2..].as_chunks().0.iter().map(|word| u16::from_be_bytes(*word)).collect())
    }

    /// Returns the value of the input register with this name in docs/registers.md.
    ///
    /// # Errors
    /// Fails when no intact answer arrives, or an exception.
    pub fn report(&mut self, name: &str) -> Result<u16> {
        Ok(self.read(4, report(name), 1)?[0])
    }

    /// Writes holding registers from `first` on: one with function 6, several with function 16.
    ///
    /// # Errors
    /// Fails when no intact answer arrives, or an exception.
    pub fn write(&mut self, first: u16, values: &[u16]) -> Result<()> {
        let [f1, f0] = first.to_be_bytes();
        let mut pdu = match values {
            [_] => vec![6, f1, f0],
            _ => vec![16, f1, f0, 0, values.len() as u8, 2 * values.len() as u8],
        };
        pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
        let answer = self.ask(&pdu)?;
        ensure!(answer == pdu[..5], "writing register {first}: {answer:02X?}");
        Ok(())
    }

    /// Does the same as [`ask`](Self::ask), over a line that changes bytes. Repeats the request, and counts that in
    /// [`failed`](Self::failed), only after a byte was damaged.
    ///
    /// # Errors
    /// Fails when no intact answer arrives.
    pub fn ask_over(&mut self, pdu: &[u8], disturb: Disturbance<'_>) -> Result<Vec<u8>> {
        let mut was_damaged = false;
        for _ in 0..ATTEMPTS {
            let is_damaged = Cell::new(false);
            let mut disturb = |byte| {
                let arrives = disturb(byte);
                is_damaged.set(is_damaged.get() || arrives != byte);
                arrives
            };
            let frame: Vec<u8> = Self::frame(self.unit, pdu).into_iter().map(&mut disturb).collect();
            self.send(&frame)?;
            if let Some(answer) = self.answer(&mut disturb, || was_damaged || is_damaged.get())? {
                return Ok(answer);
            }
            match (is_damaged.get(), was_damaged) {
                (true, _) => self.failed.damaged += 1,
                (false, true) => self.failed.after_damage += 1,
                (false, false) => bail!("no intact answer to {pdu:02X?} within {PATIENCE:?}"),
            }
            was_damaged = is_damaged.get();
        }
        bail!("no intact answer to {pdu:02X?} in {ATTEMPTS} attempts")
    }

    /// Does the same as [`ask`](Self::ask) with the last bytes of a frame, whose first bytes were sent before.
    ///
    /// # Errors
    /// Fails when no intact answer arrives.
    pub fn ask_rest(&mut self, frame: &[u8]) -> Result<Vec<u8>> {
        self.send(frame)?;
        self.answer(&mut |byte| byte, || false)?.with_context(|| format!("no answer after {frame:02X?}"))
    }

    /// Sends raw bytes.
    ///
    /// # Errors
    /// Fails when the board is off.
    pub fn send(&mut self, bytes: &[u8]) -> Result<()> {
        self.line.write_all(bytes).context("the board has closed its line")
    }

    /// Returns whether the board has sent nothing. Received bytes are discarded. Let board time pass before the call.
    ///
    /// # Errors
    /// Fails when the board is off.
    pub fn is_silent(&mut self) -> Result<bool> {
        Ok(self.receive()?.is_empty())
    }

    /// Returns the PDU of the next answer; `None` without an intact answer of this unit. Silence ends an answer only
    /// `after_damage`, because a busy host may also pause inside an undamaged one.
    fn answer(
        &mut self,
        disturb: Disturbance<'_>,
        after_damage: impl Fn() -> bool,
    ) -> Result<Option<Vec<u8>>> {
        let mut answer = vec![];
        let start = self.clock.now();
        loop {
            let received = self.receive()?;
            let is_over = received.is_empty() && !answer.is_empty();
            answer.extend(received.into_iter().map(&mut *disturb));
            // Also checks the length, because part of an answer can have a valid checksum by chance.
            if answer.len() >= 5 && answer.len() == length(&answer) {
                let (body, sum) = answer.split_at(answer.len() - 2);
                if crc(body).to_le_bytes() == sum && body.first() == Some(&self.unit) {
                    return Ok(Some(body[1..].to_vec()));
                }
            }
            let waited = self.clock.now() - start;
            if waited >= PATIENCE || (after_damage() && (is_over || waited >= UNANSWERED)) {
                return Ok(None);
            }
        }
    }

    fn receive(&mut self) -> Result<Vec<u8>> {
        let mut chunk = [0; 256];
        let (end, bound) = (self.clock.now() + PAUSE, Instant::now() + STANDSTILL);
        loop {
            match uninterrupted::read_within(&self.line, &mut chunk, PAUSE)? {
                Some(0) => bail!("the board was switched off"),
                Some(count) => return Ok(chunk[..count].to_vec()),
                None if self.clock.now() >= end => return Ok(vec![]),
                None => ensure!(Instant::now() < bound, "the board's clock has stopped"),
            }
        }
    }
}

/// Returns the length of an answer, judged by its beginning, for the functions that the tests use.
fn length(answer: &[u8]) -> usize {
    match answer[1] {
        0x80.. => 5,
        1..=4 | 21 | 23 => 5 + usize::from(answer[2]),
        22 => 10,
        _ => 8,
    }
}
