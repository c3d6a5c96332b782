//! `moldline deform`: a deformation on local files, without a server: the same input, the same bits.

use std::{
    collections::{BTreeMap, HashMap},
    path::PathBuf,
};

use clap::Args;
use moldline_deform::{Deformation, Setup};
use moldline_host::ServiceError;
use moldline_mesh::{
    CellQuality, Limits, Origin, SurfaceMesh,
    io::{
        Format, msh, stl,
        vtu::{self, Array, Values},
    },
};
use moldline_mesh_service::explained;

use crate::{
    failure::Failure,
    local::{self, Built, MeshFile, Source},
    output::{say, write},
};

/// Options of `moldline deform`.
#[derive(Debug, Args)]
pub struct DeformOptions {
    /// The set-up.
    #[command(flatten)]
    pub source: Source,
    /// Value of a design variable; those not named stay at their baseline
    #[arg(long, value_name = "NAME=VALUE", value_parser = assignment, allow_hyphen_values = true)]
    pub design: Vec<(String, f64)>,
    /// File with the design as JSON: an object of names and values, or an array of all values in order
    #[arg(long, value_name = "FILE", conflicts_with = "design")]
    pub design_file: Option<PathBuf>,
    /// File to write: .vtu with all measures; .msh, which is the mesh file of the set-up with other coordinates if that is MSH too;
    /// or .stl
    #[arg(long, short, value_name = "FILE")]
    pub output: PathBuf,
    /// Draw the deformed mesh to this PNG file, coloured by displacement
    #[cfg(feature = "plot")]
    #[arg(long, value_name = "FILE")]
    pub png: Option<PathBuf>,
    /// Write design and quality to this JSON file
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

fn assignment(text: &str) -> Result<(String, f64), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = value.trim().parse().map_err(|_| format!("`{value}` is not a number"))?;
    Ok((name.trim().to_owned(), value))
}

/// `moldline deform`
pub fn run(options: &DeformOptions) -> Result<(), Failure> {
    let format = Format::of_name(&options.output.to_string_lossy());
    let format = format.ok_or_else(|| Failure::OutputFormat { path: options.output.clone() })?;
    let pool = local::pool(&options.source)?;
    let Built { setup, mesh_file } = pool.install(|| local::build_with_mesh(&options.source))?;
    let design = design(options, &setup)?;
    let deformation = pool.install(|| {
        let explain = |error| explained(setup.origin(), error);
        local::with_bar(|monitor| setup.deform(&design, monitor).map_err(explain))
    })?;

    let mesh = SurfaceMesh { vertices: deformation.vertices.clone(), ..setup.mesh().clone() };
    let content = match (format, mesh_file) {
        (Format::Msh, Some(file)) if file.format == Some(Format::Msh) => {
            in_file(&file, setup.origin(), &mesh)?
        }
        (Format::Msh, _) => msh::write(&mesh, msh::Version::V4),
        (Format::Stl, _) => stl::write(&mesh),
        (Format::Vtu, _) => vtu_of(&setup, &mesh, &deformation),
    };
    write(&options.output, &content)?;
    say(&deformation.quality)?;
    say(&format_args!("wrote {}", options.output.display()))?;
    #[cfg(feature = "plot")]
    if let Some(path) = &options.png {
        crate::draw::displacements(path, &mesh, &setup.mesh().vertices)?;
    }
    if let Some(path) = &options.report {
        let report = report(&setup, &design, &deformation);
        write(path, format!("{report:#}\n").as_bytes())?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    Ok(())
}

/// The user's own MSH file with the positions of the mesh, in the file's unit: version, numbers, groups and other nodes stay.
fn in_file(file: &MeshFile, origin: &Origin, mesh: &SurfaceMesh) -> Result<Vec<u8>, Failure> {
    let own = origin.nodes.iter().copied().zip(0_u32..);
    let vertex_of: HashMap<u64, u32> = own.chain(origin.merged.iter().copied()).collect();
    let position = |tag| {
        let &vertex = vertex_of.get(&tag)?;
        Some(mesh.vertices[vertex as usize].map(|x| x / file.unit))
    };
    // It has been read before.
    msh::with_positions(&file.bytes, position, &Limits::default())
        .map_err(|error| Failure::Refused(ServiceError::invalid("mesh.file", error.to_string())))
}

/// Design and quality, beside the quality of the reference mesh.
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
        "quality": moldline_setup_files::quality_json(&deformation.quality),
        "reference_quality": moldline_setup_files::quality_json(&setup.report().quality),
        "seam_residual": deformation.seam_residual,
        "held_residual": deformation.held_residual,
        "projection_residual": deformation.projection_residual,
        "projection_steps": deformation.projection_steps,
        "crossing_pairs": deformation.crossings.len(),
    })
}

/// The design of the options, every variable in order.
fn design(options: &DeformOptions, setup: &Setup) -> Result<Vec<f64>, Failure> {
    match &options.design_file {
        Some(path) => local::design_file(path, setup),
        None => local::named(setup, options.design.iter().map(|(name, value)| (name.as_str(), *value))),
    }
}

/// The deformed mesh with its owner, seams and measures, for ParaView.
fn vtu_of(setup: &Setup, mesh: &SurfaceMesh, deformation: &Deformation) -> Vec<u8> {
    let reference = setup.mesh();
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
    let numbers = |numbers: &[u64]| numbers.iter().map(|&number| number as i64).collect::<Vec<i64>>();
    let (nodes, cells) = (numbers(&setup.origin().nodes), numbers(&setup.origin().cells));
    let mut point_data = vec![
        Array { name: "seam", components: 1, values: Values::UInt8(&seam) },
        Array { name: "displacement", components: 3, values: Values::Float64(&displacement) },
    ];
    // Which node and which cell of the user's file this is.
    let number = |values| Array { name: "number_in_file", components: 1, values: Values::Int64(values) };
    if nodes.len() == mesh.vertices.len() && cells.len() == mesh.cells.len() {
        point_data.push(number(&nodes));
        cell_data.push(number(&cells));
    }
    vtu::write(mesh, &point_data, &cell_data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assignments_are_read_with_their_sign() {
        assert_eq!(assignment("wing.translation=-5").unwrap(), ("wing.translation".to_owned(), -5.0));
        assert_eq!(assignment("wing.twist[3] = 0.5").unwrap(), ("wing.twist[3]".to_owned(), 0.5));
        assert!(assignment("wing.translation").is_err());
        assert!(assignment("wing.translation=far").is_err());
    }
}
