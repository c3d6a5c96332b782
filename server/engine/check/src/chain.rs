//! The whole chain in dual numbers: design, control points, seams, fields, placement, smoothing, smooth outer mold line.

use moldline_deform::{
    DeformError, Monitor, OuterMoldLine, Propagation, Setup, Stage,
    chain::seams::SeamPoint,
    chart::Chart,
    ownership::{Attachment, Freedom},
};
use moldline_geometry::{Body, Location};
use moldline_mesh::{Laplacian, Topology};
use rayon::prelude::*;

use crate::{
    CheckError,
    body::{At, DualBody, Foot},
    chart,
    dual::{Dual, LANES, Real, Vector, constant, constants, eps, number, real, tangent},
    field::{System, data},
    outputs::{self, Sum},
    seam::{DualSeam, DualSeams, union},
};

/// The paper's eps in a step of the projection.
const EPSILON: f64 = 1e-12;

/// The result of each step of the chain: values, or derivatives along one direction.
#[derive(Clone, Debug, Default)]
pub struct Stages {
    /// The user's control points of each component, Cartesian, m.
    pub control_points: Vec<Vec<[f64; 3]>>,
    /// Position of each seam vertex, in the order of the search, m.
    pub seam_positions: Vec<Real>,
    /// Its parameters on each of its owners.
    pub seam_parameters: Vec<Vec<[f64; 2]>>,
    /// For each field, the motion of each seam vertex in the field's terms.
    pub motions: Vec<Vec<Real>>,
    /// For each vertex of the mesh, the field's value.
    pub displacements: Vec<Real>,
    /// For each vertex, its position on its component, smoothing included, m.
    pub placed: Vec<Real>,
    /// The deformed mesh, m.
    pub vertices: Vec<Real>,
    /// The scalar outputs, each in its unit.
    pub functions: Vec<f64>,
}

/// Values and derivatives along a number of directions.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Values.
    pub values: Stages,
    /// Derivatives, one entry for each direction.
    pub tangents: Vec<Stages>,
    /// For each direction, the derivatives of the scalar outputs as they would be if nothing in them cancelled: sums over
    /// points of the products of the lengths of gradient and motion.
    pub terms: Vec<Vec<f64>>,
}

/// A set-up, ready to be evaluated in dual numbers.
pub struct Chain<'a> {
    setup: &'a Setup,
    systems: Vec<System>,
    topology: Topology,
}

/// Results before they are split into directions.
struct DualStages {
    control_points: Vec<Vec<[Dual; 3]>>,
    seams: Vec<DualSeam>,
    motions: Vec<Vec<Vector>>,
    displacements: Vec<Vector>,
    placed: Vec<Vector>,
    vertices: Vec<Vector>,
    functions: Vec<Sum>,
}

#[derive(Clone, Copy)]
struct Placed {
    position: Vector,
    at: At,
}

impl From<Foot> for Placed {
    fn from(foot: Foot) -> Self {
        Self { position: foot.position, at: foot.at }
    }
}

impl<'a> Chain<'a> {
    /// Prepares a set-up: its radial basis systems are decomposed anew.
    pub fn new(setup: &'a Setup) -> Self {
        let system = |region: &moldline_deform::RegionField| {
            System::new(&region.field, setup.positions(), setup.options())
        };
        Self {
            setup,
            systems: setup.fields().iter().map(system).collect(),
            topology: Topology::new(setup.mesh()),
        }
    }

