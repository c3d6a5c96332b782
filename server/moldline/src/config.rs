//! The command line and the environment.

use std::{net::SocketAddr, num::NonZeroUsize, path::PathBuf, time::Duration};

use axum::http::HeaderValue;
use clap::{Args, Parser, Subcommand, ValueEnum};
use moldline_service::{Limits, PoolLimits, Role, Tenant};

/// Deforms surface meshes with their geometry.
#[derive(Debug, Parser)]
#[command(version, about)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Logs.
    #[command(flatten)]
    pub telemetry: Telemetry,
}

/// What the program can do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Serve set-ups and sessions over gRPC and HTTP
    Serve(Serve),
    /// Analyse the flow over a mesh with the panel method
    #[command(subcommand)]
    Panel(Panel),
    /// Show what a server does and holds
    Status(Status),
    /// Make, list and revoke the tokens that a server asks for
    Token(Token),
    /// Deform the mesh of a set-up on this machine and write it as VTU
    Deform(Deform),
    /// Build a set-up on this machine and print what was found
    Setup(Setup),
    /// Check the derivatives of a set-up against the adjoint's own transpose, dual numbers and central differences
    Check(Check),
    /// Print the JSON Schema of set-up or geometry files
    Schema(Schema),
    /// Look after a store of set-ups and sessions
    #[command(subcommand)]
    Store(Store),
}

/// What can be done with a store.
#[derive(Debug, Subcommand)]
pub enum Store {
    /// Remove what nobody can reach any more: set-ups given up by all, closed sessions, old generations, left-overs
    Gc(Collect),
    /// Read everything and say what is damaged
    Verify(Place),
}

/// Which store.
#[derive(Debug, Args)]
pub struct Place {
    /// As of `moldline serve`
    #[arg(long, env = "MOLDLINE_STORE", default_value = "moldline-store", value_name = "PLACE")]
    pub store: String,
}

/// Options of `moldline store gc`.
#[derive(Debug, Args)]
pub struct Collect {
    /// Which store.
    #[command(flatten)]
    pub place: Place,
    /// Say what would be removed, and remove nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Leave what was written more recently, as in `90s`, `30m`, `24h`, `7d`; less than an hour is safe only while no server
    /// uses the store
    #[arg(long, default_value = "24h", value_parser = span)]
    pub grace: Duration,
}

fn span(text: &str) -> Result<Duration, String> {
    let seconds = [('s', 1), ('m', 60), ('h', 3600), ('d', 86400)]
        .into_iter()
        .find_map(|(unit, seconds)| Some((text.strip_suffix(unit)?, seconds)));
    let (number, unit) = seconds.ok_or("expected a number and a unit: s, m, h or d")?;
    let number: u32 = number.parse().map_err(|_| format!("`{number}` is not a whole number"))?;
    Ok(Duration::from_secs(u64::from(number) * unit))
}

/// Where logs go and how they look.
#[derive(Debug, Args)]
pub struct Telemetry {
    /// Which log messages, as in `info` or `moldline=debug,tonic=warn`; they go to standard error
    #[arg(long, global = true, env = "MOLDLINE_LOG", default_value = "info")]
    pub log: String,
    /// How they look
    #[arg(long, global = true, env = "MOLDLINE_LOG_FORMAT", default_value = "text")]
    pub log_format: LogFormat,
    /// Send traces to this OpenTelemetry collector (OTLP over gRPC), as in `http://127.0.0.1:4317`
    #[arg(long, global = true, env = "MOLDLINE_OTLP", value_name = "URL")]
    pub otlp: Option<String>,
}

/// Looks of log messages.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LogFormat {
    /// For people
    Text,
    /// One JSON object a line
    Json,
}

