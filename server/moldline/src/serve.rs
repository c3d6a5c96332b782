//! `moldline serve`: the mesh service on a port.

use std::{path::PathBuf, sync::Arc, time::Duration};

use clap::Args;
use metrics::{counter, gauge};
use moldline_host::{CacheStatus, Supply};
use moldline_mesh_service::{Limits, Service};
use moldline_transport::{Admission, Gauges, Served};
use tokio::sync::watch;

use crate::{
    api::{self, MeshApi},
    failure::Failure,
    grpc, http, quotas,
    shell::{self, ComputeOptions, ListenOptions, Parts, ServeError},
    store::Keeping,
};

/// Options of `moldline serve`.
#[derive(Debug, Args)]
pub struct ServeOptions {
    /// The port.
    #[command(flatten)]
    pub listen: ListenOptions,
    /// The compute pool.
    #[command(flatten)]
    pub compute: ComputeOptions,
    /// Largest upload, MiB
    #[arg(long, env = "MOLDLINE_MAX_UPLOAD", default_value_t = 256, value_name = "MIB")]
    pub max_upload: u64,
    /// Store of set-ups and sessions: a folder (created if missing), an object store such as s3://bucket/prefix (with
    /// AWS_ENDPOINT, AWS_ACCESS_KEY_ID and so on in the environment), or `memory`, which ends with the server
    #[arg(long, env = "MOLDLINE_STORE", default_value = "moldline-store", value_name = "PLACE")]
    pub store: String,
    /// Largest number of stored set-ups per tenant
    #[arg(long, env = "MOLDLINE_MAX_SETUPS", default_value_t = 1000)]
    pub max_setups: usize,
    /// Largest number of open sessions per tenant
    #[arg(long, env = "MOLDLINE_MAX_SESSIONS", default_value_t = 1000)]
    pub max_sessions: usize,
    /// Largest size of stored set-ups and sessions per tenant, MiB; 64 KiB of each session are free
    #[arg(long, env = "MOLDLINE_MAX_STORED", default_value_t = 65536, value_name = "MIB")]
    pub max_stored: u64,
    /// Quotas of single tenants in place of the three above, JSON; SIGHUP reads it again
    #[arg(long, env = "MOLDLINE_QUOTAS", value_name = "FILE")]
    pub quotas: Option<PathBuf>,
    /// Answer a tenant's first upload at once if others have the same content; otherwise it takes the time of its build, so that
    /// it does not tell what others have
    #[arg(long, env = "MOLDLINE_FAST_KNOWN_UPLOADS")]
    pub fast_known_uploads: bool,
    /// How the store is kept.
    #[command(flatten)]
    pub keeping: Keeping,
    /// Memory for set-ups, MiB; the least recently used are dropped, and loaded again when needed [default: a quarter of
    /// --memory, 4096 at most]
    #[arg(long, env = "MOLDLINE_SETUP_MEMORY", value_name = "MIB")]
    pub setup_memory: Option<u64>,
    /// Memory for linearisations, which derivative products need, MiB; the least recently used are dropped [default: an eighth
    /// of --memory, 2048 at most]
    #[arg(long, env = "MOLDLINE_LINEARISATION_MEMORY", value_name = "MIB")]
    pub linearisation_memory: Option<u64>,
    /// Uploads at a time
    #[arg(long, env = "MOLDLINE_UPLOADS", default_value_t = 16, value_name = "COUNT")]
    pub uploads: usize,
    /// Checks of derivatives at a time
    #[arg(long, env = "MOLDLINE_CHECKS", default_value_t = 1, value_name = "COUNT")]
    pub checks: usize,
}

impl ServeOptions {
    /// Limits of the service.
    ///
    /// # Errors
    /// If the caches take all the memory.
    pub fn limits(&self) -> Result<Limits, ServeError> {
        let total = self.compute.memory();
        let mebibytes =
            |given: Option<u64>, usual: u64| given.map_or(usual, |given| given.saturating_mul(1 << 20));
        let setups = mebibytes(self.setup_memory, (total / 4).min(4 << 30));
        let linearisations = mebibytes(self.linearisation_memory, (total / 8).min(2 << 30));
        Ok(Limits {
            memory: shell::working_memory(total, setups.saturating_add(linearisations))?,
            sharing: self.listen.sharing(),
            uploads: self.uploads,
            checks: self.checks,
            upload_bytes: self.max_upload.saturating_mul(1 << 20),
            setups: self.max_setups,
            sessions: self.max_sessions,
            stored_bytes: self.max_stored.saturating_mul(1 << 20),
            // Without credentials there is one tenant, from which nothing is to be hidden.
            hide_known: !self.fast_known_uploads
                && (self.listen.tokens.is_some() || self.listen.client_ca.is_some()),
            load: self.compute.tenant_load,
            setup_bytes: usize::try_from(setups).unwrap_or(usize::MAX),
            linearisation_bytes: usize::try_from(linearisations).unwrap_or(usize::MAX),
            ..Limits::default()
        })
    }
}

