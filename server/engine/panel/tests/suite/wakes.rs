//! Trailing edges, paths over bodies and crossings on random wings, whose trailing edges the generator knows.

use std::{collections::BTreeSet, f64::consts::TAU, sync::Arc};

use moldline_mesh::{Cell, Group, SurfaceMesh};
use moldline_panel::{
    Flow, NoMonitor, OnDoubt, Options, PanelError, PanelSetup, Reason, Reference, TrailingEdges, Warning,
};
use moldline_testing::Random;

/// A section of a wing at a station along the span.
#[derive(Clone, Copy, Debug)]
struct Station {
    leading_edge: [f64; 3],
    chord: f64,
    /// Twist about the leading edge, rad, nose up.
    twist: f64,
    thickness: f64,
}

/// An ellipsoidal body that a wing enters on one side or passes through.
#[derive(Clone, Copy, Debug)]
struct Body {
    /// Of its middle.
    x: f64,
    y: f64,
    length: f64,
    radius: f64,
}

/// Wings and bodies in the order along y, as rings of vertices around the section.
#[derive(Clone, Debug)]
struct Plane {
    /// Cells around a section, even.
    around: usize,
    /// Rows of cells of a blunt base; none if sharp.
    base: usize,
    /// Height of the base over chord.
    height: f64,
    rings: Vec<Vec<[f64; 3]>>,
    /// Whether a ring's vertex 0 lies on the trailing edge between it and the next.
    sheds: Vec<bool>,
}

impl Plane {
    fn new(around: usize, base: usize, height: f64) -> Self {
        Self { around, base, height, rings: Vec::new(), sheds: Vec::new() }
    }

    fn count(&self) -> usize {
        self.around + self.base
    }

    /// From the lower trailing edge over the nose to the upper one, then down the base.
    fn ring(&self, station: &Station) -> Vec<[f64; 3]> {
        let (sin, cos) = station.twist.sin_cos();
        let half = 0.5 * self.height;
        let place = |x: f64, z: f64| {
            let [a, b, c] = station.leading_edge;
            let (x, z) = (station.chord * x, station.chord * z);
            [a + x * cos + z * sin, b, c - x * sin + z * cos]
        };
        let surface = |i: usize| {
            let theta = TAU * i as f64 / self.around as f64;
            let x = 0.5 * (1.0 + theta.cos());
            let t = station.thickness / 0.2
                * (0.2969 * x.sqrt() - 0.126 * x - 0.3516 * x * x + 0.2843 * x.powi(3) - 0.1036 * x.powi(4));
            let t = if 2 * i == self.around {
                0.0
            } else if i == 0 || i == self.around {
                half
            } else {
                t + half * x
            };
            place(x, if 2 * i < self.around { -t } else { t })
        };
        let last = if self.base > 0 { self.around + 1 } else { self.around };
        let mut ring: Vec<[f64; 3]> = (0..last).map(surface).collect();
        let rows = 1..self.base.max(1);
        ring.extend(rows.map(|k| place(1.0, half * (1.0 - 2.0 * k as f64 / self.base as f64))));
        ring
    }

    fn wing(&mut self, stations: &[Station]) {
        for station in stations {
            self.rings.push(self.ring(station));
            self.sheds.push(true);
        }
        if let Some(last) = self.sheds.last_mut() {
            *last = false;
        }
    }

    /// The side of a body from the last ring, or to the given one, in `rows` rows; the middle of the body is a ring of its own.
    fn body(&mut self, body: &Body, next: Option<&Station>, rows: usize) {
        let from = self.rings.last().cloned();
        let side =
            |plane: &mut Self, hole: &[[f64; 3]], sign: f64, fractions: &mut dyn Iterator<Item = f64>| {
                for f in fractions {
                    let ring = (0..plane.count()).map(|i| {
                        let theta = TAU * i as f64 / plane.count() as f64;
                        let (x, z) = (body.x + body.length * theta.cos(), -body.radius * theta.sin());
                        let (x, z) = (hole[i][0] + f * (x - hole[i][0]), hole[i][2] + f * (z - hole[i][2]));
                        let out = 1.0 - ((x - body.x) / body.length).powi(2) - (z / body.radius).powi(2);
                        [x, body.y + sign * body.radius * if f == 1.0 { 0.0 } else { out.max(0.0).sqrt() }, z]
                    });
                    let ring = ring.collect();
                    plane.rings.push(ring);
                    plane.sheds.push(false);
                }
            };
        let at = |k: usize| k as f64 / rows as f64;
        if let Some(hole) = from {
            // The hole lies on the body.
            let last = self.rings.len() - 1;
            self.rings[last] = on_side(body, &hole, -1.0);
            let hole = self.rings[last].clone();
            side(self, &hole, -1.0, &mut (1..=rows).map(at));
        }
        match next {
            Some(next) => {
                let hole = on_side(body, &self.ring(next), 1.0);
                side(self, &hole, 1.0, &mut (1..rows).rev().map(at));
                self.rings.push(hole);
                self.sheds.push(true);
            }
            None => {
                // A cap that the ring of the middle shrinks onto.
                let small = vec![[body.x, body.y, 0.0]; self.count()];
                let small: Vec<[f64; 3]> = (0..self.count())
                    .map(|i| {
                        let theta = TAU * i as f64 / self.count() as f64;
                        let c = small[i];
                        [c[0] + 0.1 * body.length * theta.cos(), c[1], -0.1 * body.radius * theta.sin()]
                    })
                    .collect();
                side(self, &small, 1.0, &mut (0..rows).rev().map(at));
            }
        }
    }

