//! Coefficients at one angle of attack from forms in the onset flow, with exact slopes.
//!
//! Everything quadratic in the flow is a form over unit onset flows along the axes: `F(w) = sum_kl w_k w_l F_kl`, where w is the direction of the
//! wind. So a coefficient's slope is `sum_kl (w'_k w_l + w_k w'_l) F_kl`, exactly. With the force f and its slope f', both over dynamic pressure,
//!
//! ```text
//! C_L = 2 lift.w / S                      its slope 2 lift.w' / S
//! C_Di = 2 D(w, w) / S
//! pressure lift = f.l / S                 its slope (f'.l + f.l') / S        l: the direction of the lift
//! pressure drag = f.w / S
//! C_m = (M(w, w) - z_0 f_x + x_0 f_z) / (S c)      its slope m' likewise from M(w, w')
//! neutral point = x_0 - c m' / (pressure lift)'
//! ```

use moldline_mesh::Vector3;

use crate::{Flow, flow::FlowChange, wind::Wind};

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
        Self { force: [[Vector3::zeros(); B]; B], moment: [[0.0; B]; B], lift: [0.0; B], drag: [[0.0; B]; B] }
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

/// The symmetric form of two directions.
fn form<const B: usize>(f: &[[f64; B]; B], a: &[f64; B], b: &[f64; B]) -> f64 {
    let mut sum = 0.0;
    for k in 0..B {
        for l in 0..B {
            sum += 0.5 * (a[k] * b[l] + b[k] * a[l]) * f[k][l];
        }
    }
    sum
}

/// The same for a vector.
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

/// The gradient of a weighted sum of the coefficients: the weights are `seeds`.
pub(crate) fn vjp<const B: usize>(
    totals: &Totals<B>,
    flow: &Flow,
    seeds: &Scalars,
) -> (Totals<B>, FlowChange) {
    let adjoint = Adjoint::new(totals, flow, seeds);
    let change = FlowChange {
        alpha: adjoint.by_alpha(),
        sideslip: adjoint.by_sideslip(),
        area: adjoint.by_area(),
        chord: adjoint.by_chord(seeds),
        point: adjoint.by_point(seeds),
    };
    (adjoint.by_totals(), change)
}

/// The quantities that the parts of a gradient share.
struct Adjoint<'a, const B: usize> {
    totals: &'a Totals<B>,
    wind: Wind<B>,
    values: Scalars,
    /// Seeds, with that of the neutral point passed on to the slopes of moment and pressure lift.
    s: Scalars,
    /// `1 / S`, c, `1 / (S c)`.
    by_area: f64,
    chord: f64,
    by_volume: f64,
    /// The force and its slope.
    f: Vector3,
    df: Vector3,
    /// Seeds of both: the vectors that they are multiplied with.
    of_f: Vector3,
    of_df: Vector3,
}

impl<'a, const B: usize> Adjoint<'a, B> {
    fn new(totals: &'a Totals<B>, flow: &Flow, seeds: &Scalars) -> Self {
        let wind = Wind::<B>::new(flow);
        let reference = &flow.reference;
        let values = eval(totals, flow);
        let (by_area, chord) = (1.0 / reference.area, reference.chord);
        let by_volume = by_area / chord;
        let mut s = *seeds;
        let (a, b) = (values.moment_slope, values.pressure_lift_slope);
        if seeds.neutral_point != 0.0 {
            s.moment_slope -= chord / b * seeds.neutral_point;
            s.pressure_lift_slope += chord * a / (b * b) * seeds.neutral_point;
        }
        let [x0, _, z0] = reference.point;
        let moment_arm = Vector3::new(-z0, 0.0, x0);
        let of_f = by_area
            * (s.pressure_lift * wind.lift
                + s.pressure_drag * wind.drag
                + s.pressure_lift_slope * wind.lift_by_alpha)
            + by_volume * s.moment * moment_arm;
        let of_df = by_area * s.pressure_lift_slope * wind.lift + by_volume * s.moment_slope * moment_arm;
        let f = force(&totals.force, &wind.w, &wind.w);
        let df = 2.0 * force(&totals.force, &wind.w, &wind.by_alpha);
        Self { totals, wind, values, s, by_area, chord, by_volume, f, df, of_f, of_df }
    }

    fn by_totals(&self) -> Totals<B> {
        let Self { s, by_area, by_volume, .. } = self;
        let (w, dw) = (&self.wind.w, &self.wind.by_alpha);
        let mut out = Totals::zeros();
        for k in 0..B {
            for l in 0..B {
                let (plain, slope) = (w[k] * w[l], dw[k] * w[l] + w[k] * dw[l]);
                out.force[k][l] = self.of_f * plain + self.of_df * slope;
                out.moment[k][l] = by_volume * (s.moment * plain + s.moment_slope * slope);
                out.drag[k][l] = 2.0 * by_area * s.induced_drag * plain;
            }
            out.lift[k] = 2.0 * by_area * (s.lift * w[k] + s.lift_slope * dw[k]);
        }
        out
    }

