//! A web server for the person in front of this machine: it listens on the loopback address only, answers only below a random
//! token, and serves nothing but the named folders, bytes and look-ups of a [`Site`].

mod answer;
mod range;
mod site;

use rand::Rng;
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::thread::JoinHandle;
use thiserror::Error;

pub use site::{Find, Site, Source};

/// Requests answered at a time; a page opens about six connections.
const WORKERS: usize = 8;

/// Why a server did not start.
#[derive(Debug, Error)]
pub enum ViewerError {
    /// The port cannot be had.
    #[error("cannot listen on port {port}: {reason}; choose another --port, or 0 for any free one")]
    Listen {
        /// Asked for.
        port: u16,
        /// The system's words.
        reason: String,
    },
}

/// A running server. It stops when dropped.
pub struct Viewer {
    url: String,
    server: Arc<tiny_http::Server>,
    workers: Vec<JoinHandle<()>>,
}

impl Viewer {
    /// Starts to serve a site on a port of this machine; 0 is any free one.
    ///
    /// # Errors
    /// When the port is in use or not allowed.
    pub fn start(site: Site, port: u16) -> Result<Self, ViewerError> {
        let refused = |reason: String| ViewerError::Listen { port, reason };
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let server = tiny_http::Server::http(address).map_err(|e| refused(e.to_string()))?;
        let port = server.server_addr().to_ip().map_or(port, |address| address.port());
        let token = token();
        let (server, site) = (Arc::new(server), Arc::new(answer::Gate { site, token: token.clone(), port }));
        let worker = || {
            let (server, gate) = (server.clone(), site.clone());
            std::thread::spawn(move || {
                while let Ok(request) = server.recv() {
                    gate.answer(request);
                }
            })
        };
        let workers = (0..WORKERS).map(|_| worker()).collect();
        Ok(Self { url: format!("http://127.0.0.1:{port}/{token}/"), server, workers })
    }

    /// Where the site is, with its token.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Serves until the process ends.
    pub fn wait(mut self) {
        for worker in std::mem::take(&mut self.workers) {
            // A worker that panicked has nothing to say that its message has not.
            let _ = worker.join();
        }
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        (0..WORKERS).for_each(|_| self.server.unblock());
    }
}

/// 128 random bits in hexadecimal.
fn token() -> String {
    let bits: u128 = rand::rng().random();
    format!("{bits:032x}")
}
