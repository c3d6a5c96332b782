//! Ownership: the components that each vertex and cell lies on, where on them, and the freedom that a vertex has there. Found by
//! projection alone.

use moldline_geometry::{Body, Feature, Location};
use moldline_mesh::{Cell, SurfaceMesh, Topology, area_vector};
use moldline_spline::Vector3;
use rayon::prelude::*;

use crate::{
    Monitor, SetupError, Stage,
    error::{LISTED, VertexDistance},
    fit::misfit,
};

/// Distance of a parameter from the side of a patch, relative to its range, up to which it is on the side.
const ON_SIDE: f64 = 1e-9;
/// Vertices handled between two calls of the monitor.
const CHUNK: usize = 2048;

/// The freedom that the constraints leave to a vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// Moves over its component's surface.
    Surface,
    /// Slides along a sharp edge of its component.
    Edge(u32),
    /// Follows its component at fixed parameters: corners, poles, protected groups.
    Fixed,
}

/// A vertex on one component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attachment {
    /// Index of the component.
    pub component: u32,
    /// Parameters of the vertex there.
    pub location: Location,
    /// The freedom that it has there.
    pub freedom: Freedom,
    /// Distance of the vertex of the mesh as given from the component, m.
    pub distance: f64,
}

/// The attachments of all vertices and the owners of all cells.
#[derive(Clone, Debug)]
pub struct Ownership {
    /// Attachments of vertex `v`: `attachments[offsets[v]..offsets[v + 1]]`, by component; more than one on a seam.
    offsets: Vec<u32>,
    attachments: Vec<Attachment>,
    /// Owner of each cell.
    pub cell_owner: Vec<u32>,
}

/// The parts of an [`Ownership`], as they are found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OwnershipParts {
    /// Attachments of vertex `v`: `attachments[offsets[v]..offsets[v + 1]]`.
    pub offsets: Vec<u32>,
    /// The attachments of all vertices.
    pub attachments: Vec<Attachment>,
    /// Owner of each cell.
    pub cell_owner: Vec<u32>,
}

impl Ownership {
    /// The ownership of these parts; `None` if they do not fit the numbers of vertices and cells, or the bodies.
    pub fn restore(parts: OwnershipParts, vertices: usize, cells: usize, bodies: &[Body]) -> Option<Self> {
        let OwnershipParts { offsets, attachments, cell_owner } = parts;
        let ordered = offsets.len() == vertices + 1
            && offsets.first() == Some(&0)
            && offsets.last().map(|&end| end as usize) == Some(attachments.len())
            && offsets.windows(2).all(|pair| pair[0] < pair[1]);
        let fits = attachments.iter().all(|attachment| {
            let Some(body) = bodies.get(attachment.component as usize) else { return false };
            let edges = body.component().edges().len();
            (attachment.location.patch as usize) < body.component().patches().len()
                && !matches!(attachment.freedom, Freedom::Edge(edge) if edge as usize >= edges)
        });
        let owned = cell_owner.len() == cells && cell_owner.iter().all(|&c| (c as usize) < bodies.len());
        (ordered && fits && owned).then_some(Self { offsets, attachments, cell_owner })
    }

    /// The parts, for [`restore`](Self::restore).
    pub fn parts(&self) -> OwnershipParts {
        OwnershipParts {
            offsets: self.offsets.clone(),
            attachments: self.attachments.clone(),
            cell_owner: self.cell_owner.clone(),
        }
    }

    /// The attachments of a vertex: at least one, several on a seam.
    pub fn of(&self, vertex: u32) -> &[Attachment] {
        let v = vertex as usize;
        &self.attachments[self.offsets[v] as usize..self.offsets[v + 1] as usize]
    }

    /// The first attachment of a vertex: the component that it is placed on.
    pub fn first(&self, vertex: u32) -> &Attachment {
        &self.attachments[self.offsets[vertex as usize] as usize]
    }

    /// The attachment of a vertex to a component, if it lies on it.
    pub fn on(&self, vertex: u32, component: u32) -> Option<&Attachment> {
        self.of(vertex).iter().find(|a| a.component == component)
    }

    /// Whether a vertex lies on several components.
    pub fn is_seam(&self, vertex: u32) -> bool {
        self.of(vertex).len() > 1
    }

    /// Whether a vertex lies on one component and may move all over it.
    pub fn is_free(&self, vertex: u32) -> bool {
        matches!(self.of(vertex), [only] if only.freedom == Freedom::Surface)
    }

