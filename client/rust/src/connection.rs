//! Calls, each in as many attempts as it takes.

use std::{
    fs,
    future::Future,
    path::{Path, PathBuf},
    time::Duration,
};

use moldline_proto::v1::mesh_service_client::MeshServiceClient;
use tokio::time::{Instant, sleep, timeout_at};
use tonic::{
    Request, Response, Status,
    metadata::{Ascii, MetadataValue},
    transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity},
};

use crate::{Code, Error};

/// Bytes of the largest message.
const LARGEST_MESSAGE: usize = 512 << 20;
/// Bytes that may be under way before they are taken: an answer of usual size comes in one go.
const WINDOW: u32 = 4 << 20;

pub type Stub = MeshServiceClient<Channel>;

/// How a connection is encrypted; all files are PEM.
#[derive(Clone, Debug, Default)]
pub struct Tls {
    /// Certificates of the authorities that are trusted; the system's if absent.
    pub authorities: Option<PathBuf>,
    /// The client's own certificate and private key, where the server asks for one (mTLS).
    pub identity: Option<(PathBuf, PathBuf)>,
    /// The name that the server's certificate has to have; that of the address if absent.
    pub server_name: Option<String>,
}

/// When a call is tried again: with growing pauses, as long as its timeout allows.
///
/// A server that cannot be reached or is about to stop ([`Code::Unavailable`]) is always worth another try, one that is
/// full ([`Code::ResourceExhausted`]) if it says when, and not before. All calls are safe to repeat: they change nothing,
/// or carry a request id by which the server recognises them.
///
/// The pause before attempt k + 1 is what the server asks for, plus a random share of `first_pause * 2^(k-1)`, so that
/// those who failed together do not come back together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Retry {
    /// How often a call is tried in all; 1 for never again.
    pub attempts: u32,
    /// The pause to begin with.
    pub first_pause: Duration,
    /// Beyond which pauses do not grow.
    pub longest_pause: Duration,
}

impl Default for Retry {
    fn default() -> Self {
        Self { attempts: 10, first_pause: Duration::from_millis(100), longest_pause: Duration::from_secs(5) }
    }
}

/// Of a connection.
#[derive(Clone, Debug)]
pub struct Options {
    /// Says who you are; it goes with every call, so use it with `tls` unless the network is your own.
    pub token: Option<String>,
    /// Plain text without.
    pub tls: Option<Tls>,
    /// How long a call other than `create_setup` may take in all, with what is tried again; no limit if absent.
    pub timeout: Option<Duration>,
    /// When a call that failed is tried again.
    pub retry: Retry,
}

impl Default for Options {
    fn default() -> Self {
        Self { token: None, tls: None, timeout: Some(Duration::from_secs(600)), retry: Retry::default() }
    }
}

#[derive(Debug)]
pub struct Connection {
    stub: Stub,
    authorization: Option<MetadataValue<Ascii>>,
    retry: Retry,
}

impl Connection {
    /// Connects when it is first used.
    pub fn new(address: &str, options: &Options) -> Result<Self, Error> {
        let scheme = if options.tls.is_some() { "https" } else { "http" };
        let not_usable = |error: tonic::transport::Error| Error::client(format!("{address}: {error:?}"));
        let mut endpoint = Endpoint::from_shared(format!("{scheme}://{address}"))
            .map_err(not_usable)?
            .connect_timeout(Duration::from_secs(20))
            .initial_stream_window_size(WINDOW)
            .initial_connection_window_size(2 * WINDOW)
            // A server that has gone without a word is noticed while a long call waits for it.
            .http2_keep_alive_interval(Duration::from_secs(60));
        if let Some(tls) = &options.tls {
            endpoint = endpoint.tls_config(tls_config(tls)?).map_err(not_usable)?;
        }
        let authorization = match &options.token {
            None => None,
            Some(token) => Some(
                format!("Bearer {token}")
                    .parse()
                    .map_err(|_| Error::client("the token has characters that a header cannot have"))?,
            ),
        };
        let stub = MeshServiceClient::new(endpoint.connect_lazy())
            .max_decoding_message_size(LARGEST_MESSAGE)
            .max_encoding_message_size(LARGEST_MESSAGE);
        Ok(Self { stub, authorization, retry: options.retry })
    }

    /// One request, one answer.
    pub async fn call<Q, A, F>(
        &self,
        deadline: Deadline,
        message: Q,
        method: impl Fn(Stub, Request<Q>) -> F,
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

    /// Runs attempts until one succeeds. Gives what the last one failed with.
    pub async fn attempts<A, F>(
        &self,
        deadline: Deadline,
        attempt: impl Fn(Stub, Request<()>) -> F,
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

    /// What goes with every call.
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

/// The end of the time that an operation may take over all its calls.
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
            // A server that ends a call at its deadline may say so in this way.
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
