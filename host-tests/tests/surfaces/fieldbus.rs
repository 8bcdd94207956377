//! The register interface: what all of its masters do, a master of Modbus/TCP, and the bridge's wires.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use embedded_io::ErrorType;
use host_tests::flash_model::FlashModel;
use host_tests::modbus_tcp::Master;
use host_tests::rtu_double::RtuDouble;
use host_tests::world::{self, WIRES};
use wsg_bridge_fw::io::{Inputs, Outputs};
use wsg_fieldbus::{CommandFlags, InputImage, OutputImage};
use wsg_protocol::{Status, SystemFlags};

use crate::station::BOUND;
use crate::surface::{Outcome, SPEED, Separately, Surface, Verb};

/// Time-out of the master.
const ANSWER_TIME: Duration = Duration::from_secs(1);

/// A master of the register interface during one request.
pub(crate) trait Registers {
    /// Writes the outputs. Returns after the gripper has received them.
    fn write(&mut self, image: OutputImage) -> Result<()>;

    /// Reads the inputs.
    fn read(&mut self) -> Result<InputImage>;
}

/// Opens `registers` for each request, so that none waits for another.
pub(crate) fn master<R: Registers>(
    registers: impl Fn() -> Result<R> + Clone + Send + 'static,
) -> Box<dyn Surface> {
    let image = Arc::new(Mutex::new(OutputImage::ZERO));
    Box::new(Separately(move |verb| {
        registers().and_then(|mut it| request(&mut it, &image, verb)).map_err(|error| error.to_string())
    }))
}

/// Reads the width, or writes the output image: zeros, then the edge.
fn request(registers: &mut impl Registers, image: &Mutex<OutputImage>, verb: Verb) -> Result<String> {
    let (flag, width, force) = match verb {
        Verb::Read => return Ok((f32::from(registers.read()?.width) / 100.0).to_string()),
        Verb::Home => (CommandFlags::HOMING, 0.0, 0.0),
        Verb::Move(width) => (CommandFlags::MOVE, width, 40.0),
        Verb::Grip(width, force) => (CommandFlags::GRIP, width, force),
        Verb::FastStop => (CommandFlags::FASTSTOP, 0.0, 0.0),
        Verb::Acknowledge => (CommandFlags::STOP_ACK, 0.0, 0.0),
    };
    let speed = if flag == CommandFlags::HOMING { 0.0 } else { SPEED };
    let starts = CommandFlags::MOTIONS.contains(flag);
    if starts {
        *image.lock().expect("no panic") = OutputImage {
            width: (width * 100.0) as i16,
            speed: (speed * 100.0) as u16,
            force_limit: (force * 100.0) as i16,
            ..OutputImage::ZERO
        };
    }
    let written = *image.lock().expect("no panic");
    // An edge needs a 0 first. FASTSTOP acts on its level.
    let before = (flag != CommandFlags::FASTSTOP).then_some(CommandFlags::empty());
    for flags in before.into_iter().chain([flag]) {
        registers.write(OutputImage { flags, ..written })?;
    }
    if !starts {
        return Ok(String::new());
    }
    // The status of the command (fieldbus, 5.1.2), after E_CMD_PENDING.
    loop {
        let inputs = registers.read()?;
        match inputs.status {
            Status::CmdPending => thread::sleep(Duration::from_millis(20)),
            Status::Success if inputs.system.contains(SystemFlags::FAST_STOP) => bail!("FAST STOP"),
            Status::Success => return Ok(String::new()),
            status => bail!("{status}"),
        }
    }
}

pub(crate) fn modbus(address: SocketAddr) -> Box<dyn Surface> {
    // A master gives up, and does not continue with an edge that is late.
    master(move || Ok(Master::connect(address, ANSWER_TIME)?))
}

impl Registers for Master {
    fn write(&mut self, image: OutputImage) -> Result<()> {
        self.write(image)
    }

    fn read(&mut self) -> Result<InputImage> {
        self.read()
    }
}

/// The bridge's library on a line to the gripper, and its wires.
struct Wires {
    levels: Arc<Mutex<(Inputs, Outputs)>>,
}

