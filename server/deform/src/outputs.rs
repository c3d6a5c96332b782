//! Scalar outputs besides the vertices, as optimizers constrain them: enclosed volume, wetted areas, volumes of components,
//! tracked points, planforms.
//!
//! Volumes and areas are homogeneous polynomials or norms of the positions, so that they are evaluated from their own
//! gradients (Euler's theorem): `3 V = sum x . dV/dx`, `2 A = sum x . dA/dx`.

use moldline_foundation::quadrature::gauss_legendre;
use moldline_geometry::{Block, Body, Component, Location, block::vector};
use moldline_mesh::Cell;
use moldline_spline::Vector3;

use crate::SetupError;

/// A point of a component by the parameters of one of the user's patches.
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentPoint {
    /// Index of the component.
    pub component: usize,
    /// Index of the patch, as the user gave them.
    pub patch: usize,
    /// First parameter.
    pub u: f64,
    /// Second parameter.
    pub v: f64,
}

/// An output to be computed.
#[derive(Clone, Debug, PartialEq)]
pub enum OutputDeclaration {
    /// A weighted sum of points of components: `name.x`, `name.y`, `name.z`, m. A quarter-chord point is three quarters
    /// of the leading and one of the trailing edge.
    Point {
        /// Its name.
        name: String,
        /// The points and their weights.
        of: Vec<(ComponentPoint, f64)>,
    },
    /// `name.planform_area` (m^2), `name.span` (m) and `name.mean_aerodynamic_chord` (m) of the polygon through stations
    /// on the leading and trailing edge, seen along z; chords run along x, the span along y.
    Planform {
        /// Its name.
        name: String,
        /// Points on the leading edge, from one tip to the other.
        leading_edge: Vec<ComponentPoint>,
        /// As many on the trailing edge.
        trailing_edge: Vec<ComponentPoint>,
    },
}

/// A scalar output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Function {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
}

/// A point by its internal parameters.
#[derive(Clone, Debug)]
pub struct At {
    /// Index of the component.
    pub component: usize,
    /// Where on it.
    pub location: Location,
}

/// What a group of functions is made of.
#[derive(Clone, Debug)]
pub enum Item {
    /// Volume within the mesh.
    EnclosedVolume,
    /// Area of the cells of a component.
    WettedArea {
        /// Its index.
        component: u32,
    },
    /// Volume of a component.
    Volume {
        /// Its index.
        component: usize,
    },
    /// A weighted sum of points: three functions.
    Point(Vec<(At, f64)>),
    /// Area, span and mean aerodynamic chord of stations from tip to tip, leading and trailing edge of each.
    Planform(Vec<[At; 2]>),
}

/// The scalar outputs of a set-up.
#[derive(Clone, Debug)]
pub struct Outputs {
    functions: Vec<Function>,
    items: Vec<Item>,
    /// What volumes are seen from; on the symmetry plane of a half model, whose open side then adds nothing.
    origin: Vector3,
}

/// The gradient of one function.
#[derive(Clone, Debug, Default)]
struct FunctionGradient {
    /// By the vertices; empty if it does not depend on them.
    vertices: Vec<Vector3>,
    /// By the internal control points of some components.
    control_points: Vec<(usize, Block)>,
}

/// The scalar outputs at one state, ready for products.
#[derive(Clone, Debug)]
pub struct OutputsDerivative {
    gradients: Vec<FunctionGradient>,
}

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
}

