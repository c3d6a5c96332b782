//! `moldline status`: load and contents of a server, in the terminal.

use std::{
    io::{self, Write},
    path::PathBuf,
    time::Duration,
};

use clap::Args;
use indicatif::HumanBytes;
use moldline_proto::v1::{self, mesh_service_client::MeshServiceClient};
use tonic::{
    Request,
    transport::{Certificate, ClientTlsConfig, Endpoint},
};

use crate::{table, values};

/// Options of `moldline status`.
#[derive(Debug, Args)]
pub struct StatusOptions {
    /// Address of the server, as in `127.0.0.1:50051` or `https://example.org:50051`
    #[arg(long, env = "MOLDLINE_SERVER", default_value = "127.0.0.1:50051", value_name = "URL")]
    pub server: String,
    /// Token, if the server requires one
    #[arg(long, env = "MOLDLINE_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Certificate authority that signed the server's certificate, PEM
    #[arg(long, env = "MOLDLINE_CA", value_name = "FILE")]
    pub ca: Option<PathBuf>,
    /// Refresh every SECONDS, or every second
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "1", value_parser = values::seconds)]
    pub watch: Option<f64>,
    /// Print JSON, one line
    #[arg(long)]
    pub json: bool,
}

/// A server whose status cannot be shown.
#[derive(Debug, thiserror::Error)]
pub enum StatusError {
    /// No server answers at the address.
    #[error("cannot reach {0}: {1}")]
    Unreachable(String, String),
    /// The server refuses the request.
    #[error("the server refuses: {0}")]
    Refused(String),
    /// A file or the terminal fails.
    #[error("{0}")]
    Io(#[from] io::Error),
}

/// Shows the status, once or periodically.
pub fn run(options: &StatusOptions) -> Result<(), StatusError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(show(options))
}

async fn show(options: &StatusOptions) -> Result<(), StatusError> {
    let unreachable = |error: &dyn std::error::Error| {
        // The innermost cause is the most specific.
        let mut cause = error;
        while let Some(inner) = cause.source() {
            cause = inner;
        }
        StatusError::Unreachable(options.server.clone(), cause.to_string())
    };
    let address = match options.server.contains("://") {
        true => options.server.clone(),
        false => format!("http://{}", options.server),
    };
    let mut endpoint = Endpoint::from_shared(address.clone())
        .map_err(|error| unreachable(&error))?
        .connect_timeout(Duration::from_secs(5))
        .timeout(Duration::from_secs(10));
    if address.starts_with("https://") {
        let mut tls = ClientTlsConfig::new();
        if let Some(path) = &options.ca {
            tls = tls.ca_certificate(Certificate::from_pem(std::fs::read(path)?));
        }
        endpoint = endpoint.tls_config(tls).map_err(|error| unreachable(&error))?;
    }
    let channel = endpoint.connect().await.map_err(|error| unreachable(&error))?;
    let mut client = MeshServiceClient::new(channel);
    loop {
        let mut request = Request::new(v1::GetStatusRequest {});
        if let Some(token) = &options.token {
            let bearer = format!("Bearer {token}").parse();
            let bearer = bearer.map_err(|_| {
                StatusError::Refused("the token has characters that no header may have".to_owned())
            })?;
            request.metadata_mut().insert("authorization", bearer);
        }
        let status = client.get_status(request).await;
        let status = status.map_err(|status| StatusError::Refused(status.message().to_owned()))?.into_inner();
        let mut output = io::stdout().lock();
        if options.json {
            let text = serde_json::to_string(&status).map_err(io::Error::other)?;
            writeln!(output, "{text}")?;
        } else {
            if options.watch.is_some() {
                // Clears the screen and starts at its top left.
                write!(output, "\x1b[H\x1b[2J")?;
            }
            write!(output, "{}", render(&options.server, &status))?;
        }
        output.flush()?;
        drop(output);
        match options.watch {
            Some(seconds) => tokio::time::sleep(Duration::from_secs_f64(seconds)).await,
            None => return Ok(()),
        }
    }
}

