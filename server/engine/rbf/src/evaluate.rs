//! Values of interpolants, and the transpose of their evaluation.

use crate::{
    Block, Coefficients, RadialBasis, Vector3, coefficients::Part, points::Points, polynomial::AFFINE,
};

impl RadialBasis {
    /// The fields at `points` (metres), a row for each point. In parallel over tiles of points; each value is summed in one
    /// fixed order.
    pub fn evaluate(&self, coefficients: &Coefficients, points: &[Vector3]) -> Block {
        let Coefficients { leading, remainder } = coefficients;
        let targets = self.scaled(points);
        self.kernel.sum(self.shape_squared, &targets, &self.centres, leading, remainder.as_ref()).leading
    }

    /// The transpose of [`evaluate`](Self::evaluate): seeds of the coefficients for seeds of the values. Points and
    /// centres change their roles.
    pub fn evaluate_vjp(&self, points: &[Vector3], seeds: &Block) -> Coefficients {
        let sources = Points::new(&self.scaled(points));
        let weights = Part::from_rows(Block::zeros(AFFINE, seeds.width()), seeds, sources.padded());
        let centres = self.centres.to_vectors();
        let affine = self.kernel.moments(&sources, &weights, None);
        let rows = self.kernel.sum(self.shape_squared, &centres, &sources, &weights, None);
        Coefficients::from_rows(affine, rows, &self.centres)
    }

    fn scaled(&self, points: &[Vector3]) -> Vec<Vector3> {
        points.iter().map(|p| (p - self.origin) / self.scale).collect()
    }
}
