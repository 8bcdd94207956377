//! The control interface: operation of the gripper over HTTP with JSON, and a page that shows it. `docs/simulator.md`
//! is the user documentation.
//!
//! Each connection serves one request, or is the WebSocket of a page. Size, time and number of requests are bounded.
//! Streams are unlimited in time, but bounded in number and backlog. `Host` and `Origin` decide who may send requests: the
//! browser sets them, and a web page cannot.

mod access;
mod age;
mod answer;
mod commands;
mod documents;
mod editor;
mod events;
mod history;
mod injected;
mod page;
mod peer;
mod read_only;
mod scripts;
mod settings;
mod socket;
mod state;

use super::hub::Hub;
use super::open_line::{Listen, OpenLine};
use access::{check_host, check_origin};
use age::{Effect, Sender, Stalls, as_of, as_of_in};
use answer::{Answer, HttpError, finished, json, whole};
use anyhow::Result;
use commands::{COMMAND_EXPECTED, CommandBody, Executed};
use documents::DOCUMENTS;
use editor::{Editor, FRAME_EXPECTED, FrameBody};
use events::{Events, Link, MAX_STREAMS, Watchers, event};
use fieldbus_host::accept::{Accepted, Acceptor};
use history::History;
use http_body_util::{BodyExt, Either, LengthLimitError, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONTENT_DISPOSITION, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::upgrade::OnUpgrade;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use injected::{FAULT_EXPECTED, FaultBody, LINE_EXPECTED, PART_EXPECTED, line_faults, part, which_fault};
use peer::Peer;
use scripts::ScriptBody;
use serde::Deserialize;
use settings::{SETTINGS_EXPECTED, change, settings};
use state::{HelloBody, StateBody};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::io;
use std::net::IpAddr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::{JoinHandle, spawn_local, yield_now};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, timeout};

pub use read_only::serve_read_only;

/// The longest accepted body, in bytes.
const MAX_BODY_LEN: usize = 4_096;
/// Maximum length of the head of a request, in bytes.
const MAX_HEAD_LEN: usize = 16_384;
/// Maximum number of simultaneous connections. One more displaces the oldest.
const MAX_CONNECTIONS: usize = 32;
/// Maximum duration of a connection.
const TIME_LIMIT: Duration = Duration::from_secs(5);
/// Interval at which changes are sent to pages.
const PERIOD: Duration = Duration::from_millis(50);
/// Interval of the heartbeat to pages while nothing changes. A page shows after a second that it receives nothing.
const HEARTBEAT: Duration = Duration::from_millis(200);
/// Time from the answer to a request for a restart to the restart.
const RESTART_DELAY: Duration = Duration::from_millis(100);
/// How long a rejected connection may take to read the reason.
const REFUSAL_TIME: Duration = Duration::from_millis(100);
/// The reason: the system has no file descriptor left to serve the connection.
const NO_ROOM: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/json\r\nContent-Length: 65\r\n\
    Cache-Control: no-store\r\nConnection: close\r\nRetry-After: 1\r\n\r\n\
    {\"error\":\"the system has no descriptor left; close connections\"}\n";

/// Opens the line of the control interface; `None` without an address. `names` are the hosts accepted in requests, in
/// addition to this machine's own address and `localhost`.
pub(super) async fn open(listen: Listen<'_>, names: &[String]) -> Result<Option<OpenLine>> {
    let Some((listener, place)) = listen.tcp().await? else { return Ok(None) };
    let names = names.to_vec();
    Ok(Some(OpenLine::new(listen.name, place, move |hub| serve(hub, listener, names))))
}

async fn serve(hub: Arc<Hub>, listener: TcpListener, names: Vec<String>) -> Result<()> {
    let names: Rc<[String]> = names.into();
    let watchers = Rc::new(Watchers::default());
    let (history, editor) = (Rc::new(History::default()), Editor::new(Arc::clone(&hub)));
    let stalls = Stalls::new();
    spawn_local(Rc::clone(&stalls).watch());
    spawn_local(Rc::clone(&history).record(Arc::clone(&hub)));
    spawn_local(publish(Arc::clone(&hub), Rc::clone(&editor), Rc::clone(&watchers)));
    let site = Site { hub, names, watchers, history, editor, stalls, executed: Rc::default() };
    let serve = |link, stream, peer| serve_connection(site.clone(), link, stream, peer);
    match serve_connections(listener, MAX_CONNECTIONS, serve).await {}
}

/// Serves connections, with this limit on their number and one on their time.
async fn serve_connections<F: Future<Output = Result<()>> + 'static>(
    listener: TcpListener,
    limit: usize,
    serve: impl Fn(Rc<Link>, TcpStream, IpAddr) -> F,
) -> Infallible {
    let mut connections = Connections::default();
    let mut acceptor = Acceptor::new(listener);
    loop {
        match acceptor.accept().await {
            Accepted::Client(stream, peer) => {
                let link = Link::new();
                let served = serve(Rc::clone(&link), stream, peer.ip().to_canonical());
                connections.open(Rc::clone(&link), limit, async move {
                    tokio::select! {
                        // Ends a connection that does not speak HTTP.
                        _ = served => {}
                        // Ends a connection that exceeds its time limit.
                        () = run_out(&link) => {}
                    }
                });
                // Answers a request received with its connection before other connections can displace it.
                yield_now().await;
            }
            Accepted::Refused(stream) => {
                // A client that does not read the answer is disconnected.
                let _ = timeout(REFUSAL_TIME, refuse(stream)).await;
            }
        }
    }
}

