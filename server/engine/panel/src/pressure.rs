//! Pressure coefficients and forces as forms in the onset flow.
//!
//! The flow inside is at rest, so that the velocity outside is the surface gradient of the potential: constant on every element, `u_k` for the onset
//! flow `o_k` of unit velocity along axis k, in stretched coordinates. Bernoulli's equation there, transformed back by Goethert's rule:
//!
//! ```text
//! Cp = sum_kl w_k w_l C_kl,   C_kl = o_k . o_l - mean of u_k . u_l over the panel
//! ```
//!
//! At Mach zero it is Bernoulli's equation; else it is `-2 u - (B^2 u^2 + v^2 + w^2)` of the perturbations in the wind's axes.
//!
//! With the circulation `c = area n x u` of an element, `u_k . u_l = c_k . c_l / area^2`.

use moldline_mesh::Vector3;

use crate::{
    coefficients::Totals,
    elements::{circulation, circulation_by_corners, circulation_by_values},
    influence::Layout,
    panels::Panels,
    surface::{Surface, SurfaceChange, area, area_by_corners},
};

/// The area vector in real coordinates, and its transpose.
fn real_area(beta: f64, area: &Vector3) -> Vector3 {
    Vector3::new(area.x, beta * area.y, beta * area.z)
}

/// Forms of pressure on one panel.
pub(crate) type Form<const B: usize> = [[f64; B]; B];

/// Pressure forms of all panels.
#[derive(Clone, Debug)]
pub(crate) struct Pressure<const B: usize> {
    pub forms: Vec<Form<B>>,
}

/// Surface, set-up, and potentials at the nodes.
pub(crate) struct Potentials<'a, const B: usize> {
    pub panels: &'a Panels,
    pub layout: &'a Layout,
    pub surface: &'a Surface,
    pub nodes: [&'a [f64]; B],
}

impl<const B: usize> Potentials<'_, B> {
    fn onsets(&self) -> [Vector3; B] {
        std::array::from_fn(|k| self.surface.onset(self.panels.axes()[k]))
    }

    /// Circulations and values at the corners of an element.
    fn element(&self, element: usize) -> [(Vector3, [f64; 3]); B] {
        std::array::from_fn(|k| {
            let values = self.layout.element_values(element, self.nodes[k]);
            (circulation(&self.surface.corners[element], &values), values)
        })
    }

    /// The forms: `sum over elements of c_k.c_l / area`, over the panel's area.
    pub fn eval(&self) -> Pressure<B> {
        let onsets = self.onsets();
        let form = |panel: usize| {
            let mut form: Form<B> = std::array::from_fn(|k| std::array::from_fn(|l| onsets[k].dot(&onsets[l])));
            for element in self.layout.elements.of(panel) {
                let by = 1.0 / (area(&self.surface.corners[element]).norm() * self.surface.sizes[panel]);
                let c = self.element(element);
                for k in 0..B {
                    for l in 0..B {
                        form[k][l] -= by * c[k].0.dot(&c[l].0);
                    }
                }
            }
            form
        };
        Pressure { forms: (0..self.panels.len()).map(form).collect() }
    }

    /// The changes of the forms with those of surface and nodes.
    pub fn jvp(&self, change: &SurfaceChange, d_nodes: &[Vec<f64>; B]) -> Vec<Form<B>> {
        let onsets = self.onsets();
        let d_onsets: [Vector3; B] =
            std::array::from_fn(|k| self.surface.onset_by_beta(self.panels.axes()[k]) * change.beta);
        let form = |panel: usize| {
            let mut form: Form<B> = std::array::from_fn(|k| {
                std::array::from_fn(|l| onsets[k].dot(&d_onsets[l]) + d_onsets[k].dot(&onsets[l]))
            });
            let size = self.surface.sizes[panel];
            let mut parts = [[0.0; B]; B];
            let mut d_size = 0.0;
            for element in self.layout.elements.of(panel) {
                let corners = &self.surface.corners[element];
                let d_corners = change.corners(self.panels, &self.layout.elements, element);
                let vector = area(corners);
                let one = vector.norm();
                let by_corners = area_by_corners(&(vector / one), corners);
                let d_one: f64 = (0..3).map(|k| by_corners[k].dot(&d_corners[k])).sum();
                d_size += d_one;
                let c = self.element(element);
                let dc: [Vector3; B] = std::array::from_fn(|k| {
                    circulation(&d_corners, &c[k].1)
                        + circulation(corners, &self.layout.element_values(element, &d_nodes[k]))
                });
                for k in 0..B {
                    for l in 0..B {
                        let product = c[k].0.dot(&c[l].0) / one;
                        parts[k][l] += product;
                        form[k][l] -= ((c[k].0.dot(&dc[l]) + dc[k].dot(&c[l].0)) / one - product * d_one / one) / size;
                    }
                }
            }
            for k in 0..B {
                for l in 0..B {
                    form[k][l] += parts[k][l] * d_size / (size * size);
                }
            }
            form
        };
        (0..self.panels.len()).map(form).collect()
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of surface and nodes.
    pub fn vjp(&self, seeds: &[Form<B>], change: &mut SurfaceChange, node_seeds: &mut [Vec<f64>; B]) {
        let onsets = self.onsets();
        for (panel, seed) in seeds.iter().enumerate() {
            let size = self.surface.sizes[panel];
            for k in 0..B {
                let of: Vector3 = (0..B).map(|l| (seed[k][l] + seed[l][k]) * onsets[l]).sum();
                change.beta += self.surface.onset_by_beta(self.panels.axes()[k]).dot(&of);
            }
            let mut of_size = 0.0;
            for element in self.layout.elements.of(panel) {
                let one = area(&self.surface.corners[element]).norm();
                let c = self.element(element);
                for k in 0..B {
                    for l in 0..B {
                        of_size += seed[k][l] * c[k].0.dot(&c[l].0) / (one * size * size);
                    }
                }
            }
            for element in self.layout.elements.of(panel) {
                let corners = &self.surface.corners[element];
                let vector = area(corners);
                let one = vector.norm();
                let c = self.element(element);
                let record = &self.layout.elements.list[element];
                let nodes = self.layout.nodes.of_corner[record.panel as usize];
                let mut of_one = of_size;
                let mut corner_seeds = [Vector3::zeros(); 3];
                for k in 0..B {
                    let mut of_c = Vector3::zeros();
                    for l in 0..B {
                        of_c -= (seed[k][l] + seed[l][k]) / (one * size) * c[l].0;
                        of_one += seed[k][l] * c[k].0.dot(&c[l].0) / (one * one * size);
                    }
                    let by_corners = circulation_by_corners(&of_c, &c[k].1);
                    (0..3).for_each(|i| corner_seeds[i] += by_corners[i]);
                    let by_values = circulation_by_values(&of_c, corners);
                    for (weights, by) in record.weights().iter().zip(by_values) {
                        for (node, weight) in nodes.iter().zip(weights) {
                            node_seeds[k][*node as usize] += weight * by;
                        }
                    }
                }
                let by_area = area_by_corners(&(of_one / one * vector), corners);
                (0..3).for_each(|i| corner_seeds[i] += by_area[i]);
                change.add_corners(self.panels, &self.layout.elements, element, &corner_seeds);
            }
        }
    }
}

