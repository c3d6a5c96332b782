//! Isotropic remeshing to a field of sizes (Botsch and Kobbelt, 2004): long edges are split, short ones collapsed, edges
//! flipped and vertices moved, always on the components. Curves keep their edges; corners stay.

use moldline_foundation::Vector3;

use crate::{
    hold::{FACING, Hold, On},
    surface::{GONE, Kind, Surface},
    tessellation::ordered,
    union::Curve,
};

/// An edge is split above this multiple of the wanted length ...
const LONG: f64 = 4.0 / 3.0;
/// ... and collapsed below this one.
const SHORT: f64 = 0.75;
/// Rounds of splits or collapses in one pass.
const ROUNDS: usize = 6;

/// Why an edge is collapsed.
#[derive(Clone, Copy)]
enum Purpose {
    /// It is short.
    Size,
    /// A triangle at it is turned or long.
    Repair,
}

impl Surface<'_> {
    /// One pass of all operations.
    pub fn pass(&mut self) {
        self.collapse_short();
        self.split_long();
        self.collapse_short();
        self.flip();
        for _ in 0..3 {
            self.smooth();
            self.flip();
        }
    }

    /// Whether triangle `t` with these vertices faces outwards.
    pub fn faces_out(&self, vertices: [u32; 3], t: u32) -> bool {
        let area = self.area(vertices);
        area.dot(&self.normal(vertices, t)) > FACING * area.norm()
    }

    /// How bad triangles are: how many of them are turned, and the largest aspect ratio divided by the cosine between triangle
    /// and surface, so that at thin leading edges triangles follow the surface.
    fn badness(&self, triangles: impl Iterator<Item = ([u32; 3], u32)>) -> (usize, f64) {
        triangles.fold((0, 0.0), |(turned, worst), (vertices, t)| {
            let area = self.area(vertices);
            let cosine = area.dot(&self.normal(vertices, t)) / area.norm();
            // Also if it is not a number.
            let faces_out = cosine > FACING;
            let cosine = if faces_out { cosine } else { FACING };
            (turned + usize::from(!faces_out), f64::max(worst, self.aspect(vertices) / cosine))
        })
    }

    /// How many of the triangles do not face outwards. Putting the union's thin triangles onto the splines can turn some;
    /// no operation makes them more.
    fn turned(&self, triangles: impl Iterator<Item = ([u32; 3], u32)>) -> usize {
        triangles.filter(|&(vertices, t)| !self.faces_out(vertices, t)).count()
    }

    /// The triangles around a vertex that are turned.
    fn turned_around(&self, v: u32) -> usize {
        let around = self.around[v as usize].iter();
        self.turned(around.map(|&t| (self.triangles[t as usize], t)))
    }

    /// Edges by the ratio of their length to the wanted one that pass `filter`, curves first.
    fn ranked(&self, filter: impl Fn(f64) -> bool, descending: bool) -> Vec<[u32; 2]> {
        let mut ranked: Vec<(bool, f64, [u32; 2])> = self
            .edges()
            .into_iter()
            .map(|[a, b]| (self.curve(a, b).is_none(), self.length(a, b) / self.wanted(a, b), [a, b]))
            .filter(|(_, ratio, _)| filter(*ratio))
            .collect();
        ranked.sort_by(|x, y| {
            let order = x.1.total_cmp(&y.1);
            let order = if descending { order.reverse() } else { order };
            x.0.cmp(&y.0).then(order).then(x.2.cmp(&y.2))
        });
        ranked.into_iter().map(|(_, _, edge)| edge).collect()
    }

    fn split_long(&mut self) {
        for _ in 0..ROUNDS {
            let mut done = 0;
            for [a, b] in self.ranked(|r| r > LONG, true) {
                done += usize::from(self.split(a, b));
            }
            if done == 0 {
                break;
            }
        }
    }

    fn collapse_short(&mut self) {
        for _ in 0..ROUNDS {
            let mut done = 0;
            for [a, b] in self.ranked(|r| r < SHORT, false) {
                if self.length(a, b) < SHORT * self.wanted(a, b) {
                    let order = [(a, b), (b, a)];
                    done += usize::from(order.iter().any(|&(a, b)| self.collapse(a, b, Purpose::Size)));
                }
            }
            if done == 0 {
                break;
            }
        }
    }

    /// Puts a vertex into the middle of an edge.
    fn split(&mut self, a: u32, b: u32) -> bool {
        let faces: Vec<u32> = self.at_edge(a, b).collect();
        let Some(&first) = faces.first() else { return false };
        let curve = self.curve(a, b);
        let middle = 0.5 * (self.x(a) + self.x(b));
        let outwards = |component: u32| -> Vector3 {
            let own = faces.iter().filter(|&&t| self.owner[t as usize] == component);
            own.map(|&t| self.area(self.triangles[t as usize])).sum()
        };
        let owner = self.owner[first as usize];
        let mut best: Option<(f64, Hold, Vector3)> = None;
        for end in [Some(a), Some(b), None] {
            let on = |component: u32, edge| {
                let location = match end {
                    Some(end) => self.holds[end as usize].location(component),
                    None => {
                        let own = faces.iter().find(|&&t| self.owner[t as usize] == component);
                        own.map(|&t| self.places[t as usize])
                    }
                };
                Some(On { component, edge, location: location? })
            };
            let on = match curve {
                Some(Curve::Seam(c, d)) => vec![on(c, None), on(d, None)],
                Some(Curve::Sharp(c, edge)) => vec![on(c, Some(edge))],
                Some(Curve::Plane(c)) => vec![on(c, None)],
                None => vec![on(owner, None)],
            };
            let Some(on) = on.into_iter().collect::<Option<Vec<_>>>() else { continue };
            let mut hold = Hold { on, plane: matches!(curve, Some(Curve::Plane(_))), fixed: false };
            let Some(x) = hold.project(self.bodies, middle) else { continue };
            // The other side of a thin body may be as near.
            let astray = hold.on.iter().filter(|on| on.edge.is_none()).any(|on| {
                let body = self.bodies[on.component as usize];
                on.is_on_a_crease(body) || body.normal(&on.location).dot(&outwards(on.component)) <= 0.0
            });
            if astray {
                continue;
            }
            let distance = (x - middle).norm();
            if best.as_ref().is_none_or(|(least, ..)| distance < *least) {
                best = Some((distance, hold, x));
            }
        }
        let Some((distance, hold, x)) = best else { return false };
        if distance > 0.45 * self.length(a, b) {
            return false;
        }
        let m = self.positions.len() as u32;
        self.positions.push(x);
        self.holds.push(hold);
        self.kinds.push(if curve.is_some() { Kind::Curve } else { Kind::Surface });
        self.sizes.push(self.wanted(a, b));
        self.around.push(Vec::new());
        for t in faces {
            let old = self.triangles[t as usize];
            let new = self.triangles.len() as u32;
            self.triangles[t as usize] = old.map(|v| if v == b { m } else { v });
            self.triangles.push(old.map(|v| if v == a { m } else { v }));
            self.owner.push(self.owner[t as usize]);
            self.places.push(self.places[t as usize]);
            self.around[b as usize].retain(|&s| s != t);
            for v in old.into_iter().filter(|&v| v != a) {
                self.around[v as usize].push(new);
            }
            self.around[m as usize].extend([t, new]);
        }
        if let Some(curve) = curve {
            self.curves.remove(&ordered(a, b));
            self.curves.insert(ordered(a, m), curve);
            self.curves.insert(ordered(m, b), curve);
        }
        true
    }

    /// Moves vertex `a` into `b`, if everything stays in order.
    fn collapse(&mut self, a: u32, b: u32, purpose: Purpose) -> bool {
        let curve = self.curve(a, b);
        let allowed = match self.kinds[a as usize] {
            Kind::Surface => true,
            Kind::Curve => curve.is_some(),
            Kind::Corner => false,
        };
        let shared: Vec<u32> = self.at_edge(a, b).collect();
        if !allowed || shared.is_empty() {
            return false;
        }
        let (near_a, near_b) = (self.neighbours(a), self.neighbours(b));
        let common = near_a.iter().filter(|v| near_b.binary_search(v).is_ok()).count();
        if common != shared.len() {
            return false;
        }
        let mut moved = Vec::new();
        let mut worst_before: f64 = 0.0;
        let mut worst_after: f64 = 0.0;
        for &t in &self.around[a as usize] {
            let old = self.triangles[t as usize];
            worst_before = worst_before.max(self.aspect(old));
            if !shared.contains(&t) {
                let new = old.map(|v| if v == a { b } else { v });
                worst_after = worst_after.max(self.aspect(new));
                moved.push((t, new));
            }
        }
        let before = self.turned_around(a);
        let after = self.turned(moved.iter().map(|&(t, new)| (new, t)));
        let allowed = match purpose {
            Purpose::Size => {
                let tiny = self.length(a, b) < 0.25 * self.wanted(a, b);
                let long = |v: u32| self.length(v, b) > LONG * self.wanted(v, b);
                worst_after <= worst_before.max(3.0)
                    && (after == 0 || after < before)
                    && (tiny || !near_a.iter().any(|&v| v != b && long(v)))
            }
            Purpose::Repair => after < before || (after == before && worst_after < worst_before),
        };
        if !allowed {
            return false;
        }
        if curve.is_some() {
            let rest = near_a.iter().find(|&&v| v != b && self.curve(a, v).is_some()).copied();
            let Some(rest) = rest else { return false };
            if self.curve(b, rest).is_some() || near_b.binary_search(&rest).is_ok() {
                return false;
            }
            self.curves.remove(&ordered(a, b));
            if let Some(kept) = self.curves.remove(&ordered(a, rest)) {
                self.curves.insert(ordered(b, rest), kept);
            }
        }
        for t in shared {
            for v in self.triangles[t as usize] {
                self.around[v as usize].retain(|&s| s != t);
            }
            self.triangles[t as usize] = GONE;
        }
        for (t, new) in moved {
            self.triangles[t as usize] = new;
            self.around[b as usize].push(t);
        }
        self.around[a as usize].clear();
        self.around[b as usize].sort_unstable();
        true
    }

    /// Flips edges where that improves the worse of the two triangles.
    fn flip(&mut self) {
        for _ in 0..4 {
            let mut done = 0;
            for [a, b] in self.edges() {
                if self.curve(a, b).is_some() {
                    continue;
                }
                let faces: Vec<u32> = self.at_edge(a, b).collect();
                let [s, t] = faces[..] else { continue };
                let (old_s, old_t) = (self.triangles[s as usize], self.triangles[t as usize]);
                let other = |t: [u32; 3]| t.into_iter().find(|&v| v != a && v != b);
                let (Some(c), Some(d)) = (other(old_s), other(old_t)) else { continue };
                if c == d || self.at_edge(c, d).next().is_some() {
                    continue;
                }
                // `old_s` with one end replaced by the far vertex keeps its orientation.
                let new_s = old_s.map(|v| if v == b { d } else { v });
                let new_t = old_t.map(|v| if v == a { c } else { v });
                let before = self.badness([(old_s, s), (old_t, t)].into_iter());
                let after = self.badness([(new_s, s), (new_t, t)].into_iter());
                let improves = after.0 < before.0 || (after.0 == before.0 && after.1 < 0.999 * before.1);
                if !improves || after.1 > 100.0 {
                    continue;
                }
                self.triangles[s as usize] = new_s;
                self.triangles[t as usize] = new_t;
                for f in [s, t] {
                    self.places[f as usize] = self.place(f);
                }
                self.around[b as usize].retain(|&f| f != s);
                self.around[a as usize].retain(|&f| f != t);
                self.around[d as usize].push(s);
                self.around[c as usize].push(t);
                done += 1;
            }
            if done == 0 {
                break;
            }
        }
    }

    /// Moves each vertex towards the middle of its neighbours, weighted by the sizes, if no triangle gets bad by it.
    pub fn smooth(&mut self) {
        for v in 0..self.positions.len() as u32 {
            if self.around[v as usize].is_empty() {
                continue;
            }
            let target = match self.kinds[v as usize] {
                Kind::Corner => continue,
                Kind::Curve => {
                    let ends: Vec<u32> =
                        self.neighbours(v).into_iter().filter(|&w| self.curve(v, w).is_some()).collect();
                    let [a, b] = ends[..] else { continue };
                    let (p, q) = (1.0 / self.wanted(a, v), 1.0 / self.wanted(v, b));
                    // Equal lengths relative to the wanted ones, along the chord.
                    let (la, lb) = (p * self.length(a, v), q * self.length(v, b));
                    let shift = 0.5 * (la - lb);
                    if shift > 0.0 {
                        self.x(v) + (self.x(a) - self.x(v)) * (shift / la).min(0.5)
                    } else {
                        self.x(v) + (self.x(b) - self.x(v)) * (-shift / lb).min(0.5)
                    }
                }
                Kind::Surface => {
                    let mut sum = Vector3::zeros();
                    let mut weights = 0.0;
                    for &t in &self.around[v as usize] {
                        let t = self.triangles[t as usize];
                        let size: f64 = t.iter().map(|&w| self.sizes[w as usize]).sum::<f64>() / 3.0;
                        let weight = self.area(t).norm() / (size * size);
                        sum += weight * (self.x(t[0]) + self.x(t[1]) + self.x(t[2])) / 3.0;
                        weights += weight;
                    }
                    if weights <= 0.0 {
                        continue;
                    }
                    sum / weights
                }
            };
            self.try_move(v, target, 1.7);
        }
    }

    /// Moves a vertex to the projection of `target` if the worst triangle around it stays below `accepted` or improves.
    pub fn try_move(&mut self, v: u32, target: Vector3, accepted: f64) -> bool {
        let mut hold = self.holds[v as usize].clone();
        let old = self.positions[v as usize];
        let Some(x) = hold.project(self.bodies, target) else { return false };
        if (x - target).norm() > (target - old).norm() + 0.5 * self.sizes[v as usize] {
            return false;
        }
        if !hold.keeps_sheets_of(&self.holds[v as usize], self.bodies) {
            return false;
        }
        let badness =
            |s: &Self| s.badness(s.around[v as usize].iter().map(|&t| (s.triangles[t as usize], t)));
        let before = badness(self);
        let old_hold = std::mem::replace(&mut self.holds[v as usize], hold);
        self.positions[v as usize] = x;
        let after = badness(self);
        let good = after.0 < before.0 || (after.0 == before.0 && after.1 <= before.1.max(accepted));
        if !good {
            self.positions[v as usize] = old;
            self.holds[v as usize] = old_hold;
        }
        good
    }

    /// Removes triangles that are turned, or whose aspect ratio is above `above`, by collapses of their edges, flips and moves, whatever
    /// the sizes.
    pub fn repair(&mut self, above: f64) {
        for _ in 0..ROUNDS {
            let bad: Vec<u32> = (0..self.triangles.len() as u32).filter(|&t| self.is_bad(t, above)).collect();
            if bad.is_empty() {
                break;
            }
            for t in bad {
                let [a, b, c] = self.triangles[t as usize];
                if !self.is_bad(t, above) {
                    continue;
                }
                let mut edges = [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)];
                edges.sort_by(|x, y| self.length(x.0, x.1).total_cmp(&self.length(y.0, y.1)));
                let collapsed = edges.iter().any(|&(a, b)| self.collapse(a, b, Purpose::Repair));
                if !collapsed && !self.faces_out([a, b, c], t) {
                    // Where the surface bends more than the triangle can follow, smaller ones do.
                    let (a, b) = edges[5];
                    self.split(a, b);
                }
            }
            self.flip();
            self.polish(above);
        }
    }

    fn is_bad(&self, t: u32, above: f64) -> bool {
        let triangle = self.triangles[t as usize];
        triangle != GONE && (self.aspect(triangle) >= above || !self.faces_out(triangle, t))
    }

    /// Improves the worst triangles by moves of their vertices towards better shapes.
    pub fn polish(&mut self, above: f64) {
        for t in 0..self.triangles.len() as u32 {
            if !self.is_bad(t, above) {
                continue;
            }
            for v in self.triangles[t as usize] {
                if self.kinds[v as usize] == Kind::Corner {
                    continue;
                }
                let scale = self.sizes[v as usize];
                for w in self.neighbours(v) {
                    let direction = self.x(w) - self.x(v);
                    let Some(direction) = direction.try_normalize(0.0) else { continue };
                    for step in [0.1, -0.1, 0.03, -0.03] {
                        self.try_move(v, self.x(v) + direction * (step * scale), 1.0);
                    }
                }
            }
        }
    }
}