/// Rejects a client that cannot be served. Reads its request, because otherwise the system would discard the answer.
async fn refuse(mut stream: TcpStream) -> io::Result<()> {
    stream.write_all(NO_ROOM).await?;
    stream.shutdown().await?;
    let mut request = [0; 1_024];
    while stream.read(&mut request).await? > 0 {}
    Ok(())
}

/// The state shared by all requests.
#[derive(Clone, Debug)]
struct Site {
    hub: Arc<Hub>,
    names: Rc<[String]>,
    watchers: Rc<Watchers>,
    history: Rc<History>,
    editor: Rc<Editor>,
    stalls: Rc<Stalls>,
    executed: Rc<Executed>,
}

/// A connection, as its request sees it.
#[derive(Debug)]
struct Connection {
    link: Rc<Link>,
    stream: Peer,
    peer: IpAddr,
    here: IpAddr,
    /// The stream of a WebSocket, which begins after the answer.
    socket: RefCell<Option<(Sender, Events, OnUpgrade)>>,
}

/// Ready when a connection has lasted too long: a request exceeds the time limit, or a stream is no longer read.
async fn run_out(link: &Link) {
    sleep(TIME_LIMIT).await;
    if link.streams() {
        link.is_given_up().await;
    }
}

/// Sends changes of the state to pages while any are open.
async fn publish(hub: Arc<Hub>, editor: Rc<Editor>, watchers: Rc<Watchers>) {
    // The next entry of the system log, and the next frame of the editor.
    let (mut next_entry, mut next_frame) = (0, 0);
    let (mut next_line, mut sent_script) = (0, None);
    loop {
        watchers.opened().await;
        hub.watch_log(true);
        // A page that opens reads the settings by itself.
        let mut settings = hub.settings_revision();
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut sent = (String::new(), Instant::now());
        while !watchers.are_none() {
            ticks.tick().await;
            let report = hub.report();
            let body = StateBody::of(&hub, &report).without_time();
            // The body contains nothing that JSON cannot represent.
            let state = serde_json::to_string(&body).unwrap_or_default();
            if state != sent.0 || sent.1.elapsed() >= HEARTBEAT {
                let (time_s, as_of) = (report.now.as_micros() as f64 / 1e6, as_of(&hub, report.now));
                let json = format!("{{\"time_s\":{time_s},\"as_of\":\"{as_of}\",\"state\":{state}}}");
                watchers.send(&event("state", &json));
                sent = (state, Instant::now());
            }
            let entries = hub.system_log().entries_from(next_entry);
            if let Some(latest) = entries.last() {
                next_entry = latest.number + 1;
                let entries = serde_json::json!({ "entries": entries });
                watchers.send(&event("system_log", &entries.to_string()));
            }
            let frames = editor.frames_from(next_frame);
            if let Some(latest) = frames.last() {
                next_frame = latest.number + 1;
                let frames = serde_json::json!({ "frames": frames });
                watchers.send(&event("editor", &frames.to_string()));
            }
            let (report, lines) = hub.script_report(next_line);
            if !lines.is_empty() || sent_script.as_ref() != Some(&report) {
                next_line = lines.last().map_or(next_line, |line| line.number + 1);
                let script = serde_json::json!({ "latest": report, "lines": lines });
                watchers.send(&event("script", &script.to_string()));
                sent_script = Some(report);
            }
            if settings != hub.settings_revision() {
                settings = hub.settings_revision();
                watchers.send(&event("settings", &format!("{{\"revision\":{settings}}}")));
            }
            let log = hub.take_watched();
            if !log.lines.is_empty() {
                let lines = serde_json::json!({ "lines": log.lines, "lost": log.lost });
                watchers.send(&event("log", &lines.to_string()));
            }
        }
        hub.watch_log(false);
    }
}

