//! EtherNet/IP: the gripper as the owner of the image that an adapter serves.

use super::hub::{BusLine, ClientHandle, Hub};
use super::open_line::{Listen, OpenLine, Place};
use crate::port::PortKind;
use anyhow::{Context, Result};
use fieldbus_host::Owner;
use fieldbus_host::ethernetip::{Adapter, EthernetIpLine, Status};
use std::fmt::Arguments;
use std::net::{SocketAddr, SocketAddrV4};
use std::sync::Arc;
use wsg_fieldbus::{InputImage, OutputImage};

/// Opens the line; `None` without an address.
pub(super) async fn open(listen: Listen<'_>, line: Option<EthernetIpLine>) -> Result<Option<OpenLine>> {
    let (Some(SocketAddr::V4(address)), Some(line)) = (listen.address(), line) else { return Ok(None) };
    let adapter = Adapter::open(EthernetIpLine { address, ..line }).await?;
    let address = adapter.address();
    let bus = BusLine {
        bus: "EtherNet/IP",
        line: address.to_string(),
        address: address.ip().to_string(),
        ..BusLine::default()
    };
    let line =
        OpenLine::new(listen.name, Place::Address(address.into()), move |hub| serve(hub, adapter, address));
    Ok(Some(line.on_bus(bus)))
}

async fn serve(hub: Arc<Hub>, adapter: Adapter, address: SocketAddrV4) -> Result<()> {
    let client = hub
        .connect(PortKind::EthernetIp, &address.to_string())
        .context("all client places are taken; none is left for EtherNet/IP")?;
    adapter.serve(hub.config().serial_number, Gripper { hub, client, address }).await;
    Ok(())
}

/// The gripper as the owner of the image.
struct Gripper {
    hub: Arc<Hub>,
    client: ClientHandle,
    address: SocketAddrV4,
}

impl Owner for Gripper {
    fn inputs(&self) -> Option<InputImage> {
        Some(self.hub.look(|gripper| gripper.fieldbus_images().1))
    }

    fn take_outputs(&self, outputs: &OutputImage, before: Option<&OutputImage>) {
        self.client.write_image(outputs, before.is_none());
    }

    fn end_outputs(&self) {
        self.client.end_images();
    }

    fn note(&self, what: Arguments<'_>) {
        self.hub.note_of(&format!("ethernetip {}", self.address), what);
    }

    fn register(&self, function: u16, address: u16) -> Result<u16, Status> {
        let (output, input) = self.hub.look(|gripper| gripper.fieldbus_images());
        let bytes: &[u8] = match function {
            3 => &output.to_bytes(),
            4 => &input.to_bytes(),
            _ => return Err(Status::NoInstance),
        };
        let register = bytes.as_chunks().0.get(usize::from(address));
        register.map(|register| u16::from_be_bytes(*register)).ok_or(Status::AttributeUnsupported)
    }
}
