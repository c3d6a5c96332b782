//! The wanted length of edges: by curvature, by component, graded, and scaled to the number of cells.

use moldline_geometry::{Body, Location};

use crate::surface::{GONE, Surface};

/// Edges subtend this angle of the smallest radius of curvature, radians.
const ANGLE: f64 = 0.5;
/// Least size by curvature, relative to that of flat regions.
const LEAST: f64 = 0.25;
/// Growth of the size per length.
const GRADATION: f64 = 0.25;

/// Largest principal curvature, 1/m; `None` where the patch is singular.
fn curvature(body: &Body, l: &Location) -> Option<f64> {
    let j = body.jet(l);
    let n = j.d_u.cross(&j.d_v).try_normalize(1e-12 * j.d_u.norm() * j.d_v.norm())?;
    let (e, f, g) = (j.d_u.norm_squared(), j.d_u.dot(&j.d_v), j.d_v.norm_squared());
    let (l, m, k) = (j.d_uu.dot(&n), j.d_uv.dot(&n), j.d_vv.dot(&n));
    let determinant = e * g - f * f;
    let mean = 0.5 * (e * k - 2.0 * f * m + g * l) / determinant;
    let gauss = (l * k - m * m) / determinant;
    let value = mean.abs() + (mean * mean - gauss).max(0.0).sqrt();
    value.is_finite().then_some(value)
}

/// Sets the sizes so that about `cells` triangles result.
pub(crate) fn set(surface: &mut Surface<'_>, cells: f64, limits: &[Option<f64>], seam: Option<f64>) {
    let used: Vec<u32> =
        (0..surface.positions.len() as u32).filter(|&v| !surface.around[v as usize].is_empty()).collect();
    let radii: Vec<f64> = surface
        .holds
        .iter()
        .map(|hold| {
            let curvatures = hold
                .on
                .iter()
                .filter_map(|on| curvature(surface.bodies[on.component as usize], &on.location));
            1.0 / curvatures.fold(0.0, f64::max)
        })
        .collect();
    let edges = surface.edges();
    let (mut low, mut high) = (-40.0f64, 10.0f64);
    let length = surface.bodies.iter().map(|b| b.size()).fold(0.0, f64::max);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        let base = length * middle.exp2();
        for &v in &used {
            let hold = &surface.holds[v as usize];
            let mut size = base.min((ANGLE * radii[v as usize]).max(LEAST * base));
            for on in &hold.on {
                size = limits[on.component as usize].map_or(size, |limit| size.min(limit));
            }
            if let (Some(seam), true) = (seam, hold.on.len() > 1) {
                size = size.min(seam);
            }
            surface.sizes[v as usize] = size;
        }
        for _ in 0..8 {
            for &[a, b] in edges.iter().chain(edges.iter().rev()) {
                let reach = GRADATION * surface.length(a, b);
                let (p, q) = (surface.sizes[a as usize], surface.sizes[b as usize]);
                surface.sizes[a as usize] = p.min(q + reach);
                surface.sizes[b as usize] = q.min(p + reach);
            }
        }
        if count(surface) > cells { low = middle } else { high = middle }
    }
}

/// The number of equilateral triangles of the wanted sizes.
fn count(surface: &Surface<'_>) -> f64 {
    let cells = surface.triangles.iter().filter(|t| **t != GONE).map(|t| {
        let size: f64 = t.iter().map(|&v| surface.sizes[v as usize]).sum::<f64>() / 3.0;
        0.5 * surface.area(*t).norm() / (0.25 * 3f64.sqrt() * size * size)
    });
    cells.sum()
}