    /// The mesh with capped ends (open at the first ring if it lies on y = 0), and its trailing edges by the vertices that the wake leaves.
    fn mesh(&self) -> (SurfaceMesh, BTreeSet<[u32; 2]>) {
        let n = self.count();
        let at = |i: usize, j: usize| (j * n + i % n) as u32;
        let vertices: Vec<[f64; 3]> = self.rings.iter().flatten().copied().collect();
        let mut cells = Vec::new();
        for j in 0..self.rings.len() - 1 {
            for i in 0..n {
                cells.push(Cell::quad(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)));
            }
        }
        let half = self.rings[0].iter().all(|v| v[1] == 0.0);
        let last = self.rings.len() - 1;
        let ends: &[(usize, bool)] = if half { &[(last, false)] } else { &[(0, true), (last, false)] };
        for &(j, reversed) in ends {
            let mut cap = Vec::new();
            for k in 0..self.base {
                cap.push(Cell::triangle(at(self.around + k, j), at(self.around + k + 1, j), at(1, j)));
            }
            for i in 0..self.around / 2 {
                let (a, b, c, d) = (i, i + 1, self.around - i - 1, self.around - i);
                if i == 0 {
                    // With a base the lower corner has its triangles already.
                    cap.push(Cell::triangle(at(1, j), at(c, j), at(self.around, j)));
                } else if b == c {
                    cap.push(Cell::triangle(at(a, j), at(b, j), at(d, j)));
                } else {
                    cap.push(Cell::quad(at(a, j), at(b, j), at(c, j), at(d, j)));
                }
            }
            cells.extend(cap.into_iter().map(|cell| if reversed { cell.flipped() } else { cell }));
        }
        let edge = |j: usize| [at(0, j), at(0, j + 1)];
        let edges = (0..last).filter(|j| self.sheds[*j]).map(edge).collect();
        (SurfaceMesh::new(vertices, cells, Vec::new(), Vec::new()).unwrap(), edges)
    }
}

/// A ring moved along y onto the side of a body.
fn on_side(body: &Body, ring: &[[f64; 3]], sign: f64) -> Vec<[f64; 3]> {
    let onto = |v: &[f64; 3]| {
        let out = 1.0 - ((v[0] - body.x) / body.length).powi(2) - (v[2] / body.radius).powi(2);
        [v[0], body.y + sign * body.radius * out.max(0.0).sqrt(), v[2]]
    };
    ring.iter().map(onto).collect()
}

/// Cells cut into triangles along random diagonals.
fn cut(mesh: &SurfaceMesh, random: &mut Random) -> SurfaceMesh {
    let mut cells = Vec::new();
    for cell in &mesh.cells {
        match *cell.vertices() {
            [a, b, c, d] if random.coin() => {
                cells.extend([Cell::triangle(a, b, c), Cell::triangle(a, c, d)]);
            }
            [a, b, c, d] => cells.extend([Cell::triangle(a, b, d), Cell::triangle(b, c, d)]),
            _ => cells.push(*cell),
        }
    }
    SurfaceMesh::new(mesh.vertices.clone(), cells, Vec::new(), mesh.vertex_groups.clone()).unwrap()
}

/// Stations of a random wing: a kink, taper, twist, dihedral, and sweep up to 75 degrees at the trailing edge.
fn stations(random: &mut Random, first: f64, count: usize) -> Vec<Station> {
    let sweeps = [random.between(-75.0, 75.0), random.between(-75.0, 75.0)].map(f64::to_radians);
    let dihedral = random.between(-20.0, 20.0).to_radians().tan();
    let (taper, thickness) = (random.between(0.3, 1.0), random.between(0.04, 0.18));
    let (root, tip) = (random.between(-0.05, 0.05), random.between(-0.05, 0.05));
    let span = random.between(1.5, 5.0);
    let mut trailing = 1.0;
    let mut stations = Vec::new();
    for k in 0..count {
        let t = k as f64 / (count - 1) as f64;
        let chord = 1.0 + t * (taper - 1.0);
        if k > 0 {
            let sweep = sweeps[usize::from(2 * k > count)];
            trailing += span / (count - 1) as f64 * sweep.tan();
        }
        let leading_edge = [trailing - chord, first + span * t, dihedral * span * t];
        stations.push(Station { leading_edge, chord, twist: root + t * (tip - root), thickness });
    }
    stations
}

