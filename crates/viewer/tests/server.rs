//! Requests as a browser, and as somebody with other intentions, sends them.

use ffgs_viewer::{Site, Source, Viewer};
use std::io::{Read, Write};
use std::net::TcpStream;
use tempfile::TempDir;

struct Served {
    viewer: Viewer,
    folder: TempDir,
}

impl Served {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        std::fs::create_dir_all(folder.path().join("site/sub")).unwrap();
        std::fs::write(folder.path().join("secret.txt"), "secret").unwrap();
        std::fs::write(folder.path().join("site/a.json"), "0123456789").unwrap();
        std::fs::write(folder.path().join("site/sub/b.png"), "b").unwrap();
        std::fs::write(folder.path().join("site/.hidden"), "secret").unwrap();
        let photo = folder.path().join("secret.txt");
        let site = Site::default()
            .with("index.html", Source::Bytes(b"<p>".to_vec()))
            .with("photo", Source::Lookup(Box::new(move |name| (name == "1").then(|| photo.clone()))))
            .with("", Source::Folder(folder.path().join("site")));
        Self { viewer: Viewer::start(site, 0).unwrap(), folder }
    }

    fn address(&self) -> &str {
        self.viewer.url().strip_prefix("http://").unwrap().split('/').next().unwrap()
    }

    fn token(&self) -> &str {
        self.viewer.url().trim_end_matches('/').rsplit('/').next().unwrap()
    }

    /// Sends lines as they are; status and body.
    fn raw(&self, request: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(self.address()).unwrap();
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        let body = answer.split_once("\r\n\r\n").map(|(_, body)| body.to_owned()).unwrap_or_default();
        (status, body)
    }

    fn get(&self, path: &str, headers: &str) -> (u16, String) {
        let (address, token) = (self.address(), self.token());
        self.raw(&format!(
            "GET /{token}/{path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n{headers}\r\n"
        ))
    }
}

#[test]
fn files_bytes_and_lookups_are_served() {
    let served = Served::new();
    assert_eq!(served.get("", ""), (200, "<p>".into()));
    assert_eq!(served.get("a.json?x=1", ""), (200, "0123456789".into()));
    assert_eq!(served.get("sub/b.png", ""), (200, "b".into()));
    assert_eq!(served.get("photo/1", ""), (200, "secret".into()));
    assert_eq!(served.get("photo/2", "").0, 404);
}

#[test]
fn parts_of_files_are_served() {
    let served = Served::new();
    assert_eq!(served.get("a.json", "Range: bytes=2-4\r\n"), (206, "234".into()));
    assert_eq!(served.get("a.json", "Range: bytes=-3\r\n"), (206, "789".into()));
    assert_eq!(served.get("a.json", "Range: bytes=10-\r\n").0, 416);
}

#[test]
fn nothing_outside_the_site_is_served() {
    let served = Served::new();
    for path in [
        "../secret.txt",
        "%2e%2e/secret.txt",
        "..%2fsecret.txt",
        "sub/../../secret.txt",
        ".hidden",
        "/etc/passwd",
        "sub",
        "sub/",
        "a.json/",
        "..\\secret.txt",
        "sub//b.png",
        "photo/../secret.txt",
    ] {
        assert_eq!(served.get(path, "").0, 404, "{path}");
    }
    #[cfg(unix)]
    {
        let link = served.folder.path().join("site/link.txt");
        std::os::unix::fs::symlink(served.folder.path().join("secret.txt"), link).unwrap();
        assert_eq!(served.get("link.txt", "").0, 404);
    }
}

#[test]
fn without_the_token_the_right_host_or_a_reading_method_nothing_is_served() {
    let served = Served::new();
    let (address, token) = (served.address(), served.token());
    let send = |line: &str, host: &str| {
        served.raw(&format!("{line} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")).0
    };
    assert_eq!(send(&format!("GET /{token}/a.json"), address), 200);
    assert_eq!(send("GET /a.json", address), 404);
    assert_eq!(send("GET /", address), 404);
    assert_eq!(send(&format!("GET /{}/a.json", "0".repeat(32)), address), 404);
    assert_eq!(send(&format!("GET /{token}/a.json"), "evil.example"), 403);
    assert_eq!(send(&format!("DELETE /{token}/a.json"), address), 405);
    assert_eq!(token.len(), 32);
    assert_ne!(token, Served::new().token());
    assert!(address.starts_with("127.0.0.1:"));
}

#[test]
fn a_port_in_use_is_an_error_that_says_so() {
    let served = Served::new();
    let port: u16 = served.address().rsplit(':').next().unwrap().parse().unwrap();
    let error = Viewer::start(Site::default(), port).err().unwrap().to_string();
    assert!(error.contains(&port.to_string()) && error.contains("--port"), "{error}");
}

/// Browsers open about six connections and keep those that may be kept.
#[test]
fn connections_do_not_wait_for_each_other() {
    let served = Served::new();
    let get = || {
        let (address, token) = (served.address(), served.token());
        let mut stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(std::time::Duration::from_secs(20))).unwrap();
        write!(stream, "GET /{token}/a.json HTTP/1.1\r\nHost: {address}\r\n\r\n").unwrap();
        let (mut answer, mut part) = (Vec::new(), [0; 512]);
        while !answer.ends_with(b"0123456789") {
            let count = stream.read(&mut part).unwrap();
            assert_ne!(count, 0, "cut off");
            answer.extend(&part[..count]);
        }
        assert!(String::from_utf8_lossy(&answer).contains("Connection: close"));
    };
    std::thread::scope(|scope| (0..24).for_each(|_| drop(scope.spawn(get))));
}
