//! `wsg bridge PORT update FILE`: sends a signed image over the service port, and restarts the bridge with it.

use std::fs;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::Args;
use wsg_bridge_fw::registers::{MAP_VERSION, UpdateCommand, UpdateRefusal, update_crc};
use wsg_update::{Check, Keys, Manifest, PublicKey, Rules, SIGNATURE_LEN};

use super::client::{BLOCK_LEN, Client, Failure};
use super::names::report;
use super::{confirm, require_rest, sign};

/// Time for which a block is repeated: less than the pause that ends an update.
const REPEATS: Duration = Duration::from_secs(4);
/// Longest time of the check in the bridge.
const CHECK_TIME: Duration = Duration::from_secs(10);
/// Longest time of the restart, in which the boot loader exchanges the images.
const RESTART_TIME: Duration = Duration::from_secs(90);
/// Time between two requests for their end.
const POLL: Duration = Duration::from_millis(50);

/// Values of UPDATE_STATE.
const CHECKS: u16 = 2;
const RECEIVED: u16 = 3;
const RESTARTS: u16 = 5;

#[derive(Args, Debug)]
pub(crate) struct Arguments {
    /// Image of the board with its signature
    file: PathBuf,
    /// Public key (FILE.pub of `keygen`) for which the signature must be valid; without it, only the bridge checks the signature
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Update without asking for confirmation
    #[arg(long, short)]
    yes: bool,
}

pub(super) fn run(port: &str, arguments: &Arguments, output: &mut impl Write) -> Result<()> {
    let Arguments { file, key, yes } = arguments;
    let key = key.as_deref().map(sign::public_key).transpose()?;
    let bytes = fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    let image = image_of(&bytes, key).with_context(|| format!("{} is no valid image", file.display()))?;
    if port.starts_with("tcp://") {
        bail!("a gateway has no firmware; expected the service port of a board");
    }
    let mut client = Client::open(port)?;
    let state = State::read(&mut client)?;
    match state.board {
        0 => bail!(
            "the bridge has no boot loader for updates; write its image with `wsg bridge {port} flash` once"
        ),
        board if board != image.target.number() => {
            bail!("{} is for another board; expected an image with the number {board:08X}h", file.display())
        }
        _ => {}
    }
    let old = client.firmware()?;
    let held = client.image();
    require_rest(held.map_err(Into::into), "update")?;
    let start = state.common_start(&bytes);
    confirm(
        &format!(
            "The gripper will enter FAST STOP, and the bridge restart. Update firmware {old} to {} ({} bytes)",
            image.version,
            bytes.len()
        ),
        *yes,
    )?;
    if start > 0 {
        writeln!(output, "continues after {start} bytes of an interrupted update")?;
    }
    send(&mut client, &bytes, start)?;
    command(&mut client, UpdateCommand::Check)?;
    let checked =
        until(CHECK_TIME, || Ok(Some(State::read(&mut client)?).filter(|state| state.phase != CHECKS)))?;
    match checked {
        Some(State { phase: RECEIVED, .. }) => {}
        Some(State { refusal: Some(why), .. }) => {
            bail!("the bridge refused the image: {why}; it keeps firmware {old}")
        }
        _ => bail!("time-out: the bridge is still checking the image"),
    }
    command(&mut client, UpdateCommand::Restart)?;
    writeln!(output, "sent and checked; the bridge restarts")?;
    output.flush()?;
    drop(client);
    match until(RESTART_TIME, || Ok(restarted(port)))? {
        Some(version) if version == image.version.to_string() => {
            writeln!(output, "the bridge runs firmware {version}; STOP/ACK ends the FAST STOP")?;
            Ok(())
        }
        Some(version) => {
            bail!("the bridge runs firmware {version}: firmware {} did not start", image.version)
        }
        None => {
            bail!("time-out: the bridge does not respond after its restart; check its LED, then run `show`")
        }
    }
}

/// Returns the manifest of a file after checking it, and its signature with a key.
fn image_of(bytes: &[u8], key: Option<PublicKey>) -> Result<Manifest> {
    let parsed = bytes.split_last_chunk::<SIGNATURE_LEN>().and_then(|(image, _)| {
        let manifest = Manifest::decode(image.last_chunk()?)?;
        (manifest.length as usize == image.len()).then_some(manifest)
    });
    let manifest = parsed.context("no manifest and signature at its end")?;
    let Some(key) = key else { return Ok(manifest) };
    let Manifest { target, counter, .. } = manifest;
    let keys = Keys { first: key, second: key };
    Ok(Check::whole(&mut &*bytes, Rules { target, keys, counter })?)
}

