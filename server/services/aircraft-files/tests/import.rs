//! Imports of files that the tests write themselves.

mod common;

use common::{Set, body, disc, half_wing, iges, position, step};
use moldline_aircraft_files::{Import, ImportError, ImportOptions, import};
use moldline_foundation::{Vector3, monitor::NoMonitor};
use moldline_geometry::Body;
use moldline_setup_files::{Limits, read_setup};

const METRE: &str = "SI_UNIT(.UNSET.,.METRE.)";

fn aircraft() -> Vec<Set> {
    vec![
        ("ABCDEFGHIJ, Fuse, 0".into(), body(12.0, 1.0)),
        ("KLMNOPQRST, Main wing, 0".into(), half_wing(2.5, 9.0, 0.3, 1.0)),
        ("KLMNOPQRST, Main wing, 1".into(), half_wing(2.5, 9.0, 0.3, -1.0)),
        ("UVWXYZABCD, Disc, 0".into(), disc(0.5, 1.5)),
    ]
}

fn read(text: &str, options: &ImportOptions) -> Result<Import, ImportError> {
    import(text.as_bytes(), options, &NoMonitor)
}

fn imported(sets: &[Set]) -> Import {
    read(&step(sets, METRE), &ImportOptions::default()).expect("the file is good")
}

/// The components as the set-up has them; its mesh is one triangle.
fn components(import: &Import) -> Vec<Body> {
    let mut files = import.files.clone();
    let mesh = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n$Elements\n1\n1 2 0 1 2 3\n\
                $EndElements\n";
    files.insert("mesh.msh".into(), mesh.into());
    let content = read_setup(&files, None, &Limits::default()).expect("the set-up is good");
    let scalars: usize = import.report.components.iter().map(|c| c.variables).sum();
    let parameterisation = &content.input.parameterisation;
    assert_eq!(parameterisation.variables().len(), scalars);
    let points = parameterisation.control_points(&parameterisation.baseline()).expect("the baseline is good");
    let body = |(component, points): (moldline_geometry::Component, Vec<[f64; 3]>)| {
        let internal = component.internal_control_points(&points);
        Body::new(component.into(), internal)
    };
    content.input.components.into_iter().zip(points).map(body).collect()
}

#[test]
fn an_aircraft_of_openvsp() {
    let import = imported(&aircraft());
    let report = &import.report;
    let names: Vec<&str> = report.components.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["Fuse", "Main_wing"]);
    assert_eq!(report.left_out.iter().map(|l| l.name.as_str()).collect::<Vec<_>>(), ["Disc"]);
    let [fuselage, wing] = &report.components[..] else { panic!("two") };
    assert_eq!((fuselage.shape, wing.shape), ("body", "wing"));
    // Root caps are gone, and every patch is smooth: four quadrants; two sides, two halves, two sections, and two tip caps of two.
    assert_eq!((fuselage.patches, fuselage.pieces_in_file, fuselage.pieces), (4, 16, 4));
    assert_eq!((wing.sets, wing.shells, wing.patches, wing.pieces_in_file, wing.pieces), (2, 1, 12, 80, 12));
    assert!(wing.removal_change < 1e-13 && wing.weld < 1e-13, "{report}");
}

#[test]
fn surfaces_are_those_of_the_file() {
    let sets = aircraft();
    let import = imported(&sets);
    let bodies = components(&import);
    for (set, body) in [(0, 0), (1, 1), (2, 1)] {
        let body = &bodies[body];
        // But for the root caps, which are inside.
        for patch in sets[set].1.iter().filter(|p| p.rows.iter().flatten().any(|p| p[1].abs() > 1e-9)) {
            let pieces = [0, 1].map(|d| {
                let n = if d == 0 { patch.rows.len() } else { patch.rows[0].len() };
                (n - 1) / patch.degrees[d]
            });
            for i in 0..=6 {
                for j in 0..=6 {
                    let [x, y, z] =
                        position(patch, (pieces[0] * i) as f64 / 6.0, (pieces[1] * j) as f64 / 6.0);
                    let foot = body.closest_point(&Vector3::new(x, y, z));
                    assert!(foot.distance.abs() < 1e-12 * body.size(), "{} at {i} {j}", foot.distance);
                }
            }
        }
    }
}

#[test]
fn units_are_read_and_can_be_overridden() {
    let sets = aircraft();
    let width = |import: &Import| import.report.high[1] - import.report.low[1];
    let foot = "CONVERSION_BASED_UNIT('FOOT',#900001)";
    let definition = "#900001=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(304.8),#900002);\n\
                      #900002=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\nENDSEC;\nEND-";
    let text = step(&sets, foot).replace("ENDSEC;\nEND-", definition);
    let feet = read(&text, &ImportOptions::default()).expect("the file is good");
    assert!((width(&feet) - 18.0 * 0.3048).abs() < 1e-12);
    assert!(feet.report.to_string().contains("in metres it would be 12.0000 x 18.0000"), "{}", feet.report);
    let options = ImportOptions { metres_per_unit: Some(1.0), ..ImportOptions::default() };
    let metres = read(&text, &options).expect("the file is good");
    assert!((width(&metres) - 18.0).abs() < 1e-12);
}

