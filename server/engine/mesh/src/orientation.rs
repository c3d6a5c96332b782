//! Consistent orientation of the cells of a surface.

use thiserror::Error;

use crate::{Cell, Csr, Plane, Topology, topology::enclosed_volume};

/// Why cells cannot be oriented consistently.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OrientationError {
    /// A one-sided surface, such as a Moebius band.
    #[error("cells {cells:?} cannot be oriented alike across edge {edge:?}: the surface has one side only")]
    OneSided {
        /// The edge where both orientations met, as vertices.
        edge: [u32; 2],
        /// The cells at it.
        cells: [u32; 2],
    },
}

/// Flips cells so that neighbours across every edge with two cells agree; each patch connected by such edges keeps the
/// orientation of its majority. Edges with three or more cells separate patches. Returns which cells were flipped.
/// `topology` is that of the cells; of its fields `inconsistent_edges` alone depends on their orientation, and is stale
/// afterwards.
///
/// # Errors
/// [`OrientationError::OneSided`]; the cells are then unchanged.
pub fn orient(cells: &mut [Cell], topology: &Topology) -> Result<Vec<bool>, OrientationError> {
    let flips = Flips::find(cells, topology)?;
    flips.apply(cells);
    Ok(flips.flipped)
}

/// As [`orient`], then orients outwards (to positive enclosed volume) every patch that is closed, or closed by the symmetry plane
/// (given with a tolerance in m). The shell of a cavity, too, points away from the cavity.
///
/// # Errors
/// As [`orient`].
pub fn orient_outwards(
    vertices: &[[f64; 3]],
    cells: &mut [Cell],
    topology: &Topology,
    symmetry: Option<(&Plane, f64)>,
) -> Result<Vec<bool>, OrientationError> {
    let mut flips = Flips::find(cells, topology)?;
    flips.apply(cells);
    let mut closed = vec![true; flips.patches];
    let open = topology.open_edges(vertices, symmetry);
    for edge in open.iter().chain(&topology.non_manifold_edges) {
        for &cell in topology.edge_cells.row(*edge as usize) {
            closed[flips.patch[cell as usize] as usize] = false;
        }
    }
    let members = Csr::from_pairs(flips.patches, flips.patch.iter().copied().zip(0..));
    for patch in (0..flips.patches).filter(|&patch| closed[patch]) {
        let of_patch: Vec<Cell> = members.row(patch).iter().map(|&cell| cells[cell as usize]).collect();
        if enclosed_volume(vertices, &of_patch, symmetry.map(|(plane, _)| plane)) < 0.0 {
            for &cell in members.row(patch) {
                cells[cell as usize] = cells[cell as usize].flipped();
                flips.flipped[cell as usize] ^= true;
            }
        }
    }
    Ok(flips.flipped)
}

/// Which cells to flip, and the patch each is in.
struct Flips {
    flipped: Vec<bool>,
    patch: Vec<u32>,
    patches: usize,
}

impl Flips {
    fn find(cells: &[Cell], topology: &Topology) -> Result<Self, OrientationError> {
        const UNSEEN: u32 = u32::MAX;
        let edges = topology.edge_cells.rows().zip(0_u32..);
        let sides = edges.flat_map(|(around, edge)| around.iter().map(move |&cell| (cell, edge)));
        let cell_edges = Csr::from_pairs(cells.len(), sides);
        let runs_up = |cell: u32, edge: [u32; 2]| cells[cell as usize].edges().any(|side| side == edge);

        let mut flips =
            Self { flipped: vec![false; cells.len()], patch: vec![UNSEEN; cells.len()], patches: 0 };
        let mut members = Vec::new();
        for start in 0..cells.len() as u32 {
            if flips.patch[start as usize] != UNSEEN {
                continue;
            }
            let patch = flips.patches as u32;
            flips.patches += 1;
            flips.patch[start as usize] = patch;
            members.clear();
            members.push(start);
            let mut next = 0;
            while let Some(&cell) = members.get(next) {
                next += 1;
                for &edge in cell_edges.row(cell as usize) {
                    let &[one, two] = topology.edge_cells.row(edge as usize) else { continue };
                    let other = if one == cell { two } else { one };
                    let edge = topology.edges[edge as usize];
                    let flip = flips.flipped[cell as usize] ^ (runs_up(cell, edge) == runs_up(other, edge));
                    if flips.patch[other as usize] == UNSEEN {
                        flips.patch[other as usize] = patch;
                        flips.flipped[other as usize] = flip;
                        members.push(other);
                    } else if flips.flipped[other as usize] != flip {
                        return Err(OrientationError::OneSided { edge, cells: [cell, other] });
                    }
                }
            }
            let flipped = members.iter().filter(|&&cell| flips.flipped[cell as usize]).count();
            if 2 * flipped > members.len() {
                for &cell in &members {
                    flips.flipped[cell as usize] ^= true;
                }
            }
        }
        Ok(flips)
    }

    fn apply(&self, cells: &mut [Cell]) {
        for (cell, _) in cells.iter_mut().zip(&self.flipped).filter(|(_, flipped)| **flipped) {
            *cell = cell.flipped();
        }
    }
}
