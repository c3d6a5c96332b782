//! Validation, topology, orientation, symmetry, distances along the mesh, and Laplacians on surfaces known in closed form.

use moldline_mesh::{
    Cell, Group, Laplacian, Limits, MeshError, Plane, SurfaceMesh, Topology, graph, graph_distance,
    nearest_source, nearest_sources,
    orientation::{OrientationError, orient, orient_outwards},
    symmetry::{SymmetryError, pair_vertices},
    topology::enclosed_volume,
    vertex_normals,
};
use proptest::prelude::*;

/// The unit cube's surface, `n` by `n` quadrilaterals a side, as an outward oriented mesh; `keep` selects cells by centre.
fn cube(n: u32, keep: impl Fn([f64; 3]) -> bool) -> SurfaceMesh {
    let mut index = std::collections::HashMap::new();
    let (mut vertices, mut cells) = (Vec::new(), Vec::new());
    for axis in 0..3 {
        for side in 0..2 {
            for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
                let point = |i: u32, j: u32| {
                    let mut key = [0; 3];
                    key[axis] = side * n;
                    key[(axis + 1) % 3] = i;
                    key[(axis + 2) % 3] = j;
                    key
                };
                let corners = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
                let position = |key: [u32; 3]| key.map(|k| f64::from(k) / f64::from(n));
                let mut centre = [0.0; 3];
                for corner in corners {
                    (0..3).for_each(|k| centre[k] += 0.25 * position(corner)[k]);
                }
                if !keep(centre) {
                    continue;
                }
                let [a, b, c, d] = corners.map(|key| {
                    *index.entry(key).or_insert_with(|| {
                        vertices.push(position(key));
                        vertices.len() as u32 - 1
                    })
                });
                let quad = Cell::quad(a, b, c, d);
                cells.push(if side == 1 { quad } else { quad.flipped() });
            }
        }
    }
    SurfaceMesh::new(vertices, cells, vec![], vec![]).expect("a valid mesh")
}

/// A flat grid of `n` by `n` squares of side `1 / n`, cells upwards.
fn plate(n: u32) -> SurfaceMesh {
    let at = |k: u32| f64::from(k) / f64::from(n);
    let vertices = (0..=n).flat_map(|i| (0..=n).map(move |j| [at(i), at(j), 0.0])).collect();
    let quad = |i: u32, j: u32| {
        let a = i * (n + 1) + j;
        Cell::quad(a, a + n + 1, a + n + 2, a + 1)
    };
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| quad(i, j))).collect();
    SurfaceMesh::new(vertices, cells, vec![], vec![]).expect("a valid mesh")
}

