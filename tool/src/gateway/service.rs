//! The gateway as a service of systemd: reports readiness and end, and feeds the service manager's watchdog by the rule of a board.
//! Has no effect in a process that no service manager has started.

use std::env;
use std::process;
use std::rc::Rc;
use std::time::{Duration, Instant};

use tokio::time::sleep;
use wsg_sim::text::one_line;

use super::bridge::{Gateway, TURN};

/// Reports that all ports are open, with a text for `systemctl status`.
pub(super) fn ready(status: &str) {
    notify(&format!("READY=1\nSTATUS={}", one_line(status)));
}

/// Reports that the gateway ends on request.
pub(super) fn stopping() {
    notify("STOPPING=1");
}

/// Feeds the watchdog of the service manager, if it has one for this process.
pub(super) async fn feed_watchdog(gateways: &[Rc<Gateway>]) {
    let pid = env::var("WATCHDOG_PID").ok();
    let time = env::var("WATCHDOG_USEC").ok().and_then(|micros| micros.parse().ok());
    if let Some(micros) = time.filter(|_| pid.is_none_or(|pid| pid == process::id().to_string())) {
        feed_every(Duration::from_micros(micros) / 2, gateways, || notify("WATCHDOG=1")).await;
    }
}

/// Feeds a watchdog whenever this time has passed, and then every bridge has run a regular turn.
async fn feed_every(period: Duration, gateways: &[Rc<Gateway>], feed: impl Fn()) {
    loop {
        sleep(period).await;
        let due = Instant::now();
        while !gateways.iter().all(|gateway| gateway.alive_at() > due) {
            sleep(TURN).await;
        }
        feed();
    }
}

/// Notifies the service manager. Never waits: if the manager reads nothing, the notification is lost.
#[cfg(target_os = "linux")]
fn notify(state: &str) {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::ffi::OsStrExt;
    use std::os::unix::net::{SocketAddr, UnixDatagram};

    let Some(name) = env::var_os("NOTIFY_SOCKET") else { return };
    let send = || {
        let address = match name.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name),
            _ => SocketAddr::from_pathname(&name),
        }?;
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        socket.send_to_addr(state.as_bytes(), &address)
    };
    if let Err(error) = send() {
        super::bridge::report(format_args!("cannot notify the service manager: {error}"));
    }
}

#[cfg(not(target_os = "linux"))]
fn notify(_: &str) {}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use bus_modbus::MAX_PDU_LEN;

    use super::super::config::GripperConfig;
    use super::*;

    /// The loop runs, and so does the other bridge.
    #[tokio::test]
    async fn watchdog_is_not_fed_while_a_bridge_runs_no_regular_turn() {
        for stalled in [0, 1] {
            let gripper = GripperConfig::of("tcp://127.0.0.1:1");
            let gateways = [0, 1].map(|_| Rc::new(Gateway::open(&gripper, &Rc::default()).unwrap()));
            let fed = Cell::new(0);
            let test = async {
                for _ in 0..20 {
                    gateways[1 - stalled].pass_time().await;
                    // A turn of a request is not regular.
                    gateways[stalled].serve(
                        (0, [127, 0, 0, 1].into()),
                        &[4, 0, 0, 0, 1],
                        &mut [0; MAX_PDU_LEN],
                    );
                }
                assert_eq!(fed.get(), 0, "gateway {stalled}");
                let start = Instant::now();
                while fed.get() < 3 {
                    assert!(start.elapsed() < Duration::from_secs(60), "never fed");
                    for gateway in &gateways {
                        gateway.pass_time().await;
                    }
                }
            };
            tokio::select! {
                () = feed_every(TURN, &gateways, || fed.set(fed.get() + 1)) => {}
                () = test => {}
            }
        }
    }
}
