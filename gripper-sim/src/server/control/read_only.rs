//! The server of a page without commands, for another program of this workspace. Its connections have limits like the
//! connections of the control interface, and `Host` and `Origin` are checked in the same way.

use super::access::{check_host, check_origin};
use super::answer::{Answer, finished, whole};
use super::page::guarded;
use super::{MAX_HEAD_LEN, check_path, document, serve_connections};
use crate::control::HttpError;
use anyhow::Result;
use hyper::body::Incoming;
use hyper::header::HeaderValue;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::TokioIo;
use std::convert::Infallible;
use std::net::IpAddr;
use std::rc::Rc;
use tokio::net::{TcpListener, TcpStream};

/// Maximum number of simultaneous connections. One more displaces the oldest.
const MAX_READERS: usize = 8;

/// Serves a page at `/`, and values at these paths, each with its media type. Supports GET only. `{{nonce}}` in the page is replaced
/// with the nonce of its style and script. `read` returns the values of a path; `None`: there are none now.
///
/// Must run in a [`LocalSet`](tokio::task::LocalSet).
pub async fn serve_read_only<R>(
    listener: TcpListener,
    page: &'static str,
    values: &'static [(&'static str, &'static str)],
    read: R,
) -> Infallible
where
    R: AsyncFn(&str) -> Option<String> + 'static,
{
    let site = Rc::new(Site { page, values, read });
    serve_connections(listener, MAX_READERS, |_, stream, _| serve(Rc::clone(&site), stream)).await
}

struct Site<R> {
    page: &'static str,
    values: &'static [(&'static str, &'static str)],
    read: R,
}

/// Serves one request.
async fn serve<R: AsyncFn(&str) -> Option<String>>(site: Rc<Site<R>>, stream: TcpStream) -> Result<()> {
    let here = stream.local_addr()?.ip().to_canonical();
    let site = &*site;
    let service = service_fn(move |request: Request<Incoming>| async move {
        Ok::<_, Infallible>(finished(site.answer(here, &request).await))
    });
    let served = http1::Builder::new()
        .keep_alive(false)
        .max_buf_size(MAX_HEAD_LEN)
        .serve_connection(TokioIo::new(stream), service);
    Ok(served.await?)
}

impl<R: AsyncFn(&str) -> Option<String>> Site<R> {
    async fn answer(&self, here: IpAddr, request: &Request<Incoming>) -> Result<Answer, HttpError> {
        check_host(request.headers(), here, &[], "")?;
        check_origin(request.headers())?;
        let paths = self.values.iter().map(|(path, _)| *path).chain(["/"]);
        check_path(request, &paths.map(|path| (path, Method::GET)).collect::<Vec<_>>())?;
        let path = request.uri().path();
        let Some((_, media_type)) = self.values.iter().find(|(known, _)| *known == path) else {
            return document(guarded(self.page, ""));
        };
        let values = (self.read)(path).await.ok_or_else(|| {
            HttpError::new(StatusCode::SERVICE_UNAVAILABLE, "there are no values now; try again".to_owned())
        })?;
        Ok(whole(values, HeaderValue::from_static(media_type)))
    }
}
