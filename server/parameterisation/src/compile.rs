//! Declarations to operations: names are looked up, reference geometry is measured, everything is checked.

use std::cell::OnceCell;
use std::collections::{BTreeMap, HashMap};
use std::ops::Range;
use std::rc::Rc;

use moldline_spline::{KnotVector, Vector3};

use crate::channel::Additive;
use crate::declaration::{
    CentreLine, ComponentReference, FreeFormDeclaration, OperationDeclaration, Pivot, PlanformDeclaration,
    RadialScaleDeclaration, RotationDeclaration, SectionDeclaration, SectionKind, SweepRule,
    TranslationDeclaration, VariableDeclaration,
};
use crate::freeform::{self, FreeForm, Influence};
use crate::parameterisation::Operation;
use crate::planform::{Planform, PlanformTarget};
use crate::radial::{RadialScale, RadialTarget, taper};
use crate::rotation::Rotation;
use crate::sections::{Axes, SampledSurfaces};
use crate::translation::Translation;
use crate::variables::{DesignSpace, Variables, list};
use crate::{Dimension, ParameterisationError};

/// Stations at which a centre line or a quarter-chord line is tabulated.
const TABLE_STATIONS: usize = 512;

/// What a parameterisation is made of.
pub(crate) struct Compiled {
    pub(crate) design_space: DesignSpace,
    /// Each component's control points among the points.
    pub(crate) ranges: Vec<Range<usize>>,
    /// Reference control points, then the points carried along.
    pub(crate) points: Vec<Vector3>,
    pub(crate) operations: Vec<Operation>,
}

/// Compiles a declaration against the reference geometry.
pub(crate) fn compile(
    components: &[ComponentReference],
    variables: &[VariableDeclaration],
    operations: &[OperationDeclaration],
) -> Result<Compiled, ParameterisationError> {
    let (ranges, reference) = reference_points(components)?;
    let mut compiler = Compiler::new(components, ranges, reference, Variables::new(variables)?)?;
    compiler.carry_points(operations)?;
    let operations = operations
        .iter()
        .enumerate()
        .map(|(i, operation)| compiler.compile(i, operation))
        .collect::<Result<Vec<_>, _>>()?;
    let Compiler { ranges, points, variables, .. } = compiler;
    Ok(Compiled { design_space: variables.finish()?, ranges, points, operations })
}

/// Checks the reference geometry and lays its control points one component after the other.
fn reference_points(
    components: &[ComponentReference],
) -> Result<(Vec<Range<usize>>, Vec<Vector3>), ParameterisationError> {
    let mut points = Vec::new();
    let mut ranges = Vec::with_capacity(components.len());
    for (c, component) in components.iter().enumerate() {
        let start = points.len();
        for (p, patch) in component.patches.iter().enumerate() {
            let (n_u, n_v) = patch.surface.shape();
            let mismatch = |what, found| {
                Err(ParameterisationError::PatchSize {
                    component: c,
                    patch: p,
                    what,
                    found,
                    expected: n_u * n_v,
                })
            };
            if patch.control_points.len() != n_u * n_v {
                return mismatch("control points", patch.control_points.len());
            }
            if !patch.weights.is_empty() && patch.weights.len() != n_u * n_v {
                return mismatch("weights", patch.weights.len());
            }
            let field = |what| format!("components[{c}].patches[{p}].{what}");
            for (i, point) in patch.control_points.iter().enumerate() {
                if let Some(axis) = point.iter().position(|v| !v.is_finite()) {
                    return Err(ParameterisationError::NotFinite {
                        field: field(format!("control_points[{}][{}][{axis}]", i / n_v, i % n_v)),
                        value: point[axis],
                    });
                }
            }
            if let Some(i) = patch.weights.iter().position(|w| !w.is_finite()) {
                return Err(ParameterisationError::NotFinite {
                    field: field(format!("weights[{}][{}]", i / n_v, i % n_v)),
                    value: patch.weights[i],
                });
            }
            points.extend(patch.control_points.iter().map(|&p| Vector3::from(p)));
        }
        if points.len() == start {
            return Err(ParameterisationError::Empty { field: format!("components[{c}].patches") });
        }
        ranges.push(start..points.len());
    }
    Ok((ranges, points))
}

