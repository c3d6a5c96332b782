//! Conversion of documents to the engine's input.

use moldline_deform::SetupInput;
use moldline_geometry::{Body, Component, ComponentOptions, PatchInput, Primitive};
use moldline_mesh::{
    Cell, Group, MeshError, Origin, SurfaceMesh,
    io::{self, Format, Imported},
};
use moldline_parameterisation::{
    Axis, CentreLine, ComponentReference, FreeFormDeclaration, OperationDeclaration, Parameterisation,
    PatchReference, Pivot, PlanformDeclaration, RadialScaleDeclaration, RotationDeclaration,
    SectionDeclaration, SectionKind, SweepRule, TranslationDeclaration, Unit, VariableDeclaration,
};
use moldline_spline::{KnotError, KnotVector, MAX_DEGREE, Surface, Vector3};

use crate::document::{
    AxisDocument, ComponentDocument, MeshDocument, OperationDocument, PatchDocument, PrimitiveDocument,
    SectionDocument, SweepDocument, UnitDocument, VariableDocument,
};
use crate::files::{Files, Limits, clean_path, find_setup_file, names};
use crate::outputs::output;
use crate::parse::{parse_geometry, parse_parameterisation, parse_setup};
use crate::{SetupFileError, document};

/// Longest name of a set-up, component, patch, group or variable, bytes.
const LONGEST_NAME: usize = 256;

/// A set-up that has been read, ready for [`moldline_deform::Setup::build`].
#[derive(Clone, Debug)]
pub struct SetupContent {
    /// Its title; the name of the set-up file if it has none.
    pub name: String,
    /// The engine's input.
    pub input: SetupInput,
    /// The file of its mesh, unless that is inline, and the unit of its coordinates, m.
    pub mesh_file: Option<(String, f64)>,
    /// Its files: the set-up file, geometry, mesh. Other files that were uploaded are not part of it.
    pub files: Vec<String>,
}

/// Reads a set-up from its files. `setup_file` names the set-up file; `setup.toml` or `setup.json` if `None`.
///
/// # Errors
/// The first thing that is wrong, with the path of the field.
pub fn read_setup(
    files: &Files,
    setup_file: Option<&str>,
    limits: &Limits,
) -> Result<SetupContent, SetupFileError> {
    let setup_file = find_setup_file(files, setup_file)?;
    let document = parse_setup(&setup_file, &files[&setup_file])?;
    let mut reader = Reader { files, limits, used: vec![setup_file.clone()], control_points: 0 };

    let (components, references) = reader.components(document.components)?;
    let variables: Vec<_> = document.parameterisation.variables.into_iter().map(variable).collect();
    let operations: Vec<_> = document.parameterisation.operations.into_iter().map(operation).collect();
    let unit = document.mesh.unit.metres();
    let mesh_file = document.mesh.file.as_deref().map(|file| clean_path("mesh.file", file)).transpose()?;
    // Independent, and both take time.
    let (mesh, parameterisation) = rayon::join(
        || reader.mesh(document.mesh),
        || Parameterisation::new(&references, &variables, &operations),
    );
    let (Imported { mesh, origin }, parameterisation) = (mesh.map_err(by_field)?, parameterisation?);
    too_many("outputs", "outputs", document.outputs.len(), limits.components)?;
    let outputs = document.outputs.into_iter().enumerate();
    let outputs =
        outputs.map(|(index, document)| output(index, document, &components)).collect::<Result<_, _>>()?;
    let options = document.options.to_options();
    check_names(&document.name, &components, &mesh, &parameterisation)?;
    Ok(SetupContent {
        name: if document.name.is_empty() { setup_file } else { document.name },
        input: SetupInput { components, mesh, origin: origin.into(), parameterisation, outputs, options },
        mesh_file: mesh_file.map(|file| (file, unit)),
        files: reader.used,
    })
}

/// Whether the engine accepts the design variables and operations of a set-up file for these components. `text` is
/// TOML with nothing but its `parameterisation`.
///
/// # Errors
/// The first thing that is wrong.
pub fn check_parameterisation(text: &str, components: &[ComponentReference]) -> Result<(), SetupFileError> {
    let document = parse_parameterisation(text)?;
    let variables: Vec<_> = document.variables.into_iter().map(variable).collect();
    let operations: Vec<_> = document.operations.into_iter().map(operation).collect();
    Parameterisation::new(components, &variables, &operations)?;
    Ok(())
}

