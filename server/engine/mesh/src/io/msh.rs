//! Gmsh's MSH format: versions 2.2 and 4.1, ASCII and binary.

use std::{
    collections::{BTreeMap, HashMap},
    fmt::Write,
    rc::Rc,
};

use super::{
    Draft, Imported, ReadError,
    cursor::{Coding, Cursor},
    looked_at,
};
use crate::{Cell, Csr, Limits, SurfaceMesh, Topology};

/// A version to write, as ASCII.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// 2.2.
    V2,
    /// 4.1.
    V4,
}

/// Reads version 2.2 or 4.1, ASCII or binary. Physical surfaces become cell groups, physical curves and points vertex
/// groups, by name, or by `physical <tag>` if they have none.
///
/// # Errors
/// [`ReadError`], with a line in ASCII parts and a byte offset in binary ones.
pub fn read(bytes: &[u8], limits: &Limits) -> Result<Imported, ReadError> {
    let mut reader = Reader::new(bytes, limits)?;
    while reader.section()? {}
    reader.finish()
}

/// Element types by their numbers.
mod element {
    pub(super) const LINE: i32 = 1;
    pub(super) const TRIANGLE: i32 = 2;
    pub(super) const QUAD: i32 = 3;
    pub(super) const POINT: i32 = 15;

    /// Number of nodes of types 1 to 31.
    const NODES: [u8; 31] = [
        2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21, 4, 5, 6, 20,
        35, 56,
    ];

    pub(super) fn nodes(kind: i32) -> Option<usize> {
        let index = usize::try_from(kind).ok()?.checked_sub(1)?;
        NODES.get(index).map(|&nodes| usize::from(nodes))
    }

    pub(super) fn is_curved_surface(kind: i32) -> bool {
        matches!(kind, 9 | 10 | 16 | 20..=25)
    }
}

/// Longest name of a section, bytes.
const SECTION_NAME: usize = 64;
/// Members of groups for each byte of the file: a cell of an entity is a member of all the entity's groups.
const MEMBERSHIPS: usize = 4;

struct Reader<'a> {
    cursor: Cursor<'a>,
    limits: &'a Limits,
    version: Version,
    /// Coding of the numbers inside sections that may be binary.
    coding: Coding,
    names: HashMap<(i32, i32), String>,
    /// Physical tags of each entity, by dimension and tag; none twice.
    physicals: HashMap<(i32, i32), Rc<[i32]>>,
    /// Node tags to indices.
    nodes: HashMap<u64, u32>,
    /// Cells or vertices of each physical group, by dimension and tag.
    members: BTreeMap<(i32, i32), Vec<u32>>,
    /// Entries of all of these.
    memberships: usize,
    /// Version 2 repeats a cell for each of its groups: cells by their sorted nodes.
    known: HashMap<[u32; 4], u32>,
    draft: Draft,
}

impl<'a> Reader<'a> {
    fn new(bytes: &'a [u8], limits: &'a Limits) -> Result<Self, ReadError> {
        let mut cursor = Cursor::new(bytes);
        expect(&mut cursor, "$MeshFormat")?;
        let place = cursor.place();
        let version = match cursor.word("a version")? {
            b"2.2" | b"2.1" | b"2" => Version::V2,
            b"4.1" => Version::V4,
            other => {
                let what = format!("MSH version {}", String::from_utf8_lossy(other));
                return Err(ReadError::Unsupported { place, what, advice: "write version 4.1 or 2.2" });
            }
        };
        let binary: u32 = cursor.number("a file type, 0 or 1")?;
        let place = cursor.place();
        let data_size: u32 = cursor.number("a data size")?;
        if data_size != 8 {
            let what = format!("data size {data_size}");
            return Err(ReadError::Unsupported { place, what, advice: "write numbers of 8 bytes" });
        }
        let mut coding = Coding::Ascii;
        if binary != 0 {
            cursor.line();
            let one = cursor.take(4, "the number 1 in binary")?;
            coding = match one {
                [1, 0, 0, 0] => Coding::LittleEndian,
                [0, 0, 0, 1] => Coding::BigEndian,
                _ => return Err(ReadError::unexpected(cursor.place(), "the number 1 in binary", one)),
            };
        }
        expect(&mut cursor, "$EndMeshFormat")?;
        Ok(Self {
            cursor,
            limits,
            version,
            coding,
            names: HashMap::new(),
            physicals: HashMap::new(),
            nodes: HashMap::new(),
            members: BTreeMap::new(),
            memberships: 0,
            known: HashMap::new(),
            draft: Draft::default(),
        })
    }

