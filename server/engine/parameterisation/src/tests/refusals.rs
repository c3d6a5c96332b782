use super::*;

type Error = ParameterisationError;

fn refused(
    components: &[ComponentReference],
    variables: &[VariableDeclaration],
    operations: &[OperationDeclaration],
) -> String {
    Parameterisation::new(components, variables, operations).expect_err("must be refused").to_string()
}

fn wing_error(variables: &[VariableDeclaration], operations: &[OperationDeclaration]) -> String {
    refused(&[tapered_wing()], variables, operations)
}

fn slide() -> OperationDeclaration {
    translation("wing", [1.0, 0.0, 0.0], "t")
}

fn metres() -> VariableDeclaration {
    variable("t", &[], Unit::Metre)
}

#[test]
fn geometry_that_does_not_fit() {
    let mut wing = tapered_wing();
    wing.patches[1].control_points.pop();
    let error = Parameterisation::new(&[wing], &[], &[]).expect_err("a point is missing");
    assert_eq!(
        error,
        Error::PatchSize { component: 0, patch: 1, what: "control points", found: 24, expected: 25 }
    );

    let mut wing = tapered_wing();
    wing.patches[0].weights = vec![1.0; 3];
    let error = Parameterisation::new(&[wing], &[], &[]).expect_err("weights are missing");
    assert_eq!(error.to_string(), "components[0].patches[0]: 3 weights, expected 25");

    let mut wing = tapered_wing();
    wing.patches[1].control_points[7][2] = f64::NAN;
    let text = refused(&[wing], &[], &[]);
    assert_eq!(text, "components[0].patches[1].control_points[1][2][2] = NaN is not finite");

    let empty = ComponentReference { name: "ghost".into(), patches: vec![] };
    assert_eq!(refused(&[empty], &[], &[]), "components[0].patches is empty");
    let text = refused(&[tapered_wing(), tapered_wing()], &[], &[]);
    assert_eq!(text, "components[1].name: the name 'wing' is already taken; names must be unique");
}

#[test]
fn names_that_lead_nowhere() {
    assert_eq!(
        wing_error(&[metres()], &[translation("tail", [1.0, 0.0, 0.0], "t")]),
        "operations[0].components[0] = 'tail' does not exist; there are: wing"
    );
    assert_eq!(
        wing_error(&[metres()], &[slide(), translation("wing", [1.0, 0.0, 0.0], "dx")]),
        "operations[1].variable = 'dx' does not exist; there are: t"
    );
    assert_eq!(
        wing_error(&[metres(), variable("u", &[], Unit::Metre)], &[slide()]),
        "variables[1] 'u' is used by no operation; use it or remove it"
    );
    assert_eq!(
        wing_error(&[metres(), metres()], &[slide()]),
        "variables[1].name: the name 't' is already taken; names must be unique"
    );
}

#[test]
fn units_shapes_and_bounds() {
    assert_eq!(
        wing_error(&[variable("t", &[], Unit::Degree)], &[slide()]),
        "operations[0].variable: variable 't' is in deg, but this operation takes a length (m, ft)"
    );
    assert_eq!(
        wing_error(&[variable("t", &[3], Unit::Metre)], &[slide()]),
        "operations[0].variable: variable 't' has shape [3], but this operation takes a scalar (no shape)"
    );
    let camber = [exact_block(vec![section(SectionKind::Camber { rows: vec![] }, "c", 1)])];
    assert_eq!(
        wing_error(&[variable("c", &[5, 3], Unit::Percent)], &camber),
        "operations[0].sections[0].variable: variable 'c' has shape [5, 3], but this operation takes [4, stations], \
         one row per lattice row moved"
    );
    assert_eq!(
        wing_error(&[VariableDeclaration { lower: 1.0, upper: 2.0, ..metres() }], &[slide()]),
        "variables[0] 't': baseline 0 is outside its bounds 1..2 m"
    );
    assert_eq!(
        wing_error(&[VariableDeclaration { lower: f64::NAN, ..metres() }], &[slide()]),
        "variables[0].lower = NaN is not finite"
    );
    assert_eq!(
        wing_error(&[VariableDeclaration { baseline: Some(f64::INFINITY), ..metres() }], &[slide()]),
        "variables[0].baseline = inf is not finite"
    );
}

