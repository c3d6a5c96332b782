use super::*;
use moldline_spline::{KnotVector, Vector3, Volume};

fn build(
    components: &[ComponentReference],
    variables: &[VariableDeclaration],
    operations: &[OperationDeclaration],
) -> Parameterisation {
    Parameterisation::new(components, variables, operations).expect("is valid")
}

/// One wing block with one section function; its control points with all coefficients at the given values.
fn deformed_wing(
    kind: SectionKind,
    unit: Unit,
    degree: usize,
    shape: &[usize],
    values: &[f64],
) -> Vec<[f64; 3]> {
    let p = build(
        &[tapered_wing()],
        &[variable("v", shape, unit)],
        &[exact_block(vec![section(kind, "v", degree)])],
    );
    p.control_points(values).expect("acceptable").remove(0)
}

/// Local chord and quarter-chord point of the tapered wing.
fn chord_and_axis(y: f64) -> (f64, [f64; 2]) {
    let chord = 4.0 - 0.4 * y.abs();
    (chord, [1.0 + 0.5 * y.abs() + 0.25 * chord, 0.1 * y.abs()])
}

#[test]
fn baseline_is_the_reference_bit_by_bit() {
    let mut wing = tapered_wing();
    wing.patches[0].control_points[7][2] = -0.0;
    let p = everything();
    let (variables, names): (Vec<_>, Vec<_>) =
        p.variables().iter().map(|v| (v.baseline, v.name.as_str())).unzip();
    assert_eq!(names.len(), 4 + 12 + 2 + 3 + 2 + 3 + 2 + 7);
    assert_eq!(variables, p.baseline());
    let points = p.control_points(&p.baseline()).expect("acceptable");
    let bits = |points: &[[f64; 3]]| -> Vec<u64> { points.iter().flatten().map(|v| v.to_bits()).collect() };
    assert_eq!(bits(&points[0]), bits(&reference(&tapered_wing())));
    assert_eq!(bits(&points[1]), bits(&reference(&box_body())));
    // A negative zero is kept as well.
    let p = build(
        &[wing.clone()],
        &[variable("v", &[], Unit::Metre)],
        &[translation("wing", [0.0, 0.0, 1.0], "v")],
    );
    assert_eq!(bits(&p.control_points(&[0.0]).expect("acceptable")[0]), bits(&reference(&wing)));
}

#[test]
fn names_shapes_and_order_of_the_design_vector() {
    let p = everything();
    assert_eq!(p.variables()[0].name, "wing.twist[0]");
    assert_eq!(p.index("wing.camber[2][1]").expect("exists"), 4 + 2 * 3 + 1);
    assert_eq!(p.groups()[1], Group { name: "wing.camber".into(), shape: vec![4, 3], range: 4..16 });
    let design = p.design([("wing.twist[2]", 1.5), ("lift", -2.0)]).expect("known names");
    assert_eq!(design[2], 1.5);
    assert_eq!(design[p.index("lift").expect("exists")], -2.0);
    assert_eq!(design[p.index("body.diameter").expect("exists")], 9.84);
}

#[test]
fn translation_in_feet_along_a_direction() {
    let p = build(
        &[tapered_wing()],
        &[variable("t", &[], Unit::Foot)],
        &[translation("wing", [3.0, 0.0, 4.0], "t")],
    );
    let points = p.control_points(&[10.0]).expect("acceptable");
    // Ten feet along (0.6, 0, 0.8).
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [x + 1.8288, y, z + 2.4384]);
    assert!(distance(&points[0], &expected) < 1e-14);
}

#[test]
fn rotation_is_nose_up_about_the_root_quarter_chord() {
    let angle = [variable("a", &[], Unit::Degree)];
    let p = build(&[tapered_wing()], &angle, &[rotation("wing", Pivot::RootQuarterChord(Axis::Y), "a")]);
    let points = p.control_points(&[30.0]).expect("acceptable");
    // Root chord from x = 1 to 5: the axis is at x = 2, z = 0.
    let (s, c) = (0.5, f64::sqrt(0.75));
    let expected =
        map(&reference(&tapered_wing()), |[x, y, z]| [2.0 + c * (x - 2.0) + s * z, y, c * z - s * (x - 2.0)]);
    assert!(distance(&points[0], &expected) < 1e-7);
    let by_point = build(&[tapered_wing()], &angle, &[rotation("wing", Pivot::Point([2.0, 9.0, 0.0]), "a")]);
    assert!(distance(&by_point.control_points(&[30.0]).expect("acceptable")[0], &expected) < 1e-14);
    // A quarter turn takes the aft direction down.
    let quarter = by_point.control_points(&[90.0]).expect("acceptable");
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [2.0 + z, y, 2.0 - x]);
    assert!(distance(&quarter[0], &expected) < 1e-14);
}

