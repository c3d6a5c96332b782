//! The whole once more, written down plainly and evaluated in dual numbers: textbook formulas panel by panel, the triangles of
//! each quadrilateral with an arc tangent each, Gauss's elimination, no shared code.

use std::sync::Arc;

use moldline_mesh::{Cell, SurfaceMesh};
use moldline_panel::{Flow, Inputs, NoMonitor, Options, Outputs, PanelSetup, Scalars, Symmetry};
use moldline_testing::Random;
use num_dual::{Dual64, DualNum};

use crate::derivatives::{flow, wing};

type T = Dual64;
type V = [T; 3];

fn real(x: f64) -> T {
    T::from_re(x)
}

fn sub(a: V, b: V) -> V {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn add(a: V, b: V) -> V {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn scale(a: V, s: T) -> V {
    [a[0] * s, a[1] * s, a[2] * s]
}

fn dot(a: V, b: V) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn norm(a: V) -> T {
    dot(a, a).sqrt()
}

fn angle(a: V, b: V, c: V) -> T {
    let (ra, rb, rc) = (norm(a), norm(b), norm(c));
    let denominator = ra * rb * rc + dot(a, b) * rc + dot(a, c) * rb + dot(b, c) * ra;
    dot(a, cross(b, c)).atan2(denominator) * 2.0
}

/// Solid angle of the corners' polygon around `apex`, all relative to the point.
fn fan(apex: V, corners: &[V]) -> T {
    let n = corners.len();
    (0..n).map(|i| angle(apex, corners[i], corners[(i + 1) % n])).fold(real(0.0), |s, x| s + x)
}

fn centre(corners: &[V]) -> V {
    let sum = corners.iter().fold([real(0.0); 3], |s, c| add(s, *c));
    scale(sum, real(1.0 / corners.len() as f64))
}

fn area(c: &[V]) -> V {
    let d = c[c.len() - 1];
    scale(cross(sub(c[2], c[0]), sub(d, c[1])), real(0.5))
}

/// Lift (circulation and pressure), moment and Cp of a closed wing at Mach number and angle of attack, without symmetry.
fn evaluate(
    mesh: &SurfaceMesh,
    vertices: &[V],
    trailing: &[[u32; 2]],
    mach: T,
    alpha: T,
    flow: &Flow,
) -> (Vec<T>, Vec<T>) {
    let beta = (-mach * mach + 1.0).sqrt();
    let points: Vec<V> = vertices.iter().map(|v| [v[0] / beta, v[1], v[2]]).collect();
    let corners = |cell: &Cell| cell.vertices().iter().map(|v| points[*v as usize]).collect::<Vec<_>>();
    let cells: Vec<Vec<V>> = mesh.cells.iter().map(corners).collect();
    let n = cells.len();
    let centres: Vec<V> = cells.iter().map(|c| centre(c)).collect();
    let normals: Vec<V> = cells.iter().map(|c| area(c)).map(|a| scale(a, norm(a).recip())).collect();
    let onset = [alpha.cos() / beta, real(0.0), alpha.sin()];
    let neighbour = |cell: usize, [a, b]: [u32; 2]| {
        (0..n).find(|j| *j != cell && mesh.cells[*j].edges().any(|e| e == [b, a])).unwrap()
    };
    let is_trailing = |e: [u32; 2]| trailing.iter().any(|t| *t == e || [t[1], t[0]] == e);

    // Gradient of each cell as weights on potentials; and of the fit it comes from the ways u / |d| to neighbours and their weights.
    let (gradient, fits): (Vec<Vec<(usize, V)>>, Vec<_>) = (0..n)
        .map(|i| {
            let mut m = [[real(0.0); 3]; 3];
            let mut arms = Vec::new();
            let mut gather = |u: V| {
                for r in 0..3 {
                    for c in 0..3 {
                        m[r][c] += u[r] * u[c];
                    }
                }
            };
            gather(normals[i]);
            for e in mesh.cells[i].edges().filter(|e| !is_trailing(*e)) {
                let j = neighbour(i, e);
                let (p, q) = (points[e[0] as usize], points[e[1] as usize]);
                let along = scale(sub(q, p), norm(sub(q, p)).recip());
                let perpendicular = |v: V| sub(v, scale(along, dot(along, v)));
                let here = perpendicular(sub(p, centres[i]));
                let there = perpendicular(sub(centres[j], p));
                let d = add(
                    scale(along, dot(along, sub(centres[j], centres[i]))),
                    scale(here, (norm(here) + norm(there)) / norm(here)),
                );
                let u = scale(d, norm(d).recip());
                gather(u);
                arms.push((j, scale(u, norm(d).recip())));
            }
            let cofactors = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
            let determinant = dot(m[0], cofactors[0]);
            let mut weights = Vec::new();
            let mut own = [real(0.0); 3];
            let mut fit = Vec::new();
            for (j, r) in arms {
                let y: V = [0, 1, 2].map(|k| {
                    (cofactors[0][k] * r[0] + cofactors[1][k] * r[1] + cofactors[2][k] * r[2]) / determinant
                });
                let g = sub(y, scale(normals[i], dot(normals[i], y)));
                own = sub(own, g);
                weights.push((j, g));
                fit.push((j, r, y));
            }
            weights.push((i, own));
            (weights, fit)
        })
        .unzip();

    // Circulation of each trailing edge: upper cells run from the first vertex to the second.
    let circulation: Vec<Vec<(usize, T)>> = trailing
        .iter()
        .map(|&[a, b]| {
            let upper = (0..n).find(|j| mesh.cells[*j].edges().any(|e| e == [a, b])).unwrap();
            let lower = neighbour(upper, [a, b]);
            let middle = centre(&[points[a as usize], points[b as usize]]);
            let mut row = Vec::new();
            for (cell, sign) in [(upper, 1.0), (lower, -1.0)] {
                let way = sub(middle, centres[cell]);
                row.push((cell, real(sign)));
                row.extend(gradient[cell].iter().map(|(j, g)| (*j, dot(*g, way) * sign)));
            }
            row
        })
        .collect();

    let mut matrix = vec![vec![real(0.0); n + 1]; n];
    for i in 0..n {
        let p = centres[i];
        for j in 0..n {
            let local: Vec<V> = cells[j].iter().map(|c| sub(*c, p)).collect();
            let omega = if i == j {
                fan(normals[j], &local)
            } else if local.len() == 3 {
                angle(local[0], local[1], local[2])
            } else {
                angle(local[0], local[1], local[2]) + angle(local[0], local[2], local[3])
            };
            matrix[i][j] -= omega / (4.0 * std::f64::consts::PI);
            let sigma = -dot(onset, normals[j]);
            let mut potential = -dot(normals[j], sub(centres[j], p)) * if i == j { real(0.0) } else { omega };
            for k in 0..local.len() {
                let (a, b) = (local[k], local[(k + 1) % local.len()]);
                let d = sub(b, a);
                let length = norm(d);
                let (ra, rb) = (norm(a), norm(b));
                let q = ((ra + rb + length) / (ra + rb - length)).ln();
                potential += dot(normals[j], cross(a, d)) / length * q;
            }
            matrix[i][n] += sigma * potential / (4.0 * std::f64::consts::PI);
        }
        for (&[a, b], row) in trailing.iter().zip(&circulation) {
            // A strip of a thousand chords; its end changes nothing within rounding once taken to infinity.
            let (p_, q_) = (sub(points[b as usize], p), sub(points[a as usize], p));
            let x = [real(1.0), real(0.0), real(0.0)];
            let omega = {
                let (rp, rq) = (norm(p_), norm(q_));
                let denominator = rp * rq + dot(p_, q_) + p_[0] * rq + q_[0] * rp;
                dot(p_, cross(q_, x)).atan2(denominator) * 2.0
            };
            for (j, factor) in row {
                matrix[i][*j] -= omega * *factor / (4.0 * std::f64::consts::PI);
            }
        }
    }
    let mu = eliminate(matrix);

    let loads: Vec<T> =
        circulation.iter().map(|row| row.iter().fold(real(0.0), |s, (j, f)| s + *f * mu[*j]) * 2.0).collect();
    let lift = trailing
        .iter()
        .zip(&loads)
        .fold(real(0.0), |s, (&[a, b], load)| s + *load * (points[b as usize][1] - points[a as usize][1]));
    let mut cp = Vec::new();
    let (mut force, mut moment) = ([real(0.0); 3], real(0.0));
    for i in 0..n {
        let g = gradient[i].iter().fold([real(0.0); 3], |s, (j, g)| add(s, scale(*g, mu[*j])));
        let u = add(sub(onset, scale(normals[i], dot(onset, normals[i]))), g);
        let mut value = dot(onset, onset) - dot(u, u);
        let y = fits[i].iter().fold([real(0.0); 3], |s, (j, _, y)| add(s, scale(*y, mu[*j] - mu[i])));
        for &(j, way, _) in &fits[i] {
            // The rate along the way less the fitted one.
            let rest = ((mu[j] - mu[i]) * dot(way, way) - dot(way, y)) / norm(way);
            value -= rest * rest / 6.0;
        }
        let a = area(&cells[i]);
        let f = scale([a[0], a[1] * beta, a[2] * beta], -value);
        force = add(force, f);
        let c = [centres[i][0] * beta - flow.reference.point[0], centres[i][2] - flow.reference.point[2]];
        moment += c[1] * f[0] - c[0] * f[2];
        cp.push(value);
    }
    let s = flow.reference.area;
    let scalars = vec![
        lift / s,
        (force[2] * alpha.cos() - force[0] * alpha.sin()) / s,
        (force[0] * alpha.cos() + force[2] * alpha.sin()) / s,
        moment / (s * flow.reference.chord),
    ];
    (scalars, loads.into_iter().chain(cp).collect())
}

/// Gauss's elimination with pivots by value.
fn eliminate(mut m: Vec<Vec<T>>) -> Vec<T> {
    let n = m.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|i, j| m[*i][k].re.abs().total_cmp(&m[*j][k].re.abs())).unwrap();
        m.swap(k, pivot);
        for i in k + 1..n {
            let factor = m[i][k] / m[k][k];
            for j in k..=n {
                let x = m[k][j];
                m[i][j] -= factor * x;
            }
        }
    }
    let mut x = vec![real(0.0); n];
    for i in (0..n).rev() {
        let known = (i + 1..n).fold(real(0.0), |s: T, j| s + m[i][j] * x[j]);
        x[i] = (m[i][n] - known) / m[i][i];
    }
    x
}

