//! Set-ups and designs in local files, for commands that need no server.

use std::{
    collections::BTreeMap,
    fs, io,
    num::NonZeroUsize,
    path::{Path, PathBuf},
    sync::Arc,
};

use clap::Args;
use moldline_deform::{Monitor, Setup, Stage};
use moldline_host::{Cancellation, ServiceError};
#[cfg(feature = "plot")]
use moldline_mesh::SurfaceMesh;
use moldline_mesh::io::{Format, Imported};
use moldline_mesh_service::{explained, reporter};
use moldline_setup_files::{
    ArchiveKind, Files, GeometryContent, Limits, SetupFileError, read_folder, read_geometry,
    read_geometry_folder, read_setup, unpack,
};

use crate::{bar::Bar, failure::Failure, values};

/// Options of commands that read a set-up from local files.
#[derive(Debug, Args)]
pub struct Source {
    /// Folder or archive (.tar, .tar.gz, .tgz, .zip) of the set-up
    pub path: PathBuf,
    /// Name of the set-up file in it
    #[arg(long, value_name = "NAME")]
    pub setup_file: Option<String>,
    /// Compute threads; results do not depend on their number [default: one per core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
}

/// The compute threads.
pub fn pool(source: &Source) -> Result<rayon::ThreadPool, Failure> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(values::threads(source.threads)).build()?)
}

/// A set-up with the file of its mesh.
pub struct Built {
    /// The set-up.
    pub setup: Setup,
    /// The mesh file, unless the mesh is inline.
    pub mesh_file: Option<MeshFile>,
}

/// A mesh file.
pub struct MeshFile {
    /// Its format.
    pub format: Option<Format>,
    /// Its content.
    pub bytes: Vec<u8>,
    /// The unit of its coordinates, m.
    pub unit: f64,
}

/// Reads and builds a set-up.
pub fn build(source: &Source) -> Result<Setup, Failure> {
    build_with_mesh(source).map(|built| built.setup)
}

/// Reads and builds a set-up, and keeps the file of its mesh.
pub fn build_with_mesh(source: &Source) -> Result<Built, Failure> {
    let limits = Limits::default();
    let (mut files, setup_file) = read(source, &limits).map_err(ServiceError::from)?;
    let content = read_setup(&files, Some(&setup_file), &limits).map_err(ServiceError::from)?;
    let mesh_file = content.mesh_file.and_then(|(path, unit)| {
        let bytes = files.remove(&path)?;
        Some(MeshFile { format: Format::of_name(&path), bytes, unit })
    });
    let origin = Arc::clone(&content.input.origin);
    let setup =
        with_bar(|monitor| Setup::build(content.input, monitor).map_err(|error| explained(&origin, error)))?;
    Ok(Built { setup, mesh_file })
}

/// Reads a mesh file and merges its nodes within `tolerance`, in the file's unit.
pub fn mesh_file(path: &Path, tolerance: f64) -> Result<Imported, Failure> {
    let failed = |error: io::Error| Failure::File { path: path.to_owned(), error };
    let format = Format::of_name(&path.to_string_lossy());
    let unknown = || failed(io::Error::other(format!("is not a {} file", Format::ENDINGS)));
    let format = format.ok_or_else(unknown)?;
    let bytes = fs::read(path).map_err(failed)?;
    format
        .read(&bytes, tolerance, &moldline_mesh::Limits::default())
        .map_err(|error| failed(io::Error::other(error.to_string())))
}

/// Reads the mesh of a set-up, m, without building the set-up.
#[cfg(feature = "plot")]
pub fn mesh(source: &Source) -> Result<SurfaceMesh, Failure> {
    let limits = Limits::default();
    let (files, setup_file) = read(source, &limits).map_err(ServiceError::from)?;
    let content = read_setup(&files, Some(&setup_file), &limits).map_err(ServiceError::from)?;
    Ok(content.input.mesh)
}

/// Runs `work` with a progress bar.
pub fn with_bar<T, E: Into<ServiceError>>(
    work: impl FnOnce(&dyn Monitor<Stage>) -> Result<T, E>,
) -> Result<T, Failure> {
    let bar = Bar::new();
    let monitor = reporter(Cancellation::default(), |progress| bar.show(&progress));
    work(&monitor).map_err(|error| Failure::Refused(error.into()))
}

/// Reads the components of a set-up folder, and the name of the mesh file in it.
pub fn geometry(folder: &Path, setup_file: Option<&str>) -> Result<GeometryContent, Failure> {
    let limits = Limits::default();
    let path = setup_file.map_or_else(|| folder.to_owned(), |name| folder.join(name));
    let (files, setup_file) = read_geometry_folder(&path, &limits).map_err(ServiceError::from)?;
    Ok(read_geometry(&files, Some(&setup_file), &limits).map_err(ServiceError::from)?)
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

/// The baseline with some variables set by name.
pub fn named<'n>(setup: &Setup, values: impl Iterator<Item = (&'n str, f64)>) -> Result<Vec<f64>, Failure> {
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
