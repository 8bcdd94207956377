//! The virtual gripper, served on sockets and in virtual time.

use std::ffi::OsString;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::{Arc, Mutex, PoisonError};
use std::{io, mem};

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use wsg_sim::server::Options;
use wsg_sim::server::{ServerThread, UdpLine};
use wsg_sim::{Fault, Jaw, Part, PortKind, State, VirtualRig};

use crate::driver::{self, Driver};
use crate::error;
use crate::interpreter::{detach, process};
use crate::line::{Clock, VirtualWire};
use crate::number::shortest;

/// Parses options of `wsg-sim`.
fn options(py: Python<'_>, words: Vec<OsString>) -> PyResult<Options> {
    Options::parse(words).map_err(|error| error::exception(py, "InvalidError", &format!("{error:#}"), None))
}

/// Returns a part of this width, stiffness and inner width; none without a width.
fn part(py: Python<'_>, width: Option<f32>, stiffness: f32, inner: Option<f32>) -> PyResult<Option<Part>> {
    let invalid = |text: &str| error::exception(py, "InvalidError", text, None);
    let Some(width) = width else {
        return match inner {
            Some(inner) => Err(invalid(&format!("an inner width of {inner} mm without a part"))),
            None => Ok(None),
        };
    };
    let solid = Part::new(width, stiffness).ok_or_else(|| {
        invalid(&format!("a part of {width} mm and {stiffness} N/mm: expected finite numbers above 0"))
    })?;
    let Some(inner) = inner else { return Ok(Some(solid)) };
    let hollow = solid.with_inner_width(inner).ok_or_else(|| {
        let expected = format!("expected a number above 0 and below its width of {width} mm");
        invalid(&format!("a part with an inner width of {inner} mm: {expected}"))
    })?;
    Ok(Some(hollow))
}

/// Returns the fault of this name. The Python enumeration `Fault` has the same names.
fn fault(py: Python<'_>, name: &str) -> PyResult<Fault> {
    Ok(match name {
        "AXIS_BLOCKED" => Fault::AxisBlocked,
        "OVER_TEMPERATURE" => Fault::OverTemperature,
        "SUPPLY_OUT_OF_RANGE" => Fault::SupplyOutOfRange,
        "MOTOR_CURRENT" => Fault::MotorCurrent,
        "FINGER1_SHORT_CIRCUIT" => Fault::FingerShortCircuit(Jaw::One),
        "FINGER2_SHORT_CIRCUIT" => Fault::FingerShortCircuit(Jaw::Two),
        "FINGER1_COMMUNICATION" => Fault::FingerCommunication(Jaw::One),
        "FINGER2_COMMUNICATION" => Fault::FingerCommunication(Jaw::Two),
        _ => return Err(error::exception(py, "InvalidError", &format!("unknown fault `{name}`"), None)),
    })
}

/// Width, speed, force, force limit, gripper state, system flags, temperature, width and presence of the part.
type Seen = (f64, f64, f64, f64, u8, u32, f64, Option<f64>, bool);

fn seen(state: State) -> Seen {
    let State {
        width, speed, force, force_limit, gripper, flags, temperature, part, part_is_between, ..
    } = state;
    let [width, speed, force, force_limit] = [width, speed, force, force_limit].map(shortest);
    let temperature = f64::from(temperature.0) / 10.0;
    let part = part.map(|part| shortest(part.width()));
    (width, speed, force, force_limit, gripper.code(), flags.bits(), temperature, part, part_is_between)
}

/// A virtual gripper and its line, in virtual time.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Rig {
    rig: VirtualRig,
    is_gcl: bool,
    is_connected: Arc<AtomicBool>,
}

#[pymethods]
impl Rig {
    #[new]
    fn new(py: Python<'_>, line: &str, words: Vec<OsString>) -> PyResult<Self> {
        let kind = match line {
            "serial" => PortKind::Serial,
            "tcp" => PortKind::Tcp,
            "gcl" => PortKind::GclTcp,
            _ => {
                let text = format!("unknown line `{line}`; expected serial, tcp or gcl");
                return Err(error::exception(py, "InvalidError", &text, None));
            }
        };
        let Options { config, .. } = options(py, words)?;
        Ok(Self {
            rig: VirtualRig::with_port(kind, config),
            is_gcl: kind == PortKind::GclTcp,
            is_connected: Arc::default(),
        })
    }

    fn connect(&self, py: Python<'_>) -> PyResult<Driver> {
        let Self { rig, is_connected, .. } = self;
        if is_connected.swap(true, SeqCst) {
            let text = "the virtual gripper has a connection: close it first";
            return Err(error::exception(py, "BusyError", text, None));
        }
        let wire = VirtualWire(rig.clone(), Arc::clone(is_connected));
        rig.restore_line();
        let clock = Clock::Virtual(rig.clone());
        detach(py, || driver::connect(Box::new(wire), clock, self.is_gcl, None, "virtual gripper"))
            .map_err(|failed| failed.into_exception(py))
    }

