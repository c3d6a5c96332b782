//! Surface gradient of a potential given at panel centres.
//!
//! It is a weighted least-squares fit to the neighbours at edges, with weights 1/d^2, none across a trailing edge. A neighbour's centre is
//! unfolded about the shared edge: with e along the edge, p the part of the way from the centre to the edge normal to e,
//! and p' the same from the edge to the neighbour, `d = e (e . (c' - c)) + (|p| + |p'|) p / |p|`. With `u = d / |d|`, `M = sum u u^T + n n^T`:
//!
//! ```text
//! y = M^-1 sum u (mu' - mu) / |d|,   gradient = y - n (n . y)
//! ```
//!
//! The residual of the fit, `(mu' - mu) / |d| - u . y`, is the change of the gradient along u from the centre to the edge.

use moldline_mesh::Vector3;
use nalgebra::Matrix3;

use crate::{
    PanelError,
    panels::Panels,
    surface::{Surface, SurfaceChange},
    symmetry::mirrored,
    wake::Wakes,
};

/// Least eigenvalue ratio of M within the surface: below, neighbours lie on one line.
const FLAT: f64 = 1e-4;

/// A neighbour of a panel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Neighbour {
    /// The panel; itself if it is its own image in the plane of symmetry.
    pub panel: u32,
    pub mirrored: bool,
    pub edge: u32,
    /// The strip whose circulation is added to the neighbour's potential, with its sign: the edge carries a wake's border.
    pub jump: Option<(u32, f64)>,
}

/// Neighbours of all panels.
#[derive(Clone, Debug)]
pub(crate) struct Stencils {
    pub neighbours: Vec<Vec<Neighbour>>,
}

impl Stencils {
    pub fn new(panels: &Panels, wakes: &Wakes) -> Self {
        let mut at_trailing_edge = vec![false; panels.len()];
        for strip in &wakes.strips {
            [strip.upper, strip.lower].iter().for_each(|&p| at_trailing_edge[p as usize] = true);
        }
        let mut jumps = vec![Vec::new(); panels.edges.len()];
        wakes.jumps.iter().for_each(|j| jumps[j.edge as usize].push(*j));
        let neighbours = (0..panels.len() as u32)
            .map(|panel| {
                let mut list = Vec::new();
                for &edge in &panels.panel_edges[panel as usize] {
                    if wakes.trailing[edge as usize] {
                        continue;
                    }
                    let across = panels.across(panel, edge);
                    let left = panels.edges[edge as usize].left == panel;
                    // From the upper side to the lower one the circulation is added; paths that meet on an edge add up.
                    let over = &jumps[edge as usize];
                    if !over.is_empty() && (at_trailing_edge[panel as usize] || over.len() > 1) {
                        continue;
                    }
                    // On the plane of symmetry the image has the same wake's border.
                    let over = if across.is_some() { &over[..] } else { &[] };
                    let jump = over.first().map(|j| (j.strip, if left { -j.sign } else { j.sign }));
                    list.push(Neighbour {
                        panel: across.unwrap_or(panel),
                        mirrored: across.is_none(),
                        edge,
                        jump,
                    });
                }
                list
            })
            .collect();
        Self { neighbours }
    }
}

/// One neighbour's part of a stencil.
struct Arm {
    u: Vector3,
    /// 1 / |d|
    by_length: f64,
}

/// A gradient and the residuals of its fit at the neighbours; or changes or seeds of both.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Slope {
    pub gradient: Vector3,
    pub residuals: [f64; 4],
}

/// The stencils on a surface.
pub(crate) struct Gradients<'a> {
    panels: &'a Panels,
    surface: &'a Surface,
    stencils: &'a Stencils,
    inverses: Vec<Matrix3<f64>>,
}

/// The way from a panel's centre over an edge to a neighbour's centre.
struct Unfolded {
    along: Vector3,
    /// From the centre to the edge, normal to it, and its length; the same onwards.
    here: (Vector3, f64),
    there: (Vector3, f64),
    d: Vector3,
}

impl<'a> Gradients<'a> {
    pub fn new(panels: &'a Panels, surface: &'a Surface, stencils: &'a Stencils) -> Result<Self, PanelError> {
        let mut gradients = Self { panels, surface, stencils, inverses: Vec::with_capacity(panels.len()) };
        for panel in 0..panels.len() {
            let n = &surface.normals[panel];
            let mut m = n * n.transpose();
            for neighbour in &stencils.neighbours[panel] {
                let u = gradients.arm(panel, neighbour).u;
                m += u * u.transpose();
            }
            let inverse = m.try_inverse().filter(|inverse| inverse.norm() < 1.0 / FLAT);
            gradients.inverses.push(inverse.ok_or(PanelError::Gradient { cell: panels.cell_of[panel] })?);
        }
        Ok(gradients)
    }

    fn centre(&self, neighbour: &Neighbour) -> Vector3 {
        let centre = self.surface.centres[neighbour.panel as usize];
        if neighbour.mirrored { mirrored(centre) } else { centre }
    }

