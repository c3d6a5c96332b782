//! Products with the derivative of an analysis: `J V` for blocks of directions, `J^T W` for blocks of seeds.
//!
//! A block goes through the flow for unit winds ([`crate::state`]) together, and one by one through what depends on the angle of attack.

use std::sync::Arc;

use moldline_mesh::Vector3;

use crate::{
    Flow, Monitor, PanelError, Scalars, Solution, Stage,
    bounds::{finite, results},
    coefficients,
    distributions::{self, Distributions},
    flow::FlowChange,
    solution::AnyState,
    state::{Motion, State, StateChange},
    wind::Wind,
};

/// Directions and seeds that are handled at once.
const BLOCK: usize = 16;

/// The quantities that have derivatives: values, changes in one direction, or seeds of one adjoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outputs {
    /// Coefficients of the whole.
    pub scalars: Scalars,
    /// Section loads in the order of [`Analysis::sections`](crate::Analysis::sections), m; an empty list in a seed stands for zeros.
    pub sections: Vec<f64>,
    /// Pressure coefficient of every cell; an empty list in a seed stands for zeros.
    pub cp: Vec<f64>,
}

/// The quantities with respect to which outputs are differentiated: a change in one direction, or a gradient.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Vertices, m; an empty list in a direction stands for zeros.
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

impl Outputs {
    fn check(&self) -> Result<(), PanelError> {
        results("coefficients", self.scalars.to_array())?;
        results("section_loads", self.sections.iter().copied())?;
        results("cp", self.cp.iter().copied())
    }
}

impl Inputs {
    fn check(&self) -> Result<(), PanelError> {
        results("vertices", self.vertices.as_flattened().iter().copied())?;
        results("the flow's part", [self.alpha, self.sideslip, self.mach, self.area, self.chord])?;
        results("point", self.point)
    }
}

/// The derivative of an analysis. Products solve with the solution's factors.
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
    /// The solution that is differentiated.
    pub fn solution(&self) -> &Arc<Solution> {
        &self.solution
    }

    /// The flow at which it is differentiated.
    pub fn flow(&self) -> &Flow {
        &self.flow
    }

    /// The changes of the outputs in several directions.
    ///
    /// # Errors
    /// [`PanelError::Length`] or [`PanelError::OutOfRange`] for directions of the wrong length or not finite; cancelled; not
    /// converged; [`PanelError::Overflow`].
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
        out.iter().try_for_each(Outputs::check)?;
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
        out.iter().try_for_each(Inputs::check)?;
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
        let motion = |direction: &Inputs| Motion {
            points: if direction.vertices.is_empty() {
                vec![Vector3::zeros(); state.surface.points.len()]
            } else {
                setup.panels.gather(&direction.vertices)
            },
            mach: direction.mach,
        };
        let motions: Vec<Motion> = directions.iter().map(motion).collect();
        let changes = state.jvp(setup, &motions, monitor)?;
        Ok(directions.iter().zip(changes).map(|(d, change)| self.outputs(state, d, &change)).collect())
    }

    /// From changes of the flow for unit winds, and of the angles and reference values, to changes of the outputs.
    fn outputs<const B: usize>(
        &self,
        state: &State<B>,
        direction: &Inputs,
        change: &StateChange<B>,
    ) -> Outputs {
        let flow = FlowChange {
            alpha: direction.alpha,
            sideslip: direction.sideslip,
            area: direction.area,
            chord: direction.chord,
            point: direction.point,
        };
        let Distributions { loads, cp } = distributions::jvp(
            (&state.circulations, &state.pressure.forms),
            &Wind::new(&self.flow),
            (&change.circulations, &change.forms),
            &flow,
        );
        let of_cell = |(panel, _): &(u32, bool)| cp[*panel as usize];
        Outputs {
            scalars: coefficients::jvp(&state.totals, &self.flow, &change.totals, &flow),
            sections: loads,
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
        let (flows, changes): (Vec<FlowChange>, Vec<StateChange<B>>) =
            seeds.iter().map(|seed| self.state_seeds(state, seed)).unzip();
        let motions = state.vjp(setup, changes, monitor)?;
        let inputs = |(flow, motion): (FlowChange, Motion)| Inputs {
            vertices: setup.panels.scatter(&motion.points),
            alpha: flow.alpha,
            sideslip: flow.sideslip,
            mach: motion.mach,
            area: flow.area,
            chord: flow.chord,
            point: flow.point,
        };
        Ok(flows.into_iter().zip(motions).map(inputs).collect())
    }

    /// The transpose of [`outputs`](Self::outputs).
    fn state_seeds<const B: usize>(&self, state: &State<B>, seed: &Outputs) -> (FlowChange, StateChange<B>) {
        let panels = &self.solution.setup.panels;
        let mut cp = vec![0.0; panels.len()];
        for ((panel, _), of_cell) in panels.panel_of.iter().zip(&seed.cp) {
            cp[*panel as usize] += of_cell;
        }
        let (totals, mut flow) = coefficients::vjp(&state.totals, &self.flow, &seed.scalars);
        let (circulations, forms) = distributions::vjp(
            (&state.circulations, &state.pressure.forms),
            &Wind::new(&self.flow),
            &Distributions { loads: seed.sections.clone(), cp },
            &mut flow,
        );
        (flow, StateChange { circulations, forms, totals })
    }
}
