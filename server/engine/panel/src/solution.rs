//! The flow over one geometry, and its analysis at an angle of attack.

use std::sync::Arc;

use moldline_mesh::Vector3;

use crate::{
    Flow, Monitor, NearPass, OnDoubt, PanelError, PanelSetup, Scalars, Stage, Warning,
    bounds::{results, within},
    coefficients,
    distributions::{self, Distributions, form},
    doubt::{self, Evidence},
    panel_setup::Component,
    state::State,
    wind::Wind,
};

/// Largest Mach number: the rule is one of small perturbations of a subsonic flow.
pub const MAX_MACH: f64 = 0.9;

/// The state of one half with a plane of symmetry, or of the whole.
#[derive(Debug)]
pub(crate) enum AnyState {
    Symmetric(Box<State<2>>),
    Full(Box<State<3>>),
}

/// The flow over one geometry at one Mach number, for every angle of attack.
#[derive(Debug)]
pub struct Solution {
    pub(crate) setup: Arc<PanelSetup>,
    pub(crate) mach: f64,
    pub(crate) vertices: Vec<[f64; 3]>,
    pub(crate) near_passes: Vec<NearPass>,
    pub(crate) state: AnyState,
}

/// The load of a strip of the wake, which is that of the section of the wing ahead of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// The trailing edge, as mesh vertices.
    pub edge: [u32; 2],
    /// Its middle, m.
    pub middle: [f64; 3],
    /// From the first to the second vertex in y and z, m.
    pub span: [f64; 2],
    /// Section lift coefficient times chord, m: twice the circulation over the wind speed.
    pub load: f64,
}

/// Forces and moments of a part of the surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Loads {
    /// Name of the component.
    pub name: String,
    /// Force along the mesh's axes, over dynamic pressure times reference area.
    pub force: [f64; 3],
    /// Moments about the axes x, y, z through the reference point, over dynamic pressure times reference area times span, chord and span; y is
    /// nose up.
    pub moment: [f64; 3],
    /// Lift coefficient.
    pub lift: f64,
    /// Pressure drag coefficient.
    pub drag: f64,
}

/// The flow at one angle of attack.
#[derive(Clone, Debug, PartialEq)]
pub struct Analysis {
    /// Coefficients of the whole, with slopes.
    pub scalars: Scalars,
    /// Lift coefficient of the wakes: the part of the circulation's lift that acts on them and not on the body, because they are straight and
    /// the flow crosses them. Without derivatives.
    pub wake_lift: f64,
    /// Lift from the pressure and on the wakes over the lift that momentum demands for the circulation, less one. Zero without lift. It
    /// vanishes as the mesh is refined, and so measures the discretisation.
    pub disagreement: f64,
    /// Reasons to doubt the answer; those to doubt the set-up are in [`crate::SetupSummary`].
    pub warnings: Vec<Warning>,
    /// Forces of the whole.
    pub total: Loads,
    /// Forces of the components.
    pub components: Vec<Loads>,
    /// Loads along the trailing edges of the solved half.
    pub sections: Vec<Section>,
    /// Pressure coefficient of every cell: the mean over it.
    pub cp: Vec<f64>,
    /// Pressure coefficient at every vertex: the mean of its cells.
    pub vertex_cp: Vec<f64>,
    /// Cells beyond the critical pressure coefficient, where the flow would be supersonic.
    pub supercritical_cells: usize,
    /// Residual of the linear system relative to its right-hand side.
    pub residual: f64,
    /// Rounds of refinement, or iterations.
    pub rounds: usize,
}