    fn unfold(&self, panel: usize, neighbour: &Neighbour) -> Unfolded {
        let edge = neighbour.edge as usize;
        let along = self.surface.edges[edge] / self.surface.lengths[edge];
        let start = self.surface.points[self.panels.edges[edge].a as usize];
        let normal = |v: Vector3| v - along * along.dot(&v);
        let (centre, other) = (self.surface.centres[panel], self.centre(neighbour));
        let here = normal(start - centre);
        let there = normal(other - start);
        let (h, t) = (here.norm(), there.norm());
        let d = along * along.dot(&(other - centre)) + here * ((h + t) / h);
        Unfolded { along, here: (here, h), there: (there, t), d }
    }

    fn arm(&self, panel: usize, neighbour: &Neighbour) -> Arm {
        let d = self.unfold(panel, neighbour).d;
        let by_length = 1.0 / d.norm();
        Arm { u: d * by_length, by_length }
    }

    fn difference(neighbour: &Neighbour, panel: usize, mu: &[f64], circulation: &[f64]) -> f64 {
        let jump = neighbour.jump.map_or(0.0, |(strip, sign)| sign * circulation[strip as usize]);
        mu[neighbour.panel as usize] - mu[panel] + jump
    }

    /// y of a panel.
    fn solved(&self, panel: usize, mu: &[f64], circulation: &[f64]) -> Vector3 {
        let mut r = Vector3::zeros();
        for neighbour in &self.stencils.neighbours[panel] {
            let arm = self.arm(panel, neighbour);
            r += arm.u * (arm.by_length * Self::difference(neighbour, panel, mu, circulation));
        }
        self.inverses[panel] * r
    }

    /// The gradient on a panel, in stretched coordinates.
    pub fn eval(&self, panel: usize, [mu, circulation]: [&[f64]; 2]) -> Slope {
        let n = &self.surface.normals[panel];
        let y = self.solved(panel, mu, circulation);
        let mut residuals = [0.0; 4];
        for (residual, neighbour) in residuals.iter_mut().zip(&self.stencils.neighbours[panel]) {
            let arm = self.arm(panel, neighbour);
            *residual = arm.by_length * Self::difference(neighbour, panel, mu, circulation) - arm.u.dot(&y);
        }
        Slope { gradient: y - n * n.dot(&y), residuals }
    }

    /// The gradient as weights of the panels' potentials, without jumps: for the circulation at trailing edges.
    pub fn weights(&self, panel: usize) -> Vec<(u32, Vector3)> {
        let n = &self.surface.normals[panel];
        let mut own = Vector3::zeros();
        let mut parts = Vec::with_capacity(5);
        for neighbour in &self.stencils.neighbours[panel] {
            let arm = self.arm(panel, neighbour);
            let y = self.inverses[panel] * arm.u * arm.by_length;
            let g = y - n * n.dot(&y);
            own -= g;
            parts.push((neighbour.panel, g));
        }
        parts.push((panel as u32, own));
        parts
    }

    /// The change of [`eval`](Self::eval) with changes of the surface, the potentials and the circulations.
    pub fn jvp(
        &self,
        panel: usize,
        [mu, circulation]: [&[f64]; 2],
        surface: &SurfaceChange,
        [d_mu, d_circulation]: [&[f64]; 2],
    ) -> Slope {
        let (n, dn) = (&self.surface.normals[panel], &surface.normals[panel]);
        let y = self.solved(panel, mu, circulation);
        let mut dr = -(dn * n.dot(&y) + n * dn.dot(&y));
        // The changes of the residuals at fixed y, and the directions u.
        let (mut residuals, mut ways) = ([0.0; 4], [Vector3::zeros(); 4]);
        for (i, neighbour) in self.stencils.neighbours[panel].iter().enumerate() {
            let way = self.unfold(panel, neighbour);
            let dd = self.unfold_jvp(panel, neighbour, &way, surface);
            let by_length = 1.0 / way.d.norm();
            let u = way.d * by_length;
            let du = (dd - u * u.dot(&dd)) * by_length;
            let d_by_length = -by_length * by_length * u.dot(&dd);
            let difference = Self::difference(neighbour, panel, mu, circulation);
            let change = Self::difference(neighbour, panel, d_mu, d_circulation);
            let d_rate = d_by_length * difference + by_length * change;
            dr += du * (by_length * difference) + u * d_rate - du * u.dot(&y) - u * du.dot(&y);
            (residuals[i], ways[i]) = (d_rate - du.dot(&y), u);
        }
        let dy = self.inverses[panel] * dr;
        for (residual, u) in residuals.iter_mut().zip(&ways) {
            *residual -= u.dot(&dy);
        }
        Slope { gradient: dy - dn * n.dot(&y) - n * (dn.dot(&y) + n.dot(&dy)), residuals }
    }

