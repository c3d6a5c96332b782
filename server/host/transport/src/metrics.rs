//! `/metrics` for Prometheus.

use std::{sync::OnceLock, time::Duration};

use metrics::{Unit, describe_counter, describe_gauge, describe_histogram};
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};

use crate::observe::names;

/// Upper bounds of the histograms' buckets, s: from a round trip without work to the longest set-up.
const BUCKETS: [f64; 16] =
    [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 100.0, 300.0];

/// Installs the metrics recorder, once per process.
///
/// # Errors
/// If another recorder is installed.
pub fn start() -> Result<PrometheusHandle, String> {
    static HANDLE: OnceLock<Result<PrometheusHandle, String>> = OnceLock::new();
    HANDLE
        .get_or_init(|| {
            let builder =
                PrometheusBuilder::new().set_buckets(&BUCKETS).map_err(|error| error.to_string())?;
            let recorder = builder.build_recorder();
            let handle = recorder.handle();
            metrics::set_global_recorder(recorder).map_err(|error| error.to_string())?;
            describe_counter!(names::REQUESTS, "Requests that are over, by rpc, transport and code.");
            describe_histogram!(
                names::SECONDS,
                Unit::Seconds,
                "Time from a request's arrival to the end of its answer, by rpc and transport."
            );
            describe_gauge!(names::IN_FLIGHT, "Requests under way, by transport.");
            Ok(handle)
        })
        .clone()
}

/// Sorts samples into their buckets periodically, so that they do not pile up if /metrics is never read.
pub async fn upkeep(handle: PrometheusHandle) {
    let mut interval = tokio::time::interval(Duration::from_secs(5));
    loop {
        interval.tick().await;
        handle.run_upkeep();
    }
}