impl PanelSetup {
    /// The flow for unit winds along the axes: any angle of attack follows from it at once. `vertices` are positions in m.
    ///
    /// # Errors
    /// [`PanelError`] if the vertices are not finite, a cell has collapsed, a wake cuts a cell, the Mach number is out of range
    /// or the solution does not converge.
    pub fn solve(
        &self,
        vertices: &[[f64; 3]],
        mach: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Solution, PanelError> {
        Solution::new(Arc::new(self.clone()), vertices, mach, monitor)
    }
}

impl Solution {
    fn new(
        setup: Arc<PanelSetup>,
        vertices: &[[f64; 3]],
        mach: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        within("mach", mach, 0.0, MAX_MACH)?;
        let expected = setup.panels.vertices;
        if vertices.len() != expected {
            return Err(PanelError::Length { field: "vertices".to_owned(), got: vertices.len(), expected });
        }
        for (v, position) in vertices.iter().enumerate() {
            for (axis, &value) in position.iter().enumerate() {
                within(&format!("vertices[{v}][{axis}]"), value, -1e12, 1e12)?;
            }
        }
        setup.panels.check_symmetry(vertices)?;
        let points = setup.panels.gather(vertices);
        let near_passes = setup.wakes.check(&setup.panels, &points, monitor)?;
        let state = if setup.panels.symmetric {
            AnyState::Symmetric(Box::new(State::new(&setup, &points, mach, monitor)?))
        } else {
            AnyState::Full(Box::new(State::new(&setup, &points, mach, monitor)?))
        };
        Ok(Self { setup, mach, vertices: vertices.to_vec(), near_passes, state })
    }

    /// The set-up of the mesh.
    pub fn setup(&self) -> &Arc<PanelSetup> {
        &self.setup
    }

    /// The Mach number.
    pub fn mach(&self) -> f64 {
        self.mach
    }

    /// The positions of the mesh's vertices, m.
    pub fn vertices(&self) -> &[[f64; 3]] {
        &self.vertices
    }

    /// Memory of the solution, bytes.
    pub fn bytes(&self) -> u64 {
        self.setup.options.solver.bytes(self.setup.layout.nodes.rows())
            + 8 * 100 * self.setup.panels.len() as u64
            + 24 * self.vertices.len() as u64
    }

    /// Coefficients, pressures and loads at an angle of attack.
    ///
    /// # Errors
    /// [`PanelError::OutOfRange`] for a flow that is not finite or reference values that are not positive,
    /// [`PanelError::Sideslip`] over a half, [`PanelError::Overflow`], [`PanelError::Doubtful`] for an answer that contradicts itself, unless
    /// the options ask for warnings only.
    pub fn analyse(&self, flow: &Flow) -> Result<Analysis, PanelError> {
        self.check_flow(flow)?;
        let analysis = match &self.state {
            AnyState::Symmetric(state) => self.analysis(state, flow),
            AnyState::Full(state) => self.analysis(state, flow),
        };
        analysis.check()?;
        let refused: Vec<Warning> =
            analysis.warnings.iter().filter(|w| doubt::is_refused(w)).cloned().collect();
        if self.setup.options.on_doubt == OnDoubt::Refuse && !refused.is_empty() {
            return Err(PanelError::Doubtful(refused));
        }
        Ok(analysis)
    }

    pub(crate) fn check_flow(&self, flow: &Flow) -> Result<(), PanelError> {
        flow.check()?;
        if self.setup.panels.symmetric && flow.sideslip != 0.0 {
            return Err(PanelError::Sideslip { sideslip: flow.sideslip });
        }
        Ok(())
    }

