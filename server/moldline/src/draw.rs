//! `moldline plot`: a picture of a mesh, coloured by the quality of its cells.

use std::path::{Path, PathBuf};

use clap::Args;
use moldline_mesh::{CellQuality, SurfaceMesh, area_vector, io::Format};

use crate::{
    failure::Failure,
    local::{self, Source},
    output::{say, write},
    picture,
};

/// Options of `moldline plot`.
#[derive(Debug, Args)]
pub struct PlotOptions {
    /// Mesh file (.msh, .vtu or .stl), or folder or archive of a set-up
    pub path: PathBuf,
    /// Name of the set-up file in the folder or archive
    #[arg(long, value_name = "NAME")]
    pub setup_file: Option<String>,
    /// PNG file to write
    #[arg(long, short, value_name = "FILE", default_value = "mesh.png")]
    pub output: PathBuf,
}

/// `moldline plot`
pub fn run(options: &PlotOptions) -> Result<(), Failure> {
    let mesh = if Format::of_name(&options.path.to_string_lossy()).is_some() {
        local::mesh_file(&options.path, 0.0)?.mesh
    } else {
        let PlotOptions { path, setup_file, .. } = options;
        local::mesh(&Source { path: path.clone(), setup_file: setup_file.clone(), threads: None })?
    };
    let aspect_ratio = |cell| {
        let normal = area_vector(&mesh.vertices, cell).normalize();
        CellQuality::of_cell(&mesh.vertices, cell, &normal).aspect_ratio
    };
    let values: Vec<f64> = mesh.cells.iter().map(aspect_ratio).collect();
    draw(&options.output, &mesh, &values, "aspect ratio")
}

/// Writes the picture of a mesh coloured by the displacement of its vertices from `reference`, both in m.
pub fn displacements(path: &Path, mesh: &SurfaceMesh, reference: &[[f64; 3]]) -> Result<(), Failure> {
    let lengths: Vec<f64> = mesh
        .vertices
        .iter()
        .zip(reference)
        .map(|(to, from)| (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum::<f64>().sqrt())
        .collect();
    let mean = |vertices: &[u32]| {
        vertices.iter().map(|&vertex| lengths[vertex as usize]).sum::<f64>() / vertices.len() as f64
    };
    let values: Vec<f64> = mesh.cells.iter().map(|cell| mean(cell.vertices())).collect();
    draw(path, mesh, &values, "displacement, m")
}

fn draw(path: &Path, mesh: &SurfaceMesh, values: &[f64], name: &str) -> Result<(), Failure> {
    let range = picture::range(values);
    write(path, &picture::png(mesh, values, range)?)?;
    let [low, high] = range;
    say(&format_args!(
        "wrote {}: {name}, from {low:.3} (blue) to {high:.3} and more (yellow)",
        path.display()
    ))
}
