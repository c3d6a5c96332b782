//! Lift that acts on the wakes and not on the body.
//!
//! A wake along x is no stream surface: where the flow crosses its vortices, it presses on them with `rho u x gamma` per length. The
//! circulation counts that force, the surface does not feel it. By the momentum of the fluid far away,
//!
//! ```text
//! force on the body + force on the wakes = rho (-V_z, 0, V_x) integral Gamma dy + (induced drag, 0, 0)
//! ```
//!
//! exactly, whatever the flow near the body; the induced drag is along x, as the wakes are. Vortices of the wakes press on each other as
//! much as they are pressed, so only the body's velocity counts: that of its edges (vortices of strength kappa) and of its panels (sources
//! sigma). The integral along a vortex of strength gamma is closed; with (x, y, z) = r from its beginning to the body,
//!
//! ```text
//! upward force / rho = gamma / (4 pi) (sum integral sigma y g dA - sum kappa integral (z g dx + dz / r)),   g = 1 / (r (r - x))
//! ```
//!
//! That over edges and panels is done by Gauss's rule on pieces that are small beside their distance from the vortex.

use std::{collections::BTreeMap, f64::consts::PI};

use moldline_foundation::quadrature::GAUSS_2;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use crate::{
    panels::{Edge, Panels},
    surface::Surface,
    wake::Wakes,
};

/// Pieces are halved until they are smaller than this part of their distance from the vortex ...
const NEAR: f64 = 0.5;
/// ... or so many times, where a vortex runs along the body.
const DEPTH: u32 = 10;
/// Where vortices begin, downstream of the trailing edge, as a part of a strip's width. At the trailing edge itself the velocity of single edges
/// has no bound, and that of all together has none on a mesh, where strengths have steps.
const START: f64 = 0.05;
/// The nodes of the rule with two of them, on 0..1; both weights are 1/2.
const NODES: [f64; 2] = [0.5 * (1.0 + GAUSS_2[0].0), 0.5 * (1.0 + GAUSS_2[1].0)];

/// Upward force of the body on the wakes over dynamic pressure, m^2, as a form in the onset flow: both halves, in real coordinates.
/// `doublets` and `circulations` are those of the unit onset flows.
pub(crate) fn lift<const B: usize>(
    panels: &Panels,
    surface: &Surface,
    wakes: &Wakes,
    doublets: &[Vec<f64>; B],
    circulations: &[Vec<f64>; B],
) -> [[f64; B]; B] {
    let filaments = filaments(panels, wakes, doublets, circulations);
    let sources: [Vec<f64>; B] = std::array::from_fn(|k| {
        let onset = surface.onset(panels.axes()[k]);
        surface.normals.iter().map(|n| -onset.dot(n)).collect()
    });
    let images: &[f64] = if panels.symmetric { &[1.0, -1.0] } else { &[1.0] };
    let of_vortex = |(start, gamma): (Vector3, [f64; B])| {
        let mut force = [0.0; B];
        for side in images {
            // The image of a vortex turns the other way.
            let from = Vector3::new(start.x, side * start.y, start.z);
            for (e, strength) in panels.edges.iter().zip(&filaments) {
                let ends = [e.a, e.b].map(|p| surface.points[p as usize] - from);
                let along = ends[1] - ends[0];
                let press = |r: &Vector3| along.x * r.z * fall(r) + along.z / r.norm();
                let upward = side * mean_over_edge(&ends, DEPTH, &press);
                (0..B).for_each(|l| force[l] -= strength[l] * upward);
            }
            for (panel, corners) in panels.corners.iter().enumerate() {
                let corners = corners.map(|p| surface.points[p as usize] - from);
                let upward = side * over_panel(&corners, DEPTH, &|r| r.y * fall(r));
                (0..B).for_each(|l| force[l] += sources[l][panel] * upward);
            }
        }
        // Sideslip crosses the wakes, too: all gamma together are zero, so that only where they begin counts.
        let crossing = |l: usize| surface.onset(panels.axes()[l]).y * start.x;
        gamma.map(|gamma| std::array::from_fn(|l| gamma * (0.25 / PI * force[l] + crossing(l))))
    };
    let forces: Vec<[[f64; B]; B]> =
        vortices(surface, wakes, circulations).into_par_iter().map(of_vortex).collect();
    let factor = 2.0 * surface.beta * images.len() as f64;
    std::array::from_fn(|k| std::array::from_fn(|l| factor * forces.iter().map(|f| f[k][l]).sum::<f64>()))
}

