//! Client of QEMU's qtest protocol: sets pins and reads memory of a running machine.
//!
//! Commands are sequential, one line each way; QEMU's `system/qtest.c` describes the protocol. Covers only the
//! commands that this project needs.

use std::io::{BufRead, BufReader, Write};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

use crate::gdb::from_hex;
use crate::socket::Socket;

/// A connection to a QEMU that was started with `-qtest`.
#[derive(Debug)]
pub struct Qtest {
    connection: BufReader<Socket>,
}

impl Qtest {
    /// Connects over `connection`; an answer that takes longer than `patience` is an error.
    ///
    /// # Errors
    /// Fails when `patience` is zero.
    pub fn new(connection: Socket, patience: Duration) -> Result<Self> {
        connection.set_read_timeout(Some(patience))?;
        connection.set_write_timeout(Some(patience))?;
        Ok(Self { connection: BufReader::new(connection) })
    }

    /// Drives input `line` of the GPIO device at `qom_path` (`/machine/soc/gpioc`) high or low.
    ///
    /// # Errors
    /// Fails when QEMU has no such device or does not answer.
    pub fn set_gpio_in(&mut self, qom_path: &str, line: u8, high: bool) -> Result<()> {
        self.set_irq_in(qom_path, "unnamed-gpio-in", line, high)
    }

    /// Drives input `line` of the named inputs of the device at `qom_path` high or low.
    ///
    /// # Errors
    /// Fails when QEMU has no such device or does not answer.
    pub fn set_irq_in(&mut self, qom_path: &str, name: &str, line: u8, high: bool) -> Result<()> {
        self.command(&format!("set_irq_in {qom_path} {name} {line} {}", u8::from(high))).map(drop)
    }

    /// Reads the 32-bit word at `address` as the core would, including side effects.
    ///
    /// # Errors
    /// Fails when QEMU does not answer.
    pub fn readl(&mut self, address: u32) -> Result<u32> {
        let answer = self.command(&format!("readl {address:#x}"))?;
        let digits = answer.strip_prefix("0x").unwrap_or(&answer);
        u32::from_str_radix(digits, 16).with_context(|| format!("QEMU read the word `{answer}`"))
    }

    /// Writes the 32-bit word at `address` as the core would, including side effects.
    ///
    /// # Errors
    /// Fails when QEMU does not answer.
    pub fn writel(&mut self, address: u32, value: u32) -> Result<()> {
        self.command(&format!("writel {address:#x} {value:#x}")).map(drop)
    }

    /// Reads `len` bytes of memory starting at `address`.
    ///
    /// # Errors
    /// Fails when QEMU does not return `len` bytes.
    pub fn read(&mut self, address: u32, len: usize) -> Result<Vec<u8>> {
        if len == 0 {
            return Ok(Vec::new());
        }
        let answer = self.command(&format!("read {address:#x} {len:#x}"))?;
        let digits = answer.strip_prefix("0x").unwrap_or(&answer);
        let bytes = from_hex(digits).with_context(|| format!("QEMU read the bytes `{answer}`"))?;
        ensure!(bytes.len() == len, "QEMU read {} bytes instead of {len}", bytes.len());
        Ok(bytes)
    }

    /// Sends a command and returns the answer after `OK`.
    fn command(&mut self, command: &str) -> Result<String> {
        let no_answer = || format!("QEMU does not answer `{command}`");
        writeln!(self.connection.get_mut(), "{command}").with_context(no_answer)?;
        let mut line = String::new();
        loop {
            line.clear();
            let read = self.connection.read_line(&mut line).with_context(no_answer)?;
            ensure!(read > 0, "QEMU ended before it answered `{command}`");
            match line.trim_end().split_once(' ').unwrap_or((line.trim_end(), "")) {
                ("OK", answer) => return Ok(answer.to_owned()),
                ("FAIL" | "ERR", why) => bail!("QEMU rejects `{command}`: {why}"),
                // Unsolicited messages, such as an intercepted interrupt, may precede the answer.
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a client and its peer, which has already sent `answers`.
    fn client_hears(answers: &str) -> (Qtest, Socket) {
        let (ours, mut theirs) = crate::socket::pair().unwrap();
        theirs.write_all(answers.as_bytes()).unwrap();
        (Qtest::new(ours, Duration::from_millis(20)).unwrap(), theirs)
    }

    #[test]
    fn a_rejection_names_the_command_and_the_reason() {
        let (mut qtest, _peer) = client_hears("FAIL Unknown device\n");
        let refusal = qtest.set_gpio_in("/machine/gpioz", 0, true).unwrap_err().to_string();
        assert!(refusal.contains("/machine/gpioz") && refusal.ends_with("Unknown device"), "{refusal}");
    }
}
