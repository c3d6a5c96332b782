//! Readers against files that Gmsh and VTK wrote, round trips, and broken files.

use std::collections::BTreeSet;

use moldline_mesh::{
    Cell, Group, LeftOut, Limits, SurfaceMesh, Topology,
    io::{Imported, Place, ReadError, msh, stl, vtu},
    topology::enclosed_volume,
};
use proptest::prelude::*;

const MSH: [&[u8]; 4] = [
    include_bytes!("fixtures/box_v22_ascii.msh"),
    include_bytes!("fixtures/box_v22_binary.msh"),
    include_bytes!("fixtures/box_v41_ascii.msh"),
    include_bytes!("fixtures/box_v41_binary.msh"),
];

const VTU: [&[u8]; 13] = [
    include_bytes!("fixtures/box_ascii_plain_raw_32_le.vtu"),
    include_bytes!("fixtures/box_binary_plain_base64_32_le.vtu"),
    include_bytes!("fixtures/box_binary_plain_base64_64_le.vtu"),
    include_bytes!("fixtures/box_binary_plain_base64_64_be.vtu"),
    include_bytes!("fixtures/box_binary_zlib_base64_32_le.vtu"),
    include_bytes!("fixtures/box_binary_zlib_base64_64_le.vtu"),
    include_bytes!("fixtures/box_appended_plain_base64_32_le.vtu"),
    include_bytes!("fixtures/box_appended_plain_base64_64_le.vtu"),
    include_bytes!("fixtures/box_appended_plain_raw_32_le.vtu"),
    include_bytes!("fixtures/box_appended_zlib_base64_32_le.vtu"),
    include_bytes!("fixtures/box_appended_zlib_base64_64_le.vtu"),
    include_bytes!("fixtures/box_appended_zlib_raw_32_be.vtu"),
    include_bytes!("fixtures/box_appended_zlib_raw_64_le.vtu"),
];

const STL: [&[u8]; 2] = [include_bytes!("fixtures/box_ascii.stl"), include_bytes!("fixtures/box_binary.stl")];

fn limits() -> Limits {
    Limits::default()
}

fn names(groups: &[Group]) -> BTreeSet<&str> {
    groups.iter().map(|group| group.name.as_str()).collect()
}

/// Each cell as its corners' coordinates (in 1e-12, since Gmsh writes ASCII with 16 digits) from the smallest on, so that
/// numbering does not matter.
fn cells_by_position(mesh: &SurfaceMesh) -> Vec<Vec<[i64; 3]>> {
    let corners = |cell: &Cell| {
        let mut corners: Vec<[i64; 3]> = cell
            .vertices()
            .iter()
            .map(|&v| mesh.vertices[v as usize].map(|x| (x * 1e12).round() as i64))
            .collect();
        let least = (0..corners.len()).min_by_key(|&k| corners[k]).expect("a cell has corners");
        corners.rotate_left(least);
        corners
    };
    let mut cells: Vec<_> = mesh.cells.iter().map(corners).collect();
    cells.sort();
    cells
}

/// The box of the fixtures: 1 by 0.7 by 0.4, with its groups.
#[test]
fn gmsh_files_of_both_versions_are_read_alike() {
    let read = MSH.map(|bytes| msh::read(bytes, &limits()).unwrap());
    for imported in &read[1..] {
        assert_eq!(cells_by_position(&imported.mesh), cells_by_position(&read[0].mesh));
    }
    for Imported { mesh, origin } in &read {
        let topology = Topology::new(mesh);
        assert!(
            topology.non_manifold_edges.is_empty() && topology.open_edges(&mesh.vertices, None).is_empty()
        );
        assert_eq!((topology.euler(), origin.left_out), (2, LeftOut::default()));
        assert_eq!(origin.nodes.len(), mesh.vertices.len());
        assert_eq!(names(&mesh.cell_groups), BTreeSet::from(["ends", "the sides", "two of them"]));
        assert_eq!(names(&mesh.vertex_groups), BTreeSet::from(["corners", "rim"]));
        let x = |v: &u32| mesh.vertices[*v as usize][0];
        // The ends are x = 0 and x = 1; the rim goes round the first of them.
        for (index, cell) in mesh.cells.iter().enumerate() {
            let on_end = [0.0, 1.0].iter().any(|end| cell.vertices().iter().all(|v| x(v) == *end));
            for (name, expected) in [("ends", on_end), ("the sides", !on_end)] {
                let found = mesh.cell_group(name).unwrap().indices.contains(&(index as u32));
                assert_eq!(found, expected, "{name}: cell {index}");
            }
        }
        let rim = &mesh.vertex_group("rim").unwrap().indices;
        let on_rim = |p: &[f64; 3]| p[0] == 0.0 && (p[1] % 0.7 == 0.0 || p[2] % 0.4 == 0.0);
        let expected: Vec<u32> =
            (0..mesh.vertices.len() as u32).filter(|&v| on_rim(&mesh.vertices[v as usize])).collect();
        assert_eq!(rim, &expected);
        let corners: Vec<[f64; 3]> = mesh
            .vertex_group("corners")
            .unwrap()
            .indices
            .iter()
            .map(|&v| mesh.vertices[v as usize])
            .collect();
        assert_eq!(corners, [[0.0, 0.0, 0.4], [1.0, 0.0, 0.4]]);
        let both = mesh.cells.iter().filter(|cell| cell.is_triangle()).count();
        assert!(both > 0 && both < mesh.cells.len());
    }
}

