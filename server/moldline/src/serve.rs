//! `moldline serve`, from configuration to exit code.

use std::{io::Write, net::SocketAddr, sync::Arc, time::Duration};

use moldline_service::{Service, Store, StoreError};
use tokio::{net::TcpListener, runtime, sync::oneshot, time};
use tonic::transport::server::TcpIncoming;

use crate::{config::Serve, grpc, shutdown};

/// Why the server does not start, or ends badly.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The address is reachable from outside and nobody is authenticated.
    #[error(
        "{0} can be reached by other machines, and this server does not ask who they are; listen on 127.0.0.1, \
         or say --insecure-listen if the network around it does"
    )]
    Public(SocketAddr),
    /// No threads.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// The store is not to be had.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// No runtime.
    #[error("cannot start: {0}")]
    Start(#[from] std::io::Error),
    /// The address is not to be had.
    #[error("cannot listen on {0}: {1}")]
    Listen(SocketAddr, std::io::Error),
    /// Reflection's descriptors do not load.
    #[error("cannot describe the interface: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
    /// The transport failed.
    #[error("the transport failed: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// Requests were still running.
    #[error("{0} requests were still running after the drain timeout and were abandoned")]
    Abandoned(usize),
}

/// Serves until asked to stop, then finishes what runs.
pub fn run(options: &Serve) -> Result<(), crate::local::Failure> {
    if !options.listen.ip().is_loopback() && !options.insecure_listen {
        return Err(ServeError::Public(options.listen).into());
    }
    // Requests are few and compute elsewhere: one thread more than one keeps health probes answered.
    let runtime = runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(ServeError::from)?;
    let outcome = runtime.block_on(async {
        let store = Store::open(&options.store).await?;
        let service = Service::with_store(store, options.pool(), options.limits())?;
        serve(options, Arc::new(service)).await
    });
    runtime.shutdown_background();
    Ok(outcome?)
}

async fn serve(options: &Serve, service: Arc<Service>) -> Result<(), ServeError> {
    let listener =
        TcpListener::bind(options.listen).await.map_err(|error| ServeError::Listen(options.listen, error))?;
    let address = listener.local_addr()?;
    let (router, health) = grpc::router(Arc::clone(&service), options.max_message << 20).await?;

    // Before anyone learns of the server: who knows its address may already ask it to stop.
    let mut signals = shutdown::Signals::catch()?;
    announce(address, options)?;
    let (close, closed) = oneshot::channel::<()>();
    // Small messages leave at once: without it answers wait for the acknowledgement of the one before.
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    let mut server = tokio::spawn(router.serve_with_incoming_shutdown(incoming, async {
        let _ = closed.await;
    }));

    tokio::select! {
        () = signals.requested() => {}
        ended = &mut server => return flatten(ended),
    }
    tracing::info!(running = service.load(), "asked to stop: finishing what runs");
    health.end().await;
    time::sleep(Duration::from_secs_f64(options.drain_delay)).await;
    let _ = close.send(());
    tokio::select! {
        ended = &mut server => flatten(ended)?,
        () = shutdown::idle(&service) => {}
        () = time::sleep(Duration::from_secs_f64(options.drain_timeout)) => {
            if service.load() > 0 {
                return Err(ServeError::Abandoned(service.load()));
            }
        }
    }
    tracing::info!("stopped");
    Ok(())
}

fn flatten(
    ended: Result<Result<(), tonic::transport::Error>, tokio::task::JoinError>,
) -> Result<(), ServeError> {
    match ended {
        Ok(outcome) => Ok(outcome?),
        Err(error) => Err(ServeError::Start(std::io::Error::other(error))),
    }
}

/// Says where the server listens: to programs on standard output, to people in the log.
fn announce(address: SocketAddr, options: &Serve) -> Result<(), ServeError> {
    let mut output = std::io::stdout().lock();
    writeln!(output, "{}", serde_json::json!({ "event": "listening", "address": address.to_string() }))?;
    output.flush()?;
    let pool = options.pool();
    tracing::info!(%address, threads = pool.threads, running = pool.running, queued = pool.queued, store = options.store, "listening");
    if options.store == "memory" {
        tracing::warn!("set-ups and sessions end with this server");
    }
    if address.ip().is_loopback() {
        tracing::warn!("no authentication: every user of this machine can use this server");
    } else {
        tracing::warn!(%address, "NO AUTHENTICATION: EVERY MACHINE THAT REACHES THIS ADDRESS CAN USE THIS SERVER");
    }
    Ok(())
}
