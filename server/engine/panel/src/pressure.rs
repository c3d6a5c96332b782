//! Pressure coefficients and forces as forms in the onset flow.
//!
//! In stretched coordinates the velocity is tangential: `u_k = (I - n n^T) o_k + grad phi_k` for the onset flow `o_k` of unit velocity
//! along axis k. Bernoulli's equation there, transformed back by Goethert's rule:
//!
//! ```text
//! Cp = sum_kl w_k w_l C_kl,   C_kl = o_k . o_l - u_k . u_l - (1/6) sum_i r_ik r_il
//! ```
//!
//! Cp is the mean over a panel, on which the velocity changes linearly: by r_i from the centre to edge i, the residual of the gradient's
//! fit ([`crate::gradient`]). Two opposite edges with +r and -r make a mean square of r^2 / 3.
//!
//! At Mach zero it is Bernoulli's equation; else it is `-2 u - (B^2 u^2 + v^2 + w^2)` of the perturbations in the wind's axes.

use moldline_mesh::Vector3;

use crate::{
    coefficients::Totals,
    gradient::Slope,
    panels::Panels,
    surface::{Surface, SurfaceChange},
};

/// Weight in the mean square of the squared change of the velocity towards an edge.
const SPREAD: f64 = 1.0 / 6.0;

/// The area vector in real coordinates, and its transpose.
fn real_area(beta: f64, area: &Vector3) -> Vector3 {
    Vector3::new(area.x, beta * area.y, beta * area.z)
}

/// Forms of pressure on one panel.
pub(crate) type Form<const B: usize> = [[f64; B]; B];

/// Surface velocities and pressure forms of all panels.
#[derive(Clone, Debug)]
pub(crate) struct Pressure<const B: usize> {
    /// Velocities at the centres, and how much they change towards the edges.
    pub velocities: [Vec<Slope>; B],
    pub forms: Vec<Form<B>>,
}

/// Mean of the product of two velocities over a panel.
fn mean_product(u: &Slope, v: &Slope) -> f64 {
    u.gradient.dot(&v.gradient) + SPREAD * (0..4).map(|i| u.residuals[i] * v.residuals[i]).sum::<f64>()
}

impl<const B: usize> Pressure<B> {
    /// `gradients[k]` are those of the potentials.
    pub fn new(panels: &Panels, surface: &Surface, gradients: [Vec<Slope>; B]) -> Self {
        let onsets: [Vector3; B] = std::array::from_fn(|k| surface.onset(panels.axes()[k]));
        let mut velocities = gradients;
        for (velocities, onset) in velocities.iter_mut().zip(&onsets) {
            for (u, n) in velocities.iter_mut().zip(&surface.normals) {
                u.gradient += onset - n * n.dot(onset);
            }
        }
        let form = |panel: usize| {
            std::array::from_fn(|k| {
                std::array::from_fn(|l| {
                    onsets[k].dot(&onsets[l]) - mean_product(&velocities[k][panel], &velocities[l][panel])
                })
            })
        };
        let forms = (0..panels.len()).map(form).collect();
        Self { velocities, forms }
    }

    /// The changes of the forms with changes of gradients and surface.
    pub fn jvp(
        &self,
        panels: &Panels,
        surface: &Surface,
        gradients: &[Vec<Slope>; B],
        change: &SurfaceChange,
    ) -> Vec<Form<B>> {
        let onsets: [Vector3; B] = std::array::from_fn(|k| surface.onset(panels.axes()[k]));
        let d_onsets: [Vector3; B] =
            std::array::from_fn(|k| surface.onset_by_beta(panels.axes()[k]) * change.beta);
        (0..panels.len())
            .map(|panel| {
                let (n, dn) = (&surface.normals[panel], &change.normals[panel]);
                let du: [Slope; B] = std::array::from_fn(|k| {
                    let (o, d_o) = (&onsets[k], &d_onsets[k]);
                    let mut du = gradients[k][panel];
                    du.gradient += d_o - n * (n.dot(d_o) + dn.dot(o)) - dn * n.dot(o);
                    du
                });
                std::array::from_fn(|k| {
                    std::array::from_fn(|l| {
                        onsets[k].dot(&d_onsets[l]) + d_onsets[k].dot(&onsets[l])
                            - mean_product(&self.velocities[k][panel], &du[l])
                            - mean_product(&du[k], &self.velocities[l][panel])
                    })
                })
            })
            .collect()
    }

