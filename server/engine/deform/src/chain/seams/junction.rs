//! A vertex where three components meet: two distances are zero in the two parameters of the reference component.

use moldline_geometry::{Body, FootPoint, Location, ParameterDirection};
use moldline_spline::Vector3;

use super::target::Target;

/// Newton steps at most.
const STEPS: usize = 50;

/// A vertex where three components meet.
#[derive(Clone, Debug)]
pub struct Junction {
    /// Component on whose surface the point is sought.
    pub reference: u32,
    /// The vertex in the reference state.
    pub start: Location,
    /// The two components to be met at once.
    pub targets: [u32; 2],
}

/// A junction found.
pub(super) struct JunctionPoint {
    /// Its parameters on the reference component.
    pub at: Location,
    /// The foot points on the two targets.
    pub feet: [FootPoint; 2],
}

impl Junction {
    /// Newton's method from the reference state, damped; `tolerance` in metres. On failure, the distance that is left, m.
    pub(super) fn eval(&self, bodies: &[Body], tolerance: f64) -> Result<JunctionPoint, f64> {
        let body = &bodies[self.reference as usize];
        let look = |at: &Location| {
            let point = body.point(at);
            (point, self.targets.map(|t| bodies[t as usize].closest_point(&point.position)))
        };
        let norm = |feet: &[FootPoint; 2]| feet[0].distance.hypot(feet[1].distance);
        let mut at = self.start;
        let (mut point, mut feet) = look(&at);
        for _ in 0..STEPS {
            let distance = norm(&feet);
            if distance <= 0.1 * tolerance {
                break;
            }
            let [g_0, g_1] = feet.each_ref().map(|foot| foot.distance);
            let [[a, b], [c, d]] = slopes([&point.d_u, &point.d_v], &feet);
            let determinant = a * d - b * c;
            let (du, dv) = ((b * g_1 - d * g_0) / determinant, (c * g_0 - a * g_1) / determinant);
            let mut step = 1.0;
            let improved = loop {
                let along_u = body.walk(&at, ParameterDirection::U, step * du);
                let next = body.walk(&along_u, ParameterDirection::V, step * dv);
                let (next_point, next_feet) = look(&next);
                if norm(&next_feet) < distance {
                    (at, point, feet) = (next, next_point, next_feet);
                    break true;
                }
                step *= 0.5;
                if step < 1e-6 {
                    break false;
                }
            };
            if !improved {
                break;
            }
        }
        let residual = feet[0].distance.abs().max(feet[1].distance.abs());
        if residual > tolerance { Err(residual) } else { Ok(JunctionPoint { at, feet }) }
    }

    /// The derivative of the parameters at `at`, where the tangents are `j`: `dmu = N^-1 (n_t . (dS_t - dS_r))`,
    /// `N_ta = n_t . S_a`.
    pub(super) fn linearise(&self, at: Location, j: &[Vector3; 2], feet: &[FootPoint]) -> Vec<Target> {
        let [[a, b], [c, d]] = slopes([&j[0], &j[1]], feet);
        let determinant = a * d - b * c;
        let gains = [[d, -c], [-b, a]];
        let targets = self.targets.iter().zip(feet).zip(gains);
        let target = |((&component, foot), gain): ((&u32, &FootPoint), [f64; 2])| Target {
            component: component as usize,
            at: foot.location,
            from: at,
            normal: foot.normal,
            gain: gain.map(|g| g / determinant),
        };
        targets.map(target).collect()
    }
}

/// `n_t . S_a`: a row for each target, a column for each parameter.
fn slopes(tangents: [&Vector3; 2], feet: &[FootPoint]) -> [[f64; 2]; 2] {
    [0, 1].map(|t| tangents.map(|tangent| feet[t].normal.dot(tangent)))
}
