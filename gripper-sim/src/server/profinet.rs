//! PROFINET: the gripper as the owner of the device on a network interface.

use super::hub::{BusLine, ClientHandle, Hub};
use super::open_line::{OpenLine, Place};
use super::options::{save, toml_value};
use crate::port::PortKind;
use anyhow::{Context, Result};
use bus_profinet::Stored;
use fieldbus_host::Owner;
use fieldbus_host::profinet::{Interface, ProfinetLine};
use std::fmt::Arguments;
use std::io;
use std::path::Path;
use std::sync::Arc;
use wsg_fieldbus::{InputImage, OutputImage};

/// Opens the line on a network interface.
pub(super) fn open(line: &ProfinetLine) -> Result<OpenLine> {
    let interface = Interface::open(&line.interface)?;
    let (place, bus) = (Place::Path((&line.interface).into()), bus_line(&line.interface, &line.stored));
    let line = line.clone();
    Ok(OpenLine::new("profinet", place, move |hub| serve(hub, interface, line)).on_bus(bus))
}

async fn serve(hub: Arc<Hub>, interface: Interface, line: ProfinetLine) -> Result<()> {
    let client = hub
        .connect(PortKind::Profinet, &line.interface)
        .context("all client places are taken; none is left for PROFINET")?;
    let (stored, serial_number) = (line.stored, hub.config().serial_number);
    interface.serve(stored, serial_number, Gripper { hub, client, line }).await
}

/// Returns the bit rate of an interface as Linux reports it, or nothing without a link.
fn interface_rate(interface: &str) -> String {
    let speed = std::fs::read_to_string(format!("/sys/class/net/{interface}/speed")).unwrap_or_default();
    // -1: no link.
    speed.trim().parse::<u32>().map(|mbit| format!("{mbit} Mbit/s")).unwrap_or_default()
}

fn bus_line(interface: &str, stored: &Stored) -> BusLine {
    let address = if stored.ip.is_set() { ProfinetLine::ip_text(&stored.ip) } else { String::new() };
    BusLine {
        bus: "PROFINET",
        line: interface.to_owned(),
        address,
        rate: interface_rate(interface),
        name: stored.name.as_str().to_owned(),
    }
}

/// The gripper as the owner of the image.
struct Gripper {
    hub: Arc<Hub>,
    client: ClientHandle,
    line: ProfinetLine,
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

    fn store(&self, stored: &Stored) {
        self.hub.set_bus(bus_line(&self.line.interface, stored));
        let words = |text: String| (!text.is_empty()).then(|| vec![text]);
        let kept = ProfinetLine::kept(stored);
        self.hub.remember(&kept.map(|(name, text)| (name.to_owned(), words(text))).into());
        if let Some(path) = &self.line.keep
            && let Err(error) = keep(path, stored)
        {
            self.note(format_args!("{} cannot be written: {error}", path.display()));
        }
    }

    fn note(&self, what: Arguments<'_>) {
        self.hub.note_of(&format!("profinet {}", self.line.interface), what);
    }
}

/// Saves name, address and I&M in the configuration file that they came from.
fn keep(path: &Path, stored: &Stored) -> io::Result<()> {
    let stored = ProfinetLine::kept(stored);
    let value = |text: &String| (!text.is_empty()).then(|| toml_value(std::slice::from_ref(text), false));
    save(path, &stored.each_ref().map(|(name, text)| (*name, value(text))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bus_profinet::{Maintenance, StationName};
    use std::fs;

    #[test]
    fn stored_values_replace_only_their_lines_in_the_file() {
        let path = std::env::temp_dir().join(format!("wsg-profinet-{}.toml", std::process::id()));
        let others = "# A cell\nmodel = \"wsg32\"\nprofinet = \"eth0\"\n";
        fs::write(
            &path,
            others.to_owned() + "station=\"old\"\nim-date = \"1999\"\nprofinet-ip = \"1.2.3.4/8\"\n",
        )
        .unwrap();
        let stored = Stored {
            name: StationName::new("new").unwrap(),
            ip: ProfinetLine::ip_of_text("10.0.0.5/8,10.0.0.1").unwrap(),
            maintenance: Maintenance {
                function: ProfinetLine::maintenance_of_text("+A \"1\" \\ gr\u{FC}n\u{1}").unwrap(),
                ..Maintenance::NONE
            },
        };
        keep(&path, &stored).unwrap();
        let kept = "station=\"new\"\nprofinet-ip = \"10.0.0.5/8,10.0.0.1\"\n\
                    im-function = \"+A \\\"1\\\" \\\\ gr\u{FC}n\\u0001\"\n";
        assert_eq!(fs::read_to_string(&path).unwrap(), others.to_owned() + kept);
        keep(&path, &Stored::NONE).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), others);
        fs::remove_file(&path).unwrap();
    }
}