/// The open connections, oldest first.
#[derive(Debug, Default)]
struct Connections(VecDeque<(Rc<Link>, JoinHandle<()>)>);

impl Connections {
    /// Adds a connection. If the limit is reached, drops the oldest: it has had the most time for its request, and a
    /// complete request has been answered already.
    fn open(&mut self, link: Rc<Link>, limit: usize, connection: impl Future<Output = ()> + 'static) {
        let Self(open) = self;
        open.retain(|(_, connection)| !connection.is_finished());
        // Streams have their own limit.
        let asks = |(link, _): &(Rc<Link>, JoinHandle<()>)| !link.streams();
        if open.iter().filter(|connection| asks(connection)).count() >= limit
            && let Some((_, oldest)) = open.iter().position(asks).and_then(|at| open.remove(at))
        {
            oldest.abort();
        }
        open.push_back((link, spawn_local(connection)));
    }
}

async fn serve_connection(site: Site, link: Rc<Link>, stream: TcpStream, peer: IpAddr) -> Result<()> {
    let here = stream.local_addr()?.ip().to_canonical();
    let stream = Peer::new(stream)?;
    let socket = RefCell::default();
    let connection = Rc::new(Connection { link, stream: stream.clone(), peer, here, socket });
    let (site_of_requests, connection_of_requests) = (site.clone(), Rc::clone(&connection));
    let service = service_fn(move |request| {
        answer(site_of_requests.clone(), Rc::clone(&connection_of_requests), request)
    });
    let served = http1::Builder::new()
        // A stop is executed even if its client has given up.
        .half_close(true)
        .max_buf_size(MAX_HEAD_LEN)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    served.await?;
    let socket = connection.socket.take();
    if let Some((sender, events, upgrade)) = socket {
        socket::serve(upgrade, events, MAX_BODY_LEN, |message| answer_message(&site, sender, message)).await;
    }
    Ok(())
}

/// A command of a page.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MessageBody {
    /// The number that the answer repeats.
    id: u64,
    as_of: Option<String>,
    body: CommandBody,
}

const MESSAGE_EXPECTED: &str = r#"{"id":1,"as_of":"...","body":{"command":"home"}}"#;

