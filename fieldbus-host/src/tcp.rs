//! TCP: any number of clients, successively or simultaneously.

use crate::accept::{Accepted, Acceptor};
use crate::client::Client;
use crate::stream::{self, FlowControl};
use socket2::{SockRef, TcpKeepalive};
use std::io;
use std::net::SocketAddr;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::spawn_local;

/// Idle time of a connection after which the system sends keep-alive probes.
const KEEP_ALIVE_AFTER: Duration = Duration::from_secs(60);
/// Interval between the probes.
const KEEP_ALIVE_INTERVAL: Duration = Duration::from_secs(10);
/// Number of unanswered probes after which the connection ends.
const KEEP_ALIVE_RETRIES: u32 = 3;

/// Accepts the clients of a listener until the future is dropped, and serves each in a task of its own.
///
/// `connect` returns the client for a peer, or `None` if no place is left: then the connection closes immediately.
pub async fn serve<const FRAME_LEN: usize, C: Client<FRAME_LEN> + 'static>(
    listener: TcpListener,
    connect: impl Fn(SocketAddr) -> Option<C>,
) {
    let mut acceptor = Acceptor::new(listener);
    loop {
        match acceptor.accept().await {
            Accepted::Client(stream, peer) => {
                if let Some(client) = connect(peer) {
                    spawn_local(serve_client(stream, client));
                }
            }
            // The connection closes immediately.
            Accepted::Refused(_) => {}
        }
    }
}

/// The client is dropped, and so disconnected, before its socket closes.
async fn serve_client<const FRAME_LEN: usize>(mut stream: TcpStream, client: impl Client<FRAME_LEN>) {
    // Without keep-alive, the end of a connection is noticed later.
    let _ = keep_alive(&stream);
    if stream.set_nodelay(true).is_ok() {
        let (reader, writer) = stream.split();
        // The client has disconnected in either case.
        let _ = stream::serve(&client, reader, writer, FlowControl::Present).await;
    }
}

/// Enables keep-alive, so that the system detects a client that lost its power or network. The connection then ends
/// with a FAST STOP (command set, 1.4.2), or with the end of a Modbus master's jog (guide, 4.3.2).
fn keep_alive(stream: &TcpStream) -> io::Result<()> {
    let keep_alive = TcpKeepalive::new()
        .with_time(KEEP_ALIVE_AFTER)
        .with_interval(KEEP_ALIVE_INTERVAL)
        .with_retries(KEEP_ALIVE_RETRIES);
    let socket = SockRef::from(stream);
    // Probes are sent only while the client has acknowledged everything.
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(KEEP_ALIVE_AFTER + KEEP_ALIVE_RETRIES * KEEP_ALIVE_INTERVAL))?;
    socket.set_tcp_keepalive(&keep_alive)
}

// Windows accepts these times but does not report them.
#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[tokio::test]
    async fn system_asks_whether_a_silent_master_is_still_there() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (master, accepted) = tokio::join!(TcpStream::connect(address), listener.accept());
        let _master = master.unwrap();
        let (stream, _) = accepted.unwrap();
        assert!(!SockRef::from(&stream).keepalive().unwrap());
        keep_alive(&stream).unwrap();
        let socket = SockRef::from(&stream);
        assert!(socket.keepalive().unwrap());
        assert_eq!(socket.tcp_keepalive_time().unwrap(), KEEP_ALIVE_AFTER);
        assert_eq!(socket.tcp_keepalive_interval().unwrap(), KEEP_ALIVE_INTERVAL);
        assert_eq!(socket.tcp_keepalive_retries().unwrap(), KEEP_ALIVE_RETRIES);
        #[cfg(target_os = "linux")]
        assert_eq!(socket.tcp_user_timeout().unwrap(), Some(Duration::from_secs(90)));
    }
}
