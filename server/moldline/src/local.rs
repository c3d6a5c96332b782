//! The engine on local files, without a server: the same input, the same bits.

use std::{
    collections::BTreeMap,
    fmt, fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use moldline_check::CheckError;
use moldline_deform::{Deformation, Monitor, Setup, Stage};
use moldline_mesh::{
    CellQuality, SurfaceMesh,
    io::vtu::{self, Array, Values},
};
use moldline_service::{Cancellation, ServiceError, reporter};
use moldline_setup::{ArchiveKind, Files, Limits, SetupFileError, read_folder, read_setup, unpack};

use crate::{
    bar::Bar,
    config::{self, Document, Source},
    plot::PlotError,
    shell::ServeError,
    status::StatusError,
};

/// Why a command fails, in words for the one who gave it.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The server.
    #[error(transparent)]
    Serve(#[from] ServeError),
    /// The server's status is not to be had.
    #[error(transparent)]
    Status(#[from] StatusError),
    /// Tokens cannot be changed.
    #[error(transparent)]
    Tokens(#[from] moldline_transport::tokens::TokenFileError),
    /// The set-up or the design is refused.
    #[error("{}", .0.message)]
    Refused(#[from] ServiceError),
    /// A file cannot be read or written.
    #[error("{}: {error}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The design file is not what it should be.
    #[error("{}: {reason}", path.display())]
    DesignFile {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// The check cannot be carried out.
    #[error(transparent)]
    Check(#[from] CheckError),
    /// The derivatives are wrong.
    #[error("the derivatives do not pass: {0}")]
    Derivatives(String),
    /// A figure cannot be drawn.
    #[error("cannot draw the figure: {0}")]
    Plot(#[from] PlotError),
    /// There is no store, or it cannot be opened.
    #[error("{0}; name the place that `moldline serve` was given by --store")]
    NoStore(#[source] moldline_service::StoreError),
    /// The store.
    #[error(transparent)]
    Store(#[from] moldline_service::StoreError),
    /// It is not what was written.
    #[error("{0} objects of the store are damaged")]
    Damaged(usize),
    /// No threads.
    #[error("cannot start the compute threads: {0}")]
    Threads(#[from] rayon::ThreadPoolBuildError),
    /// Standard output is closed.
    #[error("standard output: {0}")]
    Output(#[from] io::Error),
}

/// `moldline deform`
pub fn deform(options: &config::Deform) -> Result<(), Failure> {
    let pool = pool(&options.source)?;
    let setup = pool.install(|| build(&options.source))?;
    let design = design(options, &setup)?;
    let deformation = pool.install(|| with_bar(|monitor| setup.deform(&design, monitor)))?;

    write(&options.output, &vtu_of(&setup, &deformation))?;
    say(&deformation.quality)?;
    say(&format_args!("wrote {}", options.output.display()))?;
    if let Some(path) = &options.report {
        let report = report(&setup, &design, &deformation);
        write(path, format!("{report:#}\n").as_bytes())?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    Ok(())
}

/// `moldline setup`
pub fn setup(options: &config::Setup) -> Result<(), Failure> {
    let setup = pool(&options.source)?.install(|| build(&options.source))?;
    if options.json {
        say(&format_args!("{:#}", moldline_setup::report_json(setup.report())))
    } else {
        say(setup.report())
    }
}

/// `moldline schema`
pub fn schema(options: &config::Schema) -> Result<(), Failure> {
    let schema = match options.document {
        Document::Setup => moldline_setup::setup_schema(),
        Document::Geometry => moldline_setup::geometry_schema(),
    };
    say(&format_args!("{schema:#}"))
}

/// Prints a line of results. A reader that has seen enough is no failure.
pub fn say(line: &dyn fmt::Display) -> Result<(), Failure> {
    match writeln!(io::stdout().lock(), "{line}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(Failure::Output(error)),
        _ => Ok(()),
    }
}

pub fn pool(source: &Source) -> Result<rayon::ThreadPool, Failure> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(config::threads(source.threads)).build()?)
}

/// Reads and builds a set-up.
pub fn build(source: &Source) -> Result<Setup, Failure> {
    let limits = Limits::default();
    let (files, setup_file) = read(source, &limits).map_err(ServiceError::from)?;
    let content = read_setup(&files, Some(&setup_file), &limits).map_err(ServiceError::from)?;
    with_bar(|monitor| Setup::build(content.input, monitor))
}

/// Runs `work` with a progress bar.
fn with_bar<T, E: Into<ServiceError>>(
    work: impl FnOnce(&dyn Monitor<Stage>) -> Result<T, E>,
) -> Result<T, Failure> {
    let bar = Bar::new();
    let monitor = reporter(Cancellation::default(), |progress| bar.show(&progress));
    work(&monitor).map_err(|error| Failure::Refused(error.into()))
}

fn read(source: &Source, limits: &Limits) -> Result<(Files, String), SetupFileError> {
    let Some(setup_file) = &source.setup_file else { return read_folder(&source.path, limits) };
    if source.path.is_dir() {
        return read_folder(&source.path.join(setup_file), limits);
    }
    let io = |error| SetupFileError::Io { path: source.path.display().to_string(), source: error };
    let kind = ArchiveKind::of_name(&source.path.to_string_lossy());
    let kind = kind.ok_or_else(|| io(io::Error::other("it is neither a folder nor an archive")))?;
    Ok((unpack(kind, &fs::read(&source.path).map_err(io)?, limits)?, setup_file.clone()))
}

/// Design and quality, the latter beside the reference mesh's.
fn report(setup: &Setup, design: &[f64], deformation: &Deformation) -> serde_json::Value {
    let values: BTreeMap<_, _> = setup
        .parameterisation()
        .variables()
        .iter()
        .zip(design)
        .map(|(variable, value)| (&variable.name, value))
        .collect();
    serde_json::json!({
        "design": values,
        "quality": moldline_setup::quality_json(&deformation.quality),
        "reference_quality": moldline_setup::quality_json(&setup.report().quality),
        "seam_residual": deformation.seam_residual,
        "held_residual": deformation.held_residual,
        "projection_residual": deformation.projection_residual,
        "projection_steps": deformation.projection_steps,
    })
}

/// The design asked for, every variable in order.
fn design(options: &config::Deform, setup: &Setup) -> Result<Vec<f64>, Failure> {
    match &options.design_file {
        Some(path) => design_file(path, setup),
        None => named(setup, options.design.iter().map(|(name, value)| (name.as_str(), *value))),
    }
}

/// The baseline with some variables set by name.
fn named<'n>(setup: &Setup, values: impl Iterator<Item = (&'n str, f64)>) -> Result<Vec<f64>, Failure> {
    setup.parameterisation().design(values).map_err(|error| Failure::Refused(error.into()))
}

/// The design in a JSON file.
pub fn design_file(path: &Path, setup: &Setup) -> Result<Vec<f64>, Failure> {
    #[derive(serde::Deserialize)]
    #[serde(untagged)]
    enum File {
        All(Vec<f64>),
        Named(BTreeMap<String, f64>),
    }
    let text = fs::read(path).map_err(|error| Failure::File { path: path.to_owned(), error })?;
    match serde_json::from_slice(&text) {
        Ok(File::All(values)) => Ok(values),
        Ok(File::Named(values)) => named(setup, values.iter().map(|(name, value)| (name.as_str(), *value))),
        Err(_) => {
            let reason = "is neither a JSON object of names and numbers nor an array of numbers".to_owned();
            Err(Failure::DesignFile { path: path.to_owned(), reason })
        }
    }
}

/// The deformed mesh with its owner, seams and measures, for ParaView.
fn vtu_of(setup: &Setup, deformation: &Deformation) -> Vec<u8> {
    let reference = setup.mesh();
    let mesh = SurfaceMesh { vertices: deformation.vertices.clone(), ..reference.clone() };
    let mut seam = vec![0_u8; mesh.vertices.len()];
    for vertex in setup.seam_vertices() {
        seam[vertex as usize] = 1;
    }
    let moved = deformation.vertices.iter().zip(&reference.vertices);
    let displacement: Vec<f64> =
        moved.flat_map(|(to, from)| [0, 1, 2].map(|axis| to[axis] - from[axis])).collect();
    let owner: Vec<i32> = setup.cell_owner().iter().map(|&owner| owner as i32).collect();
    let measure = |of: fn(&CellQuality) -> f64| deformation.cell_quality.iter().map(of).collect::<Vec<_>>();
    let measures = [
        ("aspect_ratio", measure(|cell| cell.aspect_ratio)),
        ("edge_ratio", measure(|cell| cell.edge_ratio)),
        ("scaled_jacobian", measure(|cell| cell.scaled_jacobian)),
        ("skew", measure(|cell| cell.skew)),
    ];
    let mut cell_data = vec![Array { name: "owner", components: 1, values: Values::Int32(&owner) }];
    cell_data.extend(measures.iter().map(|(name, values)| Array {
        name,
        components: 1,
        values: Values::Float64(values),
    }));
    let point_data = [
        Array { name: "seam", components: 1, values: Values::UInt8(&seam) },
        Array { name: "displacement", components: 3, values: Values::Float64(&displacement) },
    ];
    vtu::write(&mesh, &point_data, &cell_data)
}

pub fn write(path: &Path, content: &[u8]) -> Result<(), Failure> {
    fs::write(path, content).map_err(|error| Failure::File { path: path.to_owned(), error })
}

/// Writes a file, and makes its folder where there is none.
pub fn write_with_folder(path: &Path, content: &[u8]) -> Result<(), Failure> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(|error| Failure::File { path: folder.to_owned(), error })?;
    }
    write(path, content)
}
