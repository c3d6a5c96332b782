//! Kinks: vertices whose one-sided derivatives differ, on a crease between patches that they cross.

use std::fmt;

use moldline_deform::{DeformError, Monitor, Setup, Stage};
use rayon::prelude::*;

use crate::{Function, Outputs, differences::norm, dual::Real};

/// Steps of the one-sided differences, relative to the range of the variable. Where there is a derivative, the difference between
/// the sides at the second step is a hundredth of that at the first, or rounding, which is ten times as large.
const STEPS: [f64; 2] = [1e-4, 1e-5];
/// Largest relative difference between a kink's jumps at the two steps.
const SAME: f64 = 0.1;

/// Vertices whose derivatives to either side differ.
#[derive(Clone, Debug, PartialEq)]
pub struct Kink {
    /// These vertices.
    pub vertices: Vec<usize>,
    /// The one among them whose derivatives differ most.
    pub worst: usize,
    /// Its jump, m per unit of the variable.
    pub jump: f64,
    /// Its position in the set-up's mesh, m.
    pub position: [f64; 3],
    /// The component it is attached to.
    pub component: String,
    /// Whether it is attached to the boundary of a patch there.
    pub on_boundary: bool,
    /// `|J v - d| / |J v|` over all vertices. At these vertices d is the nearer one-sided derivative, at all others the mean of both,
    /// a central difference.
    pub error: f64,
}

/// The kink in words, and the way out.
impl fmt::Display for Kink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { vertices, worst, jump, position: [x, y, z], component, on_boundary, error } = self;
        let (count, place) =
            (vertices.len(), if *on_boundary { "at a patch boundary" } else { "inside a patch" });
        write!(
            f,
            "a kink. One-sided differences disagree at {count} vertices, by {jump:.1e} m per unit at most: at vertex {worst} of \
             `{component}`, {place}, at ({x:.6}, {y:.6}, {z:.6}). The derivative is that of one side there, and off by {error:.1e} in \
             all. Where vertices lie on a crease, take a design that moves them off it, or make the crease smooth or sharp"
        )
    }
}

/// The vertices whose one-sided derivatives along a direction differ; `None` if there are none, or a design beside this one
/// has no mesh. `here`: the outputs at the design; `tangent`: the derivatives to be checked.
pub fn kink(
    setup: &Setup,
    function: &dyn Function,
    [design, direction]: [&[f64]; 2],
    range: f64,
    here: &Outputs,
    tangent: &[[f64; 3]],
    monitor: &dyn Monitor<Stage>,
) -> Result<Option<Kink>, DeformError> {
    let [wide, narrow] = STEPS.map(|step| sides(function, design, direction, step * range, here, monitor));
    let (Some(wide), Some(narrow)) = (wide?, narrow?) else { return Ok(None) };
    let jump = |[below, above]: &[Real; 2]| above - below;
    let is_kink = |v: &usize| {
        let (wide, narrow) = (jump(&wide[*v]), jump(&narrow[*v]));
        wide.norm() > 0.0 && (wide - narrow).norm() <= SAME * wide.norm()
    };
    let vertices: Vec<usize> = (0..wide.len()).filter(is_kink).collect();
    let height = |v: usize| jump(&wide[v]).norm();
    let Some(worst) = vertices.iter().copied().max_by(|&a, &b| height(a).total_cmp(&height(b))) else {
        return Ok(None);
    };
    let mut off: Vec<[f64; 3]> = wide
        .iter()
        .zip(tangent)
        .map(|([below, above], t)| (Real::from(*t) - (below + above) * 0.5).into())
        .collect();
    for &v in &vertices {
        let [below, above] = wide[v].map(|side| Real::from(tangent[v]) - side);
        off[v] = if below.norm() < above.norm() { below.into() } else { above.into() };
    }
    let attachment = &setup.ownership().of(worst as u32)[0];
    let component = setup.reference()[attachment.component as usize].component();
    let location = attachment.location;
    let surface = &component.patches()[location.patch as usize].surface;
    let [u, v] = surface.domain();
    let at_end = |x: f64, (low, high): (f64, f64)| (x - low).min(high - x) <= 1e-9 * (high - low);
    Ok(Some(Kink {
        worst,
        jump: height(worst),
        position: setup.positions()[worst].into(),
        component: component.name().to_owned(),
        on_boundary: at_end(location.u, u) || at_end(location.v, v),
        error: norm(&off) / norm(tangent),
        vertices,
    }))
}

/// For each vertex `(-3 x(p) + 4 x(p + s d) - x(p + 2 s d)) / 2 s` with s = -h and s = h.
fn sides(
    function: &dyn Function,
    design: &[f64],
    direction: &[f64],
    h: f64,
    here: &Outputs,
    monitor: &dyn Monitor<Stage>,
) -> Result<Option<Vec<[Real; 2]>>, DeformError> {
    let at = |steps: f64| {
        let design: Vec<f64> = design.iter().zip(direction).map(|(p, d)| p + steps * h * d).collect();
        function.eval(&design, monitor)
    };
    let around: Vec<Result<Outputs, DeformError>> = [-2.0, -1.0, 1.0, 2.0].into_par_iter().map(at).collect();
    let mut meshes = Vec::with_capacity(4);
    for result in around {
        match result {
            Ok(outputs) => meshes.push(outputs.vertices),
            Err(DeformError::Cancelled) => return Err(DeformError::Cancelled),
            Err(_) => return Ok(None),
        }
    }
    let x = |mesh: &[[f64; 3]], v: usize| Real::from(mesh[v]);
    let slope = |near: &[[f64; 3]], far: &[[f64; 3]], s: f64, v: usize| {
        (x(near, v) * 4.0 - x(far, v) - x(&here.vertices, v) * 3.0) / (2.0 * s)
    };
    let both = |v| [slope(&meshes[1], &meshes[0], -h, v), slope(&meshes[2], &meshes[3], h, v)];
    Ok(Some((0..here.vertices.len()).map(both).collect()))
}
