//! Connections to a service, and calls with deadlines and retries.

use std::{
    fs,
    future::Future,
    path::{Path, PathBuf},
    time::Duration,
};

use moldline_proto::v1::{mesh_service_client::MeshServiceClient, panel_service_client::PanelServiceClient};
use tokio::time::{Instant, sleep, timeout_at};
use tonic::{
    Request, Response, Status,
    metadata::{Ascii, MetadataValue},
    transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity},
};

use crate::{Code, Error, error::Origin};

/// Bytes of the largest message.
const LARGEST_MESSAGE: usize = 512 << 20;
/// Flow-control window in bytes: a response of usual size needs no window update.
const WINDOW: u32 = 4 << 20;

/// A service's generated client.
pub trait Stub: Clone {
    /// A client over a channel, for messages up to [`LARGEST_MESSAGE`].
    fn over(channel: Channel) -> Self;
}

impl Stub for MeshServiceClient<Channel> {
    fn over(channel: Channel) -> Self {
        let stub = Self::new(channel).max_decoding_message_size(LARGEST_MESSAGE);
        stub.max_encoding_message_size(LARGEST_MESSAGE)
    }
}

impl Stub for PanelServiceClient<Channel> {
    fn over(channel: Channel) -> Self {
        let stub = Self::new(channel).max_decoding_message_size(LARGEST_MESSAGE);
        stub.max_encoding_message_size(LARGEST_MESSAGE)
    }
}

/// TLS settings of a connection; all files are PEM.
#[derive(Clone, Debug, Default)]
pub struct Tls {
    /// Certificates of the trusted authorities; the system's if absent.
    pub authorities: Option<PathBuf>,
    /// The client's own certificate and private key, for servers that require one (mTLS).
    pub identity: Option<(PathBuf, PathBuf)>,
    /// Server name that the certificate must carry; that of the address if absent.
    pub server_name: Option<String>,
}

/// Retry policy: exponential backoff with jitter, within the timeout of the call.
///
/// Calls are repeated if the server cannot be reached, or answers that it is stopping ([`Code::Unavailable`]) or is full and
/// names a delay ([`Code::ResourceExhausted`]): it has not begun with them. All calls are safe to repeat: they change nothing,
/// or carry a request id by which the server recognises them.
///
/// A call whose connection broke after it was sent ([`Origin::Lost`]) may be what the server died of. It is repeated once,
/// after a longer pause, unless `losses` says otherwise.
///
/// The pause before attempt k + 1 is the delay that the server names, plus a random share of `first_pause * 2^(k-1)`, so
/// that clients that failed together do not return together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retry {
    /// Number of attempts, including the first; 1 for no retry. By default as many as the timeout allows (without a timeout: as
    /// are made within 10 minutes).
    pub attempts: u32,
    /// Upper bound of the first random pause.
    pub first_pause: Duration,
    /// Upper bound of all random pauses.
    pub longest_pause: Duration,
    /// How often a call is repeated whose connection broke after it was sent.
    pub losses: u32,
}

impl Default for Retry {
    fn default() -> Self {
        Self {
            attempts: u32::MAX,
            first_pause: Duration::from_millis(100),
            longest_pause: Duration::from_secs(5),
            losses: 1,
        }
    }
}

/// How long a call without a timeout is repeated.
const PATIENCE: Duration = Duration::from_secs(600);
/// Pause before a call is repeated whose connection broke, in first pauses.
const AFTER_LOSS: u32 = 10;

/// Options of a connection.
#[derive(Clone, Debug)]
pub struct Options {
    /// Bearer token, sent with every call; use it with `tls` unless the network is trusted.
    pub token: Option<String>,
    /// TLS settings; plain text if absent.
    pub tls: Option<Tls>,
    /// Timeout of a call over all its attempts; no limit if absent. Set-ups and checks have timeouts of their own.
    pub timeout: Option<Duration>,
    /// Retry policy.
    pub retry: Retry,
}

impl Default for Options {
    fn default() -> Self {
        Self { token: None, tls: None, timeout: Some(Duration::from_secs(600)), retry: Retry::default() }
    }
}

#[derive(Debug)]
pub struct Connection<S> {
    address: String,
    stub: S,
    authorization: Option<MetadataValue<Ascii>>,
    retry: Retry,
}

impl<S: Stub> Connection<S> {
    /// Connects on first use.
    pub fn new(address: &str, options: &Options) -> Result<Self, Error> {
        let scheme = if options.tls.is_some() { "https" } else { "http" };
        let not_usable = |error: tonic::transport::Error| Error::client(format!("{address}: {error:?}"));
        let mut endpoint = Endpoint::from_shared(format!("{scheme}://{address}"))
            .map_err(not_usable)?
            .connect_timeout(Duration::from_secs(20))
            .initial_stream_window_size(WINDOW)
            .initial_connection_window_size(2 * WINDOW)
            // Detects a server that has vanished while a long call waits for it.
            .http2_keep_alive_interval(Duration::from_secs(60));
        if let Some(tls) = &options.tls {
            endpoint = endpoint.tls_config(tls_config(tls)?).map_err(not_usable)?;
        }
        let authorization = match &options.token {
            None => None,
            Some(token) => Some(format!("Bearer {token}").parse().map_err(|_| {
                Error::client("the token contains characters that a header must not contain")
            })?),
        };
        let (address, stub) = (address.to_owned(), S::over(endpoint.connect_lazy()));
        Ok(Self { address, stub, authorization, retry: options.retry })
    }

