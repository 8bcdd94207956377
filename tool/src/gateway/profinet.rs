//! The PROFINET device and the EtherNet/IP adapter of a gateway. Their controllers are masters of the bridge's image.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fmt::Arguments;
use std::fs;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::mpsc::{Sender, channel};
use std::thread;

use anyhow::{Context, Result, anyhow};
use bus_modbus::{Exception, MAX_PDU_LEN};
use bus_profinet::Stored;
use fieldbus_host::Owner;
use fieldbus_host::ethernetip::{Adapter, Status};
use fieldbus_host::profinet::{Interface, ProfinetLine};
use wsg_bridge_fw::plc::TcpInput;
use wsg_fieldbus::{InputImage, OutputImage};

use super::bridge::{Gateway, READER, report};
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
        let bridge = Bridge::new(gateway, format!("profinet {name}"), keep.map(writer));
        if let Err(error) = interface.serve(stored, SERIAL_NUMBER, bridge).await {
            report(format_args!("PROFINET has ended: {error:#}"));
        }
    }
}

/// Serves an EtherNet/IP adapter. Its address, unique in the network, is its serial number.
pub(super) async fn serve_adapter(adapter: Adapter, gateway: Rc<Gateway>) {
    let address = adapter.address();
    let bridge = Bridge::new(gateway, format!("ethernetip {address}"), None);
    adapter.serve(address.ip().to_bits(), bridge).await;
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
    /// Address of the controller, unspecified on PROFINET.
    address: Cell<IpAddr>,
    /// Number of pauses that the device has handled.
    pauses: Cell<u32>,
    /// Begins each message.
    label: String,
    /// Stores the data of the PROFINET station.
    writer: Option<Sender<Vec<u8>>>,
}

impl Bridge {
    fn new(gateway: Rc<Gateway>, label: String, writer: Option<Sender<Vec<u8>>>) -> Self {
        let (number, pauses) = (gateway.number(), Cell::new(gateway.pauses()));
        Self { gateway, number, address: Cell::new(Ipv4Addr::UNSPECIFIED.into()), pauses, label, writer }
    }
}

impl Owner for Bridge {
    fn inputs(&self) -> Option<InputImage> {
        self.gateway.inputs()
    }

    fn take_outputs(&self, outputs: &OutputImage, before: Option<&OutputImage>) {
        let (master, image, before) = (self.number, *outputs, before.copied());
        self.gateway.turn(TcpInput::Image { master, image, before });
        if self.gateway.is_writer(master) {
            self.gateway.note_cycle(self.address.get());
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
        report(format_args!("{}: {what}", self.label));
    }

    fn has_paused(&self) -> bool {
        let pauses = self.gateway.pauses();
        self.pauses.replace(pauses) != pauses
    }

    fn note_controller(&self, address: IpAddr) {
        self.address.set(address);
    }

    fn register(&self, function: u16, address: u16) -> Result<u16, Status> {
        let function =
            u8::try_from(function).ok().filter(|it| [3, 4].contains(it)).ok_or(Status::NoInstance)?;
        let ([high, low], mut response) = (address.to_be_bytes(), [0; MAX_PDU_LEN]);
        let len =
            self.gateway.serve((READER, self.address.get()), &[function, high, low, 0, 1], &mut response);
        match response.get(..len) {
            Some([code, 2, high, low]) if *code == function => Ok(u16::from_be_bytes([*high, *low])),
            Some([_, code]) if *code == Exception::IllegalDataAddress.code() => {
                Err(Status::AttributeUnsupported)
            }
            // The gripper does not answer.
            _ => Err(Status::StateConflict),
        }
    }
}
