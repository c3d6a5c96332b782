//! One answer, whatever solves it and on however many threads.

use std::sync::Arc;

use moldline_panel::{Analysis, NoMonitor, Options, Outputs, PanelSetup, Scalars, Solution, Solver};

use moldline_testing::Wing;

use crate::flow::flow;

/// More unknowns than one block of the preconditioner has.
fn solution(solver: Solver, tolerance: f64) -> Arc<Solution> {
    let mesh = Wing { half: true, ..Wing::rectangular(40, 48) }.mesh();
    let setup = PanelSetup::new(&mesh, Options { solver, tolerance, ..Options::default() }).unwrap();
    assert!(setup.summary().unknowns > 900);
    Arc::new(setup.solve(&mesh.vertices, 0.4, &NoMonitor).unwrap())
}

fn analysis(solver: Solver, tolerance: f64) -> Analysis {
    let a = solution(solver, tolerance).analyse(&flow(3.0, 8.0)).unwrap();
    assert!(a.residual <= tolerance, "{solver:?}: {}", a.residual);
    a
}

fn difference(one: &Analysis, two: &Analysis) -> f64 {
    let scalars = one.scalars.to_array().into_iter().zip(two.scalars.to_array());
    let cp = one.cp.iter().copied().zip(two.cp.iter().copied());
    scalars.chain(cp).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn factors_in_single_precision_are_refined() {
    let (double, single) = (analysis(Solver::Double, 1e-12), analysis(Solver::Single, 1e-12));
    assert!(single.rounds >= 2, "{} rounds", single.rounds);
    assert!(difference(&double, &single) <= 1e-9, "{:e}", difference(&double, &single));
}

#[test]
fn iterations_agree_with_factors_to_their_tolerance() {
    let double = analysis(Solver::Double, 1e-12);
    for tolerance in [1e-6, 1e-9, 1e-12] {
        let iterative = analysis(Solver::Iterative, tolerance);
        let difference = difference(&double, &iterative);
        // Velocities are differences of potentials between panels.
        assert!(difference <= 1e3 * tolerance, "{tolerance:e}: {difference:e}");
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    for solver in [Solver::Single, Solver::Iterative] {
        let bits = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let solution = solution(solver, 1e-10);
                let a = solution.analyse(&flow(3.0, 8.0)).unwrap();
                let seed = |index: usize| {
                    let mut values = [0.0; Scalars::COUNT];
                    values[index] = 1.0;
                    Outputs { scalars: Scalars::from_array(values), ..Outputs::default() }
                };
                let linearisation = solution.linearise(&flow(3.0, 8.0)).unwrap();
                let gradients = linearisation.vjp(&[seed(0), seed(4)], &NoMonitor).unwrap();
                let tangents = linearisation.jvp(&gradients, &NoMonitor).unwrap();
                let of_tangents =
                    tangents.iter().flat_map(|t| t.scalars.to_array().into_iter().chain(t.cp.clone()));
                let of_gradients = gradients.iter().flat_map(|g| g.vertices.iter().flatten().copied());
                let numbers =
                    a.scalars.to_array().into_iter().chain(a.cp).chain(of_gradients).chain(of_tangents);
                numbers.map(f64::to_bits).collect::<Vec<u64>>()
            })
        };
        assert!(bits(1) == bits(2), "{solver:?}: other bits on two threads");
        assert!(bits(1) == bits(5), "{solver:?}: other bits on five threads");
    }
}
