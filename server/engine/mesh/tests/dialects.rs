//! Dialects of files: the same mesh written in every way that the formats allow is read alike, to the last bit.

use moldline_mesh::{
    Cell, Group, LeftOut, Limits, SurfaceMesh,
    io::{Imported, Place, ReadError, msh, stl, vtu},
};

/// How the numbers of an MSH file are coded.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Coding {
    Ascii,
    Little,
    Big,
}

/// What a file may have besides the mesh.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Extra {
    None,
    Mark,
    Comments,
    OtherSections,
    Parametric,
    Partitions,
    LinesOfWindows,
}

/// Writes the sections of one dialect.
struct Writer {
    out: Vec<u8>,
    version: &'static str,
    coding: Coding,
}

impl Writer {
    fn text(&mut self, text: &str) {
        self.out.extend_from_slice(text.as_bytes());
    }

    fn bytes(&mut self, little: &[u8]) {
        match self.coding {
            Coding::Big => self.out.extend(little.iter().rev()),
            _ => self.out.extend_from_slice(little),
        }
    }

    fn int(&mut self, value: i32) {
        match self.coding {
            Coding::Ascii => self.text(&format!("{value} ")),
            _ => self.bytes(&value.to_le_bytes()),
        }
    }

    fn ints(&mut self, values: &[i32]) {
        values.iter().for_each(|&value| self.int(value));
    }

    fn size(&mut self, value: usize) {
        match self.coding {
            Coding::Ascii => self.text(&format!("{value} ")),
            _ => self.bytes(&(value as u64).to_le_bytes()),
        }
    }

    fn sizes(&mut self, values: &[usize]) {
        values.iter().for_each(|&value| self.size(value));
    }

    /// A tag of a node or an element: 8 bytes in version 4.1, 4 before.
    fn tag(&mut self, value: usize) {
        if self.version == "4.1" { self.size(value) } else { self.int(value as i32) }
    }

    fn reals(&mut self, values: &[f64]) {
        for value in values {
            match self.coding {
                Coding::Ascii => self.text(&format!("{value:?} ")),
                _ => self.bytes(&value.to_le_bytes()),
            }
        }
    }

    fn end(&mut self) {
        if self.coding == Coding::Ascii {
            self.text("\n");
        }
    }

    fn section(&mut self, name: &str, write: impl FnOnce(&mut Self)) {
        self.text(&format!("${name}\n"));
        write(self);
        self.text(&format!("\n$End{name}\n"));
    }
}

/// Nodes of the file: a cube, and one that nothing uses, with gaps between their tags.
fn nodes() -> Vec<(usize, [f64; 3])> {
    let corner = |k: usize| [0, 1, 2].map(|axis| 0.1 + f64::from((k >> axis) as u32 & 1) * 1.3);
    (0..8).map(|k| (10 * k + 3, corner(k))).chain([(99, [7.0; 3])]).collect()
}

/// Physical group, entity, type and corners of each element: faces in two entities, a line, a point, a volume.
fn elements() -> Vec<(i32, i32, i32, Vec<usize>)> {
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3]].map(|q| (7, 1, 3, q.to_vec()));
    let triangles = [[0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]].map(|t| (8, 2, 2, t.to_vec()));
    let others = [(9, 1, 1, vec![0, 1]), (10, 1, 15, vec![5]), (0, 1, 4, vec![0, 1, 2, 4])];
    quads.into_iter().chain(triangles).chain(others).collect()
}

fn dimension(kind: i32) -> i32 {
    match kind {
        15 => 0,
        1 => 1,
        2 | 3 => 2,
        _ => 3,
    }
}

