//! Derivatives against central differences and against their transposes.

use std::sync::Arc;

use moldline_mesh::SurfaceMesh;
use moldline_panel::{
    Flow, Inputs, Options, Outputs, PanelSetup, Reference, Scalars, Silent, Solution, Solver, Symmetry,
};

use crate::meshes::{Random, Wing, partly_triangles};

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
        Arc::new(self.setup.solve(&self.vertices, self.mach, &Silent).unwrap())
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
        let solution = self.setup.solve(&vertices, self.mach + step * direction.mach, &Silent).unwrap();
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
            alpha: random.next(),
            sideslip: if self.setup.summary().symmetric { 0.0 } else { random.next() },
            mach: random.next(),
            area: random.next(),
            chord: random.next(),
            point: [random.next(), random.next(), random.next()],
        }
    }

    fn random_seed(&self, random: &mut Random, solution: &Solution) -> Outputs {
        let analysis = solution.analyse(&self.flow).unwrap();
        let mut list = |n: usize| (0..n).map(|_| random.next()).collect::<Vec<f64>>();
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

#[test]
fn products_agree_with_central_differences() {
    for (name, case) in cases() {
        let mut random = Random::new(7);
        let mut direction = case.random_direction(&mut random);
        if case.setup.summary().symmetric && name == "mirrored" {
            // Halves may differ by so little only.
            direction.vertices.iter_mut().flatten().for_each(|x| *x *= 0.5);
        }
        let linearisation = case.solution().linearise(&case.flow).unwrap();
        let exact = numbers(&linearisation.jvp(std::slice::from_ref(&direction), &Silent).unwrap()[0]);
        let scale = 2e-6;
        // Fourth order: two central differences.
        let values = numbers(&case.moved(&direction, 0.0));
        let at = |step: f64| numbers(&case.moved(&direction, step));
        let [a, b, c, d] = [at(-2.0 * scale), at(-scale), at(scale), at(2.0 * scale)];
        let differences: Vec<f64> = (0..a.len())
            .map(|i| (8.0 * (c[i] - b[i]) - (d[i] - a[i])) / (12.0 * scale))
            .collect();
        let largest = |range: std::ops::Range<usize>| {
            let size = exact[range.clone()].iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let error = range.map(|i| (exact[i] - differences[i]).abs()).fold(0.0, f64::max);
            error / size
        };
        let scalars = Scalars::COUNT;
        for (i, scalar) in Scalars::NAMES.iter().enumerate() {
            // A tangent that happens to vanish is as exact as the differences of the values allow.
            let error = (exact[i] - differences[i]).abs() / exact[i].abs().max(values[i].abs());
            assert!(error < 1e-6, "{name}: {scalar} {} {}", exact[i], differences[i]);
        }
        let others = largest(scalars..exact.len());
        assert!(others < 1e-6, "{name}: {others:e}");
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
        let forward = linearisation.jvp(&directions, &Silent).unwrap();
        let backward = linearisation.vjp(&seeds, &Silent).unwrap();
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
