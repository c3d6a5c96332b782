//! The raw result of a reader, and the mesh that it becomes.

use std::collections::HashMap;

use super::{Imported, ReadError, looked_at};
use crate::{
    Cell, Group, LeftOut, Limits, Numbering, Origin, SurfaceMesh,
    merge::{self, LARGEST_LOSS},
};

/// Nodes that cells may or may not use, cells, and groups whose indices may repeat.
#[derive(Default)]
pub(super) struct Draft {
    /// The file's number of each node.
    pub(super) ids: Vec<u64>,
    pub(super) positions: Vec<[f64; 3]>,
    /// Cells, as indices of `positions`.
    pub(super) cells: Vec<Cell>,
    /// The file's number of each cell.
    pub(super) cell_ids: Vec<u64>,
    pub(super) cell_groups: Groups,
    pub(super) vertex_groups: Groups,
    /// Cells of other kinds.
    pub(super) other_cells: usize,
}

/// Groups in order of appearance, found by name.
#[derive(Default)]
pub(super) struct Groups {
    pub(super) list: Vec<Group>,
    numbers: HashMap<String, usize>,
}

impl Groups {
    /// Adds indices to the group of that name, which may be new.
    pub(super) fn add(&mut self, name: &str, indices: impl IntoIterator<Item = u32>) {
        looked_at(1 + name.len());
        let number = match self.numbers.get(name) {
            Some(&number) => number,
            None => {
                self.numbers.insert(name.to_owned(), self.list.len());
                self.list.push(Group { name: name.to_owned(), indices: Vec::new() });
                self.list.len() - 1
            }
        };
        self.list[number].indices.extend(indices);
    }

    /// Renumbers the members; those without a new number leave.
    fn renumber(&mut self, number: impl Fn(u32) -> Option<u32>) {
        for group in &mut self.list {
            group.indices = group.indices.iter().filter_map(|&index| number(index)).collect();
            group.indices.sort_unstable();
            group.indices.dedup();
        }
    }
}

impl Draft {
    /// A mesh with its indices as numbers.
    pub(super) fn of_mesh(mesh: SurfaceMesh) -> Self {
        let SurfaceMesh { vertices, cells, cell_groups, vertex_groups } = mesh;
        let groups = |list| Groups { list, numbers: HashMap::new() };
        Self {
            ids: (0..vertices.len() as u64).collect(),
            positions: vertices,
            cell_ids: (0..cells.len() as u64).collect(),
            cells,
            cell_groups: groups(cell_groups),
            vertex_groups: groups(vertex_groups),
            other_cells: 0,
        }
    }

    /// Merges nodes: those that are `equal` (for each node the one that it becomes; empty for none), and those within `tolerance` (in
    /// the file's unit, 0 for none). Leaves out nodes that no cell uses and cells that collapse, sorts the groups, and validates.
    pub(super) fn finish(
        mut self,
        numbering: Numbering,
        equal: Vec<u32>,
        tolerance: f64,
        limits: &Limits,
    ) -> Result<Imported, ReadError> {
        if self.cells.is_empty() {
            return Err(ReadError::NoSurface { nodes: self.positions.len(), other_cells: self.other_cells });
        }
        // Equal nodes are also near.
        let target = if tolerance > 0.0 { merge::near(&self.positions, tolerance) } else { equal };
        let becomes = |node: u32| target.get(node as usize).copied().unwrap_or(node);
        let collapse = |cell: &Cell| {
            // The corners of facets are merged from the start; that another file's cell names a node twice is an error.
            let merges = !target.is_empty() || numbering == Numbering::Facets;
            if merges { merge::collapse(&cell.map(becomes)) } else { Some(*cell) }
        };
        let collapsed = self.collapse(collapse, tolerance)?;

        const UNUSED: u32 = u32::MAX;
        let mut number = vec![UNUSED; self.positions.len()];
        for vertex in self.cells.iter().flat_map(|cell| cell.vertices()) {
            number[*vertex as usize] = 0;
        }
        let mut used = 0;
        for number in number.iter_mut().filter(|number| **number != UNUSED) {
            *number = used;
            used += 1;
        }
        let number_of = |node: u32| Some(number[becomes(node) as usize]).filter(|&number| number != UNUSED);
        let mut merged = Vec::new();
        for (node, &id) in (0..).zip(&self.ids) {
            if becomes(node) != node
                && let Some(vertex) = number_of(node)
            {
                merged.push((id, vertex));
            }
        }
        let left_out = LeftOut {
            nodes: number.len() - used as usize - merged.len(),
            merged_nodes: merged.len(),
            other_cells: self.other_cells,
            collapsed_cells: collapsed,
        };
        self.vertex_groups.renumber(number_of);
        for cell in &mut self.cells {
            *cell = cell.map(|vertex| number[vertex as usize]);
        }
        let mut keep = number.iter().map(|&number| number != UNUSED);
        self.positions.retain(|_| keep.next() == Some(true));
        let mut keep = number.iter().map(|&number| number != UNUSED);
        self.ids.retain(|_| keep.next() == Some(true));

        let Self { ids, positions, cells, cell_ids, cell_groups, vertex_groups, .. } = self;
        let origin = Origin { numbering, nodes: ids, cells: cell_ids, merged, left_out };
        match SurfaceMesh::with_limits(positions, cells, cell_groups.list, vertex_groups.list, limits) {
            Ok(mesh) => Ok(Imported { mesh, origin }),
            Err(error) => Err(ReadError::Mesh { message: origin.explain(&error.to_string()), error }),
        }
    }

    /// Leaves out the cells that collapse; their number.
    fn collapse(
        &mut self,
        collapse: impl Fn(&Cell) -> Option<Cell>,
        tolerance: f64,
    ) -> Result<usize, ReadError> {
        let kept: Vec<Option<Cell>> = self.cells.iter().map(collapse).collect();
        let count = kept.iter().filter(|kept| kept.is_none()).count();
        let mut next = 0;
        let numbers: Vec<Option<u32>> = kept
            .iter()
            .map(|kept| {
                next += u32::from(kept.is_some());
                kept.map(|_| next - 1)
            })
            .collect();
        if count > 0 && tolerance > 0.0 {
            let loss = merge::loss(&self.positions, &self.cells, kept.iter().map(Option::is_none));
            if loss > LARGEST_LOSS {
                return Err(ReadError::MergeTolerance { tolerance, count, cells: kept.len(), loss });
            }
        }
        self.cell_groups.renumber(|cell| numbers[cell as usize]);
        let mut keep = kept.iter().map(Option::is_some);
        self.cell_ids.retain(|_| keep.next() == Some(true));
        self.cells = kept.into_iter().flatten().collect();
        Ok(count)
    }
}
