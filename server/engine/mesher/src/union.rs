//! The union of closed tessellations: triangles that know their component, and the curves that the mesh has to keep.
//!
//! Which triangles are kept is decided by the exact Boolean operations of `manifold-rust` (a library for triangles); the
//! splines decide where the vertices lie.

use std::collections::HashMap;

use manifold_rust::{
    manifold::Manifold,
    types::{Error, MeshGL64, OpType},
};
use moldline_foundation::Vector3;
use moldline_geometry::{Body, Location};

use crate::{
    error::MesherError,
    tessellation::{Tessellation, ordered},
};

/// A curve that the mesh keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Curve {
    /// The intersection of two components, in increasing order.
    Seam(u32, u32),
    /// A sharp edge of a component.
    Sharp(u32, u32),
    /// The end of a half model of a component in the plane of symmetry.
    Plane(u32),
}

/// The union's boundary.
pub(crate) struct Union {
    /// Metres.
    pub positions: Vec<Vector3>,
    /// Counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Component of each triangle.
    pub owner: Vec<u32>,
    /// Approximate locations of each triangle's corners on its component.
    pub locations: Vec<[Location; 3]>,
    /// Curves by edge, in increasing order of the vertices.
    pub curves: HashMap<[u32; 2], Curve>,
    /// The component and its vertex that a vertex is.
    pub corners: HashMap<u32, (u32, u32)>,
}

fn bits(x: &Vector3) -> [u64; 3] {
    // Adding zero makes -0 and 0 the same.
    [x.x + 0.0, x.y + 0.0, x.z + 0.0].map(f64::to_bits)
}

/// Unites the tessellations; `half` keeps `y >= 0`.
pub(crate) fn unite(bodies: &[&Body], parts: &[Tessellation], half: bool) -> Result<Union, MesherError> {
    let count = u32::try_from(parts.len()).unwrap_or(u32::MAX);
    let first_id = Manifold::reserve_ids(count);
    let mut solids = Vec::with_capacity(parts.len());
    for (index, (part, body)) in (0u32..).zip(parts.iter().zip(bodies)) {
        let mut mesh = MeshGL64::default();
        mesh.num_prop = 3;
        mesh.vert_properties = part.positions.iter().flat_map(|x| [x.x, x.y, x.z]).collect();
        mesh.tri_verts = part.triangles.iter().flatten().map(|&v| u64::from(v)).collect();
        mesh.run_index = vec![0, mesh.tri_verts.len() as u64];
        mesh.run_original_id = vec![first_id + index];
        mesh.face_id = (0..part.triangles.len() as u64).collect();
        let solid = Manifold::from_mesh_gl64(&mesh);
        if solid.status() != Error::NoError {
            return Err(MesherError::NotManifold {
                component: body.component().name().to_owned(),
                reason: format!("{:?}", solid.status()),
            });
        }
        solids.push(solid);
    }
    let mut united = Manifold::batch_boolean(&solids, OpType::Add);
    if half {
        united = united.trim_by_plane(manifold_rust::linalg::Vec3::new(0.0, 1.0, 0.0), 0.0);
    }
    if united.status() != Error::NoError || united.is_empty() {
        return Err(MesherError::Union { reason: format!("{:?}", united.status()) });
    }
    Ok(collect(&united.get_mesh_gl64(-1), parts, first_id))
}

