//! The flow for unit winds along the axes over one geometry, and its derivative: the chain of the method's steps, down and up.
//!
//! ```text
//! points, Mach -> surface -> A, S sigma -> mu -> circulations -> gradients -> pressure forms -> loads; Trefftz plane, wake force
//! ```
//!
//! Everything behind depends on the doublet strengths mu, which solve `R(mu, surface) = 0`. So `d mu = -A^-1 dR` at fixed mu, and backwards a
//! seed of mu gives `-A^-T mu-bar` for R, which one pass over the pairs turns into seeds of the surface ([`crate::influence`]).

use moldline_mesh::Vector3;

use crate::{
    Monitor, PanelError, PanelSetup, Stage,
    coefficients::Totals,
    gradient::{Gradients, Slope},
    influence::{Influence, PairChange, PairSeeds, Strengths},
    kutta::Kutta,
    linear_system::System,
    pressure::{Form, Pressure},
    surface::{Surface, SurfaceChange},
    wake_force,
};

/// The flow for unit winds along `B` axes.
#[derive(Debug)]
pub(crate) struct State<const B: usize> {
    pub surface: Surface,
    /// The circulation of every strip as a sum over doublet strengths.
    pub rows: Vec<Vec<(u32, f64)>>,
    pub system: System,
    /// Doublet strengths: perturbation potentials on the outside.
    pub mu: [Vec<f64>; B],
    pub circulations: [Vec<f64>; B],
    pub pressure: Pressure<B>,
    pub totals: Totals<B>,
    /// Upward force on the wakes over dynamic pressure, m^2.
    pub wake_lift: [[f64; B]; B],
    pub residual: f64,
    pub rounds: usize,
}

/// A change of points (before stretching) and Mach number, or the gradient with respect to them.
pub(crate) struct Motion {
    pub points: Vec<Vector3>,
    pub mach: f64,
}

/// A change of a state, or seeds of it.
pub(crate) struct StateChange<const B: usize> {
    pub circulations: [Vec<f64>; B],
    pub forms: Vec<Form<B>>,
    pub totals: Totals<B>,
}

/// Seeds of one adjoint before the residual is involved.
struct Direct<const B: usize> {
    surface: SurfaceChange,
    circulations: [Vec<f64>; B],
    mu: [Vec<f64>; B],
}

/// Steps of which the chain needs the geometry, but the state does not keep it.
struct Steps<'a, const B: usize> {
    gradients: &'a Gradients<'a>,
    kutta: Kutta<'a>,
    influence: Influence<'a, B>,
}

impl<'a, const B: usize> Steps<'a, B> {
    fn new(setup: &'a PanelSetup, surface: &'a Surface, gradients: &'a Gradients<'a>) -> Self {
        Self {
            gradients,
            kutta: Kutta { surface, wakes: &setup.wakes, gradients },
            influence: Influence::new(&setup.panels, &setup.wakes, surface),
        }
    }
}

impl<const B: usize> State<B> {
    /// Solves for the flow over points (before stretching).
    pub fn new(
        setup: &PanelSetup,
        points: &[Vector3],
        mach: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let panels = &setup.panels;
        let surface = Surface::new(panels, points, mach)?;
        let gradients = Gradients::new(panels, &surface, &setup.stencils)?;
        let steps = Steps::<B>::new(setup, &surface, &gradients);
        let rows = steps.kutta.rows();
        let (matrix, right) = steps.influence.assemble(&rows, monitor)?;
        let system = System::new(matrix, setup.options.solver, &surface.centres, monitor)?;
        let solved = system.solve(&right, false, setup.options.tolerance, monitor)?;
        let mu: [Vec<f64>; B] = {
            let mut columns = solved.columns.into_iter();
            std::array::from_fn(|_| columns.next().unwrap_or_default())
        };
        let circulations: [Vec<f64>; B] = std::array::from_fn(|k| {
            rows.iter().map(|row| row.iter().map(|(p, f)| f * mu[k][*p as usize]).sum()).collect()
        });
        let slopes = std::array::from_fn(|k| {
            (0..panels.len()).map(|panel| gradients.eval(panel, [&mu[k], &circulations[k]])).collect()
        });
        let pressure = Pressure::new(panels, &surface, slopes);
        let mut totals = Totals::zeros();
        pressure.totals(panels, &surface, &mut totals);
        totals.lift = std::array::from_fn(|k| setup.trace.lift(&surface.points, &circulations[k]));
        totals.drag = setup.trace.drag(&surface.points, &circulations);
        let wake_lift = wake_force::lift(panels, &surface, &setup.wakes, &mu, &circulations);
        let (residual, rounds) = (solved.residual, solved.rounds);
        Ok(Self { surface, rows, system, mu, circulations, pressure, totals, wake_lift, residual, rounds })
    }

