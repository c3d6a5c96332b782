//! Products with the derivative of an analysis: `J V` for blocks of directions, `J^T W` for blocks of seeds.
//!
//! Outputs depend on the doublet strengths mu, which solve `R(mu, surface) = 0`. So `d mu = -A^-1 dR` at fixed mu, and backwards a seed of mu
//! gives `-A^-T mu-bar` for R, which one pass over the pairs turns into seeds of the surface ([`crate::influence`]).

use std::sync::Arc;

use moldline_mesh::Vector3;

use crate::{
    Flow, Monitor, PanelError, Scalars, Solution, Stage,
    gradient::{Gradients, Slope},
    influence::{Influence, PairChange, Strengths},
    kutta::Kutta,
    pressure::Form,
    solution::{AnyState, State},
    surface::SurfaceChange,
    wind::{self, FlowChange, Totals, Wind},
};

/// Directions and seeds that are handled at once.
const BLOCK: usize = 16;

/// What has derivatives: values, changes in one direction, or seeds of one adjoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Coefficients of the whole.
    pub scalars: Scalars,
    /// Section loads in the order of [`Analysis::sections`](crate::Analysis::sections), m; in a seed none stands for zeros.
    pub sections: Vec<f64>,
    /// Pressure coefficient of every cell; in a seed none stands for zeros.
    pub cp: Vec<f64>,
}

/// What outputs are differentiated by: a change in one direction, or a gradient.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Vertices, m; in a direction none stands for zeros.
    pub vertices: Vec<[f64; 3]>,
    /// Angle of attack, rad.
    pub alpha: f64,
    /// Sideslip, rad.
    pub sideslip: f64,
    /// Mach number.
    pub mach: f64,
    /// Reference area, m^2.
    pub area: f64,
    /// Reference chord, m.
    pub chord: f64,
    /// Reference point, m.
    pub point: [f64; 3],
}

/// An analysis with its derivative. Applying it solves with the solution's factors.
#[derive(Clone, Debug)]
pub struct Linearisation {
    solution: Arc<Solution>,
    flow: Flow,
}

impl Solution {
    /// The derivative at an angle of attack.
    ///
    /// # Errors
    /// As [`analyse`](Self::analyse).
    pub fn linearise(self: &Arc<Self>, flow: &Flow) -> Result<Linearisation, PanelError> {
        self.check_flow(flow)?;
        Ok(Linearisation { solution: self.clone(), flow: *flow })
    }
}

impl Linearisation {
    /// The solution it belongs to.
    pub fn solution(&self) -> &Arc<Solution> {
        &self.solution
    }

    /// The flow it belongs to.
    pub fn flow(&self) -> &Flow {
        &self.flow
    }

