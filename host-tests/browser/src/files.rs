//! A server of static files on this machine, for tests and for `cargo xtask web --open`.

use std::io::{self, BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::time::Duration;
use std::{fs, thread};

/// Time-out of a browser that connects and asks nothing.
const PATIENCE: Duration = Duration::from_secs(10);

/// Serves the files of a folder as long as this program runs. Returns the address, such as `http://127.0.0.1:43210`.
///
/// # Errors
/// Returns an error if no port is free.
pub fn serve(folder: &Path) -> io::Result<String> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let (address, folder) = (listener.local_addr()?, folder.to_owned());
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let folder = folder.clone();
            // A browser that disconnects is not a failure.
            thread::spawn(move || answer(stream, &folder).ok());
        }
    });
    Ok(format!("http://{address}"))
}

fn answer(mut stream: TcpStream, folder: &Path) -> io::Result<()> {
    stream.set_read_timeout(Some(PATIENCE))?;
    let mut head = BufReader::new(stream.try_clone()?);
    let (mut request, mut header) = (String::new(), String::new());
    head.read_line(&mut request)?;
    while head.read_line(&mut header)? > 2 {
        header.clear();
    }
    let name = request
        .split(' ')
        .nth(1)
        .unwrap_or("")
        .split(['?', '#'])
        .next()
        .unwrap_or("")
        .trim_start_matches('/');
    let name = PathBuf::from(if name.is_empty() { "index.html" } else { name });
    let kind = match name.extension().and_then(|kind| kind.to_str()) {
        Some("html") => "text/html",
        Some("js") => "text/javascript",
        Some("css") => "text/css",
        Some("wasm") => "application/wasm",
        _ => "application/octet-stream",
    };
    // The folder has no folders, and nothing leads out of it.
    let file = name
        .file_name()
        .filter(|file| *file == name.as_os_str())
        .and_then(|file| fs::read(folder.join(file)).ok());
    let (status, body) = file.map_or(("404 Not Found", vec![]), |body| ("200 OK", body));
    let len = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    )?;
    stream.write_all(&body)
}
