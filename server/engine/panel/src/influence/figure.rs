//! Centroid and second moments of elements, with which they act from afar, and of a panel: means over areas.

use moldline_mesh::Vector3;

use super::far::{Moments, moments, moments_gradient};
use crate::surface::{area, area_by_corners, area_jvp};

/// Where an element or a panel is, and how it extends about that.
#[derive(Clone, Copy, Debug)]
pub(super) struct Figure {
    pub centroid: Vector3,
    pub moments: Moments,
}

/// Seeds of the elements' corners, and of what follows from them.
type Corners = [Vector3; 3];

/// Of one element: area, centroid, and second moments about a point.
fn parts(corners: &Corners, about: &Vector3) -> (f64, Vector3, Moments) {
    let centroid = corners.iter().sum::<Vector3>() / 3.0;
    // The mean of x x^T over a triangle: corners with a twelfth each, the centroid with three quarters.
    let mut sum = moments(&(centroid - about), 0.75);
    for corner in corners {
        let part = moments(&(corner - about), 1.0 / 12.0);
        sum.iter_mut().zip(part).for_each(|(s, p)| *s += p);
    }
    (area(corners).norm(), centroid, sum)
}

/// Changes of the moments of `x` when it moves, and seeds: `weight d(x x^T)`.
fn moments_jvp(x: &Vector3, d: &Vector3, weight: f64) -> Moments {
    [
        2.0 * x.x * d.x,
        2.0 * x.y * d.y,
        2.0 * x.z * d.z,
        x.x * d.y + x.y * d.x,
        x.y * d.z + x.z * d.y,
        x.z * d.x + x.x * d.z,
    ]
    .map(|m| weight * m)
}

fn product(a: &Moments, b: &Moments) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

impl Figure {
    /// The figure of elements.
    pub fn new(elements: &[Corners]) -> Self {
        let origin = elements[0][0];
        let (mut size, mut first) = (0.0, Vector3::zeros());
        for corners in elements {
            let (area, centroid, _) = parts(corners, &origin);
            size += area;
            first += area * (centroid - origin);
        }
        let centroid = origin + first / size;
        let mut sum = [0.0; 6];
        for corners in elements {
            let (area, _, part) = parts(corners, &centroid);
            sum.iter_mut().zip(part).for_each(|(s, p)| *s += area / size * p);
        }
        Self { centroid, moments: sum }
    }

    /// The change of the figure with the corners.
    pub fn jvp(&self, elements: &[Corners], change: &[Corners]) -> Self {
        let (mut size, mut d_first, mut d_moments) = (0.0, Vector3::zeros(), [0.0; 6]);
        for (corners, d) in elements.iter().zip(change) {
            let (area_, centroid, part) = parts(corners, &self.centroid);
            let d_area = area(corners).dot(&area_jvp(corners, d)) / area_;
            let d_centroid = d.iter().sum::<Vector3>() / 3.0;
            size += area_;
            d_first += area_ * d_centroid + d_area * (centroid - self.centroid);
            // The point about which they are taken moves as well, but the first moments about it vanish.
            let mut d_part = moments_jvp(&(centroid - self.centroid), &d_centroid, 0.75);
            for (corner, d) in corners.iter().zip(d) {
                let of_corner = moments_jvp(&(corner - self.centroid), d, 1.0 / 12.0);
                d_part.iter_mut().zip(of_corner).for_each(|(s, p)| *s += p);
            }
            for k in 0..6 {
                d_moments[k] += area_ * d_part[k] + d_area * (part[k] - self.moments[k]);
            }
        }
        Self { centroid: d_first / size, moments: d_moments.map(|m| m / size) }
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the elements' corners.
    pub fn vjp(&self, elements: &[Corners], seeds: &Self, of_corners: &mut [Corners]) {
        let size: f64 = elements.iter().map(|corners| area(corners).norm()).sum();
        for (corners, out) in elements.iter().zip(of_corners) {
            let (area_, centroid, part) = parts(corners, &self.centroid);
            let share = area_ / size;
            let of_centroid = share
                * (seeds.centroid + 0.75 * moments_gradient(&seeds.moments, &(centroid - self.centroid)));
            let of_area = (seeds.centroid.dot(&(centroid - self.centroid)) + product(&seeds.moments, &part)
                - product(&seeds.moments, &self.moments))
                / size;
            let by_area = area_by_corners(&(of_area / area_ * area(corners)), corners);
            for k in 0..3 {
                let of_corner = moments_gradient(&seeds.moments, &(corners[k] - self.centroid));
                out[k] += of_centroid / 3.0 + share / 12.0 * of_corner + by_area[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use moldline_testing::Random;

    use super::*;

    fn numbers(figure: &Figure) -> Vec<f64> {
        figure.centroid.iter().chain(&figure.moments).copied().collect()
    }

    /// A rectangle in four parts: its middle, and a twelfth of the squares of its sides.
    #[test]
    fn rectangle() {
        let [a, b, c, d] =
            [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 5.0, 0.0], [1.0, 5.0, 0.0]].map(Vector3::from);
        let m = Vector3::new(2.0, 2.5, 0.0);
        let figure = Figure::new(&[[a, b, m], [b, c, m], [c, d, m], [d, a, m]]);
        assert!((figure.centroid - m).norm() < 1e-15);
        let exact = [4.0 / 12.0, 25.0 / 12.0, 0.0, 0.0, 0.0, 0.0];
        assert!(figure.moments.iter().zip(exact).all(|(f, e)| (f - e).abs() < 1e-14), "{figure:?}");
    }

    #[test]
    fn derivative_against_differences_and_transpose() {
        let mut random = Random::new(4);
        let mut corners = || -> Corners { std::array::from_fn(|_| random.vector(1.0)) };
        let elements: Vec<Corners> = (0..4).map(|_| corners()).collect();
        let change: Vec<Corners> = (0..4).map(|_| corners()).collect();
        let figure = Figure::new(&elements);
        let tangent = numbers(&figure.jvp(&elements, &change));
        let at = |step: f64| {
            let moved: Vec<Corners> = elements
                .iter()
                .zip(&change)
                .map(|(x, d)| std::array::from_fn(|k| x[k] + step * d[k]))
                .collect();
            numbers(&Figure::new(&moved))
        };
        let h = 1e-3;
        let [a, b, c, d] = [-2.0 * h, -h, h, 2.0 * h].map(at);
        for k in 0..9 {
            let difference = (8.0 * (c[k] - b[k]) - (d[k] - a[k])) / (12.0 * h);
            assert!((tangent[k] - difference).abs() < 1e-9, "{k}: {} {difference}", tangent[k]);
        }
        let seed = Figure { centroid: random.vector(1.0), moments: std::array::from_fn(|_| random.signed()) };
        let mut gradient = vec![[Vector3::zeros(); 3]; 4];
        figure.vjp(&elements, &seed, &mut gradient);
        let left: f64 = numbers(&seed).iter().zip(&tangent).map(|(a, b)| a * b).sum();
        let right: f64 = gradient.iter().flatten().zip(change.iter().flatten()).map(|(g, d)| g.dot(d)).sum();
        assert!((left - right).abs() < 1e-13 * left.abs().max(1.0), "{left} {right}");
    }
}
