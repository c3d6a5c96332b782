//! Interpolation, evaluation and their transposes, through the public interface.

use moldline_rbf::{Block, Coefficients, Kernel, RadialBasis, RbfError, Vector3};
use moldline_testing::Random;

fn scattered(count: usize, seed: u64) -> Vec<Vector3> {
    let mut random = Random::new(seed);
    let mut point =
        || Vector3::new(random.between(0.0, 30.0), random.between(-5.0, 5.0), random.between(0.0, 4.0));
    (0..count).map(|_| point()).collect()
}

/// What a backward stable solution leaves: the rounding of the sums over weights that are much larger than the data,
/// here neighbours with opposite data, times a modest factor.
fn rounding(coefficients: &Coefficients) -> f64 {
    let sums =
        (0..coefficients.columns()).map(|c| coefficients.weights(c).iter().map(|w| w.abs()).sum::<f64>());
    100.0 * f64::EPSILON * (1.0 + sums.fold(0.0, f64::max))
}

fn block(vectors: &[Vector3]) -> Block {
    let mut block = Block::zeros(vectors.len(), 3);
    vectors.iter().enumerate().for_each(|(i, v)| block.row_mut(i).copy_from_slice(v.as_slice()));
    block
}

#[test]
fn interpolates_its_data() {
    for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
        let centres = scattered(203, 1);
        let data: Vec<Vector3> =
            centres.iter().map(|c| Vector3::new(c.x.sin(), c.y * c.z, (c.x * c.y).cos())).collect();
        let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
        let coefficients = basis.fit(&block(&data));
        let out = basis.evaluate(&coefficients, &centres);
        let bound = rounding(&coefficients);
        for (i, datum) in data.iter().enumerate() {
            let value = out.vector(i, 0);
            assert!((value - datum).norm() < bound, "{kernel:?}: {value} is not {datum} within {bound:e}");
        }
    }
}

#[test]
fn reproduces_affine_fields() {
    let affine = |x: &Vector3| Vector3::new(1.0 + 2.0 * x.x, x.y - 3.0 * x.z, 0.5 * x.x + x.y + x.z);
    for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
        let centres = scattered(50, 2);
        let data: Vec<Vector3> = centres.iter().map(affine).collect();
        let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
        let points = scattered(1000, 3);
        let out = basis.evaluate(&basis.fit(&block(&data)), &points);
        for (i, point) in points.iter().enumerate() {
            assert!((out.vector(i, 0) - affine(point)).norm() < 1e-10);
        }
    }
}

/// SciPy 1.17: `RBFInterpolator(c, d, kernel="multiquadric", epsilon=1/0.02, degree=1)`, 0.02 being c for these centres.
#[test]
fn multiquadric_agrees_with_scipy() {
    let centres = [
        [0.0, 0.0, 0.0],
        [10.0, 0.0, 0.0],
        [0.0, 4.0, 0.0],
        [0.0, 0.0, 3.0],
        [10.0, 4.0, 3.0],
        [5.0, 2.0, 1.0],
        [5.0, 2.05, 1.0],
        [2.0, 3.0, 2.5],
        [7.0, 1.0, 0.5],
    ]
    .map(Vector3::from);
    let data: Vec<Vector3> = (0..9)
        .map(|i| Vector3::new(f64::from(i).sin(), f64::from(2 * i).cos(), f64::from(i * i % 5)))
        .collect();
    let points = [[5.0, 2.01, 1.005], [3.0, 1.0, 2.0], [12.0, -1.0, 0.5]].map(Vector3::from);
    let expected = [
        [-0.8437161631113225, -0.545992727626138, 0.1714953055246908],
        [-0.1828866161836063, 0.0020732151699347, 1.9551067453418252],
        [0.40993477891222, -0.4014301668440798, -0.0932814998178346],
    ];
    let basis = RadialBasis::new(Kernel::Multiquadric, &centres, 0.0).unwrap();
    let out = basis.evaluate(&basis.fit(&block(&data)), &points);
    for (i, expected) in expected.into_iter().enumerate() {
        assert!((out.vector(i, 0) - Vector3::from(expected)).norm() < 1e-11, "{expected:?}");
    }
}