    /// Reads one section; false at the end of the file.
    fn section(&mut self) -> Result<bool, ReadError> {
        self.cursor.coding = Coding::Ascii;
        self.cursor.skip_space();
        if self.cursor.rest().is_empty() {
            return Ok(false);
        }
        let at = self.cursor.position;
        let word = self.cursor.word("a section")?;
        let name = word.strip_prefix(b"$").filter(|name| name.len() <= SECTION_NAME);
        let Some(name) = name else {
            return Err(ReadError::unexpected(self.cursor.place_of(at), "a section such as $Nodes", word));
        };
        self.cursor.line();
        match (name, self.version) {
            (b"PhysicalNames", _) => self.physical_names()?,
            (b"Entities", Version::V4) => self.entities()?,
            (b"Nodes", Version::V4) => self.nodes_4()?,
            (b"Nodes", Version::V2) => self.nodes_2()?,
            (b"Elements", Version::V4) => self.elements_4()?,
            (b"Elements", Version::V2) => self.elements_2()?,
            _ => return self.skip_section(name).map(|()| true),
        }
        self.cursor.coding = Coding::Ascii;
        expect(&mut self.cursor, &format!("$End{}", String::from_utf8_lossy(name)))?;
        Ok(true)
    }

    fn skip_section(&mut self, name: &[u8]) -> Result<(), ReadError> {
        let end = [b"$End", name].concat();
        let found = self.cursor.rest().windows(end.len()).position(|window| window == end);
        // Each window may have to be compared to its end.
        looked_at(end.len() * found.unwrap_or(self.cursor.rest().len()));
        match found {
            Some(length) => {
                self.cursor.position += length + end.len();
                Ok(())
            }
            None => {
                let expected = String::from_utf8_lossy(&end).into_owned();
                Err(ReadError::Truncated { place: self.cursor.place(), expected })
            }
        }
    }

    fn physical_names(&mut self) -> Result<(), ReadError> {
        let count = self.cursor.number("a count of names")?;
        let count = self.cursor.check_count("physical names", count, 3, 1, 2 * self.limits.groups)?;
        for _ in 0..count {
            let dimension = self.cursor.number("a dimension")?;
            let tag = self.cursor.number("a physical tag")?;
            let at = self.cursor.position;
            let line = self.cursor.line();
            let name = line.strip_prefix(b"\"").and_then(|name| name.strip_suffix(b"\""));
            let name = name
                .ok_or_else(|| ReadError::unexpected(self.cursor.place_of(at), "a name in quotes", line))?;
            self.names.insert((dimension, tag), String::from_utf8_lossy(name).into_owned());
        }
        Ok(())
    }

    fn entities(&mut self) -> Result<(), ReadError> {
        self.cursor.coding = self.coding;
        let mut counts = [0; 4];
        for count in &mut counts {
            *count = self.cursor.size("a count of entities")?;
        }
        for (dimension, count) in (0..).zip(counts) {
            let coordinates = if dimension == 0 { 3 } else { 6 };
            let bytes = 4 + 8 * coordinates + 8;
            let count = self.cursor.check_count("entities", count, coordinates + 2, bytes, usize::MAX)?;
            for _ in 0..count {
                let tag = self.cursor.int("an entity's tag")?;
                for _ in 0..coordinates {
                    self.cursor.real("an entity's bounds")?;
                }
                let mut physicals = self.tags("a physical tag")?;
                physicals.sort_unstable();
                physicals.dedup();
                self.physicals.insert((dimension, tag), physicals.into());
                if dimension > 0 {
                    self.tags("a bounding entity")?;
                }
            }
        }
        Ok(())
    }

