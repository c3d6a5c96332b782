//! Scalar outputs, as optimizers constrain them: enclosed volume, wetted areas, volumes of components,
//! tracked points, planforms.

mod area;
mod gradient;
mod planform;
mod point;
mod volume;

use moldline_geometry::{Block, Component};
use moldline_spline::Vector3;

use crate::SetupError;
use gradient::FunctionGradient;

pub use gradient::{At, Measured};
pub use point::ComponentPoint;
pub use volume::quadrature;

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

/// An item that one or three functions are made of.
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
    /// The point that volumes are seen from, m; on the symmetry plane of a half model, whose open side then adds nothing.
    origin: Vector3,
}

/// The scalar outputs at one state, ready for products.
#[derive(Clone, Debug)]
pub struct OutputsDerivative {
    gradients: Vec<FunctionGradient>,
}

impl Outputs {
    /// The outputs that every set-up has, and the declared ones. `origin`: the point that volumes are seen from, m.
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
        for ((c, index), component) in (0u32..).zip(0..).zip(components) {
            let name = component.as_ref().name();
            outputs.push(Item::WettedArea { component: c }, [(format!("{name}.wetted_area"), "m^2")]);
            outputs.push(Item::Volume { component: index }, [(format!("{name}.volume"), "m^3")]);
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
                    points.push((point.locate(components).map_err(refuse)?, *weight));
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
                        leading.locate(components).map_err(refuse)?,
                        trailing.locate(components).map_err(refuse)?,
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

    /// The items that the functions are made of, in the same order.
    pub fn items(&self) -> &[Item] {
        &self.items
    }

    /// The point that volumes are seen from, m.
    pub fn origin(&self) -> Vector3 {
        self.origin
    }

    /// The values of all functions.
    pub fn eval(&self, at: Measured) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.functions.len());
        for item in &self.items {
            match item {
                Item::EnclosedVolume => values.push(volume::enclosed(at)),
                Item::WettedArea { component } => values.push(area::eval(at, *component)),
                Item::Volume { component } => values.push(volume::eval(&at.bodies[*component], at.origin)),
                Item::Point(points) => values.extend(point::eval(points, at.bodies).iter()),
                Item::Planform(stations) => values.extend(planform::eval(stations, at.bodies)),
            }
        }
        values
    }

    /// The derivative at a state.
    pub fn linearise(&self, at: Measured) -> OutputsDerivative {
        let mut gradients = Vec::with_capacity(self.functions.len());
        for item in &self.items {
            match item {
                Item::EnclosedVolume => {
                    gradients.push(FunctionGradient::of_vertices(volume::enclosed_gradient(at)));
                }
                Item::WettedArea { component } => {
                    gradients.push(FunctionGradient::of_vertices(area::gradient(at, *component)));
                }
                Item::Volume { component } => {
                    gradients.push(volume::gradient(&at.bodies[*component], *component, at.origin));
                }
                Item::Point(points) => gradients.extend(point::gradients(points, at.bodies)),
                Item::Planform(stations) => gradients.extend(planform::gradients(stations, at.bodies)),
            }
        }
        OutputsDerivative { gradients }
    }
}

impl OutputsDerivative {
    /// Tangents of the functions, a row each, for those of the vertices and of the internal control points.
    pub fn jvp(&self, vertices: &Block, control_points: &[Block]) -> Block {
        let mut out = Block::zeros(self.gradients.len(), vertices.directions());
        for (f, gradient) in self.gradients.iter().enumerate() {
            gradient.jvp(vertices, control_points, out.row_mut(f));
        }
        out
    }

    /// The transpose of [`jvp`](Self::jvp): adds to the seeds of the vertices and of the internal control points.
    pub fn vjp(&self, seeds: &Block, mut vertices: Block, control_points: &mut [Block]) -> Block {
        for (f, gradient) in self.gradients.iter().enumerate() {
            let seed = seeds.row(f);
            if seed.iter().any(|s| *s != 0.0) {
                gradient.vjp(seed, &mut vertices, control_points);
            }
        }
        vertices
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.gradients.iter().map(FunctionGradient::bytes).sum()
    }
}
