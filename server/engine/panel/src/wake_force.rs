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
//! much as they are pressed, so only the body's velocity counts: that of its vortex sheet kappa. The integral along a vortex of strength gamma is closed; with
//! (x, y, z) = r from its beginning to the body,
//!
//! ```text
//! upward force / rho = - gamma / (4 pi) integral (kappa_x z g + kappa_z / r) dS,   g = 1 / (r (r - x))
//! ```
//!
//! That over elements is done by Gauss's rule on pieces that are small beside their distance from the vortex. The vorticity of a strip is gathered
//! in two vortices.

use std::f64::consts::PI;

use moldline_foundation::quadrature::GAUSS_2;
use moldline_mesh::Vector3;
use rayon::prelude::*;

use crate::{
    Monitor, PanelError, Stage,
    influence::{Charges, Layout},
    panels::Panels,
    progress::poll,
    surface::Surface,
    wake::{Beside, Wakes},
};

/// Pieces are quartered until they are smaller than this part of their distance from the vortex ...
const NEAR: f64 = 0.5;
/// ... or so many times, where a vortex runs along the body.
const DEPTH: u32 = 8;
/// Where vortices begin, downstream of the trailing edge, as a part of a strip's width. At the trailing edge itself the velocity has no bound on a
/// mesh.
const START: f64 = 0.05;
/// Elements between two looks at the monitor: each is cut into up to `4^DEPTH` pieces.
const POLLED: usize = 8;

/// Upward force of the body on the wakes over dynamic pressure, m^2, as a form in the onset flow: both halves, in real coordinates.
/// `charges` and `circulations` are those of the unit onset flows.
pub(crate) fn lift<const B: usize>(
    panels: &Panels,
    layout: &Layout,
    surface: &Surface,
    wakes: &Wakes,
    charges: &[Charges; B],
    circulations: &[Vec<f64>; B],
    monitor: &dyn Monitor<Stage>,
) -> Result<[[f64; B]; B], PanelError> {
    let images: &[f64] = if panels.symmetric { &[1.0, -1.0] } else { &[1.0] };
    let of_vortex = |(start, gamma): (Vector3, [f64; B])| {
        let mut force = [0.0; B];
        for side in images {
            // The image of a vortex turns the other way.
            let from = Vector3::new(start.x, side * start.y, start.z);
            for element in 0..layout.elements.len() {
                if element % POLLED == 0 {
                    poll(monitor)?;
                }
                let corners = surface.corners[element].map(|c| c - from);
                let [along_x, along_z] = mean_over(&corners, DEPTH);
                for (l, force) in force.iter_mut().enumerate() {
                    let kappa = &charges[l].elements[element];
                    *force -= side * (kappa.x * along_x + kappa.z * along_z);
                }
            }
        }
        // Sideslip crosses the wakes, too: all gamma together are zero, so that only where they begin counts.
        let crossing = |l: usize| surface.onset(panels.axes()[l]).y * start.x;
        Ok(gamma.map(|gamma| std::array::from_fn(|l| gamma * (0.25 / PI * force[l] + crossing(l)))))
    };
    let vortices = vortices(panels, surface, wakes, circulations);
    let forces: Vec<[[f64; B]; B]> =
        vortices.into_par_iter().map(of_vortex).collect::<Result<_, PanelError>>()?;
    let factor = 2.0 * surface.beta * images.len() as f64;
    let sum = |k: usize, l: usize| factor * forces.iter().map(|f| f[k][l]).sum::<f64>();
    Ok(std::array::from_fn(|k| std::array::from_fn(|l| sum(k, l))))
}

/// The beginnings of the vortices along x, and their strengths.
fn vortices<const B: usize>(
    panels: &Panels,
    surface: &Surface,
    wakes: &Wakes,
    circulations: &[Vec<f64>; B],
) -> Vec<(Vector3, [f64; B])> {
    let mut vortices = Vec::new();
    for (index, strip) in wakes.strips.iter().enumerate() {
        let [a, b] = [strip.a, strip.b].map(|p| surface.points[p as usize]);
        let shift = START * (b - a).norm() * Vector3::x();
        for (node, _) in GAUSS_2 {
            let place = 0.5 * (1.0 - node) * a + 0.5 * (1.0 + node) * b;
            let fall = |k: usize| 0.5 * (circulations[k][2 * index] - circulations[k][2 * index + 1]);
            vortices.push((place + shift, std::array::from_fn(fall)));
        }
        for side in 0..2 {
            let Beside::Body(end) = strip.beside[side] else { continue };
            if panels.symmetric && panels.on_plane[end as usize] {
                continue;
            }
            let left = wakes.leaving(index, side);
            let sign = if side == 0 { 1.0 } else { -1.0 };
            let fall = |k: usize| {
                let left: f64 = left.iter().map(|(e, f)| f * circulations[k][*e as usize]).sum();
                sign * (left - circulations[k][2 * index + side])
            };
            vortices.push((surface.points[end as usize] + shift, std::array::from_fn(fall)));
        }
    }
    vortices
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

/// Means of `z g` and of `1 / r` over a triangle.
fn mean_over(corners: &[Vector3; 3], depth: u32) -> [f64; 2] {
    let [a, b, c] = corners;
    let middle = (a + b + c) / 3.0;
    let size = (b - a).norm().max((c - b).norm()).max((a - c).norm());
    if depth > 0 && size > NEAR * distance(&middle) {
        let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| 0.5 * (p + q));
        let parts =
            [[*a, ab, ca], [ab, *b, bc], [ca, bc, *c], [ab, bc, ca]].map(|part| mean_over(&part, depth - 1));
        return [0, 1].map(|k| 0.25 * parts.iter().map(|part| part[k]).sum::<f64>());
    }
    let mut sum = [0.0; 2];
    for corner in corners {
        let r = 0.5 * corner + 0.5 * middle;
        sum[0] += r.z * fall(&r) / 3.0;
        sum[1] += 1.0 / (3.0 * r.norm());
    }
    sum
}