/// The strengths of all edges as vortices from a to b. Where a wake begins on the surface, its border is a part of them.
fn filaments<const B: usize>(
    panels: &Panels,
    wakes: &Wakes,
    doublets: &[Vec<f64>; B],
    circulations: &[Vec<f64>; B],
) -> Vec<[f64; B]> {
    let edge = |e: &Edge| {
        std::array::from_fn(|k| {
            let mu = |panel: u32| doublets[k][panel as usize];
            e.right.map_or(0.0, mu) - mu(e.left)
        })
    };
    let mut filaments: Vec<[f64; B]> = panels.edges.iter().map(edge).collect();
    for jump in &wakes.jumps {
        for k in 0..B {
            filaments[jump.edge as usize][k] -= jump.sign * circulations[k][jump.strip as usize];
        }
    }
    filaments
}

/// The beginnings of the vortices along x, and their strengths.
fn vortices<const B: usize>(
    surface: &Surface,
    wakes: &Wakes,
    circulations: &[Vec<f64>; B],
) -> Vec<(Vector3, [f64; B])> {
    let mut at = BTreeMap::new();
    for ray in &wakes.rays {
        let strip = &wakes.strips[ray.strip as usize];
        let (gamma, size) = at.entry(ray.point).or_insert(([0.0; B], 0.0_f64));
        // The vortex runs upstream where the border of the strip runs downstream.
        (0..B).for_each(|k| gamma[k] -= ray.sign * circulations[k][ray.strip as usize]);
        *size = size.max(surface.lengths[strip.edge as usize]);
    }
    at.into_iter()
        .map(|(point, (gamma, size))| (surface.points[point as usize] + START * size * Vector3::x(), gamma))
        .collect()
}

/// `1 / (r (r - x))`, without cancellation; finite on the vortex, too.
fn fall(r: &Vector3) -> f64 {
    let (length, aside) = (r.norm(), (r.y * r.y + r.z * r.z).max(1e-150));
    if r.x > 0.0 { (length + r.x) / (length * aside) } else { 1.0 / (length * (length - r.x)) }
}

/// Distance from the vortex.
fn distance(r: &Vector3) -> f64 {
    if r.x > 0.0 { r.y.hypot(r.z) } else { r.norm() }
}

/// Mean of a function over a segment.
fn mean_over_edge(ends: &[Vector3; 2], depth: u32, f: &impl Fn(&Vector3) -> f64) -> f64 {
    let [a, b] = ends;
    let middle = 0.5 * (a + b);
    if depth > 0 && (b - a).norm() > NEAR * distance(&middle) {
        let halves = [[*a, middle], [middle, *b]];
        return 0.5 * halves.iter().map(|half| mean_over_edge(half, depth - 1, f)).sum::<f64>();
    }
    0.5 * NODES.map(|t| f(&(a + (b - a) * t))).iter().sum::<f64>()
}

