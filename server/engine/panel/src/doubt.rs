//! Reasons to doubt a set-up or an answer: independent checks of what the solution does not use.
//!
//! | check | what is compared |
//! |---|---|
//! | lift | pressure on the surface and force on the wakes, with what momentum demands for the circulation |
//! | drag | pressure drag with the induced drag of the Trefftz plane |
//! | span efficiency | with the largest that any wake of this span and height can have (Prandtl's box, above Munk's plane wake) |
//! | stagnation | the largest pressure coefficient with that of fluid at rest, `1 + M^2` |
//! | circulation | zigzags from one strip to the next, with the circulation itself |
//!
//! Each has two limits ([`Check::limits`]): beyond the first the answer carries a warning, beyond the second it is refused, unless the options
//! ask otherwise. The limits are those of the method with constant doublets, above what its wings and bodies showed; the project's tests stay
//! below them with the present one, and they are to be measured again.

use std::fmt;

use crate::{LeftOut, NearPass, Reason, Scalars, Section};

/// A check of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Check {
    /// Lift from pressure and wakes against lift from circulation.
    Lift,
    /// Drag from pressure against drag from the Trefftz plane.
    Drag,
    /// Span efficiency above the largest possible.
    SpanEfficiency,
    /// Pressure above that of fluid at rest.
    Stagnation,
    /// Circulation that jumps up and down from strip to strip.
    Circulation,
}

impl Check {
    /// All checks.
    pub const ALL: [Self; 5] =
        [Self::Lift, Self::Drag, Self::SpanEfficiency, Self::Stagnation, Self::Circulation];

    /// Its name in protocols.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lift => "lift",
            Self::Drag => "drag",
            Self::SpanEfficiency => "span_efficiency",
            Self::Stagnation => "stagnation",
            Self::Circulation => "circulation",
        }
    }

    /// Values above the first are warned of, above the second refused.
    pub fn limits(self) -> [f64; 2] {
        match self {
            Self::Lift => [0.03, 0.2],
            Self::Drag => [0.05, 0.3],
            Self::SpanEfficiency => [0.03, 0.3],
            Self::Stagnation => [0.2, 5.0],
            Self::Circulation => [0.05, 0.5],
        }
    }
}

/// What to do with an answer that a check finds wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum OnDoubt {
    /// Refuse it beyond the second limit of a check; warn beyond the first.
    #[default]
    Refuse,
    /// Warn only.
    Warn,
}

/// A reason to doubt a set-up or an answer.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// A closed part of the surface is as thin as a wing, but sheds no wake.
    NoWake {
        /// A cell of the part.
        cell: u32,
        /// Middle of the part, m.
        position: [f64; 3],
    },
    /// A line looks like a trailing edge, but was not taken as one.
    LeftOut(LeftOut),
    /// A wake passes cells nearer than they can resolve.
    NearPass(NearPass),
    /// A check finds the answer wrong.
    Doubt {
        /// The check.
        check: Check,
        /// What it found.
        value: f64,
        /// The limit that this is above.
        limit: f64,
    },
}

impl Warning {
    /// Goes over to other numbers of vertices.
    pub fn renumber(&mut self, number: &dyn Fn(u32) -> u32) {
        match self {
            Self::LeftOut(LeftOut { line, .. }) => line.vertices.iter_mut().for_each(|v| *v = number(*v)),
            Self::NearPass(NearPass { edge, .. }) => *edge = edge.map(number),
            Self::NoWake { .. } | Self::Doubt { .. } => {}
        }
    }

    /// Its kind in protocols.
    pub fn name(&self) -> &'static str {
        match self {
            Self::NoWake { .. } => "no_wake",
            Self::LeftOut(_) => "left_out",
            Self::NearPass(_) => "near_pass",
            Self::Doubt { check, .. } => check.name(),
        }
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoWake { cell, position: [x, y, z] } => write!(
                f,
                "the part of cells[{cell}] around ({x:.4}, {y:.4}, {z:.4}) m is as thin as a wing, but sheds no wake and so carries no lift; \
                 name its trailing edge if it has one"
            ),
            Self::LeftOut(LeftOut { line, reason }) => {
                write!(
                    f,
                    "no wake leaves the line of {line}: {reason}; name its edges if it is a trailing edge"
                )
            }
            Self::NearPass(NearPass { edge, cell, distance, size, x }) => write!(
                f,
                "the wake of trailing edge {edge:?} passes cells[{cell}] at x = {x:.4} m within {distance:.2e} m, and the cell measures \
                 {size:.2e} m; refine there, or move the surfaces apart"
            ),
            Self::Doubt { check, value, limit } => {
                let percent = 100.0 * value;
                match check {
                    Check::Lift => write!(
                        f,
                        "lift from pressure and wakes and lift from circulation are {percent:.1} % apart"
                    ),
                    Check::Drag => write!(
                        f,
                        "drag from pressure and drag from the wakes are apart by {percent:.1} % of the lift"
                    ),
                    Check::SpanEfficiency => write!(
                        f,
                        "the span efficiency is {percent:.1} % above the largest that wakes of this span and height can have"
                    ),
                    Check::Stagnation => {
                        write!(
                            f,
                            "the largest pressure coefficient is {value:.2} above that of fluid at rest"
                        )
                    }
                    Check::Circulation => write!(
                        f,
                        "the circulation jumps up and down from one trailing edge to the next by {percent:.1} % of itself"
                    ),
                }?;
                write!(f, " (limit {limit}); cells may be too coarse or trailing edges missing")
            }
        }
    }
}