fn collect(mesh: &MeshGL64, parts: &[Tessellation], first_id: u32) -> Union {
    // Vertices that the format repeats between runs are one.
    let mut same: Vec<u32> = (0..mesh.num_vert() as u32).collect();
    for (&from, &to) in mesh.merge_from_vert.iter().zip(&mesh.merge_to_vert) {
        same[from as usize] = to as u32;
    }
    let position = |v: u32| Vector3::from(mesh.get_vert_pos(v as usize));
    let mut out = Union {
        positions: Vec::new(),
        triangles: Vec::new(),
        owner: Vec::new(),
        locations: Vec::new(),
        curves: HashMap::new(),
        corners: HashMap::new(),
    };
    let mut number: Vec<Option<u32>> = vec![None; same.len()];
    let mut source = Vec::new();
    for (run, &id) in mesh.run_original_id.iter().enumerate() {
        let component = id.wrapping_sub(first_id);
        // The face in the plane of symmetry is no component's.
        let Some(part) = parts.get(component as usize) else { continue };
        for t in mesh.run_index[run] / 3..mesh.run_index[run + 1] / 3 {
            let face = mesh.face_id[t as usize] as usize;
            let corners = mesh.get_tri_verts(t as usize).map(|mut v| {
                while u64::from(same[v as usize]) != v {
                    v = u64::from(same[v as usize]);
                }
                v as u32
            });
            let vertices = corners.map(|v| {
                *number[v as usize].get_or_insert_with(|| {
                    out.positions.push(position(v));
                    out.positions.len() as u32 - 1
                })
            });
            out.locations.push(corners.map(|v| locate(part, face, &position(v))));
            out.triangles.push(vertices);
            out.owner.push(component);
            source.push(face);
        }
    }
    find_curves(&mut out, parts, &source);
    out
}

/// The location of a point of a triangle, linear in the triangle's own parameters.
fn locate(part: &Tessellation, face: usize, x: &Vector3) -> Location {
    let [a, b, c] = part.triangles[face].map(|v| part.positions[v as usize]);
    let n = (b - a).cross(&(c - a));
    let square = n.norm_squared();
    let weights = match square > 0.0 {
        true => [(c - b).cross(&(x - b)).dot(&n) / square, (a - c).cross(&(x - c)).dot(&n) / square],
        false => [1.0, 0.0],
    };
    let weights = [weights[0], weights[1], 1.0 - weights[0] - weights[1]].map(|w: f64| w.clamp(0.0, 1.0));
    let sum: f64 = weights.iter().sum();
    let l = &part.locations[face];
    let mean = |value: fn(&Location) -> f64| (0..3).map(|k| weights[k] * value(&l[k])).sum::<f64>() / sum;
    Location { patch: l[0].patch, u: mean(|l| l.u), v: mean(|l| l.v) }
}

fn find_curves(out: &mut Union, parts: &[Tessellation], source: &[usize]) {
    let mut sides: HashMap<[u32; 2], [Option<usize>; 2]> = HashMap::with_capacity(2 * source.len());
    for (t, triangle) in out.triangles.iter().enumerate() {
        for k in 0..3 {
            let entry = sides.entry(ordered(triangle[k], triangle[(k + 1) % 3])).or_default();
            entry[usize::from(entry[0].is_some())] = Some(t);
        }
    }
    for (&edge, pair) in &sides {
        let curve = match *pair {
            [Some(s), Some(t)] if out.owner[s] != out.owner[t] => {
                let [a, b] = ordered(out.owner[s], out.owner[t]);
                Curve::Seam(a, b)
            }
            [Some(s), Some(t)] => {
                let part = &parts[out.owner[s] as usize];
                let [f, g] = [s, t].map(|t| part.triangles[source[t]]);
                let shared: Vec<u32> = f.into_iter().filter(|v| g.contains(v)).collect();
                let [a, b] = shared[..] else { continue };
                match part.sharp.get(&ordered(a, b)) {
                    Some(&sharp) => Curve::Sharp(out.owner[s], sharp),
                    None => continue,
                }
            }
            [Some(s), None] => Curve::Plane(out.owner[s]),
            [None, _] => continue,
        };
        out.curves.insert(edge, curve);
    }
    for (component, part) in (0u32..).zip(parts) {
        let known: HashMap<[u64; 3], u32> =
            (0u32..).zip(&part.positions[..part.corners]).map(|(v, x)| (bits(x), v)).collect();
        for (triangle, _) in out.triangles.iter().zip(&out.owner).filter(|(_, owner)| **owner == component) {
            for &v in triangle {
                if let Some(&corner) = known.get(&bits(&out.positions[v as usize])) {
                    out.corners.insert(v, (component, corner));
                }
            }
        }
    }
}
