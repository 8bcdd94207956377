//! Grips a part over TCP, with the async driver on embassy's executor: one thread, two tasks. On a board the executor and
//! the timer are the same; the transport is a UART or a socket of `embassy-net`.
//!
//! ```text
//! cargo run -p wsg-sim -- --tcp 127.0.0.1:1000
//! cargo run -p wsg-protocol --example grip_async --features embedded-io-async -- 127.0.0.1:1000
//! ```

use std::io;
use std::net::{SocketAddr, TcpStream};

use async_io::Async;
use embassy_executor::Spawner;
use embassy_time::{Duration, Ticker};
use embedded_io_adapters::futures_03::FromFutures;
use wsg_protocol::driver::{Clock, Error, Grip, Timer, asynch::Gripper};
use wsg_protocol::{HomingDirection, Instant};

/// Embassy's clock.
struct EmbassyTimer;

impl Clock for EmbassyTimer {
    fn now(&mut self) -> Instant {
        // The clock may wrap, so its low 32 bits will do.
        Instant::from_millis(embassy_time::Instant::now().as_millis() as u32)
    }
}

impl Timer for EmbassyTimer {
    async fn wait_until(&mut self, moment: Instant) {
        embassy_time::Timer::after_millis(moment.since(self.now()).into()).await;
    }
}

/// What else there is to do meanwhile.
#[embassy_executor::task]
async fn blink() {
    let mut ticker = Ticker::every(Duration::from_millis(500));
    loop {
        ticker.next().await;
        println!("tick");
    }
}

async fn run(address: SocketAddr) -> Result<(), Error<io::Error>> {
    let stream = Async::<TcpStream>::connect(address).await.map_err(Error::Transport)?;
    stream.get_ref().set_nodelay(true).map_err(Error::Transport)?;

    let mut gripper = Gripper::new(FromFutures::new(stream), EmbassyTimer);
    gripper.connect().await?;
    println!("{}", gripper.system_info().await?);
    gripper.acknowledge().await?;
    gripper.home(HomingDirection::Default).await?;
    gripper.set_force_limit(40.0).await?;

    let grip = gripper.begin_grip(20.0, 100.0).await?;
    // To give up waiting does not give up the motion.
    let patience = Duration::from_millis(100);
    let result = loop {
        match embassy_time::with_timeout(patience, gripper.wait(&grip)).await {
            Ok(result) => break result?,
            Err(_) => println!("{:.1} mm", gripper.width().await?),
        }
    };
    match result {
        Grip::Held => println!("a part is held, {:.2} mm wide", gripper.width().await?),
        Grip::NoPart => println!("no part"),
    }
    gripper.release(60.0, 200.0).await?;
    gripper.announce_disconnect().await
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    spawner.spawn(blink().expect("it is spawned once"));
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:1000".into());
    let result = match address.parse() {
        Ok(address) => run(address).await,
        Err(error) => return eprintln!("{address}: {error}"),
    };
    // The executor never ends by itself.
    match result {
        Ok(()) => std::process::exit(0),
        Err(error) => {
            eprintln!("{error}");
            std::process::exit(1);
        }
    }
}
