use super::*;

fn flat(points: &ControlPoints) -> Vec<f64> {
    points.iter().flatten().flatten().copied().collect()
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn jvp_is_the_limit_of_central_differences() {
    let p = everything();
    for seed in 1..4 {
        let design = random_design(&p, seed);
        let linearisation = p.linearise(&design).expect("acceptable");
        for index in 0..design.len() {
            let mut direction = vec![0.0; design.len()];
            direction[index] = 1.0;
            let exact = flat(&linearisation.jvp(&[&direction]).expect("right length")[0]);
            let error = |h: f64| {
                let at = |step: f64| {
                    let mut moved = design.clone();
                    moved[index] += step;
                    flat(&p.control_points(&moved).expect("acceptable"))
                };
                let (plus, minus) = (at(h), at(-h));
                let differences = plus.iter().zip(&minus).map(|(a, b)| (a - b) / (2.0 * h));
                largest(differences.zip(&exact).map(|(d, e)| d - e)) / largest(exact.iter().copied())
            };
            let scale = p.variables()[index].baseline.abs().max(1.0);
            let best = [1e-3, 1e-4, 1e-5].map(|h| error(h * scale)).into_iter().fold(f64::INFINITY, f64::min);
            assert!(best < 1e-8, "{}: {best}", p.variables()[index].name);
        }
    }
}

#[test]
fn vjp_is_the_transpose_of_jvp() {
    let p = everything();
    for seed in 1..6 {
        let design = random_design(&p, seed);
        let linearisation = p.linearise(&design).expect("acceptable");
        let mut next = noise(seed + 100);
        let directions: Vec<Vec<f64>> = (0..3).map(|_| design.iter().map(|_| next()).collect()).collect();
        let seeds: Vec<ControlPoints> = (0..3)
            .map(|_| {
                let points = linearisation.control_points();
                points.iter().map(|c| c.iter().map(|_| [next(), next(), next()]).collect()).collect()
            })
            .collect();
        let tangents = linearisation.jvp(&directions).expect("right length");
        let gradients = linearisation.vjp(&seeds).expect("right length");
        for (v, jv) in directions.iter().zip(&tangents) {
            for (w, jtw) in seeds.iter().zip(&gradients) {
                let (w, jv) = (flat(w), flat(jv));
                let (left, right): (f64, f64) = (
                    w.iter().zip(&jv).map(|(a, b)| a * b).sum(),
                    v.iter().zip(jtw).map(|(a, b)| a * b).sum(),
                );
                let size: f64 = w.iter().zip(&jv).map(|(a, b)| (a * b).abs()).sum();
                assert!((left - right).abs() <= 1e-13 * size, "{left} {right}");
            }
        }
    }
}

#[test]
fn linearisation_carries_the_evaluated_points() {
    let p = everything();
    let design = random_design(&p, 7);
    let linearisation = p.linearise(&design).expect("acceptable");
    assert_eq!(linearisation.control_points(), p.control_points(&design).expect("acceptable"));
}

#[test]
fn vectors_of_the_wrong_length_are_refused() {
    let p = everything();
    let linearisation = p.linearise(&p.baseline()).expect("acceptable");
    let n = p.variables().len();
    let error = linearisation.jvp(&[vec![0.0; n], vec![0.0; n - 1]]).expect_err("too short");
    assert_eq!(error, DesignError::VectorLength { what: "direction 1".into(), expected: n, found: n - 1 });
    let error = linearisation.vjp(&[vec![vec![]]]).expect_err("a component is missing");
    assert_eq!(
        error,
        DesignError::VectorLength { what: "components of seed 0".into(), expected: 2, found: 1 }
    );
    let points = linearisation.control_points();
    let error = linearisation.vjp(&[vec![points[0].clone(), vec![]]]).expect_err("points are missing");
    let DesignError::VectorLength { what, found: 0, .. } = error else { panic!("{error}") };
    assert_eq!(what, "component 1 of seed 0");
}
