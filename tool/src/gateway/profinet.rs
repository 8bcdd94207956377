//! The PROFINET device of a gateway. Its controller is a master of the bridge's image.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fmt::Arguments;
use std::fs;
use std::io::ErrorKind;
use std::net::Ipv4Addr;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Sender, channel};
use std::thread;

use anyhow::{Context, Result, anyhow};
use bus_profinet::Stored;
use fieldbus_host::profinet::{Interface, Owner, ProfinetLine};
use wsg_bridge_fw::plc::TcpInput;
use wsg_fieldbus::{InputImage, OutputImage};

use super::bridge::{Gateway, report};
use crate::file_flash::replace;

/// Serial number in the device's records. The gripper's own is unknown before it answers.
const SERIAL_NUMBER: u32 = 0;

/// An open network interface, with the data of its station.
pub(super) struct Profinet {
    interface: Interface,
    line: ProfinetLine,
}

impl Profinet {
    /// Opens the interface. The data in the line's file, if there is one, replaces its initial data.
    pub(super) fn open(mut line: ProfinetLine) -> Result<Self> {
        if let Some(file) = &line.keep {
            line.stored = stored(file)?.unwrap_or(line.stored);
        }
        Ok(Self { interface: Interface::open(&line.interface)?, line })
    }

    /// Serves the device.
    pub(super) async fn serve(self, gateway: Rc<Gateway>) {
        let Self { interface, line: ProfinetLine { interface: name, stored, keep } } = self;
        let (number, pauses) = (gateway.number(), Cell::new(gateway.pauses()));
        let bridge = Bridge { gateway, number, pauses, name, writer: keep.map(writer) };
        if let Err(error) = interface.serve(stored, SERIAL_NUMBER, bridge).await {
            report(format_args!("PROFINET has ended: {error:#}"));
        }
    }
}

/// Returns the data in a file, or `None` without one.
fn stored(file: &Path) -> Result<Option<Stored>> {
    let text = match fs::read(file) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        text => text.with_context(|| format!("cannot read {}", file.display()))?,
    };
    let expected = || format!("{} is no file with the data of a PROFINET station", file.display());
    let kept: BTreeMap<String, String> = serde_json::from_slice(&text).with_context(expected)?;
    let stored = ProfinetLine::stored_of(|key| kept.get(key).map(String::as_str));
    stored.map(Some).map_err(|key| anyhow!("{key} is invalid")).with_context(expected)
}

/// Starts a thread that writes each content to a file: a slow disk must not hold the bridges.
fn writer(file: PathBuf) -> Sender<Vec<u8>> {
    let (sender, contents) = channel::<Vec<u8>>();
    thread::spawn(move || {
        for content in contents {
            if let Err(error) = replace(&file, &content) {
                report(format_args!("{} cannot be written: {error}", file.display()));
            }
        }
    });
    sender
}

/// The bridge as the owner of the image.
struct Bridge {
    gateway: Rc<Gateway>,
    /// Number of the controller among the masters.
    number: u64,
    /// Number of pauses that the device has handled.
    pauses: Cell<u32>,
    /// Name of the network interface.
    name: String,
    writer: Option<Sender<Vec<u8>>>,
}

impl Owner for Bridge {
    fn inputs(&self) -> Option<InputImage> {
        self.gateway.inputs()
    }

    fn take_outputs(&self, outputs: &OutputImage, before: Option<&OutputImage>) {
        let (master, image, before) = (self.number, *outputs, before.copied());
        self.gateway.turn(TcpInput::Image { master, image, before });
        if self.gateway.is_plc(master) {
            self.gateway.note_cycle(Ipv4Addr::UNSPECIFIED.into());
        }
    }

    fn end_outputs(&self) {
        self.gateway.turn(TcpInput::Left { master: self.number });
    }

    fn store(&self, stored: &Stored) {
        if let (Some(writer), Ok(kept)) =
            (&self.writer, serde_json::to_vec_pretty(&BTreeMap::from(ProfinetLine::kept(stored))))
        {
            // The thread ends only with the sender.
            let _ = writer.send(kept);
        }
    }

    fn note(&self, what: Arguments<'_>) {
        report(format_args!("profinet {}: {what}", self.name));
    }

    fn has_paused(&self) -> bool {
        let pauses = self.gateway.pauses();
        self.pauses.replace(pauses) != pauses
    }
}
