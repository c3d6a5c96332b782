//! Quality measures against VTK's, and reports against numpy's percentiles and closed forms.

use moldline_mesh::{
    Cell, CellQuality, Distribution, QualityReport, Summary, Vector3, area_vector,
    quality::{DEGENERATE, evaluate},
};

/// Relative difference.
fn close(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance * b.abs().max(1.0)
}

#[test]
fn measures_agree_with_vtk() {
    let fixture: serde_json::Value = serde_json::from_str(include_str!("fixtures/quality.json")).unwrap();
    let (mut quads, mut triangles, mut concave) = (0, 0, 0);
    for (index, expected) in fixture.as_array().unwrap().iter().enumerate() {
        let vertices: Vec<[f64; 3]> = serde_json::from_value(expected["vertices"].clone()).unwrap();
        let cell = if vertices.len() == 3 { Cell::triangle(0, 1, 2) } else { Cell::quad(0, 1, 2, 3) };
        let normal = area_vector(&vertices, &cell).normalize();
        let found = CellQuality::of_cell(&vertices, &cell, &normal);
        let check = |name: &str, found: f64, tolerance: f64| {
            let expected = expected[name].as_f64().unwrap();
            assert!(close(found, expected, tolerance), "cell {index}: {name} {found}, VTK {expected}");
        };
        check("AspectRatio", found.aspect_ratio, 1e-12);
        check("MinAngle", found.min_angle, 1e-9);
        check("ScaledJacobian", found.scaled_jacobian, 1e-12);
        if found.max_angle <= 180.0 {
            check("MaxAngle", found.max_angle, 1e-9);
            check("EquiangleSkew", found.skew, 1e-9);
        } else {
            concave += 1;
            assert_eq!(found.skew, 1.0);
        }
        if vertices.len() == 3 {
            triangles += 1
        } else {
            quads += 1
        }
        assert!(!found.folded);
    }
    assert!(quads > 50 && triangles > 40 && concave > 3, "{quads} {triangles} {concave}");
}

#[test]
fn dart_has_its_reflex_angle() {
    let vertices = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 2.0, 0.0]];
    let found = CellQuality::of_cell(&vertices, &Cell::quad(0, 1, 2, 3), &Vector3::z());
    // Angles of a planar quadrilateral sum to 360: 90 and twice atan(1/3).
    let expected = 270.0 - 2.0 * (1.0_f64 / 3.0).atan().to_degrees();
    assert!(close(found.max_angle, expected, 1e-13), "{} {expected}", found.max_angle);
    assert!(found.scaled_jacobian < 0.0 && !found.folded);
}

#[test]
fn jacobian_and_fold_are_seen_along_the_owner_normal() {
    let vertices = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let cell = Cell::quad(0, 1, 2, 3);
    let tilted = Vector3::new(0.0, 0.5, 0.75_f64.sqrt());
    let found = CellQuality::of_cell(&vertices, &cell, &tilted);
    assert!(close(found.scaled_jacobian, 0.75_f64.sqrt(), 1e-15) && !found.folded);
    let found = CellQuality::of_cell(&vertices, &cell, &-Vector3::z());
    assert!(found.scaled_jacobian == -1.0 && found.folded);
    // longest 3, perimeter 8, area 3
    assert!(close(found.aspect_ratio, 2.0, 1e-15) && close(found.edge_ratio, 3.0, 1e-15));
}

