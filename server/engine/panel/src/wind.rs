//! The wind's direction at an angle of attack and sideslip, and its derivatives.

use moldline_mesh::Vector3;

use crate::{Flow, flow::FlowChange};

/// The wind's direction `w = (cos alpha cos beta, -sin beta, sin alpha cos beta)` along the solved axes, the direction of the lift
/// `(-sin alpha, 0, cos alpha)`, and their derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wind<const B: usize> {
    /// w.
    pub w: [f64; B],
    /// The first and second derivative of w with respect to alpha.
    pub by_alpha: [f64; B],
    pub by_alpha_2: [f64; B],
    /// The derivative of w with respect to sideslip, and to alpha and sideslip.
    pub by_sideslip: [f64; B],
    pub by_both: [f64; B],
    /// Directions of drag (the wind's) and lift.
    pub drag: Vector3,
    pub lift: Vector3,
    /// Their derivatives.
    pub drag_by_alpha: Vector3,
    pub lift_by_alpha: Vector3,
    pub drag_by_sideslip: Vector3,
}

impl<const B: usize> Wind<B> {
    pub fn new(flow: &Flow) -> Self {
        let ((sa, ca), (sb, cb)) = (flow.alpha.sin_cos(), flow.sideslip.sin_cos());
        let pick = |v: Vector3| -> [f64; B] { std::array::from_fn(|k| if B == 2 { v[2 * k] } else { v[k] }) };
        let drag = Vector3::new(ca * cb, -sb, sa * cb);
        let drag_by_alpha = Vector3::new(-sa * cb, 0.0, ca * cb);
        let drag_by_sideslip = Vector3::new(-ca * sb, -cb, -sa * sb);
        Self {
            w: pick(drag),
            by_alpha: pick(drag_by_alpha),
            by_alpha_2: pick(Vector3::new(-ca * cb, 0.0, -sa * cb)),
            by_sideslip: pick(drag_by_sideslip),
            by_both: pick(Vector3::new(sa * sb, 0.0, -ca * sb)),
            drag,
            lift: Vector3::new(-sa, 0.0, ca),
            drag_by_alpha,
            lift_by_alpha: Vector3::new(-ca, 0.0, -sa),
            drag_by_sideslip,
        }
    }

    /// The change of w.
    pub fn jvp(&self, change: &FlowChange) -> [f64; B] {
        std::array::from_fn(|k| self.by_alpha[k] * change.alpha + self.by_sideslip[k] * change.sideslip)
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the angles.
    pub fn vjp(&self, seeds: &[f64; B], change: &mut FlowChange) {
        for k in 0..B {
            change.alpha += seeds[k] * self.by_alpha[k];
            change.sideslip += seeds[k] * self.by_sideslip[k];
        }
    }
}
