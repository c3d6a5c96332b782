//! The set-up folder: geometry files, and a set-up with variables and operations by the shape of each component.

use std::fmt::Write;

use moldline_geometry::PatchInput;
use moldline_parameterisation::{ComponentReference, PatchReference};
use moldline_setup_files::{
    Files, check_parameterisation,
    document::{GeometryDocument, PatchDocument},
};
use moldline_spline::Surface;

use crate::{
    assembly::Assembled,
    measure::Samples,
    shape::{Long, Shape, Wing},
};

/// Coefficients along the span of a wing, and lattice rows along its chord.
const STATIONS: usize = 5;
const ROWS: usize = 6;

/// A part of the set-up file: variables and operations of a component.
pub(crate) struct Block {
    text: String,
    /// Scalar variables.
    pub(crate) variables: usize,
}

/// Variables and operations of a component: all that fit its shape, or its position alone if the engine refuses those.
pub(crate) fn parameterisation(component: &Assembled, shape: &Shape, samples: &Samples) -> Block {
    let reference = reference(component);
    let mut rest = Writer::new(&component.name);
    rest.position(samples);
    let mut all = Writer::new(&component.name);
    match shape {
        Shape::Wing(wing) => all.wing(wing),
        Shape::Body(body) => all.body(body),
        Shape::Other => {}
    }
    all.position(samples);
    let accepted = check_parameterisation(&all.text, std::slice::from_ref(&reference)).is_ok();
    let Writer { text, variables, .. } = if accepted { all } else { rest };
    Block { text, variables }
}

/// The files of the set-up.
pub(crate) fn files(title: &str, components: &[(Assembled, Block)]) -> Files {
    let mut files = Files::new();
    let mut text = String::from(HEAD);
    let title = serde_json::Value::from(title);
    let _ = writeln!(text, "format = 1\nname = {title}\n\n[mesh]\nfile = \"mesh.msh\"");
    for (component, _) in components {
        let name = &component.name;
        let path = format!("geometry/{name}.json");
        let _ = write!(
            text,
            "\n[[components]]\nname = \"{name}\" # {} in the file\nfile = \"{path}\"\n",
            component.id
        );
        if component.edge_tolerance > 1e-7 {
            let _ = writeln!(
                text,
                "edge_tolerance = {:e} # edges of its patches have gaps",
                component.edge_tolerance
            );
        }
        files.insert(path, geometry(component));
    }
    for (_, block) in components {
        text += &block.text;
    }
    files.insert("setup.toml".into(), text.into_bytes());
    files
}

const HEAD: &str = "\
# Made by `moldline import`. Axes: x aft, y starboard, z up; lengths are metres.
# Delete what you do not need: every variable with its use in the operations. Operations act in the order written.
# The mesh is the one thing missing: mesh.msh, with its vertices on these components and its edges along their seams.
# Volumes and wetted areas are outputs of every set-up.
";

fn geometry(component: &Assembled) -> Vec<u8> {
    let patch = |patch: &PatchInput| {
        let n_v = patch.knots_v.control_point_count();
        PatchDocument {
            name: patch.name.clone(),
            degree_u: patch.knots_u.degree(),
            degree_v: patch.knots_v.degree(),
            knots_u: patch.knots_u.knots().to_vec(),
            knots_v: patch.knots_v.knots().to_vec(),
            control_points: patch.control_points.chunks(n_v).map(<[_]>::to_vec).collect(),
            weights: patch.weights.as_ref().map(|w| w.chunks(n_v).map(<[_]>::to_vec).collect()),
        }
    };
    let document = GeometryDocument {
        name: Some(component.name.clone()),
        patches: component.patches.iter().map(patch).collect(),
    };
    // Numbers and texts can always be written.
    serde_json::to_vec(&document).unwrap_or_default()
}

fn reference(component: &Assembled) -> ComponentReference {
    let patch = |patch: &PatchInput| PatchReference {
        surface: if patch.weights.is_some() {
            Surface::rational(patch.knots_u.clone(), patch.knots_v.clone())
        } else {
            Surface::new(patch.knots_u.clone(), patch.knots_v.clone())
        },
        control_points: patch.control_points.clone(),
        weights: patch.weights.clone().unwrap_or_default(),
    };
    ComponentReference {
        name: component.name.clone(),
        patches: component.patches.iter().map(patch).collect(),
    }
}

/// Writes the variables and operations of a component.
struct Writer<'n> {
    name: &'n str,
    text: String,
    variables: usize,
}

impl<'n> Writer<'n> {
    fn new(name: &'n str) -> Self {
        Self { name, text: String::new(), variables: 0 }
    }

    fn line(&mut self, line: &str) {
        self.text.push_str(line);
        self.text.push('\n');
    }

    /// A variable; `comment` says what it is.
    fn variable(&mut self, name: &str, comment: &str, shape: &[usize], unit: &str, bounds: [f64; 2]) {
        let full = format!("{}.{name}", self.name);
        let [lower, upper] = bounds.map(rounded);
        self.line(&format!("\n[[parameterisation.variables]]\nname = \"{full}\" # {comment}"));
        if !shape.is_empty() {
            self.line(&format!("shape = {shape:?}"));
        }
        self.line(&format!("unit = \"{unit}\"\nlower = {lower}\nupper = {upper}"));
        self.variables += shape.iter().product::<usize>();
    }

    fn operation(&mut self, kind: &str, lines: &str) {
        let name = self.name;
        self.line(&format!(
            "\n[[parameterisation.operations]]\ntype = \"{kind}\"\ncomponents = [\"{name}\"]\n{lines}"
        ));
    }

