//! A service on a port, from its address to its orderly end: the same for every service of this program.

use std::{io::Write, net::SocketAddr, sync::Arc, time::Duration};

use moldline_transport::{
    Access, Gauges, Health, Port, Served, Surroundings, TlsError, TlsFiles, acceptor, metrics_upkeep, router,
    start_metrics,
    tokens::{TokenFile, TokenFileError},
};
use tokio::{runtime, sync::oneshot, time};

use crate::{config::Listen, shutdown, telemetry};

/// Why the server does not start, or ends badly.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is reachable from outside and nobody is authenticated.
    #[error(
        "{0} can be reached by other machines, and this server does not ask who they are; listen on 127.0.0.1, ask for \
         tokens (--tokens) or client certificates (--client-ca), or say --insecure-listen if the network around it does"
    )]
    Public(SocketAddr),
    /// No threads.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The store is not to be had.
    #[error(transparent)]
    Store(#[from] moldline_service::StoreError),
    /// No runtime.
    #[error("cannot start: {0}")]
    Start(#[from] std::io::Error),
    /// The address is not to be had.
    #[error("cannot listen on {0}: {1}")]
    Listen(SocketAddr, std::io::Error),
    /// Tokens cannot be read.
    #[error("cannot read the tokens: {0}")]
    Tokens(#[from] TokenFileError),
    /// Certificates cannot be read.
    #[error("cannot use TLS: {0}")]
    Tls(#[from] TlsError),
    /// Nothing is counted.
    #[error("cannot count: {0}")]
    Metrics(String),
    /// Reflection's descriptors do not load.
    #[error("cannot describe the interface: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// Requests were still running.
    #[error("{0} requests were still running after the drain timeout and were abandoned")]
    Abandoned(usize),
}

/// What a service brings.
pub struct Parts {
    /// Its routes.
    pub served: Served,
    /// What probes are told of it.
    pub health: Health,
    /// What is counted of it when somebody asks.
    pub gauges: Gauges,
    /// Requests that compute or wait for it.
    pub load: Arc<dyn Fn() -> usize + Send + Sync>,
}

/// A runtime for requests. They are few and compute elsewhere: one thread more than one keeps health probes answered.
pub fn runtime() -> Result<runtime::Runtime, ServeError> {
    Ok(runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?)
}

/// Serves until asked to stop, then finishes what runs.
pub async fn serve(options: &Listen, parts: Parts) -> Result<(), ServeError> {
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

    // Before anyone learns of the server: who knows its address may already ask it to stop.
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
        // It ends when it is told to, or fails.
        ended = &mut server => return ended.map_err(|error| ServeError::Start(std::io::Error::other(error))),
    }
    tracing::info!(running = load(), "asked to stop: finishing what runs");
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

fn access(options: &Listen) -> Result<Access, ServeError> {
    let tokens = options.tokens.as_ref().map(TokenFile::open).transpose()?;
    Ok(Access { tokens, certificates: options.client_ca.is_some() })
}

fn tls(options: &Listen) -> Result<Option<tokio_rustls::TlsAcceptor>, ServeError> {
    let (Some(certificate), Some(key)) = (&options.tls_cert, &options.tls_key) else { return Ok(None) };
    let client_optional = options.tokens.is_some();
    let client_authority = options.client_ca.as_deref();
    Ok(Some(acceptor(TlsFiles { certificate, key, client_authority, client_optional })?))
}

/// Says where the server listens: to programs on standard output, to people in the log.
fn announce(address: SocketAddr, options: &Listen, access: &Access) -> Result<(), ServeError> {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{}", serde_json::json!({ "event": "listening", "address": address.to_string() }))?;
    output.flush()?;
    let scheme = if options.tls_cert.is_some() { "https" } else { "http" };
    tracing::info!(%address, docs = format!("{scheme}://{address}/docs"), "listening");
    if access.asks() {
        if !address.ip().is_loopback() && options.tls_cert.is_none() {
            tracing::warn!(
                "tokens travel in the clear: use --tls-cert and --tls-key, or a proxy with TLS before it"
            );
        }
    } else if address.ip().is_loopback() {
        tracing::warn!("no authentication: every user of this machine can use this server");
    } else {
        tracing::warn!(%address, "NO AUTHENTICATION: EVERY MACHINE THAT REACHES THIS ADDRESS CAN USE THIS SERVER");
    }
    Ok(())
}
