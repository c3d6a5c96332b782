//! Parallel loops of adjoints, and maps of vectors applied direction by direction.

use std::ops::Range;

use moldline_geometry::Block;
use rayon::prelude::*;

/// Parts of the mesh that gather seeds of the control points on their own. Fixed, so that sums do not depend on threads.
const PARTS: usize = 8;

/// Runs `part` on consecutive ranges of `count` items, each with its own seeds of the control points, and adds these up in
/// order.
pub(crate) fn gather<R: Send>(
    count: usize,
    control_points: &mut [Block],
    part: impl Fn(Range<usize>, &mut [Block]) -> R + Sync,
) -> Vec<R> {
    let shapes: Vec<(usize, usize)> =
        control_points.iter().map(|b| (b.data().len() / b.width().max(1), b.width())).collect();
    let parts: Vec<(R, Vec<Block>)> = (0..PARTS)
        .into_par_iter()
        .map(|p| {
            let mut own: Vec<Block> = shapes.iter().map(|&(rows, width)| Block::zeros(rows, width)).collect();
            let result = part(p * count / PARTS..(p + 1) * count / PARTS, &mut own);
            (result, own)
        })
        .collect();
    let mut results = Vec::with_capacity(PARTS);
    for (result, own) in parts {
        results.push(result);
        control_points.iter_mut().zip(&own).for_each(|(sum, part)| sum.add(part));
    }
    results
}

/// Applies a map of vectors to each direction of a block.
pub(crate) fn by_direction(block: &Block, map: impl Fn(&[[f64; 3]], &mut [[f64; 3]])) -> Block {
    let count = block.data().len() / block.width().max(1);
    let mut out = Block::zeros(count, block.width());
    let mut mapped = vec![[0.0; 3]; count];
    for d in 0..block.directions() {
        let x: Vec<[f64; 3]> = (0..count).map(|v| block.vector(v, d).into()).collect();
        map(&x, &mut mapped);
        for (v, x) in mapped.iter().enumerate() {
            out.row_mut(v)[3 * d..3 * d + 3].copy_from_slice(x);
        }
    }
    out
}