    /// Values and derivatives along `directions` in the space of the design variables.
    ///
    /// # Errors
    /// As [`Setup::deform`]; [`CheckError::Line`].
    pub fn eval(
        &self,
        design: &[f64],
        directions: &[Vec<f64>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Evaluation, CheckError> {
        let parameterisation = self.setup.parameterisation();
        parameterisation.validate(design).map_err(DeformError::from)?;
        self.in_passes(directions.len(), monitor, &|first| {
            let along = |i: usize, k: usize| directions.get(first + k).map_or(0.0, |d| d[i]);
            let design: Vec<Dual> = (0..design.len()).map(|i| number(design[i], |k| along(i, k))).collect();
            Ok(parameterisation.control_points_in(&design).map_err(DeformError::from)?)
        })
    }

    /// Values and derivatives along directions in the space of the user's control points.
    ///
    /// # Errors
    /// As [`Setup::deform_control_points`]; [`CheckError::Line`].
    pub fn eval_control_points(
        &self,
        control_points: &[Vec<[f64; 3]>],
        directions: &[Vec<Vec<[f64; 3]>>],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Evaluation, CheckError> {
        self.in_passes(directions.len(), monitor, &|first| {
            let point = |c: usize, i: usize, x: &[f64; 3]| {
                [0, 1, 2].map(|d| {
                    number(x[d], |k| directions.get(first + k).map_or(0.0, |direction| direction[c][i][d]))
                })
            };
            let component = |(c, points): (usize, &Vec<[f64; 3]>)| {
                points.iter().enumerate().map(|(i, x)| point(c, i, x)).collect()
            };
            Ok(control_points.iter().enumerate().map(component).collect())
        })
    }

    fn in_passes(
        &self,
        directions: usize,
        monitor: &dyn Monitor<Stage>,
        control_points: &dyn Fn(usize) -> Result<Vec<Vec<[Dual; 3]>>, CheckError>,
    ) -> Result<Evaluation, CheckError> {
        let mut all: Option<Evaluation> = None;
        let mut found: Option<(Vec<Body>, Vec<SeamPoint>)> = None;
        for first in (0..directions.max(1)).step_by(LANES) {
            let points = control_points(first)?;
            let (bodies, seams) = match found.take() {
                Some(found) => found,
                None => {
                    let values: Vec<Vec<[f64; 3]>> = points
                        .iter()
                        .map(|points| points.iter().map(|p| p.map(|x| x.re)).collect())
                        .collect();
                    let bodies = self.setup.bodies(&values)?;
                    let seams = self.setup.seams().eval(self.setup.reference(), &bodies, monitor)?;
                    (bodies, seams)
                }
            };
            let stages = self.pass(points, &bodies, &seams, monitor)?;
            let evaluation = all.get_or_insert_with(|| Evaluation {
                values: stages.values(),
                tangents: Vec::new(),
                terms: Vec::new(),
            });
            let lanes = (directions - first).min(LANES);
            evaluation.tangents.extend((0..lanes).map(|k| stages.tangents(k)));
            evaluation
                .terms
                .extend((0..lanes).map(|k| stages.functions.iter().map(|f| f.terms[k]).collect()));
            monitor.progress(Stage::Projection, (first + lanes) as f64 / directions.max(1) as f64);
            found = Some((bodies, seams));
        }
        all.ok_or(CheckError::Deform(DeformError::Cancelled))
    }

    fn pass(
        &self,
        control_points: Vec<Vec<[Dual; 3]>>,
        bodies: &[Body],
        found: &[SeamPoint],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<DualStages, CheckError> {
        let setup = self.setup;
        let reference: Vec<DualBody<'_>> = setup.reference().iter().map(DualBody::fixed).collect();
        let bodies: Vec<DualBody<'_>> =
            bodies.iter().zip(&control_points).map(|(b, points)| DualBody::new(b, points)).collect();
        let deformed = Deformed { setup, reference: &reference, bodies: &bodies };
        let go_on = || if monitor.cancelled() { Err(DeformError::Cancelled) } else { Ok(()) };
        go_on()?;
        let seams =
            DualSeams { solver: setup.seams(), reference: &reference, bodies: &bodies }.eval(found)?;
        go_on()?;
        let mut motions = Vec::new();
        let mut displacements = vec![Vector::zeros(); setup.positions().len()];
        for (region, system) in setup.fields().iter().zip(&self.systems) {
            let motion = deformed.motion(region.component, region.chart.as_deref(), &seams)?;
            let data = data(&region.field, &motion, |v| match region.component {
                None => deformed.follow(v) - constants(&setup.positions()[v as usize]),
                Some(_) => Vector::zeros(),
            });
            let values = system.interpolate(&data, &region.points);
            for (&v, value) in region.vertices.iter().zip(values) {
                displacements[v as usize] = value;
            }
            motions.push(motion);
        }
        go_on()?;
        let mut placed = deformed.place(&displacements, &seams)?;
        deformed.smooth(&self.topology, &mut placed)?;
        go_on()?;
        let vertices = deformed.onto_outer_mold_line(&placed, &seams, monitor);
        go_on()?;
        let functions = outputs::functions(setup, &vertices, &bodies);
        let placed = placed.into_iter().map(|p| p.position).collect();
        Ok(DualStages { control_points, seams, motions, displacements, placed, vertices, functions })
    }
}

impl DualStages {
    fn values(&self) -> Stages {
        self.part(&|x| x.re)
    }

    fn tangents(&self, k: usize) -> Stages {
        self.part(&|x| eps(x, k))
    }

    fn part(&self, of: &dyn Fn(&Dual) -> f64) -> Stages {
        let vector = |x: &Vector| Real::new(of(&x.x), of(&x.y), of(&x.z));
        let vectors = |x: &[Vector]| x.iter().map(vector).collect::<Vec<_>>();
        Stages {
            control_points: self
                .control_points
                .iter()
                .map(|c| c.iter().map(|p| [of(&p[0]), of(&p[1]), of(&p[2])]).collect())
                .collect(),
            seam_positions: self.seams.iter().map(|s| vector(&s.position)).collect(),
            seam_parameters: self
                .seams
                .iter()
                .map(|s| s.at.iter().map(|at| [of(&at.mu[0]), of(&at.mu[1])]).collect())
                .collect(),
            motions: self.motions.iter().map(|m| vectors(m)).collect(),
            displacements: vectors(&self.displacements),
            placed: vectors(&self.placed),
            vertices: vectors(&self.vertices),
            functions: self.functions.iter().map(|f| of(&f.value)).collect(),
        }
    }
}

/// The set-up with its components in both states.
struct Deformed<'a> {
    setup: &'a Setup,
    reference: &'a [DualBody<'a>],
    bodies: &'a [DualBody<'a>],
}

impl Deformed<'_> {
    fn own(&self, v: u32) -> &Attachment {
        &self.setup.ownership().of(v)[0]
    }