/// State while operations are compiled one by one.
struct Compiler<'a> {
    components: &'a [ComponentReference],
    /// The surfaces of each component alone, sampled for the first operation that asks.
    sampled: Vec<OnceCell<Rc<SampledSurfaces>>>,
    index: HashMap<&'a str, usize>,
    ranges: Vec<Range<usize>>,
    /// Reference control points, then the points carried along.
    points: Vec<Vector3>,
    variables: Variables<'a>,
    /// Points carried along with each component.
    carried: Vec<Vec<usize>>,
    /// The pivot of each operation that has one.
    pivots: Vec<Option<usize>>,
    /// Per operation and scaled point: its centre.
    centres: Vec<Vec<(usize, usize)>>,
}

impl<'a> Compiler<'a> {
    fn new(
        components: &'a [ComponentReference],
        ranges: Vec<Range<usize>>,
        points: Vec<Vector3>,
        variables: Variables<'a>,
    ) -> Result<Self, ParameterisationError> {
        let mut index = HashMap::new();
        for (i, component) in components.iter().enumerate() {
            if index.insert(component.name.as_str(), i).is_some() {
                return Err(ParameterisationError::DuplicateName {
                    field: format!("components[{i}].name"),
                    name: component.name.clone(),
                });
            }
        }
        let carried = vec![Vec::new(); components.len()];
        Ok(Self {
            components,
            sampled: components.iter().map(|_| OnceCell::new()).collect(),
            index,
            ranges,
            points,
            variables,
            carried,
            pivots: Vec::new(),
            centres: Vec::new(),
        })
    }

    /// Adds pivots and centre lines to the points, before any operation is compiled: each is moved by the operations
    /// declared before the one that needs it.
    fn carry_points(&mut self, operations: &[OperationDeclaration]) -> Result<(), ParameterisationError> {
        for (i, operation) in operations.iter().enumerate() {
            let members = self.members(i, operation)?;
            let pivot = match operation {
                OperationDeclaration::Rotation(r) => Some(self.pivot_point(i, members[0], r.pivot, true)?),
                OperationDeclaration::Planform(p) => {
                    let mut pivot = self.pivot_point(i, members[0], p.pivot, p.symmetric)?;
                    let root = self.root_quarter_chord(i, members[0], p.span, p.symmetric)?;
                    pivot[p.span.index()] = root[p.span.index()];
                    Some(pivot)
                }
                _ => None,
            };
            let carried = pivot.map(|point| self.carry(members[0], point));
            self.pivots.push(carried);
        }
        for (i, operation) in operations.iter().enumerate() {
            let mut centres = Vec::new();
            if let OperationDeclaration::RadialScale(r) = operation {
                let members = self.members(i, operation)?;
                // Centre lines of this operation need none of their own: they stay where they are.
                let scaled = self.targets(&members, None);
                let line = match r.centre {
                    CentreLine::Point(p) => Table::constant(finite(format!("operations[{i}].centre"), p)?),
                    CentreLine::Sections => {
                        let surfaces = self.surfaces(members[0]);
                        let (low, high) = surfaces.range(r.axis.index());
                        Table::new(low, high, |x| Some(surfaces.centre(r.axis.index(), x)))
                            .ok_or_else(|| geometry(i, "the body has no cross-sections along this axis"))?
                    }
                };
                let axis = r.axis.index();
                let mut at_station = BTreeMap::new();
                for point in scaled {
                    let station = self.points[point][axis];
                    let centre = *at_station.entry(station.to_bits()).or_insert_with(|| {
                        let mut centre = line.at(station);
                        centre[axis] = station;
                        self.carry(members[0], centre)
                    });
                    centres.push((point, centre));
                }
            }
            self.centres.push(centres);
        }
        Ok(())
    }

    fn surfaces(&self, component: usize) -> Rc<SampledSurfaces> {
        let sample = || Rc::new(SampledSurfaces::new(&[&self.components[component]]));
        Rc::clone(self.sampled[component].get_or_init(sample))
    }

    fn carry(&mut self, component: usize, point: Vector3) -> usize {
        self.points.push(point);
        self.carried[component].push(self.points.len() - 1);
        self.points.len() - 1
    }

    /// A pivot in reference coordinates, m.
    fn pivot_point(
        &self,
        operation: usize,
        component: usize,
        pivot: Pivot,
        symmetric: bool,
    ) -> Result<Vector3, ParameterisationError> {
        match pivot {
            Pivot::Point(point) => finite(format!("operations[{operation}].pivot"), point),
            Pivot::RootQuarterChord(span) => self.root_quarter_chord(operation, component, span, symmetric),
        }
    }

