//! Volumes: within the mesh, and of a component within its patches.
//!
//! The volume within the mesh is homogeneous in the vertices: `3 V = sum x . dV/dx`.

use moldline_foundation::quadrature::gauss_legendre;
use moldline_geometry::{Block, Body, Location};
use moldline_spline::Vector3;

use super::gradient::{FunctionGradient, Measured};

/// The volume within the mesh, m^3.
pub(super) fn enclosed(at: Measured) -> f64 {
    at.euler(&enclosed_gradient(at)) / 3.0
}

/// `dV/dx` of the volume within the mesh. A warped quadrilateral counts as the mean of its two splits into triangles.
pub(super) fn enclosed_gradient(at: Measured) -> Vec<Vector3> {
    let mut gradient = vec![Vector3::zeros(); at.vertices.len()];
    let mut add = |[a, b, c]: [u32; 3], weight: f64| {
        for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
            gradient[p as usize] += at.seen(q).cross(&at.seen(r)) * weight;
        }
    };
    for cell in at.cells {
        match *cell.vertices() {
            [a, b, c] => add([a, b, c], 1.0 / 6.0),
            [a, b, c, d] => {
                [[a, b, c], [a, c, d], [b, c, d], [b, d, a]].into_iter().for_each(|t| add(t, 1.0 / 12.0));
            }
            _ => {}
        }
    }
    gradient
}

/// The volume of a component, m^3: `1/3` of the flux of the position through its patches.
pub(super) fn eval(body: &Body, origin: Vector3) -> f64 {
    let mut volume = 0.0;
    quadrature(body, |weight, location| {
        let p = body.point(location);
        volume += weight * (p.position - origin).dot(&p.d_u.cross(&p.d_v)) / 3.0;
    });
    volume
}

/// Its gradient with respect to the control points.
pub(super) fn gradient(body: &Body, component: usize, origin: Vector3) -> FunctionGradient {
    let mut by_points = Block::zeros(body.control_points().len(), 3);
    quadrature(body, |weight, location| {
        let p = body.point(location);
        let (x, third) = (p.position - origin, weight / 3.0);
        let mut seed = Block::zeros(3, 3);
        let by = [p.d_u.cross(&p.d_v), p.d_v.cross(&x), x.cross(&p.d_u)];
        for (k, g) in by.into_iter().enumerate() {
            seed.row_mut(k).copy_from_slice((g * third).as_slice());
        }
        body.basis(location).point_vjp(&seed, &mut by_points);
    });
    FunctionGradient { vertices: Vec::new(), control_points: vec![(component, by_points)] }
}

/// Calls `f(weight, location)` at the points of a Gauss rule over all patches, exact for the volume of patches that are not
/// rational; weights are negative where a patch's parameters turn inwards.
pub fn quadrature(body: &Body, mut f: impl FnMut(f64, &Location)) {
    for (patch, description) in (0u32..).zip(body.component().patches()) {
        let surface = &description.surface;
        let sign = if description.flipped { -1.0 } else { 1.0 };
        // S . (S_u x S_v) has degree 3 p - 1; rational patches converge fast.
        let extra = if surface.is_rational() { 4 } else { 0 };
        let rule = |degree: usize| gauss_legendre((3 * degree).div_ceil(2) + extra);
        let (rule_u, rule_v) = (rule(surface.knots_u().degree()), rule(surface.knots_v().degree()));
        for u in surface.knots_u().breaks().windows(2) {
            for v in surface.knots_v().breaks().windows(2) {
                let (du, dv) = (0.5 * (u[1] - u[0]), 0.5 * (v[1] - v[0]));
                for (s, ws) in &rule_u {
                    for (t, wt) in &rule_v {
                        let location = Location { patch, u: u[0] + du * (1.0 + s), v: v[0] + dv * (1.0 + t) };
                        f(sign * ws * wt * du * dv, &location);
                    }
                }
            }
        }
    }
}
