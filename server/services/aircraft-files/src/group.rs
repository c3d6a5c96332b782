//! Components of files that do not say which patches belong together.

use std::collections::BTreeMap;

use moldline_foundation::Vector3;
use moldline_geometry::PatchInput;

use crate::model::{SurfaceSet, copy_number, split_label};

/// Corners within this distance of each other, relative to the size of all patches, touch.
const CONTACT: f64 = 1e-5;

/// Patches with the same ID and number of the copy in their labels are one set; those without ID are one set where they touch at two corners.
pub(crate) fn by_label_or_contact(patches: Vec<PatchInput>) -> Vec<SurfaceSet> {
    let mut index: BTreeMap<(String, String), usize> = BTreeMap::new();
    let mut sets: Vec<SurfaceSet> = Vec::new();
    let mut nameless = Vec::new();
    for patch in patches {
        let (id, name) = split_label(&patch.name);
        let Some(id) = id else {
            nameless.push(patch);
            continue;
        };
        let at = *index.entry((id.into(), copy_number(&patch.name).into())).or_insert_with(|| {
            sets.push(SurfaceSet { id: id.into(), name: name.into(), patches: Vec::new() });
            sets.len() - 1
        });
        sets[at].patches.push(patch);
    }
    sets.extend(by_contact(nameless));
    sets
}

fn by_contact(patches: Vec<PatchInput>) -> Vec<SurfaceSet> {
    let corners: Vec<[Vector3; 4]> = patches.iter().map(corners).collect();
    let all = || corners.iter().flatten();
    let low = all().fold(Vector3::repeat(f64::INFINITY), |a, p| a.inf(p));
    let high = all().fold(Vector3::repeat(f64::NEG_INFINITY), |a, p| a.sup(p));
    let width = (CONTACT * (high - low).norm()).max(f64::MIN_POSITIVE);
    // Corners in cells of the tolerance's width: touching ones are in the same cell or in neighbouring ones.
    let cell = |p: &Vector3| [0, 1, 2].map(|k| ((p[k] - low[k]) / width).floor() as i64);
    let mut cells: BTreeMap<[i64; 3], Vec<usize>> = BTreeMap::new();
    for (index, corner) in all().enumerate() {
        cells.entry(cell(corner)).or_default().push(index);
    }
    let mut shared: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (index, corner) in all().enumerate() {
        let [i, j, k] = cell(corner);
        let mut touched: Vec<usize> = Vec::new();
        for di in -1..=1 {
            for dj in -1..=1 {
                for dk in -1..=1 {
                    let others =
                        cells.get(&[i.saturating_add(di), j.saturating_add(dj), k.saturating_add(dk)]);
                    touched.extend(
                        others.into_iter().flatten().map(|other| other / 4).filter(|&p| p > index / 4),
                    );
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        for other in touched {
            *shared.entry((index / 4, other)).or_default() += 1;
        }
    }
    let mut root: Vec<usize> = (0..patches.len()).collect();
    let find = |root: &[usize], mut i: usize| {
        while root[i] != i {
            i = root[i];
        }
        i
    };
    for (&(a, b), &count) in &shared {
        if count >= 2 {
            let (a, b) = (find(&root, a), find(&root, b));
            root[a.max(b)] = a.min(b);
        }
    }
    let mut sets: BTreeMap<usize, SurfaceSet> = BTreeMap::new();
    let mut number = 0;
    for (index, patch) in patches.into_iter().enumerate() {
        let set = sets.entry(find(&root, index)).or_insert_with(|| {
            number += 1;
            let name = split_label(&patch.name).1;
            let name = if name.is_empty() { format!("body_{number}") } else { name.to_owned() };
            SurfaceSet { id: format!("body {number}"), name, patches: Vec::new() }
        });
        set.patches.push(patch);
    }
    sets.into_values().collect()
}

/// The corners of a patch, as far as it is clamped.
fn corners(patch: &PatchInput) -> [Vector3; 4] {
    let n_v = patch.knots_v.control_point_count();
    let n = patch.control_points.len();
    [0, n_v - 1, n - n_v, n - 1].map(|i| Vector3::from(patch.control_points[i]))
}
