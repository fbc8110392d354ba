//! A page for those who watch the server: `/metrics`, `/healthz`, `/readyz`, over plain HTTP.
//!
//! It runs in a thread of its own, so that it answers while the world hangs, which is when it is needed, and so that the
//! making of a page takes no time from a tick. `/healthz` and `/readyz` take no lock at all; `/metrics` holds the world's for
//! as long as it copies counters, at most ten times a second, however often it is asked.
//!
//! What it tells is not secret but is nobody's business either: it listens on this machine only unless told otherwise.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Semaphore, oneshot};

use super::metrics::{CONTENT_TYPE, Snapshot};
use super::{Handle, Stage};

/// Why nobody can watch.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// The address can be reached from elsewhere, and nobody said that it may.
    #[error(
        "metrics on {address} could be read from elsewhere; name a loopback address such as 127.0.0.1:9100, or say --metrics-anywhere"
    )]
    Anywhere {
        /// Which.
        address: SocketAddr,
    },
    /// The address can't be listened on.
    #[error("cannot listen on {address} for metrics: {source}; choose another with --metrics")]
    Bind {
        /// Which.
        address: SocketAddr,
        /// Why.
        source: std::io::Error,
    },
    /// There can be no thread.
    #[error("cannot start the thread that answers for metrics: {0}")]
    Thread(std::io::Error),
}

/// A thread that answers those who watch; it ends when this is dropped.
pub struct Watch {
    address: SocketAddr,
    watched: Arc<Watched>,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

#[derive(Default)]
struct Watched {
    handle: OnceLock<Handle>,
    /// The newest metrics, and when they were made.
    page: Mutex<Option<(Instant, String)>>,
}

/// Most who watch at once.
const WATCHERS: usize = 16;

/// For how long one may take to ask, and to read.
const PATIENCE: Duration = Duration::from_secs(2);

/// Most bytes of a question.
const QUESTION: usize = 4096;

/// Metrics are as old as this at most: who asks more often gets the same again.
const PAGE_AGE: Duration = Duration::from_millis(100);

impl Watch {
    /// Listens on `address` and answers: alive, and not ready until a server is [attached](Watch::attach). An address that is
    /// not of this machine is refused unless it may be `anywhere`.
    ///
    /// # Errors
    /// If the address can't be listened on, or may not be.
    pub fn start(address: SocketAddr, anywhere: bool) -> Result<Watch, WatchError> {
        if !address.ip().to_canonical().is_loopback() && !anywhere {
            return Err(WatchError::Anywhere { address });
        }
        let bind = |source| WatchError::Bind { address, source };
        let listener = std::net::TcpListener::bind(address).map_err(bind)?;
        listener.set_nonblocking(true).map_err(bind)?;
        let address = listener.local_addr().map_err(bind)?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(WatchError::Thread)?;
        let watched = Arc::new(Watched::default());
        let (stop, stopped) = oneshot::channel();
        let shared = watched.clone();
        let thread = std::thread::Builder::new()
            .name("watch".into())
            .spawn(move || {
                runtime.block_on(async {
                    tokio::select! {
                        _ = stopped => {}
                        result = listen(listener, shared) => {
                            if let Err(error) = result {
                                tracing::warn!(%error, "nobody can watch any more");
                            }
                        }
                    }
                });
            })
            .map_err(WatchError::Thread)?;
        Ok(Watch { address, watched, stop: Some(stop), thread: Some(thread) })
    }

    /// Where it listens.
    pub fn local_addr(&self) -> SocketAddr {
        self.address
    }