#[test]
fn faults_are_named() {
    let square = vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let quad = vec![Cell::quad(0, 1, 2, 3)];
    let new = |vertices: &Vec<[f64; 3]>, cells: &Vec<Cell>| {
        SurfaceMesh::new(vertices.clone(), cells.clone(), vec![], vec![])
    };
    assert!(new(&square, &quad).is_ok());
    assert_eq!(new(&vec![], &quad), Err(MeshError::Empty { what: "vertices" }));
    assert_eq!(new(&square, &vec![]), Err(MeshError::Empty { what: "cells" }));
    let out = new(&square, &vec![Cell::quad(0, 1, 2, 3), Cell::triangle(0, 1, 7)]).unwrap_err();
    assert_eq!(out, MeshError::VertexOutOfRange { cell: 1, corner: 2, vertex: 7, count: 4 });
    assert_eq!(out.to_string(), "cells[1][2] = 7 is outside 0..4");
    let repeated = new(&square, &vec![Cell::quad(0, 1, 2, 1)]).unwrap_err();
    assert_eq!(repeated, MeshError::RepeatedVertex { cell: 0, vertex: 1, vertices: Cell::quad(0, 1, 2, 1) });
    let unused = new(&square, &vec![Cell::triangle(0, 1, 3)]).unwrap_err();
    assert_eq!(unused, MeshError::UnusedVertices { count: 1, first: 2 });
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e13] {
        let mut vertices = square.clone();
        vertices[2][1] = value;
        match new(&vertices, &quad).unwrap_err() {
            MeshError::Coordinate { vertex: 2, axis: 1, .. } => {}
            other => panic!("{other:?}"),
        }
    }
    let limits = Limits { vertices: 3, ..Limits::default() };
    let many = SurfaceMesh::with_limits(square.clone(), quad.clone(), vec![], vec![], &limits).unwrap_err();
    assert_eq!(many, MeshError::TooMany { what: "vertices", count: 4, limit: 3 });
    let group = |index: u32| vec![Group { name: "g".into(), indices: vec![0, index] }];
    assert!(SurfaceMesh::new(square.clone(), quad.clone(), vec![], group(3)).is_ok());
    let outside = SurfaceMesh::new(square.clone(), quad.clone(), group(1), vec![]).unwrap_err();
    let name = "g".to_owned();
    let expected =
        MeshError::GroupIndexOutOfRange { kind: "cell", group: name, position: 1, index: 1, count: 1 };
    assert_eq!(outside, expected);
    let twice = [group(1), group(2)].concat();
    let twice = SurfaceMesh::new(square, quad, vec![], twice).unwrap_err();
    assert_eq!(twice, MeshError::DuplicateGroup { kind: "vertex", group: "g".into() });
}

#[test]
fn cube_is_closed_and_has_its_volume() {
    let n = 5;
    let mesh = cube(n, |_| true);
    let topology = Topology::new(&mesh);
    assert_eq!(mesh.vertices.len() as u32, 6 * n * n + 2);
    assert_eq!(topology.edges.len() as u32, 12 * n * n);
    assert_eq!((topology.euler(), topology.pieces), (2, 1));
    assert!(topology.is_watertight(&mesh.vertices, None));
    assert!((enclosed_volume(&mesh.vertices, &mesh.cells, None) - 1.0).abs() < 1e-14);
    let valences = topology.vertex_neighbours.rows().filter(|row| row.len() == 3).count();
    assert_eq!(valences, 8);
    for (edge, cells) in topology.edges.iter().zip(topology.edge_cells.rows()) {
        assert_eq!(topology.edge_between(edge[1], edge[0]).map(|e| topology.edges[e as usize]), Some(*edge));
        for &cell in cells {
            assert!(mesh.cells[cell as usize].edges().any(|[a, b]| [a.min(b), a.max(b)] == *edge));
        }
    }
}

#[test]
fn warped_quadrilateral_counts_as_bilinear_patch() {
    // The cube with one upper corner raised by h gains h/4 under the bilinear top and h/3 beside... the sides' triangles
    // add nothing outside their planes: the gain is the integral of h u v over the top.
    let mut mesh = cube(1, |_| true);
    let corner = mesh.vertices.iter().position(|x| *x == [1.0; 3]).unwrap();
    mesh.vertices[corner][2] = 1.4;
    let volume = enclosed_volume(&mesh.vertices, &mesh.cells, None);
    assert!((volume - (1.0 + 0.4 / 4.0)).abs() < 1e-14, "{volume}");
}