/// Where a service listens, who may use it, and how it ends.
#[derive(Debug, Args)]
pub struct Listen {
    /// Address to listen on; port 0 takes a free one. The address bound is the one line on standard output
    #[arg(long, env = "MOLDLINE_LISTEN", default_value = "127.0.0.1:50051")]
    pub listen: SocketAddr,
    /// Listen on an address that other machines reach, although nobody is asked who they are
    #[arg(long, env = "MOLDLINE_INSECURE_LISTEN")]
    pub insecure_listen: bool,
    /// Ask callers for a token of this file (`moldline token create`); changes of the file count at once
    #[arg(long, env = "MOLDLINE_TOKENS", value_name = "FILE")]
    pub tokens: Option<PathBuf>,
    /// The server's certificate and those that lead to its authority, PEM
    #[arg(long, env = "MOLDLINE_TLS_CERT", value_name = "FILE", requires = "tls_key")]
    pub tls_cert: Option<PathBuf>,
    /// Its private key, PEM
    #[arg(long, env = "MOLDLINE_TLS_KEY", value_name = "FILE", requires = "tls_cert")]
    pub tls_key: Option<PathBuf>,
    /// Ask callers for a certificate that one of these authorities has signed, PEM. It names the tenant: by a URI
    /// `moldline://TENANT/ROLE` among its alternative names, or by its common name. Optional where there are --tokens too
    #[arg(long, env = "MOLDLINE_CLIENT_CA", value_name = "FILE", requires = "tls_cert")]
    pub client_ca: Option<PathBuf>,
    /// Let web pages of this origin call, as in `https://example.org`
    #[arg(long, env = "MOLDLINE_CORS_ORIGIN", value_name = "ORIGIN", value_delimiter = ',')]
    pub cors_origin: Vec<HeaderValue>,
    /// Seconds between telling health probes that the end is near and closing the port; one probe interval
    #[arg(long, env = "MOLDLINE_DRAIN_DELAY", default_value_t = 0.0, value_name = "SECONDS", value_parser = seconds)]
    pub drain_delay: f64,
    /// Seconds that running requests have to finish
    #[arg(long, env = "MOLDLINE_DRAIN_TIMEOUT", default_value_t = 30.0, value_name = "SECONDS", value_parser = seconds)]
    pub drain_timeout: f64,
}

/// How much a service computes at a time.
#[derive(Debug, Args)]
pub struct Compute {
    /// Threads that compute; results do not depend on it [default: one a core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
    /// Requests that compute at a time, sharing the threads [default: as many as threads]
    #[arg(long, env = "MOLDLINE_RUNNING")]
    pub running: Option<NonZeroUsize>,
    /// Requests that wait for their turn; more are turned away
    #[arg(long, env = "MOLDLINE_QUEUED", default_value_t = 64)]
    pub queued: usize,
    /// Requests of one tenant that compute and wait
    #[arg(long, env = "MOLDLINE_TENANT_LOAD", default_value_t = 64)]
    pub tenant_load: usize,
    /// Largest message received, MiB
    #[arg(long, env = "MOLDLINE_MAX_MESSAGE", default_value_t = 64, value_name = "MIB")]
    pub max_message: usize,
}

impl Compute {
    /// The compute pool's size.
    pub fn pool(&self) -> PoolLimits {
        let threads = threads(self.threads);
        let running = self.running.map_or(threads, NonZeroUsize::get);
        PoolLimits { threads, running, queued: self.queued }
    }
}

