//! Answers of the control interface, and the reasons of rejected requests.

use super::events::Events;
use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::{Response, StatusCode};

pub(super) type Answer = Response<Either<Full<Bytes>, Events>>;

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
