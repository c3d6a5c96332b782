//! `moldline panel analyze`: the panel method on a local mesh, without a server: the same input, the same bits.

use std::{num::NonZeroUsize, path::PathBuf};

use clap::Args;
use moldline_host::{Cancellation, ServiceError};
use moldline_mesh::{
    LeftOut, SurfaceMesh,
    io::{Imported, vtu},
};
use moldline_mesh_service::explained;
use moldline_panel::{
    Analysis, EdgeLine, Flow, LeftOut as LineLeftOut, Loads, OnDoubt, Options, PanelError, PanelSetup,
    Reference, Scalars, Solver, Symmetry, TrailingEdges, Warning,
};
use moldline_panel_service::reporter;
use serde_json::{Value, json};

use super::choices::{ON_DOUBT, SOLVERS, SYMMETRIES, words};
use crate::{
    bar::Bar,
    failure::Failure,
    local,
    output::{say, write},
    values,
};

/// Options of `moldline panel analyze`.
#[derive(Debug, Args)]
pub struct AnalyzeOptions {
    /// Mesh file: .msh, .vtu or .stl
    pub mesh: PathBuf,
    /// Nodes of the mesh within this distance of an earlier one become one, m
    #[arg(long, default_value_t = 0.0, value_name = "M", value_parser = distance)]
    pub merge_tolerance: f64,
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
    /// Reference span of the rolling and yawing moments, m
    #[arg(long)]
    pub span: f64,
    /// Reference point of the moments, m
    #[arg(long, value_name = "X,Y,Z", value_parser = point, default_value = "0,0,0", allow_hyphen_values = true)]
    pub point: [f64; 3],
    /// Vertex group of a trailing edge; may be given several times
    #[arg(long, value_name = "GROUP", conflicts_with_all = ["trailing_edge_angle", "no_trailing_edges"])]
    pub trailing_edge: Vec<String>,
    /// Trailing edges are edges across which the surface turns by at least so many degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 120.0)]
    pub trailing_edge_angle: f64,
    /// The body has no trailing edges, and so no lift
    #[arg(long, conflicts_with = "trailing_edge_angle")]
    pub no_trailing_edges: bool,
    /// Symmetry about the plane y = 0
    #[arg(long, default_value = "automatic", value_parser = words(&SYMMETRIES))]
    pub symmetry: Symmetry,
    /// Solver of the linear system
    #[arg(long, default_value = "automatic", value_parser = words(&SOLVERS))]
    pub solver: Solver,
    /// Memory limit, MiB
    #[arg(long, default_value_t = 4096, value_name = "MIB")]
    pub memory: u64,
    /// Answers that contradict themselves
    #[arg(long, value_parser = words(&ON_DOUBT), default_value = "refuse")]
    pub on_doubt: OnDoubt,
    /// Compute threads; results do not depend on their number [default: one per core]
    #[arg(long, env = "MOLDLINE_THREADS")]
    pub threads: Option<NonZeroUsize>,
    /// Write the mesh with its pressure coefficients at every angle to this VTU file
    #[arg(long, short, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Write all coefficients and loads to this JSON file
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

fn distance(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|error| format!("{error}"))?;
    if value >= 0.0 && value.is_finite() { Ok(value) } else { Err("must be 0 or greater".to_owned()) }
}

fn point(text: &str) -> Result<[f64; 3], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let numbers = numbers.map_err(|error| format!("{error}"))?;
    numbers.try_into().map_err(|_| "expected X,Y,Z".to_owned())
}