impl Outputs {
    /// The outputs that every set-up has, and the declared ones. `origin`: what volumes are seen from.
    ///
    /// # Errors
    /// [`SetupError::Output`] naming the output and what is wrong with it.
    pub fn new<C: AsRef<Component>>(
        declarations: &[OutputDeclaration],
        components: &[C],
        origin: Vector3,
    ) -> Result<Self, SetupError> {
        let mut outputs = Self { functions: Vec::new(), items: Vec::new(), origin };
        outputs.push(Item::EnclosedVolume, [("enclosed_volume".to_owned(), "m^3")]);
        for (c, component) in components.iter().enumerate() {
            let name = component.as_ref().name();
            outputs.push(Item::WettedArea { component: c as u32 }, [(format!("{name}.wetted_area"), "m^2")]);
            outputs.push(Item::Volume { component: c }, [(format!("{name}.volume"), "m^3")]);
        }
        for declaration in declarations {
            outputs.declare(declaration, components)?;
        }
        let functions = &outputs.functions;
        if let Some(i) = (1..functions.len()).find(|&i| functions[..i].contains(&functions[i])) {
            let name = functions[i].name.clone();
            return Err(SetupError::Output { name, reason: "another output has that name".into() });
        }
        Ok(outputs)
    }

    fn push<const N: usize>(&mut self, item: Item, functions: [(String, &'static str); N]) {
        self.items.push(item);
        self.functions.extend(functions.map(|(name, unit)| Function { name, unit }));
    }

    fn declare<C: AsRef<Component>>(
        &mut self,
        declaration: &OutputDeclaration,
        components: &[C],
    ) -> Result<(), SetupError> {
        match declaration {
            OutputDeclaration::Point { name, of } => {
                let refuse = |reason: String| SetupError::Output { name: name.clone(), reason };
                if of.is_empty() {
                    return Err(refuse("it has no points".into()));
                }
                let mut points = Vec::with_capacity(of.len());
                for (point, weight) in of {
                    if !weight.is_finite() {
                        return Err(refuse(format!("the weight {weight} is not a finite number")));
                    }
                    points.push((locate(point, components).map_err(refuse)?, *weight));
                }
                let axes = ["x", "y", "z"].map(|axis| (format!("{name}.{axis}"), "m"));
                self.push(Item::Point(points), axes);
            }
            OutputDeclaration::Planform { name, leading_edge, trailing_edge } => {
                let refuse = |reason: String| SetupError::Output { name: name.clone(), reason };
                let (n, m) = (leading_edge.len(), trailing_edge.len());
                if n != m || n < 2 {
                    return Err(refuse(format!(
                        "{n} points on the leading and {m} on the trailing edge; there must be as many, two at least"
                    )));
                }
                let mut stations = Vec::with_capacity(n);
                for (leading, trailing) in leading_edge.iter().zip(trailing_edge) {
                    stations.push([
                        locate(leading, components).map_err(refuse)?,
                        locate(trailing, components).map_err(refuse)?,
                    ]);
                }
                self.push(
                    Item::Planform(stations),
                    [
                        (format!("{name}.planform_area"), "m^2"),
                        (format!("{name}.span"), "m"),
                        (format!("{name}.mean_aerodynamic_chord"), "m"),
                    ],
                );
            }
        }
        Ok(())
    }

    /// The functions, in the order of their values.
    pub fn functions(&self) -> &[Function] {
        &self.functions
    }

    /// What the functions are made of, in the same order.
    pub fn items(&self) -> &[Item] {
        &self.items
    }

    /// What volumes are seen from, m.
    pub fn origin(&self) -> Vector3 {
        self.origin
    }

    /// The values of all functions.
    pub fn eval(&self, at: Measured) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.functions.len());
        for item in &self.items {
            match item {
                Item::EnclosedVolume => {
                    let gradient = self.volume_by_vertices(at);
                    values.push(self.euler(at, &gradient) / 3.0);
                }
                Item::WettedArea { component } => {
                    let gradient = area_by_vertices(at, *component);
                    values.push(self.euler(at, &gradient) / 2.0);
                }
                Item::Volume { component } => {
                    let body = &at.bodies[*component];
                    let mut volume = 0.0;
                    quadrature(body, |weight, location| {
                        let p = body.point(location);
                        volume += weight * (p.position - self.origin).dot(&p.d_u.cross(&p.d_v)) / 3.0;
                    });
                    values.push(volume);
                }
                Item::Point(points) => {
                    let sum: Vector3 =
                        points.iter().map(|(p, w)| at.bodies[p.component].position(&p.location) * *w).sum();
                    values.extend(sum.iter());
                }
                Item::Planform(stations) => values.extend(planform(stations, at.bodies).0),
            }
        }
        values
    }

