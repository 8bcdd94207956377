//! `wsg demo`: starts a virtual gripper with its page in this process, and plays a grip cycle on it, or connects it to a PLC through the
//! bridge's library.

mod bridge;

use std::io::{self, ErrorKind, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, value_parser};
use wsg_protocol::driver::blocking::Gripper as BinaryGripper;
use wsg_protocol::driver::host::StdClock;
use wsg_protocol::driver::{Grip, Mm, MmPerS};
use wsg_protocol::{GripperState, HomingDirection};
use wsg_sim::server::{Lines, ServerThread};
use wsg_sim::{Config, Part};

use crate::gripper::{Address, Connection, Signals};
use crate::listen_address;
use bridge::VirtualBridge;

type Gripper = BinaryGripper<Connection, StdClock>;

/// Width of the part, and nominal width of each grip.
const PART: f32 = 20.0;
/// Opening width after a release.
const OPEN: f32 = 60.0;
/// Speed of every motion.
const SPEED: MmPerS = MmPerS(50.0);
/// Pause between two steps, in which a viewer can read the page.
const PAUSE: Duration = Duration::from_millis(1_500);
/// Interval of state queries.
const POLL: Duration = Duration::from_millis(20);

/// Starts a virtual gripper with its page and plays a grip cycle on it, until Ctrl-C; needs no hardware
#[derive(Args)]
#[command(after_help = "With port 0, the system chooses a free port.")]
pub(crate) struct Arguments {
    /// Address of the page
    #[arg(long, value_name = "ADDR", value_parser = listen_address, default_value = "127.0.0.1:8080")]
    page: SocketAddr,
    /// Address of the binary protocol, which `wsg gripper` uses
    #[arg(long, value_name = "ADDR", value_parser = listen_address, default_value = "127.0.0.1:11000")]
    tcp: SocketAddr,
    /// Address of Modbus/TCP, for a PLC
    #[arg(long, value_name = "ADDR", value_parser = listen_address, default_value = "127.0.0.1:1502")]
    modbus: SocketAddr,
    /// Serial port of a Modbus RTU master, or `pty` for a pseudo terminal: plays no cycle; the bridge's software connects the
    /// master, as its PLC, to the gripper
    #[arg(long, value_name = "PORT", conflicts_with_all = ["modbus", "cycles"])]
    bus: Option<String>,
    /// Serial port or `pty` for the bridge's service port, which `wsg bridge` uses
    #[arg(long, value_name = "PORT", requires = "bus")]
    service: Option<String>,
    /// File that stores the bridge's settings; without it, they are lost at the end
    #[arg(long, value_name = "FILE", requires = "bus")]
    settings: Option<PathBuf>,
    /// Number of cycles, instead of until Ctrl-C
    #[arg(long, value_name = "N", value_parser = value_parser!(u32).range(1..))]
    cycles: Option<u32>,
    /// Makes fingers and pauses this many times as fast, 1 to 100
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = value_parser!(u8).range(1..=100))]
    speed_up: u8,
}

/// Runs the demonstration. Returns 0 after the last cycle and after Ctrl-C.
pub(crate) fn run(arguments: &Arguments) -> Result<u8> {
    let &Arguments { page, tcp, modbus, cycles, speed_up, .. } = arguments;
    let signals = Signals::catch()?;
    let config = Config { time_scale: speed_up.into(), ..Config::default() };
    // The bridge replaces the gripper's own fieldbus.
    let modbus = arguments.bus.is_none().then_some(modbus);
    let lines = Lines { tcp: Some(tcp), modbus, control: Some(page), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).with_context(|| {
        let options = if arguments.bus.is_none() { "--page, --tcp and --modbus" } else { "--page and --tcp" };
        format!("the virtual gripper cannot start; {options} select other addresses")
    })?;
    let [page, tcp, modbus] = [server.control_address(), server.tcp_address(), server.modbus_address()]
        .map(|address| address.map(|address| address.to_string()).unwrap_or_default());
    if let Some(bus) = &arguments.bus {
        let (service, settings) = (arguments.service.as_deref(), arguments.settings.as_deref());
        return serve_plc(&bridge::Options { bus, service, settings }, server, &page, &tcp, &signals);
    }

    let mut gripper =
        Gripper::new(Connection::open(&Address::Tcp(tcp.clone()), None, signals.clone())?, StdClock::new());
    let mut demo = Demo { server, begin: Instant::now(), pause: PAUSE / u32::from(speed_up) };
    let played = gripper.with_connection(|gripper| {
        let played = announce(&page, &tcp, &modbus).and_then(|()| demo.play(gripper, cycles));
        // The end of the connection is announced, even after Ctrl-C.
        let is_ended = signals.check().is_err();
        signals.heed(false);
        if is_ended { demo.show("ended") } else { played }
    });
    until_closed(played)?;
    demo.server.stop()?;
    Ok(0)
}

