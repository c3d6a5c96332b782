//! From components to the mesh of their union.

use std::collections::{BTreeMap, HashMap};

use moldline_foundation::{Monitor, Vector3};
use moldline_geometry::Body;
use moldline_mesh::{
    Cell, Group, SurfaceMesh,
    quality::{self, QualityReport},
};
use rayon::prelude::*;

use crate::{
    error::MesherError,
    sizes,
    surface::{GONE, Surface},
    tessellation::{Step, tessellate},
    union::{Curve, unite},
};

/// Least number of cells.
const LEAST_CELLS: usize = 100;
/// Most.
const MOST_CELLS: usize = 2_000_000;
/// Largest turning angle of a step of the tessellation, radians.
const ANGLE: f64 = 0.2;
/// Passes of the remeshing.
const PASSES: usize = 8;
/// The pass after which the number of cells corrects the sizes.
const CORRECTION: usize = 3;

/// What is wanted.
#[derive(Clone, Debug)]
pub struct Options {
    /// Number of cells, about.
    pub cells: usize,
    /// Longest edge on components by name, metres.
    pub sizes: BTreeMap<String, f64>,
    /// Longest edge on seams, metres.
    pub seam_size: Option<f64>,
    /// The half `y >= 0` alone, open at the plane.
    pub half: bool,
    /// Mesh the half and mirror it; needs components that are symmetric with respect to `y = 0`. Found from the components if
    /// `None`.
    pub symmetric: Option<bool>,
    /// Accept components that touch no other.
    pub pieces: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            cells: 15_000,
            sizes: BTreeMap::new(),
            seam_size: None,
            half: false,
            symmetric: None,
            pieces: false,
        }
    }
}

/// Stages of the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Triangles on each component.
    Tessellation,
    /// Their union.
    Union,
    /// Sizes and quality.
    Remeshing,
}

/// A seam of the mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Seam {
    /// Names of its components.
    pub components: [String; 2],
    /// Number of its edges.
    pub edges: usize,
    /// Its length, metres.
    pub length: f64,
}

/// A mesh with what it is like.
#[derive(Clone, Debug)]
pub struct Generated {
    /// Triangles, in one cell group for each component.
    pub mesh: SurfaceMesh,
    /// Component of each cell.
    pub owner: Vec<u32>,
    /// Quality by component.
    pub quality: QualityReport,
    /// The seams, by components.
    pub seams: Vec<Seam>,
    /// Whether one half is the mirror image of the other, bit for bit.
    pub symmetric: bool,
}

/// Meshes the union of the components.
///
/// # Errors
/// See [`MesherError`].
pub fn generate(
    bodies: &[&Body],
    options: &Options,
    monitor: &dyn Monitor<Stage>,
) -> Result<Generated, MesherError> {
    let limits = check(bodies, options)?;
    let symmetric = !options.half && options.symmetric.unwrap_or_else(|| is_symmetric(bodies));
    let half = options.half || symmetric;
    let wanted = if symmetric { options.cells as f64 / 2.0 } else { options.cells as f64 };

    monitor.progress(Stage::Tessellation, 0.0);
    let step = Step { length: first_length(bodies, options.cells), angle: ANGLE };
    let parts: Vec<_> = bodies.par_iter().map(|body| tessellate(body, step)).collect();
    go_on(monitor)?;
    monitor.progress(Stage::Union, 0.0);
    let union = unite(bodies, &parts, half)?;
    refuse_hidden(bodies, &union.owner)?;
    if !options.pieces {
        refuse_pieces(bodies, &union.positions, &union.triangles, &union.owner)?;
    }
    go_on(monitor)?;

    monitor.progress(Stage::Remeshing, 0.0);
    let mut surface = Surface::new(union, bodies)?;
    sizes::set(&mut surface, wanted, &limits, options.seam_size);
    for pass in 0..PASSES {
        surface.pass();
        if pass == CORRECTION {
            let cells = surface.triangles.iter().filter(|t| **t != GONE).count() as f64;
            let factor = (cells / wanted).sqrt().clamp(0.5, 2.0);
            surface.sizes.iter_mut().for_each(|size| *size *= factor);
        }
        go_on(monitor)?;
        monitor.progress(Stage::Remeshing, (pass + 1) as f64 / (PASSES + 1) as f64);
    }
    surface.polish(1.8);
    surface.repair(4.0);
    surface.polish(1.8);
    finish(&surface, symmetric)
}