#[test]
fn vtk_files_of_every_encoding_are_read_alike() {
    let read = VTU.map(|bytes| vtu::read(bytes, &limits()).unwrap());
    for imported in &read {
        assert_eq!(imported, &read[0]);
    }
    let from_gmsh = msh::read(MSH[3], &limits()).unwrap();
    assert_eq!(cells_by_position(&read[0].mesh), cells_by_position(&from_gmsh.mesh));
}

#[test]
fn stl_vertices_are_merged() {
    let from_gmsh = msh::read(MSH[3], &limits()).unwrap().mesh;
    let triangles: usize = from_gmsh.cells.iter().map(|cell| cell.vertices().len() - 2).sum();
    for bytes in STL {
        for tolerance in [0.0, 1e-5] {
            let Imported { mesh, origin } = stl::read(bytes, tolerance, &limits()).unwrap();
            assert_eq!((mesh.cells.len(), origin.left_out), (triangles, LeftOut::default()));
            assert_eq!(mesh.vertices.len(), from_gmsh.vertices.len());
            let topology = Topology::new(&mesh);
            assert!(topology.boundary_edges.is_empty() && topology.euler() == 2);
        }
        // Every triangle collapses once all vertices are one.
        let all = stl::read(bytes, 10.0, &limits()).unwrap_err();
        assert!(matches!(all, ReadError::MergeTolerance { .. }), "{all}");
    }
    let ascii = "solid left\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n vertex 0 1 0\n endloop\n \
                 endfacet\nendsolid left\nSOLID right\nfacet normal nan nan nan outer loop vertex 1.0000001 0 -0 vertex 1 1 \
                 0 vertex 0 1 0 endloop endfacet\nfacet normal 0 0 1 outer loop vertex 1 0 0 vertex 1.0000001 0 0 vertex 1 1 0 \
                 endloop endfacet\nendsolid";
    let exact = stl::read(ascii.as_bytes(), 0.0, &limits()).unwrap();
    assert_eq!(
        (exact.mesh.vertices.len(), exact.mesh.cells.len(), exact.origin.left_out.collapsed_cells),
        (5, 3, 0)
    );
    let merged = stl::read(ascii.as_bytes(), 1e-6, &limits()).unwrap();
    assert_eq!(
        (merged.mesh.vertices.len(), merged.mesh.cells.len(), merged.origin.left_out.collapsed_cells),
        (4, 2, 1)
    );
    assert_eq!(merged.mesh.cell_group("left").unwrap().indices, [0]);
    assert_eq!(merged.mesh.cell_group("right").unwrap().indices, [1]);
    assert_eq!(merged.origin.nodes, [0, 1, 2, 4]);
}