    /// A unary call.
    pub async fn call<Q, A, F>(
        &self,
        deadline: Deadline,
        message: Q,
        method: impl Fn(S, Request<Q>) -> F,
    ) -> Result<A, Error>
    where
        Q: Clone,
        F: Future<Output = Result<Response<A>, Status>>,
    {
        let attempt = |stub, request: Request<()>| {
            let answer = method(stub, request.map(|()| message.clone()));
            async { Ok(answer.await?.into_inner()) }
        };
        self.attempts(deadline, attempt).await
    }

    /// Runs attempts until one succeeds; returns the error of the last one.
    pub async fn attempts<A, F>(
        &self,
        deadline: Deadline,
        attempt: impl Fn(S, Request<()>) -> F,
    ) -> Result<A, Error>
    where
        F: Future<Output = Result<A, Error>>,
    {
        let Retry { attempts, first_pause, longest_pause, losses } = self.retry;
        let patience = Deadline(deadline.0.or_else(|| Instant::now().checked_add(PATIENCE)));
        let mut longest = first_pause;
        let (mut failed, mut lost) = (0, 0);
        loop {
            let answer = attempt(self.stub.clone(), self.request(deadline));
            let error = match deadline.limit(answer).await {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            failed += 1;
            let mut pause = error.retry_after.unwrap_or_default() + longest.mul_f64(fastrand::f64());
            if error.origin == Origin::Lost {
                lost += 1;
                pause += AFTER_LOSS * first_pause;
            }
            longest = longest_pause.min(2 * longest);
            let again = error.may_pass() && failed < attempts && lost <= losses;
            if !again || patience.passes_within(pause) {
                return Err(self.told(error, failed, lost));
            }
            sleep(pause).await;
        }
    }

    /// The error, saying what was tried where.
    fn told(&self, mut error: Error, failed: u32, lost: u32) -> Error {
        let times = if failed == 1 { "once".to_owned() } else { format!("{failed} times") };
        let mut what = format!("called {times}");
        if lost > 0 {
            let under = if lost == 1 { "the call".to_owned() } else { format!("{lost} of the calls") };
            what += &format!(", and the connection broke under {under}, which the server may have died of");
        } else if failed == 1 && error.origin == Origin::Server {
            return error;
        }
        error.message = format!("{} ({}: {what})", error.message, self.address);
        error
    }

    /// A request with the token and the deadline.
    fn request(&self, deadline: Deadline) -> Request<()> {
        let mut request = Request::new(());
        if let Some(authorization) = &self.authorization {
            request.metadata_mut().insert("authorization", authorization.clone());
        }
        if let Some(end) = deadline.0 {
            request.set_timeout(end.saturating_duration_since(Instant::now()));
        }
        request
    }
}

/// Deadline of an operation over all its calls.
#[derive(Clone, Copy, Debug)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    pub fn after(timeout: Option<Duration>) -> Self {
        Self(timeout.and_then(|timeout| Instant::now().checked_add(timeout)))
    }

    async fn limit<A>(self, answer: impl Future<Output = Result<A, Error>>) -> Result<A, Error> {
        let Some(end) = self.0 else { return answer.await };
        let late = || Error::new(Code::DeadlineExceeded, "the call took longer than its timeout");
        match timeout_at(end, answer).await {
            Err(_) => Err(late()),
            // A server may report the deadline as a cancellation.
            Ok(Err(error)) if error.code == Code::Cancelled && Instant::now() >= end => Err(late()),
            Ok(answer) => answer,
        }
    }

    fn passes_within(self, pause: Duration) -> bool {
        self.0.is_some_and(|end| end.saturating_duration_since(Instant::now()) <= pause)
    }
}

fn tls_config(tls: &Tls) -> Result<ClientTlsConfig, Error> {
    let mut config = ClientTlsConfig::new();
    config = match &tls.authorities {
        Some(path) => config.ca_certificate(Certificate::from_pem(content(path)?)),
        None => config.with_native_roots(),
    };
    if let Some((certificate, key)) = &tls.identity {
        config = config.identity(Identity::from_pem(content(certificate)?, content(key)?));
    }
    if let Some(name) = &tls.server_name {
        config = config.domain_name(name);
    }
    Ok(config)
}

fn content(path: &Path) -> Result<Vec<u8>, Error> {
    fs::read(path).map_err(|error| Error::file(path, &error))
}
