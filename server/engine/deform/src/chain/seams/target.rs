//! One equation of the implicit function theorem at a seam vertex: how the parameters of a point on the reference component
//! follow a component that it is to meet.

use moldline_geometry::{
    Block, Body, Location,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;

/// `dmu += gain * normal . (dS_t - dS_r)`: `S_t` where the target was met, `S_r` where it was looked at from.
#[derive(Clone, Debug)]
pub(super) struct Target {
    pub component: usize,
    pub at: Location,
    pub from: Location,
    pub normal: Vector3,
    pub gain: [f64; 2],
}

impl Target {
    /// Adds to the tangents `mu` of the parameters, a pair a direction.
    pub fn jvp(&self, reference: usize, bodies: &[Body], control_points: &[Block], mu: &mut [f64]) {
        let s = surface_jvp(bodies, self.component, &self.at, control_points);
        let from = surface_jvp(bodies, reference, &self.from, control_points);
        for d in 0..mu.len() / 2 {
            let gap = self.normal.dot(&(vector(&s, d) - vector(&from, d)));
            (0..2).for_each(|a| mu[2 * d + a] += self.gain[a] * gap);
        }
    }

    /// The transpose of [`jvp`](Self::jvp).
    pub fn vjp(&self, reference: usize, bodies: &[Body], mu: &[f64], control_points: &mut [Block]) {
        let k = mu.len() / 2;
        let (mut surface, mut from) = (vec![0.0; 3 * k], vec![0.0; 3 * k]);
        for d in 0..k {
            let gap = self.gain[0] * mu[2 * d] + self.gain[1] * mu[2 * d + 1];
            add_vector(&mut surface, d, &(self.normal * gap));
            add_vector(&mut from, d, &(self.normal * -gap));
        }
        surface_vjp(bodies, self.component, &self.at, &surface, control_points);
        surface_vjp(bodies, reference, &self.from, &from, control_points);
    }
}

/// Tangents of a surface point at fixed parameters.
pub(super) fn surface_jvp(
    bodies: &[Body],
    component: usize,
    at: &Location,
    control_points: &[Block],
) -> Vec<f64> {
    let mut row = vec![0.0; control_points[component].width()];
    bodies[component].basis(at).position_jvp(&control_points[component], &mut row);
    row
}

/// The transpose of [`surface_jvp`].
pub(super) fn surface_vjp(
    bodies: &[Body],
    component: usize,
    at: &Location,
    seed: &[f64],
    control_points: &mut [Block],
) {
    bodies[component].basis(at).position_vjp(seed, &mut control_points[component]);
}