/// Names a group's name that is too long as other names are.
fn by_field(error: SetupFileError) -> SetupFileError {
    match error {
        SetupFileError::Mesh(MeshError::LongName { kind, index, start, length, limit }) => {
            SetupFileError::Value {
                field: format!("mesh.{kind}_groups[{index}].name"),
                value: format!("'{start}...'"),
                requirement: format!("has {length} bytes; names have {limit} at most"),
            }
        }
        other => other,
    }
}

/// Refuses names that no table, log line or header has room for.
fn check_names(
    title: &str,
    components: &[Component],
    mesh: &SurfaceMesh,
    parameterisation: &Parameterisation,
) -> Result<(), SetupFileError> {
    let title = [("name".to_owned(), title)];
    let components = components.iter().enumerate().flat_map(|(i, component)| {
        let field = format!("components[{i}]");
        let patches = component.patches().iter().enumerate();
        let of_patch = format!("{field}.patches");
        let patches = patches.map(move |(k, patch)| (format!("{of_patch}[{k}].name"), patch.name.as_str()));
        std::iter::once((format!("{field}.name"), component.name())).chain(patches)
    });
    let kinds = [("cell_groups", &mesh.cell_groups), ("vertex_groups", &mesh.vertex_groups)];
    let groups = kinds.into_iter().flat_map(|(kind, groups)| {
        let groups = groups.iter().enumerate();
        groups.map(move |(i, group)| (format!("mesh.{kind}[{i}].name"), group.name.as_str()))
    });
    let variables = parameterisation.variables().iter().enumerate();
    let variables = variables
        .map(|(i, variable)| (format!("parameterisation.variables[{i}].name"), variable.name.as_str()));
    match title
        .into_iter()
        .chain(components)
        .chain(groups)
        .chain(variables)
        .find(|(_, name)| name.len() > LONGEST_NAME)
    {
        None => Ok(()),
        Some((field, name)) => Err(SetupFileError::Value {
            field,
            value: format!("'{}...'", name.chars().take(32).collect::<String>()),
            requirement: format!("has {} bytes; names have {LONGEST_NAME} at most", name.len()),
        }),
    }
}

struct Reader<'a> {
    files: &'a Files,
    limits: &'a Limits,
    used: Vec<String>,
    /// Control points read so far.
    control_points: usize,
}

/// The components of a set-up that has no mesh yet.
#[derive(Clone, Debug)]
pub struct GeometryContent {
    /// The components, each with its internal control points.
    pub bodies: Vec<Body>,
    /// The mesh file that the set-up names.
    pub mesh_file: Option<String>,
}

/// Reads the components of a set-up alone. `setup_file` as for [`read_setup`].
///
/// # Errors
/// The first thing that is wrong, with the path of the field.
pub fn read_geometry(
    files: &Files,
    setup_file: Option<&str>,
    limits: &Limits,
) -> Result<GeometryContent, SetupFileError> {
    let setup_file = find_setup_file(files, setup_file)?;
    let document = parse_setup(&setup_file, &files[&setup_file])?;
    let mut reader = Reader { files, limits, used: Vec::new(), control_points: 0 };
    let (components, references) = reader.components(document.components)?;
    let bodies = components.into_iter().zip(references).map(|(component, reference)| {
        let points: Vec<[f64; 3]> = reference.patches.into_iter().flat_map(|p| p.control_points).collect();
        let points = component.internal_control_points(&points);
        Body::new(component.into(), points)
    });
    let mesh_file = document.mesh.file.map(|file| clean_path("mesh.file", &file)).transpose()?;
    Ok(GeometryContent { bodies: bodies.collect(), mesh_file })
}

impl<'a> Reader<'a> {
    fn file(&mut self, field: &str, path: &str) -> Result<(String, &'a [u8]), SetupFileError> {
        let path = clean_path(field, path)?;
        let Some(bytes) = self.files.get(&path) else {
            return Err(SetupFileError::MissingFile { field: field.into(), path, known: names(self.files) });
        };
        if !self.used.contains(&path) {
            self.used.push(path.clone());
        }
        Ok((path, bytes))
    }

