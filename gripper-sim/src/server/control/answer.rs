//! Answers of the control interface, and the reasons of rejected requests.

use super::events::Events;
use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::header::{
    ALLOW, CACHE_CONTROL, CONNECTION, CONTENT_TYPE, HeaderName, HeaderValue, REFERRER_POLICY,
    X_CONTENT_TYPE_OPTIONS,
};
use hyper::{Response, StatusCode};

pub(super) type Answer = Response<Either<Full<Bytes>, Events>>;

/// Headers of every answer: no caching, no content sniffing, no referrer.
const PRIVATE: [(HeaderName, &str); 3] =
    [(CACHE_CONTROL, "no-store"), (X_CONTENT_TYPE_OPTIONS, "nosniff"), (REFERRER_POLICY, "no-referrer")];

/// Returns the answer, or the reason of a rejection, with the headers of every answer.
pub(super) fn finished(answer: Result<Answer, HttpError>) -> Answer {
    let mut response = answer.unwrap_or_else(|HttpError { status, error, allowed }| {
        let mut response = json(&serde_json::json!({ "error": error }).to_string());
        *response.status_mut() = status;
        if let Some(method) = allowed.and_then(|allowed| HeaderValue::from_str(&allowed).ok()) {
            response.headers_mut().insert(ALLOW, method);
        }
        response
    });
    for (name, value) in PRIVATE {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    if response.status() != StatusCode::SWITCHING_PROTOCOLS {
        response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    }
    response
}

pub(super) fn json(body: &str) -> Answer {
    whole(format!("{body}\n"), HeaderValue::from_static("application/json"))
}

pub(super) fn whole(body: String, content_type: HeaderValue) -> Answer {
    let mut response = Response::new(Either::Left(Full::new(Bytes::from(body))));
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    response
}

/// A rejected request, with a reason for its sender.
#[derive(Debug)]
pub(super) struct HttpError {
    pub(super) status: StatusCode,
    pub(super) error: String,
    /// The methods that the path supports, for the header `Allow`.
    pub(super) allowed: Option<String>,
}

impl HttpError {
    pub(super) const fn new(status: StatusCode, error: String) -> Self {
        Self { status, error, allowed: None }
    }

    pub(super) const fn wrong(error: String) -> Self {
        Self::new(StatusCode::BAD_REQUEST, error)
    }
}
