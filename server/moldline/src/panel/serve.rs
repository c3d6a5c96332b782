//! `moldline panel serve`: the panel method on a port.

use std::sync::Arc;

use metrics::gauge;
use moldline_panel_service::{PanelService, Status};
use moldline_service::ComputePool;
use moldline_transport::{Gauges, Served};

use super::{Panels, grpc, http};
use crate::{
    config::PanelServe,
    serve::tell_cache,
    shell::{self, Parts, ServeError},
};

/// Serves until asked to stop, then finishes what runs.
pub fn run(options: &PanelServe) -> Result<(), crate::local::Failure> {
    let pool = options.compute.pool();
    let compute = ComputePool::new(pool, options.compute.tenant_load).map_err(ServeError::from)?;
    let service = Arc::new(PanelService::new(Arc::new(compute), options.limits()));
    let runtime = shell::runtime()?;
    let outcome = runtime.block_on(async {
        tracing::info!(threads = pool.threads, running = pool.running, queued = pool.queued, "computing");
        shell::serve(&options.listen, parts(service, options.compute.max_message << 20).await?).await
    });
    runtime.shutdown_background();
    Ok(outcome?)
}

/// The panel service as the shell takes it.
pub async fn parts(service: Arc<PanelService>, max_message: usize) -> Result<Parts, ServeError> {
    let panels = Panels::new(Arc::clone(&service));
    let (grpc, open, health) = grpc::routes(panels.clone(), max_message).await?;
    let http = http::routes(panels, max_message);
    let gauges: Gauges = {
        let service = Arc::clone(&service);
        Arc::new(move || {
            tell(&service.status());
            Box::pin(std::future::ready(()))
        })
    };
    let load = Arc::new(move || service.load());
    Ok(Parts { served: Served { http, grpc, open }, health, gauges, load })
}

/// Load and memory, for /metrics.
fn tell(status: &Status) {
    gauge!("moldline_uptime_seconds").set(status.uptime.as_secs_f64());
    gauge!("moldline_compute_running").set(status.running as f64);
    gauge!("moldline_compute_running_limit").set(status.pool.running as f64);
    gauge!("moldline_compute_queued").set(status.queued as f64);
    gauge!("moldline_compute_queued_limit").set(status.pool.queued as f64);
    tell_cache("configurations", &status.configurations);
    tell_cache("analyses", &status.solutions);
}
