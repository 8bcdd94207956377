//! The client's side of the gdb remote protocol, as QEMU's stub speaks it: watchpoints, core registers, memory.
//!
//! Here is only what this project asks for. QEMU runs one packet after the other, so several may be on their way. (Of the
//! crates, the well-kept ones are the stub's side; a client would be these few lines with a debugger's interface on top.)

use std::collections::VecDeque;
use std::io::Write;
use std::os::unix::net::UnixStream;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

/// R0 to R15 and xPSR.
const CORE_REGISTERS: usize = 17;

/// Registers of the core, while it stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoreRegisters {
    /// R0 to R15, the program counter.
    pub r: [u32; 16],
    /// xPSR; the part that numbers an exception cannot be written.
    pub xpsr: u32,
}

/// A connection to a machine that was started with `-gdb`, and stands.
#[derive(Debug)]
pub struct Gdb {
    line: UnixStream,
    patience: Duration,
    received: Vec<u8>,
    packets: VecDeque<String>,
}

impl Gdb {
    /// Speaks over `line`; an answer that takes longer than `patience` is an error.
    ///
    /// # Errors
    /// When `patience` is zero.
    pub fn new(line: UnixStream, patience: Duration) -> Result<Self> {
        line.set_write_timeout(Some(patience))?;
        Ok(Self { line, patience, received: Vec::new(), packets: VecDeque::new() })
    }

    /// Stops the machine before each load and store in these addresses. QEMU takes any length.
    ///
    /// # Errors
    /// When QEMU refuses or does not answer.
    pub fn watch(&mut self, first: u32, len: u32) -> Result<()> {
        self.command(&format!("Z4,{first:x},{len:x}"))
    }

    /// Reads the core's registers.
    ///
    /// # Errors
    /// When QEMU does not answer with them.
    pub fn core_registers(&mut self) -> Result<CoreRegisters> {
        self.send(&["g"])?;
        self.core_registers_told()
    }

    /// Reads the core's registers, and memory in pieces of an address and a length; all of one moment, for one answer's
    /// time.
    ///
    /// # Errors
    /// When QEMU does not answer with them.
    pub fn look<const N: usize>(
        &mut self,
        places: [(u32, usize); N],
    ) -> Result<(CoreRegisters, [Vec<u8>; N])> {
        let questions = places.map(|(address, len)| format!("m{address:x},{len:x}"));
        let mut packets = vec!["g"];
        packets.extend(questions.iter().map(String::as_str));
        self.send(&packets)?;
        let registers = self.core_registers_told()?;
        let mut pieces = [const { Vec::new() }; N];
        for (piece, (address, len)) in pieces.iter_mut().zip(places) {
            *piece = self.memory_told(address, len)?;
        }
        Ok((registers, pieces))
    }

    /// Reads memory; of a peripheral's the side effects happen.
    ///
    /// # Errors
    /// When there is none, or QEMU does not answer.
    pub fn read_memory(&mut self, address: u32, len: usize) -> Result<Vec<u8>> {
        self.send(&[&format!("m{address:x},{len:x}")])?;
        self.memory_told(address, len)
    }

    /// Lets the machine run.
    ///
    /// # Errors
    /// When QEMU has ended.
    pub fn run(&mut self) -> Result<()> {
        self.send(&["c"])
    }

    /// Lets the machine run, from these registers on.
    ///
    /// # Errors
    /// When QEMU refuses them, or has ended.
    pub fn run_from(&mut self, registers: &CoreRegisters) -> Result<()> {
        let words = registers.r.iter().chain([&registers.xpsr]);
        let digits: String = words.map(|word| format!("{:08x}", word.swap_bytes())).collect();
        self.send(&[&format!("G{digits}"), "c"])?;
        self.expect_ok("G")
    }