/// A closed standard output ends a demonstration without an error.
fn until_closed(played: Result<()>) -> Result<()> {
    match played {
        Err(error)
            if error
                .downcast_ref()
                .is_some_and(|error: &io::Error| error.kind() == ErrorKind::BrokenPipe) =>
        {
            Ok(())
        }
        played => played,
    }
}

/// Connects a PLC to the virtual gripper through the bridge's library, until Ctrl-C.
fn serve_plc(
    options: &bridge::Options<'_>,
    server: ServerThread,
    page: &str,
    tcp: &str,
    signals: &Signals,
) -> Result<u8> {
    server.set_part(Part::of_width(PART));
    let mut bridge = VirtualBridge::open(options, tcp)?;
    let (bus, service) = bridge.ports();
    let mut out = io::stdout();
    writeln!(out, "page     http://{page}/\nbus      {bus}")?;
    if let Some(service) = service {
        writeln!(out, "service  {service}")?;
    }
    writeln!(
        out,
        "The PLC commands the gripper by Modbus RTU. A part of {PART:.0} mm is in place. Ctrl-C ends the demonstration."
    )?;
    until_closed(bridge.run(signals, |time, outputs| {
        let names: Vec<&str> = outputs.iter_names().map(|(name, _)| name).collect();
        writeln!(io::stdout(), "{:6.1}  {}", time.as_secs_f64(), names.join(" "))?;
        Ok(())
    }))?;
    server.stop()?;
    Ok(0)
}

fn announce(page: &str, tcp: &str, modbus: &str) -> Result<()> {
    writeln!(
        io::stdout(),
        "page     http://{page}/\ngripper  tcp://{tcp}\nmodbus   {modbus}\nOpen the page in a browser. Ctrl-C ends the demonstration."
    )?;
    Ok(())
}

struct Demo {
    server: ServerThread,
    begin: Instant,
    pause: Duration,
}

impl Demo {
    /// Prints a line with the time since the start in seconds.
    fn show(&self, words: &str) -> Result<()> {
        writeln!(io::stdout(), "{:6.1}  {words}", self.begin.elapsed().as_secs_f64())?;
        Ok(())
    }

    fn play(&mut self, gripper: &mut Gripper, cycles: Option<u32>) -> Result<()> {
        self.show("HOME: the fingers search for their end stop")?;
        gripper.home(HomingDirection::Default)?;
        self.show(&format!("referenced at {:.1} mm", gripper.width()?.0))?;
        self.rest(gripper)?;
        let mut played = 0;
        while cycles.is_none_or(|cycles| played < cycles) {
            self.cycle(gripper)?;
            played += 1;
            self.show(&format!("cycle {played} is complete"))?;
        }
        Ok(())
    }

    /// Grips a part that is pulled out, then one that stays.
    fn cycle(&mut self, gripper: &mut Gripper) -> Result<()> {
        self.grip(gripper)?;
        self.server.set_part(None);
        self.show("the part is pulled out")?;
        self.wait_for(gripper, GripperState::PartLost)?;
        self.show("PART LOST")?;
        self.rest(gripper)?;
        self.release(gripper)?;
        self.grip(gripper)?;
        self.release(gripper)
    }

    /// Puts a part between the fingers and grips it.
    fn grip(&mut self, gripper: &mut Gripper) -> Result<()> {
        self.server.set_part(Part::of_width(PART));
        self.show(&format!("GRIP a part of {PART:.1} mm"))?;
        let grip = gripper.grip(Mm(PART), SPEED)?;
        ensure!(grip == Grip::Held, "the gripper holds no part: {grip:?}");
        self.show(&format!("HOLDING at {:.1} mm with {:.1} N", gripper.width()?.0, gripper.force()?.0))?;
        self.rest(gripper)
    }

    fn release(&mut self, gripper: &mut Gripper) -> Result<()> {
        self.show(&format!("RELEASE to {OPEN:.1} mm"))?;
        gripper.release(Mm(OPEN), SPEED)?;
        self.show(&format!("IDLE at {:.1} mm", gripper.width()?.0))?;
        self.rest(gripper)
    }

    /// Pauses between two steps. The queries notice Ctrl-C.
    fn rest(&self, gripper: &mut Gripper) -> Result<()> {
        let begin = Instant::now();
        while begin.elapsed() < self.pause {
            gripper.gripper_state()?;
            std::thread::sleep(POLL.min(self.pause));
        }
        Ok(())
    }

    /// Waits for a state, for at most 5 s.
    fn wait_for(&self, gripper: &mut Gripper, state: GripperState) -> Result<()> {
        let begin = Instant::now();
        while gripper.gripper_state()? != state {
            if begin.elapsed() > Duration::from_secs(5) {
                bail!("the gripper does not report {state}");
            }
            std::thread::sleep(POLL);
        }
        Ok(())
    }
}