    fn components(
        &mut self,
        entries: Vec<ComponentDocument>,
    ) -> Result<(Vec<Component>, Vec<ComponentReference>), SetupFileError> {
        let count = entries.len();
        if count == 0 {
            return Err(SetupFileError::Size {
                field: "components".into(),
                found: 0,
                what: "entries",
                expected: "at least one".into(),
            });
        }
        too_many("components", "components", count, self.limits.components)?;
        let mut components = Vec::with_capacity(count);
        let mut references = Vec::with_capacity(count);
        for (index, entry) in entries.into_iter().enumerate() {
            if references.iter().any(|r: &ComponentReference| r.name == entry.name) {
                return Err(SetupFileError::Duplicate {
                    field: format!("components[{index}].name"),
                    name: entry.name,
                });
            }
            let (component, reference) = self.component(index, entry)?;
            components.push(component);
            references.push(reference);
        }
        Ok((components, references))
    }

    fn component(
        &mut self,
        index: usize,
        entry: ComponentDocument,
    ) -> Result<(Component, ComponentReference), SetupFileError> {
        let field = format!("components[{index}]");
        let ComponentDocument { name, file, patches, primitive, unit, sharp_angle, edge_tolerance, open } =
            entry;
        if name.is_empty() {
            return Err(SetupFileError::Value {
                field: format!("{field}.name"),
                value: "''".into(),
                requirement: "must not be empty".into(),
            });
        }
        let present =
            [("file", file.is_some()), ("patches", patches.is_some()), ("primitive", primitive.is_some())];
        let scale = unit.metres();
        let patches = match (file, patches, primitive) {
            (Some(file), None, None) => {
                let (path, bytes) = self.file(&format!("{field}.file"), &file)?;
                let geometry = parse_geometry(&path, &field, bytes)?;
                self.patches(&field, geometry.patches, scale)?
            }
            (None, Some(patches), None) => self.patches(&field, patches, scale)?,
            (None, None, Some(shape)) => primitive_shape(&field, &shape, scale)?
                .patches()
                .map_err(|source| SetupFileError::Primitive { index, name: name.clone(), source })?,
            _ => return Err(choice(field, "file, patches and primitive", &present)),
        };
        let mut options = ComponentOptions { allow_open: open, ..ComponentOptions::default() };
        if let Some(angle) = sharp_angle {
            options.sharp_angle_degrees = within(format!("{field}.sharp_angle"), angle, 0.0, 180.0)?;
        }
        if let Some(tolerance) = edge_tolerance {
            options.edge_tolerance = within(format!("{field}.edge_tolerance"), tolerance, 0.0, 0.1)?;
        }
        let reference =
            ComponentReference { name: name.clone(), patches: patches.iter().map(reference).collect() };
        let (component, _) = Component::new(name.clone(), patches, &options)
            .map_err(|source| SetupFileError::Component { index, name, source })?;
        Ok((component, reference))
    }

    fn patches(
        &mut self,
        field: &str,
        patches: Vec<PatchDocument>,
        scale: f64,
    ) -> Result<Vec<PatchInput>, SetupFileError> {
        if patches.is_empty() {
            return Err(SetupFileError::Size {
                field: format!("{field}.patches"),
                found: 0,
                what: "patches",
                expected: "at least one".into(),
            });
        }
        patches
            .into_iter()
            .enumerate()
            .map(|(p, patch)| self.patch(&format!("{field}.patches[{p}]"), patch, scale))
            .collect()
    }

