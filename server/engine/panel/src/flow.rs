//! The flow at which a solution is analysed.

use crate::{PanelError, bounds::within};

/// The wind's direction and the reference values of coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Angle of attack, rad.
    pub alpha: f64,
    /// Sideslip, rad: positive if the wind comes from starboard (+y).
    pub sideslip: f64,
    /// Reference values of the coefficients.
    pub reference: Reference,
}

/// Reference values of the coefficients: of the whole aircraft, also for a half model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    /// Area, m^2.
    pub area: f64,
    /// Chord of the pitching moment, m.
    pub chord: f64,
    /// Span of rolling and yawing moment, m.
    pub span: f64,
    /// Point about which moments are taken, m.
    pub point: [f64; 3],
}

/// A change of flow and reference values, or the gradient with respect to them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FlowChange {
    pub alpha: f64,
    pub sideslip: f64,
    pub area: f64,
    pub chord: f64,
    pub point: [f64; 3],
}

impl Flow {
    /// Checks that angles are moderate and reference values positive.
    pub(crate) fn check(&self) -> Result<(), PanelError> {
        within("flow.alpha", self.alpha, -1.0, 1.0)?;
        within("flow.sideslip", self.sideslip, -1.0, 1.0)?;
        let positive = f64::MIN_POSITIVE;
        within("flow.reference.area", self.reference.area, positive, 1e24)?;
        within("flow.reference.chord", self.reference.chord, positive, 1e12)?;
        within("flow.reference.span", self.reference.span, positive, 1e12)?;
        for (axis, value) in self.reference.point.into_iter().enumerate() {
            within(&format!("flow.reference.point[{axis}]"), value, -1e12, 1e12)?;
        }
        Ok(())
    }
}