    /// The changes of the outputs in several directions.
    ///
    /// # Errors
    /// [`PanelError::Length`] or [`PanelError::OutOfRange`] for directions of the wrong length or not finite; cancelled; not converged.
    pub fn jvp(
        &self,
        directions: &[Inputs],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Outputs>, PanelError> {
        self.check_directions(directions)?;
        let mut out = Vec::with_capacity(directions.len());
        for block in directions.chunks(BLOCK) {
            out.extend(match &self.solution.state {
                AnyState::Symmetric(state) => self.block_jvp(state, block, monitor)?,
                AnyState::Full(state) => self.block_jvp(state, block, monitor)?,
            });
        }
        Ok(out)
    }

    /// The gradients of several weighted sums of the outputs.
    ///
    /// # Errors
    /// As [`jvp`](Self::jvp), for seeds.
    pub fn vjp(&self, seeds: &[Outputs], monitor: &dyn Monitor<Stage>) -> Result<Vec<Inputs>, PanelError> {
        self.check_seeds(seeds)?;
        let mut out = Vec::with_capacity(seeds.len());
        for block in seeds.chunks(BLOCK) {
            out.extend(match &self.solution.state {
                AnyState::Symmetric(state) => self.block_vjp(state, block, monitor)?,
                AnyState::Full(state) => self.block_vjp(state, block, monitor)?,
            });
        }
        Ok(out)
    }

    fn check_directions(&self, directions: &[Inputs]) -> Result<(), PanelError> {
        let expected = self.solution.vertices.len();
        for (d, direction) in directions.iter().enumerate() {
            let got = direction.vertices.len();
            if got != 0 && got != expected {
                let field = format!("directions[{d}].vertices");
                return Err(PanelError::Length { field, got, expected });
            }
            for (v, vector) in direction.vertices.iter().enumerate() {
                for (axis, value) in vector.iter().enumerate() {
                    finite(*value, || format!("directions[{d}].vertices[{v}][{axis}]"))?;
                }
            }
            let flow = [
                ("alpha", direction.alpha),
                ("sideslip", direction.sideslip),
                ("mach", direction.mach),
                ("area", direction.area),
                ("chord", direction.chord),
                ("point[0]", direction.point[0]),
                ("point[1]", direction.point[1]),
                ("point[2]", direction.point[2]),
            ];
            for (name, value) in flow {
                finite(value, || format!("directions[{d}].{name}"))?;
            }
        }
        Ok(())
    }

    fn check_seeds(&self, seeds: &[Outputs]) -> Result<(), PanelError> {
        let setup = &self.solution.setup;
        for (s, seed) in seeds.iter().enumerate() {
            for (name, value) in Scalars::NAMES.iter().zip(seed.scalars.to_array()) {
                finite(value, || format!("seeds[{s}].{name}"))?;
            }
            let lists = [
                ("sections", &seed.sections, setup.wakes.strips.len()),
                ("cp", &seed.cp, setup.panels.panel_of.len()),
            ];
            for (name, list, expected) in lists {
                if !list.is_empty() && list.len() != expected {
                    let field = format!("seeds[{s}].{name}");
                    return Err(PanelError::Length { field, got: list.len(), expected });
                }
                for (i, value) in list.iter().enumerate() {
                    finite(*value, || format!("seeds[{s}].{name}[{i}]"))?;
                }
            }
        }
        Ok(())
    }

    fn block_jvp<const B: usize>(
        &self,
        state: &State<B>,
        directions: &[Inputs],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Outputs>, PanelError> {
        let setup = &*self.solution.setup;
        let (panels, surface) = (&setup.panels, &state.surface);
        let gradients = Gradients::new(panels, surface, &setup.stencils)?;
        let kutta = Kutta { surface, wakes: &setup.wakes, gradients: &gradients };
        let influence = Influence::<B>::new(panels, &setup.wakes, surface);
        let still = vec![0.0; panels.len()];
        let strips = setup.wakes.strips.len();

        // The change of the residual at fixed mu.
        let surfaces: Vec<SurfaceChange> = directions
            .iter()
            .map(|direction| {
                let points = if direction.vertices.is_empty() {
                    vec![Vector3::zeros(); surface.points.len()]
                } else {
                    panels.gather(&direction.vertices)
                };
                surface.jvp(panels, &points, self.solution.mach, direction.mach)
            })
            .collect();
        let changes: Vec<PairChange<'_, B>> = surfaces
            .iter()
            .map(|change| PairChange {
                points: &change.points,
                centres: &change.centres,
                sources: std::array::from_fn(|k| surface.sources_jvp(panels.axes()[k], change)),
                strips: std::array::from_fn(|k| {
                    (0..strips).map(|s| kutta.jvp(s, &state.mu[k], change, &still)).collect()
                }),
            })
            .collect();
        let residuals = influence.jvp(&state.strengths(), &changes, monitor)?;
        let right: Vec<Vec<f64>> =
            residuals.into_iter().flatten().map(|r| r.into_iter().map(|r| -r).collect()).collect();
        let mut d_mu =
            state.system.solve(&right, false, setup.options.tolerance, monitor)?.columns.into_iter();

        let mut out = Vec::with_capacity(directions.len());
        for (direction, change) in directions.iter().zip(&surfaces) {
            let d_mu: [Vec<f64>; B] = std::array::from_fn(|_| d_mu.next().unwrap_or_default());
            let d_circulations: [Vec<f64>; B] = std::array::from_fn(|k| {
                (0..strips).map(|s| kutta.jvp(s, &state.mu[k], change, &d_mu[k])).collect()
            });
            let slopes: [Vec<Slope>; B] = std::array::from_fn(|k| {
                let (values, changes) =
                    ([&state.mu[k][..], &state.circulations[k]], [&d_mu[k][..], &d_circulations[k]]);
                (0..panels.len()).map(|p| gradients.jvp(p, values, change, changes)).collect()
            });
            let forms = state.pressure.jvp(panels, surface, &slopes, change);
            let mut totals = Totals::zeros();
            state.pressure.totals_jvp(panels, surface, &forms, change, &mut totals);
            totals.lift = std::array::from_fn(|k| {
                let (values, changes) = (&state.circulations[k], &d_circulations[k]);
                setup.trace.lift_jvp(&surface.points, values, &change.points, changes)
            });
            let drag_changes = [(&change.points[..], &d_circulations)];
            totals.drag = setup.trace.drag_jvp(&surface.points, &state.circulations, &drag_changes)[0];
            out.push(self.outputs(state, direction, &totals, &d_circulations, &forms));
        }
        Ok(out)
    }

    /// From changes of the forms to changes of the outputs.
    fn outputs<const B: usize>(
        &self,
        state: &State<B>,
        direction: &Inputs,
        totals: &Totals<B>,
        circulations: &[Vec<f64>; B],
        forms: &[Form<B>],
    ) -> Outputs {
        let wind = Wind::<B>::new(&self.flow);
        let flow = FlowChange {
            alpha: direction.alpha,
            sideslip: direction.sideslip,
            area: direction.area,
            chord: direction.chord,
            point: direction.point.into(),
        };
        let dw: [f64; B] =
            std::array::from_fn(|k| wind.by_alpha[k] * flow.alpha + wind.by_sideslip[k] * flow.sideslip);
        let sections = (0..self.solution.setup.wakes.strips.len())
            .map(|s| {
                let of = |k: usize| wind.w[k] * circulations[k][s] + dw[k] * state.circulations[k][s];
                2.0 * (0..B).map(of).sum::<f64>()
            })
            .collect();
        let cp: Vec<f64> = forms
            .iter()
            .zip(&state.pressure.forms)
            .map(|(change, form)| {
                let mut sum = 0.0;
                for k in 0..B {
                    for l in 0..B {
                        sum += wind.w[k] * wind.w[l] * change[k][l] + 2.0 * wind.w[k] * dw[l] * form[k][l];
                    }
                }
                sum
            })
            .collect();
        let of_cell = |(panel, _): &(u32, bool)| cp[*panel as usize];
        Outputs {
            scalars: wind::jvp(&state.totals, &self.flow, totals, &flow),
            sections,
            cp: self.solution.setup.panels.panel_of.iter().map(of_cell).collect(),
        }
    }

    fn block_vjp<const B: usize>(
        &self,
        state: &State<B>,
        seeds: &[Outputs],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Inputs>, PanelError> {
        let setup = &*self.solution.setup;
        let (panels, surface) = (&setup.panels, &state.surface);
        let gradients = Gradients::new(panels, surface, &setup.stencils)?;
        let kutta = Kutta { surface, wakes: &setup.wakes, gradients: &gradients };
        let influence = Influence::<B>::new(panels, &setup.wakes, surface);

        // From the outputs to mu.
        let mut flows = Vec::with_capacity(seeds.len());
        let mut surfaces = Vec::with_capacity(seeds.len());
        let mut circulations: Vec<[Vec<f64>; B]> = Vec::with_capacity(seeds.len());
        let mut right = Vec::with_capacity(seeds.len() * B);
        for seed in seeds {
            let mut surface_seeds = SurfaceChange::zeros(surface);
            let mut of_strips: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; setup.wakes.strips.len()]);
            let mut of_mu: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; panels.len()]);
            let (totals, mut flow) = wind::vjp(&state.totals, &self.flow, &seed.scalars);
            let mut forms = self.direct_seeds(state, seed, &mut flow, &mut of_strips);
            state.pressure.totals_vjp(panels, surface, &totals, &mut forms, &mut surface_seeds);
            let slopes = state.pressure.vjp(panels, surface, &forms, &mut surface_seeds);
            let points = &mut surface_seeds.points;
            setup.trace.drag_vjp(&surface.points, &state.circulations, &totals.drag, points, &mut of_strips);
            for k in 0..B {
                let (of_strips, of_mu) = (&mut of_strips[k], &mut of_mu[k]);
                let values = [&state.mu[k][..], &state.circulations[k]];
                let points = &mut surface_seeds.points;
                setup.trace.lift_vjp(&surface.points, values[1], totals.lift[k], points, of_strips);
                for (panel, slope) in slopes[k].iter().enumerate() {
                    let of_values = [&mut of_mu[..], &mut of_strips[..]];
                    gradients.vjp(panel, values, slope, &mut surface_seeds, of_values);
                }
                for (row, seed) in state.rows.iter().zip(of_strips.iter()) {
                    row.iter().for_each(|(panel, factor)| of_mu[*panel as usize] += seed * factor);
                }
            }
            flows.push(flow);
            surfaces.push(surface_seeds);
            circulations.push(of_strips);
            right.extend(of_mu.map(|of_mu| of_mu.into_iter().map(|x| -x).collect::<Vec<f64>>()));
        }
        let mut psi = state.system.solve(&right, true, setup.options.tolerance, monitor)?.columns.into_iter();
        let psi: Vec<[Vec<f64>; B]> =
            seeds.iter().map(|_| std::array::from_fn(|_| psi.next().unwrap_or_default())).collect();

