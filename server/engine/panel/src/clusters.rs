//! Clusters of panels that lie near each other, by bisection.

use moldline_mesh::Vector3;

/// Halves a set of panels across its longest extent until no part has more than `most`.
pub(crate) fn bisect(mut set: Vec<u32>, centres: &[Vector3], most: usize, out: &mut Vec<Vec<u32>>) {
    if set.len() <= most {
        set.sort_unstable();
        out.push(set);
        return;
    }
    let start = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    let (low, high) = set.iter().map(|i| &centres[*i as usize]).fold(start, |(l, h), c| (l.inf(c), h.sup(c)));
    let axis = (high - low).imax();
    set.sort_unstable_by(|i, j| {
        centres[*i as usize][axis].total_cmp(&centres[*j as usize][axis]).then(i.cmp(j))
    });
    let rest = set.split_off(set.len() / 2);
    bisect(set, centres, most, out);
    bisect(rest, centres, most, out);
}

/// Panels of a patch at most.
pub(crate) const PATCH: usize = 32;

/// A cluster of panels: all patches together are the surface. Loops over pairs go patch by patch, so that what they need stays in the
/// cache.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    pub panels: Vec<u32>,
    /// Nodes of the panels.
    pub nodes: Vec<u32>,
    /// Nodes at the corners of the panels, as places in `nodes`.
    pub places: Vec<[u32; 4]>,
}

impl Patch {
    /// Cuts panels into patches. `centres` and `corners` are the panels', the latter as nodes.
    pub fn cut(centres: &[Vector3], corners: &[[u32; 4]]) -> Vec<Self> {
        let mut sets = Vec::new();
        bisect((0..corners.len() as u32).collect(), centres, PATCH, &mut sets);
        let patch = |panels: Vec<u32>| {
            let mut nodes: Vec<u32> = panels.iter().flat_map(|p| corners[*p as usize]).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let place = |node: u32| nodes.partition_point(|n| *n < node) as u32;
            Self { places: panels.iter().map(|p| corners[*p as usize].map(place)).collect(), panels, nodes }
        };
        sets.into_iter().map(patch).collect()
    }
}
