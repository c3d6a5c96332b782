//! The sections of an MSH file.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    ops::Range,
    rc::Rc,
};

use super::element;
use crate::{
    Cell, Limits, Numbering,
    io::{
        Draft, Imported, ReadError,
        cursor::{Coding, Cursor},
        looked_at,
    },
};

/// The dialects that differ in their sections. 2.0 and 2.1 are read as 2.2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Dialect {
    V2,
    V40,
    V41,
}

/// Longest name of a section, bytes.
const SECTION_NAME: usize = 64;
/// Members of groups for each byte of the file: a cell of an entity is a member of all the entity's groups.
const MEMBERSHIPS: usize = 4;

pub(super) struct Reader<'a> {
    cursor: Cursor<'a>,
    limits: &'a Limits,
    dialect: Dialect,
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
    /// Version 2 repeats a cell for each of its groups: cells by their sorted nodes, and the groups of each.
    known: HashMap<[u32; 4], u32>,
    listed: HashSet<(u32, i32)>,
    /// Bytes of each node's coordinates.
    spans: Vec<Range<usize>>,
    draft: Draft,
}

impl<'a> Reader<'a> {
    /// Reads all sections.
    pub(super) fn read(bytes: &'a [u8], limits: &'a Limits) -> Result<Self, ReadError> {
        let mut reader = Self {
            cursor: Cursor::new(bytes),
            limits,
            dialect: Dialect::V2,
            coding: Coding::Ascii,
            names: HashMap::new(),
            physicals: HashMap::new(),
            nodes: HashMap::new(),
            members: BTreeMap::new(),
            memberships: 0,
            known: HashMap::new(),
            listed: HashSet::new(),
            spans: Vec::new(),
            draft: Draft::default(),
        };
        reader.format()?;
        while reader.section()? {}
        Ok(reader)
    }