#[test]
fn what_is_written_is_read_back() {
    let mut mesh = msh::read(MSH[2], &limits()).unwrap().mesh;
    mesh.vertices[0][1] = -1.234_567_890_123_456_7e-300;
    mesh.vertices[1][2] = 0.1 + 0.2;
    for version in [msh::Version::V2, msh::Version::V4] {
        let mut again = msh::read(&msh::write(&mesh, version), &limits()).unwrap().mesh;
        again.vertex_groups.sort_by_key(|group| mesh.vertex_groups.iter().position(|g| g.name == group.name));
        assert_eq!(again, mesh);
    }
    let speed: Vec<f64> = (0..3 * mesh.vertices.len()).map(|k| k as f64).collect();
    let owner: Vec<i32> = (0..mesh.cells.len() as i32).collect();
    let flags = vec![1_u8; mesh.cells.len()];
    let point_data =
        [vtu::Array { name: "a < b & \"c\"", components: 3, values: vtu::Values::Float64(&speed) }];
    let cell_data = [
        vtu::Array { name: "owner", components: 1, values: vtu::Values::Int32(&owner) },
        vtu::Array { name: "flag", components: 1, values: vtu::Values::UInt8(&flags) },
    ];
    mesh.cell_groups[0].name = "<&>\"'".to_owned();
    let bytes = vtu::write(&mesh, &point_data, &cell_data);
    assert_eq!(vtu::read(&bytes, &limits()).unwrap().mesh, mesh);
}

#[test]
fn volume_cells_and_stray_nodes_are_left_out() {
    let text = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Comments\nany $thing\n$EndComments\n$Nodes\n6\n10 0 0 0\n20 1 0 0\n30 0 \
                1 0\n40 0 0 1\n50 9 9 9\n60 1 1 0\n$EndNodes\n$Elements\n4\n1 2 2 7 1 10 20 30\n2 4 2 0 1 10 20 30 40\n3 2 0 20 60 30\n4 2 2 8 1 \
                10 20 30\n$EndElements\n";
    let read = msh::read(text.as_bytes(), &limits()).unwrap();
    assert_eq!((read.origin.left_out.nodes, read.origin.left_out.other_cells), (2, 1));
    assert_eq!(read.origin.nodes, [10, 20, 30, 60]);
    // The last element repeats the first for its second physical group.
    assert_eq!(read.mesh.cells, [Cell::triangle(0, 1, 2), Cell::triangle(1, 3, 2)]);
    assert_eq!(
        read.mesh.cell_group("physical 7"),
        Some(&Group { name: "physical 7".into(), indices: vec![0] })
    );
    assert_eq!(read.mesh.cell_group("physical 8").unwrap().indices, [0]);
}

#[test]
fn errors_name_the_line_or_the_byte() {
    let good = std::str::from_utf8(MSH[0]).unwrap();
    let error = |text: &str| msh::read(text.as_bytes(), &limits()).unwrap_err();

    let line = 1 + good.lines().position(|line| line == "$Nodes").unwrap() + 3;
    let broken: Vec<&str> =
        good.lines().enumerate().map(|(k, text)| if k + 1 == line { "3 0 zero 0" } else { text }).collect();
    let found = error(&broken.join("\n"));
    assert_eq!(found.to_string(), format!("line {line}: expected a coordinate, found `zero`"));

    match error(&good.replace("$Nodes\n30\n", "$Nodes\n4000000000\n")) {
        ReadError::TooMany { what: "nodes", count: 4_000_000_000, limit, .. } => assert!(limit < 1000),
        other => panic!("{other}"),
    }
    assert!(matches!(
        error(&good.replace("2.2 0 8", "3.0 0 8")),
        ReadError::Unsupported { place: Place::Line(2), .. }
    ));
    assert!(matches!(error(&good.replace("2.2 0 8", "2.2 0 4")), ReadError::Unsupported { .. }));
    assert!(matches!(error(&good.replace("$EndNodes", "$EndNode")), ReadError::Unexpected { .. }));
    assert!(matches!(error("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"), ReadError::Missing { what: "nodes" }));
    let quadratic = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n1\n1 9 0 1 1 1 1 1 1\n";
    assert!(matches!(error(quadratic), ReadError::Unsupported { place: Place::Line(10), .. }));
    let unknown =
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0\n$EndNodes\n$Elements\n1\n1 2 0 1 -1 1\n";
    assert!(matches!(error(unknown), ReadError::UnknownNode { place: Place::Line(10), .. }));
    let tight = Limits { vertices: 10, ..limits() };
    assert!(matches!(msh::read(MSH[3], &tight), Err(ReadError::TooMany { what: "nodes", limit: 10, .. })));
    assert!(matches!(vtu::read(VTU[0], &tight), Err(ReadError::TooMany { what: "points", limit: 10, .. })));
    assert!(matches!(stl::read(STL[0], 0.0, &tight), Err(ReadError::TooMany { what: "vertices", .. })));

    let vtu_text = std::str::from_utf8(VTU[0]).unwrap();
    let error = |text: String| vtu::read(text.as_bytes(), &limits()).unwrap_err();
    let huge = error(vtu_text.replace("NumberOfPoints=\"30\"", "NumberOfPoints=\"18446744073709551615\""));
    assert!(matches!(huge, ReadError::TooMany { what: "points", count: u64::MAX, .. }), "{huge}");
    let more = error(vtu_text.replace("NumberOfPoints=\"30\"", "NumberOfPoints=\"31\""));
    assert!(matches!(more, ReadError::Truncated { .. }), "{more}");
    let fewer = error(vtu_text.replace("NumberOfPoints=\"30\"", "NumberOfPoints=\"29\""));
    assert!(matches!(fewer, ReadError::Unexpected { .. }), "{fewer}");
    assert!(matches!(error(vtu_text.replace("Unstructured", "Poly")), ReadError::Unsupported { .. }));
    assert!(matches!(error("<VTKFile>".into()), ReadError::Missing { what: "Piece" }));
    assert!(matches!(error("plain text".into()), ReadError::Missing { what: "VTKFile" }));
}

