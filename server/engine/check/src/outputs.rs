//! Scalar outputs in dual numbers, from their formulas: volumes as sums of determinants, areas as lengths, integrals over
//! patches.
//!
//! Derivatives of sums may cancel: the volume of a component that moves as a whole has the derivative zero, of which rounding
//! remains. So each output is evaluated with a second number, which tells such a remainder from an error ([`Sum::terms`]).

use std::ops::{Add, Div, Mul, Sub};

use moldline_deform::{
    Setup,
    chain::outputs::{Item, quadrature},
};

use crate::{
    body::{At, DualBody},
    dual::{Dual, LANES, Vector, constant, constants, length, tangent},
};

/// A derivative along each direction, or the length of one.
type Lanes = nalgebra::SVector<f64, LANES>;

/// Least motion of a point, as a fraction of the largest motion: the rounding of a point that does not move, some 1e-16 of the
/// largest motion, is then no error.
const LEAST: f64 = 1e-2;

/// A number computed from coordinates of points.
#[derive(Clone, Copy)]
pub struct Sum {
    /// Its value.
    pub value: Dual,
    /// `sum |d value / d x| |dx|` over the points x that it is computed from, for each direction: its derivative if nothing
    /// cancelled.
    pub terms: Lanes,
}

/// All scalar outputs of a deformed mesh, in the order of the set-up's.
pub fn functions(setup: &Setup, vertices: &[Vector], bodies: &[DualBody<'_>]) -> Vec<Sum> {
    let outputs = setup.outputs();
    let motion = Motion::of(vertices);
    let origin = constants(&outputs.origin());
    let position =
        |at: &moldline_deform::chain::outputs::At| bodies[at.component].position(&At::fixed(&at.location));
    let mut values = Vec::with_capacity(outputs.functions().len());
    for item in outputs.items() {
        match item {
            Item::EnclosedVolume => {
                let seen = |v: u32| vertices[v as usize] - origin;
                let cone = |a, b, c| motion.determinant(&[seen(a), seen(b), seen(c)]) * (1.0 / 6.0);
                let cells = setup.mesh().cells.iter().map(|cell| match *cell.vertices() {
                    [a, b, c] => cone(a, b, c),
                    [a, b, c, d] => (cone(a, b, c) + cone(a, c, d) + cone(b, c, d) + cone(b, d, a)) * 0.5,
                    _ => Sum::zero(),
                });
                values.push(sum(cells));
            }
            Item::WettedArea { component } => {
                let at = |v: u32| vertices[v as usize];
                let owned = setup.mesh().cells.iter().zip(setup.cell_owner());
                let cells =
                    owned.filter(|(_, owner)| *owner == component).map(|(cell, _)| match *cell.vertices() {
                        [a, b, c] => motion.area([at(a), at(b)], [at(a), at(c)]),
                        [a, b, c, d] => motion.area([at(a), at(c)], [at(b), at(d)]),
                        _ => Sum::zero(),
                    });
                values.push(sum(cells));
            }
            Item::Volume { component } => {
                let body = &bodies[*component];
                let mut volume = Sum::zero();
                quadrature(body.body, |weight, location| {
                    let (x, [d_u, d_v]) = body.point(&At::fixed(location));
                    volume = volume + motion.determinant(&[x - origin, d_u, d_v]) * (weight / 3.0);
                });
                values.push(volume);
            }
            Item::Point(points) => {
                for axis in 0..3 {
                    values
                        .push(sum(points.iter().map(|(at, w)| motion.coordinate(&position(at), axis) * *w)));
                }
            }
            Item::Planform(stations) => {
                let stations: Vec<[Sum; 2]> = stations
                    .iter()
                    .map(|station| {
                        let [leading, trailing] = station.each_ref().map(&position);
                        let along = |axis| [&leading, &trailing].map(|x| motion.coordinate(x, axis));
                        let ([x_0, x_1], [y_0, y_1]) = (along(0), along(1));
                        [x_1 - x_0, (y_0 + y_1) * 0.5]
                    })
                    .collect();
                let way = stations[stations.len() - 1][1] - stations[0][1];
                let sign = if way.value.re < 0.0 { -1.0 } else { 1.0 };
                let over = |of: fn(Sum, Sum) -> Sum| {
                    let strips = stations.windows(2);
                    sum(strips.map(|s| (s[1][1] - s[0][1]) * of(s[0][0], s[1][0]) * sign))
                };
                let area = over(|c, d| (c + d) * 0.5);
                let squares = over(|c, d| (c * c + c * d + d * d) * (1.0 / 3.0));
                values.extend([area, way * sign, squares / area]);
            }
        }
    }
    values
}

impl Sum {
    fn zero() -> Self {
        Self { value: constant(0.0), terms: Lanes::zeros() }
    }
}

impl Add for Sum {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { value: self.value + other.value, terms: self.terms + other.terms }
    }
}

impl Sub for Sum {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self { value: self.value - other.value, terms: self.terms + other.terms }
    }
}

impl Mul for Sum {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let terms = self.terms * other.value.re.abs() + other.terms * self.value.re.abs();
        Self { value: self.value * other.value, terms }
    }
}

impl Mul<f64> for Sum {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self { value: self.value * factor, terms: self.terms * factor.abs() }
    }
}

impl Div for Sum {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        Self { value, terms: (self.terms + other.terms * value.re.abs()) / other.value.re.abs() }
    }
}

fn sum(terms: impl Iterator<Item = Sum>) -> Sum {
    terms.fold(Sum::zero(), Add::add)
}

/// How far points move.
struct Motion {
    /// The least motion of a point.
    least: Lanes,
}

impl Motion {
    fn of(vertices: &[Vector]) -> Self {
        let largest = vertices.iter().map(way).fold(Lanes::zeros(), |a, b| a.sup(&b));
        Self { least: largest * LEAST }
    }

    fn moved(&self, x: &Vector) -> Lanes {
        way(x).sup(&self.least)
    }

    /// The motion of a point by its length, since its coordinates change into each other under rotation.
    fn coordinate(&self, x: &Vector, axis: usize) -> Sum {
        Sum { value: x[axis], terms: self.moved(x) }
    }

    /// `a . (b x c)`.
    fn determinant(&self, [a, b, c]: &[Vector; 3]) -> Sum {
        let by = [b.cross(c), c.cross(a), a.cross(b)];
        let terms = [a, b, c].into_iter().zip(&by).map(|(x, by)| self.moved(x) * size(by)).sum();
        Sum { value: a.dot(&by[0]), terms }
    }

    /// Half the length of the cross product of the vectors between two pairs of points.
    fn area(&self, first: [Vector; 2], second: [Vector; 2]) -> Sum {
        let [e, f] = [&first, &second].map(|[p, q]| q - p);
        let [by_e, by_f] = [&first, &second].map(|[p, q]| self.moved(p) + self.moved(q));
        let twice = e.cross(&f);
        if twice.iter().all(|x| x.re == 0.0) {
            return Sum::zero();
        }
        Sum { value: length(&twice) * 0.5, terms: (by_e * size(&f) + by_f * size(&e)) * 0.5 }
    }
}

/// The derivatives of a point along each direction.
fn way(x: &Vector) -> Lanes {
    Lanes::from_fn(|k, _| tangent(x, k).norm())
}

fn size(x: &Vector) -> f64 {
    x.map(|x| x.re).norm()
}
