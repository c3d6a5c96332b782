//! Liveness and readiness: `/healthz`, `/readyz`, and the gRPC health service.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use axum::http::StatusCode;
use tonic_health::{ServingStatus, server::HealthReporter};

/// State of the probes.
#[derive(Clone)]
pub struct Health {
    ready: Arc<AtomicBool>,
    reporter: HealthReporter,
    services: Arc<[&'static str]>,
}

impl Health {
    /// The state ready, with all of `services` serving, and the gRPC health service that reports it.
    pub async fn new(
        services: &[&'static str],
    ) -> (Self, tonic_health::pb::health_server::HealthServer<impl tonic_health::pb::health_server::Health>)
    {
        let (reporter, service) = tonic_health::server::health_reporter();
        let health = Self { ready: Arc::new(AtomicBool::new(true)), reporter, services: services.into() };
        health.report(ServingStatus::Serving).await;
        (health, service)
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
    pub fn ready(&self) -> (StatusCode, &'static str) {
        match self.ready.load(Ordering::Relaxed) {
            true => (StatusCode::OK, "ready\n"),
            false => (StatusCode::SERVICE_UNAVAILABLE, "stopping\n"),
        }
    }
}
