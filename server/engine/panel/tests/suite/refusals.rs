//! Bad input: typed errors that name cells, edges, vertices and fields.

use moldline_mesh::{Cell, SurfaceMesh};
use moldline_panel::{
    Inputs, Monitor, NoMonitor, Options, Outputs, PanelError, PanelSetup, Solver, Stage, Symmetry,
    TrailingEdges,
};
use moldline_testing::{Builder, sphere};
use std::sync::Arc;

use crate::derivatives::{flow, wing};

fn refused(mesh: &SurfaceMesh, options: Options) -> PanelError {
    PanelSetup::new(mesh, options).err().unwrap()
}

fn with(cells: Vec<Cell>, mesh: &SurfaceMesh) -> SurfaceMesh {
    SurfaceMesh { cells, ..mesh.clone() }
}

fn none() -> Options {
    Options { trailing_edges: TrailingEdges::None, ..Options::default() }
}

#[test]
fn surfaces_that_are_not_closed_or_not_oriented() {
    let mesh = sphere(4);
    let open = with(mesh.cells[1..].to_vec(), &mesh);
    assert!(matches!(refused(&open, none()), PanelError::Open { count: 4, .. }));

    let mut cells = mesh.cells.clone();
    cells[17] = cells[17].flipped();
    assert!(
        matches!(refused(&with(cells, &mesh), none()), PanelError::Inconsistent { cells, .. } if cells.contains(&17))
    );

    let inwards = mesh.cells.iter().map(Cell::flipped).collect();
    let error = refused(&with(inwards, &mesh), none());
    // Of the starboard half, which is what is solved for.
    assert!(
        matches!(error, PanelError::Inwards { cell, volume } if (cell as usize) < mesh.cells.len() && (volume + 2.0).abs() < 0.3),
        "{error}"
    );

    let mut cells = mesh.cells.clone();
    cells.push(cells[5]);
    assert!(
        matches!(refused(&with(cells, &mesh), none()), PanelError::NonManifold { cells, .. } if cells.len() == 3)
    );

    let mut moved = mesh.clone();
    moved.vertices.iter_mut().for_each(|v| v[1] += 0.01);
    let mirror = Options { symmetry: Symmetry::Mirror, ..none() };
    assert!(matches!(refused(&moved, mirror), PanelError::NotSymmetric(_)));
}

#[test]
fn trailing_edges_that_are_missing_or_wrong() {
    let mesh = wing(false, false);
    let rule = |trailing_edges| Options { trailing_edges, ..Options::default() };
    assert!(matches!(
        refused(&sphere(4), Options::default()),
        error @ PanelError::NoTrailingEdge { .. } if error.to_string().contains("120 degrees")
    ));
    assert!(matches!(
        refused(&mesh, rule(TrailingEdges::Groups(vec!["missing".to_owned()]))),
        PanelError::UnknownGroup { known, .. } if known == ["trailing_edge"]
    ));
    let edges = |list: &[[u32; 2]]| rule(TrailingEdges::Edges(list.to_vec()));
    assert!(matches!(refused(&mesh, edges(&[[0, 40]])), PanelError::NotAnEdge { index: 0, edge: [0, 40] }));
    assert!(matches!(refused(&mesh, edges(&[[0, 99_999]])), PanelError::NotAnEdge { .. }));
    // Vertices 75 and 87 lie on the lower side, one behind the other along the span.
    assert!(matches!(
        refused(&mesh, edges(&[[75, 87]])),
        PanelError::BluntTrailingEdge { edge: [75, 87], .. }
    ));
    assert!(matches!(
        refused(&mesh, rule(TrailingEdges::Angle { degrees: f64::NAN })),
        PanelError::OutOfRange { .. }
    ));
}

#[test]
fn too_much_memory_is_refused_before_it_is_taken() {
    let options = Options { memory_limit: 1 << 20, ..none() };
    let error = refused(&sphere(16), options);
    assert!(
        matches!(error, PanelError::Memory { unknowns: 801, limit: 1_048_576, needed, .. } if needed > 5_000_000),
        "{error}"
    );
}