/// A wire is held for longer than it is debounced.
const HELD: Duration = Duration::from_millis(30);

/// Recipe 2, which moves to 10 mm at 20 mm/s.
const IDLE: Inputs = Inputs::FAST_STOP_OK.union(Inputs::RECIPE1);

pub(crate) fn wires(address: SocketAddr) -> Box<dyn Surface> {
    let levels = Arc::new(Mutex::new((IDLE, Outputs::empty())));
    let bridge = Arc::downgrade(&levels);
    thread::spawn(move || {
        let stream = TcpStream::connect(address).expect("the gripper listens");
        stream.set_nonblocking(true).expect("a socket option");
        let (mut line, start) = (TcpLine(stream), Instant::now());
        let mut flash = FlashModel::new();
        let (mut station, _) = world::start(&WIRES, &mut flash);
        let [mut modbus, mut service] = [RtuDouble::default(), RtuDouble::default()];
        while let Some(levels) = bridge.upgrade() {
            let inputs = levels.lock().expect("no panic").0;
            let now = start.elapsed().as_millis() as u32;
            let outputs = station.turn(now, inputs, &mut line, &mut modbus, &mut service, &mut flash);
            levels.lock().expect("no panic").1 = outputs;
            drop(levels);
            thread::sleep(Duration::from_millis(1));
        }
    });
    let wires = Wires { levels };
    let start = Instant::now();
    while !wires.levels.lock().expect("no panic").1.contains(Outputs::LINK_OK) {
        assert!(start.elapsed() < BOUND, "the bridge connects");
        thread::sleep(Duration::from_millis(5));
    }
    Box::new(wires)
}

impl Surface for Wires {
    fn begin(&mut self, verb: Verb) -> Receiver<Outcome> {
        let (sender, outcome) = channel();
        let levels = Arc::clone(&self.levels);
        thread::spawn(move || {
            let set = |wire, high| levels.lock().expect("no panic").0.set(wire, high);
            let outputs = || levels.lock().expect("no panic").1;
            let wire = match verb {
                Verb::Home => Inputs::HOME,
                Verb::Move(_) => Inputs::MOVE,
                Verb::Grip(..) => Inputs::GRIP,
                Verb::Acknowledge => Inputs::STOP_ACK,
                Verb::FastStop => {
                    set(Inputs::FAST_STOP_OK, false);
                    return sender.send(Ok(String::new()));
                }
                Verb::Read => {
                    let outputs = outputs();
                    let is_known = outputs.contains(Outputs::LINK_OK);
                    return sender.send(if is_known {
                        Ok(format!("{outputs:?}"))
                    } else {
                        Err("LINK_OK is low".into())
                    });
                }
            };
            set(Inputs::FAST_STOP_OK, true);
            thread::sleep(HELD);
            set(wire, true);
            thread::sleep(HELD);
            set(wire, false);
            while outputs().contains(Outputs::BUSY) {
                thread::sleep(HELD);
            }
            thread::sleep(HELD);
            sender.send(if outputs().contains(Outputs::ERROR) {
                Err("ERROR is high".into())
            } else {
                Ok(String::new())
            })
        });
        outcome
    }
}

/// A TCP connection as the line of a bridge.
struct TcpLine(TcpStream);

impl ErrorType for TcpLine {
    type Error = std::io::Error;
}

impl embedded_io::ReadReady for TcpLine {
    fn read_ready(&mut self) -> std::io::Result<bool> {
        match uninterrupted::peek(&self.0, &mut [0]) {
            Ok(count) => Ok(count > 0),
            Err(error) if error.kind() == ErrorKind::WouldBlock => Ok(false),
            Err(error) => Err(error),
        }
    }
}

impl embedded_io::Read for TcpLine {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        uninterrupted::read(&mut self.0, buffer)
    }
}

impl embedded_io::WriteReady for TcpLine {
    fn write_ready(&mut self) -> std::io::Result<bool> {
        Ok(true)
    }
}

impl embedded_io::Write for TcpLine {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        uninterrupted::write(&mut self.0, bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