#[test]
fn agrees_with_dual_numbers() {
    for triangles in [false, true] {
        let mesh = wing(false, triangles);
        let options = Options { symmetry: Symmetry::None, ..Options::default() };
        let setup = Arc::new(PanelSetup::new(&mesh, options).unwrap());
        let (mach, flow) = (0.4, flow(0.0));
        let solution = Arc::new(setup.solve(&mesh.vertices, mach, &NoMonitor).unwrap());
        let analysis = solution.analyse(&flow).unwrap();
        let mut random = Random::new(3);
        let direction = Inputs {
            vertices: random.vectors(mesh.vertices.len()),
            alpha: random.signed(),
            mach: random.signed(),
            ..Inputs::default()
        };
        let tangent: Outputs = solution
            .linearise(&flow)
            .unwrap()
            .jvp(std::slice::from_ref(&direction), &NoMonitor)
            .unwrap()
            .remove(0);

        let vertices: Vec<V> = mesh
            .vertices
            .iter()
            .zip(&direction.vertices)
            .map(|(v, d)| [0, 1, 2].map(|k| Dual64::new(v[k], d[k])))
            .collect();
        let trailing = setup.summary().trailing_edges;
        let mach = Dual64::new(mach, direction.mach);
        let alpha = Dual64::new(flow.alpha, direction.alpha);
        let (scalars, others) = evaluate(&mesh, &vertices, &trailing, mach, alpha, &flow);

        let pick = |s: &Scalars| [s.lift, s.pressure_lift, s.pressure_drag, s.moment];
        let values: Vec<f64> = pick(&analysis.scalars)
            .into_iter()
            .chain(analysis.sections.iter().map(|s| s.load))
            .chain(analysis.cp)
            .collect();
        let tangents: Vec<f64> =
            pick(&tangent.scalars).into_iter().chain(tangent.sections).chain(tangent.cp).collect();
        let size = tangents.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
        for (i, dual) in scalars.iter().chain(&others).enumerate() {
            assert!(
                (dual.re - values[i]).abs() < 1e-10 * values[i].abs().max(1.0),
                "value {i}: {} {}",
                dual.re,
                values[i]
            );
            let bound = if i < 4 { tangents[i].abs().max(0.1) } else { size };
            assert!((dual.eps - tangents[i]).abs() < 1e-10 * bound, "{i}: {} {}", dual.eps, tangents[i]);
        }
    }
}