/// Options of `moldline serve`.
#[derive(Debug, Args)]
pub struct Serve {
    /// The port.
    #[command(flatten)]
    pub listen: Listen,
    /// The compute pool.
    #[command(flatten)]
    pub compute: Compute,
    /// Largest upload, MiB
    #[arg(long, env = "MOLDLINE_MAX_UPLOAD", default_value_t = 256, value_name = "MIB")]
    pub max_upload: u64,
    /// Where set-ups and sessions last: a folder (made if there is none), an object store such as s3://bucket/prefix (with
    /// AWS_ENDPOINT, AWS_ACCESS_KEY_ID and so on in the environment), or `memory`, which ends with the server
    #[arg(long, env = "MOLDLINE_STORE", default_value = "moldline-store", value_name = "PLACE")]
    pub store: String,
    /// Set-ups of one tenant in the store
    #[arg(long, env = "MOLDLINE_MAX_SETUPS", default_value_t = 1000)]
    pub max_setups: usize,
    /// Open sessions of one tenant
    #[arg(long, env = "MOLDLINE_MAX_SESSIONS", default_value_t = 1000)]
    pub max_sessions: usize,
    /// Size of one tenant's set-ups in the store, MiB
    #[arg(long, env = "MOLDLINE_MAX_STORED", default_value_t = 65536, value_name = "MIB")]
    pub max_stored: u64,
    /// Memory of set-ups, MiB; those used least recently are dropped, and loaded again when they are needed
    #[arg(long, env = "MOLDLINE_SETUP_MEMORY", default_value_t = 4096, value_name = "MIB")]
    pub setup_memory: usize,
    /// Memory of linearisations, which products with derivatives need; those used least recently are dropped, MiB
    #[arg(long, env = "MOLDLINE_LINEARISATION_MEMORY", default_value_t = 2048, value_name = "MIB")]
    pub linearisation_memory: usize,
}

fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|error| format!("{error}"))?;
    Duration::try_from_secs_f64(value).map(|_| value).map_err(|error| error.to_string())
}

impl Serve {
    /// The service's limits.
    pub fn limits(&self) -> Limits {
        Limits {
            upload_bytes: self.max_upload.saturating_mul(1 << 20),
            setups: self.max_setups,
            sessions: self.max_sessions,
            stored_bytes: self.max_stored.saturating_mul(1 << 20),
            load: self.compute.tenant_load,
            setup_bytes: self.setup_memory.saturating_mul(1 << 20),
            linearisation_bytes: self.linearisation_memory.saturating_mul(1 << 20),
            ..Limits::default()
        }
    }
}

/// The number asked for, or one a core.
pub fn threads(asked: Option<NonZeroUsize>) -> usize {
    asked.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get)
}

/// Options of `moldline status`.
#[derive(Debug, Args)]
pub struct Status {
    /// The server, as in `127.0.0.1:50051` or `https://example.org:50051`
    #[arg(long, env = "MOLDLINE_SERVER", default_value = "127.0.0.1:50051", value_name = "URL")]
    pub server: String,
    /// A token, if the server asks for one
    #[arg(long, env = "MOLDLINE_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Authority that has signed the server's certificate, PEM
    #[arg(long, env = "MOLDLINE_CA", value_name = "FILE")]
    pub ca: Option<PathBuf>,
    /// Show it again and again, every second or so many
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "1", value_parser = seconds)]
    pub watch: Option<f64>,
    /// As JSON, one line
    #[arg(long)]
    pub json: bool,
}

/// Options of `moldline token`.
#[derive(Debug, Args)]
pub struct Token {
    /// The token file
    #[arg(long, global = true, env = "MOLDLINE_TOKENS", value_name = "FILE", default_value = "tokens.json")]
    pub tokens: PathBuf,
    /// What to do.
    #[command(subcommand)]
    pub command: TokenCommand,
}

/// What to do with tokens.
#[derive(Debug, Subcommand)]
pub enum TokenCommand {
    /// Make a token and print it, the only time that it is seen; the file has its hash
    Create {
        /// Whose set-ups and sessions it is for: up to 64 of a-z, 0-9, _ and -
        #[arg(long, value_parser = |text: &str| Tenant::new(text).map_err(|error| error.to_string()))]
        tenant: Tenant,
        /// What it allows: `reader` sees, `user` does everything with what is the tenant's, `admin` sees all tenants' load
        #[arg(long, value_parser = role)]
        role: Role,
        /// How long it is good for, as in `90d`, `12h`, `30m` or `45s`; for ever if absent
        #[arg(long, value_parser = lifetime, value_name = "TIME")]
        expires: Option<Duration>,
    },
    /// List the tokens, without their secrets
    List,
    /// Take a token out of the file: a running server refuses it from then on
    Revoke {
        /// As the list has it
        id: String,
    },
}

fn role(text: &str) -> Result<Role, String> {
    moldline_transport::role(text).ok_or_else(|| "it is reader, user or admin".to_owned())
}

