//! Seam vertices (sec. III.C of the paper): where they are in a deformed state, and the derivative of that.
//!
//! A vertex on two components is searched along a line of one of them ([`mod@line`]); a vertex where three meet, in both parameters
//! ([`junction`]). The seams that end at a junction are carried along with it.
//!
//! The parameters on the other owners are those of the foot point: `dmu = P (dx - dS)`.

mod junction;
mod line;
pub mod setup;
mod soft_bracket;
mod target;

use moldline_geometry::{
    Block, Body, FootPoint, Location, SignedDistance,
    block::{add_vector, vector},
};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    DeformError, Monitor, SeamOptions, Stage,
    error::{LISTED, VertexDistance},
};
use line::{Feet, LineSearch, Met};
use soft_bracket::SoftStep;
use target::{Target, surface_jvp, surface_vjp};

pub use junction::Junction;
pub use line::SeamLine;

/// How a seam vertex is found.
#[derive(Clone, Debug)]
pub enum SeamSearch {
    /// By one parameter.
    Line(SeamLine),
    /// By two parameters.
    Junction(Junction),
}

/// One vertex on two or more components.
#[derive(Clone, Debug)]
pub struct SeamVertex {
    /// Index into the mesh.
    pub vertex: u32,
    /// The components that it lies on.
    pub owners: Vec<u32>,
    /// Its parameters on each of them in the reference state.
    pub locations: Vec<Location>,
    /// How it is found.
    pub search: SeamSearch,
}

/// A seam vertex found.
#[derive(Clone, Debug, PartialEq)]
pub struct SeamPoint {
    /// Where it is, m.
    pub position: Vector3,
    /// Its parameters on each of its owners, in their order.
    pub locations: Vec<Location>,
    /// Largest distance to an owner, m.
    pub residual: f64,
    /// Where on its line it is; zero for a junction.
    pub lambda: f64,
    /// How it was found.
    trace: Trace,
}

/// How a seam vertex was found, for the derivative.
#[derive(Clone, Debug, PartialEq)]
struct Trace {
    /// How far the start of its line was carried, in parameters.
    shift: [f64; 2],
    /// The foot points on its targets: at a root those there, otherwise those that the soft bracket looked at.
    met: Vec<Met>,
    /// The steps of the soft bracket that decided `lambda`; none at a root.
    steps: Vec<SoftStep>,
    /// The foot points on its owners; on the reference component, the point itself.
    feet: Vec<FootPoint>,
}

/// The search over all seam vertices of a set-up.
#[derive(Clone, Debug)]
pub struct SeamSolver {
    /// The seam vertices.
    pub vertices: Vec<SeamVertex>,
    /// Numbers and tolerances.
    pub options: SeamOptions,
    /// Reference length, m.
    pub length: f64,
}