    fn wing(&mut self, wing: &Wing) {
        let name = self.name.to_owned();
        let Wing { span_axis, symmetric, span, area, root_quarter_chord } = wing;
        let axis = ["x", "y", "z"][*span_axis];
        let half = if *symmetric { 0.5 * span } else { *span };
        let up = if *span_axis == 1 { "up" } else { "to starboard" };
        self.line(&format!("\n# ---- {name}: a wing along {axis} ----"));
        let stations = [STATIONS];
        // The root of a mirrored wing does not move along the span.
        let span_stations = [if *symmetric { STATIONS - 1 } else { STATIONS }];
        let rows = [ROWS - 2, STATIONS];
        self.variable("twist", "root to tip, leading edge up", &stations, "deg", [-5.0, 5.0]);
        self.variable(
            "camber",
            &format!("rows from leading to trailing edge, moved {up}, of the local chord"),
            &rows,
            "percent",
            [-3.0, 3.0],
        );
        self.variable(
            "thickness",
            "rows from leading to trailing edge, of the local chord",
            &rows,
            "percent",
            [-2.0, 2.0],
        );
        self.variable("chord", "root to tip, added to the local chord", &stations, "percent", [-20.0, 20.0]);
        self.variable(
            "sections",
            "root to tip, sections moved outward",
            &span_stations,
            "m",
            [-0.05 * half, 0.05 * half],
        );
        self.variable("area", "planform, through other components", &[], "m^2", [0.8 * area, 1.25 * area]);
        let aspect_ratio = span * span / area;
        self.variable("aspect_ratio", "span^2 / area", &[], "1", [0.8 * aspect_ratio, 1.25 * aspect_ratio]);
        self.variable("incidence", "about the quarter chord of the root", &[], "deg", [-5.0, 5.0]);
        // One section in the middle and the same number on both sides.
        let sections = if *symmetric { 2 * STATIONS - 1 } else { STATIONS };
        self.operation(
            "free_form",
            &format!(
                "span = \"{axis}\"\nsymmetric = {symmetric}\nshape = [{ROWS}, {sections}, 2] # along chord, span and thickness\ndegree = [3, 3, 1]\nsections = [\n    \
                 {{ type = \"twist\", variable = \"{name}.twist\", degree = 3 }},\n    \
                 {{ type = \"camber\", variable = \"{name}.camber\", degree = 3 }},\n    \
                 {{ type = \"thickness\", variable = \"{name}.thickness\", degree = 3 }},\n    \
                 {{ type = \"chord_stretch\", variable = \"{name}.chord\", degree = 3, scales_thickness = true }},\n    \
                 {{ type = \"span_stretch\", variable = \"{name}.sections\", degree = 3 }},\n]"
            ),
        );
        self.operation(
            "planform",
            &format!(
                "span = \"{axis}\"\nsymmetric = {symmetric}\narea = \"{name}.area\"\naspect_ratio = \"{name}.aspect_ratio\""
            ),
        );
        let turn = if *span_axis == 1 { "[0, 1, 0]" } else { "[0, 0, 1]" };
        let [x, y, z] = [0, 1, 2].map(|k| root_quarter_chord[k]);
        self.operation(
            "rotation",
            &format!("axis = {turn}\npivot = [{x}, {y}, {z}] # quarter chord of the root\nvariable = \"{name}.incidence\""),
        );
    }

    fn body(&mut self, body: &Long) {
        let name = self.name.to_owned();
        let Long { axis, start, end, diameter, single } = *body;
        let label = ["x", "y", "z"][axis];
        let length = end - start;
        self.line(&format!(
            "\n# ---- {name}: a body along {label}, {length:.4} m long, {diameter:.4} m wide ----"
        ));
        self.variable(
            "length",
            "how far both ends move along the axis",
            &[2],
            "m",
            [-0.1 * length, 0.1 * length],
        );
        self.operation(
            "free_form",
            &format!(
                "span = \"{label}\"\nsymmetric = false\nshape = [2, 5, 2]\ndegree = [1, 3, 1]\nsections = [{{ type = \"span_stretch\", variable = \"{name}.length\", degree = 1 }}]"
            ),
        );
        if single {
            self.text += &format!(
                "\n[[parameterisation.variables]]\nname = \"{name}.diameter\" # scales with value / baseline\nunit = \"m\"\n"
            );
            let [baseline, lower, upper] = [diameter, 0.8 * diameter, 1.25 * diameter].map(rounded);
            self.text += &format!("baseline = {baseline}\nlower = {lower}\nupper = {upper}\n");
            self.variables += 1;
            let stations = [0.0, 0.2, 0.6, 1.0].map(|f| rounded(start + f * length));
            self.operation(
                "radial_scale",
                &format!(
                    "axis = \"{label}\"\n# Full between the second and the third, nothing at the ends.\nstations = {stations:?}\nvariable = \"{name}.diameter\""
                ),
            );
        }
    }

    fn position(&mut self, samples: &Samples) {
        let name = self.name.to_owned();
        let reach = 0.1 * (samples.high - samples.low).norm();
        for (variable, comment, direction) in
            [("aft", "position", "[1, 0, 0]"), ("up", "position", "[0, 0, 1]")]
        {
            self.variable(variable, comment, &[], "m", [-reach, reach]);
            self.operation(
                "translation",
                &format!("direction = {direction}\nvariable = \"{name}.{variable}\""),
            );
        }
    }
}

/// To four digits, since bounds are for people.
fn rounded(x: f64) -> f64 {
    format!("{x:.3e}").parse().unwrap_or(x)
}
