//! Sets of patches to closed components: mirrored copies are joined, false corners taken out, gaps welded.

use moldline_foundation::Vector3;
use moldline_geometry::{Body, Component, ComponentError, ComponentOptions, PatchInput};

use crate::{knots::remove_false_corners, model::SurfaceSet, weld::weld};

/// A control point that is taken out changes by at most this, relative to the component's size: what is left of a file's digits.
const REMOVAL_TOLERANCE: f64 = 1e-12;
/// Edges within this distance of each other, relative to the component's size, are one.
pub(crate) const WELD_TOLERANCE: f64 = 1e-4;
/// Tolerances for joining edges that are tried, relative to the component's size: the engine's, and larger ones for edges
/// with different knots, which are not welded.
const EDGE_TOLERANCES: [f64; 4] = [1e-7, 1e-6, 1e-5, 1e-4];

/// A closed component.
#[derive(Debug)]
pub(crate) struct Assembled {
    pub(crate) id: String,
    pub(crate) name: String,
    /// Patches in metres.
    pub(crate) patches: Vec<PatchInput>,
    pub(crate) body: Body,
    /// Sets that it was made of.
    pub(crate) sets: usize,
    /// Patches of the file.
    pub(crate) patches_before: usize,
    /// Smooth pieces before knots were taken out, and after.
    pub(crate) pieces_before: usize,
    pub(crate) knots_removed: usize,
    /// Largest changes, m.
    pub(crate) removal_change: f64,
    pub(crate) weld: f64,
    pub(crate) edge_tolerance: f64,
}

/// A set that is left out.
#[derive(Debug)]
pub(crate) struct LeftOut {
    pub(crate) id: String,
    pub(crate) name: String,
    pub(crate) patches: usize,
    pub(crate) reason: String,
}

/// Makes one component of the sets of one ID: all of them joined if that is closed, otherwise those that are closed by
/// themselves.
pub(crate) fn assemble(sets: Vec<SurfaceSet>) -> (Option<Assembled>, Vec<LeftOut>) {
    let size = size(sets.iter().flat_map(|set| &set.patches));
    let all: Vec<&SurfaceSet> = sets.iter().collect();
    let error = match join(&all, size) {
        Ok(component) => return (Some(component), Vec::new()),
        Err(error) => error,
    };
    let mut closed = Vec::new();
    let mut left_out = Vec::new();
    let mut leave_out = |set: &SurfaceSet, error: &ComponentError| {
        let SurfaceSet { id, name, patches } = set;
        left_out.push(LeftOut {
            id: id.clone(),
            name: name.clone(),
            patches: patches.len(),
            reason: reason(error),
        });
    };
    for set in &sets {
        let error = if sets.len() == 1 { Some(error.clone()) } else { join(&[set], size).err() };
        match error {
            None => closed.push(set),
            Some(error) => leave_out(set, &error),
        }
    }
    if closed.is_empty() {
        return (None, left_out);
    }
    match join(&closed, size) {
        Ok(component) => (Some(component), left_out),
        // Each is closed, and they touch along an edge or overlap: nothing that could be told apart.
        Err(error) => {
            closed.iter().for_each(|set| leave_out(set, &error));
            (None, left_out)
        }
    }
}

fn join(sets: &[&SurfaceSet], size: f64) -> Result<Assembled, ComponentError> {
    let first = sets[0];
    let mut patches: Vec<(usize, &PatchInput)> = Vec::new();
    for (index, set) in sets.iter().enumerate() {
        patches.extend(set.patches.iter().map(|patch| (index, patch)));
    }
    let patches_before = patches.len();
    let pieces_before = patches.iter().map(|(_, patch)| pieces(patch)).sum();
    drop_coincident(&mut patches, WELD_TOLERANCE * size);
    let mut patches: Vec<PatchInput> = patches.into_iter().map(|(_, patch)| patch.clone()).collect();
    // Gaps first: edges of equal curves then lose the same knots.
    let weld = weld(&mut patches, WELD_TOLERANCE * size);
    let (mut knots_removed, mut removal_change) = (0, 0.0_f64);
    let mut smooth = Vec::with_capacity(patches.len());
    for (number, patch) in (1..).zip(patches) {
        let (mut patch, removal) = remove_false_corners(patch, REMOVAL_TOLERANCE * size);
        patch.name = format!("patch_{number}");
        knots_removed += removal.removed;
        removal_change = removal_change.max(removal.change);
        smooth.push(patch);
    }
    let (component, control_points, edge_tolerance) = close(&first.name, &smooth)?;
    Ok(Assembled {
        id: first.id.clone(),
        name: first.name.clone(),
        body: Body::new(component.into(), control_points),
        patches: smooth,
        sets: sets.len(),
        patches_before,
        pieces_before,
        knots_removed,
        removal_change,
        weld,
        edge_tolerance,
    })
}