fn write(version: &'static str, coding: Coding, extra: Extra) -> Vec<u8> {
    let mut w = Writer { out: Vec::new(), version, coding };
    if extra == Extra::Mark {
        w.out.extend_from_slice(b"\xEF\xBB\xBF");
    }
    if extra == Extra::Comments {
        w.section("Comments", |w| w.text("$Nodes, made by a script"));
    }
    w.section("MeshFormat", |w| {
        w.text(&format!("{version} {} 8\n", i32::from(coding != Coding::Ascii)));
        if coding != Coding::Ascii {
            w.int(1);
        }
    });
    if extra == Extra::Comments {
        w.section("Comments", |w| w.text("between the sections"));
    }
    w.section("PhysicalNames", |w| {
        w.text("4\n2 7 \"the skin\"\n2 8 \"ends\"\n1 9 \"edge\"\n0 10 \"corner\"\n")
    });
    if version.starts_with('4') {
        entities(&mut w);
        if extra == Extra::Partitions {
            partitioned_entities(&mut w);
        }
        nodes_4(&mut w, extra == Extra::Parametric);
        elements_4(&mut w, extra == Extra::Partitions);
    } else {
        nodes_2(&mut w, extra == Extra::Parametric);
        elements_2(&mut w, extra == Extra::Partitions);
    }
    if extra == Extra::OtherSections {
        w.section("Periodic", |w| w.text("0\n"));
        w.section("NodeData", |w| w.text("1\n\"p\"\n1\n0.0\n3\n0\n1\n0\n"));
        w.section("MyOwn", |w| w.out.extend_from_slice(&[0, 1, 2, b'$', 255, b'\n']));
    }
    match extra {
        Extra::LinesOfWindows => {
            String::from_utf8(w.out).expect("is ASCII").replace('\n', "\r\n").into_bytes()
        }
        _ => w.out,
    }
}

/// Entities 1 of every dimension, and surface 2, with their groups.
fn entities(w: &mut Writer) {
    w.section("Entities", |w| {
        w.sizes(&[1, 1, 2, 1]);
        w.end();
        for (dimension, tag, physical) in [(0, 1, 10), (1, 1, 9), (2, 1, 7), (2, 2, 8), (3, 1, 0)] {
            w.int(tag);
            let point = dimension == 0 && w.version == "4.1";
            w.reals(&[0.5; 6][..if point { 3 } else { 6 }]);
            w.size(usize::from(physical > 0));
            w.ints(&[physical][..usize::from(physical > 0)]);
            if dimension > 0 {
                w.size(2);
                w.ints(&[1, -2]);
            }
            w.end();
        }
    });
}

/// Entities 11 of every dimension, and surface 12: parts of those above, some without groups of their own.
fn partitioned_entities(w: &mut Writer) {
    w.section("PartitionedEntities", |w| {
        w.size(2);
        w.end();
        w.size(1);
        w.ints(&[77, 2]);
        w.end();
        w.sizes(&[1, 1, 2, 1]);
        w.end();
        for (dimension, tag, parent, physical) in
            [(0, 11, 1, 10), (1, 11, 1, 9), (2, 11, 1, 0), (2, 12, 2, 8), (3, 11, 1, 0)]
        {
            w.ints(&[tag, dimension, parent]);
            w.size(2);
            w.ints(&[1, 2]);
            let point = dimension == 0 && w.version == "4.1";
            w.reals(&[0.5; 6][..if point { 3 } else { 6 }]);
            w.size(usize::from(physical > 0));
            w.ints(&[physical][..usize::from(physical > 0)]);
            if dimension > 0 {
                w.size(1);
                w.int(5);
            }
            w.end();
        }
    });
}

fn nodes_4(w: &mut Writer, parametric: bool) {
    let nodes = nodes();
    w.section("Nodes", |w| {
        w.sizes(&[2, nodes.len()]);
        if w.version == "4.1" {
            w.sizes(&[3, 99]);
        }
        w.end();
        for (dimension, block) in [(2, &nodes[..5]), (1, &nodes[5..])] {
            let entity = if w.version == "4.0" { [1, dimension] } else { [dimension, 1] };
            w.ints(&entity);
            w.int(i32::from(parametric));
            w.size(block.len());
            w.end();
            if w.version == "4.1" {
                for (tag, _) in block {
                    w.size(*tag);
                    w.end();
                }
            }
            for (tag, x) in block {
                if w.version == "4.0" {
                    w.int(*tag as i32);
                }
                w.reals(x);
                if parametric {
                    w.reals(&[0.25, 0.75][..dimension as usize]);
                }
                w.end();
            }
        }
    });
}