    /// `$MeshFormat`, which comes first but for comments.
    fn format(&mut self) -> Result<(), ReadError> {
        loop {
            self.cursor.skip_space();
            match self.cursor.rest() {
                rest if rest.starts_with(b"$Comments") => {
                    self.cursor.line();
                    self.skip_section(b"Comments")?;
                }
                rest if rest.starts_with(b"$NOD") => {
                    let (place, what) = (self.cursor.place(), "MSH version 1".to_owned());
                    return Err(ReadError::Unsupported { place, what, advice: "write version 4.1 or 2.2" });
                }
                _ => break,
            }
        }
        let cursor = &mut self.cursor;
        expect(cursor, "$MeshFormat")?;
        let place = cursor.place();
        self.dialect = match cursor.word("a version")? {
            b"2" | b"2.0" | b"2.1" | b"2.2" => Dialect::V2,
            b"4" | b"4.0" => Dialect::V40,
            b"4.1" => Dialect::V41,
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
        if binary != 0 {
            cursor.line();
            let one = cursor.take(4, "the number 1 in binary")?;
            self.coding = match one {
                [1, 0, 0, 0] => Coding::LittleEndian,
                [0, 0, 0, 1] => Coding::BigEndian,
                _ => return Err(ReadError::unexpected(cursor.place(), "the number 1 in binary", one)),
            };
        }
        expect(cursor, "$EndMeshFormat")
    }

    /// The tag of each node, where its coordinates are, and how they are coded; in the order of the file.
    pub(super) fn positions(&self) -> impl Iterator<Item = (u64, Range<usize>, Coding)> {
        self.draft.ids.iter().zip(&self.spans).map(|(&tag, span)| (tag, span.clone(), self.coding))
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
        match (name, self.dialect) {
            (b"PhysicalNames", _) => self.physical_names()?,
            (b"Entities", Dialect::V40 | Dialect::V41) => self.entities()?,
            (b"PartitionedEntities", Dialect::V40 | Dialect::V41) => self.partitioned_entities()?,
            (b"Nodes", Dialect::V40 | Dialect::V41) => self.nodes_4()?,
            (b"Nodes", Dialect::V2) => self.nodes_2(false)?,
            (b"ParametricNodes", Dialect::V2) => self.nodes_2(true)?,
            (b"Elements", Dialect::V40 | Dialect::V41) => self.elements_4()?,
            (b"Elements", Dialect::V2) => self.elements_2()?,
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
        self.entity_lists(false)
    }

    fn partitioned_entities(&mut self) -> Result<(), ReadError> {
        self.cursor.coding = self.coding;
        self.cursor.size("a count of partitions")?;
        let ghosts = self.cursor.size("a count of ghost entities")?;
        let ghosts = self.cursor.check_count("ghost entities", ghosts, 2, 8, usize::MAX)?;
        for _ in 0..2 * ghosts {
            self.cursor.int("a ghost entity's tag and partition")?;
        }
        self.entity_lists(true)
    }

    /// Points, curves, surfaces and volumes. Those of partitions belong to their parents' groups as well.
    fn entity_lists(&mut self, partitioned: bool) -> Result<(), ReadError> {
        let mut counts = [0; 4];
        for count in &mut counts {
            *count = self.cursor.size("a count of entities")?;
        }
        for (dimension, count) in (0..).zip(counts) {
            // Version 4.0 writes a box for points, too.
            let coordinates = if dimension == 0 && self.dialect == Dialect::V41 { 3 } else { 6 };
            let bytes = 4 + 8 * coordinates + 8;
            let count = self.cursor.check_count("entities", count, coordinates + 2, bytes, usize::MAX)?;
            for _ in 0..count {
                let tag = self.cursor.int("an entity's tag")?;
                let mut physicals = Vec::new();
                if partitioned {
                    let parent =
                        (self.cursor.int("the parent's dimension")?, self.cursor.int("the parent's tag")?);
                    // Borders between partitions have a parent of another dimension, in whose groups they are not.
                    if parent.0 == dimension
                        && let Some(of_parent) = self.physicals.get(&parent)
                    {
                        physicals.extend_from_slice(of_parent);
                    }
                    self.tags("a partition")?;
                }
                for _ in 0..coordinates {
                    self.cursor.real("an entity's bounds")?;
                }
                physicals.extend(self.tags("a physical tag")?);
                physicals.sort_unstable();
                physicals.dedup();
                looked_at(physicals.len());
                self.memberships += physicals.len();
                self.check_memberships()?;
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
        self.cursor.check_count("nodes", total, 4, 28, self.node_limit())?;
        self.range_of_tags("node")?;
        for _ in 0..blocks {
            let at = self.cursor.position;
            let (dimension, _) = self.entity()?;
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
            let count = self.cursor.check_count("nodes", count, 4, 28, self.node_limit())?;
            let first = self.draft.ids.len();
            if self.dialect == Dialect::V41 {
                for _ in 0..count {
                    let tag = self.cursor.size("a node's tag")?;
                    self.add_node(tag)?;
                }
            }
            for _ in 0..count {
                if self.dialect == Dialect::V40 {
                    let tag = self.node_number()?;
                    self.add_node(tag)?;
                }
                self.coordinates()?;
                for _ in 0..parameters {
                    self.cursor.real("a node's parameter")?;
                }
            }
            debug_assert_eq!(self.draft.ids.len(), first + count);
        }
        Ok(())
    }

    /// Dimension and tag of a block's entity, which version 4.0 writes the other way round.
    fn entity(&mut self) -> Result<(i32, i32), ReadError> {
        let one = self.cursor.int("an entity's dimension or tag")?;
        let other = self.cursor.int("an entity's dimension or tag")?;
        Ok(if self.dialect == Dialect::V40 { (other, one) } else { (one, other) })
    }

    /// The smallest and largest tag, in version 4.1.
    fn range_of_tags(&mut self, what: &str) -> Result<(), ReadError> {
        if self.dialect == Dialect::V41 {
            self.cursor.size(&format!("the smallest {what} tag"))?;
            self.cursor.size(&format!("the largest {what} tag"))?;
        }
        Ok(())
    }

    fn node_number(&mut self) -> Result<u64, ReadError> {
        let at = self.cursor.position;
        let tag = self.cursor.int("a node's number")?;
        u64::try_from(tag).map_err(|_| {
            let place = self.cursor.place_of(at);
            ReadError::unexpected(place, "a positive node number", tag.to_string().as_bytes())
        })
    }

    /// Parametric nodes have the dimension and tag of their entity behind them, and one parameter for each dimension.
    fn nodes_2(&mut self, parametric: bool) -> Result<(), ReadError> {
        let count = self.cursor.number("a count of nodes")?;
        self.cursor.line();
        self.cursor.coding = self.coding;
        let count = self.cursor.check_count("nodes", count, 4, 28, self.node_limit())?;
        for _ in 0..count {
            let tag = self.node_number()?;
            self.add_node(tag)?;
            self.coordinates()?;
            if parametric {
                let dimension = self.cursor.int("an entity's dimension")?;
                self.cursor.int("an entity's tag")?;
                for _ in 0..if dimension < 3 { dimension } else { 0 } {
                    self.cursor.real("a node's parameter")?;
                }
            }
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

    fn coordinates(&mut self) -> Result<(), ReadError> {
        if self.cursor.coding == Coding::Ascii {
            self.cursor.skip_space();
        }
        let start = self.cursor.position;
        let mut position = [0.0; 3];
        for coordinate in &mut position {
            *coordinate = self.cursor.real("a coordinate")?;
        }
        self.draft.positions.push(position);
        self.spans.push(start..self.cursor.position);
        Ok(())
    }

    fn elements_4(&mut self) -> Result<(), ReadError> {
        self.cursor.coding = self.coding;
        let blocks = self.cursor.size("a count of element blocks")?;
        let blocks = self.cursor.check_count("element blocks", blocks, 4, 20, usize::MAX)?;
        let total = self.cursor.size("a count of elements")?;
        self.cursor.check_count("elements", total, 2, 8, usize::MAX)?;
        self.range_of_tags("element")?;
        for _ in 0..blocks {
            let entity = self.entity()?;
            let (kind, nodes) = self.element_type()?;
            let count = self.cursor.size("a count of elements")?;
            let count = self.cursor.check_count("elements", count, 1 + nodes, 4 * (1 + nodes), usize::MAX)?;
            let physicals = self.physicals.get(&entity).map_or_else(Rc::default, Rc::clone);
            let wide = self.dialect == Dialect::V41;
            let number = move |cursor: &mut Cursor<'a>| match wide {
                true => cursor.size("a tag"),
                false => cursor.int("a tag").map(|tag| i64::from(tag) as u64),
            };
            for _ in 0..count {
                let tag = number(&mut self.cursor)?;
                self.element((kind, nodes), tag, &physicals, number)?;
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
            let mut number = 0;
            if self.coding == Coding::Ascii {
                number = self.cursor.int("an element's number")?;
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
                    number = self.cursor.int("an element's number")?;
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
                self.element((kind, nodes), i64::from(number) as u64, physicals, |cursor| {
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
        (kind, count): (i32, usize),
        id: u64,
        physicals: &[i32],
        tag: impl Fn(&mut Cursor<'a>) -> Result<u64, ReadError>,
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
                let index = self.add_cell(id, nodes, physicals)?;
                return self.add_members(2, physicals, &[index]);
            }
            // Curved lines could name groups as straight ones do, but belong to curved surfaces, which are rejected.
            8 | 26..=28 => return Ok(()),
            _ => {
                self.draft.other_cells += 1;
                return Ok(());
            }
        };
        self.add_members(dimension, physicals, &nodes[..count])
    }

    /// The index of a cell, which is new unless version 2 repeats it for a further group.
    fn add_cell(&mut self, id: u64, nodes: [u32; 4], physicals: &[i32]) -> Result<u32, ReadError> {
        let index = self.draft.cells.len();
        if self.dialect == Dialect::V2 {
            let mut sorted = nodes;
            sorted.sort_unstable();
            let known = *self.known.entry(sorted).or_insert(index as u32);
            // A second time in the same group it is a cell of its own, which whoever uses the mesh has to refuse.
            let group = physicals.first().map_or(0, |physical| physical.saturating_abs());
            if self.listed.insert((known, group)) && (known as usize) < index {
                return Ok(known);
            }
        }
        if index >= self.limits.cells {
            let (count, limit) = (index as u64 + 1, self.limits.cells as u64);
            return Err(ReadError::TooMany { place: self.cursor.place(), what: "cells", count, limit });
        }
        let [a, b, c, d] = nodes;
        self.draft.cell_ids.push(id);
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
            self.check_memberships()?;
            self.members.entry(key).or_default().extend(members);
        }
        Ok(())
    }

    fn check_memberships(&self) -> Result<(), ReadError> {
        let limit = MEMBERSHIPS * self.cursor.bytes.len();
        if self.memberships <= limit {
            return Ok(());
        }
        let (place, what) = (self.cursor.place(), "members of physical groups");
        Err(ReadError::TooMany { place, what, count: self.memberships as u64, limit: limit as u64 })
    }

    pub(super) fn finish(mut self, tolerance: f64) -> Result<Imported, ReadError> {
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
        self.draft.finish(Numbering::Tags, Vec::new(), tolerance, self.limits)
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
