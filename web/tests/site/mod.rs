//! A server of static files for the tests of the pages.

use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::PathBuf;
use std::thread;

/// The folder that `cargo xtask web` builds, served until the end of the tests.
pub(crate) struct Site {
    address: SocketAddr,
}

impl Site {
    pub(crate) fn open() -> Self {
        let default = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../target/web"));
        let folder = std::env::var_os("WSG_WEB").map_or(default, PathBuf::from);
        assert!(
            folder.join("wsg.wasm").exists(),
            "{} has no wsg.wasm: run `cargo xtask web`",
            folder.display()
        );
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let folder = folder.clone();
                thread::spawn(move || serve(client, &folder));
            }
        });
        Self { address }
    }

    /// Returns the address of a file.
    pub(crate) fn address(&self, file: &str) -> String {
        format!("http://{}/{file}", self.address)
    }
}

/// Answers one request. A browser that has left needs no answer.
fn serve(client: TcpStream, folder: &std::path::Path) {
    let mut lines = BufReader::new(&client).lines().map_while(Result::ok);
    let request = lines.next().unwrap_or_default();
    let _ = lines.take_while(|line| !line.is_empty()).count();
    let name = request.split([' ', '?']).nth(1).unwrap_or_default().trim_start_matches('/');
    let kind = match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("wasm") => "application/wasm",
        _ => "image/png",
    };
    // A browser asks for the icon by itself.
    let body = if name == "favicon.ico" { Some(Vec::new()) } else { std::fs::read(folder.join(name)).ok() };
    let status = if body.is_some() { "200 OK" } else { "404 Not Found" };
    let body = body.unwrap_or_default();
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let _ = (&client).write_all(head.as_bytes()).and_then(|()| (&client).write_all(&body));
}
