//! EtherNet/IP on real sockets. Adapters need addresses of their own, which only Linux has without set-up.

#[path = "../../../host-tests/src/ethernetip.rs"]
#[allow(dead_code, unreachable_pub, reason = "other tests use the rest")]
mod scanner;

use std::net::SocketAddrV4;
use wsg_sim::server::{EthernetIpLine, Lines, ServerThread};
use wsg_sim::{Config, Part};

#[test]
fn owner_of_an_ethernetip_adapter_homes_grips_and_stops_the_fingers_by_idle_and_silence() {
    let address = scanner::own_address();
    let line = EthernetIpLine { address: SocketAddrV4::new(address, 44_818), vendor: EthernetIpLine::VENDOR };
    let config = Config { part: Part::of_width(20.0), homing_speed: Some(400.0), ..Config::default() };
    let lines = Lines { ethernetip: Some(line), ..Lines::default() };
    let gripper = ServerThread::start(config, &lines, None).unwrap();
    scanner::judge(address, &|| gripper.state());
}