fn sorted(edges: &[[u32; 2]]) -> BTreeSet<[u32; 2]> {
    edges.iter().map(|e| [e[0].min(e[1]), e[0].max(e[1])]).collect()
}

#[test]
fn trailing_edges_of_random_wings_are_found_whole_and_nothing_else() {
    let mut random = Random::new(5);
    for trial in 0..300 {
        let mut plane = Plane::new([16, 24, 40][trial / 3 % 3], 0, 0.0);
        let wing = stations(&mut random, 0.0, 9);
        plane.wing(&wing);
        let (mesh, edges) = plane.mesh();
        let mesh = if trial % 2 == 1 { cut(&mesh, &mut random) } else { mesh };
        let summary = match PanelSetup::new(&mesh, Options::default()) {
            Ok(setup) => setup.summary(),
            Err(error) => panic!("trial {trial}: {error}: {wing:?}"),
        };
        assert_eq!(sorted(&summary.trailing_edges), edges, "trial {trial}: {:?}: {wing:?}", summary.left_out);
        assert_eq!(summary.lines.len(), 1, "trial {trial}");
        assert!(summary.symmetric && summary.roots.is_empty(), "trial {trial}");
        assert!(summary.warnings.is_empty(), "trial {trial}: {:?}", summary.warnings);
    }
}

/// The path runs to the end of the body on which the trailing edge ends, on the plane of symmetry or beside it, and only downstream.
#[test]
fn circulation_goes_downstream_along_the_body() {
    let body = |x: f64, y: f64| Body { x, y, length: 2.5, radius: 0.4 };
    let station = |y: f64| Station { leading_edge: [0.0, y, 0.0], chord: 1.0, twist: 0.03, thickness: 0.1 };
    let wing =
        |from: f64, to: f64| (0..5).map(|k| station(from + (to - from) * k as f64 / 4.0)).collect::<Vec<_>>();
    // A boom in the middle of a half wing: the wing ends on both of its sides.
    let mut boom = Plane::new(24, 0, 0.0);
    boom.wing(&wing(0.0, 1.6));
    boom.body(&body(1.2, 2.0), Some(&station(2.4)), 5);
    boom.wing(&wing(2.6, 5.0));
    // A pod at the tip.
    let mut pod = Plane::new(24, 0, 0.0);
    pod.wing(&wing(0.0, 2.6));
    pod.body(&body(1.2, 3.0), None, 5);
    // The whole of a wing with a pod on one side only.
    let mut lopsided = Plane::new(24, 0, 0.0);
    lopsided.wing(&wing(-2.0, 2.6));
    lopsided.body(&body(0.9, 3.0), None, 5);
    for (name, plane, roots) in [("boom", boom, 2), ("pod", pod, 1), ("lopsided", lopsided, 1)] {
        let (mesh, edges) = plane.mesh();
        // A single vortex from a pod's end has no finite drag, so that the answer is doubtful.
        let options = Options { on_doubt: OnDoubt::Warn, ..Options::default() };
        let setup = PanelSetup::new(&mesh, options).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(sorted(&setup.summary().trailing_edges), edges, "{name}");
        let summary = setup.summary();
        assert_eq!(summary.roots.len(), roots, "{name}");
        let ends: BTreeSet<u32> = summary.aft_ends.iter().copied().collect();
        assert_eq!(ends.len(), 1, "{name}: {ends:?}");
        let x = |v: u32| mesh.vertices[v as usize][0];
        let last = (0..mesh.vertices.len() as u32).map(x).fold(0.0, f64::max);
        for end in ends {
            assert!((x(end) - last).abs() < 1e-9, "{name}: ends at {:?}", mesh.vertices[end as usize]);
        }
        let solution = Arc::new(setup.solve(&mesh.vertices, 0.0, &NoMonitor).unwrap());
        let reference = Reference { area: 5.0, chord: 1.0, span: 5.0, point: [0.0; 3] };
        let flow = Flow { alpha: 0.05, sideslip: 0.0, reference };
        let analysis = solution.analyse(&flow).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(
            analysis.scalars.lift > 0.1 && analysis.disagreement.abs() < 0.02,
            "{name}: {:?}",
            analysis.scalars
        );
    }
}

