//! Liveness and readiness: `/healthz`, `/readyz`, and the gRPC health service.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use axum::http::StatusCode;
use tonic_health::{ServingStatus, server::HealthReporter};

/// What probes are told.
#[derive(Clone)]
pub struct Health {
    ready: Arc<AtomicBool>,
    reporter: HealthReporter,
    services: Arc<[&'static str]>,
}

impl Health {
    /// Ready, and all of `services` serving; with the gRPC service that says so.
    pub async fn new(
        services: &[&'static str],
    ) -> (Self, tonic_health::pb::health_server::HealthServer<impl tonic_health::pb::health_server::Health>)
    {
        let (reporter, service) = tonic_health::server::health_reporter();
        let health = Self { ready: Arc::new(AtomicBool::new(true)), reporter, services: services.into() };
        health.tell(ServingStatus::Serving).await;
        (health, service)
    }

    /// The end is near: send nobody here any more. What comes all the same is served.
    pub async fn end(&self) {
        self.ready.store(false, Ordering::Relaxed);
        self.tell(ServingStatus::NotServing).await;
    }

    async fn tell(&self, status: ServingStatus) {
        for service in self.services.iter().copied().chain([""]) {
            self.reporter.set_service_status(service, status).await;
        }
    }

    /// The answer to `/readyz`: whether new requests are welcome.
    pub fn ready(&self) -> (StatusCode, &'static str) {
        match self.ready.load(Ordering::Relaxed) {
            true => (StatusCode::OK, "ready\n"),
            false => (StatusCode::SERVICE_UNAVAILABLE, "stopping\n"),
        }
    }
}