fn lifetime(text: &str) -> Result<Duration, String> {
    let wrong = || "expected a number and one of s, m, h and d, as in 90d".to_owned();
    let (number, unit) = text.split_at_checked(text.len().saturating_sub(1)).ok_or_else(wrong)?;
    let number: u64 = number.parse().map_err(|_| wrong())?;
    let unit = match unit {
        "s" => 1,
        "m" => 60,
        "h" => 3600,
        "d" => 86_400,
        _ => return Err(wrong()),
    };
    number.checked_mul(unit).map(Duration::from_secs).ok_or_else(wrong)
}

/// Where a set-up is, for commands on local files.
#[derive(Debug, Args)]
pub struct Source {
    /// Folder or archive (.tar, .tar.gz, .tgz, .zip) of the set-up
    pub path: PathBuf,
    /// The file in it that describes the set-up
    #[arg(long, value_name = "NAME")]
    pub setup_file: Option<String>,
    /// Threads that compute; results do not depend on it [default: one a core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
}

/// Options of `moldline deform`.
#[derive(Debug, Args)]
pub struct Deform {
    /// Where the set-up is.
    #[command(flatten)]
    pub source: Source,
    /// Value of a design variable; those not named stay at their baseline
    #[arg(long, value_name = "NAME=VALUE", value_parser = assignment, allow_hyphen_values = true)]
    pub design: Vec<(String, f64)>,
    /// The design as JSON: an object of names and values, or an array of all values in order
    #[arg(long, value_name = "FILE", conflicts_with = "design")]
    pub design_file: Option<PathBuf>,
    /// VTU file to write
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// JSON file to write design and quality to
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

fn assignment(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
    Ok((name.trim().to_owned(), value))
}

/// Options of `moldline setup`.
#[derive(Debug, Args)]
pub struct Setup {
    /// Where the set-up is.
    #[command(flatten)]
    pub source: Source,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
}

/// Options of `moldline check`.
#[derive(Debug, Args)]
pub struct Check {
    /// Where the set-up is.
    #[command(flatten)]
    pub source: Source,
    /// How many designs: the baseline, then random ones far from it
    #[arg(long, value_name = "N", default_value_t = NonZeroUsize::MIN, conflicts_with = "design")]
    pub designs: NonZeroUsize,
    /// Seed of the random designs and vectors
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// This design instead, as JSON: an object of names and values, or an array of all values in order
    #[arg(long, alias = "design-file", value_name = "FILE")]
    pub design: Option<PathBuf>,
    /// Variables to compare with dual numbers and differences, by name or by the name of an array of them [default: all]
    #[arg(long, value_delimiter = ',', value_name = "NAME,...")]
    pub variables: Vec<String>,
    /// JSON file to write all errors to
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Folder to draw the errors against the step of the differences in, a PNG for each design
    #[arg(long, value_name = "FOLDER")]
    pub plots: Option<PathBuf>,
}

/// What the panel method can do.
#[derive(Debug, Subcommand)]
pub enum Panel {
    /// Serve analyses and their derivatives over gRPC and HTTP
    Serve(PanelServe),
    /// Analyse the flow over a mesh on this machine
    Analyze(PanelAnalyze),
}

/// Options of `moldline panel serve`.
#[derive(Debug, Args)]
pub struct PanelServe {
    /// The port.
    #[command(flatten)]
    pub listen: Listen,
    /// The compute pool.
    #[command(flatten)]
    pub compute: Compute,
    /// Memory of all analyses, those that are computed included, MiB; one that needs more is refused
    #[arg(long, env = "MOLDLINE_ANALYSIS_MEMORY", default_value_t = 4096, value_name = "MIB")]
    pub analysis_memory: u64,
    /// Memory of all configurations, MiB
    #[arg(long, env = "MOLDLINE_CONFIGURATION_MEMORY", default_value_t = 512, value_name = "MIB")]
    pub configuration_memory: u64,
}

impl PanelServe {
    /// The service's limits.
    pub fn limits(&self) -> moldline_panel_service::Limits {
        moldline_panel_service::Limits {
            solution_bytes: self.analysis_memory.saturating_mul(1 << 20),
            configuration_bytes: self.configuration_memory.saturating_mul(1 << 20),
            ..Default::default()
        }
    }
}

/// Options of `moldline panel analyze`.
#[derive(Debug, Args)]
pub struct PanelAnalyze {
    /// Mesh: .msh, .vtu or .stl
    pub mesh: PathBuf,
    /// Mach number
    #[arg(long, default_value_t = 0.0)]
    pub mach: f64,
    /// Angles of attack, degrees
    #[arg(long, value_delimiter = ',', default_value = "0", allow_hyphen_values = true)]
    pub alpha: Vec<f64>,
    /// Sideslip, degrees
    #[arg(long, default_value_t = 0.0, allow_hyphen_values = true)]
    pub sideslip: f64,
    /// Reference area, m^2
    #[arg(long)]
    pub area: f64,
    /// Reference chord of the pitching moment, m
    #[arg(long)]
    pub chord: f64,
    /// Reference span of rolling and yawing moment, m
    #[arg(long)]
    pub span: f64,
    /// Reference point of moments, m
    #[arg(long, value_name = "X,Y,Z", value_parser = point, default_value = "0,0,0", allow_hyphen_values = true)]
    pub point: [f64; 3],
    /// Vertex group of a trailing edge; several times for several
    #[arg(long, value_name = "GROUP", conflicts_with_all = ["trailing_edge_angle", "no_trailing_edges"])]
    pub trailing_edge: Vec<String>,
    /// Trailing edges are where the surface turns by so many degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 120.0)]
    pub trailing_edge_angle: f64,
    /// A body without lift
    #[arg(long, conflicts_with = "trailing_edge_angle")]
    pub no_trailing_edges: bool,
    /// The plane y = 0
    #[arg(long, default_value = "automatic")]
    pub symmetry: Symmetry,
    /// How the system is solved
    #[arg(long, default_value = "automatic")]
    pub solver: Solver,
    /// Memory that may be taken, MiB
    #[arg(long, default_value_t = 4096, value_name = "MIB")]
    pub memory: u64,
    /// Threads that compute; results do not depend on it [default: one a core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
    /// VTU file to write, with the pressure coefficients at every angle
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// JSON file to write all coefficients and loads to
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

/// The plane y = 0.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Symmetry {
    /// As the mesh is
    Automatic,
    /// Every cell is solved
    None,
    /// The mesh is one half
    Half,
    /// The mesh has both halves, one is solved
    Mirror,
}

/// How the system is solved.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Solver {
    /// By its size
    Automatic,
    /// LU in double precision
    Double,
    /// LU in single precision, refined
    Single,
    /// GMRES
    Iterative,
}

fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let numbers = numbers.map_err(|error| format!("{error}"))?;
    numbers.try_into().map_err(|_| "expected X,Y,Z".to_owned())
}

/// Options of `moldline schema`.
#[derive(Debug, Args)]
pub struct Schema {
    /// Of which document
    #[arg(default_value = "setup")]
    pub document: Document,
}

/// Documents of the set-up format.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Document {
    /// `setup.toml` and `setup.json`
    Setup,
    /// Geometry files
    Geometry,
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn spans_have_a_unit() {
        assert_eq!(span("24h").unwrap(), Duration::from_secs(86400));
        assert_eq!(span("90s").unwrap(), Duration::from_secs(90));
        assert!(span("24").is_err() && span("h").is_err() && span("-1h").is_err());
    }

    #[test]
    fn assignments_are_read_with_their_sign() {
        assert_eq!(assignment("wing.translation=-5").unwrap(), ("wing.translation".to_owned(), -5.0));
        assert_eq!(assignment("wing.twist[3] = 0.5").unwrap(), ("wing.twist[3]".to_owned(), 0.5));
        assert!(assignment("wing.translation").is_err());
        assert!(assignment("wing.translation=far").is_err());
    }
}