fn go_on(monitor: &dyn Monitor<Stage>) -> Result<(), MesherError> {
    if monitor.cancelled() { Err(MesherError::Cancelled) } else { Ok(()) }
}

/// Checks the input and gives the size limit of each component.
fn check(bodies: &[&Body], options: &Options) -> Result<Vec<Option<f64>>, MesherError> {
    if bodies.is_empty() {
        return Err(MesherError::Empty);
    }
    if !(LEAST_CELLS..=MOST_CELLS).contains(&options.cells) {
        return Err(MesherError::Cells { cells: options.cells, least: LEAST_CELLS, most: MOST_CELLS });
    }
    let names: Vec<&str> = bodies.iter().map(|body| body.component().name()).collect();
    let seam = options.seam_size.iter().map(|&size| ("seams", size));
    for (name, size) in options.sizes.iter().map(|(name, &size)| (name.as_str(), size)).chain(seam) {
        if !(size > 0.0 && size.is_finite()) {
            return Err(MesherError::Size { component: name.to_owned(), size });
        }
    }
    if let Some(name) = options.sizes.keys().find(|name| !names.contains(&name.as_str())) {
        return Err(MesherError::UnknownComponent { name: name.clone(), known: names.join(", ") });
    }
    if let Some(open) = bodies.iter().find(|body| body.component().is_open()) {
        return Err(MesherError::Open { component: open.component().name().to_owned() });
    }
    Ok(names.iter().map(|name| options.sizes.get(*name).copied()).collect())
}

/// The length of edges if all components were boxes covered by equilateral triangles.
fn first_length(bodies: &[&Body], cells: usize) -> f64 {
    let area: f64 = bodies
        .iter()
        .map(|body| {
            let d = body.bounds().high - body.bounds().low;
            2.0 * (d.x * d.y + d.y * d.z + d.z * d.x)
        })
        .sum();
    (area / cells as f64 * 4.0 / 3f64.sqrt()).sqrt()
}

/// Whether every component is its own mirror image with respect to `y = 0`, at the Greville-like samples of its patches.
fn is_symmetric(bodies: &[&Body]) -> bool {
    /// Samples of each parameter of a patch.
    const SAMPLES: usize = 7;
    bodies.par_iter().all(|body| {
        (0u32..).zip(body.component().patches()).all(|(patch, p)| {
            let [u, v] = p.surface.domain();
            let at = |(a, b): (f64, f64), k: usize| a + (k as f64 + 0.37) / SAMPLES as f64 * (b - a);
            (0..SAMPLES * SAMPLES).all(|k| {
                let l = moldline_geometry::Location { patch, u: at(u, k / SAMPLES), v: at(v, k % SAMPLES) };
                let mut x = body.position(&l);
                x.y = -x.y;
                body.closest_point(&x).distance.abs() <= 1e-11 * body.size()
            })
        })
    })
}

fn refuse_hidden(bodies: &[&Body], owner: &[u32]) -> Result<(), MesherError> {
    match (0u32..).zip(bodies).find(|(c, _)| !owner.contains(c)) {
        Some((_, body)) => Err(MesherError::Hidden { component: body.component().name().to_owned() }),
        None => Ok(()),
    }
}

fn refuse_pieces(
    bodies: &[&Body],
    positions: &[Vector3],
    triangles: &[[u32; 3]],
    owner: &[u32],
) -> Result<(), MesherError> {
    let mut root: Vec<u32> = (0..positions.len() as u32).collect();
    fn find(root: &mut [u32], mut v: u32) -> u32 {
        while root[v as usize] != v {
            root[v as usize] = root[root[v as usize] as usize];
            v = root[v as usize];
        }
        v
    }
    for t in triangles {
        for k in 1..3 {
            let (a, b) = (find(&mut root, t[0]), find(&mut root, t[k]));
            root[a.max(b) as usize] = a.min(b);
        }
    }
    // Components are joined if they share a piece; one shell in several pieces is its own matter.
    let mut joined: Vec<u32> = (0..bodies.len() as u32).collect();
    let mut first: HashMap<u32, u32> = HashMap::new();
    for (t, &component) in triangles.iter().zip(owner) {
        let piece = find(&mut root, t[0]);
        let other = *first.entry(piece).or_insert(component);
        let (a, b) = (find(&mut joined, component), find(&mut joined, other));
        joined[a.max(b) as usize] = a.min(b);
    }
    let roots: Vec<u32> = (0..bodies.len() as u32).map(|c| find(&mut joined, c)).collect();
    match roots.iter().position(|&r| r != 0) {
        Some(component) => {
            let mut distinct = roots.clone();
            distinct.sort_unstable();
            distinct.dedup();
            let component = bodies[component].component().name().to_owned();
            Err(MesherError::Pieces { pieces: distinct.len(), component })
        }
        None => Ok(()),
    }
}

