//! Readers take as long as their input is, whatever it says: each input is built in two sizes, and the bytes and entries that the
//! reader looks at are compared.

use std::{cell::Cell, fmt::Write};

use super::{Imported, ReadError, msh, stl, vtu};
use crate::Limits;

thread_local! {
    pub(super) static LOOKED_AT: Cell<usize> = const { Cell::new(0) };
}

const LIMITS: Limits =
    Limits { vertices: 1 << 24, cells: 1 << 24, groups: 1 << 24, name: 256, coordinate: 1e12 };

type Read = fn(&[u8]) -> Result<Imported, ReadError>;

fn read_vtu(bytes: &[u8]) -> Result<Imported, ReadError> {
    vtu::read(bytes, &LIMITS)
}

fn read_msh(bytes: &[u8]) -> Result<Imported, ReadError> {
    msh::read(bytes, &LIMITS)
}

fn read_stl(bytes: &[u8]) -> Result<Imported, ReadError> {
    stl::read(bytes, 0.0, &LIMITS)
}

/// Work and length at sizes `n` and `2 n`.
#[track_caller]
fn assert_linear(read: Read, input: impl Fn(usize) -> Vec<u8>) {
    let measure = |n: usize| {
        let bytes = input(n);
        LOOKED_AT.with(|sum| sum.set(0));
        // Whether it is accepted does not matter.
        let _ = read(&bytes);
        LOOKED_AT.with(Cell::get)
    };
    let (single, double) = (measure(2000), measure(4000));
    assert!(single >= 2000, "the reader looks at what the input repeats: {single}");
    assert!(10 * double <= 22 * single, "{single} for one size, {double} for the double one");
}

/// `count` times what `part` writes for each number.
fn repeated(count: usize, part: impl Fn(&mut String, usize)) -> String {
    let mut text = String::new();
    (0..count).for_each(|k| part(&mut text, k));
    text
}

fn vtu(body: &str) -> Vec<u8> {
    format!("<VTKFile type=\"UnstructuredGrid\" header_type=\"UInt64\">\n{body}</VTKFile>\n").into_bytes()
}

#[test]
fn vtu_with_many_heads() {
    assert_linear(read_vtu, |n| vtu(&"<VTKFile type=\"UnstructuredGrid\">\n".repeat(n)));
}

#[test]
fn vtu_with_many_comments_attributes_and_pieces() {
    assert_linear(read_vtu, |n| vtu(&"<!-- -->\n<? ?>".repeat(n)));
    assert_linear(read_vtu, |n| vtu(&"<!-- <!-- ".repeat(n)));
    assert_linear(read_vtu, |n| {
        vtu(&format!(
            "<Piece {} NumberOfPoints=\"1\" NumberOfCells=\"0\">",
            repeated(n, |text, k| {
                let _ = write!(text, "a{k}=\"&amp;\" ");
            })
        ))
    });
    assert_linear(read_vtu, |n| vtu(&"<Piece NumberOfPoints=\"0\" NumberOfCells=\"0\">\n</Piece>".repeat(n)));
}

#[test]
fn vtu_with_many_groups() {
    let group = |text: &mut String, k: usize| {
        let _ = writeln!(text, "<DataArray type=\"Int8\" Name=\"group:{k}\">1 1 1</DataArray>");
    };
    assert_linear(read_vtu, |n| {
        vtu(&format!(
            "<Piece NumberOfPoints=\"3\" NumberOfCells=\"1\"><Points><DataArray type=\"Float64\">0 0 0 1 0 0 0 1 0\
             </DataArray></Points><Cells><DataArray type=\"Int32\" Name=\"connectivity\">0 1 2</DataArray><DataArray \
             type=\"Int32\" Name=\"offsets\">3</DataArray><DataArray type=\"Int8\" Name=\"types\">5</DataArray></Cells>\
             <PointData>{}</PointData></Piece>",
            repeated(n, group)
        ))
    });
}

/// `n` triangles over `n` points, whose groups all name the data at offset 0.
fn vtu_of_shared_data(n: usize) -> Vec<u8> {
    let mut data: Vec<u8> = Vec::new();
    let mut append = |bytes: Vec<u8>| {
        let offset = data.len();
        data.extend((bytes.len() as u64).to_le_bytes());
        data.extend(bytes);
        offset
    };
    let types = append(vec![5; n]);
    let points = append(vec![0; 24 * n]);
    let offsets = append((1..=n as u64).flat_map(|k| (3 * k).to_le_bytes()).collect());
    let corners = append((0..3 * n as u64).flat_map(|k| (k % 3).to_le_bytes()).collect());
    let tag = |kind: &str, name: &str, offset: usize| {
        format!("<DataArray type=\"{kind}\" Name=\"{name}\" format=\"appended\" offset=\"{offset}\"/>\n")
    };
    let groups = repeated(n, |text, k| text.push_str(&tag("UInt8", &format!("group:{k}"), types)));
    let text = format!(
        "<VTKFile type=\"UnstructuredGrid\" header_type=\"UInt64\">\n<Piece NumberOfPoints=\"{n}\" NumberOfCells=\"{n}\">\
         <Points>{}</Points><Cells>{}{}{}</Cells><PointData>{groups}</PointData></Piece><AppendedData encoding=\"raw\">_",
        tag("Float64", "", points),
        tag("UInt8", "types", types),
        tag("Int64", "offsets", offsets),
        tag("Int64", "connectivity", corners)
    );
    [text.into_bytes(), data].concat()
}

#[test]
fn vtu_with_many_arrays_over_the_same_data() {
    assert_linear(read_vtu, vtu_of_shared_data);
    let error = read_vtu(&vtu_of_shared_data(100)).unwrap_err();
    assert!(error.to_string().contains("shares appended data"), "{error}");
}

#[test]
fn msh_with_many_sections_and_a_long_name() {
    let head = |version: &str| format!("$MeshFormat\n{version} 0 8\n$EndMeshFormat\n");
    assert_linear(read_msh, |n| format!("{}{}", head("2.2"), "$Other\n$EndOther\n".repeat(n)).into_bytes());
    // The end of such a section looks everywhere as if it had come.
    assert_linear(read_msh, |n| {
        let name = "Enda$".repeat(n);
        format!("{}${name}b\n{}", head("2.2"), format!("${name}").repeat(2)).into_bytes()
    });
}

#[test]
fn msh_with_many_blocks_of_an_entity_with_many_groups() {
    assert_linear(read_msh, |n| {
        let tags = repeated(n, |text, k| {
            let _ = write!(text, "{} ", k + 1);
        });
        let elements = "2 1 2 1\n1 1 2 3\n".repeat(n);
        format!(
            "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 1 0\n1 0 0 0 1 1 1 {n} {tags}0\n$EndEntities\n\
             $Nodes\n1 3 1 3\n2 1 0 3\n1\n2\n3\n0 0 0\n1 0 0\n0 1 0\n$EndNodes\n\
             $Elements\n{n} {n} 1 {n}\n{elements}$EndElements\n"
        )
        .into_bytes()
    });
}

#[test]
fn stl_with_many_solids() {
    assert_linear(read_stl, |n| {
        repeated(n, |text, k| {
            let _ = write!(
                text,
                "solid part {k}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 {k}\nvertex 1 0 {k}\nvertex 0 1 {k}\n\
                 endloop\nendfacet\nendsolid\n"
            );
        })
        .into_bytes()
    });
}
