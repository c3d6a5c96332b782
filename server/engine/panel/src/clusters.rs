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
const PATCH: usize = 32;

/// A cluster of panels and the edges of which they are the left ones: all patches together are the surface. Loops over pairs
/// go patch by patch, so that what they need of the points stays in the cache.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// Points of the panels.
    pub points: Vec<u32>,
    pub panels: Vec<u32>,
    /// Corners of the panels, as places in `points`.
    pub corners: Vec<[u32; 4]>,
    pub edges: Vec<u32>,
    /// Ends `[a, b]` of the edges, likewise.
    pub ends: Vec<[u32; 2]>,
}

impl Patch {
    /// Cuts panels into patches. `centres` and `corners` are the panels', `own` the edges of which each panel is the left one, `ends` those of
    /// every edge.
    pub fn cut(
        centres: &[Vector3],
        corners: &[[u32; 4]],
        own: &[Vec<u32>],
        ends: impl Fn(u32) -> [u32; 2],
    ) -> Vec<Self> {
        let mut sets = Vec::new();
        bisect((0..corners.len() as u32).collect(), centres, PATCH, &mut sets);
        let patch = |panels: Vec<u32>| {
            let mut points: Vec<u32> = panels.iter().flat_map(|p| corners[*p as usize]).collect();
            points.sort_unstable();
            points.dedup();
            let place = |point: u32| points.partition_point(|p| *p < point) as u32;
            let edges: Vec<u32> = panels.iter().flat_map(|p| own[*p as usize].iter().copied()).collect();
            Self {
                corners: panels.iter().map(|p| corners[*p as usize].map(place)).collect(),
                ends: edges.iter().map(|e| ends(*e).map(place)).collect(),
                edges,
                panels,
                points,
            }
        };
        sets.into_iter().map(patch).collect()
    }
}