#[test]
fn holes_count_unless_they_lie_on_the_symmetry_plane() {
    let half = cube(4, |centre| centre[1] > 0.0);
    let plane = Plane::y_zero();
    let topology = Topology::new(&half);
    assert_eq!(topology.boundary_edges.len(), 16);
    assert!(!topology.is_watertight(&half.vertices, None));
    assert!(topology.is_watertight(&half.vertices, Some((&plane, 1e-12))));
    assert!((enclosed_volume(&half.vertices, &half.cells, Some(&plane)) - 1.0).abs() < 1e-14);
    let other = Plane::new([0.0, 2.0, 0.0], 1.0).unwrap();
    assert_eq!(topology.open_edges(&half.vertices, Some((&other, 1e-12))).len(), 16);

    let mut holed = cube(4, |_| true);
    holed.cells.remove(40);
    let topology = Topology::new(&holed);
    assert_eq!((topology.boundary_edges.len(), topology.euler()), (4, 1));
    let mut twisted = cube(2, |_| true);
    twisted.cells[3] = twisted.cells[3].flipped();
    let topology = Topology::new(&twisted);
    assert_eq!(topology.inconsistent_edges.len(), 4);
    let mut finned = cube(1, |_| true);
    finned.vertices.push([2.0, 2.0, 2.0]);
    let [a, b] = [finned.cells[0].vertices()[0], finned.cells[0].vertices()[1]];
    finned.cells.push(Cell::triangle(a, b, 8));
    let topology = Topology::new(&finned);
    assert_eq!(topology.non_manifold_edges.len(), 1);
    assert_eq!(topology.edges[topology.non_manifold_edges[0] as usize], [a.min(b), a.max(b)]);
    assert!(!topology.is_watertight(&finned.vertices, None));
}

#[test]
fn moebius_band_cannot_be_oriented() {
    let n = 7_u32;
    let vertices: Vec<[f64; 3]> = (0..2 * n)
        .map(|k| {
            let turn = f64::from(k / 2) / f64::from(n) * std::f64::consts::TAU;
            let r = if k % 2 == 0 { -0.3 } else { 0.3 };
            let (s, c) = (0.5 * turn).sin_cos();
            [(1.0 + r * c) * turn.cos(), (1.0 + r * c) * turn.sin(), r * s]
        })
        .collect();
    let mut cells: Vec<Cell> =
        (0..n - 1).map(|i| Cell::quad(2 * i, 2 * i + 2, 2 * i + 3, 2 * i + 1)).collect();
    cells.push(Cell::quad(2 * n - 2, 1, 0, 2 * n - 1));
    let mesh = SurfaceMesh::new(vertices, cells.clone(), vec![], vec![]).unwrap();
    let topology = Topology::new(&mesh);
    let error = orient(&mut cells, &topology).unwrap_err();
    assert!(matches!(error, OrientationError::OneSided { .. }));
    assert_eq!(cells, mesh.cells);
}

proptest! {
    #[test]
    fn random_flips_are_undone(flips in prop::collection::vec(any::<bool>(), 54), inside_out: bool) {
        let mesh = cube(3, |_| true);
        let half = cube(3, |centre| centre[1] > 0.0);
        let plane = Plane::y_zero();
        for (mesh, symmetry) in [(mesh, None), (half, Some((&plane, 1e-9)))] {
            let mut cells = mesh.cells.clone();
            for (cell, flip) in cells.iter_mut().zip(&flips) {
                if *flip ^ inside_out {
                    *cell = cell.flipped();
                }
            }
            let given = cells.clone();
            let topology = Topology::of_cells(mesh.vertices.len(), &cells);
            let flipped = orient_outwards(&mesh.vertices, &mut cells, &topology, symmetry).unwrap();
            prop_assert_eq!(&cells, &mesh.cells);
            for k in 0..cells.len() {
                prop_assert_eq!(flipped[k], given[k] != mesh.cells[k]);
            }
            let mut alike = given;
            orient(&mut alike, &topology).unwrap();
            prop_assert!(Topology::of_cells(mesh.vertices.len(), &alike).inconsistent_edges.is_empty());
        }
    }
}

