//! Answers of the control interface, and the reasons of rejected requests.

use super::events::Events;
use crate::control::json::object;
use crate::control::{self, HttpError};
use http_body_util::{Either, Full};
use hyper::body::Bytes;
use hyper::header::{
    ALLOW, CACHE_CONTROL, CONNECTION, CONTENT_DISPOSITION, CONTENT_TYPE, HeaderName, HeaderValue,
    REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
};
use hyper::{Response, StatusCode};

pub(super) type Answer = Response<Either<Full<Bytes>, Events>>;

/// Headers of every answer: no caching, no content sniffing, no referrer.
const PRIVATE: [(HeaderName, &str); 3] =
    [(CACHE_CONTROL, "no-store"), (X_CONTENT_TYPE_OPTIONS, "nosniff"), (REFERRER_POLICY, "no-referrer")];

/// Returns the answer, or the reason of a rejection, with the headers of every answer.
pub(super) fn finished(answer: Result<Answer, HttpError>) -> Answer {
    let mut response = answer.unwrap_or_else(|HttpError { status, error, allowed }| {
        let json = object! { "error": error };
        let mut response = of_control(control::Answer::of_json(json));
        *response.status_mut() = StatusCode::from_u16(status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
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

/// Returns an answer of the control interface.
pub(super) fn of_control(answer: control::Answer) -> Answer {
    match answer {
        control::Answer::Json(json) => whole(json, HeaderValue::from_static("application/json")),
        control::Answer::LogFile(text) => {
            file(text, HeaderValue::from_static("attachment; filename=\"wsg-system-log.txt\""))
        }
    }
}

/// Returns a text that a browser saves as a file.
pub(super) fn file(text: String, disposition: HeaderValue) -> Answer {
    let mut response = whole(text, HeaderValue::from_static("text/plain; charset=utf-8"));
    response.headers_mut().insert(CONTENT_DISPOSITION, disposition);
    response
}

pub(super) fn whole(body: String, content_type: HeaderValue) -> Answer {
    let mut response = Response::new(Either::Left(Full::new(Bytes::from(body))));
    response.headers_mut().insert(CONTENT_TYPE, content_type);
    response
}