#[test]
fn the_pivot_moves_with_what_was_declared_before_it() {
    let variables = [variable("t", &[], Unit::Metre), variable("a", &[], Unit::Degree)];
    let slide = || translation("wing", [1.0, 0.0, 0.0], "t");
    let turn = || rotation("wing", Pivot::Point([2.0, 0.0, 0.0]), "a");
    let slide_first = build(&[tapered_wing()], &variables, &[slide(), turn()]);
    let turn_first = build(&[tapered_wing()], &variables, &[turn(), slide()]);
    let design = [5.0, 10.0];
    let a = slide_first.control_points(&design).expect("acceptable");
    let b = turn_first.control_points(&design).expect("acceptable");
    assert!(distance(&a[0], &b[0]) < 1e-14);
}

#[test]
fn radial_scale_about_the_line_of_centres() {
    let ratio = [variable("r", &[], Unit::One)];
    let p = build(&[box_body()], &ratio, &[radial([0.0, 2.0, 8.0, 10.0], CentreLine::Sections, "r")]);
    let points = p.control_points(&[1.5]).expect("acceptable");
    let expected = map(&reference(&box_body()), |[x, y, z]| {
        let w = match x {
            0.0 | 10.0 => 0.0,
            // Half way between the stations.
            1.0 | 9.0 => 0.5,
            _ => 1.0,
        };
        let f = 1.0 + 0.5 * w;
        [x, f * y, 0.3 * x + f * (z - 0.3 * x)]
    });
    assert!(distance(&points[0], &expected) < 1e-8);
    let line = CentreLine::Point([4.0, 0.0, 1.0]);
    let p = build(&[box_body()], &ratio, &[radial([0.0, 0.0, 10.0, 10.0], line, "r")]);
    let points = p.control_points(&[0.7]).expect("acceptable");
    let expected = map(&reference(&box_body()), |[x, y, z]| [x, 0.7 * y, 1.0 + 0.7 * (z - 1.0)]);
    assert!(distance(&points[0], &expected) < 1e-14);
}

#[test]
fn a_diameter_acts_relative_to_its_baseline() {
    let stations = [0.0, 0.0, 10.0, 10.0];
    let diameter = [VariableDeclaration { baseline: Some(9.84), ..variable("d", &[], Unit::Foot) }];
    let ratio = [variable("r", &[], Unit::One)];
    let by_diameter = build(&[box_body()], &diameter, &[radial(stations, CentreLine::Sections, "d")]);
    let by_ratio = build(&[box_body()], &ratio, &[radial(stations, CentreLine::Sections, "r")]);
    let a = by_diameter.control_points(&[12.3]).expect("acceptable");
    let b = by_ratio.control_points(&[1.25]).expect("acceptable");
    assert!(distance(&a[0], &b[0]) < 1e-14);
}

#[test]
fn radial_scale_stays_radial_on_a_body_that_was_turned() {
    let variables =
        [variable("r", &[], Unit::One), variable("a", &[], Unit::Degree), variable("t", &[], Unit::Metre)];
    let scale = || radial([1.0, 3.0, 6.0, 9.0], CentreLine::Sections, "r");
    let turn = || rotation("body", Pivot::Point([0.0; 3]), "a");
    let slide = || translation("body", [1.0, 2.0, 3.0], "t");
    let before = build(&[box_body()], &variables, &[scale(), turn(), slide()]);
    let after = build(&[box_body()], &variables, &[turn(), slide(), scale()]);
    let design = [1.4, 35.0, 7.0];
    let a = before.control_points(&design).expect("acceptable");
    let b = after.control_points(&design).expect("acceptable");
    assert!(distance(&a[0], &b[0]) < 1e-13);
}