    /// A vertex that follows its component.
    fn follow(&self, v: u32) -> Vector {
        let own = self.own(v);
        self.bodies[own.component as usize].position(&At::fixed(&own.location))
    }

    /// The motion of each seam vertex in the terms of one field.
    fn motion(
        &self,
        component: Option<u32>,
        chart: Option<&Chart>,
        seams: &[DualSeam],
    ) -> Result<Vec<Vector>, CheckError> {
        let setup = self.setup;
        let motion = |(seam, point): (&moldline_deform::chain::seams::SeamVertex, &DualSeam)| {
            let start = constants(&setup.positions()[seam.vertex as usize]);
            let Some(component) = component else { return Ok(point.position - start) };
            let Some(k) = seam.owners.iter().position(|&o| o == component) else {
                return Ok(Vector::zeros());
            };
            let reference = &self.reference[component as usize];
            let (from, to) = (&seam.locations[k], &point.at[k]);
            match (chart, setup.options().propagation) {
                (Some(chart), _) => {
                    let tolerance = 1e-12 * setup.length();
                    let [a, b] = chart::unroll(chart, reference, from, to, tolerance)
                        .ok_or(CheckError::Vertex { vertex: seam.vertex })?;
                    Ok(Vector::new(a, b, constant(0.0)))
                }
                (None, Propagation::Surface) => Ok(reference.position(to) - start),
                (None, _) => Ok(point.position - self.bodies[component as usize].position(&At::fixed(from))),
            }
        };
        let motions: Vec<Result<Vector, CheckError>> =
            setup.seams().vertices.par_iter().zip(seams).map(motion).collect();
        motions.into_iter().collect()
    }

