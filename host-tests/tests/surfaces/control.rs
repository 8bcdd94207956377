//! The control interface of the virtual gripper: one HTTP request for each verb.

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};

use crate::station::BOUND;
use crate::surface::{Outcome, SPEED, Separately, Surface, Verb};

pub(crate) fn control(address: SocketAddr) -> Box<dyn Surface> {
    Box::new(Separately(move |verb| request(address, verb)))
}

fn request(address: SocketAddr, verb: Verb) -> Outcome {
    let body = match verb {
        Verb::Read => return http(address, "GET", "/state", "").map(|state| state.1),
        Verb::Home => r#"{"command":"home"}"#.to_owned(),
        Verb::Move(width) => format!(r#"{{"command":"move","width_mm":{width},"speed_mm_per_s":{SPEED}}}"#),
        Verb::Grip(width, force) => {
            format!(r#"{{"command":"grip","width_mm":{width},"speed_mm_per_s":{SPEED},"force_n":{force}}}"#)
        }
        Verb::FastStop => r#"{"command":"fast_stop"}"#.to_owned(),
        Verb::Acknowledge => r#"{"command":"acknowledge"}"#.to_owned(),
    };
    let mut path = "/command".to_owned();
    if !matches!(verb, Verb::FastStop) {
        // Like a page, it names the state that its user sees.
        let (_, state) = http(address, "GET", "/state", "")?;
        let as_of = state.split(r#""as_of":""#).nth(1).and_then(|rest| rest.split('"').next());
        path = format!("/command?as_of={}", as_of.ok_or("a state without as_of")?);
    }
    let (status, answer) = http(address, "POST", &path, &body)?;
    if status == 200 { Ok(answer) } else { Err(format!("{status} {answer}")) }
}

fn http(address: SocketAddr, method: &str, path: &str, body: &str) -> Result<(u16, String), String> {
    let exchange = || -> std::io::Result<String> {
        let mut stream = TcpStream::connect(address)?;
        stream.set_read_timeout(Some(BOUND))?;
        let length = body.len();
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
             Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
        )?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer)?;
        Ok(answer)
    };
    let answer = exchange().map_err(|error| error.to_string())?;
    let (head, body) = answer.split_once("\r\n\r\n").ok_or("no answer")?;
    let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).ok_or("no status")?;
    Ok((status, body.to_owned()))
}
