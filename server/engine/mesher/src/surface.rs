//! The triangles while they are remeshed: who is around a vertex, what it lies on, and the curves to keep.

use std::collections::HashMap;

use moldline_foundation::Vector3;
use moldline_geometry::{Body, Location, VertexKind};

use crate::{
    error::MesherError,
    hold::{Hold, On},
    tessellation::ordered,
    union::{Curve, Union},
};

/// Marks a triangle that is gone.
pub(crate) const GONE: [u32; 3] = [u32::MAX; 3];

/// How a vertex may move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Over its component.
    Surface,
    /// Along a curve.
    Curve,
    /// Not at all.
    Corner,
}

pub(crate) struct Surface<'a> {
    pub bodies: &'a [&'a Body],
    pub positions: Vec<Vector3>,
    pub holds: Vec<Hold>,
    pub kinds: Vec<Kind>,
    /// Length of edges that is wanted, metres, by vertex.
    pub sizes: Vec<f64>,
    pub triangles: Vec<[u32; 3]>,
    pub owner: Vec<u32>,
    /// A location on the component near each triangle, on the same side of every sharp edge.
    pub places: Vec<Location>,
    /// Triangles around each vertex.
    pub around: Vec<Vec<u32>>,
    pub curves: HashMap<[u32; 2], Curve>,
}