/// A file that claims to inflate to more than it may.
#[test]
fn compressed_blocks_must_have_their_stated_length() {
    let text = String::from_utf8_lossy(VTU[4]);
    let header =
        text.find("format=\"binary\"").and_then(|at| text[at..].find('>').map(|end| at + end)).unwrap();
    let start = header + VTU[4][header..].iter().position(|byte| byte.is_ascii_alphanumeric()).unwrap();
    let mut outcomes = BTreeSet::new();
    for k in start..VTU[4].len() {
        let mut broken = VTU[4].to_vec();
        broken[k] = if broken[k] == b'B' { b'C' } else { b'B' };
        outcomes.insert(vtu::read(&broken, &limits()).is_ok());
    }
    assert_eq!(outcomes.len(), 2, "some bytes matter, those of arrays that are not read do not");
}

#[test]
fn truncation_anywhere_is_an_error_or_a_valid_mesh() {
    let mut errors = 0;
    let mut check = |result: Result<Imported, ReadError>| match result {
        Ok(imported) => assert_eq!(imported.mesh.validate(&limits()), Ok(())),
        Err(_) => errors += 1,
    };
    let mut total = 0;
    for bytes in MSH {
        (0..bytes.len()).for_each(|length| check(msh::read(&bytes[..length], &limits())));
        total += bytes.len();
    }
    for bytes in VTU {
        (0..bytes.len()).for_each(|length| check(vtu::read(&bytes[..length], &limits())));
        total += bytes.len();
    }
    for bytes in STL {
        (0..bytes.len()).for_each(|length| check(stl::read(&bytes[..length], 1e-6, &limits())));
        total += bytes.len();
    }
    // Only what follows the last number may be missing.
    assert!(errors > total * 9 / 10, "{errors} of {total}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn changed_bytes_never_panic(
        which in 0..19_usize,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let files: Vec<&[u8]> = [&MSH[..], &VTU[..], &STL[..]].concat();
        let mut bytes = files[which].to_vec();
        for (index, value) in changes {
            let index = index.index(bytes.len());
            bytes[index] = value;
        }
        let tight = Limits { vertices: 1000, cells: 1000, groups: 100, name: 256, coordinate: 1e6 };
        let read = match which {
            0..4 => msh::read(&bytes, &tight),
            4..17 => vtu::read(&bytes, &tight),
            _ => stl::read(&bytes, 1e-6, &tight),
        };
        if let Ok(imported) = read {
            prop_assert_eq!(imported.mesh.validate(&tight), Ok(()));
        }
    }

    #[test]
    fn any_triangles_survive_a_round_trip(
        points in prop::collection::vec(prop::array::uniform3(-1e6..1e6_f64), 3..40),
        quads in any::<bool>(),
    ) {
        let count = points.len() as u32 - 2;
        let cell = |k: u32| match quads && k + 3 < points.len() as u32 {
            true => Cell::quad(k, k + 1, k + 2, k + 3),
            false => Cell::triangle(k, k + 1, k + 2),
        };
        let cells: Vec<Cell> = (0..count).map(cell).collect();
        let groups = vec![Group { name: "odd".into(), indices: (0..count).filter(|k| k % 2 == 1).collect() }];
        let groups = if count > 1 { groups } else { vec![] };
        let ends = vec![Group { name: "ends".into(), indices: vec![0, count + 1] }];
        let mesh = SurfaceMesh::new(points, cells, groups, ends).unwrap();
        for version in [msh::Version::V2, msh::Version::V4] {
            prop_assert_eq!(&msh::read(&msh::write(&mesh, version), &limits()).unwrap().mesh, &mesh);
        }
        prop_assert_eq!(&vtu::read(&vtu::write(&mesh, &[], &[]), &limits()).unwrap().mesh, &mesh);
    }
}

