//! The life of a service on a port, from binding its address to draining its requests: the same for every service.

use std::{io::Write, net::SocketAddr, num::NonZeroUsize, path::PathBuf, sync::Arc, time::Duration};

use axum::http::HeaderValue;
use clap::Args;
use moldline_host::PoolLimits;
use moldline_transport::{
    Access, Gauges, Health, Port, Served, Surroundings, TlsError, TlsFiles, acceptor, metrics_upkeep, router,
    start_metrics,
    tokens::{TokenFile, TokenFileError},
};
use tokio::{runtime, sync::oneshot, time};

use crate::{shutdown, telemetry, values};

/// Options of a service's port, its access and its end.
#[derive(Debug, Args)]
pub struct ListenOptions {
    /// Address to listen on; port 0 takes a free one. Standard output gets one line with the bound address
    #[arg(long, env = "MOLDLINE_LISTEN", default_value = "127.0.0.1:50051", value_parser = values::address)]
    pub listen: SocketAddr,
    /// Allow an address that other machines can reach, without authentication
    #[arg(long, env = "MOLDLINE_INSECURE_LISTEN")]
    pub insecure_listen: bool,
    /// Require a token of this file (`moldline token create`); changes of the file take effect at once
    #[arg(long, env = "MOLDLINE_TOKENS", value_name = "FILE")]
    pub tokens: Option<PathBuf>,
    /// Certificate chain of the server, PEM
    #[arg(long, env = "MOLDLINE_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Private key of the server, PEM
    #[arg(long, env = "MOLDLINE_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Require client certificates signed by one of these authorities, PEM. A certificate names its tenant by a URI
    /// `moldline://TENANT/ROLE` among its alternative names, or by its common name. Optional for callers with a token
    #[arg(long, env = "MOLDLINE_CLIENT_CA", value_name = "FILE", requires = "tls_cert")]
    pub client_ca: Option<PathBuf>,
    /// Allow calls from web pages of this origin, as in `https://example.org`
    #[arg(long, env = "MOLDLINE_CORS_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    pub cors_origin: Vec<HeaderValue>,
    /// Seconds between the first failing health probe and the closing of the port; one probe interval
    #[arg(long, env = "MOLDLINE_DRAIN_DELAY", default_value_t = 0.0, value_name = "SECONDS", value_parser = values::seconds)]
    pub drain_delay: f64,
    /// Seconds for running requests to finish
    #[arg(long, env = "MOLDLINE_DRAIN_TIMEOUT", default_value_t = 30.0, value_name = "SECONDS", value_parser = values::seconds)]
    pub drain_timeout: f64,
}

/// Options of a service's compute pool.
#[derive(Debug, Args)]
pub struct ComputeOptions {
    /// Compute threads; results do not depend on their number [default: one per core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
    /// Requests that compute at a time and share the threads [default: the number of threads]
    #[arg(long, env = "MOLDLINE_RUNNING")]
    pub running: Option<NonZeroUsize>,
    /// Requests that wait for their turn; further ones are refused
    #[arg(long, env = "MOLDLINE_QUEUED", default_value_t = 64)]
    pub queued: usize,
    /// Requests of one tenant that compute or wait
    #[arg(long, env = "MOLDLINE_TENANT_LOAD", default_value_t = 64)]
    pub tenant_load: usize,
    /// Seconds that one piece of work may take (a build, a deformation, a product, a check); then it is given up
    #[arg(long, env = "MOLDLINE_MAX_WORK", default_value_t = 600.0, value_name = "SECONDS", value_parser = values::seconds)]
    pub max_work: f64,
    /// Largest message received, MiB
    #[arg(long, env = "MOLDLINE_MAX_MESSAGE", default_value_t = 64, value_name = "MIB")]
    pub max_message: usize,
}

impl ComputeOptions {
    /// The size of the pool.
    pub fn pool(&self) -> PoolLimits {
        let threads = values::threads(self.threads);
        let running = self.running.map_or(threads, NonZeroUsize::get);
        PoolLimits { threads, running, queued: self.queued, work: Duration::from_secs_f64(self.max_work) }
    }
}

