//! From forms in the onset flow to coefficients at one angle of attack, with exact slopes.
//!
//! Everything quadratic in the flow is a form over unit onset flows along the axes: `F(w) = sum_kl w_k w_l F_kl`, where w is the direction of the
//! wind. So a coefficient's slope is `sum_kl (w'_k w_l + w_k w'_l) F_kl`, exactly.

use moldline_mesh::Vector3;

use crate::Flow;

/// The wind's direction along the solved axes, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wind<const B: usize> {
    /// w.
    pub w: [f64; B],
    /// By alpha, and twice by alpha.
    pub by_alpha: [f64; B],
    pub by_alpha_2: [f64; B],
    /// By sideslip, and by alpha and sideslip.
    pub by_sideslip: [f64; B],
    pub by_both: [f64; B],
    /// Directions of the wind and of the lift.
    pub drag: Vector3,
    pub lift: Vector3,
    /// By alpha, and twice (the lift's).
    drag_by_alpha: Vector3,
    lift_by_alpha: Vector3,
    drag_by_sideslip: Vector3,
}

impl<const B: usize> Wind<B> {
    pub fn new(flow: &Flow) -> Self {
        let ((sa, ca), (sb, cb)) = (flow.alpha.sin_cos(), flow.sideslip.sin_cos());
        let pick = |v: Vector3| -> [f64; B] { std::array::from_fn(|k| if B == 2 { v[2 * k] } else { v[k] }) };
        let drag = Vector3::new(ca * cb, -sb, sa * cb);
        let drag_by_alpha = Vector3::new(-sa * cb, 0.0, ca * cb);
        let drag_by_sideslip = Vector3::new(-ca * sb, -cb, -sa * sb);
        Self {
            w: pick(drag),
            by_alpha: pick(drag_by_alpha),
            by_alpha_2: pick(Vector3::new(-ca * cb, 0.0, -sa * cb)),
            by_sideslip: pick(drag_by_sideslip),
            by_both: pick(Vector3::new(sa * sb, 0.0, -ca * sb)),
            drag,
            lift: Vector3::new(-sa, 0.0, ca),
            drag_by_alpha,
            lift_by_alpha: Vector3::new(-ca, 0.0, -sa),
            drag_by_sideslip,
        }
    }
}

/// Forms of the whole aircraft, divided by the dynamic pressure; half forms are doubled.
#[derive(Clone, Debug)]
pub(crate) struct Totals<const B: usize> {
    /// Force, m^2.
    pub force: [[Vector3; B]; B],
    /// Pitching moment about the origin, m^3.
    pub moment: [[f64; B]; B],
    /// `integral Gamma dy`, m^2.
    pub lift: [f64; B],
    /// Induced drag / rho, m^2.
    pub drag: [[f64; B]; B],
}

impl<const B: usize> Totals<B> {
    pub fn zeros() -> Self {
        Self {
            force: [[Vector3::zeros(); B]; B],
            moment: [[0.0; B]; B],
            lift: [0.0; B],
            drag: [[0.0; B]; B],
        }
    }
}

/// Scalars that have derivatives: their values, tangents or seeds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scalars {
    /// Lift coefficient from the circulation of the wakes.
    pub lift: f64,
    /// Induced drag coefficient from the Trefftz plane.
    pub induced_drag: f64,
    /// Lift coefficient from the pressure.
    pub pressure_lift: f64,
    /// Drag coefficient from the pressure.
    pub pressure_drag: f64,
    /// Pitching moment coefficient, nose up positive, from the pressure.
    pub moment: f64,
    /// Derivative of `lift` with respect to the angle of attack, 1/rad.
    pub lift_slope: f64,
    /// Derivative of `moment` with respect to the angle of attack, 1/rad.
    pub moment_slope: f64,
    /// Derivative of `pressure_lift` with respect to the angle of attack, 1/rad.
    pub pressure_lift_slope: f64,
    /// x of the neutral point, m: where the moment's slope vanishes.
    pub neutral_point: f64,
}

impl Scalars {
    /// Number of scalars.
    pub const COUNT: usize = 9;

    /// Their names, in the order of [`to_array`](Self::to_array).
    pub const NAMES: [&'static str; Self::COUNT] = [
        "lift",
        "induced_drag",
        "pressure_lift",
        "pressure_drag",
        "moment",
        "lift_slope",
        "moment_slope",
        "pressure_lift_slope",
        "neutral_point",
    ];

    /// In the order of [`NAMES`](Self::NAMES).
    pub fn to_array(&self) -> [f64; Self::COUNT] {
        [
            self.lift,
            self.induced_drag,
            self.pressure_lift,
            self.pressure_drag,
            self.moment,
            self.lift_slope,
            self.moment_slope,
            self.pressure_lift_slope,
            self.neutral_point,
        ]
    }