#[test]
fn parts_without_a_wake_and_edges_that_are_left_out_are_told_of() {
    let mut plane = Plane::new(24, 1, 0.3);
    let station = |k: usize| Station {
        leading_edge: [0.0, 0.25 * k as f64, 0.0],
        chord: 1.0,
        twist: 0.0,
        thickness: 0.1,
    };
    plane.wing(&[0, 1, 2, 3].map(station));
    // Too blunt: as high as long.
    let (mesh, _) = plane.mesh();
    match PanelSetup::new(&mesh, Options::default()) {
        Err(error @ PanelError::NoTrailingEdge { .. }) => {
            let PanelError::NoTrailingEdge { left_out, .. } = &error else { unreachable!() };
            assert!(left_out.iter().any(|line| line.reason == Reason::Base), "{left_out:?}");
            assert!(error.to_string().contains("base"), "{error}");
        }
        other => panic!("{:?}", other.map(|setup| setup.summary())),
    }
    // Beside a wing that sheds one, a part whose edges are not named.
    let wing = |x: f64, z: f64| straight_wing(x, z, 0.1);
    let two = together(&wing(0.0, 0.0), &wing(3.0, 1.0));
    let first = two.cells.len() as u32 / 2;
    let named =
        Options { trailing_edges: TrailingEdges::Groups(vec!["first".to_owned()]), ..Options::default() };
    let warnings = PanelSetup::new(&two, named).unwrap().summary().warnings;
    assert!(
        warnings
            .iter()
            .any(|w| matches!(w, Warning::NoWake { cell, position } if *cell >= first && position[0] > 3.0)),
        "{warnings:?}"
    );
    assert!(
        warnings.iter().any(|w| matches!(w, Warning::LeftOut(line) if line.reason == Reason::NotNamed)),
        "{warnings:?}"
    );
    assert!(PanelSetup::new(&two, Options::default()).unwrap().summary().warnings.is_empty());
}

/// A straight wing of chord 1 m and half span 2 m, with 24 cells around, whose leading edge is at x and z.
fn straight_wing(x: f64, z: f64, thickness: f64) -> SurfaceMesh {
    let mut plane = Plane::new(24, 0, 0.0);
    let station =
        |k: usize| Station { leading_edge: [x, 0.5 * k as f64, z], chord: 1.0, twist: 0.0, thickness };
    plane.wing(&[0, 1, 2, 3, 4].map(station));
    plane.mesh().0
}

/// Two meshes in one; a vertex group `first` of the first one's trailing edge, with 24 cells around.
fn together(one: &SurfaceMesh, two: &SurfaceMesh) -> SurfaceMesh {
    let first = one.vertices.len() as u32;
    let vertices = one.vertices.iter().chain(&two.vertices).copied().collect();
    let cells =
        one.cells.iter().copied().chain(two.cells.iter().map(|cell| cell.map(|v| v + first))).collect();
    let groups = vec![Group { name: "first".to_owned(), indices: (0..first).step_by(24).collect() }];
    SurfaceMesh::new(vertices, cells, Vec::new(), groups).unwrap()
}

/// A second wing downstream with the same stations: whatever its height within its thickness, the first one's wake meets it.
#[test]
fn a_wake_that_meets_a_second_wing() {
    let wing = |x: f64, z: f64| straight_wing(x, z, 0.12);
    let check = |z: f64| {
        let mesh = together(&wing(0.0, 0.0), &wing(3.0, z));
        let setup =
            PanelSetup::new(&mesh, Options { on_doubt: OnDoubt::Warn, ..Options::default() }).unwrap();
        let reference = Reference { area: 4.0, chord: 1.0, span: 4.0, point: [0.0; 3] };
        let solution = setup.solve(&mesh.vertices, 0.0, &NoMonitor)?;
        let flow = Flow { alpha: 0.05, sideslip: 0.0, reference };
        Ok((solution.analyse(&flow)?.warnings, mesh.cells.len() as u32 / 2))
    };
    for z in [0.0, 0.02, -0.05, 0.0593] {
        match check(z) {
            Err(PanelError::WakeCutsBody { cell, x, .. }) => {
                assert!(cell >= 108 && (3.0..=4.0).contains(&x), "{z}: {cell} {x}")
            }
            other => panic!("{z}: {other:?}"),
        }
    }
    let (warnings, first): (Vec<Warning>, u32) = check(0.063).unwrap();
    assert!(
        warnings
            .iter()
            .any(|w| matches!(w, Warning::NearPass(pass) if pass.cell >= first && pass.distance < 0.01)),
        "{warnings:?}"
    );
    let (warnings, _) = check(0.4).unwrap();
    assert!(!warnings.iter().any(|w| matches!(w, Warning::NearPass(_))), "{warnings:?}");
}