    fn root_quarter_chord(
        &self,
        operation: usize,
        component: usize,
        span: crate::Axis,
        symmetric: bool,
    ) -> Result<Vector3, ParameterisationError> {
        let axes = Axes::of_span(span);
        let surfaces = self.surfaces(component);
        let station = if symmetric { 0.0 } else { surfaces.range(axes.span).0 };
        let section = surfaces
            .section(axes, station, symmetric)
            .ok_or_else(|| geometry(operation, "the component has no root chord: is the span axis right?"))?;
        let mut point = Vector3::zeros();
        [point[axes.chord], point[axes.thickness]] = section.quarter_chord();
        point[axes.span] = station;
        Ok(point)
    }

    /// The components an operation names.
    fn members(
        &self,
        i: usize,
        operation: &OperationDeclaration,
    ) -> Result<Vec<usize>, ParameterisationError> {
        let names = match operation {
            OperationDeclaration::FreeForm(o) => &o.components,
            OperationDeclaration::Planform(o) => &o.components,
            OperationDeclaration::Rotation(o) => &o.components,
            OperationDeclaration::Translation(o) => &o.components,
            OperationDeclaration::RadialScale(o) => &o.components,
        };
        if names.is_empty() {
            return Err(ParameterisationError::Empty { field: format!("operations[{i}].components") });
        }
        let mut members = Vec::with_capacity(names.len());
        for (j, name) in names.iter().enumerate() {
            let field = format!("operations[{i}].components[{j}]");
            let Some(&member) = self.index.get(name.as_str()) else {
                let known: Vec<&str> = self.components.iter().map(|c| c.name.as_str()).collect();
                return Err(ParameterisationError::UnknownName {
                    field,
                    name: name.clone(),
                    known: list(&known),
                });
            };
            if members.contains(&member) {
                return Err(ParameterisationError::DuplicateName { field, name: name.clone() });
            }
            members.push(member);
        }
        Ok(members)
    }

    /// Control points of the members, then what is carried along with them, without `except`.
    fn targets(&self, members: &[usize], except: Option<usize>) -> Vec<usize> {
        let own = members.iter().flat_map(|&c| self.ranges[c].clone());
        let carried = members.iter().flat_map(|&c| self.carried[c].iter().copied());
        own.chain(carried.filter(|&p| Some(p) != except)).collect()
    }

    fn compile(
        &mut self,
        i: usize,
        operation: &OperationDeclaration,
    ) -> Result<Operation, ParameterisationError> {
        let members = self.members(i, operation)?;
        Ok(match operation {
            OperationDeclaration::FreeForm(d) => {
                Operation::FreeForm(Box::new(self.free_form(i, d, &members)?))
            }
            OperationDeclaration::Planform(d) => Operation::Planform(self.planform(i, d, &members)?),
            OperationDeclaration::Rotation(d) => Operation::Rotation(self.rotation(i, d, &members)?),
            OperationDeclaration::Translation(d) => Operation::Translation(self.translation(i, d, &members)?),
            OperationDeclaration::RadialScale(d) => Operation::RadialScale(self.radial_scale(i, d)?),
        })
    }

    fn pivot(&self, i: usize) -> usize {
        self.pivots[i].unwrap_or_default()
    }

    fn translation(
        &mut self,
        i: usize,
        declaration: &TranslationDeclaration,
        members: &[usize],
    ) -> Result<Translation, ParameterisationError> {
        Ok(Translation {
            targets: self.targets(members, None),
            direction: unit(i, "direction", declaration.direction)?,
            length: self.variables.additive_scalar(
                &format!("operations[{i}].variable"),
                &declaration.variable,
                Dimension::Length,
            )?,
        })
    }

    fn rotation(
        &mut self,
        i: usize,
        declaration: &RotationDeclaration,
        members: &[usize],
    ) -> Result<Rotation, ParameterisationError> {
        let pivot = self.pivot(i);
        Ok(Rotation {
            targets: self.targets(members, Some(pivot)),
            axis: unit(i, "axis", declaration.axis)?,
            pivot,
            angle: self.variables.additive_scalar(
                &format!("operations[{i}].variable"),
                &declaration.variable,
                Dimension::Angle,
            )?,
        })
    }