fn nodes_2(w: &mut Writer, parametric: bool) {
    let nodes = nodes();
    w.section(if parametric { "ParametricNodes" } else { "Nodes" }, |w| {
        w.text(&format!("{}\n", nodes.len()));
        for (k, (tag, x)) in nodes.iter().enumerate() {
            w.int(*tag as i32);
            w.reals(x);
            if parametric {
                let dimension = k % 4;
                w.ints(&[dimension as i32, 1]);
                w.reals(&[0.25, 0.75][..if dimension < 3 { dimension } else { 0 }]);
            }
            w.end();
        }
    });
}

fn elements_4(w: &mut Writer, partitions: bool) {
    let (elements, nodes) = (elements(), nodes());
    w.section("Elements", |w| {
        let blocks: Vec<_> = elements.chunk_by(|a, b| a.0 == b.0).collect();
        w.sizes(&[blocks.len(), elements.len()]);
        if w.version == "4.1" {
            w.sizes(&[201, 200 + elements.len()]);
        }
        w.end();
        let mut tag = 200;
        for block in blocks {
            let (_, entity, kind, _) = block[0];
            let entity = entity + if partitions { 10 } else { 0 };
            let head = [dimension(kind), entity];
            w.ints(&if w.version == "4.0" { [head[1], head[0]] } else { head });
            w.int(kind);
            w.size(block.len());
            w.end();
            for (.., corners) in block {
                tag += 1;
                w.tag(tag);
                corners.iter().for_each(|&corner| w.tag(nodes[corner].0));
                w.end();
            }
        }
    });
}

fn elements_2(w: &mut Writer, partitions: bool) {
    let (elements, nodes) = (elements(), nodes());
    w.section("Elements", |w| {
        w.text(&format!("{}\n", elements.len()));
        let mut number = 200;
        for block in elements.chunk_by(|a, b| a.0 == b.0) {
            let (physical, entity, kind, _) = block[0];
            // A partition adds its number, and that of a ghost.
            let tags: &[i32] = if partitions { &[physical, entity, 2, 1, -2] } else { &[physical, entity] };
            let count = tags.len() as i32;
            if w.coding != Coding::Ascii {
                w.ints(&[kind, block.len() as i32, count]);
            }
            for (.., corners) in block {
                number += 1;
                w.int(number);
                if w.coding == Coding::Ascii {
                    w.ints(&[kind, count]);
                }
                w.ints(tags);
                corners.iter().for_each(|&corner| w.int(nodes[corner].0 as i32));
                w.end();
            }
        }
    });
}

fn dialects() -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for version in ["2", "2.0", "2.1", "2.2", "4", "4.0", "4.1"] {
        for coding in [Coding::Ascii, Coding::Little, Coding::Big] {
            for extra in [
                Extra::None,
                Extra::Mark,
                Extra::Comments,
                Extra::OtherSections,
                Extra::Parametric,
                Extra::Partitions,
                Extra::LinesOfWindows,
            ] {
                if extra == Extra::LinesOfWindows && coding != Coding::Ascii {
                    continue;
                }
                let name = format!("{version} {coding:?} {extra:?}");
                // "4" is "4.0" under another name.
                let file = write(if version == "4" { "4.0" } else { version }, coding, extra);
                all.push((name, file));
            }
        }
    }
    all
}

