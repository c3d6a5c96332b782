//! Writes meshes as MSH.

use std::{collections::HashMap, fmt::Write};

use super::{Version, element};
use crate::{Cell, Csr, SurfaceMesh, Topology};

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
pub(super) fn coordinates([x, y, z]: &[f64; 3]) -> String {
    format!("{x:?} {y:?} {z:?}")
}

fn write_nodes(out: &mut String, vertices: &[u32]) -> std::fmt::Result {
    vertices.iter().try_for_each(|vertex| write!(out, " {}", u64::from(*vertex) + 1))?;
    writeln!(out)
}