    fn patch(&mut self, field: &str, patch: PatchDocument, scale: f64) -> Result<PatchInput, SetupFileError> {
        let PatchDocument { name, degree_u, degree_v, knots_u, knots_v, control_points, weights } = patch;
        let knots_u = knots(field, 'u', degree_u, knots_u)?;
        let knots_v = knots(field, 'v', degree_v, knots_v)?;
        let shape = (knots_u.control_point_count(), knots_v.control_point_count());
        self.control_points = self.control_points.saturating_add(shape.0.saturating_mul(shape.1));
        too_many(field, "control points up to here", self.control_points, self.limits.control_points)?;
        let control_points_field = format!("{field}.control_points");
        let mut points = grid(&control_points_field, "points", control_points, shape)?;
        for (i, point) in points.iter_mut().enumerate() {
            for (axis, value) in point.iter_mut().enumerate() {
                let at = || format!("{control_points_field}[{}][{}][{axis}]", i / shape.1, i % shape.1);
                *value = finite(at, *value * scale)?;
            }
        }
        let weights = weights
            .map(|weights| {
                let field = format!("{field}.weights");
                let weights = grid(&field, "weights", weights, shape)?;
                for (i, &weight) in weights.iter().enumerate() {
                    let at = || format!("{field}[{}][{}]", i / shape.1, i % shape.1);
                    if finite(at, weight)? <= 0.0 {
                        return Err(value_error(at(), weight, "must be positive"));
                    }
                }
                Ok(weights)
            })
            .transpose()?;
        Ok(PatchInput { name, knots_u, knots_v, control_points: points, weights })
    }

    fn mesh(&mut self, document: MeshDocument) -> Result<Imported, SetupFileError> {
        let MeshDocument { file, unit, merge_tolerance, vertices, cells, vertex_groups } = document;
        let limits = &self.limits.mesh;
        let tolerance = merge_tolerance.unwrap_or(0.0);
        if !(tolerance >= 0.0 && tolerance.is_finite()) {
            return Err(value_error("mesh.merge_tolerance".into(), tolerance, "must be 0 or greater"));
        }
        let mut imported = match (file, vertices, cells) {
            (Some(file), None, None) => {
                if vertex_groups.is_some() {
                    return Err(choice("mesh".into(), "file and vertex_groups", &[("both", true)]));
                }
                let (path, bytes) = self.file("mesh.file", &file)?;
                let format = Format::of_name(&path).ok_or_else(|| SetupFileError::Value {
                    field: "mesh.file".into(),
                    value: format!("'{path}'"),
                    requirement: format!("must end in {}", Format::ENDINGS),
                })?;
                let imported = format.read(bytes, tolerance, limits);
                imported.map_err(|source| SetupFileError::MeshFile { file: path, source })?
            }
            (None, Some(vertices), Some(cells)) => {
                let cells = cells.iter().enumerate().map(inline_cell).collect::<Result<Vec<_>, _>>()?;
                let groups = vertex_groups.unwrap_or_default();
                let groups = groups.into_iter().map(|g| Group { name: g.name, indices: g.indices }).collect();
                let mesh = SurfaceMesh::with_limits(vertices, cells, Vec::new(), groups, limits)?;
                if tolerance > 0.0 {
                    let merged = io::merged(mesh, tolerance, limits);
                    merged.map_err(|source| SetupFileError::MeshFile { file: "inline".into(), source })?
                } else {
                    Imported { mesh, origin: Origin::default() }
                }
            }
            (file, vertices, cells) => {
                let present =
                    [("file", file.is_some()), ("vertices", vertices.is_some()), ("cells", cells.is_some())];
                return Err(choice("mesh".into(), "file and (vertices with cells)", &present));
            }
        };
        if unit != document::LengthUnit::Metre {
            let scale = unit.metres();
            imported.mesh.vertices.iter_mut().flatten().for_each(|v| *v *= scale);
        }
        Ok(imported)
    }
}

fn inline_cell((i, vertices): (usize, &Vec<u32>)) -> Result<Cell, SetupFileError> {
    match vertices[..] {
        [a, b, c] => Ok(Cell::triangle(a, b, c)),
        // `u32::MAX` marks triangles in `Cell`, so it cannot be a vertex.
        [_, _, _, u32::MAX] => Err(value_error(format!("mesh.cells[{i}][3]"), u32::MAX, "is no vertex")),
        [a, b, c, d] => Ok(Cell::quad(a, b, c, d)),
        _ => Err(SetupFileError::Size {
            field: format!("mesh.cells[{i}]"),
            found: vertices.len(),
            what: "vertices",
            expected: "3 or 4".into(),
        }),
    }
}