#[test]
fn mirror_pairs_are_found_within_the_tolerance() {
    let mut mesh = cube(4, |_| true);
    for x in &mut mesh.vertices {
        x[1] -= 0.5;
    }
    let plane = Plane::y_zero();
    let mirror = pair_vertices(&mesh.vertices, &plane, 0.0).unwrap();
    let mut own = 0;
    for (v, &m) in mirror.iter().enumerate() {
        assert_eq!(plane.mirror(&mesh.vertices[v]), mesh.vertices[m as usize]);
        assert_eq!(mirror[m as usize] as usize, v);
        own += usize::from(m as usize == v);
    }
    assert_eq!(own, 16);

    let [a, b] = [3, 17];
    let off = mesh.vertices.iter().position(|x| x[1] > 0.1).unwrap();
    mesh.vertices[off][0] += 1e-6;
    assert_eq!(pair_vertices(&mesh.vertices, &plane, 2e-6).unwrap(), mirror, "{a} {b}");
    match pair_vertices(&mesh.vertices, &plane, 0.5e-6).unwrap_err() {
        SymmetryError::Unpaired { count: 2, vertex, position, .. } => {
            assert_eq!(vertex, off.min(mirror[off] as usize));
            assert_eq!(position, mesh.vertices[vertex]);
        }
        other => panic!("{other:?}"),
    }
    assert!(Plane::new([0.0; 3], 1.0).is_err() && Plane::new([f64::NAN, 0.0, 1.0], 1.0).is_err());
}

#[test]
fn distances_on_a_plate_are_those_of_the_taxicab() {
    let n = 12;
    let mesh = plate(n);
    let topology = Topology::new(&mesh);
    let sources = [0, 5 * (n + 1) + 7, (n + 1) * (n + 1) - 1];
    let taxicab = |a: u32, b: u32| {
        let [a, b] = [mesh.vertices[a as usize], mesh.vertices[b as usize]];
        (a[0] - b[0]).abs() + (a[1] - b[1]).abs()
    };
    let nearest = nearest_source(&topology, &mesh.vertices, &sources, |_| true);
    let three = nearest_sources(&topology, &mesh.vertices, &sources, 2, f64::INFINITY, |_| true);
    for v in 0..mesh.vertices.len() as u32 {
        let mut expected: Vec<f64> = sources.iter().map(|&s| taxicab(s, v)).collect();
        assert!((nearest.distance[v as usize] - taxicab(nearest.source[v as usize], v)).abs() < 1e-13);
        expected.sort_by(f64::total_cmp);
        assert!((nearest.distance[v as usize] - expected[0]).abs() < 1e-13);
        let found: Vec<(u32, f64)> = three.of(v as usize).collect();
        assert_eq!(found.len(), 2);
        for ((source, distance), expected) in found.into_iter().zip(expected) {
            assert!((distance - expected).abs() < 1e-13 && (distance - taxicab(source, v)).abs() < 1e-13);
        }
    }

    // A wall with a gap at one end: the way leads round it.
    let wall = |v: u32| v / (n + 1) == 6 && v % (n + 1) != n;
    let distance = graph_distance(&topology, &mesh.vertices, &[0], |v| !wall(v));
    assert!((distance[(12 * (n + 1)) as usize] - 3.0).abs() < 1e-13);
    assert!(distance[(6 * (n + 1)) as usize].is_infinite());
    let closed = nearest_source(&topology, &mesh.vertices, &[0, 6 * (n + 1)], |v| v / (n + 1) != 6);
    assert_eq!(closed.source[(12 * (n + 1)) as usize], graph::UNREACHED);
    let near = nearest_sources(&topology, &mesh.vertices, &[0], 4, 0.25, |_| true);
    assert_eq!((0..mesh.vertices.len()).filter(|&v| near.of(v).len() == 1).count(), 10);
}

/// A plate whose inner vertices are moved, in its plane and out of it.
fn rough_plate(n: u32, height: f64) -> (SurfaceMesh, Topology) {
    let mut mesh = plate(n);
    for (v, x) in mesh.vertices.iter_mut().enumerate() {
        let phase = v as f64;
        if x[0] > 0.0 && x[0] < 1.0 && x[1] > 0.0 && x[1] < 1.0 {
            x[0] += 0.25 / f64::from(n) * (1.3 * phase).sin();
            x[1] += 0.25 / f64::from(n) * (2.1 * phase).cos();
        }
        x[2] = height * (x[0] * x[0] - 0.5 * x[1] * x[1]);
    }
    let topology = Topology::new(&mesh);
    (mesh, topology)
}

