//! The check finds nothing wrong with a right linearisation, and names the step in which a wrong one goes wrong.

mod common;

use std::sync::atomic::{AtomicUsize, Ordering};

use common::{design, setup, unit};
use moldline_check::{
    Chain, CheckError, CheckOptions, DesignCheck, Evaluation, Linear, Outputs, Phase, Stages, Step, Watch,
    check_design, designs,
};
use moldline_deform::{DeformError, NoMonitor, Setup};

/// A linearisation given by its whole Jacobian, from dual numbers, with an error.
struct Jacobian {
    evaluation: Evaluation,
    mistake: fn(&mut Stages),
    /// A factor on the adjoint product.
    adjoint: f64,
}

impl Jacobian {
    fn new(setup: &Setup, design: &[f64]) -> Self {
        let count = design.len();
        let directions: Vec<Vec<f64>> = (0..count).map(|k| unit(count, k)).collect();
        let evaluation = Chain::new(setup).eval(design, &directions, &NoMonitor).expect("evaluates");
        Self { evaluation, mistake: |_| (), adjoint: 1.0 }
    }
}

impl Linear for Jacobian {
    fn outputs(&self) -> Outputs {
        let vertices = self.evaluation.values.vertices.iter().map(|&x| x.into()).collect();
        Outputs { vertices, functions: self.evaluation.values.functions.clone() }
    }

    fn jvp(&self, directions: &[Vec<f64>]) -> Result<Vec<Outputs>, DeformError> {
        let product = |direction: &Vec<f64>| {
            let stages = self.stages(direction)?;
            let vertices = stages.vertices.iter().map(|&x| x.into()).collect();
            Ok(Outputs { vertices, functions: stages.functions })
        };
        directions.iter().map(product).collect()
    }

    fn vjp(&self, seeds: &[Outputs]) -> Result<Vec<Vec<f64>>, DeformError> {
        let columns = self.jvp(&(0..2).map(|k| unit(2, k)).collect::<Vec<_>>())?;
        let product = |seed: &Outputs, column: &Outputs| {
            let vertices = seed.vertices.iter().flatten().zip(column.vertices.iter().flatten());
            let both = vertices.chain(seed.functions.iter().zip(&column.functions));
            self.adjoint * both.map(|(a, b)| a * b).sum::<f64>()
        };
        Ok(seeds.iter().map(|seed| columns.iter().map(|c| product(seed, c)).collect()).collect())
    }

    fn stages(&self, direction: &[f64]) -> Result<Stages, DeformError> {
        let [a, b] = &self.evaluation.tangents[..] else { panic!("two variables") };
        let mut stages = b.clone();
        let mix = |x: &mut nalgebra::Vector3<f64>, y: &nalgebra::Vector3<f64>| {
            *x = *y * direction[0] + *x * direction[1]
        };
        let mix_all = |x: &mut Vec<nalgebra::Vector3<f64>>, y: &Vec<nalgebra::Vector3<f64>>| {
            x.iter_mut().zip(y).for_each(|(x, y)| mix(x, y));
        };
        for (x, y) in stages.control_points.iter_mut().flatten().zip(a.control_points.iter().flatten()) {
            for axis in 0..3 {
                x[axis] = y[axis] * direction[0] + x[axis] * direction[1];
            }
        }
        for (x, y) in stages.seam_parameters.iter_mut().flatten().zip(a.seam_parameters.iter().flatten()) {
            for k in 0..2 {
                x[k] = y[k] * direction[0] + x[k] * direction[1];
            }
        }
        mix_all(&mut stages.seam_positions, &a.seam_positions);
        stages.motions.iter_mut().zip(&a.motions).for_each(|(x, y)| mix_all(x, y));
        mix_all(&mut stages.displacements, &a.displacements);
        mix_all(&mut stages.placed, &a.placed);
        mix_all(&mut stages.vertices, &a.vertices);
        for (x, y) in stages.functions.iter_mut().zip(&a.functions) {
            *x = y * direction[0] + *x * direction[1];
        }
        (self.mistake)(&mut stages);
        Ok(stages)
    }
}

/// The vertex whose derivatives along the first variable differ most at the baseline of the half model.
const WORST: usize = 326;

struct Nobody;

impl Watch for Nobody {
    fn progress(&self, _: Phase, _: f64) {}
}

fn check(setup: &Setup, linear: &Jacobian, design: &[f64]) -> DesignCheck {
    let options = CheckOptions::all(2);
    check_design(setup, &Chain::new(setup), linear, setup, design, &options, &Nobody).expect("is checked")
}

#[test]
fn a_right_linearisation_passes() {
    let setup = setup("tests/configurations/boom", |_| {});
    let design = design(&setup, 0.5);
    let found = check(&setup, &Jacobian::new(&setup, &design), &design);
    assert!(found.dot_product_max() < 1e-13, "{:e}", found.dot_product_max());
    assert!(found.dual_max() == 0.0 && found.values < 1e-12);
    assert!(found.central_difference_max() < 1e-8, "{:e}", found.central_difference_max());
    assert!(found.variables.iter().all(|v| v.first_off.is_none()));
    // The plateau: wide steps are off by their size, narrow ones by rounding.
    for variable in &found.variables {
        let errors: Vec<f64> = variable.differences.iter().map(|d| d.error.expect("has meshes")).collect();
        let best = variable.best().expect("has a best").1;
        assert!(errors.len() == 8 && best < 0.1 * errors[7]);
    }
}

