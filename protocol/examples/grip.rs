//! Grips a part of the virtual or a real gripper over TCP with the blocking driver.
//!
//! ```text
//! cargo run -p wsg-sim -- --tcp 127.0.0.1:1000 --gcl 127.0.0.1:1001
//! cargo run -p wsg-protocol --example grip --features std,gcl -- 127.0.0.1:1000
//! cargo run -p wsg-protocol --example grip --features std,gcl -- --protocol gcl 127.0.0.1:1001
//! ```

use std::io;
use std::process::ExitCode;

use wsg_protocol::driver::blocking::{GclGripper, Gripper, GripperOver};
use wsg_protocol::driver::host::{StdClock, Tcp};
use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, MotionResult, N, Pending, Protocol};
use wsg_protocol::session::Topic;
use wsg_protocol::{AutoUpdate, HomingDirection, Status};

/// Prints the received updates until none is received for `within_ms`.
fn show_updates<C: Clock, P: Protocol>(
    gripper: &mut GripperOver<Tcp, C, P>,
    within_ms: u32,
) -> Result<(), Error<io::Error>> {
    while let Some(update) = gripper.next_update(within_ms)? {
        println!("{update:?}");
    }
    Ok(())
}

/// Waits for the end of a motion and prints every update received meanwhile.
fn watch<C: Clock, P: Protocol, T: MotionResult>(
    gripper: &mut GripperOver<Tcp, C, P>,
    motion: &Pending<T>,
) -> Result<T, Error<io::Error>> {
    loop {
        let result = gripper.poll(motion)?;
        show_updates(gripper, 0)?;
        if let Some(result) = result {
            return Ok(result);
        }
    }
}

/// The program for either protocol. It may return early by `?`: the connection is closed properly.
fn run<C: Clock, P: Protocol>(gripper: &mut GripperOver<Tcp, C, P>) -> Result<(), Error<io::Error>> {
    println!("{}", gripper.system_info()?);
    match gripper.limits() {
        Ok(limits) => println!("{limits}"),
        Err(Error::NotInGcl) => println!("the text protocol does not report the limits"),
        Err(error) => return Err(error),
    }
    match gripper.tag(&mut [0; 64]) {
        Ok(tag) => println!("tag: {tag}"),
        Err(Error::Refused(Status::NotAvailable)) => println!("no tag"),
        Err(error) => return Err(error),
    }

    // An earlier client may have left a FAST STOP.
    gripper.acknowledge()?;
    let homing = gripper.begin_home(HomingDirection::Default)?;
    watch(gripper, &homing)?;
    gripper.set_force_limit(N(40.0))?;

    gripper.subscribe(Topic::Width, AutoUpdate::on_change(50));
    let grip = gripper.begin_grip(Mm(20.0), MmPerS(100.0))?;
    match watch(gripper, &grip)? {
        Grip::Held => println!("a part is held, {:.2} mm wide", gripper.width()?),
        Grip::NoPart => println!("no part"),
    }
    let release = gripper.begin_release(Mm(60.0), MmPerS(200.0))?;
    watch(gripper, &release)?;
    gripper.subscribe(Topic::Width, AutoUpdate::once());
    show_updates(gripper, 100)?;
    println!("{}", gripper.statistics(false)?);
    println!("updates lost: {}", gripper.counters().updates_lost);
    Ok(())
}

const USAGE: &str = "grip [--protocol binary|gcl] [ADDRESS:PORT]";

fn start() -> Result<(), String> {
    let (mut protocol, mut address) = ("binary".to_owned(), "127.0.0.1:1000".to_owned());
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--protocol" => protocol = arguments.next().ok_or(USAGE)?,
            _ if argument.starts_with('-') => {
                return Err(format!("unknown option {argument}; usage: {USAGE}"));
            }
            _ => address = argument,
        }
    }
    let line = Tcp::connect(&address).map_err(|error| format!("{address}: {error}"))?;
    let clock = StdClock::new();
    match protocol.as_str() {
        "binary" => Gripper::new(line, clock).with_connection(run),
        "gcl" => GclGripper::new(line, clock).with_connection(run),
        other => return Err(format!("unknown protocol {other}; usage: {USAGE}")),
    }
    .map_err(|error| error.to_string())
}

fn main() -> ExitCode {
    match start() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