#[test]
fn the_planform_gets_the_area_and_aspect_ratio_asked_for() {
    let variables = [variable("S", &[], Unit::SquareFoot), variable("A", &[], Unit::One)];
    for sweep in [SweepRule::Scaled, SweepRule::Kept] {
        let p = build(&[tapered_wing()], &variables, &[planform(sweep)]);
        let square_foot = 0.3048 * 0.3048;
        assert!((p.baseline()[0] * square_foot - 30.0).abs() < 1e-6);
        assert!((p.baseline()[1] - 100.0 / 30.0).abs() < 1e-6);
        let wanted = [40.0 / square_foot, 5.0];
        let points = p.control_points(&wanted).expect("acceptable");
        // Measured afresh on the result.
        let result = with_points(&tapered_wing(), &points[0]);
        let measured = build(&[result], &variables, &[planform(sweep)]).baseline();
        assert!((measured[0] / wanted[0] - 1.0).abs() < 1e-7, "{sweep:?} {measured:?}");
        assert!((measured[1] / wanted[1] - 1.0).abs() < 1e-7);
        // Span sqrt(40 * 5); thickness ratio, root quarter chord and, when kept, sweep and dihedral stay.
        let span = f64::sqrt(200.0);
        let chord = (40.0 / 30.0 / 1.5_f64).sqrt();
        let stretch = span / 10.0;
        let expected = map(&reference(&tapered_wing()), |[x, y, z]| {
            let (_, [qx, qz]) = chord_and_axis(y);
            let axis = if sweep == SweepRule::Kept { stretch } else { chord };
            [2.0 + axis * (qx - 2.0) + chord * (x - qx), stretch * y, axis * qz + chord * (z - qz)]
        });
        assert!(distance(&points[0], &expected) < 1e-5, "{sweep:?} {}", distance(&points[0], &expected));
    }
}

#[test]
fn a_planform_is_scaled_about_the_point_given_and_stays_on_the_plane_of_symmetry() {
    let variables = [variable("S", &[], Unit::SquareMetre), variable("A", &[], Unit::One)];
    let (px, pz) = (2.5, -0.75);
    for sweep in [SweepRule::Scaled, SweepRule::Kept] {
        let operation = planform_about(Pivot::Point([px, 7.0, pz]), sweep);
        let p = build(&[tapered_wing()], &variables, &[operation]);
        let [area, ratio] = p.baseline()[..] else { panic!("two variables") };
        let points = p.control_points(&[4.0 * area, 0.25 * ratio]).expect("acceptable");
        // The span stays, chord and thickness become four times as large; with `Kept`, quarter chords keep their
        // distances along chord and thickness.
        let expected = map(&reference(&tapered_wing()), |[x, y, z]| {
            let (_, [qx, qz]) = chord_and_axis(y);
            let [ox, oz] = if sweep == SweepRule::Kept { [qx - 2.0, qz] } else { [0.0; 2] };
            [px + ox + 4.0 * (x - px - ox), y, pz + oz + 4.0 * (z - pz - oz)]
        });
        assert!(distance(&points[0], &expected) < 1e-5, "{sweep:?} {}", distance(&points[0], &expected));
    }
}

#[test]
fn a_declared_baseline_replaces_the_measured_area() {
    let variables = [
        VariableDeclaration { baseline: Some(740.0), ..variable("S", &[], Unit::SquareFoot) },
        variable("A", &[], Unit::One),
    ];
    let p = build(&[tapered_wing()], &variables, &[planform(SweepRule::Scaled)]);
    let points = p.control_points(&[4.0 * 740.0, p.baseline()[1]]).expect("acceptable");
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [2.0 + 2.0 * (x - 2.0), 2.0 * y, 2.0 * z]);
    assert!(distance(&points[0], &expected) < 1e-6);
}

#[test]
fn uniform_twist_turns_each_section_about_its_own_quarter_chord() {
    let points = deformed_wing(SectionKind::Twist, Unit::Degree, 2, &[4], &[30.0; 4]);
    let (s, c) = (0.5, f64::sqrt(0.75));
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| {
        let (_, [qx, qz]) = chord_and_axis(y);
        [qx + c * (x - qx) + s * (z - qz), y, qz + c * (z - qz) - s * (x - qx)]
    });
    assert!(distance(&points, &expected) < 1e-7);
    let leading_edge_rises = points[2][2] > reference(&tapered_wing())[2][2];
    assert!(leading_edge_rises);
}

