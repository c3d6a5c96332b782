//! Liveness and readiness: `/healthz`, `/readyz`, and the gRPC health service.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use axum::http::StatusCode;
use tonic_health::{ServingStatus, server::HealthReporter};

/// State of the probes.
#[derive(Clone)]
pub struct Health {
    ready: Arc<AtomicBool>,
    reporter: HealthReporter,
    services: Arc<[&'static str]>,
    check: Check,
}

/// What a service says of itself when it is asked whether it is ready.
#[derive(Clone)]
struct Check(Arc<dyn Fn() -> Result<(), String> + Send + Sync>);

impl fmt::Debug for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Check")
    }
}

impl Health {
    /// The state ready, with all of `services` serving, and the gRPC health service that reports it.
    pub async fn new(
        services: &[&'static str],
    ) -> (Self, tonic_health::pb::health_server::HealthServer<impl tonic_health::pb::health_server::Health>)
    {
        let (reporter, service) = tonic_health::server::health_reporter();
        let check = Check(Arc::new(|| Ok(())));
        let health =
            Self { ready: Arc::new(AtomicBool::new(true)), reporter, services: services.into(), check };
        health.report(ServingStatus::Serving).await;
        (health, service)
    }

    /// Ready only as long as `check` finds no fault, which it names.
    #[must_use]
    pub fn while_passes(self, check: impl Fn() -> Result<(), String> + Send + Sync + 'static) -> Self {
        Self { check: Check(Arc::new(check)), ..self }
    }

    /// Keeps the gRPC health service to what `/readyz` says, for ever.
    pub async fn follow(self) {
        let mut interval = tokio::time::interval(Duration::from_secs(1));
        let mut last = true;
        loop {
            interval.tick().await;
            let (status, reason) = self.ready();
            let ready = status.is_success();
            if ready != last {
                tracing::warn!(ready, reason = reason.trim(), "readiness changed");
                self.report(if ready { ServingStatus::Serving } else { ServingStatus::NotServing }).await;
            }
            last = ready;
        }
    }

    /// Announces the shutdown: not ready any more. Requests that still arrive are served.
    pub async fn end(&self) {
        self.ready.store(false, Ordering::Relaxed);
        self.report(ServingStatus::NotServing).await;
    }

    async fn report(&self, status: ServingStatus) {
        for service in self.services.iter().copied().chain([""]) {
            self.reporter.set_service_status(service, status).await;
        }
    }

    /// The answer to `/readyz`: whether new requests should come here.
    pub fn ready(&self) -> (StatusCode, String) {
        if !self.ready.load(Ordering::Relaxed) {
            return (StatusCode::SERVICE_UNAVAILABLE, "stopping\n".to_owned());
        }
        match (self.check.0)() {
            Ok(()) => (StatusCode::OK, "ready\n".to_owned()),
            Err(fault) => (StatusCode::SERVICE_UNAVAILABLE, format!("{fault}\n")),
        }
    }
}