    /// A count and as many integers.
    fn tags(&mut self, expected: &str) -> Result<Vec<i32>, ReadError> {
        let count = self.cursor.size("a count of tags")?;
        let count = self.cursor.check_count("tags", count, 1, 4, usize::MAX)?;
        (0..count).map(|_| self.cursor.int(expected)).collect()
    }

    fn node_limit(&self) -> usize {
        self.limits.vertices - self.draft.positions.len().min(self.limits.vertices)
    }

    fn nodes_4(&mut self) -> Result<(), ReadError> {
        self.cursor.coding = self.coding;
        let blocks = self.cursor.size("a count of node blocks")?;
        let blocks = self.cursor.check_count("node blocks", blocks, 4, 20, usize::MAX)?;
        let total = self.cursor.size("a count of nodes")?;
        self.cursor.check_count("nodes", total, 4, 32, self.node_limit())?;
        self.cursor.size("the smallest node tag")?;
        self.cursor.size("the largest node tag")?;
        for _ in 0..blocks {
            let at = self.cursor.position;
            let dimension = self.cursor.int("an entity's dimension")?;
            self.cursor.int("an entity's tag")?;
            let parametric = self.cursor.int("0 or 1 for parametric nodes")?;
            let parameters = match (parametric, usize::try_from(dimension)) {
                (0, _) => 0,
                (1, Ok(dimension @ 0..=3)) => dimension,
                _ => {
                    let found = format!("dimension {dimension}, parametric {parametric}");
                    return Err(ReadError::unexpected(
                        self.cursor.place_of(at),
                        "a node block",
                        found.as_bytes(),
                    ));
                }
            };
            let count = self.cursor.size("a count of nodes")?;
            let count = self.cursor.check_count("nodes", count, 4, 32, self.node_limit())?;
            for _ in 0..count {
                let tag = self.cursor.size("a node's tag")?;
                self.add_node(tag)?;
            }
            for _ in 0..count {
                let position = self.coordinates()?;
                self.draft.positions.push(position);
                for _ in 0..parameters {
                    self.cursor.real("a node's parameter")?;
                }
            }
        }
        Ok(())
    }

    fn nodes_2(&mut self) -> Result<(), ReadError> {
        let count = self.cursor.number("a count of nodes")?;
        self.cursor.line();
        self.cursor.coding = self.coding;
        let count = self.cursor.check_count("nodes", count, 4, 28, self.node_limit())?;
        for _ in 0..count {
            let tag = self.cursor.int("a node's number")?;
            let tag = u64::try_from(tag).map_err(|_| {
                ReadError::unexpected(
                    self.cursor.place(),
                    "a positive node number",
                    tag.to_string().as_bytes(),
                )
            })?;
            self.add_node(tag)?;
            let position = self.coordinates()?;
            self.draft.positions.push(position);
        }
        Ok(())
    }

    fn add_node(&mut self, tag: u64) -> Result<(), ReadError> {
        let index = self.draft.ids.len() as u32;
        if self.nodes.insert(tag, index).is_some() {
            let found = tag.to_string();
            return Err(ReadError::unexpected(self.cursor.place(), "a new node tag", found.as_bytes()));
        }
        self.draft.ids.push(tag);
        Ok(())
    }

    fn coordinates(&mut self) -> Result<[f64; 3], ReadError> {
        let mut position = [0.0; 3];
        for coordinate in &mut position {
            *coordinate = self.cursor.real("a coordinate")?;
        }
        Ok(position)
    }

