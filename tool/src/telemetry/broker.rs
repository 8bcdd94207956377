//! The connection to the broker: MQTT 3.1.1 over TCP or TLS, with automatic reconnection.

use std::{fmt::Display, fs, future::pending, io, path::Path, pin::pin, sync::Arc, time::Duration};

use anyhow::{Context, Error, Result, anyhow, bail, ensure};
use mqtt_protocol_core::mqtt::{
    Connection, Version,
    common::Cursor,
    connection::{ConnectionOptions, Event, role},
    packet::{GenericPacketTrait, Packet, Qos, SubEntry, SubOpts, v3_1_1},
    result_code::{ConnectReturnCode, SubackReturnCode},
};
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf, split},
    net::TcpStream,
    sync::{mpsc, watch},
    time::{Instant, interval, sleep_until, timeout},
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore, crypto,
        pki_types::{CertificateDer, PrivateKeyDer, ServerName, pem::PemObject},
    },
};
use wsg_sim::text;

use crate::{Severity, print_message};

use super::{
    config,
    node::{Identity, Message, Node},
    report::{Messages, Report, now_ms, stopped},
    sequence::Sequence,
};

/// Time-out for each step of connecting.
const STEP: Duration = Duration::from_secs(5);
/// Time-out for NDEATH and DISCONNECT on exit.
const FAREWELL: Duration = Duration::from_secs(1);
/// Interval at which PINGREQs are sent to confirm data, and messages that no report triggers are checked for.
const LOOK: Duration = Duration::from_millis(250);
/// Maximum number of bytes per write. Further messages wait in the store.
const WRITE_LEN: usize = 32 * 1024;
/// Maximum number of bytes per read.
const READ_LEN: usize = 4 * 1024;
/// Maximum length of a packet from the broker in bytes.
const MAX_PACKET_LEN: u32 = 64 * 1024;
/// Maximum number of reports received at a time.
const REPORTS: usize = 256;

trait Stream: AsyncRead + AsyncWrite + Unpin {}
impl<S: AsyncRead + AsyncWrite + Unpin> Stream for S {}

/// Address, credentials and timing of the broker connection.
pub(super) struct Broker {
    host: String,
    tls: Option<(TlsConnector, ServerName<'static>)>,
    user: Option<String>,
    password: Option<String>,
    client_id: String,
    keep_alive: Duration,
    reconnect: Duration,
}

impl Broker {
    /// Creates the broker and reads its certificates.
    ///
    /// # Errors
    /// A certificate file cannot be read or contains no certificate.
    pub(super) fn new(config: &config::Broker) -> Result<Self> {
        let tls = match &config.tls_name {
            None => None,
            Some(name) => {
                let server = ServerName::try_from(name.clone())
                    .map_err(|_| anyhow!("broker.address: {name:?} is not a valid host name or address"))?;
                Some((tls_of(config)?, server))
            }
        };
        Ok(Self {
            host: config.host.clone(),
            tls,
            user: config.user.clone(),
            password: config.password.as_ref().map(|password| password.0.clone()),
            client_id: config.client_id.clone(),
            keep_alive: config.keep_alive,
            reconnect: config.reconnect,
        })
    }

