//! The stretched surface of Goethert's rule: points, panels, edges, sources.
//!
//! The perturbation potential phi of a subsonic flow obeys `B^2 phi_xx + phi_yy + phi_zz = 0`, `B^2 = 1 - M^2`, and lets no mass
//! through the surface: `(B^2 phi_x, phi_y, phi_z) . n = -V . n`. With x stretched by 1/B both become those of an
//! incompressible flow, whose onset is `V' = (V_x / B, V_y, V_z)`.

use moldline_mesh::Vector3;

use crate::{PanelError, panels::Panels};

/// Geometry of the solved panels, in stretched coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    pub mach: f64,
    /// `B = sqrt(1 - M^2)`.
    pub beta: f64,
    /// Vertices.
    pub points: Vec<Vector3>,
    /// Means of the panels' vertices: the collocation points.
    pub centres: Vec<Vector3>,
    /// Area vectors (Newell).
    pub areas: Vec<Vector3>,
    /// Unit normals.
    pub normals: Vec<Vector3>,
    /// Vectors along the edges.
    pub edges: Vec<Vector3>,
    /// Their lengths.
    pub lengths: Vec<f64>,
}

impl Surface {
    /// The surface of points that are not stretched yet.
    pub fn new(panels: &Panels, points: &[Vector3], mach: f64) -> Result<Self, PanelError> {
        let beta = (1.0 - mach * mach).sqrt();
        let points: Vec<Vector3> = points.iter().map(|p| Vector3::new(p.x / beta, p.y, p.z)).collect();
        let mut centres = Vec::with_capacity(panels.corners.len());
        let mut areas = Vec::with_capacity(panels.corners.len());
        for (panel, corners) in panels.corners.iter().enumerate() {
            let [a, b, c, d] = corners.map(|v| points[v as usize]);
            let weights = panels.weights(panel);
            centres.push(weights[0] * a + weights[1] * b + weights[2] * c + weights[3] * d);
            let (one, two) = (c - a, d - b);
            let area: Vector3 = 0.5 * one.cross(&two);
            let extent = one.norm_squared() + two.norm_squared();
            if area.norm().partial_cmp(&(1e-10 * extent)) != Some(std::cmp::Ordering::Greater) {
                return Err(PanelError::ZeroArea { cell: panels.cell_of[panel], area: area.norm() });
            }
            areas.push(area);
        }
        let normals = areas.iter().map(|a| a / a.norm()).collect();
        let edges: Vec<Vector3> =
            panels.edges.iter().map(|e| points[e.b as usize] - points[e.a as usize]).collect();
        let lengths: Vec<f64> = edges.iter().map(|e| e.norm()).collect();
        if let Some(edge) = lengths.iter().position(|l| *l <= 0.0) {
            let e = &panels.edges[edge];
            let edge = [panels.vertex_of[e.a as usize], panels.vertex_of[e.b as usize]];
            return Err(PanelError::ZeroEdge { edge, cell: panels.cell_of[e.left as usize] });
        }
        Ok(Self { mach, beta, points, centres, areas, normals, edges, lengths })
    }
}

/// A change of the surface in one direction, or seeds of it.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceChange {
    pub beta: f64,
    pub points: Vec<Vector3>,
    pub centres: Vec<Vector3>,
    pub areas: Vec<Vector3>,
    pub normals: Vec<Vector3>,
}

impl SurfaceChange {
    /// No change.
    pub fn zeros(surface: &Surface) -> Self {
        let panels = vec![Vector3::zeros(); surface.centres.len()];
        Self {
            beta: 0.0,
            points: vec![Vector3::zeros(); surface.points.len()],
            centres: panels.clone(),
            areas: panels.clone(),
            normals: panels,
        }
    }
}