fn knots(field: &str, direction: char, degree: usize, knots: Vec<f64>) -> Result<KnotVector, SetupFileError> {
    if !(1..=MAX_DEGREE).contains(&degree) {
        let requirement = format!("is outside 1..={MAX_DEGREE}");
        return Err(SetupFileError::Value {
            field: format!("{field}.degree_{direction}"),
            value: degree.to_string(),
            requirement,
        });
    }
    let field = format!("{field}.knots_{direction}");
    KnotVector::new(degree, knots).map_err(|source| match source {
        KnotError::NotFinite { index, value } => {
            SetupFileError::NotFinite { field: format!("{field}[{index}]"), value }
        }
        KnotError::Decreasing { index, value, previous } => value_error(
            format!("{field}[{index}]"),
            value,
            &format!("is smaller than the {previous} before it; knots must not decrease"),
        ),
        source => SetupFileError::Knots { field, source },
    })
}

/// Nested rows as one list, if they have the shape that knots and degrees require.
fn grid<T>(
    field: &str,
    what: &'static str,
    rows: Vec<Vec<T>>,
    (n_u, n_v): (usize, usize),
) -> Result<Vec<T>, SetupFileError> {
    let expected = |n: usize, d: char| format!("{n} (knots_{d} less degree_{d} + 1)");
    if rows.len() != n_u {
        let expected = expected(n_u, 'u');
        return Err(SetupFileError::Size { field: field.into(), found: rows.len(), what: "rows", expected });
    }
    if let Some(i) = rows.iter().position(|row| row.len() != n_v) {
        let (found, expected) = (rows[i].len(), expected(n_v, 'v'));
        return Err(SetupFileError::Size { field: format!("{field}[{i}]"), found, what, expected });
    }
    Ok(rows.into_iter().flatten().collect())
}

fn reference(patch: &PatchInput) -> PatchReference {
    let (knots_u, knots_v) = (patch.knots_u.clone(), patch.knots_v.clone());
    let surface = if patch.weights.is_some() {
        Surface::rational(knots_u, knots_v)
    } else {
        Surface::new(knots_u, knots_v)
    };
    PatchReference {
        surface,
        control_points: patch.control_points.clone(),
        weights: patch.weights.clone().unwrap_or_default(),
    }
}

fn primitive_shape(field: &str, shape: &PrimitiveDocument, scale: f64) -> Result<Primitive, SetupFileError> {
    let number = |name: &str, value: f64| finite(|| format!("{field}.primitive.{name}"), value * scale);
    let point = |name: &str, [x, y, z]: [f64; 3]| -> Result<Vector3, SetupFileError> {
        let at = |axis: usize, value| number(&format!("{name}[{axis}]"), value);
        Ok(Vector3::new(at(0, x)?, at(1, y)?, at(2, z)?))
    };
    Ok(match *shape {
        PrimitiveDocument::Sphere { center, radius } => {
            Primitive::Sphere { center: point("center", center)?, radius: number("radius", radius)? }
        }
        PrimitiveDocument::Box { low, high } => {
            Primitive::Box { low: point("low", low)?, high: point("high", high)? }
        }
        PrimitiveDocument::Cylinder { start, end, radius } => Primitive::Cylinder {
            start: point("start", start)?,
            end: point("end", end)?,
            radius: number("radius", radius)?,
        },
        PrimitiveDocument::Capsule { start, end, radius } => Primitive::Capsule {
            start: point("start", start)?,
            end: point("end", end)?,
            radius: number("radius", radius)?,
        },
    })
}

fn variable(v: VariableDocument) -> VariableDeclaration {
    VariableDeclaration {
        name: v.name,
        shape: v.shape,
        unit: match v.unit {
            UnitDocument::One => Unit::One,
            UnitDocument::Percent => Unit::Percent,
            UnitDocument::Metre => Unit::Metre,
            UnitDocument::Foot => Unit::Foot,
            UnitDocument::SquareMetre => Unit::SquareMetre,
            UnitDocument::SquareFoot => Unit::SquareFoot,
            UnitDocument::Degree => Unit::Degree,
            UnitDocument::Radian => Unit::Radian,
        },
        baseline: v.baseline,
        lower: v.lower.unwrap_or(f64::NEG_INFINITY),
        upper: v.upper.unwrap_or(f64::INFINITY),
    }
}