#[test]
fn camber_lifts_and_thickness_spreads_in_fractions_of_the_chord() {
    let all_rows = || (0..6).collect();
    let points =
        deformed_wing(SectionKind::Camber { rows: all_rows() }, Unit::Percent, 1, &[6, 2], &[5.0; 12]);
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [x, y, z + 0.05 * chord_and_axis(y).0]);
    assert!(distance(&points, &expected) < 1e-7);
    // The lattice reaches from the lowest to the uppermost control point, -0.08 to 0.08 chords.
    let points =
        deformed_wing(SectionKind::Thickness { rows: all_rows() }, Unit::One, 1, &[6, 2], &[0.02; 12]);
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| {
        let (chord, [_, qz]) = chord_and_axis(y);
        [x, y, z + 0.02 * (z - qz) / 0.08 * if chord > 0.0 { 1.0 } else { 0.0 }]
    });
    assert!(distance(&points, &expected) < 1e-7);
}

#[test]
fn camber_rows_leave_both_edges_unless_asked() {
    let p = build(
        &[tapered_wing()],
        &[variable("v", &[4, 3], Unit::Percent)],
        &[exact_block(vec![section(SectionKind::Camber { rows: vec![] }, "v", 1)])],
    );
    let mut design = vec![0.0; 12];
    // The first inner row, root station only.
    design[0] = 5.0;
    let lattice = |d: &[f64]| p.lattices(d).expect("acceptable").remove(0);
    let (moved, still) = (lattice(&design), lattice(&[0.0; 12]));
    assert_eq!(moved.shape, [6, 7, 2]);
    for i in 0..6 {
        for k in 0..7 {
            for j in 0..2 {
                let index = (i * 7 + k) * 2 + j;
                let lift = moved.points[index][2] - still.points[index][2];
                // Linear from root to the middle of the half span, at stations 0, 1/3, 2/3, 1.
                let share = [0.0, 0.0, 1.0 / 3.0, 1.0, 1.0 / 3.0, 0.0, 0.0][k];
                let expected =
                    if i == 1 { 0.05 * 4.0 * share * [1.0, 1.0, 0.0, 0.0][k.abs_diff(3)] } else { 0.0 };
                let chord = 1.0 - 0.1 * (5.0 / 3.0) * k.abs_diff(3) as f64;
                assert!((lift - expected * chord).abs() < 1e-7, "{i} {k} {j}: {lift} {expected}");
            }
        }
    }
    let points = p.control_points(&[5.0; 12]).expect("acceptable").remove(0);
    for (p, q) in points.iter().zip(reference(&tapered_wing())) {
        let s = (q[0] - 1.0 - 0.5 * q[1].abs()) / chord_and_axis(q[1]).0;
        if !(1e-12..=1.0 - 1e-12).contains(&s) {
            assert!((p[2] - q[2]).abs() < 1e-8, "an edge moved");
        } else {
            assert!(p[2] > q[2]);
        }
    }
}

#[test]
fn chord_stretch_about_the_quarter_chord_with_and_without_thickness() {
    for scales_thickness in [false, true] {
        let kind = SectionKind::ChordStretch { scales_thickness };
        let points = deformed_wing(kind, Unit::One, 0, &[1], &[0.2]);
        let expected = map(&reference(&tapered_wing()), |[x, y, z]| {
            let (_, [qx, qz]) = chord_and_axis(y);
            [qx + 1.2 * (x - qx), y, if scales_thickness { qz + 1.2 * (z - qz) } else { z }]
        });
        assert!(distance(&points, &expected) < 1e-7);
    }
}

#[test]
fn span_stretch_is_antisymmetric_with_a_fixed_root() {
    // One coefficient, at the tip; the one at the root is zero and linear functions connect the two.
    let points = deformed_wing(SectionKind::SpanStretch, Unit::Metre, 1, &[1], &[0.5]);
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [x, 1.1 * y, z]);
    assert!(distance(&points, &expected) < 1e-14);
}

#[test]
fn sweep_and_dihedral_move_sections_as_they_are() {
    let sweep = deformed_wing(SectionKind::Sweep, Unit::Foot, 1, &[2], &[0.0, 10.0]);
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [x + 3.048 * y.abs() / 5.0, y, z]);
    assert!(distance(&sweep, &expected) < 1e-14);
    let dihedral = deformed_wing(SectionKind::Dihedral, Unit::Metre, 1, &[2], &[0.0, 1.0]);
    let expected = map(&reference(&tapered_wing()), |[x, y, z]| [x, y, z + y.abs() / 5.0]);
    assert!(distance(&dihedral, &expected) < 1e-14);
}