/// Tangents of all seam vertices, or seeds of them.
#[derive(Clone, Debug)]
pub struct SeamTangents {
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

impl SeamSearch {
    /// The component whose parameters are searched.
    pub fn reference(&self) -> u32 {
        match self {
            Self::Line(line) => line.reference,
            Self::Junction(junction) => junction.reference,
        }
    }
}

impl SeamSolver {
    /// All seam points in the state of `bodies`, in the order of `vertices`. `reference`: the components as set up.
    ///
    /// # Errors
    /// [`DeformError::SeamLost`] naming the vertices whose line does not meet its target.
    pub fn eval(
        &self,
        reference: &[Body],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<SeamPoint>, DeformError> {
        let junctions: Vec<(usize, Result<SeamPoint, f64>)> = self
            .vertices
            .par_iter()
            .enumerate()
            .filter_map(|(i, v)| match &v.search {
                SeamSearch::Junction(_) if monitor.cancelled() => None,
                SeamSearch::Junction(junction) => Some((i, self.junction(v, junction, bodies))),
                SeamSearch::Line(_) => None,
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        let mut found: Vec<Option<Result<SeamPoint, f64>>> = vec![None; self.vertices.len()];
        for (i, point) in junctions {
            found[i] = Some(point);
        }
        let lines: Vec<Option<Result<SeamPoint, f64>>> = self
            .vertices
            .par_iter()
            .map(|v| match &v.search {
                SeamSearch::Line(_) if monitor.cancelled() => None,
                SeamSearch::Line(line) => Some(self.line(v, line, reference, bodies, &found)),
                SeamSearch::Junction(_) => None,
            })
            .collect();
        if monitor.cancelled() {
            return Err(DeformError::Cancelled);
        }
        let mut points = Vec::with_capacity(self.vertices.len());
        let mut lost: Vec<(usize, f64)> = Vec::new();
        for (i, (line, junction)) in lines.into_iter().zip(found).enumerate() {
            // Every vertex has exactly one of the two: its search is a line or a junction.
            match line.or(junction).unwrap_or(Err(f64::NAN)) {
                Ok(point) => points.push(point),
                Err(distance) => lost.push((i, distance)),
            }
        }
        if lost.is_empty() { Ok(points) } else { Err(self.lost(&lost, bodies)) }
    }

    fn lost(&self, lost: &[(usize, f64)], bodies: &[Body]) -> DeformError {
        let name = |c: u32| bodies[c as usize].component().name().to_owned();
        let (reference, target) = match &self.vertices[lost[0].0].search {
            SeamSearch::Line(line) => {
                let targets: Vec<String> = line.targets.iter().map(|&t| name(t)).collect();
                (name(line.reference), targets.join("+"))
            }
            SeamSearch::Junction(j) => {
                (name(j.reference), format!("{} and {}", name(j.targets[0]), name(j.targets[1])))
            }
        };
        DeformError::SeamLost {
            reference,
            target,
            count: lost.len(),
            worst: lost
                .iter()
                .take(LISTED)
                .map(|&(i, distance)| VertexDistance { vertex: self.vertices[i].vertex, distance })
                .collect(),
        }
    }

    fn junction(&self, vertex: &SeamVertex, junction: &Junction, bodies: &[Body]) -> Result<SeamPoint, f64> {
        let point = junction.eval(bodies, self.options.tolerance * self.length)?;
        let met = vec![Met { lambda: 0.0, feet: Feet::Several(point.feet.into()) }];
        let trace = Trace { shift: [0.0; 2], met, steps: Vec::new(), feet: Vec::new() };
        Ok(found(vertex, 0.0, point.at, trace, bodies))
    }

    fn line(
        &self,
        vertex: &SeamVertex,
        line: &SeamLine,
        reference: &[Body],
        bodies: &[Body],
        junctions: &[Option<Result<SeamPoint, f64>>],
    ) -> Result<SeamPoint, f64> {
        let undeformed = &reference[line.reference as usize];
        let mut shift = [0.0; 2];
        for &(index, weight) in &line.carried {
            let Some(Ok(point)) = &junctions[index as usize] else { continue };
            let Some(k) = self.carrier(line, index, point) else { continue };
            let (before, after) = (self.vertices[index as usize].locations[k], point.locations[k]);
            shift[0] += weight * shorter_way(undeformed, after.patch, 0, after.u - before.u);
            shift[1] += weight * shorter_way(undeformed, after.patch, 1, after.v - before.v);
        }
        let point = self.search(line, shift, undeformed, bodies).eval()?;
        let trace = Trace { shift, met: point.met, steps: point.steps, feet: Vec::new() };
        let mut point = found(vertex, point.lambda, point.at, trace, bodies);
        if self.options.polish {
            point.meet_owners(vertex, &line.targets);
        }
        Ok(point)
    }

    fn search<'a>(
        &'a self,
        line: &'a SeamLine,
        shift: [f64; 2],
        reference: &'a Body,
        bodies: &'a [Body],
    ) -> LineSearch<'a> {
        LineSearch { line, shift, options: &self.options, length: self.length, reference, bodies }
    }

    /// Which owner of a junction carries a line: the line's own component, if the junction is still on the same patch.
    fn carrier(&self, line: &SeamLine, junction: u32, point: &SeamPoint) -> Option<usize> {
        let vertex = &self.vertices[junction as usize];
        let k = vertex.owners.iter().position(|&o| o == line.reference)?;
        (vertex.locations[k].patch == point.locations[k].patch).then_some(k)
    }

    /// First row of each vertex among the parameters, where its owners follow in their order; at last, the number of rows.
    pub fn first_rows(&self) -> Vec<usize> {
        let mut rows = vec![0];
        for vertex in &self.vertices {
            rows.push(rows[rows.len() - 1] + vertex.owners.len());
        }
        rows
    }

    /// The derivative at seam points found in the state of `bodies`.
    pub fn linearise(&self, points: &[SeamPoint], reference: &[Body], bodies: &[Body]) -> SeamDerivative {
        let offsets = self.first_rows();
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
        let component = vertex.search.reference() as usize;
        let of_owner = vertex.owners.iter().position(|&o| o as usize == component);
        // The search keeps to a component that the vertex lies on.
        let at = of_owner.map_or(vertex.locations[0], |k| point.locations[k]);
        let jet = bodies[component].point(&at);
        let j = [jet.d_u, jet.d_v];
        let (targets, carried) = match &vertex.search {
            SeamSearch::Junction(junction) => {
                (junction.linearise(at, &j, point.trace.met[0].feet.as_slice()), Vec::new())
            }
            SeamSearch::Line(line) => {
                let search = self.search(line, point.trace.shift, &reference[component], bodies);
                let derivative = search.linearise(point.lambda, &point.trace.met, &point.trace.steps);
                let carried = line.carried.iter().filter_map(|&(junction, weight)| {
                    let k = self.carrier(line, junction, &points[junction as usize])?;
                    let by = derivative.by_shift.map(|row| row.map(|x| weight * x));
                    Some(Carried { row: offsets[junction as usize] + k, by })
                });
                let carried = carried.collect();
                (derivative.targets, carried)
            }
        };
        let owners = vertex
            .owners
            .iter()
            .zip(&point.trace.feet)
            .zip(&point.locations)
            .map(|((&owner, foot), at)| {
                let distance = SignedDistance::new(&bodies[owner as usize]);
                let by_point = (owner as usize != component)
                    .then(|| distance.derivative(&point.position, foot).parameters_by_point());
                Owner { component: owner as usize, at: *at, by_point }
            })
            .collect();
        VertexDerivative { reference: component, at, j, targets, carried, owners }
    }
}

impl SeamDerivative {
    /// Tangents of the seam vertices for tangents of the internal control points, a block a component.
    pub fn jvp(&self, bodies: &[Body], control_points: &[Block]) -> SeamTangents {
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

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the internal control points.
    pub fn vjp(&self, bodies: &[Body], mut seeds: SeamTangents, control_points: &mut [Block]) {
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
    pub fn zeros(&self, k: usize) -> SeamTangents {
        let attachments = self.offsets[self.vertices.len()];
        SeamTangents {
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
        let k = control_points[self.reference].directions();
        let mut position = surface_jvp(bodies, self.reference, &self.at, control_points);
        let mut mu = vec![0.0; 2 * k];
        for target in &self.targets {
            target.jvp(self.reference, bodies, control_points, &mut mu);
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
                    let s = surface_jvp(bodies, owner.component, &owner.at, control_points);
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
                    surface_vjp(bodies, owner.component, &owner.at, &surface, control_points);
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
            target.vjp(self.reference, bodies, &mu, control_points);
        }
        surface_vjp(bodies, self.reference, &self.at, &position, control_points);
    }
}

impl SeamPoint {
    /// At a root the targets are met where its foot points on the owners are, which were searched without a bound.
    fn meet_owners(&mut self, vertex: &SeamVertex, targets: &[u32]) {
        for met in &mut self.trace.met {
            for (foot, target) in met.feet.as_mut_slice().iter_mut().zip(targets) {
                if let Some(k) = vertex.owners.iter().position(|owner| owner == target) {
                    *foot = self.trace.feet[k];
                }
            }
        }
    }
}

/// A point found at `at` on its reference component, with its foot points on every owner.
fn found(vertex: &SeamVertex, lambda: f64, at: Location, trace: Trace, bodies: &[Body]) -> SeamPoint {
    let reference = vertex.search.reference();
    let position = bodies[reference as usize].position(&at);
    let mut residual: f64 = 0.0;
    let mut locations = Vec::with_capacity(vertex.owners.len());
    let mut feet = Vec::with_capacity(vertex.owners.len());
    for &owner in &vertex.owners {
        let body = &bodies[owner as usize];
        if owner == reference {
            locations.push(at);
            feet.push(body.foot_point(&position, &at));
        } else {
            let foot = body.closest_point(&position);
            residual = residual.max(foot.distance.abs());
            locations.push(foot.location);
            feet.push(foot);
        }
    }
    SeamPoint { position, locations, residual, lambda, trace: Trace { feet, ..trace } }
}

/// A difference of one parameter, taken the shorter way around a closed patch: more than half of a range is the long way.
fn shorter_way(body: &Body, patch: u32, parameter: usize, difference: f64) -> f64 {
    let (low, high) = body.component().patches()[patch as usize].surface.domain()[parameter];
    let range = high - low;
    if difference.abs() > 0.5 * range { difference - range.copysign(difference) } else { difference }
}
