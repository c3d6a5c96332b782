//! Derivatives against central differences and against their transposes.

use std::sync::Arc;

use moldline_mesh::{Limits, SurfaceMesh, io::msh};
use moldline_panel::{
    Flow, Inputs, NoMonitor, Options, Outputs, PanelSetup, Reference, Scalars, Solution, Solver, Symmetry,
    TrailingEdges,
};

use moldline_testing::{Random, Wing, partly_triangles};

/// A small swept, tapered wing with dihedral-like warping, of quads and triangles.
pub fn wing(half: bool, triangles: bool) -> SurfaceMesh {
    let wing = Wing {
        around: 12,
        span: 8,
        half_span: 2.0,
        chord: |eta| 1.0 - 0.5 * eta.abs(),
        leading_edge: |eta| 0.6 * eta.abs(),
        thickness: 0.15,
        half,
    };
    let mut mesh = wing.mesh();
    if triangles {
        mesh = partly_triangles(&mesh);
    }
    // Twisted, so that cells are warped.
    for v in &mut mesh.vertices {
        let twist = -0.1 * v[1].abs();
        *v = [v[0], v[1], v[2] + 0.05 * v[1] * v[1] + twist * v[0]];
    }
    mesh
}

pub fn flow(sideslip: f64) -> Flow {
    let reference = Reference { area: 2.9, chord: 0.8, span: 4.0, point: [0.3, 0.0, 0.1] };
    Flow { alpha: 0.07, sideslip, reference }
}

struct Case {
    setup: Arc<PanelSetup>,
    vertices: Vec<[f64; 3]>,
    mach: f64,
    flow: Flow,
}

impl Case {
    fn new(mesh: &SurfaceMesh, options: Options, mach: f64, flow: Flow) -> Self {
        let setup = Arc::new(PanelSetup::new(mesh, options).unwrap());
        Self { setup, vertices: mesh.vertices.clone(), mach, flow }
    }

    fn solution(&self) -> Arc<Solution> {
        Arc::new(self.setup.solve(&self.vertices, self.mach, &NoMonitor).unwrap())
    }

    /// Outputs a step along a direction.
    fn moved(&self, direction: &Inputs, step: f64) -> Outputs {
        let mut vertices = self.vertices.clone();
        for (v, d) in vertices.iter_mut().zip(&direction.vertices) {
            (0..3).for_each(|k| v[k] += step * d[k]);
        }
        let mut flow = self.flow;
        flow.alpha += step * direction.alpha;
        flow.sideslip += step * direction.sideslip;
        flow.reference.area += step * direction.area;
        flow.reference.chord += step * direction.chord;
        (0..3).for_each(|k| flow.reference.point[k] += step * direction.point[k]);
        let solution = self.setup.solve(&vertices, self.mach + step * direction.mach, &NoMonitor).unwrap();
        let analysis = solution.analyse(&flow).unwrap();
        Outputs {
            scalars: analysis.scalars,
            sections: analysis.sections.iter().map(|s| s.load).collect(),
            cp: analysis.cp,
        }
    }

    fn random_direction(&self, random: &mut Random) -> Inputs {
        Inputs {
            vertices: random.vectors(self.vertices.len()),
            alpha: random.signed(),
            sideslip: if self.setup.summary().symmetric { 0.0 } else { random.signed() },
            mach: random.signed(),
            area: random.signed(),
            chord: random.signed(),
            point: [random.signed(), random.signed(), random.signed()],
        }
    }

    fn random_seed(&self, random: &mut Random, solution: &Solution) -> Outputs {
        let analysis = solution.analyse(&self.flow).unwrap();
        let mut list = |n: usize| (0..n).map(|_| random.signed()).collect::<Vec<f64>>();
        Outputs {
            sections: list(analysis.sections.len()),
            cp: list(analysis.cp.len()),
            scalars: Scalars::from_array(list(Scalars::COUNT).try_into().unwrap()),
        }
    }
}

fn numbers(outputs: &Outputs) -> Vec<f64> {
    let scalars = outputs.scalars.to_array();
    scalars.iter().chain(&outputs.sections).chain(&outputs.cp).copied().collect()
}

fn dot(direction: &Inputs, gradient: &Inputs) -> (f64, f64) {
    let mut terms = vec![
        direction.alpha * gradient.alpha,
        direction.sideslip * gradient.sideslip,
        direction.mach * gradient.mach,
        direction.area * gradient.area,
        direction.chord * gradient.chord,
    ];
    terms.extend((0..3).map(|k| direction.point[k] * gradient.point[k]));
    for (d, g) in direction.vertices.iter().zip(&gradient.vertices) {
        terms.extend((0..3).map(|k| d[k] * g[k]));
    }
    (terms.iter().sum(), terms.iter().map(|t| t.abs()).sum())
}

fn cases() -> Vec<(&'static str, Case)> {
    let double = Options { symmetry: Symmetry::None, ..Options::default() };
    let mirror = Options::default();
    let half = Options { symmetry: Symmetry::Half, solver: Solver::Single, ..Options::default() };
    vec![
        ("full with sideslip", Case::new(&wing(false, true), double, 0.4, flow(0.05))),
        ("mirrored", Case::new(&wing(false, false), mirror, 0.5, flow(0.0))),
        ("half", Case::new(&wing(true, true), half, 0.3, flow(0.0))),
    ]
}