    fn radial_scale(
        &mut self,
        i: usize,
        declaration: &RadialScaleDeclaration,
    ) -> Result<RadialScale, ParameterisationError> {
        for (s, &station) in declaration.stations.iter().enumerate() {
            let field = format!("operations[{i}].stations[{s}]");
            if !station.is_finite() {
                return Err(ParameterisationError::NotFinite { field, value: station });
            }
            if s > 0 && station < declaration.stations[s - 1] {
                return Err(ParameterisationError::Geometry {
                    field,
                    reason: format!(
                        "{station} is before station {}, {}; stations must not decrease",
                        s - 1,
                        declaration.stations[s - 1]
                    ),
                });
            }
        }
        let axis = declaration.axis.index();
        let targets = self.centres[i]
            .iter()
            .map(|&(point, centre)| RadialTarget {
                point,
                centre,
                taper: taper(&declaration.stations, self.points[point][axis]),
            })
            .filter(|t| t.taper != 0.0)
            .collect();
        let ratio = self.variables.relative(
            &format!("operations[{i}].variable"),
            &declaration.variable,
            &[Dimension::Ratio, Dimension::Length],
            |dimension| (dimension == Dimension::Ratio).then_some(1.0),
        )?;
        Ok(RadialScale { targets, ratio })
    }

    fn planform(
        &mut self,
        i: usize,
        declaration: &PlanformDeclaration,
        members: &[usize],
    ) -> Result<Planform, ParameterisationError> {
        if declaration.area.is_none() && declaration.aspect_ratio.is_none() {
            return Err(ParameterisationError::Empty {
                field: format!("operations[{i}].area and .aspect_ratio"),
            });
        }
        let axes = Axes::of_span(declaration.span);
        let surfaces = self.surfaces(members[0]);
        let (area, aspect_ratio) = surfaces
            .planform(axes, declaration.symmetric)
            .ok_or_else(|| geometry(i, "the component has no planform: is the span axis right?"))?;
        let area = declaration
            .area
            .as_ref()
            .map(|name| {
                let field = format!("operations[{i}].area");
                self.variables.relative(&field, name, &[Dimension::Area], |_| Some(area))
            })
            .transpose()?;
        let aspect_ratio = declaration
            .aspect_ratio
            .as_ref()
            .map(|name| {
                let field = format!("operations[{i}].aspect_ratio");
                self.variables.relative(&field, name, &[Dimension::Ratio], |_| Some(aspect_ratio))
            })
            .transpose()?;
        let pivot = self.pivot(i);
        let root = self.root_quarter_chord(i, members[0], declaration.span, declaration.symmetric)?;
        let kept = match declaration.sweep {
            SweepRule::Scaled => None,
            SweepRule::Kept => {
                let (low, high) = surfaces.range(axes.span);
                let mirrored = declaration.symmetric;
                let (start, end) = if mirrored { (0.0, low.abs().max(high.abs())) } else { (low, high) };
                let table = Table::new(start, end, |y| {
                    let quarter_chord = surfaces.section(axes, y, mirrored)?.quarter_chord();
                    let mut offset = Vector3::zeros();
                    offset[axes.chord] = quarter_chord[0] - root[axes.chord];
                    offset[axes.thickness] = quarter_chord[1] - root[axes.thickness];
                    Some(offset)
                });
                Some(table.ok_or_else(|| geometry(i, "a section has no chord: is the span axis right?"))?)
            }
        };
        let axis_offset = |point: usize| {
            let station = self.points[point][axes.span];
            let station = if declaration.symmetric { station.abs() } else { station };
            kept.as_ref().map_or_else(Vector3::zeros, |table| table.at(station))
        };
        let targets = self.targets(members, Some(pivot)).into_iter();
        let targets =
            targets.map(|point| PlanformTarget { point, axis_offset: axis_offset(point) }).collect();
        Ok(Planform { targets, pivot, span: axes.span, area, aspect_ratio })
    }

