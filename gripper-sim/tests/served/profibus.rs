//! The gripper as a PROFIBUS slave on a pseudo terminal, with the `profirust` master. Every wait is bounded.

use crate::control::request;
use crate::rig::{BOUND, QUICK, any_port, await_true, open_adapter, open_terminal, serve};
use profirust::dp::{DpMaster, Peripheral, PeripheralHandle, PeripheralOptions};
use profirust::fdl::{FdlActiveStation, ParametersBuilder};
use profirust::phy::ProfibusPhy;
use profirust::time::Instant;
use profirust::{Address, Baudrate};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde_json::Value;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::Instant as RealInstant;
use wsg_fieldbus::profibus::PROFILE;
use wsg_fieldbus::{CommandFlags as Flag, GripperFlags as Shown, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};
use wsg_sim::server::{Lines, SerialLine, ServerThread};
use wsg_sim::{Config, Part};

const STATION: Address = 7;

/// A terminal used as the master's line.
struct Terminal {
    line: File,
    received: Vec<u8>,
}

impl Terminal {
    /// Reads the available bytes, or waits for bytes for up to a millisecond.
    fn listen(&mut self) {
        let wait = Timespec { tv_sec: 0, tv_nsec: 1_000_000 };
        let mut fds = [PollFd::new(&self.line, PollFlags::IN)];
        // A signal ends the wait, which is then repeated.
        if poll(&mut fds, Some(&wait)).is_ok_and(|count| count > 0) {
            let mut chunk = [0; 256];
            let count = uninterrupted::read(&mut self.line, &mut chunk).unwrap();
            self.received.extend_from_slice(&chunk[..count]);
        }
    }
}

impl ProfibusPhy for Terminal {
    fn poll_transmission(&mut self, _: Instant) -> bool {
        false
    }

    fn transmit_data<F: FnOnce(&mut [u8]) -> (usize, R), R>(&mut self, _: Instant, fill: F) -> R {
        let mut buffer = [0; 256];
        let (len, result) = fill(&mut buffer);
        self.line.write_all(&buffer[..len]).unwrap();
        result
    }

    fn receive_data<F: FnOnce(&[u8]) -> (usize, R), R>(&mut self, _: Instant, take: F) -> R {
        let (taken, result) = take(&self.received);
        self.received.drain(..taken);
        result
    }
}

/// A PLC with this master.
struct Plc {
    line: Terminal,
    fdl: FdlActiveStation,
    master: DpMaster<'static>,
    gripper: PeripheralHandle,
    image: OutputImage,
}

impl Plc {
    fn new(path: &Path) -> Self {
        let options = PeripheralOptions {
            ident_number: PROFILE.ident,
            user_parameters: Some(&[]),
            config: Some(PROFILE.config),
            ..PeripheralOptions::default()
        };
        let mut master = DpMaster::new(vec![]);
        let (inputs, outputs) = (vec![0; InputImage::LEN], vec![0; OutputImage::LEN]);
        let gripper = master.add(Peripheral::new(STATION, options, inputs, outputs));
        master.enter_operate();
        // A slot time of 60 ms and many retries tolerate a busy machine. The low highest address limits the polled stations.
        let parameters = ParametersBuilder::new(2, Baudrate::B500000)
            .slot_bits(30_000)
            .max_retry_limit(15)
            .highest_station_address(3)
            .build_verified(&master);
        let mut fdl = FdlActiveStation::new(parameters);
        fdl.set_online();
        let image =
            OutputImage { flags: Flag::empty(), user: 0xA5, width: 20_00, speed: 100_00, force_limit: 40_00 };
        Self { line: Terminal { line: open_terminal(path), received: vec![] }, fdl, master, gripper, image }
    }

    /// Exchanges outputs with these flags until `is_done` returns `true` for the inputs.
    fn command(&mut self, flags: Flag, is_done: impl Fn(&InputImage) -> bool) {
        self.image.flags = flags;
        let start = RealInstant::now();
        let mut shown = None;
        while !shown.as_ref().is_some_and(&is_done) {
            assert!(start.elapsed() < BOUND, "{flags:?}: {shown:?}");
            let gripper = self.master.get_mut(self.gripper);
            gripper.pi_q_mut().copy_from_slice(&self.image.to_bytes());
            self.fdl.poll(Instant::now(), &mut self.line, &mut self.master);
            let events = self.master.take_last_events();
            if events.cycle_completed && self.master.get_mut(self.gripper).is_running() {
                let inputs = self.master.get_mut(self.gripper).pi_i();
                shown = Some(InputImage::from_bytes(inputs.try_into().unwrap()));
            }
            self.line.listen();
        }
    }
}

#[test]
fn profirust_master_grips_and_releases_over_a_pty() {
    let config = Config { time_scale: QUICK, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { profibus: Some(SerialLine::Pty), control: any_port(), ..Lines::default() };
    let server = serve(config, lines);
    let mut plc = Plc::new(server.profibus_path().expect("PROFIBUS is served"));

    let shows = |state| move |input: &InputImage| (input.state, input.status) == (state, Status::Success);
    plc.command(Flag::empty(), shows(Shown::IDLE));
    plc.command(Flag::HOMING, |input| {
        input.system.contains(SystemFlags::REFERENCED) && shows(Shown::IDLE)(input)
    });
    plc.command(Flag::empty(), shows(Shown::IDLE));
    plc.command(Flag::GRIP, shows(Shown::HOLDING));
    plc.command(Flag::empty(), shows(Shown::HOLDING));
    plc.command(Flag::RELEASE, shows(Shown::IDLE));

    let outputs = || -> [u8; OutputImage::LEN] {
        serde_json::from_value(fieldbus(&server)["output"].clone()).expect("an image")
    };
    assert_eq!(outputs(), plc.image.to_bytes());
    // Global_Control to all stations: Clear_Data, sent in place of the silent profirust master.
    plc.line.line.write_all(&[0x68, 7, 7, 0x68, 0xFF, 0x82, 0x46, 58, 62, 2, 0, 0x41, 0x16]).unwrap();
    await_true("outputs of zeros", || outputs() == [0; OutputImage::LEN]);
}

/// Fieldbus manual, 7: the monitor shows the bit rate of a line that has one.
#[test]
fn monitor_shows_address_and_the_bit_rate_of_devices_only() {
    let (_adapter, path) = open_adapter();
    for (line, rate) in [(SerialLine::Device(path), "115200 bit/s"), (SerialLine::Pty, "")] {
        let lines = Lines { profibus: Some(line), control: any_port(), ..Lines::default() };
        let server = serve(Config { profibus_address: STATION, ..Config::default() }, lines);
        let bus = &fieldbus(&server)["buses"][0];
        assert_eq!((&bus["address"], &bus["rate"]), (&Value::from("7"), &Value::from(rate)));
    }
}

/// Returns the fieldbus part of the control interface's state.
fn fieldbus(server: &ServerThread) -> Value {
    let control = server.control_address().expect("the control interface is served");
    request(control, "GET", "/state", "").1["fieldbus"].take()
}