/// A server that does not start, or ends badly.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address can be reached from outside, and authentication is off.
    #[error(
        "other machines can reach {0}, and this server does not authenticate its callers; listen on 127.0.0.1, require \
         tokens (--tokens) or client certificates (--client-ca), or give --insecure-listen if the network around it \
         authenticates them"
    )]
    Public(SocketAddr),
    /// The compute threads do not start.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The store cannot be opened.
    #[error(transparent)]
    Store(#[from] moldline_mesh_service::StoreError),
    /// The asynchronous runtime does not start.
    #[error("cannot start: {0}")]
    Start(#[from] std::io::Error),
    /// The address cannot be bound.
    #[error("cannot listen on {0}: {1}")]
    Listen(SocketAddr, std::io::Error),
    /// The token file cannot be read.
    #[error("cannot read the tokens: {0}")]
    Tokens(#[from] TokenFileError),
    /// The certificates or the key cannot be read.
    #[error("cannot use TLS: {0}")]
    Tls(#[from] TlsError),
    /// The metrics recorder cannot be installed.
    #[error("cannot record metrics: {0}")]
    Metrics(String),
    /// The descriptors of gRPC reflection cannot be loaded.
    #[error("cannot describe the interface: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// Requests were still running after the drain timeout.
    #[error("{0} requests were still running after the drain timeout and were abandoned")]
    Abandoned(usize),
}

/// A service for [`serve`].
pub struct Parts {
    /// Its gRPC and HTTP routes.
    pub served: Served,
    /// Its answer to health probes.
    pub health: Health,
    /// Records its gauges before /metrics is answered.
    pub gauges: Gauges,
    /// The number of its requests that compute or wait.
    pub load: Arc<dyn Fn() -> usize + Send + Sync>,
}

/// A runtime for requests, which compute elsewhere. The second thread keeps health probes answered.
pub(crate) fn runtime() -> Result<runtime::Runtime, ServeError> {
    Ok(runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?)
}

/// Serves until the process is asked to stop, then lets running requests finish.
///
/// # Errors
/// If the server cannot start with these options, or requests outlast the drain timeout.
pub(crate) async fn serve(options: &ListenOptions, parts: Parts) -> Result<(), ServeError> {
    let access = access(options)?;
    if !options.listen.ip().is_loopback() && !access.asks() && !options.insecure_listen {
        return Err(ServeError::Public(options.listen));
    }
    let Parts { served, health, gauges, load } = parts;
    let port = Port::bind(options.listen, tls(options)?)
        .await
        .map_err(|error| ServeError::Listen(options.listen, error))?;
    let address = port.address()?;
    let metrics = start_metrics().map_err(ServeError::Metrics)?;
    tokio::spawn(metrics_upkeep(metrics.clone()));

    // Caught before the address is announced: a program that knows it may send a signal at once.
    let mut signals = shutdown::Signals::catch()?;
    announce(address, options, &access)?;
    let surroundings = Surroundings {
        access: Arc::new(access),
        health: health.clone(),
        metrics,
        gauges,
        trace: telemetry::follow,
        origins: options.cors_origin.clone(),
    };
    let app = router(served, surroundings);
    let (close, closed) = oneshot::channel::<()>();
    let mut server = tokio::spawn(port.serve(app, async {
        let _ = closed.await;
    }));

    tokio::select! {
        () = signals.requested() => {}
        // The server ends only on `close`, or by failing.
        ended = &mut server => return ended.map_err(|error| ServeError::Start(std::io::Error::other(error))),
    }
    tracing::info!(running = load(), "asked to stop: letting running requests finish");
    health.end().await;
    time::sleep(Duration::from_secs_f64(options.drain_delay)).await;
    let _ = close.send(());
    tokio::select! {
        _ = &mut server => {}
        () = shutdown::idle(&*load) => {}
        () = time::sleep(Duration::from_secs_f64(options.drain_timeout)) => {
            if load() > 0 {
                return Err(ServeError::Abandoned(load()));
            }
        }
    }
    tracing::info!("stopped");
    Ok(())
}

fn access(options: &ListenOptions) -> Result<Access, ServeError> {
    let tokens = options.tokens.as_ref().map(TokenFile::open).transpose()?;
    Ok(Access { tokens, certificates: options.client_ca.is_some() })
}

fn tls(options: &ListenOptions) -> Result<Option<tokio_rustls::TlsAcceptor>, ServeError> {
    let (Some(certificate), Some(key)) = (&options.tls_cert, &options.tls_key) else { return Ok(None) };
    let client_optional = options.tokens.is_some();
    let client_authority = options.client_ca.as_deref();
    Ok(Some(acceptor(TlsFiles { certificate, key, client_authority, client_optional })?))
}

/// Announces the address: to programs on standard output, to people in the log.
fn announce(address: SocketAddr, options: &ListenOptions, access: &Access) -> Result<(), ServeError> {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{}", serde_json::json!({ "event": "listening", "address": address.to_string() }))?;
    output.flush()?;
    let scheme = if options.tls_cert.is_some() { "https" } else { "http" };
    tracing::info!(%address, docs = format!("{scheme}://{address}/docs"), "listening");
    if access.asks() {
        if !address.ip().is_loopback() && options.tls_cert.is_none() {
            tracing::warn!(
                "tokens travel in the clear: use --tls-cert and --tls-key, or a TLS proxy in front"
            );
        }
    } else if address.ip().is_loopback() {
        tracing::warn!("no authentication: every user of this machine can use this server");
    } else {
        tracing::warn!(%address, "NO AUTHENTICATION: EVERY MACHINE THAT REACHES THIS ADDRESS CAN USE THIS SERVER");
    }
    Ok(())
}