    /// `sum x . gradient`, seen from the origin.
    fn euler(&self, at: Measured, gradient: &[Vector3]) -> f64 {
        let positions = at.vertices.iter().map(|x| Vector3::from(*x) - self.origin);
        positions.zip(gradient).map(|(x, g)| x.dot(g)).sum()
    }

    /// A warped quadrilateral counts as the mean of its two splits into triangles.
    fn volume_by_vertices(&self, at: Measured) -> Vec<Vector3> {
        let mut gradient = vec![Vector3::zeros(); at.vertices.len()];
        let x = |v: u32| Vector3::from(at.vertices[v as usize]) - self.origin;
        let mut add = |[a, b, c]: [u32; 3], weight: f64| {
            for [p, q, r] in [[a, b, c], [b, c, a], [c, a, b]] {
                gradient[p as usize] += x(q).cross(&x(r)) * weight;
            }
        };
        for cell in at.cells {
            match *cell.vertices() {
                [a, b, c] => add([a, b, c], 1.0 / 6.0),
                [a, b, c, d] => {
                    [[a, b, c], [a, c, d], [b, c, d], [b, d, a]].into_iter().for_each(|t| add(t, 1.0 / 12.0));
                }
                _ => {}
            }
        }
        gradient
    }

    /// The derivative at a state.
    pub fn linearise(&self, at: Measured) -> OutputsDerivative {
        let mut gradients = Vec::with_capacity(self.functions.len());
        let of_vertices = |vertices| FunctionGradient { vertices, ..FunctionGradient::default() };
        for item in &self.items {
            match item {
                Item::EnclosedVolume => gradients.push(of_vertices(self.volume_by_vertices(at))),
                Item::WettedArea { component } => {
                    gradients.push(of_vertices(area_by_vertices(at, *component)));
                }
                Item::Volume { component } => {
                    let body = &at.bodies[*component];
                    let mut by_points = Block::zeros(body.control_points().len(), 3);
                    quadrature(body, |weight, location| {
                        let p = body.point(location);
                        let (x, third) = (p.position - self.origin, weight / 3.0);
                        let mut seed = Block::zeros(3, 3);
                        let by = [p.d_u.cross(&p.d_v), p.d_v.cross(&x), x.cross(&p.d_u)];
                        for (k, g) in by.into_iter().enumerate() {
                            seed.row_mut(k).copy_from_slice((g * third).as_slice());
                        }
                        body.basis(location).point_vjp(&seed, &mut by_points);
                    });
                    let control_points = vec![(*component, by_points)];
                    gradients.push(FunctionGradient { control_points, ..FunctionGradient::default() });
                }
                Item::Point(points) => {
                    for axis in 0..3 {
                        let mut gradient = FunctionGradient::default();
                        for (point, weight) in points {
                            gradient.add_point(point, &Vector3::ith(axis, *weight), at.bodies);
                        }
                        gradients.push(gradient);
                    }
                }
                Item::Planform(stations) => {
                    for by_points in planform(stations, at.bodies).1 {
                        let mut gradient = FunctionGradient::default();
                        for (station, by) in stations.iter().zip(by_points) {
                            for (point, by) in station.iter().zip(by) {
                                gradient.add_point(point, &by, at.bodies);
                            }
                        }
                        gradients.push(gradient);
                    }
                }
            }
        }
        OutputsDerivative { gradients }
    }
}

impl FunctionGradient {
    fn add_point(&mut self, point: &At, by: &Vector3, bodies: &[Body]) {
        let body = &bodies[point.component];
        let slot = self.control_points.iter().position(|(c, _)| *c == point.component).unwrap_or_else(|| {
            self.control_points.push((point.component, Block::zeros(body.control_points().len(), 3)));
            self.control_points.len() - 1
        });
        body.basis(&point.location).position_vjp(by.as_slice(), &mut self.control_points[slot].1);
    }
}