    fn analysis<const B: usize>(&self, state: &State<B>, flow: &Flow) -> Analysis {
        let setup = &*self.setup;
        let panels = &setup.panels;
        let wind = Wind::<B>::new(flow);
        let scalars = coefficients::eval(&state.totals, flow);
        let Distributions { loads: section_loads, cp: panel_cp } =
            distributions::eval(&state.circulations, &state.pressure.forms, &wind);
        let everything: Vec<u32> = (0..panels.len() as u32).collect();
        let images: &[u32] = if panels.symmetric { &everything } else { &[] };
        let total = loads("total", state, &panel_cp, &everything, images, flow, &wind);
        let component = |c: &Component| loads(&c.name, state, &panel_cp, &c.own, &c.mirrored, flow, &wind);
        let sections: Vec<Section> = setup
            .wakes
            .strips
            .iter()
            .enumerate()
            .map(|(index, strip)| {
                let [a, b] = [strip.a, strip.b].map(|p| state.surface.points[p as usize]);
                let (middle, way) = (0.5 * (a + b), b - a);
                Section {
                    edge: [strip.a, strip.b].map(|p| panels.vertex_of[p as usize]),
                    middle: [state.surface.beta * middle.x, middle.y, middle.z],
                    span: [way.y, way.z],
                    load: section_loads[index],
                }
            })
            .collect();
        let cp: Vec<f64> = panels.panel_of.iter().map(|(panel, _)| panel_cp[*panel as usize]).collect();
        let vertex_cp = setup
            .vertex_cells
            .rows()
            .map(|cells| cells.iter().map(|c| cp[*c as usize]).sum::<f64>() / cells.len().max(1) as f64)
            .collect();
        let critical = critical_pressure(self.mach);
        let wake_lift = wind.lift.z * form(&state.wake_lift, &wind.w) / flow.reference.area;
        // Induced drag is along the wakes, and so a little downwards.
        let demanded = scalars.lift - scalars.induced_drag * flow.alpha.sin();
        let copies = if panels.symmetric { 2.0 } else { 1.0 };
        let wetted: f64 = (0..panels.len()).map(|panel| real_area(state, panel).norm()).sum();
        let mut warnings: Vec<Warning> = self.near_passes.iter().copied().map(Warning::NearPass).collect();
        warnings.extend(doubt::doubts(&Evidence {
            scalars: &scalars,
            wake_lift,
            demanded,
            cp: &cp,
            sections: &sections,
            symmetric: panels.symmetric,
            mach: self.mach,
            wetted: copies * wetted / flow.reference.area,
            area: flow.reference.area,
        }));
        Analysis {
            warnings,
            wake_lift,
            disagreement: if scalars.lift.abs() > 1e-9 {
                (scalars.pressure_lift + wake_lift) / demanded - 1.0
            } else {
                0.0
            },
            scalars,
            total,
            components: setup.components.iter().map(component).collect(),
            sections,
            supercritical_cells: cp.iter().filter(|cp| **cp < critical).count(),
            cp,
            vertex_cp,
            residual: state.residual,
            rounds: state.rounds,
        }
    }
}

/// The area vector of a panel before stretching, m^2.
fn real_area<const B: usize>(state: &State<B>, panel: usize) -> Vector3 {
    let (a, beta) = (&state.surface.areas[panel], state.surface.beta);
    Vector3::new(a.x, beta * a.y, beta * a.z)
}

impl Analysis {
    /// Nothing that is not finite leaves.
    fn check(&self) -> Result<(), PanelError> {
        let Self { scalars, wake_lift, disagreement, total, components, sections, cp, vertex_cp, .. } = self;
        results("coefficients", scalars.to_array().into_iter().chain([*wake_lift, *disagreement]))?;
        let of = |loads: &Loads| loads.force.into_iter().chain(loads.moment).chain([loads.lift, loads.drag]);
        results("loads", components.iter().chain([total]).flat_map(of))?;
        let of = |section: &Section| section.middle.into_iter().chain(section.span).chain([section.load]);
        results("sections", sections.iter().flat_map(of))?;
        results("cp", cp.iter().chain(vertex_cp).copied())
    }
}

/// Pressure coefficient at which the local flow is sonic (isentropic, ratio of heats 1.4); none at Mach zero.
fn critical_pressure(mach: f64) -> f64 {
    if mach <= 0.0 {
        return f64::NEG_INFINITY;
    }
    let squared = mach * mach;
    let ratio = (1.0 + 0.2 * squared) / 1.2;
    (ratio.powf(3.5) - 1.0) / (0.7 * squared)
}

fn loads<const B: usize>(
    name: &str,
    state: &State<B>,
    cp: &[f64],
    own: &[u32],
    mirrored: &[u32],
    flow: &Flow,
    wind: &Wind<B>,
) -> Loads {
    let surface = &state.surface;
    let reference = &flow.reference;
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    for (list, side) in [(own, 1.0), (mirrored, -1.0)] {
        for &panel in list {
            let panel = panel as usize;
            let (a, c) = (&surface.areas[panel], &surface.centres[panel]);
            let area = Vector3::new(a.x, side * surface.beta * a.y, surface.beta * a.z);
            let centre = Vector3::new(surface.beta * c.x, side * c.y, c.z);
            let f = -cp[panel] * area;
            force += f;
            moment += (centre - Vector3::from(reference.point)).cross(&f);
        }
    }
    let force = force / reference.area;
    let moment = moment / reference.area;
    Loads {
        name: name.to_owned(),
        force: force.into(),
        moment: [moment.x / reference.span, moment.y / reference.chord, moment.z / reference.span],
        lift: force.dot(&wind.lift),
        drag: force.dot(&wind.drag),
    }
}
