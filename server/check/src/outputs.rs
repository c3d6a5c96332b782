//! Scalar outputs in dual numbers, from their formulas: volumes as sums of determinants, areas as lengths, integrals over
//! patches.

use moldline_deform::{
    Setup,
    outputs::{Item, quadrature},
};
use nalgebra::Matrix3;

use crate::{
    body::{At, DualBody},
    dual::{Dual, Vector, constant, constants, length},
};

/// All scalar outputs of a deformed mesh, in the order of the set-up's.
pub fn functions(setup: &Setup, vertices: &[Vector], bodies: &[DualBody<'_>]) -> Vec<Dual> {
    let outputs = setup.outputs();
    let origin = constants(&outputs.origin());
    let position =
        |at: &moldline_deform::outputs::At| bodies[at.component].position(&At::fixed(&at.location));
    let mut values = Vec::with_capacity(outputs.functions().len());
    for item in outputs.items() {
        match item {
            Item::EnclosedVolume => {
                let seen = |v: u32| vertices[v as usize] - origin;
                let cone = |a, b, c| determinant(&[seen(a), seen(b), seen(c)]) / 6.0;
                let cells = setup.mesh().cells.iter().map(|cell| match *cell.vertices() {
                    [a, b, c] => cone(a, b, c),
                    [a, b, c, d] => (cone(a, b, c) + cone(a, c, d) + cone(b, c, d) + cone(b, d, a)) * 0.5,
                    _ => constant(0.0),
                });
                values.push(sum(cells));
            }
            Item::WettedArea { component } => {
                let at = |v: u32| vertices[v as usize];
                let owned = setup.mesh().cells.iter().zip(setup.cell_owner());
                let cells = owned.filter(|(_, owner)| *owner == component).map(|(cell, _)| {
                    let twice = match *cell.vertices() {
                        [a, b, c] => (at(b) - at(a)).cross(&(at(c) - at(a))),
                        [a, b, c, d] => (at(c) - at(a)).cross(&(at(d) - at(b))),
                        _ => Vector::zeros(),
                    };
                    if twice.iter().all(|x| x.re == 0.0) { constant(0.0) } else { length(&twice) * 0.5 }
                });
                values.push(sum(cells));
            }
            Item::Volume { component } => {
                let body = &bodies[*component];
                let mut volume = constant(0.0);
                quadrature(body.body, |weight, location| {
                    let (x, [d_u, d_v]) = body.point(&At::fixed(location));
                    volume += determinant(&[x - origin, d_u, d_v]) * (weight / 3.0);
                });
                values.push(volume);
            }
            Item::Point(points) => {
                let terms = points.iter().map(|(at, weight)| position(at) * constant(*weight));
                let point = terms.fold(Vector::zeros(), |sum, x| sum + x);
                values.extend(point.iter().copied());
            }
            Item::Planform(stations) => {
                let stations: Vec<[Dual; 2]> = stations
                    .iter()
                    .map(|[leading, trailing]| {
                        let (leading, trailing) = (position(leading), position(trailing));
                        [trailing.x - leading.x, (leading.y + trailing.y) * 0.5]
                    })
                    .collect();
                let way = stations[stations.len() - 1][1] - stations[0][1];
                let sign = if way.re < 0.0 { -1.0 } else { 1.0 };
                let over = |of: fn(Dual, Dual) -> Dual| {
                    let strips = stations.windows(2);
                    sum(strips.map(|s| (s[1][1] - s[0][1]) * of(s[0][0], s[1][0]) * sign))
                };
                let area = over(|c, d| (c + d) * 0.5);
                let squares = over(|c, d| (c * c + c * d + d * d) / 3.0);
                values.extend([area, way * sign, squares / area]);
            }
        }
    }
    values
}

fn sum(terms: impl Iterator<Item = Dual>) -> Dual {
    terms.fold(constant(0.0), |sum, x| sum + x)
}

fn determinant(columns: &[Vector; 3]) -> Dual {
    let m = Matrix3::from_columns(columns);
    let minor = |a: usize, b: usize| m[(1, a)] * m[(2, b)] - m[(1, b)] * m[(2, a)];
    m[(0, 0)] * minor(1, 2) - m[(0, 1)] * minor(0, 2) + m[(0, 2)] * minor(0, 1)
}