#[test]
fn positions_and_flows_that_make_no_sense() {
    let mesh = wing(false, false);
    let setup = Arc::new(PanelSetup::new(&mesh, Options::default()).unwrap());
    let solve = |vertices: &[[f64; 3]], mach| setup.solve(vertices, mach, &NoMonitor).err().unwrap();
    for mach in [-0.1, 0.95, 1.2, f64::NAN] {
        assert!(matches!(
            solve(&mesh.vertices, mach),
            PanelError::OutOfRange { field, high: 0.9, .. } if field == "mach"
        ));
    }
    let mut vertices = mesh.vertices.clone();
    vertices[30][2] = f64::NAN;
    assert!(matches!(
        solve(&vertices, 0.0),
        PanelError::OutOfRange { field, .. } if field == "vertices[30][2]"
    ));
    assert_eq!(
        solve(&mesh.vertices[1..], 0.0),
        PanelError::Length { field: "vertices".to_owned(), got: 107, expected: 108 }
    );
    let mut vertices = mesh.vertices.clone();
    vertices[60][2] += 0.01;
    assert!(matches!(solve(&vertices, 0.0), PanelError::NotSymmetric(text) if text.contains("60")));
    let mut vertices = mesh.vertices.clone();
    for v in mesh.cells[50].vertices() {
        vertices[*v as usize] = [0.3, 0.1, 0.0];
    }
    let whole = Options { symmetry: Symmetry::None, ..Options::default() };
    let full = PanelSetup::new(&mesh, whole).unwrap();
    assert!(matches!(full.solve(&vertices, 0.0, &NoMonitor), Err(PanelError::ZeroArea { cell: 50, .. })));

    let solution = Arc::new(setup.solve(&mesh.vertices, 0.3, &NoMonitor).unwrap());
    assert_eq!(solution.analyse(&flow(0.1)).err(), Some(PanelError::Sideslip { sideslip: 0.1 }));
    let mut bad = flow(0.0);
    bad.reference.area = 0.0;
    assert!(matches!(
        solution.analyse(&bad),
        Err(PanelError::OutOfRange { field, .. }) if field == "flow.reference.area"
    ));
    let linearisation = solution.linearise(&flow(0.0)).unwrap();
    let seed = Outputs { cp: vec![1.0; 3], ..Outputs::default() };
    assert!(matches!(
        linearisation.vjp(&[seed], &NoMonitor),
        Err(PanelError::Length { field, got: 3, .. }) if field == "seeds[0].cp"
    ));
    let direction = Inputs { alpha: f64::INFINITY, ..Inputs::default() };
    assert!(matches!(
        linearisation.jvp(&[direction], &NoMonitor),
        Err(PanelError::OutOfRange { field, .. }) if field == "directions[0].alpha"
    ));
}

/// A box of two by two by two cells.
fn block(builder: &mut Builder, low: [f64; 3], size: [f64; 3]) {
    for axis in 0..3 {
        for side in 0..2 {
            for i in 0..2 {
                for j in 0..2 {
                    let corner = |u: usize, v: usize| {
                        let mut p = low;
                        p[axis] += size[axis] * side as f64;
                        p[(axis + 1) % 3] += size[(axis + 1) % 3] * 0.5 * u as f64;
                        p[(axis + 2) % 3] += size[(axis + 2) % 3] * 0.5 * v as f64;
                        p
                    };
                    let mut cell = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                    if side == 0 {
                        cell.reverse();
                    }
                    builder.cell(&cell);
                }
            }
        }
    }
}

#[test]
fn a_wake_that_cuts_a_body() {
    let plain = wing(false, false);
    let mut builder = Builder::default();
    for cell in &plain.cells {
        let corners: Vec<[f64; 3]> = cell.vertices().iter().map(|v| plain.vertices[*v as usize]).collect();
        builder.cell(&corners);
    }
    let first = plain.cells.len() as u32;
    block(&mut builder, [4.0, 0.3, -1.0], [1.0, 0.6, 2.0]);
    let mesh = builder.finish();
    let setup = PanelSetup::new(&mesh, Options { symmetry: Symmetry::None, ..Options::default() }).unwrap();
    match setup.solve(&mesh.vertices, 0.0, &NoMonitor) {
        Err(PanelError::WakeCutsBody { cell, x, .. }) => assert!(cell >= first && (4.0..=5.0).contains(&x)),
        other => panic!("{:?}", other.err()),
    }
    // Above the wake there is room.
    let mut vertices = mesh.vertices.clone();
    for cell in &mesh.cells[first as usize..] {
        for v in cell.vertices() {
            vertices[*v as usize][2] = mesh.vertices[*v as usize][2] + 3.0;
        }
    }
    assert!(setup.solve(&vertices, 0.0, &NoMonitor).is_ok());
}

struct Impatient;

impl Monitor<Stage> for Impatient {
    fn progress(&self, _: Stage, _: f64) {}

    fn cancelled(&self) -> bool {
        true
    }
}

#[test]
fn cancelled_work_stops() {
    let mesh = wing(false, false);
    for solver in [Solver::Double, Solver::Single, Solver::Iterative] {
        let setup = Arc::new(PanelSetup::new(&mesh, Options { solver, ..Options::default() }).unwrap());
        assert_eq!(setup.solve(&mesh.vertices, 0.0, &Impatient).err(), Some(PanelError::Cancelled));
        let solution = Arc::new(setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap());
        let linearisation = solution.linearise(&flow(0.0)).unwrap();
        assert_eq!(linearisation.vjp(&[Outputs::default()], &Impatient).err(), Some(PanelError::Cancelled));
    }
}
