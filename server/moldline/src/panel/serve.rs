//! `moldline panel serve`: the panel method on a port.

use std::sync::Arc;

use clap::Args;
use metrics::gauge;
use moldline_host::{ComputePool, Supply};
use moldline_panel_service::{PanelService, Status};
use moldline_transport::{Admission, Gauges, Served};

use super::{
    api::{self, PanelApi},
    grpc, http,
};
use crate::{
    failure::Failure,
    serve::{record_cache, record_memory},
    shell::{self, ComputeOptions, ListenOptions, Parts, ServeError},
};

/// Options of `moldline panel serve`.
#[derive(Debug, Args)]
pub struct PanelServeOptions {
    /// The port.
    #[command(flatten)]
    pub listen: ListenOptions,
    /// The compute pool.
    #[command(flatten)]
    pub compute: ComputeOptions,
    /// Memory of all analyses, MiB, including those in progress; an analysis that needs more is refused [default: half of
    /// --memory, 4096 at most]
    #[arg(long, env = "MOLDLINE_ANALYSIS_MEMORY", value_name = "MIB")]
    pub analysis_memory: Option<u64>,
    /// Memory of all configurations, MiB [default: an eighth of --memory, 512 at most]
    #[arg(long, env = "MOLDLINE_CONFIGURATION_MEMORY", value_name = "MIB")]
    pub configuration_memory: Option<u64>,
}

impl PanelServeOptions {
    /// Limits of the service.
    pub fn limits(&self) -> moldline_panel_service::Limits {
        let total = self.compute.memory();
        let mebibytes =
            |given: Option<u64>, usual: u64| given.map_or(usual, |given| given.saturating_mul(1 << 20));
        moldline_panel_service::Limits {
            solution_bytes: mebibytes(self.analysis_memory, (total / 2).min(4 << 30)),
            configuration_bytes: mebibytes(self.configuration_memory, (total / 8).min(512 << 20)),
            ..Default::default()
        }
    }
}

/// Serves until the process is asked to stop, then lets running requests finish.
pub(crate) fn run(options: &PanelServeOptions) -> Result<(), Failure> {
    let pool = options.compute.pool();
    let (limits, sharing) = (options.limits(), options.listen.sharing());
    let cached = limits.solution_bytes.saturating_add(limits.configuration_bytes);
    let working = shell::working_memory(options.compute.memory(), cached)?;
    let memory = Supply::new("bytes of working memory", "--memory", working, sharing);
    let compute =
        ComputePool::sharing(pool, options.compute.tenant_load, sharing, memory).map_err(ServeError::from)?;
    let service = Arc::new(PanelService::new(Arc::new(compute), limits));
    let runtime = shell::runtime()?;
    let outcome = runtime.block_on(async {
        tracing::info!(threads = pool.threads, running = pool.running, queued = pool.queued, "computing");
        shell::serve(&options.listen, parts(service, options.compute.max_message << 20).await?).await
    });
    runtime.shutdown_background();
    Ok(outcome?)
}

/// The panel service on its routes. Messages may have `max_message` bytes.
///
/// # Errors
/// If the descriptors of gRPC reflection cannot be loaded.
pub async fn parts(service: Arc<PanelService>, max_message: usize) -> Result<Parts, ServeError> {
    let api = PanelApi::new(Arc::clone(&service));
    let (grpc, open, health) = grpc::routes(api.clone(), max_message).await?;
    let http = http::routes(api, max_message);
    let gauges: Gauges = {
        let service = Arc::clone(&service);
        Arc::new(move || {
            record(&service.status());
            record_memory(service.memory());
            Box::pin(std::future::ready(()))
        })
    };
    let pool = Arc::clone(&service);
    let health = health.while_passes(move || pool.moving());
    let admission = Admission { memory: Arc::clone(service.memory()), methods: api::method, max_message };
    let load = Arc::new(move || service.load());
    let served = Served { http, grpc, open, admission };
    Ok(Parts { served, health, gauges, load, reload: Box::new(|| Ok(())) })
}

/// Records load and memory for /metrics.
fn record(status: &Status) {
    gauge!("moldline_uptime_seconds").set(status.uptime.as_secs_f64());
    gauge!("moldline_compute_running").set(status.running as f64);
    gauge!("moldline_compute_running_limit").set(status.pool.running as f64);
    gauge!("moldline_compute_queued").set(status.queued as f64);
    gauge!("moldline_compute_queued_limit").set(status.pool.queued as f64);
    record_cache("configurations", &status.configurations);
    record_cache("analyses", &status.solutions);
}