/// A direction made symmetric up to a hundredth.
fn nearly_symmetric(vertices: &[[f64; 3]], direction: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let image = |v: [f64; 3]| [v[0], -v[1], v[2]];
    let distance = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
    let of_vertex = |(v, d): (&[f64; 3], &[f64; 3])| {
        let nearer = |a: &usize, b: &usize| {
            distance(&vertices[*a], &image(*v)).total_cmp(&distance(&vertices[*b], &image(*v)))
        };
        let partner = image(direction[(0..vertices.len()).min_by(nearer).unwrap()]);
        [0, 1, 2].map(|k| 0.505 * d[k] + 0.495 * partner[k])
    };
    vertices.iter().zip(direction).map(of_vertex).collect()
}

#[test]
fn products_agree_with_central_differences() {
    for (name, case) in cases() {
        let mut random = Random::new(7);
        let mut direction = case.random_direction(&mut random);
        if name == "mirrored" {
            // Halves may differ by little only.
            direction.vertices = nearly_symmetric(&case.vertices, &direction.vertices);
        }
        if case.setup.summary().symmetric {
            let on_plane = |(_, v): &(&mut [f64; 3], &[f64; 3])| v[1].abs() < 1e-9;
            direction.vertices.iter_mut().zip(&case.vertices).filter(on_plane).for_each(|(d, _)| d[1] = 0.0);
        }
        let linearisation = case.solution().linearise(&case.flow).unwrap();
        let exact = numbers(&linearisation.jvp(std::slice::from_ref(&direction), &NoMonitor).unwrap()[0]);
        let scale = 1e-4;
        // Fourth order: two central differences.
        let values = numbers(&case.moved(&direction, 0.0));
        let at = |step: f64| numbers(&case.moved(&direction, step));
        let [a, b, c, d] = [at(-2.0 * scale), at(-scale), at(scale), at(2.0 * scale)];
        let differences: Vec<f64> =
            (0..a.len()).map(|i| (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * scale)).collect();
        // Relative to the tangent itself; to a hundredth of the value, or of the largest of its kind, where the tangent happens to vanish.
        let check = |range: std::ops::Range<usize>, least: &dyn Fn(usize) -> f64| {
            for i in range {
                let error = (exact[i] - differences[i]).abs() / exact[i].abs().max(0.01 * least(i));
                assert!(error < 1e-6, "{name}: output {i}, {} {}", exact[i], differences[i]);
            }
        };
        let scalars = Scalars::COUNT;
        check(0..scalars, &|i| values[i].abs());
        let largest = exact[scalars..].iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        check(scalars..exact.len(), &|_| largest);
    }
}

/// The circulation goes on over a fuselage, also from a trailing edge that runs upstream: a coarse E175 with its wings swept forward.
#[test]
fn circulation_over_a_body() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../examples/e175/study/mesh-coarse.msh");
    let mut mesh = msh::read(&std::fs::read(path).unwrap(), &Limits::default()).unwrap().mesh;
    mesh.vertices.iter_mut().for_each(|v| v[0] -= 0.5 * v[1].abs());
    let names = ["trailing_edge_wing", "trailing_edge_htail"].map(str::to_owned).to_vec();
    let options = Options { trailing_edges: TrailingEdges::Groups(names), ..Options::default() };
    let case = Case::new(&mesh, options, 0.5, flow(0.0));
    // Bent, but still its own mirror image.
    let bent = |v: &[f64; 3]| [0.2 * v[1].abs(), 0.05 * v[1], 0.01 * v[0] * v[2] + 0.02 * v[1] * v[1]];
    let way = Inputs { vertices: case.vertices.iter().map(bent).collect(), ..Inputs::default() };
    let linearisation = case.solution().linearise(&case.flow).unwrap();
    let exact = linearisation.jvp(std::slice::from_ref(&way), &NoMonitor).unwrap().swap_remove(0);
    let at = |size: f64| case.moved(&way, size).scalars.to_array();
    let size = 1e-4;
    let [a, b, c, d] = [-2.0 * size, -size, size, 2.0 * size].map(at);
    for (i, exact) in exact.scalars.to_array().into_iter().enumerate() {
        let difference = (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * size);
        let error = (exact - difference).abs() / exact.abs().max(0.01 * b[i].abs());
        assert!(error < 1e-6, "{}: {exact} {difference}", Scalars::NAMES[i]);
    }
}

#[test]
fn transposes_agree() {
    for (name, case) in cases() {
        let mut random = Random::new(8);
        let solution = case.solution();
        let linearisation = solution.linearise(&case.flow).unwrap();
        let directions: Vec<Inputs> = (0..3).map(|_| case.random_direction(&mut random)).collect();
        let seeds: Vec<Outputs> = (0..3).map(|_| case.random_seed(&mut random, &solution)).collect();
        let forward = linearisation.jvp(&directions, &NoMonitor).unwrap();
        let backward = linearisation.vjp(&seeds, &NoMonitor).unwrap();
        for (direction, tangent) in directions.iter().zip(&forward) {
            for (seed, gradient) in seeds.iter().zip(&backward) {
                let terms = numbers(tangent).into_iter().zip(numbers(seed)).map(|(a, b)| a * b);
                let terms: Vec<f64> = terms.collect();
                let (right, size) = dot(direction, gradient);
                let left: f64 = terms.iter().sum();
                let size = size.max(terms.iter().map(|t| t.abs()).sum());
                assert!((left - right).abs() < 1e-11 * size, "{name}: {left} {right}");
            }
        }
    }
}
