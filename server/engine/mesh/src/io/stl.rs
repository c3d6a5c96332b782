//! STL triangles, ASCII and binary.

use std::{collections::HashMap, fmt::Write};

use super::{BYTE_ORDER_MARK, Draft, Imported, Place, ReadError, cursor::Cursor};
use crate::{Cell, Limits, Numbering, SurfaceMesh, area_vector};

/// Reads ASCII or binary STL and merges vertices: equal ones, and those within `tolerance` (0 for equal only) of an earlier one.
/// Triangles that collapse are left out and counted. Named solids of an ASCII file become cell groups.
///
/// A file is ASCII if it begins with `solid` and has only text where a binary file has its head and first triangle. A binary file may
/// have a few bytes after its last triangle, as some writers append.
///
/// # Errors
/// [`ReadError`], with a line or byte offset.
pub fn read(bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    let mut merger = Merger::new(limits);
    if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
        let what = "text in UTF-16".to_owned();
        return Err(ReadError::Unsupported {
            place: Place::Byte(0),
            what,
            advice: "save it as ASCII or UTF-8",
        });
    }
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
    let exact =
        bytes.len() >= HEAD && bytes.len() as u64 == HEAD as u64 + RECORD as u64 * stated_count(bytes);
    if !exact && is_text(text) && begins_with_solid(text) {
        read_ascii(bytes, &mut merger)?;
    } else {
        read_binary(bytes, &mut merger)?;
    }
    merger.draft.finish(Numbering::Facets, Vec::new(), tolerance, limits)
}

/// Bytes before the first triangle of a binary file: a comment of 80 bytes and the count.
const HEAD: usize = 84;
/// Bytes of a triangle: normal, three corners, an attribute of two bytes.
const RECORD: usize = 50;

fn begins_with_solid(bytes: &[u8]) -> bool {
    bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
}

/// Whether there is only text where a binary file has its head and its first triangle. (Names of solids may be in any code.)
fn is_text(bytes: &[u8]) -> bool {
    let control = |byte: &u8| byte.is_ascii_control() && !byte.is_ascii_whitespace();
    !bytes[..bytes.len().min(HEAD + RECORD)].iter().any(control)
}

fn stated_count(bytes: &[u8]) -> u64 {
    u64::from(u32::from_le_bytes([bytes[80], bytes[81], bytes[82], bytes[83]]))
}

fn read_binary(bytes: &[u8], merger: &mut Merger<'_>) -> Result<(), ReadError> {
    if bytes.len() < HEAD {
        let expected = "`solid`, or a binary head of 84 bytes".to_owned();
        return Err(ReadError::Truncated { place: Place::Byte(bytes.len()), expected });
    }
    let count = stated_count(bytes);
    let limit = ((bytes.len() - HEAD) / RECORD) as u64;
    if count > limit {
        return Err(ReadError::TooMany { place: Place::Byte(80), what: "triangles", count, limit });
    }
    let end = HEAD + RECORD * count as usize;
    let rest = &bytes[end..];
    // Less than a triangle, or filling: nothing that could be part of the surface.
    if rest.len() >= RECORD && !rest.iter().all(|byte| *byte == 0 || byte.is_ascii_whitespace()) {
        let expected = format!("the end of a binary STL of {count} triangles");
        let found = format!("{} bytes more", rest.len());
        return Err(ReadError::unexpected(Place::Byte(end), expected, found.as_bytes()));
    }
    for (index, record) in bytes[HEAD..end].chunks_exact(RECORD).enumerate() {
        // The normal comes first, then three corners.
        let corner = |k: usize| {
            std::array::from_fn(|axis| {
                let at = 12 * (k + 1) + 4 * axis;
                f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]))
            })
        };
        merger.add([corner(0), corner(1), corner(2)], "", || Place::Byte(HEAD + RECORD * index))?;
    }
    Ok(())
}

fn read_ascii(bytes: &[u8], merger: &mut Merger<'_>) -> Result<(), ReadError> {
    let mut cursor = Cursor::new(bytes);
    loop {
        cursor.skip_space();
        if cursor.rest().is_empty() {
            return Ok(());
        }
        expect(&mut cursor, "solid")?;
        let name = String::from_utf8_lossy(cursor.line()).into_owned();
        loop {
            let at = cursor.position;
            let word = cursor.word("`facet` or `endsolid`")?;
            if word.eq_ignore_ascii_case(b"endsolid") {
                cursor.line();
                break;
            }
            if !word.eq_ignore_ascii_case(b"facet") {
                return Err(ReadError::unexpected(cursor.place_of(at), "`facet` or `endsolid`", word));
            }
            expect(&mut cursor, "normal")?;
            for _ in 0..3 {
                // Some writers put `nan` here; orientation comes from the order of the corners, not from the normals.
                cursor.word("a normal")?;
            }
            expect(&mut cursor, "outer")?;
            expect(&mut cursor, "loop")?;
            let mut corners = [[0.0; 3]; 3];
            for corner in &mut corners {
                expect(&mut cursor, "vertex")?;
                for coordinate in corner {
                    *coordinate = cursor.number("a coordinate")?;
                }
            }
            expect(&mut cursor, "endloop")?;
            expect(&mut cursor, "endfacet")?;
            merger.add(corners, &name, || cursor.place_of(at))?;
        }
    }
}

