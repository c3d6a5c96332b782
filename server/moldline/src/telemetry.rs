//! Logs: structured, on standard error, so that standard output belongs to results. Traces, by option, to a collector.

use std::io::{self, IsTerminal};

use axum::http::HeaderMap;
use opentelemetry::{
    propagation::{Extractor, TextMapPropagator},
    trace::TracerProvider,
};
use opentelemetry_otlp::WithExportConfig;
use opentelemetry_sdk::{Resource, propagation::TraceContextPropagator, trace::SdkTracerProvider};
use tracing::{Level, Span};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::{EnvFilter, Layer, filter::Targets, layer::SubscriberExt, util::SubscriberInitExt};

use crate::config::{LogFormat, Telemetry};

/// Traces on their way to the collector; what is still here when this is dropped is sent then.
pub struct Traces(Option<(SdkTracerProvider, tokio::runtime::Runtime)>);

impl Drop for Traces {
    fn drop(&mut self) {
        if let Some((provider, _runtime)) = &self.0
            && let Err(error) = provider.shutdown()
        {
            tracing::warn!(%error, "cannot send the last traces");
        }
    }
}

/// Starts logging and tracing. A filter that cannot be read is said and `info` taken.
pub fn start(options: &Telemetry) -> Traces {
    let (filter, refused) = match EnvFilter::try_new(&options.log) {
        Ok(filter) => (filter, None),
        Err(error) => (EnvFilter::new("info"), Some(error)),
    };
    let exporter = options.otlp.as_ref().map(|endpoint| export(endpoint));
    let (traces, failed) = match exporter.transpose() {
        Ok(traces) => (traces, None),
        Err(error) => (None, Some(error)),
    };
    let spans = traces.as_ref().map(|(provider, _)| {
        // Of what this program does, not of the libraries below it.
        let own = Targets::new().with_target("moldline", Level::INFO);
        tracing_opentelemetry::layer().with_tracer(provider.tracer("moldline")).with_filter(own)
    });
    let text = tracing_subscriber::fmt::layer().with_writer(io::stderr).with_ansi(io::stderr().is_terminal());
    let lines = match options.log_format {
        LogFormat::Text => text.boxed(),
        LogFormat::Json => text.json().boxed(),
    };
    tracing_subscriber::registry().with(lines.with_filter(filter)).with(spans).init();
    if let Some(error) = refused {
        tracing::warn!(%error, "cannot read the log filter");
    }
    if let Some(error) = failed {
        tracing::warn!(error, "cannot send traces");
    }
    Traces(traces)
}

/// Sends spans in batches, from a thread of its own.
fn export(endpoint: &str) -> Result<(SdkTracerProvider, tokio::runtime::Runtime), String> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("traces")
        .enable_all()
        .build()
        .map_err(|error| error.to_string())?;
    let entered = runtime.enter();
    let exporter = opentelemetry_otlp::SpanExporter::builder()
        .with_tonic()
        .with_endpoint(endpoint)
        .build()
        .map_err(|error| error.to_string())?;
    let resource = Resource::builder().with_service_name("moldline").build();
    let provider = SdkTracerProvider::builder().with_resource(resource).with_batch_exporter(exporter).build();
    drop(entered);
    Ok((provider, runtime))
}

/// Makes a request's span the child of the caller's, if it says so (`traceparent`).
pub fn follow(span: &Span, headers: &HeaderMap) {
    struct Headers<'a>(&'a HeaderMap);
    impl Extractor for Headers<'_> {
        fn get(&self, key: &str) -> Option<&str> {
            self.0.get(key).and_then(|value| value.to_str().ok())
        }

        fn keys(&self) -> Vec<&str> {
            self.0.keys().map(axum::http::HeaderName::as_str).collect()
        }
    }
    if headers.contains_key("traceparent") {
        // Without a collector there is nothing to be the child of.
        let _ = span.set_parent(TraceContextPropagator::new().extract(&Headers(headers)));
    }
}