    /// From the order of [`NAMES`](Self::NAMES).
    pub fn from_array(values: [f64; Self::COUNT]) -> Self {
        let [
            lift,
            induced_drag,
            pressure_lift,
            pressure_drag,
            moment,
            lift_slope,
            moment_slope,
            pressure_lift_slope,
            neutral_point,
        ] = values;
        Self {
            lift,
            induced_drag,
            pressure_lift,
            pressure_drag,
            moment,
            lift_slope,
            moment_slope,
            pressure_lift_slope,
            neutral_point,
        }
    }
}

/// Derivatives of one scalar by what it is made of.
struct Part<const B: usize> {
    totals: Totals<B>,
    alpha: f64,
    sideslip: f64,
    area: f64,
    chord: f64,
    point: Vector3,
}

/// Changes or seeds of flow and reference values.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FlowChange {
    pub alpha: f64,
    pub sideslip: f64,
    pub area: f64,
    pub chord: f64,
    pub point: Vector3,
}

fn form<const B: usize>(f: &[[f64; B]; B], a: &[f64; B], b: &[f64; B]) -> f64 {
    let mut sum = 0.0;
    for k in 0..B {
        for l in 0..B {
            sum += 0.5 * (a[k] * b[l] + b[k] * a[l]) * f[k][l];
        }
    }
    sum
}

fn force<const B: usize>(f: &[[Vector3; B]; B], a: &[f64; B], b: &[f64; B]) -> Vector3 {
    let mut sum = Vector3::zeros();
    for k in 0..B {
        for l in 0..B {
            sum += f[k][l] * (0.5 * (a[k] * b[l] + b[k] * a[l]));
        }
    }
    sum
}

/// The coefficients.
pub(crate) fn eval<const B: usize>(totals: &Totals<B>, flow: &Flow) -> Scalars {
    let wind = Wind::<B>::new(flow);
    let reference = &flow.reference;
    let (w, dw) = (&wind.w, &wind.by_alpha);
    let by_area = 1.0 / reference.area;
    let f = force(&totals.force, w, w);
    let df = 2.0 * force(&totals.force, w, dw);
    let about = |moment: f64, f: &Vector3| moment - reference.point[2] * f.x + reference.point[0] * f.z;
    let by_volume = by_area / reference.chord;
    let moment_slope = by_volume * about(2.0 * form(&totals.moment, w, dw), &df);
    let pressure_lift_slope = by_area * (df.dot(&wind.lift) + f.dot(&wind.lift_by_alpha));
    let lift = |w: &[f64; B]| 2.0 * by_area * totals.lift.iter().zip(w).map(|(l, w)| l * w).sum::<f64>();
    Scalars {
        lift: lift(w),
        induced_drag: 2.0 * by_area * form(&totals.drag, w, w),
        pressure_lift: by_area * f.dot(&wind.lift),
        pressure_drag: by_area * f.dot(&wind.drag),
        moment: by_volume * about(form(&totals.moment, w, w), &f),
        lift_slope: lift(dw),
        moment_slope,
        pressure_lift_slope,
        neutral_point: reference.point[0] - reference.chord * moment_slope / pressure_lift_slope,
    }
}

