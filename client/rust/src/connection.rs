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

use crate::{Code, Error};

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
/// Calls are retried if the server cannot be reached or is stopping ([`Code::Unavailable`]), or if it is full and names a
/// delay ([`Code::ResourceExhausted`]). All calls are safe to repeat: they change nothing, or carry a request id by which
/// the server recognises them.
///
/// The pause before attempt k + 1 is the delay that the server names, plus a random share of `first_pause * 2^(k-1)`, so
/// that clients that failed together do not return together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retry {
    /// Number of attempts, including the first; 1 for no retry.
    pub attempts: u32,
    /// Upper bound of the first random pause.
    pub first_pause: Duration,
    /// Upper bound of all random pauses.
    pub longest_pause: Duration,
}

impl Default for Retry {
    fn default() -> Self {
        Self { attempts: 10, first_pause: Duration::from_millis(100), longest_pause: Duration::from_secs(5) }
    }
}

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
        Ok(Self { stub: S::over(endpoint.connect_lazy()), authorization, retry: options.retry })
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
        let mut longest = self.retry.first_pause;
        let mut failed = 0;
        loop {
            let answer = attempt(self.stub.clone(), self.request(deadline));
            let error = match deadline.limit(answer).await {
                Ok(answer) => return Ok(answer),
                Err(error) => error,
            };
            failed += 1;
            let pause = error.retry_after.unwrap_or_default() + longest.mul_f64(fastrand::f64());
            longest = self.retry.longest_pause.min(2 * longest);
            if !error.may_pass() || failed >= self.retry.attempts || deadline.passes_within(pause) {
                return Err(error);
            }
            sleep(pause).await;
        }
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