        // From the residual to the surface.
        let pairs = influence.vjp(&state.strengths(), &psi, monitor)?;
        let mut out = Vec::with_capacity(seeds.len());
        for (((flow, mut surface_seeds), of_strips), pairs) in
            flows.into_iter().zip(surfaces).zip(circulations).zip(pairs)
        {
            let add = |to: &mut [Vector3], from: &[Vector3]| {
                to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
            };
            add(&mut surface_seeds.points, &pairs.points);
            add(&mut surface_seeds.centres, &pairs.centres);
            let mut unused = vec![0.0; panels.len()];
            for k in 0..B {
                surface.sources_vjp(panels.axes()[k], &pairs.sources[k], &mut surface_seeds);
                for (strip, (direct, of_pairs)) in of_strips[k].iter().zip(&pairs.strips[k]).enumerate() {
                    kutta.vjp(strip, &state.mu[k], direct + of_pairs, &mut surface_seeds, &mut unused);
                }
            }
            let (points, mach) = surface.vjp(panels, surface_seeds, self.solution.mach);
            out.push(Inputs {
                vertices: panels.scatter(&points),
                alpha: flow.alpha,
                sideslip: flow.sideslip,
                mach,
                area: flow.area,
                chord: flow.chord,
                point: flow.point.into(),
            });
        }
        Ok(out)
    }

    /// Seeds of pressures and section loads: for the forms, the wind and the circulations.
    fn direct_seeds<const B: usize>(
        &self,
        state: &State<B>,
        seed: &Outputs,
        flow: &mut FlowChange,
        circulations: &mut [Vec<f64>; B],
    ) -> Vec<Form<B>> {
        let wind = Wind::<B>::new(&self.flow);
        let mut of_w = [0.0; B];
        for (strip, load) in seed.sections.iter().enumerate() {
            for k in 0..B {
                circulations[k][strip] += 2.0 * load * wind.w[k];
                of_w[k] += 2.0 * load * state.circulations[k][strip];
            }
        }
        let panels = &self.solution.setup.panels;
        let mut of_panels = vec![0.0; panels.len()];
        for ((panel, _), cp) in panels.panel_of.iter().zip(&seed.cp) {
            of_panels[*panel as usize] += cp;
        }
        let mut forms = vec![[[0.0; B]; B]; panels.len()];
        for ((out, form), cp) in forms.iter_mut().zip(&state.pressure.forms).zip(of_panels) {
            for k in 0..B {
                for l in 0..B {
                    out[k][l] = cp * wind.w[k] * wind.w[l];
                    of_w[k] += 2.0 * cp * wind.w[l] * form[k][l];
                }
            }
        }
        for k in 0..B {
            flow.alpha += of_w[k] * wind.by_alpha[k];
            flow.sideslip += of_w[k] * wind.by_sideslip[k];
        }
        forms
    }
}

impl<const B: usize> State<B> {
    pub(crate) fn strengths(&self) -> Strengths<'_, B> {
        Strengths {
            doublets: std::array::from_fn(|k| &self.mu[k][..]),
            circulations: std::array::from_fn(|k| &self.circulations[k][..]),
        }
    }
}

fn finite(value: f64, field: impl Fn() -> String) -> Result<(), PanelError> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(PanelError::OutOfRange { field: field(), value, low: f64::MIN, high: f64::MAX })
    }
}