    /// Sends the node's messages to the broker until `stop` is set. Reports errors and reconnects.
    pub(super) async fn run(
        &self,
        node: &mut Node,
        reports: mpsc::Receiver<Report>,
        sequence: &mut Sequence,
        mut stop: watch::Receiver<bool>,
    ) {
        let mut messages = Messages::default();
        let mut inbox = Inbox { reports, taken: Vec::with_capacity(REPORTS) };
        let identity = node.identity().clone();
        loop {
            let attempted = {
                let mut attempt = pin!(self.connect(&identity, sequence));
                loop {
                    tokio::select! {
                        attempted = &mut attempt => break attempted,
                        () = inbox.wait() => inbox.give(node),
                        () = stopped(&mut stop) => return,
                    }
                }
            };
            let end = match attempted {
                Ok((mut link, number)) => {
                    messages.print(format!("broker {}: connected", self.host));
                    node.connected(number);
                    let end = link.serve(node, &mut inbox, &mut stop, self.keep_alive).await;
                    let Some(end) = end else {
                        // A broker that no longer responds must not block the exit.
                        let _ = timeout(FAREWELL, link.farewell(&identity.death(number, now_ms()))).await;
                        return;
                    };
                    node.disconnected();
                    end
                }
                Err(error) => error,
            };
            messages.print(format!("broker {}: {end:#}", self.host));
            let again = Instant::now() + self.reconnect;
            loop {
                tokio::select! {
                    () = sleep_until(again) => break,
                    () = inbox.wait() => inbox.give(node),
                    () = stopped(&mut stop) => return,
                }
            }
        }
    }

    /// Connects, sets the will and subscribes to commands. Also returns the `bdSeq` of the connection.
    async fn connect(&self, identity: &Identity, sequence: &mut Sequence) -> Result<(Link, u8)> {
        let slow = |_| anyhow!("no response within {} s", STEP.as_secs());
        let stream = timeout(STEP, self.open()).await.map_err(slow)??;
        let number = sequence.advance()?;
        let mut link = Link::new(stream);
        timeout(STEP, link.introduce(self, identity, number)).await.map_err(slow)??;
        Ok((link, number))
    }

