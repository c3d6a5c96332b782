//! The stretched surface of Goethert's rule: points, and the geometry of panels and elements.
//!
//! The potential Phi of a subsonic flow of small perturbations obeys `B^2 Phi_xx + Phi_yy + Phi_zz = 0`, `B^2 = 1 - M^2`, and lets no mass
//! through the surface. With x stretched by 1/B both become those of an incompressible flow, whose onset is `V' = (V_x / B, V_y, V_z)`.

use moldline_mesh::Vector3;

use crate::{PanelError, elements::Elements, panels::Panels};

/// Geometry of the solved panels, in stretched coordinates.
#[derive(Clone, Debug)]
pub(crate) struct Surface {
    pub mach: f64,
    /// `B = sqrt(1 - M^2)`.
    pub beta: f64,
    /// Vertices.
    pub points: Vec<Vector3>,
    /// Means of the panels' vertices.
    pub centres: Vec<Vector3>,
    /// Area vectors of the panels: sums of those of their elements.
    pub areas: Vec<Vector3>,
    /// Corners of the elements.
    pub corners: Vec<[Vector3; 3]>,
    /// Sums of the elements' areas in every panel.
    pub sizes: Vec<f64>,
}

/// The area vector of a triangle.
pub(crate) fn area(corners: &[Vector3; 3]) -> Vector3 {
    0.5 * (corners[1] - corners[0]).cross(&(corners[2] - corners[0]))
}

/// The change of [`area`] with the corners.
pub(crate) fn area_jvp(corners: &[Vector3; 3], d: &[Vector3; 3]) -> Vector3 {
    0.5 * ((d[1] - d[0]).cross(&(corners[2] - corners[0])) + (corners[1] - corners[0]).cross(&(d[2] - d[0])))
}

/// The gradient of `of.area` with respect to the corners.
pub(crate) fn area_by_corners(of: &Vector3, corners: &[Vector3; 3]) -> [Vector3; 3] {
    [0, 1, 2].map(|k: usize| 0.5 * of.cross(&(corners[(k + 2) % 3] - corners[(k + 1) % 3])))
}

impl Surface {
    /// The surface of points that are not stretched yet.
    pub fn new(
        panels: &Panels,
        elements: &Elements,
        points: &[Vector3],
        mach: f64,
    ) -> Result<Self, PanelError> {
        let beta = (1.0 - mach * mach).sqrt();
        let points: Vec<Vector3> = points.iter().map(|p| Vector3::new(p.x / beta, p.y, p.z)).collect();
        let mut surface = Self {
            mach,
            beta,
            centres: Vec::with_capacity(panels.len()),
            areas: Vec::with_capacity(panels.len()),
            corners: Vec::with_capacity(elements.len()),
            sizes: Vec::with_capacity(panels.len()),
            points,
        };
        let none = |panel: usize, area: f64| PanelError::ZeroArea { cell: panels.cell_of[panel], area };
        let exists =
            |area: f64, extent: f64| area.partial_cmp(&(1e-10 * extent)) == Some(std::cmp::Ordering::Greater);
        for panel in 0..panels.len() {
            let at = panels.corners[panel].map(|v| surface.points[v as usize]);
            let weights = panels.weights(panel);
            let (one, two) = (at[2] - at[0], at[3] - at[1]);
            let vector: Vector3 = 0.5 * one.cross(&two);
            if !exists(vector.norm(), one.norm_squared() + two.norm_squared()) {
                return Err(none(panel, vector.norm()));
            }
            surface.centres.push((0..4).map(|i| weights[i] * at[i]).sum());
            surface.areas.push(vector);
        }
        for e in &panels.edges {
            if surface.points[e.a as usize] == surface.points[e.b as usize] {
                let edge = [panels.vertex_of[e.a as usize], panels.vertex_of[e.b as usize]];
                return Err(PanelError::ZeroEdge { edge, cell: panels.cell_of[e.left as usize] });
            }
        }
        for panel in 0..panels.len() {
            let at = panels.corners[panel].map(|v| surface.points[v as usize]);
            let extent = (at[2] - at[0]).norm_squared() + (at[3] - at[1]).norm_squared();
            let mut size = 0.0;
            for element in elements.of(panel) {
                let corners = elements.list[element].of_corners(&at);
                let one = area(&corners).norm();
                if !exists(one, extent) {
                    return Err(none(panel, one));
                }
                size += one;
                surface.corners.push(corners);
            }
            surface.sizes.push(size);
        }
        Ok(surface)
    }

    /// The onset flow V' of a unit wind along an axis.
    pub fn onset(&self, axis: usize) -> Vector3 {
        let mut v = Vector3::zeros();
        v[axis] = if axis == 0 { 1.0 / self.beta } else { 1.0 };
        v
    }

    /// The derivative of [`onset`](Self::onset) with respect to B.
    pub fn onset_by_beta(&self, axis: usize) -> Vector3 {
        if axis == 0 { Vector3::x() * (-1.0 / (self.beta * self.beta)) } else { Vector3::zeros() }
    }

    /// The change of stretched points and of B that changes of the points (before stretching) and of the Mach number cause.
    pub fn jvp(&self, points: &[Vector3], mach: f64) -> SurfaceChange {
        let beta = -self.mach * mach / self.beta;
        let by_beta = beta / self.beta;
        let point = |(p, x): (&Vector3, &Vector3)| Vector3::new(p.x / self.beta - x.x * by_beta, p.y, p.z);
        SurfaceChange { beta, points: points.iter().zip(&self.points).map(point).collect() }
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the points and of the Mach number.
    pub fn vjp(&self, mut seeds: SurfaceChange) -> (Vec<Vector3>, f64) {
        let mut beta = seeds.beta;
        for (seed, x) in seeds.points.iter_mut().zip(&self.points) {
            beta -= seed.x * x.x / self.beta;
            seed.x /= self.beta;
        }
        (seeds.points, -beta * self.mach / self.beta)
    }
}

/// A change of the surface in one direction, or seeds of it.
#[derive(Clone, Debug)]
pub(crate) struct SurfaceChange {
    pub beta: f64,
    /// Stretched.
    pub points: Vec<Vector3>,
}

impl SurfaceChange {
    /// No change.
    pub fn zeros(surface: &Surface) -> Self {
        Self { beta: 0.0, points: vec![Vector3::zeros(); surface.points.len()] }
    }

    /// The changes of an element's corners.
    pub fn corners(&self, panels: &Panels, elements: &Elements, element: usize) -> [Vector3; 3] {
        let element = &elements.list[element];
        element.of_corners(&panels.corners[element.panel as usize].map(|v| self.points[v as usize]))
    }

    /// Adds to the seeds of an element's corners.
    pub fn add_corners(
        &mut self,
        panels: &Panels,
        elements: &Elements,
        element: usize,
        seeds: &[Vector3; 3],
    ) {
        let element = &elements.list[element];
        let points = &panels.corners[element.panel as usize];
        let seeds = element.corner_seeds(seeds);
        points.iter().zip(seeds).for_each(|(point, seed)| self.points[*point as usize] += seed);
    }

    /// The change of a panel's centre.
    pub fn centre(&self, panels: &Panels, panel: usize) -> Vector3 {
        let weights = panels.weights(panel);
        (0..4).map(|i| weights[i] * self.points[panels.corners[panel][i] as usize]).sum()
    }

    /// Adds to the seeds of a panel's centre.
    pub fn add_centre(&mut self, panels: &Panels, panel: usize, seed: &Vector3) {
        for (point, weight) in panels.corners[panel].iter().zip(panels.weights(panel)) {
            self.points[*point as usize] += weight * seed;
        }
    }
}
