//! Answers of the control interface, and the reasons of rejected requests.

use super::json::ToJson;

/// Statuses of HTTP.
pub(crate) mod status {
    pub(crate) const BAD_REQUEST: u16 = 400;
    pub(crate) const NOT_FOUND: u16 = 404;
    pub(crate) const CONFLICT: u16 = 409;
    pub(crate) const PRECONDITION_FAILED: u16 = 412;
    pub(crate) const PRECONDITION_REQUIRED: u16 = 428;
    pub(crate) const INTERNAL_SERVER_ERROR: u16 = 500;
    pub(crate) const NOT_IMPLEMENTED: u16 = 501;
    pub(crate) const SERVICE_UNAVAILABLE: u16 = 503;
}

/// The body of an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// JSON, with its line end.
    Json(String),
    /// The system log, which a browser saves as a file.
    LogFile(String),
}

impl Answer {
    pub(crate) fn of_json(json: String) -> Self {
        Self::Json(json + "\n")
    }

    pub(crate) fn json(value: &dyn ToJson) -> Self {
        let mut json = String::new();
        value.write(&mut json);
        Self::of_json(json)
    }
}

/// A rejected request, with a reason for its sender.
#[derive(Debug)]
pub(crate) struct HttpError {
    pub(crate) status: u16,
    pub(crate) error: String,
    /// The methods that the path supports, for the header `Allow`.
    pub(crate) allowed: Option<String>,
}

impl HttpError {
    pub(crate) fn new(status: impl Into<u16>, error: String) -> Self {
        Self { status: status.into(), error, allowed: None }
    }

    pub(crate) fn wrong(error: String) -> Self {
        Self::new(status::BAD_REQUEST, error)
    }
}
