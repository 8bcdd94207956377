//! Who may send requests: the `Host` and `Origin` checks.

use crate::control::HttpError;
use hyper::StatusCode;
use hyper::header::{HOST, HeaderMap, HeaderValue, ORIGIN};
use hyper::http::uri::Authority;
use std::net::IpAddr;

/// Rejects a request for another host. With DNS rebinding, a browser treats the attacker's page as same-origin, and
/// only `Host` reveals it. The port is not checked, because it may be forwarded. `or_names` describes the names in a message.
pub(super) fn check_host(
    headers: &HeaderMap,
    here: IpAddr,
    names: &[String],
    or_names: &str,
) -> Result<(), HttpError> {
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
    let error = format!("the header Host is {host:?}; expected localhost, {here}{or_names}");
    Err(HttpError::new(StatusCode::MISDIRECTED_REQUEST, error))
}

/// Rejects a request from a web page other than this server's own. Programs do not send `Origin`.
pub(super) fn check_origin(headers: &HeaderMap) -> Result<(), HttpError> {
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
    let [origin, host] = [origin.as_bytes(), host].map(String::from_utf8_lossy);
    let error = format!(
        "the header Origin is {origin:?}; expected \"http://{host}\", the header Host of the request after http://: \
         only this server's own page and programs may send requests, and a proxy must forward the browser's Host"
    );
    Err(HttpError::new(StatusCode::FORBIDDEN, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_for_this_machine_or_a_name_that_is_known() {
        let here: IpAddr = "192.168.1.7".parse().unwrap();
        let names = ["Bench.example".to_owned(), "203.0.113.9".to_owned()];
        let status = |hosts: &[&str]| {
            let mut headers = HeaderMap::new();
            for host in hosts {
                headers.append(HOST, HeaderValue::from_str(host).unwrap());
            }
            check_host(&headers, here, &names, "").map_err(|refused| refused.status)
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