    fn elements_4(&mut self) -> Result<(), ReadError> {
        self.cursor.coding = self.coding;
        let blocks = self.cursor.size("a count of element blocks")?;
        let blocks = self.cursor.check_count("element blocks", blocks, 4, 20, usize::MAX)?;
        let total = self.cursor.size("a count of elements")?;
        self.cursor.check_count("elements", total, 2, 16, usize::MAX)?;
        self.cursor.size("the smallest element tag")?;
        self.cursor.size("the largest element tag")?;
        for _ in 0..blocks {
            let dimension = self.cursor.int("an entity's dimension")?;
            let tag = self.cursor.int("an entity's tag")?;
            let (kind, nodes) = self.element_type()?;
            let count = self.cursor.size("a count of elements")?;
            let count = self.cursor.check_count("elements", count, 1 + nodes, 8 * (1 + nodes), usize::MAX)?;
            let physicals = self.physicals.get(&(dimension, tag)).map_or_else(Rc::default, Rc::clone);
            for _ in 0..count {
                self.cursor.size("an element's tag")?;
                self.element(kind, nodes, &physicals, |cursor| cursor.size("a node's tag"))?;
            }
        }
        Ok(())
    }

    fn elements_2(&mut self) -> Result<(), ReadError> {
        let count = self.cursor.number("a count of elements")?;
        self.cursor.line();
        self.cursor.coding = self.coding;
        let mut left = self.cursor.check_count("elements", count, 3, 8, usize::MAX)?;
        while left > 0 {
            // ASCII elements stand alone; binary ones come in runs of one type after a common head.
            let (kind, nodes, run, tags);
            if self.coding == Coding::Ascii {
                self.cursor.int("an element's number")?;
                (kind, nodes) = self.element_type()?;
                (run, tags) = (1, self.cursor.int("a count of tags")?);
            } else {
                (kind, nodes) = self.element_type()?;
                (run, tags) = (self.cursor.int("a count of elements")?, self.cursor.int("a count of tags")?);
            }
            let (run, tags) = match (usize::try_from(run), u64::try_from(tags)) {
                (Ok(run), Ok(tags)) if (1..=left).contains(&run) => (run, tags),
                _ => {
                    let found = format!("{run} elements with {tags} tags");
                    return Err(ReadError::unexpected(
                        self.cursor.place(),
                        "counts within bounds",
                        found.as_bytes(),
                    ));
                }
            };
            left -= run;
            let tags = self.cursor.check_count("tags", tags, 1, 4, usize::MAX)?;
            for _ in 0..run {
                if self.coding != Coding::Ascii {
                    self.cursor.int("an element's number")?;
                }
                let mut physical = 0;
                for k in 0..tags {
                    let tag = self.cursor.int("a tag")?;
                    if k == 0 {
                        physical = tag;
                    }
                }
                let physicals: &[i32] = if physical == 0 { &[] } else { &[physical] };
                // A negative number wraps to one that no node has.
                self.element(kind, nodes, physicals, |cursor| {
                    cursor.int("a node's number").map(|node| i64::from(node) as u64)
                })?;
            }
        }
        Ok(())
    }

    fn element_type(&mut self) -> Result<(i32, usize), ReadError> {
        let at = self.cursor.position;
        let kind = self.cursor.int("an element type")?;
        match element::nodes(kind) {
            Some(nodes) if !element::is_curved_surface(kind) => Ok((kind, nodes)),
            _ => Err(ReadError::Unsupported {
                place: self.cursor.place_of(at),
                what: format!("element type {kind}"),
                advice: "write straight triangles and quadrilaterals (Mesh.ElementOrder = 1)",
            }),
        }
    }