    fn free_form(
        &mut self,
        i: usize,
        declaration: &FreeFormDeclaration,
        members: &[usize],
    ) -> Result<FreeForm, ParameterisationError> {
        if declaration.sections.is_empty() {
            return Err(ParameterisationError::Empty { field: format!("operations[{i}].sections") });
        }
        let embedded: Vec<&ComponentReference> = members.iter().map(|&c| &self.components[c]).collect();
        let count = members.iter().map(|&c| self.ranges[c].len()).sum();
        let mut block = FreeForm::new(
            &format!("operations[{i}]"),
            declaration,
            &SampledSurfaces::new(&embedded),
            &self.points,
            self.targets(members, None),
            count,
        )?;
        for (s, section) in declaration.sections.iter().enumerate() {
            let field = format!("operations[{i}].sections[{s}]");
            self.influences(&field, declaration, section, &mut block)?;
        }
        Ok(block)
    }

    /// Adds one section-level function to a block: coefficients times the basis at each section.
    fn influences(
        &mut self,
        field: &str,
        block: &FreeFormDeclaration,
        section: &SectionDeclaration,
        compiled: &mut FreeForm,
    ) -> Result<(), ParameterisationError> {
        let axes = Axes::of_span(block.span);
        let variable_field = format!("{field}.variable");
        let dimension = match section.kind {
            SectionKind::ChordStretch { .. } | SectionKind::Camber { .. } | SectionKind::Thickness { .. } => {
                Dimension::Ratio
            }
            SectionKind::SpanStretch | SectionKind::Sweep | SectionKind::Dihedral => Dimension::Length,
            SectionKind::Twist => Dimension::Angle,
        };
        let rows = match &section.kind {
            SectionKind::Camber { rows } | SectionKind::Thickness { rows } => {
                Some(lattice_rows(field, block, rows)?)
            }
            _ => None,
        };
        let shape = self.variables.shape(&variable_field, &section.variable)?;
        let stations = match (&rows, shape) {
            (None, [stations]) => *stations,
            (Some(rows), [n, stations]) if *n == rows.len() => *stations,
            (None, _) => {
                let expected = "one number per station along the span: [stations]".into();
                return Err(self.variables.wrong_shape(&variable_field, &section.variable, expected));
            }
            (Some(rows), _) => {
                let expected = format!("[{}, stations], one row per lattice row moved", rows.len());
                return Err(self.variables.wrong_shape(&variable_field, &section.variable, expected));
            }
        };
        let channel = self.variables.additive(&variable_field, &section.variable, dimension)?;
        // The root coefficient of a mirrored span stretch is zero and no variable.
        let fixed = usize::from(block.symmetric && section.kind == SectionKind::SpanStretch);
        let function = SpanFunction::new(&format!("{field}.degree"), section.degree, stations + fixed)?;
        let reach = compiled.stations().iter().fold(0.0, |m: f64, y| m.max(y.abs()));
        let start = compiled.stations().first().copied().unwrap_or_default();
        let end = compiled.stations().last().copied().unwrap_or_default();
        for (k, station) in compiled.stations().to_vec().into_iter().enumerate() {
            let eta = if block.symmetric { station.abs() / reach } else { (station - start) / (end - start) };
            let side = if block.symmetric && station < 0.0 { -1.0 } else { 1.0 };
            for (m, weight) in function.at(eta) {
                let Some(m) = m.checked_sub(fixed) else { continue };
                let mut push = |slot: usize, coefficient: usize, weight: f64| {
                    let slot = k * compiled.slots() + slot;
                    compiled.influences.push(influence(&channel, slot, coefficient, weight));
                };
                match &section.kind {
                    SectionKind::ChordStretch { scales_thickness } => {
                        push(freeform::STRETCH, m, weight);
                        if *scales_thickness {
                            push(freeform::THICKNESS_STRETCH, m, weight);
                        }
                    }
                    SectionKind::SpanStretch => push(freeform::SHIFT + axes.span, m, side * weight),
                    SectionKind::Sweep => push(freeform::SHIFT + axes.chord, m, weight),
                    SectionKind::Dihedral => push(freeform::SHIFT + axes.thickness, m, weight),
                    SectionKind::Twist => push(freeform::TWIST, m, weight),
                    SectionKind::Camber { .. } | SectionKind::Thickness { .. } => {
                        let thickness = matches!(section.kind, SectionKind::Thickness { .. });
                        let first = freeform::CAMBER + if thickness { block.shape[0] } else { 0 };
                        for (r, &row) in rows.iter().flatten().enumerate() {
                            push(first + row, r * stations + m, weight);
                        }
                    }
                }
            }
        }
        Ok(())
    }
}

