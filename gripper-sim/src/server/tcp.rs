//! TCP: any number of clients, successively or simultaneously.

use super::open_line::{Listen, OpenLine};
use crate::port::PortKind;
use anyhow::Result;

/// Opens a line that serves the protocol of `kind`; `None` without an address.
pub(super) async fn open(listen: Listen<'_>, kind: PortKind) -> Result<Option<OpenLine>> {
    let Some((listener, place)) = listen.tcp().await? else { return Ok(None) };
    Ok(Some(OpenLine::new(listen.name, place, move |hub| async move {
        fieldbus_host::tcp::serve(listener, |peer| hub.connect(kind, &peer.to_string())).await;
        Ok(())
    })))
}
