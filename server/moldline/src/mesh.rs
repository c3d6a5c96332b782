//! `moldline mesh`: the mesh of the union of a set-up's components, on local files.

use std::{fmt, num::NonZeroUsize, path::PathBuf};

use clap::Args;
use moldline_geometry::Body;
use moldline_host::ServiceError;
use moldline_mesh::io::{msh, vtu};
use moldline_mesher::{Generated, Options, Stage, generate};
use serde_json::json;

use crate::{bar::Bar, failure::Failure, local, output, output::say, values};

/// Options of `moldline mesh`.
#[derive(Debug, Args)]
pub struct MeshOptions {
    /// Folder of the set-up
    pub folder: PathBuf,
    /// Name of the set-up file in it
    #[arg(long, value_name = "NAME")]
    pub setup_file: Option<String>,
    /// Number of cells, about
    #[arg(long, default_value_t = 15_000)]
    pub cells: usize,
    /// Longest edge on a component, metres; repeatable
    #[arg(long = "size", value_name = "NAME=METRES", value_parser = size)]
    pub sizes: Vec<(String, f64)>,
    /// Longest edge on seams, metres
    #[arg(long, value_name = "METRES")]
    pub seam_size: Option<f64>,
    /// Mesh the half with y >= 0 alone, open at the plane of symmetry
    #[arg(long)]
    pub half: bool,
    /// Accept components that touch no other
    #[arg(long)]
    pub pieces: bool,
    /// File to write, .msh or .vtu [default: the mesh file that the set-up names]
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
    /// Compute threads; results do not depend on their number [default: one per core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
}

fn size(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=METRES")?;
    let value = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
    Ok((name.trim().to_owned(), value))
}

/// `moldline mesh`
pub fn run(options: &MeshOptions) -> Result<(), Failure> {
    let content = local::geometry(&options.folder, options.setup_file.as_deref())?;
    let path = match (&options.output, &content.mesh_file) {
        (Some(output), _) => output.clone(),
        (None, Some(file)) => options.folder.join(file),
        (None, None) => options.folder.join("mesh.msh"),
    };
    let vtu_ending = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("vtu"));
    if !vtu_ending && path.extension().is_none_or(|e| !e.eq_ignore_ascii_case("msh")) {
        let error =
            std::io::Error::other("a mesh is written as .msh or .vtu; name such a file with --output");
        return Err(Failure::File { path, error });
    }
    let wanted = Options {
        cells: options.cells,
        sizes: options.sizes.iter().cloned().collect(),
        seam_size: options.seam_size,
        half: options.half,
        symmetric: None,
        pieces: options.pieces,
    };
    let bodies: Vec<&Body> = content.bodies.iter().collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(values::threads(options.threads)).build()?;
    let bar = Progress(Bar::new());
    let generated = pool.install(|| generate(&bodies, &wanted, &bar));
    drop(bar);
    let generated = generated.map_err(ServiceError::from)?;
    let bytes = match vtu_ending {
        true => vtu::write(&generated.mesh, &[], &[]),
        false => msh::write(&generated.mesh, msh::Version::V4),
    };
    output::write_with_folder(&path, &bytes)?;
    if options.json {
        return say(&format_args!("{:#}", report_json(&generated)));
    }
    say(&Report(&generated))?;
    say(&format_args!("wrote {}", path.display()))
}

struct Progress(Bar);

impl moldline_deform::Monitor<Stage> for Progress {
    fn progress(&self, stage: Stage, fraction: f64) {
        let message = match stage {
            Stage::Tessellation => "triangles on each component",
            Stage::Union => "uniting the components",
            Stage::Remeshing => "remeshing",
        };
        self.0.tell(message.to_owned(), fraction);
    }
}

struct Report<'a>(&'a Generated);

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Generated { mesh, quality, seams, symmetric, .. } = self.0;
        let note = if *symmetric { ", symmetric with respect to y = 0" } else { "" };
        writeln!(f, "{} cells, {} vertices{note}", mesh.cells.len(), mesh.vertices.len())?;
        write!(f, "{quality}")?;
        for seam in seams {
            let [a, b] = &seam.components;
            write!(f, "\nseam of {a} and {b}: {} edges, {:.3} m", seam.edges, seam.length)?;
        }
        Ok(())
    }
}

fn report_json(generated: &Generated) -> serde_json::Value {
    let seams = generated.seams.iter();
    json!({
        "cells": generated.mesh.cells.len(),
        "vertices": generated.mesh.vertices.len(),
        "symmetric": generated.symmetric,
        "quality": moldline_setup_files::quality_json(&generated.quality),
        "seams": seams.map(|s| json!({"components": s.components, "edges": s.edges, "length": s.length}))
            .collect::<Vec<_>>(),
    })
}