/// Integral of a function over a quadrilateral.
fn over_panel(corners: &[Vector3; 4], depth: u32, f: &impl Fn(&Vector3) -> f64) -> f64 {
    let [a, b, c, d] = corners;
    let middle = 0.25 * (a + b + c + d);
    let size = (c - a).norm().max((d - b).norm());
    if depth > 0 && size > NEAR * distance(&middle) {
        let [ab, bc, cd, da] = [(a, b), (b, c), (c, d), (d, a)].map(|(p, q)| 0.5 * (p + q));
        let parts = [[*a, ab, middle, da], [ab, *b, bc, middle], [middle, bc, *c, cd], [da, middle, cd, *d]];
        return parts.iter().map(|part| over_panel(part, depth - 1, f)).sum();
    }
    let at = |s: f64, t: f64| {
        let (low, high) = (a + (b - a) * s, d + (c - d) * s);
        let by_s = (b - a) * (1.0 - t) + (c - d) * t;
        f(&(low + (high - low) * t)) * by_s.cross(&(high - low)).norm()
    };
    0.25 * NODES.iter().map(|s| NODES.iter().map(|t| at(*s, *t)).sum::<f64>()).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        NoMonitor, Options, PanelSetup, Solution, Symmetry, TrailingEdges, influence::Influence,
        solution::AnyState, state::State,
    };
    use moldline_testing::Wing;

    /// The upward force from the velocity along the vortices, summed downstream.
    fn along_the_vortices<const B: usize>(solution: &Solution, state: &State<B>) -> [[f64; B]; B] {
        let setup = &solution.setup;
        let influence = Influence::<B>::new(&setup.panels, &setup.wakes, &state.surface);
        // Steps that grow from the beginning on, but not beside a body, each with Gauss's rule.
        let mut steps = vec![0.0_f64];
        while let Some(&last) = steps.last().filter(|last| **last < 1e5) {
            steps.push(last + if last < 20.0 { (2e-4 + 0.25 * last).min(0.3) } else { 0.25 * (last - 18.8) });
        }
        let nodes: Vec<(f64, f64)> = steps
            .windows(2)
            .flat_map(|w| NODES.map(|t| (w[0] + (w[1] - w[0]) * t, 0.5 * (w[1] - w[0]))))
            .collect();
        let mut sum = [[0.0; B]; B];
        for (start, gamma) in vortices(&state.surface, &setup.wakes, &state.circulations) {
            let places: Vec<Vector3> = nodes.iter().map(|(t, _)| start + *t * Vector3::x()).collect();
            for (u, (_, weight)) in influence.velocities(&state.strengths(), &places).iter().zip(&nodes) {
                for k in 0..B {
                    (0..B).for_each(|l| sum[k][l] -= gamma[k] * weight * u[l].y);
                }
            }
            let onset = |l: usize| state.surface.onset(setup.panels.axes()[l]).y;
            (0..B).for_each(|k| (0..B).for_each(|l| sum[k][l] += gamma[k] * onset(l) * start.x));
        }
        let factor = if setup.panels.symmetric { 4.0 } else { 2.0 };
        sum.map(|row| row.map(|x| factor * state.surface.beta * x))
    }

    fn check<const B: usize>(solution: &Solution, state: &State<B>) {
        let expected = along_the_vortices(solution, state);
        let size = expected.as_flattened().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (found, expected) in state.wake_lift.as_flattened().iter().zip(expected.as_flattened()) {
            assert!((found - expected).abs() < 1e-4 * size, "{:?}, {expected:?}", state.wake_lift);
        }
    }

    fn solve(mesh: &moldline_mesh::SurfaceMesh, options: Options, mach: f64) -> Solution {
        PanelSetup::new(mesh, options).unwrap().solve(&mesh.vertices, mach, &NoMonitor).unwrap()
    }

    /// The reaction on the body, closed along the vortices, against the velocity summed along them: a swept wing with dihedral as one half
    /// and as a whole, and the E175, whose circulation goes on over the body.
    #[test]
    fn force_is_that_of_the_velocity_along_the_vortices() {
        let rise = |mesh: &mut moldline_mesh::SurfaceMesh| {
            mesh.vertices.iter_mut().for_each(|v| v[2] += 0.2 * v[1].abs());
        };
        for (half, symmetry) in [(true, Symmetry::Half), (false, Symmetry::None)] {
            let wing = Wing { half, leading_edge: |eta| 2.0 * eta.abs(), ..Wing::rectangular(16, 8) };
            let mut mesh = wing.mesh();
            rise(&mut mesh);
            let solution = solve(&mesh, Options { symmetry, ..Options::default() }, 0.5);
            match &solution.state {
                AnyState::Symmetric(state) => check(&solution, state),
                AnyState::Full(state) => check(&solution, state),
            }
        }
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../examples/e175/study/mesh-coarse.msh");
        let limits = moldline_mesh::Limits::default();
        let mesh = moldline_mesh::io::msh::read(&std::fs::read(path).unwrap(), &limits).unwrap().mesh;
        let names = ["trailing_edge_wing", "trailing_edge_htail"].map(str::to_owned).to_vec();
        let options = Options { trailing_edges: TrailingEdges::Groups(names), ..Options::default() };
        let solution = solve(&mesh, options, 0.7);
        let AnyState::Symmetric(state) = &solution.state else { panic!("the mesh is symmetric") };
        check(&solution, state);
    }
}