#[test]
fn empty_and_huge_counts() {
    let huge = wing_error(&[variable("t", &[usize::MAX, usize::MAX], Unit::Metre)], &[slide()]);
    assert!(huge.starts_with("variables[0].shape[0] = 18446744073709551615 is outside 1..="), "{huge}");
    assert!(
        wing_error(&[variable("t", &[0], Unit::Metre)], &[slide()]).starts_with("variables[0].shape[0] = 0")
    );
    let twist = |shape, degree, n: usize| {
        let block = FreeFormDeclaration {
            components: vec!["wing".into()],
            span: Axis::Y,
            symmetric: true,
            shape,
            degree,
            sections: vec![section(SectionKind::Twist, "v", 3)],
        };
        wing_error(&[variable("v", &[n], Unit::Degree)], &[OperationDeclaration::FreeForm(block)])
    };
    let text = twist([1 << 40, 1 << 40, 2], [3, 3, 1], 4);
    assert!(text.starts_with("operations[0].shape (product) = 18446744073709551615 is outside"), "{text}");
    assert!(twist([0, 5, 2], [3, 3, 1], 4).starts_with("operations[0].shape (product) = 0"));
    assert!(twist([3, 5, 2], [3, 3, 1], 4).starts_with("operations[0].shape[0]: "));
    assert!(twist([4, 5, 2], [3, 3, 1], 3).starts_with("operations[0].sections[0].degree: "));
    assert!(twist([40, 50, 20], [30, 3, 1], 4).starts_with("operations[0].shape[0]: degree 30"));
    let none = exact_block(vec![]);
    assert_eq!(wing_error(&[], &[none]), "operations[0].sections is empty");
    let nobody = OperationDeclaration::Translation(TranslationDeclaration {
        components: vec![],
        direction: [1.0, 0.0, 0.0],
        variable: "t".into(),
    });
    assert_eq!(wing_error(&[metres()], &[nobody]), "operations[0].components is empty");
}

#[test]
fn camber_rows_that_are_not_there() {
    let error = |rows: Vec<usize>, n: usize| {
        let block = exact_block(vec![section(SectionKind::Camber { rows }, "c", 0)]);
        wing_error(&[variable("c", &[n, 1], Unit::One)], &[block])
    };
    assert_eq!(error(vec![2, 6], 2), "operations[0].sections[0].rows[1] = 6 is outside 0..=5");
    assert!(
        error(vec![2, 2], 2).starts_with("operations[0].sections[0].rows[1]: the name '2' is already taken")
    );
}

#[test]
fn directions_and_stations_without_meaning() {
    assert_eq!(
        wing_error(&[metres()], &[translation("wing", [0.0; 3], "t")]),
        "operations[0].direction: is the zero vector; give a direction"
    );
    assert_eq!(
        wing_error(&[metres()], &[translation("wing", [0.0, f64::NAN, 0.0], "t")]),
        "operations[0].direction[1] = NaN is not finite"
    );
    let angle = variable("a", &[], Unit::Degree);
    assert_eq!(
        wing_error(&[angle], &[rotation("wing", Pivot::Point([0.0, 0.0, f64::INFINITY]), "a")]),
        "operations[0].pivot[2] = inf is not finite"
    );
    let body = |stations, v| refused(&[box_body()], &[v], &[radial(stations, CentreLine::Sections, "r")]);
    assert_eq!(
        body([0.0, 3.0, 2.0, 9.0], variable("r", &[], Unit::One)),
        "operations[0].stations[2]: 2 is before station 1, 3; stations must not decrease"
    );
    assert_eq!(
        body([0.0, f64::NAN, 2.0, 9.0], variable("r", &[], Unit::One)),
        "operations[0].stations[1] = NaN is not finite"
    );
    let text = body([0.0, 1.0, 2.0, 9.0], variable("r", &[], Unit::Metre));
    assert!(text.starts_with("operations[0].variable: variable 'r' needs an explicit baseline"), "{text}");
    let negative = VariableDeclaration { baseline: Some(-3.0), ..variable("r", &[], Unit::Metre) };
    let text = body([0.0, 1.0, 2.0, 9.0], negative);
    assert!(text.contains("relative to its baseline, which is -3; it must be positive"), "{text}");
}