impl<'a> Surface<'a> {
    /// The union's surface, with its vertices put onto the components.
    pub fn new(union: Union, bodies: &'a [&'a Body]) -> Result<Self, MesherError> {
        let count = union.positions.len();
        let mut surface = Self {
            bodies,
            positions: union.positions,
            holds: vec![Hold::default(); count],
            kinds: vec![Kind::Surface; count],
            sizes: vec![f64::INFINITY; count],
            around: vec![Vec::new(); count],
            triangles: union.triangles,
            owner: union.owner,
            curves: union.curves,
            places: union.locations.iter().map(middle).collect(),
        };
        for (t, (triangle, &owner)) in surface.triangles.iter().zip(&surface.owner).enumerate() {
            for (k, &v) in triangle.iter().enumerate() {
                surface.around[v as usize].push(t as u32);
                let on = &mut surface.holds[v as usize].on;
                if on.iter().all(|on| on.component != owner) {
                    on.push(On { component: owner, edge: None, location: union.locations[t][k] });
                }
            }
        }
        let mut incident: Vec<Vec<([u32; 2], Curve)>> = vec![Vec::new(); count];
        for (&edge, &curve) in &surface.curves {
            for v in edge {
                incident[v as usize].push((edge, curve));
            }
        }
        for (v, curves) in incident.iter_mut().enumerate() {
            // The order of a hash map is arbitrary.
            curves.sort_unstable_by_key(|(edge, _)| *edge);
            let hold = &mut surface.holds[v];
            hold.on.sort_by_key(|on| on.component);
            for &(_, curve) in curves.iter() {
                match curve {
                    Curve::Sharp(component, edge) => {
                        for on in hold.on.iter_mut().filter(|on| on.component == component) {
                            on.edge = Some(edge);
                        }
                    }
                    Curve::Plane(_) => hold.plane = true,
                    Curve::Seam(..) => {}
                }
            }
            surface.kinds[v] = match curves[..] {
                [] => Kind::Surface,
                [(_, a), (_, b)] if a == b => Kind::Curve,
                _ => Kind::Corner,
            };
            if let Some(&(component, vertex)) = union.corners.get(&(v as u32)) {
                let body = bodies[component as usize];
                let fixed = body.component().vertices()[vertex as usize].kind == VertexKind::Corner;
                let joint = surface.kinds[v] == Kind::Corner && hold.on.len() == 1 && !hold.plane;
                if fixed || joint {
                    surface.kinds[v] = Kind::Corner;
                    hold.fixed = true;
                }
            }
        }
        for v in 0..count {
            let x = surface.positions[v];
            match surface.holds[v].project(bodies, x) {
                Some(to) => surface.positions[v] = to,
                None => return Err(surface.tangential(v)),
            }
        }
        Ok(surface)
    }

    /// The error of a vertex that cannot be put onto all its components.
    pub fn tangential(&self, v: usize) -> MesherError {
        let names = self.holds[v].on.iter().map(|on| self.bodies[on.component as usize].component().name());
        MesherError::Tangential {
            components: names.collect::<Vec<_>>().join(", "),
            place: self.positions[v].into(),
        }
    }

    pub fn curve(&self, a: u32, b: u32) -> Option<Curve> {
        self.curves.get(&ordered(a, b)).copied()
    }

    pub fn x(&self, v: u32) -> Vector3 {
        self.positions[v as usize]
    }

    /// Wanted length of an edge.
    pub fn wanted(&self, a: u32, b: u32) -> f64 {
        0.5 * (self.sizes[a as usize] + self.sizes[b as usize])
    }

    pub fn length(&self, a: u32, b: u32) -> f64 {
        (self.x(a) - self.x(b)).norm()
    }

    /// Twice the area vector.
    pub fn area(&self, [a, b, c]: [u32; 3]) -> Vector3 {
        (self.x(b) - self.x(a)).cross(&(self.x(c) - self.x(a)))
    }

    /// Aspect ratio as Verdict defines it: 1 is best.
    pub fn aspect(&self, t: [u32; 3]) -> f64 {
        let l = [self.length(t[0], t[1]), self.length(t[1], t[2]), self.length(t[2], t[0])];
        let longest = l[0].max(l[1]).max(l[2]);
        let area = self.area(t).norm();
        if area > 0.0 { longest * (l[0] + l[1] + l[2]) / (12f64.sqrt() * area) } else { f64::INFINITY }
    }

    /// The outward normal of the owner's surface under three vertices of triangle `t`: that at those which lie on no curve,
    /// otherwise that under their middle.
    pub fn normal(&self, vertices: [u32; 3], t: u32) -> Vector3 {
        let owner = self.owner[t as usize];
        let body = self.bodies[owner as usize];
        let mut sum = Vector3::zeros();
        for v in vertices {
            let smooth = self.kinds[v as usize] == Kind::Surface;
            if let (true, Some(l)) = (smooth, self.holds[v as usize].location(owner)) {
                sum += body.normal(&l);
            }
        }
        if sum.norm() > 0.5 {
            return sum.normalize();
        }
        let center = (self.x(vertices[0]) + self.x(vertices[1]) + self.x(vertices[2])) / 3.0;
        let foot = body.closest_point_near(&center, &self.places[t as usize]);
        foot.map_or(sum, |foot| body.normal(&foot.location))
    }

    /// A location near triangle `t`: that of a vertex on no curve, or the one known so far.
    pub fn place(&self, t: u32) -> Location {
        let owner = self.owner[t as usize];
        let mut smooth =
            self.triangles[t as usize].into_iter().filter(|&v| self.kinds[v as usize] == Kind::Surface);
        smooth.find_map(|v| self.holds[v as usize].location(owner)).unwrap_or(self.places[t as usize])
    }

    /// The triangles at an edge, in increasing order.
    pub fn at_edge(&self, a: u32, b: u32) -> impl Iterator<Item = u32> + '_ {
        self.around[a as usize].iter().copied().filter(move |&t| self.triangles[t as usize].contains(&b))
    }

    /// Edges as they stand, each once, in a fixed order.
    pub fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges = Vec::with_capacity(3 * self.triangles.len() / 2);
        for t in self.triangles.iter().filter(|t| **t != GONE) {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                // Edges at the plane of symmetry have one triangle only.
                if a < b || self.at_edge(a, b).count() == 1 {
                    edges.push(ordered(a, b));
                }
            }
        }
        edges
    }

    /// The neighbours of a vertex, in increasing order.
    pub fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut out: Vec<u32> = self.around[v as usize]
            .iter()
            .flat_map(|&t| self.triangles[t as usize])
            .filter(|&w| w != v)
            .collect();
        out.sort_unstable();
        out.dedup();
        out
    }
}

/// The middle of three locations on one patch.
fn middle(l: &[Location; 3]) -> Location {
    Location { patch: l[0].patch, u: (l[0].u + l[1].u + l[2].u) / 3.0, v: (l[0].v + l[1].v + l[2].v) / 3.0 }
}
