//! The register interface on EtherNet/IP: a scanner that exchanges images with the gripper in cycles.

use std::net::{IpAddr, SocketAddr, SocketAddrV4};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use host_tests::ethernetip::{Scanner, discard, own_address};
use host_tests::gateway::Gateway;
use host_tests::modbus_tcp::LATE;
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_protocol::Status;
use wsg_sim::Config;
use wsg_sim::server::{EthernetIpLine, Lines, ServerThread};

use crate::fieldbus::{Registers, master};
use crate::process::Masters;
use crate::station::{self, Line, Station, Way};
use crate::surface::Surface;

/// Time-out of the scanner's user.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// A station with an address of its own.
pub(crate) fn station() -> Station {
    let ip = own_address();
    let address = SocketAddrV4::new(ip, 44_818);
    let line = EthernetIpLine { address, vendor: EthernetIpLine::VENDOR };
    let lines = Lines { ethernetip: Some(line), ..station::lines() };
    let gripper = ServerThread::start(Config::default(), &lines, None).expect("the server starts");
    let line = Line::on_ethernet(address.into(), move |way, discards| {
        discard(ip, usize::from(way == Way::Answers), discards);
    });
    Station::of(gripper, Some(line))
}

#[derive(Clone)]
struct Owner(Arc<Scanner>);

/// Starts a scanner of the adapter at an address.
pub(crate) fn ethernetip(address: SocketAddr) -> Box<dyn Surface> {
    let IpAddr::V4(ip) = address.ip() else { panic!("{address} is no adapter") };
    let owner = Owner(Arc::new(Scanner::start(ip, OutputImage::ZERO)));
    master(move || Ok(owner.clone()))
}

/// Starts `wsg gateway`, and commands it over EtherNet/IP.
pub(crate) fn gateway(address: SocketAddr) -> Box<dyn Surface> {
    let ip = own_address();
    let gateway = Gateway::start(address, &["--ethernetip", &ip.to_string()]);
    Masters(ethernetip((ip, 44_818).into()), gateway).connected()
}

impl Registers for Owner {
    fn write(&mut self, image: OutputImage) -> Result<()> {
        ensure!(self.0.write(image, ANSWER_TIME), LATE);
        Ok(())
    }

    fn read(&mut self) -> Result<InputImage> {
        let inputs = self.0.read(ANSWER_TIME).context(LATE)?;
        if inputs.status == Status::IoError {
            bail!("the gripper is not connected");
        }
        Ok(inputs)
    }
}