/// Registers of an update.
struct State {
    phase: u16,
    refusal: Option<UpdateRefusal>,
    received: u32,
    crc: u32,
    board: u32,
}

impl State {
    fn read(client: &mut Client) -> Result<Self, Failure> {
        let reports = client.reports()?;
        let of = |name: &str| reports.get(report(name)).copied().unwrap_or_default();
        let long = |high: &str, low: &str| u32::from(of(high)) << 16 | u32::from(of(low));
        Ok(Self {
            phase: of("UPDATE_STATE"),
            refusal: UpdateRefusal::from_code(of("UPDATE_REFUSAL")),
            received: long("UPDATE_BYTES_HIGH", "UPDATE_BYTES_LOW"),
            crc: long("UPDATE_CRC_HIGH", "UPDATE_CRC_LOW"),
            board: long("UPDATE_BOARD_HIGH", "UPDATE_BOARD_LOW"),
        })
    }

    /// Returns the length of the start of this file that the bridge has, from an interrupted update.
    fn common_start(&self, bytes: &[u8]) -> usize {
        let received = self.received as usize;
        let is_same = bytes.get(..received).is_some_and(|start| update_crc(0, start) == self.crc);
        if self.phase < CHECKS && is_same && received.is_multiple_of(2) { received } else { 0 }
    }
}

/// Sends the blocks from `start` on, with a progress bar on a terminal.
fn send(client: &mut Client, bytes: &[u8], start: usize) -> Result<()> {
    let on_terminal = io::stderr().is_terminal();
    for (number, block) in bytes.get(start..).unwrap_or_default().chunks(BLOCK_LEN).enumerate() {
        let at = start + number * BLOCK_LEN;
        if on_terminal {
            let percent = 100 * at / bytes.len();
            eprint!("\r[{:<50}] {percent} %", "#".repeat(percent / 2));
        }
        let begun = Instant::now();
        while let Err(failure) = client.write_block(at, block) {
            if let Failure::Refused(_) = failure {
                return Err(refused(client, failure));
            }
            if begun.elapsed() > REPEATS {
                bail!(
                    "interrupted after {at} of {} bytes: {failure}; run the same command to continue",
                    bytes.len()
                );
            }
            thread::sleep(POLL);
        }
    }
    if on_terminal {
        eprintln!("\r[{}] 100 %", "#".repeat(50));
    }
    Ok(())
}

fn command(client: &mut Client, command: UpdateCommand) -> Result<()> {
    client.command_update(command).map_err(|failure| refused(client, failure))
}

/// Returns the reason of a refusal.
fn refused(client: &mut Client, failure: Failure) -> anyhow::Error {
    match State::read(client) {
        Ok(State { refusal: Some(why), .. }) if matches!(failure, Failure::Refused(_)) => {
            anyhow::anyhow!("the bridge refused the update: {why}")
        }
        _ => failure.into(),
    }
}

/// Returns the version of a bridge that has restarted.
fn restarted(port: &str) -> Option<String> {
    let mut client = Client::open_any(port).ok()?;
    let [map, ..] = client.first_reports().ok()?[..] else { return None };
    if map == MAP_VERSION && State::read(&mut client).ok()?.phase == RESTARTS {
        return None;
    }
    client.firmware().ok()
}

/// Repeats this until it returns a value, or the time is over.
fn until<T>(time: Duration, mut next: impl FnMut() -> Result<Option<T>>) -> Result<Option<T>> {
    let begun = Instant::now();
    while begun.elapsed() < time {
        if let Some(value) = next()? {
            return Ok(Some(value));
        }
        thread::sleep(POLL);
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_without_a_manifest_at_its_end_is_no_image() {
        let manifest = Manifest {
            target: wsg_update::Target::of("pico"),
            version: wsg_update::Version([1, 2, 3]),
            length: 96,
            counter: 0,
            successor: None,
        };
        let file = [&[7; 32][..], &manifest.encode(), &[0; SIGNATURE_LEN]].concat();
        assert_eq!(image_of(&file, None).unwrap(), manifest);
        for wrong in [&file[1..], &file[..file.len() - 1], &[&file[..], &[0]].concat(), &[]] {
            assert!(image_of(wrong, None).is_err());
        }
        assert!(image_of(&file, Some([1; 32])).is_err(), "the signature");
    }
}