fn axis(axis: AxisDocument) -> Axis {
    match axis {
        AxisDocument::X => Axis::X,
        AxisDocument::Y => Axis::Y,
        AxisDocument::Z => Axis::Z,
    }
}

fn operation(document: OperationDocument) -> OperationDeclaration {
    match document {
        OperationDocument::FreeForm { components, span, symmetric, shape, degree, sections } => {
            OperationDeclaration::FreeForm(FreeFormDeclaration {
                components,
                span: axis(span),
                symmetric,
                shape,
                degree,
                sections: sections.into_iter().map(section).collect(),
            })
        }
        OperationDocument::Planform { components, span, symmetric, pivot, area, aspect_ratio, sweep } => {
            OperationDeclaration::Planform(PlanformDeclaration {
                components,
                span: axis(span),
                symmetric,
                pivot: pivot.map_or(Pivot::RootQuarterChord(axis(span)), Pivot::Point),
                area,
                aspect_ratio,
                sweep: match sweep {
                    SweepDocument::Scaled => SweepRule::Scaled,
                    SweepDocument::Kept => SweepRule::Kept,
                },
            })
        }
        OperationDocument::Rotation { components, axis, pivot, variable } => {
            OperationDeclaration::Rotation(RotationDeclaration {
                components,
                axis,
                pivot: pivot.map_or(Pivot::RootQuarterChord(Axis::Y), Pivot::Point),
                variable,
            })
        }
        OperationDocument::Translation { components, direction, variable } => {
            OperationDeclaration::Translation(TranslationDeclaration { components, direction, variable })
        }
        OperationDocument::RadialScale { components, axis: along, centre, stations, variable } => {
            OperationDeclaration::RadialScale(RadialScaleDeclaration {
                components,
                axis: axis(along),
                centre: centre.map_or(CentreLine::Sections, CentreLine::Point),
                stations,
                variable,
            })
        }
    }
}

fn section(document: SectionDocument) -> SectionDeclaration {
    let (kind, variable, degree) = match document {
        SectionDocument::ChordStretch { variable, degree, scales_thickness } => {
            (SectionKind::ChordStretch { scales_thickness }, variable, degree)
        }
        SectionDocument::SpanStretch { variable, degree } => (SectionKind::SpanStretch, variable, degree),
        SectionDocument::Sweep { variable, degree } => (SectionKind::Sweep, variable, degree),
        SectionDocument::Dihedral { variable, degree } => (SectionKind::Dihedral, variable, degree),
        SectionDocument::Twist { variable, degree } => (SectionKind::Twist, variable, degree),
        SectionDocument::Camber { variable, degree, rows } => {
            (SectionKind::Camber { rows }, variable, degree)
        }
        SectionDocument::Thickness { variable, degree, rows } => {
            (SectionKind::Thickness { rows }, variable, degree)
        }
    };
    SectionDeclaration { kind, variable, degree }
}

fn finite(field: impl FnOnce() -> String, value: f64) -> Result<f64, SetupFileError> {
    if value.is_finite() { Ok(value) } else { Err(SetupFileError::NotFinite { field: field(), value }) }
}

fn within(field: String, value: f64, low: f64, high: f64) -> Result<f64, SetupFileError> {
    if (low..=high).contains(&value) {
        Ok(value)
    } else {
        Err(value_error(field, value, &format!("is outside {low}..={high}")))
    }
}

fn value_error(field: String, value: impl ToString, requirement: &str) -> SetupFileError {
    SetupFileError::Value { field, value: value.to_string(), requirement: requirement.into() }
}

fn too_many(field: &str, what: &'static str, count: usize, limit: usize) -> Result<(), SetupFileError> {
    if count <= limit {
        return Ok(());
    }
    Err(SetupFileError::TooMany { field: field.into(), what, count: count as u64, limit: limit as u64 })
}

fn choice(field: String, choices: &'static str, present: &[(&str, bool)]) -> SetupFileError {
    let found: Vec<&str> = present.iter().filter(|(_, there)| *there).map(|(name, _)| *name).collect();
    let found = if found.is_empty() { "none".into() } else { found.join(", ") };
    SetupFileError::Choice { field, choices, found }
}
