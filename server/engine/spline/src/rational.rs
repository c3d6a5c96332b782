//! Points and derivatives from homogeneous sums: by the quotient rule, or directly where all weights are 1.

use crate::Vector3;

pub(crate) type Homogeneous = [f64; 4];

#[inline(always)]
pub(crate) fn add_scaled(sum: &mut Homogeneous, factor: f64, point: &Homogeneous) {
    for k in 0..4 {
        sum[k] += factor * point[k];
    }
}

#[inline(always)]
pub(crate) fn xyz(h: &Homogeneous) -> Vector3 {
    Vector3::new(h[0], h[1], h[2])
}

/// Whether any weight differs from 1.
pub(crate) fn any_weight(control_points: &[Homogeneous]) -> bool {
    control_points.iter().any(|c| c[3] != 1.0)
}

/// `S = P / w`.
#[inline(always)]
pub(crate) fn value(p: &Homogeneous) -> Vector3 {
    xyz(p) / p[3]
}

/// `S_a = (P_a - w_a S) / w`.
#[inline(always)]
pub(crate) fn first(p: &Homogeneous, a: &Homogeneous, s: &Vector3) -> Vector3 {
    (xyz(a) - s * a[3]) / p[3]
}

/// `S_ab = (P_ab - w_a S_b - w_b S_a - w_ab S) / w`.
#[inline(always)]
pub(crate) fn second(
    p: &Homogeneous,
    (a, s_a): (&Homogeneous, &Vector3),
    (b, s_b): (&Homogeneous, &Vector3),
    ab: &Homogeneous,
    s: &Vector3,
) -> Vector3 {
    (xyz(ab) - s_b * a[3] - s_a * b[3] - s * ab[3]) / p[3]
}