    /// Tells of this server from now on. The first one stays.
    pub fn attach(&self, handle: &Handle) {
        let _ = self.watched.handle.set(handle.clone());
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

async fn listen(listener: std::net::TcpListener, watched: Arc<Watched>) -> std::io::Result<()> {
    let listener = TcpListener::from_std(listener)?;
    let places = Arc::new(Semaphore::new(WATCHERS));
    loop {
        let Ok(place) = places.clone().acquire_owned().await else { return Ok(()) };
        let Ok((stream, _)) = listener.accept().await else {
            // Out of file descriptors, or a peer that has gone: neither is mended by asking again at once.
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let watched = watched.clone();
        tokio::spawn(async move {
            let _ = tokio::time::timeout(PATIENCE, converse(stream, &watched)).await;
            drop(place);
        });
    }
}

async fn converse(mut stream: TcpStream, watched: &Watched) -> std::io::Result<()> {
    let mut question = Vec::with_capacity(512);
    // Until the empty line that ends the headers; what they say does not matter.
    while !question.windows(4).any(|four| four == b"\r\n\r\n") {
        if question.len() >= QUESTION || stream.read_buf(&mut question).await? == 0 {
            let answer = Answer::plain(400, "that is no question that this page understands\n");
            return answer.write(&mut stream, false).await;
        }
    }
    let line = question.split(|&byte| byte == b'\r').next().unwrap_or_default();
    let (answer, is_head) = watched.answer(&String::from_utf8_lossy(line));
    answer.write(&mut stream, is_head).await
}

struct Answer {
    status: u16,
    kind: &'static str,
    body: String,
}

impl Answer {
    fn plain(status: u16, body: impl Into<String>) -> Answer {
        Answer { status, kind: "text/plain; charset=utf-8", body: body.into() }
    }

    async fn write(&self, stream: &mut TcpStream, is_head: bool) -> std::io::Result<()> {
        let what = match self.status {
            200 => "OK",
            400 => "Bad Request",
            404 => "Not Found",
            405 => "Method Not Allowed",
            503 => "Service Unavailable",
            _ => "Internal Server Error",
        };
        let (status, kind, length) = (self.status, self.kind, self.body.len());
        let mut page = format!(
            "HTTP/1.1 {status} {what}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
        );
        if !is_head {
            page.push_str(&self.body);
        }
        stream.write_all(page.as_bytes()).await?;
        stream.shutdown().await
    }
}

impl Watched {
    /// The answer to a request line, and whether only its head is wanted.
    fn answer(&self, line: &str) -> (Answer, bool) {
        let mut words = line.split(' ');
        let (method, target) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
        let is_head = method == "HEAD";
        if !is_head && method != "GET" {
            return (Answer::plain(405, "only GET and HEAD are answered\n"), false);
        }
        let answer = match target.split('?').next().unwrap_or_default() {
            "/metrics" => self.metrics(),
            "/healthz" => self.health(),
            "/readyz" => self.readiness(),
            "/" => Answer::plain(200, "/metrics\n/healthz\n/readyz\n"),
            _ => Answer::plain(404, "there are /metrics, /healthz and /readyz\n"),
        };
        (answer, is_head)
    }

    /// Whether the process is alive, and ticks go on.
    fn health(&self) -> Answer {
        let Some(handle) = self.handle.get() else { return Answer::plain(200, "ok: starting\n") };
        let (age, is_stuck) = handle.life.tick_age(handle.clock.now());
        match is_stuck {
            true => Answer::plain(503, format!("stuck: the last tick ended {:.1} s ago\n", age.as_secs_f64())),
            false => Answer::plain(200, format!("ok: {}\n", handle.stage().name())),
        }
    }

    /// Whether clients may come.
    fn readiness(&self) -> Answer {
        let stage = self.handle.get().map_or(Stage::Starting, Handle::stage);
        let is_ready = stage == Stage::Serving && self.health().status == 200;
        match is_ready {
            true => Answer::plain(200, "ready\n"),
            false if stage == Stage::Serving => Answer::plain(503, "not ready: stuck\n"),
            false => Answer::plain(503, format!("not ready: {}\n", stage.name())),
        }
    }

    fn metrics(&self) -> Answer {
        let Some(handle) = self.handle.get() else { return Answer::plain(503, "not ready: starting\n") };
        let mut page = self.page.lock().unwrap_or_else(PoisonError::into_inner);
        let body = match page.as_ref().filter(|(made, _)| made.elapsed() < PAGE_AGE) {
            Some((_, page)) => page.clone(),
            None => {
                let snapshot = Snapshot::take(handle);
                tracing::trace!(held = ?snapshot.held(), "scraped");
                let Ok(text) = snapshot.text() else { return Answer::plain(500, "the page could not be made\n") };
                *page = Some((Instant::now(), text.clone()));
                text
            }
        };
        Answer { status: 200, kind: CONTENT_TYPE, body }
    }
}