#[test]
fn a_planform_across_the_wrong_axis() {
    // A flat plate has no extent along z.
    let mut plate = tapered_wing();
    for patch in &mut plate.patches {
        for p in &mut patch.control_points {
            p[2] = 0.0;
        }
    }
    let planform = OperationDeclaration::Planform(PlanformDeclaration {
        components: vec!["wing".into()],
        span: Axis::Z,
        symmetric: false,
        pivot: Pivot::RootQuarterChord(Axis::Z),
        area: Some("S".into()),
        aspect_ratio: None,
        sweep: SweepRule::Scaled,
    });
    let text = refused(&[plate], &[variable("S", &[], Unit::SquareMetre)], &[planform]);
    assert!(text.starts_with("operations[0]: the component has no"), "{text}");
}

#[test]
fn variables_with_two_natural_baselines() {
    let variables = [variable("A", &[], Unit::One), variable("S", &[], Unit::SquareMetre)];
    let scale = radial([0.0, 1.0, 2.0, 3.0], CentreLine::Sections, "A");
    let text = refused(&[tapered_wing(), box_body()], &variables, &[planform(SweepRule::Scaled), scale]);
    assert!(text.contains("different natural baselines"), "{text}");
}

#[test]
fn designs() {
    let p = everything();
    let n = p.variables().len();
    assert_eq!(p.control_points(&[0.0; 3]), Err(DesignError::Length { expected: n, found: 3 }));
    assert!(p.linearise(&[]).is_err());
    let mut design = p.baseline();
    design[5] = f64::NAN;
    let text = p.validate(&design).expect_err("NaN").to_string();
    assert_eq!(text, "design[5] ('wing.camber[0][1]') = NaN is not finite");
    assert!(p.control_points(&design).is_err());
    let area = p.index("S").expect("exists");
    let mut design = p.baseline();
    design[area] = 601.0;
    let text = p.validate(&design).expect_err("out of bounds").to_string();
    assert_eq!(text, format!("design[{area}] ('S') = 601 is outside its bounds 100..600 ft^2"));
    // Bounds are for the caller to enforce, meaning is not.
    assert!(p.control_points(&design).is_ok());
    design[area] = -1.0;
    let text = p.control_points(&design).expect_err("no such wing").to_string();
    assert_eq!(text, format!("design[{area}] ('S') = -1 must be positive"));
    assert!(p.validate(&p.baseline()).is_ok());
}

#[test]
fn unknown_design_names_come_with_a_suggestion() {
    let p = everything();
    let text = p.design([("wing.twsit[2]", 1.0)]).expect_err("misspelt").to_string();
    assert_eq!(text, "there is no design variable 'wing.twsit[2]'; did you mean 'wing.twist[2]'?");
    let text = p.index("engine.thrust").expect_err("no such thing").to_string();
    assert_eq!(text, "there is no design variable 'engine.thrust'");
}

#[test]
fn overrides() {
    let p = everything();
    let design = p.baseline();
    let with = |component, control_points| {
        p.control_points_with(&design, &[Override { component, control_points }])
            .expect_err("must be refused")
    };
    assert_eq!(with(1, vec![]), DesignError::OverrideSize { component: 1, found: 0, expected: 35 });
    assert_eq!(with(9, vec![]), DesignError::OverrideSize { component: 9, found: 0, expected: 0 });
    let mut points = reference(&box_body());
    points[4][1] = f64::INFINITY;
    let text = with(1, points).to_string();
    assert_eq!(text, "override of component 1: control_points[4][1] = inf is not finite");
}
