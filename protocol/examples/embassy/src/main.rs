//! A station with embassy on a NUCLEO-F446RE: a button starts a cycle of grip and release. It compiles; it was never executed.
//!
//! The gripper's RS-232 is on USART1 over a transceiver (PA9 transmits, PA10 receives), with 115 200 bit/s. The LED is on while
//! a part is held.
#![no_std]
#![no_main]

use embassy_executor::Spawner;
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::{bind_interrupts, peripherals};
use panic_halt as _;
use wsg_protocol::driver::asynch::{Gripper, Transport};
use wsg_protocol::driver::{Clock, Error, Grip, Mm, MmPerS, N, Timer};
use wsg_protocol::{HomingDirection, Instant};

bind_interrupts!(struct Interrupts {
    USART1 => usart::BufferedInterruptHandler<peripherals::USART1>;
});

struct EmbassyTimer;

impl Clock for EmbassyTimer {
    fn now(&mut self) -> Instant {
        Instant::from_millis(embassy_time::Instant::now().as_millis() as u32)
    }
}

impl Timer for EmbassyTimer {
    async fn wait_until(&mut self, moment: Instant) {
        embassy_time::Timer::after_millis(moment.since(self.now()).into()).await;
    }
}

/// Waits until the button is released and pressed again, so that a button that is held never starts a second cycle.
async fn pressed(button: &Input<'_>) {
    for level in [Level::High, Level::Low] {
        while button.get_level() != level {
            embassy_time::Timer::after_millis(20).await;
        }
    }
}

/// Runs a cycle for each press of the button, until the gripper reports an error.
async fn station<IO: Transport>(
    gripper: &mut Gripper<IO, EmbassyTimer>,
    button: &Input<'_>,
    led: &mut Output<'_>,
) -> Result<(), Error<IO::Error>> {
    pressed(button).await;
    gripper.home(HomingDirection::Default).await?;
    gripper.set_force_limit(N(40.0)).await?;
    loop {
        pressed(button).await;
        if gripper.grip(Mm(20.0), MmPerS(100.0)).await? == Grip::Held {
            led.set_high();
            pressed(button).await;
            gripper.release(Mm(60.0), MmPerS(200.0)).await?;
            led.set_low();
        }
    }
}

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let board = embassy_stm32::init(embassy_stm32::Config::default());
    let button = Input::new(board.PC13, Pull::None);
    let mut led = Output::new(board.PA5, Level::Low, Speed::Low);
    let (mut sent, mut received) = ([0; 64], [0; 256]);
    let config = usart::Config::default();
    let uart =
        BufferedUart::new(board.USART1, board.PA10, board.PA9, &mut sent, &mut received, Interrupts, config);
    let Ok(uart) = uart else { return };
    let mut gripper = Gripper::new(uart, EmbassyTimer);
    loop {
        // An error ends the connection. A gripper that stopped stays there until the button is pressed again.
        let _ = gripper.with_connection(async |gripper| station(gripper, &button, &mut led).await).await;
        led.set_low();
        pressed(&button).await;
        let _ = gripper.acknowledge().await;
    }
}