    async fn open(&self) -> Result<Box<dyn Stream>> {
        let stream = TcpStream::connect(&self.host).await.context("cannot connect")?;
        stream.set_nodelay(true)?;
        Ok(match &self.tls {
            None => Box::new(stream),
            Some((connector, server)) => {
                Box::new(connector.connect(server.clone(), stream).await.context("TLS failed")?)
            }
        })
    }
}

/// Builds the TLS configuration.
fn tls_of(config: &config::Broker) -> Result<TlsConnector> {
    let mut roots = RootCertStore::empty();
    match &config.ca_file {
        Some(path) => {
            for certificate in
                certificates(path).with_context(|| format!("broker.ca_file {}", path.display()))?
            {
                roots.add(certificate).with_context(|| format!("broker.ca_file {}", path.display()))?;
            }
        }
        None => {
            roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
            ensure!(!roots.is_empty(), "no trusted certificates on this system; set broker.ca_file");
        }
    }
    let provider = Arc::new(crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()?
        .with_root_certificates(roots);
    let client = match &config.certificate {
        None => builder.with_no_client_auth(),
        Some((certificate, key)) => {
            let chain = certificates(certificate)
                .with_context(|| format!("broker.certificate_file {}", certificate.display()))?;
            let in_key = |error: &dyn Display| anyhow!("broker.key_file {}: {error}", key.display());
            let pem = pem_of(key).map_err(|error| in_key(&error))?;
            let secret = PrivateKeyDer::from_pem_slice(&pem).map_err(|error| in_key(&error))?;
            builder.with_client_auth_cert(chain, secret).context("broker.certificate_file and key_file")?
        }
    };
    Ok(TlsConnector::from(Arc::new(client)))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(&pem_of(path)?).collect();
    let found = found.map_err(|error| anyhow!("{error}"))?;
    ensure!(!found.is_empty(), "no certificate (PEM) found");
    Ok(found)
}

/// Reads a file in PEM format, whose text around the blocks may have any encoding.
fn pem_of(path: &Path) -> io::Result<Vec<u8>> {
    text::unmarked(fs::read(path)?)
}

/// Queue of reports for the node.
struct Inbox {
    reports: mpsc::Receiver<Report>,
    taken: Vec<Report>,
}

impl Inbox {
    /// Waits for reports. Cancel safe.
    async fn wait(&mut self) {
        if self.taken.is_empty() && self.reports.recv_many(&mut self.taken, REPORTS).await == 0 {
            // All readers have ended, so the program is about to exit.
            pending::<()>().await;
        }
    }

    fn give(&mut self, node: &mut Node) {
        self.taken.drain(..).for_each(|report| node.take(report));
    }
}

/// A connection to the broker.
struct Link {
    reader: ReadHalf<Box<dyn Stream>>,
    writer: WriteHalf<Box<dyn Stream>>,
    mqtt: Connection<role::Client>,
    /// Output buffer; bytes from `written` on are still to be sent.
    out: Vec<u8>,
    written: usize,
    needs_flush: bool,
    /// The pending PINGREQ: when it was sent, and the store position before it.
    ping: Option<(Instant, u64)>,
    last_ping: Instant,
    refusals: Messages,
}

/// A packet from the broker.
enum Received {
    Connack(ConnectReturnCode),
    Suback(bool),
    Pong,
    Command { topic: String, payload: Vec<u8>, is_retained: bool },
}

impl Link {
    fn new(stream: Box<dyn Stream>) -> Self {
        let (reader, writer) = split(stream);
        let mut options = ConnectionOptions::default();
        options.maximum_packet_size_recv = MAX_PACKET_LEN;
        let mut mqtt = Connection::with_options(Version::V3_1_1, options);
        mqtt.set_auto_pub_response(true);
        let last_ping = Instant::now();
        Self {
            reader,
            writer,
            mqtt,
            out: Vec::new(),
            written: 0,
            needs_flush: false,
            ping: None,
            last_ping,
            refusals: Messages::default(),
        }
    }

    /// Sends CONNECT with the will, and subscribes to commands.
    async fn introduce(&mut self, broker: &Broker, identity: &Identity, number: u8) -> Result<()> {
        let death = identity.death(number, now_ms());
        let keep_alive = u16::try_from(broker.keep_alive.as_secs()).unwrap_or(u16::MAX);
        let mut connect = v3_1_1::Connect::builder()
            .client_id(broker.client_id.as_str())
            .map_err(invalid)?
            .clean_session(true)
            .keep_alive(keep_alive)
            .will_message(&*death.topic, death.payload, Qos::AtLeastOnce, false)
            .map_err(invalid)?;
        if let Some(user) = &broker.user {
            connect = connect.user_name(user.as_str()).map_err(invalid)?;
        }
        if let Some(password) = &broker.password {
            connect = connect.password(password.as_bytes().to_vec()).map_err(invalid)?;
        }
        self.send(connect.build().map_err(invalid)?)?;
        match self.expect().await? {
            Received::Connack(ConnectReturnCode::Accepted) => {}
            Received::Connack(code) => bail!("the broker refused the connection: {}", reason(code)),
            _ => bail!("the broker did not answer CONNECT with CONNACK"),
        }
        let entries: Result<Vec<_>> = identity
            .command_topics()
            .iter()
            .map(|topic| {
                let options = SubOpts::new().set_qos(Qos::AtLeastOnce);
                SubEntry::new(topic.as_str(), options).map_err(invalid)
            })
            .collect();
        let id = self.mqtt.acquire_packet_id().map_err(invalid)?;
        let subscribe = v3_1_1::Subscribe::builder().packet_id(id).entries(entries?);
        self.send(subscribe.build().map_err(invalid)?)?;
        match self.expect().await? {
            Received::Suback(true) => Ok(()),
            Received::Suback(false) => {
                bail!("the broker refused the subscription to {}", identity.command_topics().join(" and "))
            }
            _ => bail!("the broker did not answer SUBSCRIBE with SUBACK"),
        }
    }

    /// Serves the connection until it fails, and returns the error. Returns `None` if the program is to exit.
    async fn serve(
        &mut self,
        node: &mut Node,
        inbox: &mut Inbox,
        stop: &mut watch::Receiver<bool>,
        keep_alive: Duration,
    ) -> Option<Error> {
        let mut looks = interval(LOOK);
        let mut chunk = vec![0; READ_LEN];
        loop {
            let turn = async {
                self.fill(node)?;
                tokio::select! {
                    count = self.reader.read(&mut chunk) => {
                        let count = count.context("connection lost")?;
                        ensure!(count > 0, "the broker closed the connection");
                        for received in self.receive(chunk.get(..count).unwrap_or(&[]))? {
                            self.take(received, node);
                        }
                    }
                    progress = write(&mut self.writer, self.out.get(self.written..).unwrap_or(&[]), self.needs_flush) => {
                        self.progress(progress.context("connection lost")?);
                    }
                    () = inbox.wait() => inbox.give(node),
                    _ = looks.tick() => self.ping(node, keep_alive)?,
                }
                Ok(())
            };
            tokio::select! {
                biased;
                () = stopped(stop) => return None,
                turn = turn => if let Err(error) = turn { return Some(error) },
            }
        }
    }

    /// Fills the output buffer with messages.
    fn fill(&mut self, node: &mut Node) -> Result<()> {
        if self.written == self.out.len() {
            self.out.clear();
            self.written = 0;
        }
        let now = now_ms();
        while self.out.len() < WRITE_LEN {
            let Some(message) = node.poll_transmit(now) else { break };
            self.publish(&message)?;
        }
        Ok(())
    }

    fn publish(&mut self, message: &Message) -> Result<()> {
        let packet = v3_1_1::Publish::builder()
            .topic_name(&*message.topic)
            .map_err(invalid)?
            .qos(Qos::AtMostOnce)
            .payload(message.payload.as_slice())
            .build()
            .map_err(invalid)?;
        self.send(packet)
    }

    /// Sends a PINGREQ to confirm data or to keep the connection alive, unless one is pending.
    fn ping(&mut self, node: &Node, keep_alive: Duration) -> Result<()> {
        match self.ping {
            Some((sent, _)) => {
                ensure!(
                    sent.elapsed() < keep_alive,
                    "no response from the broker for {} s",
                    keep_alive.as_secs()
                );
                Ok(())
            }
            None if node.is_unconfirmed() || self.last_ping.elapsed() > keep_alive / 2 => {
                self.last_ping = Instant::now();
                self.ping = Some((self.last_ping, node.mark()));
                self.send(v3_1_1::Pingreq::new())
            }
            None => Ok(()),
        }
    }

    fn take(&mut self, received: Received, node: &mut Node) {
        match received {
            Received::Pong => {
                if let Some((_, mark)) = self.ping.take() {
                    node.confirm(mark);
                }
            }
            Received::Command { topic, payload, is_retained } => {
                match node.command(&topic, &payload, is_retained, now_ms()) {
                    Ok(what) => print_message(Severity::Info, format_args!("command on {topic}: {what}")),
                    Err(why) => self.refusals.print(format!("command on {topic} refused: {why}")),
                }
            }
            Received::Connack(_) | Received::Suback(_) => {}
        }
    }

    /// Sends NDEATH, because an orderly DISCONNECT suppresses the will, then DISCONNECT.
    async fn farewell(&mut self, death: &Message) -> Result<()> {
        self.publish(death)?;
        self.send(v3_1_1::Disconnect::new())?;
        self.write_all().await?;
        self.writer.shutdown().await?;
        Ok(())
    }

    fn send(&mut self, packet: impl Into<Packet>) -> Result<()> {
        let events = self.mqtt.send(packet.into());
        self.handle(events).map(drop)
    }

    /// Flushes the output and waits for the next packet.
    async fn expect(&mut self) -> Result<Received> {
        self.write_all().await?;
        let mut chunk = vec![0; READ_LEN];
        loop {
            let count = self.reader.read(&mut chunk).await.context("connection lost")?;
            ensure!(count > 0, "the broker closed the connection");
            // Discarding the rest loses nothing: the broker answers each packet with one packet.
            if let Some(first) = self.receive(chunk.get(..count).unwrap_or(&[]))?.into_iter().next() {
                return Ok(first);
            }
        }
    }

    async fn write_all(&mut self) -> Result<()> {
        while self.written < self.out.len() || self.needs_flush {
            let rest = self.out.get(self.written..).unwrap_or(&[]);
            let progress = write(&mut self.writer, rest, self.needs_flush).await;
            self.progress(progress.context("connection lost")?);
        }
        Ok(())
    }

    fn progress(&mut self, count: Option<usize>) {
        match count {
            Some(count) => {
                self.written += count;
                self.needs_flush = self.written == self.out.len();
            }
            None => self.needs_flush = false,
        }
    }

    fn receive(&mut self, bytes: &[u8]) -> Result<Vec<Received>> {
        let mut received = Vec::new();
        let mut cursor = Cursor::new(bytes);
        while (cursor.position() as usize) < bytes.len() {
            let events = self.mqtt.recv(&mut cursor);
            received.extend(self.handle(events)?);
        }
        Ok(received)
    }

    /// Processes the events of the protocol library. Its timers are unused, because PINGREQs are sent more often anyway.
    fn handle(&mut self, events: Vec<Event>) -> Result<Vec<Received>> {
        let mut received = Vec::new();
        for event in events {
            match event {
                Event::RequestSendPacket { packet, .. } => self.out.extend(packet.to_continuous_buffer()),
                Event::NotifyPacketReceived(packet) => received.extend(match packet {
                    Packet::V3_1_1Connack(connack) => Some(Received::Connack(connack.return_code())),
                    Packet::V3_1_1Suback(suback) => {
                        let is_refused = |code: &SubackReturnCode| *code == SubackReturnCode::Failure;
                        Some(Received::Suback(!suback.return_codes().iter().any(is_refused)))
                    }
                    Packet::V3_1_1Pingresp(_) => Some(Received::Pong),
                    Packet::V3_1_1Publish(publish) => Some(Received::Command {
                        topic: publish.topic_name().to_owned(),
                        payload: publish.payload().as_slice().to_vec(),
                        is_retained: publish.retain(),
                    }),
                    _ => None,
                }),
                Event::NotifyError(error) => bail!("MQTT: {error}"),
                Event::RequestClose => bail!("MQTT: protocol violation by the broker"),
                Event::NotifyPacketIdReleased(_)
                | Event::RequestTimerReset { .. }
                | Event::RequestTimerCancel(_) => {}
            }
        }
        Ok(received)
    }
}

/// Writes some bytes and returns their number, or flushes if there are none and returns `None`. Waits if there is nothing to do.
/// Cancel safe.
async fn write(
    writer: &mut WriteHalf<Box<dyn Stream>>,
    bytes: &[u8],
    needs_flush: bool,
) -> io::Result<Option<usize>> {
    if !bytes.is_empty() {
        writer.write(bytes).await.map(Some)
    } else if needs_flush {
        writer.flush().await.map(|()| None)
    } else {
        pending().await
    }
}

fn invalid(error: impl std::fmt::Debug) -> Error {
    anyhow!("cannot be encoded in MQTT: {error:?}")
}

/// Describes why a broker refuses a connection (MQTT 3.1.1, 3.2.2.3).
const fn reason(code: ConnectReturnCode) -> &'static str {
    match code {
        ConnectReturnCode::Accepted => "accepted",
        ConnectReturnCode::UnacceptableProtocolVersion => "it does not support MQTT 3.1.1",
        ConnectReturnCode::IdentifierRejected => "client_id rejected",
        ConnectReturnCode::ServerUnavailable => "server unavailable",
        ConnectReturnCode::BadUserNameOrPassword => "wrong user or password",
        ConnectReturnCode::NotAuthorized => {
            "not authorized: wrong user or password, or no permission to connect"
        }
    }
}
