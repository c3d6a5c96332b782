//! Whether triangles meet, decided exactly (Shewchuk's adaptive predicates, Discrete & Computational Geometry 18, 1997).

use robust::{Coord, Coord3D, orient2d, orient3d};

/// A corner: its index, by which shared ones are known, and its position.
pub(super) type Corner = (u32, [f64; 3]);

fn point([x, y, z]: [f64; 3]) -> Coord3D<f64> {
    Coord3D { x, y, z }
}

/// The side of a plane through a, b and c on which d lies: -1, 0 or 1.
fn side(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> i8 {
    sign(orient3d(point(a), point(b), point(c), point(d)))
}

fn sign(value: f64) -> i8 {
    i8::from(value > 0.0) - i8::from(value < 0.0)
}

/// Points in a coordinate plane on which a triangle has an area, and the sign of that.
struct Projected {
    axes: [usize; 2],
    turn: i8,
}

impl Projected {
    fn new(triangle: &[[f64; 3]; 3]) -> Option<Self> {
        [[0, 1], [1, 2], [2, 0]].into_iter().find_map(|axes| {
            let projected = Self { axes, turn: 1 };
            let turn = projected.turns(triangle[0], triangle[1], triangle[2]);
            (turn != 0).then_some(Self { axes, turn })
        })
    }

    /// To which side the way from a over b to c turns.
    fn turns(&self, a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> i8 {
        let [a, b, c] = [a, b, c].map(|p| Coord { x: p[self.axes[0]], y: p[self.axes[1]] });
        sign(orient2d(a, b, c))
    }

    /// Whether a point of the triangle's plane is in the triangle.
    fn contains(&self, [a, b, c]: &[[f64; 3]; 3], x: [f64; 3]) -> bool {
        [(a, b), (b, c), (c, a)].iter().all(|(p, q)| self.turns(**p, **q, x) * self.turn >= 0)
    }

    /// Whether two segments of the plane meet.
    fn segments_meet(&self, [p, q]: [[f64; 3]; 2], [r, s]: [[f64; 3]; 2]) -> bool {
        let (one, two) =
            (self.turns(p, q, r) * self.turns(p, q, s), self.turns(r, s, p) * self.turns(r, s, q));
        if one > 0 || two > 0 {
            return false;
        }
        if self.turns(p, q, r) != 0 || self.turns(p, q, s) != 0 || self.turns(r, s, p) != 0 {
            return true;
        }
        // All on one line: they meet if their boxes do.
        self.axes.iter().all(|&axis| {
            let (low, high) = (p[axis].min(q[axis]), p[axis].max(q[axis]));
            r[axis].max(s[axis]) >= low && r[axis].min(s[axis]) <= high
        })
    }
}

/// Whether a segment and a triangle have a point in common. Triangles without area have none.
fn segment_meets(segment: [[f64; 3]; 2], triangle: &[[f64; 3]; 3]) -> bool {
    let [p, q] = segment;
    let [a, b, c] = *triangle;
    let (of_p, of_q) = (side(a, b, c, p), side(a, b, c, q));
    if of_p * of_q > 0 {
        return false;
    }
    if of_p == 0 && of_q == 0 {
        let Some(plane) = Projected::new(triangle) else { return false };
        return plane.contains(triangle, p)
            || plane.contains(triangle, q)
            || [[a, b], [b, c], [c, a]].into_iter().any(|edge| plane.segments_meet(segment, edge));
    }
    let turns = [side(p, q, a, b), side(p, q, b, c), side(p, q, c, a)];
    turns.iter().all(|turn| *turn >= 0) || turns.iter().all(|turn| *turn <= 0)
}

/// Whether two triangles have a point in common that is no shared corner and on no shared edge.
pub(super) fn triangles_meet(one: &[Corner; 3], two: &[Corner; 3]) -> bool {
    let at = |triangle: &[Corner; 3]| triangle.map(|(_, x)| x);
    let (a, b) = (at(one), at(two));
    let own = |triangle: &[Corner; 3], other: &[Corner; 3]| -> Vec<usize> {
        (0..3).filter(|&k| other.iter().all(|corner| corner.0 != triangle[k].0)).collect()
    };
    let (own_one, own_two) = (own(one, two), own(two, one));
    match own_one.len() {
        // One in the other's place.
        0 => true,
        // With one edge in common they meet elsewhere only if one lies folded on the other.
        1 => {
            let (p, q) = (a[own_one[0]], b[own_two[0]]);
            let [k, j] = [(own_one[0] + 1) % 3, (own_one[0] + 2) % 3];
            if side(a[0], a[1], a[2], q) != 0 {
                return false;
            }
            let Some(plane) = Projected::new(&a) else { return false };
            plane.turns(a[k], a[j], p) * plane.turns(a[k], a[j], q) > 0
        }
        // With one corner in common the edges opposite to it tell.
        2 => {
            segment_meets([a[own_one[0]], a[own_one[1]]], &b)
                || segment_meets([b[own_two[0]], b[own_two[1]]], &a)
        }
        _ => {
            let edges = |t: &[[f64; 3]; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
            edges(&a).into_iter().any(|edge| segment_meets(edge, &b))
                || edges(&b).into_iter().any(|edge| segment_meets(edge, &a))
        }
    }
}