impl<const B: usize> Pressure<B> {
    /// Adds force and pitching moment about the origin.
    pub fn totals(&self, panels: &Panels, surface: &Surface, totals: &mut Totals<B>) {
        // Linear in forms and in areas: the same sum serves values and changes.
        sum_loads(panels, surface, &self.forms, None, None, totals);
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
        sum_loads(panels, surface, forms, Some(change), Some(&self.forms), totals);
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
            add_area_seed(panels, surface, panel, &real_area(beta, &of_area), surface_seeds);
            surface_seeds.beta += of_area.y * a.y + of_area.z * a.z + of_x * centre.x;
            surface_seeds.add_centre(panels, panel, &Vector3::new(beta * of_x, 0.0, of_z));
        }
    }
}

/// Adds the loads of `forms`, and if there are `steady` ones those of the change of the surface under them.
fn sum_loads<const B: usize>(
    panels: &Panels,
    surface: &Surface,
    forms: &[Form<B>],
    change: Option<&SurfaceChange>,
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
        if let (Some(steady), Some(change)) = (steady, change) {
            let a = &surface.areas[panel];
            let d_area = real_area(beta, &area_change(panels, surface, panel, change))
                + change.beta * Vector3::new(0.0, a.y, a.z);
            let dc = change.centre(panels, panel);
            let dx = beta * dc.x + change.beta * centre.x;
            let moment = dc.z * area.x + z * d_area.x - dx * area.z - x * d_area.z;
            add(&steady[panel], d_area, moment);
        }
    }
}

/// The change of a panel's area vector, `1/2 (c - a) x (d - b)`.
fn area_change(panels: &Panels, surface: &Surface, panel: usize, change: &SurfaceChange) -> Vector3 {
    let [a, b, c, d] = panels.corners[panel].map(|p| surface.points[p as usize]);
    let [da, db, dc, dd] = panels.corners[panel].map(|p| change.points[p as usize]);
    0.5 * ((dc - da).cross(&(d - b)) + (c - a).cross(&(dd - db)))
}

/// The transpose of [`area_change`].
fn add_area_seed(panels: &Panels, surface: &Surface, panel: usize, seed: &Vector3, change: &mut SurfaceChange) {
    let corners = panels.corners[panel].map(|p| p as usize);
    let [a, b, c, d] = corners.map(|p| surface.points[p]);
    let one = 0.5 * (d - b).cross(seed);
    let two = 0.5 * seed.cross(&(c - a));
    change.points[corners[2]] += one;
    change.points[corners[0]] -= one;
    change.points[corners[3]] += two;
    change.points[corners[1]] -= two;
}