    fn place(&self, displacements: &[Vector], seams: &[DualSeam]) -> Result<Vec<Placed>, CheckError> {
        let setup = self.setup;
        let placed: Vec<Result<Placed, CheckError>> = (0..displacements.len() as u32)
            .into_par_iter()
            .map(|v| {
                let own = self.own(v);
                if setup.is_stationary(v) {
                    let position = constants(&setup.positions()[v as usize]);
                    return Ok(Placed { position, at: At::fixed(&own.location) });
                }
                let placed = self.place_vertex(v, own, &displacements[v as usize])?;
                Ok(Placed { position: self.in_plane(v, placed.position), ..placed })
            })
            .collect();
        let mut placed: Vec<Placed> = placed.into_iter().collect::<Result<_, _>>()?;
        for (seam, point) in setup.seams().vertices.iter().zip(seams) {
            if !setup.is_stationary(seam.vertex) {
                let position = self.in_plane(seam.vertex, point.position);
                placed[seam.vertex as usize] = Placed { position, at: point.at[0] };
            }
        }
        Ok(placed)
    }

    fn place_vertex(&self, v: u32, own: &Attachment, displacement: &Vector) -> Result<Placed, CheckError> {
        let setup = self.setup;
        let body = &self.bodies[own.component as usize];
        let at = |at: At| Placed { position: body.position(&at), at };
        let from = At::fixed(&own.location);
        if own.freedom == Freedom::Fixed || setup.ownership().is_seam(v) {
            return Ok(at(from));
        }
        let start = constants(&setup.positions()[v as usize]);
        Ok(match setup.options().propagation {
            Propagation::Surface => {
                let reference = &self.reference[own.component as usize];
                let region = setup.fields().iter().find(|f| f.component == Some(own.component));
                match region.map(|r| &r.chart) {
                    None => at(from),
                    Some(None) => {
                        at(onto(reference, v, own.freedom, &own.location, &(start + displacement))?.at)
                    }
                    Some(Some(chart)) => {
                        let mut departure = [displacement.x, displacement.y];
                        if let Freedom::Edge(edge) = own.freedom {
                            let sides = &body.body.component().edges()[edge as usize].sides;
                            departure = match sides.iter().find(|s| s.patch == own.location.patch) {
                                Some(side) => chart::along_edge(chart, &own.location, side, departure),
                                None => [constant(0.0); 2],
                            };
                        }
                        at(chart::walk(chart, reference, &from, departure))
                    }
                }
            }
            Propagation::Departure => {
                onto(body, v, own.freedom, &own.location, &(body.position(&from) + displacement))?.into()
            }
            Propagation::Absolute => {
                onto(body, v, own.freedom, &own.location, &(start + displacement))?.into()
            }
        })
    }

    fn may_smooth(&self, v: u32) -> bool {
        !self.setup.is_stationary(v)
            && matches!(self.setup.ownership().of(v), [only] if only.freedom == Freedom::Surface)
    }

    fn smooth(&self, topology: &Topology, placed: &mut [Placed]) -> Result<(), CheckError> {
        let options = &self.setup.options().smoothing;
        let laplacian = Laplacian::uniform(topology, |v| !self.may_smooth(v));
        for _ in 0..options.rounds {
            let next: Vec<Result<Placed, CheckError>> = (0..placed.len() as u32)
                .into_par_iter()
                .map(|v| {
                    let here = placed[v as usize];
                    if !self.may_smooth(v) {
                        return Ok(here);
                    }
                    let mean = laplacian
                        .row(v as usize)
                        .fold(Vector::zeros(), |sum, (n, w)| sum + placed[n as usize].position * constant(w));
                    let x = here.position - (here.position - mean) * constant(options.relaxation);
                    let own = self.own(v);
                    let body = &self.bodies[own.component as usize];
                    let foot = onto(body, v, own.freedom, &here.at.location(), &x)?;
                    Ok(Placed { position: self.in_plane(v, foot.position), at: foot.at })
                })
                .collect();
            for (vertex, next) in placed.iter_mut().zip(next) {
                *vertex = next?;
            }
        }
        Ok(())
    }