/// Executes a command of a page, and returns the event that answers it.
fn answer_message(site: &Site, sender: Sender, message: &str) -> Bytes {
    let parsed: Result<MessageBody, _> = serde_json::from_str(message);
    let id = parsed.as_ref().ok().map(|message| message.id);
    let answer = parsed
        .map_err(|error| {
            HttpError::wrong(format!("the message is invalid: {error}; expected {MESSAGE_EXPECTED}"))
        })
        .and_then(|MessageBody { as_of, body, .. }| {
            if !body.is_stop() {
                sender.check(&site.hub, &site.stalls, Effect::Moves, as_of.as_deref())?;
            }
            body.execute(&site.hub, &site.executed)?;
            state(&site.hub)
        });
    let (status, body) = match answer {
        Ok(state) => (StatusCode::OK, state),
        Err(HttpError { status, error, .. }) => (status, serde_json::json!({ "error": error }).to_string()),
    };
    let (id, status) = (serde_json::json!(id), status.as_u16());
    event("answer", &format!("{{\"id\":{id},\"status\":{status},\"body\":{body}}}"))
}

async fn answer(
    site: Site,
    connection: Rc<Connection>,
    request: Request<Incoming>,
) -> Result<Answer, Infallible> {
    let answer = async {
        check_host(request.headers(), connection.here, &site.names, " or a name of --control-host")?;
        check_origin(request.headers())?;
        act(&site, &connection, request).await
    };
    Ok(finished(answer.await))
}

/// Returns the state of gripper and lines as JSON.
fn state(hub: &Hub) -> Result<String, HttpError> {
    serde_json::to_string(&StateBody::of(hub, &hub.report()))
        .map_err(|error| HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))
}

/// Returns the system log as a file of text.
fn system_log_file(hub: &Hub) -> Answer {
    let lines = hub.system_log().entries_from(0).into_iter().map(|entry| format!("{entry}\n"));
    file(lines.collect(), HeaderValue::from_static("attachment; filename=\"wsg-system-log.txt\""))
}

/// Returns a text that a browser saves as a file.
fn file(text: String, disposition: HeaderValue) -> Answer {
    let mut response = whole(text, HeaderValue::from_static("text/plain; charset=utf-8"));
    response.headers_mut().insert(CONTENT_DISPOSITION, disposition);
    response
}

/// Returns the page itself.
fn show_page(request: &Request<Incoming>) -> Result<Answer, HttpError> {
    let host = request.headers().get(HOST).and_then(|host| host.to_str().ok()).unwrap_or_default();
    document(page::page(host))
}

/// Returns a page with its content security policy.
fn document((page, policy): (String, String)) -> Result<Answer, HttpError> {
    let mut response = whole(page, HeaderValue::from_static("text/html; charset=utf-8"));
    let policy = HeaderValue::from_str(&policy)
        .map_err(|error| HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy);
    Ok(response)
}

/// Opens an event stream, which begins with its static data.
fn open_events(site: &Site, link: Rc<Link>) -> Result<Events, HttpError> {
    let hello = HelloBody::of(&site.hub, &site.history);
    let hello = serde_json::to_string(&hello).unwrap_or_default();
    site.watchers.open(event("hello", &hello), link).ok_or_else(|| {
        let error = format!("{MAX_STREAMS} pages are open already; close one of them first");
        HttpError::new(StatusCode::SERVICE_UNAVAILABLE, error)
    })
}

/// Returns an event stream: a WebSocket for a page, or server-sent events for a program.
fn show_events(
    site: &Site,
    connection: &Connection,
    mut request: Request<Incoming>,
) -> Result<Answer, HttpError> {
    if !socket::is_wanted(request.headers()) {
        let events = open_events(site, Rc::clone(&connection.link))?;
        let mut response = Response::new(Either::Right(events));
        response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
        return Ok(response);
    }
    let answer = socket::accept(&request)?;
    let sender = Sender::of(request.headers(), connection.peer, connection.here);
    let upgrade = hyper::upgrade::on(&mut request);
    let events = open_events(site, Rc::clone(&connection.link))?;
    connection.socket.replace(Some((sender, events, upgrade)));
    Ok(answer)
}