#[test]
fn every_dialect_of_msh_is_read_alike() {
    let dialects = dialects();
    assert!(dialects.len() >= 60, "{}", dialects.len());
    let first = msh::read(&dialects[0].1, &Limits::default()).unwrap();
    let Imported { mesh, origin } = &first;
    assert_eq!(mesh.vertices, nodes()[..8].iter().map(|(_, x)| *x).collect::<Vec<_>>());
    assert_eq!((mesh.cells[0], mesh.cells[7]), (Cell::quad(0, 2, 3, 1), Cell::triangle(1, 7, 5)));
    let group = |name: &str, indices: Vec<u32>| Group { name: name.to_owned(), indices };
    assert_eq!(mesh.cell_groups, [group("the skin", vec![0, 1, 2, 3]), group("ends", vec![4, 5, 6, 7])]);
    assert_eq!(mesh.vertex_groups, [group("corner", vec![5]), group("edge", vec![0, 1])]);
    assert_eq!(origin.left_out, LeftOut { nodes: 1, other_cells: 1, ..LeftOut::default() });
    assert_eq!((origin.nodes[7], origin.cells[4]), (73, 205));
    for (name, file) in &dialects {
        let read = msh::read(file, &Limits::default());
        assert_eq!(read.as_ref(), Ok(&first), "{name}");
        // Other positions of some nodes; everything else stays, and so does the file with the old ones.
        let moved = |tag: u64| (tag != 13).then(|| [tag as f64, 0.5, -2.0 / 3.0]);
        let other = msh::with_positions(file, moved, &Limits::default()).unwrap();
        let read = msh::read(&other, &Limits::default()).unwrap();
        assert_eq!((&read.origin, &read.mesh.cells), (&first.origin, &mesh.cells), "{name}");
        assert_eq!(read.mesh.vertices[1], mesh.vertices[1], "{name}");
        assert_eq!(read.mesh.vertices[7], [73.0, 0.5, -2.0 / 3.0], "{name}");
        let old = |tag: u64| nodes().into_iter().find(|(of, _)| *of as u64 == tag).map(|(_, x)| x);
        let back = msh::with_positions(&other, old, &Limits::default()).unwrap();
        assert_eq!(msh::read(&back, &Limits::default()).as_ref(), Ok(&first), "{name}");
    }
}

#[test]
fn every_cut_of_a_dialect_is_refused_or_read() {
    // No panic, whatever is missing at the end.
    for (_, file) in dialects().iter().step_by(5) {
        for length in (0..file.len()).step_by(7) {
            let _ = msh::read(&file[..length], &Limits::default());
        }
    }
}

#[test]
fn version_1_and_files_without_surfaces_are_named() {
    let error = |text: &str| msh::read(text.as_bytes(), &Limits::default()).unwrap_err().to_string();
    assert_eq!(error("$NOD\n1\n"), "line 1: MSH version 1 is not supported; write version 4.1 or 2.2");
    let volume = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n1\n\
                  1 4 2 0 1 1 2 3 4\n$EndElements\n";
    let error = error(volume);
    assert!(error.contains("no triangles or quadrilaterals (4 nodes and 1 cells of other kinds"), "{error}");
    assert!(error.contains("save the surfaces too"), "{error}");
}

#[test]
fn a_cell_that_is_listed_twice_in_a_group_is_kept_twice() {
    let file = |physicals: [i32; 2]| {
        format!(
            "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n$Elements\n2\n1 2 2 {} 1 1 2 3\n\
             2 2 2 {} 1 1 2 3\n$EndElements\n",
            physicals[0], physicals[1]
        )
    };
    let cells =
        |physicals| msh::read(file(physicals).as_bytes(), &Limits::default()).unwrap().mesh.cells.len();
    // In two groups it is one cell; twice in one, or in none, it is there twice, which a set-up refuses.
    assert_eq!([cells([1, 2]), cells([1, 1]), cells([0, 0])], [1, 2, 2]);
}

