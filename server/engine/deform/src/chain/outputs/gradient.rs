//! Gradients of functions of the mesh and its components.

use moldline_geometry::{Block, Body, Location, block::vector};
use moldline_mesh::Cell;
use moldline_spline::Vector3;

/// The mesh that outputs are measured on.
#[derive(Clone, Copy)]
pub struct Measured<'a> {
    /// Its cells.
    pub cells: &'a [Cell],
    /// Component of each cell.
    pub owners: &'a [u32],
    /// Its vertices, m.
    pub vertices: &'a [[f64; 3]],
    /// The components in the same state.
    pub bodies: &'a [Body],
    /// The point that volumes are seen from, m.
    pub origin: Vector3,
}

impl Measured<'_> {
    /// A vertex seen from the origin, m.
    pub(super) fn seen(&self, vertex: u32) -> Vector3 {
        Vector3::from(self.vertices[vertex as usize]) - self.origin
    }

    /// `sum x . gradient` over all vertices, seen from the origin: by Euler's theorem the degree of a homogeneous function
    /// times its value.
    pub(super) fn euler(&self, gradient: &[Vector3]) -> f64 {
        let positions = self.vertices.iter().map(|x| Vector3::from(*x) - self.origin);
        positions.zip(gradient).map(|(x, g)| x.dot(g)).sum()
    }
}

/// A point by its internal parameters.
#[derive(Clone, Debug)]
pub struct At {
    /// Index of the component.
    pub component: usize,
    /// Where on it.
    pub location: Location,
}

/// The gradient of one function.
#[derive(Clone, Debug, Default)]
pub(super) struct FunctionGradient {
    /// With respect to the vertices; empty if it does not depend on them.
    pub vertices: Vec<Vector3>,
    /// With respect to the internal control points of some components.
    pub control_points: Vec<(usize, Block)>,
}

impl FunctionGradient {
    /// The gradient of a function of the vertices.
    pub fn of_vertices(vertices: Vec<Vector3>) -> Self {
        Self { vertices, control_points: Vec::new() }
    }

    /// Adds the gradient of a function of a point of a component; `by` is that with respect to the point.
    pub fn add_point(&mut self, point: &At, by: &Vector3, bodies: &[Body]) {
        let body = &bodies[point.component];
        let slot = self.control_points.iter().position(|(c, _)| *c == point.component).unwrap_or_else(|| {
            self.control_points.push((point.component, Block::zeros(body.control_points().len(), 3)));
            self.control_points.len() - 1
        });
        body.basis(&point.location).position_vjp(by.as_slice(), &mut self.control_points[slot].1);
    }

    /// The tangent of the function in each direction, a number each.
    pub fn jvp(&self, vertices: &Block, control_points: &[Block], row: &mut [f64]) {
        let mut add = |g: &Vector3, tangent: &[f64]| {
            row.iter_mut().enumerate().for_each(|(d, sum)| *sum += g.dot(&vector(tangent, d)));
        };
        for (v, g) in self.vertices.iter().enumerate() {
            add(g, vertices.row(v));
        }
        for (c, by_points) in &self.control_points {
            for i in 0..by_points.data().len() / 3 {
                add(&by_points.vector(i, 0), control_points[*c].row(i));
            }
        }
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the vertices and of the internal control points.
    pub fn vjp(&self, seed: &[f64], vertices: &mut Block, control_points: &mut [Block]) {
        let add = |g: &Vector3, to: &mut [f64]| {
            for (d, s) in seed.iter().enumerate() {
                (0..3).for_each(|axis| to[3 * d + axis] += g[axis] * s);
            }
        };
        for (v, g) in self.vertices.iter().enumerate() {
            add(g, vertices.row_mut(v));
        }
        for (c, by_points) in &self.control_points {
            for i in 0..by_points.data().len() / 3 {
                add(&by_points.vector(i, 0), control_points[*c].row_mut(i));
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let blocks = self.control_points.iter().map(|(_, block)| size_of_val(block.data()));
        size_of_val(&self.vertices[..]) + blocks.sum::<usize>()
    }
}
