//! Client of the GDB remote protocol for QEMU's stub: watchpoints, core registers, memory.
//!
//! Covers only the commands that this project needs. QEMU processes packets in sequence, so several may be in flight.
//! The well-maintained crates implement the stub's side only.

use std::collections::VecDeque;
use std::io::Write;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

use crate::socket::Socket;

/// R0 to R15 and xPSR.
const CORE_REGISTERS: usize = 17;

/// Core registers of a stopped machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoreRegisters {
    /// R0 to R15, where R15 is the program counter.
    pub r: [u32; 16],
    /// xPSR; the exception number cannot be written.
    pub xpsr: u32,
}

/// A connection to a stopped machine that was started with `-gdb`.
#[derive(Debug)]
pub struct Gdb {
    line: Socket,
    patience: Duration,
    received: Vec<u8>,
    packets: VecDeque<String>,
}

/// Bytes of a piece of memory that fits into a packet with its digits.
const PART: usize = 1024;

impl Gdb {
    /// Connects over `line`; an answer that takes longer than `patience` is an error.
    ///
    /// # Errors
    /// Fails when `patience` is zero.
    pub fn new(line: Socket, patience: Duration) -> Result<Self> {
        line.set_write_timeout(Some(patience))?;
        Ok(Self { line, patience, received: Vec::new(), packets: VecDeque::new() })
    }

    /// Stops the machine before each load and store in this range, or before each store only. QEMU accepts any length.
    ///
    /// # Errors
    /// Fails when QEMU rejects the watchpoint or does not answer.
    pub fn watch(&mut self, first: u32, len: u32, stores_only: bool) -> Result<()> {
        self.command(&format!("Z{},{first:x},{len:x}", if stores_only { 2 } else { 4 }))
    }

    /// Reads the core registers and pieces of memory (address, length) consistently, in one round trip.
    ///
    /// # Errors
    /// Fails when QEMU does not return them.
    pub fn look<const N: usize>(
        &mut self,
        places: [(u32, usize); N],
    ) -> Result<(CoreRegisters, [Vec<u8>; N])> {
        let questions = places.map(|(address, len)| format!("m{address:x},{len:x}"));
        let mut packets = vec!["g"];
        packets.extend(questions.iter().map(String::as_str));
        self.send(&packets)?;
        let registers = self.reported_core_registers()?;
        let mut pieces = [const { Vec::new() }; N];
        for (piece, (address, len)) in pieces.iter_mut().zip(places) {
            *piece = self.reported_memory(address, len)?;
        }
        Ok((registers, pieces))
    }

    /// Reads memory, including the side effects of peripherals.
    ///
    /// # Errors
    /// Fails when the address is invalid or QEMU does not answer.
    pub fn read_memory(&mut self, address: u32, len: usize) -> Result<Vec<u8>> {
        self.send(&[&format!("m{address:x},{len:x}")])?;
        self.reported_memory(address, len)
    }

    /// Writes memory of the stopped machine, even a ROM.
    ///
    /// # Errors
    /// Fails when QEMU rejects it or does not answer.
    pub fn write_memory(&mut self, address: u32, bytes: &[u8]) -> Result<()> {
        for (part, at) in bytes.chunks(PART).zip((address..).step_by(PART)) {
            let digits: String = part.iter().map(|byte| format!("{byte:02x}")).collect();
            self.command(&format!("M{at:x},{:x}:{digits}", part.len()))?;
        }
        Ok(())
    }

    /// Resumes the machine.
    ///
    /// # Errors
    /// Fails when QEMU has ended.
    pub fn run(&mut self) -> Result<()> {
        self.send(&["c"])
    }

    /// Resumes the machine with these registers.
    ///
    /// # Errors
    /// Fails when QEMU rejects them or has ended.
    pub fn run_from(&mut self, registers: &CoreRegisters) -> Result<()> {
        let words = registers.r.iter().chain([&registers.xpsr]);
        let digits: String = words.map(|word| format!("{:08x}", word.swap_bytes())).collect();
        self.send(&[&format!("G{digits}"), "c"])?;
        self.expect_ok("G")
    }

    /// Waits until the machine stops at a watchpoint; returns `false` while it is still running.
    ///
    /// # Errors
    /// Fails when it stops for another reason, or when QEMU ends.
    pub fn stops_within(&mut self, time: Duration) -> Result<bool> {
        match self.packet_within(time)? {
            None => Ok(false),
            Some(stop) if stop.starts_with("T05") && stop.contains("watch:") => Ok(true),
            Some(stop) => bail!("the machine stopped for another reason than a watchpoint: `{stop}`"),
        }
    }

