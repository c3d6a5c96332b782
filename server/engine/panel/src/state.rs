//! The flow for unit winds along the axes over one geometry, and its derivative: the chain of the method's steps, down and up.
//!
//! ```text
//! points, Mach -> surface -> A, b -> mu -> potentials at nodes, circulations -> pressure forms -> loads; Trefftz plane, wake force
//! ```
//!
//! Everything behind depends on the unknowns mu, which solve `R(mu, surface) = A mu - b = 0`. So `d mu = -A^-1 dR` at fixed mu, and backwards a
//! seed of mu gives `-A^-T mu-bar` for R, which one pass over the pairs turns into seeds of the surface ([`crate::influence`]).

use moldline_mesh::Vector3;

use crate::{
    Monitor, PanelError, PanelSetup, Stage,
    coefficients::Totals,
    influence::{Charges, Influence},
    linear_system::System,
    pressure::{Form, Potentials, Pressure},
    surface::{Surface, SurfaceChange},
    wake_force,
};

/// The flow for unit winds along `B` axes.
#[derive(Debug)]
pub(crate) struct State<const B: usize> {
    pub surface: Surface,
    pub system: System,
    /// The unknowns and what follows from them.
    charges: [Charges; B],
    /// Circulations at both ends of every strip.
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

/// Circulations at both ends of every strip, for values of the unknowns.
fn circulations(setup: &PanelSetup, unknowns: &[f64]) -> Vec<f64> {
    let ends = setup.layout.nodes.ends.iter().flatten();
    ends.map(|terms| terms.iter().map(|(u, f)| f * unknowns[*u as usize]).sum()).collect()
}

impl<const B: usize> State<B> {
    /// Solves for the flow over points (before stretching).
    pub fn new(
        setup: &PanelSetup,
        points: &[Vector3],
        mach: f64,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Self, PanelError> {
        let (panels, layout) = (&setup.panels, &setup.layout);
        let surface = Surface::new(panels, &layout.elements, points, mach)?;
        let influence = Influence::new(panels, layout, &surface);
        let (matrix, right) = influence.assemble::<B>(monitor)?;
        let row_points: Vec<Vector3> =
            layout.nodes.row_point.iter().map(|p| surface.points[*p as usize]).collect();
        let system = System::new(matrix, setup.options.solver, &row_points, monitor)?;
        let solved = system.solve(&right, false, setup.options.tolerance, monitor)?;
        let charges: [Charges; B] = std::array::from_fn(|k| influence.charges(&solved.columns[k]));
        let circulations: [Vec<f64>; B] = std::array::from_fn(|k| circulations(setup, &solved.columns[k]));
        let nodes = charges.each_ref().map(|c| &c.nodes[..]);
        let pressure = Potentials { panels, layout, surface: &surface, nodes }.eval();
        let mut totals = Totals::zeros();
        pressure.totals(panels, &surface, &mut totals);
        totals.lift = std::array::from_fn(|k| setup.trace.lift(&surface.points, &circulations[k]));
        totals.drag = setup.trace.drag(&surface.points, &circulations, monitor)?;
        let wake_lift =
            wake_force::lift(panels, layout, &surface, &setup.wakes, &charges, &circulations, monitor)?;
        let (residual, rounds) = (solved.residual, solved.rounds);
        Ok(Self { surface, system, charges, circulations, pressure, totals, wake_lift, residual, rounds })
    }

    fn potentials<'a>(&'a self, setup: &'a PanelSetup) -> Potentials<'a, B> {
        Potentials {
            panels: &setup.panels,
            layout: &setup.layout,
            surface: &self.surface,
            nodes: self.charges.each_ref().map(|c| &c.nodes[..]),
        }
    }

    /// The changes of the flow in several directions.
    pub fn jvp(
        &self,
        setup: &PanelSetup,
        directions: &[Motion],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<StateChange<B>>, PanelError> {
        let surfaces: Vec<SurfaceChange> =
            directions.iter().map(|motion| self.surface.jvp(&motion.points, motion.mach)).collect();
        let influence = Influence::new(&setup.panels, &setup.layout, &self.surface);
        let residuals = influence.jvp(&self.charges, &surfaces, monitor)?;
        let d_mu = self.solve_for_minus(setup, residuals, false, monitor)?;
        surfaces.iter().zip(d_mu).map(|(change, d_mu)| self.change(setup, change, &d_mu, monitor)).collect()
    }

    /// From changes of the surface and the unknowns to those of the flow.
    fn change(
        &self,
        setup: &PanelSetup,
        change: &SurfaceChange,
        d_mu: &[Vec<f64>; B],
        monitor: &dyn Monitor<Stage>,
    ) -> Result<StateChange<B>, PanelError> {
        let (panels, surface) = (&setup.panels, &self.surface);
        let d_circulations: [Vec<f64>; B] = std::array::from_fn(|k| circulations(setup, &d_mu[k]));
        let d_nodes: [Vec<f64>; B] = std::array::from_fn(|k| setup.layout.node_values(&d_mu[k]));
        let forms = self.potentials(setup).jvp(&self.pressure, change, &d_nodes);
        let mut totals = Totals::zeros();
        self.pressure.totals_jvp(panels, surface, &forms, change, &mut totals);
        totals.lift = std::array::from_fn(|k| {
            let (values, changes) = (&self.circulations[k], &d_circulations[k]);
            setup.trace.lift_jvp(&surface.points, values, &change.points, changes)
        });
        totals.drag = setup.trace.drag_jvp(
            &surface.points,
            &self.circulations,
            &change.points,
            &d_circulations,
            monitor,
        )?;
        Ok(StateChange { circulations: d_circulations, forms, totals })
    }

    /// The transpose of [`jvp`](Self::jvp): the gradients of several seeds.
    pub fn vjp(
        &self,
        setup: &PanelSetup,
        seeds: Vec<StateChange<B>>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<Vec<Motion>, PanelError> {
        let direct: Vec<_> =
            seeds.into_iter().map(|seed| self.direct(setup, seed, monitor)).collect::<Result<_, _>>()?;
        let (surfaces, of_mu): (Vec<SurfaceChange>, Vec<[Vec<f64>; B]>) = direct.into_iter().unzip();
        let psi = self.solve_for_minus(setup, of_mu, true, monitor)?;
        let influence = Influence::new(&setup.panels, &setup.layout, &self.surface);
        let pairs = influence.vjp(&self.charges, &psi, monitor)?;
        let motion = |(mut direct, pairs): (SurfaceChange, SurfaceChange)| {
            direct.beta += pairs.beta;
            direct.points.iter_mut().zip(&pairs.points).for_each(|(a, b)| *a += b);
            let (points, mach) = self.surface.vjp(direct);
            Motion { points, mach }
        };
        Ok(surfaces.into_iter().zip(pairs).map(motion).collect())
    }

    /// From seeds of the flow to those of the surface and the unknowns, at fixed residual.
    fn direct(
        &self,
        setup: &PanelSetup,
        seed: StateChange<B>,
        monitor: &dyn Monitor<Stage>,
    ) -> Result<(SurfaceChange, [Vec<f64>; B]), PanelError> {
        let (panels, surface, trace) = (&setup.panels, &self.surface, &setup.trace);
        let nodes = &setup.layout.nodes;
        let StateChange { mut circulations, mut forms, totals } = seed;
        let mut change = SurfaceChange::zeros(surface);
        let mut of_nodes: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; nodes.row.len()]);
        self.pressure.totals_vjp(panels, surface, &totals, &mut forms, &mut change);
        self.potentials(setup).vjp(&self.pressure, &forms, &mut change, &mut of_nodes);
        let points = &mut change.points;
        trace.drag_vjp(
            &surface.points,
            &self.circulations,
            &totals.drag,
            points,
            &mut circulations,
            monitor,
        )?;
        let mut of_mu: [Vec<f64>; B] = std::array::from_fn(|_| vec![0.0; nodes.rows()]);
        for k in 0..B {
            let of_ends = &mut circulations[k];
            trace.lift_vjp(
                &surface.points,
                &self.circulations[k],
                totals.lift[k],
                &mut change.points,
                of_ends,
            );
            setup.layout.add_node_values(&of_nodes[k], &mut of_mu[k]);
            for (terms, seed) in nodes.ends.iter().flatten().zip(of_ends) {
                terms.iter().for_each(|(u, f)| of_mu[k][*u as usize] += f * *seed);
            }
        }
        Ok((change, of_mu))
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
        let solved = self.system.solve(&right, transposed, setup.options.tolerance, monitor);
        let solved = solved.map_err(|error| match error {
            // The system has been solved for the flow itself, so that it is the right-hand side that is too large.
            PanelError::NotConverged { residual, .. } if !residual.is_finite() => {
                PanelError::Overflow { what: "a product" }
            }
            error => error,
        })?;
        let mut columns = solved.columns.into_iter();
        Ok((0..count).map(|_| std::array::from_fn(|_| columns.next().unwrap_or_default())).collect())
    }
}