#[test]
fn a_block_is_eq_4_with_an_inversion_by_newton() {
    // A smooth lattice (degree 3 along the span), all section functions at once, compared with the volume evaluated
    // at coordinates found by iteration.
    let variables = [
        variable("twist", &[5], Unit::Degree),
        variable("camber", &[4, 3], Unit::Percent),
        variable("thickness", &[4, 3], Unit::Percent),
        variable("chord", &[3], Unit::One),
        variable("stretch", &[3], Unit::Metre),
        variable("sweep", &[2], Unit::Metre),
    ];
    let block = FreeFormDeclaration {
        components: vec!["wing".into()],
        span: Axis::Y,
        symmetric: true,
        shape: [6, 9, 3],
        degree: [3, 3, 2],
        sections: vec![
            section(SectionKind::Twist, "twist", 3),
            section(SectionKind::Camber { rows: vec![] }, "camber", 2),
            section(SectionKind::Thickness { rows: vec![] }, "thickness", 2),
            section(SectionKind::ChordStretch { scales_thickness: false }, "chord", 1),
            section(SectionKind::SpanStretch, "stretch", 2),
            section(SectionKind::Sweep, "sweep", 1),
        ],
    };
    let p = build(&[tapered_wing()], &variables, &[OperationDeclaration::FreeForm(block)]);
    let design = random_design(&p, 3);
    let (at_rest, moved) = (
        p.lattices(&p.baseline()).expect("acceptable").remove(0),
        p.lattices(&design).expect("acceptable").remove(0),
    );
    let knots = |d: usize| KnotVector::clamped_uniform([3, 3, 2][d], [6, 9, 3][d]).expect("valid");
    let volume = Volume::new([knots(0), knots(1), knots(2)]);
    let points = p.control_points(&design).expect("acceptable").remove(0);
    for (point, rest) in points.iter().zip(reference(&tapered_wing())) {
        let xi = volume.locate(&at_rest.points, &Vector3::from(rest)).expect("inside the block");
        let expected = volume.position(&moved.points, xi);
        assert!((Vector3::from(*point) - expected).norm() < 1e-9, "{point:?} {expected}");
    }
}

#[test]
fn a_symmetric_wing_stays_symmetric_to_the_last_bit() {
    let p = everything();
    let design = random_design(&p, 11);
    let wing = &p.control_points(&design).expect("acceptable")[0];
    for i in 0..10 {
        for j in 0..5 {
            let [x, y, z] = wing[i * 5 + j];
            let mirrored = wing[i * 5 + 4 - j];
            // A vanishing y may carry either sign.
            assert_eq!([x, y + 0.0, z], [mirrored[0], 0.0 - mirrored[1], mirrored[2]], "row {i}, column {j}");
        }
    }
}

#[test]
fn shared_edges_stay_shared() {
    let p = everything();
    for seed in 0..20 {
        let wing = &p.control_points(&random_design(&p, seed)).expect("acceptable")[0];
        let (lower, upper) = wing.split_at(25);
        for j in 0..5 {
            assert_eq!(lower[j], upper[j], "leading edge");
            assert_eq!(lower[20 + j], upper[20 + j], "trailing edge");
        }
    }
}

#[test]
fn a_half_model_deforms_like_the_whole() {
    let mut half = tapered_wing();
    for patch in &mut half.patches {
        // Columns y = 0, 2.5, 5 of the five.
        let starboard = patch.control_points.chunks_exact(5).flat_map(|row| row[2..].to_vec()).collect();
        patch.control_points = starboard;
        let knots_v = KnotVector::clamped_uniform(1, 3).expect("valid");
        patch.surface = moldline_spline::Surface::new(patch.surface.knots_u().clone(), knots_v);
    }
    let variables = [
        variable("twist", &[3], Unit::Degree),
        variable("S", &[], Unit::SquareMetre),
        variable("A", &[], Unit::One),
    ];
    let operations =
        [exact_block(vec![section(SectionKind::Twist, "twist", 2)]), planform(SweepRule::Scaled)];
    let whole = build(&[tapered_wing()], &variables, &operations);
    let half = build(&[half], &variables, &operations);
    assert!((whole.baseline()[3] - half.baseline()[3]).abs() < 1e-6);
    let mut design = whole.baseline();
    design[..3].copy_from_slice(&[1.0, -2.0, 4.0]);
    let mut half_design = half.baseline();
    half_design[..3].copy_from_slice(&design[..3]);
    let a = whole.control_points(&design).expect("acceptable").remove(0);
    let b = half.control_points(&half_design).expect("acceptable").remove(0);
    let starboard: Vec<[f64; 3]> = a.chunks_exact(5).flat_map(|row| row[2..].to_vec()).collect();
    assert!(distance(&starboard, &b) < 1e-7);
}

