//! VTK's XML unstructured grid (`.vtu`).

mod data;
mod xml;

use std::{collections::HashMap, fmt::Write};

use self::{
    data::{ArrayTag, File},
    xml::{Scanner, Tag},
};
use super::{Draft, Imported, Place, ReadError};
use crate::{Cell, Group, Limits, Numbering, SurfaceMesh};

/// Prefix of the names of arrays that hold groups.
const GROUP: &str = "group:";
/// The bit of `vtkGhostType` of a cell that another piece has as its own.
const DUPLICATE: i64 = 1;

/// A data array to write beside the mesh.
#[derive(Clone, Copy, Debug)]
pub struct Array<'a> {
    /// Name, as shown in ParaView.
    pub name: &'a str,
    /// Numbers per point or cell.
    pub components: usize,
    /// Values, `components` for each point or cell.
    pub values: Values<'a>,
}

/// Values of an [`Array`].
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// Double precision.
    Float64(&'a [f64]),
    /// Signed 32 bits.
    Int32(&'a [i32]),
    /// Signed 64 bits.
    Int64(&'a [i64]),
    /// Unsigned 8 bits.
    UInt8(&'a [u8]),
}

/// Reads ASCII, inline base64 and appended (raw or base64) data, compressed with zlib or not, of either byte order.
/// Integer arrays named `group:NAME` become cell and vertex groups: members have a value other than 0. Several pieces are joined at
/// their borders, where points are equal, and the cells that one of them has as ghosts of another are left out.
///
/// # Errors
/// [`ReadError`], with a line or byte offset.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Imported, ReadError> {
    read_merged(bytes, 0.0, limits)
}

/// Bytes that reading a file takes beyond what follows from its own length: zlib makes up to a thousand of one, and what it makes is
/// announced by the pieces. 0 for files without compression, and for those that [`read`] refuses at once.
pub fn inflated(bytes: &[u8], limits: &Limits) -> u64 {
    /// Coordinates as bytes, numbers and positions; the number of the point.
    const OF_POINT: u64 = 24 + 24 + 24 + 8;
    /// Type, offset, four indices, each as bytes and as numbers; its new number, the cell and its old number.
    const OF_CELL: u64 = 2 * (8 + 8 + 32) + 8 + 16 + 8;
    /// Index of a member.
    const OF_MEMBER: u64 = 4;
    let Ok((file, pieces)) = scan(bytes) else { return 0 };
    if !file.compressed {
        return 0;
    }
    // Pieces beyond the limits are refused before they are read.
    let capped = |count: u64, limit: usize| count.min(limit as u64);
    let of_piece = |piece: &Piece<'_>| {
        let (points, cells) = (capped(piece.points, limits.vertices), capped(piece.cells, limits.cells));
        let of_points = OF_POINT + OF_MEMBER * piece.point_groups.len() as u64;
        let of_cells = OF_CELL + OF_MEMBER * piece.cell_groups.len() as u64;
        of_points.saturating_mul(points).saturating_add(of_cells.saturating_mul(cells))
    };
    pieces.iter().map(of_piece).fold(0, u64::saturating_add)
}

/// As [`read`], with points merged within `tolerance`, in the file's unit.
///
/// # Errors
/// As [`read`]; [`ReadError::MergeTolerance`] if the tolerance is too large.
pub fn read_merged(bytes: &[u8], tolerance: f64, limits: &Limits) -> Result<Imported, ReadError> {
    let (file, pieces) = scan(bytes)?;
    let mut draft = Draft::default();
    let mut starts = Vec::with_capacity(pieces.len());
    for piece in &pieces {
        starts.push(draft.positions.len());
        read_piece(&file, piece, limits, &mut draft)?;
    }
    if pieces.is_empty() {
        return Err(ReadError::Missing { what: "Piece" });
    }
    let equal = if pieces.len() > 1 { equal_to_other_pieces(&draft.positions, &starts) } else { Vec::new() };
    draft.finish(Numbering::Points, equal, tolerance, limits)
}

/// For each point the first one of an earlier piece at the same position, or itself. Equal points within a piece stay apart.
fn equal_to_other_pieces(positions: &[[f64; 3]], starts: &[usize]) -> Vec<u32> {
    let mut first: HashMap<[u64; 3], u32> = HashMap::new();
    let ends = starts[1..].iter().copied().chain([positions.len()]);
    let mut target = Vec::with_capacity(positions.len());
    let mut start = 0;
    for end in ends {
        for (index, x) in (start..).zip(&positions[start..end]) {
            // Adding zero makes -0 and 0 the same.
            let found = *first.entry(x.map(|x| (x + 0.0).to_bits())).or_insert(index as u32);
            target.push(if (found as usize) < start { found } else { index as u32 });
        }
        start = end;
    }
    target
}

/// The arrays of a piece.
#[derive(Default)]
struct Piece<'a> {
    place: usize,
    points: u64,
    cells: u64,
    coordinates: Option<ArrayTag<'a>>,
    connectivity: Option<ArrayTag<'a>>,
    offsets: Option<ArrayTag<'a>>,
    types: Option<ArrayTag<'a>>,
    /// Marks cells that belong to another piece, by a bit.
    ghosts: Option<ArrayTag<'a>>,
    point_groups: Vec<(String, ArrayTag<'a>)>,
    cell_groups: Vec<(String, ArrayTag<'a>)>,
}

/// Locates all arrays without decoding them.
fn scan(bytes: &[u8]) -> Result<(File<'_>, Vec<Piece<'_>>), ReadError> {
    let mut scanner = Scanner::new(bytes);
    let mut file = None;
    let mut pieces: Vec<Piece<'_>> = Vec::new();
    let mut within = "";
    while let Some(tag) = scanner.next_tag()? {
        if tag.closing {
            continue;
        }
        match tag.name {
            "VTKFile" => file = Some(File::new(bytes, &tag)?),
            "Piece" => {
                let points = tag.required("NumberOfPoints")?;
                let cells = tag.required("NumberOfCells")?;
                pieces.push(Piece { place: tag.start, points, cells, ..Piece::default() });
            }
            "Points" | "Cells" | "PointData" | "CellData" | "FieldData" => within = tag.name,
            "DataArray" => {
                if let Some(piece) = pieces.last_mut() {
                    note_array(piece, within, &tag, &mut scanner)?;
                }
            }
            "AppendedData" => {
                let file = file.as_mut().ok_or(ReadError::Missing { what: "VTKFile" })?;
                file.note_appended(&tag)?;
                // Raw bytes may follow.
                break;
            }
            _ => {}
        }
    }
    Ok((file.ok_or(ReadError::Missing { what: "VTKFile" })?, pieces))
}

fn note_array<'a>(
    piece: &mut Piece<'a>,
    within: &str,
    tag: &Tag<'a>,
    scanner: &mut Scanner<'a>,
) -> Result<(), ReadError> {
    let name = tag.attribute("Name").unwrap_or_default();
    let group = name.strip_prefix(GROUP).map(str::to_owned);
    match (within, name.as_ref(), group) {
        ("Points", ..) => piece.coordinates = Some(ArrayTag::new(tag, scanner)?),
        ("Cells", "connectivity", _) => piece.connectivity = Some(ArrayTag::new(tag, scanner)?),
        ("Cells", "offsets", _) => piece.offsets = Some(ArrayTag::new(tag, scanner)?),
        ("Cells", "types", _) => piece.types = Some(ArrayTag::new(tag, scanner)?),
        ("CellData", "vtkGhostType", _) => piece.ghosts = Some(ArrayTag::new(tag, scanner)?),
        ("PointData", _, Some(group)) => piece.point_groups.push((group, ArrayTag::new(tag, scanner)?)),
        ("CellData", _, Some(group)) => piece.cell_groups.push((group, ArrayTag::new(tag, scanner)?)),
        _ => {}
    }
    Ok(())
}

fn need<'b, 'a>(array: &'b Option<ArrayTag<'a>>, what: &'static str) -> Result<&'b ArrayTag<'a>, ReadError> {
    array.as_ref().ok_or(ReadError::Missing { what })
}

fn read_piece(
    file: &File<'_>,
    piece: &Piece<'_>,
    limits: &Limits,
    draft: &mut Draft,
) -> Result<(), ReadError> {
    let count = |what, count: u64, known: usize, limit: usize| {
        let limit = limit.saturating_sub(known).min(file.bytes.len() * data::MOST_PER_BYTE) as u64;
        let place = Place::Byte(piece.place);
        if count > limit { Err(ReadError::TooMany { place, what, count, limit }) } else { Ok(count as usize) }
    };
    let points = count("points", piece.points, draft.positions.len(), limits.vertices)?;
    // Cells of other kinds are left out, and count against the limit only here.
    let cells = count("cells", piece.cells, 0, limits.cells)?;
    if points == 0 && cells == 0 {
        return Ok(());
    }
    let coordinates = file.reals(need(&piece.coordinates, "array of points")?, 3 * points)?;
    let first = draft.positions.len();
    draft.ids.extend((0..points).map(|index| (first + index) as u64));
    draft.positions.extend(coordinates.chunks_exact(3).map(|x| [x[0], x[1], x[2]]));
    if cells == 0 {
        return Ok(());
    }

    let types_tag = need(&piece.types, "array `types`")?;
    let offsets_tag = need(&piece.offsets, "array `offsets`")?;
    let connectivity_tag = need(&piece.connectivity, "array `connectivity`")?;
    let types = file.integers(types_tag, cells)?;
    let ghosts = piece.ghosts.as_ref().map(|tag| file.integers(tag, cells)).transpose()?;
    let offsets = file.integers(offsets_tag, cells)?;
    let at_offsets = || file.place(offsets_tag);
    let mut last = 0;
    for &offset in &offsets {
        if offset < last {
            let found = offset.to_string();
            return Err(ReadError::unexpected(
                at_offsets(),
                format!("an offset of at least {last}"),
                found.as_bytes(),
            ));
        }
        last = offset;
    }
    // Each cell kept has at most four vertices; others may have more, but no more than the file can hold.
    let limit = (file.bytes.len() * data::MOST_PER_BYTE) as u64;
    if last as u64 > limit {
        let count = last as u64;
        return Err(ReadError::TooMany { place: at_offsets(), what: "cell vertices", count, limit });
    }
    let connectivity = file.integers(connectivity_tag, last as usize)?;
    let at_connectivity = || file.place(connectivity_tag);
    let vertex = |index: i64| match usize::try_from(index) {
        Ok(index) if index < points => Ok((first + index) as u32),
        Ok(index) => Err(ReadError::UnknownNode { place: at_connectivity(), node: index as u64 }),
        Err(_) => {
            Err(ReadError::unexpected(at_connectivity(), "an index of a point", index.to_string().as_bytes()))
        }
    };

    // The new number of each cell of the file, if it is kept.
    let mut numbers: Vec<Option<u32>> = Vec::with_capacity(cells);
    let mut start = 0;
    let first_cell = draft.cells.len() + draft.other_cells;
    for (index, (&kind, &end)) in types.iter().zip(&offsets).enumerate() {
        let indices = &connectivity[start..end as usize];
        start = end as usize;
        if ghosts.as_ref().is_some_and(|ghosts| ghosts[index] & DUPLICATE != 0) {
            numbers.push(None);
            draft.other_cells += 1;
            continue;
        }
        let cell = match (kind, indices) {
            (5 | 7, &[a, b, c]) => Cell::triangle(vertex(a)?, vertex(b)?, vertex(c)?),
            (9 | 7, &[a, b, c, d]) => Cell::quad(vertex(a)?, vertex(b)?, vertex(c)?, vertex(d)?),
            // A pixel is numbered row by row.
            (8, &[a, b, d, c]) => Cell::quad(vertex(a)?, vertex(b)?, vertex(c)?, vertex(d)?),
            (5 | 8 | 9, _) => {
                let found = format!("{} vertices", indices.len());
                let expected = format!("a cell of type {kind}");
                return Err(ReadError::unexpected(at_offsets(), expected, found.as_bytes()));
            }
            // Strips, larger polygons, and the curved surface cells.
            (6 | 7 | 22 | 23 | 28 | 30 | 34..=36 | 69 | 70 | 75 | 76, _) => {
                return Err(ReadError::Unsupported {
                    place: file.place(types_tag),
                    what: format!("VTK cell type {kind} with {} vertices", indices.len()),
                    advice: "write straight triangles (5) and quadrilaterals (9)",
                });
            }
            _ => {
                numbers.push(None);
                draft.other_cells += 1;
                continue;
            }
        };
        numbers.push(Some(draft.cells.len() as u32));
        draft.cell_ids.push((first_cell + index) as u64);
        draft.cells.push(cell);
    }

    for (name, tag) in &piece.point_groups {
        let members = (0_u32..).zip(file.integers(tag, points)?).filter(|&(_, value)| value != 0);
        draft.vertex_groups.add(name, members.map(|(index, _)| first as u32 + index));
    }
    for (name, tag) in &piece.cell_groups {
        let members = file.integers(tag, cells)?.into_iter().zip(&numbers);
        let members = members.filter(|&(value, _)| value != 0).filter_map(|(_, number)| *number);
        draft.cell_groups.add(name, members);
    }
    Ok(())
}

/// Writes appended raw little-endian data with the given arrays and the mesh's groups.
///
/// # Panics
/// If an array's length is not `components` times the number of points or cells.
pub fn write(mesh: &SurfaceMesh, point_data: &[Array<'_>], cell_data: &[Array<'_>]) -> Vec<u8> {
    let (points, cells) = (mesh.vertices.len(), mesh.cells.len());
    let mut writer = Writer::default();
    writer.text.push_str(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n<UnstructuredGrid>\n",
    );
    writer.text.push_str(&format!("<Piece NumberOfPoints=\"{points}\" NumberOfCells=\"{cells}\">\n"));

    writer.text.push_str("<PointData>\n");
    writer.data(point_data, points);
    writer.groups(&mesh.vertex_groups, points);
    writer.text.push_str("</PointData>\n<CellData>\n");
    writer.data(cell_data, cells);
    writer.groups(&mesh.cell_groups, cells);
    writer.text.push_str("</CellData>\n<Points>\n");
    writer.array("Float64", "Points", 3, mesh.vertices.iter().flatten().flat_map(|x| x.to_le_bytes()));
    writer.text.push_str("</Points>\n<Cells>\n");
    let connectivity = mesh.cells.iter().flat_map(|cell| cell.vertices());
    writer.array(
        "Int64",
        "connectivity",
        1,
        connectivity.flat_map(|&vertex| i64::from(vertex).to_le_bytes()),
    );
    let ends = mesh.cells.iter().scan(0_i64, |end, cell| {
        *end += cell.vertices().len() as i64;
        Some(*end)
    });
    writer.array("Int64", "offsets", 1, ends.flat_map(i64::to_le_bytes));
    writer.array("UInt8", "types", 1, mesh.cells.iter().map(|cell| if cell.is_triangle() { 5 } else { 9 }));
    writer.text.push_str("</Cells>\n</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_");

    let mut out = writer.text.into_bytes();
    out.append(&mut writer.appended);
    out.extend_from_slice(b"\n</AppendedData>\n</VTKFile>\n");
    out
}

#[derive(Default)]
struct Writer {
    text: String,
    appended: Vec<u8>,
}

impl Writer {
    fn array(&mut self, kind: &str, name: &str, components: usize, bytes: impl Iterator<Item = u8>) {
        let offset = self.appended.len();
        // Writing to a string cannot fail.
        let _ = writeln!(
            self.text,
            "<DataArray type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\" format=\"appended\" \
             offset=\"{offset}\"/>",
            xml::escape(name)
        );
        self.appended.extend_from_slice(&[0; 8]);
        self.appended.extend(bytes);
        let length = (self.appended.len() - offset - 8) as u64;
        self.appended[offset..offset + 8].copy_from_slice(&length.to_le_bytes());
    }

    fn data(&mut self, arrays: &[Array<'_>], count: usize) {
        for &Array { name, components, values } in arrays {
            let length = match values {
                Values::Float64(values) => values.len(),
                Values::Int32(values) => values.len(),
                Values::Int64(values) => values.len(),
                Values::UInt8(values) => values.len(),
            };
            assert_eq!(length, components * count, "array `{name}`: {components} values for each of {count}");
            match values {
                Values::Float64(values) => {
                    self.array("Float64", name, components, values.iter().flat_map(|x| x.to_le_bytes()));
                }
                Values::Int32(values) => {
                    self.array("Int32", name, components, values.iter().flat_map(|x| x.to_le_bytes()));
                }
                Values::Int64(values) => {
                    self.array("Int64", name, components, values.iter().flat_map(|x| x.to_le_bytes()));
                }
                Values::UInt8(values) => self.array("UInt8", name, components, values.iter().copied()),
            }
        }
    }

    fn groups(&mut self, groups: &[Group], count: usize) {
        for group in groups {
            let mut member = vec![0; count];
            group.indices.iter().for_each(|&index| member[index as usize] = 1);
            self.array("UInt8", &format!("{GROUP}{}", group.name), 1, member.into_iter());
        }
    }
}
