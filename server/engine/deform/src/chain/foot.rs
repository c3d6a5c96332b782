//! Foot points: a vertex is put onto its component at the point nearest to where it is aimed at. Placement and smoothing both
//! end with this; its derivative is [`SignedDistance`]'s.

use moldline_geometry::{
    Block, Body, Feature, FootChange, FootPoint, Location, SignedDistance, SignedDistanceDerivative,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;

use crate::{
    DeformError,
    error::{LISTED, VertexDistance},
    ownership::{Freedom, Ownership},
};

/// A vertex on its component.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Placed {
    pub position: Vector3,
    pub location: Location,
    /// The point whose foot point it is, where it was projected.
    pub aim: Vector3,
}

/// A foot point: of which point, and where. Its derivative is evaluated again for each product.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Foot {
    pub aim: Vector3,
    pub location: Location,
}

impl Placed {
    pub fn at(position: Vector3, location: Location) -> Self {
        Self { position, location, aim: position }
    }

    pub fn foot(&self) -> Foot {
        Foot { aim: self.aim, location: self.location }
    }
}

/// The foot point of `x` on the part of a component that its vertex may move over: the sheet of `hint`, or its sharp edge.
/// On failure, the distance of `x` from the component.
pub(crate) fn eval(body: &Body, freedom: Freedom, hint: &Location, x: &Vector3) -> Result<FootPoint, f64> {
    let foot = match freedom {
        Freedom::Edge(edge) => Some(body.closest_point_on_edge(x, edge, hint)),
        _ => body.closest_point_near(x, hint),
    };
    match foot {
        Some(foot) if foot.position.iter().all(|p| p.is_finite()) => Ok(foot),
        _ => {
            // The global search, if it comes out on the same side.
            let foot = body.closest_point(x);
            let same_side = foot.normal.dot(&body.normal(hint)) > 0.0;
            let usable = same_side && foot.feature == Feature::Face;
            if usable { Ok(foot) } else { Err(foot.distance.abs()) }
        }
    }
}

/// The vertices, if all of them have a place.
pub(crate) fn all_found(
    results: Vec<Result<Placed, f64>>,
    ownership: &Ownership,
    bodies: &[Body],
) -> Result<Vec<Placed>, DeformError> {
    let lost: Vec<VertexDistance> = (0u32..)
        .zip(&results)
        .filter_map(|(vertex, r)| r.as_ref().err().map(|&distance| VertexDistance { vertex, distance }))
        .collect();
    match lost.first() {
        None => Ok(results.into_iter().flatten().collect()),
        Some(first) => {
            let component = ownership.first(first.vertex).component as usize;
            Err(DeformError::FootPoint {
                component: bodies[component].component().name().to_owned(),
                count: lost.len(),
                worst: lost.iter().take(LISTED).copied().collect(),
            })
        }
    }
}

impl Foot {
    /// How the location follows the aim: `d(u, v) / dx`, rows for `u` and `v`.
    pub fn parameters_by_aim(&self, body: &Body) -> [Vector3; 2] {
        self.derivative(body).parameters_by_point()
    }

    /// The tangent of the foot point for that of its aim.
    pub fn jvp(&self, body: &Body, aim: &[f64], control_points: &Block, row: &mut [f64]) {
        let derivative = self.derivative(body);
        let mut surface = Block::zeros(3, row.len());
        body.basis(&self.location).point_jvp(control_points, &mut surface);
        for d in 0..row.len() / 3 {
            let change = FootChange {
                x: vector(aim, d),
                s: surface.vector(0, d),
                s_uv: [surface.vector(1, d), surface.vector(2, d)],
            };
            row[3 * d..3 * d + 3].copy_from_slice(derivative.foot_jvp(&change).as_slice());
        }
    }

    /// The transpose of [`jvp`](Self::jvp): the seed of the foot point becomes that of its aim.
    pub fn vjp(&self, body: &Body, seed: &mut [f64], control_points: &mut Block) {
        let derivative = self.derivative(body);
        let mut surface = Block::zeros(3, seed.len());
        for d in 0..seed.len() / 3 {
            let change = derivative.foot_vjp(&vector(seed, d));
            seed[3 * d..3 * d + 3].copy_from_slice(change.x.as_slice());
            add_vector(surface.row_mut(0), d, &change.s);
            add_vector(surface.row_mut(1), d, &change.s_uv[0]);
            add_vector(surface.row_mut(2), d, &change.s_uv[1]);
        }
        body.basis(&self.location).point_vjp(&surface, control_points);
    }

    fn derivative(&self, body: &Body) -> SignedDistanceDerivative {
        let foot = body.foot_point(&self.aim, &self.location);
        SignedDistance::new(body).derivative(&self.aim, &foot)
    }
}
