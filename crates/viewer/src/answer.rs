//! Answers to requests: the token, the headers, ranges of files.

use crate::range;
use crate::site::{Content, Site};
use std::io::{self, Read, SeekFrom, Write};
use tiny_http::{Method, Request, StatusCode};

/// The page may load from here only, and start workers of its own text.
const POLICY: &str = "default-src 'self'; script-src 'self' blob: 'wasm-unsafe-eval'; worker-src 'self' blob:; \
    img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; connect-src 'self' blob: data:";

/// A site behind its token.
pub(crate) struct Gate {
    pub(crate) site: Site,
    pub(crate) token: String,
    pub(crate) port: u16,
}

/// What is sent: status, body, its length, further headers.
struct Reply {
    status: u16,
    body: Box<dyn Read + Send>,
    length: u64,
    headers: Vec<(&'static str, String)>,
}

impl Reply {
    fn error(status: u16, text: &str) -> Self {
        let body = text.as_bytes().to_vec();
        let headers = vec![("Content-Type", "text/plain; charset=utf-8".to_owned())];
        Self { status, length: body.len() as u64, body: Box::new(io::Cursor::new(body)), headers }
    }
}

impl Gate {
    /// Answers a request; a visitor who has gone is no error.
    pub(crate) fn answer(&self, request: Request) {
        let header = |name: &'static str| {
            request.headers().iter().find(|h| h.field.equiv(name)).map(|h| h.value.as_str().to_owned())
        };
        let (host, wanted) = (header("Host"), header("Range"));
        let reply = match request.method() {
            Method::Get | Method::Head => self.reply(request.url(), host.as_deref(), wanted.as_deref()),
            _ => Reply::error(405, "only GET and HEAD"),
        };
        let with_body = *request.method() != Method::Head;
        let _ = write(&mut *request.into_writer(), reply, with_body);
    }

    fn reply(&self, url: &str, host: Option<&str>, wanted: Option<&str>) -> Reply {
        // Another site's page that made its name point here would send its own name.
        let own = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{}", self.port));
        if !host.is_some_and(|host| own.iter().any(|name| name == host)) {
            return Reply::error(403, "wrong host");
        }
        let path = url.split(['?', '#']).next().unwrap_or_default();
        let inside = path
            .strip_prefix('/')
            .and_then(|p| p.strip_prefix(&self.token))
            .and_then(|p| p.strip_prefix('/'));
        let Some(path) = inside else { return Reply::error(404, "not found") };
        let path = if path.is_empty() { "index.html" } else { path };
        match self.site.open(path) {
            Some((content, length)) => send(content, length, path, wanted),
            None => Reply::error(404, "not found"),
        }
    }
}

/// What every answer says. A connection carries one answer: tiny_http may leave a new one waiting for a thread while others
/// are kept alive.
const HEADERS: [(&str, &str); 6] = [
    ("Content-Security-Policy", POLICY),
    ("X-Content-Type-Options", "nosniff"),
    ("Referrer-Policy", "no-referrer"),
    ("Cache-Control", "no-store"),
    ("Accept-Ranges", "bytes"),
    ("Connection", "close"),
];

fn write(out: &mut dyn Write, mut reply: Reply, with_body: bool) -> io::Result<()> {
    let status = StatusCode(reply.status);
    write!(out, "HTTP/1.1 {} {}\r\n", reply.status, status.default_reason_phrase())?;
    for (name, value) in &reply.headers {
        write!(out, "{name}: {value}\r\n")?;
    }
    for (name, value) in HEADERS {
        write!(out, "{name}: {value}\r\n")?;
    }
    write!(out, "Content-Length: {}\r\n\r\n", reply.length)?;
    if with_body {
        io::copy(&mut reply.body, out)?;
    }
    out.flush()
}

fn send(mut content: Box<dyn Content>, length: u64, path: &str, wanted: Option<&str>) -> Reply {
    let mut headers = vec![("Content-Type", kind(path).to_owned())];
    let (status, start, count) = match wanted.map_or(Ok(None), |header| range::parse(header, length)) {
        Ok(None) => (200, 0, length),
        Ok(Some((start, count))) => {
            headers.push(("Content-Range", format!("bytes {start}-{}/{length}", start + count - 1)));
            (206, start, count)
        }
        Err(()) => {
            let mut reply = Reply::error(416, "no such range");
            reply.headers.push(("Content-Range", format!("bytes */{length}")));
            return reply;
        }
    };
    if content.seek(SeekFrom::Start(start)).is_err() {
        return Reply::error(500, "cannot read");
    }
    Reply { status, body: Box::new(content.take(count)), length: count, headers }
}

/// Media type by the end of a name.
fn kind(path: &str) -> &'static str {
    match path.rsplit('.').next().unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" | "mjs" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "json" | "jsonl" => "application/json",
        "png" => "image/png",
        "jpg" => "image/jpeg",
        "wasm" => "application/wasm",
        _ => "application/octet-stream",
    }
}