/// The component, with the least tolerance that closes it; the error is that of the engine's own.
fn close(name: &str, patches: &[PatchInput]) -> Result<(Component, Vec<[f64; 4]>, f64), ComponentError> {
    let with = |edge_tolerance: f64| {
        let options = ComponentOptions { edge_tolerance, ..ComponentOptions::default() };
        Component::new(name.to_owned(), patches.to_vec(), &options)
            .map(|(c, points)| (c, points, edge_tolerance))
    };
    let [own, larger @ ..] = EDGE_TOLERANCES;
    with(own).or_else(|error| larger.into_iter().find_map(|tolerance| with(tolerance).ok()).ok_or(error))
}

/// Drops pairs of patches of two copies that are the same surface, as the caps at the roots of mirrored wings: what is between
/// them is inside.
fn drop_coincident(patches: &mut Vec<(usize, &PatchInput)>, tolerance: f64) {
    let mut drop = vec![false; patches.len()];
    for i in 0..patches.len() {
        for j in i + 1..patches.len() {
            if !drop[i]
                && !drop[j]
                && patches[i].0 != patches[j].0
                && coincide(patches[i].1, patches[j].1, tolerance)
            {
                (drop[i], drop[j]) = (true, true);
            }
        }
    }
    let mut drop = drop.into_iter();
    patches.retain(|_| drop.next() == Some(false));
}

/// Whether the control nets of two patches are the same, forwards or backwards along each direction.
fn coincide(a: &PatchInput, b: &PatchInput, tolerance: f64) -> bool {
    let shape = |p: &PatchInput| (p.knots_u.control_point_count(), p.knots_v.control_point_count());
    let (n_u, n_v) = shape(a);
    if shape(b) != (n_u, n_v) || a.weights.is_some() != b.weights.is_some() {
        return false;
    }
    let extent = size([a].into_iter());
    let tolerance = tolerance.min(1e-3 * extent);
    let close = |p: &[f64; 3], q: &[f64; 3]| (Vector3::from(*p) - Vector3::from(*q)).norm() <= tolerance;
    [(false, false), (true, false), (false, true), (true, true)].into_iter().any(|(back_u, back_v)| {
        (0..n_u).all(|i| {
            (0..n_v).all(|j| {
                let (k, l) = (if back_u { n_u - 1 - i } else { i }, if back_v { n_v - 1 - j } else { j });
                close(&a.control_points[i * n_v + j], &b.control_points[k * n_v + l])
            })
        })
    })
}

/// Diagonal of the box around control points.
fn size<'p>(patches: impl Iterator<Item = &'p PatchInput>) -> f64 {
    let none = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (low, high) = patches.flat_map(|p| &p.control_points).fold(none, |(low, high), p| {
        let p = Vector3::from(*p);
        (low.inf(&p), high.sup(&p))
    });
    (high - low).norm()
}

/// Smooth pieces of a patch: it is cut where it is only continuous.
fn pieces(patch: &PatchInput) -> usize {
    [&patch.knots_u, &patch.knots_v]
        .map(|knots| {
            let breaks = knots.breaks();
            let inner = &breaks[1..breaks.len() - 1];
            1 + inner.iter().filter(|&&t| knots.multiplicity(t) >= knots.degree()).count()
        })
        .iter()
        .product()
}

fn reason(error: &ComponentError) -> String {
    match error {
        ComponentError::Open { count, from, .. } => {
            let [x, y, z] = from;
            format!("open: {count} edges join no other patch, one of them at ({x:.3}, {y:.3}, {z:.3}) m")
        }
        other => other.to_string(),
    }
}
