//! Pressure coefficients and forces as forms in the onset flow.
//!
//! The flow inside is at rest, so that the velocity outside is the surface gradient of the potential: `u_k` for the onset flow `o_k` of unit velocity
//! along axis k, in stretched coordinates ([`crate::recovery`]). Bernoulli's equation there, transformed back by Goethert's rule:
//!
//! ```text
//! Cp = sum_kl w_k w_l C_kl,   C_kl = o_k . o_l - u_k . u_l
//! ```
//!
//! At Mach zero it is Bernoulli's equation; else it is `-2 u - (B^2 u^2 + v^2 + w^2)` of the perturbations in the wind's axes.
//!
//! With the circulation `c = area n x u` of an element, its `area u = c x n`.

use moldline_mesh::Vector3;

use crate::{
    coefficients::Totals,
    elements::{circulation, circulation_by_corners, circulation_by_values},
    influence::Layout,
    panels::Panels,
    recovery::Recovery,
    surface::{Surface, SurfaceChange, area, area_by_corners, area_jvp},
};

/// The area vector in real coordinates, and its transpose.
fn real_area(beta: f64, area: &Vector3) -> Vector3 {
    Vector3::new(area.x, beta * area.y, beta * area.z)
}

/// Forms of pressure on one panel.
pub(crate) type Form<const B: usize> = [[f64; B]; B];

/// Velocities and pressure forms of all panels.
#[derive(Clone, Debug)]
pub(crate) struct Pressure<const B: usize> {
    velocities: [Vec<Vector3>; B],
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

    /// Mean gradients of the potential on all panels: `sum over elements of c x n`, over the area.
    fn gradients(&self, nodes: &[f64]) -> Vec<Vector3> {
        let of_panel = |panel: usize| {
            let of_element = |e: usize| {
                let corners = &self.surface.corners[e];
                circulation(corners, &self.layout.element_values(e, nodes)).cross(&area(corners).normalize())
            };
            self.layout.elements.of(panel).map(of_element).sum::<Vector3>() / self.surface.sizes[panel]
        };
        (0..self.panels.len()).map(of_panel).collect()
    }

