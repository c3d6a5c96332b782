//! The life of a service on a port, from binding its address to draining its requests: the same for every service.

use std::{io::Write, net::SocketAddr, num::NonZeroUsize, path::PathBuf, sync::Arc, time::Duration};

use axum::http::HeaderValue;
use clap::Args;
use metrics::gauge;
use moldline_host::{PoolLimits, Sharing};
use moldline_transport::{
    Access, ConnectionLimits, Connections, Gauges, Health, Port, Served, Surroundings, Tls, TlsError,
    TlsFiles, acceptor, administration, metrics_upkeep, raise_file_limit, router, start_metrics,
    tokens::{TokenFile, TokenFileError},
};
use tokio::{runtime, sync::oneshot, time};

use crate::{machine, quotas::QuotaFileError, shutdown, telemetry, values};

/// Options of a service's port, its access and its end.
#[derive(Debug, Args)]
pub struct ListenOptions {
    /// Address to listen on; port 0 takes a free one. Standard output gets one line with the bound address
    #[arg(long, env = "MOLDLINE_LISTEN", default_value = "127.0.0.1:50051", value_parser = values::address)]
    pub listen: SocketAddr,
    /// Address of a second port with /healthz, /readyz and /metrics alone, which asks for no credentials: for orchestrators and
    /// collectors, in a network of their own. Standard output gets a second line with it
    #[arg(long, env = "MOLDLINE_ADMIN_LISTEN", value_name = "ADDRESS")]
    pub admin_listen: Option<SocketAddr>,
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
    /// Client certificates that their authorities have revoked (CRL), PEM; SIGHUP reads it again
    #[arg(long, env = "MOLDLINE_CLIENT_CRL", value_name = "FILE", requires = "client_ca")]
    pub client_crl: Option<PathBuf>,
    /// Allow calls from web pages of this origin, as in `https://example.org`
    #[arg(long, env = "MOLDLINE_CORS_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    pub cors_origin: Vec<HeaderValue>,
    /// Connections at a time; beyond it those silent longest make room [default: 10000, less where open files are few]
    #[arg(long, env = "MOLDLINE_MAX_CONNECTIONS", value_name = "COUNT")]
    pub max_connections: Option<NonZeroUsize>,
    /// The same from one address [default: half of all]
    #[arg(long, env = "MOLDLINE_MAX_PEER_CONNECTIONS", value_name = "COUNT")]
    pub max_peer_connections: Option<NonZeroUsize>,
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
    /// Memory of the server, MiB: caches, and what requests take while they are under way, which are refused beyond it
    /// [default: three quarters of the machine's or container's]
    #[arg(long, env = "MOLDLINE_MEMORY", value_name = "MIB")]
    pub memory: Option<u64>,
    /// Largest message received, MiB
    #[arg(long, env = "MOLDLINE_MAX_MESSAGE", default_value_t = 64, value_name = "MIB")]
    pub max_message: usize,
}

impl ListenOptions {
    /// Whether several tenants share the server.
    pub fn sharing(&self) -> Sharing {
        if self.tokens.is_some() || self.client_ca.is_some() { Sharing::Fair } else { Sharing::Alone }
    }
}

impl ComputeOptions {
    /// Memory of the server, bytes.
    pub fn memory(&self) -> u64 {
        self.memory.map_or_else(|| machine::memory() / 4 * 3, |given| given.saturating_mul(1 << 20))
    }

    /// The size of the pool.
    pub fn pool(&self) -> PoolLimits {
        let threads = values::threads(self.threads);
        let running = self.running.map_or(threads, NonZeroUsize::get);
        PoolLimits { threads, running, queued: self.queued, work: Duration::from_secs_f64(self.max_work) }
    }
}

/// What is left of the memory for requests, bytes, where caches take `cached`.
///
/// # Errors
/// If that is less than a few requests need.
pub fn working_memory(total: u64, cached: u64) -> Result<u64, ServeError> {
    /// A small build, or a few messages.
    const LEAST: u64 = 64 << 20;
    match total.checked_sub(cached) {
        Some(working) if working >= LEAST => Ok(working),
        _ => Err(ServeError::Memory { total: total >> 20, cached: cached >> 20, least: LEAST >> 20 }),
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
    /// The caches leave too little memory.
    #[error(
        "of {total} MiB of memory (--memory) the caches take {cached} MiB, and requests need {least} MiB at least; give the \
         server more, or its caches less"
    )]
    Memory {
        /// All memory, MiB.
        total: u64,
        /// That of the caches, MiB.
        cached: u64,
        /// Least memory for requests, MiB.
        least: u64,
    },
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
    /// The quotas of single tenants cannot be read.
    #[error("cannot read the quotas: {0}")]
    Quotas(#[from] QuotaFileError),
    /// The metrics recorder cannot be installed.
    #[error("cannot record metrics: {0}")]
    Metrics(String),
    /// The descriptors of gRPC reflection cannot be loaded.
    #[error("cannot describe the interface: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// Requests were still running after the drain timeout.
    #[error(
        "{0} requests were still running, or their answers on the way, after the drain timeout and were cut off"
    )]
    Abandoned(usize),
}