    /// The changes of the flow in several directions.
    pub fn jvp(
        &self,
        setup: &PanelSetup,
        directions: &[Motion],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<StateChange<B>>, PanelError> {
        let (panels, surface) = (&setup.panels, &self.surface);
        let gradients = Gradients::new(panels, surface, &setup.stencils)?;
        let steps = Steps::<B>::new(setup, surface, &gradients);
        let surfaces: Vec<SurfaceChange> =
            directions.iter().map(|motion| surface.jvp(panels, &motion.points, motion.mach)).collect();
        let fixed = vec![0.0; panels.len()];
        let changes: Vec<PairChange<'_, B>> = surfaces
            .iter()
            .map(|change| PairChange {
                points: &change.points,
                centres: &change.centres,
                sources: std::array::from_fn(|k| surface.sources_jvp(panels.axes()[k], change)),
                strips: std::array::from_fn(|k| steps.kutta.jvp(&self.mu[k], change, &fixed)),
            })
            .collect();
        let residuals = steps.influence.jvp(&self.strengths(), &changes, monitor)?;
        let d_mu = self.solve_for_minus(setup, residuals, false, monitor)?;
        Ok(surfaces
            .iter()
            .zip(d_mu)
            .map(|(change, d_mu)| self.change(setup, &steps, change, &d_mu))
            .collect())
    }

    /// From changes of the surface and the doublets to those of the flow.
    fn change(
        &self,
        setup: &PanelSetup,
        steps: &Steps<'_, B>,
        change: &SurfaceChange,
        d_mu: &[Vec<f64>; B],
    ) -> StateChange<B> {
        let (panels, surface) = (&setup.panels, &self.surface);
        let d_circulations: [Vec<f64>; B] =
            std::array::from_fn(|k| steps.kutta.jvp(&self.mu[k], change, &d_mu[k]));
        let slopes: [Vec<Slope>; B] = std::array::from_fn(|k| {
            let values = [&self.mu[k][..], &self.circulations[k]];
            let changes = [&d_mu[k][..], &d_circulations[k]];
            (0..panels.len()).map(|p| steps.gradients.jvp(p, values, change, changes)).collect()
        });
        let forms = self.pressure.jvp(panels, surface, &slopes, change);
        let mut totals = Totals::zeros();
        self.pressure.totals_jvp(panels, surface, &forms, change, &mut totals);
        totals.lift = std::array::from_fn(|k| {
            let (values, changes) = (&self.circulations[k], &d_circulations[k]);
            setup.trace.lift_jvp(&surface.points, values, &change.points, changes)
        });
        totals.drag =
            setup.trace.drag_jvp(&surface.points, &self.circulations, &change.points, &d_circulations);
        StateChange { circulations: d_circulations, forms, totals }
    }

    /// The transpose of [`jvp`](Self::jvp): the gradients of several seeds.
    pub fn vjp(
        &self,
        setup: &PanelSetup,
        seeds: Vec<StateChange<B>>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Motion>, PanelError> {
        let gradients = Gradients::new(&setup.panels, &self.surface, &setup.stencils)?;
        let steps = Steps::<B>::new(setup, &self.surface, &gradients);
        let mut direct: Vec<Direct<B>> =
            seeds.into_iter().map(|seed| self.direct(setup, &steps, seed)).collect();
        let of_mu =
            direct.iter_mut().map(|seeds| std::mem::replace(&mut seeds.mu, [const { Vec::new() }; B]));
        let psi = self.solve_for_minus(setup, of_mu.collect(), true, monitor)?;
        let pairs = steps.influence.vjp(&self.strengths(), &psi, monitor)?;
        Ok(direct
            .into_iter()
            .zip(pairs)
            .map(|(seeds, pairs)| self.motion(setup, &steps, seeds, pairs))
            .collect())
    }

    /// From seeds of the flow to those of surface, circulations and doublets, at fixed residual.
    fn direct(&self, setup: &PanelSetup, steps: &Steps<'_, B>, seed: StateChange<B>) -> Direct<B> {
        let (panels, surface, trace) = (&setup.panels, &self.surface, &setup.trace);
        let StateChange { mut circulations, mut forms, totals } = seed;
        let mut change = SurfaceChange::zeros(surface);
        let mut mu: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; panels.len()]);
        self.pressure.totals_vjp(panels, surface, &totals, &mut forms, &mut change);
        let slopes = self.pressure.vjp(panels, surface, &forms, &mut change);
        let points = &mut change.points;
        trace.drag_vjp(&surface.points, &self.circulations, &totals.drag, points, &mut circulations);
        for k in 0..B {
            let (of_strips, of_mu) = (&mut circulations[k], &mut mu[k]);
            let values = [&self.mu[k][..], &self.circulations[k]];
            trace.lift_vjp(&surface.points, values[1], totals.lift[k], &mut change.points, of_strips);
            for (panel, slope) in slopes[k].iter().enumerate() {
                steps.gradients.vjp(panel, values, slope, &mut change, [of_mu, of_strips]);
            }
            for (row, seed) in self.rows.iter().zip(of_strips.iter()) {
                row.iter().for_each(|(panel, factor)| of_mu[*panel as usize] += seed * factor);
            }
        }
        Direct { surface: change, circulations, mu }
    }