/// Gradient of the scalars' weighted sum.
fn gradient<const B: usize>(totals: &Totals<B>, flow: &Flow, seeds: &Scalars) -> Part<B> {
    let wind = Wind::<B>::new(flow);
    let reference = &flow.reference;
    let values = eval(totals, flow);
    let (w, dw, ddw) = (&wind.w, &wind.by_alpha, &wind.by_alpha_2);
    let (ws, dws) = (&wind.by_sideslip, &wind.by_both);
    let (by_area, chord) = (1.0 / reference.area, reference.chord);
    let by_volume = by_area / chord;
    let [x0, _, z0] = reference.point;

    // The neutral point through both slopes.
    let mut s = *seeds;
    let (a, b) = (values.moment_slope, values.pressure_lift_slope);
    if seeds.neutral_point != 0.0 {
        s.moment_slope -= chord / b * seeds.neutral_point;
        s.pressure_lift_slope += chord * a / (b * b) * seeds.neutral_point;
    }
    let mut part = Part {
        totals: Totals::zeros(),
        alpha: 0.0,
        sideslip: 0.0,
        area: 0.0,
        chord: 0.0,
        point: Vector3::zeros(),
    };
    part.point.x += seeds.neutral_point;
    if seeds.neutral_point != 0.0 {
        part.chord -= a / b * seeds.neutral_point;
    }

    let f = force(&totals.force, w, w);
    let df = 2.0 * force(&totals.force, w, dw);
    let ddf = 2.0 * (force(&totals.force, dw, dw) + force(&totals.force, w, ddw));
    let fs = 2.0 * force(&totals.force, w, ws);
    let dfs = 2.0 * (force(&totals.force, ws, dw) + force(&totals.force, w, dws));
    // Of f: the vectors that it is multiplied with; of df likewise.
    let moment_arm = Vector3::new(-z0, 0.0, x0);
    let of_f = by_area
        * (s.pressure_lift * wind.lift + s.pressure_drag * wind.drag + s.pressure_lift_slope * wind.lift_by_alpha)
        + by_volume * s.moment * moment_arm;
    let of_df = by_area * s.pressure_lift_slope * wind.lift + by_volume * s.moment_slope * moment_arm;
    for k in 0..B {
        for l in 0..B {
            let (plain, slope) = (w[k] * w[l], dw[k] * w[l] + w[k] * dw[l]);
            part.totals.force[k][l] = of_f * plain + of_df * slope;
            part.totals.moment[k][l] = by_volume * (s.moment * plain + s.moment_slope * slope);
            part.totals.drag[k][l] = 2.0 * by_area * s.induced_drag * plain;
        }
        part.totals.lift[k] = 2.0 * by_area * (s.lift * w[k] + s.lift_slope * dw[k]);
        part.alpha += 2.0 * by_area * totals.lift[k] * (s.lift * dw[k] + s.lift_slope * ddw[k]);
        part.sideslip += 2.0 * by_area * totals.lift[k] * (s.lift * ws[k] + s.lift_slope * dws[k]);
    }
    let m = |a: &[f64; B], b: &[f64; B]| 2.0 * form(&totals.moment, a, b);
    part.alpha += of_f.dot(&df)
        + of_df.dot(&ddf)
        + by_volume * (s.moment * m(w, dw) + s.moment_slope * (m(dw, dw) + m(w, ddw)))
        + 4.0 * by_area * s.induced_drag * form(&totals.drag, w, dw)
        + by_area
            * f.dot(
                &(s.pressure_lift * wind.lift_by_alpha + s.pressure_drag * wind.drag_by_alpha
                    - s.pressure_lift_slope * wind.lift),
            )
        + by_area * s.pressure_lift_slope * df.dot(&wind.lift_by_alpha);
    part.sideslip += of_f.dot(&fs)
        + of_df.dot(&dfs)
        + by_volume * (s.moment * m(w, ws) + s.moment_slope * (m(ws, dw) + m(w, dws)))
        + 4.0 * by_area * s.induced_drag * form(&totals.drag, w, ws)
        + by_area * s.pressure_drag * f.dot(&wind.drag_by_sideslip);
    part.area = -by_area
        * (s.lift * values.lift
            + s.induced_drag * values.induced_drag
            + s.pressure_lift * values.pressure_lift
            + s.pressure_drag * values.pressure_drag
            + s.moment * values.moment
            + s.lift_slope * values.lift_slope
            + s.moment_slope * values.moment_slope
            + s.pressure_lift_slope * values.pressure_lift_slope);
    part.chord -= (s.moment * values.moment + s.moment_slope * values.moment_slope) / chord;
    part.point.x += by_volume * (s.moment * f.z + s.moment_slope * df.z);
    part.point.z -= by_volume * (s.moment * f.x + s.moment_slope * df.x);
    part
}

/// The change of the coefficients.
pub(crate) fn jvp<const B: usize>(
    totals: &Totals<B>,
    flow: &Flow,
    change: &Totals<B>,
    flow_change: &FlowChange,
) -> Scalars {
    // Few numbers: scalar after scalar by its gradient.
    let component = |index: usize| {
        let mut seed = [0.0; Scalars::COUNT];
        seed[index] = 1.0;
        let part = gradient(totals, flow, &Scalars::from_array(seed));
        let mut sum = part.alpha * flow_change.alpha
            + part.sideslip * flow_change.sideslip
            + part.area * flow_change.area
            + part.chord * flow_change.chord
            + part.point.dot(&flow_change.point);
        for k in 0..B {
            sum += part.totals.lift[k] * change.lift[k];
            for l in 0..B {
                sum += part.totals.force[k][l].dot(&change.force[k][l])
                    + part.totals.moment[k][l] * change.moment[k][l]
                    + part.totals.drag[k][l] * change.drag[k][l];
            }
        }
        sum
    };
    Scalars::from_array(std::array::from_fn(component))
}

/// The transpose of [`jvp`].
pub(crate) fn vjp<const B: usize>(
    totals: &Totals<B>,
    flow: &Flow,
    seeds: &Scalars,
) -> (Totals<B>, FlowChange) {
    let part = gradient(totals, flow, seeds);
    let change = FlowChange {
        alpha: part.alpha,
        sideslip: part.sideslip,
        area: part.area,
        chord: part.chord,
        point: part.point,
    };
    (part.totals, change)
}
