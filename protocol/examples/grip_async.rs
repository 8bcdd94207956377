//! Grips a part over TCP with the async driver on embassy's executor: one thread, two tasks. On a board, executor and timer
//! are the same, and the transport is a UART or a socket of `embassy-net`.
//!
//! ```text
//! cargo run -p wsg-sim -- --tcp 127.0.0.1:1000 --gcl 127.0.0.1:1001
//! cargo run -p wsg-protocol --example grip_async --features embedded-io-async,gcl -- 127.0.0.1:1000
//! cargo run -p wsg-protocol --example grip_async --features embedded-io-async,gcl -- --protocol gcl 127.0.0.1:1001
//! ```

use std::io;
use std::net::{SocketAddr, TcpStream};

use async_io::Async;
use embassy_executor::Spawner;
use embassy_time::{Duration, Ticker};
use embedded_io_adapters::futures_03::FromFutures;
use wsg_protocol::driver::asynch::{GclGripper, Gripper, GripperOver};
use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N, Protocol, Timer};
use wsg_protocol::{HomingDirection, Instant};

/// The clock of embassy.
struct EmbassyTimer;

impl Clock for EmbassyTimer {
    fn now(&mut self) -> Instant {
        // The clock may wrap, so its low 32 bits suffice.
        Instant::from_millis(embassy_time::Instant::now().as_millis() as u32)
    }
}

impl Timer for EmbassyTimer {
    async fn wait_until(&mut self, moment: Instant) {
        embassy_time::Timer::after_millis(moment.since(self.now()).into()).await;
    }
}

/// A second task that runs concurrently.
#[embassy_executor::task]
async fn blink() {
    let mut ticker = Ticker::every(Duration::from_millis(500));
    loop {
        ticker.next().await;
        println!("tick");
    }
}

type Tcp = FromFutures<Async<TcpStream>>;

async fn connect(address: SocketAddr) -> io::Result<Tcp> {
    let stream = Async::<TcpStream>::connect(address).await?;
    stream.get_ref().set_nodelay(true)?;
    Ok(FromFutures::new(stream))
}

/// The program for either protocol. It may return early by `?`: the connection is closed properly.
async fn run<P: Protocol>(gripper: &mut GripperOver<Tcp, EmbassyTimer, P>) -> Result<(), Error<io::Error>> {
    println!("{}", gripper.system_info().await?);
    gripper.acknowledge().await?;
    gripper.home(HomingDirection::Default).await?;
    gripper.set_force_limit(N(40.0)).await?;

    let grip = gripper.begin_grip(Mm(20.0), MmPerS(100.0)).await?;
    // A cancelled wait does not cancel the motion.
    let patience = Duration::from_millis(100);
    let result = loop {
        match embassy_time::with_timeout(patience, gripper.wait(&grip)).await {
            Ok(result) => break result?,
            Err(_) => println!("{:.1}", gripper.width().await?),
        }
    };
    match result {
        Grip::Held => println!("a part is held, {:.2} mm wide", gripper.width().await?),
        Grip::NoPart => println!("no part"),
    }
    gripper.release(Mm(60.0), MmPerS(200.0)).await
}

const USAGE: &str = "grip_async [--protocol binary|gcl] [ADDRESS:PORT]";

async fn start() -> Result<(), String> {
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
    let about_address = |error: &dyn std::fmt::Display| format!("{address}: {error}");
    let socket = address.parse().map_err(|error| about_address(&error))?;
    let line = connect(socket).await.map_err(|error| about_address(&error))?;
    match protocol.as_str() {
        "binary" => Gripper::new(line, EmbassyTimer).with_connection(run).await,
        "gcl" => GclGripper::new(line, EmbassyTimer).with_connection(run).await,
        other => return Err(format!("unknown protocol {other}; usage: {USAGE}")),
    }
    .map_err(|error| error.to_string())
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    spawner.spawn(blink().expect("spawned only once"));
    // The executor never ends by itself.
    match start().await {
        Ok(()) => std::process::exit(0),
        Err(error) => {
            eprintln!("{error}");
            std::process::exit(1);
        }
    }
}
