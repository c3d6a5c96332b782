//! Progress, load, times, pages of lists.

use std::time::SystemTime;

use moldline_host::{CacheStatus, Progress, Timing};
use moldline_mesh_service::{Page, Status};
use moldline_proto::v1;

pub fn progress(Progress { stage, fraction, message }: Progress) -> v1::Progress {
    v1::Progress { stage: stage.to_owned(), fraction, message }
}

pub fn page(page_size: u32, token: String) -> Page {
    Page { size: page_size as usize, token }
}

/// Seconds since 1970-01-01 00:00 UTC.
pub fn unix_seconds(time: SystemTime) -> f64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

pub fn status(status: Status) -> v1::GetStatusResponse {
    let cache = |cache: CacheStatus| v1::CacheStatus {
        entries: cache.entries as u64,
        bytes: cache.bytes as u64,
        budget_bytes: cache.budget as u64,
        hits: cache.hits,
        misses: cache.misses,
        evictions: cache.evictions,
    };
    let work = status.work.into_iter().map(|work| v1::Work {
        kind: work.kind.to_owned(),
        tenant: work.tenant.to_string(),
        setup_id: work.setup.unwrap_or_default(),
        session_id: work.session.unwrap_or_default(),
        running: work.running.is_some(),
        age_seconds: work.age.as_secs_f64(),
        running_seconds: work.running.unwrap_or_default().as_secs_f64(),
        stage: work.stage.unwrap_or_default().to_owned(),
        fraction: work.fraction,
    });
    v1::GetStatusResponse {
        version: status.version.to_owned(),
        uptime_seconds: status.uptime.as_secs_f64(),
        all_tenants: status.all_tenants,
        running: status.running as u64,
        queued: status.queued as u64,
        running_limit: status.running_limit as u64,
        queued_limit: status.queued_limit as u64,
        sessions: status.sessions as u64,
        setups_resident: status.setups_resident as u64,
        setups_stored: status.setups_stored as u64,
        stored_bytes: status.stored_bytes,
        setup_cache: Some(cache(status.setup_cache)),
        linearisation_cache: Some(cache(status.linearisation_cache)),
        work: work.collect(),
    }
}

pub fn timings(Timing { queued, engine }: Timing) -> v1::Timings {
    v1::Timings { queue_seconds: queued.as_secs_f64(), engine_seconds: engine.as_secs_f64() }
}