    fn by_alpha(&self) -> f64 {
        let Self { totals, wind, s, by_area, by_volume, .. } = self;
        let (w, dw, ddw) = (&wind.w, &wind.by_alpha, &wind.by_alpha_2);
        let ddf = 2.0 * (force(&totals.force, dw, dw) + force(&totals.force, w, ddw));
        let m = |a: &[f64; B], b: &[f64; B]| 2.0 * form(&totals.moment, a, b);
        let mut sum = 0.0;
        for k in 0..B {
            sum += 2.0 * by_area * totals.lift[k] * (s.lift * dw[k] + s.lift_slope * ddw[k]);
        }
        sum += self.of_f.dot(&self.df)
            + self.of_df.dot(&ddf)
            + by_volume * (s.moment * m(w, dw) + s.moment_slope * (m(dw, dw) + m(w, ddw)))
            + 4.0 * by_area * s.induced_drag * form(&totals.drag, w, dw)
            + by_area
                * self.f.dot(
                    &(s.pressure_lift * wind.lift_by_alpha + s.pressure_drag * wind.drag_by_alpha
                        - s.pressure_lift_slope * wind.lift),
                )
            + by_area * s.pressure_lift_slope * self.df.dot(&wind.lift_by_alpha);
        sum
    }

    fn by_sideslip(&self) -> f64 {
        let Self { totals, wind, s, by_area, by_volume, .. } = self;
        let (w, dw) = (&wind.w, &wind.by_alpha);
        let (ws, dws) = (&wind.by_sideslip, &wind.by_both);
        let fs = 2.0 * force(&totals.force, w, ws);
        let dfs = 2.0 * (force(&totals.force, ws, dw) + force(&totals.force, w, dws));
        let m = |a: &[f64; B], b: &[f64; B]| 2.0 * form(&totals.moment, a, b);
        let mut sum = 0.0;
        for k in 0..B {
            sum += 2.0 * by_area * totals.lift[k] * (s.lift * ws[k] + s.lift_slope * dws[k]);
        }
        sum += self.of_f.dot(&fs)
            + self.of_df.dot(&dfs)
            + by_volume * (s.moment * m(w, ws) + s.moment_slope * (m(ws, dw) + m(w, dws)))
            + 4.0 * by_area * s.induced_drag * form(&totals.drag, w, ws)
            + by_area * s.pressure_drag * self.f.dot(&wind.drag_by_sideslip);
        sum
    }

    fn by_area(&self) -> f64 {
        let Self { values, s, .. } = self;
        -self.by_area
            * (s.lift * values.lift
                + s.induced_drag * values.induced_drag
                + s.pressure_lift * values.pressure_lift
                + s.pressure_drag * values.pressure_drag
                + s.moment * values.moment
                + s.lift_slope * values.lift_slope
                + s.moment_slope * values.moment_slope
                + s.pressure_lift_slope * values.pressure_lift_slope)
    }

    fn by_chord(&self, seeds: &Scalars) -> f64 {
        let Self { values, s, .. } = self;
        let mut sum = 0.0;
        if seeds.neutral_point != 0.0 {
            sum -= values.moment_slope / values.pressure_lift_slope * seeds.neutral_point;
        }
        sum -= (s.moment * values.moment + s.moment_slope * values.moment_slope) / self.chord;
        sum
    }

    fn by_point(&self, seeds: &Scalars) -> [f64; 3] {
        let Self { s, f, df, .. } = self;
        [
            seeds.neutral_point + self.by_volume * (s.moment * f.z + s.moment_slope * df.z),
            0.0,
            0.0 - self.by_volume * (s.moment * f.x + s.moment_slope * df.x),
        ]
    }
}

/// The change of the coefficients: there are few, so one after the other by its gradient.
pub(crate) fn jvp<const B: usize>(
    totals: &Totals<B>,
    flow: &Flow,
    change: &Totals<B>,
    flow_change: &FlowChange,
) -> Scalars {
    let component = |index: usize| {
        let mut seed = [0.0; Scalars::COUNT];
        seed[index] = 1.0;
        let (by_totals, by_flow) = vjp(totals, flow, &Scalars::from_array(seed));
        let mut sum = by_flow.alpha * flow_change.alpha
            + by_flow.sideslip * flow_change.sideslip
            + by_flow.area * flow_change.area
            + by_flow.chord * flow_change.chord
            + Vector3::from(by_flow.point).dot(&Vector3::from(flow_change.point));
        for k in 0..B {
            sum += by_totals.lift[k] * change.lift[k];
            for l in 0..B {
                sum += by_totals.force[k][l].dot(&change.force[k][l])
                    + by_totals.moment[k][l] * change.moment[k][l]
                    + by_totals.drag[k][l] * change.drag[k][l];
            }
        }
        sum
    };
    Scalars::from_array(std::array::from_fn(component))
}
