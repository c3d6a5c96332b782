//! The smooth union of signed distances (eq. 8; `docs/derivation.md`, section 3).

use moldline_foundation::Vector3;

/// Components further than this many multiples of `1 / rho` beyond the nearest weigh less than 1e-17.
const SKIP: f64 = 40.0;

/// The smooth minimum `Phi = -1/rho log sum_c exp(-rho phi_c)`.
///
/// It is not larger than the hard minimum. Where `m` components are equally far, `Phi` lies `log(m) / rho` below them:
/// on the seam of two components the zero set of `Phi` stands `log(2) / rho` outside both, which is the fillet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothUnion {
    /// Sharpness, 1/m.
    pub rho: f64,
}

/// The smooth union at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothUnionPoint {
    /// `Phi`, metres.
    pub phi: f64,
    /// `grad Phi = sum_c w_c n_c`.
    pub gradient: Vector3,
}

impl SmoothUnion {
    /// The union whose surface stands `fillet` metres off a right-angled seam.
    ///
    /// In the plane across the seam of two half spaces at right angles, with coordinates `a, b` being the two distances,
    /// the surface is `exp(-rho a) + exp(-rho b) = 1`. On the bisector `a = b = log(2) / rho`, at the distance
    /// `sqrt(2) log(2) / rho` from the seam; that distance is `fillet`.
    pub fn from_fillet(fillet: f64) -> Self {
        Self { rho: std::f64::consts::SQRT_2 * std::f64::consts::LN_2 / fillet }
    }

    /// The fillet length of [`from_fillet`](Self::from_fillet), metres.
    pub fn fillet(&self) -> f64 {
        std::f64::consts::SQRT_2 * std::f64::consts::LN_2 / self.rho
    }

    /// The largest distance between the smooth and the hard union of `components` components, metres: `log(m) / rho`.
    pub fn bias(&self, components: usize) -> f64 {
        (components.max(1) as f64).ln() / self.rho
    }

    /// How much further than the nearest component another one may be and still have a weight, metres.
    pub fn reach(&self) -> f64 {
        SKIP / self.rho
    }

    /// Value and gradient from the components' distances and their gradients. `weights`, as long as `components`,
    /// receives the `w_c`, exactly zero for those out of reach. Without components `Phi` is infinite.
    pub fn eval(&self, components: &[(f64, Vector3)], weights: &mut [f64]) -> SmoothUnionPoint {
        let minimum = components.iter().fold(f64::INFINITY, |m, c| m.min(c.0));
        let mut sum = 0.0;
        for (w, (phi, _)) in weights.iter_mut().zip(components) {
            let exponent = self.rho * (phi - minimum);
            *w = if exponent > SKIP { 0.0 } else { (-exponent).exp() };
            sum += *w;
        }
        let mut gradient = Vector3::zeros();
        for (w, (_, n)) in weights.iter_mut().zip(components) {
            *w /= sum;
            gradient += n * *w;
        }
        SmoothUnionPoint { phi: minimum - sum.ln() / self.rho, gradient }
    }

    /// `(dPhi, dg)` for changes `(dphi_c, dn_c)` of the components' distances and gradients, at a point with the given
    /// `weights` and `gradients`: `dPhi = sum_c w_c dphi_c`, `dg = sum_c (w_c dn_c - rho w_c (dphi_c - dPhi) n_c)`.
    pub fn jvp(
        &self,
        weights: &[f64],
        gradients: impl Iterator<Item = Vector3>,
        changes: &[(f64, Vector3)],
    ) -> (f64, Vector3) {
        let d_phi: f64 = weights.iter().zip(changes).map(|(w, c)| w * c.0).sum();
        let mut d_gradient = Vector3::zeros();
        for ((w, n), (phi, d_n)) in weights.iter().zip(gradients).zip(changes) {
            d_gradient += d_n * *w - n * (self.rho * w * (phi - d_phi));
        }
        (d_phi, d_gradient)
    }

    /// The transpose of [`jvp`](Self::jvp): seeds of the component with the given weight and gradient, for seeds of
    /// `Phi` and `g`. `total` is the gradient `g` of the union.
    pub fn vjp(
        &self,
        weight: f64,
        gradient: &Vector3,
        total: &Vector3,
        phi: f64,
        g: &Vector3,
    ) -> (f64, Vector3) {
        // sum_k w_k n_k . g = total . g
        (weight * (phi + self.rho * (total - gradient).dot(g)), g * weight)
    }
}