#[test]
fn reference_is_a_fixed_point_of_its_own_weights() {
    let (mesh, topology) = rough_plate(10, 0.0);
    let normals = vertex_normals(&mesh.vertices, &mesh.cells);
    let corner = |v: u32| topology.vertex_neighbours.row(v as usize).len() == 2;
    let kept = Laplacian::reference_preserving(&topology, &mesh.vertices, &normals, corner);
    let mut out = mesh.vertices.clone();
    kept.smooth(0.7, &mesh.vertices, &mut out);
    for (a, b) in out.iter().zip(&mesh.vertices) {
        assert!((0..3).all(|k| (a[k] - b[k]).abs() < 1e-14), "{a:?} {b:?}");
    }
    for v in 0..mesh.vertices.len() {
        let sum: f64 = kept.row(v).map(|(_, weight)| weight).sum();
        assert!(kept.row(v).all(|(_, weight)| weight > 0.0));
        assert!(if corner(v as u32) { sum == 0.0 } else { (sum - 1.0).abs() < 1e-14 });
    }
    // Equal weights do move it: the test above is not met by accident.
    let uniform = Laplacian::uniform(&topology, corner);
    uniform.smooth(0.7, &mesh.vertices, &mut out);
    let moved = out.iter().zip(&mesh.vertices).map(|(a, b)| (a[0] - b[0]).abs()).fold(0.0, f64::max);
    assert!(moved > 1e-3);

    // On a curved surface the inner vertices move along their normals only.
    let (mesh, topology) = rough_plate(10, 0.8);
    let normals = vertex_normals(&mesh.vertices, &mesh.cells);
    let kept = Laplacian::reference_preserving(&topology, &mesh.vertices, &normals, |_| false);
    let mut out = mesh.vertices.clone();
    kept.apply(&mesh.vertices, &mut out);
    let inner = (0..out.len()).filter(|&v| topology.vertex_neighbours.row(v).len() == 4);
    for v in inner {
        let (l, n) = (moldline_mesh::Vector3::from(out[v]), normals[v].normalize());
        assert!((l - n * l.dot(&n)).norm() < 1e-14, "{l}");
    }
}

#[test]
fn transposes_satisfy_the_dot_product_test() {
    let (mesh, topology) = rough_plate(9, 0.5);
    let normals = vertex_normals(&mesh.vertices, &mesh.cells);
    let fixed = |v: u32| v.is_multiple_of(7);
    let count = mesh.vertices.len();
    let wave = |frequency: f64| -> Vec<[f64; 3]> {
        (0..count).map(|v| [0.0, 1.0, 2.0].map(|k| (frequency * (v as f64 + 0.3) + k).sin())).collect()
    };
    let dot = |a: &[[f64; 3]], b: &[[f64; 3]]| -> f64 {
        a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
    };
    let (v, w) = (wave(1.1), wave(2.7));
    let mut out = v.clone();
    for laplacian in [
        Laplacian::uniform(&topology, fixed),
        Laplacian::reference_preserving(&topology, &mesh.vertices, &normals, fixed),
    ] {
        laplacian.apply(&v, &mut out);
        let forward = dot(&w, &out);
        laplacian.apply_transposed(&w, &mut out);
        assert!((forward - dot(&out, &v)).abs() < 1e-12 * forward.abs().max(1.0));
        laplacian.smooth(0.4, &v, &mut out);
        for k in (0..count).filter(|&k| fixed(k as u32)) {
            assert_eq!(out[k], v[k]);
        }
        let forward = dot(&w, &out);
        laplacian.smooth_transposed(0.4, &w, &mut out);
        assert!((forward - dot(&out, &v)).abs() < 1e-12 * forward.abs().max(1.0));
        // Constants lie in the kernel.
        laplacian.apply(&vec![[2.0, -1.0, 0.5]; count], &mut out);
        assert!(out.iter().flatten().all(|x| x.abs() < 1e-14));
    }
}
