//! The control interface: operation of the gripper over HTTP with JSON, and a page that shows it. `docs/simulator.md`
//! is the user documentation.
//!
//! Each connection serves one request. Size, time and number of requests are bounded. Event streams are unlimited in
//! time, but bounded in number and backlog. `Host` and `Origin` decide who may send requests: the browser sets them,
//! and a web page cannot.

mod commands;
mod events;
mod page;

use super::accept::{Accepted, Acceptor};
use super::faulty_line::{Direction, LineCounts, LineFaults};
use super::hub::{Hub, Report};
use crate::axis::Part;
use crate::faults::Fault;
use crate::finger::{Finger, Jaw};
use anyhow::Result;
use commands::{COMMAND_EXPECTED, CommandBody};
use events::{Events, Link, MAX_STREAMS, Watchers, event};
use http_body_util::{BodyExt, Either, Full, LengthLimitError, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::{
    ALLOW, CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, HOST, HeaderMap, HeaderName, HeaderValue,
    ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::http::uri::Authority;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::TokioIo;
use serde::{Deserialize, Serialize};
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
use wsg_fieldbus::{CommandFlags, GripperFlags};
use wsg_protocol::{Status, SystemFlags};

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
/// Interval of the heartbeat to pages while nothing changes.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// How long a rejected connection may take to read the reason.
const REFUSAL_TIME: Duration = Duration::from_millis(100);
/// The reason: the system has no file descriptor left to serve the connection.
const NO_ROOM: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/json\r\nContent-Length: 65\r\n\
    Cache-Control: no-store\r\nConnection: close\r\nRetry-After: 1\r\n\r\n\
    {\"error\":\"the system has no descriptor left; close connections\"}\n";

const PART_EXPECTED: &str = r#"{"width_mm":20.0,"stiffness_n_per_mm":100.0} with numbers above 0 (the stiffness is optional), or null for no part"#;
const FAULT_EXPECTED: &str =
    r#"{"fault":"axis_blocked","on":true}, and "finger":1 or "finger":2 with the faults of a finger"#;
const LINE_EXPECTED: &str = r#"rates from 0 to 1, such as {"drop":0.01,"corrupt":0.01,"truncate":0.01,"duplicate":0.01,"delay":0.01,"delay_ms":50}, where delay_ms is at most 60000 and omitted values are 0, and "direction":"requests", "replies" or "both""#;

/// Serves the listener. `names` are the hosts accepted in requests, in addition to this machine's own address and
/// `localhost`.
pub(super) async fn serve(hub: Arc<Hub>, listener: TcpListener, names: Vec<String>) -> Result<()> {
    let names: Rc<[String]> = names.into();
    let watchers = Rc::new(Watchers::default());
    spawn_local(publish(Arc::clone(&hub), Rc::clone(&watchers)));
    let mut connections = Connections::default();
    let mut acceptor = Acceptor::new(listener);
    loop {
        match acceptor.accept().await {
            Accepted::Client(stream, _) => {
                let link = Link::new();
                let site =
                    Site { hub: Arc::clone(&hub), names: Rc::clone(&names), watchers: Rc::clone(&watchers) };
                connections.open(Rc::clone(&link), async move {
                    tokio::select! {
                        // Ends a connection that does not speak HTTP.
                        _ = serve_connection(site, Rc::clone(&link), stream) => {}
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
}

/// Ready when a connection has lasted too long: a request exceeds the time limit, or a stream is no longer read.
async fn run_out(link: &Link) {
    sleep(TIME_LIMIT).await;
    if link.streams() {
        link.is_given_up().await;
    }
}

/// Sends changes of the state to pages while any are open.
async fn publish(hub: Arc<Hub>, watchers: Rc<Watchers>) {
    loop {
        watchers.come().await;
        hub.watch_log(true);
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut told = (String::new(), Instant::now());
        while !watchers.are_none() {
            ticks.tick().await;
            let report = hub.report();
            let body = StateBody { time_s: None, ..StateBody::of(&hub, &report) };
            // The body contains nothing that JSON cannot represent.
            let state = serde_json::to_string(&body).unwrap_or_default();
            if state != told.0 || told.1.elapsed() >= HEARTBEAT {
                let time_s = report.now.as_micros() as f64 / 1e6;
                watchers.send(&event("state", &format!("{{\"time_s\":{time_s},\"state\":{state}}}")));
                told = (state, Instant::now());
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
    /// Adds a connection. If there are too many, drops the oldest: it has had the most time for its request, and a
    /// complete request has been answered already.
    fn open(&mut self, link: Rc<Link>, connection: impl Future<Output = ()> + 'static) {
        let Self(open) = self;
        open.retain(|(_, connection)| !connection.is_finished());
        // Streams have their own limit.
        let asks = |(link, _): &(Rc<Link>, JoinHandle<()>)| !link.streams();
        if open.iter().filter(|connection| asks(connection)).count() >= MAX_CONNECTIONS
            && let Some((_, oldest)) = open.iter().position(asks).and_then(|at| open.remove(at))
        {
            oldest.abort();
        }
        open.push_back((link, spawn_local(connection)));
    }
}

async fn serve_connection(site: Site, link: Rc<Link>, stream: TcpStream) -> Result<()> {
    let here = stream.local_addr()?.ip().to_canonical();
    let service = service_fn(move |request| answer(site.clone(), Rc::clone(&link), here, request));
    let served = http1::Builder::new()
        .keep_alive(false)
        .max_buf_size(MAX_HEAD_LEN)
        .serve_connection(TokioIo::new(stream), service);
    Ok(served.await?)
}

type Answer = Response<Either<Full<Bytes>, Events>>;

async fn answer(
    site: Site,
    link: Rc<Link>,
    here: IpAddr,
    request: Request<Incoming>,
) -> Result<Answer, Infallible> {
    let answer = async {
        check_host(request.headers(), here, &site.names)?;
        check_origin(request.headers())?;
        act(&site, link, request).await
    };
    let mut response = answer.await.unwrap_or_else(|HttpError { status, error, allowed }| {
        let mut response = json(&serde_json::json!({ "error": error }).to_string());
        *response.status_mut() = status;
        if let Some(method) = allowed {
            response.headers_mut().insert(ALLOW, HeaderValue::from_static(method));
        }
        response
    });
    for (name, value) in PRIVATE {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    Ok(response)
}

/// Headers of every answer: no caching, no content sniffing, no referrer.
const PRIVATE: [(HeaderName, &str); 3] =
    [(CACHE_CONTROL, "no-store"), (X_CONTENT_TYPE_OPTIONS, "nosniff"), (REFERRER_POLICY, "no-referrer")];

fn json(body: &str) -> Answer {
    whole(format!("{body}\n"), HeaderValue::from_static("application/json"))
}

fn whole(body: String, content_type: HeaderValue) -> Answer {
    let mut response = Response::new(Either::Left(Full::new(Bytes::from(body))));
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    response
}

/// Returns the state of gripper and lines.
fn state(hub: &Hub) -> Result<Answer, HttpError> {
    let report = hub.report();
    let body = serde_json::to_string(&StateBody::of(hub, &report));
    let body = body.map_err(|error| HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    Ok(json(&body))
}

/// Returns the page itself.
fn show_page() -> Result<Answer, HttpError> {
    let (page, policy) = page::page();
    let mut response = whole(page, HeaderValue::from_static("text/html; charset=utf-8"));
    let policy = HeaderValue::from_str(&policy)
        .map_err(|error| HttpError::new(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()))?;
    response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy);
    Ok(response)
}

/// Returns the event stream of a page, which begins with its static data.
fn show_events(site: &Site, link: Rc<Link>) -> Result<Answer, HttpError> {
    let hello = HelloBody::of(&site.hub);
    let hello = serde_json::to_string(&hello).unwrap_or_default();
    let events = site.watchers.open(event("hello", &hello), link).ok_or_else(|| {
        let error = format!("{MAX_STREAMS} pages are open already; close one of them first");
        HttpError::new(StatusCode::SERVICE_UNAVAILABLE, error)
    })?;
    let mut response = Response::new(Either::Right(events));
    response.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    Ok(response)
}

/// A rejected request, with a reason for its sender.
#[derive(Debug)]
struct HttpError {
    status: StatusCode,
    error: String,
    /// The method that the path supports, for the header `Allow`.
    allowed: Option<&'static str>,
}

impl HttpError {
    const fn new(status: StatusCode, error: String) -> Self {
        Self { status, error, allowed: None }
    }

    const fn wrong(error: String) -> Self {
        Self::new(StatusCode::BAD_REQUEST, error)
    }
}

/// Rejects a request for another host. With DNS rebinding, a browser treats the attacker's page as same-origin, and
/// only `Host` reveals it. The port is not checked, because it may be forwarded.
fn check_host(headers: &HeaderMap, here: IpAddr, names: &[String]) -> Result<(), HttpError> {
    let mut hosts = headers.get_all(HOST).iter();
    let (Some(host), None) = (hosts.next(), hosts.next()) else {
        return Err(HttpError::wrong("expected exactly one Host header".to_owned()));
    };
    let authority = Authority::try_from(host.as_bytes());
    let name = authority.as_ref().map_or("", Authority::host);
    let name = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    let is_address = |address: IpAddr| {
        let address = address.to_canonical();
        address.is_loopback() || address == here
    };
    let is_name = |known: &String| known.eq_ignore_ascii_case(name);
    if name.eq_ignore_ascii_case("localhost")
        || name.parse().is_ok_and(is_address)
        || names.iter().any(is_name)
    {
        return Ok(());
    }
    let host = String::from_utf8_lossy(host.as_bytes());
    let error =
        format!("the request is for the host {host:?}; expected localhost, {here} or one of --control-host");
    Err(HttpError::new(StatusCode::MISDIRECTED_REQUEST, error))
}

/// Rejects a request from a web page other than this server's own. Programs do not send `Origin`.
fn check_origin(headers: &HeaderMap) -> Result<(), HttpError> {
    let mut origins = headers.get_all(ORIGIN).iter();
    let Some(origin) = origins.next() else { return Ok(()) };
    let host = headers.get(HOST).map_or(&[][..], HeaderValue::as_bytes);
    let is_own = origin
        .as_bytes()
        .strip_prefix(b"http://")
        .is_some_and(|authority| authority.eq_ignore_ascii_case(host));
    if is_own && origins.next().is_none() {
        return Ok(());
    }
    // Without this check, any page in a browser on this machine could stop the gripper.
    let error = "the Origin header names another web page; expected a request from this server's own page or \
                 from a program";
    Err(HttpError::new(StatusCode::FORBIDDEN, error.to_owned()))
}

/// Each path and its method.
const PATHS: [(&str, Method); 7] = [
    ("/", Method::GET),
    ("/events", Method::GET),
    ("/state", Method::GET),
    ("/command", Method::POST),
    ("/part", Method::POST),
    ("/fault", Method::POST),
    ("/line", Method::POST),
];

/// Executes the request. The answer is the state, except for the page and its events.
async fn act(site: &Site, link: Rc<Link>, request: Request<Incoming>) -> Result<Answer, HttpError> {
    let hub = &site.hub;
    let path = request.uri().path().to_owned();
    let Some((_, method)) = PATHS.iter().find(|(known, _)| *known == path) else {
        let known = PATHS.map(|(path, method)| format!("{method} {path}")).join(", ");
        let error = format!("the path {path:?} is unknown; expected one of {known}");
        return Err(HttpError::new(StatusCode::NOT_FOUND, error));
    };
    if request.method() != method {
        let error = format!("{path} does not support {}; expected {method}", request.method());
        let allowed = Some(if *method == Method::GET { "GET" } else { "POST" });
        return Err(HttpError { status: StatusCode::METHOD_NOT_ALLOWED, error, allowed });
    }
    match path.as_str() {
        "/" => return show_page(),
        "/events" => return show_events(site, link),
        "/command" => command(hub, &read(request, COMMAND_EXPECTED).await?)?,
        "/part" => hub.set_part(part(read(request, PART_EXPECTED).await?)?),
        "/fault" => {
            let FaultBody { fault, finger, on } = read(request, FAULT_EXPECTED).await?;
            hub.set_fault(which_fault(hub, fault, finger)?, on);
        }
        "/line" => hub.set_line_faults(line_faults(&read(request, LINE_EXPECTED).await?)?),
        _ => {}
    }
    state(hub)
}

/// Executes the command of a button. The gripper may reject it.
fn command(hub: &Hub, body: &CommandBody) -> Result<(), HttpError> {
    let commands = body.commands(hub.config()).ok_or_else(|| {
        HttpError::wrong(format!("the command has missing or invalid numbers; expected {COMMAND_EXPECTED}"))
    })?;
    for command in &commands {
        let status = hub.command(command);
        if !matches!(status, Status::Success | Status::CmdPending) {
            let error = format!("the gripper refuses {command}: {status}");
            return Err(HttpError::new(StatusCode::CONFLICT, error));
        }
    }
    Ok(())
}

/// Reads and parses the body of a request.
async fn read<T: for<'a> Deserialize<'a>>(
    request: Request<Incoming>,
    expected: &str,
) -> Result<T, HttpError> {
    let body = match Limited::new(request.into_body(), MAX_BODY_LEN).collect().await {
        Ok(body) => body.to_bytes(),
        Err(error) if error.is::<LengthLimitError>() => {
            let error = format!("the body is too long; expected at most {MAX_BODY_LEN} bytes");
            return Err(HttpError::new(StatusCode::PAYLOAD_TOO_LARGE, error));
        }
        Err(error) => {
            return Err(HttpError::wrong(format!("the body was not received: {error}; expected {expected}")));
        }
    };
    serde_json::from_slice(&body)
        .map_err(|error| HttpError::wrong(format!("the body is invalid: {error}; expected {expected}")))
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct PartBody {
    width_mm: f32,
    stiffness_n_per_mm: Option<f32>,
}

fn part(body: Option<PartBody>) -> Result<Option<Part>, HttpError> {
    let Some(PartBody { width_mm, stiffness_n_per_mm }) = body else { return Ok(None) };
    let stiffness = stiffness_n_per_mm.unwrap_or(Part::DEFAULT_STIFFNESS);
    Part::new(width_mm, stiffness).map(Some).ok_or_else(|| {
        HttpError::wrong(format!(
            "a part {width_mm} mm wide with {stiffness} N/mm is invalid; expected {PART_EXPECTED}"
        ))
    })
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FaultBody {
    fault: FaultName,
    finger: Option<u8>,
    on: bool,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum FaultName {
    AxisBlocked,
    OverTemperature,
    SupplyOutOfRange,
    MotorCurrent,
    FingerShortCircuit,
    FingerCommunication,
}

fn which_fault(hub: &Hub, name: FaultName, finger: Option<u8>) -> Result<Fault, HttpError> {
    let of_a_finger = |fault: fn(Jaw) -> Fault, is_possible: fn(Finger) -> bool, needs: &str| {
        let [one, two] = hub.config().fingers;
        let (jaw, mounted) = match finger {
            Some(1) => (Jaw::One, one),
            Some(2) => (Jaw::Two, two),
            Some(other) => {
                return Err(HttpError::wrong(format!("there is no finger {other}; expected 1 or 2")));
            }
            None => {
                return Err(HttpError::wrong(format!(
                    "the fault requires a finger; expected {FAULT_EXPECTED}"
                )));
            }
        };
        if is_possible(mounted) {
            return Ok(fault(jaw));
        }
        let error =
            format!("the finger is {:?}, which cannot have this fault; expected {needs}", mounted.name());
        Err(HttpError::new(StatusCode::CONFLICT, error))
    };
    let fault = match name {
        FaultName::AxisBlocked => Fault::AxisBlocked,
        FaultName::OverTemperature => Fault::OverTemperature,
        FaultName::SupplyOutOfRange => Fault::SupplyOutOfRange,
        FaultName::MotorCurrent => Fault::MotorCurrent,
        FaultName::FingerShortCircuit => {
            let is_possible = |finger| finger != Finger::None;
            return of_a_finger(Fault::FingerShortCircuit, is_possible, "generic, fmf or dsa");
        }
        FaultName::FingerCommunication => {
            let is_possible = |finger| matches!(finger, Finger::Fmf | Finger::Dsa);
            return of_a_finger(Fault::FingerCommunication, is_possible, "fmf or dsa");
        }
    };
    match finger {
        None => Ok(fault),
        Some(_) => Err(HttpError::wrong(
            "the fault does not concern a finger; expected it without \"finger\"".to_owned(),
        )),
    }
}

#[derive(Debug, Default, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
struct LineBody {
    direction: DirectionName,
    drop: f64,
    delay: Option<f64>,
    delay_ms: Option<u32>,
    corrupt: f64,
    truncate: f64,
    duplicate: f64,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, Serialize)]
#[serde(rename_all = "snake_case")]
enum DirectionName {
    Requests,
    Replies,
    #[default]
    Both,
}

/// Returns the requested faults. A delay without a rate hits every frame.
fn line_faults(body: &LineBody) -> Result<LineFaults, HttpError> {
    let LineBody { direction, drop, delay, delay_ms, corrupt, truncate, duplicate } = *body;
    if delay.is_some_and(|rate| rate > 0.0) && delay_ms.is_none() {
        return Err(HttpError::wrong(format!("delay lacks delay_ms; expected {LINE_EXPECTED}")));
    }
    let delay_ms = delay_ms.unwrap_or(0);
    let delay = delay.unwrap_or(if delay_ms > 0 { 1.0 } else { 0.0 });
    for (name, rate) in [
        ("drop", drop),
        ("delay", delay),
        ("corrupt", corrupt),
        ("truncate", truncate),
        ("duplicate", duplicate),
    ] {
        if !(0.0..=1.0).contains(&rate) {
            return Err(HttpError::wrong(format!("{name} is {rate}; expected {LINE_EXPECTED}")));
        }
    }
    if delay_ms > LineFaults::MAX_DELAY_MS {
        return Err(HttpError::wrong(format!("delay_ms is {delay_ms}; expected {LINE_EXPECTED}")));
    }
    let direction = match direction {
        DirectionName::Requests => Direction::Requests,
        DirectionName::Replies => Direction::Replies,
        DirectionName::Both => Direction::Both,
    };
    Ok(LineFaults { direction, drop, delay, delay_ms, corrupt, truncate, duplicate })
}

/// The answer to every accepted request.
#[derive(Debug, Serialize)]
struct StateBody<'a> {
    model: &'static str,
    /// Omitted when the enclosing event already contains it.
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
    width_mm: f32,
    reported_width_mm: f32,
    speed_mm_per_s: f32,
    force_n: f32,
    force_limit_n: f32,
    gripper_state: String,
    system_state: Vec<&'static str>,
    temperature_c: f32,
    gripping_statistics: StatisticsBody,
    part: Option<PartBody>,
    part_is_between: bool,
    fieldbus: FieldbusBody,
    faults: Vec<ActiveFaultBody>,
    line: LineBody,
    line_counts: LineCountsByDirection,
    clients: Vec<ClientBody<'a>>,
}

/// The static data that a page receives first.
#[derive(Debug, Serialize)]
struct HelloBody {
    model: &'static str,
    limits: LimitsBody,
    names: NamesBody,
}

#[derive(Debug, Serialize)]
struct LimitsBody {
    stroke_mm: f32,
    min_speed_mm_per_s: f32,
    max_speed_mm_per_s: f32,
    min_force_n: f32,
    nominal_force_n: f32,
    overdrive_force_n: f32,
}

/// The name of each bit, lowest first; empty if undefined.
#[derive(Debug, Serialize)]
struct NamesBody {
    command: Vec<&'static str>,
    gripper: Vec<&'static str>,
    system: Vec<&'static str>,
}

impl HelloBody {
    fn of(hub: &Hub) -> Self {
        let model = hub.config().model;
        let limits = &model.parameters().limits;
        let names_by_bit = |names: &mut dyn Iterator<Item = (&'static str, u32)>| {
            let mut by_bit = vec![""; 8];
            for (name, bits) in names {
                let at = bits.trailing_zeros() as usize;
                by_bit.resize(by_bit.len().max(at + 1), "");
                by_bit[at] = name;
            }
            by_bit
        };
        Self {
            model: model.name(),
            limits: LimitsBody {
                stroke_mm: limits.stroke,
                min_speed_mm_per_s: limits.min_speed,
                max_speed_mm_per_s: limits.max_speed,
                min_force_n: limits.min_force,
                nominal_force_n: limits.nominal_force,
                overdrive_force_n: limits.overdrive_force,
            },
            names: NamesBody {
                command: names_by_bit(
                    &mut CommandFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into())),
                ),
                gripper: names_by_bit(
                    &mut GripperFlags::all().iter_names().map(|(name, flag)| (name, flag.bits().into())),
                ),
                system: names_by_bit(
                    &mut SystemFlags::all().iter_names().map(|(name, flag)| (name, flag.bits())),
                ),
            },
        }
    }
}

/// Both images, byte by byte (fieldbus, 5).
#[derive(Debug, Serialize)]
struct FieldbusBody {
    output: [u8; 8],
    input: [u8; 12],
    status: String,
}

#[derive(Debug, Serialize)]
struct StatisticsBody {
    total: u32,
    no_part: u16,
    part_lost: u16,
}

#[derive(Debug, Serialize)]
struct ActiveFaultBody {
    fault: FaultName,
    #[serde(skip_serializing_if = "Option::is_none")]
    finger: Option<u8>,
}

#[derive(Debug, Serialize)]
struct LineCountsByDirection {
    requests: LineCountsBody,
    replies: LineCountsBody,
}

#[derive(Debug, Serialize)]
struct LineCountsBody {
    frames: u64,
    dropped: u64,
    delayed: u64,
    corrupted: u64,
    truncated: u64,
    duplicated: u64,
}

#[derive(Debug, Serialize)]
struct ClientBody<'a> {
    name: &'a str,
    bytes_dropped: u16,
    bad_checksums: u16,
    too_long: u16,
    updates_lost: u32,
    replies_lost: u32,
}

impl LineCountsBody {
    const fn of(counts: &LineCounts) -> Self {
        let LineCounts { frames, dropped, delayed, corrupted, truncated, duplicated } = *counts;
        Self { frames, dropped, delayed, corrupted, truncated, duplicated }
    }
}

impl<'a> StateBody<'a> {
    fn of(hub: &Hub, report: &'a Report) -> Self {
        let Report {
            now,
            state,
            images: (output, input),
            faults,
            line_faults,
            request_counts,
            reply_counts,
            clients,
        } = report;
        let LineFaults { direction, drop, delay, delay_ms, corrupt, truncate, duplicate } = *line_faults;
        Self {
            model: hub.config().model.name(),
            time_s: Some(now.as_micros() as f64 / 1e6),
            width_mm: state.width,
            reported_width_mm: state.reported_width,
            speed_mm_per_s: state.speed,
            force_n: state.force,
            force_limit_n: state.force_limit,
            gripper_state: state.gripper.to_string(),
            system_state: flag_names(state.flags),
            temperature_c: f32::from(state.temperature.0) / 10.0,
            gripping_statistics: StatisticsBody {
                total: state.statistics.total,
                no_part: state.statistics.no_part,
                part_lost: state.statistics.part_lost,
            },
            part: state
                .part
                .map(|part| PartBody { width_mm: part.width(), stiffness_n_per_mm: Some(part.stiffness()) }),
            part_is_between: state.part_is_between,
            fieldbus: FieldbusBody {
                output: output.to_bytes(),
                input: input.to_bytes(),
                status: input.status.to_string(),
            },
            faults: faults.iter().map(active_fault).collect(),
            line: LineBody {
                direction: match direction {
                    Direction::Requests => DirectionName::Requests,
                    Direction::Replies => DirectionName::Replies,
                    Direction::Both => DirectionName::Both,
                },
                drop,
                delay: Some(delay),
                delay_ms: Some(delay_ms),
                corrupt,
                truncate,
                duplicate,
            },
            line_counts: LineCountsByDirection {
                requests: LineCountsBody::of(request_counts),
                replies: LineCountsBody::of(reply_counts),
            },
            clients: clients
                .iter()
                .map(|(name, counters)| ClientBody {
                    name,
                    bytes_dropped: counters.parser.dropped,
                    bad_checksums: counters.parser.bad_checksum,
                    too_long: counters.parser.oversize,
                    updates_lost: counters.updates_lost,
                    replies_lost: counters.replies_lost,
                })
                .collect(),
        }
    }
}

fn flag_names(flags: SystemFlags) -> Vec<&'static str> {
    flags.iter_names().map(|(name, _)| name).collect()
}

fn active_fault(fault: &Fault) -> ActiveFaultBody {
    let number = |jaw: &Jaw| Some(if *jaw == Jaw::One { 1 } else { 2 });
    let (fault, finger) = match fault {
        Fault::AxisBlocked => (FaultName::AxisBlocked, None),
        Fault::OverTemperature => (FaultName::OverTemperature, None),
        Fault::SupplyOutOfRange => (FaultName::SupplyOutOfRange, None),
        Fault::MotorCurrent => (FaultName::MotorCurrent, None),
        Fault::FingerShortCircuit(jaw) => (FaultName::FingerShortCircuit, number(jaw)),
        Fault::FingerCommunication(jaw) => (FaultName::FingerCommunication, number(jaw)),
    };
    ActiveFaultBody { fault, finger }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::future::pending;
    use tokio::task::LocalSet;

    #[tokio::test]
    async fn oldest_connection_gives_way_and_one_that_is_over_counts_no_more() {
        let mut connections = Connections::default();
        let held = Rc::new(());
        let open = |count: usize, connections: &mut Connections| {
            for _ in 0..count {
                let held = Rc::clone(&held);
                connections.open(Link::new(), async move {
                    let _held = held;
                    pending().await
                });
            }
        };
        let local = LocalSet::new();
        let all = local.run_until(async {
            connections.open(Link::new(), async {});
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

    #[test]
    fn requests_are_for_this_machine_or_a_name_that_is_known() {
        let here: IpAddr = "192.168.1.7".parse().unwrap();
        let names = ["Bench.example".to_owned(), "203.0.113.9".to_owned()];
        let status = |hosts: &[&str]| {
            let mut headers = HeaderMap::new();
            for host in hosts {
                headers.append(HOST, HeaderValue::from_str(host).unwrap());
            }
            check_host(&headers, here, &names).map_err(|refused| refused.status.as_u16())
        };
        for host in [
            "localhost",
            "LocalHost:9",
            "127.0.0.1",
            "127.8.7.6:8080",
            "[::1]",
            "[::1]:8080",
            "[::ffff:127.0.0.1]",
            "192.168.1.7",
            "192.168.1.7:8080",
            "bench.example:8080",
            "203.0.113.9:80",
        ] {
            assert_eq!(status(&[host]), Ok(()), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "192.168.1.8",
            "[fe80::1]",
            "0.0.0.0",
            "",
            ":8080",
            "local host",
            "[localhost",
        ] {
            assert_eq!(status(&[host]), Err(421), "{host}");
        }
        assert_eq!(status(&[]), Err(400));
        assert_eq!(status(&["localhost", "evil.example"]), Err(400));
    }
}
