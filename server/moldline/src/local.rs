//! The engine on local files, without a server: the same input, the same bits.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use moldline_deform::{Deformation, Setup};
use moldline_mesh::{
    CellQuality, SurfaceMesh,
    io::vtu::{self, Array, Values},
};
use moldline_service::{Cancellation, Reporter, ServiceError};

use crate::{
    bar::Bar,
    config::{self, Source},
    serve::ServeError,
};

/// Why a command fails, in words for the one who gave it.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The server.
    #[error(transparent)]
    Serve(#[from] ServeError),
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
    let bar = Bar::new();
    let monitor = Reporter::new(Cancellation::default(), |progress| bar.show(&progress));
    let deformation = pool.install(|| setup.deform(&design, &monitor)).map_err(ServiceError::from)?;
    drop((monitor, bar));

    write(&options.output, &vtu_of(&setup, &deformation))?;
    println!("{}", deformation.quality);
    println!("wrote {}", options.output.display());
    if let Some(path) = &options.report {
        let report = report(&setup, &design, &deformation);
        write(path, format!("{report:#}\n").as_bytes())?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

/// `moldline setup`
pub fn setup(options: &config::Setup) -> Result<(), Failure> {
    let setup = pool(&options.source)?.install(|| build(&options.source))?;
    if options.json {
        println!("{}", moldline_setup::report_json(setup.report()));
    } else {
        println!("{}", setup.report());
    }
    Ok(())
}

/// `moldline schema`
pub fn schema() -> Result<(), Failure> {
    println!("{}", moldline_setup::schema());
    Ok(())
}

fn pool(source: &Source) -> Result<rayon::ThreadPool, Failure> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(config::threads(source.threads)).build()?)
}

/// The design asked for, every variable in order.
fn design(options: &config::Deform, setup: &Setup) -> Result<Vec<f64>, Failure> {
    #[derive(serde::Deserialize)]
    #[serde(untagged)]
    enum File {
        All(Vec<f64>),
        Named(BTreeMap<String, f64>),
    }
    let parameterisation = setup.parameterisation();
    let named = |values: &mut dyn Iterator<Item = (&str, f64)>| {
        parameterisation.design(values).map_err(|error| Failure::Refused(error.into()))
    };
    let Some(path) = &options.design_file else {
        return named(&mut options.design.iter().map(|(name, value)| (name.as_str(), *value)));
    };
    let text = fs::read(path).map_err(|error| Failure::File { path: path.clone(), error })?;
    match serde_json::from_slice(&text) {
        Ok(File::All(values)) => Ok(values),
        Ok(File::Named(values)) => named(&mut values.iter().map(|(name, value)| (name.as_str(), *value))),
        Err(_) => {
            let reason = "is neither a JSON object of names and numbers nor an array of numbers".to_owned();
            Err(Failure::DesignFile { path: path.clone(), reason })
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
    let displacement: Vec<f64> = moved.flat_map(|(to, from)| [0, 1, 2].map(|axis| to[axis] - from[axis])).collect();
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

fn write(path: &Path, content: &[u8]) -> Result<(), Failure> {
    fs::write(path, content).map_err(|error| Failure::File { path: path.to_owned(), error })
}