    /// Number of vertices.
    pub fn vertex_count(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The indices of all vertices.
    pub fn vertices(&self) -> std::ops::Range<u32> {
        // Meshes count their vertices in 32 bits.
        0..self.vertex_count() as u32
    }

    /// Fixes the attachments of the vertices of a mask.
    pub fn fix(&mut self, mask: &[bool]) {
        for (range, _) in self.offsets.windows(2).zip(mask).filter(|(_, fixed)| **fixed) {
            let attachments = &mut self.attachments[range[0] as usize..range[1] as usize];
            attachments.iter_mut().for_each(|a| a.freedom = Freedom::Fixed);
        }
    }

    /// As `found` before, if that fits the mesh and the bodies; otherwise by [`find`](Self::find).
    ///
    /// # Errors
    /// As `find`.
    pub fn new(
        found: OwnershipParts,
        mesh: &SurfaceMesh,
        bodies: &[Body],
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        match Self::restore(found, mesh.vertices.len(), mesh.cells.len(), bodies) {
            Some(found) => Ok(found),
            None => Self::find(&mesh.vertices, &mesh.cells, bodies, tolerance, monitor),
        }
    }

    /// Finds the ownership by projecting all vertices on all components.
    ///
    /// `tolerance`: m, within which a vertex lies on a component.
    ///
    /// # Errors
    /// Vertices off every component, cells across a seam, components without cells.
    pub fn find(
        vertices: &[[f64; 3]],
        cells: &[Cell],
        bodies: &[Body],
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, SetupError> {
        monitor.progress(Stage::Ownership, 0.0);
        let mut found: Vec<Vec<Attachment>> = Vec::with_capacity(vertices.len());
        for chunk in vertices.chunks(CHUNK) {
            // One search may take long, where all points of a component are equally near.
            let attachments = |x: &[f64; 3]| match monitor.cancelled() {
                true => Vec::new(),
                false => attachments(&Vector3::from(*x), bodies, tolerance),
            };
            found.par_extend(chunk.par_iter().map(attachments));
            go_on(monitor)?;
            monitor.progress(Stage::Ownership, found.len() as f64 / vertices.len() as f64);
        }
        refuse_off_surface(vertices, &found, bodies, tolerance, monitor)?;
        let mut offsets = vec![0];
        let mut attachments = Vec::with_capacity(vertices.len());
        for found in found {
            attachments.extend(found);
            offsets.push(attachments.len() as u32);
        }
        let mut ownership = Self { offsets, attachments, cell_owner: Vec::new() };
        ownership.cell_owner = ownership.cell_owners(vertices, cells, bodies, monitor)?;
        go_on(monitor)?;
        ownership.drop_stray_attachments(cells);
        ownership.refuse_inside(vertices, bodies, tolerance, monitor)?;
        for (component, (index, body)) in (0u32..).zip(bodies.iter().enumerate()) {
            if !ownership.cell_owner.contains(&component) {
                return Err(SetupError::UnusedComponent { index, name: body.component().name().to_owned() });
            }
        }
        Ok(ownership)
    }

    fn cell_owners(
        &self,
        vertices: &[[f64; 3]],
        cells: &[Cell],
        bodies: &[Body],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<u32>, SetupError> {
        let owners: Vec<Option<u32>> = cells
            .par_iter()
            .map(|cell| {
                let corners = cell.vertices();
                let common: Vec<u32> = self
                    .of(corners[0])
                    .iter()
                    .map(|a| a.component)
                    .filter(|&c| corners[1..].iter().all(|&v| self.on(v, c).is_some()))
                    .collect();
                match common[..] {
                    [] => None,
                    [owner] => Some(owner),
                    _ if monitor.cancelled() => None,
                    // All corners are on seams: the component that the cell's normal agrees with.
                    _ => {
                        let middle = centroid(vertices, cell);
                        let area = area_vector(vertices, cell);
                        let agreement = |c: u32| bodies[c as usize].closest_point(&middle).normal.dot(&area);
                        common.into_iter().max_by(|&a, &b| agreement(a).total_cmp(&agreement(b)))
                    }
                }
            })
            .collect();
        go_on(monitor)?;
        let across: Vec<u32> =
            (0u32..).zip(&owners).filter(|(_, owner)| owner.is_none()).map(|(i, _)| i).collect();
        if across.is_empty() {
            Ok(owners.into_iter().flatten().collect())
        } else {
            let first = across.iter().take(LISTED).copied().collect();
            Err(SetupError::CellAcrossSeam { count: across.len(), first })
        }
    }

    /// Refuses vertices that are inside a component other than their own: such bodies are not trimmed where they meet. Inside and
    /// outside of open components is not known.
    fn refuse_inside(
        &self,
        vertices: &[[f64; 3]],
        bodies: &[Body],
        tolerance: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(), SetupError> {
        for (component, body) in (0u32..).zip(bodies).filter(|(_, body)| !body.component().is_open()) {
            let bounds = body.bounds();
            let candidates: Vec<u32> = self
                .vertices()
                .filter(|&v| self.on(v, component).is_none())
                .filter(|&v| bounds.squared_distance(&Vector3::from(vertices[v as usize])) == 0.0)
                .collect();
            let depth = |&vertex: &u32| {
                let x = Vector3::from(vertices[vertex as usize]);
                let distance = if monitor.cancelled() { 0.0 } else { -body.signed_distance(&x) };
                VertexDistance { vertex, distance }
            };
            let mut inside: Vec<VertexDistance> = candidates.par_iter().map(depth).collect();
            go_on(monitor)?;
            inside.retain(|v| v.distance > tolerance);
            if inside.is_empty() {
                continue;
            }
            inside.sort_by(|a, b| b.distance.total_cmp(&a.distance).then(a.vertex.cmp(&b.vertex)));
            let count = inside.len();
            let position = vertices[inside[0].vertex as usize];
            inside.truncate(LISTED);
            let component = body.component().name().to_owned();
            return Err(SetupError::Inside { component, count, position, worst: inside });
        }
        Ok(())
    }

    /// A vertex stays attached only to components that own a cell around it: one that merely touches another component is
    /// no seam vertex.
    fn drop_stray_attachments(&mut self, cells: &[Cell]) {
        let topology = Topology::of_cells(self.vertex_count(), cells);
        let mut offsets = vec![0];
        let mut kept = Vec::with_capacity(self.attachments.len());
        for v in self.vertices() {
            let around = topology.vertex_cells.row(v as usize);
            let owns = |a: &&Attachment| around.iter().any(|&c| self.cell_owner[c as usize] == a.component);
            let before = kept.len();
            kept.extend(self.of(v).iter().filter(owns));
            if kept.len() == before {
                kept.push(self.of(v)[0]);
            }
            offsets.push(kept.len() as u32);
        }
        (self.offsets, self.attachments) = (offsets, kept);
    }
}

/// Mean of a cell's vertices.
pub fn centroid(vertices: &[[f64; 3]], cell: &Cell) -> Vector3 {
    let corners = cell.vertices();
    corners.iter().map(|&v| Vector3::from(vertices[v as usize])).sum::<Vector3>() / corners.len() as f64
}

fn attachments(x: &Vector3, bodies: &[Body], tolerance: f64) -> Vec<Attachment> {
    (0u32..)
        .zip(bodies)
        .filter_map(|(component, body)| {
            let foot = body.closest_point_within(x, tolerance)?;
            Some(Attachment {
                component,
                location: foot.location,
                freedom: freedom(body, &foot.location, foot.feature),
                distance: foot.distance.abs(),
            })
        })
        .collect()
}

/// The freedom that the component's sharp features leave to a vertex at `location`.
fn freedom(body: &Body, location: &Location, feature: Feature) -> Freedom {
    let component = body.component();
    match feature {
        Feature::Corner { .. } => Freedom::Fixed,
        Feature::Edge { edge } => Freedom::Edge(edge),
        Feature::Face => match component.edge_of(location, ON_SIDE) {
            Some(edge) if component.edges()[edge as usize].collapsed => Freedom::Fixed,
            Some(edge) if component.edges()[edge as usize].sharp => Freedom::Edge(edge),
            _ => Freedom::Surface,
        },
    }
}

fn go_on(monitor: &dyn Monitor<Stage>) -> Result<(), SetupError> {
    if monitor.cancelled() { Err(SetupError::Cancelled) } else { Ok(()) }
}

fn refuse_off_surface(
    vertices: &[[f64; 3]],
    found: &[Vec<Attachment>],
    bodies: &[Body],
    tolerance: f64,
    monitor: &dyn Monitor<Stage>,
) -> Result<(), SetupError> {
    let mut off: Vec<VertexDistance> = (0u32..)
        .zip(found)
        .filter(|(_, attachments)| attachments.is_empty())
        .map(|(vertex, _)| VertexDistance { vertex, distance: 0.0 })
        .collect();
    if off.is_empty() {
        return Ok(());
    }
    off.par_iter_mut().for_each(|o| {
        if monitor.cancelled() {
            return;
        }
        let x = Vector3::from(vertices[o.vertex as usize]);
        o.distance = bodies.iter().map(|b| b.closest_point(&x).distance.abs()).fold(f64::INFINITY, f64::min);
    });
    go_on(monitor)?;
    off.sort_by(|a, b| b.distance.total_cmp(&a.distance).then(a.vertex.cmp(&b.vertex)));
    let count = off.len();
    off.truncate(LISTED);
    // A few vertices may be wrong in a mesh that fits as a whole.
    let misfit = if 4 * count >= vertices.len() { misfit(vertices, bodies) } else { None };
    Err(SetupError::OffSurface { count, tolerance, misfit, worst: off })
}