#[test]
fn a_mistake_is_found_and_named() {
    let setup = setup("tests/configurations/boom", |_| {});
    let design = design(&setup, 0.5);
    let mut linear = Jacobian::new(&setup, &design);
    type Mistake = (fn(&mut Stages), Step);
    let mistakes: [Mistake; 4] = [
        (|s| s.seam_parameters.iter_mut().for_each(|p| p[0][0] *= 1.0 + 1e-8), Step::SeamParameters),
        (|s| s.displacements.iter_mut().for_each(|d| *d *= 1.0 + 1e-8), Step::Displacements),
        (|s| s.functions.iter_mut().for_each(|f| *f *= 1.0 + 1e-8), Step::Functions),
        (|s| s.vertices.iter_mut().for_each(|x| *x *= 1.0 + 1e-8), Step::Vertices),
    ];
    for (mistake, step) in mistakes {
        linear.mistake = mistake;
        let found = check(&setup, &linear, &design);
        assert!(found.variables.iter().all(|v| v.first_off == Some(step)), "{step:?}: {:?}", found.variables);
    }
    // An error in the last step shows in the whole result.
    let found = check(&setup, &linear, &design);
    assert!((0.9e-8..1.1e-8).contains(&found.dual_max()));
    assert!(found.dot_product_max() < 1e-13, "the transpose of a wrong matrix is a transpose");
    linear.adjoint = 1.0 + 1e-9;
    let found = check(&setup, &linear, &design);
    assert!((0.9e-9..1.1e-9).contains(&found.dot_product_max()));
}

#[test]
fn far_designs_are_far_and_inside() {
    let setup = setup("tests/configurations/boom", |_| {});
    let all = designs(&setup, &setup, 4, 7, &Nobody).expect("are there");
    assert_eq!(all[0], setup.parameterisation().baseline());
    assert_eq!(all, designs(&setup, &setup, 4, 7, &Nobody).expect("are there"));
    for design in &all[1..] {
        for (value, v) in design.iter().zip(setup.parameterisation().variables()) {
            let reach = if *value > v.baseline { v.upper - v.baseline } else { v.baseline - v.lower };
            let way = (value - v.baseline).abs() / reach;
            assert!((0.5..=0.9).contains(&way));
        }
    }
}

#[test]
fn a_check_can_be_cancelled() {
    /// Cancels at the third poll.
    struct Impatient(AtomicUsize);
    impl Watch for Impatient {
        fn progress(&self, _: Phase, _: f64) {}
        fn cancelled(&self) -> bool {
            self.0.fetch_add(1, Ordering::Relaxed) >= 3
        }
    }
    let setup = setup("tests/configurations/boom", |_| {});
    let design = setup.parameterisation().baseline();
    let linear = Jacobian::new(&setup, &design);
    let watch = Impatient(AtomicUsize::new(0));
    let outcome =
        check_design(&setup, &Chain::new(&setup), &linear, &setup, &design, &CheckOptions::all(2), &watch);
    assert!(matches!(outcome, Err(CheckError::Deform(DeformError::Cancelled))));
}

/// At the baseline of the half model vertices lie on the crease between the panels of its wing, at y = 1.6 m, and move
/// across it.
#[test]
fn a_kink_is_named_and_hides_no_mistake() {
    let setup = setup("tests/configurations/half", |_| {});
    let design = setup.parameterisation().baseline();
    let mut linear = Jacobian::new(&setup, &design);
    let options =
        CheckOptions { variables: vec![0, 1], steps: vec![1e-3, 1e-4], ..CheckOptions::all(design.len()) };
    let check = |linear: &Jacobian| -> DesignCheck {
        let chain = Chain::new(&setup);
        check_design(&setup, &chain, linear, &setup, &design, &options, &Nobody).expect("is checked")
    };
    let right = check(&linear);
    assert!(right.central_difference_max() <= 1e-6, "{:e}", right.central_difference_max());
    for row in &right.variables {
        let (_, central) = row.best().expect("has meshes");
        assert!(central > 1e-5, "{central:e}");
        let kink = row.kink.as_ref().expect("there is one");
        assert!(kink.vertices.contains(&kink.worst) && kink.jump > 0.0 && kink.on_boundary);
        assert_eq!(kink.component, "wing");
        for &v in &kink.vertices {
            assert!((setup.positions()[v].y - 1.6).abs() < 1e-9, "vertex {v}");
        }
    }
    // A wrong derivative is accepted neither at the kink nor elsewhere.
    let kink = right.variables[0].kink.clone().expect("there is one");
    assert_eq!(kink.worst, WORST);
    linear.mistake = |stages| stages.vertices[WORST].x += 1e-3;
    assert!(check(&linear).variables[0].difference_error() > 1e-6);
    linear.mistake = |stages| stages.vertices[0].x += 1e-3;
    assert!(check(&linear).variables[0].difference_error() > 1e-6);
}