fn influence(channel: &Additive, slot: usize, coefficient: usize, weight: f64) -> Influence {
    Influence {
        slot,
        variable: channel.range.start + coefficient,
        baseline: channel.baseline,
        weight: weight * channel.si,
    }
}

/// The lattice rows that camber or thickness moves: those given, or all but the outermost.
fn lattice_rows(
    field: &str,
    block: &FreeFormDeclaration,
    rows: &[usize],
) -> Result<Vec<usize>, ParameterisationError> {
    let count = block.shape[0];
    for (r, &row) in rows.iter().enumerate() {
        if row >= count {
            return Err(ParameterisationError::OutOfRange {
                field: format!("{field}.rows[{r}]"),
                value: row,
                lowest: 0,
                highest: count - 1,
            });
        }
        if rows[..r].contains(&row) {
            return Err(ParameterisationError::DuplicateName {
                field: format!("{field}.rows[{r}]"),
                name: row.to_string(),
            });
        }
    }
    if !rows.is_empty() {
        return Ok(rows.to_vec());
    }
    if count < 3 {
        return Err(ParameterisationError::OutOfRange {
            field: format!("{field}: lattice rows along the chord (or give rows)"),
            value: count,
            lowest: 3,
            highest: usize::MAX,
        });
    }
    Ok((1..count - 1).collect())
}

/// A B-spline function on [0, 1], or a constant with a single coefficient.
struct SpanFunction {
    knots: Option<KnotVector>,
}

impl SpanFunction {
    fn new(field: &str, degree: usize, coefficients: usize) -> Result<Self, ParameterisationError> {
        if degree == 0 && coefficients == 1 {
            return Ok(Self { knots: None });
        }
        let knots = KnotVector::clamped_uniform(degree, coefficients)
            .map_err(|source| ParameterisationError::Knots { field: field.into(), source })?;
        Ok(Self { knots: Some(knots) })
    }

    /// Coefficients that matter at `eta`, with their weights.
    fn at(&self, eta: f64) -> Vec<(usize, f64)> {
        match &self.knots {
            None => vec![(0, 1.0)],
            Some(knots) => {
                let basis = knots.basis(eta, 0);
                basis.value().iter().enumerate().map(|(m, &w)| (basis.first + m, w)).collect()
            }
        }
    }
}

/// A curve tabulated along an axis, linear between stations and constant beyond.
struct Table {
    start: f64,
    end: f64,
    values: Vec<Vector3>,
}

impl Table {
    fn constant(value: Vector3) -> Self {
        Self { start: 0.0, end: 1.0, values: vec![value; 2] }
    }

    fn new(start: f64, end: f64, value: impl Fn(f64) -> Option<Vector3>) -> Option<Self> {
        let station = |i: usize| start + (end - start) * (i as f64 / TABLE_STATIONS as f64);
        let values = (0..=TABLE_STATIONS).map(|i| value(station(i))).collect::<Option<Vec<_>>>()?;
        (end > start).then_some(Self { start, end, values })
    }

    fn at(&self, x: f64) -> Vector3 {
        let intervals = self.values.len() - 1;
        let s = ((x - self.start) / (self.end - self.start)).clamp(0.0, 1.0) * intervals as f64;
        let i = (s as usize).min(intervals - 1);
        self.values[i].lerp(&self.values[i + 1], s - i as f64)
    }
}

fn geometry(operation: usize, reason: &str) -> ParameterisationError {
    ParameterisationError::Geometry { field: format!("operations[{operation}]"), reason: reason.into() }
}

fn finite(field: String, point: [f64; 3]) -> Result<Vector3, ParameterisationError> {
    match point.iter().position(|v| !v.is_finite()) {
        Some(axis) => {
            Err(ParameterisationError::NotFinite { field: format!("{field}[{axis}]"), value: point[axis] })
        }
        None => Ok(Vector3::from(point)),
    }
}

fn unit(operation: usize, what: &str, direction: [f64; 3]) -> Result<Vector3, ParameterisationError> {
    let vector = finite(format!("operations[{operation}].{what}"), direction)?;
    // Scaled by the largest entry first, so that no norm over- or underflows.
    let largest = vector.amax();
    if largest == 0.0 {
        return Err(ParameterisationError::Geometry {
            field: format!("operations[{operation}].{what}"),
            reason: "is the zero vector; give a direction".into(),
        });
    }
    Ok((vector / largest).normalize())
}