    fn element(
        &mut self,
        kind: i32,
        count: usize,
        physicals: &[i32],
        mut tag: impl FnMut(&mut Cursor<'a>) -> Result<u64, ReadError>,
    ) -> Result<(), ReadError> {
        let wanted = matches!(kind, element::POINT | element::LINE | element::TRIANGLE | element::QUAD);
        let mut nodes = [u32::MAX; 4];
        for k in 0..count {
            let at = self.cursor.position;
            let node = tag(&mut self.cursor)?;
            if wanted {
                let unknown = || ReadError::UnknownNode { place: self.cursor.place_of(at), node };
                nodes[k] = *self.nodes.get(&node).ok_or_else(unknown)?;
            }
        }
        let dimension = match kind {
            element::POINT => 0,
            element::LINE => 1,
            element::TRIANGLE | element::QUAD => {
                let index = self.add_cell(nodes)?;
                return self.add_members(2, physicals, &[index]);
            }
            // Curved lines could name groups as straight ones do, but belong to curved surfaces, which are rejected.
            8 | 26..=28 => return Ok(()),
            _ => {
                self.draft.ignored_cells += 1;
                return Ok(());
            }
        };
        self.add_members(dimension, physicals, &nodes[..count])
    }

    fn add_cell(&mut self, nodes: [u32; 4]) -> Result<u32, ReadError> {
        let index = self.draft.cells.len();
        if self.version == Version::V2 {
            let mut sorted = nodes;
            sorted.sort_unstable();
            let known = *self.known.entry(sorted).or_insert(index as u32);
            if (known as usize) < index {
                return Ok(known);
            }
        }
        if index >= self.limits.cells {
            let (count, limit) = (index as u64 + 1, self.limits.cells as u64);
            return Err(ReadError::TooMany { place: self.cursor.place(), what: "cells", count, limit });
        }
        let [a, b, c, d] = nodes;
        self.draft.cells.push(if d == u32::MAX { Cell::triangle(a, b, c) } else { Cell::quad(a, b, c, d) });
        Ok(index as u32)
    }

    fn add_members(&mut self, dimension: i32, physicals: &[i32], members: &[u32]) -> Result<(), ReadError> {
        for physical in physicals {
            // A negative tag means only that the entity's orientation is reversed.
            let key = (dimension, physical.saturating_abs());
            if self.members.len() >= 2 * self.limits.groups && !self.members.contains_key(&key) {
                let limit = 2 * self.limits.groups as u64;
                let (place, what) = (self.cursor.place(), "physical groups");
                return Err(ReadError::TooMany { place, what, count: limit + 1, limit });
            }
            looked_at(1 + members.len());
            self.memberships += members.len();
            let limit = MEMBERSHIPS * self.cursor.bytes.len();
            if self.memberships > limit {
                let (place, what) = (self.cursor.place(), "members of physical groups");
                let (count, limit) = (self.memberships as u64, limit as u64);
                return Err(ReadError::TooMany { place, what, count, limit });
            }
            self.members.entry(key).or_default().extend(members);
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Imported, ReadError> {
        if self.draft.positions.is_empty() {
            return Err(ReadError::Missing { what: "nodes" });
        }
        for ((dimension, tag), members) in self.members {
            let name = self.names.get(&(dimension, tag));
            let name = name.cloned().unwrap_or_else(|| format!("physical {tag}"));
            let draft = &mut self.draft;
            let groups = if dimension == 2 { &mut draft.cell_groups } else { &mut draft.vertex_groups };
            groups.add(&name, members);
        }
        self.draft.finish(self.limits)
    }
}

fn expect(cursor: &mut Cursor<'_>, expected: &str) -> Result<(), ReadError> {
    let at = cursor.position;
    let word = cursor.word(expected)?;
    if word == expected.as_bytes() {
        Ok(())
    } else {
        Err(ReadError::unexpected(cursor.place_of(at), expected, word))
    }
}

/// Writes ASCII. Vertex groups become physical curves (edges with both ends in the group) and physical points (the rest)
/// of the same name; coordinates read back to the same bits, cells in the same order. Quotes and control characters in
/// names, which the format cannot hold, become `'` and spaces.
pub fn write(mesh: &SurfaceMesh, version: Version) -> Vec<u8> {
    let layout = Layout::new(mesh);
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = match version {
        Version::V2 => layout.write_2(mesh, &mut out),
        Version::V4 => layout.write_4(mesh, &mut out),
    };
    out.into_bytes()
}

/// The map from groups to physical groups and entities.
struct Layout {
    /// Groups of each cell.
    cell_groups: Csr,
    /// The entity of each cell: cells in the same groups share one.
    entity: Vec<usize>,
    /// Groups of each entity.
    entities: Vec<Vec<u32>>,
    /// Edges and single vertices of each vertex group.
    curves: Vec<(Vec<[u32; 2]>, Vec<u32>)>,
}

impl Layout {
    fn new(mesh: &SurfaceMesh) -> Self {
        let pairs = mesh.cell_groups.iter().zip(0_u32..);
        let pairs = pairs.flat_map(|(group, number)| group.indices.iter().map(move |&cell| (cell, number)));
        let cell_groups = Csr::from_pairs(mesh.cells.len(), pairs);
        let mut numbers: HashMap<&[u32], usize> = HashMap::new();
        let mut entities = Vec::new();
        let mut entity = Vec::with_capacity(mesh.cells.len());
        for groups in cell_groups.rows() {
            entity.push(*numbers.entry(groups).or_insert_with(|| {
                entities.push(groups.to_vec());
                entities.len() - 1
            }));
        }
        let edges = if mesh.vertex_groups.is_empty() { Vec::new() } else { Topology::new(mesh).edges };
        let curve = |indices: &Vec<u32>| {
            let mut member = vec![false; mesh.vertices.len()];
            indices.iter().for_each(|&vertex| member[vertex as usize] = true);
            let inside = |edge: &&[u32; 2]| edge.iter().all(|&vertex| member[vertex as usize]);
            let edges: Vec<[u32; 2]> = edges.iter().filter(inside).copied().collect();
            edges.iter().flatten().for_each(|&vertex| member[vertex as usize] = false);
            let single = indices.iter().copied().filter(|&vertex| member[vertex as usize]).collect();
            (edges, single)
        };
        let curves = mesh.vertex_groups.iter().map(|group| curve(&group.indices)).collect();
        Self { cell_groups, entity, entities, curves }
    }

    fn write_names(&self, mesh: &SurfaceMesh, out: &mut String) -> std::fmt::Result {
        let vertex_groups = |dimension: usize| {
            let groups = mesh.vertex_groups.iter().zip(&self.curves).enumerate();
            groups.filter_map(move |(number, (group, (edges, single)))| {
                let empty = if dimension == 0 { single.is_empty() } else { edges.is_empty() };
                (!empty).then_some((dimension, number + 1, &group.name))
            })
        };
        let cell_groups =
            mesh.cell_groups.iter().enumerate().map(|(number, group)| (2, number + 1, &group.name));
        let names: Vec<_> = vertex_groups(0).chain(vertex_groups(1)).chain(cell_groups).collect();
        if names.is_empty() {
            return Ok(());
        }
        writeln!(out, "$PhysicalNames\n{}", names.len())?;
        for (dimension, tag, name) in names {
            let name = name.replace('"', "'").replace(char::is_control, " ");
            writeln!(out, "{dimension} {tag} \"{name}\"")?;
        }
        writeln!(out, "$EndPhysicalNames")
    }

    fn write_4(&self, mesh: &SurfaceMesh, out: &mut String) -> std::fmt::Result {
        writeln!(out, "$MeshFormat\n4.1 0 8\n$EndMeshFormat")?;
        self.write_names(mesh, out)?;

        let [low, high] = mesh.bounds();
        let bounds = format!("{} {}", coordinates(&low), coordinates(&high));
        let points: Vec<_> = (1..).zip(&self.curves).filter(|(_, (_, single))| !single.is_empty()).collect();
        let curves: Vec<_> = (1..).zip(&self.curves).filter(|(_, (edges, _))| !edges.is_empty()).collect();
        writeln!(out, "$Entities\n{} {} {} 0", points.len(), curves.len(), self.entities.len())?;
        for &(tag, (_, single)) in &points {
            writeln!(out, "{tag} {} 1 {tag}", coordinates(&mesh.vertices[single[0] as usize]))?;
        }
        for &(tag, _) in &curves {
            writeln!(out, "{tag} {bounds} 1 {tag} 0")?;
        }
        for (tag, groups) in (1..).zip(&self.entities) {
            write!(out, "{tag} {bounds} {}", groups.len())?;
            groups.iter().try_for_each(|group| write!(out, " {}", group + 1))?;
            writeln!(out, " 0")?;
        }
        writeln!(out, "$EndEntities")?;

        let count = mesh.vertices.len();
        writeln!(out, "$Nodes\n1 {count} 1 {count}\n2 1 0 {count}")?;
        (1..=count).try_for_each(|tag| writeln!(out, "{tag}"))?;
        mesh.vertices.iter().try_for_each(|x| writeln!(out, "{}", coordinates(x)))?;
        writeln!(out, "$EndNodes")?;

        // Runs of cells of one entity and type keep the cells in order.
        let kinds: Vec<_> =
            mesh.cells.iter().zip(&self.entity).map(|(cell, &entity)| (entity, kind(cell))).collect();
        let runs = kinds.chunk_by(|a, b| a == b).count();
        let single: usize = points.iter().map(|(_, (_, single))| single.len()).sum();
        let edges: usize = curves.iter().map(|(_, (edges, _))| edges.len()).sum();
        let total = single + edges + mesh.cells.len();
        writeln!(out, "$Elements\n{} {total} 1 {total}", points.len() + curves.len() + runs)?;
        let mut tag = 0;
        let mut element = |out: &mut String, vertices: &[u32]| {
            tag += 1;
            write!(out, "{tag}")?;
            write_nodes(out, vertices)
        };
        for (entity, (_, single)) in points {
            writeln!(out, "0 {entity} {} {}", element::POINT, single.len())?;
            single.iter().try_for_each(|&vertex| element(out, &[vertex]))?;
        }
        for (entity, (edges, _)) in curves {
            writeln!(out, "1 {entity} {} {}", element::LINE, edges.len())?;
            edges.iter().try_for_each(|edge| element(out, edge))?;
        }
        let mut cells = mesh.cells.iter();
        for run in kinds.chunk_by(|a, b| a == b) {
            let (entity, kind) = run[0];
            writeln!(out, "2 {} {kind} {}", entity + 1, run.len())?;
            cells.by_ref().take(run.len()).try_for_each(|cell| element(out, cell.vertices()))?;
        }
        writeln!(out, "$EndElements")
    }

    fn write_2(&self, mesh: &SurfaceMesh, out: &mut String) -> std::fmt::Result {
        writeln!(out, "$MeshFormat\n2.2 0 8\n$EndMeshFormat")?;
        self.write_names(mesh, out)?;
        writeln!(out, "$Nodes\n{}", mesh.vertices.len())?;
        for (tag, x) in (1..).zip(&mesh.vertices) {
            writeln!(out, "{tag} {}", coordinates(x))?;
        }
        writeln!(out, "$EndNodes")?;

        let mut elements = String::new();
        let mut tag = 0;
        let mut element = |kind: i32, physical: u32, entity: usize, vertices: &[u32]| {
            tag += 1;
            write!(elements, "{tag} {kind} 2 {physical} {entity}")?;
            write_nodes(&mut elements, vertices)
        };
        for (number, (edges, single)) in (1_u32..).zip(&self.curves) {
            let entity = number as usize;
            single.iter().try_for_each(|&vertex| element(element::POINT, number, entity, &[vertex]))?;
            edges.iter().try_for_each(|edge| element(element::LINE, number, entity, edge))?;
        }
        for (index, cell) in mesh.cells.iter().enumerate() {
            let entity = self.entity[index] + 1;
            let groups = self.cell_groups.row(index);
            if groups.is_empty() {
                element(kind(cell), 0, entity, cell.vertices())?;
            }
            groups.iter().try_for_each(|group| element(kind(cell), group + 1, entity, cell.vertices()))?;
        }
        writeln!(out, "$Elements\n{tag}\n{elements}$EndElements")
    }
}

fn kind(cell: &Cell) -> i32 {
    if cell.is_triangle() { element::TRIANGLE } else { element::QUAD }
}

/// Shortest digits that read back to the same bits.
fn coordinates([x, y, z]: &[f64; 3]) -> String {
    format!("{x:?} {y:?} {z:?}")
}

fn write_nodes(out: &mut String, vertices: &[u32]) -> std::fmt::Result {
    vertices.iter().try_for_each(|vertex| write!(out, " {}", u64::from(*vertex) + 1))?;
    writeln!(out)
}