#[test]
fn components_are_chosen_by_name_or_id() {
    let text = step(&aircraft(), METRE);
    let names = |options: ImportOptions| {
        read(&text, &options).map(|i| i.report.components.into_iter().map(|c| c.name).collect::<Vec<_>>())
    };
    let only = |name: &str| ImportOptions { only: vec![name.into()], ..ImportOptions::default() };
    assert_eq!(names(only("KLMNOPQRST")).expect("known"), ["Main_wing"]);
    let skip = ImportOptions { skip: vec!["Main_wing".into()], ..ImportOptions::default() };
    assert_eq!(names(skip).expect("known"), ["Fuse"]);
    let error = names(only("Fin")).expect_err("unknown").to_string();
    assert!(
        error.starts_with("--only Fin: no component has this name or ID; the file has Fuse (ABCDEFGHIJ), "),
        "{error}"
    );
    assert!(names(only("Disc")).expect_err("open").to_string().contains("Disc is open: "));
}

#[test]
fn a_gap_between_cap_and_skin_is_welded() {
    // As in a file of 2023: the cap's edge is 2e-5 m off the skin's.
    let mut sets = aircraft();
    for point in &mut sets[1].1[6].rows[0][5..9] {
        point[2] += 2e-5;
    }
    let import = imported(&sets);
    let wing = &import.report.components[1];
    assert_eq!((wing.patches, wing.shells), (12, 1), "{}", import.report);
    assert!((1.9e-5..2.1e-5).contains(&wing.weld), "{}", wing.weld);
    // The skin stays where it is, and stays smooth.
    assert_eq!(wing.pieces, 12);
}

#[test]
fn copies_apart_are_shells_and_names_are_unique() {
    let shifted = |side: f64| -> Set {
        let mut patches = half_wing(1.0, 2.0, 0.2, side);
        patches.iter_mut().flat_map(|p| &mut p.rows).flatten().for_each(|p| p[1] += side);
        (format!("AAAAAAAAAA, Strut, {}", u8::from(side < 0.0)), patches)
    };
    let other = ("BBBBBBBBBB, strut, 0".to_owned(), body(3.0, 0.4));
    let import = imported(&[shifted(1.0), shifted(-1.0), other]);
    let names: Vec<&str> = import.report.components.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["Strut", "strut_2"]);
    assert_eq!((import.report.components[0].shells, import.report.components[0].shape), (2, "wing"));
    components(&import);
}

#[test]
fn what_cannot_be_imported_is_refused() {
    let fails = |text: &str| read(text, &ImportOptions::default()).expect_err("refused").to_string();
    assert!(fails("hello").starts_with("the file is neither STEP"));
    let text = step(&aircraft(), METRE);
    assert!(
        fails(
            &text
                .replace("GEOMETRIC_SET(", "GEOMETRIC_CURVE_SET(")
                .replace("B_SPLINE_SURFACE", "OFFSET_SURFACE")
        )
        .starts_with("the file has no surfaces")
    );
    let hybrid = text.replace("ENDSEC;\nEND-", "#900000=CLOSED_SHELL('',());\nENDSEC;\nEND-");
    assert!(fails(&hybrid).starts_with("the file has both loose surfaces ('Fuse') and solids"));
    let many = ImportOptions {
        limits: moldline_aircraft_files::ImportLimits { control_points: 100, ..Default::default() },
        ..Default::default()
    };
    let error = read(&text, &many).expect_err("too many").to_string();
    assert!(
        error.ends_with("control points, more than the 100 allowed: export fewer components at a time"),
        "{error}"
    );
}

#[test]
fn iges_gives_the_same_as_step() {
    let sets = aircraft();
    let of_iges = read(&iges(&sets, "4,2HFT"), &ImportOptions::default()).expect("the file is good");
    assert_eq!(of_iges.report.file_unit.as_ref().map(|u| u.metres), Some(0.3048));
    let metres = ImportOptions { metres_per_unit: Some(1.0), ..ImportOptions::default() };
    let of_iges = read(&iges(&sets, "6,1HM"), &metres).expect("the file is good");
    let of_step = imported(&sets);
    for (a, b) in of_iges.report.components.iter().zip(&of_step.report.components) {
        assert_eq!((&a.name, a.patches, a.pieces), (&b.name, b.patches, b.pieces), "{}", of_iges.report);
        assert!((a.volume - b.volume).abs() < 1e-12 * b.volume && (a.area - b.area).abs() < 1e-12 * b.area);
    }
    assert_eq!(of_iges.report.components.len(), 2);
}

