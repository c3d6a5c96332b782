//! Each operation against its closed form, derivatives against differences, and everything that must be refused.

mod derivatives;
mod operations;
mod refusals;

use crate::testing::{box_body, tapered_wing};
use crate::*;
use moldline_testing::Random;

fn variable(name: &str, shape: &[usize], unit: Unit) -> VariableDeclaration {
    VariableDeclaration {
        name: name.into(),
        shape: shape.to_vec(),
        unit,
        baseline: None,
        lower: f64::NEG_INFINITY,
        upper: f64::INFINITY,
    }
}

fn section(kind: SectionKind, variable: &str, degree: usize) -> SectionDeclaration {
    SectionDeclaration { kind, variable: variable.into(), degree }
}

/// A block around the tapered wing that reproduces its kinked planform exactly: degree 1 along the span, with a
/// section at the root.
fn exact_block(sections: Vec<SectionDeclaration>) -> OperationDeclaration {
    OperationDeclaration::FreeForm(FreeFormDeclaration {
        components: vec!["wing".into()],
        span: Axis::Y,
        symmetric: true,
        shape: [6, 7, 2],
        degree: [3, 1, 1],
        sections,
    })
}

fn translation(component: &str, direction: [f64; 3], variable: &str) -> OperationDeclaration {
    OperationDeclaration::Translation(TranslationDeclaration {
        components: vec![component.into()],
        direction,
        variable: variable.into(),
    })
}

fn rotation(component: &str, pivot: Pivot, variable: &str) -> OperationDeclaration {
    OperationDeclaration::Rotation(RotationDeclaration {
        components: vec![component.into()],
        axis: [0.0, 2.0, 0.0],
        pivot,
        variable: variable.into(),
    })
}

fn radial(stations: [f64; 4], centre: CentreLine, variable: &str) -> OperationDeclaration {
    OperationDeclaration::RadialScale(RadialScaleDeclaration {
        components: vec!["body".into()],
        axis: Axis::X,
        centre,
        stations,
        variable: variable.into(),
    })
}

fn planform(sweep: SweepRule) -> OperationDeclaration {
    planform_about(Pivot::RootQuarterChord(Axis::Y), sweep)
}

fn planform_about(pivot: Pivot, sweep: SweepRule) -> OperationDeclaration {
    OperationDeclaration::Planform(PlanformDeclaration {
        components: vec!["wing".into()],
        span: Axis::Y,
        symmetric: true,
        pivot,
        area: Some("S".into()),
        aspect_ratio: Some("A".into()),
        sweep,
    })
}

fn reference(component: &ComponentReference) -> Vec<[f64; 3]> {
    component.patches.iter().flat_map(|p| p.control_points.clone()).collect()
}

/// The component with other control points.
fn with_points(component: &ComponentReference, points: &[[f64; 3]]) -> ComponentReference {
    let mut result = component.clone();
    let mut rest = points;
    for patch in &mut result.patches {
        let (own, others) = rest.split_at(patch.control_points.len());
        patch.control_points.copy_from_slice(own);
        rest = others;
    }
    result
}

/// The largest distance between corresponding points.
fn distance(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(p, q)| (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>().sqrt())
        .fold(0.0, f64::max)
}

fn map(points: &[[f64; 3]], f: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<[f64; 3]> {
    points.iter().map(|&p| f(p)).collect()
}

/// Wing and body with every kind of operation, in mixed units.
fn everything() -> Parameterisation {
    let variables = [
        variable("wing.twist", &[4], Unit::Degree),
        variable("wing.camber", &[4, 3], Unit::Percent),
        variable("wing.thickness", &[2, 1], Unit::One),
        variable("wing.chord", &[3], Unit::One),
        variable("wing.stretch", &[2], Unit::Foot),
        variable("wing.sweep", &[3], Unit::Metre),
        variable("wing.dihedral", &[2], Unit::Metre),
        VariableDeclaration { lower: 100.0, upper: 600.0, ..variable("S", &[], Unit::SquareFoot) },
        variable("A", &[], Unit::One),
        variable("wing.rotation", &[], Unit::Degree),
        variable("wing.translation", &[], Unit::Foot),
        VariableDeclaration { baseline: Some(9.84), ..variable("body.diameter", &[], Unit::Foot) },
        variable("body.pitch", &[], Unit::Radian),
        variable("lift", &[], Unit::Metre),
    ];
    let sections = vec![
        section(SectionKind::Twist, "wing.twist", 3),
        section(SectionKind::Camber { rows: vec![] }, "wing.camber", 2),
        section(SectionKind::Thickness { rows: vec![4, 1] }, "wing.thickness", 0),
        section(SectionKind::ChordStretch { scales_thickness: true }, "wing.chord", 2),
        section(SectionKind::SpanStretch, "wing.stretch", 1),
        section(SectionKind::Sweep, "wing.sweep", 1),
        section(SectionKind::Dihedral, "wing.dihedral", 1),
    ];
    let block = FreeFormDeclaration {
        components: vec!["wing".into()],
        span: Axis::Y,
        symmetric: true,
        shape: [6, 8, 3],
        degree: [3, 2, 2],
        sections,
    };
    let lift = TranslationDeclaration {
        components: vec!["body".into(), "wing".into()],
        direction: [0.0, 0.0, 1.0],
        variable: "lift".into(),
    };
    let operations = [
        OperationDeclaration::FreeForm(block),
        OperationDeclaration::Translation(lift),
        planform(SweepRule::Kept),
        rotation("wing", Pivot::RootQuarterChord(Axis::Y), "wing.rotation"),
        translation("wing", [3.0, 0.0, 4.0], "wing.translation"),
        rotation("body", Pivot::Point([1.0, 0.0, 0.5]), "body.pitch"),
        radial([1.0, 3.0, 6.0, 9.5], CentreLine::Sections, "body.diameter"),
    ];
    Parameterisation::new(&[tapered_wing(), box_body()], &variables, &operations).expect("is valid")
}

/// A deterministic sequence of numbers in -1..1.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut random = Random::new(seed);
    move || random.signed()
}

/// A design some way from the baseline: angles in degrees, lengths in feet and so on make one size fit all, except
/// for what multiplies.
fn random_design(parameterisation: &Parameterisation, seed: u64) -> Vec<f64> {
    let mut next = noise(seed);
    parameterisation
        .variables()
        .iter()
        .map(|v| {
            let size = match v.unit {
                Unit::Degree | Unit::Percent => 5.0,
                _ if v.baseline != 0.0 => 0.2 * v.baseline,
                _ => 0.3,
            };
            v.baseline + size * next()
        })
        .collect()
}
