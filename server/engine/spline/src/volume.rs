//! Trivariate splines: the free-form deformation map F(xi; B) of eq. 3, its weights, and its inverse.

use crate::{Basis, KnotVector, Vector3};
use nalgebra::Matrix3;

/// Why a point has no coordinates in a volume.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LocateError {
    /// The point is outside the volume.
    #[error("the point is outside the volume, {distance} away from it at coordinates {nearest:?}")]
    Outside {
        /// Parameters of the nearest point found.
        nearest: [f64; 3],
        /// Distance to it, metres.
        distance: f64,
    },
}

/// The tensor product of three bases; lattice points have index `(i n_2 + j) n_3 + k`.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    knots: [KnotVector; 3],
}

/// The functions of a [`Volume`] that do not vanish at a parameter.
#[derive(Debug, Clone, Copy)]
pub struct VolumeWeights {
    /// One basis per direction.
    pub basis: [Basis; 3],
    shape: [usize; 3],
}

impl VolumeWeights {
    /// `(lattice index, weight)` of each function, in increasing order of the index.
    pub fn entries(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.derivative_entries([0, 0, 0])
    }

    /// `(lattice index, derivative)`, with the order of derivation in each direction (0, 1, 2).
    pub fn derivative_entries(&self, order: [usize; 3]) -> impl Iterator<Item = (usize, f64)> + '_ {
        let [b0, b1, b2] = &self.basis;
        let [_, n1, n2] = self.shape;
        (0..b0.count).flat_map(move |i| {
            (0..b1.count).flat_map(move |j| {
                let w = b0.values[order[0]][i] * b1.values[order[1]][j];
                let base = ((b0.first + i) * n1 + b1.first + j) * n2 + b2.first;
                (0..b2.count).map(move |k| (base + k, w * b2.values[order[2]][k]))
            })
        })
    }
}

impl Volume {
    /// The tensor product of three bases.
    pub fn new(knots: [KnotVector; 3]) -> Self {
        Self { knots }
    }

    /// The knot vectors.
    pub fn knots(&self) -> &[KnotVector; 3] {
        &self.knots
    }

    /// Numbers of lattice points per direction.
    pub fn shape(&self) -> [usize; 3] {
        [0, 1, 2].map(|d| self.knots[d].control_point_count())
    }

    /// The non-vanishing functions at `xi` (clamped to the domain), with derivatives up to `derivatives`.
    pub fn weights(&self, xi: [f64; 3], derivatives: usize) -> VolumeWeights {
        let basis = [0, 1, 2].map(|d| self.knots[d].basis(xi[d], derivatives));
        VolumeWeights { basis, shape: self.shape() }
    }

    /// The point `F(xi; lattice)`.
    pub fn position(&self, lattice: &[[f64; 3]], xi: [f64; 3]) -> Vector3 {
        let weights = self.weights(xi, 0);
        weights.entries().fold(Vector3::zeros(), |sum, (i, w)| sum + Vector3::from(lattice[i]) * w)
    }

    /// The point and the Jacobian `dF/dxi`, one column per direction.
    pub fn point(&self, lattice: &[[f64; 3]], xi: [f64; 3]) -> (Vector3, Matrix3<f64>) {
        let weights = self.weights(xi, 1);
        let sum = |order| {
            weights
                .derivative_entries(order)
                .fold(Vector3::zeros(), |sum: Vector3, (i, w)| sum + Vector3::from(lattice[i]) * w)
        };
        let jacobian = Matrix3::from_columns(&[sum([1, 0, 0]), sum([0, 1, 0]), sum([0, 0, 1])]);
        (sum([0, 0, 0]), jacobian)
    }

    /// The inverse map: `xi` with `F(xi) = point`, by damped Newton from the nearest of a grid of samples (two per
    /// interval and direction), to the rounding of numbers of the lattice's size.
    ///
    /// # Errors
    /// [`LocateError::Outside`] if the nearest point of the volume is farther away than 1e-9 of the lattice's size.
    pub fn locate(&self, lattice: &[[f64; 3]], point: &Vector3) -> Result<[f64; 3], LocateError> {
        let mut low = Vector3::repeat(f64::INFINITY);
        let mut high = -low;
        for p in lattice {
            low = low.inf(&Vector3::from(*p));
            high = high.sup(&Vector3::from(*p));
        }
        let size = (high - low).norm();
        let samples = [0, 1, 2].map(|d| {
            let breaks = self.knots[d].breaks();
            let mut s: Vec<f64> = breaks.windows(2).flat_map(|w| [w[0], 0.5 * (w[0] + w[1])]).collect();
            s.push(breaks[breaks.len() - 1]);
            s
        });
        let mut seeds = Vec::with_capacity(samples[0].len() * samples[1].len() * samples[2].len());
        for &a in &samples[0] {
            for &b in &samples[1] {
                for &c in &samples[2] {
                    let xi = [a, b, c];
                    seeds.push(((self.position(lattice, xi) - point).norm(), xi));
                }
            }
        }
        seeds.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best = (f64::INFINITY, [0.0; 3]);
        for &(_, seed) in seeds.iter().take(8) {
            let found = self.newton(lattice, point, seed, size);
            if found.0 < best.0 {
                best = found;
            }
            if best.0 <= 1e-13 * size {
                break;
            }
        }
        let (distance, nearest) = best;
        if distance <= 1e-9 * size { Ok(nearest) } else { Err(LocateError::Outside { nearest, distance }) }
    }

    /// Newton with steps clamped to the domain and halved until the distance decreases.
    fn newton(&self, lattice: &[[f64; 3]], point: &Vector3, seed: [f64; 3], size: f64) -> (f64, [f64; 3]) {
        let domain = [0, 1, 2].map(|d| self.knots[d].domain());
        let mut xi = seed;
        let (mut position, mut jacobian) = self.point(lattice, xi);
        let mut distance = (position - point).norm();
        for _ in 0..60 {
            if distance <= 1e-16 * size {
                break;
            }
            // Directions that would leave the domain are fixed; the others are solved for in the least-squares sense.
            let residual = point - position;
            let full = jacobian.lu().solve(&residual);
            let mut step = full.unwrap_or_else(|| jacobian.transpose() * residual / jacobian.norm_squared());
            for _ in 0..3 {
                let held = [0, 1, 2].map(|d| {
                    (xi[d] <= domain[d].0 && step[d] <= 0.0) || (xi[d] >= domain[d].1 && step[d] >= 0.0)
                });
                if !held.contains(&true) {
                    break;
                }
                let mut j = jacobian;
                for d in 0..3 {
                    if held[d] {
                        j.column_mut(d).fill(0.0);
                    }
                }
                let mut normal = j.transpose() * j;
                for d in 0..3 {
                    if held[d] {
                        normal[(d, d)] = 1.0;
                    }
                }
                match normal.lu().solve(&(j.transpose() * residual)) {
                    Some(s) => step = s,
                    None => break,
                }
            }
            let mut scale = 1.0;
            let mut improved = false;
            for _ in 0..30 {
                let trial = [0, 1, 2].map(|d| (xi[d] + scale * step[d]).clamp(domain[d].0, domain[d].1));
                let (p, j) = self.point(lattice, trial);
                let d = (p - point).norm();
                if d < distance {
                    (xi, position, jacobian, distance) = (trial, p, j, d);
                    improved = true;
                    break;
                }
                scale *= 0.5;
            }
            if !improved {
                break;
            }
        }
        (distance, xi)
    }
}