#[test]
fn degenerate_and_broken_cells_are_the_worst_and_finite() {
    let point = [[1.0; 3]; 4];
    let line = [[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
    let broken = [[0.0; 3], [1.0, 0.0, 0.0], [1.0, f64::NAN, 0.0], [f64::INFINITY, 1.0, 0.0]];
    for vertices in [point, line, broken] {
        for cell in [Cell::quad(0, 1, 2, 3), Cell::triangle(0, 1, 2)] {
            let found = CellQuality::of_cell(&vertices, &cell, &Vector3::z());
            assert_eq!(found.aspect_ratio, DEGENERATE, "{vertices:?}");
            assert!(found.scaled_jacobian <= 0.0 && found.skew == 1.0, "{found:?}");
            assert!(found.min_angle == 0.0 && found.max_angle >= 180.0, "{found:?}");
        }
    }
    let found = CellQuality::of_cell(&broken, &Cell::quad(0, 1, 2, 3), &Vector3::z());
    assert!(found.folded && found.edge_ratio == DEGENERATE);
}

#[test]
fn percentiles_are_those_of_numpy() {
    // numpy.percentile([3, 1, 4, 1.5, 9, 2.6], [50, 95, 99]) == [2.8, 7.75, 8.75]
    let found = Distribution::new(&mut [3.0, 1.0, 4.0, 1.5, 9.0, 2.6]).unwrap();
    assert!(close(found.p50, 2.8, 1e-15) && close(found.p95, 7.75, 1e-15) && close(found.p99, 8.75, 1e-15));
    assert_eq!((found.max, found.above_5_percent), (9.0, 100.0 / 6.0));
    // Of 0, 1, ..., n - 1 the percentile q is q (n - 1) / 100.
    for count in [1, 2, 3, 20, 101, 1000] {
        let mut values: Vec<f64> = (0..count).map(|k| f64::from((k * 7919) % count)).collect();
        let found = Distribution::new(&mut values).unwrap();
        let at = |fraction: f64| fraction * f64::from(count - 1);
        for (found, expected) in [(found.p50, at(0.5)), (found.p95, at(0.95)), (found.p99, at(0.99))] {
            assert!(count % 7919 == 0 || close(found, expected, 1e-12), "{count}: {found} {expected}");
        }
    }
    assert_eq!(Distribution::new(&mut []), None);
}

/// A warped strip of rectangles and triangles with a component each.
fn strip() -> (Vec<[f64; 3]>, Vec<Cell>, Vec<u32>) {
    let count = 3000;
    let at = |i: u32| [f64::from(i) * 0.3, 0.0, (f64::from(i) * 0.37).sin()];
    let mut vertices: Vec<[f64; 3]> = (0..=count).map(at).collect();
    vertices.extend((0..=count).map(|i| [at(i)[0], 1.0 + 0.2 * f64::from(i % 3), at(i)[2]]));
    let (mut cells, mut owner) = (Vec::new(), Vec::new());
    for i in 0..count {
        let [a, b, c, d] = [i, i + 1, i + count + 2, i + count + 1];
        if i % 2 == 0 {
            cells.push(Cell::quad(a, b, c, d));
            owner.push(2);
        } else {
            cells.extend([Cell::triangle(a, b, c), Cell::triangle(a, c, d)]);
            owner.extend([0, 0]);
        }
    }
    (vertices, cells, owner)
}

#[test]
fn report_is_by_component_and_alike_for_any_number_of_threads() {
    let (vertices, cells, owner) = strip();
    let names = ["tri", "empty", "quad"].map(str::to_owned);
    let normals: Vec<Vector3> = cells.iter().map(|cell| area_vector(&vertices, cell).normalize()).collect();
    let reports = [1, 2, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let out = evaluate(&vertices, &cells, &normals);
            (out.clone(), QualityReport::new(&out, &owner, &names).unwrap())
        })
    });
    assert!(reports.windows(2).all(|pair| pair[0] == pair[1]));
    let (measured, report) = &reports[0];
    assert_eq!(report.total.cells, cells.len());
    let summarised: Vec<(&str, usize)> =
        report.per_component.iter().map(|(name, summary)| (name.as_str(), summary.cells)).collect();
    assert_eq!(summarised, [("tri", 3000), ("quad", 1500)]);
    let quads: Vec<CellQuality> =
        measured.iter().zip(&owner).filter(|(_, o)| **o == 2).map(|(q, _)| *q).collect();
    assert_eq!(Summary::new(&quads), Some(report.per_component[1].1));

    let table = report.to_string();
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines.len(), 2 + 3);
    assert!(lines[1].contains("folded/inverted") && lines[4].starts_with("total"), "{table}");
    let widths: Vec<usize> = lines[1..].iter().map(|line| line.len()).collect();
    assert!(widths.iter().all(|width| *width == widths[0]), "{table}");
    assert_eq!(report.compared_with(report).to_string().lines().count(), 2 + 6);
}