/// Close centres with opposite data, whose weights are up to 8e5: values and gradients computed with 80 digits (LU decomposition
/// of the saddle-point matrix in Python's `decimal`). All coordinates are binary fractions, nothing is rounded before.
#[test]
fn cubic_sums_that_cancel_keep_their_digits() {
    let corners =
        [(-4, -2, -1), (4, -2, -1), (-4, 2, -1), (-4, -2, 1), (4, 2, 1), (4, -2, 1), (-4, 2, 1), (4, 2, -1)];
    let mut centres: Vec<Vector3> =
        corners.map(|(x, y, z)| Vector3::new(f64::from(x), f64::from(y), f64::from(z))).to_vec();
    centres.extend(
        [
            [0.5, 0.25, 0.125],
            [0.515625, 0.25, 0.125],
            [-1.5, 1.0, -0.25],
            [-1.5, 1.015625, -0.25],
            [2.0, -1.0, 0.5],
            [2.0, -1.0, 0.515625],
        ]
        .map(Vector3::from),
    );
    let data = [
        0.0,
        0.841796875,
        0.9091796875,
        0.1416015625,
        -0.7568359375,
        -0.958984375,
        -0.279296875,
        0.6572265625,
        1.0,
        -1.0,
        1.0,
        -1.0,
        1.0,
        -1.0,
    ];
    let points = [[0.5, 0.25, 0.25], [-1.5, 1.0078125, -0.25], [3.0, 0.5, -0.5], [0.0; 3]].map(Vector3::from);
    let values = [-6.662619220663289, -0.0004831712851260907, -24.16930042995386, 77.64441307918997];
    let seeds = [1.0, -0.5, 2.0, 0.25];
    let gradient = [
        -0.04045955233460522,
        0.16168700023519553,
        0.0063328539318617235,
        -0.01675162627817605,
        0.11235443419214948,
        -0.03115630956806893,
        0.01119494208828839,
        0.6580898995826636,
        -59.5227778827112,
        61.173945449505936,
        9.575692365475271,
        -9.927366110647815,
        32.83963945978009,
        -32.250424923251586,
    ];
    let column = |values: &[f64], width: usize| {
        let mut block = Block::zeros(values.len(), width);
        values.iter().enumerate().for_each(|(i, x)| block.row_mut(i).fill(*x));
        block
    };
    let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
    for width in [1, 3, 12] {
        let out = basis.evaluate(&basis.fit(&column(&data, width)), &points);
        let back = basis.fit_vjp(&basis.evaluate_vjp(&points, &column(&seeds, width)));
        for (found, expected) in [(&out, &column(&values, width)), (&back, &column(&gradient, width))] {
            for (found, expected) in found.data().iter().zip(expected.data()) {
                assert!((found - expected).abs() <= 1e-15 * expected.abs().max(1.0), "{found} {expected}");
            }
        }
    }
}

#[test]
fn regularisation_trades_misfit_for_energy() {
    let centres = scattered(60, 5);
    let data: Vec<Vector3> = (0..60).map(|i| Vector3::repeat(if i % 2 == 0 { 1.0 } else { -1.0 })).collect();
    let misfit = |regularisation: f64| {
        let basis = RadialBasis::new(Kernel::Cubic, &centres, regularisation).unwrap();
        let out = basis.evaluate(&basis.fit(&block(&data)), &centres);
        (0..60).map(|i| (out.vector(i, 0) - data[i]).norm_squared()).sum::<f64>()
    };
    let misfits = [misfit(0.0), misfit(1e-3), misfit(1e-1)];
    assert!(misfits[0] < 1e-18 && misfits[0] < misfits[1] && misfits[1] < misfits[2], "{misfits:?}");
}

