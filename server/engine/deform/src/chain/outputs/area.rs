//! Wetted area of a component: the sum over its cells. It is homogeneous in the vertices, `2 A = sum x . dA/dx`.

use moldline_spline::Vector3;

use super::gradient::Measured;

/// The area, m^2.
pub(super) fn eval(at: Measured, component: u32) -> f64 {
    at.euler(&gradient(at, component)) / 2.0
}

/// `dA/dx` of a component's cells; a quadrilateral's area is that of its area vector.
pub(super) fn gradient(at: Measured, component: u32) -> Vec<Vector3> {
    let mut gradient = vec![Vector3::zeros(); at.vertices.len()];
    let x = |v: u32| Vector3::from(at.vertices[v as usize]);
    for (cell, _) in at.cells.iter().zip(at.owners).filter(|(_, owner)| **owner == component) {
        // The area vector is half the cross product of the differences p - q and r - s.
        let (p, q, r, s) = match *cell.vertices() {
            [a, b, c] => (b, a, c, a),
            [a, b, c, d] => (c, a, d, b),
            _ => continue,
        };
        let (e, f) = (x(p) - x(q), x(r) - x(s));
        let Some(n) = e.cross(&f).try_normalize(0.0) else { continue };
        let (by_e, by_f) = (f.cross(&n) * 0.5, n.cross(&e) * 0.5);
        gradient[p as usize] += by_e;
        gradient[q as usize] -= by_e;
        gradient[r as usize] += by_f;
        gradient[s as usize] -= by_f;
    }
    gradient
}