    /// Waits until the machine stops before an access to what is watched; `false`: it is still running.
    ///
    /// # Errors
    /// When it stops for another reason, or QEMU ends.
    pub fn stops_within(&mut self, time: Duration) -> Result<bool> {
        match self.packet_within(time)? {
            None => Ok(false),
            Some(stop) if stop.starts_with("T05") && stop.contains("watch:") => Ok(true),
            Some(stop) => bail!("the machine stopped for another reason than a watchpoint: `{stop}`"),
        }
    }

    /// Stops a machine that runs.
    ///
    /// # Errors
    /// When it does not stop, or QEMU ends.
    pub fn interrupt(&mut self) -> Result<()> {
        self.line.write_all(&[0x03]).context("QEMU's gdb stub is gone")?;
        let stop = self.answer()?;
        ensure!(stop.starts_with('T'), "the machine does not stop: `{stop}`");
        Ok(())
    }

    /// Resets a machine that stands; it begins anew when it is let run.
    ///
    /// # Errors
    /// When QEMU refuses.
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
        ensure!(answer == "OK", "QEMU's gdb stub refuses `{packet}`: `{answer}`");
        Ok(())
    }

    fn core_registers_told(&mut self) -> Result<CoreRegisters> {
        let bytes = from_hex(&self.answer()?)?;
        let words = bytes.as_chunks::<4>().0;
        ensure!(words.len() >= CORE_REGISTERS, "QEMU's gdb stub tells {} registers", words.len());
        let mut r = [0; 16];
        for (register, word) in r.iter_mut().zip(words) {
            *register = u32::from_le_bytes(*word);
        }
        Ok(CoreRegisters { r, xpsr: u32::from_le_bytes(words[CORE_REGISTERS - 1]) })
    }

    fn memory_told(&mut self, address: u32, len: usize) -> Result<Vec<u8>> {
        let bytes = from_hex(&self.answer()?).with_context(|| format!("memory at {address:#010X}"))?;
        ensure!(
            bytes.len() == len,
            "QEMU's gdb stub tells {} bytes of {len} at {address:#010X}",
            bytes.len()
        );
        Ok(bytes)
    }

    /// Each packet takes the acknowledgement of the one before with it.
    fn send(&mut self, packets: &[&str]) -> Result<()> {
        let mut text = String::new();
        for packet in packets {
            let sum = packet.bytes().fold(0u8, u8::wrapping_add);
            text.push_str(&format!("+${packet}#{sum:02x}"));
        }
        self.line.write_all(text.as_bytes()).context("QEMU's gdb stub is gone")
    }

    fn answer(&mut self) -> Result<String> {
        self.packet_within(self.patience)?.context("QEMU's gdb stub does not answer")
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
                0 => bail!("QEMU has closed its gdb stub"),
                count => self.received.extend_from_slice(&chunk[..count]),
            }
            self.take_packets()?;
        }
    }

    /// Acknowledgements between packets are passed over.
    fn take_packets(&mut self) -> Result<()> {
        while let Some(start) = self.received.iter().position(|&byte| byte == b'$') {
            let Some(len) = self.received[start..].iter().position(|&byte| byte == b'#') else { break };
            let end = start + len;
            let Some(digits) = self.received.get(end + 1..end + 3) else { break };
            let text = String::from_utf8(self.received[start + 1..end].to_vec())?;
            let sum = u8::from_str_radix(str::from_utf8(digits)?, 16)?;
            ensure!(
                sum == text.bytes().fold(0, u8::wrapping_add),
                "QEMU's gdb stub sends a wrong checksum: `{text}`"
            );
            self.received.drain(..end + 3);
            self.packets.push_back(text);
        }
        Ok(())
    }
}

fn from_hex(digits: &str) -> Result<Vec<u8>> {
    let pairs = digits.as_bytes().chunks(2);
    let bytes: Option<_> =
        pairs.map(|pair| u8::from_str_radix(str::from_utf8(pair).ok()?, 16).ok()).collect();
    bytes.with_context(|| format!("QEMU's gdb stub answers `{digits}`, no bytes"))
}