/// `moldline panel analyze`
pub fn run(options: &AnalyzeOptions) -> Result<(), Failure> {
    let Imported { mesh, origin } = local::mesh_file(&options.mesh, options.merge_tolerance)?;
    tell_left_out(origin.left_out)?;
    let explain = |error: PanelError| with_way_out(explained(&origin, error.clone()), &error);
    let explained_text = |warning: &Warning| origin.explain(&warning.to_string());
    let pool = rayon::ThreadPoolBuilder::new().num_threads(values::threads(options.threads)).build()?;
    let setup = pool.install(|| PanelSetup::new(&mesh, choices(options))).map_err(explain)?;
    let summary = setup.summary();
    let symmetric = if summary.symmetric { ", one half for both" } else { "" };
    let edges = summary.trailing_edges.len();
    say(&format_args!(
        "{} unknowns{symmetric}, {edges} trailing edges, {} MiB",
        summary.unknowns,
        summary.memory >> 20
    ))?;
    for line in &summary.lines {
        say(&format_args!("  {}", origin.explain(&line.to_string())))?;
    }
    for LineLeftOut { line, reason } in &summary.left_out {
        say(&format_args!("  left out: {}: {reason}", origin.explain(&line.to_string())))?;
    }
    for warning in &summary.warnings {
        eprintln!("warning: {}", explained_text(warning));
    }
    let reference =
        Reference { area: options.area, chord: options.chord, span: options.span, point: options.point };
    let sideslip = options.sideslip.to_radians();
    let flows: Vec<Flow> =
        options.alpha.iter().map(|alpha| Flow { alpha: alpha.to_radians(), sideslip, reference }).collect();
    let analyses: Vec<Analysis> = pool.install(|| {
        let bar = Bar::new();
        let monitor = reporter(Cancellation::default(), |progress| bar.show(&progress));
        let solution = setup.solve(&mesh.vertices, options.mach, &monitor).map_err(explain)?;
        flows.iter().map(|flow| solution.analyse(flow).map_err(explain)).collect::<Result<_, ServiceError>>()
    })?;
    for (alpha, analysis) in options.alpha.iter().zip(&analyses) {
        tell(*alpha, analysis)?;
        for warning in &analysis.warnings {
            eprintln!("warning at alpha {alpha} deg: {}", explained_text(warning));
        }
    }
    if let Some(path) = &options.output {
        write(path, &vtu_of(&mesh, &options.alpha, &analyses))?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    if let Some(path) = &options.report {
        let warnings = |warnings: &[Warning]| -> Vec<Value> {
            warnings.iter().map(|w| json!({ "kind": w.name(), "text": explained_text(w) })).collect()
        };
        let analyses: Vec<Value> = options
            .alpha
            .iter()
            .zip(&analyses)
            .map(|(alpha, a)| report(*alpha, a, &warnings(&a.warnings)))
            .collect();
        let report = json!({
            "mach": options.mach,
            "unknowns": summary.unknowns,
            "symmetric": summary.symmetric,
            "trailing_edges": summary.trailing_edges,
            "lines": summary.lines.iter().map(of_line).collect::<Vec<_>>(),
            "left_out": summary.left_out.iter().map(of_left_out).collect::<Vec<_>>(),
            "roots": summary.roots,
            "aft_ends": summary.aft_ends,
            "warnings": warnings(&summary.warnings),
            "analyses": analyses,
        });
        write(path, format!("{report:#}\n").as_bytes())?;
        say(&format_args!("wrote {}", path.display()))?;
    }
    Ok(())
}

fn choices(options: &AnalyzeOptions) -> Options {
    Options {
        symmetry: options.symmetry,
        trailing_edges: if options.no_trailing_edges {
            TrailingEdges::None
        } else if options.trailing_edge.is_empty() {
            TrailingEdges::Angle { degrees: options.trailing_edge_angle }
        } else {
            TrailingEdges::Groups(options.trailing_edge.clone())
        },
        solver: options.solver,
        on_doubt: options.on_doubt,
        memory_limit: options.memory.saturating_mul(1 << 20),
        ..Options::default()
    }
}

/// What of the file is not in the mesh.
fn tell_left_out(left_out: LeftOut) -> Result<(), Failure> {
    let LeftOut { nodes, merged_nodes, other_cells, collapsed_cells } = left_out;
    if left_out == LeftOut::default() {
        return Ok(());
    }
    say(&format_args!(
        "left out of the file: {nodes} nodes without cells, {other_cells} other cells, {collapsed_cells} collapsed cells; \
         {merged_nodes} nodes merged into others"
    ))
}

fn tell(alpha: f64, analysis: &Analysis) -> Result<(), Failure> {
    say(&format_args!(
        "\nalpha {alpha} deg (residual {:.1e} after {} rounds, lifts off by {:+.2} %)",
        analysis.residual,
        analysis.rounds,
        100.0 * analysis.disagreement
    ))?;
    for (name, value) in Scalars::NAMES.iter().zip(analysis.scalars.to_array()) {
        say(&format_args!("  {name:<20} {value:>12.6}"))?;
    }
    say(&format_args!("  {:<20} {:>12.6}", "wake_lift", analysis.wake_lift))?;
    say(&format_args!("  {:<20} {:>12} {:>12} {:>12}", "part", "lift", "drag", "moment"))?;
    for part in std::iter::once(&analysis.total).chain(&analysis.components) {
        let Loads { name, lift, drag, moment, .. } = part;
        say(&format_args!("  {name:<20} {lift:>12.6} {drag:>12.6} {:>12.6}", moment[1]))?;
    }
    if analysis.supercritical_cells > 0 {
        say(&format_args!("  {} cells beyond the critical pressure", analysis.supercritical_cells))?;
    }
    Ok(())
}

/// An error with the options of the command line that are a way out.
fn with_way_out(error: ServiceError, of: &PanelError) -> ServiceError {
    let options = match of {
        PanelError::NoTrailingEdge { .. } => {
            "--trailing-edge GROUP, --trailing-edge-angle DEGREES, or --no-trailing-edges"
        }
        PanelError::Doubtful(_) => "--on-doubt warn",
        _ => return error,
    };
    error.reworded(|text| format!("{text} ({options})"))
}

fn of_line(line: &EdgeLine) -> Value {
    let EdgeLine { vertices, from, to, length, width, turn } = line;
    json!({ "vertices": vertices, "from": from, "to": to, "length": length, "width": width, "turn": turn })
}

fn of_left_out(LineLeftOut { line, reason }: &LineLeftOut) -> Value {
    json!({ "line": of_line(line), "reason": reason.name() })
}

fn report(alpha: f64, analysis: &Analysis, warnings: &[Value]) -> Value {
    let scalars: serde_json::Map<String, Value> = Scalars::NAMES
        .iter()
        .map(|name| name.to_string())
        .zip(analysis.scalars.to_array().map(Value::from))
        .collect();
    let part = |Loads { name, force, moment, lift, drag }: &Loads| json!({ "name": name, "force": force, "moment": moment, "lift": lift, "drag": drag });
    let sections = analysis.sections.iter().map(|section| {
        json!({ "edge": section.edge, "middle": section.middle, "span": section.span, "load": section.load })
    });
    json!({
        "alpha": alpha,
        "coefficients": scalars,
        "wake_lift": analysis.wake_lift,
        "disagreement": analysis.disagreement,
        "warnings": warnings,
        "total": part(&analysis.total),
        "components": analysis.components.iter().map(part).collect::<Vec<_>>(),
        "sections": sections.collect::<Vec<_>>(),
        "supercritical_cells": analysis.supercritical_cells,
        "residual": analysis.residual,
        "rounds": analysis.rounds,
    })
}

/// The mesh with its pressures, for ParaView.
fn vtu_of(mesh: &SurfaceMesh, alphas: &[f64], analyses: &[Analysis]) -> Vec<u8> {
    let names: Vec<String> = match alphas {
        [_] => vec!["cp".to_owned()],
        _ => alphas.iter().map(|alpha| format!("cp at {alpha} deg")).collect(),
    };
    let arrays = |of: fn(&Analysis) -> &[f64]| -> Vec<vtu::Array<'_>> {
        let named = names.iter().zip(analyses);
        named
            .map(|(name, analysis)| vtu::Array {
                name,
                components: 1,
                values: vtu::Values::Float64(of(analysis)),
            })
            .collect()
    };
    vtu::write(mesh, &arrays(|a| &a.vertex_cp), &arrays(|a| &a.cp))
}