    /// Returns the virtual time in seconds.
    fn time(&self) -> f64 {
        self.rig.time().as_micros() as f64 / 1e6
    }

    /// Advances time by milliseconds.
    fn pass_ms(&self, ms: u32) {
        self.rig.pass(ms);
    }

    fn state(&self) -> Seen {
        seen(self.rig.state())
    }

    fn set_part(
        &self,
        py: Python<'_>,
        width: Option<f32>,
        stiffness: f32,
        inner_width: Option<f32>,
    ) -> PyResult<()> {
        self.rig.set_part(part(py, width, stiffness, inner_width)?);
        Ok(())
    }

    fn set_fault(&self, py: Python<'_>, name: &str, on: bool) -> PyResult<()> {
        self.rig.set_fault(fault(py, name)?, on);
        Ok(())
    }

    fn restart(&self) {
        self.rig.restart();
    }

    fn cut_line(&self) {
        self.rig.cut_line();
    }

    fn close_line(&self) {
        self.rig.close_line();
    }

    fn restore_line(&self) {
        self.rig.restore_line();
    }

    fn inject(&self, data: &[u8]) {
        self.rig.inject(data);
    }
}

/// A virtual gripper on sockets, served by a thread.
#[pyclass(frozen, module = "wsg_gripper._native")]
pub(crate) struct Server {
    server: Mutex<Option<ServerThread>>,
    udp_answers: u16,
    /// The process that started the thread. A forked child does not have it.
    process: usize,
}

const ANY_PORT: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// Returns a UDP port that is free now.
fn free_udp_port() -> io::Result<u16> {
    Ok(UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?.local_addr()?.port())
}

#[pymethods]
impl Server {
    /// Serves every line on the loopback interface, at free ports unless the options name others.
    #[new]
    fn new(py: Python<'_>, words: Vec<OsString>) -> PyResult<Self> {
        let Options { config, mut lines, is_default_line, .. } = options(py, words)?;
        if is_default_line {
            lines.tcp = None;
        }
        for address in
            [&mut lines.tcp, &mut lines.gcl, &mut lines.gcl_udp, &mut lines.modbus, &mut lines.control]
        {
            address.get_or_insert(ANY_PORT);
        }
        let udp = match lines.udp {
            Some(udp) => udp,
            None => UdpLine { address: ANY_PORT, remote_port: free_udp_port()? },
        };
        lines.udp = Some(udp);
        let server = detach(py, || ServerThread::start(config, &lines, None))
            .map_err(|error| PyOSError::new_err(format!("{error:#}")))?;
        let server = Mutex::new(Some(server));
        Ok(Self { server, udp_answers: udp.remote_port, process: process() })
    }

    /// Returns the addresses by line: TCP, UDP, GCL, GCL over UDP, Modbus and the page; and the port of answers over UDP.
    fn addresses(&self, py: Python<'_>) -> PyResult<(Vec<Option<String>>, u16)> {
        self.with(py, |server| {
            let addresses = [
                server.tcp_address(),
                server.udp_address(),
                server.gcl_address(),
                server.gcl_udp_address(),
                server.modbus_address(),
                server.control_address(),
            ];
            (addresses.map(|it| it.map(|it| it.to_string())).to_vec(), self.udp_answers)
        })
    }

    fn state(&self, py: Python<'_>) -> PyResult<Seen> {
        self.with(py, |server| seen(server.state()))
    }

    fn set_part(
        &self,
        py: Python<'_>,
        width: Option<f32>,
        stiffness: f32,
        inner_width: Option<f32>,
    ) -> PyResult<()> {
        let part = part(py, width, stiffness, inner_width)?;
        self.with(py, |server| server.set_part(part))
    }

    fn set_fault(&self, py: Python<'_>, name: &str, on: bool) -> PyResult<()> {
        let fault = fault(py, name)?;
        self.with(py, |server| server.set_fault(fault, on))
    }

    /// Powers the gripper off and closes its lines.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        if self.process != process() {
            return Ok(());
        }
        let server = self.server.lock().unwrap_or_else(PoisonError::into_inner).take();
        detach(py, || server.map_or(Ok(()), ServerThread::stop))
            .map_err(|error| PyOSError::new_err(format!("{error:#}")))
    }
}

impl Server {
    fn with<T: Send>(&self, py: Python<'_>, act: impl FnOnce(&ServerThread) -> T + Send) -> PyResult<T> {
        let closed = || error::not_connected(py, "the simulator is closed, or another process started it");
        if self.process != process() {
            return Err(closed());
        }
        let acted = detach(py, || {
            let server = self.server.lock().unwrap_or_else(PoisonError::into_inner);
            server.as_ref().map(act)
        });
        acted.ok_or_else(closed)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if self.process != process() {
            // Its thread exists in the parent only, so it cannot be joined.
            mem::forget(self.server.get_mut().unwrap_or_else(PoisonError::into_inner).take());
        }
    }
}