/// Each path and its method.
const PATHS: [(&str, Method); 19] = [
    ("/", Method::GET),
    ("/events", Method::GET),
    ("/events", Method::POST),
    ("/state", Method::GET),
    ("/log", Method::GET),
    ("/settings", Method::GET),
    ("/settings", Method::POST),
    ("/restart", Method::POST),
    ("/log.txt", Method::GET),
    (DOCUMENTS[0].0, Method::GET),
    (DOCUMENTS[1].0, Method::GET),
    ("/scripts", Method::GET),
    ("/scripts", Method::POST),
    ("/frames", Method::GET),
    ("/frame", Method::POST),
    ("/command", Method::POST),
    ("/part", Method::POST),
    ("/fault", Method::POST),
    ("/line", Method::POST),
];

/// Executes the request. The answer is the state, except for the page and its events.
async fn act(site: &Site, connection: &Connection, request: Request<Incoming>) -> Result<Answer, HttpError> {
    let hub = &site.hub;
    check_path(&request, &PATHS)?;
    let path = request.uri().path().to_owned();
    let is_post = request.method() == Method::POST;
    let sender = Sender::of(request.headers(), connection.peer, connection.here);
    let as_of = if is_post { as_of_in(request.uri())?.map(str::to_owned) } else { None };
    // Precedes each change.
    let check_age = async |effect: Effect| {
        if connection.stream.has_closed().await {
            let error = "the connection was closed before the request was executed; expected it open until the answer";
            return Err(HttpError::wrong(error.to_owned()));
        }
        sender.check(hub, &site.stalls, effect, as_of.as_deref())
    };
    match path.as_str() {
        "/" => return show_page(&request),
        "/log" => {
            let entries = hub.system_log().entries_from(0);
            return Ok(json(&serde_json::json!({ "entries": entries }).to_string()));
        }
        "/log.txt" => return Ok(system_log_file(hub)),
        "/scripts" => {
            let answer = if is_post {
                let limit = scripts::MAX_SCRIPT_BODY_LEN;
                let body: ScriptBody = read_up_to(request, limit, scripts::SCRIPT_EXPECTED).await?;
                if body.changes() {
                    check_age(Effect::Moves).await?;
                }
                scripts::execute(hub, body)?
            } else {
                scripts::scripts(hub, None)?
            };
            return Ok(json(&serde_json::json!(answer).to_string()));
        }
        "/frames" => {
            let frames = site.editor.frames_from(0);
            return Ok(json(&serde_json::json!({ "frames": frames }).to_string()));
        }
        "/frame" => {
            let body: FrameBody = read(request, FRAME_EXPECTED).await?;
            if body.commands() {
                check_age(Effect::Moves).await?;
            }
            let frame = site.editor.take(&body)?;
            return Ok(json(&serde_json::json!(frame).to_string()));
        }
        "/settings" => {
            if is_post {
                let body = read(request, SETTINGS_EXPECTED).await?;
                check_age(Effect::Changes).await?;
                change(hub, body)?;
            }
            return Ok(json(&serde_json::json!(settings(hub)?).to_string()));
        }
        "/restart" => {
            check_age(Effect::Moves).await?;
            restart(hub)?;
        }
        // Shows a page whose WebSocket does not open whether the server would accept it.
        "/events" if is_post => drop(open_events(site, Link::new())?),
        "/events" => return show_events(site, connection, request),
        "/command" => {
            let body: CommandBody = read(request, COMMAND_EXPECTED).await?;
            if !body.is_stop() {
                check_age(Effect::Moves).await?;
            }
            body.execute(hub, &site.executed)?;
        }
        "/part" => {
            let part = part(read(request, PART_EXPECTED).await?)?;
            check_age(Effect::Changes).await?;
            hub.set_part(part);
        }
        "/fault" => {
            let FaultBody { fault, finger, on } = read(request, FAULT_EXPECTED).await?;
            let fault = which_fault(hub, fault, finger)?;
            check_age(Effect::Changes).await?;
            hub.set_fault(fault, on);
        }
        "/line" => {
            let faults = line_faults(&read(request, LINE_EXPECTED).await?)?;
            check_age(Effect::Changes).await?;
            hub.set_line_faults(faults);
        }
        path => {
            if let Some((_, text)) = DOCUMENTS.iter().find(|(known, _)| *known == path) {
                return Ok(file((*text).to_owned(), HeaderValue::from_static("attachment")));
            }
        }
    }
    Ok(json(&state(hub)?))
}

