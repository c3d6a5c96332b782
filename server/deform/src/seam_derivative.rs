//! Derivative of the seam search by the implicit function theorem (section 3 of the derivation notes): at a root the path of
//! the iteration does not matter.
//!
//! With `dmu = m dlambda + M dstart` along the line and `g = Phi_T(S_r(mu))`,
//!
//! ```text
//! 0 = sum_t w_t n_t . (dS_r + J dmu - dS_t)
//! ```
//!
//! gives the parameters on the reference component, and the foot point's derivative those on the other owners. Without the
//! polish `lambda` is what soft bisection makes of the values of `g` it looked at; its derivative goes back through them.

use moldline_geometry::{
    Block, Body, Location, SignedDistance,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    chart::product,
    seam::{SeamPoint, SeamSearch, SeamSolver, Targets, along_derivative},
};

/// Tangents of all seam vertices, or seeds of them.
#[derive(Clone, Debug)]
pub struct SeamChange {
    /// Of the positions: a row of vectors for each seam vertex.
    pub positions: Block,
    /// Of the parameters `(u, v)` on each owner: a row of pairs for each attachment, vertex after vertex.
    pub parameters: Block,
}

/// All seam vertices of one state, ready for products.
#[derive(Clone, Debug)]
pub struct SeamDerivative {
    vertices: Vec<VertexDerivative>,
    /// First row of each vertex among the parameters.
    offsets: Vec<usize>,
    /// Junctions, then the lines that may depend on them.
    order: [Vec<usize>; 2],
}

#[derive(Clone, Debug)]
struct VertexDerivative {
    reference: usize,
    at: Location,
    /// `S_u`, `S_v` of the reference component there.
    j: [Vector3; 2],
    targets: Vec<Target>,
    carried: Vec<Carried>,
    owners: Vec<Owner>,
}

/// `dmu += gain * normal . (dS_t - dS_r)`: `S_t` where the target was met, `S_r` where it was looked at from.
#[derive(Clone, Debug)]
struct Target {
    component: usize,
    at: Location,
    from: Location,
    normal: Vector3,
    gain: [f64; 2],
}

/// `dmu += by * dmu_junction`.
#[derive(Clone, Debug)]
struct Carried {
    /// Row among the parameters.
    row: usize,
    by: [[f64; 2]; 2],
}

#[derive(Clone, Debug)]
struct Owner {
    component: usize,
    at: Location,
    /// How the parameters follow the point; `None` for the reference component itself.
    by_point: Option<[Vector3; 2]>,
}

impl SeamSolver {
    /// The derivative at seam points found in the state of `bodies`.
    pub fn linearise(&self, points: &[SeamPoint], reference: &[Body], bodies: &[Body]) -> SeamDerivative {
        let mut offsets = vec![0];
        for vertex in &self.vertices {
            offsets.push(offsets[offsets.len() - 1] + vertex.owners.len());
        }
        let vertices = (0..points.len())
            .into_par_iter()
            .map(|i| self.linearise_vertex(i, points, &offsets, reference, bodies))
            .collect();
        let is_line = |i: &usize| matches!(self.vertices[*i].search, SeamSearch::Line(_));
        let (lines, junctions) = (0..points.len()).partition(is_line);
        SeamDerivative { vertices, offsets, order: [junctions, lines] }
    }