/// Serves until the process is asked to stop, then lets running requests finish.
pub(crate) fn run(options: &ServeOptions) -> Result<(), Failure> {
    let runtime = shell::runtime()?;
    let outcome = runtime.block_on(async {
        let store = options.keeping.open(&options.store).await?;
        options.keeping.start(store.clone());
        let service = Service::with_store(store, options.compute.pool(), options.limits()?)?;
        serve(options, Arc::new(service)).await
    });
    runtime.shutdown_background();
    Ok(outcome?)
}

async fn serve(options: &ServeOptions, service: Arc<Service>) -> Result<(), ServeError> {
    let pool = options.compute.pool();
    tracing::info!(
        threads = pool.threads,
        running = pool.running,
        queued = pool.queued,
        memory_mib = options.compute.memory() >> 20,
        working_memory_mib = service.memory().limit() >> 20,
        store = options.store,
        "computing"
    );
    if options.store == "memory" {
        tracing::warn!("the store is in memory: set-ups and sessions end with this server");
    }
    let mut parts = parts(Arc::clone(&service), options.compute.max_message << 20).await?;
    if let Some(file) = options.quotas.clone() {
        let usual = service.limits().quota();
        parts.reload = Box::new(move || {
            service.set_quotas(quotas::read(&file, usual)?);
            Ok(())
        });
        (parts.reload)()?;
    }
    shell::serve(&options.listen, parts).await
}

/// The mesh service on its routes. Messages may have `max_message` bytes.
///
/// # Errors
/// If the descriptors of gRPC reflection cannot be loaded.
pub async fn parts(service: Arc<Service>, max_message: usize) -> Result<Parts, ServeError> {
    let api = MeshApi::new(Arc::clone(&service));
    let (grpc, open, health) = grpc::routes(api.clone(), max_message).await?;
    let http = http::routes(api, max_message);
    let gauges = gauges(Arc::clone(&service));
    let store = watch_store(&service);
    let pool = Arc::clone(&service);
    let health = health.while_passes(move || {
        pool.moving()?;
        store.borrow().clone()
    });
    let admission = Admission { memory: Arc::clone(service.memory()), methods: api::method, max_message };
    let load = Arc::new(move || service.load());
    let served = Served { http, grpc, open, admission };
    Ok(Parts { served, health, gauges, load, reload: Box::new(|| Ok(())) })
}

/// What is wrong with the store, looked at every second as long as the service lives.
fn watch_store(service: &Arc<Service>) -> watch::Receiver<Result<(), String>> {
    let (sender, receiver) = watch::channel(Ok(()));
    let service = Arc::downgrade(service);
    tokio::spawn(async move {
        while let Some(service) = service.upgrade() {
            let health = service.store_health().await;
            drop(service);
            let _ = sender.send_replace(health.map(drop).map_err(|error| format!("the store: {error}")));
            tokio::time::sleep(Duration::from_secs(1)).await;
        }
    });
    receiver
}

/// Records load and memory for /metrics.
fn gauges(service: Arc<Service>) -> Gauges {
    Arc::new(move || {
        let service = Arc::clone(&service);
        Box::pin(async move {
            record(&service.figures().await);
            record_memory(service.memory());
        })
    })
}

fn record(status: &moldline_mesh_service::Status) {
    gauge!("moldline_uptime_seconds").set(status.uptime.as_secs_f64());
    gauge!("moldline_compute_running").set(status.running as f64);
    gauge!("moldline_compute_running_limit").set(status.running_limit as f64);
    gauge!("moldline_compute_queued").set(status.queued as f64);
    gauge!("moldline_compute_queued_limit").set(status.queued_limit as f64);
    gauge!("moldline_sessions").set(status.sessions as f64);
    gauge!("moldline_setups_resident").set(status.setups_resident as f64);
    gauge!("moldline_setups_stored").set(status.setups_stored as f64);
    gauge!("moldline_stored_bytes").set(status.stored_bytes as f64);
    record_cache("setups", &status.setup_cache);
    record_cache("linearisations", &status.linearisation_cache);
}

/// Records the working memory.
pub(crate) fn record_memory(memory: &Supply) {
    gauge!("moldline_memory_bytes").set(memory.used() as f64);
    gauge!("moldline_memory_most_bytes").set(memory.most() as f64);
    gauge!("moldline_memory_limit_bytes").set(memory.limit() as f64);
}

/// Records size and hit rate of a cache.
pub(crate) fn record_cache(name: &'static str, cache: &CacheStatus) {
    gauge!("moldline_cache_entries", "cache" => name).set(cache.entries as f64);
    gauge!("moldline_cache_bytes", "cache" => name).set(cache.bytes as f64);
    gauge!("moldline_cache_budget_bytes", "cache" => name).set(cache.budget as f64);
    counter!("moldline_cache_hits_total", "cache" => name).absolute(cache.hits);
    counter!("moldline_cache_misses_total", "cache" => name).absolute(cache.misses);
    counter!("moldline_cache_evictions_total", "cache" => name).absolute(cache.evictions);
}