/// Reads the files of a service again, which stays as it was if it cannot.
pub type Reload = Box<dyn Fn() -> Result<(), ServeError> + Send + Sync>;

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
    /// Called on SIGHUP.
    pub reload: Reload,
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
    let Parts { served, health, gauges, load, reload } = parts;
    let tls = tls(options)?.map(Tls::new);
    let port = Port::bind(options.listen, tls.clone(), connection_limits(options, raise_file_limit()))
        .await
        .map_err(|error| ServeError::Listen(options.listen, error))?;
    let address = port.address()?;
    let metrics = start_metrics().map_err(ServeError::Metrics)?;
    tokio::spawn(metrics_upkeep(metrics.clone()));

    // Caught before the address is announced: a program that knows it may send a signal at once.
    let mut signals = shutdown::Signals::catch()?;
    announce(address, options, &access)?;
    let local = address.ip().is_loopback() && !access.asks() && !options.insecure_listen;
    let gauges = with_connections(gauges, port.connections());
    tokio::spawn(health.clone().follow());
    if let Some(address) = options.admin_listen {
        administer(address, administration(health.clone(), metrics.clone(), Arc::clone(&gauges))).await?;
    }
    let surroundings = Surroundings {
        access: Arc::new(access),
        health: health.clone(),
        metrics,
        gauges,
        trace: telemetry::follow,
        origins: options.cors_origin.clone(),
        local,
    };
    let app = router(served, surroundings);
    let connections = port.connections();
    let (close, closed) = oneshot::channel::<()>();
    let mut server = tokio::spawn(port.serve(app, async {
        let _ = closed.await;
    }));

    let reload = || {
        let certificates = self::tls(options).map(|acceptor| {
            if let (Some(tls), Some(acceptor)) = (&tls, acceptor) {
                tls.replace(acceptor);
                connections.renew();
            }
        });
        tracing::info!("asked to reload: reading certificates and quotas; tokens need no reload");
        for error in [certificates, reload()].into_iter().filter_map(Result::err) {
            tracing::error!(%error, "this stays as it was");
        }
    };
    tokio::select! {
        () = signals.requested(reload) => {}
        // The server ends only on `close`, or by failing.
        ended = &mut server => return ended.map_err(|error| ServeError::Start(std::io::Error::other(error))),
    }
    let running = connections.requests();
    tracing::info!(running, computing = load(), "asked to stop: letting running requests finish");
    health.end().await;
    time::sleep(Duration::from_secs_f64(options.drain_delay)).await;
    let _ = close.send(());
    // What still computes has lost its client: a request under way keeps its connection.
    let idle = || connections.open() == connections.watched();
    tokio::select! {
        _ = &mut server => {}
        () = shutdown::lasting(idle) => {}
        () = time::sleep(Duration::from_secs_f64(options.drain_timeout)) => {
            let owing = connections.owing();
            if owing > 0 {
                return Err(ServeError::Abandoned(owing));
            }
        }
    }
    tracing::info!("stopped");
    Ok(())
}

/// Records the number of connections too.
fn with_connections(gauges: Gauges, connections: Arc<Connections>) -> Gauges {
    gauge!("moldline_connections_limit").set(connections.limits().total as f64);
    Arc::new(move || {
        gauge!("moldline_connections").set(connections.open() as f64);
        gauges()
    })
}

/// Connections within the limit of open files, of which some stay for the store.
fn connection_limits(options: &ListenOptions, files: Option<u64>) -> ConnectionLimits {
    /// Connections where there are files for them.
    const USUAL: usize = 10_000;
    let total = match files {
        None => options.max_connections.map_or(USUAL, NonZeroUsize::get),
        Some(files) => {
            let kept = (files / 4).clamp(64, 1024);
            let most = usize::try_from(files.saturating_sub(kept)).unwrap_or(usize::MAX).max(1);
            options.max_connections.map_or(USUAL, NonZeroUsize::get).min(most)
        }
    };
    let of_peer = options.max_peer_connections.map_or((total / 2).max(1), NonZeroUsize::get).min(total);
    tracing::info!(files, connections = total, of_one_address = of_peer, "connections");
    ConnectionLimits { total, of_peer }
}

/// Serves probes and metrics on a thread of its own, so that they are answered whatever the others do.
async fn administer(address: SocketAddr, app: axum::Router) -> Result<(), ServeError> {
    /// More than all probes and collectors.
    const LIMITS: ConnectionLimits = ConnectionLimits { total: 64, of_peer: 64 };
    let (bound, told) = oneshot::channel();
    let serve = async move {
        match Port::bind(address, None, LIMITS).await {
            Ok(port) => {
                let _ = bound.send(port.address());
                port.serve(app, std::future::pending()).await;
            }
            Err(error) => {
                let _ = bound.send(Err(error));
            }
        }
    };
    let runtime = runtime::Builder::new_current_thread().enable_all().build()?;
    std::thread::Builder::new().name("probes".to_owned()).spawn(move || runtime.block_on(serve))?;
    let failed = |error| ServeError::Listen(address, error);
    let address = told.await.map_err(|error| failed(std::io::Error::other(error)))?.map_err(failed)?;
    let mut output = std::io::stdout().lock();
    writeln!(
        output,
        "{}",
        serde_json::json!({ "event": "listening for probes", "address": address.to_string() })
    )?;
    output.flush()?;
    tracing::info!(%address, "listening for probes");
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
    let revoked = options.client_crl.as_deref();
    Ok(Some(acceptor(TlsFiles { certificate, key, client_authority, client_optional, revoked })?))
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