    fn linearise_vertex(
        &self,
        i: usize,
        points: &[SeamPoint],
        offsets: &[usize],
        reference: &[Body],
        bodies: &[Body],
    ) -> VertexDerivative {
        let (vertex, point) = (&self.vertices[i], &points[i]);
        let x = point.position;
        let component = vertex.search.reference() as usize;
        let of_owner = vertex.owners.iter().position(|&o| o as usize == component);
        // The search keeps to a component that the vertex lies on.
        let at = of_owner.map_or(vertex.locations[0], |k| point.locations[k]);
        let jet = bodies[component].point(&at);
        let j = [jet.d_u, jet.d_v];
        let mut targets = Vec::new();
        let mut carried = Vec::new();
        match &vertex.search {
            SeamSearch::Line(line) => {
                let undeformed = &reference[component];
                let shift = self.carried(line, undeformed, |k| Some(&points[k as usize]));
                let shifted = along_derivative(undeformed, &line.start, shift);
                // The location at lambda, `m`, and `M`: its derivatives by lambda and by the shift.
                let walk = |lambda: f64| {
                    let walk = along_derivative(undeformed, &shifted.end, line.direction.map(|d| d * lambda));
                    let m =
                        walk.by_lengths.map(|row| row[0] * line.direction[0] + row[1] * line.direction[1]);
                    (walk.end, m, product(&walk.by_start, &shifted.by_lengths))
                };
                // `g` at lambda: targets, and its derivatives by the parameters and by lambda.
                let look = |lambda: f64| {
                    let (from, m, by_shift) = walk(lambda);
                    let at = bodies[component].point(&from);
                    let found = self.targets(line, &at.position, bodies);
                    let slopes = [at.d_u, at.d_v].map(|j| j.dot(&found.union.gradient));
                    (from, by_shift, found, slopes, slopes[0] * m[0] + slopes[1] * m[1])
                };
                let (_, m, mut by_shift) = walk(point.lambda);
                let sensitivities = if self.options.polish {
                    vec![(point.lambda, -1.0 / look(point.lambda).4)]
                } else {
                    self.soft_sensitivities(line, &shifted.end, undeformed, bodies, |lambda| look(lambda).4)
                };
                for (lambda, by_g) in sensitivities {
                    let (from, shift_there, Targets { weights, feet, .. }, slopes, _) = look(lambda);
                    for ((&t, foot), weight) in line.targets.iter().zip(&feet).zip(&weights) {
                        targets.push(Target {
                            component: t as usize,
                            at: foot.location,
                            from,
                            normal: foot.normal,
                            gain: m.map(|m| -by_g * weight * m),
                        });
                    }
                    for row in 0..2 {
                        for column in 0..2 {
                            let along =
                                slopes[0] * shift_there[0][column] + slopes[1] * shift_there[1][column];
                            by_shift[row][column] += m[row] * by_g * along;
                        }
                    }
                }
                for &(junction, weight) in &line.carried {
                    if let Some(k) = self.carrier(line, junction, &points[junction as usize]) {
                        let row = offsets[junction as usize] + k;
                        carried.push(Carried { row, by: by_shift.map(|r| r.map(|x| weight * x)) });
                    }
                }
            }
            SeamSearch::Junction(junction) => {
                let feet = junction.targets.map(|t| bodies[t as usize].closest_point(&x));
                let n = [0, 1].map(|r| j.map(|j| j.dot(&feet[r].normal)));
                let determinant = n[0][0] * n[1][1] - n[0][1] * n[1][0];
                let gains = [[n[1][1], -n[1][0]], [-n[0][1], n[0][0]]];
                for (k, foot) in feet.iter().enumerate() {
                    targets.push(Target {
                        component: junction.targets[k] as usize,
                        at: foot.location,
                        from: at,
                        normal: foot.normal,
                        gain: gains[k].map(|g| g / determinant),
                    });
                }
            }
        }
        let owners = vertex
            .owners
            .iter()
            .zip(&point.locations)
            .map(|(&owner, at)| {
                let body = &bodies[owner as usize];
                let by_point = (owner as usize != component).then(|| {
                    let foot = body.foot_point(&x, at);
                    SignedDistance::new(body).derivative(&x, &foot).parameters_by_point()
                });
                Owner { component: owner as usize, at: *at, by_point }
            })
            .collect();
        VertexDerivative { reference: component, at, j, targets, carried, owners }
    }
}