    fn onto_outer_mold_line(
        &self,
        placed: &[Placed],
        seams: &[DualSeam],
        monitor: &dyn Monitor<Stage>,
    ) -> Vec<Vector> {
        let setup = self.setup;
        if setup.options().outer_mold_line == OuterMoldLine::Sharp {
            return placed.iter().map(|p| p.position).collect();
        }
        let mut known: Vec<Vec<(u32, Location)>> =
            (0u32..).zip(placed).map(|(v, p)| vec![(self.own(v).component, p.at.location())]).collect();
        for (seam, point) in setup.seams().vertices.iter().zip(seams) {
            known[seam.vertex as usize] =
                seam.owners.iter().copied().zip(point.at.iter().map(At::location)).collect();
        }
        placed
            .par_iter()
            .zip(known)
            .enumerate()
            .map(|(v, (p, known))| {
                if !setup.is_active(v as u32) || monitor.cancelled() {
                    return p.position;
                }
                self.project(v as u32, p.position, known)
            })
            .collect()
    }

    /// Projection steps (eq. 18), as many as the values need.
    fn project(&self, v: u32, start: Vector, mut known: Vec<(u32, Location)>) -> Vector {
        let options = self.setup.options();
        let tolerance = options.projection_tolerance * self.setup.length();
        let smooth = self.setup.union();
        let mut x = start;
        let mut steps = 0;
        loop {
            let mut feet: Vec<Foot> = known
                .iter()
                .map(|(component, hint)| self.bodies[*component as usize].foot_near(&x, hint))
                .collect();
            for (known, foot) in known.iter_mut().zip(&feet) {
                known.1 = foot.at.location();
            }
            let mut least = feet.iter().map(|f| f.distance.re).fold(f64::INFINITY, f64::min);
            let value = real(&x);
            for (component, body) in (0u32..).zip(self.bodies) {
                if known.iter().any(|&(c, _)| c == component) {
                    continue;
                }
                let within = least.max(0.0) + smooth.reach();
                if body.body.bounds().distance(&value) > within {
                    continue;
                }
                if let Some(found) = body.body.closest_point_within(&value, within) {
                    let foot = body.foot(&x, &found);
                    known.push((component, found.location));
                    least = least.min(foot.distance.re);
                    feet.push(foot);
                }
            }
            let distances: Vec<(Dual, Vector)> = feet.iter().map(|f| (f.distance, f.normal)).collect();
            let (phi, g) = union(smooth.rho, &distances);
            if phi.re.abs() <= tolerance || steps == options.projection_steps || feet.is_empty() {
                return x;
            }
            x = self.in_plane(v, x - g * (phi / (g.dot(&g) + EPSILON)));
            steps += 1;
        }
    }

    fn in_plane(&self, v: u32, x: Vector) -> Vector {
        if self.setup.is_in_plane(v) { Vector::new(x.x, constant(0.0), x.z) } else { x }
    }
}

/// The foot point of `x` on the part of a component to which a vertex is restricted.
fn onto(
    body: &DualBody<'_>,
    v: u32,
    freedom: Freedom,
    hint: &Location,
    x: &Vector,
) -> Result<Foot, CheckError> {
    let foot = match freedom {
        Freedom::Edge(edge) => body.foot_on_edge(x, edge, hint),
        _ => body.foot_near(x, hint),
    };
    if tangent(&foot.position, 0).iter().chain(real(&foot.position).iter()).all(|x| x.is_finite()) {
        Ok(foot)
    } else {
        Err(CheckError::Vertex { vertex: v })
    }
}