    fn unfold_jvp(
        &self,
        panel: usize,
        neighbour: &Neighbour,
        way: &Unfolded,
        change: &SurfaceChange,
    ) -> Vector3 {
        let e = &self.panels.edges[neighbour.edge as usize];
        let length = self.surface.lengths[neighbour.edge as usize];
        let (da, db) = (change.points[e.a as usize], change.points[e.b as usize]);
        let along = &way.along;
        let d_along = {
            let v = (db - da) / length;
            v - along * along.dot(&v)
        };
        let dc = change.centres[panel];
        let do_ = change.centres[neighbour.panel as usize];
        let do_ = if neighbour.mirrored { mirrored(do_) } else { do_ };
        let (centre, other) = (self.surface.centres[panel], self.centre(neighbour));
        let start = self.surface.points[e.a as usize];
        let normal = |v: &Vector3, dv: Vector3| {
            dv - d_along * along.dot(v) - along * (d_along.dot(v) + along.dot(&dv))
        };
        let d_here = normal(&(start - centre), da - dc);
        let d_there = normal(&(other - start), do_ - da);
        let (here, h) = &way.here;
        let (there, t) = &way.there;
        let (dh, dt) = (here.dot(&d_here) / h, there.dot(&d_there) / t);
        let step = other - centre;
        d_along * along.dot(&step)
            + along * (d_along.dot(&step) + along.dot(&(do_ - dc)))
            + d_here * ((h + t) / h)
            + here * ((dt - dh * t / h) / h)
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of surface, potentials and circulations.
    pub fn vjp(
        &self,
        panel: usize,
        [mu, circulation]: [&[f64]; 2],
        seed: &Slope,
        surface: &mut SurfaceChange,
        [mu_seeds, circulation_seeds]: [&mut [f64]; 2],
    ) {
        let n = &self.surface.normals[panel];
        let y = self.solved(panel, mu, circulation);
        let Slope { gradient: seed, residuals } = seed;
        let mut of_y = seed - n * n.dot(seed);
        for (neighbour, residual) in self.stencils.neighbours[panel].iter().zip(residuals) {
            of_y -= *residual * self.arm(panel, neighbour).u;
        }
        let z = self.inverses[panel] * of_y;
        surface.normals[panel] -= seed * n.dot(&y) + y * n.dot(seed) + z * n.dot(&y) + y * n.dot(&z);
        for (neighbour, residual) in self.stencils.neighbours[panel].iter().zip(residuals) {
            let way = self.unfold(panel, neighbour);
            let by_length = 1.0 / way.d.norm();
            let u = way.d * by_length;
            let difference = Self::difference(neighbour, panel, mu, circulation);
            let of_rate = u.dot(&z) + residual;
            let of_change = by_length * of_rate;
            mu_seeds[neighbour.panel as usize] += of_change;
            mu_seeds[panel] -= of_change;
            if let Some((strip, sign)) = neighbour.jump {
                circulation_seeds[strip as usize] += sign * of_change;
            }
            let of_u = z * (by_length * difference - u.dot(&y)) - y * of_rate;
            let of_by_length = difference * of_rate;
            let of_d = (of_u - u * u.dot(&of_u)) * by_length - u * (by_length * by_length * of_by_length);
            self.unfold_vjp(panel, neighbour, &way, &of_d, surface);
        }
    }

    fn unfold_vjp(
        &self,
        panel: usize,
        neighbour: &Neighbour,
        way: &Unfolded,
        seed: &Vector3,
        surface: &mut SurfaceChange,
    ) {
        let e = &self.panels.edges[neighbour.edge as usize];
        let length = self.surface.lengths[neighbour.edge as usize];
        let along = &way.along;
        let (centre, other) = (self.surface.centres[panel], self.centre(neighbour));
        let start = self.surface.points[e.a as usize];
        let (here, h) = &way.here;
        let (there, t) = &way.there;
        let step = other - centre;
        let mut of_along = seed * along.dot(&step) + step * along.dot(seed);
        let of_step = along * along.dot(seed);
        let of_ratio = here.dot(seed) / h;
        // The derivative of (h + t) / h is 1 / h with respect to t, -t / h^2 with respect to h.
        let of_here = seed * ((h + t) / h) - here * (of_ratio * t / (h * h));
        let of_there = there * (of_ratio / t);
        let mut of_ways = [Vector3::zeros(); 2];
        for (of_way, (v, of_normal)) in
            of_ways.iter_mut().zip([(start - centre, of_here), (other - start, of_there)])
        {
            *of_way = of_normal - along * along.dot(&of_normal);
            of_along -= of_normal * along.dot(&v) + v * along.dot(&of_normal);
        }
        let of_edge = (of_along - along * along.dot(&of_along)) / length;
        surface.points[e.a as usize] += of_ways[0] - of_ways[1] - of_edge;
        surface.points[e.b as usize] += of_edge;
        surface.centres[panel] -= of_step + of_ways[0];
        let of_other = of_step + of_ways[1];
        surface.centres[neighbour.panel as usize] +=
            if neighbour.mirrored { mirrored(of_other) } else { of_other };
    }
}
