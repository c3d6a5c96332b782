//! Clusters of panels that lie near each other, by bisection.

use std::ops::Range;

use moldline_mesh::Vector3;

/// Halves a set of panels across its longest extent until no part has more than `most`. All parts but one are full.
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
    let parts = set.len().div_ceil(most);
    let rest = set.split_off(parts / 2 * most);
    bisect(set, centres, most, out);
    bisect(rest, centres, most, out);
}

/// Elements of a patch, and panels of a group, at most.
pub(crate) const PATCH: usize = 32;

/// A cluster of elements. All patches together are the surface, and patch after patch the elements have places in that order. Loops over pairs go patch by
/// patch, so that what they need stays in the cache.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// Places of its elements.
    pub places: Range<usize>,
    /// Nodes of the elements' panels.
    pub nodes: Vec<u32>,
    /// Those at the corners of every element's panel, as indices of `nodes`.
    pub corners: Vec<[u32; 4]>,
}

impl Patch {
    /// Cuts elements into patches: the element at every place, and the patches. `centres` and `corners` are the elements', the latter as nodes of their
    /// panels.
    pub fn cut(centres: &[Vector3], corners: &[[u32; 4]]) -> (Vec<u32>, Vec<Self>) {
        let mut sets = Vec::new();
        bisect((0..corners.len() as u32).collect(), centres, PATCH, &mut sets);
        let mut order = Vec::with_capacity(corners.len());
        let patch = |elements: Vec<u32>| {
            let mut nodes: Vec<u32> = elements.iter().flat_map(|e| corners[*e as usize]).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let index = |node: u32| nodes.partition_point(|n| *n < node) as u32;
            let corners = elements.iter().map(|e| corners[*e as usize].map(index)).collect();
            let places = order.len()..order.len() + elements.len();
            order.extend(elements);
            Self { places, corners, nodes }
        };
        let patches = sets.into_iter().map(patch).collect();
        (order, patches)
    }
}
