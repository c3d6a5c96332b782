//! Structured logs on standard error, which leaves standard output to results; optionally traces to a collector.

use std::io::{self, IsTerminal};

use axum::http::HeaderMap;
use clap::{Args, ValueEnum};
use opentelemetry::{
    propagation::{Extractor, TextMapPropagator},
    trace::TracerProvider,
};
use opentelemetry_otlp::WithExportConfig;
use opentelemetry_sdk::{Resource, propagation::TraceContextPropagator, trace::SdkTracerProvider};
use tracing::{Level, Span};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::{EnvFilter, Layer, filter::Targets, layer::SubscriberExt, util::SubscriberInitExt};

/// Options of logs and traces.
#[derive(Debug, Args)]
pub struct TelemetryOptions {
    /// Filter of the log messages on standard error, as in `info` or `moldline=debug,tonic=warn`
    #[arg(long, global = true, env = "MOLDLINE_LOG", default_value = "info")]
    pub log: String,
    /// Format of the log messages
    #[arg(long, global = true, env = "MOLDLINE_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// Send traces to this OpenTelemetry collector (OTLP over gRPC), as in `http://127.0.0.1:4317`
    #[arg(long, global = true, env = "MOLDLINE_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
}

/// Formats of log messages.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogFormat {
    /// For people
    Text,
    /// One JSON object per line
    Json,
}

/// Traces on their way to the collector. Dropping it sends the rest.
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

/// Starts logging and tracing. A filter that cannot be read is logged, and `info` used in its place.
pub fn start(options: &TelemetryOptions) -> Traces {
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
        // Spans of this program, not of the libraries below it.
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

/// Makes a request's span the child of the caller's span, if the request names one (`traceparent`).
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
        // Fails only without a collector, where spans have no parents.
        let _ = span.set_parent(TraceContextPropagator::new().extract(&Headers(headers)));
    }
}