/// Rejects a request whose path or method is not among these.
fn check_path(request: &Request<Incoming>, paths: &[(&str, Method)]) -> Result<(), HttpError> {
    let path = request.uri().path();
    let methods: Vec<&Method> =
        paths.iter().filter(|(known, _)| *known == path).map(|(_, method)| method).collect();
    if methods.is_empty() {
        let known =
            paths.iter().map(|(path, method)| format!("{method} {path}")).collect::<Vec<_>>().join(", ");
        let error = format!("the path {path:?} is unknown; expected one of {known}");
        return Err(HttpError::new(StatusCode::NOT_FOUND, error));
    }
    if !methods.contains(&request.method()) {
        let allowed = methods.iter().map(|method| method.as_str()).collect::<Vec<_>>().join(", ");
        let error = format!("{path} does not support {}; expected {allowed}", request.method());
        return Err(HttpError { status: StatusCode::METHOD_NOT_ALLOWED, error, allowed: Some(allowed) });
    }
    Ok(())
}

/// Restarts the gripper once this request is answered.
fn restart(hub: &Arc<Hub>) -> Result<(), HttpError> {
    settings(hub)?;
    let hub = Arc::clone(hub);
    spawn_local(async move {
        sleep(RESTART_DELAY).await;
        hub.restart();
    });
    Ok(())
}

/// Reads and parses the body of a request.
async fn read<T: for<'a> Deserialize<'a>>(
    request: Request<Incoming>,
    expected: &str,
) -> Result<T, HttpError> {
    read_up_to(request, MAX_BODY_LEN, expected).await
}

/// The same for a body of at most this length.
async fn read_up_to<T: for<'a> Deserialize<'a>>(
    request: Request<Incoming>,
    limit: usize,
    expected: &str,
) -> Result<T, HttpError> {
    let body = match Limited::new(request.into_body(), limit).collect().await {
        Ok(body) => body.to_bytes(),
        Err(error) if error.is::<LengthLimitError>() => {
            let error = format!("the body is too long; expected at most {limit} bytes");
            return Err(HttpError::new(StatusCode::PAYLOAD_TOO_LARGE, error));
        }
        Err(error) => {
            return Err(HttpError::wrong(format!("the body was not received: {error}; expected {expected}")));
        }
    };
    serde_json::from_slice(&body)
        .map_err(|error| HttpError::wrong(format!("the body is invalid: {error}; expected {expected}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::pending;
    use tokio::task::LocalSet;

    #[tokio::test]
    async fn oldest_open_connection_is_displaced() {
        let mut connections = Connections::default();
        let held = Rc::new(());
        let open = |count: usize, connections: &mut Connections| {
            for _ in 0..count {
                let held = Rc::clone(&held);
                connections.open(Link::new(), MAX_CONNECTIONS, async move {
                    let _held = held;
                    pending().await
                });
            }
        };
        let local = LocalSet::new();
        let all = local.run_until(async {
            connections.open(Link::new(), MAX_CONNECTIONS, async {});
            open(MAX_CONNECTIONS - 1, &mut connections);
            yield_now().await;
            open(1, &mut connections);
            yield_now().await;
            assert_eq!(Rc::strong_count(&held) - 1, MAX_CONNECTIONS, "the first one was over");
            let oldest = connections.0[0].1.abort_handle();
            open(1, &mut connections);
            yield_now().await;
            assert!(oldest.is_finished());
            assert_eq!(Rc::strong_count(&held) - 1, MAX_CONNECTIONS);
        });
        all.await;
    }
}