    /// The transpose of [`jvp`](Self::jvp): the seeds of the gradients; adds to those of the surface.
    pub fn vjp(
        &self,
        panels: &Panels,
        surface: &Surface,
        seeds: &[Form<B>],
        surface_seeds: &mut SurfaceChange,
    ) -> [Vec<Slope>; B] {
        let onsets: [Vector3; B] = std::array::from_fn(|k| surface.onset(panels.axes()[k]));
        let mut out: [Vec<Slope>; B] = std::array::from_fn(|_| vec![Slope::default(); panels.len()]);
        for (panel, seed) in seeds.iter().enumerate() {
            let n = &surface.normals[panel];
            for k in 0..B {
                let (mut of_u, mut of_onset) = (Vector3::zeros(), Vector3::zeros());
                for l in 0..B {
                    let both = seed[k][l] + seed[l][k];
                    let velocity = &self.velocities[l][panel];
                    of_u -= both * velocity.gradient;
                    for (out, r) in out[k][panel].residuals.iter_mut().zip(&velocity.residuals) {
                        *out -= SPREAD * both * r;
                    }
                    of_onset += both * onsets[l];
                }
                out[k][panel].gradient = of_u;
                of_onset += of_u - n * n.dot(&of_u);
                surface_seeds.normals[panel] -= onsets[k] * n.dot(&of_u) + of_u * n.dot(&onsets[k]);
                surface_seeds.beta += surface.onset_by_beta(panels.axes()[k]).dot(&of_onset);
            }
        }
        out
    }

    /// Adds force and pitching moment about the origin.
    pub fn totals(&self, panels: &Panels, surface: &Surface, totals: &mut Totals<B>) {
        let zero = SurfaceChange::zeros(surface);
        // Linear in forms and in areas: the same sum serves values and changes.
        sum_loads(panels, surface, &self.forms, &zero, None, totals);
    }

    /// Adds the changes of force and moment.
    pub fn totals_jvp(
        &self,
        panels: &Panels,
        surface: &Surface,
        forms: &[Form<B>],
        change: &SurfaceChange,
        totals: &mut Totals<B>,
    ) {
        sum_loads(panels, surface, forms, change, Some(&self.forms), totals);
    }

    /// The transpose of [`totals_jvp`](Self::totals_jvp): adds to the seeds of forms and surface.
    pub fn totals_vjp(
        &self,
        panels: &Panels,
        surface: &Surface,
        seeds: &Totals<B>,
        form_seeds: &mut [Form<B>],
        surface_seeds: &mut SurfaceChange,
    ) {
        let beta = surface.beta;
        let factor = if panels.symmetric { 2.0 } else { 1.0 };
        for panel in 0..panels.len() {
            let area = real_area(beta, &surface.areas[panel]);
            let centre = &surface.centres[panel];
            let (x, z) = (beta * centre.x, centre.z);
            let mut of_area = Vector3::zeros();
            let (mut of_x, mut of_z) = (0.0, 0.0);
            for k in 0..B {
                for l in 0..B {
                    let mut force = factor * seeds.force[k][l];
                    if panels.symmetric {
                        force.y = 0.0;
                    }
                    let moment = factor * seeds.moment[k][l];
                    let form = self.forms[panel][k][l];
                    form_seeds[panel][k][l] -= force.dot(&area) + moment * (z * area.x - x * area.z);
                    of_area -= form * (force + moment * Vector3::new(z, 0.0, -x));
                    of_x += form * moment * area.z;
                    of_z -= form * moment * area.x;
                }
            }
            let a = &surface.areas[panel];
            surface_seeds.areas[panel] += real_area(beta, &of_area);
            surface_seeds.beta += of_area.y * a.y + of_area.z * a.z + of_x * centre.x;
            surface_seeds.centres[panel].x += beta * of_x;
            surface_seeds.centres[panel].z += of_z;
        }
    }
}

/// Adds the loads of `forms`, and if there are `steady` ones those of the change of the surface under them.
fn sum_loads<const B: usize>(
    panels: &Panels,
    surface: &Surface,
    forms: &[Form<B>],
    change: &SurfaceChange,
    steady: Option<&[Form<B>]>,
    totals: &mut Totals<B>,
) {
    let beta = surface.beta;
    let factor = if panels.symmetric { 2.0 } else { 1.0 };
    for panel in 0..panels.len() {
        let area = real_area(beta, &surface.areas[panel]);
        let centre = &surface.centres[panel];
        let (x, z) = (beta * centre.x, centre.z);
        let mut add = |form: &Form<B>, force: Vector3, moment: f64| {
            let mut force = factor * force;
            if panels.symmetric {
                force.y = 0.0;
            }
            for k in 0..B {
                for l in 0..B {
                    totals.force[k][l] -= force * form[k][l];
                    totals.moment[k][l] -= factor * moment * form[k][l];
                }
            }
        };
        add(&forms[panel], area, z * area.x - x * area.z);
        if let Some(steady) = steady {
            let a = &surface.areas[panel];
            let d_area = real_area(beta, &change.areas[panel]) + change.beta * Vector3::new(0.0, a.y, a.z);
            let dc = &change.centres[panel];
            let dx = beta * dc.x + change.beta * centre.x;
            let moment = dc.z * area.x + z * d_area.x - dx * area.z - x * d_area.z;
            add(&steady[panel], d_area, moment);
        }
    }
}