    fn recovery(&self) -> Recovery<'_> {
        Recovery::new(self.panels, &self.layout.smooth, &self.surface.sizes)
    }

    /// Velocities and forms.
    pub fn eval(&self) -> Pressure<B> {
        let onsets = self.onsets();
        let recovery = self.recovery();
        let velocities: [Vec<Vector3>; B] =
            std::array::from_fn(|k| recovery.eval(&self.gradients(self.nodes[k])));
        let form = |panel: usize| {
            std::array::from_fn(|k| {
                std::array::from_fn(|l| {
                    onsets[k].dot(&onsets[l]) - velocities[k][panel].dot(&velocities[l][panel])
                })
            })
        };
        let forms = (0..self.panels.len()).map(form).collect();
        Pressure { velocities, forms }
    }

    /// The changes of the forms with those of surface and nodes.
    pub fn jvp(
        &self,
        pressure: &Pressure<B>,
        change: &SurfaceChange,
        d_nodes: &[Vec<f64>; B],
    ) -> Vec<Form<B>> {
        let (surface, layout) = (self.surface, self.layout);
        let onsets = self.onsets();
        let d_onsets: [Vector3; B] =
            std::array::from_fn(|k| surface.onset_by_beta(self.panels.axes()[k]) * change.beta);
        let recovery = self.recovery();
        let mut d_sizes = vec![0.0; self.panels.len()];
        let mut sums: [Vec<Vector3>; B] = std::array::from_fn(|_| vec![Vector3::zeros(); self.panels.len()]);
        for panel in 0..self.panels.len() {
            for e in layout.elements.of(panel) {
                let corners = &surface.corners[e];
                let d_corners = change.corners(self.panels, &layout.elements, e);
                let vector = area(corners);
                let (n, d_area) = (vector.normalize(), area_jvp(corners, &d_corners));
                let dn = (d_area - n * n.dot(&d_area)) / vector.norm();
                d_sizes[panel] += n.dot(&d_area);
                for k in 0..B {
                    let values = layout.element_values(e, self.nodes[k]);
                    let dc = circulation(&d_corners, &values)
                        + circulation(corners, &layout.element_values(e, &d_nodes[k]));
                    sums[k][panel] += dc.cross(&n) + circulation(corners, &values).cross(&dn);
                }
            }
        }
        let d_velocities: [Vec<Vector3>; B] = std::array::from_fn(|k| {
            let gradients = self.gradients(self.nodes[k]);
            let d_gradients: Vec<Vector3> = (0..self.panels.len())
                .map(|p| (sums[k][p] - d_sizes[p] * gradients[p]) / surface.sizes[p])
                .collect();
            recovery.jvp(&gradients, &d_gradients, &d_sizes)
        });
        let form = |panel: usize| {
            std::array::from_fn(|k| {
                std::array::from_fn(|l| {
                    onsets[k].dot(&d_onsets[l]) + d_onsets[k].dot(&onsets[l])
                        - pressure.velocities[k][panel].dot(&d_velocities[l][panel])
                        - d_velocities[k][panel].dot(&pressure.velocities[l][panel])
                })
            })
        };
        (0..self.panels.len()).map(form).collect()
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of surface and nodes.
    pub fn vjp(
        &self,
        pressure: &Pressure<B>,
        seeds: &[Form<B>],
        change: &mut SurfaceChange,
        node_seeds: &mut [Vec<f64>; B],
    ) {
        let (surface, layout) = (self.surface, self.layout);
        let onsets = self.onsets();
        let recovery = self.recovery();
        let mut of_sizes = vec![0.0; self.panels.len()];
        let mut of_sums: [Vec<Vector3>; B] = std::array::from_fn(|_| Vec::new());
        for k in 0..B {
            let both = |panel: usize, l: usize| seeds[panel][k][l] + seeds[panel][l][k];
            let velocity = |panel: usize| {
                -(0..B).map(|l| both(panel, l) * pressure.velocities[l][panel]).sum::<Vector3>()
            };
            let of_velocities: Vec<Vector3> = (0..self.panels.len()).map(velocity).collect();
            let onset: Vector3 =
                (0..self.panels.len()).map(|p| (0..B).map(|l| both(p, l) * onsets[l]).sum::<Vector3>()).sum();
            change.beta += surface.onset_by_beta(self.panels.axes()[k]).dot(&onset);
            let gradients = self.gradients(self.nodes[k]);
            of_sums[k] = recovery.vjp(&gradients, &of_velocities, &mut of_sizes);
            for (panel, of) in of_sums[k].iter_mut().enumerate() {
                *of /= surface.sizes[panel];
                of_sizes[panel] -= of.dot(&gradients[panel]);
            }
        }
        for panel in 0..self.panels.len() {
            for e in layout.elements.of(panel) {
                let corners = &surface.corners[e];
                let vector = area(corners);
                let n = vector.normalize();
                let mut corner_seeds = [Vector3::zeros(); 3];
                let mut of_normal = Vector3::zeros();
                for k in 0..B {
                    let values = layout.element_values(e, self.nodes[k]);
                    let seed = &of_sums[k][panel];
                    // seed . (c x n) = c . (n x seed) = n . (seed x c)
                    let of_c = n.cross(seed);
                    of_normal += seed.cross(&circulation(corners, &values));
                    let by_corners = circulation_by_corners(&of_c, &values);
                    (0..3).for_each(|i| corner_seeds[i] += by_corners[i]);
                    let by_values =
                        layout.elements.list[e].corner_seeds(&circulation_by_values(&of_c, corners));
                    for (node, by) in layout.nodes.of_corner[panel].iter().zip(by_values) {
                        node_seeds[k][*node as usize] += by;
                    }
                }
                let of_area = (of_normal - n * n.dot(&of_normal)) / vector.norm() + of_sizes[panel] * n;
                let by_area = area_by_corners(&of_area, corners);
                (0..3).for_each(|i| corner_seeds[i] += by_area[i]);
                change.add_corners(self.panels, &layout.elements, e, &corner_seeds);
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
fn add_area_seed(
    panels: &Panels,
    surface: &Surface,
    panel: usize,
    seed: &Vector3,
    change: &mut SurfaceChange,
) {
    let corners = panels.corners[panel].map(|p| p as usize);
    let [a, b, c, d] = corners.map(|p| surface.points[p]);
    let one = 0.5 * (d - b).cross(seed);
    let two = 0.5 * seed.cross(&(c - a));
    change.points[corners[2]] += one;
    change.points[corners[0]] -= one;
    change.points[corners[3]] += two;
    change.points[corners[1]] -= two;
}