/// Numbers what is left, mirrors it, and measures it.
fn finish(surface: &Surface<'_>, symmetric: bool) -> Result<Generated, MesherError> {
    let bodies = surface.bodies;
    let mut order: Vec<usize> =
        (0..surface.triangles.len()).filter(|&t| surface.triangles[t] != GONE).collect();
    order.sort_by_key(|&t| surface.owner[t]);
    let mut number = vec![u32::MAX; surface.positions.len()];
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut plane = Vec::new();
    let mut cells = Vec::with_capacity(2 * order.len());
    let mut owner: Vec<u32> = Vec::with_capacity(2 * order.len());
    let mut normals = Vec::with_capacity(2 * order.len());
    for &t in &order {
        let triangle = surface.triangles[t];
        let [a, b, c] = triangle.map(|v| {
            if number[v as usize] == u32::MAX {
                number[v as usize] = vertices.len() as u32;
                vertices.push(surface.positions[v as usize].into());
                plane.push(surface.holds[v as usize].plane);
            }
            number[v as usize]
        });
        cells.push(Cell::triangle(a, b, c));
        owner.push(surface.owner[t]);
        let normal = surface.normal(triangle, t as u32);
        if surface.area(triangle).dot(&normal) <= 0.0 {
            let place = (surface.x(triangle[0]) + surface.x(triangle[1]) + surface.x(triangle[2])) / 3.0;
            let component = bodies[surface.owner[t] as usize].component().name().to_owned();
            return Err(MesherError::Folded { component, place: place.into() });
        }
        normals.push(normal);
    }
    let mut seams: BTreeMap<(u32, u32), (usize, f64)> = BTreeMap::new();
    let mut edges: Vec<_> = surface.curves.iter().collect();
    edges.sort_unstable_by_key(|(edge, _)| **edge);
    let copies = if symmetric { 2 } else { 1 };
    for (&[a, b], &curve) in edges {
        if let Curve::Seam(c, d) = curve {
            let seam = seams.entry((c, d)).or_default();
            seam.0 += copies;
            seam.1 += copies as f64 * surface.length(a, b);
        }
    }
    if symmetric {
        let mut image = vec![0u32; vertices.len()];
        for v in 0..vertices.len() {
            image[v] = v as u32;
            if !plane[v] {
                image[v] = vertices.len() as u32;
                let [x, y, z] = vertices[v];
                vertices.push([x, -y, z]);
            }
        }
        for k in 0..cells.len() {
            cells.push(cells[k].flipped().map(|v| image[v as usize]));
            owner.push(owner[k]);
            let n: Vector3 = normals[k];
            normals.push(Vector3::new(n.x, -n.y, n.z));
        }
    }
    let names: Vec<String> = bodies.iter().map(|body| body.component().name().to_owned()).collect();
    let groups = (0u32..).zip(&names).map(|(c, name)| Group {
        name: name.clone(),
        indices: (0u32..).zip(&owner).filter(|(_, o)| **o == c).map(|(k, _)| k).collect(),
    });
    let mesh = SurfaceMesh { vertices, cells, cell_groups: groups.collect(), vertex_groups: Vec::new() };
    let measured = quality::evaluate(&mesh.vertices, &mesh.cells, &normals);
    let Some(quality) = QualityReport::new(&measured, &owner, &names) else { return Err(MesherError::Empty) };
    let seams = seams.into_iter().map(|((c, d), (edges, length))| Seam {
        components: [names[c as usize].clone(), names[d as usize].clone()],
        edges,
        length,
    });
    Ok(Generated { owner, quality, seams: seams.collect(), symmetric, mesh })
}