impl Surface {
    /// The change that changes of the points (before stretching) and of the Mach number cause.
    pub fn jvp(&self, panels: &Panels, points: &[Vector3], mach: f64) -> SurfaceChange {
        let mut change = SurfaceChange::zeros(self);
        change.beta = -self.mach * mach / self.beta;
        let by_beta = change.beta / self.beta;
        for (out, (p, x)) in change.points.iter_mut().zip(points.iter().zip(&self.points)) {
            *out = Vector3::new(p.x / self.beta - x.x * by_beta, p.y, p.z);
        }
        for (panel, corners) in panels.corners.iter().enumerate() {
            let [a, b, c, d] = corners.map(|v| self.points[v as usize]);
            let [da, db, dc, dd] = corners.map(|v| change.points[v as usize]);
            let weights = panels.weights(panel);
            change.centres[panel] = weights[0] * da + weights[1] * db + weights[2] * dc + weights[3] * dd;
            let area = 0.5 * ((dc - da).cross(&(d - b)) + (c - a).cross(&(dd - db)));
            change.areas[panel] = area;
            let n = &self.normals[panel];
            change.normals[panel] = (area - n * n.dot(&area)) / self.areas[panel].norm();
        }
        change
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the points and of the Mach number.
    pub fn vjp(&self, panels: &Panels, mut seeds: SurfaceChange) -> (Vec<Vector3>, f64) {
        for (panel, corners) in panels.corners.iter().enumerate() {
            let n = &self.normals[panel];
            let normal = seeds.normals[panel];
            let area = seeds.areas[panel] + (normal - n * n.dot(&normal)) / self.areas[panel].norm();
            let [a, b, c, d] = corners.map(|v| self.points[v as usize]);
            let one = 0.5 * (d - b).cross(&area);
            let two = 0.5 * area.cross(&(c - a));
            let weights = panels.weights(panel);
            let parts = [-one, -two, one, two];
            for k in 0..4 {
                seeds.points[corners[k] as usize] += weights[k] * seeds.centres[panel] + parts[k];
            }
        }
        let mut beta = seeds.beta;
        let points = seeds
            .points
            .iter()
            .zip(&self.points)
            .map(|(seed, x)| {
                beta -= seed.x * x.x / self.beta;
                Vector3::new(seed.x / self.beta, seed.y, seed.z)
            })
            .collect();
        (points, -self.mach * beta / self.beta)
    }
}

impl Surface {
    /// The onset flow of unit velocity along an axis, in stretched coordinates.
    pub fn onset(&self, axis: usize) -> Vector3 {
        let mut v = Vector3::zeros();
        v[axis] = if axis == 0 { 1.0 / self.beta } else { 1.0 };
        v
    }

    /// The derivative of [`onset`](Self::onset) with respect to B.
    pub fn onset_by_beta(&self, axis: usize) -> Vector3 {
        if axis == 0 { Vector3::x() * (-1.0 / (self.beta * self.beta)) } else { Vector3::zeros() }
    }

    /// `sigma n` of every panel for the onset flow along `axis`: `sigma = -V' . n`.
    pub fn sources(&self, axis: usize) -> Vec<Vector3> {
        let onset = self.onset(axis);
        self.normals.iter().map(|n| -onset.dot(n) * n).collect()
    }

    /// The change of [`sources`](Self::sources).
    pub fn sources_jvp(&self, axis: usize, change: &SurfaceChange) -> Vec<Vector3> {
        let onset = self.onset(axis);
        let d_onset = self.onset_by_beta(axis) * change.beta;
        self.normals
            .iter()
            .zip(&change.normals)
            .map(|(n, dn)| -(d_onset.dot(n) + onset.dot(dn)) * n - onset.dot(n) * dn)
            .collect()
    }

    /// The transpose of [`sources_jvp`](Self::sources_jvp): adds to the seeds of normals and B.
    pub fn sources_vjp(&self, axis: usize, seeds: &[Vector3], change: &mut SurfaceChange) {
        let onset = self.onset(axis);
        let by_beta = self.onset_by_beta(axis);
        for ((n, seed), of_normal) in self.normals.iter().zip(seeds).zip(&mut change.normals) {
            let along = seed.dot(n);
            *of_normal -= onset * along + seed * onset.dot(n);
            change.beta -= by_beta.dot(n) * along;
        }
    }
}