#[test]
fn a_fin_spans_upwards_and_twists_its_nose_to_starboard() {
    // The starboard half of the wing stood on end: (x, y, z) -> (x, z, y).
    let mut fin = tapered_wing();
    fin.name = "fin".into();
    for patch in &mut fin.patches {
        for p in &mut patch.control_points {
            *p = [p[0], p[2], p[1]];
        }
    }
    let block = FreeFormDeclaration {
        components: vec!["fin".into()],
        span: Axis::Z,
        symmetric: false,
        shape: [4, 7, 2],
        degree: [2, 1, 1],
        sections: vec![section(SectionKind::Twist, "twist", 1)],
    };
    let p = build(
        &[fin.clone()],
        &[variable("twist", &[2], Unit::Degree)],
        &[OperationDeclaration::FreeForm(block)],
    );
    let points = p.control_points(&[30.0, 30.0]).expect("acceptable").remove(0);
    let (s, c) = (0.5, f64::sqrt(0.75));
    let expected = map(&reference(&fin), |[x, y, z]| {
        let (_, [qx, qy]) = chord_and_axis(z);
        [qx + c * (x - qx) + s * (y - qy), qy + c * (y - qy) - s * (x - qx), z]
    });
    assert!(distance(&points, &expected) < 1e-7);
}

#[test]
fn a_block_takes_several_components_along() {
    // Upper and lower side as two components deform as they do in one.
    let whole = tapered_wing();
    let side = |i: usize, name: &str| ComponentReference {
        name: name.into(),
        patches: vec![whole.patches[i].clone()],
    };
    let variables = [variable("v", &[3], Unit::Degree)];
    let block = |components: &[&str]| {
        let OperationDeclaration::FreeForm(mut block) =
            exact_block(vec![section(SectionKind::Twist, "v", 2)])
        else {
            unreachable!()
        };
        block.components = components.iter().map(|&c| c.into()).collect();
        OperationDeclaration::FreeForm(block)
    };
    let one = build(&[tapered_wing()], &variables, &[block(&["wing"])]);
    let two = build(&[side(0, "lower"), side(1, "upper")], &variables, &[block(&["lower", "upper"])]);
    let design = [2.0, -3.0, 5.0];
    let a = one.control_points(&design).expect("acceptable").concat();
    let b = two.control_points(&design).expect("acceptable").concat();
    assert_eq!(a, b);
}

#[test]
fn one_variable_may_drive_several_operations() {
    let variables = [variable("t", &[], Unit::Metre)];
    let operations = [translation("wing", [1.0, 0.0, 0.0], "t"), translation("body", [-1.0, 0.0, 0.0], "t")];
    let p = build(&[tapered_wing(), box_body()], &variables, &operations);
    let points = p.control_points(&[2.0]).expect("acceptable");
    assert!(distance(&points[0], &map(&reference(&tapered_wing()), |[x, y, z]| [x + 2.0, y, z])) < 1e-15);
    assert!(distance(&points[1], &map(&reference(&box_body()), |[x, y, z]| [x - 2.0, y, z])) < 1e-15);
}

#[test]
fn an_override_replaces_one_component_only() {
    let p = everything();
    let design = random_design(&p, 5);
    let free = p.control_points(&design).expect("acceptable");
    let given = map(&reference(&box_body()), |[x, y, z]| [x, 2.0 * y, z]);
    let overrides = [Override { component: 1, control_points: given.clone() }];
    let points = p.control_points_with(&design, &overrides).expect("acceptable");
    assert_eq!(points[0], free[0]);
    assert_eq!(points[1], given);
}
