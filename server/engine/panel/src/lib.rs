//! A panel method for closed bodies and wings in subsonic flow on triangles and quadrilaterals of any shape, with exact derivatives.
//!
//! [`PanelSetup::new`] finds once all that does not change with the positions of the vertices: the half that is solved,
//! trailing edges, wakes and unknowns. [`PanelSetup::solve`] computes the flow for unit winds along the axes; [`Solution::analyse`] combines
//! them at any angle of attack, and [`Solution::linearise`] gives products with the derivative.
//!
//! The unknown is the potential mu at the vertices, linear on triangles. The surface is a sheet of vortices `n x grad mu`, inside of which the
//! flow is at rest, and no flow passes through it in the mean with every test function w (Galerkin's method, in `influence`):
//!
//! ```text
//! integral w n.(V + curl A) dS = 0,   A = 1/(4 pi) integral n x grad mu / r dS,   Gamma = mu_upper - mu_lower on wakes,   Cp = 1 - |grad mu|^2 at Mach 0
//! ```
//!
//! Start reading at `state`: the chain of all steps, its derivative and the transpose. In the order of the data the steps are `surface`
//! (Goethert's rule, geometry of the triangles), `influence`, `linear_system`, `recovery` and `pressure`, `trefftz`, `wake_force`; then, at one
//! angle of attack, `wind`, `distributions` and `coefficients`. `panels`, `wake`, `nodes` and `elements` are found once.
//!
//! Axes: x aft, y starboard, z up; lengths in m, angles in rad. Parallel loops run on rayon's current pool. Results are the same to the
//! last bit whatever its size.
//!
//! Absent on purpose: files, serialisation, clocks; viscosity, free wakes, supersonic flow.
//!
//! # Example
//!
//! The flow over the unit sphere, which is fastest at the equator, where `Cp = -5/4`, and how its drag changes with its vertices:
//!
//! ```
//! use std::{f64::consts::PI, sync::Arc};
//!
//! use moldline_mesh::{Cell, SurfaceMesh};
//! use moldline_panel::*;
//!
//! // Rings of vertices between the poles, which lie on the x axis.
//! let (rings, around) = (15, 32);
//! let mut vertices = vec![[-1.0, 0.0, 0.0]];
//! for (i, j) in (1..=rings).flat_map(|i| (0..around).map(move |j| (i, j))) {
//!     let (s, c) = (PI * i as f64 / (rings + 1) as f64).sin_cos();
//!     let (y, z) = (2.0 * PI * j as f64 / around as f64).sin_cos();
//!     vertices.push([-c, s * y, s * z]);
//! }
//! vertices.push([1.0, 0.0, 0.0]);
//! let last = vertices.len() as u32 - 1;
//! let at = |i: usize, j: usize| (1 + (i - 1) * around + j % around) as u32;
//! let mut cells = Vec::new();
//! for j in 0..around {
//!     cells.push(Cell::triangle(0, at(1, j), at(1, j + 1)));
//!     cells.extend((1..rings).map(|i| Cell::quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1))));
//!     cells.push(Cell::triangle(at(rings, j + 1), at(rings, j), last));
//! }
//! let mesh = SurfaceMesh::new(vertices, cells, Vec::new(), Vec::new())?;
//!
//! let options = Options { trailing_edges: TrailingEdges::None, ..Options::default() };
//! let setup = PanelSetup::new(&mesh, options)?;
//! let solution = Arc::new(setup.solve(&mesh.vertices, 0.0, &NoMonitor)?);
//! let reference = Reference { area: PI, chord: 1.0, span: 2.0, point: [0.0; 3] };
//! let flow = Flow { alpha: 0.0, sideslip: 0.0, reference };
//! let analysis = solution.analyse(&flow)?;
//! let least = analysis.cp.iter().copied().fold(f64::INFINITY, f64::min);
//! assert!((least + 1.25).abs() < 0.05);
//!
//! let drag = Outputs { scalars: Scalars { pressure_drag: 1.0, ..Scalars::default() }, ..Outputs::default() };
//! let gradient = &solution.linearise(&flow)?.vjp(&[drag], &NoMonitor)?[0];
//! assert_eq!(gradient.vertices.len(), mesh.vertices.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod bounds;
mod clusters;
mod coefficients;
mod distributions;
mod doubt;
mod elements;
mod error;
mod flow;
mod influence;
mod lanes;
mod linear_system;
mod linearisation;
mod nodes;
mod options;
mod panel_setup;
mod panels;
mod pressure;
mod progress;
mod recovery;
mod solution;
mod stage;
mod state;
mod surface;
mod symmetry;
mod thin;
mod trefftz;
mod wake;
mod wake_force;
mod wind;

pub use coefficients::Scalars;
pub use doubt::{Check, OnDoubt, Warning};
pub use error::PanelError;
pub use flow::{Flow, Reference};
pub use linearisation::{Inputs, Linearisation, Outputs};
pub use moldline_foundation::{Monitor, NoMonitor};
pub use options::{Options, Solver, Symmetry, TrailingEdges};
pub use panel_setup::{PanelSetup, SetupSummary, memory_estimate};
pub use solution::{Analysis, Loads, MAX_MACH, Section, Solution};
pub use stage::Stage;
pub use wake::{EdgeLine, LeftOut, NearPass, Reason};