/// A box of six bilinear faces with lines as edges; `shrink` takes a corner of the first face's loop inside.
fn solid(shrink: f64) -> String {
    let mut text = String::from("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n");
    let mut next = 10;
    let mut faces = Vec::new();
    let mut put = |entity: String| {
        next += 1;
        text += &format!("#{next}={entity};\n");
        format!("#{next}")
    };
    for axis in 0..3 {
        for level in [0.0, 1.0] {
            let corner = |a: f64, b: f64| {
                let mut p = [level; 3];
                (p[(axis + 1) % 3], p[(axis + 2) % 3]) = (a, b);
                p
            };
            let corners = [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0), corner(1.0, 0.0)];
            let [a, b, c, d] =
                corners.map(|[x, y, z]| put(format!("CARTESIAN_POINT('',({x:?},{y:?},{z:?}))")));
            let surface = put(format!(
                "B_SPLINE_SURFACE_WITH_KNOTS('',1,1,(({a},{b}),({d},{c})),.U.,.F.,.F.,.F.,(2,2),(2,2),(0.,1.),(0.,1.),.U.)"
            ));
            let inside = if faces.is_empty() { shrink } else { 0.0 };
            let first = put(format!("CARTESIAN_POINT('',(0.,{inside:?},{inside:?}))"));
            let vertices = [if faces.is_empty() { &first } else { &a }, &b, &c, &d]
                .map(|point| put(format!("VERTEX_POINT('',{point})")));
            let edges: Vec<String> = (0..4)
                .map(|k| {
                    let (from, to) = (&vertices[k], &vertices[(k + 1) % 4]);
                    let edge = put(format!("EDGE_CURVE('',{from},{to},#9,.T.)"));
                    put(format!("ORIENTED_EDGE('',*,*,{edge},.T.)"))
                })
                .collect();
            let bound = put(format!("EDGE_LOOP('',({}))", edges.join(",")));
            let bound = put(format!("FACE_OUTER_BOUND('',{bound},.T.)"));
            faces.push(put(format!("ADVANCED_FACE('',({bound}),{surface},.T.)")));
        }
    }
    let shell = put(format!("CLOSED_SHELL('',({}))", faces.join(",")));
    put(format!("MANIFOLD_SOLID_BREP('Block',{shell})"));
    text + "#9=LINE('',#10,#10);\n#10=CARTESIAN_POINT('',(0.,0.,0.));\nENDSEC;\nEND-ISO-10303-21;\n"
}

#[test]
fn faces_bounded_by_their_sides_are_read_and_trimmed_ones_refused() {
    let import = read(&solid(0.0), &ImportOptions::default()).expect("the file is good");
    let [block] = &import.report.components[..] else { panic!("one component: {}", import.report) };
    assert_eq!((block.name.as_str(), block.patches), ("Block", 6));
    assert!((block.volume - 1.0).abs() < 1e-12 && (block.area - 6.0).abs() < 1e-12, "{}", import.report);
    let error = read(&solid(0.1), &ImportOptions::default()).expect_err("trimmed").to_string();
    assert!(error.contains("of 'Block' (line ") && error.contains("is trimmed: edge #"), "{error}");
    let text = solid(0.0).replace("=B_SPLINE_SURFACE_WITH_KNOTS(", "=PLANE(");
    let error = read(&text, &ImportOptions::default()).expect_err("a plane").to_string();
    assert!(error.contains("export with analytic surfaces converted"), "{error}");
}

#[test]
fn spoiled_files_are_imported_or_refused() {
    let sets = aircraft();
    let files = [step(&sets, METRE), iges(&sets[..2], "6,1HM"), solid(0.0)];
    let mut random = fastrand::Rng::with_seed(7);
    for round in 0..400 {
        let mut bytes = files[round % 3].clone().into_bytes();
        for _ in 0..random.usize(1..4) {
            let at = random.usize(0..bytes.len());
            match random.u32(0..5) {
                0 => bytes[at] = random.u8(..),
                1 => bytes.truncate(at.max(1)),
                2 => drop(bytes.drain(at..(at + random.usize(1..40)).min(bytes.len()))),
                3 => {
                    let piece = bytes[at..(at + random.usize(1..200)).min(bytes.len())].to_vec();
                    let to = random.usize(0..bytes.len());
                    drop(bytes.splice(to..to, piece));
                }
                _ => {
                    let words = [
                        "(", "((((", "1e308", "-1", "#1", "99999999", "'", "/*", ";", ")", "$", "9H",
                        "\u{ff01}",
                    ];
                    let word = words[random.usize(0..words.len())];
                    drop(bytes.splice(at..at, word.bytes()));
                }
            }
            if bytes.is_empty() {
                break;
            }
        }
        let limits = moldline_aircraft_files::ImportLimits { control_points: 5000, ..Default::default() };
        let options = ImportOptions { limits, ..Default::default() };
        // No panic; a result is consistent.
        if let Ok(import) = import(&bytes, &options, &NoMonitor) {
            assert!(import.report.components.iter().all(|c| c.area.is_finite()), "round {round}");
        }
    }
}
