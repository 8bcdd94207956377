//! UDP: one frame or line per datagram. Frames go to a fixed port of the latest sender, lines to the source port of the request.

use super::echoes::Echoes;
use super::hub::{ClientHandle, Hub};
use super::open_line::{Listen, OpenLine, Place};
use crate::port::{MAX_FRAME_LEN, PortKind};
use anyhow::{Context, Result};
use fieldbus_host::Client;
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;
use tokio::net::UdpSocket;
use tokio::task::yield_now;

/// Maximum length of a datagram in bytes.
const DATAGRAM_LEN: usize = 65_535;

/// Default number of datagrams sent to a client on another machine that sends nothing; see
/// [`Lines::udp_unanswered`](super::Lines::udp_unanswered). The limit is needed because the sender of a datagram can be
/// forged and updates are unsolicited. Routers do not forward loopback addresses, so a sender with one is local.
const UNANSWERED: u32 = 1_000;

/// Returns how many datagrams are sent to this client while it sends nothing; `None`: unlimited.
fn most_unanswered(limit: Option<u32>, client: SocketAddr) -> Option<u32> {
    match limit {
        Some(0) => None,
        Some(limit) => Some(limit),
        None if client.ip().is_loopback() => None,
        None => Some(UNANSWERED),
    }
}

/// Returns whether the error is a signal, or reports that an earlier datagram was undeliverable.
const fn is_of_the_past(error: ErrorKind) -> bool {
    matches!(error, ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset)
}

/// The latest sender, which receives the answers.
#[derive(Default)]
struct Remote {
    address: Option<SocketAddr>,
    /// Datagrams sent to it since its last datagram.
    unanswered: u32,
    echoes: Echoes,
}

/// Opens a line that serves the protocol of `kind`; `None` without an address. Answers go to `remote_port`, or with
/// `None` to the source port of the request. `unanswered` limits the datagrams sent to a client that sends nothing; 0
/// disables the limit.
pub(super) async fn open(
    listen: Listen<'_>,
    kind: PortKind,
    remote_port: Option<u16>,
    unanswered: Option<u32>,
) -> Result<Option<OpenLine>> {
    let Some(address) = listen.address() else { return Ok(None) };
    let socket = UdpSocket::bind(address).await.with_context(|| listen.refused(address))?;
    let place = Place::Address(socket.local_addr()?);
    let serve = move |hub| serve(hub, socket, remote_port, kind, unanswered);
    Ok(Some(OpenLine::new(listen.name, place, serve)))
}

/// Serves the clients of one protocol; see [`open`].
async fn serve(
    hub: Arc<Hub>,
    socket: UdpSocket,
    remote_port: Option<u16>,
    kind: PortKind,
    unanswered: Option<u32>,
) -> Result<()> {
    let client = hub
        .connect(kind, &socket.local_addr()?.to_string())
        .context("all client places are taken; none is left for UDP")?;
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
                    // A client that sends continuously must not starve the others.
                    yield_now().await;
                }
                Err(error) if is_of_the_past(error.kind()) => {}
                Err(error) => return Err(error).context("UDP reception failed"),
            },
            () = client.frame_waits() => {}
            () = client.request_waits() => client.arrive(),
        }
    }
}

/// Sends all queued frames. Discards them and ends the updates once a silent client has reached its limit.
async fn send_waiting(client: &ClientHandle, socket: &UdpSocket, remote: &mut Remote, limit: Option<u32>) {
    let mut buffer = [0; MAX_FRAME_LEN];
    while let Some(frame) = client.transmit(&mut buffer) {
        let Some(address) = remote.address else { continue };
        if most_unanswered(limit, address).is_some_and(|most| remote.unanswered >= most) {
            client.end_updates();
            continue;
        }
        remote.unanswered = remote.unanswered.saturating_add(1);
        remote.echoes.sent(frame);
        // The datagram is lost if the client does not listen, like any datagram.
        let _ = socket.send_to(frame, address).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_clients_on_other_machines_are_limited_by_default() {
        let [here, here_6, there] =
            ["127.0.0.1:1501", "[::1]:1501", "192.168.1.9:1501"].map(|text| text.parse().unwrap());
        assert_eq!([here, here_6, there].map(|at| most_unanswered(None, at)), [None, None, Some(UNANSWERED)]);
        assert_eq!([here, there].map(|at| most_unanswered(Some(7), at)), [Some(7); 2]);
        assert_eq!([here, there].map(|at| most_unanswered(Some(0), at)), [None; 2]);
    }
}