fn render(server: &str, status: &v1::GetStatusResponse) -> String {
    let seconds = |seconds: f64| table::duration(Duration::try_from_secs_f64(seconds).unwrap_or_default());
    let whose = if status.all_tenants { "all tenants" } else { "your tenant" };
    let mut text = format!(
        "moldline {} at {server}, up {}, {whose}\n\n",
        status.version,
        seconds(status.uptime_seconds)
    );
    let share = |part: u64, whole: u64| part as f64 / whole.max(1) as f64;
    let load = |name: &str, count: u64, limit: u64| {
        [name.to_owned(), table::bar(share(count, limit), 20), format!("{count} of {limit}"), String::new()]
    };
    let cache = |name: &str, cache: &Option<v1::CacheStatus>| {
        let cache = cache.unwrap_or_default();
        let lookups = cache.hits + cache.misses;
        let found = match lookups {
            0 => String::new(),
            _ => format!(", {:.1} % found", 100.0 * share(cache.hits, lookups)),
        };
        [
            name.to_owned(),
            table::bar(share(cache.bytes, cache.budget_bytes), 20),
            format!("{} of {}", HumanBytes(cache.bytes), HumanBytes(cache.budget_bytes)),
            format!("{} held{found}", cache.entries),
        ]
    };
    text += &table::render(&[
        load("running", status.running, status.running_limit),
        load("queued", status.queued, status.queued_limit),
        cache("set-ups", &status.setup_cache),
        cache("linearisations", &status.linearisation_cache),
    ]);
    text += &format!(
        "\n{} sessions; set-ups: {} in memory, {} stored ({})\n\n",
        status.sessions,
        status.setups_resident,
        status.setups_stored,
        HumanBytes(status.stored_bytes)
    );
    if status.work.is_empty() {
        return text + "nothing runs\n";
    }
    let mut rows = vec![["what", "for", "state", "tenant", "session", "set-up"].map(str::to_owned)];
    for work in &status.work {
        let state = match (work.running, work.stage.as_str()) {
            (false, _) => "waits".to_owned(),
            (true, "") => "runs".to_owned(),
            (true, stage) => format!("{stage} {:.0} %", 100.0 * work.fraction),
        };
        let since = if work.running { work.running_seconds } else { work.age_seconds };
        let short = |id: &str| id.chars().take(12).collect::<String>();
        rows.push([
            work.kind.clone(),
            seconds(since),
            state,
            work.tenant.clone(),
            short(&work.session_id),
            short(&work.setup_id),
        ]);
    }
    text + &table::render(&rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn load_memory_and_work_are_shown() {
        let status = v1::GetStatusResponse {
            version: "1.2.3".to_owned(),
            uptime_seconds: 7260.0,
            all_tenants: true,
            running: 1,
            running_limit: 2,
            queued_limit: 64,
            sessions: 3,
            linearisation_cache: Some(v1::CacheStatus {
                entries: 4,
                bytes: 1 << 30,
                budget_bytes: 2 << 30,
                hits: 3,
                misses: 1,
                evictions: 0,
            }),
            work: vec![v1::Work {
                kind: "build".to_owned(),
                tenant: "anna".to_owned(),
                running: true,
                running_seconds: 1.25,
                stage: "factorisation".to_owned(),
                fraction: 0.5,
                ..Default::default()
            }],
            ..Default::default()
        };
        let text = render("localhost:1", &status);
        for words in [
            "moldline 1.2.3 at localhost:1, up 2 h 1 min, all tenants",
            "running         ██████████░░░░░░░░░░  1 of 2",
            "1.00 GiB of 2.00 GiB  4 held, 75.0 % found",
            "3 sessions",
            "build  1.2 s  factorisation 50 %  anna",
        ] {
            assert!(text.contains(words), "{words}\n{text}");
        }
        let idle = render("localhost:1", &v1::GetStatusResponse::default());
        assert!(idle.contains("nothing runs"));
    }
}
