//! TCP: any number of clients, one after the other or at once.

use super::hub::Hub;
use super::stream::{self, Pace};
use crate::port::PortKind;
use anyhow::Result;
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::spawn_local;
use tokio::time::sleep;

/// How long no connection is accepted after the system refused one, for want of descriptors for example.
const RECOVERY: Duration = Duration::from_millis(100);

/// `kind` says which protocol is spoken.
pub(super) async fn serve(hub: Rc<Hub>, listener: TcpListener, kind: PortKind) -> Result<()> {
    loop {
        match listener.accept().await {
            Ok((stream, peer)) => {
                spawn_local(serve_client(Rc::clone(&hub), stream, peer, kind));
            }
            Err(_) => sleep(RECOVERY).await,
        }
    }
}

async fn serve_client(hub: Rc<Hub>, mut stream: TcpStream, peer: SocketAddr, kind: PortKind) {
    // One too many: the connection is closed at once.
    let Some(client) = hub.connect(kind, &peer.to_string()) else { return };
    if stream.set_nodelay(true).is_ok() {
        let (reader, writer) = stream.split();
        // However it ends, the client is gone; that is all there is to say about it.
        let _ = stream::serve(&client, reader, writer, Pace::OfTheReader).await;
    }
}