fn tetrahedron() -> SurfaceMesh {
    let vertices = vec![[0.1, 0.0, 0.0], [1.0, 1.0 / 3.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let cells =
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|[a, b, c]| Cell::triangle(a, b, c)).to_vec();
    let group = |name: &str, indices: Vec<u32>| Group { name: name.to_owned(), indices };
    SurfaceMesh::new(vertices, cells, vec![group("low", vec![0, 2]), group("high", vec![1, 3])], vec![])
        .expect("is valid")
}

/// A binary STL with the given head.
fn binary_stl(mesh: &SurfaceMesh, head: &[u8]) -> Vec<u8> {
    let mut out = head.to_vec();
    out.resize(80, b' ');
    out.extend((mesh.cells.len() as u32).to_le_bytes());
    for cell in &mesh.cells {
        out.extend([0; 12]);
        for &vertex in cell.vertices() {
            out.extend(mesh.vertices[vertex as usize].iter().flat_map(|&x| (x as f32).to_le_bytes()));
        }
        out.extend([0; 2]);
    }
    out
}

#[test]
fn heads_and_ends_of_stl() {
    let mesh = tetrahedron();
    let cells = |bytes: &[u8]| stl::read(bytes, 0.0, &Limits::default()).map(|read| read.mesh.cells.len());
    for head in [&b"solid of a CAD program"[..], b"\xEF\xBB\xBFsolid", b"binary", b"solid\n facet normal"] {
        let file = binary_stl(&mesh, head);
        for end in [&b""[..], b"\n", b"\r\n\0", &[7; 49], &[0; 200]] {
            assert_eq!(cells(&[&file, end].concat()), Ok(4), "{head:?} and {} bytes", end.len());
        }
        let error = cells(&[&file[..], &[7; 60]].concat()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "byte 284: expected the end of a binary STL of 4 triangles, found `60 bytes more`"
        );
    }
    let text = stl::write(&mesh);
    for mark in [&b""[..], b"\xEF\xBB\xBF", b"\n\t "] {
        assert_eq!(cells(&[mark, &text].concat()), Ok(4));
    }
    let error = cells(&[0xFF, 0xFE, b's', 0]).unwrap_err();
    assert!(error.to_string().contains("UTF-16"), "{error}");
}

#[test]
fn stl_is_written_to_the_same_bits() {
    let mesh = tetrahedron();
    let read = stl::read(&stl::write(&mesh), 0.0, &Limits::default()).unwrap().mesh;
    let corners = |mesh: &SurfaceMesh| -> Vec<Vec<[f64; 3]>> {
        let at = |&vertex: &u32| mesh.vertices[vertex as usize];
        mesh.cells.iter().map(|cell| cell.vertices().iter().map(at).collect()).collect()
    };
    assert_eq!(corners(&read), corners(&mesh));
    assert_eq!(read.cell_groups, mesh.cell_groups);
}

#[test]
fn not_a_number_is_located_by_facet() {
    let mut mesh = tetrahedron();
    mesh.vertices[3][1] = f64::NAN;
    let at = |bytes: &[u8]| match stl::read(bytes, 0.0, &Limits::default()) {
        Err(ReadError::NotFinite { place, facet, corner, axis, .. }) => (place, facet, corner, axis),
        other => panic!("{other:?}"),
    };
    assert_eq!(at(&binary_stl(&mesh, b"")), (Place::Byte(134), 1, 2, 1));
    assert_eq!(at(&stl::write(&mesh)), (Place::Line(11), 1, 2, 1));
}

/// Positions, corners of cells, members of the group `g`, and ghosts.
type Piece<'a> = (&'a [[f64; 3]], &'a [[usize; 3]], &'a str, &'a str);

/// A VTU file of these pieces.
fn pieces(pieces: &[Piece<'_>]) -> Vec<u8> {
    let mut out = "<VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>".to_owned();
    for (points, cells, members, ghosts) in pieces {
        let text = |values: Vec<String>| values.join(" ");
        let coordinates = text(points.iter().flatten().map(|x| format!("{x:?}")).collect());
        let corners = text(cells.iter().flatten().map(|k| k.to_string()).collect());
        let offsets = text((1..=cells.len()).map(|k| (3 * k).to_string()).collect());
        let types = text(vec!["5".to_owned(); cells.len()]);
        out += &format!(
            "<Piece NumberOfPoints=\"{}\" NumberOfCells=\"{}\"><Points><DataArray type=\"Float64\">{coordinates}</DataArray></Points>\
             <Cells><DataArray type=\"Int32\" Name=\"connectivity\">{corners}</DataArray><DataArray type=\"Int32\" \
             Name=\"offsets\">{offsets}</DataArray><DataArray type=\"Int8\" Name=\"types\">{types}</DataArray></Cells><CellData>\
             <DataArray type=\"Int8\" Name=\"group:g\">{members}</DataArray><DataArray type=\"UInt8\" \
             Name=\"vtkGhostType\">{ghosts}</DataArray></CellData></Piece>",
            points.len(),
            cells.len()
        );
    }
    (out + "</UnstructuredGrid></VTKFile>").into_bytes()
}

#[test]
fn pieces_of_vtu_are_joined_at_their_borders() {
    let x = tetrahedron().vertices;
    // The second piece repeats a cell of the first as its ghost, and has a double point of its own.
    let file = pieces(&[
        (&x, &[[0, 2, 1], [0, 1, 3]], "1 0", "0 0"),
        (&[x[0], x[3], x[2], x[1], x[3]], &[[0, 1, 2], [3, 2, 4], [0, 3, 1]], "0 1 1", "0 0 1"),
    ]);
    let Imported { mesh, origin } = vtu::read(&file, &Limits::default()).unwrap();
    assert_eq!(mesh.vertices, x);
    assert_eq!(
        mesh.cells,
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|[a, b, c]| Cell::triangle(a, b, c))
    );
    assert_eq!(mesh.cell_groups, [Group { name: "g".to_owned(), indices: vec![0, 3] }]);
    assert_eq!(origin.left_out, LeftOut { merged_nodes: 5, other_cells: 1, ..LeftOut::default() });
    assert_eq!(origin.cells, [0, 1, 2, 3]);
    // In one piece equal points stay apart.
    let one = pieces(&[(&[x[0], x[1], x[2], x[0], x[2], x[3]], &[[0, 2, 1], [3, 5, 4]], "1 0", "0 0")]);
    assert_eq!(vtu::read(&one, &Limits::default()).unwrap().mesh.vertices.len(), 6);
}

#[test]
fn nodes_are_merged_in_every_format() {
    // Two quadrilaterals side by side, whose common side is double, 1e-6 apart; and a needle that collapses.
    let x = [0.0, 1.0, 2.0, 0.0, 1.0, 2.0].map(|x| [x, 0.0, 0.0]);
    let mut vertices: Vec<[f64; 3]> =
        x.iter().enumerate().map(|(k, x)| [x[0], f64::from(u8::from(k > 2)), 0.0]).collect();
    vertices.extend([[1.0 + 1e-6, 0.0, 0.0], [1.0, 1.0 + 1e-6, 0.0]]);
    let cells = vec![Cell::quad(0, 1, 4, 3), Cell::quad(6, 2, 5, 7), Cell::triangle(1, 6, 7)];
    let group = |indices| vec![Group { name: "g".to_owned(), indices }];
    let mesh = SurfaceMesh::new(vertices, cells, group(vec![1, 2]), group(vec![2, 7])).unwrap();
    let files = [
        msh::read_merged(&msh::write(&mesh, msh::Version::V2), 1e-5, &Limits::default()),
        msh::read_merged(&msh::write(&mesh, msh::Version::V4), 1e-5, &Limits::default()),
        vtu::read_merged(&vtu::write(&mesh, &[], &[]), 1e-5, &Limits::default()),
        moldline_mesh::io::merged(mesh.clone(), 1e-5, &Limits::default()),
    ];
    for read in files {
        let Imported { mesh: merged, origin } = read.unwrap();
        assert_eq!(merged.vertices, mesh.vertices[..6]);
        assert_eq!(merged.cells, [Cell::quad(0, 1, 4, 3), Cell::quad(1, 2, 5, 4)]);
        assert_eq!((&merged.cell_groups, &merged.vertex_groups), (&group(vec![1]), &group(vec![2, 4])));
        assert_eq!(origin.left_out, LeftOut { merged_nodes: 2, collapsed_cells: 1, ..LeftOut::default() });
        assert_eq!(origin.merged.iter().map(|&(_, vertex)| vertex).collect::<Vec<_>>(), [1, 4]);
    }
    let error = moldline_mesh::io::merged(mesh, 1.1, &Limits::default()).unwrap_err();
    assert!(matches!(error, ReadError::MergeTolerance { count: 2, cells: 3, .. }), "{error}");
}
