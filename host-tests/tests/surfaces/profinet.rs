//! The register interface on PROFINET: a third-party controller that exchanges images with the gripper in cycles.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::{Arc, Mutex};

use anyhow::{Error, Result};
use bus_profinet::Stored;
use host_tests::gateway::Gateway;
use host_tests::masters::PYTHON_VARIABLE;
use host_tests::namespaces::{End, Network, at_controller, prioritize, prioritize_grippers};
use wsg_fieldbus::{InputImage, OutputImage};
use wsg_sim::Config;
use wsg_sim::server::{Lines, ProfinetLine, ServerThread};

use crate::fieldbus::{Registers, master};
use crate::process::{Masters, Program};
use crate::station::{self, BOUND, Line, Station, Way};
use crate::surface::Surface;

/// A station with a network of its own.
pub(crate) fn station() -> Station {
    let network = Network::new();
    let line = ProfinetLine { interface: "eth0".to_owned(), stored: Stored::NONE, keep: None };
    let lines = Lines { profinet: Some(line), ..station::lines() };
    let gripper = network.at(End::Gripper, || ServerThread::start(Config::default(), &lines, None));
    prioritize_grippers();
    // The number of the network takes the place of a port.
    let address = (Ipv4Addr::UNSPECIFIED, network.number()).into();
    let line = Line::on_ethernet(address, move |way, discards| {
        network.discard(if way == Way::Requests { End::Controller } else { End::Gripper }, discards);
    });
    Station::of(gripper.expect("the server starts"), Some(line))
}

/// The controller `profinet-py`, which exchanges images in cycles of 8 ms.
#[derive(Clone)]
struct Profinet(Arc<Mutex<Program>>);

/// Starts a controller in the network whose number is the port of `address`.
pub(crate) fn profinet(address: SocketAddr) -> Box<dyn Surface> {
    let python = std::env::var(PYTHON_VARIABLE)
        .unwrap_or_else(|_| panic!("{PYTHON_VARIABLE} must name a Python; run `cargo xtask test`"));
    let mut controller = at_controller(address.port(), &python);
    controller.args(["-c", include_str!("../end_to_end/profinet/profinet_py.py"), "images"]);
    let controller = Profinet(Arc::new(Mutex::new(Program::start(&mut controller))));
    master(move || Ok(controller.clone()))
}

/// Starts `wsg gateway` in a network of its own, and commands it over PROFINET.
pub(crate) fn gateway(address: SocketAddr) -> Box<dyn Surface> {
    let network = Network::new();
    let gateway = Gateway::start(address, &["--profinet", &network.take_gripper_end()]);
    prioritize(&gateway.process.id().to_string());
    prioritize_grippers();
    let masters = profinet((Ipv4Addr::UNSPECIFIED, network.number()).into());
    Box::new(Masters(masters, (gateway, network)))
}

impl Profinet {
    fn ask(&self, request: &str) -> Result<InputImage> {
        let outcome = self.0.lock().expect("no panic").request(request);
        let digits = outcome.recv_timeout(BOUND)?.map_err(Error::msg)?;
        let number = u128::from_str_radix(&digits, 16)?.to_be_bytes();
        Ok(InputImage::from_bytes(number[4..].try_into()?))
    }
}

impl Registers for Profinet {
    fn write(&mut self, image: OutputImage) -> Result<()> {
        self.ask(&format!("write {:016x}", u64::from_be_bytes(image.to_bytes()))).map(drop)
    }

    fn read(&mut self) -> Result<InputImage> {
        self.ask("read")
    }
}