fn expect(cursor: &mut Cursor<'_>, expected: &str) -> Result<(), ReadError> {
    let at = cursor.position;
    let word = cursor.word(expected)?;
    if word.eq_ignore_ascii_case(expected.as_bytes()) {
        Ok(())
    } else {
        Err(ReadError::unexpected(cursor.place_of(at), expected, word))
    }
}

/// Collects triangles and merges equal corners at once.
struct Merger<'a> {
    limits: &'a Limits,
    vertices: HashMap<[u64; 3], u32>,
    draft: Draft,
    corners: u64,
}

impl<'a> Merger<'a> {
    fn new(limits: &'a Limits) -> Self {
        Self { limits, vertices: HashMap::new(), draft: Draft::default(), corners: 0 }
    }

    fn add(
        &mut self,
        corners: [[f64; 3]; 3],
        solid: &str,
        place: impl Fn() -> Place,
    ) -> Result<(), ReadError> {
        let draft = &mut self.draft;
        let facet = self.corners / 3;
        for (corner, axis) in (0..3).flat_map(|corner| (0..3).map(move |axis| (corner, axis))) {
            let value = corners[corner][axis];
            if !value.is_finite() {
                return Err(ReadError::NotFinite { place: place(), facet, corner, axis, value });
            }
        }
        let mut cell = [0; 3];
        for (vertex, corner) in cell.iter_mut().zip(corners) {
            // Adding zero makes -0 and 0 the same.
            let key = corner.map(|x| (x + 0.0).to_bits());
            *vertex = *self.vertices.entry(key).or_insert_with(|| {
                draft.ids.push(self.corners);
                draft.positions.push(corner);
                draft.positions.len() as u32 - 1
            });
            self.corners += 1;
        }
        let over = |what, count: usize, limit: usize| {
            let (count, limit) = (count as u64, limit as u64);
            if count > limit {
                Err(ReadError::TooMany { place: place(), what, count, limit })
            } else {
                Ok(())
            }
        };
        over("vertices", draft.positions.len(), self.limits.vertices)?;
        over("cells", draft.cells.len() + 1, self.limits.cells)?;
        if !solid.is_empty() {
            draft.cell_groups.add(solid, [draft.cells.len() as u32]);
            over("cell groups", draft.cell_groups.list.len(), self.limits.groups)?;
        }
        let [a, b, c] = cell;
        draft.cell_ids.push(facet);
        draft.cells.push(Cell::triangle(a, b, c));
        Ok(())
    }
}

/// Writes ASCII, with coordinates that read back to the same bits. A quadrilateral becomes two triangles; the first group of a cell
/// names its solid. The order of the cells stays, so that a solid may appear several times.
pub fn write(mesh: &SurfaceMesh) -> Vec<u8> {
    let mut group = vec![None; mesh.cells.len()];
    for (number, members) in mesh.cell_groups.iter().enumerate().rev() {
        members.indices.iter().for_each(|&cell| group[cell as usize] = Some(number));
    }
    let mut out = String::new();
    let cells: Vec<(&Cell, Option<usize>)> = mesh.cells.iter().zip(group).collect();
    for solid in cells.chunk_by(|a, b| a.1 == b.1) {
        let name = solid[0].1.map_or("", |number| &mesh.cell_groups[number].name);
        let name = name.replace(char::is_control, " ");
        // Writing to a string cannot fail.
        let _ = writeln!(out, "solid {name}");
        for (cell, _) in solid {
            match *cell.vertices() {
                [a, b, c] => write_facet(mesh, [a, b, c], &mut out),
                [a, b, c, d] => {
                    write_facet(mesh, [a, b, c], &mut out);
                    write_facet(mesh, [a, c, d], &mut out);
                }
                _ => {}
            }
        }
        let _ = writeln!(out, "endsolid {name}");
    }
    out.into_bytes()
}

fn write_facet(mesh: &SurfaceMesh, corners: [u32; 3], out: &mut String) {
    let area = area_vector(&mesh.vertices, &Cell::triangle(corners[0], corners[1], corners[2]));
    let normal = area.try_normalize(0.0).unwrap_or_default();
    let _ = writeln!(out, "facet normal {:?} {:?} {:?}\nouter loop", normal.x, normal.y, normal.z);
    for corner in corners {
        let [x, y, z] = mesh.vertices[corner as usize];
        let _ = writeln!(out, "vertex {x:?} {y:?} {z:?}");
    }
    out.push_str("endloop\nendfacet\n");
}
