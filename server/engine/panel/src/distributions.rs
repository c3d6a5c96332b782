//! Section loads and pressure coefficients at one angle of attack, and their derivative.
//!
//! With w the wind's direction, `load = sum_k w_k (Gamma_a,k + Gamma_b,k)` for a strip from a to b, `Cp = sum_kl w_k w_l C_kl` for a panel.

use crate::{flow::FlowChange, pressure::Form, wind::Wind};

/// Values, changes or seeds.
pub(crate) struct Distributions {
    /// Load of every strip, m.
    pub loads: Vec<f64>,
    /// Pressure coefficient of every panel.
    pub cp: Vec<f64>,
}

/// `sum_kl w_k w_l F_kl`.
pub(crate) fn form<const B: usize>(f: &Form<B>, w: &[f64; B]) -> f64 {
    (0..B).map(|k| (0..B).map(|l| w[k] * w[l] * f[k][l]).sum::<f64>()).sum()
}

/// The sum of the circulations at both ends of a strip.
fn both(circulations: &[f64], strip: usize) -> f64 {
    circulations[2 * strip] + circulations[2 * strip + 1]
}

/// The distributions.
pub(crate) fn eval<const B: usize>(
    circulations: &[Vec<f64>; B],
    forms: &[Form<B>],
    wind: &Wind<B>,
) -> Distributions {
    let load = |s: usize| (0..B).map(|k| wind.w[k] * both(&circulations[k], s)).sum::<f64>();
    Distributions {
        loads: (0..circulations[0].len() / 2).map(load).collect(),
        cp: forms.iter().map(|f| form(f, &wind.w)).collect(),
    }
}

/// Their change with circulations, forms and wind.
pub(crate) fn jvp<const B: usize>(
    (circulations, forms): (&[Vec<f64>; B], &[Form<B>]),
    wind: &Wind<B>,
    (d_circulations, d_forms): (&[Vec<f64>; B], &[Form<B>]),
    change: &FlowChange,
) -> Distributions {
    let (w, dw) = (&wind.w, wind.jvp(change));
    let load = |s: usize| {
        let of = |k: usize| w[k] * both(&d_circulations[k], s) + dw[k] * both(&circulations[k], s);
        (0..B).map(of).sum::<f64>()
    };
    let cp = |(change, form): (&Form<B>, &Form<B>)| {
        let mut sum = 0.0;
        for k in 0..B {
            for l in 0..B {
                sum += w[k] * w[l] * change[k][l] + 2.0 * w[k] * dw[l] * form[k][l];
            }
        }
        sum
    };
    Distributions {
        loads: (0..circulations[0].len() / 2).map(load).collect(),
        cp: d_forms.iter().zip(forms).map(cp).collect(),
    }
}

/// The transpose of [`jvp`]: seeds of circulations and forms, and those of the flow added. No loads stand for zeros.
pub(crate) fn vjp<const B: usize>(
    (circulations, forms): (&[Vec<f64>; B], &[Form<B>]),
    wind: &Wind<B>,
    seeds: &Distributions,
    flow_seeds: &mut FlowChange,
) -> ([Vec<f64>; B], Vec<Form<B>>) {
    let w = &wind.w;
    let mut of_w = [0.0; B];
    let mut of_circulations: [Vec<f64>; B] = std::array::from_fn(|k| vec![0.0; circulations[k].len()]);
    for (strip, load) in seeds.loads.iter().enumerate() {
        for k in 0..B {
            (0..2).for_each(|end| of_circulations[k][2 * strip + end] += load * w[k]);
            of_w[k] += load * both(&circulations[k], strip);
        }
    }
    let mut of_forms = vec![[[0.0; B]; B]; forms.len()];
    for ((out, form), cp) in of_forms.iter_mut().zip(forms).zip(&seeds.cp) {
        for k in 0..B {
            for l in 0..B {
                out[k][l] = cp * w[k] * w[l];
                of_w[k] += 2.0 * cp * w[l] * form[k][l];
            }
        }
    }
    wind.vjp(&of_w, flow_seeds);
    (of_circulations, of_forms)
}
