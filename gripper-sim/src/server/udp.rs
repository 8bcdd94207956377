//! UDP: one frame or line per datagram. Frames go to a fixed port of whoever sent last, lines to the port that asked.

use super::echoes::Echoes;
use super::hub::{Client, Hub};
use crate::port::{MAX_FRAME_LEN, PortKind};
use anyhow::{Context, Result};
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;
use tokio::net::UdpSocket;
use tokio::task::yield_now;

/// The longest datagram there is.
const DATAGRAM_LEN: usize = 65_535;

/// How many datagrams a client on another machine is sent while it sends nothing, unless
/// [`Lines::udp_unanswered`](super::Lines::udp_unanswered) says otherwise. The sender of a datagram can be forged, and updates go
/// on by themselves. No router passes on the loopback addresses, so a sender that has one is here.
const UNANSWERED: u32 = 1_000;

/// Returns how many datagrams this client is sent while it sends nothing; `None`: any number.
fn most_unanswered(limit: Option<u32>, client: SocketAddr) -> Option<u32> {
    match limit {
        Some(0) => None,
        Some(limit) => Some(limit),
        None if client.ip().is_loopback() => None,
        None => Some(UNANSWERED),
    }
}

/// A signal, or what the system tells about an earlier datagram that found nobody.
const fn is_of_the_past(error: ErrorKind) -> bool {
    matches!(error, ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// Who is at the other end.
#[derive(Default)]
struct Remote {
    address: Option<SocketAddr>,
    /// Datagrams sent to it since it sent something.
    unanswered: u32,
    echoes: Echoes,
}

/// Serves clients of one protocol. Answers go to `remote_port`, or with `None` to the port that sent the request. `unanswered` is
/// the number of datagrams that are sent to a client that sends nothing; 0 is any number.
pub(super) async fn serve(
    hub: Arc<Hub>,
    socket: UdpSocket,
    remote_port: Option<u16>,
    kind: PortKind,
    unanswered: Option<u32>,
) -> Result<()> {
    let client =
        hub.connect(kind, &socket.local_addr()?.to_string()).context("the gripper has no place for UDP")?;
    let mut datagram = vec![0; DATAGRAM_LEN];
    let mut remote = Remote::default();
    loop {
        send_waiting(&client, &socket, &mut remote, unanswered).await;
        tokio::select! {
            received = socket.recv_from(&mut datagram) => match received {
                Ok((len, from)) => {
                    let received = datagram.get(..len).unwrap_or(&[]);
                    if !remote.echoes.must_end(Instant::now(), from, received) {
                        let here = SocketAddr::new(from.ip(), remote_port.unwrap_or(from.port()));
                        if remote.address.is_some_and(|before| before != here) {
                            client.end_updates();
                            send_waiting(&client, &socket, &mut remote, unanswered).await;
                        }
                        remote.address = Some(here);
                        remote.unanswered = 0;
                        client.receive(received);
                    }
                    // A client that sends without end gets no more than its turn.
                    yield_now().await;
                }
                Err(error) if is_of_the_past(error.kind()) => {}
                Err(error) => return Err(error).context("UDP receives no more"),
            },
            () = client.frame_waits() => {}
            () = client.request_waits() => client.arrive(),
        }
    }
}

/// Sends every frame that waits; none any more to a client that has sent nothing for too long, and its updates end.
async fn send_waiting(client: &Client, socket: &UdpSocket, remote: &mut Remote, limit: Option<u32>) {
    let mut buffer = [0; MAX_FRAME_LEN];
    while let Some(frame) = client.transmit(&mut buffer) {
        let Some(address) = remote.address else { continue };
        if most_unanswered(limit, address).is_some_and(|most| remote.unanswered >= most) {
            client.end_updates();
            continue;
        }
        remote.unanswered = remote.unanswered.saturating_add(1);
        remote.echoes.sent(frame);
        // Nobody may listen there; a datagram is lost then, as datagrams are.
        let _ = socket.send_to(frame, address).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clients_on_other_machines_are_limited_by_default_and_those_on_this_one_are_not() {
        let [here, here_6, there] =
            ["127.0.0.1:1501", "[::1]:1501", "192.168.1.9:1501"].map(|text| text.parse().unwrap());
        assert_eq!([here, here_6, there].map(|at| most_unanswered(None, at)), [None, None, Some(UNANSWERED)]);
        assert_eq!([here, there].map(|at| most_unanswered(Some(7), at)), [Some(7); 2]);
        assert_eq!([here, there].map(|at| most_unanswered(Some(0), at)), [None; 2]);
    }
}