impl SeamDerivative {
    /// Tangents of the seam vertices for tangents of the internal control points, a block a component.
    pub fn jvp(&self, bodies: &[Body], control_points: &[Block]) -> SeamChange {
        let k = control_points.first().map_or(0, Block::directions);
        let mut out = self.zeros(k);
        for group in &self.order {
            let rows: Vec<(Vec<f64>, Vec<f64>)> = group
                .par_iter()
                .map(|&i| self.vertices[i].jvp(bodies, control_points, &out.parameters))
                .collect();
            for (&i, (position, parameters)) in group.iter().zip(rows) {
                out.positions.row_mut(i).copy_from_slice(&position);
                for (row, values) in (self.offsets[i]..).zip(parameters.chunks_exact(2 * k)) {
                    out.parameters.row_mut(row).copy_from_slice(values);
                }
            }
        }
        out
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the internal control points. `seeds` are used up.
    pub fn vjp(&self, bodies: &[Body], seeds: &mut SeamChange, control_points: &mut [Block]) {
        for group in self.order.iter().rev() {
            for &i in group {
                self.vertices[i].vjp(
                    bodies,
                    seeds.positions.row(i),
                    self.offsets[i],
                    &mut seeds.parameters,
                    control_points,
                );
            }
        }
    }

    /// No change in `k` directions.
    pub fn zeros(&self, k: usize) -> SeamChange {
        let attachments = self.offsets[self.vertices.len()];
        SeamChange {
            positions: Block::zeros(self.vertices.len(), 3 * k),
            parameters: Block::zeros(attachments, 2 * k),
        }
    }

    /// First row of a vertex among the parameters; its owners follow in their order.
    pub fn first_row(&self, vertex: usize) -> usize {
        self.offsets[vertex]
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let of_vertex = |v: &VertexDerivative| {
            size_of::<VertexDerivative>()
                + v.targets.len() * size_of::<Target>()
                + v.carried.len() * size_of::<Carried>()
                + v.owners.len() * size_of::<Owner>()
        };
        self.vertices.iter().map(of_vertex).sum()
    }
}

impl VertexDerivative {
    fn jvp(&self, bodies: &[Body], control_points: &[Block], parameters: &Block) -> (Vec<f64>, Vec<f64>) {
        let width = control_points[self.reference].width();
        let k = width / 3;
        let surface = |component: usize, at: &Location| {
            let mut row = vec![0.0; width];
            bodies[component].basis(at).position_jvp(&control_points[component], &mut row);
            row
        };
        let mut position = surface(self.reference, &self.at);
        let mut mu = vec![0.0; 2 * k];
        for target in &self.targets {
            let (s, from) = (surface(target.component, &target.at), surface(self.reference, &target.from));
            for d in 0..k {
                let gap = target.normal.dot(&(vector(&s, d) - vector(&from, d)));
                (0..2).for_each(|a| mu[2 * d + a] += target.gain[a] * gap);
            }
        }
        for carried in &self.carried {
            let row = parameters.row(carried.row);
            for d in 0..k {
                for a in 0..2 {
                    mu[2 * d + a] += carried.by[a][0] * row[2 * d] + carried.by[a][1] * row[2 * d + 1];
                }
            }
        }
        for d in 0..k {
            add_vector(&mut position, d, &(self.j[0] * mu[2 * d] + self.j[1] * mu[2 * d + 1]));
        }
        let mut all = Vec::with_capacity(2 * k * self.owners.len());
        for owner in &self.owners {
            match &owner.by_point {
                None => all.extend_from_slice(&mu),
                Some(by_point) => {
                    let s = surface(owner.component, &owner.at);
                    for d in 0..k {
                        let step = vector(&position, d) - vector(&s, d);
                        all.extend(by_point.map(|row| row.dot(&step)));
                    }
                }
            }
        }
        (position, all)
    }

    fn vjp(
        &self,
        bodies: &[Body],
        position: &[f64],
        first_row: usize,
        parameters: &mut Block,
        control_points: &mut [Block],
    ) {
        let mut position = position.to_vec();
        let k = position.len() / 3;
        let mut mu = vec![0.0; 2 * k];
        let mut scatter = |component: usize, at: &Location, seed: &[f64]| {
            bodies[component].basis(at).position_vjp(seed, &mut control_points[component]);
        };
        for (row, owner) in (first_row..).zip(&self.owners) {
            let seed = parameters.row(row);
            match &owner.by_point {
                None => mu.iter_mut().zip(seed).for_each(|(mu, seed)| *mu += seed),
                Some(by_point) => {
                    let mut surface = vec![0.0; 3 * k];
                    for d in 0..k {
                        let step = by_point[0] * seed[2 * d] + by_point[1] * seed[2 * d + 1];
                        add_vector(&mut position, d, &step);
                        add_vector(&mut surface, d, &-step);
                    }
                    scatter(owner.component, &owner.at, &surface);
                }
            }
        }
        for d in 0..k {
            let seed = vector(&position, d);
            (0..2).for_each(|a| mu[2 * d + a] += self.j[a].dot(&seed));
        }
        for carried in &self.carried {
            let row = parameters.row_mut(carried.row);
            for d in 0..k {
                for a in 0..2 {
                    row[2 * d + a] += carried.by[0][a] * mu[2 * d] + carried.by[1][a] * mu[2 * d + 1];
                }
            }
        }
        for target in &self.targets {
            let (mut surface, mut from) = (vec![0.0; 3 * k], vec![0.0; 3 * k]);
            for d in 0..k {
                let gap = target.gain[0] * mu[2 * d] + target.gain[1] * mu[2 * d + 1];
                add_vector(&mut surface, d, &(target.normal * gap));
                add_vector(&mut from, d, &(target.normal * -gap));
            }
            scatter(target.component, &target.at, &surface);
            scatter(self.reference, &target.from, &from);
        }
        scatter(self.reference, &self.at, &position);
    }
}
