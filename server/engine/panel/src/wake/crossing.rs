//! Whether a wake cuts the surface: seen along x, whether an edge of a cell downstream crosses the trailing edge.

use moldline_mesh::Vector3;

use super::{sheets::Corner, strips::Strip};
use crate::{PanelError, panels::Panels};

/// Distance that counts as touching, as a fraction of a length.
const TOUCH: f64 = 1e-9;

/// Checks that no edge crosses the infinite part of a strip, from `pq` on. The sheet beside a body is left out: it begins on it.
pub(super) fn check(
    panels: &Panels,
    points: &[Vector3],
    strip: &Strip,
    [p, q]: &[Corner; 2],
) -> Result<(), PanelError> {
    {
        let own = [p.x, q.x, p.yz, q.yz];
        let ends = [p, q].map(|corner| corner.position(points));
        for e in &panels.edges {
            if own.contains(&e.a) || own.contains(&e.b) {
                continue;
            }
            if let Some(x) = crossing(&ends, [e.a, e.b].map(|v| &points[v as usize])) {
                return Err(PanelError::WakeCutsBody {
                    edge: [panels.vertex_of[strip.a as usize], panels.vertex_of[strip.b as usize]],
                    cell: panels.cell_of[e.left as usize],
                    x,
                });
            }
        }
    }
    Ok(())
}

/// Where the edge ab crosses the strip from pq along x: `p + s (q - p) = a + t (b - a)` in y and z, and downstream in x.
fn crossing([p, q]: &[Vector3; 2], [a, b]: [&Vector3; 2]) -> Option<f64> {
    if a.x.max(b.x) <= p.x.min(q.x) {
        return None;
    }
    let along = q - p;
    let size = along.norm();
    let (side, way) = (b - a, a - p);
    let determinant = along.y * side.z - along.z * side.y;
    if determinant.abs() <= TOUCH * size * side.norm() {
        return None;
    }
    let s = (way.y * side.z - way.z * side.y) / determinant;
    let t = (way.y * along.z - way.z * along.y) / determinant;
    let inside = (TOUCH..=1.0 - TOUCH).contains(&s) && (-TOUCH..=1.0 + TOUCH).contains(&t);
    let x = a.x + t * side.x;
    (inside && x > p.x + s * along.x + TOUCH * size).then_some(x)
}
