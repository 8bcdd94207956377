//! The README's quick start.
//!
//! ```text
//! cargo run -p wsg-sim -- --tcp 127.0.0.1:1000 --part 20
//! cargo run -p wsg-protocol --example quick_start --features std -- 127.0.0.1:1000
//! ```

use wsg_protocol::HomingDirection;
use wsg_protocol::driver::{Error, Grip, Mm, MmPerS, N, host};

/// Grips a part of 20 mm with 40 N and releases it. The end of the connection is announced on every return path.
fn take_a_part(address: &str) -> Result<Grip, Error<std::io::Error>> {
    let mut gripper = host::connect(address)?;
    gripper.home(HomingDirection::Default)?;
    gripper.set_force_limit(N(40.0))?;
    let grip = gripper.grip(Mm(20.0), MmPerS(100.0))?;
    if grip == Grip::Held {
        println!("a part of {:.2}, held with {:.1}", gripper.width()?, gripper.force()?);
        gripper.release(Mm(60.0), MmPerS(200.0))?;
    }
    Ok(grip)
}

fn main() -> Result<(), Error<std::io::Error>> {
    let address = std::env::args().nth(1).unwrap_or("192.168.1.20:1000".to_owned());
    println!("{:?}", take_a_part(&address)?);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg_sim::server::{Lines, ServerThread};
    use wsg_sim::{Config, Part};

    #[test]
    fn quick_start_takes_a_part() {
        let lines = Lines { tcp: Some("127.0.0.1:0".parse().unwrap()), ..Lines::default() };
        let config = Config { part: Part::of_width(20.0), ..Config::default() };
        let server = ServerThread::start(config, &lines, None).unwrap();
        let address = server.tcp_address().unwrap().to_string();
        assert_eq!(take_a_part(&address).unwrap(), Grip::Held);
    }
}