    /// Stops a running machine.
    ///
    /// # Errors
    /// Fails when it does not stop, or when QEMU ends.
    pub fn interrupt(&mut self) -> Result<()> {
        self.line.write_all(&[0x03]).context("QEMU has closed its GDB stub")?;
        let stop = self.answer()?;
        ensure!(stop.starts_with('T'), "the machine did not stop: `{stop}`");
        Ok(())
    }

    /// Resets a stopped machine; it restarts when resumed.
    ///
    /// # Errors
    /// Fails when QEMU rejects the command.
    pub fn reset_machine(&mut self) -> Result<()> {
        let command: String = b"system_reset".iter().map(|byte| format!("{byte:02x}")).collect();
        self.command(&format!("qRcmd,{command}"))
    }

    fn command(&mut self, packet: &str) -> Result<()> {
        self.send(&[packet])?;
        self.expect_ok(packet)
    }

    fn expect_ok(&mut self, packet: &str) -> Result<()> {
        let answer = self.answer()?;
        ensure!(answer == "OK", "QEMU's GDB stub rejects `{packet}`: `{answer}`");
        Ok(())
    }

    fn reported_core_registers(&mut self) -> Result<CoreRegisters> {
        let bytes = self.reported_bytes()?;
        let words = bytes.as_chunks::<4>().0;
        ensure!(words.len() >= CORE_REGISTERS, "QEMU's GDB stub returned {} registers", words.len());
        let mut r = [0; 16];
        for (register, word) in r.iter_mut().zip(words) {
            *register = u32::from_le_bytes(*word);
        }
        Ok(CoreRegisters { r, xpsr: u32::from_le_bytes(words[CORE_REGISTERS - 1]) })
    }

    fn reported_memory(&mut self, address: u32, len: usize) -> Result<Vec<u8>> {
        let bytes = self.reported_bytes().with_context(|| format!("memory at {address:#010X}"))?;
        ensure!(
            bytes.len() == len,
            "QEMU's GDB stub returned {} bytes of {len} at {address:#010X}",
            bytes.len()
        );
        Ok(bytes)
    }

    fn reported_bytes(&mut self) -> Result<Vec<u8>> {
        let digits = self.answer()?;
        from_hex(&digits)
            .with_context(|| format!("QEMU's GDB stub returned `{digits}`, which is not hexadecimal"))
    }

    /// Prefixes each packet with the acknowledgement of the previous one.
    fn send(&mut self, packets: &[&str]) -> Result<()> {
        let mut text = String::new();
        for packet in packets {
            let sum = packet.bytes().fold(0u8, u8::wrapping_add);
            text.push_str(&format!("+${packet}#{sum:02x}"));
        }
        self.line.write_all(text.as_bytes()).context("QEMU has closed its GDB stub")
    }

    fn answer(&mut self) -> Result<String> {
        self.packet_within(self.patience)?.context("QEMU's GDB stub does not answer")
    }

    fn packet_within(&mut self, time: Duration) -> Result<Option<String>> {
        let mut chunk = [0; 1024];
        loop {
            if let Some(packet) = self.packets.pop_front() {
                return Ok(Some(packet));
            }
            if !uninterrupted::is_readable_within(&self.line, time)? {
                return Ok(None);
            }
            match uninterrupted::read(&self.line, &mut chunk)? {
                0 => bail!("QEMU has closed its GDB stub"),
                count => self.received.extend_from_slice(&chunk[..count]),
            }
            self.take_packets()?;
        }
    }

    /// Skips acknowledgements between packets.
    fn take_packets(&mut self) -> Result<()> {
        while let Some(start) = self.received.iter().position(|&byte| byte == b'$') {
            let Some(len) = self.received[start..].iter().position(|&byte| byte == b'#') else { break };
            let end = start + len;
            let Some(digits) = self.received.get(end + 1..end + 3) else { break };
            let text = String::from_utf8(self.received[start + 1..end].to_vec())?;
            let sum = u8::from_str_radix(str::from_utf8(digits)?, 16)?;
            ensure!(
                sum == text.bytes().fold(0, u8::wrapping_add),
                "QEMU's GDB stub sent a wrong checksum: `{text}`"
            );
            self.received.drain(..end + 3);
            self.packets.push_back(text);
        }
        Ok(())
    }
}

/// Returns the bytes that these pairs of hexadecimal digits stand for.
pub(crate) fn from_hex(digits: &str) -> Option<Vec<u8>> {
    let pairs = digits.as_bytes().chunks(2);
    pairs.map(|pair| u8::from_str_radix(str::from_utf8(pair).ok()?, 16).ok()).collect()
}
