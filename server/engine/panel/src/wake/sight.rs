//! An edge of the surface as the flow along x sees it, in the plane normal to the edge.
//!
//! With t along the edge and the normals n of its two panels, `m = t x n` is the direction in which a panel ends at the edge. The flow runs
//! off a panel where `m.x > 0`. In the plane normal to the edge the flow has the component `|x - (x.t) t| = cos(sweep)`, and cosines there are
//! divided by it, so that sweep changes no decision.

use moldline_mesh::Vector3;

use crate::panels::Panels;

/// What the flow sees of an edge between two panels.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    /// Unit vector along the edge.
    pub along: Vector3,
    /// Length, m.
    pub length: f64,
    /// Cosine of the sweep: of the angle between the flow and the plane normal to the edge.
    pub across: f64,
    /// Angle between the outward normals, degrees; negative in a groove.
    pub turn: f64,
    /// The same in the plane of the streamlines on both sides, which sweep does not change.
    pub streamwise_turn: f64,
    /// Cosine of the angle between the flow and the direction in which each panel ends here, in the plane normal to the edge: positive where
    /// the flow runs off the panel. The left panel is first.
    pub off: [f64; 2],
    /// Cosine of the angle between the flow and each panel's normal, in the plane normal to the edge: 1 for a base.
    pub aft: [f64; 2],
}

impl Sight {
    /// Of an edge of two panels; none at the border on the plane of symmetry.
    pub fn new(panels: &Panels, points: &[Vector3], edge: u32) -> Option<Self> {
        let e = &panels.edges[edge as usize];
        let face = |panel: u32| Face::new(&panels.corners[panel as usize].map(|v| points[v as usize]));
        let faces = [face(e.left), face(e.right?)];
        Some(Self::between(points[e.b as usize] - points[e.a as usize], &faces))
    }

    /// Of an edge along a vector, as the first of two faces runs through it.
    pub fn between(along: Vector3, faces: &[Face; 2]) -> Self {
        let length = along.norm();
        let along = along / length;
        let flow = Vector3::x();
        let across = (flow - along * along.x).norm();
        let [left, right] = faces;
        let ends = [along.cross(&left.normal), right.normal.cross(&along)];
        let angle = left.normal.dot(&right.normal).clamp(-1.0, 1.0).acos().to_degrees();
        // The other panel lies below the plane of each.
        let apart = right.centre - left.centre;
        let convex = apart.dot(&left.normal) - apart.dot(&right.normal) < 0.0;
        let streamlines = faces.each_ref().map(|face| flow - face.normal * face.normal.x);
        let lengths = streamlines.map(|u| u.norm());
        let streamwise =
            streamlines[0].dot(&streamlines[1]) / (lengths[0] * lengths[1]).max(f64::MIN_POSITIVE);
        let per = across.max(f64::MIN_POSITIVE);
        Self {
            along,
            length,
            across,
            turn: if convex { angle } else { -angle },
            streamwise_turn: 180.0 - streamwise.clamp(-1.0, 1.0).acos().to_degrees(),
            off: ends.map(|m| m.x / per),
            aft: faces.each_ref().map(|face| face.normal.x / per),
        }
    }

    /// Sweep, degrees.
    pub fn sweep(&self) -> f64 {
        self.across.clamp(-1.0, 1.0).acos().to_degrees()
    }

    /// The lesser of both sides' [`off`](Self::off).
    pub fn least_off(&self) -> f64 {
        self.off[0].min(self.off[1])
    }
}

/// Centre and unit normal of a cell.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Face {
    pub centre: Vector3,
    pub normal: Vector3,
}

impl Face {
    /// Of four corners, the last one twice for a triangle.
    pub fn new(corners: &[Vector3; 4]) -> Self {
        let [a, b, c, d] = corners;
        let centre = if c == d { (a + b + c) / 3.0 } else { (a + b + c + d) / 4.0 };
        Self { centre, normal: (c - a).cross(&(d - b)).normalize() }
    }
}
