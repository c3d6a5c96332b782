//! What a vertex lies on, and its projection onto all of it: Newton's method with steps of least length.

use moldline_foundation::Vector3;
use moldline_geometry::{Body, Location, Side};
use nalgebra::{Matrix3, SymmetricEigen};

/// Most steps of Newton's method; a seam takes four.
const MAX_STEPS: usize = 50;
/// Distance from each of them that is left, relative to the size of the component.
const TOLERANCE: f64 = 2e-14;
/// Directions whose eigenvalue is below this are free: angles of crossing below 1e-4.
const RANK: f64 = 1e-9;
/// Least cosine between normals, or between a triangle and the surface under it, that belong to one sheet.
pub(crate) const FACING: f64 = 0.3;

/// A component that a vertex lies on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct On {
    pub component: u32,
    /// The sharp edge that it lies on.
    pub edge: Option<u32>,
    /// Where the search starts.
    pub location: Location,
}

impl On {
    /// Whether the location is on a sharp edge or at a pole.
    pub fn is_on_a_crease(&self, body: &Body) -> bool {
        let component = body.component();
        let edge = component.edge_of(&self.location, 0.0).map(|edge| &component.edges()[edge as usize]);
        edge.is_some_and(|edge| edge.sharp || edge.collapsed)
    }
}

/// All that a vertex lies on.
#[derive(Clone, Debug, Default)]
pub(crate) struct Hold {
    pub on: Vec<On>,
    /// In the plane `y = 0`.
    pub plane: bool,
    /// At a corner of a component: it never moves.
    pub fixed: bool,
}

impl Hold {
    /// The location on a component.
    pub fn location(&self, component: u32) -> Option<Location> {
        self.on.iter().find(|on| on.component == component).map(|on| on.location)
    }

    /// Whether a point found from `from` has stayed on the sheets that `from` lies on: not on a sharp edge or pole that it is
    /// not held to, and not behind one.
    pub fn keeps_sheets_of(&self, from: &Self, bodies: &[&Body]) -> bool {
        self.on.iter().filter(|on| on.edge.is_none()).all(|on| {
            let body = bodies[on.component as usize];
            let turned = |l: Location| body.normal(&l).dot(&body.normal(&on.location)) < FACING;
            !on.is_on_a_crease(body) && !from.location(on.component).is_some_and(turned)
        })
    }

    /// The point of everything that is held nearest to `x`, to first order; `None` if there is none.
    pub fn project(&mut self, bodies: &[&Body], mut x: Vector3) -> Option<Vector3> {
        if self.fixed {
            return Some(x);
        }
        if self.plane {
            x.y = 0.0;
        }
        if let ([on], false) = (&mut self.on[..], self.plane) {
            let body = bodies[on.component as usize];
            let foot = match on.edge {
                Some(edge) => body.closest_point_on_edge(&x, edge, &on.location),
                None => body.closest_point_near(&x, &on.location)?,
            };
            on.location = foot.location;
            return Some(foot.position);
        }
        let mut last = f64::INFINITY;
        for _ in 0..MAX_STEPS {
            let mut matrix = Matrix3::zeros();
            let mut right = Vector3::zeros();
            let mut residual: f64 = 0.0;
            let mut size = f64::INFINITY;
            if self.plane {
                matrix.m22 += 1.0;
                right.y -= x.y;
            }
            for on in &mut self.on {
                let body = bodies[on.component as usize];
                size = size.min(body.size());
                if let Some(edge) = on.edge {
                    let foot = body.closest_point_on_edge(&x, edge, &on.location);
                    on.location = foot.location;
                    let tangent = tangent(body, edge, &foot.location)?;
                    let across = Matrix3::identity() - tangent * tangent.transpose();
                    let d = across * (x - foot.position);
                    matrix += across;
                    right -= d;
                    residual = residual.max((x - foot.position).norm() / body.size());
                } else {
                    let foot = body.closest_point_near(&x, &on.location)?;
                    on.location = foot.location;
                    matrix += foot.normal * foot.normal.transpose();
                    right -= foot.normal * foot.distance;
                    residual = residual.max(foot.distance.abs() / body.size());
                }
            }
            if residual <= TOLERANCE || (residual <= 1e-12 && residual >= last) {
                return Some(x);
            }
            last = residual;
            let eigen = SymmetricEigen::new(matrix);
            let largest = eigen.eigenvalues.max();
            let mut step = Vector3::zeros();
            for k in 0..3 {
                let v = eigen.eigenvectors.column(k).into_owned();
                if eigen.eigenvalues[k] > RANK * largest {
                    step += v * (v.dot(&right) / eigen.eigenvalues[k]);
                }
            }
            let limit = 0.1 * size;
            if step.norm() > limit {
                step *= limit / step.norm();
            }
            x += step;
            if self.plane {
                x.y = 0.0;
            }
        }
        None
    }
}

/// The unit tangent of an edge at a location on it; `None` where its derivative vanishes.
fn tangent(body: &Body, edge: u32, l: &Location) -> Option<Vector3> {
    let [u, v] = body.component().patches()[l.patch as usize].surface.domain();
    let point = body.point(l);
    let side = body.component().edges()[edge as usize].sides.iter().find(|s| {
        s.patch == l.patch
            && match s.side {
                Side::UMin => l.u == u.0,
                Side::UMax => l.u == u.1,
                Side::VMin => l.v == v.0,
                Side::VMax => l.v == v.1,
            }
    })?;
    let along = if side.side.holds_u() { point.d_v } else { point.d_u };
    along.try_normalize(0.0)
}