#[test]
fn refuses_planes_and_coincident_centres() {
    let planar: Vec<Vector3> = scattered(20, 6).iter().map(|c| Vector3::new(c.x, c.y, 1.0)).collect();
    assert_eq!(RadialBasis::new(Kernel::Cubic, &planar, 0.0).err(), Some(RbfError::Planar { centres: 20 }));
    let mut twice = scattered(20, 7);
    twice.push(twice[3]);
    for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
        let error = RadialBasis::new(kernel, &twice, 0.0).unwrap_err();
        assert_eq!(error, RbfError::Coincident { centre: 20, other: 3, distance: 0.0 });
        assert_eq!(error.to_string(), "centres 3 and 20 coincide: they are 0e0 m apart; remove one of them");
    }
}

#[test]
fn a_pivot_that_is_not_positive_is_reported_with_the_measured_distance() {
    let mut near = scattered(20, 7);
    // Distinct neighbours, whose pivots are rounding, positive or negative.
    near.extend_from_within(..);
    near[20..].iter_mut().for_each(|centre| centre.x += 1e-9);
    let error = RadialBasis::new(Kernel::Cubic, &near, 0.0).map(drop).unwrap_err();
    let RbfError::NotPositiveDefinite { centre, nearest, distance } = error else {
        panic!("{error:?}");
    };
    assert_eq!(centre, nearest + 20, "{error}");
    assert!((distance - 1e-9).abs() < 1e-14, "{error}");
    assert!(RadialBasis::new(Kernel::Cubic, &near, 1e-6).is_ok());
}

#[test]
fn bits_do_not_depend_on_threads() {
    let centres = scattered(300, 8);
    let points = scattered(3000, 9);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let basis = RadialBasis::new(Kernel::Cubic, &centres, 0.0).unwrap();
            let one = basis.evaluate(&basis.fit(&block(&centres)), &points);
            let many = basis.evaluate(&basis.fit(&columns(&centres, 40)), &points);
            let seeds = basis.fit_vjp(&basis.evaluate_vjp(&points, &many));
            (one, many, seeds)
        })
    };
    assert_eq!(run(1), run(2));
}

/// Every centre with so many different numbers.
fn columns(centres: &[Vector3], width: usize) -> Block {
    let mut block = Block::zeros(centres.len(), width);
    for (i, c) in centres.iter().enumerate() {
        block.row_mut(i).iter_mut().enumerate().for_each(|(k, x)| *x = (c.x + k as f64 * c.y).sin());
    }
    block
}

#[test]
fn columns_are_independent() {
    let (centres, points) = (scattered(600, 10), scattered(500, 11));
    for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
        let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
        let data = columns(&centres, 20);
        let coefficients = basis.fit(&data);
        let all = basis.evaluate(&coefficients, &points);
        let bound = rounding(&coefficients);
        for column in 0..20 {
            let mut single = Block::zeros(600, 1);
            (0..600).for_each(|i| single.row_mut(i)[0] = data.row(i)[column]);
            let one = basis.evaluate(&basis.fit(&single), &points);
            for i in 0..points.len() {
                assert!((one.row(i)[0] - all.row(i)[column]).abs() < bound);
            }
        }
    }
}

#[test]
fn transposes_agree() {
    let (centres, points) = (scattered(150, 12), scattered(400, 13));
    let dot = |a: &Block, b: &Block| -> f64 { a.data().iter().zip(b.data()).map(|(a, b)| a * b).sum() };
    for kernel in [Kernel::Multiquadric, Kernel::Cubic] {
        let basis = RadialBasis::new(kernel, &centres, 0.0).unwrap();
        for width in [1, 2, 3, 12, 45] {
            let (data, seeds) = (columns(&centres, width), columns(&points, width));
            let coefficients = basis.fit(&data);
            let forward = dot(&seeds, &basis.evaluate(&coefficients, &points));
            let backward = dot(&basis.fit_vjp(&basis.evaluate_vjp(&points, &seeds)), &data);
            let bound = 400.0 * width as f64 * rounding(&coefficients);
            assert!((forward - backward).abs() < bound, "{forward} {backward} {bound:e}");
        }
    }
}
