//! `moldline serve`: the mesh service on a port.

use std::sync::Arc;

use metrics::{counter, gauge};
use moldline_service::{CacheStatus, Principal, Service, Store};
use moldline_transport::{Gauges, Served};

use crate::{
    config::Serve,
    grpc, http,
    mesh::Meshes,
    shell::{self, Parts, ServeError},
};

/// Serves until asked to stop, then finishes what runs.
pub fn run(options: &Serve) -> Result<(), crate::local::Failure> {
    let runtime = shell::runtime()?;
    let outcome = runtime.block_on(async {
        let store = Store::open(&options.store).await?;
        let service = Service::with_store(store, options.compute.pool(), options.limits())?;
        serve(options, Arc::new(service)).await
    });
    runtime.shutdown_background();
    Ok(outcome?)
}

async fn serve(options: &Serve, service: Arc<Service>) -> Result<(), ServeError> {
    let pool = options.compute.pool();
    tracing::info!(
        threads = pool.threads,
        running = pool.running,
        queued = pool.queued,
        store = options.store,
        "computing"
    );
    if options.store == "memory" {
        tracing::warn!("set-ups and sessions end with this server");
    }
    shell::serve(&options.listen, parts(service, options.compute.max_message << 20).await?).await
}

/// The mesh service as the shell takes it.
pub async fn parts(service: Arc<Service>, max_message: usize) -> Result<Parts, ServeError> {
    let meshes = Meshes::new(Arc::clone(&service));
    let (grpc, open, health) = grpc::routes(meshes.clone(), max_message).await?;
    let http = http::routes(meshes, max_message);
    let gauges = gauges(Arc::clone(&service));
    let load = Arc::new(move || service.load());
    Ok(Parts { served: Served { http, grpc, open }, health, gauges, load })
}

/// Load and memory, for /metrics.
fn gauges(service: Arc<Service>) -> Gauges {
    Arc::new(move || {
        let service = Arc::clone(&service);
        Box::pin(async move {
            match service.status(&Principal::local()).await {
                Ok(status) => tell(&status),
                Err(error) => tracing::warn!(%error, "cannot say what is under way"),
            }
        })
    })
}

fn tell(status: &moldline_service::Status) {
    gauge!("moldline_uptime_seconds").set(status.uptime.as_secs_f64());
    gauge!("moldline_compute_running").set(status.running as f64);
    gauge!("moldline_compute_running_limit").set(status.running_limit as f64);
    gauge!("moldline_compute_queued").set(status.queued as f64);
    gauge!("moldline_compute_queued_limit").set(status.queued_limit as f64);
    gauge!("moldline_sessions").set(status.sessions as f64);
    gauge!("moldline_setups_resident").set(status.setups_resident as f64);
    gauge!("moldline_setups_stored").set(status.setups_stored as f64);
    gauge!("moldline_stored_bytes").set(status.stored_bytes as f64);
    tell_cache("setups", &status.setup_cache);
    tell_cache("linearisations", &status.linearisation_cache);
}

/// How full a cache is, and how well it serves.
pub fn tell_cache(name: &'static str, cache: &CacheStatus) {
    gauge!("moldline_cache_entries", "cache" => name).set(cache.entries as f64);
    gauge!("moldline_cache_bytes", "cache" => name).set(cache.bytes as f64);
    gauge!("moldline_cache_budget_bytes", "cache" => name).set(cache.budget as f64);
    counter!("moldline_cache_hits_total", "cache" => name).absolute(cache.hits);
    counter!("moldline_cache_misses_total", "cache" => name).absolute(cache.misses);
    counter!("moldline_cache_evictions_total", "cache" => name).absolute(cache.evictions);
}