#[test]
fn gmsh_orientation_gives_the_volume_of_the_box() {
    let mut mesh = msh::read(MSH[3], &limits()).unwrap().mesh;
    let topology = Topology::new(&mesh);
    moldline_mesh::orientation::orient_outwards(&mesh.vertices, &mut mesh.cells, &topology, None).unwrap();
    assert!((enclosed_volume(&mesh.vertices, &mesh.cells, None) - 0.28).abs() < 1e-15);
}

/// Reading takes a time in proportion to the length: a reader that looks back over the whole file at each number would
/// take hours over this one.
#[test]
fn large_files_are_read_through() {
    let n = 400_u32;
    let vertices = (0..=n).flat_map(|i| (0..=n).map(move |j| [f64::from(i), f64::from(j), 0.0])).collect();
    let quad = |i: u32, j: u32| {
        let a = i * (n + 1) + j;
        Cell::quad(a, a + n + 1, a + n + 2, a + 1)
    };
    let cells = (0..n).flat_map(|i| (0..n).map(move |j| quad(i, j))).collect();
    let mesh = SurfaceMesh::new(vertices, cells, vec![], vec![]).unwrap();
    for version in [msh::Version::V2, msh::Version::V4] {
        assert_eq!(msh::read(&msh::write(&mesh, version), &limits()).unwrap().mesh, mesh);
    }
    assert_eq!(vtu::read(&vtu::write(&mesh, &[], &[]), &limits()).unwrap().mesh, mesh);
    let mut ascii = "solid\n".to_owned();
    for cell in &mesh.cells {
        ascii.push_str("facet normal 0 0 1 outer loop\n");
        for &v in &cell.vertices()[..3] {
            let [x, y, z] = mesh.vertices[v as usize];
            ascii.push_str(&format!("vertex {x} {y} {z}\n"));
        }
        ascii.push_str("endloop endfacet\n");
    }
    ascii.push_str("endsolid\n");
    assert_eq!(stl::read(ascii.as_bytes(), 1e-9, &limits()).unwrap().mesh.cells.len(), mesh.cells.len());
}

/// What zlib makes of a file is known before it is made, for points, cells and every group.
#[test]
fn what_compressed_files_become_is_announced() {
    let limits = Limits::default();
    let plain = include_bytes!("fixtures/box_binary_zlib_base64_32_le.vtu");
    let small = vtu::inflated(plain, &limits);
    let mesh = vtu::read(plain, &limits).unwrap().mesh;
    assert!(small >= (48 * mesh.vertices.len() + 16 * mesh.cells.len()) as u64);
    assert_eq!(vtu::inflated(include_bytes!("fixtures/box_appended_plain_raw_32_le.vtu"), &limits), 0);
    let announced = |points: &str, cells: &str, groups: usize| {
        let group = "<DataArray type=\"UInt8\" Name=\"group:g\" format=\"appended\" offset=\"0\"/>";
        let text = format!(
            "<VTKFile type=\"UnstructuredGrid\" byte_order=\"LittleEndian\" header_type=\"UInt64\" \
             compressor=\"vtkZLibDataCompressor\"><Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\"><PointData>{}\
             </PointData></Piece></VTKFile>",
            group.repeat(groups)
        );
        vtu::inflated(text.as_bytes(), &limits)
    };
    assert_eq!(announced("1000", "0", 100) - announced("1000", "0", 0), 4 * 1000 * 100);
    assert!(
        announced("18446744073709551615", "18446744073709551615", 1000) > 4 * 1000 * limits.vertices as u64
    );
}