    /// From direct seeds and those of the pairs to points and Mach number.
    fn motion(
        &self,
        setup: &PanelSetup,
        steps: &Steps<'_, B>,
        direct: Direct<B>,
        pairs: PairSeeds<B>,
    ) -> Motion {
        let panels = &setup.panels;
        let mut change = direct.surface;
        let add = |to: &mut [Vector3], from: &[Vector3]| {
            to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
        };
        add(&mut change.points, &pairs.points);
        add(&mut change.centres, &pairs.centres);
        // The doublets' part has gone through the residual.
        let mut unused = vec![0.0; panels.len()];
        for k in 0..B {
            self.surface.sources_vjp(panels.axes()[k], &pairs.sources[k], &mut change);
            let of_strips = direct.circulations[k].iter().zip(&pairs.strips[k]);
            let of_strips: Vec<f64> = of_strips.map(|(direct, of_pairs)| direct + of_pairs).collect();
            steps.kutta.vjp(&self.mu[k], &of_strips, &mut change, &mut unused);
        }
        let (points, mach) = self.surface.vjp(panels, change);
        Motion { points, mach }
    }

    /// `-A^-1 b`, or `-A^-T b`, for the columns b of every direction or seed.
    fn solve_for_minus(
        &self,
        setup: &PanelSetup,
        columns: Vec<[Vec<f64>; B]>,
        transposed: bool,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<[Vec<f64>; B]>, PanelError> {
        let count = columns.len();
        let right: Vec<Vec<f64>> =
            columns.into_iter().flatten().map(|b| b.into_iter().map(|x| -x).collect()).collect();
        let solved = self.system.solve(&right, transposed, setup.options.tolerance, monitor)?;
        let mut columns = solved.columns.into_iter();
        Ok((0..count).map(|_| std::array::from_fn(|_| columns.next().unwrap_or_default())).collect())
    }

    /// The strengths of doublets and wakes.
    pub fn strengths(&self) -> Strengths<'_, B> {
        Strengths {
            doublets: std::array::from_fn(|k| &self.mu[k][..]),
            circulations: std::array::from_fn(|k| &self.circulations[k][..]),
        }
    }
}