/// What the checks need of an answer.
pub(crate) struct Evidence<'a> {
    pub scalars: &'a Scalars,
    /// Lift on the wakes.
    pub wake_lift: f64,
    /// Lift that momentum demands.
    pub demanded: f64,
    /// Pressure coefficients of the cells.
    pub cp: &'a [f64],
    pub sections: &'a [Section],
    /// Whether the sections are of one half of a symmetric aircraft.
    pub symmetric: bool,
    pub mach: f64,
    /// Wetted area of the whole, over the reference area.
    pub wetted: f64,
    /// Reference area, m^2.
    pub area: f64,
}

/// Lift coefficient by wetted area below which the balances are those of a body without lift.
const NO_LIFT: f64 = 0.02;

/// The doubts in an answer: checks that are above their first limit, with the limit that they are above.
pub(crate) fn doubts(evidence: &Evidence<'_>) -> Vec<Warning> {
    let doubt = |check: Check| {
        let value = value(check, evidence);
        let limits = check.limits();
        // A body without wakes is warned of only: its pressure drag tells how coarse it is, and there is no circulation that could be wrong.
        let limits = if evidence.sections.is_empty() { &limits[..1] } else { &limits[..] };
        // What is no number is above every limit.
        let limit = limits
            .iter()
            .copied()
            .rfind(|limit| value.partial_cmp(limit) != Some(std::cmp::Ordering::Less))?;
        Some(Warning::Doubt { check, value, limit })
    };
    Check::ALL.into_iter().filter_map(doubt).collect()
}

/// Whether an answer with a warning is refused.
pub(crate) fn is_refused(warning: &Warning) -> bool {
    matches!(warning, Warning::Doubt { check, limit, .. } if *limit >= check.limits()[1])
}

fn value(check: Check, e: &Evidence<'_>) -> f64 {
    let lift = e.scalars.lift.abs() + NO_LIFT * e.wetted;
    match check {
        Check::Lift => (e.scalars.pressure_lift + e.wake_lift - e.demanded).abs() / lift,
        Check::Drag => (e.scalars.pressure_drag - e.scalars.induced_drag).abs() / lift,
        Check::SpanEfficiency => excess_efficiency(e),
        Check::Stagnation => e.cp.iter().copied().fold(f64::NEG_INFINITY, f64::max) - (1.0 + e.mach * e.mach),
        Check::Circulation => zigzag(e.sections),
    }
}

/// Span efficiency over the largest possible, less one. A box of height h and span b has at most `1 + 5 h / b`, rounded up.
fn excess_efficiency(e: &Evidence<'_>) -> f64 {
    let mut box_of = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for section in e.sections {
        for (axis, range) in box_of.iter_mut().enumerate() {
            for end in [-0.5, 0.5] {
                let at = section.middle[axis + 1] + end * section.span[axis];
                *range = [range[0].min(at), range[1].max(at)];
            }
        }
    }
    let [[port, starboard], [low, high]] = box_of;
    let span = if e.symmetric { 2.0 * port.abs().max(starboard.abs()) } else { starboard - port };
    if e.sections.is_empty() || span <= 0.0 || e.scalars.lift.abs() < NO_LIFT * e.wetted {
        return 0.0;
    }
    let least = e.scalars.lift.powi(2) * e.area / (std::f64::consts::PI * span * span);
    least / (1.0 + 5.0 * (high - low) / span) / e.scalars.induced_drag.max(f64::MIN_POSITIVE) - 1.0
}

/// Second differences of the circulation that change their sign from strip to strip, over the circulation.
fn zigzag(sections: &[Section]) -> f64 {
    let total: f64 = sections.iter().map(|s| s.load.abs()).sum();
    let bend = |w: &[Section]| {
        let connected = w[0].edge[1] == w[1].edge[0] && w[1].edge[1] == w[2].edge[0];
        if connected { w[1].load - 0.5 * (w[0].load + w[2].load) } else { 0.0 }
    };
    let bends: Vec<f64> = sections.windows(3).map(bend).collect();
    let alternating = bends.windows(2).filter(|w| w[0] * w[1] < 0.0).map(|w| w[0].abs().min(w[1].abs()));
    let sum: f64 = alternating.sum();
    if total > 0.0 { sum / total } else { 0.0 }
}

/// Least width of a line that is warned of, over the surface's extent. The rear edges of tips are narrower.
const WIDE: f64 = 0.05;

/// Which lines that were left out are warned of: sharp ones that span a part of the surface's extent, m, as seen along the flow.
pub(crate) fn suspicious(lines: &[LeftOut], extent: f64) -> Vec<Warning> {
    let suspicious = |line: &&LeftOut| match line.reason {
        Reason::Flat | Reason::NotNamed | Reason::AlongTheFlow => line.line.width >= WIDE * extent,
        Reason::Smooth | Reason::Base => false,
    };
    lines.iter().filter(suspicious).cloned().map(Warning::LeftOut).collect()
}
