//! The control interface: operation of the gripper over HTTP with JSON, and a page that shows it. `docs/simulator.md`
//! is the user documentation.
//!
//! Each connection serves one request, or is the WebSocket of a page. Size, time and number of requests are bounded.
//! Streams are unlimited in time, but bounded in number and backlog. `Host` and `Origin` decide who may send requests: the
//! browser sets them, and a web page cannot.

mod access;
mod age;
mod answer;
mod documents;
mod events;
mod page;
mod peer;
mod read_only;
mod scripts;
mod socket;

use super::hub::Hub;
use super::open_line::{Listen, OpenLine};
use crate::control::json::{self, Json, body, object};
use crate::control::{
    Action, Bench, Changes, CommandBody, Effect, Host, HttpError, Publisher, Refused, SettingState, expected,
    hello, parsed, state,
};
use crate::time::Time;
use access::{check_host, check_origin};
use age::{Sender, Stalls, as_of_in};
use answer::{Answer, file, finished, of_control, whole};
use anyhow::Result;
use documents::DOCUMENTS;
use events::{Events, Link, MAX_STREAMS, Watchers, event};
use fieldbus_host::accept::{Accepted, Acceptor};
use http_body_util::{BodyExt, Either, LengthLimitError, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::upgrade::OnUpgrade;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use peer::Peer;
use scripts::ScriptBody;
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
use tokio::time::{Interval, MissedTickBehavior, interval, sleep, timeout};

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
    let stalls = Stalls::new();
    spawn_local(Rc::clone(&stalls).watch());
    spawn_local(record(Arc::clone(&hub)));
    spawn_local(publish(Arc::clone(&hub), Rc::clone(&watchers)));
    let site = Site { hub, names, watchers, stalls };
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
    stalls: Rc<Stalls>,
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

/// Returns the ticks at which the gripper is observed.
fn ticks() -> Interval {
    let mut ticks = interval(PERIOD);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
    ticks
}

/// Samples the gripper for as long as it runs.
async fn record(hub: Arc<Hub>) {
    let mut ticks = ticks();
    loop {
        ticks.tick().await;
        hub.at_bench(Bench::record);
    }
}

/// Sends changes of the state to pages while any are open.
async fn publish(hub: Arc<Hub>, watchers: Rc<Watchers>) {
    let mut publisher = Publisher::default();
    loop {
        watchers.opened().await;
        hub.at_bench(|bench, _| publisher.begin(bench));
        let mut ticks = ticks();
        while !watchers.are_none() {
            ticks.tick().await;
            for (kind, json) in hub.at_bench(|bench, now| publisher.events(bench, now)) {
                watchers.send(&event(kind, &json));
            }
        }
        hub.at_bench(|bench, _| bench.watch_log(false));
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
#[derive(Debug)]
struct MessageBody {
    /// The number that the answer repeats.
    id: u64,
    as_of: Option<String>,
    body: CommandBody,
}
body!(MessageBody: id, as_of, body);

const MESSAGE_EXPECTED: &str = r#"{"id":1,"as_of":"...","body":{"command":"home"}}"#;

/// Executes a command of a page, and returns the event that answers it.
fn answer_message(site: &Site, sender: Sender, message: &str) -> Bytes {
    let parsed: Result<MessageBody, _> = json::read(message.as_bytes());
    let id = parsed.as_ref().ok().map(|message| message.id);
    let answer = parsed
        .map_err(|error| {
            HttpError::wrong(format!("the message is invalid: {error}; expected {MESSAGE_EXPECTED}"))
        })
        .and_then(|MessageBody { as_of, body, .. }| {
            if !body.is_stop() {
                sender.check(&site.hub, &site.stalls, Effect::Moves, as_of.as_deref())?;
            }
            site.hub.at_bench(|bench, now| {
                body.execute(bench, now)?;
                Ok(state(bench, now))
            })
        });
    let (status, body) = match answer {
        Ok(state) => (StatusCode::OK.as_u16(), state),
        Err(HttpError { status, error, .. }) => (status, object! { "error": error }),
    };
    event("answer", &object! { "id": id, "status": status, "body": Json(&body) })
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
    let (kind, json) = site.hub.at_bench(|bench, _| hello(bench));
    site.watchers.open(event(kind, &json), link).ok_or_else(|| {
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
        "/scripts" => {
            let answer = if is_post {
                let body = read(request, scripts::MAX_SCRIPT_BODY_LEN, scripts::SCRIPT_EXPECTED).await?;
                let body: ScriptBody = parsed(&body, scripts::SCRIPT_EXPECTED)?;
                if body.changes() {
                    check_age(Effect::Moves).await?;
                }
                scripts::execute(hub, body)?
            } else {
                scripts::scripts(hub, None)?
            };
            return Ok(of_control(crate::control::Answer::of_json(answer)));
        }
        // Shows a page whose WebSocket does not open whether the server would accept it.
        "/events" if is_post => {
            drop(open_events(site, Link::new())?);
            return Ok(of_control(Action::State.execute(&mut Server(hub))?));
        }
        "/events" => return show_events(site, connection, request),
        _ => {}
    }
    if let Some((_, text)) = DOCUMENTS.iter().find(|(known, _)| *known == path) {
        return Ok(file((*text).to_owned(), HeaderValue::from_static("attachment")));
    }
    let body = match expected(&path) {
        Some(expected) if is_post => Some(read(request, MAX_BODY_LEN, expected).await?),
        _ => is_post.then(Bytes::new),
    };
    let action = Action::of(&hub.config(), &path, body.as_deref())?;
    if let Some(effect) = action.effect() {
        check_age(effect).await?;
    }
    Ok(of_control(action.execute(&mut Server(hub))?))
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
        return Err(HttpError {
            status: StatusCode::METHOD_NOT_ALLOWED.into(),
            error,
            allowed: Some(allowed),
        });
    }
    Ok(())
}

/// The program around the control interface.
struct Server<'a>(&'a Arc<Hub>);

impl Host for Server<'_> {
    fn at_bench<T>(&mut self, act: impl FnOnce(&mut Bench, Time) -> T) -> T {
        self.0.at_bench(act)
    }

    fn settings(&mut self) -> Option<Vec<SettingState>> {
        self.0.settings()
    }

    fn settings_file(&mut self) -> Option<String> {
        self.0.settings_file()
    }

    fn change_settings(&mut self, changes: &Changes) -> Result<(), Refused> {
        self.0.change_settings(changes)
    }

    fn restart(&mut self) {
        let hub = Arc::clone(self.0);
        spawn_local(async move {
            sleep(RESTART_DELAY).await;
            hub.restart();
        });
    }
}

/// Reads the body of a request, of at most `limit` bytes.
async fn read(request: Request<Incoming>, limit: usize, expected: &str) -> Result<Bytes, HttpError> {
    match Limited::new(request.into_body(), limit).collect().await {
        Ok(body) => Ok(body.to_bytes()),
        Err(error) if error.is::<LengthLimitError>() => {
            let error = format!("the body is too long; expected at most {limit} bytes");
            Err(HttpError::new(StatusCode::PAYLOAD_TOO_LARGE, error))
        }
        Err(error) => {
            Err(HttpError::wrong(format!("the body was not received: {error}; expected {expected}")))
        }
    }
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