impl OutputsDerivative {
    /// Tangents of the functions, a row each, for those of the vertices and of the internal control points.
    pub fn jvp(&self, vertices: &Block, control_points: &[Block]) -> Block {
        let k = vertices.directions();
        let mut out = Block::zeros(self.gradients.len(), k);
        for (f, gradient) in self.gradients.iter().enumerate() {
            let row = out.row_mut(f);
            let mut add = |g: &Vector3, tangent: &[f64]| {
                row.iter_mut().enumerate().for_each(|(d, sum)| *sum += g.dot(&vector(tangent, d)));
            };
            for (v, g) in gradient.vertices.iter().enumerate() {
                add(g, vertices.row(v));
            }
            for (c, by_points) in &gradient.control_points {
                for i in 0..by_points.data().len() / 3 {
                    add(&by_points.vector(i, 0), control_points[*c].row(i));
                }
            }
        }
        out
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the vertices and of the internal control points.
    pub fn vjp(&self, seeds: &Block, vertices: &mut Block, control_points: &mut [Block]) {
        for (f, gradient) in self.gradients.iter().enumerate() {
            let seed = seeds.row(f);
            if seed.iter().all(|s| *s == 0.0) {
                continue;
            }
            let add = |g: &Vector3, to: &mut [f64]| {
                for (d, s) in seed.iter().enumerate() {
                    (0..3).for_each(|axis| to[3 * d + axis] += g[axis] * s);
                }
            };
            for (v, g) in gradient.vertices.iter().enumerate() {
                add(g, vertices.row_mut(v));
            }
            for (c, by_points) in &gradient.control_points {
                for i in 0..by_points.data().len() / 3 {
                    add(&by_points.vector(i, 0), control_points[*c].row_mut(i));
                }
            }
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let of_points = |g: &FunctionGradient| -> usize {
            g.control_points.iter().map(|(_, block)| size_of_val(block.data())).sum()
        };
        self.gradients.iter().map(|g| size_of_val(&g.vertices[..]) + of_points(g)).sum()
    }
}

/// `dA/dx` of a component's cells; a quadrilateral's area is that of its area vector.
fn area_by_vertices(at: Measured, component: u32) -> Vec<Vector3> {
    let mut gradient = vec![Vector3::zeros(); at.vertices.len()];
    let x = |v: u32| Vector3::from(at.vertices[v as usize]);
    for (cell, _) in at.cells.iter().zip(at.owners).filter(|(_, owner)| **owner == component) {
        // The area vector is half the cross product of the differences p - q and r - s.
        let (p, q, r, s) = match *cell.vertices() {
            [a, b, c] => (b, a, c, a),
            [a, b, c, d] => (c, a, d, b),
            _ => continue,
        };
        let (e, f) = (x(p) - x(q), x(r) - x(s));
        let Some(n) = e.cross(&f).try_normalize(0.0) else { continue };
        let (by_e, by_f) = (f.cross(&n) * 0.5, n.cross(&e) * 0.5);
        gradient[p as usize] += by_e;
        gradient[q as usize] -= by_e;
        gradient[r as usize] += by_f;
        gradient[s as usize] -= by_f;
    }
    gradient
}

/// Area, span and mean aerodynamic chord of stations `[leading, trailing]`, and their gradients by these points.
fn planform(stations: &[[At; 2]], bodies: &[Body]) -> ([f64; 3], [Vec<[Vector3; 2]>; 3]) {
    let points: Vec<[Vector3; 2]> = stations
        .iter()
        .map(|station| station.each_ref().map(|p| bodies[p.component].position(&p.location)))
        .collect();
    let chord = |k: usize| points[k][1].x - points[k][0].x;
    let y = |k: usize| 0.5 * (points[k][0].y + points[k][1].y);
    let last = points.len() - 1;
    // Stations may run from either tip.
    let sign = (y(last) - y(0)).signum();
    let (mut area, mut squares) = (0.0, 0.0);
    // Gradients of the area and of the integral of the squared chord by chords and by y.
    let mut by = vec![[[0.0; 2]; 2]; points.len()];
    for k in 0..last {
        let (c, d, width) = (chord(k), chord(k + 1), sign * (y(k + 1) - y(k)));
        let (mean, square) = (0.5 * (c + d), (c * c + c * d + d * d) / 3.0);
        area += width * mean;
        squares += width * square;
        for (i, by_chord) in [(k, (2.0 * c + d) / 3.0), (k + 1, (c + 2.0 * d) / 3.0)] {
            by[i][0][0] += 0.5 * width;
            by[i][1][0] += width * by_chord;
        }
        for (i, s) in [(k, -sign), (k + 1, sign)] {
            by[i][0][1] += s * mean;
            by[i][1][1] += s * square;
        }
    }
    let chord_mean = squares / area;
    let at_points = |c: f64, y: f64| [Vector3::new(-c, 0.5 * y, 0.0), Vector3::new(c, 0.5 * y, 0.0)];
    let area_by = by.iter().map(|g| at_points(g[0][0], g[0][1])).collect();
    let chord_by = by
        .iter()
        .map(|g| {
            let through = |k: usize| (g[1][k] - chord_mean * g[0][k]) / area;
            at_points(through(0), through(1))
        })
        .collect();
    let mut span_by = vec![[Vector3::zeros(); 2]; points.len()];
    span_by[0] = at_points(0.0, -sign);
    span_by[last] = at_points(0.0, sign);
    ([area, sign * (y(last) - y(0)), chord_mean], [area_by, span_by, chord_by])
}

/// Calls `f(weight, location)` at the points of a Gauss rule over all patches, exact for the volume of patches that are not
/// rational; weights are negative where a patch's parameters turn inwards.
pub fn quadrature(body: &Body, mut f: impl FnMut(f64, &Location)) {
    for (patch, description) in (0u32..).zip(body.component().patches()) {
        let surface = &description.surface;
        let sign = if description.flipped { -1.0 } else { 1.0 };
        // S . (S_u x S_v) has degree 3 p - 1; rational patches converge fast.
        let extra = if surface.is_rational() { 4 } else { 0 };
        let rule = |degree: usize| gauss_legendre((3 * degree).div_ceil(2) + extra);
        let (rule_u, rule_v) = (rule(surface.knots_u().degree()), rule(surface.knots_v().degree()));
        for u in surface.knots_u().breaks().windows(2) {
            for v in surface.knots_v().breaks().windows(2) {
                let (du, dv) = (0.5 * (u[1] - u[0]), 0.5 * (v[1] - v[0]));
                for (s, ws) in &rule_u {
                    for (t, wt) in &rule_v {
                        let location = Location { patch, u: u[0] + du * (1.0 + s), v: v[0] + dv * (1.0 + t) };
                        f(sign * ws * wt * du * dv, &location);
                    }
                }
            }
        }
    }
}

fn locate<C: AsRef<Component>>(point: &ComponentPoint, components: &[C]) -> Result<At, String> {
    let count = components.len();
    let component = components
        .get(point.component)
        .ok_or_else(|| format!("component {} of {count}", point.component))?
        .as_ref();
    let (u, v) = (point.u, point.v);
    let within = |x: f64, (low, high): (f64, f64)| low <= x && x <= high;
    let of_patch = component.patches().iter().enumerate().filter(|(_, p)| p.source == point.patch);
    let mut ranges = [(f64::INFINITY, f64::NEG_INFINITY); 2];
    for (patch, description) in of_patch {
        let [du, dv] = description.surface.domain();
        if within(u, du) && within(v, dv) {
            let location = Location { patch: patch as u32, u, v };
            return Ok(At { component: point.component, location });
        }
        for (range, (low, high)) in ranges.iter_mut().zip([du, dv]) {
            *range = (range.0.min(low), range.1.max(high));
        }
    }
    let [(u0, u1), (v0, v1)] = ranges;
    Err(format!(
        "(u, v) = ({u}, {v}) is not on patch {} of `{}`, whose parameters are in [{u0}, {u1}] x [{v0}, {v1}]",
        point.patch,
        component.name()
    ))
}
