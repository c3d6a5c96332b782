//! STL triangles, ASCII and binary.

use std::collections::HashMap;

use super::{Draft, Imported, Place, ReadError, cursor::Cursor};
use crate::{Cell, Limits, grid::HashGrid};

/// Reads ASCII or binary STL and merges vertices: equal ones, and those within `tolerance` (m, 0 for equal only) of an earlier
/// one. Triangles that collapse are left out and counted. Named solids of an ASCII file become cell groups.
///
/// # Errors
/// [`ReadError`], with a line or byte offset.
pub fn read(bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    let mut merger = Merger::new(limits);
    if bytes.len() >= HEAD && bytes.len() as u64 == HEAD as u64 + RECORD as u64 * stated_count(bytes) {
        for record in bytes[HEAD..].chunks_exact(RECORD) {
            // The normal comes first, then three corners.
            let corner = |k: usize| {
                std::array::from_fn(|axis| {
                    let at = 12 * (k + 1) + 4 * axis;
                    f64::from(f32::from_le_bytes([
                        record[at],
                        record[at + 1],
                        record[at + 2],
                        record[at + 3],
                    ]))
                })
            };
            merger.add([corner(0), corner(1), corner(2)], "", || Place::Byte(HEAD))?;
        }
    } else if bytes.trim_ascii_start().get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid")) {
        read_ascii(bytes, &mut merger)?;
    } else if bytes.len() >= HEAD {
        let count = stated_count(bytes);
        let limit = ((bytes.len() - HEAD) / RECORD) as u64;
        if count > limit {
            return Err(ReadError::TooMany { place: Place::Byte(80), what: "triangles", count, limit });
        }
        return Err(ReadError::unexpected(
            Place::Byte(HEAD + RECORD * count as usize),
            "the end of the file after the last triangle",
            &bytes[HEAD + RECORD * count as usize..],
        ));
    } else {
        let expected = "`solid`, or a binary head of 84 bytes".to_owned();
        return Err(ReadError::Truncated { place: Place::Byte(bytes.len()), expected });
    }
    merger.finish(tolerance)
}

/// Bytes before the first triangle of a binary file: a comment of 80 bytes and the count.
const HEAD: usize = 84;
/// Bytes of a triangle: normal, three corners, an attribute of two bytes.
const RECORD: usize = 50;

fn stated_count(bytes: &[u8]) -> u64 {
    u64::from(u32::from_le_bytes([bytes[80], bytes[81], bytes[82], bytes[83]]))
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
        draft.cells.push(Cell::triangle(a, b, c));
        Ok(())
    }

    /// Merges near vertices and drops triangles that collapse.
    fn finish(mut self, tolerance: f64) -> Result<Imported, ReadError> {
        let draft = &mut self.draft;
        if tolerance > 0.0 {
            let extent = draft.positions.iter().flatten().fold(0.0, |extent: f64, x| extent.max(x.abs()));
            let mut grid = HashGrid::new(tolerance, extent);
            let mut target = Vec::with_capacity(draft.positions.len());
            for (vertex, x) in (0..).zip(&draft.positions) {
                target.push(grid.nearest(x, &draft.positions).unwrap_or_else(|| {
                    grid.insert(x, vertex);
                    vertex
                }));
            }
            for cell in &mut draft.cells {
                *cell = cell.map(|vertex| target[vertex as usize]);
            }
        }
        const DROPPED: u32 = u32::MAX;
        let collapsed = |cell: &Cell| cell.edges().any(|[a, b]| a == b);
        let mut kept = 0;
        let number = |cell: &Cell| {
            if collapsed(cell) {
                return DROPPED;
            }
            kept += 1;
            kept - 1
        };
        let numbers: Vec<u32> = draft.cells.iter().map(number).collect();
        draft.ignored_cells = draft.cells.len() - kept as usize;
        draft.cells.retain(|cell| !collapsed(cell));
        for group in &mut draft.cell_groups.list {
            group.indices.iter_mut().for_each(|index| *index = numbers[*index as usize]);
            group.indices.retain(|&index| index != DROPPED);
        }
        self.draft.finish(self.limits)
    }
}
