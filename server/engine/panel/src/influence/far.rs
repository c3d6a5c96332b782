//! The mean inverse distance of two plane figures that are far apart, with its gradient; and the change between near and far.
//!
//! With the way `d` between their centroids and the sum S of their second moments about them (means of `x x^T`),
//!
//! ```text
//! mean of 1/r = 1/R + (3 d.S.d / R^2 - tr S) / (2 R^3) + fourth order,   R = |d|
//! ```

use moldline_foundation::smooth_step::smooth_step;
use moldline_mesh::Vector3;

/// Distance over the sum of the radii from which on figures begin to count as far, and from which on they do.
const FAR: [f64; 2] = [2.0, 2.7];

/// A symmetric tensor: xx, yy, zz, xy, yz, zx.
pub(crate) type Moments = [f64; 6];

/// The moments of `weight x x^T`.
pub(crate) fn moments(x: &Vector3, weight: f64) -> Moments {
    [x.x * x.x, x.y * x.y, x.z * x.z, x.x * x.y, x.y * x.z, x.z * x.x].map(|m| weight * m)
}

/// The gradient of `sum_k of_k moments_k(x)` with respect to x.
pub(crate) fn moments_gradient(of: &Moments, x: &Vector3) -> Vector3 {
    Vector3::new(
        2.0 * of[0] * x.x + of[3] * x.y + of[5] * x.z,
        2.0 * of[1] * x.y + of[3] * x.x + of[4] * x.z,
        2.0 * of[2] * x.z + of[4] * x.y + of[5] * x.x,
    )
}

/// The mean inverse distance.
#[inline(always)]
pub(crate) fn mean(d: [f64; 3], s: &Moments) -> f64 {
    let [x, y, z] = d;
    let by_squared = 1.0 / (x * x + y * y + z * z);
    let by_r = by_squared.sqrt();
    let quadratic =
        s[0] * x * x + s[1] * y * y + s[2] * z * z + 2.0 * (s[3] * x * y + s[4] * y * z + s[5] * z * x);
    by_r + 0.5 * by_r * by_squared * (3.0 * quadratic * by_squared - (s[0] + s[1] + s[2]))
}

/// The mean, its gradient with respect to d, and with respect to S.
#[inline(always)]
pub(crate) fn mean_with_gradient(d: [f64; 3], s: &Moments) -> (f64, [f64; 3], Moments) {
    let [x, y, z] = d;
    let by_squared = 1.0 / (x * x + y * y + z * z);
    let by_r = by_squared.sqrt();
    let sd = [s[0] * x + s[3] * y + s[5] * z, s[3] * x + s[1] * y + s[4] * z, s[5] * x + s[4] * y + s[2] * z];
    let quadratic = sd[0] * x + sd[1] * y + sd[2] * z;
    let trace = s[0] + s[1] + s[2];
    let cubed = by_r * by_squared;
    let value = by_r + 0.5 * cubed * (3.0 * quadratic * by_squared - trace);
    // d(1/R) = -d/R^3; d(3 q / (2 R^5)) = 3 S d / R^5 - 15 q d / (2 R^7); d(-tr / (2 R^3)) = 3 tr d / (2 R^5).
    let fifth = cubed * by_squared;
    let along = -cubed - 7.5 * quadratic * fifth * by_squared + 1.5 * trace * fifth;
    let by_d =
        [along * x + 3.0 * fifth * sd[0], along * y + 3.0 * fifth * sd[1], along * z + 3.0 * fifth * sd[2]];
    let (diagonal, mixed) = (1.5 * fifth, 3.0 * fifth);
    let by_s = [
        diagonal * x * x - 0.5 * cubed,
        diagonal * y * y - 0.5 * cubed,
        diagonal * z * z - 0.5 * cubed,
        mixed * x * y,
        mixed * y * z,
        mixed * z * x,
    ];
    (value, by_d, by_s)
}

/// How much two figures count as far, and its gradient with respect to d. `reach` is the sum of their radii.
pub(crate) fn share(d: &Vector3, reach: f64) -> (f64, Vector3) {
    let distance = d.norm();
    let t = (distance / reach - FAR[0]) / (FAR[1] - FAR[0]);
    if t <= 0.0 {
        return (0.0, Vector3::zeros());
    }
    if t >= 1.0 {
        return (1.0, Vector3::zeros());
    }
    let slope = 30.0 * t * t * (1.0 - t) * (1.0 - t) / ((FAR[1] - FAR[0]) * reach * distance);
    (smooth_step(t), slope * d)
}

/// The squared distance over the squared reach from which on figures are far.
pub(crate) const FAR_SQUARED: f64 = FAR[1] * FAR[1];

#[cfg(test)]
mod tests {
    use moldline_testing::Random;

    use super::*;
    use crate::influence::near::Triangle;

    /// The fourth order: the error falls with the fourth power of the distance, relative to the mean.
    #[test]
    fn far_is_what_near_becomes() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.2], [0.3, 0.8, -0.1]].map(Vector3::from);
        let centroid = corners.iter().sum::<Vector3>() / 3.0;
        let mut s = [0.0; 6];
        for corner in &corners {
            let part = moments(&(corner - centroid), 1.0 / 12.0);
            s.iter_mut().zip(part).for_each(|(s, p)| *s += p);
        }
        let triangle = Triangle::new(corners);
        for way in [[0.3, -0.5, 0.8], [1.0, 0.1, 0.0], [-0.2, 0.9, 0.3]].map(|w| Vector3::from(w).normalize())
        {
            let error = [4.0, 8.0].map(|r| {
                let exact = triangle.mean(&(centroid + r * way), None);
                mean((r * way).into(), &s) / exact - 1.0
            });
            assert!(error[0].abs() < 1e-3 && error[1].abs() < 0.2 * error[0].abs(), "{error:?}");
        }
    }

    #[test]
    fn gradients_against_differences() {
        let mut random = Random::new(8);
        for _ in 0..10 {
            let d = random.vector(1.0) + Vector3::new(2.0, 0.0, 0.0);
            let s: Moments = std::array::from_fn(|_| 0.1 * random.signed());
            let (value, by_d, by_s) = mean_with_gradient(d.into(), &s);
            assert!((value - mean(d.into(), &s)).abs() < 1e-15);
            let h = 1e-5;
            for axis in 0..3 {
                let at = |step: f64| {
                    let mut d = d;
                    d[axis] += step;
                    mean(d.into(), &s)
                };
                assert!(((at(h) - at(-h)) / (2.0 * h) - by_d[axis]).abs() < 1e-9);
                let near = |step: f64| {
                    let mut d = d;
                    d[axis] += step;
                    share(&d, 0.7).0
                };
                assert!(((near(h) - near(-h)) / (2.0 * h) - share(&d, 0.7).1[axis]).abs() < 1e-8);
            }
            for k in 0..6 {
                let at = |step: f64| {
                    let mut s = s;
                    s[k] += step;
                    mean(d.into(), &s)
                };
                assert!(((at(h) - at(-h)) / (2.0 * h) - by_s[k]).abs() < 1e-9);
            }
            let x = random.vector(1.0);
            let g = moments_gradient(&s, &x);
            for axis in 0..3 {
                let at = |step: f64| {
                    let mut x = x;
                    x[axis] += step;
                    moments(&x, 1.0).iter().zip(&s).map(|(m, s)| m * s).sum::<f64>()
                };
                assert!(((at(h) - at(-h)) / (2.0 * h) - g[axis]).abs() < 1e-9);
            }
        }
    }
}
